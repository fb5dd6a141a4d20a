"""Count simulated traffic with the tracker in the loop and hold every figure against exact truth.

    python benchmarks/counts.py [--scenarios A,B] [--seeds 1,2] [--duration S] [--keep DIR] [--json OUT]

Each scenario is simulated, tracked and counted twice: with all frames, and with stretches of 2 to 12 s
without any. Lanes are given, so that what is measured is counting, not the learning of lanes. Reported: the
error of volumes by direction and by lane, of crossing times and speeds, of Edie's measures by cell, and how
often the 95 % interval of a minute's volume holds the true one. With --keep the tracks are kept in a folder
and used again.
"""

from __future__ import annotations

import argparse
import json
import os
import pickle
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np  # noqa: E402
from scipy.optimize import linear_sum_assignment  # noqa: E402

from service.evaluation.polyline import feet  # noqa: E402
from service.formats.sensor import SensorConfig  # noqa: E402
from service.simulation.frames import SimulatedFrame  # noqa: E402
from service.simulation.road_truth import crossings, lane_truth, paths_of  # noqa: E402
from service.simulation.scenario import START_US, Scenario, scenario_named, simulate  # noqa: E402
from service.simulation.scene_files import site  # noqa: E402
from service.tracking import tracker  # noqa: E402
from service.tracking.model import Frame, TrackEstimates  # noqa: E402
from service.traffic import count_intervals  # noqa: E402
from service.traffic.cells import CELL, along  # noqa: E402
from service.traffic.count_intervals import Confidence  # noqa: E402
from service.traffic.counting import count, nothing_counted  # noqa: E402
from service.traffic.measured import measured_of  # noqa: E402
from service.traffic.model import Lane, LaneMap, Moment  # noqa: E402
from service.traffic.parameters import traffic_setup  # noqa: E402
from service.traffic.records import MINUTE_US, Crossing  # noqa: E402

SCENARIOS = "motorway,dense,two_way,curve,wide,queue"
GAP_EVERY_S, GAP_S = 30.0, (2.0, 12.0)
WARM_S, TAIL_S = (
    5.0,
    0.5,
)  # at the ends of a recording nothing is compared: vehicles already there, or not over yet
NEAR_S = 1.0  # a found crossing this near in time may be a true one
WRONG_LANE_S = 0.5  # of cost
CELL_RANGE_M = (30.0, 120.0)  # of the cells that are compared
LEAST_CELL_S = 20.0  # of vehicle time in a cell and recording, below which a share of error means nothing


@dataclass
class Run:
    """One recording, tracked."""

    name: str
    gaps: bool
    config: SensorConfig
    lanes: LaneMap
    duration_s: float
    truth: list[dict]
    true_cells: dict[tuple[int, int], tuple[float, float]]
    tracks: list[tuple[int, int, TrackEstimates, bool]]


@dataclass
class Counted:
    """What was counted in one recording."""

    run: Run
    crossings: list[Crossing]
    minutes: dict[int, tuple[int, int]]  # frames, observed microseconds
    cells: dict[tuple[int, int], tuple[float, float]]


def lane_map(scenario: Scenario) -> LaneMap:
    lanes = []
    for k, row in enumerate(lane_truth(scenario.road, scenario.radar.azimuth_max_rad), start=1):
        points = np.array(row["points"])
        lanes.append(
            Lane(k, str(row["lane_id"]), "lane", row["direction"], points, np.full(len(points), 3.5), 1.0, 99)
        )
    return LaneMap(1, START_US, 0, 99, "user", tuple(lanes))


def with_gaps(frames: list[SimulatedFrame], seed: int, *, gaps: bool) -> Iterator[Frame]:
    rng = np.random.default_rng(seed)
    begin_s, end_s = np.inf, -np.inf
    next_s = rng.uniform(10, GAP_EVERY_S)
    for simulated in frames:
        time_s = (simulated.frame.time_us - START_US) / 1e6
        if gaps and time_s >= next_s:
            begin_s, end_s = time_s, time_s + rng.uniform(*GAP_S)
            next_s = end_s + rng.uniform(10, GAP_EVERY_S)
        if not begin_s <= time_s < end_s:
            yield simulated.frame


