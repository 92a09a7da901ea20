"""Many rows on sparse systems: vertices where rows meet, rows that nearly depend or conflict, programs in any units."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

import contactqp as cq
from contactqp.elements.material import Material
from contactqp.elements.shapes import rectangle
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from contactqp.linalg import existence
from contactqp.solving import sparse_run
from contactqp.solving.methods import Settings, find
from contactqp.solving.methods.inexact_active_set import projects_slowly
from tests.solving.test_linear_programs import transport


def test_rows_that_repeat_and_a_vertex_where_many_meet() -> None:
    """The corner of a box of 30 unknowns at which 90 rows meet, each side three times in other lengths."""
    n, rng = 30, np.random.default_rng(4)
    rows = np.vstack([np.eye(n), 3.0 * np.eye(n), np.eye(n) / 7.0])
    limit = np.concatenate([np.ones(n), 3.0 * np.ones(n), np.ones(n) / 7.0])
    problem = cq.ContactProblem.from_qp(np.zeros((n, n)), -rng.uniform(1, 2, n), G=rows, h=limit)
    solution = cq.solve(problem)
    assert solution.certificate.passed
    assert solution.displacement == pytest.approx(np.ones(n), rel=1e-14)
    assert np.min(solution.normal_force) >= 0.0


@pytest.mark.parametrize("order", [2, 3])
def test_banded_inequalities_agree_with_condensing(order: int) -> None:
    """The nearest sequence whose differences of an order are not negative, as in LISWET."""
    n, rng = 60, np.random.default_rng(order)
    t = np.linspace(0.0, 1.0, n)
    data = t**order + 0.1 * np.sin(9 * t) + 0.01 * rng.standard_normal(n)
    differences = sp.identity(n, format="csr")
    for _ in range(order):
        differences = differences[1:] - differences[:-1]
    problem = cq.ContactProblem.from_qp(sp.identity(n), -data, G=-differences, h=np.zeros(differences.shape[0]))
    sparse, condensed = (cq.solve(problem, condense=condense) for condense in (False, True))
    assert sparse.certificate.proven
    assert sparse.displacement == pytest.approx(condensed.displacement, rel=1e-9)


def test_rows_in_a_narrow_band_are_shown_to_one_backend(monkeypatch: pytest.MonkeyPatch) -> None:
    """The nearest convex sequence to a concave one is a line. Clarabel had been run twice, and a vertex was sought."""
    asked, size = [], 3000
    monkeypatch.setattr(sparse_run, "find", lambda name: asked.append(name) or find(name))
    differences = sp.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(size - 2, size))
    i = np.arange(-size + 1.0, size, 2.0)
    data = 5.0 * i / size - (i / size) ** 2 + np.sum((i / size) ** 2) / size
    solution = cq.solve(cq.ContactProblem.from_qp(sp.identity(size), -data, G=-differences, h=np.zeros(size - 2)))
    assert solution.certificate.proven
    assert asked == ["piqp"]
    assert solution.displacement == pytest.approx(5.0 * i / size, abs=1e-13)


def test_ties_that_share_their_unknowns_are_left_to_backends(monkeypatch: pytest.MonkeyPatch) -> None:
    """A chain pulled at its end, with weighted sums of its displacements tied to what they are, one of them twice.

    Projections had factorised the products of all pairs of ties for each set, again where ties depend on each other.
    """
    size = 2400
    monkeypatch.setattr(sparse_run, "held_by_hierarchy", None)
    chain = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(size, size)).tolil()
    chain[-1, -1] = 1.0
    u, pull, every = np.arange(1.0, size + 1), np.eye(1, size, size - 1)[0], sp.identity(size)
    sums = np.random.default_rng(0).integers(-3, 4, (12, size)).astype(float)
    ties = np.vstack([sums, sums[0] + sums[1]])
    problem = cq.ContactProblem(sp.csr_matrix(chain), pull, every, u + 1.0, tie=ties, tie_value=ties @ u)
    assert cq.solve(problem, condense=False).displacement == pytest.approx(u, rel=1e-14)
    pairs = sp.diags([1.0, -1.0], [0, 1], shape=(size - 1, size))
    few = cq.ContactProblem(sp.csr_matrix(chain), pull, every, u, tie=pairs, tie_value=np.zeros(size - 1))
    assert projects_slowly(problem)
    assert not projects_slowly(few)


def nearest_with_differences(size: int, order: int, kink: float) -> tuple[cq.ContactProblem, np.ndarray]:
    """The nearest sequence to data whose differences of an order are not negative, and the data."""
    i = np.arange(size)
    data = abs(i / size - kink) + 0.1 * np.sin(i + 1.0)
    entries = [(-1.0) ** (order - k) * math.comb(order, k) for k in range(order + 1)]
    differences = sp.diags(entries, list(range(order + 1)), shape=(size - order, size), format="csr")
    return cq.ContactProblem.from_qp(sp.identity(size), -data, G=-differences, h=np.zeros(size - order)), data


@pytest.mark.slow
@pytest.mark.parametrize(
    ("order", "size", "kink"),
    [
        (3, 1000, 0.5),
        (4, 500, 0.7),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in [(3, 3000, 0.7), (3, 3000, 0.5), (4, 3000, 0.7)]),
    ],
)
def test_differences_that_nearly_depend_on_each_other_are_proven(order: int, size: int, kink: float) -> None:
    """Rows whose least singular value is about (pi / n)^order: beside K, its square is beneath rounding.

    The nearest sequence is the least-squares fit by polynomials that meet at the open rows, where the last of their
    derivatives grows.
    """
    problem, data = nearest_with_differences(size, order, kink)
    solution = cq.solve(problem, condense=False)
    assert solution.certificate.proven
    opened, i = np.flatnonzero(solution.normal_force == 0), np.arange(size)
    assert 0 < len(opened) < 20
    beyond = np.maximum(i[:, None] - opened - 1.0, 0.0)
    pieces = np.prod([np.maximum(beyond - k, 0.0) / size for k in range(order - 1)], axis=0)
    basis = np.hstack([np.vander(i / size, order), pieces])
    weights, _, _, sizes = np.linalg.lstsq(basis, data, rcond=None)
    assert np.all(weights[order:] > 0)
    # The reference knows no more digits: of fourth differences of 3000 its condition number is 3e11.
    known = max(1e-9, 0.01 * np.finfo(float).eps * sizes[0] / sizes[-1])
    assert solution.displacement == pytest.approx(basis @ weights, abs=known)


@pytest.mark.slow
@pytest.mark.parametrize(("order", "size"), [(4, 300), (6, 200)])
def test_where_condensed_systems_end_in_a_ray_many_rows_go_to_sparse_ones_first(order: int, size: int) -> None:
    """Textbook systems, a dense one for each pivot, took minutes; of order four rounding says whether there is one."""
    solution = cq.solve(nearest_with_differences(size, order, 0.7)[0])
    assert solution.certificate.proven
    routes = solution.work.routes
    assert order == 4 or len(routes) == 2
    assert len(routes) in (0, 2)
    assert routes[1:] in ((), ("sparse: its answer is certified",))


@pytest.mark.slow
@pytest.mark.parametrize(("order", "size"), [(6, 500), (10, 150)])
def test_differences_of_too_few_digits_are_given_up_in_seconds(order: int, size: int) -> None:
    """Singular values go down to 1e-13 there. Pivots that no energy followed had not ended within minutes."""
    started = time.process_time()
    with pytest.raises((cq.NotConverged, cq.NotCertified), match="no answer is certified"):
        cq.solve(nearest_with_differences(size, order, 0.7)[0])
    assert time.process_time() - started < 30


def convex_fit(size: int, values: Any) -> cq.ContactProblem:
    """The convex sequence nearest to given values: second differences of all of them are rows."""
    rows = sp.diags([-1.0, 2.0, -1.0], [0, 1, 2], shape=(size - 2, size), format="csr")
    return cq.ContactProblem(sp.identity(size, format="csr"), values, rows, np.zeros(size - 2))


@pytest.mark.parametrize("size", [2000, pytest.param(5000, marks=pytest.mark.slow)])
def test_an_almost_solved_answer_is_asked_for_again_with_less_on_the_diagonal(size: int) -> None:
    """What Clarabel adds to the diagonal hides differences of thousands of unknowns: its answer is off by a tenth."""
    t = np.linspace(0.0, 1.0, size)
    problem = convex_fit(size, np.sin(6 * t) + 0.1 * np.sin(np.arange(size)))
    first = find("clarabel").solve(problem, Settings(1e-9))
    solution = cq.solve(problem, "clarabel")
    u = solution.displacement
    assert not first.claimed
    assert np.max(abs(first.answer.displacement - u)) > 1e-3 * np.max(abs(u))
    assert solution.certificate.proven
    assert solution.work.factorisations <= 20  # hundreds, where contacts changed one by one from that answer
    assert np.all(problem.normal @ u <= 1e-14)


def test_a_convex_fit_of_concave_values_is_their_regression_line() -> None:
    t = np.linspace(0.0, 1.0, 1000)
    values = -((t - 0.5) ** 2) - 0.3 * t**2
    solution = cq.solve(convex_fit(len(t), values), "clarabel")
    assert solution.certificate.proven
    assert np.all(solution.normal_force > 0)
    assert solution.displacement == pytest.approx(np.polyval(np.polyfit(t, values, 1), t), abs=1e-14)


def test_optimal_control_agrees_with_condensing() -> None:
    """x' = A x + B v in steps, as many equations as states, bounds on the control, no weight on the velocity."""
    steps = 40
    A, B = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([0.005, 0.1])
    size = 3 * steps
    rows, values = np.zeros((2 * steps, size)), np.zeros(2 * steps)
    for k in range(steps):
        rows[2 * k : 2 * k + 2, 3 * k : 3 * k + 2] = np.eye(2)
        rows[2 * k : 2 * k + 2, 3 * k + 2] = -B
        if k:
            rows[2 * k : 2 * k + 2, 3 * k - 3 : 3 * k - 1] = -A
    values[:2] = A @ [1.0, 0.0]
    weight = np.tile([1.0, 0.0, 0.01], steps)
    bound = np.tile([np.inf, np.inf, 0.8], steps)
    problem = cq.ContactProblem.from_qp(np.diag(weight), np.zeros(size), A=rows, b=values, lb=-bound, ub=bound)
    solution = cq.solve(problem)
    assert solution.certificate.passed
    assert np.sum(solution.normal_force > 0) > 3
    theirs = cq.solve(problem, "clarabel")
    assert solution.energy == pytest.approx(theirs.energy, rel=1e-12)
    assert abs(solution.displacement[2::3]).max() <= 0.8 * (1 + 1e-12)


