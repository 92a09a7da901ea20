"""What the README shows runs and says what it claims."""

from __future__ import annotations

import doctest
import json
import pathlib
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.cli import main
from contactqp.study.reporting import write_report
from contactqp.study.running.runner import Running

ROOT = pathlib.Path(__file__).parent.parent.parent
README = (ROOT / "README.md").read_text()


def _block(language: str) -> str:
    (found,) = re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)
    return str(found)


def _blocks(language: str) -> list[str]:
    return [str(found) for found in re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)]


def test_the_first_lines_of_python_print_what_stands_below_them(capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(_blocks("python")[0], "README.md", "exec"), {})
    assert capsys.readouterr().out == _block("text")


def test_the_python_examples_print_what_their_comments_say(capsys: pytest.CaptureFixture[str]) -> None:
    scope: dict[str, object] = {}
    for block in _blocks("python"):
        exec(compile(block, "README.md", "exec"), scope)
    printed = capsys.readouterr().out
    assert "contact 0  closed" in printed
    assert "kN" in printed
    said = re.findall(r"# prints ([\d.]+)|# closes at ([\d.]+)", "".join(_blocks("python")))
    assert len(said) == 3
    assert [text for pair in said for text in pair if text and text not in printed] == []
    soft = scope["soft"]
    assert isinstance(soft, cq.Solution)
    assert soft.certificate.force_error == pytest.approx(0.071, abs=5e-4)


def test_the_case_example_is_a_scene(tmp_path: pathlib.Path) -> None:
    case = tmp_path / "bar.toml"
    case.write_text(_block("toml"))
    assert cq.run(cq.load_scene(case))[-1].normal_force == pytest.approx([142.5], rel=1e-12)


def test_the_example_of_somebody_elses_answer_is_what_it_shows() -> None:
    test = doctest.DocTestParser().get_doctest(_block("pycon"), {}, "README", "README.md", 0)
    assert len(test.examples) >= 3
    assert doctest.DocTestRunner(verbose=False).run(test).failed == 0


def test_its_links_lead_somewhere() -> None:
    links = re.findall(r"\]\(([^)#]+)\)", README)
    assert len(links) >= 10
    assert [link for link in links if not (pathlib.Path(__file__).parent.parent.parent / link).is_file()] == []


def test_the_method_table_names_methods_that_exist() -> None:
    names = {method.name for method in cq.methods()}
    table = README.split("## Methods")[1].split("## Command line")[0]
    rows = [line.split("|")[1] for line in table.splitlines() if line.startswith("| `")]
    named = {name for row in rows for name in re.findall(r"`([a-z-]+)`", row)}
    assert len(named) >= 15
    assert named <= names


def _results() -> set[str]:
    """The numbers that the README says come out: in comments of its example, and as a right answer of another code."""
    said = re.findall(r"# \[?(\d+\.\d+)", _blocks("python")[1]) + re.findall(r"^\[(\d+\.\d+)\]", _block("text"))
    return {*said, *re.findall(r"normal_force=\[-(\d+\.\d+)\]", _block("pycon"))}


def _numbers(data: Any) -> Iterator[float]:
    """All that are in a document of JSON."""
    if isinstance(data, dict | list):
        for part in data.values() if isinstance(data, dict) else data:
            yield from _numbers(part)
    elif isinstance(data, float):
        yield data


@pytest.mark.slow
def test_its_numbers_are_those_of_a_report(tmp_path: pathlib.Path) -> None:
    """Rounded to the digits that it prints: forces are what cases expect and get, errors stand in the rows."""
    cases = [ROOT / "cases" / f"{name}.toml" for name in ("truss_floor_printed", "bar_wall")]
    write_report(cases, tmp_path, methods=["active-set", "penalty"], repeats=1, running=Running(jobs=0))
    report = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    known = list(_numbers([[case["judgements"] for case in report["cases"]], report["rows"]]))

    def found(text: str) -> bool:
        digits = len(text.partition(".")[2])
        return any(f"{value:.{digits}f}" == text for value in known)

    assert _results() == {"30.25499284", "0.071", "142.5"}
    assert [text for text in _results() if not found(text)] == []
    assert not found("30.25499285")
    truss = [row for row in report["rows"] if row["case"] == "truss_floor_printed" and row["method"] == "penalty"]
    (soft,) = (row for row in truss if row["knob_value"] == 1e6)
    assert f"{soft['error_force']:.3f}" == "0.071"


@pytest.mark.slow
def test_its_picture_is_what_its_command_draws(tmp_path: pathlib.Path) -> None:
    image = pytest.importorskip("PIL.Image")
    (command,) = re.findall(r"`contactqp (run cattaneo\w+) --plot partial_slip\.png`", README)
    drawn = tmp_path / "partial_slip.png"
    with pytest.raises(SystemExit) as ended:
        main([*command.split(), "--plot", str(drawn)])
    assert ended.value.code == 0
    shown = image.open(ROOT / "docs" / "static" / "partial_slip.png").convert("RGB")
    new = np.asarray(image.open(drawn).convert("RGB").resize(shown.size), dtype=float)
    assert np.mean(abs(new - np.asarray(shown, dtype=float))) < 5  # of 255: letters and lines may be other pixels
