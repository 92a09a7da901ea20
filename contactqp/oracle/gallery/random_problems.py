"""Generate random gallery problems with and without friction: an answer is chosen, then its load and gaps.

With integers for K, E, A and small dyadic fractions for u*, l* and the gaps, f = K u* + E'l* + A'nu* and
g = E u* + gap* are doubles, and (u*, l*, nu*) satisfies all conditions exactly.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import ceil
from typing import TypeVar

from contactqp.oracle.gallery.problem import (
    Contents,
    ExactProblem,
    Numbers,
    Row,
    Rows,
    clean,
    dominance,
    exact_answer,
    largest_row_sum,
    plus,
    times,
    transposed_times,
    with_uniqueness,
)

T = TypeVar("T")
Node = tuple[int, int]
# The offsets of the later neighbours of a lattice node.
AFTER = ((1, 0), (0, 1), (1, 1), (-1, 1))


class Draw:
    """Random integers that depend only on a name, the same on every platform and in every version of Python.

    Python guarantees this only for `random()`.
    """

    def __init__(self, name: str) -> None:
        self._random = random.Random(name).random

    def integer(self, low: int, high: int) -> int:
        """Return a random integer from low to high, inclusive."""
        return low + int(self._random() * (high - low + 1))

    def among(self, values: Sequence[T]) -> T:
        return values[self.integer(0, len(values) - 1)]

    def some(self, values: Sequence[T], count: int) -> list[T]:
        """Return `count` different random items in their order."""
        left = list(range(len(values)))
        taken = [left.pop(self.integer(0, len(left) - 1)) for _ in range(min(count, len(left)))]
        return [values[i] for i in sorted(taken)]


class Springs:
    """A stiffness (n, n) assembled from springs: K += k t't for a row t of integers."""

    def __init__(self, unknowns: int) -> None:
        self._rows: list[dict[int, Fraction]] = [{} for _ in range(unknowns)]

    def add(self, stiffness: int | Fraction, row: dict[int, int]) -> None:
        for i, x in row.items():
            for j, y in row.items():
                self._rows[i][j] = self._rows[i].get(j, Fraction(0)) + stiffness * x * y

    def rows(self) -> Rows:
        return clean(self._rows)


def lattice(springs: Springs, columns: int, rows: int, stiffness: Callable[[], int | Fraction], first: int = 0) -> None:
    """Add springs between neighbours of a plane grid, also along diagonals, so that only rigid motions have no strain.

    Node (i, j) has the unknowns 2 a and 2 a + 1, x and z, a = first + j columns + i.

    Parameters
    ----------
    springs : takes them
    columns, rows : numbers of nodes
    stiffness : function, returns the stiffness of the next spring [force / length]
    first : the number of node (0, 0)
    """
    for j in range(rows):
        for i in range(columns):
            for dx, dz in AFTER:
                if 0 <= i + dx < columns and j + dz < rows:
                    a, b = first + j * columns + i, first + (j + dz) * columns + i + dx
                    row = {2 * a: dx, 2 * a + 1: dz, 2 * b: -dx, 2 * b + 1: -dz}
                    springs.add(stiffness(), {k: x for k, x in row.items() if x})


# Random gallery problems with Coulomb friction, in the plane and in space, stuck, sliding and open.
#
# Each contact has a frame of orthogonal rows of integers of equal length, along which its node moves, so that slips,
# their sizes and forces are rational. Friction is below a bound that proves uniqueness of the answer.

# Numbers of nodes with and without contact.
FRICTIONAL_SIZES = {"easy": (1, 1), "moderate": (5, 4), "hard": (20, 16)}
Frame = tuple[tuple[int, ...], ...]  # normal and tangents

PLANE: tuple[Frame, ...] = (((0, -1), (1, 0)), ((3, -4), (4, 3)), ((-3, -4), (4, -3)))
SPACE: tuple[Frame, ...] = (
    ((0, 0, -1), (1, 0, 0), (0, 1, 0)),
    ((-1, 0, 0), (0, 1, 0), (0, 0, 1)),
    ((1, 2, -2), (2, 1, 2), (2, -2, -1)),
    ((2, -1, -2), (2, 2, 1), (1, -2, 2)),
)
DIRECTIONS: dict[int, tuple[tuple[int, ...], ...]] = {
    2: ((1,), (-1,)),
    3: ((3, 4), (-4, 3), (-3, -4), (4, -3), (5, 0), (0, -5)),
}  # all of equal length, 1 in the plane and 5 in space
FRICTIONAL_CONSTRUCTION = "f = K u* + E_N'l_N + E_T'l_T, g = E_N u* + gap*, l_T = mu l_N s/|s| where it slides"


