"""Keep the paths of the tracks that are being followed, and give out each as its track ends.

A sample is kept for each metre of travel, not for each frame: a queue adds nothing while it stands. The
samples of a frame are put behind those before it; from time to time all are joined into one table.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.tracking.model import F32, I64, TrackEstimates, TrackStatus
from service.traffic.model import Moment, Samples, Trajectory, no_samples, take
from service.traffic.vehicles import find

_CONFIRMED = int(TrackStatus.CONFIRMED)


@dataclass(frozen=True, slots=True)
class PathParameters:
    """How densely and how far back paths are kept."""

    step_m: float = 1.0  # of travel between two samples
    most_samples: int = 40_000  # of all tracks; the oldest go first. 60 tracks of 150 m have 9,000
    join_after: int = 32  # frames whose samples are kept apart


@dataclass(frozen=True, slots=True)
class Paths:
    """The tracks that are followed, T of them by number, and their samples."""

    number: I64  # (T,)
    x_m: F32  # where the last sample was taken
    y_m: F32
    length_m: F32  # as last known
    width_m: F32
    existence: F32
    past: Samples
    recent: tuple[Samples, ...]


def no_paths() -> Paths:
    """Return the state before the first frame."""
    f = np.zeros(0, dtype=np.float32)
    return Paths(np.zeros(0, dtype=np.int64), f, f, f, f, f, no_samples(), ())


def follow(
    paths: Paths, moment: Moment, now: TrackEstimates, across_std_m: F32, p: PathParameters
) -> tuple[Paths, tuple[Trajectory, ...]]:
    """Return the paths with the tracks of one more frame, and those of the tracks that are listed no more.

    Where a track merely coasts no sample is taken: nobody saw it there.
    """
    ended: tuple[Trajectory, ...] = ()
    if np.array_equal(paths.number, now.number):
        x, y = paths.x_m, paths.y_m
    else:
        ended = _ended(paths, now.number)
        before = find(paths.number, now.number)
        paths = _without_earlier(paths, now.number[before < 0])
        x, y = _last_places(paths, before)
    recent = paths.recent
    if not moment.tick:
        near = np.hypot(now.x_m - x, now.y_m - y) < p.step_m  # not, where there is no sample yet
        due = (~near & (now.status == _CONFIRMED)).nonzero()[0]
        if len(due):
            x, y = x.copy(), y.copy()
            x[due], y[due] = now.x_m[due], now.y_m[due]
            recent = (*recent, _samples(now, due, across_std_m, moment.time_us))
    paths = Paths(now.number, x, y, now.length_m, now.width_m, now.existence, paths.past, recent)
    return (_joined(paths, p) if len(recent) > p.join_after else paths), ended


def _samples(now: TrackEstimates, due: I64, across_std_m: F32, time_us: int) -> Samples:
    time = np.full(len(due), time_us, dtype=np.int64)
    return Samples(
        now.number[due], time, now.x_m[due], now.y_m[due], now.vx_mps[due], now.vy_mps[due], now.lane[due],
        across_std_m[due],
    )  # fmt: skip


def _last_places(paths: Paths, before: I64) -> tuple[F32, F32]:
    """Return where the last sample of each track now listed was taken, NaN for a new one."""
    known = before >= 0
    if not known.any():
        x, y = np.full((2, len(before)), np.nan, dtype=np.float32)
        return x, y
    nowhere = np.float32(np.nan)
    return np.where(known, paths.x_m[before], nowhere), np.where(known, paths.y_m[before], nowhere)


def so_far(paths: Paths) -> tuple[Trajectory, ...]:
    """Return the path of each track that is followed, up to now."""
    return _of(paths, np.arange(len(paths.number)))


def _ended(paths: Paths, listed: I64) -> tuple[Trajectory, ...]:
    return _of(paths, np.flatnonzero(find(listed, paths.number) < 0))


def _of(paths: Paths, chosen: I64) -> tuple[Trajectory, ...]:
    """Return the paths of the tracks at some places."""
    if not len(chosen):
        return ()
    past = take(paths.past, np.flatnonzero(find(paths.number[chosen], paths.past.number) >= 0))
    everything = join((past, *paths.recent))
    return tuple(
        Trajectory(
            number=int(paths.number[i]),
            samples=take(everything, everything.number == paths.number[i]),
            length_m=float(paths.length_m[i]),
            width_m=float(paths.width_m[i]),
            existence=float(paths.existence[i]),
        )
        for i in chosen
    )


def _without_earlier(paths: Paths, fresh: I64) -> Paths:
    """Return the paths without samples of tracks that ended and are listed again: those were given out."""
    tables = (paths.past, *paths.recent)
    if not len(fresh):
        return paths
    # Numbers rise: hardly one that begins is not above all before it. Each recent table is in their order.
    newest = (int(table.number[-1]) for table in paths.recent if len(table.number))
    fresh = fresh[fresh <= max(int(paths.past.number.max(initial=0)), *newest, 0)]
    if not len(fresh) or not any(np.isin(fresh, table.number).any() for table in tables):
        return paths
    past, *recent = (take(table, ~np.isin(table.number, fresh)) for table in tables)
    return replace(paths, past=past, recent=tuple(recent))


def retraced(samples: Samples, number: I64) -> Samples:
    """Return the samples of the named tracks."""
    return take(samples, np.isin(samples.number, number))


def _joined(paths: Paths, p: PathParameters) -> Paths:
    """Return the paths as one table, without the tracks that have ended."""
    past = join((paths.past, *paths.recent))
    past = retraced(past, paths.number)
    if len(past.number) > p.most_samples:
        past = take(past, np.arange(len(past.number) - p.most_samples, len(past.number)))
    return Paths(paths.number, paths.x_m, paths.y_m, paths.length_m, paths.width_m, paths.existence, past, ())


def join(parts: tuple[Samples, ...]) -> Samples:
    """Return several tables of samples as one."""
    names = ("number", "time_us", "x_m", "y_m", "vx_mps", "vy_mps", "lane", "across_std_m")
    return Samples(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
