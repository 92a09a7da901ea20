"""Define a contact problem in rational numbers, the proof of an answer, and its linear complementarity problem.

The numbers are the exact values of a problem's floats, or the unrounded ones of a scene. Without friction, with Z a
basis of the motions that neither K nor A resists,

    [ K  A'  Z ] [ u0   -R ]   [ f   E' ]
    [ A  0   0 ] [ .     . ] = [ b   0  ]        u = u0 - R l + Z a,    Z'(f - E'l) = 0,    W = E R,
    [ Z' 0   0 ] [ .     . ]   [ 0   0  ]        gap = g - E u = q + W l - G a,    q = g - E u0,  G = E Z,

is a linear complementarity problem with free variables a. Lemke's method solves it, or proves by a ray that there is no
solution.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any

from flint import fmpq, fmpq_mat

from contactqp.linalg.exact_algebra import Polyhedron, Region
from contactqp.linalg.rational import (
    NoSolution,
    Undecided,
    beside,
    column,
    fraction,
    fraction_rows,
    fractions,
    from_fraction,
    is_zero,
    matrix,
    null_space,
    rational,
    row_basis,
    solve_any,
    stack,
    sum_of_products,
    take,
    take_columns,
    zeros,
)
from contactqp.model.arrays import refuse_late
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import AnswerOf
from contactqp.solving.friction.exact_enumeration import finite_gap

if TYPE_CHECKING:
    from contactqp.scene.building import ExactProblem


@dataclass(frozen=True, eq=False)
class RationalProblem:
    """K u + E_N'l_N + E_T'l_T + A'nu = f, E_N u <= g, A u = b and Coulomb's law, in rational numbers."""

    K: fmpq_mat  # (n, n)
    f: fmpq_mat  # (n, 1)
    E: fmpq_mat  # (m, n)
    g: fmpq_mat  # (m, 1)
    A: fmpq_mat  # (k, n)
    b: fmpq_mat  # (k, 1)
    T: fmpq_mat  # ((d-1) m, n), without rows if there is no friction
    friction: tuple[fmpq, ...]  # (m,)
    slip_origin: fmpq_mat  # ((d-1) m, 1)

    @property
    def unknowns(self) -> int:
        return int(self.K.nrows())

    @property
    def contacts(self) -> int:
        return int(self.E.nrows())

    @property
    def ties(self) -> int:
        return int(self.A.nrows())

    @property
    def frictional(self) -> bool:
        return any(mu > 0 for mu in self.friction)

    @property
    def width(self) -> int:
        """Return the number of tangential rows of a contact, d - 1."""
        return int(self.T.nrows()) // self.contacts if self.contacts else 0

    @property
    def idle_ties(self) -> list[int]:
        """Return the ties with zero rows."""
        return [tie for tie in range(self.ties) if is_zero(take(self.A, [tie]))]

    def gap(self, u: fmpq_mat) -> fmpq_mat:
        """Return the gaps g - E_N u (m, 1) of a displacement [length]."""
        return self.g - self.E * u

    def slip(self, u: fmpq_mat) -> fmpq_mat:
        """Return the slips E_T u - slip_origin ((d-1) m, 1) of a displacement [length]."""
        return self.T * u - self.slip_origin


def of_floats(problem: ContactProblem) -> RationalProblem:
    """Return the exact values of a problem's floats, with the symmetrised K."""
    T, friction, origin = zeros(0, problem.dimension), (fmpq(0),) * problem.contacts, zeros(0, 1)
    if problem.tangent is not None and problem.slip_origin is not None and problem.friction is not None:
        T, origin = matrix(problem.tangent), column(problem.slip_origin.ravel())
        friction = tuple(map(rational, problem.friction))
    return RationalProblem(
        K=matrix(problem.stiffness),
        f=column(problem.load),
        E=matrix(problem.normal),
        g=column(finite_gap(problem)),
        A=matrix(problem.tie),
        b=column(problem.tie_value),
        T=T,
        friction=friction,
        slip_origin=origin,
    )


