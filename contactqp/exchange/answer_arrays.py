"""Answers in arrays: .npz by names, a folder of files by their names, and one array, which is what its file is called.

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

from contactqp.exchange import answer_tables, matrix_files, numpy_files, text_matrix
from contactqp.exchange.answer_reader import AnswerFile, AnswerReader, part_called, real_array, refuse_unit, vector
from contactqp.exchange.ledger import Ledger
from contactqp.exchange.matrix_market import is_matrix_market
from contactqp.exchange.numpy_files import NUMPY, ZIP
from contactqp.exchange.refusal import Path, is_number, read_bytes, wrong
from contactqp.exchange.tables import HEAD, is_table
from contactqp.model.problem import ContactProblem

EXPECTED = "displacement or normal_force"


def read_npz_answer(path: Path, problem: ContactProblem) -> AnswerFile:  # noqa: ARG001
    """The arrays of an archive that are parts of an answer.

    Raises
    ------
    InvalidProblem
        A damaged archive, none of the names, arrays of anything but numbers.
    """
    ledger = Ledger(str(path))
    parts: dict[str, NDArray[np.float64]] = {}
    for name, values in numpy_files.read_npz(path).items():
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
        table = any(is_table(file, key) for key in answer_tables.KEYS)
        found = (answer_tables.read_table_answer if table else read_array_answer)(file, problem)
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
