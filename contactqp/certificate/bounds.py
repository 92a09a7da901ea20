"""Prove bounds on the distance of an answer from the solution, for problems without friction.

Let |v|_K^2 = v'Kv, u* the solution and l*, nu* its forces. For any v that satisfies E v <= g, A v = b and any forces
l >= 0, nu with balanced resultants, let w solve K w = f - E'l - A'nu. With J the energy and D the dual energy,

    J(v) - J(u*)    = 1/2 |v - u*|^2 + l*'(g - E v)        (l* and u* are complementary, A v = b)
    J(u*) - D(l,nu) = 1/2 |w - u*|^2 + l'(g - E u*)        (D is the minimum over all w of the Lagrangian)
    J(v) - D(l,nu)  = 1/2 |v - w|^2  + l'(g - E v)         (insert f = K w + E'l + A'nu)

and adding the first two, whose last terms are not negative,

    |v - u*|^2 + |w - u*|^2 <= G^2 := |v - w|^2 + 2 l'(g - E v).                                          (1)

By the parallelogram identity the midpoint c = (v + w)/2 is nearer,

    |c - u*|^2 <= |v - w|^2/4 + l'(g - E v).                                                               (2)

Since w - u* = -K^+ (E'(l - l*) + A'(nu - nu*)),

    |l - l*|_W <= |w - u*|_K,                                                                              (3)

with |d|_W the energy norm of the response of the tied bodies to the contact forces d. From the first two lines also
l_i* <= G^2 / (2 (g - E v)_i) where v is open; and with v_i, mu_i from K v_i + E_B'mu_i + A'eta_i = 0, E_B v_i = 1_i, A
v_i = 0 on independent rows B,

    |l_i - l_i*| <= |v_i|_K |w - u*|_K + sum over j not in B of |E_j v_i| |l_j - l_j*|.                    (4)

The pair (v, l) is refined on the candidate's own set, or by `admissible_pair`; the candidate's distance to it is added.

Rounding allowance: v - w and the distances are formed from residuals in extended precision. Their refinement contracts
by a measured factor q; a last step of size s leaves about s q/(1-q), and 1e4 times what that can make in the energy
norm is added. If q >= 1/2 on all sets, nothing is proven. Added are the uncertainty by gaps and forces of rounding size
and the rounding of |v_i|_K, large where rows are nearly parallel. If bodies float, the worse of the norms with and
without rounding of K along rigid motions is used. This estimates rounding and does not enclose it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from contactqp.certificate.admissible_pair import (
    ZERO_GAP,
    AdmissiblePair,
    Undecided,
    Unproven,
    believed_sets,
    bounds_apart,
    conflict_of_constraints,
    from_repair,
    of_noise,
    of_penetration,
    out_of_balance,
    refuse_conflicting_ties,
    refuse_unbalanced,
    searched_set,
    without_tension,
)
from contactqp.certificate.balance import (
    STATE_MOTIONS,
    UNTOLD_RESISTANCE,
    determined_by,
    free_distance,
    nearest_to,
    parts_of_bare_forces,
    shared_by_rounding,
    strain_of,
    strain_of_rigid_part,
)
from contactqp.certificate.figures import (
    CONTRACTION,
    FEW_DIGITS,
    RIGID_ROUNDING,
    energy_norm,
    energy_norms,
    force_norm,
    own_forces,
    residual_noise,
    rigid_rounding,
)
from contactqp.errors import NotConverged
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.dense import saddle_point
from contactqp.linalg.equilibration import affordable_systems
from contactqp.linalg.extended import Extended, Residuals, extend
from contactqp.linalg.floating import SingleErrors, single_errors, unique_forces
from contactqp.linalg.least_norm import WITHIN_ROUNDING
from contactqp.linalg.measures import force_size, intrinsic_size, lengths_that_meet, of_rows, own_compliance, parts
from contactqp.linalg.refinement import CAUTION, OnSet, closed_contacts, polish
from contactqp.model.arrays import EPS, Indices, Mask, Vector, seconds_of_unfinished
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import BOUNDS, BY_DISPLACEMENT, FIGURES_ALONE, Answer

VANISHING = 1e-22  # errors with an energy norm below this part of the displacement's are rounding of refinement
CORRECTIONS, LAST_CORRECTIONS = 3, 50  # of each possible set of the candidate, and of the first one after all fail
LEAST_PART = 1e-6  # contact forces below this part of tie forces have errors that are negligible relative to these
NEXT_TO_NOTHING = 1e-12  # forces below this part of the displacement's energy norm have absolute errors, and vice versa
STRAINED_BY_ROUNDING = 16.0  # a strain up to this multiple of that of the rigid part may be due to rounding of K
# Why forces that contacts and ties share have no bound although their resultants have one.
REDUNDANT = "the closed contacts and ties are redundant, and forces that they share have no bound"
FRICTION_HAS_NONE = "Coulomb friction is not a minimisation; contactqp.certify looks for a bound from the law itself"
OUT_OF_TIME = "the time limit ended the search, and as long again did not suffice for bounds"
LARGEST = 8000  # the most condensed unknowns for the dense systems of the bounds


@dataclass(frozen=True, eq=False)
class Bounds:
    """Proven bounds [square root of energy]; one that could not be computed is None, with the reason."""

    energy_error: float | None = None
    force_error: float | None = None
    force_bound: Vector | None = None  # (m,) NaN for redundant contacts, whose forces are not unique
    relative_force_bound: Vector | None = None  # (m,) force_bound_i |E_i D| / |l*|_W or, if known, / largest_force
    energy_scale: float = 0.0  # |u*|_K or a lower bound
    force_scale: float = 0.0  # |l*|_W likewise
    largest_force: float = 0.0  # max |l*_i| |E_i D|, D = 1/sqrt(K_jj), of ties where no contact presses; no friction
    ties: tuple[float, float] = (0.0, 0.0)  # the error and the size of all forces of ties, if contacts have none
    single: SingleErrors | None = None  # of forces of contacts and ties that are unique, where ties or no stiffness act
    rounding: float = 0.0  # the rounding of the refinement
    rigid_rounding: float = 0.0  # the energy norm of the rounding of a rigid displacement
    force_rounding: float = 0.0  # |l|_W below this is rounding of forces that do not strain the bodies
    free_distance: float = 0.0  # the energy norm, by rounding of K, of a free motion between answer and solution
    cleared: float = 0.0  # the part of the forces that K's rounding along rigid motions would have made
    shared: float = 0.0  # the part of `force_error` that this rounding may cause in redundant forces
    undecided: float = 0.0  # the part of the distance by undecided gaps
    estimated: bool = False  # whether estimated by Ritz values, or for a K set to zero along rigid motions
    solution: Extended | None = None  # u*, to its last digits, where the signs on its contact set hold
    energy_bounds: tuple[float, float] | None = None  # lower <= J* <= upper, upper that of the answer
    energy_size: float = 0.0  # the larger of 1/2 u'Ku and |f'u|
    energy_rounding: float = 0.0  # the work of contact forces on gaps, as doubles round these
    determined: str = BY_DISPLACEMENT
    scope: str | None = None  # with friction: "global", or "local", the only equilibrium within `radius`
    radius: float | None = None
    free: bool = False  # whether "local" holds up to rigid motions
    by_energy: bool = False  # whether the answer is judged by its energy, as K is singular
    apart: float | None = None  # |u - U|_K over |U|_K for the solution U found, in this case, if K has factors
    suspicious: str | None = None  # reason for the lack of a bound, if it counts against the answer
    reasons: tuple[str, ...] = ()

    @cached_property
    def redundant(self) -> bool:
        """Return whether closed contacts and ties were found to depend on each other."""
        return any(REDUNDANT in reason for reason in self.reasons)

    @cached_property
    def proven(self) -> bool:
        """Return whether energy and force error are bounded, and not only estimated."""
        return self.energy_error is not None and self.force_error is not None and not self.estimated

    def claimed(self, tolerance: float) -> Bounds:
        """Return these bounds, which hold if bodies float, or none where it matters and the numbers do not tell."""
        untold = self.estimated and self.cleared > tolerance
        return no_bounds(UNTOLD_RESISTANCE.format(self.cleared)) if untold else self

    @cached_property
    def basis(self) -> str:
        """Return the basis of a verdict without friction: "bounds" if both errors have one, else "figures"."""
        return FIGURES_ALONE if self.energy_error is None or self.force_error is None else BOUNDS


def error_bounds(
    problem: ContactProblem, answer: Answer, residual: Residuals, condensation: Condensation, by_energy: Any = None
) -> Bounds:
    """Return the bounds of an answer, or the reasons why there are none.

    Parameters
    ----------
    problem, answer, residual, condensation : ContactProblem, Answer, its Residuals, and the problem's Condensation
    by_energy : `bounds_by_energy` for parts without stiffness, where all energy norms vanish; None leaves these out
    """
    if problem.frictional:
        return no_bounds(FRICTION_HAS_NONE)
    stiff = elastic = problem.diagonal > 0
    if stiff.any() and not stiff.all():  # unknowns of parts with stiffness; contacts and ties join a part
        elastic = np.isin(part := parts(problem), part[stiff])
    if elastic.any() and not elastic.all():
        apart: Bounds = bounds_apart(problem, answer, elastic, _condensed, by_energy)
        return apart
    found = _condensed(problem, answer, residual, condensation)
    return found if by_energy is None or elastic.all() else by_energy(problem, answer, found, condensation.rigid)


def _condensed(problem: ContactProblem, answer: Answer, residual: Residuals, condensation: Condensation) -> Bounds:
    if len(condensation.retained) > LARGEST:
        return no_bounds(f"{len(condensation.retained)} condensed unknowns: too many for dense systems")
    try:
        pair = admissible_pair(problem, answer, residual, condensation)
    except NotConverged:
        if seconds_of_unfinished() is None:
            raise
        return no_bounds(OUT_OF_TIME)
    except Undecided as reason:
        return no_bounds(str(reason))
    except Unproven as unproven:
        text = conflict_of_constraints(problem, condensation) or str(unproven)
        return replace(no_bounds(text), suspicious=text)
    return _from_pair(problem, answer, condensation, pair)


def no_bounds(reason: str) -> Bounds:
    """Return bounds that are all None for one reason."""
    return Bounds(reasons=tuple(f"{name}: {reason}" for name in ("energy_error", "force_error", "force_bound")))


def admissible_pair(
    problem: ContactProblem, answer: Answer, residual: Residuals, condensation: Condensation
) -> AdmissiblePair:
    """Return the admissible pair nearest to an answer without friction; raise Unproven if refinement finds none.

    Parameters
    ----------
    problem, answer, residual, condensation : as in `error_bounds`
    """
    compliance = condensation.delassus.compliance[: problem.contacts]
    first = closed_contacts(problem, compliance, answer.displacement, answer.normal_force)
    believed = believed_sets(problem, answer, compliance) if problem.contacts + problem.ties > 1 else ()
    if believed and not saddle_point(condensation, believed[0]).regular:  # what nearly parallel rows share needs every
        for saddle in condensation.saddles.values():  # sweep, and a verdict does not depend on what was refined before
            saddle.contraction = None
    found, taken = _holding(problem, condensation, first, CORRECTIONS, answer, residual)
    for closed, corrections in (*((closed, CORRECTIONS) for closed in believed), (first, LAST_CORRECTIONS)):
        if found is not None or taken >= affordable_systems(problem):
            break
        found, systems = _holding(problem, condensation, closed, corrections, answer, residual)
        taken += systems
    if found is None:
        last = CORRECTIONS if taken >= affordable_systems(problem) else LAST_CORRECTIONS
        found, _ = _holding(problem, condensation, first, last)
    if found is None and (searched := searched_set(problem, condensation)) is not None:
        found, _ = _holding(problem, condensation, searched, CORRECTIONS, answer, residual)
    if found is None:
        pair = from_repair(problem, answer, condensation, first)
    else:
        pair = _from_set(problem, answer, condensation, found)
    if condensation.rigid.count and (problem.load.any() or pair.force.double().any()):  # ties alone drive no motion
        refuse_unbalanced(problem, answer, condensation, pair)
    return pair


def _holding(
    problem: ContactProblem,
    condensation: Condensation,
    closed: Indices,
    corrections: int,
    answer: Answer | None = None,
    residual: Residuals | None = None,
) -> tuple[OnSet | None, int]:
    """Refine an answer, unless its rounding hides the gaps, on a set that may be corrected; return it and the systems.

    It is None unless its signs hold and refinement contracts, as other sets may leave out one of two nearly dependent
    rows; without an answer Unproven is raised then.
    """
    on_set, changed, holds = polish(problem, condensation, closed, corrections, answer, residual, CAUTION)
    if (q := on_set.contraction) >= CONTRACTION and answer is None:
        raise Unproven(f"the refinement contracts by {q:.2g} only: the stiffness is singular to working precision")
    return (on_set if holds and q < CONTRACTION else None), changed + 1


def _from_set(problem: ContactProblem, answer: Answer, condensation: Condensation, on_set: OnSet) -> AdmissiblePair:
    """Return the pair of a refined answer with right signs, the solution up to its last correction and `undecided`."""
    force, tie_force, undecided = on_set.normal_force, on_set.tie_force, _undecided(problem, condensation, on_set)
    shared = 0.0  # strain by redistribution of redundant forces, by rounding
    # Entries of size s [root of energy] have norms of at most s sqrt(nnz(K)) as displacement and s m as forces.
    entries = np.sqrt(problem.stiffness_sizes.size) + problem.contacts
    allowance = entries * on_set.remainder + residual_noise(problem, on_set.doubles) + undecided
    if problem.ties:  # forces of dependent rows
        refuse_conflicting_ties(problem, answer, condensation, on_set.displacement - extend(answer.displacement))
        force, tie_force = nearest_to(answer, condensation, on_set, allowance)
        shared = force_norm(problem, condensation, force - on_set.normal_force)[0]
    if (force.hi < 0).any():
        dropped, tie_change = without_tension(problem, condensation, force)
        pulled = sum(force_norm(problem, condensation, dropped))
        undecided, allowance = undecided + pulled, allowance + pulled
        force, tie_force = force + dropped, tie_force + tie_change
    return AdmissiblePair(
        to_middle=on_set.displacement - extend(answer.displacement),
        radius=allowance,
        dual_radius=allowance + shared,
        force=force.positive_part(),
        tie_force=tie_force,
        open_gap=np.maximum(on_set.gaps, 0.0),
        saddle=on_set.saddle,
        exact=True,
        cleared=on_set.cleared,
        undecided=undecided,
    )


def _undecided(problem: ContactProblem, condensation: Condensation, on_set: OnSet) -> float:
    """Bound the distance of the solution from an answer that penetrates by rounding [square root of energy]."""
    length, doubles = on_set.lengths, on_set.doubles
    if not np.isfinite(length).all():  # where only rounding meets, the size of the problem says what is a length
        elastic = condensation.rigid.without_rigid_part(doubles.displacement, problem.diagonal)
        whole = of_rows(problem, problem.normal, intrinsic_size(problem, doubles, elastic))
        length = np.where(np.isfinite(length), length, whole)
    excess = np.where(-on_set.gaps > ZERO_GAP * length, -on_set.gaps, 0.0)
    touching = (abs(on_set.gaps) <= WITHIN_ROUNDING * length).nonzero()[0]
    saddle = on_set.saddle if np.array_equal(touching, on_set.saddle.closed) else saddle_point(condensation, touching)
    undecided = of_noise(problem, condensation, on_set, length) if saddle.redundant else 0.0
    if excess.any():
        undecided += of_penetration(problem, condensation, on_set, excess, length)
    return undecided


def _from_pair(problem: ContactProblem, answer: Answer, condensation: Condensation, pair: AdmissiblePair) -> Bounds:
    """Return the bounds of an answer by its distance to the pair and the pair's own: (2), (3) and (4)."""
    solution = extend(answer.displacement) + pair.to_middle
    changes = extend(answer.normal_force) - pair.force, extend(answer.tie_force) - pair.tie_force
    push, changed, floats = pair.force.double(), changes[0].double(), bool(condensation.rigid.count)
    forces = (pair.force, pair.tie_force) if pair.exact else None
    strain = strain_of(problem, solution, condensation, forces) if floats else energy_norm(problem, solution)
    (energy_scale, uncertain), rigid = strain, rigid_rounding(problem, floats, answer.displacement)
    distance = energy_norms(problem, condensation, pair.to_middle)[1] + pair.radius
    moved = solution.double() if floats and pair.exact else answer.displacement  # may be far from the solution
    farther = replace(answer, displacement=np.maximum(abs(answer.displacement), abs(moved))) if floats else answer
    rounding = 4 * residual_noise(problem, farther) + VANISHING * energy_scale
    size, own = force_size(problem, problem.normal, push), np.sqrt(own_compliance(problem, problem.normal))
    if floats and energy_scale <= rigid_rounding(problem, floats, moved):
        uncertain += STRAINED_BY_ROUNDING * strain_of_rigid_part(problem, condensation, moved)
        rigid = max(rigid, 2 * uncertain)  # the answer may have the same strain
    if pair.exact and energy_scale <= pair.radius and not (problem.load.any() or push.any()):
        rounding = max(rounding, 4 * pair.dual_radius)  # without load, all admissible rigid displacements solve
    lost = uncertain > rounding and energy_scale <= uncertain and not pair.exact  # strain hidden by a large motion
    energy_scale = 0.0 if energy_scale <= max(rounding, uncertain) else energy_scale
    force_rounding = RIGID_ROUNDING * size if floats or problem.ties else 0.0  # of forces that cause no strain
    free = free_distance(problem, condensation, pair.saddle, pair.to_middle, energy_scale) if floats else 0.0
    vanishing = max(NEXT_TO_NOTHING * energy_scale, rounding, force_rounding, 2 * pair.undecided)
    force_bound, unique = _force_bound(problem, answer, condensation, pair)
    every = np.ones(problem.contacts + problem.ties, dtype=bool) if unique is None else unique
    error, scale, single = _force_error(problem, condensation, pair, changes, vanishing, force_bound, every)
    # So does a strain that is negligible beside that of contact forces, which the load balances directly.
    energy_scale = 0.0 if energy_scale <= NEXT_TO_NOTHING * scale else energy_scale
    elastic = problem.diagonal.any()  # otherwise all energy norms are zero
    tied = problem.ties > 0 and scale == 0  # they may take what a nearly parallel contact presses in truth
    felt = own_forces(problem, push, pair.tie_force.double()) if tied else own * abs(push)
    largest = float(np.max(felt, initial=0.0)) if floats or tied or scale > 0 else 0.0
    shared, of_shared, sure = np.zeros(problem.contacts), 0.0, True
    if floats:
        shared, of_shared, sure = shared_by_rounding(problem, condensation, pair.saddle, moved, pair.cleared, push)
    force_bound, relative = np.where(every[: problem.contacts], force_bound + abs(changed) + shared, 0.0), None
    if max(largest, scale) > 0:
        relative = force_bound * own / (largest or max(scale, size))
        if not problem.diagonal.all():
            relative = np.maximum(relative, parts_of_bare_forces(problem, force_bound, push))
    energy_error = np.inf if lost else relative_error(distance, energy_scale, pair.radius + uncertain)
    return Bounds(
        energy_scale=energy_scale,
        rounding=rounding,
        rigid_rounding=rigid,
        force_rounding=force_rounding,
        free_distance=free,
        cleared=pair.cleared,
        undecided=pair.undecided,
        energy_error=energy_error if elastic else 0.0,
        force_error=error + of_shared / (scale or 1.0) if elastic else 0.0,
        force_scale=scale,
        single=single,
        shared=of_shared / (scale or 1.0),
        largest_force=largest,
        force_bound=np.where(every[: problem.contacts], force_bound, np.nan),
        relative_force_bound=relative,
        estimated=not sure,
        determined=determined_by(problem, answer, condensation) if floats else BY_DISPLACEMENT,
        solution=solution if pair.exact else None,
        reasons=() if unique is None else (f"force_bound: {REDUNDANT}",),
    )


