"""The local form of a contact problem: what the contacts feel of each other through the bodies.

On the retained unknowns, scaled (`rows`), with H = [-N; T]' contact by contact and w = (g, -o), ties taken care of by
x = x0 + B y, A x0 = b, A B = 0, and rigid motions Z of what the ties leave,

    u = H'x + w = W r + q + V a,    W = H'B S_B^+ B'H,    V = H'B Z,    V'r + Z'B'(f - S x0) = 0,

where r_N = l_N, r_T = -l_T, and a are coordinates of the rigid motions. Contacts that cannot slide have no tangential
row, and any friction within its bound would do: it comes out as none.
"""

from __future__ import annotations

import numpy as np

from contactqp.condensation import UNRESISTED, Condensation
from contactqp.coulomb_cone import lengths
from contactqp.errors import NoEquilibrium
from contactqp.factorization import Array
from contactqp.friction.iterate import Iterate
from contactqp.friction.local_form import LocalForm
from contactqp.friction.rows import FrictionalRows
from contactqp.friction.states import OPEN, SLIP_BACK, SLIP_ON, STICK, Status, answer_in
from contactqp.local_problem import LocalProblem
from contactqp.problem import ContactProblem, Vector
from contactqp.violations import Answer

# Tie rows of unit length that leave more than this of their values open conflict.
CONFLICT = 1e-9
# A load that does this part of the work that its entries do, added up, drives a rigid motion by rounding only.
BALANCED = 1e-12


class ContactForm:
    """The local form of one contact problem, and the way back.

    Attributes
    ----------
    local : LocalProblem
        In scaled forces and lengths.
    """

    def __init__(self, problem: ContactProblem, condensation: Condensation, rows: FrictionalRows) -> None:
        self._problem, self._way, self._rows = problem, condensation, rows
        load, self._inner = condensation.reduce_load(problem.load)
        gap, origin, value = rows.lengths(problem)
        m, d = problem.contacts, rows.width + 1
        tangent = rows.tangent.reshape(m, rows.width, -1)
        self._H = np.concatenate([-rows.normal[:, None, :], tangent], axis=1).reshape(m * d, -1)  # its transpose
        start, basis = _of_ties(rows.tie, value)
        self._start, self._basis = start, basis
        motions = _null_motions(rows, basis)
        drive = _drive(problem, condensation, rows, basis @ motions)
        S = basis.T @ rows.S @ basis
        rigid = motions @ motions.T
        self._compliance = np.linalg.inv(S + rigid) - rigid if len(S) else S
        self._motions = motions
        self._load = basis.T @ (load * rows.scale - rows.S @ start)
        w = np.column_stack([gap, -origin.reshape(m, rows.width)]).ravel()
        HB = self._H @ basis
        resisted = _resisted(HB, motions)
        W = resisted @ self._compliance @ resisted.T
        self.local = LocalProblem(
            delassus=(W + W.T) / 2,
            offset=HB @ (self._compliance @ self._load) + self._H @ start + w,
            friction=rows.coefficient,
            dimension=d,
            bilateral=HB @ motions if motions.shape[1] else None,
            bilateral_offset=drive if motions.shape[1] else None,
            contact_names=problem.contact_names,
        )

    def answer(self, form: LocalForm, iterate: Iterate) -> Answer:
        """The answer of an iterate's combination of open, stick and slip, refined on the problem."""
        return answer_in(self._problem, self._way, self._rows, self.status(form, iterate), self.plain(form, iterate))

    def status(self, form: LocalForm, iterate: Iterate) -> Status:
        """Closed where r_N > u_N, sliding where |r_T - u_T| exceeds the bound, contacts having a compliance of one."""
        r, u = iterate.force, form.velocity(iterate.force, iterate.joint_force)
        pushed, trial = r[:, 0] - u[:, 0], r[:, 1:] - u[:, 1:]
        slides = lengths(trial) > form.mu * np.maximum(pushed, 0.0)
        # The force on the body opposes the slip.
        direction = np.where(trial[:, 0] < 0, SLIP_ON, SLIP_BACK) if form.d == 2 else np.full(form.m, SLIP_ON)
        closed = np.where(slides | (form.mu == 0), direction, STICK)
        return np.where(pushed > 0, closed, OPEN).astype(np.int8)

    def scaled_normal(self, normal_force: Vector) -> Array:
        """Forces (m, d) of the local form with normal forces (m,) of the problem, and no friction."""
        force = np.zeros((len(normal_force), self.local.dimension))
        force[:, 0] = np.maximum(normal_force, 0.0) * self._rows.normal_length
        return force

    def plain(self, form: LocalForm, iterate: Iterate) -> Answer:
        """The answer as the iterate has it."""
        rows = self._rows
        force, joint = form.unscaled(iterate.force, iterate.joint_force)
        driven = self._load + self._basis.T @ (self._H.T @ force.ravel())
        x = self._start + self._basis @ (self._compliance @ driven + self._motions @ joint)
        tie: Vector = np.zeros(0)
        if len(rows.tie):
            load, _ = self._way.reduce_load(self._problem.load)
            left = load * rows.scale - rows.S @ x + self._H.T @ force.ravel()
            tie = np.asarray(np.linalg.lstsq(rows.tie.T, left, rcond=None)[0], dtype=float)
        return Answer(
            self._way.expand(x * rows.scale, self._inner),
            force[:, 0] / rows.normal_length,
            -force[:, 1:] / rows.tangent_length[:, None],
            tie / rows.tie_length,
        )


