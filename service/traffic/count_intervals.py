"""The interval in which the true volume lies: what may be false among the counted, what may be missing.

Counted are n vehicles, each real with its own probability, in the share o of the time that was observed. The
true volume is n - F + M. F, the false ones, is Poisson with mean sum(1 - p_i). M, the missed, has two parts:

    hidden by others:  each vehicle with chance h, mean n h / (1 - h), variance mean / (1 - h) + (d mean)^2,
                       since h itself is known to the share d of its value only
    not observed:      mean (n - F + hidden) (1 - o) / o, variance I mean / o: that of a count process whose
                       rate is estimated from the time observed, I its variance over its mean

with n + 1/2 for n (Jeffreys prior of a rate). For a renewal process I is the squared coefficient of
variation of its headways: 1 for traffic at random, 0.2 to 0.5 where vehicles follow one another. It is taken
from the headways of the cell itself, drawn towards 1 with the weight of four of them.

M is binomial, Poisson or negative binomial, as its variance is below, at or above its mean. The bounds hold
the most likely volumes that are as probable as the level together (highest density); since volumes are whole
numbers they are more probable than that by a few percent, the more the fewer vehicles may be missing.

Who is hidden: the ray to a vehicle at range r passes the roofs before it, and their shadows grow with their
number and steeply with r: h = 1 - (1 - m) exp(-a k (r / 20 H)^4), with k the density of a lane and H the
height of the radar. a and m were measured on simulated roads, docs/counts.md.

Sources: Gelman et al., Bayesian Data Analysis, 3rd ed., sections 2.3 and 2.6; Cox, Renewal Theory, 1962,
section 3.3; the three distributions by their one recursion: Panjer, ASTIN Bulletin 12 (1981) 22-26.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from service.tracking.model import F64, I64

_SUMMED = 30.0  # mean up to which probabilities are added up one by one; above, a normal distribution does
_TAIL_STDS = 8.0  # beyond which they are not
_FLAT = 1e-6  # relative, of variance and mean: a Poisson distribution


@dataclass(frozen=True, slots=True)
class Confidence:
    """How sure an interval is, and what is known of the errors of counting."""

    level: float = 0.95
    mount_height_m: float = 6.0
    miss_share: float = 0.002  # of vehicles in plain view
    false_share: float = 0.005  # of counted ones, whatever their existence says
    hiding_m: float = 4.7  # shadow of a vehicle, at the range of 20 mounting heights
    hiding_heights: float = 20.0
    hiding_power: float = 4.0
    hiding_deviation: float = 0.5  # relative, of the share hidden
    random_headways: float = 4.0  # weight of traffic at random beside the headways seen


@dataclass(frozen=True, slots=True)
class Counted:
    """What was counted in R cells, (R,) each."""

    n: I64
    doubt: F64  # sum of 1 - p of the vehicles
    observed: F64  # share of the time in which frames came
    density_per_m: F64  # vehicles a metre of lane
    range_m: F64  # from the radar to where they crossed
    headways: I64  # that are known
    headway_spread: F64  # their sum of squared deviations, over their squared mean; 0 without any


def hidden_share(density_per_m: F64, range_m: F64, c: Confidence) -> F64:
    """Return the share of vehicles (R,) that are not counted because others hide them."""
    reach = np.maximum(range_m / (c.hiding_heights * max(c.mount_height_m, 1.0)), 0.0)
    seen = np.exp(-c.hiding_m * density_per_m * reach**c.hiding_power)
    return np.asarray(1.0 - (1.0 - c.miss_share) * seen)


def volume_bounds(counted: Counted, c: Confidence) -> tuple[I64, I64]:
    """Return the bounds (R,) of the true volume."""
    n, observed = counted.n, np.clip(counted.observed, 1e-3, 1.0)
    false = np.maximum(counted.doubt, c.false_share * n)
    density = counted.density_per_m / observed  # of vehicles there while frames came
    hidden = np.minimum(hidden_share(density, counted.range_m, c), 0.9)
    passed = (n + 0.5) / (1.0 - hidden)  # in the time observed, the hidden among them
    unseen = passed * (1.0 - observed) / observed
    index = (c.random_headways + counted.headway_spread) / (
        c.random_headways + np.maximum(counted.headways - 1, 0)
    )
    mean = passed * hidden + unseen
    variance = passed * hidden / (1.0 - hidden) + index * unseen / observed
    variance += (c.hiding_deviation * passed * hidden / observed) ** 2
    low, high = _most_likely(mean, variance, false, c.level)
    return np.maximum(n + low, 0), n + high


def _most_likely(mean: F64, variance: F64, false: F64, level: float) -> tuple[I64, I64]:
    """Return the bounds (R,) of missed - false, by the moments of the missed and of the Poisson false."""
    half = NormalDist().inv_cdf((1.0 + level) / 2) * np.sqrt(variance + false)
    low = np.floor(mean - false - half).astype(np.int64)
    high = np.ceil(mean - false + half).astype(np.int64)
    size = np.maximum(mean + _TAIL_STDS * np.sqrt(variance), false + _TAIL_STDS * np.sqrt(false))
    bucket = np.where(np.maximum(mean, false) > _SUMMED, -1, np.ceil(np.log2(size + 4.0)).astype(np.int64))
    for power in np.unique(bucket[bucket >= 0]).tolist():  # rows of about the same length together
        rows = np.flatnonzero(bucket == power)
        missed = counting_pmf(mean[rows], variance[rows], 2**power)
        found = highest_density(_difference(missed, counting_pmf(false[rows], false[rows], 2**power)), level)
        low[rows], high[rows] = found[0] - 2**power + 1, found[1] - 2**power + 1
    return low, high


def counting_pmf(mean: F64, variance: F64, size: int) -> F64:
    """Return the probabilities (R, size) of 0, 1, ...: binomial, Poisson or negative binomial.

    All obey P(k) = (a + b / k) P(k - 1) with 1 / (1 - a) = variance / mean, a + b = mean^2 / variance.
    """
    mean = np.maximum(mean, 1e-12)
    variance = np.maximum(variance, 1e-12)
    a = 1.0 - mean / variance
    a = np.where(np.abs(a) < _FLAT, 0.0, a)
    total = mean * (1.0 - a)  # a + b
    first = np.where(a == 0.0, -mean, total / np.where(a == 0.0, 1.0, a) * np.log1p(-a))
    factors = np.maximum(a[:, None] + (total - a)[:, None] / np.arange(1, size), 0.0)  # 0: a binomial's end
    pmf = np.exp(first)[:, None] * np.cumprod(np.column_stack([np.ones(len(mean)), factors]), axis=1)
    return np.asarray(pmf / pmf.sum(axis=1, keepdims=True))


def _difference(missed: F64, false: F64) -> F64:
    """Return the probabilities (R, 2 K - 1) of missed - false = 1 - K, ..., K - 1, of (R, K) each."""
    size = missed.shape[1]
    out = np.zeros((len(missed), 2 * size - 1))
    for k in range(size):
        if not false[:, k].any():
            break
        out[:, size - 1 - k : 2 * size - 1 - k] += false[:, k : k + 1] * missed
    return out


def highest_density(pmf: F64, level: float) -> tuple[I64, I64]:
    """Return first and last place (R,) of the fewest values that are as probable as the level together."""
    order = np.argsort(-pmf, axis=1, kind="stable")
    total = np.cumsum(np.take_along_axis(pmf, order, axis=1), axis=1)
    count = np.argmax(total >= min(level, 1.0 - 1e-9), axis=1)
    last = order.shape[1] - 1
    chosen = np.where(np.arange(last + 1) <= count[:, None], order, -1)
    low = np.where(chosen < 0, last, chosen).min(axis=1)
    return low.astype(np.int64), chosen.max(axis=1).astype(np.int64)
