"""Find every equilibrium of a tiny problem with Coulomb friction in the plane in rational numbers, without rounding.

The bodies and their ties are eliminated once,

    [ K  A' ] [ u  ]   [ f - E_N'l_N - E_T'l_T ]
    [ A  0  ] [ nu ] = [ b                     ]      u = u_0 + U y,   H y = h,   y = (l_N, l_T, a),

with motions a that neither stiffness nor ties resist, and H y = h the balance of the load along them. Each combination
of open, stick and slip either way is then a small linear system and a list of signs, as in
`contactqp.solving.friction.enumeration`; where the system is underdetermined, exact linear programs decide whether the
signs can hold, and whether the free part changes the displacement.

A local problem, V'r + R l + s = 0 and u = W r + V l + q, is treated alike, but only the existence of an answer is
decided.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem, NoEquilibrium, Unsupported, counted, shown
from contactqp.linalg.exact_algebra import ONE, ZERO, Affine, Region, Row, dot, reduced, solutions
from contactqp.model.arguments import checked
from contactqp.model.arrays import own_floating_point, refuse_late
from contactqp.model.coulomb import OPEN, STICK, all_combinations, combinations_of, plane_states
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import ReadOnly
from contactqp.model.solution import Answer, AnswerOf
from contactqp.solving.friction.enumeration import refuse_many, separate_parts

# The largest difference between exact and given values relative to the largest entry, by rounding and symmetrising.
DATA_ROUNDING = 1e-9
# Fractions that a message writes out; Python refuses to write thousands of digits.
LARGEST_WRITTEN = 10**12
NAMES = ("stiffness", "load", "normal", "gap", "tangent", "friction", "slip_origin", "tie", "tie_value")


class ExactData:
    """A problem in Fractions; matrices are lists of rows, of zeros and without friction where a contact never presses.

    Raises InvalidProblem: a name is unknown, a value is not a rational number, or it does not round to the problem's.
    """

    def __init__(self, problem: ContactProblem, exact: dict[str, Any]) -> None:
        unknown = sorted(set(exact) - set(NAMES))
        if unknown:
            raise InvalidProblem(f"exact_equilibria: expected exact {', '.join(NAMES)}, got {unknown[0]!r}")
        self._problem, self._exact = problem, exact
        self.stiffness, self.normal, self.tangent, self.tie = (
            self._matrix(name) for name in ("stiffness", "normal", "tangent", "tie")
        )
        self.load, self.gap, self.friction, self.slip_origin, self.tie_value = (
            self._vector(name) for name in ("load", "gap", "friction", "slip_origin", "tie_value")
        )
        for i, row in enumerate(self.stiffness):
            if any(row[j] != self.stiffness[j][i] for j in range(i)):
                raise InvalidProblem(f"stiffness: expected exactly symmetric, row {i} is not")
        # The friction of a contact that cannot slide has no effect.
        moves = zip(self.tangent, self.slip_origin, strict=True)
        still = np.array([not any(row) and not origin for row, origin in moves], dtype=bool)
        self.apart = problem.gap == np.inf
        self.never = self.apart | np.array([not any(row) for row in self.normal], dtype=bool) & (problem.gap >= 0)
        idle = still | self.never
        self.friction = [Fraction(0) if one else mu for one, mu in zip(idle, self.friction, strict=True)]
        self.normal = [[Fraction(0)] * len(row) if i else row for i, row in zip(self.never, self.normal, strict=True)]

    def _matrix(self, name: str) -> list[Row]:
        known = getattr(self._problem, name)
        floats = known.toarray() if hasattr(known, "toarray") else np.asarray(known)
        flat = self._numbers(name, floats)
        width = floats.shape[1]
        return [flat[i * width : (i + 1) * width] for i in range(len(floats))]

    def _vector(self, name: str) -> Row:
        known = getattr(self._problem, name)
        return self._numbers(name, np.where(known < np.inf, known, 1.0) if name == "gap" else np.asarray(known))

    def _numbers(self, name: str, floats: np.ndarray[Any, Any]) -> Row:
        if name not in self._exact:
            return [Fraction(float(x)) for x in floats.ravel()]
        given = self._exact[name]
        try:
            given = np.asarray(given.toarray() if hasattr(given, "toarray") else given, dtype=object)
        except Exception:  # noqa: BLE001  whatever an object says of itself as an array
            raise InvalidProblem(f"{name}: expected rational numbers, got {shown(given)}") from None
        if name == "friction" and given.ndim == 0:
            given = np.broadcast_to(given, floats.shape)
        if given.size != floats.size:
            raise InvalidProblem(f"{name}: expected {floats.size} exact values, got {given.size}")
        values = [_fraction(name, x) for x in given.ravel()]
        allowed = Fraction(DATA_ROUNDING * float(np.max(abs(floats), initial=0.0)))
        for value, rounded in zip(values, floats.ravel().tolist(), strict=True):
            if not abs(value - Fraction(rounded)) <= allowed:
                written = str(value) if abs(value) < LARGEST_WRITTEN else shown(value)
                raise InvalidProblem(f"{name}: expected what rounds to the problem's {rounded:g}, got {written}")
        return values


def _fraction(name: str, value: Any) -> Fraction:
    try:
        if isinstance(value, np.timedelta64):
            raise TypeError("a duration")
        return Fraction(value.item() if isinstance(value, np.integer) else value)  # 8 bits hold no denominator
    except Exception:  # noqa: BLE001  no number, or an object with words of its own
        raise InvalidProblem(f"{name}: expected rational numbers, got {shown(value)}") from None


MOST_CONTACTS = 6  # 4^6 systems of some ten rows take tens of seconds in rational numbers
MOST_UNKNOWNS = 60
# Up to this many contacts all 4^m combinations are tried in rational numbers before absence is claimed.
MOST_PROVEN = 4
NONE_IN_FLOATS = "enumeration: floats found no combination of open, stick and slip that is an equilibrium"
NONE_AT_ALL = "enumeration: no combination of open, stick and slip is an equilibrium, proven in rational numbers"
SEVERAL = (
    "enumeration: {} equilibria, and nothing in the problem chooses ({}); "
    "contactqp.equilibria(problem) returns them all"
)


@dataclass(frozen=True, eq=False)
class ExactEquilibrium(AnswerOf[NDArray[Any], NDArray[Any]], ReadOnly):
    """One equilibrium in rational numbers: arrays of Fractions, signs and shapes of `contactqp.Solution`."""

    gap: NDArray[Any]  # (m,), the float inf where a contact never closes
    slip: NDArray[Any]  # (m, 1)
    contact_status: tuple[str, ...]  # (m,) of "open" | "closed" | "grazing" | "stick" | "slip"
    continuum: bool  # whether it belongs to a continuum of equilibria
    unique_forces: bool  # whether its contact forces are unique

    def __repr__(self) -> str:
        many = ", one of a continuum" if self.continuum else ""
        unknowns = counted("unknown", len(self.displacement))
        return f"ExactEquilibrium({unknowns}, contacts: {', '.join(self.contact_status)}{many})"


@checked
@own_floating_point
def exact_equilibria(problem: ContactProblem, **exact: Any) -> tuple[ExactEquilibrium, ...]:
    """Return all equilibria of a frictional problem in the plane in rational numbers, by all combinations of states.

    Parameters
    ----------
    problem : ContactProblem
        With friction, at most six contacts and sixty unknowns, one tangential row a contact. Its floats are taken as
        they stand.
    **exact
        `stiffness`, `load`, `normal`, `gap`, `tangent`, `friction`, `slip_origin`, `tie`, `tie_value`: exact values
        (Fraction, int, or text such as "68831/10" and "0.3") that take the place of the problem's floats, which must be
        their rounding.

    Returns
    -------
    tuple of ExactEquilibrium
        One equilibrium for each displacement; the tuple is empty where no equilibrium exists. For a continuum of
        displacements one member is given for each combination of states that has one. Motions that nothing resists, not
        even contacts, are left out: the displacement is the one of least norm.

    Raises
    ------
    InvalidProblem
        There is no friction, or an exact value does not belong to the problem.
    Unsupported
        There are too many contacts or unknowns, as for a meshed body, or two tangential rows a contact.
        `contactqp.equilibria` lists, in doubles, the equilibria of at most eight contacts on any number of unknowns.

    Examples
    --------
    A pad of 10 N that is pulled by 5 N on a spring of 1 N/m, mu = 3/10: it slides two metres.

    >>> import contactqp as cq
    >>> pad = cq.ContactProblem(
    ...     stiffness=[[1.0, 0.0], [0.0, 0.0]], load=[5.0, -10.0], normal=[[0.0, -1.0]], gap=[0.0],
    ...     tangent=[[1.0, 0.0]], friction=0.3,
    ... )
    >>> [state] = exact_equilibria(pad, friction="3/10")
    >>> state.displacement, state.friction_force[0, 0], state.contact_status
    (array([Fraction(2, 1), Fraction(0, 1)], dtype=object), Fraction(3, 1), ('slip',))
    """
    if not problem.frictional or problem.slip_origin is None:
        raise InvalidProblem("exact_equilibria: expected a problem with friction")
    if problem.slip_origin.shape[1] > 1:
        raise Unsupported("exact_equilibria: two tangential rows a contact; slip directions in space cannot be listed")
    closing = int(np.sum(problem.gap < np.inf))
    for count, most, what in ((closing, MOST_CONTACTS, "contacts"), (problem.dimension, MOST_UNKNOWNS, "unknowns")):
        if count > most:
            listed = refuse_many(closing) is None
            beside = "; contactqp.equilibria lists those of this problem in doubles" if listed else ""
            raise Unsupported(
                f"exact_equilibria: {count} {what}; at most {most} are few enough for rational numbers{beside}"
            )
    return _listed(_Bodies(ExactData(problem, exact)))


def rounded_equilibria(problem: ContactProblem) -> list[Answer]:
    """Return all equilibria in rational numbers, rounded to doubles."""
    names = ("displacement", "normal_force", "friction_force", "tie_force")
    every = _listed(_Bodies(ExactData(problem, {})))
    return [Answer(*(_doubles(getattr(one, name)) for name in names)) for one in every]


def refuse_parts_without_equilibrium(problem: ContactProblem) -> None:
    """Raise NoEquilibrium if bodies that nothing joins to the others have none in rational numbers."""
    for part, named in separate_parts(problem):
        if part.contacts <= MOST_PROVEN and part.dimension <= MOST_UNKNOWNS and not rounded_equilibria(part):
            raise NoEquilibrium(f"{NONE_AT_ALL}, of the bodies at {named} alone")


def _doubles(values: NDArray[Any]) -> NDArray[np.float64]:
    """Return the nearest doubles of Fractions, all infinite where one is beyond doubles."""
    try:
        return values.astype(float)
    except OverflowError:
        return np.full(values.shape, np.inf)


def _listed(bodies: _Bodies) -> tuple[ExactEquilibrium, ...]:
    states = zip(bodies.data.never, bodies.data.friction, strict=True)
    choices = [(OPEN,) if never else plane_states(mu) for never, mu in states]
    members = [found for status in combinations_of(choices) if (found := bodies.members(status)) is not None]
    points: list[Row] = []
    listed = []
    for one in members:
        u = one.displacement
        known = u in points or any(other.contains(u) for other in members if other is not one and other.continuum)
        if one.continuum or not known:
            points.append(u)
            forces = [force for other in members for force in other.forces(u)]
            listed.append(one.equilibrium(all(force == forces[0] for force in forces)))
    return tuple(listed)


class _Bodies:
    """Displacements and tie forces as affine functions of contact forces and free motions."""

    def __init__(self, data: ExactData) -> None:
        self.data, self.m = data, len(data.gap)
        n, k, m = len(data.load), len(data.tie), self.m
        # Unknowns (u, nu), then contact forces, then the right-hand side.
        rows = [
            [*data.stiffness[i], *(tie[i] for tie in data.tie), *(row[i] for row in data.normal + data.tangent), f]
            for i, f in enumerate(data.load)
        ]
        none = [ZERO] * (2 * m)
        rows += [[*tie, *[ZERO] * k, *none, b] for tie, b in zip(data.tie, data.tie_value, strict=True)]
        rows += [[*motion, *[ZERO] * k, *none, ZERO] for motion in self._unseen()]
        rows, pivots = reduced(rows, n + k)
        free = [j for j in range(n) if j not in pivots]
        self.size = 2 * m + len(free)
        # (u, nu) = start + slope y; redundant ties have zero forces.
        self._start, self._slope = [ZERO] * (n + k), [[ZERO] * self.size for _ in range(n + k)]
        for row, j in zip(rows, pivots, strict=False):
            self._start[j] = row[-1]
            self._slope[j] = [-x for x in (*row[n + k : n + k + 2 * m], *(row[i] for i in free))]
        for column, j in enumerate(free):
            self._slope[j][2 * m + column] = ONE
        self.balance = [
            [*row[n + k : n + k + 2 * m], *[ZERO] * len(free), row[-1]]
            for row in rows[len(pivots) :]
            if any(row[n + k :])
        ]
        self.gap = [self._length(row, limit) for row, limit in zip(data.normal, data.gap, strict=True)]
        self.slip = [self._length(row, limit) for row, limit in zip(data.tangent, data.slip_origin, strict=True)]

    def _unseen(self) -> list[Row]:
        """Return the motions that stiffness, ties and contacts do not resist, along which the displacement is set to
        zero.
        """
        data = self.data
        seen = [*data.stiffness, *data.normal, *data.tie]
        seen += [row for row, mu in zip(data.tangent, data.friction, strict=True) if mu]
        found = solutions([[*row, ZERO] for row in seen], len(data.load))
        return [] if found is None else found.free

    def _length(self, row: Row, limit: Fraction) -> Row:
        """Return row'u - limit as a form in y: its slope, and its constant last."""
        n = len(row)
        slope = [dot(row, [line[j] for line in self._slope[:n]]) for j in range(self.size)]
        return [*slope, dot(row, self._start[:n]) - limit]

    def members(self, status: tuple[int, ...]) -> _Members | None:
        """Return all equilibria in one combination, None where there are none."""
        refuse_late("every combination of open, stick and slip was tried in rational numbers")
        columns = _Columns(self, status)
        rows = [columns.of(row) for row in self.balance]
        for i, state in enumerate(status):
            if state != OPEN:
                rows.append(_equation(columns.of(self.gap[i])))
            if state == STICK:
                rows.append(_equation(columns.of(self.slip[i])))
        found = solutions(rows, columns.count)
        if found is None:
            return None
        members = _Members(self, columns, found, self._signs(status))
        return members if members.there else None

    def _signs(self, status: tuple[int, ...]) -> list[Row]:
        """Return the affine forms in y, constant last, that must not be negative."""
        m, mu, unit = self.m, self.data.friction, self.force_rows()
        return [
            sign
            for i, state in enumerate(status)
            for sign in _signs_of_law(state, mu[i], (unit[i], unit[m + i]), [-x for x in self.gap[i]], self.slip[i])
        ]

    def displacement_rows(self) -> list[Row]:
        return [[*slope, start] for slope, start in zip(self._slope, self._start, strict=True)][: len(self.data.load)]

    def force_rows(self) -> list[Row]:
        return [[ONE if j == at else ZERO for j in range(self.size + 1)] for at in range(2 * self.m)]

    def tie_rows(self) -> list[Row]:
        return [[*slope, start] for slope, start in zip(self._slope, self._start, strict=True)][len(self.data.load) :]


