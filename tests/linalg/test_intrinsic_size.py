"""What is nothing beside the whole: right answers that decay are accepted, and what is planted among them is seen."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as sla

import contactqp as cq
from contactqp.linalg.dense import RigidMotions
from contactqp.linalg.measures import intrinsic_size, negligible_in, scale_through_rows
from contactqp.model.solution import Answer

FAR = 7  # of the contacts of `rail`, one where displacements are 1e-18 of the largest


def rail(elements: int = 200, tie: bool = False, length: float = 1.0, force: float = 1.0) -> cq.ContactProblem:
    """A rail of 100 m on a Winkler foundation, loaded at its left end, with stops beneath; unknowns (w, theta) a node.

    The characteristic length (4 EI / k)^(1/4) is 2.1 m: at the right end the deflection is e^-47 of that at the left.
    """
    h, EI, k = 100.0 / elements, 5e6, 1e6
    K = np.zeros((2 * elements + 2, 2 * elements + 2))
    beam = [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2]]
    beam += [[-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]
    for e in range(elements):
        K[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += EI / h**3 * np.array(beam)
    K[::2, ::2] += k * h * np.eye(elements + 1)
    units = np.tile([length, 1.0], elements + 1)  # deflections in 1/length of a metre
    K = K / np.outer(units, units) * force * length
    load = np.zeros(len(K))
    load[0] = -3e4 * force
    stops = np.linspace(0, elements, FAR + 2).astype(int)[1:]
    rows = np.zeros((FAR + 1, len(K)))
    rows[np.arange(FAR + 1), 2 * stops] = -1.0
    ties = {}
    if tie:
        both = np.zeros((1, len(K)))
        both[0, [elements, elements + 20]] = 1.0, -1.0
        ties = dict(tie=both, tie_value=[0.0])
    return cq.ContactProblem(sp.csr_matrix(K), load, rows, np.zeros(FAR + 1), **ties)


def struck_rod(elements: int = 300) -> cq.ContactProblem:
    """One implicit step of a struck rod: 4 M / dt^2 + K, the wave of the step decays by 0.6 an element."""
    K = np.diag(np.full(elements + 1, 4.0)) + 1.0 * (np.diag(np.full(elements + 1, 2.0)))
    K -= np.eye(elements + 1, k=1) + np.eye(elements + 1, k=-1)
    load = np.zeros(elements + 1)
    load[0] = 5.0
    rows = np.zeros((2, elements + 1))
    rows[0, 0], rows[1, elements // 2] = 1.0, 1.0
    return cq.ContactProblem(1e5 * K, load, rows, [1e-6, 0.0])


def pile(nodes: int = 151) -> cq.ContactProblem:
    """A pile of 30 m in soil that a hammer presses at its head onto a stop, with bearings in the depth."""
    spring, soil = 1e8, 1e8
    K = np.diag(np.r_[1.0, np.full(nodes - 2, 2.0), 1.0] * spring + soil)
    K -= spring * (np.eye(nodes, k=1) + np.eye(nodes, k=-1))
    load = np.zeros(nodes)
    load[0] = 1e6
    return cq.ContactProblem(K, load, np.eye(nodes)[[0, 40, nodes - 1]], [5e-3, 0.0, 0.0])


def block_half_on_springs(high: int = 24) -> cq.ContactProblem:
    """A lattice of three nodes by 24 whose upper half stands on stiff springs, pressed onto seats at its foot."""
    nodes = np.array([(x, y) for y in range(high) for x in range(3)], dtype=float)
    K = np.diag(np.repeat(np.where(nodes[:, 1] >= high / 2, 1e8, 0.0), 2))
    for a in range(len(nodes)):
        for b in range(a):
            along = nodes[a] - nodes[b]
            if (length := np.hypot(*along)) < 1.5:
                row = np.zeros(len(K))
                row[2 * a : 2 * a + 2], row[2 * b : 2 * b + 2] = along / length, -along / length
                K += 1e6 * np.outer(row, row)
    load = np.zeros(len(K))
    load[:6] = 500.0, -1e3, 500.0, -1e3, 500.0, -1e3
    rows = np.zeros((6, len(K)))
    rows[np.arange(3), [1, 3, 5]], rows[np.arange(3, 6), len(K) - np.array([5, 3, 1])] = -1.0, 1.0
    return cq.ContactProblem(K, load, rows, [2e-4] * 3 + [0.0] * 3)


DECAYING = {
    "rail": rail,
    "tied rail": lambda: rail(tie=True),
    "pile": pile,
    "block": block_half_on_springs,
    "struck rod": struck_rod,
    "struck rod of 500 elements": lambda: struck_rod(500),
}


@pytest.mark.sampled(12)
@pytest.mark.parametrize("kind", DECAYING)
@pytest.mark.parametrize("method", ["active-set", "osqp", "lagrange-multiplier"])
def test_answers_that_decay_to_nothing_are_accepted(kind: str, method: str) -> None:
    solution = cq.solve(DECAYING[kind](), method)
    assert solution.certificate.proven
    u = abs(solution.displacement)
    assert np.min(u[u > 0]) < 1e-16 * np.max(u)


@pytest.mark.slow
@pytest.mark.parametrize("size", [1e-4, 1e-10, 1e-14])
@pytest.mark.parametrize("kind", ["rail", "block"])
def test_paths_that_begin_small_are_accepted_and_wrong_forces_at_their_first_step_are_not(
    kind: str, size: float
) -> None:
    problem = DECAYING[kind]()
    history = cq.follow_path(problem, [size * problem.load, problem.load], steps=2)
    assert all(solution.certificate.proven for solution in history)
    first, begun = history[2], problem.replace(load=size * problem.load)
    assert 0 < np.max(abs(first.displacement)) < 10 * size * np.max(abs(history[-1].displacement))
    for i in (0, problem.contacts - 1):
        pulled = first.normal_force.copy()
        pulled[i] -= pulled[i] + 1e-6 * size * np.max(abs(problem.load))
        assert not cq.certify(begun, first.displacement, pulled).passed


@pytest.mark.parametrize("tie", [False, True])
def test_answers_of_plain_linear_solvers_are_accepted(tie: bool) -> None:
    """Conjugate gradients leave 1e-14 of the load everywhere, a factorisation what it rounds; both beside 1e-20."""
    problem = rail(tie=tie)
    right = cq.solve(problem)
    K = problem.stiffness.tocsc()
    load = problem.load - problem.normal.T @ right.normal_force - problem.tie.T @ right.tie_force
    found, left = sla.cg(K, load, rtol=1e-14, maxiter=10**5)
    assert left == 0
    for u in (found, sla.spsolve(K, load), right.displacement + 1e-25):
        assert cq.certify(problem, u, right.normal_force, tie_force=right.tie_force).passed


@pytest.mark.sampled(3)
@pytest.mark.parametrize("kind", DECAYING)
def test_what_is_planted_among_nothing_is_seen(kind: str) -> None:
    """1e-6 of what counts there, S/D_j of forces and S|E_i D| of lengths, where 1e-12 of it is excused."""
    problem = DECAYING[kind]()
    right = cq.solve(problem)
    u, force, tie = right.displacement, right.normal_force, right.tie_force
    D = 1 / np.sqrt(problem.diagonal)
    strain = np.sqrt(u @ (problem.stiffness @ u))
    far = problem.contacts - 1
    stop = int(problem.normal.indices[far])
    down = problem.normal.data[far]
    assert abs(u[stop]) < 1e-15 * np.max(abs(u))
    pulled = force.copy()
    pulled[far] = -1e-6 * strain / D[stop]
    assert cq.certify(problem, u, pulled, tie_force=tie).tension > 1e-9
    sunk = u.copy()
    sunk[stop] += down * 1e-6 * strain * D[stop]
    assert cq.certify(problem, sunk, force, tie_force=tie).penetration > 1e-9
    assert cq.certify(problem, sunk, force, tie_force=tie).equilibrium > 1e-9
    turned = u.copy()
    turned[stop - 1] += 1e-6 * strain * D[stop - 1]
    certificate = cq.certify(problem, turned, force, tie_force=tie)
    assert certificate.equilibrium > 1e-9
    assert not certificate.passed


def test_bounds_see_what_is_excused() -> None:
    problem = rail()
    right = cq.solve(problem)
    D = 1 / np.sqrt(problem.diagonal)
    strain = np.sqrt(right.displacement @ (problem.stiffness @ right.displacement))
    moved = right.displacement.copy()
    moved[-1] += 1e-13 * strain * D[-1]
    certificate = cq.certify(problem, moved, right.normal_force)
    assert certificate.equilibrium == pytest.approx(right.certificate.equilibrium, abs=1e-15)
    assert certificate.energy_error > 9e-14
    assert certificate.passed


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("length", "force"), [(2.0**-10, 2.0**10), (2.0**20, 2.0**-30), (1e3, 1e-3)])
def test_nothing_is_the_same_in_any_units(length: float, force: float) -> None:
    one, other = cq.solve(rail()), cq.solve(rail(length=length, force=force))
    assert other.certificate.passed
    a, b = one.certificate.violations, other.certificate.violations
    assert a is not None
    assert b is not None
    assert b.nothing.force[::2] == pytest.approx(a.nothing.force[::2] * force)
    assert b.nothing.normal == pytest.approx(a.nothing.normal * length)


def test_a_rigid_motion_hides_no_tension() -> None:
    """A bar that falls by 1 m onto two supports: beside |K||u| of 1e9 N a tension of 2.5 N would be rounding."""
    K = 1e9 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    rows = np.array([[1.0, 0.0], [0.0, 1.0]])
    problem = cq.ContactProblem(K, [6.0, -2.5], rows, [1.0, 1.0])
    right = cq.solve(problem)
    assert right.normal_force == pytest.approx([3.5, 0.0])
    pulled = cq.certify(problem, [1.0, 1.0], [6.0, -2.5])
    assert pulled.tension > 0.1
    assert not pulled.passed


@pytest.mark.sampled(4)
@pytest.mark.parametrize("part", [0.5, 9e-4, 2.5e-6])
@pytest.mark.parametrize("gap", [1e-3, 1.0])
def test_a_rigid_motion_hides_no_force_that_contacts_of_one_node_exert_on_each_other(gap: float, part: float) -> None:
    """Twin supports may not pull and push each other, nor may a support be pushed by a wall that is 3 m away."""
    K = 1e9 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    for other, far in ((1.0, gap), (-1.0, 3.0)):
        problem = cq.ContactProblem(K, [1.0, 1.0], [[1.0, 0.0], [0.0, 1.0], [0.0, other]], [gap, gap, far])
        assert cq.certify(problem, [gap, gap], [1.0, 1.0, 0.0]).passed
        forged = cq.certify(problem, [gap, gap], [1.0, 1.0 + part, -other * part])
        assert max(forged.tension, forged.complementarity) > 1e-7
        assert not forged.passed


@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", ["active-set", "lemke", "daqp", "clarabel", "osqp", "lagrange-multiplier"])
def test_a_free_bar_falls_onto_its_supports_and_is_pushed_out_of_a_wall(method: str) -> None:
    """By 1 mm, under loads that act where it is held or under none: the answer is a rigid motion to the last digit."""
    bar = cq.ContactProblem(1e8 * np.array([[1.0, -1.0], [-1.0, 1.0]]), [600.0, 400.0], np.eye(2), [1e-3, 1e-3])
    fallen = cq.solve(bar, method)
    assert fallen.certificate.proven
    assert fallen.displacement == pytest.approx([1e-3, 1e-3], rel=1e-14)
    assert fallen.normal_force == pytest.approx([600.0, 400.0], rel=1e-9)
    shifted = cq.solve(bar.replace(load=np.zeros(2), gap=[-1e-3, 1e-3]), method)
    assert shifted.certificate.proven
    assert shifted.displacement == pytest.approx([-1e-3, -1e-3], rel=1e-14)
    assert not cq.certify(bar, [1e-3, 1e-3 + 1e-9], fallen.normal_force).passed
    assert not cq.certify(bar, fallen.displacement, [600.0 + 1e-3, 400.0 - 1e-3]).passed
    assert not cq.certify(shifted.problem, shifted.displacement * (1 - 1e-6), [0.0, 0.0]).passed
    assert not cq.certify(shifted.problem, shifted.displacement, [1e-6, 0.0]).passed


@pytest.mark.sampled(10)
@pytest.mark.parametrize("gap", [1e-3, -1e-3, 0.37, 0.0, 12.0])
@pytest.mark.parametrize("stiffness", [3e2, 7e8])
def test_a_body_that_only_moves_is_accepted(gap: float, stiffness: float) -> None:
    """Pushed onto a stop at its loaded node, a free bar is not strained: the answer has no energy to compare with."""
    K = stiffness * np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    problem = cq.ContactProblem(K, [0.0, 0.0, 17.3], [[0.0, 0.0, 1.0]], [gap])
    for method in ("active-set", "osqp", "clarabel", "lemke"):
        solution = cq.solve(problem, method)
        assert solution.certificate.proven
        assert solution.certificate.energy_error < 1e-6 * np.sqrt(stiffness) * max(abs(gap), 1e-9)
        assert solution.displacement == pytest.approx(np.full(3, gap), rel=1e-14, abs=1e-20)
    assert not cq.certify(problem, [gap + 1e-6, gap, gap], [17.3]).passed
    assert not cq.certify(problem, np.full(3, gap), [17.3 * (1 + 1e-6)]).passed


def test_where_nothing_moves_rounding_is_nothing_and_more_is_not() -> None:
    """A load on a node that rests on its support: u = 0, to whatever a code rounds."""
    K = 1e6 * np.array([[2.0, -1.0], [-1.0, 2.0]])
    held = cq.ContactProblem(K, [50.0, 0.0], [[1.0, 0.0]], [0.0])
    assert cq.certify(held, [1e-25, -2e-25], [50.0]).passed
    assert not cq.certify(held, [0.0, 1e-12], [50.0]).passed
    unloaded = held.replace(load=np.zeros(2), gap=np.array([1e-3]))
    assert cq.certify(unloaded, [1e-25, -2e-25], [0.0]).passed
    assert not cq.certify(unloaded, [1e-12, 0.0], [0.0]).passed
    rough = cq.ContactProblem(K, [50.0, 10.0], held.normal, [0.0], tangent=[[0.0, 1.0]], friction=0.3)
    assert cq.certify(rough, [1e-25, -2e-25], [50.0], [10.0]).passed
    assert not cq.certify(rough, [0.0, 1e-12], [50.0], [10.0]).passed
    assert not cq.certify(rough, [1e-25, -2e-25], [50.0], [10.0 + 1e-6]).passed
    nothing_given = held.replace(load=np.zeros(2))
    assert not cq.certify(nothing_given, [1e-25, -2e-25], [0.0]).passed
    assert cq.certify(nothing_given, [0.0, 0.0], [0.0]).passed


def test_forces_that_ties_exert_on_each_other_give_no_size() -> None:
    """The same tie twice may carry any pair of opposite forces; however large, they excuse nothing elsewhere."""
    K = np.diag([2.0, 3.0])
    problem = cq.ContactProblem(K, [1.0, 2.0], [[0.0, 1.0]], [0.5], tie=[[1.0, 0.0], [1.0, 0.0]], tie_value=[0.0, 0.0])
    right = cq.solve(problem)
    tie = np.array([1e13, 1.0 - 1e13])
    wrong = cq.certify(problem, right.displacement * (1 + 1e-6), right.normal_force, tie_force=tie)
    assert wrong.penetration > 1e-7


def test_a_claimed_force_on_an_open_contact_gives_no_size() -> None:
    """A gap counts as closed where the displacement closes it, not where somebody says that it pushes."""
    problem = cq.ContactProblem(np.diag([1e9, 1e3]), [0.0, 1e-6], np.eye(2), [1.0, 1e-12])
    answer = Answer(np.array([0.0, 1e-12]), np.array([1e-300, 1e-6 - 1e-9]), None, np.zeros(0))
    size = intrinsic_size(problem, answer, answer.displacement)
    assert np.max(size) < 1e-7
    assert np.max(negligible_in(problem, answer, answer.displacement, size, 1e-12).force) < 1e-11


def test_parts_that_nothing_connects_have_their_own_size() -> None:
    rows = [[1.0, 0.0, 0.0], [0.0, 1.0, -1.0]]
    problem = cq.ContactProblem(np.diag([1.0, 1e12, 1e12]), [3e-8, 1e12, 0.0], rows, [1e-8, 0.5])
    answer = Answer(np.array([1e-8, 1.0, 0.0]), np.array([2e-8, 0.0]), None, np.zeros(0))
    size = intrinsic_size(problem, answer, answer.displacement)
    assert size[0] == pytest.approx(1e-9 * 1e6)
    assert size[1] == size[2] == pytest.approx(1e6)


def test_a_part_that_nothing_moves_is_measured_by_the_others() -> None:
    """A second body on its own supports, unloaded: what a code rounds there is nothing beside the first."""
    problem = cq.ContactProblem(np.diag([1e6, 2e6]), [50.0, 0.0], np.eye(2), [1e-3, 0.0])
    right = cq.solve(problem)
    for noise, passes in ((1e-22, True), (1e-10, False)):
        moved = right.displacement + np.array([0.0, -noise])
        assert cq.certify(problem, moved, right.normal_force).passed == passes


def test_unknowns_without_stiffness_get_their_scale_from_their_rows() -> None:
    problem = cq.ContactProblem(np.diag([4.0, 0.0, 0.0]), [8.0, 0.0, 0.0], [[1.0, -2.0, 0.0]], [0.0])
    answer = Answer(np.array([2.0, 1.0, 0.0]), np.zeros(1), None, np.zeros(0))
    least = negligible_in(problem, answer, answer.displacement, np.full(3, 4.0), 1e-12).force
    assert least[:2] == pytest.approx([8e-12, 16e-12])
    assert least[2] == pytest.approx(64 * np.finfo(float).eps * 8.0)


def test_a_contact_without_stiffness_is_measured_by_what_ties_join_it_to() -> None:
    """A pin joined by two rods to a spring, stopped where it stands: what a code rounds there is nothing."""
    K, tie = np.diag([4.0, 0.0, 0.0]), [[1.0, -2.0, 0.0], [0.0, 1.0, -1.0]]
    problem = cq.ContactProblem(K, [8.0, 0.0, 18.0], [[0.0, 0.0, 1.0]], [0.0], tie=tie, tie_value=[2.0, 1.0])
    assert scale_through_rows(problem) == pytest.approx([0.5, 0.25, 0.25])
    right = cq.solve(problem)
    assert right.displacement == pytest.approx([4.0, 1.0, 0.0], abs=1e-15)
    for noise, passes in ((1e-17, True), (1e-6, False)):
        moved = right.displacement + np.array([2 * noise, noise, noise])
        assert cq.certify(problem, moved, right.normal_force, tie_force=right.tie_force).passed == passes


def test_the_rigid_part_is_taken_out() -> None:
    K = np.array([[1.0, -1.0], [-1.0, 1.0]])
    problem = cq.ContactProblem(K, [0.0, 0.0], [[1.0, 0.0]], [5.0])
    rigid = RigidMotions(np.full((2, 1), 0.5**0.5))
    elastic = rigid.without_rigid_part(np.array([5.0, 5.0 + 2e-9]), problem.diagonal)
    assert elastic == pytest.approx([-1e-9, 1e-9], rel=1e-6)


def test_what_overflows_excuses_nothing() -> None:
    problem = cq.ContactProblem(np.diag([2.0, 1e300]), [1.0, 0.0], [[1.0, 0.0]], [0.25])
    right = cq.solve(problem)
    assert right.certificate.passed
    with np.errstate(over="ignore", invalid="ignore"):
        assert not cq.certify(problem, [right.displacement[0], 1e100], right.normal_force).passed


@pytest.mark.slow
@pytest.mark.parametrize("load", [1.0, 1e-3, 1e3])
def test_a_tie_that_an_unknown_without_stiffness_takes_up_hides_no_tension(load: float) -> None:
    """A stiff bar against two equal stops; the tie moves a lever that nothing resists, not the bar."""
    stops, tie = [[1.0, 0.0], [1.0, 0.0]], dict(tie=[[0.5, 1.0]], tie_value=[0.25])
    problem = cq.ContactProblem(np.diag([3.2e7, 0.0]), [load, 0.0], stops, [0.0, 0.0], **tie)
    solution = cq.solve(problem)
    assert solution.normal_force.sum() == pytest.approx(load)
    for part in (1e-6, 1e-3):
        pulling = load * np.array([1.0 + part, -part])
        assert not cq.certify(problem, solution.displacement, pulling, tie_force=[0.0]).passed
    away = problem.replace(load=[-load, 0.0])
    assert not cq.solve(away).normal_force.any()  # forces that are all zero are accepted


@pytest.mark.parametrize("moves", [1.0, 2.0**-6])
def test_noise_of_what_moves_around_a_contact_is_nothing_where_the_contact_hardly_moves(moves: float) -> None:
    """A contact closes a gap of 1e-7 or 1e-5 of what its neighbour moves by: what a solve rounds there is no length.

    A gap that is open by 256 times as much is seen all the same.
    """
    K, gap = np.array([[8.0, -4.0], [-4.0, 8.0]]), -1e-20
    u, force = np.array([moves * 2.0**-44, gap]), np.array([2.0**-42 * moves])
    problem = cq.ContactProblem(K, K @ u + np.array([0.0, force[0]]), [[0.0, 1.0]], [gap])
    assert cq.certify(problem, u, force).passed
    assert cq.certify(problem, u - np.array([0.0, 2.0**-51 * u[0]]), force).passed
    assert not cq.certify(problem, u - np.array([0.0, 2.0**-43 * u[0]]), force).passed
