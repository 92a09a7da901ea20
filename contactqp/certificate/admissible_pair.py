"""Find a displacement without penetration and forces without tension near a candidate, from which `bounds` are
computed.

The refined answer on the candidate's set of closed contacts is the solution, and the pair, if its signs hold. Otherwise
the set is corrected, or another one searched; if no set is found, the candidate is repaired by closing its contacts and
removing tensions. The bounds hold for any admissible pair, however it was found.

The least displacements and forces of a repair are computed from the rows, as products of rows with each other would
lose half of the digits of nearly dependent ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.balance import rounded_within_parts, rows_on_motions
from contactqp.certificate.figures import energy_norm, energy_norms, force_norm, residual_noise, response
from contactqp.errors import NoEquilibrium
from contactqp.linalg.condensation import Condensation, condense
from contactqp.linalg.convexity import overlap_by_rounding
from contactqp.linalg.dense import BALANCED, SaddlePoint, saddle_point
from contactqp.linalg.existence import refuse_conflict
from contactqp.linalg.extended import FINE_EPS, Extended, SparseRows, extend, extended_rows, residuals
from contactqp.linalg.floating import UNRESISTED, independent_rows, without_rounded_motion
from contactqp.linalg.least_norm import WITHIN_ROUNDING
from contactqp.linalg.measures import forces_that_meet, intrinsic_size, lengths_that_meet, of_rows, outer_forces
from contactqp.linalg.nonnegative import Infeasible, dual_active_set, least_closing, nonnegative_least_squares
from contactqp.linalg.refinement import OnSet
from contactqp.linalg.sparse_saddle import MET_TOGETHER
from contactqp.model.arrays import EPS, Array, Indices, Mask, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import BY_ENERGY, Answer

# Least-distance programming shows a conflict by a last residual below this, the rounding of its equation.
CONFLICT = 1e-14


def least_retreat(rows: Array, ties: Array, excess: Vector) -> Vector | None:
    """Minimise |w| over rows w <= -excess, ties w = 0; None if these conflict or too many steps are needed.

    Least-distance programming (Lawson and Hanson 1974, chapter 23): with G = -rows, h = excess and r the residual of
    min |[G'; h'] y - (0; 1)| over y >= 0, w_j = -r_j / r_last.
    """
    size = np.linalg.norm(rows, axis=1)
    wanted = excess / size
    largest = float(np.max(wanted))
    columns = np.hstack([-(rows / size[:, None]).T, ties.T, -ties.T])
    matrix = np.vstack([columns, np.concatenate([wanted / largest, np.zeros(2 * len(ties))])])
    unit = np.append(np.zeros(len(columns)), 1.0)
    share, residual = nonnegative_least_squares(matrix, unit)
    if np.isnan(residual):
        return None
    left = matrix @ share - unit
    return None if -left[-1] <= CONFLICT else np.asarray(largest * left[:-1] / -left[-1])


def least_forces(rows: Array, ties: Array, resultant: Vector) -> Vector | None:
    """Minimise |rows' l + ties' n - resultant| over l >= 0; None if too many steps are needed."""
    size = np.linalg.norm(rows, axis=1)
    matrix = np.hstack([(rows / size[:, None]).T, ties.T, -ties.T])
    share, residual = nonnegative_least_squares(matrix, resultant)
    if np.isnan(residual):
        return None
    return np.asarray(share[: len(rows)] / size)


# Gaps relative to their lengths, and forces relative to the largest, that count as zero in a candidate of engineering
# accuracy.
ENGINEERING_ZERO = 1e-6
# Sweeps of refinement that close contacts; each reduces the residual by eps * condition number.
CLOSING_SWEEPS = 4
# A gap below this part of its lengths is zero also in extended precision.
ZERO_GAP = 2.0**-90
# The resultant of balanced forces on a rigid motion by one or two roundings of each.
LEFT_BY_ROUNDING = 4 * EPS
# The part of an excess that may remain after a displacement in double precision.
MISSED = 1e-6
# With a smaller remainder the dependent rows do not conflict, which would leave at least half.
ROUGHLY = 0.25


@dataclass(frozen=True, eq=False)
class AdmissiblePair:
    """v with E v <= g, A v = b and forces l >= 0 in balance; w the response to l; c = (v + w)/2; u the candidate."""

    to_middle: Extended  # (n,) c - u
    radius: float  # >= |c - u*|_K
    dual_radius: float  # >= |w - u*|_K
    force: Extended  # (m,) l
    tie_force: Extended  # (k,) nu
    open_gap: Array  # (m,) g - E v
    saddle: SaddlePoint  # of the contacts that were closed for v
    exact: bool  # v and l are the solution, to rounding
    cleared: float  # relative forces by rounding of K along rigid motions
    undecided: float  # the uncertainty by contacts with gap or force of rounding size [root of energy]


class Unproven(Exception):
    """No pair was found; the exception states the reason."""


class Undecided(Unproven):
    """Nothing can be proven in double precision, whatever the answer."""


def refuse_unbalanced(
    problem: ContactProblem, answer: Answer, condensation: Condensation, pair: AdmissiblePair
) -> None:
    """Raise Undecided if the pair's forces are unbalanced on a rigid motion beyond rounding.

    An imbalance up to `BALANCED` of all forces counts as zero, as do contact forces that might carry it; the pair then
    belongs to another load, and its distance from the solution does not include them. For a refined pair the imbalance
    beyond rounding of K is computed in extended precision.

    Parameters
    ----------
    problem, answer, condensation : ContactProblem, Answer, and the Condensation of the problem
    pair : AdmissiblePair, whose forces are examined
    """
    rows, motions = extended_rows(problem), without_rounded_motion(problem, condensation.rigid.motions)
    onto = SparseRows(sp.csr_matrix(motions.T))
    outer = extend(problem.load) - rows.contact_force(pair.force, pair.tie_force)
    missed = abs((onto @ outer).double())
    solution = extend(answer.displacement) + pair.to_middle
    forces = Answer(solution.double(), pair.force.double(), None, pair.tie_force.double())
    size = abs(motions).T @ forces_that_meet(problem, forces)
    beyond = missed > max(LEFT_BY_ROUNDING, condensation.rigid.uncertainty) * size
    if pair.exact:
        stiffness = (condensation.cleared_rows(problem) if pair.cleared else rows).stiffness
        left = abs((onto @ (outer - stiffness @ solution)).double())
        rounded = EPS * abs(motions).T @ (problem.stiffness_sizes @ abs(forces.displacement))
        if problem.ties or pair.saddle.redundant:  # forces are then distributed over dependent rows in doubles
            rounded = np.maximum(rounded, LEFT_BY_ROUNDING * size)
        beyond |= left > rounded
    refined = replace(forces, displacement=np.maximum(abs(answer.displacement), abs(forces.displacement)))
    beyond &= missed > abs(motions).T @ rounded_within_parts(problem, forces_that_meet(problem, refined))
    if np.any(beyond):
        worst = int(np.argmax(np.where(beyond, missed / np.where(size > 0, size, 1.0), 0.0)))
        raise Undecided(
            f"the load drives a rigid motion by {missed[worst] / size[worst]:.1e} of the forces that meet: that counts "
            "as nothing, and so do contact forces that might carry it"
        )


def refuse_conflicting_ties(
    problem: ContactProblem, answer: Answer, condensation: Condensation, change: Extended
) -> None:
    """Raise Undecided if the answer, changed to satisfy independent ties, violates a dependent one.

    This tie contradicts the others by rounding and is left out, so that the bounds concern another value of it.

    Parameters
    ----------
    problem, answer, condensation : ContactProblem, Answer, and the Condensation of the problem
    change : (n,) Extended, what is added to the displacement
    """
    rows, refined = condensation.tie * condensation.scale, extend(answer.displacement) + change
    others = np.delete(np.arange(problem.ties), independent_rows(rows / np.linalg.norm(rows, axis=1, keepdims=True)))
    missed = abs((extend(problem.tie_value) - extended_rows(problem).tie @ refined).double())[others]
    whole = of_rows(problem, problem.tie, intrinsic_size(problem, answer, refined.double()))
    length = np.maximum(lengths_that_meet(problem, problem.tie, problem.tie_value, refined.double()), whole)[others]
    part = float(np.max(missed / np.where(length > 0, length, 1.0), initial=0.0))
    if part > MET_TOGETHER:
        raise Undecided(f"ties that depend on each other to rounding conflict by {part:.1e} of their lengths")


def believed_sets(problem: ContactProblem, answer: Answer, compliance: Vector) -> tuple[Indices, ...]:
    """Return the sets of contacts closed by gap and by force, if they differ; `compliance` (m,) is W_ii."""
    u, force = answer.displacement, answer.normal_force
    length = lengths_that_meet(problem, problem.normal, problem.gap, u)
    touching = np.flatnonzero(problem.gap - problem.normal @ u <= ENGINEERING_ZERO * length)
    size = force * np.sqrt(compliance)
    pushing = np.flatnonzero(size > ENGINEERING_ZERO * abs(size).max(initial=0.0))
    acting = np.flatnonzero(abs(size) > ENGINEERING_ZERO * abs(size).max(initial=0.0))  # possibly of the wrong sign
    return touching, pushing, acting


def searched_set(problem: ContactProblem, condensation: Condensation) -> Indices | None:
    """Return the closed contacts by a finite method, if corrections of sets cycle; None if bodies float."""
    if condensation.rigid.count:
        return None
    operator = condensation.delassus
    load, _ = condensation.reduce_load(problem.load)
    data = operator.dual_data(problem, operator.free_response(load, np.zeros(len(load))))
    try:
        force, _, ended = dual_active_set(*data, 50 * problem.contacts + 50)
    except Infeasible:
        return None
    return np.flatnonzero(force[: problem.contacts] > 0) if ended else None


def without_tension(problem: ContactProblem, condensation: Condensation, force: Extended) -> tuple[Extended, Extended]:
    """Return the change of contact forces (m,) and tie forces (k,) that removes all tensions.

    On a floating body the remaining forces must balance without the tensions, so positive forces change by the least
    amount. With l + d >= 0 on contacts that are closed for v, v and w differ only by the response of d, which is in
    (1). If no positive force can replace a tension, this is rounding of a balanced load.
    """
    push = force.double()
    dropped, tie_change = (-force).positive_part(), extend(np.zeros(problem.ties))
    Z, acting = condensation.rigid.motions, np.flatnonzero(push > 0)
    if not (Z.shape[1] and dropped.hi.any()):
        return dropped, tie_change
    rows, weight = rows_on_motions(problem, condensation, acting)
    missing = -Z.T @ (problem.normal.T @ dropped.double())
    change, *_ = np.linalg.lstsq(rows.T, missing, rcond=None)
    size = abs(Z).T @ (abs(problem.normal).T @ dropped.double()) + abs(rows).T @ abs(change)
    if np.any(abs(rows.T @ change - missing) > BALANCED * size):
        return dropped, tie_change
    change = change * weight
    changed = dropped.added_at(acting, change[: len(acting)])
    if np.any((force + changed).double()[acting] < 0):
        return dropped, tie_change
    return changed, tie_change + change[len(acting) :]


def of_noise(problem: ContactProblem, condensation: Condensation, on_set: OnSet, length: Vector) -> float:
    """Bound the uncertainty by dependent contacts whose gaps are zero only to extended precision.

    Forces l over gaps d of undecided sign leave an uncertainty of sqrt(2 l'd). Gaps are relative to the lengths that
    meet, or to the intrinsic size if these are rounding.

    Parameters
    ----------
    problem, condensation : ContactProblem, and its Condensation
    on_set : OnSet, the refined answer
    length : (m,) array [length], the lengths that meet at the contacts
    """
    gap, force = on_set.gaps, np.maximum(on_set.doubles.normal_force, 0.0)
    moved = condensation.rigid.without_rigid_part(on_set.doubles.displacement, problem.diagonal)
    whole = intrinsic_size(problem, on_set.doubles, moved)
    length = np.maximum(length, of_rows(problem, problem.normal, whole))
    pushing = np.flatnonzero((force > 0) & np.isfinite(length))
    measure = abs(gap) / np.where(length > 0, length, 1.0)
    hidden = np.append(measure[pushing], measure[(gap < 0) & (measure <= ZERO_GAP)])
    return float(np.sqrt(2 * hidden.max(initial=0.0) * (force[pushing] @ length[pushing])))


def of_penetration(
    problem: ContactProblem, condensation: Condensation, on_set: OnSet, excess: Vector, length: Vector
) -> float:
    """Bound the distance of the solution from an answer u' whose contacts are penetrated by `excess` d >= 0 (m,).

    u' solves the problem with the gaps g + d. Let w be the least displacement with E w = -d where d > 0 and E w = 0 on
    the other closed contacts, A w = 0. Then u* - w is the solution in these gaps under the load f - K w, and the
    solution depends on the load with constant one in the energy norm: |u* - u'| <= 2 |w|.

    With dependent contacts there may be no such w. For any with E w <= -d, A w = 0 the displacement u' + w is
    admissible, and u* is so in the wider gaps, where u' has the forces l':

        |u* - u'|^2 <= 2 J(u*) - 2 J(u') <= 2 J(u' + w) - 2 J(u') = |w|^2 - 2 l'E w

    Parameters
    ----------
    problem, condensation : ContactProblem, and its Condensation
    on_set : OnSet, the refined answer u'
    excess, length : (m,) arrays [length], d and the lengths that meet at the contacts

    Raises
    ------
    Undecided
        Neither displacement exists, as nearly dependent contacts conflict by more than rounding of the refinement.
    """
    closed = np.union1d(on_set.saddle.closed, np.flatnonzero(excess)).astype(np.intp)
    # A grazing contact at no distance, as a bound of zero, has no length but rounding: the size of the answer is one.
    moved = condensation.rigid.without_rigid_part(on_set.doubles.displacement, problem.diagonal)
    whole = of_rows(problem, problem.normal, intrinsic_size(problem, on_set.doubles, moved))
    measure = np.maximum(length, whole)[closed]
    measure[measure == 0] = 1.0
    largest = float(np.max(excess[closed] / measure))

    def left_by(displacement: Vector) -> Vector:
        return np.asarray((excess + problem.normal @ displacement)[closed] / measure / largest)

    nothing = np.zeros(problem.dimension), -excess[closed], np.zeros(problem.ties)
    saddle = saddle_point(condensation, closed)
    closing, _, _ = condensation.correction(saddle, *nothing)
    if not saddle.redundant or np.max(abs(left_by(closing))) <= MISSED:
        return 2 * sum(energy_norm(problem, extend(closing)))
    _, unloaded = condensation.reduce_load(np.zeros(problem.dimension))
    rows, ties = condensation.normal[closed], condensation.tie
    back = least_retreat(rows * condensation.scale, ties * condensation.scale, excess[closed])
    if back is not None:
        retreat = condensation.expand(condensation.scale * back, unloaded)
        if np.max(left := left_by(retreat)) <= MISSED:
            return _by_retreat(problem, condensation, on_set, retreat, closed, abs(left) <= MISSED)
    far = least_closing(rows * condensation.scale, ties * condensation.scale, excess[closed])
    closing = condensation.expand(condensation.scale * far, unloaded)
    # A gap within the last correction of refinement is not a conflict, as that is part of the radius.
    refined = bool(np.all(excess <= on_set.nothing[: len(excess)]))
    if refined or np.max(abs(left_by(closing))) <= ROUGHLY:
        return 2 * sum(energy_norm(problem, extend(closing)))
    raise Undecided(f"closed contacts that depend on each other to rounding conflict by {largest:.1e} of their lengths")


def _by_retreat(
    problem: ContactProblem,
    condensation: Condensation,
    on_set: OnSet,
    retreat: Vector,
    closed: Indices,
    exactly: Mask,
) -> float:
    """Return the smaller of two bounds by a displacement w with E w <= -d, E w = -d on the contacts of `exactly`.

    One is that of `of_penetration`. For the other, forces l on contacts of `exactly` only, with the response of l',
    make u' the solution also in the gaps g - E w, and |u* - u'| <= 2 |w|; the difference of responses, |l' - l|_W, is
    added.
    """
    force, held = on_set.normal_force.positive_part(), closed[exactly]
    size = sum(energy_norm(problem, extend(retreat)))
    work = force.double() @ np.maximum(-(problem.normal @ retreat), 0.0)
    by_energy = float(np.hypot(size, np.sqrt(2 * work)))
    scale, resultant = condensation.scale, force.double() @ condensation.normal
    elsewhere = least_forces(condensation.normal[held] * scale, condensation.tie * scale, resultant * scale)
    if elsewhere is None:
        return by_energy
    moved = np.zeros(problem.contacts)
    moved[held] = elsewhere
    return min(by_energy, 2 * size + sum(force_norm(problem, condensation, force - extend(moved))))


def from_repair(problem: ContactProblem, answer: Answer, condensation: Condensation, closed: Indices) -> AdmissiblePair:
    """Return the pair of v, the candidate with its contacts closed, and l, its forces without tension, balanced.

    Parameters
    ----------
    problem, answer, condensation : ContactProblem, Answer, and the Condensation of the problem
    closed : (q,) array of int, the contacts that the answer holds closed
    """
    rows = extended_rows(problem)
    to_feasible, saddle = _close(problem, answer, condensation, closed)
    force, tie = _admissible_forces(problem, answer, condensation)
    residual = extend(problem.load) - rows.stiffness @ extend(answer.displacement) - rows.contact_force(force, tie)
    to_dual, last = response(problem, condensation, residual, tied=False)
    gap = (extend(problem.gap) - rows.normal @ (extend(answer.displacement) + to_feasible)).double()
    held = np.zeros(problem.contacts, dtype=bool)
    held[saddle.closed] = True
    if saddle.redundant:  # dependent contacts may stay open
        refuse_conflicting_ties(problem, answer, condensation, to_feasible)
        dependent = np.delete(saddle.closed, saddle.independent[saddle.independent < len(saddle.closed)])
        length = lengths_that_meet(problem, problem.normal, problem.gap, answer.displacement)
        held[dependent] = gap[dependent] <= ZERO_GAP * length[dependent]
    room = np.where(held, 0.0, np.maximum(gap, 0.0))
    allowance = last + residual_noise(problem, answer)
    apart = energy_norms(problem, condensation, to_feasible - to_dual)[1] + allowance
    slack = float(force.double() @ room)
    return AdmissiblePair(
        to_middle=(to_feasible + to_dual).times(0.5),
        radius=float(np.sqrt(apart**2 / 4 + slack)) + allowance,
        dual_radius=float(np.sqrt(apart**2 + 2 * slack)) + allowance,
        force=force,
        tie_force=tie,
        open_gap=room,
        saddle=saddle,
        exact=False,
        cleared=0.0,
        undecided=0.0,
    )


def _close(
    problem: ContactProblem, answer: Answer, condensation: Condensation, closed: Indices
) -> tuple[Extended, SaddlePoint]:
    """Return the nearest displacement in energy that closes a set, enlarged by the contacts that it penetrates."""
    rows = extended_rows(problem)
    start = extend(answer.displacement)
    length = lengths_that_meet(problem, problem.normal, problem.gap, answer.displacement)
    for _ in range(problem.contacts + 1):
        saddle = saddle_point(condensation, closed)
        step = extend(np.zeros(problem.dimension))
        for _ in range(CLOSING_SWEEPS):
            gap = rows.gap(problem, start + step)
            open_tie = (extend(problem.tie_value) - rows.tie @ (start + step)).double()
            step = step + condensation.correction(saddle, np.zeros(len(start)), gap.double()[closed], open_tie)[0]
        gap = rows.gap(problem, start + step)
        penetrated = np.flatnonzero(-gap.double() > WITHIN_ROUNDING * length)
        if not penetrated.size:
            return step, saddle
        larger = np.union1d(closed, penetrated).astype(np.intp)
        if len(larger) == len(closed):
            break
        closed = larger
    raise Unproven("the candidate could not be repaired to a displacement that penetrates nowhere")


def _admissible_forces(
    problem: ContactProblem, answer: Answer, condensation: Condensation
) -> tuple[Extended, Extended]:
    """Return the candidate's forces without tension, with the least change that balances every rigid motion."""
    force, tie = np.maximum(answer.normal_force, 0.0), answer.tie_force
    Z = condensation.rigid.basis
    if not Z.shape[1]:
        return extend(force), extend(tie)
    acting = np.flatnonzero(force > 0)
    rows = np.vstack([problem.normal[acting] @ Z, problem.tie @ Z])
    missing = Z.T @ (problem.load - problem.normal.T @ force - problem.tie.T @ tie)
    change, *_ = np.linalg.lstsq(rows.T, missing, rcond=None)
    force = force.copy()
    force[acting] += change[: len(acting)]
    tie = tie + change[len(acting) :]
    left = Z.T @ (problem.load - problem.normal.T @ force - problem.tie.T @ tie)
    size = abs(Z).T @ (abs(problem.load) + abs(problem.normal).T @ force + abs(problem.tie).T @ abs(tie))
    if np.any(force < 0) or np.any(abs(left) > BALANCED * size):
        raise Unproven("no forces near the candidate's balance the load on every rigid motion")
    return extend(force), extend(tie)


