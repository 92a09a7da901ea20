"""Many load cases of one problem: one factorisation, condensed once, every case certified."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from contactqp.analysis.influence import Influence, ProvenForces
from contactqp.analysis.load_cases import STATUS, LoadCases, Solutions
from contactqp.certificate.bounds import REDUNDANT
from contactqp.certificate.number_range import near_one
from contactqp.errors import BackendMissing, ContactQPError, InvalidProblem, Unsupported, counted
from contactqp.linalg.condensation import condense
from contactqp.linalg.iteration import constraints_are_many, contacts_are_many, iterated
from contactqp.linalg.runtime import METHOD, free_memory, one_blas_thread, stage, telling
from contactqp.model.arguments import checked
from contactqp.model.arrays import own_floating_point
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution, Work
from contactqp.solving.methods import DEFAULT_METHOD, registered_name
from contactqp.solving.runs import Meter
from contactqp.solving.solve import solve

# A case pays for so many influence functions, which may take a part of the memory that is free.
PER_CASE, PART_OF_MEMORY = 8, 0.125
# Of fewer unknowns solutions take a millisecond, and are right to the last digit, which forces by functions are not.
FEWEST_UNKNOWNS = 500
# A case may fail in these ways and others go on; what is not installed or not supported is so for all of them.
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

    The stiffness is factorised and condensed once. Without friction, and where nothing floats, the forces of a case
    then take a product with influence functions and a small system, and `force_bound` proves them. What is nearer than
    that to another set of closed contacts is solved by itself, as is all else, from the answer of the case before where
    that is unique: loads that are near to each other should stand next to each other. A case that fails stops no other.

    Parameters
    ----------
    problem : ContactProblem
        What is not given for each case is that of the problem.
    loads : (N, n) array or sparse matrix, optional
        A load for each case [force]. An array of doubles is not copied.
    gaps : (N, m) array, optional
        The initial gaps of each case [length]; infinity is that of a contact that never closes.
    friction : number, (N, 1) or (N, m) array, optional
        One coefficient for all cases, one for each, or one for each contact of each.
    method : str
        As in `solve`.
    progress : callable, optional
        Is called with a few words on what is done now.
    **options
        As in `solve`, but for `warm_start`.

    Returns
    -------
    Solutions
        Forces, gaps, states and verdicts in arrays, the envelope of the forces, and each `Solution` when asked for.

    Raises
    ------
    InvalidProblem
        A wrong shape, or a number that is not finite: the case is named.
    BackendMissing, Unsupported
        The method is not installed, or cannot do this.

    Examples
    --------
    >>> import contactqp as cq
    >>> bar = cq.ContactProblem(stiffness=[[2.0]], load=[0.0], normal=[[1.0]], gap=[1.0])
    >>> many = cq.solve_many(bar, loads=[[1.0], [4.0], [6.0]])
    >>> many.normal_force.ravel(), many.passed.all(), many.envelope().load
    (array([0., 2., 4.]), np.True_, array([2]))
    """
    if "warm_start" in options:
        raise InvalidProblem("solve_many: a case starts from the one before it; expected no warm_start")
    method, cases, started = registered_name(method), LoadCases(problem, loads, gaps, friction), time.perf_counter()
    rows = _Rows(cases)
    with nullcontext() if progress is None else telling(progress):
        if method == DEFAULT_METHOD and not options and cases.count:
            _by_influence(cases, rows)
        _one_by_one(cases, rows, method, options)
    return rows.solutions(cases, method, options, time.perf_counter() - started)


