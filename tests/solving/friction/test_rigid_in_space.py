"""Rigid bodies and nodes with redundant contacts in space, made around their answers: nothing gives zero a scale."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from contactqp.solving.friction import algorithms


def planted_on_a_rigid_body(
    seed: int, coefficients: tuple[float, ...] = (0.125, 0.25, 0.5, 0.75)
) -> tuple[cq.ContactProblem, np.ndarray, np.ndarray, np.ndarray]:
    """A body of six rigid motions on up to five contacts, in frames of whole numbers, made around its answer."""
    rng = np.random.default_rng(seed)
    contacts = int(rng.integers(1, 6))
    u, force, drag = rng.integers(-4, 5, 6) * 0.25, np.zeros(contacts), np.zeros((contacts, 2))
    normal, tangent = np.zeros((contacts, 6)), np.zeros((contacts, 2, 6))
    friction, slip = rng.choice(coefficients, contacts), np.zeros((contacts, 2))
    for i in range(contacts):
        a, b, c, d = rng.integers(1, 4, 4).astype(float)  # a rotation, by its quaternion
        frame = np.array(
            [
                [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
                [2 * (b * c + a * d), a * a - b * b + c * c - d * d, 2 * (c * d - a * b)],
                [2 * (b * d - a * c), 2 * (c * d + a * b), a * a - b * b - c * c + d * d],
            ]
        ) / (a * a + b * b + c * c + d * d)
        x, y, z = rng.integers(-2, 3, 3).astype(float)
        moved = frame @ np.hstack([np.eye(3), [[0, z, -y], [-z, 0, x], [y, -x, 0]]])
        normal[i], tangent[i] = moved[0], moved[1:]
        state, along = (
            rng.choice(["open", "stick", "slip"]),
            np.array([[0.6, 0.8], [5 / 13, -12 / 13]])[rng.integers(2)],
        )
        if state != "open":
            force[i] = rng.integers(1, 9)
            drag[i] = friction[i] * force[i] * along * (rng.choice([0.0, 0.5, 0.9]) if state == "stick" else 1.0)
            slip[i] = along * rng.integers(1, 4) * 0.5 * (state == "slip")
    rows = tangent.reshape(-1, 6)
    problem = cq.ContactProblem(
        stiffness=np.zeros((6, 6)),
        load=normal.T @ force + rows.T @ drag.ravel(),
        normal=normal,
        gap=normal @ u + np.where(force > 0, 0.0, rng.integers(0, 4, contacts) * 0.25),
        tangent=rows,
        friction=friction,
        slip_origin=rows @ u - slip.ravel(),
    )
    return problem, u, force, drag


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", [37, 113, 270, 428])
def test_answers_of_rigid_bodies_are_found_and_pass(seed: int) -> None:
    """No stiffness gives gaps and forces a scale: what rounding leaves of a zero length is measured by others."""
    problem, u, force, drag = planted_on_a_rigid_body(seed)
    assert cq.certify(problem, u, force, drag).passed
    solution = cq.solve(problem)
    pushed = problem.normal.T @ solution.normal_force + problem.tangent.T @ solution.friction_force.ravel()
    assert pushed == pytest.approx(problem.load, abs=1e-12 * np.max(abs(problem.load), initial=1.0))
    assert np.min(problem.gap - problem.normal @ solution.displacement) > -1e-12
    if force.any():
        wrong = force * np.where(np.arange(len(force)) == np.argmax(force), 1.001, 1.0)
        assert not cq.certify(problem, u, wrong, drag).passed
        assert not cq.certify(problem, u + 1e-6 * problem.normal.toarray()[np.argmax(force)], force, drag).passed


@pytest.mark.slow
@pytest.mark.parametrize("seed", [66, 368])
def test_bodies_that_wedge_themselves_are_answered_from_drawn_combinations(seed: int) -> None:
    """With friction of 64 on four of five contacts no other algorithm comes to an answer."""
    problem, *_ = planted_on_a_rigid_body(seed, (0.02, 1.0, 8.0, 64.0))
    solution = cq.solve(problem)
    assert solution.method == "combinations"
    assert solution.certificate.passed
    pushed = problem.normal.T @ solution.normal_force + problem.tangent.T @ solution.friction_force.ravel()
    assert pushed == pytest.approx(problem.load, abs=1e-12 * np.max(abs(problem.load)))


@pytest.mark.slow
def test_no_combination_is_drawn_where_steps_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawn ones count as steps only where they are near; a diagnosis that allows 20 took 4 s over its questions."""
    problem, *_ = planted_on_a_rigid_body(66, (0.02, 1.0, 8.0, 64.0))
    monkeypatch.setattr(algorithms, "drawn_combinations", lambda *_: pytest.fail("combinations were drawn"))
    with pytest.raises((cq.NotConverged, cq.NotCertified)):
        cq.solve(problem, max_iter=20)


