from __future__ import annotations

import csv
import io
import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from pyproj import Geod

from service.formats.georeference import Pose, pose_of, to_east_north, to_wgs84
from service.formats.length_class import LENGTH_BOUNDS_M, length_class
from service.formats.sensor import SensorConfig
from service.formats.track_exports import (
    STATE_COLUMNS,
    StateTable,
    csv_header,
    csv_lines,
    path_feature,
    state_records,
)
from service.formats.tracks import LiveContext, StoredStates, frame_line, live_tracks, stored_line
from service.storage.rows import STATE_SAMPLE
from service.tracking.model import MOTION_SHIFT, TrackEstimates, TrackStatus

SECOND = 1_747_029_600
FLOATS = ("x_m", "y_m", "vx_mps", "vy_mps", "std_x_m", "std_y_m")


def estimates(rng, count):
    def column(low, high) -> np.ndarray:
        return rng.uniform(low, high, count).astype(np.float32)

    return TrackEstimates(
        number=np.arange(1, count + 1, dtype=np.int64),
        x_m=column(-20, 20),
        y_m=column(10, 150),
        vx_mps=column(-2, 2),
        vy_mps=column(-40, 40),
        std_x_m=column(0.01, 1),
        std_y_m=column(0.01, 1),
        cov_xy_m2=column(-0.1, 0.1),
        heading_rad=column(-4, 4),
        length_m=np.where(np.arange(count) == 0, np.nan, column(1, 20)).astype(np.float32),
        width_m=column(1, 2.5),
        existence=column(0.5, 1),
        status=rng.choice([TrackStatus.CONFIRMED, TrackStatus.COASTING], count).astype(np.uint8),
        lane=rng.integers(0, 4, count).astype(np.uint8),
        motion=rng.integers(0, 5, count).astype(np.uint8),
        hits=rng.integers(1, 99, count),
        born_us=np.full(count, SECOND * 1_000_000 - 4_200_000),
    )


def sample_of(e, i, frame_offset, time_us):
    sample = np.zeros((), STATE_SAMPLE)
    for name in (*FLOATS, "lane"):
        sample[name] = getattr(e, name)[i]
    sample["status"] = e.status[i] | e.motion[i] << MOTION_SHIFT
    sample["frame_offset"] = frame_offset
    sample["time_offset_ms"] = time_us // 1000 - SECOND * 1000
    return sample


@given(st.integers(0, 2**32 - 1), st.integers(0, 6), st.integers(0, 999_999))
def test_stored_states_give_the_same_bytes_as_the_tracker(seed, tracks, micros):
    e = estimates(np.random.default_rng(seed), tracks)
    time_us = SECOND * 1_000_000 + micros
    samples = np.array([sample_of(e, i, 3, time_us) for i in range(tracks)], STATE_SAMPLE)
    stored_us = time_us // 1000 * 1000

    line = stored_line("radar-1", 2, 903, stored_us, StoredStates(e.number, samples))

    assert line == frame_line("radar-1", 2, 903, time_us, e)


def test_a_line_holds_what_the_documentation_says():
    line = json.loads(
        frame_line("radar-1", 1, 12, SECOND * 1_000_000 + 600_000, estimates(np.random.default_rng(1), 2))
    )

    assert (line["frame"], line["timestamp"]) == (12, "2025-05-12T06:00:00.600Z")
    assert [track["track_id"] for track in line["tracks"]] == ["radar-1-1-1", "radar-1-1-2"]
    assert list(line["tracks"][0]) == ["track_id", "status", *FLOATS, "lane", "motion"]
    assert all(round(track[name], 3) == track[name] for track in line["tracks"] for name in FLOATS)


def test_a_live_track_has_every_field_and_no_nan():
    e = estimates(np.random.default_rng(2), 3)
    tracks = live_tracks(LiveContext("radar-1", 1, Pose(48.0, 11.0, 90.0)), SECOND * 1_000_000, e)

    first = tracks[0]
    assert json.dumps(tracks, allow_nan=False)
    assert (first["length_m"], first["length_class"]) == (None, None)
    assert tracks[1]["length_class"] is not None
    assert first["age_s"] == 4.2
    assert first["speed_mps"] == pytest.approx(math.hypot(first["vx_mps"], first["vy_mps"]), abs=2e-3)
    assert all(0 <= track["heading_deg"] < 360 for track in tracks)
    assert first["longitude_deg"] > 11.0
    assert live_tracks(LiveContext("radar-1", 1), 0, e)[0]["latitude_deg"] is None


