"""What is said of a file of frictional contact and of its answer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from contactqp.exchange.local_form import SingularMatrix, local_form_of
from contactqp.exchange.problem_files import is_of_matrices, read_problem
from contactqp.exchange.refusal import naming
from contactqp.model.local_problem import LocalProblem, LocalSolution
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution

if TYPE_CHECKING:
    from contactqp.distributed.collecting import CollectedSolution


@dataclass(frozen=True)
class Outline:
    """What is said of a problem beside its answer; on several ranks nobody keeps the problem itself."""

    form: str  # as solved: "local" wherever there is one, else "bodies"
    dimension: int  # 1 where nothing says it
    contacts: int
    asymmetry: float


@dataclass(frozen=True, eq=False)
class FileOutcome:
    """What one method made of one file."""

    file: str
    problem: Outline
    solution: LocalSolution | Solution | CollectedSolution | None  # also one that the certificate refuses
    failure: str | None  # why there is no answer
    seconds: float  # of solving
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        return self.failure is None and self.solution is not None and self.solution.certificate.passed

    @property
    def statuses(self) -> dict[str, int]:
        """How many contacts are open, sticking, slipping, ..."""
        if self.solution is None:
            return {}
        found = [str(status) for status in self.solution.contact_status]
        return {status: found.count(status) for status in sorted(set(found))}


def solvable_form(file: str | Path) -> LocalProblem | ContactProblem:
    """A file's problem in local form; with its bodies where nothing but contact holds them, so that M is singular.

    A problem of matrices stays as it is.
    """
    problem = read_problem(file)
    if isinstance(problem, ContactProblem) and is_of_matrices(file):
        return problem
    try:
        with naming(file):
            return local_form_of(problem)
    except SingularMatrix:
        if isinstance(problem, ContactProblem):
            return problem
        raise


def outline_of(problem: LocalProblem | ContactProblem) -> Outline:
    if isinstance(problem, LocalProblem):
        return Outline("local", problem.dimension, problem.contacts, problem.asymmetry)
    origin = problem.slip_origin
    return Outline("bodies", 1 + (0 if origin is None else origin.shape[1]), problem.contacts, problem.asymmetry)
