"""What an answer violates: the worst contact or unknown, without dimension, in any units and any scale of rows.

With F_j = (|K||u| + |E_N|'|l_N| + |E_T|'|l_T| + |A|'|nu| + |f|)_j the size of the forces that meet at unknown j (of a
load that is known to be a sum, |f| is the sum of the sizes) and
L_i = (|E_N||u| + |g|)_i the size of the lengths that meet at contact i (`lengths_that_meet` says what it is where
both vanish), a force of contact i is measured as max_j |E_ij l_i| / F_j and a gap as its size over L_i; 0/0 is 0. In F
and L, u is the displacement without its rigid part. What is nothing beside the intrinsic size of problem and answer
(`contactqp.linalg.measures`) violates nothing.

`balance` is the work that the outer forces of every body do on its rigid motions.

Coulomb's law is judged in `contactqp.certificate.coulomb_law`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from operator import is_
from typing import Any, TypeVar

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.coulomb_law import (
    CoulombData,
    compliances,
    coulomb_data,
    friction_figures,
    hardly_felt,
    lengths_across,
    slips_that_are_nothing,
)
from contactqp.linalg.condensation import condense
from contactqp.linalg.dense import RigidMotions
from contactqp.linalg.extended import Residuals, extend, extended_rows, residuals
from contactqp.linalg.factorization import images
from contactqp.linalg.floating import that_move
from contactqp.linalg.influence import plain_residuals
from contactqp.linalg.measures import (
    ROUNDING_OF_LENGTH,
    beyond,
    bodies,
    force_measure,
    intrinsic_size,
    nothing,
    outer_forces,
    parts,
    ratio,
    row_sizes,
    scale_through_rows,
    untouched,
    without_rigid_part,
)
from contactqp.model.arrays import Array, Mask, Vector, all_finite
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import FIGURES, Answer, Certificate, Nothing, Violations

T = TypeVar("T")

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
# Forces that are larger than a load by this factor hide it: a tolerance of 1e-9 of them is a thousandth of the load.
HIDES = 1e6
# By this one they drown it: their rounding is a thousandth of the load.
DROWNS = 1e12
# What rounding leaves of forces that cancel, in doubles, is below 1e-9 of this part of them.
ROUNDING_OF_SUMS = 4e-6
# A load or an elastic force is notable from this part of the intrinsic size on.
NOTABLE = 1e-6


def balance(problem: ContactProblem, answer: Answer, rigid: RigidMotions, none: Vector | None = None) -> float:
    """Return the largest |z'r| / |z|'(|f| + |E|'|l| + |A|'|nu|) over all rigid motions z of the bodies.

    By duality it is the least part t of the outer forces by which each of them may be changed so that forces and
    moments of every body balance: a linear program with as many unknowns as one body has rigid motions, whose answer
    depends on no choice of basis, unit or scale.

    Parameters
    ----------
    problem : ContactProblem
    answer : Answer
    rigid : RigidMotions
        The null space of K.
    none : (n,) array, optional
        The forces up to which there is none at an unknown. Without load, forces that are no more need not balance.
    """
    if not rigid.count:
        return 0.0
    rows = extended_rows(problem)
    force, tie = extend(answer.normal_force), extend(answer.tie_force)
    outer = extend(problem.load) - rows.contact_force(force, tie) - rows.friction_force(answer.friction_force)
    # K z is zero but for the rounding of K; what that makes of the displacement is no lack of balance.
    stray = _left_of_stiffness(problem, rigid) @ abs(answer.displacement)
    size = outer_forces(problem, answer)
    if none is not None and not problem.load_size.any() and np.all(size <= none):
        return 0.0
    body, moved = bodies(problem), that_move(problem, rigid.motions)
    # A displacement so far out that its rounding hides the forces: bounds tell what it is worth, and with friction
    # there are none.
    hidden = 1.0 if problem.frictional else 0.0
    worst = 0.0
    for b in np.unique(body[np.any(rigid.motions != 0, axis=1)]):
        members = np.flatnonzero(body == b)
        moving = np.any(rigid.motions[members] != 0, axis=0)
        motions = moved[np.ix_(members, moving)]
        if not np.any(motions * size[members, None]):
            continue  # nothing acts where the body moves
        if none is not None and np.all(size[members] <= none[members]) and np.all(untouched(problem)[members]):
            continue  # the component of a load across what bears it, F sin(pi)
        work = motions.T @ outer.double()[members]
        mixed = rigid.uncertainty * (abs(motions).T @ size[members])
        worst = max(worst, _worst_resultant(motions, work, stray[moving] + mixed, size[members], hidden))
    return worst


def _left_of_stiffness(problem: ContactProblem, rigid: RigidMotions) -> Array:
    """Return |K z| (r, n) of the rigid motions, which is formed once for a stiffness."""
    cached = problem._computed.rounding_of_motions
    if cached is None or cached[0] is not rigid:
        forces = rigid.forces
        if forces is None:
            forces = images(problem.stiffness_rows, rigid.motions)
        cached = rigid, abs(forces.T)
        problem._computed.rounding_of_motions = cached
    return np.asarray(cached[1])


@dataclass(frozen=True, eq=False)
class Resultants:
    """The resultants of a body's forces on p coordinates of its rigid motions.

    With w_j = z_j size_j the denominator is the sum of |w_j|, whatever the units of the unknowns: the coordinates are
    those of an orthonormal basis of the columns w.
    """

    weight: Array  # (p, r) the motions of each coordinate
    strength: Vector  # (p,) how much force acts along it, of the most
    work: Vector  # (p,) on each
    stray: Vector  # (p,) what K's rounding may make of that

    def unseen(self, forces: Vector, hidden: float) -> bool:
        """Return whether the rounding of K hides a resultant that is notable; `forces` (p,) are the sums of |w_j|."""
        return bool(hidden and np.any(~self.seen(forces) & (self.strength > ACTING)))

    def seen(self, forces: Vector) -> Mask:
        """Return along which motions forces act by more than the rounding of K."""
        return np.asarray(self.stray < NOTHING_BUT_ROUNDING * forces)

    def worst(self, forces: Vector) -> float:
        """Return the figure of the worst coordinate."""
        seen = self.seen(forces)
        whole = abs(self.work)[seen] / forces[seen]
        net = np.maximum(abs(self.work) - self.stray, 0.0)[seen] / forces[seen]
        return float(np.max(np.where(whole > FORGIVEN, whole, net), initial=0.0))

    def net(self, direction: Vector) -> float:
        """Return the work on a motion (p,) in these coordinates, less its uncertainty."""
        return float(abs(self.work @ direction) - self.stray @ abs(direction))


def resultants(values: Vector, right: Array, work: Vector, stray: Vector) -> Resultants:
    """Form the resultants of residual forces along r rigid motions.

    Parameters
    ----------
    values : (r,) array, descending
        Singular values of w (n, r): the motions of each unknown, times the forces that meet there.
    right : (r, r) array, right singular vectors of w, a row each
    work : (r,) array, the work of the residual on each motion
    stray : (r,) array, how uncertain that work is
    """
    kept = values > SAME_MOTION * values[0]
    weight = right[kept] / values[kept, None]
    return Resultants(weight, values[kept] / values[0], weight @ work, abs(weight) @ stray)


def _worst_resultant(motions: Array, work: Vector, stray: Vector, size: Vector, hidden: float) -> float:
    """Return max over a of (|work'a| - stray'|a|) / |motions a|'size, or `hidden` where rounding hides the forces."""
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
    """Return the coordinates a that maximise weight'a subject to sum |basis a| <= 1."""
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


