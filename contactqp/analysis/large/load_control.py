"""Follow a large deformation by load control, with notes on jumps.

Each equilibrium of Newton's method is certified and added to the history. Slips of contacts that close within a step
are measured from anchors.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.large.active_kkt import negative_on, positive_semidefinite
from contactqp.analysis.large.constrained_newton import Balance, find_balance
from contactqp.analysis.large.deformation import Forces, LargeHistory, LargeSolution, LoadedBody, Snap
from contactqp.analysis.large.newton_step import NewtonSettings, Target, in_displacement, slipped
from contactqp.certificate.certificate import certificate_of
from contactqp.certificate.figures import contact_status
from contactqp.elements.deformable import ContactGeometry, LinearisedContacts
from contactqp.errors import NotCertified, NotConverged, Unsupported
from contactqp.model.arrays import TINY, Array, Vector, time_is_up
from contactqp.model.solution import Answer, Work

# The most successive halvings of a step that does not converge.
MOST_HALVINGS = 4
# Halvings of a step for bracketing the load factor of a jump to a millionth of the step.
HALVINGS = 20
# The load factor of a jump counts as located if its bracket is below this part of the step.
LOCATED = 1e-3
# The least part of a step's displacement that remains for a vanishing step if the path jumps.
JUMP = 0.3
# Displacements that differ by less than this part of them have not jumped.
UNMOVED = 1e-9
# Stiffnesses below this part of the largest are zero.
NO_STIFFNESS = 1e-10
# Points between the ends of a step examined for an energy barrier, which Newton's method may have crossed.
BETWEEN = (0.25, 0.5, 0.75)
# The relative distance within which friction is at its bound.
STICKS = 1e-9
# A contact has landed where its gap is below this part of what it was at the start of the step, and the most parts of a
# step at which the motion before it lands is computed.
LANDED = 1e-6
MOST_SAMPLES = 12


@dataclass(frozen=True, eq=False)
class Program:
    """Loads and tie values against the load factor t: corner k at t = k, straight lines between."""

    loads: Sequence[Vector]  # (n,) each, including the start
    tie_values: Sequence[Vector]  # (k,) each

    @property
    def end(self) -> int:
        """Return the last load factor."""
        return len(self.loads) - 1

    def at(self, t: float) -> Target:
        """Return load and tie value at a load factor, without anchors."""
        leg = min(int(t), self.end - 1)
        part = t - leg
        ends = [(values[leg], values[leg + 1]) for values in (self.loads, self.tie_values)]
        load, tie_value = (end if part == 1 else start + part * (end - start) for start, end in ends)
        largest = [max(float(np.max(abs(v), initial=0.0)) for v in values) for values in (self.loads, self.tie_values)]
        return Target(load, tie_value, None, *largest)


@dataclass(eq=False)
class Remarks:
    """The notes and jumps of a path, and the steps within which several contacts land."""

    notes: list[str] = field(default_factory=list)
    snaps: list[Snap] = field(default_factory=list)
    landings: list[float] = field(default_factory=list)  # load factors of the ends of the steps

    def history(self, solutions: list[LargeSolution]) -> LargeHistory:
        """Return the history of these solutions with the remarks."""
        notes = list(self.notes)
        if self.landings:
            others = f" and in {len(self.landings) - 1} more" if self.landings[1:] else ""
            notes.append(
                f"in the step to load factor {self.landings[0]:.6g}{others} several contacts with friction land, each "
                "as if the others did not: their friction may depend on the number of steps"
            )
        return LargeHistory(solutions, notes, snaps=self.snaps)


@dataclass(frozen=True, eq=False)
class LoadControl:
    """A body, its program and the settings of Newton's method."""

    loaded: LoadedBody
    program: Program
    settings: NewtonSettings

    def follow(self, start: Vector | LargeSolution, times: Sequence[float]) -> LargeHistory:
        """Compute the equilibria at the load factors from a displacement or a solution of the path.

        Raises NotConverged, NotCertified: with the history so far.
        """
        solutions: list[LargeSolution] = []
        remarks, t = Remarks(), times[0]
        try:
            if isinstance(start, LargeSolution):
                solutions.append(start)
            else:
                solutions.append(self.first(start, t))
            for t in times[1:]:
                solutions += self._to(solutions[-1], t, remarks)
        except NotConverged as error:
            so_far = remarks.history(solutions)
            last = solutions[-1] if solutions else None
            words = "" if last is None else _cure()
            raise NotConverged(f"large_deformation: at load factor {t:.6g}: {error}{words}", so_far, last) from error
        except NotCertified as error:
            raise NotCertified(f"large_deformation: at load factor {t:.6g}: {error}", error.solution) from error
        except Unsupported as error:
            raise Unsupported(f"large_deformation: at load factor {t:.6g}: {error}") from error
        return remarks.history(solutions)

    def first(self, displacement: Vector, t: float = 0.0) -> LargeSolution:
        """Return the equilibrium from which the steps start, near a displacement."""
        target = self.program.at(t)
        anchored = target
        if self.loaded.friction is not None and self.loaded.contact is not None:
            anchored = replace(target, anchor=self.loaded.contact.positions(displacement))
        chosen = anchored if self.loaded.frictional else target
        balance = find_balance(self.loaded, displacement, self.loaded.no_forces(), chosen, self.settings)
        return large_solution(self.loaded, balance, anchored, t, self.settings)

    def _to(
        self, before: LargeSolution, t: float, remarks: Remarks, halvings: int = MOST_HALVINGS
    ) -> list[LargeSolution]:
        """Return the equilibria up to a load factor, in one step, or in halves if it does not converge."""
        try:
            return [self._next(before, t, remarks)]
        except NotConverged as error:
            if not halvings:
                raise
            whole = error
        try:
            first = self._to(before, (before.load_factor + t) / 2, remarks, halvings - 1)
            return first + self._to(first[-1], t, remarks, halvings - 1)
        except NotConverged:
            raise whole from None

    def _next(self, before: LargeSolution, t: float, remarks: Remarks) -> LargeSolution:
        target = self.program.at(t)
        if self.loaded.frictional and before.position is not None:
            touching, at = (before.normal_force > 0) | (before.gap <= 0), before.position
            solve_with = partial(self._sliding, before, t)
            balance, anchor = balance_with_anchors(self.loaded, at, before.gap, touching, solve_with)
            target = replace(target, anchor=anchor)
            remarks.landings += [t] * bool(np.sum((balance.forces.normal > 0) & ~touching & self.loaded.rough) > 1)
        else:
            balance = find_balance(self.loaded, before.displacement, forces_of(before), target, self.settings)
            if self.loaded.friction is not None:
                target = replace(target, anchor=before.position)
        if balance.shifted or self._crosses_barrier(before, balance):
            self._tell_of_jump(before, balance, t, remarks)
        solution = large_solution(self.loaded, balance, target, t, self.settings)
        if solution.negative and not before.negative:
            remarks.notes.append(
                f"from load factor {t:.6g} the equilibrium is unstable: {solution.negative} motion(s) lower the energy"
            )
        return solution

    def _sliding(self, before: LargeSolution, t: float, loaded: LoadedBody, anchor: Array, part: float) -> Balance:
        """Return the balance with friction at a part of the step to a load factor.

        Only without friction the energy leads through a jump. Where a body jumps that touched nothing, the start is
        where it comes to rest without friction.
        """
        target, forces = self._within(before.load_factor, t, part), forces_of(before)
        anchored = replace(target, anchor=anchor)
        try:
            return find_balance(loaded, before.displacement, forces, anchored, self.settings)
        except NotConverged:
            if np.any(before.normal_force > 0):
                raise
        smooth = LoadedBody(loaded.body, loaded.contact, loaded.tie)
        rest = find_balance(smooth, before.displacement, Forces(forces.normal, forces.tie), target, self.settings)
        still = replace(rest.forces, friction=np.zeros_like(forces.friction))
        return find_balance(loaded, rest.now.displacement, still, anchored, self.settings)

    def _tell_of_jump(self, before: LargeSolution, balance: Balance, t: float, remarks: Remarks) -> None:
        """Add the jump of a step to the remarks; with friction it is not located."""
        if self._is_slack(before):
            return
        if self.loaded.frictional:
            remarks.notes.append(
                f"between the load factors {before.load_factor:.6g} and {t:.6g} the body snaps, with friction: where "
                "its contacts land and slip in between depends on the number of steps"
            )
        elif (snap := self._jump(before, balance, t)) is not None:
            remarks.snaps, remarks.notes = [*remarks.snaps, snap], [*remarks.notes, snap.note]

    def _within(self, start: float, end: float, part: float) -> Target:
        """Return load and tie value at a part of a step, whose end is exact."""
        return self.program.at(end if part == 1 else start + part * (end - start))

    def _crosses_barrier(self, before: LargeSolution, balance: Balance) -> bool:
        """Return whether an energy barrier lies between two equilibria: a motion of negative energy, at a point
        between, that satisfies ties and the contacts with force at both ends, where friction holds them too.
        """
        start, motion = before.displacement, balance.now.displacement - before.displacement
        if before.negative or not np.any(motion):
            return False
        both = np.flatnonzero((before.normal_force > 0) & (balance.forces.normal > 0))
        contact, rows = balance.now.contact, [balance.now.contact.normal[both], self.loaded.tie]
        if self.loaded.frictional and contact.tangent is not None:  # friction may hold all that push
            width = contact.tangent.shape[0] // self.loaded.contacts
            rows.append(contact.tangent[(width * both[:, None] + np.arange(width)).ravel()])
        held = sp.vstack(rows, format="csr")
        for part in BETWEEN:
            u = start + part * motion
            if np.isfinite(self.loaded.body.energy(u)):
                K = sp.csc_array(self.loaded.body.tangent(u))
                if not positive_semidefinite(K) and negative_on(K, held):
                    return True
        return False

    def _is_slack(self, before: LargeSolution) -> bool:
        """Return whether nothing is loaded and some motion has no stiffness, as for a chain, whose large first
        displacement is not a jump.
        """
        if np.any(before.load) or np.any(before.normal_force):
            return False
        K = sp.csc_array(self.loaded.body.tangent(before.displacement))
        least = NO_STIFFNESS * float(np.max(abs(K.diagonal()), initial=0.0))
        return bool(negative_on(sp.csc_array(K - least * sp.identity(K.shape[0])), self.loaded.tie))

    def _jump(self, before: LargeSolution, balance: Balance, t: float) -> Snap | None:
        """Return the jump in a step whose displacement does not decrease with the step size, or None."""
        low, high = before.load_factor, t
        start, end = before.displacement, balance.now.displacement
        forces = forces_of(before)
        whole = float(np.linalg.norm(end - start))
        nothing = float(np.max(balance.now.contact.rounding, initial=0.0)) * len(end)
        if whole <= max(UNMOVED * float(np.linalg.norm(end)), nothing):  # it stays although unstable, as on a ball
            return None
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            try:
                found = find_balance(self.loaded, start, forces, self.program.at(middle), self.settings)
            except NotConverged:
                break
            u = found.now.displacement
            if np.linalg.norm(u - start) <= np.linalg.norm(u - end):
                low, start, forces = middle, u, found.forces
            else:
                high, end = middle, u
            if np.linalg.norm(end - start) < JUMP * whole:
                return None
        j = int(np.argmax(abs(end - start)))
        located = high - low <= LOCATED * (t - before.load_factor)
        return Snap(low, high, located, j, float(start[j]), float(end[j]))


