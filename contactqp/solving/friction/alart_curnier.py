"""Semismooth Newton on Coulomb's law (Alart and Curnier 1991), regularised where the Delassus operator is singular.

    Phi_N = r_N - (r_N - u_N)+,    Phi_T = r_T - P(r_T - u_T; mu (r_N - u_N)+),    u = W r + q + V l,

P the projection onto a disc. Its generalised Jacobian is A + B W, one block a contact: r = 0 where open, u = 0 where it
sticks, and where it slips, with t = y/|y|, y = r_T - u_T, radius b = mu (r_N - u_N),

    dPhi_T = dr_T - mu t (dr_N - du_N) - b/|y| (I - t t') (dr_T - du_T).

Scaled contacts have a compliance of one, the parameter of both projections. A step uses W + a I; a shrinks with success
and grows where the residual of the natural map does not fall (proximal point, Acary, Bremond and Huber 2018).

`proximal_points` takes proximal points of the law, each by Newton's method (the same, section on PPA):

    r <- the forces of (W + a I) r + (q - a r_old)

A step is a regular problem however singular W is; its fixed points are the answers of W. The weight a falls while
Newton's method finds proximal points quickly, and grows where it does not.

`drawn_combinations` starts Newton's method from drawn combinations of open, stick and slip, because bodies that
wedge themselves (large friction, few springs) have many points from which no step lowers the residual any further.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.linalg.measures import lengths
from contactqp.model.arrays import EPS, Array, Mask, Vector, time_is_up
from contactqp.solving.friction.local_form import BlockSystem, Iterate, LocalForm

# The first, the smallest and the largest regularisation, with contacts scaled to a compliance of one. In forces that W
# does not resist rounding appears divided by the smallest.
REGULARISATION = (1e-6, 1e-9, 1e2)
# Step lengths that are tried before the regularisation grows.
STEP_LENGTHS = (1.0, 0.5, 0.25, 0.1)
# The factors by which the regularisation grows, the second if it changed a step by less than the third number.
GROWTH_OF_REGULARISATION, LEAP, ALIKE = 30.0, 1e3, 1e-3
# A residual of rounding size; and the part of the forces below which a residual that a step does not lower is final.
ROUNDING_OF_MAP, ROUNDED = 1e-15, 32 * EPS
# Where so many steps do not lower the residual to this part, a few at full length follow, which pass over kinks: from
# there the residual often falls again where no step along the way lowers it.
STALLED, PROGRESS, STEPS_OVER_KINKS = 10, 0.1, 6


class _Regularisation:
    """The weight a: it grows where a step fails and falls where two in turn succeed."""

    def __init__(self) -> None:
        self.weight, self._missed, self._failed = REGULARISATION[0], np.nan, False

    @property
    def exhausted(self) -> bool:
        return self.weight > REGULARISATION[2]

    def grow(self, found: Iterate | None) -> None:
        """Make the weight larger after a step that came to `found` did not lower the residual."""
        error = np.nan if found is None else found.error
        alike = abs(error - self._missed) <= ALIKE * self._missed
        self.weight *= LEAP if alike else GROWTH_OF_REGULARISATION
        self._missed, self._failed = error, True

    def fall(self) -> None:
        """Make the weight smaller after a step, unless a smaller one failed just before."""
        self.weight = max(self.weight * (1.0 if self._failed else 0.1), REGULARISATION[1])
        self._missed, self._failed = np.nan, False


def newton(form: LocalForm, start: Iterate, max_iter: int = 60, target: float = ROUNDING_OF_MAP) -> Iterate:
    """Return the best iterate that Newton's method reaches in time from a start; it is never worse than the start.

    Parameters
    ----------
    form : LocalForm
    start : Iterate
    max_iter : int
        The largest number of steps.
    target : float
        The error, in the scale of the form, at which it is done.
    """
    best, history, regularisation = start, [start.error], _Regularisation()
    mark, since, left = start.error, 0, max_iter
    found: Iterate | None
    while left > 0 and best.error > max(target, EPS * best.size) and not time_is_up():
        if best.error <= PROGRESS * mark:
            mark, since = best.error, 0
        if since == STALLED or regularisation.exhausted:
            found, taken = _over_kinks(form, best)
            if found is best and (regularisation.exhausted or best.error <= ROUNDED * best.size):
                break
            mark, since, left = found.error, 0, left - taken
            regularisation = regularisation if found is best else _Regularisation()
        else:
            since, left = since + 1, left - 1
            found = _step(form, best, regularisation.weight)
            if found is not None and found.error < 0.999 * best.error:
                regularisation.fall()
            elif best.error <= ROUNDED * best.size:
                break  # near the rounding of the answer no step reduces the residual
            else:
                regularisation.grow(found)
        if found is not None and found.error < best.error:
            best = found
            history.append(best.error)
    return Iterate(best.force, best.joint_force, best.error, len(history) - 1, tuple(history))


def _over_kinks(form: LocalForm, here: Iterate) -> tuple[Iterate, int]:
    """Return the first of a few iterates at full length that is better than `here`, else `here`, and their number."""
    found = here
    for taken in range(1, STEPS_OVER_KINKS + 1):
        direction = _direction(form, found, REGULARISATION[0])
        if direction is None:
            break
        found = Iterate.at(form, found.force + direction[0], found.joint_force + direction[1])
        if found.error < here.error:
            return found, taken
        if not np.isfinite(found.error):
            break
    return here, taken


def _step(form: LocalForm, here: Iterate, regularisation: float) -> Iterate | None:
    """Return the best point of the line search along Newton's direction, None where the system is singular."""
    direction = _direction(form, here, regularisation)
    if direction is None:
        return None
    change, joint_change = direction
    best: Iterate | None = None
    for length in STEP_LENGTHS:
        found = Iterate.at(form, here.force + length * change, here.joint_force + length * joint_change)
        if best is None or found.error < best.error:
            best = found
        if found.error < here.error * (1 - 0.1 * length):
            break
    return best


