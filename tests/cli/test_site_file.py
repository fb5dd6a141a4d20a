"""Site files with settings of the command line on top."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from service.cli.site_file import read_site
from service.errors import InvalidInput
from service.tracking.profiles import PROFILES


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


def test_a_profile_is_what_settings_go_on_top_of(site):
    site.write_text(json.dumps({"sensor_id": "radar-7", "profile": "fast"}))
    fast, default = read_site(site), read_site(site, profile="default")
    mixed = read_site(site, None, ["clustering.window_frames=6"])

    assert fast.tracker_parameters().profile == fast.profile == "fast"
    assert fast.tracker_parameters().clustering.window_frames < 4
    assert default.tracker_parameters().clustering.window_frames == 4
    assert mixed.tracker_parameters().clustering.window_frames == 6
    digests = {read_site(site, profile=name).tracker_parameters().digest() for name in PROFILES}
    assert len(digests) == len(PROFILES) == 3
    with pytest.raises(InvalidInput, match="want fast, default, quality, got 'best'"):
        read_site(site, profile="best")
    with pytest.raises(InvalidInput, match="profile"):
        read_site(site, None, ["profile=fast"])


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
    ("content", "reason"), [("{", "JSON"), ('{"rate_hz": -1}', "rate_hz"), ("[]", "dictionary")]
)
def test_a_wrong_site_file_is_named_with_its_fault(tmp_path, content, reason):
    path = tmp_path / "site.json"
    path.write_text(content)

    with pytest.raises(InvalidInput, match=rf"(?i)site\.json.*{reason}"):
        read_site(path)


def test_a_missing_site_file_is_named(tmp_path):
    with pytest.raises(InvalidInput, match="No such file"):
        read_site(tmp_path / "nowhere.json")
