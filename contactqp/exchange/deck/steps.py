"""What acts at the end of each step of a deck: the loads of the step before, those that it states in their places.

As in CalculiX and Abaqus, a displacement, a force or a pressure stays from step to step until a later step states
another one at the same node and direction, or face (OP=MOD); within one step forces and pressures add up. OP=NEW
takes away all that earlier steps stated with its keyword. A load with an amplitude stays what it was at the end of its
own step. What both programs do differently is refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from contactqp.errors import InvalidProblem
from contactqp.exchange.deck.cards import Card
from contactqp.exchange.deck.model import Acceleration, AtNodes, FacePressure, Faces, Loading
from contactqp.model.arrays import Index

# Faces of one element, at most: each has a number of its own in a list of all of them.
_FACES = 8
_ON_FACES = ("*DLOAD", "*DSLOAD")


class StepLoads:
    """The loads that act, while the cards of a deck are read in order."""

    def __init__(self) -> None:
        self._before, self._stated = Loading(), Loading()
        self._keywords: set[str] = set()  # that stated a load in this step
        self._step = 0

    def begin_step(self) -> None:
        """Begin a step; what stands before the first one belongs to it."""
        self._step += 1

    def stated_by(self, card: Card) -> Loading:
        """Return where the loads of a card go, once OP=NEW has taken away what acted before it."""
        if card.parameters.get("OP") == "NEW":
            if card.name in self._keywords:
                where = "of its keyword in a step" if self._step > 1 else "of all, before the step included"
                raise card.refuse(f"OP=NEW stands with the first {where}; expected it there, or not at all")
            self._renew(card)
        self._keywords.add(card.name)
        return self._stated

    def _renew(self, card: Card) -> None:
        if card.name == "*BOUNDARY":
            self._before = replace(self._before, supports=[])
        elif card.name == "*CLOAD":
            self._before = replace(self._before, forces=[])
        else:
            keywords = {one.keyword for one in self._before.pressures}
            keywords |= {"*DLOAD"} if self._before.accelerations else set()
            for other in keywords - {card.name}:
                raise card.refuse(f"CalculiX takes away the {other} of earlier steps too; expected OP=MOD")
            self._before = replace(self._before, pressures=[], accelerations=[])

    def end_step(self) -> Loading:
        """End a step and return what acts at its end."""
        before, stated = self._before, self._stated
        self._before = Loading(
            [*_elsewhere(before.supports, stated.supports), *stated.supports],
            [*_elsewhere(before.forces, stated.forces), *stated.forces],
            [*_on_other_faces(before.pressures, stated.pressures), *stated.pressures],
            [*_other_gravity(before.accelerations, stated.accelerations), *stated.accelerations],
        )
        self._stated, self._keywords = Loading(), set()
        return self._before


def _elsewhere(before: Sequence[AtNodes], stated: Sequence[AtNodes]) -> list[AtNodes]:
    """Return what acted before at nodes and along axes that are not stated anew."""
    anew = {axis: _labels([one.nodes for one in stated if one.axis == axis]) for axis in range(3)}
    kept = [replace(one, nodes=one.nodes[~np.isin(one.nodes, anew[one.axis])]) for one in before]
    return [one for one in kept if len(one.nodes)]


def _on_other_faces(before: Sequence[FacePressure], stated: Sequence[FacePressure]) -> list[FacePressure]:
    """Return the pressures of before on faces that are not stated anew.

    Raises
    ------
    InvalidProblem
        One of *DLOAD and one of *DSLOAD on the same face: the later takes the place of the other in CalculiX alone.
    """
    kept = []
    for one in before:
        faces = _numbers(one.faces)
        for keyword in _ON_FACES:
            anew = np.isin(faces, _labels([_numbers(other.faces) for other in stated if other.keyword == keyword]))
            if keyword != one.keyword and anew.any():
                raise InvalidProblem(
                    f"{one.place}: {one.keyword}: a later step has a {keyword} on the face of element "
                    f"{one.faces.elements[np.isin(_numbers(one.faces), faces[anew])][0]}: expected the same keyword, "
                    "as the later one takes the place of the other in CalculiX, and adds to it in Abaqus"
                )
            faces = faces[~anew]
        left = np.isin(_numbers(one.faces), faces)
        if left.any():
            kept.append(replace(one, faces=Faces(one.faces.elements[left], one.faces.face[left])))
    return kept


def _other_gravity(before: Sequence[Acceleration], stated: Sequence[Acceleration]) -> list[Acceleration]:
    """Return the gravity of before on elements that have none anew.

    Raises
    ------
    InvalidProblem
        Other elements, or another direction: CalculiX adds both, Abaqus takes the later one.
    """
    kept = []
    for one in before:
        anew = [other for other in stated if np.isin(one.elements, other.elements).any()]
        for other in anew:
            same = np.array_equal(np.unique(one.elements), np.unique(other.elements))
            if not (same and np.array_equal(one.direction, other.direction)):
                raise InvalidProblem(
                    f"{other.place}: *DLOAD: expected GRAV on the same elements and along the same direction as at "
                    f"{one.place}, or OP=NEW and all loads that act: CalculiX adds both, Abaqus takes the later one"
                )
        if not anew:
            kept.append(one)
    return kept


def _labels(parts: Sequence[Index]) -> Index:
    return np.concatenate([np.zeros(0, dtype=np.int64), *parts])


def _numbers(faces: Faces) -> Index:
    """Return one number for each face of each element."""
    return np.asarray(_FACES * faces.elements + faces.face)
