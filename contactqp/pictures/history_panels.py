"""The curves of a load path or a motion: their values at every instant, which are drawn, and in which panels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from contactqp.analysis.history import Energies, Event, History
from contactqp.analysis.load_cases import Solutions
from contactqp.analysis.motion.motion_history import MotionHistory
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Array, Index, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution
from contactqp.pictures import style

# Relative difference up to which loads count as proportional to the times, or to one of them.
PROPORTIONAL = 1e-9
ENERGIES = ("kinetic", "elastic", "total", "work", "dissipated", "impact", "drift")
OF_PATHS = ("elastic", "work", "dissipated")
# Energies below this part of the largest are rounding errors, and are not drawn.
NO_ENERGY = 1e-12


@dataclass(frozen=True, eq=False)
class HistoryFields:
    """The values of a history at its k instants; n unknowns, m contacts.

    Attributes
    ----------
    problem : the problem at the last instant, for names, units and rows
    times : (k,) array
    moving : whether it is a motion, and `times` are times
    displacement : (k, n) array [length]
    velocity : (k, n) array or None, velocities of a motion [length / time]
    load : (k, n) array or None, loads of a load path [force]
    gap : (k, m) array, gaps, positive when open [length]
    normal_force : (k, m) array, contact forces, positive in compression [force]
    friction_force : (k, m, d-1) array or None, friction forces [force]; None without friction
    energies : mapping of str to (k,) array, the energies that are not always zero [force * length]
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
        """Return whether the load is the time times one load: the times are load factors."""
        if self.load is None or not np.any(self.load) or not np.any(self.times):
            return False
        whole = self.times @ self.load / (self.times @ self.times)
        off = np.max(abs(self.load - np.outer(self.times, whole)))
        return bool(off <= PROPORTIONAL * np.max(abs(self.load)))

    def instants(self, events: tuple[Event, ...]) -> Index:
        """Return the instant of each event: the nearest in time, or the next such one where times repeat."""
        found, here = np.empty(len(events), dtype=np.int64), 0
        for i, event in enumerate(events):
            off = abs(self.times - event.time)
            near = np.flatnonzero(off <= off.min()).tolist()
            here = next((instant for instant in near if instant >= here), near[-1])
            found[i] = here
        return found


def history_fields(history: History) -> HistoryFields:
    """Return the fields of a load path or a motion, also of one that was cut short.

    Every solution of a load path is certified for this, as it is for its events.

    Raises InvalidProblem: `history` is not a History, or has no instants.
    """
    if len(history) == 0:
        raise InvalidProblem("draw_history: expected a history of one instant or more, got none")
    if isinstance(history, MotionHistory):
        return _motion_fields(history)
    solutions = list(history)
    friction = [solution.friction_force for solution in solutions]
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
        friction_force=np.array(friction) if frictional and all(f is not None for f in friction) else None,
        energies=_energies(history.energies, OF_PATHS),
        events=history.events,
        notes=history.notes,
    )


def _motion_fields(history: MotionHistory) -> HistoryFields:
    problem, u = history.problem, history.displacements
    with np.errstate(over="ignore", invalid="ignore"):  # a motion that failed may overflow
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
    """Return the load on the body, which in a step of Newton's method is not `problem.load` but `load`."""
    return np.asarray(getattr(solution, "load", solution.problem.load))


def _energies(energies: tuple[Energies, ...], names: tuple[str, ...]) -> dict[str, Vector]:
    values = {name: np.array([getattr(energy, name) for energy in energies]) for name in names}
    sizes = {name: np.max(abs(value[np.isfinite(value)]), initial=0.0) for name, value in values.items()}
    return {name: value for name, value in values.items() if sizes[name] > NO_ENERGY * max(sizes.values())}


# Curves in one panel at most, so that they can be distinguished.
MOST_CONTACTS, MOST_UNKNOWNS = 5, 4
# Unknowns whose work or movement is below this part of the largest are left out.
LEFT_OUT = 1e-6
# The number of the curve that sums all contacts.
ALL = -1


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve; curves of the same number look the same in every panel."""

    label: str
    y: Vector
    number: int


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves over the times, or each over its own abscissa `x`; `size` is that of the terms of their values."""

    label: str
    curves: tuple[Curve, ...]
    size: float = 0.0
    x: tuple[Vector, ...] = ()
    x_label: str = ""


