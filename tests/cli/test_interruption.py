"""Ctrl-C: exit code 130, one line, no traceback, and no file that is half written."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from contactqp.cli import main
from contactqp.errors import BackendMissing
from tests.cli.commands import CASES, WALL


def interrupt(*_, **__):
    """What Ctrl-C does, in the middle of whatever calls this."""
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(5)
    raise AssertionError("nothing was interrupted")


def stopped(capsys, *arguments):
    with pytest.raises(SystemExit) as exit_:
        main(arguments)
    said = capsys.readouterr().err
    assert exit_.value.code == 130
    assert said.strip() == "contactqp: interrupted"


@pytest.mark.parametrize(
    ("place", "arguments"),
    [
        ("contactqp.scene.scene.Scene", ["run", WALL]),
        ("contactqp.linalg.condensation.eliminate", ["run", WALL]),
        ("contactqp.solving.runs.certificate_of", ["run", WALL, "--json"]),
        ("contactqp.study.footprint.subprocess.run", ["explain", WALL]),
        ("contactqp.linalg.condensation.eliminate", ["oracle", WALL]),
        ("contactqp.study.checking.check_case", ["check", WALL, "x.json"]),
    ],
    ids=["read", "run", "certify", "explain", "oracle", "check"],
)
def test_ctrl_c_is_one_line(place, arguments, monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(place, interrupt)
    stopped(capsys, *arguments)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("code", [0, 1, 130, 143])
def test_a_report_that_was_stopped_begins_no_study_of_stability(code, monkeypatch):
    begun = []
    monkeypatch.setattr("contactqp.study.reporting.report", lambda *_: code)
    monkeypatch.setattr(
        "contactqp.study.stability.stability_report.report_stability", lambda *_: begun.append("study") or 0
    )
    with pytest.raises(SystemExit) as exit_:
        main(["report", "--stability", WALL])
    assert exit_.value.code == code
    assert begun == ["study"] * (code < 128)  # what is wrong is no reason to stop


@pytest.mark.slow
def test_ctrl_c_while_a_picture_is_written_leaves_nothing(monkeypatch, capsys, tmp_path):
    def half(_, file, **__):
        Path(file).write_bytes(b"\x89PNG half a pict")
        interrupt()

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", half)
    old = tmp_path / "bar.png"
    old.write_bytes(b"the picture of the last time")
    stopped(capsys, "run", WALL, "--plot", str(old))
    assert list(tmp_path.iterdir()) == [old]
    assert old.read_bytes() == b"the picture of the last time"


def test_ctrl_c_where_python_lets_nothing_through_comes_again(monkeypatch, capsys):
    class Careless:
        def __del__(self):
            raise KeyboardInterrupt

    def load(_):
        careless = Careless()
        del careless
        for _ in range(500):
            time.sleep(0.01)
        raise AssertionError("nothing was interrupted")

    monkeypatch.setattr(sys, "unraisablehook", sys.__unraisablehook__)
    monkeypatch.setattr("contactqp.scene.scene.load_scene", load)
    stopped(capsys, "run", WALL)


@pytest.mark.parametrize("error", [ImportError("numpy"), SystemError("no result"), BackendMissing("pyamg")])
def test_ctrl_c_that_another_error_hides_is_an_interruption(error, monkeypatch, capsys):
    def load(_):
        try:
            interrupt()
        except KeyboardInterrupt:
            raise error  # noqa: B904 - as a compiled module may, whose import was interrupted

    monkeypatch.setattr("contactqp.scene.scene.load_scene", load)
    stopped(capsys, "run", WALL)


@pytest.mark.skipif(sys.platform == "win32", reason="signals of another process")
def test_a_process_that_is_interrupted_says_so_and_goes(tmp_path):
    """A motion of a few seconds, stopped in its imports or its steps."""
    begin = "import sys\nfrom contactqp.cli import main\nprint('here', flush=True)\nmain(sys.argv[1:])"
    command = [sys.executable, "-c", begin, "run", str(CASES / "bar_bounces.toml"), "--plot", "bar.png"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path) as process:
        assert process.stdout.readline() == "here\n"
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert said.removeprefix("\n") == "contactqp: interrupted\n"  # behind the ^C of a terminal, as a rule
    assert list(tmp_path.iterdir()) == []
