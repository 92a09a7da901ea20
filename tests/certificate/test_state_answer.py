"""With friction the answer of the candidate's own combination of open, stick and slip judges its forces."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from benchmarks.friction_families import contact_problem
from benchmarks.friction_forgeries import FAMILIES, beam, forged, rough_stops
from contactqp.certificate import state_answer
from contactqp.model.solution import FIGURES
from tests.solving.friction.space import several


def _worst_figure(certificate: cq.Certificate) -> float:
    return max(float(getattr(certificate, name)) for name in FIGURES)


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("family", "seed"), [("tip 2D", 0), ("stops 2D", 1), ("tip 3D", 8), ("stops 3D", 2)])
def test_a_wrong_force_that_breaks_no_figure_is_refused(family: str, seed: int) -> None:
    problem, part = rough_stops(family, seed), 2e-4
    certificate = cq.certify(problem, *forged(problem, cq.solve(problem), part))
    assert _worst_figure(certificate) <= certificate.tolerance
    assert not certificate.passed
    assert certificate.basis == "state"
    assert certificate.distance == pytest.approx(part, rel=0.2)
    assert any(failure.startswith("state: ") for failure in certificate.failures)


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("axial", "status"), [(0.0, "stick"), (1.0, "slip")])
@pytest.mark.parametrize("part", [0.5, 1e-4, 3e-6])
def test_a_contact_force_half_as_large_again_under_a_slender_cantilever_is_refused(
    part: float, axial: float, status: str
) -> None:
    """400 elements on a rough stop at the tip: its stiffness hides the residual of a force that is 50 % off."""
    elements = 400
    tip, load, normal, tangent = 3 * (elements - 1), *np.zeros((3, 3 * elements))
    load[1::3], load[tip], normal[tip + 1], tangent[tip] = -1 / elements, axial, -1.0, 1.0
    problem = cq.ContactProblem(beam(elements, 1, 300.0), load, [normal], [0.01], tangent=[tangent], friction=0.3)
    solution = cq.solve(problem)
    assert solution.certificate.basis == "state"
    assert solution.contact_status.tolist() == [status]
    certificate = cq.certify(problem, *forged(problem, solution, part))
    assert _worst_figure(certificate) <= certificate.tolerance
    assert not certificate.passed
    assert certificate.distance == pytest.approx(part, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_right_answers_of_slender_bodies_pass_to_rounding(family: str) -> None:
    for seed in range(4):
        solution = cq.solve(rough_stops(family, seed))
        assert solution.certificate.passed
        assert solution.certificate.basis == "state"
        assert solution.certificate.distance is not None
        assert solution.certificate.distance < 1e-9


def _bar(gap: float, load: float, friction: float = 0.3, contacts: int = 1) -> cq.ContactProblem:
    """A point on a spring of 1000 that is pressed onto a floor `gap` away, and on a spring of 500 along it."""
    return cq.ContactProblem(
        stiffness=np.diag([1000.0, 500.0]),
        load=[load, 3.0],
        normal=np.tile([1.0, 0.0], (contacts, 1)),
        gap=np.full(contacts, gap),
        tangent=np.tile([0.0, 1.0], (contacts, 1)),
        friction=friction,
    )


def test_what_a_verdict_rests_on_without_friction() -> None:
    smooth = cq.ContactProblem(stiffness=[[2.0]], load=[3.0], normal=[[1.0]], gap=[0.5])
    certificate = cq.solve(smooth).certificate
    assert (certificate.basis, certificate.distance) == ("bounds", None)
    assert cq.certify(smooth, np.array([np.nan]), np.array([2.0])).basis == "figures"


@pytest.mark.slow
def test_redundant_forces_may_be_shared_in_any_way_that_adds_up() -> None:
    problem = _bar(1e-3, 11.0, contacts=2)
    shared = np.array([0.001, 0.0]), np.array([3.0, 7.0]), np.array([0.9, 2.1])
    certificate = cq.certify(problem, *shared)
    assert certificate.passed
    assert certificate.basis == "state"
    assert "redundant contacts: forces are compared as far as the bodies feel them" in certificate.notes
    wrong = cq.certify(problem, shared[0], np.array([3.0, 7.0 + 1e-5]), shared[2])
    assert not wrong.passed


@pytest.mark.parametrize("moved", [0.1, 0.25])
def test_a_combination_without_inverse_leaves_the_figures_alone_and_says_so(moved: float) -> None:
    """Klarbring's contact at its critical coefficient: any of a line of slips is an equilibrium."""
    problem = cq.ContactProblem([[5.0, -2.0], [-2.0, 1.0]], [-1.0, 0.5], [[-1.0, 0.0]], [0.0], [[0.0, 1.0]], 0.5)
    given = np.array([0.0, moved]), np.array([1 - 2 * moved]), np.array([0.5 - moved])
    certificate = cq.certify(problem, *given)
    assert certificate.passed
    assert certificate.basis == "figures"
    assert any("figures alone: the system of its combination" in note for note in certificate.notes)
    for part in range(3):
        wrong = [value + 1e-6 * (i == part) for i, value in enumerate(given)]
        assert not cq.certify(problem, *wrong).passed


