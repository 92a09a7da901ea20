"""The command that solves: run."""

from __future__ import annotations

import signal
import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from contactqp.cli.output import (
    NOT_MET,
    Ending,
    complain,
    complete_case,
    complete_method,
    console,
    print_json,
    speakers,
    strict_option,
    units_option,
    whereabouts,
)
from contactqp.errors import InvalidProblem, NotConverged, StartWarning, Unsupported, warn
from contactqp.linalg.runtime import ENGINES, SERIAL, cores, import_scipy
from contactqp.model.arrays import telling, within_time

if TYPE_CHECKING:
    from contactqp.scene.judging import Failure, Judgement
    from contactqp.scene.scene import Scene
    from contactqp.study.answer_pictures import AnswerFiles
    from contactqp.study.friction_files import FileOutcome

# The number of cases from which on they are solved in parallel.
MANY = 4


@click.command("run", short_help="Solve cases, and compare with what they expect.")
@click.argument("cases", nargs=-1, required=True, metavar="CASE...", shell_complete=complete_case)
@click.option(
    "--method",
    "methods",
    multiple=True,
    metavar="M",
    shell_complete=complete_method,
    help="A name of `contactqp methods`; may be repeated.",
)
@click.option("--penalty", metavar="BETA", help='With its unit, as in "1e8 kN/m".')
@click.option("--perturbation", metavar="KAPPA", help='With its unit, as in "1e8 kN/m".')
@click.option("--option", "options", multiple=True, metavar="KEY=VALUE", help="Any other option of the method.")
@click.option("--time-limit", type=float, metavar="SECONDS", help="For each case; of other problems, for each method.")
@click.option(
    "--engine",
    type=click.Choice(ENGINES),
    default=SERIAL,
    show_default=True,
    help="In this process, or by PETSc on the ranks of mpiexec.",
)
@click.option("--checkpoint", metavar="DIR", help="With petsc: keep the steps of a load path, go on from them.")
@click.option("--plot", metavar="FILE", help="Draw the structure, and its history: .png, .pdf or .svg.")
@click.option("--vtu", metavar="FILE", help="Write displacements, stresses and contacts for ParaView: .vtu.")
@click.option("--csv", metavar="FILE", help="Write status, forces and gap of each contact at each instant: .csv.")
@click.option("--loads", metavar="FILE", help="Solve under each load case of a table: .csv.")
@units_option("a deck, or of a problem of matrices that states none,")
@strict_option
@click.option("--verbose", is_flag=True, help="Print whole tables, and every claim about every method.")
@click.option("--quiet", is_flag=True, help="Print what is not met or has no answer, and no more.")
@click.option(
    "--jobs",
    type=click.IntRange(min=1),
    metavar="N",
    help="Cases solved side by side. By default one; of four and more one for each core.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of tables.")