def _cure() -> str:
    """Return what may help where a step and its halves do not converge; nothing where the time limit ended it."""
    parts = f"parts of the step down to 1/{2**MOST_HALVINGS}"
    cures = "take more steps, or a larger tolerance= if only rounding is left, unless nothing balances that load"
    return "" if time_is_up() else f"; nor do {parts} converge: {cures}"


def forces_of(solution: LargeSolution) -> Forces:
    """Return the forces of an equilibrium."""
    friction = solution.friction_force if solution.problem.frictional else None
    return Forces(solution.normal_force, solution.tie_force, friction)


def large_solution(
    loaded: LoadedBody, balance: Balance, target: Target, load_factor: float, settings: NewtonSettings
) -> LargeSolution:
    """Return the equilibrium with the certificate of its last Newton step, and its stability.

    Raises NotCertified: the certificate refuses the answer of an exact method.

    Parameters
    ----------
    loaded : the body with its contacts and ties
    balance : the equilibrium and its iterations
    target : loads, tie values and slip origins
    load_factor : the load factor t
    settings : the settings that found it
    """
    now, step, forces = balance.now, balance.step, balance.forces
    problem = in_displacement(step.problem, balance.before.displacement)
    started = time.perf_counter()
    friction, slip = forces.friction, slipped(loaded, now, target)
    if slip is not None and problem.slip_origin is None:  # coefficients of zero, without which it was found
        rows = now.contact.tangent
        origin = np.asarray(rows @ now.displacement).reshape(slip.shape) - slip
        problem = problem.replace(tangent=rows, friction=loaded.friction, slip_origin=origin)
    if friction is None and problem.slip_origin is not None:
        friction = np.zeros_like(problem.slip_origin)
    answer = Answer(now.displacement, forces.normal, friction, forces.tie)
    certificate = certificate_of(problem, answer)
    if step.springs:
        note = (
            f"the tangent is indefinite: certified on springs of {step.springs:.3g} that are relaxed at the answer; "
            "balance and contact are those of the body, its stability is another question"
        )
        certificate = replace(certificate, notes=(*certificate.notes, note))
    if balance.unresolved:
        note = (
            f"balance holds to {balance.unresolved:.1e} of the path's largest force: below that the internal force of "
            "the body is rounding, which follows no tangent"
        )
        certificate = replace(certificate, notes=(*certificate.notes, note))
    spent = time.perf_counter() - started
    found = step.found
    solution = LargeSolution(
        problem=problem,
        answer=answer,
        contact_status=contact_status(problem, certificate),
        free_motions=() if found is None else found.free_motions,
        certificate=certificate,
        method=settings.method if found is None else found.method,
        seconds=balance.seconds + spent,
        certify_seconds=spent,
        work=replace(Work() if found is None else found.work, iterations=len(balance.iterations)),
        history=tuple(iteration.error for iteration in balance.iterations),
        load_factor=load_factor,
        load=target.load,
        tie_value=target.tie_value,
        increment=step.increment,
        current_gap=now.contact.gap,
        current_slip=slip,
        position=None if loaded.contact is None else loaded.contact.positions(now.displacement),
        elastic=loaded.body.energy(now.displacement),
        negative=negative_motions(loaded, balance),
        iterations=balance.iterations,
    )
    problem._computed.assembly, problem._computed.contact_points = loaded, solution.position
    if settings.exact and not certificate.passed:
        failures = "; ".join(certificate.failures)
        raise NotCertified(f"the certificate refuses the last step: {failures}", solution)
    return solution


