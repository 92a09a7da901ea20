"""Print the output of commands and determine exit codes, also on several ranks, and complete arguments for the shell.

On several ranks one of them prints, and all end with the same code. A rank that fails while the others wait in a
collective operation would leave them waiting. Therefore every rank calls `Speakers.settle` at its end. A failed rank
waits there for a moment, as the others may have failed too; if they do not arrive, it prints its error and aborts them
by MPI.
"""

from __future__ import annotations

import glob
import io
import json
import math
import os
import shutil
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import click
from click.shell_completion import CompletionItem

from contactqp.errors import InvalidProblem, StartWarning
from contactqp.linalg.runtime import SERIAL

if TYPE_CHECKING:
    from rich.console import Console

    from contactqp.distributed.ranks import Ranks

# Width of what is printed to a file or a pipe, unless COLUMNS says otherwise [columns].
NARROW = 80
# The width for exact numbers, whose digits stay in one line.
OF_EXACT_NUMBERS = 200
# Environment variables with the number of a process under launchers of MPI: OpenMPI, MPICH and Slurm.
LAUNCHERS = ("OMPI_COMM_WORLD_RANK", "PMI_RANK", "SLURM_PROCID")
NOT_MET, BAD_INPUT, NOT_INSTALLED, INTERRUPTED = 1, 2, 3, 130


def console(heard: bool = True, terminal: bool | None = None, piped: int = NARROW) -> Console:
    """Return the console that tables are printed to; with `heard` False the output is discarded.

    `terminal` states whether the process that finally prints has a terminal, where that is another one. `piped` is the
    width of output without a terminal, unless COLUMNS is set.
    """
    from rich.console import Console

    if terminal is not None:
        return Console(file=io.StringIO(), width=_width(terminal), highlight=False, force_terminal=terminal)
    if not heard:
        return Console(file=io.StringIO(), width=NARROW)
    if launched_rank() is not None:  # the launcher forwards it, terminal or not
        return Console(width=_width(False), highlight=False, force_terminal=False)
    return Console(width=None if sys.stdout.isatty() else _width(False, piped), highlight=False)


def _width(terminal: bool, piped: int = NARROW) -> int:
    """Return the width of output [columns]: that of COLUMNS if it is set, else of the terminal, else a fixed one."""
    stated = os.environ.get("COLUMNS", "")
    if terminal or (stated.isdigit() and int(stated)):
        return shutil.get_terminal_size((NARROW, 24)).columns
    return piped


def launched_rank() -> int | None:
    """Return the rank of this process according to its launcher, None without one."""
    found = (os.environ.get(name, "") for name in LAUNCHERS)
    return next((int(rank) for rank in found if rank.isdigit()), None)


def print_json(data: Any) -> None:
    """Print plain data as JSON, with null for numbers that are not finite doubles."""
    try:
        text = json.dumps(data, indent=2, default=str, allow_nan=False)
    except ValueError:  # such as the energy of an answer of 1e200
        text = json.dumps(_in_range(data), indent=2, default=str, allow_nan=False)
    click.echo(text)


def _in_range(data: Any) -> Any:
    """Return the data with None in place of infinite and undefined numbers."""
    if isinstance(data, dict):
        return {name: _in_range(value) for name, value in data.items()}
    if isinstance(data, list | tuple):
        return [_in_range(value) for value in data]
    return None if isinstance(data, float) and not math.isfinite(data) else data


def complain(message: str) -> None:
    """Print a message as one line on the standard error."""
    click.echo(f"contactqp: {' '.join(message.split())}", err=True)


def print_error(message: str, code: str, ending: int) -> None:
    """Print, as JSON, an error that ends a command: its line, its kind and the exit code.

    If it cannot be written, only the line on the standard error remains.
    """
    try:
        print_json({"error": " ".join(message.split()), "code": code, "exit": ending})
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


# Seconds until a command shows its progress, and between two updates.
LONG, BETWEEN = 2.0, 0.2


@contextmanager
def whereabouts() -> Iterator[Callable[[str], None] | None]:
    """Yield a function that shows the progress in one line of the standard error, which is erased at the end.

    Fast work shows nothing. None is yielded where the standard error is not a terminal.
    """
    if not sys.stderr.isatty():
        yield None
        return
    begun, shown = time.monotonic(), [0.0]

    def show(text: str) -> None:
        now = time.monotonic()
        if now - begun >= LONG and now - shown[0] >= BETWEEN:
            shown[0] = now
            line = f"{now - begun:.0f} s: {text}"[: shutil.get_terminal_size().columns - 1]
            click.echo(f"\r\x1b[K{line}", nl=False, err=True, color=True)

    try:
        yield show
    finally:
        if shown[0]:
            click.echo("\r\x1b[K", nl=False, err=True, color=True)


def refuse_doubts(_: click.Context, __: click.Parameter, strict: bool) -> bool:
    """Make doubtful starts of contacts errors where --strict is set (a callback of click)."""
    if strict:
        warnings.simplefilter("error", StartWarning)
    return strict


strict_option = click.option(
    "--strict",
    is_flag=True,
    expose_value=False,
    callback=refuse_doubts,
    help="Refuse contacts that start deep inside of what they touch, or are turned the wrong way.",
)


def read_unit_names(_: click.Context, __: click.Parameter, given: str | None) -> dict[str, str] | None:
    """Return the units that ``mm,N`` names."""
    names = None if given is None else [name.strip() for name in given.split(",")]
    if names is not None and (len(names) != 2 or not all(names)):
        raise InvalidProblem(f"--units: expected LENGTH,FORCE, such as mm,N, got {given!r}")
    return None if names is None else {"length": names[0], "force": names[1]}


