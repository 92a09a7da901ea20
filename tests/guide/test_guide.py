"""What the pages of docs/guide show runs and says what they claim."""

from __future__ import annotations

import doctest
import pathlib
import re

import numpy as np
import pytest

import contactqp as cq
from contactqp.cli import main
from contactqp.scene.judging import Judgement, judge_all

GUIDE = pathlib.Path(__file__).parents[2] / "docs" / "guide"


def text_of(page: str) -> str:
    return (GUIDE / f"{page}.md").read_text(encoding="utf-8")


def block(page: str, language: str, place: int = 0) -> str:
    found = re.findall(rf"```{language}\n(.*?)```", text_of(page), re.DOTALL)
    return str(found[place])


def test_the_body_example_presses_a_block_on_a_paraboloid() -> None:
    scope: dict[str, object] = {}
    exec(compile(block("bodies", "python"), "bodies.md", "exec"), scope)
    solution, contact = scope["solution"], scope["contact"]
    assert isinstance(solution, cq.Solution)
    assert solution.certificate.passed
    assert solution.work.factorisations == 1
    pressure = scope["pressure"]
    assert isinstance(pressure, np.ndarray)
    assert pressure @ contact.area == pytest.approx(solution.normal_force.sum())  # type: ignore[attr-defined]
    assert 0.2 < np.mean(solution.normal_force > 0) < 0.9


def test_the_example_with_friction_slips_and_dissipates(capsys: pytest.CaptureFixture[str]) -> None:
    scope: dict[str, object] = {}
    exec(compile(block("friction", "python"), "friction.md", "exec"), scope)
    slipping, path = scope["slipping"], scope["path"]
    assert isinstance(slipping, cq.Solution)
    assert isinstance(path, cq.History)
    assert np.allclose(slipping.friction_force, [[0.18, 0.24]], rtol=1e-12)
    assert np.allclose(slipping.slip, [[0.06, 0.08]], rtol=1e-12)
    assert path.energies[-1].dissipated == pytest.approx(0.3 * 5 * 0.5, rel=1e-9)
    assert capsys.readouterr().out.splitlines()[0] == "[[0.18 0.24]] [[0.06 0.08]]"


def test_the_rod_of_the_example_bounces_and_every_scheme_leaves_the_energy_of_the_table() -> None:
    scope: dict[str, object] = {}
    exec(compile(block("impact", "python"), "impact.md", "exec"), scope)
    history = scope["history"]
    assert isinstance(history, cq.MotionHistory)
    assert [(event.kind, round(event.time, 2)) for event in history.events] == [("closed", 0.5), ("opened", 1.17)]
    assert history.normal_forces[300, 0] == pytest.approx(300, rel=1e-3)
    assert history.energies[0].total == pytest.approx(500)
    table = re.findall(r"^\| `([a-z-]+)` \| .* \| ([\d .]+) \|$", text_of("impact"), re.MULTILINE)
    assert len(table) == 6
    table.append(("newmark", "11 400"))  # what blows up is not known to more digits
    n = 100
    for scheme, energy in table:
        step = 0.1 / 30 / (2 if scheme == "modified-mass-central" else 1)
        moved = cq.impact(
            scope["rod"],  # type: ignore[arg-type]
            scope["middle"] / 2 * 0.1,  # type: ignore[operator]
            np.zeros(n + 1),
            np.full(n + 1, -10.0),
            2.0,
            step,
            scheme,
        )
        assert moved.energies[-1].total == pytest.approx(
            float(energy.replace(" ", "")), rel=0.01 if scheme == "newmark" else 1e-4
        ), scheme


