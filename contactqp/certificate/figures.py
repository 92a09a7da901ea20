"""Compute the dimensionless violations of an answer at every contact and unknown, independent of units and scales.

With F_j = (|K||u| + |E_N|'|l_N| + |E_T|'|l_T| + |A|'|nu| + |f|)_j the size of the forces that meet at unknown j (of a
load that is known to be a sum, |f| is the sum of the sizes) and L_i = (|E_N||u| + |g|)_i the size of the lengths that
meet at contact i (`lengths_that_meet` says what it is where both vanish), a force of contact i is measured as max_j
|E_ij l_i| / F_j and a gap as its size over L_i; 0/0 is 0. In F and L, u is the displacement without its rigid part.
What is negligible relative to the intrinsic size of problem and answer (`contactqp.linalg.measures`) counts as zero.

Coulomb's law is judged in `contactqp.certificate.coulomb_law`, the balance of floating bodies in
`contactqp.certificate.balance`. Here are also the norms of answers and their differences,

    |v|_K^2 = v'Kv,    |d|_W^2 = the energy of the bodies' response to contact forces d.

Differences are extended-precision vectors, so their norms are accurate far below 1e-16 of the displacement.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from operator import is_
from typing import Any, Literal, TypeVar

import numpy as np

from contactqp.certificate.coulomb_law import (
    CoulombData,
    Slips,
    coulomb_data,
    friction_figures,
    lengths_across,
    slips_of,
    with_negligible_slips,
)
from contactqp.linalg.condensation import Condensation, free_motions
from contactqp.linalg.dense import REGULAR, RigidMotions, SaddlePoint, orthonormal, saddle_point
from contactqp.linalg.extended import FINE_EPS, Extended, Residuals, extend, extended_rows, residuals
from contactqp.linalg.factorization import RIGID_FORCE
from contactqp.linalg.measures import (
    ROUNDING_OF_LENGTH,
    beyond,
    forces_that_meet,
    inner_forces,
    intrinsic_size,
    negligible_in,
    outer_forces,
    parts,
    ratio,
    row_sizes,
    scale_through_rows,
)
from contactqp.linalg.refinement import CAUTION, LEAST_CONTRACTION
from contactqp.model.arrays import EPS, Mask, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Certificate, NegligibleSizes, Violations

T = TypeVar("T")

# Forces larger than a load by this factor hide it, as a tolerance of 1e-9 of them is a thousandth of the load.
HIDES = 1e6
# Beyond this factor their rounding is a thousandth of the load.
DROWNS = 1e12
# The size for forces that cancel in doubles, relative to them; their rounding is below 1e-9 of it.
ROUNDING_OF_SUMS = 4e-6
# A load or an elastic force is notable from this part of the intrinsic size on.
NOTABLE = 1e-6
# Refinement that contracts less than this proves nothing.
CONTRACTION = 0.5
# A safety factor on conditions estimated by pivots; the rounding of W was up to 1e2 times larger in the families of
# `benchmarks/silently_wrong.py`.
PIVOTS_FLATTER = 1e3
# The relative error up to which a norm in double precision suffices for a bound.
FEW_DIGITS = 1e-4
# Rounding of a double, and of v'Kv in extended precision, in units of FINE_EPS |v|'|K||v|.
ROUNDING, PRODUCT = EPS, 16
# The most sweeps of refinement of a response (two usually suffice), and its relative tolerance.
SWEEPS, ENOUGH = 8, 1e-9
# A strain below this part of the sum of K_jj u_j^2 is the rounding of a rigid motion, as is a contact force whose
# energy norm is below this part of its size.
RIGID_ROUNDING = 64 * EPS
# Units 1/sqrt(K_jj) of unknowns count as equal within this factor.
UNITS_ALIKE = 1e3


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
    residual : the residuals of the answer
    rounding : the fraction of the intrinsic size that counts as none
    rigid : the null space of K; none where no body floats
    """
    elastic, size, sizes, slips = _kept(problem, answer, "sizes", partial(_sizes, problem, answer, rigid), rigid)
    negligible, F, coulomb = negligible_in(problem, answer, elastic, size, rounding), sizes.meeting, None
    least = negligible.force if negligible.contact_force is None else negligible.contact_force
    felt = row_sizes(problem, problem.normal).measure(answer.normal_force, F, least)
    missed = residual.force.double(), residual.gap.double(), residual.tie.double()
    if slips is not None:
        negligible = with_negligible_slips(negligible, slips.hardly)
        coulomb = coulomb_data(problem, slips, F, negligible.force)
    return figures(answer, missed, sizes, negligible, felt, coulomb)


