"""The active set on sparse systems: many constraints, vertices where many rows meet."""

from __future__ import annotations

import importlib.util
import math
import sys

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.elements.material import Material
from contactqp.elements.shapes import box
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from contactqp.linalg import extended, pardiso, schur, sparse_saddle
from contactqp.linalg.iteration import constraints_are_many
from contactqp.solving import methods, sparse_run
from contactqp.solving.methods import inexact_active_set
from contactqp.solving.solve import _routes
from tests.solving.test_linear_programs import transport


def membrane(nodes: int, height: float) -> cq.ContactProblem:
    """A square membrane under a pressure that pushes it against an obstacle at this height over every node."""
    h = 1.0 / (nodes + 1)
    chain = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(nodes, nodes))
    one = sp.identity(nodes)
    K = sp.csr_matrix(sp.kron(one, chain) + sp.kron(chain, one))
    size = nodes * nodes
    return cq.ContactProblem(K, np.full(size, h * h), sp.identity(size, format="csr"), np.full(size, height))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("height", [0.068, 0.03, 0.0025])
def test_a_membrane_over_an_obstacle_is_solved_without_condensing(height: float) -> None:
    problem = membrane(40, height)
    assert constraints_are_many(problem)
    sparse = cq.solve(problem)
    assert sparse.certificate.proven
    assert sparse.certificate.determined == "displacement"
    assert sparse.work.retained == problem.dimension
    condensed = cq.solve(problem, condense=True)
    assert np.any(condensed.normal_force > 0)
    assert sparse.displacement == pytest.approx(condensed.displacement, rel=1e-12, abs=1e-15)
    assert sparse.normal_force == pytest.approx(condensed.normal_force, rel=1e-9, abs=1e-14)


def test_few_contacts_on_a_body_are_condensed_as_ever() -> None:
    problem = membrane(40, 0.03)
    few = cq.ContactProblem(problem.stiffness, problem.load, problem.normal[::40], problem.gap[::40])
    assert not constraints_are_many(few)


def strip_on_a_floor(length: int) -> cq.ContactProblem:
    """Three rows of springs in a plane, pressed onto a floor under all nodes of the lowest."""
    along = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(length, length))
    across = np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    K = sp.csr_matrix(sp.kron(along, np.eye(3)) + sp.kron(sp.identity(length), across))
    E = -sp.identity(3 * length, format="csr")[::3]
    load = np.zeros(3 * length)
    load[2::3] = -0.1 + 0.2 * np.sin(np.arange(length) / 7.0)
    return cq.ContactProblem(K, load, E, np.full(length, 0.05))


@pytest.mark.slow
def test_a_long_strip_stays_sparse_and_a_short_one_does_not() -> None:
    assert not constraints_are_many(strip_on_a_floor(200))
    long = strip_on_a_floor(800)
    assert constraints_are_many(long)
    sparse, condensed = cq.solve(long), cq.solve(long, condense=True)
    assert sparse.certificate.proven
    assert 0 < np.count_nonzero(sparse.normal_force) < 800
    assert sparse.normal_force == pytest.approx(condensed.normal_force, rel=1e-9, abs=1e-13)


def plate_on_a_ball(cells: int) -> cq.ContactProblem:
    """A plate of one layer of hexahedra, its top pressed down, every node beneath it over a ball."""
    body = Body(box((1.0, 1.0, 0.05), (cells, cells, 1)), Material(1.0, 0.3), "3d", name="plate")
    structure = Structure([body])
    held = [Support("plate", "top", axis, -0.02 if axis == 2 else 0.0) for axis in range(3)]
    ball = cq.Paraboloid([0.5, 0.5, 0.0], [0.0, 0.0, 1.0], 5.0)
    return structure.assemble(held).problem([cq.pair(structure.surface("plate", "bottom"), ball)])


