"""Matrices as text: Matrix Market (Boisvert, Pozo, Remington 1996), and tables of numbers as plain text or CSV.

    %%MatrixMarket matrix coordinate|array real|integer general|symmetric|skew-symmetric
    % comments
    rows columns [entries]
    row column value     or     value, column by column

Sizes stated by a Matrix Market file are checked against its length before memory is allocated. SciPy's reader, written
in C++, crashes on some damaged files and is not used. In plain text a line is a row, its numbers apart by commas,
semicolons or blanks.

Harwell-Boeing and Rutherford-Boeing text: assembled real matrices, symmetric too, and the load beside them.

    title, key
    lines: in all, of pointers, of row numbers, of values, of right-hand sides
    type (RSA, RUA, ...), rows, columns, entries
    Fortran formats of pointers, row numbers, values, right-hand sides
    type of the right-hand sides, how many                             only where there are any

Then follow the numbers in columns of the formats' widths (Duff, Grimes, Lewis 1992). SciPy's reader takes only
unsymmetric files without right-hand sides; finite-element codes export symmetric ones whose right-hand side is the
load.
"""

from __future__ import annotations

import math
import re
from array import array
from codecs import BOM_UTF8
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
import scipy.sparse as sp

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
    is_number,
    matrix_of,
    no_number,
    number,
    read_text,
    refuse_utf_16,
    say_sums,
    wrong,
)
from contactqp.model.arrays import Array, Index, Vector

BANNER = b"%%MatrixMarket"
MATRIX_MARKET_NAME = "Matrix Market"
# The fewest bytes of a value and its line break, and of an entry "1 1 1".
VALUE, ENTRY = 2, 6
PLAIN = re.compile(rb"[\s\d.+\-eE]*")
LONGEST_LINE, BLOCK = 2**16, 2**20


@dataclass(frozen=True)
class Head:
    """The header of a Matrix Market file."""

    form: str
    symmetry: str
    rows: int
    columns: int
    entries: int  # that follow


def read_matrix_market(path: Path) -> MatrixFile:
    """Return the matrix in CSR (coordinate form) or dense (array form), with both halves of a symmetric one; repeated
    entries are summed.

    Raises InvalidProblem: no Matrix Market, sizes that the file cannot hold, too few or too many numbers, an index
    outside; Unsupported: complex numbers, a pattern without values.
    """
    size = file_size(path, MATRIX_MARKET_NAME)
    with open(path, "rb") as file:
        head = _head(path, size, file)
        words = head.entries * (3 if head.form == "coordinate" else 1)
        values = _numbers(path, file, words)
    matrix = _coordinates(path, head, values) if head.form == "coordinate" else _array(head, values)
    ledger = Ledger(str(path))
    if head.form == "coordinate":
        say_sums(ledger, head.entries, _different(head, values))
    ledger.read.append(f"{MATRIX_MARKET_NAME}, {head.form}: {head.rows} by {head.columns}")
    if head.symmetry != "general":
        ledger.converted.append(f"{head.symmetry}: the other half of the matrix was filled in")
    return MatrixFile(matrix, None, ledger)


def _head(path: Path, size: int, file: BinaryIO) -> Head:
    words = file.readline(LONGEST_LINE).removeprefix(BOM_UTF8).decode("latin-1").split()
    line = file.readline(LONGEST_LINE)
    while line and (line.startswith(b"%") or not line.strip()):
        line = file.readline(LONGEST_LINE)
    if len(words) != 5 or words[0].lower() != BANNER.decode().lower() or words[1].lower() != "matrix":
        raise wrong(path, "first line", f"{BANNER.decode()} matrix ...", repr(" ".join(words)[:60]))
    form, field, symmetry = (word.lower() for word in words[2:])
    if form not in ("coordinate", "array"):
        raise wrong(path, "first line", "coordinate or array", repr(form[:20]))
    if field in ("complex", "pattern") or symmetry == "hermitian":
        raise Unsupported(f"{path}: first line: expected real numbers, got {field} {symmetry:.20}")
    if field not in ("real", "integer", "double", "unsigned-integer"):
        raise wrong(path, "first line", "real or integer", repr(field[:20]))
    if symmetry not in ("general", "symmetric", "skew-symmetric"):
        raise wrong(path, "first line", "general, symmetric or skew-symmetric", repr(symmetry[:20]))
    return _sizes(path, size, form, symmetry, line)