def bounds_apart(
    problem: ContactProblem, answer: Answer, elastic: Mask, condensed: Callable[..., Any], by_energy: Any
) -> Any:
    """Return the bounds of elastic parts, and those on forces in the others, where all energy norms vanish.

    Parameters
    ----------
    problem, answer, elastic : ContactProblem, Answer, and (n,) array of bool, the unknowns of parts with stiffness
    condensed, by_energy : return Bounds of a part from its data; the latter those without stiffness, or it is None
    """
    found, single = [], None
    for mask in (elastic, ~elastic):
        unknowns = np.flatnonzero(mask)
        contacts, ties = (np.unique(rows[:, unknowns].tocoo().row) for rows in (problem.normal, problem.tie))
        part = _part(problem, unknowns, contacts, ties)
        own = Answer(answer.displacement[unknowns], answer.normal_force[contacts], None, answer.tie_force[ties])
        its = condensed(part, own, residuals(part, own), condensation := condense(part))
        if by_energy is not None and mask is not elastic:
            its = by_energy(part, own, its, condensation.rigid)
        single = single if its.single is None else its.single.among(problem, (contacts, ties), single)
        found.append((unknowns, contacts, its))
    bounds, rigid = (one for *_, one in found)
    bound, relative, solution = np.zeros(problem.contacts), np.zeros(problem.contacts), None
    if bounds.solution is not None and rigid.solution is not None:
        solution = Extended(np.zeros(problem.dimension))
    for at, contacts, one in found:
        bound[contacts] = np.nan if one.force_bound is None else one.force_bound
        relative[contacts] = 0.0 if one.relative_force_bound is None else one.relative_force_bound
        if solution is not None:
            solution.hi[at], solution.lo[at] = one.solution.hi, one.solution.lo
    return replace(
        bounds,
        energy_error=None if rigid.energy_error is None else bounds.energy_error,
        force_error=None if rigid.force_error is None else bounds.force_error,
        force_bound=None if len(bound) and np.isnan(bound).all() else bound,
        relative_force_bound=relative,
        ties=max(bounds.ties, ((rigid.force_error or 0.0) * rigid.force_scale * (problem.ties > 0), rigid.force_scale)),
        single=single,
        solution=solution,
        determined=BY_ENERGY if BY_ENERGY in (bounds.determined, rigid.determined) else bounds.determined,
        suspicious=bounds.suspicious or rigid.suspicious,
        reasons=tuple(dict.fromkeys((*bounds.reasons, *rigid.reasons))),
    )


