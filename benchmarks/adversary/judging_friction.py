"""What is right of a problem with friction: Coulomb's law written out once more, and in the plane all equilibria."""

from __future__ import annotations

from typing import Any

import numpy as np

import contactqp as cq
from benchmarks.adversary.judging import (
    FORGED,
    HARDLY_SEEN,
    SEEN,
    Array,
    Judge,
    forces_that_meet,
    intrinsic_sizes,
    judge_units,
    outer_forces,
    solve,
    with_tension,
)
from benchmarks.friction_law import broken, plain_answer, seen

# Rational enumeration of more contacts takes seconds.
MOST_EXACT = 3
# An answer that breaks the law by this part of the largest force or length is wrong.
BREAKS = 1e-9
SAME = 1e-7
# Eigenvalues of a stiffness with a diagonal of ones that are rounding: what floats.
FLOATS = 1e-13


def judge_friction(judge: Judge, algorithms: list[str]) -> None:
    """Every algorithm's answer against the law, and in the plane against all equilibria."""
    posed = judge.posed
    flat = posed.plain.slip_origin is not None and posed.plain.slip_origin.shape[1] == 1
    known, exists = _equilibria(judge) if flat else (None, posed.solvable)
    judge.exact = known is not None or posed.solvable
    judge_units(judge, judge.ask("solve plain", lambda: cq.solve(posed.plain)))
    for name in algorithms:
        returned, error = _solve_friction(judge, name, flat)
        if returned is None:
            if isinstance(error, cq.NoEquilibrium) and exists:
                judge.found("denied", f"solve {name}", str(error)[:300])
            continue
        if returned.certificate.passed:
            _judge_law(judge, name, returned, known)
            _forge_friction(judge, returned)


def _solve_friction(judge: Judge, name: str, flat: bool) -> tuple[Any, Exception | None]:
    if name == "default":
        return solve(judge, "active-set")
    if name in ("lagrange-multiplier", "master-slave", "augmented-lagrangian"):
        return solve(judge, name)
    method = "clarabel" if name in ("tresca", "aclm") and not flat else "active-set"
    return solve(judge, method, algorithm=name)


def _equilibria(judge: Judge) -> tuple[list[Array] | None, bool]:
    """All equilibria as far as rows see them, None where there is a continuum or too many contacts; whether any is."""
    plain = judge.posed.plain
    if plain.contacts > MOST_EXACT or np.any(np.isinf(plain.gap)) or not plain.frictional:
        return None, judge.posed.solvable
    exact, error = judge.ask("exact_equilibria", lambda: cq.exact_equilibria(plain))
    if exact is None:
        return None, judge.posed.solvable and not isinstance(error, cq.NoEquilibrium)
    if any(one.continuum for one in exact):
        return None, True
    project = seen(plain)
    return [project @ one.displacement.astype(float) for one in exact], bool(exact)


def _same_answer(problem: cq.ContactProblem, u: Array, other: Array) -> bool:
    """Whether two displacements are one: in size, or in energy where forces that balance to 1e-9 say no more."""
    apart = u - other
    allowed = max(SAME * float(np.max(abs(u), initial=0.0)), 1e-3 * SAME)
    if float(np.max(abs(apart), initial=0.0)) <= allowed:
        return True
    K = np.asarray(problem.stiffness)
    scale = 1.0 / np.sqrt(np.where(np.diag(K) > 0, np.diag(K), 1.0))
    values = np.linalg.eigvalsh(K * np.outer(scale, scale))
    softest = float(np.min(values[values > FLOATS], initial=np.inf))
    hidden = BREAKS * float(np.max(values, initial=0.0)) > SAME * softest
    return hidden and float(apart @ K @ apart) <= SAME**2 * float(other @ K @ other)


