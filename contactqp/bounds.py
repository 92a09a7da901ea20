"""How far an answer is from the truth: proven bounds for frictionless problems.

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

with |d|_W the energy norm of the response of the tied bodies to the contact forces d.
From the first two lines also l_i* <= G^2 / (2 (g - E v)_i) where v is open; and with v_i, mu_i from
K v_i + E_B'mu_i + A'eta_i = 0, E_B v_i = 1_i, A v_i = 0 on independent rows B,

    |l_i - l_i*| <= |v_i|_K |w - u*|_K + sum over j not in B of |E_j v_i| |l_j - l_j*|.                    (4)

The pair (v, l) is got from the candidate's own set of closed contacts, with the refined answer on it (its forces, if
none pulls, and its displacement, if it penetrates nowhere, make G a matter of rounding); where the candidate's set is
wrong, from the candidate repaired: v closes its contacts, l loses its tensions. The bound of the candidate is its
distance to the pair and the pair's own.

Rounding allowance: v - w and the distances are formed from residuals in extended precision, never as differences of
large numbers. The refinement that computes them contracts by a measured factor q; the error that its last step d
leaves is at most |d|_K q/(1-q), and 2 |d|_K is added. Where q >= 1/2 nothing is proven and the reason is given. This
is an a-posteriori estimate of rounding, not an interval enclosure.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contactqp.condensation import Condensation
from contactqp.delassus import delassus
from contactqp.extended import EPS, Extended, extend, extended_rows
from contactqp.factorization import RIGID_FORCE, unit_diagonal_scale
from contactqp.polishing import ROUNDING, OnSet, closed_contacts, correction, polish
from contactqp.problem import ContactProblem, Vector
from contactqp.saddle import SaddlePoint, saddle_point
from contactqp.violations import Answer, forces_that_meet, lengths_that_meet, own_compliance

# The set of closed contacts is repaired, not searched for: a candidate whose set is further off has the bound of its
# energies.
REPAIRS = 3
# Contact forces whose energy norm is this part of the displacement's are what refinement leaves of zero.
VANISHING = 1e-22
# An energy norm of forces that is this part of their size is rounding.
FELT = 64 * np.finfo(float).eps
# A gap or a force of this part of its lengths or of the largest force is taken for none in a candidate of engineering
# accuracy.
TOUCHING = 1e-6
# Refinement that contracts less than this proves nothing.
CONTRACTION = 0.5
# Condensed unknowns beyond which the dense systems of the bounds would not fit a workstation.
LARGEST = 8000


@dataclass(frozen=True, eq=False)
class Bounds:
    """Proven bounds; None where one could not be had, with the reason."""

    energy_error: float | None = None
    force_error: float | None = None
    force_bound: Vector | None = None
    energy_scale: float = 0.0  # |u*|_K or what is known of it
    force_scale: float = 0.0  # |l*|_W likewise
    relative_force_bound: Vector | None = (
        None  # (m,) force_bound_i |E_i D| / |l*|_W, D = 1/sqrt(K_jj): no units, no row scale
    )
    rounding: float = 0.0  # what the refinement cannot tell from zero, in the square root of energy
    rigid_rounding: float = 0.0  # the energy norm that the rounding of a rigid displacement has
    force_rounding: float = 0.0  # |l|_W beneath this is the rounding of forces that the bodies do not feel
    suspicious: str | None = None  # why no bound could be had, where that speaks against the answer
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class _Pair:
    """A feasible displacement v and admissible forces l, with v and w seen from the candidate."""

    to_middle: Extended  # (n,) c - u
    radius: float  # (2): |c - u*|_K
    dual_radius: float  # (1): |w - u*|_K
    force: Extended  # (m,) l
    open_gap: Vector  # (m,) g - E v
    saddle: SaddlePoint
    exact: bool  # both are the solution, to rounding


class Unproven(Exception):
    """Why no bound could be had."""


def bounds(problem: ContactProblem, answer: Answer, condensation: Condensation) -> Bounds:
    """The bounds of an answer, or the reasons why there are none."""
    if problem.frictional:
        return _none("Coulomb friction is no minimisation: its energy bounds nothing")
    if len(condensation.retained) > LARGEST:
        return _none(f"{len(condensation.retained)} condensed unknowns: too many for the dense systems of the bounds")
    try:
        pair = _pair(problem, answer, condensation)
        return _from_pair(problem, answer, condensation, pair)
    except Unproven as reason:
        return replace(_none(str(reason)), suspicious=str(reason))


def _none(reason: str) -> Bounds:
    return Bounds(reasons=tuple(f"{name}: {reason}" for name in ("energy_error", "force_error", "force_bound")))


def _pair(problem: ContactProblem, answer: Answer, condensation: Condensation) -> _Pair:
    sets = _believed_sets(problem, answer, condensation)
    for closed in sets:
        on_set, _, holds = polish(problem, condensation, closed, REPAIRS)
        if on_set.contraction >= CONTRACTION:
            raise Unproven(
                f"the refinement contracts by {on_set.contraction:.2g} only: "
                "the stiffness is singular to working precision"
            )
        if holds:
            return _from_set(problem, answer, condensation, on_set)
    return _from_repair(problem, answer, condensation, sets[0])


def _believed_sets(problem: ContactProblem, answer: Answer, condensation: Condensation) -> list[NDArray[np.intp]]:
    """The contacts closed by gap and force together, and, should these disagree, by either alone."""
    u, force = answer.displacement, answer.normal_force
    length = lengths_that_meet(problem, problem.normal, problem.gap, u)
    touching = np.flatnonzero(problem.gap - problem.normal @ u <= TOUCHING * length)
    size = force * np.sqrt(delassus(condensation).compliance[: problem.contacts])
    pushing = np.flatnonzero(size > TOUCHING * np.max(abs(size), initial=0.0))
    acting = np.flatnonzero(abs(size) > TOUCHING * np.max(abs(size), initial=0.0))  # of the wrong sign, perhaps
    return [closed_contacts(problem, condensation, u, force), touching, pushing, acting]


def _from_set(problem: ContactProblem, answer: Answer, condensation: Condensation, on_set: OnSet) -> _Pair:
    """The refined answer on a set whose signs hold is the solution, to its last correction."""
    distance = _without_free_part(condensation, on_set.saddle, on_set.displacement - extend(answer.displacement))
    du, dl, _ = on_set.last_step
    step = extend(np.zeros(problem.contacts)).added_at(on_set.saddle.closed, dl)
    allowance = 2 * _energy_norm(problem, extend(du)) + 2 * sum(_force_norm(problem, condensation, step))
    allowance += _noise(problem, answer)
    gap = np.maximum(on_set.gap.double(), 0.0)
    return _Pair(distance, allowance, allowance, on_set.normal_force.positive_part(), gap, on_set.saddle, exact=True)


def _from_repair(
    problem: ContactProblem, answer: Answer, condensation: Condensation, closed: NDArray[np.intp]
) -> _Pair:
    """v: the candidate with its contacts closed; l: its forces without tension, balanced."""
    rows = extended_rows(problem)
    to_feasible, saddle = _close(problem, answer, condensation, closed)
    force, tie = _admissible_forces(problem, answer, condensation)
    residual = extend(problem.load) - rows.stiffness @ extend(answer.displacement) - rows.contact_force(force, tie)
    to_dual, last = _response(problem, condensation, residual, tied=False)
    gap = extend(problem.gap) - rows.normal @ (extend(answer.displacement) + to_feasible)
    room = np.where(np.isin(np.arange(problem.contacts), saddle.closed), 0.0, np.maximum(gap.double(), 0.0))
    allowance = last + _noise(problem, answer)
    apart = _energy_norm(problem, to_feasible - to_dual) + allowance
    slack = float(force.double() @ room)
    return _Pair(
        to_middle=(to_feasible + to_dual).half(),
        radius=float(np.sqrt(apart**2 / 4 + slack)) + allowance,
        dual_radius=float(np.sqrt(apart**2 + 2 * slack)) + allowance,
        force=force,
        open_gap=room,
        saddle=saddle,
        exact=False,
    )


def _close(
    problem: ContactProblem, answer: Answer, condensation: Condensation, closed: NDArray[np.intp]
) -> tuple[Extended, SaddlePoint]:
    """The nearest displacement (in energy) on which the set is closed, the set growing by what this penetrates."""
    rows = extended_rows(problem)
    start = extend(answer.displacement)
    length = lengths_that_meet(problem, problem.normal, problem.gap, answer.displacement)
    for _ in range(problem.contacts + 1):
        saddle = saddle_point(condensation, closed)
        step = extend(np.zeros(problem.dimension))
        for _ in range(4):
            gap = extend(problem.gap) - rows.normal @ (start + step)
            open_tie = extend(problem.tie_value) - rows.tie @ (start + step)
            step = step + correction(condensation, saddle, extend(np.zeros(len(start))), gap[closed], open_tie)[0]
        gap = extend(problem.gap) - rows.normal @ (start + step)
        penetrated = np.flatnonzero(-gap.double() > ROUNDING * length)
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
    """The candidate's forces without tension, changed least so that they balance the load on every rigid motion."""
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
    if np.any(force < 0) or np.any(abs(left) > 1e-12 * size):
        raise Unproven("no forces near the candidate's balance the load on every rigid motion")
    return extend(force), extend(tie)


