"""The active set without condensing, for as many constraints as unknowns, and for singular K as in linear programs.

An interior-point backend identifies the closed contacts, and sparse saddle-point systems with these, refined in
extended precision, give the answer (`contactqp.linalg.sparse_saddle`). If the backend stopped too early to identify
them, Newton steps along the central path, or a linear program to a nearby vertex, continue (`linalg.interior_point`).
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.energy_bounds import contradictory, doubtful, narrow, narrowed, nearer, ran_away
from contactqp.certificate.uniqueness import unique_on
from contactqp.errors import BackendFailed, BackendMissing, NotCertified, NotConverged, Unsupported
from contactqp.linalg import equilibration, existence, least_norm, pardiso
from contactqp.linalg.condensation import condense
from contactqp.linalg.convexity import least_solution
from contactqp.linalg.equilibration import Scaling, balanced, equilibrated, in_range, mostly_bare, nearest_bounds
from contactqp.linalg.extended import SparseRows, extend
from contactqp.linalg.interior_point import remember, solved_from
from contactqp.linalg.iteration import Systems, held_by_hierarchy, iteration, systems_of
from contactqp.linalg.refinement import pushing_contacts
from contactqp.linalg.schur import LARGE, in_narrow_band
from contactqp.linalg.sparse_saddle import SYSTEMS_AT_FIRST, WASTED, WASTED_AT_FIRST, ClosedState, Effort
from contactqp.model.arrays import (
    METHOD,
    Vector,
    all_finite,
    in_any_time,
    on_one_thread,
    one_blas_thread,
    refuse_late,
    stage,
    tell,
    time_is_up,
)
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Candidate, Final, Solution, Work
from contactqp.solving.methods import Method, Settings, find
from contactqp.solving.methods.inexact_active_set import identified_by_iteration, projects_slowly
from contactqp.solving.methods.method import ACTIVE_SET, MODELLING_LANGUAGE, QUADRATIC_PROGRAM
from contactqp.solving.runs import Run, after, described

# Backends that identify the closed contacts, tried in this order, each with its tolerance and whether the problem is
# equilibrated first. Clarabel scales the original problem best, and its factors have the least fill-in with general
# rows; with bounds only, PIQP's factors are those of K, or of the ties where K is diagonal. In narrow bands of
# unknowns with stiffness they are as few, and PIQP identifies contacts at nearly dependent rows, for which Clarabel is
# run twice; its forces on rows that are nearly parallel are less near, which stiffness can tell.
OWN, EQUILIBRATED, BALANCED_UNITS = range(3)
IDENTIFICATIONS = (
    ("clarabel", 1e-9, OWN),
    ("piqp", 1e-11, EQUILIBRATED),
    ("clarabel", 1e-11, EQUILIBRATED),
    ("clarabel", 1e-11, BALANCED_UNITS),
    ("piqp", 1e-11, OWN),
)
OF_FEW_ENTRIES = (("piqp", 1e-9, EQUILIBRATED), *IDENTIFICATIONS)
NEARER = 1e-11  # a tighter tolerance if the first answer does not identify the set
# If its factorisation broke down, Clarabel is run on the equilibrated problem, with more rounds of scaling than its own
# 10, and its answer is refined for this many steps before other backends are tried. The same applies if it stops early
# on a program, or calls it infeasible and `refuse_ray` finds no proof.
BROKE_DOWN, MOST_STEPS, OF_TWINS = "NumericalError", 100, {"equilibrate_max_iter": 50}
# The regularisation that Clarabel adds to the diagonal, 1e-8 by default, hides nearly dependent rows such as
# differences of thousands of unknowns; if its status is "almost solved" it is run again with a smaller one.
ALMOST, OF_NEARLY_DEPENDENT = "AlmostSolved", {"static_regularization_constant": 1e-12}
# From this number of constraints on, a conflict is first searched by Clarabel, in at most this many programs, each from
# the displacement of the one before, as it cannot recognise an overlap below its tolerance.
MANY_ROWS, OVERLAPS, OVERLAPPING = 10_000, 3, 1e-9
INFEASIBLE = "nfeasible"  # in what backends call conflicts (primal infeasible) and unbounded energies (dual infeasible)
# QPALM may crash (segmentation fault) if its factorisation breaks down, as for a floating chain at 1e10 N/m, so it
# solves the equilibrated problem and is not run again after condensed systems have failed.
ENDS_PROCESSES = ("qpalm",)
SYSTEMS_OF_ONE = 1000  # steps of refinement for a method with a single answer
# The search ends at this residual relative to the forces that meet; other constraints balance the rest.
ENOUGH = 1e-18
NEARLY = 1e-5  # unit weights with products E'w below this, and unit motions with products E z, may be a ray
LAST, LONGEST = "highs", 20.0  # its active set finds vertices that interior points do not; its time limit [s]
SPARSE = "sparse"  # the name of this route among others


def has_sparse_systems(method: Method) -> bool:
    """Return whether a method may use sparse systems where there are too many contacts for a dense one."""
    return method.sparse and method.kind in (ACTIVE_SET, QUADRATIC_PROGRAM, MODELLING_LANGUAGE)


class SparseRun(Run):
    """A run on all unknowns and constraints by sparse systems.

    Raises NoEquilibrium: the constraints conflict, or the energy is unbounded; NotConverged: no backend helped.

    Parameters
    ----------
    problem, method, settings : as in `Run`
    given : Candidate, optional, an answer of the method, which is not run again then
    """

    def __init__(
        self, problem: ContactProblem, method: Method, settings: Settings, given: Candidate | None = None
    ) -> None:
        super().__init__(problem, method)
        self._effort = Effort(wasted=WASTED_AT_FIRST, singles=least_norm.DUAL_CHANGES if settings.max_iter else 0)
        self._most = settings.max_iter or equilibration.affordable_systems(problem, sparse=True)
        self._waiting: list[Candidate] = []  # answers from which further changes of the set are possible
        self._twin, self._scaling = equilibrated(problem)
        self._settings, self._looked_for_overlap = settings, False
        self._state: ClosedState | None = None
        self._last: Candidate | None = None  # the last answer examined
        if not in_range(self._twin):
            raise NotConverged(f"{method.name}: the numbers of the problem leave the range of doubles")
        refuse_late(f"{method.name} began")
        with on_one_thread():  # nothing dense here is large
            if given is not None:
                self.candidate = given
            elif method.kind == ACTIVE_SET:
                self.candidate = self._identified(settings.now)
            elif method.name in ENDS_PROCESSES:
                if (start := settings.warm_start) is not None:
                    start = replace(start, answer=self._scaling.scale(start.answer))
                found = method.solve(self._twin, replace(settings.now, warm_start=start))
                self.candidate = self._scaling.unscale(found)
            else:
                self.candidate = method.solve(problem, settings.now)

    def _identified(self, settings: Settings) -> Candidate:
        """Return the answer of `_settled`, or the last one tried when time is up."""
        problem = self.problem
        at_rest = not (problem.load.any() or np.any(problem.gap < 0) or problem.tie_value.any())
        try:
            return self._linear() if at_rest or not problem.contacts else self._settled(settings)
        except NotConverged as error:
            if self._last is None or not time_is_up():
                raise
            return replace(self._last, claimed=False, status=str(error))

    def _settled(self, settings: Settings) -> Candidate:
        """Return the candidate whose closed contacts lead to a solution.

        If many changes of the set lead from one answer to no solution, the next backend is tried first.
        """
        best: Candidate | None = None
        tried, failed = list[str](), list[Candidate]()
        for found in self._candidates(settings, tried):
            before, self._last = self._state, found
            if not found.claimed:
                refuse_ray(self.problem, self._scaling.scale(found.answer))
            state = self._settle(found)
            if before is not None and not (state.holds and nearer(state, before)):
                self._state = before  # the residual is rounding of the data
            elif state.holds:
                best, self._effort.singles = found, least_norm.DUAL_CHANGES  # others need no further changes
            else:
                if self._effort.cut or (not found.claimed and self._effort.wasted < WASTED):
                    self._waiting.append(found)
                if found not in failed:
                    failed.append(found)
                    tried.append(found.status)
                if not found.claimed:
                    self._refuse_overlap()
            if (now := self._state) is None or doubtful(now) or (before is None and contradictory(now)):
                continue
            if now is before or now.force_residual <= ENOUGH or narrow(now):
                break
        if best is None:
            self.refuse_conflict()
            left = (found for found in failed if self._effort.factorisations < self._most)
            best = next((found for found in left if self._settle(found, driven=True).holds), None)
        if best is None:
            raise NotConverged(f"{self.name}: no backend led to closed contacts that hold ({'; '.join(tried)})")
        return best

    def _candidates(self, settings: Settings, tried: list[str]) -> Iterator[Candidate]:
        """Yield the start, if one is given, and then the answers of backends."""
        if settings.warm_start is not None:
            yield replace(settings.warm_start, iterations=0)
        elif (found := _by_iteration(self.problem, settings)) is not None:
            yield found
        backends = OF_FEW_ENTRIES if _leaves_few_entries(self.problem) else IDENTIFICATIONS
        steps, nearly_dependent, program = None, False, mostly_bare(self.problem)
        order = [other for other in backends if program or other[2] != BALANCED_UNITS]
        while order and self._effort.factorisations < self._most:
            name, tolerance, units = order.pop(0)
            refuse_late(f"{name} began")
            tell(f"{name} finds the closed contacts")
            options: dict[str, Any] = {}
            if name == "clarabel":
                options = (OF_TWINS if units != OWN else {}) | (OF_NEARLY_DEPENDENT if nearly_dependent else {})
            twin, scaling = self._twin, self._scaling
            if units == BALANCED_UNITS:
                twin, scaling = balanced(self.problem)
            try:
                method = find(name)
                limit = settings.now.time_limit if method.timed else None  # those without a limit have short steps
                given = Settings(tolerance, steps, limit, None, options)
                found = method.solve(self.problem if units == OWN else twin, given)
            except (BackendFailed, BackendMissing, Unsupported) as error:
                tried.append(str(error))
            else:
                found = found if units == OWN else scaling.unscale(found)
                if ALMOST in found.status and not nearly_dependent:
                    nearly_dependent = True
                    order.insert(0, (name, NEARER, units))
                    self._waiting.append(found)
                    continue
                yield found
                if BROKE_DOWN in found.status or (program and not found.claimed):
                    order.sort(key=lambda other: other[0] != name)
                    self._effort.wasted, steps = WASTED, MOST_STEPS
        if self._effort.factorisations >= self._most:
            tried.append(f"{self._effort.factorisations} systems were solved")
            return
        if self._state is None:
            self._effort.wasted, waiting = WASTED, tuple(self._waiting)
            yield from waiting
        if self._state is None:
            try:
                yield find(LAST).solve(self.problem, Settings(1e-9, None, settings.now.time_limit or LONGEST, None, {}))
            except (BackendFailed, BackendMissing, Unsupported) as error:
                tried.append(str(error))

    def _linear(self) -> Candidate:
        """Solve the linear system that remains without contacts; without load, all of them may be left open."""
        u, normal, tie = (np.zeros(size) for size in (self.problem.dimension, self.problem.contacts, self.problem.ties))
        state = solved_from(self._twin, Answer(u, normal, None, tie), self._effort)
        if not state.holds:
            self.refuse_conflict()
            raise NotConverged(f"{self.name}: the linear system leaves {state.residual:.2g} of what meets")
        self._state = state
        return self._scaling.unscale(_candidate(state, "a linear system"))

    def _settle(self, candidate: Candidate, driven: bool = False) -> ClosedState:
        """Return the state that `solved_from` reaches from a candidate; it is stored if it solves the problem."""
        tell("sparse systems settle the closed contacts")
        hasty = self._effort.wasted < WASTED
        most = self._effort.factorisations + SYSTEMS_AT_FIRST if hasty else np.inf
        self._effort.cut, self._effort.most = False, min(most, self._most)
        answer = replace(self._scaling.scale(candidate.answer), friction_force=None)
        claimed = candidate.claimed or driven or not hasty
        state = narrowed(solved_from(self._twin, answer, self._effort, driven, claimed), self._effort)
        self._state = state if state.holds else None
        return state

    def _ask_again(self) -> None:
        """Run a backend with other tolerance and units if its first answer leads to no solution."""
        options = dict(self._settings.options) or (OF_TWINS if self.name == "clarabel" else {})
        units = [(self._twin, self._scaling)] + [balanced(self.problem)] * mostly_bare(self.problem)
        for twin, scaling in units:
            if self._asked(twin, scaling, options) and self._state is not None and not ran_away(self._state):
                break

    def _asked(self, twin: ContactProblem, scaling: Scaling | None, options: dict[str, Any]) -> bool:
        """Return whether the backend's answer to the problem in these units, or in its own, leads to a solution."""
        refuse_late(f"{self.name} was asked for a nearer answer")
        given = Settings(NEARER, None, self._settings.now.time_limit, None, options)
        try:
            found = self.method.solve(twin, given)
        except BackendFailed:
            return False
        if not (found.claimed or ALMOST in found.status) or not all_finite(found.answer):
            return False
        found = found if scaling is None else scaling.unscale(found)
        spent, self._effort.wasted = self._effort.wasted, WASTED
        if not self._settle(found).holds:
            self._effort.wasted = spent
            return False
        self.candidate = found
        return True

    def final(self) -> Final:
        """Return the answer to be certified, solved on its closed contacts, or that of a backend."""
        if self._state is None and self.polish and self.method.polish and all_finite(self.candidate.answer):
            self._polish_in_time()
        if self._state is None:
            if not self.candidate.claimed and not time_is_up():
                self._refuse_overlap()
            return Final(replace(self.candidate.answer, friction_force=None))
        if least_norm.presses(self._state) and not unique_on(self._state).forces:
            with in_any_time():  # the problem is solved, and this is cheap
                self._state = least_norm.with_least_forces(self._state, self._effort)
        self._state = least_norm.without_needless_forces(self._state)
        return self._at_rest(self._state)

    def _polish_in_time(self) -> None:
        """Refine a backend's answer on its closed contacts, or a more accurate one; keep it when time is up."""
        try:
            if ALMOST in self.candidate.status and not self._settings.max_iter:
                self._asked(self.problem, None, OF_NEARLY_DEPENDENT | dict(self._settings.options))
            if self._state is None:
                self._settle(self.candidate)
            kept = self._state
            wide = kept is None or (mostly_bare(self.problem) and (ran_away(kept) or not narrow(kept)))
            if wide and not self._settings.max_iter:
                self._ask_again()
                self._state = self._state or kept
                if self._state is None and not self.candidate.claimed and INFEASIBLE not in self.candidate.status:
                    self._effort.wasted = WASTED  # no other answer is available
                    self._settle(self.candidate)
        except NotConverged:
            if not time_is_up():
                raise

    def _at_rest(self, state: ClosedState) -> Final:
        """Return the answer of a state; what lies along free motions is left out if the rest still solves a program."""
        problem, final = self.problem, self._final_of(state)
        pushing = pushing_contacts(problem, final.answer)
        resisting = np.isin(np.arange(problem.contacts), pushing)
        held = state if np.array_equal(resisting, state.closed) else replace(state, closed=resisting)
        if unique_on(held).displacement:
            return final  # nothing is free, and a search would not count in the time to the answer
        unit = self._scaling.length * self._scaling.unknowns
        condensed = condense(problem) if systems_of(problem) is Systems.CONDENSED else None  # the certificate has it
        resting, free = least_norm.at_rest(problem, condensed, (state, final.answer), pushing, unit)
        if mostly_bare(problem) and not (resting.holds and (narrow(resting) or not narrow(state))):
            return final
        return replace(self._final_of(resting), free_motions=described(problem, free))

    def _final_of(self, state: ClosedState) -> Final:
        remember(state, (given := _candidate(state)).answer)
        return Final(self._scaling.unscale(given).answer, polished=True)

    def work(self, corrections: int) -> Work:
        """Return the work so far, without factorisations inside the backend."""
        return Work(
            factorisations=self._effort.factorisations,
            back_substitutions=self._effort.back_substitutions,
            iterations=self.candidate.iterations,
            retained=self.problem.dimension,
            polish_corrections=corrections,
            solver="pardiso" if self.problem.dimension > LARGE and pardiso.available() else "superlu",
        )

    def refuse_conflict(self) -> None:
        """Raise NoEquilibrium if the constraints conflict or the energy is unbounded below."""
        if self._state is None:  # else it satisfies all constraints to rounding of the largest length
            self._refuse_overlap()
            existence.refuse_sparse_conflict(self.problem)
        if self._state is None or mostly_bare(self.problem):
            left = None if self._state is None else self._state.left.force.double()
            existence.refuse_sparse_drive(self.problem, left)

    def _refuse_overlap(self) -> None:
        """Raise NoEquilibrium if the displacement with the least violation of the constraints proves their conflict.

        It minimises |r|^2 / 2 with E u - r <= g, A u - r = b, rows being of unit length, and its r are Farkas' weights.
        With thousands of constraints this takes a tenth of the time of a linear program, which names fewer rows. A
        small overlap is scaled to size one, starting from the previous displacement.
        """
        twin, m = self._twin, self.problem.contacts
        if self._looked_for_overlap or m + twin.ties < MANY_ROWS:
            return
        self._looked_for_overlap = True
        rows = sp.vstack([twin.normal, twin.tie], format="csr")
        lengths = np.sqrt(np.asarray(rows.multiply(rows).sum(axis=1)).ravel())
        lengths[lengths == 0] = 1.0
        rows, limit = sp.diags(1.0 / lengths) @ rows, np.concatenate([twin.gap, twin.tie_value]) / lengths
        count, n = rows.shape
        overlapping = sp.hstack([rows, -sp.identity(count)], format="csr")
        squares = sp.diags(np.repeat([0.0, 1.0], [n, count]), format="csr")
        u = np.zeros(n)
        for _ in range(OVERLAPS):
            left = limit - rows @ u
            missing = abs(np.concatenate([np.minimum(left[:m], 0.0), left[m:]]))
            size = float(np.max(missing, initial=0.0))
            if not size > OVERLAPPING:
                return
            left = np.minimum(left / size, existence.IDLE_SLACK)
            of_ties = {"tie": overlapping[m:], "tie_value": left[m:]}
            looser = ContactProblem(squares, np.zeros(n + count), overlapping[:m], left[:m], **of_ties)
            try:
                found = find("clarabel").solve(looser, Settings(OVERLAPPING, MOST_STEPS, self._settings.now.time_limit))
            except (BackendFailed, BackendMissing, Unsupported):
                return
            weights = np.concatenate([found.answer.normal_force, found.answer.tie_force]) / lengths
            refuse_ray(self.problem, Answer(np.zeros(n), weights[:m], None, weights[m:]))
            u = u + size * found.answer.displacement[:n]


