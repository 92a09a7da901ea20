"""Derivatives of an answer by what its problem is made of, to either side where contacts are at a border.

Rates follow from the states of the contacts (`contactqp.analysis.rates`). A gradient takes the transposed system, with
weights z on what is asked for in place of the direction: its displacement and forces y are the gradients by load, gaps,
slip origins and tie values, -(y u' + u y')/2 is that by K.

Answers as functions of JAX and PyTorch, differentiated by what `pullback` says; neither is imported until asked for.

A function takes what is varied by name, in double precision: load (n,), gap (m,), tie_value (k,), friction (m,),
slip_origin (m, d-1), and stiffness, the entries (nnz,) of K on the pattern of `problem.stiffness_rows`. Every call is a
certified solution, and its gradient one system with the same factors. Where an answer has no gradient, at a contact
that grazes, the error says so.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.analysis.border_states import is_proven
from contactqp.analysis.many_loads import solve_many
from contactqp.analysis.rate_systems import SAME, VECTORS, Direction, Parts, Rates, errors_of, on_entries, on_pattern
from contactqp.analysis.rates import FREE, REDUNDANT, Linearised, NoRates
from contactqp.errors import BackendMissing, InvalidProblem, shown
from contactqp.linalg.floating import UNRESISTED
from contactqp.model.arguments import checked
from contactqp.model.arrays import Array, own_floating_point
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import ReadOnly, read_array, read_only
from contactqp.model.solution import Solution
from contactqp.solving.solve import solve

# What may be differentiated, and by what.
FORCES = ("normal_force", "friction_force", "tie_force")
QUANTITIES = ("displacement", *FORCES, "gap", "slip", "reaction", "energy")
PARAMETERS = (*VECTORS, "stiffness", "rows")
# Along these the answer is linear while contacts keep their states.
LINEAR = ("load", "gap", "tie_value", "slip_origin")


@dataclass(frozen=True, eq=False)
class Derivative(ReadOnly):
    """The rate at which a quantity of an answer changes along a direction, in its units over those of the parameter.

    `left` and `right` are towards minus and plus the direction; `value` is both where they are one, else None, and
    `reason` says why. `reach` are the steps (back, ahead) along the direction, not negative, within which no contact
    changes its state; None where the answer is not linear along it, as for the stiffness and in space where something
    slips. `bound` is what the value, or each of the two, may be off by, entry by entry, of a proven answer along load,
    gaps, slip origins and tie values, the energy left out; its rounding allowance is that of certificates. An answer
    with friction is proven, as by `contactqp.certify`, when it is first asked.
    """

    value: Any
    left: Any
    right: Any
    exists: bool
    bound: Any = None
    reach: tuple[float, float] | None = None
    reason: str = ""


@checked
@own_floating_point
def derivative(solution: Solution, of: str, with_respect_to: str, direction: ArrayLike) -> Derivative:
    """Return the rate at which a quantity of an answer changes along a direction of a parameter.

    Parameters
    ----------
    solution : Solution
        With friction, of contacts that are condensed.
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
        A name that is none of these or that the problem does not have, a wrong shape, or a direction of the stiffness
        that is not symmetric.
    Unsupported
        The answer is of bodies too large to factorise, or with friction of contacts too many to condense.

    Examples
    --------
    >>> import contactqp as cq
    >>> bar = cq.ContactProblem(stiffness=[[2.0]], load=[4.0], normal=[[1.0]], gap=[1.0])
    >>> cq.solve(bar).derivative("normal_force", "gap", [1.0]).value
    array([-2.])
    """
    _refuse_unknown(solution, of, with_respect_to)
    linearised = Linearised(solution)
    return _along(linearised, of, linearised.reads(with_respect_to, direction), with_respect_to)


@checked
@own_floating_point
def jacobian(solution: Solution, of: str, with_respect_to: str) -> Array:
    """Return the derivatives by all entries of a vector parameter, flat: a row an entry of the quantity; `derivative`.

    Raises
    ------
    InvalidProblem
        A derivative does not exist: the message says why. Stiffness and rows have `pullback` and `derivative` alone.
    """
    _refuse_unknown(solution, of, with_respect_to, VECTORS)
    size, linearised = np.size(getattr(solution.problem, with_respect_to)), Linearised(solution)
    rows = np.size(_value(solution, of))
    adjoint = rows < size and not len(linearised.undecided) and with_respect_to != "friction"
    if adjoint and _why_not(linearised, of, with_respect_to) is None:
        weights = np.eye(rows).reshape(rows, *np.shape(_value(solution, of)))
        gradients = [np.ravel(_gradient(linearised, of, one, with_respect_to)) for one in weights]
        return np.array(gradients).reshape(rows, size)
    columns = []
    for unit in np.eye(size):
        direction = unit.reshape(np.shape(getattr(solution.problem, with_respect_to)))
        found = _along(linearised, of, linearised.reads(with_respect_to, direction), with_respect_to)
        if found.value is None:
            raise InvalidProblem(f"jacobian of {of} with respect to {with_respect_to}: {found.reason}")
        columns.append(np.ravel(found.value))
    return np.column_stack(columns) if columns else np.zeros((rows, 0))


@checked
@own_floating_point
def pullback(solution: Solution, of: str, weights: ArrayLike, with_respect_to: str) -> Any:
    """Return the gradient of weights . quantity by a parameter, in the parameter's shape: one system for all entries.

    By the stiffness it is on the pattern of K, symmetric, so that its sum of products with dK is the rate along dK; by
    the rows on the pattern of these. Quantities and parameters are those of `derivative`.

    Parameters
    ----------
    solution : Solution
    of : str
        The quantity, a name of `derivative`'s `of`.
    weights : array in the shape of the quantity, finite
        With what each of its entries counts in the sum.
    with_respect_to : str
        The parameter, a name of `derivative`'s `with_respect_to`.

    Raises
    ------
    InvalidProblem
        A name or shape that is wrong, or a derivative that does not exist.
    """
    _refuse_unknown(solution, of, with_respect_to)
    expected = np.shape(_value(solution, of))
    given = read_array("weights", weights)
    if given.shape != expected or not np.all(np.isfinite(given)):
        raise InvalidProblem(f"weights: expected finite numbers in the shape {expected} of {of}, got {shown(weights)}")
    linearised = Linearised(solution)
    reason = _why_not(linearised, of, with_respect_to)
    if with_respect_to == "friction":
        reason = reason or linearised.borders.without_direction(np.ones(solution.problem.contacts))
    if reason is not None:
        raise InvalidProblem(f"pullback: {reason}")
    return read_only(_gradient(linearised, of, given, with_respect_to))


def _refuse_unknown(
    solution: Solution, of: str, with_respect_to: str, parameters: tuple[str, ...] = PARAMETERS
) -> None:
    for argument, name, known in (("of", of, QUANTITIES), ("with_respect_to", with_respect_to, parameters)):
        if name not in known:
            raise InvalidProblem(f"{argument}: expected one of {', '.join(known)}, got {name!r}")
        if solution.problem.tangent is None and name in ("friction_force", "slip", "friction", "slip_origin"):
            raise InvalidProblem(f"{argument}: {name!r} of a problem without tangential rows")


def _value(solution: Solution, of: str) -> Any:
    """Return the quantity itself."""
    problem = solution.problem
    return problem.load - problem.stiffness_rows @ solution.displacement if of == "reaction" else getattr(solution, of)


def _why_not(linearised: Linearised, of: str, parameter: str, along: Direction | None = None) -> str | None:
    """Return why a quantity has no derivative by a parameter, along a direction or whatever this is, or None."""
    if (reason := linearised.irregular) is not None:
        return reason
    limited = parameter in ("rows", "gap", "tie_value") and not (along and linearised.few_touch)
    if linearised.redundant and (of in FORCES or limited):
        return REDUNDANT
    problem, motions = linearised.problem, [motion.direction for motion in linearised.solution.free_motions]
    driven = bool(motions) and parameter in ("load", "stiffness", "rows")
    driven = driven if along is None else along.driven != 0
    rows = problem.normal[np.isfinite(problem.gap)] if of == "gap" else problem.normal[:0]
    seen = any(np.any(abs(rows @ motion) > UNRESISTED * (abs(rows) @ abs(motion))) for motion in motions)
    return FREE if driven or seen or (motions and of in ("displacement", "slip")) else None


def _along(linearised: Linearised, of: str, direction: Direction, parameter: str) -> Derivative:
    """Return the derivative of a quantity along a direction of one parameter."""
    reason = _why_not(linearised, of, parameter, direction) or linearised.borders.without_direction(direction.friction)
    if reason is not None:
        return Derivative(None, None, None, False, reason=reason)
    frictional = linearised.problem.frictional
    if of == "energy" and not frictional and not (linearised.redundant and parameter in ("rows", "gap", "tie_value")):
        rate = _rate_of_energy(linearised.solution, direction)
        return Derivative(rate, rate, rate, True)
    try:
        back, ahead = linearised.sides(direction)
    except NoRates as none:
        return Derivative(None, None, None, False, reason=str(none))
    if of in FORCES and (back.shared or ahead.shared):
        return Derivative(None, None, None, False, reason=REDUNDANT)
    left, right = (_of_rates(linearised.solution, of, rates, direction) for rates in (back, ahead))
    same = linearised.scales.same("displacement" if of == "energy" else of, back, ahead)
    if of == "energy" and not same:
        meet = abs(_value(linearised.solution, "reaction")) @ (abs(back.displacement) + abs(ahead.displacement))
        same = abs(left - right) <= SAME * (meet + abs(linearised.solution.displacement) @ abs(direction.load))
    reason = "" if same else f"the two sides differ: {linearised.at_border() or REDUNDANT}"
    reach = None
    turns = linearised.turns
    if parameter in LINEAR and not turns:
        reach = _first(linearised, back, -1.0), _first(linearised, ahead, 1.0)
    bound = None
    if parameter in LINEAR and of != "energy" and not turns and is_proven(linearised.solution):
        both = [errors_of(linearised.problem, of, rates, direction) for rates in (back, ahead)]
        bound = None if any(one is None for one in both) else read_only(np.maximum(*both))
    return Derivative(right if same else None, left, right, same, bound, reach, reason)


def _of_rates(solution: Solution, of: str, rates: Rates, direction: Direction) -> Any:
    """Return the rate of a quantity; of the energy with friction (Ku - f)'du - u'df + u'dK u / 2."""
    if of != "energy":
        found: Array = read_only(getattr(rates, of))
        return found
    strained = float(-0.5 * solution.displacement @ direction.strained)
    return float(-_value(solution, "reaction") @ rates.displacement - solution.displacement @ direction.load) + strained


