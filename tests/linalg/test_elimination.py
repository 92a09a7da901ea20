"""All ways of eliminating interior unknowns against the dense formula, and the solver that is taken by itself."""

from functools import partial

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components, dijkstra

import contactqp as cq
from contactqp.elements.material import Material
from contactqp.elements.shapes import box, rectangle
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from contactqp.errors import BackendFailed, InvalidProblem, Unsupported
from contactqp.linalg import condensation, factorization, pardiso, schur
from contactqp.linalg.condensation import condense, eliminate
from contactqp.linalg.dense import BackSubstitution, DenseCholesky, orthonormal
from contactqp.linalg.factorization import (
    connected_parts,
    factorise,
    joined_parts,
    null_space,
)
from contactqp.linalg.pardiso import EliminationOrder, NotPositive, Pardiso, available
from contactqp.linalg.schur import LastBlock, TrailingBlock

needs_pardiso = pytest.mark.skipif(not available(), reason="needs pypardiso")
WAYS = [partial(BackSubstitution, factorise=factorise), TrailingBlock, pytest.param(LastBlock, marks=needs_pardiso)]


def pressed_block(cells=12, **held):
    """A block pressed onto a paraboloid; `held` says what the top is held by besides its vertical displacement."""
    body = Body(rectangle(1.0, 0.5, (2 * cells, cells)), Material(1.0, 0.3), "plane-strain", name="block")
    structure = Structure([body])
    supports = [Support("block", "top", 1, -0.02)] + [Support("block", "top", 0)] * (not held.get("free"))
    paraboloid = cq.Paraboloid([0.5, 0.0], [0.0, 1.0], 5.0)
    return structure.assemble(supports).problem([cq.pair(structure.surface("block", "bottom"), paraboloid)])


@pytest.mark.parametrize("way", WAYS)
def test_what_elimination_leaves_is_the_schur_complement(way):
    problem = pressed_block(6)
    K, f = problem.stiffness.toarray(), problem.load
    c = np.unique(problem.normal.indices)
    i = np.setdiff1d(np.arange(len(f)), c)
    inverse = np.linalg.inv(K[np.ix_(i, i)])
    S = K[np.ix_(c, c)] - K[np.ix_(c, i)] @ inverse @ K[np.ix_(i, c)]
    found = way(problem.stiffness_rows, c)
    assert np.max(abs(found.schur - S)) <= 1e-14 * np.max(abs(S))
    assert 0 < found.smallest_pivot < 1
    reduced, state = found.reduce(f)
    assert reduced == pytest.approx(f[c] - K[np.ix_(c, i)] @ inverse @ f[i], rel=1e-12, abs=1e-15)
    at = np.linspace(0.0, 1.0, len(c))
    u = found.expand(at, state)
    assert u[c].tolist() == at.tolist()
    assert np.max(abs((K @ u - f)[i])) <= 1e-14 * np.max(abs(K))


@needs_pardiso
def test_pardiso_refuses_what_is_not_positive_definite_and_elimination_then_goes_the_other_way(monkeypatch):
    indefinite = sp.csr_matrix(np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 1.0], [0.0, 1.0, 4.0]]))
    with pytest.raises(NotPositive):
        Pardiso(indefinite, np.array([2]))
    monkeypatch.setenv(pardiso.SOLVER_VARIABLE, "pardiso")
    floating = sp.csr_matrix(np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 4.0]]))
    assert eliminate(floating, np.array([2])).smallest_pivot <= 1e-15


def test_a_solver_that_does_not_exist_is_refused(monkeypatch):
    monkeypatch.setenv(pardiso.SOLVER_VARIABLE, "parsido")
    with pytest.raises(InvalidProblem, match=r"expected one of superlu, pardiso, pyamg, got .parsido."):
        cq.solve(pressed_block(3))


