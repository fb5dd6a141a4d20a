"""What each score of a report means, in a sentence."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

MEANINGS: Mapping[str, str] = MappingProxyType(
    {
        "hota": "Geometric mean of the two below, over all matching distances (Luiten 2021).",
        "deta": "Share of vehicles and tracks, frame by frame, that match one another.",
        "assa": "How much of a vehicle's life one track follows, and of a track's life one vehicle.",
        "gospa": "Place errors, missed vehicles and false tracks of a frame in one (Rahmathullah 2017).",
        "gospa_loc": "The part of GOSPA that is error of place.",
        "gospa_missed": "Vehicles that no track is near, on average at any time.",
        "gospa_false": "Tracks that are near no vehicle, on average at any time.",
        "ospa": "Mean error of place in a frame where a vehicle missed or invented counts as the cut-off.",
        "mota": "One less the share of misses, false tracks and identity switches (Bernardin 2008).",
        "motp_m": "Mean distance of matched tracks from their vehicles.",
        "recall": "Share of vehicles, frame by frame, that a track follows.",
        "precision": "Share of tracks, frame by frame, that follow a vehicle.",
        "idf1": "Share of a vehicle's frames that carry its one best track (Ristani 2016).",
        "id_switches": "Changes of the track that follows a vehicle.",
        "switches_per_100": "The same for each 100 vehicles.",
        "ids_per_vehicle": "Tracks that follow one vehicle in its life, on average.",
        "fragmentations": "Interruptions of vehicles that are followed again later.",
        "mostly_tracked": "Share of vehicles followed for at least four fifths of their life.",
        "mostly_lost": "Share of vehicles followed for at most a fifth of their life.",
        "never_tracked": "Vehicles that no track ever followed.",
        "false_tracks_per_min": "Tracks that never followed a vehicle, each minute.",
        "ghost_share": "Share of all tracks that never followed a vehicle.",
        "pos_rmse_m": "Root mean square distance of tracks from the middle of their vehicles.",
        "lateral_rmse_m": "Its part across the vehicle: what decides on the lane.",
        "along_bias_m": "Mean error along the vehicle, positive ahead of its middle.",
        "vel_rmse_mps": "Root mean square error of the velocity as a vector.",
        "speed_mae_mps": "Mean absolute error of the speed.",
        "length_mae_m": "Mean absolute error of the length, from the eighth frame with points on.",
        "latency_median_s": "From a vehicle's entry into view to its confirmed track, median.",
        "latency_p90_s": "The same for nine vehicles of ten.",
        "count_recall": "Share of countable crossings of the lines that were counted.",
        "count_precision": "Share of counted crossings that happened.",
        "count_net_error": "Error of the sums that users read, by line.",
        "count_lane_error": "Error of the sums by lane.",
        "count_lane_right": "Share of counted crossings in the right lane.",
        "crossing_time_bias_s": "Mean error of the time of a crossing.",
        "crossing_time_sd_s": "Standard deviation of the same.",
        "crossing_speed_mae_mps": "Mean absolute error of the speed at the line.",
        "lanes_true": "Lanes that there are.",
        "lanes_right": "Lanes that were learned and are there.",
        "lanes_extra": "Lanes that were learned and are not there.",
        "lane_offset_mean_m": "Distance of learned centre lines from the true ones.",
        "lane_offset_max_m": "Their largest distance.",
        "changes_true": "Lane changes that there were.",
        "changes_recall": "Share of lane changes that were reported.",
        "changes_precision": "Share of reported lane changes that there were.",
        "ms_per_frame": "CPU time of one step of the tracker, mean.",
        "ms_p99": "CPU time of the slowest step of a hundred.",
    }
)
