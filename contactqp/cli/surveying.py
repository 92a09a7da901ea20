"""Commands on many methods, cases or problems, and on case files: from methods and cases to report and gallery."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from contactqp.cli.output import complain, complete_case, console, print_json
from contactqp.errors import InvalidProblem

if TYPE_CHECKING:
    from contactqp.oracle.gallery.problem import GalleryProblem
    from contactqp.scene.shipped import ShippedCase


def print_gallery(console: Console, problems: Sequence[GalleryProblem]) -> None:
    """Print the problems of the gallery as a table."""
    from contactqp.scene.tables import print_noted

    rows, notes = [], []
    for problem in problems:
        data = problem.data
        sizes = [str(size) for size in (data.unknowns, data.contacts, len(data.tie))]
        rows.append([problem.name, problem.difficulty, *sizes, "unique" if problem.unique_forces else "not unique"])
        notes.append([problem.description])
    header = ["name", "difficulty", "unknowns", "contacts", "ties", "forces", "problem"]
    print_noted(console, header, rows, notes)


# Limit for one cell of a report [s].
TIME_LIMIT = 600.0


@click.command("methods", short_help="List the methods: what each can do, what is installed.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
def methods_command(as_json: bool) -> None:
    """List every method: what it can do, and whether it is installed or how to install it."""
    from contactqp.scene.tables import method_data, print_methods
    from contactqp.solving.methods import methods

    if as_json:
        print_json([method_data(method) for method in methods()])
    else:
        print_methods(console(), methods())


@click.command("cases", short_help="List the cases that come with contactqp.")
@click.argument("words", nargs=-1, metavar="[WORD...]")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
def cases_command(words: tuple[str, ...], as_json: bool) -> None:
    """List the cases that come with contactqp, or those in which every WORD stands.

    Of a single one, as of a case's name, it prints what the case is about and where its file is, too. `contactqp run
    NAME` runs a case, and `contactqp init FILE --like NAME` copies it.
    """
    from contactqp.scene.shipped import nearest_cases, nearest_words, shipped_cases

    found = shipped_cases(words)
    if not found and words:
        found, most = nearest_cases(words)
        if not found:
            near = nearest_words(words)
            cure = f"nearest: {', '.join(near)}" if near else "without words all are listed"
            raise InvalidProblem(f"cases: no case has a word of {' '.join(words)}; {cure}")
        complain(f"cases: no case has all of {' '.join(words)}; these have {most} of them")
    if as_json:
        print_json([{"name": case.name, "title": case.title, "file": str(case.file)} for case in found])
        return
    table = Table(box=box.SIMPLE, pad_edge=False)
    table.add_column("name", no_wrap=True)
    table.add_column("what it is")
    for case in found:
        table.add_row(case.name, escape(case.title))
    console().print(table)
    if len(found) == 1:
        _print_case(found[0])


def _print_case(case: ShippedCase) -> None:
    """Print what one case is about, where its file is, and what may be done with it."""
    if case.about:
        console().print(escape(case.about))
    console().print(f"file: {case.file}", soft_wrap=True, highlight=False, markup=False)
    console().print(f"contactqp run {case.name}; contactqp init my_case.toml --like {case.name}", soft_wrap=True)


@click.command("init", short_help="Write a first case with comments, or copy one.")
@click.argument("file", default="case.toml")
@click.option(
    "--like",
    metavar="CASE",
    shell_complete=complete_case,
    help="Copy a case that comes with contactqp, by its name, instead.",
)
def init_command(file: str, like: str | None) -> None:
    """Write a first case with comments to FILE, case.toml by default; a file that is there stays as it is."""
    from contactqp.scene.judging import refuse_undecodable
    from contactqp.scene.shipped import first_case, shipped_case

    path = Path(file)
    if path.suffix != ".toml":
        raise InvalidProblem(f"{file}: expected a name that ends in .toml")
    refuse_undecodable(file)  # the text of the case names its file
    text = first_case(file) if like is None else shipped_case(like).file.read_text(encoding="utf-8")
    try:
        with path.open("x", encoding="utf-8") as new:
            new.write(text)
    except FileExistsError:
        raise InvalidProblem(f"{file}: expected a name that is free, and a file is there") from None
    click.echo(f"written: {file}; contactqp run {shlex.quote(file)}")


@click.command("schema", short_help="Print the JSON schema of case files, for editors.")
def schema_command() -> None:
    """Print the JSON schema of case files, by which editors check and complete their keys.

    It knows what each key takes, and the units by name; whether joined ones, as in kN*m/s, are of the right kind, is
    checked when the case is read.
    With Taplo or the extension Even Better TOML, the first line of a case file names it: `#:schema ./case.schema.json`.
    In a shell `contactqp explain FILE` checks a case whole, units included.
    """
    from contactqp.scene.schema import case_schema

    print_json(case_schema())


@click.command("report", short_help="Hold error against run time of every method: a page.")
@click.argument("cases", nargs=-1, metavar="[CASE...]", shell_complete=complete_case)
@click.option("-o", "--output", metavar="DIR", default="report", show_default=True, help="Where the report goes.")
@click.option("--full", is_flag=True, help="Every case by every method and every value of its knob.")
@click.option("--compare", metavar="OLD.json", help="Then print what changed since the report of that results.json.")
@click.option("--stability", is_flag=True, help="The stability study; without CASE nothing else.")
@click.option("--jobs", type=click.IntRange(min=1), metavar="N", help="Processes side by side; all cores by default.")
@click.option("--dask", metavar="ADDRESS", help="Run on the Dask cluster of this scheduler instead: tcp://host:8786.")
@click.option("--fresh", is_flag=True, help="Forget what an interrupted report left in DIR.")
@click.option(
    "--time-limit",
    type=click.FloatRange(min=0, min_open=True),
    default=TIME_LIMIT,
    show_default=True,
    metavar="SECONDS",
    help="Of one answer; it is stopped then, and its row says so.",
)
def report_command(
    cases: tuple[str, ...],
    output: str,
    full: bool,
    compare: str | None,
    stability: bool,
    jobs: int | None,
    dask: str | None,
    fresh: bool,
    time_limit: float,
) -> None:
    """Hold error against run time: run cases by every method and every value of its knob, and write a page to DIR.

    Without CASE: a telling set in a few minutes, the examples small enough to check by hand and Hertz's contact at
    three sizes. With CASE, a file, a folder or a name, every setting of those; with --full all in the folder cases, or
    all that come with contactqp.

    Answers are found side by side, then timed in turn. Results are written to DIR as they are found, and the same
    command continues a report that was interrupted.

    With --stability: sweep stiffness, gaps, friction, units and so on until methods break, and write
    stability.html, stability.csv and stability.json to DIR.
    """
    from contactqp.study.running.runner import OF_SIGNAL, Running

    running, code = Running(jobs, dask, fresh, time_limit, shown=True), 0
    if cases or full or compare or not stability:
        from contactqp.study.reporting import report

        code = report(cases, output, running, full, compare)
    if stability and code < OF_SIGNAL:  # one Ctrl-C stops both
        from contactqp.study.stability.stability_report import report_stability

        code = max(code, report_stability(output, running))
    sys.exit(code)


@click.command("export", short_help="Write a case as a deck of CalculiX.")
@click.argument("case", shell_complete=complete_case)
@click.option("--inp", "folder", metavar="DIR", required=True, help="The folder of the deck, CASE.inp.")
def export_command(case: str, folder: str) -> None:
    """Write CASE, a scene of elastic bodies whose sides touch, as a deck of CalculiX to DIR.

    Loads become nodal forces, contacts pairs of surfaces on stiff springs; `contactqp crosscheck DIR/CASE.inp` runs it
    and judges what comes out. A plane that bodies may touch becomes a plate that is held. Round obstacles, membranes,
    bars, ties, motions and load paths have no deck.
    """
    from contactqp.scene.deck.writing import write_deck
    from contactqp.scene.scene import load_scene

    click.echo(f"written: {write_deck(load_scene(case), folder)}")


@click.command("gallery", short_help="Write problems with exact answers, for tests of codes.")
@click.argument("folder", required=False, metavar="[DIR]")
@click.option(
    "--kind", metavar="K", help="named, well-posed, degenerate, redundant, floating, frictional, ...; or all."
)
@click.option("--difficulty", metavar="D", help="easy, moderate or hard; all by default.")
@click.option("--count", type=int, metavar="N", help="How many of each kind; 3 by default, and all named ones.")
@click.option("--seed", type=int, default=0, show_default=True, metavar="S", help="Where the seeds start.")
@click.option("--name", "names", multiple=True, metavar="NAME", help="A problem by its name; may be repeated.")
@click.option(
    "--as",
    "form",
    type=click.Choice(["folders", "qpbenchmark"]),
    default="folders",
    show_default=True,
    help="A folder a problem, or a test set of qpbenchmark, without friction.",
)
@click.option("--list", "listed", is_flag=True, help="List the problems, write nothing.")
@click.option("--json", "as_json", is_flag=True, help="With --list: print JSON instead of a table.")
def gallery_command(
    folder: str | None,
    kind: str | None,
    difficulty: str | None,
    count: int | None,
    seed: int,
    names: tuple[str, ...],
    form: str,
    listed: bool,
    as_json: bool,
) -> None:
    """Write problems with exact answers to DIR, as JSON and Matrix Market files for the tests of any code.

    DIR must be new or empty. index.json lists the problems; each has a folder with problem.json, stiffness.mtx,
    load.mtx, normal.mtx, gap.mtx and so on, and answer.json with its exact answer, in doubles and as fractions.
    As qpbenchmark: contact_problems.py, data/ with a .npz each, answers/ in the names and signs of qpsolvers.
    """
    from contactqp.oracle.gallery.gallery import chosen_problems, summary, write_gallery

    chosen = chosen_problems(names, kind, difficulty, count, seed)
    if listed == (folder is not None):
        raise InvalidProblem("gallery: expected a folder to write to, or --list")
    if as_json and not listed:
        raise InvalidProblem("gallery: --json goes with --list; what is written has an index.json")
    if as_json:
        print_json([summary(problem) for problem in chosen])
    elif listed:
        print_gallery(console(), chosen)
    elif form == "qpbenchmark" and folder is not None:
        from contactqp.oracle.gallery.gallery import write_qpbenchmark

        written, count = write_qpbenchmark(folder, chosen)
        left_out = f"; {len(chosen) - count} with friction are not quadratic programs" if count < len(chosen) else ""
        click.echo(f"written: {written}, {count} problems{left_out}")
    elif folder is not None:
        click.echo(f"written: {write_gallery(folder, chosen)}, {len(chosen)} problems")
