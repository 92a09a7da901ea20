"""A command of `contactqp` in this process, and the case that most tests run."""

from pathlib import Path

import pytest

from contactqp.cli import main

CASES = Path(__file__).parents[2] / "cases"
WALL = str(CASES / "bar_wall.toml")


def run(capsys, *arguments):
    """The exit code, and what was printed on standard output and error; no traceback."""
    with pytest.raises(SystemExit) as exit_:
        main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err
    return exit_.value.code, captured.out, captured.err
