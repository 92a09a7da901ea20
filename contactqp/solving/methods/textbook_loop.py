"""The textbook's active-set loop around the five classical methods of enforcement.

The course chapter (R. Perera and A. Carnicero, Contact Mechanics in 1D Elastostatics Problems, 2020) solves inequality
contact as a sequence of equality problems: solve with the current set of closed contacts, close contacts that
penetrate, open contacts in tension, and repeat until nothing changes. Master-slave, multipliers, penalty, perturbed and
augmented Lagrangian differ only in how closed contacts are enforced, so each is one function from a set of closed
contacts to a `Step`.

The loop may cycle, or open so many contacts that a body floats. Then the criss-cross method, which is not in the
textbook, changes one contact at a time: of the contacts with a wrong sign, the one of least index. If its row depends
on those of closed contacts, the blocking closed contact of least index opens; if opening it would free a body, the open
contact of least index that the body would meet closes. In exact arithmetic no set recurs (Klafszky and Terlaky 1992;
den Hertog, Roos and Terlaky 1993), also with redundant contacts and floating bodies; without exchanges it is Murty's
method (1974).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from contactqp.errors import NotConverged
from contactqp.linalg.measures import row_sizes
from contactqp.model.arrays import EPS, Indices, Mask, Vector, stated_limit
from contactqp.model.problem import ContactProblem, Matrix
from contactqp.model.solution import Answer, Candidate
from contactqp.solving.methods.method import Settings
from contactqp.solving.methods.stick_and_slip import FrictionalStep
from contactqp.solving.methods.textbook_algebra import (
    ROW_ROUNDING,
    TEXTBOOK_ROUNDING,
    FloatingBodies,
    SingularSystem,
    spread,
)


@dataclass(frozen=True, eq=False)
class Step:
    """The answer of the equality problem for one set of closed contacts."""

    answer: Answer  # without forces on the open contacts
    bound: Mask  # (m,) the closed contacts in the system, without those with dependent rows

    @classmethod
    def on_rows(
        cls, problem: ContactProblem, displacement: Vector, force: Vector, ties: Indices, contacts: Indices
    ) -> Step:
        """Return the step in which some rows carry forces.

        Parameters
        ----------
        problem : ContactProblem
        displacement : (n,) array [length]
        force : (r,) array [force], of the ties, then of the contacts
        ties, contacts : arrays of int, whose rows they are
        """
        bound = np.zeros(problem.contacts, dtype=bool)
        bound[contacts] = True
        normal = spread(force[ties.size :], contacts, problem.contacts)
        return cls(Answer(displacement, normal, None, spread(force[: ties.size], ties, problem.ties)), bound)


# A function of the mask of closed contacts, and of an order of preference of those with dependent rows.
Enforcement = Callable[[Mask, Indices], Step]


@dataclass(frozen=True, eq=False)
class Sets:
    """The sets of closed contacts of one problem, and their equality problems."""

    name: str
    problem: ContactProblem
    enforce: Enforcement

    @cached_property
    def bodies(self) -> FloatingBodies:
        """Return the rigid motions and the rows that resist them."""
        return FloatingBodies(self.problem)

    def step(self, closed: Mask, preference: Indices) -> Step:
        """Solve the equality problem of a set.

        Raises
        ------
        SingularSystem
            The set does not hold the bodies, judged by their rigid motions, as rounding may hide this in the system.
        """
        if self.bodies.rigid.shape[1]:
            rows = np.vstack([self.bodies.normal[closed], self.bodies.tie])
            if not self.bodies.held_by(rows):
                raise SingularSystem(f"{self.name}: the bodies are not held by the contacts that are closed")
        return self.enforce(closed, preference)

    def change_one(self, closed: Mask, wrong: Mask) -> Step:
        """Return the step on the next set, in which the `wrong` contact of least index has changed sides.

        Parameters
        ----------
        closed : (m,) mask, a set with independent rows that holds the bodies

        Raises
        ------
        NotConverged
            No contact can be exchanged, as the constraints conflict or the load drives an unsupported body.
        """
        changing = np.arange(len(closed)) == np.flatnonzero(wrong)[0]
        preference = np.argsort(changing, kind="stable")  # of dependent rows it is left out
        changed: Mask = closed ^ changing
        if np.any(closed & changing):
            try:
                return self.step(changed, preference)
            except SingularSystem:
                other = self._next_stop(changed, changing)
        else:
            step = self.step(changed, preference)
            if np.any(step.bound & changing):
                return step
            other = self._in_the_way(closed, changing)
        changed[other] = not changed[other]
        return self.step(changed, preference)

    def _in_the_way(self, closed: Mask, entering: Mask) -> int:
        """Return the least k in B with c_k > 0, E_i = c'[E_B; A]; unless one of these opens, E_i u cannot decrease."""
        rows = np.vstack([self.bodies.normal[closed], self.bodies.tie])
        weights = np.linalg.lstsq(rows.T, self.bodies.normal[entering][0], rcond=None)[0][: np.count_nonzero(closed)]
        blocking = np.flatnonzero(closed)[weights > ROW_ROUNDING]
        if blocking.size == 0:
            raise NotConverged(f"{self.name}: {self._named(entering)} is penetrated and no closed contact can give way")
        return int(blocking[0])

    def _next_stop(self, others: Mask, leaving: Mask) -> int:
        """Return the open contact of least index that stops the body when contact i opens."""
        rows = np.vstack([self.bodies.normal[others], self.bodies.tie, self.bodies.normal[leaving]]) @ self.bodies.rigid
        opening = np.append(np.zeros(len(rows) - 1), -1.0)
        coordinates = np.linalg.lstsq(rows, opening, rcond=ROW_ROUNDING)[0]
        if np.linalg.norm(rows @ coordinates - opening) > np.sqrt(ROW_ROUNDING):
            raise NotConverged(f"{self.name}: the system of equations is singular without {self._named(leaving)}")
        approach = self.bodies.normal @ self.bodies.rigid @ (coordinates / np.linalg.norm(coordinates))
        ahead = np.flatnonzero(~others & ~leaving & (approach > ROW_ROUNDING))
        if ahead.size == 0:
            raise NotConverged(f"{self.name}: nothing stops the body that the load drives off {self._named(leaving)}")
        return int(ahead[0])

    def _named(self, contact: Mask) -> str:
        return self.problem.contact_name(int(np.flatnonzero(contact)[0]))


