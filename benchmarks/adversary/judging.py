"""What is right of a problem, and all that comes out that is not: one `Finding` for each.

Without friction the truth is found in rational numbers (`exact_truth`); `judging_friction` has the law with friction.
"""

from __future__ import annotations

import re
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

import contactqp as cq
from benchmarks.adversary.grammar import in_units
from benchmarks.exact_truth import Truth
from benchmarks.friction_families import Posed, Units
from benchmarks.judging import PER_CONDITION, REPRESENTABLE, WRONG, bounded, exact_truth, spoiled
from contactqp.solving.methods import find
from contactqp.solving.methods.method import QUADRATIC_PROGRAM

Array = np.ndarray
# Seconds of the processor within which everything that is asked must be answered, unless `--patience` says another.
PATIENCE = 5.0
# One refused answer in so many is asked what is wrong with it.
DIAGNOSED = 4
# Seconds that an iteration may take which is asked for by name.
ITERATES = 60.0
# Time limits that methods are given, so that those which know none of their own stop.
TIME_LIMIT = 2.0
# Conditions from which rounding of the data decides what is right.
WORST_CONDITION = 1e12
# Of the largest displacement or force, what rounding in other units may change: a factorisation that pivots otherwise.
SAME_DIGITS = 1e-13
# A gap that is rational and that nothing closes.
NEVER = 2.0**200
# Forces that are this part of the intrinsic size of problem and answer are seen where they are forged.
SEEN = 1e-3
# A displacement that is right to this part strains what is moved rigidly by no more than counts as nothing.
MOVED_RIGHTLY = 1e-11
# A force that is beyond its bound by this part of those that meet where it acts is beyond the tolerance of 1e-9.
HARDLY_SEEN = 1e-8
# A part of the forces that meet that counts as nothing on a rigid motion is at most a thousandth of this.
MUCH = 1e-9
# What a forgery adds to forces or lengths: far above the tolerance of 1e-9, below the errors that bounds pass.
FORGED = 1e-6


@dataclass(frozen=True)
class Finding:
    """Something that must not be."""

    kind: str  # crashed, wrong, denied, refused, unproven, forgery, bound, units, slow, printed
    what: str  # the call
    text: str


@dataclass
class Judge:
    """The findings about one problem, and how many answers were judged."""

    posed: Posed
    seed: int
    findings: list[Finding] = field(default_factory=list)
    judgements: int = 0
    exact: bool = False  # whether the truth is known

    def ask(
        self, what: str, question: Callable[[], Any], patience: float | None = None
    ) -> tuple[Any, Exception | None]:
        """What a call returns, or the error of this package that it raises; anything else is a finding."""
        self.judgements += 1
        started, error, answer = time.process_time(), None, None
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                answer = question()
            except cq.ContactQPError as raised:
                error = raised
            except Exception as raised:  # noqa: BLE001  whatever leaves is what is looked for
                error = raised
                self.found("crashed", what, f"{type(raised).__name__}: {str(raised)[:200]}")
        seconds = time.process_time() - started
        if seconds > (PATIENCE if patience is None else patience):
            self.found("slow", what, f"{seconds:.0f} s")
        return answer, error

    def found(self, kind: str, what: str, text: str) -> None:
        self.findings.append(Finding(kind, what, text))

    def plain(self, answer: Any) -> tuple[Array, Array]:
        """Displacement and normal forces of an answer in the numbers that the problem was made in."""
        u = self.posed.units
        displacement = np.asarray(answer.displacement) / u.unknown / u.length
        return displacement, np.asarray(answer.normal_force) * u.row / u.force

    def certify(self, what: str, displacement: Array, normal: Array, friction: Any, tie: Array) -> Any:
        """The certificate of an answer in plain numbers, of the problem in its units."""
        u = self.posed.units
        rubbed = None if friction is None else friction * (u.force / u.row)[:, None]
        forces = (normal * u.force / u.row, rubbed, tie * u.force)
        given = displacement * u.unknown * u.length
        judged = self.ask(what, lambda: cq.certify(self.posed.problem, given, *forces))[0]
        if judged is not None and not judged.passed and self.judgements % DIAGNOSED == 0:
            self.ask(f"findings of {what}", lambda: judged.findings)
        return judged


