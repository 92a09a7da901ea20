"""What the tab key offers in a shell: names of cases, files, names of methods."""

from __future__ import annotations

import glob
from pathlib import Path

import click
from click.shell_completion import CompletionItem


def complete_case(_context: click.Context, _parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Return the names of shipped cases, and the files and folders here, that begin so."""
    from contactqp.scene.shipped import shipped_files

    names = [file.stem for file in shipped_files() if file.stem.startswith(begun)]
    files = [f"{file}/" if Path(file).is_dir() else file for file in sorted(glob.glob(f"{glob.escape(begun)}*"))]
    return [CompletionItem(name) for name in dict.fromkeys([*files, *names])]


def complete_method(_context: click.Context, _parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Return the names of methods that begin so."""
    from contactqp.solving.methods import methods

    return [CompletionItem(method.name) for method in methods() if method.name.startswith(begun)]
