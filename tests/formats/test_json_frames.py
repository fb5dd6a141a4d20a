from __future__ import annotations

import gzip
import json
import math

import numpy as np
import orjson
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from service.errors import InvalidFrame, InvalidInput
from service.formats.json_frames import frame_to_wire, parse_bytes, parse_frame, read_frames
from service.formats.sensor import SensorConfig

CONFIG = SensorConfig(sensor_id="radar-1")
NAMES = ("range_m", "azimuth_deg", "radial_velocity_mps", "snr_db")

point = st.fixed_dictionaries(
    {"range_m": st.floats(0, 400, width=32), "azimuth_deg": st.floats(-180, 180)},
    optional={
        "radial_velocity_mps": st.one_of(st.none(), st.floats(-80, 80), st.integers(-80, 80)),
        "snr_db": st.one_of(st.none(), st.floats(-20, 60)),
    },
)


def frame(detections, **more):
    return {
        "sensor_id": "radar-1",
        "timestamp": "2025-05-12T06:00:00.050Z",
        "frame": 1,
        "detections": detections,
    } | more


def columns_of(points):
    return {name: [p.get(name) for p in points] for name in NAMES}


def same(a, b):
    return (
        (a.sensor_id, a.time_us, a.sequence, a.boot_id) == (b.sensor_id, b.time_us, b.sequence, b.boot_id)
    ) and all(
        getattr(a, name).tobytes() == getattr(b, name).tobytes()
        for name in ("range_m", "azimuth_rad", "radial_velocity_mps", "snr_db")
    )


def faults(obj):
    """Return the pointers of what is wrong with the value, None for a good frame."""
    try:
        parse_frame(obj, CONFIG)
    except InvalidFrame as error:
        return [fault.pointer for fault in error.errors]
    return None


def pointers(detections, **more):
    return faults(frame(detections, **more))


def test_the_example_of_the_documentation():
    parsed = parse_frame(
        frame([{"range_m": 20.63, "azimuth_deg": 17.28, "radial_velocity_mps": 0.08, "snr_db": 24.3}]), CONFIG
    )

    assert (parsed.sensor_id, parsed.time_us, parsed.sequence, parsed.boot_id) == (
        "radar-1",
        1_747_029_600_050_000,
        1,
        None,
    )
    assert parsed.range_m.dtype == parsed.azimuth_rad.dtype == np.float32
    assert parsed.azimuth_rad[0] == np.float32(math.radians(17.28))
    assert parsed.snr_db[0] == np.float32(24.3)


@given(st.lists(point, max_size=20))
def test_columnar_equals_row_wise(points):
    assert same(parse_frame(frame(points), CONFIG), parse_frame(frame(columns_of(points)), CONFIG))


@given(st.lists(point, max_size=20))
def test_the_wire_form_reads_back_to_the_bit(points):
    parsed = parse_frame(frame(points, boot_id="b1"), CONFIG)

    assert same(parse_bytes(orjson.dumps(frame_to_wire(parsed)), CONFIG), parsed)


@settings(max_examples=20)
@given(st.lists(st.lists(point, max_size=5), max_size=4))
def test_a_file_reads_the_same_with_gzip_and_without(tmp_path_factory, frames):
    folder = tmp_path_factory.mktemp("frames")
    text = b"".join(orjson.dumps(frame(points, frame=i)) + b"\n" for i, points in enumerate(frames))
    plain, packed = folder / "a.jsonl", folder / "b.bin"
    plain.write_bytes(text + b"\n")
    packed.write_bytes(gzip.compress(text))

    first, second = list(read_frames([plain], CONFIG)), list(read_frames([packed], CONFIG))

    assert len(first) == len(second) == len(frames)
    assert all(same(a, b) for a, b in zip(first, second, strict=True))


def test_cartesian_points_become_slant_range_and_azimuth():
    rows = parse_frame(frame([{"x_m": 3.0, "y_m": 4.0, "z_m": -12.0}, {"x_m": -1, "y_m": 1}]), CONFIG)
    columns = parse_frame(frame({"x_m": [3.0, -1], "y_m": [4.0, 1], "z_m": [-12.0, None]}), CONFIG)

    assert same(rows, columns)
    assert rows.range_m.tolist() == [13.0, pytest.approx(math.sqrt(2))]
    assert rows.azimuth_rad.tolist() == pytest.approx([math.atan2(3, 4), -math.pi / 4])
    assert np.isnan(rows.radial_velocity_mps).all()


