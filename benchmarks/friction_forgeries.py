"""Count forged answers with friction that pass: none, on slender beams whose residual hides wrong contact forces.

    python -m benchmarks.friction_forgeries --problems 1000

A cantilever of many elements lies on rough stops, in the plane or in space. Its contact forces are made wrong by 1e-4
to one half, friction with them, and the displacement is bent so that every gap and every slip stays what it was and the
residual is spread where it is smallest beside the forces that meet: many of these answers break no figure ("hidden").
The right answers must pass. Exit code 1 if a forgery passes or a right answer is refused.
"""

from __future__ import annotations

import argparse
import os
import time
from collections import Counter
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

import contactqp as cq
from benchmarks.processes import reports_of
from contactqp.model.solution import FIGURES

Array = NDArray[np.float64]

FAMILIES = ("tip 2D", "stops 2D", "all along 2D", "tip 3D", "stops 3D")
# Elements from which a beam has a condition of about 1e9, and up to which it has 1e14.
FEWEST, MOST = 60, 1400


@dataclass
class Report:
    """What one forgery showed."""

    family: str
    seed: int
    part: float
    hidden: bool = False  # no figure of the forgery is above the tolerance
    passed: bool = False
    right_refused: str = ""
    basis: str = ""


def beam(elements: int, planes: int, slenderness: float) -> sp.csc_matrix:
    """A clamped beam of length one: axial unknown, then deflection and rotation in each plane, node by node."""
    h = 1.0 / elements
    bending = np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h]]) / h**3
    bending = np.vstack([bending, -bending[0], [6 / h**2, 2 / h, -6 / h**2, 4 / h]])
    width = 1 + 2 * planes
    local = np.zeros((2 * width, 2 * width))
    ends = np.array([0, width])
    local[np.ix_(ends, ends)] = slenderness**2 / h * np.array([[1, -1], [-1, 1]])
    for plane in range(planes):
        at = 1 + 2 * plane
        places = np.array([at, at + 1, width + at, width + at + 1])
        local[np.ix_(places, places)] = bending
    row, column = np.meshgrid(np.arange(2 * width), np.arange(2 * width), indexing="ij")
    starts = width * np.arange(elements)
    rows = (starts[:, None] + row.ravel()).ravel()
    columns = (starts[:, None] + column.ravel()).ravel()
    size = width * (elements + 1)
    whole = sp.csc_matrix((np.tile(local.ravel(), elements), (rows, columns)), shape=(size, size))
    return whole[width:, width:]


