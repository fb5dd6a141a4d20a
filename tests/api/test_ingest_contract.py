from __future__ import annotations

import shutil
import time
from types import SimpleNamespace

import orjson
import pytest

from service.api import bodies
from service.errors import Unavailable
from service.formats.rfc3339 import format_time_exact
from tests.api.serving import problem, recording, serving, until
from tests.api.test_compression import zstd


@pytest.fixture
def radar(service, request):
    """A sensor of this test's own."""
    sensor_id = f"c{abs(hash(request.node.name))}"
    assert service.post("/sensors", json={"sensor_id": sensor_id}).status_code == 201
    return sensor_id


def health(service, sensor_id):
    sensors = service.client.get("/healthz").json()["sensors"]
    return next(s for s in sensors if s["sensor_id"] == sensor_id)


def log_end(service, sensor_id):
    return service.host._frame_log.last_position(sensor_id)


COLUMNS = {"range_m": [20.0, 30.0], "azimuth_deg": [1.0, 2.0]}


@pytest.mark.parametrize(
    ("change", "pointer", "reason"),
    [
        ({"detections": COLUMNS | {"azimuth_deg": [1.0]}}, "/detections/azimuth_deg", "has 1 values"),
        ({"detections": COLUMNS | {"range_m": ["NaN", 1.0]}}, "/detections/range_m/0", "want a number"),
        ({"detections": COLUMNS | {"range_m": ["1e999", 1]}}, "/detections/range_m/0", "want a number"),
        ({"detections": COLUMNS | {"range_m": [True, 1.0]}}, "/detections/range_m/0", "want a number"),
        ({"detections": COLUMNS | {"range_m": [1, 10**30]}}, "/detections/range_m/1", "from 0 to 10000"),
        ({"detections": COLUMNS | {"range_m": [None, 1.0]}}, "/detections/range_m/0", "is missing"),
        ({"detections": {k: v * 2049 for k, v in COLUMNS.items()}}, "/detections/range_m", "at most 4096"),
        ({"detections": "many"}, "/detections", "want an array of objects"),
        ({"detections": [[1, 2]]}, "/detections/0", "want an object"),
        ({"frame": 2**63}, "/frame", "want an integer"),
        ({"frame": -1}, "/frame", "want an integer"),
        ({"frame": 1.5}, "/frame", "want an integer"),
        ({"boot_id": "x" * 65}, "/boot_id", "want 1 to 64"),
        ({"sensor_id": "another"}, "/sensor_id", "the frame is of another"),
        ({"timestamp": 1764000000}, "/timestamp", "want a string"),
        ({"timestamp": "1969-12-31T23:59:59Z"}, "/timestamp", "before 1970"),
        ({"timestamp": "2025-02-30T00:00:00Z"}, "/timestamp", "no date"),
    ],
)
def test_a_wrong_value_is_named_and_nothing_of_the_frame_is_stored(service, radar, change, pointer, reason):
    before = log_end(service, radar)
    frame = recording(radar, 1)[0] | change

    reply = problem(service.post(f"/sensors/{radar}/frames", json=frame), 422)

    assert reply["errors"][0]["pointer"] == pointer
    assert reason in reply["errors"][0]["detail"]
    assert log_end(service, radar) == before


@pytest.mark.parametrize("text", ["NaN", "-Infinity", "1e999", "9" * 400])
def test_numbers_that_are_none_are_no_json(service, radar, text):
    body = orjson.dumps(recording(radar, 1)[0]).replace(b'"snr_db":20.0', f'"snr_db":{text}'.encode())

    assert "is not JSON" in problem(service.post(f"/sensors/{radar}/frames", content=body), 422)["detail"]


def test_a_member_that_stands_twice_is_refused_in_a_frame_and_in_a_batch(service, radar):
    one, two = recording(radar, 2)
    twice = orjson.dumps(one)[:-1] + b',"frame":7}'

    alone = problem(service.post(f"/sensors/{radar}/frames", content=twice), 422)
    batch = service.post(
        f"/sensors/{radar}/frames:batch", content=b"[" + twice + b"," + orjson.dumps(two) + b"]"
    ).json()

    assert alone["errors"][0] == {"pointer": "/frame", "detail": "stands there more than once"}
    assert [item["status"] for item in batch["results"]] == ["rejected", "accepted"]
    assert batch["results"][0]["errors"][0]["pointer"] == "/0/frame"


def test_a_frame_by_zstd_is_the_same_frame(service, radar):
    frame = recording(radar, 1)[0]
    body = zstd.compress(orjson.dumps(frame))

    sent = service.post(f"/sensors/{radar}/frames", content=body, headers={"Content-Encoding": "zstd"})

    assert sent.status_code == 202
    assert service.post(f"/sensors/{radar}/frames", json=frame).json()["status"] == "duplicate"
    problem(service.post(f"/sensors/{radar}/frames", content=body, headers={"Content-Encoding": "br"}), 415)
    problem(
        service.post(f"/sensors/{radar}/frames", content=b"a,b", headers={"Content-Type": "text/csv"}), 415
    )


