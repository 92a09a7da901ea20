"""Read an answer to a problem from a file of any format, or contact forces alone.

A format of answers is one module with a `READER`, and its line in `READERS` here; `register` adds one from outside.

Contact forces come from FCLIB's /solution, NumPy's .npy, JSON, CSV or plain numbers, told apart by content:

    .npy    an array (m, d) or flat
    JSON    the same as lists, or {"force": ..., "joint_force": ..., "velocity": ..., "motion": ...}
    CSV     d columns, a row for each contact; a first line of names is stepped over, and where the first of them is
            "contact" that column names the contacts, which may then stand in any order
    text    m d numbers; what follows # is a comment

r is the force on the body, in the order (N, T1, T2) contact by contact. NaN is read as it stands; the certificate
refuses it.
"""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from contactqp.errors import counted
from contactqp.exchange import ansys, calculix_results, own_answers
from contactqp.exchange.answer_reader import AnswerFile, AnswerReader, places
from contactqp.exchange.fclib import SIGNATURE, SIGNATURE_PLACES, StoredAnswer, is_hdf5, read_solution_for
from contactqp.exchange.files import (
    HEAD,
    Ledger,
    Path,
    is_number,
    no_number,
    number,
    one_line,
    read_bytes,
    read_text,
    wrong,
)
from contactqp.exchange.numpy_files import NUMPY, read_npy
from contactqp.exchange.own_answers import load_json
from contactqp.exchange.problem_writing import ANSWER_FILE
from contactqp.model.arrays import Array
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem

EXPECTED = "forces: FCLIB's HDF5, .npy, JSON, CSV or plain numbers"
SIGNATURE_BYTES = max(SIGNATURE_PLACES) + len(SIGNATURE)
NORMAL = re.compile(r"(?:r|f|l|force|reaction)?_?n(?:ormal)?(?:_force)?\b.*|normal.*")
KEYS = ("force", "joint_force", "velocity", "motion")


def read_candidate_forces(path: Path, problem: LocalProblem) -> tuple[StoredAnswer, Ledger]:
    """Return the answer stored in a file, with forces (m, d), and the ledger of what was read; nothing is certified
    here.

    Raises InvalidProblem: no such file, or not m d numbers; BackendMissing: an HDF5 file, and h5py is not installed.
    """
    ledger = Ledger(str(path))
    found, form = _read(path, problem, ledger)
    ledger.read.append(f"{form}: the forces of {counted('contact', problem.contacts)}, in the order (N, T1, T2)")
    others = {"joint_force": found.joint_force, "velocity": found.velocity, "motion": found.motion}
    held = [name for name, value in others.items() if value is not None]
    if held:
        ledger.read.append(", ".join(held))
    return found, ledger


def _read(path: Path, problem: LocalProblem, ledger: Ledger) -> tuple[StoredAnswer, str]:
    """Return the answer and the name of its format."""
    head = read_bytes(path, EXPECTED, SIGNATURE_BYTES)
    if is_hdf5(head):
        return read_solution_for(path, problem.contacts, problem.dimension), "FCLIB"
    if head.startswith(NUMPY):
        return StoredAnswer(_forces(path, read_npy(path), problem)), ".npy"
    text = read_text(path, EXPECTED)
    if text.lstrip()[:1] in ("[", "{"):
        return _from_json(path, problem), "JSON"
    separator = next((mark for mark in (";", ",") if mark in text), None)
    values = _plain(path, text) if separator is None else _table(path, text, separator, problem, ledger)
    return StoredAnswer(_forces(path, values, problem)), "text" if separator is None else "CSV"


def _forces(path: Path, values: Any, problem: LocalProblem, place: str = "force") -> Array:
    shape = (problem.contacts, problem.dimension)
    array = _numbers(path, values, place)
    if array.shape not in (shape, (shape[0] * shape[1],)):
        raise wrong(path, place, f"shape {shape} or ({shape[0] * shape[1]},)", array.shape)
    return array.reshape(shape)


def _numbers(path: Path, values: Any, place: str) -> Array:
    try:
        raw = np.asarray(values)
        if raw.dtype.kind not in "fiu":
            raise TypeError(f"{raw.dtype}")
        return raw.astype(float)
    except (TypeError, ValueError, OverflowError) as error:
        raise wrong(path, place, "real numbers", one_line(error)) from None


def _from_json(path: Path, problem: LocalProblem) -> StoredAnswer:
    data = load_json(path, EXPECTED)
    if not isinstance(data, dict):
        return StoredAnswer(_forces(path, data, problem))
    unknown = sorted(set(data) - set(KEYS))
    if unknown or "force" not in data:
        raise wrong(path, "keys", f"'force' and at most {', '.join(KEYS[1:])}", unknown or sorted(data))
    velocity, joint, motion = (data.get(key) for key in ("velocity", "joint_force", "motion"))
    return StoredAnswer(
        force=_forces(path, data["force"], problem),
        joint_force=None if joint is None else _numbers(path, joint, "joint_force"),
        velocity=None if velocity is None else _forces(path, velocity, problem, "velocity"),
        motion=None if motion is None else _numbers(path, motion, "motion"),
    )


def _plain(path: Path, text: str) -> Array:
    words = [word for line in text.splitlines() for word in line.partition("#")[0].split()]
    return np.array([_number(path, word, "force") for word in words])


