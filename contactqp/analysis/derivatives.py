"""Compute derivatives of an answer by the data of its problem, one-sided if contacts are at a border.

Rates follow from the states of the contacts (`contactqp.analysis.rates`), gradients from the transposed system
(`contactqp.analysis.gradients`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.analysis.gradients import (
    Bounded,
    Estimate,
    are_same,
    gradient,
    may_be_bounded,
    of_rates,
    on_entries,
    rate_of_energy,
    value_of,
    why_unbounded,
)  # fmt: skip
from contactqp.analysis.rate_data import (
    FREE,
    REDUNDANT,
    VECTORS,
    Direction,
    NoAnswer,
    NoRates,
    Rates,
    named,
)
from contactqp.analysis.rates import Linearised
from contactqp.analysis.shared_forces import moved_by, unheld, unique_beside
from contactqp.analysis.slip_law import falls
from contactqp.certificate.idle_rows import ActingRows, acting_once
from contactqp.certificate.number_range import OF_SQUARES, refuse_far_from_one
from contactqp.errors import InvalidProblem, shown
from contactqp.model.arguments import checked
from contactqp.model.arrays import EPS, Array, Indices, Vector, own_floating_point
from contactqp.model.coulomb import STICK
from contactqp.model.problem_data import ReadOnly, read_array, read_matrix, read_only
from contactqp.model.solution import Solution

# The quantities and parameters of derivatives.
FORCES = ("normal_force", "friction_force", "tie_force")
QUANTITIES = ("displacement", *FORCES, "gap", "slip", "reaction", "energy")
PARAMETERS = (*VECTORS, "stiffness", "rows")
# The relative asymmetry up to which a direction of the stiffness counts as symmetric.
SYMMETRIC = 1e-12
# The reason for a missing bound.
NEVER_CLOSES = "gradients of gaps and slips of contacts that never close have none"
# Parameters in which the answer is linear while contacts keep their states.
LINEAR = ("load", "gap", "tie_value", "slip_origin")
# The acting rows of answers, and answers on these only, for answers with idle rows or repeated ties.
_ACTING: WeakKeyDictionary[Solution, ActingRows | None] = WeakKeyDictionary()
_ON_ACTING: WeakKeyDictionary[Solution, Solution] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class Derivative(ReadOnly):
    """The rate of a quantity of an answer along a direction, in its units over those of the parameter.

    `left` and `right` are along minus and plus the direction, None on a side that has no answer or no unique rate; with
    friction neither is given where one is not unique. `value` is both if they are equal, else None with a `reason`.
    `reach` are the steps (back, ahead), not negative, within which no contact changes its state, None if the answer is
    not linear along the direction, as for the stiffness and with slip in space. `bound` is the largest error of each
    entry of the value, or of the sides, for a proven answer, with the rounding allowance of certificates. An answer
    with friction is proven at the first use, as by `contactqp.certify`.
    """

    value: Any
    left: Any
    right: Any
    exists: bool
    bound: Any = None
    reach: tuple[float, float] | None = None
    reason: str = ""
    bound_reason: str = ""


@checked
@own_floating_point
def derivative(solution: Solution, of: str, with_respect_to: str, direction: ArrayLike) -> Derivative:
    """Return the rate of a quantity of an answer along a direction of a parameter.

    Parameters
    ----------
    solution : Solution
        With friction its contacts are condensed.
    of : str
        "displacement" (n,), "normal_force" (m,), "friction_force" (m, d-1), "tie_force" (k,), "gap" (m,), "slip"
        (m, d-1), "reaction" (n,), what contacts and ties take of each unknown's load, f - K u, or "energy", a number.
    with_respect_to : str
        "load" (n,), "gap" (m,), "tie_value" (k,), "friction" (m,), "slip_origin" (m, d-1), "stiffness" (n, n), or
        "rows" (m, n), those of the normals.
    direction : array of the parameter's shape
        Symmetric where it is one of the stiffness; one of friction may be one number for all contacts.

    Raises
    ------
    InvalidProblem
        An unknown name, or one that the problem does not have, a wrong shape, or a direction of the stiffness that is
        not symmetric.
    Unsupported
        The bodies are too large to factorise, or there are too many contacts with friction to condense.

    Examples
    --------
    >>> import contactqp as cq
    >>> bar = cq.ContactProblem(stiffness=[[2.0]], load=[4.0], normal=[[1.0]], gap=[1.0])
    >>> cq.solve(bar).derivative("normal_force", "gap", [1.0]).value
    array([-2.])
    """
    _refuse_unknown(solution, of, with_respect_to)
    if (rows := _acting(solution)) is not None:
        given = read_direction(solution, solution.normal_force, with_respect_to, direction)
        if why := rows.without_answer(with_respect_to, getattr(given, with_respect_to)):
            return Derivative(None, None, None, False, reason=why)
        return _on_acting(rows, solution, of, with_respect_to, given)
    linearised = _linearised(solution)
    along = read_direction(solution, linearised.push, with_respect_to, direction, linearised.closed)
    return _along(linearised, of, along, with_respect_to)


@checked
@own_floating_point
def jacobian(solution: Solution, of: str, with_respect_to: str, return_bound: bool = False) -> Any:
    """Return the derivatives of all entries (rows) of a quantity by all entries (columns) of a vector parameter.

    Parameters
    ----------
    solution : Solution
    of, with_respect_to : str
        Names of `derivative`.
    return_bound : bool
        Whether to return a pair (`Bounded`), the matrix and what its entries may be off by, as `Derivative.bound`,
        None with a `bound_reason` where one of its rows or columns has none.

    Raises
    ------
    InvalidProblem
        A derivative does not exist, with the reason. Stiffness and rows only have `pullback` and `derivative`.
    """
    _refuse_unknown(solution, of, with_respect_to, VECTORS)
    acting = _acting(solution)
    by_columns = of in ("gap", "slip", "tie_force")
    if acting is not None and not (by_columns or acting.without_answer(with_respect_to)):
        return _jacobian_on_acting(acting, solution, (of, with_respect_to), return_bound)
    parameter = getattr(solution.problem, with_respect_to)
    size, rows = np.size(parameter), np.size(value_of(solution, of))
    if acting is None:
        linearised = _linearised(solution)
        adjoint = rows < size and not len(linearised.undecided) and with_respect_to != "friction"
        if adjoint and _why_not(linearised, of, with_respect_to) is None:
            bounded, shape = return_bound and may_be_bounded(linearised), np.shape(value_of(solution, of))
            weights = (one.reshape(shape) for one in np.eye(rows))
            found = [gradient(linearised, of, one, with_respect_to, bounded) for one in weights]
            reasons = [why_unbounded(linearised, one.error) if return_bound else "" for one in found]
            pair = Bounded.of_rows([(one.value, one.error) for one in found], reasons, (rows, size))
            return pair if return_bound else pair[0]
    columns = [derivative(solution, of, with_respect_to, unit.reshape(np.shape(parameter))) for unit in np.eye(size)]
    for along in columns:
        if along.value is None:
            raise InvalidProblem(f"jacobian of {of} with respect to {with_respect_to}: {along.reason}")
    pairs, reasons = [(one.value, one.bound) for one in columns], [one.bound_reason for one in columns]
    matrix, bound = (pair := Bounded.of_rows(pairs, reasons, (size, rows)))
    whole = Bounded.of(matrix.T, None if bound is None else bound.T, pair.bound_reason)
    return whole if return_bound else whole[0]


@checked
@own_floating_point
def pullback(solution: Solution, of: str, weights: ArrayLike, with_respect_to: str, return_bound: bool = False) -> Any:
    """Return the gradient of weights . quantity by a parameter, in the parameter's shape: one system for all entries.

    By the stiffness it is on the pattern of K, symmetric, so that its sum of products with dK is the rate along dK; by
    the rows on the pattern of these. Quantities and parameters are those of `derivative`.

    Parameters
    ----------
    solution : Solution
    of : str
        The quantity, a name of `derivative`'s `of`.
    weights : array in the shape of the quantity, finite
        The weights of its entries in the sum.
    with_respect_to : str
        The parameter, a name of `derivative`'s `with_respect_to`.
    return_bound : bool
        Whether to return a pair (`Bounded`), the gradient and what its entries may be off by, of the same shape: None
        with a `bound_reason` where `Derivative.bound` is, and where contacts are too many to condense. An answer with
        friction is proven for it.

    Raises
    ------
    InvalidProblem
        A wrong name or shape, or a derivative that does not exist.
    """
    _refuse_unknown(solution, of, with_respect_to)
    expected = np.shape(value_of(solution, of))
    given = read_array("weights", weights)
    if given.shape != expected or not np.all(np.isfinite(given)):
        raise InvalidProblem(f"weights: expected finite numbers in the shape {expected} of {of}, got {shown(weights)}")
    if (rows := _acting(solution)) is not None:
        shared = REDUNDANT if rows.repeats and of == "tie_force" else ""
        if why := rows.without_answer(with_respect_to) or shared:
            raise InvalidProblem(f"pullback: {why}")
        found_on = _pullback_on_acting(rows, solution, of, given, with_respect_to)
        return found_on if return_bound else found_on[0]
    linearised = _linearised(solution)
    reason = _why_not(linearised, of, with_respect_to)
    if with_respect_to == "friction":
        reason = reason or linearised.borders.without_direction(np.ones(solution.problem.contacts))
    if reason is not None:
        raise InvalidProblem(f"pullback: {reason}")
    bounded = return_bound and may_be_bounded(linearised)
    found = gradient(linearised, of, given, with_respect_to, bounded)
    if not return_bound:
        return read_only(found.value)
    bound = None if found.error is None else read_only(found.error)
    return Bounded.of(read_only(found.value), bound, why_unbounded(linearised, bound))


def _linearised(solution: Solution) -> Linearised:
    """Return an answer with the cached systems of its rates."""
    kept = solution.problem._computed
    if kept.linearised is None or kept.linearised.solution is not solution:
        kept.linearised = Linearised(solution)
    found: Linearised = kept.linearised
    return found


def _acting(solution: Solution) -> ActingRows | None:
    """Return the acting rows of an answer's problem, None if all act."""
    if solution not in _ACTING:
        _ACTING[solution] = rows = acting_once(solution.problem)
        if rows is not None:
            _ON_ACTING[solution] = rows.acting(solution)
    return _ACTING[solution]


