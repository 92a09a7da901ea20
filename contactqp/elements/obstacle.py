"""Rigid obstacles by their signed distance, a plane or any distance function, and the directions along a surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from numbers import Rational
from typing import Any, Protocol

import numpy as np

from contactqp.elements.scalars import Number, Numbers, keep_own, positive_number, unit_vector
from contactqp.errors import InvalidProblem
from contactqp.model.arguments import checks
from contactqp.model.arrays import EPS, Array, computes
from contactqp.model.problem_data import ReadOnly, is_whole, read_array

# The step at which truncation (step^2) and rounding (eps / step) of a central difference are equal.
RELATIVE_STEP = float(np.cbrt(EPS))


class Obstacle(Protocol):
    """A rigid obstacle, given by its signed distance."""

    @property
    def dimension(self) -> int: ...

    def distance(self, points: Any) -> Numbers:
        """Return the signed distance of each of the (p, dimension) points [length]: the gap, positive when open."""

    def normals(self, points: Any) -> Numbers:
        """Return the unit vectors along which the distance grows fastest, out of the obstacle, (p, dimension)."""


@checks
@computes
@dataclass(frozen=True, eq=False)
class Plane(ReadOnly):
    """The rigid half-space behind the plane through `point`; bodies are on the side that `normal` points to.

    Parameters
    ----------
    point, normal : (dimension,) arrays
        In one, two or three dimensions; the normal may have any length but zero.
    """

    point: Any
    normal: Any

    def __post_init__(self) -> None:
        point, normal = (read_array(f"plane {what}", getattr(self, what)) for what in ("point", "normal"))
        if point.shape != normal.shape or point.shape not in ((1,), (2,), (3,)):
            raise InvalidProblem(
                f"plane: expected a point and a normal of one, two or three components, got shapes "
                f"{point.shape} and {normal.shape}"
            )
        for what, vector in (("point", point), ("normal", normal)):
            if not np.all(np.isfinite(vector)):
                raise InvalidProblem(f"plane {what}: expected finite components, got {vector}")
        keep_own(self, "point", "normal")
        self.outward()

    @property
    def dimension(self) -> int:
        """Return the dimension of space, 2 or 3."""
        return len(self.point)

    def outward(self) -> Numbers:
        """Return the unit normal n, out of the obstacle."""
        return unit_vector(self.normal, "plane normal")

    def distance(self, points: Any) -> Numbers:
        """Return (x - point).n of each of the (p, dimension) points [length]: the gap, positive when open."""
        gap: Numbers = (points_near(self, points) - np.asarray(self.point)) @ self.outward()
        return gap

    def normals(self, points: Any) -> Numbers:
        """Return n for each of the (p, dimension) points."""
        return np.tile(self.outward(), (len(points_near(self, points)), 1))


def points_near(obstacle: Obstacle, points: Any) -> Numbers:
    """Return (p, dimension) points as an array, without rounding exact numbers.

    Raises InvalidProblem: another shape, or no real numbers.
    """
    x = read_array("points", points)
    if x.ndim != 2 or x.shape[1] != obstacle.dimension:
        raise InvalidProblem(f"points: expected shape (p, {obstacle.dimension}) as the obstacle has it, got {x.shape}")
    exact = np.asarray(points)
    return exact if all(isinstance(entry, Rational) for entry in exact.flat if exact.dtype.kind == "O") else x


def tangents(normal: Numbers) -> Numbers:
    """Return the (dimension - 1, dimension) unit vectors along a surface with the unit normal n.

    2D: t = (n_2, -n_1), so that a floor with n = (0, 1) has t = (1, 0). 3D: t_1 is the projection of the axis furthest
    from n, t_2 = n x t_1.

    >>> tangents(np.array([0.0, 1.0])).tolist()
    [[1.0, -0.0]]
    >>> tangents(np.array([0.0, 0.0, 1.0])).tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    """
    if len(normal) == 1:
        return np.zeros((0, 1), dtype=int)
    if len(normal) == 2:
        return np.array([[normal[1], -normal[0]]])
    axis = np.zeros(3, dtype=int)
    axis[int(np.argmin([abs(float(c)) for c in normal]))] = 1
    first = unit_vector(axis - np.dot(axis, normal) * normal, "tangent")
    a, b, c = normal
    x, y, z = first
    return np.array([first, [b * z - c * y, c * x - a * z, a * y - b * x]])


def tangent_frames(normals: Array) -> Array:
    """Return `tangents` of each of the (p, d) unit normals, (p, d-1, d)."""
    p, d = normals.shape
    if d == 1:
        return np.zeros((p, 0, 1))
    if d == 2:
        return np.stack([normals[:, 1], -normals[:, 0]], axis=1)[:, np.newaxis, :]
    axis = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    first = axis - (axis * normals).sum(axis=1, keepdims=True) * normals
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(normals, first)], axis=1)


@checks
@computes
@dataclass(frozen=True, eq=False)
class SignedDistance:
    """The rigid obstacle {x: function(x) <= 0}, for a function that is a distance: |grad function| = 1.

    Parameters
    ----------
    function : callable
        (p, dimension) points to (p,) signed distances [length], positive outside the obstacle.
    dimension : int
        1, 2 or 3.
    gradient : callable, optional
        (p, dimension) points to (p, dimension) gradients [-]. By default central differences
        (function(x + h e_a) - function(x - h e_a)) / (2 h).
    step : float, optional
        h [length]. By default eps^(1/3) = 6.1e-6 of the largest coordinate of the points.
    tolerance : float
        | |gradient| - 1 | may be this large. A level set that is not a distance (x^2 + y^2 - R^2) would scale gaps and
        pressures; a kink (a corner, a middle line) has no normal.

    Raises
    ------
    InvalidProblem
        On use: values of the wrong shape, not finite, or with a gradient that is not of length 1; the point is named.

    Examples
    --------
    >>> ball = SignedDistance(lambda x: np.sqrt((x**2).sum(axis=1)) - 2.0, dimension=3)
    >>> ball.distance(np.array([[0.0, 0.0, 2.5]])).tolist()
    [0.5]
    """

    function: Callable[[Any], Any]
    dimension: int
    gradient: Callable[[Any], Any] | None = None
    step: float | None = None
    tolerance: float = 1e-6

    def __post_init__(self) -> None:
        if not is_whole(self.dimension) or self.dimension not in (1, 2, 3):
            raise InvalidProblem(f"signed distance: expected the dimension 1, 2 or 3, got {self.dimension}")
        if self.step is not None:
            positive_number("signed distance: step", self.step, "step")
        positive_number("signed distance: tolerance", self.tolerance, "number")

    def distance(self, points: Any) -> Array:
        """Return the function's signed distances of the (p, d) points, positive when open, (p,) [length]."""
        x = points_near(self, points)
        return _values("function", self.function(x), x, (len(x),))

    def normals(self, points: Any) -> Array:
        """Return gradient / |gradient|, (p, dimension)."""
        x = points_near(self, points)
        if self.gradient is not None:
            gradients = _values("gradient", self.gradient(x), x, x.shape)
        else:
            gradients = self._differences(x)
        length = np.linalg.norm(gradients, axis=1)
        wrong = np.flatnonzero(np.abs(length - 1) > self.tolerance)
        if wrong.size:
            i = wrong[np.argmax(np.abs(length[wrong] - 1))]
            raise InvalidProblem(
                f"signed distance: at point {i}, {x[i].tolist()}, the gradient has the length {length[i]:.9g}; "
                f"expected 1 within {self.tolerance:g}: the function is not a distance there, or has a kink"
            )
        normals: Array = gradients / length[:, np.newaxis]
        return normals

    def _differences(self, x: Array) -> Array:
        h = RELATIVE_STEP * np.abs(x).max(initial=0.0) if self.step is None else float(self.step)
        if h == 0 and len(x):
            raise InvalidProblem(
                "signed distance: all points are at the origin, which gives differences no length: expected `step`"
            )
        columns = [(self.distance(x + h * e) - self.distance(x - h * e)) / (2 * h) for e in np.eye(self.dimension)]
        return np.stack(columns, axis=1)


