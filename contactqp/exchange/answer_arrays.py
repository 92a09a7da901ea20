"""Read answers from arrays: .npz by names, folders of files by their names, single arrays, and CSV tables.

An array whose file has no such name (u.npy, normal_force.mtx, ...) is displacements or normal forces where its length
leaves no doubt, which the ledger says.
"""

from __future__ import annotations

import re
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.exchange import matrix_files, numpy_files, text_matrix
from contactqp.exchange.answer_reader import (
    AnswerFile,
    AnswerReader,
    answer_of_names,
    names_of,
    part_called,
    places,
    real_array,
    refuse_unit,
    vector,
)
from contactqp.exchange.matrix_market import is_matrix_market
from contactqp.exchange.numpy_files import NUMPY, ZIP
from contactqp.exchange.refusal import Ledger, Path, is_number, read_bytes, wrong
from contactqp.exchange.tables import HEAD, Table, begins_with, is_table, read_tables
from contactqp.model.problem import ContactProblem
from contactqp.model.unknown_names import axis_called

# Answers in CSV: tables by unknown, node, contact and tie, their rows in any order.
#
# dof,displacement or node,x,y,z (or ux, U1, D1, ..., rotx, UR1) contact,normal_force[,friction_force |
# ,friction_1,friction_2] tie,tie_force

NAME = "CSV with named columns"
KEYS = ("dof", "unknown", "node", "contact", "tie")
Held = dict[str, NDArray[np.float64]]
# Names that codes give to contact forces and pressures: CNORMF, CPRESS, fn, lambda, contact_force, ...; reactions of
# supports, and coefficients, are none.
LIKE_FORCES = re.compile(
    r"(?!react|.*coefficient$).*(?:force|frict|press|traction|lambda|multiplier|shear|normf)|^f_?[nct]"
)
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
            _refuse_forces(table, column)
            ledger.ignored.append(f"column {column:.60}")
            continue
        names += [f"{node}.{axis}" for node in nodes]
        values += table.numbers(column)
    if not names:
        return {}
    part = "displacement"
    order = places(table.path, part, names, names_of(problem, part), ledger)
    return {part: np.array(values)[order]}


def _refuse_forces(table: Table, column: str) -> None:
    """Refuse a column of forces that would be ignored: an answer whose forces are not read may be right without them.

    Raises
    ------
    InvalidProblem
        The column's name is one of forces, as far as names tell.
    """
    if part_called(column) is None and LIKE_FORCES.match(column.strip().lower()) is None:
        return
    of_contacts = table.columns[0] == "contact"
    expected = "normal_force or friction_force" if of_contacts else "forces in a table whose first column is contact"
    raise wrong(table.path, f"column {column:.60}", expected, f"it in a table by {table.columns[0]}")


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
            _refuse_forces(table, column)
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


EXPECTED = "displacement or normal_force"


def read_npz_answer(path: Path, problem: ContactProblem) -> AnswerFile:
    """The arrays of an archive that are parts of an answer.

    Raises
    ------
    InvalidProblem
        A damaged archive, none of the names, arrays of anything but numbers.
    """
    arrays = numpy_files.read_npz(path, none_for_objects=True)
    of_program = answer_of_names(path, problem, arrays)
    if of_program is not None:
        return of_program
    ledger = Ledger(str(path))
    parts: dict[str, NDArray[np.float64]] = {}
    for name, values in arrays.items():
        part = part_called(name)
        if part is None:
            refuse_unit(path, name)
            ledger.ignored.append(f"{name:.60}")
            continue
        if part in parts:
            raise wrong(path, name, "every part once", f"{part} twice")
        parts[part] = vector(path, part, real_array(path, name, values))
        ledger.read.append(f"{part}: {name}, {len(parts[part])} values in order")
    if not parts:
        raise wrong(path, "content", f"arrays called {EXPECTED}", "none of them")
    return AnswerFile(parts, ledger)