@pytest.mark.sampled(2)
@needs_pardiso
@pytest.mark.parametrize("free", [False, True])
def test_the_sparse_solver_makes_no_difference_to_the_answer(monkeypatch, free):
    """Held, and free to slide sideways: then the interior is held by the unknowns that are retained for it."""
    solutions = {}
    for solver in schur.SOLVERS:
        monkeypatch.setenv(pardiso.SOLVER_VARIABLE, solver)
        problem = pressed_block(12, free=free)
        solutions[solver] = cq.solve(problem)
        assert condense(problem).solver == solver
        assert solutions[solver].certificate.passed
        assert len(solutions[solver].free_motions) == int(free)
    one, other = solutions.values()
    assert np.max(abs(one.normal_force - other.normal_force)) <= 1e-14 * np.max(one.normal_force)
    assert np.max(abs(one.displacement - other.displacement)) <= 1e-14 * np.max(abs(one.displacement))


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("step", "way"), [(2, BackSubstitution), (4, BackSubstitution), (9, TrailingBlock)])
def test_superlu_eliminates_in_one_go_where_few_are_retained(monkeypatch, step, way):
    """Among many that are retained, and in small bodies, back-substitutions are cheaper."""
    monkeypatch.setenv(pardiso.SOLVER_VARIABLE, "superlu")
    K = pressed_block(12).stiffness_rows
    assert K.shape[0] > 300
    assert isinstance(eliminate(K, np.arange(0, K.shape[0], step)), way)
    small = pressed_block(5).stiffness_rows
    assert isinstance(eliminate(small, np.arange(0, small.shape[0], step)), BackSubstitution)


def test_superlu_needs_few_back_substitutions(monkeypatch):
    """Not one for every retained unknown: a reduced load and an expanded displacement take one each."""
    monkeypatch.setenv(pardiso.SOLVER_VARIABLE, "superlu")
    problem = pressed_block(20)
    solution = cq.solve(problem)
    assert isinstance(eliminate(problem.stiffness_rows, condense(problem).retained), TrailingBlock)
    assert solution.certificate.passed
    assert solution.certificate.force_error <= 1e-10
    assert solution.work.factorisations == 1
    assert solution.work.back_substitutions <= 10 < solution.work.retained
    again = cq.solve(problem.replace(load=1.1 * problem.load))
    assert again.work.factorisations == 0


@needs_pardiso
def test_large_bodies_take_pardiso_and_few_back_substitutions(monkeypatch):
    monkeypatch.delenv(pardiso.SOLVER_VARIABLE, raising=False)
    problem = pressed_block(40)
    solution = cq.solve(problem)
    assert condense(problem).solver == "pardiso"
    assert solution.certificate.passed
    assert solution.certificate.force_error <= 1e-10
    assert solution.work.factorisations == 1
    assert solution.work.back_substitutions <= 5
    again = cq.solve(problem.replace(load=1.1 * problem.load))
    assert again.work.factorisations == 0


def test_contacts_whose_dense_stiffness_does_not_fit_are_refused_in_one_line(monkeypatch):
    def full(*_):
        raise MemoryError("Unable to allocate 74.5 GiB")

    monkeypatch.setattr(BackSubstitution, "_schur_complement", full)
    springs = cq.ContactProblem(np.eye(4), np.ones(4), np.eye(4), np.zeros(4))
    with pytest.raises(Unsupported, match=r"4 unknowns at contacts .* memory is full"):
        cq.solve(springs)


def floating_block(cells=18, **changes):
    """A block of more than 900 unknowns, pressed down at its top and held by contact alone."""
    body = Body(rectangle(1.0, 0.5, (2 * cells, cells)), Material(1.0, 0.3), "plane-strain", name="block")
    structure = Structure([body])
    paraboloid = cq.Paraboloid([0.5, 0.0], [0.0, 1.0], 5.0)
    problem = structure.assemble([]).problem([cq.pair(structure.surface("block", "bottom"), paraboloid)])
    load, points = np.zeros(body.size), body.mesh.points
    load[2 * np.flatnonzero(points[:, 1] == 0.5) + 1] = -1e-3
    return problem.replace(load=load, **changes)


