"""Explain a wrong answer without solving a problem: by another law that it obeys, or by a single mistake.

Other laws are springs for contacts, barriers, other loads or moduli and other friction. They are recognised by the
residual r = f - K u - E_N'l_N - E_T'l_T - A'nu and by the relation of forces to gaps and slips. Single mistakes are
contacts counted twice, one wrong value, wrong shares, or an offset.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.messages import unit_of
from contactqp.linalg.extended import extend, extended_rows
from contactqp.linalg.measures import directions, lengths
from contactqp.model.arrays import TINY, Array, Mask, Vector
from contactqp.model.coulomb import slips
from contactqp.model.solution import Violations
from contactqp.oracle.diagnosis.evidence import LEFT, NAMED, Evidence, Explanation, Finding, digits
from contactqp.oracle.diagnosis.scales import CALLED, factors

# Figures below this count as satisfied in a wrong answer of moderate accuracy.
MET = 1e-6
# Spring stiffnesses, ratios and products with this relative spread count as equal.
ONE_VALUE = 1e-3
# The same if few different ones are expected, as printed overlaps have few digits.
ONE_OF_FEW = 5e-3
# A single penetration so small, with all else right to this accuracy, indicates no spring.
STOPPED = 1e-6
# The relative deviation of a force from a law that it obeys.
OBEYS = 1e-3


def laws(evidence: Evidence) -> Iterator[Explanation]:
    """Yield explanations by other laws that the complete answer obeys."""
    found = evidence.certificate.violations
    if found is None:
        return
    certificate = evidence.certificate
    balanced = max(certificate.equilibrium, certificate.balance) <= MET and certificate.tie <= MET
    if balanced:
        yield from _springs(evidence, found)
        yield from _barrier(evidence, found)
        yield from _rough(evidence, found)
    touching = max(certificate.penetration, certificate.tension, certificate.complementarity, certificate.tie) <= MET
    if touching and certificate.equilibrium > certificate.tolerance:
        yield from _residual(evidence, found)


def _springs(evidence: Evidence, found: Violations) -> Iterator[Explanation]:
    """Yield an explanation if every force is a spring's, l_i = beta_i p_i with the penetration p_i = -gap_i."""
    problem, force = evidence.problem, evidence.answer.normal_force
    limit = evidence.certificate.tolerance
    pushed = found.force_measure > limit
    off = (found.gap_measure > 1e-12) & np.isfinite(found.gap)
    sprung = pushed & off & (force * found.gap < 0)
    if (
        not np.any(sprung)
        or np.any(pushed & ~sprung)
        or np.any((found.gap < 0) & (found.gap_measure > limit) & ~pushed)
    ):
        return
    if np.sum(sprung) == 1 and evidence.before <= STOPPED:  # may as well be unfinished iterations
        return
    stiffness = force[sprung] / -found.gap[sprung]
    if not np.all((stiffness > 0) & np.isfinite(stiffness)):  # overflow
        return
    lowest, highest = float(np.min(stiffness)), float(np.max(stiffness))
    spread = highest / lowest - 1
    f, length = problem.units.force, problem.units.length
    unit = unit_of(f"{f}/{length}" if f and length else "")
    pulls = sprung & (force < 0)
    kind = "bilateral-springs" if np.any(pulls) else "penalty"
    far, near = float(np.max(abs(found.gap[sprung]))), float(np.min(abs(found.gap[sprung])))
    size = f"near {far:.2g}" if far <= 2 * near else f"from {near:.2g} to {far:.2g}"
    what = "penetration or pull" if np.any(pulls) else "penetration"
    rule = ", proportional to the force" if spread <= ONE_VALUE else ", with every force"
    rule = "" if np.sum(sprung) == 1 else rule
    beta = f"about {np.median(stiffness):.3g}{unit}"
    if spread > ONE_VALUE:
        others = "few different ones" if _few(stiffness) else "each contact its own"
        beta = f"{lowest:.3g} to {highest:.3g}{unit}, {others}"
    also = ", of springs that also pull" if np.any(pulls) else ""
    where = "everywhere" if np.sum(sprung) > 1 else f"at {problem.contact_name(int(np.flatnonzero(sprung)[0]))}"
    text = f"{what} {where} {size}{unit_of(length)}{rule}: looks like a penalty of {beta}{also}"
    if np.sum(sprung) == 1 and not np.any(pulls):
        text += ", or like a gap that is larger by as much"
    one_stiffness = (spread <= ONE_VALUE and np.sum(sprung) > 1) or _few(stiffness)
    # One spring, or springs of any stiffness, fit too easily: only if nothing else is wrong and all parts were given.
    noise = max(limit, ONE_VALUE * float(np.max(found.gap_measure[sprung])))
    strict = evidence.certificate.equilibrium <= noise and not evidence.recovered
    if one_stiffness or strict:
        yield Explanation(Finding(kind, text, True), MET if one_stiffness else LATER)