def kept_residuals(problem: ContactProblem, answer: Answer) -> Residuals:
    """Return the residuals of an answer in extended precision, kept for the last answer."""
    return _kept(problem, answer, "residuals", partial(residuals, problem, answer))


def _kept(
    problem: ContactProblem,
    answer: Answer,
    part: Literal["residuals", "sizes"],
    make: Callable[[], T],
    rigid: RigidMotions | None = None,
) -> T:
    """Return a cached part of `OfAnswer` if it belongs to this answer and problem, else compute it.

    So an answer that its method examines before it is certified is measured once. The arrays are read-only.
    """
    given = (problem.load, problem.load_size, problem.gap, problem.tie_value, problem.slip_origin)
    given = (*given, *vars(answer).values(), rigid)
    cached = getattr(problem._computed.of_answer, part)
    if cached is None or not all(map(is_, cached[0], given)):
        cached = given, make()
        setattr(problem._computed.of_answer, part, cached)
    found: T = cached[1]
    return found


def _forces_that_count(problem: ContactProblem, acting: Vector, meeting: Vector, hidden: Mask, size: Vector) -> Vector:
    """Return the forces F (n,) by which residuals are measured, limited where large forces hide the load [force].

    Self-equilibrated forces of dependent contacts and ties may have any size, relative to which a load would vanish.
    Where the forces that meet are at least 1e6 times |f| + |K||u|, F is only as large as their rounding requires; where
    they are 1e12 times that, their rounding may exceed the load, and F is |f| + |K||u|. This applies where the load is
    notable relative to the intrinsic size, and in parts without a size in which every load is hidden.

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
) -> tuple[Vector, Vector, Sizes, Slips | None]:
    """Return the sizes that do not depend on the fraction that counts as zero.

    The displacement without its rigid part and the intrinsic size S, both (n,), the sizes by which residuals are
    measured, and the slips, or None without tangential rows.
    """
    elastic, size, F = _meeting(problem, answer, rigid)
    normal, moved, tie_lengths = row_sizes(problem, problem.normal), abs(elastic), np.zeros(0)
    if problem.ties:
        tie_lengths = row_sizes(problem, problem.tie).lengths(moved) + abs(problem.tie_value)
    slips = None if problem.tangent is None else slips_of(problem, answer.displacement)
    across = np.zeros(problem.contacts) if problem.friction is None else lengths_across(problem, elastic)
    sizes = Sizes(
        meeting=F,
        push=normal.measure(answer.normal_force, F),
        lengths=normal.lengths(moved) + abs(problem.gap),
        tangential_lengths=across,
        tie_lengths=tie_lengths,
        intrinsic_size=float(size.max(initial=0.0)),
    )
    return elastic, size, sizes, slips


def _meeting(problem: ContactProblem, answer: Answer, rigid: RigidMotions | None) -> tuple[Vector, Vector, Vector]:
    """Return the displacement without its rigid part, the intrinsic size S and the forces F that meet, all (n,)."""
    elastic = answer.displacement
    if rigid is not None and rigid.count:
        elastic = rigid.without_rigid_part(elastic, problem.diagonal)
    size = intrinsic_size(problem, answer, elastic)
    inner = inner_forces(problem, elastic)
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
    negligible: NegligibleSizes,
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
    negligible : NegligibleSizes
        Those that count as negligible.
    felt : (m,) array
        |l_N| as a force, 0 where it is nothing.
    coulomb : CoulombData or None
        What judges Coulomb's law; None without friction.
    """
    residual, gap, open_tie = missed
    if coulomb is None or answer.friction_force is None:
        cone = direction = slip_measure = turned = np.zeros(len(answer.normal_force))
    else:
        cone, direction, slip_measure, turned = friction_figures(answer, coulomb, sizes.tangential_lengths, negligible)
    gap_measure = ratio(beyond(abs(gap), negligible.normal), sizes.lengths)
    return Violations(
        equilibrium=ratio(beyond(abs(residual), negligible.force), sizes.meeting),
        residual=residual,
        penetration=np.where(gap < 0, gap_measure, 0.0),
        tension=np.where(answer.normal_force < 0, felt, 0.0),
        complementarity=np.where((gap > 0) & (answer.normal_force > 0), np.minimum(gap_measure, felt), 0.0),
        cone=cone,
        slip_direction=direction,
        tie=ratio(beyond(abs(open_tie), negligible.tie), sizes.tie_lengths),
        slip_measure=slip_measure,
        turned=turned,
        lengths=sizes.lengths,
        tangential_lengths=sizes.tangential_lengths,
        gap=gap,
        gap_measure=gap_measure,
        force_measure=sizes.push,
        meeting=sizes.meeting,
        intrinsic_size=sizes.intrinsic_size,
        nothing=negligible,
    )