def _on_acting(rows: ActingRows, solution: Solution, of: str, parameter: str, given: Direction) -> Derivative:
    """Return the derivative of an answer with idle rows from that on the acting rows.

    Parameters
    ----------
    rows, solution : the rows that act, and the answer
    of, parameter, given : as in `derivative`, and the direction
    """
    if rows.repeats and of == "tie_force":
        return Derivative(None, None, None, False, reason=REDUNDANT)
    reduced = _ON_ACTING[solution]
    linearised = _linearised(reduced)
    direction = rows.part(parameter, getattr(given, parameter))
    along = read_direction(reduced, linearised.push, parameter, direction, linearised.closed)
    found = _along(linearised, of, along, parameter)
    if parameter == "gap":  # a row of zeros with zero gap has no answer for a smaller gap
        found = _within(found, rows, given)
    if (found.left is None and found.right is None) or of not in (*FORCES, "gap", "slip"):
        return found
    names = ("value", "left", "right", "bound")
    parts: dict[str, Any] = {
        name: None if (one := getattr(found, name)) is None else rows.spread(of, one) for name in names
    }
    if of in FORCES:
        return replace(found, **parts)
    moved = _along(linearised, "displacement", along, parameter)
    sides = [name for name in ("left", "right") if parts[name] is not None and getattr(moved, name) is not None]
    if not sides:
        return replace(found, value=None, left=None, right=None, exists=False, bound=None, reason=moved.reason)
    matrix, own = (
        (solution.problem.tangent, -given.slip_origin) if of == "slip" else (-solution.problem.normal, given.whole_gap)
    )
    assert matrix is not None
    idle = rows.idle_contacts
    parts |= {name: None for name in ("left", "right") if name not in sides}
    for name in sides:
        parts[name][idle] = (own + (matrix @ getattr(moved, name)).reshape(own.shape))[idle]
    same = found.exists and (
        moved.exists or (len(sides) == 2 and np.array_equal(parts["left"][idle], parts["right"][idle]))
    )
    if parts["bound"] is None or moved.bound is None:
        parts |= dict(bound=None, bound_reason=found.bound_reason or moved.bound_reason)
    else:
        size = abs(own) + (abs(matrix) @ np.max([abs(getattr(moved, name)) for name in sides], axis=0)).reshape(
            own.shape
        )
        off = (abs(matrix) @ moved.bound).reshape(own.shape)
        if given.rows is not None and of == "gap":  # the change of the row is a product with the answer
            known = linearised.extended_answer
            assert known is not None
            assert known.bound is not None
            off = off + abs(given.rows) @ known.bound.displacement
            size = size + abs(given.rows) @ abs(solution.displacement)
        parts["bound"][idle] = (off + EPS * (solution.problem.dimension + 3) * size)[idle]
    reason = found.reason or ("" if same else moved.reason)
    return replace(found, **(parts | dict(value=parts["right"] if same else None, exists=same, reason=reason)))


