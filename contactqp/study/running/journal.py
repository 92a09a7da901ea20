"""The journal of a study: cells and their results, streamed to a file of JSON lines that survives its process.

The first line holds the conditions of the study: under another machine, version or setting no kept result is used.
Every other line is the result of a cell. A line that is incomplete, as the process died while writing it, is ignored.
Nothing but the lines is needed to go on.
"""

from __future__ import annotations

import base64
import errno
import hashlib
import json
import os
import sys
import time
import types
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO, Union, get_args, get_origin, get_type_hints

import numpy as np
import scipy.sparse as sp

from contactqp.errors import SceneError
from contactqp.model.problem import ContactProblem

# Bytes of a digest: two cases of one report never have the same one by chance.
SIZE = 12


def digest(file: bytes, problem: ContactProblem) -> str:
    """Return a digest of a case file's bytes and of every number of its problem, whatever file these come from."""
    found = hashlib.blake2b(file, digest_size=SIZE)
    for field in fields(problem):
        if not field.name.startswith("_"):
            found.update(field.name.encode())
            for part in _parts(getattr(problem, field.name)):
                found.update(part)
    return found.hexdigest()


def source_digest() -> str:
    """Return a digest of the package's source: results of changed code are not mixed with new ones."""
    found = hashlib.blake2b(digest_size=SIZE)
    for file in sorted(Path(__file__).parents[1].rglob("*.py")):
        found.update(file.read_bytes())
    return found.hexdigest()


def _parts(value: Any) -> list[bytes]:
    if sp.issparse(value):
        rows = value.tocsr()
        return [np.ascontiguousarray(part).tobytes() for part in (rows.indptr, rows.indices, rows.data)]
    if isinstance(value, np.ndarray):
        return [str(value.shape).encode(), np.ascontiguousarray(value).tobytes()]
    return [repr(value).encode()]


@dataclass(frozen=True, eq=False)
class Cell:
    """One piece of a study that succeeds, fails or crashes by itself.

    Parameters
    ----------
    key : str, its name, the same in every run and different from all others: "bar_wall/osqp/raw/tolerance=1e-06"
    function : callable, a function of a module, so that another process finds it by its name
    arguments : tuple, its arguments; they are pickled
    result : type, the type that it returns: a dataclass of plain data, see `encode`
    digest : str, digest of what the arguments stand for; a result that was kept under another one is not used
    cost : float, its expected time relative to the other cells
    """

    key: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    result: type
    digest: str = ""
    cost: float = 1.0


@dataclass(frozen=True)
class Crash:
    """The result of a cell that returned nothing."""

    message: str  # died of a segmentation fault (SIGSEGV); stopped after 600 s; raised RuntimeError: ...


# The result of a cell: what its function returned, or a Crash.
Result = Any


def refuse_twins(cells: Iterable[Cell]) -> None:
    """Raise ValueError where two cells have one key: one of them would get the other's result."""
    seen: set[str] = set()
    for cell in cells:
        if cell.key in seen:
            raise ValueError(f"two cells are called {cell.key!r}")
        seen.add(cell.key)


_PLAIN = {str, int, float, bool}
_BYTES, _ARRAY, _KIND, _SHAPE = "base64", "array", "dtype", "shape"