@pytest.mark.slow
def test_a_plate_with_contacts_all_over_stays_sparse() -> None:
    problem = plate_on_a_ball(40)
    assert constraints_are_many(problem) == (importlib.util.find_spec("pyamg") is not None)
    sparse, condensed = cq.solve(problem, condense=False), cq.solve(problem, condense=True)
    assert sparse.certificate.proven
    assert 100 < np.count_nonzero(sparse.normal_force) < problem.contacts
    assert sparse.normal_force == pytest.approx(condensed.normal_force, rel=1e-9, abs=1e-14)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", ["daqp", "lagrange-multiplier"])
def test_dense_matrices_of_ten_thousand_ties_are_refused_before_they_are_made(method: str) -> None:
    n, ties = 15_000, 10_000
    K = sp.diags([-1.0, 4.0, -1.0], [-1, 0, 1], shape=(n, n), format="csr")
    equal = sp.diags([1.0, -1.0], [0, 1], shape=(ties, n), format="csr")
    stop = sp.identity(n, format="csr")[n - 50 :]
    problem = cq.ContactProblem(K, np.ones(n), stop, np.full(50, 0.1), tie=equal, tie_value=np.zeros(ties))
    with pytest.raises(cq.Unsupported, match=rf"^{method}: 50 contacts and 10000 ties would .* active-set") as refusal:
        cq.solve(problem, method)
    assert "\n" not in str(refusal.value)
    assert cq.solve(problem, "piqp").certificate.proven


def test_dense_matrices_that_do_not_fit_into_memory_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = membrane(40, 0.03)
    assert cq.solve(membrane(24, 0.03), "daqp").certificate.passed
    monkeypatch.setattr(methods, "free_memory", lambda: 100 * 2**20)
    with pytest.raises(cq.Unsupported, match=r"about 0.2 GiB \(0.1 GiB are free\)"):
        cq.solve(problem, "active-set", condense=True)


@pytest.mark.slow
@pytest.mark.skipif(not importlib.util.find_spec("pyamg"), reason="pyamg is not installed")
def test_a_set_that_only_shrinks_does_so_by_layers(monkeypatch: pytest.MonkeyPatch) -> None:
    by_layers = cq.solve(membrane(120, 0.03))
    monkeypatch.setattr(inexact_active_set, "MOST_LAYERS", 1)
    one_by_one = cq.solve(membrane(120, 0.03))
    assert by_layers.work.iterations < 0.7 * one_by_one.work.iterations
    assert by_layers.normal_force == pytest.approx(one_by_one.normal_force, rel=1e-12, abs=1e-16)


