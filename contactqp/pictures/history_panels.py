"""Which curves of a history are drawn: of many contacts and unknowns those that tell most."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from contactqp.model.arrays import Array, Index, Vector
from contactqp.model.problem import ContactProblem
from contactqp.pictures import style
from contactqp.pictures.history_fields import ENERGIES, HistoryFields

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
    units, contacts = fields.problem.units, telling_contacts(fields)
    length, force = style.length_unit(units), style.force_unit(units)
    unknowns = telling_unknowns(fields, contacts)
    moved, pushed = (_largest(values) for values in (fields.displacement, fields.normal_force))
    panels = [Panel(f"displacement [{length}]", _of_unknowns(fields, fields.displacement, unknowns), moved)]
    if fields.velocity is not None:
        label = f"velocity [{length}/{time_unit or 'time'}]"
        panels.append(Panel(label, _of_unknowns(fields, fields.velocity, unknowns)))
    if fields.problem.contacts:
        panels.append(Panel(f"gap [{length}]", _of_contacts(fields, fields.gap, contacts, "smallest"), moved))
        panels.append(
            Panel(f"normal force [{force}]", _of_contacts(fields, fields.normal_force, contacts, "sum"), pushed)
        )
    if fields.friction_force is not None:
        in_plane = fields.friction_force.shape[2] == 1
        values = fields.friction_force[:, :, 0] if in_plane else np.linalg.norm(fields.friction_force, axis=2)
        label = "friction force" if in_plane else "friction force, size"
        panels.append(Panel(f"{label} [{force}]", _of_contacts(fields, values, contacts, "sum"), pushed))
    energies = tuple(Curve(name, value, ENERGIES.index(name)) for name, value in fields.energies.items())
    panels.append(Panel(f"energy [{style.energy_unit(units)}]", energies))
    return [panel for panel in panels if panel.curves]


def time_label(fields: HistoryFields, time_unit: str) -> str:
    """What stands below the panels of `time_panels`."""
    if fields.moving:
        return f"time [{time_unit}]" if time_unit else "time"
    return "load factor" if fields.proportional else "pseudo-time"


def telling_contacts(fields: HistoryFields) -> Index:
    """Of many contacts those that push hardest, then those that come nearest."""
    with np.errstate(invalid="ignore"):
        push = np.nanmax(abs(fields.normal_force), axis=0, initial=0.0)
        near = np.nanmin(fields.gap, axis=0, initial=np.inf)
    order = np.lexsort([near, -push])[:MOST_CONTACTS]
    return np.sort(order)


def telling_unknowns(fields: HistoryFields, contacts: Index) -> Index:
    """Of a load path the unknowns whose loads do most; of a motion those of the contacts that move most."""
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
    """Those that tell something, the most telling first."""
    order = np.argsort(-tells, kind="stable")
    return unknowns[order[tells[order] > TELLS * np.max(tells, initial=0.0)]]


def _of_unknowns(fields: HistoryFields, values: Array, unknowns: Index) -> tuple[Curve, ...]:
    return tuple(Curve(fields.problem.dof_name(int(j)), values[:, j], i) for i, j in enumerate(unknowns))


def _of_contacts(fields: HistoryFields, values: Array, contacts: Index, whole: str) -> tuple[Curve, ...]:
    """One curve each; where some are left out, one of them all."""
    names = fields.problem.contact_name
    curves = [Curve(names(int(i)), values[:, i], place) for place, i in enumerate(contacts)]
    count = values.shape[1]
    if count > len(contacts):
        together = values.min(axis=1) if whole == "smallest" else values.sum(axis=1)
        curves.append(Curve(f"{whole} of all {count}", together, ALL))
    return tuple(curves)
