"""Read answers in this package's own formats: JSON, .npz by names, folders of files, single arrays, and CSV tables.

JSON is an object whose keys are the parts of an answer, each a list or an object of values by name.

    {"displacement": {"tip.x": 1e-3}, "normal_force": [142.5], "friction_force": [[0.5, 0.0]], "tie_force": [2.0]}

What `contactqp run CASE --method M --json` prints is one, alone in a list; its friction_force is along the axes of the
case, and its friction_components, along the rows of E_T, are what is read. null is NaN. The answer to a quadratic
program may come as x, y, z and z_box, with qpsolvers' signs.

An array whose file has no such name (u.npy, normal_force.mtx, ...) is displacements or normal forces where its length
leaves no doubt, which the ledger says.
"""

from __future__ import annotations

import json
import re
from codecs import BOM_UTF8
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import BackendMissing, InvalidProblem
from contactqp.exchange import matrix_files, numpy_files, text_matrices
from contactqp.exchange.answer_reader import (
    LIKE_REACTIONS,
    AnswerFile,
    AnswerReader,
    answer_of_names,
    has_contact_forces,
    names_of,
    part_called,
    places,
    real_array,
    refuse_unit,
    refuse_unread,
    unread_part,
    vector,
)
from contactqp.exchange.files import HEAD, Ledger, Path, is_number, one_line, read_bytes, read_text, wrong
from contactqp.exchange.numpy_files import NUMPY, ZIP
from contactqp.exchange.tables import Table, begins_with, is_table, read_tables
from contactqp.exchange.text_matrices import is_matrix_market
from contactqp.model.arrays import Array
from contactqp.model.names import axis_called
from contactqp.model.problem import ContactProblem

JSON = "JSON"
COMPONENTS = "friction_components"
# Keys that identify the output of `contactqp run --json`.
PRINTED = frozenset(("solved_by", "contact_status", "certificate"))
OBJECT = "a JSON file with displacement and normal_force"


def read_json_answer(path: Path, problem: ContactProblem) -> AnswerFile:
    """Return the one answer in a JSON file, alone or as the only one in a list.

    Raises
    ------
    InvalidProblem
        No JSON, no part of an answer in it, a key twice, values that are not numbers, names that are not the problem's.
    """
    data = load_json(path, OBJECT)
    if isinstance(data, list):
        if len(data) != 1 or not isinstance(data[0], dict):
            got = "a list of numbers" if not any(isinstance(one, dict) for one in data) else f"{len(data)} in a list"
            cure = "; one is printed by contactqp run CASE --method M --json" if len(data) > 1 else ""
            raise wrong(path, "content", 'one answer, such as {"displacement": [...]}', got + cure)
        data = data[0]
    if not isinstance(data, dict):
        raise wrong(path, "content", OBJECT, type(data).__name__)
    of_program = answer_of_names(path, problem, data)
    if of_program is not None:
        return of_program
    ledger, parts, named, tie_names = Ledger(str(path)), {}, set(), None
    _refuse_other_units(path, data.get("units"), problem)
    printed = data.keys() >= PRINTED
    for key, values in data.items():
        part = part_called(key) if key != COMPONENTS else "friction_force"
        refuse_unit(path, key)
        if part == "friction_force" and key != COMPONENTS and _along_axes(values):
            if COMPONENTS not in data:
                raise wrong(path, key, "one or two components a contact, along the rows of E_T", "vectors along axes")
            part = None
        elif part is None and not printed:
            refuse_unread(path, key, values, problem, forces_are_read=has_contact_forces(data))
        if part is None or values is None:
            ledger.ignored.extend([] if printed else [f"{key:.60}"])
            continue
        if part in parts:
            raise wrong(path, key, "every part once", f"{part} twice")
        if isinstance(values, dict):
            found = real_array(path, key, list(values.values()))
            if part == "tie_force":
                tie_names = tuple(values)
            else:
                found = found[places(path, key, list(values), names_of(problem, part), ledger)]
            named.add(part)
        elif isinstance(values, list):
            found = real_array(path, key, values)
        else:
            raise wrong(path, key, "a list, or values by name", f"{values!r:.40}")
        parts[part] = vector(path, part, found)
        ledger.read.append(f"{part}: {len(found)} values {'by name' if part in named else 'in order'}")
    if not parts:
        raise wrong(path, "content", OBJECT, f"the keys {', '.join(data)!s:.100}")
    if printed:
        ledger.ignored.append("what contactqp run --json prints beside displacements and forces")
    return AnswerFile(parts, ledger, frozenset(named), tie_names)