def _judge_law(judge: Judge, name: str, solution: Any, known: list[Array] | None) -> None:
    if not judge.posed.problem.frictional:
        return
    if (worst := broken(judge.posed, solution)) > BREAKS:
        judge.found("wrong", f"solve {name}", f"passed, and breaks the law by {worst:.2g}")
        return
    if known is None:
        return
    u = seen(judge.posed.plain) @ plain_answer(judge.posed, solution)[0]
    if not any(_same_answer(judge.posed.plain, u, other) for other in known):
        judge.found("wrong", f"solve {name}", f"passed, and not among all {len(known)} equilibria")


def _rougher(judge: Judge, sizes: Array) -> list[tuple[Any, ...]]:
    """The answer to the problem with a hundredth more friction, which balances, where a contact that presses slips.

    `sizes` (m, n) are what a unit of each contact's force is of the forces that meet.
    """
    plain = judge.posed.plain
    mu = np.asarray(plain.friction)
    other = judge.ask("solve rougher", lambda: cq.solve(plain.replace(friction=1.01 * mu)))[0]
    if other is None or plain.ties:
        return []
    size = np.linalg.norm(other.friction_force, axis=1)
    pushing = np.max(sizes * other.normal_force[:, None], axis=1, initial=0.0)
    beyond = (size > 1.005 * mu * other.normal_force) & (mu > 0) & (pushing >= SEEN)
    answer = other.displacement, other.normal_force, other.friction_force
    return [("the answer for more friction", *answer)] if np.any(beyond) else []


def _forge_friction(judge: Judge, solution: Any) -> None:
    """Answers that break the law by a known part: none passes."""
    if not judge.posed.problem.frictional:
        return
    u, normal, friction, tie = plain_answer(judge.posed, solution)
    rows = abs(judge.posed.plain.normal.toarray())
    meeting = forces_that_meet(judge.posed.plain, u, normal, friction) + abs(judge.posed.plain.tie).T @ abs(tie)
    floor = np.maximum(intrinsic_sizes(judge.posed.plain, u, normal), meeting)
    # Without stiffness what meets may be the rounding of the loads.
    floor = np.maximum(floor, BREAKS * np.max(abs(judge.posed.plain.load), initial=0.0))
    sizes = np.where(floor > 0, rows / np.where(floor > 0, floor, 1.0), 0.0)
    pushing = np.max(sizes * normal[:, None], axis=1)
    at = int(np.argmax(pushing))
    if pushing[at] < SEEN:
        return
    mu = float(judge.posed.plain.friction[at])  # type: ignore[index]
    forged = []
    net = outer_forces(judge.posed.plain, normal, friction)
    if np.any(abs(net) > SEEN * floor):
        forged.append(("forces x 1.001", u, 1.001 * normal, 1.001 * friction))
    torn = with_tension(judge.posed.plain, u, normal, friction)
    if torn is not None:
        forged.append((f"tension of {FORGED:g}", u, torn, friction))
    width, excess = friction.shape[1], 1e3 * FORGED * mu * normal[at]
    rubs = abs(judge.posed.plain.tangent.toarray()[width * at]) * excess  # type: ignore[union-attr]
    if np.any(rubs > HARDLY_SEEN * floor):
        rubbing = friction.copy()
        rubbing[at] = (1 + 1e3 * FORGED) * mu * normal[at] * np.eye(friction.shape[1])[0]
        forged.append(("friction beyond its bound", u, normal, rubbing))
    smooth = np.flatnonzero((np.asarray(judge.posed.plain.friction) == 0) & np.any(rows, axis=1))
    for one in smooth[:1]:
        rubbing = friction.copy()
        rubbing[one] = 1e3 * FORGED * float(np.max(normal)) * np.eye(width)[0]
        acting = abs(judge.posed.plain.tangent.toarray()[width * one]) * rubbing[one, 0]  # type: ignore[union-attr]
        if np.any(acting > HARDLY_SEEN * floor):
            forged.append(("friction where there is none", u, normal, rubbing))
    forged += _rougher(judge, sizes)
    for name, *parts in forged:
        certificate = judge.certify(f"certify {name}", *parts, tie)
        if certificate is not None and certificate.passed:
            judge.found("forgery", f"certify {name}", "passed")
