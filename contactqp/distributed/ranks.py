"""The processes of one run: collective sums, messages of any size, questions to other ranks, rows that others hold."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from contactqp.distributed.environment import petsc
from contactqp.errors import ContactQPError
from contactqp.model.arrays import Index, Vector

# Arrays from rank to rank as the bytes that they are, in messages of a size that MPI can count.

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


T = TypeVar("T")


class Ranks:
    """A communicator of mpi4py. All methods are collective, and all ranks get the same.

    Parameters
    ----------
    comm : mpi4py.MPI.Intracomm, optional
        By default all processes that were started together: ``mpiexec -n N``, or the one process.
    """

    def __init__(self, comm: Any = None) -> None:
        petsc()
        from mpi4py import MPI

        self._MPI = MPI
        self.comm = MPI.COMM_WORLD if comm is None else comm
        self.rank, self.size = int(self.comm.rank), int(self.comm.size)

    def sum(self, value: Any) -> Any:
        """The sum over the ranks of a number, or of an array of one shape on all of them."""
        return self.comm.allreduce(value, self._MPI.SUM) if np.ndim(value) == 0 else self._reduced(value, self._MPI.SUM)

    def max(self, value: Any) -> Any:
        """The largest over the ranks of a number, or of an array entry by entry."""
        return self.comm.allreduce(value, self._MPI.MAX) if np.ndim(value) == 0 else self._reduced(value, self._MPI.MAX)

    def any(self, flags: Any) -> bool:
        """Whether any flag is set on any rank."""
        return bool(self.comm.allreduce(bool(np.any(flags)), self._MPI.LOR))

    def dot(self, a: Vector, b: Vector) -> float:
        """a'b of vectors whose parts the ranks hold."""
        return float(self.comm.allreduce(float(a @ b), self._MPI.SUM))

    def first(self, count: int) -> int:
        """The number of the first of `count` things of this rank, of all counted rank after rank."""
        return int(self.comm.scan(int(count), self._MPI.SUM)) - int(count)

    def gathered(self, values: NDArray[Any]) -> NDArray[Any]:
        """The arrays of all ranks, one after the other, on every rank: for what is small."""
        return np.concatenate(self.comm.allgather(np.asarray(values)))

    def exchanged(self, destination: NDArray[np.intp], *arrays: NDArray[Any]) -> tuple[NDArray[Any], ...]:
        """Row i of each array goes to rank destination[i]; returned is what came here, in the order of its ranks."""
        order = np.argsort(destination, kind="stable")
        return self.sent(np.bincount(destination, minlength=self.size), *(np.asarray(array)[order] for array in arrays))

    def sent(self, counts: NDArray[np.intp], *arrays: NDArray[Any]) -> tuple[NDArray[Any], ...]:
        """The same of rows that stand in the order of their destinations: counts[r] of them go to rank r."""
        return tuple(sent(self.comm, counts, arrays))

    def scattered(self, counts: NDArray[np.intp], values: NDArray[Any] | None) -> NDArray[Any]:
        """This rank's rows of an array that the first rank alone has; counts[r] of them, in their order, are rank r's.

        The other ranks give None.
        """
        return scattered(self.comm, counts, values)

    def by_first(self, action: Callable[[], T]) -> T | None:
        """What an action returns that the first rank alone does; None on the others. What it refuses, all refuse."""
        failure: ContactQPError | None = None
        found: T | None = None
        if self.rank == 0:
            try:
                found = action()
            except ContactQPError as error:
                failure = error
        known = self.comm.bcast(failure)
        if known is not None:
            raise known from failure
        return found

    def told(self, value: T) -> T:
        """What the first rank has of something small."""
        known: T = self.comm.bcast(value)
        return known

    @contextmanager
    def together(self) -> Iterator[None]:
        """What one rank refuses, all refuse with the same error; nothing collective may stand inside.

        The message names the first rank that refuses, unless all do.
        """
        failure: ContactQPError | None = None
        try:
            yield
        except ContactQPError as error:
            failure = error
        known = [(rank, other) for rank, other in enumerate(self.comm.allgather(failure)) if other is not None]
        if known:
            rank, first = known[0]
            if len(known) < self.size:
                first.args = (f"rank {rank}: {first}", *first.args[1:])
            raise first from failure

    def _reduced(self, value: Any, operation: Any) -> Any:
        out = np.empty_like(value := np.ascontiguousarray(value))
        self.comm.Allreduce(value, out, operation)
        return out


# Questions to other ranks, and their answers.

Answer = Callable[[NDArray[Any], Index], tuple[NDArray[Any], ...]]


def asked(ranks: Ranks, whom: NDArray[Any], question: NDArray[Any], answer: Answer) -> tuple[NDArray[Any], ...]:
    """Row i of a question goes to rank whom[i]; the answers come back row for row. Collective.

    Parameters
    ----------
    answer : function
        From the rows that came to this rank and the ranks that they came from to arrays, row for row. All ranks call
        it once, so that it may be collective.
    """
    place = np.arange(len(question))
    came, where, asker = ranks.exchanged(whom, question, place, np.full(len(place), ranks.rank))
    back, *found = ranks.exchanged(asker, where, *answer(came, asker))
    order = np.empty(len(back), dtype=np.int64)
    order[back] = np.arange(len(back))
    return tuple(part[order] for part in found)


# Rows of a matrix that other ranks have.

ColumnIndex = NDArray[Any]


def rows_of_others(
    ranks: Ranks, starts: ColumnIndex, asked: ColumnIndex, rows: Any, columns: ColumnIndex | None = None
) -> tuple[ColumnIndex, ColumnIndex, Vector]:
    """The entries of rows of any rank: which of those asked each is in, its column, and itself. Collective.

    Parameters
    ----------
    starts : (ranks + 1,) array of int
        Where the rows of each rank begin.
    asked : (k,) array of int
        Numbers of rows.
    rows : CSR or BSR matrix
        The rows of this rank; of a BSR matrix rows and columns are those of blocks.
    columns : array of int, optional
        What the columns of `rows` stand for.
    """
    owner = np.searchsorted(starts, asked, side="right") - 1
    place, number, asker = ranks.exchanged(owner, np.arange(len(asked)), asked, np.full(len(asked), ranks.rank))
    number = number - starts[ranks.rank]
    begin, count = rows.indptr[number], np.diff(rows.indptr)[number]
    entry = np.repeat(begin - (np.cumsum(count) - count), count) + np.arange(count.sum())
    column = rows.indices[entry] if columns is None else columns[rows.indices[entry]]
    found = ranks.exchanged(np.repeat(asker, count), np.repeat(place, count), column, rows.data[entry])
    return found[0], found[1], found[2]
