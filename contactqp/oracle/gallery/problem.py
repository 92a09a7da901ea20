"""Define problems with known exact answers, in rational numbers (matrices as sparse rows of Fractions) and in
doubles.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.linalg.exact_algebra import Polyhedron, rank, solutions
from contactqp.model.arrays import Array, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import read_only
from contactqp.model.solution import AnswerOf

Row = Mapping[int, Fraction]
Rows = tuple[Row, ...]
Numbers = tuple[Fraction, ...]
Given = int | str | Fraction

ZERO = Fraction(0)
# The largest size of stiffnesses stored as dense arrays.
DENSE = 128


def numbers(values: Iterable[Given]) -> Numbers:
    """Return Fractions of integers, fractions and strings such as "3/7" and "6883.1"."""
    return tuple(Fraction(value) for value in values)


def rows_of(values: Iterable[Sequence[Given]]) -> Rows:
    """Return the sparse rows of dense ones."""
    return tuple({j: Fraction(x) for j, x in enumerate(row) if Fraction(x)} for row in values)


def clean(rows: Iterable[Mapping[int, Given]]) -> Rows:
    """Return the rows without zeros, with sorted columns."""
    return tuple({j: Fraction(row[j]) for j in sorted(row) if row[j]} for row in rows)


def times(rows: Rows, vector: Sequence[Fraction]) -> Numbers:
    """Return rows @ vector."""
    return tuple(sum((x * vector[j] for j, x in row.items()), ZERO) for row in rows)


def transposed_times(rows: Rows, vector: Sequence[Fraction], size: int) -> Numbers:
    """Return rows' @ vector, (size,)."""
    total = [ZERO] * size
    for row, value in zip(rows, vector, strict=True):
        if value:
            for j, x in row.items():
                total[j] += x * value
    return tuple(total)


def plus(*vectors: Sequence[Fraction]) -> Numbers:
    """Return the sum of vectors of equal length."""
    return tuple(sum(parts, ZERO) for parts in zip(*vectors, strict=True))


def columns_are_independent(rows: Rows, size: int) -> bool:
    """Return whether rows x = 0 has only the solution x = 0 (size,)."""
    return rank(transposed(rows, size)) == size


def transposed(rows: Rows, size: int) -> Rows:
    """Return the columns (size) as rows."""
    columns: list[dict[int, Fraction]] = [{} for _ in range(size)]
    for i, row in enumerate(rows):
        for j, x in row.items():
            columns[j][i] = x
    return tuple(columns)


def dominance(stiffness: Rows) -> Fraction:
    """Return min_i (K_ii - sum |K_ij|) of a symmetric K, a lower bound of its eigenvalues (Gershgorin 1931)."""
    return min(
        2 * row.get(i, ZERO) - sum((abs(x) for x in row.values()), ZERO)
        if row.get(i, ZERO) > 0
        else -sum((abs(x) for x in row.values()), ZERO)
        for i, row in enumerate(stiffness)
    )


def largest_row_sum(stiffness: Rows) -> Fraction:
    """Return max_i sum |K_ij|, an upper bound of the eigenvalues of a symmetric K."""
    return max(sum((abs(x) for x in row.values()), ZERO) for row in stiffness)


@dataclass(frozen=True)
class ExactProblem:
    """The data of a contact problem as rational numbers, with the names of `ContactProblem`."""

    stiffness: Rows
    load: Numbers
    normal: Rows
    gap: Numbers
    tangent: Rows = ()
    friction: Numbers = ()  # (m,), empty without friction
    slip_origin: Numbers = ()  # ((d-1) m,), empty without friction
    tie: Rows = ()
    tie_value: Numbers = ()

    @property
    def unknowns(self) -> int:
        """Return the number n of unknowns."""
        return len(self.stiffness)

    @property
    def contacts(self) -> int:
        """Return the number m of contacts."""
        return len(self.normal)

    @property
    def directions(self) -> int:
        """Return the number of slip directions of a contact: 0, 1 or 2."""
        return len(self.tangent) // len(self.normal) if self.normal else 0

    def floats(self) -> dict[str, Any]:
        """Return the arguments of `ContactProblem`, rounded to the nearest doubles."""
        n = self.unknowns
        stiffness = _matrix(self.stiffness, n)
        data: dict[str, Any] = dict(
            stiffness=stiffness if n > DENSE else stiffness.toarray(),
            load=_vector(self.load),
            normal=_matrix(self.normal, n),
            gap=_vector(self.gap),
        )
        if self.tangent:
            data |= dict(
                tangent=_matrix(self.tangent, n),
                friction=_vector(self.friction),
                slip_origin=_vector(self.slip_origin),
            )
        if self.tie:
            data |= dict(tie=_matrix(self.tie, n), tie_value=_vector(self.tie_value))
        return data

    def rounded(self) -> tuple[str, ...]:
        """Return the names of the data that are rounded to doubles."""
        found = []
        for each in fields(self):
            value: Any = getattr(self, each.name)
            flat = [x for row in value for x in (row.values() if isinstance(row, Mapping) else (row,))]
            if any(Fraction(float(x)) != x for x in flat):
                found.append(each.name)
        return tuple(found)