def _response(
    problem: ContactProblem, condensation: Condensation, force: Extended, tied: bool
) -> tuple[Extended, float]:
    """The response u of the bodies to a force, contacts open, with a bound on its error in the energy norm.

    K u + A'eta = P force and A u = 0 where tied, K u = P force where not; P leaves the rigid part of the force out.
    """
    rows = extended_rows(problem)
    saddle = saddle_point(condensation, np.zeros(0, dtype=np.intp), tied)
    force = _without_rigid_part(condensation, force)
    u, eta, no_contact = (extend(np.zeros(size)) for size in (problem.dimension, problem.ties, problem.contacts))
    last = np.inf
    for _ in range(8):
        residual = force - rows.stiffness @ u - rows.contact_force(no_contact, eta)
        none = extend(np.zeros(0))
        du, _, dn = correction(condensation, saddle, residual, none, -(rows.tie @ u) if tied else none)
        u = u + du
        eta = eta + dn if tied else eta
        size = _energy_norm(problem, extend(du))
        if size == 0 or size > CONTRACTION * last:
            break
        last = size
    return u, 2 * size


def _without_rigid_part(condensation: Condensation, vector: Extended) -> Extended:
    if not condensation.rigid.count:
        return vector
    Z = condensation.rigid.basis
    return vector - Z @ (Z.T @ vector.double())


