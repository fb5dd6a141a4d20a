"""What each score is called, how it is rounded, which way is better, and the bar it must reach.

Floors and aims are the product's own; a score without a bar has none. Rates that follow from scores (switches
per 100 vehicles, share of false tracks) are worked out here, so that the scores keep their keys.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

Value = float | int | str


@dataclass(frozen=True, slots=True)
class Measure:
    """One line of a report."""

    key: str
    title: str
    short: str  # head of a narrow column
    decimals: int = 2
    higher_is_better: bool = False
    floor: float | None = None  # must
    aim: float | None = None  # wish


MEASURES = (
    Measure("hota", "HOTA", "HOTA", 3, higher_is_better=True),
    Measure("deta", "detection accuracy", "DetA", 3, higher_is_better=True),
    Measure("assa", "association accuracy", "AssA", 3, higher_is_better=True),
    Measure("gospa", "GOSPA, m", "GOSPA"),
    Measure("gospa_loc", "GOSPA, localisation, m", "loc"),
    Measure("gospa_missed", "missed vehicles per frame", "missed"),
    Measure("gospa_false", "false tracks per frame", "false"),
    Measure("ospa", "OSPA, m", "OSPA"),
    Measure("mota", "MOTA", "MOTA", 3, higher_is_better=True),
    Measure("motp_m", "MOTP, m", "MOTP"),
    Measure("recall", "recall of vehicles", "recall", 3, higher_is_better=True),
    Measure("precision", "precision of tracks", "prec", 3, higher_is_better=True),
    Measure("idf1", "IDF1", "IDF1", 3, higher_is_better=True),
    Measure("id_switches", "identity switches", "IDSW", 0),
    Measure("switches_per_100", "switches per 100 vehicles", "sw/100", 1, floor=3.0, aim=1.0),
    Measure("ids_per_vehicle", "tracks per vehicle", "ids/veh", 2, floor=1.10, aim=1.03),
    Measure("fragmentations", "fragmentations", "frag", 0),
    Measure("mostly_tracked", "vehicles mostly tracked", "MT", 3, higher_is_better=True),
    Measure("mostly_lost", "vehicles mostly lost", "ML", 3),
    Measure("never_tracked", "vehicles never tracked", "never", 0),
    Measure("false_tracks_per_min", "false tracks per minute", "FT/min", 1),
    Measure("ghost_share", "share of false tracks", "ghosts", 3, floor=0.02, aim=0.005),
    Measure("pos_rmse_m", "position RMSE, m", "pos"),
    Measure("lateral_rmse_m", "lateral RMSE, m", "lat"),
    Measure("along_bias_m", "bias along the vehicle, m", "along"),
    Measure("vel_rmse_mps", "velocity RMSE, m/s", "vel"),
    Measure("speed_mae_mps", "speed error, m/s", "speed"),
    Measure("length_mae_m", "length error, m", "length", 2, floor=1.0),
    Measure("latency_median_s", "latency, median, s", "lat50"),
    Measure("latency_p90_s", "latency, 90th percentile, s", "lat90"),
    Measure("count_recall", "countable crossings, recall", "c.rec", 3, higher_is_better=True),
    Measure("count_precision", "countable crossings, precision", "c.prec", 3, higher_is_better=True),
    Measure("count_net_error", "count error of the lines", "c.net", 3, floor=0.02, aim=0.01),
    Measure("count_lane_error", "count error of the lanes", "c.lane", 3, floor=0.05, aim=0.02),
    Measure("count_lane_right", "crossings in the right lane", "c.right", 3, higher_is_better=True),
    Measure("crossing_time_bias_s", "crossing time, bias, s", "t.bias"),
    Measure("crossing_time_sd_s", "crossing time, deviation, s", "t.sd"),
    Measure("crossing_speed_mae_mps", "crossing speed error, m/s", "c.speed"),
    Measure("lanes_true", "lanes, true", "lanes", 0),
    Measure("lanes_right", "lanes, right", "right", 0, higher_is_better=True),
    Measure("lanes_extra", "lanes, extra", "extra", 0),
    Measure("lane_offset_mean_m", "lane offset, mean, m", "offset", 2, floor=0.5, aim=0.25),
    Measure("lane_offset_max_m", "lane offset, largest, m", "off.max"),
    Measure("changes_true", "lane changes, true", "changes", 0),
    Measure("changes_recall", "lane changes, recall", "ch.rec", 3, higher_is_better=True),
    Measure("changes_precision", "lane changes, precision", "ch.prec", 3, higher_is_better=True),
)
SPEED = (
    Measure("ms_per_frame", "CPU ms per frame", "ms"),
    Measure("ms_p99", "CPU ms, 99th percentile", "ms99"),
)
_BY_KEY = {measure.key: measure for measure in MEASURES}


def select(keys: Iterable[str]) -> tuple[Measure, ...]:
    """Return the measures of these keys in their order; raises KeyError for an unknown one."""
    return tuple(_BY_KEY[key] for key in keys)


def with_rates(scores: Mapping[str, Value]) -> dict[str, Value]:
    """Return the scores with the rates that follow from them."""
    return {
        **scores,
        "switches_per_100": _rate(scores, "id_switches", "vehicles", 100.0),
        "ghost_share": _rate(scores, "false_tracks", "track_ids", 1.0),
    }


def _rate(scores: Mapping[str, Value], part: str, whole: str, scale: float) -> float:
    above, below = scores.get(part), scores.get(whole)
    if not isinstance(above, int | float) or not isinstance(below, int | float) or below == 0:
        return math.nan
    return scale * above / below