def _first(linearised: Linearised, rates: Rates, sign: float) -> float:
    return float(min(linearised.events(rates, sign), default=np.inf))


def _rate_of_energy(solution: Solution, direction: Direction) -> float:
    """Return the rate without friction, by the envelope theorem: -u'df - l_N'dg - nu'db + u'dK u / 2 + l_N'dE_N u."""
    rate = -(solution.displacement @ direction.load) - solution.normal_force @ direction.gap
    return float(rate - solution.tie_force @ direction.tie_value + direction.work)


def _gradient(linearised: Linearised, of: str, weights: Array, parameter: str) -> Any:
    """Return the gradient of weights . quantity by a parameter."""
    problem, solution = linearised.problem, linearised.solution
    u, push = solution.displacement, linearised.push
    if of == "energy" and not problem.frictional:
        by: dict[str, Any] = dict(load=-u, gap=-push, tie_value=-solution.tie_force)
        by |= dict(friction=0.0 * push, slip_origin=Direction.zero(problem).slip_origin)
        if parameter in by:
            return float(weights) * by[parameter]
        half = float(weights) * 0.5 * u
        at_rows = on_entries(problem.normal, ((float(weights) * push, u),))
        return on_pattern(problem, half, u) if parameter == "stiffness" else at_rows
    if len(linearised.undecided):
        raise InvalidProblem(f"pullback: {linearised.at_border()}, and the derivative may have two sides")
    y = linearised.adjoint(_weights(linearised, of, weights))
    if parameter == "stiffness":
        own = 0.5 * float(weights) * u if of == "energy" else -weights if of == "reaction" else 0.0 * u
        return on_pattern(problem, own - y.displacement, u)
    if parameter == "rows":
        own = weights if of == "gap" else 0.0 * push
        return on_entries(problem.normal, ((-push, y.displacement), (-(y.normal + own), u)))
    if parameter in ("friction", "slip_origin"):
        return _by_law(linearised, of, weights, parameter, y)
    found = dict(load=y.displacement, gap=y.normal, tie_value=y.tie)[parameter]
    if parameter == "load" and of in ("reaction", "energy"):
        return found + (weights if of == "reaction" else -float(weights) * u)
    return found + weights if parameter == of == "gap" else found


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
        u = -float(weights) * _value(linearised.solution, "reaction")
    elif of == "normal_force":
        normal = weights
    elif of == "tie_force":
        tie = weights
    elif linearised.system is not None and problem.tangent is not None and problem.friction is not None:
        system = linearised.system
        tangent = weights
        normal = problem.friction * np.sum(system.directions * weights, axis=1)
        u = problem.tangent.T @ np.einsum("mij,mj->mi", system.turning, weights).ravel()
    return Parts(u, normal, tangent, tie)


