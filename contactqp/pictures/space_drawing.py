"""Pictures in space: outer surfaces of bodies or deflected membranes, and beside them maps of the contact forces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.mesh import Mesh
from contactqp.elements.obstacle import tangent_frames
from contactqp.elements.reference_elements import Block
from contactqp.model.arrays import Array, Index
from contactqp.model.problem import Units
from contactqp.pictures import style
from contactqp.pictures.contact_fields import ContactFields, PairingFields, contact_facets
from contactqp.pictures.style import cuts, edge_points, outline_points, pieces, sample

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Polygons between the nodes of a facet, in the node order of reference.REFERENCES.
_PARTS: dict[str, list[list[int]]] = {
    "tri3": [[0, 1, 2]],
    "tri6": [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]],
    "quad4": [[0, 1, 2, 3]],
    "quad8": [[0, 4, 1, 5, 2, 6, 3, 7]],
    "quad9": [[0, 4, 8, 7], [4, 1, 5, 8], [8, 5, 2, 6], [7, 8, 6, 3]],
}
# The width of the window around the loaded contacts, relative to their extent.
WIDER = 2.5
# Contacts whose unit normals have a smaller mean have no common direction, as around a hole.
NO_DIRECTION = 0.1
# Distance from a map to its legend [point], and the longest entries that fit two in a row [characters].
BELOW_AXIS, SHORT_ENTRY = 36.0, 16


def draw_map(figure: Any, axes: Any, fields: ContactFields, pairing: PairingFields) -> None:
    """Draw the map of one pairing: its contacts along their mean normal, coloured by pressure, marked by state.

    Contacts without area are coloured by their force.

    Parameters
    ----------
    figure : matplotlib figure
    axes : matplotlib axes, the part of the figure that the map is drawn to
    fields : ContactFields
    pairing : one of its pairings
    """
    from matplotlib.transforms import ScaledTranslation

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
    handles += _draw_friction(axes, fields, pairing, at, float(np.max(high_corner - low_corner)))
    axes.set_xlim(low_corner[0], high_corner[0])
    axes.set_ylim(low_corner[1], high_corner[1])
    axes.set_xlabel(f"{names[0]} [{unit}]")
    axes.set_ylabel(f"{names[1]} [{unit}]")
    largest = f"{style.number(float(np.max(shown)))} {label.partition('[')[2][:-1]}"
    axes.set_title(f"{pairing.name}: at most {largest}", fontsize="medium")
    # Below the name of the axis, however flat the map is; a long entry would reach into the scale of colours.
    below = axes.transAxes + ScaledTranslation(0.0, -BELOW_AXIS / 72, figure.dpi_scale_trans)
    place: dict[str, Any] = dict(loc="upper left", bbox_to_anchor=(0.0, 0.0), bbox_transform=below)
    longest = max(len(handle.get_label()) for handle in handles)
    axes.legend(handles=handles, **place, ncols=1 if longest > SHORT_ENTRY else 2, fontsize="small", frameon=False)


def _draw_friction(axes: Any, fields: ContactFields, pairing: PairingFields, at: Array, size: float) -> list[Any]:
    """Draw the friction on the contact nodes as arrows in the map, and return the entry of the legend."""
    friction = pairing.friction if pairing.shear is None else pairing.shear
    if friction is None or not np.nanmax(abs(friction), initial=0.0) > 0:
        return []
    shown = style.arrows_to_draw(at, np.linalg.norm(np.nan_to_num(friction), axis=1), MOST_ARROWS)
    along = np.nan_to_num(friction)[shown] @ _projection(pairing)
    largest = float(np.nanmax(np.linalg.norm(friction, axis=1)))
    look: dict[str, Any] = dict(angles="xy", scale_units="xy", scale=1.0, color=style.FRICTION, width=0.006)
    axes.quiver(*at[shown].T, *(style.ARROW * size / largest * along).T, gid="friction", zorder=5, **look)
    unit = style.force_unit(fields.units) if pairing.shear is None else style.pressure_unit(fields.units)
    return [style.line_handle(f"friction, at most {style.number(largest)} {unit}", color=style.FRICTION)]


def flattened(pairing: PairingFields) -> tuple[Array, tuple[str, str]]:
    """Return the undeformed contacts (p, 2) projected along their mean normal, and the names of the two directions."""
    projection = _projection(pairing)
    dropped = [a for a in range(3) if not np.any(projection[a])]
    if not dropped:
        return pairing.position @ projection, ("s, along the contact", "t, along the contact")
    first, second = (a for a in range(3) if a not in dropped)
    return pairing.position @ projection, ("xyz"[first], "xyz"[second])


def _projection(pairing: PairingFields) -> Array:
    """Return the two directions of a map, (3, 2).

    Where the mean normal is a coordinate axis to 1 %, that coordinate is dropped; where normals have no common
    direction, that of the shortest side is.
    """
    mean = pairing.direction.mean(axis=0)
    size = float(np.linalg.norm(mean))
    along = np.abs(mean) if size > NO_DIRECTION else -np.ptp(pairing.position, axis=0)
    axis = int(np.argmax(along))
    if size > NO_DIRECTION and along[axis] < 0.99 * size:
        return np.asarray(tangent_frames((mean / size)[np.newaxis])[0].T)
    return np.delete(np.eye(3), axis, axis=1)


def window(at: Array, value: Array) -> tuple[Array, Array]:
    """Return the lower and the upper corner of a window around the contacts under force, or around all."""
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
    """Return polygons (t, k) of contacts: the boundary facets between them, tri6 and quad9 cut at their nodes."""
    found = []
    for kind, inside in contact_facets(fields, pairing):
        parts = np.array(_PARTS[kind.name])
        found.append(inside[:, parts].reshape(-1, parts.shape[1]))
    return [polygons for polygons in found if len(polygons)]


def fans(at: Array, value: Array, polygons: list[Index]) -> tuple[Array, Array, Index]:
    """Return polygons as triangles around their middles: places (q, 2), values (q,) and triangles (t, 3)."""
    places, values, triangles, first = [at], [value], [], len(at)
    for corners in polygons:
        places.append(at[corners].mean(axis=1))
        values.append(value[corners].mean(axis=1))
        middle = np.broadcast_to(first + np.arange(len(corners))[:, np.newaxis], corners.shape)
        triangles.append(np.stack([corners, np.roll(corners, -1, axis=1), middle], axis=2).reshape(-1, 3))
        first += len(corners)
    return np.concatenate(places), np.concatenate(values), np.concatenate(triangles)


# Angles of the view [degrees]: from the left, and from above, or from below where the contact is below.
AZIMUTH, FROM_ABOVE, FROM_BELOW = -60.0, 24.0, -18.0
# Arrows of one pairing; more of them would hide the body.
MOST_ARROWS = 80
MOST_LOADS = 40
# Edges of the undeformed body are drawn where facets turn by more than this.
FEATURE = np.cos(np.radians(35.0))


def draw_space(fields: ContactFields, label: str, title: str, scale: float, size: float) -> Figure:
    """Return the figure: bodies on the left, the maps of pairings on the right.

    Parameters
    ----------
    fields : ContactFields
    label, title : the label of the colour bar, and the title
    scale : how many times displacements are magnified
    size : the largest side of the box around the undeformed bodies [length]
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    maps = [pairing for pairing in fields.pairings if len(pairing.force)]
    result = style.new_figure(13.0 if maps else 8.5, max(7.0, 3.4 * len(maps)))
    halves: Any = result.subfigures(1, 2, width_ratios=[1.5, 1.0], wspace=0.06) if maps else [result]
    left = halves[0]
    axes = left.add_subplot(projection="3d", computed_zorder=False)
    polygons, values = surface(fields, scale)
    norm = Normalize(*style.colour_range(np.concatenate(values)))
    coloured = ScalarMappable(norm, style.COLOUR_MAP)
    _draw_surface(axes, polygons, values, coloured)
    seen = [polygon.reshape(-1, 3) for polygon in polygons]
    seen += _draw_undeformed(axes, fields)
    seen += _draw_arrows(axes, fields, scale, style.ARROW * size)
    _set_axes(axes, fields, np.concatenate(seen))
    left.colorbar(coloured, ax=axes, label=label, shrink=0.6, location="left", pad=0.02)
    left.suptitle(title)
    if maps:
        panels = halves[1].subplots(len(maps), 1, squeeze=False).ravel()
        for panel, pairing in zip(panels, maps, strict=True):
            draw_map(halves[1], panel, fields, pairing)
    return result


