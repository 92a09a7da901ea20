"""`solve` condenses a problem, runs a method on it, expands and polishes the answer, and certifies it.

Large problems are solved iteratively or by sparse systems instead. With very many contacts, a subset of them is solved
and enlarged until no other contact is penetrated. The table `RUN_RULES` at the end chooses the class of run.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import Any, overload

from contactqp.certificate.certificate import certificate_of
from contactqp.certificate.idle_rows import ActingRows, acting_rows
from contactqp.certificate.messages import none_is_certified
from contactqp.certificate.number_range import NearOne, near_one
from contactqp.errors import (
    BackendFailed,
    BackendMissing,
    InvalidProblem,
    NoEquilibrium,
    NotCertified,
    NotConverged,
    SeveralEquilibria,
    Unsupported,
    refuse_other,
    shown,
)
from contactqp.linalg.iteration import (
    Systems,
    condense_anyway,
    contacts_are_many,
    factorised,
    may_be_condensed,
    may_be_factorised,
    systems_of,
)
from contactqp.linalg.pardiso import SOLVER_VARIABLE
from contactqp.linalg.runtime import SERIAL, engine_named, refuse_unknown_engine
from contactqp.model.arrays import (
    METHOD,
    Vector,
    call_within_time,
    one_blas_thread,
    own_floating_point,
    stage,
    telling,
    time_is_up,
)
from contactqp.model.local_problem import LocalProblem, LocalSolution
from contactqp.model.problem import ContactProblem
from contactqp.model.quadratic_program import in_own_words
from contactqp.model.solution import Candidate, Solution, Work
from contactqp.solving.methods import (
    DEFAULT_METHOD,
    POLYGON_OPTIONS,
    Method,
    Settings,
    find,
    refuse_arguments,
    refuse_unsupported,
    registered_name,
    warm_candidate,
)
from contactqp.solving.methods.method import ACTIVE_SET, QUADRATIC_PROGRAM
from contactqp.solving.presolve import PresolvedRun, presolved, solve_among
from contactqp.solving.runs import CondensedRun, EnforcedRun, IteratedRun, Run, after
from contactqp.solving.sparse_run import SPARSE, SparseRun, by_sparse_systems, has_sparse_systems

# Arguments that all methods share; any other argument is an option of the method.
OF_EVERY_METHOD = ("tolerance", "max_iter", "time_limit", "condense", "polish", "algorithm")
# Where the answer of the default method is refused, other exact methods are tried in this order: Lemke's pivots, which
# need no anchors for floating bodies; the textbook systems of Lagrange multipliers; Clarabel; and sparse systems, which
# come first where constraints outnumber the unknowns or MANY_PIVOTS. The number of pivots is limited to PIVOTS plus
# PIVOTS_OF_A_ROW for each constraint; there is none beyond MOST_PIVOTS. Last sparse systems: SYSTEMS plus one for each.
PIVOTING = ("lemke", "lagrange-multiplier")
MANY_PIVOTS, MOST_PIVOTS, PIVOTS, PIVOTS_OF_A_ROW, SYSTEMS = 100, 150, 200, 2, 20
# With friction, other algorithms are tried, each of which arrives at a combination of open, stick and slip differently.
FRICTIONAL_ROUTES = ("newton", "nsgs", "admm", "aclm", "enumeration")


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
    progress: Callable[[str], object] | None = None,
    **options: Any,
) -> Solution | LocalSolution:
    """Minimise 1/2 u'Ku - f'u over E_N u <= g, A u = b; return the answer with its forces and a certificate.

    Parameters
    ----------
    problem : ContactProblem or LocalProblem
    method : str
        A name of `contactqp.methods()`.
    engine : str
        "serial": in this process. "petsc": on all ranks of MPI, each of which calls this with the same problem and gets
        the same solution; `method` is "active-set".
    tolerance : float
        Relative tolerance of the method, on the nondimensional problem.
    condense : bool or "auto"
        Whether the method is given the problem condensed onto its contact unknowns. "auto" condenses where this makes
        the problem smaller, and keeps sparse systems of all unknowns where these are predicted to cost less: with many
        constraints, or a stiffness that is zero in many directions. True condenses in these cases, too, with and
        without friction; False makes "active-set" use sparse systems.
    polish : bool
        Whether the answer is computed again, to the last digit, on the set of closed contacts that the method found;
        a backend's set may be corrected twice. `solution.raw` is the answer before polishing.
    time_limit : float, optional
        Largest duration of the call without its certificate in seconds, for methods that can stop. It is checked before
        each step and each factorisation, and ends long factorisations by PARDISO. Where it is reached before there is
        an answer, NotConverged is raised; its `solution` is the best answer so far, if there is any.
    max_iter : int, optional
        Largest number of iterations of the method.
    warm_start : Solution, optional
        Solution of a problem with the same contacts, from which the method starts.
    algorithm : str, optional
        The algorithm of friction, for all kinds of methods but CLASSICAL_ENFORCEMENT, whose own systems contain
        stick and slip. In steps of the convex `method`: "tresca" (with the friction bounds of the step before), "aclm"
        (shifted cones; Acary, Cadoux, Lemarechal, Malick 2011); in space Clarabel, SCS and cvxpy take cones, others
        polygons of `facets` sides, `polygon` "inscribed" or "circumscribed". Without convex steps: "newton" (Alart and
        Curnier 1991), "nsgs" (nonsmooth Gauss-Seidel), "ppa" (proximal points), "admm", and "enumeration" (in the
        plane, at most eight contacts). All end by solving to the last digit on their combination of open, stick and
        slip, whatever `polish` is, and `max_iter` counts their steps. By default Newton's method is tried first where
        there is a `warm_start` and, in the plane, where sparse systems are used; then the others, one after another.
        Where there are several equilibria, one of them is returned ("enumeration" raises SeveralEquilibria), and
        `certificate.uniqueness` says that there are or may be others; `contactqp.equilibria` lists them, and
        `contactqp.exact_equilibria` does so in rational numbers. "associated" solves the convex relaxation in which
        sliding dilates (`contactqp.solving.friction.associated`). It is approximate by design: its answer is returned
        although the certificate refuses it where anything slides.
    progress : callable, optional
        Called with a short text on the current stage, such as ``"condense"`` or ``"contact set 3: 577 closed"``,
        whenever the stage changes. An exception that it raises ends the call.
    **options
        Options of the method, as listed in its `options`: `penalty`, `tangential_penalty` and `perturbation`
        [force / length], `update`, `solver`.

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
        The method is exact and the certificate refuses its answer. Before the default method raises this error, or
        NotConverged without friction, it tries other exact methods: Lemke's, Lagrange multipliers, Clarabel and sparse
        systems; with friction, other algorithms. The first certified answer is returned, and `work.routes` lists what
        was tried. No other method is tried where `polish` is False, `max_iter` is given, `time_limit` is over, the
        bodies are too large to factorise, or, without friction, sparse systems were used from the start.
    BackendMissing, Unsupported, InvalidProblem
        The method is not installed, does not support this problem, or an argument is wrong.

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
    if progress is not None and not callable(progress):
        raise InvalidProblem(f"progress: expected a function of one text, got {type(progress).__name__}")
    if algorithm is not None and not isinstance(algorithm, str):
        raise InvalidProblem(f"algorithm: expected a name, got {shown(algorithm)}")
    with nullcontext() if progress is None else telling(progress):
        return _solve_any(problem, method, engine, condense, warm_start, same)


