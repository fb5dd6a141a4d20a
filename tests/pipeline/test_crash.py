from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from sqlalchemy import Engine, select

from service.storage.database import connection, open_database
from service.storage.events import list_events
from service.storage.tables import crossing_blocks, track_states, tracks, traffic_minutes
from service.traffic.records import CROSSING
from tests.pipeline.crash_host import FRAMES

ROOT = Path(__file__).parents[2]


def start_host(data_dir: Path, first: int, last: int = FRAMES, processes: int = 0) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "tests.pipeline.crash_host"]
    arguments = [str(data_dir), str(first), str(last), str(processes)]
    return subprocess.Popen(
        [*command, *arguments], cwd=ROOT, stdout=subprocess.PIPE, text=True, start_new_session=True
    )


def finish(data_dir: Path, first: int, last: int = FRAMES, processes: int = 0) -> list[str]:
    """Post the frames in a process that ends by itself, and return what was said of each."""
    with start_host(data_dir, first, last, processes) as process:
        text, _ = process.communicate(timeout=180)
    assert process.returncode == 0
    return [line.split()[1] for line in text.splitlines()]


def post_and_kill(data_dir: Path, first: int, after: int, processes: int, *, whole_group: bool) -> int:
    """Post from `first` on, kill once frame `after` is durable, return the newest told of.

    whole_group: the tracker processes are killed in the same moment; else they have to end by themselves.
    """
    with start_host(data_dir, first, processes=processes) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if int(line.split()[0]) >= after:
                break
        if whole_group:
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
        rest = [line for line in process.stdout.read().splitlines() if line.count(" ") == 1]
    return int((rest[-1] if rest else line).split()[0])


def rows_of(data_dir: Path) -> tuple[list, list, list, list]:
    engine: Engine = open_database(f"sqlite:///{data_dir}/rows.sqlite")
    with connection(engine) as reader:
        summaries = [tuple(row) for row in reader.execute(tracks.select().order_by(tracks.c.number))]
        order = (track_states.c.number, track_states.c.second)
        blocks = [tuple(row) for row in reader.execute(track_states.select().order_by(*order))]
        events = list(list_events(reader, "radar-1").items)
        counts = [
            tuple(row)
            for table in (crossing_blocks, traffic_minutes)
            for row in reader.execute(select(*(c for c in table.c if c.name != "as_of")).order_by("minute"))
        ]
    engine.dispose()
    return summaries, blocks, events, counts


@pytest.mark.slow
@pytest.mark.parametrize(("processes", "whole_group"), [(0, False), (1, False), (1, True)])
def test_a_host_that_is_killed_while_frames_come_in_loses_none_and_doubles_none(
    tmp_path, processes, whole_group
):
    through = finish(tmp_path / "whole", 1)
    assert through == ["accepted"] * FRAMES

    newest = post_and_kill(tmp_path / "killed", 1, 130, processes, whole_group=whole_group)
    newest = post_and_kill(tmp_path / "killed", newest + 1, 250, processes, whole_group=whole_group)
    said = finish(tmp_path / "killed", newest + 1, processes=processes)

    # The frame after the last one told of may have become durable before the process could say so.
    assert set(said) <= {"accepted", "duplicate"}
    assert said[1:] == ["accepted"] * (len(said) - 1)
    whole, killed = rows_of(tmp_path / "whole"), rows_of(tmp_path / "killed")
    assert without_position(killed[0]) == without_position(whole[0])
    assert killed[1:] == whole[1:]
    assert killed[2] == []
    crossed = sum(len(row[-1]) // CROSSING.itemsize for row in killed[3] if isinstance(row[-1], bytes))
    assert crossed == 2  # both vehicles, each once


def without_position(summaries: list) -> list:
    as_of = list(tracks.c.keys()).index("as_of")  # a repeated frame moves it
    return [row[:as_of] + row[as_of + 1 :] for row in summaries]
