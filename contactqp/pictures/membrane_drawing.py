"""Pictures of membranes: the deflected surface, and beside it a map of the contact forces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.mesh import Mesh
from contactqp.model.arrays import Array
from contactqp.model.problem import Units
from contactqp.pictures import style
from contactqp.pictures.contact_fields import cuts, edge_points, pieces, sample

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# [inch]
WIDTH, HEIGHT = 11.0, 5.4
# Of the smallest and the largest force, as areas of their dots [point^2].
DOTS = (4.0, 60.0)


@dataclass(frozen=True, eq=False)
class MembraneFields:
    """Membranes in the plane z = 0 and their p contacts.

    Attributes
    ----------
    meshes : tuple of Mesh
    deflections : tuple of (N,) arrays
        Along z, of the nodes of each mesh [length].
    position : (p, 2) array
        The contacts, in the plane [length].
    force : (p,) array
        lambda_N, positive in compression [force].
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
    """The surface on the left, in its own scale along z; the contacts by status and force on the right."""
    result = style.new_figure(WIDTH, HEIGHT)
    space = result.add_subplot(1, 2, 1, projection="3d")
    plane = result.add_subplot(1, 2, 2)
    coloured = _draw_surface(space, fields)
    length = style.length_unit(fields.units)
    result.colorbar(coloured, ax=space, label=f"deflection w [{length}]", location="left", shrink=0.6)
    handles = _draw_edges(plane, fields) + _draw_forces(plane, fields)
    plane.set_aspect("equal")
    for axes in (space, plane):
        axes.set_xlabel(f"x [{length}]")
        axes.set_ylabel(f"y [{length}]")
    space.set_zlabel(f"w [{length}]")
    result.suptitle(style.headline(title, "deflection in a scale of its own, and contact forces seen from above"))
    style.add_legend(result, handles, columns=3)
    return result


def _draw_surface(axes: Any, fields: MembraneFields) -> Any:
    """All membranes in one range of colours."""
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
    """The boundaries."""
    from matplotlib.collections import LineCollection

    for mesh in fields.meshes:
        for block in mesh.facets_of(mesh.boundary):
            lines = list(sample(block, mesh.points, edge_points(block)))
            axes.add_collection(LineCollection(lines, color=style.OUTLINE, linewidths=0.9, gid="boundary"))
    axes.autoscale_view()
    return [style.line_handle("edge of the membrane", color=style.OUTLINE, linewidth=0.9)]


def _draw_forces(axes: Any, fields: MembraneFields) -> list[Any]:
    """Dots as large as the force, orange where there is one, and small markers of the status."""
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