def solve(judge: Judge, method: str, **options: Any) -> tuple[Any, Exception | None]:
    if find(method).kind == QUADRATIC_PROGRAM and "no time limit" not in find(method).note:
        options["time_limit"] = TIME_LIMIT
    fresh = judge.posed.problem.replace(stiffness=judge.posed.problem.stiffness)
    name, patience = (options["algorithm"], ITERATES) if "algorithm" in options else (method, None)
    return judge.ask(f"solve {name}", lambda: cq.solve(fresh, method, **options), patience)


# ------------------------------------------------------------------------------- without friction


def judge_frictionless(judge: Judge, methods: list[tuple[str, dict[str, Any]]]) -> None:
    """Every method's answer, its bounds, and forged answers, against the answer in rational numbers."""
    first = judge.ask("solve plain", lambda: cq.solve(judge.posed.plain))
    judge_units(judge, first)
    gap = judge.posed.plain.gap
    finite = judge.posed.plain.replace(gap=np.where(np.isinf(gap), NEVER, gap))
    truth, known = exact_truth(finite, first[0] or getattr(first[1], "solution", None))
    judge.exact = known in ("exact", "none")
    if truth is None:
        for method, options in methods:
            found = solve(judge, method, **options)[0] if known == "none" else None
            if found is not None and not _says_nothing_pushes(found.certificate):
                judge.found("wrong", f"solve {method}", "an answer where there is none")
        return
    posed = truth.representable <= REPRESENTABLE and truth.condition <= WORST_CONDITION
    threshold = WRONG + PER_CONDITION * truth.condition
    for method, options in methods:
        _judge_answer(judge, truth, method, *solve(judge, method, **options), threshold, posed)
    _forge(judge, truth, threshold, posed)


def judge_units(judge: Judge, first: tuple[Any, Any]) -> None:
    """The same problem in other units of length and force has the same verdict, and the same digits where it is solved.

    Where several answers exist either may be found. The units are powers of four: the root of a stiffness, too, is the
    same but for its exponent. Nearly parallel rows are left out: rounding of their forces depends on the route.
    """
    plain, rng = judge.posed.plain, np.random.default_rng([judge.seed, 4])
    if _has_nearly_parallel_rows(plain):
        return
    length, force = 4.0 ** float(rng.integers(-165, 166)), 4.0 ** float(rng.integers(-165, 166))
    twin = in_units(plain, Units(np.ones(plain.dimension), np.ones(plain.contacts), length, force), True).problem
    other = judge.ask("solve in other units", lambda: cq.solve(twin))
    verdicts = [type(answer if answer is not None else error).__name__ for answer, error in (first, other)]
    if verdicts[0] != verdicts[1]:
        text = f"{verdicts[1]} in units of {length:.0e} and {force:.0e}, where it is {verdicts[0]}: {other[1]}"
        judge.found("units", "solve in other units", text[:300])
    elif first[0] is not None and not first[0].certificate.uniqueness:
        here, there = first[0].displacement, other[0].displacement / length
        stiff = plain.diagonal > 0  # what loads would move, too: a displacement of zero has the rounding of that
        size = max(np.max(abs(here)), np.max(abs(plain.load)[stiff] / plain.diagonal[stiff], initial=0.0))
        size = max(size, np.max(abs(plain.gap), initial=0.0, where=np.isfinite(plain.gap)))  # as a free motion has
        worst = float(np.max(abs(there - here)) / size) if size > 0 else 0.0
        forces = first[0].normal_force, other[0].normal_force / force
        if np.any(forces[0]) and not any("redundant" in reason for reason in first[0].certificate.reasons):
            worst = max(worst, float(np.max(abs(forces[1] - forces[0])) / np.max(abs(forces[0]))))
        if worst > SAME_DIGITS:
            text = f"other digits, by {worst:.2g} of the largest, in units of {length:.0e} and {force:.0e}"
            judge.found("units", "solve in other units", text)