def of_scene(exact: ExactProblem) -> RationalProblem:
    """Return a scene's numbers on its free unknowns, all of them Fractions (`exact.rational`); K is symmetrised.

    As in the problem of floats, only contacts with friction have tangential rows.
    """
    free = exact.unknowns.free
    place = {name: i for i, name in enumerate(free)}
    n, m = len(free), len(exact.contacts)
    K = zeros(n, n)
    for (i, j), entry in exact.stiffness.items():
        if i in place and j in place:
            K[place[i], place[j]] = from_fraction(_exact(entry))
    K = (K + K.transpose()) / 2
    has_friction = any(contact.friction for contact in exact.contacts)
    tangents = [row for contact in exact.contacts for row in contact.tangent] if has_friction else []
    origins = [x for contact in exact.contacts for x in contact.slip_origin] if has_friction else []
    return RationalProblem(
        K=K,
        f=_column(exact.load.get(name, Fraction(0)) for name in free),
        E=_rows([contact.normal for contact in exact.contacts], place),
        g=_column(contact.gap for contact in exact.contacts),
        A=_rows([tie.row for tie in exact.ties], place),
        b=_column(tie.value for tie in exact.ties),
        T=_rows(tangents, place),
        friction=tuple(from_fraction(contact.friction) for contact in exact.contacts)
        if has_friction
        else (fmpq(0),) * m,
        slip_origin=_column(origins),
    )


def _exact(value: Any) -> Fraction:
    if isinstance(value, float):
        raise TypeError("a number of the scene is irrational")
    return Fraction(value)


def _column(values: Iterable[Any]) -> fmpq_mat:
    return column([_exact(x) for x in values])


def _rows(rows: Sequence[Mapping[str, Any]], place: Mapping[str, int]) -> fmpq_mat:
    made = zeros(len(rows), len(place))
    for i, row in enumerate(rows):
        for name, value in row.items():
            if name in place:
                made[i, place[name]] = from_fraction(_exact(value))
    return made


# Check all conditions of a contact problem in rational numbers without tolerance.


@dataclass(frozen=True, eq=False)
class RationalAnswer(AnswerOf[fmpq_mat, fmpq_mat]):
    """An answer in columns; friction, ((d-1) m, 1), is empty without friction."""


@dataclass(frozen=True)
class Wrong:
    """A violated condition, and the number of its unknown, contact or tie."""

    statement: str
    place: int


STATEMENTS = (
    "equilibrium",  # K u + E_N'l_N + E_T'l_T + A'nu = f
    "tie",  # A u = b
    "penetration",  # g - E_N u >= 0
    "tension",  # l_N >= 0
    "complementarity",  # l_N (g - E_N u) = 0
    "cone",  # |l_T| <= mu l_N
    "slip direction",  # l_T = mu l_N s / |s| where s != 0
)


def wrong(data: RationalProblem, answer: RationalAnswer) -> Iterator[Wrong]:
    """Yield every violated condition; if there is none, the answer is proven."""
    u, push, drag = answer.displacement, answer.normal_force, answer.friction_force
    left = data.K * u + data.E.transpose() * push + data.A.transpose() * answer.tie_force - data.f
    if drag.nrows():
        left += data.T.transpose() * drag
    yield from (Wrong("equilibrium", j) for j, x in enumerate(left.entries()) if x != 0)
    yield from (Wrong("tie", i) for i, x in enumerate((data.A * u - data.b).entries()) if x != 0)
    gap, forces = data.gap(u).entries(), push.entries()
    yield from (Wrong("penetration", i) for i, x in enumerate(gap) if x < 0)
    yield from (Wrong("tension", i) for i, x in enumerate(forces) if x < 0)
    yield from (Wrong("complementarity", i) for i, x in enumerate(gap) if x != 0 and forces[i] != 0)
    yield from _wrong_friction(data, answer)


def _wrong_friction(data: RationalProblem, answer: RationalAnswer) -> Iterator[Wrong]:
    width = data.width
    if not width:
        return
    slip = data.slip(answer.displacement).entries()
    drag, forces = answer.friction_force.entries(), answer.normal_force.entries()
    for i, mu in enumerate(data.friction):
        force, moved = drag[width * i : width * (i + 1)], slip[width * i : width * (i + 1)]
        bound = mu * mu * forces[i] * forces[i]
        if sum_of_products(force, force) > bound:
            yield Wrong("cone", i)
        if mu == 0 or all(s == 0 for s in moved):
            continue
        along = sum_of_products(force, moved)
        # Cauchy and Schwarz: equality means parallel.
        parallel = along * along == sum_of_products(force, force) * sum_of_products(moved, moved)
        # Contacts without force have no direction of friction.
        if not (parallel and along >= 0 and sum_of_products(force, force) == bound):
            yield Wrong("slip direction", i)


