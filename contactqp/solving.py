"""solve(): condense, run a method, expand, polish, certify."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from contactqp.candidates import first_candidates
from contactqp.certificate import certify, contact_status, refuse_not_positive
from contactqp.condensation import Condensation
from contactqp.condensation import condense as condensation_of
from contactqp.elimination import LARGE
from contactqp.errors import BackendFailed, InvalidProblem, NotCertified, NotConverged, Unsupported
from contactqp.existence import describe_motion, refuse_conflict, refuse_driven_motion
from contactqp.methods import Method, Settings, find
from contactqp.polishing import closed_contacts, least_displacement, shift_to_least_norm, without_noise
from contactqp.polishing import polish as polish_set
from contactqp.problem import ContactProblem, Vector
from contactqp.saddle import saddle_point
from contactqp.scaling import nondimensional
from contactqp.solution import Candidate, FreeMotion, Raw, Solution, Work
from contactqp.violations import Answer, lay_out
from contactqp.widening import solve_among


@dataclass(frozen=True, eq=False)
class _Found:
    """What a method made of the problem that it was shown, condensed or whole."""

    shown: ContactProblem
    candidate: Candidate
    way: Condensation
    inner: Vector | None  # what expansion needs; None where the whole problem was shown

    @cached_property
    def expanded(self) -> Candidate:
        """The candidate in the unknowns of the problem: back-substitution that polishing can do without."""
        if self.inner is None:
            return self.candidate
        return replace(self.candidate, displacement=self.way.expand(self.candidate.displacement, self.inner))


@dataclass(frozen=True, eq=False)
class _Final:
    """The answer that is certified: a candidate, polished or as it came, its free motions at rest."""

    displacement: Vector
    normal_force: Vector
    tie_force: Vector
    free_motions: tuple[FreeMotion, ...]
    corrections: int = 0
    polished: bool = False


def solve(
    problem: ContactProblem,
    method: str = "active-set",
    *,
    tolerance: float = 1e-9,
    condense: bool | str = "auto",
    polish: bool = True,
    time_limit: float | None = None,
    max_iter: int | None = None,
    warm_start: Solution | None = None,
    algorithm: str | None = None,
    **options: Any,
) -> Solution:
    """The minimum of 1/2 u'Ku - f'u over E_N u <= g, A u = b, with its forces and a certificate.

    Parameters
    ----------
    method : str
        A name of `contactqp.methods()`.
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
        The outer law of friction.
    **options
        What the method names in its `options`: `penalty` [force / length], `perturbation` [force / length], `update`,
        `solver`.

    Raises
    ------
    NoEquilibrium
        The constraints conflict, or the load drives a rigid motion that nothing holds.
    NotConverged, BackendFailed
        The method gave up; a last iterate, if any, is in `solution`.
    NotCertified
        The method promises the exact answer and the certificate refuses what it returned.
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
    started = time.perf_counter()
    _refuse_arguments(tolerance, condense, polish, time_limit, max_iter, warm_start)
    chosen = find(method)
    settings = Settings(tolerance, max_iter, time_limit, _start(problem, warm_start), options)
    _refuse_unsupported(problem, chosen, settings, algorithm)
    if (candidates := first_candidates(problem)) is not None:
        same: dict[str, Any] = dict(tolerance=tolerance, condense=condense, polish=polish, algorithm=algorithm)
        same.update(time_limit=time_limit, max_iter=max_iter, **options)
        return solve_among(
            problem, candidates, warm_start, lambda few, start: solve(few, method, warm_start=start, **same)
        )
    meter = _Meter(problem)
    way = _condensed(problem)
    refuse_driven_motion(problem, way)
    if not chosen.semidefinite and saddle_point(way, np.zeros(0, dtype=np.intp)).free.shape[1]:
        raise Unsupported(f"{method}: bodies held by contact alone (the stiffness is singular); try active-set")
    try:
        found = _run(problem, chosen, settings, way, condense)
    except (NotConverged, BackendFailed):
        refuse_conflict(problem, way)
        raise
    final = _polished(problem, chosen, found) if polish and chosen.polish else None
    if final is None:
        final = _as_it_came(problem, found)
    candidate = found.candidate
    solution = _solution(problem, chosen, found, final, meter, started)
    if not final.polished and not candidate.claimed:
        refuse_conflict(problem, way)
        reason = candidate.status or "it stopped before it had an answer"
        count = "" if candidate.iterations is None else f" (after {candidate.iterations} iterations)"
        raise NotConverged(f"{method}: {reason.removeprefix(f'{method}: ')}{count}", candidate.history, solution)
    if chosen.exact and not solution.certificate.passed:
        refuse_conflict(problem, way)
        failures = "; ".join(solution.certificate.failures)
        raise NotCertified(f"{method}: the certificate refuses the answer: {failures}", solution)
    return solution