@pytest.mark.slow
def test_backends_identify_where_no_hierarchy_does(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = cq.solve(membrane(60, 0.03))
    monkeypatch.setattr(sparse_run, "held_by_hierarchy", lambda _: False)
    found = cq.solve(membrane(60, 0.03))
    assert found.normal_force == pytest.approx(expected.normal_force, rel=1e-12, abs=1e-16)


@pytest.mark.slow
def test_repeated_bounds_share_their_force() -> None:
    """Two rows on one unknown are no fixing rows: neither is eliminated, and both forces are found."""
    problem = membrane(50, 0.03)
    twice = np.r_[np.arange(problem.contacts), 0:2500:7]
    rows, gap = problem.normal[twice], problem.gap[twice]
    repeated = cq.ContactProblem(problem.stiffness, problem.load, rows, gap)
    expected, found = cq.solve(problem), cq.solve(repeated, condense=False)
    assert found.certificate.passed
    together = problem.normal.T @ expected.normal_force
    assert rows.T @ found.normal_force == pytest.approx(together, rel=1e-9, abs=1e-14)


def test_a_tie_that_holds_an_unknown_is_eliminated_too() -> None:
    problem = membrane(50, 0.03)
    held = sp.identity(2500, format="csr")[::50]
    tied = problem.replace(tie=held, tie_value=np.full(50, 0.01))
    found = cq.solve(tied, condense=False)
    assert found.certificate.proven
    assert found.displacement[::50] == pytest.approx(0.01, rel=1e-14)
    left = problem.load - problem.stiffness @ found.displacement - problem.normal.T @ found.normal_force
    assert held @ left == pytest.approx(found.tie_force, rel=1e-9)


def test_polish_and_certificate_share_a_factorisation(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []
    saddle = sparse_saddle.SparseSaddle

    def counted(problem: cq.ContactProblem, closed: np.ndarray, regularisation: float) -> sparse_saddle.SparseSaddle:
        made.append(len(closed))
        return saddle(problem, closed, regularisation)

    monkeypatch.setattr(sparse_saddle, "SparseSaddle", counted)
    assert cq.solve(membrane(60, 0.03)).certificate.proven
    assert len(made) == 1


@pytest.mark.skipif(not pardiso.available(), reason="needs pypardiso")
def test_a_strip_is_analysed_once_and_multiplied_exactly_only_where_digits_are_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The answer's factors and the certificate's have one analysis; K u takes part in four extended residuals."""
    phases: list[int] = []
    products: list[int] = []
    call, product = pardiso._Analysis.call, extended._product

    def called(self: object, phase: int, *given: object) -> None:
        phases.append(phase)
        call(self, phase, *given)

    def multiplied(block: object, *given: object) -> object:
        products.append(block.values.size)
        return product(block, *given)

    monkeypatch.setattr(pardiso._Analysis, "call", called)
    monkeypatch.setattr(extended, "_product", multiplied)
    problem = strip_on_a_floor(800)
    entries = sum(block.values.size for block in extended.SparseRows(problem.stiffness_rows)._blocks)
    assert cq.solve(problem).certificate.proven
    assert phases.count(pardiso.ANALYSE) == 1
    assert phases.count(pardiso.FACTORISE) == 2
    assert sum(size for size in products if 4 * size > entries) == 4 * entries


def test_a_far_unknown_on_a_soft_spring_hides_no_residual_elsewhere() -> None:
    """One unknown goes 4e4 on a spring of 1e-8, another has a spring of one; forces elsewhere are some 1e-4."""
    n = 20
    stiffness = np.zeros(n)
    stiffness[:2] = 1e-8, 1.0
    row = np.r_[np.zeros(2), np.ones(n - 2)]
    cost = np.r_[-4e-4, 0.0, np.linspace(1e-4, 3e-4, n - 2)]
    problem = cq.ContactProblem.from_qp(np.diag(stiffness), cost, A=[row], b=[1.0], lb=np.zeros(n))
    solution = cq.solve(problem)
    assert solution.displacement[0] == pytest.approx(4e4, rel=1e-12)
    assert solution.certificate.proven
    off = solution.tie_force * (1 + 1e-6)
    assert not cq.certify(problem, solution.displacement, solution.normal_force, tie_force=off).passed


@pytest.mark.parametrize("shift", [1e-6, -1e-6])
def test_a_force_that_is_off_by_a_millionth_is_refused(shift: float) -> None:
    problem = membrane(30, 0.03)
    solution = cq.solve(problem, condense=False)
    force = solution.normal_force.copy()
    force[int(np.argmax(force))] *= 1 + shift
    answer = dict(displacement=solution.displacement, normal_force=force)
    assert cq.certify(problem, displacement=solution.displacement, normal_force=solution.normal_force).passed
    assert not cq.certify(problem, **answer).passed


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


def nearest_with_differences(size: int, order: int, kink: float) -> tuple[cq.ContactProblem, np.ndarray]:
    """The nearest sequence to data whose differences of an order are not negative, and the data."""
    i = np.arange(size)
    data = abs(i / size - kink) + 0.1 * np.sin(i + 1.0)
    entries = [(-1.0) ** (order - k) * math.comb(order, k) for k in range(order + 1)]
    differences = sp.diags(entries, list(range(order + 1)), shape=(size - order, size), format="csr")
    return cq.ContactProblem.from_qp(sp.identity(size), -data, G=-differences, h=np.zeros(size - order)), data


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
    """Textbook systems, a dense one for each pivot, took minutes."""
    solution = cq.solve(nearest_with_differences(size, order, 0.7)[0])
    assert solution.certificate.proven
    assert solution.work.routes[-1] == "sparse: its answer is certified"
    assert len(solution.work.routes) == 2


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


def test_an_indefinite_stiffness_is_refused_with_its_direction() -> None:
    n = 1500
    K = sp.diags([np.full(n, 2.0), np.full(n - 1, -1.2), np.full(n - 1, -1.2)], [0, -1, 1])
    problem = cq.ContactProblem(sp.csr_matrix(K), np.ones(n), sp.identity(n, format="csr"), np.ones(n))
    with pytest.raises(cq.InvalidProblem, match=r"z'Kz = -.*not convex"):
        cq.solve(problem)


def test_sparse_systems_are_the_first_route_where_constraints_outnumber_the_unknowns() -> None:
    inner = np.eye(3)
    few = cq.ContactProblem(np.eye(3), np.ones(3), inner[:1], np.ones(1))
    many = cq.ContactProblem(np.eye(3), np.ones(3), np.vstack([inner, -inner]), np.ones(6))
    assert list(_routes(few))[-1] == "sparse"
    assert next(iter(_routes(many))) == "sparse"
    assert sorted(_routes(few)) == sorted(_routes(many))


def test_an_indefinite_stiffness_of_a_few_contacts_is_refused_with_its_direction() -> None:
    """Of 300 unknowns, too many for eigenvalues at the door; the contacts are on the first two."""
    K = sp.identity(300, format="lil")
    K[0, 1] = K[1, 0] = 0.9
    K[1, 2] = K[2, 1] = 0.9
    problem = cq.ContactProblem(sp.csr_matrix(K), np.ones(300), sp.identity(300, format="csr")[:3], np.ones(3))
    with pytest.raises(cq.InvalidProblem, match=r"z'Kz = -0\.5.*\(unknown 1, "):
        cq.solve(problem)


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


@pytest.mark.sampled(2)
@pytest.mark.parametrize("backend", ["clarabel", "piqp"])
def test_backends_are_polished_on_sparse_systems(backend: str) -> None:
    pytest.importorskip(backend)
    problem = membrane(40, 0.03)
    solution, default = cq.solve(problem, backend), cq.solve(problem)
    assert solution.certificate.proven
    assert solution.raw is not None
    assert solution.displacement == pytest.approx(default.displacement, rel=1e-13)


def test_bounds_and_ties_of_separate_energies_are_first_shown_to_piqp() -> None:
    # Its factors are those of the ties; Clarabel's, which has a row for each bound, took four times as long of 93 261.
    n, random = 3000, np.random.default_rng(3)
    K, tie = sp.diags(random.uniform(1.0, 9.0, n), format="csr"), sp.csr_matrix(np.ones((1, n)))
    bounds, above = -sp.identity(n, format="csr"), np.zeros(n)
    problem = cq.ContactProblem(K, random.normal(size=n), bounds, above, tie=tie, tie_value=[n / 10])
    steps: list[str] = []
    assert cq.solve(problem, progress=steps.append).certificate.proven
    assert [step.split()[0] for step in steps if step.endswith("finds the closed contacts")] == ["piqp"]


def test_what_the_package_depends_on_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    with_all = [cq.solve(problem) for problem in (membrane(20, 0.03), transport(3))]
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *a: None if name == "piqp" else find(name, *a))
    monkeypatch.setitem(sys.modules, "piqp", None)
    for problem, known in zip((membrane(20, 0.03), transport(3)), with_all, strict=True):
        found = cq.solve(problem)
        assert found.certificate.proven
        assert found.energy == pytest.approx(known.energy, rel=1e-12)


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


@pytest.mark.sampled(2)
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


def test_what_is_free_to_move_is_at_rest_and_listed() -> None:
    """A bar that nothing holds, pulled at both ends, far from its obstacle: nothing says where it is."""
    stiffness = 157500.0 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    bar = cq.ContactProblem(stiffness, [300.0, -300.0], [[1.0, 0.0]], [5.0])
    condensed, sparse = (cq.solve(bar.replace(stiffness=stiffness), condense=way) for way in ("auto", False))
    assert [str(motion) for motion in sparse.free_motions] == [str(motion) for motion in condensed.free_motions] != []
    np.testing.assert_allclose(sparse.displacement, [300 / 315000, -300 / 315000], rtol=0, atol=5 * 1e-15)
    assert cq.solve(bar.replace(load=np.array([400.0, -300.0])), condense=False).free_motions == ()


def test_pardiso_is_switched_off_in_sparse_saddle_points_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(pardiso.CHOICE, "superlu")
    monkeypatch.setattr(pardiso, "Pardiso", lambda *_: pytest.fail("PARDISO was called"))
    problem = membrane(50, 0.03)
    assert problem.dimension > schur.LARGE
    found = cq.solve(problem, condense=False)
    assert found.certificate.passed
    assert found.work.solver == "superlu"


@pytest.mark.slow
def test_slender_bodies_with_many_contacts_are_condensed_where_sparse_systems_know_too_few_digits() -> None:
    """A cantilever of 1000 elements between obstacles above and below every node: kappa(K) is some 1e14."""
    n = 1000
    h = 1.0 / n
    element = np.array([
        [12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h],
        [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h * h, -6 * h, 4 * h * h],
    ]) / h**3  # fmt: skip
    K = sp.lil_matrix((2 * n + 2, 2 * n + 2))
    for k in range(n):
        K[2 * k : 2 * k + 4, 2 * k : 2 * k + 4] += element
    load = np.zeros(2 * n)
    load[::2] = -1.0 / n
    below = sp.csr_matrix((-np.ones(n), (np.arange(n), 2 * np.arange(n))), shape=(n, 2 * n))
    x = np.arange(1, n + 1) / n
    gap = np.concatenate([np.where(abs(x - 0.5) < 0.2, 1e-3, 3e-2), np.ones(n)])
    problem = cq.ContactProblem(sp.csr_matrix(K.tocsr()[2:, 2:]), load, sp.vstack([below, -below]), gap)
    solution = cq.solve(problem)
    assert solution.certificate.proven
    assert solution.work.routes[-1] == "condensed: its answer is certified"
    assert np.allclose(solution.normal_force, cq.solve(problem, condense=True).normal_force, rtol=1e-5, atol=1e-9)


def test_numbers_that_are_none_solve_nothing() -> None:
    """A state of NaN had residuals of zero, and was returned as the solution."""
    problem = membrane(4, 0.03)
    closed, nothing = np.ones(16, dtype=bool), np.zeros(16)
    for u, force in ((np.full(16, np.nan), nothing), (nothing, np.full(16, np.nan)), (np.full(16, np.inf), nothing)):
        answer = extended.ExtendedAnswer(*(extended.extend(part) for part in (u, force, np.zeros(0))))
        with np.errstate(all="ignore"):
            state = sparse_saddle.ClosedState.of(problem, closed, answer)
        assert not state.solved
        assert not state.holds


def test_bounds_on_both_sides_of_a_dense_energy_stay_sparse() -> None:
    # The active set closes them one by one: condensed, 700 unknowns took 13 s of the processor, and these a minute.
    n, random = 700, np.random.default_rng(5)
    factor = random.normal(size=(n // 2, n)) / np.sqrt(n)
    budget, ones = np.ones((1, n)), np.ones(n)
    program = cq.ContactProblem.from_qp(
        factor.T @ factor, 0.01 * random.normal(size=n), A=budget, b=[1.0], lb=0.0 * ones, ub=5.0 / n * ones
    )
    assert constraints_are_many(program)
    solution = cq.solve(program)
    assert solution.certificate.passed
    assert solution.work.retained == n
    with pytest.raises(cq.NoEquilibrium) as refusal:
        cq.solve(program.replace(gap=np.where(program.gap > 0, 0.9 / n, 0.0)))
    assert refusal.value.proof.excess > refusal.value.proof.rounding
