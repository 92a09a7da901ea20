"""From a case file to a Scene."""

from __future__ import annotations

import os
import tomllib
from decimal import Decimal
from pathlib import Path
from typing import Any

from contactqp.errors import SceneError
from contactqp.linalg.stages import READ, stage
from contactqp.scene.scene import Scene

# Bytes; the parser takes about a second for each of a million.
LARGEST = 2**25


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """Read and check a case file.

    Numbers are read as decimals, so that 0.1 is 1/10.

    Raises
    ------
    SceneError
        The file cannot be read, is no TOML, or is no scene: one line with file, key, what was expected and what came.
    """
    file = Path(path)
    try:
        with stage(READ):
            scene = Scene(**_tables(_text(file)))
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None
    scene._file = file
    return scene


def _text(file: Path) -> str:
    try:
        if file.exists() and not (file.is_file() or file.is_dir()):
            raise SceneError("expected a case file, got a pipe or a device")
        if file.is_file() and file.stat().st_size > LARGEST:
            size = file.stat().st_size >> 20
            raise SceneError(f"expected a case file of at most {LARGEST >> 20} MiB, got {size} MiB")
        data = file.read_bytes()
    except SceneError:
        raise
    except FileNotFoundError:
        raise SceneError("expected a case file, and there is none of that name") from None
    except IsADirectoryError:
        raise SceneError("expected a case file, got a directory") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise SceneError(f"expected a case file that can be read, got: {reason}") from None
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise SceneError(
            f"expected text in UTF-8, got the byte 0x{data[error.start]:02x} at place {error.start}"
        ) from None


def _tables(text: str) -> dict[str, Any]:
    if not text.strip():
        raise SceneError("expected a scene, got an empty file")
    try:
        # TOML files written on Windows may end their lines with CR LF and start with a mark of the byte order.
        return tomllib.loads(text.removeprefix("\ufeff"), parse_float=Decimal)
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"expected TOML, got: {' '.join(str(error).split())}") from None
    except (RecursionError, ValueError, ArithmeticError) as error:
        raise SceneError(f"expected TOML, got numbers or tables that cannot be read ({type(error).__name__})") from None
