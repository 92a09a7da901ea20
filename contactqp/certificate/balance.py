"""Measure the balance of floating bodies, and the effect of rounding of K along rigid motions.

`balance` is the work of the outer forces of every body on its rigid motions, relative to that of their sizes. By
rounding of K a rigid motion causes forces and strain, for which the norms of displacements and forces allow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.figures import (
    FEW_DIGITS,
    RIGID_ROUNDING,
    energy_norm,
    energy_norms,
    force_norm,
    response,
    rigid_rounding,
    without_part_along,
)
from contactqp.linalg.condensation import Condensation, free_motions
from contactqp.linalg.dense import RigidMotions, SaddlePoint, orthonormal
from contactqp.linalg.extended import Extended, extend, extended_rows
from contactqp.linalg.factorization import RIGID_ENERGY, images
from contactqp.linalg.floating import DEPENDENT_IN_ENERGY, RESISTED, motions_as_stated, without_rounded_motion
from contactqp.linalg.least_norm import WITHIN_ROUNDING, shift_to_least_norm
from contactqp.linalg.measures import (
    bodies,
    driven_parts,
    given_on,
    outer_forces,
    parts,
    row_sizes,
    scale_through_rows,
    untouched,
)
from contactqp.linalg.refinement import OnSet
from contactqp.model.arrays import EPS, Array, Indices, Mask, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import BY_DISPLACEMENT, BY_ENERGY, Answer

# The number of roundings of the energy's terms in its bounds.
FORMED = 8
# The largest contact forces by rounding of K, in multiples of one sample.
PUSHED_BY_ROUNDING = 8.0
# Advice if rounding of K causes forces of rigid motions, which redundant contacts share arbitrarily.
STATE_MOTIONS = ", by the rounding of K along rigid motions: give the motions as near_null_space, which are exact"
# The message where that resistance matters; the forces it makes are a part of all forces along the motions.
UNTOLD_RESISTANCE = (
    "the stiffness resists motions of the bodies by no more than the rounding of its entries, and whether it is "
    "rounding decides {:.2g} of the forces: state the motions as near_null_space if bodies float, or an array of "
    "shape (n, 0) if none does, and the stiffness is taken as it stands"
)
# Resultants below this part of the forces are zero in double precision, and the worst motion is not searched.
NO_RESULTANT = 1e-14
# If forces by rounding of K exceed this part of all forces along a motion, its balance cannot be judged.
NOTHING_BUT_ROUNDING = 0.1
# Forces by rounding of K are subtracted from a resultant up to this part of the forces.
FORGIVEN = 1e-6
# Combinations of motions on which the work is below this part of that on others are dependent.
SAME_MOTION = 1e-10
# Forces act on a motion if their work exceeds this part of that of the others.
ACTING = 1e-6
# The tolerance of HiGHS, which must be above its rounding. The figure is recomputed for the direction found; a relative
# error of 1e-7 makes it too small by 1e-7.
LP_TOLERANCES = (1e-10, 1e-7)
# The number of closed contacts and ties up to which their dependence is examined by dense matrices.
MOST_SHARING = 1000
# Forces are equal if they differ by less than this part, a thousandth of their error tolerance.
SHARED_ALIKE = 1e-9
# The largest rounding in extended precision relative to the strain by loads and gaps.
HIDDEN = 1e-6
# A force below this part of others in its part of the problem is zero also in extended precision.
NO_FORCE = 2.0**-90


def rounded_within_parts(problem: ContactProblem, meeting: Vector) -> Vector:
    """Return the rounding in extended precision of forces (n,) from elsewhere in each part [force].

    A tie may connect an unknown without stiffness to a loaded one without a force. In a part without stiffness forces
    are compared by their effect on rows. Where nothing acts, as along a bent beam, they are rounding of other parts.
    """
    D, part = scale_through_rows(problem), parts(problem)
    most = np.zeros(int(part.max(initial=-1)) + 1)
    if (bare := np.bincount(part, weights=D, minlength=len(most)) == 0).any():
        np.maximum.at(most, part, meeting)
        D = given_on(problem, np.where(bare[part] & (meeting == most[part]) & (meeting > 0), 1.0, D))
        most[:] = 0.0
    np.maximum.at(most, part, D * meeting)
    most[~driven_parts(problem, part)] = most.max(initial=0.0)
    return np.divide(NO_FORCE * most[part], D, out=np.zeros_like(D), where=D > 0)


def work_that_meets(problem: ContactProblem, answer: Answer) -> float:
    """Return |f|'|u| + |l|'(|E||u| + |g|) + |nu|'(|A||u| + |b|), the work whose rounding an answer in doubles has."""
    moved = abs(answer.displacement)
    lengths = row_sizes(problem, problem.normal).lengths(moved) + abs(problem.gap)
    tied = row_sizes(problem, problem.tie).lengths(moved) + abs(problem.tie_value)
    pushing = answer.normal_force != 0  # other gaps may be infinite
    contacts = abs(answer.normal_force[pushing]) @ lengths[pushing]
    return float(abs(problem.load) @ moved + contacts + abs(answer.tie_force) @ tied)


