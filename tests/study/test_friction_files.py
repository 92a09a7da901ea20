"""`contactqp run` on files of FCLIB and Siconos: exit codes, tables, JSON."""

from __future__ import annotations

import json

import numpy as np
import pytest

import contactqp as cq
from contactqp.study.friction_files import run_file
from tests.cli.test_cli import CASES, run
from tests.decks import STACK, write
from tests.exchange.files import (
    H,
    M,
    columns_text,
    dense_text,
    global_text,
    global_tree,
    local_text,
    local_tree,
    put,
    stored,
    triplets_text,
    write_hdf5,
)
from tests.exchange.files import W as DELASSUS
from tests.exchange.published import needs_data, published

# One contact that slides to the left: r = (35/13, 28/13), u = (0, -11/13).
SLIDING = "2\n1\n0\n2\n2\n2\t2\n1 2 2 5\n-7 -17\n0.8\n"


@pytest.fixture
def sliding(tmp_path):
    file = tmp_path / "sliding.dat"
    file.write_text(SLIDING)
    return file


def test_a_file_is_solved_and_its_certificate_printed(capsys, sliding):
    code, out, err = run(capsys, "run", sliding)
    assert (code, err) == (0, "")
    for words in ("sliding.dat", "1 slip", "natural map", "siconos", "seconds", "passed"):
        assert words in out
    assert "REFUSED" not in out


def test_json_holds_forces_and_figures(capsys, sliding):
    code, out, _ = run(capsys, "run", sliding, "--json")
    (data,) = json.loads(out)
    assert code == 0
    assert data["met"]
    assert (data["contacts"], data["dimension"], data["form"]) == (1, 2, "local")
    assert data["force"][0] == pytest.approx([35 / 13, 28 / 13], rel=1e-12)
    assert data["velocity"][0] == pytest.approx([0, -11 / 13], abs=1e-12)
    assert data["statuses"] == {"slip": 1}
    assert data["certificate"]["passed"]
    assert data["certificate"]["natural_map"] < 1e-12
    assert data["asymmetry"] == 0


