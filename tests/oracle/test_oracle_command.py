"""`contactqp oracle`: exact numbers for any language, and one line where there are none."""

from __future__ import annotations

import doctest
import json
import pathlib
import subprocess
import sys
from fractions import Fraction as F

import numpy as np
import pytest

import contactqp as cq
from contactqp.cli import main
from contactqp.oracle.exact.exact_solution import answer_data, decimal, number_data
from tests.examples import PUSHED_OFF

ROOT = pathlib.Path(__file__).parents[2]
CASES = ROOT / "cases"


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as exit_:
        main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err
    return int(exit_.value.code or 0), captured.out, captured.err


def test_the_table_has_the_fraction_its_double_and_what_was_proven(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys, "oracle", CASES / "truss_floor_printed.toml")
    assert (code, err) == (0, "")
    for words in (
        "180933933661/5980300000",
        "30.254992836646991",
        "-1/1000",
        "[kN]",
        "[m]",
        "foot",
        "closed",
        "proven",
    ):
        assert words in out


def test_json_can_be_read_back_without_loss(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "oracle", CASES / "truss_friction.toml", "--json")
    data = json.loads(out)
    assert code == 0
    [foot] = data["contacts"]
    assert F(foot["normal_force"]["exact"]) == F(180933933661, 6186793000)
    assert foot["normal_force"]["double"] == 180933933661 / 6186793000
    assert F(foot["friction_force"][0]["exact"]) == F(542801800983, 61867930000)
    assert foot["status"] == "slip"
    assert [F(x["displacement"]["exact"]) for x in data["unknowns"]] == [F(30058, 30933965), F(-1, 1000)]
    assert data["units"] == {"length": "m", "force": "kN"}
    assert F(data["events"][0]["time"]["exact"]) == F(458394666339, 639328600000)
    assert "positive in compression" in data["signs"]


def test_json_of_an_enclosure_holds_the_number_as_it_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = run(capsys, "oracle", CASES / "truss_floor.toml", "--json")
    data = json.loads(out)
    force = data["contacts"][0]["normal_force"]
    root = F(int(2**0.5 * 10**15), 10**15)
    for _ in range(5):  # Newton: far beyond the fifty digits printed
        root = (root + 2 / root) / 2
    assert not data["rational"]
    assert abs(F(force["mid"]) - (64855 - 15930 * root) / 1399) <= F(force["radius"]) < F(1, 10**45)
    assert data["contacts"][0]["force_range"] is None


