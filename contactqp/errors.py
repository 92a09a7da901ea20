"""The exceptions of the package. Every message states what was expected, what came, and where.

Errors may carry a solution, a candidate or a history of any class; this module imports nothing of the package.
"""

from __future__ import annotations

import os
import re
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from decimal import Decimal
from numbers import Number
from pathlib import Path
from reprlib import Repr
from typing import Any


class ContactQPError(Exception):
    """The base class of all errors of contactqp; pickling and copying keep their attributes.

    `code` names the kind of error in one word, which does not change between versions and is printed by `--json`.
    `history` is the completed part of a load path or motion that failed.
    """

    code = "error"
    history: Sequence[Any] = ()

    def __init__(self, message: object = "", *others: object) -> None:
        super().__init__(one_line(message) if isinstance(message, str) else message, *others)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the class, message and attributes from which pickle and copy restore the error.

        By default an exception is restored by calling its class with the message alone. Where the class takes more
        arguments this fails in the receiving process, and a `multiprocessing.Pool` then waits for ever.
        """
        return _made_again, (type(self), self.args), *super().__reduce__()[2:]


class InvalidProblem(ContactQPError, ValueError):
    """The data are not a contact problem: wrong shape, NaN, asymmetric or indefinite stiffness, negative friction."""

    code = "invalid-problem"


class WrongCall(InvalidProblem, TypeError):
    """A call that does not fit the function's signature: an unknown, surplus or missing argument."""


class SceneError(ContactQPError, ValueError):
    """A case file or a scene is wrong; the message names file, key and what was expected."""

    code = "invalid-scene"


class NoEquilibrium(ContactQPError):
    """No displacement satisfies the constraints, or the load drives a motion that nothing holds back.

    `proof` is a `contactqp.linalg.existence.Conflict` or `DrivenMotion` where one vector proves it, else None.
    """

    code = "no-equilibrium"

    def __init__(self, message: str, proof: Any = None) -> None:
        super().__init__(message)
        self.proof = proof


class SeveralEquilibria(ContactQPError):
    """Coulomb friction allows more than one answer and one was asked for; the message lists them."""

    code = "several-equilibria"


class NotConverged(ContactQPError):
    """A method stopped before it had an answer; `history` records its iterations, `solution` is its last iterate if
    any.

    For a path or a motion, `history` is its completed part, a `History`.
    """

    code = "not-converged"

    def __init__(
        self,
        message: str,
        history: Sequence[Any] = (),
        solution: Any = None,
    ) -> None:
        super().__init__(message)
        self.history = history
        self.solution = solution


class NotCertified(ContactQPError):
    """A method that promises the exact answer returned one that the certificate refuses; `solution` is that answer."""

    code = "not-certified"

    def __init__(self, message: str, solution: Any) -> None:
        super().__init__(message)
        self.solution = solution


class BackendMissing(ContactQPError, ImportError):
    """An optional package is not installed; the message gives the pip command."""

    code = "backend-missing"


class BackendFailed(ContactQPError):
    """A backend raised an exception of its own (chained as the cause), or returned nothing usable."""

    code = "backend-failed"

    def __init__(self, message: str, candidate: Any = None) -> None:
        super().__init__(message)
        self.candidate = candidate


@contextmanager
def of_backend(name: str) -> Iterator[None]:
    """Raise BackendFailed for whatever a backend raises in the block, but not for Ctrl-C, an exit or lack of memory.

    Backends raise arbitrary exceptions, including panics of Rust, which are not derived from Exception, and qpsolvers
    raises an error of its own in place of a Ctrl-C, which is then its cause.
    """
    try:
        yield
    except BaseException as error:
        cause: BaseException | None = error
        while cause is not None:
            if isinstance(cause, KeyboardInterrupt | SystemExit | MemoryError):
                raise cause from None
            cause = cause.__cause__
        raise BackendFailed(f"{name}: {type(error).__name__}: {error}") from error


class Unsupported(ContactQPError):
    """The method or feature exists but does not support this; the message names both."""

    code = "unsupported"