def _force_error(
    problem: ContactProblem,
    condensation: Condensation,
    pair: AdmissiblePair,
    changes: tuple[Extended, Extended],
    vanishing: float,
    bound: Vector,
    every: Mask,
) -> tuple[float, float, SingleErrors | None]:
    """Return the bound (3) on the distance of the answer's forces from the pair's over |l*|_W, |l*|_W, and each error.

    `changes` are the answer's forces of contacts (m,) and ties (k,) less the pair's. Forces up to `vanishing` are
    rounding. Where ties act, W is also taken without them, of all forces, which are |w - u*|_K from the true ones, and
    of contact forces alone, which a nearly parallel tie may carry, by (4), `bound` (m,). For slender floating bodies
    these are not sharp, and unique forces of ties, by `every` (m + k,), are compared one by one.
    """
    unique, bound = every[problem.contacts :], np.where(every[: problem.contacts], bound, 0.0)
    floats, independent = condensation.rigid.count > 0, pair.exact and bool(unique.all())
    carried = max(pair.dual_radius, float(np.sqrt(condensation.delassus.compliance[: problem.contacts]) @ bound))
    tied, whole, alone = ((True, False, pair.dual_radius), (False, True, pair.dual_radius), (False, False, carried))
    norms = [tied]
    if problem.ties > 0 and not (floats and independent):
        norms += [whole] if floats or not pair.exact else [alone, whole]
    found: list[tuple[float, float, float]] = []
    for held, with_ties, radius in norms:
        scale, uncertain = force_norm(problem, condensation, pair.force, held, pair.tie_force if with_ties else None)
        error = force_norm(problem, condensation, changes[0], held, changes[1] if with_ties else None)
        if not held and uncertain > FEW_DIGITS * scale and (found[0][1] > 0 or floats):
            continue  # without ties K is singular to rounding, without such a norm
        found.append((sum(error) + radius, 0.0 if scale <= vanishing else scale, uncertain + radius))
    seen = len(found) > 1 and (found[0][1] > 0 or (alone in norms and found[1][1] > 0))
    if seen and found[0][1] <= found[0][2] - pair.dual_radius:
        found = found[1:]  # contact forces are balanced by ties up to rounding
    largest, missed, single, (_, size, uncertain) = 0.0, 0.0, None, found[0]
    if pair.exact and (unique.any() or not problem.diagonal.all()):
        errors = every * abs(np.append(bound + abs(changes[0].double()), changes[1].double()))
        single = single_errors(problem, errors, np.append(pair.force.double(), pair.tie_force.double()))
        largest, missed = np.max(single.largest, initial=0.0), np.max(single.felt[problem.contacts :], initial=0.0)
    if size == 0:  # those of ties are compared directly, too; zeros of the pair may be as large as its radius
        absolute = max(max(apart for apart, *_ in found) + uncertain, missed)
        untold = float(np.max(own_forces(problem, bound, np.zeros(problem.ties)), initial=0.0)) if problem.ties else 0.0
        known = (untold if pair.exact else pair.dual_radius) <= max(vanishing, LEAST_PART * largest)
        return (absolute if known else np.inf), size, single
    return float(max(missed / largest if largest > 0 else 0.0, *(relative_error(*one) for one in found))), size, single


