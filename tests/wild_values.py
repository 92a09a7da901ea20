"""Values that no function of a user's program should hand over, and that some do: broken objects, foreign numbers,
sparse matrices of all formats, collections without an end, paths that lead nowhere.
"""

from __future__ import annotations

import array
import os
import pathlib
from collections.abc import Iterator
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import scipy.sparse as sp


class FloatOfItsOwn(float):
    def __float__(self) -> float:
        raise RuntimeError("no\nfloat")


class NoFloat:
    def __float__(self) -> float:
        raise RuntimeError("no\nfloat")


class NoIndex:
    def __index__(self) -> int:
        raise RuntimeError("no\nindex")


class Endless:
    """Has entries by number, whatever the number."""

    def __len__(self) -> int:
        return 2**62

    def __getitem__(self, place: int) -> float:
        return 1.0


class BelowZero(Endless):
    def __len__(self) -> int:
        return -1


class Junk:
    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        return "junk"


class NoText(str):
    """A text whose words fail."""

    __slots__ = ()

    def __str__(self) -> str:
        raise RuntimeError("no str")

    def __repr__(self) -> str:
        raise RuntimeError("no repr")


class NoEntries:
    def __iter__(self) -> Iterator[Any]:
        raise RuntimeError("no\nentries")


class BreaksOff:
    def __iter__(self) -> Iterator[float]:
        yield 1.0
        raise RuntimeError("later\n")


class NoPath:
    def __fspath__(self) -> str:
        raise RuntimeError("no\npath")


class PathOfBytes:
    def __fspath__(self) -> bytes:
        return b"/tmp"


class NoItems(dict[str, float]):
    def items(self) -> Any:
        raise RuntimeError("no\nitems")


class NotEqual:
    def __eq__(self, other: object) -> bool:
        raise RuntimeError("no\neq")

    __hash__ = None  # type: ignore[assignment]


def broken_sparse(data: Any, indices: Any, starts: Any) -> Any:
    """A matrix (2, 2) in CSR format whose arrays are exchanged after it was made."""
    matrix = sp.csr_array((2, 2))
    matrix.data, matrix.indices, matrix.indptr = np.asarray(data, float), np.asarray(indices), np.asarray(starts)
    return matrix


def outside_their_arrays() -> dict[str, Any]:
    """Matrices whose entries lie elsewhere in memory: SciPy itself reads and writes there, so that these are not thrown
    at everything, but at what reads a matrix.
    """
    return {
        "outside": broken_sparse([1, 2], [0, 7], [0, 1, 2]), "below": broken_sparse([1, 2], [0, -1], [0, 1, 2]),
        "starts that fall": broken_sparse([1, 2], [0, 1], [0, 5, 2]), "short": broken_sparse([1], [0, 1], [0, 1, 2]),
    }  # fmt: skip


def sparse() -> dict[str, Any]:
    two = np.diag([1.0, 2.0])
    frozen = sp.csr_array(two)
    for part in (frozen.data, frozen.indices, frozen.indptr):
        part.flags.writeable = False
    wide = np.array([0, 1], dtype=np.int64)
    twice = (np.array([0.5, 0.5, 2.0]), (np.array([0, 0, 1]), np.array([0, 0, 1])))
    return {
        "dok": sp.dok_array(two), "lil": sp.lil_array(two), "bsr": sp.bsr_array(two, blocksize=(2, 2)),
        "dia": sp.dia_array(two), "csc": sp.csc_array(two), "entries twice": sp.coo_array(twice, shape=(2, 2)),
        "zeros": sp.csr_array((np.array([1.0, 0.0, 2.0]), np.array([0, 1, 1]), np.array([0, 2, 3])), shape=(2, 2)),
        "wide indices": sp.csr_array((np.array([1.0, 2.0]), wide, np.array([0, 1, 2], np.int64)), shape=(2, 2)),
        "frozen": frozen, "unsorted": broken_sparse([3, 1, 2], [1, 0, 1], [0, 2, 3]),
        "of truth values": sp.csr_array(two != 0), "long floats": sp.csr_array(two.astype(np.longdouble)),
        "without end": sp.coo_array((2**40, 2**40)), "without rows": sp.csr_array((0, 2)),
        "a sum beyond doubles": broken_sparse([1.0, 1e308, 1e308], [0, 1, 1], [0, 1, 3]),
    }  # fmt: skip