def test_conflicts_are_proven_and_named() -> None:
    n = 20
    rows = np.vstack([np.ones((1, n)), -np.eye(n)])
    problem = cq.ContactProblem.from_qp(np.zeros((n, n)), np.ones(n), G=rows, h=np.r_[1.0, -np.ones(n)])
    with pytest.raises(cq.NoEquilibrium, match="row 0") as caught:
        cq.solve(problem)
    assert caught.value.proof.excess == pytest.approx(n - 1)


@pytest.mark.slow
def test_an_energy_that_falls_for_ever_is_told_with_the_direction() -> None:
    n = 20
    load = np.ones(n)
    problem = cq.ContactProblem.from_qp(np.zeros((n, n)), load, ub=np.zeros(n))
    with pytest.raises(cq.NoEquilibrium, match="falls for ever") as caught:
        cq.solve(problem)
    motion = caught.value.proof.motion
    assert problem.load @ motion > 0
    assert np.all(problem.normal @ motion <= 0)


def test_rows_that_contradict_by_rounding_are_believed_and_not_proven() -> None:
    """x + y = 0.3 and x + y = 0.1 + 0.2 differ in the last place; nothing else is wrong with them."""
    n = 16
    rows = np.zeros((2, n))
    rows[:, :2] = 1.0
    problem = cq.ContactProblem.from_qp(
        np.zeros((n, n)), np.arange(1.0, n + 1.0), A=rows, b=[0.3, 0.1 + 0.2], lb=np.zeros(n)
    )
    solution = cq.solve(problem)
    assert solution.certificate.passed
    assert not solution.certificate.proven
    assert "rounding of the data" in solution.certificate.reasons[0]
    assert solution.displacement[0] == pytest.approx(0.3, rel=1e-12)


