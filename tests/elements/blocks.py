"""Small elastic blocks with their own stiffness, for tests: nothing of the package but Surface is used."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from contactqp.elements.surface import Surface

FACES = {
    4: [(0, 1), (1, 2), (2, 3), (3, 0)],  # quadrilateral in the plane
    3: [(0, 1), (1, 2), (2, 0)],
    8: [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)],
    "tet": [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)],
}


@dataclass(frozen=True)
class Block:
    points: np.ndarray
    cells: np.ndarray
    first: int  # the first unknown

    @property
    def unknowns(self):
        return self.first + np.arange(self.points.size).reshape(self.points.shape)

    def surface(self, axis, value, name="surface"):
        """The facets whose nodes all have this coordinate."""
        d = self.points.shape[1]
        faces = np.concatenate([self.cells[:, f] for f in FACES["tet" if self._tetrahedral else self.cells.shape[1]]])
        on = np.isclose(self.points[faces][:, :, axis], value).all(axis=1)
        assert d == 2 or faces.shape[1] in (3, 4)
        return Surface(self.points, faces[on].astype(np.int64), self.unknowns, name)

    @property
    def _tetrahedral(self):
        return self.points.shape[1] == 3 and self.cells.shape[1] == 4

    def nodes(self, axis, value):
        return np.flatnonzero(np.isclose(self.points[:, axis], value))

    def stiffness(self, modulus, poisson):
        """Plane stress or 3D, by Gauss quadrature of B'DB."""
        d, k = self.points.shape[1], self.cells.shape[1]
        D = _elasticity(d, modulus, poisson)
        K = np.zeros((self.points.size, self.points.size))
        for cell in self.cells:
            places = (d * cell[:, None] + np.arange(d)).ravel()
            for derivatives, weight in _gauss(d, k):
                J = self.points[cell].T @ derivatives
                B = _strain(derivatives @ np.linalg.inv(J))
                assert np.linalg.det(J) > 0
                K[np.ix_(places, places)] += weight * np.linalg.det(J) * B.T @ D @ B
        return K


def block(lower, upper, divisions, simplices=False, first=0):
    """A box of rows of quadrilaterals or hexahedra; triangles or tetrahedra if `simplices`."""
    axes = [np.linspace(a, b, n + 1) for a, b, n in zip(lower, upper, divisions, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    number = np.arange(grid[..., 0].size).reshape(grid.shape[:-1])
    d = len(axes)
    corner = {
        c: number[tuple(slice(i, n + i) for i, n in zip(c, divisions, strict=True))].ravel()
        for c in product((0, 1), repeat=d)
    }
    if not simplices:
        order = [(0, 0), (1, 0), (1, 1), (0, 1)]
        turns = order if d == 2 else [(*c, z) for z in (0, 1) for c in order]
        cells = np.stack([corner[c] for c in turns], axis=1)
    else:
        parts = []
        for way in permutations(range(d)):  # Kuhn's subdivision
            steps = [tuple(int(a in way[:i]) for a in range(d)) for i in range(d + 1)]
            cell = np.stack([corner[s] for s in steps], axis=1)
            odd = np.linalg.det(np.diff(np.array(steps), axis=0)) < 0
            parts.append(cell[:, [1, 0, *range(2, d + 1)]] if odd else cell)
        cells = np.concatenate(parts)
    return Block(grid.reshape(-1, d), cells, first)


def _elasticity(d, modulus, poisson):
    if d == 2:
        factor = modulus / (1 - poisson**2)
        return factor * np.array([[1, poisson, 0], [poisson, 1, 0], [0, 0, (1 - poisson) / 2]])
    D = np.diag([1 - 2 * poisson] * 3 + [(1 - 2 * poisson) / 2] * 3)
    D[:3, :3] += poisson
    return modulus / ((1 + poisson) * (1 - 2 * poisson)) * D


def _strain(gradients):
    k, d = gradients.shape
    pairs = [(0, 1)] if d == 2 else [(1, 2), (0, 2), (0, 1)]
    B = np.zeros((d + len(pairs), k, d))
    for a in range(d):
        B[a, :, a] = gradients[:, a]
    for row, (a, b) in enumerate(pairs, start=d):
        B[row, :, a], B[row, :, b] = gradients[:, b], gradients[:, a]
    return B.reshape(len(B), -1)


def _gauss(d, k):
    if k == d + 1:
        yield np.vstack([-np.ones(d), np.eye(d)]), 1.0 / (2 if d == 2 else 6)
        return
    order = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    nodes = order if d == 2 else np.array([(*c, z) for z in (-1, 1) for c in order])
    for at in product((-(3**-0.5), 3**-0.5), repeat=d):
        factors = 1 + nodes * at
        yield np.stack([nodes[:, a] * np.delete(factors, a, 1).prod(1) for a in range(d)], axis=1) / 2**d, 1.0
