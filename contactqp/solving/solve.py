"""solve(): condense, run a method, expand, polish, certify; or iterate and certify, where the bodies are too large."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol, overload

import numpy as np

from contactqp.certificate import subset_bounds
from contactqp.certificate.certificate import compute_certificate, contact_status
from contactqp.certificate.idle_rows import ActingRows, acting_rows
from contactqp.certificate.subset_bounds import first_candidates
from contactqp.errors import (
    BackendFailed,
    BackendMissing,
    NotCertified,
    NotConverged,
    SeveralEquilibria,
    Unsupported,
    refuse_other,
)
from contactqp.linalg.iteration import iterated
from contactqp.linalg.measures import row_sizes
from contactqp.linalg.refinement import WITHIN_ROUNDING
from contactqp.linalg.stages import METHOD, POLISH, stage
from contactqp.linalg.threads import one_blas_thread
from contactqp.model.arrays import own_floating_point
from contactqp.model.engines import SERIAL, engine_named, refuse_unknown_engine
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Candidate, Final, Raw, Solution, Work
from contactqp.solving.contact_subset import solve_among
from contactqp.solving.methods import Method, Settings, find, refuse_arguments, refuse_unsupported, warm_candidate
from contactqp.solving.runs import CondensedAttempt, IteratedAttempt

if TYPE_CHECKING:
    from contactqp.model.local_problem import LocalSolution


DEFAULT_METHOD = "active-set"
# Exact routes to the same answer, tried in this order where that of the default method is refused: pivots that need no
# anchors for bodies that float, textbook systems in the numbers of the problem, and an interior point.
ROUTES = ("lemke", "lagrange-multiplier", "clarabel")
# The same with friction: algorithms that come to combinations of open, stick and slip in other ways.
FRICTIONAL_ROUTES = ("newton", "nsgs", "admm", "enumeration")


@overload
def solve(problem: ContactProblem, method: str = "active-set", **arguments: Any) -> Solution: ...


@overload
def solve(problem: LocalProblem, method: str = "active-set", **arguments: Any) -> LocalSolution: ...


@own_floating_point
def solve(
    problem: ContactProblem | LocalProblem,
    method: str = "active-set",
    *,
    engine: str = SERIAL,
    tolerance: float = 1e-9,
    condense: bool | str = "auto",
    polish: bool = True,
    time_limit: float | None = None,
    max_iter: int | None = None,
    warm_start: Any = None,
    algorithm: str | None = None,
    **options: Any,
) -> Solution | LocalSolution:
    """The minimum of 1/2 u'Ku - f'u over E_N u <= g, A u = b, with its forces and a certificate.

    Parameters
    ----------
    method : str
        A name of `contactqp.methods()`.
    engine : str
        "serial": in this process. "petsc": on all ranks of MPI, each of which calls this with the same problem and gets
        the same solution; `method` is "active-set".
    tolerance : float
        Of the method, relative, on the nondimensional problem.
    condense : bool or "auto"
        Whether the method sees the problem condensed onto its contact unknowns; "auto" does so wherever that is
        smaller.
    polish : bool
        Solve again, to the last digit, on the set of closed contacts that the method found; backends may have their
        set corrected twice. `solution.raw` is the answer before it.
    time_limit : float, optional
        Seconds, for methods that can stop.
    max_iter : int, optional
        Iterations of the method.
    warm_start : Solution, optional
        Of a problem with the same contacts.
    algorithm : str, optional
        With friction, for methods of kind other than "classical enforcement", which have systems of stick and slip of
        their own. By steps of the convex `method`: "tresca" (friction bounds of the step before), "aclm" (shifted
        cones: Acary, Cadoux, Lemarechal, Malick 2011); in space Clarabel, SCS and cvxpy take cones, others polygons of
        `facets` sides, `polygon` "inscribed" or "circumscribed". Without convex steps: "newton" (Alart and Curnier
        1991), "nsgs" (nonsmooth Gauss-Seidel), "ppa" (proximal points), "admm", "enumeration" (in the plane, at most
        eight contacts). All are solved to the last digits on their combination of open, stick and slip, `polish` or
        not, and `max_iter` counts their steps. None is Newton's method from a `warm_start`, else or where it fails the
        others, one after another. Where there are several equilibria one of them is returned, by enumeration alone
        none: `certificate.uniqueness` says that there are or may be others, `contactqp.equilibria` lists them, and
        `contactqp.exact_equilibria` in rational numbers.
        "associated" solves the convex relaxation in which sliding dilates (`contactqp.solving.friction.associated`): it
        is approximate by design, and its answer is returned although the certificate refuses it wherever something
        slides.
    **options
        What the method names in its `options`: `penalty`, `tangential_penalty` and `perturbation` [force / length],
        `update`, `solver`.

    Raises
    ------
    NoEquilibrium
        The constraints conflict, or the load drives a rigid motion that nothing holds; with friction, no combination
        of open, stick and slip is an equilibrium in rational numbers.
    SeveralEquilibria
        With friction, `algorithm` "enumeration" finds several answers.
    NotConverged, BackendFailed
        The method gave up; a last iterate, if any, is in `solution`.
    NotCertified
        The method promises the exact answer and the certificate refuses what it returned. Where that is the default
        method, unless `polish`, `max_iter` or `time_limit` speak against it, Lemke's, the Lagrange multipliers' and
        Clarabel's answers were tried before, with friction other algorithms': the first that is certified is returned,
        and `work.routes` says so.
    BackendMissing, Unsupported, InvalidProblem
        The method is not installed, cannot do this, or an argument is wrong.

    Examples
    --------
    >>> import contactqp as cq
    >>> K = [[157500.0, 0.0], [0.0, 315000.0]]
    >>> bars = cq.ContactProblem(stiffness=K, load=[300.0, 0.0], normal=[[1.0, -1.0]], gap=[1e-3])
    >>> solution = cq.solve(bars)
    >>> solution.normal_force.round(9), solution.certificate.proven
    (array([95.]), True)
    """
    same: dict[str, Any] = dict(tolerance=tolerance, polish=polish, algorithm=algorithm)
    same.update(time_limit=time_limit, max_iter=max_iter, **options)
    if engine != SERIAL:
        refuse_unknown_engine(engine)
    if isinstance(problem, LocalProblem):
        if engine != SERIAL:
            raise Unsupported(f"engine {engine!r}: a problem in local form has no stiffness to deal out")
        from contactqp.solving.local_solving import solve_local

        return solve_local(problem, method, warm_start=warm_start, **same)
    if type(problem) is not ContactProblem:
        refuse_other("solve", problem, ContactProblem, LocalProblem)
    same["condense"] = condense
    if problem.has_idle_rows and (rows := acting_rows(problem)) is not None:
        return _without_idle_rows(rows, method, engine=engine, warm_start=warm_start, **same)
    start = None if warm_start is None else warm_candidate(problem, warm_start)
    if engine != SERIAL:
        elsewhere = engine_named(engine).function("solve")
        found: Solution = elsewhere(problem, method, warm_start=warm_start, **same)
        return found
    many = problem.normal.nnz > subset_bounds.MANY and not iterated(problem)
    if many and (candidates := first_candidates(problem)) is not None:
        with problem.lock, stage(METHOD):
            return solve_among(
                problem, candidates, warm_start, lambda few, known: solve(few, method, warm_start=known, **same)
            )
    try:
        return begin(problem, method, start, **same).finish()
    except (NotCertified, NotConverged) as error:
        if method != DEFAULT_METHOD or not polish or max_iter or time_limit or iterated(problem):
            raise
        # With friction the default has tried all algorithms where none converges.
        if problem.frictional and (algorithm is not None or isinstance(error, NotConverged)):
            raise
        return _by_another_route(problem, error, same)


def _by_another_route(problem: ContactProblem, error: NotCertified | NotConverged, same: dict[str, Any]) -> Solution:
    """The answer of the first of the other exact routes that is certified; `Work.routes` says what was tried.

    Raises
    ------
    NoEquilibrium
        Another route has proven that there is none.
    NotCertified, NotConverged
        The error of the default method, with what the others came to: none is certified.
    """
    first = error.solution
    spent = first.work if isinstance(first, Solution) else Work()
    tried = [str(error)]
    seconds = first.seconds if isinstance(first, Solution) else 0.0
    routes = FRICTIONAL_ROUTES if problem.frictional else ROUTES
    for route in routes:
        changed = {"algorithm": route} if problem.frictional else {"method": route}
        try:
            found = begin(problem, **{**same, **changed}).finish()
        except (NotCertified, NotConverged, SeveralEquilibria, BackendFailed, BackendMissing, Unsupported) as other:
            tried.append(str(other))
            continue
        work = replace(found.work.after(spent), routes=(*tried, f"{route}: its answer is certified"))
        name = found.method if problem.frictional else DEFAULT_METHOD
        return replace(found, method=name, seconds=seconds + found.seconds, work=work)
    error.args = (f"{error}; {', '.join(routes)} were tried too, and no answer is certified",)
    raise error


def _without_idle_rows(rows: ActingRows, method: str, warm_start: Any, **same: Any) -> Solution:
    """The solution of a problem by that of the problem without the rows that constrain nothing."""
    rows.refuse_conflict()
    warm_candidate(rows.whole, warm_start)
    start = None if warm_start is None else rows.start(warm_start)
    try:
        found: Solution = rows.solution(solve(rows.problem, method, warm_start=start, **same))
    except (NotConverged, NotCertified) as error:
        if isinstance(error.solution, Solution):
            error.solution = rows.solution(error.solution)
        raise
    return found


def _unmet(problem: ContactProblem, solution: Solution) -> bool:
    """Whether an answer leaves gaps closed or ties unmet by more than rounding of the lengths that meet."""
    u = solution.displacement
    for rows, limit, signed in ((problem.normal, problem.gap, True), (problem.tie, problem.tie_value, False)):
        beyond = rows @ u - limit
        meeting = row_sizes(problem, rows).size @ abs(u) + abs(limit)
        if np.any((beyond if signed else abs(beyond)) > WITHIN_ROUNDING * meeting):
            return True
    return False


class Attempt(Protocol):
    """What a method made of a problem, whichever way it was shown it."""

    candidate: Candidate  # in the unknowns of the problem that the method was shown

    @property
    def expanded(self) -> Candidate:
        """In the unknowns of the problem."""

    @property
    def start(self) -> Candidate:
        """What another load may start from: in the unknowns of the problem, exact where the method was shown them."""

    def final(self, polished: bool) -> Final:
        """The answer that is to be certified."""

    def counting(self) -> Any:
        """A context whose work counts as this attempt's."""

    def work(self, corrections: int) -> Work:
        """What it has cost so far."""

    def refuse_conflict(self) -> None:
        """Raise NoEquilibrium if the constraints conflict."""


