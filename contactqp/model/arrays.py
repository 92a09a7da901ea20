"""Define types of arrays, and how functions compute: rounding, threads of BLAS, clocks and time limits.

OpenBLAS is limited to one thread for small dense systems: two threads do not accelerate a Cholesky factorisation of a
few hundred rows, and slow it down a hundredfold where another process uses the second core, as they wait for each other
by spinning. MKL, which PARDISO uses, keeps its threads. A forked process makes new locks, as one held by another thread
at the time of the fork would never be released.

A `StageClock` measures the seconds of an answer's stages and counts factorisations; without a clock this costs nothing.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from contextvars import ContextVar
from functools import cache, cached_property, wraps
from inspect import Parameter, Signature, isfunction, signature
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem, NotConverged, WrongCall, no_argument, out_of_memory

Array = NDArray[np.float64]
Vector = NDArray[np.float64]  # one number an unknown, contact, tie
Index = NDArray[np.int64]
Indices = NDArray[np.intp]  # as NumPy's own functions return them
Mask = NDArray[np.bool_]


# The messages of NumPy and SciPy about matrices that are not finite.
NOT_FINITE = (
    "array must not contain infs or nans",
    "svd did not converge",
    "svd did not converge in linear least squares",
    "eigenvalues did not converge",
)
TOO_FAR_APART = (
    "numbers too far apart: a matrix made of them has entries beyond the range of floats ({}); expected fewer orders "
    "of magnitude between stiffnesses, rows or coefficients, which other units may bring"
)

# The smallest normal double.
TINY = float(np.finfo(float).tiny)
# The machine epsilon; one rounding is at most half of it, relatively.
EPS = float(np.finfo(float).eps)
# A factor that keeps a bound valid in spite of the rounding of its last operations.
ROUNDED_UP = 1.0 + 4.0 * EPS

# Sparse solvers use 32-bit indices.
LARGEST_INDEX = 2**31 - 1

P = ParamSpec("P")
R = TypeVar("R")
C = TypeVar("C", bound=type)


def inverse_root(diagonal: Array) -> Array:
    """Return 1/sqrt of a diagonal, and 1 where it is zero; subnormal entries are replaced by the smallest normal float.

    Products of two of these scales then do not overflow.
    """
    return np.asarray(1.0 / np.sqrt(np.where(diagonal > 0, np.maximum(diagonal, TINY), 1.0)))


def all_finite(answer: object) -> bool:
    """Return whether every number in the arrays of an answer, or of a candidate for one, is finite."""
    arrays = (part for part in vars(answer).values() if isinstance(part, np.ndarray) and part.dtype.kind == "f")
    return all(bool(np.isfinite(part).all()) for part in arrays)


# Values below this part of the largest are rounding that refinement leaves of zero.
INVISIBLE = 1e-22


def zero_beneath(values: Sequence[Array], units: Sequence[Array], least: float) -> list[Array]:
    """Return arrays with zeros in place of values with |value| times unit at most `least`, the rounding that refinement
    leaves.

    Units convert displacements and forces to square roots of energy: 1/D for displacements, the scaled length of
    the row for a force.
    """
    return [
        np.where(abs(value) * unit <= least, 0.0, value) if value.size else value
        for value, unit in zip(values, units, strict=True)
    ]


def own_floating_point(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that overflows, underflows and divides by zero silently, whatever `np.seterr` is set to.

    The result is then infinite or NaN, which no certificate passes. Under `np.seterr(all="raise")`, or with warnings as
    errors, harmless underflow would otherwise raise a foreign exception. Where a factorisation fails on such numbers,
    the error states that the numbers of the problem are too far apart, and where memory is full, what was needed and
    what is free. A call that does not fit the signature raises an error with the nearest names.
    """

    @wraps(function)
    def computing(*args: P.args, **kwargs: P.kwargs) -> R:
        with np.errstate(all="ignore"):
            try:
                return function(*args, **kwargs)
            except (np.linalg.LinAlgError, ValueError) as error:
                if str(error).lower() not in NOT_FINITE:
                    raise
                raise InvalidProblem(TOO_FAR_APART.format(error)) from error
            except MemoryError as error:
                raise out_of_memory(error) from None
            except TypeError:
                _refuse_misfit(function, args, kwargs)
                raise

    return computing


