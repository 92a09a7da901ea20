"""Derivatives of an answer without friction by what its problem is made of, each the certified answer of a problem.

Along a direction (df, dg, db, dK) of load, gaps, tie values and stiffness the displacement of min 1/2 u'Ku - f'u over
E u <= g, A u = b changes at the rate du that minimises

    1/2 du'K du - (df - dK u)'du    over    E_c du = dg_c,    E_w du <= dg_w,    A du = db,

c the contacts that push and w those that graze, whose gap and force both vanish (Fiacco 1976; Robinson 1980; for
membranes over obstacles Mignot 1976). It is a contact problem of the same stiffness, with the grazing contacts as its
contacts and those that push among its ties; its forces are the rates of the forces. Where nothing grazes it is linear,
and its answer the derivative; where something does, there is one towards either side.

A gradient takes one such problem, too: with weights z on what is asked for in place of the direction, its displacement,
contact and tie forces (y, m, n) are those of the answer by load, gap and tie value, and -(y u' + u y')/2 that by K.

A contact's state lasts along the direction as far as its force and its gap, which change linearly, keep their signs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.certificate import bounds
from contactqp.errors import InvalidProblem, NoEquilibrium, Unsupported, shown
from contactqp.linalg.condensation import condense
from contactqp.linalg.dense import saddle_point
from contactqp.linalg.iteration import constraints_are_many, iterated
from contactqp.model.arguments import checked
from contactqp.model.arrays import Array, Vector, own_floating_point
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import ReadOnly, read_array, read_matrix, read_only, read_vector
from contactqp.model.solution import Solution
from contactqp.solving.solve import solve

# What may be differentiated, and by what.
QUANTITIES = ("displacement", "normal_force", "tie_force", "gap", "energy")
PARAMETERS = ("load", "gap", "tie_value", "stiffness")
# Contacts that are named in a reason.
SHOWN = 5
FREE = "bodies are free to move, and their displacements are not unique"
REDUNDANT = "contacts that touch are redundant, and share their forces in many ways"
# A direction of the stiffness is symmetric to this part of its largest entry.
SYMMETRIC = 1e-12
# One-sided rates that are this near to each other, relative to the larger, are one.
SAME = 1e-9


@dataclass(frozen=True, eq=False)
class Derivative(ReadOnly):
    """The rate at which a quantity of an answer changes along a direction, in its units over those of the parameter.

    `left` and `right` are towards minus and plus the direction; `value` is both where they are one, else None, and
    `reason` says why. `reach` are the steps (back, ahead) along the direction, not negative, within which no contact
    changes its state; None where the answer is not linear along it, as for the stiffness. No `bound` is formed yet: the
    problems whose answers these are pass their certificates.
    """

    value: Any
    left: Any
    right: Any
    exists: bool
    bound: Vector | None = None
    reach: tuple[float, float] | None = None
    reason: str = ""


@dataclass(frozen=True, eq=False)
class _Direction:
    """A direction of what a problem is made of; `stiffness` is dK u (n,)."""

    load: Vector  # (n,)
    gap: Vector  # (m,)
    tie_value: Vector  # (k,)
    stiffness: Vector  # (n,)
    work: float = 0.0  # u'dK u

    def reversed(self) -> _Direction:
        return _Direction(-self.load, -self.gap, -self.tie_value, -self.stiffness, -self.work)


@dataclass(frozen=True, eq=False)
class _Rates:
    """What changes along a direction: displacement (n,), normal (m,) and tie forces (k,), and gaps (m,)."""

    displacement: Vector
    normal_force: Vector
    tie_force: Vector
    gap: Vector


@checked
@own_floating_point
def derivative(solution: Solution, of: str, with_respect_to: str, direction: ArrayLike) -> Derivative:
    """Return the rate at which a quantity of an answer changes along a direction of a parameter.

    Parameters
    ----------
    solution : Solution
        Without friction.
    of : str
        "displacement" (n,), "normal_force" (m,), "tie_force" (k,), "gap" (m,) or "energy", a number.
    with_respect_to : str
        "load" (n,), "gap" (m,), "tie_value" (k,) or "stiffness" (n, n).
    direction : array of the parameter's shape
        Symmetric where it is one of the stiffness.

    Raises
    ------
    InvalidProblem
        A name that is none of these, a wrong shape, or a direction of the stiffness that is not symmetric.
    Unsupported
        The answer is one with friction, or of bodies too large to factorise.

    Examples
    --------
    >>> import contactqp as cq
    >>> bar = cq.ContactProblem(stiffness=[[2.0]], load=[4.0], normal=[[1.0]], gap=[1.0])
    >>> cq.solve(bar).derivative("normal_force", "gap", [1.0]).value
    array([-2.])
    """
    _refuse_unknown(of, QUANTITIES, "of")
    return _Differentiated(solution).along(of, _read_direction(solution, with_respect_to, direction), with_respect_to)


@checked
@own_floating_point
def jacobian(solution: Solution, of: str, with_respect_to: str) -> Array:
    """Return the derivatives by all entries of "load", "gap" or "tie_value", a column each; see `derivative`.

    Raises
    ------
    InvalidProblem
        A derivative does not exist: the message says why. The stiffness has `pullback` and `derivative` alone.
    """
    _refuse_unknown(of, QUANTITIES, "of")
    _refuse_unknown(with_respect_to, PARAMETERS[:3], "with_respect_to")
    size, differentiated = len(getattr(solution.problem, with_respect_to)), _Differentiated(solution)
    columns = []
    for unit in np.eye(size):
        found = differentiated.along(of, _read_direction(solution, with_respect_to, unit), with_respect_to)
        if found.value is None:
            raise InvalidProblem(f"jacobian of {of} with respect to {with_respect_to}: {found.reason}")
        columns.append(np.atleast_1d(found.value))
    rows = 1 if of == "energy" else len(np.atleast_1d(getattr(solution, of)))
    return np.column_stack(columns) if columns else np.zeros((rows, 0))


@checked
@own_floating_point
def pullback(solution: Solution, of: str, weights: ArrayLike, with_respect_to: str) -> Any:
    """Return the gradient of weights . quantity by a parameter, in the parameter's shape: one problem for all entries.

    By the stiffness it is on the pattern of K, symmetric, so that its sum of products with dK is the rate along dK.
    Quantities and parameters are those of `derivative`.

    Raises
    ------
    InvalidProblem
        A name or shape that is wrong, or a derivative that does not exist.
    """
    _refuse_unknown(of, QUANTITIES, "of")
    _refuse_unknown(with_respect_to, PARAMETERS, "with_respect_to")
    expected = np.shape(getattr(solution, of))
    given = read_array("weights", weights)
    if given.shape != expected or not np.all(np.isfinite(given)):
        raise InvalidProblem(f"weights: expected finite numbers in the shape {expected} of {of}, got {shown(weights)}")
    return _Differentiated(solution).gradient(of, given, with_respect_to)


def _refuse_unknown(name: str, known: tuple[str, ...], argument: str) -> None:
    if name not in known:
        raise InvalidProblem(f"{argument}: expected one of {', '.join(known)}, got {name!r}")


def _read_direction(solution: Solution, parameter: str, direction: Any) -> _Direction:
    _refuse_unknown(parameter, PARAMETERS, "with_respect_to")
    problem = solution.problem
    n, m, k = problem.dimension, problem.contacts, problem.ties
    parts: dict[str, Any] = dict(load=np.zeros(n), gap=np.zeros(m), tie_value=np.zeros(k), stiffness=np.zeros(n))
    if parameter != "stiffness":
        return _Direction(**(parts | {parameter: read_vector("direction", direction, len(parts[parameter]))}))
    dK = read_matrix("direction", direction)
    if dK.shape != (n, n):
        raise InvalidProblem(f"direction: expected shape {(n, n)}, got {dK.shape}")
    if n and float(abs(dK - dK.T).max()) > SYMMETRIC * float(abs(dK).max()):
        raise InvalidProblem("direction: expected a symmetric matrix, as the stiffness is one")
    moved = np.asarray(dK @ solution.displacement)
    return _Direction(**(parts | {"stiffness": moved}), work=float(solution.displacement @ moved))


class _Differentiated:
    """The problems of all directions of one answer, which share a stiffness and its rows."""

    def __init__(self, solution: Solution) -> None:
        problem = solution.problem
        if problem.frictional:
            raise Unsupported("derivatives: of answers without friction alone")
        if iterated(problem):
            raise Unsupported("derivatives: of bodies that are factorised alone")
        if not solution.certificate.passed:
            raise InvalidProblem("derivatives: the answer is not certified")
        self._solution, self._of = solution, problem
        self._closed = np.flatnonzero(solution.contact_status == "closed")
        self._grazing = np.flatnonzero(solution.contact_status == "grazing")
        rows = sp.csr_array(sp.vstack([problem.tie, problem.normal[self._closed]]))
        self._problem = ContactProblem(
            problem.stiffness, np.zeros(problem.dimension), problem.normal[self._grazing], np.zeros(len(self._grazing)),
            tie=rows, tie_value=np.zeros(rows.shape[0]), near_null_space=problem.near_null_space,
        )  # fmt: skip
        self._redundant = self._forces_depend()

    def _forces_depend(self) -> bool:
        """Whether the rows of ties and of contacts that touch depend on one another, so that forces are not unique."""
        if constraints_are_many(self._problem):  # nothing is condensed, and the certificate has looked
            return any(bounds.REDUNDANT in reason for reason in self._solution.certificate.reasons)
        touching = np.arange(len(self._grazing))
        return saddle_point(condense(self._problem), touching).redundant

    def along(self, of: str, direction: _Direction, parameter: str) -> Derivative:
        """Return the derivative of a quantity along a direction of one parameter."""
        if (reason := self._why_not(of, parameter)) is not None:
            return Derivative(None, None, None, False, reason=reason)
        if of == "energy":
            rate = self._rate_of_energy(direction)
            return Derivative(rate, rate, rate, True)
        try:
            ahead = self._rates(direction)
            back = self._rates(direction.reversed()) if len(self._grazing) else None
        except NoEquilibrium as none:
            return Derivative(None, None, None, False, reason=str(none))
        right = getattr(ahead, of)
        left = right if back is None else 0.0 - getattr(back, of)
        size = max(float(np.max(abs(one), initial=0.0)) for one in (left, right))
        same = bool(np.all(abs(left - right) <= SAME * size))
        reason = "" if same else f"the two sides differ: {self._of_grazing()}"
        reach = None
        if parameter != "stiffness":
            reach = self._reach(ahead, -1.0) if back is None else self._reach(back, 1.0), self._reach(ahead, 1.0)
        return Derivative(right if same else None, left, right, same, None, reach, reason)

    def _why_not(self, of: str, parameter: str) -> str | None:
        """Return why a quantity has no derivative by a parameter, whatever the direction, or None."""
        if self._redundant and (of.endswith("force") or parameter in ("gap", "tie_value")):
            return REDUNDANT
        free = bool(self._solution.free_motions)
        return FREE if free and (of == "displacement" or parameter in ("load", "stiffness")) else None

    def gradient(self, of: str, weights: Array, parameter: str) -> Any:
        """Return the gradient of weights . quantity by a parameter."""
        problem, solution = self._of, self._solution
        if (reason := self._why_not(of, parameter)) is not None:
            raise InvalidProblem(f"pullback: {reason}")
        if of == "energy":
            u = solution.displacement
            by = dict(load=-u, gap=-solution.normal_force, tie_value=-solution.tie_force)
            rates = by[parameter] if parameter in by else self._on_pattern(0.5 * u)
            return read_only(float(weights) * rates)
        if len(self._grazing):
            raise InvalidProblem(f"pullback: {self._of_grazing()}, and the derivative may have two sides")
        n, m, k = problem.dimension, problem.contacts, problem.ties
        parts: dict[str, Any] = dict(load=np.zeros(n), gap=np.zeros(m), tie_value=np.zeros(k))
        if of in ("displacement", "gap"):
            parts["load"] = weights if of == "displacement" else -(problem.normal.T @ weights)
        else:
            parts["gap" if of == "normal_force" else "tie_value"] = weights
        found = self._rates(_Direction(**parts, stiffness=np.zeros(n)))
        if parameter == "stiffness":
            return self._on_pattern(-found.displacement)
        if parameter == "gap" and of == "gap":
            return read_only(found.normal_force + weights)
        return dict(load=found.displacement, gap=found.normal_force, tie_value=found.tie_force)[parameter]

    def _rates(self, direction: _Direction) -> _Rates:
        """Solve the problem of a direction."""
        problem, k = self._of, self._of.ties
        value = np.concatenate([direction.tie_value, direction.gap[self._closed]])
        load = direction.load - direction.stiffness
        posed = self._problem.replace(load=load, gap=direction.gap[self._grazing], tie_value=value)
        found = solve(posed)
        force = np.zeros(problem.contacts)
        force[self._closed], force[self._grazing] = found.tie_force[k:], found.normal_force
        u = found.displacement
        gap = direction.gap - problem.normal @ u
        return _Rates(u, read_only(force), read_only(found.tie_force[:k].copy()), read_only(gap))

    def _reach(self, rates: _Rates, sign: float) -> float:
        """Return the step along sign times these rates at which the first contact opens or closes."""
        open_ = self._solution.contact_status == "open"
        steps = [np.inf]
        for size, rate, which in (
            (self._solution.normal_force, sign * rates.normal_force, self._closed),
            (self._solution.gap, sign * rates.gap, np.flatnonzero(open_)),
        ):
            falls = which[rate[which] < 0]
            steps += (size[falls] / -rate[falls]).tolist()
        return float(min(steps))

    def _rate_of_energy(self, direction: _Direction) -> float:
        """By the envelope theorem: -u'df - l_N'dg - nu'db + u'dK u / 2."""
        found = self._solution
        rate = -(found.displacement @ direction.load) - found.normal_force @ direction.gap
        return float(rate - found.tie_force @ direction.tie_value + 0.5 * direction.work)

    def _on_pattern(self, y: Vector) -> Any:
        """Return (y u' + u y')/2 on the pattern of K, sparse where K is."""
        u, K = self._solution.displacement, self._of.stiffness
        if not sp.issparse(K):
            return read_only((np.outer(y, u) + np.outer(u, y)) / 2)
        at = sp.coo_array(K)
        return sp.csr_array(((y[at.row] * u[at.col] + u[at.row] * y[at.col]) / 2, (at.row, at.col)), shape=K.shape)

    def _of_grazing(self) -> str:
        names = [self._of.contact_name(int(i)) for i in self._grazing[:SHOWN]]
        more = f" and {len(self._grazing) - SHOWN} more" if len(self._grazing) > SHOWN else ""
        verb = "grazes" if len(self._grazing) == 1 else "graze"
        return f"{', '.join(names)}{more} {verb}"
