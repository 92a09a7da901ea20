"""Receipts of `contactqp check`: they hold as long as files and verdict are what they were."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import contactqp as cq
from tests.cli.test_cli import CASES, run

WALL = CASES / "bar_wall.toml"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A case, its answer, and a wrong one, in a folder that can be moved."""
    made = tmp_path / "report"
    made.mkdir()
    (made / "wall.toml").write_bytes(WALL.read_bytes())
    solution = cq.solve(cq.load_scene(WALL).problem())
    force = solution.normal_force.tolist()
    right = {"displacement": solution.displacement.tolist(), "normal_force": force}
    (made / "right.json").write_text(json.dumps(right), encoding="utf-8")
    (made / "wrong.json").write_text(json.dumps(right | {"normal_force": [1.01 * force[0]]}), encoding="utf-8")
    return made


def receipt_of(capsys: Any, folder: Path, answer: str, *options: str) -> Path:
    file = folder / "receipt.json"
    code, out, err = run(capsys, "check", folder / "wall.toml", folder / answer, "--receipt", file, *options)
    assert (code, err) == (0 if answer == "right.json" else 1, "")
    assert f"written: {file}" in out
    return file


@pytest.mark.parametrize(("answer", "word"), [("right.json", "right"), ("wrong.json", "WRONG")])
def test_a_receipt_holds_wherever_its_folder_is(capsys: Any, folder: Path, answer: str, word: str) -> None:
    data = json.loads(receipt_of(capsys, folder, answer).read_text(encoding="utf-8"))
    assert data["verdict"]["right"] is (word == "right")
    assert data["verdict"]["proven"] is True
    right = [(one["contact"], one["right_normal_force"]) for one in data["wrong_contacts"]]
    assert right == ([] if word == "right" else [("tip", 142.5)])
    assert set(data["sha256"]) == {"wall.toml", answer}
    assert {"equilibrium", "penetration", "energy_error", "force_error"} <= set(data["figures"])
    moved = folder.rename(folder.parent / "elsewhere")
    code, out, err = run(capsys, "check", "--verify", moved / "receipt.json")
    assert (code, err) == (0, "")
    said = f"holds; it says that the answer is {word}, by contactqp {data['contactqp']}"
    assert out == f"{moved / 'receipt.json'}: {said}\n"


def _longer(folder: Path, _: dict[str, Any]) -> None:
    text = (folder / "wall.toml").read_text(encoding="utf-8")
    (folder / "wall.toml").write_text(text.replace('"2001 mm"', '"2002 mm"'), encoding="utf-8")


def _space(folder: Path, _: dict[str, Any]) -> None:
    (folder / "right.json").write_text((folder / "right.json").read_text(encoding="utf-8") + "\n", encoding="utf-8")


def _forged(_: Path, data: dict[str, Any]) -> None:
    data["verdict"]["right"] = False


def _cleverer(_: Path, data: dict[str, Any]) -> None:
    data["figures"]["cleverness"] = 0.0
    del data["figures"]["balance"]


def _pruned(folder: Path, data: dict[str, Any]) -> None:
    del data["sha256"]["right.json"]
    _space(folder, data)


def _another(folder: Path, data: dict[str, Any]) -> None:
    (folder / "other.json").write_bytes((folder / "right.json").read_bytes())
    data["candidate"] = "other.json"


def _flattered(_: Path, data: dict[str, Any]) -> None:
    data["verdict"] |= dict(proven=None, diagnosis="the best answer there ever was")


@pytest.mark.sampled(7)
@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_longer, ["wall.toml has changed since the receipt", "the answer is wrong, and the receipt says right"]),
        (_space, ["right.json has changed since the receipt was written"]),
        (_forged, ["the answer is right, and the receipt says wrong"]),
        (_cleverer, ["cleverness is not known, and the receipt says 0", "balance is 0, and the receipt says not"]),
        (_pruned, ["right.json is judged too, and the receipt has no hash of it"]),
        (_another, ["other.json is judged too", "right.json is not judged any more"]),
        (_flattered, ["the receipt says neither proven nor not", "the best answer there ever was"]),
    ],
)  # fmt: skip
def test_what_has_changed_is_said(
    capsys: Any, folder: Path, change: Callable[[Path, dict[str, Any]], None], said: list[str]
) -> None:
    file = receipt_of(capsys, folder, "right.json")
    data = json.loads(file.read_text(encoding="utf-8"))
    change(folder, data)
    file.write_text(json.dumps(data), encoding="utf-8")
    code, out, _ = run(capsys, "check", "--verify", file)
    assert code == 1
    assert "DOES NOT HOLD" in out
    for text in said:
        assert text in out
    code, out, _ = run(capsys, "check", "--verify", file, "--json")
    assert json.loads(out)["holds"] is False


def test_options_are_kept(capsys: Any, folder: Path) -> None:
    loose = ("--tolerance", "0.1", "--error-tolerance", "0.1")
    file = folder / "receipt.json"
    code, _, _ = run(capsys, "check", folder / "wall.toml", folder / "wrong.json", "--receipt", file, *loose)
    assert code == 0
    code, out, _ = run(capsys, "check", "--verify", file)
    assert code == 0
    assert "by tolerances of 0.1 (violations) and 0.1 (errors)" in out
    assert run(capsys, "check", "--verify", file, "--tolerance", "1e-30")[0] == 2


