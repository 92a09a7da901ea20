"""A sequence of solutions in time or along a load path, with its energies and its events."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import chain, pairwise
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from contactqp.analysis.lazy_solutions import Refused, looked_at
from contactqp.errors import ContactQPError
from contactqp.model.arrays import Vector, own_floating_point
from contactqp.model.problem_data import ReadOnly, read_only
from contactqp.model.solution import Solution


@dataclass(frozen=True)
class Energies:
    """Of one instant, in force times length.

    On a path between whose instants all is linear (exact events), work = elastic + dissipated to rounding; in steps the
    difference shrinks with the steps.
    """

    elastic: float  # 1/2 u'Ku, with contact springs also 1/2 l_N^2 / beta + 1/2 |l_T|^2 / beta_T
    kinetic: float
    work: float  # of the loads since the start
    dissipated: float  # by friction since the start: the sum of l_T . s, never negative on a load path
    impact: float = 0.0  # taken by normal forces since the start, in motions; negative where a scheme creates energy
    drift: float = 0.0  # total - total at the start - work + dissipated + impact: what the scheme makes of energy

    @property
    def total(self) -> float:
        """Elastic and kinetic energy."""
        return self.elastic + self.kinetic


@dataclass(frozen=True)
class Event:
    """One contact changes its state."""

    kind: str  # "closed", "opened", "stick" (a contact that slipped), "slip" (one that stuck, or that closes slipping)
    contact: int
    time: float  # pseudo-time of a load path, seconds in dynamics
    name: str = ""


class History(ReadOnly, Sequence[Solution]):
    """The solutions at `times`, the start included, and what happened between them.

    Solutions may be a sequence that expands each one, with its certificate, when it is looked at. With friction each
    solution's problem has the slip origin of its step, E_T u of the instant before or where the contact closed since;
    with contact springs, where their sliders were then.
    `linear` says that nothing changes its state between two instants.
    """

    def __init__(
        self,
        solutions: Sequence[Solution],
        times: Sequence[float],
        events: Callable[[], Iterable[Event]] = tuple,
        linear: bool = False,
        energies: Callable[[], Iterable[Energies]] | None = None,
        notes: Callable[[], Iterable[str]] = tuple,
    ) -> None:
        self._solutions, self._linear = solutions, linear
        self.times: Vector = read_only(np.array(times, dtype=float))
        self._find_events, self._find_energies, self._find_notes = events, energies, notes

    @cached_property
    @own_floating_point
    def events(self) -> tuple[Event, ...]:
        """The changes of contact state, in the order of their times.

        "closed" and "opened" say that l_N > 0 begins and ends; "slip" that s = E_T u - slip_origin leaves zero, at a
        contact that stuck or that closes; "stick" that a contact that slipped does so no more.
        """
        return tuple(self._find_events())

    @cached_property
    @own_floating_point
    def notes(self) -> tuple[str, ...]:
        """With friction in steps: where a step has jumped, and where it has taken one of several answers.

        Each step is followed again from event to event from the state at its start, which costs what exact events
        cost. "It jumps" says that no rates continue the path at the load that is named, a snap: the step ends at an
        equilibrium beyond it. "It chooses" says that several do. Loads at which the certificate found several
        equilibria (at most eight contacts) are named too. Exact events raise at such loads instead.
        """
        return tuple(self._find_notes())

    @cached_property
    @own_floating_point
    def energies(self) -> tuple[Energies, ...]:
        """Of every instant: elastic 1/2 u'Ku, the work of the loads, and what friction has dissipated.

        Between exact events work = elastic + dissipated since the start. In steps, of which the friction at the end
        counts, work is at least that: no step and no cycle of steps creates energy.

        Friction does l_T . s at every contact, s = E_T u - slip_origin the slip of a step: with l_T at its end in
        steps, with the mean of both ends between exact events. l_T is what the body does to the obstacle, along its
        own slip, and l_T . s is never negative. With the contact springs of a penalty method s is the slip of their
        sliders, E_T u - l_T / beta_T - slip_origin, and the springs store elastic energy too.
        """
        if self._find_energies is not None:
            return tuple(self._find_energies())
        return tuple(_static_energies(self._solutions, self._linear))

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
        return read_only(np.array([solution.displacement for solution in self]))

    @property
    def normal_forces(self) -> NDArray[np.float64]:
        """(steps, m) [force], positive in compression."""
        return read_only(np.array([solution.normal_force for solution in self]))

    @property
    def friction_forces(self) -> NDArray[np.float64] | None:
        """(steps, m, d-1) [force], or None without tangential rows."""
        if any(solution.friction_force is None for solution in self):
            return None
        return read_only(np.array([solution.friction_force for solution in self]))

    def __getstate__(self) -> dict[str, Any]:
        """What is copied or pickled: every solution looked at, events and notes found, or why they are not."""
        found: dict[str, Any] = dict(_solutions=looked_at(self._solutions), _find_events=_found(lambda: self.events))
        if self._find_energies is not None:
            found["_find_energies"] = _found(lambda: self.energies)
        return self.__dict__ | found | dict(_find_notes=_found(lambda: self.notes))

    def __repr__(self) -> str:
        return f"History({len(self)} solutions, times {self.times[0]:g} to {self.times[-1]:g})"


def _found(find: Callable[[], Iterable[Any]]) -> Callable[[], Iterable[Any]]:
    """Return what finds it again without looking: it itself, or the error that looking ended in."""
    try:
        return partial(tuple, find())
    except ContactQPError as error:
        return Refused(error).finish


def _static_energies(solutions: Sequence[Solution], linear: bool) -> Iterator[Energies]:
    """Energies of a quasi-static sequence.

    The work of the loads is the sum of (f_a + f_b)'(u_b - u_a)/2, exact where nothing changes its state in between. In
    steps with friction, whose dissipation is taken at their end, it is f_b'v - v'Kv/2, v = u_b - u_a: the same where
    nothing changes its state, and elsewhere never less than what is stored and dissipated.
    """
    work = dissipated = 0.0
    for before, now in pairwise(chain(solutions[:1], solutions)):
        v, K = now.displacement - before.displacement, now.problem.stiffness
        if now.friction_force is None or linear:
            work += float((before.problem.load + now.problem.load) @ v) / 2
        else:
            work += float(now.problem.load @ v - v @ (K @ v) / 2)
        if before is not now:
            dissipated += _friction_work(before, now, linear)
        elastic = float(now.displacement @ (now.problem.stiffness @ now.displacement)) / 2
        yield Energies(elastic, kinetic=0.0, work=work, dissipated=dissipated)


def _friction_work(before: Solution, now: Solution, linear: bool) -> float:
    """l_T . s, s = E_T u - slip_origin: l_T at the end of the step, or the mean of both ends where all is linear.

    Coulomb's law, which the certificate holds, leaves no contact less than zero; what is less is rounding.
    """
    force, slip = now.friction_force, now.slip
    if force is None or slip is None or before.friction_force is None:
        return 0.0
    if linear:
        force = (force + before.friction_force) / 2
    return float(np.sum(np.maximum(np.sum(force * slip, axis=1), 0.0)))
