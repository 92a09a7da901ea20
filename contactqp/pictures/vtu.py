"""Solutions for ParaView: one VTU file of all bodies or members, with fields at the nodes.

    displacement            3 components [length]; 0 along axes that the problem does not have
    stress                  xx, yy, zz, xy, yz, zx, tension positive [force / length^2] (elastic bodies)
    von_mises               [force / length^2] (elastic bodies)
    contact_force           3 components: what contact does to the body at the node [force]; 0 away from contact
    contact_normal_force    lambda_N of the node's contact, positive in compression [force]
    contact_pressure        lambda_N per area [force / length^2] (elastic bodies)
    contact_gap             under the load, positive when open [length]
    contact_status (...)    a whole number; the name of the field says what it means

The normal force, pressure and gap are NaN at nodes without a contact and where they are unknown, as 0 would mean a
closed contact without force. ParaView shows NaN in a separate colour. A node with several contacts shows the one with
the smallest gap and, of those, the largest force. Contacts of a mortar or of nodes with segments stand at the nodes of
the slave surface; `contact_force` acts on both surfaces.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.mesh_files import MESHIO_KINDS
from contactqp.exchange.files import VTU, check_file, check_installed, write_whole
from contactqp.model.arrays import Array, Index
from contactqp.model.coulomb import STATUS_WORDS
from contactqp.pictures.contact_fields import ContactFields
from contactqp.pictures.frame_drawing import FrameFields

STATUS = {word: code for code, word in enumerate(("none", *STATUS_WORDS, "held"), start=-1)}
STATUS_FIELD = f"contact_status ({', '.join(f'{code} {name}' for name, code in STATUS.items())})"
_CELLS = {kind: name for name, kind in MESHIO_KINDS.items()}


def write_vtu(fields: ContactFields | FrameFields, file: str | Path) -> None:
    """Write the fields to a VTU file for ParaView; the head of this module lists them.

    Elastic bodies have the cell field `body`, the place of the body among ContactFields.bodies. Members are lines
    between their nodes (beams too: their points in between are not written), and every node is a vertex.

    Raises InvalidProblem: the suffix is another one, or the folder does not exist; BackendMissing: meshlane is not
    installed.

    Parameters
    ----------
    fields : ContactFields or FrameFields
    file : str or Path
        A file that ends in .vtu.
    """
    path = check_vtu(file)
    meshlane: Any = importlib.import_module("meshlane")
    data = _body_data(fields) if isinstance(fields, ContactFields) else _frame_data(fields)
    mesh = meshlane.Mesh(data.points, data.cells, point_data=data.at_points, cell_data=data.at_cells)
    write_whole(path, lambda beside: mesh.write(beside, file_format="vtu"))


def check_vtu(file: str | Path) -> Path:
    """Return the file as a path if a VTU file can be written to it; raises as `write_vtu`."""
    path = check_file(file, VTU)
    check_installed("meshlane", f"writing {path.name}")
    return path


@dataclass(frozen=True, eq=False)
class _Data:
    """The arguments of meshlane.Mesh."""

    points: Array
    cells: list[tuple[str, Index]]
    at_points: dict[str, NDArray[Any]]
    at_cells: dict[str, list[Index]]


@dataclass(frozen=True, eq=False)
class _Contacts:
    """Contacts, with the number of their node among all points."""

    node: Index
    gap: Array
    force: Array
    pressure: Array
    status: Index


def _body_data(fields: ContactFields) -> _Data:
    first = np.cumsum([0, *[len(body.points) for body in fields.bodies]])
    cells: dict[str, list[tuple[int, Index]]] = {}
    for number, body in enumerate(fields.bodies):
        for block in body.body.mesh.blocks:
            cells.setdefault(_CELLS[block.kind.name], []).append((number, block.nodes + first[number]))
    axes = list(range(fields.dimension))
    contacts = [
        _Contacts(
            first[p.body] + p.node,
            p.gap,
            p.force,
            np.full(len(p.gap), np.nan) if p.pressure is None else p.pressure,
            np.array([STATUS[name] for name in p.status], dtype=np.int64),
        )
        for p in fields.pairings
    ]
    at_points = {
        "displacement": _padded(np.concatenate([body.displacement for body in fields.bodies]), axes),
        "stress": np.concatenate([body.stress for body in fields.bodies]),
        "von_mises": np.concatenate([body.von_mises for body in fields.bodies]),
        "contact_force": _padded(np.concatenate([body.contact_force for body in fields.bodies]), axes),
        **_at_points(contacts, int(first[-1]), pressure=True),
    }
    return _Data(
        points=_padded(np.concatenate([body.points for body in fields.bodies]), axes),
        cells=[(kind, np.concatenate([nodes for _, nodes in found])) for kind, found in cells.items()],
        at_points=at_points,
        at_cells={"body": [np.repeat([n for n, _ in found], [len(c) for _, c in found]) for found in cells.values()]},
    )


def _frame_data(fields: FrameFields) -> _Data:
    count, axes = len(fields.nodes), ["xyz".index(axis) for axis in fields.axes]
    pairs = [pair for member in fields.members for pair in zip(member.nodes[:-1], member.nodes[1:], strict=True)]
    cells = [("line", np.array(pairs, dtype=np.int64))] if pairs else []
    forces = np.zeros(fields.position.shape)
    for contact in fields.contacts:
        forces[list(contact.nodes)] += contact.force * contact.push
    each = [(node, contact) for contact in fields.contacts for node in contact.nodes]
    contacts = _Contacts(
        np.array([node for node, _ in each], dtype=np.int64),
        np.array([contact.gap for _, contact in each]),
        np.array([contact.force for _, contact in each]),
        np.full(len(each), np.nan),
        np.array([STATUS[contact.status] for _, contact in each], dtype=np.int64),
    )
    at_points = {
        "displacement": _padded(fields.displacement, axes),
        "contact_force": _padded(forces, axes),
        **_at_points([contacts], count, pressure=False),
    }
    vertices = ("vertex", np.arange(count)[:, np.newaxis])
    return _Data(_padded(fields.position, axes), [*cells, vertices], at_points, {})


def _at_points(contacts: list[_Contacts], count: int, *, pressure: bool) -> dict[str, NDArray[Any]]:
    """Return the fields of the contact that governs each node, NaN and "none" where there is none."""
    nothing = np.zeros(0)
    node = np.concatenate([nothing.astype(np.int64), *[c.node for c in contacts]])
    values = {
        "contact_normal_force": np.concatenate([nothing, *[c.force for c in contacts]]),
        "contact_pressure": np.concatenate([nothing, *[c.pressure for c in contacts]]),
        "contact_gap": np.concatenate([nothing, *[c.gap for c in contacts]]),
    }
    if not pressure:
        del values["contact_pressure"]
    status = np.concatenate([nothing.astype(np.int64), *[c.status for c in contacts]])
    # The governing contact comes last, so that it is the one that stays.
    order = np.lexsort([np.nan_to_num(values["contact_normal_force"]), -values["contact_gap"]])
    found: dict[str, NDArray[Any]] = {}
    for name, value in values.items():
        found[name] = np.full(count, np.nan)
        found[name][node[order]] = value[order]
    found[STATUS_FIELD] = np.full(count, STATUS["none"], dtype=np.int64)
    found[STATUS_FIELD][node[order]] = status[order]
    return found


def _padded(vectors: Array, axes: list[int]) -> Array:
    """Return (N, d) components along some of x, y, z as (N, 3)."""
    full = np.zeros((len(vectors), 3))
    full[:, axes] = vectors
    return full