@pytest.mark.slow
def test_ties_have_their_names_and_ranges_their_ends(capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = run(capsys, "oracle", CASES / "tie_symmetry.toml", "--json")
    assert {tie["name"]: tie["tie_force"]["exact"] for tie in json.loads(out)["ties"]} == {
        "A with B": "2",
        "A with C": "3",
        "A with D": "4",
    }
    _, out, _ = run(capsys, "oracle", CASES / "hanging_block.toml", "--json")
    assert [contact["force_range"] for contact in json.loads(out)["contacts"]] == [["1", None], ["1", None]]
    _, out, _ = run(capsys, "oracle", CASES / "hanging_block.toml")
    assert "1 to unbounded" in out
    assert "not unique" in out


def test_a_file_of_another_code_is_taken_as_it_stands(
    capsys: pytest.CaptureFixture[str], tmp_path: pathlib.Path
) -> None:
    pytest.importorskip("h5py")
    problem = cq.ContactProblem([[2.0, 0.0], [0.0, 1.0]], [0.3, -1.0], [[0.0, -1.0]], [0.0], [[1.0, 0.0]], 0.1)
    cq.write_fclib(tmp_path / "pad.hdf5", problem)
    code, out, _ = run(capsys, "oracle", tmp_path / "pad.hdf5", "--json")
    assert code == 0
    assert F(json.loads(out)["contacts"][0]["friction_force"][0]["exact"]) == F(0.1)


@pytest.mark.parametrize(
    ("name", "code", "said"),
    [
        ("von_mises_truss.toml", 2, "large deformations"),
        ("bar_impact.toml", 2, "a motion"),
        ("wedge.toml", 2, "irrational numbers"),
        ("cattaneo_mindlin_cylinder.toml", 2, "load path of bodies"),
        ("not_there.toml", 2, "not_there"),
        ("not_there.hdf5", 2, "not_there"),
    ],
)
def test_what_it_cannot_do_is_one_line(capsys: pytest.CaptureFixture[str], name: str, code: int, said: str) -> None:
    got, out, err = run(capsys, "oracle", CASES / name)
    assert (got, out) == (code, "")
    assert said in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("name", ["bar_wall", "truss_floor", "truss_friction"])
def test_the_time_limit_is_that_of_the_proof(capsys: pytest.CaptureFixture[str], name: str) -> None:
    code, out, err = run(capsys, "oracle", CASES / f"{name}.toml", "--time-limit", 1e-9)
    assert (code, out) == (1, "")
    assert "stopped at the time limit of 1e-09 s" in err


def test_no_equilibrium_is_exit_1_and_proven(capsys: pytest.CaptureFixture[str], tmp_path: pathlib.Path) -> None:
    case = tmp_path / "pushed.toml"
    case.write_text(PUSHED_OFF)
    code, _, err = run(capsys, "oracle", case)
    assert code == 1
    assert "proven in rational numbers" in err


@pytest.mark.slow
def test_without_python_flint_it_says_how_to_install_it() -> None:
    code = (
        "import sys; sys.modules['flint'] = None; "
        "from contactqp.cli import main; "
        f"main(['oracle', {str(CASES / 'bar_wall.toml')!r}])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 3
    assert "pip install python-flint" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_without_python_flint_everything_else_is_there() -> None:
    code = (
        "import sys; sys.modules['flint'] = None; import contactqp as cq; "
        "assert all(getattr(cq, name) is not None for name in cq.__all__); "
        "cq.solve(cq.ContactProblem([[2.0]], [1.0], [[1.0]], [0.1])); print('fine')"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "fine\n"


def test_numbers_of_any_size_are_printed() -> None:
    long = F(10**6000 + 1, 3)
    data = number_data(long, None)
    assert len(data["exact"]) == 6003
    assert data["double"] is None
    assert decimal(long, 5) == "3.3333e5999"
    assert number_data(F(1, 3), 0.0)["radius"] >= F(1, 10**50)


def test_a_solution_prints_itself() -> None:
    stops = cq.ContactProblem([[2.0]], [3.0], [[1.0], [1.0]], [0.5, 0.5], units={"length": "m", "force": "N"})
    words = str(cq.exact(stops))
    assert "contact 0: closed, normal force 1 N" in words
    assert "not unique" in words
    assert "proven: equilibrium" in words
    assert "enclosed" in str(cq.exact(stops.replace(gap=[0.5, 0.75]), enclose=True))


def test_data_of_bodies_say_whose_numbers_they_are() -> None:
    answer = cq.exact(cq.load_scene(CASES / "membrane_paraboloid.toml"))
    assert "assembled bodies as they stand" in answer.data
    data = answer_data(answer, (), "membrane")
    assert np.max([c["normal_force"]["radius"] for c in data["contacts"]]) < 1e-12


@pytest.mark.slow
def test_a_table_of_thousands_of_unknowns_is_left_to_json(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "oracle", CASES / "membrane_paraboloid.toml")
    assert code == 0
    assert "449 displacements are not shown; --json has them" in out
    assert "+-" in out
    assert len(out.splitlines()) < 470


def test_other_arguments_are_refused() -> None:
    with pytest.raises(cq.InvalidProblem, match="expected a ContactProblem or a Scene, got list"):
        cq.exact([1.0])
    with pytest.raises(cq.Unsupported, match="local problem"):
        cq.exact(cq.LocalProblem(delassus=[[1.0, 0.0], [0.0, 1.0]], offset=[1.0, 0.0], friction=0.1, dimension=2))


def test_the_guide_says_what_comes_out() -> None:
    page = (ROOT / "docs" / "guide" / "exact_answers.md").read_text()
    examples = doctest.DocTestParser().get_doctest(page, {}, "exact_answers", "exact_answers.md", 0)
    assert len(examples.examples) >= 6
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    assert runner.run(examples).failed == 0
