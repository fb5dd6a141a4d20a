"""Names of papers -> their reproductions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from service.errors import InvalidInput
from service.evaluation.reproduce.astekf import ASTEKF
from service.evaluation.reproduce.form import Paper
from service.evaluation.reproduce.hpff import HPFF
from service.evaluation.reproduce.isrckf import ISRCKF
from service.evaluation.reproduce.mast import MAST_UKF

PAPERS: Mapping[str, Paper] = MappingProxyType(
    {paper.name: paper for paper in (ASTEKF, MAST_UKF, ISRCKF, HPFF)}
)


def find_papers(names: Sequence[str]) -> list[Paper]:
    """Return the papers of those names, in the order given, each once; none named: all.

    Raises InvalidInput naming the known ones.
    """
    for name in names:
        if name not in PAPERS:
            raise InvalidInput.at("/paper", f"no paper {name!r}; known are {', '.join(PAPERS)}")
    return [PAPERS[name] for name in dict.fromkeys(names or PAPERS)]
