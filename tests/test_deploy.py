"""The files for running Wayside elsewhere say what the program does."""

from __future__ import annotations

import configparser
import re
import tomllib
from pathlib import Path

import yaml

import service

ROOT = Path(__file__).resolve().parents[1]


def test_the_composed_service_keeps_its_data_in_a_volume():
    compose = yaml.safe_load((ROOT / "docker-compose.yml").read_text())

    wayside = compose["services"]["wayside"]
    assert "data:/data" in wayside["volumes"]
    assert {"data", "kernels"} == compose["volumes"].keys()
    assert all(port.startswith("127.0.0.1:") for port in wayside["ports"])


def test_the_image_runs_as_an_ordinary_user_from_its_last_stage():
    last_stage = (ROOT / "Dockerfile").read_text().split("\nFROM ")[-1]

    assert re.search(r"^USER wayside$", last_stage, re.MULTILINE)
    assert last_stage.index("USER wayside") < last_stage.index("service.warmup")


def test_the_image_brings_the_byte_code_that_its_user_may_not_write():
    first_stage = (ROOT / "Dockerfile").read_text().split("\nFROM ")[1]

    assert first_stage.index("\nENV UV_COMPILE_BYTECODE=1\n") < first_stage.index("pip install")


def test_the_unit_starts_wayside_in_a_state_directory():
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read(ROOT / "deploy" / "wayside.service")

    assert unit["Service"]["ExecStart"] == "/opt/wayside/bin/wayside serve --data-dir %S/wayside"
    assert unit["Service"]["StateDirectory"] == "wayside"
    assert unit["Service"]["DynamicUser"] == "yes"


def test_the_scrape_example_reads_the_default_port():
    scrape = yaml.safe_load((ROOT / "deploy" / "prometheus.yml").read_text())["scrape_configs"][0]

    assert scrape["metrics_path"] == "/metrics"
    assert scrape["static_configs"][0]["targets"] == ["127.0.0.1:8321"]


def test_the_citation_names_this_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())

    assert citation["version"] == service.__version__
    assert citation["license"] == tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["license"]


def test_every_locked_package_has_a_hash_and_no_index_is_named():
    for name in ("requirements.lock", "requirements-dev.lock"):
        text = (ROOT / name).read_text()
        packages = re.findall(r"^[a-z0-9].*?(?=^[a-z0-9]|\Z)", text, re.MULTILINE | re.DOTALL)
        assert len(packages) > 40
        assert all("--hash=sha256:" in package for package in packages)
        assert "://" not in text
        assert "index" not in text
