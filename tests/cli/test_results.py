"""Results appear whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from service.cli.results import written_together
from service.errors import InvalidInput

NAMES = ("tracks.jsonl", "summary.json")


def write_each(folder: Path, text: str) -> None:
    for name in NAMES:
        (folder / name).write_text(text)


def contents(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir()}


def test_results_take_their_places_together(tmp_path):
    out = tmp_path / "deep" / "out"

    with written_together(out, NAMES) as folder:
        write_each(folder, "done")
        assert [path for path in out.iterdir() if path.is_file()] == []

    assert contents(out) == dict.fromkeys(NAMES, "done")


def test_a_failure_leaves_the_earlier_results(tmp_path):
    with written_together(tmp_path, NAMES) as folder:
        write_each(folder, "first")

    def fail_half_way():
        with written_together(tmp_path, NAMES) as folder:
            (folder / NAMES[0]).write_text("second")
            raise InvalidInput("line 17 is no frame")

    with pytest.raises(InvalidInput):
        fail_half_way()
    assert contents(tmp_path) == dict.fromkeys(NAMES, "first")


def test_what_a_killed_run_left_is_replaced(tmp_path):
    (tmp_path / ".unfinished").mkdir()
    (tmp_path / ".unfinished" / NAMES[0]).write_text("half")

    with written_together(tmp_path, NAMES) as folder:
        write_each(folder, "whole")

    assert contents(tmp_path) == dict.fromkeys(NAMES, "whole")


def test_a_folder_with_other_things_is_refused_unless_forced(tmp_path):
    (tmp_path / "thesis.tex").write_text("important")

    with pytest.raises(InvalidInput, match=r"thesis\.tex"), written_together(tmp_path, NAMES):
        pass
    with written_together(tmp_path, NAMES, force=True) as folder:
        write_each(folder, "done")

    assert contents(tmp_path) == {"thesis.tex": "important", **dict.fromkeys(NAMES, "done")}


def test_a_file_is_no_folder_for_results(tmp_path):
    (tmp_path / "out").write_text("")

    with pytest.raises(InvalidInput, match="is a file"), written_together(tmp_path / "out", NAMES):
        pass
