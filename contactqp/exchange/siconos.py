"""Read the frictional contact problems that Siconos writes as text."""

from __future__ import annotations

import re
from codecs import BOM_UTF8
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem, Unsupported
from contactqp.exchange.fclib import solvable
from contactqp.exchange.files import (
    Path,
    check_dimension,
    check_finite,
    check_friction,
    is_number,
    naming,
    read_bytes,
    refuse_utf_16,
    wrong,
)
from contactqp.model.arguments import checked
from contactqp.model.arrays import Array, Index
from contactqp.model.local_problem import GlobalProblem, LocalProblem
from contactqp.model.problem import ContactProblem

EXPECTED = "a Siconos file (text)"


class Words:
    """A place in a text; line breaks are like blanks to Siconos."""

    def __init__(self, path: Path) -> None:
        self.path = path
        data = read_bytes(path, EXPECTED).removeprefix(BOM_UTF8)
        refuse_utf_16(path, data)
        try:
            self._text = data.decode("ascii")
        except UnicodeDecodeError as error:
            byte = f"the byte 0x{data[error.start]:02x} at place {error.start}"
            raise wrong(path, "content", EXPECTED, byte) from None
        self._words = self._text.split()
        self._next = 0
        if not self._words:
            raise wrong(path, "content", EXPECTED, "an empty file")

    @property
    def unread(self) -> int:
        """Return how many words have not been read."""
        return len(self._words) - self._next

    def peek(self) -> str | None:
        """Return the next word without taking it, None at the end."""
        return self._words[self._next] if self.unread else None

    def ahead(self, count: int) -> list[str]:
        """Return the next words, without taking them."""
        return self._words[self._next : self._next + count]

    def words(self, count: int, what: str) -> list[str]:
        """Return the next words; `what` is their name in messages.

        Raises
        ------
        InvalidProblem
            The text ends before.
        """
        if count > self.unread:
            raise wrong(
                self.path, what, f"{count} {'value' if count == 1 else 'values'}", f"{self.unread}, then the end"
            )
        taken = self._words[self._next : self._next + count]
        self._next += count
        return taken

    def integer(self, what: str) -> int:
        return int(self.integers(1, what)[0])

    def size(self, what: str) -> int:
        value = self.integer(what)
        if value < 0:
            raise wrong(self.path, what, "a size", value)
        return value

    def integers(self, count: int, what: str) -> Index:
        first = self._next
        return as_integers(self, self.words(count, what), what, first)

    def numbers(self, count: int, what: str) -> Array:
        """Return the next numbers (count,), which must be finite."""
        first = self._next
        return as_numbers(self, self.words(count, what), what, first)

    def literal(self, *expected: str, what: str) -> None:
        """Step over the next words, which must be these."""
        first = self._next
        taken = self.words(len(expected), what)
        for place, (want, got) in enumerate(zip(expected, taken, strict=True)):
            if want != got:
                raise self.unexpected(what, repr(want), first + place)

    def unexpected(self, what: str, expected: str, place: int | None = None) -> InvalidProblem:
        """Return the refusal of the word at a place, the one taken last by default."""
        at = self._next - 1 if place is None else place
        return wrong(self.path, f"{what} (line {self._line(at)})", expected, repr(self._words[at][:40]))

    @property
    def place(self) -> int:
        return self._next

    def _line(self, place: int) -> int:
        before = 0
        for number, line in enumerate(self._text.splitlines(), start=1):
            before += len(line.split())
            if before > place:
                return number
        return 0


def as_integers(words: Words, taken: list[str], what: str, first: int, step: int = 1) -> Index:
    """Return words as integers.

    Parameters
    ----------
    words : the file, which errors name
    taken : list of str, the words
    what : what the numbers are, for messages
    first, step : the k-th of them stands at the place first + k step of the file
    """
    try:
        return np.array([int(word) for word in taken], dtype=np.int64)
    except (ValueError, OverflowError):
        bad = next(k for k, word in enumerate(taken) if not _is_integer(word))
        raise words.unexpected(what, "an integer", first + bad * step) from None


def as_numbers(words: Words, taken: list[str], what: str, first: int, step: int = 1) -> Array:
    """Return words as finite numbers.

    Parameters
    ----------
    words, taken, what, first, step
        As in `as_integers`.
    """
    try:
        values = np.array([float(word) for word in taken])
    except ValueError:
        bad = next(k for k, word in enumerate(taken) if not is_number(word))
        raise words.unexpected(what, "a number", first + bad * step) from None
    check_finite(words.path, what, values)
    return values


