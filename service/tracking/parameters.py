"""Every constant of the tracking core: its unit, its default and where it comes from.

`SensorModel` is what an installer knows of the radar; `TrackerParameters` is how the tracker works. Both are
frozen values: a change is a new value (`with_setting`), and `digest` names one set of values for good.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import types
import typing
from dataclasses import dataclass, field

from service.errors import InvalidInput


@dataclass(frozen=True, slots=True)
class SensorModel:
    """The radar as mounted: geometry, noise, resolution and the region in which it sees."""

    rate_hz: float = 20.0
    mount_height_m: float = 6.0
    scatter_height_m: float = 0.6  # height above the road of most echoes
    azimuth_offset_rad: float = 0.0  # added to each measured azimuth
    range_min_m: float = 20.0
    range_max_m: float = 150.0
    azimuth_max_rad: float = math.radians(45.0)
    range_resolution_m: float = 0.75
    velocity_resolution_mps: float = 0.25
    azimuth_resolution_rad: float = math.radians(1.5)
    range_std_m: float = 0.15  # standard deviations at `noise_snr_db`
    velocity_std_mps: float = 0.10
    azimuth_std_rad: float = math.radians(0.3)
    azimuth_floor_rad: float = math.radians(0.1)  # the azimuth never gets better than this
    noise_snr_db: float = 20.0
    detection_threshold_db: float = 12.0


@dataclass(frozen=True, slots=True)
class TrackerParameters:
    """How the tracker works; one set of defaults serves every road."""

    sensor: SensorModel = field(default_factory=SensorModel)
    filter: str = "astekf"  # name in service.tracking.filters.registry

    def with_setting(self, key: str, text: str) -> TrackerParameters:
        """Return a copy with one dotted key set from its text, such as ("clustering.window_frames", "6").

        Raises InvalidInput naming the key when it does not exist or the text does not fit its type.
        """
        return _with_setting(self, key, key.split("."), text)

    def as_dict(self) -> dict[str, object]:
        """Return the parameters as nested plain values."""
        return dataclasses.asdict(self)

    def digest(self) -> str:
        """Return twelve hex digits that name this set of values."""
        text = json.dumps(self.as_dict(), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:12]


def _with_setting(group: TrackerParameters, key: str, path: list[str], text: str) -> TrackerParameters:
    return typing.cast("TrackerParameters", _set(group, key, path, text))


def _set(group: object, key: str, path: list[str], text: str) -> object:
    names = {f.name for f in dataclasses.fields(group)}  # type: ignore[arg-type]
    head, rest = path[0], path[1:]
    if head not in names:
        raise InvalidInput.at(f"/{key}", f"no such parameter; {head!r} is not one of {', '.join(sorted(names))}")
    value = getattr(group, head)
    if dataclasses.is_dataclass(value):
        if not rest:
            raise InvalidInput.at(f"/{key}", "names a group of parameters, not one of them")
        return dataclasses.replace(group, **{head: _set(value, key, rest, text)})  # type: ignore[type-var]
    if rest:
        raise InvalidInput.at(f"/{key}", f"{head!r} is a value, not a group")
    kind = typing.get_type_hints(type(group))[head]
    return dataclasses.replace(group, **{head: _parse(kind, key, text)})  # type: ignore[type-var]


def _parse(kind: object, key: str, text: str) -> object:
    optional = isinstance(kind, types.UnionType)
    kinds = typing.get_args(kind) if optional else (kind,)
    if type(None) in kinds and text.lower() in {"none", "null"}:
        return None
    target = next(k for k in kinds if k is not type(None))
    if target is bool:
        if text.lower() not in {"true", "false"}:
            raise InvalidInput.at(f"/{key}", f"want true or false, got {text!r}")
        return text.lower() == "true"
    try:
        value = target(text)
    except ValueError:
        raise InvalidInput.at(f"/{key}", f"want {target.__name__}, got {text!r}") from None
    if isinstance(value, float) and not math.isfinite(value):
        raise InvalidInput.at(f"/{key}", f"want a finite number, got {text!r}")
    return value