def surface(fields: ContactFields, scale: float) -> tuple[list[Array], list[Array]]:
    """Return the deformed facets of all outer surfaces as polygons (p, q, 3), kind by kind, and displacements (p,)."""
    polygons, values = [], []
    for body in fields.bodies:
        mesh = body.body.mesh
        for block in mesh.facets_of(mesh.boundary):
            polygons.append(sample(block, body.points + scale * body.displacement, outline_points(block.kind)))
            middle = block.kind.nodes[: block.kind.corners].mean(axis=0)[np.newaxis]
            values.append(np.linalg.norm(sample(block, body.displacement, middle)[:, 0], axis=1))
    return polygons, values


def _draw_surface(axes: Any, polygons: list[Array], values: list[Array], coloured: Any) -> None:
    """Draw one collection of all bodies, so that their facets are sorted from the back to the front together."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    faces = [polygon for block in polygons for polygon in block]
    colours = coloured.to_rgba(np.concatenate(values))
    thin = float(np.clip(6.0 / np.sqrt(len(faces)), 0.08, 0.4))
    axes.add_collection3d(
        Poly3DCollection(faces, facecolors=colours, edgecolors=(0.1, 0.1, 0.1, 0.6), linewidths=thin, zorder=2)
    )


def _draw_undeformed(axes: Any, fields: ContactFields) -> list[Array]:
    """Draw the sharp edges of the undeformed bodies behind the deformed ones."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    seen = []
    for body in fields.bodies:
        mesh = body.body.mesh
        lines = [sharp_edges(block, body.points) for block in mesh.facets_of(mesh.boundary)]
        look: dict[str, Any] = dict(colors=style.UNDEFORMED, linewidths=0.8, zorder=1)
        axes.add_collection3d(Line3DCollection(np.concatenate(lines), **look))
        seen.append(body.points)
    return seen