def _number(path: Path, word: str, place: str) -> float:
    try:
        return number(word)
    except ValueError:
        raise no_number(path, place, word) from None


def _table(path: Path, text: str, separator: str, problem: LocalProblem, ledger: Ledger) -> Array:
    try:
        rows = [[cell.strip() for cell in row] for row in csv.reader(io.StringIO(text), delimiter=separator)]
    except csv.Error as error:
        raise wrong(path, "content", EXPECTED, str(error)) from None
    rows = [row for row in rows if any(row)]
    header = rows.pop(0) if rows and not is_number(rows[0][-1]) else []
    named = bool(header) and header[0].lower() == "contact"
    width = problem.dimension + named
    if header:
        _check_header(path, header[named:], ledger)
    for k, row in enumerate(rows):
        if len(row) != width:
            raise wrong(path, f"row {k + 1}", f"{width} cells", len(row))
    values = np.array([[_number(path, cell, f"row {k + 1}") for cell in row[named:]] for k, row in enumerate(rows)])
    return values[_order(path, [row[0] for row in rows], problem)] if named else values


def _check_header(path: Path, columns: list[str], ledger: Ledger) -> None:
    """Refuse a header that states another order of columns than (N, T1, T2), in which they are taken."""
    text = ", ".join(columns)
    if any(NORMAL.fullmatch(column.lower()) for column in columns[1:]):
        raise wrong(path, "first line", "columns in the order N, T1, T2", f"{text!r:.60}")
    ledger.ignored.append(f"names of columns ({text:.60}): in the order (N, T1, T2), no unit converted")


def _order(path: Path, names: list[str], problem: LocalProblem) -> list[int]:
    """Return the index of the contact that each row of the file belongs to, by its name or its number."""
    place: dict[str, int] = {}
    for k, name in enumerate(names):
        if name in place:
            raise wrong(path, "contact", "every contact once", f"{name!r} twice")
        place[name] = k
    found = []
    for i in range(problem.contacts):
        called = [name for name in (problem.contact_name(i), str(i)) if name in place]
        if not called:
            raise wrong(path, "contact", f"a row of {problem.contact_name(i)!r}", "none of that name or number")
        found.append(place[called[0]])
    if len(found) != len(names):
        extra = next(name for k, name in enumerate(names) if k not in found)
        raise wrong(path, "contact", f"the {problem.contacts} contacts of the problem", repr(extra))
    return found


READERS: list[AnswerReader] = [
    own_answers.JSON_READER,
    own_answers.TABLE_READER,
    own_answers.ARCHIVE,
    own_answers.ARRAY,
    calculix_results.FRD,
    calculix_results.DAT,
    ansys.RESULT_READER,
]


def read_answer(path: Path, problem: ContactProblem) -> AnswerFile:
    """Return the answer in a file: its parts, the ledger, and which parts came by name.

    Raises InvalidProblem: no such file, no answer in it, names that are not the problem's; BackendMissing: the package
    that reads this format is not installed.

    Parameters
    ----------
    path : path
        A file; or a folder of files called displacement, normal_force, ..., or one with an answer.json.
    problem : ContactProblem
        Whose names and sizes the file is held against; its ties are also called "tie 0", "tie 1", ... . Lists keep the
        file's order and length.

    Examples
    --------
    >>> import json, tempfile, pathlib, contactqp as cq
    >>> wall = cq.ContactProblem(stiffness=[[157500.0]], load=[300.0], normal=[[1.0]], gap=[1e-3])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "answer.json")
    ...     _ = file.write_text(json.dumps({"displacement": [1e-3], "normal_force": {"contact 0": 142.5}}))
    ...     found = read_answer(file, wall)
    >>> found.parts["normal_force"], sorted(found.named), found.ledger.read
    (array([142.5]), ['normal_force'], ['displacement: 1 values in order', 'normal_force: 1 values by name'])
    """
    file = FilePath(path)
    if file.is_dir() and (file / ANSWER_FILE).is_file():
        return read_answer(file / ANSWER_FILE, problem)
    read = own_answers.read_folder_answer if file.is_dir() else reader_of(path).read
    found = read(path, problem)
    if found.tie_names is None:
        return found
    names = [f"tie {k}" for k in range(problem.ties)]
    if set(found.tie_names) != set(names):
        names = list(map(problem.tie_name, range(problem.ties)))
    order = places(path, "tie_force", found.tie_names, names, found.ledger)
    return found._replace(parts={**found.parts, "tie_force": found.parts["tie_force"][order]})


def register(reader: AnswerReader) -> None:
    """Register a reader of another format; registered readers are tried before the package's own."""
    READERS.insert(0, reader)


def reader_of(path: Path) -> AnswerReader:
    """Return the reader of a file, found by its first bytes, else by its suffix, else the reader of plain numbers."""
    head = read_bytes(path, _expected(), HEAD)
    suffix = FilePath(path).suffix.lower()
    for reader in READERS:
        if reader.recognises is not None and reader.recognises(head):
            return reader
    by_suffix = (reader for reader in READERS if suffix in reader.suffixes and reader is not own_answers.TABLE_READER)
    return next(by_suffix, own_answers.ARRAY)


def _expected() -> str:
    return "an answer: " + ", ".join(reader.name for reader in READERS)
