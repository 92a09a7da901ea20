"""Forces that the law makes zero, and those of ties, are judged by the energy of the response to them.

A slender beam hides them from figures that compare them with |K||u|, and bounds compare with an answer without them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate.bounds import force_bound_fails
from contactqp.certificate.energy_bounds import energy_bounds
from contactqp.certificate.state_bodies import SparseBodies
from contactqp.model.solution import Answer

ELEMENTS, LENGTH, BENDING, LOAD = 400, 2000.0, 2.1e5 * 20**4 / 12, 400.0  # steel, 20 mm x 20 mm, in N and mm
TIP, MIDDLE = 2 * ELEMENTS - 2, ELEMENTS - 2
STRAY = 30.0


def free_beam() -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Deflections and slopes of a beam that nothing holds under an even load."""
    h = LENGTH / ELEMENTS
    element = BENDING / h**3 * np.array([
        [12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h],
        [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h * h, -6 * h, 4 * h * h],
    ])  # fmt: skip
    K = np.zeros((2 * ELEMENTS + 2,) * 2)
    for k in range(ELEMENTS):
        K[2 * k : 2 * k + 4, 2 * k : 2 * k + 4] += element
    return K, np.tile([-LOAD / ELEMENTS, 0.0], ELEMENTS + 1)


def cantilever() -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    K, load = free_beam()
    return K[2:, 2:], load[2:]


def row(unknown: int, sign: float = 1.0) -> np.ndarray[Any, Any]:
    found = np.zeros((1, 2 * ELEMENTS))
    found[0, unknown] = sign
    return found


def on_a_stop(**more: Any) -> cq.ContactProblem:
    K, load = cantilever()
    return cq.ContactProblem(K, load, **({"normal": row(MIDDLE, -1.0), "gap": [1.0]} | more))


def refused_for_its_force(certificate: Any) -> bool:
    return not certificate.passed and any("force_error" in failure for failure in certificate.failures)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("others", [False, True])
