"""A contact problem in rational numbers: its floats as they stand or a scene's unrounded numbers, and its proof."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from flint import fmpq, fmpq_mat

from contactqp.linalg.rational import column, from_fraction, matrix, rational, zeros
from contactqp.model.problem import ContactProblem

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
    T: fmpq_mat  # ((d-1) m, n), without rows where nothing rubs
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
        """Tangential rows of a contact, d - 1."""
        return int(self.T.nrows()) // self.contacts if self.contacts else 0

    def gap(self, u: fmpq_mat) -> fmpq_mat:
        """g - E_N u."""
        return self.g - self.E * u

    def slip(self, u: fmpq_mat) -> fmpq_mat:
        """E_T u - slip_origin."""
        return self.T * u - self.slip_origin


def of_floats(problem: ContactProblem) -> RationalProblem:
    """The floats as they stand; K as it was symmetrised."""
    T, friction, origin = zeros(0, problem.dimension), (fmpq(0),) * problem.contacts, zeros(0, 1)
    if problem.tangent is not None and problem.slip_origin is not None and problem.friction is not None:
        T, origin = matrix(problem.tangent), column(problem.slip_origin.ravel())
        friction = tuple(map(rational, problem.friction))
    return RationalProblem(
        K=matrix(problem.stiffness),
        f=column(problem.load),
        E=matrix(problem.normal),
        g=column(problem.finite_gap),
        A=matrix(problem.tie),
        b=column(problem.tie_value),
        T=T,
        friction=friction,
        slip_origin=origin,
    )


def of_scene(exact: ExactProblem) -> RationalProblem:
    """A scene's numbers on its free unknowns, all of them Fractions (`exact.rational`); K is symmetrised.

    As in the problem of floats, there are tangential rows only where there is friction.
    """
    free = exact.unknowns.free
    place = {name: i for i, name in enumerate(free)}
    n, m = len(free), len(exact.contacts)
    K = zeros(n, n)
    for (i, j), entry in exact.stiffness.items():
        if i in place and j in place:
            K[place[i], place[j]] = from_fraction(_exact(entry))
    K = (K + K.transpose()) / 2
    rubs = any(contact.friction for contact in exact.contacts)
    tangents = [row for contact in exact.contacts for row in contact.tangent] if rubs else []
    origins = [x for contact in exact.contacts for x in contact.slip_origin] if rubs else []
    return RationalProblem(
        K=K,
        f=_column(exact.load.get(name, Fraction(0)) for name in free),
        E=_rows([contact.normal for contact in exact.contacts], place),
        g=_column(contact.gap for contact in exact.contacts),
        A=_rows([tie.row for tie in exact.ties], place),
        b=_column(tie.value for tie in exact.ties),
        T=_rows(tangents, place),
        friction=tuple(from_fraction(contact.friction) for contact in exact.contacts) if rubs else (fmpq(0),) * m,
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


# Whether rational numbers solve a contact problem, statement by statement, with no tolerance.


@dataclass(frozen=True, eq=False)
class RationalAnswer:
    """Columns with the signs of `contactqp.Solution`."""

    displacement: fmpq_mat  # (n, 1)
    normal_force: fmpq_mat  # (m, 1)
    friction_force: fmpq_mat  # ((d-1) m, 1), without entries where nothing rubs
    tie_force: fmpq_mat  # (k, 1)


@dataclass(frozen=True)
class Wrong:
    """A statement that does not hold, and where: an unknown, a contact or a tie."""

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
    """Every statement that does not hold; none is a proof that the answer solves the problem."""
    u, push, rub = answer.displacement, answer.normal_force, answer.friction_force
    left = data.K * u + data.E.transpose() * push + data.A.transpose() * answer.tie_force - data.f
    if rub.nrows():
        left += data.T.transpose() * rub
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
    rub, forces = answer.friction_force.entries(), answer.normal_force.entries()
    for i, mu in enumerate(data.friction):
        force, moved = rub[width * i : width * (i + 1)], slip[width * i : width * (i + 1)]
        bound = mu * mu * forces[i] * forces[i]
        if _product(force, force) > bound:
            yield Wrong("cone", i)
        if mu == 0 or all(s == 0 for s in moved):
            continue
        along = _product(force, moved)
        # Cauchy and Schwarz: equality means parallel.
        parallel = along * along == _product(force, force) * _product(moved, moved)
        # What carries nothing has no direction of friction.
        if not (parallel and along >= 0 and _product(force, force) == bound):
            yield Wrong("slip direction", i)


def _product(one: list[fmpq], other: list[fmpq]) -> fmpq:
    return sum((x * y for x, y in zip(one, other, strict=True)), fmpq(0))


def status(data: RationalProblem, answer: RationalAnswer) -> tuple[str, ...]:
    """(m,) of "open" | "closed" | "grazing" | "stick" | "slip"."""
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
