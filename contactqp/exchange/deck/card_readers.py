"""Read the cards of a deck: nodes, elements, sets, surfaces, materials, sections; supports, loads, ties and contact."""

from __future__ import annotations

import re
from collections.abc import Sequence
from difflib import get_close_matches
from typing import TypeVar

import numpy as np

from contactqp.exchange.deck.cards import Card, Line, is_label
from contactqp.exchange.deck.model import (
    ELEMENT_NODES,
    OTHER_ELEMENTS,
    Acceleration,
    AtNodes,
    ContactPair,
    DeckMaterial,
    DeckModel,
    DeckSurface,
    DeckTie,
    Elements,
    Equation,
    FacePressure,
    Faces,
    Interaction,
    Loading,
    Section,
    SpringSection,
)
from contactqp.exchange.files import DECIMAL_COMMA
from contactqp.model.arrays import Index, Vector

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
        others = "; expected elements of one dimension: of a mesh that lists edges and faces too, those of the bodies"
        raise card.refuse(f"elements {kind} beside others of another number of dimensions{others}")
    _refuse_twice(card, "element", np.concatenate([*(one.labels for one in model.elements), group.labels]))
    model.elements.append(group)
    if card.has("ELSET"):
        extend(model.element_sets, card.parameter("ELSET"), group.labels)


def read_set(model: DeckModel, card: Card) -> None:
    """Add labels, or the members of sets defined above, to a set of nodes or of elements."""
    sets = model.node_sets if card.keyword.name == "NSET" else model.element_sets
    name = card.parameter(card.keyword.name)
    if card.keyword.name == "NSET" and card.has("ELSET"):
        card.refuse_lines()
        chosen = _find(model.element_sets, card, card.head, card.parameter("ELSET"), "set of elements")
        inside = [one.nodes[np.isin(one.labels, chosen)].ravel() for one in model.elements]
        return extend(sets, name, np.concatenate([NONE, *inside]))
    found = [NONE]
    for line, words in card.table("labels"):
        if card.has("GENERATE"):
            found.append(card.generated(line))
        else:
            found.extend(_members(sets, card, line, word) for word in words if word)
    return extend(sets, name, np.concatenate(found))


def _members(sets: dict[str, Index], card: Card, line: Line, word: str) -> Index:
    """Return a label, or the members of a set."""
    if is_label(word):
        return np.array([int(word)], dtype=np.int64)
    return _find(sets, card, line, word, "label or set")


def _find(among: dict[str, T], card: Card, line: Line, name: str, what: str) -> T:
    """Return the entry of this name, or refuse the line and suggest the nearest name.

    Raises InvalidProblem: no such name is defined above this line.
    """
    if name in among:
        return among[name]
    near = get_close_matches(name, list(among), n=1)
    nearest = f"; the nearest one is {near[0]}" if near else f"; it has {', '.join(among)[:200] or 'none'}"
    raise card.wrong(
        f"{'an' if what[0] in 'aei' else 'a'} {what} that is defined above", f"{name[:40]!r}{nearest}", line
    )


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
            nodes.append(_members(model.node_sets, card, line, words[0]))
        model.surfaces[name] = DeckSurface(name, None, np.unique(np.concatenate(nodes)), card.head.place)
        return
    elements, numbers = [NONE], [NONE]
    for line, words in card.table("an element or a set, and a face S1, S2, ..."):
        face = re.fullmatch(r"S([1-6])", words[1]) if len(words) == 2 else None
        if face is None:
            raise card.wrong("an element or a set, and a face S1, S2, ...", repr(line.text[:40]), line)
        chosen = _members(model.element_sets, card, line, words[0])
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
    material = _material(model)
    material.modulus = card.real(line, 0, "Young's modulus")
    material.poisson = card.real(line, 1, "Poisson's ratio")
    if not 1e-120 <= material.modulus <= 1e120:
        raise card.wrong("Young's modulus > 0", f"{material.modulus:g}", line)
    if not -1 < material.poisson < 0.5:
        raise card.wrong("Poisson's ratio between -1 and 0.5", f"{material.poisson:g}", line)
    if len(line.words) > 2:
        model.ledger.ignored.append(f"{line.place}: *ELASTIC: the temperature behind both constants, {line.words[2]!r}")


