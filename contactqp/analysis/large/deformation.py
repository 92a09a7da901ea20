"""A deformable body with its contacts and ties, and the equilibria of its large deformation with their iterations."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.analysis.history import Energies, Event, History
from contactqp.elements.deformable import ContactGeometry, ContactState, Deformable
from contactqp.model.arrays import Array, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import ReadOnly, read_only
from contactqp.model.solution import Solution

# A deformable body with its contacts and ties: what is out of balance at a displacement, and the Newton step there.

# Rounding of an internal force, in units of eps |K||u|: a few operations for each bar or quadrature point.
ROUNDING = 64 * np.finfo(float).eps


@dataclass(frozen=True, eq=False)
class Forces:
    """Multipliers, with the signs of a ContactProblem."""

    normal: Vector  # (m,) l_N, positive in compression
    tie: Vector  # (k,) nu
    friction: Array | None = None  # (m, d-1) l_T

    @property
    def largest(self) -> float:
        """The size of the largest normal force or tie force."""
        return float(max(np.max(abs(self.normal), initial=0.0), np.max(abs(self.tie), initial=0.0)))


@dataclass(frozen=True, eq=False)
class Instant:
    """The body at a displacement."""

    displacement: Vector  # (n,)
    internal: Vector  # (n,) the gradient of the energy
    contact: ContactState


@dataclass(frozen=True, eq=False)
class Imbalance:
    """What a displacement and forces leave, and whether that is nothing."""

    force: float  # the largest residual over the largest force that meets it
    length: float  # the largest error of a gap, slip or tie over the largest displacement
    nothing: bool  # both within tolerance, or within rounding

    @property
    def size(self) -> float:
        """The larger of both."""
        return max(self.force, self.length)


class LoadedBody:
    """The equations f_int(u) + E_N' l_N + E_T' l_T + A' nu = f of one body, with E_N, E_T and the gaps of now."""

    def __init__(
        self, body: Deformable, contact: ContactGeometry | None, tie: Any, friction: Vector | None = None
    ) -> None:
        self.body, self.contact, self.tie, self.friction = body, contact, tie, friction

    @property
    def dimension(self) -> int:
        """n."""
        return self.body.dimension

    @property
    def contacts(self) -> int:
        """m."""
        return 0 if self.contact is None else self.contact.contacts

    def at(self, u: Vector) -> Instant:
        """The body there; InvalidProblem where it cannot be or where a contact has lost its pair."""
        return Instant(u, np.asarray(self.body.internal_force(u)), self._contact(u))

    def _contact(self, u: Vector) -> ContactState:
        if self.contact is None:
            none = np.zeros(0)
            return ContactState(none, sp.csr_array((0, self.dimension)), None, none)
        return self.contact.state(u)

    def no_forces(self) -> Forces:
        """None acts."""
        return Forces(np.zeros(self.contacts), np.zeros(self.tie.shape[0]))

    def hessian(self, now: Instant, forces: Forces) -> Any:
        """K + curvature of the contacts under their forces, (n, n) CSC, symmetric."""
        K = sp.csc_array(self.body.tangent(now.displacement))
        if self.contact is not None and np.any(forces.normal):
            curvature = self.contact.curvature(now.displacement, forces.normal)
            K = K if curvature is None else sp.csc_array(K + curvature)
        return K

    def out_of_balance(self, now: Instant, load: Vector, forces: Forces | None = None) -> Vector:
        """f - f_int - E_N' l_N - E_T' l_T - A' nu, (n,) [force]."""
        left = load - now.internal
        if forces is not None:
            left = left - now.contact.normal.T @ forces.normal - self.tie.T @ forces.tie
            if forces.friction is not None and now.contact.tangent is not None:
                left = left - now.contact.tangent.T @ forces.friction.ravel()
        return np.asarray(left)

    def step_problem(
        self, now: Instant, K: Any, load: Vector, tie_value: Vector, slipped: Array | None = None
    ) -> ContactProblem:
        """The Newton step as a contact problem in the increment: K du = f - f_int, E_N du <= gap, A du = b - A u.

        `slipped` (m, d-1) is the slip of the load step so far: s = E_T du + slipped.
        """
        tangential: dict[str, Any] = {}
        if slipped is not None:
            tangential = dict(tangent=now.contact.tangent, friction=self.friction, slip_origin=-slipped)
        return ContactProblem(
            stiffness=K,
            load=load - now.internal,
            normal=now.contact.normal,
            gap=now.contact.gap,
            tie=self.tie,
            tie_value=tie_value - self.tie @ now.displacement,
            **tangential,
        )

    def imbalance(
        self,
        now: Instant,
        K: Any,
        load: Vector,
        forces: Forces,
        length_error: Vector,
        length_rounding: Vector,
        tolerance: float,
    ) -> Imbalance:
        """How far from balance the body is; lengths (any number,) are the errors of gaps, slips and ties."""
        residual = abs(self.out_of_balance(now, load, forces))
        parts = [load, now.internal, now.contact.normal.T @ forces.normal, self.tie.T @ forces.tie]
        size = max(float(np.max(abs(part), initial=0.0)) for part in parts)
        rounding = ROUNDING * (abs(K) @ abs(now.displacement))
        reach = float(np.max(abs(now.displacement), initial=0.0))
        nothing = bool(
            np.all(residual <= tolerance * size + rounding)
            and np.all(length_error <= tolerance * reach + length_rounding)
        )
        force = float(np.max(residual, initial=0.0)) / size if size else 0.0
        worst = float(np.max(length_error, initial=0.0))
        return Imbalance(force, worst / reach if reach else worst, nothing)