# Files of memory limits of control groups (versions 2 and 1): the folder, the limit, the usage, and the name of the
# reclaimable file cache in it.
_GROUPS = (
    ("/sys/fs/cgroup", "memory.max", "memory.current", "inactive_file"),
    ("/sys/fs/cgroup/memory", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
)


def free_memory() -> int | None:
    """Return the bytes of memory available without swapping, within the limits of process and group.

    None if the system does not report it.
    """
    limits = (_available(), *(_left_of(*group) for group in _GROUPS), _left_of_address_space())
    return min((left for left in limits if left is not None), default=None)


def _available() -> int | None:
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        return next((1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:")), None)
    except (OSError, ValueError):
        return None


def _left_of(folder: str, limit: str, used: str, cached: str) -> int | None:
    def read(name: str) -> str:
        return Path(folder, name).read_text(encoding="ascii").strip()

    try:
        most = read(limit)
        if most == "max":
            return None
        parts = dict(line.split() for line in read("memory.stat").splitlines())
        return max(int(most) - int(read(used)) + int(parts.get(cached, 0)), 1)
    except (OSError, ValueError):
        return None


def _left_of_address_space() -> int | None:
    """Return the address space that `ulimit -v` leaves [bytes]."""
    try:
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        return None if limit == resource.RLIM_INFINITY else max(limit - pages * resource.getpagesize(), 1)
    except (ImportError, OSError, ValueError):
        return None


def out_of_memory(error: MemoryError) -> Unsupported:
    """Return the refusal of what memory does not hold: what was needed, what is free, and the cure."""
    needed, free = str(error).partition("\n")[0] or "an array could not be allocated", free_memory()
    left = "" if free is None else f", {free / 2**30:.1f} GiB are free"
    return Unsupported(f"memory is full: {needed}{left}: free memory, or take fewer contacts or a coarser mesh")


class StartWarning(UserWarning):
    """A contact starts deep inside of what it may touch, or is turned the wrong way; the message names the cure."""


class TimeStepWarning(UserWarning):
    """The time step of a motion is too long for its contacts; the message states the step and the time to resolve."""


def warn(message: str, category: type[Warning]) -> None:
    """Issue a warning that points to the line of the caller outside of this package."""
    package = os.path.dirname(__file__) + os.sep
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and frame.f_code.co_filename.startswith(package):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, category, stacklevel=level)


def _made_again(kind: type[ContactQPError], args: tuple[Any, ...]) -> ContactQPError:
    """Return an exception without its attributes, which pickle sets afterwards."""
    error = kind.__new__(kind, *args)
    if isinstance(error, ImportError):  # ImportError stores its message separately
        ImportError.__init__(error, *args)
    return error


# What to do with a value of another type, by the name of that type.
CURES = {
    "Surface": "; two bodies are paired by pair_mortar(slave, master) or pair_node_to_segment(slave, master)",
    "Scene": "; contactqp.run(scene) solves a scene, scene.problem() is its problem",
    "str": "; contactqp.run(file) solves a case file, contactqp.read_problem(file) reads matrices and programs",
    "System": "; system.problem(contacts) is the problem of these bodies",
    "Structure": "; structure.assemble(supports, loads).problem(contacts) is the problem of these bodies",
    "ConstrainedEnergy": "; energy.solve() finds its minimum, energy.problem is its ContactProblem",
    "ndarray": "; contactqp.ContactProblem(stiffness=, load=, normal=, gap=) is a problem of matrices",
    "Problem": "; contactqp.ContactProblem.from_qp takes the arrays of a quadratic program",
}


def refuse_other(who: str, value: object, *kinds: type) -> None:
    """Raise InvalidProblem unless a value is an instance of one of the kinds."""
    if not isinstance(value, kinds):
        expected = " or ".join(kind.__name__ for kind in kinds)
        raise InvalidProblem(f"{who}: expected a {expected}, got {type(value).__name__}{cure_of(value)}")


def cure_of(value: object) -> str:
    """Return a hint on where a value of this type belongs."""
    return CURES.get("str" if isinstance(value, os.PathLike) else type(value).__name__, "")


# Words longer than any path or name are the user's data and are cut.
LONGEST_WORD = 300
_LINE_BREAKS, _LONG_WORDS = re.compile(r"\s*[\r\n]\s*"), re.compile(rf"\S{{{LONGEST_WORD + 1},}}")


def one_line(message: str) -> str:
    """Return a message without line breaks, and with the beginning of words that are longer than any path or name."""
    return _LONG_WORDS.sub(lambda word: word[0][:60] + "...", _LINE_BREAKS.sub(" ", message))


# Texts as long as a line, and the first entries of lists.
_BRIEF = Repr()
_BRIEF.maxstring = _BRIEF.maxother = _BRIEF.maxlong = 60
_BRIEF.maxlevel = 3
_AS_WRITTEN = (str, bytes, Number, Decimal, type(None), list, tuple, dict, set, frozenset)


def shown(value: object) -> str:
    """Return a value as a short text for messages: numbers and texts as Python writes them, else the type.

    >>> shown(0.5), shown([1, 2]), shown("x" * 100)[:12], shown(BackendMissing)
    ('0.5', '[1, 2]', "'xxxxxxxxxxx", 'the class BackendMissing')
    """
    if isinstance(value, type):
        return f"the class {value.__name__}"
    try:
        shape = getattr(value, "shape", None)
        if isinstance(shape, tuple) and shape:
            return f"{type(value).__name__} of shape {shape}"
        value = value.item() if shape == () and hasattr(value, "item") else value
        return " ".join(_BRIEF.repr(value).split()) if isinstance(value, _AS_WRITTEN) else type(value).__name__
    except Exception:  # noqa: BLE001  an integer of thousands of digits, objects whose own words fail
        return type(value).__name__


def counted(what: str, count: int) -> str:
    """Return a number with a noun in singular or plural.

    >>> counted("contact", 1), counted("contact", 2)
    ('1 contact', '2 contacts')
    """
    return f"{count} {what}{'s' * (count != 1)}"


def counts(**numbers: int) -> str:
    """Return several numbers with their nouns.

    >>> counts(unknown=3, contact=1)
    '3 unknowns, 1 contact'
    """
    return ", ".join(counted(what, count) for what, count in numbers.items())


# The names in this package of the symbols of textbooks, QP solvers and other codes, the most likely first.
SYMBOLS = {
    "K": ("stiffness",),
    "P": ("stiffness",),
    "k": ("stiffness",),
    "f": ("load",),
    "F": ("load",),
    "g": ("gap",),
    "h": ("gap",),
    "G": ("normal",),
    "E": ("normal", "modulus"),
    "E_N": ("normal",),
    "E_T": ("tangent",),
    "A": ("tie",),
    "b": ("tie_value",),
    "M": ("mass",),
    "m": ("mass",),
    "mu": ("friction",),
    "nu": ("poisson",),
    "rho": ("density",),
    "t": ("thickness",),
    "u": ("displacement",),
    "u0": ("displacement",),
    "v": ("velocity",),
    "v0": ("velocity",),
    "T": ("duration",),
    "dt": ("time_step",),
    "tol": ("tolerance",),
}


def no_argument(unknown: Sequence[str], names: Sequence[str]) -> str:
    """Return the message about unknown arguments of a function.

    >>> no_argument(["K"], ["stiffness", "load"])
    "no argument is called 'K' (do you mean 'stiffness'?)"
    """
    return f"no argument is called {' or '.join(map(repr, unknown))}{meant(unknown, names)}"


def meant(unknown: Sequence[str], names: Sequence[str]) -> str:
    """Return a text with the names nearest to unknown ones, or with all names where none is near.

    >>> meant(["norml"], ["load", "normal"]), meant(["xyz"], ["load", "normal"])
    (" (do you mean 'normal'?)", '; its arguments: load, normal')
    """
    from difflib import get_close_matches

    near = [
        one
        for name in unknown
        for one in [one for one in SYMBOLS.get(name, ()) if one in names][:1] or get_close_matches(name, names, n=1)
    ]
    if near:
        return f" (do you mean {' and '.join(map(repr, near))}?)"
    return f"; its arguments: {', '.join(names)}" if unknown else ""