def _has_nearly_parallel_rows(problem: cq.ContactProblem) -> bool:
    """Whether two rows of contacts and ties are apart by more than rounding and less than a tenth of their length."""
    rows = np.vstack([problem.normal.toarray(), problem.tie.toarray()])
    rows = rows[np.any(rows, axis=1)]
    rows = rows / np.max(abs(rows), axis=1)[:, None]
    rows /= np.linalg.norm(rows, axis=1)[:, None]
    along = rows @ rows.T
    apart = [np.linalg.norm(rows[b] - np.sign(along[a, b]) * rows[a]) for a in range(len(rows)) for b in range(a)]
    return any(1e-14 < distance < 0.1 for distance in apart)


def _judge_answer(
    judge: Judge, truth: Truth, method: str, returned: Any, error: Any, threshold: float, posed: bool
) -> None:
    solution = returned if returned is not None else getattr(error, "solution", None)
    if isinstance(error, cq.NoEquilibrium):
        if posed:
            judge.found("denied", f"solve {method}", str(error)[:300])
        return
    if solution is None:
        if method == "active-set" and posed and isinstance(error, cq.ContactQPError):
            judge.found("refused", f"solve {method}", f"{type(error).__name__}: {str(error)[:300]}")
        return
    errors = truth.errors(*judge.plain(solution))
    _judge_bounds(judge, truth, f"solve {method}", method, solution.certificate, errors)
    off = errors.energy if truth.nullity > 0 and _in_other_units(judge) else errors.worst
    silent = solution.certificate.passed and not _says_nothing_pushes(solution.certificate)
    if silent and find(method).exact and off > threshold:
        judge.found("wrong", f"solve {method}", f"passed, and off by {off:.2g}")
    if not solution.certificate.passed and method == "active-set" and posed:
        judge.found("refused", f"solve {method}", "; ".join(solution.certificate.failures)[:300])
    if solution.certificate.passed and _calls_much_nothing(solution.certificate):
        judge.found("unproven", f"solve {method}", "; ".join(solution.certificate.reasons)[:300])


def _in_plain_units(judge: Judge, certificate: Any) -> Any:
    """The certificate with its contact-wise bound in plain numbers."""
    if certificate.force_bound is None:
        return certificate
    return replace(certificate, force_bound=certificate.force_bound * judge.posed.units.row / judge.posed.units.force)


def _judge_bounds(judge: Judge, truth: Truth, what: str, source: str, certificate: Any, errors: Any) -> None:
    """No bound is below the error that it bounds; absolute errors are compared in the units alone of the truth."""
    other = _in_other_units(judge)
    for one in bounded(source, truth, _in_plain_units(judge, certificate), errors):
        number = {"energy_error": 0, "force_error": 1}.get(one.figure)
        if other and number is not None and (truth.tiny[number] or (number == 1 and truth.nullity > 0)):
            continue
        if number == 1 and np.any(judge.posed.plain.diagonal == 0):
            continue  # forces on what has no stiffness have no energy
        judge.judgements += 1
        if one.below:
            judge.found("bound", what, f"{one.figure} {one.bound:.17g} below the error {one.error:.17g}")


def _in_other_units(judge: Judge) -> bool:
    """Whether the problem is in other units than its truth.

    The norm of forces that do not balance on bodies that float is that of the motions of least norm, and differs then.
    """
    units = judge.posed.units
    return not (units.length == units.force == 1.0 and np.all(units.unknown == 1.0) and np.all(units.row == 1.0))