def run_command(
    cases: tuple[str, ...],
    methods: tuple[str, ...],
    penalty: str | None,
    perturbation: str | None,
    options: tuple[str, ...],
    time_limit: float | None,
    engine: str,
    checkpoint: str | None,
    plot: str | None,
    vtu: str | None,
    csv: str | None,
    loads: str | None,
    units: dict[str, str] | None,
    verbose: bool,
    quiet: bool,
    jobs: int | None,
    as_json: bool,
) -> None:
    """Solve each CASE (a file, a folder of them, or - for standard input) and compare with what it expects.

    A CASE may also be an input deck of Abaqus or CalculiX (.inp), a folder or .npz of matrices, or a problem of
    frictional contact in a file of FCLIB (HDF5) or Siconos (text): it is solved and certified.

    Without --method it is solved by active-set, and by every method that the case makes claims about. For one case the
    answer is printed, and how many of its claims are met; for several cases, one line each.

    --plot, --vtu and --csv show the answer by active-set or, with --method, those of all methods named; where there are
    several, the names of case and method are put before the suffix of FILE. A load path or a motion is drawn as
    displacements, forces and energies with its events, to FILE with "history" before the suffix; a problem of matrices
    as forces and gaps. A deck is drawn with its bodies, as a case of bodies is.

    With --loads, one CASE is solved under each row of a table, by one method. The first column of the table is "case",
    a name for each row; the others are named as unknowns (loads), as contacts (gaps) or "friction", with plain numbers
    in the units of the case. What a row does not state is as in the case. --csv writes all contacts of all rows, --plot
    draws their gaps and forces over the rows.

    With --engine petsc, `mpiexec -n 4 python -m contactqp run CASE --engine petsc` solves on four ranks, by active-set;
    the first one prints and writes the files.
    """
    import_scipy()
    from contactqp.scene.judging import read_knobs

    if "-" in cases and (engine != SERIAL or cases.count("-") > 1):
        raise InvalidProblem("run: standard input is read once, in one process; expected files, or a single -")
    speakers.start(engine)
    named, foreign = speakers.by_first(lambda: _split(cases))  # since files may exist on one rank alone
    with speakers.together():
        _refuse_on_engine(engine, checkpoint, csv, units)
        if units is not None and named:
            raise InvalidProblem(f"--units: {named[0]}: a case states its units itself; expected a deck or matrices")
        knobs = read_knobs(penalty, perturbation, options, bare=not named)
        if loads is not None:
            one = not foreign and len(named) == 1 and len(methods) <= 1
            if not one or engine != SERIAL or any((checkpoint, vtu)):
                told = "expected one case file, one method and one process, to print, --plot or --csv"
                of_matrices = "; a problem of matrices takes contactqp.solve_many, in Python" if foreign else ""
                raise InvalidProblem(f"--loads: {told}{of_matrices}")
            sys.exit(_run_loads(named[0], loads, methods, knobs, (plot, csv), time_limit, as_json, quiet))
        scenes, files = _read(named, plot, vtu, csv, every_method=bool(methods))
        asked = _Asked(
            methods, knobs, time_limit, engine, checkpoint, as_json, verbose, quiet, len(scenes) > 1 and not verbose
        )
        _refuse_combinations(asked, len(scenes), foreign, vtu)
    alone = engine != SERIAL or files is not None
    answered = [told.print() for told in _answers(scenes, files, asked, 1 if alone else jobs)]
    data = [outcome for told in answered for outcome in told.data]
    whole = sum(told.met for told in answered)
    met = whole == len(scenes)
    if asked.in_a_line and not as_json and speakers.speaks and not (quiet and met):
        click.echo(f"{whole} of {len(scenes)} met{'' if quiet else ' (--verbose prints the answers)'}")
    if foreign:
        passed, printed = _solve_files(foreign, asked, files, units)
        met, data = met and passed, data + printed
    if as_json and speakers.speaks:
        print_json(data)
    sys.exit(0 if met else NOT_MET)


def _solve_files(
    foreign: Sequence[str], asked: _Asked, files: AnswerFiles | None, units: Mapping[str, str] | None
) -> tuple[bool, list[Any]]:
    """Solve the problems in files of other codes and print them; return whether all passed, and what --json prints."""
    from contactqp.model.names import read_units
    from contactqp.study.friction_files import run_files, write_files

    solved = run_files(
        foreign,
        asked.methods,
        asked.knobs,
        drawn=files is not None,
        progress=speakers.speaks and sys.stderr.isatty(),
        engine=asked.engine,
        time_limit=asked.time_limit,
        units=read_units(units),
    )
    speakers.meet(_failed((one.failure, one.code or "") for one in solved if one.failure is not None))
    passed = all(outcome.passed for outcome in solved)
    if not speakers.speaks:
        return passed, []
    printed = _print_files(solved, asked.as_json, asked.verbose)
    for file in [] if files is None else write_files(solved, files.plot, files.vtu, files.csv):
        click.echo(f"written: {file}", err=asked.as_json)
    return passed, printed


def _refuse_on_engine(engine: str, checkpoint: str | None, csv: str | None, units: Mapping[str, str] | None) -> None:
    """Raise Unsupported for options that this engine does not have."""
    if checkpoint is not None and engine == SERIAL:
        raise Unsupported("--checkpoint: only --engine petsc keeps the steps of a load path")
    if csv is not None and engine != SERIAL:
        raise Unsupported("--csv: in one process alone; --json tells the contacts of all ranks")
    if units is not None and engine != SERIAL:
        raise Unsupported("--units: in one process alone")


