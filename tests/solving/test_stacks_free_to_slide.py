"""Blocks of solid that lie on each other, free to slide, ten decades of stiffness apart: K is singular to rounding."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import block_diag

import contactqp as cq
from contactqp.linalg.condensation import condense, free_motions
from contactqp.linalg.dense import saddle_point
from contactqp.solving import solve as solving
from contactqp.solving.methods import find

# Stacks that were refused: on all but the first two lines because K's rounding spoiled the resultants.
SEEDS = (26, 84, 100, 191, 207, 331, 343)
SEEDS += (7, 17, 27, 36, 40, 72, 93, 135, 140, 163, 177, 220, 226, 256, 323, 330, 341)
SEEDS += (2, 11, 43, 125, 145, 168, 276, 284, 317)
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
    K = block_diag(*parts)
    first = np.cumsum([0] + [len(part) for part in parts])
    E = np.zeros((count * (wide + 1), len(K)))
    for b in range(count):
        for k in range(wide + 1):
            E[b * (wide + 1) + k, first[b] + 2 * k + 1] = -1
            if b:
                E[b * (wide + 1) + k, first[b - 1] + 2 * tops[b - 1][k] + 1] = 1
    gap = np.where(rng.random(len(E)) < 0.5, 0, rng.uniform(0, 1, len(E)) * 10 ** rng.uniform(-8, -2))
    return cq.ContactProblem(K, np.concatenate(loads), E, gap)


@pytest.mark.sampled(33)
@pytest.mark.parametrize("seed", SEEDS)
def test_steel_on_what_is_softer_by_ten_decades(seed: int) -> None:
    problem = stack(seed, 10.0)
    solution = cq.solve(problem)
    assert solution.certificate.passed
    assert solution.work.routes == ()
    assert solution.free_motions
    floor = np.flatnonzero(np.count_nonzero(problem.normal.toarray(), axis=1) == 1)
    assert np.sum(solution.normal_force[floor]) == pytest.approx(-np.sum(problem.load), rel=1e-12)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("decades", [3.0, 10.0])
def test_wrong_answers_of_stiff_blocks_on_soft_ones_are_refused(decades: float) -> None:
    """What is forgiven to rounding of the stiff block's K hides neither a force nor a strain of the soft one."""
    problem = stack(276, decades)
    solution = cq.solve(problem)
    u, force = solution.displacement, solution.normal_force
    largest = np.argmax(force)
    for factor in (1 + 1e-5, 1 - 1e-5):
        assert not cq.certify(problem, u, np.where(np.arange(len(force)) == largest, factor * force, force)).passed
    soft = np.argmax(abs(u) * np.sqrt(problem.stiffness.diagonal()))
    assert not cq.certify(problem, u * np.where(np.arange(len(u)) == soft, 1 + 1e-5, 1.0), force).passed
    unloaded = np.flatnonzero(force == 0)
    pulled = force - 1e-5 * force[largest] * (np.arange(len(force)) == (unloaded[0] if unloaded.size else largest))
    assert not cq.certify(problem, u, pulled).passed


def _lattice(rng: np.random.Generator, wide: int, size: float) -> list[tuple[int, int, np.ndarray, float]]:
    """Springs along edges and diagonals of a row of squares: two nodes, from one to the other, stiffness."""
    nodes = np.array([(x, y) for y in (0, 1) for x in range(wide)])
    pairs = [(i, j, nodes[j] - nodes[i]) for i in range(2 * wide) for j in range(i + 1, 2 * wide)]
    return [(i, j, d, size * 10 ** rng.uniform(0, 1)) for i, j, d in pairs if np.max(abs(d)) == 1]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))
def test_forces_are_those_of_the_springs_whose_sums_k_rounds(seed: int) -> None:
    """A stiffness whose sums are rounded is singular to rounding only; the unrounded one, in rational numbers, is so
    exactly. Ten decades of stiffness apart the blocks' answer is that of the latter to the last digits."""
    flint = pytest.importorskip("flint")
    from contactqp.linalg.rational import floats, rational
    from contactqp.oracle.exact.rational_problem import of_floats, reduce_problem

    rng = np.random.default_rng(seed)
    count, wide = 3, int(rng.integers(2, 5))
    sizes = 10 ** rng.permutation([0.0, 10.0, rng.uniform(0, 10)])
    n = 4 * wide
    K, exact = np.zeros((count * n, count * n)), np.zeros((count * n, count * n), dtype=object)
    exact[:] = rational(0.0)
    for b, size in enumerate(sizes):
        for i, j, along, k in _lattice(rng, wide, float(size)):
            at, both = b * n + np.array([2 * i, 2 * i + 1, 2 * j, 2 * j + 1]), np.append(along, -along)
            K[np.ix_(at, at)] += k * np.outer(both, both)
            exact[np.ix_(at, at)] += np.outer(both, both).astype(int) * rational(k)
    load, E = np.zeros(count * n), np.zeros((count * wide, count * n))
    load[-2 * wide + 1 :: 2] = -rng.uniform(0.1, 1, wide)
    for b in range(count):
        rows, low = b * wide + np.arange(wide), b * n + 2 * np.arange(wide) + 1
        E[rows, low] = -1.0
        if b:
            E[rows, low - 2 * wide] = 1.0
    problem = cq.ContactProblem(K, load, E, rng.uniform(0, 1, len(E)) * 10 ** rng.uniform(-8, -1))
    solution = cq.solve(problem)
    reduced = reduce_problem(replace(of_floats(problem), K=flint.fmpq_mat(exact.tolist())))
    found = reduced.on_set(np.flatnonzero(solution.normal_force > 0).tolist())
    assert found is not None
    assert reduced.holds(*found)
    assert solution.normal_force == pytest.approx(floats(found[0]), rel=1e-9)


