"""Answers that are right but for a factor: signs, units, halves, nothing at all."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from contactqp.linalg.condensation import unknown_scale
from contactqp.model.arrays import Vector
from contactqp.oracle.diagnosis.evidence import LEFT, Evidence, Explanation
from contactqp.oracle.diagnosis.finding import Finding
from contactqp.oracle.diagnosis.named_factors import CLOSE, NamedFactor, named_factor

CALLED = {
    "displacement": "displacements",
    "normal_force": "contact forces",
    "friction_force": "friction forces",
    "tie_force": "tie forces",
}
# Beside parts that are zero the rest is right to this part.
REST = 1e-6
RIGHT = "this answer is right"


def factors(evidence: Evidence) -> dict[str, float] | None:
    """What each given part has to be divided by to be right, None where some part is not proportional to the right one.

    A part that is right, or whose right value is zero, has the factor one.
    """
    found: dict[str, float] = {}
    for name, (mine, right) in _compared(evidence).items():
        factor = _proportion(mine, right)
        if factor is None:
            return None
        found[name] = 1.0 if abs(factor - 1) <= 1e-12 else factor
    if evidence.shared:
        found = {name: found.get(name, found.get("forces", 1.0)) for name in evidence.given_parts}
    return found


def _proportion(mine: Vector, right: Vector) -> float | None:
    """Return c with mine = c right to LEFT of the largest, one where right is zero; None where no double is that.

    Both are divided by their largest entries first: the squares of values that are doubles need not be.
    """
    size, scale = (float(np.max(abs(part), initial=0.0)) for part in (mine, right))
    if not scale > 0:
        return 1.0 if np.isfinite(size) and scale == 0 else None
    if size == 0:
        return 0.0
    shape, along = mine / size, right / scale
    part = float(shape @ along) / float(along @ along)
    factor = part * (size / scale)
    if factor == 0 or not np.isfinite(factor):
        return None
    return factor if float(np.max(abs(shape - part * along))) <= LEFT * abs(part) else None


def _compared(evidence: Evidence) -> dict[str, tuple[Vector, Vector]]:
    """What was given beside what is right, part by part; forces that are open by what they do together."""
    right = evidence.right
    names = evidence.given_parts
    pairs: dict[str, tuple[Vector, Vector]] = {}
    if evidence.shared and "normal_force" in names and right is not None:
        D = unknown_scale(evidence.problem)
        filled = evidence.given.filled(evidence.problem)
        D = D / np.max(D)
        pairs["forces"] = D * evidence.resultant(filled), D * evidence.resultant(right)
        names = tuple(name for name in names if name == "displacement")
    for name in names:
        weight = evidence.weights[name]
        pairs[name] = np.ravel(weight * getattr(evidence.given, name)), np.ravel(weight * getattr(right, name))
    return pairs


def scales(evidence: Evidence) -> Iterator[Explanation]:
    """Signs, units and other factors that have a name."""
    if evidence.right is None:
        yield from _without_right(evidence)
        return
    known = factors(evidence)
    if known is None or all(abs(factor - 1) <= CLOSE for factor in known.values()):
        return
    named: dict[str, NamedFactor] = {}
    units = evidence.problem.units
    for name, factor in known.items():
        length = name == "displacement"
        one = named_factor(factor, length, units.length if length else units.force)
        if one is None:
            return
        named[name] = one
    meant = {name: one.exact for name, one in named.items()}
    if any(exact == 0 for exact in meant.values()):
        yield from _zero(evidence, meant)
        return
    undone = evidence.with_parts(**{name: getattr(evidence.given, name) / exact for name, exact in meant.items()})
    left = evidence.apart(undone, evidence.right)
    if not evidence.explains(left):
        return
    yield from _of_load(evidence, meant)
    then = evidence.then(undone, left)
    wrong = sorted({one for one in meant.values() if one != 1}, key=abs)
    found: list[Finding] = []
    for exact in wrong:
        parts = [name for name, one in meant.items() if one == exact]
        kind, _, guess = named[parts[0]]
        kind = f"{parts[0].split('_')[0]}-{kind}" if kind == "sign" and "normal_force" not in parts else kind
        fault, undoing = _texts(evidence, parts, exact, guess, then)
        text = f"{fault}: {undoing} {then}" if len(wrong) == 1 else fault
        found.append(Finding(kind, text, True, bool(found)))
    if len(found) > 1:
        undoing = f"with {'both' if len(found) == 2 else 'all'} undone"
        found[-1] = replace(found[-1], text=f"{found[-1].text}: {undoing} {then}")
    yield Explanation(found[0], left, tuple(found[1:]))


def _of_load(evidence: Evidence, meant: dict[str, float]) -> Iterator[Explanation]:
    """Where one factor belongs to everything, and gaps do not tell, the load may have had it."""
    problem, factor = evidence.problem, next(iter(meant.values()))
    if len(set(meant.values())) > 1 or not np.any(problem.load):
        return
    if evidence.passes_with(load=factor * problem.load):
        text = f"it is the right answer to {factor:.6g} times the load"
        yield Explanation(Finding("load", text, True), 0.0)


def _texts(evidence: Evidence, parts: list[str], factor: float, guess: str, then: str) -> tuple[str, str]:
    """What is wrong, and how it is undone."""
    what = "everything" if len(parts) == len(evidence.given_parts) and len(parts) > 1 else _joined(parts)
    if factor == -1:
        has = "has" if what == "everything" else "have"
        if parts == ["normal_force"] and then == RIGHT:
            other = "negative" if evidence.given.compression == "positive" else "positive"
            return f"all {what} {has} the opposite sign", f"with compression={other!r}"
        return f"{what if what == 'everything' else f'all {what}'} {has} the opposite sign", "turned,"
    is_ = "is" if what == "everything" else "are"
    if what == "everything" and " instead of " in guess and "ring" not in guess:
        guess = "another unit, such as milli for one"
    turned = " and have the opposite sign" if factor < 0 else ""
    size = f"{abs(factor):.6g}"
    undoing = f"divided by {'-' if factor < 0 else ''}{size},"
    return f"{what} {is_} {size} times the right values{turned} ({guess}?)", undoing


def _joined(parts: list[str]) -> str:
    names = [CALLED[name] for name in parts]
    if set(parts) >= {"normal_force", "friction_force", "tie_force"}:
        names = [CALLED["displacement"]] * ("displacement" in parts) + ["forces"]
    return " and ".join(names) if len(names) < 3 else f"{', '.join(names[:-1])} and {names[-1]}"


def _zero(evidence: Evidence, meant: dict[str, float]) -> Iterator[Explanation]:
    parts = [name for name, factor in meant.items() if factor == 0]
    if any(factor not in (0, 1) for factor in meant.values()):
        return
    what = "everything" if len(parts) == len(evidence.given_parts) else f"all {_joined(parts)}"
    verb = "is" if what == "everything" else "are"
    undone = evidence.with_parts(**{name: getattr(evidence.right, name) for name in parts})
    if evidence.right is None or evidence.apart(undone, evidence.right) > REST:
        return
    rest = "" if what == "everything" else "; the rest is right"
    yield Explanation(Finding("zero", f"{what} {verb} zero{rest}", True), 0.0)


def _without_right(evidence: Evidence) -> Iterator[Explanation]:
    """Where no right answer is known the certificate alone tells whether a sign or a power of ten was all."""
    force = evidence.given.normal_force
    if force is None or not np.any(force):
        return
    turned = evidence.with_parts(normal_force=-force)
    if evidence.passes(turned):
        text = _texts(evidence, ["normal_force"], -1.0, "", RIGHT)
        yield Explanation(Finding("sign", f"{text[0]}: {text[1]} {RIGHT}", True), 0.0)
        return
    for power in (3, -3, 6, -6):
        scaled = evidence.with_parts(normal_force=force / 10.0**power)
        if evidence.passes(scaled):
            one = named_factor(10.0**power, False, evidence.problem.units.force)
            text = _texts(evidence, ["normal_force"], 10.0**power, one.guess if one else "", RIGHT)
            yield Explanation(Finding("unit", f"{text[0]}: {text[1]} {RIGHT}", True), 0.0)
            return
