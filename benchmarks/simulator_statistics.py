"""Compare the simulated radar with recorded scenes: points for each vehicle and runs of misses, by range.

    python benchmarks/simulator_statistics.py SCENES_DIR [--seeds 1] [--json FILE]

The true vehicles of every scene directory in SCENES_DIR are put before our radar; each number is that of the
scene's own detections, ours, and their ratio.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import platform
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from benchmarks.commit import commit
from service.simulation.scene_replay import compare_scene, join
from service.simulation.statistics import (
    RANGE_EDGES_M,
    RUN_LONGER_THAN,
    RangeStatistics,
    Share,
    Sightings,
    range_statistics,
)
from service.simulation.vehicles import VehicleKind

AZIMUTH_MAX_RAD = math.radians(45.0)
GROUPS = {
    "car": (VehicleKind.CAR,),
    "truck and bus": (VehicleKind.TRUCK, VehicleKind.BUS),
    "motorcycle": (VehicleKind.MOTORCYCLE,),
    "all": tuple(VehicleKind),
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", type=Path)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    recorded, simulated = [], []
    for directory in sorted(p for p in args.scenes.iterdir() if (p / "labels.jsonl.gz").exists()):
        for seed in range(args.seeds):
            theirs, ours = compare_scene(directory, seed=seed)
            simulated.append(ours)
            recorded += [theirs] if seed == 0 else []
        print_scene(directory.name, recorded[-1], simulated[-args.seeds :])
    tables = {
        name: compare_groups(recorded, simulated, [int(k) for k in kinds]) for name, kinds in GROUPS.items()
    }
    for name, table in tables.items():
        print_table(name, table)
    if args.json:
        result = circumstances() | {"seeds": args.seeds, "edges_m": RANGE_EDGES_M.tolist(), "tables": tables}
        args.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


def circumstances() -> dict[str, object]:
    """Return what the numbers depend on."""
    return {
        "machine": {"architecture": platform.machine(), "python": platform.python_version()},
        "commit": commit(),
    }


def compare_groups(
    recorded: list[Sightings], simulated: list[Sightings], kinds: list[int]
) -> list[dict[str, object]]:
    theirs, ours = (
        range_statistics(rows.take(np.isin(rows.kind, kinds)).in_view(AZIMUTH_MAX_RAD))
        for rows in (join(recorded, same_vehicles=False), join(simulated, same_vehicles=False))
    )
    return [
        {
            "what": what,
            "count": a.count.tolist(),
            "recorded": rounded(a.value),
            "recorded_std_error": rounded(a.std_error),
            "simulated": rounded(b.value),
            "ratio": rounded(b.value / np.where(a.value == 0, np.nan, a.value)),
        }
        for (what, a), (_, b) in zip(named(theirs), named(ours), strict=True)
    ]


def named(s: RangeStatistics) -> list[tuple[str, Share]]:
    longer = [(f"runs longer than {n} frames", q) for n, q in zip(RUN_LONGER_THAN, s.run_longer, strict=True)]
    return [("points", s.points), ("seen", s.seen), ("miss run, frames", s.run), *longer]


def rounded(values: np.ndarray) -> list[float | None]:
    return [None if math.isnan(v) else round(v, 3) for v in values.tolist()]


def print_scene(name: str, theirs: Sightings, ours: list[Sightings]) -> None:
    a = range_statistics(theirs.in_view(AZIMUTH_MAX_RAD)).points.value
    b = range_statistics(join(ours, same_vehicles=False).in_view(AZIMUTH_MAX_RAD)).points.value
    print(f"{name:14} points, ours / recorded: " + " ".join(f"{r:5.2f}" for r in b / a), flush=True)


def print_table(name: str, table: list[dict[str, object]]) -> None:
    bins = [f"{a:.0f}-{b:.0f} m" for a, b in itertools.pairwise(RANGE_EDGES_M)]
    print(f"\n{name:28}" + "".join(f"{b:>24}" for b in bins))
    for row in table:
        columns = (row["recorded"], row["simulated"], row["ratio"], row["count"])
        cells = zip(*columns, strict=True)  # type: ignore[call-overload]
        print(f"  {row['what']:26}" + "".join(f"{cell_text(*cell):>24}" for cell in cells))


def cell_text(recorded: float | None, simulated: float | None, ratio: float | None, count: int) -> str:
    texts = ["-" if v is None else f"{v:.2f}" for v in (recorded, simulated, ratio)]
    return f"{texts[0]} {texts[1]} ({texts[2]}) n{count}"


if __name__ == "__main__":
    main()