def _forge(judge: Judge, truth: Truth, threshold: float, posed: bool) -> None:
    tie = truth.tie_force
    for name, u, force in spoiled(truth, np.random.default_rng(judge.seed)):
        if np.max(abs(u), initial=0.0) > np.sqrt(NEVER):
            continue  # closes what never closes
        certificate = judge.certify(f"certify {name}", u, force, None, tie)
        if certificate is None:
            continue
        errors = truth.errors(u, force, tie)
        _judge_bounds(judge, truth, f"certify {name}", name, certificate, errors)
        off = errors.energy if truth.nullity > 0 and _in_other_units(judge) else errors.worst
        excused = _strains_nothing(truth, u) or _says_nothing_pushes(certificate)
        if certificate.passed and off > threshold and not excused:
            judge.found("forgery", f"certify {name}", f"passed, and off by {off:.2g}")
        if name == "truth" and not certificate.passed and posed:
            judge.found("refused", "certify truth", "; ".join(certificate.failures)[:300])
    u, force = truth.rounded()
    _judge_parts_alone(judge, u, force)
    if posed:
        _judge_noisy(judge, u, force, tie)
    wrong = [(name, *parts, tie) for name, *parts in against_the_law(judge.posed.plain, u, force)]
    wrong += [(name, u, *parts) for name, *parts in forces_added(judge.posed.plain, u, force, tie)]
    wrong += [(name, u, *parts) for name, *parts in shared_otherwise(judge.posed.plain, u, force, tie)]
    for name, wrong_u, pushed, tied in wrong:
        certificate = judge.certify(f"certify {name}", wrong_u, pushed, None, tied)
        if certificate is not None and certificate.passed:
            judge.found("forgery", f"certify {name}", "passed")


def _judge_noisy(judge: Judge, u: Array, force: Array, tie: Array) -> None:
    """What a plain solve leaves of zero is right: noise of some roundings of what moves most in the same part.

    Left out are answers whose strain such noise would spoil: what moves rigidly a hundred times as far as it strains.
    """
    plain, rng = judge.posed.plain, np.random.default_rng([judge.seed, 5])
    met = np.vstack([plain.normal.toarray()[plain.gap - plain.normal @ u == 0], plain.tie.toarray()])
    if plain.ties and np.linalg.matrix_rank(met) < len(met):
        return  # contacts and ties that may exchange forces: open, benchmarks/README.md
    root = np.sqrt(np.where(plain.diagonal > 0, plain.diagonal, np.inf))
    moved, part = np.where(np.isfinite(root), root, 0.0) * abs(u), connected_parts(plain)
    noise = np.zeros(len(u))
    for one in np.unique(part):
        here = part == one
        most, own = float(np.max(moved[here])), np.where(here, u, 0.0)
        if most > 0 and np.sqrt(max(own @ (plain.stiffness @ own), 0.0)) >= 1e-2 * most:
            noise[here] = 2.0**-51 * most / root[here]
    if not np.any(noise):
        return
    certificate = judge.certify("certify truth with noise", u + noise * rng.normal(size=len(u)), force, None, tie)
    if certificate is not None and not certificate.passed:
        judge.found("refused", "certify truth with noise", "; ".join(certificate.failures)[:300])


def connected_parts(plain: cq.ContactProblem) -> Array:
    """(n,) the number of the part, connected by stiffness, contacts and ties, that each unknown belongs to."""
    rows = [
        sp.csr_array(each) for each in (plain.stiffness, plain.normal, plain.tie, plain.tangent) if each is not None
    ]
    graph = sum((abs(each).T @ abs(each) for each in rows), start=sp.csr_array((plain.dimension, plain.dimension)))
    return np.asarray(sp.csgraph.connected_components(graph, directed=False)[1])


