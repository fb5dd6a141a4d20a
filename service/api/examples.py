"""An example for every operation of the API, checked against the schemas by the tests."""

from __future__ import annotations

import json
from typing import Final

from service.api import flow_examples

TIME: Final = "2025-05-12T06:00:00.050Z"

SITE: Final = {
    "site_id": "north-bridge",
    "name": "North bridge",
    "latitude_deg": 48.137,
    "longitude_deg": 11.575,
    "time_zone": "Europe/Berlin",
}
SITE_REPLY: Final = SITE | {"created": TIME, "updated": TIME}

SENSOR: Final = {
    "sensor_id": "radar-1",
    "site_id": "north-bridge",
    "name": "Radar over lane 2",
    "latitude_deg": 48.137,
    "longitude_deg": 11.575,
    "heading_deg": 12.5,
    "rate_hz": 20.0,
    "mount_height_m": 6.0,
    "region": {"range_min_m": 20.0, "range_max_m": 150.0, "azimuth_max_deg": 45.0},
    "count_lines": [{"line_id": "C40", "p0": [-6.25, 40.0], "p1": [6.25, 40.0]}],
    "profile": "default",
    "filter": "astekf",
}
SENSOR_REPLY: Final = SENSOR | {
    "scatter_height_m": 0.6,
    "azimuth_offset_deg": 0.0,
    "azimuth_positive": "right",
    "radial_velocity_positive": "receding",
    "travel_heading_deg": None,
    "resolution": {"range_m": 0.75, "velocity_mps": 0.25, "azimuth_deg": 1.5},
    "noise_std": {
        "range_m": 0.15,
        "velocity_mps": 0.1,
        "azimuth_deg": 0.3,
        "azimuth_floor_deg": 0.1,
        "at_snr_db": 20.0,
    },
    "detection_threshold_db": 12.0,
    "parameters": {},
    "lanes": {"mode": "learned", "lanes": [], "names": {}, "accepted": None},
    "revision": 1,
    "created": TIME,
    "updated": TIME,
}

FRAME: Final = {
    "sensor_id": "radar-1",
    "timestamp": TIME,
    "frame": 1,
    "detections": {
        "range_m": [20.63, 44.1],
        "azimuth_deg": [17.28, -3.4],
        "radial_velocity_mps": [0.08, -16.9],
        "snr_db": [24.3, 31.0],
    },
}
FRAME_ROWS: Final = FRAME | {
    "detections": [{"range_m": 20.63, "azimuth_deg": 17.28, "radial_velocity_mps": 0.08, "snr_db": 24.3}]
}
FRAME_REPLY: Final = {"status": "accepted", "frame": 1}
BATCH_REPLY: Final = {
    "accepted": 1,
    "duplicate": 0,
    "late": 0,
    "conflict": 0,
    "rejected": 1,
    "results": [
        {"index": 0, "status": "accepted", "frame": 1, "detail": None, "errors": []},
        {
            "index": 1,
            "status": "rejected",
            "frame": None,
            "detail": "/detections/range_m/3: want a number from 0 to 10000, got -4",
            "errors": [
                {"pointer": "/detections/range_m/3", "detail": "want a number from 0 to 10000, got -4"}
            ],
        },
    ],
}

LIVE_TRACK: Final = {
    "track_id": "radar-1-1-3",
    "status": "confirmed",
    "x_m": 1.234,
    "y_m": 88.012,
    "vx_mps": 0.102,
    "vy_mps": -16.811,
    "speed_mps": 16.811,
    "heading_deg": 179.7,
    "std_x_m": 0.21,
    "std_y_m": 0.13,
    "cov_xy_m2": 0.003,
    "length_m": 4.5,
    "width_m": 1.8,
    "length_class": "short",
    "existence": 0.999,
    "age_s": 4.2,
    "hits": 80,
    "lane": 2,
    "motion": "moving",
    "longitude_deg": 11.57525643,
    "latitude_deg": 48.13777216,
}
LIVE: Final = {
    "sensor_id": "radar-1",
    "version": 812,
    "epoch": 1,
    "frame": 811,
    "timestamp": TIME,
    "received_at": TIME,
    "age_s": 0.04,
    "state": "live",
    "tracks": [LIVE_TRACK],
}

