"""Named sets of the tracker's parameters: less work, the default, and all that more work buys.

A profile changes a few values of the default configuration and nothing else; docs/tracker.md has what each
costs and gains. Settings of one's own go on top of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from service.errors import InvalidInput
from service.tracking.parameters import SensorModel, TrackerParameters

DEFAULT = "default"
PROFILES: Mapping[str, Mapping[str, str]] = MappingProxyType({
    "fast": {"clustering.window_frames": "2", "birth.standing_interval_frames": "10"},
    DEFAULT: {},
    "quality": {"clustering.window_frames": "6"},
})  # fmt: skip


def profile_parameters(name: str, sensor: SensorModel, filter_name: str) -> TrackerParameters:
    """Return a profile's parameters for a sensor and a filter; raises InvalidInput for an unknown profile."""
    if name not in PROFILES:
        raise InvalidInput.at("/profile", f"want {', '.join(PROFILES)}, got {name!r}")
    parameters = TrackerParameters(sensor=sensor, filter=filter_name, profile=name)
    for key, value in PROFILES[name].items():
        parameters = parameters.with_setting(key, value)
    return parameters
