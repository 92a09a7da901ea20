"""The textbook's active-set loop around the five classical enforcements.

The course chapter turns inequality contact into a sequence of equality problems: solve with the contacts that are
thought closed; contacts that penetrate come in, contacts in tension go out; repeat until nothing changes. That can go
in circles, or open so many contacts that a body comes loose; from there on `criss_cross` changes one contact at a time,
which the textbook does not do. How a closed contact is enforced is the only thing in which master-slave, multipliers,
penalty, perturbed and augmented Lagrangian differ, so each is one function from a set of closed contacts to a `Step`.
"""

from __future__ import annotations

import numpy as np

from contactqp.errors import NotConverged
from contactqp.model.arrays import Mask, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Candidate
from contactqp.solving.methods.criss_cross import Enforcement, Sets, Step
from contactqp.solving.methods.method import Settings
from contactqp.solving.methods.textbook_algebra import SingularSystem
from contactqp.solving.methods.textbook_ending import Budget, last_candidate
from contactqp.solving.methods.textbook_rounding import Sizes


def active_set_loop(
    name: str,
    problem: ContactProblem,
    settings: Settings,
    enforce: Enforcement,
    stiffness: float | Vector = 0.0,
) -> Candidate:
    """Repeat `enforce` on the set of closed contacts until it no longer changes; one contact at a time after a cycle.

    The first set is that of the contacts penetrated in the free solution; of all contacts where the bodies float
    freely, so that there is no free solution.

    Parameters
    ----------
    name : str
        The method's name, for messages.
    enforce : Enforcement
        Solves the equality problem of one set of closed contacts.
    stiffness : float or (m,) array
        Force that one unit of gap makes in a closed contact [force / length]: beta where contacts are springs or have
        springs beside them, 0 where they are exact. Rounding in the gap is seen in the force by this factor.

    Returns
    -------
    Candidate
        `history` is the number of contacts whose sign is wrong, one number an iteration. Not claimed where even the
        criss-cross steps cycle (rounding decides between sets), or where the loop stops at `settings.max_iter`
        (50 m + 200) or `settings.time_limit`.

    Raises
    ------
    NotConverged
        The first system is singular, or no contact can be exchanged for another.
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
        self._textbook_steps: int | None = None  # how many there were, once the loop goes one contact at a time
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
            except SingularSystem:  # too many contacts were opened at once
                pass
            self._textbook_steps = len(self.history)
            self._seen = {step.bound.tobytes()}
        return self._sets.change_one(step.bound, incoming | outgoing)

    def _stop(self, bound: Mask) -> str:
        """Why the loop ends here, or nothing."""
        if self.history[-1] == 0:
            return "the set of closed contacts no longer changes"
        if bound.tobytes() in self._seen:
            return "the active-set loop cycles, even one contact at a time"
        return self._budget.spent(len(self.history))


def _warm_set(problem: ContactProblem, settings: Settings) -> Mask:
    if settings.warm_start is None:
        return np.zeros(problem.contacts, dtype=bool)
    return np.asarray(settings.warm_start.normal_force > 0)


def _changes(sets: Sets, sizes: Sizes, step: Step, stiffness: float | Vector) -> tuple[Mask, Mask]:
    """Open contacts that penetrate and closed contacts in tension, both by more than rounding."""
    problem, closed = sets.problem, step.bound
    if problem.contacts == 0:
        return closed, closed
    pushes = ((problem.normal, step.normal_force), (problem.tie, step.tie_force))
    holds = ((problem.normal, problem.gap, closed), (problem.tie, problem.tie_value, np.ones(problem.ties, dtype=bool)))
    noise = sizes.noise(step.displacement, sizes.forces(step.displacement, pushes), holds)
    length = noise.of_lengths(problem.normal, problem.gap)
    penetration = problem.normal @ step.displacement - problem.gap
    incoming = ~closed & (penetration > length)
    outgoing = closed & (step.normal_force < -(noise.of_forces(problem.normal) + stiffness * length))
    return incoming, outgoing
