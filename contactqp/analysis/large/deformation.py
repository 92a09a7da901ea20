"""Define the equilibria of a large deformation, and their Newton iterations.

`LoadedBody` is a deformable body with contacts and ties: its residual at a displacement, and the Newton step there.
`LargeSolution` and `LargeHistory` are the results for the user.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.history import Energies, Event, History, contact_changes
from contactqp.errors import NotConverged
from contactqp.model.arrays import EPS, Array, Mask, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import ReadOnly, read_only
from contactqp.model.solution import Answer, HoldsAnswer, Solution

if TYPE_CHECKING:  # imported only if needed, as this module also recognises other analyses
    from contactqp.elements.deformable import ContactGeometry, Deformable, LinearisedContacts

# The rounding of an internal force in units of eps |K||u|: a few operations for each bar or quadrature point.
ROUNDING_OF_INTERNAL_FORCES = 64 * EPS


@dataclass(frozen=True, eq=False)
class Forces:
    """Multipliers, with the signs of a ContactProblem."""

    normal: Vector  # (m,) l_N, positive in compression
    tie: Vector  # (k,) nu
    friction: Array | None = None  # (m, d-1) l_T

    @property
    def largest(self) -> float:
        """Return the size of the largest normal force or tie force."""
        return float(max(np.max(abs(self.normal), initial=0.0), np.max(abs(self.tie), initial=0.0)))


@dataclass(frozen=True, eq=False)
class Instant:
    """The body at a displacement."""

    displacement: Vector  # (n,)
    internal: Vector  # (n,) the gradient of the energy
    contact: LinearisedContacts


@dataclass(frozen=True, eq=False)
class Imbalance:
    """The residuals of forces and lengths at a displacement, and whether they are negligible."""

    force: float  # the largest residual relative to the largest force
    length: float  # the largest error of a gap, slip or tie relative to the largest displacement
    nothing: bool  # both within tolerance, or within rounding
    lengths_are_met: bool  # rounding of lengths only
    residual: float  # the largest residual [force]
    largest_force: float  # [force]

    @property
    def size(self) -> float:
        """Return the larger of both residuals."""
        return max(self.force, self.length)


class LoadedBody:
    """The equations f_int(u) + E_N' l_N + E_T' l_T + A' nu = f of one body, with E_N, E_T and gaps in the current
    configuration.

    Parameters
    ----------
    body : Deformable, its internal forces f_int (n,) and their tangent K (n, n)
    contact : ContactGeometry or None, gaps and rows of its m contacts at a displacement; None without contacts
    tie : (k, n) sparse array, A, which no displacement changes; k may be 0
    friction : (m,) array, optional
        Coefficients of friction; None where there is none.
    """

    def __init__(
        self, body: Deformable, contact: ContactGeometry | None, tie: Any, friction: Vector | None = None
    ) -> None:
        self.body, self.contact, self.tie, self.friction = body, contact, tie, friction

    @property
    def dimension(self) -> int:
        """Return the number of unknowns n."""
        return self.body.dimension

    @property
    def contacts(self) -> int:
        """Return the number of contacts m."""
        return 0 if self.contact is None else self.contact.contacts

    @property
    def frictional(self) -> bool:
        """Return whether any contact has a positive coefficient of friction."""
        return bool(np.any(self.rough))

    @property
    def rough(self) -> Mask:
        """Return which contacts have a positive coefficient of friction, (m,)."""
        return np.zeros(self.contacts, dtype=bool) if self.friction is None else self.friction > 0

    @cached_property
    def unknown_names(self) -> tuple[str, ...] | None:
        """Return the names of the unknowns, if the body has them."""
        from contactqp.elements.deformable import unknown_names_of

        return unknown_names_of(self.body)

    def at(self, u: Vector) -> Instant:
        """Return the body at a displacement; raise InvalidProblem if this is inadmissible or a contact has no pair."""
        return Instant(u, np.asarray(self.body.internal_force(u)), self._contact(u))

    def _contact(self, u: Vector) -> LinearisedContacts:
        if self.contact is None:
            from contactqp.elements.deformable import LinearisedContacts

            none = np.zeros(0)
            return LinearisedContacts(none, sp.csr_array((0, self.dimension)), None, none)
        return self.contact.state(u)

    def no_forces(self) -> Forces:
        """Return zero forces."""
        return Forces(np.zeros(self.contacts), np.zeros(self.tie.shape[0]))

    def hessian(self, now: Instant, forces: Forces) -> Any:
        """Return K + curvature of the contacts under their forces, (n, n) CSC, symmetric [force / length].

        Raises NotConverged: an entry overflows.
        """
        K = sp.csc_array(self.body.tangent(now.displacement))
        if self.contact is not None and np.any(forces.normal):
            curvature = self.contact.curvature(now.displacement, forces.normal)
            K = K if curvature is None else sp.csc_array(K + curvature)
        if not np.all(np.isfinite(K.data)):
            raise NotConverged("the tangent has entries beyond 1.8e308; state the body in other units")
        return K

    def out_of_balance(self, now: Instant, load: Vector, forces: Forces | None = None) -> Vector:
        """Return f - f_int - E_N' l_N - E_T' l_T - A' nu, (n,) [force]."""
        residual = load - now.internal
        if forces is not None:
            residual = residual - now.contact.normal.T @ forces.normal - self.tie.T @ forces.tie
            if forces.friction is not None and now.contact.tangent is not None:
                residual = residual - now.contact.tangent.T @ forces.friction.ravel()
        return np.asarray(residual)

    def step_problem(
        self, now: Instant, K: Any, load: Vector, tie_value: Vector, slipped: Array | None = None
    ) -> ContactProblem:
        """Return the Newton step as a contact problem in the increment du.

        K du = f - f_int,  E_N du <= gap,  A du = b - A u

        Parameters
        ----------
        now : displacement u, internal forces, gaps and rows before the step
        K : (n, n) matrix [force / length], the tangent of the step
        load : (n,) array [force], f at the end of the load step
        tie_value : (k,) array [length], b at the end of the load step
        slipped : (m, d-1) array [length], optional
            The slip of the load step so far, s = E_T du + slipped; without it the step has no friction.
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
            dof_names=self.unknown_names,
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
        """Return the residuals of the body; `length_error` and `length_rounding` are those of gaps, slips and ties.

        Parameters
        ----------
        now : the configuration, its internal forces and contacts
        K : matrix (n, n), the tangent stiffness, which determines the rounding of internal forces
        load : (n,) array, the load at this instant [force]
        forces : the forces of contacts and ties
        length_error, length_rounding : arrays of any one size
            The errors of gaps, slips and ties, and their rounding [length].
        tolerance : relative to the largest force and the largest displacement
        """
        residual = abs(self.out_of_balance(now, load, forces))
        parts = [load, now.internal, now.contact.normal.T @ forces.normal, self.tie.T @ forces.tie]
        size = max(float(np.max(abs(part), initial=0.0)) for part in parts)
        rounding = ROUNDING_OF_INTERNAL_FORCES * (abs(K) @ abs(now.displacement))
        reach = float(np.max(abs(now.displacement), initial=0.0))
        met = bool(np.all(length_error <= tolerance * reach + length_rounding))
        nothing = bool(np.all(residual <= tolerance * size + rounding)) and met
        largest, worst = (float(np.max(errors, initial=0.0)) for errors in (residual, length_error))
        relative = largest / size if size else 0.0, worst / reach if reach else worst
        return Imbalance(*relative, nothing, met, largest, size)


@dataclass(frozen=True)
class NewtonIteration:
    """One step of Newton's method, and the residuals after it."""

    force_error: float  # the largest residual force relative to the largest force
    length_error: float  # the largest error of a linearised gap, slip or tie relative to the largest displacement
    fraction: float  # the fraction of the step that was taken
    shift: float  # added to the diagonal of an indefinite tangent for a descent direction [force / length], mostly 0
    changed: bool  # whether the closed contacts changed

    @property
    def error(self) -> float:
        """Return the larger of both residuals."""
        return max(self.force_error, self.length_error)