def staged(seed: int, stages: int = 6, width: int = 8, quadratic: int = 6, spread: int = 0) -> cq.ContactProblem:
    """Carry goods through stages for the least cost: integers beside costs of 1e-9, a few of them quadratic.

    Unknowns and ties have units of their own, of up to 10^spread.
    """
    rng = np.random.default_rng(seed)
    size = stages * width * width
    cost = rng.integers(0, 5, size).astype(float)
    cost[rng.random(size) < 0.1] = 1e-9 * rng.integers(1, 5)
    out, into = sp.kron(sp.identity(width), np.ones(width)), sp.kron(np.ones(width), sp.identity(width))
    leaving = sp.vstack([sp.kron(sp.identity(stages), out), sp.csr_matrix((width, size))])
    arriving = sp.vstack([sp.csr_matrix((width, size)), sp.kron(sp.identity(stages), into)])
    balance = np.concatenate([np.ones(width), np.zeros((stages - 1) * width), -np.ones(width)])
    energy = np.zeros(size)
    energy[rng.choice(size, quadratic, replace=False)] = rng.choice([1.0, 2.0, 10.0], quadratic)
    d, t = (10.0 ** rng.integers(-spread, spread + 1, count) for count in (size, len(balance)))
    rows, stiffness = sp.csr_matrix(sp.diags(t) @ (leaving - arriving) @ sp.diags(d)), sp.diags(d * energy * d)
    return cq.ContactProblem.from_qp(stiffness, d * cost, A=rows, b=t * balance, lb=np.zeros(size))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 5, 6, 7, 8, 9])
