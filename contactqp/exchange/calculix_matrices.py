"""The stiffness that CalculiX stores by ``*FREQUENCY, SOLVER=MATRIXSTORAGE``: job.sti, with job.dof beside it.

A line of .sti is "row column value", indices from 1, the upper triangle column by column. A line of .dof is
"node.axis", 12.2 for the second direction of node 12; fixed unknowns, and those that a multi-point constraint
eliminates, are in neither (ccx 2.20, files of its own making).
"""

from __future__ import annotations

import re
from pathlib import Path as FilePath

from contactqp.errors import InvalidProblem
from contactqp.exchange.entry_list import number_table, symmetric_matrix, whole_numbers
from contactqp.exchange.ledger import Ledger
from contactqp.exchange.matrix_reader import MatrixFile, MatrixReader
from contactqp.exchange.refusal import Path, wrong
from contactqp.exchange.text_lines import text_lines

NAME = "CalculiX .sti"
EXPECTED = "entries of CalculiX's stiffness: row, column, value"
UNKNOWN = re.compile(r"\d{1,12}\.\d{1,2}", re.ASCII)


def read_sti(path: Path) -> MatrixFile:
    """The stiffness, its unknowns called "node.axis".

    Raises
    ------
    InvalidProblem
        No such file, no .dof beside it or one of another model, a list of entries that is not whole.
    """
    labels = read_dof(FilePath(path).with_suffix(".dof"))
    ledger = Ledger(str(path))
    table = number_table(path, text_lines(path, EXPECTED), 3, EXPECTED)
    row, column = (whole_numbers(path, name, table[:, at]) - 1 for at, name in enumerate(("rows", "columns")))
    if max(row.max(), column.max()) >= len(labels):
        largest = max(row.max(), column.max()) + 1
        raise wrong(path, "indices", f"at most {len(labels)}, the lines of the .dof beside it", largest)
    matrix = symmetric_matrix(path, row, column, table[:, 2], len(labels), ledger)
    ledger.read.append(f"names of the unknowns from {FilePath(path).with_suffix('.dof').name}, such as {labels[0]}")
    ledger.assumed.append("the stiffness is that of the unloaded body: no geometric stiffness of a step before")
    ledger.assumed.append("prescribed displacements are zero: fixed unknowns are not in the file")
    return MatrixFile(matrix, labels, ledger)


def read_dof(path: Path) -> tuple[str, ...]:
    """The names "node.axis" of the unknowns, in the order of rows and columns.

    Raises
    ------
    InvalidProblem
        No such file, a line that is no such name, a name twice.
    """
    expected = "CalculiX's list of unknowns, node.axis a line"
    names = [name for line in text_lines(path, expected) if (name := line.strip())]
    if not names:
        raise wrong(path, "content", expected, "nothing")
    bad = next((i for i, name in enumerate(names) if not UNKNOWN.fullmatch(name)), None)
    if bad is not None:
        raise wrong(path, f"line {bad + 1}", "node.axis", repr(names[bad][:40]))
    if len(set(names)) < len(names):
        seen: set[str] = set()
        again = next(name for name in names if name in seen or seen.add(name))  # type: ignore[func-returns-value]
        raise wrong(path, "content", "each unknown once", f"{again} twice")
    return tuple(names)


def refuse_mass(path: Path) -> MatrixFile:
    """Refuse a .mas file: same form, other matrix."""
    raise InvalidProblem(f"{path}: expected a stiffness, got CalculiX's mass matrix; the stiffness is in the .sti")


READER = MatrixReader(NAME, (".sti",), read_sti, stiffness=True, beside=(".dof", ".mas"))
MASS = MatrixReader("CalculiX .mas", (".mas",), refuse_mass)
