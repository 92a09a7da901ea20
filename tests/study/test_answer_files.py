"""`contactqp run --plot --vtu`: names, exit codes, and nothing solved or written in vain."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import pytest

from tests.cli.test_cli import CASES, WALL, run
from tests.examples import PUSHED_OFF

pytest.importorskip("matplotlib")
pytest.importorskip("meshlane")
TRUSS = str(CASES / "truss_floor.toml")


def names(folder):
    return sorted(file.name for file in folder.iterdir())


@pytest.fixture
def unsolved(monkeypatch):
    """Nothing may be solved."""

    def refuse(*_, **__):
        raise AssertionError("solved before the file was checked")

    monkeypatch.setattr("contactqp.scene.judging.judge_all", refuse)


def test_one_case_writes_the_files_that_were_named(capsys, tmp_path):
    code, out, err = run(capsys, "run", WALL, "--plot", tmp_path / "wall.png", "--vtu", tmp_path / "wall.vtu")
    assert (code, err) == (0, "")
    assert names(tmp_path) == ["wall.png", "wall.vtu"]
    assert f"written: {tmp_path / 'wall.png'}" in out


@pytest.mark.slow
def test_several_cases_put_their_names_before_the_suffix(capsys, tmp_path):
    assert run(capsys, "run", WALL, TRUSS, "--plot", tmp_path / "a.svg")[0] == 0
    assert names(tmp_path) == ["a.bar_wall.svg", "a.truss_floor.history.svg", "a.truss_floor.svg"]


@pytest.mark.slow
def test_a_path_is_drawn_to_a_file_of_its_own(capsys, tmp_path):
    path = str(CASES / "jenkins_loop.toml")
    code, out, _ = run(capsys, "run", path, "--plot", tmp_path / "a.svg")
    assert code == 0
    assert names(tmp_path) == ["a.history.svg", "a.svg"]
    assert f"written: {tmp_path / 'a.history.svg'}" in out
    run(capsys, "run", path, WALL, "--plot", tmp_path / "b.svg")
    assert names(tmp_path)[2:] == ["b.bar_wall.svg", "b.jenkins_loop.history.svg", "b.jenkins_loop.svg"]


@pytest.mark.slow
def test_a_path_without_a_picture_asked_for_has_none(capsys, tmp_path):
    run(capsys, "run", CASES / "jenkins_loop.toml", "--vtu", tmp_path / "a.vtu")
    assert names(tmp_path) == ["a.vtu"]


@pytest.mark.usefixtures("unsolved")
def test_a_case_that_is_called_like_the_history_of_another_is_exit_2(capsys, tmp_path):
    copy = tmp_path / "bar_wall.history.toml"
    copy.write_text(Path(WALL).read_text())
    code, _, err = run(capsys, "run", WALL, copy, "--plot", tmp_path / "a.png")
    assert code == 2
    assert "'bar_wall.history' more than once" in err


@pytest.mark.slow
def test_a_path_that_was_cut_short_is_drawn_as_far_as_it_came(capsys, tmp_path, monkeypatch):
    import contactqp as cq
    from contactqp.scene import judging

    def stops(scene, _):
        raise cq.NotConverged("no further", cq.History(list(cq.run(scene))[:4], [0.0, 1.0, 1.5625, 2.0]))

    monkeypatch.setattr(judging, "judge", stops)
    code, _, err = run(capsys, "run", CASES / "jenkins_loop.toml", "--plot", tmp_path / "a.svg")
    assert code == 1
    assert "no further" in err
    assert names(tmp_path) == ["a.history.svg"]
    drawn = (tmp_path / "a.history.svg").read_text()  # its texts stand there as comments beside their outlines
    assert "as far as it came" in drawn
    assert "Load path: 4 instants" in drawn


def test_several_methods_put_their_names_before_the_suffix(capsys, tmp_path):
    methods = ("--method", "active-set", "--method", "lemke")
    assert run(capsys, "run", WALL, TRUSS, *methods, "--vtu", tmp_path / "a.vtu")[0] == 0
    assert names(tmp_path) == [
        f"a.{case}.{m}.vtu" for case in ("bar_wall", "truss_floor") for m in ("active-set", "lemke")
    ]


def test_a_knob_is_part_of_the_name(capsys, tmp_path):
    run(capsys, "run", WALL, "--method", "penalty", "--vtu", tmp_path / "a.vtu")
    assert names(tmp_path) == [f"a.penalty-penalty=1e{i}-kN-m.vtu" for i in (4, 5, 6, 7, 8)]
    (tmp_path / "one").mkdir()
    knob = ("--method", "penalty", "--penalty", "1e8 kN/m")
    run(capsys, "run", WALL, *knob, "--vtu", tmp_path / "one" / "a.vtu")
    assert names(tmp_path / "one") == ["a.vtu"]


def test_json_stays_json(capsys, tmp_path):
    import json

    code, out, err = run(capsys, "run", WALL, "--json", "--plot", tmp_path / "a.pdf")
    assert code == 0
    assert json.loads(out)
    assert "written" in err


@pytest.mark.parametrize(
    ("option", "name", "words"),
    [
        ("--plot", "a.jpg", ".png or .pdf or .svg"),
        ("--plot", "a", ".png or .pdf or .svg"),
        ("--vtu", "a.png", ".vtu"),
        ("--plot", "none/a.png", "there is no folder"),
    ],
)
@pytest.mark.usefixtures("unsolved")
def test_a_wrong_file_is_exit_2_before_anything_is_solved(capsys, tmp_path, option, name, words):
    code, out, err = run(capsys, "run", WALL, option, tmp_path / name)
    assert (code, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1
    assert names(tmp_path) == []


@pytest.mark.parametrize(
    ("package", "option", "name"),
    [("matplotlib", "--plot", "a.png"), ("meshlane", "--vtu", "a.vtu")],
)
@pytest.mark.usefixtures("unsolved")
def test_a_missing_package_is_exit_3_before_anything_is_solved(capsys, tmp_path, monkeypatch, package, option, name):
    real = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda asked, *a: None if asked == package else real(asked, *a))
    code, _, err = run(capsys, "run", WALL, option, tmp_path / name)
    assert code == 3
    assert f"pip install {package}" in err


@pytest.mark.usefixtures("unsolved")
def test_two_cases_of_one_name_are_exit_2_before_anything_is_solved(capsys, tmp_path):
    (tmp_path / "other").mkdir()
    copy = tmp_path / "other" / "bar_wall.toml"
    copy.write_text(Path(WALL).read_text())
    code, _, err = run(capsys, "run", WALL, copy, "--plot", tmp_path / "a.png")
    assert code == 2
    assert "'bar_wall' more than once" in err
    assert names(tmp_path) == ["other"]


def test_a_trial_without_an_answer_has_no_picture(capsys, tmp_path):
    file = tmp_path / "loose.toml"
    file.write_text(PUSHED_OFF)
    code, _, _ = run(capsys, "run", file, "--plot", tmp_path / "a.png")
    assert code == 1
    assert names(tmp_path) == ["loose.toml"]


@pytest.mark.slow
def test_a_table_of_contacts_over_a_path_is_written(capsys, tmp_path):
    path = str(CASES / "jenkins_loop.toml")
    code, out, _ = run(capsys, "run", path, "--csv", tmp_path / "a.csv")
    assert code == 0
    assert f"written: {tmp_path / 'a.csv'}" in out
    header, first, *_ = (tmp_path / "a.csv").read_text().splitlines()
    assert header.startswith("instant,time [legs],contact,status,normal_force [")
    assert first.split(",")[:2] == ["0", "0.0"]
    history = json.loads(run(capsys, "run", path, "--json")[1])[0]["history"]
    (contact, statuses), *_ = history["contact_status"].items()
    assert len(statuses) == len(history["friction_force"][contact]) == len(history["at"])
    assert {"slip", "stick"} <= set(statuses)


@pytest.mark.usefixtures("unsolved")
@pytest.mark.parametrize("name", ["a.txt", "none/a.csv"])
def test_a_table_that_cannot_be_written_is_told_before_anything_is_solved(capsys, tmp_path, name):
    code, _, err = run(capsys, "run", WALL, "--csv", tmp_path / name)
    assert code == 2
    assert err.count("\n") == 1


def test_friction_that_is_rounding_is_printed_as_zero(capsys):
    _, out, _ = run(capsys, "run", CASES / "truss_friction_horizontal_first.toml")
    row = next(line for line in out.splitlines() if line.split()[:2] == ["foot", "stick"])
    assert row.split()[-2:] == ["0", "0"]
