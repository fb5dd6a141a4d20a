from __future__ import annotations

import gzip
import math

import numpy as np
import pytest

from service.errors import InvalidInput
from service.evaluation.scores import evaluate, score_scene
from service.evaluation.truth import read_scene
from tests.evaluation.small_scene import FRAMES, STEP_S, SmallScene, Vehicle, stamp, write_lines

ONE = Vehicle(id=1, x=-2.0, y0=120.0, vy=-8.0)
TWO = Vehicle(id=2, x=2.0, y0=110.0, vy=-8.0)


@pytest.fixture
def scene(tmp_path):
    scene = SmallScene([ONE, TWO])
    scene.write(tmp_path)
    return scene


def scores_of(scene, directory, change=None, **options):
    tracks = write_lines(directory / "tracks.jsonl", scene.tracks(change))
    return score_scene(directory, tracks, **options)


def test_perfect_tracks_have_perfect_scores(scene, tmp_path):
    s = scores_of(scene, tmp_path)

    assert s["frames"] == FRAMES
    assert s["truth_per_frame"] == s["tracks_per_frame"] == 2.0
    for key in ("gospa", "ospa", "motp_m", "pos_rmse_m", "centre_rmse_m", "vel_rmse_mps", "along_bias_m"):
        assert s[key] == pytest.approx(0.0, abs=1e-9), key
    for key in ("mota", "idf1", "hota", "deta", "assa", "recall", "precision", "mostly_tracked"):
        assert s[key] == pytest.approx(1.0, abs=1e-12), key
    for key in ("id_switches", "fragmentations", "false_tracks", "never_tracked", "mostly_lost"):
        assert s[key] == 0, key
    assert s["vehicles"] == s["track_ids"] == 2
    assert s["ids_per_vehicle"] == 1.0


def test_half_a_metre_to_the_side_is_half_a_metre(scene, tmp_path):
    s = scores_of(scene, tmp_path, lambda _k, _v, q: {**q, "x": q["x"] + 0.5, "vy": q["vy"] + 1.0})

    for key in ("pos_rmse_m", "lateral_rmse_m", "motp_m"):
        assert s[key] == pytest.approx(0.5, abs=1e-9), key
    assert s["vel_rmse_mps"] == pytest.approx(1.0, abs=1e-12)
    assert s["gospa"] == pytest.approx(math.sqrt(2 * 0.5**2), abs=1e-9)
    assert s["ospa"] == pytest.approx(0.5, abs=1e-9)


def test_the_near_face_is_as_right_as_the_centre(scene, tmp_path):
    s = scores_of(scene, tmp_path, lambda _k, _v, q: {**q, "y": q["y"] - 2.0})  # half a length nearer

    assert s["pos_rmse_m"] == pytest.approx(0.0, abs=1e-9)
    assert s["centre_rmse_m"] == pytest.approx(2.0, abs=1e-9)
    assert s["along_bias_m"] == pytest.approx(2.0, abs=1e-9)  # ahead of the centre, for it drives that way
    assert s["lateral_rmse_m"] == pytest.approx(0.0, abs=1e-9)


def test_lengths_are_those_of_the_states_or_else_of_the_summaries(scene, tmp_path):
    short = write_lines(tmp_path / "short.jsonl", [{"track_id": 2, "length_m": 3.0}, {"track_id": 1}])

    untold = scores_of(scene, tmp_path)
    summed_up = scores_of(scene, tmp_path, summaries=short)
    told = scores_of(scene, tmp_path, lambda _k, _v, q: {**q, "length_m": 4.5}, summaries=short)

    assert math.isnan(untold["length_mae_m"])
    assert summed_up["length_mae_m"] == pytest.approx(1.0)  # of the one that tells its length, 4 m long
    assert told["length_mae_m"] == pytest.approx(0.5)


def test_a_missing_vehicle_costs_half_a_cut_off_squared(scene, tmp_path):
    s = scores_of(scene, tmp_path, lambda _k, v, q: q if v is ONE else None)

    assert s["gospa"] == pytest.approx(math.sqrt(8.0))
    assert s["ospa"] == pytest.approx(math.sqrt(16.0 / 2))
    assert (s["gospa_missed"], s["gospa_false"]) == (1.0, 0.0)
    assert (s["recall"], s["mota"], s["never_tracked"], s["mostly_lost"]) == (0.5, 0.5, 1, 0.5)


