"""Our own method: the primal-dual active set on the Delassus operator, safeguarded by a finite dual active-set method.

The primal-dual active set (Hintermueller, Ito and Kunisch 2003) takes the contacts with W_ii l_i > gap_i as closed,
solves, and repeats; few steps, and many contacts change in each. Where it comes back to a set it has seen, Goldfarb and
Idnani's method, which ends after finitely many steps, takes over. Bodies held by contact alone are anchored by soft
springs whose force a proximal iteration removes; every pass ends by solving the true equilibrium on its set.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from contactqp.errors import NotConverged
from contactqp.linalg.condensation import Condensation, condense
from contactqp.linalg.dense import BALANCED, OPERATOR_ROUNDING, Delassus, lower_factor, saddle_point
from contactqp.linalg.equilibration import nondimensional
from contactqp.linalg.existence import touch_one_each
from contactqp.linalg.floating import UNRESISTED
from contactqp.linalg.nonnegative import Infeasible, dual_active_set
from contactqp.linalg.runtime import lapack
from contactqp.model.arrays import Array, Indices, Mask, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Candidate
from contactqp.solving.methods.method import ACTIVE_SET, Method, Settings

# After this many steps the sets alternate, and the safeguard is cheaper.
PRIMAL_DUAL_STEPS = 40
PROXIMAL_STEPS = 60
# Entries of a row of unit length along a motion that are below this are set to zero; HiGHS drops them, too.
UNFELT = 1e-9


def solve_active_set(problem: ContactProblem, settings: Settings) -> Candidate:
    """Find the contact set of the solution, and the answer on it.

    Raises NotConverged: no set was found: the constraints conflict, or `max_iter` steps (by default 50 for each contact
    and 200 more) did not suffice.
    """
    condensation = condense(problem)
    found = solve_condensed(problem, condensation, settings, problem)
    _, inner = condensation.reduce_load(problem.load)
    whole = replace(found.answer, displacement=condensation.expand(found.answer.displacement, inner))
    return replace(found, answer=whole)


def solve_condensed(
    problem: ContactProblem, condensation: Condensation, settings: Settings, shown: ContactProblem | None = None
) -> Candidate:
    """Run `solve_active_set` on a condensation; the displacement is that of the retained unknowns.

    Where no set is found, Lemke's method solves the condensed problem, or the one given as `shown`.

    Parameters
    ----------
    problem : ContactProblem
    condensation : the Condensation of the problem
    settings : limits, and the answer to start from
    shown : the problem that Lemke's method is given
    """
    load, inner = condensation.reduce_load(problem.load)
    size = condensation.reduced_size(problem, inner)
    operator = condensation.delassus
    limit = 50 * problem.contacts + 200 if settings.max_iter is None else settings.max_iter
    anchor = _rigid_answer(problem, operator, load) if condensation.rigid.count else np.zeros(len(load))
    force = np.zeros(len(operator.W))
    if settings.warm_start is not None:
        force[: problem.contacts] = settings.warm_start.answer.normal_force / operator.row_scale[: problem.contacts]
    # Contacts that appear dependent in W, which squares the differences of rows, may be independent.
    doubtful = np.zeros(0, dtype=np.intp)
    steps = 0
    before: Indices | None = None
    for _ in range(PROXIMAL_STEPS):
        if steps >= limit:
            raise NotConverged(f"active-set: no contact set was found in {steps} steps")
        free = operator.free_response(load, anchor)
        try:
            force, taken = _closed_by(operator.dual_data(problem, free), force, limit - steps)
        except Infeasible as conflict:  # or appears so by the springs of anchors or in W
            doubtful = conflict.rows[conflict.rows < problem.contacts]
            break
        steps += taken
        anchor = operator.displaced(free, force)
        closed = np.flatnonzero(force[: problem.contacts] > 0)
        answer = None
        if before is None or not np.array_equal(closed, before):  # a set that failed will fail again
            answer = _equilibrium_on(problem, condensation, operator, load, size, closed)
        if answer is not None:
            return Candidate(answer, iterations=steps)
        before = closed
        if not condensation.rigid.count:
            break
    try:
        return _without_anchors(shown or condensation.reduced_problem(problem, load, inner), settings, steps)
    except NotConverged:
        answer = _equilibrium_on(problem, condensation, operator, load, size, doubtful)
        if answer is None or np.any(_penetrated(condensation, problem, answer.displacement)):
            raise
        return Candidate(answer, iterations=steps)


def _without_anchors(problem: ContactProblem, settings: Settings, steps: int) -> Candidate:
    """Solve by Lemke's finite pivoting, which needs no anchors, where the range of stiffnesses is too large for
    them.
    """
    from contactqp.solving.methods.complementarity import solve_lemke

    twin, scaling = nondimensional(problem)
    candidate = scaling.unscale(solve_lemke(twin, replace(settings, warm_start=None, options={})))
    pivots = candidate.iterations or 0
    return replace(candidate, iterations=steps + pivots, status=f"by {pivots} pivots of Lemke's method")


def _rigid_answer(problem: ContactProblem, operator: Delassus, load: Vector) -> Vector:
    """Return the displacement of rigid bodies, max f'Z a over E Z a <= g, scaled, at which they are anchored.

    A stiff body may cross a wide gap under a small load, which would take many steps with the anchors at rest.
    """
    motions, scaled_load = operator.motions, load * operator.scale
    drive = motions.T @ scaled_load
    none = np.zeros(len(load))
    if not motions.shape[1] or np.linalg.norm(drive) <= OPERATOR_ROUNDING * np.linalg.norm(scaled_load):
        return none
    rows, m = operator.rows, problem.contacts
    length = np.linalg.norm(rows, axis=1)
    limit = np.concatenate([problem.gap, problem.tie_value]) / length
    reach = abs(limit).max(initial=0.0)
    if reach == 0:
        return none
    rows = (rows / length[:, None]) @ motions
    rows[abs(rows) < UNFELT] = 0.0
    if not problem.ties and touch_one_each(rows):
        return np.asarray(reach * (motions @ _furthest(drive, rows, limit / reach)))
    from scipy.optimize import linprog

    answer = linprog(
        -drive / np.linalg.norm(drive),
        A_ub=rows[:m],
        b_ub=limit[:m] / reach,
        A_eq=rows[m:] if problem.ties else None,
        b_eq=limit[m:] / reach if problem.ties else None,
        bounds=(None, None),
        method="highs",
    )
    return none if answer.x is None else np.asarray(reach * (motions @ answer.x))


def _furthest(drive: Vector, rows: Array, limit: Vector) -> Vector:
    """Maximise d'a over R a <= g, each row bounding one coordinate; zero where that has no bounded solution."""
    bound = np.divide(limit[:, None], rows, out=np.full(rows.shape, np.nan), where=rows != 0)
    most = np.min(np.where(rows > 0, bound, np.inf), axis=0, initial=np.inf)
    least = np.max(np.where(rows < 0, bound, -np.inf), axis=0, initial=-np.inf)
    aim = np.where(drive > 0, most, np.where(drive < 0, least, np.clip(0.0, least, most)))
    nowhere = np.any(least > most) or not np.all(np.isfinite(aim)) or np.any(limit[~np.any(rows, axis=1)] < 0)
    return np.zeros(len(drive)) if nowhere else aim