def test_too_large_a_system_leaves_the_figures_alone_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = _bar(1e-3, 11.0)
    monkeypatch.setattr(state_answer, "MOST_OPERATIONS", 1.0)
    certificate = cq.solve(problem).certificate
    assert certificate.passed
    assert certificate.basis == "figures"
    assert any("the verdict rests on the figures alone" in note for note in certificate.notes)
    assert "figures alone" in str(certificate)


def test_where_nothing_settles_friction_is_held_and_the_minimum_judges(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = rough_stops("tip 2D", 0)
    solution = cq.solve(problem)
    monkeypatch.setattr(state_answer._Comparison, "_last_correction", lambda *_: np.inf)
    right = cq.certify(problem, solution.displacement, solution.normal_force, solution.friction_force)
    assert right.passed
    assert right.basis == "figures"
    wrong = cq.certify(problem, *forged(problem, solution, 2e-4))
    assert _worst_figure(wrong) <= wrong.tolerance
    assert any(failure.startswith("with friction held, ") for failure in wrong.failures)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("load", [1.0, 1.0 + 1e-16, 1.0 - 1e-16])
@pytest.mark.parametrize("friction", [0.3, 3.0])
def test_a_contact_that_just_touches_may_be_taken_in_either_state(load: float, friction: float) -> None:
    problem = _bar(1e-3, load, friction)
    for force in (0.0, 1e-14):
        certificate = cq.certify(problem, np.array([1e-3, 6e-3]), np.array([force]), np.array([friction * force]))
        assert certificate.passed, str(certificate)


def test_at_the_end_of_sticking_either_state_is_right() -> None:
    problem = _bar(1e-3, 11.0, friction=0.3)  # a force of 10 whose friction bound is the load along the floor
    assert cq.certify(problem, np.array([1e-3, 0.0]), np.array([10.0]), np.array([3.0])).passed
    assert cq.certify(problem, np.array([1e-3, 1e-18]), np.array([10.0]), np.array([3.0])).passed
    assert not cq.certify(problem, np.array([1e-3, 1e-6]), np.array([10.0]), np.array([3.0])).passed


def test_a_strain_that_is_wrong_behind_a_large_gap_is_refused() -> None:
    """A bar that is soft beside its support slides one metre with it; of its strain 5 % are missing."""
    problem = cq.ContactProblem(
        stiffness=[[1e9, -1e9, 0.0], [-1e9, 1e9, 0.0], [0.0, 0.0, 1e9]],
        load=[0.0, 1.0, 0.1],
        normal=[[0.0, 1.0, 0.0]],
        gap=[1.0],
        tangent=[[0.0, 0.0, 1.0]],
        friction=0.5,
        tie=[[1.0, 0.0, 0.0]],
        tie_value=[1.0 - 0.5e-9],
    )
    solution = cq.solve(problem)
    assert solution.certificate.passed, str(solution.certificate)
    force = solution.normal_force + 0.05 * 0.5
    tie = solution.tie_force - 0.05 * 0.5
    certificate = cq.certify(problem, solution.displacement, force, solution.friction_force, tie)
    assert not certificate.passed


@pytest.mark.sampled(30)
@pytest.mark.parametrize("family", ["any 2D", "any 3D", "singular 2D", "redundant 3D", "bad units 3D"])
@pytest.mark.parametrize("seed", range(6))
def test_right_answers_pass_and_a_force_that_is_off_does_not(family: str, seed: int) -> None:
    """Coefficients of zero at some contacts, ties and slip origins are among them."""
    problem = contact_problem(family, seed).problem
    try:
        solution = cq.solve(problem)
    except cq.ContactQPError:
        pytest.skip("no answer, or several")
    assert solution.certificate.basis in ("state", "figures")
    if not np.any(solution.normal_force):
        return
    force = solution.normal_force * (1 + 1e-4)
    assert not cq.certify(problem, solution.displacement, force, solution.friction_force, solution.tie_force).passed


def test_contacts_that_slip_in_space_are_compared_along_their_slip() -> None:
    known = several(3)
    solution = cq.solve(known.problem)
    assert solution.certificate.basis == "state"
    turned = solution.friction_force + 1e-5 * solution.friction_force[:, ::-1]
    assert not cq.certify(known.problem, solution.displacement, solution.normal_force, turned).passed


@pytest.mark.slow
def test_in_space_a_redundant_contact_at_its_bound_that_does_not_slip_sticks() -> None:
    """Its slip is zero and has no direction; its twin sticks well within its bound."""
    problem = contact_problem("redundant 3D", 92).problem
    certificate = cq.solve(problem, algorithm="nsgs").certificate
    assert certificate.passed
    assert certificate.basis == "state"


def test_a_slender_body_in_space_is_solved_to_the_last_digits() -> None:
    """Its system looks singular to working precision; the least correction that fits was 4e-6 off."""
    certificate = cq.solve(rough_stops("tip 3D", 75)).certificate
    assert certificate.distance is not None
    assert certificate.distance < 1e-9


@pytest.mark.sampled(3)
@pytest.mark.parametrize("seed", range(3))
def test_contacts_far_from_the_load_of_a_bedded_rail_are_no_reason_to_deny_its_equilibrium(seed: int) -> None:
    """Displacements decay to rounding along a rail on springs; one contact, under the load, plainly slips."""
    elements, length = 400, 100.0
    h = length / elements
    K = beam(elements, 1, 30.0).toarray() * 10.0 ** (3 + seed)
    deflection = np.arange(1, len(K), 3)
    K[deflection, deflection] += 1e8 * h
    K[deflection - 1, deflection - 1] += 5e7 * h
    nodes = np.array([20, 200, 390])
    normal, tangent, load = np.zeros((3, len(K))), np.zeros((3, len(K))), np.zeros(len(K))
    normal[np.arange(3), 3 * nodes + 1], tangent[np.arange(3), 3 * nodes] = 1.0, 1.0
    load[3 * nodes[0] : 3 * nodes[0] + 2] = 9e4, 1e5
    solution = cq.solve(
        cq.ContactProblem(stiffness=K, load=load, normal=normal, gap=np.zeros(3), tangent=tangent, friction=0.3)
    )
    assert solution.certificate.passed
    assert solution.contact_status[0] == "slip"


def test_forces_that_redundant_contacts_and_ties_exert_on_each_other_excuse_no_length():
    """Two ties determine both unknowns: 1e27 that contact 1 and the ties balance must not hide that they are unmet."""
    problem = cq.ContactProblem(
        stiffness=np.diag([3.328125, 19072.0]), load=[0.00054, -0.09135],
        normal=[[1.25, -0.75], [0.75, -0.75], [0.375, -0.375]], gap=[1.2e-6, 2.1e-6, 4.9e-6],
        tangent=[[0.0, 1.0], [1.5, 0.25], [0.75, 0.125]], friction=[1.0, 0.125, 0.125],
        slip_origin=[[-9.5e-7], [-4.1e-6], [-5.8e-6]], tie=[[-1.0, 0.5], [0.5, 0.5]], tie_value=[-4.8e-7, -3.3e-6],
    )  # fmt: skip
    pushed, rubbed = [0, 2.9514191065171256e27, 0], [0, -3.689273883146407e26, 0]
    judged = cq.certify(problem, np.zeros(2), pushed, rubbed, [2.6439796162549247e27, 1.9676127376780836e27])
    assert not judged.passed
    assert judged.tie > 0.1
    assert judged.complementarity > 0.1


@pytest.mark.sampled(4)
@pytest.mark.parametrize("far", [0.0, 1e6, 1e12, 1e13, 1e14, 1e15])
def test_a_wrong_answer_far_away_hides_behind_no_rounding(far: float) -> None:
    """Two masses on a spring whose contact presses with 0.85: an open one is refused, however far both have moved."""
    problem = cq.ContactProblem(
        [[66.0, -66.0], [-66.0, 66.0]], [-48.015625, 48.015625], [[1.0, -1.0]], [-0.75],
        tangent=[[0.5, -0.5]], friction=1.5, slip_origin=[[-0.375]],
    )  # fmt: skip
    right = cq.solve(problem)
    assert right.normal_force[0] > 0.8
    stretched = 48.015625 / 66 / 2
    wrong = np.array([far - stretched, far + stretched])
    assert not cq.certify(problem, wrong, [0.0], [[0.0]]).passed
    assert cq.certify(problem, right.displacement + far, right.normal_force, right.friction_force).passed


@pytest.mark.sampled(21)
@pytest.mark.parametrize("gap", [1e3, 1e9, 1e12, 1e13, 1e14, 1e16, 1e20])
@pytest.mark.parametrize("units", [1e-9, 1.0, 1e12])
def test_beside_a_gap_that_a_body_crosses_rigidly_forces_are_not_nothing(gap: float, units: float) -> None:
    """Two masses on a spring fall onto rough ground: 2 and 1 are right, 3 and 0 leave one in the ground by 1."""
    problem = cq.ContactProblem(
        units * np.kron([[1.0, -1.0], [-1.0, 1.0]], np.eye(2)), np.multiply(units, [1.0, -2.0, 0.5, -1.0]),
        [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, -1.0]], [gap, gap],
        tangent=[[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]], friction=0.9,
    )  # fmt: skip
    assert cq.solve(problem).normal_force == pytest.approx(np.multiply(units, [2.0, 1.0]))
    fallen = np.array([0.0, -gap, 0.5, -gap])
    forces = np.multiply(units, [3.0, 0.0]), np.multiply(units, [[1.5], [0.0]])
    assert not cq.certify(problem, fallen - [0.0, 0.0, 0.0, 1.0], *forces).passed


