"""Find the mistake that explains a wrong answer, else list what it violates, in words.

A hypothesis is tested with the problem and the right answer: with the mistake undone, the answer must be right, or more
accurate by two digits; or it must be the right answer to another, named problem. Families of hypotheses are tested in
turn, those that need no solution first; of the first family that explains the answer, the best explanation and all
equally good ones are returned. If only an unnamed factor explains it, a sign or a unit may hide another mistake.

One family consists of right answers to another question: gaps, contacts, ties, loads or friction omitted or
changed. Each of its hypotheses is another problem, which is solved and compared with the given answer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.messages import unit_of
from contactqp.certificate.uniqueness import POSSIBLE, SEVERAL
from contactqp.errors import ContactQPError, NoEquilibrium
from contactqp.linalg.dense import unknown_scale
from contactqp.linalg.iteration import grid_operations, iterated
from contactqp.model.arrays import Array, Indices, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Certificate, Solution
from contactqp.oracle.diagnosis.evidence import LEFT, NAMED, Effort, Evidence, Explanation, Finding, symptoms
from contactqp.oracle.diagnosis.explanations import duplicates, laws, one_value, shares, shifted
from contactqp.oracle.diagnosis.orders import orders, two_mistakes
from contactqp.oracle.diagnosis.scales import inexact, printed, scales
from contactqp.oracle.foreign.judging import (
    EQUALLY_GOOD,
    GivenAnswer,
    JudgedContact,
    determined_gaps,
    held_against,
    missing_parts,
)
from contactqp.solving.solve import solve

# Larger problems are not solved again for a hypothesis; the second limit is for other rows, which need a
# factorisation.
LARGEST, LARGEST_OF_OTHER_ROWS, MOST_CONTACTS = 200_000, 60_000, 1500


class Question(NamedTuple):
    """Another problem, and the finding if the answer is its solution."""

    kind: str
    text: str
    problem: ContactProblem
    kept: Indices | None = None  # its contacts among those of the problem, None for all
    ties: int = 0  # how many of its first ties are bilateral contacts
    held: Indices | None = None  # the numbers of these contacts


def too_large(problem: ContactProblem) -> bool:
    """Return whether the problem is too large for some other questions."""
    return problem.dimension > LARGEST_OF_OTHER_ROWS or problem.contacts > MOST_CONTACTS


def other_rows(problem: ContactProblem, question: Question) -> bool:
    """Return whether a question needs another factorisation."""
    return question.kept is not None or question.problem.ties != problem.ties


# Operations of any question, per entry of the stiffness, per cube of the condensed rows, and if no answer is found;
# 1e9 take about a second.
CALL, PER_ENTRY, PER_CUBE, HOPELESS = 1e7, 200.0, 5.0, 6e8
# Limits for questions with friction: steps of an algorithm, and combinations of states.
STEPS_WITH_FRICTION = 20


def predicted_operations(problem: ContactProblem, factorised: bool) -> float:
    """Return the predicted operations of solving a problem, with or without its factorisation."""
    rows = problem.contacts + problem.ties
    if problem.frictional and problem.slip_origin is not None:
        rows += problem.slip_origin.size
    condensed = (2 if problem.frictional else 1) * CALL + PER_CUBE * float(rows) ** 3
    entries, size = float(problem.stiffness_rows.nnz), float(problem.dimension)
    return condensed + PER_ENTRY * entries + (grid_operations(size, entries / size) if factorised else 0.0)


def other_questions(evidence: Evidence) -> Iterator[Explanation]:
    """Yield explanations by other questions whose right answer was given."""
    problem = evidence.problem
    if problem.dimension > LARGEST or problem.contacts > MOST_CONTACTS or iterated(problem):
        return
    D, balanced, allowed = balance(evidence)
    for question in _questions(evidence):
        if other_rows(problem, question) and too_large(problem):
            continue
        if float(np.max(abs(D * question.problem.load - balanced), initial=0.0)) > allowed:
            continue
        if evidence.effort.exhausted:
            evidence.effort.unasked.append(question.kind)
            continue
        evidence.effort.spent += predicted_operations(question.problem, other_rows(problem, question))
        answer = _answered(problem, question)
        if isinstance(answer, ContactQPError):  # without friction absence is proven soon; otherwise all attempts failed
            proven = isinstance(answer, NoEquilibrium) and not question.problem.frictional
            evidence.effort.spent += 0.0 if proven else HOPELESS
            continue
        left = evidence.apart(evidence.given, answer)
        if left <= LEFT and (evidence.explains(left) or evidence.right is None):
            yield Explanation(Finding(question.kind, question.text, True), left)


def balance(evidence: Evidence) -> tuple[Vector, Vector, float]:
    """Return D = 1/sqrt(K_jj), D times the load (n,) balanced by a complete answer, and the largest distance of other
    loads.

    |D r| <= |D K D| |D^-1 du| + sum |D E'dl| in largest entries; an explanation has D^-1 du and forces within LEFT of
    the answer's. Every load is near enough if a part of the answer was not given.
    """
    problem, given, D = evidence.problem, evidence.given, unknown_scale(evidence.problem)
    if evidence.recovered or given.displacement is None:
        return D, np.zeros(problem.dimension), np.inf
    answer = given.filled(problem)
    balanced = problem.stiffness @ answer.displacement
    balanced = balanced + problem.normal.T @ answer.normal_force + problem.tie.T @ answer.tie_force
    rows = np.asarray(abs(sp.csr_matrix(problem.stiffness)) @ D) * D
    size = float(np.max(rows, initial=0.0)) * float(np.max(abs(answer.displacement) / D, initial=0.0))
    parts = [(problem.normal, answer.normal_force), (problem.tie, answer.tie_force)]
    if problem.tangent is not None and answer.friction_force is not None:
        friction_force = answer.friction_force.ravel()
        balanced = balanced + problem.tangent.T @ friction_force
        parts.append((problem.tangent, friction_force))
    largest = 0.0
    for matrix, force in parts:
        weight = np.sqrt(np.asarray(matrix.multiply(matrix) @ D**2).ravel())
        largest = max(largest, float(np.max(weight * abs(force), initial=0.0)))
    count = sum(int(np.max(np.diff(sp.csc_matrix(matrix).indptr), initial=0)) for matrix, _ in parts)
    return D, np.asarray(D * balanced), 2 * LEFT * (size + count * largest)


def _answered(problem: ContactProblem, question: Question) -> Answer | ContactQPError:
    """Return the (cached) right answer to the other question as one to this problem, or the reason why there is
    none.
    """
    answers = held_against(problem).others
    key = (question.text, *(None if which is None else which.tobytes() for which in (question.kept, question.held)))
    if key not in answers:
        try:
            answers[key] = _solved(problem, question)
        except ContactQPError as error:
            answers[key] = error.with_traceback(None)
    return answers[key]


def _solved(problem: ContactProblem, question: Question) -> Answer:
    found = solve(question.problem, max_iter=STEPS_WITH_FRICTION if question.problem.frictional else None)
    if question.kept is None and question.held is None:
        return Answer(found.displacement, found.normal_force, _friction(problem, found, None), _ties(problem, found, 0))
    kept = np.arange(problem.contacts) if question.kept is None else question.kept
    force = np.zeros(problem.contacts)
    force[kept] = found.normal_force
    if question.held is not None:
        force[question.held] = found.tie_force[: question.ties]
    return Answer(found.displacement, force, _friction(problem, found, kept), _ties(problem, found, question.ties))


def _friction(problem: ContactProblem, found: Solution, kept: Indices | None) -> Array | None:
    if problem.slip_origin is None:
        return None
    friction = np.zeros(problem.slip_origin.shape)
    if found.friction_force is not None:
        friction[slice(None) if kept is None else kept] = found.friction_force
    return friction


def _ties(problem: ContactProblem, found: Solution, skipped: int) -> Array:
    rest = found.tie_force[skipped:]
    return rest if len(rest) == problem.ties else np.zeros(problem.ties)


def _questions(evidence: Evidence) -> Iterator[Question]:
    problem, gap = evidence.problem, evidence.problem.gap
    closing = np.isfinite(gap)  # the others never close, for any change of gaps
    if np.any(gap[closing] != 0):
        without = problem.replace(gap=np.where(closing, 0.0, gap))
        yield Question("gap-ignored", "it is the right answer without the initial gaps", without)
        text = "it is the right answer with the initial gaps of the opposite sign"
        yield Question("gap-sign", text, problem.replace(gap=np.where(closing, -gap, gap)))
        found = evidence.certificate.violations
        pushes = found is not None and bool(np.any(found.force_measure > evidence.certificate.tolerance))
        # Without any force, large gaps are the same as no contact.
        for factor in (1e3, 1e-3) if pushes else ():
            text = f"it is the right answer with the initial gaps {factor:g} times as large: in another unit?"
            yield Question("gap-unit", text, problem.replace(gap=factor * gap))
    if np.any(gap < 0) and np.any(gap > 0):
        text = "it is the right answer without the initial overlaps: where bodies overlap the gap was taken as zero"
        yield Question("overlap-ignored", text, problem.replace(gap=np.maximum(gap, 0.0)))
    if np.any(problem.load):
        for factor, words in ((-1.0, "the load with the opposite sign"), (0.0, "no load"), (2.0, "twice the load")):
            yield Question("load", f"it is the right answer to {words}", problem.replace(load=factor * problem.load))
        yield Question("load", "it is the right answer to half the load", problem.replace(load=0.5 * problem.load))
    if problem.ties:
        text = "it is the right answer without the ties"
        yield Question("ties-ignored", text, problem.replace(tie=None, tie_value=None))
        if np.any(problem.tie_value):
            text = "it is the right answer with all tie values zero"
            yield Question("tie-value-ignored", text, problem.replace(tie_value=0 * problem.tie_value))
    if problem.frictional:
        frictionless = problem.replace(friction=np.zeros(problem.contacts))
        yield Question("friction-ignored", "it is the right answer without friction", frictionless)
        if problem.slip_origin is not None and np.any(problem.slip_origin):
            text = "it is the right answer with slip counted from zero: slip_origin was left out"
            yield Question("slip-origin", text, problem.replace(slip_origin=0 * problem.slip_origin))
    yield from _without_contacts(evidence)
    yield from _held(evidence)


def _without_contacts(evidence: Evidence) -> Iterator[Question]:
    """Yield the problems without contacts, and without those that penetrate and have no force."""
    problem, found = evidence.problem, evidence.certificate.violations
    none = np.zeros(0, dtype=np.intp)
    if found is None or not problem.contacts:
        return
    limit = evidence.certificate.tolerance
    largest = float(np.max(found.force_measure, initial=0.0))
    if largest <= limit:
        yield Question("free", "it is the right answer without any contact", problem.with_contacts(none), none)
    missed = np.flatnonzero((found.penetration > limit) & (found.force_measure <= max(limit, 1e-6 * largest)))
    if evidence.given.displacement is None:
        missed = _unpressed(evidence)
    if largest > limit and missed.size and len(missed) < problem.contacts:
        kept = np.setdiff1d(np.arange(problem.contacts), missed)
        names = [problem.contact_name(int(i)) for i in missed[:NAMED]]
        more = f" and {len(missed) - NAMED} more" if len(missed) > NAMED else ""
        text = f"it is the right answer without {', '.join(names)}{more}: contact was missed there"
        yield Question("contact-missed", text, problem.with_contacts(kept), kept)


def _unpressed(evidence: Evidence) -> Indices:
    """Return the contacts without force that have one in the right answer."""
    if evidence.right is None:
        return np.zeros(0, dtype=np.intp)
    should = evidence.right.normal_force
    largest = float(np.max(abs(should), initial=0.0))
    return np.flatnonzero((should > 1e-6 * largest) & (abs(evidence.answer.normal_force) <= 1e-9 * largest))


def _held(evidence: Evidence) -> Iterator[Question]:
    """Yield the problems with bilateral contacts: all of them, those with a force, or those that touch."""
    problem, found = evidence.problem, evidence.certificate.violations
    if not problem.contacts or found is None or problem.frictional:
        return
    limit = evidence.certificate.tolerance
    acting = np.flatnonzero(found.force_measure > limit)
    touching = np.flatnonzero((found.gap_measure <= limit) | ~np.isfinite(found.lengths))
    pulling = np.flatnonzero(found.tension > limit)
    tried: set[bytes] = set()
    for held in (np.arange(problem.contacts), acting, touching):
        held = held[np.isfinite(problem.gap[held])]
        key = held.astype(np.intp).tobytes()
        if not held.size or key in tried:
            continue
        tried.add(key)
        kept = np.setdiff1d(np.arange(problem.contacts), held)
        rows = sp.vstack([sp.csr_matrix(problem.normal[held]), sp.csr_matrix(problem.tie)])
        values = np.concatenate([problem.gap[held], problem.tie_value])
        glued = problem.with_contacts(kept).replace(tie=rows, tie_value=values)
        names = ", ".join(problem.contact_name(int(i)) for i in pulling[:NAMED])
        what = "all contacts" if len(held) == problem.contacts else f"{len(held)} contacts"
        text = f"{what} are held both ways, as if glued" + (f": {names} in tension" if names else "")
        yield Question("bilateral", text, glued, kept, len(held), held)


Family = Callable[[Evidence], Iterator[Explanation]]
# Groups of families; within a group the best explanation counts.
GROUPS: tuple[tuple[Family, ...], ...] = (
    (printed,),
    (scales, orders),
    (one_value, shifted, laws, other_questions, duplicates),
    (shares,),
    (inexact,),
)
# Explanations with an error up to this multiple of the best one's are equally good.
AS_GOOD, NOTHING_LEFT = 10.0, 1e-6


# Operations for other questions in a diagnosis (about a second), unless the right answer takes more.
BUDGET = 1e9


def diagnose(
    problem: ContactProblem,
    given: GivenAnswer,
    answer: Answer,
    certificate: Certificate,
    right: Solution | None,
    operations: float | None = None,
) -> tuple[Finding, ...]:
    """Return the causes of a refused answer, then its violations, then what was not examined.

    Solving other questions may take so many `operations`, by default as many as the right answer and at least `BUDGET`.
    These are predicted, not timed, so that the findings do not depend on the machine.

    Parameters
    ----------
    problem : ContactProblem
    given, answer
        What came from another code, and the complete answer that was judged.
    certificate : the certificate of the answer
    right : Solution or None, the right answer, where one was found
    operations : how many operations other questions may take
    """
    violated = tuple(symptoms(problem, answer, certificate))
    if certificate.violations is None:
        return violated
    recovered = bool(missing_parts(problem, given))
    if operations is None:
        operations = max(BUDGET, predicted_operations(problem, factorised=True))
    evidence = Evidence(problem, given, answer, certificate, right, recovered, Effort(operations))
    found = _explained(evidence)
    if all(one.finding.kind == "scaled" for one in found):
        found = two_mistakes(evidence, _explained) or found
    if found:
        return (*_best(found), *violated, *_others(problem, right))
    return (*violated, *_not_examined(problem), *_not_asked(evidence.effort), *_others(problem, right))


def _explained(evidence: Evidence) -> list[Explanation]:
    """Return the findings of the first group of families that explains the answer."""
    for group in GROUPS:
        found = [one for family in group for one in family(evidence) if one.error <= LEFT]
        if found:
            return found
    return []


def _others(problem: ContactProblem, right: Solution | None) -> Iterator[Finding]:
    """Yield the finding that the right answer may not be unique."""
    if right is None:
        return
    if SEVERAL in right.certificate.uniqueness:
        yield Finding("several", "other answers exist at this load; the nearest that was found is set beside this one")
    elif POSSIBLE in right.certificate.uniqueness:
        yield Finding("several", "other answers are not excluded; one that was found is set beside this one")
    elif not np.all(determined_gaps(problem, right)):
        yield Finding("several", EQUALLY_GOOD)


def _best(found: list[Explanation]) -> list[Finding]:
    """Return the best explanation and equally good ones, one of each kind."""
    least = min(one.error for one in found)
    kept: dict[str, Explanation] = {}
    for one in found:
        if one.error <= max(AS_GOOD * least, NOTHING_LEFT):
            kept.setdefault(one.finding.kind, one)
    return [finding for one in kept.values() for finding in (one.finding, *one.beside)]


def _not_examined(problem: ContactProblem) -> Iterator[Finding]:
    if too_large(problem) or iterated(problem):
        text = (
            f"not examined, the problem being large ({problem.dimension} unknowns, {problem.contacts} contacts): "
            "whether it is the right answer to some other question, such as without ties or with contacts glued"
        )
        yield Finding("not-examined", text)


def _not_asked(effort: Effort) -> Iterator[Finding]:
    if effort.unasked:
        kinds = ", ".join(dict.fromkeys(effort.unasked))
        text = (
            f"not examined after {effort.allowed:.3g} operations: whether it is the right answer to "
            f"{len(effort.unasked)} other questions ({kinds}); in Python, findings_within(operations) of what certify "
            "returns asks more"
        )
        yield Finding("not-examined", text)


def paragraph(
    certificate: Certificate,
    problem: ContactProblem,
    findings: tuple[Finding, ...],
    wrong: Sequence[JudgedContact],
    why_not: str | None,
) -> str:
    """Return the findings as one paragraph, without a cause with the right values of the worst contact.

    Parameters
    ----------
    certificate : Certificate
    problem : ContactProblem
    findings : tuple of Finding, in the order of output
    wrong : sequence of JudgedContact, the worst first
    why_not : str or None, the reason why no right answer is known, None if there is one
    """
    worst, others = (wrong[0] if wrong else None), len(wrong) - 1
    if certificate.passed:
        return "nothing is wrong with this answer"
    causes: list[str] = []
    for one in findings:
        if one.together and causes:
            causes[-1] += f", and {one.text}"
        elif one.cause:
            causes.append(one.text)
    sentences = [*causes[:1], *(f"or, the same numbers: {text}" for text in causes[1:3])]
    if not causes:
        sentences = [one.text for one in findings if one.kind != "several"] or list(certificate.failures)
        if worst is not None and worst.right_normal_force is not None:
            force, length = unit_of(problem.units.force), unit_of(problem.units.length)
            values = f"a force of {worst.right_normal_force:.6g}{force} at a gap of {worst.right_gap:.3g}{length}"
            more = f", and {others} other contact{'s are' if others > 1 else ' is'} wrong too" if others else ""
            sentences.append(f"right would be {values} at {worst.name}{more}")
    sentences += [one.text for one in findings if one.kind == "several"]
    if why_not is not None:
        sentences.append(f"no right answer can be set beside it ({why_not})")
    return "; ".join(sentences)
