"""Read a site file, with the settings of the command line on top."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from service.errors import InvalidInput
from service.formats.sensor import SensorConfig
from service.pipeline.offline import read_site as read_config
from service.tracking.filters.registry import make_filter
from service.traffic.parameters import traffic_setup


def read_site(
    path: Path,
    filter_name: str | None = None,
    settings: Sequence[str] = (),
    profile: str | None = None,
) -> SensorConfig:
    """Return the sensor of SITE.json with profile, filter and KEY=VALUE settings of the command line on top.

    Raises InvalidInput for a file that is none, an unknown parameter or a value that does not fit.
    """
    try:
        config = read_config(path)
    except OSError as error:
        raise InvalidInput(f"{path}: {error.strerror or error}") from None
    except (InvalidInput, UnicodeDecodeError) as error:
        faults = error.errors if isinstance(error, InvalidInput) else ()
        raise InvalidInput(f"{path} is no site file: {error}", faults) from None
    return with_settings(config, filter_name, settings, profile)


def with_settings(
    config: SensorConfig,
    filter_name: str | None,
    settings: Sequence[str],
    profile: str | None = None,
) -> SensorConfig:
    """Return the configuration with another profile, filter and KEY=VALUE settings; raises InvalidInput."""
    changes: dict[str, object] = {"parameters": config.parameters | dict(setting(text) for text in settings)}
    if filter_name is not None:
        changes["filter"] = filter_name
    if profile is not None:
        changes["profile"] = profile
    config = config.model_copy(update=changes)
    # names a wrong filter, key or value now, before any work
    make_filter(config.filter, config.tracker_parameters().filters)
    traffic_setup(config)
    return config


def setting(text: str) -> tuple[str, str]:
    """Return key and value of KEY=VALUE; raises InvalidInput."""
    key, equals, value = text.partition("=")
    if not equals or not key:
        raise InvalidInput(f"--set wants KEY=VALUE, got {text!r}")
    return key.strip(), value.strip()
