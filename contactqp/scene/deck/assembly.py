"""Stiffness, loads, supports and equations of a deck, over the unknowns of all nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg

from contactqp.elements.loads import integrated
from contactqp.elements.members import spring_stiffness, truss_stiffness
from contactqp.elements.reference_elements import REFERENCES, Block, Geometry
from contactqp.elements.solid import Body
from contactqp.errors import InvalidProblem, counted
from contactqp.exchange.deck.model import AtNodes, Equation, Faces
from contactqp.model.arrays import Array, Index, Vector
from contactqp.scene.deck.groups import Group, Topology


@dataclass(frozen=True, eq=False)
class DeckAssembly:
    """The linear system of a deck, without contacts.

    Parameters
    ----------
    topology : Topology
    points : (N, d) array, where the nodes are, as *CONTACT PAIR, ADJUST and *TIE, ADJUST moved them [length]
    """

    topology: Topology
    points: Array

    @cached_property
    def bodies(self) -> Sequence[tuple[Group, Body, Index]]:
        """Return each group, the body of its elements, and the unknowns of that body in u."""
        found = []
        for group in self.topology.groups:
            solid = replace(group, model="plane-strain") if self._thickens(group) else group
            body, used = solid.body(self.points, self.topology.labels)
            found.append((group, body, self.topology.unknowns[used].ravel()))
        return found

    @cached_property
    def stiffness(self) -> Any:
        """Return K of all unknowns, symmetric to the last digit, CSC [force / length]."""
        n = self.topology.size
        total = sp.csc_array((n, n))
        for group, body, unknowns in self.bodies:
            part = sp.coo_array(body.stiffness)
            rows, columns = part.coords
            total = total + sp.csc_array(sp.coo_array((part.data, (unknowns[rows], unknowns[columns])), shape=(n, n)))
            if self._thickens(group):
                total = total + self._of_thickness(group, body)
        return sp.csc_array(total + self._links())

    def _thickens(self, group: Group) -> bool:
        return self.topology.expanded and group.model == "plane-stress"

    def _of_thickness(self, group: Group, body: Body) -> Any:
        """Return the part of K that the unknown changes of thickness contribute, CSC.

        CalculiX models plane stress by solid elements displaced by (u_x, u_y, w z / t). With the strains eps_z = w / t,
        gamma_xz = z / t dw/dx and gamma_yz likewise, their energy is that of plane strain plus

            integral of  lambda div(u) w  +  (lambda + 2 mu) w^2 / (2 t)  +  mu t |grad w|^2 / 24  over the plane.
        """
        block = body.mesh.blocks[0]
        geometry, weights = body.integration(block, body.stiffness_rule(block))
        G, N, t = geometry.gradient, geometry.shape, group.thickness
        lame_lambda, lame_mu = body.material.lame_lambda, body.material.lame_mu
        coupling = lame_lambda / t * np.einsum("eq,eqia,qj->eiaj", weights, G, N)
        square = (lame_lambda + 2 * lame_mu) / t**2 * np.einsum("eq,qi,qj->eij", weights, N, N)
        square += lame_mu / 12 * np.einsum("eq,eqia,eqja->eij", weights, G, G)
        w = self.topology.thicknesses_of(group)
        moved = self.topology.unknowns[group.nodes][..., None]
        entries = [(coupling, moved, w[:, None, None, :]), ((square + np.swapaxes(square, 1, 2)) / 2, *_pairs(w))]
        entries.append((coupling, w[:, None, None, :], moved))
        data, rows, columns = (
            np.concatenate([np.broadcast_arrays(*one)[at].ravel() for one in entries]) for at in range(3)
        )
        return sp.csc_array(sp.coo_array((data, (rows, columns)), shape=(self.topology.size,) * 2))

    def full_radii(self, displacement: Vector) -> Vector:
        """Return u with the radial displacements of an axisymmetric mesh, of which CalculiX prints means.

        It turns these elements into a wedge from -1 to 1 degree, and prints means along x over its layers: of both
        sides, which is cos(1 degree) of the radial displacement, and at a corner of a quadratic element of both sides
        and four times the middle. The difference would be taken for forces of 1e-4 of the elements' stiffness, and for
        supports that moved by 1e-4 of what is prescribed.
        """
        layers, u = np.ones(len(self.topology.active)), displacement.copy()
        side = np.cos(np.radians(1.0))
        for group in self.topology.groups:
            corners = group.kind.corners
            if group.model == "axisymmetric":
                layers[group.nodes] = side
                if group.nodes.shape[1] > corners:
                    layers[group.nodes[:, :corners]] = (2 + side) / 3
        u[self.topology.unknowns[:, 0]] /= layers
        return u

    def with_thicknesses(self, displacement: Vector) -> Vector:
        """Return u of all unknowns from the displacements of all nodes, with the thicknesses in equilibrium."""
        w = self.topology.thicknesses
        u = np.concatenate([displacement, np.zeros(len(w))])
        if len(w):
            u[w] = -scipy.sparse.linalg.spsolve(sp.csc_array(self.stiffness[w][:, w]), (self.stiffness @ u)[w])
        return u

    def _links(self) -> Any:
        n = self.topology.size
        rows, columns, values = [], [], []
        for elements, sizes, materials in self.topology.links:
            each = zip(elements.labels.tolist(), elements.nodes, sizes.tolist(), materials, strict=True)
            for label, nodes, size, material in each:
                start, end = self.points[nodes]
                if not np.linalg.norm(end - start) > 0:
                    raise InvalidProblem(f"{elements.place}: element {label} has no length")
                if material is None:
                    K = spring_stiffness(size, end - start)
                else:
                    K = truss_stiffness(material.modulus, size, start, end)
                unknowns = self.topology.unknowns[nodes].ravel()
                rows.append(np.repeat(unknowns, len(unknowns)))
                columns.append(np.tile(unknowns, len(unknowns)))
                values.append(np.asarray(K, dtype=float).ravel())
        if not rows:
            return sp.csc_array((n, n))
        entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
        return sp.csc_array(sp.coo_array(entries, shape=(n, n)))

    @cached_property
    def load(self) -> Vector:
        """Return the forces on all unknowns [force]."""
        total = np.zeros(self.topology.size)
        for force in self.topology.model.loading.forces:
            np.add.at(total, self._unknowns(force, "*CLOAD"), force.value)
        self._press(total)
        for acting in self.topology.model.loading.accelerations:
            self.topology.check_elements(acting.elements, acting.place)
            for group in self.topology.groups:
                mine = np.isin(group.labels, acting.elements)
                if mine.any():
                    density = self._density(group, acting.place)
                    weight = _Weighing(density * acting.vector[: self.topology.dimension])
                    self._add(total, group, Block(group.kind, self._within(group)[mine]), weight)
            for links, _, _ in self.topology.links:
                if np.isin(links.labels, acting.elements).any():
                    raise InvalidProblem(f"{acting.place}: GRAV on {links.type}; expected solid elements")
        return total

    def _press(self, total: Vector) -> None:
        pressures = self.topology.model.loading.pressures
        if not pressures:
            return
        faces = Faces(
            *(np.concatenate([getattr(one.faces, part) for one in pressures]) for part in ("elements", "face"))
        )
        value = np.concatenate([np.full(len(one.faces.face), one.value) for one in pressures])
        try:
            found = self.topology.facets(faces, "")
        except InvalidProblem:
            for one in pressures:  # one call per line, so that messages can name it
                self.topology.facets(one.faces, one.place)
            raise
        for group, local, elements, entries in found:
            kind = REFERENCES[group.kind.facet]
            facets = Block(kind, self._within(group)[elements][:, list(group.kind.facets[local])])
            self._add(total, group, facets, _Pressing(value[entries]))

    def _within(self, group: Group) -> Index:
        """Return the nodes of a group's elements in the numbering of its body."""
        _, inverse = np.unique(group.nodes, return_inverse=True)
        return np.asarray(inverse.reshape(group.nodes.shape), dtype=np.int64)

    def _add(self, total: Vector, group: Group, block: Block, density: Any) -> None:
        body, unknowns = next((body, unknowns) for one, body, unknowns in self.bodies if one is group)
        total[unknowns] += integrated(body, (block,), density)

    def _density(self, group: Group, place: str) -> float:
        if not group.material.density > 0:
            raise InvalidProblem(f"{place}: GRAV: material {group.material.name} has no *DENSITY")
        return group.material.density

    def _unknowns(self, at: AtNodes, keyword: str) -> Index:
        """Return the unknowns of some nodes along one axis; nodes without elements have none."""
        if at.axis >= self.topology.dimension:
            if at.value:
                raise InvalidProblem(f"{at.place}: {keyword}: direction {at.axis + 1} in a plane deck")
            self._note(f"{at.place}: {keyword}: direction {at.axis + 1}, which plane elements have not")
            return np.zeros(0, dtype=np.int64)
        nodes, without = self.topology.places(at.nodes, f"{at.place}: {keyword}")
        if len(without) and keyword == "*CLOAD" and at.value:
            raise InvalidProblem(f"{at.place}: {keyword}: node {without[0]} is in no element and no equation")
        if len(without):
            self._note(f"{at.place}: {keyword}: {counted('node', len(without))} in no element, such as {without[0]}")
        return np.asarray(self.topology.unknowns[nodes, at.axis])

    def _note(self, line: str) -> None:
        ignored = self.topology.model.ledger.ignored
        if line not in ignored:
            ignored.append(line)

    @cached_property
    def prescribed(self) -> Vector:
        """Return the prescribed displacements, NaN at free unknowns [length]; the last of several for one unknown
        holds.
        """
        values = np.full(self.topology.size, np.nan)
        ledger = self.topology.model.ledger
        for support in self.topology.model.loading.supports:
            unknowns = self._unknowns(support, "*BOUNDARY")
            before = values[unknowns]
            if np.any(before[~np.isnan(before)] != support.value):
                node = self.topology.name(int(unknowns[~np.isnan(before) & (before != support.value)][0]))
                ledger.assumed.append(f"{support.place}: *BOUNDARY: {node} has two displacements; the last one counts")
            values[unknowns] = support.value
        return values

    @cached_property
    def equations(self) -> Any:
        """Return the rows of *EQUATION over all unknowns, (k, n) CSR, whose products with u must vanish."""
        found = [self._row(equation) for equation in self.topology.model.equations]
        return sp.csr_array(sp.vstack([sp.csr_array((0, self.topology.size)), *found], format="csr"))

    def _row(self, equation: Equation) -> Any:
        flat = equation.axes >= self.topology.dimension
        if flat.any():
            raise InvalidProblem(f"{equation.place}: *EQUATION: direction 3 in a plane deck")
        nodes, _ = self.topology.places(equation.nodes, equation.place)
        columns = self.topology.unknowns[nodes, equation.axes]
        entries = equation.coefficients, (np.zeros(len(columns), dtype=np.int64), columns)
        return sp.csr_array(sp.coo_array(entries, shape=(1, self.topology.size)))

    def rigid_motions(self) -> Array:
        """Return the translations and rotations of all nodes together, for multigrid: (n, q)."""
        d = self.topology.dimension
        x = self.points - self.points.mean(axis=0)
        motions = [np.tile(np.eye(d)[axis], len(x)) for axis in range(d)]
        for a, b in ((0, 1), (1, 2), (0, 2))[: 1 if d == 2 else 3]:
            turn = np.zeros_like(x)
            turn[:, a], turn[:, b] = -x[:, b], x[:, a]
            motions.append(turn.ravel())
        return np.pad(np.stack(motions, axis=1), ((0, len(self.topology.thicknesses)), (0, 0)))


def _pairs(nodes: Index) -> tuple[Index, Index]:
    """Return rows and columns (E, n, n) of element matrices."""
    return nodes[:, :, None], nodes[:, None, :]


@dataclass(frozen=True, eq=False)
class _Pressing:
    """The integrand of pressures on facets (p,), per area of the reference facet."""

    value: Vector

    def __call__(self, facets: Geometry) -> Vector:
        return np.asarray(-self.value[:, None, None] * facets.normal)


@dataclass(frozen=True, eq=False)
class _Weighing:
    """The integrand of a body force, per volume of the reference element."""

    force: Array

    def __call__(self, elements: Geometry) -> Vector:
        return np.asarray(self.force * elements.determinant[..., None])
