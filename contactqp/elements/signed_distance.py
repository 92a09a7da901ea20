"""A rigid obstacle given by any signed distance function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.reading import positive_number, real_array
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import computes
from contactqp.model.problem_data import is_whole

# Where truncation (step^2) and rounding (eps / step) of a central difference meet.
RELATIVE_STEP = float(np.cbrt(np.finfo(float).eps))


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
        | |gradient| - 1 | may be this large. A level set that is no distance (x^2 + y^2 - R^2) would scale gaps and
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

    def distance(self, points: Any) -> NDArray[np.float64]:
        """function(points), (p,) [length]."""
        x = real_array("points", points)
        return _values("function", self.function(x), x, (len(x),))

    def normals(self, points: Any) -> NDArray[np.float64]:
        """gradient / |gradient|, (p, dimension)."""
        x = real_array("points", points)
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
                f"expected 1 within {self.tolerance:g}: the function is no distance there, or has a kink"
            )
        normals: NDArray[np.float64] = gradients / length[:, np.newaxis]
        return normals

    def _differences(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        h = RELATIVE_STEP * np.abs(x).max(initial=0.0) if self.step is None else float(self.step)
        if h == 0 and len(x):
            raise InvalidProblem(
                "signed distance: all points are at the origin, which gives differences no length: expected `step`"
            )
        columns = [(self.distance(x + h * e) - self.distance(x - h * e)) / (2 * h) for e in np.eye(self.dimension)]
        return np.stack(columns, axis=1)


def _values(what: str, values: Any, x: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float64]:
    got = real_array(f"signed distance: {what}", values)
    if got.shape != shape:
        raise InvalidProblem(
            f"signed distance: {what} of points of shape {x.shape}: expected shape {shape}, got {got.shape}"
        )
    wrong = np.flatnonzero(~np.isfinite(got.reshape(len(x), -1)).all(axis=1))
    if wrong.size:
        raise InvalidProblem(
            f"signed distance: {what} at {x[wrong[0]].tolist()}: expected a finite value, got {got[wrong[0]]}"
        )
    return got
