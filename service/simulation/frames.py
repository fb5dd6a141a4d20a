"""From a moving scene and a radar to frames on the wire, each with the truth behind it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from service.simulation.radar import Observation, Radar
from service.simulation.vehicles import VehicleStates
from service.tracking.model import F64, I64, Frame

US = 1_000_000
MS_US = 1_000
RANGE_DECIMALS, AZIMUTH_DECIMALS, VELOCITY_DECIMALS, SNR_DECIMALS = 2, 2, 2, 1  # of metres, degrees, m/s, dB


@dataclass(frozen=True, slots=True)
class SimulatedFrame:
    """A frame of N detections, the V vehicles on the road at its time, and who caused which detection."""

    frame: Frame
    vehicles: VehicleStates
    points: I64  # (V,) detections whose strongest part came from the vehicle
    visible: F64  # (V,) share of its faces towards the radar that is not shadowed
    source: I64  # (N,) vehicle id, 0 standing clutter, -1 false alarm, -2 ghost


def simulate_frames(
    states_after: Callable[[float], VehicleStates | None],
    radar: Radar,
    rng: np.random.Generator,
    *,
    start_us: int,
    sensor_id: str,
) -> Iterator[SimulatedFrame]:
    """Yield the frames that get through, until the scene ends.

    `states_after(time_s)` moves the scene to a time since the start and returns its vehicles, None at the
    end; times grow. `rng` decides on jitter and dropped frames; these leave a gap in `frame.sequence`.
    """
    p = radar.parameters
    last_s, number = -1 / p.rate_hz, 0
    while True:
        jitter_s = (
            float(np.clip(rng.normal(0.0, p.jitter_s), -p.jitter_most_s, p.jitter_most_s))
            if p.jitter_s
            else 0.0
        )
        # timestamps have milliseconds on the wire, and the truth is that of the timestamp
        time_ms = max(round((number / p.rate_hz + jitter_s) * MS_US), 0)
        vehicles = states_after(time_ms / MS_US)
        if vehicles is None:
            return
        observation = radar.observe(vehicles, time_ms / MS_US - last_s)
        last_s = time_ms / MS_US
        if rng.random() >= p.drop_probability:
            frame = to_frame(
                observation, time_us=start_us + time_ms * MS_US, sequence=number, sensor_id=sensor_id
            )
            yield SimulatedFrame(frame, vehicles, observation.points, observation.visible, observation.source)
        number += 1


def to_frame(observation: Observation, *, time_us: int, sequence: int, sensor_id: str) -> Frame:
    """Return the observation as a frame, rounded as the sensor writes it."""
    azimuth_deg = np.round(np.degrees(observation.azimuth_rad), AZIMUTH_DECIMALS)
    return Frame(
        sensor_id=sensor_id,
        time_us=time_us,
        sequence=sequence,
        boot_id=None,
        range_m=np.round(observation.range_m, RANGE_DECIMALS).astype(np.float32),
        azimuth_rad=np.radians(azimuth_deg).astype(np.float32),
        radial_velocity_mps=np.round(observation.radial_velocity_mps, VELOCITY_DECIMALS).astype(np.float32),
        snr_db=np.round(observation.snr_db, SNR_DECIMALS).astype(np.float32),
    )
