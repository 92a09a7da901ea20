"""Many load cases of one problem: one factorisation, condensed once, every case certified.

Where cases are many, influence functions turn each into a product with the loads and a small system. Let B = [E; A] be
the rows of contacts and ties and Y = K^-1 B' their influence functions, the displacements under unit forces along them.
With W = B Y the forces l of a load f within the limits c = (g, b) are, on closed contacts and ties C,

    W_CC l_C = (Y'f - c)_C,    and the gaps of the other contacts    (c - Y'f + W l)_i,

in which no unknown but those of contacts appears. Rows are scaled so that W_ii = 1, and lengths and forces with them.

Every answer is proven. The forces computed for C solve a system whose right-hand side is off by their residual r and
by e, the error of Y'f, of W and of the products with them. With V = W_CC^-1 the forces l* of the answer on C satisfy

    |l - l*| <= |V| (|r| + e),    |gap_i - gap_i*| <= e_i + |W_iC| |V| (|r| + e),

and where forces are positive and gaps open by more than these bounds, l* meets the conditions of Karush, Kuhn and
Tucker: K being positive definite, it is the solution. A case that is nearer to another set, or less accurate than an
answer has to be, is left to `solve`.

Where the least eigenvalue w of W for all contacts and ties tells enough, |V| x is not formed: the eigenvalues of W_CC
are not less, so that no entry of V x exceeds |x|/w.

The influence functions are corrected once, by residuals with digits beyond double precision (`linalg.sliced`). The size
q of the correction, relative to the functions, tells that of what is left, q^2, and ALLOWANCE times as much is counted,
as it is in certificates. A product of vectors, added up in parts of p numbers and these in groups of p, is off by at
most (2 p + number of groups) eps/2 of the sum of its terms' sizes.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.analysis.load_cases import STATUS, LoadCases, Solutions
from contactqp.certificate.bounds import REDUNDANT
from contactqp.certificate.number_range import near_one
from contactqp.errors import BackendMissing, ContactQPError, InvalidProblem, Unsupported, counted
from contactqp.linalg.condensation import Condensation, condense
from contactqp.linalg.dense import lower_factor
from contactqp.linalg.iteration import Systems, systems_of
from contactqp.linalg.runtime import free_memory, lapack
from contactqp.linalg.sliced import LEFT_OUT, SlicedStiffness
from contactqp.model.arguments import checked
from contactqp.model.arrays import (
    METHOD,
    Array,
    Indices,
    Mask,
    Vector,
    one_blas_thread,
    own_floating_point,
    stage,
    telling,
)
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution, Work
from contactqp.solving.methods import DEFAULT_METHOD, registered_name
from contactqp.solving.runs import Meter
from contactqp.solving.solve import solve

EPS = float(np.finfo(float).eps)
# What corrections of influence functions tell of their errors is counted so many times; corrections larger than a part
# of the functions tell nothing.
ALLOWANCE, LARGEST_CORRECTION = 1e4, 1e-6
# Influence functions at once: factors are read once for all of them, and some fifteen arrays of their size are there
# for a while, which should not take more than all functions at the loaded unknowns, unless that is next to nothing.
FEWEST, MOST, ARRAYS = 6, 32, 15
# Terms of a product that are added up by themselves.
PART = 64
# Corrections of the set of closed contacts for one load, at most, and sets whose systems are kept.
MOST_SETS, KEPT = 50, 16
# Forces are proven to this part of the largest, gaps to this part of the largest length, or left to `solve`; so is what
# is nearer than `GRAZING` of these to another set of closed contacts.
PROVEN, GRAZING = 1e-7, 1e-8
# Lengths, scaled, whose products neither underflow nor overflow.
SMALLEST, LARGEST = 1e-100, 1e100
# An inverse is known to be near where what is missing of it is less than this.
NEAR = 0.1


@dataclass(frozen=True, eq=False)
class ProvenForces:
    """The answer of one load case on its contacts and, behind these, its ties."""

    force: Vector  # (m + k,)
    bound: Vector  # (m + k,) of the error of each force
    gap: Vector  # (m,)
    closed: Mask  # (m,)


class Influence:
    """The influence functions of the contacts and ties of a problem that does not float, at the loaded unknowns."""

    def __init__(self, problem: ContactProblem, condensation: Condensation, loaded: Indices) -> None:
        operator = condensation.delassus
        stiffness = SlicedStiffness(problem.stiffness_rows, condensation.unknown_scale)
        self._scale, self._contacts = operator.row_scale, problem.contacts
        rows = sp.csr_array(sp.diags(self._scale) @ sp.vstack([problem.normal, problem.tie]))
        unit, count = condensation.unknown_scale, len(self._scale)
        self._functions, W, largest = np.empty((len(loaded), count)), np.empty((count, count)), np.empty(count)
        correction = 0.0
        at_once = min(MOST, max(FEWEST, count * len(loaded) // (ARRAYS * len(unit))))
        for start in range(0, count, at_once):
            of = slice(start, start + at_once)
            Y = condensation.responses(condensation.scale[:, None] * operator.response[:, of])
            change = condensation.free_displacements(stiffness.residual(rows[of].T.toarray(), Y))
            Y += change
            self._functions[:, of], W[:, of] = Y[loaded], rows @ Y
            largest[of] = np.max(abs(Y) / unit[:, None], axis=0)
            correction = max(correction, float(np.max(abs(change) / (unit[:, None] * largest[of]))))
        self.accurate = bool(correction <= LARGEST_CORRECTION and np.all(np.isfinite(largest)))
        self._W = (W + W.T) / 2
        # Errors of Y'f are this times D'|f|; those of W_ij the product of row i's and column j's.
        refined = EPS + ALLOWANCE * correction**2 + stiffness.longest * LEFT_OUT / EPS * correction
        terms, longest = 2 * PART + len(loaded) // PART**2 + 2, int(np.max(np.diff(rows.indptr), initial=0))
        self._unit, self._of_load = unit[loaded], (refined + EPS / 2 * terms) * largest
        self._of_column, self._of_row = (refined + EPS * longest) * largest, abs(rows) @ unit
        self._least_eigenvalue = self._bounded_eigenvalue()
        self._systems: dict[bytes, _System | None] = {}

    def free(self, loads: Any) -> tuple[Array, Vector]:
        """Return Y'f, scaled (q, m + k), of loads at the loaded unknowns (q, loaded), and the size D'|f| of each."""
        found = np.zeros((loads.shape[0], len(self._scale)))
        for first in range(0, len(self._unit), PART**2):
            group = np.zeros_like(found)
            for start in range(first, min(first + PART**2, len(self._unit)), PART):
                group += loads[:, start : start + PART] @ self._functions[start : start + PART]
            found += group
        return found, np.asarray(abs(loads) @ self._unit)

    def forces(self, free: Vector, size: float, limit: Vector, closed: Mask) -> ProvenForces | None:
        """Return the proven forces of a load, or None where it is left to `solve`.

        Parameters
        ----------
        free, size : (m + k,) array and float
            What `free` returns of the load.
        limit : (m + k,) array
            Gaps and tie values.
        closed : (m,) array
            The contacts to begin with.
        """
        m, length = self._contacts, self._scale * limit
        found = self._on_own_set(free - length, closed)
        if found is None:
            return None
        system, force, slack = found
        members, pushing, terms = system.members, abs(force), abs(free) + abs(length)
        error = self._of_load * size + EPS * (len(members) + 4) * (terms + pushing.sum())
        error += self._of_row * (self._of_column[members] @ pushing)
        error += self._of_column * (self._of_row[members] @ pushing)
        off = abs(slack[members]) + error[members]
        on = np.zeros(m, dtype=bool)
        on[members[members < m]] = True
        largest = max(float(terms.max(initial=0.0)), float(pushing.max(initial=0.0)))
        if not SMALLEST < largest < LARGEST:
            return None
        bound = np.full(len(members), np.linalg.norm(off) / self._least_eigenvalue)
        if bound.max(initial=0.0) > PROVEN * pushing.max(initial=0.0):
            bound = system.bounded(off)
        of_gap = error + abs(self._W[:, members]) @ bound
        pushes = force[: on.sum()] > np.maximum(bound[: on.sum()], GRAZING * largest)
        opens = slack[:m][~on] > np.maximum(of_gap[:m], GRAZING * largest)[~on]
        accurate = bound.max(initial=0.0) <= PROVEN * pushing.max(initial=0.0) and of_gap.max() <= PROVEN * largest
        if not (pushes.all() and opens.all() and accurate):
            return None
        forces, bounds = np.zeros(len(free)), np.zeros(len(free))
        forces[members], bounds[members] = force, bound
        gap = np.where(on, 0.0, slack[:m] / self._scale[:m])
        return ProvenForces(forces * self._scale, bounds * self._scale, gap, on)

    def _bounded_eigenvalue(self) -> float:
        """Return a number that no eigenvalue of the true W is less than, next to nothing where none is known."""
        from scipy.linalg import eigvalsh

        values = eigvalsh(self._W, check_finite=False) if self.accurate else np.zeros(1)
        rounding = 8 * len(self._W) * EPS * values[-1]  # of LAPACK's eigenvalues, and of W's two halves
        missing = 2 * np.linalg.norm(self._of_row) * np.linalg.norm(self._of_column)
        return max(float(values[0] - rounding - missing), float(np.finfo(float).tiny))

    def _on_own_set(self, excess: Vector, closed: Mask) -> tuple[_System, Vector, Vector] | None:
        """Return the system of the contacts that a load closes, their forces and all gaps, scaled."""
        m = self._contacts
        for _ in range(MOST_SETS):
            system = self._system(closed)
            if system is None:
                return None
            force = system.solve(excess[system.members])
            slack = self._W[:, system.members] @ force - excess
            signs = slack[:m] < 0
            signs[closed] = force[: np.count_nonzero(closed)] > 0
            if np.array_equal(signs, closed):
                return system, force, slack
            closed = signs
        return None

    def _system(self, closed: Mask) -> _System | None:
        """Return the system of a set of closed contacts and the ties; None where their rows are dependent."""
        key = closed.tobytes()
        if key not in self._systems:
            if len(self._systems) >= KEPT:
                self._systems.pop(next(iter(self._systems)))
            ties = np.arange(self._contacts, len(self._scale))
            members = np.concatenate([np.flatnonzero(closed), ties])
            W = self._W[np.ix_(members, members)]
            factor = lower_factor(W)
            of_entries = self._of_row[members], self._of_column[members]
            self._systems[key] = None if factor is None else _System(members, W, factor, *of_entries)
        return self._systems[key]


class _System:
    """W_CC of a set of closed contacts and ties, factorised."""

    def __init__(self, members: Indices, W: Array, factor: Array, of_row: Vector, of_column: Vector) -> None:
        self.members, self._W, self._factor = members, W, factor
        self._of_row, self._of_column = of_row, of_column

    def solve(self, right: Vector) -> Vector:
        return np.asarray(lapack().dpotrs(self._factor, right, lower=True)[0]) if len(right) else right

    def bounded(self, size: Vector) -> Vector:
        """Return bounds of W_CC^-1 x for all |x| <= size, infinite where the inverse is not known."""
        sizes, missing = self._inverse
        if not missing < NEAR:
            return np.full(len(size), np.inf)
        found = sizes @ size
        return np.asarray(found + missing / (1 - missing) * found.max(initial=0.0))

    @cached_property
    def _inverse(self) -> tuple[Any, float]:
        """|V| of the inverse in doubles and q >= |I - V W|, the errors of W included."""
        count = len(self.members)
        if not count:
            return np.zeros((0, 0)), 0.0
        V = np.asarray(lapack().dpotrs(self._factor, np.eye(count), lower=True)[0])
        sizes = abs(V)
        missing = abs(np.eye(count) - V @ self._W).sum(axis=1) + EPS * count * (sizes @ abs(self._W)).sum(axis=1)
        missing += (sizes @ self._of_row) * self._of_column.sum() + (sizes @ self._of_column) * self._of_row.sum()
        return sizes, float(missing.max())


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
    if systems_of(problem) is not Systems.CONDENSED:
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
    """Return whether there is no sign of other answers, or of other forces with the same displacement."""
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
