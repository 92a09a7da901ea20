"""The exact solution of a frictionless contact problem whose data are floats as they stand, and errors against it.

Everything is rational (`contactqp.oracle`). A set of closed contacts that somebody guesses is tried first; Lemke's
method decides where no guess is right, and proves by its ray that there is no solution. Every answer is checked in
rational arithmetic against the problem as it was stated: equilibrium, gaps, signs, complementarity, ties. No solver of
the package is used here.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import flint
import numpy as np
from flint import arb, arb_mat, fmpq, fmpq_mat

from contactqp.linalg.equilibration import Scaling, equilibrated, mostly_bare
from contactqp.linalg.rational import column, floats, matrix, number, solve_any, stack, take
from contactqp.oracle.exact.rational_problem import RationalProblem, Reduced, of_floats, reduce_problem

# Bits for norms of rational vectors: their cancellation costs at most twice the digits of the condition number.
PRECISION = 600
# A true size below this part of the size of the whole problem is judged absolutely.
TINY = 1e-12
# Eigenvalues of a stiffness with unit diagonal beneath this are those of rigid motions: what the rounding of doubles
# makes of zero. What lies above, be it the lost digits of a printed matrix, belongs to the stiffness as it stands.
SINGULAR = 1e-14


# Below this condition of K the bodies without their ties are stiff enough for forces to be compared on these, too.
SEEN_UNTIED = 1e8


@dataclass(frozen=True)
class Errors:
    """How far an answer is from the truth, in the norms of the certificate."""

    energy: float  # |u - u*|_K / |u*|_K
    force: float  # |l - l*|_W / |l*|_W; of a program |l - l*| over |(l*, nu*)|, equilibrated, where these are unique
    readings: dict[str, tuple[float, ...]]  # "energy_error", "force_error": what a bound of it may mean
    contact: np.ndarray | None  # (m,) |l_i - l_i*|, None where the forces are not unique
    blurred: float = 0.0  # what the rounding of K along rigid motions makes of an error, relative
    rounding: float = 0.0  # one rounding of every displacement, in the energy norm, relative to |u*|_K
    cost: float = 0.0  # of a program |J(u) - J(u*)| over the larger term of J(u*)

    @property
    def worst(self) -> float:
        return max(self.energy, self.force, self.cost)


@dataclass(frozen=True, eq=False)
class Truth:
    """The exact solution; norms are evaluated with `PRECISION` bits."""

    displacement: fmpq_mat  # (n, 1), up to motions that nothing drives and nothing holds
    force: fmpq_mat  # (m, 1), one of those with the unique resultant
    unique_forces: bool
    tie_force: np.ndarray  # (k,) one of those that fit, rounded
    stiffness: fmpq_mat
    compliance: fmpq_mat  # (m, m) W, of the tied bodies
    tie: fmpq_mat  # (k, 1) the same, exactly
    untied: fmpq_mat | None  # (m + k, m + k) [E; A] K^-1 [E; A]', where K is regular and there are ties
    nullity: int  # of K
    free: int  # motions that neither K, A nor a closed contact resists
    pivots: int  # 0 where a guess was right
    reduced: Reduced
    projected: bool  # K is singular to rounding, and was made so exactly
    program: Scaling | None  # the units in which forces are compared where K sees nothing of many unknowns that act
    condition: float  # kappa(K), see `condition`

    def _rounding(self, displacement: np.ndarray) -> float:
        """One rounding of every displacement, in the energy norm, relative to |u*|_K; eps where nothing is strained.

        It is far above eps where a body moves much and strains little.
        """
        data = self.reduced.data
        diagonal = floats(column(data.K[j, j] for j in range(data.unknowns)))
        moved = abs(floats(self.displacement)) + abs(displacement)
        size = float(np.linalg.norm(np.sqrt(abs(diagonal)) * moved))
        return float(np.finfo(float).eps) * max(1.0, size / self._sizes[0] if self._sizes[0] > 0 else 1.0)

    @cached_property
    def _sizes(self) -> tuple[float, float]:
        return _norm(self.stiffness, self.displacement), _norm(self.compliance, self.force)

    @cached_property
    def size(self) -> float:
        """The largest of |u*|_K, |l*|_W and what load and contact forces are worth where they act, |f_j| / sqrt(K_jj).

        All are square roots of energies. Forces that a rigid motion takes to where the load acts strain nothing.
        """
        data = self.reduced.data
        diagonal = floats(column(data.K[j, j] for j in range(data.unknowns)))
        root = np.sqrt(np.where(diagonal > 0, diagonal, np.inf))
        outer = (abs(floats(part)) / root for part in (data.f, data.E.transpose() * self.force))
        return max(*self._sizes, *(float(np.max(part, initial=0.0)) for part in outer))

    @cached_property
    def work(self) -> float:
        """sqrt(2 |f'u*|), which energies are relative to where nothing is strained [square root of energy]."""
        return float(np.sqrt(2 * abs(floats(self.reduced.data.f.transpose() * self.displacement)[0])))

    @cached_property
    def tiny(self) -> tuple[bool, bool]:
        """Whether |u*|_K and |l*|_W are next to nothing and judged against `size`."""
        return self._sizes[0] <= TINY * self.size, self._sizes[1] <= TINY * self.size

    @cached_property
    def force_size(self) -> float:
        """The largest contact force; where that is next to nothing, what the size of the problem stands for."""
        if not self.tiny[1]:
            return float(np.max(abs(floats(self.force))))
        compliance = max(floats(column(self.compliance[i, i] for i in range(self.compliance.nrows()))), default=0.0)
        return self.size / np.sqrt(compliance) if self.size > 0 < compliance else 1.0

    def rounded(self) -> tuple[np.ndarray, np.ndarray]:
        """The displacement and the forces in the nearest floats."""
        return floats(self.displacement), floats(self.force)

    @cached_property
    def representable(self) -> float:
        """The error that remains when the truth is rounded to floats: no float answer can be expected to do better."""
        return self.errors(*self.rounded()).worst

    def errors(self, displacement: np.ndarray, force: np.ndarray, tie_force: np.ndarray | None = None) -> Errors:
        """The errors of floats, relative; against the size of the problem where the truth is tiny.

        A bound may count forces of ties, too: where they are given it is compared with the error of all forces.
        """
        if not (np.all(np.isfinite(displacement)) and np.all(np.isfinite(force))):
            return Errors(np.inf, np.inf, {"energy_error": (np.inf,), "force_error": (np.inf,)}, None)
        rounding = self._rounding(displacement)
        du = column(displacement) - self.displacement
        dl = column(force) - self.force
        if self.program is not None:
            return self._errors_of_program(self.program, du, dl, rounding)
        energy, pushed = _norm(self.stiffness, du), _norm(self.compliance, dl)
        scales = [self.size if tiny else size for tiny, size in zip(self.tiny, self._sizes, strict=True)]
        # Where ties may take a part of what contacts push with, forces are compared by what the tied bodies feel.
        loose, whole = [], 0.0
        if self.untied is not None and tie_force is not None:
            change, every = stack(dl, column(tie_force) - self.tie), stack(self.force, self.tie)
            whole = _ratio(_norm(self.untied, change), _norm(self.untied, every))
        if self.untied is not None and self.unique_forces:
            loose = [_ratio(*(_norm(self.untied, stack(part, self.tie * 0)) for part in (dl, self.force)))]
        contact = abs(floats(dl)) if self.unique_forces else None
        readings = {
            "energy_error": self._readings(energy, 0, []),
            "force_error": self._readings(pushed, 1, loose),
        }
        if whole > 0:
            whole = max(whole, *readings["force_error"])
            seen = self.condition < SEEN_UNTIED and not self.tiny[1]
            readings["force_error"] = (whole,) if seen else (*readings["force_error"], whole)
        sizes = _ratio(energy, scales[0]), _ratio(pushed, scales[1])
        if tie_force is not None and 0 < len(tie_force) == self.reduced.data.A.nrows():  # one by one
            readings["force_error"] += (max(self._of_ties_alone(tie_force), *readings["force_error"]),)
        # The rounding of K along rigid motions has the same size.
        return Errors(*sizes, readings, contact, rounding if self.projected else 0.0, rounding)

    def _of_ties_alone(self, tie_force: np.ndarray) -> float:
        """The largest error of a tie's force over the largest force, each by what it strains where it acts."""
        data = self.reduced.data
        softness = [1 / data.K[j, j] if data.K[j, j] > 0 else fmpq(0) for j in range(data.unknowns)]

        def own(rows: fmpq_mat) -> np.ndarray:
            squares = (sum(rows[i, j] ** 2 * softness[j] for j in range(rows.ncols())) for i in range(rows.nrows()))
            return np.sqrt([number(square) for square in squares])

        contacts, ties = own(data.E), own(data.A)
        sizes = np.append(contacts * abs(floats(self.force)), ties * abs(self.tie_force))
        return _ratio(float(np.max(ties * abs(tie_force - self.tie_force))), float(np.max(sizes)))

    def _errors_of_program(self, units: Scaling, du: fmpq_mat, dl: fmpq_mat, rounding: float) -> Errors:
        """The errors where K alone is no measure: a linear program's answer is right or wrong by its energy."""
        data, u = self.reduced.data, self.displacement
        missing = data.f - data.K * u  # J(u* + d) - J(u*) = d'K d / 2 - d'(f - K u*)
        change = (du.transpose() * (data.K * du))[0, 0] / 2 - (du.transpose() * missing)[0, 0]
        terms = max(self.work**2, self._sizes[0] ** 2) / 2
        energy = _norm(self.stiffness, du)
        readings: dict[str, tuple[float, ...]] = {"energy_error": self._readings(energy, 0, [])}
        pushed = 0.0
        if self.unique_forces and data.A.rank() == len(self.tie_force):  # so that those of ties are unique, too
            factors, ties = units.contacts / units.force, units.ties / units.force
            largest = float(np.linalg.norm(np.concatenate([floats(self.force) * factors, self.tie_force * ties])))
            pushed = _ratio(float(np.linalg.norm(floats(dl) * factors)), largest)
            readings["force_error"] = (pushed,)
        strain = _ratio(energy, max(self._sizes[0], self.work))
        contact = abs(floats(dl)) if self.unique_forces else None
        return Errors(strain, pushed, readings, contact, 0.0, rounding, _ratio(abs(number(change)), terms))

    def _readings(self, error: float, which: int, others: list[float]) -> tuple[float, ...]:
        """The least that a bound must exceed, and the largest that it may be compared with.

        Where there are ties, the larger error with and without them; where the truth is next to nothing, relative to
        itself, to the size of the problem, or absolute.
        """
        own = _ratio(error, self._sizes[which])
        if self.tiny[which]:
            return (own, _ratio(error, self.size), error)
        return (max([own, *others]),)


def _ratio(size: float, scale: float) -> float:
    return size / scale if scale > 0 else size


def _norm(metric: fmpq_mat, vector: fmpq_mat) -> float:
    if not vector.nrows():
        return 0.0
    with flint.ctx.workprec(PRECISION):
        x = arb_mat(vector)
        square = (x.transpose() * (arb_mat(metric) * x))[0, 0]
        if square.contains(0):  # nothing, or less than the bits tell from nothing: decided in rational numbers
            square = arb((vector.transpose() * (metric * vector))[0, 0])
        return float(abs(square).sqrt().mid())


def find_truth(problem: Any, guesses: Iterable[np.ndarray] = (), max_pivots: int = 400) -> Truth:
    """The exact solution of a problem.

    Parameters
    ----------
    problem : ContactProblem without friction
    guesses : index arrays of closed contacts, tried in order before the finite method
    max_pivots : int

    Raises
    ------
    NoSolution
        Proven: the constraints conflict or the load drives a motion that nothing holds.
    Undecided
        `max_pivots` did not suffice.
    """
    reduced = reduce_problem(_data(problem))
    pivots = 0
    for found in _candidates(reduced, guesses):
        if reduced.holds(*found):
            break
    else:
        force, motion, pivots = reduced.lemke(max_pivots)
        found = (force, motion)
        if not reduced.holds(*found):
            raise ArithmeticError("the complementary solution fails the exact check")
    return _truth(problem, reduced, *found, pivots)


def _data(problem: Any) -> RationalProblem:
    """The floats as they stand; K that is singular to rounding for motions Z is P K P, P = I - Z (Z'Z)^-1 Z'."""
    data, K = of_floats(problem), problem.stiffness_rows.toarray()
    root = np.sqrt(np.where(np.diag(K) > 0, np.diag(K), 1.0))
    values, vectors = np.linalg.eigh(K / np.outer(root, root))
    Z = matrix(vectors[:, values < SINGULAR] / root[:, None])
    if data.K.rank() + Z.ncols() <= data.unknowns:
        return data
    along = Z * (Z.transpose() * Z).solve(Z.transpose() * data.K)
    left = data.K - along
    return replace(data, K=left - (left * Z) * (Z.transpose() * Z).solve(Z.transpose()))


def _candidates(reduced: Reduced, guesses: Iterable[np.ndarray]) -> Iterator[tuple[fmpq_mat, fmpq_mat]]:
    """Answers on guessed sets, each followed by two primal-dual corrections of its set."""
    tried: set[tuple[int, ...]] = set()
    for guess in guesses:
        closed = tuple(int(i) for i in guess)
        for _ in range(3):
            if closed in tried:
                break
            tried.add(closed)
            found = reduced.on_set(closed)
            if found is None:
                break
            yield found
            gap = (reduced.q + reduced.W * found[0] - reduced.G * found[1]).entries()
            pairs = zip(found[0].entries(), gap, strict=True)
            closed = tuple(i for i, (lam, w) in enumerate(pairs) if lam > 0 or w < 0)


def _tie_force(problem: Any, reduced: Reduced, u: fmpq_mat, force: fmpq_mat) -> fmpq_mat:
    data = reduced.data
    missing = data.f - data.K * u - data.E.transpose() * force
    solved = solve_any(matrix(problem.tie).transpose(), missing) if problem.ties else None
    return solved[0] if solved else column(np.zeros(problem.ties))


def _truth(problem: Any, reduced: Reduced, force: fmpq_mat, motion: fmpq_mat, pivots: int) -> Truth:
    data, u = reduced.data, reduced.displaced(force, motion)
    gap = data.gap(u).entries()
    closed = [i for i, w in enumerate(gap) if w == 0]
    rows = stack(take(data.E, closed), data.A)
    tie = _tie_force(problem, reduced, u, force)
    held = stack(data.K, data.A, take(data.E, [i for i in closed if force[i, 0] > 0]))
    return Truth(
        displacement=u,
        force=force,
        unique_forces=rows.nrows() == 0 or rows.rank() == rows.nrows(),
        tie_force=floats(tie),
        tie=tie,
        stiffness=data.K,
        compliance=reduced.W,
        untied=_untied_compliance(problem, reduced),
        nullity=data.K.nrows() - data.K.rank(),
        free=data.K.nrows() - held.rank(),
        pivots=pivots,
        reduced=reduced,
        projected=matrix(problem.stiffness) != data.K,
        program=equilibrated(problem)[1] if mostly_bare(problem) else None,
        condition=condition(problem, data.K.nrows() - data.K.rank()),
    )


def _untied_compliance(problem: Any, reduced: Reduced) -> fmpq_mat | None:
    data = reduced.data
    if not data.ties or data.K.rank() < data.unknowns:
        return None
    every = stack(data.E, matrix(problem.tie))
    return every * data.K.solve(every.transpose())


def condition(problem: Any, nullity: int) -> float:
    """kappa(K) with the diagonal scaled to one, on the nonzero spectrum; at most 1/eps."""
    K = problem.stiffness
    K = K.toarray() if hasattr(K, "toarray") else np.asarray(K)
    diagonal = np.diag(K)
    D = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values = np.linalg.eigvalsh(K * np.outer(D, D))
    if nullity == len(values):
        return 1.0
    return float(values[-1] / max(values[nullity], np.finfo(float).eps * values[-1]))
