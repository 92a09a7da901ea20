"""Bodies solved without a factorisation: the answers of the factorising way, and what is refused."""

import importlib.util
import sys

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.certificate.multigrid_bounds import ENOUGH_STEPS
from contactqp.linalg import multigrid
from contactqp.linalg.factorization import widest_level
from contactqp.linalg.iteration import iterated, iteration
from contactqp.linalg.pardiso import SOLVER_VARIABLE
from contactqp.solving.methods import Settings, inexact_active_set
from tests.blocks_in_space import fresh, layered, on_paraboloid, on_sphere, stacked, with_ties

needs_pyamg = pytest.mark.skipif(not multigrid.available(), reason="needs pyamg")


@pytest.fixture
def by_iteration(monkeypatch):
    monkeypatch.setenv(SOLVER_VARIABLE, "pyamg")


def factorised(problem):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(SOLVER_VARIABLE, "superlu")
        return cq.solve(fresh(problem))


def twice(problem):
    """Every contact two times."""
    rows = sp.vstack([problem.normal, problem.normal])
    return problem.replace(normal=rows, gap=np.tile(problem.gap, 2), contact_names=None)


CASES = {
    "a row an unknown": on_paraboloid,
    "three unknowns a row": on_sphere,
    "mortar": stacked,
    "ties": lambda: with_ties(on_paraboloid()),
    "ties and three unknowns a row": lambda: with_ties(on_sphere()),
    "some unknowns of a node held": lambda: on_paraboloid().replace(near_null_space=None),
    "nearly incompressible": lambda: on_paraboloid((9, 9, 7), poisson=0.499),
    "a plate": lambda: on_paraboloid((20, 20, 2), size=(1.0, 1.0, 0.02)),
    "quadratic": lambda: on_paraboloid((5, 5, 4), kind="hex20"),
}


@pytest.mark.slow
@pytest.mark.usefixtures("by_iteration")
@needs_pyamg
@pytest.mark.parametrize("name", CASES)
def test_the_answer_is_that_of_the_factorising_way(name):
    problem = fresh(CASES[name]())
    solution, reference = cq.solve(problem), factorised(problem)
    certificate = solution.certificate
    assert certificate.passed
    assert not certificate.proven, "an estimate is no proof"
    assert any("estimates" in note for note in certificate.notes)
    assert certificate.equilibrium <= 1e-9
    push = np.max(reference.normal_force)
    assert np.max(abs(solution.normal_force - reference.normal_force)) <= 1e-6 * push
    assert np.max(abs(solution.displacement - reference.displacement)) <= 1e-7 * np.max(abs(reference.displacement))
    assert solution.tie_force == pytest.approx(reference.tie_force, rel=1e-6, abs=1e-6 * push)
    assert solution.contact_status.tolist() == reference.contact_status.tolist()
    assert solution.work.solver == "pyamg"
    assert 0 < solution.work.krylov_iterations <= 150
    assert solution.work.factorisations == solution.work.back_substitutions == 0


@pytest.mark.slow
@pytest.mark.usefixtures("by_iteration")
@needs_pyamg
def test_contacts_that_come_twice_share_their_force_in_some_way():
    problem = on_paraboloid()
    solution, reference = cq.solve(twice(problem)), factorised(problem)
    assert solution.certificate.passed
    together = solution.normal_force.reshape(2, -1).sum(axis=0)
    assert together == pytest.approx(reference.normal_force, rel=1e-6, abs=1e-7 * np.max(together))


@pytest.mark.slow
@pytest.mark.usefixtures("by_iteration")
@needs_pyamg
def test_a_body_without_contact_is_one_linear_system():
    problem = on_paraboloid(press=-0.02)
    solution = cq.solve(problem.replace(normal=np.zeros((0, problem.dimension)), gap=[], contact_names=[]))
    assert solution.certificate.passed
    assert problem.stiffness @ solution.displacement == pytest.approx(problem.load, abs=1e-8 * max(abs(problem.load)))
    parted = cq.solve(problem)
    assert parted.certificate.passed
    assert not np.any(parted.normal_force)
    assert cq.solve(problem.replace(load=np.zeros(problem.dimension))).certificate.passed


@pytest.mark.slow
@pytest.mark.usefixtures("by_iteration")
@needs_pyamg
def test_early_systems_are_not_solved_to_the_end(monkeypatch):
    problem = on_paraboloid((16, 16, 12))
    taken = {}
    for trust in (inexact_active_set.TRUST, 1e-3):
        monkeypatch.setattr(inexact_active_set, "TRUST", trust)
        taken[trust] = cq.solve(fresh(problem)).work.krylov_iterations
    rough, exact = taken.values()
    rough, exact = rough - ENOUGH_STEPS, exact - ENOUGH_STEPS  # the certificate's own
    assert rough <= 20
    assert exact >= 1.3 * rough