def encode(value: Any) -> Any:
    """Return a value as plain data for JSON, from which `decode` makes it again.

    Strings, numbers, truth values and None stay what they are; NaN and infinities too, in Python's dialect of JSON.
    Frozen dataclasses become mappings, arrays and bytes base64, tuples lists, fractions text. Fields annotated as Any
    must be plain data.

    Raises TypeError: the value holds something else.
    """
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: encode(getattr(value, field.name)) for field in fields(value)}
    if hasattr(value, "model_dump"):
        return value.model_dump()
    if isinstance(value, Mapping):
        return {str(key): encode(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [encode(item) for item in value]
    if isinstance(value, bytes):
        return {_BYTES: _text(value)}
    if isinstance(value, np.ndarray):
        return {_ARRAY: _text(np.ascontiguousarray(value).tobytes()), _KIND: value.dtype.str, _SHAPE: value.shape}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Fraction):
        return str(value)
    if value is None or isinstance(value, str | int | float):
        return value
    raise TypeError(f"expected plain data, got {type(value).__name__}")


def decode(data: Any, kind: Any) -> Any:
    """Return the value of a type that `encode` made these data of.

    Raises KeyError, TypeError, ValueError: the data are not of that type.
    """
    origin, arguments = get_origin(kind), get_args(kind)
    if hasattr(origin or kind, "__value__"):  # a name of a type, as NDArray since NumPy 2.5
        return decode(data, (origin or kind).__value__)
    if origin in (Union, types.UnionType):
        return _decode_union(data, arguments)
    if kind is Any or kind in _PLAIN or data is None:
        return data
    if origin is np.ndarray or kind is np.ndarray:
        return np.frombuffer(_bytes(data[_ARRAY]), dtype=data[_KIND]).reshape(data[_SHAPE]).copy()
    if origin is tuple:
        kinds = [arguments[0]] * len(data) if arguments[-1] is Ellipsis else arguments
        return tuple(decode(item, kinds[i]) for i, item in enumerate(data))
    if origin is not None and issubclass(origin, Mapping):
        return {key: decode(item, arguments[1]) for key, item in data.items()}
    if origin is list:
        return [decode(item, arguments[0]) for item in data]
    if kind is bytes:
        return _bytes(data[_BYTES])
    if hasattr(kind, "__dataclass_fields__"):
        return kind(**{name: decode(data[name], hint) for name, hint in _hints(kind).items() if name in data})
    return kind(**data) if hasattr(kind, "model_dump") else kind(data)


def _decode_union(data: Any, kinds: tuple[Any, ...]) -> Any:
    """Decode a union of a type and None, or of types that JSON holds as they are."""
    kinds = tuple(kind for kind in kinds if kind is not type(None))
    if data is None or set(kinds) <= _PLAIN:
        return data
    if len(kinds) > 1:
        raise TypeError(f"expected one type or none, got {kinds}")
    return decode(data, kinds[0])


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _bytes(text: str) -> bytes:
    return base64.b64decode(text, validate=True)


def lock(stream: BinaryIO, file: Path) -> bool:
    """Lock an open file until this process ends, however it ends.

    False where another process has locked it, or has just removed the file of this name.
    """
    return _locked(stream) and file.exists() and os.path.samestat(os.fstat(stream.fileno()), file.stat())


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


SCHEMA, SCHEMA_VERSION = "contactqp-unfinished-study", 1
# Seconds between calls of fsync: a process that dies loses no result, a machine that dies those of these seconds.
SYNC = 2.0
# Differences between conditions that a note names at most.
MOST = 3
# Errors of a full disk and of a quota that is used up.
FULL = (errno.ENOSPC, errno.EDQUOT)


class Journal:
    """The results of one study in one file, which no other process writes while this is open.

    Raises SceneError: the file cannot be written, or another process is writing it.

    Parameters
    ----------
    file : path, the file, which is made if need be; its folder exists
    conditions : mapping, versions, machine and settings under which results are the same
    fresh : bool, discard the results in it
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
        """Return the number of kept results."""
        return len(self._kept)

    def find(self, cell: Cell) -> Result | None:
        """Return the kept result of a cell; None where there is none, or one of another state of its case."""
        kept = self._kept.get(cell.key)
        if kept is None or kept.get("digest") != cell.digest:
            return None
        try:
            return _read(kept, cell.result)
        except (KeyError, TypeError, ValueError):
            return None

    def changed(self, cells: Iterable[Cell]) -> Iterator[Cell]:
        """Yield the cells whose kept result is of another state of their case."""
        return (cell for cell in cells if cell.key in self._kept and self.find(cell) is None)

    def write(self, cell: Cell, result: Result) -> Result:
        """Keep a result, and return it as it would be read, so that interrupted and whole studies agree.

        Raises
        ------
        SceneError
            The disk is full or fails; earlier results are kept.
        """
        line = dict(key=cell.key, digest=cell.digest)
        line |= {"crash": encode(result)} if isinstance(result, Crash) else {"result": encode(result)}
        self._kept[cell.key] = self._write(line)
        return _read(self._kept[cell.key], cell.result)

    def close(self) -> None:
        """Close the file, which another process may then write."""
        self._stream.close()

    def remove(self) -> None:
        """Remove the file: the study is finished."""
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
        """Close the file after a line could not be written, and return the error to raise."""
        with suppress(OSError):  # what is left of the line would be written now, in vain
            self._stream.close()
        kept = f"the {self.count} results found so far are kept in it" if self.count else "nothing was found yet"
        todo = "free space there and run" if error.errno in FULL else "run"
        return SceneError(f"{self.file}: cannot be written: {error.strerror}; {kept}; {todo} the same command again")


def _open(file: Path) -> BinaryIO:
    """Open a file for reading and writing, and lock it."""
    try:
        stream = file.open("a+b")
    except OSError as error:
        raise SceneError(f"{file.parent}: expected a folder that can be written, got: {error.strerror}") from None
    if not lock(stream, file):
        stream.close()
        raise SceneError(f"{file.parent}: another report is being written to this folder")
    return stream


def _whole_lines(stream: BinaryIO) -> tuple[list[dict[str, Any]], int]:
    """Return the complete lines, and the position at which the last of them ends."""
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
    """Yield the conditions that differ from those of the kept results."""
    if not (isinstance(found, dict) and isinstance(head, dict)):
        if found != head:
            yield f"{where} {found} instead of {head}"
        return
    for name in dict.fromkeys([*head, *found]):
        yield from _differences(found.get(name), head.get(name), name)
