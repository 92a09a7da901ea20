"""Contacts that graze by less than doubles hold, and overlaps of bodies with next to no stiffness."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq


def chains(seed: int) -> cq.ContactProblem:
    """Two chains that meet at their ends to a rounding, and perhaps a stop elsewhere."""
    rng = np.random.default_rng(seed)
    sizes = int(rng.integers(1, 5)), int(rng.integers(1, 5))
    n = sum(sizes)
    K = np.zeros((n, n))
    for first, count in zip((0, sizes[0]), sizes, strict=True):
        for i, k in enumerate(10 ** rng.uniform(-3, 3, count)):
            at = [first + i - 1, first + i][i == 0 :]
            K[np.ix_(at, at)] += k * (1 if i == 0 else np.array([[1.0, -1.0], [-1.0, 1.0]]))
    load = rng.normal(size=n) * 10 ** rng.uniform(-2, 2)
    rows, gap = np.zeros((1, n)), []
    rows[0, sizes[0] - 1], rows[0, n - 1] = 1.0, -1.0
    u = np.linalg.solve(K, load)
    if rng.random() < 0.5:
        rows = np.vstack([rows, np.eye(n)[rng.integers(0, n)] * rng.choice([-1, 1])])
        gap = [rng.normal() * np.max(abs(u)) * 0.5]
        u = cq.solve(cq.ContactProblem(K, load, rows[1:], gap)).displacement
    gap = np.append(rows[0] @ u * (1 + rng.integers(-3, 4) * 2.2e-16), gap)
    scale = 2.0 ** rng.integers(-20, 20)
    return cq.ContactProblem(K * scale, load * scale, rows, gap)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("seed", [532, 554, 918, *range(12)])
def test_which_contacts_push_is_decided_beneath_the_rounding_of_doubles(seed):
    """Of the seeds that are named, refinement used to stop before it could tell."""
    pytest.importorskip("flint")
    from contactqp.linalg.rational import floats
    from contactqp.oracle.exact.rational_problem import of_floats, reduce_problem

    problem = chains(seed)
    solution = cq.solve(problem)
    assert solution.certificate.passed
    reduced = reduce_problem(of_floats(problem))
    force, motion, _ = reduced.lemke(100)
    assert reduced.holds(force, motion)
    assert np.array_equal(solution.normal_force > 0, floats(force) > 0)


def overlapping(seed: int) -> cq.ContactProblem:
    """Unknowns of which at most one is stiff, rows of any size, gaps and overlaps."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 6)), int(rng.integers(1, 8))
    K = np.zeros((n, n))
    if rng.random() < 0.4:
        k = int(rng.integers(0, n))
        K[k, k] = 10 ** rng.uniform(-3, 3)
    if rng.random() < 0.7:
        E = rng.integers(-2, 3, (m, n)).astype(float) * 10.0 ** rng.integers(-3, 4, (m, 1))
    else:
        E = rng.normal(size=(m, n))
    push = np.where(rng.random(m) < 0.6, rng.uniform(0, 1, m), 0)
    load = E.T @ push if rng.random() < 0.7 else np.zeros(n)
    if rng.random() < 0.7:
        push = np.round(push * 64) / 64
        load = E.T @ push * load.any()
    few = rng.random() < 0.5
    gap = rng.integers(-5, 6, m) * 10.0 ** rng.uniform(-6, 6) if few else -rng.uniform(0, 1, m)
    A = rng.integers(-1, 2, (1, n)).astype(float) if rng.random() < 0.25 else None
    E[~E.any(axis=1)] = np.eye(n)[0]
    A = None if A is None or not A.any() else A
    return cq.ContactProblem(K, load, E, gap, tie=A, tie_value=None if A is None else [float(rng.integers(-1, 2))])


@pytest.mark.sampled(20)
@pytest.mark.parametrize("seed", [115, 130, 519, 571, 612, 659, 698, 743, 754, 758, 795, *range(3, 12)])
def test_overlaps_without_stiffness_end_without_penetration(seed):
    """The shift to the least displacement took rounding for rows that hold it, and noise for what refinement leaves."""
    problem = overlapping(seed)
    try:
        solution = cq.solve(problem)
    except cq.NoEquilibrium:
        return
    except cq.NotCertified:  # a load that rounding takes out of the cone of the rows; machines round otherwise
        with pytest.raises(cq.NoEquilibrium, match="rational"):
            cq.exact(problem)
        return
    assert solution.certificate.passed
    u, lengths = solution.displacement, abs(problem.normal) @ abs(solution.displacement) + abs(problem.gap)
    assert np.all(problem.gap - problem.normal @ u >= -1e-12 * lengths)
    closer, violations = u * (1 - 1e-6), solution.certificate.violations
    assert violations is not None
    excess = problem.normal @ closer - problem.gap
    if np.any((excess > 1e-8 * lengths) & (excess > 10 * violations.nothing.normal)):
        assert not cq.certify(problem, closer, solution.normal_force, tie_force=solution.tie_force).passed
