"""CalculiX's .frd in its text formats: fields at nodes, increment by increment (cgx's manual, "Result Format").

A block begins with 100C (time, number of nodes, format), -4 (name) and a -5 for each component; -1 lines hold node and
up to six values in columns of 12, -2 lines the rest, -3 ends it, and 9999 ends the file. Format 0 is short (nodes in 5
columns), 1 long (10), 2 and 3 are binary and refused.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from contactqp.errors import InvalidProblem, Unsupported
from contactqp.exchange.calculix_fields import CONTACT, DISPLACEMENT, FORCE, NodalField
from contactqp.exchange.refusal import Path, read_bytes, wrong
from contactqp.exchange.text_lines import text_lines

BEGINNING = b"    1C"
EXPECTED = "CalculiX's results in text (.frd)"
KINDS = {"DISP": DISPLACEMENT, "FORC": FORCE, "RF": FORCE, "CONTACT": CONTACT}
NODE_WIDTH = {"0": 5, "1": 10}
VALUE_WIDTH, PER_LINE = 12, 6
# Where a block of numbers begins: nodes, elements, results.
BLOCK = re.compile(r" {4}([23])C| {2}(100)C")
NUMBER = re.compile(r" *[+-]?\d+\.\d*(?:[eE]?[+-]\d+)? *", re.ASCII)
MOST_COMPONENTS = 100


@dataclass(eq=False)
class _Block:
    """A block of results as far as it is read."""

    time: float
    expected: int  # nodes, as the header says
    node_width: int
    name: str = ""
    announced: int = 0  # components, as -4 says
    components: list[str] = field(default_factory=list)  # those that are stored
    named: int = 0  # those that -5 lines name
    nodes: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))
    open: int = 0  # values of the last node that are still to come


def read_frd(path: Path) -> list[NodalField]:
    """All fields of a file, in its order; strings of kinds that are none of ours are CalculiX's names (STRESS, ...).

    Raises
    ------
    InvalidProblem
        No such file, a line that is not what stands in this place, a file that was cut off.
    Unsupported
        A binary file (``*NODE OUTPUT``, ``*EL FILE, OUTPUT=...`` in binary).
    """
    fields: list[NodalField] = []
    block: _Block | None = None
    skipping = ended = False
    for number, line in enumerate(_lines(path), 1):
        mark, place = line[:3], f"line {number}"
        if ended and line.strip():
            raise wrong(path, place, "nothing after 9999", repr(line[:40]))
        if mark == " -3":
            if block is not None:
                fields.append(_field(path, place, block))
            block, skipping = None, False
        elif skipping or not line.strip():
            continue
        elif block is not None:
            _take(path, place, block, line)
        elif begins := BLOCK.match(line):
            width = _node_width(path, place, line)
            skipping = begins[1] is not None
            block = None if skipping else _begin(path, place, line, width)
        elif line.strip() == "9999":
            ended = True
        elif not line.startswith(("    1", "    9")):
            raise wrong(path, place, "the beginning of a block", repr(line[:40]))
    if not ended:
        raise wrong(path, "end", "a line 9999", "the end of the file: the run broke off or the file was cut off")
    return fields


def _lines(path: Path) -> Iterator[str]:
    """The lines of a text; a binary file has the same headers in text, which name the format before the first bytes."""
    head = read_bytes(path, EXPECTED, len(BEGINNING))
    if head != BEGINNING:
        raise wrong(path, "first line", f"{EXPECTED}, beginning with 1C", repr(head.decode("latin-1")))
    return text_lines(path, EXPECTED)


def _node_width(path: Path, place: str, line: str) -> int:
    storage = line.rstrip()[-1:]
    if storage in ("2", "3"):
        raise Unsupported(f"{path}: {place}: a binary block; let CalculiX print text")
    if storage not in NODE_WIDTH:
        raise wrong(path, place, "format 0 or 1 at its end", repr(storage))
    return NODE_WIDTH[storage]


def _begin(path: Path, place: str, line: str, node_width: int) -> _Block:
    """Columns 13 to 24 are the time, 25 to 36 the number of nodes."""
    return _Block(_number(path, place, line[12:24]), _integer(path, place, line[24:36]), node_width)


def _take(path: Path, place: str, block: _Block, line: str) -> None:
    mark = line[:3]
    if mark == " -4":
        block.name = line[5:13].strip()
        block.announced = _integer(path, place, line[13:18])
        if not 0 < block.announced <= MOST_COMPONENTS:
            raise wrong(path, place, f"1 to {MOST_COMPONENTS} components", block.announced)
    elif mark == " -5":
        block.named += 1
        # The last number says that the component follows from the others and is not stored.
        if line[33:38].strip() in ("", "0"):
            block.components.append(line[5:13].strip())
    elif mark == " -1":
        if not block.components or block.named != block.announced:
            raise wrong(path, place, f"{block.announced} lines -5 before the values", block.named)
        if block.open:
            raise wrong(path, place, f"{block.open} more values of the node before", "the next node")
        block.nodes.append(_integer(path, place, line[3 : 3 + block.node_width]))
        block.open = len(block.components)
        _values(path, place, block, line)
    elif mark == " -2" and block.open:
        _values(path, place, block, line)
    else:
        raise wrong(path, place, "a line of the block", repr(line[:40]))


def _values(path: Path, place: str, block: _Block, line: str) -> None:
    count, start = min(block.open, PER_LINE), 3 + block.node_width
    for at in range(start, start + count * VALUE_WIDTH, VALUE_WIDTH):
        block.values.append(_number(path, place, line[at : at + VALUE_WIDTH]))
    if line[start + count * VALUE_WIDTH :].strip():
        raise wrong(path, place, f"{count} values", repr(line[:100]))
    block.open -= count


def _field(path: Path, place: str, block: _Block) -> NodalField:
    if len(block.nodes) != block.expected and block.name != "CONTACT":  # CalculiX counts all nodes there
        raise wrong(path, place, f"{block.expected} nodes of {block.name}, as the header says", len(block.nodes))
    if block.open or block.named != block.announced:
        raise wrong(path, place, f"{block.open} more values, {block.announced} components", "the end of the block")
    nodes = np.array(block.nodes, dtype=np.int64)
    values = np.array(block.values, dtype=float).reshape(len(nodes), len(block.components))
    if len(np.unique(nodes)) < len(nodes):
        raise wrong(path, place, f"each node of {block.name} once", "one twice")
    return NodalField(KINDS.get(block.name, block.name), tuple(block.components), block.time, nodes, values)


def _number(path: Path, place: str, word: str) -> float:
    """A real number; Fortran leaves out the E of exponents beyond 99."""
    if not NUMBER.fullmatch(word):
        raise wrong(path, place, "a number", repr(word))
    try:
        return float(word)
    except ValueError:
        return float(re.sub(r"(?<=\d)([+-])", r"E\1", word))


def _integer(path: Path, place: str, word: str) -> int:
    try:
        value = int(word)
    except ValueError:
        raise wrong(path, place, "a whole number", repr(word)) from None
    if not 0 <= value < 2**40:
        raise InvalidProblem(f"{path}: {place}: expected a number of nodes or of a node, got {value}")
    return value
