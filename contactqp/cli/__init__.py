"""The command line: arguments and exit codes. Each command imports what it needs when it is called."""

from __future__ import annotations

import _thread
import gc
import os
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NoReturn

import click

from contactqp.cli.judging import check_command, crosscheck_command, explain_command, oracle_command
from contactqp.cli.output import (
    BAD_INPUT,
    INTERRUPTED,
    NOT_INSTALLED,
    NOT_MET,
    Ending,
    complain,
    explained,
    leave_to_the_first,
    print_error,
    speakers,
)
from contactqp.cli.solving import run_command
from contactqp.cli.surveying import (
    cases_command,
    export_command,
    gallery_command,
    init_command,
    methods_command,
    report_command,
    schema_command,
)
from contactqp.errors import (
    BackendMissing,
    ContactQPError,
    InvalidProblem,
    SceneError,
    StartWarning,
    Unsupported,
    one_line,
)

# Seconds after which a Ctrl-C that was ignored is repeated.
ONCE_MORE = 0.05


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="contactqp", prog_name="contactqp")
def command() -> None:
    """Contact problems as energy minimisation with inequality constraints, every answer certified."""


for _command in (
    run_command,
    check_command,
    crosscheck_command,
    explain_command,
    oracle_command,
    methods_command,
    cases_command,
    init_command,
    schema_command,
    report_command,
    gallery_command,
    export_command,
):
    command.add_command(_command)


def _exit_code(error: ContactQPError) -> int:
    if isinstance(error, BackendMissing):
        return NOT_INSTALLED
    return BAD_INPUT if isinstance(error, SceneError | InvalidProblem | Unsupported) else NOT_MET


def _insist(ignored: sys.UnraisableHookArgs) -> None:
    """Repeat a Ctrl-C that Python ignored, as it does in a callback of an import."""
    if issubclass(ignored.exc_type, KeyboardInterrupt):
        # It is repeated from another thread, as it would be ignored here again.
        threading.Timer(ONCE_MORE, _thread.interrupt_main).start()
    else:
        sys.__unraisablehook__(ignored)


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line, on `sys.argv` by default; every error of contactqp is one line and an exit code.

    With --json it is an object on the standard output as well: `error`, the line; `code`, its kind; `exit`.
    """
    if sys.stderr is None:  # the parent process closed it
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115  for as long as the process lives
    if sys.stdout is None:
        print("contactqp: the standard output is closed", file=sys.stderr)
        sys.exit(2)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # names in a case may hold letters that the terminal cannot show
            stream.reconfigure(errors="replace")
    if sys.unraisablehook is sys.__unraisablehook__:
        sys.unraisablehook = _insist
    speakers.forget("--json" in (sys.argv[1:] if arguments is None else arguments))
    _keep_for_good(arguments)
    printed, sys.stdout = sys.stdout, _WhileRead(sys.stdout)
    try:
        code = speakers.settle(_ended(arguments))
        sys.stdout.flush()
    finally:
        sys.stdout = printed
    _keep_for_good(arguments)
    sys.exit(code)


class _WhileRead:
    """A standard output that stays usable when its reader closes the pipe, so that the exit code does not change."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        try:
            return int(self._stream.write(text))
        except BrokenPipeError:
            self._go_on_unread()
            return len(text)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except BrokenPipeError:
            self._go_on_unread()

    def _go_on_unread(self) -> None:
        os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())


def _keep_for_good(arguments: Sequence[str] | None) -> None:
    """Exclude all existing objects from garbage collection in the process of a command, which ends soon.

    Scanning all imported classes and functions, at the latest when Python ends, takes a quarter of the time of a small
    command.
    """
    if arguments is None:
        gc.freeze()


INTERRUPTION = Ending(INTERRUPTED, "interrupted", error="interrupted")


def _interrupted(error: BaseException | None) -> bool:
    """Return whether a Ctrl-C caused an error, as when the import of a compiled module is interrupted."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _ended(arguments: Sequence[str] | None) -> Ending:
    """Run the command, and return its ending in this process."""
    with warnings.catch_warnings():
        told: set[str] = set()
        warnings.simplefilter("always", StartWarning)
        warnings.showwarning = partial(_warn, warnings.showwarning, told)
        return _run(arguments)


def _warn(others: Callable[..., None], told: set[str], message: Warning | str, kind: type[Warning], *more: Any) -> None:
    """Print each warning about the start of a contact once, as one line; other warnings are left to Python."""
    if not issubclass(kind, StartWarning):
        others(message, kind, *more)
    elif str(message) not in told and speakers.speaks:
        told.add(str(message))
        complain(f"warning: {message}")


def _run(arguments: Sequence[str] | None) -> Ending:
    try:
        command(arguments, prog_name="contactqp", standalone_mode=False)
    except SystemExit as end:
        return Ending(end.code if isinstance(end.code, int) else 0)
    except ContactQPError as error:
        return INTERRUPTION if _interrupted(error) else Ending(_exit_code(error), str(error), error=error.code)
    except StartWarning as doubt:  # by --strict
        return Ending(BAD_INPUT, str(doubt), error="start")
    except click.ClickException as error:
        leave_to_the_first()
        error.show()
        if speakers.as_json:
            print_error(error.format_message(), "usage", BAD_INPUT)
        return Ending(BAD_INPUT)
    except (click.Abort, KeyboardInterrupt):
        return INTERRUPTION
    except BrokenPipeError:  # the reader closed the pipe, as in `contactqp methods | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:  # a name too long, no permission, a full disk
        return Ending(BAD_INPUT, one_line(f"{error.filename or 'file'}: {error.strerror or error}"), error="file")
    except Exception as error:
        if _interrupted(error):
            return INTERRUPTION
        if isinstance(error, MemoryError) and not speakers.asked:
            return Ending(NOT_MET, f"{explained(error)}; a coarser mesh takes less", error="memory")
        if not speakers.asked:
            raise
        # The other ranks wait for this one, which must not end before they are told.
        bug = not isinstance(error, MemoryError | RuntimeError)  # PETSc's errors are RuntimeErrors
        return Ending(NOT_MET, explained(error), traceback.format_exc() if bug else "", "bug" if bug else "engine")
    return Ending(0)
