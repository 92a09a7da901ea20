"""What the cells of these tests do; other processes find it by its name."""

from __future__ import annotations

import ctypes
import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

from contactqp.errors import SceneError


@dataclass(frozen=True)
class Number:
    value: float


def half(value: float) -> Number:
    return Number(value / 2)


def noted(file: Path, value: float) -> Number:
    """Leaves a line for each call."""
    with file.open("a") as stream:
        stream.write(f"{value}\n")
    return half(value)


def slow(file: Path, value: float) -> Number:
    time.sleep(0.02)
    return noted(file, value)


def where() -> Number:
    return Number(os.getpid())


def threads() -> Number:
    return Number(float(os.environ.get("OPENBLAS_NUM_THREADS", "nan")))


def chatter() -> Number:
    print("what a library writes to where the answers go")
    os.write(1, b"and what it writes without Python\n")
    return Number(1.0)


def overlap(folder: Path) -> Number:
    """How many others are at work at the same time."""
    mine = folder / str(os.getpid())
    mine.touch()
    time.sleep(0.05)
    found = len(list(folder.iterdir()))
    mine.unlink()
    return Number(found)


def segfault() -> Number:
    ctypes.string_at(0)
    return Number(0.0)


def killed() -> Number:
    os.kill(os.getpid(), signal.SIGKILL)
    return Number(0.0)


def leaves() -> Number:
    os._exit(3)


def unlucky(file: Path) -> Number:
    """Dies the first time only, as of a signal that was meant for all."""
    if not file.exists():
        file.touch()
        os.kill(os.getpid(), signal.SIGTERM)
    return Number(1.0)


def hangs() -> Number:
    time.sleep(1000)
    return Number(0.0)


def buggy() -> Number:
    raise ZeroDivisionError("nobody thought of this")


class Unportable(Exception):
    """Cannot be made again from its message."""

    def __init__(self, one: str, other: str) -> None:
        super().__init__(one + other)


def unportable() -> Number:
    raise Unportable("this", " and that")


def wrong_case() -> Number:
    raise SceneError("case.toml: loads: expected a number, got 'much'")
