"""Answers in CSV: tables by unknown, node, contact and tie, their rows in any order.

dof,displacement            or    node,x,y,z (or ux, U1, D1, ..., rotx, UR1)
contact,normal_force[,friction_force | ,friction_1,friction_2]
tie,tie_force
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from contactqp.exchange.answer_reader import AnswerFile, AnswerReader, names_of, part_called, places, refuse_unit
from contactqp.exchange.ledger import Ledger
from contactqp.exchange.refusal import Path, wrong
from contactqp.exchange.tables import Table, begins_with, read_tables
from contactqp.exchange.unknown_names import axis_called
from contactqp.model.problem import ContactProblem

NAME = "CSV with named columns"
KEYS = ("dof", "unknown", "node", "contact", "tie")
Held = dict[str, NDArray[np.float64]]
FRICTION = re.compile(r"friction(?:_force)?(?:_(?!coefficient)(\d|[a-z]\w*))?")


def read_table_answer(path: Path, problem: ContactProblem) -> AnswerFile:
    """What the tables of a CSV file hold.

    Raises
    ------
    InvalidProblem
        As `read_tables`; a table that says nothing of an answer, a part twice, names that are not the problem's.
    """
    ledger = Ledger(str(path))
    found: Held = {}
    tie_names: tuple[str, ...] | None = None
    for table in read_tables(path, KEYS):
        held = _by_node(table, problem, ledger) if table.columns[0] == "node" else _by_name(table, problem, ledger)
        twice = next((part for part in held if part in found), None)
        if twice is not None:
            raise wrong(path, twice, "every part once", "a second table of it")
        found |= held
        tie_names = tuple(table.column("tie")) if "tie_force" in held else tie_names
    if not found:
        raise wrong(path, "content", "a table of displacement or normal_force", "none")
    ledger.read.extend(f"{part}: {len(values)} values by name" for part, values in found.items())
    return AnswerFile(found, ledger, frozenset(found), tie_names)


def _by_node(table: Table, problem: ContactProblem, ledger: Ledger) -> Held:
    """Displacements along the axes, of unknowns that are called node.axis."""
    names: list[str] = []
    values: list[float] = []
    nodes = table.column("node")
    for column in table.columns[1:]:
        axis = axis_called(column)
        if axis is None:
            refuse_unit(table.path, column, axis_called)
            ledger.ignored.append(f"column {column:.60}")
            continue
        names += [f"{node}.{axis}" for node in nodes]
        values += table.numbers(column)
    if not names:
        return {}
    part = "displacement"
    order = places(table.path, part, names, names_of(problem, part), ledger)
    return {part: np.array(values)[order]}


def _by_name(table: Table, problem: ContactProblem, ledger: Ledger) -> Held:
    wanted = {"contact": ("normal_force", "normal_pressure"), "tie": ("tie_force",)}
    belongs = wanted.get(table.columns[0], ("displacement",))
    columns: dict[str, list[str]] = {}
    friction: list[str] = []
    for column in table.columns[1:]:
        part = part_called(column)
        if _is_friction(table, column):
            friction.append(column)
        elif part in belongs:
            columns[part] = [column, *columns.get(part, [])]
        else:
            refuse_unit(table.path, column, lambda name: part_called(name) in belongs or _is_friction(table, name))
            ledger.ignored.append(f"column {column:.60}")
    if friction:
        columns["friction_force"] = sorted(friction) if all(name[-1].isdecimal() for name in friction) else friction
    held: Held = {}
    given = table.column(table.columns[0])
    for part, names in columns.items():
        if part != "friction_force" and len(names) > 1:
            raise wrong(table.path, part, "one column", ", ".join(names)[:100])
        values = np.array([table.numbers(name) for name in names]).T.reshape(len(given), len(names))
        if part != "tie_force":
            values = values[places(table.path, part, given, names_of(problem, part), ledger)]
        held[part] = values if part == "friction_force" else values[:, 0]
    return held


def _is_friction(table: Table, column: str) -> bool:
    return table.columns[0] == "contact" and FRICTION.fullmatch(column) is not None


READER = AnswerReader(NAME, (".csv",), read_table_answer, known=lambda head: begins_with(head, KEYS))
