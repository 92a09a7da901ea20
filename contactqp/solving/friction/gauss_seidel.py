"""Nonsmooth Gauss-Seidel (Jourdan, Alart, Jean 1998), contact by contact with the other forces fixed.

Each contact solves its own law with its own block of W: in the plane by trying open, stick and slip both ways; in space
by projections r <- P_K(r - rho (u + mu |u_T| e_N)), with adaptive rho (Acary, Bremond, Huber 2018, self-adaptive fixed
point). Uncoupled contacts have one colour and are updated together. Joints follow every sweep by a proximal step, by
which conditions V'r = -s on the forces, R = 0, become springs 1/e on the contacts and multipliers (augmented
Lagrangian).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.coulomb_law import de_saxce, onto_cone
from contactqp.errors import NotConverged
from contactqp.linalg.measures import lengths, reciprocal
from contactqp.model.arrays import Array, Indices, Mask, Vector
from contactqp.solving.friction.local_form import Iterate, LocalForm

# The number of projections of one contact in one sweep, which need not converge while the others still change.
LOCAL_STEPS = 12
# rho shrinks if the relative change of velocity in a step exceeds the first number, and grows below the second.
TOO_LONG, TOO_SHORT = 0.9, 0.3
SHRINK, GROW = 2.0 / 3.0, 1.5
# The compliance that stands for joints without any.
JOINT_COMPLIANCE = 1.0


def gauss_seidel(form: LocalForm, start: Iterate) -> Iterator[Iterate]:
    """Yield an iterate for each sweep, without end; its error says how far it is from a solution."""
    sweeps = _Sweeps(form, start)
    count = 0
    while True:
        sweeps.once()
        count += 1
        if not np.all(np.isfinite(sweeps.r)):
            raise NotConverged(f"nsgs: the forces have overflowed after {count} sweeps")
        yield Iterate.at(form, sweeps.r.copy(), sweeps.joint.copy(), count)


class _Sweeps:
    def __init__(self, form: LocalForm, start: Iterate) -> None:
        self._form = form
        self.r, self.joint = start.force.copy(), start.joint_force.copy()
        W = form.W
        if form.joints:
            # Positive where a joint has a compliance, negative where it is a condition on the forces.
            self._regular = JOINT_COMPLIANCE * form.joint_signs
            self._stiffness = np.linalg.inv(form.R + np.diag(self._regular))
            W = W - form.V @ self._stiffness @ form.V.T
        self._W = sp.csr_array(W) if form.sparse else W
        self._blocks = own_blocks(self._W, form.m, form.d)
        largest = np.linalg.norm(self._blocks, axis=(1, 2))
        self._rho = 1.0 / np.where(largest > 0, largest, 1.0)
        self._colours = [(colour, self._rows(colour)) for colour in colours(self._W, form.m, form.d)]

    def _rows(self, colour: Indices) -> Array:
        d = self._form.d
        rows: Array = self._W[(d * colour[:, None] + np.arange(d)).ravel()]
        return rows

    def once(self) -> None:
        """Make one sweep over all contacts."""
        form, q = self._form, self._form.q
        if form.joints:
            # The part of l = (R + e)^-1 (e l_old - s - V'r) that does not depend on r.
            held = self._stiffness @ (self._regular * self.joint - form.s)
            q = q + form.V @ held
        q = q.reshape(form.m, form.d)
        for colour, rows in self._colours:
            own, before = self._blocks[colour], self.r[colour]
            outer = (rows @ self.r.ravel()).reshape(len(colour), form.d) + q[colour]
            outer -= np.einsum("iab,ib->ia", own, before)
            self.r[colour], self._rho[colour] = solve_contacts(own, outer, form.mu[colour], before, self._rho[colour])
        if form.joints:
            self.joint = self._stiffness @ (self._regular * self.joint - form.s - form.V.T @ self.r.ravel())


def solve_in_plane(own: Array, outer: Array, mu: Vector) -> tuple[Array, Mask]:
    """Return forces (k, 2) of single contacts, u = W_ii r + q_i, and which have a solution; open is tried first, then
    stick.
    """
    a, b, c, e = own[:, 0, 0], own[:, 0, 1], own[:, 1, 0], own[:, 1, 1]
    normal, tangential = outer[:, 0], outer[:, 1]
    r, done = np.zeros_like(outer), normal >= 0
    determinant = a * e - b * c
    inverse = reciprocal(determinant)
    stuck = np.column_stack([b * tangential - e * normal, c * normal - a * tangential]) * inverse[:, None]
    held = ~done & (determinant > 0) & (stuck[:, 0] >= 0) & (abs(stuck[:, 1]) <= mu * stuck[:, 0])
    r[held], done = stuck[held], done | held
    for way in (1.0, -1.0):
        share = way * mu
        push = np.divide(-normal, a + b * share, out=np.full_like(a, -1.0), where=a + b * share > 0)
        slides = ~done & (push >= 0) & (way * (tangential + (c + e * share) * push) <= 0)
        r[slides, 0], r[slides, 1], done = push[slides], (share * push)[slides], done | slides
    return r, done


def solve_contacts(own: Array, outer: Array, mu: Vector, start: Array, rho: Vector) -> tuple[Array, Vector]:
    """Return forces (k, d) of k single contacts, u = W_ii r + q_i, and the adapted steps rho (k,).

    Parameters
    ----------
    own : (k, d, d) array, the blocks W_ii of the contacts
    outer : (k, d) array, the velocities q_i that all other forces give them
    mu : (k,) array, the coefficients of friction
    start : (k, d) array, the forces so far
    rho : (k,) array, the steps of projections so far
    """
    if own.shape[1] == 2:
        r, solved = solve_in_plane(own, outer, mu)
        if np.all(solved):
            return r, rho
        rest = ~solved
        rho = rho.copy()
        r[rest], rho[rest] = projected(own[rest], outer[rest], mu[rest], start[rest], rho[rest])
        return r, rho
    return projected(own, outer, mu, start, rho)


def projected(own: Array, outer: Array, mu: Vector, start: Array, rho: Vector) -> tuple[Array, Vector]:
    """Do the same as `solve_contacts`, by a few projections.

    Parameters
    ----------
    own, outer, mu, start, rho
        As in `solve_contacts`.
    """
    r, rho = start.copy(), rho.copy()
    for _ in range(LOCAL_STEPS):
        velocity = de_saxce(np.einsum("iab,ib->ia", own, r) + outer, mu)
        for _ in range(3):
            trial = onto_cone(r - rho[:, None] * velocity, mu)
            changed = de_saxce(np.einsum("iab,ib->ia", own, trial) + outer, mu)
            moved = lengths(trial - r)
            slope = np.divide(rho * lengths(changed - velocity), moved, out=np.zeros_like(moved), where=moved > 0)
            overshoots = slope > TOO_LONG
            if not np.any(overshoots):
                break
            rho = np.where(overshoots, rho * SHRINK * np.minimum(1.0, 1.0 / slope.clip(1e-300)), rho)
        r = trial
        rho = np.where((slope < TOO_SHORT) & (moved > 0), rho * GROW, rho)
        if not np.any(moved > 1e-16 * lengths(r)):
            break
    return r, rho


def colours(W: Array, m: int, d: int) -> list[Indices]:
    """Return groups of uncoupled contacts, found greedily."""
    if not sp.issparse(W):
        coupled = (W != 0).reshape(m, d, m, d).any(axis=(1, 3))
        if coupled.all():
            return [np.array([i]) for i in range(m)]
        pairs = sp.csr_array(coupled | coupled.T)
    else:
        entries = sp.coo_array(W)
        pairs = sp.csr_array((np.ones(entries.nnz), (entries.row // d, entries.col // d)), shape=(m, m))
        pairs = sp.csr_array(pairs + pairs.T)
    colour = np.full(m, -1)
    for i in range(m):
        taken = set(colour[pairs.indices[pairs.indptr[i] : pairs.indptr[i + 1]]].tolist())
        colour[i] = next(c for c in range(m + 1) if c not in taken)
    return [np.flatnonzero(colour == c) for c in range(int(colour.max(initial=-1)) + 1)]


def own_blocks(W: Array, m: int, d: int) -> Array:
    """Return the diagonal blocks (m, d, d)."""
    if not sp.issparse(W):
        return np.asarray(W.reshape(m, d, m, d)[np.arange(m), :, np.arange(m)])
    entries = sp.coo_array(W)
    own = entries.row // d == entries.col // d
    blocks = np.zeros((m, d, d))
    row, column = entries.row[own], entries.col[own]
    np.add.at(blocks, (row // d, row % d, column % d), entries.data[own])
    return blocks