def _with(name: str, key: str | None, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(data: dict[str, Any]) -> None:
        if key is None:
            data[name] = value
        else:
            data[name][key] = value

    return change


@pytest.mark.sampled(20)
@pytest.mark.parametrize(
    "change",
    [
        _with("options", "compression", []), _with("options", "dof_map", 0), _with("options", "contact_map", {}),
        _with("options", "tolerance", 10**400), _with("options", "tolerance", "small"), _with("options", "x", 1),
        _with("figures", "force_error", 10**400), _with("figures", "force_error", True),
        _with("figures", "force_error", -1.0), _with("verdict", "right", 1), _with("contactqp", None, []),
        _with("created", None, 3), _with("problem", None, ""), _with("sha256", None, ["a"]),
        _with("candidate", None, "a\0b"), _with("options", "contact_map", "\ud800"), _with("sha256", "\0", "x"),
    ],
)  # fmt: skip
def test_a_receipt_of_other_types_is_refused_in_one_line(
    capsys: Any, folder: Path, change: Callable[[dict[str, Any]], None]
) -> None:
    file = receipt_of(capsys, folder, "right.json")
    data = json.loads(file.read_text(encoding="utf-8"))
    change(data)
    file.write_text(json.dumps(data), encoding="utf-8")
    code, out, err = run(capsys, "check", "--verify", file)
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert "expected a receipt" in err


def test_an_answer_that_is_no_number_has_a_receipt_too(capsys: Any, folder: Path) -> None:
    (folder / "wrong.json").write_text('{"displacement": [NaN], "normal_force": [1e308]}', encoding="utf-8")
    file = receipt_of(capsys, folder, "wrong.json")
    code, out, err = run(capsys, "check", "--verify", file)
    assert (code, err) == (0, "")
    assert "holds; it says that the answer is WRONG" in out


def test_all_files_of_a_folder_of_matrices_count(capsys: Any, tmp_path: Path) -> None:
    problem = cq.ContactProblem([[2.0]], [3.0], [[1.0]], [1.0])
    solution = cq.solve(problem)
    for asked in ("folder", "folder/problem.json"):
        folder = tmp_path / asked.replace("/", "-")
        cq.write_problem(folder / "folder", problem)
        answer = {"displacement": solution.displacement.tolist(), "normal_force": solution.normal_force.tolist()}
        (folder / "answer.json").write_text(json.dumps(answer), encoding="utf-8")
        receipt = folder / "folder" / "receipt.json"  # among them, and none of them
        for _ in range(2):
            assert run(capsys, "check", folder / asked, folder / "answer.json", "--receipt", receipt)[0] == 0
            assert run(capsys, "check", "--verify", receipt)[0] == 0
        (folder / "folder" / "tie.csv").write_text("1\n", encoding="utf-8")
        code, out, _ = run(capsys, "check", "--verify", receipt)
        assert code != 0
        assert "tie.csv is judged too" in out or code == 2


@pytest.mark.parametrize("target", ["right.json", "wall.toml", "", ".", "nowhere/receipt.json"])
def test_a_receipt_overwrites_nothing_that_is_judged(capsys: Any, folder: Path, target: str) -> None:
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    place = folder / target if target else ""
    code, _, err = run(capsys, "check", folder / "wall.toml", folder / "right.json", "--receipt", place)
    assert (code, len(err.splitlines())) == (2, 1)
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before


def test_a_receipt_that_is_not_there_is_told_apart_from_one_that_is_none(capsys: Any, tmp_path: Path) -> None:
    code, _, err = run(capsys, "check", "--verify", tmp_path / "nosuch.json")
    assert code == 2
    assert "something else" not in err


@pytest.mark.parametrize(
    "text", ["", "[]", "[" * 100_000, "{}", '{"schema": "contactqp-receipt", "schema_version": 1}']
)
def test_what_is_no_receipt_is_refused_in_one_line(capsys: Any, tmp_path: Path, text: str) -> None:
    file = tmp_path / "receipt.json"
    file.write_text(text, encoding="utf-8")
    code, out, err = run(capsys, "check", "--verify", file)
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert "expected a receipt" in err


@pytest.mark.skipif(sys.platform == "win32", reason="no devices by name")
def test_a_device_that_a_receipt_names_is_not_read(capsys: Any, folder: Path) -> None:
    """A device without end filled the memory before anything was said."""
    file = receipt_of(capsys, folder, "right.json")
    data = json.loads(file.read_text(encoding="utf-8"))
    data["options"]["dof_map"] = "/dev/zero"
    file.write_text(json.dumps(data), encoding="utf-8")
    code, _, err = run(capsys, "check", "--verify", file)
    assert (code, len(err.splitlines())) == (2, 1)
    assert "got a pipe or a device" in err


def test_a_name_that_is_too_long_is_not_repeated(capsys: Any, folder: Path) -> None:
    file = receipt_of(capsys, folder, "right.json")
    data = json.loads(file.read_text(encoding="utf-8"))
    data["options"]["dof_map"] = "a" * 3000
    file.write_text(json.dumps(data), encoding="utf-8")
    code, _, err = run(capsys, "check", "--verify", file)
    assert code == 2
    assert len(err) < 400


def test_a_file_that_is_gone_is_named(capsys: Any, folder: Path) -> None:
    file = receipt_of(capsys, folder, "right.json")
    (folder / "right.json").unlink()
    code, _, err = run(capsys, "check", "--verify", file)
    assert code == 2
    assert "the file 'right.json' beside the receipt" in err


def test_check_needs_a_problem_and_an_answer_or_a_receipt(capsys: Any, folder: Path) -> None:
    assert run(capsys, "check")[0] == 2
    assert run(capsys, "check", folder / "wall.toml")[0] == 2
    assert run(capsys, "check", folder / "wall.toml", folder / "right.json", "--verify", "x.json")[0] == 2
