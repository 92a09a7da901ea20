"""The adversary finds nothing in a few trials, and each planted fault within two minutes (slow)."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import contactqp as cq

pytest.importorskip("flint")

from benchmarks.adversary.__main__ import main
from benchmarks.adversary.faults import FAULTS, SEEN_AS
from benchmarks.adversary.files import _ended, _judge_command, _mutated
from benchmarks.adversary.grammar import BODIES, CONTACTS, HELD, LOADS, REPEATS, SIZES, draw
from benchmarks.adversary.judging import Finding, Judge
from benchmarks.adversary.shrinking import shrunk
from benchmarks.adversary.trials import ASIDE, KINDS, _aside, files, trial, write_smallest
from benchmarks.friction_families import Posed


@pytest.mark.slow
def test_trials_are_the_same_for_the_same_seed() -> None:
    assert trial(11, 3, ("frictionless",)) == trial(11, 3, ("frictionless",))


@pytest.mark.slow
def test_every_word_is_spoken() -> None:
    spoken: set[str] = set()
    for number in range(400):
        sentence = draw(np.random.default_rng([0, number]), ("frictionless", "plane", "space")[number % 3])
        spoken |= set(sentence.words)
        assert sentence.posed.problem.contacts == sentence.posed.plain.contacts
    assert spoken >= {*BODIES, *HELD, *CONTACTS, *LOADS, *REPEATS, *SIZES}


# Trials that found something once: a diagonal below the normal floats, of which scales overflowed; a compliance whose
# inverse did; forces and slips whose ratio did.
@pytest.mark.parametrize(
    ("seed", "number"),
    [(9001, 14110), *(pytest.param(*one, marks=pytest.mark.slow) for one in ((777, 1023), (9003, 1651)))],
)
def test_wild_trials_that_found_something_find_nothing(seed: int, number: int) -> None:
    done = trial(seed, number, ("wild",))
    assert done.judgements >= 5
    assert done.findings == ()


# And of all kinds: ties that depend on each other and share forces of 1e9; digits of forces that are not unique, and of
# a displacement of zero; a bound below the error of a force that nothing stiff meets; a wrong answer 1e15 away, whose
# rounding hid its strain; lengths that are rounding where K is zero; noise that was forged.
@pytest.mark.slow
@pytest.mark.parametrize("number", [3963, 4130, 8283, 12368, 14346, 15104, 17691])
def test_trials_that_found_something_find_nothing(number: int) -> None:
    done = trial(97367752, number)
    assert done.judgements >= 5
    assert done.findings == ()


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_few_trials_find_nothing(kind: str) -> None:
    done = [trial(0, number, (kind,)) for number in range(6)]
    assert [finding for one in done for finding in one.findings] == []
    assert sum(one.judgements for one in done) >= 20
    if kind == "frictionless":
        assert sum(one.exact for one in done) == 6


@pytest.mark.slow
def test_the_commands_that_read_mutated_files_work_as_they_stand() -> None:
    """A command that is refused anyhow looks at no file; what it says of another one is then nothing."""
    asked = files().asked
    assert asked
    for file, command in asked:
        code, out, err = _ended(command, b"")
        assert code == 0, (file, err)
        assert out


@pytest.mark.slow
def test_archives_of_quadratic_programs_get_other_arrays(tmp_path: Path) -> None:
    file, read = tmp_path / "program.npz", []
    np.savez(file, P=np.eye(2), q=np.array([1.0, 2.0]))
    for seed in range(60):
        changed, what = _mutated(file, file.read_bytes(), np.random.default_rng(seed))
        if what.startswith(("P: ", "q: ")):
            (tmp_path / "changed.npz").write_bytes(changed)
            with np.load(tmp_path / "changed.npz") as arrays:  # which is whole
                same = all(
                    name in arrays and arrays[name].dtype == one.dtype and np.array_equal(arrays[name], one)
                    for name, one in np.load(file).items()
                )
            read.append(same)
    assert len(read) > 15
    assert np.mean(read) < 0.3


@pytest.mark.slow
@pytest.mark.parametrize(("fault", "kind"), [("bound", "bound"), ("sign", "forgery")])
def test_faults_show_in_large_bodies_whose_answer_is_chosen(fault: str, kind: str) -> None:
    sound = [trial(3, number, ("large",)) for number in range(3)]
    assert [finding for one in sound for finding in one.findings] == []
    with FAULTS[fault]():
        found = [finding for number in range(3) for finding in trial(3, number, ("large",)).findings]
    assert kind in {finding.kind for finding in found}


def test_every_fault_has_its_place() -> None:
    """Of each but "none" it is known as what it must be found."""
    assert FAULTS.keys() - SEEN_AS.keys() == {"none"}


def test_an_error_of_several_lines_is_a_finding() -> None:
    judge = Judge(None, 0)  # type: ignore[arg-type]  # there is no problem with a truth
    _judge_command(judge, ["run", "nowhere.toml"], "as it stands", b"")
    assert judge.findings == []
    with FAULTS["lines"]():
        _judge_command(judge, ["run", "nowhere.toml"], "as it stands", b"")
    assert [one.kind for one in judge.findings] == ["printed"]


def test_problems_shrink_to_what_shows_a_finding() -> None:
    rng = np.random.default_rng(5)
    posed = next(
        p for p in (draw(rng, "frictionless").posed for _ in range(50)) if p.plain.contacts > 2 and p.plain.ties
    )

    def pressed(tried: Posed) -> bool:
        return bool(np.any(tried.plain.load)) and tried.plain.contacts >= 1

    smallest = shrunk(posed, pressed)
    assert (smallest.plain.contacts, smallest.plain.ties, smallest.plain.dimension) == (1, 0, 1)


@pytest.mark.slow
def test_units_show_at_one_in_four_of_the_problems_that_float(tmp_path: Path) -> None:
    """Among all problems of the grammar one in fifty shows them, which two minutes of a shared core may not reach."""

    def shows(number: int) -> bool:
        sentence, ask = _aside(7, number)
        judge = Judge(sentence.posed, number)
        ask(judge)
        return "units" in {one.kind for one in judge.findings}

    assert not any(map(shows, range(24)))
    with FAULTS["units"]():
        found = [number for number in range(24) if shows(number)]
        assert len(found) >= 6
        (finding,) = (one for one in trial(7, found[0], ("frictionless",)).findings if one.what.startswith(ASIDE))
        folder = write_smallest(7, found[0], ("frictionless",), finding, tmp_path)
    assert cq.read_problem(folder).dimension <= _aside(7, found[0])[0].posed.problem.dimension


@pytest.mark.slow
def test_a_finding_is_written_with_the_command_that_shows_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with FAULTS["bound"]():
        number = next(n for n in range(20) if trial(0, n, tuple(KINDS)).kind == "frictionless" and trial(0, n).findings)
        finding = trial(0, number).findings[0]
        folder = write_smallest(0, number, tuple(KINDS), finding, tmp_path)
    assert finding.kind == "bound"
    text = (folder / "finding.txt").read_text()
    assert f"python -m benchmarks.adversary --seed 0 --trial {number}" in text
    assert cq.read_problem(folder).dimension <= 3
    assert main(["--seed", "0", "--trial", str(number)]) == 0  # without the fault
    assert main(["--seed", "0", "--trial", str(number), "--plant", "bound"]) == 1
    assert "bound: " in capsys.readouterr().out


def test_of_what_hangs_and_of_wild_numbers_the_command_is_written(tmp_path: Path) -> None:
    wild = next(n for n in range(40) if trial(0, n, ("wild",)).kind == "wild")
    for number, kinds, finding in (
        (wild, ("wild",), Finding("crashed", "solve", "ValueError")),
        (0, ("frictionless",), Finding("hang", "process", "ended with -9")),
    ):
        folder = write_smallest(0, number, kinds, finding, tmp_path)
        text = (folder / "finding.txt").read_text()
        assert text.endswith(f"python -m benchmarks.adversary --seed 0 --trial {number} --kind {kinds[0]}\n")


@pytest.mark.slow
def test_problems_without_friction_may_have_tangents() -> None:
    sentences = [draw(np.random.default_rng(seed), "frictionless") for seed in range(80)]
    assert any(one.posed.plain.tangent is not None and not one.posed.plain.frictional for one in sentences)


def test_findings_are_equal_by_what_they_say() -> None:
    finding = Finding("wrong", "solve", "off")
    assert replace(finding, text="on") != finding
    assert json.loads(json.dumps(finding.__dict__)) == finding.__dict__


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_can_be_planted(fault: str) -> None:
    """What it replaces is there: `patch` raises AttributeError where a name has gone, and the process of such a fault
    would end without a trial."""
    with FAULTS[fault]():
        pass


def test_processes_that_end_before_their_first_trial_are_a_finding(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "executable", shutil.which("false"))
    assert main(["--minutes", "0.5", "--jobs", "1"]) == 1
    assert "the process ended with 1 before its first trial" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("fault", [name for name in FAULTS if name != "none"])
def test_a_planted_fault_is_found_within_two_minutes(fault: str, pytestconfig: pytest.Config) -> None:
    """The seed is that of Hypothesis where one is given, as by `.ci/run`: what failed there can be repeated."""
    command = [sys.executable, "-m", "benchmarks.adversary", "--minutes", "2", "--plant", fault]
    seed = pytestconfig.getoption("hypothesis_seed", None)
    command += [] if seed is None else ["--seed", str(seed)]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", errors="replace", check=False, timeout=240)
    kinds = {line.split(":")[0] for line in done.stdout.splitlines()}
    assert done.returncode == 1, done.stdout + done.stderr
    assert kinds & SEEN_AS[fault], done.stdout
