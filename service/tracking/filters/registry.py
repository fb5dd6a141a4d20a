"""Names of filters -> filters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from service.errors import InvalidInput
from service.tracking.filters.base import Filter
from service.tracking.filters.cubature import isrckf, sh_ekf, srckf
from service.tracking.filters.ekf import Ekf
from service.tracking.filters.mast_ukf import mast_ukf
from service.tracking.filters.parameters import FilterParameters
from service.tracking.filters.strong_tracking import Astekf
from service.tracking.filters.strong_tracking_paper import AstekfPaper, Stekf
from service.tracking.filters.ukf import ast_ukf, st_ukf, ukf

_MAKERS: Mapping[str, Callable[[FilterParameters], Filter]] = MappingProxyType(
    {
        "astekf": lambda p: Astekf(p.astekf),
        "astekf-paper": lambda p: AstekfPaper(p.astekf_paper),
        "ekf": lambda p: Ekf(p.ekf),
        "stekf": lambda p: Stekf(p.stekf),
        "srckf": lambda p: srckf(p.srckf),
        "sh-ekf": lambda p: sh_ekf(p.sh_ekf),
        "isrckf": lambda p: isrckf(p.isrckf),
        "ukf": lambda p: ukf(p.ukf),
        "st-ukf": lambda p: st_ukf(p.st_ukf),
        "ast-ukf": lambda p: ast_ukf(p.ast_ukf),
        "mast-ukf": lambda p: mast_ukf(p.mast_ukf),
    }
)


def filter_names() -> tuple[str, ...]:
    """Return the names of all filters, sorted."""
    return tuple(sorted(_MAKERS))


def make_filter(name: str, parameters: FilterParameters | None = None) -> Filter:
    """Return the filter of that name with its part of the parameters (None: defaults).

    Raises InvalidInput naming the known filters when there is none.
    """
    maker = _MAKERS.get(name)
    if maker is None:
        raise InvalidInput.at("/filter", f"no filter {name!r}; known are {', '.join(filter_names())}")
    return maker(parameters or FilterParameters())
