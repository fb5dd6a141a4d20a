"""Every foreseen failure is a sentence on standard error and an exit code."""

from __future__ import annotations

import pytest
import typer

from service.cli.edge import FAILED, INTERRUPTED, WRONG_INPUT, one_sentence
from service.errors import Conflict, FieldError, InvalidInput, NotFound, StorageError


@pytest.mark.parametrize(
    ("error", "code", "sentence"),
    [
        (InvalidInput("site.json: /rate_hz: too small"), WRONG_INPUT, "site.json: /rate_hz: too small"),
        (NotFound("no sensor radar-9"), WRONG_INPUT, "no sensor radar-9"),
        (Conflict("sensor radar-1 exists already"), FAILED, "sensor radar-1 exists already"),
        (StorageError("the database is newer"), FAILED, "the database is newer"),
        (PermissionError(13, "Permission denied", "/data"), FAILED, "/data: Permission denied"),
        (KeyboardInterrupt(), INTERRUPTED, ""),
    ],
)
def test_an_error_becomes_its_sentence_and_code(error, code, sentence, capsys):
    with pytest.raises(typer.Exit) as stopped, one_sentence():
        raise error

    assert stopped.value.exit_code == code
    assert capsys.readouterr().err.strip() == sentence


def test_every_wrong_field_is_told_once(capsys):
    faults = (FieldError("/a", "too small"), FieldError("/b", "missing"))
    with pytest.raises(typer.Exit), one_sentence():
        raise InvalidInput("site.json: /a: too small", faults)

    assert capsys.readouterr().err.splitlines() == ["site.json: /a: too small", "/b: missing"]


def test_an_unforeseen_error_keeps_its_traceback():
    with pytest.raises(ZeroDivisionError), one_sentence():
        _ = 1 / 0
