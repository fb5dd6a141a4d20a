"""What a filter estimates and how it is seen: the state, its motion, its sensor, for any size of either.

The live tracker has one space (`road`): six states, range, azimuth and range rate. The studies of the papers
have others, and every filter that takes a `Space` works in all of them. Leading dimensions of every array are
batch dimensions: tracks, Monte Carlo runs, models of an IMM.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from service.tracking.geometry import wrap_angle
from service.tracking.measurement import AZIMUTH, RANGE, RANGE_RATE, linearise
from service.tracking.model import F64
from service.tracking.motion import STATES, constant_acceleration, constant_velocity

ROAD_COLUMNS = (0, 1, 3, 4)  # x, vx, y, vy of [x vx ax y vy ay]
ROAD_AXES = ((0, 1, 2), (3, 4, 5))
PLANE_COLUMNS = (0, 1, 2, 3)  # ... of [x vx y vy], with anything behind
PLANE_AXES = ((0, 1), (2, 3))


class Step(Protocol):
    """The motion from one measurement to the next."""

    @property
    def Q(self) -> F64:  # noqa: N802 - the textbook's name
        """The process noise (n, n) or (..., n, n)."""
        ...

    def move(self, mean: F64, cov: F64) -> tuple[F64, F64]:
        """Return the moved mean (..., n) and the moved covariance F P F' (..., n, n), without the noise."""
        ...


class Sensor(Protocol):
    """What of the state is measured."""

    @property
    def channels(self) -> int:
        """Values per measurement, m."""
        ...

    def predict(self, states: F64) -> F64:
        """Return the measurement (..., m) of the states (..., n)."""
        ...

    def linearise(self, states: F64) -> tuple[F64, F64]:
        """Return the measurement (..., m) and its derivative (..., m, n)."""
        ...

    def difference(self, z: F64, z_hat: F64) -> F64:
        """Return z - z_hat (..., m), angles wrapped to (-pi, pi]."""
        ...

    def to_axes(self, e: F64, S: F64, z_hat: F64) -> tuple[F64, F64]:
        """Return the innovation e (..., m) and its covariance S (..., m, m) in Cartesian axes.

        Shapes (..., A) and (..., A, A); a channel that was not measured has zeros in e.
        """
        ...


@dataclass(frozen=True, slots=True)
class Space:
    """States, motion and sensor of a filter."""

    motion: Callable[[float], Step]  # by the time step in seconds
    sensor: Sensor
    axes: tuple[tuple[int, ...], ...]  # the states of each Cartesian axis; a state may be in none

    def axis_of_state(self, states: int) -> F64:
        """Return (A, n) with a one where a state belongs to an axis."""
        member = np.zeros((len(self.axes), states))
        for axis, columns in enumerate(self.axes):
            member[axis, list(columns)] = 1.0
        return member


def scale_axes(cov: F64, factor: F64, space: Space) -> F64:
    """Return D^1/2 C D^1/2 (..., n, n) with a factor for each axis (..., A); states of no axis stay."""
    member = space.axis_of_state(cov.shape[-1])
    root = np.sqrt(1.0 + ((factor - 1.0)[..., None] * member).sum(axis=-2))
    return np.asarray((root[..., :, None] * root[..., None, :]) * cov)


@dataclass(frozen=True, slots=True)
class LinearStep:
    """x' = F x + w, w ~ N(0, Q), of any size; F and Q may have batch dimensions."""

    F: F64
    Q: F64

    def move(self, mean: F64, cov: F64) -> tuple[F64, F64]:
        """Return F x and F P F', exactly symmetric."""
        moved = self.F @ cov @ self.F.swapaxes(-1, -2)
        return (self.F @ mean[..., None])[..., 0], (moved + moved.swapaxes(-1, -2)) * 0.5


