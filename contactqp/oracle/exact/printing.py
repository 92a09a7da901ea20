"""Exact answers as tables, as text and as data for any language."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from contactqp.oracle.exact.decimals import (
    cut,
    nearest,
    number_data,
    ratio,
)
from contactqp.oracle.exact.exact_solution import ExactSolution, Fractions, remarks, shown_at

if TYPE_CHECKING:
    from rich.console import Console

# A table of more unknowns is read by nobody.
MOST_SHOWN = 200
SIGNS = (
    "K u + E_N'l_N + E_T'l_T + A'nu = f; normal_force l_N is positive in compression; gap = g - E_N u is positive when "
    "open; slip = E_T u - slip_origin, and friction_force l_T is what the body does to the obstacle, along its slip; "
    "tie_force is nu"
)


def answer_data(answer: ExactSolution, ties: Sequence[str], title: str = "") -> dict[str, Any]:
    """All of it, for JSON; numbers that are exact are text "p/q", doubles are the nearest to them."""
    problem, radius = answer.problem, answer.radius

    def entry(name: str, *place: int) -> dict[str, Any]:
        off = None if radius is None else float(getattr(radius, name)[place])
        return number_data(getattr(answer, name)[place], off)

    def entries(name: str, i: int) -> list[dict[str, Any]] | None:
        values: Fractions | None = getattr(answer, name)
        return None if values is None else [entry(name, i, axis) for axis in range(values.shape[1])]

    return {
        "format": "contactqp exact answer",
        "version": 1,
        "title": title,
        "rational": answer.rational,
        "signs": SIGNS,
        "units": {"length": problem.units.length, "force": problem.units.force},
        "unknowns": [
            {"name": problem.dof_name(j), "displacement": entry("displacement", j)} for j in range(problem.dimension)
        ],
        "contacts": [
            {
                "name": problem.contact_name(i),
                "status": answer.contact_status[i],
                "normal_force": entry("normal_force", i),
                "force_range": None if radius else [None if x is None else ratio(x) for x in answer.force_range[i]],
                "friction_force": entries("friction_force", i),
                "gap": entry("gap", i),
                "slip": entries("slip", i),
            }
            for i in range(problem.contacts)
        ],
        "ties": [{"name": name, "tie_force": entry("tie_force", k)} for k, name in enumerate(ties)],
        "unique_forces": answer.unique_forces,
        "energy": None if answer.energy is None else number_data(answer.energy, None),
        "equilibria": answer.equilibria,
        "uniqueness": list(answer.uniqueness),
        "free_motions": [str(motion) for motion in answer.free_motions],
        "events": [
            {"kind": event.kind, "contact": event.name, "time": number_data(event.time, None)}
            for event in answer.events
        ],
        "data": answer.data,
        "way": answer.way,
        "proof": list(answer.proof),
        "notes": list(answer.notes),
        "method": answer.method,
        "seconds": answer.seconds,
    }


def print_answer(console: Console, answer: ExactSolution, ties: Sequence[str], title: str) -> None:
    """Tables of unknowns, contacts, ties and events."""
    from rich.table import Table

    problem, length, force = answer.problem, answer.problem.units.length, answer.problem.units.force
    console.print(f"{title}: {'exact' if answer.rational else 'enclosed'}, of {answer.data}", markup=False)

    def show(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        if rows:
            table = Table(*heads, box=None, pad_edge=True)
            for row in rows:
                table.add_row(*row)
            console.print(table, markup=False)

    number = "exact" if answer.rational else "mid +- radius"
    if problem.dimension <= MOST_SHOWN:
        show(
            ["unknown", f"displacement{_in(length)}", number],
            [[problem.dof_name(j), *_pair(answer, "displacement", j)] for j in range(problem.dimension)],
        )
    else:
        console.print(f"{problem.dimension} displacements are not shown; --json has them", markup=False)
    rubs = answer.friction_force is not None
    heads = ["contact", "status", f"normal force{_in(force)}", number, f"gap{_in(length)}"]
    heads += [f"friction force{_in(force)}"] if rubs else []
    heads += [] if answer.unique_forces else ["range"]
    rows = []
    for i, word in enumerate(answer.contact_status):
        row = [problem.contact_name(i), word, *_pair(answer, "normal_force", i), shown_at(answer, "gap", i)]
        if answer.friction_force is not None:
            row.append(
                ", ".join(shown_at(answer, "friction_force", i, w) for w in range(answer.friction_force.shape[1]))
            )
        if not answer.unique_forces:
            row.append(" to ".join("unbounded" if x is None else cut(ratio(x)) for x in answer.force_range[i]))
        rows.append(row)
    show(heads, rows)
    show(
        ["tie", f"force{_in(force)}", number],
        [[name, *_pair(answer, "tie_force", k)] for k, name in enumerate(ties)],
    )
    show(["event", "contact", "time"], [[event.kind, event.name, cut(ratio(event.time))] for event in answer.events])
    for line in answer.proof:
        console.print(f"proven: {line}", markup=False)
    for line in remarks(answer):
        console.print(line, markup=False)


def _in(unit: str) -> str:
    return f" [{unit}]" if unit else ""


def _pair(answer: ExactSolution, name: str, *place: int) -> tuple[str, str]:
    x: Fraction = getattr(answer, name)[place]
    return f"{nearest(x):.17g}", shown_at(answer, name, *place)