def read_density(model: DeckModel, card: Card) -> None:
    """Read the density, at one temperature."""
    line = card.only_line("the density (one temperature)")
    material = _material(model)
    material.density = card.real(line, 0, "the density")
    if material.density < 0:
        raise card.wrong("a density >= 0", f"{material.density:g}", line)


def _material(model: DeckModel) -> DeckMaterial:
    """Return the last material; the order of cards ensures that there is one."""
    return list(model.materials.values())[-1]


def read_section(model: DeckModel, card: Card) -> None:
    """Give a material to elements, with the thickness of plane ones or the area of trusses."""
    elements = _find(model.element_sets, card, card.head, card.parameter("ELSET"), "set of elements")
    name = card.parameter("MATERIAL")
    if len(card.lines) > 1:
        raise card.wrong("at most one line of data, a thickness", f"{len(card.lines)} lines")
    size = None
    for line in (line for line in card.lines if line.words):  # Abaqus/CAE writes a comma where there is nothing
        size = card.real(line, 0, "a thickness, or the area of a truss")
        if not size > 0 or len(line.words) > 1:
            raise card.wrong("one thickness > 0", repr(line.text[:40]), line)
    model.sections.append(Section(elements, name, size, card.head.place))


def read_spring(model: DeckModel, card: Card) -> None:
    """Give a stiffness to springs; the empty line that both programs expect before it has been left out."""
    elements = _find(model.element_sets, card, card.head, card.parameter("ELSET"), "set of elements")
    line = card.only_line("an empty line, then the stiffness of SPRINGA")
    stiffness = card.real(line, 0, "the stiffness of the springs")
    if not stiffness > 0:
        raise card.wrong("a stiffness > 0", f"{stiffness:g}", line)
    model.springs.append(SpringSection(elements, stiffness, card.head.place))


def _refuse_twice(card: Card, what: str, labels: Index) -> None:
    values, counts = np.unique(labels, return_counts=True)
    twice: Sequence[int] = values[counts > 1].tolist()
    if twice:
        raise card.refuse(f"{what} {twice[0]} stands twice; expected each label once")


Amplitudes = dict[str, tuple[Vector, Vector]]
# The directions that each of these words fixes, among the unknowns of the elements offered here.
FIXED_DIRECTIONS = {
    "ENCASTRE": (0, 1, 2), "PINNED": (0, 1, 2), "XSYMM": (0,), "YSYMM": (1,), "ZSYMM": (2,),
    "XASYMM": (1, 2), "YASYMM": (0, 2), "ZASYMM": (0, 1),
}  # fmt: skip
ROTATIONS = (4, 5, 6)


def read_amplitude(amplitudes: Amplitudes, card: Card) -> None:
    """Read times and values, up to four pairs a line."""
    numbers = [card.numbers(line, words, "times and values") for line, words in card.table("times and values")]
    table = np.concatenate(numbers)
    if len(table) % 2 or np.any(np.diff(table[::2]) < 0):
        raise card.wrong("pairs of an ascending time and a value", f"{len(table)} numbers")
    amplitudes[card.parameter("NAME")] = table[::2], table[1::2]


def factor(amplitudes: Amplitudes, card: Card, end: float) -> float:
    """Return what a load of this card is multiplied by at the end of the step."""
    if not card.has("AMPLITUDE"):
        return 1.0
    times, values = _find(amplitudes, card, card.head, card.parameter("AMPLITUDE"), "amplitude")
    return float(np.interp(end, times, values))