@dataclass(frozen=True)
class NewtonIteration:
    """One step of Newton's method, and what it left."""

    force_error: float  # the largest force out of balance over the largest force that acts
    length_error: float  # the largest error of a linearised gap, slip or tie over the largest displacement
    fraction: float  # of the step that was taken
    shift: float  # added to the diagonal of an indefinite tangent to find a way down [force / length]; mostly 0
    changed: bool  # whether other contacts are closed than before

    @property
    def error(self) -> float:
        """The larger of both errors."""
        return max(self.force_error, self.length_error)


@dataclass(frozen=True, eq=False)
class LargeSolution(Solution):
    """An equilibrium at a large displacement.

    `problem` is the last step of Newton's method, from u_0 = u - `increment`, written in the displacement: K is the
    tangent there, the load f - f_int + K u_0, E_N and E_T the rows and gap + E_N u_0 the gaps of there. The certificate
    is of that problem. Gaps, slips and energy are those of u itself.
    """

    load_factor: float = 0.0
    load: Vector = field(default_factory=lambda: np.zeros(0), repr=False)  # (n,) on the body
    tie_value: Vector = field(default_factory=lambda: np.zeros(0), repr=False)  # (k,) A u
    increment: Vector = field(default_factory=lambda: np.zeros(0), repr=False)  # (n,) the last step
    current_gap: Vector = field(default_factory=lambda: np.zeros(0), repr=False)
    current_slip: NDArray[np.float64] | None = field(default=None, repr=False)
    position: NDArray[np.float64] | None = field(default=None, repr=False)  # (m, d) of the contacts
    elastic: float = 0.0  # the energy of the body
    negative: int = 0  # motions without contact change that have negative energy; 0: stable
    iterations: tuple[NewtonIteration, ...] = field(default=(), repr=False)
    load_rate: float = 1.0  # how the load factor goes on along an arc; negative where it falls
    load_scale: float = 0.0  # the length of one unit of load factor on an arc [length]

    @property
    def gap(self) -> Vector:
        """The gaps there, positive when open [length]."""
        return self.current_gap

    @property
    def slip(self) -> NDArray[np.float64] | None:
        """(m, d-1): how far the contacts slid in the load step, along the tangents there [length]."""
        return self.current_slip

    @property
    def energy(self) -> float:
        """Elastic energy - f'u."""
        return self.elastic - float(self.load @ self.displacement)

    @property
    def stable(self) -> bool:
        """Whether no motion that keeps the closed contacts closed lowers the energy."""
        return self.negative == 0


@dataclass(frozen=True, eq=False)
class LimitPoint(ReadOnly):
    """A limit point: the load that a path carries is greatest or least there."""

    kind: str  # "maximum" or "minimum"
    load_factor: float
    displacement: Vector = field(repr=False)
    normal_force: Vector = field(repr=False)
    after: int = 0  # the solution of the history that comes before it
    smooth: bool = True  # False: a contact closes or opens there


