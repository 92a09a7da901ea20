"""Random gallery problems with Coulomb friction, in the plane and in space, stuck, sliding and open.

Each contact has a frame of orthogonal rows of integers of one length, and nodes move along their own frame, so that
slips, sizes of slips and forces are rational. Friction is below a bound that proves the answer to be the only one.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import ceil

from contactqp.oracle.gallery.algebra import (
    Numbers,
    Row,
    clean,
    dominance,
    largest_row_sum,
    plus,
    times,
    transposed_times,
)
from contactqp.oracle.gallery.draw import Draw, Springs
from contactqp.oracle.gallery.problem import Contents, ExactProblem, exact_answer
from contactqp.oracle.gallery.statement import with_uniqueness

# Nodes that touch something, and nodes that do not.
SIZES = {"easy": (1, 1), "moderate": (5, 4), "hard": (20, 16)}
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
}  # all of one length, 1 in the plane and 5 in space
BY_CONSTRUCTION = "f = K u* + E_N'l_N + E_T'l_T, g = E_N u* + gap*, l_T = mu l_N s/|s| where it slides"


@dataclass(frozen=True)
class _Touch:
    """What is chosen of one contact."""

    frame: Frame
    state: str
    approach: Fraction  # along the normal, in lengths of the frame
    slip: Numbers  # (d-1,), likewise along the tangents
    pressed: Fraction  # l_N
    rubbing: Numbers  # (d-1,) l_T
    gap: Fraction

    def motion(self, axis: int) -> Fraction:
        """The node's displacement along an axis: none of it along the tangents where it sticks."""
        return self.approach * self.frame[0][axis] + sum(
            (s * row[axis] for s, row in zip(self.slip, self.frame[1:], strict=True)), Fraction(0)
        )


def frictional(draw: Draw, difficulty: str) -> Contents:
    """A network of springs whose nodes stick to, slide on or hang over rough obstacles."""
    dimension = draw.integer(2, 3)
    touching, others = SIZES[difficulty]
    n = dimension * (touching + others)
    stiffness = _network(draw, n)
    # The largest sixteenth beneath the bound of `gallery_uniqueness`.
    friction = Fraction(ceil(16 * dominance(stiffness) / largest_row_sum(stiffness)) - 1, 16)
    # Of three neighbours one slides, one sticks and one is open; a single one touches.
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
    force, rubbing = tuple(touch.pressed for touch in touches), [touch.rubbing for touch in touches]
    load = plus(
        times(stiffness, u),
        transposed_times(normal, force, n),
        transposed_times(tangent, [x for row in rubbing for x in row], n),
    )
    gap = plus(times(normal, u), [touch.gap for touch in touches])
    origin = (Fraction(0),) * len(tangent)
    data = ExactProblem(stiffness, load, normal, gap, tangent, (friction,) * touching, origin)
    answer = exact_answer(data, tuple(u), force, rubbing)
    found = ", ".join(sorted(set(answer.contact_status)))
    text = f"A network of springs in {dimension}D on rough obstacles, mu = {friction}: {found}; slip starts at zero."
    return with_uniqueness(data, answer, text, "made for this gallery", BY_CONSTRUCTION, {})


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
        rubbing=tuple(share * friction * pressed * x / length for x in direction),
        gap=Fraction(draw.integer(1, 32), 16) if state == "open" else Fraction(0),
    )


def _network(draw: Draw, n: int) -> tuple[Row, ...]:
    """A stiffness that couples every unknown with a few others, its diagonal well above its row sums."""
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