def test_free_motions_of_a_soft_block_tied_to_a_stiff_one_keep_the_tie() -> None:
    K = block_diag(block(1, 1, 1.0, 1.0, 1.0), block(2, 1, 1.0, 0.5, 1e10))
    E, A = np.zeros((2, len(K))), np.zeros((1, len(K)))
    E[0, 1], E[1, 3], A[0, 4], A[0, 8] = -1.0, -1.0, 1.0, -1.0
    problem = cq.ContactProblem(K, np.zeros(len(K)), E, [0.0, 0.0], tie=A)
    condensation = condense(problem)
    motions = free_motions(condensation, saddle_point(condensation, np.zeros(0, dtype=np.intp)))
    assert motions.shape[1] == 5
    assert abs(A @ motions) == pytest.approx(0.0, abs=1e-15)
    assert motions.T @ motions == pytest.approx(np.eye(5), abs=1e-14)


@pytest.mark.sampled(36)
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
            return replace(
                candidate,
                answer=replace(
                    candidate.answer, normal_force=0 * candidate.normal_force, displacement=0 * candidate.displacement
                ),
            )

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


def _not_converged(*_: Any) -> Any:
    raise cq.NotConverged("no interior point led to closed contacts that hold")


def test_where_all_routes_are_refused_the_user_is_told_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = cq.ContactProblem([[157500.0]], [300.0], [[1.0]], [1e-3])
    monkeypatch.setattr(solving, "find", _spoiling("active-set", *solving.PIVOTING, "clarabel"))
    monkeypatch.setattr(solving, "SparseRun", _not_converged)
    with pytest.raises(cq.NotCertified, match="lemke, lagrange-multiplier, clarabel, sparse were tried too") as caught:
        cq.solve(problem)
    assert caught.value.solution.method == "active-set"


def test_who_limits_iterations_is_told_at_once_and_who_limits_time_while_there_is_any_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = cq.ContactProblem([[157500.0]], [300.0], [[1.0]], [1e-3])
    monkeypatch.setattr(solving, "find", _spoiling("active-set"))
    with pytest.raises(cq.NotCertified):
        cq.solve(problem, max_iter=10)
    solution = cq.solve(problem, time_limit=60.0)
    assert solution.work.routes[-1] == "lemke: its answer is certified"
    monkeypatch.setattr(solving, "time_is_up", lambda: True)
    with pytest.raises(cq.NotCertified):
        cq.solve(problem, time_limit=60.0)


def rough(seed: int, decades: float) -> cq.ContactProblem:
    """A stack whose contacts rub, pushed sideways at its top by a hundredth of its weight or less."""
    smooth, rng = stack(seed, decades), np.random.default_rng(seed)
    normal = smooth.normal.toarray()
    tangent = np.zeros_like(normal)
    tangent[:, ::2] = normal[:, 1::2]
    load = smooth.load.copy()
    load[-2] += rng.uniform(-1, 1) * 0.01 * np.sum(abs(load))
    gap = np.where(rng.random(len(normal)) < 0.7, 0.0, smooth.gap)
    return cq.ContactProblem(smooth.stiffness, load, normal, gap, tangent=tangent, friction=rng.choice([0.2, 0.6]))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 9))
