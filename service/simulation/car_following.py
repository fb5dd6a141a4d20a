"""The intelligent driver model: the acceleration that a driver chooses behind a leader.

Source: Treiber, Hennecke, Helbing 2000, "Congested traffic states in empirical observations and microscopic
simulations", Phys. Rev. E 62, eqs. (2), (3); braking down to a lower wanted speed is bounded to the
comfortable one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.tracking.model import F64, I64, Bool

EXPONENT = 4  # of the free-road term, the paper's value
HARDEST_BRAKING_MPS2 = 8.0  # dry road
SMALLEST_GAP_M = 0.1  # keeps the interaction term finite when bumpers touch
FAR_M = 1e6  # gap of a vehicle without leader


@dataclass(frozen=True, slots=True)
class Driver:
    """The drivers' values, one column each."""

    wanted_speed_mps: F64
    acceleration_mps2: F64
    deceleration_mps2: F64
    headway_s: F64
    standstill_gap_m: F64

    def take(self, index: I64 | Bool) -> Driver:
        """Return the drivers that an index or a mask picks."""
        return Driver(
            self.wanted_speed_mps[index],
            self.acceleration_mps2[index],
            self.deceleration_mps2[index],
            self.headway_s[index],
            self.standstill_gap_m[index],
        )


def idm_acceleration(driver: Driver, speed_mps: F64, gap_m: F64, leader_speed_mps: F64) -> F64:
    """Return the acceleration for a bumper-to-bumper gap and the leader's speed; all (V,)."""
    a, b = driver.acceleration_mps2, driver.deceleration_mps2
    free = np.maximum(a * (1 - (speed_mps / driver.wanted_speed_mps) ** EXPONENT), -b)
    closing = speed_mps * (speed_mps - leader_speed_mps) / (2 * np.sqrt(a * b))
    wanted_gap = driver.standstill_gap_m + np.maximum(speed_mps * driver.headway_s + closing, 0.0)
    interaction = a * (wanted_gap / np.maximum(gap_m, SMALLEST_GAP_M)) ** 2
    return np.asarray(np.maximum(free - interaction, -HARDEST_BRAKING_MPS2))


def advance(speed_mps: F64, acceleration_mps2: F64, dt_s: float) -> tuple[F64, F64]:
    """Return the distance travelled and the new speed after `dt_s`; a braking vehicle stops and stays."""
    new_speed = np.maximum(speed_mps + acceleration_mps2 * dt_s, 0.0)
    stops = speed_mps + acceleration_mps2 * dt_s < 0
    braking = np.where(stops, -acceleration_mps2, 1.0)
    distance = np.where(stops, speed_mps**2 / (2 * braking), (speed_mps + new_speed) / 2 * dt_s)
    return distance, new_speed