@dataclass(frozen=True)
class ExactAnswer(AnswerOf[Numbers, tuple[Numbers, ...]]):
    """The answer as rational numbers: K u + E_N'l_N + E_T'l_T + A'nu = f, l_N positive in compression.

    Friction forces are (m, d-1), and empty without friction.
    """

    gap: Numbers  # (m,) g - E_N u
    slip: tuple[Numbers, ...]  # (m, d-1) E_T u - slip_origin, empty without friction
    contact_status: tuple[str, ...]  # (m,) of open, closed, grazing, stick, slip


@dataclass(frozen=True)
class Contents:
    """The contents of a gallery problem."""

    data: ExactProblem
    exact: ExactAnswer
    description: str
    source: str
    formula: str  # the derivation of the answer
    unique_displacement: bool  # proven to be the only one
    unique_forces: bool  # whether the forces are proven to be unique
    rounding: Fraction  # largest relative change of the answer by rounding the data to doubles, 0 if none are rounded
    names: Mapping[str, Any]  # dof_names, contact_names, units


class GalleryProblem:
    """A contact problem with its exact answer, generated at the first use.

    Parameters
    ----------
    name, kind, difficulty : str
        The name gives the problem back: `contactqp.testing.problem(name)`.
    build : function that returns the Contents

    Attributes
    ----------
    problem : ContactProblem
    displacement, normal_force, friction_force, tie_force, gap
        The exact answer rounded to doubles, in the signs of `ContactProblem`: (n,), (m,) positive in compression,
        (m, d-1) or None without friction, (k,), (m,) positive when open. If `unique_forces` is false, the forces are
        one of several right answers.
    exact : ExactAnswer
        The same as Fractions, with slip and contact status.
    data : ExactProblem
        The problem as Fractions.
    unique_displacement, unique_forces : bool
        Whether the answer is proven to be unique.
    rounding : Fraction
        The largest relative change of the answer by rounding the data to doubles, 0 if none are rounded.
    description, formula, source : str
    """

    def __init__(self, name: str, kind: str, difficulty: str, build: Callable[[], Contents]) -> None:
        self.name, self.kind, self.difficulty, self._build = name, kind, difficulty, build

    @property
    def __name__(self) -> str:
        """Return the name, used by pytest for parameters of a test."""
        return self.name

    def __str__(self) -> str:
        return self.name

    def __repr__(self) -> str:
        return f"GalleryProblem({self.name!r})"

    @cached_property
    def _contents(self) -> Contents:
        return self._build()

    @property
    def data(self) -> ExactProblem:
        return self._contents.data

    @property
    def exact(self) -> ExactAnswer:
        return self._contents.exact

    @property
    def description(self) -> str:
        return self._contents.description

    @property
    def formula(self) -> str:
        return self._contents.formula

    @property
    def source(self) -> str:
        return self._contents.source

    @property
    def unique_displacement(self) -> bool:
        return self._contents.unique_displacement

    @property
    def unique_forces(self) -> bool:
        return self._contents.unique_forces

    @property
    def rounding(self) -> Fraction:
        return self._contents.rounding

    @cached_property
    def problem(self) -> ContactProblem:
        return ContactProblem(**self.data.floats(), **self._contents.names)

    @cached_property
    def displacement(self) -> Vector:
        return _vector(self.exact.displacement)

    @cached_property
    def normal_force(self) -> Vector:
        return _vector(self.exact.normal_force)

    @cached_property
    def friction_force(self) -> Array | None:
        if not self.data.tangent:
            return None
        return read_only(np.array([[float(x) for x in row] for row in self.exact.friction_force]))

    @cached_property
    def tie_force(self) -> Vector:
        return _vector(self.exact.tie_force)

    @cached_property
    def gap(self) -> Vector:
        return _vector(self.exact.gap)


