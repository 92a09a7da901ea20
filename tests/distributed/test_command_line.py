"""`contactqp run --engine petsc` on several ranks: the answers of one process, said once."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from contactqp.cli import main
from tests.distributed.cases import path_case

CASES = Path(__file__).parents[2] / "cases"
PARTS = ("displacement", "normal_force", "gap")


def run(python_on_ranks, count, *arguments):
    return python_on_ranks(count, "-m", "contactqp", "run", *arguments, "--engine", "petsc")


def in_one_process(capsys, case) -> dict:
    with pytest.raises(SystemExit) as end:
        main(["run", str(case), "--method", "active-set", "--json"])
    assert end.value.code == 0
    (outcome,) = json.loads(capsys.readouterr().out)
    return outcome


@pytest.mark.parametrize(
    ("cases", "count"),
    [
        (("bar_wall",), 2),
        pytest.param(("bar_wall", "hertz_line"), 2, marks=pytest.mark.slow),
        pytest.param(("tie_symmetry",), 3, marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_the_answer_is_that_of_one_process(python_on_ranks, capsys, cases, count):
    files = [CASES / f"{case}.toml" for case in cases]
    done = run(python_on_ranks, count, *files, "--json")
    assert done.code == 0, done.err
    for found, file in zip(json.loads(done.out), files, strict=True):
        is_that_of_one_process(found, in_one_process(capsys, file))


def is_that_of_one_process(found: dict, wanted: dict) -> None:
    assert found["engine"] == "petsc"
    assert found["certificate"]["passed"]
    assert found["certificate"]["failures"] == wanted["certificate"]["failures"] == []
    assert len(wanted["displacement"]) > 0
    assert len(wanted["expectations"]) > 0
    for part in PARTS:
        values, others = (np.array(list(outcome[part].values())) for outcome in (found, wanted))
        assert np.abs(values - others).max(initial=0) <= 1e-9 * np.abs(others).max(initial=1e-300)
    keys = ("quantity", "ok")
    assert [[row[key] for key in keys] for row in found["expectations"]] == [
        [row[key] for key in keys] for row in wanted["expectations"]
    ]


@pytest.mark.slow
def test_tables_and_files_are_written_once(python_on_ranks, tmp_path):
    case = path_case(tmp_path)
    done = run(python_on_ranks, 2, case, "--plot", tmp_path / "p.png")
    assert done.code == 0, done.err
    assert done.out.count("Two bars in a row, active-set engine=petsc: certificate passed") == 1
    assert done.out.count("closed   stop") == 1  # in the table of events
    assert done.out.count("written: ") == 2
    assert sorted(file.name for file in tmp_path.iterdir()) == ["p.history.png", "p.png", "path.toml"]


@pytest.mark.slow
def test_bodies_in_pieces_are_drawn_and_written(python_on_ranks, tmp_path):
    """Their pictures ask for more than their tables: with a path, for its loads and energies too."""
    text = (CASES / "hertz_line.toml").read_text().partition("[[expect]]")[0]
    case = tmp_path / "hertz_path.toml"
    case.write_text(text.replace("\naxes", "\npath = { steps = 2 }\naxes", 1))
    assert "path" in case.read_text()
    done = run(python_on_ranks, 2, case, "--plot", tmp_path / "p.png", "--vtu", tmp_path / "v.vtu")
    assert done.code == 0, done.err
    assert sorted(file.name for file in tmp_path.iterdir()) == ["hertz_path.toml", "p.history.png", "p.png", "v.vtu"]


@pytest.mark.slow
def test_what_is_not_offered_there_is_refused_in_one_line(commands):
    asked = {
        ("bar_bounces.toml",): "engine 'petsc': a motion",
        ("von_mises_truss.toml",): "engine 'petsc': large deformations",
        ("truss_floor.toml",): "engine 'petsc': exact events of a load path; state its steps alone",
        ("bar_wall.toml", "--method", "clarabel"): "clarabel",
        ("bar_wall.toml", "--units", "mm,N"): "--units: in one process alone",
        ("bar_wall.toml", "--option", "condense=false"): "engine 'petsc': condense is an option of one process",
    }
    found = commands(*(["run", CASES / name, *rest, "--engine", "petsc"] for name, *rest in asked))
    for (code, out, err), said in zip(found, asked.values(), strict=True):
        assert (code, out) == (2, "")
        (line,) = err.strip().splitlines()
        assert said in line


@pytest.mark.slow
def test_an_expectation_that_is_not_met_is_the_exit_code_of_all_ranks(python_on_ranks, tmp_path):
    case = tmp_path / "wrong.toml"
    case.write_text((CASES / "bar_wall.toml").read_text().replace('"285/2 kN"', '"143 kN"'))
    assert "143 kN" in case.read_text()
    done = run(python_on_ranks, 2, case)
    assert done.code == 1
    assert done.said == []
    assert done.out.count("NOT MET") == 1
