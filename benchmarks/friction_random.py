"""Count wrong and missing answers to random frictional problems: none is wrong, and what refuses is counted.

    python -m benchmarks.friction_random --problems 2200

Seeded problems in the plane and in space (`friction_families`), every algorithm and the classical methods. Every answer
is held against the law (`friction_law`, apart from the certificate), in the plane also against all equilibria in
rational numbers. Exit code 1 if an answer breaks the law, is not among all equilibria, is called the only one where
there are several, or if an equilibrium is denied, or missed by enumeration in floating point. So are the bounds of the
default's answer and of answers that are off by 1e-14 to 1e-7: none may be below the distance in rational numbers,
"global" is claimed where there is one equilibrium, and where "local" is one is within the radius.
"""

from __future__ import annotations

import argparse
import os
import time
from collections import Counter
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np

import contactqp as cq
from benchmarks.friction_families import CONTACT_FAMILIES, FAMILIES, Posed, contact_problem, local_problem
from benchmarks.friction_law import broken, broken_locally, driven, plain_answer, seen, size_of_offsets
from benchmarks.processes import reports_of
from contactqp.linalg.factorization import images

ALGORITHMS = ("default", "tresca", "aclm", "newton", "nsgs", "admm")
CLASSICAL = ("lagrange-multiplier", "augmented-lagrangian", "master-slave")
BREAKS = 1e-9
# Displacements that differ by this part of the largest are one; conditions of random problems reach 1e6.
SAME = 1e-7
# Rational enumeration of four contacts takes seconds.
MOST_EXACT = 3
# Forces of rigid motions, of those that meet there, that are rounding of doubles.
ROUNDED = 1e-14
# What candidates are off by, and what their bounds may be, where they are to pass.
OFF = (0.0, 1e-14, 1e-12, 1e-9, 1e-7)
# Answers that are as far off as other codes' by default, and far beyond, and answers in other states: they are held
# against the truth as well, at tolerances at which nearly all pass, and count in no share of what is proven.
FAR_OFF = (1e-4, 1e-2, 1.0)
LOOSE = dict(tolerance=1e-4, error_tolerance=1e-3)
WIDE = dict(tolerance=0.9, error_tolerance=1e3)
# Where the law contracts by less than this nearly all candidates are to have bounds.
CONTRACTED = 0.9
# What certificates say of candidates whose states have no answer of their own, or several.
NOT_REGULAR = "no answer of its own states is near whose forces are unique"


@dataclass
class Report:
    """What one problem showed."""

    family: str
    seed: int
    outcomes: dict[str, str] = field(default_factory=dict)  # solved, refused, denied, unsupported
    wrong: list[str] = field(default_factory=list)
    states: int | None = None  # in the plane: how many equilibria there are
    continuum: bool = False
    exists: bool = False
    seconds: dict[str, float] = field(default_factory=dict)
    bounds: Counter[str] = field(default_factory=Counter)  # candidates by the scope of what is proven of them
    far: Counter[str] = field(default_factory=Counter)  # those far off or in other states, likewise
    contracted: Counter[str] = field(default_factory=Counter)  # those where kappa of `critical_friction` is below 0.9
    ratios: list[float] = field(default_factory=list)  # of a bound and the distance that it is of


def _attempt(report: Report, name: str, problem: Any) -> Any:
    arguments: dict[str, Any] = {}
    if name in CLASSICAL:
        arguments["method"] = name
    elif name != "default":
        space = problem.dimension == 3 if isinstance(problem, cq.LocalProblem) else problem.slip_origin.shape[1] == 2
        arguments["algorithm"] = name
        if name in ("tresca", "aclm") and space:
            arguments["method"] = "clarabel"
    started = time.perf_counter()
    try:
        solution = cq.solve(problem, **arguments)
        report.outcomes[name] = "solved"
        return solution
    except (cq.NoEquilibrium, cq.SeveralEquilibria) as error:
        report.outcomes[name] = "denied" if isinstance(error, cq.NoEquilibrium) else "refused"
    except (cq.NotConverged, cq.NotCertified, cq.BackendFailed):
        report.outcomes[name] = "refused"
    except cq.Unsupported:
        report.outcomes[name] = "unsupported"
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:  # LinAlgError and InvalidProblem are such
        report.outcomes[name] = "crashed"
        report.wrong.append(f"{name}: crashed: {type(error).__name__}: {error}")
    finally:
        report.seconds[name] = time.perf_counter() - started
    return None