def sharp_edges(block: Block, points: Array) -> Array:
    """Return edges (e, 2, 3) of facets where the surface turns sharply, or where facets of this kind end."""
    corners = block.nodes[:, : block.kind.corners]
    x = points[corners]
    normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    edge = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(corners)), corners.shape[1])
    order = np.lexsort(edge.T)
    edge, owner = edge[order], owner[order]
    same = np.all(edge[1:] == edge[:-1], axis=1)
    smooth = same & ((normal[owner[1:]] * normal[owner[:-1]]).sum(axis=1) > FEATURE)
    hidden = np.zeros(len(edge), dtype=bool)
    hidden[1:] |= same  # the second of a pair
    hidden[:-1] |= smooth
    return points[edge[~hidden]]


def load_arrows(fields: ContactFields, scale: float, longest: float) -> tuple[Array, Array]:
    """Return where the arrows of nodal loads end (q, d), and their vectors (q, d), the longest of that length.

    Of many loads only some of each body get an arrow.
    """
    largest = max((float(np.linalg.norm(body.load, axis=1).max(initial=0.0)) for body in fields.bodies), default=0.0)
    heads, shafts = [np.zeros((0, fields.dimension))], [np.zeros((0, fields.dimension))]
    for body in fields.bodies:
        loaded = style.arrows_to_draw(body.points, np.linalg.norm(body.load, axis=1), MOST_LOADS)
        heads.append((body.points + scale * body.displacement)[loaded])
        shafts.append(longest / largest * body.load[loaded] if largest > 0 else body.load[loaded])
    return np.concatenate(heads), np.concatenate(shafts)


