"""Ansys's binary files: stiffness and load of a .full file, displacements of a .rst file, by ansys-mapdl-reader.

Unknowns are called node.axis, such as 12.x or 7.rotz, along the axes of the node. Fixed unknowns are left out of the
stiffness. Contact results of a .rst file are not read: forces are recovered from the displacements.
"""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import BackendMissing, Unsupported
from contactqp.exchange.answer_reader import AnswerFile, AnswerReader, names_of, places
from contactqp.exchange.files import Ledger, MatrixFile, MatrixReader, Path, file_size, read_bytes, wrong
from contactqp.exchange.numpy_files import sparse_matrix
from contactqp.exchange.processes import read_in_own_process
from contactqp.model.arrays import Vector
from contactqp.model.names import AXES
from contactqp.model.problem import ContactProblem

# The standard header: 100 words of four bytes; its item 2 is the kind of file, item 27 the length of the file in words.
WORDS, KIND, LENGTH = 100, 2, 28
FULL, RESULT = 4, 12
NAMES = {FULL: "Ansys .full", RESULT: "Ansys .rst"}


def read_full(path: Path) -> MatrixFile:
    """Return the stiffness of the unknowns that are free, with their names.

    Raises
    ------
    InvalidProblem
        No such file, no .full file, a damaged one.
    Unsupported
        Constraint equations, unsymmetric matrices.
    BackendMissing
        ansys-mapdl-reader is not installed.
    """
    found = _read(path, FULL)
    if found["equations"]:
        raise Unsupported(f"{path}: {int(found['equations'])} constraint equations in it, whose rows are not read")
    matrix = sparse_matrix(path, found, "stiffness_")
    labels = tuple(_label(node, axis) for node, axis in zip(found["node"], found["axis"], strict=True))
    ledger = Ledger(str(path))
    ledger.read.append(f"{NAMES[FULL]}: {matrix.shape[0]} unknowns, such as {labels[0] if labels else 'none'}")
    ledger.converted.append(f"{int(found['held'])} unknowns that are held were left out; the other half was filled in")
    ledger.assumed.append("no closed contact elements in it: their penalty would be part of this stiffness")
    ledger.ignored.append("mass and damping")
    return MatrixFile(matrix, labels, ledger)


def read_full_load(path: Path) -> tuple[Vector, Ledger] | None:
    """Return the load vector of the unknowns that are free; None where all of it is zero. Raises as `read_full`."""
    load = np.asarray(_read(path, FULL)["load"], dtype=float)
    if not np.any(load):
        return None
    ledger = Ledger(str(path))
    ledger.read.append(f"load: the load vector stored in it, {np.count_nonzero(load)} of {len(load)} are not zero")
    return load, ledger


def read_result(path: Path, problem: ContactProblem) -> AnswerFile:
    """Return the displacements of the last set of results.

    Raises
    ------
    InvalidProblem
        No such file, no .rst file, a damaged one, nodes that the problem does not have.
    BackendMissing
        ansys-mapdl-reader is not installed.
    """
    found = _read(path, RESULT)
    axes = [str(name).lower().removeprefix("u") for name in found["axes"].ravel()]
    values = np.asarray(found["values"], dtype=float)
    if values.shape != (len(found["node"]), len(axes)):
        raise wrong(path, "nodal solution", f"{len(axes)} values a node", f"shape {values.shape}")
    names = [f"{int(node)}.{axis}" for node in found["node"] for axis in axes]
    ledger = Ledger(str(path))
    ledger.read.append(f"{NAMES[RESULT]}: displacement at {len(found['node'])} nodes, along the axes of the nodes")
    if found["sets"] > 1:
        ledger.assumed.append(f"the last of {int(found['sets'])} sets of results is the one")
    ledger.ignored.append("stresses, strains, reactions and contact results: forces are recovered from displacements")
    order = places(path, "displacement", names, names_of(problem, "displacement"), ledger)
    return AnswerFile({"displacement": values.ravel()[order]}, ledger, frozenset({"displacement"}))


def _label(node: Any, axis: Any) -> str:
    k = int(axis)
    return f"{int(node)}.{AXES[k]}" if 0 <= k < len(AXES) else f"{int(node)}.dof{k}"


def _read(path: Path, kind: int) -> dict[str, NDArray[Any]]:
    """Read a file in a process of its own and return the arrays that this process found."""
    _check_head(path, kind)
    _refuse_missing()
    return read_in_own_process(path, NAMES[kind].rpartition(".")[2], NAMES[kind])


def _check_head(path: Path, kind: int) -> None:
    """Refuse a file whose header states another kind of file."""
    size = file_size(path, NAMES[kind])
    head = read_bytes(path, NAMES[kind], 4 * (WORDS + 2))
    if len(head) < 4 * (WORDS + 2):
        raise wrong(path, "content", NAMES[kind], "an empty file" if not head else f"{len(head)} bytes")
    if np.frombuffer(head, ">i4", 1)[0] == WORDS:
        raise Unsupported(f"{path}: content: expected {NAMES[kind]} of a little-endian machine, got big-endian")
    words = np.frombuffer(head, "<i4")
    if words[0] != WORDS or words[KIND] != kind:
        raise wrong(path, "content", NAMES[kind], "something else")
    if 4 * int(words[LENGTH]) > size:
        raise wrong(path, "content", f"{4 * int(words[LENGTH])} bytes, as its header says", size)


def _refuse_missing() -> None:
    try:
        missing = importlib.util.find_spec("ansys.mapdl.reader") is None
    except ModuleNotFoundError:
        missing = True
    if missing:
        raise BackendMissing("Ansys's binary files need ansys-mapdl-reader: pip install ansys-mapdl-reader")


def _known(kind: int, head: bytes) -> bool:
    return len(head) > 12 and np.frombuffer(head[:12], "<i4")[[0, KIND]].tolist() == [WORDS, kind]


READER = MatrixReader(
    NAMES[FULL], (".full",), read_full, recognises=lambda head: _known(FULL, head), stiffness=True, load=read_full_load
)
RESULT_READER = AnswerReader(NAMES[RESULT], (".rst",), read_result, recognises=lambda head: _known(RESULT, head))