def status(data: RationalProblem, answer: RationalAnswer) -> tuple[str, ...]:
    """Return the contact states (m,) in the words "open", "closed", "grazing", "stick" and "slip"."""
    gap, forces = data.gap(answer.displacement).entries(), answer.normal_force.entries()
    width = data.width
    slip = (data.slip(answer.displacement) if width else zeros(0, 1)).entries()
    words = []
    for i, mu in enumerate(data.friction):
        if forces[i] == 0:
            words.append("open" if gap[i] != 0 else "grazing")
        elif mu == 0:
            words.append("closed")
        else:
            words.append("slip" if any(s != 0 for s in slip[width * i : width * (i + 1)]) else "stick")
    return tuple(words)


# Lemke's method in rational numbers with lexicographic ratio tests: it is finite, and its ray proves infeasibility.
#
# Cottle, Pang and Stone (1992), The Linear Complementarity Problem, section 4.4.


def lemke(M: fmpq_mat, p: fmpq_mat, max_pivots: int) -> tuple[list[fmpq], int]:
    """Solve w = p + M z, w >= 0, z >= 0, w'z = 0 exactly, M positive semidefinite; return z and the number of pivots.

    Raises NoSolution on a secondary ray, Undecided after `max_pivots`.
    """
    size = M.nrows()
    if all(x >= 0 for x in p.entries()):
        return [fmpq(0)] * size, 0
    identity = fmpq_mat(size, size, [int(i == j) for i in range(size) for j in range(size)])
    cover = fmpq_mat(size, 1, [-1] * size)
    # Columns: w, z, z0, right-hand side; row by row I w - M z - z0 = p.
    table = beside(identity, -1 * M, cover, p).tolist()
    basis, z0, right = list(range(size)), 2 * size, 2 * size + 1
    row = min(range(size), key=lambda i: [table[i][right], *table[i][:size]])
    entering = z0
    for count in range(1, max_pivots + 1):
        refuse_late(f"pivot {count} of Lemke's method")
        leaving = basis[row]
        _pivot(table, row, entering)
        basis[row] = entering
        if leaving == z0:
            values = {variable: table[i][right] for i, variable in enumerate(basis)}
            return [values.get(size + i, fmpq(0)) for i in range(size)], count
        entering = leaving + size if leaving < size else leaving - size
        rows = [i for i in range(size) if table[i][entering] > 0]
        if not rows:
            raise NoSolution("a secondary ray")
        row = _lexicographic_row(table, rows, entering, basis, z0)
    raise Undecided(f"{max_pivots} pivots")


def _lexicographic_row(table: list[list[fmpq]], rows: list[int], entering: int, basis: list[int], z0: int) -> int:
    size = len(table)
    ratios = {i: table[i][2 * size + 1] / table[i][entering] for i in rows}
    least = min(ratios.values())
    tied = [i for i in rows if ratios[i] == least]
    for i in tied:
        if basis[i] == z0:
            return i
    if len(tied) == 1:
        return tied[0]
    return min(tied, key=lambda i: [table[i][j] / table[i][entering] for j in range(size)])


def _pivot(table: list[list[fmpq]], row: int, column_: int) -> None:
    pivot = table[row][column_]
    lead = table[row] = [x / pivot for x in table[row]]
    for i, other in enumerate(table):
        factor = other[column_]
        if i != row and factor != 0:
            table[i] = [x - factor * y if y != 0 else x for x, y in zip(other, lead, strict=True)]


# All x = start + N c with v + G c >= 0 in rational numbers: the one of least norm, and the ranges of entries.

# The most pivots of Lemke's method, which takes about as many as there are conditions.
MOST_PIVOTS = 2000

Range = tuple[Fraction | None, Fraction | None]