class _Columns:
    """The unknowns of a combination: l_N where closed, l_T where it sticks, a; where it slips l_T = s mu l_N."""

    def __init__(self, bodies: _Bodies, status: tuple[int, ...]) -> None:
        m = bodies.m
        self._parts: list[list[tuple[int, Fraction]]] = []
        for i, state in enumerate(status):
            if state == OPEN:
                continue
            along = [] if state == STICK else [(m + i, state * bodies.data.friction[i])]
            self._parts.append([(i, ONE), *along])
        self._parts += [[(m + i, ONE)] for i, state in enumerate(status) if state == STICK]
        self._parts += [[(j, ONE)] for j in range(2 * m, bodies.size)]
        self.count, self._size = len(self._parts), bodies.size

    def of(self, row: Row) -> Row:
        """Return an affine form in y, constant last, in terms of these unknowns."""
        return [*(sum((row[j] * share for j, share in part), ZERO) for part in self._parts), row[-1]]


class _Members:
    """All equilibria of one combination, a polyhedron in the c of y = point + free'c, usually a single point."""

    def __init__(self, bodies: _Bodies, columns: _Columns, found: Affine, signs: list[Row]) -> None:
        self._bodies, self._columns, self._found = bodies, columns, found
        self._moved = [self._image(row) for row in bodies.displacement_rows()]
        self._forces = [self._image(row) for row in bodies.force_rows()]
        self._region = Region([self._image(sign) for sign in signs], len(found.free))
        self.there, self.continuum = not self._region.empty, False
        if self.there:
            self._at = self._region.point()
            ends = self._region.ends([slope for _, slope in self._moved])
            self.continuum = ends is None or bool(ends)
            if ends:
                self._at = [sum(values, ZERO) / len(ends) for values in zip(*ends, strict=True)]
            self.displacement = [value + dot(slope, self._at) for value, slope in self._moved]

    def _image(self, row: Row) -> tuple[Fraction, Row]:
        """Return a form in y, its constant last, as its value at c = 0 and its slope in c."""
        own = self._columns.of(row)
        value, slope = self._found.image(own[:-1])
        return value + own[-1], slope

    def _value(self, row: Row) -> Fraction:
        value, slope = self._image(row)
        return value + dot(slope, self._at)

    def _within(self, displacement: Row) -> tuple[Affine, Region] | None:
        """Return the solutions with a given displacement, in coordinates of their own."""
        equations = [[*slope, u - value] for (value, slope), u in zip(self._moved, displacement, strict=True)]
        found = solutions(equations, len(self._found.free))
        if found is None:
            return None
        signs = [(room + value, slope) for room, (value, slope) in self._region.seen_from(found)]
        return found, Region(signs, len(found.free))

    def contains(self, displacement: Row) -> bool:
        """Return whether a displacement is one of these."""
        within = self._within(displacement)
        return within is not None and not within[1].empty

    def forces(self, displacement: Row) -> list[Row]:
        """Return contact forces for one displacement: none, the unique ones, or two different ones if there are
        many.
        """
        within = self._within(displacement)
        if within is None or within[1].empty:
            return []
        found, region = within
        images = [(value, found.image(slope)) for value, slope in self._forces]
        ends = region.ends([slope for _, (_, slope) in images])
        points = [region.point(), *(ends or [])]
        vectors = [[value + more + dot(slope, c) for value, (more, slope) in images] for c in points]
        # An unbounded set of forces contains many.
        return [vectors[0], []] if ends is None else [v for k, v in enumerate(vectors) if v not in vectors[:k]]

    def equilibrium(self, unique_forces: bool) -> ExactEquilibrium:
        bodies = self._bodies
        forces = [self._value(row) for row in bodies.force_rows()]
        normal, friction = forces[: bodies.m], forces[bodies.m :]
        gap, slip = [-self._value(row) for row in bodies.gap], [self._value(row) for row in bodies.slip]
        apart = [np.inf if never else one for one, never in zip(gap, bodies.data.apart, strict=True)]
        return ExactEquilibrium(
            displacement=_array(self.displacement),
            normal_force=_array(normal),
            friction_force=_array(friction)[:, None],
            tie_force=_array([self._value(row) for row in bodies.tie_rows()]),
            gap=_array(apart),
            slip=_array(slip)[:, None],
            contact_status=tuple(map(_status, normal, gap, slip, bodies.data.friction, bodies.data.never)),
            continuum=self.continuum,
            unique_forces=unique_forces,
        )


