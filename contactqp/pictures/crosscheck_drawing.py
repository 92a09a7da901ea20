"""Pictures of a cross-check: the contact pressure of the other code, that of the reference, and their difference."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Array, Vector
from contactqp.oracle.foreign.crosscheck_verdict import CrossCheck, PairVerdict
from contactqp.pictures import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH, HEIGHT = 10.0, 3.2
DOT = 40.0


def draw_crosscheck(found: CrossCheck, file: str | Path) -> None:
    """Draw the pressures of a cross-check to a file, a row of three pictures for each contact pair.

    In the plane they are drawn along the surface, in space from the direction in which the slave nodes spread least.

    Parameters
    ----------
    found : CrossCheck
    file : str or Path
        A file that ends in .png, .pdf or .svg.

    Raises
    ------
    InvalidProblem
        The suffix is unknown, the folder does not exist, or the deck has no contact pairs.
    BackendMissing
        matplotlib is not installed.
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
        area = np.where(pair.area > 0, pair.area, np.inf)
        theirs, right = pair.force / area, pair.reference_force / area
        both = np.concatenate([theirs, right])
        titles = (f"pressure by {style.plain(found.code)}", f"pressure, {found.reference}", "difference")
        fields = ((theirs, both), (right, both), (theirs - right, theirs - right))
        for at, (values, among), title in zip(row, fields, titles, strict=True):
            _draw(figure, at, pair, values, among)
            at.set_title(title)
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
        axes.set_xlabel("along the surface")
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
