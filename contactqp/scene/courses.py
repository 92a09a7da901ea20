"""Print pressures along a side, and forces over a load path or a motion, as lines of characters or a table."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from rich.console import Console

from contactqp.analysis.history import History
from contactqp.analysis.large.deformation import LargeHistory
from contactqp.model.arrays import Array
from contactqp.scene.building import NodeModel
from contactqp.scene.judging import Judgement
from contactqp.scene.schema import SceneData, has_corners
from contactqp.scene.tables import Drawn, Letters, course, print_table, written
from contactqp.scene.units import KINDS

# The number of contacts beyond which only their sum is drawn.
MOST_CONTACTS = 6
# The number of nodes drawn on either side of those with force.
BESIDE = 2
# The least number of instants of a course.
EVEN = 48
# Nodes closer than this part of the length of their side count as one place.
SAME_PLACE = 1e-9


def time_label(scene: SceneData) -> str:
    """Return the label of times of events."""
    if scene.motion is not None:
        return "time [s]"
    return "time" if has_corners(scene) else "load factor"


@dataclass(frozen=True)
class Course:
    """A sequence of values that is drawn in one line of characters."""

    contact: str
    what: str
    unit: str
    over: str  # the coordinate or time of the values and its range
    values: Array

    @property
    def cells(self) -> list[str]:
        """Return the cells of the row: contact, quantity with its largest value, and range."""
        largest = f"at most {np.max(self.values):.4g} {self.unit}".rstrip()
        return [self.contact, f"{self.what}, {largest}", self.over]


def print_courses(console: Console, judgement: Judgement) -> None:
    """Print a table of all courses, nothing where there are none."""
    courses = [*_pressures(judgement), *_histories(judgement)]

    def draw(width: int, letters: Letters) -> list[str]:
        return [course(each.values, width, letters) for each in courses]

    print_table(console, ["contact", "course of", "over"], [each.cells for each in courses], [Drawn(1, draw)])


def _pressures(judgement: Judgement) -> Iterator[Course]:
    """Yield the pressures on each side along its longest axis; of nodes at one place the largest."""
    model, solution = judgement.model, judgement.solution
    if isinstance(model, NodeModel):
        return
    system = model.scene.system
    for contact in model.contacts:
        points, pressures = contact.pairing.points, np.nan_to_num(model.pressures(contact.name, solution))
        if len(points) < 2 or not np.any(pressures > 0):
            continue
        axis = int(np.argmax(np.ptp(points, axis=0)))
        place, largest = _across(points[:, axis], pressures)
        pressing = np.flatnonzero(largest > 0)
        near = slice(max(int(pressing[0]) - BESIDE, 0), int(pressing[-1]) + BESIDE + 1)
        unit = system.label(KINDS["pressure"].dimension)
        over = _range(model.scene.axes[axis], place[near], system.length)
        yield Course(contact.name, "pressure", unit, over, largest[near])


def _across(place: Array, values: Array) -> tuple[Array, Array]:
    """Return the places in ascending order without repetition, and the largest value at each."""
    order = np.argsort(place, kind="stable")
    first = np.concatenate([[True], np.diff(place[order]) > SAME_PLACE * np.ptp(place)])
    starts = np.flatnonzero(first)
    return place[order][starts], np.maximum.reduceat(values[order], starts)


def _histories(judgement: Judgement) -> Iterator[Course]:
    """Yield the normal force of each contact, or the sum of many, over a path or motion, and a load factor that
    reverses.
    """
    history, scene = judgement.history, judgement.scene
    if len(history) < 2:
        return
    name, times = time_label(scene), history.times
    if isinstance(history, LargeHistory):
        over = f"{len(history)} equilibria"
        if not bool(np.all(np.diff(times) > 0)):
            yield Course("", "load factor", "", over, times)
    else:
        over = _range(name.removesuffix(" [s]"), times, "s" if name.endswith("[s]") else "")
    for contact, force in of_contacts(judgement, history):
        yield Course(contact, "normal force", scene.units.force, over, _even(times, force))


def _even(times: Array, values: Array) -> Array:
    """Return the values at equidistant times, interpolated between the events of a path."""
    if len(times) >= EVEN or not np.all(np.diff(times) > 0):
        return values
    return np.interp(np.linspace(times[0], times[-1], EVEN), times, values)


def of_contacts(judgement: Judgement, history: History) -> Iterator[tuple[str, Array]]:
    """Yield names of contacts with their normal forces over a history [force]; of very many, one sum."""
    forces = np.asarray(history.normal_forces).reshape(len(history), -1)
    model = judgement.model
    if not isinstance(model, NodeModel):
        for contact in model.contacts:
            yield contact.name, np.array([model.of_entry(contact.name, row, 0.0).sum() for row in forces])
    elif 0 < forces.shape[1] <= MOST_CONTACTS:
        yield from zip(judgement.solution.problem.contact_names or (), forces.T, strict=True)
    elif forces.shape[1]:
        yield "all together", forces.sum(axis=1)


def _range(name: str, values: ArrayLike, unit: str) -> str:
    ends = np.asarray(values, dtype=float)
    return f"{name} {ends[0]:.4g} to {ends[-1]:.4g} {unit}".rstrip()


def print_instants(console: Console, judgement: Judgement, most: int) -> None:
    """Print the normal force of each contact over a path or a motion, at `most` instants at most."""
    history, scene = judgement.history, judgement.scene
    if len(history) < 2:
        return
    chosen = np.unique(np.linspace(0, len(history) - 1, min(len(history), most)).round().astype(int))
    forces = list(of_contacts(judgement, history))
    header = [time_label(scene), *(f"{contact} [{scene.units.force}]" for contact, _ in forces)]
    rows = [[written(history.times[k]), *(written(force[k]) for _, force in forces)] for k in chosen]
    print_table(console, header, rows, most=most)
    if len(chosen) < len(history):
        console.print(f"{len(chosen)} of {len(history)} instants; --json prints all")
