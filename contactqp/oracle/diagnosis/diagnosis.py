"""What went wrong with an answer, in words: hypotheses that explain all of it, else what it violates.

A hypothesis is tested against the problem and the right answer: undone, the answer must be right, or nearer to right by
two digits; or it must be the right answer to the other question that is named. The families are asked in turn, those
that take no solution first, and the first that explains the answer is believed: within it the best explanation, and
any other that is as good. Where none does but a factor without a name, a sign or a unit may hide another mistake.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from contactqp.certificate.uniqueness import POSSIBLE, SEVERAL
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Certificate, Solution
from contactqp.oracle.diagnosis.evidence import LEFT, Evidence, Explanation, Finding, symptoms, unit_of
from contactqp.oracle.diagnosis.laws import laws
from contactqp.oracle.diagnosis.mix_ups import duplicates, one_value, shares, shifted
from contactqp.oracle.diagnosis.orders import orders, two_mistakes
from contactqp.oracle.diagnosis.other_questions import other_questions, too_large
from contactqp.oracle.diagnosis.scales import inexact, printed, scales
from contactqp.oracle.foreign.foreign_answer import GivenAnswer
from contactqp.oracle.foreign.judged_contacts import JudgedContact
from contactqp.oracle.foreign.recovery import missing_parts

Family = Callable[[Evidence], Iterator[Explanation]]
# Families that are weighed against each other, group after group.
GROUPS: tuple[tuple[Family, ...], ...] = (
    (printed,),
    (scales, orders),
    (one_value, shifted, laws, other_questions, duplicates),
    (shares,),
    (inexact,),
)
# Explanations that leave this many times what the best one leaves are as good.
AS_GOOD, NOTHING_LEFT = 10.0, 1e-6


def diagnose(
    problem: ContactProblem, given: GivenAnswer, answer: Answer, certificate: Certificate, right: Solution | None
) -> tuple[Finding, ...]:
    """Causes that explain the answer, then what it violates."""
    violated = tuple(symptoms(problem, answer, certificate))
    if certificate.violations is None:
        return violated
    recovered = bool(missing_parts(problem, given))
    evidence = Evidence(problem, given, answer, certificate, right, recovered)
    found = _explained(evidence)
    if all(one.finding.kind == "scaled" for one in found):
        found = two_mistakes(evidence, _explained) or found
    if found:
        return (*_best(found), *violated, *_others(right))
    return (*violated, *_not_examined(problem), *_others(right))


def _explained(evidence: Evidence) -> list[Explanation]:
    """What the first group of families that explains the answer says."""
    for group in GROUPS:
        found = [one for family in group for one in family(evidence) if one.left <= LEFT]
        if found:
            return found
    return []


def _others(right: Solution | None) -> Iterator[Finding]:
    """Yield the finding that other answers may be as right as the one that was found."""
    if right is None:
        return
    if SEVERAL in right.certificate.uniqueness:
        yield Finding("several", "other answers exist at this load; the nearest that was found is set beside this one")
    elif POSSIBLE in right.certificate.uniqueness:
        yield Finding("several", "other answers are not excluded; one that was found is set beside this one")


def _best(found: list[Explanation]) -> list[Finding]:
    """The best explanation and those that are as good, one of a kind."""
    least = min(one.left for one in found)
    kept: dict[str, Explanation] = {}
    for one in found:
        if one.left <= max(AS_GOOD * least, NOTHING_LEFT):
            kept.setdefault(one.finding.kind, one)
    return [finding for one in kept.values() for finding in (one.finding, *one.beside)]


def _not_examined(problem: ContactProblem) -> Iterator[Finding]:
    if too_large(problem):
        text = (
            f"not examined, the problem being large ({problem.dimension} unknowns, {problem.contacts} contacts): "
            "whether it is the right answer to some other question, such as without ties or with contacts glued"
        )
        yield Finding("not-examined", text)


def paragraph(
    certificate: Certificate,
    problem: ContactProblem,
    findings: tuple[Finding, ...],
    worst: JudgedContact | None,
    why_not: str | None,
) -> str:
    """The findings as one paragraph; without a cause the right values of the worst contact stand with them."""
    if certificate.passed:
        return "nothing is wrong with this answer"
    causes: list[str] = []
    for one in findings:
        if one.together and causes:
            causes[-1] += f", and {one.text}"
        elif one.cause:
            causes.append(one.text)
    said = [*causes[:1], *(f"or, the same numbers: {text}" for text in causes[1:3])]
    if not causes:
        said = [one.text for one in findings if one.kind != "several"] or list(certificate.failures)
        if worst is not None and worst.right_normal_force is not None:
            force, length = unit_of(problem.units.force), unit_of(problem.units.length)
            values = f"a force of {worst.right_normal_force:.6g}{force} at a gap of {worst.right_gap:.3g}{length}"
            said.append(f"right would be {values} at {worst.name}")
    said += [one.text for one in findings if one.kind == "several"]
    if why_not is not None:
        said.append(f"no right answer can be set beside it ({why_not})")
    return "; ".join(said)
