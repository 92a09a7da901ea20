"""Contact forces from a file: FCLIB's /solution, NumPy's .npy, JSON, CSV or plain numbers, told apart by content.

    .npy    an array (m, d) or flat
    JSON    the same as lists, or {"force": ..., "joint_force": ..., "velocity": ..., "motion": ...}
    CSV     d columns, a row for each contact; a first line of names is stepped over, and where the first of them is
            "contact" that column names the contacts, which may then stand in any order
    text    m d numbers; what follows # is a comment

r is the force on the body, in the order (N, T1, T2) contact by contact. NaN is read: it is for the certificate to fail.
"""

from __future__ import annotations

import csv
import io
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import counted
from contactqp.exchange.fclib import SIGNATURE, SIGNATURE_PLACES, StoredAnswer, is_hdf5, read_solution_for
from contactqp.exchange.files import (
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
from contactqp.model.local_problem import LocalProblem

EXPECTED = "forces: FCLIB's HDF5, .npy, JSON, CSV or plain numbers"
HEAD = max(SIGNATURE_PLACES) + len(SIGNATURE)
NORMAL = re.compile(r"(?:r|f|l|force|reaction)?_?n(?:ormal)?(?:_force)?\b.*|normal.*")
KEYS = ("force", "joint_force", "velocity", "motion")


def read_candidate_forces(path: Path, problem: LocalProblem) -> tuple[StoredAnswer, Ledger]:
    """Return forces (m, d) for a problem, what else the file holds, and the ledger; nothing of it is believed.

    Raises
    ------
    InvalidProblem
        No such file, or not m d numbers.
    BackendMissing
        An HDF5 file, and h5py is not installed.
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
    """Return the answer, and what its format is called."""
    head = read_bytes(path, EXPECTED, HEAD)
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


def _forces(path: Path, values: Any, problem: LocalProblem, place: str = "force") -> NDArray[np.float64]:
    shape = (problem.contacts, problem.dimension)
    array = _numbers(path, values, place)
    if array.shape not in (shape, (shape[0] * shape[1],)):
        raise wrong(path, place, f"shape {shape} or ({shape[0] * shape[1]},)", array.shape)
    return array.reshape(shape)


def _numbers(path: Path, values: Any, place: str) -> NDArray[np.float64]:
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


def _plain(path: Path, text: str) -> NDArray[np.float64]:
    words = [word for line in text.splitlines() for word in line.partition("#")[0].split()]
    return np.array([_number(path, word, "force") for word in words])


def _number(path: Path, word: str, place: str) -> float:
    try:
        return number(word)
    except ValueError:
        raise no_number(path, place, word) from None


def _table(path: Path, text: str, separator: str, problem: LocalProblem, ledger: Ledger) -> NDArray[np.float64]:
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
    """Columns stand in the order (N, T1, T2) whatever they are called, but not where they say otherwise."""
    said = ", ".join(columns)
    if any(NORMAL.fullmatch(column.lower()) for column in columns[1:]):
        raise wrong(path, "first line", "columns in the order N, T1, T2", f"{said!r:.60}")
    ledger.ignored.append(f"names of columns ({said:.60}): in the order (N, T1, T2), no unit converted")


def _order(path: Path, names: list[str], problem: LocalProblem) -> list[int]:
    """Return the place of each contact, by its name or its number."""
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