def exact_answer(
    data: ExactProblem,
    displacement: Numbers,
    normal_force: Numbers,
    friction_force: Sequence[Numbers] = (),
    tie_force: Numbers = (),
) -> ExactAnswer:
    """Return an answer with its gaps, slips and states.

    Parameters
    ----------
    data : ExactProblem
    displacement, normal_force, friction_force, tie_force : sequences of Fraction; (m, d-1) for friction
    """
    gap = tuple(g - x for g, x in zip(data.gap, times(data.normal, displacement), strict=True))
    width = data.directions
    slid = tuple(x - o for x, o in zip(times(data.tangent, displacement), data.slip_origin, strict=True))
    slip = tuple(slid[i * width : (i + 1) * width] for i in range(len(gap))) if width else ()
    status = []
    for i, (opening, force) in enumerate(zip(gap, normal_force, strict=True)):
        rough = width and data.friction[i] > 0
        closed = ("slip" if any(slip[i]) else "stick") if rough else "closed"
        status.append("open" if opening > 0 else closed if force > 0 else "grazing")
    return ExactAnswer(displacement, normal_force, tuple(friction_force), tie_force, gap, slip, tuple(status))


def _vector(values: Sequence[Fraction]) -> Vector:
    return read_only(np.array([float(x) for x in values], dtype=float))


def _matrix(rows: Rows, n: int) -> Any:
    entries = [(i, j, float(x)) for i, row in enumerate(rows) for j, x in row.items() if x != ZERO]
    i, j, values = zip(*entries, strict=True) if entries else ((), (), ())
    return sp.csr_matrix((np.array(values, dtype=float), (i, j)), shape=(len(rows), n))


# Uniqueness of exact answers by exact ranks; "no" means "not proven".


def only_displacement(data: ExactProblem, answer: ExactAnswer) -> bool:
    """Return whether the displacement is proven to be unique.

    Without friction the answers form a convex set on which K u, the ties and the gaps of contacts with force are
    constant: a single point if K, A and these rows of E_N have no common null vector. With friction see
    `below_critical_friction`.
    """
    if any(data.friction) and not below_critical_friction(data):
        return False
    if dominance(data.stiffness) > 0:
        return True
    carrying = tuple(row for row, force in zip(data.normal, answer.normal_force, strict=True) if force > 0)
    return columns_are_independent((*data.stiffness, *data.tie, *carrying), data.unknowns)


def below_critical_friction(data: ExactProblem) -> bool:
    """Return whether friction is small enough for a unique answer: mu < least / largest eigenvalue of K (Gershgorin).

    Let the rows E of all contacts, divided by their lengths, be orthonormal, x = E (u - v) for two answers u and v, and
    H = (E K^-1 E')^-1. Signorini's and Coulomb's law give x'Hx <= mu |(Hx)_N| |x_T| <= mu |H| |x|^2, while x'Hx >=
    |x|^2 times the least eigenvalue of H, and the eigenvalues of H lie between those of K.
    """
    if not _orthogonal_frames(data) or data.tie:
        return False
    least = dominance(data.stiffness)
    return least > 0 and max(data.friction) < least / largest_row_sum(data.stiffness)


def _orthogonal_frames(data: ExactProblem) -> bool:
    """Return whether all rows are orthogonal, with equal lengths for each contact."""
    width = data.directions
    rows = [row for i, normal in enumerate(data.normal) for row in (normal, *data.tangent[i * width : (i + 1) * width])]
    lengths = [sum((x * x for x in row.values()), ZERO) for row in rows]
    if any(lengths[i] != lengths[i - i % (width + 1)] for i in range(len(rows))):
        return False
    meeting = [[i for i, _ in enumerate(rows) if j in rows[i]] for j in range(data.unknowns)]
    pairs = {(a, b) for rows_here in meeting for a in rows_here for b in rows_here if a < b}
    return all(sum((x * rows[b].get(j, ZERO) for j, x in rows[a].items()), ZERO) == 0 for a, b in pairs)


def only_forces(data: ExactProblem, answer: ExactAnswer, displacement_is_unique: bool) -> bool:
    """Return whether the forces are proven to be unique.

    The forces of a displacement are unique if the rows of closed contacts, their slip directions with friction, and the
    ties are independent. Without friction, if only contacts without force make them dependent, they are unique if no
    other forces are compressive (a linear program in rational numbers).
    """
    width = data.directions
    if any(data.friction) and not displacement_is_unique:
        return False
    closed = [i for i, gap in enumerate(answer.gap) if gap == 0]
    slipping = tuple(data.tangent[i * width + k] for i in closed for k in range(width) if data.friction[i] > 0)
    rows = (*(data.normal[i] for i in closed), *slipping, *data.tie)
    if rank(rows) == len(rows):
        return True
    carrying = [i for i in closed if answer.normal_force[i] > 0]
    strong = (*(data.normal[i] for i in carrying), *data.tie)
    if slipping or rank(strong) < len(strong):
        return False
    weak = tuple(data.normal[i] for i in closed if answer.normal_force[i] == 0)
    return not _other_compressions((*weak, *strong), len(weak), data.unknowns)


