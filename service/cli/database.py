"""Find the settings and open the database that a command works on."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from pydantic import ValidationError

from service.errors import InvalidInput
from service.settings import Settings

if TYPE_CHECKING:
    from sqlalchemy import Engine


def read_settings(**given: object) -> Settings:
    """Return the settings of the environment with what the command line names (not None) on top.

    Raises InvalidInput naming the setting that does not fit.
    """
    try:
        return Settings.model_validate({**Settings().model_dump(), **_named(given)})
    except ValidationError as error:
        first = error.errors()[0]
        name = "_".join(map(str, first["loc"])).upper()
        raise InvalidInput(f"WAYSIDE_{name}: {first['msg']}") from None


def open_rows(settings: Settings) -> Engine:
    """Return the database of rows, brought up to the schema of this version."""
    from service.storage import migrate
    from service.storage.database import open_database

    engine = open_database(settings.rows_url)
    migrate.upgrade(engine)
    return engine


def now_us() -> int:
    """Return the time of the machine in microseconds since 1970."""
    return time.time_ns() // 1000


def _named(given: dict[str, object]) -> dict[str, object]:
    return {name: value for name, value in given.items() if value is not None}
