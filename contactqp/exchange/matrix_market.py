"""Matrix Market text, by SciPy; the sizes it states are held against the size of the file before anything is made."""

from __future__ import annotations

import warnings

import scipy.io

from contactqp.errors import Unsupported
from contactqp.exchange.ledger import Ledger
from contactqp.exchange.matrix_reader import MatrixFile, MatrixReader
from contactqp.exchange.refusal import Path, check_rows, file_size, one_line, wrong

BANNER = b"%%MatrixMarket"
NAME = "Matrix Market"
# The fewest bytes of a value and its line break, and of an entry "1 1 1".
VALUE, ENTRY = 2, 6
LONGEST_LINE = 2**16


def read_matrix_market(path: Path) -> MatrixFile:
    """A matrix in coordinate or array form; of a symmetric one both halves.

    Raises
    ------
    InvalidProblem
        No Matrix Market, sizes that the file cannot hold, too few or too many entries.
    Unsupported
        Complex numbers, a pattern without values.
    """
    size = file_size(path, NAME)
    form, symmetry, numbers = _head(path, size)
    try:
        with open(path, "rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            matrix = scipy.io.mmread(file)
    except (ValueError, TypeError, IndexError, OverflowError, EOFError, OSError, MemoryError) as error:
        raise wrong(path, "entries", f"{numbers} of {NAME}", one_line(error)) from None
    ledger = Ledger(str(path))
    ledger.read.append(f"{NAME}, {form}: {matrix.shape[0]} by {matrix.shape[1]}")
    if symmetry != "general":
        ledger.converted.append(f"{symmetry}: the other half of the matrix was filled in")
    return MatrixFile(matrix, None, ledger)


def _head(path: Path, size: int) -> tuple[str, str, int]:
    """Form, symmetry and the number of entries that follow, checked."""
    with open(path, "rb") as file:
        words = file.readline(LONGEST_LINE).decode("latin-1").split()
        line = file.readline(LONGEST_LINE)
        while line and (line.startswith(b"%") or not line.strip()):
            line = file.readline(LONGEST_LINE)
    if len(words) != 5 or words[0].encode() != BANNER or words[1].lower() != "matrix":
        raise wrong(path, "first line", f"{BANNER.decode()} matrix ...", repr(" ".join(words)[:60]))
    form, field, symmetry = (word.lower() for word in words[2:])
    if form not in ("coordinate", "array"):
        raise wrong(path, "first line", "coordinate or array", repr(form[:20]))
    if field in ("complex", "pattern") or symmetry == "hermitian":
        raise Unsupported(f"{path}: first line: expected real numbers, got {field} {symmetry}")
    if field not in ("real", "integer", "double", "unsigned-integer"):
        raise wrong(path, "first line", "real or integer", repr(field[:20]))
    if symmetry not in ("general", "symmetric", "skew-symmetric"):
        raise wrong(path, "first line", "general, symmetric or skew-symmetric", repr(symmetry[:20]))
    count = _entries(path, form, symmetry, line)
    if count * (VALUE if form == "array" else ENTRY) > size:
        raise wrong(path, "sizes", f"what a file of {size} bytes can hold", f"{count} entries")
    return form, symmetry, count


def _entries(path: Path, form: str, symmetry: str, line: bytes) -> int:
    expected = "rows and columns" if form == "array" else "rows, columns and entries"
    try:
        sizes = [int(word) for word in line.split()]
    except ValueError:
        sizes = []
    if len(sizes) != (2 if form == "array" else 3) or min(sizes) < 0:
        raise wrong(path, "sizes", expected, repr(line[:60].decode("latin-1").strip()))
    rows, columns = sizes[:2]
    if symmetry != "general" and rows != columns:
        raise wrong(path, "sizes", f"a square matrix, as it is {symmetry}", f"{rows} by {columns}")
    check_rows(path, "sizes", rows)
    if max(sizes) >= 2**62:
        raise wrong(path, "sizes", expected, max(sizes))
    if form == "coordinate":
        return sizes[2]
    return rows * columns if symmetry == "general" else rows * (rows + (1 if symmetry == "symmetric" else -1)) // 2


READER = MatrixReader(NAME, (".mtx", ".mm"), read_matrix_market, known=lambda head: head.startswith(BANNER))