@pytest.mark.slow
@pytest.mark.parametrize(("off", "passes"), [(0.0, True), (1e-17, True), (-3e-17, True), (1e-6, False), (-1e-6, False)])
def test_where_nothing_is_stiff_lengths_are_held_against_the_largest(off: float, passes: bool) -> None:
    problem = cq.ContactProblem(
        np.zeros((2, 2)), [0.1875, 0.1240234375], [[-0.5, 0.0], [0.0, -0.5], [0.0, -0.5], [0.0, 0.5]],
        [-0.3125, 0.1875, 0.0, 0.0], tie=[[0.75, 0.5], [-0.125, 0.5]], tie_value=[0.75, -0.125],
    )  # fmt: skip
    tie = np.linalg.solve(problem.tie.toarray().T, problem.load)
    assert cq.certify(problem, [1.0, off], np.zeros(4), None, tie).passed is passes
    assert cq.solve(problem).certificate.passed


def test_a_contact_at_its_bound_that_hardly_slips_is_taken_to_slip_where_that_is_near() -> None:
    """A slip just below what counts as one, all of the friction, and forces just above nothing: to stick there would
    take other forces."""
    stiffness = np.array([[1.0, 1e-3, 0.0], [1e-3, 1.0, 0.2], [0.0, 0.2, 1.0]])
    moved, push = np.array([1.0, 0.0, 0.8e-12]), 3e-12
    friction = 0.3 * push
    load = stiffness @ moved + [0.0, push, friction]
    problem = cq.ContactProblem(stiffness, load, [[0.0, 1, 0]], [0.0], tangent=[[0.0, 0, 1]], friction=0.3)
    assert cq.certify(problem, moved, [push], [friction]).passed
    assert not cq.certify(problem, moved, [10 * push], [10 * friction]).passed
    assert not cq.certify(problem, moved + np.array([0, 0, 1e-6]), [push], [friction]).passed
    assert not cq.certify(problem, moved, [push + 1e-6], [friction]).passed