def judge(family: str, seed: int, algorithms: tuple[str, ...] = (*ALGORITHMS, *CLASSICAL)) -> Report:
    """One problem by some algorithms; those that are classical take no local problems."""
    report = Report(family, seed)
    if family in CONTACT_FAMILIES:
        _judge_contact(report, contact_problem(family, seed), algorithms)
    else:
        chosen = tuple(name for name in algorithms if name in ALGORITHMS)
        _judge_local(report, *local_problem(family, seed), chosen)
    for name, outcome in report.outcomes.items():
        if outcome == "denied" and report.exists:
            report.wrong.append(f"{name}: denies an equilibrium that exists")
    return report


def _judge_contact(report: Report, posed: Posed, algorithms: tuple[str, ...]) -> None:
    report.exists = posed.solvable
    problem, flat = posed.problem, posed.plain.slip_origin.shape[1] == 1  # type: ignore[union-attr]
    known: list[np.ndarray] = []
    project, exact = seen(posed.plain), None
    if flat:
        rational = problem.contacts <= MOST_EXACT and not posed.plain.rigid_change
        exact = cq.exact_equilibria(posed.plain) if rational else None
        known = _listed(report, posed, exact, project)
    for name in algorithms:
        solution = _attempt(report, name, problem)
        if solution is None:
            continue
        if (worst := broken(posed, solution)) > BREAKS or not cq.certify(
            problem, solution.displacement, solution.normal_force, solution.friction_force, solution.tie_force
        ).passed:
            report.wrong.append(f"{name}: breaks the law by {worst:.2g}")
            continue
        report.exists = True
        if name == "default" and flat and exact and not report.continuum:
            _judge_bounds(report, posed, exact)
        if flat and not report.continuum and not _among(project @ plain_answer(posed, solution)[0], known):
            report.wrong.append(f"{name}: not among all {len(known)} equilibria")
        if len(known) > 1 and not _says_several(solution.certificate.uniqueness):
            report.wrong.append(f"{name}: called the only one of {len(known)}")


def _judge_bounds(report: Report, posed: Posed, exact: Any) -> None:
    """Bounds of answers in plain numbers, beside the distances in rational ones."""
    plain, rng = posed.plain, np.random.default_rng([report.seed, 7])
    try:
        answer = cq.solve(plain)
    except cq.ContactQPError:
        return
    contracts = _kappa(plain) < CONTRACTED
    K = np.vectorize(Fraction, otypes=[object])(np.asarray(plain.stiffness_rows.toarray()))
    near = K + np.diag(np.diag(K)) if _held_by_contacts(plain) else K  # the norm that a radius is stated in
    truths = [
        (_rational(one.displacement), np.column_stack([_rational(one.normal_force), _rational(one.friction_force)]))
        for one in exact
    ]
    given = (answer.displacement, answer.normal_force, answer.friction_force, answer.tie_force)
    for part in (*OFF, *FAR_OFF):
        parts = tuple(x * (1 + part * rng.normal(size=np.shape(x))) for x in given)
        far = part in FAR_OFF
        found = cq.certify(plain, *parts, **(WIDE if far else LOOSE))
        off = _judge_bound(report, f"off by {part:g}", parts, found, K, near, truths)
        if far:
            report.far[found.scope or "none"] += 1
            continue
        report.bounds[found.scope or "none"] += 1
        report.bounds["irregular"] += any(NOT_REGULAR in reason for reason in found.reasons)
        if contracts:
            report.contracted[found.scope or "none"] += 1
        if part > 1e-13 and off is not None:
            report.ratios.append(off)
    u, normal, friction, tie = given
    chosen = np.zeros(len(normal))
    chosen[int(np.argmax(abs(normal)))] = 1.0
    for name, parts in (
        ("one contact open", (u, normal * (1 - chosen), friction * (1 - chosen)[:, None], tie)),
        ("one slip reversed", (u, normal, friction * (1 - 2 * chosen)[:, None], tie)),
        ("all sticks", (u, normal, 0.5 * friction, tie)),
    ):
        found = cq.certify(plain, *parts, **WIDE)
        report.far[found.scope or "none"] += 1
        _judge_bound(report, name, parts, found, K, near, truths)


