"""The numbers of a history that are drawn: at every instant displacements, gaps, forces, loads and energies.

A motion keeps them as arrays. Of a load path every solution is looked at once, which costs its certificate; its events
need that anyway.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactqp.analysis.history import Energies, Event, History
from contactqp.analysis.motion.motion_history import MotionHistory
from contactqp.errors import InvalidProblem, refuse_other
from contactqp.model.arrays import Array, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution

# Loads are proportional to the times, or all along one of them, to this part of the largest.
ROUNDING = 1e-9
ENERGIES = ("kinetic", "elastic", "total", "work", "dissipated", "impact", "drift")
OF_PATHS = ("elastic", "work", "dissipated")
# Energies below this part of the largest are rounding, and are not drawn.
NO_ENERGY = 1e-12


@dataclass(frozen=True, eq=False)
class HistoryFields:
    """What a history does at its k instants; n unknowns, m contacts.

    Attributes
    ----------
    problem : ContactProblem
        At the last instant, for names, units and rows.
    times : (k,) array
    moving : bool
        Whether it is a motion, and `times` are times.
    displacement : (k, n) array [length]
    velocity : (k, n) array or None
        Of a motion [length / time].
    load : (k, n) array or None
        Of a load path [force].
    gap : (k, m) array
        Positive when open [length].
    normal_force : (k, m) array
        Positive in compression [force].
    friction_force : (k, m, d-1) array or None
        None without friction [force].
    energies : mapping of str to (k,) array
        Those that are not zero all the time [force * length].
    events : tuple of Event
    notes : tuple of str
    """

    problem: ContactProblem
    times: Vector
    moving: bool
    displacement: Array
    velocity: Array | None
    load: Array | None
    gap: Array
    normal_force: Array
    friction_force: Array | None
    energies: Mapping[str, Vector]
    events: tuple[Event, ...]
    notes: tuple[str, ...]

    @property
    def proportional(self) -> bool:
        """Whether the load is the time times one load: the times are load factors."""
        if self.load is None or not np.any(self.load) or not np.any(self.times):
            return False
        whole = self.times @ self.load / (self.times @ self.times)
        off = np.max(abs(self.load - np.outer(self.times, whole)))
        return bool(off <= ROUNDING * np.max(abs(self.load)))

    def instants(self, events: tuple[Event, ...]) -> NDArray[np.int64]:
        """The instant of each event, one of those nearest in time; where loads go back and forth the next such one."""
        found, here = np.empty(len(events), dtype=np.int64), 0
        for i, event in enumerate(events):
            off = abs(self.times - event.time)
            near = np.flatnonzero(off <= off.min()).tolist()
            here = next((instant for instant in near if instant >= here), near[-1])
            found[i] = here
        return found


def history_fields(history: History) -> HistoryFields:
    """The fields of a load path, a motion, or what there is of one.

    Raises
    ------
    InvalidProblem
        It is no History, or one without instants.
    """
    refuse_other("draw_history", history, History)
    if len(history) == 0:
        raise InvalidProblem("draw_history: expected a history of one instant or more, got none")
    if isinstance(history, MotionHistory):
        return _of_motion(history)
    solutions = list(history)
    rubbing = [solution.friction_force for solution in solutions]
    frictional = any(solution.problem.frictional for solution in solutions)
    return HistoryFields(
        problem=solutions[-1].problem,
        times=history.times,
        moving=False,
        displacement=np.array([solution.displacement for solution in solutions]),
        velocity=None,
        load=np.array([_load(solution) for solution in solutions]),
        gap=np.array([solution.gap for solution in solutions]),
        normal_force=np.array([solution.normal_force for solution in solutions]),
        friction_force=np.array(rubbing) if frictional and all(f is not None for f in rubbing) else None,
        energies=_energies(history.energies, OF_PATHS),
        events=history.events,
        notes=history.notes,
    )


def _of_motion(history: MotionHistory) -> HistoryFields:
    problem, u = history.motion.scheme.body.problem, history.displacements
    with np.errstate(over="ignore", invalid="ignore"):  # a motion that failed may have left all numbers
        energies = _energies(history.energies, ENERGIES)
        gap = problem.gap - np.asarray(problem.normal @ u.T).T
    return HistoryFields(
        problem=problem,
        times=history.times,
        moving=True,
        displacement=u,
        velocity=history.velocities,
        load=None,
        gap=gap,
        normal_force=history.normal_forces,
        friction_force=history.friction_forces,
        energies=energies,
        events=history.events,
        notes=history.notes,
    )


def _load(solution: Solution) -> Vector:
    """On the body: of a step of Newton's method `problem.load` is what is left of it."""
    return np.asarray(getattr(solution, "load", solution.problem.load))


def _energies(energies: tuple[Energies, ...], names: tuple[str, ...]) -> dict[str, Vector]:
    values = {name: np.array([getattr(energy, name) for energy in energies]) for name in names}
    sizes = {name: np.max(abs(value[np.isfinite(value)]), initial=0.0) for name, value in values.items()}
    return {name: value for name, value in values.items() if sizes[name] > NO_ENERGY * max(sizes.values())}
