"""Files that are written whole or not at all, and what must be there before anything is solved for them."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable
from pathlib import Path

from contactqp.errors import BackendMissing, InvalidProblem

PICTURES = (".png", ".pdf", ".svg")
VTU = (".vtu",)


def check_file(file: str | Path, suffixes: tuple[str, ...]) -> Path:
    """The file as a path.

    Raises
    ------
    InvalidProblem
        Another suffix, a folder that is not there, a folder in the place of the file.
    """
    path = Path(file)
    if path.suffix.lower() not in suffixes:
        raise InvalidProblem(f"{path}: expected a file name that ends in {' or '.join(suffixes)}")
    if path.is_dir():
        raise InvalidProblem(f"{path}: expected a file, this is a folder")
    if not path.parent.is_dir():
        raise InvalidProblem(f"{path}: there is no folder {str(path.parent)!r}")
    return path


def check_installed(package: str, purpose: str) -> None:
    """Refuse where the package is missing; it is not imported to find out.

    Raises
    ------
    BackendMissing
    """
    if importlib.util.find_spec(package) is None:
        raise BackendMissing(f"{purpose} needs {package}: pip install {package}")


def write_whole(file: Path, write: Callable[[Path], None], *, durable: bool = False) -> None:
    """Let `write` fill a file beside this one with the same suffix, then put it in place.

    Parameters
    ----------
    durable : bool
        It is on the disk before this returns: a machine that dies afterwards does not lose it.

    Raises
    ------
    InvalidProblem
        The file system refuses.
    """
    beside = file.with_name(f".{file.stem}.{os.getpid()}{file.suffix}")
    try:
        write(beside)
        if durable:
            _onto_disk(beside)
        os.replace(beside, file)
        if durable:
            _onto_disk(file.parent)
    except OSError as error:
        raise InvalidProblem(f"{file}: cannot be written ({error.strerror or error})") from error
    finally:
        beside.unlink(missing_ok=True)


def _onto_disk(path: Path) -> None:
    """Have what is in memory of a file or a folder written."""
    place = os.open(path, os.O_RDONLY)
    try:
        os.fsync(place)
    finally:
        os.close(place)
