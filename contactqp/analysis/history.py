"""A sequence of solutions in time or along a load path, with energies and events.

Solutions are certified at first access (`LazySolutions`). The events of a frictionless leg are found exactly: while no
contact changes its state, displacements and forces are linear in the load. If contacts have neither gap nor force, the
contact problem in rates decides which close: contacts with force stay closed, those without gap and force satisfy
E_i v <= 0, l_i' >= 0, l_i' E_i v = 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from importlib import import_module
from itertools import chain, pairwise
from pathlib import Path
from typing import Any, NoReturn, Protocol, overload

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.load_cases import ContactRow, ContactTable, contact_table
from contactqp.certificate.idle_rows import ActingRows
from contactqp.errors import ContactQPError, NoEquilibrium, NotCertified, NotConverged, Unsupported
from contactqp.linalg.condensation import Condensation, condense
from contactqp.linalg.measures import of_rows
from contactqp.linalg.refinement import OnSet, answer_on
from contactqp.model.arguments import checked
from contactqp.model.arrays import Array, Indices, Mask, Vector, own_floating_point, refuse_late
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import ReadOnly, read_only
from contactqp.model.solution import Solution
from contactqp.model.summary import Printed, history_table, wrapped
from contactqp.solving.methods import find
from contactqp.solving.solve import solve

# Events nearer than this part of a leg coincide, as doubles cannot order them.
SIMULTANEOUS = 1e-12
# Rates below this part of the largest are zero.
STEADY = 1e-12
SHARED = "follow_path(events='exact'): contacts share forces, and which of them opens is not unique; give steps instead"
JUMPS = "follow_path(events='exact'): it jumps, as the load moves a body that nothing holds; give steps instead"


@dataclass(frozen=True)
class Energies:
    """The energies of one instant [force * length].

    On a piecewise linear path (exact events), work = elastic + dissipated up to rounding; in steps the difference
    decreases with the step size.
    """

    elastic: float  # 1/2 u'Ku, with contact springs also 1/2 l_N^2 / beta + 1/2 |l_T|^2 / beta_T
    kinetic: float
    work: float  # work of the loads since the start
    dissipated: float  # by friction since the start: the sum of l_T . s, nonnegative on a load path
    impact: float = 0.0  # lost by normal forces since the start, in motions; negative if a scheme creates energy
    drift: float = 0.0  # total - total at the start - work + dissipated + impact, the energy error of the scheme

    @property
    def total(self) -> float:
        """Return the sum of elastic and kinetic energy."""
        return self.elastic + self.kinetic


@dataclass(frozen=True)
class Event:
    """A change of state of one contact."""

    kind: str  # "closed", "opened", "stick" (after slip), "slip" (after stick, or closing with slip)
    contact: int
    time: float  # pseudo-time of a load path, seconds in dynamics
    name: str = ""


class History(ReadOnly, Printed, Sequence[Solution]):
    """The solutions at `times`, including the start, and the events between them.

    With friction each solution's problem has the slip origin of its step, E_T u of the previous instant or where the
    contact closed since; with contact springs, the previous positions of their sliders.

    Parameters
    ----------
    solutions : sequence of Solution, which may expand each one, with its certificate, on first access
    times : pseudo-times of a load path, load factors, or seconds of a motion
    events, energies, notes : functions without arguments
        They return what the attributes of these names hold, on first access; energies are formed from the solutions
        by default.
    linear : bool, whether nothing changes its state between two instants
    """

    time_label = "time [legs]"  # label of `times` in tables

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
        """Return the changes of contact state, ordered by time.

        "closed" and "opened" are the beginning and end of l_N > 0, "slip" that of s = E_T u - slip_origin leaving zero,
        at a sticking or closing contact, and "stick" the end of slip.
        """
        return tuple(self._find_events())

    @cached_property
    @own_floating_point
    def notes(self) -> tuple[str, ...]:
        """Return notes on steps with friction that jump, or take one of several answers.

        Each step is followed again from event to event, in doubles unless something is found, for about a second or as
        long as the steps took. "It jumps" means that no rates continue the path at the named load (a snap), and that
        the step ends at another equilibrium; "it chooses" means that several do. Loads at which the certificate found
        several equilibria (at most eight contacts) are named too. With exact events, errors are raised instead.
        """
        return tuple(self._find_notes())

    @cached_property
    @own_floating_point
    def energies(self) -> tuple[Energies, ...]:
        """Return the energies of every instant: elastic 1/2 u'Ku, work of the loads, and dissipation by friction.

        Between exact events work = elastic + dissipated since the start. In steps, with friction at their end, work is
        at least that, so that no step or cycle of steps creates energy.

        Friction dissipates l_T . s at every contact, with s = E_T u - slip_origin the slip of a step, and with l_T at
        its end in steps, or the mean of both ends between exact events. l_T is the force of the body on the obstacle,
        along its slip, so that l_T . s is not negative. With the contact springs of a penalty method s is the slip of
        their sliders, E_T u - l_T / beta_T - slip_origin, and the springs store elastic energy too.
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

    def __getattr__(self, name: str) -> Any:
        """Raise AttributeError, with a hint if solutions have the attribute."""
        if not name.startswith("_") and (hasattr(Solution, name) or name in Solution.__dataclass_fields__):
            raise AttributeError(f"a {type(self).__name__} holds solutions; history[-1].{name} is that of the last one")
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    @property
    def displacements(self) -> Array:
        """Return the displacements (steps, n) [length]."""
        return read_only(np.array([solution.displacement for solution in self]))

    @property
    def normal_forces(self) -> Array:
        """Return the normal forces (steps, m) [force], positive in compression."""
        return read_only(np.array([solution.normal_force for solution in self]))

    @property
    def friction_forces(self) -> Array | None:
        """Return the friction forces (steps, m, d-1) [force], or None without tangential rows."""
        if any(solution.friction_force is None for solution in self):
            return None
        return read_only(np.array([solution.friction_force for solution in self]))

    def __getstate__(self) -> dict[str, Any]:
        """Finish every solution and compute events and notes, or their errors, before copying or pickling."""
        found: dict[str, Any] = dict(_solutions=finish_all(self._solutions), _find_events=_found(lambda: self.events))
        if self._find_energies is not None:
            found["_find_energies"] = _found(lambda: self.energies)
        return self.__dict__ | found | dict(_find_notes=_found(lambda: self.notes))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({len(self)} solutions, times {self.times[0]:g} to {self.times[-1]:g})"

    def plot(self, file: str | Path | None = None, **options: Any) -> Any:
        """Draw the history, into a file if one is given, and return the figure: `contactqp.draw(self, file, ...)`."""
        return import_module("contactqp.study.answer_pictures").draw(self, file, **options)

    @checked
    def table(self, time_label: str = "") -> ContactTable[ContactRow]:
        """Return time, status, normal force, friction and gap of every contact at every instant, one row each.

        `time_label` is the heading of the column of times, if the default lacks the unit: "time [ms]".
        """
        return contact_table(self, self.times.tolist(), time_label or self.time_label)

    @checked
    def write_csv(self, file: str | Path, time_label: str = "") -> None:
        """Write `table` to a file of comma-separated values; raise InvalidProblem if this fails."""
        self.table(time_label).write_csv(file)

    def summary(self) -> str:
        """Return a table of instants with their largest forces, and of events, for `print`; for one solution, its
        summary.
        """
        if type(self) is History and len(self) == 1 and not self.notes:
            return self[0].summary()
        forces, events = self.normal_forces, self.events
        table = history_table(self.times, self, forces, events, exact=self._linear, time_label=self.time_label)
        return "\n".join([table, *wrapped(*(f"note: {note}" for note in self.notes))])

    def __str__(self) -> str:
        try:
            return self.summary()
        except ContactQPError as error:  # raised by a step finished only now
            return f"{self!r}: {error}"


