"""Elastic bodies: the stiffness matrix from a mesh and a material, and the stresses of a displaced body.

All stresses are (xx, yy, zz, xy, yz, zx), VTK's order, tension positive [force / length^2]. In axial symmetry x is the
radius, y the axis and zz the hoop stress; in plane strain zz is nu (xx + yy). Assembly takes linear time and gives
matrices that are symmetric to the last digit.

`Membrane` is flat, with one deflection per node under a constant tension (Poisson's equation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.elements.material import STRAINS, Material, Model, measure, strain_matrix, strains
from contactqp.elements.mesh import Mesh
from contactqp.elements.nodal_pressure import tributary_areas
from contactqp.elements.reference_elements import (
    REFERENCES,
    Block,
    Geometry,
    Quadrature,
    Reference,
    at_rule,
    batches,
    gauss,
    sum_at_nodes,
    tetrahedron,
    triangle,
)
from contactqp.elements.scalars import moderate_number
from contactqp.elements.surface import Surface
from contactqp.errors import InvalidProblem
from contactqp.model.arguments import checks
from contactqp.model.arrays import Array, Index
from contactqp.model.problem_data import ReadOnly, read_array, read_only, read_vector

# The points at which stresses are most accurate: one for linear simplices, else the Gauss points that integrate a
# linear stress field (Barlow 1976). Stresses are extrapolated from them to the nodes by linear shape functions.
_SAMPLES = {
    "tri3": triangle(1), "tri6": triangle(3), "tet4": tetrahedron(1), "tet10": tetrahedron(4),
    "quad4": gauss(2, 2), "quad8": gauss(2, 2), "quad9": gauss(2, 2),
    "hex8": gauss(2, 3), "hex20": gauss(2, 3), "hex27": gauss(2, 3),
}  # fmt: skip


@checks
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
        The thickness of plane bodies, from 1e-120 to 1e120 [length]. With the default 1 forces are per unit thickness.
    name : str
        Used in every message.

    Raises
    ------
    InvalidProblem
        No mesh, no material, a model that does not fit the mesh, a thickness outside its range or without a meaning,
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

    def __repr__(self) -> str:
        return f"Body({self.name}: {self.mesh!r}, {self.model})"

    def __post_init__(self) -> None:
        if (self.model == "3d") != (self.mesh.dimension == 3):
            raise InvalidProblem(f"{self.name}: a {self.mesh.dimension}D mesh and the model {self.model!r}")
        moderate_number(self.name, self.thickness, "thickness")
        if self.model in ("3d", "axisymmetric") and self.thickness != 1:
            raise InvalidProblem(f"{self.name}: the model {self.model!r} has no thickness, got {self.thickness}")
        if self.model == "axisymmetric" and self.mesh.points[:, 0].min(initial=0.0) < 0:
            i = int(np.argmin(self.mesh.points[:, 0]))
            at = f"{self.mesh.points[i, 0]:.6g} at node {self.mesh.number(i)}"
            raise InvalidProblem(f"{self.name}: expected radii x >= 0, got {at}")

    @property
    def dimension(self) -> int:
        """Return the dimension d of space, 2 or 3."""
        return self.mesh.dimension

    @property
    def axes(self) -> str:
        """Return the axes that a node moves along: ``"xy"`` or ``"xyz"``."""
        return "xyz"[: self.dimension]

    @property
    def size(self) -> int:
        """Return the number of unknowns N d."""
        return int(self.mesh.points.size)

    @cached_property
    def stiffness(self) -> Any:
        """Return K, the sum over the elements of the integral of B'DB: (N d, N d) CSC, symmetric to the last digit.

        [force / length], per unit thickness times `thickness` in plane problems.
        """
        where = pattern([block.nodes for block in self.mesh.blocks], len(self.mesh.points))
        return read_only(from_blocks(where, self.node_blocks(self.mesh.blocks, where)))

    def node_blocks(self, blocks: Sequence[Block], where: Pattern) -> Array:
        """Return the contribution of these elements to K as blocks (pairs, d, d), for the node pairs of `where`."""
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

    def element_stiffness(self, block: Block) -> Array:
        """Return the symmetric element matrices (E, n d, n d) of a block, all at once [force / length].

        In space, with the gradients G_ia = dN_i/dx_a of the shape functions, K_ia,jb is the integral of
        lambda G_ia G_jb + mu (G_ib G_ja + delta_ab G_i.G_j): B'DB of an isotropic material for a fifth of the work.
        """
        geometry, weights = self.integration(block, self.stiffness_rule(block))
        form = self._by_gradients if self.model == "3d" else self._by_strains
        K = form(geometry, weights)
        return np.asarray((K + np.swapaxes(K, 1, 2)) / 2)

    def _by_gradients(self, geometry: Geometry, weights: Array) -> Array:
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

    def _by_strains(self, geometry: Geometry, weights: Array) -> Array:
        B = strain_matrix(geometry, self.model)
        DB = np.matmul(self.material.constitutive(self.model), B) * weights[..., None, None]
        E, q, strains, columns = B.shape
        by_rows = B.reshape(E, q * strains, columns)
        return np.asarray(np.matmul(np.swapaxes(by_rows, 1, 2), DB.reshape(E, q * strains, columns)))

    def stiffness_rule(self, block: Block) -> Quadrature:
        """Return the rule of full integration, in axial symmetry the fine one, because the integrand contains the
        radius.
        """
        return block.kind.fine_rule if self.model == "axisymmetric" else block.kind.rule

    def integration(self, block: Block, rule: Quadrature) -> tuple[Geometry, Array]:
        """Return the elements of a block at the points of a rule, and the weights (E, q) of these points [volume].

        An integral over the body is the sum of weights times the values at the points.
        """
        geometry = at_rule(block, self.mesh.points, rule)
        volume = geometry.determinant * rule.weights
        return geometry, volume * measure(geometry.positions, self.model, self.thickness)

    def surface(self, name: str, *, first: int = 0) -> Surface:
        """Return the named side, for pairing; `first` is the index in u of the body's first unknown.

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

    def rigid_motions(self, centre: Array | None = None) -> Array:
        """Return the motions without strain as columns: translations, then rotations about `centre` [length].

        By default about the mean of the nodes. (N d, 3) in the plane, (N d, 6) in space, (N d, 1), along the axis, in
        axial symmetry. For two axes a < b the rotation is u_a = -x_b, u_b = x_a.
        """
        N, d = self.mesh.points.shape
        if self.model == "axisymmetric":
            return np.tile([[0.0], [1.0]], (N, 1))
        x = self.mesh.points - (self.mesh.points.mean(axis=0) if centre is None else read_vector("centre", centre, d))
        motions = [np.tile(np.eye(d)[:, a], N) for a in range(d)]
        for a, b in ((0, 1), (1, 2), (0, 2))[: 1 if d == 2 else 3]:
            turn = np.zeros((N, d))
            turn[:, a], turn[:, b] = -x[:, b], x[:, a]
            motions.append(turn.ravel())
        return np.stack(motions, axis=1)