def contact_status(problem: ContactProblem, certificate: Certificate) -> Any:
    """Return (m,) of "open", "closed", "grazing" and, with friction, "stick" and "slip".

    A contact is closed if its force is not zero and its gap, relative to the lengths that meet there, is at most its
    force relative to the forces that meet, or at most `tolerance`; and also if it is penetrated with a compressive
    force, as with a penalty. The sign of the force is judged by `tension`. A closed contact with friction slips if its
    slip exceeds `tolerance` of the lengths that meet. A contact is grazing if gap and force are both at most
    `tolerance`, and the force is negligible in energy.
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


def energy_norm(problem: ContactProblem, displacement: Extended | Vector) -> tuple[float, float]:
    """Return |v|_K [square root of energy] and a bound on its error, as by rounding of a large rigid motion.

    It is computed in double precision, unless that loses more than a few digits.
    """
    v = displacement if isinstance(displacement, np.ndarray) else displacement.double()
    u = abs(v)
    square = float(v @ (problem.stiffness @ v))
    size = float(u @ (problem.stiffness_sizes @ u))
    terms = problem.dimension + 2  # of the longest sum
    rounding = terms * ROUNDING * size
    if rounding > FEW_DIGITS * square:
        exact = extend(displacement)
        square = max(float(exact.dot(extended_rows(problem).stiffness @ exact)), 0.0)
        rounding = float(PRODUCT * FINE_EPS * size)
    norm = float(np.sqrt(square))
    return norm, min(float(np.sqrt(rounding)), rounding / norm) if norm > 0 else float(np.sqrt(rounding))


def energy_norms(
    problem: ContactProblem,
    condensation: Condensation,
    displacement: Extended,
    counted: tuple[float, float] | None = None,
) -> tuple[float, float]:
    """Return the least and the largest |v|_K, with and without the rounding of K along rigid motions.

    By this rounding K z of a rigid motion z is a force of either sign, and for a nearly rigid v, v'Kv may differ from
    the energy of its strain, that of v without its rigid part.

    Parameters
    ----------
    problem : ContactProblem
    condensation : the Condensation of the problem, with its rigid motions
    displacement : Extended (n,), v
    counted : two floats, optional
        `energy_norm` of v, where it has been formed already.
    """
    norm, uncertain = counted or energy_norm(problem, displacement)
    if not condensation.rigid.count:
        return norm, norm + uncertain
    motions = condensation.rigid.motions
    moved = motions @ condensation.rigid.coordinates(displacement.double(), problem.diagonal)
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
    condensation : the Condensation of the problem
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
            if rounding <= FEW_DIGITS * square and square > 0:  # squares of very small forces underflow
                return float(np.sqrt(square)), float(rounding / np.sqrt(square))
    held = extend(np.zeros(problem.ties)) if tie_force is None else tie_force
    load = extended_rows(problem).contact_force(force, held)
    u, error = response(problem, condensation, load, tied)
    norm, rounding = energy_norm(problem, u)
    return norm, error + rounding


def response(problem: ContactProblem, condensation: Condensation, load: Extended, tied: bool) -> tuple[Extended, float]:
    """Return the displacement u under a load with all contacts open, and a bound on its error in the energy norm.

    K u + A'eta = P load and A u = 0 where tied, K u = P load where not; P removes the part of the load that drives free
    motions.

    Parameters
    ----------
    problem : ContactProblem
    condensation : the Condensation of the problem
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
    if foreseen <= ENOUGH or not first:  # the contraction is known from another load
        return u, 2 * foreseen * first + left
    # Usually the next sweep confirms convergence, for which residuals in double precision suffice.
    held = problem.stiffness_rows @ u.double() + problem.tie.T @ eta.double()
    du, _, size = step(extend(load.double() - held))
    if size <= ENOUGH * first:
        measured = max(saddle.contraction or 0.0, size / first, LEAST_CONTRACTION)
        saddle.contraction = measured if saddle.regular else None
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
    """Return the free motions (n, q), accurate to a few eps at every unknown.

    Orthonormal ones are so if the units of the unknowns are similar. Otherwise entries have rounding errors of the
    largest entry in units of 1/sqrt(K_jj), which one correction by K z in extended precision removes.
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
    """Return a bound of the response, in the energy norm, to the error of taking Z Z'f, or what ties balance, from f.

    Unknown by unknown it is at most a (|f| + |Z||Z|'|f|), if the orthonormal motions Z (n, q) are accurate to a: a few
    eps, or the resistance of ties to them where that is larger. The response to it is at most

        a |D (|f| + |Z||Z|'|f|)| / sqrt(e),    D = 1/sqrt(K_jj),

    with e the least energy of a motion that has strain.
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
    """Return the products of ties with motions (n, q), relative to the terms that should cancel."""
    most = abs(problem.tie).sum(axis=1)[:, None] * np.max(abs(motions), axis=0, initial=0.0)
    return float(np.max(abs(problem.tie @ motions) / np.where(most > 0, most, 1.0), initial=0.0))


def without_part_along(motions: Vector, vector: Extended) -> Extended:
    """Return a vector without its part along orthonormal motions (n, q)."""
    if not motions.shape[1]:
        return vector
    return vector - motions @ (motions.T @ vector.double())


def residual_noise(problem: ContactProblem, answer: Answer) -> float:
    """Bound the energy norm of the response to the rounding d of a residual, |D d| / sqrt(least eigenvalue of DKD).

    A residual is formed so that |d_j| <= FINE_EPS F_j.
    """
    scale = problem.own_scale
    return float(FINE_EPS / np.sqrt(RIGID_FORCE) * np.linalg.norm(scale * forces_that_meet(problem, answer)))


def rigid_rounding(problem: ContactProblem, floats: bool, displacement: Vector) -> float:
    """Return the energy norm of the rounding of a rigid displacement, zero if nothing floats."""
    if not floats:
        return 0.0
    size = abs(displacement)
    return float(RIGID_ROUNDING * np.sqrt(size @ (problem.stiffness_sizes @ size)))


def own_forces(problem: ContactProblem, push: Vector, tie_force: Vector) -> Vector:
    """Return |l_i| |E_i D| (m + k,), the size of each contact's and tie's force at its own unknowns [root of energy].

    D = 1/sqrt(K_jj), as for all other unknowns fixed.
    """
    compliance = np.concatenate([row_sizes(problem, rows).compliance for rows in (problem.normal, problem.tie)])
    return np.asarray(np.sqrt(compliance) * abs(np.concatenate([push, tie_force])))