def _condensed(problem: ContactProblem) -> Condensation:
    """The condensation. Meanwhile, what refinement and certificate need of a large stiffness is laid out by another
    thread: sparse solvers analyse a matrix on one core."""
    if problem.dimension < LARGE:
        return condensation_of(problem)
    with ThreadPoolExecutor(1) as pool:
        laid_out = pool.submit(lay_out, problem)
        way = condensation_of(problem)
        laid_out.result()
    return way


class _Meter:
    """Counts what one call costs, the condensation included where this call makes it."""

    def __init__(self, problem: ContactProblem) -> None:
        known: Condensation | None = problem._shared.get("condensation")
        self._problem = problem
        self._before = (known.factorisations, known.back_substitutions) if known else (0, 0)

    def read(self, iterations: int | None, corrections: int) -> Work:
        way = condensation_of(self._problem)
        return Work(
            factorisations=way.factorisations - self._before[0],
            back_substitutions=way.back_substitutions - self._before[1],
            iterations=iterations,
            retained=len(way.retained),
            polish_corrections=corrections,
        )


def _refuse_arguments(
    tolerance: Any, condense: Any, polish: Any, time_limit: Any, max_iter: Any, warm_start: Any
) -> None:
    refuse_not_positive("tolerance", tolerance)
    if time_limit is not None:
        refuse_not_positive("time_limit", time_limit)
    if max_iter is not None and (isinstance(max_iter, bool) or not isinstance(max_iter, int) or max_iter < 1):
        raise InvalidProblem(f"max_iter: expected a positive integer, got {max_iter!r}")
    if not (isinstance(condense, bool) or condense == "auto"):
        raise InvalidProblem(f"condense: expected True, False or 'auto', got {condense!r}")
    if not isinstance(polish, bool):
        raise InvalidProblem(f"polish: expected True or False, got {polish!r}")
    if warm_start is not None and not isinstance(warm_start, Solution):
        raise InvalidProblem(f"warm_start: expected a Solution, got {type(warm_start).__name__}")


def _start(problem: ContactProblem, warm_start: Solution | None) -> Candidate | None:
    if warm_start is None:
        return None
    shapes = ((problem.dimension,), (problem.contacts,), (problem.ties,))
    values = (warm_start.displacement, warm_start.normal_force, warm_start.tie_force)
    if tuple(value.shape for value in values) != shapes:
        raise InvalidProblem(f"warm_start: expected a solution of {problem!r}, got one of {warm_start.problem!r}")
    return Candidate(*values)


def _refuse_unsupported(problem: ContactProblem, method: Method, settings: Settings, algorithm: str | None) -> None:
    unknown = sorted(set(settings.options) - set(method.options))
    if unknown:
        known = ", ".join(method.options) or "none"
        raise InvalidProblem(f"{method.name}: unknown option {unknown[0]!r}; its own options: {known}")
    missing = [name for name in method.required if settings.options.get(name) is None]
    if missing:
        raise InvalidProblem(f"{method.name}: {missing[0]} has no default, state it: solve(..., {missing[0]}=...)")
    if problem.frictional:
        raise Unsupported(
            f"{method.name}: Coulomb friction (certify() judges it, no algorithm of this version solves it)"
        )
    if algorithm is not None:
        raise Unsupported(
            f"{method.name}: algorithm={algorithm!r} is an outer law of friction, and this problem has none"
        )