# Parameters that collect arguments without a name in the signature.
COLLECTING = (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD)


def misfit(signature: Signature, given: Mapping[str, Any], error: TypeError) -> str:
    """Return why a call does not fit the signature, unknown arguments first, as they may be misspelled missing ones."""
    names = [name for name, one in signature.parameters.items() if one.kind not in COLLECTING and name != "self"]
    unknown = [name for name in given if name not in names]
    return no_argument(unknown, names) if unknown else f"{error}; its arguments: {', '.join(names)}"


def _refuse_misfit(function: Callable[..., Any], args: Sequence[Any], kwargs: Mapping[str, Any]) -> None:
    """Raise WrongCall if these arguments do not fit the signature; otherwise the original TypeError stands."""
    try:
        signature(function).bind(*args, **kwargs)
    except TypeError as error:
        raise WrongCall(f"{function.__qualname__}: {misfit(signature(function), kwargs, error)}") from None


def refuses_misfits(function: Callable[P, R]) -> Callable[P, R]:
    """Make a constructor that reads its arguments itself raise WrongCall for calls that do not fit.

    Raises WrongCall: there is no argument of that name, and the nearest one is given; or arguments are missing.
    """
    names = [*signature(function).parameters][1:]
    known = frozenset(names)
    needed = [name for name, one in signature(function).parameters.items() if one.default is one.empty][1:]

    @wraps(function)
    def calling(*args: P.args, **kwargs: P.kwargs) -> R:
        if not kwargs.keys() <= known:
            unknown = [name for name in kwargs if name not in known]
            raise WrongCall(f"{type(args[0]).__name__}: {no_argument(unknown, names)}")
        missing = [name for name in needed[len(args) - 1 :] if name not in kwargs]
        if missing:
            called, absent = type(args[0]).__name__, " and ".join(map(repr, missing))
            raise WrongCall(f"{called}: {absent} missing; its arguments: {', '.join(names)}")
        return function(*args, **kwargs)

    return calling


def computes(kind: C) -> C:
    """Apply `own_floating_point` to the constructor and all public methods and properties of a class."""
    for name, value in tuple(vars(kind).items()):
        if name.startswith("_") and name != "__post_init__":
            continue
        if isfunction(value):
            setattr(kind, name, own_floating_point(value))
        elif isinstance(value, cached_property):
            value.func = own_floating_point(value.func)
        elif isinstance(value, property) and value.fget is not None:
            setattr(kind, name, property(own_floating_point(value.fget), doc=value.__doc__))
    return kind