def test_friction_of_a_smooth_contact_is_an_error_of_the_forces(others: bool) -> None:
    """Beside it other contacts are smooth, too, or one is rough."""
    rows = {"normal": np.vstack([row(MIDDLE, -1.0), row(MIDDLE // 2 * 2 + 40, -1.0)]), "gap": [1.0, 50.0]}
    problem = on_a_stop(tangent=np.vstack([row(TIP), row(TIP - 40)]), friction=[0.0, 0.3 if others else 0.0], **rows)
    solution = cq.solve(problem)
    u, push, rub = solution.displacement, solution.normal_force, np.zeros((2, 1))
    assert cq.certify(problem, u, push, rub).passed
    assert cq.certify(problem, u, push, rub + np.array([[1e-9], [0.0]])).passed
    for size in (STRAY, -STRAY, 1e-2):
        certificate = cq.certify(problem, u, push, rub + np.array([[size], [0.0]]))
        assert refused_for_its_force(certificate), size
        assert "contact 0 has a force that the law makes zero" in " ".join(certificate.failures)
        assert certificate.force_bound is not None
        assert certificate.force_bound[0] >= abs(size)


@pytest.mark.parametrize("after_another", [False, True])
def test_the_bound_of_the_displacement_has_the_response_to_friction_of_a_smooth_contact(after_another: bool) -> None:
    """The displacement is in balance with that friction: residuals are rounding, and what was found for other answers
    does not end the refinement at once."""
    problem = cq.ContactProblem([[5.0, 2.0], [2.0, 4.0]], [3.0, -1.0], [[0.0, -1.0]], [0.0], [[1.0, 0.0]], friction=0.0)
    right, push = np.array([0.6, 0.0]), [2.2]  # 5 u = 3; 1 + 2 u
    for rub in (2.0**-34, 2.0**-30, 2.0**-20):
        fresh = problem._without_results()
        if after_another:
            assert cq.certify(fresh, right, push, [[0.0]]).passed
        moved = np.array([-4.0, 2.0]) * rub / 16  # K moved = -(rub, 0)
        certificate = cq.certify(fresh, right + moved, push, [[rub]])
        assert certificate.energy_error is not None
        assert certificate.energy_error >= (1 - 1e-6) * np.sqrt(4 / 16 / (5 * 0.36)) * rub


@pytest.mark.sampled(4)
@pytest.mark.parametrize("force", [STRAY, -STRAY, 1e-2])
def test_a_contact_that_never_closes_has_no_force(force: float) -> None:
    problem = on_a_stop(normal=np.vstack([row(MIDDLE, -1.0), row(TIP, -1.0)]), gap=[1.0, np.inf])
    solution = cq.solve(problem)
    assert cq.certify(problem, solution.displacement, solution.normal_force + np.array([0.0, 1e-9])).passed
    certificate = cq.certify(problem, solution.displacement, solution.normal_force + np.array([0.0, force]))
    assert refused_for_its_force(certificate)
    assert "contact 1 has a force that the law makes zero, as its gap is infinite" in " ".join(certificate.failures)
    assert certificate.force_error is not None
    assert certificate.force_error > 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("force", [STRAY, -STRAY, 1e-2])
def test_units_of_rows_do_not_hide_a_force_that_the_law_makes_zero(force: float) -> None:
    """Rows scaled so far that the problem is judged in units of its own: the verdict, and the error, stay the same."""
    unit = np.array([2.0**400, 2.0**-300])
    plain = on_a_stop(normal=np.vstack([row(MIDDLE, -1.0), row(TIP, -1.0)]), gap=[1.0, np.inf])
    scaled = plain.replace(normal=plain.normal.toarray() * unit[:, None], gap=plain.gap * unit)
    u, right = (solution := cq.solve(plain)).displacement, solution.normal_force
    assert cq.certify(scaled, u, (right + np.array([0.0, 1e-9])) / unit).passed
    pushed = right + np.array([0.0, force])
    here, there = cq.certify(plain, u, pushed), cq.certify(scaled, u, pushed / unit)
    assert refused_for_its_force(there)
    assert there.force_error == pytest.approx(here.force_error, rel=1e-6)


def test_an_absurd_force_that_the_law_makes_zero_is_refused() -> None:
    """In units of its row it is beyond all doubles."""
    problem = on_a_stop(normal=np.vstack([row(MIDDLE, -1.0), row(TIP, -(2.0**900))]), gap=[1.0, np.inf])
    solution = cq.solve(problem)
    certificate = cq.certify(problem, solution.displacement, solution.normal_force + np.array([0.0, 1e200]))
    assert not certificate.passed
    assert "contact 1" in " ".join(certificate.failures)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("force", [STRAY, 1e-2])
def test_forces_of_ties_are_forces(force: float) -> None:
    problem = on_a_stop(gap=[2.0], tie=row(TIP), tie_value=[-20.0])
    solution = cq.solve(problem)
    K, load = cantilever()
    held = np.vstack([row(MIDDLE, -1.0), row(TIP)])
    system = np.block([[K, held.T], [held, np.zeros((2, 2))]])
    forces = np.linalg.solve(system, np.concatenate([load, [2.0, -20.0]]))[-2:]
    assert forces == pytest.approx([solution.normal_force[0], solution.tie_force[0]], rel=1e-4)
    given = solution.displacement, solution.normal_force
    assert cq.certify(problem, *given, tie_force=solution.tie_force).passed
    assert cq.certify(problem, *given, tie_force=solution.tie_force + 1e-9).passed
    assert refused_for_its_force(cq.certify(problem, *given, tie_force=solution.tie_force + force))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("length", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("force", [1e-6, 1.0, 1e6])
def test_forces_of_ties_are_told_where_no_contact_has_one(length: float, force: float) -> None:
    """Two springs in line, the first node moved by a tie, the second far from its stop."""
    K = np.array([[3.0, -2.0], [-2.0, 2.0]]) * force / length
    problem = cq.ContactProblem(
        K, [0.0, 0.1 * force], [[0.0, 1.0]], [9.0 * length], tie=[[1.0, 0.0]], tie_value=[length]
    )
    solution = cq.solve(problem)
    assert solution.tie_force[0] == pytest.approx((0.1 - 1.0) * force)
    given = solution.displacement, solution.normal_force
    for part, passes in ((1e-12, True), (1e-4, False)):
        certificate = cq.certify(problem, *given, tie_force=solution.tie_force * (1 + part))
        assert certificate.passed is passes


@pytest.mark.slow
def test_ties_that_depend_on_each_other_share_as_they_like() -> None:
    problem = on_a_stop(gap=[2.0], tie=np.vstack([row(TIP), 2.0 * row(TIP)]), tie_value=[-20.0, -40.0])
    solution = cq.solve(problem)
    other = solution.tie_force + np.array([2e3, -1e3])
    assert cq.certify(problem, solution.displacement, solution.normal_force, tie_force=other).passed
    assert refused_for_its_force(
        cq.certify(problem, solution.displacement, solution.normal_force, tie_force=other + np.array([0.0, 5.0]))
    )


def machine(spring: float) -> cq.ContactProblem:
    """A rigid machine on three feet, its middle one 0.1 mm low, held by weak springs; N and mm."""
    rows = [[-1.0, 500.0], [-1.0, 0.0], [-1.0, -500.0]]
    return cq.ContactProblem(np.diag([spring, 1e6 * spring]), [-1e5, 3e6], rows, [0.0, 0.1, 0.0])


@pytest.mark.slow
@pytest.mark.parametrize("spring", [0.0, 1e-12, 1e-9, 1e-7, 1e-3, 1.0])
def test_which_feet_stand_on_their_shims_does_not_depend_on_weak_springs(spring: float) -> None:
    problem = machine(spring)
    solution = cq.solve(problem)
    assert solution.normal_force == pytest.approx([53000.0, 0.0, 47000.0], rel=1e-6)
    assert not any("not told from zero" in note for note in solution.certificate.notes)
    displacement = solution.displacement
    wrong = [6000.0, 94000.0, 0.0]  # the same resultant on two feet, one of which stands over its shim
    assert not cq.certify(problem, displacement, wrong).passed
    turned = displacement + np.array([0.0, 1e-4])  # onto the middle shim, by a hair
    assert not cq.certify(problem, turned, solution.normal_force).passed
    for part, passes in ((1e-13, spring > 0), (1e-4, False)):  # what is nothing beside the largest length, and what not
        certificate = cq.certify(problem, displacement + np.array([-0.1 * part, 0.0]), solution.normal_force)
        assert certificate.passed is passes


def machine_with_friction(spring: float) -> cq.ContactProblem:
    """The machine pushed sideways: its feet slip at mu = 0.2, and the middle one is 1 mm low."""
    K = np.diag([spring, spring, 1e6 * spring])
    rows = np.array([[0.0, -1.0, 500.0], [0.0, -1.0, 0.0], [0.0, -1.0, -500.0]])
    return cq.ContactProblem(
        K, [3e4, -1e5, 0.0], rows, [0.0, 1.0, 0.0], tangent=[[1.0, 0.0, 0.0]] * 3, friction=[0.2] * 3
    )


@pytest.mark.sampled(4)
@pytest.mark.parametrize("spring", [1e-9, 1e-6, 1e-2])
def test_machines_that_slide_far_on_weak_springs_stand_on_their_shims(spring: float) -> None:
    problem = machine_with_friction(spring)
    solution = cq.solve(problem)
    assert solution.normal_force == pytest.approx([5e4, 0.0, 5e4])
    assert solution.friction_force.ravel() == pytest.approx([1e4, 0.0, 1e4])
    assert solution.displacement[0] == pytest.approx(1e4 / spring)  # far beyond any gap
    wrong = cq.certify(problem, solution.displacement, [0.0, 1e5, 0.0], [[0.0], [2e4], [0.0]])
    assert not wrong.passed


def test_gaps_that_count_as_nothing_beside_others_are_told() -> None:
    """The machine's feet stand on stiff bars, one of which is stopped a metre away: on its stiffness that is far."""
    K, rows = np.diag([1e-7, 0.1, 1e6, 1e6, 1e6]), np.zeros((4, 5))
    rows[:3, :2], rows[:3, 2:], rows[3, 4] = machine(1.0).normal.toarray(), np.eye(3), -1.0
    problem = cq.ContactProblem(K, [-1e5, 3e6, 0.0, 0.0, 0.0], rows, [0.0, 0.2, 0.0, 1e3])
    hidden = [note for note in cq.solve(problem).certificate.notes if "not told from zero" in note]
    assert len(hidden) == 1
    assert "the gap of contact 1, 0.2, is not told from zero" in hidden[0]
    near = problem.replace(gap=[0.0, 0.2, 0.0, 0.3])
    assert not any("not told from zero" in note for note in cq.solve(near).certificate.notes)


@pytest.mark.slow
@pytest.mark.parametrize("force", [STRAY, 1e-2])
def test_forces_of_ties_are_forces_with_friction_too(force: float) -> None:
    problem = on_a_stop(gap=[2.0], tie=row(TIP), tie_value=[-20.0], tangent=row(MIDDLE - 40), friction=[0.3])
    solution = cq.solve(problem)
    given = solution.displacement, solution.normal_force, solution.friction_force
    assert cq.certify(problem, *given, tie_force=solution.tie_force).passed
    assert cq.certify(problem, *given, tie_force=solution.tie_force + 1e-9).passed
    certificate = cq.certify(problem, *given, tie_force=solution.tie_force + force)
    assert not certificate.passed
    assert any("state: the contact forces are" in failure for failure in certificate.failures)


def on_three_supports(rough: bool, more: int = 0) -> cq.ContactProblem:
    """A beam that floats but for ties at its ends and its middle, above stops; `more` unknowns on soft springs."""
    K, load = free_beam()
    n = len(load) + more
    held, stops = np.zeros((3 + more, n)), np.zeros((2, n))
    held[[0, 1, 2], [0, ELEMENTS, 2 * ELEMENTS]] = 1.0
    stops[[0, 1], [ELEMENTS // 2, 3 * ELEMENTS // 2]] = -1.0
    stiffness = np.zeros((n, n))
    stiffness[: len(load), : len(load)] = K
    for j in range(more):
        held[3 + j, len(load) + j] = stiffness[len(load) + j, len(load) + j] = 1.0
    values = np.concatenate([np.zeros(3), np.full(more, 1e4)])
    friction = {"tangent": np.roll(stops, 1, axis=1), "friction": 0.3} if rough else {}
    load = np.append(load, np.zeros(more))
    return cq.ContactProblem(stiffness, load, stops, [0.02, 0.03], tie=held, tie_value=values, **friction)


@pytest.mark.slow
@pytest.mark.parametrize("rough", [False, True])
def test_forces_of_ties_that_hold_a_floating_body_are_forces(rough: bool) -> None:
    """Those of three supports in line may change together without a resultant."""
    problem = on_three_supports(rough)
    solution = cq.solve(problem)
    given = solution.displacement, solution.normal_force, solution.friction_force
    for part, passes in ((0.0, True), (1e-10, True), (1e-5, False), (1e-4, False), (1e-2, False)):
        tie = solution.tie_force + part * abs(solution.tie_force).max() * np.array([0.5, -1.0, 0.5])
        certificate = cq.certify(problem, *given, tie_force=tie)
        assert certificate.passed is passes, part
        if not (passes or rough):
            assert refused_for_its_force(certificate)


def tied_chain(**more: Any) -> tuple[np.ndarray[Any, Any], cq.ContactProblem]:
    """Twenty springs in line, the first held, a stop at the tenth and a tie at the last."""
    K = 2.0 * np.eye(20) - np.eye(20, k=1) - np.eye(20, k=-1)
    K[-1, -1] = 1.0
    unit = np.eye(20)
    return K, cq.ContactProblem(K, unit[9], unit[[9]], [0.1], tie=unit[[19]], tie_value=[-0.5], **more)


def test_forces_of_ties_are_compared_where_nothing_is_condensed() -> None:
    K, problem = tied_chain()
    solution, errors = cq.solve(problem), []
    for part in (0.0, 1e-4):
        answer = Answer(solution.displacement, solution.normal_force, None, solution.tie_force * (1 + part))
        errors.append(energy_bounds(problem, answer).force_error)
    (pressed,), (held,) = solution.normal_force, solution.tie_force
    unit = np.eye(20)
    sizes = [np.sqrt(g @ np.linalg.solve(K, g)) for g in (1e-4 * held * unit[19], held * unit[19] + pressed * unit[9])]
    alone = 1e-4 * held / np.hypot(held, pressed / 2)  # in units of powers of two: where the stop is K_jj = 2
    assert errors == pytest.approx([0.0, max(sizes[0] / sizes[1], alone)], rel=1e-6, abs=1e-12)


@pytest.mark.slow
def test_large_forces_of_ties_elsewhere_hide_no_contact_force() -> None:
    problem = on_three_supports(rough=False, more=1)
    solution = cq.solve(problem)
    for part, fails in ((0.0, False), (1e-5, True)):
        force = solution.normal_force * (1 + part)
        known = energy_bounds(problem, Answer(solution.displacement, force, None, solution.tie_force))
        assert force_bound_fails(known, 1e-6, 0.0) is fails


def test_a_force_next_to_a_support_counts_beside_the_largest_one() -> None:
    problem = on_a_stop(normal=np.vstack([row(MIDDLE, -1.0), row(4, -1.0)]), gap=[1.0, 1.0])
    solution = cq.solve(problem)
    assert solution.normal_force[1] == 0.0
    for part, passes in ((1e-9, True), (2e-6, False), (1e-4, False)):
        force = solution.normal_force + np.array([0.0, part * solution.normal_force[0]])
        certificate = cq.certify(problem, solution.displacement, force)
        assert certificate.passed is passes
        assert any(failure.startswith("force_bound") for failure in certificate.failures) is not passes


def test_sparse_bodies_know_the_response_to_forces_of_ties() -> None:
    K, problem = tied_chain(tangent=np.eye(20)[[14]], friction=[0.3])
    load = 3.0 * np.eye(20)[9] + 0.5 * np.eye(20)[14] - 2.0 * np.eye(20)[19]
    norm = SparseBodies(problem).untied_norm(np.array([3.0]), np.array([[0.5]]), np.array([-2.0]))
    assert norm is not None
    assert norm[0] == pytest.approx(np.sqrt(load @ np.linalg.solve(K, load)), rel=1e-9)


@pytest.mark.parametrize("part", [1e-3, 1e-4])
def test_a_small_tie_force_between_large_loads_is_judged_by_itself_where_no_contact_pushes(part: float) -> None:
    """A tie between two nodes under loads of four million times its force, and a stop that nothing presses."""
    stiff = np.array([[3.5553511250e6, -3.5553280000e6], [-3.5553280000e6, 3.5553280000e6]])
    load = [-2.66652553125e6, 2.66649662500e6]
    problem = cq.ContactProblem(stiff, load, [[-1.0, 0.0]], [10.0], tie=[[1.0, -1.0]], tie_value=[-0.75])
    right = cq.solve(problem)
    assert not right.normal_force.any()
    assert 0 < abs(right.tie_force[0]) < 1e-5 * abs(load[0])
    assert cq.certify(problem, right.displacement, right.normal_force, tie_force=right.tie_force).passed
    wrong = cq.certify(problem, right.displacement, right.normal_force, tie_force=(1 + part) * right.tie_force)
    assert not wrong.passed
    assert any("tie" in failure for failure in wrong.failures)


@pytest.mark.parametrize("stray", [1e-13, 1e-11, 1e-3])
@pytest.mark.parametrize("contact", [0, 1])
@pytest.mark.parametrize("friction", [(0.0, 0.0), (0.0, 0.5), (0.5, 0.0)])
def test_bounds_contain_friction_that_the_law_makes_zero_however_small(
    stray: float, contact: int, friction: tuple[float, float]
) -> None:
    """Contact 0 is open and contact 1 carries 3/4 at (1, -1), which slips nowhere: all friction is zero."""
    problem = cq.ContactProblem(
        [[9.0, 6.0], [6.0, 11.0]], [2.25, -4.4375], [[-1.5, -0.5], [-1.0, 0.75]], [-0.5, -1.75],
        tangent=[[-1.0, 1.5], [0.75, 1.0]], friction=friction, slip_origin=[[-2.5], [-0.25]],
    )  # fmt: skip
    forces = np.where(np.arange(2) == contact, stray, 0.0)
    found = cq.certify(problem, [1.0, -1.0], [0.0, 0.75], forces, tolerance=0.9, error_tolerance=1e3)
    assert found.force_bound is not None
    assert found.force_error is not None
    assert found.force_bound[contact] >= stray
    # In the norm of the compliance: both sizes are square roots of what 63 times the inverse of K makes of the rows.
    along, pushed = np.array([-1.0, 1.5]) if contact == 0 else np.array([0.75, 1.0]), 0.75 * np.array([-1.0, 0.75])
    adjugate = np.array([[11.0, -6.0], [-6.0, 9.0]])
    assert found.force_error >= (1 - 1e-9) * stray * np.sqrt(along @ adjugate @ along / (pushed @ adjugate @ pushed))


def test_stray_friction_is_compared_with_the_contact_forces_beside_a_body_that_is_strained_far_more() -> None:
    """1e-6 presses beside a body that 1 strains: a stray friction of 1e-9 is a thousandth of all contact forces."""
    problem = cq.ContactProblem(
        np.eye(3), [1.0, 0.0, 1e-6], [[0.0, 0.0, 1.0]], [0.0], tangent=[[0.0, 1.0, 0.0]], friction=0.0
    )
    found = cq.certify(problem, [1.0, 0.0, 0.0], [1e-6], [1e-9], tolerance=0.9, error_tolerance=1e3)
    assert found.force_error is not None
    assert found.force_error >= 1e-3 * (1 - 1e-9)
    assert not cq.certify(problem, [1.0, 0.0, 0.0], [1e-6], [1e-9]).passed


@pytest.mark.parametrize("stray", [1e-13, 1e-10])
def test_bounds_contain_stray_friction_on_a_support(stray: float) -> None:
    """It moves nothing, but without a coefficient of friction no value within the cone but zero is right."""
    problem = cq.ContactProblem(
        [[2.0, 0.0], [0.0, 1.0]], [3.0, 1.0], [[1.0, 0.0], [0.0, 1.0]], [1.0, 0.5],
        tangent=[[0.0, 0.0], [0.0, 0.0]], friction=[0.0, 0.5],
    )  # fmt: skip
    found = cq.certify(problem, [1.0, 0.5], [1.0, 0.5], [stray, 0.0])
    assert found.force_bound is not None
    assert found.force_bound[0] >= stray
