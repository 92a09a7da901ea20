"""Compute gradients of a function of an answer by all entries of a parameter at once, with error bounds.

The gradient of weights z . quantity follows from the transposed (adjoint) system of the rates, with z on the quantity
as the right-hand side. Its displacement and forces y are the gradients by load, gaps, slip origins and tie values; that
by K is -(y u' + u y')/2 on the pattern of K, and those by rows and coefficients are similar products.

Bounds are those of rates. Weights on a gap, a slip, a reaction or the energy enter by products with rows or the
stiffness, whose rounding error is included as a correction of the solution. Products of y with the answer use the same
refinement for both, and every number has an error bound (`Estimate`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.rate_data import EXTENDED_EPS, SAME_RATE, SINGULAR, Direction, NoRates, Parts, Rates, errors_of
from contactqp.analysis.rates import Linearised
from contactqp.analysis.slip_law import times
from contactqp.certificate.certificate import certificate_of
from contactqp.errors import InvalidProblem
from contactqp.linalg.condensation import condense
from contactqp.linalg.dense import unknown_scale
from contactqp.linalg.extended import Extended, extend, extended_rows
from contactqp.model.arrays import EPS, Array, Mask, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import read_only
from contactqp.model.solution import Answer, Solution

# Entries of a pattern computed at a time, so that the data fit into the cache.
AT_ONCE = 2**14
# Reasons for a missing bound.
IN_SPACE = "contacts are at the border of two states in space, where errors of directions of slip are not known"
UNTOLD = "a slip in space is so small, or its force, that rounding of the answer turns its direction"
SHARED = "contacts, or ties, share forces, and which of them carry the changes is not told from rounding"
GRAZES = "bodies are free to move, and where they go decides on what grazes them"
UNREFINED = "refinement does not take the rates beyond double precision"
_PROVEN: WeakKeyDictionary[Solution, bool] = WeakKeyDictionary()  # whether an answer with friction has bounds


class Bounded(tuple[Any, Any]):
    """A gradient or a Jacobian with error bounds of its entries; `bound_reason` is the reason if they are None."""

    bound_reason: str

    @classmethod
    def of(cls, value: Any, bound: Any, reason: str) -> Bounded:
        """Return the pair, with the reason if there is no bound."""
        pair = cls((value, bound))
        pair.bound_reason = reason if bound is None else ""
        return pair

    @classmethod
    def of_rows(cls, rows: list[tuple[Any, Any]], reasons: list[str], shape: tuple[int, int]) -> Bounded:
        """Return a matrix with its bounds, None if a row has none.

        Parameters
        ----------
        rows : each with its bound
        reasons : the reasons of missing bounds, empty if there are bounds
        shape : the shape of the matrix, which may have no rows
        """
        values, bounds = ([one[k] for one in rows] for k in (0, 1))
        matrix = np.array([np.ravel(one) for one in values]).reshape(shape)
        if any(one is None for one in bounds):
            return cls.of(matrix, None, next(filter(None, reasons), ""))
        return cls.of(matrix, np.array([np.ravel(one) for one in bounds]).reshape(shape), "")


@dataclass(frozen=True, eq=False)
class Estimate:
    """An array with error bounds of its entries, None if not requested or unknown."""

    value: Array
    error: Array | None

    @classmethod
    def exactly(cls, value: Any) -> Estimate:
        """Return exact numbers."""
        return cls(np.asarray(value, dtype=float), np.zeros(np.shape(value)))

    def __add__(self, other: Estimate) -> Estimate:
        value = self.value + other.value
        if self.error is None or other.error is None:
            return Estimate(value, None)
        return Estimate(value, _rounded(self.error + other.error, value))

    def __neg__(self) -> Estimate:
        return Estimate(-self.value, self.error)

    def __mul__(self, other: Estimate) -> Estimate:
        value = self.value * other.value
        if self.error is None or other.error is None:
            return Estimate(value, None)
        error = abs(self.value) * other.error + self.error * abs(other.value) + self.error * other.error
        return Estimate(value, _rounded(error, value))

    def summed(self) -> Estimate:
        """Return the sums of rows."""
        value, width = self.value.sum(axis=1), self.value.shape[1]
        if self.error is None:
            return Estimate(value, None)
        return Estimate(value, _rounded(self.error.sum(axis=1), width * abs(self.value).sum(axis=1)))

    def on(self, rows: Any) -> Estimate:
        """Return the product of a matrix with a vector."""
        value = np.asarray(rows @ self.value)
        if self.error is None:
            return Estimate(value, None)
        sizes, terms = abs(sp.csr_array(rows)), int(np.max(np.diff(sp.csr_array(rows).indptr), initial=0)) + 3
        return Estimate(value, _rounded(sizes @ self.error, terms * (sizes @ abs(self.value))))


def _rounded(error: Array, size: Array) -> Array:
    """Return an error increased by the rounding of numbers of a size, and its own rounding."""
    return np.asarray(error * (1 + 8 * EPS) + EPS * abs(size))


@dataclass(frozen=True, eq=False)
class _Estimates:
    """The parts of an answer, or of a solution of the transposed system."""

    displacement: Estimate
    normal: Estimate
    tangent: Estimate
    tie: Estimate

    @classmethod
    def of(cls, found: Parts, bound: Parts | None) -> _Estimates:
        errors = [None] * 4 if bound is None else vars(bound).values()
        return cls(*(Estimate(value, error) for value, error in zip(vars(found).values(), errors, strict=True)))


def gradient(linearised: Linearised, of: str, weights: Array, parameter: str, bounded: bool = False) -> Estimate:
    """Return the gradient of weights . quantity by a parameter, with its bound if requested and known.

    Gradients by stiffness or rows are sparse matrices of their pattern instead of arrays.

    Parameters
    ----------
    linearised : the answer and the systems of its rates
    of, weights, parameter : as in `contactqp.analysis.derivatives.pullback`
    bounded : whether to compute error bounds

    Raises
    ------
    InvalidProblem
        The derivative is one-sided, or does not exist.
    """
    problem = linearised.problem
    answer, given = _answer(linearised, bounded), Estimate.exactly(weights)
    u, push = answer.displacement, answer.normal
    if of == "energy" and not problem.frictional:
        if parameter == "stiffness":
            return on_pattern(problem, Estimate.exactly(0.5 * weights) * u, u)
        if parameter == "rows":
            return on_entries(problem.normal, ((given * push, u),))
        zero = Estimate.exactly(np.zeros_like(push.value)), Estimate.exactly(Direction.zero(problem).slip_origin)
        by = dict(load=-u, gap=-push, tie_value=-answer.tie, friction=zero[0], slip_origin=zero[1])
        return given * by[parameter]
    if len(linearised.undecided):
        raise InvalidProblem(f"pullback: {linearised.at_border()}, and the derivative may have two sides")
    try:
        y = _adjoint(linearised, of, weights, bounded)
    except NoRates as none:
        raise InvalidProblem(f"the gradient of {of} by {parameter} does not exist: {none}") from None
    if parameter == "stiffness":
        own = Estimate.exactly(0.5 * weights) * u if of == "energy" else Estimate.exactly(-weights)
        return on_pattern(problem, own + -y.displacement if of in ("energy", "reaction") else -y.displacement, u)
    if parameter == "rows":
        forced = y.normal + given if of == "gap" else y.normal
        return on_entries(problem.normal, ((-push, y.displacement), (-forced, u)))
    if parameter in ("friction", "slip_origin"):
        return _by_law(linearised, of, given, parameter, push, y)
    found = dict(load=y.displacement, gap=y.normal, tie_value=y.tie)[parameter]
    if parameter == "load" and of in ("reaction", "energy"):
        return found + (given if of == "reaction" else -(given * u))
    return found + given if parameter == of == "gap" else found


def value_of(solution: Solution, of: str) -> Any:
    """Return the quantity itself."""
    problem = solution.problem
    return problem.load - problem.stiffness_rows @ solution.displacement if of == "reaction" else getattr(solution, of)


def idle_ties(problem: ContactProblem) -> Mask:
    """Return the ties (k,) with rows of zeros, whose force is always zero."""
    return np.asarray(abs(problem.tie).sum(axis=1) == 0).ravel()


def _answer(linearised: Linearised, bounded: bool) -> _Estimates:
    """Return the answer in doubles, or with bounds, the refined one."""
    solution, known = linearised.solution, linearised.extended_answer if bounded else None
    if known is not None and known.bound is not None:
        return _Estimates.of(known.found, known.bound)
    tangent = Parts.zero(linearised.problem).tangent
    return _Estimates.of(Parts(solution.displacement, linearised.push, tangent, solution.tie_force), None)


def _adjoint(linearised: Linearised, of: str, weights: Array, bounded: bool) -> _Estimates:
    """Return the solution of the transposed system.

    Raises NoRates: refinement failed.
    """
    given, system = _weights(linearised, of, weights), linearised.system
    if system is None:
        return _Estimates.of(linearised.adjoint(given), None)
    solved = system.solve(given, True, bounded)
    if not solved.settled:
        raise NoRates(SINGULAR)
    if not bounded:
        return _Estimates.of(solved.found, None)
    if of in ("displacement", "normal_force", "tie_force"):
        return _Estimates.of(solved.found, solved.bound)
    whole = _whole_weights(linearised, of, weights)
    if whole is None:
        return _Estimates.of(solved.found, None)
    exact, rest = whole
    u, normal = (whole - part for whole, part in zip(exact, (given.displacement, given.normal), strict=True))
    low = replace(Parts.zero(linearised.problem), displacement=u.double(), normal=normal.double())
    more = system.with_more(solved, low, rest)
    return _Estimates.of(more.found, more.bound)


def _weights(linearised: Linearised, of: str, weights: Array) -> Parts:
    """Return the right-hand side of the transposed system: weights of the unknowns of the system."""
    problem, zero = linearised.problem, Parts.zero(linearised.problem)
    u, normal, tangent, tie = zero.displacement, zero.normal, zero.tangent, zero.tie
    if of == "displacement":
        u = weights
    elif of == "gap":
        u = -(problem.normal.T @ weights)
    elif of == "slip" and problem.tangent is not None:
        u = problem.tangent.T @ weights.ravel()
    elif of == "reaction":
        u = -(problem.stiffness_rows @ weights)
    elif of == "energy":
        u = -float(weights) * value_of(linearised.solution, "reaction")
    elif of == "normal_force":
        normal = weights
    elif of == "tie_force":
        tie = np.where(idle_ties(problem), 0.0, weights)
    elif linearised.system is not None and problem.tangent is not None and problem.friction is not None:
        system = linearised.system
        tangent = weights
        normal = problem.friction * np.sum(system.directions * weights, axis=1)
        u = problem.tangent.T @ np.einsum("mij,mj->mi", system.turning, weights).ravel()
    return Parts(u, normal, tangent, tie)


def _whole_weights(linearised: Linearised, of: str, weights: Array) -> tuple[tuple[Extended, Extended], Parts] | None:
    """Return weights of displacements and normal forces in twice double precision, and their errors.

    None if the answer is not available in this precision.
    """
    problem, zero = linearised.problem, Parts.zero(linearised.problem)
    exact, u, normal = extended_rows(problem), extend(zero.displacement), extend(zero.normal)
    rest, size = zero.displacement, abs(weights)
    if of == "gap":
        u, rest = exact.contact_force(extend(-weights), extend(zero.tie)), abs(problem.normal).T @ size
    elif of == "slip" and problem.tangent is not None:
        u, rest = exact.friction_force(extend(weights.ravel())), abs(problem.tangent).T @ size.ravel()
    elif of == "reaction":
        u, rest = -(exact.stiffness @ extend(weights)), problem.stiffness_sizes @ size
    elif of == "energy":
        known = linearised.extended_answer
        if known is None or not np.isfinite(known.remainder):
            return None
        reaction = extend(problem.load) - exact.stiffness @ known.extended[0]
        u = reaction.spread(np.full((len(reaction), 1), -float(weights)))
        whole = abs(known.extended[0].hi)
        unknown = known.remainder * unknown_scale(problem) / EXTENDED_EPS + whole
        rest = float(size) * (abs(problem.load) + problem.stiffness_sizes @ unknown)
    elif linearised.system is not None and problem.tangent is not None:
        law, given = linearised.system.law, extend(weights.ravel())
        normal, u = times(Extended(law.coefficient), law.along(given)), exact.friction_force(law.turned(given))
        turned = np.repeat(law.error_of_turned(weights), weights.shape[1])
        lacks = law.error_of_dragged(np.linalg.norm(weights, axis=1)) + EXTENDED_EPS * law.coefficient * size.sum(
            axis=1
        )
        return (u, normal), replace(zero, displacement=abs(problem.tangent).T @ turned, normal=lacks)
    return (u, normal), replace(zero, displacement=EXTENDED_EPS * rest)


def _by_law(
    linearised: Linearised, of: str, given: Estimate, parameter: str, push: Estimate, y: _Estimates
) -> Estimate:
    """Return the gradient by coefficients (m,) or slip origins (m, d-1), which enter by Coulomb's law.

    Parameters
    ----------
    linearised, of, parameter : as in `gradient`
    given : the weights
    push, y : the contact forces (m,), and the solution of the transposed system
    """
    problem, system = linearised.problem, linearised.system
    none = Estimate.exactly(np.zeros_like(y.tangent.value))
    slip_weights = -given if of == "slip" and parameter == "slip_origin" else none
    if system is None or problem.tangent is None or not problem.frictional:
        return slip_weights if parameter == "slip_origin" else Estimate.exactly(np.zeros(problem.contacts))
    moved, shape = -y.displacement.on(problem.tangent), y.tangent.value.shape
    dragged = Estimate(moved.value.reshape(shape), None if moved.error is None else moved.error.reshape(shape))
    dragged = dragged + given if of == "friction_force" else dragged
    law = system.law
    if parameter == "friction":
        rounded = system.turns * EPS * np.ones(shape) + law.off[:, None]
        return push * (Estimate(system.directions, rounded) * dragged).summed()
    turned = law.turned(extend(dragged.value.ravel())).double().reshape(shape)
    if dragged.error is None:
        return y.tangent + slip_weights + Estimate(-turned, None)
    lacks = law.turns.hi * np.linalg.norm(dragged.error, axis=1) + law.error_of_turned(dragged.value)
    return y.tangent + slip_weights + Estimate(-turned, lacks[:, None] + EPS * abs(turned))


def energy_of_rates(linearised: Linearised, rates: Rates, direction: Direction) -> tuple[float, float | None]:
    """Return the rate of the energy, (Ku - f)'du - u'df + u'dK u / 2, and its error."""
    problem, solution, known = linearised.problem, linearised.solution, linearised.extended_answer
    du = rates.displacement
    if known is None or known.bound is None or rates.bound is None:
        half = float(-0.5 * solution.displacement @ direction.strained)
        return float(-value_of(solution, "reaction") @ du - solution.displacement @ direction.load) + half, None
    answer, off = known.found, known.bound
    taken, error = np.zeros_like(du), np.zeros_like(du)  # the part of each unknown's load carried by contacts and ties
    for rows, force, apart in (
        (problem.normal, answer.normal, off.normal), (problem.tie, answer.tie, off.tie),
        (problem.tangent, answer.tangent, off.tangent),
    ):  # fmt: skip
        if rows is not None:
            taken, size = taken + rows.T @ force.ravel(), abs(rows).T @ abs(force).ravel()
            error += abs(rows).T @ apart.ravel() + EPS * (rows.shape[0] + 3) * size
    u, off_u = answer.displacement, off.displacement
    lacks = np.zeros_like(u) if rates.off is None else rates.off.displacement
    return _summed(
        (-taken, error, du, rates.bound.displacement), (-u, off_u, direction.load, np.zeros_like(u)),
        (-0.5 * u, 0.5 * off_u, direction.strained, lacks),
    )  # fmt: skip


