"""What went wrong with an answer, in words: hypotheses that explain all of it, else what it violates."""

from __future__ import annotations

from contactqp.certificate import Certificate
from contactqp.oracle.finding import Finding
from contactqp.oracle.foreign_answer import GivenAnswer
from contactqp.oracle.symptoms import symptoms
from contactqp.problem import ContactProblem
from contactqp.solution import Solution
from contactqp.violations import Answer


def diagnose(
    problem: ContactProblem, given: GivenAnswer, answer: Answer, certificate: Certificate, right: Solution | None
) -> tuple[Finding, ...]:
    """Causes that explain the answer, then what it violates."""
    del given, right
    return tuple(symptoms(problem, answer, certificate))


def paragraph(certificate: Certificate, findings: tuple[Finding, ...], why_not: str | None) -> str:
    """The findings as one paragraph."""
    if certificate.passed:
        return "nothing is wrong with this answer"
    told = [one for one in findings if one.cause] or list(findings)
    said = [_sentence(one.text) for one in told]
    if why_not is not None:
        said.append(_sentence(f"no right answer can be set beside it ({why_not})"))
    return " ".join(said) or _sentence("; ".join(certificate.failures))


def _sentence(text: str) -> str:
    return text if text.endswith((".", "?")) else f"{text}."