def _closed_by(data: tuple[Array, Vector, Mask, Vector], force: Vector, limit: int) -> tuple[Vector, int]:
    """Return scaled forces of the anchored problem by primal-dual steps, then by the finite method where these cycle.

    `data` are those of `Delassus.dual_data`.
    """
    force, steps, done = _primal_dual(*data, force, min(limit, PRIMAL_DUAL_STEPS))
    if done:
        return force, steps
    force, more, done = dual_active_set(*data, limit - steps)
    if not done:
        raise NotConverged(f"active-set: the contact set still changed after {steps + more} steps")
    return force, steps + more


def _primal_dual(
    W: Array,
    excess: Vector,
    tied: Mask,
    tolerance: Vector,
    force: Vector,
    limit: int,
) -> tuple[Vector, int, bool]:
    """Repeat l_B = W_BB^-1 h_B on the contacts B with l + (h - W l) > 0; return l, the steps, and whether B stayed."""
    seen: set[bytes] = set()
    for step in range(1, limit + 1):
        closed = tied | (force + (excess - W @ force) > tolerance)
        if closed.tobytes() in seen:
            return force, step, False
        seen.add(closed.tobytes())
        B = closed.nonzero()[0]
        force = np.zeros(len(W))
        if B.size:
            lower = lower_factor(W[B[:, None], B])
            # With redundant contacts the finite method chooses which of them to keep.
            if lower is None or lower.diagonal().min() ** 2 < OPERATOR_ROUNDING:
                return force, step, False
            force[B] = lapack().dpotrs(lower, excess[B], lower=True)[0]
        penetrated = np.where(closed, 0.0, excess - W @ force)
        if (penetrated <= tolerance).all() and (force[~tied] >= 0).all():
            return force, step, True
    return force, limit, False


def _equilibrium_on(
    problem: ContactProblem,
    condensation: Condensation,
    operator: Delassus,
    load: Vector,
    size: Vector,
    closed: Indices,
) -> Answer | None:
    """Return x, l_N and tie forces on a set without anchors; None where signs fail or a free motion is driven."""
    saddle = saddle_point(condensation, closed)
    x, on_set, tie_force = saddle.solve(load, problem.gap[closed], problem.tie_value)
    if saddle.free.shape[1]:
        carried = condensation.normal[closed].T @ on_set + condensation.tie.T @ tie_force
        if np.any(saddle.drive(load - carried, size)):
            return None
    force = np.zeros(problem.contacts)
    force[closed] = on_set
    push = force / operator.row_scale[: problem.contacts]
    tension = max(OPERATOR_ROUNDING * abs(push).max(initial=0.0), BALANCED * np.max(size * operator.scale, initial=0.0))
    if np.any(push < -tension):
        return None
    # Where nothing floats, the set with anchors is final. Contacts that free motions open are opened by polishing.
    if condensation.rigid.count:
        penetrated = _penetrated(condensation, problem, x) & ~_moved(condensation, operator, saddle.free)
        penetrated[closed] = False
        if penetrated.any():
            return None
    return Answer(x, np.maximum(force, 0.0), None, tie_force)


def _penetrated(condensation: Condensation, problem: ContactProblem, x: Vector) -> Mask:
    """Return flags (m,) of contacts that the contact unknowns x penetrate by more than rounding."""
    length = abs(condensation.normal) @ abs(x) + abs(problem.gap)
    return np.asarray(condensation.normal @ x - problem.gap > OPERATOR_ROUNDING * length)


def _moved(condensation: Condensation, operator: Delassus, free: Array) -> Mask:
    """Return a mask (m,) of contacts that the orthonormal, scaled motions (p, q) left free by the set displace."""
    rows = operator.rows[: len(condensation.normal)]
    felt = np.linalg.norm(rows @ free, axis=1)
    return np.asarray(felt > UNRESISTED * np.linalg.norm(rows, axis=1))


METHODS = (
    Method(
        name="active-set",
        kind=ACTIVE_SET,
        solve=solve_active_set,
        solve_condensed=solve_condensed,
        polish=True,
        corrections=50,
        note="finite: primal-dual steps, safeguarded by a dual active-set method",
    ),
)
