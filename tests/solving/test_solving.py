"""solve(): exact answers, floating bodies, ties, redundant and grazing contacts, and honest refusals."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import example, given, settings
from hypothesis import strategies as st

import contactqp as cq
from contactqp.model.solution import Answer
from contactqp.solving.methods import Method
from tests.examples import (
    CANTILEVER_FORCE,
    TRUSS_CONTACT_STIFFNESS,
    TRUSS_DISPLACEMENT,
    TRUSS_FORCE,
    block_between,
    cantilever,
    seeded_problem,
    truss,
    two_bars,
)

EXACT = [method.name for method in cq.methods() if method.exact and method.installed]
POLISHED = [method.name for method in cq.methods() if method.polish and method.installed]
CONDENSE = [True, False, "auto"]


@pytest.mark.sampled(16)
@pytest.mark.parametrize("condense", CONDENSE)
@pytest.mark.parametrize("method", EXACT)
def test_exact_methods_give_the_exact_answer(method: str, condense: bool | str) -> None:
    solution = cq.solve(truss(), method, condense=condense)
    assert solution.normal_force == pytest.approx([TRUSS_FORCE], rel=1e-12)
    assert solution.displacement == pytest.approx(TRUSS_DISPLACEMENT, rel=1e-12)
    assert solution.certificate.passed
    assert solution.certificate.proven
    assert solution.method == method
    bars = cq.solve(two_bars(), method, condense=condense)
    assert bars.normal_force == pytest.approx([95.0], rel=1e-12)
    assert bars.displacement == pytest.approx([41 / 31500, 19 / 63000], rel=1e-12)


@pytest.mark.sampled(8)
@pytest.mark.parametrize("condense", CONDENSE)
@pytest.mark.parametrize("beta", [1e3, 1e4, 1e5, 1e6, 1e7, 1e8])
def test_penalty_and_perturbed_lagrangian_give_the_penalised_answer(beta: float, condense: bool | str) -> None:
    exact = TRUSS_FORCE * beta / (beta + TRUSS_CONTACT_STIFFNESS)
    soft = cq.solve(truss(), "penalty", penalty=beta, condense=condense)
    twin = cq.solve(truss(), "perturbed-lagrangian", perturbation=beta, condense=condense)
    assert soft.normal_force == pytest.approx([exact], rel=1e-10)
    assert twin.normal_force == pytest.approx([exact], rel=1e-10)
    assert not soft.certificate.passed
    assert soft.certificate.force_error == pytest.approx(1 - exact / TRUSS_FORCE, rel=1e-6)


@pytest.mark.parametrize("condense", CONDENSE)
def test_the_last_row_of_table_2_1_is_one_unit_in_the_last_place_of_the_gap(condense: bool | str) -> None:
    """beta = 1e20: the printed 21.684 kN is beta times the spacing of doubles at 1 mm; the certificate refuses it."""
    solution = cq.solve(truss(), "penalty", penalty=1e20, condense=condense)
    assert solution.normal_force == pytest.approx([1e20 * np.spacing(1e-3)], rel=1e-12)
    assert round(float(solution.normal_force[0]), 3) == 21.684
    assert not solution.certificate.passed
    assert solution.certificate.force_error == pytest.approx(1 - 21.684043449710089 / TRUSS_FORCE, rel=1e-6)
    multiplier = cq.solve(truss(), "perturbed-lagrangian", perturbation=1e20, condense=condense)
    assert multiplier.normal_force == pytest.approx([30.2550], abs=5e-5)


@pytest.mark.parametrize("beta", [0.0, 1.0, 1e3, 1e5, 1e8])
def test_augmented_lagrangian_is_exact_for_every_penalty(beta: float) -> None:
    solution = cq.solve(two_bars(), "augmented-lagrangian", penalty=beta)
    assert solution.normal_force == pytest.approx([95.0], rel=1e-12)


def test_an_open_contact_has_no_force() -> None:
    for method in EXACT:
        solution = cq.solve(two_bars(100.0), method)
        assert solution.normal_force == pytest.approx([0.0], abs=1e-12), method
        assert list(solution.contact_status) == ["open"]


def test_a_beam_on_a_stop() -> None:
    solution = cq.solve(cantilever())
    assert solution.normal_force == pytest.approx([CANTILEVER_FORCE], rel=1e-6)
    assert solution.work.retained == 1
    assert solution.work.factorisations == 1


@pytest.mark.sampled(8)
@pytest.mark.parametrize("method", POLISHED)
def test_bodies_held_by_contact_alone(method: str) -> None:
    if not _method(method).semidefinite:
        with pytest.raises(cq.Unsupported, match="contact alone"):
            cq.solve(block_between(), method)
        return
    for contrast in (1.0, 1e6):
        problem = block_between(contrast=contrast, seed=5)
        solution = cq.solve(problem, method)
        assert solution.certificate.proven
        assert solution.normal_force.sum() == pytest.approx(-problem.load.sum(), rel=1e-10)


def _method(name: str) -> Method:
    return next(method for method in cq.methods() if method.name == name)


def test_a_motion_that_nothing_drives_is_left_at_rest_and_listed() -> None:
    problem = block_between(seed=2)
    solution = cq.solve(problem)
    assert len(solution.free_motions) == 1
    motion = solution.free_motions[0]
    sideways = np.tile([1.0, 0.0], problem.dimension // 2)
    assert abs(motion.direction) == pytest.approx(sideways, abs=1e-9)
    assert solution.displacement @ sideways == pytest.approx(0.0, abs=1e-12)
    assert "unknown 0" in str(motion)


def test_least_displacement_does_not_penetrate() -> None:
    """Two loose masses without load, the first in overlap with a wall: it is pushed out, and nothing else moves."""
    problem = cq.ContactProblem(stiffness=np.zeros((2, 2)), load=[0.0, 0.0], normal=[[1.0, 0.0]], gap=[-0.25])
    solution = cq.solve(problem)
    assert solution.displacement == pytest.approx([-0.25, 0.0], abs=1e-15)
    assert solution.normal_force == pytest.approx([0.0])
    assert len(solution.free_motions) == 2


def test_a_point_mass_on_two_walls_shares_its_load() -> None:
    problem = cq.ContactProblem(
        stiffness=np.zeros((2, 2)), load=[0.0, -10.0], normal=[[-1.0, -1.0], [1.0, -1.0]], gap=[0.0, 0.0]
    )
    assert cq.solve(problem).normal_force == pytest.approx([5.0, 5.0], rel=1e-12)


def test_driven_motions_are_refused_in_words() -> None:
    names = ["left.x", "right.x"]
    K = np.array([[1.0, -1.0], [-1.0, 1.0]])
    problem = cq.ContactProblem(stiffness=K, load=[0.0, -1.0], normal=[[1.0, 0.0]], gap=[0.0], dof_names=names)
    for method in EXACT:
        with pytest.raises(cq.NoEquilibrium, match=r"left\.x by -1, right\.x by -1"):
            cq.solve(problem, method)


@pytest.mark.sampled(5)
@pytest.mark.parametrize("method", EXACT)
def test_conflicting_constraints_are_named(method: str) -> None:
    names = ["left wall", "far away", "right wall"]
    problem = cq.ContactProblem(
        stiffness=np.eye(2), load=[0.0, 0.0], normal=[[-1.0, 0.0], [0.0, 1.0], [1.0, 0.0]], gap=[-1.0, 5.0, 0.5],
        contact_names=names,
    )  # fmt: skip
    with pytest.raises(cq.NoEquilibrium) as caught:
        cq.solve(problem, method)
    assert "left wall" in str(caught.value)
    assert "right wall" in str(caught.value)
    assert "far away" not in str(caught.value)


def test_a_tie_against_a_wall_conflicts() -> None:
    problem = cq.ContactProblem(
        stiffness=np.eye(1), load=[0.0], normal=[[1.0]], gap=[0.5], tie=[[1.0]], tie_value=[1.0], contact_names=["wall"]
    )
    with pytest.raises(cq.NoEquilibrium, match=r"wall.*tie 0|tie 0.*wall"):
        cq.solve(problem)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", EXACT)
def test_ties_have_forces_with_the_sign_of_equilibrium(method: str) -> None:
    tied = cq.ContactProblem(
        stiffness=np.eye(2), load=[1.0, 0.0], normal=[[1.0, 0.0]], gap=[0.25], tie=[[1.0, -1.0]], tie_value=[0.125]
    )
    solution = cq.solve(tied, method)
    # u = (1/4, 1/8): -1/8 in the second unknown is the tie's, the rest of the load the wall's.
    assert solution.displacement == pytest.approx([0.25, 0.125], rel=1e-12)
    assert solution.tie_force == pytest.approx([0.125], rel=1e-12)
    assert solution.normal_force == pytest.approx([0.625], rel=1e-12)


def test_redundant_ties_are_legal() -> None:
    tied = cq.ContactProblem(
        stiffness=np.eye(2), load=[1.0, 0.0], normal=np.zeros((0, 2)), gap=[], tie=[[1.0, -1.0], [2.0, -2.0]]
    )
    solution = cq.solve(tied)
    assert solution.displacement == pytest.approx([0.5, 0.5])
    assert solution.certificate.passed


@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", [m for m in POLISHED if m != "projected-gauss-seidel"])
def test_more_contacts_than_unknowns(method: str) -> None:
    angles = np.linspace(-1.2, 1.2, 25)
    normal = -np.column_stack([np.sin(angles), np.cos(angles)])
    problem = cq.ContactProblem(stiffness=np.diag([3.0, 5.0]), load=[1.0, -20.0], normal=normal, gap=np.full(25, 0.1))
    solution = cq.solve(problem, method)
    assert solution.certificate.proven
    assert np.all(solution.gap > -1e-15)


def test_a_half_converged_backend_is_refused_with_its_iterate() -> None:
    with pytest.raises((cq.NotConverged, cq.NotCertified)) as caught:
        cq.solve(truss(), "osqp", polish=False, tolerance=1e-12, max_iter=1)
    assert caught.value.solution is not None
    assert not caught.value.solution.certificate.passed


def test_the_raw_answer_is_kept_beside_the_polished_one() -> None:
    solution = cq.solve(truss(), "clarabel", tolerance=1e-3)
    assert solution.raw is not None
    assert solution.raw.certificate.force_error is not None
    assert solution.certificate.force_error is not None
    assert solution.raw.certificate.force_error > solution.certificate.force_error
    assert cq.solve(truss()).raw is None


def test_the_raw_answer_is_judged_when_it_is_asked_for_and_travels_with_what_judges_it() -> None:
    """A certificate of the raw answer costs as much as that of the answer, and most people never look at it."""
    raw = cq.solve(truss(), "clarabel", tolerance=1e-3).raw
    assert raw is not None
    assert "certificate" not in vars(raw)
    copied = pickle.loads(pickle.dumps(raw))
    assert copied.certificate.force_error == raw.certificate.force_error
    assert not raw.certificate.passed


def test_the_raw_answer_of_a_problem_with_idle_rows_has_a_force_for_every_row() -> None:
    known = truss()
    normal = sp.vstack([known.normal, np.zeros((1, known.dimension))])
    problem = cq.ContactProblem(known.stiffness, known.load, normal, np.append(known.gap, 1.0))
    raw = cq.solve(problem, "clarabel", tolerance=1e-3).raw
    assert raw is not None
    assert raw.normal_force.shape == (problem.contacts,)
    again = cq.certify(problem, raw.displacement, raw.normal_force)
    assert raw.certificate.force_error == again.force_error
    assert raw.certificate.failures == again.failures


def test_unknown_names_and_options_are_refused() -> None:
    with pytest.raises(cq.Unsupported, match="active-set"):
        cq.solve(truss(), "activeset")
    with pytest.raises(cq.InvalidProblem, match=r"^penalty has no default"):
        cq.solve(truss(), "penalty")
    with pytest.raises(cq.InvalidProblem, match=r"^penalty: expected a positive finite number, got -1"):
        cq.solve(truss(), "penalty", penalty=-1)
    with pytest.raises(cq.InvalidProblem, match=r"^penalty: expected a positive finite number; expected real numbers"):
        cq.solve(truss(), "penalty", penalty="soft")
    with pytest.raises(cq.InvalidProblem, match="unknown option"):
        cq.solve(truss(), "osqp", penalty=1.0)
    with pytest.raises(cq.InvalidProblem, match="condense"):
        cq.solve(truss(), condense="maybe")
    with pytest.raises(cq.InvalidProblem, match="tolerance"):
        cq.solve(truss(), tolerance=-1.0)
    with pytest.raises(cq.Unsupported, match="friction"):
        cq.solve(truss(), algorithm="tresca")
    missing = [method.name for method in cq.methods() if not method.installed]
    for name in missing:
        with pytest.raises(cq.BackendMissing, match="pip install"):
            cq.solve(truss(), name)


def test_a_method_that_lies_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    from contactqp.model.solution import Candidate
    from contactqp.solving import methods
    from contactqp.solving.methods import Settings

    def lie(problem: cq.ContactProblem, _: Settings) -> Candidate:
        return Candidate(Answer(np.zeros(problem.dimension), np.zeros(problem.contacts), None, np.zeros(problem.ties)))

    monkeypatch.setitem(methods._REGISTRY, "liar", Method(name="liar", kind="test", solve=lie))
    with pytest.raises(cq.NotCertified, match="refuses"):
        cq.solve(truss(), "liar")


def test_frictionless_tangential_rows_are_carried() -> None:
    solution = cq.solve(truss(tangent=[[1.0, 0.0]], friction=0.0))
    assert solution.friction_force is not None
    assert solution.friction_force.shape == (1, 1)
    assert solution.slip is not None
    assert solution.slip[0, 0] == pytest.approx(TRUSS_DISPLACEMENT[0])


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 10_000), rigid=st.integers(0, 3))
@example(seed=2006, rigid=3)  # products of rounded factors: energies of rigid motions near an eps of their sizes
@example(seed=3168, rigid=3)
def test_random_problems_are_solved_and_proven(seed: int, rigid: int) -> None:
    solution = cq.solve(seeded_problem(seed, n=10, m=8, rigid=rigid))
    assert solution.certificate.passed
    assert solution.certificate.proven


@pytest.mark.slow
@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 10_000), power=st.integers(0, 12))
def test_a_warm_start_changes_nothing_but_the_work(seed: int, power: int) -> None:
    problem = block_between(contrast=10.0**power, seed=seed)
    cold = cq.solve(problem)
    warm = cq.solve(problem, warm_start=cold)
    assert warm.displacement == pytest.approx(cold.displacement, rel=1e-12)
    with pytest.raises(cq.InvalidProblem, match="warm_start"):
        cq.solve(truss(), warm_start=cold)


def test_a_thousand_unknowns_by_superlu() -> None:
    n = 1500
    K = sp.diags([np.full(n, 2.0), -np.ones(n - 1), -np.ones(n - 1)], [0, 1, -1]).tocsc()
    E = sp.identity(n).tocsr()[::100]
    problem = cq.ContactProblem(stiffness=K, load=np.full(n, 1e-4), normal=E, gap=np.full(E.shape[0], 1.0))
    solution = cq.solve(problem)
    assert solution.certificate.proven
    assert solution.work.retained == E.shape[0]
    full = cq.solve(problem, "clarabel", condense=False)
    assert full.work.retained == n
    sparse = cq.solve(problem, condense=False)
    assert sparse.work.retained == n
    assert sparse.normal_force == pytest.approx(solution.normal_force, rel=1e-12, abs=1e-14)
    assert full.normal_force == pytest.approx(solution.normal_force, rel=1e-10, abs=1e-12)


def test_data_of_the_problem_given_to_solve_are_named_as_that() -> None:
    with pytest.raises(cq.InvalidProblem, match=r"'friction' \(it belongs to the problem: solve\(problem.replace\("):
        cq.solve(truss(), friction=0)
    with pytest.raises(cq.InvalidProblem, match=r"or inf where a contact never closes, got -inf at \[0\]"):
        truss().replace(gap=[-np.inf])
