"""Types of arrays, and how functions compute: floating-point errors, threads of BLAS, clocks and time limits.

Arrays are named by what they hold; shapes stand beside each field and in each docstring.

OpenBLAS keeps to one thread around small dense systems: two threads make a Cholesky factorisation of a few hundred rows
no faster, and a hundred times slower where another process has the second core: they wait for each other by spinning.
MKL, which PARDISO runs on, keeps its threads. A lock that another thread holds while the process is forked would never
be released in the child, which therefore makes its own.

A clock takes the seconds of an answer's stages and counts its factorisations; it costs nothing where none runs.
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

from contactqp.errors import InvalidProblem, NotConverged, WrongCall, no_argument

Array = NDArray[np.float64]
Vector = NDArray[np.float64]  # one number an unknown, contact, tie
Index = NDArray[np.int64]
Indices = NDArray[np.intp]  # as NumPy's own functions return them
Mask = NDArray[np.bool_]


# What NumPy and SciPy say of matrices that are not finite.
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

# The least double with all its digits.
TINY = float(np.finfo(float).tiny)
# The rounding of a double is at most half of this part of it.
EPS = float(np.finfo(float).eps)
# Times this a bound stays one, whatever its last operations have rounded.
ROUNDED_UP = 1.0 + 4.0 * EPS

# Sparse solvers count rows and columns with 32 bits.
LARGEST_INDEX = 2**31 - 1

P = ParamSpec("P")
R = TypeVar("R")
C = TypeVar("C", bound=type)


def inverse_root(diagonal: Array) -> Array:
    """Return 1/sqrt of a diagonal, and 1 where it is zero; entries below the normal floats count as the smallest of
    these.

    Products of two of these scales therefore stay in the range of floats.
    """
    return np.asarray(1.0 / np.sqrt(np.where(diagonal > 0, np.maximum(diagonal, TINY), 1.0)))


def all_finite(answer: object) -> bool:
    """Return whether every number in the arrays of an answer, or of a candidate for one, is finite."""
    arrays = (part for part in vars(answer).values() if isinstance(part, np.ndarray) and part.dtype.kind == "f")
    return all(bool(np.isfinite(part).all()) for part in arrays)


def zero_beneath(values: Sequence[Array], units: Sequence[Array], least: float) -> list[Array]:
    """Return arrays with zeros where |value| times its unit is at most `least`: the rounding that refinement leaves.

    Units turn displacements and forces into square roots of energy, in which they compare: 1/D for displacements, the
    scaled length of its row for a force.
    """
    return [
        np.where(abs(value) * unit <= least, 0.0, value) if value.size else value
        for value, unit in zip(values, units, strict=True)
    ]


def own_floating_point(function: Callable[P, R]) -> Callable[P, R]:
    """Let a function overflow, underflow and divide by zero silently, whatever `np.seterr` says.

    What comes of it is infinite or NaN, which no certificate passes; under `np.seterr(all="raise")`, or with warnings
    as errors, harmless underflow would end a solve with somebody else's exception. Where a factorisation refuses such
    numbers, numbers of the problem are too far apart to be computed with, and the error says so.
    A call that does not fit the signature is told the nearest arguments.
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
            except TypeError:
                _refuse_misfit(function, args, kwargs)
                raise

    return computing


# Parameters that collect arguments without a name in the signature.
COLLECTING = (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD)


def misfit(signature: Signature, given: Mapping[str, Any], error: TypeError) -> str:
    """Return why a call does not fit: the arguments that are not there first, which a missing one may be meant by."""
    names = [name for name, one in signature.parameters.items() if one.kind not in COLLECTING and name != "self"]
    unknown = [name for name in given if name not in names]
    return no_argument(unknown, names) if unknown else f"{error}; its arguments: {', '.join(names)}"


def _refuse_misfit(function: Callable[..., Any], args: Sequence[Any], kwargs: Mapping[str, Any]) -> None:
    """Raise WrongCall where these arguments do not fit the signature; a call that fits raised what it raised."""
    try:
        signature(function).bind(*args, **kwargs)
    except TypeError as error:
        raise WrongCall(f"{function.__qualname__}: {misfit(signature(function), kwargs, error)}") from None


def refuses_misfits(function: Callable[P, R]) -> Callable[P, R]:
    """Refuse calls that do not fit a constructor which reads its arguments itself.

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
    """Give the constructor and all public methods and properties of a class settings of their own, as above."""
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
    """Raise InvalidProblem where a sparse matrix has entries outside of its shape, or fewer numbers than places.

    SciPy's conversions of such a matrix read and write beyond the ends of its arrays.
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
    """Return whether each number of a sparse matrix has one place among `count`."""
    within = not len(places) or (int(places.min()) >= 0 and int(places.max()) < count)
    return len(places) == len(data) and within


# Rows of contacts, tangents and ties, or unknowns that are eliminated by dense factors, from which OpenBLAS would start
# a second thread; smaller problems are done before its libraries are found.
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
    """One limit for all who want it at a time: entered by the first, left by the last."""

    def __init__(self) -> None:
        self._lock, self._count, self._limited = threading.Lock(), 0, ExitStack()

    def renew(self) -> None:
        """Take a new lock in a process that was forked; it keeps the limit of the process that it comes from."""
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


