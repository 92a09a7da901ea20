"""Bounds on forces of tied bodies on sparse systems contain the true errors, in the norms of tied and untied bodies."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from benchmarks.judging import bounded, exact_truth
from contactqp.certificate.bounds import error_failures, force_bound_fails
from contactqp.certificate.energy_bounds import energy_bounds
from contactqp.model.solution import Answer


def force_error(problem: cq.ContactProblem, *answer: np.ndarray) -> float:
    u, pressed, held = answer
    found = energy_bounds(problem, Answer(u, pressed, None, held))
    assert found.force_error is not None
    return found.force_error


@pytest.mark.parametrize("stiffer", [1.0, 2.0**10, 2.0**20])
@pytest.mark.parametrize("unit", [1.0, 2.0**-330, 2.0**330])
def test_a_force_on_a_stiff_body_counts_as_one_on_the_soft_body_that_is_tied_to_it(stiffer: float, unit: float) -> None:
    """Both move together, so each half of the force strains the same, though the stiff one alone hardly feels it."""
    K, tie, rows = unit * np.diag([1.0, stiffer]), np.array([[1.0, -1.0]]), np.eye(2)
    u, pressed, held = np.array([0.5, 0.5]), unit * np.array([1.0, 1.0]), unit * np.array([0.25])
    problem = cq.ContactProblem(K, K @ u + pressed + tie.T @ held, rows, u, tie=tie, tie_value=[0.0])
    assert force_error(problem, u, pressed, held) <= 1e-12
    off = pressed * np.array([1.0, 1.0 + 2.0**-10])
    assert force_error(problem, u, off, held) >= 2.0**-11 * (1 - 1e-12)


@pytest.mark.parametrize("held", [1.0, 2.0**10, 2.0**20])
def test_large_forces_of_ties_hide_no_error_of_a_contact_on_a_body_that_floats_without_them(held: float) -> None:
    """The relative error of the only contact force is known; forces had been compared with those of all ties alone."""
    K = np.array([[4.0, -4.0, 0.0], [-4.0, 4.0, 0.0], [0.0, 0.0, 2.0]])
    tie, row = np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 1.0, 1.0]])
    u, pressed, ties = np.array([0.25, 0.5, 0.125]), np.array([0.75]), np.array([held])
    problem = cq.ContactProblem(K, K @ u + row.T @ pressed + tie.T @ ties, row, row @ u, tie=tie, tie_value=tie @ u)
    assert force_error(problem, u, pressed, ties) <= 1e-12
    for part in (2.0**-10, 2.0**-20, -1.0):
        assert force_error(problem, u, pressed * (1 + part), ties) >= abs(part) * (1 - 1e-12)


def test_forces_beside_an_unknown_without_stiffness_are_compared_by_what_they_strain_through_a_tie() -> None:
    """The contact acts on a bare unknown, which the tie joins to a spring; another contact presses a stiff one hard."""
    K, tie = np.diag([0.0, 1.0, 2.0**20]), np.array([[1.0, -1.0, 0.0]])
    rows = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    u, pressed, held = np.array([0.5, 0.5, 0.25]), np.array([1.0, 512.0]), np.array([-0.5])
    load = K @ u + rows.T @ pressed + tie.T @ held
    problem = cq.ContactProblem(K, load, rows, rows @ u, tie=tie, tie_value=[0.0])
    truth, _ = exact_truth(problem, None)
    assert truth is not None
    off = pressed * np.array([1.0 + 2.0**-10, 1.0])
    true = min(truth.errors(u, off, held).readings["force_error"])
    assert force_error(problem, u, pressed, held) <= 1e-12
    assert force_error(problem, u, off, held) >= true * (1 - 1e-12) > 0


def tied(rng: np.random.Generator) -> cq.ContactProblem:
    """Springs in a row, with a support or none, one or two ties, and contacts of which one is nearly a sum of ties."""
    n = int(rng.integers(3, 7))
    B = np.eye(n) - np.eye(n, k=1)
    B[-1] *= rng.random() < 0.6
    K = B.T @ np.diag(2.0 ** rng.integers(-2, 9, n)) @ B
    tie = np.zeros((int(rng.integers(1, 3)), n))
    for row in tie:
        row[rng.choice(n, 2, replace=False)] = rng.choice([-1.0, 1.0, 0.5], 2)
    near = tie.T @ rng.choice([-1.0, 0.5, 1.0], len(tie))
    near[rng.integers(n)] += 2.0 ** -int(rng.integers(18, 28))
    rows = np.vstack([np.eye(n)[rng.choice(n, 2, replace=False)], near])
    u, pressed = rng.integers(-4, 5, n) / 8, rng.integers(0, 5, 3) / 8
    load = K @ u + rows.T @ pressed + tie.T @ (rng.integers(-8, 9, len(tie)) / 8)
    gap = rows @ u + np.where(pressed > 0, 0.0, rng.integers(0, 2, 3) / 4)
    return cq.ContactProblem(K, load, rows, gap, tie=tie, tie_value=tie @ u)


@pytest.mark.sampled(8)
@pytest.mark.parametrize("seed", range(24))
def test_bounds_of_tied_bodies_contain_the_true_errors(seed: int) -> None:
    rng = np.random.default_rng([31, seed])
    problem = tied(rng)
    truth, _ = exact_truth(problem, None)
    assert truth is not None
    u, pressed = truth.rounded()
    held, compared = truth.tie_force, 0
    for size in (0.0, 1e-9, 1e-6, 1e-3):
        noise = 1 + size * rng.standard_normal(3)
        for forces, ties in ((pressed * noise, held), (pressed, held * (1 + size)), (pressed * (1 + size), held)):
            found = energy_bounds(problem, Answer(u, forces, None, ties))
            for one in bounded("noise", truth, found, truth.errors(u, forces, ties)):
                compared += 1
                assert not one.below, (size, one)
    assert compared


def test_a_contact_that_seems_open_may_press_where_rounding_leaves_a_free_motion_unbalanced() -> None:
    """A chain and a lattice that two ties hold; the third contact, nearly the sum of the ties, presses with 0.375.

    The two others alone balance the load to 1e-15, with the third open by 1e-11 of the lengths.
    """
    K = np.zeros((12, 12))
    springs = (454656.0, {0: 1, 1: -1}), (7168.0, {1: 1, 2: -1}), (4.28125, {2: 1, 3: -1}), (368640.0, {4: 1, 6: -1})
    lattice = (2.5, {5: 1, 9: -1}), (409600.0, {8: 1, 10: -1}), (557056.0, {7: 1, 11: -1})
    braces = (512.0, {4: 1, 5: 1, 10: -1, 11: -1}), (672.0, {6: 1, 7: -1, 8: -1, 9: 1})
    for stiffness, ends in (*springs, *lattice, *braces):
        K[np.ix_(list(ends), list(ends))] += stiffness * np.outer(list(ends.values()), list(ends.values()))
    rows = np.zeros((3, 12))
    rows[0, [1, 11]], rows[1, [4, 6]] = (1.0, -1.0), (1.0, -1.0)
    tie = np.array([
        [0.0, 0.5, -0.5, 1.5, 1.0, 0.5, 0.0, 1.0, 1.0, 1.0, -1.0, -0.5],
        [1.0, -1.0, 0.0, -0.5, -0.5, 0.0, -0.5, -0.5, 0.5, 0.0, 0.5, -1.0],
    ])  # fmt: skip
    rows[2] = 0.5 * tie[0] - tie[1]
    rows[2, 9] -= 2.0**-26
    load = [-340992.625, 333825.21875, 7171.8125, -2.5625, 138115.0, -125.03125, -138829.4375, 209485.25, -460211.375,
            -589.5625000055879, 460926.75, -208767.96875]  # fmt: skip
    problem = cq.ContactProblem(K, load, rows, [0.375, 0.375, -2.3124999906867743], tie=tie, tie_value=[-2.625, 1.0])
    try:
        found = cq.solve(problem)
    except cq.NotCertified as refused:
        found = refused.solution
    truth, _ = exact_truth(problem, None)
    assert truth is not None
    np.testing.assert_array_equal(truth.rounded()[1], [0.125, 1.75, 0.375])
    bounds = energy_bounds(problem, Answer(found.displacement, found.normal_force, None, found.tie_force))
    assert bounds.force_bound is not None
    assert np.all(bounds.force_bound >= abs(found.normal_force - truth.rounded()[1]))


@pytest.mark.sampled(9)
@pytest.mark.parametrize("third", [False, True], ids=["two ties", "three ties"])
@pytest.mark.parametrize("unit", [1.0, 1e-9, 1e12])
@pytest.mark.parametrize("exponent", [8, 18, 21, 24, 27, 30, 36])
def test_forces_on_bodies_with_nearly_parallel_ties_are_compared_by_their_exact_response(
    exponent: int, unit: float, third: bool
) -> None:
    """Together they hold the unknown that the largest force presses, which then strains nothing but its neighbours."""
    n = 6
    K = unit * (np.diag([6.5, 8.0, 15.25, 4.0, 6.0, 9.0]) - np.eye(n, k=1) - np.eye(n, k=-1))
    tie = np.array([[1.0, -1.0, 0.5, 0.0, 0.0, 1.0], [1.0, -1.0, 0.5, 2.0**-exponent, 0.0, 1.0]])
    if third:
        tie = np.vstack([[0.0, 0.5, 0.5, 0.0, 1.0, 0.0], tie])
        tie[2] += tie[0]
    rows = np.eye(n)[[3, 2, 4]]
    u, pressed = np.array([0.5, -0.25, 0.125, 0.75, 0.375, -0.5]), unit * np.array([64.0, 0.75, 0.25])
    held = unit * np.array([0.5, -1.25, 2.0])[: len(tie)]
    problem = cq.ContactProblem(K, K @ u + rows.T @ pressed + tie.T @ held, rows, rows @ u, tie=tie, tie_value=tie @ u)
    truth, _ = exact_truth(problem, None)
    assert truth is not None
    for off in ([1.25, 1.0, 1.0], [1.0, 1.25, 1.0], [1.0, 1.01, 0.97], [1.0, -1.0, 1.0]):
        found = energy_bounds(problem, Answer(u, pressed * off, None, held))
        true = min(truth.errors(u, pressed * off, held).readings["force_error"])
        assert found.force_error is not None
        assert found.force_error >= (1 - 1e-6) * true > 0


@pytest.mark.parametrize("exponent", [16, 24, 31])
def test_a_chain_that_only_ties_hold_is_compared_by_its_response_however_large_their_forces(exponent: int) -> None:
    """Rounding leaves its pivots positive, so that it seems soft."""
    K = np.zeros((6, 6))
    for i, stiffness in enumerate([64.0, 0.25, 2.0, 128.0, 0.5]):
        K[i : i + 2, i : i + 2] += stiffness * np.array([[1.0, -1.0], [-1.0, 1.0]])
    tie = np.array([[0.5, 0.0, 0.0, 0.5, 0.0, 0.0], [0.5, 0.0, 2.0**-exponent, 0.5, 0.0, 0.0]])
    rows = np.array([[0.0, 0.0, 1.0, -1.0, 0.0, -1.0], [0.0, 0.5, -1.0, 0.0, 0.0, 0.5]])
    u, pressed, held = np.arange(6) / 8, np.array([0.375, 40.0]), 2.0**20 * np.array([1.0, -1.0])
    problem = cq.ContactProblem(K, K @ u + rows.T @ pressed + tie.T @ held, rows, rows @ u, tie=tie, tie_value=tie @ u)
    truth, _ = exact_truth(problem, None)
    assert truth is not None
    for off in ([1.25, 1.0], [1.0, 1.001], [1.0, -1.0]):
        true = min(truth.errors(u, pressed * off, held).readings["force_error"])
        assert force_error(problem, u, pressed * off, held) >= (1 - 1e-6) * true > 0


def test_forces_of_ties_without_stiffness_are_judged_beside_redundant_contacts_too() -> None:
    """The second and the fourth contact share a force; forces of the ties are determined by what they hold."""
    K = np.diag([1.25, 14.0, 0.0, 0.0, 0.0])
    rows = np.eye(5)[[0, 1, 4, 1]] * np.array([[-1.0], [1.0], [1.0], [1.0]])
    tie = np.array([[0.5, -0.5, -0.5, 2.0, 0.0], [-0.5, 0.5, 1.0, -0.5, -1.0], [0.5, -0.5, -0.5, 2.0, 0.0]])
    tie[2, 2] += 2.0**-23
    u, pressed, held = np.array([0.0, 0.0, -0.625, -0.625, -0.125]), np.array([0.125, 3.5, 0, 0]), [-0.75, 0.625, 0.25]
    gap = rows @ u + np.array([0.0, 0.0, 0.5, 0.0])
    problem = cq.ContactProblem(K, K @ u + rows.T @ pressed + tie.T @ held, rows, gap, tie=tie, tie_value=tie @ u)
    shared = np.array([0.125, 1.5, 0.0, 2.0])
    assert force_error(problem, u, shared, np.array(held)) <= 1e-9
    off = np.array([-7.5e-4, -7.5e-4 * 2.0**-24, 7.5e-4])
    assert force_error(problem, u, shared, np.array(held) + off) >= 1e-6


def failed_forces(problem: cq.ContactProblem, u: np.ndarray, pressed: np.ndarray, held: np.ndarray) -> list[str]:
    """Return the first failure of a certificate, and that of bounds on sparse systems."""
    bounds = energy_bounds(problem, Answer(u, pressed, None, held))
    alone = [*error_failures(bounds, 1e-6, 0.0), *(["force_bound"] if force_bound_fails(bounds, 1e-6, 0.0) else [])]
    return [*cq.certify(problem, u, pressed, tie_force=held).failures[:1], *alone[-1:]]


# The bodies feel the ties by a lever of 1e-9; one of two contacts is alone at its unknown.
LEVER, UNITS = 2.0**-27, [1.0, 2.0**30, 2.0**-30]
HARDLY_FELT = np.array([[0, 1, 0, 0.5, 0], [0, 1, LEVER, 0.5, 0]])


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("touching", [False, True])
@pytest.mark.parametrize("kind", ["ties", "contacts"])
def test_single_forces_that_the_bodies_hardly_feel_are_compared_with_those_that_meet_there(
    kind: str, touching: bool, unit: float
) -> None:
    K, rows, D = np.diag([1.9765625, 0, 8960, 0, 0]), np.eye(5)[[3, 4]], np.array([1, unit, 1, 1, 1 / unit])
    u, held = np.array([0.5, -0.75, -0.875, -0.375, -0.875]), np.array([1, 0.125])
    pressed, gap = np.array([0, 0.203125]), rows @ u + np.array([0.0 if touching else 0.5, 0.0])
    load, value = D * (K @ u + rows.T @ pressed + HARDLY_FELT.T @ held), HARDLY_FELT @ u
    rows, both, u = rows * D, HARDLY_FELT * D, u / D
    if kind == "ties":
        problem = cq.ContactProblem(K, load, rows, gap, tie=both, tie_value=value, tie_names=["left", "right"])
        judged = [(pressed, held + off) for off in np.outer([0.0, 1e-5, 1e-3, 0.1, -0.1, -1.2], [1, -1])]
    else:
        gaps = np.append(gap, value)
        problem = cq.ContactProblem(K, load, np.vstack([rows, both]), gaps, contact_names=["a", "b", "left", "right"])
        judged = [(np.append(pressed, held + off), np.zeros(0)) for off in np.outer([0, 1e-5, 1e-3, 0.1], [1, -1])]
    assert failed_forces(problem, u, *judged[0]) == []
    for forces in judged[1:]:
        found = failed_forces(problem, u, *forces)
        assert len(found) == 2
        assert any(name in text for name in ("left", "right") for text in found)


def test_ties_at_unknowns_without_stiffness_are_judged_singly_beside_one_that_joins_them_to_the_body() -> None:
    for apart in (2.0**-16, 2.0**-30):
        K, tie, rows = np.diag([100.0, 0, 0]), np.array([[0, 1, 0.5], [0, 1, 0.5 + apart], [1, 0, 1]]), np.eye(3)[:1]
        u, held, none = np.array([0.5, -0.25, 0.125]), np.array([1, -0.125, 2.0]), np.zeros(1)
        load = K @ u + tie.T @ held
        problem = cq.ContactProblem(K, load, rows, rows @ u + 1, tie=tie, tie_value=tie @ u)
        assert failed_forces(problem, u, none, held) == []
        for off in (1e-5, 1e-3, 0.1):
            found = failed_forces(problem, u, none, held + off * np.array([1, -1, 0]))
            assert len(found) == 2
            assert "tie 1" in found[1]


def test_rounding_in_a_joint_without_force_is_no_error() -> None:
    """Two bodies are tied to an unknown without stiffness at which nothing acts."""
    K, tie, u = np.diag([100.0, 50.0, 0.0]), np.array([[1.0, 0.0, -1.0], [0.0, 1.0, -1.0]]), np.full(3, 0.5)
    problem = cq.ContactProblem(K, K @ u, np.zeros((0, 3)), [], tie=tie, tie_value=[0.0, 0.0])
    for off in (0.0, 1e-16, 1e-13):
        assert cq.certify(problem, u, [], tie_force=[off, -off]).passed


@pytest.mark.parametrize("unit", [1.0, 2.0**20])
@pytest.mark.parametrize("exponent", [18, 24, 30])
def test_a_contact_whose_force_a_tie_carries_does_not_hide_what_its_neighbour_holds(exponent: int, unit: float) -> None:
    """The tie's force is far larger than what the other tie, nearly parallel, takes of it in every sweep."""
    n, apart = 6, 2.0**-exponent
    K = unit * (np.diag([2.0, 34, 34, 2.5, 1, 4.5]) - np.diag(w := [2.0, 32, 2, 0.5, 0.5], 1) - np.diag(w, -1))
    tie = np.array([[0.0, -1, -1, -1, -1, 0], [apart, 1, 1, 1, 1, 0]]) * np.array([[1000.0], [0.01]])
    rows = np.array([[0.0, 1, 1 + apart, 1, 1, 0], [2.0, 1, 0, 1, -2, 0], [0.0, 0, 1, 0, -1, -1]])
    u, pressed, held = (
        np.array([-2, -2, 4, -3, -3, 4]) / 8,
        unit * np.array([2.0**20, 0.125, 0.25]),
        np.array([0, 0.75]),
    )
    problem = cq.ContactProblem(K, K @ u + rows.T @ pressed + tie.T @ held, rows, rows @ u, tie=tie, tie_value=tie @ u)
    truth, _ = exact_truth(problem, None)
    assert truth is not None
    u, pressed = truth.rounded()
    assert len(u) == n
    for off in ([1.0, 1.25, 1.0], [1.001, 1.0, 1.0], [1.0, 1.0, -1.0]):
        true = min(truth.errors(u, pressed * off, truth.tie_force).readings["force_error"])
        assert force_error(problem, u, pressed * off, truth.tie_force) >= (1 - 1e-6) * true > 0