def contact_changes(
    states: Iterable[tuple[Mask, Mask]], times: Iterable[float], name: Callable[[int], str]
) -> Iterator[Event]:
    """Yield every change of contact state, at the first instant after it.

    Parameters
    ----------
    states : iterable of pairs of (m,) masks, which contacts push, and which of them slide, at each instant
    times : iterable of float, the time of each instant; the first one has no events
    name : function, the name of a contact by its number
    """
    instants = zip(states, times, strict=True)
    for ((pushed, slid), _), ((pushes, slides), time) in pairwise(instants):
        for i in np.flatnonzero((pushed != pushes) | (slid != slides)).tolist():
            if pushed[i] != pushes[i]:
                yield Event("closed" if pushes[i] else "opened", i, time, name(i))
            if pushes[i] and slid[i] != slides[i]:
                yield Event("slip" if slides[i] else "stick", i, time, name(i))


def _found(find: Callable[[], Iterable[Any]]) -> Callable[[], Iterable[Any]]:
    """Return a function that returns the computed result, or raises its error again."""
    try:
        return partial(tuple, find())
    except ContactQPError as error:
        return Refused(error).finish


def _static_energies(solutions: Sequence[Solution], linear: bool) -> Iterator[Energies]:
    """Return the energies of a quasi-static sequence.

    The work of the loads is the sum of (f_a + f_b)'(u_b - u_a)/2, exact if no contact changes its state in between. In
    steps with friction, whose dissipation is evaluated at their end, it is f_b'v - v'Kv/2, v = u_b - u_a: the same if
    no contact changes its state, and otherwise at least the stored and dissipated energy.
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
    """Return l_T . s with s = E_T u - slip_origin: l_T at the end of the step, or the mean of both ends on linear
    steps.

    By Coulomb's law it is not negative; negative values are rounding.
    """
    force, slip = now.friction_force, now.slip
    if force is None or slip is None or before.friction_force is None:
        return 0.0
    if linear:
        force = (force + before.friction_force) / 2
    return float(np.sum(np.maximum(np.sum(force * slip, axis=1), 0.0)))


class Unfinished(Protocol):
    """An answer that may need refinement, expansion and certification."""

    def finish(self) -> Solution:
        """Refine, expand and certify the answer, unless this was done."""


@dataclass(frozen=True)
class Refused:
    """An answer that was refused at first access."""

    error: ContactQPError

    def finish(self) -> NoReturn:
        """Raise the error of the refusal again."""
        raise self.error


def finish_all(solutions: Sequence[Solution]) -> Sequence[Solution]:
    """Return the solutions, all finished; refused ones raise their error again on access."""
    kept: list[Unfinished | Solution] = []
    for k in range(len(solutions)):
        try:
            kept.append(solutions[k])
        except ContactQPError as error:
            kept.append(Refused(error))
    return LazySolutions(kept)


class LazySolutions(Sequence[Solution]):
    """A sequence of answers, each finished once at first access; a slice is a list of finished solutions.

    Errors of `finish` are raised at first access, and again later. The solution replaces the answer, which is freed.
    """

    def __init__(self, steps: Iterable[Unfinished | Solution] = ()) -> None:
        self._steps: list[Unfinished | Solution] = list(steps)

    def append(self, step: Unfinished | Solution) -> None:
        """Add one answer at the end."""
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


@dataclass(frozen=True, eq=False)
class OnAllRows:
    """One solution of a history computed without idle rows, extended to all rows at first access."""

    rows: ActingRows
    history: History
    number: int

    def extended(self, found: Solution) -> Solution:
        """Return a solution on the acting rows as one of the whole problem."""
        whole: Solution = self.rows.at(found.problem).solution(found)
        return whole

    def finish(self) -> Solution:
        """Return the solution of the whole problem.

        Raises
        ------
        NotCertified
            As the history; `solution` is that of the whole problem.
        """
        try:
            return self.extended(self.history[self.number])
        except NotCertified as error:
            if isinstance(error.solution, Solution):
                error.solution = self.extended(error.solution)
            raise


def events_on_all_rows(rows: ActingRows, history: History) -> Iterator[Event]:
    """Yield the events of a history without idle rows, with contact numbers among all rows."""
    return (replace(event, contact=int(rows.contacts[event.contact])) for event in history.events)


@dataclass(frozen=True, eq=False)
class _State:
    """The contacts at one instant: those with force, and those with neither gap nor force."""

    fraction: float
    closed: Indices
    undecided: Indices


def events_of_leg(problem: ContactProblem, start: Vector, end: Vector, first: Solution, method: str) -> list[Event]:
    """Return every event of one leg, with times from 0 at the start of the leg to 1 at its end.

    Parameters
    ----------
    problem : a problem without friction
    start, end : (n,) arrays, the loads at both ends of the leg [force]
    first : the solution at its start
    method : the name of an exact method
    """
    if not find(method).exact:
        raise Unsupported(f"{method}: exact events (it is approximate by design); give steps instead")
    condensation = condense(problem)
    direction = problem.replace(load=end - start, gap=np.zeros(problem.contacts), tie_value=np.zeros(problem.ties))
    undecided = np.array(first.certificate.grazing, dtype=np.intp)
    carrying = np.setdiff1d(np.flatnonzero(first.normal_force > 0), undecided)
    state = _State(0.0, carrying, undecided)
    events: list[Event] = []
    felt = of_rows(problem, problem.normal, np.ones(problem.dimension))
    limit = 20 * problem.contacts + 20
    for _ in range(limit):
        refuse_late("the next event was found")
        chosen, rates = _rates(direction, condensation, state)
        events += _decided(state, chosen)
        here = answer_on(problem.replace(load=start + state.fraction * (end - start)), condensation, chosen)
        following = _next_state(state, chosen, here, rates, np.where(felt > 0, felt, 1.0))
        if following is None:
            return events
        state = following
    raise NotConverged(f"follow_path: more than {limit} changes of state in one leg")


def _decided(state: _State, chosen: Indices) -> list[Event]:
    """Return the events at a state: undecided contacts that close if they were open, or open if they had a force."""
    changed = [i for i in state.undecided if (i in state.closed) != (i in chosen)]
    return [Event("closed" if i in chosen else "opened", int(i), state.fraction) for i in changed]


def _rates(direction: ContactProblem, condensation: Condensation, state: _State) -> tuple[Indices, OnSet]:
    """Return the closed contacts just after a state, and the rates of displacement and force."""
    certain = np.setdiff1d(state.closed, state.undecided)
    trial, seen = certain, set()
    while trial.tobytes() not in seen:
        seen.add(trial.tobytes())
        if (rates := _rates_on(direction, condensation, trial)) is None:
            break
        tension, closing = _wrong_rates(state, trial, rates)
        if not tension.size and not closing.size:
            return trial, rates
        trial = np.union1d(np.setdiff1d(trial, tension), closing).astype(np.intp)
    trial = _solved(direction, certain, state.undecided)
    rates = _rates_on(direction, condensation, trial)
    if rates is not None and not any(wrong.size for wrong in _wrong_rates(state, trial, rates)):
        return trial, rates
    if rates is not None and rates.saddle.redundant:
        raise Unsupported(SHARED)
    raise NotConverged(f"follow_path: no continuation was found at {state.fraction:.6g} of the leg")


def _solved(direction: ContactProblem, certain: Indices, undecided: Indices) -> Indices:
    """Return the closed contacts of the contact problem in rates, in which the certain ones stay closed."""
    ties = sp.vstack([direction.tie, direction.normal[certain]])
    try:
        rates = solve(direction.with_contacts(undecided).replace(tie=ties, tie_value=np.zeros(ties.shape[0])))
    except NoEquilibrium:
        raise Unsupported(JUMPS) from None
    pushing = rates.normal_force > STEADY * np.max(rates.normal_force, initial=0.0)
    return np.union1d(certain, undecided[pushing]).astype(np.intp)


def _rates_on(direction: ContactProblem, condensation: Condensation, closed: Indices) -> OnSet | None:
    """Return the rates on closed contacts, None where the load drives a body that these do not hold."""
    rates = answer_on(direction, condensation, closed)
    load, inner = condensation.reduce_load(direction.load)
    carried = condensation.normal.T @ rates.doubles.normal_force + condensation.tie.T @ rates.doubles.tie_force
    return None if rates.saddle.drive(load - carried, condensation.reduced_size(direction, inner)).any() else rates


def _wrong_rates(state: _State, trial: Indices, rates: OnSet) -> tuple[Indices, Indices]:
    undecided = state.undecided
    force, closing = rates.normal_force.double(), -rates.gap.double()
    pulls = force < -STEADY * np.max(abs(force), initial=0.0)
    closes = closing > np.maximum(STEADY * np.max(abs(closing), initial=0.0), rates.rounding_of_gaps)
    inside = np.isin(undecided, trial)
    return undecided[inside & pulls[undecided]], undecided[~inside & closes[undecided]]


def _next_state(state: _State, chosen: Indices, here: OnSet, rates: OnSet, felt: Vector) -> _State | None:
    """Return the next fraction at which an open gap or a contact force reaches zero, with all these contacts, and those
    that rest on closed gaps without force, as others carry it.

    Forces times `felt`, |E_i D| (m,), and gaps over it are in sqrt(energy), so that rates of both are comparable.
    """
    count = len(here.gap)
    is_closed, undecided = (np.isin(np.arange(count), some) for some in (chosen, state.undecided))
    value = np.where(is_closed, here.normal_force.double(), here.gap.double())
    rate = np.where(is_closed, rates.normal_force.double(), rates.gap.double())
    size = abs(rate) * np.where(is_closed, felt, 1 / felt)
    falls = (~undecided | (value > 0)) & (rate < 0) & (size > STEADY * np.max(size, initial=0.0))
    ahead = np.full(count, np.inf)
    ahead[falls] = np.maximum(value[falls], 0.0) / -rate[falls]
    reach = state.fraction + np.min(ahead, initial=np.inf)
    if not reach < 1 - SIMULTANEOUS:
        return None
    resting = ~is_closed & (abs(rates.gaps) <= rates.rounding_of_gaps) & (here.gaps <= here.rounding_of_gaps)
    together = np.flatnonzero((ahead <= np.min(ahead) + SIMULTANEOUS) | resting)
    return _State(float(reach), chosen, together)
