"""Have the tracker's kernels ready before the service is: a line from the cache, more while they compile."""

from __future__ import annotations

from service import warmup
from service.cli.edge import say

SLOW_S = 1.0  # loading from the cache takes a tenth of it


def warm_up() -> None:
    """Load the kernels of the cache, or compile them into it."""
    say("Preparing the tracker (the first time its kernels are compiled, which takes about a minute)")

    def tell(name: str, seconds: float) -> None:
        if seconds > SLOW_S:
            say(f"  {name}: {seconds:.1f} s")

    warmup.warm_up(tell)