def _run(problem: ContactProblem, method: Method, settings: Settings, way: Condensation, wanted: bool | str) -> _Found:
    """The method's candidate on the condensed problem, or on the whole one."""
    if not problem.contacts and not problem.ties:
        return _linear(problem, way)
    # Condensed, motions that nothing drives or resists are held: with them "auto" condenses even where nothing lies
    # inside.
    smaller = len(way.retained) < problem.dimension or way.rigid.count > 0
    condensed = smaller if wanted == "auto" else bool(wanted)
    if not condensed:
        return _Found(problem, _run_scaled(problem, method, settings), way, None)
    load, inner = way.reduce_load(problem.load)
    start = settings.warm_start
    if start is not None:
        settings = replace(settings, warm_start=way.restrict_candidate(start))
    reduced = way.reduced_problem(problem, load, inner)
    return _Found(reduced, _run_scaled(reduced, method, settings), way, inner)


def _linear(problem: ContactProblem, way: Condensation) -> _Found:
    """Without contacts and ties there is one linear system and nothing to choose."""
    none = np.zeros(0)
    load, inner = way.reduce_load(problem.load)
    x, _, _ = saddle_point(way, np.zeros(0, dtype=np.intp)).solve(load, none, none)
    reduced = way.reduced_problem(problem, load, inner)
    return _Found(reduced, Candidate(x, none, none, status="a linear system"), way, inner)


def _run_scaled(problem: ContactProblem, method: Method, settings: Settings) -> Candidate:
    if not method.scale:
        return method.solve(problem, settings)
    twin, scaling = nondimensional(problem)
    if settings.warm_start is not None:
        settings = replace(settings, warm_start=scaling.scale(settings.warm_start))
    return scaling.unscale(method.solve(twin, settings))


def _polished(problem: ContactProblem, method: Method, found: _Found) -> _Final | None:
    """The refined answer on the candidate's contact set, or None where its signs do not hold."""
    candidate, way = found.candidate, found.way
    if not _finite(candidate):
        return None
    closed = closed_contacts(found.shown, way, candidate.displacement, candidate.normal_force)
    answer, corrections, holds = polish_set(problem, way, closed, method.corrections)
    if not holds:
        return None
    answer, free = least_displacement(problem, way, answer)
    motions = tuple(_free_motion(problem, direction) for direction in free.T)
    return _Final(*without_noise(problem, way, answer), motions, corrections, polished=True)


def _as_it_came(problem: ContactProblem, found: _Found) -> _Final:
    """The candidate, its free motions put to rest as far as they are free."""
    candidate = found.expanded
    u, force, tie = candidate.displacement, candidate.normal_force, candidate.tie_force
    if not _finite(candidate):
        return _Final(u, force, tie, ())
    shift, free = shift_to_least_norm(problem, found.way, Answer(u, force, None, tie))
    return _Final(u + shift, force, tie, tuple(_free_motion(problem, direction) for direction in free.T))


def _finite(candidate: Candidate) -> bool:
    return all(
        np.all(np.isfinite(part)) for part in (candidate.displacement, candidate.normal_force, candidate.tie_force)
    )


def _free_motion(problem: ContactProblem, direction: Vector) -> FreeMotion:
    direction = direction / direction[np.argmax(abs(direction))]
    return FreeMotion(direction, describe_motion(problem, direction))


def _solution(
    problem: ContactProblem, method: Method, found: _Found, final: _Final, meter: _Meter, started: float
) -> Solution:
    answered = time.perf_counter()
    no_friction = None if problem.slip_origin is None else np.zeros_like(problem.slip_origin)
    certificate = certify(problem, final.displacement, final.normal_force, no_friction, final.tie_force)
    certified = time.perf_counter()
    # The active-set method's own answer is the set; what came before its refinement is no other method's answer.
    raw = _raw(problem, found.expanded) if final.polished and method.kind != "active set" else None
    return Solution(
        problem=problem,
        displacement=final.displacement,
        normal_force=final.normal_force,
        friction_force=no_friction,
        tie_force=final.tie_force,
        contact_status=contact_status(problem, certificate, None),
        free_motions=final.free_motions,
        certificate=certificate,
        method=method.name,
        seconds=certified - started,
        certify_seconds=certified - answered,
        work=meter.read(found.candidate.iterations, final.corrections),
        raw=raw,
        history=found.candidate.history,
    )


def _raw(problem: ContactProblem, candidate: Candidate) -> Raw:
    no_friction = None if problem.slip_origin is None else np.zeros_like(problem.slip_origin)
    values = (candidate.displacement, candidate.normal_force, candidate.tie_force)
    certificate = certify(problem, values[0], values[1], no_friction, values[2])
    return Raw(*values, claimed=candidate.claimed, status=candidate.status, certificate=certificate)
