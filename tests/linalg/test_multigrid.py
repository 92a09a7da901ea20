"""The V-cycle is what conjugate gradients and the bounds take it for: symmetric, positive, below the inverse."""

import numpy as np
import pytest
import scipy.sparse as sp

from contactqp.linalg import multigrid
from contactqp.linalg.krylov import AssembledRows, ConjugateGradients
from contactqp.linalg.multigrid import Hierarchy, available, largest_eigenvalue
from contactqp.linalg.v_cycle import HeldHierarchy
from tests.blocks_in_space import on_paraboloid, on_sphere, stacked

pytestmark = pytest.mark.skipif(not available(), reason="needs pyamg")


@pytest.fixture(autouse=True)
def several_levels(monkeypatch):
    monkeypatch.setattr(multigrid, "COARSEST", 60)


def preconditioner(problem, held, hierarchy=None):
    hierarchy = hierarchy or Hierarchy(problem.stiffness_rows, problem.near_null_space)
    return HeldHierarchy(hierarchy, problem.normal).cycle(np.asarray(held, dtype=np.intp))


def dense(operator, n):
    return np.column_stack([operator(column) for column in np.eye(n)])


SMALL = {
    "a row an unknown": lambda: on_paraboloid((5, 5, 4)),
    "three unknowns a row": lambda: on_sphere((4, 4, 4)),
    "mortar": lambda: stacked((4, 4, 3), (3, 3, 3)),
    "quadratic": lambda: on_paraboloid((2, 2, 3), kind="tet10"),
    "nearly incompressible": lambda: on_paraboloid((5, 5, 4), poisson=0.499),
}


@pytest.mark.sampled(15)
@pytest.mark.parametrize("name", SMALL)
@pytest.mark.parametrize("part", [0.0, 0.5, 1.0])
def test_the_v_cycle_is_symmetric_and_its_spectrum_ends_at_one(name, part):
    """Else conjugate gradients would not converge, and one would be no bound on the largest eigenvalue of M K."""
    problem = SMALL[name]()
    hierarchy = Hierarchy(problem.stiffness_rows, problem.near_null_space)
    assert len(hierarchy.levels) >= 2
    held = np.arange(int(part * problem.contacts))
    M = dense(preconditioner(problem, held, hierarchy), problem.dimension)
    assert np.max(abs(M - M.T)) <= 1e-13 * np.max(abs(M))
    E = problem.normal.toarray()[held]
    K = problem.stiffness.toarray()
    strength = 10.0 / np.sum(E**2 / np.diag(K), axis=1)
    lower = np.linalg.cholesky(K + (E.T * strength) @ E)
    spectrum = np.linalg.eigvalsh(lower.T @ ((M + M.T) / 2) @ lower)
    assert spectrum[0] > (0.003 if name == "nearly incompressible" else 0.03)
    assert spectrum[-1] <= 1 + 1e-12