def _by_law(linearised: Linearised, of: str, weights: Array, parameter: str, y: Parts) -> Array:
    """Return the gradient by coefficients (m,) or slip origins (m, d-1), which enter by Coulomb's law."""
    problem, system = linearised.problem, linearised.system
    slip_weights = -weights if of == "slip" and parameter == "slip_origin" else np.zeros_like(y.tangent)
    if system is None or problem.tangent is None or not problem.frictional:
        return slip_weights if parameter == "slip_origin" else np.zeros(problem.contacts)
    dragged = -(problem.tangent @ y.displacement).reshape(y.tangent.shape)
    dragged = dragged + weights if of == "friction_force" else dragged
    if parameter == "friction":
        return np.asarray(linearised.push * np.sum(system.directions * dragged, axis=1))
    return np.asarray(y.tangent + slip_weights - np.einsum("mij,mj->mi", system.turning, dragged))


FRAMEWORKS = ("jax", "torch")
VARIED = (*VECTORS, "stiffness")
# What `solve_many` takes, by its names of them, and what it has of all cases.
OF_MANY = dict(load="loads", gap="gaps", friction="friction")
ARRAYS_OF_MANY = ("normal_force", "friction_force", "tie_force", "gap")


@checked
@own_floating_point
def differentiable(problem: ContactProblem, of: str, varied: Sequence[str], framework: str) -> Callable[..., Any]:
    """Return an answer as a function of what is varied, for automatic differentiation.

    Parameters
    ----------
    problem : ContactProblem
        What is not varied is its own.
    of : str
        "displacement", "normal_force", "friction_force", "tie_force", "gap", "slip" or "energy".
    varied : sequence of str
        Names of the arguments, in their order: "load", "gap", "tie_value", "friction", "slip_origin" and "stiffness",
        the entries of K on the pattern of `problem.stiffness_rows`, which are symmetrised.
    framework : str
        "jax": for `jax.grad`, `jax.jacrev`, `jax.vmap` and `jax.jit`; "torch": for tensors and `torch.func`. Batches of
        loads, gaps and coefficients are solved as by `solve_many`.

    Raises
    ------
    BackendMissing
        The framework is not installed.
    InvalidProblem
        A name that is none of these; JAX computes in single precision.

    Examples
    --------
    >>> import jax, contactqp as cq  # doctest: +SKIP
    >>> jax.config.update("jax_enable_x64", True)  # doctest: +SKIP
    >>> bar = cq.ContactProblem([[157500.0]], [300.0], [[1.0]], [1e-3])  # doctest: +SKIP
    >>> force = cq.differentiable(bar, "normal_force", ["gap"], "jax")  # doctest: +SKIP
    >>> jax.jacrev(force)(bar.gap)  # doctest: +SKIP
    Array([[-157500.]], dtype=float64)
    """
    known = tuple(name for name in QUANTITIES if name != "reaction")
    named = [("of", of, known), ("framework", framework, FRAMEWORKS), *(("varied", name, VARIED) for name in varied)]
    for argument, name, names in named:
        if name not in names:
            raise InvalidProblem(f"{argument}: expected one of {', '.join(names)}, got {name!r}")
    if not varied or len(set(varied)) < len(varied):
        raise InvalidProblem(f"varied: expected names, each once, got {', '.join(varied) or 'none'}")
    try:
        module = import_module(framework)
    except ImportError:
        raise BackendMissing(f"differentiable: {framework} is not installed: pip install {framework}") from None
    host = _Host(problem, of, tuple(varied))
    return _jax_function(module, host) if framework == "jax" else _torch_function(module, host)


