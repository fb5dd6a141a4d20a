"""Do a slow computation in steps: a generator yields how much work each step was, and returns the answer.

What is done at once and what is spread over frames is then one code, and gives one answer.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, field
from typing import Generic, TypeVar

T = TypeVar("T")
Steps = Generator[int, None, T]  # yields work in pairs of a point and a piece of a curve, or as long as such
CALL_WORK = 40_000  # to compare two lanes, a tenth of a millisecond in calls


def at_once(steps: Steps[T]) -> T:
    """Return the answer of all steps."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            answer: T = end.value
            return answer


@dataclass(slots=True)
class Progress(Generic[T]):
    """A computation that is under way."""

    steps: Steps[T]
    work: int = 0  # done up to now
    ended: list[T] = field(default_factory=list)  # its answer, once it is known

    def go_on(self, work: int) -> None:
        """Take steps until so much work is done in all, or nothing is left."""
        while self.work < work and not self.ended:
            try:
                self.work += next(self.steps)
            except StopIteration as end:
                self.ended.append(end.value)

    def answer(self) -> T:
        """Take the steps that are left, and return the answer."""
        if not self.ended:
            self.ended.append(at_once(self.steps))
        return self.ended[0]