def read_boundary(model: DeckModel, loading: Loading, card: Card, scale: float) -> None:
    """Read displacements: nodes, a first and a last direction, a value; or nodes and a word such as ENCASTRE.

    Parameters
    ----------
    model, loading, card : DeckModel with the sets of nodes, Loading that takes the supports, Card
    scale : float, by which all values are multiplied: that of an amplitude at the end of the step
    """
    rotations = 0
    for line, words in card.table("nodes, a first and a last direction, a displacement"):
        nodes = _members(model.node_sets, card, line, words[0])
        if len(words) == 2 and words[1] in FIXED_DIRECTIONS:
            loading.supports.extend(AtNodes(nodes, axis, 0.0, line.place) for axis in FIXED_DIRECTIONS[words[1]])
            continue
        if not 2 <= len(words) <= 4:
            raise card.wrong("nodes, a first and a last direction, a displacement", repr(line.text[:40]), line)
        first = _direction(card, line, words[1])
        last = _direction(card, line, words[2]) if len(words) > 2 and words[2] else first
        if last < first:
            raise card.wrong("a last direction not below the first", repr(line.text[:40]), line)
        value = scale * card.real(line, 3, "a displacement", 0.0)
        for direction in range(first, last + 1):
            if direction in ROTATIONS:
                rotations += 1
                if value:
                    raise card.wrong("directions 1 to 3 with a value", f"the rotation {direction}", line)
            else:
                loading.supports.append(AtNodes(nodes, direction - 1, value, line.place))
    if rotations:
        model.ledger.ignored.append(f"{card.head.place}: *BOUNDARY: rotations; the elements have none")


def _direction(card: Card, line: Line, word: str) -> int:
    if not re.fullmatch(r"[1-6]", word):
        raise card.wrong("a direction 1, 2 or 3", repr(word[:40]), line)
    return int(word)


def read_forces(model: DeckModel, loading: Loading, card: Card, scale: float) -> None:
    """Read forces: nodes, a direction, a value; forces on one node add up.

    Parameters
    ----------
    model, loading, card, scale : as in `read_boundary`; `loading` takes the forces
    """
    for line, words in card.table("nodes, a direction, a force"):
        if len(words) != 3 or words[1] not in ("1", "2", "3"):
            raise card.wrong("nodes, a direction 1, 2 or 3, a force", repr(line.text[:40]), line)
        nodes = _members(model.node_sets, card, line, words[0])
        value = scale * card.real(line, 2, "a force")
        loading.forces.append(AtNodes(nodes, int(words[1]) - 1, value, line.place))


def read_distributed(model: DeckModel, loading: Loading, card: Card, scale: float) -> None:
    """Read pressures ``elements, P1, value`` and weights ``elements, GRAV, g, nx, ny, nz``.

    Parameters
    ----------
    model, loading, card, scale : as in `read_boundary`; `loading` takes pressures and accelerations
    """
    for line, words in card.table("elements, P1 or GRAV, a value"):
        if len(words) < 3:
            raise card.wrong("elements, P1 or GRAV, a value", repr(line.text[:40]), line)
        if words[0] or words[1] != "GRAV":
            elements = _members(model.element_sets, card, line, words[0])
        else:  # gravity on all elements, which CalculiX does not offer
            elements = np.concatenate([NONE, *(one.labels for one in model.elements if one.type != "SPRINGA")])
        face = re.fullmatch(r"P([1-6])", words[1])
        if face is not None:
            if len(words) > 3:
                raise card.wrong("elements, P1, a pressure", repr(line.text[:40]), line)
            value = scale * card.real(line, 2, "a pressure")
            faces = Faces(elements, np.full(len(elements), int(face[1])))
            loading.pressures.append(FacePressure(faces, value, card.name, line.place))
        elif words[1] == "GRAV":
            direction = _direction_of_gravity(card, line, words)
            value = scale * card.real(line, 2, "an acceleration")
            loading.accelerations.append(Acceleration(elements, value, direction, line.place))
        else:
            raise card.refuse(f"the load {words[1][:40]} is not offered; P1 to P6 and GRAV are", line)


def _direction_of_gravity(card: Card, line: Line, words: list[str]) -> Vector:
    if not 4 <= len(words) <= 6:
        raise card.wrong("elements, GRAV, an acceleration and its direction", repr(line.text[:60]), line)
    direction = np.pad(card.numbers(line, words[3:], "a direction"), (0, 6 - len(words)))
    length = float(np.linalg.norm(direction))
    if not length > 0:
        raise card.wrong("a direction of gravity", "zeros", line)
    return np.asarray(direction / length)