def test_a_body_that_slides_at_the_limit_of_its_load_passes_beside_a_contact_that_grazes() -> None:
    """How far it has slid is for nothing to say: the next contact's gap is rounding, and no force answers that."""
    normal = np.array([[0.0, 0.8, -0.6], [0.0, 1.0, 0.0]])
    tangent = np.array([[0.0, -0.6, -0.8], [-1.0, 0.0, 0.0], [-0.8, 0.0, -0.6], [-0.6, 0.0, 0.8]])
    u = np.array([0.25, 0.5, 1.0])
    problem = cq.ContactProblem(
        stiffness=np.zeros((3, 3)),
        load=[0.0, 10.0, 5.0],
        normal=normal,
        gap=normal @ u,
        tangent=tangent,
        friction=[2.0, 1e-3],
        slip_origin=tangent @ u - [-1.0, 0.0, 1.0, -1.0],
    )
    assert cq.certify(problem, u, [5.0, 0.0], [-10.0, 0.0, 0.0, 0.0]).passed
    assert not cq.certify(problem, u, [5.005, 0.0], [-10.0, 0.0, 0.0, 0.0]).passed
    assert not cq.certify(problem, u, [5.0, 0.0], [-10.0, 0.01, 0.0, 0.0]).passed


def test_a_body_without_loads_that_only_touches_passes_wherever_it_is() -> None:
    normal = np.array([[4.0, -8.0, -1.0, 8.0, 5.0, -8.0]]) / 9
    u = np.array([-2.36854473, 0.76345639, 1.07514067, 0.79299945, -0.34360239, -0.31649844])
    problem = cq.ContactProblem(
        stiffness=np.zeros((6, 6)),
        load=np.zeros(6),
        normal=normal,
        gap=normal @ u,
        tangent=np.array([[-4.0, -1.0, -8.0, 1.0, 4.0, -1.0], [7.0, 4.0, -4.0, -4.0, 11.0, 4.0]]) / 9,
        friction=0.5,
    )
    assert cq.certify(problem.replace(slip_origin=problem.tangent @ u), u, [0.0], [0.0, 0.0]).passed
    assert not cq.certify(problem, u + 1e-6 * normal[0], [0.0], [0.0, 0.0]).passed


@pytest.mark.slow
def test_an_iterate_that_satisfies_the_law_is_the_answer_where_no_combination_can_be_refined() -> None:
    """Two nodes on springs; three contacts of the first depend on each other, and two of these only graze."""
    B = np.array(
        [
            [15.0, 3.0, -2.0, -3.0, 4.0, 7.0],
            [3.0, 19.0, -3.0, -5.0, 8.0, 4.0],
            [-2.0, -3.0, 8.0, 2.0, -3.0, -4.0],
            [-3.0, -5.0, 2.0, 12.0, -6.0, -1.0],
            [4.0, 8.0, -3.0, -6.0, 8.0, 1.0],
            [7.0, 4.0, -4.0, -1.0, 1.0, 10.0],
        ]
    )
    normal, tangent = np.zeros((5, 6)), np.zeros((5, 2, 6))
    normal[0, :3], tangent[0, :, :3] = np.array([6, -2, -3]) / 7, np.array([[2, -3, 6], [-3, -6, -2]]) / 7
    normal[1, :3], tangent[1, :, :3] = np.array([-11, -10, 2]) / 15, np.array([[2, -5, -14], [10, -10, 5]]) / 15
    normal[2, 2], tangent[2, 0, 0], tangent[2, 1, 1] = -1.0, 1.0, 1.0
    normal[3, 3:], tangent[3, :, 3:] = [0.6, 0.0, 0.8], [[0.8, 0.0, -0.6], [0.0, 1.0, 0.0]]
    normal[4, [2, 5]], tangent[4, 0, [0, 3]], tangent[4, 1, [1, 4]] = [-1.0, 1.0], [1.0, -1.0], [1.0, -1.0]
    rows, u, friction = (
        tangent.reshape(-1, 6),
        np.array([0.75, -0.25, 0.0, -0.5, 0.5, 0.5]),
        [1.0, 0.25, 0.5, 0.25, 0.25],
    )
    force = np.array([3.0, 5.0, 0.0, 0.0, 7.0])
    drag = np.array([24 / 17, 45 / 17, 9 / 17, 16.875 / 17, 0.0, 0.0, 0.0, 0.0, 0.0, -1.75])
    slip = np.array([8 / 17, 15 / 17, 0.0, 0.0, 0.8, -0.6, -12 / 13, -5 / 13, 0.0, 0.0])
    problem = cq.ContactProblem(
        stiffness=B,
        load=B @ u + normal.T @ force + rows.T @ drag,
        normal=normal,
        gap=normal @ u,
        tangent=rows,
        friction=friction,
        slip_origin=rows @ u - slip,
    )
    solution = cq.solve(problem)
    assert solution.displacement == pytest.approx(u, abs=1e-7)
    assert solution.certificate.passed


