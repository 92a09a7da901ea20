"""An answer from CalculiX's results, .frd (text) or .dat: displacements and, at slave nodes, contact pressures.

The unknowns of the problem are called "node.axis", 12.2 or 12.y, as the .dof file beside a stored stiffness calls them;
its contacts are called by their slave node, "12", "node 12" or like one of its unknowns. The last increment counts.
Pressures are positive in compression, and zero where CalculiX prints no contact element.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from contactqp.errors import InvalidProblem, Unsupported
from contactqp.exchange.answer_reader import AnswerFile, AnswerReader
from contactqp.exchange.files import Ledger, Path, read_bytes, refuse_utf_16, text_lines, wrong
from contactqp.model.arrays import Array, Index
from contactqp.model.problem import ContactProblem

# The fields that CalculiX prints at nodes.
DISPLACEMENT, FORCE, CONTACT = "displacement", "force", "contact"


@dataclass(frozen=True, eq=False)
class NodalField:
    """A nodal field at one time; `kind` is one of the above, or else CalculiX's own name."""

    kind: str
    components: tuple[str, ...]  # CalculiX's own names: D1, D2, D3; COPEN, ..., CPRESS, ...
    time: float
    nodes: Index  # (N,) as printed
    values: Array  # (N, c)

    def component(self, name: str) -> Array | None:
        """Return one component (N,), None where the field does not have it."""
        return self.values[:, self.components.index(name)] if name in self.components else None


# CalculiX's .dat: the tables of *NODE PRINT and *CONTACT PRINT, increment by increment.
#
# Before each table stands a line of words with the time at its end: "displacements (vx,vy,vz) for set S and time t",
# "forces (fx,fy,fz) ...", "contact stress (slave node,press,tang1,tang2) ...", "relative contact displacement (slave
# node, ...) ...". Contact pressure is positive in compression. Tables of slave elements and faces are face-to-face
# contact at its integration points and give no value at a node; other tables are none of contact's.

DAT_EXPECTED = "CalculiX's printed tables (.dat)"
TITLE = re.compile(r"\s(\S[^()]*?)\s*\(([^()]*)\).*\btime\s+(\S+)\s*", re.ASCII)
DAT_NUMBER = re.compile(r"[+-]?\d+\.\d*(?:[eE]?[+-]\d+)?", re.ASCII)
OMITTED = re.compile(r"(?<=[\d.])(?=[+-])")
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
    """Return the nodal tables of a file, in its order, and the titles of the others.

    Raises
    ------
    InvalidProblem
        No such file, no table of CalculiX's in it, a line that is not a row of its table, a file that was cut off.
    """
    tables: list[_Table] = []
    others: list[str] = []
    table: _Table | None = None
    for number, line in enumerate(text_lines(path, DAT_EXPECTED), 1):
        if WORDS.search(line):
            table = _begin_table(path, f"line {number}", line, others)
            if table is not None:
                tables.append(table)
        elif table is not None and line.strip():
            _take_row(path, f"line {number}", table, line)
        elif line.strip() and not others:
            raise wrong(path, f"line {number}", "the title of a table", repr(line[:40]))
    if not tables and not others:
        raise wrong(path, "content", DAT_EXPECTED, "no table")
    return [_field_of_table(path, table) for table in tables], others


def _begin_table(path: Path, place: str, line: str, others: list[str]) -> _Table | None:
    title = TITLE.fullmatch(line)
    if title is None:
        others.append(" ".join(line.split())[:80])
        return None
    kind, components = NODAL.get(title[1], ("", ()))
    if not kind or title[2].startswith("slave element"):
        others.append(f"{title[1]} ({title[2]})"[:80])
        return None
    return _Table(kind, components, _number_of_row(path, place, title[3]))


def _take_row(path: Path, place: str, table: _Table, line: str) -> None:
    words = line.split()
    count = len(table.components) + 1
    if len(words) != count or not words[0].isdecimal() or len(words[0]) > 12:
        raise wrong(path, place, f"a node and {count - 1} values", repr(line[:60]))
    table.nodes.append(int(words[0]))
    table.values.extend(_number_of_row(path, place, word) for word in words[1:])