def read_surface_load(model: DeckModel, loading: Loading, card: Card, scale: float) -> None:
    """Read pressures on surfaces: ``surface, P, value``.

    Parameters
    ----------
    model, loading, card, scale : as in `read_boundary`; `loading` takes the pressures
    """
    for line, words in card.table("a surface, P, a pressure"):
        if len(words) != 3 or words[1] != "P":
            raise card.wrong("a surface, P, a pressure", repr(line.text[:40]), line)
        surface = _find(model.surfaces, card, line, words[0], "surface")
        if surface.faces is None:
            raise card.wrong("a surface of faces", f"{surface.name}, of nodes", line)
        value = scale * card.real(line, 2, "a pressure")
        loading.pressures.append(FacePressure(surface.faces, value, card.name, line.place))


def read_equation(model: DeckModel, card: Card) -> None:
    """Read equations: the number of terms, then node, direction and coefficient of each, four terms a line."""
    lines = list(card.lines)
    if not lines:
        raise card.wrong("the number of terms", "no line of data")
    while lines:
        head = lines.pop(0)
        words = head.words
        if len(words) != 1 or not words[0].isdecimal() or not 1 <= int(words[0][:7]) <= 10**6:
            raise card.wrong("the number of terms", repr(head.text[:40]), head)
        count, terms, line = int(words[0]), list[str](), head
        while lines and len(terms) < 3 * count:
            line = lines.pop(0)
            terms += line.words
        if len(terms) != 3 * count:
            raise card.wrong(f"{count} terms of node, direction and coefficient", f"{len(terms)} numbers", line)
        nodes = np.array([card.label(line, word, "a node") for word in terms[::3]], dtype=np.int64)
        if any(word not in ("1", "2", "3") for word in terms[1::3]):
            raise card.wrong("directions 1, 2 or 3", repr(line.text[:60]), line)
        axes = np.array([int(word) - 1 for word in terms[1::3]], dtype=np.int64)
        coefficients = np.array([card.real_word(line, word, "coefficients") for word in terms[2::3]])
        if not coefficients.any():
            raise card.wrong("a coefficient other than zero", "zeros alone", line)
        model.equations.append(Equation(nodes, axes, coefficients, head.place))


def read_tie(model: DeckModel, card: Card) -> None:
    """Read a tie: slave and master surface."""
    line = card.only_line("a slave and a master surface")
    slave, master = _two_surfaces(card, line)
    tolerance = None
    if card.has("POSITION TOLERANCE"):
        tolerance = _positive(card, "POSITION TOLERANCE")
    model.ties.append(DeckTie(slave, master, tolerance, card.parameter("ADJUST", "YES") == "YES", card.head.place))


def read_pair(model: DeckModel, card: Card) -> None:
    """Read contact pairs: slave and master surface, the interaction between them, how they are discretised."""
    kind = " ".join(card.parameter("TYPE", "NODE TO SURFACE").split())
    named = {"".join(name.split()): name for name in ("NODE TO SURFACE", "SURFACE TO SURFACE", "MORTAR")}
    kind = named.get("".join(kind.split()), "MORTAR")
    if not card.has("TYPE"):
        model.ledger.assumed.append(f"{card.head.place}: *CONTACT PAIR: TYPE=NODE TO SURFACE, as nothing is stated")
    for line, _ in card.table("a slave and a master surface"):
        slave, master = _two_surfaces(card, line)
        adjust: float | Index | None = None
        if card.has("ADJUST"):
            stated = card.parameter("ADJUST")
            adjust = model.node_sets[stated] if stated in model.node_sets else _positive(card, "ADJUST", zero=True)
        pair = ContactPair(slave, master, card.parameter("INTERACTION"), kind, adjust, line.place)
        if any((one.slave, one.master) == (slave, master) for one in model.pairs):
            raise card.refuse(f"the pair {pair.name} stands twice; expected each once", line)
        model.pairs.append(pair)


