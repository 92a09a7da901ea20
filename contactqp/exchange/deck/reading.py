"""Read a deck into a `DeckModel`, with a ledger of which cards were read, assumed or without effect.

What acts at the end of each step is what acted before, with what the step states in its place. As in CalculiX and
Abaqus, a displacement, a force or a pressure stays from step to step until a later step states another one at the same
node and direction, or face (OP=MOD); within one step forces and pressures add up. OP=NEW takes away all that earlier
steps stated with its keyword. A load with an amplitude stays what it was at the end of its own step. Decks on which the
two programs differ are refused.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from contactqp.errors import InvalidProblem, counted
from contactqp.exchange.deck import card_readers
from contactqp.exchange.deck.cards import CALCULIX_COLUMNS, MODEL, STEP, Card, Effect, read_cards
from contactqp.exchange.deck.instances import flattened
from contactqp.exchange.deck.model import Acceleration, AtNodes, DeckModel, FacePressure, Faces, Loading
from contactqp.exchange.files import Ledger, Path, is_number
from contactqp.model.arrays import Index

Handler = Callable[[DeckModel, Card], None]
# The order in which cards are read, whatever their order in the deck: sets and loads refer to nodes and elements.
_FIRST: dict[str, Handler] = {"NODE": card_readers.read_nodes, "ELEMENT": card_readers.read_elements}
_MODEL: dict[str, Handler] = {
    "NSET": card_readers.read_set,
    "ELSET": card_readers.read_set,
    "SURFACE": card_readers.read_surface,
    "MATERIAL": card_readers.read_material,
    "ELASTIC": card_readers.read_elastic,
    "DENSITY": card_readers.read_density,
    "SOLID SECTION": card_readers.read_section,
    "SPRING": card_readers.read_spring,
    "EQUATION": card_readers.read_equation,
    "TIE": card_readers.read_tie,
    "CONTACT PAIR": card_readers.read_pair,
    "SURFACE INTERACTION": card_readers.read_interaction,
    "SURFACE BEHAVIOR": card_readers.read_behavior,
    "FRICTION": card_readers.read_friction,
    "CLEARANCE": card_readers.read_clearance,
}
_LOADS: dict[str, Callable[[DeckModel, Loading, Card, float], None]] = {
    "BOUNDARY": card_readers.read_boundary,
    "CLOAD": card_readers.read_forces,
    "DLOAD": card_readers.read_distributed,
    "DSLOAD": card_readers.read_surface_load,
}
# Cards that belong to a material or an interaction must follow its keyword directly.
_FOLLOWING = {
    "ELASTIC": "MATERIAL", "DENSITY": "MATERIAL", "EXPANSION": "MATERIAL", "CONDUCTIVITY": "MATERIAL",
    "SPECIFIC HEAT": "MATERIAL", "DAMPING": "MATERIAL", "SURFACE BEHAVIOR": "SURFACE INTERACTION",
    "FRICTION": "SURFACE INTERACTION",
}  # fmt: skip
_SHOWN = 5
# Steps of one deck: with friction each is assembled and solved.
MOST_STEPS = 100
# Faces of one element, at most: each has a number of its own in a list of all of them.
_FACES = 8
_ON_FACES = ("*DLOAD", "*DSLOAD")


def read_deck_model(path: Path, columns: int | None = None) -> DeckModel:
    """Return the model of a deck; its ledger lists what was read, assumed and without effect.

    Raises InvalidProblem: a card that is unknown, not offered or malformed, with file and line.

    Parameters
    ----------
    path : path
    columns : read this many characters of each number, as CalculiX reads 20; all of them by default
    """
    cards, labels = flattened(read_cards(path, columns))
    model = DeckModel(str(path), Ledger(str(path), converted=labels))
    periods = _check_order(path, cards)
    model.end = sum(periods)
    for card in cards:
        if card.keyword.name in _FIRST:
            _FIRST[card.keyword.name](model, card)
    amplitudes: card_readers.Amplitudes = {}
    acting = StepLoads()
    for card in cards:
        name = card.keyword.name
        _note_idle(model.ledger, card)
        _note_long_numbers(model, card)
        if name in _MODEL:
            _MODEL[name](model, card)
        elif name == "AMPLITUDE":
            if len(periods) > 1 and card.parameter("TIME", "STEP TIME") != "STEP TIME":
                raise card.refuse("with several steps, expected TIME=STEP TIME")
            card_readers.read_amplitude(amplitudes, card)
        elif name in _LOADS:
            stated = acting.stated_by(card)
            if card.lines or not card.has("OP"):  # a card with OP alone is not a mistake: it takes loads away
                _LOADS[name](model, stated, card, card_readers.factor(amplitudes, card, periods[len(model.steps)]))
        elif name == "STEP":
            acting.begin_step()
        elif name == "END STEP":
            model.steps.append(acting.end_step())
    _check_model(model)
    model.ledger.read.insert(0, _contents(model))
    return model


def _check_order(path: Path, cards: list[Card]) -> list[float]:
    """Check the order of the cards, with static steps at the end, and return the time period of each step."""
    inside, static, owner = False, False, ""
    periods: list[float] = []
    for card in cards:
        name = card.keyword.name
        if periods and not inside and name != "STEP" and card.keyword.effect is not Effect.IDLE:
            raise card.refuse("expected nothing but another *STEP behind *END STEP")
        if (card.keyword.where == STEP and not inside) or (card.keyword.where == MODEL and inside):
            raise card.refuse(f"expected it {card.keyword.where}")
        if name in _FOLLOWING and owner != _FOLLOWING[name]:
            raise card.refuse(f"expected it right behind *{_FOLLOWING[name]}")
        if name not in _FOLLOWING:
            owner = name
        if name == "STEP":
            inside, static = True, False
        elif name == "STATIC":
            if static:
                raise card.refuse("a step has one *STATIC; expected one")
            if periods and (card.has("TIME RESET") or card.has("TOTAL TIME AT START")):
                raise card.refuse("times of the steps of a deck go on; expected neither TIME RESET nor TOTAL TIME")
            static = True
            periods.append(_period(card))
        elif name == "END STEP":
            if not static:
                raise card.refuse("expected *STATIC in the step, got none")
            inside = False
    if not periods:
        raise InvalidProblem(f"{path}: expected a *STEP with *STATIC in it, got none")
    if inside:
        raise InvalidProblem(f"{path}: expected *END STEP at the end, got none: the file was cut off")
    if len(periods) > MOST_STEPS:
        raise InvalidProblem(f"{path}: expected at most {MOST_STEPS} steps, got {len(periods)}")
    return periods


def _period(card: Card) -> float:
    """Return the time at the end of the step: the second number, 1 by default."""
    if len(card.lines) > 1:
        raise card.wrong("at most one line of data", f"{len(card.lines)} lines")
    for line in card.lines:
        if len(line.words) > 4:
            raise card.wrong("up to four times", f"{len(line.words)} numbers", line)
        times = card.numbers(line, line.words, "times")
        if np.any(times < 0):
            raise card.wrong("times >= 0", repr(line.text[:40]), line)
        if len(times) > 1 and times[1] > 0:
            return float(times[1])
    return 1.0


def _note_idle(ledger: Ledger, card: Card) -> None:
    if card.keyword.effect is Effect.IDLE:
        ledger.ignored.append(f"{card.head.place}: {card.name}: {card.keyword.why}")
        return
    idle = [card.keyword.names[key] for key in card.parameters if card.keyword.parameters.get(key) == "idle"]
    if idle:
        ledger.ignored.append(f"{card.head.place}: {card.name}: {', '.join(idle)}")


def _note_long_numbers(model: DeckModel, card: Card) -> None:
    """Note the numbers that have more characters than CalculiX reads."""
    if card.keyword.effect is Effect.IDLE or card.keyword.name == "HEADING":
        return
    for line in card.lines:
        if len(line.text) > CALCULIX_COLUMNS and any(
            len(word) > CALCULIX_COLUMNS and is_number(word) for word in line.words
        ):
            model.long_numbers.append(line.place)


def _check_model(model: DeckModel) -> None:
    if not len(model.labels) or not model.elements:
        raise InvalidProblem(f"{model.file}: expected *NODE and *ELEMENT, got none")
    for place in model.long_numbers[:_SHOWN]:
        model.ledger.assumed.append(f"{place}: all of a number's characters count; CalculiX reads the first 20")
    if len(model.long_numbers) > _SHOWN:
        more = counted("more line", len(model.long_numbers) - _SHOWN)
        model.ledger.assumed.append(f"{more} with numbers of more than 20 characters")
    for pair in model.pairs:
        if pair.interaction not in model.interactions:
            has = ", ".join(model.interactions) or "none"
            raise InvalidProblem(
                f"{pair.place}: *CONTACT PAIR: there is no interaction {pair.interaction}; it has {has}"
            )
    for interaction in model.interactions.values():
        if not interaction.stated:
            model.ledger.assumed.append(f"{interaction.place}: no *SURFACE BEHAVIOR: HARD")
    named = [(one.place, one.slave, one.master) for one in model.pairs]
    named += [(one.place, one.slave, one.master) for one in model.ties]
    for place, *names in named:
        for name in names:
            if name not in model.surfaces:
                has = ", ".join(model.surfaces)[:200] or "none"
                raise InvalidProblem(f"{place}: there is no surface {name}; it has {has}")
    if len(model.steps) > 1 and any(interaction.friction > 0 for interaction in model.interactions.values()):
        model.ledger.assumed.append(f"friction is followed step by step, each of the {len(model.steps)} one increment")
    pairs = {(pair.slave, pair.master) for pair in model.pairs}
    for slave, master in model.clearances:
        if (slave, master) not in pairs:
            raise InvalidProblem(f"{model.file}: *CLEARANCE: there is no contact pair of {slave} and {master}")


def _contents(model: DeckModel) -> str:
    counts = {kind: sum(len(one.labels) for one in model.elements if one.type == kind) for kind in model.types()}
    elements = ", ".join(f"{count} {kind}" for kind, count in counts.items())
    return f"{counted('node', len(model.labels))}, {elements}"


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
        """Return the `Loading` that a card adds to; OP=NEW first removes the loads that earlier steps stated with its
        keyword.
        """
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
    """Return the earlier loads at nodes and along axes that are not stated again."""
    anew = {axis: _labels([one.nodes for one in stated if one.axis == axis]) for axis in range(3)}
    kept = [replace(one, nodes=one.nodes[~np.isin(one.nodes, anew[one.axis])]) for one in before]
    return [one for one in kept if len(one.nodes)]


def _on_other_faces(before: Sequence[FacePressure], stated: Sequence[FacePressure]) -> list[FacePressure]:
    """Return the earlier pressures on faces that are not stated again.

    Raises
    ------
    InvalidProblem
        *DLOAD and *DSLOAD on the same face: the later replaces the earlier in CalculiX alone.
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
    """Return the earlier gravity loads on elements for which none is stated again.

    Raises InvalidProblem: other elements, or another direction: CalculiX adds both, Abaqus takes the later one.
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