def _few(stiffness: Vector) -> bool:
    """Return whether at most a third of the values differ, as penalties proportional to areas do on a regular mesh."""
    steps = np.diff(np.log(np.sort(stiffness)))
    return 3 * (1 + int(np.sum(steps > ONE_OF_FEW))) <= len(stiffness)


# The nominal remaining error of explanations that should yield to better ones.
LATER = 0.9e-3


def _barrier(evidence: Evidence, found: Violations) -> Iterator[Explanation]:
    """Yield an explanation if l_i gap_i is the same at all contacts and none is closed, as in an interior point."""
    force, gap = evidence.answer.normal_force, found.gap
    if len(gap) < 2 or np.any(force <= 0) or np.any(gap <= 0) or evidence.problem.frictional:
        return
    product = force * gap
    least, most = float(np.min(product)), float(np.max(product))
    if not (least > 0 and most <= 1.1 * least < np.inf):  # products may overflow
        return
    unit = unit_of(evidence.problem.units.force), unit_of(evidence.problem.units.length)
    text = (
        f"every contact is open and pushes, force times gap being {np.median(product):.3g}{unit[0]}{unit[1]} at all of "
        "them: an interior-point method that stopped early?"
    )
    yield Explanation(Finding("barrier", text, True), MET)


def _residual(evidence: Evidence, found: Violations) -> Iterator[Explanation]:
    """Yield explanations if the residual is a multiple of the load, of K u or of u, or the load of some unknowns."""
    problem, u, r = evidence.problem, evidence.answer.displacement, found.residual
    inner = (extended_rows(problem).stiffness @ extend(u)).double()
    part = _multiple(r, problem.load)
    # A factor printed as 1 is due to the rounding of the answer.
    if part is not None and f"{1 - part:.4g}" != "1" and evidence.passes_with(load=(1 - part) * problem.load):
        factor = 1 - part
        words = {0.0: "no load at all", -1.0: "the load with the opposite sign", 2.0: "twice the load"}
        text = f"it is the right answer to {words.get(round(factor, 6), f'{factor:.4g} times the load')}"
        yield Explanation(Finding("load", text, True), 0.0)
    missing = abs(r - problem.load) <= OBEYS * abs(problem.load)
    missing &= problem.load != 0
    if np.any(missing) and np.all(abs(r[~missing]) <= MET * found.meeting[~missing]):
        without = np.where(missing, 0.0, problem.load)
        if evidence.passes_with(load=without):
            names = ", ".join(problem.dof_name(int(j)) for j in np.flatnonzero(missing)[:5])
            text = f"it is the right answer without the load of {names}"
            yield Explanation(Finding("load-missing", text, True), 0.0)
            return
    part = _multiple(r, inner)
    told = part is not None and part > -1 and f"{1 + part:.6g}" != "1"
    if part is not None and told and _passes_with(evidence, (1 + part) * problem.stiffness):
        text = f"the bodies are {1 + part:.6g} times as stiff as the problem's: another modulus?"
        yield Explanation(Finding("stiffness", text, True), MET)
        return
    diagonal = problem.diagonal
    for added, what in ((np.ones_like(u), "u"), (diagonal, "diag(K) u")):
        part = _multiple(r, added * u)
        if part is not None and part > 0 and _passes_with(evidence, problem.stiffness + sp.diags(part * added)):
            text = (
                f"what is out of balance is {part:.3g} {what}: the stiffness was regularised (that much was added to "
                "its diagonal)"
            )
            yield Explanation(Finding("regularised", text, True), MET)
            return


