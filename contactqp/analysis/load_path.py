"""Follow load paths: one ContactProblem after another, all with one factorisation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from contactqp.analysis.friction_path import follow_on_springs, follow_with_friction
from contactqp.analysis.history import (
    Event,
    History,
    LazySolutions,
    OnAllRows,
    contact_changes,
    events_of_leg,
    events_on_all_rows,
)
from contactqp.certificate.idle_rows import ActingRows, acting_rows
from contactqp.certificate.number_range import refuse_far_from_one
from contactqp.errors import ContactQPError, InvalidProblem, NoEquilibrium, Unsupported, shown
from contactqp.linalg.condensation import condense
from contactqp.linalg.iteration import contacts_are_many, iterated
from contactqp.model.arguments import checked
from contactqp.model.arrays import Vector, one_blas_thread, own_floating_point, refuse_late
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import is_whole
from contactqp.model.solution import Candidate, Solution
from contactqp.solving.methods import find, registered_name, within_time_of
from contactqp.solving.solve import begin, solve

DEFAULT_STEPS = 100


@checked
@own_floating_point
def follow_path(
    problem: ContactProblem,
    loads: Sequence[ArrayLike],
    steps: int | None = None,
    events: str | None = None,
    method: str = "active-set",
    **options: Any,
) -> History:
    """Follow a piecewise-linear load path from rest.

    The load goes from zero to `loads[0]` while the pseudo-time t goes from 0 to 1, on to `loads[1]` until t = 2, and
    so on; `problem.load` is not used.

    With Coulomb friction the path has a history. The slip of step k + 1 is

        s = E_T u - o,   o = E_T u of step k;   o = E_T u where the gap g - E_N u vanishes, for a contact that closes,

    at the fraction of the step at which it closes, so that sticking positions do not depend on the steps. The problem
    of every solution has o as its `slip_origin`, and `Solution.slip` is s. A contact that opens loses its anchor; one
    that is closed at the start (gap 0) is anchored at `problem.slip_origin`.

    Parameters
    ----------
    problem : ContactProblem
        Stiffness, contacts, friction and ties; ties keep their values throughout.
    loads : sequence of (n,) arrays [force]
        The corners of the path.
    steps : int, optional
        The number of equal steps in a leg, 100 by default; with ``events="exact"`` the default is to stop at events and
        corners only.
    events : None or "exact"
        None reports a change of state at the first step that shows it. "exact" finds its time exactly: between
        changes the displacement is linear in the load. With friction in the plane a contact closes or opens where its
        gap or its force vanishes, and slips where |l_T| = mu l_N; whether it slips on, and what follows where several
        change at once or the load turns, is Coulomb's law in rates (`contactqp.analysis.friction_events`).
    method, **options
        As in `solve`; `time_limit` [s] is that of the whole path.
        With friction the steps in the plane are taken by Newton's method on the combination of open, stick and slip
        (`contactqp.solving.friction.newton`) unless `algorithm` names another; `method` is the convex
        method of the fixed point that it falls back to. A textbook method with systems of stick and slip takes the
        steps itself. With the penalty and perturbed Lagrangian methods the path is that of bodies on contact springs,
        in steps or from event to event: the sliders behind the springs slip, a slip origin is where they were, elastic
        energy is stored in bodies and springs, and the certificate of each solution says how far it is from rigid
        contact. Without friction these methods take steps only.

    Returns
    -------
    History
        The start and every step (``steps=40`` gives 41 solutions on one leg), and every event; a contact that closes
        and slips at once has two. Where the problem is condensed onto all contacts, a step is solved for the contact
        unknowns alone; it is polished, expanded and certified on first access, which may raise NotCertified. With very
        many contacts, with bodies that are not factorised, and with friction in two tangential directions, every step
        is solved and certified at once.

    Raises
    ------
    Unsupported
        Exact events are asked for with an approximate method without friction, where the motion jumps, or with friction
        and two tangents per contact; or `solve` does not support this friction.
    NoEquilibrium
        There is no equilibrium at some load or, with friction and exact events, no rates continue the path (the body
        snaps); the message has the pseudo-time and the contacts. Steps may find a state beyond the snap, with a note in
        `History.notes`.
    SeveralEquilibria
        With friction above a critical coefficient and exact events, several rates continue the path. This is detected
        for at most 256 combinations of undecided contacts; otherwise one is followed. Steps follow one, with a note in
        `History.notes`.
    NotConverged, NotCertified
        Raised by `solve` at an instant of the path; `history` holds the instants before it.

    Examples
    --------
    >>> wall = ContactProblem(stiffness=[[157500.0]], load=[0.0], normal=[[1.0]], gap=[1e-3])
    >>> follow_path(wall, loads=[[300.0]], events="exact").events
    (Event(kind='closed', contact=0, time=0.525, name='contact 0'),)

    A slider on a spring, pressed by 1 N and then pulled: it slips when the spring's end pulls with 0.3 N.

    >>> slider = ContactProblem([[2.0, 0.0], [0.0, 0.0]], [0.0, 0.0], [[0.0, -1.0]], [0.0], [[1.0, 0.0]], friction=0.3)
    >>> history = follow_path(slider, loads=[[0.0, -1.0], [1.0, -1.0]], events="exact")
    >>> [(event.kind, event.time) for event in history.events], round(history.energies[-1].dissipated, 12)
    ([('closed', 0.0), ('slip', 1.3)], 0.105)
    """
    method, corners = registered_name(method), _corners(problem, loads)
    if events not in (None, "exact"):
        raise InvalidProblem(f"events: expected None or 'exact', got {shown(events)}")
    count = steps if steps is not None else (DEFAULT_STEPS if events is None else 1)
    if not is_whole(count) or count < 1:
        raise InvalidProblem(f"steps: expected a positive integer, got {shown(count)}")
    refuse_far_from_one("follow_path", problem)
    if (rows := acting_rows(problem)) is not None:
        rows.refuse_conflict()
        try:
            return _of_all_rows(rows, follow_path(rows.problem, loads, steps, events, method, **options))
        except ContactQPError as error:
            if isinstance(error.history, History):
                error.history = _of_all_rows(rows, error.history)
            raise
    if events and iterated(problem):
        raise Unsupported("follow_path: exact events of a body that is not factorised; take steps")
    with problem._lock, one_blas_thread(problem), within_time_of(options):
        if problem.frictional:
            chosen = find(method)
            if chosen.springs is not None:
                return follow_on_springs(problem, corners, int(count), events == "exact", chosen, options)
            return follow_with_friction(problem, corners, int(count), events == "exact", method, options)
        return _follow_steps(_Steps(problem, method, options), problem, corners, int(count), events == "exact", method)


def _follow_steps(
    solutions: _Steps, problem: ContactProblem, corners: Sequence[Vector], count: int, exactly: bool, method: str
) -> History:
    """Follow the legs from corner to corner, each in `count` steps and, with `exactly`, at every event."""
    times: list[float] = [0.0]
    found: list[Event] = []

    def history() -> History:
        return History(solutions, times, lambda: found if exactly else changes(solutions, times), linear=exactly)

    try:
        for leg, ends in enumerate(pairwise(corners)):
            _follow_leg(solutions, problem, leg, ends, count, method if exactly else None, times, found)
    except ContactQPError as error:
        error.history = history()
        raise
    return history()


def _follow_leg(
    solutions: _Steps,
    problem: ContactProblem,
    leg: int,
    ends: tuple[Vector, Vector],
    count: int,
    method: str | None,
    times: list[float],
    found: list[Event],
) -> None:
    """Follow one leg from its first load to its last in `count` steps, and append the times of its instants.

    With a method given, its exact events are computed, appended, and added as instants.
    """
    solutions.turn(*ends)
    fractions = {(i + 1) / count for i in range(count)}
    if method is not None:
        exact = events_of_leg(problem, *ends, solutions[-1], method)
        found += [Event(e.kind, e.contact, leg + e.time, problem.contact_name(e.contact)) for e in exact]
        fractions |= {e.time for e in exact if e.time > 0}
    for fraction in sorted(fractions):
        refuse_late(f"the step to t = {leg + fraction:.6g}")
        try:
            solutions.go_to(fraction)
        except NoEquilibrium as error:
            raise NoEquilibrium(f"follow_path: at t = {leg + fraction:.6g}: {error}", error.proof) from error
        times.append(leg + fraction)


class _Steps(LazySolutions):
    """The solutions along a path, each refined, expanded and certified at first access."""

    def __init__(self, problem: ContactProblem, method: str, options: dict[str, Any]) -> None:
        super().__init__()
        self._problem, self._method, self._options = problem, method, options
        self._start: Candidate | None = None
        # Without a condensation of all contacts `solve` is used.
        self._whole = iterated(problem) or contacts_are_many(problem)
        self._step(np.zeros(problem.dimension))

    def turn(self, start: Vector, end: Vector) -> None:
        """Begin the leg from one corner of the load to the next."""
        self._leg = start, end
        if not self._whole:
            condensation = condense(self._problem)
            self._reduced = condensation.reduce_load(start), condensation.reduce_load(end)

    def go_to(self, fraction: float) -> None:
        """Add a step to the load at a fraction of the leg."""
        start, end = self._leg
        load = end if fraction == 1 else start + fraction * (end - start)
        if not self._whole:
            # The reduced load of a combination is the combination of reduced loads.
            (f, inner), (f_end, inner_end) = self._reduced
            at = f + fraction * (f_end - f), inner + fraction * (inner_end - inner)
            condense(self._problem).remember_load(load, *at)
        self._step(load)

    def _step(self, load: Vector) -> None:
        problem = self._problem.replace(load=load)
        if self._whole:
            before = self[-1] if len(self) else None
            self.append(solve(problem, self._method, warm_start=before, **self._options))
            return
        run = begin(problem, self._method, self._start, **self._options)
        self._start = run.start
        self.append(run)


def _corners(problem: ContactProblem, loads: Sequence[ArrayLike]) -> list[Vector]:
    if len(loads) == 0:
        raise InvalidProblem("loads: expected at least one load vector, got none")
    return [np.zeros(problem.dimension), *(problem.replace(load=load).load for load in loads)]


def changes(solutions: Sequence[Solution], times: Sequence[float]) -> Iterator[Event]:
    """Return the contacts that have a force at one step and none at the previous one, or the reverse."""
    states = ((solution.normal_force > 0, np.zeros(len(solution.normal_force), dtype=bool)) for solution in solutions)
    return contact_changes(states, times, lambda i: solutions[0].problem.contact_name(i))


def _of_all_rows(rows: ActingRows, history: History) -> History:
    """Return a path of the problem without idle rows as a path of the whole problem."""
    return History(
        LazySolutions(OnAllRows(rows, history, k) for k in range(len(history))),
        history.times.tolist(),
        lambda: events_on_all_rows(rows, history),
        energies=lambda: history.energies,
        notes=lambda: history.notes,
    )
