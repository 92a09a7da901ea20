"""Read files with one-line errors and a ledger of what was read, and write files whole or not at all.

The interface of matrix readers, and FCLIB's and SciPy's ways to store a sparse matrix.
"""

from __future__ import annotations

import importlib.util
import os
import re
import stat
from codecs import BOM_UTF8
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Any, Literal, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.errors import BackendMissing, InvalidProblem, Unsupported, shown
from contactqp.model.arrays import Array, Index, Vector

Path = str | os.PathLike[str]

# Bytes of a file that is read as a whole and becomes objects of many times its size: text in words, JSON.
LARGEST_WHOLE = 2**27
LONGEST_SAYING = 200
EXPONENT_D = re.compile(r"(?<=[\d.])[dD](?=[+-]?\d)")
DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d*(?:[eE][+-]?\d+)?")
UTF_16 = (b"\xff\xfe", b"\xfe\xff")


def wrong(path: Path, place: str, expected: str, got: Any) -> InvalidProblem:
    """Return the error that something in a file is not what was expected, for the caller to raise.

    Parameters
    ----------
    path : Path
    place : str
        Where in the file: a key, a line, a column.
    expected : str
    got : object
        Its text is quoted.
    """
    return InvalidProblem(f"{path}: {place}: expected {expected}, got {got}")


def check_dimension(path: Path, place: str, dimension: int) -> int:
    """Return the dimension of contacts, 2 or 3.

    Raises Unsupported: 5, which says that the contacts resist rolling too; InvalidProblem: anything else.
    """
    if dimension == 5:
        raise Unsupported(
            f"{path}: {place} is 5: contacts that resist rolling are not supported, only sliding (2 or 3)"
        )
    if dimension not in (2, 3):
        raise wrong(path, place, "2 or 3", dimension)
    return dimension


def check_finite(path: Path, place: str, values: Array) -> None:
    """Raise InvalidProblem for values that are not finite; the message names file and place."""
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise wrong(path, place, "finite numbers", f"{values[bad[0]]} at [{bad[0]}]")


def check_friction(path: Path, place: str, friction: Array) -> None:
    """Raise InvalidProblem for negative coefficients of friction; the message names file and place."""
    if np.any(friction < 0):
        worst = int(np.argmin(friction))
        raise wrong(path, place, "coefficients of friction >= 0", f"{friction[worst]:.6g} at contact {worst}")


def number(word: str) -> float:
    """Return the number that a word states, also with Fortran's exponent as in 1.0D+03; Python's 1_000 is refused.

    Raises
    ------
    ValueError
        It is none.
    """
    if "_" in word:
        raise ValueError(word)
    return float(EXPONENT_D.sub("e", word))


def is_number(word: str) -> bool:
    """Return whether a word is a number, NaN included."""
    try:
        number(word)
    except ValueError:
        return False
    return True


def no_number(path: Path, place: str, word: str) -> InvalidProblem:
    """Return the error for a word that should be a number."""
    comma = " (a decimal comma? numbers have points)" if DECIMAL_COMMA.fullmatch(word.strip()) else ""
    return wrong(path, place, "a number", f"{word[:40]!r}{comma}")


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Put the file's name before what a problem refuses of its data."""
    try:
        yield
    except InvalidProblem as error:
        told = str(error)
        raise type(error)(told if told.startswith(f"{path}: ") else f"{path}: {told}") from None


def file_size(path: Path, expected: str) -> int:
    """Return how many bytes a file has.

    Raises
    ------
    InvalidProblem
        There is no such file, or it is a folder, a pipe or a device, which have no size to compare a header with.
    """
    try:
        found = os.stat(path)
    except FileNotFoundError:
        raise InvalidProblem(f"{path}: expected {expected}, and there is none of that name") from None
    except (OSError, ValueError) as error:
        raise _unreadable(path, expected, error) from None
    if stat.S_ISDIR(found.st_mode):
        raise InvalidProblem(f"{path}: expected {expected}, got a folder")
    if not stat.S_ISREG(found.st_mode):
        raise InvalidProblem(f"{path}: expected {expected}, got a pipe or a device")
    return found.st_size


# This many first bytes suffice to recognise every format that its content reveals.
HEAD = 512