def time_panels(fields: HistoryFields, time_unit: str) -> list[Panel]:
    """Return the panels of displacements, velocities, gaps, forces and energies, as far as the history has them."""
    units, contacts = fields.problem.units, chosen_contacts(fields)
    length, unknowns = style.length_unit(units), chosen_unknowns(fields, contacts)
    moved = _largest(fields.displacement)
    panels = [Panel(f"displacement [{length}]", _unknown_curves(fields, fields.displacement, unknowns), moved)]
    if fields.velocity is not None:
        label = f"velocity [{length}/{time_unit or 'time'}]"
        panels.append(Panel(label, _unknown_curves(fields, fields.velocity, unknowns)))
    panels += contact_panels(fields, contacts, moved)
    energies = tuple(Curve(name, value, ENERGIES.index(name)) for name, value in fields.energies.items())
    panels.append(Panel(f"energy [{style.energy_unit(units)}]", energies))
    return [panel for panel in panels if panel.curves]


def contact_panels(fields: HistoryFields, contacts: Index, moved: float) -> list[Panel]:
    """Return the panels of gaps, whose terms are of the size `moved` [length], and of normal and friction forces."""
    if not fields.problem.contacts:
        return []
    length, force = style.length_unit(fields.problem.units), style.force_unit(fields.problem.units)
    pushed = _largest(fields.normal_force)
    panels = [
        Panel(f"gap [{length}]", _contact_curves(fields, fields.gap, contacts, "smallest"), moved),
        Panel(f"normal force [{force}]", _contact_curves(fields, fields.normal_force, contacts, "sum"), pushed),
    ]
    if fields.friction_force is not None:
        in_plane = fields.friction_force.shape[2] == 1
        values = fields.friction_force[:, :, 0] if in_plane else np.linalg.norm(fields.friction_force, axis=2)
        label = "friction force" if in_plane else "friction force, size"
        rubbed = max(pushed, _largest(values))  # a contact with friction 1e20 sticks while almost nothing pushes
        panels.append(Panel(f"{label} [{force}]", _contact_curves(fields, values, contacts, "sum"), rubbed))
    return panels


def case_fields(many: Solutions) -> HistoryFields:
    """Return the forces and gaps of many load cases over their numbers; displacements are left out."""
    return HistoryFields(
        problem=many.problem,
        times=np.arange(len(many), dtype=float),
        moving=False,
        displacement=np.zeros((len(many), 0)),
        velocity=None,
        load=None,
        gap=many.gap,
        normal_force=many.normal_force,
        friction_force=many.friction_force,
        energies={},
        events=(),
        notes=(),
    )


def time_label(fields: HistoryFields, time_unit: str, stated: str) -> str:
    """Return the label of the time axis; `stated` is used for a motion without a unit of time."""
    if fields.moving:
        return f"time [{time_unit}]" if time_unit else stated
    return "load factor" if fields.proportional else "pseudo-time [legs]"


def chosen_contacts(fields: HistoryFields) -> Index:
    """Return the contacts with the largest forces, then those with the smallest gaps."""
    with np.errstate(invalid="ignore"):
        push = np.nanmax(abs(fields.normal_force), axis=0, initial=0.0)
        near = np.nanmin(fields.gap, axis=0, initial=np.inf)
    order = np.lexsort([near, -push])[:MOST_CONTACTS]
    return np.sort(order)


def chosen_unknowns(fields: HistoryFields, contacts: Index) -> Index:
    """Return the unknowns whose loads do most work on a load path, or those of contacts that move most."""
    moved, candidates = _moved(fields), np.arange(fields.displacement.shape[1])
    weight = moved
    if fields.load is not None:
        work = work_of_unknowns(fields)
        weight = work if np.any(work) else moved
    elif np.any(moved[touched := _touched(fields.problem, contacts)]):
        candidates = touched
    found = ranked(candidates, weight[candidates])
    return (found if len(found) else candidates)[:MOST_UNKNOWNS]


def _touched(problem: ContactProblem, contacts: Index) -> Index:
    """Return the unknowns in the rows of these contacts."""
    found = [problem.normal[contacts].nonzero()[1]]
    if problem.tangent is not None and problem.contacts:
        width = problem.tangent.shape[0] // problem.contacts
        rows = (width * contacts[:, np.newaxis] + np.arange(width)).ravel()
        found.append(problem.tangent[rows].nonzero()[1])
    return np.unique(np.concatenate(found))


def _largest(values: Array) -> float:
    return float(np.max(abs(values[np.isfinite(values)]), initial=0.0))


def _moved(fields: HistoryFields) -> Vector:
    """Return the range of each displacement, (n,) [length]."""
    u = np.where(np.isfinite(fields.displacement), fields.displacement, 0.0)
    return np.asarray(np.ptp(u, axis=0))


def work_of_unknowns(fields: HistoryFields) -> Vector:
    """Return an upper bound of the work of the load of each unknown, (n,) [force * length]."""
    load = np.zeros(1) if fields.load is None else np.max(abs(fields.load), axis=0)
    return np.asarray(load * _moved(fields))


def ranked(unknowns: Index, weight: Vector) -> Index:
    """Return the unknowns by decreasing weight, without those of negligible weight."""
    order = np.argsort(-weight, kind="stable")
    return unknowns[order[weight[order] > LEFT_OUT * np.max(weight, initial=0.0)]]