def _direction(form: LocalForm, here: Iterate, regularisation: float) -> tuple[Array, Vector] | None:
    """Return Newton's changes of the forces of contacts (m, d) and joints (p,), None where the system is singular.

    An open contact loses its force whatever the others do, so that equations are solved for the closed ones alone.
    """
    r, u = here.force, form.velocity(here.force, here.joint_force)
    closed = r[:, 0] > u[:, 0]
    change = np.where(closed[:, None], 0.0, -r)
    A, B, phi = jacobian_blocks(r[closed], u[closed], form.mu[closed])
    missed, V = form.joint_residual(r, here.joint_force), form.V.reshape(form.m, form.d, form.joints)[closed]
    if change.any():
        phi = phi + np.einsum("iab,ib->ia", B, (form.W @ change.ravel()).reshape(form.m, form.d)[closed])
        missed = missed + form.V.T @ change.ravel()
    try:
        system = BlockSystem(form, _jacobian(form, A, B, regularisation, closed), V, B @ V)
        found, joint = system.solve(-phi.ravel(), -missed)
    except np.linalg.LinAlgError:
        return None  # singular: a larger regularisation
    if not (np.isfinite(found).all() and np.isfinite(joint).all()):
        return None
    change[closed] = found.reshape(-1, form.d)
    return change, joint


def _jacobian(form: LocalForm, A: Array, B: Array, regularisation: float, closed: Mask) -> Any:
    """Return A + B (W + a I) of the closed contacts, B (q, d, d) that of a unilateral one in its first row."""
    own = A + regularisation * B
    if form.sparse:
        return form.blocks.jacobian(own, B, closed)
    W, q = form.W, len(B)
    if q < form.m:
        kept = np.repeat(closed, form.d).nonzero()[0]
        W = W[kept[:, None], kept]
    matrix = np.matmul(B, W.reshape(q, form.d, q * form.d)).reshape(q, form.d, q, form.d)
    each = np.arange(q)
    matrix[each, :, each, :] += own
    return matrix.reshape(q * form.d, q * form.d)


def jacobian_blocks(r: Array, u: Array, friction: Vector) -> tuple[Array, Array, Array]:
    """Return A, B (q, d, d) of the Jacobian A + B W, and Phi (q, d), at forces and velocities (q, d) of closed
    contacts.
    """
    q, d = r.shape
    A, B, phi = np.zeros((q, d, d)), np.zeros((q, d, d)), u.copy()
    B[:] = np.eye(d)
    if d == 1:
        return A, B, phi
    y, bound = r[:, 1:] - u[:, 1:], friction * (r[:, 0] - u[:, 0])
    size = lengths(y)
    sliding = ((size > bound) | (friction == 0)).nonzero()[0]
    if len(sliding):
        y, bound, size = y[sliding], bound[sliding], np.where(size[sliding] > 0, size[sliding], 1.0)
        t, unit = y / size[:, None], np.eye(d - 1)
        across = (bound / size)[:, None, None] * (unit - t[:, :, None] * t[:, None, :])
        push = friction[sliding, None] * t
        A[sliding, 1:, 1:] = unit - across
        A[sliding, 1:, 0] = -push
        B[sliding, 1:, 0] = push
        B[sliding, 1:, 1:] = across
        phi[sliding, 1:] = r[sliding, 1:] - bound[:, None] * t
    return A, B, phi


# The first, the smallest and the largest weight, with contacts scaled to a compliance of one.
FIRST, LEAST, MOST = 1e-2, 1e-9, 1e3
# Newton's steps for one proximal point, and those after which the weight halves; the weight grows by this factor.
STEPS, FEW, GROWTH = 25, 6, 4.0
# A proximal point is accepted when its own residual has fallen to this part.
FOUND = 1e-2
PROXIMAL_ROUNDING = 1e-14


def proximal_points(form: LocalForm, start: Iterate) -> Iterator[Iterate]:
    """Yield an iterate for each proximal point, until Newton's method finds none at any weight."""
    here, weight, count = start, FIRST, 0
    while weight <= MOST:
        nearby = _regular(form, here, weight)
        owed = Iterate.at(nearby, here.force, here.joint_force)
        found = newton(nearby, owed, STEPS, target=max(1e-3 * owed.error, PROXIMAL_ROUNDING))
        if found.error <= max(FOUND * owed.error, 10 * PROXIMAL_ROUNDING):
            weight = max(weight / 2, LEAST) if found.iterations <= FEW else weight
            count += 1
            here = Iterate.at(form, found.force, found.joint_force, count)
            yield here
        else:
            weight *= GROWTH