def _judge_parts_alone(judge: Judge, u: Array, force: Array) -> None:
    """Displacements alone and forces alone: what is missing is found, or not; a wrong one does not pass."""
    units, problem = judge.posed.units, judge.posed.problem
    parts = dict(displacement=u * units.unknown * units.length, normal_force=force * units.force / units.row)
    for name, values in parts.items():
        judge.ask(f"certify {name} alone", lambda name=name, values=values: cq.certify(problem, **{name: values}))
    if np.any(problem.stiffness) and np.all(problem.diagonal > 0) and np.any(u):
        at = int(np.argmax(abs(u) * np.sqrt(judge.posed.plain.diagonal)))
        wrong = np.where(np.arange(len(u)) == at, 1 + 1e3 * FORGED, 1.0) * parts["displacement"]
        if np.any(judge.posed.plain.normal.toarray()[:, at]) or problem.ties:
            return  # a contact or a tie may have what is missing
        judged = judge.ask("certify displacement alone, off", lambda: cq.certify(problem, displacement=wrong))[0]
        if judged is not None and judged.passed:
            judge.found("forgery", "certify displacement alone, off", "passed")


def _says_nothing_pushes(certificate: cq.Certificate) -> bool:
    """Whether the verdict claims no bound, as the load on a rigid motion is nothing beside the forces that squeeze."""
    return any("counts as nothing" in reason for reason in certificate.reasons)


def _calls_much_nothing(certificate: cq.Certificate) -> bool:
    """Whether no bound is claimed for a load on a rigid motion that is no small part of the forces that meet there."""
    parts = [re.search(r"drives a rigid motion by (\S+) of the forces that meet", one) for one in certificate.reasons]
    return any(part is not None and float(part[1]) > MUCH for part in parts)


def _strains_nothing(truth: Truth, u: Array) -> bool:
    """Whether the truth is moved rigidly, and an answer to it is right up to the rounding of what it is moved by."""
    right = truth.rounded()[0]
    return truth.tiny[0] and bool(np.max(abs(u - right)) <= MOVED_RIGHTLY * np.max(abs(right)))


def against_the_law(problem: cq.ContactProblem, u: Array, force: Array) -> Iterator[tuple[str, Array, Array]]:
    """Answers that tear, push at a distance, or balance nothing, each by a part of 1e-6: no tolerance forgives that."""
    torn = with_tension(problem, u, force, None)
    if torn is not None:
        yield f"tension of {FORGED:g}", u, torn
    apart = pushed_apart(problem, u, force)
    if apart is not None:
        yield f"tension of {FORGED:g} that others balance", u, apart
    meeting = forces_that_meet(problem, u, force, None)
    part = np.divide(np.diag(problem.stiffness) * abs(u), meeting, out=np.zeros(len(u)), where=meeting > 0)
    energy = np.sqrt(np.diag(problem.stiffness)) * abs(u)
    part[energy < 1e-3 * np.max(energy)] = 0.0  # beside larger ones these may count as nothing
    at = int(np.argmax(part))
    if part[at] > 1e-3:
        moved = u.copy()
        moved[at] *= 1 + 1e3 * FORGED
        yield "one displacement off by 0.001", moved, force


def forces_added(problem: cq.ContactProblem, u: Array, force: Array, tie: Array) -> Iterator[tuple[str, Array, Array]]:
    """Forces with more at one contact that never closes, or at one tie, by 0.001 of the largest of all.

    Forces are compared in the root of energy at their own unknowns, where all of these are stiff. Those of ties are
    unique where the rows of ties and of closed contacts are independent.
    """
    compliance = np.divide(1.0, problem.diagonal, out=np.full(problem.dimension, np.nan), where=problem.diagonal > 0)

    def felt(rows: Any) -> Array:
        dense = rows.toarray()
        return np.asarray(np.sqrt(np.sum(np.where(dense != 0, dense**2 * compliance, 0.0), axis=1)))

    of_contact, of_tie = felt(problem.normal), felt(problem.tie)
    largest = np.nanmax(np.append(of_contact * abs(force), of_tie * abs(tie)), initial=0.0)
    for at in np.flatnonzero(np.isinf(problem.gap) & (of_contact > 0) & (largest > 0))[:1]:
        yield "a force where nothing closes", force + np.eye(len(force))[at] * 1e-3 * largest / of_contact[at], tie
    closed = problem.normal.toarray()[problem.gap - problem.normal @ u <= 1e-9 * (abs(problem.normal) @ abs(u))]
    held = np.vstack([closed, problem.tie.toarray()])
    held /= np.where(np.any(held, axis=1), np.max(abs(held), axis=1, initial=0.0), 1.0)[:, None]
    pushed = np.nanmax(np.sqrt(compliance) * abs(problem.load), initial=0.0)
    acts = largest > 1e-11 * pushed  # a force beneath 1e-12 of the size of the problem counts as nothing
    if acts and np.min(np.linalg.svd(held, compute_uv=False), initial=1.0) > 1e-3 and len(held) <= held.shape[1]:
        for at in np.flatnonzero(of_tie > 0)[-1:]:
            yield "a tie force off by 0.001", force, tie + np.eye(len(tie))[at] * 1e-3 * largest / of_tie[at]


