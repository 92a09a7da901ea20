"""Read a deck into the model that it states, and the ledger of what became of each card."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from contactqp.errors import InvalidProblem, counted
from contactqp.exchange.deck import card_readers
from contactqp.exchange.deck.cards import CALCULIX_COLUMNS, MODEL, STEP, Card, Effect, read_cards
from contactqp.exchange.deck.instances import flattened
from contactqp.exchange.deck.model import DeckModel, Loading
from contactqp.exchange.deck.steps import StepLoads
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
_LOADS: dict[str, Callable[[DeckModel, Loading, Card, float], None]] = {
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
# Steps of one deck: with friction each is assembled and solved.
MOST_STEPS = 100


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
            _LOADS[name](model, stated, card, card_readers.factor(amplitudes, card, periods[len(model.steps)]))
        elif name == "STEP":
            acting.begin_step()
        elif name == "END STEP":
            model.steps.append(acting.end_step())
    _check_model(model)
    model.ledger.read.insert(0, _contents(model))
    return model


def _check_order(path: Path, cards: list[Card]) -> list[float]:
    """Check that cards stand where they may, with static steps at the end; return how long each of these takes."""
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