def stress_at_nodes(body: Body, displacement: ArrayLike) -> Array:
    """Return (N, 6) stresses at the nodes, extrapolated from the most accurate points of each element and averaged.

    Raises InvalidProblem: the displacement is not (N d,).
    """
    total, count = stress_sums(body, displacement, body.mesh.blocks)
    return total / count


def stress_sums(body: Body, displacement: ArrayLike, blocks: Sequence[Block]) -> tuple[Array, Array]:
    """Return stresses (N, 6) at the nodes, summed over these elements, and the number of elements at each node (N,
    1).
    """
    u = _displacement(body, displacement)
    N = len(body.mesh.points)
    total, count = np.zeros((N, 6)), np.zeros((N, 1))
    for block in blocks:
        geometry = Geometry(block.kind, body.mesh.points[block.nodes], _SAMPLES[block.kind.name].points)
        continued = np.matmul(_continuation(block.kind), stress_in(body, block, geometry, u))
        total += sum_at_nodes(block, continued, N)
        count += sum_at_nodes(block, np.ones((*block.nodes.shape, 1)), N)
    return total, count


def von_mises(stress: ArrayLike) -> Array:
    """Return sqrt(1/2 ((xx-yy)^2 + (yy-zz)^2 + (zz-xx)^2) + 3 (xy^2 + yz^2 + zx^2)) of (..., 6) stresses.

    >>> von_mises([[2.0, 0.0, 0.0, 0.0, 0.0, 0.0], [5.0, 5.0, 5.0, 0.0, 0.0, 0.0]]).tolist()
    [2.0, 0.0]
    """
    xx, yy, zz, xy, yz, zx = np.moveaxis(read_array("stress", stress), -1, 0)
    squares = ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2) / 2 + 3 * (xy**2 + yz**2 + zx**2)
    return np.asarray(np.sqrt(squares))


