"""Compile the tracker's kernels before they are needed, and say so: the first time takes a while."""

from __future__ import annotations

from service import warmup


def warm_up() -> None:
    """Load the kernels of the cache, or compile them into it."""
    warmup.main()