def test_the_sensors_signs_are_turned_into_ours():
    config = SensorConfig(azimuth_positive="left", radial_velocity_positive="approaching")
    polar = parse_frame(frame([{"range_m": 9, "azimuth_deg": 10, "radial_velocity_mps": 5}]), config)
    cartesian = parse_frame(frame([{"x_m": 1, "y_m": 1, "radial_velocity_mps": 5}]), config)

    assert polar.azimuth_rad[0] == np.float32(math.radians(-10))
    assert polar.radial_velocity_mps[0] == cartesian.radial_velocity_mps[0] == -5
    assert cartesian.azimuth_rad[0] > 0


def test_absent_identity_is_none_and_the_configuration_names_the_sensor():
    parsed = parse_frame({"timestamp": "2025-05-12T06:00:00Z", "detections": []}, CONFIG)

    assert (parsed.sensor_id, parsed.sequence, parsed.boot_id, len(parsed)) == ("radar-1", None, None, 0)


def test_an_unknown_field_is_ignored():
    parsed = parse_frame(frame([{"range_m": 9, "azimuth_deg": 1, "rcs_dbsm": 2}], comment="x"), CONFIG)

    assert len(parsed) == 1


GOOD = {"range_m": 9.0, "azimuth_deg": 1.0}


@pytest.mark.parametrize(
    ("detections", "pointer"),
    [
        ([GOOD, GOOD, {"range_m": 9.0, "azimuth_deg": 180.5}], "/detections/2/azimuth_deg"),
        ([{"range_m": -0.1, "azimuth_deg": 0}], "/detections/0/range_m"),
        ([{"range_m": math.nan, "azimuth_deg": 0}], "/detections/0/range_m"),
        ([{"range_m": "9", "azimuth_deg": 0}], "/detections/0/range_m"),
        ([{"range_m": True, "azimuth_deg": 0}], "/detections/0/range_m"),
        ([{"range_m": 10**400, "azimuth_deg": 0}], "/detections/0/range_m"),
        ([GOOD | {"snr_db": 1e6}], "/detections/0/snr_db"),
        ([GOOD | {"radial_velocity_mps": -math.inf}], "/detections/0/radial_velocity_mps"),
        ([GOOD, {"range_m": 9.0}], "/detections/1/azimuth_deg"),
        ([GOOD, 3], "/detections/1"),
        ([GOOD, {"x_m": 1, "y_m": 1}], "/detections/1"),
        ([GOOD | {"x_m": 1, "y_m": 1}], "/detections/0"),
        ([{}], "/detections/0/range_m"),
        ([GOOD] * 4097, "/detections"),
        ({}, "/detections/range_m"),
        ({"range_m": [1, 2, 3, -4], "azimuth_deg": [0] * 4}, "/detections/range_m/3"),
        ({"range_m": [1, None], "azimuth_deg": [0, 0]}, "/detections/range_m/1"),
        ({"range_m": [1, 2], "azimuth_deg": [0]}, "/detections/azimuth_deg"),
        ({"range_m": [1], "azimuth_deg": [0], "snr_db": [1, 2]}, "/detections/snr_db"),
        ({"range_m": [1], "azimuth_deg": [0], "snr_db": ["1"]}, "/detections/snr_db/0"),
        ({"range_m": [1, 2], "azimuth_deg": [0, 0], "snr_db": [None, math.nan]}, "/detections/snr_db/1"),
        ({"range_m": [1], "azimuth_deg": [0], "x_m": [1], "y_m": [1]}, "/detections"),
        ({"range_m": [1], "azimuth_deg": 0}, "/detections/azimuth_deg"),
        ({"range_m": [1] * 4097, "azimuth_deg": [0] * 4097}, "/detections/range_m"),
        ({"x_m": [1], "y_m": [[1]]}, "/detections/y_m/0"),
        ("none", "/detections"),
        (None, "/detections"),
    ],
)
def test_a_wrong_detection_is_named_by_its_pointer(detections, pointer):
    assert pointers(detections)[0] == pointer


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("frame", -1),
        ("frame", 1.0),
        ("frame", True),
        ("frame", 2**53),
        ("boot_id", ""),
        ("boot_id", 7),
        ("boot_id", "a b"),
        ("timestamp", None),
        ("timestamp", 1_747_029_600),
        ("timestamp", "12.5.2025"),
        ("sensor_id", "radar-2"),
        ("sensor_id", "../x"),
        ("sensor_id", None),
    ],
)
def test_a_wrong_head_is_named_by_its_pointer(field, value):
    assert pointers([], **{field: value}) == [f"/{field}"]


