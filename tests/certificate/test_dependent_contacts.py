"""Contacts that hardly differ, their truth known exactly: no bound is less than the error, and no error is hidden."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate.admissible_pair import least_forces, least_retreat
from contactqp.linalg import convexity
from contactqp.linalg.convexity import overlap_by_rounding
from contactqp.linalg.exact_algebra import contradiction
from contactqp.linalg.nonnegative import least_closing
from contactqp.model.solution import Solution


def solution_of(problem: cq.ContactProblem) -> Solution:
    try:
        return cq.solve(problem)
    except cq.NotCertified as refused:
        return refused.solution


def corner(angle: float) -> cq.ContactProblem:
    """u* = (0, -1) and λ* = (3, 5) exactly, f = K u* + E'λ*, while 1 + 5 θ is a double."""
    return cq.ContactProblem(
        [[4.0, -1.0], [-1.0, 5.0]], [1.0 + 5.0 * angle, -13.0], [[0.0, -1.0], [angle, -1.0]], [1.0, 1.0]
    )


def wedge(angle: float, load: float) -> cq.ContactProblem:
    """u_1 <= 1 and u_1 >= 1 + θ u_2 leave no u_2 > 0 however small θ is: u* = (1, 0)."""
    return cq.ContactProblem([[1.0, 0.0], [0.0, 1.0]], [0.0, load], [[1.0, 0.0], [-1.0, angle]], [1.0, -1.0])


@pytest.mark.sampled(12)
@pytest.mark.parametrize("exponent", range(30, 51))
def test_bounds_cover_the_errors_of_nearly_parallel_contacts(exponent: int) -> None:
    problem = corner(2.0**-exponent)
    found = solution_of(problem)
    certificate = found.certificate
    assert certificate.energy_error is not None
    assert certificate.force_error is not None
    du = found.displacement - [0.0, -1.0]
    K, resultant = problem.stiffness, problem.normal.T @ (found.normal_force - [3.0, 5.0])
    whole = problem.normal.T @ np.array([3.0, 5.0])
    assert np.sqrt(du @ (K @ du)) / np.sqrt(5.0) <= certificate.energy_error
    inverse = np.linalg.inv(K)
    assert np.sqrt(resultant @ inverse @ resultant / (whole @ inverse @ whole)) <= certificate.force_error


@pytest.mark.slow
@pytest.mark.parametrize("exponent", [43, 44, 45, 46, 47])
@pytest.mark.parametrize("load", [0.0625, 0.25, 1.0])
def test_a_wedge_that_hardly_narrows_still_holds(exponent: int, load: float) -> None:
    """The forces that hold it are load / θ each: an answer without them, which lets the body move, must not pass."""
    problem = wedge(2.0**-exponent, load)
    found = cq.solve(problem)
    assert found.certificate.passed
    np.testing.assert_allclose(found.displacement, [1.0, 0.0], rtol=0, atol=1e-15)
    carried = load * 2.0**exponent
    np.testing.assert_allclose(found.normal_force, [carried - 1.0, carried], rtol=1e-12)
    assert not cq.certify(problem, [1.0, load], [0.0, 0.0]).passed


@pytest.mark.parametrize("exponent", [50, 51, 52])
def test_what_the_last_place_of_a_gap_decides_is_not_proven(exponent: int) -> None:
    """A gap that is one unit in its last place wider lets the body slip in by a quarter of the truth or more."""
    certificate = solution_of(wedge(2.0**-exponent, 1.0)).certificate
    assert not certificate.proven
    assert certificate.energy_error is None
    assert "conflict by" in certificate.reasons[0]


@pytest.mark.parametrize("length", [1.0, 2.0**-10, 2.0**20])
def test_a_conflict_by_rounding_is_stated_as_one_beside_a_bound_of_zero(length: float) -> None:
    """At y = 0 two slopes leave x <= 0.48 less a rounding and x >= 0.48: no length but rounding meets at the floor."""
    gap = length * np.array([0.33599999999999997, -0.048, 0.0, 0.0])
    rows = [[0.7, 0.6], [-0.1, 0.4], [-1.0, 0.0], [0.0, -1.0]]
    problem = cq.ContactProblem(np.diag([0.0, 3.0 / length]), [0.007, -0.674], rows, gap)
    with pytest.raises(cq.NoEquilibrium):
        cq.exact(problem)
    certificate = cq.solve(problem).certificate
    assert certificate.passed
    assert not certificate.proven
    stated = re.search(r"conflict by (\S+) of their lengths", certificate.reasons[0])
    assert stated is not None
    assert 0 < float(stated[1]) < 1e-15


