"""Microscopic traffic on a road, stepped in time: arrivals, car following, lane changes, signals, stops."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from service.simulation.car_following import FAR_M, Driver, advance, idm_acceleration
from service.simulation.fleet import WANDER_M, Fleet, LaneOrder, draw_vehicle, gap_m
from service.simulation.lane_changes import LaneChangeParameters, choose_changes
from service.simulation.roads import Road
from service.simulation.vehicles import KINDS, MIX, VehicleKind, VehicleStates
from service.tracking.model import F64

MOOD_STD = 0.03  # of the wanted speed; drivers do not hold it exactly
MOOD_TIME_S = 15.0
WANDER_LENGTH_M = 180.0  # of one swing inside the lane
SHORTEST_ARRIVAL_S = 0.7  # between two vehicles of one lane; the entry gap adds to it
ENTRY_HEADWAY_S = 0.9  # a new vehicle waits outside until this gap is free
ENTRY_CLOSING_S = 5.0  # in which a new vehicle may use up what it has beyond its headway
SIGNAL_BRAKING_MPS2 = 3.5  # harder braking than this is not asked for: the vehicle passes
RELAX_S = 8.0  # in which a short headway after a lane change grows back (Laval, Leclercq 2008)
STANDING_MPS = 0.2
MOST_WAITING = 5  # vehicles before a full entry; more demand goes elsewhere
FULL_LATERAL_SPEED_MPS = 5.0  # slower vehicles change lanes more slowly, standing ones not at all


@dataclass(frozen=True, slots=True)
class Signal:
    """A traffic light across all approaching or all receding lanes."""

    at_m: float  # arc length of the stop line
    direction: int
    green_s: float
    amber_s: float
    red_s: float

    def stops_at(self, time_s: float) -> bool:
        """Return whether it shows amber or red."""
        return time_s % (self.green_s + self.amber_s + self.red_s) >= self.green_s


@dataclass(frozen=True, slots=True)
class SlowZone:
    """A stretch that is driven slower than the limit for some time out of each period: a bottleneck."""

    from_m: float
    to_m: float
    speed_mps: float
    start_s: float = 0.0
    duration_s: float = math.inf
    period_s: float = math.inf

    def is_on(self, time_s: float) -> bool:
        """Return whether it is slow now."""
        since = time_s - self.start_s
        return (
            since >= 0
            and (since % self.period_s if math.isfinite(self.period_s) else since) < self.duration_s
        )


@dataclass(frozen=True, slots=True)
class Stop:
    """A vehicle that stops in a lane at an arc length and stands for a while."""

    lane_id: str
    at_m: float
    start_s: float
    duration_s: float
    period_s: float = math.inf


@dataclass(frozen=True, slots=True)
class TrafficParameters:
    """Demand, speeds and what disturbs the flow."""

    receding_vph: float = 0.0  # over all lanes of the direction
    approaching_vph: float = 0.0
    speed_limit_mps: float = 25.0
    mix: dict[VehicleKind, float] = field(default_factory=lambda: dict(MIX))
    lane_change: LaneChangeParameters = field(default_factory=LaneChangeParameters)
    signals: tuple[Signal, ...] = ()
    slow_zones: tuple[SlowZone, ...] = ()
    stops: tuple[Stop, ...] = ()


class Traffic:
    """The state of the traffic on one road; `step` moves it forward."""

    def __init__(self, road: Road, parameters: TrafficParameters, rng: np.random.Generator) -> None:
        self.road = road
        self.parameters = parameters
        self.time_s = 0.0
        self.fleet = Fleet.empty()
        self._rng = rng
        self._next_id = 1
        self._direction = np.array([lane.direction for lane in road.lanes])
        self._offset_m = np.array([lane.offset_m for lane in road.lanes])
        self._entry_m = np.where(self._direction > 0, road.start_m, -road.end_m)
        self._exit_m = np.where(self._direction > 0, road.end_m, -road.start_m)
        self._neighbours = road.neighbours()
        self._waiting: list[list[VehicleKind]] = [[] for _ in road.lanes]
        self._next_arrival_s = np.array([self._draw_interval_s(i) for i in range(len(road.lanes))])
        self._stops_done: dict[Stop, int] = {}

    def step(self, dt_s: float) -> None:
        """Move every vehicle forward by `dt_s`."""
        self.time_s += dt_s
        self._arrive()
        fleet, order = self.fleet, LaneOrder.of(self.fleet)
        self._fluctuate(dt_s)
        self._order_stops()
        driver = fleet.driver(self._limit_mps())
        fleet.acceleration_mps2 = self._acceleration(order, driver)
        choose_changes(
            fleet,
            order,
            driver,
            time_s=self.time_s,
            neighbours=self._neighbours,
            parameters=self.parameters.lane_change,
            rng=self._rng,
        )
        distance, fleet.speed_mps = advance(fleet.speed_mps, fleet.acceleration_mps2, dt_s)
        s = fleet.travel_m * self._direction[fleet.lane]
        fleet.travel_m = fleet.travel_m + distance / self.road.shrink(s, self._lateral()[0])
        pace = np.minimum(fleet.speed_mps / FULL_LATERAL_SPEED_MPS, 1.0)
        fleet.progress = np.minimum(fleet.progress + pace * dt_s / fleet.change_s, 1.0)
        fleet.old_lane = np.where(fleet.progress >= 1, fleet.lane, fleet.old_lane)
        inside = fleet.travel_m < self._exit_m[fleet.lane]
        if not inside.all():
            fleet.keep(inside)

    def run(self, duration_s: float, dt_s: float) -> None:
        """Step until `duration_s` has passed, to fill the road."""
        for _ in range(round(duration_s / dt_s)):
            self.step(dt_s)

    def states(self) -> VehicleStates:
        """Return the vehicles in the plan frame."""
        fleet, direction = self.fleet, self._direction[self.fleet.lane]
        s = fleet.travel_m * direction
        offset, lateral_mps = self._lateral()
        x, y = self.road.place(s, offset)
        road_heading = self.road.heading_at(s) + np.where(direction > 0, 0.0, np.pi)
        right_mps = (
            lateral_mps * direction
        )  # offsets count to the reference line's right, drivers sit facing theirs
        forward_mps = fleet.speed_mps
        sine, cosine = np.sin(road_heading), np.cos(road_heading)
        nearest = np.abs(offset[:, None] - self._offset_m[None, :]).argmin(axis=1)
        return VehicleStates(
            vehicle_id=fleet.vehicle_id.copy(),
            kind=fleet.kind.copy(),
            x_m=x,
            y_m=y,
            vx_mps=forward_mps * sine + right_mps * cosine,
            vy_mps=forward_mps * cosine - right_mps * sine,
            heading_rad=(road_heading + np.arctan2(right_mps, np.maximum(forward_mps, 1.0))) % (2 * np.pi),
            length_m=fleet.length_m.copy(),
            width_m=fleet.width_m.copy(),
            height_m=fleet.height_m.copy(),
            lane=nearest,
        )

    def _lateral(self) -> tuple[F64, F64]:
        """Return each vehicle's offset from the reference line and its rate [m/s].

        The move between two lanes is the minimum-jerk profile of Flash, Hogan 1985: 10 p^3 - 15 p^4 + 6 p^5.
        """
        fleet = self.fleet
        p = fleet.progress
        old, new = self._offset_m[fleet.old_lane], self._offset_m[fleet.lane]
        share, slope = p**3 * (10 - 15 * p + 6 * p**2), 30 * p**2 * (1 - p) ** 2
        pace = np.minimum(fleet.speed_mps / FULL_LATERAL_SPEED_MPS, 1.0)
        amplitude = np.array([WANDER_M[k] for k in VehicleKind])[fleet.kind]
        wave = 2 * np.pi / WANDER_LENGTH_M
        angle = wave * fleet.travel_m + fleet.wander_phase_rad
        offset = old + (new - old) * share + fleet.lateral_m + amplitude * np.sin(angle)
        rate = (new - old) * slope * pace / fleet.change_s + amplitude * wave * fleet.speed_mps * np.cos(
            angle
        )
        return offset, rate

    def _limit_mps(self) -> F64:
        fleet, p = self.fleet, self.parameters
        limit = np.full(len(fleet), p.speed_limit_mps)
        s = fleet.travel_m * self._direction[fleet.lane]
        for zone in p.slow_zones:
            if zone.is_on(self.time_s):
                limit[(s > zone.from_m) & (s < zone.to_m)] = zone.speed_mps
        return limit

    def _fluctuate(self, dt_s: float) -> None:
        keep = math.exp(-dt_s / MOOD_TIME_S)
        relaxed = 1 - (1 - self.fleet.headway_share) * math.exp(-dt_s / RELAX_S)
        self.fleet.headway_share = relaxed
        noise = MOOD_STD * math.sqrt(1 - keep**2) * self._rng.normal(size=len(self.fleet))
        self.fleet.mood = self.fleet.mood * keep + noise

    def _acceleration(self, order: LaneOrder, driver: Driver) -> F64:
        """Return the least of what the leader in each occupied lane, the signals and ordered stops allow."""
        fleet = self.fleet
        owner, leader = order.owner, order.leaders()
        entry = idm_acceleration(
            driver.take(owner), fleet.speed_mps[owner], gap_m(fleet, owner, leader), fleet.speed_mps[leader]
        )
        least = np.full(len(fleet), np.inf)
        np.minimum.at(least, owner, entry)
        room = self._room_to_stop_m()
        if np.any(room < FAR_M):
            standing = idm_acceleration(driver, fleet.speed_mps, room, np.zeros(len(fleet)))
            least = np.where(room < FAR_M, np.minimum(least, standing), least)
        return least

    def _room_to_stop_m(self) -> F64:
        """Return the distance from each front bumper to the nearest line where the vehicle must stand."""
        fleet = self.fleet
        front = fleet.travel_m + fleet.length_m / 2
        holding = np.isfinite(fleet.stop_at_m)
        room = np.where(holding, fleet.stop_at_m - front + fleet.standstill_gap_m, FAR_M)
        for signal in self.parameters.signals:
            ahead = signal.at_m * signal.direction - front
            mine = (self._direction[fleet.lane] == signal.direction) & (ahead > 0)
            if not signal.stops_at(self.time_s):
                fleet.passes_signal[mine] = False
                continue
            needed = fleet.speed_mps**2 / (2 * np.maximum(ahead, 1e-3))
            fleet.passes_signal |= mine & (needed > SIGNAL_BRAKING_MPS2)
            room = np.where(mine & ~fleet.passes_signal, np.minimum(room, ahead), room)
        return room

    def _order_stops(self) -> None:
        """Begin and end the stops that are due."""
        fleet = self.fleet
        ordered = np.isfinite(fleet.stop_at_m)
        stands = ordered & (fleet.speed_mps < STANDING_MPS) & np.isinf(fleet.stop_until_s)
        fleet.stop_until_s[stands] = self.time_s + fleet.stop_for_s[stands]
        fleet.stop_at_m[ordered & (fleet.stop_until_s <= self.time_s)] = np.inf
        for stop in self.parameters.stops:
            since = self.time_s - stop.start_s
            turn = int(since // stop.period_s) if math.isfinite(stop.period_s) else 0
            if since >= 0 and self._stops_done.get(stop, -1) < turn and self._order_stop(stop):
                self._stops_done[stop] = turn

    def _order_stop(self, stop: Stop) -> bool:
        """Tell the nearest vehicle that can brake in comfort to stand at the place; False: there is none."""
        fleet = self.fleet
        lane = next(i for i, q in enumerate(self.road.lanes) if q.lane_id == stop.lane_id)
        at = stop.at_m * self._direction[lane]
        room = at - fleet.travel_m - fleet.length_m / 2
        comfort = fleet.speed_mps**2 / fleet.wanted_deceleration_mps2  # twice the braking distance
        able = (fleet.lane == lane) & (fleet.old_lane == lane) & (room > comfort)
        if not able.any():
            return False
        chosen = np.flatnonzero(able)[np.argmin(room[able])]
        fleet.stop_at_m[chosen] = at
        fleet.stop_for_s[chosen] = stop.duration_s
        fleet.stop_until_s[chosen] = np.inf
        return True

    def _arrive(self) -> None:
        """Let the vehicles in that are due and find room at the lane's entry."""
        for lane in range(len(self.road.lanes)):
            while self._next_arrival_s[lane] <= self.time_s:
                if len(self._waiting[lane]) < MOST_WAITING:
                    self._waiting[lane].append(self._draw_kind())
                self._next_arrival_s[lane] += self._draw_interval_s(lane)
            if self._waiting[lane] and self._enter(lane, self._waiting[lane][0]):
                self._waiting[lane].pop(0)

    def _enter(self, lane: int, kind: VehicleKind) -> bool:
        fleet, entry = self.fleet, float(self._entry_m[lane])
        inside = np.flatnonzero((fleet.lane == lane) | (fleet.old_lane == lane))
        gap, leader_mps = FAR_M, float(self.parameters.speed_limit_mps)
        if len(inside):
            last = inside[np.argmin(fleet.travel_m[inside])]
            gap = float(fleet.travel_m[last] - entry - (fleet.length_m[last] + KINDS[kind].length_m[1]) / 2)
            leader_mps = float(fleet.speed_mps[last])
        if gap < KINDS[kind].standstill_gap_m + ENTRY_HEADWAY_S * leader_mps:
            return False
        new = draw_vehicle(
            kind, vehicle_id=self._next_id, lane=lane, travel_m=entry, time_s=self.time_s, rng=self._rng
        )
        wanted_mps = float(self.parameters.speed_limit_mps * new.speed_factor[0])
        spare_m = max(gap - float(new.standstill_gap_m[0]) - leader_mps * float(new.headway_s[0]), 0.0)
        new.speed_mps[0] = min(wanted_mps, leader_mps + spare_m / ENTRY_CLOSING_S)
        fleet.append(new)
        self._next_id += 1
        return True

    def _draw_kind(self) -> VehicleKind:
        kinds = list(self.parameters.mix)
        share = np.array([self.parameters.mix[k] for k in kinds])
        return kinds[int(self._rng.choice(len(kinds), p=share / share.sum()))]

    def _draw_interval_s(self, lane: int) -> float:
        """Return a time to the next arrival: exponential behind a shortest one (Cowan's M2)."""
        p, direction = self.parameters, self._direction[lane]
        vph = p.receding_vph if direction > 0 else p.approaching_vph
        if vph <= 0:
            return math.inf
        mean_s = 3600.0 * int(np.sum(self._direction == direction)) / vph
        return SHORTEST_ARRIVAL_S + float(self._rng.exponential(max(mean_s - SHORTEST_ARRIVAL_S, 0.0)))
