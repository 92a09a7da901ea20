"""Run a method on a problem: pose the problem to it, then polish and certify its answer.

A run keeps the method's candidate, in the unknowns of the posed problem, and counts its work. The table
`contactqp.solving.solve.RUN_RULES` chooses the class of run for a problem.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.certificate import certificate_of, compute_certificate
from contactqp.certificate.figures import contact_status
from contactqp.errors import BackendFailed, NotCertified, NotConverged, Unsupported
from contactqp.linalg.condensation import Condensation, condense
from contactqp.linalg.condensation import condense as condensation_of
from contactqp.linalg.dense import DENSE_SIZE, saddle_point, unknown_scale
from contactqp.linalg.equilibration import nondimensional
from contactqp.linalg.existence import refuse_conflict, refuse_driven_motion
from contactqp.linalg.iteration import Iteration, iterated, iteration
from contactqp.linalg.least_norm import WITHIN_ROUNDING, shift_to_least_norm
from contactqp.linalg.measures import lay_out, longest_stated, row_sizes
from contactqp.linalg.refinement import closed_contacts, least_displacement, polish, pushing_contacts, without_noise
from contactqp.linalg.schur import LARGE
from contactqp.model.arrays import (
    INVISIBLE,
    POLISH,
    Array,
    Vector,
    all_finite,
    on_one_thread,
    one_blas_thread,
    own_floating_point,
    refuse_late,
    stage,
    time_is_up,
    unfinished,
    zero_beneath,
)
from contactqp.model.names import along_axes, describe_motion
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Candidate, Final, FreeMotion, Raw, Solution, Work
from contactqp.solving.methods import FEW_ROWS, Method, Settings, refuse_too_dense
from contactqp.solving.methods.inexact_active_set import solve_by_iteration
from contactqp.solving.methods.method import ACTIVE_SET, CLASSICAL_ENFORCEMENT
from contactqp.solving.methods.textbook_algebra import with_idle_motions_held


class Meter:
    """Counts the work of one answer, including the condensation if it is not cached."""

    def __init__(self, problem: ContactProblem) -> None:
        self.problem = problem
        self._factorisations = self._back_substitutions = 0

    @contextmanager
    def running(self) -> Iterator[None]:
        factorisations, back_substitutions = self._counts()
        yield
        now = self._counts()
        self._factorisations += now[0] - factorisations
        self._back_substitutions += now[1] - back_substitutions

    def _counts(self) -> tuple[int, int]:
        cached: Condensation | None = self.problem._computed.condensation
        return (cached.factorisations, cached.back_substitutions) if cached else (0, 0)

    def read(self, iterations: int | None, corrections: int) -> Work:
        condensation: Condensation = self.problem._computed.condensation or condense(self.problem)
        interior = self.problem.dimension - len(condensation.retained)
        return Work(
            factorisations=self._factorisations,
            back_substitutions=self._back_substitutions,
            iterations=iterations,
            retained=len(condensation.retained),
            polish_corrections=corrections,
            solver="dense" if condensation.solver == "superlu" and interior <= DENSE_SIZE else condensation.solver,
        )


class Run(ABC):
    """One method on one problem; `finish` polishes and certifies its candidate.

    Attributes
    ----------
    name, exact : str, bool
        The name of the method in the answer, and whether it promises the exact answer; with friction, those of the
        algorithm that uses the method.
    candidate : Candidate
        The answer of the method, in the unknowns of the posed problem.
    polish : bool
        Whether `finish` solves again, to the last digits, on the method's set of closed contacts.
    seconds : float
        Spent before `finish`.
    """

    candidate: Candidate

    def __init__(self, problem: ContactProblem, method: Method) -> None:
        self.problem, self.method, self.meter = problem, method, Meter(problem)
        self.name, self.exact = method.name, method.exact
        self.polish, self.seconds = True, 0.0

    @property
    def expanded(self) -> Candidate:
        """Return the candidate in the unknowns of the problem."""
        return self.candidate

    @property
    def start(self) -> Candidate:
        """Return the start for another load, in the problem's unknowns; exact only if the method was shown those."""
        return self.candidate

    @abstractmethod
    def final(self) -> Final:
        """Return the answer that is to be certified."""

    def work(self, corrections: int) -> Work:
        """Return what the answer has cost so far."""
        return self.meter.read(self.candidate.iterations, corrections)

    def refuse_conflict(self) -> None:
        """Raise NoEquilibrium if the constraints conflict."""
        refuse_conflict(self.problem, condense(self.problem))

    @own_floating_point
    def finish(self) -> Solution:
        """Return the answer, polished where the method's answers are, with its certificate.

        Raises
        ------
        NoEquilibrium, NotConverged, NotCertified
            As `solve`.
        """
        started = time.perf_counter() - self.seconds
        with self.problem._lock, one_blas_thread(self.problem), stage(POLISH):
            return self._accepted(*self._certified(started))

    def seconds_to_answer(self) -> float:
        """Polish as `finish` does, and return the seconds of method and polishing, without certifying."""
        started = time.perf_counter() - self.seconds
        with self.problem._lock, one_blas_thread(self.problem), stage(POLISH), self.meter.running():
            self.final()
            return time.perf_counter() - started

    def _accepted(self, solution: Solution, polished: bool) -> Solution:
        """Return the solution, or raise if the method did not converge or the certificate refuses an exact method."""
        candidate, name = self.candidate, self.name
        if not polished and not candidate.claimed:
            if not time_is_up():
                self.refuse_conflict()
            reason = candidate.status or "it stopped before it had an answer"
            count = "" if candidate.iterations is None else f" (after {candidate.iterations} iterations)"
            raise NotConverged(f"{name}: {reason.removeprefix(f'{name}: ')}{count}", candidate.history, solution)
        if self.exact and not solution.certificate.passed:
            self.refuse_conflict()
            failures = "; ".join(solution.certificate.failures)
            raise NotCertified(f"{name}: the certificate refuses the answer: {failures}", solution)
        if self.exact and _unmet(self.problem, solution):
            self.refuse_conflict()  # violations below the tolerance may be a conflict of constraints
        return solution

    def _certified(self, started: float) -> tuple[Solution, bool]:
        """Return the certified solution, and whether it is polished."""
        problem, candidate = self.problem, self.candidate
        with self.meter.running():
            final = self.final()
            answer = final.answer
            if answer.friction_force is None and problem.slip_origin is not None:
                answer = replace(answer, friction_force=np.zeros_like(problem.slip_origin))
            answered = time.perf_counter()
            with nullcontext() if final.polished or candidate.claimed or not time_is_up() else unfinished():
                certificate = certificate_of(problem, answer)
            certified = time.perf_counter()
            # The active-set method has no raw answer, as refinement is part of it.
            raw = self._raw(answer.friction_force) if final.polished and self.method.kind != ACTIVE_SET else None
        status = contact_status(problem, certificate) if final.contact_status is None else final.contact_status
        solution = Solution(
            problem=problem,
            answer=answer,
            contact_status=status,
            free_motions=final.free_motions,
            certificate=certificate,
            method=self.name,
            seconds=certified - started,
            certify_seconds=certified - answered,
            work=self.work(final.corrections),
            raw=raw,
            history=candidate.history,
        )
        return solution, final.polished

    def _raw(self, friction: Any) -> Raw:
        candidate = self.expanded
        answer = replace(candidate.answer, friction_force=friction)
        return Raw(self.problem, answer, candidate.claimed, candidate.status, judge=compute_certificate)


