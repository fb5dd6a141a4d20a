"""Turn positions in a sensor's plan frame into longitude and latitude (WGS84), by the sensor's pose."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from pyproj import Transformer

from service.formats.sensor import SensorConfig
from service.tracking.model import F64


@dataclass(frozen=True, slots=True)
class Pose:
    """Where the plan frame's origin lies and where its y axis points."""

    latitude_deg: float
    longitude_deg: float
    heading_deg: float  # of the boresight, clockwise from north


def pose_of(config: SensorConfig) -> Pose | None:
    """Return the sensor's pose, None where its place is not known."""
    if config.latitude_deg is None or config.longitude_deg is None:
        return None
    return Pose(config.latitude_deg, config.longitude_deg, config.heading_deg)


def to_east_north(pose: Pose, x_m: F64, y_m: F64) -> tuple[F64, F64]:
    """Return east and north of the sensor in metres, shape (N,): the plan frame turned by the heading."""
    heading_rad = math.radians(pose.heading_deg)
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    return x_m * cos + y_m * sin, y_m * cos - x_m * sin


def to_wgs84(pose: Pose, x_m: F64, y_m: F64) -> tuple[F64, F64]:
    """Return longitude and latitude in degrees, shape (N,), rounded to 1e-8 (about a millimetre).

    Source: azimuthal equidistant projection about the sensor, which keeps distance and direction from it.
    """
    east_m, north_m = to_east_north(pose, x_m, y_m)
    longitude, latitude = _projection(pose.latitude_deg, pose.longitude_deg).transform(east_m, north_m)
    return np.round(longitude, 8) + 0.0, np.round(latitude, 8) + 0.0


@lru_cache(maxsize=256)
def _projection(latitude_deg: float, longitude_deg: float) -> Transformer:
    """Return the map from metres east and north to degrees; a Transformer may be shared between threads."""
    return Transformer.from_pipeline(
        f"+proj=pipeline +step +inv +proj=aeqd +lat_0={latitude_deg!r} +lon_0={longitude_deg!r} +ellps=WGS84 "
        "+step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
