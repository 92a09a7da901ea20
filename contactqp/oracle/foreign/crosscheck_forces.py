"""Compute forces of another code and of the exact answer at the slave nodes of a deck's contact pairs.

The forces of the other code follow from its displacements u by the deck's stiffness: K u - f are the nodal forces of
contacts, ties and supports. At a slave node this is the contact force, along the normal of the master.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.elements.nodal_pressure import nodal_pressure, node_normals, tributary_areas
from contactqp.elements.surface import kind_of
from contactqp.linalg.dense import unknown_scale
from contactqp.model.arrays import Array, Index, Mask, Vector
from contactqp.oracle.foreign.recovery import balancing_forces
from contactqp.scene.deck.contacts import DeckContact, Discretisation
from contactqp.scene.deck.deck import Deck, Enforcement
from contactqp.solving.solve import solve

# Rounding of printed digits is uniform within half a unit of the last one; this many standard deviations bound it.
SURE = 6.0
# The largest component of a normal along a held direction with which the force is computed from the other components.
LEANING = 0.1


@dataclass(frozen=True, eq=False)
class ForeignAnswer:
    """The displacements of another code for all unknowns of a deck, including constrained ones.

    Attributes
    ----------
    deck : Deck
    u : (n,) array [length]
    unit : (n,) array, the unit of the last printed digit of each [length]
    """

    deck: Deck
    u: Vector
    unit: Vector

    @cached_property
    def forces(self) -> Vector:
        """Return K u - f (n,), the nodal forces of contacts, ties and supports [force]."""
        return np.asarray(self.deck.assembly.stiffness @ self.u - self.deck.assembly.load)

    @cached_property
    def variance(self) -> Vector:
        """Return the variance of the rounding of each u, uniform over one unit of the last digit [length^2]."""
        return np.asarray(self.unit**2 / 12)

    @cached_property
    def noise(self) -> Vector:
        """Return the error of `forces` due to printed digits (n,) [force]."""
        squares = self.deck.assembly.stiffness.copy()
        squares.data = squares.data**2
        return np.asarray(SURE * np.sqrt(squares @ self.variance))

    def noise_along(self, direction: Vector) -> float:
        """Return the error, due to printed digits, of the sum of the forces times a direction (n,) [force]."""
        along = self.deck.assembly.stiffness @ direction
        return float(SURE * np.sqrt((along**2) @ self.variance))

    @cached_property
    def recovered(self) -> Vector:
        """Return the forces of all contacts, node to segment, that together balance the free unknowns."""
        problem = self.deck.problem()
        rows = sp.csr_array(sp.vstack([problem.normal, problem.tie], format="csr"))
        pushing = np.zeros(rows.shape[0], dtype=bool)
        found, _ = balancing_forces(rows, -self.forces[self.deck.free], pushing, unknown_scale(problem))
        return found[: problem.contacts]


@dataclass(frozen=True, eq=False)
class PairNodes:
    """The slave nodes at which a pair is judged.

    Attributes
    ----------
    contact : node to segment
    nodes : (q,) array of int
    direction : (q, d) array
        The normal of the master at each, or minus the slave's normal without partner; without components along which
        supports, ties or other pairs act, and scaled so that its product with the force is the normal force.
    measured : (q, d) array of bool
        Whether the force on a node along an axis is known, as nothing else acts there.
    row : (q,) array of int, the contact of each among those of the pair, -1 if it has none
    contacts : (q,) array of int
        The contact of each among those of the problem, -1 if it has none or cannot move.
    alone : whether only the pair acts on these nodes along their normals, so that single forces are known
    """

    contact: DeckContact
    nodes: Index
    direction: Array
    measured: Mask
    row: Index
    contacts: Index
    alone: bool

    @property
    def unknowns(self) -> Index:
        """Return the indices of the nodes' displacements in u, (q, d)."""
        return np.asarray(self.contact.slave.unknowns[self.nodes])

    @property
    def of_quadratic_faces(self) -> bool:
        """Return whether the deck has contact of faces with a quadratic slave."""
        return self.contact.pair.type != "NODE TO SURFACE" and kind_of(self.contact.slave).quadratic

    @cached_property
    def area(self) -> Vector:
        """Return the area of the slave surface that belongs to each node, (q,) [area]."""
        slave = self.contact.slave
        return np.asarray(tributary_areas(slave)[np.searchsorted(slave.nodes, self.nodes)])

    def pressure(self, force: Vector) -> Vector:
        """Return the pressures (q,) from nodal forces (q,) [force] by projection [force / length^2]."""
        order = np.argsort(self.nodes)
        found = np.empty(len(force))
        found[order] = nodal_pressure(self.contact.slave, self.nodes[order]).of(force[order])
        return found

    def gap(self, u: Vector) -> Vector:
        """Return the gaps (q,) at a displacement of all unknowns, NaN for nodes without partner [length]."""
        pairing, paired = self.contact.pairing, self.row >= 0
        found = np.full(len(self.row), np.nan)
        found[paired] = (pairing.gap - pairing.normal @ u)[self.row[paired]]
        return found

    def forces(self, answer: ForeignAnswer) -> tuple[Vector, Array]:
        """Return the normal forces (q,) of another code, and its nodal force vectors (q, d) [force]."""
        if self.alone:
            vectors = np.where(self.measured, answer.forces[self.unknowns], 0.0)
            return self.along(vectors), vectors
        force = np.where(self.contacts < 0, 0.0, answer.recovered[self.contacts])
        return force, force[:, None] * self.direction

    def along(self, vectors: Array) -> Vector:
        """Return the components of vectors (q, d) along the normals, (q,)."""
        return np.asarray(np.einsum("qd,qd->q", vectors, self.direction))

    @property
    def has_friction(self) -> bool:
        """Return whether there is friction and the tangential forces are known."""
        return self.alone and self.contact.interaction.friction > 0

    def friction(self, vectors: Array) -> float:
        """Return the sum of the sizes of the tangential components of vectors (q, d), 0 without friction [force]."""
        if not self.has_friction:
            return 0.0
        size = (self.direction**2).sum(axis=1, keepdims=True)
        along = vectors - self.along(vectors)[:, None] * self.direction / size
        return float(np.linalg.norm(self.shares @ along, axis=1).sum())

    @cached_property
    def shares(self) -> Any:
        """Return the CSR matrix (q, q) applied to nodal forces before comparison, usually the identity.

        On quadratic faces single nodal forces mean little: under constant pressure the corner forces of a serendipity
        face are tensile. Half of the force at the middle of an edge is added to each of its ends, which gives the
        integrals of the pressure with linear shape functions, in which tension is real.
        """
        count, slave = len(self.nodes), self.contact.slave
        kind = kind_of(slave)
        if not self.of_quadratic_faces:
            return sp.eye_array(count, format="csr")
        place = np.full(len(slave.points), -1)
        place[self.nodes] = np.arange(count)
        edges = kind.edges if kind.nodes.shape[1] == 2 else np.array([[0, 1]])
        ends: dict[int, set[int]] = {}
        for facet in slave.facets.tolist():
            for at, edge in enumerate(edges.tolist()):
                ends.setdefault(facet[kind.corners + at], set()).update(facet[end] for end in edge)
        share = sp.lil_array((count, count))
        for at, node in enumerate(self.nodes.tolist()):
            corners = [place[end] for end in ends.get(node, ()) if place[end] >= 0] or [at]
            for corner in corners:
                share[corner, at] += 1.0 / len(corners)
        return sp.csr_array(share)


