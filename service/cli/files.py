"""Read a site file with the settings of the command line, and write results whole or not at all."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from pydantic import ValidationError

from service.errors import FieldError, InvalidInput
from service.formats.sensor import SensorConfig
from service.tracking.filters.registry import make_filter

PARTIAL = ".partial"  # suffix of a file that is not finished


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


@contextmanager
def written_together(
    directory: Path, names: Sequence[str], *, force: bool = False
) -> Iterator[dict[str, Path]]:
    """Yield for each file name a path to write to; at the end all take their names, on an error all vanish.

    The last name is the one whose presence says that the results are complete. Raises InvalidInput when the
    directory holds anything else and `force` is not set.
    """
    _prepare(directory, names, force=force)
    paths = {name: directory / f"{name}{PARTIAL}" for name in names}
    try:
        yield paths
        (directory / names[-1]).unlink(missing_ok=True)
        for name in names:
            paths[name].replace(directory / name)
    finally:
        for path in paths.values():
            path.unlink(missing_ok=True)


def _prepare(directory: Path, names: Sequence[str], *, force: bool) -> None:
    if directory.exists() and not directory.is_dir():
        raise InvalidInput(f"{directory} is a file; --out wants a folder")
    directory.mkdir(parents=True, exist_ok=True)
    ours = {*names, *(f"{name}{PARTIAL}" for name in names)}
    others = sorted(path.name for path in directory.iterdir() if path.name not in ours)
    if others and not force:
        raise InvalidInput(
            f"{directory} holds other things ({others[0]}, ...); name another folder or add --force"
        )


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