def rough_stops(family: str, seed: int) -> cq.ContactProblem:
    """A beam that its load presses onto rough stops, and that its axial load drags along them."""
    rng = np.random.default_rng([seed, FAMILIES.index(family)])
    elements = int(np.exp(rng.uniform(np.log(FEWEST), np.log(MOST))))
    planes = 2 if family.endswith("3D") else 1
    width, n = 1 + 2 * planes, (1 + 2 * planes) * elements
    K = beam(elements, planes, 10 ** rng.uniform(1.5, 3.0)) * 10 ** rng.uniform(-6, 6)
    stiffness = K[-2 * planes, -2 * planes] / elements**3
    nodes = {
        "tip": np.array([elements]),
        "stops": np.unique(rng.integers(elements // 5, elements + 1, 3)),
        "all": np.arange(elements // 10, elements + 1, max(elements // 20, 1)),
    }[family.split()[0]]
    first = width * (nodes - 1)
    count, at = len(nodes), np.arange(len(nodes))
    normal = sp.csr_matrix((np.ones(count), (at, first + 1)), shape=(count, n))
    tangents = np.column_stack([first, first + 3])[:, :planes].ravel()
    tangent = sp.csr_matrix((np.ones(len(tangents)), (np.arange(len(tangents)), tangents)), shape=(len(tangents), n))
    far = 10 ** rng.uniform(-3, 1)
    gap = far * (nodes / elements) ** 2
    load = np.zeros(n)
    load[1::width] = stiffness * far * 10 ** rng.uniform(0.3, 1.5) / elements
    # From what sticks everywhere to what slips everywhere, in both tangential directions.
    load[width * elements - width] = load[1::width].sum() * 10 ** rng.uniform(-2, 2) * rng.choice([-1, 1])
    if planes == 2:
        load[3::width] = load[1] * 10 ** rng.uniform(-2, 0.5)
    return cq.ContactProblem(
        stiffness=K, load=load, normal=normal, gap=gap, tangent=tangent, friction=float(rng.uniform(0.1, 0.6))
    )


def forged(problem: cq.ContactProblem, solution: cq.Solution, part: float) -> tuple[Array, Array, Array]:
    """Displacement, normal and friction forces, the forces wrong by `part`, gaps and sticking slips as they were.

    The displacement is u + w with R w = 0 on what is held and the least sum of (residual_j / F_j)^2: the residual is
    F^2 K^-1 R'c.
    """
    assert problem.tangent is not None
    force, friction = solution.normal_force * (1 + part), solution.friction_force * (1 + part)
    closed = solution.contact_status != "open"
    sticks = np.repeat(solution.contact_status == "stick", solution.friction_force.shape[1])
    R = sp.vstack([problem.normal[closed], problem.tangent[sticks]]).tocsr()
    K = sp.csc_matrix(problem.stiffness)
    factor = splu(K)
    outer = problem.normal.T @ (force - solution.normal_force)
    outer = outer + problem.tangent.T @ (friction - solution.friction_force).ravel()
    u = solution.displacement
    F = abs(K) @ abs(u) + abs(problem.load) + abs(outer) / part
    X = factor.solve(R.T.toarray())
    spread = factor.solve(F[:, None] ** 2 * X)
    w = -factor.solve(outer)
    w = w - spread @ np.linalg.lstsq(R @ spread, R @ w, rcond=None)[0]
    w = w - X @ np.linalg.solve(R @ X, R @ w)
    return u + w, force, friction


def judge(family: str, seed: int) -> Report:
    """One problem, its right answer and one forgery."""
    problem = rough_stops(family, seed)
    part = float(10 ** np.random.default_rng([seed, 7]).uniform(-4, np.log10(0.5)))
    report = Report(family, seed, part)
    try:
        solution = cq.solve(problem)
    except cq.ContactQPError as error:
        report.right_refused = f"{type(error).__name__}: {error}"
        return report
    if not np.any(solution.normal_force):
        return report
    certificate = cq.certify(problem, *forged(problem, solution, part))
    report.hidden = max(float(getattr(certificate, name)) for name in FIGURES) <= certificate.tolerance
    report.passed, report.basis = certificate.passed, certificate.basis
    return report


def _task(task: tuple[str, int]) -> Report:
    return judge(*task)


def run(problems: int, families: tuple[str, ...] = FAMILIES, jobs: int = 2) -> list[Report]:
    """`problems` problems spread evenly over the families, in a fixed order."""
    tasks = [(family, seed) for seed in range(-(-problems // len(families))) for family in families]
    return reports_of(_task, tasks, jobs)


def table(reports: list[Report]) -> list[str]:
    """Counts for each family."""
    lines = [f"{'':16}{'forged':>8}{'hidden':>8}{'passed':>8}{'right refused':>15}  basis"]
    for family in dict.fromkeys(report.family for report in reports):
        chosen = [report for report in reports if report.family == family]
        made = [report for report in chosen if report.basis]
        basis = ", ".join(f"{name} {count}" for name, count in Counter(r.basis for r in made).items())
        counts = len(made), sum(r.hidden for r in made), sum(r.passed for r in made)
        refused = sum(bool(r.right_refused) for r in chosen)
        lines.append(f"{family:16}{counts[0]:8}{counts[1]:8}{counts[2]:8}{refused:15}  {basis}")
    return lines


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=1000, help="in all, spread evenly over the families")
    parser.add_argument("--family", action="append", choices=FAMILIES, help="only this one; may be repeated")
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1))
    chosen = parser.parse_args(arguments)
    started = time.perf_counter()
    reports = run(chosen.problems, tuple(chosen.family or FAMILIES), chosen.jobs)
    print(f"{len(reports)} problems, {time.perf_counter() - started:.0f} s")
    print("\n".join(table(reports)))
    wrong = [f"{r.family!r} {r.seed}: {r.part:.2g} off and passed" for r in reports if r.passed]
    wrong += [f"{r.family!r} {r.seed}: {r.right_refused}" for r in reports if r.right_refused]
    print("\n" + ("\n".join(f"WRONG: {line}" for line in wrong) or "nothing wrong"))
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
