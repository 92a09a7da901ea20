"""Strains from nodal displacements: the matrices B in eps = B u, and the measure that integrals over a body carry."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.geometry import Geometry
from contactqp.elements.material import STRAINS, Model

# (strain, axis of the displacement, axis of the derivative); the strains are numbered as in material.STRAINS.
_PLANE = ((0, 0, 0), (1, 1, 1), (2, 0, 1), (2, 1, 0))
_DERIVATIVES = {
    "plane-strain": _PLANE,
    "plane-stress": _PLANE,
    "axisymmetric": ((0, 0, 0), (1, 1, 1), (3, 0, 1), (3, 1, 0)),
    "3d": ((0, 0, 0), (1, 1, 1), (2, 2, 2), (3, 0, 1), (3, 1, 0), (4, 1, 2), (4, 2, 1), (5, 0, 2), (5, 2, 0)),
}
HOOP = 2


def strain_matrix(geometry: Geometry, model: Model) -> NDArray[np.float64]:
    """B of E elements at q points: (E, q, strains, n d), unknowns node by node [1/length].

    eps_aa = du_a/dx_a, gamma_ab = du_a/dx_b + du_b/dx_a; in axial symmetry also eps_hoop = u_r / r.
    """
    gradient = geometry.gradient
    E, q, n, d = gradient.shape
    B = np.zeros((E, q, len(STRAINS[model]), n, d))
    for strain, axis, derivative in _DERIVATIVES[model]:
        B[:, :, strain, :, axis] = gradient[..., derivative]
    if model == "axisymmetric":
        B[:, :, HOOP, :, 0] = geometry.shape / geometry.positions[..., :1]
    return B.reshape(E, q, -1, n * d)


def strains(geometry: Geometry, model: Model, displacement: NDArray[np.float64]) -> NDArray[np.float64]:
    """B u of E elements at q points from the displacements (E, n, d) of their nodes, without B: (E, q, strains) [-]."""
    derivative = np.matmul(np.swapaxes(displacement, 1, 2)[:, None], geometry.gradient)
    eps = np.zeros((*derivative.shape[:2], len(STRAINS[model])))
    for strain, axis, along in _DERIVATIVES[model]:
        eps[..., strain] += derivative[..., axis, along]
    if model == "axisymmetric":
        eps[..., HOOP] = np.matmul(geometry.shape, displacement[..., :1])[..., 0] / geometry.positions[..., 0]
    return eps


def measure(positions: NDArray[np.float64], model: Model, thickness: float) -> NDArray[np.float64]:
    """What an integral over the plane is multiplied by, (E, q): the thickness, 1 in 3D, 2 pi r in axial symmetry.

    Axisymmetric forces are thus those of the full circle.
    """
    if model == "axisymmetric":
        return 2 * np.pi * positions[..., 0]
    return np.full(positions.shape[:-1], thickness)
