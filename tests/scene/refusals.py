"""How a wrong case file must be refused: exit code 2, one line on stderr with the file and the words, no traceback."""

import pytest

from contactqp.cli import main


def complaint(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line on stderr of a command that must exit with 2."""
    with pytest.raises(SystemExit) as exit_:
        main(arguments)
    captured = capsys.readouterr()
    assert exit_.value.code == 2, captured.err
    assert captured.err.count("\n") == 1, captured.err
    assert "Traceback" not in captured.err + captured.out
    return captured.err


def mutated(text: str, old: str, new: str) -> str:
    """The text with its one place of `old` changed."""
    assert text.count(old) == 1, f"the mutation must change one place, and {old!r} is there {text.count(old)} times"
    return text.replace(old, new)


def refuse(capsys: pytest.CaptureFixture[str], file: str, words: str, command: str = "run") -> None:
    """The command must refuse the file in one line that names it and has these words."""
    message = complaint(capsys, command, file)
    assert file in message
    assert words in message


def accept(capsys: pytest.CaptureFixture[str], file: str, *command: str) -> None:
    """The command must exit with 0."""
    with pytest.raises(SystemExit) as exit_:
        main([*(command or ("run",)), file])
    assert exit_.value.code == 0, capsys.readouterr()
