"""Track recorded scenes that have truth, each in a process of its own, and score what was found."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

import numpy as np

from service.errors import InvalidInput
from service.evaluation import scores
from service.evaluation.measures import Value
from service.evaluation.recorded import RecordedTracks, SizedState, TrackId, record
from service.evaluation.truth import Scene, read_scene
from service.formats.json_frames import read_frames
from service.formats.sensor import SensorConfig
from service.formats.tracks import frame_line
from service.tracking import tracker
from service.tracking.model import Frame, TrackEstimates
from service.tracking.parameters import TrackerParameters

Result = dict[str, Value]


@dataclass(frozen=True, slots=True)
class Job:
    """One scene to be scored, and how."""

    scene: Path  # directory with frames.jsonl, site.json and truth
    tracks: Path | None = None  # directory with tracks.jsonl; None: the tracker is run
    filter: str | None = None
    settings: tuple[str, ...] = ()  # KEY=VALUE
    until_s: float | None = None
    keep: Path | None = None  # directory for SCENE/tracks.jsonl of what the tracker found
    profile: str | None = None  # None: the site's own


def run_all(jobs: Sequence[Job], processes: int = 1) -> Iterator[Result]:
    """Yield the scores of each job, in their order."""
    if processes == 1 or len(jobs) == 1:
        yield from map(run, jobs)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(processes, len(jobs)), mp_context=context) as pool:
        yield from pool.map(run, jobs)


def run(job: Job) -> Result:
    """Return the scores of one scene, with the CPU time of a step where the tracker was run.

    Raises InvalidInput when the scene has no truth or no frames, or a setting is wrong.
    """
    if job.tracks is not None:
        return scores.evaluate(job.tracks, job.scene, until=job.until_s)
    scene = read_scene(job.scene)
    if job.until_s is not None:
        scene = scene.until(job.until_s)
    parameters = configured(scene.site, job).tracker_parameters()
    tracks, cpu_s = _track(job, scene, parameters)
    settled = cpu_s[int(scene.site.rate_hz) :] or cpu_s
    return {
        **scores.score(scene, tracks),
        "ms_per_frame": 1e3 * float(np.mean(settled)),
        "ms_p99": 1e3 * float(np.percentile(settled, 99)),
        "parameters": _digest(scene.site, job),
    }


def _digest(site: SensorConfig, job: Job) -> str:
    """Return the digest of the job's configuration for a sensor like any other, so that scenes have one."""
    anywhere = SensorConfig(profile=site.profile, filter=site.filter, parameters=site.parameters)
    return configured(anywhere, job).tracker_parameters().digest()


def configured(site: SensorConfig, job: Job) -> SensorConfig:
    """Return the sensor with the job's profile, filter and settings on top."""
    chosen = dict(setting.split("=", 1) for setting in job.settings)
    changes: dict[str, object] = {"parameters": site.parameters | chosen}
    chosen_names = {"filter": job.filter, "profile": job.profile}
    changes |= {name: value for name, value in chosen_names.items() if value is not None}
    return site.model_copy(update=changes)


def _track(job: Job, scene: Scene, parameters: TrackerParameters) -> tuple[RecordedTracks, list[float]]:
    """Return the tracks of the scene's frames and the CPU seconds of each step."""
    number = {int(n): k for k, n in enumerate(scene.number)}
    frames: list[dict[TrackId, SizedState]] = [{} for _ in number]
    lines: list[bytes] = []
    state, cpu_s = tracker.initial_state(parameters), []
    for frame in takewhile(lambda f: f.sequence in number, _frames_of(job.scene, scene.site)):
        begin = time.process_time()
        state, estimates, _ = tracker.step(state, frame, parameters)
        cpu_s.append(time.process_time() - begin)
        if frame.sequence is not None:
            frames[number[frame.sequence]] = states_of(estimates)
            if job.keep is not None:
                lines.append(frame_line(frame.sensor_id, 1, frame.sequence, frame.time_us, estimates))
    if job.keep is not None:
        folder = job.keep / scene.name
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "tracks.jsonl").write_bytes(b"".join(line + b"\n" for line in lines))
    return record(frames), cpu_s


def states_of(estimates: TrackEstimates) -> dict[TrackId, SizedState]:
    """Return place, velocity and length of each track by its number."""
    e = estimates
    columns = (e.x_m, e.y_m, e.vx_mps, e.vy_mps, e.length_m)
    states = zip(*(np.asarray(c, dtype=np.float64).tolist() for c in columns), strict=True)
    return dict(zip(estimates.number.tolist(), states, strict=True))


def _frames_of(directory: Path, site: SensorConfig) -> Iterator[Frame]:
    found = sorted(directory.glob("frames.jsonl*"))
    if not found:
        raise InvalidInput(f"{directory}: there is no frames.jsonl or frames.jsonl.gz")
    return read_frames(found, site)