def _by_influence(cases: LoadCases, rows: _Rows) -> None:
    """Solve what is proven by influence functions, where there are cases enough to pay for these."""
    try:
        problem = cases.case(0)
        if not _pays(cases, problem):
            return
        meter = Meter(problem)
        with problem.lock, one_blas_thread(problem), stage(METHOD), meter.running():
            condensation, loaded = condense(problem), cases.loaded()
            size, free = len(loaded) * (problem.contacts + problem.ties) * loaded.itemsize, free_memory()
            if condensation.rigid.count or not len(condensation.schur) or size > PART_OF_MEMORY * (free or np.inf):
                return
            influence = Influence(problem, condensation, loaded)
            if influence.accurate:
                _take_blocks(cases, rows, influence, loaded)
    except ContactQPError:
        return  # `solve` says of each case what there is to say
    route = f"influence functions: {int(rows.answered.sum())} of {counted('case', cases.count)}"
    rows.work = replace(meter.read(0, 0), routes=(route,))


def _pays(cases: LoadCases, problem: ContactProblem) -> bool:
    """Return whether influence functions are offered of a problem, and the cases are enough for their number."""
    rough = problem.frictional or (cases.friction is not None and np.any(cases.friction > 0))
    count = problem.contacts + problem.ties
    if problem.dimension < FEWEST_UNKNOWNS:
        return False
    if rough or not 0 < count <= min(PER_CASE * cases.count, problem.dimension) or problem.has_idle_rows:
        return False
    if iterated(problem) or constraints_are_many(problem) or contacts_are_many(problem):
        return False
    return near_one(problem) is None


def _take_blocks(cases: LoadCases, rows: _Rows, influence: Influence, loaded: Any) -> None:
    """Solve the cases in blocks, each from the closed contacts of the one before it."""
    problem = cases.problem
    closed = np.zeros(problem.contacts, dtype=bool)
    for numbers, loads in cases.blocks(loaded):
        free, sizes = influence.free(loads)
        for place, i in enumerate(numbers):
            at = place % len(free)
            limit = np.concatenate([cases.gap(i), problem.tie_value])
            found = influence.forces(free[at], float(sizes[at]), limit, closed)
            if found is not None:
                rows.take_forces(i, found)
                closed = found.closed


def _one_by_one(cases: LoadCases, rows: _Rows, method: str, options: dict[str, Any]) -> None:
    """Solve each case, from the answer of the one before it where both are unique."""
    before: Solution | None = None
    refused: InvalidProblem | None = None
    for i in np.flatnonzero(~rows.answered).tolist():
        problem = cases.case(i)
        try:
            found = _solved(problem, method, before, options)
        except OF_ALL:
            raise
        except ContactQPError as error:
            refused = error if isinstance(error, InvalidProblem) else refused
            rows.fail(i, error)
            continue
        rows.take(i, found)
        before = found if _is_unique(found) else None
    if refused is not None and not rows.answered.any():
        raise refused  # it is the problem, and no load of it


def _solved(problem: ContactProblem, method: str, before: Solution | None, options: dict[str, Any]) -> Solution:
    """Solve from another answer, or from none where that fails or the answer found is one of several."""
    if before is not None:
        try:
            found = solve(problem, method, warm_start=before, **options)
            if _is_unique(found):
                return found
        except ContactQPError:
            pass  # what it says should not depend on the case before
    return solve(problem, method, **options)


def _is_unique(solution: Solution) -> bool:
    """Return whether nothing speaks for other answers, or for other forces of the same displacement."""
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
        self.passed, self.proven, self.answered = (np.zeros(count, dtype=bool) for _ in range(3))
        self.failures = [""] * count
        self.work = Work()

    def take(self, i: int, found: Solution) -> None:
        """Keep what is asked for of the answer of a case."""
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

    def take_forces(self, i: int, found: ProvenForces) -> None:
        """Keep the proven forces of a case without friction."""
        m = len(found.closed)
        self.normal_force[i], self.tie_force[i], self.gap[i] = found.force[:m], found.force[m:], found.gap
        self.force_bound[i] = found.bound[:m]
        if self.friction_force is not None:
            self.friction_force[i] = 0.0
        self.status[i] = np.where(found.closed, NUMBER["closed"], NUMBER["open"])
        self.passed[i] = self.proven[i] = self.answered[i] = True

    def fail(self, i: int, error: ContactQPError) -> None:
        """Keep why a case has no answer."""
        self.failures[i] = str(error)

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
        )