def of_rates(linearised: Linearised, of: str, rates: Rates, direction: Direction) -> tuple[Any, Any]:
    """Return the rate of a quantity and its error, None if unknown.

    Parameters
    ----------
    linearised, of : the answer, and the name of the quantity
    rates, direction : the rates of the answer, and their direction
    """
    if of != "energy":
        return read_only(getattr(rates, of)), errors_of(linearised.problem, of, rates, direction)
    return energy_of_rates(linearised, rates, direction)


def are_same(linearised: Linearised, of: str, sides: tuple[Rates, Rates], direction: Direction) -> bool:
    """Return whether a quantity has the same rates on both sides of a direction, but for rounding.

    Parameters
    ----------
    linearised, of : the answer, and the name of the quantity
    sides, direction : the rates of the answer towards minus and plus the direction, and the direction
    """
    back, ahead = sides
    if linearised.scales.same("displacement" if of == "energy" else of, back, ahead):
        return of != "friction_force" or _same_on_supports(linearised, back, ahead)
    if of != "energy":
        return False
    solution = linearised.solution
    size = abs(value_of(solution, "reaction")) @ (abs(back.displacement) + abs(ahead.displacement))
    left, right = (energy_of_rates(linearised, side, direction)[0] for side in sides)
    return bool(abs(left - right) <= SAME_RATE * (size + abs(solution.displacement) @ abs(direction.load)))


