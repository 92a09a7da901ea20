"""Prove bounds on the distance of an answer with friction from an equilibrium, if it is unique or the only one nearby.

Coulomb's law is not a minimisation, but the distance of a candidate to any equilibrium is bounded by its violations of
the law. Let W be the compliance of all contact rows (W_NN and W_TT its blocks of normal and tangential rows), |v|_K^2 =
v'Kv and |d|_W^2 = d'Wd. Of forces l let w be their displacement, K w = f - E'l - A'nu, A w = b, with gaps g_i and slips
s_i; of an equilibrium u*, l* likewise g* and s*. With d = l - l*, W d is (g - g*, s* - s), and

    |w - u*|_K^2 = |d|_W^2 = sum over i of d_N (g - g*) - d_T.(s - s*).                                     (1)

Write l = h + z, where h has h_N >= 0, |h_T| <= mu h_N, h_N = 0 where a contact is open, and h_T = mu h_N s/|s| where it
slips, and e = h - l*. Signorini's law for l* (l*_N g* = 0, both at least 0) gives, contact by contact,

    e_N (g - g*) <= |e_N| t,    t = |g| where closed, (-g)+ where open,                                     (2)

and Coulomb's, l*_T.s* = mu l*_N |s*| and |l*_T| <= mu l*_N, gives

    -e_T.(s - s*) <= mu e_N (|s*| - |s|) <= mu |e_N| |(Wd)_T|                    open or slipping,          (3)
    -e_T.(s - s*) <= |e_T| |s| + mu |e_N| (|s| + |(Wd)_T|)                       sticking.                  (4)

With |d_N,i| <= V_i |d|_W, V_i^2 = (W^-1)_NN,ii, the same for tangents, |(Wd)_T,i| <= w_i |d|_W, and Necas's constant
kappa (`critical_friction`), by which sum mu_i |d_N,i| |(Wd)_T,i| <= kappa |d|_W^2, (1) becomes

    (1 - kappa) |d|_W^2 <= b |d|_W + c,                                                                     (5)

with b and c sums of the violations of l: t, |s| of sticking contacts and z. For kappa < 1 this bounds the distance to
every equilibrium, in the plane and in space: `scope` is "global". It is applied to the answer of the candidate's own
combination of open, stick and slip, refined in twice double precision, for which b and c are rounding; the distance of
the candidate to that answer is added.

If kappa is not below 1, the combination itself is examined. If every sign holds by a margin, an equilibrium nearer than
r, the least margin over its V_i or w_i, has the same combination: what is open stays open, so that d acts on the closed
contacts alone, in the plane with d_T = mu d_N s where they slip, and V_i^2 is that of the remaining rows. That
combination has one answer: in the plane that of a linear system, in space if a smaller constant of the slipping
contacts only (`slips_nearby`) is below 1: slips are then the only zero of a continuous, strongly monotone map on a
ball, which exists (Brouwer), since the residual of the refined slips is less than the growth of the map within the
ball; otherwise by Newton and Kantorovich, see `SlipsNearby.settled`. `scope` is "local", `radius` is r in the energy
norm.

Where some contacts have no margin (at a border of stick and slip, closed without force), r is the least margin of the
others. These keep their states, and are eliminated: d = T d_L, and W' d_L are the gaps and slips of the contacts L at
the borders, and in space of those that slip. (2) to (5) hold for d_L on W' in the norm of its symmetric part H,
whatever the states of L, with another kappa: where that is below 1 one equilibrium at most is nearer than r. It exists:
as W' is positive definite, forces with given friction bounds are unique, at most |q|, and continuous in the bounds
(Brouwer); its distance is at most that of (5) times the largest |T d|_W / |d|_H, which is less than r.

In the plane, with few contacts, the only equilibrium nearby is the only one where the determinants of all combinations
have one sign (`critical_friction`): `scope` is then "global", too.

A body held by contacts only has no W. Differences d balance on it, and (1) to (5) hold with the W, norms and kappa of
`force_norms.BalancedForces`, with w displaced rigidly such that rows determined by balance have no error. Contacts that
keep their states by more than the resulting bound do so in every answer; if they determine the position of the bodies,
the scope is "global". An equilibrium exists if no rigid motion slides contacts with friction, since balance then admits
normal forces for any friction bounds (Kakutani), or if the answer has a margin. Otherwise "nearer than r" is meant in
the norm of M = S + A'A + Z Z' on the retained unknowns, in which springs fix the rigid motions Z
(`contactqp.linalg.delassus`): |R_i v| <= w_i |v|_M with w_i^2 = R_i M^-1 R_i', and forces y of closed contacts and ties
B, which balance on Z, satisfy y'B M^-1 B'y <= y'B S^+ B'y = |v|_K^2, so that V_i^2 = ((B M^-1 B')^-1)_ii bounds them.
As S_jj <= K_jj, |v|_M is at most the norm of v'Kv + sum K_jj v_j^2, in which `radius` is then stated, reduced for
unknowns without stiffness (`part_that_is_seen`).

Rounding allowance: w is formed by one more refinement, whose correction is counted twice in every gap and slip; kappa,
V_i and w_i are increased for rounding of W, by the pivots of its factors, and for the effect of rounding of a soft
stiffness on W (`contactqp.linalg.delassus`). It is an a-posteriori estimate, not an interval enclosure. With free rigid
motions, "local" holds up to these; if contacts slip along such a motion, rounding would decide whether friction
balances the load, and nothing is claimed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from contactqp.certificate.bounds import NEXT_TO_NOTHING, Bounds, no_bounds, relative_error
from contactqp.certificate.coulomb_law import onto_discs
from contactqp.certificate.critical_friction import (
    KAPPA,
    MOST_UNKNOWNS,
    WITHOUT_STIFFNESS,
    SlipsNearby,
    acting_rows,
    critical,
    felt_rows,
    inverse_of_lower,
    slips_nearby,
    too_many,
)
from contactqp.certificate.force_norms import (
    BalancedForces,
    Eliminated,
    ForceNorms,
    balanced_forces,
    eliminated,
    margins_of,
    norms_of_all_rows,
    norms_of_skew,
    over,
    part_that_is_seen,
    rigid_uncertainty,
    rows_with_friction,
    wedged,
)
from contactqp.certificate.state_bodies import (
    LAW_ROUNDING,
    Compared,
    RefinedLengths,
    refined_lengths,
    refined_local_lengths,
    with_rounding_of_motions,
)
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.delassus import ContactCompliance, ContactOperators, contact_compliance, refined_forces
from contactqp.linalg.extended import extend
from contactqp.linalg.measures import directions, lengths, own_compliance
from contactqp.model.arrays import ROUNDED_UP, Array, Mask, Vector
from contactqp.model.coulomb import OPEN, Status
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import GLOBALLY, LOCALLY, Answer

# The largest asymmetry of local problems that counts as rounding.
SYMMETRIC = 1e-15
FLOATS = "a body is held by contacts alone"
# A contact is at a border of states if its distance from another state is below this part of the largest, or this many
# times smaller than that of the answer.
AT_BORDER, FAR_ENOUGH = 1e-9, 4.0
ROWS_DEPEND = "contact rows depend on one another, or nearly: compliance has no inverse"
WEDGED = "ties close a contact with friction, which may press with any force"
NO_MARGIN = "a contact is within rounding of another state"
SLIDES_FREELY = "contacts slip along a motion that nothing else resists: rounding decides whether friction balances it"


def frictional_bounds(
    problem: ContactProblem, condensation: Condensation, answer: Answer, compared: Compared
) -> Bounds:
    """Return bounds of an answer that was compared with that of its own combination, or reasons for having none.

    Parameters
    ----------
    problem, condensation, answer : the problem, its condensation, and what is judged
    compared : with the refined answer of the combination
    """
    found = _proven(problem, condensation, answer, compared)
    if not isinstance(found, str) and condensation.rigid.count:
        found = with_rounding_of_motions(problem, condensation, compared, found)
    return no_bounds(f"friction: {found}") if isinstance(found, str) else found


def _proven(problem: ContactProblem, condensation: Condensation, answer: Answer, compared: Compared) -> Bounds | str:
    if (reason := too_many(problem, condensation, nearby=True)) is not None:
        return reason
    others = too_many(problem, condensation)  # reason why other equilibria far away are not excluded
    compliance = contact_compliance(problem, condensation)
    if compared.refined.redundant:
        return ROWS_DEPEND
    refined = refined_lengths(problem, condensation, compared, compliance)
    if refined is None:
        return "its refined answer leaves ties unmet"
    kappa, mu = np.inf, _coefficient(problem, compared)
    if others is None and not compliance.floats:
        norms = ForceNorms.of(compliance, condensation.lost_digits, rows_with_friction(compliance, mu))
        if norms is not None:
            kappa = critical(problem, condensation).kappa * (1 + norms.allowance)
        if norms is not None and kappa < 1:
            error = _distance(refined, norms, compared.status, mu, kappa)
            return _bounds(problem, answer, compared, norms, compliance, error)
    elif others is None:
        balanced = balanced_forces(compliance, mu, refined, condensation.lost_digits)
        if balanced is not None and (found := _balanced_distance(problem, compared, refined, balanced)) is not None:
            return _bounds(problem, answer, compared, balanced.norms, compliance, found)
    unique = others is None and (of_all := critical(problem, condensation)).unique and of_all.examined != KAPPA
    others = others or (FLOATS if compliance.floats else f"kappa = {kappa:.3g}")
    nearby = _proven_nearby(problem, condensation, answer, compared, refined, others)
    return nearby if isinstance(nearby, str) or not unique else replace(nearby, scope=GLOBALLY, radius=None)


def _balanced_distance(
    problem: ContactProblem, compared: Compared, refined: RefinedLengths, balanced: BalancedForces
) -> float | None:
    """Bound |d|_W for bodies held by contacts only; None if kappa is not below one, or their position is undetermined.

    Contacts whose forces keep their state by more than the bound do so in every answer and determine the position.
    """
    mu, norms = _coefficient(problem, compared), balanced.norms
    if not balanced.kappa < 1:
        return None
    error = _distance(refined, norms, compared.status, mu, balanced.kappa, (balanced.gap, balanced.slip))
    closed = refined.normal > error * norms.normal_force
    sticks = closed & (refined.room(mu) > error * (mu * norms.normal_force + norms.tangential_force))
    exists = balanced.always or np.all(margins_of(refined, norms, compared.status, mu) > error)
    return error if exists and balanced.settled_by(closed, sticks) else None


def _proven_nearby(
    problem: ContactProblem,
    condensation: Condensation,
    answer: Answer,
    compared: Compared,
    refined: RefinedLengths,
    others: str,
) -> Bounds | str:
    """Return the local statement if every sign holds by a margin, else the reason why there is none.

    Parameters
    ----------
    refined : the refined answer of the combination that the candidate was compared with
    others : why there is no global statement
    """
    compliance, mu = contact_compliance(problem, condensation), _coefficient(problem, compared)
    norms = ForceNorms.nearby(compliance, condensation.lost_digits, compared.status, mu)
    if norms is None:
        return ROWS_DEPEND
    others = f"other equilibria are not excluded ({others})"
    if wedged(compliance, mu, refined):
        return f"{others}, and {WEDGED}"
    uncertain, apart, seen, free = refined.correction, 0.0, 1.0, False
    if compliance.floats:
        if not (seen := part_that_is_seen(problem, condensation, mu, refined)):
            return WITHOUT_STIFFNESS
        more, free = rigid_uncertainty(compliance, compared.status, refined, mu)
        if not np.isfinite(more):
            return f"{others}, and {SLIDES_FREELY}"
        uncertain += more
        moved = (extend(answer.displacement) - compared.refined.displacement).double()
        apart = float(np.sqrt(problem.diagonal @ moved**2))
    margin = float(np.min(margins_of(refined, norms, compared.status, mu), initial=np.inf)) - uncertain
    slips = slips_nearby(compliance, compared.status, mu)
    near = _nearest(slips, refined, norms, 2 * compared.last + uncertain, margin)
    if isinstance(near, float):
        return f"{others}, nor others nearby ({near:.3g})"
    error, reach = near[0], near[1] * float(np.sqrt(seen))
    pushed = compared.force * (1 + norms.allowance)
    around = max(float(np.hypot(compared.displacement, apart)), pushed) + error
    radius = reach - around
    if not radius > around:
        at = None
        if not compliance.floats:
            at = _at_borders(compliance, compared.status, mu, refined, condensation.lost_digits, around)
        if at is None:
            return f"{others}, and {NO_MARGIN}"
        norms, error, radius = at
    found = _bounds(problem, answer, compared, norms, compliance, error)
    return replace(found, scope=LOCALLY, radius=radius, free=free)


def _nearest(
    slips: SlipsNearby | None, refined: RefinedLengths, norms: ForceNorms, left: float, margin: float
) -> tuple[float, float] | float:
    """Return a bound on the distance of the only equilibrium in its states and the radius without others, or the
    constant.

    Parameters
    ----------
    slips : those of contacts that slip in these states, None where they have no compliance
    refined, norms : the refined answer of the states, and the norms of forces on rows that act in them
    left : what its refinement leaves, in the norm of the answers
    margin : how far contacts are from other states
    """
    if slips is None:
        return np.inf
    nearby, slides = slips.kappa * (1 + norms.allowance), slips.slides
    force = refined.friction[slides]
    missed = slips.mu[:, None] * refined.normal[slides, None] * directions(refined.slip[slides]) - force
    off = np.linalg.norm(missed, axis=1) + LAW_ROUNDING * np.linalg.norm(force, axis=1)
    if nearby < 1:
        return (left + (1 + norms.allowance) * float(slips.widest @ off)) / (1 - nearby), margin
    found = slips.settled(refined.normal[slides], refined.slip[slides], norms.allowance, margin)
    if found is None:
        return nearby
    # Residuals of refinement change slips, mapped to y by J^-1 (J - I), and forces, mapped by J^-1.
    left = left * slips.growth
    error = ((1 + 2 * found.inverse) * left + float(found.spread @ off)) / found.slack
    return (error, found.radius) if error < found.radius else nearby


def _at_borders(
    compliance: ContactOperators, status: Status, mu: Vector, refined: RefinedLengths, lost_digits: float, around: float
) -> tuple[ForceNorms, float, float] | None:
    """Return norms, the distance of the only equilibrium nearby and the radius if some contacts have no margin.

    All others keep their states within the radius and are eliminated; for the remaining contacts, and in space slipping
    ones, (5) applies on W' of `eliminated` in any states. None if its constant is not below one.

    Parameters
    ----------
    compliance, refined : the operators, forces and lengths of all contacts
    status, mu : their states and coefficients (m,)
    lost_digits : by which W is rounded
    around : how far the refined answer is from the one that is judged
    """
    rows = acting_rows(compliance, status, mu)
    norms = ForceNorms.of(compliance, lost_digits, rows)
    if norms is None:
        return None
    margins = margins_of(refined, norms, status, mu)
    border = margins <= FAR_ENOUGH * around + AT_BORDER * float(np.max(margins[np.isfinite(margins)], initial=0.0))
    law = border | ((abs(status) == 1) & (mu > 0) & (refined.slip.shape[1] > 1))
    found = eliminated(compliance, status, mu, law) if border.any() else None
    norms = ForceNorms.of(compliance, lost_digits, rows | (felt_rows(compliance) & border[:, None]))
    if found is None or norms is None:
        return None
    none = np.zeros((len(found.W), 0))
    rounding = max(lost_digits, compliance.rounding) * found.growth
    half = ContactOperators((found.W + found.W.T) / 2, none, none[:0], compliance.scale[law], 0, found.W.diagonal())
    own, kappa = norms_of_skew(half, found.W, mu[law], rounding)
    if own is None or not kappa < 1:
        return None
    error = _error_at_borders(compliance.W, (norms, own), refined, found, (status, mu, law), kappa)
    margin = float(np.min(margins_of(refined, norms, status, mu)[~border], initial=np.inf)) - refined.correction
    radius = margin - around - error
    return (norms, error, radius) if radius > around + error else None


def _error_at_borders(
    W: Array,
    norms: tuple[ForceNorms, ForceNorms],
    refined: RefinedLengths,
    found: Eliminated,
    law: tuple[Status, Vector, Mask],
    kappa: float,
) -> float:
    """Bound |l - l*|_W from the refined forces l to those of the equilibrium that has `law` at the borders.

    Forces equal to l on `law` that satisfy the conditions of their states elsewhere differ from l by M^-1 times its
    residuals there. From these to l* the difference is T d of (5) for `law`, whose lengths also change.

    Parameters
    ----------
    W : that of all contacts
    norms : of the rows that act, and of those of `law` in the norm of the symmetric part of W'
    refined : forces and lengths of all contacts
    found, kappa : W' and its constant
    law : states and coefficients of all contacts, and which have the law
    """
    (of_all, own), (status, mu, at) = norms, law
    m, d = len(mu), refined.slip.shape[1] + 1
    uncertain = np.column_stack([of_all.gap, *[of_all.slip] * (d - 1)]) * refined.correction
    missed = (abs(np.column_stack([refined.gap, refined.slip])) + uncertain).ravel()
    off = np.zeros((m, d))
    drag = refined.friction - (mu * status * refined.normal)[:, None]
    slides = (abs(status) == 1) & (mu > 0) & ~at
    off[slides, 1:] = (abs(drag) + LAW_ROUNDING * abs(refined.friction))[slides]
    size, kept = abs(W), np.arange(m * d).reshape(m, d)[at].ravel()
    changed = found.inverse @ (missed[found.held] + size[found.held] @ off.ravel())
    moved = (found.response @ changed + size[kept] @ off.ravel()).reshape(-1, d) + uncertain[at]
    parts = over(moved[:, 0], own.gap), over(lengths(moved[:, 1:]), own.slip)
    there = (refined.normal[at], refined.friction[at], refined.gap[at], refined.slip[at])
    distance = _distance(RefinedLengths(*there, float(np.max(parts))), own, status[at], mu[at], kappa)
    factor = inverse_of_lower(np.linalg.cholesky((found.W + found.W.T) / 2))
    grown = float(np.sqrt(np.max(np.linalg.eigvalsh(factor @ found.energy @ factor.T))))
    left = np.sqrt(changed @ found.own @ changed) + np.sqrt(off.ravel() @ size @ off.ravel())
    return (1 + own.allowance) * grown * distance + float(left) + refined.correction


def _distance(
    refined: RefinedLengths,
    norms: ForceNorms,
    status: Status,
    mu: Vector,
    kappa: float,
    uncertain: tuple[Vector, Vector] | None = None,
) -> float:
    """Bound |d|_W from the refined forces to those of any equilibrium, by (5), and add |u - w|_K.

    Parameters
    ----------
    refined, norms, kappa : forces and lengths, the norms of differences, and Necas's constant
    status, mu : states and coefficients (m,)
    uncertain : by which gaps and slips (m,) may be off; what the correction makes of them unless given
    """
    more = refined.correction
    off_gap, off_slip = (more * norms.gap, more * norms.slip) if uncertain is None else uncertain
    closed, slides = status != OPEN, (abs(status) == 1) & (mu > 0)
    held = np.where(closed, np.maximum(refined.normal, 0.0), 0.0)  # h_N
    tension = abs(refined.normal - held)
    gap = np.where(closed, abs(refined.gap), np.maximum(-refined.gap, 0.0))
    gap = np.where(closed | (refined.gap < off_gap), gap + off_gap, 0.0)  # t
    bound = mu * held
    moved = np.maximum(lengths(refined.slip) - off_slip, 0.0)
    still = lengths(refined.slip) + off_slip
    # Slipping: h_T along the slip, whose direction has an error by rounding.
    turned = np.divide(2 * off_slip, moved, out=np.full_like(moved, np.inf), where=moved > 0)
    in_space = refined.slip.shape[1] > 1  # where directions are doubles
    along = lengths(refined.friction - bound[:, None] * directions(refined.slip)) + bound * np.minimum(turned, 2.0)
    along += in_space * LAW_ROUNDING * bound
    # Sticking: h_T is the nearest point of the disc, and slips count as errors.
    within = lengths(refined.friction - onto_discs(refined.friction, bound))
    within += np.where(refined.room(mu) < 0, LAW_ROUNDING * bound, 0.0)
    as_slipping = along * norms.slip
    as_sticking = within * norms.slip + still * (norms.tangential_force + mu * norms.normal_force)
    sticks = closed & (mu > 0) & ~(slides & (as_slipping <= as_sticking))
    off = np.where(closed & (mu > 0), np.where(sticks, within, along), lengths(refined.friction))  # |z_T|
    slip = np.where(sticks, still, 0.0)
    b = np.sum(
        norms.normal_force * (gap + mu * slip)
        + norms.tangential_force * slip
        + tension * (np.where(tension > 0, norms.gap, 0.0) + mu * norms.slip)
        + off * norms.slip
    )
    c = np.sum(tension * (gap + mu * slip) + off * slip)
    room = 1 - kappa
    return float((b + np.sqrt(b * b + 4 * room * c)) / (2 * room) + more)


def _coefficient(problem: ContactProblem, compared: Compared) -> Vector:
    return np.where(compared.frictional, 0.0 if problem.friction is None else problem.friction, 0.0)


def _bounds(
    problem: ContactProblem,
    answer: Answer,
    compared: Compared,
    norms: ForceNorms,
    compliance: ContactCompliance,
    distance: float,
) -> Bounds:
    """Return the bounds of an answer from the error bound of its combination's refined answer."""
    found, m, more = compared.refined, problem.contacts, norms.allowance
    moved, pushed = compared.displacement + distance, compared.force * (1 + more) + distance
    # Without strain, or without contact force, that error is absolute; if this is uncertain, there is none.
    least = NEXT_TO_NOTHING * max(compared.strain, compared.size)
    strain, size = (part if part > least else 0.0 for part in (compared.strain, compared.size))
    known = distance <= least
    energy_error = relative_error(moved, strain, distance + compared.unsure) if strain or known else np.inf
    force_error = relative_error(pushed, size, distance + more * size) if size or known else np.inf
    given = np.zeros(len(found.friction_force.hi)) if answer.friction_force is None else answer.friction_force.ravel()
    apart_in_friction = (extend(given) - found.friction_force).double().reshape(m, -1)
    apart_in_friction = np.where(compared.frictional[:, None], apart_in_friction, 0.0)
    apart = np.column_stack([(extend(answer.normal_force) - found.normal_force).double(), apart_in_friction])
    bound = lengths(apart) + distance * norms.force / compliance.scale
    own = np.sqrt(own_compliance(problem, problem.normal))
    return Bounds(
        energy_error=energy_error,
        force_error=force_error,
        force_bound=bound,
        relative_force_bound=bound * own / (size or strain or 1.0),
        energy_scale=strain,
        force_scale=size,
        scope=GLOBALLY,
    )


