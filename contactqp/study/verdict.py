"""What is said of somebody else's answer, be it to a case or to a file of forces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from contactqp.exchange.ledger import Ledger
from contactqp.model.local_problem import LocalProblem, LocalSolution
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import LocalCertificate, Solution
from contactqp.oracle.judged_answer import JudgedAnswer
from contactqp.study.check_options import as_options
from contactqp.study.friction_files import figures, finite


class JudgedContact(Protocol):
    """What is said of one contact."""

    def data(self) -> dict[str, Any]:
        """All that is known, for JSON."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """What is said of a candidate."""

    problem_file: str
    candidate_file: str
    problem: ContactProblem | LocalProblem
    certificate: JudgedAnswer | LocalCertificate
    worst: Sequence[JudgedContact]
    right: Solution | LocalSolution | None  # looked for where the candidate is wrong
    why_not: str | None  # why there is no solution to set beside it
    ledgers: tuple[Ledger, ...]  # of the problem and of the candidate
    notes: tuple[str, ...] = ()  # beside those of the certificate

    @property
    def passed(self) -> bool:
        return self.certificate.passed

    def data(self) -> dict[str, Any]:
        """All that is known, for JSON."""
        certificate = self.certificate
        return {
            "problem": self.problem_file,
            "candidate": self.candidate_file,
            "contacts": self.problem.contacts,
            "right": self.passed,
            **(_judged_data(certificate) if isinstance(certificate, JudgedAnswer) else {}),
            "tolerance": certificate.tolerance,
            "certificate": {name: finite(value) for name, value in figures(certificate).items()},
            "failures": list(certificate.failures),
            "notes": [*self.notes, *certificate.notes],
            "worst": [one.data() for one in self.worst],
            "right_values": None if self.right is None else {"method": self.right.method},
            "no_right_values": self.why_not,
            "ledgers": [ledger.data() for ledger in self.ledgers],
        }


def _judged_data(certificate: JudgedAnswer) -> dict[str, Any]:
    return {
        "proven": certificate.proven,
        "basis": certificate.basis,
        "diagnosis": as_options(certificate.diagnosis),
        "findings": [{"kind": one.kind, "text": one.text, "cause": one.cause} for one in certificate.findings],
        "recovered": list(certificate.recovered),
    }


def finite_list(values: NDArray[np.float64] | None) -> list[float | None] | None:
    """Numbers for JSON, None where they are not finite."""
    return None if values is None else [finite(float(value)) for value in values]
