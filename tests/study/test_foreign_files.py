"""Files as engineers have them: other spellings, units in names, decimal commas, names in several places."""

from __future__ import annotations

import json
import os
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.exchange.answer_files import read_answer
from contactqp.model.names import axis_called, plain_name
from tests.cli.test_cli import CASES, run
from tests.decks import STACK

NAMES = ("1.x", "1.y", "2.x")
K = [[4.0, -1.0, 0.0], [-1.0, 5.0, 2.5], [0.0, 2.5, 3.0]]
CSV = "dof,displacement\n1.x,0.1\n1.y,{y}\n2.x,{x}\ncontact,normal_force\nleft,{f}\nright,0\n"


@pytest.fixture
def folder(monkeypatch, tmp_path) -> Path:
    """Three unknowns and two contacts in p, its answer in u and f; the working directory is there."""
    monkeypatch.chdir(tmp_path)
    place = tmp_path / "p"
    place.mkdir()
    parts = {"K": K, "load": [2.0, 1.0, 0.5], "normal": [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], "gap": [0.1, 5.0]}
    for name, values in parts.items():
        np.savetxt(place / f"{name}.txt", values)
    (place / "dof_names.txt").write_text("\n".join(NAMES))
    (place / "contact_names.txt").write_text("left\nright\n")
    return place


@pytest.fixture
def text(folder) -> str:
    """The right answer as a table."""
    solution = cq.solve(cq.read_problem(folder))
    u, f = solution.displacement.tolist(), solution.normal_force.tolist()
    return CSV.format(y=repr(u[1]), x=repr(u[2]), f=repr(f[0]))


def check(capsys, content: str | bytes, *options: str, name: str = "a.csv") -> tuple[int, str, str]:
    Path(name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return run(capsys, "check", "p", name, *options)


def respelled(text: str, *names: str) -> str:
    for ours, theirs in zip(NAMES, names, strict=True):
        text = text.replace(f"\n{ours},", f"\n{theirs},")
    return text


def test_directions_by_all_their_names():
    same = ("x", "X", "1", "ux", "UX", "U1", "d1", "u_x", "disp_x", "Displacement_X")
    assert {axis_called(name) for name in same} == {"x"}
    assert {axis_called(name) for name in ("rotz", "6", "UR3", "rz", "ROTZ")} == {"rotz"}
    assert [axis_called(name) for name in ("", "0", "7", "temp", "u", "xx")] == [None] * 6
    assert plain_name("12.UX") == plain_name("12.1") == "12.x"
    assert plain_name("12.ROTZ") == plain_name("12.UR3") == plain_name("12.6") == plain_name("12.theta")
    assert plain_name("tip") is None
    assert plain_name(".x") is None


@pytest.mark.sampled(3)
@pytest.mark.parametrize("names", [("1.1", "1.2", "2.1"), ("1.UX", "1.UY", "2.UX"), ("1.u1", "1.y", "2.D1")])
def test_unknowns_spelled_otherwise_are_found_and_the_ledger_says_so(capsys, text, names):
    code, out, _ = check(capsys, respelled(text, *names))
    assert code == 0
    assert f"such as {names[0]} for 1.x" in out
    values = json.dumps({"displacement": dict(zip(names, (0.1, 0.5, 0.2), strict=True))})
    code, out, _ = check(capsys, values, name="wrong.json")
    assert code == 1
    assert "1.y is out of balance" in out


@pytest.mark.parametrize(
    ("names", "more", "said"),
    [
        (("1.1", "1.2", "2.1"), "1.UX,0.2\n", "expected one value for '1.x', got 1.1, 1.UX, which mean the same"),
        (("1.x", "1.y", "2.x"), "2.1,0.7\n", "expected one value for '2.x', got 2.1, 2.x, which mean the same"),
    ],
)
def test_two_spellings_of_one_unknown_are_refused(capsys, text, names, more, said):
    code, _, err = check(capsys, respelled(text, *names).replace("contact,", f"{more}contact,"))
    assert code == 2
    assert said in err


def test_tables_of_a_problem_may_spell_unknowns_otherwise(capsys, folder, text):
    for name in ("normal.txt", "gap.txt", "load.txt", "contact_names.txt"):
        (folder / name).unlink()
    (folder / "contacts.csv").write_text("contact,dof,coefficient,gap\nleft,1.1,1,0.1\nright,2.UX,1,5\n")
    (folder / "load.csv").write_text("dof,load\n1.1,2\n1.2,1\n2.1,0.5\n")
    code, out, _ = check(capsys, text)
    assert code == 0
    assert "contacts: 2 unknowns spelled otherwise, such as 1.1 for 1.x" in " ".join(out.split())
    assert "3 unknowns spelled otherwise, such as 1.1 for 1.x" in " ".join(out.split())
    (folder / "dof_names.txt").write_text("1.x\n1.ux\n2.x\n")
    code, _, err = check(capsys, text)
    assert code == 2
    assert "expected one of '1.x' and '1.ux', got '1.1'" in err


def test_columns_by_axis_as_other_codes_call_them(capsys, text):
    y, x = (text.splitlines()[k].partition(",")[2] for k in (2, 3))
    for columns in ("ux,uy", "U1,U2", "D1,D2", "X,Y"):
        code, _, _ = check(capsys, f"Node,{columns}\n2,{x},0\n1,0.1,{y}\n")
        assert code == 0, columns


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "name", ["displacement [mm]", "displacement (mm)", "displacement/mm", "displacement_mm", "u [m]"]
)
def test_a_unit_in_a_name_is_refused_and_not_passed_over(capsys, text, name):
    """Passed over, the forces alone would be judged, and found right."""
    wrong = text.replace("displacement", name).replace("1.x,0.1", "1.x,100")
    code, _, err = check(capsys, wrong)
    assert code == 2
    assert "alone, in the units of the problem, got a unit, and none is converted" in err


