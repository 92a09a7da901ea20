"""Every contact has a scale of its own: units of single contacts change nothing, and far contacts hide nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import contactqp as cq
from benchmarks.friction_families import CONTACT_FAMILIES, contact_problem
from benchmarks.friction_random import judge
from contactqp.certificate.uniqueness import SEVERAL
from tests.solving.friction.test_local import made

# Order (N, T), Klarbring's (1990) contact; mu = 0.8 at q = (0.3, 1.25) may be open, stick and slip.
KLARBRING = np.array([[1.0, 2.0], [2.0, 5.0]])
STATES = ([0.0, 0.0], [1.0, -0.65], [0.5, -0.4])


def in_own_units(
    problem: cq.LocalProblem, factor: NDArray[np.float64], velocity: float = 1.0, force: float = 1.0
) -> cq.LocalProblem:
    """Velocities of contact i times factor_i, its forces divided by it, and all of either kind in other units."""
    d = np.repeat(factor, problem.dimension)
    W = problem.delassus.toarray() * np.outer(d, d) * velocity / force
    return cq.LocalProblem(W, problem.offset * d * velocity, problem.friction, problem.dimension)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("seed", range(5))
def test_powers_of_two_at_contacts_change_no_digit_of_a_local_answer(dimension: int, seed: int) -> None:
    problem, _, _ = made(seed, dimension=dimension)
    factor = 2.0 ** np.random.default_rng(seed).integers(-27, 28, problem.contacts)
    plain, scaled = cq.solve(problem), cq.solve(in_own_units(problem, factor))
    assert np.array_equal(scaled.force * factor[:, None], plain.force)
    assert np.array_equal(scaled.velocity / factor[:, None], plain.velocity)
    assert list(scaled.contact_status) == list(plain.contact_status)
    assert scaled.certificate.uniqueness == plain.certificate.uniqueness
    for figure in ("natural_map", "penetration", "tension", "complementarity", "cone", "slip_direction"):
        assert getattr(scaled.certificate, figure) == getattr(plain.certificate, figure), figure


@pytest.mark.sampled(6)
@pytest.mark.parametrize("algorithm", [None, "newton", "nsgs", "admm"])
@pytest.mark.parametrize("seed", range(3))
def test_any_factor_at_contacts_and_any_unit_changes_rounding_only(algorithm: str | None, seed: int) -> None:
    problem, r, _ = made(seed)
    random = np.random.default_rng(seed)
    factor, (velocity, force) = 10.0 ** random.uniform(-8, 8, problem.contacts), 10.0 ** random.uniform(-8, 8, 2)
    scaled = in_own_units(problem, factor, velocity, force)
    solution = cq.solve(scaled, algorithm=algorithm)
    np.testing.assert_allclose(solution.force * factor[:, None] / force, r, atol=1e-9)
    assert list(solution.contact_status) == (["open", "slip", "stick"] * 2)[:5]
    assert cq.certify_local(scaled, r / factor[:, None] * force).passed


@pytest.mark.parametrize("seed", range(5))
def test_published_errors_are_reported_and_judge_nothing(seed: int) -> None:
    problem, r, _ = made(seed)
    factor = np.array([1e-8, 1e8, 1e-4, 1e4, 1.0])
    scaled = in_own_units(problem, factor)
    certificate = cq.certify_local(scaled, r / factor[:, None])
    assert certificate.passed
    assert certificate.siconos_error == cq.siconos_local_error(scaled, r / factor[:, None])


@pytest.mark.sampled(3)
@pytest.mark.parametrize("part", [1e-3, 1e-6])
@pytest.mark.parametrize("contact", [1, 2, 4])
def test_a_wrong_force_is_refused_in_any_unit_and_beside_a_contact_that_is_far(contact: int, part: float) -> None:
    """Contacts 1 and 4 slip, contact 2 sticks."""
    problem, r, _ = made(1)
    spoiled = r.copy()
    spoiled[contact] *= 1 + part
    for exponent in (-8, 0, 8):
        factor = np.ones(5)
        factor[contact] = 10.0**exponent
        assert not cq.certify_local(in_own_units(problem, factor), spoiled / factor[:, None]).passed
    far = with_far_contact(problem, 1e9)
    assert cq.certify_local(far, np.vstack([r, np.zeros(3)])).passed
    assert not cq.certify_local(far, np.vstack([spoiled, np.zeros(3)])).passed


def with_far_contact(problem: cq.LocalProblem, far: float) -> cq.LocalProblem:
    """An open contact of its own beside the others, `far` away and sliding as fast."""
    d, n = problem.dimension, len(problem.offset)
    W = np.eye(n + d)
    W[:n, :n] = problem.delassus.toarray()
    offset, friction = np.append(problem.offset, np.full(d, far)), np.append(problem.friction, 0.3)
    return cq.LocalProblem(W, offset, friction, d)


@pytest.mark.parametrize("slip", [1.0, 1e6])
def test_a_slip_hides_no_overlap_of_its_own_contact(slip: float) -> None:
    """W = 1: r_N = 1, r_T = -mu; pressing a millionth less leaves an overlap of a millionth."""
    problem = cq.LocalProblem(np.eye(2), [-1.0, slip], 0.5, 2)
    assert cq.certify_local(problem, [1.0, -0.5]).passed
    assert not cq.certify_local(problem, (1 - 1e-6) * np.array([1.0, -0.5])).passed


def test_what_rounding_leaves_of_an_offset_is_no_overlap_and_what_is_more_is_one() -> None:
    rounded = cq.LocalProblem(np.eye(2), [-1e-17, -1.0], 0.5, 2)
    assert cq.certify_local(rounded, [0.0, 0.0]).passed
    assert not cq.certify_local(cq.LocalProblem(np.eye(2), [-1e-6, -1.0], 0.5, 2), [0.0, 0.0]).passed


@pytest.mark.sampled(10)
@pytest.mark.parametrize("far", [1.0, 1e3, 1e6, 1e9])
@pytest.mark.parametrize("unit", [1e-8, 1.0, 1e8])
def test_all_three_local_answers_are_found_beside_a_far_contact_in_any_unit(far: float, unit: float) -> None:
    one = with_far_contact(cq.LocalProblem(KLARBRING, [0.3, 1.25], 0.8, 2), far)
    problem = in_own_units(one, np.array([unit, 1.0]))
    found = cq.equilibria(problem)
    forces = [solution.force[0] * unit for solution in found]
    np.testing.assert_allclose(sorted(map(tuple, forces)), sorted(map(tuple, STATES)), atol=1e-12)
    for state in STATES:
        assert cq.certify_local(problem, [*(np.array(state) / unit), 0.0, 0.0]).passed
        wrong = np.add(state, [1e-6, 0.0])
        assert not cq.certify_local(problem, [*(wrong / unit), 0.0, 0.0]).passed


@pytest.mark.parametrize("factor", [1e-8, 1e-4, 1e4, 1e8])
def test_an_operator_is_indefinite_or_not_in_any_unit(factor: float) -> None:
    scale = np.diag([factor, factor, 1.0, 1.0])
    W = np.kron(np.array([[2.0, 1.0], [1.0, 2.0]]), np.eye(2))
    cq.LocalProblem(scale @ W @ scale, np.ones(4), 0.3, 2)
    with pytest.raises(cq.InvalidProblem, match="indefinite"):
        cq.LocalProblem(scale @ (W - 1.2 * np.eye(4)) @ scale, np.ones(4), 0.3, 2)


def klarbring_bodies(size: float, far: float, coupled: bool, origin: float = 0.0) -> cq.ContactProblem:
    """Klarbring's contact with displacements of about `size` and three answers, beside a contact `far` away."""
    K = np.zeros((4, 4))
    K[:2, :2] = np.linalg.inv(np.array([[1.0, -2.0], [-2.0, 5.0]]))
    K[2:, 2:] = np.eye(2)
    free = size * np.array([-0.3, 1.25])
    normal = np.array([[1.0, 0.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0] if coupled else [0.0, 0.0, 1.0, 0.0]])
    tangent = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0] if coupled else [0.0, 0.0, 0.0, 1.0]])
    return cq.ContactProblem(
        stiffness=K, load=np.append(K[:2, :2] @ free, [0.0, 0.0]), normal=normal, gap=[0.0, far], tangent=tangent,
        friction=[0.8, 0.3], slip_origin=[0.0, origin],
    )  # fmt: skip


