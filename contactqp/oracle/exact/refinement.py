"""Iterative refinement of the whole contact problem, with any method that works in doubles.

What is left of a problem around an approximation (u, l, nu), magnified by D, is a problem of the same kind in the
correction w = D (u* - u):

    minimise  1/2 w'Kw - D r'w,   r = f - K u - E'l - A'nu,
    subject to  E_i w = D (g - E u)_i   where l_i stands out of what is left: its correction may have either sign,
                E_i w <= D (g - E u)_i  elsewhere, l_i taken to be none so far,
                A w = D (b - A u).

The residuals are formed in integers, without rounding, and D grows by what each solution leaves: a contact that is
undecided in doubles shows its gap or its force under the magnification. Scaled refinement of quadratic programs: Weber,
Sager and Gleixner (2019), Mathematical Programming Computation 11, 421; there slacks and their signs are magnified too.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction as Fraction
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem, NoEquilibrium, NotCertified, NotConverged, Unsupported
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution
from contactqp.oracle.exact.fixed_point import Fixed, FixedMatrix, fixed
from contactqp.solving.solve import solve

# Digits of the parts of an approximation beyond its largest, in bits.
KEPT, MOST_DIGITS = 360, 90
MOST_ROUNDS = 40
# A force that is this much larger than all that is left pushes for certain.
STANDS_OUT = 2.0**10
# A contact whose gap is this many times what may still move stays open.
FAR = 2.0**20


@dataclass(frozen=True, eq=False)
class Refined:
    """An approximation far beyond doubles, and its residuals without rounding; forces that do not push are zero."""

    problem: ContactProblem
    displacement: Fixed  # (n,)
    normal_force: Fixed  # (m,)
    tie_force: Fixed  # (k,)
    imbalance: Fixed  # (n,) f - K u - E'l - A'nu
    gap: Fixed  # (m,) g - E u
    tie_error: Fixed  # (k,) b - A u
    closed: NDArray[np.intp]  # contacts with a force
    rounds: int
    first: Solution  # in doubles


def refine(
    problem: ContactProblem,
    method: str = "active-set",
    digits: int = 40,
    *,
    first: Solution | None = None,
    **options: Any,
) -> Refined:
    """Solve a frictionless problem to many more digits than doubles have.

    Parameters
    ----------
    problem : ContactProblem
        Its floats are taken as they stand.
    method, **options
        As in `contactqp.solve`: what solves the magnified problems.
    digits : int
        Residuals relative to the load and to the lengths of the problem, at most 90.
    first : Solution, optional
        In doubles, where it is known already.

    Raises
    ------
    NotConverged
        Residuals do not fall that far: the contact set keeps changing, or the floats are too ill-conditioned.
    InvalidProblem, Unsupported
        Too many digits; friction.
    NoEquilibrium, NotCertified
        Of the first solution.

    Examples
    --------
    A wall 0.1 away, the float: of the force 300 - 157500 * 0.1000000000000000055511... a double holds 16 digits.

    >>> wall = ContactProblem(stiffness=[[157500.0]], load=[30000.0], normal=[[1.0]], gap=[0.1])
    >>> force = refine(wall).normal_force.fractions()[0]
    >>> force == 30000 - 157500 * Fraction(0.1)
    True
    """
    if not 0 < digits <= MOST_DIGITS:
        raise InvalidProblem(f"refine: digits: expected 1 to {MOST_DIGITS}, got {digits}")
    if problem.frictional:
        raise Unsupported("refine: Coulomb friction is no quadratic program")
    if first is None:
        first = solve(problem, method, **options)
    walk = _Walk(problem, first, method, options)
    goal = 2.0 ** (-digits * 3.3219)
    for round_ in range(MOST_ROUNDS):
        if walk.settled and max(walk.left) <= goal:
            return walk.refined(round_, first)
        walk.step()
    raise NotConverged(
        f"refine: residuals of {max(walk.left):.1e} after {MOST_ROUNDS} rounds, {goal:.0e} wanted", solution=first
    )


class _Walk:
    def __init__(self, problem: ContactProblem, first: Solution, method: str, options: dict[str, Any]) -> None:
        self.problem, self._method, self._options = problem, method, options
        self._K, self._E, self._A = (
            FixedMatrix(sp.csr_matrix(x)) for x in (problem.stiffness, problem.normal, problem.tie)
        )
        self._Et, self._At = (FixedMatrix(sp.csr_matrix(x.T)) for x in (problem.normal, problem.tie))
        self._f, self._g, self._b = fixed(problem.load), fixed(problem.gap), fixed(problem.tie_value)
        # sqrt(K_jj) makes displacements and forces comparable; |E_i| / sqrt(K_jj) gaps and normal forces.
        self._scale = _root(problem)
        self._arm, self._tie_arm = (np.asarray(abs(rows) @ (1 / self._scale)) for rows in (problem.normal, problem.tie))
        self.settled = False
        self._key: Any = None
        self._take(fixed(first.displacement), fixed(np.maximum(first.normal_force, 0.0)), fixed(first.tie_force))
        # Sizes in sqrt(energy): what forces there are, and what lengths.
        sizes = [abs(problem.load) / self._scale, self._scale * abs(first.displacement)]
        sizes.append(self._arm * abs(first.normal_force))
        self._size = max((float(np.max(part, initial=0.0)) for part in sizes), default=0.0) or 1.0

    def _take(self, u: Fixed, push: Fixed, tie: Fixed) -> None:
        self.u, self.push, self.tie = (x.rounded(KEPT - min(x.exponent, KEPT)) for x in (u, push, tie))
        self.gap = self._g - self._E @ self.u
        self.tie_error = self._b - self._A @ self.u
        self.imbalance = self._f - self._K @ self.u - self._Et @ self.push - self._At @ self.tie

    @property
    def left(self) -> tuple[float, float]:
        """Forces and lengths that are left, relative to those of the problem."""
        closed = np.array([x > 0 for x in self.push.integers], dtype=bool)
        forces = abs(self.imbalance.floats()) / self._scale
        lengths = np.concatenate(
            [abs(self.gap[closed].floats()) / self._arm[closed], abs(self.tie_error.floats()) / self._tie_arm]
        )
        overlap = np.maximum(-self.gap.floats(), 0.0) / self._arm
        return (
            float(np.max(forces, initial=0.0)) / self._size,
            float(max(np.max(lengths, initial=0.0), np.max(overlap, initial=0.0))) / self._size,
        )

    def step(self) -> None:
        """Solve what is left under a magnifying glass, and add it."""
        problem, m = self.problem, self.problem.contacts
        remains = max(*self.left, 2.0**-KEPT)
        force = self._arm * self.push.floats() / self._size
        certain = force > STANDS_OUT * remains
        if not np.all(certain | (force == 0)):
            held = Fixed(np.where(certain, self.push.integers, 0), self.push.bits)
            self._take(self.u, held, self.tie)
            remains = max(*self.left, 2.0**-KEPT)
        gap = self.gap.floats() / self._arm / self._size
        near = ~certain & (gap < FAR * remains)
        power = int(np.floor(-np.log2(remains)))
        held_, loose = np.flatnonzero(certain), np.flatnonzero(near)
        part = self._magnified(held_, loose, power)
        try:
            found = solve(part, self._method, **self._options)
        except (NotCertified, NotConverged) as error:
            if not isinstance(error.solution, Solution):
                raise
            found = error.solution
        except NoEquilibrium as error:
            reason = f"refine: what is left, magnified by 2^{power}, has no equilibrium: {error}"
            raise NotConverged(reason) from None
        push = np.zeros(m)
        push[held_] = found.tie_force[problem.ties :]
        push[loose] = np.maximum(found.normal_force, 0.0)
        more = fixed(push).times_power(-power)
        total = self.push + more
        before = certain.copy()
        self._take(
            self.u + fixed(found.displacement).times_power(-power),
            Fixed(np.where([x > 0 for x in total.integers], total.integers, 0), total.bits),
            self.tie + fixed(found.tie_force[: problem.ties]).times_power(-power),
        )
        self.settled = np.array_equal(before, [x > 0 for x in self.push.integers])

    def _magnified(self, held: NDArray[np.intp], loose: NDArray[np.intp], power: int) -> ContactProblem:
        problem = self.problem
        values = np.concatenate([self.tie_error.floats_at(power), self.gap[held].floats_at(power)])
        load, gap = self.imbalance.floats_at(power), self.gap[loose].floats_at(power)
        key = (held.tobytes(), loose.tobytes())
        if self._key != key:
            self._key = key
            self._part = ContactProblem(
                stiffness=problem.stiffness,
                load=load,
                normal=problem.normal[loose],
                gap=gap,
                tie=sp.vstack([problem.tie, problem.normal[held]]).tocsr(),
                tie_value=values,
            )
            return self._part
        return self._part.replace(load=load, gap=gap, tie_value=values)

    def refined(self, rounds: int, first: Solution) -> Refined:
        closed = np.flatnonzero([x > 0 for x in self.push.integers])
        return Refined(
            self.problem,
            self.u,
            self.push,
            self.tie,
            self.imbalance,
            self.gap,
            self.tie_error,
            closed,
            rounds,
            first,
        )


def _root(problem: ContactProblem) -> Vector:
    diagonal = problem.diagonal
    largest = float(np.max(diagonal, initial=0.0)) or 1.0
    return np.asarray(np.sqrt(np.where(diagonal > 0, diagonal, largest)))
