"""Assemble the system K u = f of supported and loaded pieces, and its contact problem."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.distributed.mesh_nodes import ContactSurfaces, Nodes, assemble_stiffness, connected_parts, incidence
from contactqp.distributed.partition_mesh import number_codes
from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.ranks import Product, Ranks, petsc
from contactqp.distributed.rows import Rows, chosen_rows
from contactqp.elements.loads import Load
from contactqp.elements.structure import EVERYTHING_HELD, FreeContacts, Structure, Support
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Index, Mask, Vector
from contactqp.model.problem import Units


@dataclass(frozen=True, eq=False)
class PieceSystem:
    """The system of a structure, with the k d unknowns of this rank's own nodes.

    Parameters
    ----------
    structure : Structure, the pieces of this rank
    nodes : Nodes, their nodes
    prescribed : (k d,) array, displacements of the supports [length], NaN at free unknowns
    """

    structure: Structure
    nodes: Nodes
    prescribed: Vector

    @property
    def ranks(self) -> Ranks:
        """Return the processes."""
        return self.nodes.ranks

    @property
    def dimension(self) -> int:
        """Return the number d of unknowns of a node."""
        return len(self.structure.bodies[0].axes)

    @cached_property
    def constrained(self) -> Mask:
        """Return flags (k d,) of the unknowns that supports constrain."""
        return ~np.isnan(self.prescribed)

    @cached_property
    def support_displacement(self) -> Vector:
        """Return the prescribed displacements (k d,), 0 at free unknowns [length]."""
        return np.where(self.constrained, self.prescribed, 0.0)

    @cached_property
    def parts(self) -> StiffnessParts:
        """Return K in the parts that the problem and its answers need; the first call is collective."""
        PETSc = petsc()
        K = assemble_stiffness([self.structure.solid(body.name) for body in self.structure.bodies], self.nodes)
        support_product = Product(K)(self.support_displacement)
        constrained = np.flatnonzero(self.constrained)
        constrained_rows = Rows.from_csr(chosen_rows(K, constrained), K)
        diagonal = K.getDiagonal()
        K.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        K.zeroRowsColumns((K.getOwnershipRange()[0] + constrained).astype(PETSc.IntType), diag=1.0)
        K.setDiagonal(diagonal)  # diagonal of constrained unknowns, of the size of their neighbours'
        K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        return StiffnessParts(K, support_product, constrained_rows)

    def forces(self, loads: Sequence[Load]) -> Vector:
        """Return the nodal forces (k d,) of loads on all own unknowns [force]. Collective."""
        total = np.zeros(self.structure.size)
        with self.ranks.raising_together():
            for acting in loads:
                first = self.structure.first(acting.body)
                body = self.structure.solid(acting.body)
                total[first : first + body.size] += acting.forces(body)
        return self.nodes.summed(total.reshape(-1, self.dimension)).ravel()

    def constrained_product(self, displacement: Vector) -> Vector:
        """Return K u (k d,) at constrained unknowns, 0 at free ones, from the u of all own unknowns. Collective."""
        found = np.zeros(len(self.constrained))
        found[self.constrained] = self.parts.constrained_rows.lengths(displacement)
        return found

    def own_nodes(self, body: str, number: int | None = None) -> Index:
        """Return the indices among own nodes of a body's nodes, or of the one with a given number."""
        mesh = self.structure.body(body).mesh
        if number is not None:
            return self.own_places(body, mesh.places(body, np.array([number])))
        first = self.structure.first(body) // self.dimension
        mine = self.nodes.own[(self.nodes.own >= first) & (self.nodes.own < first + len(mesh.points))]
        return np.asarray(self.nodes.place[mine] - self.nodes.first)

    def own_places(self, body: str, nodes: Index) -> Index:
        """Return the indices among own nodes of `nodes` of a body's piece, which this rank owns."""
        first = self.structure.first(body) // self.dimension
        return np.asarray(self.nodes.place[first + nodes] - self.nodes.first)

    def right_side(self, load: Vector) -> Vector:
        """Return f - K u_prescribed (k d,) at free unknowns, 0 at constrained ones [force]."""
        return np.where(self.constrained, 0.0, load - self.parts.support_product)

    def problem(
        self, load: Vector, surfaces: ContactSurfaces, contacts: FreeContacts, slaves: Index, *, units: Units
    ) -> DistributedProblem:
        """Return this rank's part of the contact problem. Collective.

        Parameters
        ----------
        load : (k d,) array
            Forces on all own unknowns [force].
        surfaces : ContactSurfaces
            The surfaces that may touch.
        contacts : FreeContacts
            The contacts, over the free unknowns of `surfaces`.
        slaves : (m,) array of int
            The place in `surfaces` of each contact's node, whose owner gets the contact.
        units : Units
            The units of the scene.
        """
        K, d = self.parts.free, self.dimension
        mine = np.flatnonzero(surfaces.owners[slaves] == self.ranks.rank)
        unknowns = (d * surfaces.place[:, None] + np.arange(d)).ravel()
        free = unknowns[surfaces.gathered(self.nodes, ~self.constrained.reshape(-1, d)).ravel()]
        tangential: dict[str, Any] = {}
        if contacts.friction is not None and contacts.slip_origin is not None:
            per = d - 1
            along = (per * mine[:, None] + np.arange(per)).ravel()
            tangential = {
                "tangent": Rows.from_csr(sp.csr_matrix(contacts.tangent[along]), K, free),
                "friction": contacts.friction[mine],
                "slip_origin": contacts.slip_origin.reshape(-1, per)[mine],
            }
        names = [contacts.names[i] for i in mine]
        return DistributedProblem(
            ranks=self.ranks,
            stiffness=K,
            load=self.right_side(load),
            normal=Rows.from_csr(sp.csr_matrix(contacts.normal[mine]), K, free),
            gap=contacts.gap[mine],
            tie=Rows.from_csr(sp.csr_matrix((0, len(free))), K, free),
            tie_value=np.zeros(0),
            constrained=self.constrained,
            body=np.repeat(self._bodies(), d),
            near_null_space=self._motions(),
            dof_number=self._free_numbers(),
            contact_number=mine.astype(np.int64),
            tie_number=np.zeros(0, dtype=np.int64),
            units=units,
            dof_name=self._name,
            contact_name=names.__getitem__,
            **tangential,
        )

    def _motions(self) -> Vector:
        """Return rigid motions about one centre for each body across ranks, 0 at constrained unknowns."""
        parts, first = [], 0
        for body in self.structure.bodies:
            N = len(body.mesh.points)
            mine = self.nodes.own[(self.nodes.own >= first) & (self.nodes.own < first + N)] - first
            first += N
            total = self.ranks.sum(body.mesh.points[mine].sum(axis=0))
            motions = self.structure.solid(body.name).rigid_motions(total / body.mesh.total)
            d, q = self.dimension, motions.shape[1]
            parts.append(motions.reshape(N, d, q)[mine].reshape(d * len(mine), q))
        motions = np.concatenate(parts)
        motions[self.constrained] = 0.0
        return motions

    def _bodies(self) -> Index:
        free: Mask = ~np.all(self.constrained.reshape(-1, self.dimension), axis=1)
        return connected_parts(self.nodes, incidence(self.structure.bodies), self.nodes.with_ghosts(free))

    def _free_numbers(self) -> Index:
        """Return the number of each own unknown among the free ones as in one process, -1 for constrained ones."""
        numbers = self.nodes.numbers[self.nodes.own]
        unknowns = (self.dimension * numbers[:, None] + np.arange(self.dimension)).ravel()
        found, free = np.full(len(unknowns), -1), ~self.constrained
        found[free] = number_codes(self.ranks, unknowns[free])[0]
        return found

    def _name(self, here: int) -> str:
        node, axis = divmod(int(here), self.dimension)
        number = int(self.nodes.numbers[self.nodes.own[node]])
        for body in self.structure.bodies:
            if number < body.mesh.total:
                return f"{body.name} node {number} {body.axes[axis]}"
            number -= body.mesh.total
        raise IndexError(here)


@dataclass(frozen=True, eq=False)
class StiffnessParts:
    """K with decoupled constrained unknowns, and the rows and columns that were removed.

    Attributes
    ----------
    free : PETSc.Mat, K with only the diagonal in rows and columns of constrained unknowns
    support_product : (k d,) array, K u_prescribed on all own unknowns [force]
    constrained_rows : the rows of K of this rank's constrained unknowns
    """

    free: Any
    support_product: Vector
    constrained_rows: Rows


def prescribed_displacements(structure: Structure, nodes: Nodes, supports: Sequence[Support]) -> Vector:
    """Return the prescribed displacements (k d,) of own unknowns, NaN at free ones. Collective.

    Raises InvalidProblem as `Structure.assemble` does.
    """
    with nodes.ranks.raising_together():
        every = structure.prescribed(supports)
    mine = every.reshape(-1, len(structure.bodies[0].axes))[nodes.own].ravel()
    if not nodes.ranks.any(np.isnan(mine)):
        raise InvalidProblem(EVERYTHING_HELD)
    return mine