def test_units_of_nodes_forces_and_keys_are_refused_too(capsys, text):
    assert check(capsys, "node,ux [mm],uy [mm]\n1,0.1,0\n2,0,0\n")[0] == 2
    assert check(capsys, text.replace("normal_force", "normal_force [kN]"))[0] == 2
    code, _, err = check(capsys, json.dumps({"displacement": [0.1, 0, 0], "normal_force [N]": [1, 0]}), name="a.json")
    assert code == 2
    assert "normal_force [n]" in err.lower()
    np.savez("a.npz", **{"displacement [m]": np.zeros(3), "normal_force": np.zeros(2)})
    assert run(capsys, "check", "p", "a.npz")[0] == 2


def test_numbers_of_fortran_are_read_everywhere(capsys, folder, text):
    D = text.replace("1.x,0.1", "1.x,1.0D-01")
    assert check(capsys, D)[0] == 0
    (folder / "load.txt").write_text("2.0D0\n+1.0d+00\n5D-1\n")
    assert check(capsys, D)[0] == 0
    (folder / "K.txt").unlink()
    entries = "1 1 4.0D+00\n2 1 -1d0\n2 2 5\n3 2 .25D+01\n3 3 3.D0\n"
    (folder / "K.mtx").write_text(f"%%matrixmarket matrix coordinate real symmetric\n3 3 5\n{entries}")
    assert check(capsys, D)[0] == 0
    assert check(capsys, D.replace("1.0D-01", "1_0.D-02"))[0] == 2


def test_decimal_commas_and_thousands_are_refused_in_words(capsys, folder, text):
    semicolons = text.replace(",", ";")
    assert check(capsys, semicolons)[0] == 0
    code, _, err = check(capsys, semicolons.replace("1.x;0.1", "1.x;0,1"))
    assert code == 2
    assert "got '0,1' (a decimal comma? numbers have points)" in err
    assert check(capsys, text.replace("1.x,0.1", '1.x,"1,000.5"'))[0] == 2
    (folder / "gap.txt").unlink()
    (folder / "gap.csv").write_text("0,1;5,0\n")
    code, _, err = check(capsys, text)
    assert code == 2
    assert "expected one mark between numbers, got two" in err
    (folder / "gap.csv").write_text("0.1;5.0\n")
    assert check(capsys, text)[0] == 0
    (folder / "gap.csv").write_text("0.1, 5.0\n")
    assert check(capsys, text)[0] == 0


@pytest.mark.parametrize("name", ["a.csv", "displacement.txt", "a.json"])
def test_utf_16_is_named(capsys, text, name):
    code, _, err = check(capsys, text.encode("utf-16"), name=name)
    assert code == 2
    assert "expected text in UTF-8, got UTF-16: save it as UTF-8" in err


def test_positions_are_those_of_all_unknowns_and_no_others(capsys, text):
    values = [line.partition(",")[2] for line in text.splitlines()[1:4]]
    table = "dof,displacement\n" + "".join(f"{k},{value}\n" for k, value in enumerate(values))
    assert check(capsys, table)[0] == 0
    code, _, err = check(capsys, table + "3,0\n")  # all unknowns of a mesh, maybe, held ones too
    assert code == 2
    assert "expected 3 values by name, got 3, which the problem does not have" in err
    for empty in ("dof,displacement\n", "contact,normal_force\n"):
        code, _, err = check(capsys, empty)
        assert code == 2
        assert "values by name, got none" in err