def _two_surfaces(card: Card, line: Line) -> tuple[str, str]:
    words = line.words
    if len(words) != 2 or not all(words):
        raise card.wrong("a slave and a master surface", repr(line.text[:60]), line)
    return words[0], words[1]


def _positive(card: Card, name: str, *, zero: bool = False) -> float:
    value = parameter_number(card, name)
    if value < 0 or (value == 0 and not zero):
        raise card.wrong(f"{name}=... above zero", f"{value:g}")
    return value


def parameter_number(card: Card, name: str) -> float:
    """Return the number that a parameter has."""
    word = card.parameter(name)
    if DECIMAL_COMMA.fullmatch(word):
        raise card.wrong(f"{name}=NUMBER", repr(word))
    return card.real_word(card.head, word, f"{name}=NUMBER")


def read_interaction(model: DeckModel, card: Card) -> None:
    """Begin a surface interaction; the cards that follow define it."""
    name = card.parameter("NAME")
    if name in model.interactions:
        raise card.refuse(f"there is an interaction {name} already, at {model.interactions[name].place}")
    if len(card.lines) == 1 and len(card.lines[0].words) == 1:
        card.real(card.lines[0], 0, "a thickness")
        model.ledger.ignored.append(f"{card.lines[0].place}: *SURFACE INTERACTION: a thickness; sections state it")
    else:
        card.refuse_lines()
    model.interactions[name] = Interaction(name, card.head.place)


def read_behavior(model: DeckModel, card: Card) -> None:
    """Read the law of pressure over overlap, HARD or LINEAR with a stiffness, and the further numbers of CalculiX."""
    interaction = _interaction(model, card)
    interaction.stated = True
    if card.parameter("PRESSURE-OVERCLOSURE", "HARD") == "HARD":
        for line in card.lines:
            model.ledger.ignored.append(f"{line.place}: *SURFACE BEHAVIOR: numbers below HARD, which has none")
        return
    line = card.only_line("the stiffness of LINEAR")
    if len(line.words) > 3:
        raise card.wrong("a stiffness, a tension and a clearance", f"{len(line.words)} numbers", line)
    interaction.stiffness = card.real(line, 0, "the stiffness of LINEAR")
    if not interaction.stiffness > 0:
        raise card.wrong("a stiffness > 0", f"{interaction.stiffness:g}", line)
    for at, name in ((1, "tension"), (2, "clearance")):
        if len(line.words) > at and line.words[at]:
            value = card.real(line, at, f"a {name}")
            told = f"a {name} of {value:g}, by which CalculiX lets open contacts pull"
            model.ledger.ignored.append(f"{line.place}: *SURFACE BEHAVIOR: {told}")


def read_friction(model: DeckModel, card: Card) -> None:
    """Read the coefficient of friction, and the stick slope that CalculiX reads beside it."""
    interaction = _interaction(model, card)
    line = card.only_line("the coefficient of friction")
    interaction.friction = card.real(line, 0, "the coefficient of friction")
    if interaction.friction < 0:
        raise card.wrong("a coefficient of friction >= 0", f"{interaction.friction:g}", line)
    if len(line.words) > 1 and line.words[1]:
        interaction.stick = card.real(line, 1, "the stick slope")
    if len(line.words) > 2:
        raise card.wrong("a coefficient of friction and a stick slope", f"{len(line.words)} numbers", line)


def _interaction(model: DeckModel, card: Card) -> Interaction:
    if not model.interactions:
        raise card.refuse("it belongs to a surface interaction; expected *SURFACE INTERACTION before it")
    return list(model.interactions.values())[-1]


def read_clearance(model: DeckModel, card: Card) -> None:
    """Read the initial gap that replaces the distances of the mesh."""
    card.refuse_lines()
    pair = card.parameter("SLAVE"), card.parameter("MASTER")
    model.clearances = {**model.clearances, pair: parameter_number(card, "VALUE")}