@dataclass(frozen=True, eq=False, repr=False)
class LargeSolution(Solution):
    """An equilibrium at a large displacement.

    `problem` is the last Newton step from u_0 = u - `increment`, in terms of the displacement: K is the tangent, f -
    f_int + K u_0 the load, E_N and E_T the rows and gap + E_N u_0 the gaps at u_0. The certificate is that of this
    problem. Gaps, slips and energy are those of u. `position` has the positions of the contacts, None if the body has
    none; nodes of a truss or a solid are at their coordinates plus the displacement.
    """

    load_factor: float = 0.0
    load: Vector = field(default_factory=lambda: np.zeros(0), repr=False)  # (n,) on the body
    tie_value: Vector = field(default_factory=lambda: np.zeros(0), repr=False)  # (k,) A u
    increment: Vector = field(default_factory=lambda: np.zeros(0), repr=False)  # (n,) the last step
    current_gap: Vector = field(default_factory=lambda: np.zeros(0), repr=False)
    current_slip: Array | None = field(default=None, repr=False)
    position: Array | None = field(default=None, repr=False)  # (m, d) of the contacts
    elastic: float = 0.0  # the energy of the body
    negative: int = 0  # number of motions with closed contacts and negative energy; 0: stable
    iterations: tuple[NewtonIteration, ...] = field(default=(), repr=False)
    load_rate: float = 1.0  # the rate of the load factor along an arc
    load_scale: float = 0.0  # the length of one unit of load factor on an arc [length]

    @property
    def gap(self) -> Vector:
        """Return the gaps in the current configuration, positive when open, (m,) [length]."""
        return self.current_gap

    @property
    def slip(self) -> Array | None:
        """Return the slips in the load step along the current tangents, (m, d-1) [length]."""
        return self.current_slip

    @property
    def energy(self) -> float:
        """Return the elastic energy minus f'u [force * length]."""
        return self.elastic - float(self.load @ self.displacement)

    @property
    def stable(self) -> bool:
        """Return whether no motion with the closed contacts closed decreases the energy."""
        return self.negative == 0


