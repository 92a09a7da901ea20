"""The local form of a contact problem: what the contacts feel of each other through the bodies.

On the retained unknowns, scaled (`rows`), with H = [-N; T]' contact by contact and w = (g, -o), ties taken care of by
x = x0 + B y, A x0 = b, A B = 0, and rigid motions Z of what the ties leave,

    u = H'x + w = W r + q + V a,    W = H'B S_B^+ B'H,    V = H'B Z,    V'r + Z'B'(f - S x0) = 0,

where r_N = l_N, r_T = -l_T, and a are coordinates of the rigid motions (`contact_operator`). Contacts that cannot slide
have no tangential row, and any friction within its bound would do: it comes out as none.
"""

from __future__ import annotations

import numpy as np

from contactqp.linalg.condensation import Condensation
from contactqp.linalg.friction_states import OPEN, SLIP_BACK, SLIP_ON, STICK, Status, answer_in
from contactqp.linalg.frictional_rows import FrictionalRows
from contactqp.model.arrays import Array, Vector
from contactqp.model.coulomb_cone import lengths
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem
from contactqp.model.verdicts import Answer
from contactqp.solving.friction.contact_operator import contact_operator
from contactqp.solving.friction.iterate import Iterate
from contactqp.solving.friction.local_form import LocalForm


class ContactForm:
    """The local form of one contact problem, and the way back.

    Attributes
    ----------
    local : LocalProblem
        In scaled forces and lengths.
    """

    def __init__(self, problem: ContactProblem, condensation: Condensation, rows: FrictionalRows) -> None:
        self._problem, self._way, self._rows = problem, condensation, rows
        self._operator = operator = contact_operator(problem, condensation, rows)
        load, self._inner = condensation.reduce_load(problem.load)
        self._scaled_load = load * rows.scale
        gap, origin, value = rows.lengths(problem)
        self._start = operator.start(value)
        self._load = operator.basis.T @ (self._scaled_load - rows.S @ self._start)
        w = np.column_stack([gap, -origin.reshape(-1, rows.width)]).ravel()
        joints = operator.motions.shape[1] > 0
        self.local = LocalProblem(
            delassus=operator.delassus,
            offset=operator.free(self._load, self._start) + w,
            friction=rows.coefficient,
            dimension=rows.width + 1,
            bilateral=operator.rigid if joints else None,
            bilateral_offset=operator.drive(problem) if joints else None,
            contact_names=problem.contact_names,
        )

    def answer(self, form: LocalForm, iterate: Iterate) -> Answer:
        """The answer of an iterate's combination of open, stick and slip, refined on the problem."""
        return self.answer_in(self.status(form, iterate), self.plain(form, iterate))

    def answer_in(self, status: Status, start: Answer) -> Answer:
        """The answer of a combination (m,), refined on the problem from `start`; its signs may fail."""
        return answer_in(self._problem, self._way, self._rows, status, start)

    def status(self, form: LocalForm, iterate: Iterate) -> Status:
        """Closed where r_N > u_N, sliding where |r_T - u_T| exceeds the bound, contacts having a compliance of one."""
        r, u = iterate.force, form.velocity(iterate.force, iterate.joint_force)
        pushed, trial = r[:, 0] - u[:, 0], r[:, 1:] - u[:, 1:]
        slides = lengths(trial) > form.mu * np.maximum(pushed, 0.0)
        # The force on the body opposes the slip.
        direction = np.where(trial[:, 0] < 0, SLIP_ON, SLIP_BACK) if form.d == 2 else np.full(form.m, SLIP_ON)
        closed = np.where(slides | (form.mu == 0), direction, STICK)
        return np.where(pushed > 0, closed, OPEN).astype(np.int8)

    def scaled_force(self, normal_force: Vector, friction_force: Array | None) -> Array:
        """Forces (m, d) of the local form with normal forces (m,) and friction (m, d-1) of the problem."""
        force = np.zeros((len(normal_force), self.local.dimension))
        force[:, 0] = np.maximum(normal_force, 0.0) * self._rows.normal_length
        if friction_force is not None:
            force[:, 1:] = -friction_force * self._rows.tangent_length[:, None]
        return force

    def plain(self, form: LocalForm, iterate: Iterate) -> Answer:
        """The answer as the iterate has it."""
        rows, operator = self._rows, self._operator
        force, joint = form.unscaled(iterate.force, iterate.joint_force)
        pushed = operator.H.T @ force.ravel()
        y = operator.compliance @ (self._load + operator.basis.T @ pushed) + operator.motions @ joint
        x = self._start + operator.basis @ y
        tie: Vector = np.zeros(0)
        if len(rows.tie):
            left = self._scaled_load - rows.S @ x + pushed
            tie = np.asarray(np.linalg.lstsq(rows.tie.T, left, rcond=None)[0], dtype=float)
        return Answer(
            self._way.expand(x * rows.scale, self._inner),
            force[:, 0] / rows.normal_length,
            -force[:, 1:] / rows.tangent_length[:, None],
            tie / rows.tie_length,
        )
