"""Solve contact problems over the ranks of MPI and certify the answers.

`solve_distributed` solves a problem of which each rank has a part; `solve_whole` one given whole to every rank, and
returns the whole answer to each.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.certificate.certificate import ROUNDING_OF_ANSWERS
from contactqp.certificate.multigrid_bounds import iterated_bounds
from contactqp.distributed import bounded
from contactqp.distributed.certificate import certify_distributed, contact_status
from contactqp.distributed.distributing import distribute
from contactqp.distributed.iteration import DistributedIteration
from contactqp.distributed.preconditioner import AUTO, SOLVERS, chosen_solver
from contactqp.distributed.problem import Bodies, DistributedProblem, DistributedSolution, largest_over_ranks
from contactqp.distributed.ranks import Ranks, collect_garbage
from contactqp.distributed.violations import violations
from contactqp.errors import NotCertified, NotConverged, Unsupported
from contactqp.linalg.iterated_states import FrictionRows
from contactqp.model.arrays import Array, Index
from contactqp.model.names import describe_motion
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import (
    FIGURES,
    Answer,
    Candidate,
    Certificate,
    FreeMotion,
    HoldsAnswer,
    NegligibleSizes,
    Solution,
    Violations,
    Work,
)
from contactqp.solving.friction.algorithms import ALGORITHMS
from contactqp.solving.friction.by_iteration import solve_friction_by_iteration
from contactqp.solving.methods import Settings, algorithm_name, find, of_same_letters, refuse_arguments, registered_name
from contactqp.solving.methods.inexact_active_set import solve_by_iteration
from contactqp.solving.methods.method import ACTIVE_SET

# The energy error relative to the energy of the contact forces: on any number of ranks the displacement agrees with
# that of one process to 1e-9 in energy; single very soft unknowns may differ by more, relative to their own size.
ENERGY = 1e-10


def solve_distributed(
    problem: DistributedProblem,
    method: str = "active-set",
    *,
    solver: str = AUTO,
    tolerance: float = 1e-9,
    time_limit: float | None = None,
    max_iter: int | None = None,
    warm_start: Answer | None = None,
) -> DistributedSolution:
    """Minimise 1/2 u'Ku - f'u over E_N u <= g, A u = b; return the solution with forces and certificate. Collective.

    Parameters
    ----------
    problem : DistributedProblem
        The problem, with or without friction.
    method : str
        ``"active-set"``: the primal-dual active set with truncated conjugate gradients
        (`contactqp.solving.methods.inexact_active_set`). For comparison PETSc's own, which take contacts and ties that
        are bounds on unknowns of their own and bodies that are supported (`contactqp.distributed.bounded`):
        ``"vinewtonrsls"``, ``"vinewtonssls"`` (SNES) and ``"tao-bntr"``; their `solver` is ``"mumps"``, ``"hypre"`` or
        ``"asm"``.
    solver : str
        The preconditioner: ``"gamg"``, ``"hypre"``, ``"mumps"`` (a factorisation), or ``"auto"``: MUMPS up to 100 000
        unknowns and GAMG beyond. PETSc's options with the prefix ``contactqp_`` override ours.
    tolerance, time_limit, max_iter
        As in `contactqp.solve`; max_iter counts contact sets.
    warm_start : Answer, optional
        This rank's part of the answer of a problem with the same K and rows.

    Raises
    ------
    NoEquilibrium
        The load drives a rigid motion that nothing resists.
    NotConverged, NotCertified
        As `contactqp.solve`, and if constraints conflict; the attached solution is a DistributedSolution.
    Unsupported
        Another method, or a solver that this PETSc lacks.
    InvalidProblem
        An invalid tolerance or limit.
    BackendFailed
        PETSc failed.
    """
    started = time.perf_counter()
    method = distributed_method(method)
    refuse_arguments(tolerance, "auto", True, time_limit, max_iter)
    collect_garbage(problem.ranks.comm)
    start = None
    if warm_start is not None:
        start = Candidate(replace(warm_start, friction_force=None))
    settings = Settings(tolerance, max_iter, time_limit, start, {})
    by_bounds = method in bounded.METHODS
    preconditioner = AUTO if by_bounds and solver not in SOLVERS else solver
    iteration = iteration_of(problem, chosen_solver(preconditioner, problem.dimension))
    before = iteration.krylov_iterations
    if by_bounds:
        if iteration.floating.count:
            raise Unsupported(f"{method}: a body that only contacts hold has no stiffness that PETSc could factorise")
        candidate = bounded.solve_bounded(problem, method, solver, settings)
    elif problem.frictional:
        certifiable = partial(_certifiable, problem, tolerance)
        candidate = solve_friction_by_iteration(problem, iteration, settings, warm_start, ENERGY, certifiable)
        method = algorithm_name("tresca", method)
    else:
        candidate = solve_by_iteration(problem, iteration, settings, ENERGY)
    answer, motions = _at_rest(problem, iteration, candidate.answer)
    solution = _certified(problem, answer, motions, iteration, method)
    krylov_iterations = iteration.krylov_iterations - before
    solution = replace(
        solution,
        seconds=float(problem.ranks.max(time.perf_counter() - started)),
        work=replace(solution.work, iterations=candidate.iterations, krylov_iterations=krylov_iterations),
    )
    if not candidate.claimed:
        message = f"{method}: {candidate.status} (after {candidate.iterations} iterations)"
        raise NotConverged(message, candidate.history, solution)
    if not solution.certificate.passed:
        failures = "; ".join(solution.certificate.failures)
        raise NotCertified(f"{method}: the certificate refuses the answer: {failures}", solution)
    return solution


def _certifiable(problem: DistributedProblem, tolerance: float, answer: Answer, limit: float) -> bool:
    """Return whether all figures of the certificate except `balance`, which equilibrium implies, are at most a
    limit.
    """
    found = violations(problem, answer, Bodies(problem.ranks, problem.body), ROUNDING_OF_ANSWERS * tolerance)
    figures = largest_over_ranks(problem.ranks, *(getattr(found, name) for name in FIGURES if name != "balance"))
    return all(figure <= limit for figure in figures)


def certified_solution(
    problem: DistributedProblem, answer: Answer, method: str, solver: str = AUTO
) -> DistributedSolution:
    """Certify a known answer, without raising if the certificate refuses it. Collective.

    Parameters
    ----------
    problem : the problem
    answer : this rank's part of the answer
    method : the name of the method that it is from
    solver : the preconditioner, as in `solve_distributed`
    """
    iteration = iteration_of(problem, chosen_solver(solver, problem.dimension))
    return _certified(problem, answer, _at_rest(problem, iteration, answer)[1], iteration, method)


def distributed_method(name: str) -> str:
    """Return the registered name of a method that solves over ranks, ignoring case.

    Raises Unsupported: the method does not exist, or does not solve over ranks.
    """
    method = of_same_letters(name, bounded.METHODS) or registered_name(name)
    if method in bounded.METHODS or find(method).kind == ACTIVE_SET:
        return method
    raise Unsupported(f"{method}: engine 'petsc' has active-set, and {', '.join(bounded.METHODS)} to compare it with")


def iteration_of(problem: DistributedProblem, solver: str) -> DistributedIteration:
    """Return the iteration of a stiffness and its rows, shared by all problems that have both. Collective."""
    frictional = problem.frictional
    made = problem.computed.iterations
    if (solver, frictional) not in made:
        made[solver, frictional] = DistributedIteration(problem, solver, tangents=frictional)
    found: DistributedIteration = made[solver, frictional]
    return found


def _at_rest(problem: DistributedProblem, iteration: DistributedIteration, answer: Answer) -> tuple[Answer, Array]:
    """Return the answer with the displacement of least norm within the gaps, and the unresisted rigid motions."""
    if not iteration.floating.count:
        return answer, np.zeros((len(problem.load), 0))
    u, force = answer.displacement, answer.normal_force
    if answer.friction_force is not None and problem.friction is not None:
        displacement, motions = FrictionRows(problem, iteration).at_rest(u, force)
    else:
        displacement, motions = iteration.floating.at_rest(u, force, problem.gap)
    return replace(answer, displacement=displacement), motions


def _certified(
    problem: DistributedProblem, answer: Answer, motions: Array, iteration: DistributedIteration, method: str
) -> DistributedSolution:
    """Return an answer with its certificate, and with the seconds and work of the certificate."""
    started, before = time.perf_counter(), iteration.krylov_iterations
    certificate = certify_distributed(problem, answer, bounds=lambda: iterated_bounds(problem, answer, iteration))
    seconds = float(problem.ranks.max(time.perf_counter() - started))
    work = Work(
        factorisations=int(iteration.factorised),
        retained=problem.dimension,
        solver=iteration.solver,
        krylov_iterations=iteration.krylov_iterations - before,
    )
    status = contact_status(problem, certificate)
    return DistributedSolution(problem, answer, status, certificate, method, seconds, seconds, work, motions)


# The fields of violations with one entry per unknown; "tie" has one per tie, the others one per contact.
_OF_UNKNOWNS = ("equilibrium", "residual", "meeting")
# The options of `solve` for one process only, with their default values.
_OF_ONE_PROCESS = {"condense": "auto", "polish": True}
# The options of `solve_distributed`, with a distributed warm start.
_OPTIONS = ("tolerance", "solver", "time_limit", "max_iter")


def solve_whole(problem: ContactProblem, method: str, *, warm_start: Any = None, **options: Any) -> Solution:
    """Solve as `contactqp.solve` on the ranks of MPI; arguments and result are the same on all ranks. Collective.

    Raises Unsupported: a method or an option for one process only.

    Parameters
    ----------
    problem : the whole problem, on every rank
    method : as in `solve_distributed`
    warm_start : Solution, optional
        A solution of a problem with the same K and rows.
    **options
        The options that `options_on_ranks` accepts.
    """
    chosen = options_on_ranks(options)
    part = distribute(problem, Ranks())
    start = None if warm_start is None else part_of_solution(part, warm_start)
    with whole_in_errors(problem):
        return whole_solution(problem, solve_distributed(part, method, warm_start=start, **chosen))


def options_on_ranks(options: dict[str, Any]) -> dict[str, Any]:
    """Return the options of `solve` that apply on several ranks.

    Raises Unsupported: another one is given.
    """
    stated = [name for name, usual in _OF_ONE_PROCESS.items() if name in options and options[name] != usual]
    if stated:
        raise Unsupported(f"engine 'petsc': {stated[0]} is an option of one process, leave it out")
    algorithm = options.get("algorithm")
    if algorithm is not None and not (algorithm in ALGORITHMS and ALGORITHMS[algorithm].on_ranks):
        raise Unsupported(f"engine 'petsc': friction is solved by 'tresca' alone, got {options['algorithm']!r}")
    chosen = {name: value for name, value in options.items() if name not in (*_OF_ONE_PROCESS, "algorithm")}
    if unknown := [name for name in chosen if name not in _OPTIONS]:
        raise Unsupported(f"engine 'petsc': there is no option {unknown[0]!r}, expected one of {', '.join(_OPTIONS)}")
    return chosen


def part_of_solution(part: DistributedProblem, solution: Solution) -> Answer:
    """Return this rank's part of a solution that all ranks have."""
    friction, free = solution.friction_force, part.dof_number >= 0
    displacement = np.zeros(len(part.dof_number))
    displacement[free] = solution.displacement[part.dof_number[free]]
    return Answer(
        displacement=displacement,
        normal_force=solution.normal_force[part.contact_number],
        friction_force=None if friction is None else friction[part.contact_number],
        tie_force=solution.tie_force[part.tie_number],
    )