def test_a_body_whose_motions_are_stated_is_factorised_once():
    problem = floating_block()
    stated, unstated = cq.solve(problem), cq.solve(problem.replace(near_null_space=None))
    assert stated.work.factorisations == 1
    assert stated.certificate.passed
    assert stated.certificate.proven
    assert condense(problem).rigid.count == 3
    assert np.allclose(stated.normal_force, unstated.normal_force, rtol=0, atol=1e-9 * np.max(unstated.normal_force))


@pytest.mark.slow
def test_motions_that_are_stated_wrongly_or_in_part_stay_hints():
    problem = floating_block()
    reference = cq.solve(problem).normal_force
    motions = problem.near_null_space
    strained = motions + 1e-9 * np.random.default_rng(0).normal(size=motions.shape)
    for hints in (strained, motions[:, :1], np.random.default_rng(1).normal(size=motions.shape)):
        twin = problem.replace(near_null_space=hints)
        assert condense(twin).rigid.count == 3
        solution = cq.solve(twin)
        assert solution.certificate.proven
        assert np.allclose(solution.normal_force, reference, rtol=0, atol=1e-9 * np.max(reference))


@pytest.mark.slow
def test_supports_leave_combinations_of_the_stated_motions():
    # Held in x at one side: only the motion along y is left, one column or a combination of several.
    body = Body(rectangle(1.0, 0.5, (36, 18)), Material(1.0, 0.3), "plane-strain", name="block")
    structure = Structure([body])
    assembled = structure.assemble([Support("block", "left", 0)])
    paraboloid = cq.Paraboloid([0.0, 0.0], [0.0, 1.0], 5.0)
    problem = assembled.problem([cq.pair(structure.surface("block", "bottom"), paraboloid)])
    load = np.zeros(body.size)
    load[2 * np.flatnonzero(body.mesh.points[:, 1] == 0.5) + 1] = -1e-3
    mixed = problem.near_null_space @ np.array([[1.0, 2.0, 0.5], [1.0, -1.0, 3.0], [0.0, 1.0, 1.0]])
    for motions in (problem.near_null_space, mixed):
        twin = problem.replace(load=load[assembled.free], near_null_space=motions)
        assert condense(twin).rigid.count == 1
        assert cq.solve(twin).certificate.proven


def test_an_orthonormal_basis_of_rigid_motions_is_accurate_at_unknowns_of_any_unit():
    """A triangle of bars with one node in nanometres and one in gigametres: K z is rounding everywhere."""
    at = np.array([[0.0, 0.0], [1.3, 0.1], [0.4, 0.9]])
    K = np.zeros((6, 6))
    for i, j in ((0, 1), (1, 2), (0, 2)):
        d = np.concatenate([at[i] - at[j], at[j] - at[i]]) / np.linalg.norm(at[i] - at[j])
        K[np.ix_([2 * i, 2 * i + 1, 2 * j, 2 * j + 1], [2 * i, 2 * i + 1, 2 * j, 2 * j + 1])] += np.outer(d, d)
    units = 2.0 ** np.array([0, 0, 30, 30, -30, -30])
    K = K * np.outer(units, units)
    basis = null_space(K).basis
    assert basis.shape == (6, 3)
    assert basis.T @ basis == pytest.approx(np.eye(3), abs=1e-12)
    assert np.all(abs(K @ basis) <= 64 * np.finfo(float).eps * (abs(K) @ abs(basis)))


@pytest.mark.parametrize("way", WAYS)
def test_several_motions_are_expanded_as_each_is(way):
    problem = pressed_block(6)
    c = np.unique(problem.normal.indices)
    found = way(problem.stiffness_rows, c)
    at = np.random.default_rng(0).normal(size=(len(c), 3))
    _, nothing = found.reduce(np.zeros(problem.dimension))
    each = np.column_stack([found.expand(x, nothing) for x in at.T])
    assert np.max(abs(found.expand_motions(at) - each)) <= 1e-13 * np.max(abs(each))


