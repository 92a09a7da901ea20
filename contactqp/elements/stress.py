"""Stresses of a displaced body, at its quadrature points and at its nodes, and von Mises' equivalent stress.

All stresses are (xx, yy, zz, xy, yz, zx), VTK's order, tension positive [force / length^2]. In axial symmetry x is the
radius, y the axis and zz the hoop stress; in plane strain zz is nu (xx + yy).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactqp.elements.geometry import Block, Geometry, sum_at_nodes
from contactqp.elements.kinematics import strains
from contactqp.elements.quadrature import gauss, tetrahedron, triangle
from contactqp.elements.reading import real_array
from contactqp.elements.reference import REFERENCES, Reference
from contactqp.elements.solid import Body
from contactqp.errors import InvalidProblem

# Where the stresses of an element are most accurate: one point for linear simplices, else the Gauss points of full
# integration of the linear stress field (Barlow 1976); a field of the linear kind through them gives the nodes.
_SAMPLES = {
    "tri3": triangle(1), "tri6": triangle(3), "tet4": tetrahedron(1), "tet10": tetrahedron(4),
    "quad4": gauss(2, 2), "quad8": gauss(2, 2), "quad9": gauss(2, 2),
    "hex8": gauss(2, 3), "hex20": gauss(2, 3), "hex27": gauss(2, 3),
}  # fmt: skip


class PointStress(NamedTuple):
    """Stresses at the quadrature points of one block of elements."""

    positions: NDArray[np.float64]  # (E, q, d) [length]
    stress: NDArray[np.float64]  # (E, q, 6) [force / length^2]


def stress_at_quadrature(body: Body, displacement: ArrayLike) -> tuple[PointStress, ...]:
    """sigma = D B u at the quadrature points of the stiffness, one entry for each block of the mesh.

    Raises
    ------
    InvalidProblem
        The displacement is not (N d,).
    """
    u = _displacement(body, displacement)
    found = []
    for block in body.mesh.blocks:
        geometry = Geometry(block.kind, body.mesh.points[block.nodes], body.stiffness_rule(block).points)
        found.append(PointStress(geometry.positions, _stress(body, block, geometry, u)))
    return tuple(found)


def stress_at_nodes(body: Body, displacement: ArrayLike) -> NDArray[np.float64]:
    """(N, 6) stresses at the nodes: continued from the best points of each element, then averaged over the elements.

    Raises
    ------
    InvalidProblem
        The displacement is not (N d,).
    """
    total, count = stress_sums(body, displacement, body.mesh.blocks)
    return total / count


def stress_sums(
    body: Body, displacement: ArrayLike, blocks: Sequence[Block]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The stresses (N, 6) at the nodes, summed over these elements, and how many of them each node (N, 1) is in."""
    u = _displacement(body, displacement)
    N = len(body.mesh.points)
    total, count = np.zeros((N, 6)), np.zeros((N, 1))
    for block in blocks:
        geometry = Geometry(block.kind, body.mesh.points[block.nodes], _SAMPLES[block.kind.name].points)
        continued = np.matmul(_continuation(block.kind), _stress(body, block, geometry, u))
        total += sum_at_nodes(block, continued, N)
        count += sum_at_nodes(block, np.ones((*block.nodes.shape, 1)), N)
    return total, count


def von_mises(stress: ArrayLike) -> NDArray[np.float64]:
    """sqrt(1/2 ((xx-yy)^2 + (yy-zz)^2 + (zz-xx)^2) + 3 (xy^2 + yz^2 + zx^2)) of (..., 6) stresses.

    >>> von_mises([[2.0, 0.0, 0.0, 0.0, 0.0, 0.0], [5.0, 5.0, 5.0, 0.0, 0.0, 0.0]]).tolist()
    [2.0, 0.0]
    """
    xx, yy, zz, xy, yz, zx = np.moveaxis(real_array("stress", stress), -1, 0)
    squares = ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2) / 2 + 3 * (xy**2 + yz**2 + zx**2)
    return np.asarray(np.sqrt(squares))


def _stress(body: Body, block: Block, geometry: Geometry, u: NDArray[np.float64]) -> NDArray[np.float64]:
    strain = strains(geometry, body.model, u.reshape(body.mesh.points.shape)[block.nodes])
    return np.asarray(strain @ body.material.stress_matrix(body.model).T)


def _continuation(kind: Reference) -> NDArray[np.float64]:
    """(n, samples): the field of the linear kind through the sample points, at the nodes; constant for one sample."""
    samples = _SAMPLES[kind.name].points
    if len(samples) == 1:
        return np.ones((len(kind.nodes), 1))
    linear = REFERENCES[kind.linear]
    return linear.shape(kind.nodes) @ np.linalg.inv(linear.shape(samples))


def _displacement(body: Body, displacement: ArrayLike) -> NDArray[np.float64]:
    u = real_array(f"{body.name}: displacement", displacement)
    if u.shape != (body.size,):
        raise InvalidProblem(f"{body.name}: expected a displacement of shape ({body.size},), got {u.shape}")
    return u
