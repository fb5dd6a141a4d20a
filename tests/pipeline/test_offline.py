from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import orjson
import pytest

from service.errors import InvalidFrame, InvalidInput
from service.formats.json_frames import frame_to_wire
from service.pipeline.offline import track
from service.pipeline.order import Fate
from tests.pipeline import simple_tracker
from tests.pipeline.recordings import CONFIG, pausing_recording, recording


def test_a_recording_gives_frames_tracks_and_counts():
    found = track(pausing_recording(), CONFIG, tracker=simple_tracker)

    assert [scan.number for scan in found] == [n for n in range(1, 81) if n != 11]
    assert found.missing == 1
    assert found.fates[Fate.DUPLICATE] == 1
    assert [row.key.number for row in found.summaries] == [1, 2, 3, 4]
    assert all(row.ended for row in found.summaries)


def test_the_states_of_a_track_are_a_trajectory():
    found = track(recording(20), CONFIG, tracker=simple_tracker)

    path = found.trajectory(1)

    assert len(path) == 19
    assert path.frame.tolist() == list(range(2, 21))
    np.testing.assert_allclose(np.diff(path.y_m), 0.5, atol=1e-5)  # 10 m/s at 20 frames/s, in float32
    assert len(found.trajectory(99)) == 0


def test_frames_may_be_files_wire_objects_or_values(tmp_path: Path):
    frames = recording(20)
    lines = b"\n".join(orjson.dumps(frame_to_wire(frame)) for frame in frames)
    plain, packed, site = tmp_path / "a.jsonl", tmp_path / "b.jsonl.gz", tmp_path / "site.json"
    plain.write_bytes(lines)
    packed.write_bytes(gzip.compress(lines))
    site.write_text(json.dumps({"sensor_id": "radar-1"}))

    given = [str(plain), [packed], iter(frames), (frame_to_wire(frame) for frame in frames)]
    found = [list(track(one, site, tracker=simple_tracker).lines()) for one in given]

    assert found[0] == found[1] == found[2] == found[3]
    assert len(found[0]) == 20


def test_no_frames_give_an_empty_recording():
    found = track([], tracker=simple_tracker)

    assert len(found) == 0
    assert found.summaries == ()


@pytest.mark.parametrize(
    ("site", "message"),
    [({"rate_hz": -1}, "/rate_hz"), ({"region": {"azimuth_max_deg": 100}}, "/region/azimuth_max_deg")],
)
def test_a_wrong_site_is_named(site, message):
    with pytest.raises(InvalidInput, match=message):
        track([], site, tracker=simple_tracker)


def test_a_wrong_setting_is_named():
    with pytest.raises(InvalidInput, match="/nonsense"):
        track([], settings={"nonsense": 1}, tracker=simple_tracker)


def test_something_that_is_no_frame_is_refused():
    with pytest.raises(InvalidFrame, match="got int"):
        track([1, 2], tracker=simple_tracker)
