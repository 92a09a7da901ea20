"""Answers that are right but for a factor: signs, units, halves, nothing at all."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from contactqp.oracle.evidence import LEFT, Evidence, Explanation
from contactqp.oracle.finding import Finding

CALLED = {
    "displacement": "displacements",
    "normal_force": "contact forces",
    "friction_force": "friction forces",
    "tie_force": "tie forces",
}
# A factor this close to a known one is meant to be it.
CLOSE = 1e-4
# Beside parts that are zero the rest is right to this part.
REST = 1e-6
KNOWN_LENGTHS = {25.4: "inches", 2.54: "inches", 0.0254: "inches", 0.3048: "feet", 12.0: "feet and inches"}
KNOWN_FORCES = {9.80665: "kilogram-force", 4.4482216153: "pound-force", 4448.2216153: "kilopound-force"}
LARGEST_POWER = 12


def factors(evidence: Evidence) -> dict[str, float] | None:
    """What each given part has to be divided by to be right, None where some part is not proportional to the right one.

    A part that is right, or whose right value is zero, has the factor one.
    """
    found: dict[str, float] = {}
    for name in evidence.given_parts:
        weight = evidence.weights[name]
        mine = np.ravel(weight * getattr(evidence.given, name))
        right = np.ravel(weight * getattr(evidence.right, name))
        size = float(right @ right)
        factor = float(mine @ right) / size if size > 0 else 1.0
        largest = np.max(abs(right), initial=0.0) * max(abs(factor), 1e-300) or 1.0
        if factor != 0 and np.max(abs(mine - factor * right), initial=0.0) > LEFT * largest:
            return None
        if factor == 0 and np.any(mine):
            return None
        found[name] = 1.0 if abs(factor - 1) <= 1e-12 else factor
    return found


def scales(evidence: Evidence) -> Iterator[Explanation]:
    """Signs, units and other factors that have a name."""
    if evidence.right is None or (evidence.shared and "normal_force" in evidence.given_parts):
        yield from _without_right(evidence)
        return
    known = factors(evidence)
    if known is None or all(abs(factor - 1) <= CLOSE for factor in known.values()):
        return
    named: dict[str, tuple[str, float, str]] = {}
    for name, factor in known.items():
        one = _named(name, factor)
        if one is None:
            return
        named[name] = one
    meant = {name: exact for name, (_, exact, _) in named.items()}
    if any(exact == 0 for exact in meant.values()):
        yield from _zero(evidence, meant)
        return
    undone = evidence.with_parts(**{name: getattr(evidence.given, name) / exact for name, exact in meant.items()})
    left = evidence.apart(undone, evidence.right)
    if not evidence.explains(left):
        return
    yield from _of_load(evidence, meant)
    then = evidence.then(undone, left)
    for exact in sorted({one for one in meant.values() if one != 1}, key=abs):
        parts = [name for name, one in meant.items() if one == exact]
        kind, _, said = named[parts[0]]
        kind = f"{parts[0].split('_')[0]}-{kind}" if kind == "sign" and "normal_force" not in parts else kind
        text = _text(evidence, parts, exact, said, then)
        yield Explanation(Finding(kind, text, True), left)


def _of_load(evidence: Evidence, meant: dict[str, float]) -> Iterator[Explanation]:
    """Where one factor belongs to everything, and gaps do not tell, the load may have had it."""
    problem, factor = evidence.problem, next(iter(meant.values()))
    if len(set(meant.values())) > 1 or not np.any(problem.load):
        return
    if evidence.passes(evidence.given, problem.replace(load=factor * problem.load)):
        text = f"it is the right answer to {factor:.6g} times the load"
        yield Explanation(Finding("load", text, True), 0.0)


def _named(name: str, factor: float) -> tuple[str, float, str] | None:
    """Kind, exact value and words of a factor; None if it has no name."""
    if factor == 0:
        return "zero", 0.0, ""
    if abs(factor - 1) <= CLOSE:
        return "right", 1.0, ""
    sign, size = (1.0 if factor > 0 else -1.0), abs(factor)
    if abs(size - 1) <= CLOSE:
        return "sign", -1.0, ""
    power = round(float(np.log10(size)))
    if power and abs(power) <= LARGEST_POWER and abs(size / 10.0**power - 1) <= CLOSE:
        return "unit", sign * 10.0**power, _power_of_ten(name, power)
    for known, called in (KNOWN_LENGTHS if name == "displacement" else KNOWN_FORCES).items():
        for exact in (known, 1 / known):
            if abs(size / exact - 1) <= CLOSE:
                return "unit", sign * exact, f"{called} somewhere?"
    for exact, said in (
        (2.0, "both halves of a symmetric model added, or everything counted twice?"),
        (0.5, "half of a symmetric model?"),
        (2 * np.pi, "a whole ring instead of one radian of it?"),
        (1 / (2 * np.pi), "one radian of a ring instead of all of it?"),
    ):
        if abs(size / exact - 1) <= CLOSE:
            return ("half" if exact in (2.0, 0.5) else "radian"), sign * exact, said
    return None


def _power_of_ten(name: str, power: int) -> str:
    if name == "displacement":
        return {3: "millimetres instead of metres?", -3: "metres instead of millimetres?"}.get(power, "another unit?")
    return {3: "N instead of kN?", -3: "kN instead of N?", 6: "N instead of MN?", -6: "MN instead of N?"}.get(
        power, "another unit?"
    )


def _text(evidence: Evidence, parts: list[str], factor: float, said: str, then: str) -> str:
    what = "everything" if len(parts) == len(evidence.given_parts) and len(parts) > 1 else _joined(parts)
    if factor == -1:
        has = "has" if what == "everything" else "have"
        if parts == ["normal_force"] and then == "this answer is right":
            other = "negative" if evidence.given.compression == "positive" else "positive"
            return f"all {what} {has} the opposite sign: with compression={other!r} {then}"
        return f"{what if what == 'everything' else f'all {what}'} {has} the opposite sign: turned, {then}"
    is_ = "is" if what == "everything" else "are"
    if what == "everything" and said.endswith("instead of metres?"):
        said = "another unit, such as milli for one?"
    turned = " and have the opposite sign" if factor < 0 else ""
    size = f"{abs(factor):.6g}"
    return f"{what} {is_} {size} times the right values{turned} ({said.rstrip('?')}?): divided by {size}, {then}"


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
    """Where forces are open or no right answer is known the certificate alone tells whether a turned sign was all."""
    force = evidence.given.normal_force
    if force is None or not np.any(force):
        return
    turned = evidence.with_parts(normal_force=-force)
    if evidence.passes(turned):
        text = _text(evidence, ["normal_force"], -1.0, "", "this answer is right")
        yield Explanation(Finding("sign", text, True), 0.0)
        return
    for power in (3, -3, 6, -6):
        scaled = evidence.with_parts(normal_force=force / 10.0**power)
        if evidence.passes(scaled):
            said = _power_of_ten("normal_force", power)
            text = _text(evidence, ["normal_force"], 10.0**power, said, "this answer is right")
            yield Explanation(Finding("unit", text, True), 0.0)
            return
