"""Quadratic programs from files: qpbenchmark's .mat, qpsolvers' .npz, QPS."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import qpsolvers
import scipy.sparse as sp
from scipy.io import savemat

import contactqp as cq
from contactqp.cli import main
from contactqp.exchange.fclib import write_fclib
from contactqp.exchange.problem_files import refuse_malformed
from contactqp.model.quadratic_program import answer_of_program

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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (dict(A=None), "none called A"),
        (dict(A=sp.csc_matrix(np.ones((4, 2)))), "the identity in its last 2 rows"),
        (dict(A=np.ones((1, 1, 4, 2))), r"A: expected a matrix, got an array of shape \(1, 1, 4, 2\)"),
        (dict(P=np.ones((1, 2, 2))), r"P: expected a matrix, got an array of shape \(1, 2, 2\)"),
        (dict(q=np.array([1.0, np.nan])), "q"),
        (dict(l=np.zeros(3)), "shapes"),
    ],
)
def test_damaged_files_are_refused_in_one_line(tmp_path: Path, changed: dict[str, Any], message: str) -> None:
    with pytest.raises(cq.InvalidProblem, match=message):
        cq.read_problem(matlab(tmp_path / "P.mat", **changed))


@pytest.mark.slow
def test_what_is_no_matlab_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "P.mat"
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(cq.InvalidProblem, match=r"a \.mat file"):
        cq.read_problem(path)


def test_qpsolvers_archives_are_read_and_nothing_is_unpickled(tmp_path: Path) -> None:
    path = tmp_path / "program.npz"
    qpsolvers.Problem(P, Q, A, np.array([1.0, 3.0]), lb=np.array([0.0, -np.inf])).save(str(path))
    problem = cq.read_problem(path)
    assert isinstance(problem, cq.ContactProblem)
    assert problem.contact_names == ("row 0", "row 1", "lower 0")
    assert problem.ties == 0


def test_sparse_matrices_that_qpsolvers_pickled_are_refused_in_words(tmp_path: Path) -> None:
    path = tmp_path / "program.npz"
    qpsolvers.Problem(P, Q, sp.csc_matrix(A), np.array([1.0, 3.0])).save(str(path))
    with pytest.raises(cq.InvalidProblem, match=r"G: expected arrays, got pickled .* save them by \.toarray\(\)"):
        cq.read_problem(path)


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


@pytest.mark.slow
def test_qps_files_are_read_by_highs(tmp_path: Path) -> None:
    """The example of Maros and Meszaros: the minimum without its constant of 4, at (0.7625, 0.475)."""
    pytest.importorskip("highspy")
    path = tmp_path / "t.qps"
    path.write_text(QPS)
    problem = cq.read_problem(path)
    assert isinstance(problem, cq.ContactProblem)
    assert problem.dof_names == ("c1", "c2")
    assert problem.contact_names == ("range r1 lower", "range r2 upper", "lower c1", "lower c2", "upper c1")
    solution = cq.solve(problem)
    assert solution.displacement == pytest.approx([0.7625, 0.475], rel=1e-12)
    assert solution.energy == pytest.approx(4.371875, rel=1e-12)


@pytest.mark.slow
def test_rows_and_columns_keep_the_names_of_their_file(tmp_path: Path) -> None:
    pytest.importorskip("highspy")
    path = tmp_path / "t.qps"
    tied = QPS.replace(" L  r2", " L  r2\n E  sum").replace("RHS\n", "    c2        sum       1.0\nRHS\n")
    path.write_text(tied.replace("RHS\n", "RHS\n    rhs1      sum       0.5\n").replace("UP bnd1", "FX bnd1"))
    problem = cq.read_problem(path)
    assert isinstance(problem, cq.ContactProblem)
    assert problem.tie_names == ("range sum", "fixed c1")
    assert problem.contact_names == ("range r1 lower", "range r2 upper", "lower c2")
    solution = cq.solve(problem)
    assert solution.certificate.proven
    for name in ("range r2 upper", "fixed c1"):
        assert name in str(solution)
    moved = solution.displacement + np.array([0.0, 1.0])
    wrong = cq.certify(problem, moved, solution.normal_force, tie_force=solution.tie_force)
    assert "range sum is not met" in str(wrong)
    back = problem.to_qp()
    assert (back.lb[1], back.G.shape[0], back.A.shape[0]) == (0.0, 2, 2)
    answer = answer_of_program(problem, solution.displacement, solution.tie_force, solution.normal_force[:2])
    assert cq.certify(problem, **answer).proven


def test_names_of_unknowns_and_ranges_stand_for_their_numbers() -> None:
    parts = dict(lb=[0.0, 0.0], ub=[np.inf, 0.0], C=A, l=[1.0, -1.0], u=[1.0, np.inf])
    named = cq.ContactProblem.from_qp(P, Q, **parts, dof_names=["a", "b"], range_names=["sum", "difference"])
    assert named.contact_names == ("range difference lower", "lower a")
    assert named.tie_names == ("range sum", "fixed b")
    assert cq.ContactProblem.from_qp(P, Q, **parts).tie_names == ("range 0", "fixed 1")
    assert named.with_ties(np.array([1])).tie_name(0) == "fixed b"
    with pytest.raises(cq.InvalidProblem, match="range_names: expected 2 names, got 1"):
        cq.ContactProblem.from_qp(P, Q, **parts, range_names=["sum"])


@pytest.mark.slow
def test_what_is_no_qps_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("highspy")
    path = tmp_path / "t.qps"
    path.write_text("nothing of the kind")
    with pytest.raises(cq.InvalidProblem, match="QPS"):
        cq.read_problem(path)


NUMBERS = """NAME T
* a comment, and names with spaces
ROWS
 N  COST
 G  ROW 1
