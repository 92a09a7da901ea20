"""Commands that examine one problem or answer: check, crosscheck, explain, oracle."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path as FilePath
from tempfile import TemporaryDirectory
from typing import Literal, NoReturn

import click

from contactqp.cli.output import (
    NOT_MET,
    OF_EXACT_NUMBERS,
    complete_case,
    complete_method,
    console,
    print_json,
    strict_option,
    units_option,
    whereabouts,
)
from contactqp.errors import InvalidProblem, SceneError
from contactqp.model.arrays import telling, within_time


@click.command("check", short_help="Judge somebody else's answer to a problem.")
@click.argument("problem", required=False, shell_complete=complete_case)
@click.argument("candidate", required=False, shell_complete=complete_case)
@click.option(
    "--compression",
    type=click.Choice(["positive", "negative"]),
    default="positive",
    show_default=True,
    help="Which sign of CANDIDATE's normal forces means compression.",
)
@click.option("--pressure-areas", metavar="FILE", help="Areas of the contacts: CANDIDATE holds pressures.")
@click.option(
    "--dof-map",
    metavar="FILE",
    help="Where each unknown of PROBLEM stands in CANDIDATE, or its name there; places may be written out: '[1, 0]'.",
)
@click.option("--contact-map", metavar="FILE", help="The same for contacts.")
@click.option("--tolerance", type=float, default=1e-9, show_default=True, help="Largest violation that passes.")
@click.option("--error-tolerance", type=float, default=1e-6, show_default=True, help="Largest bound that passes.")
@units_option("a deck, or of matrices that state none,")
@click.option("--receipt", metavar="FILE.json", help="Write hashes, version, verdict, figures and bounds to it.")
@click.option("--verify", "receipt_to_verify", metavar="FILE.json", help="Say whether that receipt still holds.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of tables.")
def check_command(
    problem: str | None,
    candidate: str | None,
    compression: str,
    pressure_areas: str | None,
    dof_map: str | None,
    contact_map: str | None,
    tolerance: float,
    error_tolerance: float,
    units: dict[str, str] | None,
    receipt: str | None,
    receipt_to_verify: str | None,
    as_json: bool,
) -> None:
    """Judge somebody else's answer, CANDIDATE, to PROBLEM: exit 0 if it is right, 1 if it is wrong.

    PROBLEM is a case file; an input deck of Abaqus or CalculiX (.inp); or a folder or .npz of matrices, by the names of
    their files: stiffness or K, load or f, normal or E_N, gap or g (Matrix Market, Harwell-Boeing, CSV, .npy, Ansys's
    .full, ...), or contacts.csv. CANDIDATE then holds displacement, normal_force or both, and friction_force and
    tie_force, by name or in order: JSON (what `contactqp run CASE --method M --json` prints is one), CSV (columns
    dof,displacement and contact,normal_force), .npz, one array or a folder of them, or a result file of a code that is
    known.

    Or PROBLEM is a file of FCLIB (HDF5) or Siconos (text); CANDIDATE then holds the forces on the bodies, contact by
    contact in the order (N, T1, T2): FCLIB's /solution, a .npy array, JSON, CSV or plain numbers.

    One of the two may be -, standard input: a case file as PROBLEM, JSON as CANDIDATE.

    It prints the figures of the certificate and its error bounds, or why there are none. For a wrong answer it also
    says what is wrong, and lists the worst contacts with the right values beside.

    A map is a text file: places counted from 0, or CANDIDATE's names in its order, one a line, or CSV
    problem,candidate.

    `contactqp check --verify FILE.json` checks a receipt: it hashes the files, whose paths are relative to the receipt,
    and judges the answer again; exit 0 if nothing has changed, else 1 with the differences.
    """
    if receipt_to_verify is not None:
        told = (problem, receipt, pressure_areas, dof_map, contact_map, units)
        if told != (None,) * 6 or (compression, tolerance, error_tolerance) != ("positive", 1e-9, 1e-6):
            raise click.UsageError("--verify takes files and options from the receipt: expected no others")
        _verify(receipt_to_verify, as_json)
    if problem is None or candidate is None:
        raise click.UsageError("expected PROBLEM and CANDIDATE, or --verify FILE.json")
    from contactqp.linalg.runtime import import_scipy

    import_scipy()
    from contactqp.study.checking import check_answer, print_check
    from contactqp.study.verdict import CheckOptions

    options = CheckOptions(tolerance, compression, pressure_areas, dof_map, contact_map, error_tolerance, units)
    if problem == candidate == "-":
        raise InvalidProblem("check: PROBLEM and CANDIDATE are both standard input; expected a file for one of them")
    if receipt is not None:
        from contactqp.study.receipt import receipt_path, write_receipt

        receipt_path(receipt, problem, candidate, options)  # refused before anything is judged
    with _answer_file(candidate) as file:
        verdict = check_answer(problem, file, options)
    if candidate == "-":
        read = replace(verdict.ledgers[1], source=STANDARD_INPUT)
        verdict = replace(verdict, candidate_file=STANDARD_INPUT, ledgers=(verdict.ledgers[0], read))
    if receipt is not None:
        write_receipt(receipt, problem, candidate, options, verdict)
    if as_json:
        print_json(verdict.data())
    else:
        print_check(console(), verdict)
    if receipt is not None:
        click.echo(f"written: {receipt}", err=as_json)
    sys.exit(0 if verdict.passed else NOT_MET)


@click.command("crosscheck", short_help="Judge the contact of a deck in its own code.")
@click.argument("model", metavar="MODEL.inp")
@click.argument("results", required=False, metavar="[RESULTS]")
@click.option(
    "--reference",
    type=click.Choice(["exact", "penalty"]),
    default="exact",
    show_default=True,
    help="No overlap at all, or the springs that the deck states.",
)
@click.option(
    "--error-tolerance",
    type=float,
    default=1e-2,
    show_default=True,
    help="Largest error that passes, of the resultant.",
)
@click.option("--time-limit", type=float, default=600.0, show_default=True, metavar="SECONDS", help="For CalculiX.")
@click.option("--plot", metavar="FILE", help="Draw both pressure fields and their difference: .png, .pdf or .svg.")
@click.option("--folder", metavar="DIR", help="Where CalculiX runs; MODEL.ccx by default. What it writes stays there.")
@units_option("the deck")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
def crosscheck_command(
    model: str,
    results: str | None,
    reference: Literal["exact", "penalty"],
    error_tolerance: float,
    time_limit: float,
    plot: str | None,
    folder: str | None,
    units: dict[str, str] | None,
    as_json: bool,
) -> None:
    """Judge the contact of MODEL.inp as CalculiX solves it, pair by pair: exit 0 if it is right, 1 if it is wrong.

    MODEL.inp is an input deck of Abaqus or CalculiX: linear elastic static steps. RESULTS is a .dat or .frd file of
    CalculiX with the displacements of all nodes (`*NODE PRINT` or `*NODE FILE`, U); without it the deck is run by ccx,
    or by the command that CONTACTQP_CCX names, and exit 3 says that there is none.

    It prints the resultant of each pair in the other code and the exact one, the causes of the difference (springs
    instead of contact, nodes in tension, truncated numbers, contact that was not detected), and the worst nodes.
    """
    from contactqp.oracle.foreign.crosscheck import crosscheck

    if plot is not None:
        from contactqp.pictures.style import check_picture

        check_picture(plot)  # refused before anything is run
    found = crosscheck(
        model,
        results,
        reference=reference,
        error_tolerance=error_tolerance,
        time_limit=time_limit,
        folder=folder,
        units=units,
    )
    if as_json:
        print_json(found.data())
    else:
        click.echo(found.summary())
    if plot is not None:
        from contactqp.pictures.drawing import draw_crosscheck

        draw_crosscheck(found, plot)
        click.echo(f"written: {plot}", err=as_json)
    sys.exit(0 if found.passed else NOT_MET)


def _verify(receipt: str, as_json: bool) -> NoReturn:
    from contactqp.study.receipt import verify

    found = verify(receipt)
    if as_json:
        print_json(found.data())
    else:
        word = "right" if found.right else "WRONG"
        holds = "holds" if found.holds else "DOES NOT HOLD"
        click.echo(f"{receipt}: {holds}; it says that the answer is {word}, by contactqp {found.written_by}")
        if found.tolerances != (1e-9, 1e-6):
            click.echo(f"  by tolerances of {found.tolerances[0]:g} (violations) and {found.tolerances[1]:g} (errors)")
        for text in found.differences:
            click.echo(f"  {text}")
    sys.exit(0 if found.holds else NOT_MET)


STANDARD_INPUT = "standard input"
# Limit for the solve whose cost is explained [s].
EXPLAINED_WITHIN = 60.0


@contextmanager
def _answer_file(candidate: str) -> Iterator[str]:
    """Yield the file of an answer; what comes in on standard input is first written into one."""
    if candidate != "-":
        yield candidate
        return
    from contactqp.scene.scene import read_standard_input

    try:
        given = read_standard_input("an answer")
    except SceneError as error:
        raise SceneError(f"{STANDARD_INPUT}: {error}") from None
    with TemporaryDirectory() as folder:
        file = FilePath(folder, "standard-input.json")
        file.write_bytes(given)
        yield str(file)


@click.command("explain", short_help="Print what a case is made of, why, and its cost.")
@click.argument("case", shell_complete=complete_case)
@strict_option
@click.option("--no-solve", is_flag=True, help="Say what the case is made of, and not what its answer takes.")
@click.option(
    "--time-limit",
    type=click.FloatRange(min=0, min_open=True),
    default=EXPLAINED_WITHIN,
    show_default=True,
    metavar="SECONDS",
    help="Of the solve; it is stopped then, and its cost is that of what was done.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of tables.")
def explain_command(case: str, no_solve: bool, time_limit: float, as_json: bool) -> None:
    """Print the unknowns and constraints of CASE, which blocks it got and which not, with the reason, and its cost.

    The cost is that of solving CASE once by active-set in a fresh interpreter: the time of each stage, memory, modules
    imported, factorisations, contacts kept and dropped. It takes about as long as `contactqp run`, and no
    longer than --time-limit; --no-solve leaves it out. A case without an answer is explained all the same.

    CASE may also be a problem of matrices, as a quadratic program (.qps, .mps, .mat, .npz), or -, a case file on
    standard input; of these no cost is taken.
    """
    from dataclasses import asdict

    from contactqp.exchange.problem_files import is_problem_file
    from contactqp.scene.explaining import explain, explain_problem
    from contactqp.scene.scene import load_scene

    if is_problem_file(case):
        from contactqp.study.friction_files import solvable_form

        explanation, no_solve = explain_problem(solvable_form(case), FilePath(case).name), True
    else:
        explanation, no_solve = explain(load_scene(case)), no_solve or case == "-"
    if not as_json:
        from contactqp.scene.explaining import print_explanation

        print_explanation(console(), explanation)
    footprint = None
    if not no_solve:
        from contactqp.study.footprint import measure

        footprint = measure(case, time_limit=time_limit)
    if as_json:
        print_json(asdict(explanation) | {"footprint": None if footprint is None else footprint.data()})
    elif footprint is not None:
        from contactqp.study.footprint import print_footprint

        print_footprint(console(), footprint)


@click.command("oracle", short_help="Print the exact answer of a case.")
@click.argument("case", shell_complete=complete_case)
@click.option(
    "--method",
    metavar="M",
    shell_complete=complete_method,
    default="active-set",
    show_default=True,
    help="What proposes the contact set.",
)
@click.option(
    "--time-limit",
    type=click.FloatRange(min=0, min_open=True),
    metavar="SECONDS",
    help="Of the whole, proof included. Default: none.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of tables.")
def oracle_command(case: str, method: str, time_limit: float | None, as_json: bool) -> None:
    """Print the exact answer of CASE, in rational numbers or enclosed: multipliers for tests in any language.

    CASE is a case file (- is standard input), whose numbers are read exactly (1 mm is 1/1000 m), or a problem in a file
    of another code, whose floats are taken as they stand. Exit 1 if there is no equilibrium or nothing could be proven.
    """
    from contactqp.oracle.exact.exact import exact, read_case, tie_names
    from contactqp.oracle.exact.exact_solution import answer_data, print_answer

    with within_time(time_limit), whereabouts() as shown, telling(shown):
        asked = read_case(case)
        answer = exact(asked, method)
    ties, title = tie_names(asked, answer.problem.ties), str(getattr(asked, "title", case))
    if as_json:
        print_json(answer_data(answer, ties, title))
    else:
        print_answer(console(piped=OF_EXACT_NUMBERS), answer, ties, title)
