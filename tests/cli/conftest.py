"""A small simulated scene, and the command line in this process."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import structlog
from typer.testing import CliRunner, Result

from service.cli.main import app
from service.simulation.scene_files import write_scene

Run = Callable[..., Result]


@pytest.fixture(scope="session")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scene")
    write_scene("motorway", folder, seed=3, duration_s=6.0)
    return folder


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Run]:
    monkeypatch.chdir(tmp_path)  # no .env of the developer
    for name in ("WAYSIDE_KEY", "WAYSIDE_URL", "WAYSIDE_DATA_DIR", "WAYSIDE_DATABASE_URL"):
        monkeypatch.delenv(name, raising=False)

    def call(*arguments: str | Path, code: int = 0) -> Result:
        result = CliRunner().invoke(app, [str(argument) for argument in arguments])
        assert result.exit_code == code, result.output
        return result

    yield call
    structlog.reset_defaults()  # `serve` logs to the standard error of its call, which is closed by now
