"""Solve problems in files of other codes, in one process or on ranks, and print one outcome per file and method."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from contactqp.analysis.history import History
from contactqp.analysis.load_cases import contact_table
from contactqp.distributed.distributing import ProblemRows, problem_from_share, rows_of_problem, share_from_first_rank
from contactqp.distributed.problem import DistributedSolution
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.solving import (
    CollectedSolution,
    collected,
    distributed_method,
    options_on_ranks,
    solve_distributed,
)
from contactqp.errors import (
    BackendFailed,
    ContactQPError,
    InvalidProblem,
    NoEquilibrium,
    NotCertified,
    NotConverged,
    SeveralEquilibria,
    Unsupported,
)
from contactqp.exchange.files import Ledger, naming, write_whole
from contactqp.exchange.local_form import SingularMatrix, local_form_of
from contactqp.exchange.problem_files import is_deck, is_of_matrices, is_problem_file, read_problem_with_ledger
from contactqp.linalg.runtime import SERIAL
from contactqp.model.arrays import Array, within_time
from contactqp.model.local_problem import LocalProblem, LocalSolution
from contactqp.model.problem import ContactProblem, Units
from contactqp.model.solution import ANSWER_PARTS, Certificate, LocalCertificate, Solution
from contactqp.model.summary import finite
from contactqp.scene.deck.deck import read_deck
from contactqp.scene.tables import fits, print_noted, print_wrapped
from contactqp.scene.units import Quantity, UnitSystem, number
from contactqp.solving.methods import DEFAULT_METHOD, options_of
from contactqp.solving.solve import solve


@dataclass(frozen=True)
class Outline:
    """Facts about a problem that are printed with its answer; on several ranks no rank keeps the problem itself."""

    form: str  # as solved: "local" wherever there is one, else "bodies"
    dimension: int  # 1 where nothing says it
    contacts: int
    asymmetry: float
    is_energy: bool = False  # bodies without friction, or any other energy with linear constraints
    unknowns: int = 0
    ties: int = 0


@dataclass(frozen=True, eq=False)
class FileOutcome:
    """The outcome of one method on the problem of one file."""

    file: str
    problem: Outline
    solution: LocalSolution | Solution | CollectedSolution | None  # also one that the certificate refuses
    failure: str | None  # why there is no answer
    seconds: float  # of solving
    options: Mapping[str, Any] = field(default_factory=dict)
    code: str | None = None  # that of the error, where there is a failure
    ledger: Ledger | None = None  # what was read, assumed and without effect, of files of bodies
    method: str = DEFAULT_METHOD  # the name that was asked for; with friction `solution.method` is longer

    @property
    def passed(self) -> bool:
        return self.failure is None and self.solution is not None and self.solution.certificate.passed

    @property
    def statuses(self) -> dict[str, int]:
        """Return the number of contacts in each state: open, sticking, slipping, ..."""
        found = [] if self.solution is None else [str(status) for status in self.solution.contact_status]
        return {status: found.count(status) for status in sorted(set(found))}


def solvable_form(file: str | Path) -> LocalProblem | ContactProblem:
    """Return a file's problem in local form, or with its bodies where M is singular as only contact holds them.

    A problem of matrices stays as it is.
    """
    return read_solvable(file)[0]


def read_solvable(file: str | Path) -> tuple[LocalProblem | ContactProblem, Ledger]:
    """Return what `solvable_form` returns, and what was read, converted, assumed and ignored of the file."""
    problem, ledger = read_problem_with_ledger(file)
    if isinstance(problem, ContactProblem) and is_of_matrices(file):
        return problem, ledger
    try:
        with naming(file):
            return (problem if isinstance(problem, LocalProblem) else local_form_of(problem)), ledger
    except SingularMatrix:
        if isinstance(problem, ContactProblem):
            return problem, ledger
        raise


def outline_of(problem: LocalProblem | ContactProblem) -> Outline:
    """Return the facts about a problem that are printed with its answer."""
    if isinstance(problem, LocalProblem):
        return Outline("local", problem.dimension, problem.contacts, problem.asymmetry)
    origin = problem.slip_origin
    dimension = 1 + (0 if origin is None else origin.shape[1])
    sizes = not problem.frictional, problem.dimension, problem.ties
    return Outline("bodies", dimension, problem.contacts, problem.asymmetry, *sizes)


def run_file_on_ranks(file: str, method: str, options: Mapping[str, Any]) -> FileOutcome:
    """Solve a file's problem on all ranks of MPI; collective. The first rank has the whole answer.

    The first rank reads the file and distributes the problem. It holds all of K while it does so; the others never hold
    more than an equal share of the rows and their part.

    Raises InvalidProblem, Unsupported, BackendMissing as `run_file` raises, on all ranks with the same message.
    """
    method = distributed_method(method)
    chosen, ranks = options_on_ranks(dict(options)), Ranks()
    outline, share = _read(file, ranks)
    began = time.perf_counter()
    solution: CollectedSolution | None = None
    failure: ContactQPError | None = None
    try:
        with naming(file):
            solution = collected(solve_distributed(problem_from_share(ranks, share), method, **chosen))
    except (NotConverged, NotCertified) as error:
        found: Any = error.solution
        solution = collected(found) if isinstance(found, DistributedSolution) else None
        failure = error
    except (NoEquilibrium, SeveralEquilibria, BackendFailed) as error:
        failure = error
    seconds = time.perf_counter() - began
    return _outcome(file, outline, solution, failure, seconds=seconds, options=options, method=method)


def _outcome(file: str, outline: Outline, solution: Any, error: ContactQPError | None, **fields: Any) -> FileOutcome:
    told = (None, None) if error is None else (f"{file}: {error}", error.code)
    return FileOutcome(file, outline, solution, told[0], code=told[1], **fields)


def _read(file: str, ranks: Ranks) -> tuple[Outline, ProblemRows]:
    """Return the facts about a file's problem and this rank's share of it; the whole problem is dropped."""
    found = ranks.on_first_rank(lambda: _first_reads(file))
    outline, whole = (None, None) if found is None else found
    share = share_from_first_rank(whole, ranks)
    shared_outline: Any = ranks.broadcast(outline)
    return shared_outline, share


def _first_reads(file: str) -> tuple[Outline, ProblemRows]:
    problem = solvable_form(file)
    if not isinstance(problem, ContactProblem):
        raise Unsupported(f"{file}: engine 'petsc': a problem in local form has no stiffness to deal out")
    return outline_of(problem), rows_of_problem(problem)


SHARED_FIGURES = ("penetration", "tension", "complementarity", "cone", "slip_direction")
LOCAL_FIGURES = (*SHARED_FIGURES, "joints", "natural_map", "siconos_error")
BODY_FIGURES = ("equilibrium", "balance", *SHARED_FIGURES, "tie")


def split_files(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split arguments into case files (and folders of them) and files of other codes."""
    foreign = [argument for argument in arguments if is_problem_file(argument)]
    return [argument for argument in arguments if argument not in foreign], foreign


