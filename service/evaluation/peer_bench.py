"""Time the tracker beside Stone Soup's JPDA on the same frames, where that is installed (extra `bench`)."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np

from service.tracking import tracker
from service.tracking.model import Frame
from service.tracking.parameters import TrackerParameters

WARM_UP = 20  # frames that do not count: tracks begin after some


@dataclass(frozen=True, slots=True)
class Comparison:
    """CPU time of one step of both trackers on the same frames, taken in turns."""

    peer: str
    frames: int
    step_s: float  # median, from points to tracks
    peer_step_s: float  # median, from clusters to tracks
    tracks: int  # after the last frame
    peer_tracks: int

    @property
    def ratio(self) -> float:
        """Return how many times faster the tracker is."""
        return self.peer_step_s / self.step_s

    def sentence(self) -> str:
        """Return the comparison in words."""
        return (
            f"{self.peer} takes {1e3 * self.peer_step_s:.1f} ms from clusters to tracks where a whole step "
            f"takes {1e3 * self.step_s:.2f} ms: {self.ratio:.0f} times as long (CPU time, medians over "
            f"{self.frames} frames; {self.peer_tracks} and {self.tracks} tracks at the end)"
        )


def is_installed() -> bool:
    """Tell whether Stone Soup can be imported."""
    return importlib.util.find_spec("stonesoup") is not None


def compare(
    frames: Sequence[Frame], parameters: TrackerParameters, clock: Callable[[], float] = time.process_time
) -> Comparison:
    """Run both trackers over the frames; raises ImportError without Stone Soup."""
    from service.evaluation.stone_soup import StoneSoup, detections_of  # noqa: PLC0415 - optional, and slow to import

    peer, state = StoneSoup(), tracker.initial_state(parameters)
    taken, peer_taken, tracks, peer_tracks = [], [], 0, 0
    for frame in frames:
        before = clock()
        state, estimates, _ = tracker.step(state, frame, parameters)
        taken.append(clock() - before)
        detections, timestamp = detections_of(frame, parameters)
        before = clock()
        peer_tracks = peer.step(detections, timestamp)
        peer_taken.append(clock() - before)
        tracks = len(estimates)
    counted = slice(WARM_UP if len(frames) > WARM_UP else 0, None)
    return Comparison(
        peer=f"Stone Soup {version('stonesoup')}, JPDA",
        frames=len(taken[counted]),
        step_s=float(np.median(taken[counted])),
        peer_step_s=float(np.median(peer_taken[counted])),
        tracks=tracks,
        peer_tracks=peer_tracks,
    )
