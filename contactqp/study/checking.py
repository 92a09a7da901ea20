"""`contactqp check`: which kind of problem a file holds, and what is printed of the verdict."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from contactqp.exchange.problem_files import is_of_matrices, is_problem_file, read_problem_with_ledger, read_tie_names
from contactqp.exchange.refusal import wrong
from contactqp.model.problem import ContactProblem
from contactqp.study.answer_check import AnswerVerdict, check_case, check_problem
from contactqp.study.check_options import CheckOptions, as_options
from contactqp.study.friction_check import ForcesVerdict, WorstContact, check_forces
from contactqp.study.friction_files import figures
from contactqp.study.friction_printing import MOST_CONTACTS, vector_text


def check_answer(problem: str, candidate: str, options: CheckOptions) -> ForcesVerdict | AnswerVerdict:
    """Judge an answer to a case file or to matrices, or forces for a file of FCLIB or Siconos.

    Raises
    ------
    SceneError, InvalidProblem, Unsupported, BackendMissing
        Of the files and options.
    """
    if Path(problem).is_dir() and not is_problem_file(problem):
        held = ", ".join(sorted(file.name for file in Path(problem).iterdir())[:5]) or "nothing"
        raise wrong(problem, "folder", "problem.json, or a file called stiffness or K", f"{held:.100}")
    if not is_problem_file(problem):
        return check_case(problem, candidate, options)
    if not is_of_matrices(problem):
        return check_forces(problem, candidate, options)
    stored, ledger = read_problem_with_ledger(problem)
    assert isinstance(stored, ContactProblem)
    return check_problem(stored, ledger, candidate, options, read_tie_names(problem))


def print_check(console: Console, verdict: ForcesVerdict | AnswerVerdict) -> None:
    """Right or wrong, why, the worst contacts with right values beside, and what was read."""
    word = "[green]right[/green]" if verdict.passed else "[red]WRONG[/red]"
    console.print(f"{escape(verdict.candidate_file)}: {word} (tolerance {verdict.certificate.tolerance:g})")
    if isinstance(verdict, AnswerVerdict) and not verdict.passed:
        _print_lines(console, [f"  {as_options(verdict.certificate.diagnosis)}"])
    for name, value in figures(verdict.certificate).items():
        console.print(f"  {name.replace('_', ' ')}: {value:.3g}")
    _print_lines(console, [f"  wrong: {failure}" for failure in verdict.certificate.failures])
    _print_lines(console, [f"  note: {note}" for note in (*verdict.notes, *verdict.certificate.notes)])
    if isinstance(verdict, ForcesVerdict):
        _print_forces(console, verdict)
    elif not verdict.passed:
        _print_lines(console, [verdict.certificate.table(MOST_CONTACTS)])
    if verdict.why_not is not None:
        _print_lines(console, [f"no right values to set beside: {verdict.why_not}"])
    for ledger in verdict.ledgers:
        _print_lines(console, [ledger.source, *(f"  {kind}: {line}" for kind, line in ledger)])


def _print_lines(console: Console, lines: Sequence[str]) -> None:
    """As they are: no markup, no line broken."""
    for line in lines:
        console.print(escape(line), soft_wrap=True)


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


def _print_table(console: Console, header: list[str], rows: list[list[str]]) -> None:
    if not rows:
        return
    table = Table(*header, box=box.SIMPLE, pad_edge=False)
    for row in rows[:MOST_CONTACTS]:
        table.add_row(*row)
    console.print(table)
    if len(rows) > MOST_CONTACTS:
        console.print(f"... and {len(rows) - MOST_CONTACTS} more contacts (--json has all)")
