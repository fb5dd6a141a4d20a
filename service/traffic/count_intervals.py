"""The interval in which the true volume lies: what may be false among the counted, what may be missing.

Counted are n vehicles, each real with its own probability, in the observed share of the time. The number of
false ones is Poisson with mean sum(1 - p_i); the number of missed ones, when each vehicle is counted with
probability c = observed (1 - miss), is negative binomial with n + 1/2 successes (the predictive distribution
under the Jeffreys prior of a Poisson rate). Their outer quantiles bound the volume.

Source: Gelman et al., Bayesian Data Analysis, 3rd ed., section 2.6 (Poisson counts with exposure).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import nbinom, poisson

from service.tracking.model import F64, I64


@dataclass(frozen=True, slots=True)
class Confidence:
    """How sure an interval is, and what is known of the errors of counting."""

    level: float = 0.95
    miss_share: float = 0.015  # of vehicles in view, hidden behind others: measured, docs/counts.md
    false_share: float = 0.005  # of counted ones beyond what their existence says: likewise


def volume_bounds(n: I64, doubt: F64, observed: F64, c: Confidence) -> tuple[I64, I64]:
    """Return the bounds (R,) of the true volume.

    n: counted; doubt: sum of 1 - p of the counted; observed: share of the time in which frames came.
    """
    tail = (1.0 - c.level) / 2
    false = np.maximum(doubt, c.false_share * n)
    low = n - poisson.ppf(1.0 - tail, false)
    caught = np.clip(observed * (1.0 - c.miss_share), 1e-3, 1.0)
    high = n + nbinom.ppf(1.0 - tail, n + 0.5, caught)
    return np.maximum(low, 0).astype(np.int64), np.asarray(high).astype(np.int64)