def test_rejected_and_late_frames_are_counted(service, radar):
    sent = recording(radar, 12)
    service.post(f"/sensors/{radar}/frames:batch", json=[*sent[:5], *sent[6:], {"frame": 1}])
    service.post(f"/sensors/{radar}/frames", json=sent[5] | {"timestamp": "2999-01-01T00:00:00Z"})
    service.post(f"/sensors/{radar}/frames", json=sent[5])

    def counted():  # the two frames after the gap were held at first
        text = service.client.get("/metrics").text
        lines = [f'wayside_frames_total{{fate="{f}",sensor_id="{radar}"}} {n}.0' for f, n in
                 (("rejected", 2), ("late", 1), ("tracked", 9))]  # fmt: skip
        return all(line in text for line in lines)

    until(counted)


def test_a_clock_in_1970_is_taken_its_setting_and_its_setting_back_are_told(service, radar):
    def post(first, start_us, count=30):
        frames = recording(radar, count)
        for k, frame in enumerate(frames):
            frame["timestamp"], frame["frame"] = format_time_exact(start_us + k * 50_000), first + k
        return service.post(f"/sensors/{radar}/frames:batch", json=frames).json()

    now_us = time.time_ns() // 1000

    assert post(1, 5_000_000)["accepted"] == 30  # a sensor without a battery begins at 00:00:05
    assert post(31, now_us - 2_000_000)["accepted"] == 30
    assert health(service, radar)["clock_steps"] == 1
    assert health(service, radar)["clock_skew_s"] == pytest.approx(0, abs=5)
    assert post(61, now_us + 3600_000_000)["rejected"] == 30  # an hour ahead
    assert health(service, radar)["clock_ahead_s"] == pytest.approx(3600, abs=30)
    back = post(61, now_us - 3600_000_000)
    assert (back["late"], back["accepted"]) == (2, 28)  # the third in a row shows that the clock was set back
    until(lambda: health(service, radar)["epoch"] == 2)


def test_a_full_disk_is_503_with_retry_after_and_passes_by_itself(tmp_path, monkeypatch):
    with serving(tmp_path, disk_free_min_share=0.05) as running:
        running.post("/sensors", json={"sensor_id": "radar-1"})
        first, second = recording("radar-1", 2)
        usage = SimpleNamespace(total=100, free=4)
        monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)

        def post(frame, wanted):
            reply = running.post("/sensors/radar-1/frames", json=frame)
            return reply if reply.status_code == wanted else None

        full = until(lambda: post(first, 503))
        usage.free = 10

        assert "disk is nearly full: 4 of 100" in problem(full, 503)["detail"]
        assert int(full.headers["retry-after"]) >= 1
        taken = until(lambda: post(second, 202))
        assert taken.json()["status"] == "accepted"
        assert running.client.get("/readyz").status_code == 200


def test_a_full_log_takes_frames_again_once_the_tracker_has_stored_them(tmp_path):
    limits = {"log_limit_bytes": 600_000, "flush_interval_s": 2.0, "snapshot_interval_s": 0.1}
    with serving(tmp_path, **limits) as running:
        running.post("/sensors", json={"sensor_id": "radar-1"})
        sent = recording("radar-1", 3000, vehicles=20)
        parts = iter([sent[k : k + 50] for k in range(0, len(sent), 50)])

        def post(part):
            return running.post("/sensors/radar-1/frames:batch", json=part)

        while (refused := post(part := next(parts))).status_code == 202:
            assert refused.json()["accepted"] == 50

        assert "the log is full" in problem(refused, 503)["detail"]
        assert refused.headers["retry-after"] == "5"
        taken = until(lambda: (reply := post(part)).status_code == 202 and reply)
        assert taken.json()["accepted"] == 50


def test_many_large_bodies_at_once_are_503_not_a_full_memory():
    room = bodies.BodyRoom(1000)
    with room.hold() as first, room.hold() as second:
        first.add(7000)
        with pytest.raises(Unavailable, match="7000 bytes are in work"):
            second.add(1001)
        second.add(1000)
    with room.hold() as third:
        third.add(8000)


def test_a_body_that_does_not_arrive_is_408(service, monkeypatch, radar):
    monkeypatch.setattr(bodies, "BODY_TIME_S", 0.05)

    def slowly():
        yield b"{"
        time.sleep(0.5)
        yield b"}"

    problem(service.post(f"/sensors/{radar}/frames", content=slowly()), 408)
