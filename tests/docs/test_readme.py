"""What the README shows runs and says what it claims."""

from __future__ import annotations

import doctest
import json
import pathlib
import re
import tomllib
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.cli import command, main
from contactqp.oracle.pytest_plugin import ContactOracle
from contactqp.study.reporting import write_report
from contactqp.study.running.runner import Running

ROOT = pathlib.Path(__file__).parent.parent.parent
README = (ROOT / "README.md").read_text()


def _block(language: str) -> str:
    (found,) = _blocks(language)
    return found


def _blocks(language: str) -> list[str]:
    return [str(found) for found in re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)]


def _printed() -> str:
    """What stands below the first lines of Python."""
    return _blocks("text")[0]


def test_what_it_takes_is_what_the_package_states() -> None:
    """The version of Python, and that no index has it: every line of pip installs from the folder."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    (stated,) = re.findall(r"It takes Python (\d+\.\d+) or later", README)
    assert project["requires-python"] == f">={stated}"
    installed = re.findall(r"pip install (?:--editable )?'?([^\s'`]+)", README)
    assert installed == [".[backends,report,exact,solids]", ".[test]", "numpy<2"]
    assert "pip install contactqp" not in README


def test_both_lines_of_the_shell_say_what_they_are_for() -> None:
    """Each block of one line has a caption of its own before it."""
    assert re.findall(r"^(To install[^\n]*):\n\n```sh$", README, re.MULTILINE) == [
        "To install it and run its main job, a report on methods",
        "To install what the tests need, and run them",
    ]
    assert [len(block.splitlines()) for block in _blocks("sh")] == [1, 1]


def test_the_counts_of_wrong_answers_are_those_of_the_benchmarks() -> None:
    (counts,) = re.findall(
        r"in none of the (\d+ \d+) solves of (\d+) problems by all methods.*?in none of (\d+) problems",
        README,
        re.DOTALL,
    )
    solves, problems, with_friction = counts
    measured = re.sub(r"\s+", " ", (ROOT / "benchmarks" / "README.md").read_text())
    assert re.search(rf"{problems} problems, {solves} solves, [^;]*; wrong but passed 0,", measured)
    assert re.search(rf"The table is of `--problems {with_friction}`[^:]*, exit code 0: nothing wrong", measured)


def test_the_table_of_commands_is_complete() -> None:
    named = set(re.findall(r"`contactqp ([a-z]+)", README.split("## Command line")[1].split("## Case files")[0]))
    assert named == set(command.commands)


def test_the_files_that_check_reads_are_these(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Columns of the block are files, their first line the names; another force is refused."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bar").mkdir()
    table = [re.split(r" {2,}", line) for line in _blocks("text")[1].splitlines()]
    files = {name: "\n".join(lines) + "\n" for name, *lines in zip(*table, strict=True)}
    assert len(files) == 4
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    assert "PROBLEM is the folder `bar`, and `theirs.csv` is right" in README
    for text, code in ((files["theirs.csv"], 0), (files["theirs.csv"].replace("142.5", "142.6"), 1)):
        (tmp_path / "theirs.csv").write_text(text)
        with pytest.raises(SystemExit) as ended:
            main(["check", "bar", "theirs.csv"])
        assert ended.value.code == code


def test_the_test_of_multipliers_passes_and_fails() -> None:
    (block,) = (block for block in _blocks("python") if "contact_oracle" in block)
    assert len(block.splitlines()) <= 6

    def run(my_code: Callable[[cq.ContactProblem], Any]) -> None:
        scope: dict[str, Any] = {"my_code": my_code}
        exec(compile(block, "README.md", "exec"), scope)
        scope["test_the_multiplier_of_the_wall"](ContactOracle())

    run(lambda problem: cq.solve(problem, "lemke").normal_force)
    with pytest.raises(AssertionError, match="opposite sign"):
        run(lambda problem: -cq.solve(problem, "lemke").normal_force)


def test_associated_friction_is_refused_as_coulombs() -> None:
    """It lifts what slides, and passes only as the law that it is."""
    sliding = cq.ContactProblem(np.eye(2), [3.0, -1.0], [[0.0, -1.0]], [0.0], tangent=[[1.0, 0.0]], friction=0.5)
    lifted = cq.solve(sliding, algorithm="associated")
    assert lifted.gap[0] > 0.1
    assert not cq.certify(sliding, lifted.displacement, lifted.normal_force, lifted.friction_force)


def test_the_first_lines_of_python_print_what_stands_below_them(capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(_blocks("python")[0], "README.md", "exec"), {})
    assert capsys.readouterr().out == _printed()


def test_the_python_examples_print_what_their_comments_say(capsys: pytest.CaptureFixture[str]) -> None:
    scope: dict[str, object] = {}
    for block in _blocks("python"):
        exec(compile(block, "README.md", "exec"), scope)
    printed = capsys.readouterr().out
    assert "contact 0  closed" in printed
    assert "kN" in printed
    said = re.findall(r"# prints ([^\n:;]+)|# closes at ([\d.]+)", "".join(_blocks("python")))
    assert len(said) == 4
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
    said = re.findall(r"# \[?(\d+\.\d+)", _blocks("python")[1]) + re.findall(r"^\[(\d+\.\d+)\]", _printed())
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
    (drawing,) = re.findall(r"`contactqp (run cattaneo\w+) --plot partial_slip\.png`", README)
    drawn = tmp_path / "partial_slip.png"
    with pytest.raises(SystemExit) as ended:
        main([*drawing.split(), "--plot", str(drawn)])
    assert ended.value.code == 0
    shown = image.open(ROOT / "docs" / "static" / "partial_slip.png").convert("RGB")
    new = np.asarray(image.open(drawn).convert("RGB").resize(shown.size), dtype=float)
    assert np.mean(abs(new - np.asarray(shown, dtype=float))) < 5  # of 255: letters and lines may be other pixels