@pytest.mark.parametrize("scale", [1.0, 3.0, 1 / 7])
@pytest.mark.parametrize("gap", [0.3, 0.1 + 0.2])
def test_redundant_contacts_whose_gaps_differ_by_rounding_are_proven(scale: float, gap: float) -> None:
    row = np.array([0.6, 0.8])
    problem = cq.ContactProblem(np.diag([2.0, 3.0]), [5.0, 1.0], [row, scale * row], [0.3, scale * gap])
    certificate = cq.solve(problem).certificate
    assert certificate.passed
    assert certificate.proven


def test_a_body_between_walls_that_touch_it_to_rounding_is_right() -> None:
    """0.1 + 0.2 > 0.3: the walls overlap by half an ulp, which is no conflict, and nothing that could be proven."""
    problem = cq.ContactProblem(np.diag([2.0, 3.0]), [5.0, 1.0], [[1.0, 0.0], [-1.0, 0.0]], [0.3, -(0.1 + 0.2)])
    certificate = cq.solve(problem).certificate
    assert certificate.passed
    assert not certificate.proven


def wall_beside_a_bed(random: np.random.Generator) -> cq.ContactProblem:
    """One unknown between two walls without room; beside it a bed of springs that its load holds against stops at 0."""
    spring, bed = random.uniform(1.0, 3.0, 3), np.zeros((5, 5))
    for i, stiffness in enumerate(spring, start=1):
        bed[i : i + 2, i : i + 2] += stiffness * np.array([[1.0, -1.0], [-1.0, 1.0]])
    stiffness = bed + np.diag([5.0, *random.uniform(50.0, 900.0, 4)])
    rows = np.eye(5)[[0, 0, 2, 4]] * [[1.0], [-1.0], [1.0], [1.0]]
    return cq.ContactProblem(stiffness, [6.0, 0.0, 0.07, 0.0, 0.01], rows, [1.0, -1.0, 0.0, 0.0])


@pytest.mark.sampled(6)
@pytest.mark.parametrize("seed", range(12))
def test_noise_of_a_body_at_rest_is_not_measured_by_itself(seed: int) -> None:
    """u* = (1, 0, 0, 0, 0), λ* = (1, 0, 0.07, 0.01): what hardly moves there hides nothing of the walls' forces."""
    random = np.random.default_rng(seed)
    problem = wall_beside_a_bed(random)
    noise = 2.0**-51 / np.sqrt(problem.diagonal) * random.normal(size=5)
    truth, force = np.array([1.0, 0.0, 0.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.07, 0.01])
    certificate = cq.certify(problem, truth + noise, force)
    assert certificate.passed
    assert certificate.energy_error is not None
    assert certificate.energy_error < 1e-14
    for moved in (1e-4, 1e-6):
        certificate = cq.certify(problem, truth + noise + [0.0, 0.0, -moved, 0.0, 0.0], force)
        assert not certificate.passed


def test_the_least_retreat_opens_by_what_is_asked() -> None:
    rows, tie = np.array([[3.0, 4.0, 0.0], [6.0, 8.0, 0.0]]), np.array([[0.0, 0.0, 1.0]])
    moved = least_retreat(rows, tie, np.array([5.0, 0.0]))
    assert moved is not None
    np.testing.assert_allclose(moved, [-0.6, -0.8, 0.0], atol=1e-12)


def test_there_is_no_retreat_between_walls() -> None:
    assert least_retreat(np.array([[1.0], [-1.0]]), np.zeros((0, 1)), np.array([1.0, 0.0])) is None


def test_the_least_closing_tells_rows_apart_that_their_products_do_not() -> None:
    moved = least_closing(np.array([[1.0, 0.0], [-1.0, 1e-13]]), np.zeros((0, 2)), np.array([0.0, 1e-13]))
    np.testing.assert_allclose(moved, [0.0, -1.0], atol=1e-2)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("fall", [1e-3, 1.0, 1e3])