@pytest.mark.sampled(18)
@pytest.mark.parametrize("coupled", [True, False])
@pytest.mark.parametrize("origin", [0.0, 1.0, -1.0])
@pytest.mark.parametrize("size", [1e-2, 1e-6, 1e-9])
def test_three_answers_are_three_beside_a_gap_of_a_metre(size: float, origin: float, coupled: bool) -> None:
    problem = klarbring_bodies(size, 1.0, coupled, origin)
    exact, found = cq.exact_equilibria(problem), cq.equilibria(problem)
    assert len(exact) == 3
    known = sorted(tuple(one.normal_force.astype(float)) for one in exact)
    np.testing.assert_allclose(sorted(tuple(one.normal_force) for one in found), known, rtol=1e-9, atol=1e-12 * size)
    for one in (*found, cq.solve(problem)):
        assert one.certificate.passed
        assert one.certificate.uniqueness == (SEVERAL,)


@pytest.mark.parametrize("coupled", [True, False])
def test_one_answer_is_not_called_several_beside_a_gap_of_a_metre(coupled: bool) -> None:
    problem = klarbring_bodies(1e-6, 1.0, coupled)
    problem = problem.replace(load=-problem.load)
    assert len(cq.exact_equilibria(problem)) == 1
    assert cq.solve(problem).certificate.uniqueness == ()


