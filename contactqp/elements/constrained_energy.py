"""Minimise a quadratic energy made of parts with constraints, and return the state of each part at the minimum.

Each part contributes energy, internal unknowns and constraints, whose multipliers are its forces.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.errors import InvalidProblem, counted, shown
from contactqp.model.arguments import checks
from contactqp.model.arrays import Array, Vector, computes, own_floating_point
from contactqp.model.problem import ContactProblem, Units
from contactqp.model.problem_data import ReadOnly, is_number, is_whole, read_stiffness, read_vector
from contactqp.model.solution import Certificate, Solution
from contactqp.model.summary import Printed, Table, headline, largest, number, unknowns_table, verdict_of
from contactqp.solving.solve import solve

# A linear form of the unknowns by their names.
Form = Mapping[str, float]
# Below this number of unknowns a dense matrix costs nothing and is easier to inspect.
DENSE_SIZE = 64
# Unknowns without names are called by number.
MOST_NUMBERED = 1_000_000


@dataclass(frozen=True)
class Square:
    """The energy 1/2 stiffness (form(u) - offset)^2."""

    form: Form
    stiffness: float
    offset: float = 0.0


@dataclass(frozen=True)
class Condition:
    """The constraint form(u) <= bound, or form(u) = bound in a tie."""

    name: str
    form: Form
    bound: float


@dataclass(frozen=True)
class Contribution:
    """The unknowns, energy and constraints that a part adds."""

    internal: tuple[str, ...] = ()
    squares: tuple[Square, ...] = ()
    load: Form | None = None  # energy -load(u)
    unilateral: tuple[Condition, ...] = ()
    ties: tuple[Condition, ...] = ()


@dataclass(frozen=True)
class Found:
    """Unknowns and multipliers of a minimum, by their names."""

    unknown: Mapping[str, float]
    multiplier: Mapping[str, float]  # of the conditions; not negative for inequalities

    def value(self, form: Form) -> float:
        return float(sum(factor * self.unknown[name] for name, factor in form.items()))


@dataclass(frozen=True)
class PartState:
    """The state of one part at the minimum."""

    deformation: float  # elongation, rotation, or the bounded combination of unknowns
    force: float  # its sign is defined by the part
    status: str  # "taut" | "slack", "pushes" | "idle", "active" | "inactive", "elastic" | "yields", "tied"
    plastic: float = 0.0  # plastic part of the deformation


class Part(Protocol):
    """Anything with a name that adds energy or constraints."""

    @property
    def name(self) -> str: ...

    def contribution(self) -> Contribution:
        """Return what the part adds."""

    def state(self, found: Found) -> PartState:
        """Return the state of the part at a minimum."""


def read_form(part: str, given: Any) -> dict[str, float]:
    """Check a linear form given by the user and drop its zeros.

    Raises InvalidProblem: it is not a mapping from names to finite numbers, or zero.
    """
    if not isinstance(given, Mapping):
        raise InvalidProblem(
            f"{part}: expected a mapping from unknowns to factors, as {{'x': 1.0}}, got {shown(given)}"
        )
    form = {str(name): read_number(f"{part}: factor of {name!r}", factor) for name, factor in given.items()}
    form = {name: factor for name, factor in form.items() if factor}
    if not form:
        raise InvalidProblem(f"{part}: expected at least one unknown with a factor that is not zero, got {dict(given)}")
    return form


def read_number(what: str, value: Any, *, positive: bool = False) -> float:
    """Read a finite number.

    Raises InvalidProblem: it is not a number, not finite, or not positive where it must be.

    Parameters
    ----------
    what : str, the name of the number in messages
    value : object, the number as the user gave it
    positive : whether it must be above zero
    """
    expected = "a finite number above 0" if positive else "a finite number"
    if not is_number(value) or not np.isfinite(value) or (positive and not value > 0):
        raise InvalidProblem(f"{what}: expected {expected}, got {shown(value)}")
    return float(value)


def plus(form: Form, others: Iterable[tuple[str, float]]) -> dict[str, float]:
    """Return a form with coefficients of internal unknowns added."""
    return dict(form) | dict(others)


def minus(form: Form) -> dict[str, float]:
    return {name: -factor for name, factor in form.items()}


@checks
@computes
@dataclass(frozen=True, eq=False)
class ConstrainedEnergy:
    """The problem min 1/2 u'Ku - f'u + the energies of the parts, subject to their constraints.

    Parameters
    ----------
    unknowns : sequence of distinct str, or int
        Their names, or their number (the names are then "u0", "u1", ...).
    stiffness : (n, n) array or sparse matrix, optional
        K, symmetric positive semidefinite; zero by default.
    load : (n,) array, optional
        f; zero by default.
    parts : sequence of Spring, Cable, Strut, AtMost, AtLeast, Equal, Obstacle, PlasticHinge, or anything that is a
        `contactqp.elements.constrained_energy.Part`
    units : Units or mapping, optional
        As in `ContactProblem`; labels only.

    Attributes
    ----------
    problem : ContactProblem
        The same problem for `solve`, `certify` and `compare`: inequalities are its contacts, equalities its ties. Its
        energy is smaller by `constant`.

    Raises
    ------
    InvalidProblem
        Wrong shapes, repeated names, or a part with an undefined unknown; the message names it.

    Examples
    --------
    A cantilever of 2 kN/m hangs on a cable of 8 kN/m with 0.1 m of slack and carries 3 kN.

    >>> import contactqp as cq
    >>> energy = cq.ConstrainedEnergy(["w"], [[2.0]], [3.0], parts=[cq.Cable("cable", {"w": 1.0}, 8.0, slack=0.1)])
    >>> minimum = energy.solve()
    >>> round(minimum["w"], 12), round(minimum.parts["cable"].force, 12), minimum.certificate.passed
    (0.38, 2.24, True)
    """

    unknowns: Sequence[str] | int
    stiffness: Any = None
    load: ArrayLike | None = None
    parts: Sequence[Part] = ()
    units: Units | Mapping[str, str] | None = None
    problem: ContactProblem = field(init=False, repr=False)
    _contributions: Mapping[str, Contribution] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        names = self.unknowns
        if is_whole(names):
            if not 0 <= names <= MOST_NUMBERED:
                raise InvalidProblem(
                    f"unknowns: expected from 0 to {MOST_NUMBERED}, got {shown(names)}; a ContactProblem may have more"
                )
            names = tuple(f"u{j}" for j in range(int(names)))
        if isinstance(names, (str, bytes)) or not isinstance(names, Iterable):
            raise InvalidProblem(f"unknowns: expected names, or how many there are, got {shown(names)}")
        object.__setattr__(self, "unknowns", tuple(str(name) for name in names))
        object.__setattr__(self, "parts", tuple(self.parts))
        _refuse_twice("part", [part.name for part in self.parts])
        object.__setattr__(self, "_contributions", {part.name: part.contribution() for part in self.parts})
        _refuse_twice("unknown", self.all_unknowns)
        _refuse_twice("constraint", [condition.name for condition in chain(self._unilateral, self._ties)])
        stated = set(self.all_unknowns)
        for name, added in self._contributions.items():
            forms = [s.form for s in added.squares] + [c.form for c in (*added.unilateral, *added.ties)]
            for unknown in chain(*forms, added.load or ()):
                if unknown not in stated:
                    raise InvalidProblem(f"{name}: expected unknowns of {_some(self.names)}, got {shown(unknown)}")
        object.__setattr__(self, "problem", self._assembled())

    @property
    def names(self) -> tuple[str, ...]:
        """Return the user's unknowns."""
        return tuple(self.unknowns)  # type: ignore[arg-type]  # names, since __post_init__

    @property
    def all_unknowns(self) -> tuple[str, ...]:
        """Return the user's unknowns and the internal ones of parts."""
        return (*self.names, *chain.from_iterable(added.internal for added in self._contributions.values()))

    @property
    def _unilateral(self) -> tuple[Condition, ...]:
        return tuple(chain.from_iterable(added.unilateral for added in self._contributions.values()))

    @property
    def _ties(self) -> tuple[Condition, ...]:
        return tuple(chain.from_iterable(added.ties for added in self._contributions.values()))

    @property
    def constant(self) -> float:
        """Return the energy at u = 0: 1/2 k offset^2 of the prestressed parts."""
        squares = chain.from_iterable(added.squares for added in self._contributions.values())
        return float(sum(square.stiffness * square.offset * square.offset / 2 for square in squares))

    def _assembled(self) -> ContactProblem:
        own, places = len(self.names), {name: j for j, name in enumerate(self.all_unknowns)}
        n = len(places)
        load = np.zeros(n)
        if self.load is not None:
            load[:own] = read_vector("load", self.load, own)
        blocks = [self._user_stiffness(n)]
        for added in self._contributions.values():
            for square in added.squares:
                row = _row(square.form, places)
                blocks.append(sp.csc_matrix(square.stiffness * (row.T @ row)))
                load += square.stiffness * square.offset * row.toarray().ravel()
            for name, force in (added.load or {}).items():
                load[places[name]] += force
        stiffness = sum(blocks[1:], blocks[0])
        rows, ties = self._unilateral, self._ties
        return ContactProblem(
            stiffness=stiffness.toarray() if n <= DENSE_SIZE else sp.csc_array(stiffness),
            load=load,
            normal=_rows(rows, places),
            gap=[condition.bound for condition in rows],
            tie=_rows(ties, places) if ties else None,
            tie_value=[condition.bound for condition in ties] if ties else None,
            dof_names=self.all_unknowns,
            contact_names=[condition.name for condition in rows],
            units=self.units,
        )

    def _user_stiffness(self, n: int) -> Any:
        own = len(self.names)
        if self.stiffness is None:
            return sp.csc_matrix((n, n))
        K, *_ = read_stiffness(self.stiffness)
        if K.shape != (own, own):
            raise InvalidProblem(f"stiffness: expected shape {(own, own)}, got {K.shape}")
        entries = sp.coo_matrix(K)
        return sp.csc_matrix((entries.data, (entries.row, entries.col)), shape=(n, n))

    def solve(self, method: str = "active-set", **options: Any) -> ConstrainedMinimum:
        """Return the minimum; parameters and errors are those of `contactqp.solve`.

        Raises `NoEquilibrium` also for a load beyond the plastic limit.
        """
        return self.read(solve(self.problem, method, **options))

    def read(self, solution: Solution) -> ConstrainedMinimum:
        """Return the minimum that a solution of `problem` by any method describes, with the state of every part."""
        if solution.problem.dof_names != self.problem.dof_names:
            raise InvalidProblem("read: expected a solution of this energy's own problem")
        return ConstrainedMinimum(self, solution)


