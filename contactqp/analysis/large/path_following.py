"""Follow paths through limit points, by arc length or displacement control, from contact event to contact event.

If a path breaks off, the error has the history so far.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.history import Event
from contactqp.analysis.large.active_kkt import by_signs
from contactqp.analysis.large.deformation import LargeHistory, LargeSolution, LimitPoint, LoadedBody
from contactqp.analysis.large.load_control import LoadControl, Program, forces_of, large_solution
from contactqp.analysis.large.newton_step import NewtonSettings
from contactqp.analysis.large.path_equations import (
    SHARP,
    Control,
    Direction,
    PathEquations,
    PathPoint,
    Sphere,
    Touch,
    Unknown,
)
from contactqp.errors import NotConverged
from contactqp.model.arrays import EPS, Mask, Vector
from contactqp.model.solution import Answer

# The most halvings of a failing step.
HALVINGS = 12
# Contact forces below this part of the largest force are rounding.
TENSION = 1e-12
# The least component of the direction along an unknown that counts as moving.
STILL = 1e-12
# An unknown has reached its value if this part of its whole change remains.
REACHED = 1e-13


@dataclass(frozen=True, eq=False)
class ByArc:
    """Steps of one length along the path."""

    radius: float

    def control(self, path: PathEquations, start: PathPoint, direction: Direction, part: float) -> Control:  # noqa: ARG002
        """Return the sphere about the start of the step.

        Parameters
        ----------
        path : PathEquations
        start : PathPoint
        direction : Direction
            Not used: the sphere does not depend on it.
        part : float
            The part of the radius that the step takes, after halvings.
        """
        return Sphere(start.displacement, start.load_factor, path.scale, part * self.radius)

    def length(self, direction: Direction, part: float) -> float:  # noqa: ARG002
        """Return the length along the direction to the guess."""
        return part * self.radius


@dataclass(frozen=True, eq=False)
class ByUnknown:
    """Steps to a value of one unknown."""

    place: int
    change: float  # change from the start of the step

    def control(self, path: PathEquations, start: PathPoint, direction: Direction, part: float) -> Control:  # noqa: ARG002
        """Return the control u_j = its value at the start plus a part of the change.

        Parameters
        ----------
        path : PathEquations
            Not used.
        start : PathPoint
        direction : Direction
            Not used.
        part : float
            The part of the change that the step takes, after halvings.
        """
        return Unknown(self.place, start.displacement[self.place] + part * self.change)

    def length(self, direction: Direction, part: float) -> float:
        """Return the length along the direction to the guess.

        Raises
        ------
        NotConverged
            The path continues in the opposite direction, or not along that unknown.
        """
        rate = float(direction.displacement[self.place])
        if rate * self.change <= STILL * abs(self.change):
            raise NotConverged(f"unknown {self.place} can go no further: the path turns back or a contact holds it")
        return part * self.change / rate


Pace = ByArc | ByUnknown


class PathFollower:
    """A path followed point by point, with separate points at events and limit points."""

    def __init__(self, path: PathEquations, start: LargeSolution, towards: ByUnknown | None = None) -> None:
        self.path = path
        self.solutions: list[LargeSolution] = [start]
        self.notes: list[str] = []
        self.limit_points: list[LimitPoint] = []
        self.events: list[Event] = []
        self._negative: int | None = start.negative  # on the contacts closed after the point, if known
        self._point = PathPoint(path.loaded.at(start.displacement), start.load_factor, forces_of(start))
        self._closed = start.normal_force > 0
        sense = float(np.sign(start.load_rate))
        closed, ahead = self._set_out(sense)
        if towards is not None and ahead.displacement[towards.place] * towards.change < 0:
            closed, ahead = self._set_out(-sense)
        if start.load_scale == 0:
            # The displacement per unit of load at the start, or up to it.
            size = float(np.linalg.norm(ahead.displacement)) / abs(ahead.load_factor)
            far, load = float(np.linalg.norm(start.displacement)), abs(start.load_factor)
            self.path = replace(path, scale=size or (far / load if far and load else 1.0))
            ahead = self.path.onwards(self._point, closed, ahead)
        self._closed, self._direction = closed, ahead

    def _set_out(self, sense: float) -> tuple[Mask, Direction]:
        """Return the closed contacts and the direction from the start, with the load rising or falling."""
        contact, nothing = self._point.now.contact, np.zeros(len(self.path.load))
        touching = ~self._closed & (contact.gap <= contact.rounding)
        closed = self._first_closed(touching, sense) if np.any(touching) else self._closed
        return closed, self.path.direction(self._point, closed, nothing, sense)

    @property
    def history(self) -> LargeHistory:
        """Return the history so far."""
        return LargeHistory(self.solutions, self.notes, self.limit_points, self.events)

    @property
    def reached(self) -> PathPoint:
        """Return the last point."""
        return self._point

    @property
    def rate(self) -> Direction:
        """Return the direction in which the path continues from the last point."""
        return self._direction

    def _first_closed(self, touching: Mask, sense: float) -> Mask:
        """Return the closed contacts, including those that touch without force if the load presses them."""
        now, path = self._point.now, self.path
        which = np.flatnonzero(touching)
        K = path.loaded.hessian(now, self._point.forces)
        constrained = sp.vstack([now.contact.normal[np.flatnonzero(self._closed)], path.loaded.tie], format="csr")
        value = np.concatenate([np.zeros(int(np.sum(self._closed))), sense * path.tie_rate])
        rows, none = now.contact.normal[which], np.zeros(len(which))
        _, _, _, pressed = by_signs(
            K, sense * path.load, rows, none, constrained, value, np.ones(len(which), dtype=bool)
        )
        closed = self._closed.copy()
        closed[which[pressed]] = True
        return closed

    def advance(self, pace: Pace) -> None:
        """Advance by one step, or up to the first contact that closes or opens.

        Raises
        ------
        NotConverged
        """
        part, failure = 1.0, None
        for halving in range(HALVINGS):
            try:
                point = self._to(pace, part)
                event = self._first_event(point)
                if event is None:
                    onwards = self.path.onwards(point, self._closed, self._direction)
                    if halving + 1 < HALVINGS:
                        self._refuse_sharp(point, onwards)
                    self._keep(point, self._closed, onwards, pace, part)
                else:
                    self._switch(*event, pace, part)
            except NotConverged as error:
                failure, part = error, part / 2
                continue
            return
        raise NotConverged(f"no part of a step along the path converges: {failure}") from failure

    def _refuse_sharp(self, point: PathPoint, onwards: Direction) -> None:
        """Raise NotConverged if the path turns too sharply to a point, or goes back."""
        start, ahead, path = self._point, self._direction, self.path
        moved, risen = point.displacement - start.displacement, point.load_factor - start.load_factor
        for direction in (ahead, onwards):
            along = moved @ direction.displacement + path.scale**2 * risen * direction.load_factor
            if along <= 0:
                raise NotConverged("the step turns back")
        if path.cosine(ahead, onwards) < SHARP:
            raise NotConverged("the path turns sharply")

    def _to(self, pace: Pace, part: float, *, finished: bool = True) -> PathPoint:
        """Return the point at a part of the step on the currently closed contacts."""
        start, ahead = self._point, self._direction
        far = pace.length(ahead, part)
        forces = replace(
            start.forces,
            normal=start.forces.normal + far * ahead.normal,
            tie=start.forces.tie + far * ahead.tie,
        )
        u, t = start.displacement + far * ahead.displacement, start.load_factor + far * ahead.load_factor
        control = pace.control(self.path, start, ahead, part)
        return self.path.point(u, t, forces, self._closed, control, finished=finished)

    def _first_event(self, point: PathPoint) -> tuple[int, PathPoint] | None:
        """Return the contact that first closes or opens before a point, and the part of the step."""
        found: tuple[int, PathPoint] | None = None
        for _ in range(2 * self.path.loaded.contacts + 1):
            wrong = self._fractions(point)
            if not wrong:
                return found
            i = min(wrong, key=lambda contact: wrong[contact])
            start, part = self._point, wrong[i]
            closed = self._closed.copy()
            closed[i] = False
            u = start.displacement + part * (point.displacement - start.displacement)
            t = start.load_factor + part * (point.load_factor - start.load_factor)
            found = i, self.path.point(u, t, point.forces, closed, Touch(i))
            point = found[1]
        raise NotConverged("contacts close and open one before the other")

    def _fractions(self, point: PathPoint) -> dict[int, float]:
        """Return for every contact with overlap or tension at a point where it began, by linear interpolation."""
        before, gap, force = self._point, point.now.contact.gap, point.forces.normal
        tension = TENSION * max(point.forces.largest, float(np.max(abs(point.now.internal), initial=0.0)))
        overlaps = ~self._closed & (gap < -point.now.contact.rounding)
        pulls = self._closed & (force < -tension)
        found: dict[int, float] = {}
        for i in np.flatnonzero(overlaps | pulls):
            was, now = (before.now.contact.gap[i], gap[i]) if overlaps[i] else (before.forces.normal[i], force[i])
            found[int(i)] = float(max(was, 0.0) / (max(was, 0.0) - now))
        return found

    def _switch(self, contact: int, point: PathPoint, pace: Pace, part: float) -> None:
        """Close or open the contact at the point, and change the direction of the path."""
        path, opens = self.path, bool(self._closed[contact])
        without = self._closed.copy()
        without[contact] = False
        arriving = path.onwards(point, self._closed, self._direction)
        unit = np.zeros(path.loaded.contacts)
        unit[contact] = 1.0
        nothing = np.zeros(len(path.load))
        if opens:
            row = -np.asarray(point.now.contact.normal[[contact]].toarray())[0]
            closed, leaving = without, path.direction(point, without, row, 0.0)
        else:
            closed = without.copy()
            closed[contact] = True
            leaving = path.direction(point, closed, nothing, 0.0, unit)
        self._keep(point, closed, leaving, pace, part, arriving)
        name = self.solutions[-1].problem.contact_name(contact)
        self.events.append(Event("opened" if opens else "closed", contact, point.load_factor, name))

    def _keep(
        self,
        point: PathPoint,
        closed: Mask,
        leaving: Direction,
        pace: Pace,
        part: float,
        arriving: Direction | None = None,
    ) -> None:
        """Append the point to the history, with the limit points before it."""
        if point.balance is None:
            raise ValueError("a point that was not finished")
        arriving = leaving if arriving is None else arriving
        path, start = self.path, self.solutions[-1]
        target = path.target(point.load_factor)
        if path.loaded.friction is not None:  # coefficients of zero: slips without forces
            target = replace(target, anchor=start.position)
        solution = large_solution(path.loaded, point.balance, target, point.load_factor, path.settings)
        solution = replace(solution, load_rate=leaving.load_factor, load_scale=path.scale)
        turns = self._direction.load_factor * arriving.load_factor < 0
        if turns:
            self.limit_points.append(self._limit(point, pace, part))
        elif self._negative not in (None, solution.negative):
            a, b = start.load_factor, point.load_factor
            self.notes.append(f"between the load factors {a:.6g} and {b:.6g} other equilibria branch off")
        if arriving.load_factor * leaving.load_factor < 0:
            self.limit_points.append(self._limit_at(point, arriving, smooth=False, after=len(self.solutions)))
        self.solutions.append(solution)
        self._negative = solution.negative if np.array_equal(closed, self._closed) else None
        self._point, self._closed, self._direction = point, closed, leaving

    def _limit(self, end: PathPoint, pace: Pace, part: float) -> LimitPoint:
        """Return the limit point, where t' vanishes between the last point and the next, by bracketing."""
        from scipy.optimize import brentq

        if isinstance(pace, ByArc):
            reach = self.path.distance(self._point, end) / pace.radius
        else:
            reach = (end.displacement[pace.place] - self._point.displacement[pace.place]) / pace.change

        def rate(fraction: float) -> float:
            if fraction == 0:
                return self._direction.load_factor
            point = self._to(pace, fraction, finished=False)
            return self.path.onwards(point, self._closed, self._direction).load_factor

        root = float(brentq(rate, 0.0, reach, xtol=1e-14 * part, rtol=8 * EPS))
        return self._limit_at(self._to(pace, root, finished=False), self._direction, True, len(self.solutions) - 1)

    def _limit_at(self, point: PathPoint, arriving: Direction, smooth: bool, after: int) -> LimitPoint:
        kind = "maximum" if arriving.load_factor > 0 else "minimum"
        forces = point.forces
        answer = Answer(point.displacement, forces.normal, forces.friction, forces.tie)
        return LimitPoint(kind, point.load_factor, answer, after, smooth)