def _sizes(path: Path, size: int, form: str, symmetry: str, line: bytes) -> Head:
    try:
        sizes = [int(word) for word in line.split()]
    except ValueError:
        sizes = []
    if len(sizes) != (2 if form == "array" else 3) or min(sizes) < 0 or max(sizes) >= 2**62:
        expected = "rows and columns" if form == "array" else "rows, columns and entries"
        raise wrong(path, "sizes", expected, repr(line[:60].decode("latin-1").strip()))
    rows, columns = sizes[:2]
    if symmetry != "general" and rows != columns:
        raise wrong(path, "sizes", f"a square matrix, as it is {symmetry}", f"{rows} by {columns}")
    check_rows(path, "sizes", rows)
    on_diagonal = {"general": 0, "symmetric": 1, "skew-symmetric": -1}[symmetry]
    whole = rows * columns if not on_diagonal else rows * (rows + on_diagonal) // 2
    entries = sizes[2] if form == "coordinate" else whole
    if entries * (VALUE if form == "array" else ENTRY) > size + VALUE:
        raise wrong(path, "sizes", f"what a file of {size} bytes can hold", f"{entries} entries")
    return Head(form, symmetry, rows, columns, entries)


def _numbers(path: Path, file: BinaryIO, count: int) -> Array:
    """Return the numbers that follow, which must be this many."""
    found = array("d")
    while block := file.read(BLOCK):
        block += file.readline(LONGEST_LINE)
        words = block.decode("latin-1").split()
        try:
            found.extend(map(float if PLAIN.fullmatch(block) else number, words))
        except ValueError:
            bad = next(word for word in words if not is_number(word))
            raise no_number(path, "entries", bad) from None
        if len(found) > count:
            break
    if len(found) != count:
        raise wrong(path, "entries", f"{count} numbers", "more" if len(found) > count else len(found))
    return np.array(found)


def _coordinates(path: Path, head: Head, values: Array) -> sp.csr_array:
    row, column, x = values.reshape(-1, 3).T
    for what, index, most in (("row", row, head.rows), ("column", column, head.columns)):
        bad = np.flatnonzero(~((index >= 1) & (index <= most) & (index == np.floor(index))))
        if bad.size:
            raise wrong(path, f"entry {bad[0] + 1}, {what}", f"a number from 1 to {most}", f"{index[bad[0]]:.17g}")
    i, j = row.astype(np.int64) - 1, column.astype(np.int64) - 1
    if head.symmetry != "general":
        other = i != j
        if np.any(i < j) and np.any(i > j):
            raise wrong(path, "entries", f"one half of a {head.symmetry} matrix", "both sides of the diagonal")
        sign = 1.0 if head.symmetry == "symmetric" else -1.0
        i, j, x = np.r_[i, j[other]], np.r_[j, i[other]], np.r_[x, sign * x[other]]
    return sp.csr_array(sp.coo_array((x, (i, j)), shape=(head.rows, head.columns)))


def _different(head: Head, values: Array) -> int:
    """Return the number of distinct entries in a list."""
    row, column = values.reshape(-1, 3)[:, :2].astype(np.int64).T
    order = np.lexsort((column, row))
    row, column = row[order], column[order]
    return int(np.count_nonzero((np.diff(row) != 0) | (np.diff(column) != 0))) + (head.entries > 0)


def _array(head: Head, values: Array) -> Array:
    if head.symmetry == "general":
        return values.reshape((head.rows, head.columns), order="F")
    dense = np.zeros((head.rows, head.columns))
    upper = np.triu_indices(head.rows, 0 if head.symmetry == "symmetric" else 1)  # a lower half column by column
    dense.T[upper] = values
    dense[upper] = values if head.symmetry == "symmetric" else -values
    return dense


def is_matrix_market(head: bytes) -> bool:
    return head[: len(BANNER)].lower() == BANNER.lower()


MATRIX_MARKET = MatrixReader(MATRIX_MARKET_NAME, (".mtx", ".mm"), read_matrix_market, recognises=is_matrix_market)

TEXT_NAME = "text or CSV"
EXPECTED = "numbers in text or CSV"
# The longest line that is accepted, a row of about a million numbers.
LONGEST_TEXT_LINE = 2**24
COMMENTS = ("#", "%", "//")
COMMA_IN_NUMBER = re.compile(r"\d,\d")
SEPARATORS = re.compile(r"\s*[,;]\s*|\s+")