def _without_free_part(condensation: Condensation, saddle: SaddlePoint, displacement: Extended) -> Extended:
    """A displacement less its part along motions that nothing resists: between two answers it is no error."""
    if not saddle.free.shape[1]:
        return displacement
    motions = condensation.rigid.motions
    retained = condensation.scale[:, None] * saddle.free
    coordinates, *_ = np.linalg.lstsq(motions[condensation.retained], retained, rcond=None)
    free, _ = np.linalg.qr(motions @ coordinates)
    return displacement - free @ (free.T @ displacement.double())


def _energy_norm(problem: ContactProblem, displacement: Extended) -> float:
    """|v|_K."""
    return float(np.sqrt(max(displacement.dot(extended_rows(problem).stiffness @ displacement), 0.0)))


def _noise(problem: ContactProblem, answer: Answer) -> float:
    """What the rounding d of a residual, |d_j| <= EPS F_j, may hide: |D d| / sqrt(least eigenvalue of DKD)."""
    scale = unit_diagonal_scale(problem.stiffness)
    return float(EPS / np.sqrt(RIGID_FORCE) * np.linalg.norm(scale * forces_that_meet(problem, answer)))


def _from_pair(problem: ContactProblem, answer: Answer, condensation: Condensation, pair: _Pair) -> Bounds:
    rounding = 4 * _noise(problem, answer)
    middle = extend(answer.displacement) + pair.to_middle
    energy_scale = _energy_scale(problem, condensation, middle)
    rounding += VANISHING * energy_scale
    energy_scale = 0.0 if energy_scale <= rounding else energy_scale
    force_size = _force_size(problem, pair.force.double())
    # Forces that act on rigid motions or on what ties hold strain nothing; in double precision that is not quite
    # nothing.
    force_rounding = FELT * force_size if condensation.rigid.count or problem.ties else 0.0
    force_bound, reason = _force_bound(problem, answer, condensation, pair)
    force_error, force_scale = _force_error(problem, answer, condensation, pair, energy_scale, rounding, force_rounding)
    relative = None
    if force_bound is not None and force_scale > 0:
        relative = force_bound * np.sqrt(own_compliance(problem, problem.normal)) / max(force_scale, force_size)
    return Bounds(
        energy_error=_relative(
            _energy_norm(problem, pair.to_middle) + pair.radius, energy_scale, pair.radius, rounding
        ),
        force_error=force_error,
        force_bound=force_bound,
        energy_scale=energy_scale,
        force_scale=force_scale,
        relative_force_bound=relative,
        rounding=rounding,
        force_rounding=force_rounding,
        rigid_rounding=_rigid_rounding(problem, condensation, answer.displacement),
        reasons=() if reason is None else (f"force_bound: {reason}",),
    )