COLUMNS
    X 0  COST  1.0  ROW 1  {}
RHS
    RHS  ROW 1  2.0
RANGES
    RNG  ROW 1  .5E+1
BOUNDS
 FR BND  X 0
 UP BND  X 0  {}
QUADOBJ
    X 0  X 0  1
ENDATA
"""


@pytest.mark.parametrize("no_number", ["abc", "1,5", "2.0D3", "0x2", "2_0", "np.float64(1.0)"])
def test_numbers_that_are_none_are_refused(no_number: str, tmp_path: Path) -> None:
    """HiGHS reads "abc" as 0, "1,5" as 1 and "2.0D3" as 2: a program of these was proven, with an energy of zero."""
    path = tmp_path / "t.qps"
    path.write_text(NUMBERS.format("-1e0", "Inf"))
    refuse_malformed(path)
    for numbers, line in ((("1.0", no_number), 14), ((no_number, "1.0"), 7)):
        path.write_text(NUMBERS.format(*numbers))
        with pytest.raises(cq.InvalidProblem, match=rf"line {line}: expected a number, got '{re.escape(no_number)}'"):
            refuse_malformed(path)


BOUNDS, QUADRATIC, END = "BOUNDS\n", "QUADOBJ\n", "ENDATA\n"
MALFORMED = {
    "row twice": (" L  r2", " L  r2\n E  r1", "line 6: expected a new row, got 'r1'"),
    "coefficient twice": ("RHS\n", "    c2  r1  3\nRHS\n", "line 11: expected the entry of 'c2' in 'r1' once"),
    "columns apart": ("RHS\n", "    c1  obj  3\nRHS\n", "line 11: expected entries of a column side by side, got 'c1'"),
    "three pairs": ("r2         2.0", "r2  2.0  r1  3", "line 9: expected one or two pairs of a name and a number"),
    "side of no row": ("r2         6.0", "r9  6", "line 12: expected a row of ROWS, got 'r9'"),
    "side twice": (BOUNDS, "    rhs1  r1  7\nBOUNDS\n", "line 13: expected 'r1' in RHS once"),
    "sides of two sets": (BOUNDS, "    rhs2  obj  7\nBOUNDS\n", "line 13: expected one set of RHS, 'rhs1', got 'rhs2'"),
    "range of no row": (BOUNDS, "RANGES\n    rng  r9  7\nBOUNDS\n", "line 14: expected a row of ROWS, got 'r9'"),
    "sides after ranges": ("RHS\n", "RANGES\n    rng  r1  7\nRHS\n", "line 13: expected RHS before RANGES"),
    "bound of no column": (QUADRATIC, " UP bnd1  c7  5\nQUADOBJ\n", "line 15: expected a column of COLUMNS.* got 'c7'"),
    "bound twice": (QUADRATIC, " FR bnd1  c1\nQUADOBJ\n", "line 15: expected the upper bound of 'c1' once"),
    "bounds of two sets": (
        QUADRATIC,
        " UP b  c2 5\nQUADOBJ\n",
        "line 15: expected one set of BOUNDS, 'bnd1', got 'b'",
    ),
    "set named as a column": (
        "UP bnd1",
        "UP c2",
        "line 14: expected a set of bounds not called as a column, got 'c2'",
    ),
    "term of no column": (END, "    c1  c7  1\nENDATA\n", "line 19: expected a column of COLUMNS.* got 'c7'"),
    "term twice": (END, "    c2  c1  1\nENDATA\n", "line 19: expected the term of 'c2' and 'c1' once"),
    "terms of two sections": (END, "QMATRIX\nENDATA\n", "line 19: expected one section of quadratic terms"),
    "terms of no objective": ("QUADOBJ", "QSECTION r9", "line 15: expected quadratic terms of the objective 'obj'"),
    "another sense": ("ROWS\n", "OBJSENSE MAXIMIZE\nROWS\n", "line 2: expected MAX after OBJSENSE, got 'MAXIMIZE'"),
}


@pytest.mark.parametrize("given", MALFORMED.values(), ids=MALFORMED.keys())
def test_entries_that_highs_leaves_out_or_adds_are_refused(given: tuple[str, str, str], tmp_path: Path) -> None:
    """HiGHS reads each of these without an error, as another program than the one that is written."""
    before, after, message = given
    path = tmp_path / "t.qps"
    path.write_text(QPS)
    refuse_malformed(path)
    path.write_text(QPS.replace(before, after, 1))
    with pytest.raises(cq.InvalidProblem, match=rf"t\.qps: {message}"):
        refuse_malformed(path)


FIXED = """NAME          T
ROWS
 N  obj
 G  r 1
