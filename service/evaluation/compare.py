"""Track one recording with several filters and put their accuracy, consistency and cost side by side.

All else is equal: clustering, association and life of the tracks are the tracker's, with the parameters of
the recording's site. The time is that of the steps; of it the filter's own is measured apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from pathlib import Path

import numpy as np

from service.errors import InvalidInput
from service.evaluation.counted import count
from service.evaluation.kinematics import Matches, match
from service.evaluation.measures import Measure, Value, select
from service.evaluation.monte_carlo import innovation_squared
from service.evaluation.recorded import RecordedTracks, State, TrackId, record
from service.evaluation.report import Grid, cells
from service.evaluation.rules import RULES
from service.evaluation.scores import score
from service.evaluation.truth import Scene, read_scene
from service.formats.json_frames import read_frames
from service.tracking import tracker
from service.tracking.filters.base import Expected, Filter, FilterState, Prediction
from service.tracking.filters.registry import make_filter
from service.tracking.filters.space import ROAD_COLUMNS
from service.tracking.measurement import CHANNELS
from service.tracking.model import F64, Frame
from service.tracking.parameters import TrackerParameters

Clock = Callable[[], float]

MEASURES = (
    *select(
        [
            "hota",
            "gospa",
            "pos_rmse_m",
            "lateral_rmse_m",
            "vel_rmse_mps",
            "id_switches",
            "fragmentations",
            "never_tracked",
        ]
    ),
    Measure("nees", "NEES per state", "NEES"),
    Measure("nis", "NIS per channel", "NIS"),
    Measure("step_ms", "time per step, ms", "ms/step"),
    Measure("filter_us", "filter's time per track and step, us", "us/track", 1),
)
SURE = 0.5  # association probability from which a measurement is a track's own
MEAN = "mean"
WARM_UP_FRAMES = 40  # tracked once before; kernels are loaded when they are first used


@dataclass(slots=True)
class Watched:
    """A filter that is timed, and whose innovations are kept; it is itself a `base.Filter`."""

    inner: Filter
    clock: Clock
    seconds: float = 0.0
    track_steps: int = 0
    nis: list[F64] = field(default_factory=list)  # per channel, of measurements that are surely the track's
    _seen: Expected | None = None

    @property
    def name(self) -> str:
        """The name in the registry."""
        return self.inner.name

    @property
    def memory_size(self) -> int:
        """Columns of the memory."""
        return self.inner.memory_size

    def start(self, mean: F64, cov: F64) -> FilterState:
        """Return new tracks."""
        return self.inner.start(mean, cov)

    def predict(self, state: FilterState, dt_s: float) -> Prediction:
        """Return the tracks moved ahead."""
        begin = self.clock()
        prediction = self.inner.predict(state, dt_s)
        self.seconds += self.clock() - begin
        return prediction

    def expected(self, prediction: Prediction) -> Expected:
        """Return the expected measurements."""
        begin = self.clock()
        self._seen = self.inner.expected(prediction)
        self.seconds += self.clock() - begin
        return self._seen

    def update(self, prediction: Prediction, z: F64, R: F64, beta: F64, miss: F64) -> FilterState:
        """Return the tracks after the measurements."""
        begin = self.clock()
        state = self.inner.update(prediction, z, R, beta, miss)
        self.seconds += self.clock() - begin
        self.track_steps += len(miss)
        if self._seen is not None and beta.size:
            best = beta.argmax(axis=1)
            own = np.arange(len(best))
            sure = (beta[own, best] > SURE)[:, None]
            mine = np.where(sure, z[own, best], np.nan)
            channels = np.isfinite(mine).sum(axis=1)
            squared = innovation_squared(
                self._seen, mine, np.where(sure[:, :, None], R[own, best], np.eye(CHANNELS))
            )
            self.nis.append((squared / np.maximum(channels, 1))[channels > 0])
        return state


def compare(  # noqa: PLR0913 - one choice a keyword
    directories: Sequence[Path],
    names: Sequence[str],
    *,
    settings: Mapping[str, str],
    until: float | None,
    clock: Clock,
    advance: Callable[[str], None],
) -> list[dict[str, Value]]:
    """Return one result for each recording and filter, in this order; `advance` hears of each as it begins.

    Raises InvalidInput for a folder without truth, an unknown filter or a wrong setting.
    """
    for name in names:
        make_filter(name)
    if len(set(names)) < len(names):
        raise InvalidInput.at("/filters", f"names a filter twice: {', '.join(names)}")
    return list(_results(directories, names, settings, until, clock, advance))


def _results(  # noqa: PLR0913, PLR0917 - of `compare`
    directories: Sequence[Path],
    names: Sequence[str],
    settings: Mapping[str, str],
    until: float | None,
    clock: Clock,
    advance: Callable[[str], None],
) -> Iterator[dict[str, Value]]:
    for directory in directories:
        scene = read_scene(directory)
        scene = scene if until is None else scene.until(until)
        parameters = scene.site.tracker_parameters()
        for key, text in settings.items():
            parameters = parameters.with_setting(key, text)
        known = set(scene.number.tolist())
        source = read_frames([next(directory.glob("frames.jsonl*"))], scene.site)
        frames = list(takewhile(lambda frame, known=known: frame.sequence in known, source))  # type: ignore[misc]
        for name in names:
            advance(f"{scene.name}: {name}")
            yield measure(scene, frames, name, parameters, clock)


def measure(
    scene: Scene, frames: Sequence[Frame], name: str, parameters: TrackerParameters, clock: Clock
) -> dict[str, Value]:
    """Return the scores of one filter on the frames of a scene."""
    run(scene, frames[:WARM_UP_FRAMES], make_filter(name, parameters.filters), parameters, clock)
    bank = Watched(make_filter(name, parameters.filters), clock)
    tracks, cov, seconds = run(scene, frames, bank, parameters, clock)
    counted = count(scene, tracks, RULES)
    nis = np.concatenate([np.zeros(0), *bank.nis])
    return {
        **score(scene, tracks),
        "filter": name,
        "nees": mean_nees(scene, tracks, cov, match(counted, tracks, RULES)),
        "nis": float(np.mean(nis)) if len(nis) else math.nan,
        "step_ms": 1e3 * float(np.median(seconds)),
        "filter_us": 1e6 * bank.seconds / max(bank.track_steps, 1),
        "parameters": parameters.digest(),
    }


def run(
    scene: Scene, frames: Sequence[Frame], bank: Filter, parameters: TrackerParameters, clock: Clock
) -> tuple[RecordedTracks, F64, list[float]]:
    """Return the tracks of the frames, covariances (N, 4, 4) of [x vx y vy] of their states, step seconds."""
    place = {int(n): k for k, n in enumerate(scene.number)}
    found: list[dict[TrackId, State]] = [{} for _ in place]
    covs: list[F64] = []
    seconds: list[float] = []
    state, columns = tracker.initial_state(parameters), list(ROAD_COLUMNS)
    for frame in frames:
        begin = clock()
        state, estimates, _ = tracker.step(state, frame, parameters, bank)
        seconds.append(clock() - begin)
        shown = state.tracks.take(state.tracks.confirmed)
        values = zip(estimates.number.tolist(), shown.mean[:, [0, 3, 1, 4]].tolist(), strict=True)
        if frame.sequence is not None:
            found[place[frame.sequence]] = {number: (x, y, vx, vy) for number, (x, y, vx, vy) in values}
        covs.append(shown.cov[:, columns][:, :, columns])
    return record(found), np.concatenate([np.zeros((0, 4, 4)), *covs]), seconds


def mean_nees(scene: Scene, tracks: RecordedTracks, cov: F64, matches: Matches) -> float:
    """Return the mean over the matched pairs of e' C^-1 e / 4, e the error of [x vx y vy]."""
    r, s, rows = matches.row, matches.state, scene.rows
    if not len(r):
        return math.nan
    e = np.stack(
        [
            tracks.x_m[s] - rows.x_m[r],
            tracks.vx_mps[s] - rows.vx_mps[r],
            tracks.y_m[s] - rows.y_m[r],
            tracks.vy_mps[s] - rows.vy_mps[r],
        ],
        axis=1,
    )
    squared = (e * np.linalg.solve(cov[s], e[..., None])[..., 0]).sum(axis=1)
    return float(np.mean(squared)) / len(ROAD_COLUMNS)


def with_means(results: Sequence[Mapping[str, Value]]) -> list[dict[str, Value]]:
    """Return the results, followed by the mean of each filter where there are several recordings."""
    rows = [dict(result) for result in results]
    if len({row["scene"] for row in rows}) == 1:
        return rows
    for name in dict.fromkeys(str(row["filter"]) for row in rows):
        own = [row for row in rows if row["filter"] == name and row["scene"] != MEAN]
        means = {
            m.key: float(np.mean([float(row[m.key]) for row in own])) for m in MEASURES if m.key in own[0]
        }
        rows.append({"scene": MEAN, "filter": name, **means})
    return rows


def grid(results: Sequence[Mapping[str, Value]]) -> Grid:
    """Return a table with a row for each result."""
    heads = ("recording", "filter", *(m.short for m in MEASURES))
    return Grid(
        heads, tuple((str(r["scene"]), str(r["filter"]), *cells(r, MEASURES)) for r in with_means(results))
    )
