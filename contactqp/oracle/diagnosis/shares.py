"""Answers of which a part is right: the total and not its distribution, all but the areas, all but one factor."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from contactqp.model.arrays import Vector
from contactqp.oracle.diagnosis.evidence import LEFT, Evidence, Explanation, digits
from contactqp.oracle.diagnosis.finding import Finding
from contactqp.oracle.diagnosis.scales import CALLED, factors
from contactqp.oracle.diagnosis.symptoms import unit_of

FORCES_OF_CONTACTS = {"normal_force", "friction_force"}
# Contacts that must push before their factors mean anything.
ENOUGH = 3
# The smallest area of the largest, where forces are taken for pressures.
AREAS_DIFFER = 0.95


def shares(evidence: Evidence) -> Iterator[Explanation]:
    """What forces have in common with the right ones where displacements are right or were not given."""
    if evidence.right is None or evidence.shared:
        return
    force = evidence.given.normal_force
    u = evidence.given.displacement
    if force is not None and (u is None or evidence.part_apart("displacement", u, evidence.right.displacement) <= LEFT):
        yield from _pressures(evidence, force, evidence.right.normal_force)
        yield from _total(evidence, force, evidence.right.normal_force)
    yield from _any_factor(evidence)


def _pressures(evidence: Evidence, force: Vector, right: Vector) -> Iterator[Explanation]:
    """Every pushing contact has a positive factor of its own, and few different ones occur, or areas were given."""
    size = float(np.max(abs(right), initial=0.0))
    acting = right > LEFT * size
    if np.sum(acting) < ENOUGH or np.any(abs(force[~acting]) > LEFT * float(np.max(abs(force)))):
        return
    if evidence.given.pressure_area is not None:
        without = evidence.with_parts(normal_force=force / evidence.given.pressure_area)
        left = evidence.apart(without, evidence.right or evidence.answer)
        if evidence.explains(left):
            text = "the values given are forces already, no pressures: without pressure_area "
            yield Explanation(Finding("pressure", text + evidence.then(without, left), True), left)
            return
    area = right[acting] / force[acting] if np.all(force[acting] > 0) else np.zeros(1)
    if np.sum(abs(area - 1) > LEFT) < 2:  # one force is wrong
        return
    values = np.unique(np.round(area / np.max(area), 4)) if np.all(area > 0) else np.zeros(0)
    # Areas differ by more than what an inexact answer is off by.
    if 2 <= len(values) <= max(2, int(np.sum(acting)) // 2) and values[0] < AREAS_DIFFER:
        text = (
            f"the forces are the right ones divided by {np.min(area):.4g} to {np.max(area):.4g}, few different "
            "numbers: pressures? With pressure_area= they are turned into forces"
        )
        yield Explanation(Finding("pressure", text, True), LEFT)


def _total(evidence: Evidence, force: Vector, right: Vector) -> Iterator[Explanation]:
    """The total is right and its distribution is not."""
    total, should = float(np.sum(force)), float(np.sum(right))
    if not should > 0 or abs(total - should) > 1e-6 * should or np.any(force < 0):
        return
    if evidence.part_apart("normal_force", force, right) <= LEFT:
        return
    unit = unit_of(evidence.problem.units.force)
    moved = 0.5 * float(np.sum(abs(force - right)))
    text = (
        f"the contact forces add up to the right total ({should:.4g}{unit}), but {moved:.3g}{unit} of it stand at the "
        "wrong contacts"
    )
    yield Explanation(Finding("distribution", text, True), LEFT)


def _any_factor(evidence: Evidence) -> Iterator[Explanation]:
    """Every part is right but for a factor that has no name."""
    known = factors(evidence)
    if known is None:
        return
    odd = {name: factor for name, factor in known.items() if abs(factor - 1) > LEFT and factor != 0}
    entries = sum(int(np.count_nonzero(getattr(evidence.given, name))) for name in odd)
    if not odd or entries < ENOUGH:
        return
    undone = evidence.with_parts(**{name: getattr(evidence.given, name) / factor for name, factor in odd.items()})
    left = evidence.apart(undone, evidence.right or evidence.answer)
    if evidence.explains(left):
        said = " and ".join(f"all {CALLED[name]} are {factor:.6g} times the right ones" for name, factor in odd.items())
        area = next(iter(odd.values()))
        hint = f" (pressures, on areas of {1 / area:.4g}?)" if set(odd) <= FORCES_OF_CONTACTS and area > 0 else ""
        yield Explanation(Finding("scaled", f"{said}, to {digits(left)}{hint}", True), left)