def floating_in_space(cells=(10, 10, 7), supports=(), **changes):
    """A block of about 2900 unknowns, pressed down by forces on its top; contacts hold it vertically alone."""
    body = Body(box((1.0, 1.0, 0.7), cells, "hex8"), Material(1.0, 0.3), "3d", name="block")
    structure = Structure([body])
    assembled = structure.assemble(list(supports))
    centre = [0.0, 0.0, 0.0] if supports else [0.5, 0.5, 0.0]
    paraboloid = cq.Paraboloid(centre, [0.0, 0.0, 1.0], 5.0)
    problem = assembled.problem([cq.pair(structure.surface("block", "bottom"), paraboloid)])
    load = np.zeros(body.size)
    load[3 * np.flatnonzero(body.mesh.points[:, 2] == 0.7) + 2] = -1e-4
    return problem.replace(load=load[assembled.free], **changes)


QUARTER = (Support("block", "left", 0), Support("block", "front", 1))


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["superlu", pytest.param("pardiso", marks=needs_pardiso)])
@pytest.mark.parametrize(
    ("problem", "motions"),
    [
        (floating_in_space(near_null_space=None), 6),
        (floating_in_space(supports=QUARTER, near_null_space=None), 1),
        (floating_block(24, near_null_space=None), 3),
    ],
    ids=["in space", "quarter", "plane"],
)
def test_a_body_whose_motions_nobody_states_is_factorised_once_too(monkeypatch, solver, problem, motions):
    """Nodes that hold it are retained from the start: no factorisation shows only that the interior floats."""
    monkeypatch.setenv(pardiso.SOLVER_VARIABLE, solver)
    tried = []
    monkeypatch.setattr(condensation, "eliminate", lambda *a: tried.append(1) or eliminate(*a))
    twin = problem.replace(stiffness=problem.stiffness)
    way = condense(twin)
    assert len(tried) == way.factorisations == 1
    assert way.rigid.count == motions
    assert len(way.retained) <= problem.contacts + 12
    assert cq.solve(twin).certificate.proven


def test_many_bodies_are_not_all_held_as_a_precaution():
    """Their nodes would be more unknowns than the contacts touch."""
    chain = sp.diags([np.full(800, 2.0), -np.ones(799), -np.ones(799)], [0, 1, -1])
    ends = sp.csr_matrix((np.ones(30), (np.arange(30), 800 * np.arange(30))), shape=(30, 24000))
    problem = cq.ContactProblem(sp.block_diag([chain] * 30), np.full(24000, 1e-3), ends, np.full(30, 0.1))
    assert len(condense(problem).retained) == 30
    one = cq.ContactProblem(sp.block_diag([chain] * 3), np.full(2400, 1e-3), ends[:3, :2400], np.full(3, 0.1))
    assert len(condense(one).retained) == 12  # the touched ends are among the four nodes of each chain


