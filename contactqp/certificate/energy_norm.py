"""Norms of displacements and of contact forces in the square root of energy, and the rounding that they cannot avoid.

    |v|_K^2 = v'Kv,    |d|_W^2 = the energy of the bodies' response to contact forces d

Differences come in as extended-precision vectors, so their norms mean something far beneath 1e-16 of the displacement.
"""

from __future__ import annotations

import numpy as np

from contactqp.linalg.condensation import Condensation, free_motions
from contactqp.linalg.dense import REGULAR, RigidMotions, SaddlePoint, orthonormal, saddle_point
from contactqp.linalg.extended import EPS, Extended, extend, extended_rows
from contactqp.linalg.factorization import RIGID_ENERGY, RIGID_FORCE
from contactqp.linalg.measures import forces_that_meet, rigid_part, row_sizes
from contactqp.linalg.refinement import CAUTION, LEAST_CONTRACTION
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer

# Refinement that contracts less than this proves nothing.
CONTRACTION = 0.5
# Pivots flatter the condition of a matrix: the rounding of W was up to 1e2 times what they say over the families of
# `benchmarks/silently_wrong.py`.
PIVOTS_FLATTER = 1e3
# A norm that double precision knows to this part is known well enough for a bound.
FEW_DIGITS = 1e-4
# Rounding of a double, and of v'Kv in extended precision, in units of EPS |v|'|K||v|.
ROUNDING, PRODUCT = float(np.finfo(float).eps), 16
# Sweeps of refinement that a response may take, and the part of it that need not be known: good ones need two.
SWEEPS, ENOUGH = 8, 1e-9
# A displacement's strain that is this part of what its unknowns, each alone, would cost is the rounding of a rigid
# motion; so is a contact force's whose energy norm is this part of its size.
RIGID_ROUNDING = 64 * np.finfo(float).eps
# Units 1/sqrt(K_jj) of unknowns that differ by no more than this are alike.
UNITS_ALIKE = 1e3
# Rounding of K makes so many times the contact forces that one sample of it does, at most.
PUSHED_BY_ROUNDING = 8.0


def energy_norm(problem: ContactProblem, displacement: Extended) -> tuple[float, float]:
    """Return |v|_K [square root of energy] and a bound on its error: even extended precision rounds a large rigid
    motion.

    In double precision, unless that rounds away more than a few digits.
    """
    v = displacement.double()
    u = abs(v)
    square = float(v @ (problem.stiffness @ v))
    size = float(u @ (problem.stiffness_sizes @ u))
    terms = problem.dimension + 2  # of the longest sum
    rounding = terms * ROUNDING * size
    if rounding > FEW_DIGITS * square:
        square = max(float(displacement.dot(extended_rows(problem).stiffness @ displacement)), 0.0)
        rounding = float(PRODUCT * EPS * size)
    norm = float(np.sqrt(square))
    return norm, min(float(np.sqrt(rounding)), rounding / norm) if norm > 0 else float(np.sqrt(rounding))


def energy_norms(
    problem: ContactProblem,
    condensation: Condensation,
    displacement: Extended,
    counted: tuple[float, float] | None = None,
) -> tuple[float, float]:
    """Return the least and the most that |v|_K may be, K's rounding along rigid motions being counted or not.

    That rounding makes K z of a rigid motion z a force of either sign: where v is nearly rigid, v'Kv may be more or
    less than the energy of its strain, which is that of v without its rigid part.

    Parameters
    ----------
    problem : ContactProblem
    condensation : that of the problem, with its rigid motions
    displacement : Extended (n,), v
    counted : two floats, optional
        `energy_norm` of v, where it has been formed already.
    """
    norm, uncertain = counted or energy_norm(problem, displacement)
    if not condensation.rigid.count:
        return norm, norm + uncertain
    motions = condensation.rigid.motions
    moved = motions @ rigid_part(problem, displacement.double(), condensation.rigid)
    strained, beyond = energy_norm(problem, displacement - moved)
    return min(norm, strained), max(norm + uncertain, strained + beyond)


def force_norm(
    problem: ContactProblem,
    condensation: Condensation,
    force: Extended,
    tied: bool = True,
    tie_force: Extended | None = None,
) -> tuple[float, float]:
    """Return |d|_W of contact forces d on the tied (or untied) bodies, and a bound on its error.

    Parameters
    ----------
    problem : ContactProblem
    condensation : that of the problem
    force : Extended (m,), d, of any sign
    tied : whether the ties hold
    tie_force : Extended (k,), optional
        Forces of ties that act beside d, on untied bodies; none by default.
    """
    d = force.double()
    if not (d.any() or (tie_force is not None and tie_force.double().any())):
        return 0.0, 0.0
    if (tied is False or not problem.ties) and not condensation.rigid.count and tie_force is None:
        operator = condensation.delassus
        if operator.smallest_pivot >= REGULAR:
            square, size = operator.squared_norm(d)
            rounding = PIVOTS_FLATTER * condensation.lost_digits / operator.smallest_pivot * size
            if rounding <= FEW_DIGITS * square and square > 0:  # squares of very small forces are zero
                return float(np.sqrt(square)), float(rounding / np.sqrt(square))
    held = extend(np.zeros(problem.ties)) if tie_force is None else tie_force
    load = extended_rows(problem).contact_force(force, held)
    u, error = response(problem, condensation, load, tied)
    norm, rounding = energy_norm(problem, u)
    return norm, error + rounding


