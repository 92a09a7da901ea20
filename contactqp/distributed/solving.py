"""solve_distributed(): the active set over the ranks, and its certificate."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from contactqp.certificate.bounds import Bounds, iterated_bounds
from contactqp.distributed import bounded
from contactqp.distributed.certificate import certify_distributed, contact_status
from contactqp.distributed.environment import destroy_dropped
from contactqp.distributed.friction import solve_friction
from contactqp.distributed.friction_rows import FrictionRows
from contactqp.distributed.iteration import DistributedIteration
from contactqp.distributed.preconditioner import AUTO, SOLVERS, chosen_solver
from contactqp.distributed.problem import DistributedAnswer, DistributedProblem, DistributedSolution
from contactqp.errors import NotCertified, NotConverged, Unsupported
from contactqp.model.solution import Candidate, Work
from contactqp.solving.methods import Settings, find, refuse_arguments
from contactqp.solving.methods.inexact_active_set import solve_by_iteration

# Of the energy of the contact forces: on any number of ranks the displacement is that of one process to 1e-9, in
# energy; single unknowns that are much softer than others may be off by more of their own size.
ENERGY = 1e-10


def solve_distributed(
    problem: DistributedProblem,
    method: str = "active-set",
    *,
    solver: str = AUTO,
    tolerance: float = 1e-9,
    time_limit: float | None = None,
    max_iter: int | None = None,
    warm_start: DistributedAnswer | None = None,
) -> DistributedSolution:
    """The minimum of 1/2 u'Ku - f'u over E_N u <= g, A u = b, with its forces and a certificate. Collective.

    Parameters
    ----------
    problem : DistributedProblem
    method : str
        ``"active-set"``: the primal-dual active set with truncated conjugate gradients
        (`contactqp.solving.methods.inexact_active_set`). For comparison PETSc's own, which take contacts and ties that
        are bounds on unknowns of their own and bodies that are held (`contactqp.distributed.bounded`):
        ``"vinewtonrsls"``, ``"vinewtonssls"`` (SNES) and ``"tao-bntr"``; their `solver` is ``"mumps"``, ``"hypre"`` or
        ``"asm"``.
    solver : str
        What preconditions them: ``"gamg"``, ``"hypre"``, ``"mumps"`` (a factorisation), or ``"auto"``: MUMPS up to
        100 000 unknowns and GAMG beyond. Options of PETSc's with the prefix ``contactqp_`` come after.
    tolerance, time_limit, max_iter
        As in `contactqp.solve`; max_iter counts contact sets.
    warm_start : DistributedAnswer, optional
        Of a problem with the same K and rows.

    Raises
    ------
    NoEquilibrium
        The load drives a rigid motion that nothing holds back.
    NotConverged, NotCertified
        As `contactqp.solve`, and where constraints conflict; the solution they carry is a DistributedSolution.
    Unsupported
        Another method, a solver that this PETSc has not.
    InvalidProblem
        A tolerance or a limit that is none.
    BackendFailed
        PETSc gave up.
    """
    started = time.perf_counter()
    refuse_method(method)
    refuse_arguments(tolerance, "auto", True, time_limit, max_iter)
    destroy_dropped(problem.ranks.comm)
    settings = Settings(tolerance, max_iter, time_limit, _start(warm_start), {})
    if method in bounded.METHODS:
        return _by_bounds(problem, method, solver, settings, started)
    way = iteration_of(problem, chosen_solver(solver, problem.dimension))
    before = way.krylov_iterations
    if problem.frictional:
        return _rubbing(problem, way, method, settings, warm_start, started)
    candidate = solve_by_iteration(problem, way, settings, ENERGY)
    answer = DistributedAnswer(candidate.displacement, candidate.normal_force, None, candidate.tie_force)
    answer, motions = _at_rest(problem, way, answer)
    solution = _judged(
        problem, answer, way, method, started, candidate.iterations, way.krylov_iterations - before, motions
    )
    return _accepted(solution, candidate)


def judged(
    problem: DistributedProblem, answer: DistributedAnswer, method: str, solver: str = AUTO
) -> DistributedSolution:
    """An answer that is known already, with its certificate. Collective."""
    way = iteration_of(problem, chosen_solver(solver, problem.dimension))
    _, motions = _at_rest(problem, way, answer)
    return _judged(problem, answer, way, method, time.perf_counter(), 0, 0, motions)


def refuse_method(method: str) -> None:
    """Raise Unsupported for what is not done over ranks."""
    if method in bounded.METHODS or find(method).kind == "active set":
        return
    raise Unsupported(f"{method}: engine 'petsc' has active-set, and {', '.join(bounded.METHODS)} to compare it with")


def _by_bounds(
    problem: DistributedProblem, method: str, solver: str, settings: Settings, started: float
) -> DistributedSolution:
    """By PETSc's own solvers; what bounds their error is ours."""
    way = iteration_of(problem, chosen_solver(solver if solver in SOLVERS else AUTO, problem.dimension))
    if way.floating.count:
        raise Unsupported(f"{method}: a body that only contacts hold has no stiffness that PETSc could factorise")
    candidate = bounded.solve_bounded(problem, method, solver, settings)
    answer = DistributedAnswer(candidate.displacement, candidate.normal_force, None, candidate.tie_force)
    none = np.zeros((len(problem.load), 0))
    return _accepted(_judged(problem, answer, way, method, started, candidate.iterations, 0, none), candidate)


