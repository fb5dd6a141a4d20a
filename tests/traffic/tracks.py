"""Make the estimates of tracks that traffic analysis is given, frame by frame."""

from __future__ import annotations

import numpy as np

from service.tracking.model import TrackEstimates, TrackStatus

START_US = 1_747_029_600_000_000
FRAME_US = 50_000


def estimates(number, x_m, y_m, vx_mps, vy_mps, *, status=TrackStatus.CONFIRMED, std_m=0.2) -> TrackEstimates:
    """Confirmed cars at these places; every argument is one value a track, or one for all."""
    number = np.atleast_1d(np.asarray(number, dtype=np.int64))
    count = len(number)

    def column(values) -> np.ndarray:
        return np.broadcast_to(np.asarray(values, dtype=np.float32), count).copy()

    vx, vy = column(vx_mps), column(vy_mps)
    return TrackEstimates(
        number=number, x_m=column(x_m), y_m=column(y_m), vx_mps=vx, vy_mps=vy,
        std_x_m=column(std_m), std_y_m=column(std_m), cov_xy_m2=column(0.0),
        heading_rad=np.arctan2(vx, vy), length_m=column(4.5), width_m=column(1.9), existence=column(0.99),
        status=np.broadcast_to(np.uint8(status), count).copy(), lane=np.zeros(count, dtype=np.uint8),
        motion=np.zeros(count, dtype=np.uint8), hits=np.full(count, 50), born_us=np.full(count, START_US),
    )  # fmt: skip
