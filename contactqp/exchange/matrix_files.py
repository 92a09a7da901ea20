"""Read a matrix or a vector from a file of any format: the registry of readers.

A format is one module with a `READER`, and its line in `READERS` here; `register` adds one from outside.
"""

from __future__ import annotations

from pathlib import Path as FilePath

from contactqp.exchange import ansys, deck_matrices, numpy_files, text_matrices
from contactqp.exchange.files import HEAD, MatrixFile, MatrixReader, Path, read_bytes, wrong

READERS: list[MatrixReader] = [
    deck_matrices.ABAQUS,  # .mtx without Matrix Market's banner
    text_matrices.MATRIX_MARKET,
    text_matrices.HARWELL_BOEING,
    numpy_files.READER,
    deck_matrices.CALCULIX,
    deck_matrices.MASS,
    ansys.READER,
    text_matrices.TEXT,
]
GZIP = b"\x1f\x8b"


def read_matrix(path: Path) -> MatrixFile:
    """Return a matrix (or a vector), the names of its unknowns, and the ledger of what was read and converted.

    Raises
    ------
    InvalidProblem
        No such file, no matrix of real numbers, sizes that the file cannot hold.
    Unsupported
        Complex numbers, patterns without values, matrices that are not assembled.
    BackendMissing
        The package that reads this format is not installed.
    """
    return reader_of(path).read(path)


def register(reader: MatrixReader) -> None:
    """Register a reader of another format; registered readers are tried before the package's own."""
    READERS.insert(0, reader)


def reader_of(path: Path) -> MatrixReader:
    """Return the reader of a file, found by its first bytes, else by its suffix, else the reader of plain text."""
    head = read_bytes(path, _expected(), HEAD)
    if head.startswith(GZIP):
        raise wrong(path, "content", _expected(), "a file compressed by gzip; expand it first")
    suffix = FilePath(path).suffix.lower()
    for reader in READERS:
        if reader.recognises is not None and reader.recognises(head):
            return reader
    return next((reader for reader in READERS if suffix in reader.suffixes), text_matrices.TEXT)


def companions() -> frozenset[str]:
    """Return suffixes of files that are read along with others and are not matrices."""
    return frozenset(suffix for reader in READERS for suffix in reader.beside)


def stiffness_suffixes() -> frozenset[str]:
    """Return the suffixes of formats whose files always hold a stiffness."""
    return frozenset(suffix for reader in READERS if reader.stiffness for suffix in reader.suffixes)


def _expected() -> str:
    return "a matrix: " + ", ".join(reader.name for reader in READERS)