FILES = {
    "local.hdf5": lambda file: write_hdf5(file, local_tree(joints=True)),
    "global.h5": lambda file: write_hdf5(file, global_tree(joints=True)),
    "unsymmetric.hdf5": lambda file: write_hdf5(
        file, put(global_tree(), "fclib_global/M", stored(M + np.eye(3, k=1) / 4, "csc"))
    ),
    "columns.dat": lambda file: file.write_text(local_text(columns_text(DELASSUS), "1")),
    "global.txt": lambda file: file.write_text(global_text(triplets_text(M), dense_text(H))),
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", FILES)
def test_every_format_runs_beside_case_files(capsys, tmp_path, name):
    FILES[name](tmp_path / name)
    code, out, _ = run(capsys, "run", tmp_path / name, CASES / "bar_wall.toml", "--method", "active-set", "--json")
    case, foreign = json.loads(out)
    assert code == 0
    assert case["title"] == "A bar and a rigid wall"
    assert foreign["file"] == str(tmp_path / name)
    assert foreign["certificate"]["passed"]
    assert (foreign["asymmetry"] > 1e-3) == (name in ("unsymmetric.hdf5", "local.hdf5", "columns.dat"))


def test_methods_and_options_reach_the_solver(capsys, sliding):
    code, out, _ = run(capsys, "run", sliding, "--option", "algorithm=admm", "--option", "polish=false", "--json")
    assert code == 0
    assert "admm" in json.loads(out)[0]["method"]
    code, out, _ = run(capsys, "run", sliding, "--method", "active-set", "--method", "clarabel", "--json")
    assert code == 0
    assert "clarabel" in json.loads(out)[1]["method"]
    code, _, err = run(capsys, "run", sliding, "--method", "activ-set")
    assert code == 2
    assert "active-set" in err


def test_no_answer_is_exit_1_in_one_line(capsys, sliding):
    """One step of the fixed point on the friction bound, which goes in circles on this file."""
    stopped = [f"--option={option}" for option in ("algorithm=tresca", "max_iter=1", "polish=false")]
    code, out, err = run(capsys, "run", sliding, *stopped)
    assert code == 1
    assert err.count("\n") == 1
    assert "sliding.dat" in err
    assert "REFUSED" in out
    (data,) = json.loads(run(capsys, "run", sliding, *stopped, "--json")[1])
    assert data["failure"]
    assert not data["met"]


@pytest.mark.slow
def test_walls_that_close_on_a_block_have_no_answer_and_none_is_invented(capsys, tmp_path):
    """Forces so large that the closing velocity is lost in their rounding are no answer."""
    walls = np.array([[1, 0, -1, 0], [0, 1, 0, 1], [-1, 0, 1, 0], [0, 1, 0, 1.0]])
    file = tmp_path / "jammed.dat"
    file.write_text(f"2\n2\n{dense_text(walls)}-0.1 0 -0.1 0\n0.3 0.3\n")
    code, out, err = run(capsys, "run", file)
    assert code == 1
    assert "jammed.dat" in err
    assert "REFUSED" in out
    (tmp_path / "huge.txt").write_text("8e15 0 8e15 0")
    assert run(capsys, "check", file, tmp_path / "huge.txt")[0] == 1


def test_bad_files_and_options_without_meaning_are_exit_2(capsys, tmp_path, sliding):
    short = tmp_path / "short.dat"
    short.write_text(SLIDING[:-8])
    for arguments, words in {
        ("run", short): "short.dat: q: expected 2 values, got 1",
        (
            "run",
            tmp_path / "none.hdf5",
        ): "none.hdf5: expected a folder or .npz of matrices, a file of FCLIB (HDF5) or "
        "Siconos (text), a quadratic program, or a deck (.inp), and there is none",
        (
            "run",
            sliding,
            "--penalty",
            "1e8 kN/m",
        ): "--penalty: expected a number, as this file states no units, got '1e8 kN/m'",
        ("run", sliding, "--plot", tmp_path / "a.png"): "a problem in local form has forces in --json",
        ("run", sliding, "--vtu", tmp_path / "a.vtu"): "--vtu needs a case file or a deck, this file has no",
        ("run", sliding, "--option", "algorithm=magic"): "sliding.dat: algorithm: expected one of",
    }.items():
        code, _, err = run(capsys, *arguments)
        assert code == 2
        assert words in err
        assert err.count("\n") == 1


def test_without_h5py_an_hdf5_file_is_exit_3(capsys, tmp_path, monkeypatch):
    file = write_hdf5(tmp_path / "a.hdf5", local_tree())
    monkeypatch.setitem(__import__("sys").modules, "h5py", None)
    code, _, err = run(capsys, "run", file)
    assert code == 3
    assert "pip install h5py" in err


def test_bodies_that_only_contact_holds_are_solved_as_bodies(capsys, tmp_path):
    """A floating mass point in the plane: M = 0, so there is no local form."""
    rows = dict(normal=[[0.0, -1.0]], gap=[0.25], tangent=[[1.0, 0.0]], friction=0.5)
    floating = cq.ContactProblem(stiffness=np.zeros((2, 2)), load=[0.25, -1.0], **rows)
    file = tmp_path / "floating.hdf5"
    cq.write_fclib(file, floating)
    outcome = run_file(str(file))
    assert isinstance(outcome.solution, cq.Solution)
    assert outcome.solution.normal_force == pytest.approx([1.0])
    (data,) = json.loads(run(capsys, "run", file, "--json")[1])
    assert data["form"] == "bodies"
    assert data["certificate"]["equilibrium"] < 1e-12


@pytest.mark.sampled(2)
@needs_data
@pytest.mark.parametrize(
    "name", ["Rover1039.dat", "CubeH8.hdf5", "GFC3D_TwoRods1.dat", "LMGC_GlobalFrictionContactProblem00046.hdf5"]
)
def test_published_files_run(capsys, name):
    code, out, _ = run(capsys, "run", published(name), "--json")
    (data,) = json.loads(out)
    assert code == 0
    assert data["certificate"]["natural_map"] < 1e-9


def test_a_folder_of_matrices_prints_its_answer_and_draws_forces_and_gaps(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data = dict(stiffness=[[2.0, -1.0], [-1.0, 1.0]], load=[0.0, 3.0], normal=[[0.0, 1.0]], gap=[1.0])
    cq.write_problem("bare", cq.ContactProblem(**data))
    cq.write_problem("stated", cq.ContactProblem(**data, units={"length": "mm", "force": "N"}))
    code, out, _ = run(capsys, "run", "bare", "--plot", "a.png", "--csv", "a.csv")
    assert code == 0
    assert out.startswith("bare: energy -2.75\nactive-set: passed, proven")
    assert out.endswith("written: a.png\nwritten: a.csv\n")
    assert (tmp_path / "a.png").stat().st_size > 1000
    assert (tmp_path / "a.csv").read_text().splitlines()[1].startswith("0,1.0,contact 0,closed,2.5,")
    run(capsys, "run", "bare", "--method", "osqp", "--method", "lemke", "--csv", "b.csv")
    assert {file.name for file in tmp_path.glob("b*.csv")} == {"b.osqp.csv", "b.lemke.csv"}
    cq.write_problem("rough", cq.ContactProblem(**data, tangent=[[1.0, 0.0]], friction=0.3))
    run(capsys, "run", "rough", "--method", "osqp", "--method", "lemke", "--csv", "c.csv")
    assert {file.name for file in tmp_path.glob("c*.csv")} == {"c.osqp.csv", "c.lemke.csv"}
    cq.write_problem("other/bare", cq.ContactProblem(**data))
    code, _, err = run(capsys, "run", "bare", "other/bare", "--csv", "d.csv")
    assert code == 2
    assert "expected files with distinct names, got 'bare' more than once" in err
    assert not list(tmp_path.glob("d*.csv"))


@pytest.mark.slow
def test_a_deck_is_drawn_and_written_with_its_bodies(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path, STACK)
    code, out, _ = run(capsys, "run", "model.inp", "--plot", "a.svg", "--vtu", "a.vtu", "--units", "mm,N")
    assert (code, out.splitlines()[-2:]) == (0, ["written: a.svg", "written: a.vtu"])
    picture = (tmp_path / "a.svg").read_text()
    assert "ABOVE on BELOW: at most 5 N/mm²" in picture
    assert "displacement, magnitude [mm]" in picture
    assert "model, active-set" in picture
    assert "contact_pressure" in (tmp_path / "a.vtu").read_text(errors="replace")
    solution = cq.solve(cq.read_deck("model.inp").problem())
    for scene in ("model.inp", cq.read_deck("model.inp")):
        titles = [axes.get_title() for axes in cq.draw(solution, scene=scene).axes]
        assert "ABOVE on BELOW: at most 5 force/length²" in titles
    springs = "*NODE\n1, 0.\n2, 1.\n*ELEMENT, TYPE=SPRINGA, ELSET=E\n1, 1, 2\n*SPRING, ELSET=E\n\n3.\n"
    springs += "*BOUNDARY\n1, 1, 3\n2, 2, 3\n*STEP\n*STATIC\n*CLOAD\n2, 1, 1.\n*END STEP\n"
    write(tmp_path, springs, "springs.inp")
    code, out, err = run(capsys, "run", "springs.inp", "--plot", "b.png")
    assert (code, err) == (0, "")
    code, _, err = run(capsys, "run", "springs.inp", "--vtu", "b.vtu")
    assert (code, err.strip()) == (2, "contactqp: springs.inp: a deck without solid elements has no bodies to draw")


def test_a_stiffness_of_a_method_is_a_number_in_the_units_of_the_matrices(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data = dict(stiffness=[[2.0]], load=[3.0], normal=[[1.0]], gap=[1.0])
    cq.write_problem("bare", cq.ContactProblem(**data))
    cq.write_problem("stated", cq.ContactProblem(**data, units={"length": "mm", "force": "N"}))
    for folder, penalty in (("bare", "8"), ("stated", "8"), ("stated", "8 kN/m")):
        out = run(capsys, "run", folder, "--method", "penalty", "--penalty", penalty, "--json")[1]
        assert json.loads(out)[0]["normal_force"] == pytest.approx([0.8])  # (3 - 2) 8 / (2 + 8)
    code, _, err = run(capsys, "run", "bare", "--method", "penalty", "--penalty", "8 kN/m")
    assert code == 2
    assert "bare: --penalty: expected a number, as this file states no units, got '8 kN/m'" in err