def run_files(
    files: Sequence[str],
    methods: Sequence[str],
    knobs: Mapping[str, Any],
    *,
    drawn: bool = False,
    progress: bool = False,
    engine: str = SERIAL,
    time_limit: float | None = None,
    units: Units | None = None,
) -> list[FileOutcome]:
    """Solve every file by every method.

    Raises InvalidProblem: a stiffness with a unit for a problem that states none; names of units for one that states
    its own; two files of one name, whose pictures would be one; Unsupported: a picture or a table of a problem in local
    form, or of one that is dealt out to ranks.

    Parameters
    ----------
    files : sequence of str, files of problems in formats of other codes
    methods : sequence of str, names of methods; active-set where there is none
    knobs : mapping, options of the methods
    drawn : whether a picture or a table of the answer was asked for, which problems in local form have not
    progress : show a bar on stderr
    engine : "serial", or the engine that solves on ranks
    time_limit : seconds for each file and method
    units : what the units of files that state none are called; in one process alone
    """
    if not files:
        return []
    stems = [Path(file).stem for file in files]
    twice = next((stem for stem in stems if stems.count(stem) > 1), None)
    if drawn and twice is not None:
        raise InvalidProblem(f"--plot and --csv: expected files with distinct names, got {twice!r} more than once")
    if drawn and engine != SERIAL:
        raise Unsupported(f"{files[0]}: --plot and --csv in one process alone; --json tells the answer of all ranks")
    from rich.console import Console
    from rich.progress import track

    trials = [(file, method) for file in files for method in methods or (DEFAULT_METHOD,)]
    shown = track(trials, "solving", console=Console(stderr=True), transient=True, disable=not progress)
    outcomes = []
    for file, method in shown:
        with within_time(time_limit):
            chosen = options_of(method, methods or (method,), knobs)
            outcomes.append(run_file(file, method, chosen, engine, drawn=drawn, units=units))
    return outcomes