def load_handle(fields: ContactFields) -> Any:
    """Return the entry of the loads in a legend, with their resultant."""
    load = np.concatenate([body.load for body in fields.bodies])
    label = style.load_label(load, ("x", "y", "z")[: fields.dimension], fields.units)
    return style.line_handle(label, color=style.LOAD, marker=">")


def _draw_arrows(axes: Any, fields: ContactFields, scale: float, longest: float) -> list[Array]:
    """Draw contact forces and loads on their bodies as arrows; pressures are in the maps."""
    heads, shafts = load_arrows(fields, scale, longest)
    look: dict[str, Any] = dict(linewidth=0.9, arrow_length_ratio=0.2, zorder=3)
    tails, handles = [], [style.line_handle("undeformed", color=style.UNDEFORMED, linewidth=0.8)]
    if len(heads):
        tails.append(heads - shafts)
        axes.quiver(*tails[-1].T, *shafts.T, color=style.LOAD, **look)
        handles.insert(0, load_handle(fields))
    largest = max((float(np.nanmax(p.force, initial=0.0)) for p in fields.pairings), default=0.0)
    for pairing in fields.pairings if largest > 0 else ():
        pushed = style.arrows_to_draw(pairing.position, pairing.force, MOST_ARROWS)
        heads = (pairing.position + scale * pairing.displacement)[pushed]
        shafts = longest / largest * pairing.force[pushed, np.newaxis] * pairing.direction[pushed]
        tails.append(heads - shafts)
        axes.quiver(*tails[-1].T, *shafts.T, color=style.PRESSURE, **look)
    if largest > 0:
        label = f"contact force of a node, longest arrow {style.number(largest)} {style.force_unit(fields.units)}"
        handles.insert(0, style.line_handle(label, color=style.PRESSURE))
    axes.legend(handles=handles, loc="lower left", fontsize="small", framealpha=0.85, edgecolor="none")
    return tails


def _set_axes(axes: Any, fields: ContactFields, seen: Array) -> None:
    unit = style.length_unit(fields.units)
    low, high = seen.min(axis=0), seen.max(axis=0)
    for name, a, b in zip("xyz", low, high, strict=True):
        getattr(axes, f"set_{name}lim")(a, b)
        getattr(axes, f"set_{name}label")(f"{name} [{unit}]")
    axes.set_proj_type("ortho")
    axes.set_box_aspect(high - low, zoom=0.92)
    axes.locator_params(nbins=5)
    axes.view_init(elev=FROM_BELOW if _seen_from_below(fields.pairings) else FROM_ABOVE, azim=AZIMUTH)


def _seen_from_below(pairings: tuple[PairingFields, ...]) -> bool:
    """Return whether the contacts push upwards on the whole: the contact side is then the lower one."""
    push = sum((pairing.direction.sum(axis=0) for pairing in pairings), np.zeros(3))
    return bool(push[2] > 0.5 * np.linalg.norm(push))


# Size of the figure of membranes [inch].
MEMBRANE_WIDTH, MEMBRANE_HEIGHT = 11.0, 5.4
# Areas of the dots of the smallest and the largest force [point^2].
DOTS = (4.0, 60.0)


@dataclass(frozen=True, eq=False)
class MembraneFields:
    """Membranes in the plane z = 0 and their p contacts.

    Attributes
    ----------
    meshes : tuple of Mesh
    deflections : tuple of (N,) arrays, displacements along z of the nodes of each mesh [length]
    position : (p, 2) array, places of the contacts in the plane [length]
    force : (p,) array, contact forces lambda_N, positive in compression [force]
    status : (p,) array of str
    units : Units
    """

    meshes: tuple[Mesh, ...]
    deflections: tuple[Array, ...]
    position: Array
    force: Array
    status: NDArray[np.str_]
    units: Units