def _within(found: Derivative, rows: ActingRows, given: Direction) -> Derivative:
    """Return a derivative as far as rows of zeros have gaps along a direction, None on a side where they have not."""
    gap, change = rows.whole.gap[rows.idle_contacts], given.gap[rows.idle_contacts]
    steps = [min(falls(gap, sign * change), default=np.inf) for sign in (-1.0, 1.0)]
    if found.reach is not None:
        found = replace(found, reach=(min(found.reach[0], steps[0]), min(found.reach[1], steps[1])))
    left, right = (None if step == 0 else one for step, one in zip(steps, (found.left, found.right), strict=True))
    if min(steps) > 0 or (found.left is None and found.right is None):
        return found
    reason = f"towards {'minus' if steps[0] == 0 else 'plus'} the direction: {rows.without_answer('gap')}"
    return replace(found, value=None, left=left, right=right, exists=False, reason=reason)


def _pullback_on_acting(rows: ActingRows, solution: Solution, of: str, weights: Array, parameter: str) -> Bounded:
    """Return the gradient, with bound, of an answer with idle rows from that on the acting rows.

    Gaps and slips of idle rows depend on their data and on the displacement, to which their weights are added.
    """
    reduced, idle = _ON_ACTING[solution], rows.idle_contacts
    pair = pullback(reduced, of, rows.part(of, weights), parameter, True)
    whole = [None if one is None else rows.spread(parameter, one) for one in pair]
    if of not in ("gap", "slip") or not np.any(weights[idle]):
        value, bound = (None if one is None else read_only(one) for one in whole)
        return Bounded.of(value, bound, pair.bound_reason)
    problem, seen = solution.problem, weights.copy()
    seen[rows.contacts] = 0.0
    matrix = problem.tangent if of == "slip" else -problem.normal
    assert matrix is not None
    gradient_of_moved = pullback(reduced, "displacement", matrix.T @ seen.ravel(), parameter)
    value = whole[0] + rows.spread(parameter, gradient_of_moved)
    if (of, parameter) in (("gap", "gap"), ("slip", "slip_origin")):
        value = value + (seen if of == "gap" else -seen)
    elif (of, parameter) == ("gap", "rows"):
        value = (
            value
            + on_entries(problem.normal, ((Estimate.exactly(-seen), Estimate.exactly(solution.displacement)),)).value
        )
    return Bounded.of(read_only(value), None, NEVER_CLOSES)


