"""The cases that come with the package are found by name, from any folder; a file that is there comes first."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import contactqp as cq
from contactqp.scene import shipped
from contactqp.scene.shipped import case_path, shipped_cases, shipped_files, shipped_folder
from tests.cli.test_cli import run

CASES = Path(__file__).parents[2] / "cases"


def test_every_case_of_the_checkout_is_shipped_and_has_a_title() -> None:
    assert shipped_folder() == CASES
    assert [case.file for case in shipped_cases()] == sorted(CASES.glob("*.toml"))
    assert all(case.title for case in shipped_cases())


@pytest.mark.slow
def test_a_name_is_found_from_any_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    assert cq.run("bar_wall")[-1].force_at("tip") == pytest.approx(142.5)
    for arguments in (["run", "bar_wall"], ["explain", "bar_wall.toml", "--no-solve"], ["oracle", "bar_wall"]):
        code, out, err = run(capsys, *arguments)
        assert (code, err) == (0, "")
        assert "A bar and a rigid wall" in out
    Path("answer.json").write_text('{"normal_force": [142.5]}')
    assert run(capsys, "check", "bar_wall", "answer.json")[0] == 0


def test_a_file_that_is_there_comes_first(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    other = (CASES / "bar_wall.toml").read_text(encoding="utf-8").replace("A bar and a rigid wall", "Mine")
    Path("bar_wall.toml").write_text(other, encoding="utf-8")
    assert cq.load_scene("bar_wall.toml").title == "Mine"
    assert case_path("./elsewhere/bar_wall.toml") == Path("elsewhere/bar_wall.toml")
    with pytest.raises(cq.SceneError, match=r"elsewhere/bar_wall\.toml: expected a case file, and there is none"):
        cq.load_scene("elsewhere/bar_wall.toml")


def test_a_misspelled_name_is_answered_with_the_nearest(capsys) -> None:
    code, _, err = run(capsys, "run", "bar_wal")
    assert code == 2
    assert "there is none of that name; of the cases that come with contactqp: bar_wall, bar_wall_path" in err


def test_a_misspelled_file_is_answered_with_the_nearest_beside_it(tmp_path: Path, capsys) -> None:
    (tmp_path / "my_beam.toml").touch()
    for named in ("my_baem.toml", "my_beam.tom", "my_beam"):
        code, _, err = run(capsys, "run", tmp_path / named)
        assert code == 2
        assert f"there is none of that name; nearest: {tmp_path / 'my_beam.toml'}" in " ".join(err.split())


@pytest.mark.slow
def test_a_verb_finds_the_cases_in_which_it_stands_otherwise() -> None:
    assert {case.name for case in shipped_cases(("bouncing", "mass"))} >= {"mass_bounces", "bar_bounces"}
    assert shipped_cases(("strings",)) == shipped_cases(("string",))


@pytest.mark.slow
def test_cases_are_listed_and_found_by_words(capsys) -> None:
    code, out, err = run(capsys, "cases")
    assert (code, err) == (0, "")
    assert all(file.stem in out for file in shipped_files())
    code, out, _ = run(capsys, "cases", "Hertz", "sphere", "--json")
    assert [case["name"] for case in json.loads(out)] == ["cattaneo_mindlin_sphere", "hertz_sphere"]
    assert run(capsys, "cases", "nothing of the kind")[0] == 2
    assert run(capsys, "cases", "ring")[0] == 2  # it stands in strings, springs and during alone
    assert "string_over_floor" in run(capsys, "cases", "strings")[1]
    code, out, err = run(capsys, "cases", "unicorn", "cylinders", "mindlin")
    assert (code, "no case has all of unicorn cylinders mindlin; these have 2 of them" in err) == (0, True)
    assert "cattaneo_mindlin_cylinder" in out


def test_a_package_without_cases_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(shipped, "shipped_files", list)
    for module in ("reporting", "telling"):
        monkeypatch.setattr(f"contactqp.study.{module}.shipped_folder", lambda: None)
    assert run(capsys, "run", "bar_wall")[2].endswith("and there is none of that name\n")
    assert "expected case files, or a folder 'cases' here" in run(capsys, "report", "--full")[2]
    assert "the cases that come with contactqp are missing here; name case files instead" in run(capsys, "report")[2]


def test_a_name_of_five_hundred_letters_is_not_repeated_whole(tmp_path: Path) -> None:
    text = (CASES / "bar_wall.toml").read_text(encoding="utf-8").replace('unknown = "1.x"', f'unknown = "{"9" * 500}"')
    (tmp_path / "long.toml").write_text(text, encoding="utf-8")
    with pytest.raises(cq.SceneError) as refused:
        cq.load_scene(tmp_path / "long.toml")
    assert "there is no unknown '9999" in str(refused.value)
    assert len(str(refused.value)) < 300 + len(str(tmp_path))


def test_a_case_is_found_by_its_name_and_says_what_it_is_about(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "cases", "truss_floor")
    assert code == 0
    assert "truss_floor_printed" not in out
    assert f"file: {CASES / 'truss_floor.toml'}" in out
    assert "contactqp run truss_floor; contactqp init my_case.toml --like truss_floor" in out
    assert "nearest: sphere" in run(capsys, "cases", "spherical")[2]


def test_a_case_is_copied_to_be_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(capsys, "init", "mine.toml", "--like", "bar_wall")[0] == 0
    assert Path("mine.toml").read_text("utf-8") == (CASES / "bar_wall.toml").read_text("utf-8")
    assert run(capsys, "init", "mine.toml", "--like", "bar_wall")[0] == 2  # it stays as it is
    code, _, err = run(capsys, "init", "other.toml", "--like", "bar_wal")
    assert code == 2
    assert "nearest: bar_wall" in err
    assert not Path("other.toml").exists()
    code, _, err = run(capsys, "init", "other.toml", "--like", "beam_on_stop")
    assert code == 2
    assert "`contactqp cases WORD`" in err


@pytest.mark.slow
def test_all_cases_are_a_line_each_of_80_columns(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "run", CASES)
    *lines, last = out.splitlines()
    assert code == 0
    assert len(lines) == len(shipped_files())
    assert max(map(len, lines)) <= 80
    assert last == f"{len(lines)} of {len(lines)} met (--verbose prints the answers)"