def fallen(far: float, mu: float, load: list[float]) -> cq.ContactProblem:
    """Two nodes, tied by a spring alone, that fall far onto a floor, each with its own load."""
    return cq.ContactProblem(
        np.kron([[1.0, -1.0], [-1.0, 1.0]], np.eye(2)), load,
        [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, -1.0]], [far, far],
        tangent=[[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]], friction=mu,
    )  # fmt: skip


@pytest.mark.sampled(3)
@pytest.mark.parametrize("far", [1e6, 1e12, 1e15])
def test_a_gap_that_bodies_cross_without_strain_hides_no_wrong_forces(far: float) -> None:
    """One node held up by the other penetrates by 1, with a force that is half as large again."""
    problem = fallen(far, 0.9, [1.0, -2.0, 0.5, -1.0])
    assert cq.certify(problem, [0.0, -far, 0.0, -far], [2.0, 1.0], [[1.0], [0.5]]).passed
    assert not cq.certify(problem, [0.0, -far, 0.5, -far - 1.0], [3.0, 0.0], [[1.5], [0.0]]).passed


@pytest.mark.sampled(4)
@pytest.mark.parametrize("far", [1e12, 1e16, 1e20])
def test_forces_are_right_where_doubles_hold_no_strain_beside_the_motion(far: float) -> None:
    assert cq.solve(fallen(far, 0.9, [1.0, -2.0, 0.5, -1.0])).normal_force == pytest.approx([2.0, 1.0])


