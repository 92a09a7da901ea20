"""A map of one pairing in space: its contacts seen along their mean normal, coloured by pressure, marked by status."""

from __future__ import annotations

from typing import Any

import numpy as np

from contactqp.elements.obstacle import tangent_frames
from contactqp.model.arrays import Array, Index
from contactqp.pictures import style
from contactqp.pictures.contact_fields import ContactFields, PairingFields

# Polygons between the nodes of a facet, in the node order of reference.REFERENCES.
_PARTS: dict[str, list[list[int]]] = {
    "tri3": [[0, 1, 2]],
    "tri6": [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]],
    "quad4": [[0, 1, 2, 3]],
    "quad8": [[0, 4, 1, 5, 2, 6, 3, 7]],
    "quad9": [[0, 4, 8, 7], [4, 1, 5, 8], [8, 5, 2, 6], [7, 8, 6, 3]],
}
# Contacts under force are looked at in a window so many times wider than they spread.
WIDER = 2.5
# Below this mean of their unit normals contacts have no common direction, as around a hole.
NO_DIRECTION = 0.1


def draw_map(figure: Any, axes: Any, fields: ContactFields, pairing: PairingFields) -> None:
    """Pressure, or the force of contacts without area, at the undeformed contacts."""
    at, names = flattened(pairing)
    unit = style.length_unit(fields.units)
    if pairing.pressure is None:
        value, label = pairing.force, f"contact force of a point [{style.force_unit(fields.units)}]"
    else:
        value, label = pairing.pressure, f"contact pressure [{style.pressure_unit(fields.units)}]"
    shown = np.nan_to_num(value)
    low, high = 0.0, style.colour_range(shown)[1]
    polygons = facets(fields, pairing)
    look: dict[str, Any] = dict(cmap="OrRd", vmin=low, vmax=high)
    if polygons and pairing.pressure is not None:
        places, values, triangles = fans(at, shown, polygons)
        coloured = axes.tripcolor(*places.T, triangles, values, shading="gouraud", rasterized=True, **look)
    else:
        coloured = axes.scatter(*at.T, c=shown, s=30, **look)
    size = float(np.clip(1500.0 / len(at), 2.0, 16.0))
    handles = []
    for status, marker in style.MARKERS.items():
        chosen = at[pairing.status == status]
        if len(chosen):
            points: dict[str, Any] = dict(
                marker=marker.shape, facecolor=marker.face, edgecolor="black", linewidths=0.5, zorder=4
            )
            axes.scatter(*chosen.T, s=size, gid=status, **points)
            handles.append(style.marker_handle(status, style.count_label(status, len(chosen))))
    figure.colorbar(coloured, ax=axes, label=label, shrink=0.6)
    axes.set_aspect("equal")
    low_corner, high_corner = window(at, shown)
    axes.set_xlim(low_corner[0], high_corner[0])
    axes.set_ylim(low_corner[1], high_corner[1])
    axes.set_xlabel(f"{names[0]} [{unit}]")
    axes.set_ylabel(f"{names[1]} [{unit}]")
    largest = f"{style.number(float(np.max(shown)))} {label.partition('[')[2][:-1]}"
    axes.set_title(f"{pairing.name}: at most {largest}", fontsize="medium")
    axes.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(0.0, -0.16), ncols=3, fontsize="small", frameon=False
    )


def flattened(pairing: PairingFields) -> tuple[Array, tuple[str, str]]:
    """The undeformed contacts (p, 2) on the plane across their mean normal, and what its directions are called.

    An axis that is the normal to 1 % is left out; so is, where normals have no common direction, the shortest side.
    """
    mean = pairing.direction.mean(axis=0)
    size = float(np.linalg.norm(mean))
    along = np.abs(mean) if size > NO_DIRECTION else -np.ptp(pairing.position, axis=0)
    axis = int(np.argmax(along))
    if size > NO_DIRECTION and along[axis] < 0.99 * size:
        frame = tangent_frames((mean / size)[np.newaxis])[0]
        return pairing.position @ frame.T, ("s, along the contact", "t, along the contact")
    kept = [a for a in range(3) if a != axis]
    return pairing.position[:, kept], ("xyz"[kept[0]], "xyz"[kept[1]])


def window(at: Array, value: Array) -> tuple[Array, Array]:
    """The lower and the upper corner of what is worth looking at: around the contacts under force, or all."""
    pushed = at[value > 0]
    low, high = at.min(axis=0), at.max(axis=0)
    margin = 0.06 * float((high - low).max())
    if len(pushed):
        spread = float(np.ptp(pushed, axis=0).max())
        if spread > 0:
            middle = (pushed.min(axis=0) + pushed.max(axis=0)) / 2
            low, high = (np.maximum(low, middle - WIDER * spread / 2), np.minimum(high, middle + WIDER * spread / 2))
            margin = 0.06 * float((high - low).max())
    return low - margin, high + margin


def facets(fields: ContactFields, pairing: PairingFields) -> list[Index]:
    """Polygons (t, k) of contacts: the boundary facets between them, tri6 and quad9 cut at their nodes."""
    found = []
    for number in np.unique(pairing.body):
        mesh = fields.bodies[number].body.mesh
        contact = np.full(len(mesh.points), -1)
        mine = np.flatnonzero(pairing.body == number)
        contact[pairing.node[mine]] = mine
        for block in mesh.facets_of(mesh.boundary):
            here = contact[block.nodes]
            inside = here[(here >= 0).all(axis=1)]
            parts = np.array(_PARTS[block.kind.name])
            found.append(inside[:, parts].reshape(-1, parts.shape[1]))
    return [polygons for polygons in found if len(polygons)]


def fans(at: Array, value: Array, polygons: list[Index]) -> tuple[Array, Array, Index]:
    """Polygons as triangles around their middles: places (q, 2), values (q,) and triangles (t, 3)."""
    places, values, triangles, first = [at], [value], [], len(at)
    for corners in polygons:
        places.append(at[corners].mean(axis=1))
        values.append(value[corners].mean(axis=1))
        middle = np.broadcast_to(first + np.arange(len(corners))[:, np.newaxis], corners.shape)
        triangles.append(np.stack([corners, np.roll(corners, -1, axis=1), middle], axis=2).reshape(-1, 3))
        first += len(corners)
    return np.concatenate(places), np.concatenate(values), np.concatenate(triangles)