def shared_otherwise(
    problem: cq.ContactProblem, u: Array, force: Array, tie: Array
) -> Iterator[tuple[str, Array, Array]]:
    """Forces that nearly parallel rows of closed contacts and ties share otherwise, by 0.001 of the largest and more.

    What is out of balance is half of the tolerance. Rows are independent up to a condition of 1e9, and so are those of
    contacts that graze, so that forces are unique; these are compared where all unknowns that they act on are stiff, or
    none is.
    """
    pushing = np.flatnonzero(force > 0)
    rows = np.vstack([problem.normal.toarray()[pushing], problem.tie.toarray()])
    stiff, sizes = problem.diagonal > 0, np.linalg.norm(rows, axis=1)
    touched = np.any(rows, axis=0)
    if not 2 <= len(rows) <= rows.shape[1] or not np.all(sizes) or len(set(stiff[touched])) > 1:
        return
    shares, apart, _ = np.linalg.svd(rows / sizes[:, None])
    touching = problem.normal.toarray()[problem.gap - problem.normal @ u == 0]
    met = np.vstack([touching[np.any(touching, axis=1)], problem.tie.toarray()])
    if apart[-1] <= 1e-9 * apart[0] or np.linalg.matrix_rank(met) < len(met):
        return
    unit = sizes
    if np.all(stiff[touched]):
        unit = np.linalg.norm(rows / np.sqrt(np.where(stiff, problem.diagonal, 1.0)), axis=1)
    change = shares[:, -1] / sizes
    meeting = forces_that_meet(problem, u, force, None) + abs(problem.tie.T) @ abs(tie)
    pushed_on = touched & (meeting > 0)
    unbalanced = np.max(abs(rows.T @ change)[pushed_on] / meeting[pushed_on], initial=0.0)
    room = np.divide(force[pushing], abs(change[: len(pushing)]), out=np.full(len(pushing), np.inf),
                     where=change[: len(pushing)] != 0)  # fmt: skip
    if not unbalanced > 0:
        return
    change = change * min(5e-10 / unbalanced, 0.5 * float(np.min(room, initial=np.inf)))
    held = np.concatenate([force[pushing], tie])
    if np.max(abs(change) * unit) > 1e-3 * np.max(abs(held) * unit):
        pushed = force.copy()
        pushed[pushing] += change[: len(pushing)]
        yield "forces shared otherwise", pushed, tie + change[len(pushing) :]


def pushed_apart(problem: cq.ContactProblem, u: Array, force: Array) -> Array | None:
    """The same forces in all at each unknown, one of them a tension of 1e-6 of the largest that meets where it acts.

    Where the rows of contacts depend, some push more for what one pulls: equilibrium, gaps and the norm of the forces
    are those of the answer, and only the sign of the one is wrong.
    """
    rows = problem.normal.toarray()
    for at in np.argsort(force):
        others = np.flatnonzero((np.arange(len(force)) != at) & np.any(rows, axis=1) & (force > SEEN * np.max(force)))
        if not np.any(rows[at]) or not others.size:
            continue
        weights = np.linalg.lstsq(rows[others].T, rows[at], rcond=None)[0]
        if np.max(abs(rows[others].T @ weights - rows[at])) > 1e-14 * np.max(abs(rows[at])):
            continue
        size = np.maximum(forces_that_meet(problem, u, force, None), intrinsic_sizes(problem, u, force))[rows[at] != 0]
        pull = FORGED * float(np.max(size / abs(rows[at][rows[at] != 0])))
        forged = force.copy()
        forged[others] += (pull + force[at]) * weights
        forged[at] = -pull
        if np.min(forged[others]) >= 0:
            return forged
    return None


