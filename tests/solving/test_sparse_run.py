"""The active set on sparse systems: which problems go there, and what it shares with the certificate."""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.elements.material import Material
from contactqp.elements.shapes import box
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from contactqp.linalg import extended, iteration, pardiso, schur, sparse_saddle
from contactqp.linalg.existence import refuse_sparse_drive
from contactqp.linalg.extended import ExtendedAnswer
from contactqp.linalg.iteration import constraints_are_many
from contactqp.model.solution import Candidate
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


def test_a_band_that_decides_nothing_is_not_sought(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half the length of its longest row bounds the band of a body in space in any order: it is condensed anyhow."""
    structure = cq.Structure([cq.Body(cq.box((1.0, 1.0, 0.2), (17, 17, 3)), cq.Material(1.0, 0.3), "3d", name="block")])
    foot = cq.pair(structure.surface("block", "bottom"), cq.Plane([0.0, 0.0, 0.0], [0.0, 0.0, 1.0]))
    problem = structure.assemble([cq.Support("block", "top", axis) for axis in range(3)]).problem(foot)
    twin = problem.replace(stiffness=problem.stiffness)
    monkeypatch.setattr(iteration, "_band", lambda problem: np.diff(problem.stiffness_rows.indptr).max() // 2)
    assert not constraints_are_many(problem)
    monkeypatch.setattr(iteration, "_band", None)
    assert not constraints_are_many(twin)


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


@pytest.mark.slow
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


@pytest.mark.slow
def test_polish_and_certificate_share_a_factorisation(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []
    saddle = sparse_saddle.SparseSaddle

    def counted(problem: cq.ContactProblem, closed: np.ndarray, regularisation: float) -> sparse_saddle.SparseSaddle:
        made.append(len(closed))
        return saddle(problem, closed, regularisation)

    monkeypatch.setattr(sparse_saddle, "SparseSaddle", counted)
    assert cq.solve(membrane(60, 0.03)).certificate.proven
    assert len(made) == 1


@pytest.mark.slow
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


def test_routes_of_pivots_are_left_out_where_each_pivot_takes_long() -> None:
    grid = np.eye(200)
    assert list(_routes(cq.ContactProblem(grid, np.ones(200), grid, np.ones(200)))) == ["sparse", "clarabel"]


def test_an_indefinite_stiffness_of_a_few_contacts_is_refused_with_its_direction() -> None:
    """Of 300 unknowns, too many for eigenvalues at the door; the contacts are on the first two."""
    K = sp.identity(300, format="lil")
    K[0, 1] = K[1, 0] = 0.9
    K[1, 2] = K[2, 1] = 0.9
    problem = cq.ContactProblem(sp.csr_matrix(K), np.ones(300), sp.identity(300, format="csr")[:3], np.ones(3))
    with pytest.raises(cq.InvalidProblem, match=r"z'Kz = -0\.5.*\(unknown 1, "):
        cq.solve(problem)


@pytest.mark.slow
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


def test_what_is_free_to_move_is_at_rest_and_listed() -> None:
    """A bar that nothing holds, pulled at both ends, far from its obstacle: nothing says where it is."""
    stiffness = 157500.0 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    bar = cq.ContactProblem(stiffness, [300.0, -300.0], [[1.0, 0.0]], [5.0])
    condensed, sparse = (cq.solve(bar.replace(stiffness=stiffness), condense=way) for way in ("auto", False))
    assert [str(motion) for motion in sparse.free_motions] == [str(motion) for motion in condensed.free_motions] != []
    np.testing.assert_allclose(sparse.displacement, [300 / 315000, -300 / 315000], rtol=0, atol=5 * 1e-15)
    assert cq.solve(bar.replace(load=np.array([400.0, -300.0])), condense=False).free_motions == ()


def test_pardiso_is_switched_off_in_sparse_saddle_points_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(pardiso.SOLVER_VARIABLE, "superlu")
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
        answer = extended.ExtendedAnswer(extended.extend(u), extended.extend(force), None, extended.extend(np.zeros(0)))
        with np.errstate(all="ignore"):
            state = sparse_saddle.ClosedState.of(problem, closed, answer)
        assert not state.solved
        assert not state.holds


@pytest.mark.slow
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


@pytest.mark.skipif(importlib.util.find_spec("qpalm") is None, reason="qpalm is not installed")
def test_a_backend_that_ends_processes_is_not_asked_again() -> None:
    """QPALM may end the process where its factors break down: it is shown diagonals of one, and once."""
    problem = cq.ContactProblem(np.eye(2), np.ones(2), np.eye(2), np.ones(2))
    error = cq.NotConverged("qpalm: it stopped")
    with pytest.raises(cq.NotConverged) as raised:
        sparse_run.by_sparse_systems(problem, methods.find("qpalm"), methods.Settings(), error)
    assert raised.value is error
    assert sparse_run.by_sparse_systems(problem, methods.find("clarabel"), methods.Settings(), error).certificate.passed
    seen: list[cq.ContactProblem] = []
    method = methods.find("qpalm")

    def watched(shown: cq.ContactProblem, settings: methods.Settings) -> Candidate:
        seen.append(shown)
        return method.solve(shown, settings)

    stiff = problem.replace(stiffness=1e10 * np.eye(2), load=[2e10, 0.0])
    run = sparse_run.SparseRun(stiff, replace(method, solve=watched), methods.Settings())
    assert np.all((seen[0].diagonal >= 0.25) & (seen[0].diagonal <= 4))
    assert run.candidate.displacement == pytest.approx([1.0, 0.0], abs=1e-6)
    assert run.candidate.normal_force == pytest.approx([1e10, 0.0], abs=1e5)


def test_as_the_last_route_sparse_systems_end_after_so_many(monkeypatch: pytest.MonkeyPatch) -> None:
    """A mesh whose elements differ by 1e12 in size was refused after 640 systems and four backends, in a minute."""
    problem, settled = membrane(10, 0.03), []

    def none_holds(twin: cq.ContactProblem, answer: object, effort: sparse_saddle.Effort, *_: object) -> object:
        settled.append(effort.most)
        effort.factorisations += 30
        return sparse_saddle.ClosedState.of(twin, np.zeros(twin.contacts, dtype=bool), ExtendedAnswer.of(answer))

    few = cq.ContactProblem(problem.stiffness, problem.load, problem.normal[::10], problem.gap[::10])
    limits = _routes(few)["sparse"]
    assert limits == {"condense": False, "max_iter": 30}  # twenty, and one for each contact
    monkeypatch.setattr(sparse_run, "solved_from", none_holds)
    with pytest.raises(cq.NotConverged, match=r"\(.*; 30 systems were solved\)"):
        cq.solve(few, **limits)
    assert settled[0] == 30  # of the one backend that was asked


def test_no_linear_program_in_a_stiffness_that_every_unknown_has(monkeypatch: pytest.MonkeyPatch) -> None:
    """It found nothing that could be claimed, and in the whole K of 8000 unknowns it did not end within minutes."""
    problem = membrane(10, 0.03)
    monkeypatch.setattr("scipy.optimize.linprog", lambda *_, **__: pytest.fail("a linear program was begun"))
    refuse_sparse_drive(problem)
    monkeypatch.undo()
    bare = sp.diags(np.append(np.ones(99), 0.0))
    with pytest.raises(cq.NoEquilibrium, match="drives a motion"):
        refuse_sparse_drive(cq.ContactProblem(bare, np.ones(100), problem.normal[:50], problem.gap[:50]))


@pytest.mark.skipif(importlib.util.find_spec("daqp") is None, reason="daqp is not installed")
def test_the_answer_of_a_dense_backend_to_a_plan_is_settled_by_sparse_systems() -> None:
    """A plan with costs on three products, whose answer is stated; that of DAQP 0.11 is off by 8e-11 of its lengths."""
    random, n = np.random.default_rng(31), 24
    rows = np.zeros((12, n))
    for row in rows:
        row[random.choice(n, 4, replace=False)] = np.round(random.normal(size=4) * 10.0 ** random.integers(-2, 3, 4), 3)
    amount = np.maximum(0, random.integers(-4, 6, n)).astype(float)
    price = rows.T @ np.round(random.normal(size=12), 2) + np.where(amount > 0, 0, random.integers(0, 3, n))
    costs = np.zeros((n, n))
    chosen = random.choice(n, 3, replace=False)
    costs[chosen, chosen] = random.integers(1, 4, 3)
    plan = cq.ContactProblem.from_qp(costs, price - costs @ amount, A=rows, b=rows @ amount, lb=np.zeros(n))
    settled = cq.solve(plan, "daqp")
    assert settled.certificate.passed
    assert settled.energy == pytest.approx(plan.energy(amount), rel=1e-12)


def fit(data: int, unknowns: int) -> tuple[cq.ContactProblem, float]:
    """The fit of unknowns of at least zero to data that positive ones meet, if these are fewer, and their energy."""
    random = np.random.default_rng(data)
    X = random.random((data, unknowns))
    y = X @ random.uniform(1.0, 2.0, unknowns)
    return cq.ContactProblem.from_qp(X.T @ X, -(X.T @ y), lb=np.zeros(unknowns)), float(-0.5 * (y @ y))


def test_a_dense_energy_of_few_data_is_not_condensed() -> None:
    """Each motion without energy was treated as a rigid one: with 800 unknowns and 400 data that took half a minute."""
    assert constraints_are_many(fit(30, 60)[0])
    assert not constraints_are_many(fit(80, 60)[0])
    springs = np.eye(36)
    for first in range(0, 36, 18):  # two dense bodies, each with the motions of a rigid one
        z = np.linalg.qr(np.random.default_rng(first).standard_normal((18, 6)))[0]
        springs[first : first + 18, first : first + 18] -= z @ z.T
    assert not constraints_are_many(cq.ContactProblem(springs, np.zeros(36), -np.eye(36), np.zeros(36)))


def test_loads_that_balance_to_rounding_of_dense_entries_close_no_contacts() -> None:
    """Their rounding drove thirty motions without energy, along which fifty contacts closed one after the other."""
    problem, energy = fit(30, 60)
    solution = cq.solve(problem)
    assert solution.certificate.proven
    assert solution.energy == pytest.approx(energy, rel=1e-12)
    assert solution.work.factorisations < 10


def test_free_motions_of_a_dense_energy_are_searched_where_that_takes_a_part_of_a_second() -> None:
    """In extended precision the null space of 400 unknowns with half as many data takes ten seconds."""
    few, many = (cq.solve(fit(size // 2, size)[0]) for size in (60, 320))
    assert len(few.free_motions) == 30
    assert not many.free_motions
    assert many.certificate.proven
