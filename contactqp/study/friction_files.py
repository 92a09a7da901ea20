"""Files of frictional contact, solved: one outcome a file and method, with what its certificate says."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from contactqp.errors import BackendFailed, InvalidProblem, NoEquilibrium, NotCertified, NotConverged, SeveralEquilibria
from contactqp.exchange.problem_files import is_problem_file
from contactqp.exchange.refusal import naming
from contactqp.model.engines import SERIAL
from contactqp.model.local_problem import LocalSolution
from contactqp.model.solution import Certificate, LocalCertificate
from contactqp.solving.solve import solve
from contactqp.study.file_outcome import FileOutcome, outline_of, solvable_form

if TYPE_CHECKING:
    pass

SHARED_FIGURES = ("penetration", "tension", "complementarity", "cone", "slip_direction")
LOCAL_FIGURES = (*SHARED_FIGURES, "joints", "natural_map", "siconos_error")
BODY_FIGURES = ("equilibrium", "balance", *SHARED_FIGURES, "tie")
ANSWER_PARTS = ("displacement", "normal_force", "friction_force", "tie_force")
DEFAULT_METHOD = "active-set"


def split_files(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Case files (and folders of them), and files of other codes."""
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
) -> list[FileOutcome]:
    """Every file by every method, by our own where none is named; `progress` shows a bar on stderr.

    Raises
    ------
    InvalidProblem
        A picture was asked for, or a stiffness with a unit: these files have no geometry and no units.
    """
    if files and drawn:
        raise InvalidProblem(f"{files[0]}: --plot and --vtu need a case file, this file has no geometry")
    stiffness = next((name for name in ("penalty", "perturbation") if files and name in knobs), None)
    if stiffness is not None:
        raise InvalidProblem(f"{files[0]}: --{stiffness} needs a case file, this file has no units")
    if not files:
        return []
    from rich.console import Console
    from rich.progress import track

    trials = [(file, method) for file in files for method in methods or (DEFAULT_METHOD,)]
    shown = track(trials, "solving", console=Console(stderr=True), transient=True, disable=not progress)
    return [run_file(file, method, knobs, engine) for file, method in shown]


def run_file(
    file: str, method: str | None = None, options: Mapping[str, Any] | None = None, engine: str = SERIAL
) -> FileOutcome:
    """Solve a file's problem; with an engine of several ranks, where the answer is whole on the first, collectively.

    Raises
    ------
    InvalidProblem, Unsupported, BackendMissing
        The file, the method or its options are no good. That a method finds no answer is an outcome.
    """
    if engine != SERIAL:
        from contactqp.study.files_on_ranks import run_file_on_ranks

        return run_file_on_ranks(file, method or DEFAULT_METHOD, options or {})
    problem, chosen = solvable_form(file), dict(options or {})
    solution: Any
    began = time.perf_counter()
    try:
        with naming(file):
            solution, failure = solve(problem, method or DEFAULT_METHOD, **chosen), None
    except (NotConverged, NotCertified) as error:
        solution, failure = error.solution, f"{file}: {error}"
    except (NoEquilibrium, SeveralEquilibria, BackendFailed) as error:
        solution, failure = None, f"{file}: {error}"
    return FileOutcome(file, outline_of(problem), solution, failure, time.perf_counter() - began, chosen)


def figures(certificate: LocalCertificate | Certificate) -> dict[str, float]:
    """The certificate's figures by name."""
    names = LOCAL_FIGURES if isinstance(certificate, LocalCertificate) else BODY_FIGURES
    return {name: float(getattr(certificate, name)) for name in names}


def outcome_data(outcome: FileOutcome) -> dict[str, Any]:
    """All that is known of one outcome, for JSON."""
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
    if outcome.failure is not None:
        data["failure"] = outcome.failure
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
        parts = {
            name: getattr(solution, name) for name in ("displacement", "normal_force", "friction_force", "tie_force")
        }
        data |= {name: part.tolist() for name, part in parts.items() if part is not None}
    return data


def finite(value: float) -> float | None:
    """JSON has no numbers that are not finite."""
    return float(value) if math.isfinite(value) else None
