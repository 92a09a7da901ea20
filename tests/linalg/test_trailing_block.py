"""SuperLU with the retained unknowns last: S, loads and displacements against dense algebra and closed forms."""

import os

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from contactqp.elements.loads import Traction
from contactqp.elements.material import Material
from contactqp.elements.shapes import box, rectangle
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from contactqp.errors import InvalidProblem
from contactqp.linalg.condensation import eliminate
from contactqp.linalg.dense import DENSE_SIZE, BackSubstitution
from contactqp.linalg.factorization import DIAGONAL_PIVOTS, SuperLU, fill_reducing_order, forget_triangles
from contactqp.linalg.schur import TrailingBlock


def two_blocks(second_modulus=1.0):
    """Two plane bodies that do not touch, the first held at its top, the second nowhere."""
    bodies = [
        Body(rectangle(1.0, 0.5, (8, 4)), Material(1.0, 0.3), "plane-strain", name="one"),
        Body(rectangle(1.0, 0.5, (7, 5), corner=(0, 2)), Material(second_modulus, 0.3), "plane-strain", name="two"),
    ]
    structure = Structure(bodies)
    held = [Support("one", "top", 0), Support("one", "top", 1)]
    loads = [Traction("two", "top", [0.1, -1.0]), Traction("one", "left", [1.0, 0.2])]
    system = structure.assemble(held, loads)
    problem = system.problem([])
    return problem.stiffness_rows, problem.load


def solid_block():
    structure = Structure([Body(box((1.0, 1.0, 0.7), (5, 4, 4)), Material(2.1e11, 0.3), "3d", name="block")])
    held = [Support("block", "top", axis) for axis in range(3)]
    system = structure.assemble(held, [Traction("block", "left", [1e6, 0.0, 2e5])])
    problem = system.problem([])
    return problem.stiffness_rows, problem.load


def members_of_second(K):
    return np.flatnonzero(sp.csgraph.connected_components(K)[1] == 1)


def a_few_of_two_bodies(second_modulus=1.0):
    """Of the second enough to hold it where it floats."""
    K, f = two_blocks(second_modulus)
    return K, f, np.r_[3:20:4, members_of_second(K)[[0, 1, 30, -2, -1]]]


def all_of_one_body():
    K, f = two_blocks()
    return K, f, members_of_second(K)


def all_but_one():
    K, f = two_blocks()
    return K, f, np.delete(np.arange(len(f)), 17)


def every(step, low=0):
    K, f = solid_block()
    return K, f, np.arange(low, len(f), step)


CASES = {
    "a few of two bodies, one floating": a_few_of_two_bodies,
    "stiffness contrast 1e8": lambda: a_few_of_two_bodies(1e8),
    "all of one body, none of the other": all_of_one_body,
    "all but one": all_but_one,
    "every second": lambda: every(2),
    "every seventh": lambda: every(7),
    "a single one": lambda: every(10**6, 100),
    "none": lambda: every(1, 10**6),
}


def dense(K, f, c):
    """S, f_S and the interior's response to u_c = 1, 2, 3, ... by numpy, in the scale that gives K a unit diagonal."""
    D = 1.0 / np.sqrt(K.diagonal())
    A, b = K.toarray() * np.outer(D, D), D * f
    i = np.setdiff1d(np.arange(len(f)), c)
    A_ci, at = A[np.ix_(c, i)], np.arange(1.0, len(c) + 1)
    X = np.linalg.solve(A[np.ix_(i, i)], np.column_stack([A_ci.T, b[i]]))
    S, f_S = A[np.ix_(c, c)] - A_ci @ X[:, :-1], b[c] - A_ci @ X[:, -1]
    u = np.empty(len(f))
    u[c], u[i] = at, X[:, -1] - X[:, :-1] @ at
    return D, S, f_S, u


