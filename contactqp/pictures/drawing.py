"""Pictures of elastic bodies in contact; in the plane with the contact pressure along the boundary.

A cross-check is drawn as the contact pressure of the other code, that of the reference, and their difference.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from contactqp.elements.reference_elements import Block
from contactqp.model.arrays import Array, Index, Vector
from contactqp.pictures import style
from contactqp.pictures.contact_fields import BodyFields, ContactFields, PairingFields, contact_facets
from contactqp.pictures.space_drawing import draw_space, load_arrows, load_handle
from contactqp.pictures.style import MANY, cuts, edge_points, edges, magnification, pieces, sample, scale_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure
from typing import TYPE_CHECKING

from contactqp.errors import InvalidProblem
from contactqp.oracle.foreign.crosscheck_verdict import CrossCheck, PairVerdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure


MARGIN = 0.04
# Arrows of one pairing; more of them would overlap.
MOST_ARROWS = 60
# Loaded contacts that extend over less than this part of the bodies get a window of their own, wider by this factor.
SMALL_ZONE, WIDER = 0.15, 3.0


@dataclass(frozen=True, eq=False)
class Triangles:
    """All bodies as one set of small triangles."""

    points: Array  # (q, 2), deformed
    triangles: Index  # (t, 3)
    values: Array  # (q,)


def triangles(fields: ContactFields, scale: float) -> Triangles:
    """Return the deformed elements of all bodies; values are displacement magnitudes."""
    points, corners, values, first = [], [], [], 0
    for body in fields.bodies:
        for block in body.body.mesh.blocks:
            parts = pieces(block.kind, cuts(block))
            x = sample(block, body.points + scale * body.displacement, parts.points)
            points.append(x.reshape(-1, 2))
            values.append(np.linalg.norm(sample(block, body.displacement, parts.points), axis=2).ravel())
            starts = first + len(parts.points) * np.arange(len(block))
            corners.append((starts[:, None, None] + parts.triangles).reshape(-1, 3))
            first += len(points[-1])
    return Triangles(np.concatenate(points), np.concatenate(corners), np.concatenate(values))


def contact_zone(fields: ContactFields, scale: float, size: float) -> Array | None:
    """Return the square [[x_low, y_low], [x_high, y_high]] around the contacts under force; None where it is large."""
    places = [(p.position + scale * p.displacement)[p.force > 0] for p in fields.pairings]
    pushed = np.concatenate([np.zeros((0, 2)), *places])
    if len(pushed) < 2:
        return None
    low, high = pushed.min(axis=0), pushed.max(axis=0)
    side = float((high - low).max())
    if not 0 < side < SMALL_ZONE * size:
        return None
    return np.asarray((low + high) / 2 + WIDER * side / 2 * np.array([[-1.0], [1.0]]))


def draw_plane(axes: Any, fields: ContactFields, scale: float, window: Array | None = None) -> tuple[Any, list[Any]]:
    """Draw all bodies and contacts in the plane.

    Parameters
    ----------
    axes : matplotlib axes
    fields : ContactFields
    scale : how many times displacements are magnified
    window : (2, 2) array, optional
        Corners of the part that is shown; all by default.

    Returns
    -------
    coloured, handles
        The artist of the colour bar, and the entries of the legend.
    """
    bodies = np.concatenate([body.points for body in fields.bodies])
    longest = style.ARROW * float(np.ptp(bodies if window is None else window, axis=0).max())
    drawn = triangles(fields, scale)
    low, high = style.colour_range(drawn.values)
    x, y = drawn.points.T
    look: dict[str, Any] = dict(shading="gouraud", cmap=style.COLOUR_MAP, vmin=low, vmax=high, rasterized=True)
    coloured = axes.tripcolor(x, y, drawn.triangles, drawn.values, **look)
    seen = [drawn.points, bodies]
    handles = [style.line_handle("undeformed", color=style.UNDEFORMED, linewidth=0.8)]
    for body in fields.bodies:
        _draw_outlines(axes, body, scale)
    for pairing in fields.pairings:
        seen += _draw_obstacle(axes, fields, pairing)
    if any(pairing.on_obstacle for pairing in fields.pairings):
        handles.append(style.line_handle("rigid obstacle", color=style.OBSTACLE, linewidth=2.5))
    for under_pressure in (True, False):
        tails, handle = _draw_arrows(axes, fields, under_pressure, scale, longest)
        seen, handles = [*seen, *tails], [*handles, *handle]
    tails, handle = _draw_loads(axes, fields, scale, longest)
    seen, handles = [*seen, *tails], [*handles, *handle, *_draw_points(axes, fields, scale)]
    _set_axes(axes, fields, np.concatenate(seen) if window is None else window)
    return coloured, handles


def _draw_outlines(axes: Any, body: BodyFields, scale: float) -> None:
    """Draw the undeformed boundary in grey, the deformed one in black, and thin lines between elements."""
    mesh, deformed = body.body.mesh, body.points + scale * body.displacement
    boundary = mesh.facets_of(mesh.boundary)
    # Thinner lines for finer meshes, so that the colour stays visible.
    thin = float(np.clip(8.0 / np.sqrt(mesh.elements), 0.06, 0.4))
    _add_lines(axes, boundary, body.points, "undeformed", color=style.UNDEFORMED, linewidths=0.8)
    if mesh.elements <= MANY:
        _add_lines(axes, edges(mesh), deformed, "elements", color=style.OUTLINE, linewidths=thin)
    _add_lines(axes, boundary, deformed, "deformed", color=style.OUTLINE, linewidths=0.9)


def _add_lines(axes: Any, blocks: tuple[Block, ...], points: Array, name: str, **look: Any) -> None:
    from matplotlib.collections import LineCollection

    for block in blocks:
        axes.add_collection(
            LineCollection(list(sample(block, points, edge_points(block))), gid=name, **look), autolim=False
        )


def segments(fields: ContactFields, pairing: PairingFields) -> Index:
    """Return the pairs of contacts (s, 2) at neighbouring nodes on the boundary of their body."""
    found = [np.zeros((0, 2), dtype=np.int64)]
    for kind, inside in contact_facets(fields, pairing):
        along = inside[:, [0, 2, 1]] if kind.name == "line3" else inside
        found += [along[:, i : i + 2] for i in range(along.shape[1] - 1)]
    return np.concatenate(found)


def _draw_obstacle(axes: Any, fields: ContactFields, pairing: PairingFields) -> list[Array]:
    """Draw the part of a rigid obstacle that faces the contacts, x - gap n, and return its points."""
    from matplotlib.collections import LineCollection

    if not pairing.on_obstacle:
        return []
    feet = pairing.position - pairing.initial_gap[:, np.newaxis] * pairing.direction
    look: dict[str, Any] = dict(color=style.OBSTACLE, linewidths=2.5, capstyle="round", zorder=1.5, gid="obstacle")
    axes.add_collection(LineCollection(list(feet[segments(fields, pairing)]), **look), autolim=False)
    return [feet]


def _draw_arrows(
    axes: Any, fields: ContactFields, under_pressure: bool, scale: float, longest: float
) -> tuple[list[Array], list[Any]]:
    """Draw pressures, or forces of contacts without area, as arrows; return their tails and the legend entries.

    The arrows include friction, the shaded bars show the pressure alone.
    """
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Patch

    chosen = [pairing for pairing in fields.pairings if (pairing.pressure is not None) == under_pressure]
    values = [pairing.force if pairing.pressure is None else pairing.pressure for pairing in chosen]
    largest = max((float(np.nanmax(v, initial=0.0)) for v in values), default=0.0)
    if largest <= 0:
        return [], []
    tails, tilted = [], False
    for pairing, value in zip(chosen, values, strict=True):
        heads = pairing.position + scale * pairing.displacement
        shafts = longest / largest * np.nan_to_num(value)[:, np.newaxis] * pairing.direction
        if under_pressure:
            both = segments(fields, pairing)
            i, j = both[np.isfinite(value[both]).all(axis=1)].T
            bars = np.stack([heads[i], heads[j], (heads - shafts)[j], (heads - shafts)[i]], axis=1)
            look: dict[str, Any] = dict(facecolor=style.PRESSURE, alpha=0.3, edgecolor="none", zorder=3, gid="pressure")
            axes.add_collection(PolyCollection(list(bars), **look), autolim=False)
        dragged = pairing.shear if under_pressure else pairing.friction
        if dragged is not None:
            shafts += longest / largest * np.nan_to_num(dragged)
            tilted = tilted or bool(np.any(np.nan_to_num(dragged)))
        tails.append(heads - shafts)
        pushed = style.arrows_to_draw(pairing.position, value, MOST_ARROWS)
        starts, arrows = tails[-1][pushed].T, shafts[pushed].T
        unscaled: dict[str, Any] = dict(
            angles="xy", scale_units="xy", scale=1.0, color=style.PRESSURE, width=0.003, zorder=3.5
        )
        axes.quiver(*starts, *arrows, gid="pressure arrows" if under_pressure else "force arrows", **unscaled)
    unit = style.pressure_unit(fields.units) if under_pressure else style.force_unit(fields.units)
    name = "contact pressure" if under_pressure else "contact force of a point"
    label = f"{name}, at most {style.number(largest)} {unit}{', friction tilts arrows' if tilted else ''}"
    handle = (
        Patch(facecolor=style.PRESSURE, alpha=0.5, label=label)
        if under_pressure
        else style.line_handle(label, color=style.PRESSURE, marker=">")
    )
    return tails, [handle]


def _draw_loads(axes: Any, fields: ContactFields, scale: float, longest: float) -> tuple[list[Array], list[Any]]:
    """Draw nodal loads as arrows that end at their nodes; return their tails and the legend entry."""
    heads, shafts = load_arrows(fields, scale, longest)
    if not len(heads):
        return [], []
    look: dict[str, Any] = dict(angles="xy", scale_units="xy", scale=1.0, color=style.LOAD, width=0.003, zorder=3.5)
    axes.quiver(*(heads - shafts).T, *shafts.T, gid="loads", **look)
    return [heads - shafts], [load_handle(fields)]


def _draw_points(axes: Any, fields: ContactFields, scale: float) -> list[Any]:
    """Draw the contact points by state, and return the entries of the legend with their counts."""
    if not fields.pairings:
        return []
    places = np.concatenate([p.position + scale * p.displacement for p in fields.pairings])
    statuses = np.concatenate([p.status for p in fields.pairings])
    handles = []
    area = float(np.clip(900.0 / max(len(places), 1), 4.0, 22.0))
    for status, marker in style.MARKERS.items():
        at = places[statuses == status]
        if len(at):
            look: dict[str, Any] = dict(
                marker=marker.shape, facecolor=marker.face, edgecolor="black", linewidths=0.6, zorder=4
            )
            axes.scatter(*at.T, s=area, gid=status, **look)
            handles.append(style.marker_handle(status, style.count_label(status, len(at))))
    return handles


def _set_axes(axes: Any, fields: ContactFields, seen: Array) -> None:
    unit = style.length_unit(fields.units)
    round_ = any(body.body.model == "axisymmetric" for body in fields.bodies)
    axes.set_xlabel(f"{'radius r' if round_ else 'x'} [{unit}]")
    axes.set_ylabel(f"{'axis of symmetry y' if round_ else 'y'} [{unit}]")
    axes.set_aspect("equal")
    low, high = seen.min(axis=0), seen.max(axis=0)
    margin = MARGIN * max(high - low)
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    if round_ and low[0] - margin <= 0:
        axes.axvline(0.0, color="black", linestyle="-.", linewidth=0.8, zorder=0.5)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


# Sizes of the figure [inch]: the longer side of the bodies, and what title, legend and colour bar add.
LONG_SIDE, BESIDE, BELOW = 7.0, 2.0, 1.7
LEAST_SIDE = 2.2


def figure(fields: ContactFields, *, scale: float | None = None, title: str = "") -> Figure:
    """Draw deformed bodies, coloured, with loads, contact pressure along the boundary, and contact points by state.

    Parameters
    ----------
    fields : ContactFields
    scale : float, optional
        The factor by which displacements are magnified; by default it makes them visible, and is 1 where they are
        visible as they are. The title states it. Gaps are drawn between the magnified bodies, so that bodies that met
        across a gap overlap in the picture.
    title : str
        The title of the picture.

    Raises
    ------
    InvalidProblem
        The scale is not positive.

    Notes
    -----
    In 2D arrows show the pressure, or the force of contacts without area, and push the body that the contact nodes
    belong to; of many contacts only some get an arrow, while the shaded bars and the maps show all. In 3D the outer
    surface is drawn facet by facet from the back to the front (the painter's algorithm: facets of very different sizes
    may cover each other wrongly), with a map of the pressure of each pairing beside it.
    """
    points = np.concatenate([body.points for body in fields.bodies])
    size = float(np.ptp(points, axis=0).max())
    none = np.zeros(0)
    scale = magnification(
        scale,
        size,
        np.concatenate([body.displacement for body in fields.bodies]),
        np.concatenate([none, *[pairing.initial_gap for pairing in fields.pairings]]),
        np.concatenate([none, *[pairing.gap for pairing in fields.pairings]]),
    )
    title = style.headline(title, scale_text(scale))
    label = f"displacement, magnitude [{style.length_unit(fields.units)}]"
    if fields.dimension == 3:
        return draw_space(fields, label, title, scale, size)
    return _plane_figure(fields, label, title, scale, points)


def _plane_figure(fields: ContactFields, label: str, title: str, scale: float, points: Array) -> Figure:
    """Return the figure of all bodies, and beside them the contact zone where it is small."""
    sides = np.ptp(points, axis=0)
    width, height = np.maximum(sides / sides.max() * LONG_SIDE, LEAST_SIDE)
    zone = contact_zone(fields, scale, float(sides.max()))
    shown = [None] if zone is None else [None, zone]
    widths = [width, height][: len(shown)]
    result = style.new_figure(sum(widths) + BESIDE, height + BELOW)
    panels = result.subplots(1, len(shown), squeeze=False, width_ratios=widths)[0]
    for panel, window in zip(panels, shown, strict=True):
        coloured, handles = draw_plane(panel, fields, scale, window)
    result.colorbar(coloured, ax=panels, label=label, shrink=0.9)
    result.suptitle(title)
    if zone is not None:
        panels[1].set_title("contact zone", fontsize="medium")
    style.add_legend(result, handles, columns=min(3 * len(shown), len(handles)))
    return result


WIDTH, HEIGHT = 10.0, 3.2
DOT = 40.0


def draw_crosscheck(found: CrossCheck, file: str | Path) -> None:
    """Draw the pressures of a cross-check to a file, a row of three pictures for each contact pair.

    In the plane they are drawn along the surface, in space from the direction in which the slave nodes spread least.

    Raises InvalidProblem: the suffix is unknown, the folder does not exist, or the deck has no contact pairs;
    BackendMissing: matplotlib is not installed.

    Parameters
    ----------
    found : CrossCheck
    file : str or Path
        A file that ends in .png, .pdf or .svg.
    """
    path = style.check_picture(file)
    pairs = [pair for pair in found.pairs if len(pair.labels)]
    if not pairs:
        raise InvalidProblem(f"{found.deck}: expected a deck with contact pairs whose nodes can move, got none")
    style.save(crosscheck_figure(found, pairs), path)


def crosscheck_figure(found: CrossCheck, pairs: list[PairVerdict]) -> Figure:
    """Return the figure that `draw_crosscheck` writes."""
    figure = style.new_figure(WIDTH, HEIGHT * len(pairs))
    axes = np.atleast_2d(figure.subplots(len(pairs), 3, squeeze=False))
    for row, pair in zip(axes, pairs, strict=True):
        theirs, right = pair.pressure, pair.reference_pressure
        both = np.concatenate([theirs, right])
        unit = f" [{style.pressure_unit(found.units)}]" if found.units.length else ""
        titles = (f"pressure by {style.plain(found.code)}{unit}", f"pressure, {found.reference}{unit}", "difference")
        fields = ((theirs, both), (right, both), (theirs - right, theirs - right))
        for at, (values, among), title in zip(row, fields, titles, strict=True):
            _draw(figure, at, pair, values, among)
            at.set_title(title, fontsize="medium")
            at.set_xlabel(f"along the surface{f' [{found.units.length}]' if found.units.length else ''}")
        row[0].set_ylabel(f"{style.plain(pair.name)}: {pair.word}")
    return figure


def _draw(figure: Figure, axes: Any, pair: PairVerdict, values: Vector, among: Vector) -> None:
    """Draw one field over the slave nodes on the scale of others: a line in the plane, dots in space."""
    flat = _flattened(pair.points)
    if pair.points.shape[1] == 2:
        order = np.argsort(flat[:, 0], kind="stable")
        axes.plot(flat[order, 0], values[order], marker="o")
        low, high = min(float(among.min()), 0.0), max(float(among.max()), 0.0)
        room = 0.1 * (high - low) or 1.0
        axes.set_ylim(low - room, high + room)
        return
    bound = float(abs(among).max()) or 1.0
    colours = {"cmap": "RdBu_r", "vmin": -bound, "vmax": bound, "edgecolors": "0.5", "linewidths": 0.4}
    dots = axes.scatter(flat[:, 0], flat[:, 1], c=values, s=DOT, **colours)
    axes.margins(0.1)
    axes.set_aspect("equal", adjustable="datalim")
    figure.colorbar(dots, ax=axes)


def _flattened(points: Array) -> Array:
    """Return the coordinates (m, d) along the directions in which the points spread most, the first one first."""
    apart = points - points.mean(axis=0)
    _, _, directions = np.linalg.svd(apart, full_matrices=True)
    return np.asarray(apart @ directions.T)
