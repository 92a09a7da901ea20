"""Quadratic programs from files: qpbenchmark's .mat, qpsolvers' .npz, QPS."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.io import savemat

import contactqp as cq

P, Q = np.diag([2.0, 4.0]), np.array([-2.0, 4.0])
A = np.array([[1.0, 1.0], [1.0, -1.0]])


def matlab(path: Path, **changed: Any) -> Path:
    identity = np.vstack([A, np.eye(2)])
    parts: dict[str, Any] = dict(P=sp.csc_matrix(P), q=Q[:, None], r=7.0, A=sp.csc_matrix(identity))
    parts |= dict(l=np.array([1.0, -1e20, 0.0, -1e20])[:, None], u=np.array([1.0, 3.0, 1e20, 1e20])[:, None])
    savemat(path, {name: value for name, value in (parts | changed).items() if value is not None})
    return path


def test_qpbenchmarks_files_are_read_with_ranges_and_bounds(tmp_path: Path) -> None:
    problem = cq.read_problem(matlab(tmp_path / "P.mat"))
    assert isinstance(problem, cq.ContactProblem)
    assert problem.contact_names == ("range 1 upper", "lower 0")
    assert (problem.ties, problem.tie_value.tolist()) == (1, [1.0])
    assert cq.solve(problem).certificate.proven


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (dict(A=None), "none called A"),
        (dict(A=sp.csc_matrix(np.ones((4, 2)))), "the identity in its last 2 rows"),
        (dict(q=np.array([1.0, np.nan])), "q"),
        (dict(l=np.zeros(3)), "shapes"),
    ],
)
def test_damaged_files_are_refused_in_one_line(tmp_path: Path, changed: dict[str, Any], message: str) -> None:
    with pytest.raises(cq.InvalidProblem, match=message):
        cq.read_problem(matlab(tmp_path / "P.mat", **changed))


def test_what_is_no_matlab_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "P.mat"
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(cq.InvalidProblem, match=r"a \.mat file"):
        cq.read_problem(path)


def test_qpsolvers_archives_are_read_and_nothing_is_unpickled(tmp_path: Path) -> None:
    import qpsolvers

    path = tmp_path / "program.npz"
    qpsolvers.Problem(P, Q, A, np.array([1.0, 3.0]), lb=np.array([0.0, -np.inf])).save(str(path))
    problem = cq.read_problem(path)
    assert isinstance(problem, cq.ContactProblem)
    assert problem.contact_names == ("row 0", "row 1", "lower 0")
    assert problem.ties == 0


QPS = """NAME          T
ROWS
 N  obj
 G  r1
 L  r2
COLUMNS
    c1        r1        2.0   r2        -1.0
    c1        obj       1.5
    c2        r1        1.0   r2         2.0
    c2        obj       -2.0
RHS
    rhs1      r1        2.0   r2         6.0
BOUNDS
 UP bnd1      c1        20.0
QUADOBJ
    c1        c1        8.0
    c1        c2        2.0
    c2        c2       10.0
ENDATA
"""


def test_qps_files_are_read_by_highs(tmp_path: Path) -> None:
    """The example of Maros and Meszaros: the minimum without its constant of 4, at (0.7625, 0.475)."""
    pytest.importorskip("highspy")
    path = tmp_path / "t.qps"
    path.write_text(QPS)
    problem = cq.read_problem(path)
    assert isinstance(problem, cq.ContactProblem)
    assert problem.dof_names == ("c1", "c2")
    assert problem.contact_names == ("range 0 lower", "range 1 upper", "lower 0", "lower 1", "upper 0")
    solution = cq.solve(problem)
    assert solution.displacement == pytest.approx([0.7625, 0.475], rel=1e-12)
    assert solution.energy == pytest.approx(4.371875, rel=1e-12)


def test_what_is_no_qps_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("highspy")
    path = tmp_path / "t.qps"
    path.write_text("nothing of the kind")
    with pytest.raises(cq.InvalidProblem, match="QPS"):
        cq.read_problem(path)
