"""The JSON schema of case files, and the first case: what editors and newcomers are given."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest

import contactqp as cq
from contactqp.scene.schema import case_schema
from tests.cli.test_cli import CASES, run


@pytest.fixture(scope="module")
def validator() -> Any:
    schema = case_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def read(file: Path) -> dict[str, Any]:
    return tomllib.loads(file.read_text(encoding="utf-8"))


@pytest.mark.slow
@pytest.mark.parametrize("file", sorted(CASES.glob("*.toml")), ids=lambda file: file.stem)
def test_every_case_fits_the_schema(validator: Any, file: Path) -> None:
    assert [error.message for error in validator.iter_errors(read(file))] == []


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (("bars", 0, "modulos"), "210 GPa", "'modulos' was unexpected"),
        (("titel",), "a bar", "'titel' was unexpected"),
        (("bars", 0, "area"), 15, "15 is not of type 'string'"),
        (("bars", 0, "area"), "large", "'large' does not match"),
        (("bars", 0, "area"), "15 cm", "'15 cm' does not match"),
        (("bars", 0, "area"), "15 cm^3", "'15 cm^3' does not match"),
        (("bars", 0, "area"), "15 qm", "'15 qm' does not match"),
        (("bars", 0, "area"), "15", "'15' does not match"),
        (("bars", 0, "modulus"), "210 gpa", "'210 gpa' does not match"),
        (("bars", 0, "modulus"), "210 kN/m²/", "does not match"),
        (("nodes", 1, "at", 0), "2 kN", "'2 kN' does not match"),
        (("loads", 0, "value"), "300 m", "'300 m' does not match"),
        (("obstacles", 0, "kind"), "wall", "is not one of"),
        (("contacts", 0, "name"), 3, "3 is not of type 'string'"),
        (("contacts", 0, "friction"), [1], "not valid under any"),
    ],
)
def test_an_editor_marks_what_the_reader_refuses(validator: Any, path: tuple[Any, ...], value: Any, said: str) -> None:
    data = read(CASES / "bar_wall.toml")
    place: Any = data
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    assert [error for error in validator.iter_errors(data) if said in error.message]
    with pytest.raises(cq.SceneError):
        cq.Scene(**data)


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    "area",
    [
        "15 cm^2",
        "15 cm**2",
        "3/2 mm ^ 2",
        " 2*(1+3) m*m",
        "1e-3 m^2",
        "15cm^2",
        ".5 in^2",
        "4 N/Pa",
        "1 km mm",
        "2 cm²",
        "3 kN/MPa²*Pa",
    ],
)
def test_an_editor_marks_nothing_that_the_reader_takes(validator: Any, area: str) -> None:
    data = read(CASES / "bar_wall.toml")
    data["bars"][0]["area"] = area
    assert cq.Scene(**data).bars[0].area.si > 0
    assert [error.message for error in validator.iter_errors(data)] == []


def test_the_command_prints_the_schema(capsys: Any) -> None:
    code, out, _ = run(capsys, "schema")
    assert code == 0
    assert json.loads(out) == json.loads(json.dumps(case_schema()))
    area = json.loads(out)["$defs"]["Bar"]["properties"]["area"]
    assert (area["type"], area["examples"]) == ("string", ["15 cm^2"])


def test_the_first_case_is_met_and_overwrites_nothing(capsys: Any, tmp_path: Path, validator: Any) -> None:
    file = tmp_path / "mine.toml"
    assert run(capsys, "init", file) == (0, f"written: {file}; contactqp run {file}\n", "")
    text = file.read_text(encoding="utf-8")
    assert f"contactqp run {file}" in text
    assert list(validator.iter_errors(read(file))) == []
    assert run(capsys, "run", file, "--strict")[0] == 0
    code, _, err = run(capsys, "init", file)
    assert code == 2
    assert "expected a name that is free" in err
    assert file.read_text(encoding="utf-8") == text
    assert run(capsys, "init", tmp_path / "mine.txt")[0] == 2


def test_rotations_and_displacements_answer_to_the_names_of_other_codes() -> None:
    scene = cq.Scene(
        title="cantilever", axes=["x", "y"],
        nodes=[{"name": "a", "at": ["0 m", "0 m"]}, {"name": "b", "at": ["0 m", "2 m"]}],
        beams=[{"name": "beam", "nodes": ["a", "b"], "area": "1 m^2", "inertia": "1 m^4", "modulus": "8 Pa"}],
        fixed=["a", "a.theta"], loads=[{"unknown": "b.x", "value": "0.3 N"}],
    )  # fmt: skip
    solution = cq.run(scene)[-1]
    assert solution.at("b.ROTZ") == solution.at("b.UR3") == solution.at("b.theta") == pytest.approx(-0.075)
    assert solution.at("b.UX") == solution.at("b.x") == pytest.approx(0.1)
    with pytest.raises(cq.InvalidProblem, match=r"no unknown is called 'b\.ROTX'; nearest: b\.x"):
        solution.at("b.ROTX")
