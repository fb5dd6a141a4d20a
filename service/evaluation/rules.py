"""The distances and times that decide what a score counts."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ScoringRules:
    """Limits shared by all scores; the defaults are those of the published scenes."""

    cutoff_m: float = 4.0  # GOSPA and OSPA cut-off; similarity is zero from here on (HOTA)
    gate_m: float = 2.0  # a track is on a vehicle up to here: just over half a lane
    order: int = 2  # exponent p of GOSPA and OSPA
    edge_m: float = 1.5  # vehicles this near the region's ends count neither way
    edge_deg: float = 1.5  # ... or this near its sides
    remember_s: float = 1.0  # a vehicle counts while it gave a detection within this time
    ignore_reach_m: float = 10.0  # cap of the cost that pairs tracks with vehicles that do not count
    false_frames: int = 5  # a track id of fewer counted frames is too short to be called false
    false_share: float = 0.3  # a track on a vehicle in less than this share of its frames is false
    latency_skip_s: float = 1.0  # vehicles already there at the start say nothing about latency
    crossing_tolerance_s: float = 1.0  # a found crossing is right within this time of a true one
    wrong_lane_cost_s: float = 0.5  # prefers the crossing of the right lane among near ones
    crossing_gap_s: float = 1.0  # a track is not carried over a count line across a longer gap
    countable_warm_s: float = 5.0  # crossings before this time cannot fairly be asked for
    countable_tail_s: float = 0.5  # nor those so near the end
    countable_frames: int = 10  # nor those of vehicles detected in fewer frames before
    lane_offset_m: float = 1.2  # mean offset up to which a learned lane is a true one
    lane_coverage: float = 0.5  # share of the true lane that must be covered
    lane_alignment: float = 0.7  # mean cosine between the two directions
    lane_near_m: float = 25.0  # lanes are compared between these ranges
    lane_far_m: float = 130.0
    lane_points: int = 15  # a true lane has more points (2 m apart) than this in there
    lane_vehicles: int = 5  # and at least so many vehicles used it
    change_tolerance_s: float = 2.0  # a lane change is right this near the manoeuvre
    change_search_frames: int = 20  # frames each way in which the track is looked up


RULES = ScoringRules()