def rounded_outward(problem: ContactProblem, answer: Answer, energy_bounds: tuple[float, float]) -> tuple[float, float]:
    """Return bounds of the least energy, wider by the rounding of the numbers that formed them [force * length].

    These are a few roundings of the energy's terms. The upper one also includes the energy of the answer as doubles
    form it, which rounds sums of n products. The verdict takes the bounds before this.
    """
    (lower, upper), moved = energy_bounds, abs(answer.displacement)
    with np.errstate(over="ignore", invalid="ignore"):
        terms = 0.5 * float(moved @ (problem.stiffness_sizes @ moved)) + float(problem.load_size @ moved)
        formed = max(problem.energy(answer.displacement), upper)
    rounding = FORMED * EPS * max(terms, abs(lower), abs(upper))
    if not np.isfinite([rounding, formed]).all():
        return lower, upper
    return float(np.nextafter(lower - rounding, -np.inf)), float(np.nextafter(formed + rounding, np.inf))


def imposed_work(problem: ContactProblem, answer: Answer) -> float:
    """Return |l|'|g| + |nu|'|b|, the work of forces on imposed lengths, which no free motion changes."""
    pushing = answer.normal_force != 0  # other gaps may be infinite
    contacts = abs(answer.normal_force[pushing]) @ abs(problem.gap[pushing])
    return float(contacts + abs(answer.tie_force) @ abs(problem.tie_value))


def parts_of_bare_forces(problem: ContactProblem, bound: Vector, push: Vector) -> Vector:
    """Return bounds (m,) over the largest force for contacts at unknowns without stiffness, 0 for others.

    Forces are compared in the largest scale that rows give these unknowns, as their own compliance does not see them.
    """
    bare = problem.diagonal == 0
    scale = given_on(problem, np.where(bare, 0.0, problem.own_scale), np.maximum)
    felt = np.sqrt(problem.normal.power(2) @ scale**2)
    largest = float(np.max(felt * abs(push), initial=0.0))
    seen = (abs(problem.normal) @ bare.astype(float) > 0) & (largest > 0)
    return np.where(seen, bound * felt / (largest or 1.0), 0.0)


def strain_of_rigid_part(problem: ContactProblem, condensation: Condensation, displacement: Vector) -> float:
    """Return the energy norm of the rigid part of a displacement, which is rounding of K."""
    forces = resisting_forces(problem, condensation, displacement)
    elastic, missing = response(problem, condensation, extend(forces), tied=False)
    return sum(energy_norm(problem, elastic)) + missing


def strain_of(
    problem: ContactProblem,
    solution: Extended,
    condensation: Condensation,
    forces: tuple[Extended, Extended] | None,
) -> tuple[float, float]:
    """Return |u*|_K of the solution, or of the nearest known displacement, and its uncertainty if bodies float.

    If a rigid motion hides the strain even in extended precision, the response to all forces is used, which has no
    rigid part.

    Parameters
    ----------
    problem, condensation : ContactProblem, and its Condensation
    solution : Extended (n,), the displacement
    forces : Extended (m,) and Extended (k,), or None, those of contacts and ties, if they are known
    """
    norm, uncertain = energy_norm(problem, solution)
    if forces is None or uncertain <= FEW_DIGITS * norm:
        return energy_norms(problem, condensation, solution, (norm, uncertain))[0], uncertain
    load = extend(problem.load) - extended_rows(problem).contact_force(*forces)
    elastic, missing = response(problem, condensation, load, tied=False)
    strain, rounding = energy_norm(problem, elastic)
    return (strain, rounding + missing) if rounding + missing < uncertain else (norm, uncertain)


