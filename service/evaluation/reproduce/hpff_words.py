"""What the reproduction of the HPFF paper shows, in words."""

from __future__ import annotations

from service.evaluation.reproduce.form import Figure, Kind, Table, sentences

CITATION = (
    'J. M. Pak, "Hybrid PDA/FIR Filtering for Preceding Vehicle Tracking Using Automotive Radars", '
    "IEEE Access 9, 2021, doi 10.1109/ACCESS.2021.3107464."
)
HOLDS = sentences("""
The FIR reset removes nearly all of the PDAF's lost tracks in moderate clutter and most of them in heavy
clutter, as printed in tables 2, 3 and 5. Under the fitted reading the HPFF's errors in tables 2 and 3 are met
within 13 %.

HPFF before PDAF in position error and in lost tracks in every row of tables 2 to 6.
""")
FAILS = sentences("""
With every nominal miss dropping the target (literal reading) the HPFF resets four to five times in a drive
and its errors are larger than printed, the more the lower P_D is. A third of the nominal misses meets tables
2 and 3 and comes near table 4. That third is fitted; the paper does not state it.

M7: the paper gives neither the speed nor the shape of the lane change. The reading chosen loses fewer tracks
with the PDAF in moderate clutter, and more with the HPFF in heavy clutter, than printed.

M8, HPFF, moderate clutter: our error is smaller than printed; sigma_w is not stated.

Eq. 30 is a root of summed squares; with it a few per cent of lost tracks would dominate every number. The
tables fit mean error norms.

The gain depends on a process noise below the paper's own rule (half of a_M to a_M): with sigma_w of 1 to 2
m/s^2 the PDAF alone keeps most of what it loses in table 5 (table B).

A reset at every empty gate costs velocity accuracy in normal driving (M1: 0.17 to 0.28 m/s).
""")
CHANGED = sentences("""
Eq. 6 is read as r sigma_theta^2 / sigma_r < 0.4, and a return that breaks it gives a warning at run time.

Eq. 11 gets its G Q G'. Eq. 15 gets the determinant of S; the printed |R| is an option, used in tables 2 to 6.
Eq. 26 gets its J_N, its G_bar and P* = J M^-1 J'; the printed P* is up to three times too large (table C).

For several targets the reset needs evidence: see the FIR recovery of the live tracker in docs/papers.md.
""")
NO_RESULTS: tuple[Table, Figure] = (
    Table("Table 1", "list of acronyms", Kind.NO_RESULT),
    Figure("Figures 1-3", "radar geometry, empty gate, and the eight motions", Kind.NO_RESULT),
)
