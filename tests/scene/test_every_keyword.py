"""Decks that between them have every keyword, parameter and element that the reader knows, each with its answer.

Two cubes of E = 1000 and no contraction stand 0.01 apart, the lower one held below; a force F on the upper one goes
through both, and pushing its top down by 0.02 takes (0.02 - 0.01) / (2 / 1000) = 5.
"""

from __future__ import annotations

import pathlib
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest

import contactqp as cq
from benchmarks.decks import reworded
from contactqp.exchange.deck.cards import KEYWORDS, Card, Effect, read_cards, squeezed
from contactqp.exchange.deck.model import ELEMENT_NODES, OTHER_ELEMENTS
from contactqp.exchange.deck.reading import read_deck_model
from tests.decks import ASSEMBLED, STACK, Deck, lame_force, write

PUSHED = "*BOUNDARY\nTOP, 3, 3, -0.02\n"
PAIR = "*CONTACT PAIR, INTERACTION=TOUCH, TYPE=NODE TO SURFACE"
HELD = "*BOUNDARY\nBOTTOM, 1, 3\nALL, 1, 2\n"
BEHAVIOUR = "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR\n1e4\n"
# The nodes of the top move up and down as one.
STIFF_TOP = "*EQUATION\n" + "".join(f"2\n{node}, 3, 1., 15, 3, -1.\n" for node in (16, 17, 18))
SECOND = "*END STEP\n*STEP\n*STATIC\n"


@dataclass(frozen=True)
class Stated:
    """A deck and its answer: the sums of contact forces, of ties and along the surface, and displacements by name."""

    text: str
    force: float | None = None
    friction: float | None = None
    tie: float | None = None
    at: dict[str, float] | None = None
    told: Sequence[str] = ()  # words of the ledger
    off: float = 1e-9
    enforcement: str = "exact"


def cubes(*changes: tuple[str, str]) -> str:
    """Return the deck of two cubes with some words in the place of others."""
    text = STACK
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    return text


def loaded(cards: str, before: str = STIFF_TOP, *changes: tuple[str, str]) -> str:
    """Return the deck of two cubes with other loads and cards before the step."""
    return cubes((PUSHED, cards), ("*STEP\n", f"{before}*STEP\n"), *changes)


def pressed(kind: str) -> str:
    """Return the deck of two bodies of one type of elements, one on the other, under a pressure of 3."""
    model, reduced = kind[:3], kind.endswith("R")
    nodes = kind[3:].rstrip("R")
    deck = Deck(model)
    for name, height in (("UP", 1.0), ("LOW", 0.0)):
        if model == "C3D":
            shape = {"4": "tet4", "8": "hex8", "10": "tet10", "20": "hex20"}[nodes]
            mesh = cq.box((1.0, 1.0, 1.0), (2, 2, 1), shape, corner=(0.0, 0.0, height))
        else:
            shape = {"3": "tri3", "4": "quad4", "6": "tri6", "8": "quad8"}[nodes]
            square = cq.rectangle(1.0, 1.0, (2, 1), shape)
            mesh = square.mapped(lambda x, height=height: x + np.array([3.0, height]))
        deck.body(name, mesh, section="0.5" if model in ("CPE", "CPS") else "")
    for name, body, side in (("SLAVE", "UP", "bottom"), ("MASTER", "LOW", "top"), ("ROOF", "UP", "top")):
        deck.surface(name, body, side)
    deck.nset("TOP", "UP", "top")
    deck.nset("BOTTOM", "LOW", "bottom")
    deck.pair("NODE TO SURFACE", "HARD")
    deck.lines += ["*BOUNDARY", "BOTTOM, 1, 3", "TOP, 1", *(["TOP, 2"] if model == "C3D" else [])]
    deck.step += ["*DSLOAD", "ROOF, P, 3."]
    return deck.text().replace(f"TYPE={kind[: len(kind) - reduced]},", f"TYPE={kind},")


AREA = {"C3D": 1.0, "CPE": 0.5, "CPS": 0.5, "CAX": np.pi * (4**2 - 3**2)}
SOLIDS = [kind for kind in ELEMENT_NODES if kind[:3] in AREA]


