"""Receipts of `contactqp check`: they hold as long as files and verdict are what they were."""

from __future__ import annotations

import json
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


def _boasts(_: Path, data: dict[str, Any]) -> None:
    data["figures"]["force_error"] = -1.0
    data["figures"]["cleverness"] = 0.0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_longer, ["wall.toml has changed since the receipt", "the answer is wrong, and the receipt says right"]),
        (_space, ["right.json has changed since the receipt was written"]),
        (_forged, ["the answer is right, and the receipt says wrong"]),
        (_boasts, ["cleverness is not known, and the receipt says 0"]),
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
    assert run(capsys, "check", "--verify", file)[0] == 0


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"schema": "contactqp-receipt", "schema_version": 1}'])
def test_what_is_no_receipt_is_refused_in_one_line(capsys: Any, tmp_path: Path, text: str) -> None:
    file = tmp_path / "receipt.json"
    file.write_text(text, encoding="utf-8")
    code, out, err = run(capsys, "check", "--verify", file)
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert "expected a receipt" in err


def test_a_file_that_is_gone_is_named(capsys: Any, folder: Path) -> None:
    file = receipt_of(capsys, folder, "right.json")
    (folder / "right.json").unlink()
    code, _, err = run(capsys, "check", "--verify", file)
    assert code == 2
    assert "the file 'right.json' beside the receipt" in err


def test_usage(capsys: Any, folder: Path) -> None:
    assert run(capsys, "check")[0] == 2
    assert run(capsys, "check", folder / "wall.toml")[0] == 2
    assert run(capsys, "check", folder / "wall.toml", folder / "right.json", "--verify", "x.json")[0] == 2
