"""Complete and certify an answer of another code, and compare it with the right one contact by contact.

Missing parts are recovered from the others (`recovery`), and the first completion that passes the certificate is taken.
Of several equilibria the one nearest to the given answer is the right one.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from contactqp.certificate.certificate import certificate_of
from contactqp.certificate.idle_rows import ActingRows, acting_rows
from contactqp.certificate.number_range import NearOne, near_one
from contactqp.certificate.uniqueness import POSSIBLE, SEVERAL
from contactqp.errors import ContactQPError
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.dense import unknown_scale
from contactqp.linalg.measures import lengths_that_meet
from contactqp.model.arrays import Array, Mask, Vector, all_finite, time_is_up
from contactqp.model.coulomb import slips
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import ReadOnly
from contactqp.model.solution import ANSWER_PARTS, BY_ENERGY, Answer, AnswerOf, Candidate, Certificate, Solution
from contactqp.model.summary import aligned, finite, without_rounding
from contactqp.oracle.foreign.recovery import displaced, pressed
from contactqp.solving.equilibria import equilibria
from contactqp.solving.solve import begin, of_problem, solve

# The most contacts for which all combinations of open, stick and slip are tried: 256, each 1 to 3 ms.
FEW = 4
# Steps of each friction algorithm in the search for an equilibrium near a given answer.
STEPS_FROM_ANSWER = 20


@dataclass(frozen=True, eq=False)
class GivenAnswer(AnswerOf[Vector | None, Array | None], ReadOnly):
    """The given parts of an answer in the problem's order, signs and units, None for missing ones."""

    compression: str = "positive"  # the original sign of its normal forces
    pressure_area: Vector | None = None  # (m,) the areas by which they were multiplied
    notes: tuple[str, ...] = ()

    def filled(self, problem: ContactProblem) -> Answer:
        """Return the answer with zeros for missing parts."""
        width = () if problem.slip_origin is None else problem.slip_origin.shape
        none = np.zeros(width) if problem.slip_origin is not None else None
        return Answer(
            np.zeros(problem.dimension) if self.displacement is None else self.displacement,
            np.zeros(problem.contacts) if self.normal_force is None else self.normal_force,
            none if self.friction_force is None else self.friction_force,
            np.zeros(problem.ties) if self.tie_force is None else self.tie_force,
        )


def missing_parts(problem: ContactProblem, given: GivenAnswer) -> tuple[str, ...]:
    """Return the names of the missing parts."""
    wanted = {
        "displacement": True,
        "normal_force": problem.contacts > 0,
        "friction_force": problem.slip_origin is not None,
        "tie_force": problem.ties > 0,
    }
    return tuple(name for name, has in wanted.items() if has and getattr(given, name) is None)


@dataclass(frozen=True, eq=False)
class Recovery:
    """A complete answer, and the names of its recovered parts."""

    answer: Answer
    recovered: tuple[str, ...]
    notes: tuple[str, ...] = ()


def recoveries(problem: ContactProblem, given: GivenAnswer) -> Iterator[Recovery]:
    """Yield complete answers, the simple completion first.

    Raises InvalidProblem: a recovered part overflows; Unsupported: only forces were given, and the body is too large to
    factorise.
    """
    missing = missing_parts(problem, given)
    if not missing:
        yield Recovery(given.filled(problem), ())
    elif (twin := acting_rows(problem) or near_one(problem)) is not None:
        yield from _recovered_there(twin, problem, given)
    elif not all_finite(given):
        yield Recovery(
            given.filled(problem), (), ("nothing was recovered: the given values are not finite, or absurdly large",)
        )
    elif "displacement" in missing:
        for answer, how in displaced(problem, given.filled(problem), missing):
            yield Recovery(answer, missing, (f"recovered from the forces: {_words(missing)} ({how})",))
    else:
        for answer, how in pressed(problem, given.filled(problem), missing):
            yield Recovery(answer, missing, (f"recovered from the displacement: {_words(missing)} ({how})",))