def _refuse_other_units(path: Path, stated: Any, problem: ContactProblem) -> None:
    """Refuse an answer that states other units than the problem, as JSON printed by the command `run` states them.

    Raises InvalidProblem: a unit of length or force with another name, where the problem names its own.
    """
    if not isinstance(stated, dict):
        return
    for what, ours in (("length", problem.units.length), ("force", problem.units.force)):
        theirs = stated.get(what)
        if ours and isinstance(theirs, str) and theirs and _plain_unit(theirs) != _plain_unit(ours):
            raise wrong(
                path, f"units.{what}", f"{ours!r}, that of the problem", f"{theirs!r:.20}, and none is converted"
            )


def _plain_unit(name: str) -> str:
    return name.replace("\u00b5", "u").replace("\u03bc", "u")


def _along_axes(values: Any) -> bool:
    return isinstance(values, dict) and any(isinstance(one, dict) for one in values.values())


def load_json(path: Path, expected: str) -> Any:
    """Return what a JSON file holds.

    Raises InvalidProblem: no such file, no JSON, a key twice in one object.
    """
    text = read_text(path, expected)

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) != len(pairs):
            keys = [key for key, _ in pairs]
            twice = next(key for k, key in enumerate(keys) if key in keys[:k])
            raise wrong(path, f"{twice:.60}", "every key once", "it twice")
        return found

    try:
        return json.loads(text, object_pairs_hook=once)
    except InvalidProblem:
        raise
    except RecursionError:
        raise wrong(path, "content", expected, "JSON nested beyond reading") from None
    except ValueError as error:
        raise wrong(path, "content", "JSON", one_line(error)) from None


def is_json_answer(head: bytes) -> bool:
    """Return whether a file begins with a JSON object, alone or as the first in a list."""
    return head.removeprefix(BOM_UTF8).replace(b"[", b" ", 1).lstrip()[:1] == b"{"


JSON_READER = AnswerReader(JSON, (".json",), read_json_answer, recognises=is_json_answer)

# Answers in CSV: tables by unknown, node, contact and tie, their rows in any order.
#
# dof,displacement or node,x,y,z (or ux, U1, D1, ..., rotx, UR1) contact,normal_force[,friction_force |
# ,friction_1,friction_2] tie,tie_force

TABLE = "CSV with named columns"
KEYS = ("dof", "unknown", "node", "contact", "tie")
Held = dict[str, Array]
FRICTION = re.compile(r"friction(?:_force)?(?:_(?!coefficient)(\d|[a-z]\w*))?")


def read_table_answer(path: Path, problem: ContactProblem) -> AnswerFile:
    """Return what the tables of a CSV file hold.

    Raises
    ------
    InvalidProblem
        As `read_tables`; a table that says nothing of an answer, a part twice, names that are not the problem's.
    """
    ledger = Ledger(str(path))
    found: Held = {}
    tie_names: tuple[str, ...] | None = None
    headings: list[str] = []
    for table in read_tables(path, KEYS):
        headings.append(",".join(table.columns))
        held = _by_node(table, problem, ledger) if table.columns[0] == "node" else _by_name(table, problem, ledger)
        twice = next((part for part in held if part in found), None)
        if twice is not None:
            raise wrong(path, twice, "every part once", "a second table of it")
        found |= held
        tie_names = tuple(table.column("tie")) if "tie_force" in held else tie_names
    if not found:
        expected = "a column displacement beside dof, or normal_force beside contact"
        raise wrong(path, "content", expected, f"the columns {' and '.join(headings) or 'of no table'}")
    ledger.read.extend(f"{part}: {len(values)} values by name" for part, values in found.items())
    return AnswerFile(found, ledger, frozenset(found), tie_names)


def _by_node(table: Table, problem: ContactProblem, ledger: Ledger) -> Held:
    """Return the displacements of a table with one column an axis, of unknowns that are called node.axis."""
    names: list[str] = []
    values: list[float] = []
    nodes = table.column("node")
    for column in table.columns[1:]:
        axis = axis_called(column)
        if axis is None:
            refuse_unit(table.path, column, axis_called)
            _refuse_unread(table, column)
            ledger.ignored.append(f"column {column:.60}")
            continue
        names += [f"{node}.{axis}" for node in nodes]
        values += table.numbers(column)
    if not names:
        return {}
    part = "displacement"
    order = places(table.path, part, names, names_of(problem, part), ledger)
    return {part: np.array(values)[order]}


def _refuse_unread(table: Table, column: str) -> None:
    """Refuse a column of forces or displacements that would be ignored, so that wrong ones cannot pass unread.

    Raises InvalidProblem: the column's name is one that programs give to forces, or to displacements by unknown.
    """
    like, key = unread_part(column), table.columns[0]
    if like == "displacements" and key in ("dof", "unknown"):
        raise wrong(table.path, f"column {column:.60}", "displacement", "a name under which none are read")
    of_contacts = key == "contact"
    reactions = of_contacts and not has_contact_forces(table.columns) and LIKE_REACTIONS.match(column.lower())
    if part_called(column) is None and like != "forces" and not reactions:
        return
    expected = "normal_force or friction_force" if of_contacts else "forces in a table whose first column is contact"
    raise wrong(table.path, f"column {column:.60}", expected, f"it in a table by {key}")


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
            _refuse_unread(table, column)
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


