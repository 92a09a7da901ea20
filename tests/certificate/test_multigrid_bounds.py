"""Certificates without a factorisation: bounds above the truth and near it, wrong answers refused."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.certificate.multigrid_bounds import dual_norm, refined_norm
from contactqp.linalg.contact_iteration import ContactIteration, FloatingMotions
from contactqp.linalg.iteration import Iteration, iteration
from contactqp.linalg.krylov import ConjugateGradients, OneProcess
from contactqp.linalg.multigrid import available
from contactqp.linalg.pardiso import SOLVER_VARIABLE
from contactqp.model.solution import FIGURES
from tests.blocks_in_space import fresh, on_paraboloid, on_sphere, stacked, with_ties

pytestmark = pytest.mark.skipif(not available(), reason="needs pyamg")


class Truth:
    """The solution by factorisation, and the true errors of anybody's answer."""

    def __init__(self, problem):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv(SOLVER_VARIABLE, "superlu")
            self.solution = cq.solve(fresh(problem))
        self.problem = problem
        n, k = problem.dimension, problem.ties
        saddle = sp.bmat([[problem.stiffness, problem.tie.T], [problem.tie, None]]) if k else problem.stiffness
        factor = sp.linalg.splu(sp.csc_matrix(saddle))
        self.respond = lambda load: factor.solve(np.concatenate([load, np.zeros(k)]))[:n]

    def energy(self, v):
        return np.sqrt(v @ (self.problem.stiffness @ v))

    def push(self, force):
        load = self.problem.normal.T @ force
        return np.sqrt(max(load @ self.respond(load), 0.0))

    def errors(self, u, force):
        known = self.solution
        energy = self.energy(u - known.displacement) / self.energy(known.displacement)
        return energy, self.push(force - known.normal_force) / self.push(known.normal_force)


PROBLEMS = {
    "a row an unknown": on_paraboloid,
    "three unknowns a row": on_sphere,
    "mortar": stacked,
    "ties": lambda: with_ties(on_paraboloid((9, 9, 6))),
    "nearly incompressible": lambda: on_paraboloid((9, 9, 6), poisson=0.499),
    "a plate": lambda: on_paraboloid((18, 18, 2), size=(1.0, 1.0, 0.02)),
    "slender": lambda: on_paraboloid((4, 4, 40), size=(0.1, 0.1, 2.0), press=1e-3),
    "tetrahedra": lambda: on_paraboloid((5, 5, 4), kind="tet10"),
}
TRUTH = {}


@pytest.fixture
def truth(request, monkeypatch):
    name = request.param
    if name not in TRUTH:
        TRUTH[name] = Truth(PROBLEMS[name]())
    monkeypatch.setenv(SOLVER_VARIABLE, "pyamg")
    return TRUTH[name]


def certified(truth, u, force):
    """A foreign answer: nothing is known of the problem yet."""
    return cq.certify(fresh(truth.problem), u, force, tie_force=truth.solution.tie_force)


@pytest.mark.sampled(48)
@pytest.mark.parametrize("truth", PROBLEMS, indirect=True)
@pytest.mark.parametrize("size", [1e-10, 1e-7, 1e-3])
@pytest.mark.parametrize("kind", ["rough", "smooth"])
def test_the_bounds_are_above_the_truth_and_not_far_above(truth, size, kind):
    """Displacements that are wrong from unknown to unknown, or as the response to some other load is."""
    generator = np.random.default_rng(3)
    u, force = truth.solution.displacement, truth.solution.normal_force
    wrong = generator.standard_normal(len(u)) / np.sqrt(truth.problem.diagonal)
    if kind == "smooth":
        wrong = truth.respond(np.ones(len(u)))
    u = u + size * wrong * truth.energy(u) / truth.energy(wrong)
    force = force * (1 + size * generator.uniform(-1, 1, len(force)))
    certificate = certified(truth, u, force)
    energy, push = truth.errors(u, force)
    assert energy <= certificate.energy_error <= 100 * energy
    assert push <= certificate.force_error
    figures = (getattr(certificate, name) for name in FIGURES)
    assert certificate.passed == (
        max(figures) <= 1e-9 and max(certificate.energy_error, certificate.force_error) <= 1e-6
    )
    assert certificate.force_bound is None
    assert any("force_bound" in reason for reason in certificate.reasons)


@pytest.mark.sampled(8)
@pytest.mark.parametrize("truth", PROBLEMS, indirect=True)
def test_our_own_answer_is_bounded_as_closely(truth):
    solution = cq.solve(fresh(truth.problem))
    energy, push = truth.errors(solution.displacement, solution.normal_force)
    certificate = solution.certificate
    assert energy <= certificate.energy_error <= 100 * energy
    assert push <= certificate.force_error <= 100 * push


@pytest.mark.slow
@pytest.mark.parametrize("truth", PROBLEMS, indirect=True)
def test_the_dual_norm_is_above_the_truth(truth):
    problem = fresh(truth.problem)
    way = iteration(problem)
    factor = sp.linalg.splu(sp.csc_matrix(problem.stiffness))
    for seed in range(4):
        load = np.random.default_rng(seed).standard_normal(problem.dimension) ** (2 * (seed % 2) + 1)
        loads = [load, factor.solve(load), problem.stiffness @ load]
        for r in loads:
            exact = np.sqrt(r @ factor.solve(r))
            assert exact <= dual_norm(way, r) <= 5 * exact


