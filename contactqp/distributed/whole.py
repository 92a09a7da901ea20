"""A problem that every rank was given whole, solved by all of them, and its answer given whole to each."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.distributed.distributing import distribute
from contactqp.distributed.problem import DistributedAnswer, DistributedProblem, DistributedSolution, Numbers
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.solving import solve_distributed
from contactqp.errors import NotCertified, NotConverged, Unsupported
from contactqp.linalg.existence import describe_motion
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Certificate, FreeMotion, Nothing, Solution, Violations, Work
from contactqp.solving.friction.algorithms import ALGORITHMS

# What a certificate says of each unknown; of ties it says "tie", and all else of contacts.
_OF_UNKNOWNS = ("equilibrium", "residual", "meeting")
# What `solve` takes for a problem in one process and has no meaning on several, with what leaves it out.
_OF_ONE_PROCESS = {"condense": "auto", "polish": True}
# What `solve_distributed` takes, but for what is dealt out.
_OPTIONS = ("tolerance", "solver", "time_limit", "max_iter")


def solve_whole(problem: ContactProblem, method: str, *, warm_start: Any = None, **options: Any) -> Solution:
    """As `contactqp.solve`, on the ranks of MPI. Collective: all ranks give the same and get the same.

    Raises
    ------
    Unsupported
        A method or an option that is of one process only.
    """
    chosen = options_on_ranks(options)
    part = distribute(problem, Ranks())
    start = None if warm_start is None else dealt(part, warm_start)
    with whole_in_errors(problem):
        return gathered(problem, solve_distributed(part, method, warm_start=start, **chosen))


def options_on_ranks(options: dict[str, Any]) -> dict[str, Any]:
    """The options of `solve` that mean something on several ranks.

    Raises
    ------
    Unsupported
        Another one is given.
    """
    stated = [name for name, usual in _OF_ONE_PROCESS.items() if name in options and options[name] != usual]
    if stated:
        raise Unsupported(f"engine 'petsc': {stated[0]} is an option of one process, leave it out")
    algorithm = options.get("algorithm")
    if algorithm is not None and not (algorithm in ALGORITHMS and ALGORITHMS[algorithm].on_ranks):
        raise Unsupported(f"engine 'petsc': friction is solved by 'tresca' alone, got {options['algorithm']!r}")
    left = {name: value for name, value in options.items() if name not in (*_OF_ONE_PROCESS, "algorithm")}
    if unknown := [name for name in left if name not in _OPTIONS]:
        raise Unsupported(f"engine 'petsc': there is no option {unknown[0]!r}, expected one of {', '.join(_OPTIONS)}")
    return left


def dealt(part: DistributedProblem, solution: Solution) -> DistributedAnswer:
    """This rank's part of a solution that all ranks have."""
    friction, there = solution.friction_force, part.dof_number >= 0
    displacement = np.zeros(len(part.dof_number))
    displacement[there] = solution.displacement[part.dof_number[there]]
    return DistributedAnswer(
        displacement=displacement,
        normal_force=solution.normal_force[part.contact_number],
        friction_force=None if friction is None else friction[part.contact_number],
        tie_force=solution.tie_force[part.tie_number],
    )


@contextmanager
def whole_in_errors(problem: ContactProblem) -> Iterator[None]:
    """The solution that an error carries is whole, as that of one process. Collective where all ranks raise it."""
    try:
        yield
    except (NotConverged, NotCertified) as error:
        found: Any = error.solution
        carrier: Any = error
        if isinstance(found, DistributedSolution):
            carrier.solution = gathered(problem, found)
        raise


