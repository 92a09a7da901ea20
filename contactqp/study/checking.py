"""`contactqp check`: which of the two kinds of problem a file holds, and what is printed of the verdict."""

from __future__ import annotations

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from contactqp.exchange.problem_files import is_problem_file
from contactqp.study.case_check import CaseVerdict, ContactComparison, check_case
from contactqp.study.friction_check import ForcesVerdict, WorstContact, check_forces
from contactqp.study.friction_files import figures
from contactqp.study.friction_printing import MOST_CONTACTS, vector_text


def check_answer(problem: str, candidate: str, tolerance: float = 1e-9) -> ForcesVerdict | CaseVerdict:
    """Judge an answer to a case file, or forces for a file of FCLIB or Siconos; raises as these."""
    return (check_forces if is_problem_file(problem) else check_case)(problem, candidate, tolerance)


def print_check(console: Console, verdict: ForcesVerdict | CaseVerdict) -> None:
    """Right or wrong, why, and the worst contacts with right values beside them."""
    word = "[green]right[/green]" if verdict.passed else "[red]WRONG[/red]"
    console.print(f"{escape(verdict.candidate_file)}: {word} (tolerance {verdict.certificate.tolerance:g})")
    for name, value in figures(verdict.certificate).items():
        console.print(f"  {name.replace('_', ' ')}: {value:.3g}")
    for failure in verdict.certificate.failures:
        console.print(escape(f"  wrong: {failure}"), soft_wrap=True)
    for note in (*verdict.notes, *verdict.certificate.notes):
        console.print(escape(f"  note: {note}"), soft_wrap=True)
    if isinstance(verdict, ForcesVerdict):
        _print_forces(console, verdict)
    else:
        _print_case(console, verdict)
    if verdict.why_not is not None:
        console.print(escape(f"no right values to set beside: {verdict.why_not}"), soft_wrap=True)


def _print_forces(console: Console, verdict: ForcesVerdict) -> None:
    header = ["contact", "wrong", "size", "force", "velocity"]
    header += ["right force", "right velocity"] if verdict.right is not None else []
    _print_table(console, header, [_forces_row(one) for one in verdict.worst])
    if verdict.right is not None:
        console.print(
            f"right values: one solution, by {verdict.right.method}; there are others where contacts are redundant or "
            "friction is large",
            soft_wrap=True,
        )


def _forces_row(one: WorstContact) -> list[str]:
    shown = [one.force, one.velocity]
    shown += [part for part in (one.right_force, one.right_velocity) if part is not None]
    return [escape(one.name), one.figure, f"{one.size:.3g}", *map(vector_text, shown)]


def _print_case(console: Console, verdict: CaseVerdict) -> None:
    unit = verdict.problem.units.force
    header = ["contact", f"normal force [{unit}]", f"right normal force [{unit}]"]
    if verdict.problem.frictional:
        header += [f"friction force [{unit}]", f"right friction force [{unit}]"]
    _print_table(console, [escape(text) for text in header], [_case_row(one) for one in verdict.worst])


def _case_row(one: ContactComparison) -> list[str]:
    rubbing = [part for part in (one.friction_force, one.right_friction_force) if part is not None]
    return [escape(one.name), f"{one.normal_force:.9g}", f"{one.right_normal_force:.9g}", *map(vector_text, rubbing)]


def _print_table(console: Console, header: list[str], rows: list[list[str]]) -> None:
    if not rows:
        return
    table = Table(*header, box=box.SIMPLE, pad_edge=False)
    for row in rows[:MOST_CONTACTS]:
        table.add_row(*row)
    console.print(table)
    if len(rows) > MOST_CONTACTS:
        console.print(f"... and {len(rows) - MOST_CONTACTS} more contacts (--json has all)")