def _unknown_curves(fields: HistoryFields, values: Array, unknowns: Index) -> tuple[Curve, ...]:
    return tuple(Curve(fields.problem.dof_name(int(j)), values[:, j], i) for i, j in enumerate(unknowns))


def _contact_curves(fields: HistoryFields, values: Array, contacts: Index, whole: str) -> tuple[Curve, ...]:
    """Return a curve for each contact, and one of all together where some are left out."""
    names = fields.problem.contact_name
    curves = [Curve(names(int(i)), values[:, i], place) for place, i in enumerate(contacts)]
    count = values.shape[1]
    if count > len(contacts):
        together = values.min(axis=1) if whole == "smallest" else values.sum(axis=1)
        curves.append(Curve(f"{whole} of all {count}", together, ALL))
    return tuple(curves)


# Loads that come one by one and are drawn as curves of their own, at most.
MOST_LOADS = 3


@dataclass(frozen=True, eq=False)
class Part:
    """One term of the loads: amount (k,) times pattern (n,) [force]."""

    amount: Vector
    pattern: Vector

    @property
    def size(self) -> float:
        """Return the sum of the sizes of the pattern's forces [force]."""
        return float(np.sum(abs(self.pattern)))


def load_panel(fields: HistoryFields) -> Panel | None:
    """Return load over displacement; None without loads, and where there are too many loads.

    One load that grows and shrinks: its factor over the displacements of up to four loaded unknowns. Several loads on
    up to four unknowns: the force on each over its displacement. Loads on more unknowns: over their mean displacement
    p'u / sum |p|, p the load; for several loads the force is that of each, sum |p|, so that the area is its work, and
    each is called after the pseudo-time from which it grows: ``load 2, from 1 on``.
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
    curves = tuple(
        Curve(f"load {i + 1}, from {_first_growth(fields, part):.4g} on", part.amount * part.size, i)
        for i, part in enumerate(parts)
    )
    return Panel(f"load [{style.force_unit(fields.problem.units)}]", curves, x=x, x_label=x_label)


def _first_growth(fields: HistoryFields, part: Part) -> float:
    """Return the last pseudo-time at which a part of the loads is still zero, before it first grows."""
    acts = np.flatnonzero(abs(part.amount) > PROPORTIONAL * np.max(abs(part.amount)))
    return float(fields.times[max(int(acts[0]) - 1, 0)]) if len(acts) else 0.0


def load_factor(fields: HistoryFields) -> Vector | None:
    """Return the factor (k,) of loads that are all multiples of one load, else None.

    It is the time where loads are proportional to it, else the load over the largest one.

    >>> from types import SimpleNamespace
    >>> load_factor(SimpleNamespace(load=np.array([[0.0, 0.0], [2.0, 4.0], [-1.0, -2.0]]), proportional=False)).tolist()
    [0.0, 1.0, -0.5]
    """
    if fields.load is None or fields.proportional:
        return fields.times if fields.load is not None else None
    largest = fields.load[int(np.argmax(np.max(abs(fields.load), axis=1)))]
    factor = np.asarray(fields.load @ largest / (largest @ largest))
    off = np.max(abs(fields.load - np.outer(factor, largest)))
    return factor if off <= PROPORTIONAL * np.max(abs(largest)) else None


def load_parts(load: Array) -> tuple[Part, ...]:
    """Split loads (k, n) into at most three that come one by one, each as it first grows; empty where there are more.

    >>> press, push = np.array([0.0, 2.0, 2.0]), np.array([1.0, 0.0, 0.0])
    >>> parts = load_parts(np.array([0 * press, press, press + push, press - push]))
    >>> [[round(float(a), 9) + 0.0 for a in part.amount] for part in parts]
    [[0.0, 1.0, 1.0, 1.0], [0.0, 0.0, 1.0, -1.0]]
    """
    growth, patterns = np.diff(load, axis=0, prepend=0.0), np.zeros((0, load.shape[1]))
    rest, largest = growth, float(np.max(abs(load)))
    while np.any(new := np.max(abs(rest), axis=1) > PROPORTIONAL * largest):
        if len(patterns) == MOST_LOADS:
            return ()
        patterns = np.vstack([patterns, growth[int(np.argmax(new))]])
        basis = np.linalg.qr(patterns.T)[0]
        rest = growth - (growth @ basis) @ basis.T
    amounts = np.cumsum(np.linalg.lstsq(patterns.T, growth.T, rcond=None)[0], axis=1)
    return tuple(Part(amount, pattern) for amount, pattern in zip(amounts, patterns, strict=True))


def _loads_of_unknowns(fields: HistoryFields, unknowns: Index, factor: Vector | None) -> Panel | None:
    """Return a curve for each loaded unknown."""
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