def after(error: NotCertified | NotConverged, how: str, found: Solution) -> Solution:
    """Return the solution of a later attempt with message and work of the failed one added."""
    spent = first.work if isinstance(first := error.solution, Solution) else Work()
    return replace(found, work=replace(found.work.after(spent), routes=(str(error), f"{how}: its answer is certified")))


def _unmet(problem: ContactProblem, solution: Solution) -> bool:
    """Return whether an answer penetrates or misses ties by more than rounding of the lengths that meet."""
    u, found = solution.answer.displacement, solution.certificate.violations
    apart = found is not None and bool((found.gap >= 0).all())  # in twice double precision
    for rows, limit, signed in ((problem.normal, problem.gap, True), (problem.tie, problem.tie_value, False)):
        if not limit.size or (signed and apart):
            continue
        beyond = rows @ u - limit
        meeting = row_sizes(problem, rows).lengths(abs(u)) + abs(limit)
        if np.any((beyond if signed else abs(beyond)) > WITHIN_ROUNDING * meeting):
            return True
    return False


class CondensedRun(Run):
    """The method on the contact unknowns, or on all if condensing is switched off or reduces nothing.

    Raises NoEquilibrium, NotConverged, BackendFailed, Unsupported as `solve` does; Unsupported too where the dense
    matrices are predicted to be too large.

    Parameters
    ----------
    problem, method, settings : ContactProblem, Method, Settings
    condense : bool or "auto", as in `solve`
    """

    def __init__(self, problem: ContactProblem, method: Method, settings: Settings, condense: bool | str) -> None:
        super().__init__(problem, method)
        if problem.contacts + problem.ties > FEW_ROWS or problem.dimension > LARGE:
            refuse_too_dense(problem, method, condense)
        with self.meter.running():
            self._condensation = _condensed(problem)
            refuse_late(f"{method.name} began")
            if self._condensation.rigid.count:
                refuse_driven_motion(problem, self._condensation.rigid)
            if not method.semidefinite and saddle_point(self._condensation, np.zeros(0, dtype=np.intp)).free.shape[1]:
                raise Unsupported(
                    f"{method.name}: bodies held by contact alone (the stiffness is singular); try active-set"
                )
            try:
                self._whole, self.candidate = self._run(settings.now if settings.time_limit else settings, condense)
            except (NotConverged, BackendFailed):
                self.refuse_conflict()
                raise

    def final(self) -> Final:
        """Return the answer to be certified, refined on its set if `polish` is set."""
        found = self._polished() if self.polish and self.method.polish else None
        return self._as_it_came() if found is None else found

    @cached_property
    def expanded(self) -> Candidate:
        """Return the candidate in the unknowns of the problem, by a back-substitution."""
        if self._whole:
            return self.candidate
        _, inner = self._condensation.reduce_load(self.problem.load)
        answer = self.candidate.answer
        whole = replace(answer, displacement=self._condensation.expand(answer.displacement, inner))
        return replace(self.candidate, answer=whole)

    @property
    def start(self) -> Candidate:
        """Return the start for another load, in the problem's unknowns; exact only if the method was shown those."""
        if self._whole:
            return self.candidate
        displacement = np.zeros(self.problem.dimension)
        displacement[self._condensation.retained] = self.candidate.answer.displacement
        return replace(self.candidate, answer=replace(self.candidate.answer, displacement=displacement))

    def work(self, corrections: int) -> Work:
        """Return the work so far, with the number of unknowns of the posed problem."""
        spent = super().work(corrections)
        if self._whole and self.method.kind != ACTIVE_SET:
            return replace(spent, retained=self.problem.dimension)
        return spent

    def _run(self, settings: Settings, wanted: bool | str) -> tuple[bool, Candidate]:
        """Run the method; return whether it was posed all unknowns, and its candidate."""
        problem, condensation, method = self.problem, self._condensation, self.method
        # Condensation fixes motions that nothing drives or resists, so with these "auto" condenses even without
        # interior unknowns.
        smaller = len(condensation.retained) < problem.dimension or condensation.rigid.count > 0
        bare = not problem.contacts and not problem.ties
        if not bare and not (smaller if wanted == "auto" else wanted):
            if method.kind == CLASSICAL_ENFORCEMENT and condensation.rigid.count:
                problem = with_idle_motions_held(problem, condensation)
            return True, _run_scaled(problem, method, settings)
        if settings.warm_start is not None:
            start = settings.warm_start.answer
            start = replace(start, displacement=start.displacement[condensation.retained])
            settings = replace(settings, warm_start=replace(settings.warm_start, answer=start))
        if method.solve_condensed is not None and not bare:
            return False, method.solve_condensed(problem, condensation, settings)
        load, inner = condensation.reduce_load(problem.load)
        if bare:
            return False, _linear(condensation, load)
        return False, _run_scaled(condensation.reduced_problem(problem, load, inner), method, settings)

    def _polished(self) -> Final | None:
        """Return the refined answer on the candidate's contact set, None if its signs are wrong or the time is up."""
        problem, condensation, found = self.problem, self._condensation, self.candidate.answer
        if not all_finite(found):
            return None
        u = found.displacement
        if not self._whole:
            u = np.zeros(problem.dimension)
            u[condensation.retained] = found.displacement
        compliance = condensation.delassus.compliance[: problem.contacts]
        closed = closed_contacts(problem, compliance, u, found.normal_force)
        try:
            answer, corrections, holds = polish(problem, condensation, closed, self.method.corrections)
        except NotConverged as late:
            self.candidate = replace(self.candidate, claimed=False, status=str(late))
            return None
        if not holds:
            return None
        answer, free = least_displacement(problem, condensation, answer)
        motions = described(problem, free) if free.size else ()
        return Final(without_noise(problem, condensation, answer), motions, corrections, polished=True)

    def _as_it_came(self) -> Final:
        """Return the candidate of the method without components along free motions."""
        answer = replace(self.expanded.answer, friction_force=None)
        if not all_finite(answer):
            return Final(answer)
        closed = pushing_contacts(self.problem, answer)
        shift, free = shift_to_least_norm(self.problem, self._condensation, answer, closed)
        answer = replace(answer, displacement=answer.displacement + shift)
        return Final(answer, described(self.problem, free))


