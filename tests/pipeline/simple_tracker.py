"""A small nearest-neighbour tracker: quick and deterministic, with births, coasting and deaths."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.tracking.model import F64, I64, Frame, StepReport, TrackEstimates, TrackStatus
from service.tracking.parameters import TrackerParameters

GATE_M = 4.0
CONFIRM_HITS = 2
PATIENCE_US = 1_500_000


@dataclass(frozen=True, slots=True)
class SimpleState:
    number: I64
    place_m: F64  # (T, 2)
    velocity_mps: F64  # (T, 2)
    hits: I64
    born_us: I64
    hit_us: I64
    next_number: int
    time_us: int

    @property
    def idle(self) -> bool:
        return len(self.number) == 0

    @property
    def resting_numbers(self) -> I64:
        return np.zeros(0, dtype=np.int64)


def initial_state(parameters: TrackerParameters | None = None) -> SimpleState:
    whole, plane = np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    return SimpleState(whole, plane, plane, whole, whole, whole, next_number=1, time_us=0)


def step(state: SimpleState, frame: Frame, parameters: TrackerParameters):
    assert frame.time_us > state.time_us, "time must go on"
    state = _predict(state, frame.time_us)
    points = np.column_stack(
        [frame.range_m * np.sin(frame.azimuth_rad), frame.range_m * np.cos(frame.azimuth_rad)]
    ).astype(np.float64)
    place, velocity = state.place_m.copy(), state.velocity_mps.copy()
    hits, hit_us = state.hits.copy(), state.hit_us.copy()
    fresh = []
    for point in points:
        distance = np.hypot(*(state.place_m - point).T)
        nearest = int(np.argmin(distance)) if len(distance) else -1
        if nearest < 0 or distance[nearest] > GATE_M:
            fresh.append(point)
        elif hit_us[nearest] < frame.time_us:
            dt_s = (frame.time_us - hit_us[nearest]) / 1e6
            velocity[nearest] += 0.5 * (point - state.place_m[nearest]) / dt_s
            place[nearest] = point
            hits[nearest] += 1
            hit_us[nearest] = frame.time_us
    born = np.array(fresh).reshape(-1, 2)
    count = len(born)
    time = np.full(count, frame.time_us, dtype=np.int64)
    state = SimpleState(
        number=np.append(state.number, np.arange(count) + state.next_number),
        place_m=np.concatenate([place, born]),
        velocity_mps=np.concatenate([velocity, np.zeros((count, 2))]),
        hits=np.append(hits, np.ones(count, dtype=np.int64)),
        born_us=np.append(state.born_us, time),
        hit_us=np.append(hit_us, time),
        next_number=state.next_number + count,
        time_us=frame.time_us,
    )
    state = _forget(state)
    return state, _estimates(state), StepReport(points=len(frame), born=count)


def coast(state: SimpleState, time_us: int, parameters: TrackerParameters):
    assert time_us > state.time_us, "time must go on"
    state = _forget(_predict(state, time_us))
    return state, _estimates(state), StepReport()


def _predict(state: SimpleState, time_us: int) -> SimpleState:
    dt_s = (time_us - state.time_us) / 1e6 if state.time_us else 0.0
    return replace(state, place_m=state.place_m + dt_s * state.velocity_mps, time_us=time_us)


def _forget(state: SimpleState) -> SimpleState:
    stay = state.time_us - state.hit_us <= PATIENCE_US
    columns = ("number", "place_m", "velocity_mps", "hits", "born_us", "hit_us")
    return replace(state, **{name: getattr(state, name)[stay] for name in columns})


def _estimates(state: SimpleState) -> TrackEstimates:
    listed = state.hits >= CONFIRM_HITS
    x, y = state.place_m[listed].T.astype(np.float32)
    vx, vy = state.velocity_mps[listed].T.astype(np.float32)
    ones = np.ones(len(x), dtype=np.float32)
    coasting = state.hit_us[listed] < state.time_us
    return TrackEstimates(
        number=state.number[listed],
        x_m=x,
        y_m=y,
        vx_mps=vx,
        vy_mps=vy,
        std_x_m=ones * np.float32(0.2),
        std_y_m=ones * np.float32(0.3),
        cov_xy_m2=ones * np.float32(0.0),
        heading_rad=np.arctan2(vx, vy),
        length_m=np.where(state.hits[listed] > 4, ones * np.float32(4.5), np.float32(np.nan)),
        width_m=ones * np.float32(np.nan),
        existence=ones,
        status=np.where(coasting, TrackStatus.COASTING, TrackStatus.CONFIRMED).astype(np.uint8),
        lane=np.zeros(len(x), dtype=np.uint8),
        motion=np.zeros(len(x), dtype=np.uint8),
        hits=state.hits[listed],
        born_us=state.born_us[listed],
    )