def _recovered_there(twin: ActingRows | NearOne, problem: ContactProblem, given: GivenAnswer) -> Iterator[Recovery]:
    """Yield complete answers by a problem of the acting rows, or in units with numbers near one.

    Given parts are unchanged.
    """
    names = [name for name in ANSWER_PARTS if getattr(given, name) is not None]
    there = twin.answer(given.filled(problem))
    for found in recoveries(twin.problem, replace(given, **{name: getattr(there, name) for name in names})):
        whole = twin.whole_answer(found.answer)
        yield replace(found, answer=replace(whole, **{name: getattr(given, name) for name in names}))


def _words(names: tuple[str, ...]) -> str:
    return ", ".join(names)


def certify_given(
    problem: ContactProblem,
    given: GivenAnswer,
    tolerance: float = 1e-9,
    error_tolerance: float = 1e-6,
    factorization: Condensation | None = None,
) -> tuple[Certificate, Recovery]:
    """Return the certificate of the first completion that passes, or else of the first one, and the completion.

    Raises InvalidProblem, Unsupported as `contactqp.certify` and `recoveries`.

    Parameters
    ----------
    problem : ContactProblem
    given : the parts that came, in the problem's order, signs and units
    tolerance, error_tolerance : the largest figure and the largest relative error bound that pass
    factorization : reused instead of factorising again
    """
    first: tuple[Certificate, Recovery] | None = None
    for tried in recoveries(problem, given):
        found = certificate_of(problem, tried.answer, tolerance, error_tolerance, factorization, prove_friction=True)
        if found.passed:
            return found, tried
        first = first or (found, tried)
    assert first is not None  # there is always a simple completion
    if (completed := _with_forces_of_solution(problem, given)) is None:
        return first
    found = certificate_of(problem, completed.answer, tolerance, error_tolerance, factorization)
    return (found, completed) if found.passed else first


def _with_forces_of_solution(problem: ContactProblem, given: GivenAnswer) -> Recovery | None:
    """Return a displacement with the forces of the solution, None with friction, for large problems, or without a
    solution.

    With nearly dependent rows, forces from a displacement contain its magnified rounding; the solution's forces are
    right if the displacement is.
    """
    missing = missing_parts(problem, given)
    if given.displacement is None or "normal_force" not in missing or problem.frictional or not problem._is_small:
        return None
    with suppress(ContactQPError):
        right = _kept_solution(held_against(problem))
        if right.certificate.passed:
            forces = {name: getattr(right, name) for name in missing}
            how = f"recovered from the displacement: {_words(missing)} (those of the solution, which it is near)"
            return Recovery(replace(given.filled(problem), **forces), missing, (how,))
    return None


@dataclass(eq=False)
class HeldAgainst:
    """The cached right answers to a problem and to other questions, for all judged answers."""

    problem: ContactProblem
    solution: Solution | ContactQPError | None = None  # or the reason why there is none
    others: dict[Any, Answer | ContactQPError] = field(default_factory=dict)  # oracle.diagnosis: by question


def held_against(problem: ContactProblem) -> HeldAgainst:
    """Return the cached right answers to this problem; the cache keeps the last problem of these matrices."""
    kept = problem._computed.held_against
    if kept is None or kept.problem is not problem:
        kept = problem._computed.held_against = HeldAgainst(problem)
    return kept  # type: ignore[no-any-return]


def _kept_solution(kept: HeldAgainst) -> Solution:
    """Return the certified solution, computed once; errors are raised again each time, except a time limit."""
    if kept.solution is None:
        try:
            kept.solution = solve(kept.problem)
        except ContactQPError as error:
            if time_is_up():
                raise
            kept.solution = error
    if isinstance(kept.solution, ContactQPError):
        raise kept.solution.with_traceback(None)
    return kept.solution


