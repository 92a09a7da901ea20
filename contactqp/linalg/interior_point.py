"""Newton's steps along the central path: they separate closed contacts from open ones where a backend has stopped.

With slacks s = g - E_N u the points of the central path solve

    K u + E_N' l + A' nu = f,    E_N u + s = g,    A u = b,    s_i l_i = t,    s, l > 0,

and come, as t goes to zero, to the middle of the set of solutions: there either the force of a contact stays or its
slack, if any solution has one of them. A backend's answer is a point near the path with a t of its tolerance.
Mehrotra's steps (1992) from there make t smaller by orders of magnitude each, until force against slack tells the two
apart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from contactqp.errors import BackendFailed
from contactqp.linalg.crossover import refined, vertex_near, with_least_forces, without_conflict
from contactqp.linalg.extended import ExtendedAnswer
from contactqp.linalg.pardiso import INDEFINITE, elimination_order
from contactqp.linalg.sparse_saddle import ClosedState, Effort, factorised, nearest_state
from contactqp.model.arrays import Mask, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer

# A backend's displacement is taken to be off by this part of its size.
BACKEND_IS_OFF = 1e-9
# Added to the diagonal of the matrix of a step; refinement in double precision takes it back.
REGULARISATION, REFINEMENTS = 1e-8, 2
STEPS = 25
# Forces that are so many times those that act press against each other.
PRESSED = 1e3
# The part of the way to the nearest zero of a force or a slack that a step goes.
SHORT_OF_ZERO = 0.9995
# The work that a predicted step leaves, over that of now, counts as so much at most.
MOST_CENTRED = 1e3
# Steps that go no further than this part of their way have come to an end.
NO_WAY = 1e-6
# Work of all forces on all slacks, as a part of the energies that meet, from which on they are told apart.
TOLD_APART = 1e-22
# Forces and slacks of the start are at least this part of the geometric mean of their largest products.
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
        """The contacts whose force exceeds their slack (m,)."""
        return np.asarray(self.force > self.slack)

    @property
    def answer(self) -> Answer:
        """The point as an answer."""
        return Answer(self.displacement, np.where(self.closed, self.force, 0.0), None, self.tie_force)

    @property
    def work(self) -> float:
        """The work l's of forces l on slacks s, which measures the distance from the solution."""
        return float(self.force @ self.slack)


def settled(problem: ContactProblem, answer: Answer, effort: Effort, driven: bool = False) -> ClosedState:
    """Return the solution of an equilibrated problem that is nearest to an answer; `holds` says whether it is one.

    The closed contacts are those of the answer; where these do not lead to a solution, those of the point that Newton's
    steps along the central path come to from there; then those of the vertex near the answer. With `driven`, contacts
    close in addition where the load drives a motion that those of the point leave free.
    """
    start = ExtendedAnswer.of(answer)
    state = nearest_state(problem, _closed_in(problem, answer), start, effort)
    if state.holds or not problem.contacts:
        return state
    point = sharpened(problem, answer, effort)
    middle = ExtendedAnswer.of(point.answer)
    state = nearest_state(problem, point.closed, middle, effort, driven)
    vertex = None if state.holds else vertex_near(problem, start, _off(problem, answer), effort)
    return state if vertex is None else vertex


def _closed_in(problem: ContactProblem, answer: Answer) -> Mask:
    """Return the contacts whose force relative to the largest exceeds their gap relative to the largest length (m,)."""
    gap = problem.gap - problem.normal @ answer.displacement
    forces = (answer.normal_force, answer.tie_force, problem.load)
    force = max(float(abs(values).max(initial=0.0)) for values in forces)
    length = float(abs(answer.displacement).max(initial=0.0))
    return np.asarray(answer.normal_force * length > gap * force)


def _off(problem: ContactProblem, answer: Answer) -> float:
    """Return a length by which the displacement of an answer may be off: its penetration or what ties are open."""
    gap = problem.gap - problem.normal @ answer.displacement
    open_ties = problem.tie_value - problem.tie @ answer.displacement
    least = BACKEND_IS_OFF * float(np.max(abs(answer.displacement), initial=0.0))
    return max(float(np.max(-gap, initial=0.0)), float(np.max(abs(open_ties), initial=0.0)), least)


def solved_from(problem: ContactProblem, answer: Answer, effort: Effort, driven: bool = False) -> ClosedState:
    """Return `settled` and `refined`, at a vertex where contacts conflict, with least forces where they press."""
    state = without_conflict(refined(settled(problem, answer, effort, driven), effort), effort)
    acting = float(np.max(problem.stiffness_sizes @ abs(state.answer.displacement.double()), initial=0.0))
    acting = max(acting, float(np.max(problem.load_size, initial=0.0)))
    if state.holds and state.force > PRESSED * acting:
        return with_least_forces(state, effort)
    return state


