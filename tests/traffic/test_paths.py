from __future__ import annotations

import numpy as np

from service.tracking.model import TrackStatus
from service.traffic.measured import measured_of
from service.traffic.model import Moment
from service.traffic.paths import PathParameters, follow, no_paths
from tests.traffic.tracks import FRAME_US, START_US, estimates


def watch(frames, parameters=None):
    """Return the paths after the frames, and the trajectories that they gave out."""
    paths, finished = no_paths(), []
    for k, now in enumerate(frames):
        moment = Moment(START_US + k * FRAME_US, k, tick=False)
        paths, ended = follow(
            paths, moment, now, measured_of(now).across_std_m, parameters or PathParameters()
        )
        finished += ended
    return paths, finished


def test_the_path_of_a_track_is_given_out_when_it_ends():
    drive = [estimates([1, 2], [0.0, 3.5], [100 - 0.6 * k, 20 + 0.6 * k], 0, [-12, 12]) for k in range(100)]

    _, finished = watch([*drive, estimates([2], 3.5, 80, 0, 12)])

    assert [path.number for path in finished] == [1]
    samples = finished[0].samples
    assert set(samples.x_m.tolist()) == {0.0}
    steps = -np.diff(samples.y_m)
    assert steps.min() >= 1.0
    assert steps.max() <= 1.0 + 0.6 + 1e-4  # the first frame that is a metre on
    np.testing.assert_array_equal(samples.time_us, START_US + FRAME_US * np.arange(0, 100, 2))


def test_a_standing_vehicle_adds_no_samples():
    rng = np.random.default_rng(4)
    stand = [estimates([1], rng.normal(0, 0.1), 60 + rng.normal(0, 0.1), 0, 0) for _ in range(400)]

    paths, _ = watch(stand)

    assert len(paths.past.number) + sum(len(part.number) for part in paths.recent) == 1


def test_nobody_saw_a_vehicle_where_its_track_only_coasted():
    seen = [estimates([1], 0, 100 - 2 * k, 0, -40) for k in range(10)]
    unseen = [estimates([1], 0, 80 - 2 * k, 0, -40, status=TrackStatus.COASTING) for k in range(10)]

    _, finished = watch([*seen, *unseen, estimates([], 0, 0, 0, 0)])

    assert finished[0].samples.y_m.tolist() == [100 - 2 * k for k in range(10)]


def test_memory_is_bounded_and_the_newest_samples_stay():
    drive = [estimates([1], 0, 2 * k, 0, 40) for k in range(200)]

    paths, finished = watch(
        [*drive, estimates([], 0, 0, 0, 0)], PathParameters(most_samples=50, join_after=5)
    )

    kept = finished[0].samples.y_m
    assert 50 <= len(kept) <= 56
    assert kept[-1] == 398
    assert len(paths.past.number) == 50 or len(paths.number) == 0


def test_what_was_given_out_of_a_track_is_not_given_out_again_when_it_comes_back():
    first = [estimates([1, 2], [0, 3.5], [100 - 2 * k, 50], 0, [-40, 0]) for k in range(10)]
    gone = [estimates([2], 3.5, 50, 0, 0)] * 4
    again = [estimates([1, 2], [0, 3.5], [60 - 2 * k, 50], 0, [-40, 0]) for k in range(10)]

    for join_after in (2, 32):
        _, finished = watch([*first, *gone, *again, *gone], PathParameters(join_after=join_after))

        assert [path.number for path in finished] == [1, 1]
        assert finished[0].samples.y_m.tolist() == [100 - 2 * k for k in range(10)]
        assert finished[1].samples.y_m.tolist() == [60 - 2 * k for k in range(10)]