def _refuse_combinations(asked: _Asked, cases: int, foreign: Sequence[str], vtu: str | None) -> None:
    """Raise an error for options that contradict each other or the files that they are for."""
    if foreign and vtu is not None:
        from contactqp.exchange.problem_files import is_deck

        for bare in (file for file in foreign if not is_deck(file)):
            raise InvalidProblem(f"{bare}: --vtu needs a case file or a deck, this file has no geometry")
    if asked.knobs and cases and not asked.methods and asked.engine == SERIAL:
        belong = "belongs" if len(asked.knobs) == 1 else "belong"
        raise InvalidProblem(f"run: {', '.join(asked.knobs)} {belong} to a method; state it by --method")
    if asked.time_limit is not None and not asked.time_limit > 0:
        raise InvalidProblem(f"--time-limit: expected a positive number of seconds, got {asked.time_limit:g}")
    if asked.time_limit is not None and asked.engine != SERIAL:
        raise Unsupported("--time-limit: in one process alone; on ranks --option time_limit=SECONDS")
    if asked.checkpoint is not None and cases != 1:
        raise InvalidProblem(f"--checkpoint: expected one case, whose steps are kept there, got {cases}")


def _run_loads(
    case: str,
    loads: str,
    methods: Sequence[str],
    knobs: Mapping[str, Any],
    files: tuple[str | None, str | None],
    time_limit: float | None,
    as_json: bool,
    quiet: bool,
) -> int:
    """Solve a case under each load case of a table, print and write the answers, and return the exit code."""
    from contactqp.scene.judging import case_files
    from contactqp.scene.load_cases import cases_data, print_cases, solve_cases, write_cases
    from contactqp.scene.scene import load_scene
    from contactqp.solving.methods import DEFAULT_METHOD

    (file,), (plot, csv) = case_files([case]), files
    if plot is not None:
        from contactqp.pictures.style import check_picture

        check_picture(plot)  # refused before anything is solved
    options = dict(knobs) if time_limit is None else dict(knobs, time_limit=time_limit)
    with whereabouts() as shown, telling(shown):
        answers = solve_cases(load_scene(file), loads, methods[0] if methods else DEFAULT_METHOD, options)
    if csv is not None:
        write_cases(answers, csv)
    if plot is not None:
        answers.solutions.plot(plot, title=answers.scene.title, names=answers.names)
    if as_json:
        print_json(cases_data(answers))
    elif not (quiet and answers.met):
        print_cases(console(), answers)
    for written in filter(None, files):
        click.echo(f"written: {written}", err=as_json)
    return 0 if answers.met else NOT_MET


def _split(cases: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split arguments into case files (and folders of them) and problems in files of other codes."""
    from contactqp.scene.judging import are_case_files

    if are_case_files(cases):
        return list(cases), []
    from contactqp.study.friction_files import split_files

    return split_files(cases)


def _read(
    named: Sequence[str], plot: str | None, vtu: str | None, csv: str | None, *, every_method: bool
) -> tuple[list[Scene], AnswerFiles | None]:
    """Return the scenes, and the files that answers are drawn to."""
    from contactqp.scene.judging import case_files
    from contactqp.scene.scene import load_scene

    scenes = [load_scene(file) for file in case_files(named)]
    if plot is None and vtu is None and csv is None:
        return scenes, None
    from contactqp.study.answer_pictures import answer_files

    return scenes, answer_files(scenes, plot, vtu, csv, every_method=every_method)


@dataclass(frozen=True)
class _Asked:
    """How the cases of one command are to be solved and printed."""

    methods: tuple[str, ...]
    knobs: Mapping[str, Any]
    time_limit: float | None
    engine: str
    checkpoint: str | None
    as_json: bool
    verbose: bool
    quiet: bool
    in_a_line: bool


@dataclass(frozen=True)
class _Outcome:
    """The outcomes of one case, as they are to be printed."""

    met: bool
    complaints: tuple[str, ...]
    text: str  # for the standard output
    data: list[Any]  # for --json
    doubts: tuple[str, ...] = ()  # StartWarnings of another process

    def print(self) -> _Outcome:
        """Print warnings, complaints and text, each to its stream, and return itself."""
        for doubt in self.doubts:
            warn(doubt, StartWarning)
        for message in self.complaints if speakers.speaks else ():
            complain(message)
        click.echo(self.text, nl=False)
        return self


def _answers(scenes: Sequence[Scene], files: AnswerFiles | None, asked: _Asked, jobs: int | None) -> Iterator[_Outcome]:
    """Yield the outcomes of each case, solved in this process or in `jobs` parallel ones."""
    side_by_side = min(jobs or (cores() if len(scenes) >= MANY else 1), len(scenes))
    if side_by_side <= 1:
        yield from (_answer(scene, files, asked) for scene in scenes)
        return
    from concurrent.futures import ProcessPoolExecutor
    from concurrent.futures.process import BrokenProcessPool
    from multiprocessing import active_children, get_context

    pool = ProcessPoolExecutor(side_by_side, get_context("spawn"), _leave_ctrl_c_to_the_first)
    solve = partial(_answer_elsewhere, asked=asked, terminal=sys.stdout.isatty())
    try:
        # `pool.map` would cancel the remaining cases, and then the pool's own thread fails when its processes end.
        for future in [pool.submit(solve, scene) for scene in scenes]:
            yield future.result()
    except BaseException as error:
        for child in active_children():
            child.terminate()
        if isinstance(error, BrokenProcessPool):
            text = "run: a process that solved a case died; with --jobs 1 they are solved one by one, in this one"
            raise NotConverged(text) from None
        raise
    finally:
        pool.shutdown()  # wait, as the pool's own thread may otherwise close a pipe that Python still writes to


def _leave_ctrl_c_to_the_first() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _answer_elsewhere(scene: Scene, *, asked: _Asked, terminal: bool) -> _Outcome:
    """Solve a case in a process of its own, whose warnings are returned as text."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", StartWarning)
        told = _answer(scene, None, asked, terminal)
    return replace(told, doubts=tuple(str(one.message) for one in caught if issubclass(one.category, StartWarning)))


