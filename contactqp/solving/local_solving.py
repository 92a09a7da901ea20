"""Solve a local problem: scale it, run an algorithm or enumerate, refine by Newton's method, and certify.

Enumeration takes all combinations of open, stick, slip either way, in the plane. With r_N = l_N, r_T = -l_T,
u_N = g - N x and u_T = T x - o, the local form u = W r + q + V l gives base and slope of
`contactqp.solving.friction.enumeration`, and V'r + R l + s = 0 its conditions H y = h. W need not be symmetric.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import nullcontext
from typing import Any

import numpy as np

from contactqp.certificate.local_certificate import MeasuredForces, measured_forces, not_finite
from contactqp.certificate.other_answers import DISPLACEMENT_ROUNDING
from contactqp.errors import (
    InvalidProblem,
    NoEquilibrium,
    NotCertified,
    NotConverged,
    SeveralEquilibria,
    Unsupported,
    shown,
)
from contactqp.linalg.delassus import velocity_of
from contactqp.model.arrays import (
    THREADS_PAY,
    Array,
    Vector,
    in_any_time,
    on_one_thread,
    own_floating_point,
    stated_limit,
    time_is_up,
    within_time,
)
from contactqp.model.local_problem import LocalProblem, LocalSolution, local_status
from contactqp.solving.friction.alart_curnier import newton
from contactqp.solving.friction.algorithms import ALGORITHMS, Outcome, run_algorithm, run_any
from contactqp.solving.friction.conic import refuse_penetrated, refuse_unbalanced
from contactqp.solving.friction.enumeration import Combinations, refuse_many
from contactqp.solving.friction.exact_enumeration import (
    MOST_PROVEN,
    NONE_AT_ALL,
    NONE_IN_FLOATS,
    SEVERAL,
    has_local_equilibrium,
)
from contactqp.solving.friction.local_form import Iterate, LocalForm
from contactqp.solving.methods import DEFAULT_METHOD, POLYGON_OPTIONS, Settings, algorithm_name, find, refuse_arguments

ENUMERATION = "enumeration"
# The size from which on dense systems are run on one thread.
WORTH_ONE_THREAD = 100
# Scaled errors this small are worth a certificate.
WORTH_JUDGING = 1e-6
# Combinations that violate the law by less than this may be answers within rounding.
NEAR_THE_LAW = 1e-6


@own_floating_point
def solve_local(
    problem: LocalProblem,
    method: str = DEFAULT_METHOD,
    *,
    tolerance: float = 1e-9,
    polish: bool = True,
    time_limit: float | None = None,
    max_iter: int | None = None,
    warm_start: Any = None,
    algorithm: str | None = None,
    **options: Any,
) -> LocalSolution:
    """Solve a frictional problem in local form for forces and velocities.

    Parameters
    ----------
    problem : LocalProblem
    method, tolerance, polish, time_limit, max_iter, algorithm, **options
        As in `contactqp.solve`; a `method` other than the default one takes the convex steps of "aclm" unless an
        `algorithm` is named.
    warm_start : LocalSolution, optional
        The solution of a problem with the same numbers of contacts and joints.

    Raises
    ------
    NoEquilibrium
        Enumeration, if asked for or as the last resort in the plane, finds no answer; or no forces balance the load or
        open all contacts.
    SeveralEquilibria
        Enumeration was asked for and finds several answers.
    NotConverged
        No algorithm found forces that pass `tolerance`; `solution` holds the best.
    NotCertified
        The algorithm was not to be polished, and its answer does not pass.
    BackendMissing, BackendFailed, Unsupported, InvalidProblem
        The convex method is missing, fails or cannot do this; or an argument is wrong.
    """
    refuse_arguments(tolerance, "auto", polish, time_limit, max_iter)
    if algorithm is None and method != DEFAULT_METHOD:
        algorithm = "aclm"
    if algorithm is not None and algorithm not in (*ALGORITHMS, ENUMERATION):
        names = ", ".join((*ALGORITHMS, ENUMERATION))
        raise InvalidProblem(f"algorithm: expected one of {names} or None, got {shown(algorithm)}")
    _refuse_options(method, algorithm, options)
    settings = Settings(tolerance, max_iter, time_limit, None, options)
    with nullcontext() if time_limit is None else within_time(time_limit):
        if algorithm == ENUMERATION:
            return _enumerated(problem, tolerance, only=True)
        return _solved(problem, method, algorithm, settings, warm_start, polish)


def _solved(
    problem: LocalProblem, method: str, algorithm: str | None, settings: Settings, warm_start: Any, polish: bool
) -> LocalSolution:
    """Run an algorithm, or one after another, and certify the last iterate; arguments have been checked."""
    began, tolerance = time.perf_counter(), settings.tolerance
    form = LocalForm(problem)
    start = Iterate.nothing(form)
    if warm_start is not None:
        if not isinstance(warm_start, LocalSolution):
            raise InvalidProblem(f"warm_start: expected a LocalSolution, got {type(warm_start).__name__}")
        if warm_start.force.shape != (form.m, form.d) or len(warm_start.joint_force) != form.joints:
            raise InvalidProblem("warm_start: expected a solution of a problem with the same contacts and joints")
        start = Iterate.at(form, form.scaled(warm_start.force), form.joint_force(form.scaled(warm_start.force)))

    judge = _Judge(form, tolerance)

    def accepted(iterate: Iterate) -> bool:
        if not iterate.error <= max(WORTH_JUDGING, 100 * tolerance) * iterate.size:
            return False
        return judge.passes(iterate)

    with on_one_thread() if WORTH_ONE_THREAD <= len(form.q) < THREADS_PAY else nullcontext():
        if algorithm is None:
            refuse_unbalanced(form)
            outcome = run_any(form, settings, start, accepted, lambda: refuse_penetrated(form))
        else:
            outcome = run_algorithm(form, ALGORITHMS[algorithm], find(method), settings, start, accepted, polish)
    with in_any_time():
        solution = judge.solution(outcome, began)
    if outcome.accepted:
        return solution
    if algorithm is None and not time_is_up() and not_enumerated(form) is None:
        return _enumerated(problem, tolerance, only=False)
    late = f"stopped at the time limit of {stated_limit(settings.time_limit)}; " if time_is_up() else ""
    reason = f"{outcome.name}: {late}{'; '.join(solution.certificate.failures)}{_floor(outcome)}"
    if polish:
        count = outcome.iterate.iterations
        raise NotConverged(f"{reason} (after {count} iterations)", outcome.iterate.history, solution)
    raise NotCertified(reason, solution)


def local_equilibria(problem: LocalProblem, tolerance: float = 1e-9) -> tuple[LocalSolution, ...]:
    """Return every answer of a local problem in the plane with at most eight contacts, one for each velocity.

    Raises Unsupported: the problem is in space, or has more contacts; NotConverged: no answer passes `tolerance`, and
    some nearly do, or the time is up; `solution` is then the nearest one so far.
    """
    began, form, found = time.perf_counter(), LocalForm(problem), list[LocalSolution]()
    judge = _Judge(form, tolerance)
    try:
        for iterate in enumerated(form):
            found.append(judge.solution(Outcome(iterate, ENUMERATION, True), began))
    except NotConverged as late:
        late.solution = min(found, key=lambda solution: solution.certificate.natural_map, default=None)
        raise
    passed = tuple(solution for solution in found if solution.certificate.passed)
    near = min(found, key=lambda solution: solution.certificate.natural_map, default=None)
    if not passed and near is not None and near.certificate.natural_map <= NEAR_THE_LAW:
        raise NotConverged(f"enumeration: {'; '.join(near.certificate.failures)}", (), near)
    return passed


def _enumerated(problem: LocalProblem, tolerance: float, only: bool) -> LocalSolution:
    """Return the first answer of the enumeration; with `only`, raise SeveralEquilibria if there are several."""
    found = local_equilibria(problem, tolerance)
    if not found:
        if problem.contacts > MOST_PROVEN:
            raise NotConverged(
                f"{NONE_IN_FLOATS}; that there is none is proven in rational numbers up to {MOST_PROVEN} contacts"
            )
        if has_local_equilibrium(problem):
            raise NotConverged(f"{NONE_IN_FLOATS}, and in rational numbers there is one")
        raise NoEquilibrium(NONE_AT_ALL)
    if only and len(found) > 1:
        listed = "; ".join(", ".join(f"r_N = {force:.6g}" for force in one.force[:, 0].tolist()) for one in found)
        raise SeveralEquilibria(SEVERAL.format(len(found), listed))
    return found[0]


def _refuse_options(method: str, algorithm: str | None, options: dict[str, Any]) -> None:
    convex = algorithm is not None and algorithm != ENUMERATION and ALGORITHMS[algorithm].convex
    known = (*POLYGON_OPTIONS, *find(method).options) if convex else ()
    unknown = sorted(set(options) - set(known))
    if unknown:
        whose = algorithm_name(str(algorithm), method) if convex else (algorithm or "friction")
        raise InvalidProblem(f"{whose}: unknown option {unknown[0]!r}; its own options: {', '.join(known) or 'none'}")


def _floor(outcome: Outcome) -> str:
    """Return the message on the asymmetric part of delassus, which convex steps do not see, or an empty string."""
    if outcome.steps is None or not outcome.steps.asymmetry:
        return ""
    part = outcome.steps.asymmetry
    return f"; a minimisation sees the symmetric part of delassus only, which is off by {part:.2g} of it"


class _Judge:
    """Judges the iterates of a form. The last one's figures are kept: the iterate that is accepted is certified too."""

    def __init__(self, form: LocalForm, tolerance: float) -> None:
        self._form, self._problem, self._tolerance = form, form.problem, tolerance
        self._last: tuple[Array, Array, Array, MeasuredForces | None] | None = None

    def _measured(self, iterate: Iterate) -> tuple[Array, Array, MeasuredForces | None]:
        """Return the forces of contacts and joints in the problem's units, and what has been measured of them."""
        if self._last is None or self._last[0] is not iterate.force:
            force, joint = self._form.unscaled(iterate.force, iterate.joint_force)
            measured = measured_forces(self._problem, force, joint, self._tolerance)
            self._last = iterate.force, force, joint, measured
        return self._last[1:]

    def passes(self, iterate: Iterate) -> bool:
        """Return whether every figure of an iterate is within the tolerance."""
        measured = self._measured(iterate)[2]
        return measured is not None and measured.verdict.passed

    def solution(self, outcome: Outcome, began: float) -> LocalSolution:
        """Return the solution that an outcome is, certified."""
        force, joint, measured = self._measured(outcome.iterate)
        certificate = not_finite(self._problem, self._tolerance) if measured is None else measured.verdict
        return LocalSolution(
            problem=self._problem,
            force=force,
            velocity=velocity_of(self._problem, force, joint) if measured is None else measured.velocity,
            joint_force=joint,
            contact_status=local_status(self._problem, certificate),
            certificate=certificate,
            method=outcome.name,
            seconds=time.perf_counter() - began,
            iterations=outcome.iterate.iterations,
            history=outcome.iterate.history,
        )