def _values(what: str, values: Any, x: Array, shape: tuple[int, ...]) -> Array:
    got = read_array(f"signed distance: {what}", values)
    if got.shape != shape:
        raise InvalidProblem(
            f"signed distance: {what} of points of shape {x.shape}: expected shape {shape}, got {got.shape}"
        )
    wrong = np.flatnonzero(~np.isfinite(got.reshape(len(x), int(np.prod(shape[1:])))).all(axis=1))
    if wrong.size:
        raise InvalidProblem(
            f"signed distance: {what} at {x[wrong[0]].tolist()}: expected a finite value, got {got[wrong[0]]}"
        )
    return got


@dataclass(frozen=True, eq=False)
class ContactRows:
    """One contact on the unknowns of its nodes: E_N u <= gap, slip E_T u."""

    normal: Numbers  # (nodes * dimension,)
    gap: Number  # positive when open
    tangent: Numbers  # (dimension - 1, nodes * dimension)


def against_plane(point: Any, plane: Plane) -> ContactRows:
    """Return the rows against a plane, E_N = -n', gap = (x - point).n: moving against the obstacle's normal closes
    the gap.

    Course chapter, Example 2.10: on a floor, n = (0, 1), E_N = (0, -1).
    """
    n = plane.outward()
    gap: Number = plane.distance(np.asarray(point)[np.newaxis, :])[0]
    return ContactRows(normal=-n, gap=gap, tangent=tangents(n))


def against_surface(point: Any, obstacle: Obstacle) -> ContactRows:
    """Return the rows against any obstacle, in floats, with its normal nearest to the point."""
    at = np.asarray(point, dtype=float)[np.newaxis, :]
    n = np.array([float(x) for x in obstacle.normals(at)[0]], dtype=object)
    return ContactRows(normal=-n, gap=float(obstacle.distance(at)[0]), tangent=tangents(n))


def between_nodes(first: Any, second: Any, direction: Any) -> ContactRows:
    """Return the rows of two nodes, E_N = (n', -n'), gap = (x_2 - x_1).n with n = direction / |direction| from the
    first to the second.

    Course chapter, Example 2.13: E_N = (1, -1) for two bars on one line. The tangents are those of the second node's
    surface, whose normal points back at the first: E_T = (t, -t).
    """
    n = unit_vector(direction, "contact direction")
    gap: Number = np.dot(np.asarray(second) - np.asarray(first), n)
    along = tangents(-n)
    return ContactRows(normal=np.concatenate([n, -n]), gap=gap, tangent=np.hstack([along, -along]))
