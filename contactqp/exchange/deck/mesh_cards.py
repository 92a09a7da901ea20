"""Cards of nodes, elements, sets, surfaces, materials and sections."""

from __future__ import annotations

import re
from collections.abc import Sequence
from difflib import get_close_matches
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from contactqp.exchange.deck.cards import Card, Line, is_label
from contactqp.exchange.deck.model import (
    ELEMENT_NODES,
    OTHER_ELEMENTS,
    DeckMaterial,
    DeckModel,
    DeckSurface,
    Elements,
    Faces,
    Section,
    SpringSection,
)
from contactqp.model.arrays import Index

T = TypeVar("T")
NONE: Index = np.zeros(0, dtype=np.int64)


def read_nodes(model: DeckModel, card: Card) -> None:
    """Add nodes: a label and up to three coordinates a line; those that are left out are 0."""
    labels, points = [], []
    for line, words in card.table("a label and coordinates"):
        if len(words) > 4:
            raise card.wrong("a label and up to three coordinates", f"{len(words)} numbers", line)
        labels.append(card.label(line, words[0]))
        points.append(np.pad(card.numbers(line, words[1:], "coordinates"), (0, 4 - len(words))))
    added = np.array(labels, dtype=np.int64)
    every = np.concatenate([model.labels, added])
    _refuse_twice(card, "node", every)
    order = np.argsort(every, kind="stable")
    model.labels = every[order]
    model.points = np.concatenate([model.points, np.array(points, dtype=float)])[order]
    if card.has("NSET"):
        extend(model.node_sets, card.parameter("NSET"), added)


def read_elements(model: DeckModel, card: Card) -> None:
    """Add elements of one type: a label and the labels of the nodes, which may go on over several lines."""
    kind = card.parameter("TYPE")
    if kind in OTHER_ELEMENTS:
        raise card.refuse(f"elements {kind}: {OTHER_ELEMENTS[kind]}")
    if kind not in ELEMENT_NODES:
        near = get_close_matches(kind, [*ELEMENT_NODES, *OTHER_ELEMENTS], n=1)
        nearest = f"; the nearest one is {near[0]}" if near else f"; offered are {', '.join(ELEMENT_NODES)}"
        raise card.refuse(f"there are no elements {kind[:40]}{nearest}")
    width = ELEMENT_NODES[kind] + 1
    numbers: list[int] = []
    at: list[Line] = []
    for line, words in card.table(f"a label and {width - 1} nodes for each element"):
        if not len(numbers) % width:
            at.append(line)
        elif len(numbers) % width + len(words) > width:
            raise card.wrong(f"{width - 1} nodes for each {kind}", "more", line)
        if len(words) > width:
            raise card.wrong(f"a label and {width - 1} nodes for each {kind}", f"{len(words)} numbers", line)
        numbers.extend(card.label(line, word, "a label of a node") for word in words)
    if len(numbers) % width:
        got = f"{len(numbers) % width} numbers for the last one"
        raise card.wrong(f"a label and {width - 1} nodes for each {kind}", got, at[-1])
    table = np.array(numbers, dtype=np.int64).reshape(-1, width)
    group = Elements(kind, table[:, 0], table[:, 1:], card.head.place)
    dimensions = {one.dimension for one in (*model.elements, group)} - {0}
    if len(dimensions) > 1:
        raise card.refuse(f"elements {kind} beside others of another number of dimensions; expected one of both")
    _refuse_twice(card, "element", np.concatenate([*(one.labels for one in model.elements), group.labels]))
    model.elements.append(group)
    if card.has("ELSET"):
        extend(model.element_sets, card.parameter("ELSET"), group.labels)


def read_set(model: DeckModel, card: Card) -> None:
    """Add labels, or the members of sets that stand further up, to a set of nodes or of elements."""
    sets = model.node_sets if card.keyword.name == "NSET" else model.element_sets
    name = card.parameter(card.keyword.name)
    if card.keyword.name == "NSET" and card.has("ELSET"):
        card.refuse_lines()
        chosen = find(model.element_sets, card, card.head, card.parameter("ELSET"), "set of elements")
        inside = [one.nodes[np.isin(one.labels, chosen)].ravel() for one in model.elements]
        return extend(sets, name, np.concatenate([NONE, *inside]))
    found = [NONE]
    for line, words in card.table("labels"):
        if card.has("GENERATE"):
            found.append(card.generated(line))
        else:
            found.extend(members(sets, card, line, word) for word in words if word)
    return extend(sets, name, np.concatenate(found))


def members(sets: dict[str, Index], card: Card, line: Line, word: str) -> Index:
    """Return a label, or the members of a set."""
    if is_label(word):
        return np.array([int(word)], dtype=np.int64)
    return find(sets, card, line, word, "label or set")


def find(among: dict[str, T], card: Card, line: Line, name: str, what: str) -> T:
    """Return what is called so in a deck, or refuse the line, with the nearest name.

    Raises
    ------
    InvalidProblem
        There is none of that name further up.
    """
    if name in among:
        return among[name]
    near = get_close_matches(name, list(among), n=1)
    nearest = f"; the nearest one is {near[0]}" if near else f"; it has {', '.join(among)[:200] or 'none'}"
    raise card.wrong(f"a {what} that stands further up", f"{name[:40]!r}{nearest}", line)