def beside(element: str, section: str) -> str:
    """Return the deck of two cubes, pressed by 20, whose top hangs on a bar or a spring of stiffness 1000 too."""
    node = "99, 0., 0., 3.01\n"
    text = loaded("*CLOAD\n15, 3, -20.\n", f"{STIFF_TOP}*ELEMENT, TYPE={element}, ELSET=LINK\n9, 15, 99\n{section}")
    return text.replace("18, 0., 1., 2.01\n", f"18, 0., 1., 2.01\n{node}").replace(HELD, f"{HELD}99, 1, 3\n")


def flat_bars() -> str:
    """Return the deck of two squares of thickness 1 with a bar beside, as `beside` has it in space."""
    nodes = "".join(f"{n}, {x}, {y}\n" for n, x, y in (
        (1, 0, 0), (2, 1, 0), (3, 1, 1), (4, 0, 1), (11, 0, 1.01), (12, 1, 1.01), (13, 1, 2.01), (14, 0, 2.01),
        (99, 0, 3.01)))  # fmt: skip
    return (
        f"*NODE, NSET=ALL\n{nodes}*ELEMENT, TYPE=CPS4, ELSET=SOLID\n1, 1, 2, 3, 4\n2, 11, 12, 13, 14\n"
        "*ELEMENT, TYPE=T2D2, ELSET=BAR\n9, 14, 99\n*MATERIAL, NAME=STEEL\n*ELASTIC\n1000., 0.\n"
        "*SOLID SECTION, ELSET=SOLID, MATERIAL=STEEL\n1.\n*SOLID SECTION, ELSET=BAR, MATERIAL=STEEL\n1.\n"
        "*SURFACE, NAME=BELOW\n1, S3\n*SURFACE, NAME=ABOVE\n2, S1\n*SURFACE INTERACTION, NAME=TOUCH\n"
        f"*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=HARD\n{PAIR}\nABOVE, BELOW\n*EQUATION\n2\n13, 2, 1., 14, 2, -1.\n"
        "*BOUNDARY\n1, ENCASTRE\n2, ENCASTRE\n99, PINNED\nALL, 1\n*STEP\n*STATIC\n*CLOAD\n14, 2, -20.\n*END STEP\n"
    )


def press_fit() -> str:
    """Return the deck of a hub on a hollow shaft, 0.01 too thick, axisymmetric, held along the axis."""
    deck = Deck("CAX")
    for name, inner, outer in (("HUB", 20.0, 40.0), ("SHAFT", 5.0, 20.01)):
        ring = cq.rectangle(outer - inner, 1.0, (8, 1), "quad8")
        deck.body(name, ring.mapped(lambda x, inner=inner: x + np.array([inner, 0.0])))
    deck.surface("SLAVE", "HUB", "left")
    deck.surface("MASTER", "SHAFT", "right")
    deck.pair("SURFACE TO SURFACE", "HARD")
    deck.lines += ["*BOUNDARY", "HUB, 2", "SHAFT, 2"]
    return deck.text()


def rubbing(*steps: str) -> str:
    """Return the deck of two cubes with friction, the top pressed by 8 and moved along x in steps, without a turn."""
    wide = "".join(f"{n}, {3 * x - 1}., {3 * y - 1}., {z}.\n" for n, (x, y, z) in enumerate(
        [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)], 1))  # fmt: skip
    narrow = STACK.partition("*NODE, NSET=ALL\n")[2].partition("11, ")[0]
    first = f"*CLOAD\n15, 3, -8.\n*BOUNDARY\n{steps[0]}\n"
    more = "".join(f"{SECOND}*BOUNDARY\n{step}\n" for step in steps[1:])
    friction = f"{BEHAVIOUR}*FRICTION, SLIP TOLERANCE=0.005, ELASTIC SLIP=1e-6\n0.2, 1e5\n"
    return loaded(first + more, STIFF_TOP, (narrow, wide), (BEHAVIOUR, friction), ("ALL, 1, 2\n", "ALL, 2\n"))