def test_friction_columns_in_any_order(capsys, folder):
    for name in ("normal.txt", "gap.txt", "contact_names.txt"):
        (folder / name).unlink()
    rows = "c,1.x,0,0,1,0,0.9\nc,1.y,0,,0,1,\nc,2.x,1,,0,0,\n"
    (folder / "contacts.csv").write_text(f"contact,dof,coefficient,gap,tangent,tangent_2,friction\n{rows}")
    (folder / "K.txt").write_text("4 0 0\n0 4 0\n0 0 4\n")
    (folder / "load.txt").write_text("1 0.5 10\n")
    table = "dof,displacement\n1.x,0\n1.y,0\n2.x,0\ncontact,{}\nc,{}\n"
    assert check(capsys, table.format("normal_force,friction_1,friction_2", "10,1,0.5"))[0] == 0
    assert check(capsys, table.format("friction_2,normal_force,friction_1", "0.5,10,1"))[0] == 0
    assert check(capsys, table.format("normal_force,friction_1,friction_2", "10,0.5,1"))[0] == 1
    named = table.format("normal_force,friction_1,friction_2,friction_coefficient", "10,1,0.5,0.9")
    assert check(capsys, named)[0] == 0
    assert check(capsys, table.format("normal_force,friction_1 [N],friction_2 [N]", "10,1,0.5"))[0] == 2


STATED = {"format": "contactqp problem", "version": 1}


def test_names_in_several_places_must_agree(capsys, folder, text):
    state = lambda **more: (folder / "problem.json").write_text(json.dumps(STATED | more))  # noqa: E731
    state(dof_names=list(NAMES), contact_names=["left", "right"])
    assert check(capsys, text)[0] == 0
    state(contact_names=["right", "left"])
    code, _, err = check(capsys, text)
    assert code == 2
    assert "contact_names: expected the same in contact_names.txt and problem.json, got others" in err
    (folder / "dof_names.txt").write_text("1\n2\n3\n")
    state(dof_names=["1", "2", "3", "4"])
    assert check(capsys, text)[0] == 2
    (folder / "problem.json").unlink()
    (folder / "dof_names.txt").write_text("1.x\n1.y\n2.x\n9.x\n")
    (folder / "load.txt").rename(folder / "load.csv")
    (folder / "load.csv").write_text("dof,load\n9.x,1\n")  # beyond the stiffness
    code, _, err = check(capsys, text)
    assert code == 2
    assert "dof_names: expected 3 names, one for each row of the stiffness, got 4" in err


def test_contacts_of_a_table_are_not_renamed_in_silence(capsys, folder, text):
    for name in ("normal.txt", "gap.txt"):
        (folder / name).unlink()
    (folder / "contacts.csv").write_text("contact,dof,coefficient,gap\nleft,1.x,1,0.1\nright,2.x,1,5\n")
    assert check(capsys, text)[0] == 0
    (folder / "contact_names.txt").write_text("right\nleft\n")
    code, _, err = check(capsys, text)
    assert code == 2
    assert "contact_names: expected those of contacts.csv, in its order, got right, left" in err


def test_names_above_the_columns_of_a_stiffness_are_not_put_in_another_order(capsys, folder, text):
    (folder / "K.txt").unlink()
    (folder / "K.csv").write_text("1.1,1.2,2.1\n4,-1,0\n-1,5,2.5\n0,2.5,3\n".replace("1.1,1.2,2.1", "a.1,a.2,b.1"))
    code, out, _ = check(capsys, text)
    assert code == 0
    assert "ignored: names in the stiffness, such as 'a.1': dof_names are others" in out
    (folder / "K.csv").write_text("1.ux,1.uy,2.ux\n4,-1,0\n-1,5,2.5\n0,2.5,3\n")
    code, out, _ = check(capsys, text)
    assert code == 0
    assert "names in the stiffness" not in out
    (folder / "dof_names.txt").write_text("1.y\n1.x\n2.x\n")
    code, _, err = check(capsys, text)
    assert code == 2
    assert "dof_names: expected '1.ux' at line 1, as the stiffness says, got '1.y'" in err


