"""K u = f of pieces that supports hold and loads act on, and the contact problem that it makes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.environment import petsc
from contactqp.distributed.pieces.nodes import Nodes, Touching, assemble_stiffness, connected_parts, incidence
from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.ranks import Ranks, asked
from contactqp.distributed.rows import Rows, chosen_rows
from contactqp.elements.loads import Load
from contactqp.elements.structure import EVERYTHING_HELD, FreeContacts, Structure, Support
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Index, Vector
from contactqp.model.problem import Units


@dataclass(frozen=True, eq=False)
class PieceSystem:
    """As `structure.System`, of which this rank has the unknowns of its own nodes, k d of them.

    Parameters
    ----------
    structure : Structure
        Of the pieces of this rank.
    nodes : Nodes
    prescribed : (k d,) array
        Displacements of the supports [length], NaN at free unknowns.
    """

    structure: Structure
    nodes: Nodes
    prescribed: Vector

    @property
    def ranks(self) -> Ranks:
        return self.nodes.ranks

    @property
    def dimension(self) -> int:
        """d."""
        return len(self.structure.bodies[0].axes)

    @cached_property
    def held(self) -> NDArray[np.bool_]:
        """(k d,) unknowns that supports hold."""
        return ~np.isnan(self.prescribed)

    @cached_property
    def given(self) -> Vector:
        """(k d,) the prescribed displacements, 0 at free unknowns [length]."""
        return np.where(self.held, self.prescribed, 0.0)

    @cached_property
    def parts(self) -> StiffnessParts:
        """K in the parts that the problem and its answers need. First asked collectively."""
        return _in_parts(self)

    def forces(self, loads: Sequence[Load]) -> Vector:
        """(k d,) nodal forces of loads on all own unknowns [force]. Collective."""
        total = np.zeros(self.structure.size)
        with self.ranks.together():
            for acting in loads:
                first = self.structure.first(acting.body)
                body = self.structure.solid(acting.body)
                total[first : first + body.size] += acting.forces(body)
        return self.nodes.summed(total.reshape(-1, self.dimension)).ravel()

    def at_held(self, displacement: Vector) -> Vector:
        """K u at held unknowns, 0 at free ones: (k d,), from the u of all own unknowns. Collective."""
        found = np.zeros(len(self.held))
        found[self.held] = self.parts.of_held.lengths(displacement)
        return found

    def own_nodes(self, body: str, number: int | None = None) -> Index:
        """The places among own nodes of those of a body, or of the one with a number in it."""
        mesh = self.structure.body(body).mesh
        if number is not None:
            return self.own_places(body, mesh.places(body, np.array([number])))
        first = self.structure.first(body) // self.dimension
        mine = self.nodes.own[(self.nodes.own >= first) & (self.nodes.own < first + len(mesh.points))]
        return np.asarray(self.nodes.place[mine] - self.nodes.first)

    def own_places(self, body: str, nodes: Index) -> Index:
        """The places among own nodes of those that the piece of a body has at `nodes`, all own."""
        first = self.structure.first(body) // self.dimension
        return np.asarray(self.nodes.place[first + nodes] - self.nodes.first)

    def right_side(self, load: Vector) -> Vector:
        """f - K u_prescribed at free unknowns, 0 at held ones: (k d,) [force]."""
        return np.where(self.held, 0.0, load - self.parts.of_given)

    def problem(
        self, load: Vector, touching: Touching, contacts: FreeContacts, slaves: Index, *, units: Units
    ) -> DistributedProblem:
        """The contact problem. Collective.

        Parameters
        ----------
        load : (k d,) array
            On all own unknowns [force].
        touching : Touching
        contacts : FreeContacts
            Over the free unknowns of `touching`.
        slaves : (m,) array of int
            The place in `touching` of each contact's node: its owner has the contact.
        """
        K, d = self.parts.free, self.dimension
        mine = np.flatnonzero(touching.owners[slaves] == self.ranks.rank)
        unknowns = (d * touching.place[:, None] + np.arange(d)).ravel()
        free = touching.gathered(self.nodes, ~self.held.reshape(-1, d)).ravel()
        there = unknowns[free]
        tangential: dict[str, Any] = {}
        if contacts.friction is not None and contacts.slip_origin is not None:
            per = d - 1
            along = (per * mine[:, None] + np.arange(per)).ravel()
            tangential = {
                "tangent": _rows(contacts.tangent[along], there, K),
                "friction": contacts.friction[mine],
                "slip_origin": contacts.slip_origin.reshape(-1, per)[mine],
            }
        names = [contacts.names[i] for i in mine]
        return DistributedProblem(
            ranks=self.ranks,
            stiffness=K,
            load=self.right_side(load),
            normal=_rows(contacts.normal[mine], there, K),
            gap=contacts.gap[mine],
            tie=_rows(sp.csr_matrix((0, len(there))), there, K),
            tie_value=np.zeros(0),
            held=self.held,
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
        """Rigid motions about one centre for each body, on whatever ranks its nodes are; 0 where held."""
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
        motions[self.held] = 0.0
        return motions

    def _bodies(self) -> Index:
        loose: NDArray[np.bool_] = ~np.all(self.held.reshape(-1, self.dimension), axis=1)
        return connected_parts(self.nodes, incidence(self.structure.bodies), self.nodes.spread(loose))

    def _free_numbers(self) -> Index:
        """The number of each own unknown among the free ones in the order of one process; -1 where held."""
        ranks, nodes = self.ranks, self.nodes
        free = ~self.held.reshape(-1, self.dimension)
        count = free.sum(axis=1)
        total = int(ranks.sum(len(nodes.own)))
        numbers = nodes.numbers[nodes.own]

        def answer(came: Index, _: Index) -> tuple[Index]:
            order = np.argsort(came[:, 0])
            before = np.empty(len(order), dtype=np.int64)
            before[order] = np.cumsum(came[order, 1]) - came[order, 1]
            return (ranks.first(int(came[:, 1].sum())) + before,)

        question = np.column_stack([numbers, count])
        (start,) = asked(ranks, numbers * ranks.size // max(total, 1), question, answer)
        found = start[:, None] + np.cumsum(free, axis=1) - 1
        return np.where(free, found, -1).ravel().astype(np.int64)

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
    """K with rows of their own for held unknowns, and what their rows and columns were.

    Attributes
    ----------
    free : PETSc.Mat
    of_given : (k d,) array
        K u_prescribed on all own unknowns [force].
    of_held : Rows
        Those of this rank's held unknowns.
    """

    free: Any
    of_given: Vector
    of_held: Rows


def prescribed_of(structure: Structure, nodes: Nodes, supports: Sequence[Support]) -> Vector:
    """(k d,) the prescribed displacements of own unknowns, NaN at free ones. Collective.

    Raises
    ------
    InvalidProblem
        As `Structure.assemble`.
    """
    with nodes.ranks.together():
        every = structure.prescribed(supports)
    mine = every.reshape(-1, len(structure.bodies[0].axes))[nodes.own].ravel()
    if not nodes.ranks.any(np.isnan(mine)):
        raise InvalidProblem(EVERYTHING_HELD)
    return mine


def _in_parts(system: PieceSystem) -> StiffnessParts:
    PETSc = petsc()
    bodies = [system.structure.solid(body.name) for body in system.structure.bodies]
    K = assemble_stiffness(bodies, system.nodes)
    into, at = K.createVecs()
    at.array[:] = system.given
    K.mult(at, into)
    held = np.flatnonzero(system.held)
    of_held = Rows.over_touched(chosen_rows(K, held), K)
    diagonal = K.getDiagonal()
    K.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
    K.zeroRowsColumns((K.getOwnershipRange()[0] + held).astype(PETSc.IntType), diag=1.0)
    K.setDiagonal(diagonal)  # a support's own stiffness is of the size of its neighbours'
    K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    return StiffnessParts(K, np.array(into.array), of_held)


def _rows(rows: Any, there: Index, like: Any) -> Rows:
    rows = sp.csr_matrix(rows)
    columns = np.unique(rows.indices)
    return Rows(rows[:, columns], there[columns], like)
