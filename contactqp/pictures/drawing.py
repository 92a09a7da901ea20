"""Pictures of elastic bodies in contact."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from contactqp.model.arrays import Array
from contactqp.pictures import style
from contactqp.pictures.contact_fields import ContactFields
from contactqp.pictures.plane_drawing import contact_zone, draw_plane
from contactqp.pictures.space_drawing import draw_space
from contactqp.pictures.style import Colour, magnification, scale_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# [inch]: of the longer side of the bodies, and what title, legend and colour bar add.
LONG_SIDE, BESIDE, BELOW = 7.0, 2.0, 1.7
LEAST_SIDE = 2.2


def draw(
    fields: ContactFields,
    file: str | Path,
    *,
    colour: Colour = "displacement",
    scale: float | None = None,
    title: str = "",
) -> None:
    """Draw deformed bodies, coloured, with the contact pressure along the boundary and the contact points by status.

    Parameters
    ----------
    fields : ContactFields
    file : str or Path
        Ends in .png, .pdf or .svg.
    colour : "displacement" or "von mises"
        The magnitude of the displacement [length], or von Mises' stress [force / length^2].
    scale : float, optional
        How many times displacements are magnified; by default as many as make them visible, 1 where they are. The
        title says so. Gaps are those between the bodies as they are drawn: magnified bodies that met across a gap
        overlap in the picture.
    title : str
        Stands above that.

    Raises
    ------
    InvalidProblem
        Another suffix, an unknown colour, a scale that is not positive, a folder that is not there.
    BackendMissing
        matplotlib is not installed.

    Notes
    -----
    In 2D arrows show the pressure, or the force of contacts without area, and push the body that the contact nodes
    belong to; of many contacts every so many-th gets one, while the shaded bars and the maps show all. In 3D the outer
    surface is drawn facet by facet from the back to the front (the painter's algorithm: facets of very different sizes
    may cover each other wrongly), with a map of the pressure of each pairing beside it.
    """
    path = style.check_picture(file)
    style.save(figure(fields, colour=colour, scale=scale, title=title), path)


def figure(
    fields: ContactFields, *, colour: str = "displacement", scale: float | None = None, title: str = ""
) -> Figure:
    """The figure that `draw` writes."""
    label = style.colour_label(colour, fields.units)
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
    title = style.headline(
        title, scale_text(scale) if colour == "displacement" else f"von Mises stress, {scale_text(scale)}"
    )
    if fields.dimension == 3:
        return draw_space(fields, colour, label, title, scale, size)
    return _plane_figure(fields, colour, label, title, scale, points)


def _plane_figure(fields: ContactFields, colour: str, label: str, title: str, scale: float, points: Array) -> Figure:
    """All bodies, and beside them the contact zone where it is small."""
    sides = np.ptp(points, axis=0)
    width, height = np.maximum(sides / sides.max() * LONG_SIDE, LEAST_SIDE)
    zone = contact_zone(fields, scale, float(sides.max()))
    shown = [None] if zone is None else [None, zone]
    widths = [width, height][: len(shown)]
    result = style.new_figure(sum(widths) + BESIDE, height + BELOW)
    panels = result.subplots(1, len(shown), squeeze=False, width_ratios=widths)[0]
    for panel, window in zip(panels, shown, strict=True):
        coloured, handles = draw_plane(panel, fields, colour, scale, window)
    result.colorbar(coloured, ax=panels, label=label, shrink=0.9)
    result.suptitle(title)
    if zone is not None:
        panels[1].set_title("contact zone", fontsize="medium")
    style.add_legend(result, handles, columns=min(3 * len(shown), len(handles)))
    return result