def test_what_problem_json_says_and_nobody_reads_is_in_the_ledger(capsys, folder, text):
    (folder / "problem.json").write_text(json.dumps(STATED | {"frction": 0.3, "ties": 0}))
    _, out, _ = check(capsys, text)
    assert "ignored: problem.json: frction" in out
    assert "assumed: no ties" not in out
    names = {"stiffness": "K.txt", "load": "load.txt", "normal": "normal.txt", "gap": "gap.txt"}
    (folder / "problem.json").write_text(json.dumps(STATED | {"files": names}))
    (folder / "tie.txt").write_text("0 0 1\n")
    code, out, _ = check(
        capsys, text.replace("1.x", "0").replace("1.y", "1").replace("2.x", "2").partition("contact")[0]
    )
    assert code == 0
    assert "ignored: tie.txt: not among the files of problem.json" in out
    assert "assumed: no ties" in out


def test_ties_by_their_own_names(capsys, folder):
    (folder / "ties.csv").write_text("tie,dof,coefficient\nrod,2.x,1\n")
    solution = cq.solve(cq.read_problem(folder))
    answer = {part: getattr(solution, part).tolist() for part in ("displacement", "normal_force")}
    for name in ("rod", "tie 0"):
        whole = answer | {"tie_force": {name: solution.tie_force[0]}}
        assert check(capsys, json.dumps(whole), name="a.json")[0] == 0
    assert check(capsys, json.dumps(answer | {"tie_force": {"cable": 0.0}}), name="a.json")[0] == 2


def test_a_folder_of_tables_is_an_answer(capsys, text, tmp_path):
    (tmp_path / "theirs").mkdir()
    u, f = text.replace("contact,", "|contact,").split("|")
    (tmp_path / "theirs/displacement.csv").write_text(u)
    (tmp_path / "theirs/normal_force.csv").write_text(f)
    assert run(capsys, "check", "p", "theirs")[0] == 0
    shutil.copy(tmp_path / "theirs/normal_force.csv", tmp_path / "theirs/displacement.csv")
    code, _, err = run(capsys, "check", "p", "theirs")
    assert code == 2
    assert "displacement.csv: expected displacement and nothing else, got normal_force" in err


def test_a_table_without_a_known_first_column_is_told_what_to_call_it(capsys, text):
    code, _, err = check(capsys, text.partition("contact")[0].replace("dof,", "name,"))
    assert code == 2
    assert "expected dof, node, contact or tie as the first column" in err


def test_json_without_a_suffix_and_lists_without_names(capsys, text):
    u = [float(line.partition(",")[2]) for line in text.splitlines()[1:4]]
    assert check(capsys, json.dumps([{"displacement": u}]), name="answer")[0] == 0
    code, _, err = check(capsys, json.dumps(u), name="a.json")
    assert code == 2
    assert 'expected one answer, such as {"displacement": [...]}, got a list of numbers' in err


def test_signs_of_forces_that_are_not_there_were_not_turned(capsys, text):
    _, out, _ = check(capsys, text.partition("contact")[0], "--compression", "negative")
    assert "turned round" not in out
    _, out, _ = check(capsys, text, "--compression", "negative")
    assert "turned round" in out


def test_what_the_system_refuses_is_one_line(capsys, folder, text):
    for arguments in (("a" * 300, "a.csv"), ("p", "a" * 300)):
        code, out, err = run(capsys, "check", *arguments)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert "File name too long" in err
    os.symlink("p", "link")
    assert check(capsys, text)[0] == 0
    assert run(capsys, "check", "link", "a.csv")[0] == 0
    (folder / "K.txt").rename(folder / "K.txt.gz")
    code, _, err = run(capsys, "check", "p", "a.csv")
    assert code == 2
    assert "p: folder: expected problem.json, or a file called stiffness or K, got K.txt.gz, contact_names.txt" in err
    (folder / "K.txt").write_bytes(b"\x1f\x8b\x08\x00rest")
    code, _, err = run(capsys, "check", "p", "a.csv")
    assert code == 2
    assert "compressed by gzip" in err


def test_the_load_in_a_harwell_boeing_file_is_not_told_as_left_out_where_it_is_the_load(folder):
    from benchmarks.valid_files import HARWELL_BOEING
    from contactqp.exchange.problem_files import read_problem_with_ledger

    (folder / "K.txt").unlink()
    (folder / "load.txt").unlink()
    (folder / "K.rsa").write_text(HARWELL_BOEING)
    problem, ledger = read_problem_with_ledger(folder)
    assert problem.load.tolist() == [2.0, 1.0, 0.5]
    assert not ledger.ignored
    assert any("right-hand sides: 1" in line for line in ledger.read)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("case", ["hanging_block", "klarbring_slides_back", "block_on_incline_sideways"])
