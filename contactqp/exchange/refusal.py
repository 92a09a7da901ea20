"""What is said of a file that is not what it should be: the file, the place in it, what was expected, what came."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem, Unsupported

Path = str | os.PathLike[str]


def wrong(path: Path, place: str, expected: str, got: Any) -> InvalidProblem:
    return InvalidProblem(f"{path}: {place}: expected {expected}, got {got}")


def check_dimension(path: Path, place: str, dimension: int) -> int:
    """2 or 3.

    Raises
    ------
    Unsupported
        5, which says that the contacts resist rolling too.
    InvalidProblem
        Anything else.
    """
    if dimension == 5:
        raise Unsupported(
            f"{path}: {place} is 5: contacts that resist rolling are not supported, only sliding (2 or 3)"
        )
    if dimension not in (2, 3):
        raise wrong(path, place, "2 or 3", dimension)
    return dimension


def check_finite(path: Path, place: str, values: NDArray[np.float64]) -> None:
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise wrong(path, place, "finite numbers", f"{values[bad[0]]} at [{bad[0]}]")


def check_friction(path: Path, place: str, friction: NDArray[np.float64]) -> None:
    if np.any(friction < 0):
        worst = int(np.argmin(friction))
        raise wrong(path, place, "coefficients of friction >= 0", f"{friction[worst]:.6g} at contact {worst}")


def is_number(word: str) -> bool:
    """Whether a word of a text is one, be it NaN."""
    try:
        float(word)
    except ValueError:
        return False
    return True


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Put the file's name before what a problem refuses of its data."""
    try:
        yield
    except InvalidProblem as error:
        raise type(error)(f"{path}: {error}") from None


def read_bytes(path: Path, expected: str, most: int = -1) -> bytes:
    """The first bytes of a file, or all.

    Raises
    ------
    InvalidProblem
        There is none of that name, or it cannot be read.
    """
    try:
        with open(path, "rb") as file:
            return file.read(most)
    except FileNotFoundError:
        raise InvalidProblem(f"{path}: expected {expected}, and there is none of that name") from None
    except IsADirectoryError:
        raise InvalidProblem(f"{path}: expected {expected}, got a folder") from None
    except (OSError, ValueError) as error:
        raise InvalidProblem(f"{path}: expected {expected} ({getattr(error, 'strerror', None) or error})") from None
