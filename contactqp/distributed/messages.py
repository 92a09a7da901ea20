"""Arrays from rank to rank as the bytes that they are, in messages of a size that MPI can count."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

# MPI counts in 32 bits, and some of its transports bytes too.
MOST_BYTES = 2**30
# The kind of arrays that are no bytes: they hold Python objects.
_OBJECTS = -1


def sent(comm: Any, counts: NDArray[Any], arrays: Sequence[NDArray[Any]]) -> list[NDArray[Any]]:
    """The first counts[0] rows of each array go to rank 0, the next counts[1] to rank 1, ...; what came is returned.

    Arrays of objects, and those whose rows are not of one type on all ranks (text is as wide as its longest, and an
    empty array may be of any type), are pickled. Collective.
    """
    told = np.empty((comm.size, 3), dtype=np.int64)
    largest = int(np.max(counts, initial=0)) * max((_row_bytes(array) for array in arrays), default=0)
    told[:, 0], told[:, 1], told[:, 2] = counts, largest, _kind(arrays)
    heard = np.empty_like(told)
    comm.Alltoall(told, heard)
    if np.any(heard[:, 2] != heard[0, 2]) or heard[0, 2] == _OBJECTS:
        return _pickled(comm, counts, arrays)
    came = heard[:, 0]
    rounds = _rounds(int(heard[:, 1].max()))
    return [_sent(comm, rounds, counts, came, array) for array in arrays]


def scattered(comm: Any, counts: NDArray[Any], values: NDArray[Any] | None) -> NDArray[Any]:
    """The rows of an array that the first rank alone has: counts[0] of them stay, the next counts[1] go to rank 1, ...

    Nothing is copied but the part of each rank. Collective; the other ranks give None.
    """
    said = None if values is None else (values.dtype.str, values.shape[1:])
    dtype, shape = comm.bcast(said)
    out = np.empty((int(counts[comm.rank]), *shape), dtype=dtype)
    rows = None if values is None else np.ascontiguousarray(values)
    starts = np.cumsum(counts) - counts
    rounds = _rounds(int(np.max(counts, initial=0)) * _row_bytes(out))
    with _row_type(out) as row:
        for first, last in _pieces(rounds, counts):
            at, end = first[comm.rank], last[comm.rank]
            given = None if rows is None else [_bytes(rows), (last - first, starts + first), row]
            comm.Scatterv(given, [_bytes(out[at:end]), int(end - at), row])
    return out


def _sent(comm: Any, rounds: int, counts: NDArray[Any], came: NDArray[Any], array: NDArray[Any]) -> NDArray[Any]:
    rows = np.ascontiguousarray(array)
    out = np.empty((int(came.sum()), *rows.shape[1:]), dtype=rows.dtype)
    if not _row_bytes(rows):
        return out
    starts, places = np.cumsum(counts) - counts, np.cumsum(came) - came
    with _row_type(rows) as row:
        for (first, last), (begin, end) in zip(_pieces(rounds, counts), _pieces(rounds, came), strict=True):
            comm.Alltoallv(
                [_bytes(rows), (last - first, starts + first), row], [_bytes(out), (end - begin, places + begin), row]
            )
    return out


def _pickled(comm: Any, counts: NDArray[Any], arrays: Sequence[NDArray[Any]]) -> list[NDArray[Any]]:
    cuts = np.cumsum(counts)[:-1]
    parts = [np.split(array, cuts) for array in arrays]
    came = comm.alltoall([tuple(part[rank] for part in parts) for rank in range(comm.size)])
    return [np.concatenate([part[i] for part in came]) for i in range(len(arrays))]


def _kind(arrays: Sequence[NDArray[Any]]) -> int:
    """The same number on two ranks where the rows of all arrays are of the same types."""
    if any(array.dtype.hasobject for array in arrays):
        return _OBJECTS
    return zlib.crc32(repr([(array.dtype.str, array.shape[1:]) for array in arrays]).encode())


def _row_bytes(array: NDArray[Any]) -> int:
    return int(array.dtype.itemsize * np.prod(array.shape[1:], dtype=np.int64))


def _rounds(largest: int) -> int:
    """How many messages the longest of them is cut into."""
    return -(-largest // MOST_BYTES)


def _pieces(rounds: int, counts: NDArray[Any]) -> Iterator[tuple[NDArray[Any], NDArray[Any]]]:
    """From which row to which each round goes; both ends of a message know its count and cut it alike."""
    for i in range(rounds):
        yield counts * i // rounds, counts * (i + 1) // rounds


@contextmanager
def _row_type(array: NDArray[Any]) -> Iterator[Any]:
    """One row as MPI sees it, so that counts and places are those of rows."""
    from mpi4py import MPI

    row = MPI.BYTE.Create_contiguous(_row_bytes(array)).Commit()
    try:
        yield row
    finally:
        row.Free()


def _bytes(array: NDArray[Any]) -> NDArray[np.uint8]:
    return array.reshape(-1).view(np.uint8)