def _jacobian_on_acting(rows: ActingRows, solution: Solution, names: tuple[str, str], return_bound: bool) -> Any:
    """Return the Jacobian of an answer with idle rows from that on the acting rows."""
    wholes = value_of(solution, names[0]), getattr(solution.problem, names[1])
    counted = (np.arange(np.size(one)).reshape(np.shape(one)) for one in wholes)
    places = [rows.part(name, one).ravel() for name, one in zip(names, counted, strict=True)]
    whole, pair = [], jacobian(_ON_ACTING[solution], *names, return_bound=True)
    for one in pair:
        matrix = np.zeros([np.size(one) for one in wholes])
        if one is not None:
            matrix[np.ix_(*places)] = one
        whole.append(None if one is None else matrix)
    return Bounded.of(whole[0], whole[1], pair.bound_reason) if return_bound else whole[0]


def _refuse_unknown(
    solution: Solution, of: str, with_respect_to: str, parameters: tuple[str, ...] = PARAMETERS
) -> None:
    for argument, name, known in (("of", of, QUANTITIES), ("with_respect_to", with_respect_to, parameters)):
        if name not in known:
            raise InvalidProblem(f"{argument}: expected one of {', '.join(known)}, got {name!r}")
        if solution.problem.tangent is None and name in ("friction_force", "slip", "friction", "slip_origin"):
            raise InvalidProblem(f"{argument}: {name!r} of a problem without tangential rows")
    refuse_far_from_one("derivatives", solution.problem, OF_SQUARES)


