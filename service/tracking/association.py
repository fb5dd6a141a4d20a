"""Turn likelihood ratios of gated pairs into association probabilities: joint probabilistic data association.

`marginals` sums over all joint hypotheses (JPDA); `assign_maximum` takes the one of greatest weight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse.csgraph import connected_components

from service.errors import InvalidInput
from service.tracking.association_kernels import INVALID, UNBALANCED, solve
from service.tracking.kernel import ready
from service.tracking.model import F64, I64

SAFE_RANGE = 600.0  # natural log; hypotheses that span less cannot underflow (float64 reaches to 708)
NOT_NUMBERS = "want numbers or -inf (outside the gate), and log_miss finite"
WIDEST = 24  # a layer of 2^24 states is 128 MB: beyond it the exact recursion is no use


@dataclass(frozen=True, slots=True)
class Marginals:
    """Association probabilities of T tracks and M measurements; a row of beta and its miss sum to 1."""

    beta: F64  # (T, M) probability that the measurement is the track's
    miss: F64  # (T,) probability that the track has no measurement
    components: int  # connected components of tracks with common measurements, lone tracks included
    approximated: int  # components wider than the limit, solved by loopy belief propagation
    component: I64  # (T,) each track's component, numbered by their first track


def marginals(log_weight: F64, log_miss: F64, *, temper: float = 1.0, max_width: int = 14) -> Marginals:
    """Return the marginal probabilities over all joint hypotheses, exact unless counted in `approximated`.

    log_weight: (T, M) log of P_D N(z; z^, S) / clutter density, -inf outside the gate.  log_miss: (T,) log of
    the weight of having no measurement, 1 - P_D P_G.  Only differences inside a row matter, and they may be
    huge. temper: power to which joint weights are raised where two or more tracks compete; 1 is plain JPDA,
    1.5 to 2 keeps neighbours apart that azimuth noise would merge.  max_width: most measurements that the
    recursion carries at once (2^max_width states); wider components are approximated.

    Source: Fortmann, Bar-Shalom, Scheffe 1983 (JPDA); the sum is by dynamic programming over the measurements
    that placed and unplaced tracks share.
    """
    log_weight, log_miss = _checked(log_weight, log_miss)
    if not 0 < temper < np.inf:
        raise InvalidInput.at("/temper", f"want a positive number, got {temper}")
    if not 0 <= max_width <= WIDEST:
        raise InvalidInput.at("/max_width", f"want 0 to {WIDEST}, got {max_width}")
    tracks, measurements = log_weight.shape
    beta, miss, component = np.empty_like(log_weight), np.empty(tracks), np.empty(tracks, np.int64)
    price, temper, max_width = np.zeros(measurements), float(temper), int(max_width)
    solved = solve(log_weight, log_miss, price, SAFE_RANGE, temper, max_width, beta, miss, component)
    if solved[0] == UNBALANCED:
        price = _balancing_prices(log_weight, log_miss)
        solved = solve(log_weight, log_miss, price, np.inf, temper, max_width, beta, miss, component)
    if solved[0] == INVALID:
        raise InvalidInput.at("/log_weight", NOT_NUMBERS)
    return Marginals(beta, miss, *solved, component)


def assign_maximum(log_weight: F64, log_miss: F64) -> Marginals:
    """Return the joint hypothesis of greatest weight as probabilities 0 and 1; arguments as for `marginals`.

    Source: the ASTEKF paper's association by maximum probability; solved as an assignment problem.
    """
    log_weight, log_miss = _checked(log_weight, log_miss)
    if not ((log_weight < np.inf).all() and np.isfinite(log_miss).all()):
        raise InvalidInput.at("/log_weight", NOT_NUMBERS)
    choice = _best_choice(log_weight, log_miss)
    chose = choice >= 0
    beta = np.zeros_like(log_weight)
    beta[chose, choice[chose]] = 1.0
    gate = (log_weight > -np.inf).astype(np.int64)
    components, component = connected_components(gate @ gate.T, directed=False)
    return Marginals(beta, np.where(chose, 0.0, 1.0), components, 0, component.astype(np.int64))


def _best_choice(log_weight: F64, log_miss: F64) -> I64:
    """Return (T,) the measurement of each track in the hypothesis of greatest weight, or -1."""
    tracks, measurements = log_weight.shape
    own = np.full((tracks, tracks), -np.inf)  # staying, as a column for each track
    np.fill_diagonal(own, log_miss)
    choice = linear_sum_assignment(np.hstack([log_weight, own]), maximize=True)[1]
    return np.where(choice < measurements, choice, -1)


def _balancing_prices(log_weight: F64, log_miss: F64) -> F64:
    """Return (M,) the least prices at which the best hypothesis gives every track its best choice.

    They are the dual variables of the assignment problem: with weights lowered by them and rows scaled to
    their maximum, the best hypothesis weighs 1 and no choice more, so that what underflows does not matter.
    """
    choice = _best_choice(log_weight, log_miss)
    track = np.arange(len(choice))
    value = np.where(choice >= 0, log_weight[track, choice], log_miss)
    price = np.zeros(log_weight.shape[1])
    for _ in track:  # longest paths have no more steps than there are tracks
        bid = log_weight - (value - np.where(choice >= 0, price[choice], 0.0))[:, None]
        raised = np.maximum(price, bid.max(axis=0))
        if np.array_equal(raised, price):
            break
        price = raised
    return price


def _checked(log_weight: F64, log_miss: F64) -> tuple[F64, F64]:
    if log_weight.ndim != 2 or log_miss.shape != log_weight.shape[:1]:  # noqa: PLR2004 - tracks by measurements
        raise InvalidInput.at(
            "/log_weight", f"want (T, M) with log_miss (T,), got {log_weight.shape} and {log_miss.shape}"
        )
    return ready(log_weight), ready(log_miss)
