"""Assemble several bodies with supports and loads into the system of the free unknowns and its contact problem.

Prescribed displacements are moved to the right-hand side of K u = f and to the gaps. `System.problem` is the place
where K, f and pairings meet; a formulation of contact that changes K or adds unknowns is added there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.elements.loads import Field, Load, field_values, node_numbers, refuse_on_membrane, solid_mass
from contactqp.elements.pairing import Pairing
from contactqp.elements.scalars import keep_own, real_vector
from contactqp.elements.solid import Body, Membrane
from contactqp.elements.surface import Surface
from contactqp.errors import InvalidProblem, counted, shown
from contactqp.model.arguments import checks
from contactqp.model.arrays import EPS, Array, Index, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import ReadOnly, read_coefficient, read_only

Part = Body | Membrane
# Relative difference up to which two supports prescribe the same displacement to a node.
SAME_DISPLACEMENT = 1e-12
EVERYTHING_HELD = "structure: the supports hold every unknown; expected some that are free"
_KINDS = {"xy": "2D", "xyz": "3D", "z": "membrane"}

# The rounding error of a gap, relative to the coordinates of which it is a difference.
GAPS_ROUND = 16 * EPS


@checks
@dataclass(frozen=True)
class Support(ReadOnly):
    """A prescribed displacement of some nodes along one axis.

    Parameters
    ----------
    body : str
    nodes : str, int or sequence of int
        A named set (of nodes, or a side), or node numbers.
    axis : int or str
        0, 1 or 2, or "x", "y" or "z"; 0 or "z" for the one axis of a membrane.
    value : float, or a function of (p, d) points that returns (p,)
        The displacement [length], for a function at the initial positions; 0 fixes the nodes.
    """

    body: str
    nodes: str | int | Sequence[int]
    axis: int | Literal["x", "y", "z"]
    value: Field = 0.0

    def __post_init__(self) -> None:
        keep_own(self, "nodes", "value")


@checks
@dataclass(frozen=True, eq=False)
class Structure(ReadOnly):
    """Several bodies with unknowns in one vector u, body after body, within a body node by node.

    Parameters
    ----------
    bodies : sequence of Body or of Membrane
        The bodies have distinct names and the same number of dimensions.

    Raises
    ------
    InvalidProblem
        No bodies, names that are not distinct, 2D and 3D bodies or membranes together.
    """

    bodies: Sequence[Part]

    def __repr__(self) -> str:
        return f"Structure({', '.join(body.name for body in self.bodies)}; {counted('unknown', self.size)})"

    def __post_init__(self) -> None:
        names = [body.name for body in self.bodies]
        if not names:
            raise InvalidProblem("structure: expected at least one body, got none")
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise InvalidProblem(f"structure: expected bodies with distinct names, got {shown(twice)} more than once")
        kinds = dict.fromkeys(_KINDS[body.axes] for body in self.bodies)
        if len(kinds) > 1:
            raise InvalidProblem(f"structure: expected bodies of one dimension, got {' and '.join(kinds)} ones")
        object.__setattr__(self, "bodies", tuple(self.bodies))

    @property
    def size(self) -> int:
        """Return the number of unknowns of all bodies."""
        return sum(body.size for body in self.bodies)

    def body(self, name: str) -> Part:
        """Return the body of that name."""
        for body in self.bodies:
            if body.name == name:
                return body
        names = ", ".join(repr(body.name) for body in self.bodies)
        raise InvalidProblem(f"structure: there is no body {name!r}; it has {names}")

    def solid(self, name: str) -> Body:
        """Return the elastic body of that name; InvalidProblem for a membrane."""
        body = self.body(name)
        if isinstance(body, Membrane):
            raise InvalidProblem(f"structure: expected an elastic body, got the membrane {name!r}")
        return body

    def first(self, name: str) -> int:
        """Return the index in u of the body's first unknown."""
        names = [body.name for body in self.bodies]
        return sum(body.size for body in self.bodies[: names.index(self.body(name).name)])

    def surface(self, body: str, side: str) -> Surface:
        """Return a side of a body, numbered in the u of the structure."""
        return replace(self.solid(body).surface(side, first=self.first(body)), unknown_count=self.size)

    def mass(self, lumped: bool = False) -> Any:
        """Return M of all unknowns, (n, n) CSR [force time^2 / length], consistent or lumped onto the nodes.

        Raises
        ------
        InvalidProblem
            A material without density, a membrane.
        """
        parts = [solid_mass(self.solid(body.name), lumped) for body in self.bodies]
        return sp.csr_array(sp.block_diag(parts, format="csr"))

    def displacements(self, name: str, displacement: ArrayLike) -> Array:
        """Return the (N, d) displacements of one body's nodes, (N, 1) of a membrane's, out of the u of all unknowns."""
        body, first = self.body(name), self.first(name)
        u = real_vector("displacement", displacement, self.size)
        return u[first : first + body.size].reshape(-1, len(body.axes))

    def unknown_names(self) -> tuple[str, ...]:
        """Return ``"block node 12 x"`` for each unknown."""
        return tuple(
            f"{body.name} node {i} {axis}"
            for body in self.bodies
            for i in range(len(body.mesh.points))
            for axis in body.axes
        )

    def rigid_motions(self) -> Array:
        """Return motions without energy, the k-th of every body combined in column k, (n, q) [length]."""
        of_bodies = [body.rigid_motions() for body in self.bodies]
        motions = np.zeros((self.size, max(part.shape[1] for part in of_bodies)))
        for body, part in zip(self.bodies, of_bodies, strict=True):
            first = self.first(body.name)
            motions[first : first + body.size, : part.shape[1]] = part
        return motions

    @cached_property
    def stiffness(self) -> Any:
        """Return K of all unknowns, free or not: (n, n) CSC [force / length]."""
        return _sorted(sp.block_diag([body.stiffness for body in self.bodies], format="csc"))

    def assemble(self, supports: Sequence[Support] = (), loads: Sequence[Load] = ()) -> System:
        """Return the system of the free unknowns under these supports and loads, which all add up.

        Parameters
        ----------
        supports : sequence of Support
        loads : sequence of Traction, Pressure, PointLoad or Gravity
            Membranes take Pressure and PointLoad. Or of anything with a `body` and `forces(body)`, which are nodal
            forces (N d,) [force].

        Raises
        ------
        InvalidProblem
            An unknown body or set, an axis that the body does not have, contradicting supports, or no free unknown.
        """
        load = np.zeros(self.size)
        for acting in loads:
            first = self.first(acting.body)
            body: Any = self.body(acting.body)
            if isinstance(body, Membrane):
                refuse_on_membrane(acting, body)
            load[first : first + body.size] += acting.forces(body)
        prescribed = self.prescribed(supports)
        if not np.isnan(prescribed).any():
            raise InvalidProblem(EVERYTHING_HELD)
        return System(self, load, prescribed)

    def prescribed(self, supports: Sequence[Support]) -> Vector:
        """Return the prescribed displacements, NaN at free unknowns, (n,) [length].

        Raises
        ------
        InvalidProblem
            An unknown body or set, an axis that the body does not have, or contradicting supports.
        """
        prescribed = np.full(self.size, np.nan)
        for support in supports:
            body = self.body(support.body)
            d = len(body.axes)
            axis = body.axes.find(support.axis) if isinstance(support.axis, str) else int(support.axis)
            if axis not in range(d):
                which = " or ".join(f"{number} ({letter})" for number, letter in enumerate(body.axes))
                raise InvalidProblem(f"support of {body.name!r}: expected the axis {which}, got {shown(support.axis)}")
            nodes = node_numbers(body, support.nodes)
            values = field_values(f"support of {body.name!r}", support.value, body.mesh.points[nodes], ())
            places = self.first(body.name) + d * nodes + axis
            before = prescribed[places]
            size = np.max(abs(values), initial=np.nanmax(abs(before), initial=0.0))  # a sine may give 1e-16
            other = np.flatnonzero(abs(before - values) > SAME_DISPLACEMENT * size)
            if other.size:
                i = other[0]
                node, along = body.mesh.number(nodes[i]), body.axes[axis]
                raise InvalidProblem(
                    f"support of {body.name!r}: node {node} along {along} is to move by {values[i]:.12g} and, by "
                    f"another support, by {before[i]:.12g}"
                )
            prescribed[places] = values
        return prescribed


