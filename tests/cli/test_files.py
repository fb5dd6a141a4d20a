"""Site files with settings on top, and results that appear whole or not at all."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from service.cli.files import read_site, written_together
from service.errors import InvalidInput

NAMES = ("tracks.jsonl", "summary.json")


@pytest.fixture
def site(tmp_path: Path) -> Path:
    path = tmp_path / "site.json"
    path.write_text(json.dumps({"sensor_id": "radar-7", "rate_hz": 10, "mount_height_m": 5.5}))
    return path


def test_a_site_file_takes_filter_and_settings_of_the_command_line(site):
    config = read_site(site, "ekf", ["sensor.range_std_m=0.4", "clustering.window_frames = 5"])

    parameters = config.tracker_parameters()
    assert config.sensor_id == "radar-7"
    assert parameters.filter == "ekf"
    assert parameters.sensor.range_std_m == 0.4
    assert parameters.clustering.window_frames == 5
    assert parameters.digest() != read_site(site).tracker_parameters().digest()


@pytest.mark.parametrize(
    ("filter_name", "settings", "reason"),
    [
        ("kalman", [], "no filter 'kalman'"),
        (None, ["window"], "KEY=VALUE"),
        (None, ["clustering.windows=3"], "no such parameter"),
        (None, ["clustering.window_frames=many"], "want int"),
    ],
)
def test_a_wrong_setting_is_named(site, filter_name, settings, reason):
    with pytest.raises(InvalidInput, match=reason):
        read_site(site, filter_name, settings)


@pytest.mark.parametrize(
    ("content", "reason"), [("{", "JSON"), ('{"rate_hz": -1}', "rate_hz"), ("[]", "object")]
)
def test_a_wrong_site_file_is_named_with_its_fault(tmp_path, content, reason):
    path = tmp_path / "site.json"
    path.write_text(content)

    with pytest.raises(InvalidInput, match=rf"(?i)site\.json.*{reason}"):
        read_site(path)


def test_a_missing_site_file_is_named(tmp_path):
    with pytest.raises(InvalidInput, match="No such file"):
        read_site(tmp_path / "nowhere.json")


def test_results_take_their_names_together(tmp_path):
    out = tmp_path / "out"

    with written_together(out, NAMES) as paths:
        for name, path in paths.items():
            path.write_text(name)
            assert not (out / name).exists()

    assert sorted(p.name for p in out.iterdir()) == sorted(NAMES)
    assert (out / "tracks.jsonl").read_text() == "tracks.jsonl"


def test_a_failure_leaves_the_earlier_results(tmp_path):
    with written_together(tmp_path, NAMES) as paths:
        for path in paths.values():
            path.write_text("first")

    def fail_half_way():
        with written_together(tmp_path, NAMES) as paths:
            paths["tracks.jsonl"].write_text("second")
            raise InvalidInput("line 17 is no frame")

    with pytest.raises(InvalidInput):
        fail_half_way()
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == dict.fromkeys(NAMES, "first")


def test_a_folder_with_other_things_is_refused_unless_forced(tmp_path):
    (tmp_path / "thesis.tex").write_text("important")

    with pytest.raises(InvalidInput, match=r"thesis\.tex"), written_together(tmp_path, NAMES):
        pass
    with written_together(tmp_path, NAMES, force=True) as paths:
        for path in paths.values():
            path.write_text("")

    assert (tmp_path / "thesis.tex").read_text() == "important"
    assert (tmp_path / "summary.json").exists()


def test_a_file_is_no_folder_for_results(tmp_path):
    (tmp_path / "out").write_text("")

    with pytest.raises(InvalidInput, match="is a file"), written_together(tmp_path / "out", NAMES):
        pass
