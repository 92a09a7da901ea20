"""The bounds of the certificate against the true errors of random candidates, the truth in rational numbers.

Candidates of many kinds: the answers of solvers and the truth rounded to doubles, to single precision and to printed
digits, perturbed at all sizes from 1e-16 to 1, on wrong sets of closed contacts, of penalty springs, scaled, with
turned signs, without forces, and somebody's answer to another problem. Every bound is held against the error that it
is to exceed: none may be below it, and the median of all ratios is to be at most ten.

    python -m benchmarks.bound_random                       # 10 000 candidates
    python -m benchmarks.bound_random --candidates 500
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import count, islice
from pathlib import Path
from typing import Any

import numpy as np

import contactqp as cq
from benchmarks.exact_truth import Truth
from benchmarks.judging import Bounded, attempt, bounded, exact_truth
from benchmarks.problem_families import FAMILIES, family
from benchmarks.processes import reports_of
from contactqp.linalg.rational import floats, rational

SOLVABLE = tuple(name for name, entry in FAMILIES.items() if entry.solvable)
EACH = 50  # candidates of a problem
# True errors beneath this are rounding of the truth to doubles: no bound is asked to be near them.
ROUNDING = 1e-14
WITHIN = 10.0


@dataclass(frozen=True)
class Judged:
    """One candidate: its bounds beside the true errors."""

    family: str
    seed: int
    kind: str
    passed: bool
    bounds: tuple[Bounded, ...]


Candidate = tuple[str, np.ndarray, np.ndarray]


def candidates(truth: Truth, solver: Any, rng: np.random.Generator) -> Iterator[Candidate]:
    """Kind, displacement and contact forces, without end."""
    u, force = truth.rounded()
    yield "truth rounded", u, force
    if solver is not None:
        yield "solver", solver.displacement, solver.normal_force
    with np.errstate(over="ignore"):
        single = u.astype(np.float32).astype(float), force.astype(np.float32).astype(float)
    if all(np.all(np.isfinite(part)) for part in single):
        yield "single precision", *single
    yield "six digits", _printed(u), _printed(force)
    yield "zero", 0 * u, 0 * force
    yield "no forces", u, 0 * force
    while True:
        yield _perturbed(u, force, rng)
        found = _on_other_set(truth, rng)
        yield found if found is not None else _perturbed(u, force, rng)


def _printed(values: np.ndarray) -> np.ndarray:
    return np.array([float(f"{value:.5e}") for value in values])


def _perturbed(u: np.ndarray, force: np.ndarray, rng: np.random.Generator) -> Candidate:
    size = 10.0 ** rng.uniform(-16, 0)
    how = rng.integers(6)
    if how == 0:
        return "noise on u", u * (1 + size * rng.normal(size=len(u))), force
    if how == 1:
        return "noise on l", u, force * (1 + size * rng.normal(size=len(force)))
    if how == 2:
        return (
            "noise on both",
            u * (1 + size * rng.normal(size=len(u))),
            force * (1 + size * rng.normal(size=len(force))),
        )
    if how == 3:
        largest = np.max(abs(force), initial=0.0)
        return "forces on open contacts", u, force + size * largest * abs(rng.normal(size=len(force)))
    if how == 4:
        return "scaled", u * (1 + size * rng.normal()), force * (1 + size * rng.normal())
    turned = force.copy()
    if len(turned):
        turned[rng.integers(len(turned))] *= -1
    return "turned sign", u, turned


def _on_other_set(truth: Truth, rng: np.random.Generator) -> Candidate | None:
    """The exact answer on a random set of closed contacts, by springs or not, rounded."""
    closed = np.array([x > 0 for x in truth.force.entries()], dtype=bool)
    if not len(closed):
        return None
    kind, members, softness = "wrong set", closed.copy(), []
    if rng.random() < 0.5 and np.any(closed):
        kind, stiffer = "penalty", 10.0 ** rng.uniform(0, 12)
        softness = [truth.compliance[int(i), int(i)] / rational(stiffer) for i in np.flatnonzero(closed)]
    else:
        members[rng.integers(len(members), size=int(rng.integers(1, 4)))] ^= True
    found = truth.reduced.on_set([int(i) for i in np.flatnonzero(members)], softness)
    if found is None:
        return None
    return kind, floats(truth.reduced.displaced(*found)), floats(found[0])


def judged(task: tuple[str, int, int]) -> list[Judged]:
    """The first candidates of one problem; none where the truth is not known."""
    name, seed, each = task
    problem = family(name, seed)
    solver, error = attempt(problem, "active-set")
    solver = solver or getattr(error, "solution", None)
    truth, _ = exact_truth(problem, solver)
    if truth is None:
        return []
    reports = []
    rng = np.random.default_rng([seed, len(name)])
    for kind, u, force in islice(candidates(truth, solver, rng), each):
        certificate = cq.certify(problem, u, force, tie_force=truth.tie_force)
        bounds = tuple(bounded(kind, truth, certificate, truth.errors(u, force)))
        reports.append(Judged(name, seed, kind, certificate.passed, bounds))
    return reports


def run(wanted: int, jobs: int, each: int = EACH) -> list[Judged]:
    """At least so many candidates, families in turn."""
    reports: list[Judged] = []
    tasks = ((name, seed, each) for seed in count() for name in SOLVABLE)
    while len(reports) < wanted:
        some = list(islice(tasks, max(1, (wanted - len(reports)) // each)))
        reports += [one for found in reports_of(judged, some, jobs) for one in found]
    return reports[:wanted]


def below(reports: list[Judged]) -> list[tuple[Judged, Bounded]]:
    """Every bound beneath its true error."""
    return [(one, known) for one in reports for known in one.bounds if known.below]


def ratios(reports: list[Judged]) -> dict[str, np.ndarray]:
    """Bound by true error, for each figure; infinite where there is an infinite bound."""
    found: dict[str, list[float]] = {}
    for one in reports:
        for known in one.bounds:
            if known.largest > ROUNDING:
                found.setdefault(known.figure, []).append(known.bound / known.largest)
    return {figure: np.array(values) for figure, values in found.items()}


def text(reports: list[Judged], seconds: float) -> Iterator[str]:
    """The counts and the ratios."""
    problems = len({(one.family, one.seed) for one in reports})
    bounds = sum(len(one.bounds) for one in reports)
    families = len({one.family for one in reports})
    yield f"{len(reports)} candidates for {problems} problems of {families} families, {bounds} bounds, {seconds:.0f} s"
    kinds = Counter(one.kind for one in reports)
    yield ", ".join(f"{number} {kind}" for kind, number in kinds.most_common())
    yield f"passed {sum(one.passed for one in reports)}, without any bound {sum(not one.bounds for one in reports)}"
    yield f"bounds below the true error: {len(below(reports))}"
    yield f"{'bound':14s}{'compared':>10s}{'median':>10s}{'90 %':>10s}{'99 %':>10s}{'max':>10s}"
    for figure, values in ratios(reports).items():
        tail = "".join(f"{np.quantile(values, part, method='lower'):>10.3g}" for part in (0.9, 0.99, 1.0))
        yield f"{figure:14s}{len(values):>10d}{np.median(values):>10.3g}{tail}"


def failures(reports: list[Judged]) -> Iterator[str]:
    """What is not as it must be."""
    for one, known in below(reports):
        yield f"{one.family} {one.seed}, {one.kind}: {known.figure} {known.bound:.3g} below {known.error:.3g}"
    for figure, values in ratios(reports).items():
        if not np.median(values) <= WITHIN:
            yield f"{figure}: {np.median(values):.3g} times the true error in the median"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--candidates", type=int, default=10_000)
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1))
    parser.add_argument("--output", type=Path, default=Path("bound_random.json"))
    chosen = parser.parse_args(arguments)
    started = time.perf_counter()
    reports = run(chosen.candidates, chosen.jobs)
    print("\n".join(text(reports, time.perf_counter() - started)))
    chosen.output.write_text(json.dumps([asdict(one) for one in reports], default=float) + "\n")
    found = list(failures(reports))
    print("\n".join(f"FAILED: {line}" for line in found) or "all met")
    return 1 if found else 0


if __name__ == "__main__":
    raise SystemExit(main())
