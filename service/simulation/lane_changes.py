"""Which drivers begin a lane change now: gap acceptance and the wish to go faster.

Source: Kesting, Treiber, Helbing 2007, "General lane-changing model MOBIL for car-following models", Transp.
Res. Rec. 1999: the safety criterion bounds the new follower's braking; the incentive here is the driver's own
advantage alone.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from service.simulation.car_following import Driver, idm_acceleration
from service.simulation.fleet import Fleet, LaneOrder, gap_m
from service.simulation.vehicles import KINDS, VehicleKind
from service.tracking.model import F64, I64, Bool

THINK_S = 1.0  # between two thoughts of one driver
SLOWEST_MPS = 3.0  # a slower vehicle has no room to steer out


@dataclass(frozen=True, slots=True)
class LaneChangeParameters:
    """When drivers change lanes."""

    advantage_mps2: float = 0.25  # of acceleration that makes a change worth it
    safe_braking_mps2: float = 2.0  # the most that a change asks of its driver or the new follower
    headway_share: float = 0.5  # of the wanted headway that drivers accept while changing
    without_need: float = 0.01  # chance at each thought to change although there is no advantage
    rest_s: float = 6.0  # after a change before the next thought
    shortest_s: float = 3.0  # duration of the lateral move
    longest_s: float = 5.0


@dataclass(frozen=True, slots=True)
class _Options:
    """C possible changes: who, to which lane, before whom (-1: nobody), and how much acceleration it wins."""

    who: I64
    lane: I64
    behind: I64
    gain_mps2: F64


def choose_changes(  # noqa: PLR0913 - what a driver sees, one keyword each
    fleet: Fleet,
    order: LaneOrder,
    driver: Driver,
    *,
    time_s: float,
    neighbours: tuple[tuple[int, ...], ...],
    parameters: LaneChangeParameters,
    rng: np.random.Generator,
) -> None:
    """Begin the lane changes of this instant, at most one into each lane; changes the fleet in place."""
    thinking = (fleet.next_thought_s <= time_s) & (fleet.old_lane == fleet.lane)
    if not thinking.any():
        return
    fleet.next_thought_s[thinking] = time_s + THINK_S
    able = thinking & (fleet.speed_mps > SLOWEST_MPS) & ~np.isfinite(fleet.stop_at_m)
    pairs = [(i, lane) for i in np.flatnonzero(able) for lane in neighbours[fleet.lane[i]]]
    if not pairs:
        return
    who, lane = np.array(pairs).T
    restless = np.array([KINDS[k].restlessness for k in VehicleKind])[fleet.kind[who]]
    idle = rng.random(len(who)) < parameters.without_need * restless
    options = _weigh(fleet, order, driver, who, lane, idle=idle, parameters=parameters)
    taken: set[int] = set()
    for k in np.argsort(-options.gain_mps2, kind="stable"):
        i, target = int(options.who[k]), int(options.lane[k])
        if target in taken or fleet.lane[i] != fleet.old_lane[i]:
            continue
        taken.add(target)
        fleet.lane[i] = target
        fleet.progress[i] = 0.0
        fleet.headway_share[i] = parameters.headway_share
        if options.behind[k] >= 0:
            fleet.headway_share[options.behind[k]] = parameters.headway_share
        fleet.change_s[i] = rng.uniform(parameters.shortest_s, parameters.longest_s)
        fleet.next_thought_s[i] = time_s + fleet.change_s[i] + parameters.rest_s


def _weigh(  # noqa: PLR0913 - what a driver sees, one keyword each
    fleet: Fleet,
    order: LaneOrder,
    driver: Driver,
    who: I64,
    lane: I64,
    *,
    idle: Bool,
    parameters: LaneChangeParameters,
) -> _Options:
    """Return the changes that are safe and worth it."""
    ahead, behind = order.around(lane, fleet.travel_m[who])
    front, back = gap_m(fleet, who, ahead), gap_m(fleet, behind, who)
    speed = fleet.speed_mps
    driver = dataclasses.replace(driver, headway_s=fleet.headway_s * parameters.headway_share)
    own = idm_acceleration(driver.take(who), speed[who], front, speed[ahead])
    follower = idm_acceleration(driver.take(behind), speed[behind], back, speed[who])
    room = np.minimum(front, back) > fleet.standstill_gap_m[who]
    limit = -parameters.safe_braking_mps2
    safe = room & (own > limit) & ((behind < 0) | (follower > limit))
    gain = own - fleet.acceleration_mps2[who]
    worth = (gain > parameters.advantage_mps2) | (idle & (gain > -parameters.advantage_mps2))
    good = safe & worth
    return _Options(who[good], lane[good], behind[good], gain[good])
