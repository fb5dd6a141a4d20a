"""What the reproduction of the ASTEKF paper shows, in words."""

from __future__ import annotations

from service.evaluation.reproduce.form import Figure, Kind, Table, sentences

CITATION = (
    'F. Tian, X. Guo, W. Fu, "Target Tracking Algorithm Based on Adaptive Strong Tracking Extended Kalman '
    'Filter", Electronics 2024, 13, 652, doi 10.3390/electronics13030652.'
)
HOLDS = sentences("""
The range direction (y, vy) of motion 1: all six numbers of table 2 within 15 %, and ASTEKF before
STEKF and EKF by shares within seven points of the printed ones.

The order of motion 2 in the range direction, its EKF and STEKF rows within 15 %; the ASTEKF of ours is less
good than printed (y 0.35 for 0.26 m, vy 1.0 for 0.85 m/s).

The adaptive softening factor is as good as the best fixed one and needs no tuning (table C).
""")
FAILS = sentences("""
The x positions of table 2 cannot be had at the printed azimuth noise of 0.5 deg: each is below the posterior
Cramer-Rao bound (0.27 m), that of the ASTEKF nine times. At 0.05 deg (table A) the STEKF row and the text
agree with the paper but for x; that the paper's azimuth noise was that is our inference and stated nowhere.
The same holds for table 3.

The EKF's x errors are reached at no azimuth noise that we tried: they are smaller than ours at 0.5 deg and
larger at 0.05 deg.

The printed gain of 46 and 38 % is recovery from a wrong start. With a right start and little process noise
the EKF is at the bound on motion 1 (table D), so that no fading filter can beat it there.

Table 4 and figures 10 and 11 come from drives that are not published; ours are simulated stand-ins with the
noise of the simulation. Figures 7, 8 and 12 show clustering, association and lanes of the same recording.
""")
CHANGED = sentences("""
Eq. 20, 21 need the true state; the softening factor is found online instead, by how well each candidate
predicted the innovations.

Eq. 22 uses V of the scan before; eq. 24 propagates P once; the traces of eq. 24 to 27 are whitened by R;
eq. 28 is a congruence, and the update is in Joseph form. The literal forms lose positive definiteness.

The default filter `astekf` goes further: fading for each axis of the line of sight, the signed mean of the
innovations as statistic, a damped acceleration and an update that resists outliers. `astekf-paper` is the
form of these tables.

The start (position measured, no velocity), q = 0.02 m/s^2 and the shares alpha are identified from the
tables; the paper does not state them.
""")
NO_RESULTS: tuple[tuple[Table, ...], tuple[Figure, ...]] = (
    (Table("Table 1", "parameters of the radar", Kind.NO_RESULT),),
    (
        Figure("Figures 1-2", "hardware and flow chart", Kind.NO_RESULT),
        Figure("Figure 6", "photographs of the road", Kind.NO_RESULT),
        Figure("Figure 7", "clusters of the recording", Kind.UNPUBLISHED),
        Figure("Figure 8", "associations of the recording", Kind.UNPUBLISHED),
        Figure("Figure 9", "photographs of the vehicles", Kind.NO_RESULT),
        Figure("Figure 12", "lanes of the recording", Kind.UNPUBLISHED),
    ),
)