def read_text_matrix(path: Path) -> MatrixFile:
    """Return a dense matrix; a first line of words gives the names of its unknowns. Comments begin with # or %.

    Raises
    ------
    InvalidProblem
        No such file, a word that is not a number (where, which), rows of different lengths, nothing at all.
    """
    ledger, values, width, header = Ledger(str(path)), array("d"), 0, None
    for line, words in _rows(path):
        if not width and header is None and not any(is_number(word) for word in words):
            header = words
            continue
        width = width or len(words)
        if len(words) != width:
            raise wrong(path, f"line {line}", f"{width} numbers, as in the lines before", len(words))
        values.extend(_numbers_of_line(path, line, words))
    if not width:
        raise wrong(path, "content", EXPECTED, "no number")
    matrix: Array = np.frombuffer(values, dtype=float).reshape(-1, width)
    ledger.read.append(f"{TEXT_NAME}: {matrix.shape[0]} by {width}")
    labels = None
    if header is not None:
        ledger.read.append(f"first line: {len(header)} names, such as {header[0]!r:.40}")
        labels = tuple(header) if len(header) == width else None
        if labels is None:
            raise wrong(path, "first line", f"{width} names, one a column", len(header))
    return MatrixFile(matrix, labels, ledger)


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the words of every line that has any, with its number."""
    file_size(path, EXPECTED)
    with open(path, "rb") as file:
        place = 0
        while line := file.readline(LONGEST_TEXT_LINE):
            place += 1
            if place == 1:
                refuse_utf_16(path, line)
            if b"\0" in line:
                raise wrong(path, f"line {place}", EXPECTED, "the byte 0x00: a binary file")
            if len(line) == LONGEST_TEXT_LINE and not line.endswith(b"\n"):
                raise wrong(path, f"line {place}", f"at most {LONGEST_TEXT_LINE} bytes", "more")
            try:
                text = line.decode("utf-8-sig" if place == 1 else "utf-8")
            except UnicodeDecodeError as error:
                raise wrong(path, f"line {place}", EXPECTED, f"the byte 0x{line[error.start]:02x}") from None
            for mark in COMMENTS:
                text = text.partition(mark)[0]
            text = text.strip().rstrip(",;")
            if COMMA_IN_NUMBER.search(text) and (";" in text or "\t" in text):
                raise wrong(
                    path, f"line {place}", "one mark between numbers", "two: decimal commas? numbers have points"
                )
            if text:
                yield place, SEPARATORS.split(text)


def _numbers_of_line(path: Path, line: int, words: list[str]) -> list[float]:
    try:
        return [number(word) for word in words]
    except ValueError:
        bad = next(word for word in words if not is_number(word))
        raise no_number(path, f"line {line}", bad) from None


TEXT = MatrixReader(TEXT_NAME, (".csv", ".txt", ".dat", ".asc", ".tsv"), read_text_matrix)


HARWELL_BOEING_NAME = "Harwell-Boeing"
SYMMETRIES = {"s": "symmetric", "u": "unsymmetric", "r": "rectangular", "z": "skew-symmetric"}
FORMAT = re.compile(r"\((?:\d*p,?)?(\d*)\(?(?:\d*p,?)?([iedfg])(\d+)(?:\.(\d+)(?:e\d+)?)?\)?\)")
# A value whose exponent has three digits comes without a letter: 1.0-100.
BARE_EXPONENT = re.compile(r"(?<=[\d.])(?=[+-]\d+$)")


@dataclass(frozen=True)
class Format:
    """A Fortran format such as (5E16.8)."""

    letter: str
    repeat: int
    width: int


@dataclass(frozen=True)
class Header:
    """The header of a text matrix, before its numbers."""

    lines: tuple[int, int, int, int]  # of pointers, rows, values, right-hand sides
    kind: str  # three letters, lower case
    shape: tuple[int, int]
    entries: int
    formats: tuple[str, str, str, str]
    loads: int  # right-hand sides
    load_kind: str

    @property
    def length(self) -> int:
        """Return how many lines the header takes."""
        return 5 if self.lines[3] else 4


def read_harwell_boeing(path: Path) -> MatrixFile:
    """Return the matrix, both halves of a symmetric one.

    Raises InvalidProblem: no such file, a header or a number that is none, sizes that the file cannot hold, lines that
    are missing; Unsupported: complex numbers, a pattern, elements that are not assembled.
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
    ledger.read.append(f"{HARWELL_BOEING_NAME} {header.kind.upper()}: {rows} by {columns}, {header.entries} entries")
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
    size = file_size(path, HARWELL_BOEING_NAME)
    lines = read_text(path, HARWELL_BOEING_NAME).splitlines()
    if len(lines) < 4:
        raise wrong(path, "content", f"{HARWELL_BOEING_NAME}, four lines at least", f"{len(lines)} lines")
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
        words = line.split()  # SciPy writes narrower columns than the format it states, but separates them by blanks
        columns = [line[k : k + form.width] for k in range(0, form.width * here, form.width)]
        found += words if len(words) == here else columns
    return found


def _integers(path: Path, lines: list[str], first: int, header: Header, part: int, count: int) -> Index:
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
    if form.letter == "i" or all("." in word for word in words):  # Fortran inserts missing points
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


HARWELL_BOEING = MatrixReader(
    HARWELL_BOEING_NAME,
    (".rua", ".rsa", ".rra", ".hb", ".rb", ".psa", ".matrix"),
    read_harwell_boeing,
    recognises=_known,
    load=read_load,
)