def _judge_bound(
    report: Report, name: str, parts: Any, found: Any, K: np.ndarray, near: np.ndarray, truths: list[Any]
) -> float | None:
    """Hold the bounds of an answer against the truths; return bound over distance, None where there is either not."""
    if not found.proven:
        return None
    u, normal, friction, _ = parts
    force = np.column_stack([normal, np.ravel(friction)])
    apart = [(_energy(K, _rational(u) - v), _energy(K, v), forces) for v, forces in truths]
    distance, size, forces = min(apart, key=lambda one: one[0])
    error = found.energy_error * (size or 1.0)
    own = [float(sum(row**2)) ** 0.5 for row in _rational(force) - forces]
    if error < distance * (1 - 1e-6) or np.any(found.force_bound < np.array(own) * (1 - 1e-6)):
        report.wrong.append(f"bounds: {name}, {error:.3g} below {distance:.3g}, or that of a force")
    if found.scope == "global" and len(truths) != 1:
        report.wrong.append(f"bounds: global beside {len(truths)} equilibria")
    away = [_energy(near, _rational(u) - v) for v, _ in truths]
    if found.scope == "local" and sum(one < found.radius for one in away) != 1:
        report.wrong.append(f"bounds: not one equilibrium within {found.radius:.3g}")
    return error / distance if distance > 0 else None


def _kappa(problem: cq.ContactProblem) -> float:
    """The constant by which the law contracts, infinite where it has none."""
    try:
        return cq.critical_friction(problem).kappa
    except cq.ContactQPError:
        return float("inf")


def _held_by_contacts(problem: cq.ContactProblem) -> bool:
    """Whether stiffness and ties alone leave a body free to move."""
    scale = np.diag(1 / np.sqrt(np.where(problem.diagonal > 0, problem.diagonal, 1.0)))
    tie = problem.tie.toarray() @ scale
    tie = tie / np.maximum(np.linalg.norm(tie, axis=1, keepdims=True), np.finfo(float).tiny)
    held = scale @ problem.stiffness_rows.toarray() @ scale + tie.T @ tie
    return bool(np.linalg.eigvalsh(held)[0] <= 1e-9) if len(held) else False


def _rational(values: Any) -> np.ndarray:
    flat = [Fraction(x if isinstance(x, Fraction) else float(x)) for x in np.ravel(values)]
    return np.array(flat, dtype=object).reshape(np.shape(values))


def _energy(K: np.ndarray, v: np.ndarray) -> float:
    return float(v @ (K @ v)) ** 0.5


def _singular_to_rounding(problem: cq.ContactProblem) -> bool:
    """Whether stated motions meet forces that are nothing but rounding, and not zero."""
    if problem.near_null_space is None:
        return False
    forces = abs(images(problem.stiffness, problem.near_null_space))
    size = abs(problem.stiffness) @ abs(problem.near_null_space)
    met = np.max(forces, axis=0) / np.max(size, axis=0)
    return bool(np.any((met > 0) & (met <= ROUNDED)))


