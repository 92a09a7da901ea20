"""Load control of a large deformation: step after step up the load, jumps told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.large.active_kkt import negative_on, positive_semidefinite
from contactqp.analysis.large.constrained_newton import Balance, balance_with_anchors, find_balance, large_solution
from contactqp.analysis.large.deformation import Forces, LargeHistory, LargeSolution, LoadedBody, Snap
from contactqp.analysis.large.newton_step import NewtonSettings, Target
from contactqp.errors import NotCertified, NotConverged
from contactqp.model.arrays import Vector

# Halvings of a step in search of a jump: its load factor is known to a millionth of the step.
HALVINGS = 20
# A load factor is told if it is known to this part of the step.
KNOWN = 1e-3
# What is left of a step's displacement when the step has shrunk to nothing: a jump, not a steep path.
JUMP = 0.3
# A motion of less stiffness than this part of the largest has none.
NO_STIFFNESS = 1e-10
# Where between the ends of a step a crest of the energy is looked for: Newton's method may have leapt over it.
BETWEEN = (0.25, 0.5, 0.75)


@dataclass(frozen=True, eq=False)
class Program:
    """Loads and tie values against the load factor t: corner k at t = k, straight lines between."""

    loads: Sequence[Vector]  # (n,) each, the start included
    tie_values: Sequence[Vector]  # (k,) each

    @property
    def end(self) -> int:
        """The last load factor."""
        return len(self.loads) - 1

    def at(self, t: float) -> Target:
        """Load and tie value, without anchors."""
        leg = min(int(t), self.end - 1)
        part = t - leg
        if part == 1:
            return Target(self.loads[leg + 1], self.tie_values[leg + 1])
        load = self.loads[leg] + part * (self.loads[leg + 1] - self.loads[leg])
        return Target(load, self.tie_values[leg] + part * (self.tie_values[leg + 1] - self.tie_values[leg]))


@dataclass(frozen=True, eq=False)
class LoadControl:
    """A body, its program and the settings of Newton's method."""

    loaded: LoadedBody
    program: Program
    settings: NewtonSettings

    def follow(self, start: Vector | LargeSolution, times: Sequence[float]) -> LargeHistory:
        """The equilibria at the load factors, from a displacement or from a solution on the way.

        Raises
        ------
        NotConverged, NotCertified
            With the history so far.
        """
        solutions: list[LargeSolution] = []
        notes: list[str] = []
        snaps: list[Snap] = []
        first = times[0]
        try:
            if isinstance(start, LargeSolution):
                solutions.append(start)
            else:
                solutions.append(self.first(start, first))
            for t in times[1:]:
                solutions.append(self._next(solutions[-1], t, notes, snaps))
        except NotConverged as error:
            at = times[len(solutions)]
            so_far = LargeHistory(solutions, notes, snaps=snaps)
            last = solutions[-1] if solutions else None
            raise NotConverged(f"large_deformation: at load factor {at:.6g}: {error}", so_far, last) from error
        except NotCertified as error:
            at = times[len(solutions)]
            raise NotCertified(f"large_deformation: at load factor {at:.6g}: {error}", error.solution) from error
        return LargeHistory(solutions, notes, snaps=snaps)

    def first(self, displacement: Vector, t: float = 0.0) -> LargeSolution:
        """The equilibrium from which the steps set out, near a displacement."""
        target = self.program.at(t)
        if self.loaded.friction is not None and self.loaded.contact is not None:
            anchor = self.loaded.contact.positions(displacement)
            target = Target(target.load, target.tie_value, anchor)
        balance = find_balance(self.loaded, displacement, self.loaded.no_forces(), target, self.settings)
        return large_solution(self.loaded, balance, target, t, self.settings)

    def _next(self, before: LargeSolution, t: float, notes: list[str], snaps: list[Snap]) -> LargeSolution:
        target = self.program.at(t)
        if self.loaded.friction is not None and before.position is not None:
            touching = (before.normal_force > 0) | (before.gap <= 0)
            balance, anchor = balance_with_anchors(
                self.loaded,
                before.position,
                before.gap,
                touching,
                lambda loaded, anchor: find_balance(
                    loaded,
                    before.displacement,
                    forces_of(before),
                    Target(target.load, target.tie_value, anchor),
                    self.settings,
                ),
            )
            target = Target(target.load, target.tie_value, anchor)
        else:
            balance = find_balance(self.loaded, before.displacement, forces_of(before), target, self.settings)
        if self.loaded.friction is None and (balance.shifted or self._leaps(before, balance)):
            snap = None if self._slack(before) else self._jump(before, balance, t)
            if snap is not None:
                snaps.append(snap)
                notes.append(snap.note)
        solution = large_solution(self.loaded, balance, target, t, self.settings)
        if solution.negative and not before.negative:
            notes.append(
                f"from load factor {t:.6g} the equilibrium is unstable: {solution.negative} motion(s) lower the energy"
            )
        return solution

    def _leaps(self, before: LargeSolution, balance: Balance) -> bool:
        """Whether a crest of the energy lies between two equilibria: a negative motion, on the way between their
        displacements, that keeps ties and the contacts that push at both ends."""
        start, way = before.displacement, balance.now.displacement - before.displacement
        if before.negative or not np.any(way):
            return False
        both = np.flatnonzero((before.normal_force > 0) & (balance.forces.normal > 0))
        rows = sp.vstack([balance.now.contact.normal[both], self.loaded.tie], format="csr")
        for part in BETWEEN:
            u = start + part * way
            if np.isfinite(self.loaded.body.energy(u)):
                K = sp.csc_array(self.loaded.body.tangent(u))
                if not positive_semidefinite(K) and negative_on(K, rows):
                    return True
        return False

    def _slack(self, before: LargeSolution) -> bool:
        """Whether nothing is loaded and some motion has no stiffness, as of a chain: it takes its shape from the first
        load, and what moves far then has not snapped."""
        if np.any(before.load) or np.any(before.normal_force):
            return False
        K = sp.csc_array(self.loaded.body.tangent(before.displacement))
        least = NO_STIFFNESS * float(np.max(abs(K.diagonal()), initial=0.0))
        return bool(negative_on(sp.csc_array(K - least * sp.identity(K.shape[0])), self.loaded.tie))

    def _jump(self, before: LargeSolution, balance: Balance, t: float) -> Snap | None:
        """Return the snap of a step whose displacement does not shrink with it, or None."""
        low, high = before.load_factor, t
        start, end = before.displacement, balance.now.displacement
        forces = forces_of(before)
        whole = float(np.linalg.norm(end - start))
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
        told = high - low <= KNOWN * (t - before.load_factor)
        return Snap(low, high, told, j, float(start[j]), float(end[j]))


def forces_of(solution: LargeSolution) -> Forces:
    """The forces of an equilibrium."""
    friction = solution.friction_force if solution.problem.frictional else None
    return Forces(solution.normal_force, solution.tie_force, friction)
