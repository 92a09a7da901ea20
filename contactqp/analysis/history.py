"""Histories: solutions along a load path or in time, certified when looked at, with their energies and events."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import chain, combinations, pairwise
from typing import Any, NoReturn, Protocol, overload

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import ContactQPError, NotConverged, Unsupported
from contactqp.linalg.condensation import Condensation, condense
from contactqp.linalg.refinement import OnSet, answer_on
from contactqp.model.arrays import Indices, Vector, own_floating_point
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import ReadOnly, read_only
from contactqp.model.solution import Solution
from contactqp.solving.methods import find

# Solutions in time or along a load path that cost their certificate only when they are looked at.


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


@dataclass(frozen=True)
class Energies:
    """The energies of one instant [force * length].

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
        """The energies of every instant: elastic 1/2 u'Ku, the work of the loads, and what friction has dissipated.

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


# Changes of contact state along one leg of a load path, found exactly.
#
# While no contact changes its state, displacements and forces are linear in the load. At a load where contacts have
# neither gap nor force, which of them close follows from the contact problem in rates: contacts that carry force stay
# closed, those without gap and force satisfy E_i v <= 0, l_i' >= 0, l_i' E_i v = 0.

# Two events nearer than this part of a leg are one: doubles cannot order them.
SIMULTANEOUS = 1e-12
# Rates below this part of the largest are zero.
STEADY = 1e-12
# Subsets of simultaneous contacts that are tried one by one when the quick search does not settle.
TRIED_ONE_BY_ONE = 12


@dataclass(frozen=True, eq=False)
class _State:
    """One instant: contacts that carry force, contacts with neither gap nor force."""

    fraction: float
    closed: Indices
    undecided: Indices


def events_of_leg(problem: ContactProblem, start: Vector, end: Vector, first: Solution, method: str) -> list[Event]:
    """Every event of one leg, its time counted from 0 at the start of the leg to 1 at its end."""
    if not find(method).exact:
        raise Unsupported(f"{method}: exact events (it is approximate by design); give steps instead")
    way = condense(problem)
    direction = problem.replace(load=end - start, gap=np.zeros(problem.contacts), tie_value=np.zeros(problem.ties))
    undecided = np.array(first.certificate.grazing, dtype=np.intp)
    carrying = np.setdiff1d(np.flatnonzero(first.normal_force > 0), undecided)
    state = _State(0.0, carrying, undecided)
    events: list[Event] = []
    limit = 20 * problem.contacts + 20
    for _ in range(limit):
        chosen, rates = _rates(direction, way, state)
        events += _decided(state, chosen)
        here = answer_on(problem.replace(load=start + state.fraction * (end - start)), way, chosen)
        following = _next_state(state, chosen, here, rates)
        if following is None:
            return events
        state = following
    raise NotConverged(f"follow_path: more than {limit} changes of state in one leg")


def _decided(state: _State, chosen: Indices) -> list[Event]:
    """The events at a state: undecided contacts that were open close, those that carried force open."""
    events = []
    for i in state.undecided:
        was_closed, is_closed = i in state.closed, i in chosen
        if was_closed != is_closed:
            events.append(Event("closed" if is_closed else "opened", int(i), state.fraction))
    return events


def _rates(direction: ContactProblem, way: Condensation, state: _State) -> tuple[Indices, OnSet]:
    """The closed contacts just after a state, and the rates of displacement and force."""
    certain = np.setdiff1d(state.closed, state.undecided)
    trial, seen = certain, set()
    while trial.tobytes() not in seen:
        seen.add(trial.tobytes())
        rates = _rates_on(direction, way, trial)
        tension, closing = _wrong_rates(state, trial, rates)
        if not tension.size and not closing.size:
            return trial, rates
        trial = np.union1d(np.setdiff1d(trial, tension), closing).astype(np.intp)
    for subset in _subsets(state.undecided):
        trial = np.union1d(certain, np.array(subset, dtype=np.intp)).astype(np.intp)
        rates = _rates_on(direction, way, trial)
        if not any(wrong.size for wrong in _wrong_rates(state, trial, rates)):
            return trial, rates
    raise NotConverged(f"follow_path: no continuation was found at {state.fraction:.6g} of the leg")


def _subsets(contacts: Indices) -> chain[tuple[int, ...]]:
    few = contacts[:TRIED_ONE_BY_ONE]
    return chain.from_iterable(combinations(few, size) for size in range(len(few) + 1))


def _rates_on(direction: ContactProblem, way: Condensation, closed: Indices) -> OnSet:
    rates = answer_on(direction, way, closed)
    load, inner = way.reduce_load(direction.load)
    if np.any(rates.saddle.drive(load, way.reduced_size(direction, inner))):
        raise Unsupported(
            "follow_path(events='exact'): the motion jumps where the load sets a loose body going; give steps instead"
        )
    return rates


def _wrong_rates(state: _State, trial: Indices, rates: OnSet) -> tuple[Indices, Indices]:
    undecided = state.undecided
    force, closing = rates.normal_force.double(), -rates.gap.double()
    pulls = force < -STEADY * np.max(abs(force), initial=0.0)
    closes = closing > STEADY * np.max(abs(closing), initial=0.0)
    inside = np.isin(undecided, trial)
    return undecided[inside & pulls[undecided]], undecided[~inside & closes[undecided]]


def _next_state(state: _State, chosen: Indices, here: OnSet, rates: OnSet) -> _State | None:
    """The next fraction at which an open gap or a contact force reaches zero, and all contacts that do so there."""
    count = len(here.gap)
    is_closed = np.isin(np.arange(count), chosen)
    value = np.where(is_closed, here.normal_force.double(), here.gap.double())
    rate = np.where(is_closed, rates.normal_force.double(), rates.gap.double())
    settled = ~np.isin(np.arange(count), state.undecided) | (value > 0)
    falls = settled & (rate < -STEADY * np.max(abs(rate), initial=0.0))
    ahead = np.full(count, np.inf)
    ahead[falls] = np.maximum(value[falls], 0.0) / -rate[falls]
    reach = state.fraction + np.min(ahead, initial=np.inf)
    if not reach < 1 - SIMULTANEOUS:
        return None
    together = np.flatnonzero(ahead <= np.min(ahead) + SIMULTANEOUS)
    return _State(float(reach), chosen, together)
