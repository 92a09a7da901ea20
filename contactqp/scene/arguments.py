"""What stands on a command line, read: case files, and the knobs of a method."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from contactqp.errors import SceneError
from contactqp.scene.expression import NotANumber
from contactqp.scene.judging import Knob
from contactqp.scene.units import KINDS, read_quantity


def are_case_files(arguments: Iterable[str]) -> bool:
    """Whether all that is named is case files by their suffix."""
    return all(Path(argument).suffix.lower() == ".toml" and not Path(argument).is_dir() for argument in arguments)


def case_files(arguments: Iterable[str]) -> list[str]:
    """The files that are named, and all case files of the folders that are."""
    files: list[str] = []
    for argument in arguments:
        if not Path(argument).is_dir():
            files.append(argument)
            continue
        found = sorted(str(file) for file in Path(argument).glob("*.toml"))
        if not found:
            raise SceneError(f"{argument}: expected case files (*.toml) in this folder, got none")
        files += found
    return files


def read_knobs(penalty: str | None, perturbation: str | None, options: Iterable[str]) -> dict[str, Knob]:
    """Stiffnesses with their units, and any other ``key=value``."""
    knobs: dict[str, Knob] = {}
    for name, text in (("penalty", penalty), ("perturbation", perturbation)):
        if text is not None:
            try:
                knobs[name] = read_quantity(text, [KINDS["stiffness"]])
            except NotANumber as error:
                raise SceneError(f"--{name}: {error}") from None
    for option in options:
        name, sign, text = option.partition("=")
        if not sign or not name:
            raise SceneError(f"--option: expected key=value, got {option!r}")
        if name in ("penalty", "perturbation"):
            raise SceneError(f"--option: expected --{name} with its unit, got {option!r}")
        knobs[name] = _value(text)
    return knobs


def _value(text: str) -> Knob:
    """A truth value, a whole number, a number or a word."""
    if text in ("true", "false"):
        return text == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