def relative_error(error: float, scale: float, uncertainty: float) -> float:
    """Return the error over the least possible true scale; the error with its uncertainty where the scale is zero."""
    return error + uncertainty if scale == 0 else error / (scale - uncertainty) if scale > uncertainty else np.inf


def _force_bound(
    problem: ContactProblem, answer: Answer, condensation: Condensation, pair: AdmissiblePair
) -> tuple[Vector, Mask | None]:
    """Return bounds (m,) on the errors of the pair's contact forces, and which forces of contacts and ties (m + k,) are
    unique, None where all are.

    They are (4) on contacts closed in v or within the radius, as (4) holds for any choice, and by the gap on open ones.
    With redundant rows v_i exists where a force is unique.
    """
    length = lengths_that_meet(problem, problem.normal, problem.gap, answer.displacement)
    untold = pair.dual_radius * np.sqrt(condensation.delassus.compliance[: problem.contacts]) if pair.exact else 0.0
    touches = pair.open_gap <= np.maximum(WITHIN_ROUNDING * length, untold)
    active, outside = touches.nonzero()[0], (~touches).nonzero()[0]
    saddle = saddle_point(condensation, active)
    count, bound = len(active), np.zeros(problem.contacts)
    bound[outside] = pair.dual_radius**2 / (2 * pair.open_gap[outside])
    if count:
        nothing = np.zeros((len(condensation.retained), count))
        motion, share, held = saddle.solve(nothing, np.eye(count), np.zeros((problem.ties, count)))
        moved = condensation.normal @ motion
        energy = -np.sum(moved[active] * share, axis=0) - np.sum((condensation.tie @ motion) * held, axis=0)
        rounding = len(motion) * EPS * np.sum(abs(motion) / condensation.scale[:, None], axis=0) ** 2
        own = np.sqrt(np.maximum(energy, 0.0) + rounding) * pair.dual_radius + abs(moved[outside]).T @ bound[outside]
        bound[active] = own + 2 * abs(moved[active] - np.eye(count)).T @ own
        if condensation.rigid.count:
            bound[active] += out_of_balance(problem, answer, condensation, pair, active)
    return bound, unique_forces(condensation, saddle) if saddle.redundant else None


