"""The answer that somebody's numbers are held against: exact where it is known, else a certified solution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer
from contactqp.oracle.foreign.right_answer import right_answer
from contactqp.oracle.gallery.problem import GalleryProblem


@dataclass(frozen=True, eq=False)
class Reference:
    """A right answer, and whether it is the only one."""

    problem: ContactProblem
    name: str
    displacement: Vector  # (n,)
    normal_force: Vector  # (m,)
    friction_force: NDArray[np.float64] | None  # (m, d-1)
    tie_force: Vector  # (k,)
    open: NDArray[np.bool_]  # (m,)
    slip: NDArray[np.float64]  # (m, d-1) zero where it sticks, (m, 0) without friction
    one_displacement: bool
    one_force: bool

    @property
    def length(self) -> float:
        """What displacements are relative to: the largest of them, or else of what they must reach; 0 if all vanish."""
        problem = self.problem
        origin = np.zeros(0) if problem.slip_origin is None else problem.slip_origin.ravel()
        moved = _largest(self.displacement)
        return moved if moved > 0 else max(_largest(problem.gap), _largest(origin), _largest(problem.tie_value))

    @property
    def force(self) -> float:
        """What forces are relative to: the largest that a contact or tie puts on an unknown, or else of the load."""
        parts = [weights(self.problem.normal) * abs(self.normal_force), weights(self.problem.tie) * abs(self.tie_force)]
        if self.friction_force is not None:
            parts.append(weights(self.problem.tangent) * abs(self.friction_force).ravel())
        return _largest(np.concatenate(parts)) or _largest(self.problem.load)

    @property
    def resultant(self) -> Vector:
        """E_N'l_N + E_T'l_T + A'nu (n,): what all forces do to the bodies together."""
        problem = self.problem
        total = problem.normal.T @ self.normal_force + problem.tie.T @ self.tie_force
        if problem.tangent is not None and self.friction_force is not None:
            total = total + problem.tangent.T @ self.friction_force.ravel()
        return np.asarray(total)


def weights(rows: Any) -> Vector:
    """max_j |E_ij| of every row: a multiplier times this is the largest force that it puts on an unknown."""
    return np.asarray(abs(rows).max(axis=1).toarray()).ravel() if rows.shape[0] else np.zeros(0)


def plain_problem(problem: ContactProblem | GalleryProblem) -> ContactProblem:
    """The contact problem itself."""
    return problem.problem if isinstance(problem, GalleryProblem) else problem


def name_of(problem: ContactProblem | GalleryProblem) -> str:
    return problem.name if isinstance(problem, GalleryProblem) else repr(problem)


def known_reference(known: GalleryProblem) -> Reference:
    """The exact answer of a gallery problem."""
    problem, exact = known.problem, known.exact
    return Reference(
        problem,
        known.name,
        known.displacement,
        known.normal_force,
        known.friction_force,
        known.tie_force,
        np.array([gap > 0 for gap in exact.gap], dtype=bool),
        np.array([[float(x) for x in row] for row in exact.slip]).reshape(problem.contacts, -1 if exact.slip else 0),
        known.unique_displacement,
        known.unique_forces,
    )


def solved_reference(problem: ContactProblem, answer: Answer) -> Reference:
    """A certified solution, of several the one nearest to an answer.

    Raises
    ------
    ContactQPError
        There is none, or none was found.
    """
    found = right_answer(problem, answer)
    sliding = found.contact_status == "slip"
    slip = np.zeros((problem.contacts, 0)) if found.slip is None else np.where(sliding[:, None], found.slip, 0.0)
    only = not found.certificate.uniqueness
    return Reference(
        problem,
        repr(problem),
        found.displacement,
        found.normal_force,
        found.friction_force,
        found.tie_force,
        found.contact_status == "open",
        slip,
        only,
        only if problem.frictional else found.certificate.force_bound is not None,
    )


def _largest(values: Vector) -> float:
    return float(np.max(abs(values), initial=0.0))
