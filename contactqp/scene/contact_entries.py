"""The contacts of a scene of bodies, entry by entry: what the forces and gaps of its problem are at their nodes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.obstacle import tangent_frames
from contactqp.elements.pairing import Pairing
from contactqp.model.arrays import Vector


class ContactAnswer(Protocol):
    """What is asked of a solution: contact by contact of the problem, all of them."""

    @property
    def normal_force(self) -> Vector: ...

    @property
    def friction_force(self) -> NDArray[np.float64] | None: ...

    @property
    def gap(self) -> Vector: ...

    @property
    def contact_status(self) -> Any: ...


@dataclass(frozen=True, eq=False)
class PairedContact:
    """One entry of the scene's contacts: many contacts in the problem, one for each paired node.

    Attributes
    ----------
    name : str
    body : str
        The body or membrane that touches; of two bodies the slave.
    pairing : Pairing
    friction : Fraction
    """

    name: str
    body: str
    pairing: Pairing
    friction: Fraction


@dataclass(frozen=True, eq=False)
class ContactEntries(ABC):
    """The entries of the scene's contacts, in their order."""

    contacts: tuple[PairedContact, ...]

    @property
    @abstractmethod
    def kept(self) -> NDArray[np.int64]:
        """Which rows of all pairings are contacts of the problem: those that a free unknown moves."""

    @property
    def row_names(self) -> list[str]:
        """``floor 12`` for each row of all pairings: its entry in the scene and its node."""
        return [f"{contact.name} {node}" for contact in self.contacts for node in contact.pairing.nodes]

    @property
    def row_friction(self) -> Vector | None:
        """The coefficient of each row of all pairings; None where nothing rubs."""
        each = [np.full(len(contact.pairing.gap), float(contact.friction)) for contact in self.contacts]
        friction = np.concatenate([np.zeros(0), *each])
        return friction if friction.any() else None

    @property
    def notes(self) -> list[str]:
        """What the pairings say of themselves, entry by entry."""
        return [f"{contact.name}: {note}" for contact in self.contacts for note in contact.pairing.notes]

    def place(self, name: str) -> int:
        """The place of an entry of the scene's contacts among them."""
        return [contact.name for contact in self.contacts].index(name)

    def normal_forces(self, name: str, solution: ContactAnswer) -> Vector:
        """lambda of each paired node of one entry, (p,) [force]; 0 where only supported nodes meet."""
        return self.of_entry(name, solution.normal_force, 0.0)

    def pressures(self, name: str, solution: ContactAnswer) -> Vector:
        """At each paired node of one entry, (p,) [force / length^2], positive in compression; `Pairing.pressure`.

        NaN where only supported nodes meet, whose forces nobody knows.
        """
        known = self.of_entry(name, solution.normal_force, np.nan)
        return self.contacts[self.place(name)].pairing.pressure(known)

    def friction_tractions(self, name: str, solution: ContactAnswer) -> Vector:
        """lambda_T per area of each paired node along the axes, (p, d) [force / length^2]; NaN where unknown."""
        unknown = np.isnan(self.of_entry(name, solution.normal_force, np.nan))
        vectors = np.where(unknown[:, np.newaxis], np.nan, self.friction_vectors(name, solution))
        pairing = self.contacts[self.place(name)].pairing
        return np.column_stack([pairing.per_area(component) for component in vectors.T])

    def friction_vectors(self, name: str, solution: ContactAnswer) -> Vector:
        """lambda_T of each paired node of one entry along the axes, (p, d) [force]: what it does to what it touches."""
        pairing = self.contacts[self.place(name)].pairing
        frames, along = tangent_frames(pairing.direction), self.tangential(name, solution.friction_force)
        return np.asarray(np.einsum("pk,pkd->pd", along, frames))

    def closed(self, name: str, solution: ContactAnswer) -> NDArray[np.bool_]:
        """Which paired nodes of one entry press, (p,)."""
        return self._has_status(name, solution, "closed", "stick", "slip")

    def stuck(self, name: str, solution: ContactAnswer) -> NDArray[np.bool_]:
        """Which paired nodes of one entry press and stick, (p,)."""
        return self._has_status(name, solution, "stick")

    def _has_status(self, name: str, solution: ContactAnswer, *statuses: str) -> NDArray[np.bool_]:
        return self.of_entry(name, np.isin(solution.contact_status, statuses).astype(float), 0.0) > 0

    def gaps(self, name: str, solution: ContactAnswer) -> Vector:
        """The gap of each paired node of one entry, (p,), positive when open; NaN where only supported nodes meet."""
        return self.of_entry(name, solution.gap, np.nan)

    def tangential(self, name: str, values: Any) -> Vector:
        """Of each paired node of one entry, (p, d-1); 0 where only supported nodes meet, and without friction."""
        width = self.contacts[self.place(name)].pairing.points.shape[1] - 1
        if values is None:
            return np.zeros((len(self.contacts[self.place(name)].pairing.gap), width))
        return np.column_stack([self.of_entry(name, values[:, k], 0.0) for k in range(width)])

    def of_entry(self, name: str, values: Any, otherwise: float) -> Vector:
        """The values (m,) of the problem's contacts that belong to one entry, (p,)."""
        sizes = [len(contact.pairing.gap) for contact in self.contacts]
        every = np.full(sum(sizes), otherwise)
        every[self.kept] = values
        start = sum(sizes[: self.place(name)])
        return every[start : start + sizes[self.place(name)]]
