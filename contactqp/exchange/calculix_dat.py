"""CalculiX's .dat: the tables of *NODE PRINT and *CONTACT PRINT, increment by increment.

Before each table stands a line of words with the time at its end: "displacements (vx,vy,vz) for set S and time t",
"forces (fx,fy,fz) ...", "contact stress (slave node,press,tang1,tang2) ...", "relative contact displacement (slave
node, ...) ...". Contact pressure is positive in compression. Tables of slave elements and faces are face-to-face
contact at its integration points and give no value at a node; other tables are none of contact's.
"""

from __future__ import annotations

import re
from array import array
from dataclasses import dataclass, field

import numpy as np

from contactqp.exchange.calculix_fields import CONTACT, DISPLACEMENT, FORCE, NodalField
from contactqp.exchange.refusal import Path, wrong
from contactqp.exchange.text_lines import text_lines

EXPECTED = "CalculiX's printed tables (.dat)"
TITLE = re.compile(r"\s(\S[^()]*?)\s*\(([^()]*)\).*\btime\s+(\S+)\s*", re.ASCII)
NUMBER = re.compile(r"[+-]?\d+\.\d*(?:[eE]?[+-]\d+)?", re.ASCII)
OMITTED = re.compile(r"(?<=\d)(?=[+-])")
WORDS = re.compile(r"[A-DF-Za-df-z]{2}")
NODAL = {
    "displacements": (DISPLACEMENT, ("D1", "D2", "D3")),
    "forces": (FORCE, ("F1", "F2", "F3")),
    "relative contact displacement": (CONTACT, ("COPEN", "CSLIP1", "CSLIP2")),
    "contact stress": (CONTACT, ("CPRESS", "CSHEAR1", "CSHEAR2")),
}


@dataclass(eq=False)
class _Table:
    kind: str
    components: tuple[str, ...]
    time: float
    nodes: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))


def read_dat(path: Path) -> tuple[list[NodalField], list[str]]:
    """The nodal tables of a file, in its order, and the titles of the others.

    Raises
    ------
    InvalidProblem
        No such file, no table of CalculiX's in it, a line that is no row of its table, a file that was cut off.
    """
    tables: list[_Table] = []
    others: list[str] = []
    table: _Table | None = None
    for number, line in enumerate(text_lines(path, EXPECTED), 1):
        if WORDS.search(line):
            table = _begin(path, f"line {number}", line, others)
            if table is not None:
                tables.append(table)
        elif table is not None and line.strip():
            _take(path, f"line {number}", table, line)
        elif line.strip() and not others:
            raise wrong(path, f"line {number}", "the title of a table", repr(line[:40]))
    if not tables and not others:
        raise wrong(path, "content", EXPECTED, "no table")
    return [_field(path, table) for table in tables], others


def _begin(path: Path, place: str, line: str, others: list[str]) -> _Table | None:
    title = TITLE.fullmatch(line)
    if title is None:
        others.append(" ".join(line.split())[:80])
        return None
    kind, components = NODAL.get(title[1], ("", ()))
    if not kind or title[2].startswith("slave element"):
        others.append(f"{title[1]} ({title[2]})"[:80])
        return None
    return _Table(kind, components, _number(path, place, title[3]))


def _take(path: Path, place: str, table: _Table, line: str) -> None:
    words = line.split()
    count = len(table.components) + 1
    if len(words) != count or not words[0].isdecimal() or len(words[0]) > 12:
        raise wrong(path, place, f"a node and {count - 1} values", repr(line[:60]))
    table.nodes.append(int(words[0]))
    table.values.extend(_number(path, place, word) for word in words[1:])


def _number(path: Path, place: str, word: str) -> float:
    """A real number; Fortran leaves out the E of exponents beyond 99."""
    if not NUMBER.fullmatch(word):
        raise wrong(path, place, "a number", repr(word[:40]))
    return float(word if "E" in word.upper() else OMITTED.sub("E", word))


def _field(path: Path, table: _Table) -> NodalField:
    nodes = np.array(table.nodes, dtype=np.int64)
    if len(np.unique(nodes)) < len(nodes):
        raise wrong(path, table.kind, "each node once at a time", "one twice")
    values = np.array(table.values, dtype=float).reshape(-1, len(table.components))
    return NodalField(table.kind, table.components, table.time, nodes, values)


def is_dat(head: bytes) -> bool:
    """Whether first bytes are the title of one of CalculiX's tables, with an empty line before it."""
    lines = [line for line in head.decode("latin-1").splitlines() if line.strip()]
    title = TITLE.fullmatch(lines[0]) if lines else None
    return title is not None and NUMBER.fullmatch(title[3]) is not None
