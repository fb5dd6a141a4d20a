"""What the reproduction of the MAST-UKF paper shows, in words."""

from __future__ import annotations

from service.evaluation.reproduce.form import Figure, Kind, Table, sentences

CITATION = (
    'F. Tian, S. Wang, W. Fu, T. Wei, "Vehicle Target Tracking Algorithm Based on Improved Strong Tracking '
    'Unscented Kalman Filter", Appl. Sci. 2025, 15, 3276, doi 10.3390/app15063276.'
)
HOLDS = sentences("""
MAST-UKF a quarter to a third below UKF in position and velocity (printed: 0.75 and 0.63): when the models of
an IMM contain the true motions and 5 % of the measurements are outliers of ten standard deviations (tables C,
D: 0.68 and 0.67, 0.74 and 0.64).

ST-UKF a little before UKF in position where one straight model must follow the circles (table A); there the
MAST-UKF of the paper is three times worse than all others.
""")
FAILS = sentences("""
With the printed noise of 50 m no filter can have the errors of table 2: both positions, and the velocities
of the MAST-UKF, are below the posterior Cramer-Rao bound, the x position four to six times. With 50 m^2
(table B) the printed MAST-UKF is just above a bound that knows every motion, and half of what any filter had.

No reading gives the printed order of all four filters: where the ST-UKF beats the UKF, MAST-UKF loses, and
where MAST-UKF wins the others lose.

Three of the four position rows of table 2 have x/y = 1.732, the root of three, to four digits. Errors of two
axes of a turning target are not so alike; the columns look like one number resolved along 30 degrees.

The printed 32.67, 28.54 and 23.17 % do not follow from table 2 (31.0, 27.8 and 23.0 %).

Averaging the estimated tracks before taking the error gives numbers of the printed size and the order UKF,
ST, AST (table E), but MAST-UKF not first.

Tables 4 and 5 and figure 7 come from drives that are not published; ours are simulated stand-ins.
""")
CHANGED = sentences("""
The filter `mast-ukf` is a safe form: it tells a manoeuvre from noise by the whiteness of the residuals. The
paper's, which explains every excess as measurement noise, is `filters.mast_ukf.form=paper` (with the
corrections without which it cannot run) and `printed`; both lose manoeuvring vehicles in traffic.

Sigma points with a spread of one in place of 0.001, whose weights of a million cancel; results are equal to
four digits. The azimuth is wrapped, H is the statistical linearisation, updates are in Joseph form.

D of eq. 7, 8 as printed is always at its maximum; the ratio is taken the other way round.
""")
NO_RESULTS: tuple[tuple[Table, ...], tuple[Figure, ...]] = (
    (
        Table("Table 1", "motions of the target", Kind.NO_RESULT),
        Table("Table 3", "parameters of the radar", Kind.NO_RESULT),
    ),
    (
        Figure("Figure 1", "flow chart", Kind.NO_RESULT),
        Figure("Figures 4-6", "hardware and photographs", Kind.NO_RESULT),
    ),
)
