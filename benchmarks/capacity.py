"""Raise the number of sensors until a real service no longer keeps its bars; print where the time goes.

    python benchmarks/capacity.py [--from 6] [--to 30] [--step 2] [--minutes 0.5] [--points 140]
        [--trackers N] [--json OUT.json]

Each step is a run of benchmarks/soak.py with that many sensors of 20 Hz and 30 vehicles, everything stored. A
number of sensors is carried when nothing is lost or doubled, the tracker ends less than a second behind, and
p95 and p99 of posted-to-readable stay within 100 and 200 ms.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.soak import BARS, soak

FALLS_BEHIND_S = 1.0


def carried(found: dict[str, object]) -> bool:
    return (
        found["lost"] == found["doubled"] == 0
        and found["drained_s"] < FALLS_BEHIND_S
        and found.get("readable_p95_ms", 1e9) <= BARS["readable_p95_ms"]
        and found.get("readable_p99_ms", 1e9) <= BARS["readable_p99_ms"]
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--from", dest="first", type=int, default=6)
    parser.add_argument("--to", dest="last", type=int, default=30)
    parser.add_argument("--step", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=0.5)
    parser.add_argument("--rate", type=float, default=20.0)
    parser.add_argument("--vehicles", type=int, default=30)
    parser.add_argument("--points", type=int, default=140)
    parser.add_argument("--trackers", type=int)
    parser.add_argument("--warm", type=float, default=15.0)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    runs, most = [], 0
    for sensors in range(options.first, options.last + 1, options.step):
        options.sensors = sensors
        found = soak(options)
        found.pop("minutes_one_by_one")
        runs.append(found)
        kept = carried(found)
        cores = found["cores"]
        print(
            f"{sensors} sensors: p95 {found.get('readable_p95_ms')} ms, "
            f"p99 {found.get('readable_p99_ms')} ms, "
            f"drained in {found['drained_s']} s; cores: {cores}; "
            f"mean ms since receipt: {found['mean_ms_since_receipt']}; "
            f"{'carried' if kept else 'not carried'}",
            flush=True,
        )
        if not kept:
            break
        most = sensors
    print(f"carried: {most} sensors")
    if options.json:
        options.json.write_text(json.dumps({"carried": most, "runs": runs}, indent=1) + "\n")


if __name__ == "__main__":
    main()