@computes
@dataclass(frozen=True, eq=False)
class ConstrainedMinimum(ReadOnly, Printed):
    """The minimum of the energy and the state of every part there; `minimum["x"]` is an unknown.

    `print(minimum)` shows the verdict, the unknowns, and the parts with the largest forces.
    """

    of: ConstrainedEnergy
    solution: Solution

    def __repr__(self) -> str:
        parts = counted("part", len(self.of.parts))
        return f"ConstrainedMinimum({parts}, {counted('unknown', len(self.of.names))}, {verdict_of(self.certificate)})"

    @own_floating_point
    def __str__(self) -> str:
        tables = [
            unknowns_table(self.solution, len(self.of.names)),
            _parts_table(self.parts, self.solution.problem.units),
        ]
        return "\n".join([*headline(self.solution, self.energy), *(table.text() for table in tables if table.rows)])

    @property
    def certificate(self) -> Certificate:
        """Return the certificate of the contact problem's solution that this minimum was read from."""
        return self.solution.certificate

    @property
    def displacement(self) -> Vector:
        """Return the user's unknowns (n,), in their order."""
        return np.asarray(self.solution.displacement[: len(self.of.names)])

    @property
    def energy(self) -> float:
        """Return 1/2 u'Ku - f'u and the energies of the parts."""
        return self.solution.energy + self.of.constant

    def __getitem__(self, name: str) -> float:
        return self._found.unknown[name]

    @property
    def multiplier(self) -> Mapping[str, float]:
        """Return the multiplier of every constraint by its name; those of inequalities are not negative."""
        return self._found.multiplier

    @cached_property
    def parts(self) -> Mapping[str, PartState]:
        """Return the elongation or value, force and status of each part at the minimum, by the name of the part."""
        return {part.name: part.state(self._found) for part in self.of.parts}

    @cached_property
    def _found(self) -> Found:
        problem, solution = self.of.problem, self.solution
        ties = [condition.name for condition in self.of._ties]
        return Found(
            unknown=_by_name(problem.dof_names or (), solution.displacement),
            multiplier=_by_name(problem.contact_names or (), solution.normal_force)
            | _by_name(ties, solution.tie_force),
        )