def _passes_with(evidence: Evidence, stiffness: Any) -> bool:
    return evidence.passes_with(stiffness=sp.csr_matrix(stiffness))


def _multiple(vector: Vector, of: Vector) -> float | None:
    """Return the factor c with vector = c of, None if there is none."""
    largest, scale = (float(np.max(abs(one), initial=0.0)) for one in (vector, of))
    if not (0 < largest < np.inf and 0 < scale < np.inf):
        return None
    shape, along = vector / largest, of / scale  # squares may overflow
    part = float(shape @ along) / float(along @ along)
    return part * (largest / scale) if float(np.max(abs(shape - part * along))) <= OBEYS else None


def _rough(evidence: Evidence, found: Violations) -> Iterator[Explanation]:
    """Yield explanations if friction follows another law: sign, coefficient, direction or shape of the cone."""
    problem, answer, limit = evidence.problem, evidence.answer, evidence.certificate.tolerance
    slip = slips(problem, answer.displacement)
    if not problem.frictional or problem.friction is None or slip is None or answer.friction_force is None:
        return
    normal_law = max(evidence.certificate.penetration, evidence.certificate.tension) <= MET
    force, mu = answer.friction_force, problem.friction
    slides, push = found.slip_measure > max(limit, MET), answer.normal_force
    bound = mu * np.maximum(push, 0.0)
    acting = found.force_measure > limit
    sliding = slides & acting & (mu > 0)
    size, along = lengths(force), directions(slip)
    if normal_law and np.any(sliding) and np.any(found.gap_measure[sliding] > MET):
        dilated = mu * lengths(slip)
        if np.all(abs(found.gap - dilated)[sliding] <= OBEYS * dilated[sliding]):
            text = "what slides also rises, by mu times its slip: the associated relaxation, and not Coulomb's law"
            yield Explanation(Finding("associated", text, True), MET)
            return
    if not normal_law or evidence.certificate.complementarity > MET:
        return
    beyond = (found.cone > limit) & acting
    if np.any(sliding) and np.max(lengths(force + bound[:, None] * along)[sliding] / bound[sliding]) <= OBEYS:
        text = "friction pushes along where it should hold back: its sign is reversed wherever something slides"
        yield Explanation(Finding("friction-reversed", text, True), MET)
        return
    if np.any(beyond) and not np.any(sliding):
        names = ", ".join(problem.contact_name(int(i)) for i in np.flatnonzero(beyond)[:3])
        text = f"everything sticks, also {names}, where mu l_N cannot hold it: no slip was allowed"
        yield Explanation(Finding("stuck", text, True), MET)
        return
    if np.any(sliding):
        yield from _other_cone(evidence, sliding, size, bound, slip)


