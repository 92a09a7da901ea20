"""What commands print, and the codes that they end with."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from rich.console import Console

NOT_MET, BAD_INPUT, NOT_INSTALLED, INTERRUPTED = 1, 2, 3, 130


def console() -> Console:
    """Where tables go."""
    from rich.console import Console

    # Into a pipe or a file there is no width to wrap at.
    return Console(width=None if sys.stdout.isatty() else 200, highlight=False)


def print_json(data: Any) -> None:
    """Plain data for programs."""
    click.echo(json.dumps(data, indent=2, default=str, allow_nan=False))


def complain(message: str) -> None:
    """One line on the standard error."""
    click.echo(f"contactqp: {' '.join(message.split())}", err=True)
