"""One contact at a time, by least index: the criss-cross method, for sets on which the textbook's loop goes in circles.

Of the contacts whose sign is wrong, the one of least index changes sides. Where its row follows from those of closed
contacts, the closed contact of least index that stands in its way opens for it; where opening it would let a body go,
the open contact of least index that the body would run into closes instead. No set comes twice in exact arithmetic
(Klafszky and Terlaky 1992; den Hertog, Roos and Terlaky 1993), redundant contacts and floating bodies included;
without exchanges it is Murty's method (1974).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from contactqp.errors import NotConverged
from contactqp.model.arrays import Indices, Mask, Vector
from contactqp.model.problem import ContactProblem
from contactqp.solving.methods.textbook_algebra import NEGLIGIBLE, FloatingBodies, SingularSystem, spread


@dataclass(frozen=True, eq=False)
class Step:
    """The equality problem's answer for one set of closed contacts."""

    displacement: Vector  # (n,)
    normal_force: Vector  # (m,), zero on the open contacts
    tie_force: Vector  # (k,)
    bound: Mask  # (m,) the closed contacts that took part; dependent rows may leave some out

    @classmethod
    def on_rows(
        cls, problem: ContactProblem, displacement: Vector, force: Vector, ties: Indices, contacts: Indices
    ) -> Step:
        """The answer whose rows, of these ties and then of these contacts, carry the forces (r,)."""
        bound = np.zeros(problem.contacts, dtype=bool)
        bound[contacts] = True
        return cls(
            displacement,
            normal_force=spread(force[ties.size :], contacts, problem.contacts),
            tie_force=spread(force[: ties.size], ties, problem.ties),
            bound=bound,
        )


# A mask of the closed contacts, and an order of preference among them should their rows be dependent.
Enforcement = Callable[[Mask, Indices], Step]


@dataclass(frozen=True, eq=False)
class Sets:
    """The sets of closed contacts of one problem, and their equality problems."""

    name: str
    problem: ContactProblem
    enforce: Enforcement

    @cached_property
    def bodies(self) -> FloatingBodies:
        """The rigid motions, and the rows that feel them."""
        return FloatingBodies(self.problem)

    def step(self, closed: Mask, preference: Indices) -> Step:
        """Solve the equality problem of a set.

        Raises
        ------
        SingularSystem
            The set does not hold the bodies: told from the motions themselves, which rounding may hide in the system.
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
        closed : (m,) mask
            A set with independent rows that holds the bodies.

        Raises
        ------
        NotConverged
            No contact can be exchanged: the constraints conflict, or nothing stops a body that the load drives.
        """
        changing = np.arange(len(closed)) == np.flatnonzero(wrong)[0]
        preference = np.argsort(changing, kind="stable")  # in doubt, it is the one left out
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
        """With E_i = c'[E_B; A], the least k in B with c_k > 0: unless one of them gives way, E_i u cannot decrease."""
        rows = np.vstack([self.bodies.normal[closed], self.bodies.tie])
        weights = np.linalg.lstsq(rows.T, self.bodies.normal[entering][0], rcond=None)[0][: np.count_nonzero(closed)]
        blocking = np.flatnonzero(closed)[weights > NEGLIGIBLE]
        if blocking.size == 0:
            raise NotConverged(f"{self.name}: {self._named(entering)} is penetrated and no closed contact can give way")
        return int(blocking[0])

    def _next_stop(self, others: Mask, leaving: Mask) -> int:
        """The open contact of least index that is approached by the rigid motion that leaves contact i alone."""
        rows = np.vstack([self.bodies.normal[others], self.bodies.tie, self.bodies.normal[leaving]]) @ self.bodies.rigid
        opening = np.append(np.zeros(len(rows) - 1), -1.0)
        coordinates = np.linalg.lstsq(rows, opening, rcond=NEGLIGIBLE)[0]
        if np.linalg.norm(rows @ coordinates - opening) > np.sqrt(NEGLIGIBLE):
            raise NotConverged(f"{self.name}: the system of equations is singular without {self._named(leaving)}")
        approach = self.bodies.normal @ self.bodies.rigid @ (coordinates / np.linalg.norm(coordinates))
        ahead = np.flatnonzero(~others & ~leaving & (approach > NEGLIGIBLE))
        if ahead.size == 0:
            raise NotConverged(f"{self.name}: nothing stops the body that the load drives off {self._named(leaving)}")
        return int(ahead[0])

    def _named(self, contact: Mask) -> str:
        return self.problem.contact_name(int(np.flatnonzero(contact)[0]))
