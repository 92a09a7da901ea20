"""Bound the distance of an answer from the solution by products and conjugate gradients, without a factorisation.

Let v satisfy E v <= g, A v = b, let l >= 0 and nu be any forces, w the response to them, K w = f - E'l - A'nu. Then
(`bounds`, equation 1)

    |v - u*|^2 + |w - u*|^2 <= G^2 = |v - w|^2 + 2 l'(g - E v),    |v - w|^2 = r'K^-1 r,    r = f - K v - E'l - A'nu,

and |l - l*|_W <= |w - u*|_K <= G. v is the candidate moved onto the ties and onto the contacts with l_i > (g - E u)_i /
(E_i D^-1 E_i'), D = diag K: penetrated ones, and those whose closing costs less than 2 l_i (g - E u)_i. The distance |v
- u|_K is added. l are the candidate's forces without tension.

r'K^-1 r is enclosed from k steps of preconditioned conjugate gradients on K e = r (`krylov`): no
eigenvalue of M K exceeds one (`contactqp.linalg.multigrid`), and

    sum of a_j rho_j + rho_k <= r'K^-1 r <= sum of a_j rho_j + rho_k / (least eigenvalue of M K),

until the last term, with the least Ritz value of the run, of at least ENOUGH_STEPS steps, over SAFETY for the
eigenvalue, is at most GENEROUS times the left side. Ritz values estimate that eigenvalue from above: the bound
is an a-posteriori estimate, no enclosure; where M is a factorisation refinement bounds r'K^-1 r (`refined_norm`). The
estimate fails if r has no component, beyond rounding, along a motion for which M is SAFETY times worse than for all
others of the run.

|l*|_W >= |l|_W - G, and |l|_W >= l'E v / |v|_K for any v that moves no tie; v = M E'l is nearly the best.

Rounding: r is formed in double precision, each entry with an error of at most ROUNDING_OF_PRODUCTS F_j (F of
`violations`); the bound is raised in the ratio of the D-norms of r and of that. Gaps that were closed are zero to the
rounding of their lengths L_i; ROUNDING_OF_PRODUCTS L_i / sqrt(E_i D^-1 E_i') is added for each of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from contactqp.certificate.bounds import Bounds, no_bounds, relative_error
from contactqp.linalg.contact_iteration import ContactIteration, Limits
from contactqp.model.arrays import EPS, Indices, Vector

# The least contraction of refinement, as in `figures`.
CONTRACTION = 0.5
SAFETY = 10.0
# The largest ratio of the unknown part of r'K^-1 r to the known one; the bound is then at most five times too large.
GENEROUS = 25.0
# Further steps are within rounding of the previous ones.
EXHAUSTED = EPS**2
# The same for residuals in double precision.
ITERATED_NOTHING = 1e-10
# The least number of steps of the longest run for Ritz values to be used.
ENOUGH_STEPS, MOST_STEPS = 8, 60
# Rounding of a residual or a gap in double precision, relative to the forces or lengths that meet.
ROUNDING_OF_PRODUCTS = 16 * EPS
# The most corrections of the set onto which the candidate is moved.
REPAIRS = 8
# A penetration below this part of its lengths is rounding of a closed contact.
CLOSED = 1e-14


# The tolerance of refinement of the response to r.
FEW_DIGITS = 1e-4
SWEEPS = 20


@dataclass(frozen=True, eq=False)
class Distances:
    """Bounds on the distances of an answer from the solution [square root of energy]."""

    displacement: float  # >= |u - u*|_K
    force: float  # >= |l - l*|_W
    energy_scale: float  # |u|_K
    force_scale: float  # <= |l|_W, 0 without forces
    radius: float  # >= |v - u*|_K and |w - u*|_K
    estimated: bool  # by Ritz values


class Unrepaired(Exception):
    """The candidate could not be moved to a displacement without penetration, for the reason stated."""


class Forces(Protocol):
    """An answer without friction."""

    @property
    def displacement(self) -> Vector: ...  # (n,)

    @property
    def normal_force(self) -> Vector: ...  # (m,)

    @property
    def tie_force(self) -> Vector: ...  # (k,)


def distances(problem: Limits, answer: Forces, iteration: ContactIteration) -> Distances:
    """Bound the distance of an answer from the solution.

    Raises Unrepaired: no displacement without penetration was found near it.
    """
    given = np.append(answer.normal_force, answer.tie_force)
    push, forces = _forces(problem, answer, given, iteration)
    moved, gap, rounding = _repaired(problem, answer, push, iteration)
    v = answer.displacement + moved
    outer = iteration.forces(forces)
    r = problem.load - iteration.product(v) - outer
    change = iteration.forces(forces - given)
    response, shifted, estimated = _responses(iteration, r, change)
    stationary = response * (1 + _noise(problem, v, outer, r, iteration))
    radius = float(np.sqrt(stationary**2 + 2 * iteration.dot(push, gap))) + rounding
    return Distances(
        displacement=_energy_norm(iteration, moved) + radius,
        force=shifted + radius,
        energy_scale=_energy_norm(iteration, answer.displacement),
        force_scale=force_norm(push, len(answer.normal_force), iteration),
        radius=radius,
        estimated=estimated,
    )


def _forces(problem: Limits, answer: Forces, given: Vector, iteration: ContactIteration) -> tuple[Vector, Vector]:
    """Return contact forces without tension, zero on ties, and all forces, which balance floating bodies."""
    contact = np.arange(len(given)) < len(answer.normal_force)
    forces = np.where(contact, np.maximum(given, 0.0), given)
    forces = balanced_forces(problem, answer.displacement, forces, iteration)
    if iteration.any(contact & (forces < 0)):
        raise Unrepaired("the contact forces could not be brought into balance with the load")
    return np.where(contact, forces, 0.0), forces


def balanced_forces(problem: Limits, displacement: Vector, forces: Vector, iteration: ContactIteration) -> Vector:
    """Return contact and tie forces (m + k,) with the least change that balances the load on rigid motions.

    Parameters
    ----------
    problem : load, gaps and ties
    displacement : (n,) array [length]
    forces : (m + k,) array [force], of contacts, then of ties
    iteration : products with the stiffness, and the motions of floating bodies
    """
    if not iteration.floating.count:
        return forces
    residual = problem.load - iteration.product(displacement) - iteration.forces(forces)
    # The change is relative, so that contact forces stay compressive.
    contact = np.arange(len(forces)) < len(problem.gap)
    return forces + iteration.balanced(residual, np.where(contact, forces, 1 / iteration.own_compliance))


def _energy_norm(iteration: ContactIteration, v: Vector) -> float:
    return float(np.sqrt(max(iteration.dot(v, iteration.product(v)), 0.0))) if iteration.any(v != 0) else 0.0


def _responses(iteration: ContactIteration, r: Vector, change: Vector) -> tuple[float, float, bool]:
    """Bound sqrt(r'K^-1 r) of two forces from above; return both and whether they are estimates."""
    if iteration.factorised:
        response, shifted = refined_norm(iteration, r), refined_norm(iteration, change)
        if response is not None and shifted is not None:
            return response, shifted, False
    return dual_norm(iteration, r), dual_norm(iteration, change, learned=True), True


def refined_norm(iteration: ContactIteration, force: Vector) -> float | None:
    """Bound sqrt(r'K^-1 r) from above if M is the inverse of K up to rounding; None if refinement does not confirm
    this.

    e = M r, then M (r - K e), and so on: as each is at most CONTRACTION of the one before, the remaining sum is at most
    the last.
    """
    left = iteration.deflated(force).copy()
    response, last, first = np.zeros_like(left), np.inf, 0.0
    for _ in range(SWEEPS):
        step = iteration.smooth(left)
        forces = iteration.product(step)
        size = float(np.sqrt(max(iteration.dot(step, forces), 0.0)))
        if size > CONTRACTION * last:
            return None
        response, left = response + step, iteration.deflated(left - forces)
        first, last = first or size, size
        if size <= FEW_DIGITS * first:
            return _energy_norm(iteration, response) + 2 * size
    return None


def dual_norm(iteration: ContactIteration, force: Vector, learned: bool = False) -> float:
    """Estimate sqrt(r'K^-1 r) from above [square root of energy].

    The eigenvalue is that of this run, so that the estimate depends on K and r only; with `learned`, those of earlier
    runs are also used, which saves steps.
    """
    if not iteration.any(force != 0):
        return 0.0
    run = iteration.run_without_rows(iteration.deflated(force).copy())
    while True:
        square = run.square()
        iteration.learn(run)
        least, longest = (
            (iteration.least_eigenvalue, iteration.longest_run) if learned else (run.least_eigenvalue(), run.steps)
        )
        rest = SAFETY * square / least if least > 0 else np.inf
        exhausted = square <= EXHAUSTED * run.gained  # few unknowns, for which Ritz values are accurate
        ended = exhausted or (longest >= ENOUGH_STEPS and rest <= GENEROUS * (run.gained + square))
        if ended or run.steps >= MOST_STEPS or not run.step():
            return float(np.sqrt(run.gained + rest))
        iteration.krylov_iterations += 1


def _noise(problem: Limits, v: Vector, forces: Vector, r: Vector, iteration: ContactIteration) -> float:
    """Return the rounding of r relative to r, both in the norm of D^-1."""
    scale = 1 / np.sqrt(iteration.diagonal)
    size = iteration.norm(scale * r)
    meeting = iteration.product_sizes(v) + abs(problem.load) + abs(forces)
    return ROUNDING_OF_PRODUCTS * iteration.norm(scale * meeting) / size if size > 0 else 0.0


def force_norm(push: Vector, contacts: int, iteration: ContactIteration) -> float:
    """Return l'E v / |v|_K for v = M E'l that moves no tie, a lower bound of |l|_W."""
    if not iteration.any(push != 0):
        return 0.0
    load = iteration.deflated(iteration.forces(push))
    v = iteration.smooth(load)
    ties = np.arange(contacts, len(push))
    iteration.held(ties, np.zeros(len(ties))).admit(v)
    size = _energy_norm(iteration, v)
    return max(iteration.dot(load, v), 0.0) / size if size > 0 else 0.0


def _repaired(
    problem: Limits, answer: Forces, push: Vector, iteration: ContactIteration
) -> tuple[Vector, Vector, float]:
    """Return v - u, the gaps g - E v (m + k,), zero where closed, and their rounding [square root of energy]."""
    m = len(problem.gap)
    limit = np.concatenate([problem.gap, problem.tie_value])
    u = answer.displacement
    lengths = iteration.length_sizes(u) + abs(limit)
    gap = limit - iteration.lengths(u)
    closed = push * iteration.own_compliance > gap
    closed[m:] = True
    for _ in range(REPAIRS):
        v, left = _closed_onto(iteration, np.flatnonzero(closed), limit, u)
        deep = (-left > CLOSED * lengths) & ~closed
        if not iteration.any(deep):
            break
        closed |= deep
    else:
        raise Unrepaired("the candidate could not be moved to a displacement that penetrates nowhere")
    if iteration.any(abs(left[closed]) > CLOSED * lengths[closed]):
        raise Unrepaired("contacts that depend on each other cannot be closed together")
    open_gap = np.where(closed, 0.0, np.maximum(left, 0.0))
    rounding = ROUNDING_OF_PRODUCTS * iteration.norm(lengths[closed] / np.sqrt(iteration.own_compliance[closed]))
    return v - u, open_gap, float(rounding)


def _closed_onto(iteration: ContactIteration, rows: Indices, limit: Vector, u: Vector) -> tuple[Vector, Vector]:
    """Return u moved onto the limits of some rows, and the gaps of all rows at this displacement."""
    held = iteration.held(rows, limit[rows])
    v = u.copy()
    for _ in range(2):  # the second time removes rounding of the first
        held.close(v)
    return v, limit - iteration.lengths(v)


def iterated_bounds(problem: Limits, answer: Forces, iteration: ContactIteration) -> Bounds:
    """Bound an answer without friction by products and responses (`contactqp.certificate.multigrid_bounds`)."""
    try:
        found = distances(problem, answer, iteration)
    except Unrepaired as reason:
        return replace(no_bounds(str(reason)), suspicious=str(reason))
    force_scale = found.force_scale if found.force_scale > ITERATED_NOTHING * found.energy_scale else 0.0
    return Bounds(
        energy_error=relative_error(found.displacement, found.energy_scale, found.displacement),
        force_error=relative_error(found.force, force_scale, found.radius),
        energy_scale=found.energy_scale,
        force_scale=force_scale,
        estimated=found.estimated,
        reasons=("force_bound: contact by contact it takes a response to a unit force on each",),
    )
