"""Answers in arrays: .npz by names, a folder of files by their names, and one array, which is what its file is called.

An array whose file has no such name (u.npy, normal_force.mtx, ...) is displacements or normal forces where its length
leaves no doubt, which the ledger says.
"""

from __future__ import annotations

from pathlib import Path as FilePath
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.exchange import matrix_files, numpy_files
from contactqp.exchange.answer_reader import AnswerFile, AnswerReader, part_called, real_array, vector
from contactqp.exchange.ledger import Ledger
from contactqp.exchange.numpy_files import NUMPY, ZIP
from contactqp.exchange.refusal import Path, wrong
from contactqp.problem import ContactProblem

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
    ledger = Ledger(str(path))
    parts: dict[str, NDArray[np.float64]] = {}
    for file in sorted(FilePath(path).iterdir()):
        part = part_called(file.stem)
        if part is None or file.is_dir():
            ledger.ignored.append(file.name)
            continue
        if part in parts:
            raise wrong(path, file.name, "every part once", f"{part} twice")
        found = read_array_answer(file, problem)
        parts |= found.parts
        ledger.read.extend(f"{part}: {file.name}: {line}" for line in found.ledger.read)
        ledger.converted.extend(f"{file.name}: {line}" for line in found.ledger.converted)
    if not parts:
        raise wrong(path, "folder", f"files called {EXPECTED}", "none of them")
    return AnswerFile(parts, ledger)


ARCHIVE = AnswerReader("NPZ", (".npz",), read_npz_answer, known=lambda head: head.startswith((ZIP, b"PK\x05\x06")))
ARRAY = AnswerReader(
    "an array (.npy, .mtx, text)",
    (".npy", ".mtx", ".txt"),
    read_array_answer,
    known=lambda head: head.startswith((NUMPY, b"%%MatrixMarket")),
)