@pytest.mark.slow
@pytest.mark.usefixtures("by_iteration")
@needs_pyamg
def test_sets_that_come_back_are_solved_more_accurately(monkeypatch):
    """With blind trust every step changes the set by forces that mean nothing yet: it still ends, with the answer."""
    problem = on_paraboloid((12, 12, 9))
    wise = cq.solve(problem)
    monkeypatch.setattr(inexact_active_set, "TRUST", 1e6)
    blind = cq.solve(fresh(problem))
    assert blind.certificate.passed
    assert blind.work.iterations > wise.work.iterations
    assert blind.normal_force == pytest.approx(wise.normal_force, abs=1e-7 * np.max(wise.normal_force))


@pytest.mark.slow
@pytest.mark.usefixtures("by_iteration")
@needs_pyamg
def test_a_known_solution_is_a_place_to_start_from():
    problem = on_paraboloid((14, 14, 10))
    first = cq.solve(problem)
    again = cq.solve(problem.replace(load=problem.load * (1 + 1e-6)), warm_start=first)
    assert again.certificate.passed
    assert again.work.krylov_iterations < 0.8 * first.work.krylov_iterations
    assert again.work.iterations == 1


@pytest.mark.usefixtures("by_iteration")
@needs_pyamg
def test_an_unknown_without_stiffness_is_refused_in_words():
    held = on_paraboloid((6, 6, 4))
    bare = sp.block_diag([held.stiffness, sp.csr_array((1, 1))])
    with pytest.raises(cq.Unsupported, match=f"unknown {held.dimension} has no stiffness"):
        cq.solve(cq.ContactProblem(stiffness=bare, load=np.zeros(held.dimension + 1), normal=[], gap=[]))


@pytest.mark.usefixtures("by_iteration")
@needs_pyamg
def test_who_stops_too_early_says_so_and_hands_over_what_there_is(monkeypatch):
    with pytest.raises(cq.NotConverged, match=r"no contact set was found; \d+ contacts disagree") as caught:
        cq.solve(on_paraboloid((12, 12, 8)), max_iter=1)
    assert caught.value.solution is not None
    assert not caught.value.solution.certificate.passed
    assert caught.value.history
    with pytest.raises(cq.NotConverged, match="before the hierarchy of the stiffness was built"):
        cq.solve(on_paraboloid(), time_limit=1e-9)
    problem = on_paraboloid()
    iteration(problem)
    with pytest.raises(cq.NotConverged, match="the time limit is reached"):
        cq.solve(problem, time_limit=1e-9)
    monkeypatch.setattr(inexact_active_set, "STEPS", 3)
    with pytest.raises(cq.NotConverged, match="did not converge in 3 steps"):
        cq.solve(on_paraboloid())


@pytest.mark.usefixtures("by_iteration")
@needs_pyamg
def test_constraints_that_conflict_are_no_answer():
    problem = on_paraboloid((6, 6, 4))
    wall = problem.normal[[0]]
    walls, gap = sp.vstack([problem.normal, -wall]), np.append(problem.gap, -1.0)
    conflict = problem.replace(normal=walls, gap=gap, contact_names=None)
    with pytest.raises((cq.NotConverged, cq.NotCertified)):
        cq.solve(conflict)


@pytest.mark.usefixtures("by_iteration")
@needs_pyamg
def test_other_methods_and_condensing_are_refused_in_words():
    problem = on_paraboloid((4, 4, 3))
    with pytest.raises(cq.Unsupported, match="osqp: a body this large is not factorised"):
        cq.solve(problem, "osqp")
    with pytest.raises(cq.Unsupported, match="condensing a body this large means factorising it"):
        cq.solve(problem, condense=True)


@pytest.mark.usefixtures("by_iteration")
def test_without_pyamg_the_pip_command_is_named(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *rest: None if name == "pyamg" else find(name, *rest))
    with pytest.raises(cq.BackendMissing, match="pip install pyamg"):
        cq.solve(on_paraboloid((4, 4, 3)))


@pytest.mark.usefixtures("by_iteration")
@needs_pyamg
def test_a_pyamg_that_cannot_be_imported_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyamg.aggregation", None)
    with pytest.raises(cq.BackendMissing, match=r"pyamg: import of pyamg.aggregation.*pip install --upgrade"):
        cq.solve(on_paraboloid((4, 4, 3)))