@dataclass(frozen=True, eq=False)
class Family:
    """The family x = start + N c with v + G c >= 0, with independent columns N."""

    start: fmpq_mat  # (n, 1)
    directions: fmpq_mat  # (n, r)
    room: fmpq_mat  # (p, 1) v
    slope: fmpq_mat  # (p, r) G

    def least(self) -> fmpq_mat:
        """Return the coefficients c (r, 1) of the member x of least Euclidean norm, which satisfies

            N'(start + N c) = G's,    w = v + G c >= 0,  s >= 0,  w's = 0.

        Raises
        ------
        NoSolution
            Proven: no member satisfies the conditions.
        """
        across = self.directions.transpose()
        square = across * self.directions
        free = -1 * square.solve(across * self.start)
        room = self.room + self.slope * free
        if all(x >= 0 for x in room.entries()):
            return free
        pull = square.solve(self.slope.transpose())
        push, _ = lemke(self.slope * pull, room, MOST_PIVOTS)
        return free + pull * fmpq_mat(len(push), 1, push)

    @cached_property
    def zero_rooms(self) -> frozenset[int]:
        """Return the indices of slacks w that are zero for all members."""
        rooms = Family(self.room, self.slope, self.room, self.slope).ranges(range(self.room.nrows()))
        return frozenset(place for place, (_, most) in enumerate(rooms) if most == 0)

    def are_same(self, rows: fmpq_mat) -> bool:
        """Return whether the products of rows (q, n) with x are the same for all members."""
        return is_zero(rows * (self.directions * null_space(take(self.slope, sorted(self.zero_rooms)))))

    def ranges(self, entries: Iterable[int]) -> list[Range]:
        """Return the least and the largest value of each entry of x, None if unbounded; a member must exist."""
        slopes, rooms = fraction_rows(self.slope), fractions(self.room)
        # A condition independent of c is satisfied, or there is no member.
        kept = [i for i, slope in enumerate(slopes) if any(slope)]
        region = Polyhedron([rooms[i] for i in kept], [slopes[i] for i in kept], int(self.directions.ncols()))
        found: list[Range] = []
        for entry in entries:
            row, at = [fraction(x) for x in self.directions.tolist()[entry]], fraction(self.start[entry, 0])
            low, high = region.range(row) if any(row) else ([Fraction(0)] * len(row), [Fraction(0)] * len(row))
            ends = [
                None if end is None else at + sum((x * y for x, y in zip(row, end, strict=True)), Fraction(0))
                for end in (low, high)
            ]
            found.append((ends[0], ends[1]))
        return found


def region_of(room: fmpq_mat, slope: fmpq_mat) -> Region:
    """Return the coordinates c with room + slope c >= 0, for room (q, 1) and slope (q, r)."""
    return Region(list(zip(fractions(room), fraction_rows(slope), strict=True)), int(slope.ncols()))


def longest(rooms: list[Fraction], slopes: list[list[Fraction]]) -> Fraction | float:
    """Return the largest last coordinate of c with rooms + slopes c >= 0, for rooms (q,) and slopes (q, r).

    It is not negative, as c = 0 is admissible, and infinite if unbounded.
    """
    size = len(slopes[0]) if slopes else 1
    step = [Fraction(0)] * (size - 1) + [Fraction(1)]
    _, most = Polyhedron([*rooms, Fraction(0)], [*slopes, step], size).range(step)
    return math.inf if most is None else most[-1]


def blocks(directions: fmpq_mat, slope: fmpq_mat) -> list[list[int]]:
    """Return the columns in blocks that share no row, so that ranges can be computed block by block."""
    group = list(range(int(directions.ncols())))
    for row in [*directions.tolist(), *slope.tolist()]:
        touched = [j for j, x in enumerate(row) if x != 0]
        for j in touched[1:]:
            old, new = group[j], group[touched[0]]
            group = [new if g == old else g for g in group]
    return [[j for j, g in enumerate(group) if g == name] for name in dict.fromkeys(group)]


def block_of(family: Family, columns: list[int]) -> Family:
    """Return the family of only these directions, with the conditions that they affect."""
    slope = take_columns(family.slope, columns)
    rows = [i for i, row in enumerate(slope.tolist()) if any(x != 0 for x in row)]
    return Family(family.start, take_columns(family.directions, columns), take(family.room, rows), take(slope, rows))


