"""The equilibria of problems with Coulomb friction: all of a small one, whether any exists, and the relaxed one.

`equilibria` lists and certifies every equilibrium, `existence_margin` tells whether a problem surely has one, and
`associated_difference` measures how far the associated relaxation is from Coulomb's answer.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, overload

import numpy as np

from contactqp.certificate.idle_rows import acting_rows
from contactqp.certificate.number_range import near_one
from contactqp.errors import InvalidProblem, Unsupported
from contactqp.linalg.condensation import condense
from contactqp.linalg.delassus import condensed_frictional_rows
from contactqp.model.arguments import checked
from contactqp.model.arrays import Array, Vector, own_floating_point
from contactqp.model.local_problem import LocalProblem, LocalSolution
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import ReadOnly
from contactqp.model.solution import Solution
from contactqp.solving.friction.conic import interior_margin
from contactqp.solving.friction.contact_form import ContactForm
from contactqp.solving.friction.local_form import LocalForm
from contactqp.solving.friction_runs import found_by_enumeration
from contactqp.solving.local_solving import local_equilibria
from contactqp.solving.methods import within_time_of
from contactqp.solving.solve import of_problem, solve


@overload
def equilibria(problem: ContactProblem) -> tuple[Solution, ...]: ...


@overload
def equilibria(problem: LocalProblem) -> tuple[LocalSolution, ...]: ...


@checked
@own_floating_point
def equilibria(problem: ContactProblem | LocalProblem) -> tuple[Solution, ...] | tuple[LocalSolution, ...]:
    """Return all states of a frictional problem in the plane that satisfy equilibrium, contact and Coulomb's law.

    Above a critical coefficient of friction a problem may have no equilibrium, several, or a continuum, of which some
    members are returned. All combinations of open, stick and slip are tried (`contactqp.solving.friction.enumeration`).

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
        There is no friction, so that `solve` returns the only answer.
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
    if not problem.frictional:
        raise InvalidProblem(
            "equilibria: expected a problem with friction; without it the minimum is what solve returns"
        )
    if (rows := acting_rows(problem)) is not None:
        rows.refuse_conflict()
        return tuple(rows.solution(one) for one in equilibria(rows.problem))
    if (near := near_one(problem)) is not None:
        return tuple(of_problem(near, one) for one in equilibria(near.problem))
    started = time.perf_counter()
    with problem._lock:
        found = found_by_enumeration(problem)
    for run in found:
        run.seconds = time.perf_counter() - started
    return tuple(run.finish() for run in found)


@dataclass(frozen=True, eq=False)
class AssociatedDifference(ReadOnly):
    """The answers of Coulomb's law and of its associated relaxation, and their differences, associated less Coulomb."""

    coulomb: Solution
    associated: Solution
    displacement: Vector  # (n,) [length]
    normal_force: Vector  # (m,) [force]
    friction_force: Array  # (m, d-1) [force]
    opening: Vector  # (m,) mu |s| where the relaxation slides under load: the gap that it opens [length]
    displacement_part: float  # |du|_K / |u|_K, absolute where Coulomb's answer has no energy
    force_part: float  # largest change of a contact force, of the largest contact force

    def __str__(self) -> str:
        return (
            f"the associated relaxation is off Coulomb's displacement by {self.displacement_part:.3g} in energy, off "
            f"its forces by {self.force_part:.3g}, and opens contacts that slide by up to "
            f"{np.max(self.opening, initial=0.0):.3g}"
        )