def numbers() -> dict[str, Any]:
    frozen = np.ones(2)
    frozen.flags.writeable = False
    third = Fraction(1, 3)
    return {
        "a float of its own": FloatOfItsOwn(1), "no float": NoFloat(), "no index": NoIndex(), "junk": Junk(),
        "a list of no floats": [NoFloat(), 1.0], "fractions": [third, 2 * third], "decimals": [Decimal("0.1")] * 2,
        "an integer below all": -(10**400), "integers beyond all": [10**400, 1],
        "a decimal beyond all": Decimal("1e400"), "decimals beyond all": [Decimal("1e400"), Decimal(1)],
        "a fraction beyond all": Fraction(10**400), "objects of fractions": np.array([third, third], dtype=object),
        "objects of numbers": np.eye(2).astype(object), "long float": np.longdouble(0.5),
        "a long float beyond all": np.longdouble("1e400"), "long floats": np.eye(2, dtype=np.longdouble),
        "half float": np.float16(0.5), "half floats squared": np.eye(2, dtype=np.float16),
        "truth values squared": np.eye(2, dtype=bool), "8 bits": np.int8(1), "unsigned": np.uint64(2**64 - 1),
        "2**31": 2**31, "2**63": 2**63, "big endian": np.ones(2, ">f8"), "frozen numbers": frozen,
        "backwards": np.array([[1.0, 2.0], [2.0, 5.0]])[::-1, ::-1], "one for all": np.broadcast_to(1.0, (2, 2)),
        "minus zero": -0.0, "minus zeros": np.array([-0.0, -0.0]), "the least double": 5e-324,
        "least doubles": np.eye(2) * 5e-324, "dates": np.array(["2020-01-01"] * 2, dtype="datetime64[D]"),
        "void": np.zeros(2, dtype="V8"), "memory": memoryview(np.ones(2)), "an array of C": array.array("d", [1.0]),
        "nothing squared": np.zeros((0, 0)), "masked and squared": np.ma.masked_array(np.eye(2), np.eye(2) > 0),
        "rows of different kinds": np.array([np.ones(2), np.ones(3)], dtype=object),
    }  # fmt: skip


def others(folder: pathlib.Path) -> dict[str, Any]:
    loop, nowhere, words = folder / "loop", folder / "nowhere", folder / "words.toml"
    loop.symlink_to(loop)
    nowhere.symlink_to(folder / "not there")
    words.write_bytes(b"\xff\xfe\x00words")
    return {
        "endless": Endless(), "shorter than nothing": BelowZero(), "a text without words": NoText("x"),
        "no entries": NoEntries(), "breaks off": BreaksOff(), "no items": NoItems(w=1.0), "not equal": NotEqual(),
        "no path": NoPath(), "a path of bytes": PathOfBytes(), "bytes of a path": os.fsencode(words), "loop": loop,
        "a loop by name": str(loop), "nowhere": nowhere, "no text": words, "a folder by path": folder,
        "a long path": "/tmp/" + "a" * 5000, "half of a character": "\udcff",
        "a path with half of a character": pathlib.Path("\udcff.toml"), "no path at all": pathlib.Path(),
        "a long range": range(10**12), "a form of no number": {"w": float("nan")}, "a form too large": {"w": 10**400},
        "a form of objects": {"w": NoFloat()}, "words for numbers": ["1", "2"],
    }  # fmt: skip


def values(folder: pathlib.Path) -> dict[str, Any]:
    return {f"sparse: {name}": one for name, one in sparse().items()} | numbers() | others(folder)
