"""Hyperelastic laws: energy, second Piola-Kirchhoff stress and its tangent from the displacement gradient H = du/dX.

F = 1 + H, C = F'F, Green's strain G = (H + H' + H'H) / 2, J = det F. Everything is formed from H, so that small strains
keep their digits. In the plane F_zz = 1 (plane strain), or S_zz = 0 where a law has a form for plane stress.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from contactqp.model.arrays import Array


@dataclass(frozen=True, eq=False)
class Kinematics:
    """What a law needs at (..., d, d) displacement gradients."""

    gradient: Array  # H

    @property
    def deformation(self) -> Array:
        """F = 1 + H."""
        return np.asarray(np.eye(self.gradient.shape[-1]) + self.gradient)

    @property
    def strain(self) -> Array:
        """G = (H + H' + H'H) / 2."""
        H = self.gradient
        turned = np.swapaxes(H, -1, -2)
        return np.asarray((H + turned + turned @ H) / 2)

    @property
    def dilation(self) -> Array:
        """J - 1 = tr H + second invariant of H + (3D) det H, (...)."""
        H = self.gradient
        trace = np.trace(H, axis1=-2, axis2=-1)
        second = (trace**2 - np.trace(H @ H, axis1=-2, axis2=-1)) / 2
        return np.asarray(trace + second + (np.linalg.det(H) if H.shape[-1] == 3 else 0.0))


class HyperelasticLaw(Protocol):
    """w per unit of the volume at rest, S = dw/dG and dS/dG with both symmetries of its pairs of indices."""

    def energy(self, at: Kinematics) -> Array:
        """w, (...) [force / length^2]."""

    def stress(self, at: Kinematics) -> Array:
        """S, (..., d, d) [force / length^2]."""

    def tangent(self, at: Kinematics) -> Array:
        """dS/dG, (..., d, d, d, d) [force / length^2]."""


@dataclass(frozen=True)
class SaintVenantKirchhoff:
    """w = lambda (tr G)^2 / 2 + mu G:G, S = lambda tr G 1 + 2 mu G: linear elasticity at large rotations.

    It is no law for large compression: a bar is weakest at L / L0 = 1 / sqrt(3), and beyond that gives way.
    """

    lame_lambda: float
    lame_mu: float

    def energy(self, at: Kinematics) -> Array:
        """lambda (tr G)^2 / 2 + mu G:G."""
        G = at.strain
        trace = np.trace(G, axis1=-2, axis2=-1)
        return np.asarray(self.lame_lambda * trace**2 / 2 + self.lame_mu * np.sum(G * G, axis=(-2, -1)))

    def stress(self, at: Kinematics) -> Array:
        """lambda tr G 1 + 2 mu G."""
        G = at.strain
        trace = np.trace(G, axis1=-2, axis2=-1)[..., None, None]
        return np.asarray(self.lame_lambda * trace * np.eye(G.shape[-1]) + 2 * self.lame_mu * G)

    def tangent(self, at: Kinematics) -> Array:
        """lambda 1 x 1 + 2 mu 1 symmetric."""
        d = at.gradient.shape[-1]
        identity = np.eye(d)
        constant = _two_pairs(self.lame_lambda, self.lame_mu, identity, identity)
        return np.broadcast_to(constant, (*at.gradient.shape[:-2], d, d, d, d))


@dataclass(frozen=True)
class NeoHookean:
    """w = mu (tr C - 3) / 2 - mu log J + lambda (log J)^2 / 2 (Bonet and Wood 2008, 6.27); it resists J -> 0."""

    lame_lambda: float
    lame_mu: float

    def energy(self, at: Kinematics) -> Array:
        """mu (tr G - log J) + lambda (log J)^2 / 2."""
        trace, log = np.trace(at.strain, axis1=-2, axis2=-1), np.log1p(at.dilation)
        return np.asarray(self.lame_mu * (trace - log) + self.lame_lambda * log**2 / 2)

    def stress(self, at: Kinematics) -> Array:
        """mu (1 - C^-1) + lambda log J C^-1, the first as 2 mu C^-1 G."""
        G = at.strain
        inverse = np.linalg.inv(np.eye(G.shape[-1]) + 2 * G)
        found = 2 * self.lame_mu * inverse @ G + self.lame_lambda * np.log1p(at.dilation)[..., None, None] * inverse
        return np.asarray((found + np.swapaxes(found, -1, -2)) / 2)

    def tangent(self, at: Kinematics) -> Array:
        """lambda C^-1 x C^-1 + 2 (mu - lambda log J) C^-1 symmetric."""
        G = at.strain
        inverse = np.linalg.inv(np.eye(G.shape[-1]) + 2 * G)
        inverse = (inverse + np.swapaxes(inverse, -1, -2)) / 2
        shear = self.lame_mu - self.lame_lambda * np.log1p(at.dilation)
        return _two_pairs(self.lame_lambda, shear[..., None, None, None, None], inverse, inverse)


def _two_pairs(first: float, second: float | Array, a: Array, b: Array) -> Array:
    """first a_ij b_kl + second (a_ik b_jl + a_il b_jk)."""
    crossed = np.einsum("...ik,...jl->...ijkl", a, b) + np.einsum("...il,...jk->...ijkl", a, b)
    return np.asarray(first * np.einsum("...ij,...kl->...ijkl", a, b) + second * crossed)