def read_bytes(path: Path, expected: str, most: int = -1) -> bytes:
    """Return the first `most` bytes of a file, all of them by default, without the byte order mark of UTF-8.

    Raises InvalidProblem: there is no such file, it cannot be read, or all of it would be more than `LARGEST_WHOLE`.
    """
    size = file_size(path, expected)
    if most < 0 and size > LARGEST_WHOLE:
        raise wrong(path, "size", f"{expected} of at most {LARGEST_WHOLE >> 20} MiB", f"{size / 2**20:.0f} MiB")
    try:
        with open(path, "rb") as file:
            return file.read() if most < 0 else file.read(most + len(BOM_UTF8)).removeprefix(BOM_UTF8)[:most]
    except (OSError, ValueError) as error:
        raise _unreadable(path, expected, error) from None


def read_text(path: Path, expected: str) -> str:
    """Return all of a text file, UTF-8.

    Raises InvalidProblem as `read_bytes`, or bytes that are not text.
    """
    data = read_bytes(path, expected)
    refuse_utf_16(path, data)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        byte = f"the byte 0x{data[error.start]:02x} at place {error.start}"
        raise wrong(path, "content", expected, byte) from None
    if "\0" in text:
        raise wrong(path, "content", expected, f"the byte 0x00 at place {text.index(chr(0))}")
    return text


def refuse_utf_16(path: Path, head: bytes) -> None:
    """Refuse text that begins with the mark of UTF-16, as Windows' programs may save it."""
    if head.startswith(UTF_16):
        raise wrong(path, "content", "text in UTF-8", "UTF-16: save it as UTF-8")


def one_line(error: BaseException) -> str:
    """Return the message of another library's exception, without line breaks and shortened."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= LONGEST_SAYING else text[:LONGEST_SAYING] + "..."


def check_rows(path: Path, place: str, rows: int) -> None:
    """Refuse a number of rows that a file of this size cannot fill: one pointer a row would be more than the file."""
    most = 1000 + 8 * os.path.getsize(path)
    if rows > most:
        raise wrong(path, place, f"at most {most} rows in a file of this size", rows)


def _unreadable(path: Path, expected: str, error: Exception) -> InvalidProblem:
    return InvalidProblem(f"{path}: expected {expected} ({getattr(error, 'strerror', None) or one_line(error)})")


# The kinds of notes in a ledger: how a file became a problem or an answer.

KINDS = ("read", "converted", "assumed", "ignored")


@dataclass(frozen=True)
class Ledger:
    """Notes on what was read, converted, assumed and ignored of one source, one line each; readers append to it."""

    source: str
    read: list[str] = field(default_factory=list)
    converted: list[str] = field(default_factory=list)  # other signs, units or orders than ours
    assumed: list[str] = field(default_factory=list)  # what the source does not say
    ignored: list[str] = field(default_factory=list)  # what neither a problem nor an answer can hold

    def note_rigid_change(self, part: float) -> None:
        """Note the part of a stiffness, if any, that was taken for the rounding of printed digits."""
        if part > 0:
            digits = f"changed by {part:.1g} of its diagonal at most, the rounding of printed digits"
            self.converted.append(f"stiffness: {digits}, so that rigid motions cost no energy")

    def __iter__(self) -> Iterator[tuple[str, str]]:
        """Yield kind and line of every note, in the order of `KINDS`."""
        for kind in KINDS:
            for line in getattr(self, kind):
                yield kind, line

    def data(self) -> dict[str, object]:
        """Return all of it, for JSON."""
        return {"source": self.source} | {kind: list(getattr(self, kind)) for kind in KINDS}


# Text files of other programs are read line by line, since they may be larger than memory.

# The longest line that is accepted; programs that print tables of numbers break their lines.
LONGEST = 2**16


def text_lines(path: Path, expected: str) -> Iterator[str]:
    """Yield the lines, without their ends and without the mark of UTF-8 that Windows' programs begin text with.

    Raises InvalidProblem: no such file, an empty one, a byte that is not ASCII or zero, an endless line, or a last line
    that does not end: such a file was cut off, maybe within a number.
    """
    if not file_size(path, expected):
        raise wrong(path, "content", expected, "nothing")
    number = 0
    with open(path, "rb") as file:
        while line := file.readline(LONGEST):
            number += 1
            if number == 1:
                refuse_utf_16(path, line)
                line = line.removeprefix(BOM_UTF8)
            if not line.endswith(b"\n"):
                if len(line) == LONGEST:
                    raise wrong(path, f"line {number}", f"at most {LONGEST} bytes", "more")
                raise wrong(path, "last line", "a line break after it", "the end of the file: it was cut off")
            if not line.isascii() or b"\0" in line:
                strange = next(byte for byte in line if byte > 127 or byte == 0)
                raise wrong(path, f"line {number}", expected, f"the byte 0x{strange:02x}")
            yield line.rstrip(b"\r\n").decode("ascii")


PICTURES = (".png", ".pdf", ".svg")
VTU = (".vtu",)


def check_file(file: str | FilePath, suffixes: tuple[str, ...]) -> FilePath:
    """Return the file as a path.

    Raises InvalidProblem: another suffix, a folder that is not there, a folder in the place of the file.
    """
    path = FilePath(file)
    if path.suffix.lower() not in suffixes:
        raise InvalidProblem(f"{path}: expected a file name that ends in {' or '.join(suffixes)}")
    if path.is_dir():
        raise InvalidProblem(f"{path}: expected a file, this is a folder")
    if not path.parent.is_dir():
        raise InvalidProblem(f"{path}: there is no folder {str(path.parent)!r}")
    return path


def check_installed(package: str, purpose: str) -> None:
    """Raise BackendMissing where a package is not installed; it is looked up without importing it.

    Raises
    ------
    BackendMissing
    """
    if importlib.util.find_spec(package) is None:
        raise BackendMissing(f"{purpose} needs {package}: pip install {package}")


def write_whole(file: FilePath, write: Callable[[FilePath], None], *, durable: bool = False) -> None:
    """Write a file as a whole or not at all: `write` fills another beside it, which then takes its place.

    Raises InvalidProblem: the file system refuses.

    Parameters
    ----------
    durable : whether the file is forced onto the disk before this returns, so that a crash afterwards does not lose it
    """
    beside = file.with_name(f".{file.stem}.{os.getpid()}{file.suffix}")
    try:
        write(beside)
        if durable:
            _onto_disk(beside)
        os.replace(beside, file)
        if durable:
            _onto_disk(file.parent)
    except OSError as error:
        raise InvalidProblem(f"{file}: cannot be written ({error.strerror or error})") from error
    finally:
        beside.unlink(missing_ok=True)


def _onto_disk(path: FilePath) -> None:
    """Flush a file or a folder from the system's cache to the disk."""
    place = os.open(path, os.O_RDONLY)
    try:
        os.fsync(place)
    finally:
        os.close(place)