def _number_of_row(path: Path, place: str, word: str) -> float:
    """Return a real number; Fortran leaves out the E of exponents beyond 99."""
    if not DAT_NUMBER.fullmatch(word):
        raise wrong(path, place, "a number", repr(word[:40]))
    return float(word if "E" in word.upper() else OMITTED.sub("E", word))


def _field_of_table(path: Path, table: _Table) -> NodalField:
    nodes = np.array(table.nodes, dtype=np.int64)
    if len(np.unique(nodes)) < len(nodes):
        raise wrong(path, table.kind, "each node once at a time", "one twice")
    values = np.array(table.values, dtype=float).reshape(-1, len(table.components))
    return NodalField(table.kind, table.components, table.time, nodes, values)


def is_dat(head: bytes) -> bool:
    """Return whether a file begins with an empty line and the title of one of CalculiX's tables."""
    lines = [line for line in head.decode("latin-1").splitlines() if line.strip()]
    title = TITLE.fullmatch(lines[0]) if lines else None
    return title is not None and DAT_NUMBER.fullmatch(title[3]) is not None


# CalculiX's .frd in its text formats: fields at nodes, increment by increment (cgx's manual, "Result Format").
#
# A block begins with 100C (time, number of nodes, format), -4 (name) and a -5 for each component; -1 lines hold node
# and up to six values in columns of 12, -2 lines the rest, -3 ends it, and 9999 ends the file. Format 0 is short (nodes
# in 5 columns), 1 long (10), 2 and 3 are binary and refused.

BEGINNING = b"    1C"
FRD_EXPECTED = "CalculiX's results in text (.frd)"
KINDS = {"DISP": DISPLACEMENT, "FORC": FORCE, "RF": FORCE, "CONTACT": CONTACT}
NODE_WIDTH = {"0": 5, "1": 10}
VALUE_WIDTH, PER_LINE = 12, 6
# Where a block of numbers begins: nodes, elements, results.
BLOCK = re.compile(r" {4}([23])C| {2}(100)C")
FRD_NUMBER = re.compile(r" *[+-]?\d+\.\d*(?:[eE]?[+-]\d+)? *", re.ASCII)
MOST_COMPONENTS = 100


@dataclass(eq=False)
class _Block:
    """A block of results while it is being read."""

    time: float
    expected: int  # nodes, as the header says
    node_width: int
    name: str = ""
    announced: int = 0  # components, as -4 says
    components: list[str] = field(default_factory=list)  # those that are stored
    named: int = 0  # those that -5 lines name
    nodes: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))
    open: int = 0  # values of the last node that have not been read yet