def iteration_of(problem: DistributedProblem, solver: str) -> DistributedIteration:
    """Made once for a stiffness and its rows; shared by all problems that have both."""
    frictional = problem.frictional
    key = f"iteration by {solver}, {'with' if frictional else 'without'} friction"
    if key not in problem.shared:
        problem.shared[key] = DistributedIteration(problem, solver, tangents=frictional)
    way: DistributedIteration = problem.shared[key]
    return way


def _rubbing(
    problem: DistributedProblem,
    way: DistributedIteration,
    method: str,
    settings: Settings,
    start: DistributedAnswer | None,
    started: float,
) -> DistributedSolution:
    """The answer with friction, certified."""
    before = way.krylov_iterations
    found = solve_friction(problem, way, settings, start, ENERGY)
    steps = way.krylov_iterations - before
    answer, motions = _at_rest(problem, way, found.answer)
    name = f"tresca with {method}"
    solution = _judged(problem, answer, way, name, started, found.steps, steps, motions)
    return _accepted(solution, Candidate(answer.displacement, answer.normal_force, answer.tie_force))


def _at_rest(
    problem: DistributedProblem, way: DistributedIteration, answer: DistributedAnswer
) -> tuple[DistributedAnswer, Any]:
    """The displacement of least norm within the gaps, and the motions that nothing resists."""
    if not way.floating.count:
        return answer, np.zeros((len(problem.load), 0))
    floating = way.floating
    if answer.friction_force is not None and problem.friction is not None:
        rubs = (problem.friction > 0) & (answer.normal_force > 0)
        floating = FrictionRows(problem, way).sticking(rubs)[0].floating
    displacement, motions = floating.at_rest(problem, answer.displacement, answer.normal_force)
    return replace(answer, displacement=displacement), motions


def _start(known: DistributedAnswer | None) -> Candidate | None:
    return None if known is None else Candidate(known.displacement, known.normal_force, known.tie_force)


def _judged(
    problem: DistributedProblem,
    answer: DistributedAnswer,
    way: DistributedIteration,
    method: str,
    started: float,
    sets: int | None,
    steps: int,
    motions: Any,
) -> DistributedSolution:
    answered, before = time.perf_counter(), way.krylov_iterations

    def known() -> Bounds:
        return iterated_bounds(problem, answer, way)

    certificate = certify_distributed(problem, answer, bounds=known)
    ended = time.perf_counter()
    return DistributedSolution(
        problem=problem,
        answer=answer,
        status=contact_status(problem, certificate),
        certificate=certificate,
        method=method,
        seconds=float(problem.ranks.max(ended - started)),
        certify_seconds=float(problem.ranks.max(ended - answered)),
        work=Work(
            factorisations=int(way.solver == "mumps"),
            iterations=sets,
            retained=problem.dimension,
            solver=way.solver,
            krylov_iterations=steps + way.krylov_iterations - before,
        ),
        motions=motions,
    )


def _accepted(solution: DistributedSolution, candidate: Candidate) -> DistributedSolution:
    if not candidate.claimed:
        message = f"{solution.method}: {candidate.status} (after {candidate.iterations} iterations)"
        raise NotConverged(message, candidate.history, solution)
    if not solution.certificate.passed:
        failures = "; ".join(solution.certificate.failures)
        raise NotCertified(f"{solution.method}: the certificate refuses the answer: {failures}", solution)
    return solution