SOLVED = {
    "as it is": Stated(STACK, 5.0, at={"5.z": -0.005, "11.z": -0.015}),
    "springs in the place of contact": Stated(STACK, 0.01 / (2 / 1000 + 1 / 1e4), enforcement="penalty"),
    "coordinates are rectangular": Stated(cubes(("*NODE, NSET=ALL", "*NODE, NSET=ALL, SYSTEM=R")), 5.0),
    "isotropic in short": Stated(cubes(("*ELASTIC", "*ELASTIC, TYPE=ISO")), 5.0),
    "isotropic in full": Stated(cubes(("*ELASTIC", "*ELASTIC, TYPE=ISOTROPIC")), 5.0),
    "sets of sets, in any order": Stated(
        cubes(("*NSET, NSET=BOTTOM", "*NSET, NSET=BOTTOM, UNSORTED, INTERNAL"),
              ("*MATERIAL,", "*ELSET, ELSET=SOLID, GENERATE, UNSORTED\n1, 2\n*MATERIAL,"),
              ("*MATERIAL,", "*ELSET, ELSET=UPPER, INTERNAL\n2\n*MATERIAL,"),
              ("2, S1", "UPPER, S1")),
        5.0, told=["*NSET: UNSORTED, INTERNAL"]),
    "nodes of elements": Stated(
        loaded("*CLOAD\nWHOLE, 3, -1.\n", "",
               ("*MATERIAL,", "*ELSET, ELSET=UPPER\n2\n*NSET, NSET=WHOLE, ELSET=UPPER\n*MATERIAL,")),
        8.0),
    "a file of its own": Stated("*INCLUDE, INPUT=stack.inp\n", 5.0),
    "parts and instances": Stated(ASSEMBLED, 5.5, told=["*INSTANCE UP-1: 10 added to labels"]),
    "surfaces by name and kind": Stated(
        cubes(("*SURFACE, NAME=BELOW", "*SURFACE, NAME=BELOW, TYPE=ELEMENT, INTERNAL"),
              ("*SURFACE, NAME=ABOVE\n2, S1", "*SURFACE, NAME=ABOVE, TYPE=NODE\n11\n12\n13\n14")),
        5.0, told=["*SURFACE: INTERNAL"]),
    "the weight of a density": Stated(loaded("*DLOAD\nSOLID, GRAV, 10., 0., 0., -1.\n", ""), 20.0),
    "a section with words": Stated(
        cubes(("ELSET=SOLID, MATERIAL=STEEL", "ELSET=SOLID, MATERIAL=STEEL, ORIENTATION=O, CONTROLS=C")), 5.0,
        told=["*SOLID SECTION: ORIENTATION, CONTROLS"]),
    "a spring beside": Stated(beside("SPRINGA", "*SPRING, ELSET=LINK\n\n1000.\n"), 10 / 3, at={"15.z": -5 / 300}),
    "a truss beside": Stated(beside("T3D2", "*SOLID SECTION, ELSET=LINK, MATERIAL=STEEL\n1.\n"), 10 / 3),
    "a truss in the plane": Stated(flat_bars(), 10 / 3, at={"14.y": -5 / 300}),
    "supports in words": Stated(
        cubes((HELD, "*BOUNDARY, TYPE=DISPLACEMENT, LOAD CASE=1\nBOTTOM, PINNED\nALL, XSYMM\nALL, YSYMM\n")), 5.0,
        told=["*BOUNDARY: LOAD CASE"]),
    "supports in other words": Stated(
        cubes((HELD, "*BOUNDARY\nBOTTOM, ZSYMM\nALL, ZASYMM\nBOTTOM, XASYMM\nBOTTOM, YASYMM\n")), 5.0),
    "supports of a second step": Stated(
        cubes((PUSHED, f"{PUSHED}{SECOND}*BOUNDARY, OP=NEW\nBOTTOM, 1, 3\nALL, 1, 2\n15, 3, 3, -0.03\n"),
              ("*STEP", f"{STIFF_TOP}*STEP")), 10.0),
    "supports that stay": Stated(cubes((PUSHED, f"{PUSHED}{SECOND}*BOUNDARY, OP=MOD\n")) .replace(
        "OP=MOD\n", "OP=MOD\nTOP, 3, 3, -0.03\n"), 10.0),
    "a support that follows an amplitude": Stated(
        loaded(PUSHED.replace("*BOUNDARY", "*BOUNDARY, AMPLITUDE=UP"),
               "*AMPLITUDE, NAME=UP, DEFINITION=TABULAR, VALUE=RELATIVE, TIME=STEP TIME, SMOOTH=0.1\n0., 0., 2., 4.\n"),
        15.0, told=["*AMPLITUDE: SMOOTH"]),
    "forces that follow an amplitude": Stated(
        loaded("*CLOAD, OP=MOD, AMPLITUDE=UP, LOAD CASE=1\n15, 3, -4.\n",
               f"{STIFF_TOP}*AMPLITUDE, NAME=UP, TIME=TOTAL TIME\n0., 0., 2., 4.\n"),
        8.0, told=["*CLOAD: LOAD CASE"]),
    "forces that are taken away": Stated(
        loaded(f"*CLOAD\n15, 3, -4.\n{SECOND}*CLOAD, OP=NEW\n16, 3, -7.\n"), 7.0),
    "pressures that are taken away": Stated(
        loaded(f"*DLOAD, OP=MOD, LOAD CASE=1\n2, P2, 4.\n{SECOND}*DLOAD, OP=NEW\n2, P2, 9.\n"), 9.0,
        told=["*DLOAD: LOAD CASE"]),
    "a pressure that follows an amplitude": Stated(
        loaded("*DLOAD, AMPLITUDE=UP\n2, P2, 4.\n", f"{STIFF_TOP}*AMPLITUDE, NAME=UP\n0., 0., 1., 3.\n"), 12.0),
    "pressures on surfaces": Stated(
        loaded(f"*DSLOAD, OP=MOD, LOAD CASE=1\nROOF, P, 4.\n{SECOND}*DSLOAD, OP=NEW, AMPLITUDE=UP\nROOF, P, 3.\n",
               f"{STIFF_TOP}*SURFACE, NAME=ROOF\n2, S2\n*AMPLITUDE, NAME=UP\n0., 0., 1., 2.\n"),
        6.0, told=["*DSLOAD: LOAD CASE"]),
    "equations": Stated(loaded("*BOUNDARY\n15, 3, 3, -0.02\n"), 5.0),
    "a tie of what is near": Stated(
        cubes((PAIR, "*TIE, NAME=T, POSITION TOLERANCE=0.02, ADJUST=NO, TYPE=SURFACE TO SURFACE")), tie=10.0),
    "a tie of what is moved": Stated(
        cubes((PAIR, "*TIE, NAME=T, POSITION TOLERANCE=0.02, ADJUST=YES, TYPE=NODE TO SURFACE")),
        tie=0.02 / (1 / 1000 + 1.01 / 1000), told=["4 slave nodes moved"]),
    "contact of faces": Stated(
        cubes((PAIR, f"{PAIR.replace('NODE', 'SURFACE')}, SMALL SLIDING, NO THICKNESS, EXTENSION ZONE=0.1")),
        5.0, told=["SMALL SLIDING, NO THICKNESS, EXTENSION ZONE", "no overlap at slave nodes"]),
    "contact by mortar": Stated(cubes((PAIR, PAIR.replace("NODE TO SURFACE", "MORTAR"))), 5.0),
    "contact by linear mortar": Stated(cubes((PAIR, PAIR.replace("NODE TO SURFACE", "LINMORTAR"))), 5.0),
    "slave nodes within a distance are moved": Stated(
        cubes((PAIR, f"{PAIR}, ADJUST=0.02")), 0.02 / (1 / 1000 + 1.01 / 1000), told=["4 slave nodes moved"]),
    "slave nodes of a set are moved": Stated(
        cubes((PAIR, f"{PAIR}, ADJUST=SOLE"), ("*MATERIAL,", "*NSET, NSET=SOLE\n11, 12, 13, 14\n*MATERIAL,")),
        0.02 / (1 / 1000 + 1.01 / 1000)),
    "hard contact by penalty": Stated(
        cubes((BEHAVIOUR, "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=HARD, PENALTY\n")), 0.01 / (2 / 1000 + 1 / 5e4),
        enforcement="penalty",
        told=["*SURFACE BEHAVIOR: PENALTY", "HARD as LINEAR with 50000, 50 times Young's modulus"]),
    "hard contact by other means": Stated(
        cubes((BEHAVIOUR, "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=HARD, DIRECT, AUGMENTED LAGRANGE\n")), 5.0,
        told=["*SURFACE BEHAVIOR: DIRECT, AUGMENTED LAGRANGE"]),
    "a clearance": Stated(
        cubes((HELD, f"*CLEARANCE, MASTER=BELOW, SLAVE=ABOVE, VALUE=-0.01\n{HELD}")), 15.0),
    "friction that slips": Stated(rubbing("TOP, 1, 1, 0.1"), 8.0, 1.6,
                                  told=["*FRICTION: SLIP TOLERANCE, ELASTIC SLIP"]),
    "friction that slips back": Stated(rubbing("TOP, 1, 1, 0.1", "TOP, 1, 1, -0.1"), 8.0, -1.6,
                                       told=["friction is followed step by step, each of the 2 one increment"]),
    "a step with words": Stated(
        cubes(("*STEP", "*STEP, NLGEOM=NO, INC=9, INCF=9, NAME=S, AMPLITUDE=RAMP, UNSYMM=NO, "
                        "EXTRAPOLATION=NO, CONVERT SDI=YES"),
              ("*STATIC", "*STATIC, SOLVER=SPOOLES, DIRECT, TIME RESET, TOTAL TIME AT START=0., ELECTROMAGNETICS=NO")),
        5.0, told=["*STEP: INC, INCF, NAME, AMPLITUDE, UNSYMM, EXTRAPOLATION, CONVERT SDI",
                   "*STATIC: SOLVER, DIRECT, TIME RESET, TOTAL TIME AT START, ELECTROMAGNETICS"]),
    "a step without large displacements": Stated(cubes(("*STEP", "*STEP, NLGEOM=OFF")), 5.0),
    "a press fit": Stated(press_fit(), lame_force() * 4 / 4.0 / 1.0, off=2e-3),
    **{f"a pressure on {kind}": Stated(pressed(kind), 3 * AREA[kind[:3]]) for kind in SOLIDS},
}  # fmt: skip