def _other_cone(evidence: Evidence, sliding: Mask, size: Vector, bound: Vector, slip: Array) -> Iterator[Explanation]:
    problem, force = evidence.problem, evidence.answer.friction_force
    assert problem.friction is not None
    assert force is not None
    ratio = size[sliding] / np.maximum(bound[sliding], TINY)
    factor = float(np.median(ratio))
    if abs(factor - 1) > OBEYS and np.max(abs(ratio - factor)) <= OBEYS * factor:
        other = factor * problem.friction
        if evidence.passes_with(friction=other):
            values = np.unique(np.round(other[other > 0], 9))
            words = f"mu = {values[0]:.4g}" if len(values) == 1 else f"{factor:.4g} times mu"
            mine = f"{problem.friction[sliding][0]:.4g}"
            text = f"it is the right answer with {words}, where the problem has mu = {mine}"
            yield Explanation(Finding("friction-coefficient", text, True), 0.0)
            return
    if force.shape[1] > 1:
        # With a square cone each slipping component is at the bound.
        at_bound = abs(abs(force) - bound[:, None]) <= OBEYS * bound[:, None]
        still = abs(slip) <= OBEYS * lengths(slip)[:, None]
        square = np.all(at_bound | still, axis=1)[sliding]
        diamond = abs(np.sum(abs(force), axis=1) - bound)[sliding] <= OBEYS * bound[sliding]
        if np.all(square) or np.all(diamond):
            text = "friction is bounded direction by direction: a pyramid instead of Coulomb's round cone"
            yield Explanation(Finding("pyramid", text, True), MET)


# The largest part of the pushing contacts that may be counted differently.
FEWER = 0.5


def duplicates(evidence: Evidence) -> Iterator[Explanation]:
    """Yield explanations by forces counted twice, or halved, at some contacts."""
    yield from _rows_twice(evidence)
    if evidence.right is None or evidence.shared:
        return
    force, u = evidence.given.normal_force, evidence.given.displacement
    if force is not None and (u is None or evidence.part_apart("displacement", u, evidence.right.displacement) <= LEFT):
        yield from _counted_otherwise(evidence, force, evidence.right.normal_force)


def _rows_twice(evidence: Evidence) -> Iterator[Explanation]:
    """Yield an explanation if the problem repeats a contact row and each copy has the whole force."""
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
    """Return the groups of contacts with equal rows and gaps."""
    problem = evidence.problem
    rows = problem.normal
    keys: dict[bytes, list[int]] = {}
    for i, (start, end) in enumerate(zip(rows.indptr[:-1], rows.indptr[1:], strict=True)):
        key = rows.indices[start:end].tobytes() + rows.data[start:end].tobytes() + problem.gap[[i]].tobytes()
        keys.setdefault(key, []).append(i)
    return [np.array(members) for members in keys.values() if len(members) > 1]


def _counted_otherwise(evidence: Evidence, force: Vector, right: Vector) -> Iterator[Explanation]:
    """Yield an explanation if some contacts have half or twice the right force and the others the right one."""
    size = float(np.max(abs(right), initial=0.0))
    acting = right > LEFT * size
    if np.sum(acting) < 2:
        return
    ratio = np.where(acting, force / np.where(acting, right, 1.0), 1.0)
    for factor, words in ((0.5, "half"), (2.0, "twice")):
        members = np.flatnonzero(abs(ratio - factor) <= LEFT)
        if not members.size or len(members) > FEWER * np.sum(acting):
            continue
        changed = force.copy()
        changed[members] /= factor
        undone = evidence.with_parts(normal_force=changed)
        left = evidence.apart(undone, evidence.right or evidence.answer)
        if evidence.explains(left):
            names = ", ".join(evidence.problem.contact_name(int(i)) for i in members[:NAMED])
            text = f"{names} {'has' if len(members) == 1 else 'have'} {words} the right force, all others are right: "
            text += "a contact row that appears twice in the model?"
            yield Explanation(Finding("duplicate-row", text, True), left)
            return


# Answers with one wrong value.

# The least number of values.
LEAST = 4
# The error, relative to the largest of its kind, up to which a value is right.
RIGHT = 1e-9


