"""The command line: arguments only."""

from __future__ import annotations

import _thread
import json
import os
import sys
import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NoReturn

import click

import contactqp
from contactqp.errors import BackendMissing, ContactQPError, InvalidProblem, SceneError, Unsupported

if TYPE_CHECKING:
    from rich.console import Console

NOT_MET, BAD_INPUT, NOT_INSTALLED, INTERRUPTED = 1, 2, 3, 130
# Seconds after which a Ctrl-C that was ignored is repeated.
ONCE_MORE = 0.05
# Of one cell of a report [s].
TIME_LIMIT = 600.0


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(contactqp.__version__, prog_name="contactqp")
def command() -> None:
    """Contact problems as energy minimisation with inequality constraints, every answer certified."""


@command.command("run")
@click.argument("cases", nargs=-1, required=True, metavar="CASE...")
@click.option("--method", "methods", multiple=True, metavar="M", help="A name of `contactqp methods`; may be repeated.")
@click.option("--penalty", metavar="BETA", help='With its unit, as in "1e8 kN/m".')
@click.option("--perturbation", metavar="KAPPA", help='With its unit, as in "1e8 kN/m".')
@click.option("--option", "options", multiple=True, metavar="KEY=VALUE", help="Any other option of the method.")
@click.option("--plot", metavar="FILE", help="Draw the structure, and its history: .png, .pdf or .svg.")
@click.option("--vtu", metavar="FILE", help="Write displacements, stresses and contacts for ParaView: .vtu.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of tables.")
def run_command(
    cases: tuple[str, ...],
    methods: tuple[str, ...],
    penalty: str | None,
    perturbation: str | None,
    options: tuple[str, ...],
    plot: str | None,
    vtu: str | None,
    as_json: bool,
) -> None:
    """Solve each CASE (a file, or a folder of them) and compare with what it expects.

    A CASE may also be a folder or .npz of matrices, or a problem of frictional contact in a file of FCLIB (HDF5) or
    Siconos (text): it is solved, and what is said of it is its certificate.

    Without --method: by active-set, and by every method that the case itself says something about.

    --plot and --vtu show the answer by active-set or, with --method, those of all methods named; where there are
    several, the names of case and method are put before the suffix of FILE. A load path or a motion is drawn as
    displacements, forces and energies with its events, to FILE with "history" before the suffix.
    """
    from contactqp.scene.arguments import are_case_files, case_files, read_knobs
    from contactqp.scene.judging import Failure, Judgement, judge_all
    from contactqp.scene.loading import load_scene
    from contactqp.scene.printing import judgement_data, print_judgements
    from contactqp.scene.printing_paths import print_failure

    named, foreign = list(cases), list[str]()
    if not are_case_files(cases):
        from contactqp.study.friction_files import split_files

        named, foreign = split_files(cases)
    scenes = [load_scene(file) for file in case_files(named)]
    knobs = read_knobs(penalty, perturbation, options)
    files = None
    if plot is not None or vtu is not None:
        from contactqp.study.answer_files import answer_files

        files = answer_files(scenes, plot, vtu, every_method=bool(methods))
    console, outcomes = _console(), []
    for scene in scenes:
        outcomes += (found := judge_all(scene, methods, knobs))
        for failure in (outcome for outcome in found if isinstance(outcome, Failure)):
            _complain(failure.message)
            if not as_json:
                print_failure(console, failure)
        if not as_json:
            print_judgements(console, [outcome for outcome in found if isinstance(outcome, Judgement)])
        for file in files.write(found) if files is not None else ():
            click.echo(f"written: {file}", err=as_json)
    data, met = [judgement_data(outcome) for outcome in outcomes] if as_json else [], all(o.met for o in outcomes)
    if foreign:
        from contactqp.study.friction_files import outcome_data, run_files
        from contactqp.study.friction_printing import print_outcomes

        solved = run_files(foreign, methods, knobs, drawn=bool(plot or vtu), progress=sys.stderr.isatty())
        for message in (outcome.failure for outcome in solved if outcome.failure is not None):
            _complain(message)
        if as_json:
            data += [outcome_data(outcome) for outcome in solved]
        else:
            print_outcomes(console, solved)
        met = met and all(outcome.passed for outcome in solved)
    if as_json:
        _print_json(data)
    sys.exit(0 if met else NOT_MET)