def test_a_soft_spring_holds_a_body_whose_motions_nobody_states():
    """What is spread over a body as rounding must not be the force of a spring."""
    problem = floating_block(24, near_null_space=None)
    springs = np.zeros(problem.dimension)
    springs[[0, 1, -1]] = 1e-8
    held = problem.replace(stiffness=problem.stiffness + sp.diags(springs, format="csc"))
    assert condense(held).rigid.count == 0
    solution = cq.solve(held)
    assert solution.certificate.proven
    assert not solution.free_motions
    reaction = held.normal.T @ solution.normal_force + springs * solution.displacement
    assert np.sum(reaction[1::2]) == pytest.approx(np.sum(held.load[1::2]), rel=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("bare", [False, True])
def test_a_floating_body_takes_few_back_substitutions(monkeypatch, bare):
    """Six motions that are looked for take one each; what rounding of K makes of motions, which bounds contain, two."""
    monkeypatch.setenv(pardiso.SOLVER_VARIABLE, "superlu")
    problem = floating_in_space(**({"near_null_space": None} if bare else {}))
    solution = cq.solve(problem)
    assert solution.certificate.proven
    assert len(solution.free_motions) == 3
    free = np.column_stack([motion.direction for motion in solution.free_motions])
    size = abs(free).T @ abs(solution.displacement)
    assert np.all(abs(free.T @ solution.displacement) <= 1e-12 * size)  # at rest where nothing holds it
    assert solution.work.back_substitutions <= (23 if bare else 17)


def test_nodes_far_apart_are_as_many_entries_away_as_the_graph_says():
    random = np.random.default_rng(0)
    for _ in range(30):
        size = int(random.integers(2, 60))
        matrix = sp.random(size, size, 0.06, random_state=random, format="csr")
        graph = sp.csr_matrix(matrix + matrix.T + sp.identity(size))
        starts = np.append(np.unique(connected_parts(graph)[1], return_index=True)[1], random.integers(0, size))
        away = dijkstra(graph, directed=False, indices=np.unique(starts), unweighted=True, min_only=True)
        assert factorization._hops_away(graph, starts).tolist() == away.tolist()


@pytest.mark.parametrize("rows", [0, 1, 5])
def test_connected_parts_are_those_of_the_graph(rows):
    assert connected_parts(sp.identity(rows, format="csr"))[0] == rows
    chain = sp.csr_matrix(sp.diags([np.ones(6), np.ones(5), np.ones(5)], [0, 1, -1]))
    count, label = connected_parts(sp.block_diag([chain, sp.identity(rows)], format="csr"))
    assert count == 1 + rows
    assert np.all(label[:6] == label[0])


def test_a_diagonal_below_the_normal_floats_is_scaled_without_overflow():
    matrix = np.outer([1.0, 0.6, 2e-160], [1.0, 0.6, 2e-160])
    assert 0 < matrix[2, 2] < np.finfo(float).tiny
    assert DenseCholesky(matrix).smallest_pivot <= 1e-15


def test_motions_are_orthonormal_in_units_that_make_them_nearly_parallel() -> None:
    units = np.array([1e17, 1.0, 1e-17])
    motions = orthonormal(units[:, None] * np.array([[1.0, 1.0, 1.0], [1.0, 2.0, 3.0], [1.0, 3.0, 7.0]]))
    assert motions.T @ motions == pytest.approx(np.eye(3), abs=1e-14)


def test_motions_that_units_make_dependent_stay_as_they_are() -> None:
    units = np.array([1e17, 1e13, 1e-9])
    motions = orthonormal(units[:, None] * np.array([[0.0, 1.0, 3.0], [-3.0, 2.0, 3.0], [3.0, -2.0, -3.0]]))
    assert np.all(np.isfinite(motions))


@pytest.mark.parametrize("pairs", [0, 3, 10, 64, 65, 300])
def test_parts_that_pairs_join_are_those_of_scipy(pairs: int) -> None:
    for seed in range(10):
        random = np.random.default_rng(seed)
        count = int(random.integers(1, 30))
        one, other = random.integers(0, count, (2, pairs))
        graph = sp.coo_array((np.ones(pairs), (one, other)), shape=(count, count))
        assert joined_parts(count, one, other).tolist() == connected_components(graph, directed=False)[1].tolist()


def test_a_narrow_band_is_factorised_by_lapack_in_an_order_that_is_kept(monkeypatch):
    random, size = np.random.default_rng(3), schur.LARGE + 500
    shuffled = random.permutation(size)
    rows = sp.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(size - 2, size), format="csr")[:, shuffled]
    saddle = sp.bmat([[sp.identity(size), rows.T], [rows, -1e-9 * sp.identity(size - 2)]], format="csc")
    order, nothing = EliminationOrder(size), []
    monkeypatch.setattr(order, "factorised", lambda *_: nothing.append(1))
    right = random.standard_normal(saddle.shape[0])
    found = schur.factorised(saddle, pardiso.INDEFINITE, order, np.arange(size))(right)
    left = right - saddle @ found
    assert np.max(abs(left)) <= 1e-12 * np.max(abs(found))
    first = order.band
    other = saddle + sp.csc_matrix(sp.identity(saddle.shape[0]))
    again = schur.factorised(other, pardiso.INDEFINITE, order, np.arange(size))(right)
    assert order.band is first
    assert np.max(abs(right - other @ again)) <= 1e-12 * np.max(abs(again))
    assert not nothing


