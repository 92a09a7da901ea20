"""Answers that are right as far as they go: single precision, printed digits, iterations that stopped early."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields

import numpy as np

from contactqp.model.arrays import Vector
from contactqp.oracle.diagnosis.evidence import Evidence, Explanation, digits
from contactqp.oracle.diagnosis.finding import Finding
from contactqp.oracle.foreign.judging import judge

# What is nearer than this to right is right to a few digits.
FEW_DIGITS = 1e-3
# Values beneath this part of the largest are noise.
NOISE = 1e-9
MOST_PRINTED = 12
LOOSEST = 1e-2


def printed(evidence: Evidence) -> Iterator[Explanation]:
    """Numbers of single precision or of few digits, each as near to the right one as these are."""
    if evidence.right is None or not evidence.before <= FEW_DIGITS:
        return
    values, right, noise = _side_by_side(evidence)
    for kind, why, last_digit in _roundings(values):
        if np.all(abs(values - right) <= last_digit * np.maximum(abs(values), abs(right)) + noise):
            yield _told(evidence, kind, why)
            return


def inexact(evidence: Evidence) -> Iterator[Explanation]:
    """To how many digits an answer is right that nothing else explains."""
    if evidence.right is not None and evidence.before <= FEW_DIGITS:
        yield _told(evidence, "inexact", "single precision, a printed answer, or iterations that stopped early?")


def _told(evidence: Evidence, kind: str, why: str) -> Explanation:
    text = f"it agrees with the right answer to about {digits(evidence.before)}: {why}"
    passing = _what_passes(evidence)
    text = f"{text} {passing}" if text.endswith("?") else f"{text}; {passing}"
    return Explanation(Finding(kind, text, True), evidence.before)


def _side_by_side(evidence: Evidence) -> tuple[Vector, Vector, Vector]:
    """All given values, the right ones, and what is noise beside the largest of their kind."""
    mine = [np.ravel(getattr(evidence.given, name)) for name in evidence.given_parts]
    right = [np.ravel(getattr(evidence.right, name)) for name in evidence.given_parts]
    noise = [np.full(len(part), NOISE * np.max(abs(part), initial=0.0)) for part in right]
    return np.concatenate(mine), np.concatenate(right), np.concatenate(noise)


def _roundings(values: Vector) -> Iterator[tuple[str, str, float]]:
    """Kind, words and relative size of the last digit of the roundings that leave the values as they are."""
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
    """The tolerances, powers of ten, that would pass."""
    found = evidence.certificate
    sizes = [
        float(getattr(found, one.name))
        for one in fields(found)
        if one.name in ("equilibrium", "balance", "penetration", "tension", "complementarity", "cone", "tie")
    ]
    worst = max([*sizes, found.slip_direction, (found.natural_map or 0.0) / 4, found.tolerance])
    start = int(np.ceil(np.log10(worst))) if np.isfinite(worst) else 0
    for power in range(start, start + 3):
        tolerance = max(10.0**power, found.tolerance)
        if tolerance > LOOSEST:
            break
        for error_tolerance in (found.error_tolerance, *(10.0**p for p in range(-6, -1))):
            if error_tolerance < found.error_tolerance:
                continue
            passed, _ = judge(evidence.problem, evidence.given, tolerance, error_tolerance)
            if passed.passed:
                more = "" if error_tolerance == found.error_tolerance else f", error_tolerance={error_tolerance:g}"
                return f"tolerance={tolerance:g}{more} passes it"
    return f"no tolerance up to {LOOSEST:g} passes it"