def units_option(of: str) -> Callable[[Any], Any]:
    """Return the option --units of a command."""
    told = f'What the units of {of} are called, such as "mm,N".'
    return click.option("--units", metavar="LENGTH,FORCE", callback=read_unit_names, help=told)


T = TypeVar("T")
# Seconds within which ranks that fail together are expected; higher ranks wait longer, so that only one prints.
GRACE, APART, MOST_APART = 2.0, 0.1, 10
# Seconds between two checks whether all ranks have arrived.
PAUSE = 0.01
# PETSc's error code where it gets no memory, and the function that allocates it, whatever code it fails with.
PETSC_MEMORY, PETSC_ALLOCATION = 55, "PetscMalloc"


@dataclass(frozen=True)
class Ending:
    """How one rank ends: its exit code, and the message to be printed, if any."""

    code: int
    message: str = ""
    traceback: str = ""  # where the cause is a bug
    error: str = ""  # what kind of error it is, for programs


class Speakers:
    """The ranks of this run, of which one prints, once an engine with several ranks is used."""

    def __init__(self) -> None:
        self.forget()

    def forget(self, as_json: bool = False) -> None:
        """Begin another command, which runs in this process alone until it asks for an engine.

        With `as_json` an error that ends it is printed as JSON as well.
        """
        self.asked, self.as_json = False, as_json
        self._ranks: Ranks | None = None
        self._closing: Any = None  # a communicator of its own for the end of the run

    def start(self, engine: str) -> None:
        """Start MPI if the engine needs it.

        Raises
        ------
        BackendMissing
            PETSc or mpi4py is not installed.
        """
        if engine == SERIAL:
            return
        self.asked = True
        from contactqp.distributed.ranks import Ranks

        self._ranks = Ranks()
        self._closing = self._ranks.comm.Dup()

    @property
    def speaks(self) -> bool:
        """Return whether this process prints and writes the results of all ranks."""
        return self._ranks is None or self._ranks.rank == 0

    def together(self) -> AbstractContextManager[None]:
        """Return a context in which an error of one rank is raised on all."""
        return nullcontext() if self._ranks is None else self._ranks.raising_together()

    def by_first(self, action: Callable[[], T]) -> T:
        """Return the result of an action of the first rank on all ranks; its errors are raised on all."""
        return action() if self._ranks is None else cast(T, self._ranks.broadcast(self._ranks.on_first_rank(action)))

    def settle(self, ending: Ending) -> int:
        """Print the messages once and return the exit code of all ranks, or abort the ranks that do not arrive."""
        if self._ranks is None:
            self._settle_unstarted(ending)
            return ending.code
        self.meet(ending)
        endings: list[Ending] = self._closing.allgather(ending)
        failed = [number for number, other in enumerate(endings) if other.message]
        if not failed:
            return max(other.code for other in endings)
        if self._ranks.rank == failed[0]:
            same = all(other.message == ending.message for other in endings)
            _say(ending, None if same else failed[0])
        return endings[failed[0]].code

    def meet(self, ending: Ending) -> None:
        """Wait for all ranks; a rank with a message aborts them if they do not arrive soon."""
        if self._ranks is None:
            return
        rank, arrived = self._ranks.rank, self._closing.Ibarrier()
        until = time.monotonic() + GRACE + APART * min(rank, MOST_APART)
        while not arrived.Test():
            if ending.message and time.monotonic() > until:
                _say(ending, rank)
                self._ranks.comm.Abort(ending.code)
            time.sleep(PAUSE)

    def _settle_unstarted(self, ending: Ending) -> None:
        """Print the message of a rank where MPI was not started, so that ranks cannot agree."""
        rank = leave_to_the_first() if self.asked else 0
        if ending.message:
            _say(ending, rank or None)


def leave_to_the_first() -> int:
    """Wait, on other ranks than the first, until the launcher has ended them with it; return the rank if it has not."""
    rank = launched_rank() or 0
    if rank:
        time.sleep(GRACE)
    return rank


def explained(error: Exception) -> str:
    """Return one line about an exception that is not a ContactQPError."""
    lines = str(error).strip().splitlines()
    if type(error).__module__.startswith("petsc4py"):
        reason = lines[-1].partition("] ")[2] or lines[-1]  # the innermost one is last, after its rank
        full = getattr(error, "ierr", None) == PETSC_MEMORY or PETSC_ALLOCATION in str(error)
        return f"out of memory: PETSc, {reason}" if full else f"PETSc: {reason}"
    if isinstance(error, MemoryError):
        return "out of memory" + (f": {lines[0]}" if lines else "")
    return f"{type(error).__name__}: {lines[0] if lines else 'no reason given'}"


def _say(ending: Ending, rank: int | None) -> None:
    if ending.traceback:
        print(ending.traceback, file=sys.stderr)
    complain(ending.message if rank is None else f"rank {rank}: {ending.message}")
    if speakers.as_json and ending.error:
        print_error(ending.message, ending.error, ending.code)
    for stream in (sys.stdout, sys.stderr):
        stream.flush()


speakers = Speakers()


def complete_case(_context: click.Context, _parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Return the shipped cases, files and folders whose name begins with `begun`, for completion by the shell."""
    from contactqp.scene.shipped import shipped_files

    names = [file.stem for file in shipped_files() if file.stem.startswith(begun)]
    files = [f"{file}/" if Path(file).is_dir() else file for file in sorted(glob.glob(f"{glob.escape(begun)}*"))]
    return [CompletionItem(name) for name in dict.fromkeys([*files, *names])]


def complete_method(_context: click.Context, _parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Return the methods whose name begins with `begun`, for completion by the shell."""
    from contactqp.solving.methods import methods

    return [CompletionItem(method.name) for method in methods() if method.name.startswith(begun)]