@dataclass(frozen=True, eq=False)
class LimitPoint(ReadOnly, HoldsAnswer):
    """A point of a path at which the load factor is greatest or least."""

    kind: str  # "maximum" or "minimum"
    load_factor: float
    answer: Answer = field(repr=False)
    after: int = 0  # index of the previous solution in the history
    smooth: bool = True  # False if a contact closes or opens there


@dataclass(frozen=True, eq=False)
class Snap:
    """A jump under load control, at a load factor between `low` and `high`."""

    low: float
    high: float
    located: bool  # whether the bracket is small relative to the step
    unknown: int  # the unknown that jumps furthest
    before: float  # its displacement [length]
    after: float

    @property
    def note(self) -> str:
        """Return the jump in words."""
        where = f"at load factor {self.high:.6g}"
        if not self.located:
            where = f"between the load factors {self.low:.6g} and {self.high:.6g}"
        return (
            f"snap-through {where}: the tangent loses its definiteness and unknown {self.unknown} jumps from "
            f"{self.before:.6g} to {self.after:.6g}, the next equilibrium down the energy"
        )


class LargeHistory(History):
    """The equilibria of a path; `times` are the load factors, which may decrease with arc-length control.

    Parameters
    ----------
    solutions : sequence of LargeSolution
    notes : iterable of str
        Notes on the path, such as jumps of its steps.
    limit_points : iterable of LimitPoint
        The limit points of paths by arc length and displacement control.
    events : iterable of Event, optional
        The changes of state; without them they are read off the solutions.
    snaps : iterable of Snap
        The jumps of load control.
    """

    time_label = "load factor"

    def __init__(
        self,
        solutions: Sequence[LargeSolution],
        notes: Iterable[str] = (),
        limit_points: Iterable[LimitPoint] = (),
        events: Iterable[Event] | None = None,
        snaps: Iterable[Snap] = (),
    ) -> None:
        found, located = list(solutions), tuple(notes)
        happened = _Found(found).events if events is None else partial(tuple, tuple(events))
        super().__init__(
            found,
            [solution.load_factor for solution in found],
            events=happened,
            energies=_Found(found).energies,
            notes=partial(tuple, located),
        )
        self.limit_points = tuple(limit_points)
        self.snaps = tuple(snaps)

    def __repr__(self) -> str:
        return super().__repr__() if len(self) else "LargeHistory(no solutions)"

    @property
    def iterations(self) -> tuple[tuple[NewtonIteration, ...], ...]:
        """Return for every solution the residuals after each Newton step, which converge quadratically at the end."""
        return tuple(solution.iterations for solution in self._found)

    @property
    def stable(self) -> Mask:
        """Return whether each equilibrium is stable, (steps,)."""
        return read_only(np.array([solution.stable for solution in self._found]))

    @property
    def _found(self) -> Sequence[LargeSolution]:
        return [solution for solution in self if isinstance(solution, LargeSolution)]


@dataclass(frozen=True, eq=False)
class _Found:
    """Quantities of a history that are computed at first access."""

    solutions: Sequence[LargeSolution]

    def events(self) -> Iterator[Event]:
        """Return the contacts that close, open, slip or stick, at the first solution after it."""
        states = (_pushes_and_slides(solution) for solution in self.solutions)
        times = (solution.load_factor for solution in self.solutions)
        return contact_changes(states, times, lambda i: self.solutions[0].problem.contact_name(i))

    def energies(self) -> Iterator[Energies]:
        """Return the elastic energy of the body, the work of loads and ties by the trapezoidal rule, and the sum of
        l_T . s over the steps.

        If a path jumps, work and elastic energy differ by the released energy.
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


def _pushes_and_slides(solution: LargeSolution) -> tuple[Mask, Mask]:
    slides = solution.contact_status == "slip"
    return slides | (solution.contact_status == "stick") | (solution.normal_force > 0), slides
