"""The interval in which the true volume lies: what may be false among the counted, what may be missing.

Counted are n vehicles, each real with its own probability, in the observed share of the time. The number of
false ones is Poisson with mean sum(1 - p_i). Each vehicle is counted with probability c = observed (1 - h), h
the share of vehicles that others hide; the number of missed ones is then negative binomial with n + 1/2
successes (the predictive distribution under the Jeffreys prior of a Poisson rate), widened because h itself
is known to half of its value only. Their outer quantiles bound the volume.

Who is hidden: the ray to a vehicle at range r passes the roofs before it, and their shadows grow with their
number and steeply with r: h = 1 - (1 - m) exp(-a k (r / 20 H)^4), with k the density of a lane and H the
height of the radar. a = 8 m was measured on simulated roads, docs/counts.md.

Source: Gelman et al., Bayesian Data Analysis, 3rd ed., section 2.6 (Poisson counts with exposure).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from service.tracking.model import F64, I64

_SUMMED = 30.0  # mean up to which probabilities are added up one by one: most minutes, and ten times as fast


@dataclass(frozen=True, slots=True)
class Confidence:
    """How sure an interval is, and what is known of the errors of counting."""

    level: float = 0.95
    mount_height_m: float = 6.0
    miss_share: float = 0.005  # of vehicles in plain view
    false_share: float = 0.005  # of counted ones, beyond what their existence says
    hiding_m: float = 8.0  # shadow of a vehicle, at the range of 20 mounting heights
    hiding_heights: float = 20.0
    hiding_power: float = 4.0
    hiding_deviation: float = 0.5  # relative, of the share hidden


@dataclass(frozen=True, slots=True)
class Counted:
    """What was counted in R cells, (R,) each."""

    n: I64
    doubt: F64  # sum of 1 - p of the vehicles
    observed: F64  # share of the time in which frames came
    density_per_m: F64  # vehicles a metre of lane
    range_m: F64  # from the radar to where they crossed


def hidden_share(density_per_m: F64, range_m: F64, c: Confidence) -> F64:
    """Return the share of vehicles (R,) that are not counted because others hide them."""
    reach = np.maximum(range_m / (c.hiding_heights * max(c.mount_height_m, 1.0)), 0.0)
    seen = np.exp(-c.hiding_m * density_per_m * reach**c.hiding_power)
    return np.asarray(1.0 - (1.0 - c.miss_share) * seen)


def volume_bounds(counted: Counted, c: Confidence) -> tuple[I64, I64]:
    """Return the bounds (R,) of the true volume."""
    tail, n = (1.0 - c.level) / 2, counted.n
    low = n - poisson_quantile(1.0 - tail, np.maximum(counted.doubt, c.false_share * n))
    hidden = np.minimum(hidden_share(counted.density_per_m, counted.range_m, c), 0.9)
    caught = np.clip(counted.observed * (1.0 - hidden), 1e-3, 1.0)
    mean = (n + 0.5) * (1.0 - caught) / caught
    deviation = c.hiding_deviation * (n + 0.5) * hidden / (1.0 - hidden)
    variance = np.maximum(mean / caught + deviation**2, mean * (1 + 1e-6))
    high = n + nbinom_quantile(1.0 - tail, mean**2 / (variance - mean), mean / variance)
    return np.maximum(low, 0).astype(np.int64), np.asarray(high).astype(np.int64)


def poisson_quantile(share: float, mean: F64) -> I64:
    """Return for each mean (R,) the smallest k with P(X <= k) >= share."""
    many = np.flatnonzero(mean > _SUMMED)
    few = np.where(mean > _SUMMED, 0.0, mean)
    out = _summed(share, np.exp(-few), lambda k, rows: few[rows] / (k + 1))
    if len(many):
        from scipy.stats import poisson  # noqa: PLC0415 - half a second of import, for who asks for long intervals

        out[many] = poisson.ppf(share, mean[many])
    return out


def nbinom_quantile(share: float, successes: F64, p: F64) -> I64:
    """Return the smallest k failures, P(X <= k) >= share, before so many `successes` (R,) of chance `p`."""
    large = successes * (1.0 - p) / p > _SUMMED
    many, miss = np.flatnonzero(large), np.where(large, 0.0, 1.0 - p)
    first = np.exp(successes * np.log1p(-miss))
    out = _summed(share, first, lambda k, rows: (successes[rows] + k) / (k + 1) * miss[rows])
    if len(many):
        from scipy.stats import nbinom  # noqa: PLC0415

        out[many] = nbinom.ppf(share, successes[many], p[many])
    return out


def _summed(share: float, first: F64, growth: Callable[[int, I64], F64]) -> I64:
    """Add P(X = k) up from k = 0 until the share is reached in every row; P(X = k + 1) = growth P(X = k)."""
    out = np.zeros(len(first), np.int64)
    rows, mass, total, k = np.arange(len(first)), first, first, 0
    while True:
        left = total < share
        rows, mass, total = rows[left], mass[left], total[left]
        if not len(rows):
            return out
        mass = mass * growth(k, rows)
        total, k = total + mass, k + 1
        out[rows] = k
