"""How far the associated relaxation of friction is from Coulomb's answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Vector
from contactqp.model.floating_point import own_floating_point
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import ReadOnly
from contactqp.model.solution import Solution
from contactqp.solving.solve import solve


@dataclass(frozen=True, eq=False)
class AssociatedDifference(ReadOnly):
    """Both answers, and associated less Coulomb."""

    coulomb: Solution
    associated: Solution
    displacement: Vector  # (n,) [length]
    normal_force: Vector  # (m,) [force]
    friction_force: NDArray[np.float64]  # (m, d-1) [force]
    opening: Vector  # (m,) mu |s| where the relaxation slides under load: the gap that it opens [length]
    displacement_part: float  # |du|_K / |u|_K, absolute where Coulomb's answer has no energy
    force_part: float  # largest change of a contact force, of the largest contact force

    def __str__(self) -> str:
        return (
            f"the associated relaxation is off Coulomb's displacement by {self.displacement_part:.3g} in energy, off "
            f"its forces by {self.force_part:.3g}, and opens contacts that slide by up to "
            f"{np.max(self.opening, initial=0.0):.3g}"
        )


@own_floating_point
def associated_difference(
    problem: ContactProblem, coulomb: Solution | None = None, method: str = "active-set", **options: Any
) -> AssociatedDifference:
    """Solve Coulomb's law and its associated relaxation, min 1/2 u'Ku - f'u over E_N u + mu |E_T u - o| <= g, A u = b.

    Parameters
    ----------
    problem : ContactProblem
        With friction.
    coulomb : Solution, optional
        Coulomb's answer, where it is known; else `solve(problem, method)`.
    method : str
        The exact method of both convex problems.
    **options
        Of `solve`.

    Raises
    ------
    InvalidProblem
        There is no friction, or `coulomb` is of another problem.
    NoEquilibrium, NotConverged, NotCertified, BackendFailed, Unsupported
        As `solve`.

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
    right = solve(problem, method, **options) if coulomb is None else coulomb
    other = solve(problem, method, algorithm="associated", **options)
    moved = other.displacement - right.displacement
    energy, own = (_energy_norm(problem, v) for v in (moved, right.displacement))
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


def _friction(solution: Solution) -> NDArray[np.float64]:
    return np.zeros((len(solution.normal_force), 1)) if solution.friction_force is None else solution.friction_force
