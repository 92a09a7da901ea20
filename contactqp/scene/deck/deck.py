"""A deck as a contact problem: the exact one, or the penalty problem that the deck states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.elements.scalars import real_vector
from contactqp.elements.structure import FreeContacts, free_contacts, stacked
from contactqp.errors import ContactQPError, InvalidProblem, Unsupported, counted
from contactqp.exchange.deck.model import DeckModel
from contactqp.exchange.deck.reading import read_deck_model
from contactqp.exchange.files import Ledger, Path, naming
from contactqp.model.arguments import checked, checks
from contactqp.model.arrays import Array, Index, Vector, own_floating_point
from contactqp.model.problem import ContactProblem
from contactqp.scene.deck.assembly import DeckAssembly
from contactqp.scene.deck.contacts import (
    DeckContact,
    Discretisation,
    Surfaces,
    adjusted_points,
    contact_names,
    contacts_of,
    note,
    tie_rows,
)
from contactqp.scene.deck.groups import topology_of
from contactqp.solving.solve import solve

Enforcement = Literal["exact", "penalty"]
# CalculiX replaces HARD by springs of this many times Young's modulus, per unit of length of the deck.
HARD_IS = 50.0


@checks
@dataclass(frozen=True, eq=False)
class Deck:
    """What `read_deck` returns: the model of an input deck of Abaqus or CalculiX.

    Parameters
    ----------
    model : DeckModel
        The cards as they were read, with the ledger.
    expanded : bool
        Take elements of plane stress as CalculiX does, which makes solids of them: the change of thickness at each node
        is an unknown ``"thickness of node 17"`` behind the displacements, linear across the plane. By default no point
        has a stress across the plane, as in Abaqus.
    """

    model: DeckModel
    expanded: bool = False

    def __repr__(self) -> str:
        return f"Deck({self.model.file}: {self.ledger.read[0]}, {counted('contact pair', len(self.model.pairs))})"

    @property
    def ledger(self) -> Ledger:
        """Return what was read, converted, assumed and without effect, line by line of the deck."""
        return self.model.ledger

    @cached_property
    def assembly(self) -> DeckAssembly:
        """Return the linear system over the unknowns of all nodes, held ones included."""
        return DeckAssembly(self._surfaces.topology, adjusted_points(self._surfaces))

    @cached_property
    def _surfaces(self) -> Surfaces:
        return Surfaces(topology_of(self.model, expanded=self.expanded))

    @cached_property
    def _contacts(self) -> dict[Discretisation, DeckContacts]:
        return {}

    def contacts(self, discretisation: Discretisation) -> DeckContacts:
        """Return the contact pairs in one discretisation, found once.

        "node-to-segment" forbids overlap at slave nodes, "mortar" on average where faces are linear, "points" at the
        Gauss points of the slaves' faces.
        """
        if discretisation not in self._contacts:
            with naming(self.model.file):
                pairs = contacts_of(self._surfaces, self.assembly.points, discretisation)
                self._contacts[discretisation] = DeckContacts(pairs, self.assembly.prescribed)
        return self._contacts[discretisation]

    @cached_property
    def free(self) -> Index:
        """Return the free unknowns, as places among the unknowns of all nodes."""
        return np.flatnonzero(np.isnan(self.assembly.prescribed))

    @property
    def dof_names(self) -> tuple[str, ...]:
        """Return the names of the problem's unknowns, ``"17.y"`` for node 17 along y."""
        return tuple(self.assembly.topology.name(unknown) for unknown in self.free.tolist())

    @cached_property
    def _given(self) -> Vector:
        return np.where(np.isnan(self.assembly.prescribed), 0.0, self.assembly.prescribed)

    def expand(self, displacement: ArrayLike) -> Vector:
        """Return the displacements of all unknowns from those of the problem's, prescribed ones filled in."""
        u = self._given.copy()
        u[self.free] = real_vector("displacement", displacement, len(self.free))
        return u

    def displacements(self, displacement: ArrayLike) -> tuple[Index, Array]:
        """Return the labels (N,) of the nodes and their displacements (N, d) from those of the problem's unknowns."""
        u = self.expand(displacement)
        return self.assembly.topology.labels, u[self.assembly.topology.unknowns]

    def problem(
        self, enforcement: Enforcement = "exact", discretisation: Discretisation = "node-to-segment"
    ) -> ContactProblem:
        """Return the contact problem of the deck.

        Parameters
        ----------
        enforcement : str
            ``"exact"`` admits no overlap, as HARD says, whatever stiffness the deck states. ``"penalty"``: the problem
            that a deck with PRESSURE-OVERCLOSURE=LINEAR states: each contact rests on a spring of that stiffness times
            its area, an unknown ``"spring of node 17"`` that is behind all others in u; HARD is taken as CalculiX takes
            it, as LINEAR with 50 times the largest Young's modulus. A stick slope makes springs along the surface
            likewise.
        discretisation : str
            ``"node-to-segment"``: no slave node overlaps. ``"mortar"``: no overlap on the average over each slave
            node's share of the surface, for pairs of linear faces that are not axisymmetric; others stay as they are.
            ``"points"``: no Gauss point of a slave's face overlaps, which springs at integration points tend to. How
            far they are apart is what the mesh leaves open.

        Returns
        -------
        ContactProblem
            Unknowns ``"17.y"``, contacts ``"node 17"``; in the units of the deck.

        Raises
        ------
        InvalidProblem
            All nodes of the deck are held, or elements, surfaces or pairs are invalid; the message has the line.
        """
        return self._problem(enforcement, discretisation, self._slipped(enforcement, discretisation))

    def _problem(
        self, enforcement: Enforcement, discretisation: Discretisation, slipped: Vector | None
    ) -> ContactProblem:
        """Return the problem of the last step, slip of all pairs starting from E_T u = `slipped` [length]."""
        contacts = self.contacts(discretisation)
        with naming(self.model.file):
            exact = self._exact(contacts.free, None if slipped is None else slipped[contacts.tangent_rows])
            problem = exact if enforcement == "exact" else self._on_springs(exact, contacts)
            return problem._with_load_sum(
                problem.load, np.pad(self._load_size, (0, problem.dimension - len(self.free)))
            )

    def _slipped(self, enforcement: Enforcement, discretisation: Discretisation) -> Vector | None:
        """Return E_T u of all pairs at the start of the last step, less the elongation of tangential springs [length].

        The earlier steps are solved one after another. None with a single step or without friction.
        """
        if self.contacts(discretisation).free.tangent is None:
            return None
        slipped = None
        for count in range(1, len(self.model.steps)):
            own = Ledger(self.model.file, read=self.ledger.read[:1])
            deck = replace(self, model=replace(self.model, steps=self.model.steps[:count], ledger=own))
            problem, contacts = deck._problem(enforcement, discretisation, slipped), deck.contacts(discretisation)
            try:
                u = solve(problem).displacement
            except ContactQPError as error:
                error.args = (f"step {count}: {error}", *error.args[1:])
                raise
            for kind, line in own:
                note(getattr(self.ledger, kind), line)
            slipped = np.asarray(contacts.tangent @ deck.expand(u[: len(deck.free)]))
            if problem.tangent is not None and contacts.free.slip_origin is not None:
                slipped[contacts.tangent_rows] = problem.tangent @ u - contacts.free.slip_origin
        return slipped

    def _exact(self, contacts: FreeContacts, slipped: Vector | None) -> ContactProblem:
        assembly, free = self.assembly, self.free
        if not len(free):
            raise InvalidProblem("every node is held; expected some that are free")
        given, tie, slip_origin = self._given, self.ties, contacts.slip_origin
        if slipped is not None and slip_origin is not None:
            slip_origin = slip_origin + slipped
        return ContactProblem(
            stiffness=self._stiffness,
            load=(assembly.load - assembly.stiffness @ given)[free],
            normal=contacts.normal,
            gap=contacts.gap,
            tangent=contacts.tangent,
            friction=contacts.friction,
            slip_origin=slip_origin,
            tie=tie[:, free] if tie.shape[0] else None,
            tie_value=-(tie @ given) if tie.shape[0] else None,
            dof_names=self.dof_names,
            contact_names=contacts.names,
            near_null_space=assembly.rigid_motions()[free],
        )

    @cached_property
    def _load_size(self) -> Vector:
        """Return the sum of absolute values of the terms of the load, for estimates of its rounding [force]."""
        assembly = self.assembly
        return np.asarray((abs(assembly.load) + abs(assembly.stiffness) @ abs(self._given))[self.free])

    @cached_property
    def _stiffness(self) -> Any:
        return sp.csc_array(self.assembly.stiffness[self.free][:, self.free])

    @cached_property
    def ties(self) -> Any:
        """Return the rows of ties and equations over the unknowns of all nodes, (k, n) CSR."""
        rows, _ = tie_rows(self._surfaces, self.assembly.points)
        return sp.csr_array(sp.vstack([self.assembly.equations, rows], format="csr"))

    def _on_springs(self, exact: ContactProblem, contacts: DeckContacts) -> ContactProblem:
        """Return the penalty problem, with a normal spring at each contact and tangential ones where the deck has a
        stick slope.
        """
        if not exact.contacts:
            return exact
        m, names = exact.contacts, exact.contact_names or ()
        along = 0 if exact.tangent is None else exact.tangent.shape[0]
        normal, sticks = self._springs(contacts, along // m)
        sliding = np.flatnonzero(np.isfinite(sticks))
        added = [f"spring of {name}" for name in names]
        added += [f"spring along {names[j // (along // m)]}, direction {j % (along // m) + 1}" for j in sliding]
        width = m + len(sliding)
        tangent = None
        if along:
            entries = np.ones(len(sliding)), (sliding, m + np.arange(len(sliding)))
            tangent = _side_by_side(exact.tangent, -sp.coo_array(entries, shape=(along, width)))
        behind = sp.coo_array((np.ones(m), (np.arange(m), np.arange(m))), shape=(m, width))
        springs = sp.diags_array(np.concatenate([normal, sticks[sliding]]))
        return ContactProblem(
            stiffness=sp.csc_array(sp.block_diag([exact.stiffness, springs], format="csc")),
            load=np.concatenate([exact.load, np.zeros(width)]),
            normal=_side_by_side(exact.normal, -behind),
            gap=exact.gap,
            tangent=tangent,
            friction=exact.friction,
            slip_origin=exact.slip_origin,
            tie=_side_by_side(exact.tie, sp.coo_array((exact.ties, width))) if exact.ties else None,
            tie_value=exact.tie_value if exact.ties else None,
            dof_names=[*self.dof_names, *added],
            contact_names=names,
        )

    def _springs(self, contacts: DeckContacts, repeat: int) -> tuple[Vector, Vector]:
        """Return the stiffness of the normal and the tangential springs [force / length], NaN for none."""
        behind, along = [], []
        for contact in contacts.pairs:
            area = contact.pairing.area
            if area is None:
                raise Unsupported(f"{contact.pair.place}: a penalty needs areas of the slave nodes")
            stiffness = contact.interaction.stiffness
            if stiffness is None:
                stiffness = HARD_IS * max(material.modulus for material in self.model.materials.values())
                told = f"HARD as LINEAR with {stiffness:.6g}, {HARD_IS:g} times Young's modulus"
                note(self.ledger.assumed, f"{contact.pair.place}: {told}")
            behind.append(stiffness * area)
            along.append((np.nan if contact.interaction.stick is None else contact.interaction.stick) * area)
        kept = contacts.free.kept
        return np.concatenate(behind)[kept], np.repeat(np.concatenate(along)[kept], repeat)


def _side_by_side(left: Any, right: Any) -> Any:
    return sp.csr_array(sp.hstack([sp.csr_array(left), sp.csr_array(right)], format="csr"))


@dataclass(frozen=True, eq=False)
class DeckContacts:
    """The contact pairs of a deck in one discretisation.

    Attributes
    ----------
    pairs : sequence of DeckContact, their rows are over the unknowns of all nodes
    prescribed : (n,) array, prescribed displacements, NaN at free unknowns
    """

    pairs: Sequence[DeckContact]
    prescribed: Vector

    @cached_property
    def free(self) -> FreeContacts:
        """Return the contacts over the free unknowns, without those that no free unknown moves."""
        has_friction = any(one.interaction.friction > 0 for one in self.pairs)
        friction = [np.full(len(one.labels), one.interaction.friction) for one in self.pairs]
        return free_contacts(
            [one.pairing for one in self.pairs],
            self.prescribed,
            friction=np.concatenate(friction) if has_friction else None,
            names=contact_names(self.pairs),
        )

    @property
    def tangent(self) -> Any:
        """Return the tangential rows of all pairs over the unknowns of all nodes."""
        return stacked([one.pairing.tangent for one in self.pairs], len(self.prescribed))

    @property
    def tangent_rows(self) -> Index:
        """Return the indices of the problem's tangential rows among those of all pairs."""
        along = self.tangent.shape[0] // max(sum(len(one.labels) for one in self.pairs), 1)
        return np.asarray((self.free.kept[:, None] * along + np.arange(along)).ravel())

    def of_pair(self, number: int) -> tuple[Index, Index]:
        """Return the indices of a pair's contacts in the problem, and their indices within the pair."""
        ends = np.cumsum([0, *(len(one.labels) for one in self.pairs)])
        kept = self.free.kept
        mine = np.flatnonzero((kept >= ends[number]) & (kept < ends[number + 1]))
        return mine, kept[mine] - ends[number]


@checked
@own_floating_point
def read_deck(path: Path) -> Deck:
    """Read an input deck of Abaqus or CalculiX: linear elastic static steps, with their contact pairs.

    The problem is that at the end of the last step. Where there is friction, each step before is solved as one
    increment, and slip starts from where it ends.

    Every keyword and parameter is applied, refused with its line, or listed in `deck.ledger` as without effect. Lengths
    and forces stay in the units of the deck. Elements: C3D4, C3D8, C3D10, C3D20, C3D20R, CPE, CPS and CAX with 3, 4, 6
    and 8 nodes and 8R, T3D2, T2D2, SPRINGA.

    Parameters
    ----------
    path : path
        The deck; the files that it includes are looked for beside it.

    Returns
    -------
    Deck
        ``deck.problem()`` is the ContactProblem, ``deck.problem("penalty")`` the one on springs that it states.

    Raises
    ------
    InvalidProblem
        The file is not a deck, a keyword or parameter is unknown or not offered, or numbers do not fit; the message
        names file, line and keyword.
    """
    return Deck(read_deck_model(path))


def read_deck_problem(path: Path) -> tuple[ContactProblem, Ledger]:
    """Return the exact problem of a deck, and the ledger of what was read, assumed and without effect."""
    deck = read_deck(path)
    return deck.problem(), deck.ledger
