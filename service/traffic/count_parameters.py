"""What the counting of vehicles at lines is tuned by; lengths in metres, times in seconds."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CountParameters:
    """Constants of crossings, stitching and ghosts, each with its source."""

    travel_m: float = 1.5  # seen on both sides of a line before a crossing counts; above the jitter of a stop
    edge_m: float = 0.5  # beyond the ends of a line that still cross it: a lateral standard deviation or two
    fit_s: float = 0.5  # on either side of a crossing: samples of the straight fit that gives its time
    window_s: float = 3.0  # of samples kept for fits and ghosts

    # Pieces of one vehicle: cost = (ds - v gap)^2 / (a + b gap)^2 + dd^2 / (c + d gap)^2 + dv^2 / e^2
    stitch_gap_s: float = 3.0
    stitch_along_m: float = 0.8
    stitch_along_mps: float = 0.8
    stitch_across_m: float = 0.7
    stitch_across_mps: float = 0.4
    stitch_speed_mps: float = 2.0
    stitch_cost: float = 9.0  # three standard deviations

    # A piece that goes along inside another, older one is its ghost.
    ghost_share: float = 0.6  # of its life
    ghost_along_m: float = 4.0
    ghost_across_m: float = 1.2  # half of the widest vehicle

    # An echo that goes to a neighbour and back seems to drive behind the vehicle, on its bearing.
    bounce_from_m: float = 2.0  # behind it, ...
    bounce_to_m: float = 20.0  # ... where a neighbour may be
    bounce_spread_m: float = 4.0  # of that distance: a neighbour's way beside the vehicle
    bounce_across_m: float = 0.9  # from the bearing, a median: half the width of a car
    bounce_leaves_m: float = 1.0  # the way of the vehicle, which a follower would not

    # A crossing that nobody saw, of a vehicle first seen behind the line or last seen before it
    unseen_behind_s: float = 4.0  # of the way back to the line, at most; beyond, too few are real
    unseen_order_m: float = 120.0  # ... unless the order of its lane tells when that was
    unseen_ahead_s: float = 4.0  # of the way on to it; farther, once one crosses that was behind it
    unseen_silent_s: float = 0.5  # without a measurement before a vehicle is lost
    unseen_lost_s: float = 30.0  # ... and for which it stays so
    unseen_life_s: float = 2.5  # for which it was followed: second tracks of a vehicle rarely are
    unseen_wait_s: float = 1.5  # for others that are counted there
    unseen_least_mps: float = 3.0  # slower ones may have stood
    unseen_apart_m: float = 2.0  # between bumpers of vehicles in a lane, at least ...
    unseen_apart_s: float = 0.6  # ... and between their middles in time
    unseen_guess_s: float = 1.5  # between two guesses of when one vehicle crossed: three standard deviations
    unseen_across_m: float = 2.5  # beside one another vehicles are farther apart
    # Shares of such crossings that are real, on simulated roads
    unseen_share: float = 0.93  # told by speed
    unseen_between_share: float = 0.75  # by who drives before and behind it: 33 of 44 within three seconds
    unseen_passed_share: float = 0.9  # by who drove behind it when it was lost: 52 of 56

    least_life_s: float = 1.0  # listed for less, a vehicle is more often a ghost than not
    least_existence: float = 0.5  # of a track whose crossing is counted
    real_share: float = (
        0.995  # of crossings of tracks that exist for sure: some are second tracks of a vehicle
    )
    least_speed_mps: float = 0.1  # of a crossing: what 1/v and occupancy can bear
    assumed_length_m: float = 4.5  # of a vehicle whose length is not known yet: a car's
    cell_m: float = 20.0  # of a lane: Edie's cells hold a few vehicles each, and a minute of them
    blind_s: float = 1.0  # without a frame before traffic counts as unobserved; the tracker coasts for longer

    auto_range_m: float = 60.0  # where a line is placed when none is drawn: many points a vehicle, few hidden
    auto_margin_m: float = 2.5  # by which it reaches beyond the outer lanes' centre lines