@own_floating_point
def begin(
    problem: ContactProblem,
    method: str = "active-set",
    start: Candidate | None = None,
    *,
    tolerance: float = 1e-9,
    condense: bool | str = "auto",
    polish: bool = True,
    time_limit: float | None = None,
    max_iter: int | None = None,
    algorithm: str | None = None,
    **options: Any,
) -> Begun:
    """Run a method; polish and certificate, which need all unknowns, wait until the answer is looked at.

    Parameters are those of `solve`, but for `start`: a candidate where that takes a solution.

    Raises
    ------
    NoEquilibrium, SeveralEquilibria, NotConverged, BackendFailed, BackendMissing, Unsupported, InvalidProblem
        As `solve`.
    """
    started = time.perf_counter()
    refuse_arguments(tolerance, condense, polish, time_limit, max_iter)
    chosen, settings = find(method), Settings(tolerance, max_iter, time_limit, start, options)
    refuse_unsupported(problem, chosen, settings, algorithm)
    with problem.lock, one_blas_thread(problem), stage(METHOD):
        attempt: Attempt
        if problem.frictional and chosen.solve_friction is not None:
            from contactqp.solving.runs import EnforcedAttempt

            attempt = EnforcedAttempt(problem, chosen, chosen.solve_friction, settings)
        elif problem.frictional:
            from contactqp.solving.friction_runs import attempt_friction

            attempt = found = attempt_friction(problem, chosen, settings, algorithm)
            chosen = replace(chosen, name=found.name, exact=found.exact)
        else:
            way = IteratedAttempt if iterated(problem) else CondensedAttempt
            attempt = way(problem, chosen, settings, condense)
    return Begun(problem, chosen, attempt, polish, time.perf_counter() - started)