def rows_scaled(problem: cq.ContactProblem, factor: NDArray[np.float64]) -> cq.ContactProblem:
    """All rows of contact i, its gap and its slip origin times factor_i."""
    assert problem.tangent is not None
    assert problem.slip_origin is not None
    width = problem.slip_origin.shape[1]
    data: dict[str, Any] = dict(
        normal=problem.normal.toarray() * factor[:, None],
        gap=problem.gap * factor,
        tangent=problem.tangent.toarray() * np.repeat(factor, width)[:, None],
        slip_origin=problem.slip_origin * factor[:, None],
    )
    return problem.replace(**data)


@pytest.mark.sampled(16)
@pytest.mark.parametrize("name", ["any 2D", "any 3D", "made around an answer 2D", "made around an answer 3D"])
@pytest.mark.parametrize("seed", range(4))
def test_rows_of_a_contact_may_be_scaled_by_any_factor(name: str, seed: int) -> None:
    problem = contact_problem(name, seed).problem
    plain = cq.solve(problem)
    for power in (2.0, 10.0):
        exponent = np.random.default_rng(seed).integers(-8, 9, problem.contacts) * (1 if power == 10 else 3)
        factor = power**exponent
        scaled = cq.solve(rows_scaled(problem, factor))
        forces = scaled.normal_force * factor
        size = np.max(abs(plain.normal_force))
        np.testing.assert_allclose(forces, plain.normal_force, rtol=1e-10, atol=1e-12 * size)
        assert list(scaled.contact_status) == list(plain.contact_status)
        assert scaled.certificate.uniqueness == plain.certificate.uniqueness


SCALES = [name for name in CONTACT_FAMILIES if name.startswith(("far_gap", "scaled_contact"))]


@pytest.mark.sampled(24)
@pytest.mark.parametrize("name", [*SCALES, *(f"local {name}" for name in SCALES)])
@pytest.mark.parametrize("seed", [*range(3), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(3, 20))])
def test_random_problems_of_many_scales_by_every_algorithm(name: str, seed: int) -> None:
    report = judge(name, seed)
    assert report.wrong == []
    assert report.outcomes["default"] == "solved" or not report.exists