def _solve_any(
    problem: Any, method: str, engine: str, condense: bool | str, warm_start: Any, same: dict[str, Any]
) -> Solution | LocalSolution:
    if not isinstance(problem, LocalProblem) and type(problem) is not ContactProblem:
        refuse_other("solve", problem, ContactProblem, LocalProblem)
    if isinstance(engine, str) and engine == SERIAL:  # other engines have their own methods
        method = registered_name(method)
    else:
        refuse_unknown_engine(engine)
    if isinstance(problem, LocalProblem):
        if engine != SERIAL:
            raise Unsupported(f"engine {engine!r}: a problem in local form has no stiffness to deal out")
        from contactqp.solving.local_solving import solve_local

        return solve_local(problem, method, warm_start=warm_start, **same)
    limit = same["time_limit"]
    refuse_arguments(same["tolerance"], condense, same["polish"], limit, same["max_iter"])
    words = in_own_words() if problem._computed.of_stiffness.of_program else nullcontext()
    with nullcontext() if limit is None else call_within_time(limit), words:
        return _solve(problem, method, warm_start, engine, dict(same, condense=condense))


def _solve(
    problem: ContactProblem, method: str, warm_start: Solution | None, engine: str, same: dict[str, Any]
) -> Solution:
    """Solve on another engine, in other units, on a subset of the contacts or directly, else by other routes."""
    condense, algorithm = same["condense"], same["algorithm"]
    options = {name: value for name, value in same.items() if name not in OF_EVERY_METHOD}
    problem._refuse_exchanged_arrays()
    if problem.has_idle_rows and (rows := acting_rows(problem)) is not None:
        return _without_idle_rows(rows, method, engine=engine, warm_start=warm_start, **same)
    start = None if warm_start is None else warm_candidate(problem, warm_start)
    if engine != SERIAL:
        elsewhere: Callable[..., Solution] = engine_named(engine).function("solve")
        return elsewhere(problem, method, warm_start=warm_start, **same)
    if not problem._is_near_one and (near := near_one(problem)) is not None:
        return _in_other_units(near, method, warm_start=warm_start, **same)
    small = problem._is_small and not os.environ.get(SOLVER_VARIABLE)  # nothing costs less than condensing it
    systems = Systems.CONDENSED if small else systems_of(problem)
    if systems is Systems.ITERATED and may_be_factorised(problem):
        needs_factors = find(method).kind != ACTIVE_SET or condense is True or algorithm not in (None, "tresca")
        if needs_factors:
            with factorised(problem):
                return solve(problem, method, warm_start=warm_start, **same)
    if systems is Systems.SUBSET and algorithm != "associated":
        with problem._lock, stage(METHOD):
            among = solve_among(
                problem,
                warm_start,
                lambda subset, subset_start: solve(subset, method, warm_start=subset_start, **same),
                _without_friction,
            )
        if among is not None:
            return among
        systems = systems_of(problem)  # the search may have shown that a body floats
    settings = Settings(same["tolerance"], same["max_iter"], same["time_limit"], start, options)
    try:
        return _begun(problem, method, systems, settings, condense, same["polish"], algorithm).finish()
    except (NotCertified, NotConverged) as error:
        limited = not same["polish"] or same["max_iter"] or time_is_up()
        if method != DEFAULT_METHOD or limited:
            sparse_before = systems is Systems.SPARSE and has_sparse_systems(find(method))
            if limited or sparse_before or systems not in (Systems.CONDENSED, Systems.SPARSE):
                raise
            return by_sparse_systems(problem, find(method), settings, error)
        systems = systems_of(problem)  # the failed attempt may have shown that a body floats
        if systems is Systems.ITERATED:
            if not may_be_factorised(problem):
                raise
            with factorised(problem):
                return after(error, "factorised", solve(problem, method, warm_start=warm_start, **same))
        if systems is Systems.SPARSE:
            if not (problem.frictional or may_be_condensed(problem)):
                raise  # the other routes condense
            condense_anyway(problem)
            return after(error, "condensed", solve(problem, method, warm_start=warm_start, **same))
        # With friction NotConverged means that the default has tried all algorithms.
        if problem.frictional and (algorithm is not None or isinstance(error, NotConverged)):
            raise
        return _by_another_route(problem, error, same)