class Budget:
    """The limits of a loop that begins now, in iterations (`most` by default) and seconds."""

    def __init__(self, settings: Settings, most: int) -> None:
        self._most, self._seconds = settings.max_iter or most, settings.time_limit
        self._started = time.perf_counter()

    def spent(self, iterations: int) -> str:
        """Return the reason why a loop must end after `iterations`, or an empty string."""
        if iterations >= self._most:
            return f"stopped after {self._most} iterations"
        if self._seconds is not None and time.perf_counter() - self._started > self._seconds:
            return f"stopped after {stated_limit(self._seconds)}"
        return ""


def last_candidate(
    name: str, step: Step | FrictionalStep, reason: str, history: Sequence[float], together: int | None
) -> Candidate:
    """Return the last step of a loop with the reason of its end; it is claimed if no contact has a wrong sign.

    Parameters
    ----------
    name : the method
    step : Step or FrictionalStep, the last one
    reason : why the loop ended
    history : sequence of float, what was wrong after each iteration; none in the last one claims the answer
    together : int or None, how many iterations changed all wrong contacts at once, None if all did
    """
    one_by_one = "" if together is None else f" (one contact at a time after {together} iterations)"
    return Candidate(
        step.answer,
        iterations=len(history),
        claimed=history[-1] == 0,
        status=f"{name}: {reason}{one_by_one}",
        history=tuple(history),
    )


# Rows (r, n), their limits (r,), and a mask of those that are equations, E_i u = g_i.
Hold = tuple[Any, Vector, Mask]


