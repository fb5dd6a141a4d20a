"""Names of association methods -> how the tracker weighs contested measurements."""

from __future__ import annotations

from service.errors import InvalidInput
from service.tracking.association import Marginals, assign_maximum, marginals
from service.tracking.model import F64

JPDA, MAXIMUM = "jpda", "maximum-probability"
METHODS = (JPDA, MAXIMUM)


def associate(method: str, log_weight: F64, log_miss: F64, *, temper: float = 1.0) -> Marginals:
    """Return the association probabilities of T tracks and M measurements; see `association.marginals`.

    "jpda" weighs every measurement by its probability over all joint hypotheses. "maximum-probability" takes
    the joint hypothesis of greatest probability, the one with the least sum of statistical distances and
    their normalisation, as the ASTEKF paper (Electronics 2024, 13, 652, section 3) associates; tempering
    does not change it.
    """
    check_method(method)
    if method == MAXIMUM:
        return assign_maximum(log_weight, log_miss)
    return marginals(log_weight, log_miss, temper=temper)


def check_method(method: str) -> None:
    """Raise InvalidInput naming the known methods when this is none of them."""
    if method not in METHODS:
        raise InvalidInput.at(
            "/boxes.association", f"no association {method!r}; known are {', '.join(METHODS)}"
        )
