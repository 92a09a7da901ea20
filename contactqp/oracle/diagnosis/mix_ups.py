"""Recognise answers that are right but for contacts counted twice, one value, a share, or an offset."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from contactqp.model.arrays import Vector
from contactqp.oracle.diagnosis.evidence import LEFT, NAMED, Evidence, Explanation, Finding, digits, unit_of
from contactqp.oracle.diagnosis.scales import CALLED, factors

# Of all pushing contacts, at most this part may be counted otherwise.
FEWER = 0.5


def duplicates(evidence: Evidence) -> Iterator[Explanation]:
    """Yield forces counted twice, or halved, at some contacts."""
    yield from _rows_twice(evidence)
    if evidence.right is None or evidence.shared:
        return
    force, u = evidence.given.normal_force, evidence.given.displacement
    if force is not None and (u is None or evidence.part_apart("displacement", u, evidence.right.displacement) <= LEFT):
        yield from _counted_otherwise(evidence, force, evidence.right.normal_force)


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
    """Groups of contacts with the same row and gap."""
    problem = evidence.problem
    rows = problem.normal
    keys: dict[bytes, list[int]] = {}
    for i, (start, end) in enumerate(zip(rows.indptr[:-1], rows.indptr[1:], strict=True)):
        key = rows.indices[start:end].tobytes() + rows.data[start:end].tobytes() + problem.gap[[i]].tobytes()
        keys.setdefault(key, []).append(i)
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


# Answers of which every value is right but one.

# Values that there must be.
LEAST = 6
# A value this near to the right one, as a part of the largest of its kind, is right.
RIGHT = 1e-9


def one_value(evidence: Evidence) -> Iterator[Explanation]:
    """Yield an explanation where all values but one are right."""
    right = evidence.right
    if right is None or evidence.shared:
        return
    wrong: list[tuple[str, int, float, float]] = []
    count = 0
    for name in evidence.given_parts:
        mine, should = np.ravel(getattr(evidence.given, name)), np.ravel(getattr(right, name))
        weight = np.ravel(evidence.weights[name])
        size = float(np.max(abs(weight * should), initial=0.0)) or 1.0
        count += len(mine)
        off = np.flatnonzero(abs(weight * (mine - should)) > RIGHT * size)
        wrong += [(name, int(i), float(mine[i]), float(should[i])) for i in off]
    if len(wrong) != 1 or count < LEAST:
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


# Answers of which a part is right: the total and not its distribution, all but the areas, all but one factor.

FORCES_OF_CONTACTS = {"normal_force", "friction_force"}
# Contacts that must push before their factors mean anything.
ENOUGH = 3
# The smallest area of the largest, where forces are taken for pressures.
AREAS_DIFFER = 0.95


def shares(evidence: Evidence) -> Iterator[Explanation]:
    """Yield what forces have in common with the right ones where displacements are right or were not given."""
    if evidence.right is None or evidence.shared:
        return
    force = evidence.given.normal_force
    u = evidence.given.displacement
    if force is not None and (u is None or evidence.part_apart("displacement", u, evidence.right.displacement) <= LEFT):
        yield from _pressures(evidence, force, evidence.right.normal_force)
        yield from _total(evidence, force, evidence.right.normal_force)
    yield from _any_factor(evidence)


def _pressures(evidence: Evidence, force: Vector, right: Vector) -> Iterator[Explanation]:
    """Yield an explanation where every pushing contact has a positive factor of its own: few of them differ, or areas
    were given.
    """
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
    """Yield an explanation where the total is right and its distribution is not."""
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
    """Yield an explanation where every part is right but for a factor that has no name."""
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


# Nodes that must have moved alike, and pushing contacts that must have one gap.
NODES, CONTACTS, SOME = 3, 2, 50


# Right answers but for an offset: of all gaps alike, or of all displacements alike.


def shifted(evidence: Evidence) -> Iterator[Explanation]:
    """Offsets of gaps and of displacements."""
    yield from _gaps(evidence)
    yield from _displacements(evidence)


def _gaps(evidence: Evidence) -> Iterator[Explanation]:
    """Yield an explanation where all pushing contacts have one gap, and with all gaps less that the answer passes."""
    found, problem = evidence.certificate.violations, evidence.problem
    if found is None:
        return
    limit = evidence.certificate.tolerance
    pushing = evidence.answer.normal_force > 0
    pushing &= found.force_measure > limit
    if np.sum(pushing) < CONTACTS or not np.all(found.gap_measure[pushing] > limit):
        return
    rows = problem.normal[np.flatnonzero(pushing)[:SOME]].toarray()
    if np.linalg.matrix_rank(rows) < CONTACTS:  # rows that say the same have one gap whatever is wrong
        return
    offset = float(np.median(found.gap[pushing]))
    if not np.isfinite(offset) or np.max(abs(found.gap[pushing] - offset)) > LEFT * abs(offset):
        return
    if evidence.passes_with(gap=problem.gap - offset):
        size = f"{abs(offset):.4g}{unit_of(problem.units.length)}"
        text = (
            f"it is the right answer with every gap {'smaller' if offset > 0 else 'larger'} by {size}: a thickness, an "
            "offset of surfaces or an adjustment of nodes?"
        )
        yield Explanation(Finding("gap-offset", text, True), 0.0)


def _displacements(evidence: Evidence) -> Iterator[Explanation]:
    """Yield an explanation where all nodes are off by the same displacement."""
    u, right = evidence.given.displacement, evidence.right
    if u is None or right is None or not np.all(np.isfinite(u)):
        return
    off = u - right.displacement
    for d in (1, 2, 3):
        if len(u) % d or len(u) < NODES * d:
            continue
        mean = np.mean(off.reshape(-1, d), axis=0)
        back = np.ravel(np.full((len(u) // d, d), mean))
        undone = evidence.with_parts(displacement=u - back)
        left = evidence.apart(undone, right)
        if np.any(mean) and evidence.explains(left):
            sizes = ", ".join(f"{one:.4g}" for one in mean)
            size = f"({sizes})" if d > 1 else sizes
            unit = unit_of(evidence.problem.units.length)
            text = (
                f"all displacements are off by the same {size}{unit}: counted from elsewhere, or a rigid motion was "
                f"added? Without it {evidence.then(undone, left)}"
            )
            yield Explanation(Finding("shifted", text, True), left)
            return
