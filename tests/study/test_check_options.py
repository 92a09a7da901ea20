"""What `check` is told of a candidate, and what is refused of maps, areas and candidates: one line, exit 2."""

from __future__ import annotations

import json

import numpy as np
import pytest

import contactqp as cq
from contactqp.exchange.answer_files import read_answer
from tests.cli.test_cli import CASES, run
from tests.exchange.test_problem_folder import PARTS

ANSWER = {"displacement": {"a.x": 0.5, "b.x": 1e-3, "c.x": 0.0}, "normal_force": {"left": 1.0, "right": 2.0}}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A problem of three unknowns and two contacts, and its right answer by name."""
    problem = cq.ContactProblem(**PARTS)
    solution = cq.solve(problem)
    cq.write_problem(tmp_path / "p", problem)
    values = {"displacement": (problem.dof_names, solution.displacement)}
    values["normal_force"] = (problem.contact_names, solution.normal_force)
    data = {part: dict(zip(names, found.tolist(), strict=True)) for part, (names, found) in values.items()}
    (tmp_path / "a.json").write_text(json.dumps(data))
    (tmp_path / "lists.json").write_text(json.dumps({part: list(found.values()) for part, found in data.items()}))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_verdict_has_ledgers_of_both_files_and_a_diagnosis(capsys, folder):
    code, out, _ = run(capsys, "check", "p", "a.json")
    assert code == 0
    assert "stiffness: stiffness.mtx: Matrix Market, coordinate: 3 by 3" in out
    assert "displacement: 3 values by name" in out
    data = json.loads((folder / "a.json").read_text())
    data["normal_force"]["right"] *= -1
    (folder / "a.json").write_text(json.dumps(data | {"energy": 3}))
    code, out, _ = run(capsys, "check", "p", "a.json", "--json")
    found = json.loads(out)
    assert code == 1
    assert [ledger["source"] for ledger in found["ledgers"]] == ["p", "a.json"]
    assert found["ledgers"][1]["ignored"] == ["energy"]
    assert found["worst"][0]["contact"] == "right"
    assert found["diagnosis"]
    assert found["findings"][0]["kind"]
    printed = run(capsys, "check", "p", "a.json")[1]
    assert found["diagnosis"] in printed


BAD_CANDIDATES = {
    "gone.json": (None, "gone.json: expected an answer"),
    "empty.json": ("", "empty.json: content: expected"),
    "none.json": ('{"energy": 1}', "none.json: content: expected a JSON file with displacement and normal_force"),
    "number.json": ('{"displacement": 3}', "number.json: displacement: expected a list, or values by name, got 3"),
    "text.json": ('{"displacement": ["x"]}', "text.json: displacement: expected numbers"),
    "true.json": ('{"displacement": [true, 0, 0]}', "true.json: displacement: expected numbers"),
    "huge.json": ('{"displacement": [1' + "0" * 400 + "]}", "huge.json: displacement: expected numbers"),
    "twice.json": ('{"u": [1, 2, 3], "displacement": [1, 2, 3]}', "displacement: expected every part once"),
    "key.json": ('{"u": {"a.x": 1, "a.x": 2}}', "key.json: a.x: expected every key once, got it twice"),
    "deep.json": ("[" * 50000, "deep.json: content: expected"),
    "short.json": ('{"displacement": [1, 2]}', "short.json: displacement: expected shape (3,), got (2,)"),
    "names.json": (
        '{"displacement": {"a.x": 1, "b.x": 2}}',
        "names.json: displacement: expected 3 values by name, got no c.x",
    ),
    "contacts.json": (
        '{"normal_force": {"left": 1, "right": 2, "middle": 3}}',
        "contacts.json: normal_force: expected 2 values by name, got middle, which the problem does not have",
    ),
    "cells.csv": ("dof,displacement\na.x,1,2\n", "cells.csv: line 2: expected 2 cells, got 3"),
    "cell.csv": ("dof,displacement\na.x,one\n", "cell.csv: line 2: expected a number, got 'one'"),
    "rows.csv": ("dof,displacement\na.x,1\nb.x,1\na.x,2\n", "rows.csv: displacement: expected every name once"),
    "columns.csv": ("dof,displacement,displacement\na.x,1,1\n", "columns.csv: line 1: expected every column once"),
    "other.csv": (
        "dof,weight\na.x,1\n",
        "expected a column displacement beside dof, or normal_force beside contact, got the columns dof,weight",
    ),
    "quote.csv": ('dof,displacement\n"a.x,1\n', "quote.csv: content: expected a table"),
    "length.txt": ("1\n2\n3\n4\n", "length.txt: content: expected 3 displacements or 2 normal forces, got 4 numbers"),
    "matrix.txt": ("1 2\n3 4\n5 6\n", "matrix.txt: content: expected 3 displacements or 2 normal forces, got 6"),
    "word.txt": ("1 x 3\n", "word.txt: line 1: expected a number, got 'x'"),
    "pressure.csv": ("contact,pressure\nleft,1\nright,1\n", "--pressure-areas, which make it a force, got none"),
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", BAD_CANDIDATES)
def test_a_candidate_with_a_fault_is_exit_2(capsys, folder, name):
    text, words = BAD_CANDIDATES[name]
    if text is not None:
        (folder / name).write_text(text)
    code, out, err = run(capsys, "check", "p", name)
    assert (code, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("text", "words"),
    [  # forces that would be left out, without which the answer is right
        ("node,ux,normal_force\na,{},5\nb,{},5\nc,{},5\n", "column normal_force: expected forces in a table whose"),
        (
            "node,ux,fcontact\na,{},5\nb,{},5\nc,{},5\n",
            "column fcontact: expected forces in a table whose first column",
        ),
        ("node,ux,CPRESS\na,{},5\nb,{},5\nc,{},5\n", "column cpress: expected forces in a table whose first column"),
        ("dof,displacement,force\na.x,{},5\nb.x,{},5\nc.x,{},5\n", "column force: expected forces in a table whose"),
        ("node,ux\na,{}\nb,{}\nc,{}\ncontact,fn\nleft,1\nright,2\n", "column fn: expected normal_force or friction"),
    ],
)
def test_columns_of_forces_are_read_or_refused(capsys, folder, text, words):
    values = json.loads((folder / "a.json").read_text())["displacement"].values()
    (folder / "a.csv").write_text(text.format(*map(repr, values)))
    code, out, err = run(capsys, "check", "p", "a.csv")
    assert (code, out) == (2, "")
    assert words in err


def test_columns_of_other_numbers_are_ignored_which_stands_at_the_top_and_in_the_receipt(capsys, folder):
    values = json.loads((folder / "a.json").read_text())["displacement"].values()
    (folder / "a.csv").write_text("node,ux,temperature\na,{},5\nb,{},5\nc,{},5\n".format(*map(repr, values)))
    code, out, _ = run(capsys, "check", "p", "a.csv", "--receipt", "r.json")
    assert code == 0
    assert out.splitlines()[1] == "  ignored: column temperature"
    assert json.loads((folder / "r.json").read_text())["ignored"] == ["column temperature"]
    (folder / "r.csv").write_text("node,ux,reaction_force\na,{},5\nb,{},5\nc,{},5\n".format(*map(repr, values)))
    assert "ignored: column reaction_force" in run(capsys, "check", "p", "r.csv")[1]  # of supports
    code, _, err = run(capsys, "check", "p", "a.csv", "--compression", "negative")
    assert code == 2
    assert "normal_force: expected the forces whose sign --compression tells, got none" in err


def test_the_map_that_a_diagnosis_names_can_be_pasted(capsys, folder):
    data = json.loads((folder / "a.json").read_text())
    left, right = data["normal_force"].values()
    assert left != right
    (folder / "turned.json").write_text(json.dumps(data | {"normal_force": {"left": right, "right": left}}))
    out = run(capsys, "check", "p", "turned.json")[1]
    assert "--contact-map '[1, 0]': this answer is right" in out
    for told in ("[1, 0]", "1,0"):
        code, _, _ = run(capsys, "check", "p", "turned.json", "--contact-map", told, "--receipt", "r.json")
        assert code == 0
        assert run(capsys, "check", "--verify", "r.json")[0] == 0
    many = str(list(range(400)))  # longer than the name of a file may be
    code, _, err = run(capsys, "check", "p", "turned.json", "--contact-map", many)
    assert (code, "contact_map" in err, err.count("\n")) == (2, True, 1)
    (folder / "map.csv").write_text("problem,candidate\nleft,4\nright,7\n")
    (folder / "numbers.json").write_text(json.dumps(data | {"normal_force": {"4": left, "7": right}}))
    assert run(capsys, "check", "p", "numbers.json", "--contact-map", "map.csv")[0] == 0


BAD_MAPS = {
    "empty": ("", "lists.json", "map: content: expected places or names, one a line"),
    "few": ("0\n1\n", "lists.json", "dof_map: expected 3 integers"),
    "twice": ("0\n1\n1\n", "lists.json", "dof_map: place 1 is given to b.x and c.x"),
    "far": ("0\n1\n3\n", "lists.json", "displacement: expected at least 4 values"),
    "unknown": ("a.x\nb.x\nd.x\n", "lists.json", "dof_map: expected every unknown of the problem, 'c.x' missing"),
    "names": (
        "a.x\nb.x\nc.x\n",
        "a.json",
        "map: content: expected a table problem,candidate, as the candidate has names",
    ),
    "renamed": ("problem,candidate\na.x,x\nb.x,y\nc.x,z\n", "lists.json", "expected places counted from 0"),
    "missing": ("problem,candidate\na.x,x\nb.x,y\n", "a.json", "each of the problem's 3 names once, got c.x"),
    "again": ("problem,candidate\na.x,x\nb.x,y\nc.x,x\n", "a.json", "candidate: expected every name once"),
    "columns": ("problem,other\na.x,x\n", "a.json", "map: columns: expected problem,candidate, got problem, other"),
}


@pytest.mark.parametrize("name", BAD_MAPS)
def test_a_map_with_a_fault_is_exit_2(capsys, folder, name):
    text, candidate, words = BAD_MAPS[name]
    (folder / "map").write_text(text)
    code, out, err = run(capsys, "check", "p", candidate, "--dof-map", "map")
    assert (code, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1\n", "pressure_area: expected one area a contact, shape (2,), got (1,)"),
        ("1\n0\n", "pressure_area: expected positive finite areas, got 0 at [1]"),
        ("1 2\n3 4\n", "areas: content: expected one area a contact, got shape (2, 2)"),
        ("contact,area\nleft,1\n", "areas: contact: expected each of the problem's 2 contacts once, got right"),
        ("contact,size\nleft,1\n", "areas: columns: expected contact,area"),
    ],
)
def test_areas_with_a_fault_are_exit_2(capsys, folder, text, words):
    (folder / "areas").write_text(text)
    code, _, err = run(capsys, "check", "p", "a.json", "--pressure-areas", "areas")
    assert code == 2
    assert words in err


def test_an_array_of_as_many_numbers_as_unknowns_and_contacts_needs_a_name(tmp_path):
    problem = cq.ContactProblem(stiffness=[[2.0]], load=[3.0], normal=[[1.0]], gap=[1.0])
    np.save(tmp_path / "a.npy", [1.0])
    with pytest.raises(cq.InvalidProblem, match="expected a file called displacement or normal_force"):
        read_answer(tmp_path / "a.npy", problem)
    np.save(tmp_path / "normal_force.npy", [1.0])
    assert list(read_answer(tmp_path / "normal_force.npy", problem).parts) == ["normal_force"]


def test_columns_that_are_no_vector_are_not_flattened(tmp_path):
    """Two columns of two contacts have as many numbers as four unknowns."""
    problem = cq.ContactProblem(stiffness=np.eye(4), load=np.ones(4), normal=np.eye(4)[:2], gap=[1.0, 1.0])
    (tmp_path / "a.csv").write_text("number,value\n1,2.5\n2,3.5\n")
    with pytest.raises(cq.InvalidProblem, match=r"displacement: expected a vector, got shape \(2, 2\)"):
        read_answer(tmp_path / "a.csv", problem)


def test_signs_and_areas_of_forces_for_a_local_problem(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    local = cq.LocalProblem(delassus=[[1.0, 2.0], [2.0, 5.0]], offset=[-7.0, -17.0], friction=0.8, dimension=2)
    cq.write_fclib("p.hdf5", local)
    force = cq.solve(local).force
    np.save("turned.npy", force * [-1, 1])
    assert run(capsys, "check", "p.hdf5", "turned.npy")[0] == 1
    assert run(capsys, "check", "p.hdf5", "turned.npy", "--compression", "negative")[0] == 0
    np.save("pressure.npy", force / 0.25)
    (tmp_path / "areas.txt").write_text("0.25\n")
    code, out, _ = run(capsys, "check", "p.hdf5", "pressure.npy", "--pressure-areas", "areas.txt")
    assert code == 0
    assert "converted: pressures: multiplied by the areas of the contacts" in out
    assert run(capsys, "check", "p.hdf5", "pressure.npy")[0] == 1
    code, _, err = run(capsys, "check", "p.hdf5", "pressure.npy", "--dof-map", "areas.txt")
    assert code == 2
    assert "--dof-map: expected a problem with displacements" in err


def test_ties_of_a_case_go_by_their_names(capsys, tmp_path):
    case = CASES / "tie_symmetry.toml"
    (data,) = json.loads(run(capsys, "run", case, "--method", "active-set", "--json")[1])
    assert isinstance(data["tie_force"], dict)
    file = tmp_path / "a.json"
    file.write_text(json.dumps(data | {"tie_force": dict(reversed(list(data["tie_force"].items())))}))
    assert run(capsys, "check", case, file)[0] == 0
    file.write_text(json.dumps(data | {"tie_force": dict.fromkeys(data["tie_force"], 1e3)}))
    assert run(capsys, "check", case, file)[0] == 1
    file.write_text(json.dumps(data | {"tie_force": {"elsewhere": 1.0}}))
    assert run(capsys, "check", case, file)[0] == 2


def test_a_stiffness_alone_is_no_problem(capsys, folder):
    (folder / "K.full").write_bytes(b"\0" * 500)
    code, _, err = run(capsys, "check", "K.full", "a.json")
    assert code == 2
    assert "expected a folder of this stiffness, a load, and contacts" in err


def test_what_run_prints_of_a_folder_is_right(capsys, folder):
    code, out, _ = run(capsys, "run", "p", "--json")
    (data,) = json.loads(out)
    assert code == 0
    assert data["form"] == "bodies"
    assert data["statuses"] == {"closed": 1, "open": 1}
    (folder / "ours.json").write_text(out)
    assert run(capsys, "check", "p", "ours.json")[0] == 0


def test_error_bounds_are_printed_and_in_the_json_of_right_and_wrong_answers(capsys, tmp_path, monkeypatch):
    """The force of the wall is 285/2, and 57/40 off if it is a hundredth larger; the pad slips by 1/10 at 3/10."""
    monkeypatch.chdir(tmp_path)
    units = {"length": "m", "force": "kN"}
    bar = dict(stiffness=[[157500.0]], load=[300.0], normal=[[1.0]], gap=[1e-3], units=units)
    cq.write_problem("bar", cq.ContactProblem(**bar))
    for force, off in ((142.5, 0.0), (143.925, 1.425)):
        (tmp_path / "answer.json").write_text(json.dumps({"displacement": [1e-3], "normal_force": [force]}))
        _, out, _ = run(capsys, "check", "bar", "answer.json")
        assert "error bounds, proven: displacement " in out
        assert off == 0.0 or "no contact force is further off than 1.4 kN" in out
        bounds = json.loads(run(capsys, "check", "bar", "answer.json", "--json")[1])["bounds"]
        assert bounds["force_bound"] == pytest.approx([off], rel=1e-9, abs=1e-12)
        assert bounds["force_error"] == pytest.approx(off / 142.5, rel=1e-9, abs=1e-14)
    pad = cq.ContactProblem(
        stiffness=[[2.0, 0.0], [0.0, 0.0]],
        load=[0.5, -1.0],
        normal=[[0.0, -1.0]],
        gap=[0.0],
        tangent=[[1.0, 0.0]],
        friction=0.3,
    )
    cq.write_problem("pad", pad)
    answer = {"displacement": [0.11, 0.0], "normal_force": [1.0], "friction_force": [0.28]}
    (tmp_path / "answer.json").write_text(json.dumps(answer))
    _, out, _ = run(capsys, "check", "pad", "answer.json", "--tolerance", "0.1", "--error-tolerance", "0.2")
    assert "error bounds, proven: displacement 0.1, contact forces 0.067" in out
    assert "no contact force is further off than 0.02" in out
    assert "no bound: energy_error, force_error, force_bound: friction" in run(capsys, "check", "pad", "answer.json")[1]


def test_matrices_of_csv_files_are_told_what_their_units_are_called(capsys, tmp_path, monkeypatch):
    """Nothing in such a folder can name them. A receipt keeps the names; those written before have none."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bar").mkdir()
    files = {
        "K": "1.x\n157500\n",
        "load": "dof,load\n1.x,300\n",
        "contacts": "contact,dof,coefficient,gap\nw,1.x,1,1e-3\n",
    }
    for name, text in files.items():
        (tmp_path / "bar" / f"{name}.csv").write_text(text)
    (tmp_path / "a.csv").write_text("contact,normal_force\nw,143\n")
    (tmp_path / "a.json").write_text('{"units": {"length": "mm", "force": "N"}, "normal_force": {"w": 142.5}}')
    code, out, _ = run(capsys, "check", "bar", "a.csv", "--units", "m,kN", "--receipt", "r.json")
    assert code == 1
    assert "force [kN]" in out
    assert "gap [m]" in out
    assert run(capsys, "check", "--verify", "r.json")[0] == 0
    assert json.loads((tmp_path / "r.json").read_text())["options"]["units"] == {"length": "m", "force": "kN"}
    assert run(capsys, "check", "bar", "a.csv", "--receipt", "r.json")[0] == 1
    receipt = json.loads((tmp_path / "r.json").read_text())
    assert receipt["options"].pop("units") is None
    (tmp_path / "r.json").write_text(json.dumps(receipt))
    assert run(capsys, "check", "--verify", "r.json")[0] == 0
    for units in (3, {"length": "m"}, {"length": "m", "force": 1}):
        receipt["options"]["units"] = units
        (tmp_path / "r.json").write_text(json.dumps(receipt))
        assert "expected a receipt" in run(capsys, "check", "--verify", "r.json")[2]
    assert run(capsys, "check", "bar", "a.json")[0] == 0
    code, _, err = run(capsys, "check", "bar", "a.json", "--units", "m,kN")
    assert code == 2
    assert "expected 'm', that of the problem, got 'mm'" in err
    code, _, err = run(capsys, "check", CASES / "bar_wall.toml", "a.json", "--units", "m,kN")
    assert code == 2
    assert "expected a deck or matrices without units" in err