@dataclass(frozen=True)
class _Touch:
    """The chosen answer of one contact."""

    frame: Frame
    state: str
    approach: Fraction  # along the normal, in lengths of the frame
    slip: Numbers  # (d-1,), likewise along the tangents
    pressed: Fraction  # l_N
    drag: Numbers  # (d-1,) l_T
    gap: Fraction

    def motion(self, axis: int) -> Fraction:
        """Return the node's displacement along an axis, without tangential part if it sticks."""
        return self.approach * self.frame[0][axis] + sum(
            (s * row[axis] for s, row in zip(self.slip, self.frame[1:], strict=True)), Fraction(0)
        )


def frictional(draw: Draw, difficulty: str) -> Contents:
    """Return a network of springs whose nodes stick to, slide on or are above rough obstacles."""
    dimension = draw.integer(2, 3)
    touching, others = FRICTIONAL_SIZES[difficulty]
    n = dimension * (touching + others)
    stiffness = _network(draw, n)
    # The largest multiple of 1/16 below the bound of `below_critical_friction`.
    friction = Fraction(ceil(16 * dominance(stiffness) / largest_row_sum(stiffness)) - 1, 16)
    # Of three neighbours one slides, one sticks and one is open; a single contact touches.
    states = ["slip", "stick", "open"] if touching > 1 else [draw.among(("slip", "stick"))]
    touches = [
        _touch(draw, dimension, states[i % len(states)], friction, difficulty != "easy") for i in range(touching)
    ]
    u = [touch.motion(axis) for touch in touches for axis in range(dimension)]
    u += [Fraction(draw.integer(-32, 32), 16) for _ in range(dimension * others)]
    rows = [
        clean({dimension * node + axis: x for axis, x in enumerate(row)} for row in touch.frame)
        for node, touch in enumerate(touches)
    ]
    normal, tangent = tuple(row[0] for row in rows), tuple(row for frame in rows for row in frame[1:])
    force, drag = tuple(touch.pressed for touch in touches), [touch.drag for touch in touches]
    load = plus(
        times(stiffness, u),
        transposed_times(normal, force, n),
        transposed_times(tangent, [x for row in drag for x in row], n),
    )
    gap = plus(times(normal, u), [touch.gap for touch in touches])
    origin = (Fraction(0),) * len(tangent)
    data = ExactProblem(stiffness, load, normal, gap, tangent, (friction,) * touching, origin)
    answer = exact_answer(data, tuple(u), force, drag)
    found = ", ".join(sorted(set(answer.contact_status)))
    text = f"A network of springs in {dimension}D on rough obstacles, mu = {friction}: {found}; slip starts at zero."
    return with_uniqueness(data, answer, text, "made for this gallery", FRICTIONAL_CONSTRUCTION, {})


def _touch(draw: Draw, dimension: int, state: str, friction: Fraction, turned: bool) -> _Touch:
    frames: tuple[Frame, ...] = PLANE if dimension == 2 else SPACE
    frame = draw.among(frames) if turned else frames[0]
    direction, length = draw.among(DIRECTIONS[dimension]), {2: 1, 3: 5}[dimension]
    way = Fraction(draw.integer(1, 8), 16) if state != "stick" else Fraction(0)
    pressed = Fraction(5 * draw.integer(1, 32), 4) if state != "open" else Fraction(0)
    share = Fraction(1) if state == "slip" else Fraction(draw.integer(0, 15), 16)
    return _Touch(
        frame,
        state,
        approach=Fraction(draw.integer(-16, 16), 16),
        slip=tuple(way * x for x in direction),
        pressed=pressed,
        drag=tuple(share * friction * pressed * x / length for x in direction),
        gap=Fraction(draw.integer(1, 32), 16) if state == "open" else Fraction(0),
    )


def _network(draw: Draw, n: int) -> tuple[Row, ...]:
    """Return a diagonally dominant stiffness that couples every unknown with a few others."""
    springs = Springs(n)
    sums = [0] * n
    for i in range(n):
        for j in sorted({draw.integer(0, n - 1) for _ in range(3)} - {i}):
            k = draw.integer(1, 8)
            springs.add(k, {i: 1, j: draw.among((-1, 1))})
            sums[i] += k
            sums[j] += k
    for i in range(n):
        springs.add(2 * max(sums) - sums[i] + draw.integer(1, 8), {i: 1})
    return springs.rows()


# Columns and rows of the lattice, whose lowest row has the contacts.
SIZES = {"easy": (2, 2), "moderate": (5, 3), "hard": (12, 4)}
LARGE = {"easy": 12, "moderate": 20, "hard": 30}  # nodes along a side of the membrane
CONTRAST = {"easy": 20, "moderate": 30, "hard": 40}  # powers of two
FLOORS = ((0, -1), (3, -4), (-3, -4), (1, -2))  # possible rows of the obstacle, not of unit length
BY_CONSTRUCTION = "f = K u* + E'l* + A'nu*, g = E u* + gap* for a chosen answer"


