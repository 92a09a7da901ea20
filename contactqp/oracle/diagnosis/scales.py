"""Recognise answers that are right up to a factor (signs, units, halves) or up to their precision."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from typing import NamedTuple

import numpy as np

from contactqp.linalg.dense import unknown_scale
from contactqp.model.arrays import Vector
from contactqp.oracle.diagnosis.evidence import LEFT, Evidence, Explanation, Finding, digits
from contactqp.oracle.foreign.judging import certify_given

# Typical factors of wrong answers with their names: signs, units, halves, rings.

# The relative distance within which a factor counts as a named one.
CLOSE = 1e-4
LARGEST_POWER = 12
# Powers of ten of units, by the units' names in problems.
LENGTHS = {"m": 0, "mm": -3, "cm": -2, "um": -6, "µm": -6, "km": 3}
FORCES = {"N": 0, "kN": 3, "MN": 6, "mN": -3}
WORDS = {"m": "metres", "mm": "millimetres", "cm": "centimetres", "um": "micrometres", "µm": "micrometres"}
ENGLISH_LENGTHS = {25.4: "inches", 2.54: "inches", 0.0254: "inches", 0.3048: "feet", 12.0: "feet and inches"}
ENGLISH_FORCES = {9.80665: "kilogram-force", 4.4482216153: "pound-force", 4448.2216153: "kilopound-force"}
OTHERS = (
    (2.0, "half", "both halves of a symmetric model added, or everything counted twice"),
    (0.5, "half", "half of a symmetric model"),
    (2 * np.pi, "radian", "a whole ring instead of one radian of it"),
    (1 / (2 * np.pi), "radian", "one radian of a ring instead of all of it"),
)


class NamedFactor(NamedTuple):
    """The kind of a factor, its exact value, and a guess in words, possibly empty."""

    kind: str
    exact: float
    guess: str


def named_factor(factor: float, length: bool, unit: str) -> NamedFactor | None:
    """Return the name of a factor of displacements or forces, None if it has none.

    `unit` is the problem's; a displacement 1000 times too large was given in the next smaller unit.
    """
    if factor == 0:
        return NamedFactor("zero", 0.0, "")
    if abs(factor - 1) <= CLOSE:
        return NamedFactor("right", 1.0, "")
    sign, size = (1.0 if factor > 0 else -1.0), abs(factor)
    if abs(size - 1) <= CLOSE:
        return NamedFactor("sign", -1.0, "")
    power = round(float(np.log10(size)))
    if power and abs(power) <= LARGEST_POWER and abs(size / 10.0**power - 1) <= CLOSE:
        return NamedFactor("unit", sign * 10.0**power, _power_of_ten(power, length, unit))
    for known, called in (ENGLISH_LENGTHS if length else ENGLISH_FORCES).items():
        for exact in (known, 1 / known):
            if abs(size / exact - 1) <= CLOSE:
                return NamedFactor("unit", sign * exact, f"{called} somewhere")
    for exact, kind, guess in OTHERS:
        if abs(size / exact - 1) <= CLOSE:
            return NamedFactor(kind, sign * exact, guess)
    return None


def _power_of_ten(power: int, length: bool, unit: str) -> str:
    known = LENGTHS if length else FORCES
    if unit not in known:
        unit = "" if unit else ("m" if power > 0 else "mm") if length else ("kN" if power > 0 else "N")
    theirs = [name for name, size in known.items() if unit in known and size == known[unit] - power]
    if not theirs:
        return "another unit"
    return f"{WORDS.get(theirs[0], theirs[0])} instead of {WORDS.get(unit, unit)}"


CALLED = {
    "displacement": "displacements",
    "normal_force": "contact forces",
    "friction_force": "friction forces",
    "tie_force": "tie forces",
}
# The largest error of the other parts if some are zero.
REST = 1e-6
RIGHT = "this answer is right"


def factors(evidence: Evidence) -> dict[str, float] | None:
    """Return the factor of each given part relative to the right one, None if some part is not proportional.

    The factor of a right part, or of one whose right value is zero, is one.
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
    """Return c with mine = c right up to LEFT of the largest, one if right is zero, None if there is none.

    Both are divided by their largest entries first, as squares may overflow.
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
    """Return pairs of given and right parts; forces that are not unique are replaced by nodal forces."""
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
    """Yield explanations by signs, units and other named factors."""
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
    """Yield a factor of the load if all parts have the same factor and gaps do not contradict it."""
    problem, factor = evidence.problem, next(iter(meant.values()))
    if len(set(meant.values())) > 1 or not np.any(problem.load):
        return
    if evidence.passes_with(load=factor * problem.load):
        text = f"it is the right answer to {factor:.6g} times the load"
        yield Explanation(Finding("load", text, True), 0.0)


def _texts(evidence: Evidence, parts: list[str], factor: float, guess: str, then: str) -> tuple[str, str]:
    """Return the mistake and its correction in words."""
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
    """Yield signs and powers of ten with which the certificate passes, if no right answer is known."""
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


# Right answers of low precision: single precision, printed digits, unfinished iterations.

# Answers with a smaller error are right to a few digits.
FEW_DIGITS = 1e-3
# Values below this part of the largest are noise.
NOISE = 1e-9
MOST_PRINTED = 12
LOOSEST = 1e-2
NONE_PASSES = f"no tolerance up to {LOOSEST:g} passes it"
# Answers with a smaller error are right in all digits, as far as compared.
ROUNDINGS = 1e-13


def printed(evidence: Evidence) -> Iterator[Explanation]:
    """Yield an explanation if numbers of single precision or few digits are right to these digits."""
    if evidence.right is None or not evidence.before <= FEW_DIGITS:
        return
    values, right, noise = _side_by_side(evidence)
    for kind, why, last_digit in _roundings(values):
        part = min(last_digit, 1 / 3)  # rounding to one digit changes a number by at most a third (1.5 to 1)
        if np.all(abs(values - right) <= part * np.maximum(abs(values), abs(right)) + noise):
            yield from _inexact_by(evidence, kind, why)
            return


def inexact(evidence: Evidence) -> Iterator[Explanation]:
    """Yield the number of right digits of an answer that nothing else explains."""
    if evidence.right is not None and evidence.before <= FEW_DIGITS:
        yield from _inexact_by(
            evidence, "inexact", "single precision, a printed answer, or iterations that stopped early?"
        )


def _inexact_by(evidence: Evidence, kind: str, why: str) -> Iterator[Explanation]:
    right = "the right answer"
    if evidence.right is None or evidence.before < 0.1 * evidence.apart(evidence.given, evidence.right):
        right = "the equilibrium with the same contacts open, sticking and slipping"
    text = f"it agrees with {right} to about {digits(evidence.before)}{_small_forces(evidence)}: {why}"
    passing = _what_passes(evidence)
    if evidence.before <= ROUNDINGS and passing == NONE_PASSES:  # lack of digits does not explain it
        return
    text = f"{text} {passing}" if text.endswith("?") else f"{text}; {passing}"
    yield Explanation(Finding(kind, text, True), evidence.before)


def _small_forces(evidence: Evidence) -> str:
    """Return in words the contact with a wrong small force, if all forces agree relative to the largest, else ""."""
    given = evidence.given.normal_force
    if evidence.right is None or given is None or evidence.shared:
        return ""
    mine, right = np.ravel(given), np.ravel(evidence.right.normal_force)
    off, size = abs(mine - right), np.maximum(abs(mine), abs(right))
    wrong = np.flatnonzero((off >= 0.5 * size) & (size > NOISE * np.max(abs(right), initial=0.0)))
    if not wrong.size:
        return ""
    i = int(wrong[np.argmax(size[wrong])])
    force = f"{right[i]:.3g} {evidence.problem.units.force}".rstrip()
    return f" of the largest values, but {evidence.problem.contact_name(i)} has {mine[i]:.3g} and should have {force}"


def _side_by_side(evidence: Evidence) -> tuple[Vector, Vector, Vector]:
    """Return all given values, the right ones, and the noise level of each kind."""
    mine = [np.ravel(getattr(evidence.given, name)) for name in evidence.given_parts]
    right = [np.ravel(getattr(evidence.right, name)) for name in evidence.given_parts]
    noise = [np.full(len(part), NOISE * np.max(abs(part), initial=0.0)) for part in right]
    return np.concatenate(mine), np.concatenate(right), np.concatenate(noise)


def _roundings(values: Vector) -> Iterator[tuple[str, str, float]]:
    """Yield each rounding that does not change the values: kind, words, and relative size of the last digit."""
    with np.errstate(over="ignore"):
        single = values.astype(np.float32).astype(float)
    if np.all(np.isclose(single, values, rtol=1e-15, atol=0.0)):
        yield "single-precision", "every number is one of single precision", float(np.finfo(np.float32).eps)
    for count in range(1, MOST_PRINTED + 1):
        printed = np.array([float(f"{value:.{count - 1}e}") for value in values])
        if np.all(np.isclose(printed, values, rtol=1e-14, atol=0.0)):
            yield "printed-digits", f"every number has {count} digits at most, as printed", 10.0 ** (1 - count)
            return


def _what_passes(evidence: Evidence) -> str:
    """Return the tolerances, powers of ten, with which the answer would pass."""
    found = evidence.certificate
    sizes = [
        float(getattr(found, one.name))
        for one in fields(found)
        if one.name in ("equilibrium", "balance", "penetration", "tension", "complementarity", "cone", "tie")
    ]
    worst = max([*sizes, found.slip_direction, (found.natural_map or 0.0) / 4, found.tolerance])
    start = int(np.ceil(np.log10(worst))) if np.isfinite(worst) else 0
    powers = range(start, start + 3)
    if evidence.recovered:  # missing parts are recovered with this tolerance, and all figures depend on it
        powers = range(int(np.floor(np.log10(found.tolerance))) + 1, 0)
    for power in powers:
        tolerance = max(10.0**power, found.tolerance)
        if tolerance > LOOSEST:
            break
        for error_tolerance in (found.error_tolerance, *(10.0**p for p in range(-6, -1))):
            if error_tolerance < found.error_tolerance:
                continue
            passed, _ = certify_given(evidence.problem, evidence.given, tolerance, error_tolerance)
            if passed.passed:
                more = "" if error_tolerance == found.error_tolerance else f", error_tolerance={error_tolerance:g}"
                return f"tolerance={tolerance:g}{more} passes it"
    return NONE_PASSES
