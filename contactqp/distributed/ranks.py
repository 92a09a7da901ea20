"""The processes of one run, and what they tell each other."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from contactqp.distributed import messages
from contactqp.distributed.environment import petsc
from contactqp.errors import ContactQPError
from contactqp.model.arrays import Vector

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
        return tuple(messages.sent(self.comm, counts, arrays))

    def scattered(self, counts: NDArray[np.intp], values: NDArray[Any] | None) -> NDArray[Any]:
        """This rank's rows of an array that the first rank alone has; counts[r] of them, in their order, are rank r's.

        The other ranks give None.
        """
        return messages.scattered(self.comm, counts, values)

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
