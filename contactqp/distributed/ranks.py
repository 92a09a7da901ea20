"""Load PETSc and MPI, set PETSc's options, make its matrices, and exchange data between the processes (ranks) of a run.

`Ranks` has sums, messages of any size, requests to other ranks, and errors raised on all ranks.
"""

from __future__ import annotations

import ctypes
import glob
import importlib
import importlib.util
import os
import sys
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any, TypeVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.errors import BackendMissing, ContactQPError
from contactqp.model.arrays import Index, Indices, Vector

RECIPE = (
    "apt-get install python3-petsc4py python3-mpi4py python3-venv && /usr/bin/python3 -m venv --system-site-packages "
    "petsc && petsc/bin/pip install 'numpy<2' '.[solids]'"
)
# Debian builds petsc4py for the Python of this prefix, and installs it beside PETSc, not on the path of that Python.
_PREFIX = "/usr"
_DEBIAN = "/usr/lib/petscdir/petsc*/*-real/lib/python3/dist-packages"


@cache
def petsc() -> Any:
    """Start MPI and return the module petsc4py.PETSc.

    PETSc reads options from the variable PETSC_OPTIONS, not from the command line, which belongs to the program. Its
    errors are raised as PETSc.Error.

    Raises
    ------
    BackendMissing
        petsc4py or mpi4py is not installed, does not fit this NumPy, or was built for complex numbers.
    """
    if names := missing():
        raise BackendMissing(f"{' and '.join(names)} not installed: {RECIPE}")
    try:
        importlib.import_module("mpi4py.MPI")  # initialises MPI, and finalises it with the process
        importlib.import_module("petsc4py").init([])
        PETSc = importlib.import_module("petsc4py.PETSc")
    except (ImportError, ValueError) as error:  # ValueError: it was built for the arrays of another NumPy
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise BackendMissing(f"petsc4py cannot be loaded ({reason}): {RECIPE}") from error
    if PETSc.ScalarType().dtype.kind != "f":
        raise BackendMissing(f"petsc4py was built for complex numbers; expected a build for real ones: {RECIPE}")
    PETSc.Sys.pushErrorHandler("python")
    return PETSc


def missing() -> list[str]:
    """Return which of petsc4py and mpi4py are not installed, without loading them."""
    # Debian's petsc4py is put on the path of the Python that it was built for, unless PETSC_DIR names another PETSc.
    if importlib.util.find_spec("petsc4py") is None and sys.base_prefix == _PREFIX and "PETSC_DIR" not in os.environ:
        sys.path += sorted(glob.glob(_DEBIAN))[-1:]
    return [name for name in ("petsc4py", "mpi4py") if importlib.util.find_spec(name) is None]


def block_matrix(comm: Any, rows: sp.bsr_matrix) -> Any:
    """Make a PETSc.Mat from the rows of each rank over the unknowns of all ranks. Collective.

    Blocks of three have one column number for nine values, and products take half the time. PETSc's multigrids and
    factorisations take single rows alone (`aij_copy`).

    Returns
    -------
    PETSc.Mat
        BAIJ with the blocks of `rows`, or AIJ where these are single unknowns.
    """
    PETSc = petsc()
    size = rows.blocksize[0]
    matrix = PETSc.Mat().create(comm)
    matrix.setType(block_type(size))
    matrix.setSizes(((rows.shape[0], rows.shape[1]), (rows.shape[0], rows.shape[1])), bsize=size)
    indptr, indices = rows.indptr.astype(PETSc.IntType), rows.indices.astype(PETSc.IntType)
    matrix.setPreallocationCSR((indptr, indices, rows.data.reshape(-1)))
    matrix.assemble()
    return matrix


def aij_copy(matrix: Any) -> Any:
    """Copy a symmetric PETSc.Mat to the format AIJ of single rows. Collective."""
    PETSc = petsc()
    copy = matrix.convert(PETSc.Mat.Type.AIJ, PETSc.Mat())
    copy.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    return copy