def _resisted(rows: Array, motions: Array) -> Array:
    """What of rows is no rigid motion; exactly nothing where it is rounding, so that its compliance is none."""
    left = rows - (rows @ motions) @ motions.T
    size = np.linalg.norm(rows, axis=1)
    return np.where((np.linalg.norm(left, axis=1) > UNRESISTED * size)[:, None], left, 0.0)


def _drive(problem: ContactProblem, condensation: Condensation, rows: FrictionalRows, motions: Array) -> Vector:
    """z'f of every rigid motion, whose retained unknowns are given; exactly nothing where it is rounding."""
    rigid = condensation.rigid
    if not motions.shape[1]:
        return np.zeros(0)
    retained = rigid.motions[condensation.retained] / rows.scale[:, None]
    whole = rigid.motions @ np.linalg.lstsq(retained, motions, rcond=None)[0]
    work, size = whole.T @ problem.load, abs(whole).T @ abs(problem.load)
    return np.asarray(np.where(abs(work) <= max(BALANCED, rigid.uncertainty) * size, 0.0, work))


def _of_ties(tie: Array, value: Vector) -> tuple[Vector, Array]:
    """x0 with A x0 = b of least norm, and an orthonormal basis of A's null space."""
    if not len(tie):
        return np.zeros(tie.shape[1]), np.eye(tie.shape[1])
    left, size, right = np.linalg.svd(tie)
    rank = int(np.sum(size > UNRESISTED * size[0]))
    start = right[:rank].T @ ((left[:, :rank].T @ value) / size[:rank])
    if np.max(abs(tie @ start - value), initial=0.0) > CONFLICT * np.max(abs(value), initial=0.0):
        raise NoEquilibrium("friction: the ties contradict each other")
    return start, right[rank:].T


def _null_motions(rows: FrictionalRows, basis: Array) -> Array:
    """An orthonormal basis of the rigid motions that the ties leave, in coordinates of `basis`."""
    motions = rows.motions
    if not motions.shape[1]:
        return np.zeros((basis.shape[1], 0))
    if len(rows.tie):
        _, size, right = np.linalg.svd(rows.tie @ motions)
        motions = motions @ right[int(np.sum(size > UNRESISTED)) :].T
    return np.asarray(basis.T @ motions)