def test_stiff_blocks_on_soft_ones_that_rub(seed: int) -> None:
    problem = rough(seed, 10.0)
    solution = cq.solve(problem)
    assert solution.certificate.passed
    force, friction = solution.normal_force, solution.friction_force
    assert friction is not None
    floor = np.flatnonzero(np.count_nonzero(problem.normal.toarray(), axis=1) == 1)
    assert np.sum(force[floor]) == pytest.approx(-np.sum(problem.load[1::2]), rel=1e-12)
    assert np.sum(friction[floor]) == pytest.approx(-np.sum(problem.load[::2]), rel=1e-9)
    largest = np.argmax(force)
    for name in ("normal", "friction"):
        spoiled = {"normal": force.copy(), "friction": friction.copy()}
        spoiled[name][largest] *= 1 + 1e-5
        assert not cq.certify(problem, solution.displacement, spoiled["normal"], spoiled["friction"]).passed


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", [14, 35, *range(4)])  # the first two were refused
def test_bodies_that_hold_each_other_in_any_units_of_their_unknowns(seed: int) -> None:
    """Two chains, one held by a tie and the other by a contact with it; an unknown may be in units of 2^-25 to 2^25."""
    stiffness = np.zeros((8, 8))
    for first, springs in ((0, (5.5625, 8.25, 3.046875, 2.234375)), (5, (2.0625, 1168.0))):
        for i, spring in enumerate(springs, start=first):
            stiffness[i : i + 2, i : i + 2] += spring * np.array([[1.0, -1.0], [-1.0, 1.0]])
    rows, tie = np.eye(8)[[1, 0]] - np.eye(8)[[2, 7]], np.eye(8)[[7]]
    u, force = np.array([0.5, 0.875, 0.75, -0.5, -0.5, 0.5, 0.5, 0.875]), np.array([0.8125, 0.9375])
    load = stiffness @ u + rows.T @ force + tie.T @ [2.625]
    unit = 2.0 ** np.random.default_rng(seed).integers(-25, 25, 8)
    problem = cq.ContactProblem(
        stiffness * np.outer(unit, unit), load * unit, rows * unit, rows @ u, tie=tie * unit, tie_value=tie @ u
    )
    solution = cq.solve(problem)
    assert solution.certificate.proven
    np.testing.assert_allclose(solution.displacement * unit, u, atol=1e-13)
    np.testing.assert_allclose(solution.normal_force, force, rtol=1e-13)


@pytest.mark.parametrize("unit", [1.0, 2.0**-40, 2.0**40])
def test_a_body_that_no_row_holds_stays_free_in_any_units(unit: float) -> None:
    """Of two chains side by side one contact holds the first; a load on the second alone has nothing against it."""
    chain = np.array([[1.0, -1.0], [-1.0, 1.0]])
    scale = np.array([1.0, 1.0, unit, unit])
    stiffness = np.kron(np.eye(2), chain) * np.outer(scale, scale)
    problem = cq.ContactProblem(stiffness, [1.0, 0.0, 0.0, 0.0], [[0.0, 1.0, 0.0, 0.0]], [0.5])
    assert len(cq.solve(problem).free_motions) == 1
    with pytest.raises(cq.NoEquilibrium):
        cq.solve(problem.replace(load=[1.0, 0.0, unit, 0.0]))


@pytest.mark.parametrize("left", [1e-17, 1e-14])
def test_what_cancellation_leaves_of_zero_holds_no_body(left: float) -> None:
    """Two contacts hold the first of two chains, and feel the second by rounding: it is free, and a load drives it."""
    chain = np.array([[1.0, -1.0], [-1.0, 1.0]])
    rows = [[0.0, 1.0, left, 0.0], [0.0, 1.0, 0.0, 2 * left]]
    problem = cq.ContactProblem(np.kron(np.eye(2), chain), [1.0, 0.0, 1.0, 0.0], rows, [0.5, 0.5])
    assert saddle_point(condense(problem), np.array([0, 1])).free.shape[1] == 1
    with pytest.raises(cq.NoEquilibrium):
        cq.solve(problem)


def test_a_body_that_is_shifted_within_its_gaps_is_penetrated_in_no_unit() -> None:
    """A floating lattice and a mass that four rows join: the least displacement is bounded by two contacts that touch.

    In units that are 2^34 apart the shift along its motions was met to 2e-9 there.
    """
    stiffness = np.zeros((9, 9))
    springs = [(0, 1, -1), (0, 2, 1), (0, 6, 1), (0, 7, 1), (1, 5, 1), (1, 6, 1), (1, 7, 1), (2, 3, 1), (2, 4, 1),
               (2, 5, -1), (3, 4, -1), (3, 5, 1), (3, 7, 1), (4, 5, 1), (4, 6, 1), (6, 7, -1)]  # fmt: skip
    for i, j, sign in springs:
        stiffness[i, j] = stiffness[j, i] = -sign
    stiffness += np.diag([2.0] * 8 + [0.1337890625])
    load = np.array([-3.0, -1.625, 3.125, -2.125, -3.375, 1.75, 3.25, 2.0, -0.0167236328125])
    rows = np.array(
        [[-0.5, -0.25, 1.75, 0.25, -0.5, 0.5, 0.5, 0.5, 0.75], [-0.75, 0.75, -0.5, -1.0, 1.75, 0.5, -1.0, 0.0, 0.0],
         [1.0, -1.0, -0.75, -0.75, 0.75, -0.5, -0.75, 1.0, -1.0], [0.75, 0.75, -1.0, -0.5, 0.25, 1.5, 0.75, 0.5, 0.0]]
    )  # fmt: skip
    gap, unit = np.array([3.46875, -1.875, -2.40625, 0.90625]), 2.0 ** np.array([40, 32, 35, 39, 10, 6, 12, 22, 28])
    solution = cq.solve(cq.ContactProblem(stiffness * np.outer(unit, unit), load * unit, rows * unit, gap))
    assert solution.certificate.passed
    assert len(solution.free_motions) >= 3
    assert np.min(solution.gap) > -1e-13