def _listed(report: Report, posed: Posed, exact: Any, project: np.ndarray) -> list[np.ndarray]:
    """All equilibria, and what enumeration in floating point makes of them."""
    try:
        found = cq.equilibria(posed.problem)
    except cq.ContactQPError as error:
        report.wrong.append(f"enumeration: {type(error).__name__}: {error}")
        return []
    for solution in found:
        if (worst := broken(posed, solution)) > BREAKS:
            report.wrong.append(f"enumeration: breaks the law by {worst:.2g}")
    # Turns that printed digits or their rounding resist, by 1e-16 of K, have equilibria of their own far away.
    if posed.plain.rigid_change or _singular_to_rounding(posed.plain):
        report.continuum, report.exists = True, True
        return []
    floats = [project @ plain_answer(posed, solution)[0] for solution in found]
    if exact is None:
        report.states, report.exists = len(floats), report.exists or bool(floats)
        return floats
    report.states, report.exists = len(exact), bool(exact)
    report.continuum = any(one.continuum for one in exact)
    known = [project @ one.displacement.astype(float) for one in exact]
    for one, u in zip(exact, known, strict=True):
        if not one.continuum and not _among(u, floats):
            report.wrong.append(f"enumeration: misses one of {len(known)} equilibria")
    for u in floats:
        if not report.continuum and not _among(u, known):
            report.wrong.append(f"enumeration: finds what is none of {len(known)} equilibria")
    return known


def _judge_local(report: Report, problem: cq.LocalProblem, solvable: bool, algorithms: tuple[str, ...]) -> None:
    report.exists = solvable
    known: list[np.ndarray] = []
    flat = problem.dimension == 2
    if flat:
        found = cq.equilibria(problem)
        known = [driven(problem, solution) for solution in found]
        report.states = len(known)
        for solution in found:
            if (worst := broken_locally(problem, solution)) > BREAKS:
                report.wrong.append(f"enumeration: breaks the law by {worst:.2g}")
        if solvable and not found:
            report.wrong.append("enumeration: misses the answer that the problem was made from")
        report.exists = solvable or bool(found)
    deficient = "rank-deficient" in report.family
    for name in algorithms:
        solution = _attempt(report, name, problem)
        if solution is None:
            continue
        if (worst := broken_locally(problem, solution)) > BREAKS or not solution.certificate.passed:
            report.wrong.append(f"{name}: breaks the law by {worst:.2g}")
            continue
        report.exists = True
        # A singular operator may leave a continuum of velocities.
        nearest = float(np.min(size_of_offsets(problem), initial=1.0))
        if flat and not deficient and not _among(driven(problem, solution), known, SAME * nearest):
            report.wrong.append(f"{name}: not among all {len(known)} equilibria")


def _among(u: np.ndarray, known: list[np.ndarray], least: float = 1e-3 * SAME) -> bool:
    allowed = max(SAME * float(np.max(abs(u), initial=0.0)), least)
    return any(float(np.max(abs(u - other), initial=0.0)) <= allowed for other in known)


def _says_several(findings: tuple[str, ...]) -> bool:
    return any(finding.startswith("several answers") for finding in findings)


def table(reports: list[Report]) -> list[str]:
    """Counts for each algorithm, in the plane and in space."""
    lines = []
    for kind, chosen in (
        ("contact problems in the plane", [r for r in reports if r.family in CONTACT_FAMILIES and "2D" in r.family]),
        ("contact problems in space", [r for r in reports if r.family in CONTACT_FAMILIES and "3D" in r.family]),
        ("local problems in the plane", [r for r in reports if r.family not in CONTACT_FAMILIES and "2D" in r.family]),
        ("local problems in space", [r for r in reports if r.family not in CONTACT_FAMILIES and "3D" in r.family]),
    ):
        if not chosen:
            continue
        exists = sum(r.exists for r in chosen)
        several = sum((r.states or 0) > 1 for r in chosen)
        head = f"{len(chosen)} {kind}; {exists} have an equilibrium that is known"
        if chosen[0].states is not None:
            head += f", {several} several, {sum(r.continuum for r in chosen)} a continuum"
        lines += ["", head, f"{'':22}{'solved':>16}{'refused, exists':>17}{'refused rightly':>17}{'seconds':>9}"]
        for name in (*ALGORITHMS, *CLASSICAL):
            counts = Counter((r.outcomes[name], r.exists) for r in chosen if name in r.outcomes)
            total = sum(counts.values()) - counts["unsupported", True] - counts["unsupported", False]
            if not total:
                continue
            solved = counts["solved", True]
            missed = sum(counts[what, True] for what in ("refused", "denied", "crashed"))
            rightly = counts["refused", False] + counts["denied", False]
            spent = sum(r.seconds.get(name, 0.0) for r in chosen)
            lines.append(
                f"{name:22}{f'{solved} = {solved / max(exists, 1):.2%}':>16}{missed:17}{rightly:17}{spent:9.1f}"
            )
    return lines


