"""Solids at large displacements and strains, from the mesh and the quadrature of a linear elastic body.

A hyperelastic law gives energy, second Piola-Kirchhoff stress and its tangent from the displacement gradient
H = du/dX. F = 1 + H, C = F'F, Green's strain G = (H + H' + H'H) / 2, J = det F. Everything is formed from H, so that
small strains keep their digits. In the plane F_zz = 1 (plane strain), or S_zz = 0 where a law has a form for plane
stress.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from contactqp.elements.reference_elements import Block, batches, sum_at_nodes
from contactqp.elements.scalars import real_vector
from contactqp.elements.solid import Body, Pattern, assemble, pattern
from contactqp.elements.structure import Structure
from contactqp.errors import InvalidProblem, shown
from contactqp.model.arguments import checks
from contactqp.model.arrays import Array, computes

LAWS = ("saint-venant-kirchhoff", "neo-hookean")


@dataclass(frozen=True, eq=False)
class Kinematics:
    """The strain measures that a law needs at (..., d, d) displacement gradients."""

    gradient: Array  # H

    @property
    def deformation(self) -> Array:
        """Return F = 1 + H."""
        return np.asarray(np.eye(self.gradient.shape[-1]) + self.gradient)

    @property
    def strain(self) -> Array:
        """Return G = (H + H' + H'H) / 2."""
        H = self.gradient
        turned = np.swapaxes(H, -1, -2)
        return np.asarray((H + turned + turned @ H) / 2)

    @property
    def dilation(self) -> Array:
        """Return J - 1 = tr H + second invariant of H + (3D) det H, (...)."""
        H = self.gradient
        trace = np.trace(H, axis1=-2, axis2=-1)
        second = (trace**2 - np.trace(H @ H, axis1=-2, axis2=-1)) / 2
        return np.asarray(trace + second + (np.linalg.det(H) if H.shape[-1] == 3 else 0.0))


class HyperelasticLaw(Protocol):
    """A law w per unit of the volume at rest, with S = dw/dG, and dS/dG with both symmetries of its pairs of
    indices.
    """

    def energy(self, at: Kinematics) -> Array:
        """Return w, (...) [force / length^2]."""

    def stress(self, at: Kinematics) -> Array:
        """Return S, (..., d, d) [force / length^2]."""

    def tangent(self, at: Kinematics) -> Array:
        """Return dS/dG, (..., d, d, d, d) [force / length^2]."""


@dataclass(frozen=True)
class SaintVenantKirchhoff:
    """Linear elasticity at large rotations: w = lambda (tr G)^2 / 2 + mu G:G, S = lambda tr G 1 + 2 mu G.

    It is not suited to large compression: the force of a bar is largest at L / L0 = 1 / sqrt(3) and falls beyond that.
    """

    lame_lambda: float
    lame_mu: float

    def energy(self, at: Kinematics) -> Array:
        """Return lambda (tr G)^2 / 2 + mu G:G."""
        G = at.strain
        trace = np.trace(G, axis1=-2, axis2=-1)
        return np.asarray(self.lame_lambda * trace**2 / 2 + self.lame_mu * np.sum(G * G, axis=(-2, -1)))

    def stress(self, at: Kinematics) -> Array:
        """Return lambda tr G 1 + 2 mu G."""
        G = at.strain
        trace = np.trace(G, axis1=-2, axis2=-1)[..., None, None]
        return np.asarray(self.lame_lambda * trace * np.eye(G.shape[-1]) + 2 * self.lame_mu * G)

    def tangent(self, at: Kinematics) -> Array:
        """Return lambda 1 x 1 + 2 mu 1 symmetric."""
        d = at.gradient.shape[-1]
        identity = np.eye(d)
        constant = _two_pairs(self.lame_lambda, self.lame_mu, identity, identity)
        return np.broadcast_to(constant, (*at.gradient.shape[:-2], d, d, d, d))


def _inverse(matrices: Array) -> Array:
    """Return the inverses of matrices (..., d, d), NaN where an element has been crushed: such a step is refused."""
    try:
        return np.asarray(np.linalg.inv(matrices))
    except np.linalg.LinAlgError:
        return np.full_like(matrices, np.nan)


@dataclass(frozen=True)
class NeoHookean:
    """The law w = mu (tr C - 3) / 2 - mu log J + lambda (log J)^2 / 2 (Bonet and Wood 2008, 6.27); it resists J ->
    0.
    """

    lame_lambda: float
    lame_mu: float

    def energy(self, at: Kinematics) -> Array:
        """Return mu (tr G - log J) + lambda (log J)^2 / 2."""
        trace, log = np.trace(at.strain, axis1=-2, axis2=-1), np.log1p(at.dilation)
        return np.asarray(self.lame_mu * (trace - log) + self.lame_lambda * log**2 / 2)

    def stress(self, at: Kinematics) -> Array:
        """Return mu (1 - C^-1) + lambda log J C^-1, the first as 2 mu C^-1 G."""
        G = at.strain
        inverse = _inverse(np.eye(G.shape[-1]) + 2 * G)
        found = 2 * self.lame_mu * inverse @ G + self.lame_lambda * np.log1p(at.dilation)[..., None, None] * inverse
        return np.asarray((found + np.swapaxes(found, -1, -2)) / 2)

    def tangent(self, at: Kinematics) -> Array:
        """Return lambda C^-1 x C^-1 + 2 (mu - lambda log J) C^-1 symmetric."""
        G = at.strain
        inverse = _inverse(np.eye(G.shape[-1]) + 2 * G)
        inverse = (inverse + np.swapaxes(inverse, -1, -2)) / 2
        shear = self.lame_mu - self.lame_lambda * np.log1p(at.dilation)
        return _two_pairs(self.lame_lambda, shear[..., None, None, None, None], inverse, inverse)


def _two_pairs(first: float, second: float | Array, a: Array, b: Array) -> Array:
    """Return first a_ij b_kl + second (a_ik b_jl + a_il b_jk)."""
    crossed = np.einsum("...ik,...jl->...ijkl", a, b) + np.einsum("...il,...jk->...ijkl", a, b)
    return np.asarray(first * np.einsum("...ij,...kl->...ijkl", a, b) + second * crossed)


@checks
@computes
@dataclass(frozen=True, eq=False)
class NonlinearSolid:
    """A body of a hyperelastic material: energy, internal force and tangent by Gauss quadrature over its mesh at rest.

    Unknowns, mesh, sides, rigid motions and dead loads (`load.forces(body)`) are those of `body`.

    Parameters
    ----------
    body : Body
        In plane strain or 3D; in plane stress with the law of Saint Venant and Kirchhoff, whose S_zz = 0 then.
    law : "saint-venant-kirchhoff", "neo-hookean" or a HyperelasticLaw
        The named laws take the Lame constants of the body's material.

    Raises
    ------
    InvalidProblem
        Another law or model; on use, an element turned inside out (det F <= 0 at a quadrature point), where the energy
        is inf.

    Notes
    -----
    With g_a = dN_a/dX and F = 1 + sum of u_a g_a', the force on node a is the integral of F S g_a, and the tangent that
    of F_iI C_IJKL F_kK g_aJ g_bL + delta_ik g_a.S g_b (Bonet and Wood 2008, chapter 9).

    Examples
    --------
    >>> from contactqp.elements.material import Material
    >>> from contactqp.elements.shapes import rectangle
    >>> square = Body(rectangle(1.0, 1.0, (1, 1)), Material(modulus=1.0, poisson=0.0), "plane-strain")
    >>> solid = NonlinearSolid(square, "saint-venant-kirchhoff")
    >>> stretched = np.array([1.0, 0.0]) * square.mesh.points / 2
    >>> solid.energy(stretched.ravel()), 0.625**2 / 2
    (0.1953125, 0.1953125)
    """

    body: Body
    law: str | HyperelasticLaw = "neo-hookean"

    def __post_init__(self) -> None:
        if not isinstance(self.body, Body):
            raise InvalidProblem(f"nonlinear solid: expected a Body, got {type(self.body).__name__}")
        name, model = self.body.name, self.body.model
        if isinstance(self.law, str) and self.law not in LAWS:
            raise InvalidProblem(f"{name}: expected a law of {', '.join(LAWS)}, got {shown(self.law)}")
        if model == "axisymmetric" or (model == "plane-stress" and self.law != "saint-venant-kirchhoff"):
            raise InvalidProblem(
                f"{name}: large strains have no form for the model {model!r} with the law {self.law!r}"
            )

    def unknown_names(self) -> tuple[str, ...]:
        """Return ``"block node 12 x"`` for each unknown."""
        return Structure([self.body]).unknown_names()

    @property
    def dimension(self) -> int:
        """Return the number of unknowns, n = N d for N nodes."""
        return self.body.size

    @cached_property
    def hyperelastic(self) -> HyperelasticLaw:
        """Return the law with its constants."""
        if not isinstance(self.law, str):
            return self.law
        material = self.body.material
        lame_lambda, lame_mu = material.lame_lambda, material.lame_mu
        if self.body.model == "plane-stress":
            lame_lambda = 2 * lame_lambda * lame_mu / (lame_lambda + 2 * lame_mu)
        kind = SaintVenantKirchhoff if self.law == "saint-venant-kirchhoff" else NeoHookean
        return kind(lame_lambda, lame_mu)

    def energy(self, displacement: ArrayLike) -> float:
        """Return the integral of w over the body at rest [force * length]; inf where an element is turned inside
        out.
        """
        total = 0.0
        for part in self._parts(displacement):
            if np.any(part.at.dilation <= -1):
                return float("inf")
            total += float(np.sum(part.volume * self.hyperelastic.energy(part.at)))
        return total

    def internal_force(self, displacement: ArrayLike) -> Array:
        """Return the gradient of the energy, (n,) [force].

        Raises
        ------
        InvalidProblem
            An element turned inside out, which is named.
        """
        N = len(self.body.mesh.points)
        total = np.zeros((N, self.body.dimension))
        for part in self._admitted(displacement):
            P = part.at.deformation @ self.hyperelastic.stress(part.at) * part.volume[..., None, None]
            total += sum_at_nodes(part.block, np.einsum("eqna,eqia->eni", part.gradient, P), N)
        return total.ravel()

    def tangent(self, displacement: ArrayLike) -> Any:
        """Return the Hessian of the energy, (n, n) CSC, symmetric to the last digit [force / length].

        Raises
        ------
        InvalidProblem
            As `internal_force`.
        """
        d = self.body.dimension
        entries = np.empty((d, d, len(self._pattern.slots)))
        at = 0
        for part in self._admitted(displacement):
            n = part.block.nodes.shape[1]
            pairs = len(part.block) * n * n
            entries[:, :, at : at + pairs] = np.transpose(self._blocks(part), (2, 4, 0, 1, 3)).reshape(d, d, pairs)
            at += pairs
        return assemble(self._pattern, entries)

    def cauchy_stress(self, displacement: ArrayLike) -> tuple[Array, ...]:
        """Return sigma = F S F' / J at the quadrature points of each batch of elements, (E, q, d, d), positive in
        tension.
        """
        found = []
        for part in self._admitted(displacement):
            F, S = part.at.deformation, self.hyperelastic.stress(part.at)
            found.append(F @ S @ np.swapaxes(F, -1, -2) / (1 + part.at.dilation)[..., None, None])
        return tuple(found)

    def _blocks(self, part: _Part) -> Array:
        """Return the symmetric element matrices (E, n, d, n, d)."""
        g, F = part.gradient, part.at.deformation
        S = self.hyperelastic.stress(part.at) * part.volume[..., None, None]
        C = self.hyperelastic.tangent(part.at) * part.volume[..., None, None, None, None]
        spread = np.einsum("eqiI,eqnJ->eqniIJ", F, g)
        E, q, n, d = g.shape
        B = spread.reshape(E, q, n * d, d * d)
        axial = np.matmul(np.matmul(B, C.reshape(E, q, d * d, d * d)), np.swapaxes(B, 2, 3)).sum(axis=1)
        K = axial.reshape(E, n, d, n, d)
        geometric = np.einsum("eqnI,eqIJ,eqmJ->enm", g, S, g, optimize=True)
        for a in range(d):
            K[:, :, a, :, a] += geometric
        return np.asarray((K + np.transpose(K, (0, 3, 4, 1, 2))) / 2)

    @cached_property
    def _pattern(self) -> Pattern:
        return pattern([block.nodes for block in self.body.mesh.blocks], len(self.body.mesh.points))

    @cached_property
    def _at_rest(self) -> list[tuple[Block, int, Array, Array]]:
        """Return, for every batch of elements, its block, the index of its first element, shape gradients and
        weights.
        """
        d, found = self.body.dimension, []
        for block in self.body.mesh.blocks:
            rule, first = self.body.stiffness_rule(block), 0
            n = block.nodes.shape[1]
            for part in batches(block, len(rule.weights) * (n * d) ** 2):
                geometry, volume = self.body.integration(part, rule)
                found.append((part, first, geometry.gradient, volume))
                first += len(part)
        return found

    def _parts(self, displacement: ArrayLike) -> Iterator[_Part]:
        u = real_vector("displacement", displacement, self.dimension)
        moved = u.reshape(self.body.mesh.points.shape)
        for block, first, gradient, volume in self._at_rest:
            H = np.einsum("eni,eqnJ->eqiJ", moved[block.nodes], gradient)
            yield _Part(block, first, gradient, volume, Kinematics(H))

    def _admitted(self, displacement: ArrayLike) -> Iterator[_Part]:
        """Return the parts, and refuse elements that are turned inside out."""
        for part in self._parts(displacement):
            inverted = np.flatnonzero(np.any(part.at.dilation <= -1, axis=1))
            if inverted.size:
                element, kind = part.first + int(inverted[0]), part.block.kind.name
                raise InvalidProblem(f"{self.body.name}: {kind} element {element} is turned inside out (det F <= 0)")
            yield part


@dataclass(frozen=True, eq=False)
class _Part:
    """A batch of elements at a displacement."""

    block: Block
    first: int
    gradient: Array  # (E, q, n, d) dN/dX
    volume: Array  # (E, q)
    at: Kinematics