def right_answer(problem: ContactProblem, answer: Answer) -> Solution:
    """Return a certified solution; of several equilibria the one nearest to the answer, in the energy scale.

    Raises ContactQPError: none exists, or none was found.
    """
    found = _kept_solution(held_against(problem))
    others = found.certificate.uniqueness
    plane = problem.tangent is not None and problem.tangent.shape[0] == problem.contacts
    if not (SEVERAL in others or POSSIBLE in others) or not all_finite(answer):
        return found
    solutions = [found]
    with suppress(ContactQPError):
        solutions += equilibria(problem) if plane and problem.contacts <= FEW else [_from(problem, answer)]
    weight = np.sqrt(np.maximum(problem.diagonal, 0.0))
    return min(solutions, key=lambda one: float(np.linalg.norm(weight * (one.displacement - answer.displacement))))


def _from(problem: ContactProblem, answer: Answer) -> Solution:
    """Return the equilibrium found by Newton's method from the answer."""
    if (near := near_one(problem)) is not None:
        return of_problem(near, _from(near.problem, near.answer(answer)))
    return begin(problem, start=Candidate(answer), max_iter=STEPS_FROM_ANSWER).finish()


# The note for gaps that are not unique (`determined_gaps`).
EQUALLY_GOOD = "the right answer is not the only one: other displacements have the same energy, and other gaps"


def determined_gaps(problem: ContactProblem, right: Solution) -> Mask:
    """Return the contacts (m,) whose gaps are the same in every right answer.

    A linear program may have several optimal vertices, and gaps of open contacts may change as bodies slide freely.
    """
    if right.certificate.determined == BY_ENERGY and right.certificate.energy_bounds is not None:
        return np.zeros(problem.contacts, dtype=bool)
    moved, scale = np.zeros(problem.contacts, dtype=bool), unknown_scale(problem)
    for motion in right.free_motions:
        largest = np.max(abs(motion.direction) / scale)
        moved |= abs(problem.normal @ motion.direction) > SAME_VALUE * largest * (abs(problem.normal) @ scale)
    return ~moved


OF_CONTACTS = ("penetration", "tension", "complementarity", "cone", "slip_direction")
# Without bounds, forces and gaps that differ by less than this part of the largest count as equal.
SAME_VALUE = 1e-6


@dataclass(frozen=True, eq=False)
class JudgedContact(ReadOnly):
    """A wrong contact of a given answer, in the problem's units, with forces positive in compression."""

    name: str
    index: int
    figure: str  # what is broken most: a figure of the certificate, or "force", "gap" beside the right ones
    size: float  # of it, dimensionless
    normal_force: float
    gap: float  # positive when open
    friction_force: Array | None  # (d-1,)
    slip: Array | None
    right_normal_force: float | None  # None where no right answer was found
    right_gap: float | None
    right_friction_force: Array | None
    right_slip: Array | None

    def data(self) -> dict[str, Any]:
        """Return the contact as plain data for JSON, with null for values that are not finite."""
        numbers = {name: finite(value) for name, value in vars(self).items() if name not in ("name", "index", "figure")}
        return {"contact": self.name, "index": self.index, "figure": self.figure} | numbers


def judged_contacts(
    problem: ContactProblem, answer: Answer, certificate: Certificate, right: Solution | None
) -> tuple[JudgedContact, ...]:
    """Return the wrong contacts of a refused answer, worst first.

    Parameters
    ----------
    problem : ContactProblem
    answer : Answer
    certificate : the certificate of the answer
    right : Solution or None, the right answer for comparison
    """
    names, table = _measures(problem, answer, certificate, right)
    largest = np.max(table, axis=0, initial=0.0)
    wrong = np.flatnonzero(largest > certificate.tolerance)
    order = wrong[np.argsort(-largest[wrong], kind="stable")]
    gap, slip = problem.gap - problem.normal @ answer.displacement, slips(problem, answer.displacement)
    beside = None if right is None else without_rounding(right)
    return tuple(
        JudgedContact(
            name=problem.contact_name(int(i)),
            index=int(i),
            figure=names[int(np.argmax(table[:, i]))],
            size=float(largest[i]),
            normal_force=float(answer.normal_force[i]),
            gap=float(gap[i]),
            friction_force=_of(answer.friction_force, i),
            slip=_of(slip, i),
            right_normal_force=None if beside is None else float(beside.normal_force[i]),
            right_gap=None if beside is None else float(beside.gap[i]),
            right_friction_force=None if beside is None else _of(beside.friction_force, i),
            right_slip=None if beside is None else _of(beside.slip, i),
        )
        for i in order
    )


