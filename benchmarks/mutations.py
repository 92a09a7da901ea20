"""What may happen to a file: cut off, bits turned, bytes swapped, numbers made huge, text made binary, ..."""

from __future__ import annotations

import io
import re
import zipfile
import zlib
from collections.abc import Callable
from functools import cache

import numpy as np

NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
HUGE = [b"999999999999", b"4294967297", b"-1", b"1e400", b"nan", b"inf", b"0", b"18446744073709551616", b"1e-320",
        b"9" * 5000, b"2147483647", b"1_0", b"0x10", "\u0663".encode()]  # fmt: skip
Random = np.random.Generator


def truncated(data: bytes, random: Random) -> bytes:
    return data[: int(random.integers(0, max(len(data), 1)))]


def beheaded(data: bytes, random: Random) -> bytes:
    return data[int(random.integers(0, max(len(data), 1))) :]


def bits_turned(data: bytes, random: Random) -> bytes:
    changed = bytearray(data)
    for place in random.integers(0, max(len(data), 1), size=int(random.integers(1, 9))):
        if place < len(changed):
            changed[place] ^= 1 << int(random.integers(0, 8))
    return bytes(changed)


def bytes_overwritten(data: bytes, random: Random) -> bytes:
    at, width = int(random.integers(0, max(len(data), 1))), int(random.integers(1, 65))
    return data[:at] + random.bytes(width) + data[at + width :]


def bytes_inserted(data: bytes, random: Random) -> bytes:
    at = int(random.integers(0, len(data) + 1))
    return data[:at] + random.bytes(int(random.integers(1, 33))) + data[at:]


def part_removed(data: bytes, random: Random) -> bytes:
    at = int(random.integers(0, max(len(data), 1)))
    return data[:at] + data[at + int(random.integers(1, 65)) :]


def endianness_swapped(data: bytes, random: Random) -> bytes:
    width = int(random.choice([2, 4, 8]))
    whole = len(data) // width * width
    return np.frombuffer(data[:whole], f"<u{width}").byteswap().tobytes() + data[whole:]


def number_changed(data: bytes, random: Random) -> bytes:
    found = list(NUMBER.finditer(data))
    if not found:
        return bytes_overwritten(data, random)
    one = found[int(random.integers(0, len(found)))]
    return data[: one.start()] + HUGE[int(random.integers(0, len(HUGE)))] + data[one.end() :]


def line_twice(data: bytes, random: Random) -> bytes:
    lines = data.splitlines(keepends=True)
    at = int(random.integers(0, len(lines))) if lines else 0
    return b"".join(lines[: at + 1] + lines[at:])


def line_removed(data: bytes, random: Random) -> bytes:
    lines = data.splitlines(keepends=True)
    at = int(random.integers(0, len(lines))) if lines else 0
    return b"".join(lines[:at] + lines[at + 1 :])


def lines_exchanged(data: bytes, random: Random) -> bytes:
    lines = data.splitlines(keepends=True)
    random.shuffle(lines)
    return b"".join(lines)


def emptied(data: bytes, random: Random) -> bytes:  # noqa: ARG001
    return [b"", b"\n", b" ", b"\0" * 4096, b"\xef\xbb\xbf", b"\xff\xfe", b"#\n"][int(random.integers(0, 7))]


def nonsense(data: bytes, random: Random) -> bytes:
    return random.bytes(len(data) or 64)


def nested(data: bytes, random: Random) -> bytes:
    """Brackets without end, as JSON, TOML or a header of NumPy."""
    opening = [b"[", b'{"displacement":', b"a = [", b"(", b'{"a":[']
    deep = opening[int(random.integers(0, len(opening)))] * 20000
    return deep if random.integers(0, 2) else data[:10] + deep


def another_format(data: bytes, random: Random) -> bytes:  # noqa: ARG001
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("notes.txt", "nothing")
    others = [archive.getvalue(), b"%PDF-1.7\n", b"\x89HDF\r\n\x1a\n" + bytes(600), b"\x93NUMPY\x01\x00v\x00",
              b"%%MatrixMarket matrix coordinate real general\n", b"<?xml version='1.0'?><VTKFile/>", b"{}", b"[]",
              b"PK\x05\x06" + bytes(18), b"SQLite format 3\x00", b"\x64\x00\x00\x00\x00\x00\x00\x80\x04\x00\x00\x00",
              b"\x64\x00\x00\x00\x00\x00\x00\x80\x0c\x00\x00\x00" + bytes(396)]  # fmt: skip
    return others[int(random.integers(0, len(others)))]


def gigantic(data: bytes, random: Random) -> bytes:  # noqa: ARG001
    """Sizes that no file of this length can hold, in formats that state them."""
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999, 99999), }"
    npy = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    flat = b"{'descr': '<f8', 'fortran_order': False, 'shape': (0, 9999999999999), }"
    market = b"%%MatrixMarket matrix coordinate real general\n999999999999 999999999999 1\n1 1 1.0\n"
    array = b"%%MatrixMarket matrix array real general\n999999 999999\n1.0\n"
    local = b"2\n999999999\n0\n999999999\n999999999\n999999999\t999999999\n1.0\n"
    choices = [npy, b"\x93NUMPY\x01\x00" + len(flat).to_bytes(2, "little") + flat, market, array, local, bomb(npy)]
    return choices[int(random.integers(0, len(choices)))]


@cache
def bomb(npy: bytes) -> bytes:
    """An archive whose members grow to far more than they are, or say so."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as file:
        header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (33554432,), }"
        head = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
        for name in ("load", "displacement"):
            file.writestr(f"{name}.npy", head + bytes(8 * 2**22))
        file.writestr("normal_force.npy", npy)
    return archive.getvalue().replace((8 * 2**22 + len(head)).to_bytes(4, "little"), b"\xff\xff\xff\x7f")


def member_changed(data: bytes, random: Random) -> bytes:
    """One member of an archive, packed again so that its checksum is right; anything else has a number changed."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as file:
            members = {name: file.read(name) for name in file.namelist()}
    except (zipfile.BadZipFile, OSError, ValueError, RuntimeError, NotImplementedError, EOFError, zlib.error):
        return number_changed(data, random)
    if not members:
        return data
    name = list(members)[int(random.integers(0, len(members)))]
    change = [bits_turned, bytes_overwritten, truncated, number_changed, endianness_swapped, gigantic, nonsense]
    members[name] = change[int(random.integers(0, len(change)))](members[name], random)
    if random.integers(0, 4) == 0:
        members.pop(name)
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in members.items():
            file.writestr(name, content)
    return archive.getvalue()


MUTATIONS: tuple[Callable[[bytes, Random], bytes], ...] = (
    truncated, beheaded, bits_turned, bytes_overwritten, bytes_inserted, part_removed, endianness_swapped,
    number_changed, number_changed, number_changed, line_twice, line_removed, lines_exchanged, emptied, nonsense,
    nested, another_format, gigantic, member_changed, member_changed, member_changed,
)  # fmt: skip


def mutate(data: bytes, random: Random) -> tuple[bytes, str]:
    """A mutated file, and what was done to it; now and then two things at once."""
    names = []
    for _ in range(1 + int(random.integers(0, 4) == 0)):
        change = MUTATIONS[int(random.integers(0, len(MUTATIONS)))]
        data = change(data, random)
        names.append(change.__name__)
    return data, " and ".join(names)