@command.command("check")
@click.argument("problem")
@click.argument("candidate")
@click.option(
    "--compression",
    type=click.Choice(["positive", "negative"]),
    default="positive",
    show_default=True,
    help="Which sign of CANDIDATE's normal forces means compression.",
)
@click.option("--pressure-areas", metavar="FILE", help="Areas of the contacts: CANDIDATE holds pressures.")
@click.option("--dof-map", metavar="FILE", help="Where each unknown of PROBLEM stands in CANDIDATE, or its name there.")
@click.option("--contact-map", metavar="FILE", help="The same for contacts.")
@click.option("--tolerance", type=float, default=1e-9, show_default=True, help="Largest violation that passes.")
@click.option("--error-tolerance", type=float, default=1e-6, show_default=True, help="Largest bound that passes.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of tables.")
def check_command(
    problem: str,
    candidate: str,
    compression: str,
    pressure_areas: str | None,
    dof_map: str | None,
    contact_map: str | None,
    tolerance: float,
    error_tolerance: float,
    as_json: bool,
) -> None:
    """Judge somebody else's answer, CANDIDATE, to PROBLEM: exit 0 if it is right, 1 if it is wrong.

    PROBLEM is a case file; or a folder or .npz of matrices, by the names of their files: stiffness or K, load or f,
    normal or E_N, gap or g (Matrix Market, Harwell-Boeing, CSV, .npy, Ansys's .full, ...), or contacts.csv. CANDIDATE
    then holds displacement, normal_force or both, and friction_force and tie_force, by name or in order: JSON (what
    `contactqp run CASE --method M --json` prints is one), CSV (columns dof,displacement and contact,normal_force),
    .npz, one array or a folder of them, or a result file of a code that is known.

    Or PROBLEM is a file of FCLIB (HDF5) or Siconos (text); CANDIDATE then holds the forces on the bodies, contact by
    contact in the order (N, T1, T2): FCLIB's /solution, a .npy array, JSON, CSV or plain numbers.

    A map is a text file: places counted from 0, or CANDIDATE's names in its order, one a line, or CSV
    problem,candidate.
    """
    from contactqp.study.check_options import CheckOptions
    from contactqp.study.checking import check_answer, print_check

    options = CheckOptions(tolerance, compression, pressure_areas, dof_map, contact_map, error_tolerance)
    verdict = check_answer(problem, candidate, options)
    if as_json:
        _print_json(verdict.data())
    else:
        print_check(_console(), verdict)
    sys.exit(0 if verdict.passed else NOT_MET)


@command.command("explain")
@click.argument("case")
@click.option("--no-solve", is_flag=True, help="Say what the case is made of, and not what its answer takes.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of tables.")
def explain_command(case: str, no_solve: bool, as_json: bool) -> None:
    """Print the unknowns and constraints of CASE, which blocks it got and which not, with the reason, and its cost.

    The cost is that of solving CASE once by active-set in a fresh interpreter: the time of each stage, memory, modules
    imported, factorisations, contacts kept and dropped. It takes about as long as `contactqp run`; --no-solve leaves it
    out. A case without an answer is explained all the same.
    """
    from dataclasses import asdict

    from contactqp.scene.explaining import explain
    from contactqp.scene.loading import load_scene

    explanation = explain(load_scene(case))
    if not as_json:
        from contactqp.scene.printing_explanation import print_explanation

        print_explanation(_console(), explanation)
    footprint = None
    if not no_solve:
        from contactqp.study.footprint.measuring import measure

        footprint = measure(case)
    if as_json:
        _print_json(asdict(explanation) | {"footprint": None if footprint is None else footprint.data()})
    elif footprint is not None:
        from contactqp.study.footprint.printing import print_footprint

        print_footprint(_console(), footprint)


@command.command("oracle")
@click.argument("case")
@click.option("--method", metavar="M", default="active-set", show_default=True, help="What proposes the contact set.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of tables.")
def oracle_command(case: str, method: str, as_json: bool) -> None:
    """Print the exact answer of CASE, in rational numbers or enclosed: multipliers for tests in any language.

    CASE is a case file, whose numbers are read exactly (1 mm is 1/1000 m), or a problem in a file of another code,
    whose floats are taken as they stand. Exit 1 if there is no equilibrium or nothing could be proven.
    """
    from contactqp.oracle.exact.exact import exact
    from contactqp.oracle.exact.printing import answer_data, print_answer
    from contactqp.oracle.exact.reading import read_case, tie_names

    asked = read_case(case)
    answer = exact(asked, method)
    ties, title = tie_names(asked, answer.problem.ties), str(getattr(asked, "title", case))
    if as_json:
        _print_json(answer_data(answer, ties, title))
    else:
        print_answer(_console(), answer, ties, title)


@command.command("methods")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
def methods_command(as_json: bool) -> None:
    """List every method: what it can do, and whether it is installed or how to install it."""
    from contactqp.methods import methods
    from contactqp.scene.printing_methods import method_data, print_methods

    if as_json:
        _print_json([method_data(method) for method in methods()])
    else:
        print_methods(_console(), methods())