@dataclass(frozen=True, eq=False)
class Sizes:
    """Absolute values of the problem's matrices."""

    problem: ContactProblem
    bodies: FloatingBodies
    stiffness: Matrix

    @classmethod
    def of(cls, problem: ContactProblem, bodies: FloatingBodies) -> Sizes:
        return cls(problem, bodies, abs(problem.stiffness))

    def forces(self, displacement: Vector, pushes: tuple[tuple[Any, Vector], ...]) -> Vector:
        """Return F_j, the size of the forces that meet at unknown j (n,) [force].

        Parameters
        ----------
        displacement : (n,)
        pushes : pairs of rows (r, n) and forces (r,)
        """
        meeting = self.stiffness @ np.abs(displacement) + self.problem.load_size
        for rows, force in pushes:
            meeting = meeting + row_sizes(self.problem, rows).forces(np.abs(force))
        return np.asarray(meeting)

    def noise(self, displacement: Vector, forces: Vector, holds: tuple[Hold, ...]) -> Noise:
        """Return the rounding errors of forces and lengths at this displacement (n,), for forces (n,) that meet there.

        The rounding of F_k changes unknown k by 16 eps F_k / K_kk, and the forces at its neighbours j by |K_jk| times
        that. Rows that are equations by `holds` change their unknowns, too.
        """
        diagonal = self.stiffness.diagonal()
        softness = 1.0 / np.where(diagonal > 0, diagonal, np.inf)
        shaken = 16 * EPS * (self.stiffness @ (softness * forces))
        moved = softness * shaken
        for rows, limits, held in holds:
            moved = moved + self._moved_by(rows, limits, held, displacement)
        return Noise(np.abs(displacement), forces, shaken, moved, self.bodies)

    def _moved_by(self, rows: Any, limits: Vector, held: Mask, displacement: Vector) -> Vector:
        """Return the displacement (n,) by rounding of E_i u = g_i: 16 eps (|E_i||u| + |g_i|) D_j^2 |E_ij| / |E_i D|^2.

        It is the least displacement that corrects this error, in unknowns where the stiffness has a unit diagonal. For
        an unknown that should be zero, without force and stiffness, it may be the only measure of size.
        """
        sizes, softness = row_sizes(self.problem, rows), self.bodies.scale**2
        compliance = rows.power(2) @ softness
        lengths = np.where(held, sizes.lengths(np.abs(displacement)) + np.abs(limits), 0.0)
        pulled = sizes.forces(lengths / np.where(compliance > 0, compliance, 1.0))
        return np.asarray(16 * EPS * softness * pulled)


@dataclass(frozen=True, eq=False)
class Noise:
    """Rounding at one displacement."""

    size: Vector  # (n,) |u|
    forces: Vector  # (n,) F
    shaken: Vector  # (n,) of a force that should be zero
    moved: Vector  # (n,) of a displacement that should be zero
    bodies: FloatingBodies

    def of_forces(self, rows: Any) -> Vector:
        """Return the noise (r,) of the forces of rows: the least noise at one of a row's unknowns j, over |E_ij|.

        At an unknown without stiffness and forces, eps^2 of the largest force is used.
        """
        entries = abs(rows).tocoo()
        noise = np.full(rows.shape[0], np.inf)
        np.minimum.at(noise, entries.row, (TEXTBOOK_ROUNDING * self.forces + self.shaken)[entries.col] / entries.data)
        entry = np.ones(rows.shape[0])
        np.maximum.at(entry, entries.row, entries.data)
        left = TEXTBOOK_ROUNDING**2 * float(self.forces.max(initial=0.0)) / entry
        return np.where(np.isfinite(noise), noise, 0.0) + left + self.bodies.carried(rows, self.forces)

    def of_lengths(self, rows: Any, limits: Vector) -> Vector:
        """Return the noise (r,) of E u - g for rows and their limits."""
        size = abs(rows)
        return np.asarray(TEXTBOOK_ROUNDING * (size @ self.size + np.abs(limits)) + size @ self.moved)


