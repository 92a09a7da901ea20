"""What commands print, and the codes that they end with."""

from __future__ import annotations

import io
import json
import os
import sys
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from rich.console import Console

# Columns of a table that nobody looks at through a window.
WIDE = 200
# What launchers of MPI call the number of a process: OpenMPI, MPICH and Slurm.
LAUNCHERS = ("OMPI_COMM_WORLD_RANK", "PMI_RANK", "SLURM_PROCID")
NOT_MET, BAD_INPUT, NOT_INSTALLED, INTERRUPTED = 1, 2, 3, 130


def console(heard: bool = True) -> Console:
    """Return the console that tables go to; with `heard` False they are made and dropped."""
    from rich.console import Console

    if not heard:
        return Console(file=io.StringIO(), width=WIDE)
    if launched_rank() is not None:  # the launcher passes it on, whatever stands at its own end
        return Console(width=WIDE, highlight=False, force_terminal=False)
    # Into a pipe or a file there is no width to wrap at.
    return Console(width=None if sys.stdout.isatty() else WIDE, highlight=False)


def launched_rank() -> int | None:
    """The number of this process as its launcher has it; None without one."""
    found = (os.environ.get(name, "") for name in LAUNCHERS)
    return next((int(rank) for rank in found if rank.isdigit()), None)


def print_json(data: Any) -> None:
    """Plain data for programs."""
    click.echo(json.dumps(data, indent=2, default=str, allow_nan=False))


def complain(message: str) -> None:
    """One line on the standard error."""
    click.echo(f"contactqp: {' '.join(message.split())}", err=True)
