"""Every equilibrium of a small problem with Coulomb friction, each certified."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import overload

from contactqp.certificate.idle_rows import acting_rows
from contactqp.errors import InvalidProblem, refuse_other
from contactqp.model.floating_point import own_floating_point
from contactqp.model.local_problem import LocalProblem
from contactqp.model.local_solution import LocalSolution
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution
from contactqp.solving.friction_attempt import found_by_enumeration
from contactqp.solving.local_solving import local_equilibria
from contactqp.solving.methods import find
from contactqp.solving.solve import Begun


@overload
def equilibria(problem: ContactProblem) -> tuple[Solution, ...]: ...


@overload
def equilibria(problem: LocalProblem) -> tuple[LocalSolution, ...]: ...


@own_floating_point
def equilibria(problem: ContactProblem | LocalProblem) -> tuple[Solution, ...] | tuple[LocalSolution, ...]:
    """All states of a frictional problem in the plane that satisfy equilibrium, contact and Coulomb's law.

    Above a critical coefficient of friction a problem may have none, several, or a continuum of which some members are
    returned. All combinations of open, stick and slip are tried (`contactqp.solving.friction.enumeration`).

    Parameters
    ----------
    problem : ContactProblem or LocalProblem
        With friction, at most eight contacts, one tangential row a contact; or in local form in the plane, its operator
        symmetric or not.

    Returns
    -------
    tuple of Solution or LocalSolution
        One for each displacement (velocity), certified; empty where there is no equilibrium. Where contacts are
        redundant, the forces are one choice among many.

    Raises
    ------
    InvalidProblem
        There is no friction: `solve` has the one answer.
    Unsupported
        More than eight contacts, or two tangential rows a contact.
    NotCertified
        The certificate refuses one of them.

    Examples
    --------
    Klarbring's (1990) one contact, mu = 0.8 above the critical 0.5, has three: open, stick, slip.

    >>> import contactqp as cq
    >>> data = dict(stiffness=[[5.0, -2.0], [-2.0, 1.0]], normal=[[-1.0, 0.0]], gap=[0.0], tangent=[[0.0, 1.0]])
    >>> [str(s.contact_status[0]) for s in cq.equilibria(cq.ContactProblem(**data, load=[-1.0, 0.65], friction=0.8))]
    ['open', 'stick', 'slip']
    """
    if isinstance(problem, LocalProblem):
        return local_equilibria(problem)
    refuse_other("equilibria", problem, ContactProblem, LocalProblem)
    if not problem.frictional:
        raise InvalidProblem(
            "equilibria: expected a problem with friction; without it the minimum is what solve returns"
        )
    if (rows := acting_rows(problem)) is not None:
        rows.refuse_conflict()
        return tuple(rows.solution(one) for one in equilibria(rows.problem))
    started = time.perf_counter()
    with problem.lock:
        found = found_by_enumeration(problem)
    spent = time.perf_counter() - started
    method = replace(find("active-set"), name="enumeration")
    return tuple(Begun(problem, method, attempt, True, spent).finish() for attempt in found)
