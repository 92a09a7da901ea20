"""Load paths: one ContactProblem after another, all with one factorisation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from contactqp.analysis.events import events_of_leg
from contactqp.analysis.history import Event, History
from contactqp.errors import InvalidProblem, Unsupported
from contactqp.problem import ContactProblem, Vector
from contactqp.solution import Solution
from contactqp.solving import solve

DEFAULT_STEPS = 100


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

    Parameters
    ----------
    loads : sequence of (n,) arrays [force]
        The corners of the path.
    steps : int, optional
        Equal steps a leg, 100 by default; with ``events="exact"`` none but the events and the corners by default.
    events : None or "exact"
        None reports a change of state at the first step that shows it. "exact" finds its time exactly: between
        changes the displacement is linear in the load.
    method, **options
        As in `solve`.

    Returns
    -------
    History
        The start and every step (``steps=40`` gives 41 solutions on one leg), and every event.

    Raises
    ------
    Unsupported
        Friction (not in this version); exact events with a method that is approximate by design, or where the motion
        jumps.
    NoEquilibrium
        At the first load that nothing holds.

    Examples
    --------
    >>> wall = ContactProblem(stiffness=[[157500.0]], load=[0.0], normal=[[1.0]], gap=[1e-3])
    >>> follow_path(wall, loads=[[300.0]], events="exact").events
    (Event(kind='closed', contact=0, time=0.525, name='contact 0'),)
    """
    corners = _corners(problem, loads)
    if events not in (None, "exact"):
        raise InvalidProblem(f"events: expected None or 'exact', got {events!r}")
    count = steps if steps is not None else (DEFAULT_STEPS if events is None else 1)
    if count < 1:
        raise InvalidProblem(f"steps: expected at least 1, got {count}")
    if problem.frictional:
        raise Unsupported("follow_path: Coulomb friction (not in this version)")
    solutions = [solve(problem.replace(load=corners[0]), method=method, **options)]
    times, found = [0.0], []
    for leg, (start, end) in enumerate(pairwise(corners)):
        fractions = [(i + 1) / count for i in range(count)]
        if events == "exact":
            exact = events_of_leg(problem, start, end, solutions[-1], method)
            found += [Event(e.kind, e.contact, leg + e.time, problem.contact_name(e.contact)) for e in exact]
            fractions = sorted({*fractions, *(e.time for e in exact if e.time > 0)})
        for fraction in fractions:
            load = end if fraction == 1 else start + fraction * (end - start)
            solutions.append(solve(problem.replace(load=load), method=method, warm_start=solutions[-1], **options))
            times.append(leg + fraction)
    return History(solutions, times, lambda: found if events else _changes(solutions, times))


def _corners(problem: ContactProblem, loads: Sequence[ArrayLike]) -> list[Vector]:
    if len(loads) == 0:
        raise InvalidProblem("loads: expected at least one load vector, got none")
    return [np.zeros(problem.dimension), *(problem.replace(load=load).load for load in loads)]


def _changes(solutions: Sequence[Solution], times: Sequence[float]) -> Iterator[Event]:
    """Contacts that carry a force at one step and none at the one before, or the other way round."""
    for (before, now), time in zip(pairwise(solutions), times[1:], strict=True):
        was, carries = before.normal_force > 0, now.normal_force > 0
        for i in np.flatnonzero(was != carries):
            kind = "closed" if carries[i] else "opened"
            yield Event(kind, int(i), time, now.problem.contact_name(int(i)))