class _Host:
    """Answers and gradients in NumPy, of one case or of a batch, whose dimensions come before those of a case."""

    def __init__(self, problem: ContactProblem, of: str, varied: tuple[str, ...]) -> None:
        self.problem, self.of, self.varied = problem, of, varied
        self.shape = np.shape(getattr(solve(problem), of))
        self._ranks = [1 if name == "stiffness" else np.ndim(getattr(problem, name)) for name in varied]
        self._last: tuple[tuple[bytes, ...], Solution] | None = None

    def _cases(self, values: Sequence[Any]) -> tuple[tuple[int, ...], list[Array]]:
        """Return the dimensions of a batch, and the values of its cases (cases, ...) one after the other."""
        given = [np.asarray(value, dtype=float) for value in values]
        pairs = list(zip(given, self._ranks, strict=True))
        batch = np.broadcast_shapes(*(value.shape[: value.ndim - rank] for value, rank in pairs))
        own = [value.shape[value.ndim - rank :] for value, rank in pairs]
        whole = [np.broadcast_to(value, batch + one) for value, one in zip(given, own, strict=True)]
        return batch, [value.reshape(-1, *one) for value, one in zip(whole, own, strict=True)]

    def solution(self, values: Sequence[Array]) -> Solution:
        """Return the certified answer where these have the varied parameters' places; the last one is kept."""
        key = tuple(value.tobytes() for value in values)
        if self._last is not None and self._last[0] == key:
            return self._last[1]
        changes: dict[str, Any] = {}
        for name, given in zip(self.varied, values, strict=True):
            changes[name] = given
            if name == "stiffness":
                rows = self.problem.stiffness_rows
                if given.shape != rows.data.shape:
                    raise InvalidProblem(f"stiffness: expected entries {rows.data.shape}, got {given.shape}")
                K = sp.csr_array((given, rows.indices, rows.indptr), shape=rows.shape)
                changes[name] = (K + K.T) / 2
        found: Solution = solve(self.problem.replace(**changes))
        self._last = key, found
        return found

    def value(self, *values: Any) -> Array:
        """Return the quantity, in doubles; that of many loads, gaps or coefficients as of `solve_many`."""
        batch, cases = self._cases(values)
        if len(cases[0]) > 1 and set(self.varied) <= set(OF_MANY):
            given: dict[str, Any] = {OF_MANY[name]: one for name, one in zip(self.varied, cases, strict=True)}
            many = solve_many(self.problem, **given)
            of_all = self.of in ARRAYS_OF_MANY and many.passed.all()  # one that fails says why when it is asked for
            found = getattr(many, self.of) if of_all else [getattr(one, self.of) for one in many]
        else:
            found = [getattr(self.solution(one), self.of) for one in zip(*cases, strict=True)]
        return np.array(found, dtype=float).reshape(batch + self.shape)

    def gradients(self, weights: Any, *values: Any) -> tuple[Array, ...]:
        """Return the gradient of weights . quantity by each argument, case by case."""
        batch, cases = self._cases(values)
        given = np.asarray(weights, dtype=float)
        batch = np.broadcast_shapes(batch, given.shape[: given.ndim - len(self.shape)])
        given = np.broadcast_to(given, batch + self.shape).reshape(-1, *self.shape)
        rows, found = self.problem.stiffness_rows, [np.empty((len(given), *one.shape[1:])) for one in cases]
        places = np.repeat(np.arange(rows.shape[0]), np.diff(rows.indptr)), rows.indices
        for i, weight in enumerate(given):
            solution = self.solution([one[i % len(one)] for one in cases])
            for name, gradient in zip(self.varied, found, strict=True):
                own = pullback(solution, self.of, weight, name)
                gradient[i] = np.reshape(sp.csr_array(own)[places] if name == "stiffness" else own, gradient[i].shape)
        return tuple(one.reshape(*batch, *one.shape[1:]) for one in found)


