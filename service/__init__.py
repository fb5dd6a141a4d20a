"""Turn frames of radar detections into vehicle tracks, lanes and traffic counts."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from service.kernel_cache import prepare

if TYPE_CHECKING:
    from service.pipeline.offline import track

__version__ = "0.1.0"
__all__ = ["__version__", "track"]

prepare(os.environ)


def __getattr__(name: str) -> object:
    """Import `track` on first use, so that `wayside --version` does not wait for the numerical libraries."""
    if name == "track":
        from service.pipeline.offline import track  # noqa: PLC0415 - see the docstring

        return track
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