def track(frames: Iterator[Frame], config: SensorConfig) -> Iterator[tuple[int, int, TrackEstimates, bool]]:
    """Yield time, number and tracks of each frame, and of the ticks of a gap, as the fold has them."""
    parameters = config.tracker_parameters()
    state, last_us, number = tracker.initial_state(parameters), None, 0
    for number, frame in enumerate(frames):
        while last_us is not None and frame.time_us - last_us > 1_000_000:
            last_us += 1_000_000
            if last_us < frame.time_us and not state.idle:
                state, estimates, _ = tracker.coast(state, last_us, parameters)
                yield last_us, number, estimates, True
        state, estimates, _ = tracker.step(state, frame, parameters)
        yield frame.time_us, number, estimates, False
        last_us = frame.time_us
    for k in range(1, 5):
        state, estimates, _ = tracker.coast(state, last_us + k * 1_000_000, parameters)
        yield last_us + k * 1_000_000, number, estimates, True


def true_cells(lanes: LaneMap, frames: list[SimulatedFrame], cell_m: float) -> dict:
    """Metres and seconds by lane and cell, frame by frame: a vehicle is where it is for one period."""
    out: dict[tuple[int, int], list[float]] = defaultdict(lambda: [0.0, 0.0])
    for before, after in pairwise(frames):
        seconds = (after.frame.time_us - before.frame.time_us) / 1e6
        v = before.vehicles
        speed = np.hypot(v.vx_mps, v.vy_mps)
        for k, lane in enumerate(lanes.lanes):
            mine = v.lane == k
            if mine.any():
                place = along(lane.points_m, v.x_m[mine], v.y_m[mine]) + speed[mine] * seconds / 2
                for cell, metres in zip((place // cell_m).astype(int), speed[mine] * seconds, strict=True):
                    out[lane.index, int(cell)][0] += metres
                    out[lane.index, int(cell)][1] += seconds
    return {key: (a, b) for key, (a, b) in out.items()}


def make(name: str, seed: int, duration_s: float, *, gaps: bool) -> Run:
    scenario = scenario_named(name)
    frames = list(simulate(scenario, seed=seed, duration_s=duration_s))
    config = SensorConfig.model_validate(site(scenario, duration_s))
    lanes = lane_map(scenario)
    return Run(
        name=name,
        gaps=gaps,
        config=config,
        lanes=lanes,
        duration_s=duration_s,
        truth=crossings(scenario.road, paths_of(frames, START_US), START_US),
        true_cells=true_cells(lanes, frames, traffic_setup(config).parameters.counting.cell_m),
        tracks=list(track(with_gaps(frames, seed, gaps=gaps), config)),
    )


def assign(estimates: TrackEstimates, lanes: LaneMap) -> None:
    """Put each track into the nearest lane."""
    if not len(estimates):
        return
    at = np.stack([estimates.x_m, estimates.y_m], axis=1).astype(np.float64)
    away = np.stack([feet(lane.points_m, at).distance_m for lane in lanes.lanes])
    estimates.lane[:] = np.array([lane.index for lane in lanes.lanes])[np.argmin(away, axis=0)]


def tally(run: Run) -> Counted:
    setup, state = traffic_setup(run.config), nothing_counted()
    found: list[Crossing] = []
    minutes: dict[int, tuple[int, int]] = {}
    cells: dict[int, np.ndarray] = {}
    for time_us, number, estimates, tick in run.tracks:
        assign(estimates, run.lanes)
        state, counts = count(
            state, Moment(time_us, number, tick), estimates, measured_of(estimates), run.lanes, setup
        )
        found += counts.crossings
        minutes |= {part.minute: (part.frames, part.observed_us) for part in counts.received}
        cells |= {part.minute: part.records.reshape(-1).view(CELL) for part in counts.cells}
    sums: dict[tuple[int, int], list[float]] = defaultdict(lambda: [0.0, 0.0])
    for table in cells.values():
        for row in table:
            sums[int(row["lane"]), int(row["cell"])][0] += float(row["distance_m"])
            sums[int(row["lane"]), int(row["cell"])][1] += float(row["time_s"])
    return Counted(run, found, minutes, {key: (a, b) for key, (a, b) in sums.items()})


def lane_name(counted: Counted, crossing: Crossing) -> str:
    lane = counted.run.lanes.lane(crossing.lane)
    return "" if lane is None else lane.lane_id


def volumes(results: list[Counted]) -> dict[str, float]:
    """Pooled error of the volumes, by direction and by lane of a line and recording."""
    true, net, by_lane = 0, 0, 0
    lines: dict[str, list[int]] = defaultdict(lambda: [0, 0])
    for c in results:
        direction = {lane.lane_id: lane.direction for lane in c.run.lanes.lanes}
        balance, lanes = Counter(), Counter()
        for row in c.run.truth:
            if WARM_S <= row["t"] <= c.run.duration_s - TAIL_S:
                true += 1
                lines[row["line_id"]][0] += 1
                balance[row["line_id"], direction[row["lane_id"]]] -= 1
                lanes[row["line_id"], row["lane_id"]] -= 1
        for crossing in c.crossings:
            if WARM_S <= (crossing.time_us - START_US) / 1e6 <= c.run.duration_s - TAIL_S:
                name = lane_name(c, crossing)
                balance[crossing.line_id, direction[name]] += 1
                lanes[crossing.line_id, name] += 1
        net += sum(balance.values())
        for (line, _), value in balance.items():
            lines[line][1] += value
        by_lane += sum(abs(value) for value in lanes.values())
    out = {
        "crossings_true": true,
        "net_volume_error": net / max(true, 1),
        "lane_volume_error": by_lane / max(true, 1),
    }
    return out | {f"net_volume_error_{line}": sums[1] / sums[0] for line, sums in sorted(lines.items())}


def events(results: list[Counted]) -> dict[str, float]:
    """Recall, precision, time and speed of single crossings."""
    true = hits = found = right = 0
    late, speed = [], []
    for c in results:
        for line in {row["line_id"] for row in c.run.truth}:
            a = [
                r
                for r in c.run.truth
                if r["line_id"] == line and WARM_S <= r["t"] <= c.run.duration_s - TAIL_S
            ]
            b = [x for x in c.crossings if x.line_id == line]
            times = np.array([(x.time_us - START_US) / 1e6 for x in b])
            inside = (times >= WARM_S) & (times <= c.run.duration_s - TAIL_S)
            true += len(a)
            if not a or not b:
                found += int(inside.sum())
                continue
            apart = np.abs(np.array([r["t"] for r in a])[:, None] - times)
            wrong = np.array([[r["lane_id"] != lane_name(c, x) for x in b] for r in a])
            cost = np.where(apart <= NEAR_S, apart + WRONG_LANE_S * wrong, 100.0)
            for i, j in zip(*linear_sum_assignment(cost), strict=True):
                if cost[i, j] < 100.0:
                    hits, inside[j] = hits + 1, True  # one near the end may be of a true one within
                    right += not wrong[i, j]
                    late.append(times[j] - a[i]["t"])
                    speed.append(abs(b[j].speed_mps - a[i]["speed_mps"]))
            found += int(inside.sum())
    return {
        "recall": hits / max(true, 1),
        "precision": hits / max(found, 1),
        "lane_right": right / max(hits, 1),
        "time_bias_s": float(np.mean(late)),
        "time_sd_s": float(np.std(late)),
        "speed_mae_mps": float(np.mean(speed)),
    }


def edie(results: list[Counted]) -> dict[str, float]:
    """Error of Edie's flow, density and speed over cells pooled by scenario, weighted by their traffic."""
    pooled: dict[tuple[str, int, int], list[float]] = defaultdict(lambda: [0.0] * 4)
    for c in results:
        if c.run.gaps:
            continue
        cell_m = traffic_setup(c.run.config).parameters.counting.cell_m
        for (lane, cell), (metres, seconds) in c.run.true_cells.items():
            points = c.run.lanes.lanes[lane - 1].points_m
            k = int(np.clip((cell + 0.5) * cell_m / 2.0, 0, len(points) - 1))
            if CELL_RANGE_M[0] <= np.hypot(*points[k]) <= CELL_RANGE_M[1]:
                found = c.cells.get((lane, cell), (0.0, 0.0))
                pooled[c.run.name, lane, cell] = [
                    a + b
                    for a, b in zip(pooled[c.run.name, lane, cell], (metres, seconds, *found), strict=True)
                ]
    table = np.array([row for row in pooled.values() if row[1] >= LEAST_CELL_S])
    metres, seconds, found_m, found_s = table.T
    errors = {
        "q": found_m / metres - 1,
        "k": found_s / seconds - 1,
        "v": (found_m / np.maximum(found_s, 1e-9)) / (metres / seconds) - 1,
    }
    out: dict[str, float] = {"edie_cells": len(table)}
    for name, error in errors.items():
        out[f"edie_{name}_mean"] = float(error.mean())
        out[f"edie_{name}_mean_abs"] = float(np.abs(error).mean())
        out[f"edie_{name}_within_3_percent"] = float(np.mean(np.abs(error) <= 0.03))
    return out


def intervals(results: list[Counted], confidence: Confidence) -> dict[str, float]:
    """How often the interval of a volume (line, lane, minute after the first) holds the true one."""
    rows = []
    for c in results:
        for minute in range(1, int(c.run.duration_s) // 60):
            begin_us = START_US + minute * MINUTE_US
            end_us = min(begin_us + MINUTE_US, START_US + round((c.run.duration_s - TAIL_S) * 1e6))
            share = min(c.minutes.get(begin_us // MINUTE_US, (0, 0))[1] / MINUTE_US, 1.0)
            for line, lane in {(row["line_id"], row["lane_id"]) for row in c.run.truth}:
                true = sum(
                    r["line_id"] == line
                    and r["lane_id"] == lane
                    and begin_us <= START_US + r["t"] * 1e6 < end_us
                    for r in c.run.truth
                )
                mine = [
                    x
                    for x in c.crossings
                    if x.line_id == line and lane_name(c, x) == lane and begin_us <= x.time_us < end_us
                ]
                rows.append((true, *_cell(mine, share)))
    true, n, doubt, observed, density, far, headways, spread = np.array(rows).T
    cells = count_intervals.Counted(
        n.astype(int), doubt, observed, density, far, headways.astype(int), spread
    )
    low, high = count_intervals.volume_bounds(cells, confidence)
    return {
        "interval_cells": len(true),
        "interval_holds": float(np.mean((low <= true) & (true <= high))),
        "interval_too_low": float(np.mean(true > high)),
        "interval_too_high": float(np.mean(true < low)),
        "interval_mean_width": float(np.mean(high - low)),
        "cells_exact": float(np.mean(n == true)),
    }


def _cell(mine: list[Crossing], share: float) -> tuple[float, ...]:
    """Count, doubt, observed share, density a metre, range, headways and their spread of one cell."""
    if not mine:
        return 0.0, 0.0, share, 0.0, 0.0, 0.0, 0.0
    density = sum(1 / x.speed_mps for x in mine) / 60
    far = float(np.mean([np.hypot(x.x_m, x.y_m) for x in mine]))
    known = np.array([x.headway_s for x in mine if not np.isnan(x.headway_s)])
    spread = float(np.sum((known / known.mean() - 1) ** 2)) if len(known) else 0.0
    return len(mine), sum(1 - x.probability for x in mine), share, density, far, len(known), spread


def report(results: list[Counted]) -> dict[str, object]:
    whole = [c for c in results if not c.run.gaps]
    gaps = [c for c in results if c.run.gaps]
    out: dict[str, object] = {"pooled": volumes(whole) | events(whole) | edie(whole)}
    for name in sorted({c.run.name for c in whole}):
        mine = [c for c in whole if c.run.name == name]
        out[name] = volumes(mine) | events(mine) | edie(mine)
    confidence = Confidence()
    out["intervals"] = {
        "all frames": intervals(whole, confidence),
        "with gaps": intervals(gaps, confidence) if gaps else {},
        "together": intervals(results, confidence),
    }
    return out


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenarios", default=SCENARIOS)
    parser.add_argument("--seeds", default="1,2")
    parser.add_argument("--duration", type=float, default=180.0)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    results = []
    for seed in map(int, given.seeds.split(",")):
        for name in given.scenarios.split(","):
            for gaps in (False, True):
                kept = given.keep and given.keep / f"{name}-{seed}-{gaps}.pickle"
                if kept and kept.exists():
                    run = pickle.loads(kept.read_bytes())  # noqa: S301 - written by this program
                else:
                    run = make(name, seed, given.duration, gaps=gaps)
                    if kept:
                        kept.parent.mkdir(parents=True, exist_ok=True)
                        kept.write_bytes(pickle.dumps(run))
                results.append(tally(run))
                print(name, seed, gaps, len(results[-1].crossings), file=sys.stderr, flush=True)
    record = {"seeds": given.seeds, "duration_s": given.duration, "scenarios": given.scenarios}
    text = json.dumps(record | report(results), indent=1)
    print(text)
    if given.json:
        given.json.write_text(text + "\n")


if __name__ == "__main__":
    main()