def test_what_is_iterated_on_is_large_and_in_space_unless_somebody_chooses(monkeypatch):
    problem = on_paraboloid()
    monkeypatch.delenv(SOLVER_VARIABLE, raising=False)
    assert not iterated(problem)
    monkeypatch.setattr("contactqp.linalg.iteration.MOST_OPERATIONS", 0.0)
    assert iterated(problem) == multigrid.available()
    monkeypatch.setattr("contactqp.linalg.iteration.COUPLED", 100)
    assert not iterated(problem)
    for choice in ("superlu", "pardiso", "pyamg"):
        monkeypatch.setenv(SOLVER_VARIABLE, choice)
        assert iterated(problem) == (choice == "pyamg")


@pytest.mark.slow
@needs_pyamg
def test_the_way_follows_the_predicted_cost_of_factors_and_not_the_number_of_unknowns(monkeypatch):
    """A bar is eliminated from one end to the other, for a part of what a cube of as many unknowns takes."""
    bar, cube = on_paraboloid((80, 3, 3), size=(80.0, 3.0, 3.0)), on_paraboloid((10, 10, 8))
    assert bar.dimension > cube.dimension
    monkeypatch.delenv(SOLVER_VARIABLE, raising=False)
    monkeypatch.setattr("contactqp.linalg.iteration.MOST_OPERATIONS", 2e8)
    assert not iterated(bar)
    assert iterated(cube)
    monkeypatch.setattr("contactqp.linalg.iteration.MOST_OPERATIONS", 1e7)
    assert iterated(fresh(bar))


@needs_pyamg
def test_factors_that_do_not_fit_into_the_free_memory_are_not_made(monkeypatch):
    monkeypatch.delenv(SOLVER_VARIABLE, raising=False)
    monkeypatch.setattr("contactqp.linalg.iteration.LITTLE_MEMORY", 0.0)
    free = 50_000_000
    monkeypatch.setattr("contactqp.linalg.iteration.free_memory", lambda: free)
    problem = on_paraboloid()
    assert not iterated(problem)
    free = 100_000
    assert iterated(problem)


def test_levels_of_a_search_are_those_of_the_graph():
    chain = sp.diags([1.0, 2.0, 1.0], [-1, 0, 1], shape=(50, 50), format="csr")
    order = np.random.default_rng(2).permutation(50)
    assert widest_level(chain[order][:, order]) == 1
    beside = sp.diags([1.0, 1.0], [-1, 1], shape=(4, 4))
    grid = sp.csr_matrix(sp.kron(sp.identity(4), chain) + sp.kron(beside, sp.identity(50)))
    assert widest_level(grid) == 4
    assert widest_level(sp.csr_matrix(sp.block_diag([chain, chain]))) is None


@pytest.mark.slow
@pytest.mark.usefixtures("by_iteration")
@needs_pyamg
def test_a_soft_layer_that_hides_the_contacts_is_no_silent_error(monkeypatch):
    """Next to nothing of the energy is above the layer: the solver misses every contact, and its certificate says so,
    as does one that has seen nothing of the solver's runs."""
    problem = layered(1e-10)
    with pytest.raises(cq.NotCertified) as caught:
        cq.solve(problem)
    found = caught.value.solution
    assert not np.any(found.normal_force)
    for twin in (problem, fresh(problem)):
        certificate = cq.certify(twin, found.displacement, found.normal_force)
        assert not certificate.passed
        assert certificate.energy_error == pytest.approx(found.certificate.energy_error, rel=1e-4)
    monkeypatch.setenv(SOLVER_VARIABLE, "superlu")
    assert np.all(cq.solve(fresh(problem)).normal_force > 0)


@pytest.mark.usefixtures("by_iteration")
@needs_pyamg
@pytest.mark.parametrize("factor", [0.0, 1e-12])
def test_unloading_starts_from_rest(factor):
    problem = on_sphere((5, 5, 4)).replace(gap=np.full(36, 0.1))
    loaded = cq.solve(problem)
    unloaded = cq.solve(problem.replace(load=factor * problem.load), warm_start=loaded)
    assert unloaded.certificate.passed
    assert np.max(abs(unloaded.displacement)) <= 2 * factor * np.max(abs(loaded.displacement))


@pytest.mark.sampled(2)
@pytest.mark.usefixtures("by_iteration")
@needs_pyamg
@pytest.mark.parametrize("factor", [1e-200, 1e200])
def test_the_size_of_the_near_null_space_means_nothing(factor):
    problem = on_paraboloid((6, 6, 4))
    hinted = problem.replace(near_null_space=factor * problem.near_null_space)
    assert cq.solve(hinted).work.krylov_iterations == cq.solve(problem).work.krylov_iterations