@pytest.fixture
def folder(tmp_path: pathlib.Path) -> pathlib.Path:
    write(tmp_path, STACK, "stack.inp")
    return tmp_path


@pytest.mark.sampled(36)
@pytest.mark.parametrize("name", SOLVED)
def test_a_deck_has_its_answer(folder: pathlib.Path, name: str) -> None:
    stated = SOLVED[name]
    deck = cq.read_deck(write(folder, stated.text))
    solution = cq.solve(deck.problem(stated.enforcement))
    assert solution.certificate.passed
    for sum_, right in ((solution.normal_force, stated.force), (solution.tie_force, stated.tie)):
        if right is not None:
            assert abs(sum_.sum()) == pytest.approx(right, rel=stated.off)
    if stated.friction is not None:
        assert solution.friction_force[:, 0].sum() == pytest.approx(stated.friction, rel=stated.off)
    for unknown, right in (stated.at or {}).items():
        assert solution.at(unknown) == pytest.approx(right, rel=stated.off)
    lines = [line for _, line in deck.ledger]
    for words in stated.told:
        assert any(words in line for line in lines), (words, lines)
    for card in cards_of(folder):  # nothing in silence
        idle = [card.keyword.names[key] for key in card.parameters if card.keyword.parameters.get(key) == "idle"]
        assert not idle or f"{card.head.place}: {card.name}: {', '.join(idle)}" in deck.ledger.ignored