# Largest figure at which signs count as satisfied: tighter than the certificate's, as rounding may add to it.
HOLDS = 1e-10

# The part of the intrinsic size that is nothing, less than the certificate's for the same reason.
NOTHING = 1e-13


def violations(
    problem: ContactProblem,
    answer: Answer,
    residual: Residuals,
    rounding: float = ROUNDING_OF_LENGTH,
    rigid: RigidMotions | None = None,
) -> Violations:
    """Return every figure of an answer with these residuals.

    Parameters
    ----------
    problem : ContactProblem
    answer : Answer
    residual : those of the answer
    rounding : the fraction of the intrinsic size that counts as none
    rigid : the null space of K; none where no body floats
    """
    elastic, size, sizes, hardly = _kept(problem, answer, "sizes", partial(_sizes, problem, answer, rigid), rigid)
    none, F, coulomb = nothing(problem, answer, elastic, size, rounding), sizes.meeting, None
    least = none.force if none.contact_force is None else none.contact_force
    missed = residual.force.double(), residual.gap.double(), residual.tie.double()
    if hardly is not None:
        none = slips_that_are_nothing(none, hardly)
        coulomb = coulomb_data(problem, answer, F, none.force, hardly)
    felt = force_measure(problem.normal, answer.normal_force, F, least, row_sizes(problem, problem.normal))
    return figures(answer, missed, sizes, none, felt, coulomb)


def kept_residuals(problem: ContactProblem, answer: Answer) -> Residuals:
    """Return the residuals of an answer in extended precision; those of the last answer are kept."""
    return _kept(problem, answer, "residuals", partial(residuals, problem, answer))


