"""Discs, balls and cylinders as O-grids: a rounded square or cubic core, and layers from its faces to the circle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.lattice import Patch
from contactqp.elements.spacing import spacing
from contactqp.model.arrays import Index

Half = Literal["full", "positive", "negative"]
# Half-width of the core over the radius, and how round it is (0 square, 1 circular): at these the angles of a
# uniform disc's cells lie between 68 and 127 degrees.
CORE, ROUNDNESS = 0.5, 0.5


@dataclass(frozen=True, eq=False)
class OGrid:
    """The unit disc or ball, or a part of it, perhaps extruded along one more axis.

    A key has one component for each round axis (the place in the core, or on its surface), one for the extrusion if
    there is one, and last the layer: 0 in the core, 2 `layers` on the circle.

    Parameters
    ----------
    halves : tuple of str
        For each round axis whether coordinates of both signs belong to the part.
    core : int
        Cells from the centre to a face of the core.
    layers : int
        Cells from there to the circle.
    grading : float
        With a value above 1 cells shrink towards the pole, the lowest point of the last round axis.
    extrusion : int
        Cells along the extrusion; 0: none.
    """

    halves: tuple[Half, ...]
    core: int
    layers: int
    grading: float = 1.0
    extrusion: int = 0

    @property
    def layer(self) -> int:
        """The component of the key that counts the layers."""
        return len(self.halves) + (self.extrusion > 0)

    def patches(self) -> list[Patch]:
        """The core, and the layers over each of its faces that is not cut."""
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

    def position(self, keys: Index) -> NDArray[np.float64]:
        """Round coordinates (N, round axes) of the unit disc or ball; the extrusion has no part in them.

        With q in [-1, 1]^d the place in the core, the direction is d_a = tan(pi q_a / 4) (equal angles along the
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

    def _core(self, axis: int, keys: Index) -> NDArray[np.float64]:
        """q in [-1, 1] along one axis: graded to -1 along the axis of the pole, to 0 along the others."""
        n = self.core
        if axis < len(self.halves) - 1 or self.halves[axis] == "positive" or self.grading == 1:
            return np.asarray(np.sign(keys) * spacing(n, self.grading, "low")[abs(keys)])
        cells = n if self.halves[axis] == "negative" else 2 * n
        return np.asarray(spacing(cells, self.grading, "low")[keys + 2 * n] * (cells // n) - 1)