def well_posed(draw: Draw, difficulty: str) -> Contents:
    """Return a lattice supported from above, some of whose nodes touch a floor."""
    columns, _ = SIZES[difficulty]
    states = _states(draw, columns, closed=(columns + 1) // 2)
    text = "A lattice of springs, held at its upper nodes, over a floor; the closed rows are independent."
    return _on_floor(draw, difficulty, states, text)


def degenerate(draw: Draw, difficulty: str) -> Contents:
    """Return the same with grazing contacts."""
    columns, _ = SIZES[difficulty]
    grazing = max(1, columns // 3)
    states = _states(draw, columns, closed=(columns - grazing + 1) // 2, grazing=grazing)
    text = f"A lattice of springs over a floor; {grazing} of its contacts graze: gap and force are both exactly zero."
    return _on_floor(draw, difficulty, states, text)


def redundant(draw: Draw, difficulty: str) -> Contents:
    """Return the same with redundant contacts."""
    columns, _ = SIZES[difficulty]
    states = _states(draw, columns, closed=max(1, columns // 2))
    text = "A lattice of springs over a floor; closed rows are repeated, scaled and added up: forces are not unique."
    # In easy problems there are more closed rows than unknowns.
    return _on_floor(draw, difficulty, states, text, repeats=10 - columns if difficulty == "easy" else columns)


def stiff(draw: Draw, difficulty: str) -> Contents:
    """Return the same with some very stiff springs.

    In doubles the answer has an error of about 1e-9; plain elimination has a larger one, growing with the stiffness.
    """
    columns, _ = SIZES[difficulty]
    power = CONTRAST[difficulty]
    text = (
        f"A lattice of springs over a floor; stiffnesses differ by up to 2^{power}, stiff springs are hardly strained."
    )
    return _on_floor(draw, difficulty, _states(draw, columns, closed=(columns + 1) // 2), text, contrast=power)


def tied(draw: Draw, difficulty: str) -> Contents:
    """Return the same with multi-point constraints between nodes above the floor."""
    columns, rows = SIZES[difficulty]
    nodes = draw.some(range(columns, columns * rows), max(1, columns // 2))
    ties = []
    for node in nodes:
        other = 2 * draw.integer(0, node - 1)
        factor = draw.among((-3, -2, -1, 1, 2, 3))
        ties.append({2 * node + draw.integer(0, 1): draw.among((1, 2)), other: factor})
    text = f"A lattice of springs over a floor; constraints A u = b, {len(ties)} in number, between its unknowns."
    return _on_floor(draw, difficulty, _states(draw, columns, closed=(columns + 1) // 2), text, ties=clean(ties))


def floating(draw: Draw, difficulty: str) -> Contents:
    """Return two lattices held only by a floor, a wall and each other."""
    columns, rows = {"easy": (2, 1), "moderate": (3, 2), "hard": (6, 3)}[difficulty]
    each = columns * rows
    springs = Springs(4 * each)
    for first in (0, each):
        lattice(springs, columns, rows, lambda: draw.integer(1, 16), first)
    top, bottom, upper = each - columns, 0, each
    normal = [{2 * (bottom + i) + 1: -1} for i in range(columns)]
    normal += [{2 * (top + i) + 1: 1, 2 * (upper + i) + 1: -1} for i in range(columns)]
    walls = [{2 * bottom: -1}, {2 * upper: -1}]
    # The ends of each joint and both walls have forces: three conditions per body.
    states = _ends_closed(draw, columns) + _ends_closed(draw, columns) + ["closed"] * 2
    u = _displacement(draw, 4 * each)
    text = "Two bodies, one on the other, lean against a wall on a floor; no spring holds them and K is singular."
    return _with_answer(draw, difficulty, springs.rows(), clean(normal + walls), states, u, text)


def large(draw: Draw, difficulty: str) -> Contents:
    """Return a membrane on soft springs over an obstacle, with a contact at every node."""
    side = LARGE[difficulty]
    springs = Springs(side * side)
    for j in range(side):
        for i in range(side):
            here = j * side + i
            springs.add(1 + 16 * ((i in (0, side - 1)) + (j in (0, side - 1))), {here: 1})
            for there in ([here + 1] if i + 1 < side else []) + ([here + side] if j + 1 < side else []):
                springs.add(draw.integer(4, 16), {here: 1, there: -1})
    centre, radius = (side // 2 + draw.integer(-1, 1), side // 2 + draw.integer(-1, 1)), side // 3
    states = []
    for here in range(side * side):
        distance = (here % side - centre[0]) ** 2 + (here // side - centre[1]) ** 2
        on_edge = distance == radius**2
        states.append("grazing" if on_edge else "closed" if distance < radius**2 else "open")
    u = tuple(Fraction(-draw.integer(0, 64), 64) for _ in range(side * side))
    normal = clean({here: -1} for here in range(side * side))
    text = (
        f"A membrane of {side} x {side} nodes, each of them a contact with an uneven obstacle, pressed on a disc of it."
    )
    return _with_answer(draw, difficulty, springs.rows(), normal, states, u, text)


def _on_floor(
    draw: Draw,
    difficulty: str,
    states: Sequence[str],
    text: str,
    repeats: int = 0,
    contrast: int = 0,
    ties: Rows = (),
) -> Contents:
    columns, rows = SIZES[difficulty]
    n = 2 * columns * rows
    springs = Springs(n)
    weight = 2**contrast
    lattice(springs, columns, rows, lambda: draw.integer(1, 16) * (draw.among((1, weight)) if contrast else 1))
    for i in range(n - 2 * columns, n):
        springs.add(draw.integer(1, 16), {i: 1})
    floors = [(0, -1) if difficulty == "easy" else draw.among(FLOORS) for _ in range(columns)]
    normal: list[Row] = list(clean({2 * i: x, 2 * i + 1: z} for i, (x, z) in enumerate(floors)))
    states = list(states)
    closed = [i for i, state in enumerate(states) if state == "closed"]
    for k in range(repeats):
        row = normal[closed[k % len(closed)]]
        other = normal[draw.among(closed)] if k % 2 else {}
        factor = draw.among((Fraction(1), Fraction(2), Fraction(1, 2)))
        normal.append({j: factor * (row.get(j, Fraction(0)) + other.get(j, Fraction(0))) for j in {*row, *other}})
        states.append("closed")
    u = _displacement(draw, n) if not contrast else _nearly_rigid(draw, columns, rows, contrast)
    return _with_answer(draw, difficulty, springs.rows(), clean(normal), states, u, text, ties)


def _with_answer(
    draw: Draw,
    difficulty: str,
    stiffness: Rows,
    normal: Rows,
    states: Sequence[str],
    u: Numbers,
    text: str,
    ties: Rows = (),
) -> Contents:
    """Return contents with forces and gaps for the states; in hard problems some are a few millionths of the others."""
    n = len(stiffness)
    force, gap = [], []
    for state in states:
        small = difficulty == "hard" and draw.integer(0, 7) == 0
        size = Fraction(draw.integer(1, 64), 2**20 if small else 4)
        force.append(size if state == "closed" else Fraction(0))
        gap.append(size / 16 if state == "open" else Fraction(0))
    tie_force = tuple(Fraction(draw.integer(-32, 32), 4) for _ in ties)
    load = plus(times(stiffness, u), transposed_times(normal, force, n), transposed_times(ties, tie_force, n))
    data = ExactProblem(stiffness, load, normal, plus(times(normal, u), gap), tie=ties, tie_value=times(ties, u))
    answer = exact_answer(data, u, tuple(force), tie_force=tie_force)
    return with_uniqueness(data, answer, text, "made for this gallery", BY_CONSTRUCTION, {})


def _states(draw: Draw, contacts: int, closed: int, grazing: int = 0) -> list[str]:
    """Return the states of contacts with given numbers of closed and grazing ones at random positions."""
    touching = draw.some(range(contacts), closed + grazing)
    graze = draw.some(touching, grazing)
    return ["grazing" if i in graze else "closed" if i in touching else "open" for i in range(contacts)]


def _ends_closed(draw: Draw, contacts: int) -> list[str]:
    inner = [draw.among(("closed", "open")) for _ in range(contacts - 2)]
    return ["closed", *inner, "closed"]


def _displacement(draw: Draw, n: int) -> Numbers:
    return tuple(Fraction(draw.integer(-64, 64), 16) for _ in range(n))


def _nearly_rigid(draw: Draw, columns: int, rows: int, contrast: int) -> Numbers:
    """Return a small rigid motion with a strain of 2^-contrast.

    The motion, rounded to doubles, strains a stiff spring by 2^contrast eps times its size: this is kept below 2^-28,
    so that the rounded answer is nearly an answer.
    """
    unit = Fraction(1, 2 ** (contrast - 19))
    right, up, turn = (draw.integer(-64, 64) * unit, draw.integer(-64, 64) * unit, draw.integer(1, 8) * unit)
    u: list[Fraction] = []
    for j in range(rows):
        for i in range(columns):
            u += [
                right - turn * j + Fraction(draw.integer(-8, 8), 2**contrast),
                up + turn * i + Fraction(draw.integer(-8, 8), 2**contrast),
            ]
    return tuple(u)
