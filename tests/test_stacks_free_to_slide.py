"""Blocks of solid that lie on each other, free to slide, ten decades of stiffness apart: K is singular to rounding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp import solving
from contactqp.methods import find

SEEDS = (26, 84, 100, 191, 207, 331, 343)
POISSON = 0.3
GAUSS = 1 / np.sqrt(3)


def rectangle(width: float, height: float, modulus: float) -> np.ndarray:
    """K of a bilinear rectangle in plane stress, counterclockwise nodes."""
    D = modulus / (1 - POISSON**2) * np.array([[1, POISSON, 0], [POISSON, 1, 0], [0, 0, (1 - POISSON) / 2]])
    K = np.zeros((8, 8))
    for x in (-GAUSS, GAUSS):
        for y in (-GAUSS, GAUSS):
            shapes = np.array([[y - 1, 1 - y, 1 + y, -1 - y], [x - 1, -1 - x, 1 + x, 1 - x]]) / 4
            gradient = shapes * np.array([[2 / width], [2 / height]])
            B = np.zeros((3, 8))
            B[0, ::2], B[1, 1::2], B[2, ::2], B[2, 1::2] = gradient[0], gradient[1], gradient[1], gradient[0]
            K += B.T @ D @ B * width * height / 4
    return K


def block(wide: int, high: int, width: float, height: float, modulus: float) -> np.ndarray:
    """K of a grid of rectangles; node (x, y) has the number x + (wide + 1) y."""
    K = np.zeros((2 * (wide + 1) * (high + 1),) * 2)
    element = rectangle(width / wide, height / high, modulus)
    for x in range(wide):
        for y in range(high):
            first = x + (wide + 1) * y
            nodes = np.array([first, first + 1, first + wide + 2, first + wide + 1])
            at = np.column_stack([2 * nodes, 2 * nodes + 1]).ravel()
            K[np.ix_(at, at)] += element
    return (K + K.T) / 2


def stack(seed: int, decades: float) -> cq.ContactProblem:
    """Two to four blocks under loads that press every column of nodes down."""
    rng = np.random.default_rng(seed)
    count, wide, width = int(rng.integers(2, 5)), int(rng.integers(1, 5)), rng.uniform(0.1, 2)
    powers = rng.permutation(np.append([0.0, decades], rng.uniform(0, decades, count - 2)))
    parts, loads, tops = [], [], []
    for b in range(count):
        high, height = int(rng.integers(1, 4)), rng.uniform(0.1, 1)
        parts.append(block(wide, high, width, height, 1e6 * 10 ** powers[b]))
        tops.append(np.arange(wide + 1) + (wide + 1) * high)
        load = np.zeros(len(parts[b]))
        if b == count - 1:
            load[2 * tops[b] + 1] = -rng.uniform(0.1, 1, wide + 1) * 1e3
        if rng.random() < 0.5:
            load[1::2] -= rng.uniform(0, 1) * 10 ** rng.uniform(-2, 2)
        loads.append(load)
    K = sp.block_diag(parts).toarray()
    first = np.cumsum([0] + [len(part) for part in parts])
    E = np.zeros((count * (wide + 1), len(K)))
    for b in range(count):
        for k in range(wide + 1):
            E[b * (wide + 1) + k, first[b] + 2 * k + 1] = -1
            if b:
                E[b * (wide + 1) + k, first[b - 1] + 2 * tops[b - 1][k] + 1] = 1
    gap = np.where(rng.random(len(E)) < 0.5, 0, rng.uniform(0, 1, len(E)) * 10 ** rng.uniform(-8, -2))
    return cq.ContactProblem(K, np.concatenate(loads), E, gap)


@pytest.mark.parametrize("seed", SEEDS)
def test_steel_on_what_is_softer_by_ten_decades(seed: int) -> None:
    problem = stack(seed, 10.0)
    solution = cq.solve(problem)
    assert solution.certificate.passed
    assert solution.free_motions
    weight = -np.sum(problem.load)
    floor = np.flatnonzero(np.count_nonzero(problem.normal.toarray(), axis=1) == 1)
    # K z of the rigid motion of a stiff block is rounding of K, which the forces balance as well.
    rounding = np.finfo(float).eps * np.max(abs(problem.stiffness) @ abs(solution.displacement))
    assert np.sum(solution.normal_force[floor]) == pytest.approx(weight, rel=1e-9, abs=rounding)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("decades", [0.0, 4.6, 7.0])
def test_stacks_of_usual_contrast_need_no_other_route(seed: int, decades: float) -> None:
    solution = cq.solve(stack(seed, decades))
    assert solution.certificate.passed
    assert solution.work.routes == ()


def _spoiling(*names: str):
    """The registry, with methods that find no contact force and are not corrected."""

    def spoiled(name: str):
        method = find(name)
        if name not in names:
            return method

        def nothing(problem, settings):
            candidate = method.solve(problem, settings)
            return replace(candidate, normal_force=0 * candidate.normal_force, displacement=0 * candidate.displacement)

        return replace(method, solve=nothing, corrections=0)

    return spoiled


def test_another_exact_route_is_tried_before_the_user_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = cq.ContactProblem([[157500.0]], [300.0], [[1.0]], [1e-3])
    monkeypatch.setattr(solving, "find", _spoiling("active-set"))
    solution = cq.solve(problem)
    assert solution.certificate.passed
    assert solution.normal_force == pytest.approx([142.5])
    assert solution.work.routes[0].startswith("active-set: the certificate refuses")
    assert solution.work.routes[-1] == "lemke: its answer is certified"


def test_where_all_routes_are_refused_the_user_is_told_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = cq.ContactProblem([[157500.0]], [300.0], [[1.0]], [1e-3])
    monkeypatch.setattr(solving, "find", _spoiling("active-set", *solving.ROUTES))
    with pytest.raises(cq.NotCertified, match="lemke, lagrange-multiplier, clarabel were tried too") as caught:
        cq.solve(problem)
    assert caught.value.solution.method == "active-set"


def test_who_names_a_limit_is_told_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = cq.ContactProblem([[157500.0]], [300.0], [[1.0]], [1e-3])
    monkeypatch.setattr(solving, "find", _spoiling("active-set"))
    with pytest.raises(cq.NotCertified):
        cq.solve(problem, time_limit=10.0)