@checked
@own_floating_point
def associated_difference(
    problem: ContactProblem, coulomb: Solution | None = None, method: str = "active-set", **options: Any
) -> AssociatedDifference:
    """Solve Coulomb's law and its associated relaxation, min 1/2 u'Ku - f'u over E_N u + mu |E_T u - o| <= g, A u = b.

    Parameters
    ----------
    problem : ContactProblem
        A problem with friction.
    coulomb : Solution, optional
        Coulomb's answer, if it is known already; by default `solve(problem, method)`.
    method : str
        The exact method of both convex problems.
    **options
        Further options of `solve`; `time_limit` [s] is that of both solutions together.

    Raises
    ------
    InvalidProblem
        There is no friction, or `coulomb` is of another problem.
    NoEquilibrium, NotConverged, NotCertified, BackendFailed, Unsupported
        Raised by `solve`.

    Examples
    --------
    A block of one spring is pressed with 2 and pulled by 3, mu = 1/2: friction holds 1; relaxed, it climbs as it
    slides, against its spring, and the ground presses more.

    >>> import contactqp as cq
    >>> data = dict(stiffness=[[2.0, 0.0], [0.0, 2.0]], normal=[[-1.0, 0.0]], gap=[0.0], tangent=[[0.0, 1.0]])
    >>> found = associated_difference(cq.ContactProblem(**data, load=[-2.0, 3.0], friction=0.5))
    >>> found.coulomb.normal_force.round(9), found.associated.normal_force.round(9), found.opening.round(9)
    (array([2.]), array([2.8]), array([0.4]))
    """
    if not problem.frictional or problem.friction is None:
        raise InvalidProblem("associated_difference: expected a problem with friction")
    if coulomb is not None and coulomb.problem is not problem:
        raise InvalidProblem("coulomb: expected a solution of this very problem")
    with within_time_of(options):
        right = solve(problem, method, **options) if coulomb is None else coulomb
        other = solve(problem, method, algorithm="associated", **options)
    moved = other.displacement - right.displacement
    near = near_one(problem)
    seen = (moved, right.displacement) if near is None else map(near.displacement, (moved, right.displacement))
    energy, own = (_energy_norm(problem if near is None else near.problem, v) for v in seen)
    forces = [np.column_stack([s.normal_force, _friction(s)]) for s in (other, right)]
    change, largest = forces[0] - forces[1], float(np.max(abs(forces[1]), initial=0.0))
    worst = float(np.max(abs(change), initial=0.0))
    slip = np.zeros((problem.contacts, 1)) if other.slip is None else other.slip
    opening = np.where(other.normal_force > 0, problem.friction * np.linalg.norm(slip, axis=1), 0.0)
    return AssociatedDifference(
        coulomb=right,
        associated=other,
        displacement=moved,
        normal_force=change[:, 0],
        friction_force=change[:, 1:],
        opening=opening,
        displacement_part=energy / own if own > 0 else energy,
        force_part=worst / largest if largest > 0 else worst,
    )


def _energy_norm(problem: ContactProblem, u: Vector) -> float:
    return float(np.sqrt(max(u @ (problem.stiffness @ u), 0.0)))


def _friction(solution: Solution) -> Array:
    return np.zeros((len(solution.normal_force), 1)) if solution.friction_force is None else solution.friction_force


@checked
@own_floating_point
def existence_margin(problem: ContactProblem | LocalProblem) -> float:
    """Return the margin of the existence test of Acary, Cadoux, Lemarechal and Malick (2011).

    It is the largest x <= 1 for which some velocity u = W y + V l + q has u_N - x >= mu |u_T| at every contact, in a
    scale in which contacts have a compliance of one and q entries of size one. Where it is positive, forces that
    satisfy the law exist; where it is not, they may exist all the same.

    Parameters
    ----------
    problem : ContactProblem with friction, or LocalProblem

    Raises
    ------
    InvalidProblem
        The problem is a contact problem without friction, whose minimum exists wherever the constraints do not
        conflict.
    Unsupported
        Bodies float, or a local problem has joints without compliance, which the theorem excludes.
    BackendMissing, BackendFailed
        Clarabel is not installed, or fails.

    Examples
    --------
    A block jammed between walls that close in on it has no solution:

    >>> import numpy as np
    >>> W = np.zeros((4, 4))
    >>> W[::2, ::2], W[1::2, 1::2] = [[1.0, -1.0], [-1.0, 1.0]], [[1.0, 1.0], [1.0, 1.0]]
    >>> existence_margin(LocalProblem(delassus=W, offset=[-0.1, 0.0, -0.1, 0.0], friction=0.5, dimension=2)) < 0
    True
    """
    if isinstance(problem, ContactProblem) and (rows := acting_rows(problem)) is not None:
        rows.refuse_conflict()
        if not rows.problem.frictional:
            return 1.0  # no contact may close that has friction
        problem = rows.problem
    form = LocalForm(problem if isinstance(problem, LocalProblem) else _local(problem))
    if np.any(form.joint_signs < 0):
        raise Unsupported("existence_margin: bodies that float, or joints without compliance (the theorem has neither)")
    return interior_margin(form)


def _local(problem: ContactProblem) -> LocalProblem:
    if not problem.frictional:
        raise InvalidProblem("existence_margin: expected a problem with friction")
    near = near_one(problem)
    problem = problem if near is None else near.problem
    with problem._lock:
        way = condense(problem)
        return ContactForm(problem, way, condensed_frictional_rows(problem, way)).local