def _kept(
    problem: ContactProblem, answer: Answer, name: str, make: Callable[[], T], rigid: RigidMotions | None = None
) -> T:
    """Return what was made last under a name if it was made of this very answer to this very problem; else make it.

    An answer that its method looks at before it is certified is measured once. Arrays of both cannot be changed.
    """
    given = (problem.load, problem.load_size, problem.gap, problem.tie_value, problem.slip_origin)
    given = (*given, *vars(answer).values(), rigid)
    cached = problem._computed.of_answer.get(name)
    if cached is None or not all(map(is_, cached[0], given)):
        cached = problem._computed.of_answer[name] = given, make()
    found: T = cached[1]
    return found


def _forces_that_count(problem: ContactProblem, acting: Vector, meeting: Vector, hidden: Mask, size: Vector) -> Vector:
    """Return the forces F (n,) by which residuals are measured where some of those that meet hide the load [force].

    Contacts and ties that depend on each other may exert forces on each other of any size, in which a load would be
    lost. Where all that meets is 1e6 times |f| + |K||u| and more, F is no more than what its rounding needs; where it
    is 1e12 times that, the rounding alone may exceed the load, and F is |f| + |K||u|. So it is everywhere that this is
    notable beside the intrinsic size, and in parts that have no size where every load of the part is hidden.

    Parameters
    ----------
    problem : ContactProblem
    acting, meeting : (n,) arrays, |f| + |K||u|, and the same with the forces of contacts and ties [force]
    hidden : (n,) array of bool, where the second hides the first
    size : (n,) array, the intrinsic size [square root of energy]
    """
    D, part = scale_through_rows(problem), parts(problem)
    shown = np.bincount(part, weights=(acting > 0) & ~hidden)[part] > 0
    counts = np.where((D > 0) & (size > 0), acting * D >= NOTABLE * size, ~shown)
    held = np.where(meeting > DROWNS * acting, acting, np.maximum(acting, ROUNDING_OF_SUMS * meeting))
    return np.where(hidden & counts, held, meeting)


def _sizes(
    problem: ContactProblem, answer: Answer, rigid: RigidMotions | None
) -> tuple[Vector, Vector, Sizes, Mask | None]:
    """Return what does not depend on which part of the size counts as none.

    The displacement without its rigid part and the intrinsic size S, both (n,), the sizes by which residuals are
    measured, and the contacts that are `hardly_felt` (m,), or None without tangential rows.
    """
    elastic, size, F = _meeting(problem, answer, rigid)
    normal, moved, tie_lengths = row_sizes(problem, problem.normal), abs(elastic), np.zeros(0)
    if problem.ties:
        tie_lengths = row_sizes(problem, problem.tie).lengths(moved) + abs(problem.tie_value)
    with_friction = problem.tangent is not None and problem.friction is not None
    sizes = Sizes(
        meeting=F,
        push=force_measure(problem.normal, answer.normal_force, F, sizes=normal),
        lengths=normal.lengths(moved) + abs(problem.gap),
        tangential_lengths=lengths_across(problem, elastic) if with_friction else np.zeros(problem.contacts),
        tie_lengths=tie_lengths,
        intrinsic_size=float(size.max(initial=0.0)),
    )
    return elastic, size, sizes, None if problem.tangent is None else hardly_felt(*compliances(problem))


def _meeting(problem: ContactProblem, answer: Answer, rigid: RigidMotions | None) -> tuple[Vector, Vector, Vector]:
    """Return the displacement without its rigid part, the intrinsic size S and the forces F that meet, all (n,)."""
    elastic = answer.displacement if rigid is None else without_rigid_part(problem, answer.displacement, rigid)
    size = intrinsic_size(problem, answer, elastic)
    inner = problem.stiffness_sizes @ abs(elastic)
    acting, F = problem.load_size + inner, inner + outer_forces(problem, answer)
    hidden = (acting > 0) & (HIDES * acting < F)
    return elastic, size, _forces_that_count(problem, acting, F, hidden, size) if hidden.any() else F


@dataclass(frozen=True, eq=False)
class Sizes:
    """The forces and lengths by which the residuals of an answer are measured."""

    meeting: Vector  # (n,) F [force]
    push: Vector  # (m,) |l_N| as a force
    lengths: Vector  # (m,) L of the normal rows
    tangential_lengths: Vector  # (m,) that of the tangential rows
    tie_lengths: Vector  # (k,) that of the ties
    intrinsic_size: float  # S [square root of energy]


