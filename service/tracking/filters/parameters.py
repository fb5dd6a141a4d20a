"""The constants of the filters: unit, default and where each comes from. `None` switches a part off.

"Study" below is the project's own Monte Carlo comparison on eight road manoeuvres (range std 0.75 m,
azimuth std 0.5 deg, 20 Hz); "paper" is Electronics 2024, 13, 652 ("Target Tracking Algorithm Based on
Adaptive Strong Tracking Extended Kalman Filter"), its symbols in brackets.
"""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class EkfParameters:
    """Extended Kalman filter, damped constant-acceleration model, an update that resists outliers."""

    accel_std_mps2: float = (
        0.177  # jump of the acceleration per 0.05 s; study: best for the damped model without fading
    )
    accel_tau_s: float | None = (
        1.3  # time constant with which the acceleration decays; None: never (the paper)
    )
    robust_gate: float | None = 16.0  # NIS above which R is inflated; study
    gate_release_frames: int | None = 3  # after so many rejected frames in a row the next is taken as it is


@dataclass(frozen=True, slots=True)
class StekfParameters:
    """Strong tracking EKF, one fading factor for all states (paper, eq. 22-26)."""

    accel_std_mps2: float = 0.10
    accel_tau_s: float | None = None
    forgetting: float = 0.95  # [rho] weight of the past in the residual covariance; paper
    softening: float = 5.0  # [beta] share of R taken from the residual covariance; study: useful from 4 to 6
    lambda_max: float = 2.0  # largest fading factor; the factors compound from frame to frame
    clip: float | None = 12.0  # NIS to which residuals are shortened before they enter the statistic
    robust_gate: float | None = 16.0
    gate_release_frames: int | None = 3


@dataclass(frozen=True, slots=True)
class AstekfParameters:
    """The recommended adaptive strong tracking EKF: fading per line-of-sight axis; for single points."""

    accel_std_mps2: float = 0.11  # [q] study: the acceleration has a spread of 0.36 m/s^2
    accel_tau_s: float | None = 1.0
    statistic_gain: float = 0.115  # [g] weight of the newest innovation in its running mean
    softening_start: float = (
        5.0  # [b0] softening factor of a track's first measurements; study: useful from 4 to 6
    )
    softening_step: float = 0.6  # [u] step of the grid b_n = 1 + u n
    softening_fixed: float | None = None  # use this factor always and search none
    warm_up: int = 10  # measurements of a track that use `softening_start`; paper
    score_forgetting: float = 0.9  # [gamma] memory of the predictive score of each b_n
    score_tolerance: float = 1.0  # fade as little as a score this close to the best allows
    alpha_position: float = 1.0  # [alpha] shares of the fading among the derivatives
    alpha_velocity: float = 2.0
    alpha_acceleration: float = 3.0
    lambda_max: float = 2.0
    clip: float | None = 7.0  # NIS to which innovations are shortened before they enter the statistic
    robust_gate: float | None = 16.0
    gate_release_frames: int | None = 3


@dataclass(frozen=True, slots=True)
class AstekfPaperParameters:
    """The adaptive strong tracking EKF as the paper has it, in the reading that can be computed online.

    One set of fading factors for both axes, residual covariance by eq. 22. The defaults keep the two guards
    without which it diverges on outliers; `PAPER_ASTEKF` is without them.
    """

    accel_std_mps2: float = 0.02  # [q] not printed; identified from the paper's EKF row
    accel_tau_s: float | None = None
    forgetting: float = 0.95  # [rho]
    softening_start: float = 2.0  # [b0]
    softening_step: float = 0.5  # [u]
    softening_fixed: float | None = None
    warm_up: int = 10
    score_forgetting: float = 0.9
    score_tolerance: float = 3.0
    alpha_position: float = 1.05
    alpha_velocity: float = 1.58
    alpha_acceleration: float = 1.26
    lambda_max: float = 10.0
    clip: float | None = 12.0
    robust_gate: float | None = 16.0
    gate_release_frames: int | None = 3


@dataclass(frozen=True, slots=True)
class UkfParameters:
    """Unscented Kalman filter over the damped constant-acceleration model of the EKF."""

    accel_std_mps2: float = 0.177
    accel_tau_s: float | None = 1.3
    spread: float = 1.0  # [alpha] of the sigma points; 0.001 in the paper, which is the same to four digits
    robust_gate: float | None = 16.0
    gate_release_frames: int | None = 3


@dataclass(frozen=True, slots=True)
class StUkfParameters:
    """ST-UKF and AST-UKF: one fading factor. "MAST" below is Appl. Sci. 2025, 15, 3276."""

    accel_std_mps2: float = 0.10  # smaller than for a filter that cannot fade; study
    accel_tau_s: float | None = 1.3
    spread: float = 1.0
    forgetting: float = 0.95  # [rho] MAST, eq. 22
    softening: float = 4.0  # [beta] study: without it the filter fades on noise
    lambda_max: float = 1.3  # factors compound: 1.3 at 20 Hz, 4 at 1 Hz; study
    robust_gate: float | None = 16.0
    gate_release_frames: int | None = 3


