"""NumPy's .npy and .npz: arrays of real numbers, and SciPy's sparse matrices. Nothing is unpickled.

Sizes stated by a header or an archive are checked against the file before memory is allocated.
"""

from __future__ import annotations

import ast
import io
import math
import re
import struct
import zipfile
import zlib
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.errors import ContactQPError, Unsupported
from contactqp.exchange.files import (
    COLUMNS,
    ROWS,
    Ledger,
    MatrixFile,
    MatrixReader,
    Path,
    StoredMatrix,
    check_rows,
    file_size,
    matrix_of,
    one_line,
    wrong,
)

# The header of one pickled object.
SINGLE_OBJECT = re.compile(
    rb"^\x93NUMPY.{4,6}\{'descr': '\|O', 'fortran_order': (?:False|True), 'shape': \(\), \}", re.DOTALL
)
NAME = "NumPy's .npy or .npz"
NUMPY, ZIP = b"\x93NUMPY", b"PK\x03\x04"
LONGEST_HEADER = 4096
# The largest unpacked size of an archive: this many times its own size, plus a constant. DEFLATE reaches 1032 times, on
# nothing but zeros.
GROWTH, SMALL = 100, 2**26
DAMAGED = (
    zipfile.BadZipFile, zlib.error, struct.error, OSError, EOFError, ValueError, RuntimeError, NotImplementedError,
    KeyError, IndexError, OverflowError, MemoryError, AttributeError, TypeError,
)  # fmt: skip

Arrays = Mapping[str, NDArray[Any]]


def read_numpy(path: Path) -> MatrixFile:
    """Return the array in a .npy file, the sparse matrix of `scipy.sparse.save_npz`, or the one array of a .npz file.

    Raises InvalidProblem: a damaged file, one that holds something else, sizes that the file cannot hold; Unsupported:
    Python objects, complex numbers, sparse forms other than CSR, CSC and COO.
    """
    ledger = Ledger(str(path))
    if starts_with(path, NUMPY):
        values = real(path, "content", read_npy(path))
        ledger.read.append(f".npy: {values.dtype} of shape {values.shape}")
        return MatrixFile(values, None, ledger)
    arrays = read_npz(path)
    if is_sparse(arrays):
        matrix = sparse_matrix(path, arrays)
        ledger.read.append(f"SciPy's sparse .npz: {matrix.shape[0]} by {matrix.shape[1]}")
        return MatrixFile(matrix, None, ledger)
    if len(arrays) != 1:
        raise wrong(path, "content", "one array, or SciPy's sparse matrix", f"the arrays {', '.join(arrays):.200}")
    ((name, values),) = arrays.items()
    values = real(path, name, values)
    ledger.read.append(f".npz: {name}, {values.dtype} of shape {values.shape}")
    return MatrixFile(values, None, ledger)


def real(path: Path, place: str, values: NDArray[Any]) -> NDArray[Any]:
    """Return real numbers of at most two dimensions; refuse anything else."""
    if values.dtype.kind not in "fiu":
        raise wrong(path, place, "real numbers", f"{values.dtype} of shape {values.shape}")
    if values.ndim > 2:
        raise wrong(path, place, "a matrix or a vector", f"shape {values.shape}")
    return np.atleast_1d(values)


def starts_with(path: Path, mark: bytes) -> bool:
    file_size(path, NAME)
    with open(path, "rb") as file:
        return file.read(len(mark)) == mark


def read_npy(path: Path) -> NDArray[Any]:
    """Return the real numbers of a .npy file, of any shape, in this machine's order of bytes."""
    size = file_size(path, NAME)
    with open(path, "rb") as file:
        return _array(path, "content", file, size)


def names_in_npz(path: Path) -> set[str]:
    """Return the names of the arrays of an archive; none where the file is not an archive or is damaged."""
    try:
        with zipfile.ZipFile(path) as archive:
            return {name.removesuffix(".npy") for name in archive.namelist()}
    except DAMAGED:
        return set()


def read_npz(path: Path, none_for_objects: bool = False) -> dict[str, Any]:
    """Return all arrays of an archive, by name; texts come as arrays of bytes.

    With `none_for_objects` a single pickled Python object, recognised by its header and never unpickled, is read as
    None.
    """
    size = file_size(path, NAME)
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            _check_growth(path, members, size)
            found: dict[str, Any] = {}
            for member in members:
                name = member.filename.removesuffix(".npy")
                if name in found:
                    raise wrong(path, name[:60], "every array once", "it twice")
                data = archive.read(member)
                if none_for_objects and SINGLE_OBJECT.search(data[:LONGEST_HEADER]):
                    found[name] = None
                    continue
                found[name] = _array(path, name[:60], io.BytesIO(data), len(data))
            return found
    except ContactQPError:
        raise
    except DAMAGED as error:
        raise wrong(path, "content", "an archive of arrays (.npz)", one_line(error)) from None