def test_degenerate_vertices_are_found_in_units_of_each_unknown_and_tie(seed: int) -> None:
    """Where data round differently, forces of 1e-16 decide what closes; backends, and programs, see no such thing."""
    solution, beside = (cq.solve(staged(seed, 4, 6, 4, spread)) for spread in (3, 0))
    assert solution.certificate.passed
    assert solution.energy == pytest.approx(beside.energy, rel=1e-9)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("seed", range(4))
def test_programs_by_a_modelling_language_are_polished_on_sparse_systems(seed: int) -> None:
    pytest.importorskip("cvxpy")
    assert cq.solve(staged(seed, 3, 3, 2), "cvxpy").certificate.passed


@pytest.mark.slow
@pytest.mark.parametrize("unit", [2.0**-6, 1.0, 2.0**5])
@pytest.mark.parametrize("seed", [8, 41, 52])
def test_degenerate_vertices_are_found_in_all_units_of_force(seed: int, unit: float) -> None:
    """Where forces of 1e-9 decide which contacts close, those of an interior point come to a set with too few."""
    problem = staged(seed)
    solution = cq.solve(problem.replace(stiffness=unit * problem.stiffness, load=unit * problem.load))
    assert solution.certificate.proven
    assert solution.energy == pytest.approx(unit * cq.solve(problem).energy, rel=1e-12)


def held_at_no_cost() -> tuple[cq.ContactProblem, dict[str, np.ndarray]]:
    """Ties that hold what costs no energy, beside unknowns at rest; the answer, with the forces of rounding."""
    size = 20
    stiffness, rows = np.r_[np.ones(4), np.zeros(size - 4)], (np.eye(size) + np.eye(size, k=1))[4:]
    limits = dict(A=rows, b=rows.sum(axis=1), ub=np.full(size, 9.0))
    problem = cq.ContactProblem.from_qp(np.diag(stiffness), np.zeros(size), **limits)
    forces = dict(normal_force=np.zeros(problem.contacts), tie_force=np.full(size - 4, 1.6e-38))
    return problem, dict(displacement=1.0 - stiffness, **forces)


@pytest.mark.slow
def test_forces_of_rounding_are_measured_by_what_lengths_would_make() -> None:
    problem, answer = held_at_no_cost()
    assert cq.certify(problem, **answer).passed
    for name, planted in (("tie_force", 1e-6), ("normal_force", 1e-6)):
        wrong = answer[name].copy()
        wrong[3] += planted
        assert not cq.certify(problem, **(answer | {name: wrong})).passed


@pytest.mark.sampled(2)
@pytest.mark.parametrize("factor", [2.0**-40, 2.0**40])
def test_units_change_nothing(factor: float) -> None:
    problem = transport(5)
    other = cq.ContactProblem(
        problem.stiffness,
        problem.load * factor,
        problem.normal,
        problem.gap * factor**2,
        None,
        None,
        None,
        problem.tie,
        problem.tie_value * factor**2,
    )
    first, second = cq.solve(problem), cq.solve(other)
    assert second.certificate.passed
    assert second.energy == pytest.approx(first.energy * factor**3, rel=1e-12)