def membrane_figure(fields: MembraneFields, *, title: str = "") -> Figure:
    """Return the figure: the surface in a scale of its own along z, and the contacts by state and force."""
    result = style.new_figure(MEMBRANE_WIDTH, MEMBRANE_HEIGHT)
    space = result.add_subplot(1, 2, 1, projection="3d")
    plane = result.add_subplot(1, 2, 2)
    coloured = _draw_membranes(space, fields)
    length = style.length_unit(fields.units)
    result.colorbar(coloured, ax=space, label=f"deflection w [{length}]", location="left", shrink=0.6)
    handles = _draw_edges(plane, fields) + _draw_force_dots(plane, fields)
    plane.set_aspect("equal")
    for axes in (space, plane):
        axes.set_xlabel(f"x [{length}]")
        axes.set_ylabel(f"y [{length}]")
    space.set_zlabel(f"w [{length}]")
    result.suptitle(style.headline(title, "deflection in a scale of its own, and contact forces seen from above"))
    style.add_legend(result, handles, columns=3)
    return result


def _draw_membranes(axes: Any, fields: MembraneFields) -> Any:
    """Draw all membranes in one range of colours."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    coloured = ScalarMappable(Normalize(*style.colour_range(np.concatenate(fields.deflections))), style.COLOUR_MAP)
    for mesh, w in zip(fields.meshes, fields.deflections, strict=True):
        for block in mesh.blocks:
            parts = pieces(block.kind, cuts(block))
            points = sample(block, np.column_stack([mesh.points, w]), parts.points)
            corners = points[:, parts.triangles].reshape(-1, 3, 3)
            _add_triangles(axes, corners, coloured)
    low, high = _box(fields)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_zlim(*coloured.get_clim())
    axes.locator_params(nbins=5)
    return coloured


def _add_triangles(axes: Any, corners: Array, coloured: Any) -> None:
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    colours = coloured.to_rgba(corners[:, :, 2].mean(axis=1))
    axes.add_collection3d(Poly3DCollection(list(corners), facecolors=colours, edgecolors="none", gid="surface"))


def _box(fields: MembraneFields) -> tuple[Array, Array]:
    points = np.concatenate([mesh.points for mesh in fields.meshes])
    return points.min(axis=0), points.max(axis=0)


def _draw_edges(axes: Any, fields: MembraneFields) -> list[Any]:
    """Draw the boundaries, and return the entry of the legend."""
    from matplotlib.collections import LineCollection

    for mesh in fields.meshes:
        for block in mesh.facets_of(mesh.boundary):
            lines = list(sample(block, mesh.points, edge_points(block)))
            axes.add_collection(LineCollection(lines, color=style.OUTLINE, linewidths=0.9, gid="boundary"))
    axes.autoscale_view()
    return [style.line_handle("edge of the membrane", color=style.OUTLINE, linewidth=0.9)]


def _draw_force_dots(axes: Any, fields: MembraneFields) -> list[Any]:
    """Draw dots whose area shows the force, and small markers of the state; return the entries of the legend."""
    largest = float(np.nanmax(fields.force, initial=0.0))
    handles = []
    for status, marker in style.MARKERS.items():
        at = fields.position[fields.status == status]
        if len(at):
            axes.scatter(*at.T, s=6.0, marker=marker.shape, facecolor=marker.face, edgecolor="black", linewidths=0.5)
            handles.append(style.marker_handle(status, style.count_label(status, len(at))))
    if largest > 0:
        pushed = np.nan_to_num(fields.force) > style.DOT * largest
        area = DOTS[0] + (DOTS[1] - DOTS[0]) * fields.force[pushed] / largest
        axes.scatter(*fields.position[pushed].T, s=area, color=style.PRESSURE, alpha=0.6, gid="forces", linewidths=0)
        label = f"contact force of a node, largest dot {style.number(largest)} {style.force_unit(fields.units)}"
        handles.append(style.line_handle(label, color=style.PRESSURE, linestyle="none", marker="o", alpha=0.6))
    return handles