def run_file(
    file: str,
    method: str | None = None,
    options: Mapping[str, Any] | None = None,
    engine: str = SERIAL,
    *,
    drawn: bool = False,
    units: Units | None = None,
) -> FileOutcome:
    """Solve a file's problem.

    Parameters
    ----------
    file : a file of a problem in a format of another code
    method : name of the method, active-set by default
    options : mapping, optional
        Options of the method.
    engine : str
        "serial", or the engine that solves on ranks: then the call is collective, and the first rank has the answer.
    drawn, units : bool and Units, optional
        As in `run_files`.

    Raises
    ------
    InvalidProblem, Unsupported, BackendMissing
        The file, the method or its options are invalid. That a method finds no answer is an outcome.
    """
    if engine != SERIAL:
        return run_file_on_ranks(file, method or DEFAULT_METHOD, _in_units(file, None, options or {}))
    read, ledger = read_solvable(file)
    problem = called(file, read, units)
    chosen = _in_units(file, problem.units if isinstance(problem, ContactProblem) else None, options or {})
    if drawn and isinstance(problem, LocalProblem):
        raise Unsupported(f"{file}: --plot and --csv need displacements; a problem in local form has forces in --json")
    solution: Any = None
    failure: ContactQPError | None = None
    began = time.perf_counter()
    try:
        with naming(file):
            solution = solve(problem, method or DEFAULT_METHOD, **chosen)
    except (NotConverged, NotCertified) as error:
        solution, failure = error.solution, error
    except (NoEquilibrium, SeveralEquilibria, BackendFailed) as error:
        failure = error
    about = {"seconds": time.perf_counter() - began, "options": chosen, "ledger": ledger}
    return _outcome(file, outline_of(problem), solution, failure, method=method or DEFAULT_METHOD, **about)


def called(file: str, problem: LocalProblem | ContactProblem, units: Units | None) -> LocalProblem | ContactProblem:
    """Return a problem that states no units with names for them."""
    if units is None or not units.length:
        return problem
    has = "a problem in local form"
    if isinstance(problem, ContactProblem):
        if not problem.units.length:
            return problem.replace(units=units)
        has = f"{problem.units.length} and {problem.units.force}"
    raise InvalidProblem(f"--units: {file}: expected a deck or matrices without units, got {has}")


