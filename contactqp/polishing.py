"""From a set of closed contacts to the answer on it, refined until rounding is gone.

The condensed saddle-point system acts as an approximate inverse; residuals are formed on the full problem in extended
precision and corrections added in extended precision (mixed-precision refinement; Higham 2002, chapter 12), so the answer is
right to the last digits of double precision as long as eps * condition number < 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactqp.condensation import Condensation
from contactqp.delassus import delassus
from contactqp.extended import Extended, extend, extended_rows
from contactqp.factorization import Array
from contactqp.nonnegative import dual_active_set
from contactqp.problem import ContactProblem, Vector
from contactqp.saddle import SaddlePoint
from contactqp.violations import Answer, force_measure, forces_that_meet

# Refinement stops when a sweep no longer halves the correction; good sets need three or four.
MAX_SWEEPS = 12
# What double precision cannot tell from zero, relative to the lengths or forces that meet.
ROUNDING = 8 * np.finfo(float).eps


@dataclass(frozen=True, eq=False)
class OnSet:
    """The equality-constrained answer on one set of closed contacts, in extended precision."""

    displacement: Extended
    normal_force: Extended
    tie_force: Extended
    gap: Extended
    saddle: SaddlePoint
    last_step: Vector  # (n,) of the refinement: what it still changed at its end
    contraction: float  # of the refinement: the part of a correction that its successor still finds missing


def answer_on(problem: ContactProblem, condensation: Condensation, closed: NDArray[np.intp]) -> OnSet:
    """K u + E_B'l_B + A'nu = f, E_B u = g_B, A u = b on the closed contacts B, refined."""
    rows = extended_rows(problem)
    saddle = SaddlePoint(condensation, closed)
    u, force, tie = (extend(np.zeros(size)) for size in (problem.dimension, problem.contacts, problem.ties))
    weight = np.sqrt(np.maximum(problem.stiffness.diagonal(), 0.0))
    row_weight = 1.0 / np.sqrt(delassus(condensation).compliance)
    sizes: list[float] = []
    for _ in range(MAX_SWEEPS):
        residual = extend(problem.load) - rows.internal_force(u) - rows.contact_force(force, tie)
        gap = extend(problem.gap) - rows.normal @ u
        open_tie = extend(problem.tie_value) - rows.tie @ u
        du, dl, dn = correction(condensation, saddle, residual, gap[closed], open_tie)
        u = u + du
        force[closed] += dl
        tie = tie + dn
        moved = np.max(weight * abs(du), initial=0.0)
        pushed = np.max(abs(np.concatenate([dl / row_weight[closed], dn / row_weight[problem.contacts :]])), initial=0.0)
        sizes.append(float(max(moved, pushed)))
        if sizes[-1] == 0 or (len(sizes) > 2 and sizes[-1] > 0.5 * sizes[-2]):
            break
    contraction = sizes[1] / sizes[0] if len(sizes) > 1 and sizes[0] else 0.0
    return OnSet(u, force, tie, extend(problem.gap) - rows.normal @ u, saddle, du, contraction)


def correction(
    condensation: Condensation, saddle: SaddlePoint, residual: Extended, gap: Extended, open_tie: Extended
) -> tuple[Vector, Vector, Vector]:
    """One solve of the full saddle-point system with the condensed factors, in double precision."""
    reduced, inner = condensation.reduce_load(np.asarray(residual, dtype=float))
    dx, dl, dn = saddle.solve(reduced, np.asarray(gap, dtype=float), np.asarray(open_tie, dtype=float))
    return condensation.expand(dx, inner), dl, dn


def closed_contacts(problem: ContactProblem, condensation: Condensation, u: Vector, force: Vector) -> NDArray[np.intp]:
    """The contacts that an answer says are closed: W_ii l_i > gap_i, both lengths."""
    compliance = delassus(condensation).compliance[: problem.contacts]
    return np.flatnonzero(compliance * force > problem.gap - problem.normal @ u)


def polish(
    problem: ContactProblem, condensation: Condensation, closed: NDArray[np.intp], max_corrections: int
) -> tuple[OnSet, int, bool]:
    """The refined answer on a set of closed contacts, the corrections of the set that it took, and whether its signs hold.

    A correction opens the contacts held in tension and closes those that are penetrated. Redundant contacts first
    get forces without tension, where such forces exist, and those with none leave the set.
    """
    seen: set[bytes] = set()
    corrections = 0
    while True:
        answer = answer_on(problem, condensation, closed)
        if answer.saddle.redundant:
            lean = _without_tension(condensation, answer)
            if len(lean) < len(closed):
                closed = lean
                answer = answer_on(problem, condensation, closed)
        tension, penetrated = _wrong(problem, answer, closed)
        if not tension.size and not penetrated.size:
            return answer, corrections, True
        seen.add(closed.tobytes())
        proposal = np.union1d(np.setdiff1d(closed, tension), penetrated).astype(np.intp)
        if corrections >= max_corrections or proposal.tobytes() in seen:
            return answer, corrections, False
        closed = proposal
        corrections += 1


def _wrong(problem: ContactProblem, answer: OnSet, closed: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Contacts in tension and contacts penetrated, beyond rounding."""
    u, force = np.asarray(answer.displacement, dtype=float), np.asarray(answer.normal_force, dtype=float)
    length = abs(problem.normal) @ abs(u) + abs(problem.gap)
    meeting = forces_that_meet(problem, Answer(u, force, None, np.asarray(answer.tie_force, dtype=float)))
    pull = force_measure(problem.normal, np.maximum(-force, 0.0), meeting)
    penetrated = np.flatnonzero(-answer.gap > ROUNDING * length)
    return np.flatnonzero(pull > ROUNDING), np.setdiff1d(penetrated, closed)


