"""Answers of which a part is right: the total and not its distribution, all contacts but some, all but one factor."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from contactqp.oracle.evidence import LEFT, Evidence, Explanation, digits
from contactqp.oracle.finding import Finding
from contactqp.oracle.scales import CALLED, factors
from contactqp.oracle.symptoms import NAMED, unit_of
from contactqp.problem import Vector

# Contacts that must push before their factors mean anything.
ENOUGH = 3
# Of so many pushing contacts, at most this part may be counted otherwise.
FEWER = 0.5


def shares(evidence: Evidence) -> Iterator[Explanation]:
    """What forces have in common with the right ones where displacements are right or were not given."""
    yield from _rows_twice(evidence)
    if evidence.right is None or evidence.shared:
        return
    force = evidence.given.normal_force
    u = evidence.given.displacement
    if force is not None and (u is None or evidence.part_apart("displacement", u, evidence.right.displacement) <= LEFT):
        yield from _counted_otherwise(evidence, force, evidence.right.normal_force)
        yield from _pressures(evidence, force, evidence.right.normal_force)
        yield from _total(evidence, force, evidence.right.normal_force)
    yield from _one_value(evidence)
    yield from _any_factor(evidence)


def _rows_twice(evidence: Evidence) -> Iterator[Explanation]:
    """Rows of the problem that are one contact, each with all of its force (or half of what their sum should be)."""
    force, right, problem = evidence.given.normal_force, evidence.right, evidence.problem
    if force is None or right is None or problem.contacts < 2:
        return
    groups = _same_rows(evidence)
    changed, doubled = force.copy(), []
    for members in groups:
        total, should = float(np.sum(force[members])), float(np.sum(right.normal_force[members]))
        if should > 0 and abs(total - len(members) * should) <= LEFT * should:
            changed[members] /= len(members)
            doubled.append(members)
    if not doubled:
        return
    undone = evidence.with_parts(normal_force=changed)
    left = evidence.apart(undone, right)
    if evidence.explains(left):
        names = " and ".join(problem.contact_name(int(i)) for i in doubled[0])
        text = f"a contact row appears twice ({names}), and the force was counted at each: shared, "
        yield Explanation(Finding("duplicate-row", text + evidence.then(undone, left), True), left)


def _same_rows(evidence: Evidence) -> list[np.ndarray]:
    """Groups of contacts with the same row and gap, all scaled alike."""
    problem = evidence.problem
    keys: dict[bytes, list[int]] = {}
    for i in range(problem.contacts):
        row = problem.normal[[i]].tocoo()
        size = float(np.max(abs(row.data)))
        values = np.round(np.concatenate([row.data / size, [problem.gap[i] / size]]), 12) + 0.0
        keys.setdefault(np.asarray(row.col, dtype=np.int64).tobytes() + values.tobytes(), []).append(i)
    return [np.array(members) for members in keys.values() if len(members) > 1]


def _counted_otherwise(evidence: Evidence, force: Vector, right: Vector) -> Iterator[Explanation]:
    """Some contacts have half or twice their force, the others are right."""
    size = float(np.max(abs(right), initial=0.0))
    acting = right > LEFT * size
    if np.sum(acting) < 2:
        return
    ratio = np.where(acting, force / np.where(acting, right, 1.0), 1.0)
    for factor, said in ((0.5, "half"), (2.0, "twice")):
        members = np.flatnonzero(abs(ratio - factor) <= LEFT)
        if not members.size or len(members) > FEWER * np.sum(acting):
            continue
        changed = force.copy()
        changed[members] /= factor
        undone = evidence.with_parts(normal_force=changed)
        left = evidence.apart(undone, evidence.right or evidence.answer)
        if evidence.explains(left):
            names = ", ".join(evidence.problem.contact_name(int(i)) for i in members[:NAMED])
            text = f"{names} {'has' if len(members) == 1 else 'have'} {said} the right force, all others are right: "
            text += "a contact row that appears twice in the model?"
            yield Explanation(Finding("duplicate-row", text, True), left)
            return


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
    values = np.unique(np.round(area / np.max(area), 4)) if np.all(area > 0) else np.zeros(0)
    if 2 <= len(values) <= max(2, int(np.sum(acting)) // 2):
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


def _one_value(evidence: Evidence) -> Iterator[Explanation]:
    """All values but one are right."""
    right = evidence.right
    assert right is not None
    wrong: list[tuple[str, int, float, float]] = []
    count = 0
    for name in evidence.given_parts:
        mine, should = np.ravel(getattr(evidence.given, name)), np.ravel(getattr(right, name))
        weight = np.ravel(evidence.weights[name])
        size = float(np.max(abs(weight * should), initial=0.0)) or 1.0
        count += len(mine)
        off = np.flatnonzero(abs(weight * (mine - should)) > 1e-9 * size)
        wrong += [(name, int(i), float(mine[i]), float(should[i])) for i in off]
    if len(wrong) != 1 or count < 2 * ENOUGH:
        return
    name, i, mine_value, should_value = wrong[0]
    problem, values = evidence.problem, getattr(evidence.given, name)
    width = values.shape[1] if values.ndim > 1 else 1
    called = problem.dof_name if name == "displacement" else problem.contact_name
    where = f"tie {i}" if name == "tie_force" else called(i // width)
    unit = unit_of(problem.units.length if name == "displacement" else problem.units.force)
    what = f"the {name.replace('_', ' ')} of {where}"
    text = f"all values are right but one: {what} is {mine_value:.6g}{unit} instead of {should_value:.6g}{unit}"
    yield Explanation(Finding("one-value", text, True), 0.0)


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
        yield Explanation(Finding("scaled", f"{said}, to {digits(left)}", True), left)