def block_type(size: int) -> str:
    """Return PETSc's name of the matrix type with blocks of `size` unknowns."""
    Type = petsc().Mat.Type
    return str(Type.BAIJ if size > 1 else Type.AIJ)


class Product:
    """The product x -> A x with a square PETSc.Mat, or x -> A'x; calling it is collective."""

    def __init__(self, matrix: Any, *, transposed: bool = False) -> None:
        self._multiply = matrix.multTranspose if transposed else matrix.mult
        self._input, self._output = matrix.createVecs()

    def __call__(self, x: Vector) -> Vector:
        self._input.array[:] = x
        self._multiply(self._input, self._output)
        return np.array(self._output.array)


# The prefix of PETSc's options of preconditioners, as in PETSC_OPTIONS="-contactqp_pc_gamg_threshold 0.02".
PREFIX = "contactqp_"


@contextmanager
def temporary_options(prefix: str, defaults: dict[str, Any]) -> Iterator[None]:
    """Set PETSc's options of this prefix within the context, except those set by the user."""
    options = petsc().Options(prefix)
    added = {name: value for name, value in defaults.items() if not options.hasName(name)}
    for name, value in added.items():
        options[name] = value
    try:
        yield
    finally:
        for name in added:
            options.delValue(name)


def release_free_memory() -> None:
    """Return free memory between used blocks to the system, which glibc does by itself only at the end of its heap.

    A mesh is freed after the stiffness is assembled, so that its memory would lie below that of the stiffness. Other C
    libraries are left alone.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # CDLL(None) searches all libraries of this process
    if trim is not None:
        trim(0)


def collect_garbage(comm: Any) -> None:
    """Destroy the PETSc objects that Python has released on all ranks. Collective.

    PETSc would keep all released vectors and scatters, some for each solution.
    """
    cleanup = getattr(petsc(), "garbage_cleanup", None)  # PETSc before 3.18 destroys at once
    if cleanup is not None:
        cleanup(comm)


# Arrays are sent as bytes, in messages small enough for MPI's 32-bit counts; some transports count bytes.
MOST_BYTES = 2**30
# Marks arrays of Python objects, which cannot be sent as bytes.
_OBJECTS = -1

T = TypeVar("T")


class Ranks:
    """A communicator of mpi4py.

    All methods are collective and return the same on all ranks, unless stated otherwise.

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
        """Return the sum over the ranks of a number, or of arrays of equal shape."""
        return self._reduced(value, self._MPI.SUM)

    def max(self, value: Any) -> Any:
        """Return the maximum over the ranks of a number, or of an array entry by entry."""
        return self._reduced(value, self._MPI.MAX)

    def _reduced(self, value: Any, operation: Any) -> Any:
        if np.ndim(value) == 0:
            return self.comm.allreduce(value, operation)
        out = np.empty_like(value := np.ascontiguousarray(value))
        self.comm.Allreduce(value, out, operation)
        return out

    def any(self, flags: Any) -> bool:
        """Return whether any flag is set on any rank."""
        return bool(self.comm.allreduce(bool(np.any(flags)), self._MPI.LOR))

    def dot(self, a: Vector, b: Vector) -> float:
        """Return a'b of two distributed vectors."""
        return float(self.comm.allreduce(float(a @ b), self._MPI.SUM))

    def offset(self, count: int) -> int:
        """Return how many items the ranks before this one have; this rank has `count`."""
        return int(self.comm.scan(int(count), self._MPI.SUM)) - int(count)

    def gathered(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the concatenated arrays of all ranks, which should be small."""
        return np.concatenate(self.comm.allgather(np.asarray(values)))

    def exchange(self, destination: Indices, *arrays: NDArray[Any]) -> tuple[NDArray[Any], ...]:
        """Send row i of each array to rank destination[i]; return the received rows in the order of their senders."""
        order = np.argsort(destination, kind="stable")
        return self.send(np.bincount(destination, minlength=self.size), *(np.asarray(array)[order] for array in arrays))

    def send(self, counts: NDArray[Any], *arrays: NDArray[Any]) -> tuple[NDArray[Any], ...]:
        """Send the first counts[0] rows of each array to rank 0, the next counts[1] to rank 1, ...

        Returns the received rows in the order of their senders. Arrays of objects, and arrays whose row types differ
        between ranks (such as widths of text, or empty arrays), are pickled.
        """
        header = np.empty((self.size, 3), dtype=np.int64)
        largest = int(np.max(counts, initial=0)) * max((_row_bytes(array) for array in arrays), default=0)
        header[:, 0], header[:, 1], header[:, 2] = counts, largest, _row_types(arrays)
        received = np.empty_like(header)
        self.comm.Alltoall(header, received)
        if np.any(received[:, 2] != received[0, 2]) or received[0, 2] == _OBJECTS:
            return self._pickled(counts, arrays)
        rounds = _rounds(int(received[:, 1].max()))
        return tuple(self._send(rounds, counts, received[:, 0], array) for array in arrays)

    def _send(self, rounds: int, counts: NDArray[Any], received: NDArray[Any], array: NDArray[Any]) -> NDArray[Any]:
        rows = np.ascontiguousarray(array)
        out = np.empty((int(received.sum()), *rows.shape[1:]), dtype=rows.dtype)
        if not _row_bytes(rows):
            return out
        starts, places = np.cumsum(counts) - counts, np.cumsum(received) - received
        with _row_type(rows) as row:
            for (first, last), (begin, end) in zip(_slices(rounds, counts), _slices(rounds, received), strict=True):
                send = [_bytes(rows), (last - first, starts + first), row]
                self.comm.Alltoallv(send, [_bytes(out), (end - begin, places + begin), row])
        return out

    def _pickled(self, counts: NDArray[Any], arrays: Sequence[NDArray[Any]]) -> tuple[NDArray[Any], ...]:
        parts = [np.split(array, np.cumsum(counts)[:-1]) for array in arrays]
        received = self.comm.alltoall([tuple(part[rank] for part in parts) for rank in range(self.size)])
        return tuple(np.concatenate([part[i] for part in received]) for i in range(len(arrays)))

    def scatter(self, counts: NDArray[Any], values: NDArray[Any] | None) -> NDArray[Any]:
        """Return this rank's rows of an array that only the first rank has; the others pass None.

        The first counts[0] rows stay, the next counts[1] go to rank 1, ... Only the part of each rank is copied.
        """
        dtype, shape = self.broadcast(None if values is None else (values.dtype, values.shape[1:]))
        rows = np.empty((0, *shape), dtype=dtype) if values is None else values
        return self.send(np.zeros_like(counts) if values is None else counts, rows)[0]

    def broadcast(self, value: T) -> Any:
        """Return a small value of the first rank."""
        return self.comm.bcast(value)

    def on_first_rank(self, action: Callable[[], T]) -> T | None:
        """Call a function on the first rank only and return its result there, None on the others.

        Its ContactQPError is raised on all ranks.
        """
        with self.raising_together(name_rank=False):
            return action() if self.rank == 0 else None

    @contextmanager
    def raising_together(self, *, name_rank: bool = True) -> Iterator[None]:
        """Raise the ContactQPError of one rank on all ranks. The context must contain no collective call.

        With `name_rank` the message names the first rank that raised it, unless all did.
        """
        failure: ContactQPError | None = None
        try:
            yield
        except ContactQPError as error:
            failure = error
        failures = [(rank, other) for rank, other in enumerate(self.comm.allgather(failure)) if other is not None]
        if failures:
            rank, first = failures[0]
            if name_rank and len(failures) < self.size:
                first.args = (f"rank {rank}: {first}", *first.args[1:])
            raise first from failure


def _row_types(arrays: Sequence[NDArray[Any]]) -> int:
    """Return a hash of the row types of all arrays."""
    if any(array.dtype.hasobject for array in arrays):
        return _OBJECTS
    return zlib.crc32(repr([(array.dtype.str, array.shape[1:]) for array in arrays]).encode())


def _row_bytes(array: NDArray[Any]) -> int:
    return int(array.dtype.itemsize * np.prod(array.shape[1:], dtype=np.int64))


def _rounds(largest: int) -> int:
    """Return the number of messages for the longest array."""
    return -(-largest // MOST_BYTES)


def _slices(rounds: int, counts: NDArray[Any]) -> Iterator[tuple[NDArray[Any], NDArray[Any]]]:
    """Yield the first row of each round and the one after its last, the same for sender and receiver."""
    for i in range(rounds):
        yield counts * i // rounds, counts * (i + 1) // rounds


@contextmanager
def _row_type(array: NDArray[Any]) -> Iterator[Any]:
    """Return MPI's type of one row, so that MPI counts rows."""
    from mpi4py import MPI

    row = MPI.BYTE.Create_contiguous(_row_bytes(array)).Commit()
    try:
        yield row
    finally:
        row.Free()


def _bytes(array: NDArray[Any]) -> NDArray[np.uint8]:
    return array.reshape(-1).view(np.uint8)


Reply = Callable[[NDArray[Any], Index], tuple[NDArray[Any], ...]]


def ask_ranks(ranks: Ranks, owners: NDArray[Any], requests: NDArray[Any], reply: Reply) -> tuple[NDArray[Any], ...]:
    """Send row i of the requests to rank owners[i] and return the replies row by row. Collective.

    Parameters
    ----------
    ranks : the processes
    owners : (k,) array of int, the rank that each request goes to
    requests : (k, ...) array, the requests of this rank
    reply : function
        Takes the rows that this rank has received and their senders, and returns arrays, row for row. All ranks call
        it once, so that it may be collective.
    """
    place = np.arange(len(requests))
    received, places, sender = ranks.exchange(owners, requests, place, np.full(len(place), ranks.rank))
    back, *replies = ranks.exchange(sender, places, *reply(received, sender))
    order = np.empty(len(back), dtype=np.int64)
    order[back] = np.arange(len(back))
    return tuple(part[order] for part in replies)


def entries_of_rows(indptr: Index, rows: Index) -> tuple[Index, Index]:
    """Return the indices of the entries of some rows of a CSR matrix, row after row, and their number in each row."""
    counts = np.diff(indptr)[rows]
    return np.repeat(indptr[rows] - (np.cumsum(counts) - counts), counts) + np.arange(counts.sum()), counts


def rows_of_other_ranks(
    ranks: Ranks, starts: Index, wanted: Index, rows: Any, columns: Index | None = None
) -> tuple[Index, Index, Vector]:
    """Fetch rows of a distributed matrix from their ranks. Collective.

    Parameters
    ----------
    ranks : the processes
    starts : (ranks + 1,) array of int, where the rows of each rank begin
    wanted : (k,) array of int, numbers of rows
    rows : CSR or BSR matrix, the rows of this rank; of a BSR matrix rows and columns are those of blocks
    columns : array of int, optional
        The global numbers of the columns of `rows`, where these are numbered otherwise.

    Returns
    -------
    places, columns, values : arrays
        For each entry its row's place in `wanted`, its column, and its value.
    """
    owner = np.searchsorted(starts, wanted, side="right") - 1
    place, number, sender = ranks.exchange(owner, np.arange(len(wanted)), wanted, np.full(len(wanted), ranks.rank))
    entries, counts = entries_of_rows(rows.indptr, number - starts[ranks.rank])
    column = rows.indices[entries] if columns is None else columns[rows.indices[entries]]
    found = ranks.exchange(np.repeat(sender, counts), np.repeat(place, counts), column, rows.data[entries])
    return found[0], found[1], found[2]