def _parts_table(parts: Mapping[str, PartState], units: Units) -> Table:
    """Return the table of parts with the largest forces: status, force and deformation."""
    states = list(parts.items())
    shown = largest(np.array([abs(state.force) for _, state in states]))
    rows = [(name, state.status, number(state.force), number(state.deformation)) for name, state in states]
    force, length = (f" [{unit}]" if unit else "" for unit in (units.force, units.length))
    few = f", the {len(shown)} of the largest forces" if len(shown) < len(states) else ""
    columns = ("", "status", f"force{force}", f"deformation{length}")
    return Table(f"{counted('part', len(states))}{few}", columns, tuple(rows[i] for i in shown))


def _by_name(names: Iterable[str], values: Array) -> dict[str, float]:
    return dict(zip(names, values.tolist(), strict=True))


def _row(form: Mapping[str, float], places: Mapping[str, int]) -> Any:
    columns = [places[name] for name in form]
    return sp.csr_matrix((list(form.values()), ([0] * len(columns), columns)), shape=(1, len(places)))


def _rows(conditions: Sequence[Condition], places: Mapping[str, int]) -> Any:
    if not conditions:
        return np.zeros((0, len(places)))
    return sp.vstack([_row(condition.form, places) for condition in conditions], format="csr")


def _refuse_twice(what: str, names: Iterable[str]) -> None:
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise InvalidProblem(f"{what}: expected distinct names, got {twice[0]!r} more than once")


def _some(names: Sequence[str]) -> str:
    shown = ", ".join(names[:6])
    return shown if len(names) <= 6 else f"{shown}, ... ({len(names)})"