# The three ways in which FCLIB stores a sparse matrix, and SciPy's.
#
# nz = -1: compressed columns, p the n + 1 column pointers, i the rows; nz = -2: compressed rows, p the m + 1 row
# pointers, i the columns; nz >= 0: nz triplets, p the COLUMN and i the row of each, as in CSparse (the comment in
# fclib.h says it the other way round, FCLIB's files do not). The arrays may be longer than what is used of them: nzmax
# is what was allocated.

Storage = Literal["csc", "csr", "triplet"]
COLUMNS, ROWS = -1, -2
MARKS: dict[str, int] = {"csc": COLUMNS, "csr": ROWS}
LARGEST_INT = int(np.iinfo(np.int32).max)

Integers = Index


@dataclass(frozen=True, eq=False)
class StoredMatrix:
    """A matrix as FCLIB's file holds it."""

    nzmax: int
    m: int
    n: int
    nz: int
    p: Integers
    i: Integers
    x: Array


def matrix_of(stored: StoredMatrix, path: Path, place: str) -> Any:
    """Return the matrix in CSR form; entries that are stored twice are summed.

    Raises
    ------
    InvalidProblem
        A storage that does not exist, too few entries, pointers that go back, an index outside, a NaN.
    """
    if stored.nz < ROWS:
        raise wrong(path, f"{place}/nz", "-1 (columns), -2 (rows) or a number of triplets", stored.nz)
    if min(stored.m, stored.n) < 0:
        raise wrong(path, f"{place}/m, {place}/n", "a size", (stored.m, stored.n))
    check_rows(path, f"{place}/m", stored.m)
    row, column, used = _triplets(stored, path, place) if stored.nz >= 0 else _compressed(stored, path, place)
    x = stored.x[:used]
    check_finite(path, f"{place}/x", x)
    return sp.csr_array(sp.coo_array((x, (row, column)), shape=(stored.m, stored.n)))


def _triplets(stored: StoredMatrix, path: Path, place: str) -> tuple[Integers, Integers, int]:
    used = stored.nz
    _enough(stored, used, path, place, {"p": stored.p, "i": stored.i, "x": stored.x})
    row, column = stored.i[:used], stored.p[:used]
    _inside(row, stored.m, path, f"{place}/i (rows)")
    _inside(column, stored.n, path, f"{place}/p (columns)")
    return row, column, used


