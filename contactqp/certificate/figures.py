"""What an answer violates: the worst contact or unknown, without dimension, in any units and any scale of rows.

With F_j = (|K||u| + |E_N|'|l_N| + |E_T|'|l_T| + |A|'|nu| + |f|)_j the size of the forces that meet at unknown j (of a
load that is known to be a sum, |f| is the sum of the sizes) and
L_i = (|E_N||u| + |g|)_i the size of the lengths that meet at contact i (`lengths_that_meet` says what it is where
both vanish), a force of contact i is measured as max_j |E_ij l_i| / F_j and a gap as its size over L_i; 0/0 is 0. In F
and L, u is the displacement without its rigid part. What is nothing beside the intrinsic size of problem and answer
(`contactqp.linalg.measures`) violates nothing.

Coulomb's law is judged in `contactqp.certificate.coulomb_law`, the balance of bodies that float in
`contactqp.certificate.balance`. Here also are the norms that answers and differences between them are compared in,

    |v|_K^2 = v'Kv,    |d|_W^2 = the energy of the bodies' response to contact forces d.

Differences come in as extended-precision vectors, so their norms mean something far beneath 1e-16 of the displacement.
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
    slips_that_are_nothing,
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
    nothing,
    outer_forces,
    parts,
    ratio,
    row_sizes,
    scale_through_rows,
)
from contactqp.linalg.refinement import CAUTION, LEAST_CONTRACTION
from contactqp.model.arrays import EPS, Mask, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Certificate, Nothing, Violations

T = TypeVar("T")

# Forces that are larger than a load by this factor hide it: a tolerance of 1e-9 of them is a thousandth of the load.
HIDES = 1e6
# By this one they drown it: their rounding is a thousandth of the load.
DROWNS = 1e12
# What rounding leaves of forces that cancel, in doubles, is below 1e-9 of this part of them.
ROUNDING_OF_SUMS = 4e-6
# A load or an elastic force is notable from this part of the intrinsic size on.
NOTABLE = 1e-6
# Refinement that contracts less than this proves nothing.
CONTRACTION = 0.5
# Pivots flatter the condition of a matrix: the rounding of W was up to 1e2 times what they say over the families of
# `benchmarks/silently_wrong.py`.
PIVOTS_FLATTER = 1e3
# A norm that double precision knows to this part is known well enough for a bound.
FEW_DIGITS = 1e-4
# Rounding of a double, and of v'Kv in extended precision, in units of FINE_EPS |v|'|K||v|.
ROUNDING, PRODUCT = EPS, 16
# Sweeps of refinement that a response may take, and the part of it that need not be known: good ones need two.
SWEEPS, ENOUGH = 8, 1e-9
# A displacement's strain that is this part of what its unknowns, each alone, would cost is the rounding of a rigid
# motion; so is a contact force's whose energy norm is this part of its size.
RIGID_ROUNDING = 64 * EPS
# Units 1/sqrt(K_jj) of unknowns that differ by no more than this are alike.
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
    residual : those of the answer
    rounding : the fraction of the intrinsic size that counts as none
    rigid : the null space of K; none where no body floats
    """
    elastic, size, sizes, slips = _kept(problem, answer, "sizes", partial(_sizes, problem, answer, rigid), rigid)
    none, F, coulomb = nothing(problem, answer, elastic, size, rounding), sizes.meeting, None
    least = none.force if none.contact_force is None else none.contact_force
    felt = row_sizes(problem, problem.normal).measure(answer.normal_force, F, least)
    missed = residual.force.double(), residual.gap.double(), residual.tie.double()
    if slips is not None:
        none = slips_that_are_nothing(none, slips.hardly)
        coulomb = coulomb_data(problem, slips, F, none.force)
    return figures(answer, missed, sizes, none, felt, coulomb)


def kept_residuals(problem: ContactProblem, answer: Answer) -> Residuals:
    """Return the residuals of an answer in extended precision; those of the last answer are kept."""
    return _kept(problem, answer, "residuals", partial(residuals, problem, answer))


def _kept(
    problem: ContactProblem,
    answer: Answer,
    part: Literal["residuals", "sizes"],
    make: Callable[[], T],
    rigid: RigidMotions | None = None,
) -> T:
    """Return the part of `OfAnswer` if it was made of this very answer to this very problem; else make it.

    An answer that its method looks at before it is certified is measured once. Arrays of both cannot be changed.
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
) -> tuple[Vector, Vector, Sizes, Slips | None]:
    """Return what does not depend on which part of the size counts as none.

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


def energy_norm(problem: ContactProblem, displacement: Extended | Vector) -> tuple[float, float]:
    """Return |v|_K [square root of energy] and a bound on its error: even extended precision rounds a large rigid
    motion.

    In double precision, unless that rounds away more than a few digits.
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
    """Bound what the rounding d of a residual may hide, |D d| / sqrt(least eigenvalue of DKD).

    A residual is formed so that |d_j| <= FINE_EPS F_j.
    """
    scale = problem.own_scale
    return float(FINE_EPS / np.sqrt(RIGID_FORCE) * np.linalg.norm(scale * forces_that_meet(problem, answer)))


def rigid_rounding(problem: ContactProblem, rigid: RigidMotions, displacement: Vector) -> float:
    """Return the energy norm of the rounding of a rigid displacement; zero where nothing floats."""
    if not rigid.count:
        return 0.0
    size = abs(displacement)
    return float(RIGID_ROUNDING * np.sqrt(size @ (problem.stiffness_sizes @ size)))


def own_forces(problem: ContactProblem, push: Vector, tie_force: Vector) -> Vector:
    """Return |l_i| |E_i D| (m + k,), the size of each contact's and tie's force at its own unknowns [root of energy].

    D = 1/sqrt(K_jj), as where all other unknowns are held.
    """
    compliance = np.concatenate([row_sizes(problem, rows).compliance for rows in (problem.normal, problem.tie)])
    return np.asarray(np.sqrt(compliance) * abs(np.concatenate([push, tie_force])))
