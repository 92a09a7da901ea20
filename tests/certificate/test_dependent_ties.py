"""Ties that depend on others: those whose values agree are set aside and named, those that conflict are refused."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from benchmarks.families_of_constraints import answer_shared_with_ties
from contactqp.certificate.idle_rows import dependent_sparse_ties, sharing_unknowns

K = np.diag([2.0, 3.0, 5.0, 7.0])
LOAD = np.array([1.0, -2.0, 0.5, 0.0])
FAR = np.array([[1.0, 0.0, 0.0, 0.0]])
# Of the chords of a ring any three make the fourth.
RING = np.array([[-1.0, 1, 0, 0], [0, -1, 1, 0], [0, 0, -1, 1], [1, 0, 0, -1]])


def ring(excess: float, scale: float = 1.0, **arguments) -> cq.ContactProblem:
    value = scale * np.array([0.25, 0.5, -0.125, -0.625])
    value[3] += excess
    return cq.ContactProblem(K, LOAD, FAR, [1e3 * scale], tie=RING, tie_value=value, **arguments)


def test_a_tie_that_depends_on_others_is_named_with_those():
    solution = cq.solve(ring(0.0))
    assert solution.certificate.passed
    (note,) = [note for note in solution.certificate.notes if "depends on" in note]
    (unused,) = np.flatnonzero(solution.tie_force == 0)
    assert note.startswith(f"tie {unused} depends on ")
    assert all(f"tie {j}" in note for j in range(4))


def test_only_the_ties_that_take_part_are_named():
    rows = np.vstack([np.eye(4)[2], 3 * RING[0], RING[0]])
    problem = cq.ContactProblem(K, LOAD, FAR, [1e3], tie=rows, tie_value=[0.1, 0.75, 0.25])
    (note,) = [note for note in cq.solve(problem).certificate.notes if "depends on" in note]
    assert "tie 0" not in note
    assert "tie 1" in note
    assert "tie 2" in note


def test_independent_ties_are_not_spoken_of():
    problem = cq.ContactProblem(K, LOAD, FAR, [1e3], tie=RING[:3], tie_value=[0.25, 0.5, -0.125])
    assert not any("depends on" in note for note in cq.solve(problem).certificate.notes)


def test_of_many_dependent_ties_the_first_are_named_and_the_others_counted():
    problem = cq.ContactProblem(K, LOAD, FAR, [1e3], tie=np.tile(RING[0], (12, 1)), tie_value=np.full(12, 0.25))
    said = cq.solve(problem).certificate.notes
    notes = [note for note in said if " depends on " in note or "ties depend on others" in note]
    assert len(notes) == 9
    assert notes[-1] == "3 more ties depend on others"


@pytest.mark.sampled(11)
@pytest.mark.parametrize("method", ["active-set", "lemke", "lagrange-multiplier", "clarabel"])
@pytest.mark.parametrize("excess", [1e-3, 1e-6, 1e-9, -1e-9])
@pytest.mark.parametrize("scale", [1.0, 1e5])
def test_a_conflict_of_ties_is_proven_however_small(method, excess, scale):
    with pytest.raises(cq.NoEquilibrium, match="no displacement satisfies these constraints together") as refused:
        cq.solve(ring(excess * scale, scale), method)
    proof = refused.value.proof
    assert proof.exact
    assert proof.excess == pytest.approx(abs(excess) * scale, rel=1e-6)


@pytest.mark.sampled(6)
@pytest.mark.parametrize("method", ["active-set", "lemke", "lagrange-multiplier", "clarabel"])
@pytest.mark.parametrize("excess", [1e-3, 1e-9])
def test_a_conflict_of_contacts_is_proven_however_small(method, excess):
    """A ring of gaps whose sum is negative, on bodies that float."""
    chain = np.array([[1.0, -1, 0, 0], [-1, 2, -1, 0], [0, -1, 2, -1], [0, 0, -1, 1]])
    gap = np.array([0.25, 0.5, -0.125, -0.625 - excess, 0.0])
    problem = cq.ContactProblem(chain, [-1.0, 0, 0, 0], np.vstack([RING, [-1.0, 0, 0, 0]]), gap)
    with pytest.raises(cq.NoEquilibrium, match="contact 0, contact 1, contact 2, contact 3 "):
        cq.solve(problem, method)


def test_what_rounding_makes_of_agreeing_values_is_no_conflict():
    value = np.array([0.1, 0.2, 0.3])
    problem = cq.ContactProblem(K, LOAD, FAR, [1e3], tie=RING, tie_value=[*value, -float(np.sum(value))])
    assert cq.solve(problem).certificate.passed


@pytest.mark.slow
def test_dependent_ties_are_named_where_nothing_is_condensed() -> None:
    """A membrane held over an obstacle, too many contacts to condense: three ties on three nodes in a circle."""
    side = 50
    chain = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(side, side))
    one, n = sp.identity(side), side * side
    ties = sp.csr_matrix(
        ([1.0, -1.0, 1.0, -1.0, 2.0, -2.0, 1.0], ([0, 0, 1, 1, 2, 2, 3], [5, 9, 9, 20, 5, 20, 77])), shape=(4, n)
    )
    membrane = cq.ContactProblem(
        stiffness=sp.csr_matrix(sp.kron(one, chain) + sp.kron(chain, one)),
        load=np.full(n, 1e-3),
        normal=sp.identity(n, format="csr"),
        gap=np.full(n, 0.03),
        tie=ties,
        tie_value=[0.001, 0.001, 0.004, 0.0],
    )
    solution = cq.solve(membrane)
    assert solution.work.retained == n
    assert solution.certificate.passed
    (said,) = [note for note in solution.certificate.notes if "depends on" in note]
    assert {name for name in ("tie 0", "tie 1", "tie 2", "tie 3") if name in said} == {"tie 0", "tie 1", "tie 2"}
    with pytest.raises(cq.NoEquilibrium, match="tie 0, tie 1, tie 2"):
        cq.solve(membrane.replace(tie_value=[0.001, 0.001, 0.0041, 0.0]))


@pytest.mark.sampled(24)
@pytest.mark.parametrize("seed", range(24))
def test_bounds_of_shared_forces_hold_in_any_units(seed: int) -> None:
    """Of the forces of contacts and ties, |E'dl + A'dnu| in K^-1 over that of the answer is no larger than the bound.

    Bounds in units of 1e-7 to 1e7 of each unknown and row were a thousandth of the error: rows were compared before
    their unknowns had one unit. Others were two thirds of it: a force that pulled was set to zero, and what it balanced
    left as it was.
    """
    rng = np.random.default_rng([28, seed])
    stiffness, contacts, ties, u, force, tie_force = answer_shared_with_ties(rng)
    unknown, row, tied = (4.0 ** rng.integers(-12, 13, len(each)) for each in (u, force, tie_force))
    problem = cq.ContactProblem(
        stiffness / np.outer(unknown, unknown),
        (stiffness @ u + contacts.T @ force + ties.T @ tie_force) / unknown,
        contacts / unknown * row[:, None],
        (contacts @ u) * row,
        tie=ties / unknown * tied[:, None],
        tie_value=(ties @ u) * tied,
    )
    inverse = np.linalg.inv(stiffness)

    def felt(push: np.ndarray, held: np.ndarray) -> float:
        resultant = contacts.T @ push + ties.T @ held
        return float(np.sqrt(max(resultant @ inverse @ resultant, 0.0)))

    size = felt(force, tie_force)
    pushed = felt(force, -np.linalg.lstsq(ties.T, contacts.T @ force, rcond=None)[0])
    assert cq.certify(problem, u * unknown, force / row, tie_force=tie_force / tied).passed
    for part in (1e-9, 1e-6, 1e-3):
        changes = (part * force, 0 * tie_force), (part * rng.normal(size=len(force)) * force, 0 * tie_force)
        for change, turn in (*changes, (0 * force, part * rng.normal(size=len(tie_force)))):
            given = np.maximum(force + change, 0.0), tie_force + turn
            certificate = cq.certify(problem, u * unknown, given[0] / row, tie_force=given[1] / tied)
            error = felt(given[0] - force, turn)
            relative = error / size if pushed >= 1e-6 * size > 0 else min(error, error / (size or 1.0))
            assert certificate.force_error is not None
            assert certificate.force_error >= relative * (1 - 1e-6) - 1e-12
            assert not (certificate.passed and error > 1e-5 * size)


def test_forces_that_ties_take_up_but_for_rounding_are_compared_with_those_of_ties() -> None:
    """Of a chain on a support of 2^-45 contacts push what a tie carries: their force on the tied chain is rounding."""
    springs = [0.125, 2.0, 1.0, 1.0, 0.25]
    stiffness = np.zeros((6, 6))
    for place, spring in enumerate(springs):
        stiffness[place : place + 2, place : place + 2] += spring * np.array([[1.0, -1.0], [-1.0, 1.0]])
    stiffness[0, 0] += 2.0**-45
    row, u = np.array([-4.0, 2.0, 0.0, -4.0, 2.0, 4.0]), np.array([1.0, 0.0, -0.5, -0.875, 1.0, -0.875])
    contacts, force, tie_force = np.array([row / 2, row]), np.array([0.4375, 0.8125]), np.array([0.25])
    load = stiffness @ u + contacts.T @ force + row * tie_force
    problem = cq.ContactProblem(stiffness, load, contacts, contacts @ u, tie=row[None], tie_value=[row @ u])
    assert cq.certify(problem, u, force, tie_force=tie_force).passed
    assert cq.certify(problem, u, force + np.array([0.25, -0.125]), tie_force=tie_force).passed
    assert not cq.certify(problem, u, force * 1.001, tie_force=tie_force).passed
    assert not cq.certify(problem, u, force, tie_force=tie_force * 1.001).passed


@pytest.mark.parametrize("seed", range(4))
def test_ties_with_an_unknown_of_their_own_take_part_in_no_dependence(seed: int) -> None:
    """Ties on a tree that hangs on a ring are left out one after the other; what depends is what it is without that."""
    random = np.random.default_rng(seed)
    ring_size, n = 6, 20
    pairs = [(i, (i + 1) % ring_size) for i in range(ring_size)]
    pairs += [(int(random.integers(0, j)), j) for j in range(ring_size, n)]
    pairs = [pairs[i] for i in random.permutation(len(pairs))]
    rows = sp.csr_matrix(np.array([np.eye(n)[i] - np.eye(n)[j] for i, j in pairs]))
    on_ring = [k for k, pair in enumerate(pairs) if max(pair) < ring_size]
    assert sharing_unknowns(rows).tolist() == on_ring
    problem = cq.ContactProblem(sp.identity(n), np.ones(n), np.eye(1, n), [9.0], tie=rows, tie_value=np.zeros(n))
    ((one, others),) = dependent_sparse_ties(problem)
    assert sorted([one, *others.tolist()]) == on_ring


@pytest.mark.parametrize("excess", [0.0, 1e-14, 5e-14])
def test_nothing_is_proven_of_ties_that_contradict_each_other_by_rounding(excess: float) -> None:
    """x + y = 4 and 2 x + 2 y = 8 + d have no solution but for d = 0; up to rounding they are met and pass."""
    problem = cq.ContactProblem(
        [[2.0, 1.0], [1.0, 3.0]], [9.0, 1.0], [[1.0, 1.0]], [9.0], tie=[[1.0, 1.0], [2.0, 2.0]],
        tie_value=[4.0, 8.0 + excess],
    )  # fmt: skip
    certificate = cq.solve(problem).certificate
    assert certificate.passed
    assert certificate.proven == (excess == 0)
    assert any("depends on" in note for note in certificate.notes)
    assert any("ties that depend on each other to rounding conflict" in reason for reason in certificate.reasons) == (
        excess > 0
    )
