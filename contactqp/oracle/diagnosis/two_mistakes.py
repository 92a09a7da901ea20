"""Answers with a flipped sign or another unit, and another mistake beside: what a sign hides is looked for again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from contactqp.errors import ContactQPError
from contactqp.oracle.diagnosis.evidence import Evidence, Explanation, digits
from contactqp.oracle.diagnosis.finding import Finding
from contactqp.oracle.diagnosis.named_factors import named_factor
from contactqp.oracle.foreign.foreign_answer import GivenAnswer
from contactqp.oracle.foreign.judging import judge

# Powers of ten of units that are confused, and how far from one the other mistake may put the factor.
POWERS, NEAR = (3, 6), 0.3
# Where no other mistake is found: undone, the answer is right to this part, and was further off by this factor.
ROUGHLY, NEARER = 0.1, 20.0
# Signs and powers of ten are told from noise by no fewer values.
ENOUGH = 3
CONTACT_FORCES = ("normal_force", "friction_force")


class _Undone(NamedTuple):
    kind: str
    text: str
    given: GivenAnswer


def two_mistakes(evidence: Evidence, explained: Callable[[Evidence], list[Explanation]]) -> list[Explanation]:
    """A sign or a unit, and what `explained` says of the answer with that undone."""
    for undone in _undoings(evidence):
        try:
            found, completed = judge(
                evidence.problem, undone.given, evidence.certificate.tolerance, evidence.certificate.error_tolerance
            )
        except ContactQPError:
            continue
        after = replace(evidence, given=undone.given, answer=completed.answer, certificate=found)
        others = explained(after)
        if any(one.finding.kind != "scaled" for one in others):
            best = min(others, key=lambda one: one.left)
            beside = tuple(replace(one, together=True) for one in (best.finding, *best.beside))
            first, *rest = beside
            beside = (replace(first, text=f"with that undone, {first.text}"), *rest)
            return [Explanation(Finding(undone.kind, undone.text, True), best.left, beside)]
        if after.before <= min(ROUGHLY, evidence.before / NEARER):
            text = f"{undone.text}: with that undone it agrees with the right answer to {digits(after.before)} only"
            return [Explanation(Finding(undone.kind, text, True), after.before)]
    return []


def _undoings(evidence: Evidence) -> Iterator[_Undone]:
    given, right = evidence.given, evidence.right
    force = given.normal_force
    if force is None or right is None or not np.any(force) or not np.all(np.isfinite(force)):
        return
    forces = [name for name in evidence.given_parts if name != "displacement"]
    values = sum(int(np.count_nonzero(getattr(given, name))) for name in evidence.given_parts)
    if values < ENOUGH:
        return
    largest = float(np.max(abs(force)))
    turned = -1.0 if np.max(force) <= 1e-3 * largest else 1.0
    if turned < 0:
        other = "negative" if given.compression == "positive" else "positive"
        text = f"all contact forces have the opposite sign (compression={other!r})"
        yield _Undone("sign", text, replace(given, normal_force=-force))
    should = float(np.sum(abs(right.normal_force)))
    power = _power(float(np.sum(abs(force))), should)
    if power:
        size = turned * 10.0**power
        one = named_factor(10.0**power, False, evidence.problem.units.force)
        sign = " and have the opposite sign" if turned < 0 else ""
        guess = f" ({one.guess}?)" if one and one.guess else ""
        text = f"the forces are about {10.0**power:g} times the right ones{sign}{guess}"
        changes: dict[str, Any] = {
            name: getattr(given, name) / (size if name == "normal_force" else abs(size)) for name in forces
        }
        yield _Undone("unit", text, replace(given, **changes))
    if given.displacement is None:
        return
    weight = evidence.weights["displacement"]
    power = _power(
        float(np.linalg.norm(weight * given.displacement)), float(np.linalg.norm(weight * right.displacement))
    )
    if power:
        one = named_factor(10.0**power, True, evidence.problem.units.length)
        guess = f" ({one.guess}?)" if one and one.guess else ""
        text = f"the displacements are about {10.0**power:g} times the right ones{guess}"
        changed: dict[str, Any] = {"displacement": given.displacement / 10.0**power}
        if turned < 0:
            text, changed = f"{text} and all contact forces have the opposite sign", changed | {"normal_force": -force}
        yield _Undone("unit", text, replace(given, **changed))


def _power(mine: float, right: float) -> int:
    """The power of a thousand by which a size is too large, 0 where there is none."""
    if not 0 < mine < np.inf or not 0 < right < np.inf:
        return 0
    exponent = float(np.log10(mine) - np.log10(right))
    power = 3 * round(exponent / 3)
    return power if abs(power) in POWERS and abs(exponent - power) <= NEAR else 0
