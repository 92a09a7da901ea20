"""The problems of the gallery as a table on a screen."""

from __future__ import annotations

from collections.abc import Sequence

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from contactqp.oracle.gallery.problem import GalleryProblem


def print_gallery(console: Console, problems: Sequence[GalleryProblem]) -> None:
    """One row a problem."""
    table = Table(box=box.SIMPLE, pad_edge=False)
    for title in ("name", "difficulty", "unknowns", "contacts", "ties", "forces", "problem"):
        table.add_column(title, no_wrap=title == "name", justify="right" if title.endswith("s") else "left")
    for known in problems:
        data = known.data
        sizes = [str(size) for size in (data.unknowns, data.contacts, len(data.tie))]
        forces = "unique" if known.unique_forces else "not unique"
        table.add_row(known.name, known.difficulty, *sizes, forces, escape(known.description))
    console.print(table)
