"""A footprint measured in a fresh interpreter, where nothing else is in it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys

from contactqp.study.footprint.footprint import Footprint

CHILD = "contactqp.study.footprint.child"


def measure(case: str | os.PathLike[str], method: str = "active-set", time_limit: float | None = None) -> Footprint:
    """What a case takes from its file to its certified answer.

    Parameters
    ----------
    case : path
        A case file.
    method : str
        A name of `contactqp.methods()` that needs no knob.
    time_limit : float, optional
        Seconds; what takes longer is stopped.

    Returns
    -------
    Footprint
        Its `failure` says in one line why there is no answer: what the error of the package says, the signal that
        ended the process, that it took too long.
    """
    known = (str(case), method)
    command = [sys.executable, "-P", "-m", CHILD, *known]  # -P: no modules from the folder that it is run in
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=time_limit,
            env=_environment(),
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Footprint(*known, failure=f"stopped after {time_limit:g} s")
    except OSError as error:
        return Footprint(*known, failure=f"no process could be started: {error.strerror or error}")
    if done.returncode:
        return Footprint(*known, failure=_ending(done.returncode, done.stderr))
    try:
        return Footprint.from_data(json.loads(done.stdout.splitlines()[-1]))  # libraries may have said something
    except (IndexError, ValueError, TypeError, KeyError):
        return Footprint(*known, failure="the process that measured said nothing that can be read")


def _environment() -> dict[str, str]:
    """This process's, modules looked for where it does."""
    return os.environ | {"PYTHONPATH": os.pathsep.join(folder or os.getcwd() for folder in sys.path)}


def _ending(code: int, said: str) -> str:
    """How a process ended that did not end well."""
    if code < 0:
        try:
            name = signal.Signals(-code).name
        except ValueError:
            name = f"signal {-code}"
        return f"the process died of {name}"
    last = said.strip().splitlines()[-1:] or [f"exit code {code}"]
    return f"the process ended early: {last[0]}"