@dataclass(frozen=True, eq=False)
class PathControl:
    """A body, its load and the settings of Newton's method, for paths through limit points."""

    loaded: LoadedBody
    program: Program
    settings: NewtonSettings

    def follow_arc(self, start: Vector | LargeSolution, steps: int, radius: float | None) -> LargeHistory:
        """Follow steps of equal arc length, by default that of 1/`steps` of the load at the start.

        Raises NotConverged: with the history so far.
        """
        follower = self._follower(self._at_rest(start), None)
        pace = ByArc(float(np.sqrt(2) * follower.path.scale / steps) if radius is None else radius)
        for _ in range(steps):
            _advance(follower, pace)
        return follower.history

    def follow_unknown(self, start: Vector | LargeSolution, steps: int, place: int, wanted: float) -> LargeHistory:
        """Follow equal steps of one unknown up to a value.

        Raises NotConverged: with the history so far.

        Parameters
        ----------
        start : (n,) array [length] or LargeSolution, where the path begins, as a guess or as an equilibrium
        steps : how many
        place : the number of the unknown, counted from 0
        wanted : float [length], its value at the end
        """
        at_rest = self._at_rest(start)
        first = float(at_rest.displacement[place])
        if wanted == first:
            return LargeHistory([at_rest])
        follower = self._follower(at_rest, ByUnknown(place, wanted - first))
        for k in range(1, steps + 1):
            value = wanted if k == steps else first + (wanted - first) * k / steps
            while abs(remaining := value - follower.reached.displacement[place]) > REACHED * abs(wanted - first):
                _advance(follower, ByUnknown(place, remaining))
        return follower.history

    def _at_rest(self, start: Vector | LargeSolution) -> LargeSolution:
        if isinstance(start, LargeSolution):
            return start
        try:
            return LoadControl(self.loaded, self.program, self.settings).first(start)
        except NotConverged as error:
            raise NotConverged(f"large_deformation: at load factor 0: {error}", LargeHistory([])) from error

    def _follower(self, start: LargeSolution, towards: ByUnknown | None) -> PathFollower:
        first, last = self.program.tie_values
        scale = start.load_scale or 1.0
        path = PathEquations(self.loaded, self.program.loads[1], first, last - first, self.settings, scale)
        try:
            return PathFollower(path, start, towards)
        except NotConverged as error:
            message = f"large_deformation: at load factor {start.load_factor:.6g}: {error}"
            raise NotConverged(message, LargeHistory([start]), start) from error


def _advance(follower: PathFollower, pace: Pace) -> None:
    try:
        follower.advance(pace)
    except NotConverged as error:
        last = follower.solutions[-1]
        message = f"large_deformation: after load factor {last.load_factor:.6g}: {error}"
        raise NotConverged(message, follower.history, last) from error