def _is_integer(word: str) -> bool:
    try:
        return abs(int(word)) <= np.iinfo(np.int64).max
    except ValueError:
        return False


DENSE, BLOCKS, SPARSE = 0, 1, 2
TRIPLETS, COLUMNS, ROWS = 1, 2, 3


# Matrices in Siconos's text: dense, sparse blocks, and the dumps of CSparse.
#
# storage  size0  size1      and then, by storage,
# 0   size0 size1, and the values column by column
# 1   number of blocks, block rows, block columns; the last row of each block row, the last column of each block
#     column; the lengths of two lists: the first block of each block row, the block column of each block; then for
#     each block its number and its values column by column
# 2   1 (triplets) or 2 (columns), and what CSparse prints, with the six digits it prints


def read_matrix(words: Words, name: str, shape: tuple[int, int] | None = None) -> Any:
    """Return the next matrix in CSR form, of this shape if one is given.

    Raises InvalidProblem: the text ends, sizes do not agree, an index is out of range, a value is not a finite number;
    Unsupported: a storage that is none of these.
    """
    storage = words.integer(f"{name}, storage")
    if storage not in (DENSE, BLOCKS, SPARSE):
        raise words.unexpected(f"{name}, storage", "0 (dense), 1 (sparse blocks) or 2 (sparse)")
    size = (words.size(f"{name}, rows"), words.size(f"{name}, columns"))
    if shape is not None and size != shape:
        raise wrong(words.path, f"{name}, size", f"{shape}", size)
    read = {DENSE: _read_dense, BLOCKS: _read_blocks, SPARSE: _read_dump}[storage]
    return read(words, name, size)


def _read_dense(words: Words, name: str, size: tuple[int, int]) -> Any:
    _same_size(words, name, size, tuple(int(v) for v in words.integers(2, f"{name}, size")))
    values = words.numbers(size[0] * size[1], name)
    return sp.csr_array(values.reshape(size[1], size[0]).T)


def _same_size(words: Words, name: str, size: tuple[int, int], again: tuple[int, ...]) -> None:
    if again != size:
        raise wrong(words.path, f"{name}, size when it is stated again", f"{size}", again)


def _read_blocks(words: Words, name: str, size: tuple[int, int]) -> Any:
    count, block_rows, block_columns = (int(v) for v in words.integers(3, f"{name}, numbers of blocks"))
    if min(count, block_rows, block_columns) < 0:
        raise wrong(words.path, f"{name}, numbers of blocks", "sizes", (count, block_rows, block_columns))
    ends = (
        _ends(words, f"{name}, block rows", block_rows, size[0]),
        _ends(words, f"{name}, block columns", block_columns, size[1]),
    )
    pointers, filled = (int(v) for v in words.integers(2, f"{name}, lengths of the block lists"))
    if not 0 <= pointers <= block_rows + 1 or filled != count:
        expected = f"at most {block_rows + 1} and {count}"
        raise wrong(words.path, f"{name}, lengths of the block lists", expected, f"{pointers} and {filled}")
    first = words.integers(pointers, f"{name}, first block of each block row")
    if (pointers and (first[0] != 0 or np.any(np.diff(first) < 0))) or (first[-1] if pointers else 0) != count:
        expected = f"indices that begin at 0, never go back and end at {count}"
        raise wrong(words.path, f"{name}, first block of each block row", expected, first[:9].tolist())
    column = words.integers(filled, f"{name}, block columns")
    if np.any((column < 0) | (column >= block_columns)):
        worst = int(column[np.argmax((column < 0) | (column >= block_columns))])
        raise wrong(words.path, f"{name}, block columns", f"indices from 0 to {block_columns - 1}", worst)
    row = np.repeat(np.arange(max(pointers - 1, 0)), np.diff(first)) if pointers else np.zeros(0, dtype=int)
    return _placed_blocks(words, name, size, ends, row, column)


def _ends(words: Words, what: str, count: int, size: int) -> Index:
    """Return the ends (count + 1,) of blocks, the first of which is zero."""
    last = words.integers(count, what)
    ends = np.concatenate([[0], last])
    if np.any(np.diff(ends) < 0) or ends[-1] != size:
        raise wrong(words.path, what, f"ends that never go back and reach {size}", last[-9:].tolist())
    return ends


