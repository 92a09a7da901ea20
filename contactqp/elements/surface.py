"""A part of a body's boundary that may touch something: nodes, facets, and where their displacements stand in u."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.reading import positive_number
from contactqp.model.problem_data import ReadOnly, read_array, read_only, read_whole


@dataclass(frozen=True, eq=False)
class Surface(ReadOnly):
    """Facets of a body's boundary, oriented so that their normals point out of the body.

    Parameters
    ----------
    points : (N, d) array
        Coordinates of all nodes of the body [length], d = 2 or 3.
    facets : (p, k) array of int
        Node numbers of each facet. 2D: its ends, then the middle if quadratic (k = 2 or 3); walking from the first end
        to the second the body lies on the left, so the outward normal of a tangent (t_x, t_y) is (t_y, -t_x). 3D: its
        corners, counter-clockwise seen from outside (k = 3 or 4), then the middles of the edges between them in the
        same order (k = 6 or 8), then the centre (k = 9).
    unknowns : (N, d) array of int
        unknowns[i, a] is the place of node i's displacement along axis a in u.
    name : str
        Used in every message.
    thickness : float
        Of a plane body [length]: forces are for all of it. With 1 they are per unit thickness.
    revolved : bool
        The surface of an axisymmetric body, about x = 0: forces are those of the full circle.

    Raises
    ------
    InvalidProblem
        Arrays that are none of real or of whole numbers, a thickness that is not positive.
    """

    points: NDArray[np.float64]
    facets: NDArray[np.int64]
    unknowns: NDArray[np.int64]
    name: str = "surface"
    thickness: float = 1.0
    revolved: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", read_only(read_array(f"{self.name}: points", self.points)))
        for what in ("facets", "unknowns"):
            object.__setattr__(self, what, read_only(read_whole(f"{self.name}: {what}", getattr(self, what))))
        positive_number(f"{self.name}: thickness", self.thickness, "length")

    @property
    def dimension(self) -> int:
        """d."""
        return int(self.points.shape[1])

    @property
    def nodes(self) -> NDArray[np.int64]:
        """The nodes of the facets, each once, in ascending order."""
        return read_only(np.unique(self.facets))
