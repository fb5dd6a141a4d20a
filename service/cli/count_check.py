"""`wayside count-check`: hold counts by hand against the measured volumes."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli import options
from service.cli.database import now_us, open_rows, read_settings
from service.cli.edge import one_sentence
from service.cli.output import print_json, print_rows, provenance
from service.errors import InvalidInput

if TYPE_CHECKING:
    from service.api.flow_schemas import ManualCountInput

COLUMNS = (
    "start",
    "interval_s",
    "line_id",
    "lane_id",
    "direction",
    "length_class",
    "counted",
    "measured",
    "difference",
    "relative_error",
    "geh",
    "coverage",
)


@one_sentence()
def count_check(
    sensor_id: Annotated[str, typer.Argument(metavar="SENSOR", help="Id of the sensor.")],
    counts: Annotated[
        Path,
        typer.Argument(
            metavar="COUNTS.csv",
            help="Columns line_id, start, counted; may have interval_s, lane_id, direction, length_class.",
        ),
    ],
    *,
    data_dir: options.DataDir = None,
    database: options.Database = None,
    as_json: options.Json = False,
) -> None:
    """Keep counts by hand and print difference, relative error and GEH of each interval."""
    from service.api.flow_views import check_fields, manual_counts_of
    from service.storage.database import session_scope
    from service.storage.manual_counts import compare, save_manual_counts

    manual = manual_counts_of(_read(counts))
    engine = open_rows(read_settings(data_dir=data_dir, database_url=database))
    with session_scope(engine) as connection:
        save_manual_counts(connection, sensor_id, manual, now_us=now_us())
        rows = [check_fields(checked) for checked in compare(connection, sensor_id, manual)]
    if as_json:
        print_json(provenance() | {"sensor_id": sensor_id, "checks": rows})
        return
    print_rows(COLUMNS, rows, title=f"Counts by hand beside {sensor_id}")
    known = [row for row in rows if row["within_target"] is not None]
    good = sum(bool(row["within_target"]) for row in known)
    typer.echo(f"{good} of {len(known)} with GEH below 5; {len(rows) - len(known)} without measurement")


def _read(path: Path) -> list[ManualCountInput]:
    """Return the counts of a CSV file; raises InvalidInput with the line."""
    from pydantic import ValidationError

    from service.api.flow_schemas import ManualCountInput

    found = []
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            for line, row in enumerate(csv.DictReader(file), start=2):
                values = {name: text.strip() for name, text in row.items() if name and text and text.strip()}
                try:
                    found.append(ManualCountInput.model_validate(_numbers(values)))
                except (ValidationError, ValueError) as error:
                    raise InvalidInput(f"{path}, line {line}: {_first(error)}") from None
    except OSError as error:
        raise InvalidInput(f"{path}: {error.strerror or error}") from None
    if not found:
        raise InvalidInput(f"{path} holds no counts; want a header with line_id,start,counted")
    return found


def _numbers(values: dict[str, str]) -> dict[str, object]:
    return {
        name: int(text) if name in {"interval_s", "direction", "counted"} else text
        for name, text in values.items()
    }


def _first(error: Exception) -> str:
    from pydantic import ValidationError

    if isinstance(error, ValidationError):
        fault = error.errors()[0]
        return f"{'.'.join(map(str, fault['loc']))}: {fault['msg']}"
    return str(error)
