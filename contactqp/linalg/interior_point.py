"""Identify closed contacts by Newton steps along the central path, and cross over to a vertex.

With slacks s = g - E_N u the points of the central path solve

    K u + E_N' l + A' nu = f,    E_N u + s = g,    A u = b,    s_i l_i = t,    s, l > 0,

and converge, as t goes to zero, to the centre of the set of solutions, at which either the force or the slack of a
contact is positive, if it is in any solution. A backend's answer is a point near the path with a t of its tolerance.
Mehrotra's steps (1992) from there reduce t by orders of magnitude each, until forces and slacks are clearly separated.

If more contacts close than there are independent rows, an interior point distributes the load over all of them, and
rounding of the data makes their gaps contradict each other. A linear program, scaled by the contradiction, then goes to
a vertex (the crossover of interior point methods, Megiddo 1991; the scaling is that of iterative refinement, Gleixner,
Steffy and Wolter 2016).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import BackendFailed
from contactqp.linalg.equilibration import equilibrated, mostly_bare
from contactqp.linalg.extended import Extended, ExtendedAnswer, extend, extended_rows, residuals_of
from contactqp.linalg.factorization import with_added_diagonal
from contactqp.linalg.least_norm import by_corrections, by_dual_steps, by_single_changes, carried_by_rows
from contactqp.linalg.nonnegative import CARRIES, given_rows, highs
from contactqp.linalg.pardiso import INDEFINITE, elimination_order
from contactqp.linalg.schur import factorised
from contactqp.linalg.sparse_saddle import (
    MET_TOGETHER,
    ClosedState,
    Effort,
    by_pivots,
    nearest_state,
    solved_on,
    with_right_signs,
)
from contactqp.model.arrays import EPS, TINY, Indices, Mask, Vector, refuse_late
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer

# The most displacement of unknowns, in units of the contradiction, and the reach of open contacts.
FARTHEST = 1e3
# The most factorisations at a vertex of conflicting rows; a right vertex needs few.
AT_A_VERTEX = 20
# Forces above this multiple of the residual are kept, and the number of times the rest is balanced again.
LARGE_FORCE, ROUNDS = 1e6, 6


def without_conflict(state: ClosedState, effort: Effort, met: float = MET_TOGETHER) -> ClosedState:
    """Return a state whose closed contacts are met to this part of the largest length, else the same state, marked."""
    if not state.solved or state.length_residual <= met or state.in_conflict:
        return state
    together = by_pivots(state, effort)
    if together.holds and together.length_residual <= met:
        return together
    most, enough = effort.most, effort.factorisations + AT_A_VERTEX
    effort.most = min(most, enough)
    vertex = vertex_near(state.problem, state.answer, state.length * state.length_residual, effort)
    effort.most = most
    met, balanced = (max(part, state.force_residual) for part in (met, MET_TOGETHER))
    if vertex is None or not (vertex.holds and vertex.length_residual <= met and vertex.force_residual <= balanced):
        return replace(state, in_conflict=most >= enough)
    return vertex


def vertex_near(problem: ContactProblem, answer: ExtendedAnswer, length: float, effort: Effort) -> ClosedState | None:
    """Return the state at the vertex nearest to an answer, in units of its possible error.

    With the gaps g - E u and tie residuals b - A u of the answer, the change v of u in units of this length d solves

        minimise  (K u - f)' v    subject to    E v <= (g - E u) / d,    A v = (b - A u) / d,    |v_j| <= FARTHEST

    whose multipliers are the forces; contacts with zero force may open. None is returned where there are no contacts, d
    underflows, or the linear program has no solution.

    Parameters
    ----------
    problem : equilibrated
    answer : ExtendedAnswer
    length : float [length], d
    effort : counts factorisations and back-substitutions
    """
    if not problem.contacts or length < TINY:
        return None  # ties determine everything
    left = residuals_of(extended_rows(problem), problem, answer)
    gap, tie = left.gap.double() / length, left.tie.double() / length
    near = np.flatnonzero(gap <= FARTHEST)
    carried = carried_by_rows(problem, answer)
    size = float(np.max(abs(carried), initial=0.0)) or 1.0
    found = highs(
        -carried / size,
        **given_rows("ub", problem.normal[near], gap[near]),
        **given_rows("eq", problem.tie, tie),
        bounds=(-FARTHEST, FARTHEST),
    )
    if found is None:
        return None
    force, closed = np.zeros(problem.contacts), np.zeros(problem.contacts, dtype=bool)
    force[near] = -size * found.ineqlin.marginals if len(near) else 0.0
    closed[near] = force[near] > 0
    of_ties = -size * found.eqlin.marginals if problem.ties else np.zeros(0)
    start = ExtendedAnswer(answer.displacement + extend(length * found.x), extend(force), None, extend(of_ties))
    return nearest_state(problem, closed, start, effort)


def refined(state: ClosedState, effort: Effort) -> ClosedState:
    """Return a state in which contacts also carry the residual of a state, if there is one.

    At a degenerate vertex forces far below the largest determine the closed contacts, which neither an interior point
    nor a linear program in the units of the problem resolves. In units d of the residual r = f - K u - E'l - A'nu and D
    of a length, the change v of u solves

        minimise  -(r + E_w' l_w)' v / d    subject to    E_s v = (g - E u)_s / D,    E_w v <= (g - E u)_w / D,
                                                          A v = (b - A u) / D,    |v_j| <= FARTHEST, d / (D K_jj)

    s being the contacts whose forces are large beside d, w the others, whose forces the multipliers replace.
    """
    problem = state.problem
    for _ in range(ROUNDS):
        if state.holds and not state.driven:
            break
        refuse_late("a vertex was found")
        force, length = state.left.force.double(), state.length / FARTHEST
        size = float(np.max(abs(force)))
        units = size > 0 and length >= TINY
        start = _vertex_in_units(state, size, length) if units else None
        if start is None:
            break
        closed = start.normal_force.double() > 0
        after = with_right_signs(solved_on(problem, closed, start, effort), effort)
        if not after.holds or (state.holds and not after.better_than(state)):
            break
        state = after
    return state


def _vertex_in_units(state: ClosedState, size: float, length: float) -> ExtendedAnswer | None:
    """Return the answer of the linear program of `refined` in units of a force and a length."""
    problem, answer = state.problem, state.answer
    carried, gap = answer.normal_force.double(), state.left.gap.double() / length
    large = carried > LARGE_FORCE * size
    kept, others = np.flatnonzero(large), np.flatnonzero(~large)
    cost = -state.left.force.double() / size - problem.normal[others].T @ (carried[others] / size)
    equal = sp.vstack([problem.normal[kept], problem.tie], format="csr")
    yields = size / length / np.where(problem.diagonal > 0, problem.diagonal, TINY)
    farthest = np.minimum(FARTHEST, yields)
    found = highs(
        cost,
        **given_rows("ub", problem.normal[others], _felt(gap[others])),
        **given_rows("eq", equal, _felt(np.concatenate([gap[kept], state.left.tie.double() / length]))),
        bounds=np.column_stack([-_felt(farthest), _felt(farthest)]),
    )
    if found is None:
        return None
    change, tie = np.zeros(problem.contacts), -size * found.eqlin.marginals if equal.shape[0] else np.zeros(0)
    change[others] = -size * found.ineqlin.marginals - carried[others] if len(others) else 0.0
    change[kept] = tie[: len(kept)]
    force = (answer.normal_force + extend(change)).positive_part()
    return ExtendedAnswer(
        answer.displacement + extend(length * found.x), force, None, answer.tie_force + extend(tie[len(kept) :])
    )


def _felt(limits: Vector) -> Vector:
    """Return limits of a linear program, with those below its tolerance, which may make it infeasible, set to zero."""
    return np.where(abs(limits) > CARRIES, limits, 0.0)


# The assumed relative error of a backend's displacement.
BACKEND_IS_OFF = 1e-9
# The regularisation of a step's matrix, removed by refinement in double precision.
REGULARISATION, REFINEMENTS = 1e-10, 2
STEPS = 25
# The fraction of the step to the boundary of positive forces and slacks.
SHORT_OF_ZERO = 0.99
# The largest centring parameter of a predictor-corrector step.
MOST_CENTRED = 1e3
# The iteration ends if the step length falls below this.
SHORTEST_STEP = 1e-6
# The complementarity l's, relative to the energies, below which forces and slacks are separated.
SEPARATED = 1e-22
# They are also separated if in a step one of each pair falls below the first part and the other stays above the second
# (the indicators of El-Bakry, Tapia and Zhang 1994, with limits 0 and 1).
VANISHES, STAYS = 0.1, 0.5
# The least forces and slacks of the start, relative to the geometric mean of their largest products.
LEAST = 1e-3

Step = tuple[Vector, Vector, Vector]


@dataclass(frozen=True, eq=False)
class CentralPoint:
    """A point near the central path of an equilibrated problem."""

    displacement: Vector  # (n,)
    force: Vector  # (m,) l > 0
    slack: Vector  # (m,) s > 0
    tie_force: Vector  # (k,)

    @property
    def closed(self) -> Mask:
        """Return the contacts whose force exceeds their slack (m,)."""
        return np.asarray(self.force > self.slack)

    @property
    def answer(self) -> Answer:
        """Return the answer of the point."""
        return Answer(self.displacement, np.where(self.closed, self.force, 0.0), None, self.tie_force)

    @property
    def work(self) -> float:
        """Return the complementarity l's of forces l and slacks s, which measures the distance from the solution."""
        return float(self.force @ self.slack)


def settled(problem: ContactProblem, answer: Answer, effort: Effort, driven: bool = False) -> ClosedState:
    """Return the solution of an equilibrated problem nearest to an answer; `holds` tells whether it is one.

    The closed contacts are tried in this order: those of the answer; those after Newton steps along the central path;
    for programs, those of a dual active set from either; those of the vertex near the answer. With `driven`, further
    contacts close if the load drives a free motion. At last contacts are changed one by one (`by_single_changes`).

    Parameters
    ----------
    problem : equilibrated
    answer : Answer
    effort : counts factorisations and back-substitutions
    driven : whether contacts are closed in addition, as above
    """
    if (known := _remembered(problem, answer)) is not None:
        return known
    state = nearest_state(problem, _closed_in(problem, answer), start := ExtendedAnswer.of(answer), effort)
    if state.holds or not problem.contacts:
        return state if state.holds else by_pivots(state, effort)
    point = sharpened(problem, answer, effort)
    middle = ExtendedAnswer.of(point.answer)
    state = nearest_state(problem, point.closed, middle, effort, driven)
    vertex = None if state.holds else vertex_near(problem, start, _off(problem, answer), effort)
    state = state if vertex is None else vertex
    if state.holds or not mostly_bare(problem):
        return state if state.holds else _by_pivots(problem, answer, state, effort)
    state, own = refined(state, effort), _closed_in(problem, answer)
    if not state.holds:
        state = by_corrections(ClosedState.of(problem, own, start), effort)
    for closed, near in ((point.closed, middle), (own, start)):
        if not state.holds:
            state = by_dual_steps(solved_on(problem, closed, near, effort), effort)
    return state


def _by_pivots(problem: ContactProblem, answer: Answer, failed: ClosedState, effort: Effort) -> ClosedState:
    """Return the solution for nearly dependent rows, of the `failed` state or an answer's contacts, else that state.

    Parameters
    ----------
    problem, answer, effort : as in `settled`
    failed : the state that other ways have led to
    """
    if (state := by_pivots(failed, effort)).holds:
        return state
    effort.pivots = True
    state = nearest_state(problem, _closed_in(problem, answer), start := ExtendedAnswer.of(answer), effort)
    if not state.holds:
        state = by_single_changes(solved_on(problem, _closed_in(problem, answer), start, effort), effort)
    effort.pivots = False
    return state if state.holds else failed


@dataclass(frozen=True, eq=False)
class LastSolution:
    """The solution of which a method's answer is the rounding, for the certificate of this answer."""

    given: Answer
    closed: Mask
    answer: ExtendedAnswer
    in_conflict: bool

    def is_of(self, answer: Answer) -> bool:
        """Return whether this very answer is the rounding of the solution."""
        names = ("displacement", "normal_force", "tie_force")
        return all(np.array_equal(getattr(self.given, name), getattr(answer, name)) for name in names)


def remember(state: ClosedState, given: Answer) -> None:
    """Store with an equilibrated problem the solution of which an answer is the rounding."""
    state.problem._computed.last_solution = LastSolution(given, state.closed, state.answer, state.in_conflict)


def remember_of_all_rows(
    fewer: ContactProblem,
    whole: ContactProblem,
    answers: tuple[Answer, Answer],
    shares: Any,
    kept: tuple[Indices, Indices],
) -> None:
    """Store with a problem the solution found with some of its rows, which carry all forces in it.

    Parameters
    ----------
    fewer, whole : the problem of some rows, and that of all
    answers : of `fewer` and of `whole`, in the units of the problem
    shares : (all, some) matrix with a positive entry where a contact touches when a kept one does
    kept : the contacts and the ties of `whole` that are those of `fewer`
    """
    if fewer._computed.equilibrated is None:
        return  # it was condensed
    (twin, units), (other, others) = equilibrated(fewer), equilibrated(whole)
    last: LastSolution | None = twin._computed.last_solution
    if last is None or not last.is_of(units.scale(answers[0])):
        return

    def spread(force: Extended, at: Indices, one: Vector, all_rows: Vector) -> Extended:
        """Return forces of kept rows on all rows, in other units; these are powers of two."""
        force = force.times(units.force / others.force * (all_rows[at] / one))
        hi, lo = np.zeros((2, len(all_rows)))
        hi[at], lo[at] = force.hi, force.lo
        return Extended(hi, lo)

    moved = last.answer.displacement.times(units.length / others.length * (units.unknowns / others.unknowns))
    normal = spread(last.answer.normal_force, kept[0], units.contacts, others.contacts)
    tie = spread(last.answer.tie_force, kept[1], units.ties, others.ties)
    closed = np.asarray(shares @ last.closed.astype(float) > 0)
    given, answer = others.scale(answers[1]), ExtendedAnswer(moved, normal, None, tie)
    other._computed.last_solution = LastSolution(given, closed, answer, last.in_conflict)


def _remembered(problem: ContactProblem, answer: Answer) -> ClosedState | None:
    """Return the kept solution, with its residuals formed anew, if it is that of this very answer and holds."""
    last: LastSolution | None = problem._computed.last_solution
    if last is None or not last.is_of(answer):
        return None
    state = ClosedState.of(problem, last.closed, last.answer)
    return replace(state, in_conflict=last.in_conflict) if state.holds else None


def _closed_in(problem: ContactProblem, answer: Answer) -> Mask:
    """Return the contacts whose force relative to the largest exceeds their gap relative to the largest length (m,)."""
    gap = problem.gap - problem.normal @ answer.displacement
    forces = (answer.normal_force, answer.tie_force, problem.load)
    force = max(float(abs(values).max(initial=0.0)) for values in forces)
    length = float(abs(answer.displacement).max(initial=0.0))
    return np.asarray(answer.normal_force * length > gap * force)


def _off(problem: ContactProblem, answer: Answer) -> float:
    """Return the possible error of a displacement, its penetration or the residual of ties [length]."""
    gap = problem.gap - problem.normal @ answer.displacement
    open_ties = problem.tie_value - problem.tie @ answer.displacement
    least = BACKEND_IS_OFF * float(np.max(abs(answer.displacement), initial=0.0))
    return max(float(np.max(-gap, initial=0.0)), float(np.max(abs(open_ties), initial=0.0)), least)


def solved_from(
    problem: ContactProblem, answer: Answer, effort: Effort, driven: bool = False, claimed: bool = True
) -> ClosedState:
    """Return `settled` and `refined`, at a vertex where contacts conflict.

    Parameters
    ----------
    problem, answer, effort, driven
        As in `settled`.
    claimed : whether the answer is more than a guess, of which nothing but its closed contacts is tried
    """
    if claimed:
        state = settled(problem, answer, effort, driven)
    else:
        state = nearest_state(problem, _closed_in(problem, answer), ExtendedAnswer.of(answer), effort)
    return without_conflict(refined(state, effort), effort) if claimed or state.holds else state


def sharpened(problem: ContactProblem, answer: Answer, effort: Effort) -> CentralPoint:
    """Return the point of the central path reached by Newton steps from an answer of an equilibrated problem."""
    point, system = _near_path(problem, answer), PathSystem(problem)
    for _ in range(STEPS):
        if point.work <= SEPARATED * _energies(problem, point):
            break
        try:
            after, length = _step(system, point, effort)
        except BackendFailed:
            break
        if length < SHORTEST_STEP or not np.all(np.isfinite(after.displacement)):
            break
        before, point = point, after
        if _told_apart(before, point):
            break
    return point


def _told_apart(before: CentralPoint, after: CentralPoint) -> bool:
    """Return whether in a step each contact kept one of force and slack while the other tended to zero."""
    force, slack = after.force / before.force, after.slack / before.slack
    vanishing, kept = np.where(after.closed, slack, force), np.where(after.closed, force, slack)
    return bool(np.all((before.closed == after.closed) & (vanishing <= VANISHES) & (kept >= STAYS)))


def _near_path(problem: ContactProblem, answer: Answer) -> CentralPoint:
    """Return the answer with forces and slacks raised until they are positive."""
    force, slack = answer.normal_force, problem.gap - problem.normal @ answer.displacement
    products = np.maximum(force, 0.0) * np.maximum(slack, 0.0)
    least = LEAST * np.sqrt(max(float(np.mean(products)) if len(products) else 0.0, EPS))
    return CentralPoint(answer.displacement, np.maximum(force, least), np.maximum(slack, least), answer.tie_force)


def _energies(problem: ContactProblem, point: CentralPoint) -> float:
    """Return the size of the terms of the energy at a point."""
    u = point.displacement
    return float(
        abs(u) @ (problem.stiffness_sizes @ abs(u)) + abs(problem.load) @ abs(u) + abs(problem.gap) @ point.force
    )


def _step(system: PathSystem, point: CentralPoint, effort: Effort) -> tuple[CentralPoint, float]:
    """Make a predictor-corrector step; return the next point and the step length, at most one."""
    problem, u, l, s = system.problem, point.displacement, point.force, point.slack  # noqa: E741
    solve = system.solver(s / l, effort)
    force = problem.load - problem.stiffness_rows @ u - problem.normal.T @ l - problem.tie.T @ point.tie_force
    slack, tie = problem.gap - problem.normal @ u - s, problem.tie_value - problem.tie @ u
    du, dl, _ = solve(force, slack + s, tie, False)
    ds = slack - problem.normal @ du
    reached = float((l + _until_zero(l, dl) * dl) @ (s + _until_zero(s, ds) * ds))
    mean = point.work / len(l)
    target = mean * min(reached / point.work, MOST_CENTRED) ** 3
    du, dl, dn = solve(force, slack + s - (target - dl * ds) / l, tie, True)
    ds = slack - problem.normal @ du
    a, b = (SHORT_OF_ZERO * _until_zero(values, change) for values, change in ((s, ds), (l, dl)))
    after = replace(
        point, displacement=u + a * du, slack=s + a * ds, force=l + b * dl, tie_force=point.tie_force + b * dn
    )
    return after, max(a, b)


def _until_zero(values: Vector, change: Vector) -> float:
    """Return the largest step, at most one, with which positive values stay positive."""
    return float(1.0 / max(1.0, np.max(-change / values, initial=0.0)))


class PathSystem:
    """The systems K u + E'l + A'nu = f, E u - c l = g, A u = b of steps, with compliances c (m,) of the contacts.

    Contacts of one unknown (bounds) are eliminated beforehand, which adds E_ij^2 / c_i to its stiffness.
    """

    def __init__(self, problem: ContactProblem) -> None:
        E, n = problem.normal, problem.dimension
        single = np.diff(E.indptr) == 1
        self.problem, self._bounds, self._others = problem, np.flatnonzero(single), np.flatnonzero(~single)
        starts = E.indptr[self._bounds]
        self._unknown, self._entry = E.indices[starts], E.data[starts]
        rows = sp.vstack([E[self._others], problem.tie], format="csr")
        count = rows.shape[0]
        blocks = [[problem.stiffness_rows, rows.T], [rows, sp.csr_matrix((count, count))]] if count else None
        matrix = sp.bmat(blocks, format="csr") if blocks else sp.csr_matrix(problem.stiffness_rows)
        self._matrix = sp.csc_matrix(with_added_diagonal(matrix, np.full(n + count, REGULARISATION)).T)
        columns = np.repeat(np.arange(n + count), np.diff(self._matrix.indptr))
        self._on_diagonal = np.flatnonzero(self._matrix.indices == columns)

    def solver(self, compliance: Vector, effort: Effort) -> Callable[[Vector, Vector, Vector, bool], Step]:
        """Return a function from f, g, b to u, l, nu, with optional refinement; raises BackendFailed as
        `factorised`.
        """
        problem, bounds, others, unknown, entry = self.problem, self._bounds, self._others, self._unknown, self._entry
        E, A, n, k = problem.normal, problem.tie, problem.dimension, problem.ties
        stiffer = np.bincount(unknown, entry**2 / compliance[bounds], n)
        softer = np.concatenate([compliance[others], np.zeros(k)]) + 2 * REGULARISATION
        refuse_late("the next step along the central path")
        matrix = self._matrix.copy()
        matrix.data[self._on_diagonal] += np.concatenate([stiffer, -softer])
        factor = factorised(matrix, INDEFINITE, elimination_order(problem), np.arange(n))
        effort.factorisations += 1

        def once(force: Vector, gap: Vector, tie: Vector) -> Step:
            effort.back_substitutions += 1
            by_bounds = np.bincount(unknown, entry * gap[bounds] / compliance[bounds], n)
            found = factor(np.concatenate([force + by_bounds, gap[others], tie]))
            u, pushed = found[:n], np.zeros(len(gap))
            pushed[others] = found[n : n + len(others)]
            pushed[bounds] = (entry * u[unknown] - gap[bounds]) / compliance[bounds]
            return u, pushed, found[n + len(others) :]

        def found(force: Vector, gap: Vector, tie: Vector, refined: bool) -> Step:
            u, l, nu = once(force, gap, tie)  # noqa: E741
            often = 1 if elimination_order(problem).band is not None else REFINEMENTS
            for _ in range(often if refined else 0):
                left = force - problem.stiffness_rows @ u - E.T @ l - A.T @ nu
                du, dl, dn = once(left, gap - E @ u + compliance * l, tie - A @ u)
                u, l, nu = u + du, l + dl, nu + dn  # noqa: E741
            return u, l, nu

        return found
