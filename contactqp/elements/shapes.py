"""Meshes of simple shapes: structured, graded towards where contact is expected, with named sides.

All lengths are in [length]. `kind` is any kind of element of the shape's dimension. `grading` >= 1 is the ratio of the
largest to the smallest element along a direction; sizes grow geometrically. Curved sides carry all their nodes on the
exact curve. Every function raises InvalidProblem for an invalid length, number of divisions or grading.

    rectangle, box                   sides left right (x), front back (y, 3D), bottom top (the last axis); a box may
                                     have a crowned bottom, a paraboloid
    disc, half_disc, quarter_disc    side arc; half_disc is the lower half, with the flat side top (y = 0);
                                     quarter_disc is its right half, with the sides top and left (x = 0)
    cylinder                         axis z; sides bottom, top, side; a half is y >= 0, with front (y = 0);
                                     a quarter also x >= 0, with left (x = 0)
    ball                             side sphere; a half is the lower one, with top (z = 0); a quarter also x >= 0,
                                     with left (x = 0); an eighth also y >= 0, with front (y = 0)

Discs and balls are graded towards their pole, the lowest point, which is the node set ``"pole"``. They are O-grids: a
rounded square or cubic core, and layers from its faces to the circle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from inspect import signature
from typing import Any, Literal, ParamSpec, Protocol, cast

import numpy as np

from contactqp.elements.mesh import Mesh
from contactqp.elements.mesh_files import Lattice, Patch
from contactqp.errors import InvalidProblem, shown
from contactqp.model.arguments import checked
from contactqp.model.arrays import Array, Index, Mask
from contactqp.model.problem_data import is_whole

P = ParamSpec("P")
Part = Literal["full", "half", "quarter", "eighth"]
Half = Literal["full", "positive", "negative"]
Towards = Literal["low", "high", "both", "middle"]
_AXIS_SIDES = {2: (("left", "right"), ("bottom", "top")), 3: (("left", "right"), ("front", "back"), ("bottom", "top"))}
_CYLINDER_PARTS: dict[str, tuple[Half, ...]] = {
    "full": ("full", "full"),
    "half": ("full", "positive"),
    "quarter": ("positive", "positive"),
}
_BALL_PARTS: dict[str, tuple[Half, ...]] = {
    "full": ("full", "full", "full"),
    "half": ("full", "full", "negative"),
    "quarter": ("positive", "full", "negative"),
    "eighth": ("positive", "positive", "negative"),
}
# Half-width of the core over the radius, and how round it is (0 square, 1 circular): at these the angles of a
# uniform disc's cells lie between 68 and 127 degrees.
CORE, ROUNDNESS = 0.5, 0.5


class Shape(Protocol[P]):
    """A function that returns the mesh of a shape; its attribute `lattice` returns the description of that mesh."""

    lattice: Callable[P, Lattice]

    def __call__(self, *args: P.args, **options: P.kwargs) -> Mesh:
        """Return the mesh."""


def _shape(function: Callable[P, Lattice]) -> Shape[P]:
    lattice = checked(function)

    @wraps(lattice)
    def mesh(*args: P.args, **options: P.kwargs) -> Mesh:
        return lattice(*args, **options).mesh()

    found: Any = mesh
    found.lattice = lattice
    found.__signature__ = signature(lattice).replace(return_annotation="Mesh")
    return cast(Shape[P], found)


@_shape
def rectangle(
    width: float,
    height: float,
    divisions: tuple[int, int],
    kind: str = "quad4",
    *,
    grading: float = 1.0,
    towards: Sequence[str] = ("bottom",),
    corner: tuple[float, float] = (0.0, 0.0),
) -> Lattice:
    """Mesh the rectangle from `corner`, its lowest x and y, to corner + (width, height).

    Its sides are ``"left"``, ``"right"``, ``"bottom"`` and ``"top"``.

    Parameters
    ----------
    width, height : float
        Lengths along x and y [length].
    divisions : (int, int)
        Cells along x and y.
    kind : str
        Kind of element: ``"quad4"``, ``"quad8"``, ``"quad9"``, or ``"tri3"``, ``"tri6"``, two of which make a cell.
    grading : float
        The largest over the smallest element, at least 1.
    towards : sequence of str
        The sides towards which elements get smaller; ``"middle"`` is the middle of the width.
    corner : (float, float)
        Lowest x and y [length].

    >>> mesh = rectangle(2.0, 1.0, (4, 2), "tri6")
    >>> mesh.elements, round(mesh.volume(), 12)
    (16, 2.0)
    """
    return _box((width, height), divisions, kind, grading, towards, corner)


@_shape
def box(
    lengths: tuple[float, float, float],
    divisions: tuple[int, int, int],
    kind: str = "hex8",
    *,
    grading: float = 1.0,
    towards: Sequence[str] = ("bottom",),
    corner: tuple[float, float, float] = (0.0, 0.0, 0.0),
    crown: float | None = None,
) -> Lattice:
    """Mesh the box from `corner`, its lowest coordinates, to corner + lengths.

    Its sides are ``"left"`` and ``"right"`` along x, ``"front"`` and ``"back"`` along y, ``"bottom"`` and ``"top"``
    along z. With `crown`, the radius of curvature on the axis x = y = 0, the bottom is higher than there by
    (x^2 + y^2) / (2 crown), and what is above by a part of that which falls linearly to 0 at the flat top.

    Parameters
    ----------
    lengths : (float, float, float)
        Lengths along x, y and z [length].
    divisions : (int, int, int)
        Cells along x, y and z.
    kind : str
        Kind of element: ``"hex8"``, ``"hex20"``, ``"hex27"``, or ``"tet4"``, ``"tet10"``, six of which make a cell.
    grading, towards : float, sequence of str
        As for `rectangle`; ``"middle"`` is the middle in x and in y.
    corner : (float, float, float)
        Lowest x, y and z [length].
    crown : float, optional
        Radius of curvature of the bottom [length].

    >>> mesh = box((1.0, 2.0, 3.0), (1, 1, 2), "tet4")
    >>> mesh.elements, sorted(mesh.sides)
    (12, ['back', 'bottom', 'front', 'left', 'right', 'top'])
    """
    lattice = _box(lengths, divisions, kind, grading, towards, corner)
    if crown is None:
        return lattice
    radius, bottom, height = _length("crown", crown), corner[2], lengths[2]
    highest = sum(max(abs(low), abs(low + length)) ** 2 for low, length in zip(corner[:2], lengths[:2], strict=True))
    if highest >= 2 * radius * height:
        least = highest / (2 * height)
        raise InvalidProblem(
            f"shape: expected a crown that stays below the top, of a radius above {least:g}, got {radius:g}"
        )

    def crowned(keys: Index) -> Array:
        x, y, z = lattice.position(keys).T
        return np.column_stack([x, y, z + (x**2 + y**2) / (2 * radius) * (1 - (z - bottom) / height)])

    return replace(lattice, position=crowned)


@_shape
def disc(
    radius: float,
    divisions: tuple[int, int],
    kind: str = "quad4",
    *,
    grading: float = 1.0,
    center: tuple[float, float] = (0.0, 0.0),
) -> Lattice:
    """Mesh a disc.

    Parameters
    ----------
    radius : float
        Radius [length].
    divisions : (int, int)
        Elements from the centre to the edge of the core, and from there to the arc: 8 n elements along the arc and
        n + m along a radius for (n, m).
    kind : str
        Kind of element, as for `rectangle`.
    grading : float
        Ratio of the largest to the smallest element, which is at the pole.
    center : (float, float)
        Centre of the whole disc [length].
    """
    return _round(OGrid(("full", "full"), *_pair(divisions), grading), radius, center, kind, {})


@_shape
def half_disc(
    radius: float,
    divisions: tuple[int, int],
    kind: str = "quad4",
    *,
    grading: float = 1.0,
    center: tuple[float, float] = (0.0, 0.0),
) -> Lattice:
    """Mesh the lower half of the disc around `center`, y <= center_y; as `disc`.

    Parameters
    ----------
    radius, divisions, kind, grading, center
        As for `disc`.
    """
    return _round(OGrid(("full", "negative"), *_pair(divisions), grading), radius, center, kind, {"top": 1})


@_shape
def quarter_disc(
    radius: float,
    divisions: tuple[int, int],
    kind: str = "quad4",
    *,
    grading: float = 1.0,
    center: tuple[float, float] = (0.0, 0.0),
) -> Lattice:
    """Mesh the lower right quarter of the disc around `center`; as `disc`. In axial symmetry it is a half ball.

    Parameters
    ----------
    radius, divisions, kind, grading, center
        As for `disc`.
    """
    grid = OGrid(("positive", "negative"), *_pair(divisions), grading)
    return _round(grid, radius, center, kind, {"top": 1, "left": 0})


@_shape
def ball(
    radius: float,
    divisions: tuple[int, int],
    kind: str = "hex8",
    *,
    part: Part = "full",
    grading: float = 1.0,
    center: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Lattice:
    """Mesh a ball or a part of it; `divisions` as for `disc`.

    Parameters
    ----------
    radius, divisions : float, (int, int)
        As for `disc`.
    kind : str
        Kind of element, as for `box`.
    part : str
        ``"full"``, ``"half"``, ``"quarter"`` or ``"eighth"``.
    grading : float
        Ratio of the largest to the smallest element.
    center : (float, float, float)
        Centre of the whole ball [length].
    """
    halves = _BALL_PARTS[part]
    cuts = {name: axis for axis, name in enumerate(("left", "front", "top")) if halves[axis] != "full"}
    return _round(OGrid(halves, *_pair(divisions), grading), radius, center, kind, cuts)


@_shape
def cylinder(
    radius: float,
    height: float,
    divisions: tuple[int, int, int],
    kind: str = "hex8",
    *,
    part: Part = "full",
    grading: float = 1.0,
    center: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Lattice:
    """Mesh the cylinder with the axis z and the middle of its bottom at `center`, or a part of it.

    `divisions` are those of `disc` and the elements along z, which get smaller towards the bottom.

    Parameters
    ----------
    radius, height : float
        Radius and height [length].
    divisions : (int, int, int)
        Those of `disc`, and the elements along z, which get smaller towards the bottom.
    kind : str
        Kind of element, as for `box`.
    part : str
        ``"full"``, ``"half"`` or ``"quarter"``.
    grading : float
        Ratio of the largest to the smallest element.
    center : (float, float, float)
        Middle of the bottom of the whole cylinder [length].
    """
    if part not in _CYLINDER_PARTS:
        raise InvalidProblem(f"cylinder: expected a part of {', '.join(_CYLINDER_PARTS)}, got {shown(part)}")
    R, H = _length("radius", radius), _length("height", height)
    halves = _CYLINDER_PARTS[part]
    z = H * spacing(divisions[2], grading, "low")
    grid = OGrid(halves, *_pair(divisions[:2]), extrusion=divisions[2])
    sides = {
        "bottom": _at(2, 0),
        "top": _at(2, 2 * divisions[2]),
        "side": _at(grid.layer, 2 * grid.layers),
        **{name: _at(axis, 0) for axis, name in enumerate(("left", "front")) if halves[axis] != "full"},
    }

    def position(keys: Index) -> Array:
        return np.asarray(center) + np.column_stack([R * grid.position(keys), z[keys[:, 2]]])

    return Lattice(grid.patches(), kind, position, sides)


def _box(
    lengths: Sequence[float],
    divisions: Sequence[int],
    kind: str,
    grading: float,
    towards: Sequence[str],
    corner: Sequence[float],
) -> Lattice:
    names = _AXIS_SIDES[len(lengths)]
    names_of_sides = {name for pair in names for name in pair} | {"middle"}
    if set(towards) - names_of_sides:
        raise InvalidProblem(
            f"shape: expected `towards` to be a list of {', '.join(sorted(names_of_sides))}, got {shown(towards)}"
        )
    values = []
    for axis, pair in enumerate(names):
        place = _towards(pair, towards, horizontal=axis < len(names) - 1)
        share = spacing(divisions[axis], grading if place else 1.0, place or "low")
        values.append(corner[axis] + _length("length", lengths[axis]) * share)
    sides: dict[str, Callable[[Index], Mask]] = {}
    for axis, (low, high) in enumerate(names):
        sides |= {low: _at(axis, 0), high: _at(axis, 2 * divisions[axis])}

    def position(keys: Index) -> Array:
        return np.stack([values[axis][keys[:, axis]] for axis in range(len(names))], axis=1)

    patch = Patch([np.arange(2 * n + 1) for n in divisions], range(len(names)))
    return Lattice([patch], kind, position, sides)


def _towards(pair: tuple[str, str], towards: Sequence[str], *, horizontal: bool) -> Towards | None:
    low, high = (name in towards for name in pair)
    if low or high:
        return "both" if low and high else "low" if low else "high"
    return "middle" if horizontal and "middle" in towards else None


def _round(grid: OGrid, radius: float, center: Sequence[float], kind: str, cuts: dict[str, int]) -> Lattice:
    R, axes = _length("radius", radius), len(grid.halves)
    curved = "arc" if axes == 2 else "sphere"
    sides = {curved: _at(grid.layer, 2 * grid.layers), **{name: _at(axis, 0) for name, axis in cuts.items()}}

    def position(keys: Index) -> Array:
        return np.asarray(center) + R * grid.position(keys)

    return Lattice(grid.patches(), kind, position, sides, {"pole": np.array([*center[:-1], center[-1] - R])})


def _at(component: int, value: int) -> Callable[[Index], Mask]:
    return lambda keys: keys[:, component] == value


def _pair(divisions: Sequence[int]) -> tuple[int, int]:
    for n in divisions:
        spacing(n, 1.0, "low")
    return divisions[0], divisions[1]


def _length(what: str, value: float) -> float:
    if not (math.isfinite(value) and value > 0):
        raise InvalidProblem(f"shape: expected a positive {what}, got {value}")
    return float(value)


@dataclass(frozen=True, eq=False)
class OGrid:
    """The unit disc or ball, or a part of it, perhaps extruded along one more axis.

    A key has one component for each round axis (the place in the core, or on its surface), one for the extrusion if
    there is one, and last the layer: 0 in the core, 2 `layers` on the circle.

    Parameters
    ----------
    halves : tuple of str, for each round axis whether coordinates of both signs belong to the part
    core : int, cells from the centre to a face of the core
    layers : int, cells from there to the circle
    grading : float, with a value above 1 cells shrink towards the pole, the lowest point of the last round axis
    extrusion : int, cells along the extrusion; 0: none
    """

    halves: tuple[Half, ...]
    core: int
    layers: int
    grading: float = 1.0
    extrusion: int = 0

    @property
    def layer(self) -> int:
        """Return the component of the key that counts the layers."""
        return len(self.halves) + (self.extrusion > 0)

    def patches(self) -> list[Patch]:
        """Return the core, and the layers over each of its faces that is not cut."""
        n = 2 * self.core
        limits = {"full": (-n, n), "positive": (0, n), "negative": (-n, 0)}
        axes: list[Index] = [np.arange(limits[half][0], limits[half][1] + 1) for half in self.halves]
        if self.extrusion:
            axes.append(np.arange(2 * self.extrusion + 1))
        columns = list(range(len(axes)))
        outward = np.arange(2 * self.layers + 1)
        found = [Patch(axes, columns, {self.layer: 0})]
        for axis, half in enumerate(self.halves):
            for end in limits[half]:
                if end:
                    directions, places = list(axes), list(columns)
                    directions[axis], places[axis] = outward if end > 0 else outward[::-1], self.layer
                    found.append(Patch(directions, places, {axis: end}))
        return found

    def position(self, keys: Index) -> Array:
        """Return the coordinates (N, round axes) in the unit disc or ball, without the extrusion.

        With the position q in [-1, 1]^d in the core, the direction is d_a = tan(pi q_a / 4) (equal angles along the
        faces), e = d / |d|; the core is at CORE ((1 - ROUNDNESS) q + ROUNDNESS |q|_max e(q / |q|_max)), and the layers
        go along straight lines from there to e.
        """
        q = np.stack([self._core(axis, keys[:, axis]) for axis in range(len(self.halves))], axis=1)
        size = abs(q).max(axis=1, keepdims=True)
        direction = np.tan(np.pi / 4 * q / np.where(size > 0, size, 1.0))
        length = np.linalg.norm(direction, axis=1, keepdims=True)
        unit = direction / np.where(length > 0, length, 1.0)
        core = CORE * ((1 - ROUNDNESS) * q + ROUNDNESS * size * unit)
        t = spacing(self.layers, self.grading, "high")[keys[:, self.layer]][:, None]
        return np.asarray((1 - t) * core + t * unit)

    def _core(self, axis: int, keys: Index) -> Array:
        """Return q in [-1, 1] along one axis: graded to -1 along the axis of the pole, to 0 along the others."""
        n = self.core
        if axis < len(self.halves) - 1 or self.halves[axis] == "positive" or self.grading == 1:
            return np.asarray(np.sign(keys) * spacing(n, self.grading, "low")[abs(keys)])
        cells = n if self.halves[axis] == "negative" else 2 * n
        return np.asarray(spacing(cells, self.grading, "low")[keys + 2 * n] * (cells // n) - 1)


# The largest grading; with smaller elements the stiffness would lose all its digits.
STEEPEST = 1e10


def spacing(cells: int, grading: float, towards: Towards) -> Array:
    """Return ends and middles of cells from 0 to 1, (2 cells + 1,), whose sizes shrink geometrically towards one
    place.

    Parameters
    ----------
    cells : int
        At least one.
    grading : float
        Largest over smallest size, at least 1.
    towards : str
        Where the cells are smallest: the ``"low"`` end, the ``"high"`` end, ``"both"`` ends or the ``"middle"``.

    >>> spacing(2, 3.0, "low").tolist()
    [0.0, 0.125, 0.25, 0.625, 1.0]
    """
    if not is_whole(cells) or cells < 1:
        raise InvalidProblem(f"shape: expected whole numbers of divisions >= 1, got {shown(cells)}")
    if not 1 <= grading <= STEEPEST:
        raise InvalidProblem(f"shape: expected a grading from 1 to {STEEPEST:g}, got {grading:g}")
    i = np.arange(cells)
    distance = {
        "low": i,
        "high": cells - 1 - i,
        "both": np.minimum(i, cells - 1 - i),
        "middle": abs(i - (cells - 1) / 2),
    }[towards]
    spread = float(distance.max() - distance.min())
    sizes = grading ** ((distance - distance.min()) / spread) if spread else np.ones(cells)
    ends = np.concatenate([[0.0], np.cumsum(sizes) / sizes.sum()])
    ends[-1] = 1.0
    values = np.empty(2 * cells + 1)
    values[::2] = ends
    values[1::2] = (ends[1:] + ends[:-1]) / 2
    return values