def _regular(form: LocalForm, centre: Iterate, weight: float) -> LocalForm:
    """Return the form of the proximal point problem, W + weight I and q - weight r of the centre r."""
    size = form.m * form.d
    nearby = copy.copy(form)
    if form.sparse:
        nearby.W, nearby.blocks = form.W + weight * sp.identity(size, format="csr"), form.blocks.stiffened(weight)
    else:
        nearby.W = form.W + weight * np.eye(size)
    nearby.q = form.q - weight * centre.force.ravel()
    return nearby


# Steps at full length from every combination, before those that have to lower the residual; and the most of the latter.
FULL_STEPS, LOWERING_STEPS = 12, 25
# What drawn combinations may cost, about a second: counted, not timed, so that answers are the same anywhere. A
# step takes an overhead and the number of equations cubed.
DRAWN_OPERATIONS, STEP_OVERHEAD = 1e9, 1.5e5
# How often a contact is open, sticks and slides.
DRAWN = (0.2, 0.35, 0.45)
# Parts of a drawn system beneath this, of its largest, are rounding.
DRAWN_RANK = 1e-10
# An error of this part of the forces is near an answer; forces beyond so many times those of the start are passed over.
NEAR_AN_ANSWER, MOST_WEDGED = 1e-6, 1e3


def drawn_combinations(form: LocalForm, start: Iterate) -> Iterator[Iterate]:
    """Yield where Newton's method comes to from combinations of states and directions of slip, drawn by a fixed seed.

    Steps at full length pass over points from which no step lowers the residual, and lowering steps follow them. What
    is neither near an answer nor nearer than all before is passed over, and so are wedges whose contacts press each
    other with far larger forces than those that balance the load at the start, or whose bodies are far away.
    """
    rng, left, count, best = np.random.default_rng(form.m), DRAWN_OPERATIONS, 0, np.inf
    a_step = STEP_OVERHEAD + (len(form.q) + form.joints) ** 3
    while left > 0 and not time_is_up():
        drawn = _drawn(form, rng)
        passed, taken = _at_full_length(form, drawn)
        found = newton(form, passed, LOWERING_STEPS)
        left -= a_step * (1 + taken + found.iterations + len(STEP_LENGTHS))
        count += 1
        if max(found.size, _motion(found)) > MOST_WEDGED * max(start.size, _motion(start)):
            continue
        if found.error < best or found.error <= NEAR_AN_ANSWER * found.size:
            best = min(best, found.error)
            yield Iterate(found.force, found.joint_force, found.error, count)


def _motion(iterate: Iterate) -> float:
    """Return the largest force of a joint, which for a rigid motion is how far it moves."""
    return float(np.max(abs(iterate.joint_force), initial=0.0))


def _drawn(form: LocalForm, rng: np.random.Generator) -> Iterate:
    """Return the forces of least norm that fit a drawn combination best, their signs as they come.

    Each contact has three unknown forces where it sticks, none where it is open, and its normal force where it slides
    in a given direction; as many of its velocities are to vanish.
    """
    m, d = form.m, form.d
    states, ways = rng.choice(3, m, p=DRAWN), rng.normal(size=(m, d - 1))
    ways *= (form.mu / np.maximum(lengths(ways), np.finfo(float).tiny))[:, None]
    closed = np.repeat(states > 0, d)
    closed[np.add.outer(d * np.flatnonzero(states == 2), np.arange(1, d))] = False
    at_rest = np.eye(m * d)[:, closed]
    pushed = np.eye(m * d)
    for i in np.flatnonzero(states == 2):
        pushed[d * i + 1 : d * (i + 1), d * i] = ways[i]
    forces = pushed[:, closed]
    matrix = np.block([[at_rest.T @ form.W @ forces, at_rest.T @ form.V], [form.V.T @ forces, form.R]])
    right = -np.concatenate([at_rest.T @ form.q, form.s])
    try:
        found = np.linalg.lstsq(matrix, right, rcond=DRAWN_RANK)[0]
    except np.linalg.LinAlgError:
        return Iterate.nothing(form)
    return Iterate.at(form, (forces @ found[: forces.shape[1]]).reshape(m, d), found[forces.shape[1] :])


def _at_full_length(form: LocalForm, here: Iterate) -> tuple[Iterate, int]:
    """Return the best of Newton's iterates at full length, hardly regularised, and how many there were."""
    best, taken = here, 0
    while taken < FULL_STEPS:
        taken += 1
        direction = _direction(form, here, REGULARISATION[1])
        if direction is None:
            break
        here = Iterate.at(form, here.force + direction[0], here.joint_force + direction[1])
        if not np.isfinite(here.error):
            break
        best = here if here.error < best.error else best
        if best.error <= ROUNDED * best.size:
            break
    return best, taken