def test_the_arch_of_the_example_snaps_onto_its_floor(capsys: pytest.CaptureFixture[str]) -> None:
    scope: dict[str, object] = {}
    exec(compile(block("large_deformation", "python"), "large_deformation.md", "exec"), scope)
    note, _, *limits = capsys.readouterr().out.splitlines()
    assert note.startswith("snap-through at load factor 0.290327: ")
    assert "unknown 1 jumps from -0.084" in note
    assert "to -0.3, " in note
    assert limits == ["maximum 0.290327 -0.0845", "minimum -0.290327 -0.3155"]
    last = scope["snapped"][-1]  # type: ignore[index]
    np.testing.assert_allclose(last.displacement, [0, -0.3], atol=1e-15)
    assert last.normal_force[0] == pytest.approx(1 + 100 / 1.04**1.5 * 0.003, rel=1e-12)
    assert round(last.normal_force[0], 5) == 1.28286


def test_the_example_of_a_large_deformation_meets_what_it_expects(tmp_path: pathlib.Path) -> None:
    case = tmp_path / "arch.toml"
    case.write_text(block("large_deformation", "toml"))
    (judgement,) = judge_all(cq.load_scene(case))
    assert len(judgement.expectations) == 2
    assert judgement.met


def test_the_example_of_a_body_meets_what_it_expects(tmp_path: pathlib.Path) -> None:
    case = tmp_path / "cylinder.toml"
    case.write_text(block("bodies", "toml"))
    (judgement,) = judge_all(cq.load_scene(case))
    assert len(judgement.expectations) == 1
    assert judgement.met


def test_the_example_of_files_writes_reads_and_judges(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(block("files", "python", 1), "files.md", "exec"), {})
    printed = capsys.readouterr().out
    assert "[[2.69230769 2.15384615]]" in printed
    assert "passed" in printed
    with pytest.raises(SystemExit) as exit_:
        main(["check", "sliding.hdf5", "flipped.npy"])
    assert exit_.value.code == 1
    assert "WRONG" in capsys.readouterr().out


def test_the_example_with_friction_prints_what_is_shown(
    tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Line by line, but for the blank ones and the rules of the tables."""
    monkeypatch.setenv("COLUMNS", "120")
    case = tmp_path / "pad.toml"
    case.write_text(block("friction", "toml"))
    with pytest.raises(SystemExit) as exit_:
        main(["run", str(case)])
    assert exit_.value.code == 0
    printed = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    shown = text_of("friction").split("and exits with 0:")[1].split("```")[1].strip("\n").splitlines()
    assert shown == [line for line in printed if line and set(line.strip()) != {"─"}]


def test_the_example_of_a_motion_meets_what_it_expects(tmp_path: pathlib.Path) -> None:
    case = tmp_path / "rod.toml"
    case.write_text(block("impact", "toml"))
    (judgement,) = judge_all(cq.load_scene(case))
    assert len(judgement.expectations) == 2
    assert judgement.met
    assert isinstance(judgement, Judgement)
    times = {event.kind: event.time for event in judgement.history.events}
    assert times == pytest.approx({"closed": 1e-4, "opened": 1.8e-4}, abs=2e-6)


def test_the_example_of_somebody_elses_answer_is_what_it_shows() -> None:
    test = doctest.DocTestParser().get_doctest(block("judging", "pycon"), {}, "judging", "judging.md", 0)
    assert len(test.examples) >= 8
    failed = doctest.DocTestRunner(verbose=False).run(test)
    assert failed.failed == 0


def test_a_folder_of_matrices_is_solved_and_judged_as_the_example_says(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(block("files", "python", 0), "files.md", "exec"), {})
    assert capsys.readouterr().out == "[221.25]\n"
    options = ["--compression", "negative", "--pressure-areas", "areas.csv"]
    for arguments, code, words in (
        (options, 0, "right (tolerance"),
        (options[2:], 1, "all contact forces have the opposite sign"),
        (options[:2], 2, "--pressure-areas, which make it a force"),
    ):
        for problem in ("bar", "bar-out"):
            with pytest.raises(SystemExit) as ended:
                main(["check", problem, "theirs.csv", *arguments])
            assert ended.value.code == code
            told = capsys.readouterr()
            assert words in told.out + told.err