COLUMNS
    c 1       obj                1.5   r 1                2.0
RHS
    rhs       r 1                2.0
BOUNDS
 UP bnd       c 1               20.0
QUADOBJ
    c 1       c 1                8.0
ENDATA
"""


@pytest.mark.parametrize("section", ["RHS", "BOUNDS", "QUADOBJ", "ENDATA"])
def test_names_with_spaces_are_told_apart_in_fixed_fields_only(section: str, tmp_path: Path) -> None:
    path = tmp_path / "t.qps"
    head, _, tail = FIXED.partition(f"\n{section}\n")
    last = head.splitlines()[-1]
    twice = f"{head}\n{last}\n{section}\n{tail}"
    path.write_text(twice)
    with pytest.raises(cq.InvalidProblem, match=rf"line {len(head.splitlines()) + 1}: expected .* once"):
        refuse_malformed(path)
    for certain_or_not in (FIXED, twice.replace("    c 1       obj  ", "  c 1       obj    ")):
        path.write_text(certain_or_not)
        refuse_malformed(path)


def test_unknowns_with_quadratic_terms_alone_need_no_column(tmp_path: Path) -> None:
    """HiGHS's own writer leaves empty columns out; sets of sides and of bounds may go without a name, as in SIF."""
    path = tmp_path / "t.qps"
    alone = QPS.replace("UP bnd1", "UP").replace(QUADRATIC, " FR bnd1      c7\nQUADOBJ\n    c7        c7        1.0\n")
    path.write_text(alone.replace("    rhs1 ", "    "))
    refuse_malformed(path)
    path.write_text(alone.replace("    c7        c7        1.0\n", ""))
    with pytest.raises(cq.InvalidProblem, match="c7"):
        refuse_malformed(path)


