"""A problem of very many contacts by a subset of them that grows until no other contact is penetrated."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.certificate.certificate import compute_certificate, contact_status
from contactqp.certificate.subset_bounds import among, candidates_around, first_candidates, take_all, widened
from contactqp.errors import NoEquilibrium, NotCertified, NotConverged
from contactqp.linalg.condensation import condense
from contactqp.linalg.iteration import contacts_are_many
from contactqp.linalg.runtime import tell
from contactqp.model.arrays import Array, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution, Work

WithoutFriction = Callable[[ContactProblem], tuple[Vector, Work]]


def solve_among(
    problem: ContactProblem,
    start: Solution | None,
    solve: Callable[[ContactProblem, Solution | None], Solution],
    without_friction: WithoutFriction,
) -> Solution | None:
    """Solve a problem by `solve(problem of the candidates, start)`, and certify the answer with all contacts.

    Returns None where all contacts are few enough, or no candidates are found. Where the candidates cannot hold the
    bodies, all contacts are taken at once. `without_friction` returns normal forces (m,) and what they have cost.
    """
    started = time.perf_counter()
    candidates, spent = _first(problem, start, without_friction)
    while candidates is not None:
        tell(f"{len(candidates)} of {problem.contacts} contacts are candidates")
        few = among(problem, candidates)
        try:
            solution = solve(few, _restricted(start, few, candidates))
        except NoEquilibrium:
            spent = _spent_on(few).after(spent)
            take_all(problem)
            solution = solve(problem, start)
            return replace(solution, work=solution.work.after(spent), seconds=time.perf_counter() - started)
        except (NotConverged, NotCertified) as error:
            if isinstance(error.solution, Solution):
                error.solution = _of_all(problem, candidates, error.solution, spent, started)
            raise
        wider = widened(problem, candidates, _gap(problem, solution.displacement), solution.displacement)
        if wider is None:
            return _of_all(problem, candidates, solution, spent, started)
        spent = solution.work.after(spent)
        candidates = wider
    return None


def _first(
    problem: ContactProblem, start: Solution | None, without_friction: WithoutFriction
) -> tuple[NDArray[np.intp] | None, Work]:
    """Return the first candidates, None for all contacts, and the work of finding them.

    With friction they are those of the last load, or near those that close at the start, else without friction.
    """
    if not problem.frictional or not contacts_are_many(problem) or problem._computed.subset is not None:
        return first_candidates(problem), Work()
    if start is not None:
        return candidates_around(problem, np.flatnonzero(start.normal_force > 0)), Work()
    try:
        force, work = without_friction(problem)
    except (NoEquilibrium, NotConverged, NotCertified):
        return None, Work()
    return candidates_around(problem, np.flatnonzero(force > 0)), work


def _spent_on(few: ContactProblem) -> Work:
    """Return the work spent on a problem that came to no answer."""
    way = condense(few)
    return Work(factorisations=way.factorisations, back_substitutions=way.back_substitutions)


def _gap(problem: ContactProblem, displacement: Vector) -> Vector:
    return np.asarray(problem.gap - problem.normal @ displacement)


def _restricted(start: Solution | None, few: ContactProblem, candidates: NDArray[np.intp]) -> Solution | None:
    if start is None:
        return None
    friction = None if start.friction_force is None else start.friction_force[candidates]
    return replace(start, problem=few, normal_force=start.normal_force[candidates], friction_force=friction)


def _of_all(
    problem: ContactProblem, candidates: NDArray[np.intp], solution: Solution, spent: Work, started: float
) -> Solution:
    """Return the solution with all contacts, certified with all of them."""

    def spread(force: Array) -> Array:
        everywhere = np.zeros((problem.contacts, *force.shape[1:]))
        everywhere[candidates] = force
        return everywhere

    def of_all(found: Any) -> Any:
        friction = None if problem.slip_origin is None else np.zeros_like(problem.slip_origin)
        if found.friction_force is not None:
            friction = spread(found.friction_force)
        return replace(found, problem=problem, normal_force=spread(found.normal_force), friction_force=friction)

    answered = time.perf_counter()
    raw = solution.raw
    whole: Solution = of_all(solution)
    certificate = compute_certificate(
        problem, whole.displacement, whole.normal_force, whole.friction_force, whole.tie_force
    )
    whole = replace(whole, certificate=certificate)
    certified = time.perf_counter()
    return replace(
        whole,
        contact_status=contact_status(problem, whole.certificate),
        raw=None if raw is None else of_all(raw),
        seconds=certified - started,
        certify_seconds=certified - answered,
        work=solution.work.after(spent),
    )