@dataclass(frozen=True, eq=False)
class Begun:
    """A method's answer that nobody has looked at."""

    problem: ContactProblem
    method: Method
    attempt: Attempt
    polish: bool
    seconds: float  # so far

    @own_floating_point
    def finish(self) -> Solution:
        """Polish and certify.

        Raises
        ------
        NoEquilibrium, NotConverged, NotCertified
            As `solve`.
        """
        started = time.perf_counter() - self.seconds
        with self.problem.lock, one_blas_thread(self.problem), stage(POLISH):
            return self._accepted(*self._certified(started))

    def _accepted(self, solution: Solution, polished: bool) -> Solution:
        """The solution, unless its method did not converge or the certificate refuses what should be exact."""
        candidate, name = self.attempt.candidate, self.method.name
        if not polished and not candidate.claimed:
            self.attempt.refuse_conflict()
            reason = candidate.status or "it stopped before it had an answer"
            count = "" if candidate.iterations is None else f" (after {candidate.iterations} iterations)"
            raise NotConverged(f"{name}: {reason.removeprefix(f'{name}: ')}{count}", candidate.history, solution)
        if self.method.exact and not solution.certificate.passed:
            self.attempt.refuse_conflict()
            failures = "; ".join(solution.certificate.failures)
            raise NotCertified(f"{name}: the certificate refuses the answer: {failures}", solution)
        if self.method.exact and _unmet(self.problem, solution):
            self.attempt.refuse_conflict()  # what is beneath the tolerance may be a conflict of constraints
        return solution

    def _certified(self, started: float) -> tuple[Solution, bool]:
        """The solution, and whether it is polished."""
        problem, candidate = self.problem, self.attempt.candidate
        with self.attempt.counting():
            final = self.attempt.final(self.polish)
            friction = final.friction_force
            if friction is None and problem.slip_origin is not None:
                friction = np.zeros_like(problem.slip_origin)
            answered = time.perf_counter()
            certificate = compute_certificate(
                problem, final.displacement, final.normal_force, friction, final.tie_force
            )
            certified = time.perf_counter()
            # The active-set method's own answer is the set; what came before its refinement is no other method's.
            raw = self._raw(friction) if final.polished and self.method.kind != "active set" else None
        solution = Solution(
            problem=problem,
            displacement=final.displacement,
            normal_force=final.normal_force,
            friction_force=friction,
            tie_force=final.tie_force,
            contact_status=contact_status(problem, certificate)
            if final.contact_status is None
            else final.contact_status,
            free_motions=final.free_motions,
            certificate=certificate,
            method=self.method.name,
            seconds=certified - started,
            certify_seconds=certified - answered,
            work=self.attempt.work(final.corrections),
            raw=raw,
            history=candidate.history,
        )
        return solution, final.polished

    def _raw(self, friction: Any) -> Raw:
        candidate = self.attempt.expanded
        values = (candidate.displacement, candidate.normal_force, candidate.tie_force)
        certificate = compute_certificate(self.problem, values[0], values[1], friction, values[2])
        return Raw(*values, claimed=candidate.claimed, status=candidate.status, certificate=certificate)
