"""Form the equations of stick and slip in the plane by the course chapter's section 2.4, with its signs corrected.

A closed contact satisfies E_N u = g, and where it sticks also E_T u = o with its slip origin o. Where it slips in the
direction s = +1 or -1, friction s mu l_N acts on the obstacle along E_T, so that the contact force acts along

    E_s = E_N + s mu E_T        (l_N >= 0; the chapter's E_N - s mu E_T, eq. 2.41, belongs to R_N = -l_N <= 0)

and not along the constrained row E_N, and the systems of slip are unsymmetric.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Indices, Vector
from contactqp.model.coulomb import OPEN, STICK, Status
from contactqp.model.problem import ContactProblem, Matrix
from contactqp.model.solution import Answer
from contactqp.solving.methods.method import Settings
from contactqp.solving.methods.textbook_algebra import (
    contact_stiffness,
    refuse_contradiction,
    rows_independent_of_earlier,
    spread,
)


@dataclass(frozen=True, eq=False)
class FrictionalStep:
    """The answer of one system, for one status of every contact, without forces on open ones."""

    answer: Answer
    status: Status  # (m,) contacts in the system; those with dependent rows are left out and open

    @property
    def friction(self) -> Vector:
        """Return the friction forces (m,), one a contact in the plane."""
        assert self.answer.friction_force is not None
        forces: Vector = self.answer.friction_force[:, 0]
        return forces


# A function of the statuses, and of an order of preference of closed contacts with dependent rows.
FrictionalEnforcement = Callable[[Status, Indices], FrictionalStep]


def coefficients(problem: ContactProblem) -> Vector:
    """Return mu (m,), zero where all unknowns of the tangential row are supported and the contact cannot slide."""
    if problem.tangent is None or problem.friction is None:
        return np.zeros(problem.contacts)
    return np.where(np.diff(problem.tangent.indptr) > 0, problem.friction, 0.0)


def origins(problem: ContactProblem) -> Vector:
    """Return E_T u (m,) where the slip starts [length]."""
    return np.zeros(problem.contacts) if problem.slip_origin is None else problem.slip_origin[:, 0]


@dataclass(frozen=True, eq=False)
class StatusRows:
    """The equations of one status: ties, then closed contacts, then those of them that stick.

    Attributes
    ----------
    held, pushed : (r, n) csr_arrays, [A; E_N; E_T] and [A; E_s; E_T], E_s = E_N where a contact sticks
    values : (r,), [b; g; o]
    ties, closed, stuck : index arrays, which ties and contacts the rows are
    """

    problem: ContactProblem
    status: Status
    held: Matrix
    pushed: Matrix
    values: Vector
    ties: Indices
    closed: Indices
    stuck: Indices

    @property
    def of_contacts(self) -> slice:
        """Return the rows of contacts, without ties."""
        return slice(self.ties.size, None)

    def per_row(self, normal: Vector, tangential: Vector) -> Vector:
        """Return values of contacts, (m,) for normal and (m,) for tangential rows, in the order of these rows."""
        return np.concatenate([normal[self.closed], tangential[self.stuck]])

    def step(self, displacement: Vector, contact_force: Vector, tie_force: Vector) -> FrictionalStep:
        """Return the step in which the rows of contacts and of ties carry these forces."""
        count, m = self.closed.size, self.problem.contacts
        normal = spread(contact_force[:count], self.closed, m)
        friction = spread(contact_force[count:], self.stuck, m)
        friction = friction + np.where(self.status == STICK, 0, self.status) * coefficients(self.problem) * normal
        tie = spread(tie_force, self.ties, self.problem.ties)
        return FrictionalStep(Answer(displacement, normal, friction[:, None], tie), self.status)


def status_rows(
    name: str, problem: ContactProblem, status: Status, preference: Indices, *, independent: bool
) -> StatusRows:
    """Return the equations of a status, with `independent` without contact rows that depend on earlier ones.

    Of dependent ties the first are always kept. A closed contact without normal row is open; a sticking one without
    tangential row has no friction.

    Raises NotConverged: ties contradict each other.

    Parameters
    ----------
    name : the method's name, for messages
    problem : ContactProblem
    status : (m,) array of int, OPEN, STICK, SLIP_BACK or SLIP_ON
    preference : (m,) array of int, all contacts, in the order in which their rows are kept
    independent : whether rows that follow from those before them are left out
    """
    E_N, E_T = problem.normal, sp.csr_array(problem.tangent)
    ties = rows_independent_of_earlier(problem.tie)
    refuse_contradiction(name, problem, ties)
    closed = preference[(status != OPEN)[preference]]
    stuck = closed[status[closed] == STICK]
    held = _stacked(problem.tie[ties], E_N[closed], E_T[stuck])
    if independent and len(kept := rows_independent_of_earlier(held)) < held.shape[0]:
        normal = kept[(kept >= ties.size) & (kept < ties.size + closed.size)] - ties.size
        tangential = stuck[kept[kept >= ties.size + closed.size] - ties.size - closed.size]
        closed = closed[normal]
        stuck = tangential[np.isin(tangential, closed)]
        held = _stacked(problem.tie[ties], E_N[closed], E_T[stuck])
        status = np.where(np.isin(np.arange(problem.contacts), closed), status, OPEN).astype(np.int8)
    drag, pushed = np.where(status == STICK, 0, status)[closed] * coefficients(problem)[closed], held
    if np.any(drag):
        pushed = _stacked(problem.tie[ties], E_N[closed] + sp.diags(drag) @ E_T[closed], E_T[stuck])
    values = np.concatenate([problem.tie_value[ties], problem.gap[closed], origins(problem)[stuck]])
    return StatusRows(problem, status, held, pushed, values, ties, closed, stuck)


def _stacked(*parts: Matrix) -> Matrix:
    return sp.csr_array(sp.vstack(parts, format="csr"))


def frictional_springs(rows: StatusRows, beta: Vector) -> tuple[Matrix, Vector]:
    """Return K + P' beta H and f + P' beta q: rows H u = q are constrained, forces act along P, beta (r,)."""
    problem, contacts = rows.problem, rows.of_contacts
    weighted = rows.pushed[contacts].T @ sp.diags(beta)
    spring = sp.csr_array(weighted @ rows.held[contacts])
    K = problem.stiffness + (spring if sp.issparse(problem.stiffness) else spring.toarray())
    return K, problem.load + weighted @ rows.values[contacts]


def spring_stiffnesses(
    name: str, problem: ContactProblem, settings: Settings, normal: Vector, *, zero: bool = False
) -> tuple[Vector, Vector]:
    """Return normal and tangential spring stiffnesses, (m,) each [force / length]; equal without `tangential_penalty`.

    Raises InvalidProblem: the option is not positive (or negative, where `zero` allows none) and finite.

    Parameters
    ----------
    name : the method's name, for messages
    problem : ContactProblem
    settings : their options may have `tangential_penalty`
    normal : (m,) array [force / length]
    zero : whether a stiffness of zero is allowed
    """
    given = settings.options.get("tangential_penalty")
    if given is None:
        return normal, normal
    return normal, contact_stiffness(name, "tangential_penalty", given, problem.contacts, zero=zero)


def refuse_tangential_penalty(name: str, settings: Settings) -> None:
    """Raise InvalidProblem if the option is given for a problem without friction."""
    if settings.options.get("tangential_penalty") is not None:
        raise InvalidProblem(f"{name}: tangential_penalty was given, and the problem has no friction")