def forces_that_meet(problem: cq.ContactProblem, u: Array, force: Array, friction: Array | None) -> Array:
    """(n,) the sum of the sizes of the forces that meet at each unknown."""
    meeting = abs(np.asarray(problem.stiffness)) @ abs(u) + abs(problem.load) + abs(problem.normal).T @ abs(force)
    if friction is not None and problem.tangent is not None:
        meeting = meeting + abs(problem.tangent).T @ abs(friction.ravel())
    return np.asarray(meeting)


def outer_forces(problem: cq.ContactProblem, force: Array, friction: Array) -> Array:
    """(n,) what contacts exert on the bodies in all."""
    assert problem.tangent is not None
    return np.asarray(problem.normal.T @ force + problem.tangent.T @ friction.ravel())


def intrinsic_sizes(problem: cq.ContactProblem, u: Array, force: Array) -> Array:
    """(n,) the forces that stand, at each unknown, for the size of problem and answer; beneath them is nothing.

    Gaps that the answer closes give a size, too; where nothing acts it is the smallest gap that does.
    """
    root = np.sqrt(np.where(np.diag(problem.stiffness) > 0, np.diag(problem.stiffness), np.inf))
    outer = abs(problem.load) + abs(problem.normal).T @ abs(force)
    size = max(float(np.max(np.where(np.isfinite(root), root, 0.0) * abs(u))), float(np.max(outer / root)))
    felt = np.linalg.norm(problem.normal.toarray() / root, axis=1)
    limit = np.where(np.isfinite(problem.gap), abs(problem.gap), 0.0)
    closed = abs(problem.gap - problem.normal @ u) <= 1e-9 * (abs(problem.normal) @ abs(u) + limit)
    size = max(size, float(np.max(limit[closed & (felt > 0)] / felt[closed & (felt > 0)], initial=0.0)))
    if not np.any(problem.load) and not np.any(problem.tie_value):
        gives = (problem.gap > 0) & np.isfinite(problem.gap) & (felt > 0)
        size = max(size, float(np.min(problem.gap[gives] / felt[gives]))) if np.any(gives) else size
    return size * np.where(np.isfinite(root), root, _roots_through_rows(problem, root))


def _roots_through_rows(problem: cq.ContactProblem, root: Array) -> Array:
    """(n,) the sizes of forces at unknowns without stiffness, whose scale is that of what rows join them to; else 0."""
    rows = abs(problem.normal.toarray())
    felt = np.max(rows / root, axis=1, initial=0.0)  # nothing where a row touches nothing stiff
    scale = np.max(np.where(rows > 0, felt[:, None] / np.where(rows > 0, rows, 1.0), 0.0), axis=0, initial=0.0)
    return np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0)


def with_tension(problem: cq.ContactProblem, u: Array, force: Array, friction: Array | None) -> Array | None:
    """The forces with a tension at the contact that has the least, by 1e-6 of what meets wherever it acts."""
    acting = np.flatnonzero(np.any(problem.normal.toarray(), axis=1) & np.isfinite(problem.gap))
    if not acting.size:
        return None
    at = int(acting[np.argmin(force[acting])])
    row = abs(problem.normal.toarray()[at])
    meeting = np.maximum(forces_that_meet(problem, u, force, friction), intrinsic_sizes(problem, u, force))
    size = float(np.max(meeting[row > 0] / row[row > 0]))
    if size == 0:
        return None
    torn = force.copy()
    torn[at] = -FORGED * size
    return torn