def _without_friction(problem: ContactProblem) -> tuple[Vector, Work]:
    """Return the normal forces (m,) of the problem without friction, possibly uncertified, and the work."""
    slippery = problem.replace(tangent=None, friction=None, slip_origin=None)  # fewer unknowns are condensed
    if contacts_are_many(slippery):
        found = solve(slippery)
        return found.normal_force, found.work
    run = begin(slippery, DEFAULT_METHOD)
    return run.expanded.answer.normal_force, run.work(0)


def _routes(problem: ContactProblem) -> dict[str, dict[str, Any]]:
    """Return the routes in their order, each with the arguments of `begin` that select it."""
    if problem.slip_origin is not None and problem.frictional:
        from contactqp.solving.friction_runs import FEW_CONTACTS

        routes: dict[str, dict[str, Any]] = {route: {"algorithm": route} for route in FRICTIONAL_ROUTES}
        if problem.slip_origin.shape[1] > 1:
            routes["aclm"]["method"] = "clarabel"  # it accepts cones in space
        elif problem.contacts <= FEW_CONTACTS:  # trying all combinations is cheaper than thousands of iterations
            return {name: routes.pop(name) for name in ("newton", "enumeration")} | routes
        return routes
    constraints = problem.contacts + problem.ties
    pivots = {"max_iter": PIVOTS + PIVOTS_OF_A_ROW * constraints}
    routes = dict.fromkeys(PIVOTING, pivots) if constraints <= MOST_PIVOTS else {}
    routes = {route: {"method": route} | limits for route, limits in {**routes, "clarabel": {}}.items()}
    if constraints > min(problem.dimension, MANY_PIVOTS):
        return {SPARSE: {"condense": False}} | routes
    return routes | {SPARSE: {"condense": False, "max_iter": SYSTEMS + constraints}}