@checks
@dataclass(frozen=True, eq=False)
class System(ReadOnly):
    """The system K u = f on the free unknowns of a structure, with prescribed displacements on the right-hand side.

    Parameters
    ----------
    structure : Structure
    load : (n,) array
        Nodal forces on all unknowns [force].
    prescribed : (n,) array
        Displacements of the supports [length], NaN at free unknowns.
    """

    structure: Structure
    load: Vector
    prescribed: Vector

    def __post_init__(self) -> None:
        keep_own(self, "load", "prescribed")

    def __repr__(self) -> str:
        bodies = ", ".join(body.name for body in self.structure.bodies)
        return f"System({counted('unknown', len(self.prescribed))}, {len(self.free)} of them free, of {bodies})"

    @cached_property
    def free(self) -> Index:
        """Return the free unknowns: free[j] is the index among all unknowns of unknown j of this system."""
        return read_only(np.flatnonzero(np.isnan(self.prescribed)))

    @cached_property
    def given(self) -> Vector:
        """Return the prescribed displacements, 0 at free unknowns, (n,) [length]."""
        return read_only(np.where(np.isnan(self.prescribed), 0.0, self.prescribed))

    @cached_property
    def K(self) -> Any:
        """Return the stiffness of the free unknowns, CSC [force / length]."""
        return _sorted(self.structure.stiffness[self.free][:, self.free])

    @cached_property
    def f(self) -> Vector:
        """Return the load f (n,) on the free unknowns, less what prescribed displacements exert on them [force]."""
        return read_only(np.asarray((self.load - self.structure.stiffness @ self.given)[self.free]))

    def mass(self, lumped: bool = False) -> Any:
        """Return M of the free unknowns, CSR [force time^2 / length], as `impact` takes it.

        Consistent or lumped onto the nodes, from the densities of the materials; InvalidProblem where one has none.
        """
        return self.structure.mass(lumped)[self.free][:, self.free]

    def expand(self, displacement: ArrayLike) -> Vector:
        """Return all displacements, prescribed ones filled in, from those of the free unknowns (n,) [length]."""
        u = self.given.copy()
        u[self.free] = real_vector("displacement", displacement, len(self.free))
        return u

    def support_forces(self, displacement: ArrayLike, contact_forces: ArrayLike | None = None) -> Vector:
        """Return the support forces on the bodies, K u + E'l - f at supported unknowns and 0 at the others, (n,)
        [force].

        `displacement` is the u of all unknowns, `contact_forces` E_N' l_N (+ E_T' l_T) on all unknowns.
        """
        residual = self.structure.stiffness @ real_vector("displacement", displacement, len(self.load)) - self.load
        if contact_forces is not None:
            residual = residual + real_vector("contact_forces", contact_forces, len(self.load))
        return np.where(np.isnan(self.prescribed), 0.0, residual)

    def free_contacts(self, pairings: Sequence[Pairing]) -> Index:
        """Return the contacts that depend on a free unknown, numbered across all pairings; `problem` keeps these."""
        return kept_contacts(stacked([pairing.normal for pairing in pairings], self.structure.size), self.prescribed)

    def problem(
        self,
        pairings: Sequence[Pairing] | Pairing,
        *,
        friction: ArrayLike | None = None,
        units: Any = None,
        names: Sequence[str] | None = None,
    ) -> ContactProblem:
        """Return the contact problem of the free unknowns: E_N of the free unknowns, gap := gap - E_N u_prescribed.

        Parameters
        ----------
        pairings : sequence of Pairing, or one
            Rows over all unknowns. Contacts between supported nodes, which no free unknown moves, are left out.
        friction : float or array with one coefficient for each row of all pairings, optional
            With it the problem has tangential rows, and slip is counted from the prescribed displacements.
        units : Units or mapping, optional
            The same as in `ContactProblem`.
        names : sequence of str, optional
            Names of the rows of all pairings, by default ``contact j`` with the index j among all rows.

        Raises
        ------
        InvalidProblem
            Rows of another length than u; supported nodes that are pressed into an obstacle.
        """
        pairings = [pairings] if isinstance(pairings, Pairing) else pairings
        contacts = free_contacts(pairings, self.prescribed, friction=friction, names=names)
        unknowns = self.structure.unknown_names()
        problem = ContactProblem(
            stiffness=self.K,
            load=self.f,
            normal=contacts.normal,
            gap=contacts.gap,
            tangent=contacts.tangent,
            friction=contacts.friction,
            slip_origin=contacts.slip_origin,
            dof_names=[unknowns[j] for j in self.free],
            contact_names=contacts.names,
            units=units,
            near_null_space=self.structure.rigid_motions()[self.free],
        )
        problem._computed.assembly = Assembly(self, tuple(pairings))
        if pairings:
            problem._computed.contact_points = np.concatenate([one.points for one in pairings])[contacts.kept]
        return problem