def bounds_table(reports: list[Report]) -> list[str]:
    """Of how many candidates bounds are proven, and how near they are to what they bound."""
    counts = sum((r.bounds for r in reports), Counter())
    ratios = np.array([x for r in reports for x in r.ratios])
    if not counts:
        return []
    irregular, contracted = counts.pop("irregular", 0), sum((r.contracted for r in reports), Counter())
    parts = ", ".join(f"{name} {counts[name]}" for name in ("global", "local", "none"))
    line = f"bounds of {counts.total()} candidates in the plane: {parts}, of which in no regular state {irregular}"
    had = contracted.total() - contracted["none"]
    line += f"; where kappa < {CONTRACTED}: {had} of {contracted.total()}"
    if ratios.size:
        line += f"; over the distance: median {np.median(ratios):.3g}, 90 % {np.quantile(ratios, 0.9):.3g}"
    far = sum((r.far for r in reports), Counter())
    beside = ", ".join(f"{name} {far[name]}" for name in ("global", "local", "none"))
    return [
        "",
        line,
        f"of {far.total()} that are off by {FAR_OFF[0]:g} to {FAR_OFF[-1]:g} or in other states: {beside}",
    ]


def _task(task: tuple[str, int, tuple[str, ...]]) -> Report:
    return judge(*task)


def run(
    problems: int,
    families: tuple[str, ...] = FAMILIES,
    jobs: int = 2,
    algorithms: tuple[str, ...] = (*ALGORITHMS, *CLASSICAL),
) -> list[Report]:
    """`problems` problems spread evenly over the families, in a fixed order."""
    seeds = range(-(-problems // len(families)))
    tasks = [(family, seed, algorithms) for seed in seeds for family in families]
    return reports_of(_task, tasks, jobs)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=2200, help="in all, spread evenly over the families")
    parser.add_argument("--family", action="append", choices=FAMILIES, help="only this one; may be repeated")
    parser.add_argument(
        "--algorithms", nargs="+", choices=(*ALGORITHMS, *CLASSICAL), help="only these; the default first"
    )
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1))
    parser.add_argument("--missed", action="store_true", help="list where the default refuses though one exists")
    chosen = parser.parse_args(arguments)
    started = time.perf_counter()
    algorithms = tuple(chosen.algorithms or (*ALGORITHMS, *CLASSICAL))
    reports = run(chosen.problems, tuple(chosen.family or FAMILIES), chosen.jobs, algorithms)
    print(f"{len(reports)} problems, {time.perf_counter() - started:.0f} s")
    print("\n".join([*table(reports), *bounds_table(reports)]))
    missed = [r for r in reports if r.exists and r.outcomes.get("default") in ("refused", "denied")]
    if chosen.missed:
        print("\n".join(f"missed by default: {r.family!r} {r.seed}" for r in missed))
    wrong = [f"{r.family!r} {r.seed}: {line}" for r in reports for line in r.wrong]
    print("\n" + ("\n".join(f"WRONG: {line}" for line in wrong) or "nothing wrong"))
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
