"""Whether the outer forces of every body balance: what they do on its rigid motions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.linalg.extended import extend, images
from contactqp.linalg.extended_rows import extended_rows
from contactqp.linalg.factorization import RigidMotions
from contactqp.linalg.intrinsic_size import bodies
from contactqp.linalg.measures import outer_forces
from contactqp.model.arrays import Array, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.verdicts import Answer

# Resultants below this part of the forces are zero in double precision; which motion is worst is then not asked.
NO_RESULTANT = 1e-14
# A motion along which K's rounding makes up this part of the forces cannot be judged by them.
NOTHING_BUT_ROUNDING = 0.1
# What K's rounding makes of a rigid motion is forgiven up to this part of the forces: beyond, a resultant is wrong,
# whoever carries the rest.
FORGIVEN = 1e-6
# Combinations of motions on which the forces of a body do this part of the work of the others are one motion twice.
SAME_MOTION = 1e-10
# Forces that do this part of the work of the others on a motion act on it.
ACTING = 1e-6
# HiGHS ends without an answer where the first is beneath its rounding. The figure of the direction that is found is
# formed anew: a direction that is best to 1e-7 has one that is too small by 1e-7 of itself.
LP_TOLERANCES = (1e-10, 1e-7)


def balance(problem: ContactProblem, answer: Answer, rigid: RigidMotions) -> float:
    """The worst |z'r| / |z|'(|f| + |E|'|l| + |A|'|nu|) over all rigid motions z of the bodies.

    By duality it is the least part t of the outer forces by which each of them may be changed so that forces and
    moments of every body balance: a linear program with as many unknowns as one body has rigid motions, whose answer
    depends on no choice of basis, unit or scale.
    """
    if not rigid.count:
        return 0.0
    rows = extended_rows(problem)
    force, tie = extend(answer.normal_force), extend(answer.tie_force)
    outer = extend(problem.load) - rows.contact_force(force, tie) - rows.friction_force(answer.friction_force)
    # K z is zero but for the rounding of K; what that makes of the displacement is no lack of balance.
    stray = _left_of_stiffness(problem, rigid) @ abs(answer.displacement)
    size = outer_forces(problem, answer)
    body = bodies(problem)
    # A displacement so far out that its rounding hides the forces: bounds tell what it is worth, and with friction
    # there are none.
    hidden = 1.0 if problem.frictional else 0.0
    worst = 0.0
    for b in np.unique(body[np.any(rigid.motions != 0, axis=1)]):
        members = np.flatnonzero(body == b)
        moving = np.any(rigid.motions[members] != 0, axis=0)
        motions = rigid.motions[np.ix_(members, moving)]
        work = motions.T @ outer.double()[members]
        mixed = rigid.uncertainty * (abs(motions).T @ size[members])
        worst = max(worst, _worst_resultant(motions, work, stray[moving] + mixed, size[members], hidden))
    return worst


def _left_of_stiffness(problem: ContactProblem, rigid: RigidMotions) -> Array:
    """|K z| (r, n), formed once for the motions of a stiffness."""
    known = problem._shared.get("left_of_stiffness")
    if known is None or known[0] is not rigid:
        forces = rigid.forces
        if forces is None:
            forces = images(problem.stiffness_rows, rigid.motions)
        known = rigid, abs(forces.T)
        problem._shared["left_of_stiffness"] = known
    return np.asarray(known[1])


@dataclass(frozen=True, eq=False)
class Resultants:
    """What the forces of a body do on p coordinates of its motions.

    With w_j = z_j size_j the denominator is the sum of |w_j|, whatever the units of the unknowns: the coordinates are
    those of an orthonormal basis of the columns w.
    """

    weight: Array  # (p, r) the motions of each coordinate
    strength: Vector  # (p,) how much force acts along it, of the most
    work: Vector  # (p,) on each
    stray: Vector  # (p,) what K's rounding may make of that

    def unseen(self, forces: Vector, hidden: float) -> bool:
        """Whether rounding hides forces (p,), the sums of |w_j|, where that matters."""
        return bool(hidden and np.any(~self.seen(forces) & (self.strength > ACTING)))

    def seen(self, forces: Vector) -> NDArray[np.bool_]:
        """Where next to no force acts along a motion, what the rounding of K holds is all there is to see."""
        return np.asarray(self.stray < NOTHING_BUT_ROUNDING * forces)

    def worst(self, forces: Vector) -> float:
        """The figure of the worst coordinate."""
        seen = self.seen(forces)
        whole = abs(self.work)[seen] / forces[seen]
        net = np.maximum(abs(self.work) - self.stray, 0.0)[seen] / forces[seen]
        return float(np.max(np.where(whole > FORGIVEN, whole, net), initial=0.0))

    def net(self, direction: Vector) -> float:
        """What is left of the work on a motion (p,) in these coordinates."""
        return float(abs(self.work @ direction) - self.stray @ abs(direction))


def resultants(values: Vector, right: Array, work: Vector, stray: Vector) -> Resultants:
    """From the singular values and right vectors of w (n, r), and the work and its uncertainty (r,) on its motions."""
    kept = values > SAME_MOTION * values[0]
    weight = right[kept] / values[kept, None]
    return Resultants(weight, values[kept] / values[0], weight @ work, abs(weight) @ stray)


def _worst_resultant(motions: Array, work: Vector, stray: Vector, size: Vector, hidden: float) -> float:
    """max over coordinates a of (|work'a| - stray'|a|) / |motions a|'size; `hidden` where rounding hides what acts."""
    left, values, right = np.linalg.svd(motions * size[:, None], full_matrices=False)
    found = resultants(values, right, work, stray)
    basis = left[:, : len(found.work)]
    forces = np.sum(abs(basis), axis=0)
    if found.unseen(forces, hidden):
        return hidden
    seen, worst = found.seen(forces), found.worst(forces)
    if np.sum(seen) <= 1 or worst <= NO_RESULTANT:
        return worst
    direction = np.zeros(len(seen))
    direction[seen] = _worst_direction(basis[:, seen], found.work[seen] / np.max(abs(found.work[seen])))
    return max(found.net(direction) / float(np.sum(abs(basis @ direction))), worst)


def _worst_direction(basis: Array, weight: Vector) -> Vector:
    """argmax weight'a subject to sum |basis a| <= 1."""
    from scipy.optimize import linprog

    count, width = basis.shape
    unit, dense = sp.identity(count), sp.csr_matrix(basis)
    rows = sp.bmat([[dense, -unit], [-dense, -unit], [None, np.ones((1, count))]], format="csr")
    for tolerance in LP_TOLERANCES:
        answer = linprog(
            np.concatenate([-weight, np.zeros(count)]),
            A_ub=rows,
            b_ub=np.append(np.zeros(2 * count), 1.0),
            bounds=[(None, None)] * width + [(0, None)] * count,
            method="highs",
            options={"primal_feasibility_tolerance": tolerance, "dual_feasibility_tolerance": tolerance},
        )
        if answer.x is not None:
            return np.asarray(answer.x[:width])
    raise ArithmeticError(f"the balance of forces could not be judged: {answer.message}")