def refuse_places_outside(name: str, matrix: Any) -> None:
    """Raise InvalidProblem where a sparse matrix has indices outside of its shape, or fewer values than indices.

    SciPy would read and write beyond the ends of its arrays.
    """
    if max(matrix.shape) > LARGEST_INDEX:
        raise InvalidProblem(f"{name}: expected at most {LARGEST_INDEX} rows and columns, got shape {matrix.shape}")
    if matrix.format == "coo":
        fit = all(_are_places(at, count, matrix.data) for at, count in zip(matrix.coords, matrix.shape, strict=True))
    elif matrix.format in ("csr", "csc", "bsr"):
        block = getattr(matrix, "blocksize", (1, 1))
        sizes = [size // width for size, width in zip(matrix.shape, block, strict=True)]
        rows, columns = sizes[::-1] if matrix.format == "csc" else sizes
        start, at = matrix.indptr, matrix.indices
        fit = len(start) == rows + 1 and start[0] == 0 and bool(np.all(np.diff(start) >= 0))
        fit = fit and start[-1] <= len(at) and _are_places(at, columns, matrix.data)
    else:
        return  # the other formats convert in Python, with checks
    if not fit:
        raise InvalidProblem(
            f"{name}: expected a sparse matrix, got one with entries outside of its shape {matrix.shape}"
        )


def _are_places(places: Any, count: int, data: Any) -> bool:
    """Return whether each value of a sparse matrix has one index below `count`."""
    within = not len(places) or (int(places.min()) >= 0 and int(places.max()) < count)
    return len(places) == len(data) and within


# The size of dense systems (rows of contacts, tangents and ties, or eliminated unknowns) from which OpenBLAS starts a
# second thread; below it limiting the threads is not worth the search for its libraries.
WORTHWHILE = 32


def renew_in_child(renew: Callable[[], None]) -> None:
    """Call this in every process that is forked from this one, where the platform forks."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=renew)


@contextmanager
def on_one_thread() -> Iterator[None]:
    """Keep OpenBLAS on one thread."""
    _LIMIT.enter(_openblas())
    try:
        yield
    finally:
        _LIMIT.leave()


class _Limit:
    """A limit of threads that concurrent callers share: the first one sets it, and the last one removes it."""

    def __init__(self) -> None:
        self._lock, self._count, self._limited = threading.Lock(), 0, ExitStack()

    def renew(self) -> None:
        """Make a new lock in a forked process, which keeps the limit of its parent."""
        self._lock = threading.Lock()

    def enter(self, pools: Any) -> None:
        with self._lock:
            if not self._count:
                self._limited.enter_context(pools.limit(limits=1))
            self._count += 1

    def leave(self) -> None:
        with self._lock:
            self._count -= 1
            if not self._count:
                self._limited.close()


_LIMIT = _Limit()
renew_in_child(_LIMIT.renew)


@cache
def _openblas() -> Any:
    """Return the controller of the OpenBLAS libraries of NumPy and SciPy."""
    import scipy.linalg  # noqa: F401  brings a library of its own
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(internal_api="openblas")


# The number of contacts from which on a second thread is faster.
THREADS_PAY = 1500


def one_blas_thread(problem: Any) -> AbstractContextManager[None]:
    """Keep OpenBLAS on one thread while a problem is worked on, unless its dense systems are large enough for two.

    The size of the dense systems decides, not the number of unknowns: for a membrane of 737 unknowns and 217 contacts,
    two threads made the Cholesky factorisation up to a hundred times slower beside other work.
    """
    tangents = 0 if problem.tangent is None else problem.tangent.shape[0]
    rows = max(problem.contacts + tangents + problem.ties, problem.dimension)
    return on_one_thread() if rows >= WORTHWHILE and problem.contacts < THREADS_PAY else nullcontext()


READ = "read and check the file"
BUILD = "build the problem"
CONDENSE = "condense"
METHOD = "method"
POLISH = "expand and polish"
CERTIFY = "certify"
STEPS = "between the steps"  # of a path or a motion: tangents, predictions, events
# In the order of the data.
STAGES = (READ, BUILD, CONDENSE, METHOD, POLISH, CERTIFY, STEPS)


class StageClock:
    """A clock of the seconds by stage; nested stages are subtracted from outer ones, so that all sum to the total."""

    def __init__(self) -> None:
        self.factorisations = 0  # of the stiffness
        self.half_substitutions = 0  # forward or backward, with one right-hand side
        self._seconds: dict[str, float] = {}
        self._outer: list[str] = []
        self._stage, self._since = "", time.perf_counter()

    @property
    def seconds(self) -> dict[str, float]:
        """Return the seconds so far by stage; those outside of any have the name ''."""
        self._charge()
        return dict(self._seconds)

    @property
    def back_substitutions(self) -> int:
        """Return the number of right-hand sides solved, forward and backward."""
        return (self.half_substitutions + 1) // 2

    @contextmanager
    def within(self, name: str) -> Iterator[None]:
        """Count the time inside the block as that of a stage, apart from stages inside it."""
        self._charge()
        self._outer.append(self._stage)
        self._stage = name
        try:
            yield
        finally:
            self._charge()
            self._stage = self._outer.pop()

    def _charge(self) -> None:
        now = time.perf_counter()
        self._seconds[self._stage] = self._seconds.get(self._stage, 0.0) + now - self._since
        self._since = now


# The running clock, if any, whose counts are increased by every factorisation and solve.
RUNNING: ContextVar[StageClock | None] = ContextVar("the clock that runs", default=None)
_UNTIMED = nullcontext()


@contextmanager
def timed() -> Iterator[StageClock]:
    """Run a clock for the work of this thread inside the block."""
    clock = StageClock()
    token = RUNNING.set(clock)
    try:
        yield clock
    finally:
        RUNNING.reset(token)


# The function that receives the progress of the running call, if any.
_LISTENER: ContextVar[Callable[[str], object] | None] = ContextVar("who is told where the call is", default=None)


@contextmanager
def telling(progress: Callable[[str], object] | None) -> Iterator[None]:
    """Have `tell` call a function inside the block; None keeps the current one."""
    token = _LISTENER.set(_LISTENER.get() if progress is None else progress)
    try:
        yield
    finally:
        _LISTENER.reset(token)


def tell(where: str) -> None:
    """Pass a short text on the current work to the function that `telling` has set."""
    listener = _LISTENER.get()
    if listener is not None:
        listener(where)


def stage(name: str) -> AbstractContextManager[None]:
    """Report a stage by `tell`, and count the time inside the block as its own if a clock runs."""
    tell(name)
    clock = RUNNING.get()
    return _UNTIMED if clock is None else clock.within(name)


STOPPED = "stopped at the time limit"
# The end of the running call, if it has a time limit, and that limit in seconds.
_END: ContextVar[tuple[float, float] | None] = ContextVar("when the call that runs has to end", default=None)


def within_time(seconds: float | None) -> AbstractContextManager[None]:
    """Have `refuse_late` raise after this many seconds; an earlier limit stays in force."""
    earlier = _END.get()
    end = earlier if seconds is None else (time.perf_counter() + seconds, seconds)
    return _ending(end if earlier is None or (end is not None and end[0] < earlier[0]) else earlier)


# Added to the message of a call that reached its time limit without an answer.
NO_ANSWER = "no displacement had been computed yet, so that there is no answer to return"


@contextmanager
def call_within_time(seconds: float) -> Iterator[None]:
    """Limit a call as `within_time` does; the error of one that is no part of another says if there is no answer."""
    whole = _END.get() is None
    try:
        with within_time(seconds):
            yield
    except NotConverged as error:
        if whole and error.solution is None and str(error).startswith(STOPPED):
            error.args = (f"{error}; {NO_ANSWER}",)
        raise


def in_any_time() -> AbstractContextManager[None]:
    """Suspend the time limit inside the block, so that an answer found so far can be certified."""
    return nullcontext() if _END.get() is None else _ending(None)


@contextmanager
def _ending(end: tuple[float, float] | None) -> Iterator[None]:
    token = _END.set(end)
    try:
        yield
    finally:
        _END.reset(token)


# When an answer that the time limit has cut short has been judged for as long again, and that limit; else None.
_UNFINISHED: ContextVar[tuple[float, float] | None] = ContextVar("when an unfinished answer is judged", default=None)


@contextmanager
def unfinished() -> Iterator[None]:
    """Mark, inside the block, that the time limit was reached before the method had an answer.

    The certificate then spends at most the same time on its bounds, and does not search for the right answer.
    """
    end = _END.get()
    token = _UNFINISHED.set(None if end is None else (time.perf_counter() + end[1], end[1]))
    try:
        yield
    finally:
        _UNFINISHED.reset(token)


def seconds_of_unfinished() -> float | None:
    """Return the time limit that was reached before the answer being certified was found, else None."""
    end = _UNFINISHED.get()
    return None if end is None else end[1]


def seconds_left() -> float | None:
    """Return the seconds left to the running call, at least a microsecond, None without a limit."""
    end = _END.get()
    return None if end is None else max(end[0] - time.perf_counter(), 1e-6)


def time_is_up() -> bool:
    """Return whether the time limit of the running call has passed."""
    end = _END.get()
    return end is not None and time.perf_counter() > end[0]


def stated_limit(seconds: float | None) -> str:
    """Return the time limit of the call, or outside of a call these seconds, as text."""
    end = _END.get()
    return f"{seconds if end is None else end[1]:g} s"


def refuse_late(what: str, judging: bool = False) -> None:
    """Raise NotConverged if the time limit has passed; `what` names the next piece of work.

    With `judging` also if an answer that the limit has cut short has been judged for as long again.
    """
    end = _END.get() or (_UNFINISHED.get() if judging else None)
    if end is not None and time.perf_counter() > end[0]:
        raise NotConverged(f"{STOPPED} of {end[1]:g} s, before {what}")