ODD = st.sampled_from([True, False, None, "1", "", [1], [], {}, -0.5, 2**63, 2**64 - 1, 1e300, 10_000, 0])
NUMBER = st.one_of(st.integers(0, 100), st.floats(0, 100))


@given(st.lists(st.lists(st.one_of(NUMBER, NUMBER, NUMBER, ODD), max_size=3), min_size=4, max_size=4))
def test_the_quick_way_of_columns_finds_the_same_as_the_slow_one(columns):
    obj = frame(dict(zip(NAMES, columns, strict=True)))
    wrong = faults(obj)  # looks for booleans, value by value
    if wrong is None:
        assert same(parse_bytes(orjson.dumps(obj), CONFIG), parse_frame(obj, CONFIG))
        return
    with pytest.raises(InvalidFrame) as quick:
        parse_bytes(orjson.dumps(obj), CONFIG)
    assert [fault.pointer for fault in quick.value.errors] == wrong


@pytest.mark.parametrize("odd", [True, False, None, "1", [1], {}, -0.5, 2**64 - 1])
def test_one_odd_value_among_the_columns_is_named(odd):
    columns = {name: [1.0, 2, 3.5] for name in NAMES}
    columns["range_m"][1] = odd
    body = orjson.dumps(frame(columns))

    with pytest.raises(InvalidFrame) as refused:
        parse_bytes(body, CONFIG)
    assert [fault.pointer for fault in refused.value.errors] == ["/detections/range_m/1"]


def test_every_fault_of_a_frame_is_named_at_once():
    assert pointers([{"range_m": -1, "azimuth_deg": 200}], frame=-1, timestamp="") == [
        "/timestamp",
        "/frame",
        "/detections/0/range_m",
        "/detections/0/azimuth_deg",
    ]


def test_the_number_of_named_faults_is_bounded():
    assert len(pointers([{"range_m": -1, "azimuth_deg": 200, "snr_db": "x"}] * 4000)) < 30


json_value = st.recursive(
    st.one_of(
        st.none(),
        st.booleans(),
        st.integers(),
        st.floats(),
        st.text(max_size=5),
        st.sampled_from(["2025-05-12T06:00:00Z", "radar-1"]),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.dictionaries(
            st.sampled_from(
                ["sensor_id", "timestamp", "frame", "boot_id", "detections", *NAMES, "x_m", "y_m"]
            ),
            inner,
            max_size=4,
        ),
    ),
    max_leaves=12,
)


@given(json_value, json_value)
def test_a_hostile_value_raises_nothing_but_invalid_frame(value, detections):
    for obj in (value, frame(detections), frame([detections])):
        assert faults(obj) is None or faults(obj)


@given(st.binary(max_size=60))
def test_hostile_bytes_raise_nothing_but_invalid_frame(body):
    with pytest.raises(InvalidFrame):
        parse_bytes(body, CONFIG)


@pytest.mark.parametrize("body", [b"[" * 100_000, b'{"a": 1e999', b"\xff", b"NaN", b""])
def test_what_is_not_json_is_refused(body):
    with pytest.raises(InvalidFrame, match=r"is not JSON|nearly empty"):
        parse_bytes(body, CONFIG)


def test_a_wrong_line_of_a_file_is_named(tmp_path):
    path = tmp_path / "frames.jsonl"
    path.write_text(json.dumps(frame([])) + "\n\n" + json.dumps(frame([], frame=-3)) + "\n")

    with pytest.raises(InvalidFrame, match=r"frames\.jsonl, line 3: /frame"):
        list(read_frames([path], CONFIG))


def test_a_truncated_gzip_file_and_a_missing_file_are_invalid_input(tmp_path):
    path = tmp_path / "frames.jsonl.gz"
    path.write_bytes(gzip.compress(json.dumps(frame([])).encode() * 50)[:-9])

    with pytest.raises(InvalidInput, match=r"frames\.jsonl\.gz"):
        list(read_frames([path], CONFIG))
    with pytest.raises(InvalidInput, match=r"cannot be read"):
        list(read_frames([tmp_path / "nothing"], CONFIG))