@pytest.mark.sampled(4)
@pytest.mark.parametrize("case", CASES)
def test_bodies_leave_the_dense_schur_complement(case):
    K, f, c = CASES[case]()
    D, S, f_S, u = dense(K, f, c)
    found = TrailingBlock(K, c)
    left = found.schur * np.outer(D[c], D[c])
    assert np.max(abs(left - S), initial=0.0) <= 1e-14 * np.max(abs(S), initial=1.0)
    assert np.array_equal(found.schur, found.schur.T)
    reduced, state = found.reduce(f)
    assert reduced * D[c] == pytest.approx(f_S, rel=0, abs=1e-13 * np.max(abs(D * f)))
    at = D[c] * u[c]
    displaced = found.expand(at, state)
    assert displaced[c].tolist() == at.tolist()
    assert displaced / D == pytest.approx(u, rel=0, abs=1e-13 * np.max(abs(u)))
    assert found.half_substitutions == 4
    assert 1e-3 < found.smallest_pivot <= 1.0
    if len(c) and len(c) < len(f) // 2:  # the comparison tells S from what was there before elimination
        assert np.max(abs(K[c][:, c].toarray() * np.outer(D[c], D[c]) - S)) > 1e-2


def chain(springs):
    """K of masses in a row, nothing held."""
    k = np.asarray(springs, dtype=float)
    return sp.diags([-k, np.r_[k, 0.0] + np.r_[0.0, k], -k], [-1, 0, 1]).tocsr()


@pytest.mark.parametrize(("octaves", "tolerance"), [(1, 1e-12), (13, 1e-9), (26, 1e-6)])
def test_a_floating_chain_leaves_its_springs_in_series(octaves, tolerance):
    """Retained ends: k = 1 / sum 1/k_j; a load goes to the ends as the compliances beside it; ends that are carried far
    away take the masses along. The tolerances go with the condition of K."""
    rng = np.random.default_rng(1)
    k = 2.0 ** rng.integers(0, octaves, 500)  # their sums are exact
    compliance = np.cumsum(np.r_[0.0, 1 / k])
    series, share = 1 / compliance[-1], compliance[200] / compliance[-1]
    ends, f = np.array([0, 500]), np.zeros(501)
    f[200] = 3.0
    found = TrailingBlock(chain(k), ends)
    assert found.schur / series == pytest.approx(np.array([[1.0, -1.0], [-1.0, 1.0]]), rel=tolerance)
    reduced, state = found.reduce(f)
    assert reduced == pytest.approx([3.0 * (1 - share), 3.0 * share], rel=tolerance)
    sag = 3.0 * np.minimum(compliance * (1 - share), compliance[200] * (1 - compliance / compliance[-1]))
    u = found.expand(np.array([1e3, 2e3]), state)
    assert u == pytest.approx(1e3 + 1e3 * compliance / compliance[-1] + sag, rel=tolerance)
    assert u[ends].tolist() == [1e3, 2e3]


@pytest.mark.parametrize("size", [5, 400])
def test_an_interior_that_floats_has_a_pivot_of_zero_and_keeps_finite_numbers(size):
    """Two chains of unit springs, the second with nothing retained: its last pivot is exactly zero."""
    K = sp.block_diag([chain(np.ones(size)), chain(np.ones(size))], format="csr")
    for way in (TrailingBlock, eliminate):
        found = way(K, np.array([0, size]))
        assert found.smallest_pivot == pytest.approx(0.0, abs=1e-12)
        assert found.smallest_pivot <= 1e-15
        assert found.schur == pytest.approx(np.array([[1, -1], [-1, 1]]) / size, rel=1e-6)
        reduced, state = found.reduce(np.ones(2 * size + 2))
        assert np.all(np.isfinite(found.expand(reduced, state)))
    held = K + sp.diags(np.r_[np.zeros(2 * size + 1), 1.0])
    assert TrailingBlock(sp.csr_matrix(held), np.array([0, size])).smallest_pivot > 1e-4


