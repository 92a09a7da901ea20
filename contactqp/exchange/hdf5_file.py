"""An HDF5 file, read with every surprise refused in one line: file, dataset, what was expected, what came."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import BackendMissing, InvalidProblem
from contactqp.exchange.matrix_reader import StoredMatrix, matrix_of
from contactqp.exchange.refusal import Path, check_finite, file_size, one_line, read_bytes, wrong

SIGNATURE = b"\x89HDF\r\n\x1a\n"
# Where the signature may stand: a user block of 512 bytes or a power of two times that may come before it.
SIGNATURE_PLACES = (0, 512, 1024, 2048)
# What an array may grow to: this many times the size of the file and some more, as in an archive of arrays.
GROWTH, SMALL = 100, 2**26
EXPECTED = "an FCLIB file (HDF5)"


def is_hdf5(data: bytes) -> bool:
    """Whether these first bytes of a file are HDF5's."""
    return any(data[place:].startswith(SIGNATURE) for place in SIGNATURE_PLACES)


def h5py_module() -> Any:
    """h5py, imported when it is first needed.

    Raises
    ------
    BackendMissing
    """
    try:
        import h5py
    except ImportError as error:
        raise BackendMissing(f"FCLIB's files need h5py ({error}): pip install h5py") from None
    return h5py


@contextmanager
def opened(path: Path) -> Iterator[Hdf5File]:
    """The file, open for reading.

    Raises
    ------
    BackendMissing
        h5py is not installed.
    InvalidProblem
        No such file, or it is no HDF5.
    """
    head = read_bytes(path, EXPECTED, max(SIGNATURE_PLACES) + len(SIGNATURE))
    if not is_hdf5(head):
        raise wrong(path, "content", EXPECTED, "an empty file" if not head else "something else")
    h5py = h5py_module()
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise wrong(path, "content", EXPECTED, f"a damaged one ({one_line(error)})") from None
    with file:
        yield Hdf5File(path, file)


class Hdf5File:
    """Groups and datasets by their full names."""

    def __init__(self, path: Path, file: Any) -> None:
        self.path = path
        self._file = file

    def has(self, name: str) -> bool:
        try:
            return name in self._file
        except (OSError, RuntimeError, ValueError, KeyError) as error:
            raise wrong(self.path, name, "a group", f"damaged data ({one_line(error)})") from None

    def top(self) -> list[str]:
        try:
            return sorted(str(name) for name in self._file)
        except (OSError, RuntimeError, ValueError, KeyError) as error:
            raise wrong(self.path, "content", "groups", f"damaged data ({one_line(error)})") from None

    def integer(self, name: str) -> int:
        values = self.integers(name)
        if len(values) != 1:
            raise wrong(self.path, name, "one integer", f"{len(values)}")
        return int(values[0])

    def integers(self, name: str) -> NDArray[np.int64]:
        values = self._values(name)
        if values.dtype.kind not in "iu" or values.ndim > 1:
            raise wrong(self.path, name, "a list of integers", f"{values.dtype} of shape {values.shape}")
        return values.reshape(-1).astype(np.int64)

    def numbers(self, name: str) -> NDArray[np.float64]:
        """A list of numbers of any length, finite or not."""
        values = self._values(name)
        if values.dtype.kind not in "fiu" or values.ndim > 1:
            raise wrong(self.path, name, "a list of numbers", f"{values.dtype} of shape {values.shape}")
        return values.reshape(-1).astype(float)

    def vector(self, name: str, size: int, why: str, *, finite: bool = True) -> NDArray[np.float64]:
        """(size,) numbers; `why` says where the size comes from."""
        values = self.numbers(name)
        if len(values) != size:
            raise wrong(self.path, name, f"{size} numbers ({why})", len(values))
        if finite:
            check_finite(self.path, name, values)
        return values

    def shape(self, name: str) -> tuple[int, int]:
        """(m, n) of a matrix."""
        return self.integer(f"{name}/m"), self.integer(f"{name}/n")

    def matrix(self, name: str, shape: tuple[int, int], why: str) -> Any:
        """A matrix of this shape in CSR form; `why` says where the shape comes from."""
        if self.shape(name) != shape:
            raise wrong(self.path, f"{name}/m, {name}/n", f"{shape} ({why})", self.shape(name))
        stored = StoredMatrix(
            nzmax=self.integer(f"{name}/nzmax"),
            m=shape[0],
            n=shape[1],
            nz=self.integer(f"{name}/nz"),
            p=self.integers(f"{name}/p"),
            i=self.integers(f"{name}/i"),
            x=self.numbers(f"{name}/x"),
        )
        return matrix_of(stored, self.path, name)

    def _check_growth(self, name: str, dataset: Any) -> None:
        """Refuse what would grow beyond its file: chunks that are packed, or are not there at all."""
        most = SMALL + GROWTH * file_size(self.path, EXPECTED)
        stated = int(dataset.dtype.itemsize) * math.prod(int(size) for size in dataset.shape)
        if stated > most:
            raise wrong(self.path, name, f"at most {most >> 20} MiB", f"{stated / 2**20:.0f} MiB")

    def _values(self, name: str) -> NDArray[Any]:
        if not self.has(name):
            raise wrong(self.path, name, "this dataset", "none of that name")
        try:
            dataset = self._file[name]
            if not hasattr(dataset, "shape"):
                raise wrong(self.path, name, "a dataset", "a group")
            self._check_growth(name, dataset)
            return np.asarray(dataset[()])
        except InvalidProblem:
            raise
        except (OSError, RuntimeError, KeyError, TypeError, ValueError, MemoryError) as error:
            raise wrong(self.path, name, "numbers", f"damaged data ({one_line(error)})") from None