@given(st.floats(-80, 80), st.floats(-180, 180), st.floats(0, 360), st.floats(-100, 100), st.floats(1, 300))
def test_places_have_the_distance_and_bearing_of_the_plan_frame(latitude, longitude, heading, x_m, y_m):
    pose = Pose(latitude, longitude, heading)
    lon, lat = to_wgs84(pose, np.array([x_m]), np.array([y_m]))

    bearing, _, distance_m = Geod(ellps="WGS84").inv(longitude, latitude, lon[0], lat[0])

    assert distance_m == pytest.approx(math.hypot(x_m, y_m), abs=2e-3)  # degrees are rounded to 1 mm
    turn = bearing - heading - math.degrees(math.atan2(x_m, y_m))
    assert math.hypot(x_m, y_m) * abs(math.remainder(math.radians(turn), math.tau)) < 4e-3


def test_a_boresight_to_the_east_puts_the_right_hand_in_the_south():
    east_m, north_m = to_east_north(Pose(0, 0, 90), np.array([1.0]), np.array([10.0]))

    assert (east_m[0], north_m[0]) == pytest.approx((10.0, -1.0))


def test_the_pose_needs_both_coordinates():
    assert pose_of(SensorConfig(latitude_deg=1.0)) is None
    assert pose_of(SensorConfig(latitude_deg=1.0, longitude_deg=2.0, heading_deg=3)) == Pose(1.0, 2.0, 3.0)


@pytest.mark.parametrize(
    ("length_m", "name"),
    [(None, None), (math.nan, None), (2.5, "motorcycle"), (2.6, "short"), (6.6, "medium"), (14.9, "long")],
)
def test_length_classes_have_half_open_bins(length_m, name):
    assert length_class(length_m, LENGTH_BOUNDS_M) == name


def test_the_shortest_vehicle_that_a_tracker_tells_of_is_a_motorcycle():
    shortest_m = SensorConfig().tracker_parameters().extent.length_min_m

    assert length_class(shortest_m, SensorConfig().length_bounds_m) == "motorcycle"


def test_the_bounds_of_the_length_classes_are_a_setting_of_the_sensor():
    e = estimates(np.random.default_rng(2), 2)
    e.length_m[:] = 3.0
    config = SensorConfig.model_validate({"length_bounds_m": [3.5, 7.0, 12.0]})

    tracks = live_tracks(LiveContext("radar-1", 1, None, config.length_bounds_m), SECOND * 1_000_000, e)

    assert [track["length_class"] for track in tracks] == ["motorcycle"] * 2
    for wrong in ([2.5, 2.5, 9.0], [2.5, 9.0], [-1.0, 2.0, 3.0]):
        with pytest.raises(ValidationError):
            SensorConfig.model_validate({"length_bounds_m": wrong})


def test_csv_states_read_back_with_their_units():
    e = estimates(np.random.default_rng(3), 1)
    samples = np.array([sample_of(e, 0, k, SECOND * 10**6) for k in range(2)])
    times_us = np.array([SECOND * 10**6, SECOND * 10**6 + 50_000])
    table = StateTable("radar-1", 1, np.array([7, 7]), np.array([40, 41]), times_us, samples)
    records = state_records(table, None)
    rows = list(csv.DictReader(io.StringIO(csv_header(STATE_COLUMNS) + csv_lines(STATE_COLUMNS, records))))

    assert [row["frame"] for row in rows] == ["40", "41"]
    assert rows[1]["timestamp"] == "2025-05-12T06:00:00.050Z"
    assert rows[0]["track_id"] == "radar-1-1-7"
    assert float(rows[0]["x_m"]) == records[0]["x_m"]
    assert rows[0]["longitude_deg"] == ""
    assert set(rows[0]) == set(STATE_COLUMNS) == set(records[0])


def test_a_path_is_a_line_a_point_or_nothing():
    pose, one, two = Pose(48, 11, 0), np.array([1.0]), np.array([1.0, 2.0])

    assert path_feature({}, pose, two, two)["geometry"]["type"] == "LineString"
    assert path_feature({}, pose, one, one)["geometry"]["type"] == "Point"
    assert path_feature({"a": 1}, None, two, two) == {
        "type": "Feature",
        "geometry": None,
        "properties": {"a": 1},
    }
