"""What stood there before a vehicle came is not of that vehicle."""

from __future__ import annotations

import math

import numpy as np
import pytest

from service.tracking.boxes import BOX_COLUMNS, BSPEED, PG, POINT_COLUMNS, PVAR_AZ, PX, PY
from service.tracking.state import Window
from service.tracking.stood import Standing, StoodParameters, forbid
from tests.tracking.test_tracker import detections, frame, run, vehicle

FRAMES = 20
AT = 10.0, 70.0
GATE = 25.0


def points_at(*places, azimuth_std_rad=0.002):
    points = np.zeros((len(places), POINT_COLUMNS))
    points[:, [PX, PY]] = np.reshape(places, (-1, 2))
    points[:, PG] = np.hypot(points[:, PX], points[:, PY])
    points[:, PVAR_AZ] = azimuth_std_rad**2
    return points


def seen(place=AT, *, share=1.0, owned=False, times=1):
    """A second of standing echoes of one place, in a share of its frames, so many in each."""
    frames = np.repeat(np.arange(round(FRAMES * share)), times)
    n = len(frames)
    return Window(points_at(*[place] * n), frames, np.full(n, owned), np.ones(n, np.bool_))


def costs(window, *, speed_mps=5.0, standing=True, known=False, frames=FRAMES, place=AT):
    """What one point costs a box that drives and one that stands."""
    cost, boxes = np.ones((2, 1)), np.zeros((2, BOX_COLUMNS))
    boxes[0, BSPEED] = speed_mps
    now = Standing(np.array([standing]), np.array([known]), window, frames)
    forbid(cost, boxes, points_at(place), now, GATE, StoodParameters())
    return cost[:, 0].tolist()


def test_what_stood_for_a_second_is_of_nobody_who_drives():
    assert costs(seen()) == [math.inf, 1.0]
    assert costs(seen(), speed_mps=1.0) == [1.0, 1.0]
    assert costs(seen(), standing=False) == [1.0, 1.0]


@pytest.mark.parametrize(
    ("window", "forbidden"),
    [
        (seen(share=0.6), True),
        (seen(share=0.4), False),
        (seen(share=0.4, times=3), False),  # frames count, not echoes
        (seen(owned=True), False),  # that of a vehicle which brakes, perhaps
        (seen((10.0, 72.0)), False),
        (seen((11.5, 70.0)), False),
        (seen((10.3, 70.2)), True),
        (seen(share=0.0), False),
    ],
)
def test_it_must_have_stood_in_that_place_and_been_nobodys(window, forbidden):
    assert math.isinf(costs(window)[0]) is forbidden


def test_where_clutter_is_known_to_stand_nothing_has_to_be_seen_before():
    nothing = seen(share=0.0)

    assert costs(nothing, known=True) == [math.inf, 1.0]
    assert costs(nothing, known=True, standing=False) == [1.0, 1.0]
    assert costs(nothing, frames=0) == [1.0, 1.0]


def test_after_a_gap_a_few_frames_are_no_second():
    for frames in (1, 9):
        assert costs(seen(share=frames / FRAMES), frames=frames) == [1.0, 1.0]
    assert costs(seen(share=0.5), frames=10) == [math.inf, 1.0]


def test_a_place_is_as_wide_as_its_azimuth_is_uncertain():
    beside = seen((10.9, 69.9))

    assert costs(beside) == [1.0, 1.0]
    cost, boxes = np.ones((1, 1)), np.zeros((1, BOX_COLUMNS))
    boxes[0, BSPEED] = 5.0
    now = Standing(np.array([True]), np.array([False]), beside, FRAMES)
    forbid(cost, boxes, points_at(AT, azimuth_std_rad=0.008), now, GATE, StoodParameters())
    assert math.isinf(cost[0, 0])


BUSHES = np.array([(-0.5, 55.5), (0.4, 56.1), (0.2, 57.0)])


def when_hidden(*, bushes_before, speed_mps=4.0, lost=20):
    """Return a car's track before and after a frame of bushes alone, which a truck has hidden for a while.

    bushes_before: they have stood there for a second, or appear only now, as what brakes unseen does.
    """
    rng, frames = np.random.default_rng(4), []
    for k in range(61 + lost):
        y = 54.0 + 0.05 * speed_mps * (k - 60)
        rows = [vehicle(rng, 0.0, y - 14.0, 0.0, speed_mps, length=10.0, width=2.5, points=14)]
        rows += [vehicle(rng, 0.0, y, 0.0, speed_mps)] if k < 60 else []
        bushes = detections(rng, *BUSHES.T, np.zeros(3), np.zeros(3), 25.0)
        frames.append(frame(k, *rows, *([bushes] if k == 60 + lost or (bushes_before and k > 40) else [])))
    state, _ = run(frames[:-1])
    after, _ = run(frames[-1:], state=state)
    near = ((s.tracks, np.hypot(s.tracks.x_m, s.tracks.y_m - 55.0) < 5.0) for s in (state, after))
    return (tracks.take(which) for tracks, which in near)


@pytest.mark.parametrize("bushes_before", [True, False])
def test_a_lost_box_meets_what_appears_and_not_what_stood_there(bushes_before):
    before, after = when_hidden(bushes_before=bushes_before)

    assert before.empty.tolist() == [20]
    assert after.empty.tolist() == [21 if bushes_before else 0]
