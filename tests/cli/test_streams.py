"""Standard input, output and error: piped, closed by their other end, or never there."""

import io
import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from contactqp.cli import main
from tests.cli.commands import CASES, WALL, run


@pytest.mark.slow
def test_a_reader_that_leaves_early_is_no_error():
    files = " ".join(map(str, sorted(CASES.glob("b*.toml"))))
    command = f"{sys.executable} -m contactqp run {files} --jobs 2 | head -1"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, check=True)
    assert done.stdout.count("\n") == 1
    assert done.stderr == ""


@pytest.mark.slow
@pytest.mark.parametrize(("force", "code"), [(142.5, 0), (1.0, 1)])
def test_the_verdict_is_the_same_where_nobody_reads_it(tmp_path, force, code):
    candidate = tmp_path / "candidate.json"
    candidate.write_text(json.dumps({"displacement": [1e-3], "normal_force": [force]}))
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-m", "contactqp", "check", WALL, candidate], stdout=write, stderr=subprocess.PIPE, check=False
    )
    os.close(write)
    assert (done.returncode, done.stderr) == (code, b"")


def piped(monkeypatch, content):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(content)))


@pytest.mark.parametrize("command", ["run", "explain", "oracle"])
def test_a_case_comes_in_on_standard_input(capsys, monkeypatch, command):
    piped(monkeypatch, Path(WALL).read_bytes())
    code, out, err = run(capsys, command, "-")
    assert (code, err) == (0, "")
    assert "A bar and a rigid wall" in out


def test_an_answer_or_a_case_to_check_comes_in_on_standard_input(capsys, monkeypatch, tmp_path):
    _, answer, _ = run(capsys, "oracle", WALL, "--json")
    right = tmp_path / "right.json"
    right.write_text(json.dumps({"displacement": [1e-3], "normal_force": [142.5e3]}))
    assert "142.5" in answer
    piped(monkeypatch, Path(WALL).read_bytes())
    judged_as_case, _, _ = run(capsys, "check", "-", right)
    piped(monkeypatch, right.read_bytes())
    judged_as_answer, _, _ = run(capsys, "check", WALL, "-")
    direct, _, _ = run(capsys, "check", WALL, right)
    assert judged_as_case == judged_as_answer == direct
    piped(monkeypatch, json.dumps({"displacement": [1.0], "normal_force": [0.0]}).encode())
    assert run(capsys, "check", WALL, "-")[0] == 1


@pytest.mark.parametrize(
    ("arguments", "content", "words"),
    [
        (("run", "-"), b"x =", "standard input: expected TOML"),
        (("oracle", "-"), b"", "standard input: expected a scene, got an empty file"),
        (("explain", "-"), b"\xff", "standard input: expected text in UTF-8"),
        (("run", "-", "-"), b"", "standard input is read once"),
        (("check", "-", "-"), b"", "both standard input"),
    ],
)
def test_what_comes_in_wrong_on_standard_input_is_exit_2(capsys, monkeypatch, arguments, content, words):
    piped(monkeypatch, content)
    code, _, err = run(capsys, *arguments)
    assert code == 2
    assert words in err
    assert err.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize("arguments", ["run nowhere.toml --json", "methods --jsn --json"])
@pytest.mark.parametrize("reader", ["> /dev/full", "| true"])
def test_an_error_that_nobody_reads_leaves_no_traceback(arguments, reader):
    command = f"sleep 0.5; {sys.executable} -m contactqp {arguments}; echo code $? >&2"
    done = subprocess.run(["bash", "-c", f"({command}) {reader}"], capture_output=True, text=True, check=False)
    assert "code 2" in done.stderr
    assert "Traceback" not in done.stderr
    assert "Exception" not in done.stderr


@pytest.mark.parametrize("arguments", [("run", "-"), ("explain", "-"), ("oracle", "-")])
def test_a_standard_input_that_is_closed_is_said(
    arguments: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert capsys.readouterr().err.count("standard input: expected a case, and it is closed") == 1


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("closed", "arguments", "code", "said"),
    [
        (">&-", "run CASE --json", 2, "the standard output is closed"),
        ("2>&-", "run nowhere.toml", 2, ""),
        ("<&-", "run -", 2, "standard input: expected a case, and it is closed"),
        ("<&-", "check CASE -", 2, "standard input: expected an answer, and it is closed"),
    ],
)
def test_streams_that_are_closed_are_no_traceback(closed: str, arguments: str, code: int, said: str) -> None:
    words = arguments.replace("CASE", str(Path(__file__).parents[2] / "cases" / "bar_wall.toml"))
    done = subprocess.run(
        f"{sys.executable} -m contactqp {words} {closed}", shell=True, capture_output=True, text=True, check=False
    )
    assert done.returncode == code
    assert said in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_processes_side_by_side_have_ended_when_the_command_has(capsys: pytest.CaptureFixture[str]) -> None:
    """What the pool's own thread still closes while Python ends was a traceback now and then."""
    for _ in range(2):
        assert run(capsys, "run", CASES / "bar_wall.toml", CASES / "two_bars.toml", "--jobs", "2")[0] == 0
        assert not [thread.name for thread in threading.enumerate() if "Executor" in type(thread).__name__]


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are text there")
@pytest.mark.parametrize("command", ["report", "run", "explain", "init"])
def test_a_name_that_is_no_text_is_refused_in_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, command: str
) -> None:
    """Names are bytes: one of another encoding ended report and init in the midst of what they write."""
    monkeypatch.chdir(tmp_path)
    name = "Stoss\udcff.toml"
    if command != "init":
        Path(name).write_bytes(Path(WALL).read_bytes())
    code, _, err = run(capsys, command, name)
    assert code == 2
    assert len(err.splitlines()) == 1
    assert "udcff" in err
    assert [one.name for one in tmp_path.iterdir()] == ([] if command == "init" else [name])


def test_a_body_that_memory_does_not_hold_is_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def needs_more(*_: object, **__: object) -> None:
        raise MemoryError("Unable to allocate 2.26 GiB for an array")

    monkeypatch.setattr("contactqp.oracle.exact.exact.exact", needs_more)
    code, out, err = run(capsys, "oracle", WALL, "--json")
    said = "out of memory: Unable to allocate 2.26 GiB for an array; a coarser mesh takes less"
    assert (code, err) == (1, f"contactqp: {said}\n")
    assert json.loads(out) == {"error": said, "code": "memory", "exit": 1}