def _why_not(linearised: Linearised, of: str, parameter: str, along: Direction | None = None) -> str | None:
    """Return why a quantity has no derivative by a parameter, along a direction or any, or None."""
    if (reason := linearised.irregular) is not None:
        return reason
    if parameter == "slip_origin" and (reason := _drawn_on_supports(linearised, of, along)) is not None:
        return reason
    limited = parameter not in ("load", "stiffness") and not (along and linearised.sharings_are_few)
    told = along and linearised.shares is not None and linearised.system is None  # by the rates
    shared = of in FORCES and not (told or (along and linearised.only(of, along)))
    if (linearised.redundant or linearised.shares) and (shared or limited):
        return REDUNDANT
    problem = linearised.problem
    motions = unheld(linearised.solution, linearised.closed)
    driven = bool(motions) and parameter in ("load", "stiffness", "rows")
    driven = driven if along is None else along.driven != 0
    return FREE if driven or not unique_beside(motions, problem, of) else None


def _drawn_on_supports(linearised: Linearised, of: str, along: Direction | None) -> str | None:
    """Return why there are no rates by slip origins: a contact that sticks is to slip where supports hold it.

    In the plane only its friction jumps, which no unknown feels; in space its friction turns, too.
    """
    problem, borders, tangents = linearised.problem, linearised.borders, linearised.scales.units[2]
    if not problem.frictional or (of != "friction_force" and borders.drag.shape[1] == 1):
        return None
    drawn = (tangents == 0).reshape(borders.drag.shape) & (along is None or along.slip_origin != 0)
    found = np.flatnonzero((linearised.status == STICK) & borders.still & np.any(drawn, axis=1))
    text = "would have to slip along a tangent whose unknowns are all supported"
    return f"{named(problem, found)} {text}" if len(found) else None


def _along(linearised: Linearised, of: str, direction: Direction, parameter: str) -> Derivative:
    """Return the derivative of a quantity along a direction of one parameter."""
    reason = _why_not(linearised, of, parameter, direction) or linearised.borders.without_direction(direction.friction)
    if reason is not None:
        return Derivative(None, None, None, False, reason=reason)
    frictional = linearised.problem.frictional
    if of == "energy" and not frictional and not (linearised.redundant and parameter in ("rows", "gap", "tie_value")):
        rate, error = rate_of_energy(linearised, direction)
        bound = error if may_be_bounded(linearised) else None
        return Derivative(rate, rate, rate, True, bound, bound_reason=why_unbounded(linearised, bound))
    found = [_unique(linearised, of, side, direction) for side in linearised.sides(direction)]
    sides = [side for side in found if isinstance(side, Rates)]
    missing = [side for side in found if isinstance(side, NoRates)]
    # With friction, what is not unique on one side may not be so on the other, where other states may come, too.
    if not sides or (frictional and not all(isinstance(side, NoAnswer) for side in missing)):
        return Derivative(None, None, None, False, reason=str(missing[-1]))
    left, right = (of_rates(linearised, of, side, direction)[0] if isinstance(side, Rates) else None for side in found)
    same = len(sides) == 2 and are_same(linearised, of, (sides[0], sides[1]), direction)
    reason = "" if same else f"the two sides differ: {linearised.at_border() or REDUNDANT}"
    for sign, side in zip(("minus", "plus"), found, strict=True):
        reason = f"towards {sign} the direction: {side}" if isinstance(side, NoRates) else reason
    reach, shared = None, any(side.shared for side in sides)
    if parameter in LINEAR and linearised.has_events:
        back, ahead = (
            min(linearised.events(side, sign), default=np.inf) if isinstance(side, Rates) else 0.0
            for sign, side in zip((-1.0, 1.0), found, strict=True)
        )
        reach = float(back), float(ahead)
    bound, seen = None, not direction.by_answer or all(side.off is not None for side in sides)
    if seen and may_be_bounded(linearised, shared):
        errors = [of_rates(linearised, of, side, direction)[1] for side in sides]
        bound = None if any(one is None for one in errors) else read_only(np.max(errors, axis=0))
    why = why_unbounded(linearised, bound, shared)
    return Derivative(right if same else None, left, right, same, bound, reach, reason, why)