def _signs_of_law(state: int, friction: Fraction, force: tuple[Row, Row], gap: Row, slip: Row) -> list[Row]:
    """Return the affine forms, constant last, that Coulomb's law requires to be nonnegative in one state of a
    contact.
    """
    push, drag = force
    if state == OPEN:
        return [gap]
    if state == STICK:
        return [push, *([friction * p + s * r for p, r in zip(push, drag, strict=True)] for s in (-1, 1))]
    return [push, *([[state * x for x in slip]] if friction else [])]


def _equation(form: Row) -> Row:
    """Return the equation form = 0 as a row (a, b) of a'x = b."""
    return [*form[:-1], -form[-1]]


def _status(force: Fraction, gap: Fraction, slip: Fraction, friction: Fraction, never: bool) -> str:
    if not force:
        return "open" if gap or never else "grazing"
    if not friction:
        return "closed"
    return "slip" if slip else "stick"


def _array(values: Sequence[Fraction | float]) -> NDArray[Any]:
    array = np.empty(len(values), dtype=object)
    array[:] = values
    return array


def has_local_equilibrium(problem: LocalProblem) -> bool:
    """Return whether forces (r, l) with V'r + R l + s = 0 satisfy Coulomb's law at every contact, u = W r + V l + q.

    Every combination of open, stick and slip either way is a linear system and a list of signs, decided exactly; the
    problem is in the plane, and there are at most 4^m of them.
    """
    m, p = problem.contacts, problem.joints
    W, V, R = (_fractions(matrix) for matrix in (problem.delassus, problem.bilateral, problem.bilateral_delassus))
    q, s = _row(problem.offset), _row(problem.bilateral_offset)
    mu = _row(problem.friction)
    joints = [[*(V[i][j] for i in range(2 * m)), *R[j], s[j]] for j in range(p)]
    velocity = [[*W[i], *V[i], q[i]] for i in range(2 * m)]  # forms in (r, l), their constant last
    force = [[ONE if j == i else ZERO for j in range(2 * m + p + 1)] for i in range(2 * m)]
    for states in all_combinations(mu):
        zero, signs = list(joints), list[Row]()
        for i, state in enumerate(states):
            push, drag, opens, slips = force[2 * i], force[2 * i + 1], velocity[2 * i], velocity[2 * i + 1]
            slides = drag if state == OPEN else [x + state * mu[i] * y for x, y in zip(drag, push, strict=True)]
            zero += [push if state == OPEN else opens, slips if state == STICK else slides]
            signs += _signs_of_law(state, mu[i], (push, drag), opens, slips)
        found = solutions([_equation(row) for row in zero], 2 * m + p)
        if found is None:
            continue
        images = [(value + sign[-1], slope) for sign in signs for value, slope in [found.image(sign[:-1])]]
        if not Region(images, len(found.free)).empty:
            return True
    return False


def _fractions(matrix: Any) -> list[Row]:
    dense = matrix.toarray() if hasattr(matrix, "toarray") else np.asarray(matrix)
    return [_row(row) for row in dense]


def _row(values: Any) -> Row:
    return [Fraction(float(x)) for x in np.asarray(values).ravel()]


def finite_gap(problem: ContactProblem) -> NDArray[np.float64]:
    """Return the gaps (m,) of a problem for rational numbers, which have no infinity.

    Raises Unsupported: one is infinite.
    """
    if (never := problem.gap == np.inf).any():
        i = int(np.argmax(never))
        raise Unsupported(f"{problem.contact_name(i)} never closes: infinity is not a rational number, leave it out")
    return problem.gap