def _sorted(matrix: Any) -> Any:
    """Return a matrix as read-only CSC with sorted indices, so that no solver has to sort them in place."""
    found = sp.csc_array(matrix)
    found.sum_duplicates()
    return read_only(found)


@dataclass(frozen=True, eq=False)
class Assembly:
    """The bodies and pairings of a problem, for pictures of its solution."""

    system: System
    pairings: tuple[Pairing, ...]

    def under(self, load: Vector) -> System:
        """Return the system with another load (f,) on its free unknowns [force].

        If it is a multiple of the system's load, the load on supported unknowns is scaled likewise, else unchanged.
        """
        if np.array_equal(load, self.system.f):
            return self.system
        free, whole = self.system.free, self.system.load.copy()
        own, stated = whole[free], load + (self.system.structure.stiffness @ self.system.given)[free]
        factor = float(stated @ own) / float(own @ own) if own.any() else 1.0
        if abs(stated - factor * own).max(initial=0.0) <= SAME_DISPLACEMENT * abs(stated).max(initial=0.0):
            return replace(self.system, load=factor * whole)
        whole[free] = stated
        return replace(self.system, load=whole)


@dataclass(frozen=True, eq=False)
class FreeContacts:
    """The m contacts that a free unknown moves, over the f free unknowns.

    Attributes
    ----------
    kept : (m,) array of int, their indices among the rows of all pairings
    normal : (m, f) sparse array
    gap : (m,) array, gap - E_N u_prescribed [length]
    names : list of str
    tangent : ((d-1) m, f) sparse array, optional
    friction : (m,) array, optional
    slip_origin : ((d-1) m,) array, optional
        -E_T u_prescribed [length].
    """

    kept: Index
    normal: Any
    gap: Vector
    names: list[str]
    tangent: Any = None
    friction: Vector | None = None
    slip_origin: Vector | None = None