def described(problem: ContactProblem, free: Array) -> tuple[FreeMotion, ...]:
    """Return the columns of a basis (n, q) as motions, described in words, whose largest component is one."""
    aligned = along_axes(problem, free) if free.size else free
    directions = (direction / direction[np.argmax(abs(direction))] for direction in aligned.T)
    return tuple(FreeMotion(direction, describe_motion(problem, direction)) for direction in directions)


def _condensed(problem: ContactProblem) -> Condensation:
    """Condense a problem; for a large one, a second thread prepares data of refinement and certificate."""
    if problem.dimension < LARGE:
        return condensation_of(problem)
    with ThreadPoolExecutor(1) as pool:
        laid_out = pool.submit(own_floating_point(lay_out), problem)
        condensation = condensation_of(problem)
        laid_out.result()
    return condensation


def _linear(condensation: Condensation, load: Vector) -> Candidate:
    """Solve the linear system that remains without contacts and ties."""
    none = np.zeros(0)
    x, _, _ = saddle_point(condensation, np.zeros(0, dtype=np.intp)).solve(load, none, none)
    return Candidate(Answer(x, none, None, none), status="a linear system")


def _run_scaled(problem: ContactProblem, method: Method, settings: Settings) -> Candidate:
    if not method.scale:
        return method.solve(problem, settings)
    twin, scaling = nondimensional(problem)
    if settings.warm_start is not None:
        start = replace(settings.warm_start, answer=scaling.scale(settings.warm_start.answer))
        settings = replace(settings, warm_start=start)
    return scaling.unscale(method.solve(twin, settings))