def heated_from_its_border(cells: int, capped_by: float) -> cq.ContactProblem:
    """-Laplace u = 20 in a square, u >= 0 on its border, u within it capped by so much below the least that can be."""
    nodes = cells + 1
    at = np.arange(nodes * nodes).reshape(nodes, nodes)
    inner = at[1:-1, 1:-1].ravel()
    beside = [at[:-2, 1:-1], at[2:, 1:-1], at[1:-1, :-2], at[1:-1, 2:]]
    rows = np.tile(np.arange(len(inner)), 5)
    columns = np.concatenate([inner, *(part.ravel() for part in beside)])
    values = np.repeat([4.0, -1.0, -1.0, -1.0, -1.0], len(inner))
    tie = sp.csc_matrix((values, (rows, columns)), shape=(len(inner), nodes * nodes))
    heat = np.full(len(inner), 20.0 / cells**2)
    least = spsolve(tie[:, inner], heat)
    inside = np.isin(at.ravel(), inner)
    below, above = np.where(inside, -np.inf, 0.0), np.where(inside, np.max(least) - capped_by, 10.0)
    K = sp.diags(np.where(inside, 1.0, 1e-4 * cells) / cells**2, format="csr")
    return cq.ContactProblem.from_qp(K, np.zeros(nodes * nodes), A=tie, b=heat, lb=below, ub=above)


@pytest.mark.slow
@pytest.mark.parametrize("capped_by", [0.27, pytest.param(1.1e-5, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "method", ["active-set", *(pytest.param(x, marks=pytest.mark.slow) for x in ("piqp", "clarabel"))]
)
def test_ten_thousand_constraints_that_conflict_are_refused_without_a_linear_program(
    method: str, capped_by: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It took half a minute where there are thirty thousand."""
    monkeypatch.setattr(existence, "_least_excess", None)
    problem = heated_from_its_border(75, capped_by)
    with pytest.raises(cq.NoEquilibrium, match="no displacement satisfies these constraints together") as error:
        cq.solve(problem, method)
    proof = error.value.proof
    assert isinstance(proof, existence.Conflict)
    assert np.all(proof.normal >= 0)
    moved = problem.normal.T @ proof.normal + problem.tie.T @ proof.tie
    sizes = abs(problem.normal).T @ proof.normal + abs(problem.tie).T @ abs(proof.tie)
    assert np.max(abs(moved) - 1e-14 * sizes) <= 0
    overlap = -(problem.gap @ proof.normal + problem.tie_value @ proof.tie)
    assert overlap == pytest.approx(proof.excess, rel=1e-6)
    assert overlap > 100 * proof.rounding


@pytest.mark.slow
def test_ten_thousand_constraints_that_nearly_conflict_are_met() -> None:
    assert cq.solve(heated_from_its_border(75, -1e-5)).certificate.proven


def test_gaps_that_are_rounding_of_coordinates_are_met_beside_what_loads_cause() -> None:
    """Sixty blocks on each other, free to slide, whose gaps of 1e-15 are the rounding of their heights."""
    count, weight = 60, 1e-5
    blocks = [
        Body(
            rectangle(1.0, 0.3, ((7, 5)[i % 2], 2), corner=(0.0, 0.3 * i)),
            Material(1.0, 0.3),
            "plane-strain",
            name=f"b{i}",
        )
        for i in range(count)
    ]
    structure = Structure(blocks)
    held = structure.assemble([Support("b0", "bottom", axis) for axis in range(2)])
    faces = [(structure.surface(f"b{i}", "top"), structure.surface(f"b{i + 1}", "bottom")) for i in range(count - 1)]
    load = np.zeros(structure.size)
    load[1::2] = -weight
    problem = held.problem([cq.pair_mortar(*both) for both in faces]).replace(load=load[held.free])
    assert 0 < abs(problem.gap).max() < 1e-13
    found = cq.solve(problem)
    assert not found.work.routes
    assert found.work.factorisations <= 5
    assert found.certificate.proven
    lifted = np.zeros((structure.size, count - 1))  # all blocks above a joint
    for i in range(count - 1):
        lifted[structure.first(f"b{i + 1}") + 1 :: 2, i] = 1.0
    lifted = lifted[held.free]
    carried = (problem.normal @ lifted).T @ found.normal_force
    assert carried == pytest.approx(lifted.T @ problem.load, rel=1e-12)