@dataclass(frozen=True, eq=False)
class Snap:
    """A snap of load control, at a load factor between `low` and `high`."""

    low: float
    high: float
    told: bool  # whether it is known to a small part of the step
    unknown: int  # the one that jumps furthest
    before: float  # its displacement [length]
    after: float

    @property
    def note(self) -> str:
        """In words."""
        where = f"at load factor {self.high:.6g}"
        if not self.told:
            where = f"between the load factors {self.low:.6g} and {self.high:.6g}"
        return (
            f"snap-through {where}: the tangent loses its definiteness and unknown {self.unknown} jumps from "
            f"{self.before:.6g} to {self.after:.6g}, the next equilibrium down the energy"
        )


class LargeHistory(History):
    """The equilibria of a path; `times` are the load factors, which an arc length may take back and forth.

    `limit_points` are those of arc length and displacement control, `snaps` the jumps of load control.
    """

    def __init__(
        self,
        solutions: Sequence[LargeSolution],
        notes: Iterable[str] = (),
        limit_points: Iterable[LimitPoint] = (),
        events: Iterable[Event] | None = None,
        snaps: Iterable[Snap] = (),
    ) -> None:
        found, told = list(solutions), tuple(notes)
        happened = _Found(found).events if events is None else partial(tuple, tuple(events))
        super().__init__(
            found,
            [solution.load_factor for solution in found],
            events=happened,
            energies=_Found(found).energies,
            notes=partial(tuple, told),
        )
        self.limit_points = tuple(limit_points)
        self.snaps = tuple(snaps)

    def __repr__(self) -> str:
        return super().__repr__() if len(self) else "LargeHistory(no solutions)"

    @property
    def iterations(self) -> tuple[tuple[NewtonIteration, ...], ...]:
        """What each Newton step of every solution left: squared from one to the next at the end."""
        return tuple(solution.iterations for solution in self._found)

    @property
    def stable(self) -> NDArray[np.bool_]:
        """(steps,) whether each equilibrium is."""
        return read_only(np.array([solution.stable for solution in self._found]))

    @property
    def _found(self) -> Sequence[LargeSolution]:
        return [solution for solution in self if isinstance(solution, LargeSolution)]


@dataclass(frozen=True, eq=False)
class _Found:
    """What is computed of a history when it is asked for."""

    solutions: Sequence[LargeSolution]

    def events(self) -> Iterator[Event]:
        """Contacts that close, open, slip or stick, at the first solution that shows it."""
        for before, now in pairwise(self.solutions):
            for i in range(len(now.normal_force)):
                for kind in _kinds(_doing(before, i), _doing(now, i)):
                    yield Event(kind, i, now.load_factor, now.problem.contact_name(i))

    def energies(self) -> Iterator[Energies]:
        """Elastic energy of the body; the work of loads and ties by the trapezoidal rule; l_T . s of every step.

        Where a path jumps, work and elastic energy differ by what the jump sets free.
        """
        work = dissipated = 0.0
        for k, now in enumerate(self.solutions):
            if k:
                before = self.solutions[k - 1]
                work += float((before.load + now.load) @ (now.displacement - before.displacement)) / 2
                work -= float((before.tie_force + now.tie_force) @ (now.tie_value - before.tie_value)) / 2
                if now.friction_force is not None and now.slip is not None:
                    dissipated += float(np.sum(np.maximum(np.sum(now.friction_force * now.slip, axis=1), 0.0)))
            yield Energies(now.elastic, kinetic=0.0, work=work, dissipated=dissipated)


def _doing(solution: LargeSolution, i: int) -> str:
    status = str(solution.contact_status[i])
    return status if status in ("stick", "slip") else "closed" if solution.normal_force[i] > 0 else "open"


def _kinds(before: str, now: str) -> list[str]:
    """The events that lead from one state to the next."""
    if before == now:
        return []
    if now == "open":
        return ["opened"]
    closes = ["closed"] if before == "open" else []
    slips = ["slip"] if now == "slip" else []
    sticks = ["stick"] if now == "stick" and before == "slip" else []
    return closes + slips + sticks
