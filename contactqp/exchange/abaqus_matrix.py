"""Stiffness matrices that Abaqus prints: *MATRIX GENERATE, STIFFNESS and *MATRIX OUTPUT, job_STIF1.mtx.

FORMAT=MATRIX INPUT and LABELS: "node, direction, node, direction, value" a line; FORMAT=COORDINATE: "row, column,
value", indices from 1 (Abaqus Analysis User's Guide, "Generating structural matrices"). A symmetric matrix is one
triangle or both. Lines of ** are comments. An unknown with a boundary condition stays, with 1e36 on its diagonal.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import chain
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import Unsupported
from contactqp.exchange.entry_list import Integers, number_table, symmetric_matrix, whole_numbers
from contactqp.exchange.ledger import Ledger
from contactqp.exchange.matrix_reader import MatrixFile, MatrixReader
from contactqp.exchange.refusal import Path, wrong
from contactqp.exchange.text_lines import text_lines

NAME = "Abaqus matrix text"
EXPECTED = "entries of Abaqus's stiffness: node, direction, node, direction, value or row, column, value"
FIXED = 1e36
NUMBER = rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
LABELLED = re.compile(rb"\s*" + rb"-?\d+\s*,\s*\d+\s*,\s*" * 2 + NUMBER + rb"\s*,?\s*")
DIRECTIONS = 100  # of a node: displacements, rotations, warping, temperatures up to 11 and on


def read_abaqus_matrix(path: Path) -> MatrixFile:
    """The stiffness, its unknowns called "node.direction"; those of COORDINATE files have no names.

    Unknowns with 1e36 on the diagonal, which Abaqus holds fixed, are left out.

    Raises
    ------
    InvalidProblem
        No such file, words that are no numbers, a list of entries that is not whole.
    Unsupported
        Internal nodes, whose labels are negative.
    """
    ledger = Ledger(str(path))
    comments: list[int] = []
    rows = _rows(path, comments)
    first = next(rows, "")
    width = len(first.split())
    if width not in (3, 5):
        raise wrong(path, "first line", EXPECTED, f"{width} words")
    table = number_table(path, chain([first], rows), width, EXPECTED)
    if comments:
        ledger.ignored.append(f"{len(comments)} lines of comments and keywords")
    if width == 3:
        row, column = (whole_numbers(path, name, table[:, at]) - 1 for at, name in enumerate(("rows", "columns")))
        size, labels = int(max(row.max(), column.max())) + 1, None
        if size > len(row):
            raise wrong(path, "diagonal", f"an entry for each of {size} unknowns", f"{len(row)} entries in all")
        ledger.assumed.append("FORMAT=COORDINATE: unknowns have no names and are taken in their order")
    else:
        row, column, labels = _labelled(path, table)
        size = len(labels)
    matrix = symmetric_matrix(path, row, column, table[:, -1], size, ledger)
    ledger.assumed.append("the stiffness is that of the first step's base state, without contact")
    return _without_fixed(path, matrix, labels, ledger)


def _rows(path: Path, comments: list[int]) -> Iterator[str]:
    """The lines of numbers, blanks for commas; the numbers of the other lines are left in `comments`."""
    for number, line in enumerate(text_lines(path, EXPECTED), 1):
        if line.lstrip().startswith("*"):
            comments.append(number)
        elif line.strip():
            yield line.replace(",", " ")


def _labelled(path: Path, table: np.ndarray[Any, np.dtype[np.float64]]) -> tuple[Integers, Integers, tuple[str, ...]]:
    """Rows, columns and the names of the unknowns, by node and direction."""
    if np.any(table[:, [0, 2]] < 0):
        line = int(np.argmax(np.any(table[:, [0, 2]] < 0, axis=1))) + 1
        raise Unsupported(f"{path}: line {line}: internal nodes (negative labels) are not supported")
    nodes = [whole_numbers(path, "node labels", table[:, at]) for at in (0, 2)]
    directions = [whole_numbers(path, "directions", table[:, at]) for at in (1, 3)]
    if max(direction.max() for direction in directions) >= DIRECTIONS:
        raise wrong(path, "directions", f"numbers below {DIRECTIONS}", max(d.max() for d in directions))
    if max(node.max() for node in nodes) >= 2**40:
        raise wrong(path, "node labels", "numbers below 2^40", max(node.max() for node in nodes))
    keys = np.concatenate([node * DIRECTIONS + direction for node, direction in zip(nodes, directions, strict=True)])
    unknowns, place = np.unique(keys, return_inverse=True)
    labels = tuple(f"{key // DIRECTIONS}.{key % DIRECTIONS}" for key in unknowns)
    row, column = np.split(place.ravel(), 2)
    return row.astype(np.int64), column.astype(np.int64), labels


def _without_fixed(path: Path, matrix: Any, labels: tuple[str, ...] | None, ledger: Ledger) -> MatrixFile:
    free = np.flatnonzero(matrix.diagonal() < FIXED)
    fixed = matrix.shape[0] - len(free)
    if not fixed:
        return MatrixFile(matrix, labels, ledger)
    if not free.size:
        raise wrong(path, "diagonal", "an unknown that is not fixed", f"{fixed} of 1e36")
    ledger.converted.append(f"{fixed} fixed unknowns (1e36 on the diagonal) are left out")
    ledger.assumed.append("prescribed displacements are zero")
    kept = None if labels is None else tuple(labels[i] for i in free)
    return MatrixFile(sp.csr_matrix(matrix[free][:, free]), kept, ledger)


def is_abaqus_matrix(head: bytes) -> bool:
    """Whether first bytes are node, direction, node, direction, value, after comments and the line of *MATRIX."""
    lines = [line for line in head.split(b"\n")[:-1] if line.strip()] if b"\n" in head else [head]
    while lines and lines[0].lstrip().startswith((b"**", b"*MATRIX")):
        lines.pop(0)
    return bool(lines) and LABELLED.fullmatch(lines[0].rstrip(b"\r")) is not None


READER = MatrixReader(NAME, (".mtx",), read_abaqus_matrix, is_abaqus_matrix)