def _same_on_supports(linearised: Linearised, back: Rates, ahead: Rates) -> bool:
    """Return whether friction along tangents whose unknowns are all supported has the same rates, beside other rates.

    It is measured as the contact's normal force is.
    """
    scales = linearised.scales
    _, normal, tangent, _ = scales.units
    apart = abs(back.friction_force - ahead.friction_force) * normal[:, None]
    largest = max(scales.largest(back), scales.largest(ahead))
    return bool(np.all(apart[(tangent == 0).reshape(apart.shape)] <= SAME_RATE * largest))


def _summed(*products: tuple[Vector, Vector, Vector, Vector]) -> tuple[float, float]:
    """Return a sum of products of vectors with errors, (a, error, b, error), and its error."""
    total, size, error = 0.0, 0.0, 0.0
    for a, off_a, b, off_b in products:
        total += float(a @ b)
        size += (len(a) + 3) * float(abs(a) @ abs(b))
        error += float(abs(a) @ off_b + off_a @ abs(b) + off_a @ off_b)
    return total, error + EPS * (size + 2 * len(products) * error)


def rate_of_energy(linearised: Linearised, direction: Direction) -> tuple[float, float | None]:
    """Return the rate without friction, -u'df - l_N'dg - nu'db + u'dK u / 2 + l_N'dE_N u, and its error.

    This is the envelope theorem.
    """
    solution, known = linearised.solution, linearised.extended_answer
    if known is None or known.bound is None:
        rate = -(solution.displacement @ direction.load) - solution.normal_force @ direction.gap
        return float(rate - solution.tie_force @ direction.tie_value + direction.work), None
    answer, off = known.found, known.bound
    u, push = answer.displacement, answer.normal
    found = [
        (-u, off.displacement, direction.load, np.zeros_like(u)),
        (-push, off.normal, direction.gap, np.zeros_like(push)),
        (-answer.tie, off.tie, direction.tie_value, np.zeros_like(answer.tie)),
    ]
    for rows, left, error in (
        (direction.stiffness, 0.5 * u, 0.5 * off.displacement), (direction.rows, push, off.normal),
    ):  # fmt: skip
        if rows is not None:
            terms = int(np.max(np.diff(rows.indptr), initial=0)) + 3
            moved = abs(rows) @ off.displacement + EPS * terms * (abs(rows) @ abs(u))
            found.append((left, error, np.asarray(rows @ u), moved))
    return _summed(*found)


