"""Recover missing parts of an answer from the given ones.

Forces from displacements: equilibrium with the rows B = [E_N; E_T; A],

    B'l = f - K u,

is solved by least squares with unknowns scaled by energy; dependent rows share their resultant without tension if
possible. The remainder is left as a residual for the certificate.

Displacements from forces: K u + A'nu = f - E_N'l_N - E_T'l_T, A u = b. Floating bodies are then shifted by the least
motion that closes the contacts with force; with friction also sticking contacts keep their position, slipping ones slip
along their friction, and no other contact is penetrated.

Both magnify rounding errors, for stiff bodies and for displacements that are small differences of large ones. Each
therefore has an alternative, which is used if only this passes the certificate: the forces that hold the touching
contacts at their gaps, and the displacement with the contacts with force closed. The certificate judges both by the
original problem; `judging.certify_given` takes the completion that passes.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import Unsupported
from contactqp.linalg.condensation import condense, free_motions
from contactqp.linalg.dense import orthonormal, saddle_point, unknown_scale
from contactqp.linalg.extended import extend, extended_rows
from contactqp.linalg.iteration import factorised, iterated, may_be_factorised
from contactqp.linalg.least_norm import shift_to_least_norm
from contactqp.linalg.measures import directions, lengths, lengths_that_meet
from contactqp.linalg.nonnegative import forces_without_tension, shift_within_gaps
from contactqp.linalg.refinement import answer_on, pushing_contacts
from contactqp.model.arrays import EPS, Array, Indices, Mask, Vector
from contactqp.model.coulomb import slips
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer

# Forces of rows that balance a given residual: B'l = r by least squares, for one connected group at a time.

# The tolerance of dependence for rows of unit length.
DEPENDENT_UNIT_ROWS = 1e-12
# Groups of more rows are solved iteratively.
DENSE_ROWS = 1500
# The largest relative increase of the residual for forces without tension.
NEARLY_AS_WELL = 1e-9
# The relative error of zero forces by least squares, over the balanced residual.
FIT_ROUNDING = 16 * EPS
# Forces above this part of the largest count as acting; HiGHS' linear programs have errors of 1e-7.
ACTING = 1e-6


def balancing_forces(
    rows: Any, residual: Vector, pushing_only: Mask, scale: Vector, left: Vector | None = None
) -> tuple[Vector, bool]:
    """Return forces l (q,) of rows B (q, n) with B'l = r, and whether some rows are dependent.

    Unknowns are scaled by `scale` (n,), 1/sqrt(K_jj). Forces of dependent rows are chosen without tension if that
    balances the residual as well, and with the least l'd if the lengths d (q,) of the rows, g - E u and b - A u, are
    given: forces with the same resultant have the same displacement, and the multipliers of the minimum are those of
    the largest dual energy.

    Parameters
    ----------
    rows : matrix (q, n), B, of contacts, tangents and ties
    residual : (n,) array, r, to be balanced by forces on the rows [force]
    pushing_only : (q,) array of bool, rows whose forces may not be negative
    scale : (n,) array, 1/sqrt(K_jj)
    left : (q,) array, optional
        The lengths d that the rows leave.
    """
    from scipy.sparse.csgraph import connected_components

    count = rows.shape[0]
    force, shared = np.zeros(count), False
    if not count:
        return force, shared
    scaled = sp.csr_matrix(rows @ sp.diags(scale))
    length = np.sqrt(np.asarray(scaled.multiply(scaled).sum(axis=1))).ravel()
    length[length == 0] = 1.0  # a push and its friction may cancel, and such a row exerts nothing
    scaled = sp.csr_matrix(sp.diags(1 / length) @ scaled)
    target = residual * scale
    _, label = connected_components(abs(scaled) @ abs(scaled).T, directed=False)
    order = np.argsort(label, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(label[order])) + 1):
        part = scaled[members]
        touched = np.unique(part.indices)
        B, r = part[:, touched], target[touched]
        if len(members) > DENSE_ROWS:
            force[members] = _iteratively(B, r)
            continue
        cost = np.zeros(len(members)) if left is None else left[members] / length[members]
        force[members], dependent = _densely(B.toarray(), r, pushing_only[members], cost)
        shared |= dependent
    return force / length, shared


def _densely(B: Array, r: Vector, pushing_only: Mask, cost: Vector) -> tuple[Vector, bool]:
    if len(B) == 1:
        return B @ r, False
    force, _, rank, _ = np.linalg.lstsq(B.T, r, rcond=DEPENDENT_UNIT_ROWS)
    if rank == len(B):  # a force beneath the rounding of the sum is none
        return np.where(abs(force) > FIT_ROUNDING * np.linalg.norm(r), force, 0.0), False
    size = float(np.linalg.norm(r))
    if size == 0:
        return np.zeros(len(B)), True
    share, left = forces_without_tension(B, r / size, pushing_only)
    most = np.linalg.norm(B.T @ force - r) / size + NEARLY_AS_WELL
    if not left <= most:
        return np.asarray(force), True
    if np.any(cost) and np.any(share):  # without acting rows there is no choice
        chosen = _of_least_work(B, share, pushing_only, cost)
        cheaper, left = forces_without_tension(B[chosen], r / size, pushing_only[chosen])
        if left <= most:
            share = np.zeros(len(B))
            share[chosen] = cheaper
    return size * share, True


def _of_least_work(B: Array, force: Vector, pushing_only: Mask, cost: Vector) -> Indices:
    """Return the acting rows of the forces with the same resultant B'l and the least work l'd, by a linear program."""
    from scipy.linalg import null_space
    from scipy.optimize import linprog

    free = null_space(B.T, rcond=DEPENDENT_UNIT_ROWS)
    largest = np.max(abs(force))
    found = linprog(
        (cost / np.max(abs(cost))) @ free,
        A_ub=-free[pushing_only],
        b_ub=force[pushing_only] / largest,
        bounds=(None, None),
        method="highs",
    )
    if found.x is None:
        return np.arange(len(B))
    return np.flatnonzero(~pushing_only | (force / largest + free @ found.x > ACTING))


def _iteratively(B: Any, r: Vector) -> Vector:
    from scipy.sparse.linalg import lsqr

    return np.asarray(lsqr(B.T, r, atol=1e-15, btol=1e-15, conlim=0.0, iter_lim=20 * B.shape[0])[0])


# Forces of dependent frictional contacts that obey Coulomb's law, from a displacement.
#
# The force of a slipping contact has one direction, l_N (1, mu s/|s|); that of a sticking contact is a nonnegative
# combination of the edges of its cone, in space of an inscribed polygon. Least squares of equilibrium over nonnegative
# combinations give forces within the law if they exist. With given normal forces the coefficients of a contact add up
# to its force, with a slack variable if it sticks.

# A gap or a slip below this part of its lengths counts as zero.
ZERO_GAP = 1e-9
# Sides of the polygon that replaces the cone of a sticking contact in space.
SIDES = 32


def _tangential_lengths(problem: ContactProblem, displacement: Vector) -> Vector:
    """Return |L| (m,) of each contact's tangential rows [length], without rows at rest if another one moves.

    It is infinite if all are at rest.
    """
    if problem.tangent is None or problem.slip_origin is None:
        return np.full(problem.contacts, np.inf)
    meeting = lengths_that_meet(problem, problem.tangent, problem.slip_origin.ravel(), displacement)
    meeting = meeting.reshape(problem.slip_origin.shape)
    finite = np.where(np.isfinite(meeting), meeting, 0.0)
    return np.where(np.any(finite > 0, axis=1), lengths(finite), np.inf)


def lawful_share(
    problem: ContactProblem,
    answer: Answer,
    residual: Vector,
    tied: bool,
    push: Vector | None = None,
    none: float = ZERO_GAP,
) -> Answer | None:
    """Return a displacement with contact and tie forces that obey the law, None without friction.

    Parameters
    ----------
    problem : ContactProblem
    answer : its displacement is kept; so are its tie forces unless `tied`
    residual : (n,) array [force], f - K u less the tie forces that are known
    tied : whether the ties share in the residual
    push : (m,) array [force], optional
        The normal forces if known; the residual is then balanced by friction and ties.
    none : float, optional
        A gap or a slip below this part of its lengths is zero.
    """
    slip = slips(problem, answer.displacement)
    if slip is None or problem.tangent is None or problem.friction is None:
        return None
    m, width = slip.shape
    gap = problem.gap - problem.normal @ answer.displacement
    length = lengths_that_meet(problem, problem.normal, problem.gap, answer.displacement)
    touching = gap <= none * length
    moving = lengths(slip) > none * _tangential_lengths(problem, answer.displacement)
    contacts, ways = _edges(touching, moving, directions(slip))
    drag = problem.friction[contacts, None] * ways
    columns = (width * contacts[:, None] + np.arange(width)).ravel()
    places = np.repeat(np.arange(len(contacts)), width)
    spread = sp.csr_matrix((drag.ravel(), (places, columns)), shape=(len(contacts), m * width))
    scale, edges = unknown_scale(problem), spread @ sp.csr_matrix(problem.tangent)
    if push is None:
        edges = edges + sp.csr_matrix(problem.normal[contacts])
    else:
        idle = np.flatnonzero(touching & ~moving)
        parts = sp.eye(m, format="csr")[np.concatenate([contacts, idle])]
        edges = sp.hstack([sp.vstack([edges, sp.csr_matrix((len(idle), len(scale)))]), parts])
        residual, scale = np.concatenate([residual, push]), np.concatenate([scale, np.full(m, np.median(scale))])
    tie = sp.csr_matrix(problem.tie)
    tie.resize(tie.shape[0], len(scale))
    pushing_only = np.arange(edges.shape[0] + tied * tie.shape[0]) < edges.shape[0]
    share, _ = balancing_forces(sp.vstack([edges, tie]) if tied else edges, residual, pushing_only, scale)
    normal, friction = np.zeros(m), np.zeros(slip.shape)
    np.add.at(normal, contacts, share[: len(contacts)])
    np.add.at(friction, contacts, share[: len(contacts), None] * drag)
    normal = normal if push is None else push
    return Answer(answer.displacement, normal, friction, share[edges.shape[0] :] if tied else answer.tie_force)


def _edges(touching: Mask, moving: Mask, along: Array) -> tuple[Indices, Array]:
    """Return the contact (q,) and the direction (q, d-1) of each admissible edge of a cone."""
    slipping, sticking = np.flatnonzero(touching & moving), np.flatnonzero(touching & ~moving)
    if along.shape[1] == 1:
        every = np.array([[1.0], [-1.0]])
    else:
        angle = 2 * np.pi * np.arange(SIDES) / SIDES
        every = np.column_stack([np.cos(angle), np.sin(angle)])
    contacts = np.concatenate([slipping, np.repeat(sticking, len(every))])
    return contacts, np.concatenate([along[slipping], np.tile(every, (len(sticking), 1))])


# Given gaps below this part of their lengths, and forces below this part of the largest, count as zero.
TOUCHING, PUSHING = 1e-6, 1e-12
# Given friction within this part of its bound slips, as both may be printed with six digits.
AT_BOUND = 2e-5
NO_CONTACTS = np.zeros(0, dtype=np.intp)


def pressed(problem: ContactProblem, answer: Answer, missing: tuple[str, ...]) -> Iterator[tuple[Answer, str]]:
    """Yield answers with forces computed from the displacement."""
    rows = extended_rows(problem)
    residual = extend(problem.load) - rows.stiffness @ extend(answer.displacement)
    residual = residual - rows.contact_force(extend(answer.normal_force), extend(answer.tie_force))
    residual = residual - rows.friction_force(answer.friction_force)
    everything = _Unknowns(problem, missing, np.arange(problem.contacts))
    pulls = np.arange(everything.rows.shape[0]) >= everything.normals
    ahead = None if problem.tangent is not None else everything.missed_lengths(answer.displacement)
    found, shared = balancing_forces(everything.rows, residual.double(), ~pulls, unknown_scale(problem), ahead)
    how = "by equilibrium" + (", shared without tension among rows that depend on one another" if shared else "")
    yield everything.filled(answer, found), how
    if problem.frictional and "friction_force" in missing:
        push = None if "normal_force" in missing else answer.normal_force
        which = " among rows that depend on one another" if shared else ""
        for none in (ZERO_GAP, TOUCHING):
            lawful = lawful_share(problem, answer, residual.double(), "tie_force" in missing, push, none)
            if lawful is not None:
                yield lawful, f"by equilibrium, shared within the law{which}"
    if iterated(problem):
        return
    gap = problem.gap - problem.normal @ answer.displacement
    length = lengths_that_meet(problem, problem.normal, problem.gap, answer.displacement)
    touching = _Unknowns(problem, missing, np.flatnonzero(gap <= TOUCHING * length))
    load = (extend(problem.load) - rows.contact_force(extend(answer.normal_force), extend(answer.tie_force))).double()
    load = load - rows.friction_force(answer.friction_force).double()
    felt = np.diff(touching.rows.indptr) > 0  # supported tangents need no constraint
    held, rows_felt = np.zeros(len(felt)), touching.rows[felt]
    held[felt] = _held(problem, load, rows_felt, rows_felt @ answer.displacement)[1]
    yield touching.filled(answer, held), "as what holds the touching contacts where they are"


class _Unknowns:
    """The rows whose forces are missing, normal ones first, and the indices of these forces."""

    def __init__(self, problem: ContactProblem, missing: tuple[str, ...], contacts: Indices) -> None:
        self._problem, self._missing, self._contacts = problem, missing, contacts
        blocks = []
        self.normals = len(contacts) if "normal_force" in missing else 0
        if self.normals:
            blocks.append(problem.normal[contacts])
        if "friction_force" in missing and problem.tangent is not None and problem.slip_origin is not None:
            width = problem.slip_origin.shape[1]
            blocks.append(problem.tangent[(width * contacts[:, None] + np.arange(width)).ravel()])
        if "tie_force" in missing:
            blocks.append(problem.tie)
        none = sp.csr_matrix((0, problem.dimension))
        self.rows = sp.csr_matrix(sp.vstack([sp.csr_matrix(block) for block in blocks])) if blocks else none

    def missed_lengths(self, displacement: Vector) -> Vector:
        """Return gaps and tie residuals b - A u of the rows, without friction."""
        rows, u = extended_rows(self._problem), extend(displacement)
        gap = (extend(self._problem.gap) - rows.normal @ u).double()[self._contacts]
        tie = (extend(self._problem.tie_value) - rows.tie @ u).double()
        return np.concatenate([gap if self.normals else gap[:0], tie if "tie_force" in self._missing else tie[:0]])

    def filled(self, answer: Answer, found: Vector) -> Answer:
        """Return the known answer with the forces of these rows."""
        normal, friction, tie = answer.normal_force, answer.friction_force, answer.tie_force
        if "normal_force" in self._missing:
            normal = np.zeros(self._problem.contacts)
            normal[self._contacts] = found[: self.normals]
        rest = found[self.normals :]
        if "friction_force" in self._missing and friction is not None:
            chosen = friction[self._contacts]
            count = chosen.size
            friction = np.zeros_like(friction)
            friction[self._contacts] = rest[:count].reshape(chosen.shape)
            rest = rest[count:]
        return Answer(answer.displacement, normal, friction, rest if "tie_force" in self._missing else tie)


def displaced(problem: ContactProblem, answer: Answer, missing: tuple[str, ...]) -> Iterator[tuple[Answer, str]]:
    """Yield answers with displacement and tie forces computed from contact forces."""
    if iterated(problem) and may_be_factorised(problem):
        with factorised(problem):
            yield from displaced(problem, answer, missing)
        return
    if iterated(problem):
        raise Unsupported(
            "certify: forces alone take a factorisation of the stiffness, and the body is too large for one; expected "
            "displacement too"
        )
    rows = extended_rows(problem)
    nothing = extend(np.zeros(problem.ties))
    dragged_load = extend(problem.load) - rows.friction_force(answer.friction_force)
    load = (dragged_load - rows.contact_force(extend(answer.normal_force), nothing)).double()
    push = answer.normal_force > PUSHING * np.max(abs(answer.normal_force), initial=0.0)
    closed = np.flatnonzero(push)
    u, tie, free = _held(problem, load, problem.tie, problem.tie_value, closed)
    yield _completed(answer, u, tie, missing), "the bodies' response"
    how = "the bodies' response, moved along what nothing resists to where the law allows the forces"
    if (shift := _shift_within_law(problem, answer, u, free, closed)) is not None:
        yield _completed(answer, u + shift, tie, missing), how
    for rows, values, held, known in _lengths_held(problem, answer, closed):
        load = (extend(problem.load) - extended_rows(problem).friction_force(known)).double()
        u, forces, free = _held(problem, load, rows, values)
        tie = forces[: problem.ties]
        yield _completed(answer, u, tie, missing), f"the bodies' response, {held}"
        if (shift := _shift_within_law(problem, answer, u, free, closed)) is not None:
            yield _completed(answer, u + shift, tie, missing), f"{how}, {held}"
    if not problem.frictional:
        whole = Answer(u, answer.normal_force, None, tie)
        shift, _ = shift_to_least_norm(problem, condense(problem), whole, pushing_contacts(problem, whole))
        if shift.any():
            how = "the bodies' response, moved within the gaps along what no contact resists"
            yield _completed(answer, u + shift, tie, missing), how


def _lengths_held(
    problem: ContactProblem, answer: Answer, closed: Indices
) -> Iterator[tuple[Any, Vector, str, Array | None]]:
    """Yield the rows constrained by the law at contacts with force (`closed`), their values and numbers, and the
    friction that acts as a load: first ties and normal rows, then also the tangential rows of sticking contacts.
    """
    if not closed.size:
        return
    rows = sp.vstack([sp.csr_matrix(problem.tie), sp.csr_matrix(problem.normal[closed])])
    values = np.concatenate([problem.tie_value, problem.gap[closed]])
    yield rows, values, "the pushing contacts held closed", answer.friction_force
    if problem.tangent is None or problem.slip_origin is None or answer.friction_force is None:
        return
    sticking = _inside_the_cone(problem, answer, closed)
    if sticking.size:
        width = problem.slip_origin.shape[1]
        along = problem.tangent[(width * sticking[:, None] + np.arange(width)).ravel()]
        known = answer.friction_force.copy()
        known[sticking] = 0.0
        rows = sp.vstack([rows, sp.csr_matrix(along)])
        values = np.concatenate([values, problem.slip_origin[sticking].ravel()])
        yield rows, values, "the pushing contacts held closed, and those inside the cone where they stick", known


def _inside_the_cone(problem: ContactProblem, answer: Answer, pushing: Indices) -> Indices:
    """Return the contacts with force whose friction is below its bound by more than printed digits."""
    assert problem.friction is not None
    assert answer.friction_force is not None
    bound = (1 - AT_BOUND) * problem.friction[pushing] * answer.normal_force[pushing]
    return np.asarray(pushing[lengths(answer.friction_force[pushing]) < bound])


def _completed(answer: Answer, u: Vector, tie: Vector, missing: tuple[str, ...]) -> Answer:
    return Answer(u, answer.normal_force, answer.friction_force, tie if "tie_force" in missing else answer.tie_force)


def _held(
    problem: ContactProblem, load: Vector, rows: Array, values: Vector, pushing: Indices = NO_CONTACTS
) -> tuple[Vector, Vector, Array]:
    """Solve K u + B'l = load with B u = values.

    Returns u (n,), the forces l of the rows and an orthonormal basis (n, q) of the remaining rigid motions. Along these
    u is shifted by the least motion that closes the contacts with force.
    """
    system = ContactProblem(
        stiffness=problem.stiffness,
        load=load,
        normal=sp.csr_matrix((0, problem.dimension)),
        gap=[],
        tie=sp.csr_matrix(rows),
        tie_value=values,
    )
    condensation = condense(system)
    found = answer_on(system, condensation, NO_CONTACTS)
    u = found.displacement
    free = free_motions(condensation, saddle_point(condensation, NO_CONTACTS))
    if free.shape[1] and pushing.size:
        ahead = extend(problem.gap) - extended_rows(problem).normal @ u
        shift, *_ = np.linalg.lstsq(problem.normal[pushing] @ free, ahead.double()[pushing], rcond=1e-12)
        u = u + free @ shift
    return u.double(), found.tie_force.double(), free


def _shift_within_law(
    problem: ContactProblem, answer: Answer, displacement: Vector, free: Array, pushing: Indices
) -> Vector | None:
    """Return the least motion along `free` (n, q) with which the given friction satisfies Coulomb's law.

    Contacts with force are closed, E_N u = g; those whose friction is below its bound stay at their slip origin; the
    slip of the others is along their friction, s x l_T = 0 and s'l_T >= 0; no contact is penetrated. The norm is scaled
    by energy. None if nothing floats or there is no friction.
    """
    slip, friction = slips(problem, displacement), answer.friction_force
    if not free.shape[1] or problem.friction is None or problem.tangent is None:
        return None
    assert slip is not None
    assert friction is not None
    scale = unknown_scale(problem)
    basis = scale[:, None] * orthonormal(free / scale[:, None])
    gap = problem.gap - problem.normal @ displacement
    normal = problem.normal @ basis
    tangent = (problem.tangent @ basis).reshape(*slip.shape, -1)
    bound = problem.friction * answer.normal_force
    sticking = _inside_the_cone(problem, answer, pushing)
    slipping = pushing[(bound[pushing] > 0) & ~np.isin(pushing, sticking)]
    along = directions(friction)[slipping]
    across = np.column_stack([-along[:, 1], along[:, 0]]) if along.shape[1] == 2 else np.zeros_like(along)
    held = [normal[pushing], tangent[sticking].reshape(-1, basis.shape[1])]
    held.append(np.einsum("id,idq->iq", across, tangent[slipping]))
    missed = np.concatenate([gap[pushing], -slip[sticking].ravel(), -np.sum(across * slip[slipping], axis=1)])
    start, _, rank, _ = np.linalg.lstsq(np.vstack(held), missed, rcond=DEPENDENT_UNIT_ROWS)
    left = np.linalg.svd(np.vstack(held))[2][rank:].T
    apart = np.flatnonzero(np.isfinite(gap) & ~np.isin(np.arange(len(gap)), pushing))
    bounded: Array = np.vstack([normal[apart], -np.einsum("id,idq->iq", along, tangent[slipping])])
    room = np.concatenate([gap[apart], np.sum(along * slip[slipping], axis=1)]) - bounded @ start
    felt = np.linalg.norm(bounded @ left, axis=1) > DEPENDENT_UNIT_ROWS * np.linalg.norm(bounded, axis=1)
    if felt.any():
        start = start + left @ shift_within_gaps(bounded[felt] @ left, room[felt], np.zeros(left.shape[1]))
    return np.asarray(basis @ start)