def by_sparse_systems(
    problem: ContactProblem, method: Method, settings: Settings, error: NotCertified | NotConverged
) -> Solution:
    """Return the certified solution by sparse systems after condensed ones have failed.

    Methods that need dense matrices, or may crash, are not run again; the systems start from their answer. Raises
    `error` if there is none, if it leads to no solution, and with friction.

    Parameters
    ----------
    problem, method, settings : as in `Run`
    error : the error that the condensed systems raised
    """
    found, given = error.solution, None
    if problem.frictional or method.kind not in (QUADRATIC_PROGRAM, MODELLING_LANGUAGE):
        raise error
    if not has_sparse_systems(method) or method.name in ENDS_PROCESSES:
        if not isinstance(found, Solution):
            raise error
        given = Candidate(found.answer if found.raw is None else found.raw.answer)
        settings = replace(settings, max_iter=SYSTEMS_OF_ONE)
    started = time.perf_counter()
    try:
        with problem._lock, one_blas_thread(problem), stage(METHOD):
            run = SparseRun(problem, method, settings, given)
        run.seconds = time.perf_counter() - started
        return after(error, SPARSE, run.finish())
    except (BackendFailed, NotCertified, NotConverged):
        raise error from None


def _by_iteration(problem: ContactProblem, settings: Settings) -> Candidate | None:
    """Return the answer of the inexact active set if a multigrid hierarchy suits K (supported bodies, membranes)."""
    slowly = problem.dimension < LARGE or _separate(problem) or projects_slowly(problem)
    if slowly or not held_by_hierarchy(problem):
        return None
    return identified_by_iteration(problem, iteration(problem), settings)