def test_a_band_without_an_inverse_is_told_and_a_wide_matrix_is_left_to_sparse_solvers():
    size = schur.LARGE + 500
    singular = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(size, size), format="lil")
    singular[7, :] = singular[:, 7] = 0.0
    with pytest.raises(BackendFailed, match="pivot"):
        schur.factorised(singular.tocsc(), pardiso.INDEFINITE, EliminationOrder(size), np.arange(size))
    side = 60
    chain = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(side, side))
    K = sp.csc_matrix(sp.kron(sp.identity(side), chain) + sp.kron(chain, sp.identity(side)))
    order = EliminationOrder(side**2)
    solve = schur.factorised(K, pardiso.POSITIVE_DEFINITE, order, np.arange(side**2))
    assert order.wide
    assert order.band is None
    assert K @ solve(np.ones(side**2)) == pytest.approx(1.0, abs=1e-10)


def test_a_nearly_dense_matrix_is_factorised_by_lapack(monkeypatch):
    """SuperLU takes twenty times as long for dense rows of a few hundred unknowns."""
    random, size = np.random.default_rng(4), 90
    rows = random.integers(-9, 10, (size, size)).astype(float)
    saddle = sp.bmat([[2.0**-20 * sp.identity(size), rows.T], [rows, -(2.0**-20) * sp.identity(size)]], format="csc")
    wanted = random.integers(-9, 10, 2 * size).astype(float)
    monkeypatch.setattr("scipy.sparse.linalg.splu", None)
    solve = schur.factorised(saddle, pardiso.INDEFINITE, EliminationOrder(size), np.arange(size))
    assert solve(saddle @ wanted) == pytest.approx(wanted, abs=1e-8)
    with pytest.raises(BackendFailed, match="pivot"):
        schur.factorised(sp.csc_matrix(np.ones((3, 3))), pardiso.INDEFINITE, EliminationOrder(3), np.arange(3))


def test_unknowns_that_nothing_couples_are_rigid_where_they_have_no_stiffness(monkeypatch):
    """A thousand linear unknowns had taken a second, as each was cut out of the matrix as a body."""
    monkeypatch.setattr(factorization, "_null_space_of_component", None)
    motions = null_space(sp.diags([0.0, 2.0, 0.0, 1.0, 0.0], format="csr")).motions
    assert motions.tolist() == np.eye(5)[:, [0, 2, 4]].tolist()


@pytest.mark.slow
def test_unknowns_without_stiffness_may_be_retained():
    """PARDISO needs every entry of the diagonal; where rows were empty it had failed with an error of its own."""
    pytest.importorskip("pypardiso")
    n = 60
    K = sp.diags([-np.ones(n - 1), np.full(n, 3.0), -np.ones(n - 1)], [-1, 0, 1])
    bare = [0, 7, 8, 63]
    place = np.setdiff1d(np.arange(n + 4), bare)
    spread = sp.csr_array((np.ones(n), (place, np.arange(n))), shape=(n + 4, n))
    whole = sp.csr_array(spread @ K @ spread.T)
    retained = np.sort([*bare, 5, 40])
    factors = LastBlock(whole, retained)
    interior = np.setdiff1d(np.arange(n + 4), retained)
    dense = whole.toarray()
    across = dense[np.ix_(interior, retained)]
    expected = dense[np.ix_(retained, retained)] - across.T @ np.linalg.solve(dense[np.ix_(interior, interior)], across)
    np.testing.assert_allclose(factors.schur, expected, rtol=0, atol=1e-14)