@dataclass(frozen=True, eq=False)
class LocalBounds:
    """The bounds of forces of a local problem, with their scope."""

    force_error: float  # >= |r - r*|_W / |r*|_W, absolute where r* vanishes
    force_bound: Vector  # (m,) >= |r_i - r_i*| [force]
    scope: str
    radius: float | None = None


def local_bounds(problem: LocalProblem, force: Array, status: Status) -> LocalBounds | str:
    """Return bounds of forces r (m, d) of a local problem in these states (m,), or the reason for none.

    W is that of the problem, the displacement of (1) any whose gaps and slips are u = W r + q. Where W is not symmetric
    d'W d is that of its symmetric part, and slips nearby that turn are those of Newton and Kantorovich alone.
    """
    if not problem.contacts:
        return LocalBounds(0.0, np.zeros(0), GLOBALLY)
    if problem.joints:
        return "local problems with joints have none"
    if len(problem.offset) > MOST_UNKNOWNS:
        return f"{problem.contacts} contacts: too many for dense operators"
    W, n, mu = problem.scaled_delassus.toarray(), len(problem.offset), problem.friction
    sign = np.tile(np.r_[1.0, -np.ones(problem.dimension - 1)], problem.contacts)
    W = W * np.outer(sign, sign)  # r_T = -l_T, and nearby slips depend on the sign of their coupling to r_N
    none, scale = np.zeros((n, 0)), 1 / problem.contact_scale
    compliance = ContactOperators((W + W.T) / 2, none, none[:0], scale, 0, W.diagonal())
    found = refined_forces(problem, force, status)
    if found is None:
        return "no answer of its own states is near whose forces are unique"
    refined, apart, last, size = refined_local_lengths(problem, force, found)
    skew = problem.scaled_asymmetry > SYMMETRIC
    norms, kappa = norms_of_skew(compliance, W, mu) if skew else norms_of_all_rows(compliance, problem)
    scope, radius = GLOBALLY, None
    if norms is not None and kappa < 1:
        error = _distance(refined, norms, status, mu, kappa)
    else:
        acting = acting_rows(compliance, status, mu)
        of_acting = norms_of_skew(compliance, W, mu, 0.0, acting)[0] if skew else None
        norms = of_acting if skew else ForceNorms.nearby(compliance, 0.0, status, mu)
        if norms is None or wedged(compliance, mu, refined):
            return ROWS_DEPEND if norms is None else WEDGED
        slips = slips_nearby(compliance, status, mu, W if skew else None)
        left, least = 2 * last + refined.correction, np.min(margins_of(refined, norms, status, mu), initial=np.inf)
        margin = float(least) - refined.correction
        near = _nearest(slips, refined, norms, left, margin)
        if isinstance(near, float):
            return f"other equilibria are not excluded (kappa = {kappa:.3g}), nor others nearby ({near:.3g})"
        error, reach = near
        scope, radius = LOCALLY, reach - apart - error
        if not radius > apart + error:
            at = None if skew else _at_borders(compliance, status, mu, refined, 0.0, apart + error)
            if at is None:
                return f"other equilibria are not excluded (kappa = {kappa:.3g}), and {NO_MARGIN}"
            norms, error, radius = at
    off = lengths((extend(force.ravel()) - found.force).double().reshape(force.shape))
    bound = ROUNDED_UP * (off + error * norms.force / compliance.scale)
    return LocalBounds(relative_error(apart + error, size, error), bound, scope, radius)
