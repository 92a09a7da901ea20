"""Enclose the answer of a scene with irrational geometry in balls (intervals with midpoint and radius).

The scene is assembled with balls for irrational numbers, the linear system of the contact states found in floating
point is solved in balls (which proves that it is regular), and all required signs are proven to be strict. A contact
that just touches is undecidable.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from numbers import Rational
from typing import TYPE_CHECKING, Any

import flint
import numpy as np
from flint import arb, arb_mat

from contactqp.elements.scalars import irrational_roots
from contactqp.errors import NotCertified, Unsupported
from contactqp.linalg.rational import fraction, from_fraction, sum_of_products
from contactqp.model.arrays import refuse_late
from contactqp.model.solution import Solution
from contactqp.oracle.exact.exact_solution import ExactSolution, Fractions, Parts, rounded_up
from contactqp.oracle.exact.rational_answer import PROVEN_FRICTION, Asked, proof_of, proposal, symmetrised
from contactqp.scene.building import ExactProblem, exact_problem

if TYPE_CHECKING:
    from contactqp.scene.scene import Scene


# Real numbers enclosed in balls mid +- radius (flint's arb), which can be combined with Fractions in formulas.


class Ball:
    """A number of a scene with a bound of its rounding error, in flint's current precision.

    >>> two = root(Fraction(2)) ** 2
    >>> two > Fraction(1), two > 2, 2 > two, two.value.contains(2)
    (True, False, False, True)
    """

    __slots__ = ("value",)

    def __init__(self, value: arb) -> None:
        self.value = value

    def __add__(self, other: Any) -> Any:
        return _made(other, lambda x: self.value + x)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return _made(other, lambda x: self.value - x)

    def __rsub__(self, other: Any) -> Any:
        return _made(other, lambda x: x - self.value)

    def __mul__(self, other: Any) -> Any:
        return _made(other, lambda x: self.value * x)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        return _made(other, lambda x: self.value / x)

    def __rtruediv__(self, other: Any) -> Any:
        return _made(other, lambda x: x / self.value)

    def __pow__(self, exponent: int) -> Ball:
        return Ball(self.value**exponent)

    def __neg__(self) -> Ball:
        return Ball(-self.value)

    def __abs__(self) -> Ball:
        return Ball(abs(self.value))

    def __gt__(self, other: Any) -> bool:
        """Return whether the ball is proven to be greater, False if undecided."""
        return bool(self.value > to_arb(other))

    def __lt__(self, other: Any) -> bool:
        return bool(self.value < to_arb(other))

    def __bool__(self) -> bool:
        """Return False if the number is known to be zero, else True."""
        return not self.value.is_zero()


def root(square: Any) -> Ball:
    """Return the square root of a nonnegative number."""
    return Ball(to_arb(square).sqrt())


def to_arb(value: Any) -> arb:
    """Return the ball of a number."""
    found = _arb_of(value)
    if found is None:
        raise TypeError(f"expected a number that a ball computes with, got {type(value).__name__}")
    return found


def _arb_of(value: Any) -> arb | None:
    if isinstance(value, Ball):
        return value.value
    if isinstance(value, Rational):
        return arb(from_fraction(Fraction(value)))
    return None  # floats may be rounded, so that a proof is impossible


def _made(other: Any, operation: Callable[[arb], arb]) -> Any:
    found = _arb_of(other)
    return NotImplemented if found is None else Ball(operation(found))


def midpoint(value: arb) -> Fraction:
    """Return the exact midpoint, a dyadic number."""
    return fraction(value.mid().fmpq())


def radius(value: arb) -> float:
    """Return the radius, rounded up to a double."""
    exact = fraction(value.rad().fmpq())
    return rounded_up(exact)


# Precisions in bits; the second is used if the first does not decide all signs.
PRECISIONS = (256, 1024, 4096)
# The required relative radius of nonzero components; otherwise the next precision is tried.
ENOUGH = 1e-15
# The most unknowns: dense systems in balls of some hundred unknowns take seconds.
MOST_UNKNOWNS = 400

Rows = list[list[arb]]


@dataclass(frozen=True, eq=False)
class Balls:
    """The problem on its free unknowns; matrices are lists of rows."""

    K: Rows
    f: list[arb]
    E: Rows
    g: list[arb]
    T: Rows  # one per contact, none without friction
    friction: list[arb]
    origin: list[arb]
    A: Rows
    b: list[arb]


@dataclass(frozen=True, eq=False)
class Enclosed:
    """Balls of an answer with strict signs."""

    u: list[arb]
    push: list[arb]
    drag: list[arb]
    tie: list[arb]
    gap: list[arb]
    slip: list[arb]

    def values(self) -> list[arb]:
        return self.u + self.push + self.drag + self.tie + self.gap + self.slip


def enclose_scene(scene: Scene, asked: Asked) -> ExactSolution:
    """Return the answer in balls.

    Raises NotCertified: a sign cannot be decided; Unsupported: too many unknowns, friction in space, a singular system,
    or no answer in floating point.
    """
    problem = asked.problem
    if problem.dimension > MOST_UNKNOWNS:
        raise Unsupported(f"exact: {problem.dimension} unknowns with irrational numbers; at most {MOST_UNKNOWNS}")
    if problem.frictional and problem.slip_origin is not None and problem.slip_origin.shape[1] > 1:
        raise Unsupported("exact: friction in space with irrational numbers")
    solution, error = proposal(asked)
    if solution is None:
        raise error if error is not None else Unsupported("exact: floats propose nothing")
    with proof_of(solution):
        return _in_balls(scene, asked, solution)


def _in_balls(scene: Scene, asked: Asked, solution: Solution) -> ExactSolution:
    undecided, problem = "", asked.problem
    for precision in PRECISIONS:
        refuse_late(f"the answer was enclosed with {precision} bits")
        with flint.ctx.workprec(precision), irrational_roots(root):
            try:
                balls = _balls(exact_problem(scene))
            except TypeError as error:
                raise Unsupported(f"exact: irrational numbers that are known as floats only ({error})") from None
            _refuse_indefinite(scene, balls)
            states = tuple(str(word) for word in solution.contact_status)
            try:
                found = _solved(balls, states, [float(x) for x in _rub(solution)])
            except ZeroDivisionError:
                undecided = "the system of the proposed contact set is singular"
                continue
            undecided = _undecided(balls, states, found, problem.contact_name)
            if not undecided and all(_is_sharp(x) for x in found.values()):
                return _answer(asked, solution, found, states)
    raise NotCertified(f"exact: {undecided or 'the balls stay too wide'}, with {PRECISIONS[-1]} bits", solution)


def _rub(solution: Solution) -> Sequence[float]:
    force = solution.friction_force
    return [] if force is None else [float(x) for x in np.asarray(force)[:, 0]]


def _balls(exact: ExactProblem) -> Balls:
    free = exact.unknowns.free
    place = {name: i for i, name in enumerate(free)}
    K = [[arb(0)] * len(free) for _ in free]
    for (i, j), entry in exact.stiffness.items():
        if i in place and j in place:
            K[place[i]][place[j]] = to_arb(entry)
    K = [
        [(x + y) / 2 for x, y in zip(row, column, strict=True)]
        for row, column in zip(K, zip(*K, strict=True), strict=True)
    ]
    frictional = any(contact.friction for contact in exact.contacts)
    contacts = exact.contacts if frictional else ()
    return Balls(
        K=K,
        f=[to_arb(exact.load.get(name, Fraction(0))) for name in free],
        E=[_row(contact.normal, place) for contact in exact.contacts],
        g=[to_arb(contact.gap) for contact in exact.contacts],
        T=[_row(row, place) for contact in contacts for row in contact.tangent],
        friction=[to_arb(contact.friction) for contact in exact.contacts],
        origin=[to_arb(x) for contact in contacts for x in contact.slip_origin],
        A=[_row(tie.row, place) for tie in exact.ties],
        b=[to_arb(tie.value) for tie in exact.ties],
    )


def _row(row: Mapping[str, Any], place: Mapping[str, int]) -> list[arb]:
    made = [arb(0)] * len(place)
    for name, value in row.items():
        if name in place:
            made[place[name]] = to_arb(value)
    return made


def _refuse_indefinite(scene: Scene, balls: Balls) -> None:
    """Raise Unsupported if the stiffness may be indefinite; elements are semidefinite, but given matrices need not
    be.
    """
    if all(element.semidefinite for _, element in scene.elements):
        return
    pivots = [list(row) for row in balls.K]
    for i, row in enumerate(pivots):
        if not row[i] > 0:
            raise Unsupported("exact: a stiffness with matrices of its own that is not proven to be positive definite")
        for other in pivots[i + 1 :]:
            share = other[i] / row[i]
            other[i:] = [x - share * y for x, y in zip(other[i:], row[i:], strict=True)]


def _solved(balls: Balls, states: tuple[str, ...], drags: list[float]) -> Enclosed:
    """Return the solution of the system of `contactqp.oracle.exact.rational_equilibrium` in balls."""
    n, m = len(balls.f), len(balls.g)
    closed = [i for i, word in enumerate(states) if word not in ("open", "grazing")]
    stuck = [i for i in closed if states[i] == "stick"]
    sign = {i: (1 if drags[i] > 0 else -1) for i in closed if states[i] == "slip"}
    pushed = [
        [x + sign[i] * balls.friction[i] * y for x, y in zip(balls.E[i], balls.T[i], strict=True)]
        if i in sign
        else balls.E[i]
        for i in closed
    ]
    held = balls.A + [balls.E[i] for i in closed] + [balls.T[i] for i in stuck]
    along = balls.A + pushed + [balls.T[i] for i in stuck]
    limit = balls.b + [balls.g[i] for i in closed] + [balls.origin[i] for i in stuck]
    matrix = [[*balls.K[j], *(row[j] for row in along)] for j in range(n)]
    matrix += [[*row, *[arb(0)] * len(held)] for row in held]
    size = n + len(held)
    x = arb_mat(size, size, [y for row in matrix for y in row]).solve(arb_mat(size, 1, balls.f + limit)).entries()
    if not all(y.is_finite() for y in x):
        raise ZeroDivisionError
    u, tie, rest = x[:n], x[n : n + len(balls.A)], x[n + len(balls.A) :]
    push, drag = [arb(0)] * m, [arb(0)] * len(balls.T)
    for i, value in zip(closed, rest, strict=False):
        push[i] = value
        if i in sign:
            drag[i] = sign[i] * balls.friction[i] * value
    for i, value in zip(stuck, rest[len(closed) :], strict=True):
        drag[i] = value
    gap = [arb(0) if i in closed else balls.g[i] - sum_of_products(balls.E[i], u) for i in range(m)]
    slip = [arb(0) if i in stuck else sum_of_products(row, u) - balls.origin[i] for i, row in enumerate(balls.T)]
    return Enclosed(u, push, drag, tie, gap, slip)


def _undecided(balls: Balls, states: tuple[str, ...], found: Enclosed, name: Any) -> str:
    """Return the first sign that is not proven strictly, in words, or ""."""
    for i, word in enumerate(states):
        if word in ("open", "grazing"):
            if not found.gap[i] > 0:
                return f"the gap of {name(i)} is not proven to be positive ({found.gap[i].str(6)})"
            continue
        if not found.push[i] > 0:
            return f"the normal force of {name(i)} is not proven to be positive ({found.push[i].str(6)})"
        if word == "stick" and not abs(found.drag[i]) < balls.friction[i] * found.push[i]:
            return f"{name(i)} is not proven to stick"
        if word == "slip" and not found.drag[i] * found.slip[i] > 0:
            return f"{name(i)} is not proven to slip that way"
    return ""


def _is_sharp(value: arb) -> bool:
    """Return whether an interval is narrow relative to its number, or small enough for a zero."""
    size, off = abs(float(value.mid())), float(value.rad())
    return off <= ENOUGH * size or off < 1e-60


def _answer(asked: Asked, solution: Solution, found: Enclosed, states: tuple[str, ...]) -> ExactSolution:
    problem = asked.problem
    shape = None if problem.slip_origin is None else problem.slip_origin.shape
    push = found.push
    ranges = np.empty((len(push), 2), dtype=object)
    for i, force in enumerate(push):
        ranges[i] = [midpoint(force), midpoint(force)]
    last = (PROVEN_FRICTION,) if problem.frictional else ("the stiffness is positive semidefinite, element by element",)
    return ExactSolution(
        problem=problem,
        displacement=_middles(found.u),
        normal_force=_middles(push),
        friction_force=None if shape is None else _middles(found.drag).reshape(shape),
        tie_force=_middles(found.tie),
        gap=_middles(found.gap),
        slip=None if shape is None else _middles(found.slip).reshape(shape),
        contact_status=tuple("open" if word == "grazing" else word for word in states),
        rational=False,
        radius=Parts(
            _radii(found.u),
            _radii(push),
            None if shape is None else _radii(found.drag).reshape(shape),
            _radii(found.tie),
            _radii(found.gap),
            None if shape is None else _radii(found.slip).reshape(shape),
        ),
        unique_forces=True,
        force_range=ranges,
        free_motions=(),
        energy=None,
        equilibria=None,
        uniqueness=solution.certificate.uniqueness,
        events=(),
        data=asked.source,
        way="the proposed contact set, in balls",
        proof=(
            "the system of this contact set is regular: these are its only displacements and forces",
            "every gap and every normal force is strictly positive where it is not zero by that system",
            *last,
        ),
        notes=symmetrised(problem),
        method=asked.method,
        seconds=time.perf_counter() - asked.started,
    )


def _middles(values: Sequence[arb]) -> Fractions:
    array = np.empty(len(values), dtype=object)
    array[:] = [midpoint(x) for x in values]
    return array


def _radii(values: Sequence[arb]) -> Any:
    return np.array([radius(x) for x in values], dtype=float)