def one_value(evidence: Evidence) -> Iterator[Explanation]:
    """Yield an explanation if all values but one are right."""
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
    called = {"displacement": problem.dof_name, "tie_force": problem.tie_name}.get(name, problem.contact_name)
    where = called(i // width)
    unit = unit_of(problem.units.length if name == "displacement" else problem.units.force)
    what = f"the {name.replace('_', ' ')} of {where}"
    text = f"all values are right but one: {what} is {mine_value:.6g}{unit} instead of {should_value:.6g}{unit}"
    yield Explanation(Finding("one-value", text, True), 0.0)


# Partly right answers: total right but not its distribution, all right except areas, or except one factor.

FORCES_OF_CONTACTS = {"normal_force", "friction_force"}
# The least number of pushing contacts for which factors are examined.
ENOUGH = 3
# The least ratio of areas if forces are confused with pressures.
AREAS_DIFFER = 0.95


def shares(evidence: Evidence) -> Iterator[Explanation]:
    """Yield explanations of forces if displacements are right or were not given."""
    if evidence.right is None or evidence.shared:
        return
    force = evidence.given.normal_force
    u = evidence.given.displacement
    if force is not None and (u is None or evidence.part_apart("displacement", u, evidence.right.displacement) <= LEFT):
        yield from _pressures(evidence, force, evidence.right.normal_force)
        yield from _total(evidence, force, evidence.right.normal_force)
    yield from _any_factor(evidence)


def _pressures(evidence: Evidence, force: Vector, right: Vector) -> Iterator[Explanation]:
    """Yield an explanation if each pushing force has a positive factor, and few of these differ or areas were given."""
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
    if np.sum(abs(area - 1) > LEFT) < 2:  # a single wrong force
        return
    values = np.unique(np.round(area / np.max(area), 4)) if np.all(area > 0) else np.zeros(0)
    # Areas differ by more than the error of an inexact answer.
    if 2 <= len(values) <= max(2, int(np.sum(acting)) // 2) and values[0] < AREAS_DIFFER:
        text = (
            f"the forces are the right ones divided by {np.min(area):.4g} to {np.max(area):.4g}, few different "
            "numbers: pressures? With pressure_area= they are turned into forces"
        )
        yield Explanation(Finding("pressure", text, True), LEFT)


def _total(evidence: Evidence, force: Vector, right: Vector) -> Iterator[Explanation]:
    """Yield an explanation if the total is right and its distribution is not."""
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
    """Yield an explanation if every part is right up to an unnamed factor."""
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
        text = " and ".join(f"all {CALLED[name]} are {factor:.6g} times the right ones" for name, factor in odd.items())
        area = next(iter(odd.values()))
        hint = f" (pressures, on areas of {1 / area:.4g}?)" if set(odd) <= FORCES_OF_CONTACTS and area > 0 else ""
        yield Explanation(Finding("scaled", f"{text}, to {digits(left)}{hint}", True), left)


# The least numbers of nodes with equal offset, and of pushing contacts with equal gap.
NODES, CONTACTS, SOME = 3, 2, 50


# Answers right up to one offset of all gaps or of all displacements.


def shifted(evidence: Evidence) -> Iterator[Explanation]:
    """Yield explanations by one offset of all gaps, or by one displacement of all nodes."""
    yield from _gaps(evidence)
    yield from _displacements(evidence)


def _gaps(evidence: Evidence) -> Iterator[Explanation]:
    """Yield an explanation if all pushing contacts have the same gap, and the answer passes with gaps reduced by it."""
    found, problem = evidence.certificate.violations, evidence.problem
    if found is None:
        return
    limit = evidence.certificate.tolerance
    pushing = evidence.answer.normal_force > 0
    pushing &= found.force_measure > limit
    if np.sum(pushing) < CONTACTS or not np.all(found.gap_measure[pushing] > limit):
        return
    rows = problem.normal[np.flatnonzero(pushing)[:SOME]].toarray()
    if np.linalg.matrix_rank(rows) < CONTACTS:  # equal rows have equal gaps in any answer
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
    """Yield an explanation if all nodes have the same error of displacement."""
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
