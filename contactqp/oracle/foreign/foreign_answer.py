"""An answer of another code, completed and certified.

What was not given is recovered from the rest (`recovery`), and of the completions the first that passes the certificate
is taken.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from contactqp.certificate.certificate import certificate_of
from contactqp.certificate.idle_rows import ActingRows, acting_rows
from contactqp.certificate.number_range import NearOne, near_one
from contactqp.linalg.condensation import Condensation
from contactqp.model.arrays import Array, Vector, all_finite
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import ReadOnly
from contactqp.model.solution import ANSWER_PARTS, Answer, AnswerOf, Certificate
from contactqp.oracle.foreign.recovery import displaced, pressed


@dataclass(frozen=True, eq=False)
class GivenAnswer(AnswerOf[Vector | None, Array | None], ReadOnly):
    """The parts of an answer that were given, in the problem's own order, signs and units; None where one was not."""

    compression: str = "positive"  # the sign that its normal forces came with
    pressure_area: Vector | None = None  # (m,) what they were multiplied by
    notes: tuple[str, ...] = ()

    def filled(self, problem: ContactProblem) -> Answer:
        """Return the answer with zeros for what was not given."""
        width = () if problem.slip_origin is None else problem.slip_origin.shape
        none = np.zeros(width) if problem.slip_origin is not None else None
        return Answer(
            np.zeros(problem.dimension) if self.displacement is None else self.displacement,
            np.zeros(problem.contacts) if self.normal_force is None else self.normal_force,
            none if self.friction_force is None else self.friction_force,
            np.zeros(problem.ties) if self.tie_force is None else self.tie_force,
        )


def missing_parts(problem: ContactProblem, given: GivenAnswer) -> tuple[str, ...]:
    """Return the parts that the problem has and that were not given."""
    wanted = {
        "displacement": True,
        "normal_force": problem.contacts > 0,
        "friction_force": problem.slip_origin is not None,
        "tie_force": problem.ties > 0,
    }
    return tuple(name for name, has in wanted.items() if has and getattr(given, name) is None)


@dataclass(frozen=True, eq=False)
class Recovery:
    """A complete answer, and what of it was recovered."""

    answer: Answer
    recovered: tuple[str, ...]
    notes: tuple[str, ...] = ()


def recoveries(problem: ContactProblem, given: GivenAnswer) -> Iterator[Recovery]:
    """Complete answers, the plain way first.

    Raises InvalidProblem: what is recovered is beyond doubles; Unsupported: forces alone were given and the body is too
    large to factorise.
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
    """Complete answers of the rows that act, or in units in which numbers are near one, as those of the problem.

    What was given stays as it was.
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
    assert first is not None  # there is always a plain way
    return first
