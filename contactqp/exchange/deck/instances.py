"""Expand the parts, instances and assembly of an Abaqus deck into the equivalent flat deck.

Nodes, elements and sets of a part are repeated for each *INSTANCE of it, translated and rotated as stated there. A set
or a surface S of instance I is called I.S, as the assembly calls it; node and element labels of the second and further
instances are raised by a power of ten times their place: node 12 of the second instance may be node 1012.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from contactqp.exchange.deck.cards import LARGEST_LABEL, Card, Effect, Line, is_label
from contactqp.model.arrays import Array, Vector

T = TypeVar("T")
_FRAMES = ("PART", "END PART", "INSTANCE", "END INSTANCE", "ASSEMBLY", "END ASSEMBLY")
# Parameters that name a set or a surface of the same instance.
_OWN_NAMES = {
    "NODE": ("NSET",), "ELEMENT": ("ELSET",), "NSET": ("NSET", "ELSET"), "ELSET": ("ELSET",), "SURFACE": ("NAME",),
    "SOLID SECTION": ("ELSET",), "SPRING": ("ELSET",), "EQUATION": (),
}  # fmt: skip
# Cards whose data name nodes, elements or sets, and at which words of a line.
_FIRST_WORD, _EVERY_WORD, _EVERY_THIRD = slice(0, 1), slice(None), slice(0, None, 3)
_NAMING = {
    "ELEMENT": _EVERY_WORD, "NODE": _FIRST_WORD, "NSET": _EVERY_WORD, "ELSET": _EVERY_WORD, "SURFACE": _FIRST_WORD,
    "EQUATION": _EVERY_THIRD, "BOUNDARY": _FIRST_WORD, "CLOAD": _FIRST_WORD, "DLOAD": _FIRST_WORD,
    "SOLID SECTION": slice(0, 0), "SPRING": slice(0, 0),
}  # fmt: skip
_ON_PARTS = "put loads and supports on nodes of the instances"
_OF_INSTANCE = re.compile(r"(.+)\.(\d+)")


@dataclass
class _Instance:
    """A part in the assembly: its cards, its placement, and the number that is added to its labels."""

    name: str
    card: Card
    cards: list[Card] = field(default_factory=list)
    offset: int = 0

    @property
    def prefix(self) -> str:
        return f"{self.name}."


def flattened(cards: list[Card]) -> tuple[list[Card], list[str]]:
    """Return the cards of a deck without parts and instances, and notes on how labels were renumbered.

    Raises
    ------
    InvalidProblem
        Parts and instances that do not end, do not exist, or contain something that is not supported; by line.
    """
    if not any(card.keyword.name in _FRAMES for card in cards):
        for card in cards:
            if card.has("INSTANCE"):
                raise card.refuse("INSTANCE: expected it in an *ASSEMBLY")
        return cards, []
    instances, others = _taken_apart(cards)
    notes = _number(instances)
    flat = [card for one in instances.values() for card in _of_instance(one)]
    flat += [_outside(card, instances) for card in others]
    return flat, notes


def _taken_apart(cards: Sequence[Card]) -> tuple[dict[str, _Instance], list[Card]]:
    """Return the instances with the cards of their parts and their own, and all other cards in order."""
    parts: dict[str, list[Card]] = {}
    instances: dict[str, _Instance] = {}
    others: list[Card] = []
    frames: list[str] = []
    inside: list[Card] | None = None
    for card in cards:
        name = card.keyword.name
        if name.startswith("END ") and name in _FRAMES:
            if not frames or frames.pop() != name.removeprefix("END "):
                raise card.refuse(f"expected *{name.removeprefix('END ')} before it")
            card.refuse_lines()
            inside = None
        elif name in _FRAMES:
            if frames != (["ASSEMBLY"] if name == "INSTANCE" else []):
                raise card.refuse(f"expected it {'in an *ASSEMBLY' if name == 'INSTANCE' else 'by itself'}")
            frames.append(name)
            if name == "PART":
                card.refuse_lines()
                inside = _new(parts, card, list[Card]())
            elif name == "INSTANCE":
                instance = _new(instances, card, _Instance(card.parameter("NAME"), card))
                inside = instance.cards
                inside += _part_of(card, parts)
        elif inside is not None:
            if name not in _OWN_NAMES and card.keyword.effect is not Effect.IDLE:
                raise card.refuse(f"it is not followed in a part; there {', '.join(_OWN_NAMES)} are")
            inside.append(card)
        else:
            if frames and name in ("NODE", "ELEMENT"):
                raise card.refuse(f"those of an assembly, such as reference points, are not offered; {_ON_PARTS}")
            others.append(card)
    if frames:
        raise cards[-1].refuse(f"expected *END {frames[-1]} before the end of the deck")
    return instances, others


def _new(among: dict[str, T], card: Card, value: T) -> T:
    name = card.parameter("NAME")
    if name in among:
        raise card.refuse(f"{name} stands twice; expected each name once")
    among[name] = value
    return value


def _part_of(card: Card, parts: dict[str, list[Card]]) -> Sequence[Card]:
    """Return the cards of the part that an instance names, none for an instance that defines its own nodes."""
    if not card.has("PART"):
        return []
    name = card.parameter("PART")
    if name not in parts:
        raise card.wrong("a part that is defined above", f"{name[:40]!r}; it has {', '.join(parts)[:200] or 'none'}")
    return parts[name]


def _number(instances: dict[str, _Instance]) -> list[str]:
    """Set the number that is added to the labels of each instance, and return notes about it."""
    largest = max((_largest_label(one.cards) for one in instances.values()), default=1)
    step = 10 ** len(str(largest))
    notes = []
    for place, one in enumerate(instances.values()):
        one.offset = place * step
        if one.offset + largest >= LARGEST_LABEL:
            raise one.card.refuse(f"labels up to {largest} in {len(instances)} instances are too large")
        if place:
            notes.append(f"{one.card.head.place}: *INSTANCE {one.name}: {one.offset} added to labels")
    return notes


def _largest_label(cards: Iterable[Card]) -> int:
    return max((int(line.words[0]) for card in cards if card.keyword.name in ("NODE", "ELEMENT")
                for line in card.lines if line.words and is_label(line.words[0])), default=1)  # fmt: skip


def _of_instance(instance: _Instance) -> Iterable[Card]:
    """Yield the cards of an instance with unique names and labels, its nodes in their final position."""
    place = _placement(instance.card)

    def renamed(_card: Card, _line: Line, word: str) -> str:
        return str(int(word) + instance.offset) if is_label(word) else instance.prefix + word if word else word

    for card in instance.cards:
        name = card.keyword.name
        if card.keyword.effect is Effect.IDLE:
            yield card
            continue
        own = {key: instance.prefix + card.parameters[key] for key in _OWN_NAMES[name] if card.parameters.get(key)}
        moved = card if name != "NODE" or place is None else _moved(card, place)
        yield _rewritten(moved, card.parameters | own, renamed)


def _outside(card: Card, instances: dict[str, _Instance]) -> Card:
    """Return a card of the assembly, the model or a step, its labels resolved by INSTANCE=I or the prefix in I.12."""
    if card.keyword.name not in _NAMING:
        return card
    parameters, own = dict(card.parameters), None
    if card.has("INSTANCE"):
        name = parameters.pop("INSTANCE")
        if name not in instances:
            raise card.wrong("an instance", f"{name[:40]!r}; it has {', '.join(instances)[:200] or 'none'}")
        own = instances[name]
        if "ELSET" in parameters and card.keyword.name == "NSET":
            parameters["ELSET"] = own.prefix + parameters["ELSET"]

    def renamed(card: Card, line: Line, word: str) -> str:
        if own is not None:
            return str(int(word) + own.offset) if is_label(word) else own.prefix + word if word else word
        if is_label(word):
            raise card.wrong("INSTANCE.LABEL outside of parts", repr(word), line)
        found = _OF_INSTANCE.fullmatch(word)
        if found is not None and found[1] in instances and is_label(found[2]):
            return str(int(found[2]) + instances[found[1]].offset)
        return word

    return _rewritten(card, parameters, renamed)


def _rewritten(card: Card, parameters: dict[str, str], renamed: Callable[[Card, Line, str], str]) -> Card:
    """Return a card with other parameters, and with other names and labels in its data."""
    lines = []
    for line in card.lines:
        words = line.words
        at = _NAMING[card.keyword.name]
        if card.has("GENERATE"):
            at = slice(0, 2)  # the third number is an increment
        elif card.keyword.name == "EQUATION" and len(words) == 1:
            at = slice(0, 0)  # the number of terms
        words[at] = [renamed(card, line, word) for word in words[at]]
        lines.append(replace(line, text=", ".join(words)))
    names = (card.keyword.names[key] + (f"={value}" if value else "") for key, value in parameters.items())
    return replace(
        card, parameters=parameters, lines=lines, head=replace(card.head, text=", ".join([card.name, *names]))
    )


@dataclass(frozen=True, eq=False)
class _Placement:
    """The placement of an instance: its points are moved by a translation (3,), then turned about a point (3,)."""

    translation: Vector
    point: Vector
    rotation: Array  # (3, 3)

    def __call__(self, x: Vector) -> Vector:
        return np.asarray(self.point + self.rotation @ (x + self.translation - self.point))


def _placement(card: Card) -> _Placement | None:
    """Return the placement of an instance, None where it is not moved.

    A first line has a translation, a second one two points of an axis and an angle in degrees.
    """
    if not card.lines:
        return None
    if len(card.lines) > 2:
        raise card.wrong("at most a translation and a rotation", f"{len(card.lines)} lines", card.lines[2])
    first = card.lines[0]
    if len(first.words) > 3:
        raise card.wrong("a translation", repr(first.text[:60]), first)
    translation = np.pad(card.numbers(first, first.words, "a translation"), (0, 3 - len(first.words)))
    point, rotation = np.zeros(3), np.eye(3)
    for line in card.lines[1:]:
        numbers = card.numbers(line, line.words, "two points and an angle")
        axis = numbers[3:6] - numbers[:3] if len(numbers) == 7 else np.zeros(3)
        length = float(np.linalg.norm(axis))
        if not 0 < length < np.inf:
            raise card.wrong("two different points of an axis and an angle", repr(line.text[:60]), line)
        point, rotation = numbers[:3], _rotation(axis / length, np.radians(numbers[6]))
    return _Placement(translation, point, rotation)


def _rotation(axis: Vector, angle: float) -> Array:
    """Return the matrix (3, 3) of a right-handed turn about a unit vector (Rodrigues' formula); quarters are exact."""
    quarter = round(2 * angle / np.pi)
    whole = bool(np.isclose(2 * angle / np.pi, quarter, rtol=0, atol=1e-12))
    sine, cosine = ((0, 1), (1, 0), (0, -1), (-1, 0))[quarter % 4] if whole else (np.sin(angle), np.cos(angle))
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + sine * cross + (1 - cosine) * cross @ cross)


def _moved(card: Card, place: _Placement) -> Card:
    """Return the card of a part's nodes in the position of an instance, with 13 digits, which every program reads."""
    lines = []
    for line in card.lines:
        words = line.words
        if len(words) > 4:
            raise card.wrong("a label and up to three coordinates", f"{len(words)} numbers", line)
        x = place(np.pad(card.numbers(line, words[1:], "coordinates"), (0, 4 - len(words))))
        lines.append(replace(line, text=", ".join([*words[:1], *(f"{value:.12e}" for value in x)])))
    return replace(card, lines=lines)
