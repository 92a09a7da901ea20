"""Isotropic linear elasticity: from displacements to strains, and from strains to stresses.

Strains and stresses stand in the order of VTK's symmetric tensors, (xx, yy, zz, xy, yz, zx), shear strains doubled
(gamma_xy = 2 eps_xy). A model keeps those strains that can differ from zero:

    plane-strain    (xx, yy, xy)       eps_zz = 0, sigma_zz follows
    plane-stress    (xx, yy, xy)       sigma_zz = 0
    axisymmetric    (xx, yy, zz, xy)   x is the radius, y the axis, zz the hoop direction
    3d              all six

Strains are eps = B u of the nodal displacements u; integrals over a body carry its measure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from contactqp.elements.reference_elements import Geometry
from contactqp.elements.scalars import moderate_number, real_number
from contactqp.errors import InvalidProblem
from contactqp.model.arguments import checks
from contactqp.model.arrays import Array

Model = Literal["plane-strain", "plane-stress", "axisymmetric", "3d"]
MODELS: tuple[str, ...] = get_args(Model)
STRAINS: dict[str, tuple[int, ...]] = {
    "plane-strain": (0, 1, 3),
    "plane-stress": (0, 1, 3),
    "axisymmetric": (0, 1, 2, 3),
    "3d": (0, 1, 2, 3, 4, 5),
}
# (strain, axis of the displacement, axis of the derivative); the strains are numbered as in material.STRAINS.
_PLANE = ((0, 0, 0), (1, 1, 1), (2, 0, 1), (2, 1, 0))
_DERIVATIVES = {
    "plane-strain": _PLANE,
    "plane-stress": _PLANE,
    "axisymmetric": ((0, 0, 0), (1, 1, 1), (3, 0, 1), (3, 1, 0)),
    "3d": ((0, 0, 0), (1, 1, 1), (2, 2, 2), (3, 0, 1), (3, 1, 0), (4, 1, 2), (4, 2, 1), (5, 0, 2), (5, 2, 0)),
}
HOOP = 2


@checks
@dataclass(frozen=True)
class Material:
    """An isotropic linear elastic material.

    Parameters
    ----------
    modulus : float
        Young's modulus E from 1e-120 to 1e120 [force / length^2].
    poisson : float
        Poisson's ratio [-], -1 < nu < 1/2. Close to 1/2 linear elements lock (they are far too stiff, as every
        quadrature point enforces constant volume): with nu > 0.45 use quadratic ones. No mixed formulation is offered.
    density : float
        rho >= 0 [mass / length^3]; only gravity and motions need it.
    name : str
        Used in every message.

    Raises
    ------
    InvalidProblem
        A number outside these ranges or not finite.
    """

    modulus: float
    poisson: float
    density: float = 0.0
    name: str = "material"

    def __post_init__(self) -> None:
        moderate_number(self.name, self.modulus, "modulus")
        real_number(f"{self.name}: Poisson's ratio", self.poisson)
        if not -1 < self.poisson < 0.5:
            raise InvalidProblem(f"{self.name}: expected Poisson's ratio between -1 and 0.5, got {self.poisson}")
        if real_number(f"{self.name}: density", self.density) < 0:
            raise InvalidProblem(f"{self.name}: expected a density >= 0, got {self.density}")

    @property
    def lame_lambda(self) -> float:
        """Return lambda = E nu / ((1 + nu) (1 - 2 nu)) [force / length^2]."""
        return self.modulus * self.poisson / ((1 + self.poisson) * (1 - 2 * self.poisson))

    @property
    def lame_mu(self) -> float:
        """Return mu = E / (2 (1 + nu)), the shear modulus [force / length^2]."""
        return self.modulus / (2 * (1 + self.poisson))

    def constitutive(self, model: Model) -> Array:
        """Return D in sigma = D eps for the strains of the model: (3, 3), (4, 4) or (6, 6) [force / length^2].

        >>> Material(modulus=2.0, poisson=0.0).constitutive("plane-stress").tolist()
        [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]]
        """
        return self.stress_matrix(model)[list(STRAINS[model])]

    def stress_matrix(self, model: Model) -> Array:
        """Return the matrix of all six stresses from the strains of the model, (6, number of strains): D, and
        sigma_zz.
        """
        # In plane stress eps_zz = -lambda / (lambda + 2 mu) (eps_xx + eps_yy) leaves this lambda to the plane.
        reduced = 2 * self.lame_lambda * self.lame_mu / (self.lame_lambda + 2 * self.lame_mu)
        D = np.diag([2.0, 2.0, 2.0, 1.0, 1.0, 1.0]) * self.lame_mu
        D[:3, :3] += reduced if model == "plane-stress" else self.lame_lambda
        matrix = D[:, list(STRAINS[model])]
        if model == "plane-stress":
            matrix[2] = 0.0
        return matrix


def strain_matrix(geometry: Geometry, model: Model) -> Array:
    """Return B of E elements at q points, unknowns node by node: (E, q, strains, n d) [1/length].

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


def strains(geometry: Geometry, model: Model, displacement: Array) -> Array:
    """Return B u of E elements at q points from the displacements (E, n, d) of their nodes, without forming B: (E,
    q, strains) [-].
    """
    derivative = np.matmul(np.swapaxes(displacement, 1, 2)[:, None], geometry.gradient)
    eps = np.zeros((*derivative.shape[:2], len(STRAINS[model])))
    for strain, axis, along in _DERIVATIVES[model]:
        eps[..., strain] += derivative[..., axis, along]
    if model == "axisymmetric":
        eps[..., HOOP] = np.matmul(geometry.shape, displacement[..., :1])[..., 0] / geometry.positions[..., 0]
    return eps


def measure(positions: Array, model: Model, thickness: float) -> Array:
    """Return the factor of an integral over the plane, (E, q): the thickness, 1 in 3D, 2 pi r in axial symmetry.

    Axisymmetric forces are thus those of the full circle.
    """
    if model == "axisymmetric":
        return 2 * np.pi * positions[..., 0]
    return np.full(positions.shape[:-1], thickness)
