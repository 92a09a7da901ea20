"""Solutions in time or along a load path that cost their certificate only when they are looked at."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol, overload

from contactqp.floating_point import own_floating_point
from contactqp.solution import Solution


class Unfinished(Protocol):
    """An answer that may not have been looked at."""

    def finish(self) -> Solution:
        """Refine, expand and certify it, unless that is done."""


class LazySolutions(Sequence[Solution]):
    """Answers in order, each finished when it is first looked at, and once; a slice is a list, all of it finished.

    What `finish` raises is raised where the solution is looked at, and again the next time. A finished answer is let go
    of: the solution takes its place.
    """

    def __init__(self, steps: Iterable[Unfinished | Solution] = ()) -> None:
        self._steps: list[Unfinished | Solution] = list(steps)

    def append(self, step: Unfinished | Solution) -> None:
        """One more at the end."""
        self._steps.append(step)

    def __len__(self) -> int:
        return len(self._steps)

    @overload
    def __getitem__(self, index: int) -> Solution: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[Solution]: ...

    @own_floating_point
    def __getitem__(self, index: int | slice) -> Solution | Sequence[Solution]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        step = self._steps[index]
        solution = step if isinstance(step, Solution) else step.finish()
        self._steps[index] = solution
        return solution
