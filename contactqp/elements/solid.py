"""Elastic bodies: a mesh, a material, and the stiffness matrix that follows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.assembly import Pattern, blocks_of_nodes, from_blocks, pattern
from contactqp.elements.geometry import Block, Geometry, at_rule, batches
from contactqp.elements.kinematics import measure, strain_matrix
from contactqp.elements.material import MODELS, STRAINS, Material, Model
from contactqp.elements.mesh import Mesh
from contactqp.elements.quadrature import Quadrature
from contactqp.elements.reading import positive_number
from contactqp.elements.surface import Surface
from contactqp.errors import InvalidProblem
from contactqp.model.problem_data import ReadOnly, read_only


@dataclass(frozen=True, eq=False)
class Body(ReadOnly):
    """One linear elastic body. Its unknowns are node by node: u[d i + a] is the displacement of node i along axis a.

    Parameters
    ----------
    mesh : Mesh
    material : Material
    model : str
        ``"plane-strain"``, ``"plane-stress"``, ``"axisymmetric"`` (x is the radius, y the axis; all forces and the
        stiffness are those of the full circle, 2 pi r) or ``"3d"``.
    thickness : float
        Of plane bodies [length]. With the default 1 forces are per unit thickness.
    name : str
        Used in every message.

    Raises
    ------
    InvalidProblem
        No mesh, no material, a model that does not fit the mesh, a thickness that is not positive or has no meaning,
        a negative radius.

    Notes
    -----
    Nodes on the axis of symmetry have r = 0 and cannot move radially: fix their displacement along x.
    """

    mesh: Mesh
    material: Material
    model: Model
    thickness: float = 1.0
    name: str = "body"

    def __post_init__(self) -> None:
        for what, value, kind in (("mesh", self.mesh, Mesh), ("material", self.material, Material)):
            if not isinstance(value, kind):
                raise InvalidProblem(f"{self.name}: expected a {kind.__name__} as its {what}, got {value!r}")
        if self.model not in MODELS:
            raise InvalidProblem(f"{self.name}: expected a model of {', '.join(MODELS)}, got {self.model!r}")
        if (self.model == "3d") != (self.mesh.dimension == 3):
            raise InvalidProblem(f"{self.name}: a {self.mesh.dimension}D mesh and the model {self.model!r}")
        positive_number(self.name, self.thickness, "thickness")
        if self.model in ("3d", "axisymmetric") and self.thickness != 1:
            raise InvalidProblem(f"{self.name}: the model {self.model!r} has no thickness, got {self.thickness}")
        if self.model == "axisymmetric" and self.mesh.points[:, 0].min(initial=0.0) < 0:
            i = int(np.argmin(self.mesh.points[:, 0]))
            at = f"{self.mesh.points[i, 0]:.6g} at node {self.mesh.number(i)}"
            raise InvalidProblem(f"{self.name}: expected radii x >= 0, got {at}")

    @property
    def dimension(self) -> int:
        """d."""
        return self.mesh.dimension

    @property
    def axes(self) -> str:
        """The axes that a node moves along: ``"xy"`` or ``"xyz"``."""
        return "xyz"[: self.dimension]

    @property
    def size(self) -> int:
        """How many unknowns the body has: N d."""
        return int(self.mesh.points.size)

    @cached_property
    def stiffness(self) -> Any:
        """K = sum over the elements of the integral of B'DB: (N d, N d) CSC, symmetric to the last digit.

        [force / length], per unit thickness times `thickness` in plane problems.
        """
        where = pattern([block.nodes for block in self.mesh.blocks], len(self.mesh.points))
        return read_only(from_blocks(where, self.node_blocks(self.mesh.blocks, where)))

    def node_blocks(self, blocks: Sequence[Block], where: Pattern) -> NDArray[np.float64]:
        """What these elements bring to K: its blocks (pairs, d, d), for the nodes as `where` numbers them."""
        d = self.dimension
        entries = np.empty((d, d, len(where.slots)))
        at = 0
        for block in blocks:
            n = block.nodes.shape[1]
            points = len(self.stiffness_rule(block).weights)
            for part in batches(block, points * len(STRAINS[self.model]) * n * d):
                pairs = len(part) * n * n
                K = self.element_stiffness(part).reshape(len(part), n, d, n, d)
                entries[:, :, at : at + pairs] = np.transpose(K, (2, 4, 0, 1, 3)).reshape(d, d, pairs)
                at += pairs
        return blocks_of_nodes(where, entries)

    def element_stiffness(self, block: Block) -> NDArray[np.float64]:
        """The symmetric element matrices (E, n d, n d) of a block, all at once [force / length].

        In space, with the gradients G_ia = dN_i/dx_a of the shape functions, K_ia,jb is the integral of
        lambda G_ia G_jb + mu (G_ib G_ja + delta_ab G_i.G_j): B'DB of an isotropic material for a fifth of the work.
        """
        geometry, weights = self.integration(block, self.stiffness_rule(block))
        form = self._by_gradients if self.model == "3d" else self._by_strains
        K = form(geometry, weights)
        return np.asarray((K + np.swapaxes(K, 1, 2)) / 2)

    def _by_gradients(self, geometry: Geometry, weights: NDArray[np.float64]) -> NDArray[np.float64]:
        gradient = geometry.gradient
        E, q, n, d = gradient.shape
        gradient = gradient.reshape(E, q, n * d)
        weighted = np.swapaxes(gradient * weights[..., None], 1, 2)
        products = np.matmul(weighted, gradient).reshape(E, n, d, n, d)
        lame_lambda, lame_mu = self.material.lame_lambda, self.material.lame_mu
        K = lame_lambda * products + lame_mu * np.swapaxes(products, 2, 4)
        of_both = lame_mu * np.einsum("eiaja->eij", products)
        for a in range(d):
            K[:, :, a, :, a] += of_both
        return np.asarray(K.reshape(E, n * d, n * d))

    def _by_strains(self, geometry: Geometry, weights: NDArray[np.float64]) -> NDArray[np.float64]:
        B = strain_matrix(geometry, self.model)
        DB = np.matmul(self.material.constitutive(self.model), B) * weights[..., None, None]
        E, q, strains, columns = B.shape
        by_rows = B.reshape(E, q * strains, columns)
        return np.asarray(np.matmul(np.swapaxes(by_rows, 1, 2), DB.reshape(E, q * strains, columns)))

    def stiffness_rule(self, block: Block) -> Quadrature:
        """Full integration; in axial symmetry the fine rule, because the radius stands in the integrand."""
        return block.kind.fine_rule if self.model == "axisymmetric" else block.kind.rule

    def integration(self, block: Block, rule: Quadrature) -> tuple[Geometry, NDArray[np.float64]]:
        """The block's elements at a rule's points, and weights (E, q): an integral over the body sums them up."""
        geometry = at_rule(block, self.mesh.points, rule)
        volume = geometry.determinant * rule.weights
        return geometry, volume * measure(geometry.positions, self.model, self.thickness)

    def surface(self, name: str, *, first: int = 0) -> Surface:
        """The named side, for pairing; `first` is the place of the body's first unknown in u.

        Raises
        ------
        InvalidProblem
            No such side, a side without faces, a side of several kinds of facet.
        """
        facets = self.mesh.side(name)
        if len(facets) > 1:
            kinds = ", ".join(block.kind.name for block in facets)
            raise InvalidProblem(f"{self.name}: side {name!r} has facets of several kinds ({kinds}); expected one kind")
        unknowns = first + np.arange(self.size).reshape(self.mesh.points.shape)
        where = f"{self.name}.{name}"
        return Surface(self.mesh.points, facets[0].nodes, unknowns, where, self.thickness, self.model == "axisymmetric")

    def rigid_motions(self, centre: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
        """The motions without strain as columns: translations, then rotations about `centre` [length].

        By default about the mean of the nodes. (N d, 3) in the plane, (N d, 6) in space, (N d, 1), along the axis, in
        axial symmetry. For two axes a < b the rotation is u_a = -x_b, u_b = x_a.
        """
        N, d = self.mesh.points.shape
        if self.model == "axisymmetric":
            return np.tile([[0.0], [1.0]], (N, 1))
        x = self.mesh.points - (self.mesh.points.mean(axis=0) if centre is None else centre)
        motions = [np.tile(np.eye(d)[:, a], N) for a in range(d)]
        for a, b in ((0, 1), (1, 2), (0, 2))[: 1 if d == 2 else 3]:
            turn = np.zeros((N, d))
            turn[:, a], turn[:, b] = -x[:, b], x[:, a]
            motions.append(turn.ravel())
        return np.stack(motions, axis=1)