@pytest.mark.parametrize("lowest", [0.0, -1e-3])
def test_an_indefinite_interior_is_refused(lowest):
    """A pivot that is negative at once, and a zero beside which SuperLU takes a pivot that is not on the diagonal."""
    middle = np.array([[1.0, 1.0, 0.0], [1.0, 1.0 + lowest, 0.5], [0.0, 0.5, 0.25]])
    K = sp.block_diag([chain(np.ones(DENSE_SIZE)), middle], format="csr")
    for way in (TrailingBlock, eliminate):
        with pytest.raises(InvalidProblem, match=r"positive semidefinite, got a pivot of -"):
            way(K, np.array([0]))


def test_where_everything_is_retained_nothing_is_eliminated():
    K, f = two_blocks()
    found = eliminate(K, np.arange(len(f)))
    assert isinstance(found, BackSubstitution)
    assert np.array_equal(found.schur, K.toarray())
    reduced, state = found.reduce(f)
    assert np.array_equal(reduced, f)
    assert np.array_equal(found.expand(f, state), f)
    assert found.half_substitutions == 0


def test_a_load_on_retained_unknowns_alone_is_left_as_it_is():
    K, f = solid_block()
    c = np.arange(0, len(f), 7)
    load = np.zeros(len(f))
    load[c] = f[c] + 1.0
    reduced, _ = TrailingBlock(K, c).reduce(load)
    assert np.array_equal(reduced, load[c])


def test_the_order_keeps_factors_sparse():
    cells = np.ones((40, 40))
    K = sp.kronsum(chain(cells[0]), chain(cells[0])) + sp.identity(41 * 41)
    order = fill_reducing_order(K)
    assert np.array_equal(np.sort(order), np.arange(41 * 41))
    own = splu(sp.csc_matrix(K), permc_spec="MMD_AT_PLUS_A", **DIAGONAL_PIVOTS).nnz
    ours = splu(sp.csc_matrix(sp.csr_matrix(K)[order][:, order]), permc_spec="NATURAL", **DIAGONAL_PIVOTS).nnz
    none = splu(sp.csc_matrix(K), permc_spec="NATURAL", **DIAGONAL_PIVOTS).nnz
    assert ours <= 1.01 * own
    assert none > 2 * ours


def test_the_order_is_one_of_the_pattern_alone():
    K, _ = two_blocks()
    other = K.copy()
    other.data = np.random.default_rng(2).standard_normal(K.nnz)
    assert np.array_equal(fill_reducing_order(K), fill_reducing_order(other))


def test_triangles_that_were_looked_at_are_given_back_and_the_factors_still_solve():
    K, f = solid_block()
    factor = splu(sp.csc_matrix(K))
    before = factor.solve(f)
    assert factor.L.nnz + factor.U.nnz > K.nnz
    forget_triangles(factor)
    assert factor.L.nnz + factor.U.nnz == 0
    assert np.array_equal(factor.solve(f), before)


def test_a_whole_solve_with_superlu_agrees_with_the_elimination():
    """Another path to the same displacement: K^-1 f without retaining anything, and through S."""
    K, f = solid_block()
    c = np.arange(0, len(f), 7)
    found = TrailingBlock(K, c)
    reduced, state = found.reduce(f)
    through = found.expand(np.linalg.solve(found.schur, reduced), state)
    straight = SuperLU(K).solve(f)
    assert np.max(abs(through - straight)) <= 1e-13 * np.max(abs(straight))


def test_what_superlu_prints_of_singular_matrices_is_not_heard(monkeypatch, capfd):
    """A cable of a thousand bars had written BLAS's complaints into the JSON of its answer."""

    def speaking(matrix, **options):
        os.write(1, b" ** On entry to DTRSV  parameter number  6 had an illegal value\n")
        return splu(matrix, **options)

    monkeypatch.setattr("scipy.sparse.linalg.splu", speaking)
    TrailingBlock(
        sp.diags([-np.ones(299), np.full(300, 2.0), -np.ones(299)], [-1, 0, 1], format="csr"), np.array([299])
    )
    print("heard")
    assert capfd.readouterr().out == "heard\n"
