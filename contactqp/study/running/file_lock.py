"""A lock on a file that ends with the process that holds it, however it ends."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import BinaryIO


def lock(stream: BinaryIO, file: Path) -> bool:
    """Lock an open file for this process alone; False where another one has it, or has just removed it."""
    return _locked(stream) and _is(stream, file)


def _is(stream: BinaryIO, file: Path) -> bool:
    """Whether that is still the file of this name."""
    return file.exists() and os.path.samestat(os.fstat(stream.fileno()), file.stat())


if sys.platform == "win32":
    import msvcrt

    # Far behind the contents: others may read the file.
    _PLACE = 2**30

    def _locked(stream: BinaryIO) -> bool:
        stream.seek(_PLACE)
        try:
            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True

else:
    import fcntl

    def _locked(stream: BinaryIO) -> bool:
        try:
            fcntl.flock(stream.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True
