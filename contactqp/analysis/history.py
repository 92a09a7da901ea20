"""A sequence of solutions in time or along a load path, with its energies and its events."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, pairwise
from typing import overload

import numpy as np
from numpy.typing import NDArray

from contactqp.problem import Vector
from contactqp.solution import Solution


@dataclass(frozen=True)
class Energies:
    """Of one instant, in force times length."""

    elastic: float  # 1/2 u'Ku
    kinetic: float
    work: float  # of the loads since the start
    dissipated: float

    @property
    def total(self) -> float:
        """Elastic and kinetic energy."""
        return self.elastic + self.kinetic


@dataclass(frozen=True)
class Event:
    """One contact changes its state."""

    kind: str  # "closed", "opened", "stick", "slip"
    contact: int
    time: float  # pseudo-time of a load path, seconds in dynamics
    name: str = ""


class History(Sequence[Solution]):
    """The solutions at `times`, the start included, and what happened between them.

    Solutions may be a sequence that expands each one, with its certificate, when it is looked at.
    """

    def __init__(
        self, solutions: Sequence[Solution], times: Sequence[float], events: Callable[[], Iterable[Event]] = tuple
    ) -> None:
        self._solutions = solutions
        self.times: Vector = np.asarray(times, dtype=float)
        self._find_events = events

    @cached_property
    def events(self) -> tuple[Event, ...]:
        """The changes of contact state, in the order of their times."""
        return tuple(self._find_events())

    @cached_property
    def energies(self) -> tuple[Energies, ...]:
        """Of every instant."""
        return tuple(_static_energies(self._solutions))

    def __len__(self) -> int:
        return len(self._solutions)

    def __iter__(self) -> Iterator[Solution]:
        return iter(self._solutions)

    @overload
    def __getitem__(self, index: int) -> Solution: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[Solution]: ...

    def __getitem__(self, index: int | slice) -> Solution | Sequence[Solution]:
        return self._solutions[index]

    @property
    def displacements(self) -> NDArray[np.float64]:
        """(steps, n) [length]."""
        return np.array([solution.displacement for solution in self])

    @property
    def normal_forces(self) -> NDArray[np.float64]:
        """(steps, m) [force], positive in compression."""
        return np.array([solution.normal_force for solution in self])

    @property
    def friction_forces(self) -> NDArray[np.float64] | None:
        """(steps, m, d-1) [force], or None without tangential rows."""
        if any(solution.friction_force is None for solution in self):
            return None
        return np.array([solution.friction_force for solution in self])

    def __repr__(self) -> str:
        return f"History({len(self)} solutions, times {self.times[0]:g} to {self.times[-1]:g})"


def _static_energies(solutions: Sequence[Solution]) -> Iterator[Energies]:
    """Energies of a quasi-static, frictionless sequence.

    The work of the loads is the sum of (f_a + f_b)'(u_b - u_a)/2, exact where nothing changes its state in between.
    """
    work = 0.0
    for before, now in pairwise(chain(solutions[:1], solutions)):
        work += float((before.problem.load + now.problem.load) @ (now.displacement - before.displacement)) / 2
        elastic = float(now.displacement @ (now.problem.stiffness @ now.displacement)) / 2
        yield Energies(elastic, kinetic=0.0, work=work, dissipated=0.0)