def test_a_standing_false_track_is_counted_in_every_frame(scene, tmp_path):
    lines = scene.tracks() + [{"frame": k, "track_id": "ghost", "x": 8.0, "y": 60.0} for k in range(FRAMES)]

    s = score_scene(tmp_path, write_lines(tmp_path / "tracks.jsonl", lines))

    assert (s["gospa_false"], s["false_tracks"], s["track_ids"]) == (1.0, 1, 3)
    assert s["false_tracks_per_min"] == pytest.approx(60 / ((FRAMES - 1) * STEP_S), rel=1e-6)
    assert s["mota"] == pytest.approx(0.5)


def test_new_names_half_way_are_one_switch_each(scene, tmp_path):
    s = scores_of(scene, tmp_path, lambda k, v, q: {**q, "track_id": v.id + 10 * (k >= FRAMES // 2)})

    assert s["id_switches"] == 2
    assert s["mota"] == pytest.approx(1 - 2 / (2 * FRAMES))
    assert s["idf1"] == pytest.approx(0.5)
    assert s["ids_per_vehicle"] == 2.0
    assert s["deta"] == pytest.approx(1.0)
    assert s["assa"] == pytest.approx(0.5)  # each half shares half of its vehicle's frames
    assert s["hota"] == pytest.approx(math.sqrt(0.5))
    assert s["fragmentations"] == 0


def test_a_gap_is_one_fragment(scene, tmp_path):
    s = scores_of(scene, tmp_path, lambda k, v, q: None if v is ONE and 50 <= k < 60 else q)

    assert s["fragmentations"] == 1
    assert s["id_switches"] == 0


def test_latency_counts_from_the_first_detection(tmp_path):
    scene = SmallScene([ONE, Vehicle(id=2, x=2.0, y0=110.0, vy=-8.0, seen_from=40)])
    scene.write(tmp_path)

    s = scores_of(scene, tmp_path, lambda k, v, q: q if v is ONE or k >= 46 else None)

    assert s["latency_median_s"] == pytest.approx(6 * STEP_S, abs=1e-6)  # vehicle 1 was there at the start


def test_a_vehicle_long_out_of_sight_counts_neither_way(tmp_path):
    scene = SmallScene([ONE, Vehicle(id=2, x=2.0, y0=110.0, vy=-8.0, seen_until=100)])
    scene.write(tmp_path)

    with_tracks = scores_of(scene, tmp_path)
    without = scores_of(scene, tmp_path, lambda k, v, q: q if v is ONE or k < 120 else None)

    assert with_tracks["truth_per_frame"] == pytest.approx((FRAMES + 120) / FRAMES, abs=0.01)
    for s in (with_tracks, without):
        assert (s["gospa_missed"], s["gospa_false"]) == pytest.approx((0.0, 0.0), abs=0.01)


def test_tentative_tracks_are_not_read_and_times_find_their_frame(scene, tmp_path):
    def by_time(k, v, q):
        return {**q, "frame": None, "timestamp": stamp(k), "status": "confirmed" if v is ONE else "tentative"}

    s = scores_of(scene, tmp_path, by_time)

    assert s["tracks_per_frame"] == 1.0
    assert s["recall"] == 0.5


def test_crossings_are_found_where_tracks_cross_the_line(scene, tmp_path):
    s = scores_of(scene, tmp_path)

    assert s["flow_source"] == "derived from the tracks"
    # one at 5.0 s, exactly as long after the start as it needs to count; the other at 3.75 s, too early to
    assert (s["crossings_true"], s["crossings_found"], s["countable_true"], s["countable_found"]) == (
        2,
        2,
        1,
        1,
    )
    assert s["count_recall"] == s["count_precision"] == s["lane_right"] == 1.0
    assert s["lane_count_error"] == s["total_count_error"] == 0.0
    assert s["crossing_time_bias_s"] == pytest.approx(0.0, abs=1e-6)
    assert s["crossing_speed_mae_mps"] == pytest.approx(0.0, abs=1e-12)


def test_a_track_that_jitters_on_the_line_is_counted_once_each_way(tmp_path):
    scene = SmallScene([ONE])
    scene.write(tmp_path)
    wobble = np.random.default_rng(1).normal(0.0, 1.0, FRAMES)

    s = scores_of(scene, tmp_path, lambda k, _v, q: {**q, "y": q["y"] + wobble[k]})

    assert s["crossings_found"] == 2  # there, and once back


def test_reported_crossings_take_the_place_of_derived_ones(scene, tmp_path):
    flow = write_lines(
        tmp_path / "crossings.jsonl",
        [
            {"line_id": "C", "timestamp": "2025-05-12T06:00:05.300Z", "lane_id": "L1", "speed_mps": 9.0},
            {"line_id": "C", "timestamp": "2025-05-12T06:00:08.000Z", "lane_id": "L2", "speed_mps": 9.0},
        ],
    )

    s = scores_of(scene, tmp_path, flow=flow)

    assert s["flow_source"] == "tracker"
    assert (s["crossing_recall"], s["crossing_precision"], s["lane_right"]) == (0.5, 0.5, 1.0)
    assert s["crossing_time_bias_s"] == pytest.approx(0.3, abs=1e-6)
    assert s["flow_speed_mae_mps"] == pytest.approx(1.0)


def test_until_scores_only_the_first_seconds(scene, tmp_path):
    s = scores_of(scene, tmp_path, lambda k, _v, q: {**q, "x": q["x"] + (k >= 80)}, until=4.0)

    assert s["frames"] == 80
    assert s["pos_rmse_m"] == pytest.approx(0.0, abs=1e-9)
    assert s["crossings_true"] == 1


def test_a_directory_of_results_is_scored_with_what_it_holds(tmp_path):
    scene = SmallScene([Vehicle(id=k, x=-2.0, y0=90.0 + 8.0 * k, vy=-16.0) for k in range(1, 7)])
    truth, out = tmp_path / "truth", tmp_path / "out"
    truth.mkdir()
    out.mkdir()
    scene.write(truth)
    lines = write_lines(tmp_path / "all.jsonl", scene.tracks()).read_bytes()
    (out / "tracks.jsonl.gz").write_bytes(gzip.compress(lines))
    points = [[-1.8, float(y)] for y in range(20, 150, 10)]
    write_lines(out / "lanes.json", [{"lanes": [{"lane_id": 1, "points": points}]}])

    s = evaluate(out, truth)

    assert (s["lanes_true"], s["lanes_right"], s["lanes_extra"], s["lane_count_exact"]) == (1, 1, 0, True)
    assert s["lane_offset_max_m"] == pytest.approx(0.2)
    assert s["lane_coverage"] == pytest.approx(1.0)
    assert "changes_true" not in s


def test_no_tracks_at_all_is_a_score_and_not_an_error(scene, tmp_path):
    s = scores_of(scene, tmp_path, lambda *_: None)

    assert (s["hota"], s["mota"], s["recall"], s["never_tracked"], s["count_recall"]) == (0, 0, 0, 2, 0)
    assert math.isnan(s["pos_rmse_m"])
    assert math.isnan(s["latency_median_s"])


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        (
            "tracks.jsonl",
            '{"frame": 1, "track_id": 1, "x": 0, "y": 1}\n{"frame": 2, "x": 0, "y": 1}\n',
            "line 2: 'track_id'",
        ),
        ("tracks.jsonl", '{"frame": 1, "track_id": 1, "x": "far", "y": 1}\n', "line 1: 'x' is 'far'"),
        ("tracks.jsonl", "{broken\n", "line 1: not JSON"),
        ("site.json", '{"sensor_id": "radar-1", "mount_height_m": -4}', "mount_height_m"),
        ("road_truth.json", '{"lanes": [{"lane_id": "L1", "points": [[0, 20]]}]}', "lane 'L1' has 1 points"),
        ("road_truth.json", '{"lanes": []}', "'crossings' is missing"),
    ],
)
def test_what_is_wrong_in_a_file_is_said_with_file_and_line(scene, tmp_path, name, text, said):
    write_lines(tmp_path / "tracks.jsonl", scene.tracks())
    (tmp_path / name).write_text(text)

    with pytest.raises(InvalidInput, match=f"(?s){name}.*{said}"):
        score_scene(tmp_path, tmp_path / "tracks.jsonl")


def test_a_wrong_row_of_the_truth_is_named(tmp_path):
    SmallScene([ONE]).write(tmp_path)
    rows = gzip.decompress((tmp_path / "truth.csv.gz").read_bytes()).decode().splitlines()
    rows[7] = rows[7].replace("-2.0", "west", 1)
    (tmp_path / "truth.csv.gz").write_bytes(gzip.compress("\n".join(rows).encode()))

    with pytest.raises(InvalidInput, match=r"truth\.csv\.gz, line 8: .*'west'"):
        read_scene(tmp_path)


def test_a_road_without_lanes_still_counts_crossings(tmp_path):
    scene = SmallScene([ONE, TWO], lanes={})
    scene.write(tmp_path)

    s = scores_of(scene, tmp_path)

    assert (s["crossing_recall"], s["crossing_precision"]) == (1.0, 1.0)


def test_no_time_at_all_is_refused(scene, tmp_path):
    with pytest.raises(InvalidInput, match="until: want more than 0 seconds"):
        scores_of(scene, tmp_path, until=0.0)


def test_a_directory_without_truth_says_which_file_it_wants(tmp_path):
    with pytest.raises(InvalidInput, match=r"site\.json"):
        read_scene(tmp_path)
