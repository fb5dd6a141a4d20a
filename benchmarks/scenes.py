"""Track recorded scenes that have truth and print how well that went, one row a scene.

    python benchmarks/scenes.py SCENE_DIR... [--jobs N] [--until S] [--set key=value]... [--json OUT.json]
        [--columns hota,gospa,...] [--tracks-dir DIR] [--profile] [--peers]

Every scene runs in its own process. The time is CPU time of the tracker's steps alone, without the
first second.
"""

from __future__ import annotations

import argparse
import cProfile
import io
import json
import multiprocessing
import os
import pstats
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is imported: one process a scene, one thread a process
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np  # noqa: E402

from service.evaluation import report  # noqa: E402
from service.evaluation.measures import MEASURES, Measure, Value, select  # noqa: E402
from service.evaluation.recorded import RecordedTracks, State, TrackId, record  # noqa: E402
from service.evaluation.scores import score  # noqa: E402
from service.evaluation.truth import Scene, read_scene  # noqa: E402
from service.formats.json_frames import read_frames  # noqa: E402
from service.formats.tracks import frame_line  # noqa: E402
from service.tracking import tracker  # noqa: E402
from service.tracking.parameters import TrackerParameters  # noqa: E402

COLUMNS = (
    "hota,gospa,gospa_missed,gospa_false,id_switches,switches_per_100,false_tracks_per_min,count_recall,"
    "count_precision,latency_median_s,latency_p90_s,pos_rmse_m,lateral_rmse_m,vel_rmse_mps"
)
SPEED = (
    Measure("ms_per_frame", "CPU ms per frame", "ms"),
    Measure("ms_p99", "CPU ms, 99th percentile", "ms99"),
)
PROFILE_LINES = 25
PEERS = Path(__file__).with_name("peers.json")
PEERS_LEAST_S = 20.0  # shorter runs miss most of the first vehicles' lives


@dataclass(frozen=True)
class Job:
    directory: Path
    settings: tuple[str, ...]
    until: float | None
    tracks_dir: Path | None
    profile: bool


def run(job: Job) -> dict[str, Value]:
    scene = read_scene(job.directory)
    if job.until is not None:
        scene = scene.until(job.until)
    profiler = cProfile.Profile()
    if job.profile:
        profiler.enable()
    tracks, cpu_s = track(job, scene)
    profiler.disable()
    if job.profile:
        text = io.StringIO()
        pstats.Stats(profiler, stream=text).sort_stats("tottime").print_stats(PROFILE_LINES)
        print(f"{scene.name}\n{text.getvalue()}", flush=True)
    settled = cpu_s[int(scene.site.rate_hz) :] or cpu_s
    speed = {"ms_per_frame": 1e3 * float(np.mean(settled)), "ms_p99": 1e3 * float(np.percentile(settled, 99))}
    return {**score(scene, tracks), **speed, "parameters": parameters_of(job, scene).digest()}


def parameters_of(job: Job, scene: Scene) -> TrackerParameters:
    parameters = scene.site.tracker_parameters()
    for setting in job.settings:
        key, _, text = setting.partition("=")
        parameters = parameters.with_setting(key, text)
    return parameters


def track(job: Job, scene: Scene) -> tuple[RecordedTracks, list[float]]:
    """Return the tracks of the scene's frames and the CPU seconds of each step."""
    parameters = parameters_of(job, scene)
    state = tracker.initial_state(parameters)
    number = {int(n): k for k, n in enumerate(scene.number)}
    frames: list[dict[TrackId, State]] = [{} for _ in number]
    lines, cpu_s = [], []
    source = read_frames([next(job.directory.glob("frames.jsonl*"))], scene.site)
    for frame in takewhile(lambda f: f.sequence in number, source):
        begin = time.process_time()
        state, estimates, _ = tracker.step(state, frame, parameters)
        cpu_s.append(time.process_time() - begin)
        columns = (estimates.x_m, estimates.y_m, estimates.vx_mps, estimates.vy_mps)
        states = zip(*(np.asarray(c, dtype=np.float64).tolist() for c in columns), strict=True)
        frames[number[frame.sequence]] = dict(zip(estimates.number.tolist(), states, strict=True))
        if job.tracks_dir is not None:
            lines.append(
                frame_line(scene.site.sensor_id, 1, frame.sequence, frame.time_us, estimates) + b"\n"
            )
    if job.tracks_dir is not None:
        out = job.tracks_dir / scene.name
        out.mkdir(parents=True, exist_ok=True)
        (out / "tracks.jsonl").write_bytes(b"".join(lines))
    return record(frames), cpu_s


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
    parser.add_argument("--json", type=Path, help="write all scores here")
    parser.add_argument("--columns", default=COLUMNS, help="keys of the scores to print, or 'all'")
    parser.add_argument("--tracks-dir", type=Path, help="write SCENE/tracks.jsonl below this directory")
    parser.add_argument("--profile", action="store_true", help="print where the time goes")
    parser.add_argument(
        "--peers", action="store_true", help="add the best of other trackers (run with --until 30)"
    )
    options = parser.parse_args()
    settings = tuple(options.settings)
    jobs = [Job(d, settings, options.until, options.tracks_dir, options.profile) for d in options.scenes]
    if options.jobs == 1 or len(jobs) == 1:
        results = [run(job) for job in jobs]
    else:
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(min(options.jobs, len(jobs)), mp_context=context) as pool:
            results = list(pool.map(run, jobs))
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
