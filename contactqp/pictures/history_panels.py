"""The curves of a history that are drawn, chosen of many, and load over displacement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactqp.analysis.history import Energies, Event, History
from contactqp.analysis.motion.motion_history import MotionHistory
from contactqp.errors import InvalidProblem, refuse_other
from contactqp.model.arrays import Array, Index, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution
from contactqp.pictures import style

# The numbers of a history that are drawn: at every instant displacements, gaps, forces, loads and energies.
#
# A motion keeps them as arrays. Of a load path every solution is looked at once, which costs its certificate; its
# events need that anyway.

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
        return _motion_fields(history)
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


def _motion_fields(history: MotionHistory) -> HistoryFields:
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


# Curves that can be told apart in one panel.
MOST_CONTACTS, MOST_UNKNOWNS = 5, 4
# Of unknowns: those that tell less than this part of what the first one does are left out.
TELLS = 1e-6
# The number of a curve of all contacts together.
ALL = -1


@dataclass(frozen=True, eq=False)
class Curve:
    """One line; curves of the same number look the same in every panel."""

    label: str
    y: Vector
    number: int


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves over the times, or over an abscissa `x` of their own for each; `size` is that of what they are made of."""

    label: str
    curves: tuple[Curve, ...]
    size: float = 0.0
    x: tuple[Vector, ...] = ()
    x_label: str = ""


def time_panels(fields: HistoryFields, time_unit: str) -> list[Panel]:
    """Displacements, velocities, gaps, forces and energies against time; what a history has none of is left out."""
    units, contacts = fields.problem.units, chosen_contacts(fields)
    length, force = style.length_unit(units), style.force_unit(units)
    unknowns = chosen_unknowns(fields, contacts)
    moved, pushed = (_largest(values) for values in (fields.displacement, fields.normal_force))
    panels = [Panel(f"displacement [{length}]", _unknown_curves(fields, fields.displacement, unknowns), moved)]
    if fields.velocity is not None:
        label = f"velocity [{length}/{time_unit or 'time'}]"
        panels.append(Panel(label, _unknown_curves(fields, fields.velocity, unknowns)))
    if fields.problem.contacts:
        panels.append(Panel(f"gap [{length}]", _contact_curves(fields, fields.gap, contacts, "smallest"), moved))
        panels.append(
            Panel(f"normal force [{force}]", _contact_curves(fields, fields.normal_force, contacts, "sum"), pushed)
        )
    if fields.friction_force is not None:
        in_plane = fields.friction_force.shape[2] == 1
        values = fields.friction_force[:, :, 0] if in_plane else np.linalg.norm(fields.friction_force, axis=2)
        label = "friction force" if in_plane else "friction force, size"
        panels.append(Panel(f"{label} [{force}]", _contact_curves(fields, values, contacts, "sum"), pushed))
    energies = tuple(Curve(name, value, ENERGIES.index(name)) for name, value in fields.energies.items())
    panels.append(Panel(f"energy [{style.energy_unit(units)}]", energies))
    return [panel for panel in panels if panel.curves]


def time_label(fields: HistoryFields, time_unit: str) -> str:
    """What stands below the panels of `time_panels`."""
    if fields.moving:
        return f"time [{time_unit}]" if time_unit else "time"
    return "load factor" if fields.proportional else "pseudo-time"


def chosen_contacts(fields: HistoryFields) -> Index:
    """Return, of many contacts, those that push hardest, then those that come nearest."""
    with np.errstate(invalid="ignore"):
        push = np.nanmax(abs(fields.normal_force), axis=0, initial=0.0)
        near = np.nanmin(fields.gap, axis=0, initial=np.inf)
    order = np.lexsort([near, -push])[:MOST_CONTACTS]
    return np.sort(order)


def chosen_unknowns(fields: HistoryFields, contacts: Index) -> Index:
    """Return the unknowns whose loads do most work on a load path, or those of contacts that move most."""
    moved, candidates = _moved(fields), np.arange(fields.displacement.shape[1])
    tells = moved
    if fields.load is not None:
        work = work_of_unknowns(fields)
        tells = work if np.any(work) else moved
    elif np.any(moved[touched := _touched(fields.problem, contacts)]):
        candidates = touched
    found = ranked(candidates, tells[candidates])
    return (found if len(found) else candidates)[:MOST_UNKNOWNS]


def _touched(problem: ContactProblem, contacts: Index) -> Index:
    """The unknowns in the rows of these contacts."""
    found = [problem.normal[contacts].nonzero()[1]]
    if problem.tangent is not None and problem.contacts:
        width = problem.tangent.shape[0] // problem.contacts
        rows = (width * contacts[:, np.newaxis] + np.arange(width)).ravel()
        found.append(problem.tangent[rows].nonzero()[1])
    return np.unique(np.concatenate(found))


def _largest(values: Array) -> float:
    return float(np.max(abs(values[np.isfinite(values)]), initial=0.0))


def _moved(fields: HistoryFields) -> Vector:
    """(n,) [length]."""
    u = np.where(np.isfinite(fields.displacement), fields.displacement, 0.0)
    return np.asarray(np.ptp(u, axis=0))


def work_of_unknowns(fields: HistoryFields) -> Vector:
    """(n,) at most what the load of each unknown does [force * length]."""
    load = np.zeros(1) if fields.load is None else np.max(abs(fields.load), axis=0)
    return np.asarray(load * _moved(fields))


def ranked(unknowns: Index, tells: Vector) -> Index:
    """Return the unknowns that move or are loaded, the largest first."""
    order = np.argsort(-tells, kind="stable")
    return unknowns[order[tells[order] > TELLS * np.max(tells, initial=0.0)]]


