"""Track recorded scenes that have truth and print how well that went, one row a scene, beside other trackers.

    python -m benchmarks.scenes SCENE_DIR... [--jobs N] [--until S] [--profile NAME] [--set key=value]...
        [--json OUT.json] [--columns hota,gospa,...] [--tracks-dir DIR] [--peers]

What `wayside evaluate --card` does for a page, this does for a terminal, with the best of other trackers.
Every scene runs in its own process. The time is CPU time of the tracker's steps, without the first second.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is imported: one process a scene, one thread a process
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np  # noqa: E402

from service.evaluation import report  # noqa: E402
from service.evaluation.measures import MEASURES, SPEED, Measure, Value, select  # noqa: E402
from service.evaluation.scene_runs import Job, run_all  # noqa: E402

COLUMNS = (
    "hota,gospa,gospa_missed,gospa_false,id_switches,switches_per_100,false_tracks_per_min,count_recall,"
    "count_precision,latency_median_s,latency_p90_s,pos_rmse_m,lateral_rmse_m,vel_rmse_mps"
)
PEERS = Path(__file__).with_name("peers.json")
PEERS_LEAST_S = 20.0  # shorter runs miss most of the first vehicles' lives


def mean_row(results: list[dict[str, Value]]) -> dict[str, Value]:
    """Return the mean over the scenes of every number that is known in all of them."""
    keys = [k for k, v in results[0].items() if isinstance(v, int | float)]
    return {"scene": "mean", **{k: float(np.mean([result[k] for result in results])) for k in keys}}


def with_peers(results: list[dict[str, Value]], measures: tuple[Measure, ...]) -> list[dict[str, Value]]:
    """Return each result followed by the best that any other tracker reached, measure by measure."""
    peers = [p for p in json.loads(PEERS.read_text())["results"] if p["until_s"] >= PEERS_LEAST_S]
    out = []
    for result in results:
        here = [peer for peer in peers if peer["scene"] == result["scene"]]
        best = {
            m.key: (max if m.higher_is_better else min)(peer[m.key] for peer in here)
            for m in measures
            if here and m.key in here[0]
        }
        seconds = sorted({f"{peer['until_s']:g}" for peer in here})
        out += [result, {"scene": f"  best peer, {' or '.join(seconds)} s", **best}]
    return out


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="+", type=Path, metavar="SCENE_DIR")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--until", type=float, help="only the first so many seconds")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="settings")
    parser.add_argument("--profile", help="fast, default or quality")
    parser.add_argument("--json", type=Path, help="write all scores here")
    parser.add_argument("--columns", default=COLUMNS, help="keys of the scores to print, or 'all'")
    parser.add_argument("--tracks-dir", type=Path, help="write SCENE/tracks.jsonl below this directory")
    parser.add_argument(
        "--peers", action="store_true", help="add the best of other trackers (run with --until 30)"
    )
    options = parser.parse_args()
    settings = tuple(options.settings)
    jobs = [
        Job(d, settings=settings, until_s=options.until, keep=options.tracks_dir, profile=options.profile)
        for d in options.scenes
    ]
    results = list(run_all(jobs, options.jobs))
    measures = MEASURES if options.columns == "all" else select(options.columns.split(","))
    shown = with_peers(results, measures) if options.peers else [*results]
    if len(results) > 1:
        shown.append(mean_row(results))
    grid = (
        report.by_measure(shown) if options.columns == "all" else report.by_scene(shown, (*measures, *SPEED))
    )
    print(report.markdown(grid), end="")
    if options.json:
        options.json.write_text(report.to_json(results))


if __name__ == "__main__":
    main()
