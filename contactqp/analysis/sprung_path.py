"""Load paths of the penalty methods with Coulomb friction: the path of the bodies on contact springs, and its sliders.

A method that gives contacts a stiffness solves Coulomb's law of bodies with springs at their contacts
(`contactqp.solving.friction.contact_springs`): its path is theirs, in steps or from one exact event to the next. The
history shows the bodies: a solution is what the method itself makes of `solution.problem`, whose slip origin is where
the sliders were at the instant before, or where they stick.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from contactqp.analysis.friction_path import follow_with_friction
from contactqp.analysis.friction_steps import refuse_options
from contactqp.analysis.history import History
from contactqp.analysis.lazy_solutions import LazySolutions
from contactqp.errors import Unsupported
from contactqp.linalg.threads import one_blas_thread
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution
from contactqp.solving.friction.contact_springs import with_contact_springs, without_contact_springs
from contactqp.solving.methods import Method
from contactqp.solving.methods.augmented_lagrangian import default_penalty

# Contact springs of this many times the stiffness that the bodies show there: rates keep five digits.
STIFFEST = 1e6


def follow_on_springs(
    problem: ContactProblem,
    corners: Sequence[Vector],
    count: int,
    exactly: bool,
    chosen: Method,
    options: dict[str, Any],
) -> History:
    """As `follow_with_friction`, of a method whose `springs` names the stiffnesses of its contacts.

    Raises
    ------
    InvalidProblem
        A stiffness is missing, or not positive and finite.
    Unsupported
        A stiffness is so far above that of the bodies that rounding hides whether a contact goes on.
    """
    refuse_options(problem, chosen, options)
    if chosen.springs is None:
        raise ValueError(f"{chosen.name} has no contact springs")
    beta, beta_T = (options.get(name) for name in chosen.springs)
    others = {name: value for name, value in options.items() if name not in (*chosen.options, "algorithm")}
    springs = with_contact_springs(problem, np.asarray(beta), beta_T)
    for option, stiffness in zip(chosen.springs, (beta, beta_T), strict=True):
        if stiffness is not None:
            _refuse_rigid(problem, chosen.name, stiffness, option)
    loads = [np.concatenate([load, np.zeros(springs.dimension - problem.dimension)]) for load in corners]
    whole = follow_with_friction(springs, loads, count, exactly, "active-set", others)
    bodies = LazySolutions(_WithoutSprings(problem, whole, i, chosen.name) for i in range(len(whole)))
    times = whole.times.tolist()
    return History(bodies, times, lambda: whole.events, energies=lambda: whole.energies, notes=lambda: whole.notes)


def _refuse_rigid(problem: ContactProblem, name: str, stiffness: Any, option: str) -> None:
    """Rates of forces are differences of motions times the stiffness, and signs of rates are what a path goes by."""
    own = default_penalty(problem, problem.normal, 1.0)
    ratio = np.broadcast_to(np.asarray(stiffness, dtype=float), own.shape) / own
    if np.any(ratio > STIFFEST):
        i = int(np.argmax(ratio))
        raise Unsupported(
            f"{name}: {option} of {problem.contact_name(i)} is {ratio[i]:.1g} times the stiffness of the bodies there: "
            f"on a path with friction at most {STIFFEST:.0e}; rigid contact is method='active-set'"
        )


@dataclass(frozen=True, eq=False)
class _WithoutSprings:
    """The bodies at one instant, without the springs with which they were followed."""

    problem: ContactProblem
    on_springs: Sequence[Solution]
    instant: int
    name: str  # of the method

    def finish(self) -> Solution:
        """What the method itself makes of the instant, certified."""
        on_springs, n = self.on_springs[self.instant], self.problem.dimension
        whole = on_springs.problem
        with self.problem.lock, one_blas_thread(self.problem):
            own = self.problem.replace(load=whole.load[:n], slip_origin=whole.slip_origin)
            return without_contact_springs(own, on_springs, self.name)