def cards_of(folder: pathlib.Path) -> list[Card]:
    return read_cards(folder / "model.inp")


def test_the_decks_have_all_that_is_read(folder: pathlib.Path) -> None:
    found: dict[str, dict[str, set[str]]] = {}
    for stated in SOLVED.values():
        write(folder, stated.text)
        for card in cards_of(folder):
            for key, value in (card.parameters or {"": ""}).items():
                found.setdefault(card.keyword.name, {}).setdefault(key, set()).add(squeezed(value))
    assert any("*INCLUDE" in stated.text for stated in SOLVED.values())  # the one that is no card
    for keyword in (one for one in KEYWORDS.values() if one.effect is Effect.READ):
        assert keyword.name in found, keyword.name
        for key, offered in keyword.parameters.items():
            if offered != "refused":
                assert key in found[keyword.name], (keyword.name, key)
            if offered not in (None, "idle", "refused"):
                values = {squeezed(value) for value in offered.split("|")}
                assert found[keyword.name][key] == values, (keyword.name, key)
    assert found["ELEMENT"]["TYPE"] == set(ELEMENT_NODES)


def refusal(folder: pathlib.Path, lines: Sequence[str]) -> str:
    with pytest.raises(cq.InvalidProblem) as caught:
        read_deck_model(write(folder, "\n".join(lines)))
    return str(caught.value)


def with_keyword(name: str) -> tuple[list[str], int]:
    """Return the lines of the first deck that has a keyword, and the line that it stands on."""
    for stated in SOLVED.values():
        lines = stated.text.splitlines()
        at = next((i for i, line in enumerate(lines) if squeezed(line.split(",")[0]) == f"*{squeezed(name)}"), None)
        if at is not None:
            return lines, at
    raise AssertionError(name)