def test_a_body_that_falls_onto_two_stops_at_each_node_is_right(fall: float) -> None:
    """Gaps that differ in their last place: the energy of forces over them is no error of the displacement."""
    n, random = 20, np.random.default_rng(1)
    chain = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    chain[0, 0] = chain[-1, -1] = 1.0
    once = fall + 0.01 * random.random(n)
    gap = np.append(once, np.nextafter(once, np.where(random.random(n) < 0.5, -np.inf, np.inf)))
    problem = cq.ContactProblem(chain, 1e-2 * random.random(n), np.vstack([np.eye(n), np.eye(n)]), gap)
    certificate = cq.solve(problem).certificate
    assert certificate.proven
    assert certificate.energy_error is not None
    assert certificate.energy_error < 1e-9
    exact = cq.exact(problem).doubles.displacement
    du, K = cq.solve(problem).displacement - exact, problem.stiffness
    assert du @ (K @ du) <= (certificate.energy_error + 1e-12) ** 2 * (exact @ (K @ exact))


def test_forces_are_moved_to_rows_that_hold_them_and_stay_forces() -> None:
    rows = np.array([[1.0, 0.0], [1.0, 1.0]])
    np.testing.assert_allclose(least_forces(rows, np.zeros((0, 2)), np.array([3.0, 2.0])), [1.0, 2.0], rtol=1e-12)
    np.testing.assert_allclose(least_forces(rows, np.zeros((0, 2)), np.array([-3.0, 0.0])), [0.0, 0.0], atol=1e-15)
    tied = least_forces(rows, np.array([[0.0, 1.0]]), np.array([3.0, 7.0]))
    assert tied is not None
    assert tied.sum() == pytest.approx(3.0)


@pytest.mark.sampled(7)
@pytest.mark.parametrize("squeeze", [1.0, 1e6, 1e8, 1e10, 1e12, 1e14, 1e17])
def test_what_two_walls_exert_on_each_other_hides_no_load(squeeze: float) -> None:
    """A load of 0.5 that the walls do not balance is refused however they squeeze; balanced, it passes while they can.

    Nothing is elastic, and with friction there are no bounds: the figures alone must see it.
    """
    problem = cq.ContactProblem(
        np.zeros((2, 2)), [0.5, 0.5], [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]], [1.0, -1.0, 0.0],
        tangent=[[0.0, 1.0], [0.0, 1.0], [1.0, 0.0]], friction=[0.5, 0.5, 0.0],
    )  # fmt: skip
    friction = np.zeros((3, 1))
    assert not cq.certify(problem, [1.0, 0.0], [squeeze, squeeze, 0.5], friction).passed
    if squeeze < 1e15:  # beyond, 0.5 is less than the last place of the forces
        assert cq.certify(problem, [1.0, 0.0], [squeeze + 0.5, squeeze, 0.5], friction).passed