def test_what_run_prints_with_friction_is_an_answer(capsys, tmp_path, case):
    file = CASES / f"{case}.toml"
    _, out, _ = run(capsys, "run", file, "--method", "active-set", "--json")
    (tmp_path / "r.json").write_text(out)
    code, out, _ = run(capsys, "check", file, tmp_path / "r.json", "--json")
    assert code == 0
    assert any("friction_force: " in line for line in json.loads(out)["ledgers"][1]["read"])
    (answer,) = json.loads((tmp_path / "r.json").read_text())
    next(iter(answer["friction_components"].values()))[0] += 1.0
    (tmp_path / "r.json").write_text(json.dumps(answer))
    assert run(capsys, "check", file, tmp_path / "r.json")[0] == 1
    del answer["friction_components"]
    (tmp_path / "r.json").write_text(json.dumps(answer))
    code, _, err = run(capsys, "check", file, tmp_path / "r.json")
    assert code == 2
    assert "friction_force: expected one or two components a contact, along the rows of E_T" in err


@pytest.mark.slow
def test_names_that_the_problem_does_not_have_take_no_time(tmp_path):
    """A mesh of 60 000 unknowns, a third of them held: a search among all names for each would take minutes."""
    n = 40000
    problem = cq.ContactProblem(
        stiffness=sp.eye(n, format="csc"),
        load=np.ones(n),
        normal=sp.csr_array(([1.0], ([0], [0])), shape=(1, n)),
        gap=[2.0],
        dof_names=[f"{k}.{axis}" for k in range(n // 2) for axis in "xy"],
    )
    file = tmp_path / "u.csv"
    file.write_text("node,U1,U2,U3\n" + "".join(f"{k},1,1,0\n" for k in range(n // 2)))
    began = time.process_time()
    found = read_answer(file, problem)
    assert time.process_time() - began < 10
    assert np.all(found.parts["displacement"] == 1)
    assert any("20000 names that the problem does not have" in line for line in found.ledger.ignored)


@pytest.mark.slow
def test_run_calls_the_units_of_matrices_and_decks_by_their_names(capsys, folder):
    Path(folder.parent / "deck.inp").write_text(STACK)
    for problem, of_a_gap in (("p", "gap [mm]"), ("deck.inp", "gap [mm]")):
        plain, named = run(capsys, "run", problem), run(capsys, "run", problem, "--units", "mm,N")
        assert of_a_gap in named[1]
        assert of_a_gap not in plain[1]
        assert json.loads(run(capsys, "run", problem, "--units", "mm,N", "--json")[1])[0]["units"] == {
            "length": "mm",
            "force": "N",
        }
    penalty = "--method", "penalty", "--penalty", "1e9 N/mm"
    assert "states no units" in run(capsys, "run", "deck.inp", *penalty)[2]
    assert run(capsys, "run", "deck.inp", *penalty, "--units", "mm,N")[0] == 1


def test_names_of_units_that_fit_nothing_are_refused_in_one_line(capsys, folder):
    named = cq.read_problem(folder).replace(units={"length": "m", "force": "kN"})
    cq.write_problem(folder.parent / "q", named)
    for arguments, said in (
        (("q", "--units", "mm,N"), "got m and kN"),
        (("p", "--units", "mm"), "expected LENGTH,FORCE, such as mm,N, got 'mm'"),
        (("p", "--units", "N,mm"), "expected a length, got 'N'"),
        (("bar_wall", "--units", "mm,N"), "a case states its units itself"),
    ):
        code, _, error = run(capsys, "run", *arguments)
        assert (code, said in error, len(error.splitlines())) == (2, True, 1), error


def test_run_tells_what_of_a_deck_was_assumed_and_all_of_it_with_verbose(capsys, folder):
    text = STACK.replace("*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR\n1e4\n", "")
    Path(folder.parent / "deck.inp").write_text(text)
    short, long = run(capsys, "run", "deck.inp")[1], run(capsys, "run", "deck.inp", "--verbose")[1]
    assumed = "  assumed: deck.inp: line 37: no *SURFACE BEHAVIOR: HARD"
    assert assumed in short
    assert assumed in long
    for line in ("  read: 16 nodes, 2 C3D8", "  ignored: deck.inp: line 1: *HEADING: words"):
        assert line in long
        assert line not in short
    ledger = json.loads(run(capsys, "run", "deck.inp", "--json")[1])[0]["ledger"]
    assert "deck.inp: line 1: *HEADING: words" in ledger["ignored"]