@pytest.mark.slow
def test_programs_that_are_not_convex_name_file_and_unknown(tmp_path: Path) -> None:
    pytest.importorskip("highspy")
    path = tmp_path / "t.qps"
    for before, after, message in (
        ("20.0", "-20.0", "bounds of c1: expected a lower one at most the upper one, got 0 above -20"),
        ("c2       10.0", "c2       -10.0", r"P: expected positive semidefinite, got P\[c2, c2\] = -10"),
        ("c2       10.0", "c2       0.25", r"P: indefinite, \|P\[c1, c2\]\| = 2 exceeds"),
    ):
        path.write_text(QPS.replace(before, after))
        with pytest.raises(cq.InvalidProblem, match=rf"t\.qps: {message}"):
            cq.read_problem(path)


def command(*arguments: str) -> int:
    """The exit code of a command."""
    with pytest.raises(SystemExit) as ended:
        main(list(arguments))
    return int(ended.value.code or 0)


def other_peoples_answer(folder: Path) -> tuple[Path, dict[str, Any]]:
    """A program of every part, one unknown fixed by its bounds, and Clarabel's answer by qpsolvers."""
    P, A, G = np.diag([2.0, 1.0, 4.0, 1.0]), np.array([[1.0, 0.0, 1.0, 1.0]]), np.eye(2, 4, 0) + np.eye(2, 4, 1)
    parts = dict(q=np.array([-2.0, -6.0, 1.0, 0.5]), h=np.array([2.0, 4.0]), b=np.array([1.0]))
    parts |= dict(lb=np.array([0.0, -np.inf, 0.0, 0.25]), ub=np.array([np.inf, 1.5, np.inf, 0.25]))
    qpsolvers.Problem(P=P, G=G, A=A, **parts).save(str(folder / "program.npz"))
    sparse = qpsolvers.Problem(P=sp.csc_matrix(P), G=sp.csc_matrix(G), A=sp.csc_matrix(A), **parts)
    found = qpsolvers.solve_problem(sparse, "clarabel", tol_gap_abs=1e-13, tol_gap_rel=1e-13, tol_feas=1e-13)
    return folder / "program.npz", {name: np.asarray(getattr(found, name)) for name in ("x", "y", "z", "z_box")}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("form", ["json", "npz"])
def test_answers_in_the_names_and_signs_of_qpsolvers_are_checked(form: str, tmp_path: Path) -> None:
    program, answer = other_peoples_answer(tmp_path)
    file = tmp_path / f"answer.{form}"

    def check(**changed: Any) -> int:
        given = answer | changed
        if form == "npz":
            np.savez(file, **given)
        else:
            file.write_text(json.dumps({name: np.asarray(values).tolist() for name, values in given.items()}))
        return command("check", str(program), str(file), "--tolerance", "1e-7")

    assert np.count_nonzero(abs(answer["z_box"]) > 1e-3) >= 2
    assert check() == 0
    assert check(z=-answer["z"]) == 1
    assert check(z_box=-answer["z_box"]) == 1
    assert check(y=answer["y"] + 1e-3) == 1
    assert check(z=answer["z"][:1]) == 2