def _placed_blocks(
    words: Words,
    name: str,
    size: tuple[int, int],
    ends: tuple[Index, Index],
    row: NDArray[Any],
    column: Index,
) -> Any:
    rows, columns, values = [np.zeros(0, dtype=int)], [np.zeros(0, dtype=int)], [np.zeros(0)]
    for place, (i, j) in enumerate(zip(row, column, strict=True)):
        if words.integer(f"{name}, number of a block") != place:
            raise words.unexpected(f"{name}, number of a block", f"{place}")
        tall, wide = int(ends[0][i + 1] - ends[0][i]), int(ends[1][j + 1] - ends[1][j])
        values.append(words.numbers(tall * wide, f"{name}, block {place}"))
        rows.append(np.tile(np.arange(tall), wide) + ends[0][i])
        columns.append(np.repeat(np.arange(wide), tall) + ends[1][j])
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return sp.csr_array(sp.coo_array(entries, shape=size))


def _read_dump(words: Words, name: str, size: tuple[int, int]) -> Any:
    origin = words.integer(f"{name}, origin")
    if origin == ROWS:
        raise Unsupported(f"{words.path}: {name}: a dump of compressed rows (origin 3) is not supported")
    if origin not in (TRIPLETS, COLUMNS):
        raise words.unexpected(f"{name}, origin", "1 (triplets) or 2 (columns)")
    words.literal("CSparse", what=f"{name}, dump")
    while words.peek() is not None and not _is_size(str(words.peek())) and words.peek() != "triplet:":
        words.words(1, name)  # version, date and author
    if origin == TRIPLETS:
        words.literal("triplet:", what=f"{name}, dump")
    count = _dump_header(words, name, size)
    if origin == TRIPLETS:
        row, column, values = _dumped_triplets(words, name, count)
    else:
        row, column, values = _dumped_columns(words, name, size[1], count)
    for what, index, most in (("row", row, size[0]), ("column", column, size[1])):
        if np.any((index < 0) | (index >= most)):
            worst = int(index[np.argmax((index < 0) | (index >= most))])
            raise wrong(words.path, f"{name}, {what}", f"indices from 0 to {most - 1}", worst)
    return sp.csr_array(sp.coo_array((values, (row, column)), shape=size))


def _is_size(word: str) -> bool:
    return re.fullmatch(r"\d+-by-\d+,", word) is not None


def _dump_header(words: Words, name: str, size: tuple[int, int]) -> int:
    """Return K of the header ``m-by-n, nzmax: N nnz: K``; where entries stand by columns ``, 1-norm: X`` follows."""
    (stated,) = words.words(1, f"{name}, dump")
    if not _is_size(stated):
        raise words.unexpected(f"{name}, dump", "a size, like 3-by-3,")
    _same_size(words, name, size, tuple(int(part) for part in stated[:-1].split("-by-")))
    words.literal("nzmax:", what=f"{name}, dump")
    words.integer(f"{name}, nzmax")
    words.literal("nnz:", what=f"{name}, dump")
    (number,) = words.words(1, f"{name}, nnz")
    count = int(as_integers(words, [number.rstrip(",")], f"{name}, nnz", words.place - 1)[0])
    if count < 0:
        raise words.unexpected(f"{name}, nnz", "a number of entries")
    if number.endswith(","):
        words.literal("1-norm:", what=f"{name}, dump")
        words.words(1, f"{name}, 1-norm")
    return count


Entries = tuple[Index, Index, Array]


def _dumped_triplets(words: Words, name: str, count: int) -> Entries:
    """Return the entries of a matrix that is dumped as ``i j : x`` each."""
    first = words.place
    taken = words.words(4 * count, f"{name}, {count} entries")
    _colons(words, taken[2::4], name, first + 2, 4)
    row = as_integers(words, taken[0::4], f"{name}, row", first, 4)
    column = as_integers(words, taken[1::4], f"{name}, column", first + 1, 4)
    return row, column, as_numbers(words, taken[3::4], f"{name}, values", first + 3, 4)