def negative_motions(loaded: LoadedBody, balance: Balance) -> int:
    """Return the number of motions of negative energy that keep ties, contacts with force and sticking contacts."""
    K = loaded.hessian(balance.now, balance.forces)
    if positive_semidefinite(K):
        return 0
    contact, forces = balance.now.contact, balance.forces
    rows = [contact.normal[np.flatnonzero(forces.normal > 0)], loaded.tie]
    if forces.friction is not None and loaded.friction is not None and contact.tangent is not None:
        width = forces.friction.shape[1]
        sticks = np.linalg.norm(forces.friction, axis=1) < loaded.friction * forces.normal * (1 - STICKS)
        rows.append(contact.tangent[np.flatnonzero(np.repeat(sticks, width))])
    return negative_on(K, sp.vstack(rows, format="csr"))


@dataclass(frozen=True, eq=False)
class HeldOpen:
    """A contact geometry with widened gaps, so that some contacts cannot close."""

    geometry: ContactGeometry
    offset: Vector  # (m,) added to the gaps [length]

    @property
    def contacts(self) -> int:
        """Return the number of contacts m."""
        return self.geometry.contacts

    def state(self, displacement: Vector) -> LinearisedContacts:
        """Return the contacts at a displacement, with widened gaps."""
        state = self.geometry.state(displacement)
        return replace(state, gap=state.gap + self.offset)

    def curvature(self, displacement: Vector, normal_force: Vector) -> Any:
        """Return the curvature of the geometry, which does not depend on gaps."""
        return self.geometry.curvature(displacement, normal_force)

    def slip_since(self, displacement: Vector, anchor: Vector) -> Vector:
        """Return the slips since the anchors, which do not depend on gaps."""
        return self.geometry.slip_since(displacement, anchor)

    def positions(self, displacement: Vector) -> Vector:
        """Return the positions of the contacts (m, d) [length]."""
        return self.geometry.positions(displacement)


