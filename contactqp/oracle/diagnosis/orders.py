"""Recognise answers whose values are permuted, answers with two mistakes, and wrong forces of local problems."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import permutations
from typing import Any, NamedTuple

import numpy as np

from contactqp.certificate.local_certificate import certify_local, contact_figures
from contactqp.errors import ContactQPError
from contactqp.model.arrays import Array, Indices, Vector
from contactqp.model.local_problem import LocalProblem, LocalSolution
from contactqp.model.solution import Solution
from contactqp.oracle.diagnosis.evidence import LEFT, Evidence, Explanation, Finding, digits
from contactqp.oracle.diagnosis.scales import named_factor
from contactqp.oracle.foreign.judging import GivenAnswer, certify_given

# The longest order that is printed.
WRITTEN = 12


def orders(evidence: Evidence) -> Iterator[Explanation]:
    """Yield explanations by orders of contacts, of unknowns, of both, and of tangential directions."""
    if evidence.right is None:
        return
    contact, unknown = None if evidence.shared else _of_contacts(evidence), _of_unknowns(evidence)
    for chosen in ([contact], [unknown], [contact, unknown]):
        found = [one for one in chosen if one is not None]
        if len(found) != len(chosen):
            continue
        changes: dict[str, Array] = {}
        for one in found:
            changes |= one[0]
        undone = evidence.with_parts(**changes)
        left = evidence.apart(undone, evidence.right)
        if evidence.explains(left):
            then = evidence.then(undone, left)
            *others, last = [Finding(kind, text, True, i > 0) for i, (_, kind, text) in enumerate(found)]
            last = replace(last, text=f"{last.text}: {then} in the problem's order")
            first, *beside = [*others, last]
            yield Explanation(first, left, tuple(beside))
            return
    if not evidence.shared:
        yield from _of_directions(evidence)


Order = tuple[dict[str, Array], str, str]


def _of_contacts(evidence: Evidence) -> Order | None:
    mine, right = evidence.given.normal_force, evidence.right.normal_force if evidence.right else None
    if mine is None or right is None or len(mine) < 2:
        return None
    place = _places(mine, right)
    if place is None:
        return None
    changes: dict[str, Array] = {"normal_force": mine[place]}
    if evidence.given.friction_force is not None:
        changes["friction_force"] = evidence.given.friction_force[place]
    count = len(mine)
    if np.array_equal(place, np.arange(count)[::-1]):
        words = "the contacts stand in reverse order"
    else:
        moved = np.flatnonzero(place != np.arange(count))
        names = [
            f"{evidence.problem.contact_name(int(i))} has the force of {evidence.problem.contact_name(int(j))}"
            for i, j in zip(place[moved[:2]], moved[:2], strict=True)
        ]
        words = f"the contacts stand in another order ({', '.join(names)})"
    if count <= WRITTEN:
        words += f", contact_map={[int(i) for i in place]}"
    return changes, "permuted", words


def _places(mine: Vector, right: Vector) -> Indices | None:
    """Return the permutation p with mine[p] = right, None if there is none, or if the order is right."""
    size = float(np.max(abs(right), initial=0.0))
    if size == 0 or np.max(abs(np.sort(mine) - np.sort(right))) > LEFT * size:
        return None
    if np.max(abs(mine - right)) <= LEFT * size:
        return None
    place = np.empty(len(mine), dtype=np.intp)
    place[np.argsort(right, kind="stable")] = np.argsort(mine, kind="stable")
    reverse = np.arange(len(mine))[::-1]
    return reverse if np.max(abs(mine[reverse] - right)) <= LEFT * size else place


def _of_unknowns(evidence: Evidence) -> Order | None:
    mine = evidence.given.displacement
    if mine is None or evidence.right is None or evidence.part_apart("displacement", mine, _right(evidence)) <= LEFT:
        return None
    right = _right(evidence)
    for place, words in _regular_orders(len(mine)):
        if evidence.part_apart("displacement", mine[place], right) <= LEFT:
            return {"displacement": mine[place]}, "permuted-unknowns", words
    general = _places(mine, right)
    if general is None or evidence.part_apart("displacement", mine[general], right) > LEFT:
        return None
    words = "the unknowns stand in another order"
    if len(mine) <= WRITTEN:
        words += f", dof_map={[int(i) for i in general]}"
    return {"displacement": mine[general]}, "permuted-unknowns", words


def _right(evidence: Evidence) -> Vector:
    assert evidence.right is not None
    return evidence.right.displacement


def _regular_orders(n: int) -> Iterator[tuple[Indices, str]]:
    """Return the usual orders of the components of nodes."""
    yield np.arange(n)[::-1], "the unknowns stand in reverse order"
    for d in (2, 3, 6):
        if n % d or n == d == 6:
            continue
        table = np.arange(n).reshape(-1, d)
        for order in permutations(range(d)) if d <= 3 else ():
            if order != tuple(range(d)):
                words = " ".join("xyz"[j] for j in order)
                yield table[:, list(order)].ravel(), f"the components of the nodes stand in the order {words}"
        blocked = np.arange(n).reshape(d, -1)
        yield blocked.T.ravel(), f"all {d} components stand one after the other (blocked), not node by node"
        yield table.T.ravel(), f"the {d} components stand node by node, not one after the other (blocked)"


def _of_directions(evidence: Evidence) -> Iterator[Explanation]:
    mine, right = evidence.given.friction_force, evidence.right
    if mine is None or right is None:
        return
    yield from _of_components(evidence, mine, right)
    if mine.shape[1] < 2:
        return
    by_direction = "the friction forces stand direction by direction, not by contact"
    swapped, *others = _tangential_mistakes(mine)
    tried = (swapped, (mine.ravel().reshape(2, -1).T, "tangent-order", by_direction), *others)
    for changed, kind, text in tried:
        undone = evidence.with_parts(friction_force=np.ascontiguousarray(changed))
        left = evidence.apart(undone, right)
        if evidence.explains(left):
            yield Explanation(Finding(kind, f"{text}: undone, {evidence.then(undone, left)}", True), left)
            return
    yield from _of_angle(evidence, mine, right)


def _tangential_mistakes(friction_force: Array) -> Iterator[tuple[Array, str, str]]:
    """Yield friction forces (m, 2) with swapped or reversed directions put right, the kind of mistake, and words."""
    swapped = friction_force[:, ::-1]
    yield swapped, "tangent-order", "the two tangential directions are swapped"
    for signs, which in (([-1.0, 1.0], "first"), ([1.0, -1.0], "second")):
        yield friction_force * signs, "tangent-sign", f"the {which} tangential direction has the opposite sign"
    for signs in ([1.0, -1.0], [-1.0, 1.0]):
        yield swapped * signs, "tangent-order", "the tangential directions are turned by a right angle"


def _of_components(evidence: Evidence, mine: Array, right: Solution) -> Iterator[Explanation]:
    """Yield an explanation if normal and tangential forces are exchanged."""
    normal = evidence.given.normal_force
    if normal is None:
        return
    table = np.column_stack([normal, mine])
    words = ("the normal force", "the first friction force", "the second friction force")
    for order in permutations(range(table.shape[1])):
        if order[0] == 0:
            continue
        for sign in (1.0, -1.0):
            undone = evidence.with_parts(
                normal_force=sign * table[:, order[0]], friction_force=table[:, list(order[1:])].copy()
            )
            left = evidence.apart(undone, right)
            if evidence.explains(left):
                turned = " with the opposite sign" if sign < 0 else ""
                message = (
                    f"the components of the contact forces are mixed up ({words[order[0]]} is the normal one{turned})"
                )
                text = f"{message}: undone, {evidence.then(undone, left)}"
                yield Explanation(Finding("components", text, True), left)
                return


def _of_angle(evidence: Evidence, mine: Array, right: Solution) -> Iterator[Explanation]:
    """Yield an explanation if one rotation or reflection of the tangents gives the right friction forces."""
    should = right.friction_force
    if should is None or np.sum(np.linalg.norm(should, axis=1) > LEFT * np.max(np.linalg.norm(should, axis=1))) < 2:
        return
    left_vectors, _, right_vectors = np.linalg.svd(mine.T @ should)
    turn = left_vectors @ right_vectors
    undone = evidence.with_parts(friction_force=mine @ turn)
    left = evidence.apart(undone, right)
    if evidence.explains(left):
        mirrored = np.linalg.det(turn) < 0
        angle = float(np.degrees(np.arctan2(turn[0, 1], turn[0, 0])))
        words = "mirrored and turned" if mirrored else f"turned by {abs(angle):.4g} degrees"
        text = f"the tangential directions are {words}: undone, {evidence.then(undone, left)}"
        yield Explanation(Finding("tangent-turned", text, True), left)


# Powers of ten of confused units, and the range of the factor left for the other mistake.
POWERS, NEAR = (3, 6), 0.3
# Without another mistake: the largest error after undoing, and the least factor by which undoing reduces it.
ROUGHLY, NEARER = 0.1, 20.0
# The least number of values for recognising signs and powers of ten.
ENOUGH = 3


class _Undone(NamedTuple):
    kind: str
    text: str
    given: GivenAnswer


def two_mistakes(evidence: Evidence, explained: Callable[[Evidence], list[Explanation]]) -> list[Explanation]:
    """Return findings of a wrong sign or unit, with those of `explained` for the answer with it undone.

    Forces that dependent contacts share otherwise than the right answer are judged here, too: the certificate passes
    them with their sign undone.
    """
    for undone in _undoings(evidence):
        try:
            found, completed = certify_given(
                evidence.problem, undone.given, evidence.certificate.tolerance, evidence.certificate.error_tolerance
            )
        except ContactQPError:
            continue
        if found.passed:
            text = f"{undone.text}: with that undone this answer is right"
            return [Explanation(Finding(undone.kind, text, True), 0.0)]
        if undone.kind == "friction-sign":  # alone; a second mistake is looked for behind the other signs and units
            continue
        after = replace(evidence, given=undone.given, answer=completed.answer, certificate=found)
        others = explained(after)
        if any(one.finding.kind != "scaled" for one in others):
            best = min(others, key=lambda one: one.error)
            beside = tuple(replace(one, together=True) for one in (best.finding, *best.beside))
            first, *rest = beside
            beside = (replace(first, text=f"with that undone, {first.text}"), *rest)
            return [Explanation(Finding(undone.kind, undone.text, True), best.error, beside)]
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
    if given.friction_force is not None and np.any(given.friction_force):
        text = "all friction forces have the opposite sign"
        yield _Undone("friction-sign", text, replace(given, friction_force=-given.friction_force))
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
    """Return the power of a thousand by which a size is too large, 0 if there is none."""
    if not 0 < mine < np.inf or not 0 < right < np.inf:
        return 0
    exponent = float(np.log10(mine) - np.log10(right))
    power = 3 * round(exponent / 3)
    return power if abs(power) in POWERS and abs(exponent - power) <= NEAR else 0


# The least tolerance that is not tried on local forces that may be right up to their printed digits.
COARSE = 1e-3


def mistake_in_local_forces(
    problem: LocalProblem, force: Array, joint_force: Vector | None, right: LocalSolution | None, tolerance: float
) -> Iterator[str]:
    """Yield what turns wrong forces of a local problem into right ones, at most one cause.

    It is a sign, an order, a unit or a few printed digits: undone, the certificate passes the forces.

    Parameters
    ----------
    problem : LocalProblem
    force : (m, d) array, finite and not all zero, in the order (N, T1, T2)
    joint_force : array or None, forces of joints that the contacts do not have
    right : LocalSolution or None, whose size shows a factor
    tolerance : float, of the verdict
    """

    def passes(force: Array, limit: float) -> bool:
        measures = contact_figures(problem, force, joint_force).values()
        small = all(float(np.max(part, initial=0.0)) <= limit for part in measures)
        return small and bool(certify_local(problem, force, joint_force, tolerance=limit).passed)

    for text, undone in _local_mistakes(force, right):
        if passes(undone, tolerance):
            yield f"{text} this answer is right"
            return
    for power in range(int(np.ceil(np.log10(tolerance) + 1e-9)), int(np.log10(COARSE))):
        if passes(force, 10.0**power):
            yield f"with --tolerance 1e{power:03d} this answer is right: printed digits, or iterations stopped early?"
            return


def _local_mistakes(force: Array, right: LocalSolution | None) -> Iterator[tuple[str, Array]]:
    """Yield mistakes in words, and the forces (m, d) without them."""
    m, d = force.shape
    yield "all normal forces have the opposite sign: with --compression negative", force * [-1.0, *[1.0] * (d - 1)]
    yield "all forces have the opposite sign, those on the obstacle? Turned,", -force
    yield "all tangential forces have the opposite sign: turned,", force * [1.0, *[-1.0] * (d - 1)]
    order = "(T1, T2, N)" if d == 3 else "(T, N)"
    yield f"the columns stand in the order {order}: in the order (N, T1, T2)", np.roll(force, 1, axis=1)
    for friction_force, _, text in _tangential_mistakes(force[:, 1:]) if d == 3 else ():
        yield f"{text}: undone,", np.column_stack([force[:, 0], friction_force])
    yield "the contacts stand in reverse order: turned round,", force[::-1]
    yield "all normal forces stand before the tangential ones: contact by contact", force.ravel().reshape(d, m).T
    if right is not None and np.any(right.force):
        factor = float(np.sum(force * right.force) / np.sum(right.force**2))
        named = named_factor(factor, length=False, unit="") if factor else None
        if named is not None and named.exact not in (0.0, 1.0, -1.0):
            guess = f" ({named.guess}?)" if named.guess else ""
            yield f"all forces are {named.exact:.10g} times the right ones{guess}: divided,", force / named.exact