def _by_another_route(problem: ContactProblem, error: NotCertified | NotConverged, same: dict[str, Any]) -> Solution:
    """Return the first certified answer of the other exact routes; `Work.routes` says what was tried.

    Raises NoEquilibrium: another route has proven it; NotCertified, NotConverged: no route has a certified answer.
    """
    first = error.solution
    spent, seconds = (first.work, first.seconds) if isinstance(first, Solution) else (Work(), 0.0)
    tried, names = [str(error)], list[str]()
    for route, changed in _routes(problem).items():
        if time_is_up():
            break
        names.append(route)
        try:
            found = begin(problem, **{**same, **changed}).finish()
        except (NotCertified, NotConverged, SeveralEquilibria, BackendFailed, BackendMissing, Unsupported) as other:
            tried.append(str(other))
            if route == "enumeration" and isinstance(other, NotCertified | NotConverged):
                break  # it has tried every combination of open, stick and slip
            continue
        work = replace(found.work.after(spent), routes=(*tried, f"{route}: its answer is certified"))
        name = found.method if problem.frictional else DEFAULT_METHOD
        return replace(found, method=name, seconds=seconds + found.seconds, work=work)
    error.args = (f"{error}; {', '.join(names)} were tried too, and {none_is_certified(problem, first)}",)
    raise error


def _without_idle_rows(rows: ActingRows, method: str, warm_start: Any, **same: Any) -> Solution:
    """Solve a problem without its rows of zeros and return the solution with all rows."""
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


def _in_other_units(near: NearOne, method: str, warm_start: Any, **same: Any) -> Solution:
    """Solve a problem in units in which its numbers are near one, and convert the solution back."""
    warm_candidate(near.whole, warm_start)
    start = None if warm_start is None else near.start(warm_start)
    try:
        found = solve(near.problem, method, warm_start=start, **near.options(same))
    except (NotConverged, NotCertified) as error:
        near.refuse_far_gap()
        if isinstance(error.solution, Solution):
            error.solution = of_problem(near, error.solution)
        raise
    except NoEquilibrium as error:
        near.refuse_far_gap()
        raise near.no_equilibrium(error) from None
    return of_problem(near, found)


def of_problem(near: NearOne, found: Solution) -> Solution:
    """Convert a solution in units near one to the units of the problem, and certify it there.

    Raises InvalidProblem, NotCertified: a number of the answer, or a gap that it closes, overflows or underflows there.
    """
    answer, raw = near.answer_of(found), None if near.whole.frictional else found.raw
    certificate = certificate_of(near.whole, answer, found.certificate.tolerance, found.certificate.error_tolerance)
    if raw is not None:
        unpolished = replace(near.whole_answer(raw.answer), friction_force=None)
        raw = replace(raw, problem=near.whole, answer=unpolished)
    whole = replace(found, problem=near.whole, answer=answer, raw=raw, certificate=certificate)
    near.refuse_lost(found, whole)
    return replace(whole, free_motions=near.motions(found.free_motions))


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
) -> Run:
    """Run a method; refinement and certificate, which need all unknowns, wait until `Run.finish` is called.

    Raises NoEquilibrium, SeveralEquilibria, NotConverged, BackendFailed, BackendMissing, Unsupported, InvalidProblem as
    `solve` does.

    Parameters
    ----------
    problem, method, tolerance, condense, polish, time_limit, max_iter, algorithm, **options : as in `solve`
    start : Candidate, optional
    """
    refuse_arguments(tolerance, condense, polish, time_limit, max_iter)
    settings = Settings(tolerance, max_iter, time_limit, start, options)
    return _begun(problem, method, systems_of(problem), settings, condense, polish, algorithm)