def balance_with_anchors(
    loaded: LoadedBody,
    position: Array,
    gap: Vector,
    touching: Any,
    solve_with: Callable[[LoadedBody, Array, float], Balance],
) -> tuple[Balance, Array]:
    """Return the balance at the end of a step, and the anchors (m, d) of its slips.

    A contact that touched is anchored at its previous position. One that closes is anchored where the motion without
    the contacts that close reaches the obstacle, at the part of the step at which its gap vanishes.

    Parameters
    ----------
    loaded : LoadedBody
    position, gap, touching : (m, d), (m,), (m,), at the start of the step
    solve_with : function, the balance of a body whose slips start at anchors, at a part of the step up to 1
    """
    found = solve_with(loaded, position, 1.0)
    closes = (found.forces.normal > 0) & ~touching
    if not np.any(closes) or loaded.contact is None:
        return found, position
    far = np.where(closes, 1e3 * (abs(gap) + float(np.max(abs(gap)))), 0.0)
    free = LoadedBody(loaded.body, HeldOpen(loaded.contact, far), loaded.tie, loaded.friction)
    passages = [Passage(0.0, position, gap)]

    def pass_at(part: float) -> None:
        now = solve_with(free, position, part).now
        passages.append(Passage(part, free.contact.positions(now.displacement), now.contact.gap - far))  # type: ignore[union-attr]
        passages.sort(key=lambda passage: passage.part)

    try:
        pass_at(1.0)
        while len(passages) < 2 + MOST_SAMPLES and (part := _next_part(passages, np.flatnonzero(closes))) is not None:
            pass_at(part)
    except NotConverged:
        if len(passages) == 1:  # without the contact the body is not held, so that only its final position is known
            passages.append(Passage(1.0, loaded.contact.positions(found.now.displacement), found.now.contact.gap))
    anchor = position.copy()
    for i in np.flatnonzero(closes):
        anchor[i] = _landing(passages, int(i))
    return solve_with(loaded, anchor, 1.0), anchor