def on_pattern(problem: ContactProblem, y: Estimate, u: Estimate) -> Estimate:
    """Return (y u' + u y')/2 on the pattern of K, sparse if K is."""
    half = Estimate.exactly(0.5)
    pairs = (half * y, u), (half * u, y)
    return on_entries(problem.stiffness_rows if sp.issparse(problem.stiffness) else None, pairs)


def on_entries(rows: Any, pairs: tuple[tuple[Estimate, Estimate], ...]) -> Estimate:
    """Return the sum of left right' over pairs on the pattern of CSR rows, dense if these are None."""
    value, errors = _products(rows, [(left.value, right.value) for left, right in pairs]), []
    for left, right in pairs:
        if left.error is None or right.error is None:
            return Estimate(value, None)
        apart = _rounded(left.error, len(pairs) * left.value), _rounded(right.error, right.value)
        errors += [(apart[0], abs(right.value) + apart[1]), (abs(left.value), apart[1])]
    return Estimate(value, _products(rows, errors))


def _products(rows: Any, pairs: list[tuple[Vector, Vector]]) -> Any:
    if rows is None:
        return np.sum([np.outer(left, right) for left, right in pairs], axis=0)
    ends, counts, entries = rows.indptr, np.diff(rows.indptr), np.zeros(len(rows.indices))
    cuts = np.unique(np.searchsorted(ends, np.arange(0, ends[-1] + AT_ONCE, AT_ONCE)).clip(0, len(counts)))
    for first, last in pairwise(cuts):
        part = slice(ends[first], ends[last])
        for left, right in pairs:
            own = right.take(rows.indices[part])
            own *= np.repeat(left[first:last], counts[first:last])
            entries[part] += own
    return sp.csr_array((entries, rows.indices, rows.indptr), shape=rows.shape)