def _in_units(file: str, units: Units | None, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return options with their stiffnesses as numbers in a problem's units.

    Raises InvalidProblem: a stiffness with a unit, and the problem states none.
    """
    numbers = dict(options)
    for name, value in options.items():
        if isinstance(value, Quantity):
            if units is None or not units.length:
                raise InvalidProblem(
                    f"{file}: --{name}: expected a number, as this file states no units, got {value.text!r}"
                )
            numbers[name] = number(UnitSystem(units.length, units.force), value)
    return numbers


def write_files(outcomes: Sequence[FileOutcome], plot: Path | None, vtu: Path | None, csv: Path | None) -> list[Path]:
    """Draw answers, decks with their bodies, write fields and contacts, and return the files, named where several.

    Parameters
    ----------
    outcomes, plot, vtu, csv : answers, and the files of pictures, of fields of decks and of tables, None for none
    """
    from contactqp.pictures.contact_fields import fields_of_deck
    from contactqp.pictures.vtu import write_vtu
    from contactqp.study.answer_pictures import draw, named_file

    found = [(outcome, outcome.solution) for outcome in outcomes if isinstance(outcome.solution, Solution)]
    stems, written = {Path(outcome.file).stem for outcome, _ in found}, list[Path]()
    for outcome, solution in found:
        stem = Path(outcome.file).stem
        names = [stem][: len(stems) > 1] + [outcome.method][: len(found) > len(stems)]
        deck = read_deck(outcome.file) if is_deck(outcome.file) and (plot, vtu) != (None, None) else None
        if plot is not None:
            written.append(named_file(plot, names))
            draw(solution, written[-1], scene=deck, title=f"{stem}, {solution.method}")
        if vtu is not None and deck is not None:
            written.append(named_file(vtu, names))
            write_vtu(fields_of_deck(deck, solution), written[-1])
        if csv is not None:
            written.append(named_file(csv, names))
            write_whole(written[-1], contact_table([solution], [1.0], History.time_label).write_csv)
    return written


def figures(certificate: LocalCertificate | Certificate) -> dict[str, float]:
    """Return the certificate's figures by name."""
    names = LOCAL_FIGURES if isinstance(certificate, LocalCertificate) else BODY_FIGURES
    return {name: float(getattr(certificate, name)) for name in names}


def outcome_data(outcome: FileOutcome) -> dict[str, Any]:
    """Return one outcome as plain data for JSON."""
    solution, problem = outcome.solution, outcome.problem
    data: dict[str, Any] = {
        "file": outcome.file,
        "form": problem.form,
        "dimension": problem.dimension,
        "contacts": problem.contacts,
        "asymmetry": problem.asymmetry,
        "met": outcome.passed,
        "seconds": outcome.seconds,
    }
    if outcome.ledger is not None:
        data["ledger"] = outcome.ledger.data()
    if outcome.failure is not None:
        data |= {"failure": outcome.failure, "code": outcome.code}
    if solution is not None:
        certificate = solution.certificate
        data |= {
            "method": solution.method,
            "statuses": outcome.statuses,
            "certificate": {
                "passed": bool(certificate.passed),
                "basis": certificate.basis,
                "failures": list(certificate.failures),
                **{name: finite(value) for name, value in figures(certificate).items()},
            },
        }
    if isinstance(solution, LocalSolution):
        data |= {
            "iterations": solution.iterations,
            "force": solution.force.tolist(),
            "velocity": solution.velocity.tolist(),
            "joint_force": solution.joint_force.tolist(),
        }
    elif solution is not None:
        if isinstance(solution, Solution):
            data |= _energy_of(solution)
            data["units"] = {"length": solution.problem.units.length, "force": solution.problem.units.force}
        parts = {name: getattr(solution, name) for name in ANSWER_PARTS}
        data |= {name: part.tolist() for name, part in parts.items() if part is not None}
    return data


def _energy_of(solution: Solution) -> dict[str, Any]:
    """Return the energy of an answer, what is proven of it, and what the problem determines."""
    certificate = solution.certificate
    bounds = certificate.energy_bounds
    return {
        "unknowns": len(solution.displacement),
        "energy": solution.energy,
        "energy_bounds": None if bounds is None else list(bounds),
        "energy_error": certificate.energy_error,
        "force_error": certificate.force_error,
        "proven": certificate.proven,
        "determined": certificate.determined,
    }


# Contacts that a table on a screen lists; --json has all.
MOST_CONTACTS = 10
PASSED, REFUSED = Text("passed", style="green"), Text("REFUSED", style="red")


def print_outcomes(console: Console, outcomes: Sequence[FileOutcome], *, verbose: bool = False) -> None:
    """Print one row per file and method: sizes, the worst of each figure, the errors that other codes publish.

    Of energies without friction: the energy, and what is proven of it. Of a single answer with displacements that is
    its own table, the largest displacements and forces. Below is what was assumed of decks; with `verbose` all that
    became of their cards.
    """
    _print_tables(console, outcomes)
    ledgers = {outcome.file: outcome.ledger for outcome in outcomes if outcome.ledger and is_deck(outcome.file)}
    for ledger in ledgers.values():
        lines = [f"  {kind}: {line}" for kind, line in ledger if verbose or kind == "assumed"]
        print_wrapped(console, lines)


def _print_tables(console: Console, outcomes: Sequence[FileOutcome]) -> None:
    energies = [outcome for outcome in outcomes if outcome.problem.is_energy]
    if len(outcomes) == 1 and isinstance(outcomes[0].solution, Solution):
        energy = f": energy {outcomes[0].solution.energy:.12g}" if outcomes[0].problem.is_energy else ""
        console.print(f"[bold]{escape(outcomes[0].file)}[/bold]{energy}", soft_wrap=True)
        console.print(escape(outcomes[0].solution.summary()))
        return
    if energies:
        _print_energies(console, energies)
    outcomes = [outcome for outcome in outcomes if not outcome.problem.is_energy]
    if not outcomes:
        return
    header = ["file", "contacts", "", "algorithm", "state of contacts", *(n.replace("_", " ") for n in SHARED_FIGURES)]
    header += ["natural map", "siconos", "asymmetry", "seconds", "certificate"]
    short = ["file", "contacts", "", "state of contacts", "seconds", "certificate"]
    _print_rows(console, header, [_row(outcome) for outcome in outcomes], short)


def _print_rows(
    console: Console, header: Sequence[str], rows: Sequence[Sequence[str | Text]], short: Sequence[str]
) -> None:
    """Print a table; where it is too wide, one of the `short` columns, and the others below each row."""
    table = Table(box=box.SIMPLE, pad_edge=False)
    for title in header:
        table.add_column(title, no_wrap=title == "file")
    for row in rows:
        table.add_row(*(escape(cell) if isinstance(cell, str) else cell for cell in row))
    if fits(console, table):
        console.print(table)
        return
    named = [dict(zip(header, map(str, row), strict=True)) for row in rows]
    notes = [[", ".join(f"{k} {v}" for k, v in one.items() if v and k not in short)] for one in named]
    print_noted(console, [*short, ""], [[one[title] for title in short] for one in named], notes)


def _print_energies(console: Console, outcomes: Sequence[FileOutcome]) -> None:
    header = ["file", "method", "energy", "unknowns", "contacts", "ties", "error at most", "unique", "worst figure"]
    rows: list[list[str | Text]] = []
    for outcome in outcomes:
        problem, solution = outcome.problem, outcome.solution
        file, sizes = Path(outcome.file).name, map(str, (problem.unknowns, problem.contacts, problem.ties))
        found, sized = ["", ""], ["", "", ""]
        if isinstance(solution, Solution):
            certificate, values = solution.certificate, figures(solution.certificate)
            worst = max(values, key=lambda name: values[name])
            bound = "not proven" if certificate.energy_error is None else f"{certificate.energy_error:.1e}"
            about = f"{values[worst]:.1e} {worst.replace('_', ' ')}" if values[worst] > 0 else "0"
            found = [solution.method, f"{solution.energy:.12g}"]
            sized = [bound, certificate.determined or "", about]
        verdict = PASSED if outcome.passed else REFUSED
        rows.append([file, *found, *sizes, *sized, f"{outcome.seconds:.2f}", verdict])
    short = ["file", "method", "energy", "seconds", "certificate"]
    _print_rows(console, [*header, "seconds", "certificate"], rows, short)


def _row(outcome: FileOutcome) -> list[str | Text]:
    solution = outcome.solution
    values = figures(solution.certificate) if solution is not None else {}
    errors = (values.get(name) for name in (*SHARED_FIGURES, "natural_map", "siconos_error"))
    dimension = outcome.problem.dimension
    states = ", ".join(f"{number} {status}" for status, number in outcome.statuses.items())
    return [
        Path(outcome.file).name,
        f"{outcome.problem.contacts}",
        f"{dimension}D" if dimension > 1 else "",  # unknown without tangential rows
        solution.method if solution is not None else "",
        states,
        *("" if value is None else f"{value:.1e}" for value in errors),
        f"{outcome.problem.asymmetry:.0e}",
        f"{outcome.seconds:.2f}",
        PASSED if outcome.passed else REFUSED,
    ]


def vector_text(values: Array) -> str:
    """Return a vector as text: ``(1, 2.5, -3)``."""
    return "(" + ", ".join(f"{value:.6g}" for value in values) + ")"