@pytest.mark.slow
@pytest.mark.parametrize("squeeze", [1e8, 1.0, 1e14])
def test_what_two_walls_exert_on_each_other_hides_no_load_in_space(squeeze: float) -> None:
    across = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    problem = cq.ContactProblem(
        np.zeros((3, 3)), [0.5, 0.0, 0.5], [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [1.0, -1.0, 0.0],
        tangent=[*across, *across, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], friction=[0.5, 0.5, 0.0],
    )  # fmt: skip
    friction = np.zeros((3, 2))
    assert not cq.certify(problem, [1.0, 0.0, 0.0], [squeeze, squeeze, 0.5], friction).passed
    assert cq.certify(problem, [1.0, 0.0, 0.0], [squeeze + 0.5, squeeze, 0.5], friction).passed


@pytest.mark.parametrize("squeeze", [1e6, 1e9, 1e12])
def test_forces_that_cancel_excuse_no_load_of_an_elastic_body_either(squeeze: float) -> None:
    problem = cq.ContactProblem(
        np.diag([4.0, 3.0]), [6.0, 1.0], [[1.0, 0.0], [-1.0, 0.0]], [1.0, -1.0],
        tangent=[[0.0, 1.0], [0.0, 1.0]], friction=0.0,
    )  # fmt: skip
    u = [1.0, 1 / 3]
    assert cq.certify(problem, u, [2 + squeeze, squeeze], np.zeros((2, 1))).passed
    assert not cq.certify(problem, u, [2.01 + squeeze, squeeze], np.zeros((2, 1))).passed


@pytest.mark.slow
@pytest.mark.parametrize("method", ["active-set", "lemke", "lagrange-multiplier", "master-slave"])
def test_a_body_that_only_moves_onto_skew_seats_is_right_however_they_share(method: str) -> None:
    """Gaps as doubles round them leave open which of the seats carry; the body is not strained by that."""
    points, K = np.array([[0, 0], [1, 0], [0, 1.0]]), np.zeros((6, 6))
    for a, b in ((0, 1), (0, 2), (1, 2)):
        along = (points[a] - points[b]) / np.hypot(*(points[a] - points[b]))
        row = np.zeros(6)
        row[2 * a : 2 * a + 2], row[2 * b : 2 * b + 2] = along, -along
        K += 1e6 * np.outer(row, row)
    seats = np.array(
        [[0, 0, 0, 0, 1, 0], [0, 0, 0.866025, 0.5, 0, 0], [0, 0, 0.866025, -0.5, 0, 0], [0, 0, 1, 0, 0, 0]]
    )
    fall, push = np.array([-0.0074, 0, -0.0074, 0.002, -0.0094, 0]), np.array([200.0, 0, 400, 600])
    problem = cq.ContactProblem(K, seats.T @ push, seats, seats @ fall)
    found = cq.solve(problem, method)
    assert found.displacement == pytest.approx(fall, abs=1e-15)
    strained = found.displacement + np.array([0, 1e-8, 0, 0, 0, 0])  # 1e-6 of the fall
    assert not cq.certify(problem, strained, found.normal_force).passed
    pulled = found.normal_force + np.array([0, 0, 0, -1e-3]) @ np.diag([0, 0, 0, 1.0])
    assert not cq.certify(problem, found.displacement, pulled).passed


def moved_onto_skew_seats(seed: int) -> tuple[cq.ContactProblem, np.ndarray]:
    """A free truss that falls onto seats at random angles, some of which push; gaps at its place are rounding."""
    rng = np.random.default_rng(seed)
    points = np.array([(i, j) for j in (0, 1) for i in range(3)]) + rng.uniform(-0.1, 0.1, (6, 2))
    K = np.zeros((12, 12))
    for a in range(6):
        for b in range(a):
            apart = points[a] - points[b]
            if np.hypot(*apart) < 1.7:
                row = np.zeros(12)
                row[2 * a : 2 * a + 2] = apart / np.hypot(*apart)
                row[2 * b : 2 * b + 2] = -row[2 * a : 2 * a + 2]
                K += 1e6 * rng.uniform(0.5, 2) * np.outer(row, row)
    turn = np.column_stack([-points[:, 1], points[:, 0]]).ravel()
    fall = np.tile(-(10.0 ** rng.uniform(-5, -1, 2)), 6) + 10 ** rng.uniform(-5, -2) * turn
    seats = np.zeros((5, 12))
    for row in seats:
        node, angle = 2 * int(rng.integers(6)), rng.uniform(0, 2 * np.pi)
        row[node : node + 2] = np.cos(angle), np.sin(angle)
    push = (rng.random(5) < 0.6) * rng.uniform(1, 100, 5)
    return cq.ContactProblem(K, seats.T @ push, seats, seats @ fall), fall


@pytest.mark.slow
@pytest.mark.parametrize("method", ["active-set", "daqp", "lemke"])
def test_a_body_that_touches_on_all_sides_stays_where_it_is(method: str) -> None:
    """Along a motion that contacts touch on both sides there is no room, though rounding says less than none."""
    held = 0
    for seed in range(40):
        problem, fall = moved_onto_skew_seats(seed)
        if not np.any(problem.load):
            continue
        found = cq.solve(problem, method)
        assert found.work.routes == ()
        assert np.min(found.gap) >= -1e-15
        held += np.max(abs(found.displacement - fall)) <= 1e-12
    assert held >= 10


def table_on_four_legs() -> cq.ContactProblem:
    """A rigid table, 10 in its middle: legs NE, SE, NW, SW, whose forces are 5 - x, x, x, 5 - x for x from 0 to 5."""
    at = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
    rows = np.column_stack([-np.ones(4), -at[:, 1], at[:, 0]])
    return cq.ContactProblem(np.zeros((3, 3)), [-10.0, 0.0, 0.0], rows, np.zeros(4))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("method", ["active-set", "lemke", "piqp"])
def test_forces_that_are_not_unique_are_said_to_be_so(method: str) -> None:
    solution = cq.solve(table_on_four_legs(), method=method)
    (note,) = [note for note in solution.certificate.notes if note.startswith("forces are not unique")]
    assert bool(solution.certificate.grazing) == ("may press in another" in note)
    assert "forces are not unique" in str(solution)
    lowest, highest = np.array(cq.exact(table_on_four_legs()).force_range, dtype=float).T
    assert (lowest.tolist(), highest.tolist()) == ([0.0] * 4, [5.0] * 4)


def test_unique_forces_have_no_such_note() -> None:
    problem = table_on_four_legs()
    three = problem.with_contacts(np.array([0, 1, 2]))
    solution = cq.solve(three.replace(load=[-10.0, -2.0, 2.0]))
    assert not any("not unique" in note for note in solution.certificate.notes)


@pytest.mark.slow
def test_contacts_that_graze_and_can_never_press_are_no_other_forces() -> None:
    """Two equal rows touch beside a tie that neither load nor stiffness pushes: all forces are zero, and unique."""
    rows, gap = [[0.0, 1.0], [1.0, -1.0], [0.0, 1.0], [0.0, -1.0], [-1.0, -1.0]], [-1.0, 3.0, -1.0, 2.0, 1.0]
    problem = cq.ContactProblem.from_qp(np.zeros((2, 2)), [0.0, 0.0], G=rows, h=gap, A=[[-1.0, 1.0]], b=[-2.0])
    solution = cq.solve(problem)
    assert (solution.certificate.grazing, cq.exact(problem).unique_forces) == ((0, 2), True)
    assert not any("unique" in note for note in solution.certificate.notes)
    # A load on both rows, with more than enough contacts to carry it, is shared in many ways.
    pushed = cq.solve(problem.replace(load=[0.0, 1.0]))
    assert any(note.startswith("forces are not unique") for note in pushed.certificate.notes)


@pytest.mark.slow
def test_a_contact_that_grazes_may_press_beside_others_that_already_do() -> None:
    """A block on its two edges and between them: its weight rests on the edges, or in part between them."""
    rows = [[-1.0, 1.0], [-1.0, 0.0], [-1.0, -1.0]]
    problem = cq.ContactProblem(np.zeros((2, 2)), [-2.0, 0.0], rows, np.zeros(3))
    for force in ([1.0, 0.0, 1.0], [0.0, 2.0, 0.0]):
        (note,) = cq.certify(problem, np.zeros(2), force).notes[-1:]
        assert note.endswith("those that graze here may press in another")
    # Without a load nothing presses, and nothing can.
    idle = cq.certify(problem.replace(load=np.zeros(2)), np.zeros(2), np.zeros(3))
    assert idle.passed
    assert not any("unique" in note for note in idle.notes)


@pytest.mark.slow
def test_whether_forces_are_unique_is_told_in_any_units_of_rows() -> None:
    """Rows of 1e195 and 1e-201 made a matrix beyond the range of doubles; a right answer was refused for it."""
    rows = [[9e195, 0.0], [3e-173, 0.0], [0.0, 1.6e-201]]
    problem = cq.ContactProblem(np.diag([7.0, 0.0]), [0.0, 1.8e-07], rows, [0.0, 0.0, -1e-201])
    solution = cq.solve(problem)
    assert solution.certificate.passed
    assert solution.normal_force[2] == pytest.approx(1.8e-7 / 1.6e-201)


@pytest.mark.slow
def test_a_grazing_contact_that_is_nearly_parallel_to_one_that_presses_is_left_out() -> None:
    """Two ties and two contacts hold a lattice that floats; noise of rounding counts the third contact as closed."""
    lower = {
        (0, 0): 228, (1, 0): 156, (1, 1): 436, (2, 0): -72, (2, 2): 73.0625, (3, 2): -1.0625, (3, 3): 117.0625,
        (4, 2): -1.0625, (4, 3): 1.0625, (4, 4): 16.0625, (5, 1): -280, (5, 2): 1.0625, (5, 3): -1.0625,
        (5, 4): -1.0625, (5, 5): 281.0625, (6, 0): -156, (6, 1): -156, (6, 4): -15, (6, 6): 171, (7, 0): -156,
        (7, 1): -156, (7, 3): -116, (7, 6): 156, (7, 7): 272,
    }  # fmt: skip
    K = np.zeros((8, 8))
    for (i, j), entry in lower.items():
        K[i, j] = K[j, i] = entry
    normal = np.zeros((3, 8))
    normal[[0, 2], 4] = normal[1, 7] = -1.0
    normal[2, 0] = 2.0**-23
    tie = np.array([[1.5, 0, -1, -0.5, 0.5, 1, -1, -0.5], [1, 1, 0, 0.5, -1, 0, 1, 0]])
    u, force, tied = np.array([-7, -2, 5, 1, 8, -5, -2, 6]) / 8, np.array([0, 326, 0.75 * 2**-9]), np.array([0, -0.25])
    load = K @ u + normal.T @ force + tie.T @ tied
    problem = cq.ContactProblem(K, load, normal, normal @ u, tie=tie, tie_value=tie @ u)
    for seed in range(8):
        noise = 2.0**-47 * np.random.default_rng(seed).normal(size=8) / np.sqrt(np.diag(K))
        certificate = cq.certify(problem, u + noise, force, tie_force=tied)
        assert certificate.proven, certificate.failures


SQUEEZED: dict[str, dict[str, Any]] = {
    "a contact that says the same twice, the last digit apart": dict(
        stiffness=[[1e-6, 0.0, -2e-6], [0.0, 0.0, 0.0], [-2e-6, 0.0, 4e-6]],
        load=[-1.0000000013, 2.0, 0.7000000026],
        normal=[[0.0, 2.0, 0.0], [0.0, -4.0, 0.0]],
        gap=[-0.0014, 0.0027999999999999995],
        tie=[[-1.0, 2.0, 0.7]],
        tie_value=[-0.00049],
    ),
    "two contacts and a tie": dict(
        stiffness=[[2.0, -1.0], [-1.0, 1.0]],
        load=[3.1, 6.6],
        normal=[[0.0, 1.0], [0.3, 2.0], [-0.15, -3.0]],
        gap=[0.0, 0.03, -0.015],
        tie=[[2.0, 0.7]],
        tie_value=[0.2],
    ),
}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("condense", [True, False])
@pytest.mark.parametrize("what", SQUEEZED)
def test_contacts_that_overlap_by_rounding_prove_nothing(what: str, condense: bool) -> None:
    """Taken exactly the rows contradict each other, so that no solution is there to be near; no digit is wrong."""
    problem = cq.ContactProblem(**SQUEEZED[what])
    with pytest.raises(cq.NoEquilibrium, match="proven in rational numbers"):
        cq.exact(problem, enclose=False)
    certificate = cq.solve(problem, condense=condense).certificate
    assert certificate.passed
    assert not certificate.proven
    assert certificate.scope is None
    assert "overlap" in certificate.reasons[0] or "conflict" in certificate.reasons[0]


def test_contacts_that_touch_exactly_are_proven_though_they_depend_on_each_other() -> None:
    """The same rows without the last digit: -4 u <= -2 (2 u) holds exactly, and the answer is proven."""
    node = cq.ContactProblem([[1.0]], [2.0], [[1.0], [-4.0]], [0.7, -4 * 0.7])
    assert cq.exact(node).gap.tolist() == [0, 0]
    assert cq.solve(node).certificate.proven


@pytest.mark.slow
@pytest.mark.parametrize("turned", [1e-11, 1e-12])
def test_ties_that_nearly_depend_on_each_other_are_named_where_nothing_is_certified(turned: float) -> None:
    """Their forces are 1 / turned, of which doubles leave no digits: the message says which rows to change."""
    rows = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, turned, 0.0]]
    names = ["left", "apart", "right"]
    ties = dict(tie=rows, tie_value=[0.5, 0.0, 0.5 + 1e-7], tie_names=names)
    problem = cq.ContactProblem(np.diag([2.0, 3.0, 1.0]), [3.0, 1.0, 0.0], np.zeros((0, 3)), [], **ties)
    with pytest.raises(cq.NotCertified, match=r"the rows of left, right depend on each other but for .* leave one of"):
        cq.solve(problem)