@dataclass(frozen=True, eq=False)
class Reduced:
    """The problem in contact forces l and motions a (see the module)."""

    data: RationalProblem  # with independent ties
    Z: fmpq_mat
    u0: fmpq_mat
    R: fmpq_mat
    W: fmpq_mat
    q: fmpq_mat
    G: fmpq_mat
    drive: fmpq_mat  # Z'f

    def displaced(self, force: fmpq_mat, motion: fmpq_mat) -> fmpq_mat:
        """Return the displacement u = u0 - R l + Z a of contact forces l and motions a."""
        return self.u0 - self.R * force + self.Z * motion

    def on_set(self, closed: Iterable[int], softness: Iterable[fmpq] = ()) -> tuple[fmpq_mat, fmpq_mat] | None:
        """Return forces and motions with the contacts of the set closed and the others without force.

        With a softness (length / force) for each contact of the set, these are springs: the penalty answer.
        """
        closed = tuple(closed)
        count, r = len(closed), self.G.ncols()
        W = take_columns(take(self.W, closed), closed)
        for i, soft in enumerate(softness):
            W[i, i] += soft
        G, q = take(self.G, closed), take(self.q, closed)
        system = stack(beside(W, -1 * G), beside(G.transpose(), zeros(r, r)))
        solved = solve_any(system, stack(-1 * q, self.drive))
        if solved is None:
            return None
        values = solved[0].entries()
        force = zeros(self.W.nrows(), 1)
        for i, value in zip(closed, values[:count], strict=True):
            force[i, 0] = value
        return force, fmpq_mat(r, 1, values[count:])

    def lemke(self, max_pivots: int) -> tuple[fmpq_mat, fmpq_mat, int]:
        """Solve by Lemke's method with a = a+ - a-; return forces, motions and pivots. A ray proves that there is no
        solution.
        """
        m, r = self.W.nrows(), self.G.ncols()
        G, GT, none = self.G, self.G.transpose(), zeros(r, 2 * r)
        M = stack(beside(self.W, -1 * G, G), beside(GT, none), beside(-1 * GT, none))
        z, pivots = lemke(M, stack(self.q, -1 * self.drive, self.drive), max_pivots)
        motion = [z[m + i] - z[m + r + i] for i in range(r)]
        return fmpq_mat(m, 1, z[:m]), fmpq_mat(r, 1, motion), pivots

    def holds(self, force: fmpq_mat, motion: fmpq_mat) -> bool:
        """Return whether forces and motions satisfy the original problem in rational arithmetic."""
        data, u = self.data, self.displaced(force, motion)
        gap, pushes = data.gap(u).entries(), force.entries()
        if any(lam < 0 for lam in pushes) or any(w < 0 for w in gap):
            return False
        if any(lam != 0 and w != 0 for lam, w in zip(pushes, gap, strict=True)):
            return False
        missing = data.f - data.K * u - data.E.transpose() * force
        return data.A * u == data.b and solve_any(data.A.transpose(), missing) is not None


def reduce_problem(data: RationalProblem) -> Reduced:
    """Return the problem in contact forces and the motions without energy that independent ties allow.

    Raises NoSolution: the ties contradict each other.
    """
    kept = _independent_ties(data)
    data = RationalProblem(
        data.K, data.f, data.E, data.g, take(data.A, kept), take(data.b, kept), data.T, data.friction, data.slip_origin
    )
    n, k, m = data.unknowns, data.ties, data.contacts
    Z = null_space(stack(data.K, data.A))
    r = Z.ncols()
    top = beside(data.K, data.A.transpose(), Z)
    system = stack(top, beside(data.A, zeros(k, k + r)), beside(Z.transpose(), zeros(r, k + r)))
    right = stack(beside(data.f, data.E.transpose()), beside(data.b, zeros(k, m)), zeros(r, 1 + m))
    solved = take(system.solve(right), range(n)).transpose()
    u0, R = take(solved, [0]).transpose(), take(solved, range(1, 1 + m)).transpose()
    return Reduced(data, Z, u0, R, data.E * R, data.gap(u0), data.E * Z, Z.transpose() * data.f)


def _independent_ties(data: RationalProblem) -> list[int]:
    kept = row_basis(data.A)
    if len(kept) < data.ties and solve_any(data.A, data.b) is None:
        raise NoSolution("the ties contradict each other")
    return kept
