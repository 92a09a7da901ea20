"""Compute the steps of a motion: problems of the scheme, solved one by one and certified in blocks.

A step must resolve the duration of a contact, half a period of the slowest vibration excited by the impact. For
example, a rod of length L stays at a wall for 2 L / c, half the period of its slowest vibration with the touching end
fixed. In general the duration is pi / omega, with the lowest nonzero frequency omega with closed contacts that the
impact velocities excite, by Lanczos' method on the factorised operator of a time step.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.motion.mass_matrix import OTHERWISE, critical_step, slowest_frequency, touched
from contactqp.analysis.motion.motion_history import Motion, MotionHistory, notes_on_motion
from contactqp.analysis.motion.schemes.scheme import Scheme, State
from contactqp.analysis.motion.step_contact import StepContact, StepProblem, StepResult
from contactqp.errors import (
    BackendFailed,
    InvalidProblem,
    NoEquilibrium,
    NotCertified,
    NotConverged,
    SeveralEquilibria,
    TimeStepWarning,
    warn,
)
from contactqp.linalg.measures import (
    HELD_BY_DOUBLES,
    NOTHING_BY_DEFAULT,
    beyond,
    directions,
    lengths,
    ratio,
    reciprocal,
    row_sizes,
)
from contactqp.model.arrays import CERTIFY, METHOD, Array, Indices, Mask, Vector, in_any_time, refuse_late, stage
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import refuse_not_positive
from contactqp.model.solution import Work

FIGURES = ("equilibrium", "penetration", "tension", "complementarity", "cone", "slip_direction", "tie")
# A start is noted whose kinetic energy changes by more than this part as mass is moved; on a mesh it is an element's.
CHANGED = 0.1

Block = Array  # one row per step


@dataclass(frozen=True, eq=False)
class StepFigures:
    """The worst figures of each step of a block, (steps,) each; see `contactqp.certificate.certificate`."""

    equilibrium: Block
    penetration: Block
    tension: Block
    complementarity: Block
    cone: Block
    slip_direction: Block
    tie: Block

    def first_above(self, tolerance: float) -> tuple[int, str, float] | None:
        """Return the first step with a figure above a tolerance, the figure's name and value; NaN counts as
        infinite.
        """
        values = np.array([getattr(self, name) for name in FIGURES])
        values = np.where(np.isnan(values), np.inf, values)
        beyond = np.flatnonzero(np.any(values > tolerance, axis=0))
        if not len(beyond):
            return None
        step = int(beyond[0])
        worst = int(np.argmax(values[:, step]))
        return step, FIGURES[worst], float(values[worst, step])


class StepJudge:
    """The data of a template for computing figures."""

    def __init__(self, template: ContactProblem) -> None:
        self._problem = template
        self._K, self._N, self._A = template.stiffness_rows, template.normal, template.tie
        self._T = template.tangent if template.frictional else None
        self._sizes = tuple(abs(matrix) for matrix in (self._K, self._N, self._A))
        self._pushing, self._pushing_size = (sp.csr_matrix(rows.T) for rows in (self._N, self._sizes[1]))
        self._unit = np.sqrt(template.diagonal)
        self._compliance = {name: np.sqrt(row_sizes(template, rows).compliance) for name, rows in self._rows().items()}
        self._entries = sp.coo_matrix(abs(self._N))

    def _rows(self) -> dict[str, Any]:
        return {"normal": self._N, "tie": self._A} | ({} if self._T is None else {"tangent": self._T})

    def refused(
        self, posed: list[StepProblem], answered: list[StepResult], tolerance: float
    ) -> tuple[int, str, float] | None:
        """Return the first refused step of a block with name and value of its worst figure, or None."""
        if self._plainly_right(posed, answered, tolerance):
            return None
        return self.figures(posed, answered).first_above(tolerance)

    def _plainly_right(self, posed: list[StepProblem], answered: list[StepResult], tolerance: float) -> bool:
        """Return whether steps without friction or ties pass a simpler, stricter test.

        Residuals are within the tolerance times K_jj |x_j| + |E_N|'l_N, and gaps within that times |E_N||x| + |g|, so
        that the figures are no larger. It proceeds step by step to use the cache.
        """
        if self._problem.ties or self._T is not None:
            return False
        within = tolerance * self._problem.diagonal
        for p, a in zip(posed, answered, strict=True):
            residual, size = p.load - self._K @ a.increment, np.abs(a.unknown)
            pushes = bool(a.normal.any())
            if (pushes or p.closable is None or p.closable.any()) and not self._contacts_hold(p, a, size, tolerance):
                return False
            size *= within
            if pushes:
                residual -= self._pushing @ a.normal
                size += self._pushing_size @ (tolerance * a.normal)
            np.abs(residual, out=residual)
            if not (residual <= size).all():
                return False
        return True

    def _contacts_hold(self, p: StepProblem, a: StepResult, size: Vector, tolerance: float) -> bool:
        """Return whether no contact is in tension, gaps are not negative, and those of contacts with force are zero."""
        room, pushes = p.gap - self._N @ a.unknown, a.normal > 0
        seen = np.ones(len(room), dtype=bool) if p.closable is None else p.closable
        if (a.normal < 0).any() or (pushes & ~seen).any():
            return False
        wrong = (seen & (room < 0)) | (pushes & (room > 0))
        if not wrong.any():
            return True
        return not (wrong & (abs(room) > tolerance * (self._sizes[1] @ size + abs(p.gap)))).any()

    def figures(self, posed: list[StepProblem], answered: list[StepResult]) -> StepFigures:
        """Return the figures of a block of steps."""
        problem = self._problem
        x, (load, F) = np.column_stack([a.unknown for a in answered]), self._loads(posed)
        normal, tie = np.column_stack([a.normal for a in answered]), np.column_stack([a.tie for a in answered])
        friction, gap = np.column_stack([a.friction for a in answered]), np.column_stack([p.gap for p in posed])
        looked = np.column_stack([np.ones(len(p.gap), bool) if p.closable is None else p.closable for p in posed])
        size = abs(x)
        inner = self._sizes[0] @ size
        residual, F = load - self._K @ x, F + inner
        _, N, A = self._sizes
        if np.any(normal):
            residual, F = residual - self._N.T @ normal, F + N.T @ abs(normal)
        if problem.ties:
            residual, F = residual - self._A.T @ tie, F + A.T @ abs(tie)
        if self._T is not None:
            residual, F = residual - self._T.T @ friction, F + abs(self._T).T @ abs(friction)
        whole = self._intrinsic_size(load, x)
        none = np.maximum(NOTHING_BY_DEFAULT * whole * self._unit[:, None], HELD_BY_DOUBLES * inner)
        room, length = gap - self._N @ x, N @ size + abs(gap)
        room_measure = ratio(beyond(abs(room), self._no_length("normal", length, whole)), length)
        push, held = self._forces(normal, F, none), np.zeros_like(tie)
        if problem.ties:
            value = np.array([np.zeros(problem.ties) if p.tie_value is None else p.tie_value for p in posed]).T
            sizes = A @ size + abs(value)
            held = ratio(beyond(abs(self._A @ x - value), self._no_length("tie", sizes, whole)), sizes)
        cone, direction = self._coulomb(posed, x, normal, friction, F, whole)
        stray = ~looked & (normal != 0)  # a force at a contact that the step may not close
        return StepFigures(
            _worst(ratio(beyond(abs(residual), none), F)),
            _worst(np.where(looked & (room < 0), room_measure, 0.0)),
            _worst(np.where((normal < 0) | stray, push, 0.0)),
            _worst(np.where(looked & (room > 0) & (normal > 0), np.minimum(room_measure, push), 0.0)),
            cone,
            direction,
            _worst(held),
        )

    def _loads(self, posed: list[StepProblem]) -> tuple[Block, Block]:
        """Return f and its size, (n, steps) each; with a base the load is K base plus that on x - base."""
        load = np.column_stack([p.load for p in posed])
        bases = [p.base for p in posed if p.base is not None]
        if not bases:
            return load, abs(load)
        base = np.column_stack(bases)
        return load + self._K @ base, abs(load) + self._sizes[0] @ abs(base)

    def _intrinsic_size(self, load: Block, x: Block) -> Vector:
        """Return the size of each step, (steps,), as `contactqp.linalg.measures.intrinsic_size`.

        It is that of the loads and of |x|_K, including inertia.
        """
        D = reciprocal(self._unit)
        strain = np.sqrt(np.maximum(np.sum(x * (self._K @ x), axis=0), 0.0))
        return np.asarray(np.maximum(strain, np.max(D[:, None] * abs(load), axis=0, initial=0.0)))

    def _no_length(self, name: str, length: Block, whole: Vector) -> Block:
        """Return the lengths of rows below which lengths count as zero."""
        return np.maximum(NOTHING_BY_DEFAULT * whole * self._compliance[name][:, None], HELD_BY_DOUBLES * length)

    def _forces(self, force: Block, F: Block, none: Block) -> Block:
        """Return max_j |E_ij l_i| / F_j, (m, steps), with negligible forces as zero."""
        measure = np.zeros_like(force)
        acting = np.any(force != 0, axis=1)[self._entries.row]
        row, column, size = self._entries.row[acting], self._entries.col[acting], self._entries.data[acting]
        np.maximum.at(measure, row, ratio(beyond(size[:, None] * abs(force[row]), none[column]), F[column]))
        return measure

    def _coulomb(
        self, posed: list[StepProblem], x: Block, normal: Block, friction: Block, F: Block, whole: Vector
    ) -> tuple[Block, Block]:
        """Return `cone` and `slip_direction` (steps,), each the worst over the contacts."""
        steps, m = x.shape[1], len(normal)
        if self._T is None or not len(friction):
            return np.zeros(steps), np.zeros(steps)
        problem, width = self._problem, len(friction) // m
        origin = np.array([np.zeros(len(friction)) if p.slip_origin is None else p.slip_origin for p in posed]).T

        def by_contact(rows: Block) -> Block:
            """Return values (m (d-1), steps) in the shape (m steps, d-1)."""
            return np.moveaxis(rows.reshape(m, width, steps), 1, 2).reshape(-1, width)

        slip, force = by_contact(self._T @ x - origin), by_contact(friction)
        along = abs(self._T) @ abs(x) + abs(origin)
        size, least = lengths(by_contact(along)), lengths(by_contact(self._no_length("tangent", along, whole)))
        slip = np.where((beyond(lengths(slip), least) == 0)[:, None], 0.0, slip)
        bound = (problem.friction[:, None] * np.maximum(normal, 0.0)).ravel()  # type: ignore[index]
        excess = np.maximum(lengths(force) - bound, 0.0)
        wrong = lengths(force - bound[:, None] * directions(slip))
        meeting = self._meeting_at_tangents(F).ravel()
        slip_measure = ratio(lengths(slip), size)
        cone, direction = ratio(excess, meeting), np.minimum(slip_measure, ratio(wrong, meeting))
        return _worst(cone.reshape(m, steps)), _worst(direction.reshape(m, steps))

    def _meeting_at_tangents(self, F: Block) -> Block:
        """Return min_j F_j / |E_T|_ij (m, steps), |E_T|_ij the length of column j of the rows of contact i."""
        assert self._T is not None
        squares = sp.coo_matrix(self._T.multiply(self._T))
        width = self._T.shape[0] // self._N.shape[0]
        # |E_T'v|_j is at most |v| times the length of column j of the contact's rows.
        shape = (self._N.shape[0], self._T.shape[1])
        columns = sp.coo_matrix(sp.csr_matrix((squares.data, (squares.row // width, squares.col)), shape=shape))
        least = np.full((self._N.shape[0], F.shape[1]), np.inf)
        np.minimum.at(least, columns.row, F[columns.col] / np.sqrt(columns.data)[:, None])
        return least


def _worst(values: Block) -> Block:
    """Return the worst figure of each step, including NaN."""
    return np.asarray(np.max(values, axis=0, initial=0.0))


# Steps certified at once.
BLOCK = 64
TOLERANCE = 1e-9
# The tolerance within which a duration is a whole number of steps.
WHOLE = 1e-6
# The most steps whose times are distinct in double precision.
MOST_STEPS = 2.0**53
# The least number of steps that resolve the duration of a contact.
RESOLVED = 10
# The relative accuracy of the critical step, which central differences may use.
CRITICAL = 1e-6


class MotionRun:
    """A motion in progress.

    Parameters
    ----------
    scheme : Scheme
    load : function of the time, f (n,) [force]
    start : float, the time at the start
    method, options : str, dict, for the contact problem of each step, as in `solve`
    """

    def __init__(
        self, scheme: Scheme, load: Callable[[float], Vector], start: float, method: str, options: dict[str, Any]
    ) -> None:
        self._scheme, self._load = scheme, load
        self._contacts = tuple(StepContact(template, method, options) for template in scheme.templates)
        self._judges = tuple(StepJudge(template) for template in scheme.templates)
        self._pending: list[list[tuple[StepProblem, StepResult]]] = [[] for _ in scheme.templates]
        self._notes: list[str] = []
        self._certified, self._alone = 0, False  # steps; whether each is solved as a problem of its own, which raw
        self._raw = options.get("polish") is False  # answers are not
        self._impacts = FirstImpacts(scheme.body.problem)
        self._vibrates: tuple[Mask, Vector] | None = None  # bodies and vibration of the last impact
        self._motion = Motion(scheme, [], load, start, method, [0.0], self._work)

    def start(self, u: Vector, v: Vector, mass: Any) -> None:
        """Set the start; note where the scheme has moved so much of the stated mass that its kinetic energy changes."""
        self._motion.states.append(self._scheme.first(u, v, self._load(self._motion.start)))
        body = self._scheme.body
        stated, left = (float(v @ (M @ v)) / 2 for M in (mass, body.mass))
        if abs(left - stated) > CHANGED * stated:
            unit = f" {body.problem.units.force} {body.problem.units.length}" if body.problem.units.force else ""
            self._notes.append(
                f"the kinetic energy at the start is {left:.6g}{unit}, with the stated mass {stated:.6g}{unit}: "
                f"{self._scheme.name!r} moves mass off the contacts, and with it what the start gives them; {OTHERWISE}"
            )

    def lasting(self, duration: float) -> MotionHistory:
        """Compute the steps of a duration and return the history from the start."""
        refuse_not_positive("duration", duration)
        h = self._scheme.body.step
        ratio = float(np.float64(duration) / h) if duration < MOST_STEPS * h else np.inf
        if ratio > MOST_STEPS:
            raise InvalidProblem(f"duration: {duration:g} takes more steps of {h:g} than can be counted")
        if ratio < 1 - WHOLE:
            raise InvalidProblem(f"time_step: expected one no longer than the duration, {duration:g}, got {h:g}")
        whole = abs(ratio - round(ratio)) <= WHOLE
        return self._steps(round(ratio) if whole else int(np.ceil(ratio)))

    def _resumed(self, states: list[State], duration: float) -> MotionHistory:
        """Continue from these states for `MotionHistory.resume`, without changing the first history."""
        twin = copy.copy(self)
        twin._motion = replace(self._motion, states=list(states), seconds=list(self._motion.seconds), work=twin._work)
        twin._impacts = self._impacts.copy()
        twin._notes, twin._pending = list(self._notes), [[] for _ in self._pending]
        twin._certified = len(states) - 1
        return twin.lasting(duration)

    def _steps(self, count: int) -> MotionHistory:
        """Compute a number of steps and certify them."""
        began, motion = time.perf_counter() - self._motion.seconds[0], self._motion
        first, state, load = len(motion.states), motion.states[-1], self._load(motion.time(len(motion.states) - 1))
        with np.errstate(over="ignore", invalid="ignore"):
            while (k := len(motion.states)) < first + count:
                next_load = self._load(motion.time(k))
                before, state = state, self._step(state, load, next_load)
                motion.states.append(state)
                load = next_load
                if self._impacts.awaited:
                    self._check_contact_time(self._impacts.new(before, state), before, state, k)
                if k % BLOCK == 0 or k == first + count - 1:
                    motion.seconds[0] = time.perf_counter() - began
                    self._judge(k)
                    state, load = motion.states[-1], self._load(motion.time(self._certified)) if self._alone else load
        return self.history

    @property
    def history(self) -> MotionHistory:
        notes = tuple(self._notes)  # of the steps so far
        return MotionHistory(self._motion, lambda: (*notes, *notes_on_motion(self._motion)), self._resumed)

    def _step(self, state: State, load: Vector, next_load: Vector) -> State:
        answers: tuple[StepResult, ...] = ()
        for contact, pending in zip(self._contacts, self._pending, strict=True):
            posed = self._scheme.pose(state, load, next_load, answers)
            try:
                refuse_late("it was taken")
                with stage(METHOD):
                    found = contact.alone(posed) if self._alone else contact.solve(posed)
            except (NotConverged, NotCertified, BackendFailed, NoEquilibrium, SeveralEquilibria) as error:
                done = len(self._motion.states) - 1
                for pairs in self._pending:
                    del pairs[self._steps_since(done) :]  # of a step with two problems one may be solved
                self._judge(done, final=True)
                raise NotConverged(f"{self._scheme.name}: step {done + 1}: {error}", self.history) from error
            pending.append((posed, found))
            answers = (*answers, found)
        return self._scheme.accept(state, answers)

    def _steps_since(self, done: int) -> int:
        """Return the number of steps not yet certified."""
        return done - self._certified

    def _judge(self, last: int, final: bool = False) -> None:
        """Certify the steps since the last block; from a refused one on, they will be computed again as separate
        problems.

        Factors in doubles are not accurate enough for steps that are long compared to vibrations of a free body. Raises
        NotConverged if a refused step was computed separately or its answer is raw, or if this is `final`.
        """
        refusals = []
        for judge, pending, template in zip(self._judges, self._pending, self._scheme.templates, strict=True):
            if not pending:
                continue
            with stage(CERTIFY), in_any_time():
                refused = judge.refused([p for p, _ in pending], [a for _, a in pending], TOLERANCE)
            pending.clear()
            refusals += [] if refused is None else [(*refused, template)]
        if not refusals:
            self._certified, self._alone = last, False
            return
        step, figure, worst, template = min(refusals, key=lambda one: one[0])
        first, instant = self._certified + 1, f"{self._motion.time(self._certified + 1 + step):g}"
        del self._motion.states[first + step :]
        if not np.isfinite(worst):
            raise NotConverged(f"{self._scheme.name}: the motion has left all numbers at time {instant}", self.history)
        if final or self._alone or self._raw:
            raise NotConverged(
                f"{self._scheme.name}: the certificate refuses the step that ends at time {instant}: {figure} is "
                f"{worst:.3g}, tolerance {TOLERANCE:g} ({template!r})",
                self.history,
            )
        self._certified, self._alone = first + step - 1, True

    def _work(self) -> Work:
        return Work(
            factorisations=sum(contact.factorisations for contact in self._contacts),
            back_substitutions=sum(contact.back_substitutions for contact in self._contacts),
            iterations=len(self._motion.states) - 1,
            retained=len(touched(self._scheme.body.problem)),
        )

    def _check_contact_time(self, closing: Indices, before: State, state: State, k: int) -> None:
        """Warn once if the step is too long for closing contacts."""
        scheme, h = self._scheme, self._scheme.body.step
        if scheme.inertia is None or not len(closing):
            return
        closed = np.flatnonzero(state.normal_force > 0)
        share = scheme.inertia * scheme.body.mass + scheme.body.stiffness
        contact, template = self._contacts[-1], scheme.templates[-1]
        factor = float(template.stiffness.diagonal().max() / share.diagonal().max())
        bodies = self._impacts.bodies(scheme.body.mass, closing)
        known = None if self._vibrates is None or not np.array_equal(self._vibrates[0], bodies) else self._vibrates[1]
        omega, shape = slowest_frequency(
            lambda y: factor * contact.respond_closed(y, closed),
            scheme.body.mass,
            scheme.inertia,
            np.where(bodies, before.velocity, 0.0),
            np.pi / (RESOLVED * h),
            known,
        )
        self._vibrates = None if shape is None else (bodies, shape)
        if omega is None or np.pi / omega >= RESOLVED * h:
            return
        self._impacts.awaited = False
        names = ", ".join(scheme.body.problem.contact_name(int(i)) for i in closing[:3])
        self._warn(
            f"time step {h:.3g} is too long to resolve the contact that closes at time {self._motion.time(k):.6g} "
            f"({names}): it lasts about {np.pi / omega:.2g}, half a period of the slowest vibration that it starts; "
            f"take steps of {np.pi / omega / RESOLVED:.2g} or less"
        )

    def check_critical_step(self, penalty: float | None) -> None:
        """Raise InvalidProblem for an unstable step; warn if only penalty springs, which act during contact, make it
        unstable.
        """
        body = self._scheme.body
        limit = critical_step(body.mass, body.stiffness)
        if body.step > limit * (1 + CRITICAL):
            raise InvalidProblem(
                f"time_step: {self._scheme.name} is stable up to {limit:.6g} (2 over the highest frequency of "
                f"stiffness and mass), got {body.step:.6g}"
            )
        if penalty is None or self._scheme.springs is None:
            return
        E = body.problem.normal
        touching = critical_step(body.mass, body.stiffness + penalty * (E.T @ E))
        if body.step > touching * (1 + CRITICAL):
            self._warn(
                f"time step {body.step:.6g} is unstable with all contacts closed: contact springs of {penalty:g} are "
                f"stable up to {touching:.6g}"
            )

    def _warn(self, message: str) -> None:
        self._notes.append(message)
        warn(message, TimeStepWarning)


class FirstImpacts:
    """The contacts that closed by an impact so far, each reported at its first impact."""

    def __init__(self, problem: ContactProblem) -> None:
        self._normal, self._tie, self._stiffness = problem.normal, problem.tie, problem.stiffness_rows
        self._met = np.zeros(problem.contacts, dtype=bool)
        self._body: Indices | None = None  # the body of each unknown, computed at the first impact
        self.awaited = problem.contacts > 0

    def copy(self) -> FirstImpacts:
        """Return an independent copy."""
        twin = copy.copy(self)
        twin._met = self._met.copy()
        return twin

    def new(self, before: State, now: State) -> Indices:
        """Return the contacts that close with approaching velocity for the first time."""
        closing = np.flatnonzero((now.normal_force > 0) & (before.normal_force <= 0) & ~self._met)
        if len(closing):
            closing = closing[self._normal[closing] @ before.velocity > 0]
            self._met[closing] = True
            self.awaited = not bool(np.all(self._met))
        return closing

    def bodies(self, mass: Any, contacts: Indices) -> Mask:
        """Return the unknowns (n,) of the bodies of these contacts; ties join bodies."""
        if self._body is None:
            from scipy.sparse.csgraph import connected_components

            tied = abs(self._tie).T @ abs(self._tie)
            self._body = connected_components(abs(self._stiffness) + abs(mass) + tied, directed=False)[1]
        return np.isin(self._body, self._body[sp.csr_matrix(abs(self._normal[contacts])).indices])