def pair_nodes(deck: Deck, number: int) -> PairNodes:
    """Return the nodes at which a contact pair is judged, if possible all slave nodes on which only the pair acts."""
    contacts = deck.contacts("node-to-segment")
    contact = contacts.pairs[number]
    slave, pairing = contact.slave, contact.pairing
    nodes = slave.nodes
    row = np.full(len(nodes), -1)
    row[np.searchsorted(nodes, pairing.nodes)] = np.arange(len(pairing.nodes))
    direction = -node_normals(slave)
    direction[row >= 0] = pairing.direction[row[row >= 0]]
    of_problem, of_pair = contacts.of_pair(number)
    place = np.full(len(pairing.nodes) + 1, -1)
    place[of_pair] = of_problem
    parts = [np.flatnonzero(~np.isnan(deck.assembly.prescribed)), deck.ties.indices]
    parts += [one.pairing.normal.indices for other, one in enumerate(contacts.pairs) if other != number]
    acted = np.isin(slave.unknowns[nodes], np.concatenate(parts))
    lone = np.asarray(np.linalg.norm(np.where(acted, direction, 0.0), axis=1) <= LEANING)
    alone = bool(lone[place[row] >= 0].all())
    kept = lone if alone else place[row] >= 0
    if alone:
        direction = np.where(acted, 0.0, direction)
        direction[kept] /= (direction[kept] ** 2).sum(axis=1, keepdims=True)
    known = np.asarray(~acted[kept]) if alone else np.ones((int(kept.sum()), slave.dimension), dtype=bool)
    return PairNodes(contact, nodes[kept], direction[kept], known, row[kept], place[row[kept]], alone)


def reference_forces(
    deck: Deck, pairs: list[PairNodes], enforcement: Enforcement, discretisation: Discretisation
) -> list[Array]:
    """Return the forces (q, d) of the exact answer on the slave nodes of each pair, friction included [force].

    If single nodal forces are unknown, they are those of the contacts along their normals.

    Parameters
    ----------
    deck : Deck
    pairs : list of PairNodes, the slave nodes of each contact pair
    enforcement : str, how the problem states the contact conditions, as `Deck.problem` takes it
    discretisation : str, which contacts there are, as `Deck.problem` takes it
    """
    contacts = deck.contacts(discretisation)
    solution = solve(deck.problem(enforcement, discretisation))
    found = []
    for number, judged in enumerate(pairs):
        contact = contacts.pairs[number]
        of_problem, of_pair = contacts.of_pair(number)
        force = np.zeros(len(contact.labels))
        force[of_pair] = solution.normal_force[of_problem]
        on_bodies = -(contact.pairing.normal.T @ force)
        if solution.friction_force is not None and judged.alone:
            d = contact.pairing.direction.shape[1]
            along = np.zeros((len(force), d - 1))
            along[of_pair] = np.asarray(solution.friction_force)[of_problem].reshape(-1, d - 1)
            on_bodies -= contact.pairing.tangent.T @ along.ravel()
        if not judged.alone and discretisation == "node-to-segment":
            found.append(np.where(judged.row < 0, 0.0, force[judged.row])[:, None] * judged.direction)
        else:
            found.append(np.where(judged.measured, on_bodies[judged.unknowns], 0.0))
    return found
