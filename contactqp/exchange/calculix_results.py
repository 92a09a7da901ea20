"""An answer from CalculiX's results, .frd (text) or .dat: displacements and, at slave nodes, contact pressures.

The unknowns of the problem are called "node.axis", 12.2 or 12.y, as the .dof file beside a stored stiffness calls them;
its contacts are called by their slave node, "12", "node 12" or like one of its unknowns. The last increment counts.
Pressures are positive in compression, those of contact elements that are not there are zero.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem
from contactqp.exchange.answer_reader import AnswerFile, AnswerReader
from contactqp.exchange.calculix_dat import EXPECTED as TABLES
from contactqp.exchange.calculix_dat import is_dat, read_dat
from contactqp.exchange.calculix_fields import CONTACT, DISPLACEMENT, NodalField
from contactqp.exchange.calculix_frd import EXPECTED as FIELDS
from contactqp.exchange.calculix_frd import read_frd
from contactqp.exchange.ledger import Ledger
from contactqp.exchange.refusal import Path, wrong
from contactqp.model.problem import ContactProblem

UNKNOWN = re.compile(r"(\d+)\.([1-3xyz])", re.ASCII)
CONTACT_NAME = re.compile(r"(?:node |contact )?(\d+)(?:\.[1-3xyz])?", re.ASCII)
AXES = {"1": 0, "2": 1, "3": 2, "x": 0, "y": 1, "z": 2}
Values = NDArray[np.float64]


def read_frd_answer(path: Path, problem: ContactProblem) -> AnswerFile:
    """What a .frd file holds, by `answer_of`; six digits are printed of each number."""
    ledger = Ledger(str(path))
    return answer_of(path, problem, read_frd(path), ledger, FIELDS)


def read_dat_answer(path: Path, problem: ContactProblem) -> AnswerFile:
    """What a .dat file holds, by `answer_of`; seven digits are printed of each number."""
    ledger = Ledger(str(path))
    tables, others = read_dat(path)
    ledger.ignored.extend(f"table: {title}" for title in others[:20])
    return answer_of(path, problem, tables, ledger, TABLES)


def answer_of(
    path: Path, problem: ContactProblem, fields: list[NodalField], ledger: Ledger, expected: str
) -> AnswerFile:
    """Displacements and contact pressures of the last increment that has them.

    Raises
    ------
    InvalidProblem
        Unknowns that are not called node.axis, an unknown of whose node nothing is printed, no displacement and no
        contact pressure at nodes at all.
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
    """All nodes of the last time: *NODE PRINT makes a table for each set of nodes."""
    time = max(field.time for field in fields)
    now = [field for field in fields if field.time == time]
    earlier = len({field.time for field in fields}) - 1
    if earlier:
        ledger.ignored.append(f"{what} of {earlier} earlier times")
    if len({field.components for field in now}) > 1:
        raise wrong(path, what, "the same components at all nodes", "different ones")
    values: dict[int, Values] = {}
    for field in now:
        values.update(zip(field.nodes.tolist(), field.values, strict=True))
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
        ledger.ignored.append(f"{rest} displacements that are no unknowns of the problem, none larger than {most:g}")
    return u


def _pressures(
    path: Path, problem: ContactProblem, field: NodalField, parts: dict[str, Values], ledger: Ledger
) -> None:
    """Pressures of contacts that are called by their node, if they all are."""
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