TABLE_READER = AnswerReader(TABLE, (".csv",), read_table_answer, recognises=lambda head: begins_with(head, KEYS))


ARRAYS = "displacement or normal_force"


def read_npz_answer(path: Path, problem: ContactProblem) -> AnswerFile:
    """Return the arrays of an archive that are parts of an answer.

    Raises InvalidProblem: a damaged archive, none of the names, arrays of anything but numbers.
    """
    arrays = numpy_files.read_npz(path, none_for_objects=True)
    of_program = answer_of_names(path, problem, arrays)
    if of_program is not None:
        return of_program
    ledger = Ledger(str(path))
    parts: dict[str, Array] = {}
    for name, values in arrays.items():
        part = part_called(name)
        if part is None:
            refuse_unit(path, name)
            refuse_unread(path, name, values, problem, forces_are_read=has_contact_forces(arrays))
            ledger.ignored.append(f"{name:.60}")
            continue
        if part in parts:
            raise wrong(path, name, "every part once", f"{part} twice")
        parts[part] = vector(path, part, real_array(path, name, values))
        ledger.read.append(f"{part}: {name}, {len(parts[part])} values in order")
    if not parts:
        raise wrong(path, "content", f"arrays called {ARRAYS}", "none of them")
    return AnswerFile(parts, ledger)


def read_array_answer(path: Path, problem: ContactProblem) -> AnswerFile:
    """Return an answer of one array in any format of matrices; the file's name or its length says which part it is.

    Raises InvalidProblem: no array, or one of a length that may be either or neither.
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
    """Refuse a CSV table whose first column is not a known key, with a message that lists the keys."""
    head = read_bytes(path, ARRAYS, HEAD)
    if matrix_files.reader_of(path) is not text_matrices.TEXT or b"\0" in head:
        return
    lines = head.decode("utf-8-sig", "replace").splitlines()[:2]
    cells = [[cell.strip().strip('"') for cell in re.split("[,;\t]", line)] for line in lines]
    if len(cells) < 2 or len(cells[0]) < 2 or any(map(is_number, cells[0])):
        return
    if not is_number(cells[1][0]) or any(cell.lower() in KEYS for cell in cells[0]):
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
    """Return a sparse column as a vector; a sparse matrix of any other shape is not part of an answer."""
    if not sp.issparse(matrix):
        return matrix
    if min(matrix.shape) > 3:
        raise wrong(path, "content", "a vector", f"a sparse matrix of shape {matrix.shape}")
    return np.asarray(matrix.toarray())


def read_folder_answer(path: Path, problem: ContactProblem) -> AnswerFile:
    """Return the files of a folder that are called like parts of an answer; raises as `read_array_answer`."""
    ledger, named, tie_names = Ledger(str(path)), frozenset[str](), None
    parts: dict[str, Array] = {}
    forces_are_read = has_contact_forces(file.stem for file in FilePath(path).iterdir())
    for file in sorted(FilePath(path).iterdir()):
        part = part_called(file.stem)
        if part is None or file.is_dir():
            _refuse_unread_file(file, problem, forces_are_read)
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
        raise wrong(path, "folder", f"files called {ARRAYS}", "none of them")
    return AnswerFile(parts, ledger, named, tie_names)


def _refuse_unread_file(file: FilePath, problem: ContactProblem, forces_are_read: bool) -> None:
    """Refuse a file that holds parts of an answer, or is called like forces and holds them, and would not be read.

    Raises InvalidProblem: there is such a part in it.
    """
    if file.is_dir():
        return
    try:
        table = any(is_table(file, key) for key in KEYS)
        held = read_table_answer(file, problem).parts if table else {}
        like = unread_part(file.stem) or LIKE_REACTIONS.match(file.stem.lower())
        values = matrix_files.read_matrix(file).matrix if like and not table else None
    except (InvalidProblem, BackendMissing):
        return
    if held:
        raise wrong(file.parent, file.name, f"a file called like what it holds ({', '.join(held)})", "another name")
    if values is not None:
        values = _dense(file, values)
        refuse_unread(file.parent, file.stem, values, problem, forces_are_read=forces_are_read)


ARCHIVE = AnswerReader("NPZ", (".npz",), read_npz_answer, recognises=lambda head: head.startswith((ZIP, b"PK\x05\x06")))
ARRAY = AnswerReader(
    "an array (.npy, .mtx, text)",
    (".npy", ".mtx", ".txt"),
    read_array_answer,
    recognises=lambda head: head.startswith(NUMPY) or is_matrix_market(head),
)