@pytest.mark.parametrize("seed", [1, 10])
def test_a_row_written_twice_in_other_units_is_redundant_beside_unknowns_without_stiffness(seed: int) -> None:
    """Steps fitted to whole numbers by sums of sizes, min sum |x_i - y_i| + sum |x_{i+1} - x_i|, in units
    of many sizes.

    Factors with little on the diagonal round as much as a repeated row responds. Its forces had been called unique,
    and the answer was refused as each copy may carry what the other does.
    """
    n, rng = 15, np.random.default_rng(seed)
    y, one, none = rng.integers(-9, 10, n), np.eye(n), np.zeros((n, n - 1))
    steps, zero, each = np.diff(one, axis=0), np.zeros((n - 1, n)), np.eye(n - 1)
    rows = np.block([[one, -one, none], [-one, -one, none], [steps, zero, -each], [-steps, zero, -each]])
    rows, limit = np.vstack([rows, rows[-1] / 2]), np.concatenate([y, -y, np.zeros(2 * n - 1)])
    unit, weight = 10.0 ** rng.integers(-3, 4, 3 * n - 1), 10.0 ** rng.integers(-2, 3, len(rows))
    cost = unit * np.concatenate([np.zeros(n), np.ones(2 * n - 1)])
    rows = rows * unit * weight[:, None]
    solution = cq.solve(cq.ContactProblem.from_qp(np.zeros((len(cost),) * 2), cost, rows, limit * weight))
    levels = np.arange(-9, 10)  # the least sums are reached at levels of the data
    least = abs(levels - y[0])
    for value in y[1:]:
        least = np.min(least + abs(levels[:, None] - levels), axis=1) + abs(levels - value)
    assert solution.certificate.proven
    assert solution.energy == pytest.approx(min(least), rel=1e-12)