def test_forces_of_bounds_that_a_program_does_not_have_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A sign turned round in z_box belongs to no bound; that all contact forces are zero was all that was said."""
    np.savez(tmp_path / "program.npz", P=np.eye(2), q=[-2.0, 1.0], lb=[-np.inf, 0.0], ub=[0.5, np.inf])
    for z_box, told in (([1.5, -1.0], False), ([-1.5, 1.0], True)):
        (tmp_path / "answer.json").write_text(json.dumps(dict(x=[0.5, 0.0], z_box=z_box)))
        assert command("check", str(tmp_path / "program.npz"), str(tmp_path / "answer.json")) == told
        said = "ignored: z_box: what stands where there is no such bound, at most -1.5 at unknown 0"
        assert (said in " ".join(capsys.readouterr().out.split())) == told


def test_backends_answers_become_those_of_the_contact_problem() -> None:
    problem = cq.ContactProblem.from_qp(
        np.eye(3), [-3.0, 2.0, -1.0], lb=np.array([-1.0, -1.0, 0.5]), ub=np.array([1.0, np.inf, 0.5])
    )
    parts = answer_of_program(problem, np.array([1.0, -1.0, 0.5]), z_box=np.array([2.0, -1.0, 0.5]))
    assert cq.certify(problem, **parts).proven
    assert parts["tie_force"] == pytest.approx([0.5])


def test_run_says_the_energy_and_how_well_it_is_known(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(matlab(tmp_path / "P.mat"))
    assert command("run", path, "--json") == 0
    (found,) = json.loads(capsys.readouterr().out)
    expected = cq.solve(cq.read_problem(path))
    assert (found["unknowns"], found["proven"], found["determined"]) == (2, True, "displacement")
    assert found["energy"] == expected.energy
    assert found["energy_error"] <= 1e-12
    assert command("run", path) == 0
    table = capsys.readouterr().out
    assert f"{expected.energy:.12g}" in table
    assert "P.mat" in table


@pytest.mark.slow
def test_explain_says_what_a_program_is_made_of(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command("explain", str(matlab(tmp_path / "P.mat")), "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["contacts"] == [
        "range 1 upper: +1 unknown 0 -1 unknown 1 <= 3",
        "lower 0: -1 unknown 0 <= 0",
    ]
    assert found["ties"] == ["range 0: +1 unknown 0 +1 unknown 1 = 1"]
    blocks = {block["name"]: block for block in found["blocks"]}
    assert blocks["bounds of single unknowns among them"]["reason"] == "1 bound"
    assert blocks["condensation"]["included"]
    assert found["footprint"] is None


def test_explain_takes_problems_in_local_form(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("h5py")
    path = tmp_path / "local.hdf5"
    write_fclib(path, cq.LocalProblem(delassus=np.eye(3), offset=[-1.0, 0.5, 0.0], friction=[0.3], dimension=3))
    assert command("explain", str(path)) == 0
    said = capsys.readouterr().out
    assert "local form" in said
    assert "1 contact with friction" in said


WRONG: dict[str, tuple[dict[str, object], str]] = {
    "P with nan": ({"P": [[1.0, 0.0], [0.0, np.nan]]}, r"P: expected finite numbers, got nan at \[1, 1\]"),
    "P sparse with inf": ({"P": sp.diags([np.inf, 1.0])}, r"P: expected finite numbers, got inf at \[0, 0\]"),
    "P not square": ({"P": np.ones((2, 3))}, r"P: expected a square matrix, got shape \(2, 3\)"),
    "P a vector": ({"P": [1.0, 1.0]}, r"P: expected a square matrix, got shape \(2,\)"),
    "q too long": ({"q": np.ones(3)}, "q: expected 2 entries, one for each row of P, got 3"),
    "h that nothing satisfies": ({"h": [1.0, -np.inf]}, r"h: expected a number or inf, got -inf at \[1\]"),
    "b infinite": ({"b": [np.inf]}, r"b: expected finite numbers, got inf at \[0\]"),
    "P not convex": ({"P": [[1.0, 2.0], [2.0, 1.0]]}, r"P: indefinite, \|P\[0, 1\]\| = 2 exceeds"),
    "lb infinite": ({"lb": [0.0, np.inf]}, "lb: expected a number or -inf, got inf at 1"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_wrong_is_named_as_it_was_given(what: str) -> None:
    """Not as the stiffness, gap or tie value that it becomes."""
    program = dict(P=np.eye(2), q=np.ones(2), G=np.eye(2), h=np.ones(2), A=np.ones((1, 2)), b=np.ones(1))
    given, message = WRONG[what]
    with pytest.raises(cq.InvalidProblem, match=f"^{message}"):
        cq.ContactProblem.from_qp(**{**program, **given})


@pytest.mark.parametrize(
    ("parts", "said"),
    [
        (dict(P=[[1.0, 2.0], [0.0, 1.0]], q=[1.0, 1.0]), "P: indefinite"),
        (dict(P=np.eye(2), q=[1.0, 1.0, 1.0]), "q: expected 2 entries"),
        (dict(P=np.eye(2), q=[1.0, np.nan]), "q: expected finite numbers"),
        (dict(P=np.eye(2), q=[1.0, 1.0], G=[[1.0, 0.0]]), "h: expected beside G"),
        (dict(P=np.eye(2), q=[1.0, 1.0], lb=[1.0, 1.0], ub=[0.0, 2.0]), "lb: expected at most ub"),
    ],
)
def test_a_program_that_is_none_is_refused_with_its_file(tmp_path: Path, parts: dict, said: str) -> None:
    """Of many files that are read one after the other, the message names the one that is wrong."""
    path = tmp_path / "program.npz"
    np.savez(path, **parts)
    with pytest.raises(cq.InvalidProblem, match=f"^{re.escape(str(path))}: {said}"):
        cq.read_problem(path)


def test_a_program_of_qpbenchmark_that_is_none_is_refused_with_its_file(tmp_path: Path) -> None:
    path = tmp_path / "program.mat"
    sides = dict(l=np.ones(2), u=-np.ones(2), r=0.0)
    savemat(path, dict(P=np.eye(2), q=np.ones(2), A=np.eye(2), **sides))
    with pytest.raises(cq.InvalidProblem, match=f"^{re.escape(str(path))}: lb: expected at most ub"):
        cq.read_problem(path)


def tridiagonal(n: int, diagonal: float) -> sp.csr_matrix:
    ones = np.full(n - 1, -1.0)
    return sp.diags([ones, np.full(n, diagonal), ones], [-1, 0, 1], format="csr")


def test_what_is_found_while_solving_is_said_by_the_names_of_a_program() -> None:
    """The user of P, q, G and h knows of no stiffness and no load; one who gave a stiffness reads of it as before."""
    curved = tridiagonal(2000, 2.0 - 1e-5)  # its least eigenvalue is 4 sin^2(pi / 4002) - 1e-5 < 0
    given = cq.ContactProblem.from_qp(curved, np.ones(2000), np.eye(1, 2000), [1.0])
    for attempt in (lambda: cq.solve(given), lambda: cq.certify(given, np.zeros(2000), np.zeros(1))):
        with pytest.raises(cq.InvalidProblem, match=r"^P: expected positive semidefinite"):
            attempt()
    with pytest.raises(cq.InvalidProblem, match=r"^P: expected positive semidefinite"):
        cq.solve(given.replace(load=np.zeros(2000)))
    with pytest.raises(cq.InvalidProblem, match=r"^stiffness: expected positive semidefinite"):
        cq.solve(cq.ContactProblem(curved, np.ones(2000), np.eye(1, 2000), [1.0]))
    falling = cq.ContactProblem.from_qp([[1.0, -1.0], [-1.0, 1.0]], [1.0, 1.0], [[1.0, 0.0]], [1.0])
    with pytest.raises(cq.NoEquilibrium, match=r"^q falls along what no row or bound limits: .*check the sign of q$"):
        cq.solve(falling)
    sliding = falling.replace(load=[1.0, 1.0])
    with pytest.raises(cq.Unsupported, match=r"\(P is singular\)"):
        cq.solve(sliding, method="projected-gauss-seidel")