def may_be_bounded(linearised: Linearised, shared: bool = False) -> bool:
    """Return whether errors have bounds: the answer is proven, and with shared forces of friction separately."""
    if linearised.shares is not None and (shared or linearised.system is not None):
        return linearised.system is not None and linearised.extended_answer is not None
    return linearised.has_bounds and (_is_proven(linearised.solution) or linearised.stands)


def why_unbounded(linearised: Linearised, bound: Any, shared: bool = False) -> str:
    """Return why rates, possibly of shared forces, have no bound; empty if they have one."""
    if bound is not None:
        return ""
    if linearised.shares is not None and (shared or linearised.system is not None):
        return SHARED
    if not (_is_proven(linearised.solution) or linearised.stands):
        return ": ".join(["the answer is not proven", *linearised.solution.certificate.reasons[:1]])
    if linearised.is_sparse:
        return "bounds follow from condensed contacts, and these are too many"
    if linearised.turns and linearised.sure:
        return IN_SPACE if linearised.system is None else UNTOLD
    if linearised.redundant or shared:
        return SHARED
    if linearised.has_bounds:
        return GRAZES if linearised.solution.free_motions else UNREFINED
    return f"{linearised.at_border()}, within what refinement leaves of zero, and may be beside the border"


def _is_proven(solution: Solution) -> bool:
    """Return whether errors of an answer are bounded; an answer with friction is proven at the first call."""
    problem, certificate = solution.problem, solution.certificate
    if certificate.proven or not problem.frictional:
        return certificate.proven
    if solution not in _PROVEN:
        forces = solution.normal_force, solution.friction_force, solution.tie_force
        limits = certificate.tolerance, certificate.error_tolerance, condense(problem)
        found = certificate_of(problem, Answer(solution.displacement, *forces), *limits, prove_friction=True)
        _PROVEN[solution] = found.proven
    return _PROVEN[solution]
