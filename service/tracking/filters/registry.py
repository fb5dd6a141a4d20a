"""Names of filters -> filters: the built-in ones, and those of installed packages.

A package adds one by an entry point of the group `wayside.filters`: its name is the filter's, its object
takes `FilterParameters` and returns a `base.Filter` of that name. Installed packages are part of the program,
as imports are: what is there is found once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType

from service.errors import InvalidInput
from service.tracking.filters.base import Filter
from service.tracking.filters.cubature import isrckf, sh_ekf, srckf
from service.tracking.filters.ekf import Ekf
from service.tracking.filters.imm import imm
from service.tracking.filters.mast_ukf import mast_ukf
from service.tracking.filters.parameters import FilterParameters
from service.tracking.filters.strong_tracking import Astekf
from service.tracking.filters.strong_tracking_paper import AstekfPaper, Stekf
from service.tracking.filters.ukf import ast_ukf, st_ukf, ukf

GROUP = "wayside.filters"
Maker = Callable[[FilterParameters], Filter]

_BUILT_IN: Mapping[str, Maker] = MappingProxyType(
    {
        "ast-ukf": lambda p: ast_ukf(p.ast_ukf),
        "astekf": lambda p: Astekf(p.astekf),
        "astekf-paper": lambda p: AstekfPaper(p.astekf_paper),
        "ekf": lambda p: Ekf(p.ekf),
        "imm": lambda p: imm(p.imm),
        "isrckf": lambda p: isrckf(p.isrckf),
        "mast-ukf": lambda p: mast_ukf(p.mast_ukf),
        "sh-ekf": lambda p: sh_ekf(p.sh_ekf),
        "srckf": lambda p: srckf(p.srckf),
        "st-ukf": lambda p: st_ukf(p.st_ukf),
        "stekf": lambda p: Stekf(p.stekf),
        "ukf": lambda p: ukf(p.ukf),
    }
)


def filter_names() -> tuple[str, ...]:
    """Return the names of all filters, sorted."""
    return tuple(sorted({*_BUILT_IN, *_offered()}))


def make_filter(name: str, parameters: FilterParameters | None = None) -> Filter:
    """Return the filter of that name with its part of the parameters (None: defaults).

    Raises InvalidInput naming the known filters when there is none, and naming the package when its filter
    cannot be used.
    """
    maker = _BUILT_IN.get(name) or _installed(name)
    if maker is None:
        raise InvalidInput.at("/filter", f"no filter {name!r}; known are {', '.join(filter_names())}")
    return maker(parameters or FilterParameters())


@cache
def _offered() -> Mapping[str, EntryPoint]:
    """Return the entry points of installed packages; raises InvalidInput for a name that is taken."""
    offered: dict[str, EntryPoint] = {}
    for point in entry_points(group=GROUP):
        if point.name in _BUILT_IN or point.name in offered:
            raise InvalidInput.at("/filter", f"{point.value} offers {point.name!r}, a name that is taken")
        offered[point.name] = point
    return MappingProxyType(offered)


@cache
def _installed(name: str) -> Maker | None:
    """Return what makes the filter of that name in an installed package, tried once."""
    point = _offered().get(name)
    if point is None:
        return None
    try:
        maker: Maker = point.load()
        made = maker(FilterParameters())
        answers = made.name
        complete = all(callable(getattr(made, part)) for part in ("start", "predict", "expected", "update"))
    except (ImportError, AttributeError, TypeError) as error:
        raise InvalidInput.at("/filter", f"{point.value} gives no filter {name!r}: {error}") from error
    if answers != name or not complete:
        raise InvalidInput.at("/filter", f"{point.value} gives a filter {answers!r}, want {name!r}")
    return maker