@contextmanager
def whole_in_errors(problem: ContactProblem) -> Iterator[None]:
    """Replace the distributed solution attached to an error by the whole one. Collective if the error is raised, on all
    ranks.
    """
    try:
        yield
    except (NotConverged, NotCertified) as error:
        carrier: Any = error
        if isinstance(carrier.solution, DistributedSolution):
            carrier.solution = whole_solution(problem, carrier.solution)
        raise


def whole_solution(problem: ContactProblem, solution: DistributedSolution) -> Solution:
    """Return a distributed solution as that of one process, on every rank. Collective."""
    return Solution(
        problem=problem,
        answer=Answer(solution.displacement, solution.normal_force, solution.friction_force, solution.tie_force),
        contact_status=solution.contact_status,
        free_motions=tuple(FreeMotion(motion, describe_motion(problem, motion)) for motion in solution.free_motions),
        certificate=whole_certificate(solution, solution.problem.gathered),
        method=solution.method,
        seconds=solution.seconds,
        certify_seconds=solution.certify_seconds,
        work=solution.work,
    )


Gather = Callable[[NDArray[Any], Index], NDArray[Any]]


def whole_certificate(solution: DistributedSolution, gather: Gather) -> Certificate:
    """Return the certificate with the figures of the contacts, unknowns and ties of all ranks. Collective.

    `gather` returns the values of all ranks in the order of their numbers.
    """
    part, certificate = solution.problem, solution.certificate
    bound, found = certificate.force_bound, certificate.violations
    return replace(
        certificate,
        force_bound=None if bound is None else gather(bound, part.contact_number),
        violations=None if found is None else _whole_violations(found, part, gather),
    )