# Answers are equal if their velocities agree to this part of the sizes of their terms, which are at least the second
# part of the largest: together, the rounding of displacements.
SAME_VELOCITY = 1e-8
NONE_BESIDE = DISPLACEMENT_ROUNDING / SAME_VELOCITY


def enumerated(form: LocalForm) -> Iterator[Iterate]:
    """Yield the answers of all combinations whose signs may hold, refined by Newton's method, each velocity once.

    Raises Unsupported: the problem is in space, or has more than eight contacts.
    """
    if (reason := not_enumerated(form)) is not None:
        raise Unsupported(reason)
    seen: list[tuple[Vector, Vector]] = []  # W r + V l, and the sizes of the terms of its entries
    for count, y in enumerate(y for _, y in _combinations(form).plausible()):
        force = np.stack([y[: form.m], -y[form.m : 2 * form.m]], axis=1)
        found = newton(form, Iterate.at(form, force, y[2 * form.m :]))
        answers = form.velocity(found.force, found.joint_force).ravel() - form.q
        sizes = abs(form.W) @ abs(found.force).ravel() + abs(form.V) @ abs(found.joint_force)
        sizes += NONE_BESIDE * np.max(sizes, initial=0.0)  # nothing but rounding may meet in an entry
        # Answers whose violation exceeds the difference of velocities may be replaced by a better one.
        if found.error <= SAME_VELOCITY * max(1.0, float(np.max(sizes, initial=0.0))):
            if any(np.all(abs(answers - u) <= SAME_VELOCITY * np.maximum(sizes, size)) for u, size in seen):
                continue
            seen.append((answers, sizes))
        yield Iterate(found.force, found.joint_force, found.error, count + 1)


def not_enumerated(form: LocalForm) -> str | None:
    """Return the reason why the combinations of a problem are not listed, or None."""
    if form.d > 2:
        return "enumeration: the problem is in space; slip directions in space cannot be listed"
    return refuse_many(form.m)


def _combinations(form: LocalForm) -> Combinations:
    W = form.W.toarray() if form.sparse else form.W
    signs = np.r_[np.ones(form.m), -np.ones(form.m)]
    order = np.r_[2 * np.arange(form.m), 2 * np.arange(form.m) + 1]  # all normals, then all tangents
    V = form.V[order]
    # u in the order and the signs of r = (l_N, -l_T); then N x - g = -u_N, T x - o = u_T.
    compliance = np.hstack([W[np.ix_(order, order)] * signs, V])
    return Combinations(
        coefficient=form.mu,
        base=-signs * form.q[order],
        slope=-signs[:, None] * compliance,
        target=np.zeros(2 * form.m),
        fixed=np.hstack([V.T * signs, form.R]),
        fixed_right=-form.s,
        nothing=DISPLACEMENT_ROUNDING,
    )
