"""Problems as folders of matrices: every digit comes back, what is missing is refused, what is taken is said."""

from __future__ import annotations

import json
from fractions import Fraction

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp

import contactqp as cq
from contactqp.exchange.problem_folder import is_problem_folder, read_problem_folder, write_problem

K = np.array([[3.0, -1.0, 0.0], [-1.0, 2.0 + 1 / 3, -1.0], [0.0, -1.0, 1.0 + 1e-13]])
PARTS = dict(
    stiffness=sp.csr_array(K),
    load=[0.1, -1 / 3, 2.0],
    normal=[[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    gap=[1e-3, 0.0],
    dof_names=["a.x", "b.x", "c.x"],
    contact_names=["left", "right"],
    units={"length": "m", "force": "kN"},
)
RUBBING = dict(tangent=[[1.0, 0.0, 0.0], [0.5, -0.5, 0.0]], friction=[0.25, 0.3], slip_origin=[[0.0], [1e-4]])
TIED = dict(tie=[[1.0, -1.0, 0.0]], tie_value=[1e-5], tie_names=["rigid link"])


def same(a: cq.ContactProblem, b: cq.ContactProblem) -> bool:
    """Whether two problems are the same to the last bit."""
    for name in ("stiffness", "load", "normal", "gap", "tangent", "friction", "slip_origin", "tie", "tie_value"):
        one, other = getattr(a, name), getattr(b, name)
        if (one is None) != (other is None):
            return False
        if one is not None:
            one, other = (x.toarray() if sp.issparse(x) else x for x in (one, other))
            if one.shape != other.shape or not np.array_equal(one, other):
                return False
    return all(getattr(a, name) == getattr(b, name) for name in ("dof_names", "contact_names", "tie_names", "units"))


@pytest.mark.parametrize("more", [{}, RUBBING, TIED, RUBBING | TIED], ids=["plain", "friction", "ties", "both"])
def test_what_is_written_comes_back_to_the_last_bit(tmp_path, more):
    problem = cq.ContactProblem(**PARTS, **more)
    read, ledger = read_problem_folder(write_problem(tmp_path / "p", problem, about={"description": "three"}))
    assert same(read, problem)
    assert not same(read, problem.replace(load=np.nextafter(problem.load, 1)))
    assert any("stiffness.mtx: Matrix Market, coordinate: 3 by 3" in line for line in ledger.read)
    assert json.loads((tmp_path / "p/problem.json").read_text())["description"] == "three"


def test_no_contacts_is_a_problem_too(tmp_path):
    problem = cq.ContactProblem(stiffness=K, load=np.ones(3), normal=np.zeros((0, 3)), gap=[])
    assert same(read_problem_folder(write_problem(tmp_path, problem))[0].replace(), problem)


def test_exact_answers_are_written_as_fractions_and_numbers(tmp_path):
    problem = cq.ContactProblem(**PARTS)
    third = Fraction(1, 3)
    write_problem(tmp_path, problem, {"displacement": [third, third, 0 * third], "normal_force": [third, 2 * third]})
    data = json.loads((tmp_path / "answer.json").read_text())
    assert data["displacement"] == [1 / 3, 1 / 3, 0.0]
    assert data["exact"] == {"displacement": ["1/3", "1/3", "0"], "normal_force": ["1/3", "2/3"]}
    write_problem(tmp_path, problem, cq.solve(problem))
    assert json.loads((tmp_path / "answer.json").read_text())["contact_status"] == ["open", "closed"]
    with pytest.raises(cq.InvalidProblem, match=r"answer: expected displacement, .*got forces"):
        write_problem(tmp_path, problem, {"forces": [1.0]})
    with pytest.raises(cq.InvalidProblem, match=r"about: .*got units"):
        write_problem(tmp_path, problem, about={"units": "kN"})


def by_symbols(folder):
    scipy.io.mmwrite(folder / "K.mtx", sp.coo_matrix(K), precision=17)
    np.savetxt(folder / "f.txt", PARTS["load"], fmt="%.17g")
    np.savetxt(folder / "E_N.csv", PARTS["normal"], delimiter=",", fmt="%.17g")
    np.save(folder / "g.npy", PARTS["gap"])
    (folder / "dof_names.txt").write_text("a.x\nb.x\nc.x\n")
    (folder / "contact_names.txt").write_text("left\nright\n")


def test_files_are_told_by_their_names_in_any_format(tmp_path):
    by_symbols(tmp_path)
    (tmp_path / "notes.md").write_text("nothing")
    read, ledger = read_problem_folder(tmp_path)
    assert same(read, cq.ContactProblem(**PARTS | {"units": None}))
    assert ledger.ignored == ["notes.md"]
    assert ledger.assumed == ["no ties: supports are eliminated from the stiffness, or there are none"]


@pytest.mark.parametrize("name", ["K.mtx", "f.txt", "E_N.csv", "g.npy"])
def test_what_is_missing_is_refused_and_not_assumed(tmp_path, name):
    by_symbols(tmp_path)
    (tmp_path / name).unlink()
    with pytest.raises(cq.InvalidProblem, match=r"(stiffness|load|normal|gap): expected"):
        read_problem_folder(tmp_path)
    assert is_problem_folder(tmp_path) == (name != "K.mtx")


def test_a_part_that_is_there_twice_is_refused(tmp_path):
    by_symbols(tmp_path)
    (tmp_path / "load.txt").write_text("1\n2\n3\n")
    with pytest.raises(cq.InvalidProblem, match=r"load: expected one file of it, got f\.txt and load\.txt"):
        read_problem_folder(tmp_path)


CONTACTS = """# the left one touches two nodes
contact,dof,coefficient,gap,tangent,friction,slip_origin
left,b.x,1,0.001,0.5,0.25,0
right,c.x,1,0,1,0.3,1e-4
left,a.x,-0.5,,1,,
"""


def test_contacts_by_the_names_of_unknowns(tmp_path):
    by_symbols(tmp_path)
    for name in ("E_N.csv", "g.npy", "f.txt", "contact_names.txt"):
        (tmp_path / name).unlink()
    (tmp_path / "contacts.csv").write_text(CONTACTS)
    (tmp_path / "ties.csv").write_text("tie;dof;coefficient;value\none;a.x;1;0.002\n")
    (tmp_path / "load.csv").write_text("dof,load\nc.x,2.5\n")
    read, ledger = read_problem_folder(tmp_path)
    expected = cq.ContactProblem(
        stiffness=sp.csr_array(K),
        load=[0, 0, 2.5],
        normal=[[-0.5, 1, 0], [0, 0, 1]],
        gap=[0.001, 0],
        tangent=[[1, 0.5, 0], [0, 0, 1]],
        friction=[0.25, 0.3],
        slip_origin=[0, 1e-4],
        tie=[[1, 0, 0]],
        tie_value=[0.002],
        dof_names=["a.x", "b.x", "c.x"],
        contact_names=["left", "right"],
        tie_names=["one"],
    )
    assert same(read, expected)
    assert any("load: zero at 2 unknowns that the table does not name" in line for line in ledger.assumed)


@pytest.mark.parametrize(
    ("change", "words"),
    {
        "name": (("b.x", "d.x"), r"line 3: expected one of the 3 unknowns, such as 'a.x', got 'd.x'"),
        "gap": (("-0.5,,", "-0.5,0.002,"), r"line 5: expected the gap 0.001 of 'left' again, got 0.002"),
        "no gap": (("b.x,1,0.001", "b.x,1,"), r"line 3: expected a number, got ''"),
        "twice": (("left,a.x", "left,b.x"), "line 5: expected every unknown once"),
        "column": (("coefficient", "weight"), "columns: expected the columns contact, dof, coefficient, gap"),
        "word": (("left,b.x,1", "left,b.x,1_0"), "line 3: expected a number, got '1_0'"),
    }.values(),
)
def test_a_table_of_contacts_with_a_fault(tmp_path, change, words):
    by_symbols(tmp_path)
    for name in ("E_N.csv", "g.npy", "contact_names.txt"):
        (tmp_path / name).unlink()
    (tmp_path / "contacts.csv").write_text(CONTACTS.replace(*change))
    with pytest.raises(cq.InvalidProblem, match=rf"contacts\.csv: {words}"):
        read_problem_folder(tmp_path)


def test_contacts_stated_twice_are_refused(tmp_path):
    by_symbols(tmp_path)
    (tmp_path / "contacts.csv").write_text(CONTACTS)
    with pytest.raises(cq.InvalidProblem, match=r"expected one file of it, got a second one"):
        read_problem_folder(tmp_path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": "another"}, "problem.json: format: expected 'contactqp problem', got 'another'"),
        ({"version": 2}, "problem.json: version: expected 1, got 2"),
        ({"unknowns": 4}, "problem.json: unknowns: expected 3, as in the matrices, got 4"),
        ({"files": {"stiffness": "../K.mtx"}}, "problem.json: files: expected a part .*beside this one"),
        ({"files": {"load": "load.mtx"}}, "stiffness: expected a file called stiffness or K, got none"),
        ({"dof_names": ["a", 1, "c"]}, "problem.json: dof_names: expected a list of names"),
        ({"dof_names": ["a", "b"]}, "dof_names: expected 3 names, one for each row of the stiffness, got 2"),
        ({"units": {"length": "m", "time": "s"}}, "units: expected the keys 'length' and 'force'"),
        ({"units": 3}, "problem.json: units: expected names by name"),
    ],
)
def test_a_problem_json_with_a_fault(tmp_path, change, words):
    write_problem(tmp_path, cq.ContactProblem(**PARTS))
    file = tmp_path / "problem.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | change))
    with pytest.raises(cq.InvalidProblem, match=words) as refused:
        read_problem_folder(tmp_path)
    assert "\n" not in str(refused.value)