def _compressed(stored: StoredMatrix, path: Path, place: str) -> tuple[Integers, Integers, int]:
    lines, width = (stored.n, stored.m) if stored.nz == COLUMNS else (stored.m, stored.n)
    p = stored.p
    if len(p) < lines + 1:
        raise wrong(path, f"{place}/p", f"{lines + 1} pointers", len(p))
    p = p[: lines + 1]
    if p[0] != 0 or np.any(np.diff(p) < 0):
        raise wrong(path, f"{place}/p", "pointers that begin at 0 and never go back", _first_fault(p))
    used = int(p[-1])
    _enough(stored, used, path, place, {"i": stored.i, "x": stored.x})
    index = stored.i[:used]
    _inside(index, width, path, f"{place}/i")
    line = np.repeat(np.arange(lines), np.diff(p))
    return (index, line, used) if stored.nz == COLUMNS else (line, index, used)


def _first_fault(pointers: Integers) -> str:
    if pointers[0] != 0:
        return f"{pointers[0]} at [0]"
    at = int(np.argmax(np.diff(pointers) < 0))
    return f"{pointers[at]} and then {pointers[at + 1]} at [{at + 1}]"


def _enough(stored: StoredMatrix, used: int, path: Path, place: str, arrays: dict[str, NDArray[Any]]) -> None:
    if stored.nzmax < used:
        raise wrong(path, f"{place}/nzmax", f"at least the {used} entries that are stored", stored.nzmax)
    for name, values in arrays.items():
        if len(values) < used:
            raise wrong(path, f"{place}/{name}", f"{used} entries", len(values))


def _inside(index: Integers, size: int, path: Path, place: str) -> None:
    outside = np.flatnonzero((index < 0) | (index >= size))
    if outside.size:
        raise wrong(path, place, f"indices from 0 to {size - 1}", f"{index[outside[0]]} at [{outside[0]}]")


def stored_form(matrix: Any, storage: Storage, name: str) -> StoredMatrix:
    """Return a matrix as FCLIB stores it, nzmax = nz, no entry twice.

    Raises InvalidProblem: a storage that FCLIB does not have, or a matrix that FCLIB's 32 bits do not hold.
    """
    if storage not in ("csc", "csr", "triplet"):
        raise InvalidProblem(f"storage: expected 'csc', 'csr' or 'triplet', got {shown(storage)}")
    entries = sp.csc_array(matrix) if storage == "csc" else sp.csr_array(matrix)
    entries.sort_indices()
    if max(entries.nnz, *entries.shape) > LARGEST_INT:
        raise InvalidProblem(f"{name}: FCLIB's integers have 32 bits, got shape {entries.shape}, {entries.nnz} entries")
    if storage == "triplet":
        list_ = entries.tocoo()
        p, i, x, nz = list_.col, list_.row, list_.data, entries.nnz
    else:
        p, i, x, nz = entries.indptr, entries.indices, entries.data, MARKS[storage]
    m, n = entries.shape
    return StoredMatrix(entries.nnz, m, n, nz, p, i, np.asarray(x, dtype=float))


class MatrixFile(NamedTuple):
    """A matrix from a file."""

    matrix: Any  # dense or sparse; NaN is allowed here and refused by the problem
    labels: tuple[str, ...] | None  # names of the unknowns, such as "12.x", in the order of the columns
    ledger: Ledger


def say_sums(ledger: Ledger, stored: int, different: int) -> None:
    """Note that entries of a sparse matrix that are stored more than once were added up, as in every assembly."""
    if stored > different:
        ledger.converted.append(f"{stored - different} entries are stored more than once: added up")


@dataclass(frozen=True)
class MatrixReader:
    """A format of matrices or vectors."""

    name: str
    suffixes: tuple[str, ...]  # lower case, with their dots
    read: Callable[[Path], MatrixFile]
    recognises: Callable[[bytes], bool] | None = None  # whether these first bytes are unmistakably of this format
    stiffness: bool = False  # files of this suffix hold a stiffness, whatever they are called
    load: Callable[[Path], tuple[Vector, Ledger] | None] | None = None  # the load stored with the stiffness, if any
    beside: tuple[str, ...] = ()  # suffixes of files that it reads along with its own, such as those of names
