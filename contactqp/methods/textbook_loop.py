"""The textbook's active-set loop around the five classical enforcements.

The course chapter turns inequality contact into a sequence of equality problems: solve with the contacts that are
thought closed; contacts that penetrate come in, contacts in tension go out; repeat until nothing changes. How a closed
contact is enforced is the only thing in which master-slave, multipliers, penalty, perturbed and augmented Lagrangian
differ, so each of them is one function from a set of closed contacts to a `Step`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from contactqp.methods.method import Settings
from contactqp.methods.textbook_algebra import ROUNDING, Indices, Mask, SingularSystem
from contactqp.problem import ContactProblem, Matrix, Vector
from contactqp.solution import Candidate


@dataclass(frozen=True, eq=False)
class Step:
    """The equality problem's answer for one set of closed contacts."""

    displacement: Vector  # (n,)
    normal_force: Vector  # (m,), zero on the open contacts
    tie_force: Vector  # (k,)
    bound: Mask  # (m,) the closed contacts that took part; dependent rows may leave some out


# A mask of the closed contacts, and an order of preference among them should their rows be dependent.
Enforcement = Callable[[Mask, Indices], Step]


def active_set_loop(
    name: str,
    problem: ContactProblem,
    settings: Settings,
    enforce: Enforcement,
    stiffness: float | Vector = 0.0,
) -> Candidate:
    """Repeat `enforce` on the set of closed contacts until the set no longer changes.

    The first set is that of the contacts penetrated in the free solution; of all contacts where the bodies float
    freely, so that there is no free solution.

    Parameters
    ----------
    name : str
        The method's name, for messages.
    enforce : Enforcement
        Solves the equality problem of one set of closed contacts.
    stiffness : float or (m,) array
        Force that one unit of gap makes in a closed contact [force / length]: beta where contacts are springs, 0 where
        they are exact. Rounding in the gap is seen in the force by this factor.

    Returns
    -------
    Candidate
        `history` is the number of contacts that changed sides, one number an iteration. Not claimed where the loop
        cycles, or where it stops at `settings.max_iter` (10 m + 20) or `settings.time_limit`.

    Raises
    ------
    NotConverged
        The system of some set is singular.
    """
    started, history, seen = time.perf_counter(), list[float](), set[bytes]()
    limit = settings.max_iter or 10 * problem.contacts + 20
    sizes = _Sizes.of(problem)
    closed, preference = _warm_set(problem, settings), np.arange(problem.contacts)
    while True:
        step = enforce(closed, preference) if history else _first_step(enforce, closed, preference)
        incoming, outgoing = _changes(problem, sizes, step, stiffness)
        history.append(float(np.count_nonzero(incoming | outgoing)))
        status = _stop(history, step.bound.tobytes() in seen, limit, settings, started)
        if status:
            return _candidate(step, history, f"{name}: {status}")
        seen.add(step.bound.tobytes())
        closed = (step.bound & ~outgoing) | incoming
        # Where rows are dependent, the contact that has just been seen to penetrate is the one that binds.
        preference = np.argsort(~incoming, kind="stable")


def _candidate(step: Step, history: list[float], status: str) -> Candidate:
    return Candidate(
        step.displacement,
        step.normal_force,
        step.tie_force,
        iterations=len(history),
        claimed=history[-1] == 0,
        status=status,
        history=tuple(history),
    )


def _warm_set(problem: ContactProblem, settings: Settings) -> Mask:
    if settings.warm_start is None:
        return np.zeros(problem.contacts, dtype=bool)
    return np.asarray(settings.warm_start.normal_force > 0)


def _first_step(enforce: Enforcement, closed: Mask, preference: Indices) -> Step:
    try:
        return enforce(closed, preference)
    except SingularSystem:
        if closed.all():
            raise
        return enforce(np.ones_like(closed), preference)


def _stop(history: list[float], repeated: bool, limit: int, settings: Settings, started: float) -> str:
    """Why the loop ends here, or nothing."""
    if history[-1] == 0:
        return "the set of closed contacts no longer changes"
    if repeated:
        return "the active-set loop cycles"
    if len(history) >= limit:
        return f"stopped after {limit} iterations"
    if settings.time_limit is not None and time.perf_counter() - started > settings.time_limit:
        return f"stopped after {settings.time_limit:g} s"
    return ""


@dataclass(frozen=True, eq=False)
class _Sizes:
    """Absolute values of the problem's matrices, for the size of what rounding can do."""

    stiffness: Matrix
    normal: Matrix
    tie: Matrix

    @classmethod
    def of(cls, problem: ContactProblem) -> _Sizes:
        return cls(abs(problem.stiffness), abs(problem.normal), abs(problem.tie))

    def forces(self, problem: ContactProblem, step: Step) -> Vector:
        """F_j, the size of the forces that meet at unknown j (n,) [force]."""
        u, force, tie_force = np.abs(step.displacement), np.abs(step.normal_force), np.abs(step.tie_force)
        return np.asarray(self.stiffness @ u + self.normal.T @ force + self.tie.T @ tie_force + np.abs(problem.load))

    def tremor(self, forces: Vector) -> tuple[Vector, Vector]:
        """What rounding makes of a force and of a displacement that should be zero, (n,) each [force], [length].

        The rounding of F_k moves unknown k by 16 eps F_k / K_kk, and its neighbours j feel |K_jk| times that.
        """
        diagonal = self.stiffness.diagonal()
        softness = 1.0 / np.where(diagonal > 0, diagonal, np.inf)
        shaken = 16 * np.finfo(float).eps * (self.stiffness @ (softness * forces))
        return shaken, softness * shaken


def _changes(problem: ContactProblem, sizes: _Sizes, step: Step, stiffness: float | Vector) -> tuple[Mask, Mask]:
    """Open contacts that penetrate and closed contacts in tension, both by more than rounding."""
    closed = step.bound
    if problem.contacts == 0:
        return closed, closed
    normal, forces = sizes.normal, sizes.forces(problem, step)
    shaken, moved = sizes.tremor(forces)
    # A force is noise when it is at one of the contact's unknowns j: min over j of the noise there / |E_ij|.
    noise = np.minimum.reduceat((ROUNDING * forces + shaken)[normal.indices] / normal.data, normal.indptr[:-1])
    length = ROUNDING * (normal @ np.abs(step.displacement) + np.abs(problem.gap)) + normal @ moved
    penetration = problem.normal @ step.displacement - problem.gap
    incoming = ~closed & (penetration > length)
    outgoing = closed & (step.normal_force < -(noise + stiffness * length))
    return incoming, outgoing
