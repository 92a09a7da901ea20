"""Printed matrices of floating bodies: lost digits along rigid motions are taken away, and nothing else is."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from benchmarks.families_of_printing import print_and_read
from benchmarks.families_of_stacks import spring_block
from contactqp.linalg.factorization import null_space
from contactqp.model.printed_stiffness import clear_of_printing

Array = np.ndarray


def block(seed: int, size: float = 2.1e11) -> tuple[Array, Array, Array]:
    """K and rigid motions of a plane lattice of springs whose nodes lie irregularly, and the nodes."""
    rng = np.random.default_rng(seed)
    nodes = np.array([(i, j) for j in range(3) for i in range(4)]) + rng.uniform(-0.2, 0.2, (12, 2))
    K = np.zeros((24, 24))
    for a in range(12):
        for b in range(a):
            along = nodes[a] - nodes[b]
            if (length := np.hypot(*along)) < 1.7:
                row = np.zeros(24)
                row[2 * a : 2 * a + 2], row[2 * b : 2 * b + 2] = along / length, -along / length
                K += size * rng.uniform(0.5, 2) * np.outer(row, row)
    motions = np.zeros((24, 3))
    motions[::2, 0] = motions[1::2, 1] = 1.0
    motions[::2, 2], motions[1::2, 2] = -nodes[:, 1], nodes[:, 0]
    return K, motions, nodes


def pressed(K: Array, nodes: Array, stated: Array | None) -> cq.ContactProblem:
    """The block, pressed down on three seats that lie at slightly different heights; sideways it is free."""
    E, f = np.zeros((3, 24)), np.zeros(24)
    low = np.argsort(nodes[:, 1])[:3]
    E[range(3), 2 * low + 1] = -1.0
    f[1::2] = -1e-5 * np.max(K) / 12
    return cq.ContactProblem(K, f, E, [0.0, 1e-7, 2e-7], near_null_space=stated)


@pytest.mark.sampled(42)
@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("digits", [6, 7, 8, 9, 10, 11, 12])
@pytest.mark.parametrize("seed", range(3))
def test_printed_blocks_answer_as_the_unprinted_to_the_printed_digits(seed: int, digits: int, stated: bool) -> None:
    K, motions, nodes = block(seed)
    told = motions if stated else None
    right = cq.solve(pressed(K, nodes, motions))
    found = cq.solve(pressed(print_and_read(K, digits), nodes, told))
    assert found.certificate.passed
    assert found.normal_force == pytest.approx(right.normal_force, rel=100 * 10.0**-digits, abs=0)
    assert 0 < found.problem.rigid_change <= 5 * 10.0 ** (1 - digits)
    assert any("printed digits" in note for note in found.certificate.notes)


@pytest.mark.sampled(6)
@pytest.mark.parametrize("digits", [6, 8, 10, 12])
@pytest.mark.parametrize("sides", [(4, 3), (3, 2, 2)])
def test_turns_of_regular_lattices_are_recognised_with_the_zeros_of_their_stiffness(
    sides: tuple[int, ...], digits: int
) -> None:
    """Springs along axes leave zeros, and K + d has no turn but the exact one: it is found together with d."""
    nodes = np.array(list(np.ndindex(*sides)), dtype=float)
    exact = spring_block(np.random.default_rng(digits), nodes, 1.0) / 3
    K = sp.csr_array(print_and_read(exact, digits))
    found = clear_of_printing(K, None)
    assert found is not None
    change = found.stiffness - K
    assert np.all(abs(change.toarray()) <= 10 * 10.0**-digits * np.max(abs(exact)) * (exact != 0))
    turns = len(sides) * (len(sides) - 1) // 2
    values = np.linalg.eigvalsh(found.stiffness.toarray()) / np.max(exact)
    assert np.sum(abs(values) < 1e-14) == len(sides) + turns
    assert abs(np.linalg.eigvalsh(K.toarray()) / np.max(exact))[0] > 1e-14


def lattice(seed: int, sides: tuple[int, ...], held: float = 0.0) -> Array:
    """K of a lattice whose springs lie along axes and diagonals, a spring at its first unknown, printed to 6 digits."""
    nodes = np.array(list(np.ndindex(*sides)), dtype=float)
    K = spring_block(np.random.default_rng(seed), nodes, 1.0) / 3
    K[0, 0] += held * np.max(K)
    return print_and_read(K, 6)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("seed", [0, 1, 9])
def test_what_is_cleared_of_printing_is_rigid_to_a_rounding_of_the_energy_too(seed: int) -> None:
    """Refinement that looks at forces alone leaves turns twice the energy that a rigid motion may have."""
    found = clear_of_printing(sp.csr_array(lattice(seed, (2, 2, 2))), None)
    assert found is not None
    assert null_space(found.stiffness).count == 6


@pytest.mark.slow
@pytest.mark.parametrize(("sides", "digits"), [((4, 4, 4), 6), ((13, 13), 12)])
def test_so_is_a_body_of_more_equations_than_singular_values_take(sides: tuple[int, ...], digits: int) -> None:
    nodes = np.array(list(np.ndindex(*sides)), dtype=float)
    exact = spring_block(np.random.default_rng([digits, *sides, 0]), nodes, 1.0) / 3
    found = clear_of_printing(sp.csr_array(print_and_read(exact, digits)), None)
    assert found is not None
    assert null_space(found.stiffness).count == len(sides) * (len(sides) + 1) // 2


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", range(8))
def test_a_spring_of_a_hundred_roundings_is_no_rounding(seed: int) -> None:
    assert clear_of_printing(sp.csr_array(lattice(seed, (2, 2, 2), held=1e-4)), None) is None


@pytest.mark.sampled(3)
@pytest.mark.parametrize("seed", range(30))
def test_soft_springs_that_are_stated_in_few_digits_stay(seed: int) -> None:
    """Whole numbers eight decades apart: what holds or joins stiff parts is as small as digits that a printer loses."""
    rng = np.random.default_rng(seed)
    large = 10.0 ** int(rng.integers(3, 8))
    if seed % 3 == 0:  # a beam
        K = np.zeros((12, 12))
        element = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]])
        for at in range(0, 10, 2):
            K[at : at + 4, at : at + 4] += large * rng.integers(1, 10) * element
    elif seed % 3 == 1:  # a lattice
        nodes = np.array(list(np.ndindex(*(3, 2, 2)[: int(rng.integers(2, 4))])), dtype=float)
        K = large * np.round(spring_block(rng, nodes, 4.0))
    else:  # a chain of two stiff parts
        links = large * rng.integers(1, 10, 7)
        links[[0, 4]] = rng.integers(1, 10, 2)
        K = np.diag(links + np.append(links[1:], 0.0)) - np.diag(links[1:], 1) - np.diag(links[1:], -1)
    held = rng.choice(len(K), int(rng.integers(1, 4)), replace=False)
    K[held, held] += rng.integers(1, 10, len(held))
    assert clear_of_printing(sp.csr_array(K), None) is None


def test_rigid_motions_cost_nothing_and_no_entry_changes_by_more_than_its_digits() -> None:
    K, motions, _ = block(3)
    printed = print_and_read(K, 7)
    changed = cq.ContactProblem(printed, np.zeros(24), np.zeros((0, 24)), [], near_null_space=motions).stiffness
    assert np.max(abs(printed @ motions)) > 1e-9 * np.max(K)
    assert np.all(abs(changed @ motions) <= 64 * np.finfo(float).eps * (abs(changed) @ abs(motions)))
    assert np.array_equal(changed, changed.T)
    unit = 10.0 ** (np.floor(np.log10(abs(printed[printed != 0]))) - 6)
    assert np.all(abs(changed - printed)[printed != 0] <= 2 * unit)


def test_a_matrix_with_all_its_digits_stays_as_it_is() -> None:
    K, motions, nodes = block(4)
    for told in (motions, None):
        problem = pressed(K, nodes, told)
        assert np.array_equal(problem.stiffness, K)
        assert problem.rigid_change == 0


def test_motions_that_are_stated_roughly_change_no_matrix() -> None:
    K, motions, nodes = block(9)
    rough = motions * (1 + 1e-9 * np.random.default_rng(0).normal(size=motions.shape))
    assert np.array_equal(pressed(K, nodes, rough).stiffness, K)


@pytest.mark.parametrize("stated", [True, False])
def test_springs_that_hold_a_body_stay(stated: bool) -> None:
    """A soft spring of two parts in a million, and a soft bed, are as weak as lost digits; they follow a rule."""
    bar = 1000.0 * (np.diag([1.0, *[2.0] * 38, 1.0]) - np.diag(np.ones(39), 1) - np.diag(np.ones(39), -1))
    for held in (np.diag([0.002] + [0.0] * 39), 0.002 * np.eye(40)):
        K = bar + held
        told = np.ones((40, 1)) if stated else None
        problem = cq.ContactProblem(K, np.eye(40)[-1], np.zeros((0, 40)), [], near_null_space=told)
        assert np.array_equal(problem.stiffness, K)
        assert problem.rigid_change == 0


def test_units_that_are_changed_after_printing_hide_the_digits_and_not_the_noise() -> None:
    K, motions, nodes = block(5)
    printed = print_and_read(K, 8) * 0.0254
    assert np.linalg.eigvalsh(printed)[0] < 0
    problem = pressed(printed, nodes, motions)
    assert 0 < problem.rigid_change < 1e-7
    assert cq.solve(problem).certificate.passed


def test_where_no_motion_is_known_well_enough_the_message_says_what_to_state() -> None:
    K, motions, _ = block(6)
    order = np.random.default_rng(0).permutation(24)
    printed = print_and_read(K, 6)[np.ix_(order, order)]
    assert np.linalg.eigvalsh(printed)[0] < 0
    with pytest.raises(cq.InvalidProblem, match="near_null_space"):
        cq.ContactProblem(printed, np.zeros(24), np.zeros((0, 24)), [])
    told = cq.ContactProblem(printed, np.zeros(24), np.zeros((0, 24)), [], near_null_space=motions[order])
    assert told.rigid_change > 0


def test_bodies_beside_supported_ones_are_cleared_alone() -> None:
    K, motions, _ = block(7)
    held = 3.0e10 * np.array([[2.0, -1.0], [-1.0, 1.0]]) / 7
    both = print_and_read(np.block([[K, np.zeros((24, 2))], [np.zeros((2, 24)), held]]), 9)
    told = np.vstack([motions, np.zeros((2, 3))])
    cleared = clear_of_printing(sp.csr_array(both), told)
    assert cleared is not None
    assert np.array_equal(cleared.stiffness.toarray()[24:, 24:], both[24:, 24:])


def test_the_change_is_kept_when_other_data_are_replaced() -> None:
    K, motions, nodes = block(8)
    problem = pressed(print_and_read(K, 9), nodes, motions)
    for other in (problem.replace(load=2 * problem.load), problem.replace(normal=2 * problem.normal.toarray())):
        assert other.rigid_change == problem.rigid_change


@pytest.mark.slow
def test_large_bodies_are_recognised_too() -> None:
    """A lattice of 900 unknowns, too many for all eigenvalues."""
    rng = np.random.default_rng(0)
    nodes = np.array([(i, j) for j in range(15) for i in range(30)]) + rng.uniform(-0.2, 0.2, (450, 2))
    rows = []
    for a in range(450):
        for b in range(max(0, a - 31), a):
            along = nodes[a] - nodes[b]
            if (length := np.hypot(*along)) < 1.7:
                row = np.zeros(900)
                row[2 * a : 2 * a + 2], row[2 * b : 2 * b + 2] = along / length, -along / length
                rows.append(np.sqrt(rng.uniform(0.5, 2)) * row)
    R = sp.csr_array(np.array(rows))
    K = sp.coo_array(R.T @ R)
    printed = sp.csr_array((print_and_read(K.data[None], 9)[0], (K.row, K.col)), shape=K.shape)
    problem = cq.ContactProblem(printed, np.zeros(900), np.zeros((0, 900)), [])
    assert 0 < problem.rigid_change < 1e-7


@pytest.mark.parametrize("unit", [1.0, 1e-2, 1e5])
def test_whole_numbers_were_not_printed(unit: float) -> None:
    """Semidefinite matrices of one digit, whose translations half a digit of every entry would resist."""
    rows = [[8.0, 0, -2, 0], [0, 2, 1, 4], [-2, 1, 1, 2], [0, 4, 2, 8]]
    more = [[1, 0, -2, 2, 2, -1], [0, 1, 1, -2, 1, -1], [-2, 1, 5, -6, -3, 1], [2, -2, -6, 8, 2, 0],
            [2, 1, -3, 2, 5, -3], [-1, -1, 1, 0, -3, 2]]  # fmt: skip
    for given in (unit * np.array(rows), unit * np.array(more, dtype=float)):
        problem = cq.ContactProblem(given, np.zeros(len(given)), np.eye(len(given))[:1], [0.0])
        assert problem.rigid_change == 0
        assert np.array_equal(problem.stiffness, given)


@pytest.mark.parametrize("unit", [1.0, 0.1, 1e3])
def test_a_spring_at_a_node_whose_neighbours_are_exact_stays(unit: float) -> None:
    """Three bars, and a spring 1/2 (3, -4)(3, -4)' at the third node: one entry has four digits, 517.5.

    With all nodes moved alike along the diagonal it works at two of six unknowns, in both directions.
    """
    K = np.array([[266, 612, -16, -12, -250, -600], [612, 1449, -12, -9, -600, -1440], [-16, -12, 279, -852, -263, 864],
                  [-12, -9, -852, 2921, 864, -2912], [-250, -600, -263, 864, 517.5, -270],
                  [-600, -1440, 864, -2912, -270, 4360]])  # fmt: skip
    assert clear_of_printing(sp.csr_array(unit * K), None) is None


def test_whole_numbers_of_as_many_digits_are_no_printed_ones() -> None:
    """Bars whose entries are of four digits, and springs of one to three digits that hold some of the nodes."""
    for seed in range(300):
        rng = np.random.default_rng([2, seed])
        nodes, d, rows = int(rng.integers(2, 5)), int(rng.integers(2, 4)), []
        for a in range(nodes):
            for b in range(a):
                bar = np.zeros((nodes, d))
                bar[a] = rng.integers(40, 61, d) * rng.choice([-1.0, 1.0], d)
                bar[b] = -bar[a]
                rows.append(bar.ravel())
        for a in rng.choice(nodes, int(rng.integers(1, nodes + 1)), replace=False):
            held = np.zeros((nodes, d))
            held[a] = rng.integers(1, 7, d) * rng.choice([-1.0, 1.0], d)
            rows.append(held.ravel())
        R = np.array(rows)
        assert clear_of_printing(sp.csr_array(R.T @ R), None) is None, seed