def _leaves_few_entries(problem: ContactProblem) -> bool:
    """Return whether PIQP's factors have as few entries as K, as the ties of a diagonal K, or as a narrow band."""
    several = np.diff(problem.normal.indptr) > 1
    if not several.any() and (not problem.ties or _separate(problem)):
        return True
    rows = sp.vstack([problem.normal[np.flatnonzero(several)], problem.tie], format="csr")
    return bool(problem.diagonal.all()) and in_narrow_band(problem.stiffness_rows, rows)


def _separate(problem: ContactProblem) -> bool:
    """Return whether K is diagonal and positive, so that only ties couple the unknowns."""
    return problem.stiffness_rows.nnz == problem.dimension and bool(problem.diagonal.all())


def _candidate(state: ClosedState, status: str = "") -> Candidate:
    """Return the answer of a state in doubles, with forces of rounding size set to zero."""
    answer = state.answer.double()
    force = answer.normal_force.clip(min=0.0)
    return Candidate(Answer(answer.displacement, force, None, answer.tie_force), status=status)


def refuse_ray(problem: ContactProblem, diverged: Answer) -> None:
    """Raise NoEquilibrium if the diverged answer of a backend is a ray that proves it.

    If constraints conflict, the forces diverge along Farkas' weights, and if the energy is unbounded, displacements
    diverge along a motion that nothing resists. The rounding error of the ray is corrected by other rows, bounds of
    unknowns first, and the result is checked in extended precision. `diverged` is equilibrated.
    """
    if not all_finite(diverged):
        return
    twin, scaling = equilibrated(problem)
    weights = _farkas(twin, np.maximum(diverged.normal_force, 0.0), diverged.tie_force)
    if weights is not None:
        units = np.concatenate([scaling.contacts, scaling.ties])
        existence.refuse_proven(problem, existence.conflict_of(problem, scaling.unknowns, weights / units))
    largest = float(np.max(abs(diverged.displacement), initial=0.0))
    if largest > 0:
        motion = diverged.displacement / largest
        if twin.load @ motion > existence.DRIVEN * (abs(twin.load) @ abs(motion)) and _rests(twin, motion):
            existence.refuse_drive_along(problem, motion, strictly=True)