def test_who_asks_for_less_is_given_it_where_a_body_moves_rigidly() -> None:
    """A block pressed onto rough ground a metre away: seven digits of a displacement pass for 1e-3, not 1e-9."""
    problem = cq.ContactProblem(
        1e3 * np.kron([[1.0, -1.0], [-1.0, 1.0]], np.eye(2)), [0.0, -2.0, 0.0, -2.0],
        [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, -1.0]], [1.0, 1.0],
        tangent=[[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]], friction=0.5,
    )  # fmt: skip
    printed = np.array([0.0, -1.0, 0.0, -1.0 + 1e-7])
    forces = [2.0, 2.0], np.zeros((2, 1))
    assert cq.certify(problem, printed, *forces, tolerance=1e-4, error_tolerance=1e-3).passed
    assert not cq.certify(problem, printed, *forces).passed


def _held_by_a_tie() -> cq.ContactProblem:
    """A contact on an unknown without stiffness that two ties hold, open: no force moves it."""
    return cq.ContactProblem(
        stiffness=[[2.0, 0.0], [0.0, 0.0]], load=[2.0, 2.0], normal=[[0.0, -1.0]], gap=[1.0], tangent=[[1.0, 0.0]],
        friction=1e3, slip_origin=[[-1.0]], tie=[[0.0, -1.0], [-1.0, 1.0]], tie_value=[-1.0, 0.0],
    )  # fmt: skip


def _masonry() -> cq.ContactProblem:
    """Five unknowns without any stiffness, held by two ties and by three contacts, of which one grazes."""
    return cq.ContactProblem(
        stiffness=np.zeros((5, 5)), load=[4.0, -3.0, -4.0, 4.0, 1.0],
        normal=[[1, 0, -1, -1, -1], [0, -1, 0, 0, -1], [-1, -1, -1, 0, 0]], gap=[2.0, 0.0, 0.0],
        tangent=[[-1, -1, 0, 0, 1], [1, 0, 0, 0, 1], [-1, 0, -1, 0, -1]], friction=[0.25, 0.25, 1e6],
        slip_origin=[[-1.0], [1.0], [0.0]], tie=[[0, 1, -1, 1, 1], [1, 0, 0, 1, 1]], tie_value=[0.0, 0.0],
    )  # fmt: skip


def _moved_without_strain() -> cq.ContactProblem:
    """A body that ties move by a whole slip and that nothing strains there."""
    K = [
        [5, -3, 5, 0, 3, 4], [-3, 3, -5, 0, -3, -3], [5, -5, 9, 0, 7, 6], [0, 0, 0, 0, 0, 0], [3, -3, 7, 0, 9, 6],
        [4, -3, 6, 0, 6, 5],
    ]  # fmt: skip
    unit = np.eye(6)
    return cq.ContactProblem(
        stiffness=np.array(K, dtype=float), load=[2.0, 0.0, -4.0, -3.0, 2.0, -4.0],
        normal=[unit[2], -unit[0], -unit[5]], gap=np.zeros(3), tangent=unit[[3, 4, 1]], friction=[8.0, 1e6, 1.0],
        slip_origin=[[0.0], [1.0], [0.0]], tie=[[1, 1, -1, 0, 1, 0], [0, 1, -1, 1, 0, 0]], tie_value=[0.0, 1.0],
    )  # fmt: skip


