"""Bad data are refused at the door, with a line that says what came and what was expected."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from tests.examples import truss

GOOD = dict(stiffness=np.array([[2.0, -1.0], [-1.0, 2.0]]), load=[1.0, 0.0], normal=[[1.0, 0.0]], gap=[0.1])

BAD = {
    "stiffness not square": (dict(stiffness=np.ones((2, 3))), "square"),
    "stiffness empty": (dict(stiffness=np.zeros((0, 0))), "square"),
    "stiffness a vector": (dict(stiffness=np.ones(2)), "matrix"),
    "stiffness with NaN": (dict(stiffness=[[np.nan, 0.0], [0.0, 1.0]]), r"finite numbers, got nan at \[0, 0\]"),
    "stiffness complex": (dict(stiffness=np.eye(2) * 1j), "real"),
    "stiffness text": (dict(stiffness="K"), "real numbers"),
    "stiffness asymmetric": (dict(stiffness=[[2.0, -1.0], [-0.9, 2.0]]), "symmetric"),
    "stiffness negative diagonal": (dict(stiffness=[[1.0, 0.0], [0.0, -1.0]]), "semidefinite"),
    "stiffness indefinite in a pair": (dict(stiffness=[[1.0, 2.0], [2.0, 1.0]]), "indefinite"),
    "stiffness off-diagonal beside a zero diagonal": (dict(stiffness=[[0.0, 1.0], [1.0, 1.0]]), "indefinite"),
    "load too long": (dict(load=[1.0, 2.0, 3.0]), r"\(2,\), got \(3,\)"),
    "load infinite": (dict(load=[np.inf, 0.0]), "finite"),
    "normal with wrong columns": (dict(normal=[[1.0, 0.0, 0.0]]), "2 columns"),
    "gap missing": (dict(gap=[]), r"\(1,\)"),
    "gap NaN": (dict(gap=[np.nan]), "finite"),
    "friction without tangent": (dict(friction=0.3), "tangent"),
    "friction negative": (dict(friction=-0.1, tangent=[[0.0, 1.0]]), ">= 0"),
    "friction of wrong length": (dict(friction=[0.1, 0.2], tangent=[[0.0, 1.0]]), r"\(1,\)"),
    "tangent with three rows": (dict(friction=0.1, tangent=np.ones((3, 2))), "rows"),
    "slip origin of wrong shape": (dict(friction=0.1, tangent=[[0.0, 1.0]], slip_origin=[0.0, 1.0]), "slip_origin"),
    "tie value without tie": (dict(tie_value=[1.0]), "tie_value"),
    "tie value of wrong length": (dict(tie=[[1.0, -1.0]], tie_value=[1.0, 2.0]), "tie_value"),
    "too few names": (dict(dof_names=["x"]), "2 names"),
    "a name twice": (dict(dof_names=["x", "x"]), "'x' more than once"),
    "unknown unit key": (dict(units={"mass": "kg"}), "length"),
}


@pytest.mark.parametrize("kind", BAD)
def test_bad_data_are_refused(kind: str) -> None:
    change, words = BAD[kind]
    with pytest.raises(cq.InvalidProblem, match=words) as caught:
        cq.ContactProblem(**(GOOD | change))
    assert "\n" not in str(caught.value)


def test_an_indefinite_matrix_whose_pairs_look_right_is_refused() -> None:
    """Every 2x2 minor of this matrix is positive, its determinant is not."""
    K = np.full((3, 3), -0.9) + 1.9 * np.eye(3)
    with pytest.raises(cq.InvalidProblem, match="indefinite"):
        cq.ContactProblem(stiffness=K, load=np.zeros(3), normal=np.eye(1, 3), gap=[0.0])


@pytest.mark.parametrize("kind", [np.asarray, sp.csr_matrix])
@pytest.mark.parametrize("held", [True, False])
def test_definiteness_is_told_without_eigenvalues(kind: type, held: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    # Eigenvalues of 200 unknowns took as long as the solution and its certificate together.
    K = 2.0 * np.eye(5) - np.eye(5, k=1) - np.eye(5, k=-1)
    K[0, 0] = K[4, 4] = 2.0 if held else 1.0
    monkeypatch.setattr(np.linalg, "eigvalsh", lambda _: pytest.fail("eigenvalues were computed"))
    assert cq.ContactProblem(stiffness=kind(K), load=np.zeros(5), normal=np.eye(1, 5), gap=[1.0]).asymmetry == 0


def test_a_large_indefinite_matrix_is_refused_by_its_factorisation() -> None:
    n = 400
    K = sp.diags([np.full(n, 2.0), -np.ones(n - 1), -np.ones(n - 1)], [0, 1, -1]).tolil()
    K[n // 2, n // 2] = 0.5  # three neighbours of -1 against it
    problem = cq.ContactProblem(stiffness=K.tocsc(), load=np.ones(n), normal=np.eye(1, n), gap=[0.0])
    with pytest.raises(cq.InvalidProblem, match="semidefinite"):
        cq.solve(problem)


def test_a_global_problem_beside_diagonals_of_the_least_number_leaves_no_warning() -> None:
    """Its asymmetry is beyond doubles; it may be as unsymmetric as it likes."""
    least = float(np.nextafter(0.0, 1.0))
    given = {"directions": np.eye(2), "load": [0.0, 1.0], "offset": [0.0, 0.0], "friction": [0.3], "dimension": 2}
    problem = cq.GlobalProblem([[least, 0.0], [1.0, least]], **given)
    assert problem.asymmetry == np.inf
    assert problem.matrix.toarray().tolist() == [[least, 0.0], [1.0, least]]


def test_print_precision_asymmetry_is_symmetrised_and_reported() -> None:
    K = np.array([[2.0, -1.0], [-1.0 + 1e-8, 2.0]])
    problem = cq.ContactProblem(**(GOOD | dict(stiffness=K)))
    assert problem.asymmetry == pytest.approx(5e-9)
    assert np.array_equal(problem.stiffness, np.asarray(problem.stiffness).T)
    assert any("asymmetric" in note for note in cq.solve(problem).certificate.notes)


def test_a_problem_cannot_be_changed_and_copies_its_data() -> None:
    load = np.array([1.0, 0.0])
    problem = cq.ContactProblem(**(GOOD | dict(load=load)))
    load[0] = 7.0
    assert problem.load[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        problem.load[0] = 2.0
    with pytest.raises(AttributeError):
        problem.gap = 0  # type: ignore[misc]


def test_replace_takes_other_contacts_with_friction() -> None:
    one = problem_of_one_unknown()
    two = one.replace(normal=[[1.0], [-1.0]], gap=[0.0, 1.0], tangent=[[0.5], [0.5]], friction=[0.3, 0.2])
    assert two.slip_origin.tolist() == [[0.0], [0.0]]
    with pytest.raises(cq.InvalidProblem, match="slip_origin: expected shape"):
        one.replace(slip_origin=[[0.1]]).replace(
            normal=[[1.0], [-1.0]], gap=[0.0, 1.0], tangent=[[0.5], [0.5]], friction=[0.3, 0.2]
        )


def problem_of_one_unknown() -> cq.ContactProblem:
    return cq.ContactProblem([[1.0]], [5.0], [[1.0]], [0.0], tangent=[[0.5]], friction=[0.3])


def test_replace_shares_the_factorisation_and_checks_what_is_new() -> None:
    problem = truss()
    first, second = cq.solve(problem), cq.solve(problem.replace(load=[30.0, -50.0], gap=[2e-3]))
    assert first.work.factorisations == 1
    assert second.work.factorisations == 0
    with pytest.raises(cq.InvalidProblem, match="load"):
        problem.replace(load=[1.0])
    with pytest.raises(cq.InvalidProblem, match="unknown"):
        problem.replace(loads=[1.0, 2.0])
    assert cq.solve(problem.replace(stiffness=2 * np.asarray(problem.stiffness))).work.factorisations == 1


def test_sparse_and_dense_data_give_one_answer() -> None:
    dense = truss()
    sparse = truss(stiffness=sp.coo_matrix(np.asarray(dense.stiffness)), normal=sp.csc_array([[0.0, -1.0]]))
    assert np.array_equal(cq.solve(dense).displacement, cq.solve(sparse).displacement)


@pytest.mark.parametrize(("stiffness", "row"), [(1e120, 1e-120), (1e-120, 1e120)])
def test_rows_may_be_as_small_or_as_large_as_doubles_are(stiffness: float, row: float) -> None:
    K, soft = np.diag([1.0, stiffness]), stiffness**-0.5  # both bodies have as much energy
    problem = cq.ContactProblem(K, [2.0, 3.0 / soft], np.diag([1.0, row]), [1.0, row * soft])
    solution = cq.solve(problem)
    assert solution.displacement == pytest.approx([1.0, soft])
    assert solution.normal_force == pytest.approx([1.0, 2.0 / soft / row])
    assert solution.certificate.proven


@pytest.mark.slow
def test_a_row_may_act_on_what_is_not_elastic() -> None:
    problem = cq.ContactProblem(np.diag([0.0, 1e200]), [-1.0, 0.0], [[-1.0, 1e-150]], [1.0])
    assert problem.normal.toarray().tolist() == [[-1.0, 1e-150]]
    with pytest.raises(cq.InvalidProblem, match="contact 0 closes only after 1,"):  # of which its tiny entry is no part
        cq.solve(problem)


@pytest.mark.parametrize("elements", [8, 300])
@pytest.mark.parametrize("part", [0.99, 1.01, 2.0])
def test_a_column_beyond_eulers_load_is_sent_to_large_deformation(elements: int, part: float) -> None:
    """A simply supported column by finite differences buckles into a sine under (2 - 2 cos(pi / n)) n^2 EI."""
    n = elements
    bent = n * n * (2 * np.eye(n - 1) - np.eye(n - 1, k=1) - np.eye(n - 1, k=-1))
    euler = n * n * (2 - 2 * np.cos(np.pi / n))
    data = dict(stiffness=bent @ bent - part * euler * bent, load=np.ones(n - 1), normal=np.eye(1, n - 1), gap=[1.0])
    if part < 1:
        assert cq.solve(cq.ContactProblem(**data)).certificate.passed
        return
    with pytest.raises(cq.InvalidProblem, match=r"buckling load .* contactqp\.large_deformation"):
        cq.solve(cq.ContactProblem(**data))