def response(problem: ContactProblem, condensation: Condensation, load: Extended, tied: bool) -> tuple[Extended, float]:
    """Return the displacement u under a load with all contacts open, and a bound on its error in the energy norm.

    K u + A'eta = P load and A u = 0 where tied, K u = P load where not; P leaves the part of the load out that drives
    motions which nothing resists.

    Parameters
    ----------
    problem : ContactProblem
    condensation : that of the problem
    load : Extended (n,)
    tied : whether the ties hold, at the value zero
    """
    rows = extended_rows(problem)
    saddle = saddle_point(condensation, np.zeros(0, dtype=np.intp), tied)
    motions = _free_motions(problem, condensation, saddle, tied)
    left = _left_along(problem, condensation, motions, load, tied)
    load = without_part_along(motions, load)
    u, eta, no_contact = (extend(np.zeros(size)) for size in (problem.dimension, problem.ties, problem.contacts))
    none = np.zeros(0)

    def step(residual: Extended) -> tuple[Vector, Vector, float]:
        du, _, dn = condensation.correction(saddle, residual.double(), none, -(rows.tie @ u).double() if tied else none)
        return du, dn if tied else np.zeros(problem.ties), energy_norm(problem, extend(du))[0]

    du, dn, first = step(load)
    u, eta = u + du, eta + dn
    foreseen = (saddle.contraction or 1.0) * CAUTION
    if foreseen <= ENOUGH or not first:  # another load has shown what the next sweep leaves to do
        return u, 2 * foreseen * first + left
    # As a rule the next sweep shows that nothing is left to do, and residuals in double precision can tell.
    held = problem.stiffness_rows @ u.double() + problem.tie.T @ eta.double()
    du, _, size = step(extend(load.double() - held))
    if size <= ENOUGH * first:
        saddle.contraction = max(saddle.contraction or 0.0, size / first, LEAST_CONTRACTION)
        return u + du, 2 * size + left
    last = first
    for _ in range(SWEEPS):
        du, dn, size = step(load - rows.stiffness @ u - rows.contact_force(no_contact, eta))
        u, eta = u + du, eta + dn
        if size <= ENOUGH * first or size > CONTRACTION * last:
            break
        last = size
    return u, 2 * size + left


def _free_motions(problem: ContactProblem, condensation: Condensation, saddle: SaddlePoint, tied: bool) -> Vector:
    """Return the motions (n, q) that nothing resists, known to a few eps at every unknown.

    Orthonormal ones are so in units of the unknowns that are alike. In others what has cancelled at an unknown is a
    rounding of the largest entry in units of 1/sqrt(K_jj); one correction by K z in extended precision removes that.
    """
    motions, scale = free_motions(condensation, saddle), problem.own_scale
    if not motions.shape[1] or scale.max() <= UNITS_ALIKE * scale.min():
        return motions
    if saddle.corrected_motions is None:
        rows, corrected, none = extended_rows(problem), motions.copy(), np.zeros(0)
        for z in corrected.T:
            held = (rows.stiffness @ extend(z)).double()
            open_tie = -(rows.tie @ extend(z)).double() if tied else none
            z += condensation.correction(saddle, -held, none, open_tie)[0]
        saddle.corrected_motions = orthonormal(corrected)
    return saddle.corrected_motions


def _left_along(
    problem: ContactProblem, condensation: Condensation, motions: Vector, load: Extended, tied: bool
) -> float:
    """Bound the response, in the energy norm, to what rounding leaves of a load that motions (n, q) or ties take.

    Orthonormal motions Z are known to a few eps, or to what ties resist of them, and so are Z Z'f, which is taken away
    of a load f, and what ties take of it: of the response at most so many |D (|f| + |Z||Z|'|f|)| / sqrt(e) is left,
    with D = 1/sqrt(K_jj) and e the least energy of a motion that has strain.
    """
    held = tied and problem.ties > 0
    if not (motions.shape[1] or held):
        return 0.0
    size = abs(load.double())
    taken = size + abs(motions) @ (abs(motions).T @ size)
    norm = float(np.linalg.norm(problem.own_scale * taken))
    accuracy = max(RIGID_ROUNDING, _resisted(problem, motions)) if held else RIGID_ROUNDING
    return float(accuracy * norm / np.sqrt(condensation.rigid.softest))


def _resisted(problem: ContactProblem, motions: Vector) -> float:
    """Return how much ties resist motions (n, q), relative to the terms that should cancel."""
    most = abs(problem.tie).sum(axis=1)[:, None] * np.max(abs(motions), axis=0, initial=0.0)
    return float(np.max(abs(problem.tie @ motions) / np.where(most > 0, most, 1.0), initial=0.0))