def free_distance(
    problem: ContactProblem, condensation: Condensation, saddle: SaddlePoint, apart: Extended, energy_scale: float
) -> float:
    """Return the energy norm of a distance along free motions, which is rounding of K.

    Along all rigid motions where the solution is not strained: ties and contacts may ask for one without any force.

    Parameters
    ----------
    problem, condensation : ContactProblem, and its Condensation
    saddle : the factorised system of the closed contacts, which leaves the motions free
    apart : Extended (n,), the distance
    energy_scale : |u*|_K of the solution
    """
    motions = free_motions(condensation, saddle) if energy_scale > 0 else orthonormal(condensation.rigid.motions)
    if not motions.shape[1]:
        return 0.0
    resisted, _ = energy_norm(problem, without_part_along(motions, apart))
    distance = sum(energy_norm(problem, apart))
    if FEW_DIGITS**2 * energy_scale < resisted:  # motions in doubles leave a rounding of the whole distance
        forces = extended_rows(problem).stiffness @ apart
        elastic, missing = response(problem, condensation, forces, tied=False)
        resisted = min(resisted, sum(energy_norm(problem, elastic)) + missing)
    size = abs(motions @ (motions.T @ apart.double()))
    # It is limited by the energy of a rigid motion by rounding of K (`is_rigid`).
    most = float(np.sqrt(RIGID_ENERGY * (size @ (problem.stiffness_sizes @ size))))
    return min(max(distance - resisted, 0.0), most)


def determined_by(problem: ContactProblem, answer: Answer, condensation: Condensation) -> str:
    """Return BY_ENERGY if a motion is free: neither K nor ties nor the contacts with a force resist it."""
    push = row_sizes(problem, problem.normal).measure(answer.normal_force, outer_forces(problem, answer))
    _, free = shift_to_least_norm(problem, condensation, answer, np.flatnonzero(push > RESISTED))
    return BY_ENERGY if free.shape[1] else BY_DISPLACEMENT


def hides_strain(problem: ContactProblem, displacement: Vector, rigid: RigidMotions, size: float, left: float) -> bool:
    """Return whether the rounding of a displacement along rigid motions hides the strain by loads and gaps.

    Without friction it is the rounding of residuals in extended precision, at most 1e-6 of the strain. With friction,
    where an answer is compared with that of its own states, it is the rounding of a displacement in doubles.

    Parameters
    ----------
    problem, displacement : ContactProblem, (n,) array [length]
    rigid : the rigid motions of the bodies
    size, left : what loads and gaps strain, and what residuals hide without friction [square root of energy]
    """
    doubles = rigid_rounding(problem, rigid.count > 0, displacement) * (EPS / RIGID_ROUNDING)
    return 0 < size < (doubles if problem.frictional else left / HIDDEN)


def shared_by_rounding(
    problem: ContactProblem,
    condensation: Condensation,
    saddle: SaddlePoint,
    displacement: Vector,
    cleared: float,
    push: Vector,
) -> tuple[Vector, float, bool]:
    """Return bounds (m,) of the contact forces by rounding of K along rigid motions, their energy norm, and their
    validity.

    On the closed contacts they balance K z of the rigid part z of a displacement. Stated motions are exact and make
    none if K was cleared of them. Beyond `RESISTED` other motions may have a real resistance, and nothing is proven; if
    they are rigid, these forces have no resultant and do not affect statically determined forces.

    Parameters
    ----------
    problem, condensation : ContactProblem, and its Condensation
    saddle : the factorised system of the closed contacts
    displacement : (n,) array [length], whose rigid part makes the forces
    cleared : the part of all forces that K was cleared of
    push : (m,) array, the contact forces; without them, or imposed lengths, and without a load nothing has forces
    """
    forces = resisting_forces(problem, condensation, displacement, cleared)
    if not forces.any():
        return np.zeros(problem.contacts), 0.0, True
    imposed = problem.gap[saddle.closed].any() or problem.tie_value.any()  # without it, forces are noise
    acts, motions = bool(problem.load.any() or (push.any() and imposed)), condensation.rigid.motions
    unsure = cleared > RESISTED and acts
    if unsure:
        spread = problem.diagonal[:, None] * motions
        forces = forces - spread @ np.linalg.lstsq(motions.T @ spread, motions.T @ forces, rcond=None)[0]
    pushed, closed = np.zeros(problem.contacts), saddle.closed
    _, share, _ = condensation.correction(saddle, forces, np.zeros(len(closed)), np.zeros(problem.ties))
    pushed[closed] = PUSHED_BY_ROUNDING * share
    return abs(pushed), sum(force_norm(problem, condensation, extend(pushed), tied=True)), not unsure