TRACK: Final = {
    "track_id": "radar-1-1-3",
    "sensor_id": "radar-1",
    "ended": True,
    "start": "2025-05-12T06:00:00.050Z",
    "end": "2025-05-12T06:00:07.150Z",
    "duration_s": 7.1,
    "first_frame": 1,
    "last_frame": 143,
    "states": 143,
    "hits": 139,
    "length_m": 4.512,
    "width_m": 1.803,
    "length_class": "short",
    "existence": 0.999,
    "first_x_m": 1.3,
    "first_y_m": 142.2,
    "last_x_m": 1.1,
    "last_y_m": 22.9,
    "distance_m": 119.4,
    "mean_speed_mps": 16.81,
    "max_speed_mps": 17.02,
}
STATE: Final = {
    "track_id": "radar-1-1-3",
    "frame": 12,
    "timestamp": "2025-05-12T06:00:00.600Z",
    "status": "confirmed",
    "x_m": 1.234,
    "y_m": 88.012,
    "vx_mps": 0.102,
    "vy_mps": -16.811,
    "speed_mps": 16.811,
    "std_x_m": 0.21,
    "std_y_m": 0.13,
    "lane": 2,
    "motion": "moving",
    "longitude_deg": 11.57525643,
    "latitude_deg": 48.13777216,
}
STATE_LINE: Final = {
    "frame": 12,
    "timestamp": "2025-05-12T06:00:00.600Z",
    "tracks": [
        {
            "track_id": "radar-1-1-3",
            "status": "confirmed",
            "x_m": 1.234,
            "y_m": 88.012,
            "vx_mps": 0.102,
            "vy_mps": -16.811,
            "std_x_m": 0.21,
            "std_y_m": 0.13,
            "lane": 2,
            "motion": "moving",
        }
    ],
}
EVENT: Final = {
    "event_id": "radar-1-2-0",
    "sensor_id": "radar-1",
    "epoch": 2,
    "kind": "tracker_restarted",
    "timestamp": TIME,
    "detail": {"reason": "the stored state cannot be read"},
}

KEY: Final = {"name": "gantry uplink", "scopes": ["ingest"], "sensor_ids": ["radar-1"]}
KEY_REPLY: Final = KEY | {"key_id": "5b1f0c2a9d3e4f60", "created": TIME, "last_used": None, "rotated": None}
ACT: Final = {
    "number": 12,
    "time": TIME,
    "actor": "5b1f0c2a9d3e4f60",
    "action": "sensor.archived",
    "target": "radar-1",
    "detail": {},
}
SESSION: Final = {"open": False, "key_id": "5b1f0c2a9d3e4f60", "scopes": ["read"]}

READY: Final = {
    "status": "ready",
    "checks": [{"name": "database", "ok": True, "detail": "answers"}],
}
HEALTH: Final = {
    "status": "ok",
    "version": "0.1.0",
    "lag_s": 0.0,
    "log_bytes": 1048576,
    "log_damaged_records": 0,
    "storage": {
        "log_files": 3,
        "log_oldest_age_s": 86400.0,
        "log_waiting_records": 0,
        "rows_bytes": 4194304,
        "disk_free_share": 0.62,
        "oldest_age_s": {"track_states": 612000.5, "tracks": 3024000.5, "acts": 3110400.25},
    },
    "sensors": [
        {
            "sensor_id": "radar-1",
            "state": "live",
            "failure": None,
            "epoch": 1,
            "frame_age_s": 0.04,
            "stored_age_s": 0.6,
            "clock_ahead_s": -0.012,
            "clock_skew_s": -0.009,
            "clock_drift_ppm": 12.5,
            "clock_jitter_s": 0.0021,
            "clock_steps": 0,
            "queue_depth": 0,
            "lag_s": 0.0,
            "unstored_frames": 12,
            "waiting_log_bytes": 0,
        }
    ],
    "tracker_processes": [{"running": True, "restarts": 0, "sensors": 1}],
}
DIAGNOSIS: Final = {
    "sensor_id": "radar-1",
    "findings": [
        {
            "code": "yaw",
            "severity": "fault",
            "sentence": "The tracks run 1.02 deg to the right of the normals of the count lines.",
            "evidence": {"yaw_deg": 1.02, "yaw_standard_error_deg": 0.03, "azimuth_offset_deg": -1.02},
            "advice": "If the site file is right there, set azimuth_offset_deg to -1.02 (now 0).",
        }
    ],
    "measured": {"rate_hz": 20.0, "missing_share": 0.0, "points_per_frame": 109.2},
    "not_told": [],
}
PROBLEM: Final = {
    "type": "/problems/invalid-input",
    "title": "Invalid input",
    "status": 422,
    "detail": "/detections/2/azimuth_deg: want a number from -180 to 180, got 181",
    "instance": "/api/v1/sensors/radar-1/frames",
    "request_id": "3f0c9a51b2d84e76",
    "errors": [{"pointer": "/detections/2/azimuth_deg", "detail": "want a number from -180 to 180, got 181"}],
}
LANE: Final = {
    "lane_id": "L2",
    "index": 2,
    "name": "left",
    "kind": "lane",
    "direction": "approaching",
    "points_m": [[0.04, 150.2], [-0.03, 84.0], [0.01, 20.4]],
    "width_m": [3.5, 3.49, 3.5],
    "left_m": [[1.79, 150.2], [1.71, 84.0], [1.76, 20.4]],
    "right_m": [[-1.71, 150.2], [-1.77, 84.0], [-1.74, 20.4]],
    "length_m": 129.8,
    "confidence": 0.91,
    "vehicles": 22,
    "coordinates": [[8.0000004, 52.0013503], [8.0, 52.0007551], [8.0, 52.0001834]],
}
LANE_MAP: Final = {
    "sensor_id": "radar-1",
    "version": "1-3",
    "since": TIME,
    "frame": 904,
    "vehicles": 54,
    "source": "learned",
    "mode": "learned",
    "accepted": True,
    "lanes": [LANE],
}
LANE_VERSION: Final = {
    "version": "1-3",
    "since": TIME,
    "frame": 904,
    "vehicles": 54,
    "source": "learned",
    "lanes": 3,
    "turns": 0,
    "change": {"added": ["L3"], "removed": [], "moved_m": {"L1": 0.31}, "longer_m": {}},
}
LANE_CHANGE: Final = {
    "timestamp": TIME,
    "decided_at": TIME,
    "track_id": "radar-1-1-3",
    "from_lane": "L1",
    "to_lane": "L2",
    "x_m": 1.743,
    "y_m": 84.2,
    "speed_mps": 16.8,
    "map_version": "1-3",
}