class EnforcedRun(Run):
    """Coulomb friction by the method's own systems of stick and slip, in the problem's own unknowns, never polished.

    Raises Unsupported: two tangential directions a contact, or bodies too large to factorise; NoEquilibrium: the
    constraints conflict, or the load drives a motion that nothing holds; NotConverged, InvalidProblem as the method.
    """

    def __init__(
        self,
        problem: ContactProblem,
        method: Method,
        settings: Settings,
    ) -> None:
        if problem.slip_origin is not None and problem.slip_origin.shape[1] > 1:
            raise Unsupported(
                f"{method.name}: two tangential rows a contact; its systems of stick and slip are those of the plane"
            )
        if iterated(problem):
            raise Unsupported(f"{method.name}: a body this large is not factorised, and its systems of friction are")
        super().__init__(problem, method)
        assert method.solve_friction is not None
        with self.meter.running():
            refuse_driven_motion(problem, condense(problem).rigid)
            try:
                self.candidate = method.solve_friction(problem, settings)
            except NotConverged:
                self.refuse_conflict()
                raise

    def final(self) -> Final:
        """Return the answer to be certified, the candidate with rounding errors set to zero."""
        u, normal, friction, tie = _without_noise(self.problem, self.candidate.answer)
        # The elongation of a tangential spring is not slip, which the certificate cannot distinguish.
        status = None if self.method.exact else self.candidate.contact_status
        return Final(Answer(u, normal, friction[:, None], tie), contact_status=status)

    def work(self, corrections: int) -> Work:
        """Return what the answer has cost so far."""
        return replace(super().work(corrections), retained=self.problem.dimension)