def gathered(problem: ContactProblem, solution: DistributedSolution) -> Solution:
    """A distributed solution as one process would have it, on every rank. Collective."""
    return Solution(
        problem=problem,
        displacement=solution.displacement,
        normal_force=solution.normal_force,
        friction_force=solution.friction_force,
        tie_force=solution.tie_force,
        contact_status=solution.contact_status,
        free_motions=tuple(FreeMotion(motion, describe_motion(problem, motion)) for motion in solution.free_motions),
        certificate=certificate_of(solution, solution.problem.whole),
        method=solution.method,
        seconds=solution.seconds,
        certify_seconds=solution.certify_seconds,
        work=solution.work,
    )


def certificate_of(
    solution: DistributedSolution, whole: Callable[[NDArray[Any], Numbers], NDArray[Any]]
) -> Certificate:
    """With what it says contact by contact of all ranks, where `whole` makes that of their parts. Collective."""
    part, certificate = solution.problem, solution.certificate
    bound, found = certificate.force_bound, certificate.violations
    return replace(
        certificate,
        force_bound=None if bound is None else whole(bound, part.contact_number),
        violations=None if found is None else _violations_of(found, part, whole),
    )


def _violations_of(
    found: Violations, part: DistributedProblem, whole: Callable[[NDArray[Any], Numbers], NDArray[Any]]
) -> Violations:
    """The violations of all unknowns, contacts and ties, from each rank's. Collective."""
    numbers = dict.fromkeys(_OF_UNKNOWNS, part.dof_number) | {"tie": part.tie_number}
    gathered = {
        each.name: whole(getattr(found, each.name), numbers.get(each.name, part.contact_number))
        for each in fields(found)
        if each.name not in ("intrinsic_size", "nothing")
    }
    none = found.nothing
    origin, across = part.slip_origin, none.tangent
    if origin is not None:
        across = whole(across.reshape(origin.shape), part.contact_number).ravel()
    nothing = Nothing(
        force=whole(none.force, part.dof_number),
        normal=whole(none.normal, part.contact_number),
        tangent=none.tangent
        if origin is None
        else whole(none.tangent.reshape(origin.shape), part.contact_number).ravel(),
        tie=whole(none.tie, part.tie_number),
    )
    return Violations(**gathered, intrinsic_size=found.intrinsic_size, nothing=nothing)


# An answer for the rank that prints it: whole on the first, of no rows on the others.


@dataclass(frozen=True, eq=False)
class CollectedSolution:
    """What is told of an answer in the numbers of one process; arrays have their rows on the first rank alone."""

    displacement: Vector = field(repr=False)  # (n,)
    normal_force: Vector = field(repr=False)  # (m,)
    friction_force: NDArray[np.float64] | None = field(repr=False)  # (m, d-1)
    tie_force: Vector = field(repr=False)  # (k,)
    contact_status: NDArray[np.str_] = field(repr=False)  # (m,)
    certificate: Certificate  # its figures and its verdict are those of all ranks
    method: str
    seconds: float
    work: Work


def collected(solution: DistributedSolution) -> CollectedSolution:
    """An answer of all ranks. Collective."""
    part, answer = solution.problem, solution.answer

    def whole(values: NDArray[Any], numbers: Numbers) -> NDArray[Any]:
        return _on_first(part.ranks, values, numbers)

    friction = answer.friction_force
    return CollectedSolution(
        displacement=whole(answer.displacement, part.dof_number),
        normal_force=whole(answer.normal_force, part.contact_number),
        friction_force=None if friction is None else whole(friction, part.contact_number),
        tie_force=whole(answer.tie_force, part.tie_number),
        contact_status=whole(solution.status, part.contact_number),
        certificate=certificate_of(solution, whole),
        method=solution.method,
        seconds=solution.seconds,
        work=solution.work,
    )


def _on_first(ranks: Ranks, values: NDArray[Any], numbers: Numbers) -> NDArray[Any]:
    """Values of all ranks in the order of their numbers, negative ones left out, on the first rank. Collective."""
    kept = np.flatnonzero(numbers >= 0)
    every, order = ranks.exchanged(np.zeros(len(kept), dtype=np.intp), values[kept], numbers[kept])
    return np.asarray(every[np.argsort(order)])