@command.command("report")
@click.argument("cases", nargs=-1, metavar="[CASE...]")
@click.option("-o", "--output", metavar="DIR", default="report", show_default=True, help="Where the report goes.")
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
    stability: bool,
    jobs: int | None,
    dask: str | None,
    fresh: bool,
    time_limit: float,
) -> None:
    """Run every case by every method and every value of its knob, and write errors and run times to DIR.

    Answers are found side by side, then timed one after the other. What is found streams to DIR; a report that was
    interrupted goes on from there by the same command.

    With --stability: sweep stiffness, gaps, friction, units and so on until methods break, and write
    stability.html, stability.csv and stability.json to DIR.
    """
    from contactqp.study.running.running import Running

    running, codes = Running(jobs, dask, fresh, time_limit, shown=True), []
    if cases or not stability:
        from contactqp.study.report.report import report

        codes.append(report(cases, output, running))
    if stability:
        from contactqp.study.stability.report import report_stability

        codes.append(report_stability(output, running))
    sys.exit(max(codes))


@command.command("gallery")
@click.argument("folder", required=False, metavar="[DIR]")
@click.option(
    "--kind", metavar="K", help="named, well-posed, degenerate, redundant, floating, frictional, ...; or all."
)
@click.option("--difficulty", metavar="D", help="easy, moderate or hard; all by default.")
@click.option("--count", type=int, metavar="N", help="How many of each kind; 3 by default, and all named ones.")
@click.option("--seed", type=int, default=0, show_default=True, metavar="S", help="Where the seeds start.")
@click.option("--name", "names", multiple=True, metavar="NAME", help="A problem by its name; may be repeated.")
@click.option("--list", "listed", is_flag=True, help="List the problems, write nothing.")
@click.option("--json", "as_json", is_flag=True, help="With --list: print JSON instead of a table.")
def gallery_command(
    folder: str | None,
    kind: str | None,
    difficulty: str | None,
    count: int | None,
    seed: int,
    names: tuple[str, ...],
    listed: bool,
    as_json: bool,
) -> None:
    """Write problems with exact answers to DIR, as JSON and Matrix Market files for the tests of any code.

    DIR must be new or empty. index.json lists the problems; each has a folder with problem.json, stiffness.mtx,
    load.mtx, normal.mtx, gap.mtx and so on, and answer.json with its exact answer, in doubles and as fractions.
    """
    from contactqp.oracle.gallery.files import summary, write_gallery
    from contactqp.oracle.gallery.gallery import chosen_problems

    chosen = chosen_problems(names, kind, difficulty, count, seed)
    if listed == (folder is not None):
        raise InvalidProblem("gallery: expected a folder to write to, or --list")
    if as_json and not listed:
        raise InvalidProblem("gallery: --json goes with --list; what is written has an index.json")
    if as_json:
        _print_json([summary(known) for known in chosen])
    elif listed:
        from contactqp.study.gallery_printing import print_gallery

        print_gallery(_console(), chosen)
    elif folder is not None:
        click.echo(f"written: {write_gallery(folder, chosen)}, {len(chosen)} problems")


def _console() -> Console:
    from rich.console import Console

    # Into a pipe or a file there is no width to wrap at.
    return Console(width=None if sys.stdout.isatty() else 200, highlight=False)


def _print_json(data: Any) -> None:
    click.echo(json.dumps(data, indent=2, default=str, allow_nan=False))


def _complain(message: str) -> None:
    click.echo(f"contactqp: {' '.join(message.split())}", err=True)


def _exit_code(error: ContactQPError) -> int:
    if isinstance(error, BackendMissing):
        return NOT_INSTALLED
    return BAD_INPUT if isinstance(error, SceneError | InvalidProblem | Unsupported) else NOT_MET


def _insist(ignored: sys.UnraisableHookArgs) -> None:
    """Ctrl-C where Python lets no exception through, as in a callback of an import, comes once more after that."""
    if issubclass(ignored.exc_type, KeyboardInterrupt):
        # From another thread, a moment later: here it would be ignored again.
        threading.Timer(ONCE_MORE, _thread.interrupt_main).start()
    else:
        sys.__unraisablehook__(ignored)


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line, on `sys.argv` by default; every error of contactqp is one line and an exit code."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # names in a case may hold letters that the terminal cannot show
            stream.reconfigure(errors="replace")
    if sys.unraisablehook is sys.__unraisablehook__:
        sys.unraisablehook = _insist
    try:
        command(arguments, prog_name="contactqp", standalone_mode=False)
    except ContactQPError as error:
        _complain(str(error))
        sys.exit(_exit_code(error))
    except click.ClickException as error:
        error.show()
        sys.exit(BAD_INPUT)
    except (click.Abort, KeyboardInterrupt):
        _complain("interrupted")
        sys.exit(INTERRUPTED)
    except BrokenPipeError:  # the reader of our output has left, as in `contactqp methods | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
    except OSError as error:  # a name too long, no permission, a full disk
        _complain(f"{error.filename or 'file'}: {error.strerror or error}")
        sys.exit(BAD_INPUT)
    sys.exit(0)