def _other_compressions(rows: Rows, weak: int, n: int) -> bool:
    """Return whether a nonzero combination of the rows vanishes, with nonnegative coefficients of the first `weak`
    ones.
    """
    found = solutions([[row.get(j, ZERO) for j in range(len(rows))] + [ZERO] for row in transposed(rows, n)], len(rows))
    free = found.free if found is not None else []
    slopes = [[direction[i] for direction in free] for i in range(weak)]
    growth = [sum(column, ZERO) for column in zip(*slopes, strict=True)]
    return Polyhedron([ZERO] * weak, slopes, len(free)).range(growth)[1] is None


# Gallery problems of few unknowns from dense rows of integers, fractions and strings.

Dense = Sequence[Sequence[Given]]


def stated(
    *,
    stiffness: Dense,
    load: Sequence[Given],
    normal: Dense = (),
    gap: Sequence[Given] = (),
    displacement: Sequence[Given],
    normal_force: Sequence[Given] = (),
    tangent: Dense = (),
    friction: Given = 0,
    friction_force: Dense = (),
    tie: Dense = (),
    tie_value: Sequence[Given] | None = None,
    tie_force: Sequence[Given] = (),
    description: str,
    source: str,
    formula: str,
    units: tuple[str, str] = ("", ""),
    unknowns: Sequence[str] | None = None,
    contacts: Sequence[str] | None = None,
    one_displacement: bool | None = None,
    rounding: Fraction = Fraction(0),
) -> Contents:
    """Return a problem and its answer; `units` are those of length and force, and a single coefficient of friction
    applies to all contacts.

    `one_displacement` states a proof of uniqueness that `only_displacement` does not find.

    Parameters
    ----------
    stiffness, load, normal, gap, tangent, tie, tie_value
        The data of the problem as rows of rational numbers; `tie_value` is zero without it.
    friction
        The coefficient of all contacts.
    displacement, normal_force, friction_force, tie_force
        The answer, which is proven when the problem is made.
    description, source, formula : what the problem shows, where it comes from, and its answer as a formula
    units : (str, str), of length and of force
    unknowns, contacts : sequences of str, optional
        Their names.
    one_displacement : true if a proof of uniqueness is known that `only_displacement` does not find
    rounding : by how much the answer to the problem in doubles may differ from this one, relative
    """
    rough = bool(tangent)
    data = ExactProblem(
        stiffness=rows_of(stiffness),
        load=numbers(load),
        normal=rows_of(normal),
        gap=numbers(gap),
        tangent=rows_of(tangent),
        friction=(Fraction(friction),) * len(normal) if rough else (),
        slip_origin=(Fraction(0),) * len(tangent),
        tie=rows_of(tie),
        tie_value=numbers([0] * len(tie) if tie_value is None else tie_value),
    )
    drags: list[Numbers] = [numbers(row) for row in friction_force]
    answer = exact_answer(data, numbers(displacement), numbers(normal_force), drags, numbers(tie_force))
    names: dict[str, Any] = dict(
        units=dict(zip(("length", "force"), units, strict=True)),
        dof_names=None if unknowns is None else tuple(unknowns),
        contact_names=None if contacts is None else tuple(contacts),
    )
    return with_uniqueness(data, answer, description, source, formula, names, one_displacement, rounding)


def with_uniqueness(
    data: ExactProblem,
    answer: ExactAnswer,
    description: str,
    source: str,
    formula: str,
    names: dict[str, Any],
    one_displacement: bool | None = None,
    rounding: Fraction = Fraction(0),
) -> Contents:
    """Return contents with uniqueness of the answer, if not stated, by exact ranks.

    Parameters
    ----------
    data, answer
        The problem and its exact answer.
    description, source, formula : what the problem shows, where it comes from, and its answer as a formula
    names : dict, the names of unknowns, contacts and units, as a ContactProblem takes them
    one_displacement : whether the displacement is unique, if known
    rounding : by how much the answer to the problem in doubles may differ from this one, relative
    """
    displacement = only_displacement(data, answer) if one_displacement is None else one_displacement
    forces = only_forces(data, answer, displacement)
    return Contents(data, answer, description, source, formula, displacement, forces, rounding, names)
