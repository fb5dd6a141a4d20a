"""A small made-up road: vehicles on four lanes and a parked one, a point each, at the pace of life."""

from __future__ import annotations

import threading
import time
from typing import Self

import httpx

from service.formats.rfc3339 import format_time

SENSOR = "radar-1"
LANES = ((-5.0, -14.0), (-1.5, -12.0), (2.0, 11.0), (5.5, 15.0))  # x [m], speed along y [m/s]
DRIVING = 8
PARKED_M = (-9.0, 60.0)
VEHICLES = DRIVING + 1
FIRST_M, LAST_M = 25.0, 140.0
PERIOD_S = 0.05


def detections(elapsed_s):
    rows = [(*PARKED_M, 0.0)]
    for number in range(DRIVING):
        x_m, speed_mps = LANES[number % len(LANES)]
        start_m = number * (LAST_M - FIRST_M) / DRIVING
        y_m = FIRST_M + (start_m + speed_mps * elapsed_s) % (LAST_M - FIRST_M)
        rows.append((x_m, y_m, speed_mps))
    x_m, y_m, speed_mps = (list(column) for column in zip(*rows, strict=True))
    return {"x_m": x_m, "y_m": y_m, "radial_velocity_mps": speed_mps, "snr_db": [20.0] * len(rows)}


class RoadStream:
    """Posts frames from a thread until it is left."""

    def __init__(self, service, sensor_id=SENSOR, headers=None) -> None:
        self._url = f"{service.url}/api/v1/sensors/{sensor_id}/frames"
        self._headers = headers
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self.refusals = []

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_) -> None:
        self.stop()
        assert self.refusals == []

    def stop(self):
        self._ended.set()
        self._thread.join()

    def _run(self):
        begun_s, number = time.monotonic(), 0
        with httpx.Client(headers=self._headers) as client:
            while not self._ended.wait(max(0.0, begun_s + number * PERIOD_S - time.monotonic())):
                number += 1
                frame = {
                    "timestamp": format_time(time.time_ns() // 1000),
                    "frame": number,
                    "detections": detections(number * PERIOD_S),
                }
                reply = client.post(self._url, json=frame)
                if reply.status_code != 202:
                    self.refusals.append(reply.text)
