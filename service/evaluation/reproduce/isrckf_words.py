"""What the reproduction of the ISRCKF paper shows, in words."""

from __future__ import annotations

from service.evaluation.reproduce.form import Figure, Kind, Table, sentences

CITATION = (
    'S. Song, J. Wu, "Motion State Estimation of Target Vehicle under Unknown Time-Varying Noises Based on '
    'Improved Square-Root Cubature Kalman Filter", Sensors 2020.'
)
HOLDS = sentences("""
ISRCKF before SRCKF and SH-EKF where the noise is unknown and changes: in the simulated drives its speed error
is a third below the SRCKF's in the median, and its distance error a fifth (printed: at most 29 and 59 %). In
the parking and the tunnel a part of that is its guard against outliers, which the others lack here.

The estimated noise follows steps of 4 and 9 in the variance within a quarter of the drive (table B).

The motion states and all their times, by the classifier of the live pipeline.

The ISRCKF costs more than the SRCKF and SH-EKF (printed: 13 and 4 %; in numpy, which pays for each call,
about 70 and 50 %).
""")
FAILS = sentences("""
No drive of the paper is published. Figures 5 to 8 are simulated stand-ins: the four environments are named
in the paper without numbers, so loudness, outliers and braking of each are ours, and the ratios say nothing
about its roads.

The literal estimator of Q (eq. 27) is indefinite in nearly every update, so that a filter that takes its root
stops; the mean estimators (eq. 25, 26) diverge. The printed SH-EKF (eq. 22, 23) is no rival.

The printed measurement (eq. 4: range and the absolute speed) leaves the azimuth out and hides the sign of the
speed, so that the side position cannot be known; ours is range, azimuth and signed range rate.

With the right R (campus, expressway) the distance gains nothing: the large printed gains need a wrong R.

The filter that follows the paper to the letter (estimators with the last sample's weight of eq. 24) loses the
vehicle in the tunnel, among outliers.
""")
CHANGED = sentences("""
R is estimated from differenced residuals relative to their variance, which is positive and free of the slow
bias of a manoeuvre; Q has one scale for each axis with a floor. Neither can lose positive definiteness.

Twenty virtual measurements keep the first one from replacing R (eq. 24 has d = 1 there).

The motion states get two rules where the paper's have no way out; the curve of figure 10 is reconstructed.
""")
NO_RESULTS: tuple[tuple[Table, ...], tuple[Figure, ...]] = (
    (Table("Tables 1, 2", "parameters of radar and lidar", Kind.NO_RESULT),),
    (Figure("Figures 1-4", "axes, states, car and places", Kind.NO_RESULT),),
)