def stress_in(body: Body, block: Block, geometry: Geometry, u: Array) -> Array:
    """Return sigma = D B u (E, q, 6) at the points of a geometry of the elements of a block.

    Parameters
    ----------
    body : Body
    block : elements of its mesh
    geometry : their geometry at q points
    u : (N d,) array, the displacement of the body
    """
    strain = strains(geometry, body.model, u.reshape(body.mesh.points.shape)[block.nodes])
    return np.asarray(strain @ body.material.stress_matrix(body.model).T)


def _continuation(kind: Reference) -> Array:
    """Return the extrapolation from the sample points to the nodes by linear shape functions, (n, samples)."""
    samples = _SAMPLES[kind.name].points
    if len(samples) == 1:
        return np.ones((len(kind.nodes), 1))
    linear = REFERENCES[kind.linear]
    return linear.shape(kind.nodes) @ np.linalg.inv(linear.shape(samples))


def _displacement(body: Body, displacement: ArrayLike) -> Array:
    u = read_array(f"{body.name}: displacement", displacement)
    if u.shape != (body.size,):
        raise InvalidProblem(f"{body.name}: expected a displacement of shape ({body.size},), got {u.shape}")
    return u


@dataclass(frozen=True, eq=False)
class Pattern:
    """The pairs of nodes that share an element, as compressed rows, and the index there of each pair of each element.

    Attributes
    ----------
    indptr, indices : arrays of int, row i holds the nodes indices[indptr[i]:indptr[i + 1]], ascending
    slots : (total of E n^2,) array of int
        The index in `indices` of every pair (first node, second node) of every element, element by element.
    """

    indptr: Index
    indices: Index
    slots: Index


def pattern(connectivities: Sequence[Index], nodes: int) -> Pattern:
    """Return the pattern of elements with the given (E, n) node numbers among `nodes` nodes, by two counting sorts."""
    rows = np.concatenate([np.repeat(c, c.shape[1], axis=1).ravel() for c in connectivities])
    columns = np.concatenate([np.tile(c, (1, c.shape[1])).ravel() for c in connectivities])
    order = _counting_sort(columns, nodes)
    order = order[_counting_sort(rows[order], nodes)]
    row, column = rows[order], columns[order]
    new = np.ones(len(order), dtype=bool)
    new[1:] = (row[1:] != row[:-1]) | (column[1:] != column[:-1])
    slots = np.empty(len(order), dtype=np.int64)
    slots[order] = np.cumsum(new) - 1
    indptr = np.concatenate([[0], np.cumsum(np.bincount(row[new], minlength=nodes))])
    return Pattern(indptr, column[new], slots)


def assemble(where: Pattern, entries: Array) -> Any:
    """Return the (nodes d, nodes d) CSC matrix of symmetric element matrices; as `blocks_of_nodes`."""
    return from_blocks(where, blocks_of_nodes(where, entries))


def blocks_of_nodes(where: Pattern, entries: Array) -> Array:
    """Return the blocks (pairs in the pattern, d, d) of symmetric element matrices, summed up.

    Parameters
    ----------
    where : Pattern
    entries : (d, d, total of E n^2) array
        entries[a, b, s] couples axis a of the first node of pair s with axis b of its second node.

    Notes
    -----
    Both (i, j) and (j, i) add up their elements one after the other in the order of the elements, so that symmetric
    element matrices give a matrix that is symmetric to the last digit.
    """
    d, count = entries.shape[0], len(where.indices)
    blocks = np.empty((count, d, d))
    for a in range(d):
        for b in range(d):
            blocks[:, a, b] = np.bincount(where.slots, weights=entries[a, b], minlength=count)
    return blocks


