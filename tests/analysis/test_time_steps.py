"""The parts of a time step: mass matrices, contact forces with Coulomb friction, certificates of many steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.linalg import block_diag

import contactqp as cq
from contactqp.analysis.motion import mass_matrix, step_contact
from contactqp.analysis.motion.step_contact import StepProblem, StepResult, frictional_forces, states_of
from contactqp.analysis.motion.time_stepping import FIGURES, StepJudge
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK
from tests.analysis.motions import rod_at_wall


@pytest.mark.parametrize("lumped", [True, False])
def test_a_rod_keeps_its_mass(lumped: bool) -> None:
    problem, mass = rod_at_wall(10, lumped=lumped)
    moved = cq.redistributed_mass(mass, problem)
    assert moved.sum() == pytest.approx(mass.sum(), rel=1e-14)
    assert abs(moved[0]).sum() == 0.0
    assert abs(moved - mass)[3:, 3:].sum() == 0.0  # what is far from the contact stays


def test_a_plane_body_keeps_mass_centre_and_inertia() -> None:
    """A frame of springs in the plane: three rigid motions, and z'Mz of all of them as before."""
    rng = np.random.default_rng(3)
    points = np.array([[x, y] for x in range(5) for y in range(4)], float) + 0.1 * rng.normal(size=(20, 2))
    K = np.zeros((40, 40))
    for a in range(20):
        for b in range(a):
            way = points[a] - points[b]
            if np.linalg.norm(way) < 1.8:
                row = np.zeros(40)
                row[[2 * a, 2 * a + 1]], row[[2 * b, 2 * b + 1]] = way, -way
                K += np.outer(row, row)
    M = np.diag(np.repeat(rng.uniform(1.0, 2.0, 20), 2))
    normal = np.zeros((2, 40))
    normal[0, [0, 1]], normal[1, 9] = [0.6, 0.8], -1.0
    problem = cq.ContactProblem(K, np.zeros(40), normal, [1.0, 1.0])
    moved = cq.redistributed_mass(M, problem)
    turn = np.column_stack([-points[:, 1], points[:, 0]]).ravel()
    Z = np.column_stack([np.tile([1.0, 0], 20), np.tile([0, 1.0], 20), turn])
    np.testing.assert_allclose(Z.T @ moved @ Z, Z.T @ M @ Z, rtol=1e-9, atol=1e-9 * np.trace(M))
    assert abs(moved.toarray()[[0, 1, 9]]).sum() == 0.0
    assert np.linalg.eigvalsh(np.delete(np.delete(moved.toarray(), [0, 1, 9], 0), [0, 1, 9], 1))[0] > 0.0


def test_each_body_keeps_its_own_and_a_held_one_too() -> None:
    free, M = rod_at_wall(6)
    K = free.stiffness.toarray()
    held = K[1:, 1:]  # its first node is a support
    both, masses = block_diag(K, held), sp.block_diag([M, M.toarray()[1:, 1:]])
    rows = np.zeros((1, 13))
    rows[0, [6, 12]] = 1.0, -1.0
    problem = cq.ContactProblem(both, np.zeros(13), rows, [1.0])
    moved = cq.redistributed_mass(masses, problem).toarray()
    assert moved[:7, :7].sum() == pytest.approx(M.sum())
    assert moved[7:, 7:].sum() == pytest.approx(M.toarray()[1:, 1:].sum())
    assert abs(moved[[6, 12]]).sum() == 0.0


