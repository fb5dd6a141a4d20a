"""A package of one's own adds a filter: built, installed beside the program, and used by the command line."""

import os
import subprocess
import sys
import zipfile
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import pytest

from service.cli.site_file import with_settings
from service.errors import InvalidInput
from service.formats.sensor import SensorConfig
from service.pipeline.offline import track
from service.tracking.filters import registry
from service.warmup import _frame

ROOT = Path(__file__).resolve().parents[3]
PROJECT = """
[build-system]
requires = ["hatchling"]
build-backend = "hatchling.build"
[project]
name = "steady-filter"
version = "1.0"
[project.entry-points."wayside.filters"]
steady = "steady_filter:make"
[tool.hatch.build.targets.wheel]
packages = ["steady_filter"]
"""
MODULE = """
from service.tracking.filters.ekf import Ekf
from service.tracking.filters.parameters import EkfParameters


def make(parameters):
    return Ekf(EkfParameters(accel_std_mps2=0.3), name="steady")
"""
PRINT_NAMES = """
from service.tracking.filters.registry import filter_names, make_filter
print(*filter_names())
print(make_filter("steady").parameters.accel_std_mps2)
"""


@pytest.fixture(autouse=True)
def forget():
    """Leave no filter of a package behind."""
    yield
    registry._offered.cache_clear()
    registry._installed.cache_clear()


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Return a folder into which a small package was installed from its wheel."""
    source, target = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("target")
    (source / "steady_filter").mkdir()
    (source / "pyproject.toml").write_text(PROJECT)
    (source / "steady_filter" / "__init__.py").write_text(MODULE)
    run([sys.executable, "-m", "hatchling", "build", "-t", "wheel"], cwd=source)
    (wheel,) = (source / "dist").glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(target)
    return target


def run(command, cwd, **variables):
    done = subprocess.run(
        command, cwd=cwd, env=os.environ | variables, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def with_package(folder, *arguments, cwd=ROOT):
    return run([sys.executable, *arguments], cwd=cwd, PYTHONPATH=f"{folder}:{ROOT}")


def test_an_installed_package_adds_its_filter(installed):
    names, accel_std = with_package(installed, "-c", PRINT_NAMES).splitlines()

    assert "steady" in names.split()
    assert "imm" in names.split()
    assert accel_std == "0.3"


def test_a_recording_is_tracked_with_the_filter_of_a_package(installed, monkeypatch):
    monkeypatch.syspath_prepend(str(installed))
    registry._offered.cache_clear()
    registry._installed.cache_clear()

    config = with_settings(SensorConfig(), "steady", ())
    recording = track([_frame(number) for number in range(30)], config)

    assert config.filter == "steady"
    assert len(recording.summaries) >= 2
    assert recording.parameters_digest != track([_frame(0)], SensorConfig()).parameters_digest


@pytest.fixture
def offer(monkeypatch):
    """Return a function that pretends that packages offer these filters."""

    def set_to(**points):
        found = EntryPoints(EntryPoint(name, value, registry.GROUP) for name, value in points.items())
        monkeypatch.setattr(registry, "entry_points", lambda group: found.select(group=group))
        registry._offered.cache_clear()
        registry._installed.cache_clear()

    return set_to


def test_a_package_cannot_take_a_built_in_name(offer):
    offer(ekf="other:make")

    with pytest.raises(InvalidInput, match="other:make offers 'ekf', a name that is taken"):
        registry.filter_names()


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        ("no_such_module:make", "gives no filter 'own': No module named"),
        ("math:no_such_function", "gives no filter 'own'"),
        ("math:sqrt", "gives no filter 'own'"),
        ("service.tracking.filters.registry:_BUILT_IN", "gives no filter 'own'"),
        ("service.tracking.filters.ekf:Ekf", "gives a filter 'ekf', want 'own'"),
    ],
)
def test_a_package_whose_filter_does_not_work_is_named(offer, value, reason):
    offer(own=value)

    with pytest.raises(InvalidInput, match=reason):
        registry.make_filter("own")


def test_an_unknown_name_lists_the_filters_of_packages_too(offer):
    offer(zebra="other:make")

    with pytest.raises(InvalidInput, match=r"known are ast-ukf, .*, zebra"):
        registry.make_filter("kalman")