@dataclass(frozen=True, slots=True)
class MastUkfParameters:
    """MAST-UKF: factors D on Q for each axis and J on R for each channel; gains are per frame of 0.05 s."""

    accel_std_mps2: float = 0.10  # smaller than for a filter that cannot fade; study
    accel_tau_s: float | None = 1.3
    spread: float = 1.0
    form: str = "safe"  # "paper" and "printed" are for comparison: they lose manoeuvring targets
    axis_gain: float = 0.0488  # log 1.05: D changes by 0.95 to 1.05 a frame; MAST, eq. 3
    axis_max: float = 64.0  # bound of D and 1/D; study
    residual_max: float = 3.0  # normalised residuals are clipped here
    product_gain: float = 0.1  # weight of the newest product of successive residuals
    white_product: float = 0.5  # residuals are white while the running product stays below
    noise_gain: float = 0.03  # of log J
    noise_mean: float = 0.92  # mean of min(e^2, 4) of a standard normal e
    noise_cap: float = 4.0
    noise_max: float = 25.0  # bound of J
    manoeuvre_residual: float = 1.5  # two successive residuals beyond it, of one sign, are a manoeuvre
    manoeuvre_fading: float = 2.0  # of the covariance of that axis
    outlier_limit: float = 6.6  # chi-square of one channel, 99 %
    gate_release_frames: int | None = 3
    forgetting: float = 0.95  # [rho] of the paper's form; eq. 22
    window: int = 30  # frames of the paper's comparison; eq. 6
    every: int = 10  # frames between its decisions


@dataclass(frozen=True, slots=True)
class SrckfParameters:
    """Square-root cubature Kalman filter over the damped constant-acceleration model of the EKF."""

    accel_std_mps2: float = 0.177
    accel_tau_s: float | None = 1.3
    robust_gate: float | None = 16.0
    gate_release_frames: int | None = 3


@dataclass(frozen=True, slots=True)
class SageHusaParameters:
    """ISRCKF and SH-EKF: noises estimated online. Counts and weights are per frame of 0.04 to 0.05 s."""

    accel_std_mps2: float = 0.177
    accel_tau_s: float | None = 1.3
    form: str = "safe"  # "fading" and "mean" are the paper's recursions, for comparison
    forgetting: float = 0.97  # [b] Sensors 2020, eq. 24: 0.95 to 0.99
    virtual: int = 20  # measurements that the configured noises count as; study
    warm_up: int = 10  # measurements of a track before anything is estimated
    nis_max: float = 25.0  # mean square of the normalised residuals from which nothing is learnt
    ratio_max: float = 9.0  # bound of one sample of the scale of R
    noise_min: float = 0.1  # bounds of the scale of R
    noise_max: float = 100.0
    axis_min: float = 0.5  # bounds of the scale of Q
    axis_max: float = 25.0
    outlier_limit: float = 6.6  # chi-square of one channel, 99 %
    gate_release_frames: int | None = 3


@dataclass(frozen=True, slots=True)
class ImmParameters:
    """Interacting models: cruise (constant velocity), accelerate (damped constant acceleration), turn."""

    velocity_density_m2ps3: float = (
        0.066  # white acceleration while cruising; this and below: search on the study
    )
    accel_std_mps2: float = 0.82
    accel_tau_s: float | None = 3.2
    turn_std_mps2: float = 0.08
    cruise_s: float = 29.0  # how long each lasts on average
    accelerate_s: float = 3.4
    turn_s: float = 1.5
    robust_gate: float | None = 16.0
    gate_release_frames: int | None = 3


# Vehicles that turn at a crossing are large innovations of a box for longer, and ought not to be shortened.
# Measured in the live tracker: with the constants for points crossings lose 0.01 to 0.03 of HOTA.
ROAD_ASTEKF = AstekfParameters(accel_std_mps2=0.10, accel_tau_s=1.3, clip=12.0)

# The errors of a box's centre stay alike from frame to frame, and their differences say that R is small.
# Measured in the live tracker on stop-and-go traffic: HOTA 0.63 with a bound of 0.1, 0.69 with 1.
ROAD_SAGE_HUSA = SageHusaParameters(noise_min=1.0)

UNBOUNDED = 1e9  # a fading factor that no data of the paper reaches

# The rows of the paper's tables 2 and 3: no guards.
PAPER_EKF = EkfParameters(accel_std_mps2=0.02, accel_tau_s=None, robust_gate=None)
PAPER_STEKF = StekfParameters(
    accel_std_mps2=0.02, softening=2.0, lambda_max=UNBOUNDED, clip=None, robust_gate=None
)
PAPER_ASTEKF = AstekfPaperParameters(lambda_max=UNBOUNDED, clip=None, robust_gate=None)


@dataclass(frozen=True, slots=True)
class FilterParameters:
    """The constants of every filter, so that a configuration can hold them beside the chosen name."""

    ekf: EkfParameters = field(default_factory=EkfParameters)
    stekf: StekfParameters = field(default_factory=StekfParameters)
    astekf: AstekfParameters = field(default_factory=lambda: ROAD_ASTEKF)
    astekf_paper: AstekfPaperParameters = field(default_factory=AstekfPaperParameters)
    ukf: UkfParameters = field(default_factory=UkfParameters)
    st_ukf: StUkfParameters = field(default_factory=StUkfParameters)
    ast_ukf: StUkfParameters = field(default_factory=StUkfParameters)
    mast_ukf: MastUkfParameters = field(default_factory=MastUkfParameters)
    srckf: SrckfParameters = field(default_factory=SrckfParameters)
    sh_ekf: SageHusaParameters = field(default_factory=lambda: ROAD_SAGE_HUSA)
    isrckf: SageHusaParameters = field(default_factory=lambda: ROAD_SAGE_HUSA)
    imm: ImmParameters = field(default_factory=ImmParameters)


# For single points, as in the studies; the defaults above are for the boxes of the live tracker.
POINT_FILTERS = FilterParameters(
    astekf=AstekfParameters(), sh_ekf=SageHusaParameters(), isrckf=SageHusaParameters()
)