def _of(values: Array | None, i: int) -> Array | None:
    return None if values is None else values[i]


def _measures(
    problem: ContactProblem, answer: Answer, certificate: Certificate, right: Solution | None
) -> tuple[list[str], Array]:
    """Return the names (q,) and the sizes (q, m) of the violations of each contact."""
    m, found = problem.contacts, certificate.violations
    if found is None:
        bad = ~np.isfinite(answer.normal_force)
        if answer.friction_force is not None:
            bad |= ~np.all(np.isfinite(answer.friction_force), axis=1)
        touched = abs(problem.normal) @ (~np.isfinite(answer.displacement)).astype(float) > 0
        return ["not finite"], np.where(bad | touched, np.inf, 0.0)[None, :]
    names, table = list(OF_CONTACTS), [getattr(found, name) for name in OF_CONTACTS]
    if right is not None:
        redundant = any("redundant" in reason for reason in certificate.reasons) or "forces not unique" in str(
            right.certificate.uniqueness
        )
        if not redundant:
            names.append("force")
            table.append(_apart(answer, right))
        names.append("gap")
        length = lengths_that_meet(problem, problem.normal, problem.gap, right.displacement)
        apart = abs(found.gap - right.gap) / np.where(np.isfinite(length), length, np.inf)
        table.append(np.where((apart > SAME_VALUE) & determined_gaps(problem, right), apart, 0.0))
    return names, np.array(table).reshape(len(names), m)


def _apart(answer: Answer, right: Solution) -> Vector:
    """Return the force errors of each contact relative to the largest right force."""
    apart = abs(answer.normal_force - right.normal_force)
    if answer.friction_force is not None and right.friction_force is not None:
        apart = np.maximum(apart, np.max(abs(answer.friction_force - right.friction_force), axis=1, initial=0.0))
    largest = float(np.max(abs(right.normal_force), initial=0.0)) or float(np.max(abs(answer.normal_force), initial=1))
    relative = apart / largest if largest > 0 else apart
    return np.where(relative > SAME_VALUE, relative, 0.0)


def contacts_table(problem: ContactProblem, contacts: tuple[JudgedContact, ...], limit: int = 20) -> str:
    """Return a table of at most `limit` contacts as text."""
    if not contacts:
        return "no contact is wrong"
    force, length = (f" [{unit}]" if unit else "" for unit in (problem.units.force, problem.units.length))
    header = ["contact", "what", "size", f"force{force}", "right", f"gap{length}", "right"]
    frictional = contacts[0].friction_force is not None
    header += [f"friction{force}", "right"] if frictional else []
    lines = [header]
    for one in contacts[:limit]:
        line = [one.name, one.figure.replace("_", " "), f"{one.size:.2g}"]
        line += [_number(value) for value in (one.normal_force, one.right_normal_force, one.gap, one.right_gap)]
        line += [_number(value) for value in (one.friction_force, one.right_friction_force)] if frictional else []
        lines.append(line)
    text = aligned(lines)
    if len(contacts) > limit:
        text.append(f"and {len(contacts) - limit} more")
    return "\n".join(text)


def _number(value: Any) -> str:
    if value is None:
        return "-"
    return " ".join(f"{one:.6g}" for one in np.atleast_1d(value))