RIGID = [
    (_held_by_a_tie, [1.0, 1.0], [0.0], [[0.0]], [-2.0, 0.0]),
    (_moved_without_strain, [0, -4.0, -3.0, 2.0, 1.0, 0], [0, 5.0, 4.0], [[0.0], [-5.0], [-4.0]], [7.0, -3.0]),
]


@pytest.mark.sampled(5)
@pytest.mark.parametrize(("make", "displacement", "normal", "friction", "tie"), RIGID)
@pytest.mark.parametrize("wrong", ["", "normal", "friction", "tie"])
def test_what_rounding_alone_measures_refuses_no_right_answer(make, displacement, normal, friction, tie, wrong) -> None:
    """Compliances that ties leave, and lengths of bodies that move rigidly, are zero but for rounding."""
    problem, off = make(), 1e-6
    assert cq.solve(problem).certificate.passed
    parts = {"normal": np.array(normal), "friction": np.array(friction), "tie": np.array(tie)}
    if wrong:
        parts[wrong] = parts[wrong].copy()
        parts[wrong][-1] += 10 * off
    given = parts["normal"], parts["friction"], parts["tie"]
    assert cq.certify(problem, np.array(displacement), *given).passed is (not wrong)


@pytest.mark.slow
def test_without_stiffness_the_rounding_of_a_gap_is_none() -> None:
    problem = _masonry()
    solution = cq.solve(problem)
    assert solution.certificate.passed
    u = solution.displacement + 1e-6 * np.array([0.0, 1.0, 0.0, 0.0, -1.0])
    given = solution.normal_force, solution.friction_force, solution.tie_force
    assert not cq.certify(problem, u, *given).passed


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 12, 19])
def test_forces_along_a_rigid_motion_have_no_size_but_that_of_the_strain(seed: int) -> None:
    """A body that floats up to roundings of its stiffness slides on one contact whose force pushes and drags along its
    motion: the response to that was a root of roundings, and friction off by 1e-7 was called 2.5 times as large.
    """
    shape, strains = np.random.default_rng(seed).normal(size=(3, 5)), np.eye(3) - 1 / 3
    stiffness = strains @ shape @ shape.T @ strains
    problem = cq.ContactProblem(
        (stiffness + stiffness.T) / 2, [22.0, 8.0, 0.3], [[0.0, 0.0, 1.0]], [1e-4], tangent=[[0.0, 1.0, 0.0]],
        friction=1.0,
    )  # fmt: skip
    right = cq.solve(problem)
    forces = right.normal_force, right.friction_force * (1 + 1e-7)
    judged = cq.certify(problem, right.displacement, *forces, tolerance=1e-5, error_tolerance=1e-4)
    assert judged.passed
    assert judged.distance == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("beyond", [1.0001, 1.001, 1.023737627118644, 1.108479152542373])
def test_a_rigid_ladder_is_compared_where_refinement_ends_in_rounding_of_its_forces(beyond: float) -> None:
    """It leans at tan a >= (1 - mu_f mu_w) / (2 mu_f); without stiffness and lengths only forces have a size."""
    floor, wall = 0.5, 0.2
    angle = np.arctan((1 - floor * wall) / (2 * floor)) * beyond
    c, s = np.cos(angle), np.sin(angle)
    ladder = cq.ContactProblem(
        np.zeros((3, 3)),
        [0.0, -1.0, 0.0],
        [[0.0, -1.0, c], [1.0, 0.0, -s]],
        [0.0, 0.0],
        tangent=[[1.0, 0.0, s], [0.0, 1.0, c]],
        friction=[floor, wall],
    )
    found = cq.solve(ladder)
    assert found.certificate.basis == "state"
    assert not cq.certify(ladder, found.displacement, 1.001 * found.normal_force, found.friction_force).passed