def test_every_parameter_that_is_not_offered_is_refused_by_its_line(folder: pathlib.Path) -> None:
    count = 0
    for keyword in (one for one in KEYWORDS.values() if one.effect is Effect.READ):
        lines, at = with_keyword(keyword.name)
        place = f"model.inp: line {at + 1}: *{keyword.name}: "
        for key, offered in keyword.parameters.items():
            name = keyword.names[key]
            if offered == "refused":
                said = refusal(folder, [*lines[:at], f"{lines[at]}, {name}=1", *lines[at + 1 :]])
                assert f"{place}{name} is not offered{keyword.cure(key)}" in said
            elif offered not in (None, "idle"):
                bare = re.sub(rf",\s*{re.escape(name)}=[^,]*", "", lines[at], flags=re.IGNORECASE)
                said = refusal(folder, [*lines[:at], f"{bare}, {name}=ODD", *lines[at + 1 :]])
                assert f"{place}expected {name}={' or '.join(offered.split('|'))}, got 'ODD'" in said
            else:
                continue
            count += 1
        said = refusal(folder, [*lines[:at], f"{lines[at]}, ODDEST=1", *lines[at + 1 :]])
        assert f"*{keyword.name} has no parameter ODDEST; " in said
    assert count > 90


def test_every_other_element_is_refused_by_its_line(folder: pathlib.Path) -> None:
    assert len(OTHER_ELEMENTS) > 5
    for kind, why in OTHER_ELEMENTS.items():
        said = refusal(folder, STACK.replace("TYPE=C3D8,", f"TYPE={kind},").splitlines())
        assert f"line 20: *ELEMENT: elements {kind}: {why}" in said


def test_a_misspelled_keyword_is_answered_with_the_nearest(folder: pathlib.Path) -> None:
    read = [one for one in KEYWORDS.values() if one.effect is Effect.READ and len(one.name) > 4]
    assert len(read) > 20
    for keyword in read:
        lines, at = with_keyword(keyword.name)
        wrong = lines[at].upper().replace(keyword.name, keyword.name[:-2] + keyword.name[-1], 1)
        said = refusal(folder, [*lines[:at], wrong, *lines[at + 1 :]])
        assert f"model.inp: line {at + 1}: there is no keyword " in said
        assert "the nearest one is *" in said


@pytest.mark.slow
@pytest.mark.parametrize(("first", "count"), [(0, 40), pytest.param(40, 2000, marks=pytest.mark.slow)])
def test_decks_in_other_words_are_solved_or_refused_in_one_line(folder: pathlib.Path, first: int, count: int) -> None:
    """Words in the place of others, lines and cards that are missing, stand twice or elsewhere, other numbers."""
    decks, said = list(SOLVED.values()), []
    for number in range(first, first + count):
        random = np.random.default_rng([28, number])
        change = reworded if number % 2 else rearranged
        file = write(folder, change(decks[number % len(decks)].text, random))
        try:
            cq.solve(cq.read_deck(file).problem())
        except cq.InvalidProblem as error:
            said.append(str(error))
        except (cq.NoEquilibrium, cq.NotConverged, cq.NotCertified, cq.SeveralEquilibria, cq.Unsupported):
            continue
    assert not [line for line in said if "\n" in line or not 0 < len(line) < 1000]
    assert count / 2 < len(said) < count * 19 / 20


def rearranged(text: str, random: np.random.Generator) -> str:
    """Leave out a line, write it twice, exchange two cards, or change a number by a factor."""
    lines, cards = text.splitlines(keepends=True), re.split(r"(?m)^(?=\*)", text)
    spots = list(re.finditer(r"-?\d+\.\d*(?:e[-+]?\d+)?", text))
    how = int(random.integers(0, 4))
    if how == 0 and spots:
        spot = spots[int(random.integers(len(spots)))]
        value = float(spot[0]) * random.choice([-1, 0, 0.5, 2, 1 + 1e-9, 1e3, 1e-3, 1e8]) + random.choice([0, 0.01])
        return f"{text[: spot.start()]}{float(value)!r}{text[spot.end() :]}"
    at = int(random.integers(len(lines)))
    if how < 3:
        return "".join([*lines[:at], *([lines[at]] * (2 if how == 1 else 0)), *lines[at + 1 :]])
    one, other = random.integers(0, len(cards), 2).tolist()
    cards[one], cards[other] = cards[other], cards[one]
    return "".join(cards)