def active_set_loop(
    name: str,
    problem: ContactProblem,
    settings: Settings,
    enforce: Enforcement,
    stiffness: float | Vector = 0.0,
) -> Candidate:
    """Repeat `enforce` on the set of closed contacts until it is constant, changing one contact at a time after a
    cycle.

    The first set is that of the contacts penetrated in the free solution; of all contacts where the bodies float
    freely, so that there is no free solution.

    Raises NotConverged: the first system is singular, or no contact can be exchanged for another.

    Parameters
    ----------
    problem : ContactProblem
    settings : limits, and the answer to start from
    name : the method's name, for messages
    enforce : solves the equality problem of one set of closed contacts
    stiffness : float or (m,) array
        Force that one unit of gap makes in a closed contact [force / length]: beta where contacts are springs or have
        springs beside them, 0 where they are exact. Rounding in the gap is seen in the force by this factor.

    Returns
    -------
    Candidate
        `history` is the number of contacts whose sign is wrong, one number an iteration. Not claimed where even the
        criss-cross steps cycle (rounding decides between sets), or where the loop stops at `settings.max_iter`
        (50 m + 200) or `settings.time_limit`.
    """
    loop = _Loop(name, problem, settings, enforce, stiffness)
    try:
        return loop.run()
    except SingularSystem as error:
        raise NotConverged(str(error), tuple(loop.history)) from None


class _Loop:
    def __init__(
        self, name: str, problem: ContactProblem, settings: Settings, enforce: Enforcement, stiffness: float | Vector
    ) -> None:
        self._name, self._problem, self._settings = name, problem, settings
        self._sets = Sets(name, problem, enforce)
        self._stiffness, self._sizes = stiffness, Sizes.of(problem, self._sets.bodies)
        self._budget = Budget(settings, 50 * problem.contacts + 200)
        self._textbook_steps: int | None = None  # their number, once single changes have begun
        self._seen: set[bytes] = set()
        self.history: list[float] = []

    def run(self) -> Candidate:
        step = self._first_step()
        while True:
            incoming, outgoing = _changes(self._sets, self._sizes, step, self._stiffness)
            self.history.append(float(np.count_nonzero(incoming | outgoing)))
            status = self._stop(step.bound)
            if status:
                return last_candidate(self._name, step, status, self.history, self._textbook_steps)
            self._seen.add(step.bound.tobytes())
            step = self._next_step(step, incoming, outgoing)

    def _first_step(self) -> Step:
        closed, order = _warm_set(self._problem, self._settings), np.arange(self._problem.contacts)
        try:
            return self._sets.step(closed, order)
        except SingularSystem:
            if closed.all():
                raise
            return self._sets.step(np.ones_like(closed), order)

    def _next_step(self, step: Step, incoming: Mask, outgoing: Mask) -> Step:
        if self._textbook_steps is None:
            # Where rows are dependent, the contact that has just been seen to penetrate is the one that binds.
            preference = np.argsort(~incoming, kind="stable")
            try:
                following = self._sets.step((step.bound & ~outgoing) | incoming, preference)
                if following.bound.tobytes() not in self._seen:
                    return following
            except SingularSystem:  # too many contacts opened at once
                pass
            self._textbook_steps = len(self.history)
            self._seen = {step.bound.tobytes()}
        return self._sets.change_one(step.bound, incoming | outgoing)

    def _stop(self, bound: Mask) -> str:
        """Return the reason why the loop ends here, or an empty string."""
        if self.history[-1] == 0:
            return "the set of closed contacts no longer changes"
        if bound.tobytes() in self._seen:
            return "the active-set loop cycles, even one contact at a time"
        return self._budget.spent(len(self.history))


def _warm_set(problem: ContactProblem, settings: Settings) -> Mask:
    if settings.warm_start is None:
        return np.zeros(problem.contacts, dtype=bool)
    return np.asarray(settings.warm_start.answer.normal_force > 0)


def _changes(sets: Sets, sizes: Sizes, step: Step, stiffness: float | Vector) -> tuple[Mask, Mask]:
    """Return the open contacts that penetrate and the closed contacts in tension, both by more than rounding."""
    problem, closed = sets.problem, step.bound
    if problem.contacts == 0:
        return closed, closed
    answer = step.answer
    pushes = ((problem.normal, answer.normal_force), (problem.tie, answer.tie_force))
    holds = ((problem.normal, problem.gap, closed), (problem.tie, problem.tie_value, np.ones(problem.ties, dtype=bool)))
    noise = sizes.noise(answer.displacement, sizes.forces(answer.displacement, pushes), holds)
    length = noise.of_lengths(problem.normal, problem.gap)
    penetration = problem.normal @ answer.displacement - problem.gap
    incoming = ~closed & (penetration > length)
    outgoing = closed & (answer.normal_force < -(noise.of_forces(problem.normal) + stiffness * length))
    return incoming, outgoing