@pytest.mark.usefixtures("by_iteration")
@needs_pyamg
def test_a_loose_tolerance_is_no_loose_certificate():
    assert cq.solve(on_paraboloid((6, 6, 4)), tolerance=1e-3).certificate.passed


def test_the_work_names_the_solver(monkeypatch):
    monkeypatch.setenv(SOLVER_VARIABLE, "superlu")
    assert cq.solve(on_paraboloid((6, 6, 4))).work.solver == "superlu"
    tiny = cq.ContactProblem(stiffness=[[2.0]], load=[1.0], normal=[[1.0]], gap=[0.1])
    assert cq.solve(tiny).work.solver == "dense"


@pytest.mark.usefixtures("by_iteration")
@needs_pyamg
def test_problems_with_the_same_stiffness_share_the_hierarchy():
    problem = on_paraboloid()
    cq.solve(problem)
    assert iteration(problem.replace(load=2 * problem.load)) is iteration(problem)
    assert iteration(problem.replace(near_null_space=None)) is not iteration(problem)


def test_the_hint_is_checked_and_kept():
    problem = on_paraboloid((3, 3, 2))
    n = problem.dimension
    assert problem.near_null_space.shape == (n, 6)
    assert problem.replace(load=np.zeros(n)).near_null_space is problem.near_null_space
    assert problem.replace(gap=problem.gap, stiffness=2 * problem.stiffness).near_null_space.shape == (n, 6)
    with pytest.raises(cq.InvalidProblem, match=rf"near_null_space: expected shape \({n}, q\).*got \(2, 6\)"):
        problem.replace(near_null_space=np.ones((2, 6)))
    with pytest.raises(cq.InvalidProblem, match="near_null_space: expected finite numbers"):
        problem.replace(near_null_space=np.full((n, 1), np.nan))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("bed", [1e2, 1e5, 1e8])
def test_contacts_where_nothing_arrives_hold_up_no_set(monkeypatch: pytest.MonkeyPatch, bed: float) -> None:
    """Half of the nodes stand on stiff springs: at the far side forces are 1e-20 and less, and their signs rounding."""
    monkeypatch.setenv("CONTACTQP_SPARSE_SOLVER", "pyamg")
    n, rng = 30, np.random.default_rng(0)
    chain = sp.diags([np.full(n, 2.0), np.full(n - 1, -1.0), np.full(n - 1, -1.0)], [0, 1, -1])
    springs = np.zeros(n * n)
    springs[n * n // 2 :] = bed
    K = sp.csr_matrix(sp.kron(sp.identity(n), chain) + sp.kron(chain, sp.identity(n)) + sp.diags(springs))
    load = np.zeros(n * n)
    load[:n] = rng.uniform(0.0, 10.0, n)
    near_and_far = np.r_[:n, n * n - n : n * n]
    rows = sp.csr_matrix((rng.choice([-1.0, 1.0], 2 * n), (np.arange(2 * n), near_and_far)), shape=(2 * n, n * n))
    problem = cq.ContactProblem(K, load, rows, np.where(rng.random(2 * n) < 0.5, 0.0, rng.uniform(0.0, 3.0, 2 * n)))
    solution = cq.solve(problem)
    assert solution.certificate.passed
    monkeypatch.setenv("CONTACTQP_SPARSE_SOLVER", "superlu")
    exact = cq.solve(problem.replace(load=load))
    assert solution.normal_force == pytest.approx(exact.normal_force, rel=1e-6, abs=1e-6)


@pytest.mark.slow
@needs_pyamg
def test_sets_that_grow_and_shrink_in_turn_are_left_to_another_method(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a membrane they turn a few times, which is no reason to give up; where one turn is, nothing is identified."""
    side, h = 50, 1.0 / 51
    chain, one = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(side, side)), sp.identity(side)
    K, n = sp.csr_matrix(sp.kron(one, chain) + sp.kron(chain, one)), side * side
    problem = cq.ContactProblem(K, np.full(n, h * h), sp.identity(n, format="csr"), np.full(n, 0.0165))
    settings = Settings(1e-9)
    found = inexact_active_set.identified_by_iteration(problem, iteration(problem), settings)
    assert found is not None
    assert found.claimed
    assert found.iterations > 9
    monkeypatch.setattr(inexact_active_set, "TURNS", 1)
    monkeypatch.setattr(inexact_active_set, "OFTEN", 0.0)
    assert inexact_active_set.identified_by_iteration(problem, iteration(problem), settings) is None