@pytest.mark.sampled(3)
@pytest.mark.parametrize("decades", [6.5, 7.0, 8.0])
def test_a_contact_on_springs_many_decades_apart_is_solved(decades: float) -> None:
    """Its normal and its tangent are nearly one row beside the soft spring, and yet no forces balance each other."""
    stiffness = np.diag([10.0**decades, 10.0**-decades])
    normal, tangent, u = np.array([[0.8, -0.6]]), np.array([[0.6, 0.8]]), np.array([0.25, -0.5])
    problem = cq.ContactProblem(
        stiffness=stiffness,
        load=stiffness @ u + 5.0 * normal[0] + 0.5 * tangent[0],
        normal=normal,
        gap=normal @ u,
        tangent=tangent,
        friction=0.3,
        slip_origin=tangent @ u,
    )
    solution = cq.solve(problem)
    assert solution.displacement == pytest.approx(u, rel=1e-9)
    assert cq.certify(problem, u, [5.0], [0.5]).passed
    assert not cq.certify(problem, u, [5.005], [0.5]).passed


@pytest.mark.slow
def test_an_iterate_that_meets_the_law_is_no_end_where_the_stiffness_is_ill_conditioned() -> None:
    """K spans ten decades, forces in error by 1e-13 of the law are no answer yet, and another algorithm has it."""
    factor = np.array(
        [
            [2.2e-04, 4.4e-04, 1.3e-03, 1.4e-03, -1.5e-01, 6.3e-01, -2.4],
            [-3.5e-05, 5.7e-04, -6.2e-04, 9.7e-04, -1.8e-01, -1.2, 2.8],
            [-4.5e-05, 1.1e-04, 3.7e-03, -4.8e-03, 8.0e-02, -3.7e-01, -2.7],
            [-1.4e-04, 5.8e-04, -5.5e-04, 9.1e-04, 1.4e-01, 6.1e-01, -15.0],
            [2.6e-05, 3.5e-04, -1.6e-04, 3.3e-04, 2.7e-01, 1.1e-01, 23.0],
            [-1.4e-04, -8.7e-05, 2.0e-03, 6.5e-03, -1.4e-01, 3.3e-01, 9.2],
            [-9.2e-05, 1.2e-04, -7.1e-04, -6.0e-03, -2.4e-01, 7.0e-01, 11.0],
        ]
    )
    normal, tangent = np.zeros((3, 7)), np.zeros((6, 7))
    normal[0, [1, 2, 5]], normal[1, [0, 1, 4]], normal[2, [0, 5, 6]] = (
        [-0.041, 2.9, -1.1],
        [-1, -0.021, 0.066],
        [-0.29, -2.5, 1.7],
    )
    tangent[0, [1, 2, 5]], tangent[1, [1, 2, 5]] = [0.8, -0.26, -0.46], [0.66, -0.12, 0.47]
    tangent[2, [0, 1, 4]], tangent[3, [0, 1, 4]] = [0.033, 0.7, 0.72], [0.061, -0.72, 0.7]
    tangent[4, [0, 5, 6]], tangent[5, [0, 5, 6]] = [0.006, 0.63, -0.19], [-0.86, 0.48, 0.93]
    u, force = np.array([0.53, 1.1, 0.77, -0.98, -0.38, -1.0, -0.85]), np.array([0.96, 0.15, 2.1])
    friction, along = np.array([0.6, 0.3, 0.6]), np.array([[-0.12, -0.99], [0.97, 0.25], [0.0, 0.0]])
    along[:2] /= np.linalg.norm(along[:2], axis=1)[:, None]
    drag = (friction * force)[:, None] * along + np.array([[0.0, 0.0], [0.0, 0.0], [0.042, -0.19]])
    slip = np.array([0.011, 2.8e-4, 0.0])[:, None] * along
    K = factor @ factor.T
    problem = cq.ContactProblem(
        (K + K.T) / 2,
        K @ u + normal.T @ force + tangent.T @ drag.ravel(),
        normal,
        normal @ u,
        tangent=tangent,
        friction=friction,
        slip_origin=tangent @ u - slip.ravel(),
    )
    solution = cq.solve(problem)
    assert solution.normal_force == pytest.approx(force, rel=1e-7)
    assert solution.friction_force == pytest.approx(drag, rel=1e-7)