def _part(problem: ContactProblem, unknowns: Indices, contacts: Indices, ties: Indices) -> ContactProblem:
    """Return the problem of these unknowns alone, with the contacts and ties that act there."""
    K = sp.csr_array(problem.stiffness_rows)[unknowns][:, unknowns]
    return ContactProblem(
        K if sp.issparse(problem.stiffness) else K.toarray(), problem.load[unknowns],
        problem.normal[contacts][:, unknowns], problem.gap[contacts],
        tie=problem.tie[ties][:, unknowns], tie_value=problem.tie_value[ties],
        contact_names=[problem.contact_name(int(i)) for i in contacts],
    )  # fmt: skip


def conflict_of_constraints(problem: ContactProblem, condensation: Condensation) -> str | None:
    """Return a text on constraints that provably conflict, so that no answer is right, else None."""
    try:
        refuse_conflict(problem, condensation)
    except NoEquilibrium as conflict:
        return str(conflict)
    return overlap_by_rounding(problem)


def out_of_balance(
    problem: ContactProblem, answer: Answer, condensation: Condensation, pair: AdmissiblePair, active: Indices
) -> Vector:
    """Return the imbalance by rounding on rigid motions, as forces (q,) of the active contacts.

    Such forces do not change gaps and are therefore not in (4). Refined forces are balanced to FINE_EPS of all forces
    that meet, including |K||u| of a large motion, those of a repair to eps of the outer forces.

    Parameters
    ----------
    problem, answer, condensation : ContactProblem, Answer, and the Condensation of the problem
    pair : AdmissiblePair, whose forces they are
    active : (q,) array of int, the contacts that are closed in it
    """
    motions = condensation.rigid.motions
    solution = (extend(answer.displacement) + pair.to_middle).double()
    forces = Answer(solution, pair.force.double(), None, pair.tie_force.double())
    imbalance = FINE_EPS * forces_that_meet(problem, forces) if pair.exact else EPS * outer_forces(problem, forces)
    rows, weight = rows_on_motions(problem, condensation, active)
    rows[abs(rows) <= UNRESISTED] = 0.0  # rounding of rows orthogonal to a motion
    share = np.linalg.pinv(rows.T, rcond=UNRESISTED) @ np.diag(abs(motions).T @ imbalance)
    return np.asarray((weight * np.sum(abs(share), axis=1))[: len(active)])