def from_blocks(where: Pattern, blocks: Array) -> Any:
    """Return the (nodes d, nodes d) CSC matrix of these blocks; its rows are its columns."""
    size = blocks.shape[1] * (len(where.indptr) - 1)
    # Sparse direct solvers need 32-bit indices, which SciPy uses where they suffice.
    whole = np.int32 if blocks.size < np.iinfo(np.int32).max else np.int64
    indices, indptr = where.indices.astype(whole), where.indptr.astype(whole)
    rows = sp.bsr_array((blocks, indices, indptr), shape=(size, size)).tocsr()
    return sp.csc_array((rows.data, rows.indices, rows.indptr), shape=(size, size))


def _counting_sort(keys: Index, largest: int) -> Index:
    """Return the stable order of integers below `largest`, by a counting sort, the transposition of one compressed
    row.
    """
    row = sp.csr_array((np.arange(len(keys)), keys, [0, len(keys)]), shape=(1, largest))
    order: Index = row.tocsc().data
    return order


@checks
@dataclass(frozen=True, eq=False)
class Membrane:
    """A membrane in the plane z = 0 that deflects by w along z: its energy is the integral of T/2 |grad w|^2.

    Small slopes; the tension does not change. Unknown i is the deflection of node i.

    Parameters
    ----------
    mesh : Mesh
        A mesh in two dimensions, of the plane in which the membrane is stretched.
    tension : float
        T from 1e-120 to 1e120, the force per length across any cut [force / length].
    name : str
        Used in every message.

    Raises
    ------
    InvalidProblem
        No mesh, a mesh in 3D, a tension outside its range.
    """

    mesh: Mesh
    tension: float
    name: str = "membrane"

    def __post_init__(self) -> None:
        if self.mesh.dimension != 2:
            raise InvalidProblem(f"{self.name}: expected a plane mesh for a membrane, got one in 3D")
        moderate_number(self.name, self.tension, "tension")

    @property
    def axes(self) -> str:
        """Return the axes that a node moves along."""
        return "z"

    @property
    def size(self) -> int:
        """Return the number of unknowns N."""
        return len(self.mesh.points)

    @property
    def points(self) -> Array:
        """Return the nodes in space, (N, 3) with z = 0 [length]."""
        return np.column_stack([self.mesh.points, np.zeros(self.size)])

    @cached_property
    def stiffness(self) -> Any:
        """Return K_ij, T times the integral of grad N_i . grad N_j: (N, N) CSC [force / length]."""
        where = pattern([block.nodes for block in self.mesh.blocks], self.size)
        entries = []
        for block in self.mesh.blocks:
            geometry = at_rule(block, self.mesh.points, block.kind.fine_rule)
            weights = self.tension * geometry.determinant * block.kind.fine_rule.weights
            gradient = geometry.gradient
            K = np.einsum("eq,eqia,eqja->eij", weights, gradient, gradient, optimize=True)
            entries.append(((K + np.swapaxes(K, 1, 2)) / 2).ravel())
        return assemble(where, np.concatenate(entries)[np.newaxis, np.newaxis])

    def rigid_motions(self) -> Array:
        """Return the one motion without energy, the same deflection of all nodes, (N, 1)."""
        return np.ones((self.size, 1))

    def areas(self) -> Array:
        """Return the tributary area of each node, (N,) [length^2].

        Raises
        ------
        InvalidProblem
            Elements of several kinds.
        """
        return tributary_areas(self.surface)

    @property
    def surface(self) -> Surface:
        """Return the elements as facets in space, with the unknowns of the nodes along z.

        Raises
        ------
        InvalidProblem
            Elements of several kinds.
        """
        if len(self.mesh.blocks) > 1:
            kinds = ", ".join(block.kind.name for block in self.mesh.blocks)
            raise InvalidProblem(f"{self.name}: expected elements of one kind in a membrane, got {kinds}")
        facets = self.mesh.blocks[0].nodes
        return Surface(self.points, facets, np.arange(3 * self.size).reshape(-1, 3), name=self.name)
