"""Rows that follow from others are set aside and have their forces again; nothing is decided by a tolerance."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.linalg import interior_point
from contactqp.solving.presolve import held_by_ties, never_close, parallel_rows, presolved

SIZES = [6, 1500]
METHODS = ["active-set", "clarabel"]


def polytope(n: int) -> tuple[sp.csr_matrix, np.ndarray]:
    """Rows of whole numbers around the origin, more of them than unknowns."""
    rng = np.random.default_rng(n)
    extra = sp.random(n, n, 3 / n, random_state=rng, data_rvs=lambda size: rng.integers(1, 4, size).astype(float))
    rows = sp.vstack([sp.identity(n), 5 * sp.identity(n) + extra], format="csr")
    return rows, np.asarray(rows.sum(axis=1)).ravel() / 8


def problem_of(n: int, rows: sp.csr_matrix, gap: np.ndarray, **ties: object) -> cq.ContactProblem:
    return cq.ContactProblem(sp.identity(n, format="csr"), np.linspace(-1, 3, n), rows, gap, **ties)


def repeated(n: int) -> tuple[cq.ContactProblem, cq.ContactProblem]:
    """A polytope; the same with each row three times as long, each row with a wider gap, each row a quarter as long."""
    rows, gap = polytope(n)
    every = sp.vstack([rows, 3 * rows, rows, 0.25 * rows], format="csr")
    return problem_of(n, rows, gap), problem_of(n, every, np.concatenate([gap, 3 * gap, gap + 1e-9, 0.25 * gap]))


@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("n", SIZES)
def test_parallel_contacts_share_the_force_of_one_and_wider_ones_have_none(n: int, method: str) -> None:
    single, every = repeated(n)
    expected, found = cq.solve(single, method), cq.solve(every, method)
    assert found.certificate.proven
    assert any("parallel to nearer ones" in note for note in found.certificate.notes)
    assert any("parallel to equal ones" in note for note in found.certificate.notes)
    assert found.displacement == pytest.approx(expected.displacement, rel=1e-12, abs=1e-14)
    one, longer, wider, shorter = found.normal_force.reshape(4, -1)
    assert np.all(found.normal_force >= 0)
    assert np.max(one) > 0
    assert not np.any(wider)
    # The least sum of squares among the ways to share it: in proportion to the lengths of the rows.
    assert longer == pytest.approx(3 * one)
    assert shorter == pytest.approx(0.25 * one)
    together = every.normal.T @ found.normal_force
    assert together == pytest.approx(single.normal.T @ expected.normal_force, rel=1e-9, abs=1e-12)


def test_a_row_that_is_parallel_but_for_the_last_digit_is_no_parallel_row() -> None:
    rows, _ = polytope(6)
    other = rows.copy()
    other.data[-1] = np.nextafter(other.data[-1], 9.0)
    groups = parallel_rows(sp.vstack([rows, other], format="csr"), signed=True)
    assert {group.rows[0] for group in groups} == set(range(rows.shape[0] - 1))
    turned = parallel_rows(sp.vstack([rows, -rows], format="csr"), signed=True)
    assert not turned
    assert len(parallel_rows(sp.vstack([rows, -rows], format="csr"), signed=False)) == rows.shape[0]


def test_factors_that_are_no_doubles_are_rational_numbers() -> None:
    rows = sp.csr_matrix([[3.0, 6.0], [1.0, 2.0], [0.1, 0.2], [7.0, 14.0]])
    (group,) = parallel_rows(rows, signed=True)
    assert group.factors == (1, Fraction(1, 3), Fraction(0.1) / 3, Fraction(7, 3))
    at, _ = group.tightest(np.array([3.0, 1.0, 0.1, 7.0]))
    # 0.1 is a little more than a tenth, in the row as in the gap: all of them are the same constraint.
    assert at.tolist() == [0, 1, 2, 3]
    at, _ = group.tightest(np.array([3.0, np.nextafter(1.0, 0.0), 0.1, 7.0]))
    assert at.tolist() == [1]


def test_rows_that_are_others_times_powers_of_two_are_found_and_tiny_entries_are_compared_as_fractions() -> None:
    rows = np.array([[0.1, -0.3, 0.0], [0.2, -0.6, 0.0], [0.0, 0.1, -0.3], [0.05, -0.15, 0.0], [0.2, -0.6, 1e-300]])
    (group,) = parallel_rows(sp.csr_matrix(rows), signed=True)
    assert (group.rows.tolist(), group.factors) == ([0, 1, 3], (1, 2, Fraction(1, 2)))
    least = np.nextafter(0.0, 1.0)  # half of three times this is not a double, and neither is half of it
    assert not parallel_rows(sp.csr_matrix([[1.0, 3 * least], [0.5, 2 * least]]), signed=True)
    (group,) = parallel_rows(sp.csr_matrix([[1.0, 4 * least], [0.5, 2 * least]]), signed=True)
    assert group.factors == (1, Fraction(1, 2))


@pytest.mark.parametrize("n", SIZES)
def test_contacts_out_of_reach_within_bounds_are_set_aside_and_those_at_its_end_are_not(n: int) -> None:
    box = sp.vstack([sp.identity(n), -sp.identity(n)], format="csr")
    sums = sp.csr_matrix(np.triu(np.ones((3, n)))) if n < 10 else sp.csr_matrix(np.ones((3, n)))
    most = np.asarray(sums.sum(axis=1)).ravel()
    rows = sp.vstack([box, sums], format="csr")
    gap = np.concatenate([np.ones(2 * n), [most[0] * (1 + 1e-9), most[1], most[2] / 2]])
    problem = problem_of(n, rows, gap)
    assert never_close(problem).tolist() == [2 * n]
    found = cq.solve(problem)
    assert found.certificate.proven
    assert any(f"contact {2 * n}, out of reach" in note for note in found.certificate.notes)
    assert found.normal_force[2 * n] == 0.0
    assert cq.certify(problem, found.displacement, found.normal_force).passed


@pytest.mark.sampled(2)
@pytest.mark.parametrize("n", SIZES)
def test_parallel_ties_share_their_force_with_their_sign(n: int) -> None:
    rows, gap = polytope(n)
    ties = sp.csr_matrix(([1.0, 1.0], ([0, 0], [0, n - 1])), shape=(1, n))
    single = problem_of(n, rows, gap, tie=ties, tie_value=[0.125])
    twice = problem_of(n, rows, gap, tie=sp.vstack([ties, -2 * ties]), tie_value=[0.125, -0.25])
    expected, found = cq.solve(single), cq.solve(twice)
    assert found.certificate.passed
    assert any("tie 1, parallel to equal ones" in note for note in found.certificate.notes)
    assert found.displacement == pytest.approx(expected.displacement, rel=1e-12, abs=1e-14)
    (force,) = expected.tie_force
    assert found.tie_force == pytest.approx([force / 5, -2 * force / 5])


@pytest.mark.parametrize("n", [6, 150, pytest.param(1500, marks=pytest.mark.slow)])
def test_ties_that_contradict_are_proven_to_with_weights_for_every_row(n: int) -> None:
    rows, gap = polytope(n)
    every, wide = sp.vstack([rows, rows], format="csr"), np.concatenate([gap, gap])
    ties = sp.csr_matrix(([1.0, 1.0], ([0, 0], [0, n - 1])), shape=(1, n))
    problem = problem_of(n, every, wide, tie=sp.vstack([ties, 3 * ties]), tie_value=[0.125, 0.375 + 1e-9])
    with pytest.raises(cq.NoEquilibrium, match="tie 0, tie 1") as caught:
        cq.solve(problem)
    proof = caught.value.proof
    assert proof.exact
    assert proof.normal.shape == (problem.contacts,)
    assert proof.tie.shape == (2,)
    weights = [Fraction(float(x)).limit_denominator(1000) for x in proof.tie]
    assert weights[0] + 3 * weights[1] == 0
    assert sum(w * Fraction(float(b)) for w, b in zip(weights, problem.tie_value, strict=True)) < 0


@pytest.mark.slow
def test_a_long_chain_of_ties_that_contradict_is_proven_in_rational_numbers() -> None:
    """Beyond what elimination in rational numbers can do, the weights of a chain are whole numbers all the same."""
    n = 300
    steps = sp.diags([np.ones(n - 1), -np.ones(n - 1)], [0, 1], shape=(n - 1, n))
    closing = sp.csr_matrix(([1.0, -1.0], ([0, 0], [0, n - 1])), shape=(1, n))
    value = np.append(np.full(n - 1, 0.125), 0.125 * (n - 1) + 1e-6)
    problem = problem_of(n, sp.csr_matrix((0, n)), np.zeros(0), tie=sp.vstack([steps, closing]), tie_value=value)
    with pytest.raises(cq.NoEquilibrium) as caught:
        cq.solve(problem)
    proof = caught.value.proof
    assert proof.exact
    assert not np.any(problem.tie.T @ proof.tie)
    assert proof.excess == pytest.approx(1e-6, rel=1e-6)


def test_where_rows_do_not_outnumber_the_unknowns_all_of_them_are_shown() -> None:
    problem = problem_of(6, sp.csr_matrix(np.eye(6)[[0, 0, 1]]), np.zeros(3))
    assert not any("set aside" in note for note in cq.solve(problem).certificate.notes)
    assert presolved(problem) is not None


def test_a_start_counts_for_the_rows_that_are_left() -> None:
    _, every = repeated(6)
    found = cq.solve(every)
    again = cq.solve(every.replace(load=every.load * (1 + 1e-3)), warm_start=found)
    assert again.certificate.proven
    fewer = presolved(every)
    assert fewer is not None
    left = fewer.contacts.restricted(found.normal_force)
    assert fewer.contacts.matrix @ left == pytest.approx(found.normal_force)


def test_contacts_that_ties_hold_have_no_force() -> None:
    """Wherever else they stand: a tie takes what such a contact might push, and no pair of them squeezes the other."""
    K, load = np.diag([2.0, 3.0]), np.array([5.0, 7.0])
    rows, gap = [[-2.0, 0.0], [1.0, 0.0], [0.0, 1.0]], [-1.0, 0.75, 1.0]
    tied = cq.ContactProblem(K, load, rows, gap, tie=[[4.0, 0.0]], tie_value=[2.0])  # u = 1/2: closed, open, free
    assert held_by_ties(tied).tolist() == [0, 1]
    fewer = presolved(tied)
    assert fewer is not None
    assert fewer.contacts.kept.tolist() == [2]
    assert fewer.notes == ("set aside: contact 0, contact 1, held by ties",)
    for method in ("active-set", "clarabel", "osqp"):
        solution = cq.solve(tied, method)
        assert solution.displacement == pytest.approx([0.5, 1.0])
        assert solution.normal_force == pytest.approx([0.0, 0.0, 4.0])
        assert solution.tie_force == pytest.approx([1.0])  # 4 nu = 5 - 2 / 2
    beyond = tied.replace(gap=[-1.0, 0.25, 1.0])  # the tie is further than the second contact lets it be
    assert held_by_ties(beyond).tolist() == [0]
    with pytest.raises(cq.NoEquilibrium):
        cq.solve(beyond)


def test_a_vertex_of_a_program_with_repeated_rows_is_not_searched_again_for_its_certificate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The certificate of all rows began at doubles, and took 500 systems for a minimum cut in other units."""
    costs = np.random.default_rng(3).integers(1, 9, 12).astype(float)
    supply, demand = np.array([3.0, 4.0, 5.0]), np.array([2.0, 3.0, 3.0, 4.0])
    carried = np.vstack([np.kron(np.eye(3), np.ones(4)), np.kron(np.ones(3), np.eye(4))])
    rows = np.vstack([-np.eye(12), -3.0 * np.eye(12), -0.7 * np.eye(12)])
    ties = np.vstack([carried, 3.0 * carried[:2]])
    values = np.concatenate([supply, demand, 3.0 * supply[:2]])
    problem = cq.ContactProblem(np.zeros((12, 12)), -costs, rows, np.zeros(36), tie=ties, tie_value=values)
    solution = cq.solve(problem)
    assert solution.certificate.proven
    assert solution.energy == float(Fraction(cq.exact(problem).energy))
    monkeypatch.setattr(interior_point, "nearest_state", lambda *_: pytest.fail("the vertex is known"))
    forces = dict(normal_force=solution.normal_force, tie_force=solution.tie_force)
    assert cq.certify(problem, displacement=solution.displacement, **forces).proven