def figures(
    answer: Any,
    missed: tuple[Vector, Vector, Vector],
    sizes: Sizes,
    none: Nothing,
    felt: Vector,
    coulomb: CoulombData | None,
) -> Violations:
    """Return every figure of an `Answer`, or of one rank's part of one.

    Parameters
    ----------
    answer : Answer
    missed : three arrays, (n,) [force], (m,) [length], (k,) [length]
        Its residuals of equilibrium, its gaps, and what its ties miss.
    sizes : Sizes
        The forces and lengths by which they are measured.
    none : Nothing
        Those that count as none.
    felt : (m,) array
        |l_N| as a force, 0 where it is nothing.
    coulomb : CoulombData or None
        What judges Coulomb's law; None without friction.
    """
    residual, gap, open_tie = missed
    if coulomb is None or answer.friction_force is None:
        cone = direction = slip_measure = turned = np.zeros(len(answer.normal_force))
    else:
        cone, direction, slip_measure, turned = friction_figures(answer, coulomb, sizes.tangential_lengths, none)
    gap_measure = ratio(beyond(abs(gap), none.normal), sizes.lengths)
    return Violations(
        equilibrium=ratio(beyond(abs(residual), none.force), sizes.meeting),
        residual=residual,
        penetration=np.where(gap < 0, gap_measure, 0.0),
        tension=np.where(answer.normal_force < 0, felt, 0.0),
        complementarity=np.where((gap > 0) & (answer.normal_force > 0), np.minimum(gap_measure, felt), 0.0),
        cone=cone,
        slip_direction=direction,
        tie=ratio(beyond(abs(open_tie), none.tie), sizes.tie_lengths),
        slip_measure=slip_measure,
        turned=turned,
        lengths=sizes.lengths,
        tangential_lengths=sizes.tangential_lengths,
        gap=gap,
        gap_measure=gap_measure,
        force_measure=sizes.push,
        meeting=sizes.meeting,
        intrinsic_size=sizes.intrinsic_size,
        nothing=none,
    )


def holds(problem: ContactProblem, answer: Answer) -> bool:
    """Return whether an answer satisfies equilibrium, contact and Coulomb's law by the certificate's measures.

    The rigid part of the displacement is left out, and what is nothing beside the intrinsic size is excused.
    """
    if not all_finite(answer):
        return False
    rigid = condense(problem).rigid
    found = violations(problem, answer, kept_residuals(problem, answer), NOTHING, rigid)
    if any(float(np.max(getattr(found, name), initial=0.0)) > HOLDS for name in FIGURES if name != "balance"):
        return False
    return balance(problem, answer, rigid, found.nothing.force) <= HOLDS


def holds_by_products(problem: ContactProblem, rigid: RigidMotions, answer: Answer, tolerance: float) -> bool:
    """Return `holds` but for the balance of a body that is not factorised, by products in double precision.

    Parameters
    ----------
    problem : ContactProblem
    rigid : the null space of K
    answer : Answer
    tolerance : largest figure that passes
    """
    found = violations(problem, answer, plain_residuals(problem, answer), NOTHING, rigid)
    return all(float(np.max(getattr(found, name), initial=0.0)) <= tolerance for name in FIGURES if name != "balance")


def contact_status(problem: ContactProblem, certificate: Certificate) -> Any:
    """Return (m,) of "open", "closed", "grazing" and, with friction, "stick" and "slip".

    A contact is closed where its force is not nothing and its gap, relative to the lengths that meet there, is at most
    its force relative to the forces that meet, or at most `tolerance`; and where it is penetrated and pushes back, as
    with a penalty. Other signs do not count: `tension` judges that of the force. A closed contact with friction slips
    where its slip is more than `tolerance` of the lengths that meet. It is grazing where gap and force are both at most
    `tolerance`, and the force is nothing beside the energy.
    """
    grazing = np.zeros(problem.contacts, dtype=bool)
    grazing[list(certificate.grazing)] = True
    return status_words(certificate, problem.friction, grazing)


def status_words(certificate: Certificate, friction: Vector | None, grazing: Mask) -> Any:
    """Return the words of `contact_status` for the contacts of a certificate's violations."""
    found = certificate.violations
    if found is None:
        return np.full(len(grazing), "unknown")
    near = found.gap_measure <= np.maximum(found.force_measure, certificate.tolerance)
    yields = (found.penetration > 0) & (found.tension == 0)
    pushes = (found.force_measure > 0) & (near | yields)
    status = np.where(pushes, "closed", "open").astype("<U8")
    if friction is not None:
        frictional = (friction > 0) & (status == "closed")
        status[frictional] = np.where(found.slip_measure[frictional] > certificate.tolerance, "slip", "stick")
    status[grazing] = "grazing"
    return status