def free_contacts(
    pairings: Sequence[Pairing],
    prescribed: Vector,
    *,
    friction: ArrayLike | None = None,
    names: Sequence[str] | None = None,
) -> FreeContacts:
    """Return the contacts of the free unknowns, without those between supported nodes, which no free unknown moves.

    Raises InvalidProblem: rows of another length than u; supported nodes that are pressed into an obstacle.

    Parameters
    ----------
    pairings : sequence of Pairing, rows over all n unknowns
    prescribed : (n,) array, displacements of the supports [length], NaN at free unknowns
    friction, names
        As `System.problem` takes them.
    """
    free = np.flatnonzero(np.isnan(prescribed))
    given = np.where(np.isnan(prescribed), 0.0, prescribed)
    normal = stacked([pairing.normal for pairing in pairings], len(given))
    gap = np.concatenate([np.zeros(0), *[np.asarray(pairing.gap, dtype=float) for pairing in pairings]])
    gap = gap - normal @ given
    kept = kept_contacts(normal, prescribed)
    held = np.setdiff1d(np.arange(len(gap)), kept)
    called = [f"contact {i}" for i in range(len(gap))] if names is None else names
    if len(called) != len(gap):
        raise InvalidProblem(f"names: expected one for each of {len(gap)} rows, got {len(called)}")
    rounding = GAPS_ROUND * (_distances(pairings) + abs(normal) @ abs(given))
    if held.size and np.min((gap + rounding)[held]) < 0:
        i = held[np.argmin((gap + rounding)[held])]
        raise InvalidProblem(
            f"{called[i]}: its nodes are supported and overlap by {-gap[i]:.6g}; nothing can part them"
        )
    tangential: dict[str, Any] = {}
    if friction is not None:
        tangent = stacked([pairing.tangent for pairing in pairings], len(given))
        per_contact = tangent.shape[0] // max(len(gap), 1)
        rows = (kept[:, None] * per_contact + np.arange(per_contact)).ravel()
        tangential = {
            "tangent": tangent[rows][:, free],
            "friction": read_coefficient(friction, len(gap))[kept],
            "slip_origin": -(tangent @ given)[rows],
        }
    return FreeContacts(kept, sp.csr_array(normal[kept][:, free]), gap[kept], [called[i] for i in kept], **tangential)


def _distances(pairings: Sequence[Pairing]) -> Vector:
    """Return the distance from the origin of the nodes of each contact (p,), for the rounding of gaps [length]."""
    far = [np.full(len(pairing.gap), np.max(abs(pairing.points), initial=0.0)) for pairing in pairings]
    return np.concatenate([np.zeros(0), *far])


def kept_contacts(normal: Any, prescribed: Vector) -> Index:
    """Return the rows of E_N that depend on a free unknown."""
    return np.flatnonzero(abs(sp.csr_array(normal)) @ np.isnan(prescribed).astype(float) > 0)


def stacked(rows: Sequence[Any], n: int) -> Any:
    """Return the rows of all pairings, one under the other.

    Raises InvalidProblem: rows over another number of unknowns than n.
    """
    for i, matrix in enumerate(rows):
        if matrix.shape[1] != n:
            raise InvalidProblem(f"pairing {i}: expected rows over all {n} unknowns, got {matrix.shape[1]}")
    return sp.csr_array(sp.vstack([sp.csr_array((0, n)), *rows], format="csr"))