def _rests(problem: ContactProblem, motion: Vector) -> bool:
    """Return whether the resistance to a motion is within a backend's tolerance."""
    felt = (abs(problem.stiffness_rows @ motion), np.maximum(problem.normal @ motion, 0.0), abs(problem.tie @ motion))
    return all(float(np.max(part, initial=0.0)) <= NEARLY for part in felt)


def _farkas(problem: ContactProblem, normal: Vector, tie: Vector) -> Vector | None:
    """Return Farkas' weights (m + k,) near these, with which the rows nearly cancel and overlap, else None."""
    limit = np.concatenate([problem.gap, problem.tie_value])
    rows = sp.csr_matrix(sp.vstack([problem.normal, problem.tie]))
    weights = np.concatenate([normal, tie])
    size = float(np.max(abs(weights), initial=0.0))
    if not size > 0:
        return None
    weights = np.where(abs(weights) > existence.NO_PART * size, weights / size, 0.0)
    if np.max(abs(rows.T @ weights), initial=0.0) > NEARLY or not -(limit @ weights) > 0:
        return None
    across, bounds = SparseRows(rows.T.tocsr()), nearest_bounds(problem)
    for passed in range(existence.PROJECTIONS):
        left = (across @ extend(weights)).double()
        taken = np.where(left > 0, bounds[0], np.where(left < 0, bounds[1], np.minimum(*bounds)))
        part = sp.csc_matrix(sp.diags(abs(weights)) @ rows).T
        part.eliminate_zeros()
        entries = np.diff(part.indptr)
        kept = np.flatnonzero((entries > 1) if passed else (taken < 0) & (entries > 0))
        if not np.any(left[kept]):
            break
        try:
            weights = weights * (1.0 - np.sign(weights) * least_solution(part[kept], left[kept]))
        except BackendFailed:
            return None
    left = (across @ extend(weights)).double()
    taken = np.where(left > 0, bounds[0], bounds[1])
    on = np.flatnonzero((left != 0) & (taken >= 0))
    entries = abs(problem.normal.data[problem.normal.indptr[taken[on]]])
    np.add.at(weights, taken[on], abs(left[on]) / entries)
    return None if np.any(weights[: problem.contacts] < 0) else weights