def _without_tension(condensation: Condensation, answer: OnSet) -> NDArray[np.intp]:
    """The members of a redundant set that carry its resultant without tension, if any can."""
    from scipy.optimize import nnls

    closed = answer.saddle.closed
    force = np.asarray(answer.normal_force[closed], dtype=float)
    contacts = condensation.normal[closed] * condensation.scale
    ties = condensation.tie * condensation.scale
    resultant = contacts.T @ force
    size = np.linalg.norm(resultant)
    if size == 0:
        return closed[:0]
    columns = np.vstack([contacts, ties, -ties])
    length = np.linalg.norm(columns, axis=1)
    share, missing = nnls((columns / length[:, None]).T, resultant / size, maxiter=30 * len(columns))
    if missing > 1e-9:
        return closed
    return closed[share[: len(closed)] > 1e-12]


def least_displacement(problem: ContactProblem, condensation: Condensation, answer: OnSet) -> tuple[Vector, Array]:
    """Among the displacements that differ by motions nothing drives and nothing resists, the one of least norm.

    Returns the displacement and an orthonormal basis (n, q) of those motions.
    """
    u = np.asarray(answer.displacement, dtype=float)
    Z = condensation.rigid.basis
    scaled = answer.saddle.free
    if not scaled.shape[1]:
        return u, np.zeros((problem.dimension, 0))
    retained = condensation.scale[:, None] * scaled
    coordinates, *_ = np.linalg.lstsq(Z[condensation.retained], retained, rcond=None)
    free, _ = np.linalg.qr(Z @ coordinates)
    shift = -(free.T @ u)
    rows = problem.normal @ free
    stays = np.linalg.norm(rows, axis=1) > ROUNDING * (abs(problem.normal) @ np.ones(problem.dimension))
    if np.any(stays):
        shift = _shift_within_gaps(rows[stays], np.asarray(answer.gap, dtype=float)[stays], shift)
    return u + free @ shift, free


def _shift_within_gaps(rows: Array, gap: Vector, wanted: Vector) -> Vector:
    """The shift nearest to the wanted one that closes no contact beyond touching: min |a - wanted|, rows a <= gap."""
    length = np.linalg.norm(rows, axis=1)
    unit, room = rows / length[:, None], np.maximum(gap, 0.0) / length
    none = np.zeros(len(room), dtype=bool)
    slack = 1e-15 * (abs(room) + abs(unit) @ abs(wanted))
    force, _, _ = dual_active_set(unit @ unit.T, unit @ wanted - room, none, slack, 50 * len(room) + 50)
    return np.asarray(wanted - unit.T @ force)