def test_rows_that_unknowns_tell_apart_are_not_eliminated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows that act on unknowns of their own, one after the other, are independent; others are examined still."""
    asked: list[int] = []

    def counted(rows: Any, limits: Any, signed: int) -> Any:
        asked.append(len(rows))
        return contradiction(rows, limits, signed)

    monkeypatch.setattr(convexity, "contradiction", counted)
    nodes = cq.ContactProblem(4 * np.eye(4), np.ones(4), np.eye(4)[:3], np.zeros(3), tie=[[0, 0, -1.0, 1.0]])
    assert overlap_by_rounding(nodes) is None
    squeezed = cq.ContactProblem(np.eye(3), np.ones(3), [[1.0, 0, 1], [-1, 0, -1], [0, 1, 0]], [0.0, -(2.0**-50), 1.0])
    assert overlap_by_rounding(squeezed, np.array([True, False, True])) is None
    assert asked == []
    assert "contact 0, contact 1 (weighted) overlap by 8.9e-16" in str(overlap_by_rounding(squeezed))
    assert asked == [3]


@pytest.mark.parametrize("seed", range(4))
def test_rows_of_few_entries_contradict_each_other_as_their_elimination_says(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng, found = np.random.default_rng(seed), {True: 0, False: 0}
    for _ in range(60):
        n, m = int(rng.integers(2, 6)), int(rng.integers(1, 5))
        rows = rng.integers(-1, 2, (m + 1, n)) * (rng.random((m + 1, n)) < 0.6)
        limits = rng.integers(-1, 2, m + 1).astype(float)
        rows[np.arange(m + 1), rng.integers(0, n, m + 1)] = 1.0
        problem = cq.ContactProblem(np.eye(n), np.ones(n), rows[:m], limits[:m], tie=rows[m:], tie_value=limits[m:])
        near = rng.random(m) < 0.8
        quickly = overlap_by_rounding(problem, near)
        with monkeypatch.context() as always:
            always.setattr(convexity, "_independent_by_unknowns", lambda *_: False)
            assert quickly == overlap_by_rounding(problem, near)
        found[quickly is None] += 1
    assert min(found.values()) >= 3, found