def extend(sets: dict[str, Index], name: str, labels: Index) -> None:
    """Add labels to a set; each is in it once, and they ascend."""
    sets[name] = np.unique(np.concatenate([sets.get(name, NONE), labels]))


def read_surface(model: DeckModel, card: Card) -> None:
    """Add a surface: faces ``elements, S1`` of elements or sets of them, or nodes."""
    name = card.parameter("NAME")
    if name in model.surfaces:
        raise card.refuse(f"there is a surface {name} already; expected all of it below one keyword")
    if card.parameter("TYPE", "ELEMENT") == "NODE":
        nodes = [NONE]
        for line, words in card.table("labels of nodes or sets"):
            if len(words) > 1 and words[1]:
                raise card.wrong("a node or a set a line, without areas", repr(line.text[:40]), line)
            nodes.append(members(model.node_sets, card, line, words[0]))
        model.surfaces[name] = DeckSurface(name, None, np.unique(np.concatenate(nodes)), card.head.place)
        return
    elements, numbers = [NONE], [NONE]
    for line, words in card.table("an element or a set, and a face S1, S2, ..."):
        face = re.fullmatch(r"S([1-6])", words[1]) if len(words) == 2 else None
        if face is None:
            raise card.wrong("an element or a set, and a face S1, S2, ...", repr(line.text[:40]), line)
        chosen = members(model.element_sets, card, line, words[0])
        elements.append(chosen)
        numbers.append(np.full(len(chosen), int(face[1])))
    pairs = np.unique(np.stack([np.concatenate(elements), np.concatenate(numbers)], axis=1), axis=0)
    model.surfaces[name] = DeckSurface(name, Faces(pairs[:, 0], pairs[:, 1]), None, card.head.place)


def read_material(model: DeckModel, card: Card) -> None:
    """Begin a material; the cards that follow state its numbers."""
    card.refuse_lines()
    name = card.parameter("NAME")
    if name in model.materials:
        raise card.refuse(f"there is a material {name} already, at {model.materials[name].place}")
    model.materials[name] = DeckMaterial(name, card.head.place)


def read_elastic(model: DeckModel, card: Card) -> None:
    """Read Young's modulus and Poisson's ratio, at one temperature."""
    line = card.only_line("Young's modulus and Poisson's ratio (one temperature)")
    if len(line.words) not in (2, 3):
        raise card.wrong("Young's modulus and Poisson's ratio", f"{len(line.words)} numbers", line)
    material = _material(model, card)
    material.modulus = card.real(line, 0, "Young's modulus")
    material.poisson = card.real(line, 1, "Poisson's ratio")
    if not 1e-120 <= material.modulus <= 1e120:
        raise card.wrong("Young's modulus > 0", f"{material.modulus:g}", line)
    if not -1 < material.poisson < 0.5:
        raise card.wrong("Poisson's ratio between -1 and 0.5", f"{material.poisson:g}", line)


def read_density(model: DeckModel, card: Card) -> None:
    """Read the density, at one temperature."""
    line = card.only_line("the density (one temperature)")
    material = _material(model, card)
    material.density = card.real(line, 0, "the density")
    if material.density < 0:
        raise card.wrong("a density >= 0", f"{material.density:g}", line)


def _material(model: DeckModel, card: Card) -> DeckMaterial:
    if not model.materials:
        raise card.refuse("it belongs to a material; expected *MATERIAL before it")
    return list(model.materials.values())[-1]


def read_section(model: DeckModel, card: Card) -> None:
    """Give a material to elements, with the thickness of plane ones or the area of trusses."""
    elements = find(model.element_sets, card, card.head, card.parameter("ELSET"), "set of elements")
    name = card.parameter("MATERIAL")
    if len(card.lines) > 1:
        raise card.wrong("at most one line of data, a thickness", f"{len(card.lines)} lines")
    size = None
    for line in card.lines:
        size = card.real(line, 0, "a thickness, or the area of a truss")
        if not size > 0 or len(line.words) > 1:
            raise card.wrong("one thickness > 0", repr(line.text[:40]), line)
    model.sections.append(Section(elements, name, size, card.head.place))


def read_spring(model: DeckModel, card: Card) -> None:
    """Give a stiffness to springs; the empty line that both programs expect before it has been left out."""
    elements = find(model.element_sets, card, card.head, card.parameter("ELSET"), "set of elements")
    line = card.only_line("an empty line, then the stiffness of SPRINGA")
    stiffness = card.real(line, 0, "the stiffness of the springs")
    if not stiffness > 0:
        raise card.wrong("a stiffness > 0", f"{stiffness:g}", line)
    model.springs.append(SpringSection(elements, stiffness, card.head.place))


def _refuse_twice(card: Card, what: str, labels: NDArray[np.int64]) -> None:
    values, counts = np.unique(labels, return_counts=True)
    twice: Sequence[int] = values[counts > 1].tolist()
    if twice:
        raise card.refuse(f"{what} {twice[0]} stands twice; expected each label once")
