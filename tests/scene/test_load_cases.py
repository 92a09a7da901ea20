"""A case file under a table of load cases: the answers of cases of their own, and one clear line for a wrong table."""

from __future__ import annotations

import json

import numpy as np
import pytest

import contactqp as cq
from contactqp.scene.load_cases import solve_cases
from tests.cli.commands import CASES, WALL, run


def solved(tmp_path, text, case="bar_wall", method="active-set", **knobs):
    (tmp_path / "loads.csv").write_text(text)
    return solve_cases(cq.load_scene(CASES / f"{case}.toml"), str(tmp_path / "loads.csv"), method, knobs)


def test_rows_state_loads_and_gaps_and_the_rest_is_the_case(tmp_path):
    found = solved(tmp_path, "case,1.x,tip\nhalf,150,\nfull,,\ndouble,600,1e-3\nnear,,0\n")
    assert found.names == ("half", "full", "double", "near")
    assert found.met
    assert found.solutions.normal_force.ravel() == pytest.approx([0.0, 142.5, 442.5, 300.0])
    table = found.solutions.table(found.names)
    assert table.columns == ("case", "contact", "status", "normal_force [kN]", "gap [m]", "passed")
    assert table[1].cells == ("full", "tip", "closed", pytest.approx(142.5), 0.0, True)
    soft = solved(tmp_path, "case;1.x\nfull;300\n", method="penalty", penalty=1e5)
    assert soft.solutions.normal_force.ravel() == pytest.approx([5700 / 103])
    assert not soft.met


def test_coefficients_of_friction_and_bodies(tmp_path):
    found = solved(tmp_path, "case,friction\nas it is,\nsmooth,0\n", "truss_friction_methods")
    own = found.solutions.problem
    for i, friction in enumerate((own.friction, np.zeros(own.contacts))):
        alone = cq.solve(own.replace(friction=friction))
        assert found.solutions.normal_force[i] == pytest.approx(alone.normal_force)
        assert found.solutions.friction_force[i] == pytest.approx(alone.friction_force)
    assert "friction_force [kN]" in found.solutions.table().columns
    block = solved(tmp_path, "case\nas it is\n", "patch_two_blocks")
    alone = cq.solve(block.solutions.problem)
    assert block.solutions.normal_force[0] == pytest.approx(alone.normal_force, rel=1e-9, abs=1e-12)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("text", "case", "message"),
    [
        ("load,1.x\na,1\n", "bar_wall", "begins with case"),
        ("case,2.x\na,1\n", "bar_wall", "names of unknowns"),
        ("case,1.x\na,much\n", "bar_wall", "line 2"),
        ("case,1.x\na,1\na,2\n", "bar_wall", "every case once"),
        ("case,1.x\n", "bar_wall", "a row for each load case"),
        ("case,friction\na,0.3\n", "bar_wall", "whose contacts have friction"),
        ("case,1.x\na,1\n", "bar_wall_path", "without load path"),
    ],
)
def test_a_table_that_does_not_fit_is_refused_in_one_line(tmp_path, capsys, text, case, message):
    (tmp_path / "loads.csv").write_text(text)
    code, out, err = run(capsys, "run", CASES / f"{case}.toml", "--loads", tmp_path / "loads.csv")
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert message in err


def test_the_command_prints_writes_and_tells_programs(tmp_path, capsys):
    (tmp_path / "loads.csv").write_text("case,1.x\nhalf,150\nfull,300\n")
    given = "run", WALL, "--loads", tmp_path / "loads.csv"
    code, out, err = run(capsys, *given, "--csv", tmp_path / "forces.csv")
    assert (code, err) == (0, "")
    for words in ("A bar and a rigid wall", "half", "142.5", "2 of 2 load cases passed", "written:"):
        assert words in out
    assert (tmp_path / "forces.csv").read_text().splitlines()[2].startswith("full,tip,closed,142.5,0.0,true")
    code, out, _ = run(capsys, *given, "--json")
    assert [one["normal_force"]["tip"] for one in json.loads(out)] == pytest.approx([0.0, 142.5])
    assert run(capsys, *given, "--method", "penalty", "--penalty", "1e5 kN/m")[0] == 1
    assert run(capsys, *given, "--quiet")[:2] == (0, "")
    assert run(capsys, *given, "--vtu", "a.vtu")[0] == 2
    assert run(capsys, *given, "--csv", tmp_path / "none" / "a.csv")[0] == 2


def test_the_command_draws_load_cases_and_refuses_other_pictures_before_it_solves(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    table = tmp_path / "loads.csv"
    table.write_text("case,1.x\nhalf,150\ndouble,600\n")
    code, out, _ = run(capsys, "run", "bar_wall", "--loads", table, "--plot", tmp_path / "cases.png")
    assert (code, f"written: {tmp_path / 'cases.png'}" in out.replace("\n", "")) == (0, True)
    assert (tmp_path / "cases.png").read_bytes().startswith(b"\x89PNG")
    for options in (("--plot", tmp_path / "cases.txt"), ("--vtu", tmp_path / "cases.vtu")):
        code, out, error = run(capsys, "run", "bar_wall", "--loads", table, *options)
        assert (code, out, len(error.splitlines())) == (2, "", 1)