def _force_size(problem: ContactProblem, force: Vector) -> float:
    """|D E'l|: the contact forces at their own unknowns, in the square root of energy."""
    return float(np.linalg.norm(unit_diagonal_scale(problem.stiffness) * (problem.normal.T @ force)))


def _force_error(
    problem: ContactProblem,
    answer: Answer,
    condensation: Condensation,
    pair: _Pair,
    energy_scale: float,
    rounding: float,
    force_rounding: float,
) -> tuple[float, float]:
    """(3) relative to |l*|_W, and |l*|_W, zero where the contact forces are what refinement leaves of zero.

    Where ties act on a stiffness that needs none, W may also be taken without them; from the forces of the solution
    itself both are known, and the larger error is the bound.
    """
    change = extend(answer.normal_force) - pair.force
    both = pair.exact and problem.ties > 0 and not condensation.rigid.count
    errors, scales = [], []
    for tied in (True, False) if both else (True,):
        scale, uncertain = _force_norm(problem, condensation, pair.force, tied)
        scale = 0.0 if scale <= max(VANISHING * energy_scale, force_rounding) else scale
        error = sum(_force_norm(problem, condensation, change, tied)) + pair.dual_radius
        errors.append(_relative(error, scale, pair.dual_radius + uncertain, rounding + force_rounding))
        scales.append(scale)
    return max(errors), scales[0]


def _energy_scale(problem: ContactProblem, condensation: Condensation, displacement: Extended) -> float:
    """|u|_K, zero where it is no more than the rounding of a rigid motion."""
    norm = _energy_norm(problem, displacement)
    return norm if norm > _rigid_rounding(problem, condensation, displacement.double()) else 0.0


def _rigid_rounding(problem: ContactProblem, condensation: Condensation, displacement: Vector) -> float:
    """The energy norm that the rounding of a rigid displacement has."""
    if not condensation.rigid.count:
        return 0.0
    size = abs(displacement)
    return float(64 * np.finfo(float).eps * np.sqrt(size @ (abs(problem.stiffness) @ size)))


def _relative(error: float, scale: float, uncertainty: float, rounding: float) -> float:
    """error over the least that the true scale can be; absolute where that is zero, infinite where it may be zero."""
    if scale > uncertainty:
        return error / (scale - uncertainty)
    return error if scale == 0 and uncertainty <= rounding else float("inf")


def _force_norm(
    problem: ContactProblem, condensation: Condensation, force: Extended, tied: bool = True
) -> tuple[float, float]:
    """|d|_W, the energy norm of the (tied) bodies' response to contact forces d, and a bound on its error."""
    if not np.any(force.double()):
        return 0.0, 0.0
    load = extended_rows(problem).contact_force(force, extend(np.zeros(problem.ties)))
    u, error = _response(problem, condensation, load, tied)
    return _energy_norm(problem, u), error


def _force_bound(
    problem: ContactProblem, answer: Answer, condensation: Condensation, pair: _Pair
) -> tuple[Vector | None, str | None]:
    """(4) on every contact that is closed in v, the bound of the first lines on those that are open."""
    length = lengths_that_meet(problem, problem.normal, problem.gap, answer.displacement)
    active = np.flatnonzero(pair.open_gap <= ROUNDING * length)
    saddle = saddle_point(condensation, active)
    if saddle.redundant:
        return None, "the closed contacts and ties are redundant: their forces are not unique"
    m, count = problem.contacts, len(active)
    bound = np.zeros(m)
    outside = np.setdiff1d(np.arange(m), active)
    bound[outside] = pair.dual_radius**2 / (2 * pair.open_gap[outside])
    if count:
        unit = np.eye(count)
        nothing = np.zeros((len(condensation.retained), count))
        motion, reaction, _ = saddle.solve(nothing, unit, np.zeros((problem.ties, count)))
        stiffness = np.sqrt(np.maximum(-np.diag(reaction), 0.0))
        bound[active] = stiffness * pair.dual_radius + abs(condensation.normal[outside] @ motion).T @ bound[outside]
    return bound + abs((extend(answer.normal_force) - pair.force).double()), None