def _page(item: object) -> dict[str, object]:
    return {"items": [item], "next": None}


# by operation id: the name of the function that answers
REQUESTS: Final[dict[str, dict[str, object]]] = {
    "create_site": {"site": SITE},
    "change_site": {"another name": {"name": "North bridge, eastbound"}},
    "create_sensor": {"sensor": SENSOR},
    "change_sensor": {"turned and another filter": {"heading_deg": 14.0, "filter": "ekf"}},
    "post_frame": {"columnar": FRAME, "row-wise": FRAME_ROWS},
    "post_frames": {"batch": [FRAME, FRAME_ROWS | {"frame": 2}]},
    "create_key": {"key of one radar": KEY},
    "control_lanes": {
        "keep a version": {"action": "pin", "version": "1-3"},
        "name a lane": {"action": "rename", "names": {"L2": "left"}},
        "draw one lane": {
            "action": "replace",
            "lanes": [{"index": 1, "points_m": [[0.0, 150.0], [0.0, 20.0]], "width_m": 3.5}],
        },
    },
    "check_manual_counts": {"a quarter of an hour": [flow_examples.MANUAL_COUNT]},
}
RESPONSES: Final[dict[str, object]] = {
    "create_site": SITE_REPLY,
    "list_sites": _page(SITE_REPLY),
    "read_site": SITE_REPLY,
    "change_site": SITE_REPLY,
    "create_sensor": SENSOR_REPLY,
    "list_sensors": _page(SENSOR_REPLY),
    "read_sensor": SENSOR_REPLY,
    "change_sensor": SENSOR_REPLY,
    "post_frame": FRAME_REPLY,
    "post_frames": BATCH_REPLY,
    "read_live": LIVE,
    "read_tracks": _page(TRACK),
    "read_track": TRACK,
    "read_track_states": _page(STATE),
    "read_events": _page(EVENT),
    "read_lanes": LANE_MAP,
    "read_lane_versions": _page(LANE_VERSION),
    "control_lanes": {"mode": "learned", "lanes": [], "names": {"L2": "left"}, "accepted": "1-3"},
    "read_lane_changes": _page(LANE_CHANGE),
    **{name: _page(item) for name, item in flow_examples.PAGES.items()},
    **flow_examples.RESPONSES,
    "read_evidence": flow_examples.EVIDENCE | {"tracks": [TRACK]},
    "read_diagnosis": DIAGNOSIS,
    "create_key": KEY_REPLY | {"secret": "Zx3vYkq0bX0mYw1pJ2u3VtQe5rS7aHc9dLfGiKjNoPM"},
    "rotate_key": KEY_REPLY | {"secret": "b7T1wqJm2KfQx9RzL4vNc8YhUe5sPdAi3GoXtBnMkWE", "rotated": TIME},
    "list_keys": _page(KEY_REPLY),
    "read_audit": _page(ACT),
    "purge_sensor": {"sensor_id": "radar-1", "rows": {"tracks": 18204, "track_states": 220115}},
    "restart_sensor": {"sensor_id": "radar-1", "skipped": 72000},
    "read_session": SESSION,
    "open_session": SESSION,
    "live": {"status": "ok"},
    "ready": READY,
    "health": HEALTH,
}
# operations whose reply is not JSON: media type and example
OTHER_RESPONSES: Final[dict[str, tuple[str, object]]] = {
    "read_states": ("application/x-ndjson", json.dumps(STATE_LINE) + "\n"),
    "stream_live": ("text/event-stream", f"id: 812\nevent: live\ndata: {json.dumps(LIVE)}\n\n"),
    "metrics": ("text/plain", 'wayside_http_requests_total{method="GET",route="/livez",status="200"} 1.0\n'),
}
# operations that take nothing but their path and give no body
BODILESS: Final = frozenset({"archive_site", "archive_sensor", "revoke_key", "close_session"})