def _check_growth(path: Path, members: list[zipfile.ZipInfo], size: int) -> None:
    grown, most = sum(member.file_size for member in members), SMALL + GROWTH * size
    if grown > most:
        expected = f"at most {most >> 20} MiB from a file of {size} bytes"
        raise wrong(path, "sizes in the archive", expected, f"{grown / 2**20:.0f} MiB")


def _array(path: Path, place: str, file: BinaryIO, size: int) -> NDArray[Any]:
    """Return one array; `size` is that of the file or the member of an archive that it fills."""
    head = file.read(len(NUMPY) + 2)
    if not head.startswith(NUMPY) or len(head) < len(NUMPY) + 2 or head[6] not in (1, 2, 3):
        raise wrong(
            path, place, "an array of numbers, as NumPy writes it", "an empty file" if not head else repr(head[:8])
        )
    width = 2 if head[6] == 1 else 4
    length = int.from_bytes(file.read(width), "little")
    if length > LONGEST_HEADER:
        raise wrong(path, place, f"a header of at most {LONGEST_HEADER} bytes", length)
    dtype, shape, fortran = _header(path, place, file.read(length))
    count, held = math.prod(shape), size - len(head) - width - length
    if count * dtype.itemsize != held:
        stated = f"{dtype} of shape {shape}" if len(shape) < 5 else f"{len(shape)} dimensions"
        raise wrong(path, place, f"{count * dtype.itemsize:.6g} bytes ({stated})", f"{held}")
    values = np.frombuffer(file.read(held), dtype=dtype)
    values = values.reshape(shape, order="F" if fortran else "C")
    return values.astype(dtype.newbyteorder("="))


def _header(path: Path, place: str, text: bytes) -> tuple[np.dtype[Any], tuple[int, ...], bool]:
    try:
        stated = ast.literal_eval(text.decode("utf-8").strip())
        descr, shape, fortran = stated["descr"], stated["shape"], stated["fortran_order"]
        dtype = np.dtype(descr) if isinstance(descr, str) and len(stated) == 3 else None
    except (*DAMAGED, SyntaxError) as error:
        raise wrong(path, place, "a header of NumPy", one_line(error)) from None
    if dtype is None or dtype.kind in "OcV":
        raise Unsupported(f"{path}: {place}: expected an array of real numbers, got {descr!r:.60}")
    sizes = isinstance(shape, tuple) and all(type(part) is int and 0 <= part < 2**62 for part in shape)
    if not sizes or len(shape) > 4 or not isinstance(fortran, bool) or dtype.kind not in "biufSU":
        raise wrong(path, place, "an array of real numbers", f"{descr!r:.60} of shape {shape!r:.60}")
    return dtype, shape, fortran


def is_sparse(arrays: Arrays, name: str = "") -> bool:
    """Return whether these hold a matrix as `scipy.sparse.save_npz` stores it, each name beginning with `name`."""
    return {f"{name}data", f"{name}shape"} <= set(arrays)


def sparse_matrix(path: Path, arrays: Arrays, name: str = "") -> Any:
    """Return the sparse matrix in CSR form of data, indices, indptr (or row, col), shape, and format ("csr" where
    missing).
    """
    place = name.rstrip("_") or "content"

    def one(part: str, kinds: str) -> NDArray[Any]:
        values = arrays.get(f"{name}{part}")
        if values is None or values.ndim != 1 or values.dtype.kind not in kinds:
            got = "none of that name" if values is None else f"{values.dtype} of shape {values.shape}"
            raise wrong(path, f"{name}{part}", "a list of numbers", got)
        return values.astype(float if kinds == "biuf" else np.int64)

    stated = arrays.get(f"{name}format", np.array("csr"))
    form = stated.item() if stated.size == 1 else ""
    form = form.decode("latin-1") if isinstance(form, bytes) else str(form)
    if form not in ("csr", "csc", "coo"):
        raise Unsupported(f"{path}: {place}: expected the sparse form csr, csc or coo, got {form!r:.20}")
    shape = one("shape", "iu").tolist()
    if len(shape) != 2 or min(shape) < 0:
        raise wrong(path, f"{name}shape", "rows and columns", f"{shape!r:.60}")
    check_rows(path, f"{name}shape", shape[0])
    x = one("data", "biuf")
    if form == "coo":
        nz, p, i = len(x), one("col", "iu"), one("row", "iu")
    else:
        nz, p, i = (ROWS if form == "csr" else COLUMNS), one("indptr", "iu"), one("indices", "iu")
    stored = StoredMatrix(nzmax=len(x), m=shape[0], n=shape[1], nz=nz, p=p, i=i, x=x)
    return sp.csr_array(matrix_of(stored, path, place))


READER = MatrixReader(
    NAME, (".npy", ".npz"), read_numpy, recognises=lambda head: head.startswith((NUMPY, ZIP, b"PK\x05\x06"))
)