def _dumped_columns(words: Words, name: str, width: int, count: int) -> Entries:
    """Return the entries of a matrix dumped by columns: ``col j : locations a to b``, then ``i : x`` for each entry."""
    rows, columns, values = [np.zeros(0, dtype=int)], [np.zeros(0, dtype=int)], [np.zeros(0)]
    read = 0
    for j in range(width):
        what = f"{name}, column {j}"
        words.literal("col", str(j), ":", "locations", str(read), "to", what=what)
        last = words.integer(what)
        if not read - 1 <= last < count:
            raise words.unexpected(what, f"a last location from {read - 1} to {count - 1}")
        here = last + 1 - read
        first = words.place
        taken = words.words(3 * here, what)
        _colons(words, taken[1::3], name, first + 1, 3)
        rows.append(as_integers(words, taken[0::3], what, first, 3))
        values.append(as_numbers(words, taken[2::3], what, first + 2, 3))
        columns.append(np.full(here, j))
        read = last + 1
    if read != count:
        raise wrong(words.path, name, f"{count} entries", read)
    return np.concatenate(rows), np.concatenate(columns), np.concatenate(values)


def _colons(words: Words, taken: list[str], name: str, first: int, step: int) -> None:
    bad = next((k for k, word in enumerate(taken) if word != ":"), None)
    if bad is not None:
        raise words.unexpected(f"{name}, dump", "':'", first + bad * step)


# Siconos's text files of frictional contact.
#
#     dimension, contacts, W, q, mu                 local:   u = W r + q
#     dimension, contacts, M, H, f, w, mu           global:  M v = H r + f,  u = H'v + w
#
# Old versions end a local file with one more number, 0 or 1. Nothing in a file says which of the two it is: it is local
# if its first matrix has the size of the contacts and what follows it is q and mu. Names of files say nothing.

# What old versions of Siconos put at the end: whether a problem is complete.
COMPLETE = ("0", "1")
# The shortest matrix that can follow: storage, rows, columns.
MATRIX_HEAD = 3


@checked
def read_siconos(path: Path, *, as_stored: bool = False) -> ContactProblem | LocalProblem | GlobalProblem:
    """Return the problem in a text file of Siconos; returns as `read_fclib`.

    Sparse matrices (storage 2) stand in the file with six digits: what is read is that problem, not the one that
    Siconos had in memory.

    Raises
    ------
    InvalidProblem
        No such file, text that ends early or goes on, a word that is not a number, sizes that do not agree, NaN.
    Unsupported
        Contacts that resist rolling.
    """
    stored = _read(Words(path))
    return stored if as_stored else solvable(stored, path)


def _read(words: Words) -> LocalProblem | GlobalProblem:
    d = check_dimension(words.path, "dimension", words.integer("dimension"))
    m = words.size("number of contacts")
    matrix = read_matrix(words, "first matrix")
    rows, columns = matrix.shape
    if rows != columns:
        raise wrong(words.path, "first matrix", "a square one (W or M)", matrix.shape)
    tail, bodies = (d + 1) * m, MATRIX_HEAD + rows + (d + 1) * m
    if rows == d * m and words.unread < bodies:
        _refuse_head_of_matrix(words, rows)
        q, mu = words.numbers(d * m, "q"), words.numbers(m, "mu")
        _end(words, f"the {tail} numbers of q and mu")
        check_friction(words.path, "mu", mu)
        with naming(words.path):
            return LocalProblem(delassus=matrix, offset=q, friction=mu, dimension=d)
    H = read_matrix(words, "H", (rows, d * m))
    f, w, mu = words.numbers(rows, "f"), words.numbers(d * m, "w"), words.numbers(m, "mu")
    _end(words, "mu")
    check_friction(words.path, "mu", mu)
    with naming(words.path):
        return GlobalProblem(matrix=matrix, directions=H, load=f, offset=w, friction=mu, dimension=d)


def _refuse_head_of_matrix(words: Words, size: int) -> None:
    """Refuse a global file that ends within H and must not pass for a local one; q is written with decimal points."""
    if words.unread >= MATRIX_HEAD and words.ahead(MATRIX_HEAD) in (
        [storage, f"{size}", f"{size}"] for storage in "012"
    ):
        found = " ".join(words.ahead(MATRIX_HEAD))
        raise wrong(words.path, "after the first matrix", "q, or the whole of a second matrix", f"{found!r}, its head")


def _end(words: Words, after: str) -> None:
    if words.unread == 1 and words.peek() in COMPLETE:
        return
    if words.unread:
        raise wrong(
            words.path, f"after {after}", "the end", f"{words.unread} more, beginning with {words.peek()!r:.40}"
        )