def _without_noise(problem: ContactProblem, found: Answer) -> tuple[Vector, Vector, Vector, Vector]:
    """Return displacement, normal, friction and tie forces, with rounding errors set to zero.

    All are compared as square roots of energy, forces by means of their rows.
    """
    D = unknown_scale(problem)
    friction = np.zeros(problem.contacts) if found.friction_force is None else found.friction_force[:, 0]
    values = (found.displacement, found.normal_force, friction, found.tie_force)
    rows = (problem.normal, sp.csr_array(problem.tangent), problem.tie)
    units = (1.0 / D, *(np.sqrt(row.power(2) @ D**2) for row in rows))
    sizes = (abs(value) * unit for value, unit in zip(values, units, strict=True))
    largest = max(size.max(initial=0.0) for size in (*sizes, abs(problem.load) * D))
    u, normal, friction, tie = zero_beneath(values, units, INVISIBLE * largest)
    kept = abs(found.displacement) / D > INVISIBLE * longest_stated(problem)
    return np.where(kept, found.displacement, u), normal, friction, tie


_ELSE = "to factorise it all the same: CONTACTQP_SPARSE_SOLVER=pardiso (pip install pypardiso) or superlu"


class RunByIteration(Run):
    """A run on a body that is too large to factorise; its work is counted in iterations.

    Raises Unsupported: another method than the active set.
    """

    def __init__(
        self, problem: ContactProblem, method: Method, make_iteration: Callable[[ContactProblem], Iteration]
    ) -> None:
        if method.kind != ACTIVE_SET:
            raise Unsupported(
                f"{method.name}: a body this large is not factorised, only iterated on, by active-set; {_ELSE}"
            )
        super().__init__(problem, method)
        self.iteration = make_iteration(problem)
        self._before = self.iteration.krylov_iterations

    def work(self, corrections: int) -> Work:
        """Return what the answer has cost so far."""
        return Work(
            iterations=self.candidate.iterations,
            retained=self.problem.dimension,
            polish_corrections=corrections,
            solver=self.iteration.solver,
            krylov_iterations=self.iteration.krylov_iterations - self._before,
        )

    def refuse_conflict(self) -> None:
        """Do nothing, as a conflict of constraints cannot be proven without a factorisation."""


class IteratedRun(RunByIteration):
    """The active set by conjugate gradients on a body that is too large to factorise, as accurate as the certificate
    requires.

    Raises Unsupported: another method than the active set, or `condense` is True; NotConverged as `solve_by_iteration`
    does; NoEquilibrium: the load drives a rigid motion that nothing holds.

    Parameters
    ----------
    problem, method, settings, condense : as in `CondensedRun`; `condense` True is refused
    """

    def __init__(self, problem: ContactProblem, method: Method, settings: Settings, condense: bool | str) -> None:
        if condense is True:
            raise Unsupported(f"{method.name}: condensing a body this large means factorising it; {_ELSE}")
        super().__init__(problem, method, iteration)
        refuse_driven_motion(problem, self.iteration.rigid)
        with on_one_thread():  # no large dense matrices
            self.candidate = solve_by_iteration(problem, self.iteration, settings.now)

    def final(self) -> Final:
        """Return the answer to be certified, the candidate without components along free motions."""
        found, floating = replace(self.candidate.answer, friction_force=None), self.iteration.floating
        if not floating.count:
            return Final(found)
        u, free = floating.at_rest(found.displacement, found.normal_force, self.problem.gap)
        return Final(replace(found, displacement=u), described(self.problem, free))
