"""A case's claims held against an answer, number by number."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from contactqp.elements.exact import Number
from contactqp.scene.answers import READERS
from contactqp.scene.answers_of_nodes import Answer
from contactqp.scene.building import NodeModel
from contactqp.scene.claims import Claim, Expectation, Published
from contactqp.scene.corners import end_time
from contactqp.scene.instant import Instant
from contactqp.scene.units import Quantity, UnitSystem

if TYPE_CHECKING:
    from contactqp.scene.answers_of_bodies import BodyAnswer
    from contactqp.scene.bodies import BodyModel

Shown = float | str | tuple[float, ...]


def answer_of(model: NodeModel | BodyModel, solution: Any, instant: Instant | None = None) -> Answer | BodyAnswer:
    """A solution of the model's problem; without an instant, at the end of the load path or under the full load."""
    instant = instant or Instant(end_time(model.scene))
    if isinstance(model, NodeModel):
        return Answer(model, solution, instant)
    from contactqp.scene.answers_of_bodies import BodyAnswer

    return BodyAnswer(model.scene, model, solution, instant)


def value_of(claim: Claim, answer: Answer | BodyAnswer) -> tuple[Number, ...] | str:
    """What the answer says of the claim's quantity, in the scene's units: a number, words, or a matrix row by row."""
    value = READERS[claim.quantity](claim, answer) if isinstance(answer, Answer) else answer.value_of(claim)
    if isinstance(value, str):
        return value
    return tuple(value) if isinstance(value, list | tuple) else (value,)


@dataclass(frozen=True)
class Comparison:
    """One row: a quantity, what it should be, what the answer says, and whether that is close enough."""

    quantity: str
    expected: Shown
    got: Shown
    unit: str
    error: float  # relative to the largest expected number, or in `unit` if the tolerance is
    tolerance: float
    relative: bool
    ok: bool
    reason: str  # the derivation, or why the printed number is right or wrong
    verdict: str | None = None  # on a printed number
    erratum: str | None = None  # its number in the list of errata


def compare_expectation(expectation: Expectation, answer: Answer | BodyAnswer) -> Comparison:
    """The exact value against the answer's."""
    got = value_of(expectation, answer)
    if isinstance(got, str):
        same = set(str(expectation.value).split("; ")) <= set(got.split("; "))
        return Comparison(
            str(expectation), str(expectation.value), got, "", float(not same), 0.0, False, same, expectation.derivation
        )
    system, targets, tolerance = answer.scene.system, expectation.targets, expectation.tolerance
    exact = [system.value(target) for target in targets]
    relative = tolerance.dimension != targets[0].dimension or not any(tolerance.dimension)
    scale = max(map(abs, exact)) if relative else Fraction(1)
    allowed = system.value(tolerance)
    error = _distance(got, exact) / float(scale) if scale else _distance(got, exact)
    return Comparison(
        quantity=str(expectation),
        expected=_shown(exact),
        got=_shown(got),
        unit=_unit(expectation, targets, system),
        error=error,
        tolerance=float(allowed),
        relative=relative,
        ok=len(got) == len(exact) and error <= float(allowed),
        reason=expectation.derivation,
    )


def compare_published(published: Published, answer: Answer | BodyAnswer) -> Comparison:
    """A printed number against the answer: a right one agrees to half a unit of its last digit, a wrong one not."""
    got = value_of(published, answer)
    system, target = answer.scene.system, published.target
    printed, half_digit = system.value(target), system.value(published.half_digit)
    error = math.inf if isinstance(got, str) else _distance(got, [printed])
    # The answer is a double: a printed number that ends in an exact tie is not wrong by the rounding of the last place.
    agrees = error <= float(half_digit) * (1 + 1e-9)
    return Comparison(
        quantity=str(published),
        expected=_shown([printed]),
        got=got if isinstance(got, str) else _shown(got),
        unit=_unit(published, [target], system),
        error=error,
        tolerance=float(half_digit),
        relative=False,
        ok=agrees == (published.verdict == "right"),
        reason=f"{published.where}: {published.why}",
        verdict=published.verdict,
        erratum=published.erratum,
    )


def _distance(got: Sequence[Number], exact: Sequence[Fraction]) -> float:
    """The largest difference, formed exactly; infinite where a number is not finite."""
    if not all(math.isfinite(number) for number in got) or len(got) != len(exact):
        return math.inf
    return float(max(abs(Fraction(a) - b) for a, b in zip(got, exact, strict=True)))


def _shown(numbers: Sequence[Number]) -> Shown:
    floats = tuple(float(number) for number in numbers)
    return floats[0] if len(floats) == 1 else floats


def _unit(claim: Claim, targets: Sequence[Quantity], system: UnitSystem) -> str:
    """Of a matrix of ties every column has its own."""
    return "" if claim.quantity == "tie matrix" else system.label(targets[0].dimension)