def read_frd(path: Path) -> list[NodalField]:
    """Return all fields of a file, in its order; kinds that are not listed above keep CalculiX's names (STRESS, ...).

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
    """Return the lines of a text; a binary file has the same headers in text, which name the format before the first
    bytes.
    """
    head = read_bytes(path, FRD_EXPECTED, len(BEGINNING))
    refuse_utf_16(path, head)
    if head != BEGINNING:
        raise wrong(path, "first line", f"{FRD_EXPECTED}, beginning with 1C", repr(head.decode("latin-1")))
    return text_lines(path, FRD_EXPECTED)


def _node_width(path: Path, place: str, line: str) -> int:
    storage = line.rstrip()[-1:]
    if storage in ("2", "3"):
        raise Unsupported(f"{path}: {place}: a binary block; let CalculiX print text")
    if storage not in NODE_WIDTH:
        raise wrong(path, place, "format 0 or 1 at its end", repr(storage))
    return NODE_WIDTH[storage]


def _begin(path: Path, place: str, line: str, node_width: int) -> _Block:
    """Begin a block of results: columns 13 to 24 of its line are the time, 25 to 36 the number of nodes."""
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
    """Return a real number; Fortran leaves out the E of exponents beyond 99."""
    if not FRD_NUMBER.fullmatch(word):
        raise wrong(path, place, "a number", repr(word))
    try:
        return float(word)
    except ValueError:
        return float(OMITTED.sub("E", word))


def _integer(path: Path, place: str, word: str) -> int:
    try:
        value = int(word)
    except ValueError:
        raise wrong(path, place, "a whole number", repr(word)) from None
    if not 0 <= value < 2**40:
        raise InvalidProblem(f"{path}: {place}: expected a number of nodes or of a node, got {value}")
    return value


UNKNOWN = re.compile(r"(\d+)\.([1-3xyz])", re.ASCII)
CONTACT_NAME = re.compile(r"(?:node |contact )?(\d+)(?:\.[1-3xyz])?", re.ASCII)
AXES = {"1": 0, "2": 1, "3": 2, "x": 0, "y": 1, "z": 2}
Values = Array


def read_frd_answer(path: Path, problem: ContactProblem) -> AnswerFile:
    """Return the answer in a .frd file by `answer_of`; its numbers have six digits."""
    ledger = Ledger(str(path))
    return answer_of(path, problem, read_frd(path), ledger, FRD_EXPECTED)


def read_dat_answer(path: Path, problem: ContactProblem) -> AnswerFile:
    """Return the answer in a .dat file by `answer_of`; its numbers have seven digits."""
    ledger = Ledger(str(path))
    tables, others = read_dat(path)
    ledger.ignored.extend(f"table: {title}" for title in others[:20])
    return answer_of(path, problem, tables, ledger, DAT_EXPECTED)


def read_displacements(path: Path) -> tuple[NodalField, Ledger]:
    """Return the displacements at the last time in a .frd or .dat file, of all its nodes, and the ledger.

    Raises InvalidProblem: no such file, no displacements in it, a file that was cut off.
    """
    ledger = Ledger(str(path))
    if read_bytes(path, FRD_EXPECTED, len(BEGINNING)) == BEGINNING:
        fields = read_frd(path)
    else:
        fields, _ = read_dat(path)
    moved = [field for field in fields if field.kind == DISPLACEMENT]
    if not moved:
        raise wrong(path, "content", "CalculiX's results with displacements (*NODE PRINT or *NODE FILE, U)", "none")
    return _last(path, moved, "displacements", ledger), ledger


def answer_of(
    path: Path, problem: ContactProblem, fields: list[NodalField], ledger: Ledger, expected: str
) -> AnswerFile:
    """Return the displacements and contact pressures of the last increment that has them.

    Raises InvalidProblem: unknowns that are not called node.axis, an unknown whose node is not printed, or a file with
    neither displacements nor contact pressures at nodes.

    Parameters
    ----------
    path : the file, for messages
    problem : ContactProblem
    fields : list of NodalField, all that the file prints at nodes
    ledger : takes what was ignored and assumed
    expected : the kind of file, for messages
    """
    parts: dict[str, Values] = {}
    moved = [field for field in fields if field.kind == DISPLACEMENT]
    pressed = [field for field in fields if field.kind == CONTACT and field.component("CPRESS") is not None]
    if moved:
        last = _last(path, moved, "displacements", ledger)
        parts["displacement"] = _displacement(path, problem, last, ledger)
    if pressed:
        last = _last(path, pressed, "contact pressures", ledger)
        # Node-to-face contact prints the nodes that have a contact element, mortar contact those of the slave surface.
        if moved and len(last.nodes) >= max(len(field.nodes) for field in moved):
            ledger.ignored.append(
                "contact pressures: printed at every node, that is extrapolated from the integration points of faces"
            )
        else:
            _pressures(path, problem, last, parts, ledger)
    if not parts:
        raise wrong(path, "content", f"{expected} with displacements", "none")
    others = sorted({field.kind for field in fields if field not in moved and field not in pressed})
    ledger.ignored.extend(f"field: {kind}" for kind in others)
    return AnswerFile(parts, ledger, frozenset(parts))


def _last(path: Path, fields: list[NodalField], what: str, ledger: Ledger) -> NodalField:
    """Return all nodes of the last time: *NODE PRINT makes a table for each set of nodes."""
    time = max(field.time for field in fields)
    now = [field for field in fields if field.time == time]
    earlier = len({field.time for field in fields}) - 1
    if earlier:
        ledger.ignored.append(f"{what} of {earlier} earlier times")
    if len({field.components for field in now}) > 1:
        raise wrong(path, what, "the same components at all nodes", "different ones")
    values: dict[int, Values] = {}
    for each in now:
        values.update(zip(each.nodes.tolist(), each.values, strict=True))
    ledger.read.append(f"{what} of {len(values)} nodes at time {time:g}")
    width = len(now[0].components)
    nodes = np.array(list(values), dtype=np.int64)
    return NodalField(now[0].kind, now[0].components, time, nodes, np.array(list(values.values())).reshape(-1, width))


def _displacement(path: Path, problem: ContactProblem, field: NodalField, ledger: Ledger) -> Values:
    row = {int(node): at for at, node in enumerate(field.nodes)}
    u = np.empty(problem.dimension)
    used: set[tuple[int, int]] = set()
    for j in range(problem.dimension):
        name = problem.dof_name(j)
        found = UNKNOWN.fullmatch(name)
        if found is None:
            expected = "unknowns called node.axis, such as 12.2, as displacements are printed by node"
            raise InvalidProblem(f"{path}: displacement: expected {expected}, got {name!r:.60}")
        node, axis = int(found[1]), AXES[found[2]]
        if node not in row or axis >= field.values.shape[1]:
            raise wrong(path, "displacement", f"one of each unknown, {name} too", f"{len(row)} other nodes")
        u[j] = field.values[row[node], axis]
        used.add((row[node], axis))
    rest = field.values.size - len(used)
    if rest:
        other = np.ones(field.values.shape, dtype=bool)
        other[tuple(np.array(sorted(used)).T)] = False
        most = np.max(abs(field.values[other]))
        ledger.ignored.append(f"{rest} displacements that are not unknowns of the problem, none larger than {most:g}")
    return u


def _pressures(
    path: Path, problem: ContactProblem, field: NodalField, parts: dict[str, Values], ledger: Ledger
) -> None:
    """Add the pressures of the contacts to `parts` where all contacts are called by their slave node."""
    names = [CONTACT_NAME.fullmatch(problem.contact_name(i)) for i in range(problem.contacts)]
    if problem.contact_names is None or any(name is None for name in names):
        ledger.ignored.append("contact pressures: the problem's contacts are not called by their slave node")
        return
    nodes = [int(name[1]) for name in names if name is not None]
    if len(set(nodes)) < len(nodes):
        ledger.ignored.append("contact pressures: two contacts of the problem are called by the same node")
        return
    printed = dict(zip(field.nodes.tolist(), field.component("CPRESS"), strict=True))  # type: ignore[arg-type]
    moving = {int(name[1]) for j in range(problem.dimension) if (name := UNKNOWN.fullmatch(problem.dof_name(j)))}
    others = [node for node in printed if node not in set(nodes) and printed[node] != 0]
    strange = [node for node in others if node in moving or not moving]
    if strange:
        raise wrong(path, "contact pressures", "those of the problem's contacts", f"one of node {strange[0]} too")
    if others:
        ledger.ignored.append(f"contact pressures at {len(others)} nodes that are held, such as node {others[0]}")
    absent = [node for node in nodes if node not in printed]
    if absent:
        ledger.assumed.append(f"{len(absent)} contacts have no contact element: no pressure")
    parts["normal_pressure"] = np.array([printed.get(node, 0.0) for node in nodes])


FRD = AnswerReader("CalculiX .frd", (".frd",), read_frd_answer, lambda head: head.startswith(b"    1C"))
DAT = AnswerReader("CalculiX .dat", (".dat",), read_dat_answer, is_dat)