@pytest.mark.parametrize("turned", [0.0, 0.5])
def test_moved_mass_has_no_units_and_no_axes(turned: float) -> None:
    """A clamped beam of two elements with a mass at its middle and tip, which meets a stop: deflection and rotation.

    Mass that went to rotations made the answer depend on the unit of length. That of the tip follows the middle along a
    straight line, its slope there: w_tip = w + h theta, where the middle's rotation has no mass and is in balance.
    """
    bending = np.array([[24.0, 0, -12, 6], [0, 8, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]])  # w, theta of both; h = 1
    K, M, stop = np.zeros((6, 6)), np.diag([2.0, 2.0, 0.0, 2.0, 2.0, 0.0]), np.zeros((1, 6))
    K[np.ix_([1, 2, 4, 5], [1, 2, 4, 5])] = bending
    K[np.ix_([0, 3], [0, 3])] = [[100.0, -50.0], [-50.0, 50.0]]
    stop[0, 4] = -1.0
    c, s = np.cos(turned), np.sin(turned)
    turn = np.kron(np.eye(2), [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    expected = np.zeros((6, 6))
    follows = np.linalg.solve(bending[1:, 1:], -bending[1:, 0])[1]
    expected[0, 0], expected[1, 1] = 2.0 + 2.0 * (turned > 0), 2.0 + 2.0 * follows**2
    expected[3, 3] = 0.0 if turned else 2.0
    for unit in (1.0, 1e3, 1e-3):
        D = np.diag([unit, unit, 1.0] * 2)  # lengths of another unit
        across = turn @ D
        problem = cq.ContactProblem(across.T @ K @ across, np.zeros(6), stop @ across, [1.0])
        moved = cq.redistributed_mass(across.T @ M @ across, problem).toarray()
        np.testing.assert_allclose(np.linalg.inv(across).T @ moved @ np.linalg.inv(across), expected, atol=1e-12)


@pytest.mark.parametrize("turned", [0.0, 0.01, 0.6, np.pi / 2])
@pytest.mark.parametrize("friction", [None, 0.3])
def test_a_block_in_any_direction_keeps_its_mass(turned: float, friction: float | None) -> None:
    """With friction, and beside an axis by little, no neighbours along the side could keep the centre of mass."""
    turn = np.array([[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]])
    mesh = cq.rectangle(1.0, 1.0, (4, 4)).mapped(lambda points: points @ turn.T)
    structure = cq.Structure([cq.Body(mesh, cq.Material(1.0, 0.3, density=1.0), "plane-strain", name="block")])
    foot = cq.pair(structure.surface("block", "bottom"), cq.Plane([0.0, 0.0], turn @ [0.0, 1.0]))
    system = structure.assemble()
    problem, M, Z = system.problem(foot, friction=friction), system.mass(), structure.rigid_motions()
    for known in (problem, problem.replace(near_null_space=None)):
        moved = cq.redistributed_mass(M, known)
        np.testing.assert_allclose(Z.T @ moved @ Z, Z.T @ M @ Z, atol=1e-12)
        kept = moved.diagonal() > 0
        assert np.count_nonzero(~kept) == (5 if friction is None and turned == 0.0 else 10)
        assert np.linalg.eigvalsh(moved.toarray()[kept][:, kept])[0] > 0.0
        assert np.max(moved.diagonal()) < 4 * np.max(M.diagonal())


def test_many_contacts_of_a_held_body_leave_slight_compliances_out(monkeypatch: pytest.MonkeyPatch) -> None:
    body = cq.Body(cq.rectangle(1.0, 0.2, (40, 4)), cq.Material(1.0, 0.3, density=1.0), "plane-strain", name="strip")
    structure = cq.Structure([body])
    system = structure.assemble([cq.Support("strip", "top", axis) for axis in (0, 1)])
    foot = cq.pair(structure.surface("strip", "bottom"), cq.Plane([0.0, 0.0], [0.0, 1.0]))
    problem = system.problem(foot, friction=0.3).replace(near_null_space=None)
    whole = cq.redistributed_mass(system.mass(), problem)
    monkeypatch.setattr(mass_matrix, "MANY", 0)
    local, fall = cq.redistributed_mass(system.mass(), problem), np.tile([0.0, 1.0], problem.dimension // 2)
    assert local.nnz < whole.nnz
    assert fall @ local @ fall == pytest.approx(fall @ whole @ fall, rel=1e-2)
    assert np.linalg.eigvalsh(local.toarray())[0] > -1e-14


def test_mass_on_full_rows_moves_as_on_sparse_ones() -> None:
    """Whole numbers, so that T'MT has no rounding: 250 contacts whose shares reach 300 unknowns each."""
    rng = np.random.default_rng(5)
    heavy, carries = np.arange(0, 500, 2), np.arange(1, 701, 2)
    T = sp.lil_matrix((720, 720))
    T[carries, carries] = 1.0
    T[np.ix_(heavy, carries[:300])] = rng.integers(-8, 8, (250, 300))
    M = sp.diags([1.0 * rng.integers(1, 9, 719), 1.0 * rng.integers(20, 90, 720)], [1, 0], format="csr")
    M = sp.csr_matrix(M + M.T)
    moved = mass_matrix._moved(M, sp.csr_matrix(T), heavy)
    np.testing.assert_array_equal(moved.toarray(), T.toarray().T @ M.toarray() @ T.toarray())


def test_motions_of_a_large_held_body_are_not_searched_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """PARDISO's pivots say that it has none; SuperLU's factors of a body in space take ten times as long."""
    pytest.importorskip("pypardiso")
    body = cq.Body(cq.box((1.0, 1.0, 0.5), (10, 10, 6)), cq.Material(1.0, 0.3, density=1.0), "3d", name="block")
    structure = cq.Structure([body])
    held, foot = [cq.Support("block", "top", axis) for axis in range(3)], cq.Plane([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    system = structure.assemble(held)
    problem = system.problem(cq.pair(structure.surface("block", "bottom"), foot)).replace(near_null_space=None)
    found = cq.redistributed_mass(system.mass(), problem)
    monkeypatch.setattr(mass_matrix, "null_space", None)
    twin = problem.replace(stiffness=problem.stiffness)
    assert abs(cq.redistributed_mass(system.mass(), twin) - found).max() == 0.0
    assert mass_matrix._known_motions(twin).shape == (problem.dimension, 0)


def test_what_has_no_neighbours_left_is_refused() -> None:
    pair = cq.ContactProblem([[1.0, -1.0], [-1.0, 1.0]], [0, 0], np.eye(2), [1.0, 1.0])
    with pytest.raises(cq.InvalidProblem, match="cannot be moved to others of the same body"):
        cq.redistributed_mass([1.0, 1.0], pair)


ONE = np.array([[1.0, 0.5], [0.5, 2.0]])  # u_N, u_T of r_N, r_T


def still(m: int) -> np.ndarray:
    return np.full(m, OPEN, dtype=np.int8)


@pytest.mark.parametrize(
    ("free", "coefficient", "expected"),
    [
        ([1.0, 3.0], 0.5, (0.0, 0.0)),  # open
        ([-1.0, -0.5], 0.5, (1.0, 0.0)),  # r_N = 1 alone stops it
        ([-1.0, 2.0], 0.6, (1 / 0.7, 0.6 / 0.7)),  # slips on: u_N = r_N + r_T / 2 - 1 = 0, r_T = -0.6 r_N
        ([-1.0, -3.0], 0.5, (1 / 1.25, -0.5 / 1.25)),  # slips back
    ],
)
def test_one_contact_by_hand(
    free: list[float], coefficient: float, expected: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(step_contact, "solve", None)  # no local problem is needed
    normal, friction = frictional_forces(ONE, np.array(free), np.array([coefficient]), still(1), "active-set", {})
    np.testing.assert_allclose([normal[0], friction[0, 0]], expected, rtol=1e-14, atol=1e-15)


@pytest.mark.sampled(16)
@pytest.mark.parametrize("seed", range(40))
def test_states_find_what_the_algorithms_find(seed: int) -> None:
    rng = np.random.default_rng(seed)
    m = 3
    root = rng.normal(size=(2 * m, 8))
    W, c = root @ root.T / 8 + np.eye(2 * m), rng.normal(size=2 * m)
    coefficient = rng.choice([0.0, 0.1, 0.3], size=m)
    start = rng.integers(SLIP_BACK, STICK + 1, size=m).astype(np.int8)
    normal, friction = frictional_forces(W, c, coefficient, start, "active-set", {})
    local = cq.LocalProblem(delassus=W, offset=c, friction=coefficient, dimension=2)
    known = cq.solve(local)
    np.testing.assert_allclose(np.column_stack([normal, -friction]), known.force, atol=1e-10)
    assert cq.certify_local(local, np.column_stack([normal, -friction])).passed


def test_states_that_cycle_are_left_to_an_algorithm(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(step_contact, "MAX_STATE_CHANGES", 0)
    normal, friction = frictional_forces(ONE, np.array([-1.0, 2.0]), np.array([0.6]), still(1), "active-set", {})
    np.testing.assert_allclose([normal[0], friction[0, 0]], [1 / 0.7, 0.6 / 0.7], rtol=1e-12)


def test_contacts_that_say_the_same_are_left_to_an_algorithm() -> None:
    W = np.kron(np.ones((2, 2)), ONE)
    normal, friction = frictional_forces(
        W, np.array([-1.0, 2.0, -1.0, 2.0]), np.array([0.6, 0.6]), still(2), "active-set", {}
    )
    np.testing.assert_allclose([normal.sum(), friction.sum()], [1 / 0.7, 0.6 / 0.7], rtol=1e-9)


def test_steps_in_space_read_the_operator_of_their_contacts_once(monkeypatch: pytest.MonkeyPatch) -> None:
    # Read and scaled anew, and its critical friction sought again, it took two fifths of a step.
    block = dict(stiffness=1e3 * np.eye(3), load=[0.0, 0.0, -10.0], normal=[[0.0, 0.0, -1.0]], gap=[0.0])
    sliding = cq.ContactProblem(**block, tangent=np.eye(2, 3), friction=0.3)
    made: list[cq.LocalProblem] = []

    def counted(**data: object) -> cq.LocalProblem:
        made.append(cq.LocalProblem(**data))
        return made[-1]

    monkeypatch.setattr(step_contact, "LocalProblem", counted)
    history = cq.impact(
        sliding, mass=np.eye(3), displacement=[0.1, 0.0, 0.0], velocity=[1.0, 0.5, 0.0], duration=0.01, time_step=1e-3
    )
    assert (history.normal_forces[1:] > 0).all()
    assert len(made) == 1


def test_the_states_of_forces() -> None:
    found = states_of(
        np.array([0.0, 1, 1, 1, 1]), np.array([[0.0], [0.1], [0.5], [-0.5], [0.0]]), np.r_[0.5 * np.ones(4), 0]
    )
    assert found.tolist() == [OPEN, STICK, SLIP_ON, SLIP_BACK, SLIP_ON]


rng = np.random.default_rng(7)
ROOT = rng.normal(size=(6, 6))
PROBLEM = cq.ContactProblem(
    stiffness=ROOT @ ROOT.T + np.eye(6),
    load=np.zeros(6),
    normal=rng.normal(size=(2, 6)),
    gap=np.zeros(2),
    tangent=rng.normal(size=(4, 6)),
    friction=[0.3, 0.5],
    tie=rng.normal(size=(1, 6)),
)


def step(seed: int) -> tuple[StepProblem, StepResult]:
    rng = np.random.default_rng(seed)
    posed = StepProblem(rng.normal(size=6), rng.normal(size=2), None, rng.normal(size=4), rng.normal(size=1))
    x = rng.normal(size=6)
    return posed, StepResult(x, rng.normal(size=2), rng.normal(size=4), rng.normal(size=1), x)


@pytest.mark.slow
def test_the_figures_are_those_of_the_certificate() -> None:
    """Of answers that are wrong in every way: cone and slip are bounded from above, the others alike."""
    steps = [step(seed) for seed in range(20)]
    found = StepJudge(PROBLEM).figures([p for p, _ in steps], [a for _, a in steps])
    for k, (posed, answer) in enumerate(steps):
        problem = PROBLEM.replace(
            load=posed.load, gap=posed.gap, slip_origin=posed.slip_origin, tie_value=posed.tie_value
        )
        known = cq.certify(problem, answer.unknown, answer.normal, answer.friction, answer.tie)
        for name in FIGURES:
            mine, theirs = getattr(found, name)[k], getattr(known, name)
            if name in ("cone", "slip_direction"):
                assert theirs * (1 - 1e-9) <= mine <= 5 * theirs + 1e-12, name
            else:
                assert mine == pytest.approx(theirs, rel=1e-9), name


def test_each_figure_names_its_step() -> None:
    problem = PROBLEM.replace(load=rng.normal(size=6), gap=[0.1, 0.2], tie_value=[0.3])
    right = cq.solve(problem)
    assert right.friction_force is not None
    posed = StepProblem(problem.load, problem.gap, None, None, problem.tie_value)
    x = right.displacement
    answer = StepResult(x, right.normal_force, right.friction_force.ravel(), right.tie_force, x)
    judge = StepJudge(PROBLEM)
    assert judge.figures([posed] * 3, [answer] * 3).first_above(1e-12) is None
    spoiled = {
        "equilibrium": (posed, replace(answer, unknown=x * (1 + 1e-6))),
        "tie": (replace(posed, tie_value=np.array([0.4])), answer),
        "penetration": (replace(posed, gap=posed.gap - 1.0), answer),
        "tension": (posed, replace(answer, normal=answer.normal - 1.0)),
        "complementarity": (replace(posed, gap=posed.gap + 1.0), replace(answer, normal=answer.normal + 1.0)),
        "cone": (posed, replace(answer, friction=answer.friction + 5.0)),
    }
    for name, (asked, wrong) in spoiled.items():
        found = judge.figures([posed, asked, posed], [answer, wrong, answer])
        assert getattr(found, name)[1] > 1e-8, name
        refused = found.first_above(1e-9)
        assert refused is not None
        assert refused[0] == 1


def test_what_is_no_number_fails_and_a_contact_that_was_not_looked_at_has_no_force() -> None:
    judge, (posed, answer) = StepJudge(PROBLEM), step(3)
    nan = replace(answer, unknown=np.full(6, np.nan))
    refused = judge.figures([posed], [nan]).first_above(1e-9)
    assert refused is not None
    assert refused[2] == np.inf
    unseen = replace(posed, closable=np.array([False, False]), gap=np.array([-9.0, -9.0]))
    quiet = replace(answer, normal=np.zeros(2), friction=np.zeros(4))
    assert judge.figures([unseen], [quiet]).penetration[0] == 0.0
    assert judge.figures([unseen], [replace(quiet, normal=np.array([1.0, 0.0]))]).tension[0] > 0.0