def without_part_along(motions: Vector, vector: Extended) -> Extended:
    """Return a vector less its part along orthonormal motions (n, q)."""
    if not motions.shape[1]:
        return vector
    return vector - motions @ (motions.T @ vector.double())


def residual_noise(problem: ContactProblem, answer: Answer) -> float:
    """Bound what the rounding d of a residual, |d_j| <= EPS F_j, may hide: |D d| / sqrt(least eigenvalue of DKD)."""
    scale = problem.own_scale
    return float(EPS / np.sqrt(RIGID_FORCE) * np.linalg.norm(scale * forces_that_meet(problem, answer)))


def rigid_rounding(problem: ContactProblem, rigid: RigidMotions, displacement: Vector) -> float:
    """Return the energy norm of the rounding of a rigid displacement; zero where nothing floats."""
    if not rigid.count:
        return 0.0
    size = abs(displacement)
    return float(RIGID_ROUNDING * np.sqrt(size @ (problem.stiffness_sizes @ size)))


def strain_of_rigid_part(problem: ContactProblem, condensation: Condensation, displacement: Vector) -> float:
    """Return the energy norm of the rigid part of a displacement, which is rounding of K."""
    forces = _forces_of_rigid_part(problem, condensation, displacement)
    elastic, missing = response(problem, condensation, extend(forces), tied=False)
    return sum(energy_norm(problem, elastic)) + missing


def strain_of(
    problem: ContactProblem,
    solution: Extended,
    condensation: Condensation,
    forces: tuple[Extended, Extended] | None,
) -> tuple[float, float]:
    """Return |u*|_K of the solution, or of the nearest displacement known, and its uncertainty where bodies float.

    Where a rigid motion hides the strain even in extended precision, it is that of the response to all forces, which
    does not move rigidly.

    Parameters
    ----------
    problem : ContactProblem
    solution : Extended (n,), the displacement
    condensation : that of the problem
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

    Parameters
    ----------
    problem : ContactProblem
    condensation : that of the problem
    saddle : the factorised system of the closed contacts, which leaves the motions free
    apart : Extended (n,), the distance
    energy_scale : |u*|_K of the solution
    """
    motions = free_motions(condensation, saddle)
    if not motions.shape[1]:
        return 0.0
    resisted, _ = energy_norm(problem, without_part_along(motions, apart))
    distance = sum(energy_norm(problem, apart))
    if 0 < FEW_DIGITS**2 * energy_scale < resisted:  # motions in doubles leave a rounding of the whole distance
        forces = extended_rows(problem).stiffness @ apart
        elastic, missing = response(problem, condensation, forces, tied=False)
        resisted = min(resisted, sum(energy_norm(problem, elastic)) + missing)
    size = abs(motions @ (motions.T @ apart.double()))
    # More than K's rounding may make of a rigid motion it is not: see `is_rigid`.
    most = float(np.sqrt(RIGID_ENERGY * (size @ (problem.stiffness_sizes @ size))))
    return min(max(distance - resisted, 0.0), most)


def shared_by_rounding(
    problem: ContactProblem, condensation: Condensation, saddle: SaddlePoint, displacement: Vector
) -> tuple[Vector, float]:
    """Return sizes (m,) of the contact forces that K's rounding along rigid motions may make, and their energy norm.

    On the closed contacts they balance the forces of the rigid part of a displacement, less the resultants of these:
    forces that equilibrium alone determines do not feel it.

    Parameters
    ----------
    problem : ContactProblem
    condensation : that of the problem
    saddle : the factorised system of the closed contacts
    displacement : (n,) array [length], whose rigid part makes the forces
    """
    forces, motions = _forces_of_rigid_part(problem, condensation, displacement), condensation.rigid.motions
    spread = problem.diagonal[:, None] * motions
    forces = forces - spread @ np.linalg.lstsq(motions.T @ spread, motions.T @ forces, rcond=None)[0]
    pushed, closed = np.zeros(problem.contacts), saddle.closed
    _, share, _ = condensation.correction(saddle, forces, np.zeros(len(closed)), np.zeros(problem.ties))
    pushed[closed] = PUSHED_BY_ROUNDING * share
    return abs(pushed), sum(force_norm(problem, condensation, extend(pushed), tied=True))


def _forces_of_rigid_part(problem: ContactProblem, condensation: Condensation, displacement: Vector) -> Vector:
    """Return the forces (n,) that K, being rounded, makes of the rigid part of a displacement."""
    K, motions = extended_rows(problem).stiffness, condensation.rigid.motions
    forces = np.column_stack([(K @ extend(z)).double() for z in motions.T])
    return np.asarray(forces @ rigid_part(problem, displacement, condensation.rigid))


def own_forces(problem: ContactProblem, push: Vector, tie_force: Vector) -> Vector:
    """Return |l_i| |E_i D| (m + k,), the size of each contact's and tie's force at its own unknowns [root of energy].

    D = 1/sqrt(K_jj), as where all other unknowns are held.
    """
    compliance = np.concatenate([row_sizes(problem, rows).compliance for rows in (problem.normal, problem.tie)])
    return np.asarray(np.sqrt(compliance) * abs(np.concatenate([push, tie_force])))
