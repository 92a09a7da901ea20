"""What a study has found so far, streamed to a file of JSON lines that survives its process.

The first line says with what the study runs: where that is another machine, version or setting, nothing that is kept
is used. Every other line is the result of a cell. A line that is torn, as the process died while it was written, is no
result. Beside the lines nothing is needed to go on.
"""

from __future__ import annotations

import errno
import json
import os
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from contactqp.errors import SceneError
from contactqp.study.running.cells import Cell, Crash, Result
from contactqp.study.running.codec import decode, encode
from contactqp.study.running.file_lock import lock

SCHEMA, SCHEMA_VERSION = "contactqp-unfinished-study", 1
# Seconds between calls of fsync: a process that dies loses nothing, a machine that dies no more than these.
SYNC = 2.0
# How many differences between then and now are named.
MOST = 3
# Errors that go away where there is room: a full disk, a quota that is spent.
FULL = (errno.ENOSPC, errno.EDQUOT)


class Journal:
    """The results of one study in one file, which nobody else writes while this is open.

    Parameters
    ----------
    file : path
        Made if need be; its folder exists.
    conditions : mapping
        Under which results are the same: versions, machine, settings.
    fresh : bool
        Forget what is in it.

    Raises
    ------
    SceneError
        The file cannot be written, or another process is writing it.
    """

    def __init__(self, file: Path, conditions: Mapping[str, Any], fresh: bool = False) -> None:
        self.file = file
        self._stream = _open(file)
        self._synced = time.monotonic()
        head = json.loads(json.dumps(encode(dict(schema=SCHEMA, schema_version=SCHEMA_VERSION, **conditions))))
        lines, end = _whole_lines(self._stream)
        found = lines[0] if lines else {}
        other = () if fresh or not lines else tuple(_differences(found, head))
        self.notes = (f"{file.name}: begun with {', '.join(other[:MOST])}: started over",) if other else ()
        self._kept: dict[str, dict[str, Any]] = {}
        if lines and not fresh and not other:
            self._kept = {line["key"]: line for line in lines[1:] if "key" in line}
            self._stream.truncate(end)
        else:
            self._stream.truncate(0)
            self._write(head)

    @property
    def count(self) -> int:
        """How many results there are."""
        return len(self._kept)

    def find(self, cell: Cell) -> Result | None:
        """What was kept of a cell; None where nothing was, or only of another state of its case."""
        kept = self._kept.get(cell.key)
        if kept is None or kept.get("digest") != cell.digest:
            return None
        try:
            return _read(kept, cell.result)
        except (KeyError, TypeError, ValueError):
            return None

    def changed(self, cells: Iterable[Cell]) -> Iterator[Cell]:
        """Those of which a result was kept that is not theirs any more."""
        return (cell for cell in cells if cell.key in self._kept and self.find(cell) is None)

    def write(self, cell: Cell, result: Result) -> Result:
        """Keep a result, and return it as it will be read: the same whether a study was interrupted or not.

        Raises
        ------
        SceneError
            The disk is full, or fails; what was kept before stays.
        """
        line = dict(key=cell.key, digest=cell.digest)
        line |= {"crash": encode(result)} if isinstance(result, Crash) else {"result": encode(result)}
        self._kept[cell.key] = self._write(line)
        return _read(self._kept[cell.key], cell.result)

    def close(self) -> None:
        """Let others write."""
        self._stream.close()

    def remove(self) -> None:
        """The study is finished."""
        with suppress(PermissionError):  # Windows removes no open file
            self.file.unlink()
        self.close()
        self.file.unlink(missing_ok=True)

    def _write(self, data: Mapping[str, Any]) -> dict[str, Any]:
        """Write a line, and return it as it will be read."""
        line = json.dumps(data).encode("ascii")
        try:
            self._stream.write(line + b"\n")
            self._stream.flush()
            if time.monotonic() - self._synced > SYNC:
                os.fsync(self._stream.fileno())
                self._synced = time.monotonic()
        except OSError as error:
            raise self._refused(error) from None
        return dict(json.loads(line))

    def _refused(self, error: OSError) -> SceneError:
        """What is said where a line cannot be written; nothing more is."""
        with suppress(OSError):  # what is left of the line would be written now, in vain
            self._stream.close()
        kept = f"the {self.count} results found so far are kept in it" if self.count else "nothing was found yet"
        todo = "free space there and run" if error.errno in FULL else "run"
        return SceneError(f"{self.file}: cannot be written: {error.strerror}; {kept}; {todo} the same command again")


def _open(file: Path) -> BinaryIO:
    """Open for reading and writing, locked."""
    try:
        stream = file.open("a+b")
    except OSError as error:
        raise SceneError(f"{file.parent}: expected a folder that can be written, got: {error.strerror}") from None
    if not lock(stream, file):
        stream.close()
        raise SceneError(f"{file.parent}: another report is being written to this folder")
    return stream


def _whole_lines(stream: BinaryIO) -> tuple[list[dict[str, Any]], int]:
    """The lines that are whole, and where the last of them ends."""
    stream.seek(0)
    data = stream.read()
    end = data.rfind(b"\n") + 1
    return [line for line in map(_parsed, data[:end].splitlines()) if line is not None], end


def _parsed(line: bytes) -> dict[str, Any] | None:
    try:
        data = json.loads(line)
    except ValueError:  # a hole of zeros, where the machine died before the disk had it
        return None
    return data if isinstance(data, dict) else None


def _read(line: Mapping[str, Any], kind: type) -> Result:
    if "crash" in line:
        return decode(line["crash"], Crash)
    return decode(line["result"], kind)


def _differences(found: Any, head: Any, where: str = "") -> Iterator[str]:
    """What of the conditions is not as it was."""
    if not (isinstance(found, dict) and isinstance(head, dict)):
        if found != head:
            yield f"{where} {found} instead of {head}"
        return
    for name in dict.fromkeys([*head, *found]):
        yield from _differences(found.get(name), head.get(name), name)