def read_array_answer(path: Path, problem: ContactProblem) -> AnswerFile:
    """One array from any format that matrices come in; its part by the file's name, or by its length.

    Raises
    ------
    InvalidProblem
        No array, or one of a length that may be either or neither.
    """
    _refuse_table(path)
    source = matrix_files.read_matrix(path)
    ledger, part = source.ledger, part_called(FilePath(path).stem)
    values = real_array(path, part or "content", _dense(path, source.matrix))
    columns = [part_called(label) for label in source.labels or ()]
    if len(columns) == 1 and columns[0] is not None:
        part = columns[0]
    if part is None:
        part = _by_length(path, values.size, problem)
        ledger.assumed.append(f"{values.size} numbers: {part}, by their length")
    return AnswerFile({part: vector(path, part, values)}, ledger)


def _refuse_table(path: Path) -> None:
    """Refuse a table whose first column is none that is known, in words of tables."""
    head = read_bytes(path, EXPECTED, HEAD)
    if matrix_files.reader_of(path) is not text_matrix.READER or b"\0" in head:
        return
    lines = head.decode("utf-8-sig", "replace").splitlines()[:2]
    cells = [[cell.strip().strip('"') for cell in re.split("[,;\t]", line)] for line in lines]
    if len(cells) == 2 and len(cells[0]) > 1 and not any(map(is_number, cells[0])) and not is_number(cells[1][0]):
        expected = "dof, node, contact or tie as the first column of a table with names"
        raise wrong(path, "first line", expected, f"{lines[0].strip()!r:.60}")


def _by_length(path: Path, size: int, problem: ContactProblem) -> str:
    n, m = problem.dimension, problem.contacts
    if n != m and size in (n, m):
        return "displacement" if size == n else "normal_force"
    expected = f"{n} displacements or {m} normal forces"
    if n == m and size == n:
        raise wrong(path, "content", f"a file called displacement or normal_force ({expected})", f"{size} numbers")
    raise wrong(path, "content", expected, f"{size} numbers")


def _dense(path: Path, matrix: Any) -> Any:
    """A sparse column as a vector; a sparse matrix of any other shape is no part of an answer."""
    if not sp.issparse(matrix):
        return matrix
    if min(matrix.shape) > 3:
        raise wrong(path, "content", "a vector", f"a sparse matrix of shape {matrix.shape}")
    return np.asarray(matrix.toarray())


def read_folder_answer(path: Path, problem: ContactProblem) -> AnswerFile:
    """The files of a folder that are called like parts of an answer; raises as `read_array_answer`."""
    ledger, named, tie_names = Ledger(str(path)), frozenset[str](), None
    parts: dict[str, NDArray[np.float64]] = {}
    for file in sorted(FilePath(path).iterdir()):
        part = part_called(file.stem)
        if part is None or file.is_dir():
            ledger.ignored.append(file.name)
            continue
        if part in parts:
            raise wrong(path, file.name, "every part once", f"{part} twice")
        table = any(is_table(file, key) for key in KEYS)
        found = (read_table_answer if table else read_array_answer)(file, problem)
        if set(found.parts) != {part}:
            raise wrong(path, file.name, f"{part} and nothing else", ", ".join(found.parts))
        parts |= found.parts
        named |= found.named
        tie_names = found.tie_names or tie_names
        for kind, line in found.ledger:
            getattr(ledger, kind).append(f"{file.name}: {line}")
    if not parts:
        raise wrong(path, "folder", f"files called {EXPECTED}", "none of them")
    return AnswerFile(parts, ledger, named, tie_names)


ARCHIVE = AnswerReader("NPZ", (".npz",), read_npz_answer, known=lambda head: head.startswith((ZIP, b"PK\x05\x06")))
ARRAY = AnswerReader(
    "an array (.npy, .mtx, text)",
    (".npy", ".mtx", ".txt"),
    read_array_answer,
    known=lambda head: head.startswith(NUMPY) or is_matrix_market(head),
)
