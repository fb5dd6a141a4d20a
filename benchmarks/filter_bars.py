"""Hold every filter against its bars on simulated vehicles, and print and keep the numbers.

    python -m benchmarks.filter_bars [--part suite,traffic,following,hostile,braking] [--runs N] [--seeds N]
        [--scans N] [--json docs/measured/filter_bars.json]

suite: the road manoeuvres of the ASTEKF study, all filters, four kinds of radar, with standard errors over
the seeds. traffic: the unscented filters against a plain UKF. following: the cubature filters behind another
vehicle. hostile: scans that no radar should send. braking: 200 vehicles that brake with 9 m/s^2. The defaults
take about seven minutes of one core.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from service.evaluation.hostile_study import endure
from service.evaluation.monte_carlo import (
    Runs,
    error_squared,
    lost,
    position_and_velocity_rmse,
    run_filter,
)
from service.evaluation.report import Grid, markdown
from service.evaluation.reproduce.form import mean_and_error
from service.evaluation.traffic_study import (
    CAR_DOPPLER,
    CAR_RADAR,
    DEFECTS,
    DOPPLER,
    NOISE_LEVELS,
    RADAR,
    Errors,
    estimated_levels,
    fly,
    follow,
)
from service.simulation.manoeuvres import HELD_OUT, PERIOD_S, SUITE, braking
from service.simulation.point_radar import PointNoise, measure
from service.tracking.filters.cubature import isrckf, sh_ekf, srckf
from service.tracking.filters.mast_ukf import mast_ukf
from service.tracking.filters.parameters import (
    POINT_FILTERS,
    MastUkfParameters,
    SageHusaParameters,
    SrckfParameters,
    StUkfParameters,
    UkfParameters,
)
from service.tracking.filters.registry import filter_names, make_filter
from service.tracking.filters.space import plane
from service.tracking.filters.ukf import ast_ukf, st_ukf, ukf

PAPER_RADAR = PointNoise()
PAPER_DOPPLER = dataclasses.replace(PAPER_RADAR, velocity_std_mps=0.25)
CELLS = {
    "range, azimuth": PAPER_RADAR,
    "range, azimuth, defects": dataclasses.replace(PAPER_RADAR, **DEFECTS),
    "Doppler": PAPER_DOPPLER,
    "Doppler, defects": dataclasses.replace(PAPER_DOPPLER, **DEFECTS),
}
MANOEUVRES = {**SUITE, **HELD_OUT}
AFTER = round(2.0 / PERIOD_S)
UNSCENTED = {
    "ukf": lambda space: ukf(UkfParameters(robust_gate=None), space),
    "st-ukf": lambda space: st_ukf(StUkfParameters(robust_gate=None), space),
    "ast-ukf": lambda space: ast_ukf(StUkfParameters(robust_gate=None), space),
    "mast-ukf": lambda space: mast_ukf(MastUkfParameters(), space),
}
UNSCENTED_PRINTED = {  # where the process noise is too small, which is where they fail
    **UNSCENTED,
    "mast-ukf (paper)": lambda space: mast_ukf(MastUkfParameters(form="paper"), space),
    "mast-ukf (printed)": lambda space: mast_ukf(MastUkfParameters(form="printed"), space),
}
CUBATURE = {
    "srckf": lambda space: srckf(SrckfParameters(robust_gate=None), space),
    "isrckf": lambda space: isrckf(SageHusaParameters(), space),
    "sh-ekf": lambda space: sh_ekf(SageHusaParameters(), space),
}
CUBATURE_PRINTED = {  # behind a braking vehicle, likewise
    **CUBATURE,
    "isrckf (fading)": lambda space: isrckf(SageHusaParameters(form="fading"), space),
    "sh-ekf (mean)": lambda space: sh_ekf(SageHusaParameters(form="mean"), space),
}
TRAFFIC = (  # standard deviation of the acceleration, radar, defects, louder than assumed
    (4.0, RADAR, {}, 1.0),
    (4.0, RADAR, DEFECTS, 1.0),
    (4.0, RADAR, {}, 2.0),
    (1.0, RADAR, {}, 1.0),
    (4.0, DOPPLER, {}, 1.0),
    (4.0, DOPPLER, DEFECTS, 1.0),
)
FOLLOWING = (  # standard deviation of the acceleration, radar, assumed noise, braking
    (1.0, CAR_RADAR, 3.0, 0.0),
    (4.0, CAR_RADAR, 1.0, 0.0),
    (4.0, CAR_DOPPLER, 1.0, 0.0),
    (1.0, CAR_DOPPLER, 1.0, 0.0),
    (1.0, CAR_DOPPLER, 1.0, 4.0),
)


def suite(runs: int, seeds: range) -> list[dict[str, object]]:
    """Return position and velocity errors of every filter, kind of radar and manoeuvre, by seed."""
    names = list(MANOEUVRES)
    truth = np.concatenate([np.repeat(MANOEUVRES[n]()[:, None], runs, axis=1) for n in names], axis=1)
    rows: list[dict[str, object]] = []
    for cell, noise in CELLS.items():
        scans = {seed: measure(truth, noise, np.random.default_rng(seed)) for seed in seeds}
        for name in filter_names():
            for seed, z in scans.items():
                flown = run_filter(make_filter(name, POINT_FILTERS), z, noise.covariance(), PERIOD_S)
                for i, manoeuvre in enumerate(names):
                    part = slice(i * runs, (i + 1) * runs)
                    own, exact = Runs(flown.mean[:, part], flown.cov[:, part]), truth[:, part]
                    position_m, velocity_mps = position_and_velocity_rmse(own, exact, AFTER)
                    rows.append({
                        "radar": cell, "filter": name, "manoeuvre": manoeuvre, "seed": seed,
                        "position_m": position_m, "velocity_mps": velocity_mps,
                        "lost": int(lost(own, exact).sum()),
                        "nees": float(error_squared(own, exact, AFTER).mean()),
                    })  # fmt: skip
            print(f"suite: {cell}, {name}", flush=True)
    return rows


Key = tuple[str, str, str]  # radar, manoeuvre, filter


def by_seed(rows: list[dict[str, object]]) -> dict[Key, list[float]]:
    """Return the geometric mean of position and velocity error in each cell of the suite, for each seed."""
    out: dict[Key, list[float]] = {}
    for r in rows:
        if r["manoeuvre"] in SUITE:
            key = (str(r["radar"]), str(r["manoeuvre"]), str(r["filter"]))
            out.setdefault(key, []).append(math.sqrt(float(r["position_m"]) * float(r["velocity_mps"])))
    return out


def behind(joint: dict[Key, list[float]], name: str) -> tuple[float, float, float, float, str]:
    """Return how far a filter is behind the best, with standard errors over the seeds.

    First over the whole suite, in geometric mean, and then in the one manoeuvre and radar where it is
    farthest, which is named last.
    """
    names = list(dict.fromkeys(key[2] for key in joint))
    cells = list(dict.fromkeys(key[:2] for key in joint))
    logs = {key: np.log(values) for key, values in joint.items()}
    suites = {n: np.mean([logs[(*cell, n)] for cell in cells], axis=0) for n in names}
    first = min(suites, key=lambda n: float(suites[n].mean()))
    whole = mean_and_error(np.exp(suites[name] - suites[first]).tolist())
    worst = (-math.inf, math.nan, "")
    for cell in cells:
        best = min(names, key=lambda n, cell=cell: float(logs[(*cell, n)].mean()))
        ratio, error = mean_and_error(np.exp(logs[(*cell, name)] - logs[(*cell, best)]).tolist())
        worst = max(worst, (ratio, error, f"{cell[1]}, {cell[0]}"))
    return (*whole, *worst)


def suite_table(rows: list[dict[str, object]]) -> Grid:
    """Return geometric means over the suite, and how far each filter is from the best (`behind`)."""
    joint, out = by_seed(rows), []
    for name in filter_names():
        own = [r for r in rows if r["filter"] == name and r["manoeuvre"] in SUITE]
        means = [
            "/".join(
                f"{geometric([float(r[key]) for r in own if r['radar'] == cell]):.3f}"
                for key in ("position_m", "velocity_mps")
            )
            for cell in CELLS
        ]
        whole, whole_error, worst, worst_error, where = behind(joint, name)
        lost_here = sum(int(r["lost"]) for r in rows if r["filter"] == name)
        far = f"{worst:.2f} +- {worst_error:.2f}"
        out.append((name, *means, f"{whole:.3f} +- {whole_error:.3f}", far, where, str(lost_here)))
    return Grid(("filter", *CELLS, "of the best", "worst", "where", "lost"), tuple(out))


def geometric(values: list[float]) -> float:
    return float(np.exp(np.mean(np.log(values))))


def paired(
    makers: dict[str, Callable], reference: str, run: Callable[[Callable, int], Errors], seeds: range
) -> list[dict[str, object]]:
    """Return the errors of each filter, averaged over the seeds, and its ratios to the reference."""
    table = {name: [dataclasses.asdict(run(make, seed)) for seed in seeds] for name, make in makers.items()}
    means = {
        name: {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
        for name, rows in table.items()
    }
    ratios = ("position_m", "velocity_mps", "ahead_m", "ahead_mps")
    return [
        {"filter": name, **mean, **{f"{key}_ratio": mean[key] / means[reference][key] for key in ratios}}
        for name, mean in means.items()
    ]


def traffic_rows(runs: int, seeds: range) -> list[dict[str, object]]:
    rows = []
    for accel_std, radar, defects, louder in TRAFFIC:
        true = dataclasses.replace(radar.times(louder), **defects)
        space = plane(accel_std, doppler=radar.velocity_std_mps is not None)
        label = {
            "accel_std_mps2": accel_std, "doppler": radar.velocity_std_mps is not None,
            "defects": bool(defects), "louder": louder,
        }  # fmt: skip
        found = paired(
            UNSCENTED_PRINTED if accel_std == 1.0 else UNSCENTED,
            "ukf",
            lambda make, seed, space=space, true=true, radar=radar: fly(make(space), true, radar, seed, runs),
            seeds,
        )
        rows += [label | row for row in found]
        print(f"traffic: {label}", flush=True)
    return rows


def following_rows(runs: int, seeds: range) -> list[dict[str, object]]:
    rows = []
    for accel_std, radar, assumed, brake in FOLLOWING:
        doppler = radar.velocity_std_mps is not None
        space, known = plane(accel_std, doppler=doppler), radar.times(assumed)
        label = {
            "accel_std_mps2": accel_std, "doppler": doppler, "assumed": assumed, "brake_mps2": brake,
        }  # fmt: skip
        found = paired(
            CUBATURE_PRINTED if brake > 0.0 else CUBATURE,
            "srckf",
            lambda make, seed, space=space, radar=radar, known=known, brake=brake: follow(
                make(space), radar, known, seed, runs, brake_mps2=brake
            ),
            seeds,
        )
        rows += [label | row for row in found]
        print(f"following: {label}", flush=True)
    return rows


def level_rows(runs: int) -> list[dict[str, object]]:
    """Return the estimated scales of R before each change of the true ones."""
    chosen = isrckf(SageHusaParameters(), plane(1.0, doppler=True))
    levels = estimated_levels(chosen, CAR_DOPPLER, 41, runs)
    return [
        {"true": true, "range": row[0], "azimuth": row[1], "range_rate": row[2]}
        for true, row in zip(NOISE_LEVELS, levels.tolist(), strict=True)
    ]


def braking_rows() -> list[dict[str, object]]:
    """Return how many of 200 vehicles each filter loses under 9 m/s^2, with defects."""
    rows = []
    for cell in ("range, azimuth, defects", "Doppler, defects"):
        noise = CELLS[cell]
        truth = np.repeat(braking(9.0)[:, None], 200, axis=1)
        z = measure(truth, noise, np.random.default_rng(51))
        for name in filter_names():
            runs = run_filter(make_filter(name, POINT_FILTERS), z, noise.covariance(), PERIOD_S)
            position_m, velocity_mps = position_and_velocity_rmse(runs, truth, AFTER)
            rows.append({
                "radar": cell, "filter": name, "lost": int(lost(runs, truth).sum()), "of": 200,
                "position_m": position_m, "velocity_mps": velocity_mps,
            })  # fmt: skip
    print("braking", flush=True)
    return rows


def hostile_rows(scans: int) -> list[dict[str, object]]:
    rows = []
    for name in filter_names():
        found = endure(make_filter(name), scans, 61)
        rows.append({"filter": name, **dataclasses.asdict(found), "sound": found.sound})
        print(f"hostile: {name}", flush=True)
    return rows


def print_table(rows: list[dict[str, object]]) -> None:
    heads = tuple(rows[0])
    cells = tuple(tuple(f"{v:.3g}" if isinstance(v, float) else str(v) for v in row.values()) for row in rows)
    print(markdown(Grid(heads, cells)))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--part", default="suite,traffic,following,hostile,braking")
    parser.add_argument("--runs", type=int, default=30)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--scans", type=int, default=100_000)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    seeds = range(100, 100 + options.seeds)
    parts: dict[str, Callable[[], list[dict[str, object]]]] = {
        "suite": lambda: suite(options.runs, seeds),
        "traffic": lambda: traffic_rows(options.runs, seeds),
        "following": lambda: following_rows(options.runs, seeds),
        "levels": lambda: level_rows(options.runs),
        "hostile": lambda: hostile_rows(options.scans),
        "braking": braking_rows,
    }
    wanted = set(options.part.split(","))
    wanted |= {"levels"} if "following" in wanted else set()
    found: dict[str, list[dict[str, object]]] = {}
    for name, make in parts.items():
        if name not in wanted:
            continue
        found[name] = make()
        print(f"\n## {name}\n")
        if name == "suite":
            print(markdown(suite_table(found[name])), flush=True)
        else:
            print_table(found[name])
        if options.json:  # after each part: all of them take a while
            content = {"runs": options.runs, "seeds": list(seeds), **found}
            options.json.write_text(json.dumps(content, indent=1, default=float) + "\n")


if __name__ == "__main__":
    main()