def _whole_violations(found: Violations, part: DistributedProblem, gather: Gather) -> Violations:
    numbers = dict.fromkeys(_OF_UNKNOWNS, part.dof_number) | {"tie": part.tie_number}
    whole = {
        each.name: gather(getattr(found, each.name), numbers.get(each.name, part.contact_number))
        for each in fields(found)
        if each.name not in ("intrinsic_size", "nothing")
    }
    negligible, tangent = found.nothing, found.nothing.tangent
    if part.slip_origin is not None:
        tangent = gather(tangent.reshape(part.slip_origin.shape), part.contact_number).ravel()
    nothing = NegligibleSizes(
        force=gather(negligible.force, part.dof_number),
        normal=gather(negligible.normal, part.contact_number),
        tangent=tangent,
        tie=gather(negligible.tie, part.tie_number),
        contact_force=None if negligible.contact_force is None else gather(negligible.contact_force, part.dof_number),
    )
    return Violations(**whole, intrinsic_size=found.intrinsic_size, nothing=nothing)


@dataclass(frozen=True, eq=False)
class CollectedSolution(HoldsAnswer):
    """A solution for printing, complete in the numbers of one process on the first rank, with empty arrays on the
    others.
    """

    answer: Answer = field(repr=False)
    contact_status: NDArray[np.str_] = field(repr=False)  # (m,)
    certificate: Certificate  # with figures and verdict of all ranks
    method: str
    seconds: float
    work: Work


def collected(solution: DistributedSolution) -> CollectedSolution:
    """Collect a solution of all ranks on the first one. Collective."""
    part, answer = solution.problem, solution.answer

    def gather(values: NDArray[Any], numbers: Index) -> NDArray[Any]:
        free = np.flatnonzero(numbers >= 0)
        every, order = part.ranks.exchange(np.zeros(len(free), dtype=np.intp), values[free], numbers[free])
        return np.asarray(every[np.argsort(order)])

    friction = answer.friction_force
    return CollectedSolution(
        answer=Answer(
            displacement=gather(answer.displacement, part.dof_number),
            normal_force=gather(answer.normal_force, part.contact_number),
            friction_force=None if friction is None else gather(friction, part.contact_number),
            tie_force=gather(answer.tie_force, part.tie_number),
        ),
        contact_status=gather(solution.status, part.contact_number),
        certificate=whole_certificate(solution, gather),
        method=solution.method,
        seconds=solution.seconds,
        work=solution.work,
    )