@dataclass(frozen=True, eq=False)
class Passage:
    """The positions and gaps that contacts have at a part of a step, in the motion without those that close."""

    part: float
    position: Array  # (m, d)
    gap: Vector  # (m,)


def _bracket(passages: Sequence[Passage], i: int) -> tuple[Passage, Passage]:
    """Return the passages between which the gap of a contact vanishes first, the last two if it does not."""
    closed = next((k for k in range(1, len(passages)) if passages[k].gap[i] <= 0), len(passages) - 1)
    return passages[closed - 1], passages[closed]


def _landing(passages: Sequence[Passage], i: int) -> Vector:
    """Return the position at which the gap of a contact vanishes, along a straight line within its bracket."""
    before, after = _bracket(passages, i)
    fall = max(float(before.gap[i] - after.gap[i]), TINY)
    fraction = min(max(float(before.gap[i]) / fall, 0.0), 1.0)
    return np.asarray(before.position[i] + fraction * (after.position[i] - before.position[i]))


def _next_part(passages: Sequence[Passage], closes: Any) -> float | None:
    """Return the part of the step to be computed next, at which the contact that is furthest from landing has landed
    by interpolation; None where all have, or none lands.
    """
    worst, furthest = LANDED, None
    for i in closes:
        before, after = _bracket(passages, i)
        if before.gap[i] <= 0 or after.gap[i] > 0:
            continue
        left = min(float(before.gap[i]), -float(after.gap[i])) / float(passages[0].gap[i])
        if left > worst:
            worst, furthest = left, i
    if furthest is None:
        return None
    return _interpolated(passages, furthest)


def _interpolated(passages: Sequence[Passage], i: int) -> float | None:
    """Return the part at which a gap vanishes by interpolation (Chandrupatla 1997), None if none is within its bracket.

    Parts are a parabola over the gaps of the bracket and of a neighbour where it is monotonic, and else the bracket is
    halved; between the ends of a step they are a line. SciPy's root finders follow one function, while a passage
    gives the gaps of all contacts.
    """
    before, after = _bracket(passages, i)
    k = passages.index(before)
    ends = [(before, after, passages[k - 1])] if k else []
    ends += [(after, before, passages[k + 2])] if k + 2 < len(passages) else []
    part = (before.part + after.part) / 2
    if not ends:
        part = float(before.gap[i] / (before.gap[i] - after.gap[i]))
    for near, far, third in sorted(ends, key=lambda three: -abs(three[0].gap[i])):
        f, g, h = (float(passage.gap[i]) for passage in (near, far, third))
        if len({f, g, h}) < 3:
            continue
        along, down = (near.part - far.part) / (third.part - far.part), (f - g) / (h - g)
        if down**2 < along and (1 - down) ** 2 < 1 - along:
            t = f / (g - f) * h / (g - h) + (third.part - near.part) / (far.part - near.part) * f / (h - f) * g / (
                h - g
            )
            part = near.part + t * (far.part - near.part)
    return part if before.part < part < after.part else None