def test_a_run_ends_where_nothing_is_left_to_gain():
    """A floating body of three unknowns: two steps are all that there are, and further ones are rounding."""
    K = np.array([[1.0, -1.0, 0.0], [-1.0, 3.0, -2.0], [0.0, -2.0, 2.0]])
    near = np.linalg.inv(K + 1e-5 * np.diag(np.diag(K)))
    rigid = SimpleNamespace(admit=lambda z: z.__isub__(np.diag(K) @ z / np.trace(K)), balanced=np.copy)
    way = SimpleNamespace(
        any=np.any,
        deflated=lambda force: force - force.mean(),
        learn=lambda run: ContactIteration.learn(way, run),
        run_without_rows=lambda r: ConjugateGradients(K.dot, near.dot, np.zeros(3), r, rigid),
        least_eigenvalue=1.0,
        longest_run=0,
        krylov_iterations=0,
    )
    for seed in range(20):
        r = way.deflated(np.random.default_rng(seed).standard_normal(3))
        exact = np.sqrt(r @ np.linalg.pinv(K) @ r)
        assert exact * (1 - 1e-12) <= dual_norm(way, r, learned=True) <= 5 * exact
        assert way.least_eigenvalue > 0.99


@pytest.mark.slow
@pytest.mark.parametrize("truth", ["a row an unknown", "three unknowns a row", "mortar"], indirect=True)
def test_wrong_answers_are_refused(truth):
    u, force = truth.solution.displacement, truth.solution.normal_force
    strongest = int(np.argmax(force))
    assert certified(truth, u, force).passed
    assert any("equilibrium" in failure for failure in certified(truth, u, 1.01 * force).failures)
    assert any("tension" in failure for failure in certified(truth, u, -force).failures)
    lost = force.copy()
    lost[strongest] = 0.0
    assert any("force_error" in failure for failure in certified(truth, u, lost).failures)
    unknown = certified(truth, u, np.where(np.arange(len(force)) == 0, np.nan, force))
    assert not unknown.passed
    assert unknown.energy_error is None


@pytest.mark.slow
@pytest.mark.parametrize("truth", ["a row an unknown", "three unknowns a row", "mortar", "ties"], indirect=True)
def test_a_closed_contact_that_is_missing_is_refused_though_forces_balance(truth):
    """The answer of the problem without its strongest contact: equilibrium holds, the contact is penetrated."""
    problem = truth.problem
    strongest = int(np.argmax(truth.solution.normal_force))
    without = problem.gap.copy()
    without[strongest] += 1.0
    wrong = cq.solve(fresh(problem).replace(gap=without))
    certificate = cq.certify(fresh(problem), wrong.displacement, wrong.normal_force, tie_force=wrong.tie_force)
    assert certificate.equilibrium <= 1e-9
    assert any("penetration" in failure for failure in certificate.failures)
    energy, push = truth.errors(wrong.displacement, wrong.normal_force)
    assert energy <= certificate.energy_error <= 100 * energy
    assert push <= certificate.force_error <= 100 * push


@pytest.mark.slow
def test_friction_has_figures_and_no_bounds(monkeypatch):
    monkeypatch.setenv(SOLVER_VARIABLE, "pyamg")
    problem = on_paraboloid((8, 8, 6))
    touched = problem.normal.tocoo()
    n = problem.dimension
    order = np.argsort(touched.row)
    aside = np.column_stack([touched.col[order] - 2, touched.col[order] - 1]).ravel()
    tangent = sp.csr_array((np.ones(len(aside)), (np.arange(len(aside)), aside)), shape=(len(aside), n))
    solution = cq.solve(problem)
    rough = problem.replace(tangent=tangent, friction=0.3)
    certificate = cq.certify(rough, solution.displacement, solution.normal_force, np.zeros((problem.contacts, 2)))
    assert certificate.equilibrium <= 1e-9
    assert certificate.slip_direction > 1e-3
    assert not certificate.proven
    assert "not condensed" in certificate.reasons[0]


class _Dense(Iteration):
    """Products with K and M of a dense matrix, M given; nothing else is asked of it."""

    def __init__(self, K: np.ndarray, M: np.ndarray) -> None:
        ContactIteration.__init__(self)
        self._K, self._M = K, M
        none = np.zeros((len(K), 0))
        self.floating = FloatingMotions(OneProcess(), np.diag(K), none, 0, lambda x: x[:0], np.zeros(0))

    def product(self, x: np.ndarray) -> np.ndarray:
        return self._K @ x

    def smooth(self, force: np.ndarray) -> np.ndarray:
        return self._M @ force


def test_refinement_bounds_the_norm_where_m_is_nearly_the_inverse_and_says_nothing_where_it_is_not() -> None:
    random = np.random.default_rng(3)
    root = random.standard_normal((12, 12))
    K, r = root @ root.T + 0.1 * np.eye(12), random.standard_normal(12)
    true = float(np.sqrt(r @ np.linalg.solve(K, r)))
    for off in (0.0, 1e-8, 0.2, -0.2):
        bound = refined_norm(_Dense(K, (1 + off) * np.linalg.inv(K)), r)
        assert bound is not None
        assert true * (1 - 1e-12) <= bound <= true * (1 + 1e-3)
    assert refined_norm(_Dense(K, 0.4 * np.linalg.inv(K)), r) is None
    assert refined_norm(_Dense(K, np.diag(1 / np.diag(K))), r) is None
    assert refined_norm(_Dense(K, np.linalg.inv(K)), np.zeros(12)) == 0
