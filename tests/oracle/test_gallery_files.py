"""The exported gallery: read back to the last bit, right in the hands of others, written whole or not at all."""

from __future__ import annotations

import ast
import json
import os
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import qpsolvers
import scipy.sparse as sp

import contactqp as cq
from contactqp.cli import main
from contactqp.exchange.problem_folder import read_problem_folder
from contactqp.oracle.gallery import gallery as gallery_files
from contactqp.oracle.gallery.gallery import problem, problems, write_gallery
from contactqp.oracle.gallery.problem import GalleryProblem
from tests.oracle.matrix_market_user import broken_conditions, read_matrix

EVERY = problems()
DATA = ("stiffness", "load", "normal", "gap", "tangent", "friction", "slip_origin", "tie", "tie_value")


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_gallery(tmp_path_factory.mktemp("somewhere") / "gallery", EVERY)


@pytest.mark.sampled(51)
@pytest.mark.parametrize("known", EVERY)
def test_problems_come_back_to_the_last_bit(exported: Path, known: GalleryProblem) -> None:
    back, ledger = read_problem_folder(exported / known.name)
    for name in DATA:
        here, there = (_dense(getattr(one, name)) for one in (known.problem, back))
        if name in ("tie", "tie_value") and not known.problem.ties:
            continue
        assert (here is None) == (there is None), name
        if here is not None and there is not None:
            assert here.shape == there.shape
            assert here.tobytes() == there.tobytes(), name
    for name in ("dof_names", "contact_names", "units"):
        assert getattr(back, name) == getattr(known.problem, name)
    assert not ledger.ignored


@pytest.mark.sampled(4)
@pytest.mark.parametrize("known", EVERY)
def test_answers_are_right_in_the_hands_of_another_code(exported: Path, known: GalleryProblem) -> None:
    folder = exported / known.name
    # The one answer that belongs to 3/10 and not to the double nearest to it.
    assert broken_conditions(folder) == ([] if known.rounding == 0 else ["cone", "slip direction"])
    answer = json.loads((folder / "answer.json").read_text())
    for part in ("displacement", "normal_force", "tie_force", "gap"):
        assert answer[part] == [float(x) for x in getattr(known.exact, part)]
        if answer[part]:
            assert [Fraction(x) for x in answer["exact"][part]] == list(getattr(known.exact, part))
    assert answer["contact_status"] == list(known.exact.contact_status)


def test_an_answer_that_is_changed_is_wrong_in_the_hands_of_another_code(tmp_path: Path) -> None:
    folder = write_gallery(tmp_path / "g", [problem("wedge")]) / "wedge"
    answer = json.loads((folder / "answer.json").read_text())
    answer["exact"]["normal_force"] = ["-4", "6"]
    (folder / "answer.json").write_text(json.dumps(answer))
    assert broken_conditions(folder) == ["equilibrium", "tension"]


def test_the_index_lists_every_folder(exported: Path) -> None:
    index = json.loads((exported / "index.json").read_text())
    assert (index["format"], index["version"]) == ("contactqp gallery", 1)
    assert [one["name"] for one in index["problems"]] == [known.name for known in EVERY]
    assert {one["folder"] for one in index["problems"]} | {"index.json"} == {path.name for path in exported.iterdir()}
    (table,) = (one for one in index["problems"] if one["name"] == "four-legged-table")
    assert (table["unknowns"], table["contacts"], table["unique_forces"]) == (3, 4, False)


def test_data_that_are_no_doubles_stand_beside_as_fractions(exported: Path) -> None:
    stated = json.loads((exported / "truss-on-rough-floor" / "problem.json").read_text())
    assert stated["exact_data"] == {"friction": ["3/10"]}
    assert 0 < stated["rounding"] < 1e-16
    assert read_matrix(exported / "truss-on-rough-floor" / "friction.mtx")[2] == {(0, 0): 0.3}


def test_what_is_in_a_folder_is_never_touched(tmp_path: Path) -> None:
    (tmp_path / "index.json").write_text("mine")
    with pytest.raises(cq.InvalidProblem, match=r"expected a new or an empty folder, 'index.json' is in it"):
        write_gallery(tmp_path, [problem("wedge")])
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("index.json", "mine")]
    with pytest.raises(cq.InvalidProblem, match="expected a folder, this is a file"):
        write_gallery(tmp_path / "index.json", [problem("wedge")])
    with pytest.raises(cq.InvalidProblem, match="there is no folder"):
        write_gallery(tmp_path / "a" / "b", [problem("wedge")])
    with pytest.raises(cq.InvalidProblem, match="no problem of the gallery is chosen"):
        write_gallery(tmp_path / "new", [])
    (tmp_path / "empty").mkdir()
    assert (write_gallery(tmp_path / "empty", [problem("wedge")]) / "wedge" / "load.mtx").exists()


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_folder_is_written_whole_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    written = gallery_files.write_problem

    def full(folder: Path, *rest: Any) -> Path:
        if folder.name == "two-bars":
            raise error
        return written(folder, *rest)

    monkeypatch.setattr(gallery_files, "write_problem", full)
    expected = cq.InvalidProblem if isinstance(error, OSError) else KeyboardInterrupt
    with pytest.raises(expected):
        write_gallery(tmp_path / "g", [problem("wedge"), problem("two-bars")])
    assert os.listdir(tmp_path) == []