def resisting_forces(
    problem: ContactProblem, condensation: Condensation, displacement: Vector, cleared: float = 0.0
) -> Vector:
    """Return K z (n,) of the rigid part z of a displacement, due to rounding of K if no resistance is hidden in it.

    Parameters
    ----------
    problem, condensation : ContactProblem, and its Condensation
    displacement : (n,) array [length]
    cleared : the part of all forces that K was cleared of, after which motions that are stated make none
    """
    K, motions = extended_rows(problem).stiffness, condensation.rigid.motions
    of = ~motions_as_stated(problem, motions)[1] if cleared else np.ones(motions.shape[1], dtype=bool)
    if not of.any():
        return np.zeros(problem.dimension)
    forces = np.column_stack([(K @ extend(z)).double() for z in motions.T[of]])
    return np.asarray(forces @ condensation.rigid.coordinates(displacement, problem.diagonal)[of])


def balance(problem: ContactProblem, answer: Answer, rigid: RigidMotions, negligible: Vector | None = None) -> float:
    """Return the largest |z'r| / |z|'(|f| + |E|'|l| + |A|'|nu|) over all rigid motions z of the bodies.

    By duality it is the least relative change t of each outer force after which forces and moments of every body
    balance, a linear program with as many unknowns as one body has rigid motions. It is independent of basis, units and
    scales.

    Parameters
    ----------
    problem : ContactProblem
    answer : Answer
    rigid : RigidMotions
        The null space of K.
    negligible : (n,) array, optional
        The force up to which there is none at each unknown. On a body without load such forces need not balance.
    """
    if not rigid.count:
        return 0.0
    rows = extended_rows(problem)
    force, tie = extend(answer.normal_force), extend(answer.tie_force)
    outer = extend(problem.load) - rows.contact_force(force, tie) - rows.friction_force(answer.friction_force)
    # K z is zero up to rounding of K, whose effect is not a lack of balance.
    stray = _left_of_stiffness(problem, rigid) @ abs(answer.displacement)
    size = outer_forces(problem, answer)
    if negligible is not None and not problem.load_size.any() and np.all(size <= negligible):
        return 0.0
    body, moved = bodies(problem), without_rounded_motion(problem, rigid.motions)
    # If rounding of a large displacement hides the forces, bounds decide, which do not exist with friction.
    hidden = 1.0 if problem.frictional else 0.0
    worst = 0.0
    for b in np.unique(body[np.any(rigid.motions != 0, axis=1)]):
        members = np.flatnonzero(body == b)
        moving = np.any(rigid.motions[members] != 0, axis=0)
        motions = moved[np.ix_(members, moving)]
        if not np.any(motions * size[members, None]):
            continue  # no force acts on the moving unknowns
        idle = not problem.load_size[members].any() or np.all(untouched(problem)[members])
        if idle and negligible is not None and np.all(size[members] <= negligible[members]):
            continue  # rounding by a tie, or of a load component such as F sin(pi)
        work = motions.T @ outer.double()[members]
        mixed = rigid.uncertainty * (abs(motions).T @ size[members])
        worst = max(worst, _worst_resultant(motions, work, stray[moving] + mixed, size[members], hidden))
    return worst


def _left_of_stiffness(problem: ContactProblem, rigid: RigidMotions) -> Array:
    """Return |K z| (r, n) of the rigid motions, formed once for a stiffness."""
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
    strength: Vector  # (p,) force along each coordinate, relative to the largest
    work: Vector  # (p,) on each
    stray: Vector  # (p,) its possible rounding by K

    def unseen(self, forces: Vector, hidden: float) -> bool:
        """Return whether the rounding of K hides a notable resultant; `forces` (p,) are the sums of |w_j|."""
        return bool(hidden and np.any(~self.seen(forces) & (self.strength > ACTING)))

    def seen(self, forces: Vector) -> Mask:
        """Return along which motions forces exceed the rounding of K."""
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
    """Return max over a of (|work'a| - stray'|a|) / |motions a|'size, or `hidden` if rounding hides the forces."""
    pushed = size > 0  # nothing else enters the sums
    left, values, right = np.linalg.svd((motions * size[:, None])[pushed], full_matrices=False)
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