# Contacts from which a second thread pays.
THREADS_PAY = 1500


def one_blas_thread(problem: Any) -> AbstractContextManager[None]:
    """Keep OpenBLAS on one thread while a problem is worked on, unless its dense systems are large enough for two.

    What counts is the size of the dense systems, whatever the number of unknowns: a membrane of 737 unknowns has 217
    contacts, and two threads made its Cholesky factors up to a hundred times slower beside other work.
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
    """Seconds by stage. Each instant belongs to the innermost stage that it is in, so that they sum to the total."""

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


# The clock that runs, if one does: whoever factorises or solves adds to its counts.
RUNNING: ContextVar[StageClock | None] = ContextVar("the clock that runs", default=None)
_UNTIMED = nullcontext()


@contextmanager
def timed() -> Iterator[StageClock]:
    """Run a clock for all that this thread does inside the block."""
    clock = StageClock()
    token = RUNNING.set(clock)
    try:
        yield clock
    finally:
        RUNNING.reset(token)


# Who is told where the call that runs is, if anybody.
_LISTENER: ContextVar[Callable[[str], object] | None] = ContextVar("who is told where the call is", default=None)


@contextmanager
def telling(progress: Callable[[str], object] | None) -> Iterator[None]:
    """Have `tell` call a function while this lasts; None leaves the one that there is."""
    token = _LISTENER.set(_LISTENER.get() if progress is None else progress)
    try:
        yield
    finally:
        _LISTENER.reset(token)


def tell(where: str) -> None:
    """Say in a few words what is done now."""
    listener = _LISTENER.get()
    if listener is not None:
        listener(where)


def stage(name: str) -> AbstractContextManager[None]:
    """Say that a stage begins, and charge what happens meanwhile to it if a clock runs."""
    tell(name)
    clock = RUNNING.get()
    return _UNTIMED if clock is None else clock.within(name)


STOPPED = "stopped at the time limit"
# When the call that runs has to end, if it has to, and the seconds that it was given.
_END: ContextVar[tuple[float, float] | None] = ContextVar("when the call that runs has to end", default=None)


def within_time(seconds: float | None) -> AbstractContextManager[None]:
    """Have `refuse_late` raise so many seconds from now; an earlier end that is already set stays."""
    earlier = _END.get()
    end = earlier if seconds is None else (time.perf_counter() + seconds, seconds)
    return _ending(end if earlier is None or (end is not None and end[0] < earlier[0]) else earlier)


# What is said of a call that had to end before it had any answer.
NO_ANSWER = "no displacement had been computed yet, so that there is no answer to return"


@contextmanager
def call_within_time(seconds: float) -> Iterator[None]:
    """End a call as `within_time` does, and say of one that had no answer until then why it returns none."""
    try:
        with within_time(seconds):
            yield
    except NotConverged as error:
        if error.solution is None and str(error).startswith(STOPPED) and NO_ANSWER not in str(error):
            error.args = (f"{error}; {NO_ANSWER}",)
        raise


def in_any_time() -> AbstractContextManager[None]:
    """Suspend the time limit inside the block, so that what has been found is certified."""
    return nullcontext() if _END.get() is None else _ending(None)


@contextmanager
def _ending(end: tuple[float, float] | None) -> Iterator[None]:
    token = _END.set(end)
    try:
        yield
    finally:
        _END.reset(token)


# The time limit of the call that ran out of time before it had the answer that is certified; None where none did.
_UNFINISHED: ContextVar[float | None] = ContextVar("the time limit that has cut an answer short", default=None)


@contextmanager
def unfinished() -> Iterator[None]:
    """Tell the certificate, inside the block, that the time was up before the method had an answer.

    Its bounds then take as long again at most, and searches for the right answer are left out.
    """
    end = _END.get()
    token = _UNFINISHED.set(None if end is None else end[1])
    try:
        yield
    finally:
        _UNFINISHED.reset(token)


def seconds_of_unfinished() -> float | None:
    """Return the time limit that was over before the answer that is certified was found, else None."""
    return _UNFINISHED.get()


def seconds_left() -> float | None:
    """Return the seconds until the running call has to end, at least a microsecond; None without a limit."""
    end = _END.get()
    return None if end is None else max(end[0] - time.perf_counter(), 1e-6)


def time_is_up() -> bool:
    """Return whether the call that runs should have ended."""
    end = _END.get()
    return end is not None and time.perf_counter() > end[0]


def stated_limit(seconds: float | None) -> str:
    """Return in words the time limit of the call; outside of a call, of a step that was given these seconds."""
    end = _END.get()
    return f"{seconds if end is None else end[1]:g} s"


def refuse_late(what: str) -> None:
    """Raise NotConverged where the call that runs should have ended; `what` was to be done next."""
    end = _END.get()
    if end is not None and time.perf_counter() > end[0]:
        raise NotConverged(f"{STOPPED} of {stated_limit(None)}, before {what}")
