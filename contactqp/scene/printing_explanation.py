"""An explanation on a screen."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape

from contactqp.scene.explaining import shortened
from contactqp.scene.explanation import Explanation
from contactqp.scene.tables import MOST_ROWS, print_table


def print_explanation(console: Console, explanation: Explanation) -> None:
    """Unknowns, constraints, blocks."""
    console.print(f"[bold]{escape(explanation.title)}[/bold] (in {escape(explanation.units)})")
    console.print(escape(f"unknowns: {len(explanation.unknowns)}: {shortened(explanation.unknowns)}"))
    if explanation.fixed:
        console.print(escape(f"fixed: {len(explanation.fixed)}: {shortened(explanation.fixed)}"))
    for heading, rows in (("contacts", explanation.contacts), ("ties", explanation.ties)):
        console.print(f"{heading}: {len(rows)}")
        for row in rows[:MOST_ROWS]:
            console.print(escape(f"  {row}"))
    blocks = [[block.name, "included" if block.included else "left out", block.reason] for block in explanation.blocks]
    print_table(console, ["block", "", "why"], blocks)