def _unique(linearised: Linearised, of: str, side: Rates | NoRates, direction: Direction) -> Rates | NoRates:
    """Return the rates on a side where those of a quantity are unique, otherwise why there are none."""
    if isinstance(side, NoRates):
        return side
    if of in FORCES and side.shared and not linearised.only(of, direction):
        return NoRates(REDUNDANT)
    return side if unique_beside(side.motions, linearised.problem, of) else NoRates(FREE)


def read_direction(
    solution: Solution, push: Vector, parameter: str, direction: Any, closed: Indices | None = None
) -> Direction:
    """Return the direction of a parameter as changes of the data, at an answer with contact forces (m,).

    Raises InvalidProblem: a wrong shape, numbers that are not finite, or an unsymmetric change of the stiffness.

    Parameters
    ----------
    solution, push : the answer, and its contact forces
    parameter, direction : as in `contactqp.analysis.derivatives.derivative`
    closed : contacts that hold motions, as far as the answer does not tell them
    """
    problem, u = solution.problem, solution.displacement
    zero, motions = Direction.zero(problem), unheld(solution, closed)
    if parameter in VECTORS:
        expected, given = np.shape(getattr(problem, parameter)), read_array("direction", direction)
        if parameter == "friction" and given.ndim == 0:
            given = np.full(expected, given)
        if given.shape not in (expected, (int(np.prod(expected)),), () if expected == (1,) else expected):
            raise InvalidProblem(f"direction: expected shape {expected}, got {given.shape}")
        if not np.all(np.isfinite(given)):
            raise InvalidProblem(f"direction: expected finite numbers, got {shown(direction)}")
        loads = given[None] if parameter == "load" else np.zeros((0, problem.dimension))
        driven = float(moved_by(motions, loads))
        return Direction(**(vars(zero) | {parameter: given.reshape(expected), "driven": driven}))
    change = read_matrix("direction", direction)
    expected = problem.stiffness.shape if parameter == "stiffness" else problem.normal.shape
    if change.shape != expected:
        raise InvalidProblem(f"direction: expected shape {expected}, got {change.shape}")
    change = sp.csr_array(change)
    if parameter == "rows":
        closing = np.asarray(change @ u)
        changed: dict[str, Any] = dict(
            turned=-np.asarray(change.T @ push), closing=-closing, work=float(push @ closing),
            driven=float(moved_by(motions, change)), rows=change,
        )  # fmt: skip
        return Direction(**(vars(zero) | changed))
    if float(abs(change - change.T).max()) > SYMMETRIC * float(abs(change).max()):
        raise InvalidProblem("direction: expected a symmetric matrix, as the stiffness is one")
    moved = np.asarray(change @ u)
    driven = float(moved_by(motions, change))
    strained: dict[str, Any] = dict(strained=-moved, work=0.5 * float(u @ moved), driven=driven, stiffness=change)
    return Direction(**(vars(zero) | strained))
