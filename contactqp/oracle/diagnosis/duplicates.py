"""Contacts whose row stands twice, in the problem or in the model that an answer comes from."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from contactqp.model.arrays import Vector
from contactqp.oracle.diagnosis.evidence import LEFT, Evidence, Explanation
from contactqp.oracle.diagnosis.finding import Finding
from contactqp.oracle.diagnosis.symptoms import NAMED

# Of all pushing contacts, at most this part may be counted otherwise.
FEWER = 0.5


def duplicates(evidence: Evidence) -> Iterator[Explanation]:
    """Forces counted twice, or halved, at some contacts."""
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