def _jax_function(jax: Any, host: _Host) -> Callable[..., Any]:
    """Return a function with a reverse rule, whose solutions are made outside of JAX, all of a batch at once."""
    if not jax.config.jax_enable_x64:
        raise InvalidProblem(
            'differentiable: JAX computes in single precision; expected jax.config.update("jax_enable_x64", True)'
        )

    def shaped(shape: tuple[int, ...]) -> Any:
        return jax.ShapeDtypeStruct(shape, float)

    def answered(*values: Any) -> Any:
        return jax.pure_callback(host.value, shaped(host.shape), *values, vmap_method="expand_dims")

    def forward(*values: Any) -> Any:
        return answered(*values), values

    def backward(values: Any, weights: Any) -> Any:
        shapes = tuple(shaped(value.shape) for value in values)
        return jax.pure_callback(host.gradients, shapes, weights, *values, vmap_method="expand_dims")

    answer: Any = jax.custom_vjp(answered)
    answer.defvjp(forward, backward)
    made: Callable[..., Any] = answer
    return made


def _torch_function(torch: Any, host: _Host) -> Callable[..., Any]:
    """Return a function of tensors in double precision, for `torch.func.vmap` and `grad`, too."""

    def kind(name: str, forward: Any, keep: Any, backward: Any) -> Any:
        def batched(_: Any, dimensions: Any, *values: Any) -> Any:
            pairs = zip(values, dimensions, strict=True)
            found = made.apply(*(one[None] if place is None else one.movedim(place, 0) for one, place in pairs))
            return found, (0,) * len(found) if isinstance(found, tuple) else 0

        rules = dict(forward=forward, setup_context=keep, backward=backward, vmap=batched)
        made: Any = type(name, (torch.autograd.Function,), {rule: staticmethod(one) for rule, one in rules.items()})
        return made

    def numbers(values: Any) -> Any:
        return (value.detach().numpy() for value in values)

    def pulled(context: Any, weights: Any) -> Any:
        values = context.saved_tensors
        found = gradient.apply(weights, *values)
        return tuple(one.sum_to_size(value.shape) for one, value in zip(found, values, strict=True))

    gradient = kind(
        "ContactGradient", lambda *values: tuple(map(torch.from_numpy, host.gradients(*numbers(values)))),
        lambda *_: None, None,
    )  # fmt: skip
    answer = kind(
        "ContactAnswer", lambda *values: torch.from_numpy(host.value(*numbers(values))),
        lambda context, values, _: context.save_for_backward(*values), pulled,
    )  # fmt: skip
    apply: Callable[..., Any] = answer.apply
    return apply