def error_failures(bounds: Bounds, tolerance: float, nothing: float) -> Iterator[str]:
    """Yield a message for each failed bound on the whole answer; errors up to `nothing` [sqrt(energy)] are zero."""
    if bounds.suspicious is not None:
        yield f"unproven: {bounds.suspicious}"
    # Where the true size vanishes, errors are compared with the answer's energy or the strain by rounding; what is
    # negligible beside all others counts as zero, unless the contact forces are smaller.
    beside_forces = min(nothing, tolerance * bounds.force_scale) if bounds.force_scale > 0 else nothing
    strain, pushed = max(bounds.rigid_rounding, beside_forces), max(tolerance * bounds.energy_scale, nothing)
    # Undecided gaps do not strain a body that moves rigidly; they are in the bound and its uncertainty.
    forgiven_strain = bounds.free_distance + (0.0 if bounds.energy_scale > beside_forces else 2 * bounds.undecided)
    rigidly = 4 * bounds.force_rounding  # forces and their difference balance to rounding on rigid motions
    pairs = (
        ("energy_error", "displacement", bounds.energy_scale, beside_forces, strain, forgiven_strain),
        ("force_error", "contact forces", bounds.force_scale, 0.0, pushed, rigidly),
    )
    for name, what, scale, none, absolute, forgiven in pairs:
        by_energy = name == "energy_error" and bounds.by_energy  # `energy_failures` judges the energy itself
        value = bounds.apart if by_energy else getattr(bounds, name)
        if value is None:
            continue
        if scale > none:
            kind, limit, size = f"of {'its' if what == 'displacement' else 'their'} size", tolerance, scale
        else:
            value = value * (scale or 1.0)
            kind, limit, size = "in the square root of energy, where the truth is zero", absolute, 1.0
        # Forces with errors below the rounding of the refinement have no relative error.
        if not value * size <= max(limit * size, bounds.rounding) + forgiven:
            cure = STATE_MOTIONS if name == "force_error" and bounds.shared > value / 2 else ""
            yield f"{name}: the {what} may be off by {value:.3g} {kind} (tolerance {limit:.3g}){cure}"
    missed, largest = bounds.ties
    worst = None if bounds.single is None else bounds.single.worst_tie(tolerance, bounds.rounding, nothing)
    if worst is None and missed > max(tolerance * largest, bounds.rounding, nothing):
        worst = "a tie", missed / (largest or missed)
    if worst is not None:
        yield "force_error: the force of {} may be off by {:.3g} of the largest (tolerance {:.3g})".format(
            *worst, tolerance
        )


def force_bound_fails(bounds: Bounds, tolerance: float, nothing: float) -> bool:
    """Return whether the bound of a contact force exceeds the tolerance and `nothing` [sqrt(energy)]."""
    relative, single = bounds.relative_force_bound, bounds.single
    beneath = bounds.rounding / (bounds.largest_force or bounds.force_scale or np.inf)
    none = max(beneath, nothing / bounds.largest_force) if bounds.largest_force > 0 else beneath
    allowed = none if single is None else single.nothing(tolerance, beneath, none)[: single.problem.contacts]
    return not (relative is None or bounds.force_bound is None or np.all(relative <= np.maximum(tolerance, allowed)))
