"""Read a site file, with the settings of the command line on top."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pydantic import ValidationError

from service.errors import FieldError, InvalidInput
from service.formats.sensor import SensorConfig
from service.tracking.filters.registry import make_filter


def read_site(path: Path, filter_name: str | None = None, settings: Sequence[str] = ()) -> SensorConfig:
    """Return the sensor of SITE.json with the filter and KEY=VALUE settings of the command line on top.

    Raises InvalidInput for an unreadable file, an unknown parameter or a value that does not fit.
    """
    try:
        config = SensorConfig.model_validate_json(path.read_bytes())
    except OSError as error:
        raise InvalidInput(f"{path}: {error.strerror or error}") from None
    except ValidationError as error:
        raise InvalidInput(f"{path}: {_first(error)}", _fields(error)) from None
    changes: dict[str, object] = {"parameters": config.parameters | dict(_setting(text) for text in settings)}
    if filter_name is not None:
        changes["filter"] = filter_name
    config = config.model_copy(update=changes)
    make_filter(config.filter)  # names a wrong filter, key or value now, before any work
    config.tracker_parameters()
    return config


def _setting(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not equals or not key:
        raise InvalidInput(f"--set wants KEY=VALUE, got {text!r}")
    return key.strip(), value.strip()


def _fields(error: ValidationError) -> list[FieldError]:
    return [FieldError("/" + "/".join(map(str, part["loc"])), part["msg"]) for part in error.errors()]


def _first(error: ValidationError) -> str:
    first = _fields(error)[0]
    return f"{first.pointer}: {first.reason}" if first.pointer != "/" else first.reason