@dataclass(frozen=True, slots=True)
class PolarSensor:
    """Range, azimuth and, with Doppler, range rate of a point in the plane; see `tracking.measurement`."""

    columns: tuple[int, int, int, int] = PLANE_COLUMNS  # of x, vx, y, vy in the state
    doppler: bool = True

    @property
    def channels(self) -> int:
        """Values per measurement."""
        return RANGE_RATE + 1 if self.doppler else RANGE_RATE

    def predict(self, states: F64) -> F64:
        """Return range, azimuth (and range rate) of the states."""
        return linearise(self._on_road(states))[0][..., : self.channels]

    def linearise(self, states: F64) -> tuple[F64, F64]:
        """Return the measurement and its derivative."""
        z, on_road = linearise(self._on_road(states))
        if states.shape[-1] == STATES and self.columns == ROAD_COLUMNS:
            return z[..., : self.channels], on_road[..., : self.channels, :]
        H = np.zeros((*states.shape[:-1], self.channels, states.shape[-1]))
        H[..., list(self.columns)] = on_road[..., : self.channels, list(ROAD_COLUMNS)]
        return z[..., : self.channels], H

    def difference(self, z: F64, z_hat: F64) -> F64:
        """Return z - z_hat with the azimuth wrapped."""
        e = z - z_hat
        e[..., AZIMUTH] = wrap_angle(e[..., AZIMUTH])
        return e

    def to_axes(self, e: F64, S: F64, z_hat: F64) -> tuple[F64, F64]:
        """Return the innovation and its covariance in x and y.

        A measured range rate, many times sharper than the range, stands for it: it is scaled to the standard
        deviation of the range.
        """
        radial, r, azimuth = e[..., RANGE], z_hat[..., RANGE], z_hat[..., AZIMUTH]
        if self.doppler:
            used = e[..., RANGE_RATE] != 0.0
            variance = np.where(used, S[..., RANGE_RATE, RANGE_RATE], 1.0)
            scaled = e[..., RANGE_RATE] * np.sqrt(S[..., RANGE, RANGE] / variance)
            radial = np.where(used, scaled, radial)
        s, c = np.sin(azimuth), np.cos(azimuth)
        T = np.stack([np.stack([s, r * c], -1), np.stack([c, -r * s], -1)], -2)
        planar = np.stack([radial, e[..., AZIMUTH]], -1)
        return (T @ planar[..., None])[..., 0], T @ S[..., :2, :2] @ T.swapaxes(-1, -2)

    def _on_road(self, states: F64) -> F64:
        if states.shape[-1] == STATES and self.columns == ROAD_COLUMNS:
            return states
        on_road = np.zeros((*states.shape[:-1], STATES))
        on_road[..., list(ROAD_COLUMNS)] = states[..., list(self.columns)]
        return on_road


ROAD_SENSOR = PolarSensor(ROAD_COLUMNS)


def road(accel_std_mps2: float, accel_tau_s: float | None) -> Space:
    """Return the space of the live tracker: damped constant acceleration, [x vx ax y vy ay]."""
    return Space(
        lambda dt_s: constant_acceleration(dt_s, accel_std_mps2, accel_tau_s), ROAD_SENSOR, ROAD_AXES
    )


def steady_road(density_m2ps3: float) -> Space:
    """Return the space of the live tracker under constant velocity; its accelerations are idle."""
    return Space(lambda dt_s: constant_velocity(dt_s, density_m2ps3), ROAD_SENSOR, ROAD_AXES)


def plane(accel_std_mps2: float, *, doppler: bool) -> Space:
    """Return the space [x vx y vy] under constant velocity with a random acceleration in each step."""
    return Space(
        lambda dt_s: velocity_step(dt_s, accel_std_mps2), PolarSensor(PLANE_COLUMNS, doppler), PLANE_AXES
    )


def velocity_step(dt_s: float, accel_std_mps2: float, turn_rate_radps: float = 0.0) -> LinearStep:
    """Return the step of [x vx y vy], straight or on a circle, with a random acceleration held over the step.

    Q = sigma^2 G G' per axis, G = [T^2/2, T].  A positive turn rate turns from +x to +y.
    Source: Bar-Shalom, Li, Kirubarajan 2001, sections 6.3.2 and 11.7.1.
    """
    angle = turn_rate_radps * dt_s
    s, c = np.sin(angle), np.cos(angle)
    along, across = dt_s, 0.5 * dt_s * angle
    if abs(angle) > np.sqrt(np.finfo(np.float64).eps):
        along, across = s / turn_rate_radps, (1.0 - c) / turn_rate_radps
    F = np.array([[1, along, 0, -across], [0, c, 0, -s], [0, across, 1, along], [0, s, 0, c]], np.float64)
    G = np.array([dt_s * dt_s / 2.0, dt_s])
    Q: F64 = accel_std_mps2**2 * np.kron(np.eye(2), np.outer(G, G)).astype(np.float64)
    return LinearStep(F, Q)
