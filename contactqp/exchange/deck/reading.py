"""Read a deck into the model that it states, and the ledger of what became of each card."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from contactqp.errors import InvalidProblem, counted
from contactqp.exchange.deck import card_readers
from contactqp.exchange.deck.cards import CALCULIX_COLUMNS, MODEL, STEP, Card, Effect, read_cards
from contactqp.exchange.deck.model import DeckModel
from contactqp.exchange.files import Ledger, Path, is_number

Handler = Callable[[DeckModel, Card], None]
# What stands before others in a deck, whatever their order in it: sets and loads name nodes and elements.
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
_LOADS: dict[str, Callable[[DeckModel, Card, float], None]] = {
    "BOUNDARY": card_readers.read_boundary,
    "CLOAD": card_readers.read_forces,
    "DLOAD": card_readers.read_distributed,
    "DSLOAD": card_readers.read_surface_load,
}
# What a material or an interaction is made of stands right behind its own keyword.
_FOLLOWING = {
    "ELASTIC": "MATERIAL", "DENSITY": "MATERIAL", "EXPANSION": "MATERIAL", "CONDUCTIVITY": "MATERIAL",
    "SPECIFIC HEAT": "MATERIAL", "DAMPING": "MATERIAL", "SURFACE BEHAVIOR": "SURFACE INTERACTION",
    "FRICTION": "SURFACE INTERACTION",
}  # fmt: skip
_SHOWN = 5


def read_deck_model(path: Path, columns: int | None = None) -> DeckModel:
    """Return what a deck states; the ledger says what was read, assumed and without effect.

    Parameters
    ----------
    path : path
    columns : int, optional
        Read this many characters of each number, as CalculiX reads 20; all of them by default.

    Raises
    ------
    InvalidProblem
        Anything that is not known, not offered or not as it should be, by file and line.
    """
    cards = read_cards(path, columns)
    model = DeckModel(str(path), Ledger(str(path)))
    end = model.end = _check_order(path, cards)
    for card in cards:
        if card.keyword.name in _FIRST:
            _FIRST[card.keyword.name](model, card)
    amplitudes: card_readers.Amplitudes = {}
    inside, loaded = False, False
    for card in cards:
        name = card.keyword.name
        _note_idle(model.ledger, card)
        _note_long_numbers(model, card)
        if name in _MODEL:
            _MODEL[name](model, card)
        elif name == "AMPLITUDE":
            card_readers.read_amplitude(amplitudes, card)
        elif name in _LOADS:
            _check_op(card, loaded and not inside)
            loaded = True
            _LOADS[name](model, card, card_readers.factor(amplitudes, card, end))
        inside = inside or name == "STEP"
    _check_model(model)
    model.ledger.read.insert(0, _contents(model))
    return model


def _check_order(path: Path, cards: list[Card]) -> float:
    """Check that cards stand where they may, with one static step at the end; return the time at its end."""
    inside = ended = False
    end, static, owner = 1.0, False, ""
    for card in cards:
        name = card.keyword.name
        if ended and card.keyword.effect is not Effect.IDLE:
            raise card.refuse("a deck has one step here; expected nothing behind *END STEP")
        if (card.keyword.where == STEP and not inside) or (card.keyword.where == MODEL and inside):
            raise card.refuse(f"expected it {card.keyword.where}")
        if name in _FOLLOWING and owner != _FOLLOWING[name]:
            raise card.refuse(f"expected it right behind *{_FOLLOWING[name]}")
        if name not in _FOLLOWING:
            owner = name
        if name == "STEP":
            inside = True
        elif name == "STATIC":
            if static:
                raise card.refuse("a step has one *STATIC; expected one")
            static, end = True, _period(card)
        elif name == "END STEP":
            ended = True
    if not static:
        raise InvalidProblem(f"{path}: expected a *STEP with *STATIC in it, got none")
    if not ended:
        raise InvalidProblem(f"{path}: expected *END STEP at the end, got none: the file was cut off")
    return end


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


def _check_op(card: Card, before: bool) -> None:
    """Refuse OP=NEW where it would take something away that stands before the step."""
    if card.parameters.get("OP") == "NEW" and before:
        raise card.refuse("OP=NEW takes away what stands before the step; expected the deck without it")


def _note_idle(ledger: Ledger, card: Card) -> None:
    if card.keyword.effect is Effect.IDLE:
        ledger.ignored.append(f"{card.head.place}: {card.name}: {card.keyword.why}")
        return
    idle = [card.keyword.names[key] for key in card.parameters if card.keyword.parameters.get(key) == "idle"]
    if idle:
        ledger.ignored.append(f"{card.head.place}: {card.name}: {', '.join(idle)}")


def _note_long_numbers(model: DeckModel, card: Card) -> None:
    """Note where numbers have more characters than CalculiX reads of them."""
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
    pairs = {(pair.slave, pair.master) for pair in model.pairs}
    for slave, master in model.clearances:
        if (slave, master) not in pairs:
            raise InvalidProblem(f"{model.file}: *CLEARANCE: there is no contact pair of {slave} and {master}")


def _contents(model: DeckModel) -> str:
    counts = {kind: sum(len(one.labels) for one in model.elements if one.type == kind) for kind in model.types()}
    elements = ", ".join(f"{count} {kind}" for kind, count in counts.items())
    return f"{counted('node', len(model.labels))}, {elements}"