def sharpened(problem: ContactProblem, answer: Answer, effort: Effort) -> CentralPoint:
    """Return the point of the central path that Newton's steps from an answer of an equilibrated problem come to."""
    point = _near_path(problem, answer)
    for _ in range(STEPS):
        if point.work <= TOLD_APART * _energies(problem, point):
            break
        try:
            after, length = _step(problem, point, effort)
        except BackendFailed:
            break
        if length < NO_WAY or not np.all(np.isfinite(after.displacement)):
            break
        point = after
    return point


def _near_path(problem: ContactProblem, answer: Answer) -> CentralPoint:
    """Return the answer with forces and slacks raised until they are positive."""
    force, slack = answer.normal_force, problem.gap - problem.normal @ answer.displacement
    products = np.maximum(force, 0.0) * np.maximum(slack, 0.0)
    least = LEAST * np.sqrt(max(float(np.mean(products)) if len(products) else 0.0, np.finfo(float).eps))
    return CentralPoint(answer.displacement, np.maximum(force, least), np.maximum(slack, least), answer.tie_force)


def _energies(problem: ContactProblem, point: CentralPoint) -> float:
    """Return the size of the terms of the energy at a point."""
    u = point.displacement
    return float(
        abs(u) @ (problem.stiffness_sizes @ abs(u)) + abs(problem.load) @ abs(u) + abs(problem.gap) @ point.force
    )


def _step(problem: ContactProblem, point: CentralPoint, effort: Effort) -> tuple[CentralPoint, float]:
    """Make a predictor-corrector step; return the next point and the step length, at most one."""
    u, l, s = point.displacement, point.force, point.slack  # noqa: E741
    solve = _solver(problem, s / l, effort)
    force = problem.load - problem.stiffness_rows @ u - problem.normal.T @ l - problem.tie.T @ point.tie_force
    slack, tie = problem.gap - problem.normal @ u - s, problem.tie_value - problem.tie @ u
    du, dl, _ = solve(force, slack + s, tie)
    ds = slack - problem.normal @ du
    reached = float((l + _until_zero(l, dl) * dl) @ (s + _until_zero(s, ds) * ds))
    mean = point.work / len(l)
    target = mean * min(reached / point.work, MOST_CENTRED) ** 3
    du, dl, dn = solve(force, slack + s - (target - dl * ds) / l, tie)
    ds = slack - problem.normal @ du
    a, b = (SHORT_OF_ZERO * _until_zero(values, change) for values, change in ((s, ds), (l, dl)))
    after = replace(
        point, displacement=u + a * du, slack=s + a * ds, force=l + b * dl, tie_force=point.tie_force + b * dn
    )
    return after, max(a, b)


def _until_zero(values: Vector, change: Vector) -> float:
    """Return the largest step, at most one, along a change after which positive values stay positive."""
    return float(1.0 / max(1.0, np.max(-change / values, initial=0.0)))


def _solver(problem: ContactProblem, compliance: Vector, effort: Effort) -> Callable[[Vector, Vector, Vector], Step]:
    """Return a function that solves K u + E'l + A'nu = f, E u - c l = g, A u = b, c (m,) compliances of contacts.

    Contacts of one unknown alone, bounds, are eliminated beforehand: they add E_ij^2 / c_i to its stiffness.
    """
    E, A, n, k = problem.normal, problem.tie, problem.dimension, problem.ties
    single = np.diff(E.indptr) == 1
    bounds, others = np.flatnonzero(single), np.flatnonzero(~single)
    unknown, entry = E.indices[E.indptr[bounds]], E.data[E.indptr[bounds]]
    diagonal = np.full(n, REGULARISATION) + np.bincount(unknown, entry**2 / compliance[bounds], n)
    rows = sp.vstack([E[others], A], format="csr")
    below = -np.concatenate([compliance[others], np.zeros(k)]) - REGULARISATION
    stiffness = problem.stiffness_rows + sp.diags(diagonal)
    matrix = sp.bmat([[stiffness, rows.T], [rows, sp.diags(below)]], format="csc") if rows.shape[0] else stiffness
    factor = factorised(sp.csc_matrix(matrix), INDEFINITE, elimination_order(problem), np.arange(n))
    effort.factorisations += 1

    def once(force: Vector, gap: Vector, tie: Vector) -> Step:
        effort.back_substitutions += 1
        by_bounds = np.bincount(unknown, entry * gap[bounds] / compliance[bounds], n)
        found = factor(np.concatenate([force + by_bounds, gap[others], tie]))
        u, pushed = found[:n], np.zeros(len(gap))
        pushed[others] = found[n : n + len(others)]
        pushed[bounds] = (entry * u[unknown] - gap[bounds]) / compliance[bounds]
        return u, pushed, found[n + len(others) :]

    def refined(force: Vector, gap: Vector, tie: Vector) -> Step:
        u, l, nu = once(force, gap, tie)  # noqa: E741
        for _ in range(REFINEMENTS):
            left = force - problem.stiffness_rows @ u - E.T @ l - A.T @ nu
            du, dl, dn = once(left, gap - E @ u + compliance * l, tie - A @ u)
            u, l, nu = u + du, l + dl, nu + dn  # noqa: E741
        return u, l, nu

    return refined