@pytest.mark.slow
def test_strong_springs_that_are_not_along_an_axis_leave_the_nodes_free_across_them():
    """On the diagonal alone they kept nodes from moving across them: steps of GMRES with friction rose threefold."""
    problem = SMALL["a row an unknown"]()
    touched = np.unique(problem.normal.indices // 3)
    rows = sp.identity(problem.dimension, format="csr")[(3 * touched[:, None] + np.arange(3)).ravel()]
    stiffness = 1e3 * np.mean(problem.diagonal)
    springs = sp.kron(sp.identity(len(touched)), np.sqrt(stiffness / 2) * np.array([[1.0, 1.0, 0.0]]), format="csr")
    hierarchy = Hierarchy(problem.stiffness_rows, problem.near_null_space)
    cycle = HeldHierarchy(hierarchy, rows).cycle(np.zeros(0, dtype=np.intp), springs)
    F = (springs @ rows).toarray()
    lower = np.linalg.cholesky(problem.stiffness.toarray() + F.T @ F)
    spectrum = np.linalg.eigvalsh(lower.T @ dense(cycle, problem.dimension) @ lower)
    assert 0.2 < spectrum[0] < spectrum[-1] <= 1 + 1e-12


@pytest.mark.slow
def test_a_held_face_does_not_spoil_the_preconditioner_as_the_mesh_is_refined():
    """Without the rows' stiffness it does: the same run with M for the free body takes ever more steps."""
    steps = {}
    for cells in (6, 12):
        problem = on_paraboloid((cells, cells, cells), size=(1.0, 1.0, 1.0))
        E = problem.normal
        held = np.arange(problem.contacts)
        hierarchy = Hierarchy(problem.stiffness_rows, problem.near_null_space)
        for kind, rows in (("held", held), ("free", held[:0])):
            projection = AssembledRows(
                sp.csr_matrix(E), np.arange(problem.dimension), np.zeros(len(held)), 1 / problem.diagonal
            )
            cycle = preconditioner(problem, rows, hierarchy)
            load = np.random.default_rng(1).standard_normal(problem.dimension)
            run = ConjugateGradients(problem.stiffness.__matmul__, cycle, np.zeros(problem.dimension), load, projection)
            start = np.linalg.norm(run.unbalanced)
            while np.linalg.norm(run.unbalanced) > 1e-8 * start:
                assert run.step()
            steps[kind, cells] = run.steps
    assert steps["held", 12] <= steps["held", 6] + 3 <= 20
    assert steps["free", 12] >= 1.4 * steps["held", 12]


def test_units_of_the_unknowns_change_nothing():
    problem = SMALL["a row an unknown"]()
    scale = np.repeat(10.0 ** np.random.default_rng(0).uniform(-3, 3, problem.dimension // 3), 3)
    D = sp.diags(scale)
    twin = Hierarchy(sp.csr_matrix(D @ problem.stiffness @ D), problem.near_null_space / scale[:, None])
    mine = Hierarchy(problem.stiffness_rows, problem.near_null_space)
    assert [level.matrix.shape for level in twin.levels] == [level.matrix.shape for level in mine.levels]
    assert twin.held == pytest.approx(mine.held, rel=1e-8)
    r = np.random.default_rng(1).standard_normal(problem.dimension)
    other = HeldHierarchy(twin, problem.normal @ D).cycle(np.arange(5))(r * scale) * scale
    assert other == pytest.approx(preconditioner(problem, np.arange(5), mine)(r), rel=1e-8, abs=1e-10)


def test_bodies_that_float_are_told_by_a_motion_without_energy():
    K = sp.block_diag([on_paraboloid((3, 3, 3)).stiffness, on_paraboloid((3, 3, 3), sides=False).stiffness])
    motions = np.vstack([on_paraboloid((3, 3, 3), sides=s).near_null_space for s in (True, False)])
    for B in (motions, None):
        hierarchy = Hierarchy(sp.csr_matrix(K), B)
        assert hierarchy.bodies.max() == 1
        assert hierarchy.held[0] > 1e-4
        assert (abs(hierarchy.held[1]) < 1e-14) == (B is not None)


def test_the_largest_eigenvalue_is_not_underestimated():
    K = SMALL["quadratic"]().stiffness.toarray()
    root = 1 / np.sqrt(np.diag(K))
    exact = np.linalg.eigvalsh(K * np.outer(root, root))[-1]
    assert exact <= largest_eigenvalue(K.__matmul__, np.diag(K)) <= 1.1 * exact * (1 + 1e-12)


@pytest.mark.slow
def test_steps_of_conjugate_gradients_tell_the_energy_of_the_error_and_the_spectrum():
    problem = SMALL["a row an unknown"]()
    K, n = problem.stiffness.toarray(), problem.dimension
    cycle = preconditioner(problem, [])
    none = AssembledRows(sp.csr_matrix((0, n)), np.arange(n), np.zeros(0), np.ones(n))
    r = np.random.default_rng(2).standard_normal(n)
    exact = r @ np.linalg.solve(K, r)
    lower = np.linalg.cholesky(K)
    least = np.linalg.eigvalsh(lower.T @ dense(cycle, n) @ lower)[0]
    run = ConjugateGradients(problem.stiffness.__matmul__, cycle, np.zeros(n), r.copy(), none)
    for _ in range(8):
        assert run.step()
        assert run.gained <= exact <= run.gained + run.square() / least
        assert least <= run.least_eigenvalue() <= 1
    assert run.gained == pytest.approx(exact, rel=1e-6)
    assert run.square() == pytest.approx(run.unbalanced @ cycle(run.unbalanced), rel=1e-12)


def test_a_lone_unknown_on_a_spring_does_not_float():
    chain = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(200, 200))
    hierarchy = Hierarchy(sp.block_diag([chain, [[7.0]]], format="csr"))
    assert len(hierarchy.levels) > 1
    assert hierarchy.held[1] == pytest.approx(1.0)
    assert not hierarchy.soft.any()


def test_bodies_of_one_motion_are_measured_at_once(monkeypatch):
    # A diagonal K of 93 261 unknowns has as many bodies; an eigenvalue problem of each took nine seconds.
    monkeypatch.setattr(multigrid, "energy_ratios", None)
    bodies = [[[2.0, -1.0], [-1.0, 2.0]], [[3.0, -3.0], [-3.0, 3.0]], [[5.0]]]
    pairs = sp.csr_matrix(sp.block_diag([sp.csr_array(body) for body in bodies], format="csr"))
    hierarchy = Hierarchy(pairs, coarsest=2)
    assert hierarchy.held == pytest.approx([0.5, 0.0, 1.0], abs=1e-15)
    assert list(hierarchy.soft) == [0, 1, 0]