def call(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[object, str, str]:
    with pytest.raises(SystemExit) as exit_:
        main(["gallery", *(str(argument) for argument in arguments)])
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err
    return exit_.value.code, captured.out, captured.err


def test_the_command_writes_and_lists(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "g"
    code, out, err = call(capsys, folder, "--kind", "redundant", "--count", 2, "--seed", 7)
    assert (code, out, err) == (0, f"written: {folder}, 2 problems\n", "")
    assert sorted(path.name for path in folder.iterdir()) == ["index.json", "redundant-7", "redundant-8"]
    code, out, _ = call(capsys, "--list", "--name", "wedge", "--name", "stiff-4")
    assert code == 0
    assert "stiff-4" in out
    assert "Two bars" not in out
    code, out, _ = call(capsys, "--list", "--json", "--difficulty", "hard", "--count", 1)
    assert code == 0
    assert {one["difficulty"] for one in json.loads(out)} == {"hard"}
    assert os.listdir(tmp_path) == ["g"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["{}/g", "--kind", "redundnat"], "did you mean 'redundant'"),
        (["{}/g", "--name", "wegde"], "did you mean 'wedge'"),
        (["{}/g", "--count", "-1"], "count: expected an integer >= 0, got -1"),
        (["{}/g", "--count", "many"], "not a valid integer"),
        (["{}/g", "--kind", "named", "--difficulty", "hard"], "no problem of the gallery is chosen"),
        (["{}/g", "--name", "wedge", "--kind", "tied"], "expected names or a kind"),
        (["{}/g", "--list"], "expected a folder to write to, or --list"),
        (["{}/g", "--json"], "--json goes with --list"),
        ([], "expected a folder to write to, or --list"),
        (["{}/a/b"], "there is no folder"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    code, out, err = call(capsys, *(argument.format(tmp_path) for argument in arguments))
    assert code == 2
    assert out == "" or json.loads(out)["code"] == "invalid-problem"
    assert words in err
    assert os.listdir(tmp_path) == []


def _dense(value: Any) -> np.ndarray[Any, Any] | None:
    if value is None:
        return None
    return np.ascontiguousarray(value.toarray() if sp.issparse(value) else value)


def test_an_empty_folder_is_filled_and_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may be a link, or where the user stands."""
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    before = (tmp_path / "real").stat().st_ino
    write_gallery(tmp_path / "link", [problem("wedge")])
    assert (tmp_path / "real").stat().st_ino == before
    assert sorted(path.name for path in (tmp_path / "real").iterdir()) == ["index.json", "wedge"]
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    write_gallery(".", [problem("wedge")])
    assert sorted(path.name for path in Path.cwd().iterdir()) == ["index.json", "wedge"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["here", "link", "real"]


@pytest.fixture(scope="module")
def test_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sets") / "contact_qpbenchmark"
    with pytest.raises(SystemExit) as ended:
        main(["gallery", "--as", "qpbenchmark", str(folder)])
    assert not ended.value.code
    return folder


@pytest.mark.slow
def test_a_test_set_of_qpbenchmark_has_the_parts_it_asks_for(test_set: Path) -> None:
    """A class named as its file in a script, problems in data/, room for results/."""
    assert {path.name for path in test_set.iterdir()} == {
        "contact_problems.py",
        "data",
        "answers",
        "results",
        "README.md",
    }
    tree = ast.parse((test_set / "contact_problems.py").read_text())
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
    assert [node.name for node in classes] == ["ContactProblems"]
    assert {"title", "description", "sparse_only", "__iter__"} <= {
        node.name for node in classes[0].body if isinstance(node, ast.FunctionDef)
    }


def test_the_answers_of_a_test_set_meet_the_conditions_of_its_programs(test_set: Path) -> None:
    written = sorted((test_set / "data").glob("*.npz"))
    assert [path.stem for path in written] == sorted(known.name for known in EVERY if not known.problem.frictional)
    for path in written:
        program = qpsolvers.Problem.load(str(path))
        answer = json.loads((test_set / "answers" / f"{path.stem}.json").read_text())
        x, z, y = (np.array(answer[name]) for name in ("x", "z", "y"))
        stationary = program.P @ x + program.q
        size = abs(program.P) @ abs(x) + abs(program.q)
        if program.G is not None and len(z):
            stationary, size = stationary + program.G.T @ z, size + abs(program.G).T @ z
            room = program.h - program.G @ x
            scale = abs(program.G) @ abs(x) + abs(program.h)
            assert np.all(room >= -1e-14 * scale), path.stem
            assert np.all(z >= 0)
            assert np.all((z == 0) | (abs(room) <= 1e-14 * scale)), path.stem
        if program.A is not None and len(y):
            stationary, size = stationary + program.A.T @ y, size + abs(program.A).T @ abs(y)
        assert np.all(abs(stationary) <= 1e-14 * size + 1e-300), path.stem
        terms = abs(x) @ abs(program.P) @ abs(x) + abs(program.q) @ abs(x)
        assert 0.5 * x @ program.P @ x + program.q @ x == pytest.approx(answer["cost"], abs=1e-14 * terms)
        assert float(Fraction(answer["exact"]["cost"])) == answer["cost"]


def test_friction_alone_makes_no_test_set(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["gallery", "--as", "qpbenchmark", "--kind", "frictional", str(tmp_path / "set")])
    assert ended.value.code == 2
    assert "expected a problem without friction" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
