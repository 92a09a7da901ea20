"""Harwell-Boeing and Rutherford-Boeing text: assembled real matrices, symmetric too, and the load beside them.

    title, key
    lines: in all, of pointers, of row numbers, of values, of right-hand sides
    type (RSA, RUA, ...), rows, columns, entries
    Fortran formats of pointers, row numbers, values, right-hand sides
    type of the right-hand sides, how many                             only where there are any

Then the numbers in columns of the formats' widths (Duff, Grimes, Lewis 1992). SciPy's reader takes unsymmetric files
without right-hand sides only; what finite-element codes export is symmetric, and the right-hand side is the load.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem, Unsupported
from contactqp.exchange.files import (
    COLUMNS,
    Ledger,
    MatrixFile,
    MatrixReader,
    Path,
    StoredMatrix,
    check_rows,
    file_size,
    matrix_of,
    read_text,
    say_sums,
    wrong,
)
from contactqp.model.arrays import Vector

NAME = "Harwell-Boeing"
SYMMETRIES = {"s": "symmetric", "u": "unsymmetric", "r": "rectangular", "z": "skew-symmetric"}
FORMAT = re.compile(r"\((?:\d*p,?)?(\d*)\(?(?:\d*p,?)?([iedfg])(\d+)(?:\.(\d+)(?:e\d+)?)?\)?\)")
# A value whose exponent has three digits comes without a letter: 1.0-100.
BARE_EXPONENT = re.compile(r"(?<=[\d.])(?=[+-]\d+$)")
LONGEST_LINE = 2**16


@dataclass(frozen=True)
class Format:
    """A Fortran format such as (5E16.8)."""

    letter: str
    repeat: int
    width: int


@dataclass(frozen=True)
class Header:
    """What stands before the numbers."""

    lines: tuple[int, int, int, int]  # of pointers, rows, values, right-hand sides
    kind: str  # three letters, lower case
    shape: tuple[int, int]
    entries: int
    formats: tuple[str, str, str, str]
    loads: int  # right-hand sides
    load_kind: str

    @property
    def length(self) -> int:
        """How many lines it takes."""
        return 5 if self.lines[3] else 4


def read_harwell_boeing(path: Path) -> MatrixFile:
    """Return the matrix; of a symmetric one both halves.

    Raises
    ------
    InvalidProblem
        No such file, a header or a number that is none, sizes that the file cannot hold, lines that are missing.
    Unsupported
        Complex numbers, a pattern, elements that are not assembled.
    """
    lines, header = _opened(path)
    rows, columns = header.shape
    at = header.length
    pointers = _integers(path, lines, at, header, 0, columns + 1)
    indices = _integers(path, lines, at + header.lines[0], header, 1, header.entries)
    values = _values(path, lines, at + sum(header.lines[:2]), header, 2, header.entries)
    stored = StoredMatrix(header.entries, rows, columns, COLUMNS, pointers - 1, indices - 1, values)
    matrix = matrix_of(stored, path, "matrix")
    ledger = Ledger(str(path))
    symmetry = SYMMETRIES[header.kind[1]]
    ledger.read.append(f"{NAME} {header.kind.upper()}: {rows} by {columns}, {header.entries} entries")
    say_sums(ledger, header.entries, matrix.nnz)
    if header.kind[1] in "sz":
        sign = 1 if header.kind[1] == "s" else -1
        at_diagonal, half = matrix.diagonal(), matrix.tocoo()
        if np.any(half.row < half.col) and np.any(half.row > half.col):
            raise wrong(path, "matrix", f"one half of a {symmetry} matrix", "entries on both sides of the diagonal")
        other = half.T.tocsr() * sign
        other.setdiag(0.0 * at_diagonal)
        matrix = (matrix + other).tocsr()
        ledger.converted.append(f"{symmetry}: the other half of the matrix was filled in")
    if header.lines[3]:
        ledger.read.append(f"right-hand sides: {header.loads}, the load where no other is given")
    return MatrixFile(matrix, None, ledger)


def read_load(path: Path) -> tuple[Vector, Ledger] | None:
    """Return the one right-hand side of the file, where there is one; raises as `read_harwell_boeing`."""
    lines, header = _opened(path)
    if not header.lines[3]:
        return None
    if header.loads != 1 or not header.load_kind.startswith("f"):
        raise Unsupported(f"{path}: right-hand sides: expected one, in full, got {header.loads} {header.load_kind!r}")
    load = _values(path, lines, header.length + sum(header.lines[:3]), header, 3, header.shape[0])
    ledger = Ledger(str(path))
    ledger.read.append(f"load: the right-hand side, {len(load)} numbers")
    return load, ledger


def _opened(path: Path) -> tuple[list[str], Header]:
    size = file_size(path, NAME)
    lines = read_text(path, NAME).splitlines()
    if len(lines) < 4:
        raise wrong(path, "content", f"{NAME}, four lines at least", f"{len(lines)} lines")
    counts, kind = _whole(path, lines[1], 2), lines[2][:3].lower()
    if len(kind) != 3 or kind[0] not in "ricp" or kind[1] not in "surzh" or kind[2] not in "ae":
        raise wrong(path, "line 3", "a type of matrix such as RSA or RUA", repr(lines[2][:20]))
    if kind[0] in "cp" or kind[1] == "h" or kind[2] == "e":
        expected = "an assembled matrix of real numbers (R.A)"
        raise Unsupported(f"{path}: line 3: expected {expected}, got the type {kind.upper()}")
    sizes = _whole(path, lines[2][3:], 3)
    if len(counts) not in (4, 5) or len(sizes) not in (3, 4):
        raise wrong(path, "lines 2 and 3", "4 or 5 numbers of lines, and rows, columns, entries", f"{counts}, {sizes}")
    rows, columns, entries = sizes[:3]
    check_rows(path, "line 3", max(rows, columns))
    if kind[1] in "sz" and rows != columns:
        raise wrong(path, "line 3", "a square matrix", f"{rows} by {columns}")
    if entries + columns > size:
        raise wrong(path, "line 3", f"what a file of {size} bytes can hold", f"{entries} entries")
    loads, load_kind = 0, ""
    if len(counts) == 5 and counts[4]:
        stated = _whole(path, lines[4][3:], 5) if len(lines) > 4 else []
        if not stated:
            raise wrong(path, "line 5", "type and number of right-hand sides", "none")
        loads, load_kind = stated[0], lines[4][:3].lower()
    parts = (lines[3][:16], lines[3][16:32], lines[3][32:52], lines[3][52:72])
    cleaned = tuple(part.replace(" ", "").lower() for part in parts)
    lengths = (counts[1], counts[2], counts[3], counts[4] if len(counts) == 5 else 0)
    return lines, Header(lengths, kind, (rows, columns), entries, cleaned, loads, load_kind)  # type: ignore[arg-type]


def _whole(path: Path, text: str, line: int) -> list[int]:
    try:
        found = [int(word) for word in text.split()]
    except ValueError:
        found = [-1]
    if min(found, default=-1) < 0:
        raise wrong(path, f"line {line}", "whole numbers", repr(text[:60].strip()))
    return found


def _format(path: Path, text: str, letters: str) -> Format:
    match = FORMAT.fullmatch(text)
    if match is None or match[2] not in letters:
        raise wrong(path, "line 4", "a Fortran format such as (8I10) or (5E16.8)", repr(text[:24]))
    repeat, width = int(match[1][:6] or 1), int(match[3][:6])
    if not 0 < repeat <= LONGEST_LINE or not 0 < width <= LONGEST_LINE:
        raise wrong(path, "line 4", "a Fortran format with some columns", repr(text[:24]))
    return Format(match[2], repeat, width)


def _fields(path: Path, lines: list[str], first: int, header: Header, part: int, form: Format, count: int) -> list[str]:
    """Return the texts in the columns of a format."""
    needed = math.ceil(count / form.repeat)
    if needed > header.lines[part] or first + needed > len(lines):
        held = min(header.lines[part], max(len(lines) - first, 0))
        raise wrong(path, f"lines from {first + 1}", f"{needed} lines of {count} numbers", f"{held}")
    found: list[str] = []
    for line in lines[first : first + needed]:
        here = min(form.repeat, count - len(found))
        words = line.split()  # SciPy writes narrower columns than the format it states; blanks part them all the same
        columns = [line[k : k + form.width] for k in range(0, form.width * here, form.width)]
        found += words if len(words) == here else columns
    return found


def _integers(path: Path, lines: list[str], first: int, header: Header, part: int, count: int) -> NDArray[np.int64]:
    form = _format(path, header.formats[part], "i")
    fields = _fields(path, lines, first, header, part, form, count)
    try:
        return np.array([int(field) for field in fields], dtype=np.int64)
    except (ValueError, OverflowError):
        raise _no_number(path, fields, first, form, "a whole number", _is_integer) from None


def _values(path: Path, lines: list[str], first: int, header: Header, part: int, count: int) -> Vector:
    form = _format(path, header.formats[part], "iedfg")
    fields = _fields(path, lines, first, header, part, form, count)
    words = [BARE_EXPONENT.sub("e", field.strip().lower().replace("d", "e")) for field in fields]
    if form.letter == "i" or all("." in word for word in words):  # without a point Fortran puts one somewhere
        try:
            return np.array([float(word) for word in words])
        except ValueError:
            pass
    raise _no_number(path, fields, first, form, "a number with its decimal point", _is_value)


def _no_number(
    path: Path, fields: list[str], first: int, form: Format, expected: str, good: Callable[[str], bool]
) -> InvalidProblem:
    at = next((k for k, field in enumerate(fields) if not good(field)), 0)
    return wrong(path, f"line {first + 1 + at // form.repeat}", expected, repr(fields[at][:40]))


def _is_integer(field: str) -> bool:
    try:
        return abs(int(field)) < 2**62
    except ValueError:
        return False


def _is_value(field: str) -> bool:
    try:
        float(field.lower().replace("d", "e"))
    except ValueError:
        return False
    return "." in field


def _known(head: bytes) -> bool:
    lines = head.splitlines()
    return len(lines) > 3 and re.match(rb"(?i)[ricp][surzh][ae]\s", lines[2]) is not None and b"(" in lines[3]


READER = MatrixReader(
    NAME,
    (".rua", ".rsa", ".rra", ".hb", ".rb", ".psa", ".matrix"),
    read_harwell_boeing,
    known=_known,
    load=read_load,
)