@pytest.mark.slow
@pytest.mark.parametrize("power", [0, 20, -20, 49])
def test_an_unknown_without_stiffness_that_only_tangents_join_to_a_stiff_one_is_solved_in_any_unit(power: int) -> None:
    """u_0, without stiffness, is held between two walls; u_1, on a spring, slides with it along one of four contacts.

    There are several answers, and one of them is found, with the same states, whatever the units of length and force.
    """
    length, force = 2.0**-power, 2.0 ** (power / 2)
    tangent = [[2.0, 0.75], [0.0, -1.0], [0.0, -1.0], [0.0, -1.0]]
    problem = cq.ContactProblem(
        np.diag([0.0, 6.5]) * force / length, np.array([-1.25, -7.5]) * force, [[1.0, 0.0]] * 2 + [[-1.0, 0.0]] * 2,
        np.array([1.0, 1.0, -1.0, -0.25]) * length, tangent=tangent, friction=[1.0, 0.0, 1.0, 1.0],
        slip_origin=np.array([[2.4375], [0.75], [-0.25], [1.75]]) * length,
    )  # fmt: skip
    solution = cq.solve(problem)
    assert solution.certificate.passed
    assert solution.displacement[0] == pytest.approx(length, rel=1e-14)
    assert list(solution.contact_status)[3] == "open"


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("width", "overlap"), [(1, 1e-12), (1, 1e-30), (1, 1e-60), (2, 1e-12), (2, 1e-30)])
def test_an_overlap_that_contacts_alone_prescribe_is_no_rounding_of_forces(width: int, overlap: float) -> None:
    """A stuck body is pushed back by its overlap, however small that is beside what its load would move."""
    n = width + 1
    load = np.array([1.0, *[0.125] * width])
    problem = cq.ContactProblem(
        2 * np.eye(n) + 0.3, load, np.eye(1, n), [-overlap], tangent=np.eye(n)[1:], friction=0.5
    )
    solution = cq.solve(problem)
    assert solution.displacement == pytest.approx([-overlap, *[0.0] * width], rel=1e-12, abs=1e-12 * overlap)
    assert solution.contact_status.tolist() == ["stick"]
    assert solution.normal_force == pytest.approx([1.0], rel=1e-9)
    assert not cq.certify(problem, np.zeros(n), solution.normal_force, solution.friction_force).passed


@pytest.mark.slow
def test_what_floats_cannot_tell_is_found_in_rational_numbers() -> None:
    """Stiffness from 1e-140 to 1e74 hides the one equilibrium from floats; a contact that never closes is left out."""
    K = [
        [1.699e17, 4.233e45, 1.528e-62, 9.964e-26],
        [4.233e45, 6.667e74, 2.726e-33, -5076.0],
        [1.528e-62, 2.726e-33, 1.785e-140, 2.037e-105],
        [9.964e-26, -5076.0, 2.037e-105, 5.921e-67],
    ]
    load = [-3.63e7, 2.244e37, -3.122e-72, -1.683e-35]
    normal = np.array([[-1.0, -1.0, -1.0, -1.0], [0.0, 0.0, -2.0, 0.0], [-2.0, 1.0, -1.0, 1.0]])
    tangent = np.array([[-2.0, 1.0, -2.0, 2.0], [2.0, 2.0, 2.0, -2.0], [1.0, 2.0, -2.0, -1.0]])
    problem = cq.ContactProblem(K, load, normal, [0.485, -1.032, 0.2506], tangent, 0.5)
    [exact] = cq.exact_equilibria(problem)
    solution = cq.solve(problem)
    assert solution.method == "enumeration"
    assert solution.normal_force == pytest.approx([float(force) for force in exact.normal_force], rel=1e-9)
    beside = problem.replace(
        normal=normal[[0, 0, 1, 2]], gap=[np.inf, *problem.gap], tangent=tangent[[0, 0, 1, 2]], friction=0.5
    )
    assert cq.solve(beside).normal_force == pytest.approx([0.0, *solution.normal_force], rel=1e-9)