def _begun(
    problem: ContactProblem,
    name: str,
    systems: Systems,
    settings: Settings,
    condense: bool | str,
    polish: bool,
    algorithm: str | None,
) -> Run:
    """Run the method of this name with checked arguments, by the first of `RUN_RULES` that applies."""
    started = time.perf_counter()
    method = find(name)
    refuse_unsupported(problem, method, settings, algorithm)
    if algorithm is not None:
        from contactqp.solving.friction_runs import refuse_unknown_algorithm

        refuse_unknown_algorithm(algorithm)
    if settings.options and not problem.frictional:  # options of friction cones without friction
        others = {name: value for name, value in settings.options.items() if name not in POLYGON_OPTIONS}
        settings = replace(settings, options=others)
    with problem._lock, one_blas_thread(problem), stage(METHOD):
        run = _run(problem, method, systems, settings, condense, algorithm)
    run.polish, run.seconds = polish, time.perf_counter() - started
    return run


def _run(
    problem: ContactProblem, method: Method, systems: Systems, settings: Settings, condense: Any, algorithm: str | None
) -> Run:
    rule = next(rule for rule in RUN_RULES if rule.applies(systems, problem, method, condense))
    return rule.run(problem, method, settings, systems, condense, algorithm)


@dataclass(frozen=True)
class RunRule:
    """One rule of the table `RUN_RULES`, the first of which that applies is taken: a condition and the run for it."""

    applies: Callable[[Systems, ContactProblem, Method, bool | str], bool]  # condense
    run: Callable[[ContactProblem, Method, Settings, Systems, bool | str, str | None], Run]  # condense, algorithm


def _run_friction(
    problem: ContactProblem, method: Method, settings: Settings, systems: Systems, condense: Any, algorithm: str | None
) -> Run:
    from contactqp.solving.friction_runs import run_friction

    systems = Systems.CONDENSED if condense is True and systems is Systems.SPARSE else systems
    return run_friction(problem, method, settings, systems, algorithm)


def _has_rows_to_spare(_: Systems, problem: ContactProblem, method: Method, __: Any) -> bool:
    many = not problem.frictional and problem.contacts + problem.ties > problem.dimension
    return many and method.kind in (ACTIVE_SET, QUADRATIC_PROGRAM) and presolved(problem) is not None


def _run_presolved(problem: ContactProblem, method: Method, settings: Settings, _: Any, condense: Any, __: Any) -> Run:
    kept = presolved(problem)
    assert kept is not None
    return PresolvedRun(
        kept, problem, method, settings, lambda one, its: _run(one, method, systems_of(one), its, condense, None)
    )


def _stays_sparse(systems: Systems, _: ContactProblem, method: Method, condense: bool | str) -> bool:
    everywhere = condense is False and method.kind == ACTIVE_SET
    return (systems is Systems.SPARSE if condense == "auto" else everywhere) and has_sparse_systems(method)


RUN_RULES = (
    # The method has its own systems of stick and slip, in all unknowns of the problem.
    RunRule(
        lambda _, problem, method, __: problem.frictional and method.solve_friction is not None,
        lambda problem, method, settings, *_: EnforcedRun(problem, method, settings),
    ),
    # Friction is solved by an algorithm, which may use the method for its convex steps.
    RunRule(lambda _, problem, *__: problem.frictional, _run_friction),
    # The body is too large to factorise.
    RunRule(
        lambda systems, *_: systems is Systems.ITERATED,
        lambda problem, method, settings, _, condense, __: IteratedRun(problem, method, settings, condense),
    ),
    # Rows outnumber the unknowns, and some are redundant.
    RunRule(_has_rows_to_spare, _run_presolved),
    # There are so many constraints, or K is so singular, that condensing costs more than sparse systems.
    RunRule(_stays_sparse, lambda problem, method, settings, *_: SparseRun(problem, method, settings)),
    # Contacts and ties touch few unknowns, and the method is posed only these unless `condense` is False.
    RunRule(
        lambda *_: True,
        lambda problem, method, settings, _, condense, __: CondensedRun(problem, method, settings, condense),
    ),
)
