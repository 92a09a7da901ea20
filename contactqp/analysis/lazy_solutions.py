"""Solutions in time or along a load path that cost their certificate only when they are looked at."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NoReturn, Protocol, overload

from contactqp.errors import ContactQPError
from contactqp.model.arrays import own_floating_point
from contactqp.model.solution import Solution


class Unfinished(Protocol):
    """An answer that may not have been looked at."""

    def finish(self) -> Solution:
        """Refine, expand and certify it, unless that is done."""


@dataclass(frozen=True)
class Refused:
    """An answer that was refused when it was looked at, and is refused again."""

    error: ContactQPError

    def finish(self) -> NoReturn:
        """Raise the error."""
        raise self.error


def looked_at(solutions: Sequence[Solution]) -> Sequence[Solution]:
    """Return the solutions, all of them looked at; those that are refused stay so, where they are looked at again."""
    kept: list[Unfinished | Solution] = []
    for k in range(len(solutions)):
        try:
            kept.append(solutions[k])
        except ContactQPError as error:
            kept.append(Refused(error))
    return LazySolutions(kept)


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