def nearest_to(answer: Answer, condensation: Condensation, on_set: OnSet, radius: float) -> tuple[Extended, Extended]:
    """Return the forces of contacts (m,) and ties (k,) of the solution that are nearest to an answer's.

    Dependent closed contacts and ties admit many forces without tension with the same R'y, R their unit rows in units
    in which S has a unit diagonal, and y their forces over the weights of the rows. The known forces are returned if
    others differ by less than `SHARED_ALIKE`, if no rows are dependent, or if there are too many rows.

    Parameters
    ----------
    answer : the answer that is judged
    condensation : that of its problem
    on_set : the solution, up to `radius`
    radius : float [square root of energy]
    """
    forces, m = (on_set.normal_force, on_set.tie_force), len(answer.normal_force)
    compliance = condensation.delassus.compliance
    untold = np.maximum(WITHIN_ROUNDING * on_set.lengths, radius * np.sqrt(compliance[:m]))
    touching = np.flatnonzero(on_set.gaps <= untold)
    count = len(touching)
    if count + len(answer.tie_force) > MOST_SHARING:
        return forces
    rows = np.vstack([condensation.normal[touching], condensation.tie]) * condensation.scale
    length = np.linalg.norm(rows, axis=1)
    weight = 1.0 / np.where(length > 0, length, 1.0)
    rows = (rows * weight[:, None]).T
    apart = extend(answer.normal_force) - forces[0], extend(answer.tie_force) - forces[1]
    difference = np.concatenate([apart[0].double()[touching], apart[1].double()]) / weight
    size = np.concatenate([forces[0].double()[touching], forces[1].double()]) / weight
    least = np.where(np.arange(len(size)) < count, -np.maximum(size, 0.0), -np.inf)
    shared = _shared_alike(rows, difference, least)
    # Forces do work on the rounding of gaps, which is added to the bound of the displacement.
    if np.linalg.norm(shared) <= SHARED_ALIKE * np.linalg.norm(size):
        return forces
    change = shared * weight
    return forces[0].added_at(touching, change[:count]), forces[1] + change[count:]


def _shared_alike(rows: Array, wanted: Vector, least: Vector) -> Vector:
    """Return forces y (q,) >= least near `wanted` with R y = 0, where R (p, q) has unit columns.

    Forces below the least are fixed at it, one set after the other; if the others cannot balance them, the step to the
    nearest forces of any sign ends where the first one reaches the least.
    """
    held, first = np.zeros(len(wanted), dtype=bool), np.zeros(len(wanted))
    dependent = DEPENDENT_IN_ENERGY * max(rows.shape)
    for turn in range(len(wanted)):
        forces, free = np.where(held, least, wanted), ~held
        left, _, rank, _ = np.linalg.lstsq(rows[:, free], rows @ forces, rcond=dependent)
        if turn == 0 and rank == len(wanted):
            return first
        forces[free] -= left
        first = first if turn else forces
        if np.linalg.norm(rows @ forces) > dependent * np.linalg.norm(forces):
            break
        if not (less := free & (forces < least)).any():
            return forces
        held |= less
    less = first < least
    return first * float(np.min(least[less] / first[less], initial=1.0))


def rows_on_motions(problem: ContactProblem, condensation: Condensation, active: Indices) -> tuple[Array, Vector]:
    """Return the displacements of active contacts and all ties by rigid motions, (q + k, r), and the weights of these
    rows.

    Each row is multiplied by its weight 1/sqrt(W_ii), so that forces over their weights are roots of energy.
    """
    Z = condensation.rigid.motions
    weight = 1.0 / np.sqrt(condensation.delassus.compliance)
    weight = np.concatenate([weight[active], weight[problem.contacts :]])
    return np.vstack([problem.normal[active] @ Z, problem.tie @ Z]) * weight[:, None], weight
