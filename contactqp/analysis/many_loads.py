"""Many load cases of one problem: one factorisation, condensed once, every case certified.

For many cases, influence functions (`contactqp.linalg.influence`) reduce each to a product with its load and a small
system: without friction, with friction in the plane, and in space if all closed contacts stick. The answer is proven,
and floating bodies are put on springs. A case too near to other contact states, or not accurate enough, is solved by
`solve`.

The search for states starts from the previous case if answers are unique for any load (without friction, or by
`contactqp.critical_friction`); otherwise from the contacts that close without friction, so that an answer does not
depend on previous cases; for floating bodies from all contacts closed.

Answers are also available as functions of JAX and PyTorch, which are imported on request. Every call is a certified
solution, its gradient one system with the same factors (`pullback`); where there is none an error is raised.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.analysis.derivatives import QUANTITIES, pullback
from contactqp.analysis.load_cases import STATUS, LoadCases, Solutions
from contactqp.analysis.rate_data import VECTORS
from contactqp.certificate.bounds import REDUNDANT
from contactqp.certificate.critical_friction import critical, too_many
from contactqp.certificate.number_range import near_one
from contactqp.errors import BackendMissing, ContactQPError, InvalidProblem, Unsupported, counted, free_memory
from contactqp.linalg.condensation import Condensation, condense
from contactqp.linalg.influence import Influence, ProvenForces, SolvedCases, held_by_springs
from contactqp.linalg.iteration import Systems, systems_of
from contactqp.model import arrays
from contactqp.model.arguments import checked
from contactqp.model.arrays import METHOD, Array, Vector, one_blas_thread, own_floating_point, stage, telling
from contactqp.model.coulomb import OPEN, SLIP_ON, STICK
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution, Work
from contactqp.solving.methods import DEFAULT_METHOD, registered_name, within_time_of
from contactqp.solving.runs import Meter
from contactqp.solving.solve import solve

# The number of influence functions worth computing per case, and the part of free memory for them.
PER_CASE, PART_OF_MEMORY = 8, 0.125
# With fewer unknowns a solution takes a millisecond, so that functions are used only from this number of cases.
FEWEST_UNKNOWNS, MANY_CASES = 500, 200
# Errors of single cases, after which others continue; missing or unsupported methods concern all of them.
OF_ALL = (BackendMissing, Unsupported)
NUMBER = {word: number for number, word in enumerate(STATUS)}


@checked
@own_floating_point
def solve_many(
    problem: ContactProblem,
    loads: Any = None,
    gaps: Any = None,
    friction: ArrayLike | None = None,
    method: str = DEFAULT_METHOD,
    progress: Callable[[str], object] | None = None,
    **options: Any,
) -> Solutions:
    """Solve one problem for many loads, gaps or coefficients of friction, each certified as by `solve`.

    The stiffness is factorised and condensed once, and again on springs if a body floats. Without friction, with
    friction in the plane, and in space without slip, a case then takes a product with influence functions and a small
    system, and `force_bound` proves its forces: with friction they are those of an equilibrium, the only one nearby.
    Cases closer to other contact states, and all others, are solved separately, starting from the previous answer if
    this is unique, so that similar loads should be adjacent. Failing cases do not affect others.

    Parameters
    ----------
    problem : ContactProblem
        It provides what is not given for each case.
    loads : (N, n) array or sparse matrix, optional
        A load for each case [force]. An array of doubles is not copied.
    gaps : (N, m) array, optional
        The initial gaps of each case [length]; infinity is that of a contact that never closes.
    friction : number, (N, 1) or (N, m) array, optional
        One coefficient for all cases, one for each, or one for each contact of each.
    method : str
        The method of `solve` for every case.
    progress : callable, optional
        A function that is called with a few words on what is being done.
    **options
        Further options of `solve`, except `warm_start`. `time_limit` [s] is that of all cases together; `failures` has
        the reason for those that were not solved in time.

    Returns
    -------
    Solutions
        Forces, gaps, states and verdicts in arrays, the envelope of the forces, and each `Solution` when asked for.

    Raises
    ------
    InvalidProblem
        An array has a wrong shape or a number that is not finite; the message names the case.
    BackendMissing, Unsupported
        The method is not installed, or cannot do this.

    Examples
    --------
    >>> import contactqp as cq
    >>> bar = cq.ContactProblem(stiffness=[[2.0]], load=[0.0], normal=[[1.0]], gap=[1.0])
    >>> many = cq.solve_many(bar, loads=[[1.0], [4.0], [6.0]])
    >>> many.normal_force.ravel(), bool(many.passed.all()), many.envelope().load
    (array([0., 2., 4.]), True, array([2]))
    """
    for meant in ("loads", "gaps"):
        if meant[:-1] in options:
            raise InvalidProblem(f"solve_many: no argument is called {meant[:-1]!r} (do you mean {meant!r}?)")
    if "warm_start" in options:
        raise InvalidProblem("solve_many: a case starts from the one before it; expected no warm_start")
    method, cases, started = registered_name(method), LoadCases(problem, loads, gaps, friction), time.perf_counter()
    rows = _Rows(cases)
    with nullcontext() if progress is None else telling(progress), within_time_of(options):
        if method == DEFAULT_METHOD and not options.keys() - {"time_limit"} and cases.count:
            _by_influence(cases, rows)
        _one_by_one(cases, rows, method, options)
    return rows.solutions(cases, method, options, time.perf_counter() - started)


def _by_influence(cases: LoadCases, rows: _Rows) -> None:
    """Solve cases by influence functions, if these pay for the number of cases."""
    try:
        problem = cases.case(0)
        if not _pays(cases, problem) or not _may_stick(cases, problem, rows):
            return
        meter = Meter(problem)
        with problem._lock, one_blas_thread(problem), stage(METHOD), meter.running():
            condensation, loaded, rough = condense(problem), cases.loaded(), _is_rough(cases, problem)
            size, free = len(loaded) * _functions(problem, rough) * loaded.itemsize, free_memory()
            if not len(condensation.schur) or size > PART_OF_MEMORY * (free or np.inf):
                return
            warm, springs = not rough or _is_only(cases, condensation), condensation.rigid.count
            if springs:
                problem = held_by_springs(problem, condensation.rigid.motions)
                condensation = condense(problem)
            influence = Influence(problem, condensation, loaded, rough, springs)
            if influence.accurate:
                _take_blocks(cases, rows, influence, loaded, warm)
    except ContactQPError:
        return  # `solve` handles each case
    route = f"influence functions: {int(rows.answered.sum())} of {counted('case', cases.count)}"
    rows.work = replace(meter.read(0, 0), routes=(route,))


def _pays(cases: LoadCases, problem: ContactProblem) -> bool:
    """Return whether influence functions are available for a problem, and pay for the number of cases."""
    rough = _is_rough(cases, problem)
    count = _functions(problem, rough)
    if problem.dimension < FEWEST_UNKNOWNS and cases.count < MANY_CASES:
        return False
    if not 0 < count <= min(PER_CASE * cases.count, problem.dimension) or problem.has_idle_rows:
        return False
    if systems_of(problem) is not Systems.CONDENSED:
        return False
    return near_one(problem) is None


def _may_stick(cases: LoadCases, problem: ContactProblem, rows: _Rows) -> bool:
    """Return whether nothing slips in the first case, solved separately, in space; in the plane slip is allowed."""
    if not _is_rough(cases, problem) or _functions(problem, rough=True) <= 2 * problem.contacts + problem.ties:
        return True
    rows.take(0, found := solve(problem))
    return "slip" not in found.contact_status


def _is_rough(cases: LoadCases, problem: ContactProblem) -> bool:
    """Return whether any case has friction."""
    return problem.frictional or bool(cases.friction is not None and np.any(cases.friction > 0))


def _functions(problem: ContactProblem, rough: bool) -> int:
    """Return the number of influence functions."""
    return problem.contacts + problem.ties + (problem.tangent.shape[0] if rough and problem.tangent is not None else 0)


def _is_only(cases: LoadCases, condensation: Condensation) -> bool:
    """Return whether answers are unique for every load, by the largest coefficient of each contact."""
    problem = cases.problem
    problem = problem if cases.friction is None else problem.replace(friction=cases.friction.max(axis=0))
    return too_many(problem, condensation) is None and critical(problem, condensation).unique


def _take_blocks(cases: LoadCases, rows: _Rows, influence: Influence, loaded: Any, warm: bool) -> None:
    """Solve cases in blocks, from the states of the previous one if `warm`, else from those without friction."""
    problem, m, closed = cases.problem, cases.problem.contacts, STICK if influence.rough else SLIP_ON
    solved, friction = SolvedCases(), np.zeros(m)
    origin = problem.slip_origin.ravel() if influence.rough and problem.slip_origin is not None else np.zeros(0)
    for numbers, loads in cases.blocks(loaded):
        if arrays.time_is_up():
            return
        free, sizes = influence.free(loads)
        for place, i in enumerate(numbers):
            at = place % len(free)
            if influence.rough:
                friction = cases.coefficients(i)
            limit = np.concatenate([cases.gap(i), origin, problem.tie_value, np.zeros(influence.springs)])
            excess = influence.excess(free[at], limit)
            status = solved.nearest(excess) if warm else None
            if status is None:  # without contacts a floating body has no position
                touches = np.isfinite(limit[:m]) if influence.springs else (excess[:m] > 0) & (not warm)
                status = np.where(touches, closed, OPEN).astype(np.int8)
            found = influence.forces(free[at], float(sizes[at]), limit, status, friction)
            if found is not None:
                rows.take_forces(i, found, friction)
                solved.keep(excess, found.status)


def _one_by_one(cases: LoadCases, rows: _Rows, method: str, options: dict[str, Any]) -> None:
    """Solve each case, from the previous answer if both are unique."""
    before: Solution | None = None
    refused: InvalidProblem | None = None
    for i in np.flatnonzero(~rows.answered).tolist():
        try:
            arrays.refuse_late("this case was solved")
            found = _solved(cases.case(i), method, before, options)
        except OF_ALL:
            raise
        except ContactQPError as error:
            refused = error if isinstance(error, InvalidProblem) else refused
            rows.failures[i] = str(error)
            continue
        rows.take(i, found)
        before = found if _is_unique(found) else None
    if refused is not None and not rows.answered.any():
        raise refused  # the problem fails, not a load


def _solved(problem: ContactProblem, method: str, before: Solution | None, options: dict[str, Any]) -> Solution:
    """Solve from another answer, or without it if that fails or the answer is one of several."""
    if before is not None:
        try:
            found = solve(problem, method, warm_start=before, **options)
            if _is_unique(found):
                return found
        except ContactQPError:
            pass  # the error should not depend on the previous case
    return solve(problem, method, **options)


def _is_unique(solution: Solution) -> bool:
    """Return whether there are no findings of other answers, or of other forces with the same displacement."""
    certificate = solution.certificate
    several = certificate.uniqueness or any(REDUNDANT in reason for reason in certificate.reasons)
    return certificate.passed and not several and not solution.free_motions


class _Rows:
    """The arrays of all answers, filled case by case."""

    def __init__(self, cases: LoadCases) -> None:
        problem, count = cases.problem, cases.count
        m, origin = problem.contacts, problem.slip_origin
        self.normal_force = np.full((count, m), np.nan)
        self.friction_force = None if origin is None else np.full((count, *origin.shape), np.nan)
        self.tie_force = np.full((count, problem.ties), np.nan)
        self.gap, self.force_bound = np.full((count, m), np.nan), np.full((count, m), np.nan)
        self.status = np.full((count, m), NUMBER["unknown"], dtype=np.uint8)
        self.passed, self.proven, self.answered, self.started = (np.zeros(count, dtype=bool) for _ in range(4))
        self.failures = [""] * count
        self.work = Work()

    def take(self, i: int, found: Solution) -> None:
        """Store the answer of a case."""
        certificate = found.certificate
        self.normal_force[i], self.tie_force[i], self.gap[i] = found.normal_force, found.tie_force, found.gap
        if self.friction_force is not None and found.friction_force is not None:
            self.friction_force[i] = found.friction_force
        if certificate.force_bound is not None:
            self.force_bound[i] = certificate.force_bound
        self.status[i] = [NUMBER[str(word)] for word in found.contact_status]
        self.passed[i], self.proven[i], self.answered[i] = certificate.passed, certificate.proven, True
        self.failures[i] = "; ".join(certificate.failures)
        self.work = replace(found.work.after(self.work), routes=self.work.routes)

    def take_forces(self, i: int, found: ProvenForces, friction: Vector) -> None:
        """Store the proven forces of a case, given its coefficients of friction."""
        m, ties = len(found.gap), self.tie_force.shape[1]
        self.normal_force[i], self.tie_force[i], self.gap[i] = found.force[:m], found.force[m : m + ties], found.gap
        self.force_bound[i] = found.bound[:m]
        if self.friction_force is not None:
            self.friction_force[i] = 0.0
            if found.friction_force is not None:
                self.friction_force[i].flat = found.friction_force
        rough = np.where(found.status == STICK, NUMBER["stick"], NUMBER["slip"])
        closed = np.where(friction > 0, rough, NUMBER["closed"])
        self.status[i] = np.where(found.status == OPEN, NUMBER["open"], closed)
        self.passed[i] = self.proven[i] = self.answered[i] = self.started[i] = True

    def solutions(self, cases: LoadCases, method: str, options: dict[str, Any], seconds: float) -> Solutions:
        """Return the answers of all cases."""
        return Solutions(
            problem=cases.problem,
            normal_force=self.normal_force,
            friction_force=self.friction_force,
            tie_force=self.tie_force,
            gap=self.gap,
            force_bound=self.force_bound,
            passed=self.passed,
            proven=self.proven,
            failures=tuple(self.failures),
            method=method,
            seconds=seconds,
            work=self.work,
            _status=self.status,
            _cases=cases,
            _arguments=options,
            _started=self.started,
        )


FRAMEWORKS = ("jax", "torch")
VARIED = (*VECTORS, "stiffness")
# The arguments of `solve_many` by parameter, and the quantities that it has for all cases.
OF_MANY = dict(load="loads", gap="gaps", friction="friction")
ARRAYS_OF_MANY = ("normal_force", "friction_force", "tie_force", "gap")


@checked
@own_floating_point
def differentiable(problem: ContactProblem, of: str, varied: Sequence[str], framework: str) -> Callable[..., Any]:
    """Return an answer as a function of the varied parameters, for automatic differentiation.

    Parameters
    ----------
    problem : ContactProblem
        It provides what is not varied.
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
        A name is unknown, or JAX computes in single precision.

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
    """Answers and gradients in NumPy for one case or a batch, whose dimensions precede those of a case."""

    def __init__(self, problem: ContactProblem, of: str, varied: tuple[str, ...]) -> None:
        self.problem, self.of, self.varied = problem, of, varied
        self.shape = np.shape(getattr(solve(problem), of))
        self._ranks = [1 if name == "stiffness" else np.ndim(getattr(problem, name)) for name in varied]
        self._last: tuple[tuple[bytes, ...], Solution] | None = None

    def _cases(self, values: Sequence[Any]) -> tuple[tuple[int, ...], list[Array]]:
        """Return the dimensions of a batch, and the values of its cases (cases, ...)."""
        given = [np.asarray(value, dtype=float) for value in values]
        pairs = list(zip(given, self._ranks, strict=True))
        batch = np.broadcast_shapes(*(value.shape[: value.ndim - rank] for value, rank in pairs))
        own = [value.shape[value.ndim - rank :] for value, rank in pairs]
        whole = [np.broadcast_to(value, batch + one) for value, one in zip(given, own, strict=True)]
        return batch, [value.reshape(-1, *one) for value, one in zip(whole, own, strict=True)]

    def solution(self, values: Sequence[Array]) -> Solution:
        """Return the certified answer for these values of the parameters; the last one is cached."""
        key = tuple(value.tobytes() for value in values)
        if (last := self._last) is not None and last[0] == key:
            return last[1]
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
        """Return the quantity in doubles, for many loads, gaps or coefficients by `solve_many`."""
        batch, cases = self._cases(values)
        if len(cases[0]) > 1 and set(self.varied) <= set(OF_MANY):
            given: dict[str, Any] = {OF_MANY[name]: one for name, one in zip(self.varied, cases, strict=True)}
            many = solve_many(self.problem, **given)
            of_all = self.of in ARRAYS_OF_MANY and many.passed.all()  # a failing case raises its error when used
            found = getattr(many, self.of) if of_all else [getattr(one, self.of) for one in many]
        else:
            found = [getattr(self.solution(one), self.of) for one in zip(*cases, strict=True)]
        return np.array(found, dtype=float).reshape(batch + self.shape)

    def gradients(self, weights: Any, *values: Any) -> tuple[Array, ...]:
        """Return the gradient of weights . quantity by each argument, case by case."""
        of_values, cases = self._cases(values)
        given = np.asarray(weights, dtype=float)
        batch = np.broadcast_shapes(of_values, given.shape[: given.ndim - len(self.shape)])
        given = np.broadcast_to(given, batch + self.shape).reshape(-1, *self.shape)
        case = np.broadcast_to(np.arange(len(cases[0])).reshape(of_values), batch).ravel()
        rows, found = self.problem.stiffness_rows, [np.empty((len(given), *one.shape[1:])) for one in cases]
        places = np.repeat(np.arange(rows.shape[0]), np.diff(rows.indptr)), rows.indices
        for i in np.argsort(case, kind="stable"):  # the weights of one case after the other: its solution is cached
            weight, solution = given[i], self.solution([one[case[i]] for one in cases])
            for name, gradient in zip(self.varied, found, strict=True):
                own = pullback(solution, self.of, weight, name)
                gradient[i] = np.reshape(sp.csr_array(own)[places] if name == "stiffness" else own, gradient[i].shape)
        return tuple(one.reshape(*batch, *one.shape[1:]) for one in found)


def _jax_function(jax: Any, host: _Host) -> Callable[..., Any]:
    """Return a function with a reverse rule, whose solutions are computed outside of JAX for a whole batch."""
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
    """Return a function of tensors in double precision, also for `torch.func.vmap` and `grad`."""

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
