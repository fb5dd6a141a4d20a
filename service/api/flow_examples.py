"""Examples for the operations that count; `examples` joins them to the others."""

from __future__ import annotations

from typing import Final

CROSSING: Final = {
    "crossing_id": "radar-1-1-c17",
    "sensor_id": "radar-1",
    "line_id": "C40",
    "timestamp": "2025-05-12T06:00:05.214Z",
    "lane_id": "L2",
    "lane_map_version": 3,
    "direction": -1,
    "track_id": "radar-1-1-3",
    "vehicle_id": "radar-1-1-3",
    "frame": 104,
    "x_m": 1.21,
    "y_m": 40.0,
    "speed_mps": 16.811,
    "signed_speed_mps": -16.811,
    "length_m": 4.512,
    "length_class": "short",
    "headway_s": 2.914,
    "gap_s": 2.645,
    "probability": 0.998,
}
FLOW_ROW: Final = {
    "row": "WyJDNDAiLDIsLTEsbnVsbF0-1747029600-900",
    "sensor_id": "radar-1",
    "line_id": "C40",
    "lane_id": "L2",
    "lane_scope": "lane",
    "direction": -1,
    "length_class": None,
    "start": "2025-05-12T06:00:00.000Z",
    "end": "2025-05-12T06:15:00.000Z",
    "interval_s": 900,
    "coverage": 0.998,
    "observed": 1.0,
    "n": 212,
    "volume": 212,
    "volume_low": 209,
    "volume_high": 220,
    "flow_vph": 848.0,
    "time_mean_speed_mps": 16.92,
    "space_mean_speed_mps": 16.655,
    "p85_speed_mps": 19.104,
    "occupancy_percent": 9.311,
    "density_per_km": 14.143,
    "mean_length_m": 4.87,
    "mean_headway_s": 4.243,
    "mean_gap_s": 3.951,
    "peak_hour_factor": None,
    "virtual_length_m": 2.0,
    "speed_histogram": [0, 0, 0, 2, 9, 40, 101, 52, 8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
    "quality": [],
    "definitions": "wayside-flow-1",
}
_WINDOW: Final = {"sensor_id": "radar-1", "interval": "15min", "time_zone": "Europe/Berlin"}
_SPAN: Final = {"start": "2025-05-12T06:00:00.000Z", "end": "2025-05-12T06:15:00.000Z"}
CELL_ROW: Final = {
    "sensor_id": "radar-1",
    "lane_id": "L2",
    "lane_map_version": 3,
    "cell": 2,
    **_SPAN,
    "interval_s": 900,
    "coverage": 0.998,
    "observed": 1.0,
    "length_m": 20.0,
    "distance_m": 4230.5,
    "time_s": 252.4,
    "flow_vph": 846.1,
    "density_per_km": 14.022,
    "speed_mps": 16.761,
    "definitions": "wayside-flow-1",
}
MOVEMENT_ROW: Final = {
    **_SPAN,
    "entry": "north",
    "exit": "west",
    "length_class": "short",
    "volume": 31,
    "expected": 30.842,
}
MANUAL_COUNT: Final = {
    "line_id": "C40",
    "start": "2025-05-12T06:00:00Z",
    "interval_s": 900,
    "direction": -1,
    "counted": 214,
}
CHECK_ROW: Final = {
    "line_id": "C40",
    "lane_id": None,
    "direction": -1,
    "length_class": None,
    **_SPAN,
    "interval_s": 900,
    "coverage": 0.998,
    "counted": 214,
    "measured": 212,
    "difference": -2,
    "relative_error": -0.0093,
    "geh": 0.274,
    "within_target": True,
}

PAGES: Final[dict[str, object]] = {"read_crossings": CROSSING}
EVIDENCE: Final[dict[str, object]] = {
    "flow": FLOW_ROW,
    "crossings": [CROSSING],
    "frames": {"first": 104, "last": 104, "start": CROSSING["timestamp"], "end": CROSSING["timestamp"]},
}
RESPONSES: Final[dict[str, object]] = {
    "read_flow": _WINDOW | {"items": [FLOW_ROW]},
    "read_cells": _WINDOW | {"items": [CELL_ROW]},
    "read_coverage": _WINDOW | {"items": [{**_SPAN, "coverage": 0.998, "observed": 1.0}]},
    "read_movements": _WINDOW | {"items": [MOVEMENT_ROW]},
    "check_manual_counts": {"sensor_id": "radar-1", "items": [CHECK_ROW]},
    "read_checks": {"sensor_id": "radar-1", "items": [CHECK_ROW]},
}
