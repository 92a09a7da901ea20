"""A problem of very many contacts, solved on candidates that are widened until no other contact is penetrated."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.certificate.certificate import compute_certificate, contact_status
from contactqp.certificate.subset_bounds import among, take_all, widened
from contactqp.errors import NoEquilibrium, NotCertified, NotConverged
from contactqp.linalg.condensation import condense
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Raw, Solution, Work


def solve_among(
    problem: ContactProblem,
    candidates: NDArray[np.intp],
    start: Solution | None,
    solve: Callable[[ContactProblem, Solution | None], Solution],
) -> Solution:
    """The solution of the whole problem by `solve(problem of the candidates, where to start)`.

    Where the candidates alone cannot hold the bodies, all contacts are taken at once.
    """
    started, spent = time.perf_counter(), Work()
    while True:
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


def _spent_on(few: ContactProblem) -> Work:
    """What a problem that came to no answer has cost."""
    way = condense(few)
    return Work(factorisations=way.factorisations, back_substitutions=way.back_substitutions)


def _gap(problem: ContactProblem, displacement: Vector) -> Vector:
    return np.asarray(problem.gap - problem.normal @ displacement)


def _restricted(start: Solution | None, few: ContactProblem, candidates: NDArray[np.intp]) -> Solution | None:
    return None if start is None else replace(start, problem=few, normal_force=start.normal_force[candidates])


def _of_all(
    problem: ContactProblem, candidates: NDArray[np.intp], solution: Solution, spent: Work, started: float
) -> Solution:
    """The solution with all contacts, certified with all of them."""

    def spread(force: Vector) -> Vector:
        everywhere = np.zeros(problem.contacts)
        everywhere[candidates] = force
        return everywhere

    answered = time.perf_counter()
    no_friction = None if problem.slip_origin is None else np.zeros_like(problem.slip_origin)

    def judged(answer: Solution | Raw) -> dict[str, Any]:
        force = spread(answer.normal_force)
        certificate = compute_certificate(problem, answer.displacement, force, no_friction, answer.tie_force)
        return dict(normal_force=force, certificate=certificate)

    whole = replace(solution, problem=problem, friction_force=no_friction, **judged(solution))
    certified = time.perf_counter()
    return replace(
        whole,
        contact_status=contact_status(problem, whole.certificate),
        raw=None if solution.raw is None else replace(solution.raw, **judged(solution.raw)),
        seconds=certified - started,
        certify_seconds=certified - answered,
        work=solution.work.after(spent),
    )