def _unknown_curves(fields: HistoryFields, values: Array, unknowns: Index) -> tuple[Curve, ...]:
    return tuple(Curve(fields.problem.dof_name(int(j)), values[:, j], i) for i, j in enumerate(unknowns))


def _contact_curves(fields: HistoryFields, values: Array, contacts: Index, whole: str) -> tuple[Curve, ...]:
    """One curve each; where some are left out, one of them all."""
    names = fields.problem.contact_name
    curves = [Curve(names(int(i)), values[:, i], place) for place, i in enumerate(contacts)]
    count = values.shape[1]
    if count > len(contacts):
        together = values.min(axis=1) if whole == "smallest" else values.sum(axis=1)
        curves.append(Curve(f"{whole} of all {count}", together, ALL))
    return tuple(curves)


# Load over displacement: of one load, of few loaded unknowns, or of loads that come one by one.

# Loads that come one by one; more would be curves that nobody could name.
MOST_LOADS = 3


@dataclass(frozen=True, eq=False)
class Part:
    """One of the loads that a load is the sum of: amount (k,) times pattern (n,) [force]."""

    amount: Vector
    pattern: Vector

    @property
    def size(self) -> float:
        """Sum of the sizes of the pattern's forces [force]."""
        return float(np.sum(abs(self.pattern)))


def load_panel(fields: HistoryFields) -> Panel | None:
    """Load over displacement; None where nothing is loaded, or by more loads than can be told apart.

    One load that grows and shrinks: its factor over the displacements of up to four loaded unknowns. Several loads on
    up to four unknowns: the force on each over its displacement. Loads on more unknowns: over their mean displacement
    p'u / sum |p|, p the load; for several loads the force is that of each, sum |p|, so that the area is its work.
    """
    if fields.load is None or not np.any(fields.load):
        return None
    loaded, factor = np.flatnonzero(np.any(fields.load != 0, axis=0)), load_factor(fields)
    if len(loaded) <= MOST_UNKNOWNS:
        return _loads_of_unknowns(fields, ranked(loaded, work_of_unknowns(fields)[loaded]), factor)
    parts = load_parts(fields.load)
    if not parts:
        return None
    x = tuple(fields.displacement @ part.pattern / part.size for part in parts)
    x_label = f"mean displacement along the load [{style.length_unit(fields.problem.units)}]"
    if factor is not None:
        return Panel(_factor_label(fields), (Curve("all loaded", factor, ALL),), x=x, x_label=x_label)
    curves = tuple(Curve(f"load {i + 1}", part.amount * part.size, i) for i, part in enumerate(parts))
    return Panel(f"load [{style.force_unit(fields.problem.units)}]", curves, x=x, x_label=x_label)


def load_factor(fields: HistoryFields) -> Vector | None:
    """(k,) the times where loads are proportional to them, else the load over the largest if it is along it, or None.

    >>> from types import SimpleNamespace
    >>> load_factor(SimpleNamespace(load=np.array([[0.0, 0.0], [2.0, 4.0], [-1.0, -2.0]]), proportional=False)).tolist()
    [0.0, 1.0, -0.5]
    """
    if fields.load is None or fields.proportional:
        return fields.times if fields.load is not None else None
    largest = fields.load[int(np.argmax(np.max(abs(fields.load), axis=1)))]
    factor = np.asarray(fields.load @ largest / (largest @ largest))
    off = np.max(abs(fields.load - np.outer(factor, largest)))
    return factor if off <= ROUNDING * np.max(abs(largest)) else None


def load_parts(load: Array) -> tuple[Part, ...]:
    """The loads (k, n) as a sum of at most three that come one by one, each as it is when it first grows; else none.

    >>> press, push = np.array([0.0, 2.0, 2.0]), np.array([1.0, 0.0, 0.0])
    >>> parts = load_parts(np.array([0 * press, press, press + push, press - push]))
    >>> [[round(float(a), 9) + 0.0 for a in part.amount] for part in parts]
    [[0.0, 1.0, 1.0, 1.0], [0.0, 0.0, 1.0, -1.0]]
    """
    growth, patterns = np.diff(load, axis=0, prepend=0.0), np.zeros((0, load.shape[1]))
    rest, largest = growth, float(np.max(abs(load)))
    while np.any(new := np.max(abs(rest), axis=1) > ROUNDING * largest):
        if len(patterns) == MOST_LOADS:
            return ()
        patterns = np.vstack([patterns, growth[int(np.argmax(new))]])
        basis = np.linalg.qr(patterns.T)[0]
        rest = growth - (growth @ basis) @ basis.T
    amounts = np.cumsum(np.linalg.lstsq(patterns.T, growth.T, rcond=None)[0], axis=1)
    return tuple(Part(amount, pattern) for amount, pattern in zip(amounts, patterns, strict=True))


def _loads_of_unknowns(fields: HistoryFields, unknowns: NDArray[np.int64], factor: Vector | None) -> Panel | None:
    """A curve for each of few loaded unknowns."""
    if fields.load is None or not len(unknowns):
        return None
    problem = fields.problem
    forces = [fields.load[:, j] if factor is None else factor for j in unknowns]
    named = zip(unknowns, forces, strict=True)
    curves = tuple(Curve(problem.dof_name(int(j)), force, i) for i, (j, force) in enumerate(named))
    x = tuple(fields.displacement[:, j] for j in unknowns)
    label = f"load [{style.force_unit(problem.units)}]" if factor is None else _factor_label(fields)
    return Panel(label, curves, x=x, x_label=f"displacement [{style.length_unit(problem.units)}]")


def _factor_label(fields: HistoryFields) -> str:
    return "load factor" if fields.proportional else "load over the largest"