def _answer(scene: Scene, files: AnswerFiles | None, asked: _Asked, terminal: bool | None = None) -> _Outcome:
    """Solve a case and draw its answer; on several ranks collectively, as each has a part of it."""
    from contactqp.scene.judging import Failure, judge_all
    from contactqp.scene.printing import judgement_data

    here = terminal is None and asked.engine == SERIAL  # others write to the same terminal
    with within_time(asked.time_limit), whereabouts() if here else nullcontext() as shown, telling(shown):
        found = judge_all(scene, asked.methods, asked.knobs, asked.engine, asked.checkpoint)
    failures = [outcome for outcome in found if isinstance(outcome, Failure)]
    speakers.meet(_failed((failure.message, failure.code) for failure in failures))
    text = "" if asked.as_json else _text(found, asked, terminal)
    written = [] if files is None else _draw(found, files)
    lines = "".join(f"written: {file}\n" for file in written)
    if asked.as_json and lines:
        click.echo(lines, nl=False, err=True)
    return _Outcome(
        met=all(outcome.met for outcome in found),
        complaints=tuple(failure.message for failure in failures),
        text=text if asked.as_json else text + lines,
        data=[judgement_data(outcome) for outcome in found] if asked.as_json else [],
    )


def _text(found: Sequence[Judgement | Failure], asked: _Asked, terminal: bool | None) -> str:
    """Return the text of the outcomes of one case; `terminal` says whether it will be shown on a terminal."""
    from contactqp.scene.judging import Judgement
    from contactqp.scene.printing import print_case_line, print_failure, print_judgements

    shown = console(heard=speakers.speaks, terminal=terminal)
    with shown.capture() as captured:
        if asked.in_a_line:
            if not (asked.quiet and all(outcome.met for outcome in found)):
                print_case_line(shown, found)
        elif not asked.quiet:
            for outcome in found:
                if not isinstance(outcome, Judgement):
                    print_failure(shown, outcome)
            print_judgements(shown, [one for one in found if isinstance(one, Judgement)], asked.verbose)
    return captured.get() if speakers.speaks else ""


def _failed(failures: Iterable[tuple[str, str]]) -> Ending:
    """Return the ending of a rank that alone has no answer, while the others wait in a collective operation.

    Failures are pairs of message and code; the first code is used.
    """
    known = list(failures)
    return Ending(NOT_MET, "; ".join(message for message, _ in known), error=known[0][1] if known else "")


def _draw(found: Sequence[Judgement | Failure], files: AnswerFiles) -> list[Path]:
    """Write pictures and files, and return their paths; on several ranks the first one gathers the answer."""
    from contactqp.scene.judging import Judgement

    for outcome in found:
        if isinstance(outcome, Judgement) and outcome.trial.engine != SERIAL:
            from contactqp.distributed.distributed_bodies import gather

            gather(outcome.history)
    return files.write(found) if speakers.speaks else []


def _print_files(solved: Sequence[FileOutcome], as_json: bool, verbose: bool) -> list[Any]:
    """Print the outcomes of problems in files of other codes; with `as_json`, return the data to be printed."""
    from contactqp.study.friction_files import outcome_data, print_outcomes

    for message in (outcome.failure for outcome in solved if outcome.failure is not None):
        complain(message)
    if as_json:
        return [outcome_data(outcome) for outcome in solved]
    print_outcomes(console(), solved, verbose=verbose)
    return []
