"""The exact solution of a frictionless contact problem whose data are the floats as they stand.

Everything is rational (python-flint). With Z a basis of the motions that neither K nor A resists,

    [ K  A'  Z ] [ u0   -R ]   [ f   E' ]
    [ A  0   0 ] [ .     . ] = [ b   0  ]        u = u0 - R l + Z a,    Z'(f - E'l) = 0,    W = E R,
    [ Z' 0   0 ] [ .     . ]   [ 0   0  ]        gap = g - E u = q + W l - G a,    q = g - E u0,  G = E Z,

a linear complementarity problem with free variables a. A set of closed contacts that somebody guesses is tried first;
Lemke's method with lexicographic ratio tests (finite; Cottle, Pang and Stone 1992, section 4.4) decides where no guess
is right, and proves by its ray that there is no solution. Every answer is checked in rational arithmetic against the
problem as it was stated: equilibrium, gaps, signs, complementarity, ties. No solver of the package is used here.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import flint
import numpy as np
from flint import arb_mat, fmpq, fmpq_mat

from benchmarks.rational import (
    NoSolution,
    beside,
    column,
    floats,
    lemke,
    matrix,
    null_space,
    pivot_columns,
    solve_any,
    stack,
    take,
    zeros,
)

# Bits for norms of rational vectors: their cancellation costs at most twice the digits of the condition number.
PRECISION = 600
# A true size below this part of the size of the whole problem is judged absolutely.
TINY = 1e-12


@dataclass(frozen=True)
class Errors:
    """How far an answer is from the truth, in the norms of the certificate."""

    energy: float  # |u - u*|_K / |u*|_K
    force: float  # |l - l*|_W / |l*|_W
    readings: dict[str, tuple[float, ...]]  # "energy_error", "force_error": what a bound of it may mean
    contact: np.ndarray | None  # (m,) |l_i - l_i*|, None where the forces are not unique

    @property
    def worst(self) -> float:
        return max(self.energy, self.force)


@dataclass(frozen=True, eq=False)
class Truth:
    """The exact solution; norms are evaluated with `PRECISION` bits."""

    displacement: fmpq_mat  # (n, 1), up to motions that nothing drives and nothing holds
    force: fmpq_mat  # (m, 1), one of those with the unique resultant
    unique_forces: bool
    tie_force: np.ndarray  # (k,) one of those that fit, rounded
    stiffness: fmpq_mat
    compliance: fmpq_mat  # (m, m) W, of the tied bodies
    untied: fmpq_mat | None  # (m, m) E K^-1 E', where K is regular and there are ties
    nullity: int  # of K
    free: int  # motions that neither K, A nor a closed contact resists
    pivots: int  # 0 where a guess was right
    reduced: Reduced

    @cached_property
    def _sizes(self) -> tuple[float, float]:
        return _norm(self.stiffness, self.displacement), _norm(self.compliance, self.force)

    @cached_property
    def size(self) -> float:
        """The larger of |u*|_K and |l*|_W, both square roots of energies."""
        return max(self._sizes)

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

    def errors(self, displacement: np.ndarray, force: np.ndarray) -> Errors:
        """The errors of floats, relative; against the size of the problem where the truth is tiny."""
        if not (np.all(np.isfinite(displacement)) and np.all(np.isfinite(force))):
            return Errors(np.inf, np.inf, {"energy_error": (np.inf,), "force_error": (np.inf,)}, None)
        du = column(displacement) - self.displacement
        dl = column(force) - self.force
        energy, pushed = _norm(self.stiffness, du), _norm(self.compliance, dl)
        scales = [self.size if tiny else size for tiny, size in zip(self.tiny, self._sizes, strict=True)]
        loose = [] if self.untied is None else [_ratio(_norm(self.untied, dl), _norm(self.untied, self.force))]
        contact = abs(floats(dl)) if self.unique_forces else None
        readings = {
            "energy_error": self._readings(energy, 0, []),
            "force_error": self._readings(pushed, 1, loose),
        }
        return Errors(_ratio(energy, scales[0]), _ratio(pushed, scales[1]), readings, contact)

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
        return float(abs(square).sqrt().mid())


@dataclass(frozen=True, eq=False)
class Reduced:
    """The problem in its contact forces l and motions a (see the module)."""

    K: fmpq_mat
    f: fmpq_mat
    E: fmpq_mat
    g: fmpq_mat
    A: fmpq_mat
    b: fmpq_mat
    Z: fmpq_mat
    u0: fmpq_mat
    R: fmpq_mat
    W: fmpq_mat
    q: fmpq_mat
    G: fmpq_mat
    drive: fmpq_mat  # Z'f


def _reduce(problem: Any) -> Reduced:
    K, E, f, g = matrix(problem.stiffness), matrix(problem.normal), column(problem.load), column(problem.gap)
    A, b = _independent_ties(matrix(problem.tie), column(problem.tie_value))
    n, k = K.nrows(), A.nrows()
    Z = null_space(stack(K, A))
    r = Z.ncols()
    top = beside(K, A.transpose(), Z)
    system = stack(top, beside(A, zeros(k, k + r)), beside(Z.transpose(), zeros(r, k + r)))
    right = stack(beside(f, E.transpose()), beside(b, zeros(k, E.nrows())), zeros(r, 1 + E.nrows()))
    solved = take(system.solve(right), range(n)).transpose()
    u0, R = take(solved, [0]).transpose(), take(solved, range(1, 1 + E.nrows())).transpose()
    return Reduced(K, f, E, g, A, b, Z, u0, R, E * R, g - E * u0, E * Z, Z.transpose() * f)


def _independent_ties(A: fmpq_mat, b: fmpq_mat) -> tuple[fmpq_mat, fmpq_mat]:
    if not A.nrows():
        return A, zeros(0, 1)
    reduced, _ = beside(A, b).rref()
    leading = pivot_columns(reduced)
    if A.ncols() in leading:
        raise NoSolution("the ties contradict each other")
    kept = take(reduced, range(len(leading))).transpose()
    return take(kept, range(A.ncols())).transpose(), take(kept, [A.ncols()]).transpose()


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
    reduced = _reduce(problem)
    pivots = 0
    for found in _candidates(reduced, guesses):
        if _holds(reduced, *found):
            break
    else:
        force, motion, pivots = _lemke(reduced, max_pivots)
        found = (force, motion)
        if not _holds(reduced, *found):
            raise ArithmeticError("the complementary solution fails the exact check")
    return _truth(problem, reduced, *found, pivots)


def _candidates(reduced: Reduced, guesses: Iterable[np.ndarray]) -> Iterator[tuple[fmpq_mat, fmpq_mat]]:
    """Answers on guessed sets, each followed by two primal-dual corrections of its set."""
    tried: set[tuple[int, ...]] = set()
    for guess in guesses:
        closed = tuple(int(i) for i in guess)
        for _ in range(3):
            if closed in tried:
                break
            tried.add(closed)
            found = on_set(reduced, closed)
            if found is None:
                break
            yield found
            gap = (reduced.q + reduced.W * found[0] - reduced.G * found[1]).entries()
            pairs = zip(found[0].entries(), gap, strict=True)
            closed = tuple(i for i, (lam, w) in enumerate(pairs) if lam > 0 or w < 0)


def on_set(reduced: Reduced, closed: Iterable[int], softness: Iterable[fmpq] = ()) -> tuple[fmpq_mat, fmpq_mat] | None:
    """Forces and motions with the contacts of the set closed and the others without force.

    With a softness (length / force) for each contact of the set they are springs instead: the penalty answer.
    """
    closed = tuple(closed)
    count, r = len(closed), reduced.G.ncols()
    rows = take(reduced.W, closed)
    W = take(rows.transpose(), closed).transpose()
    for i, soft in enumerate(softness):
        W[i, i] += soft
    G, q = take(reduced.G, closed), take(reduced.q, closed)
    system = stack(beside(W, -1 * G), beside(G.transpose(), zeros(r, r)))
    solved = solve_any(system, stack(-1 * q, reduced.drive))
    if solved is None:
        return None
    values = solved[0].entries()
    force = zeros(reduced.W.nrows(), 1)
    for i, value in zip(closed, values[:count], strict=True):
        force[i, 0] = value
    return force, fmpq_mat(r, 1, values[count:])


def _holds(reduced: Reduced, force: fmpq_mat, motion: fmpq_mat) -> bool:
    """The proof: the problem as it was stated, in rational arithmetic."""
    u = displaced(reduced, force, motion)
    gap = (reduced.g - reduced.E * u).entries()
    pushes = force.entries()
    if any(lam < 0 for lam in pushes) or any(w < 0 for w in gap):
        return False
    if any(lam != 0 and w != 0 for lam, w in zip(pushes, gap, strict=True)):
        return False
    if reduced.A * u != reduced.b:
        return False
    missing = reduced.f - reduced.K * u - reduced.E.transpose() * force
    if not reduced.A.nrows():
        return all(x == 0 for x in missing.entries())
    return solve_any(reduced.A.transpose(), missing) is not None


def displaced(reduced: Reduced, force: fmpq_mat, motion: fmpq_mat) -> fmpq_mat:
    """u = u0 - R l + Z a."""
    return reduced.u0 - reduced.R * force + reduced.Z * motion


def _tie_force(problem: Any, reduced: Reduced, u: fmpq_mat, force: fmpq_mat) -> np.ndarray:
    missing = reduced.f - reduced.K * u - reduced.E.transpose() * force
    solved = solve_any(matrix(problem.tie).transpose(), missing) if problem.ties else None
    return floats(solved[0]) if solved else np.zeros(problem.ties)


def _truth(problem: Any, reduced: Reduced, force: fmpq_mat, motion: fmpq_mat, pivots: int) -> Truth:
    u = displaced(reduced, force, motion)
    gap = (reduced.g - reduced.E * u).entries()
    closed = [i for i, w in enumerate(gap) if w == 0]
    rows = stack(take(reduced.E, closed), reduced.A)
    held = stack(reduced.K, reduced.A, take(reduced.E, [i for i in closed if force[i, 0] > 0]))
    return Truth(
        displacement=u,
        force=force,
        unique_forces=rows.nrows() == 0 or rows.rank() == rows.nrows(),
        tie_force=_tie_force(problem, reduced, u, force),
        stiffness=reduced.K,
        compliance=reduced.W,
        untied=_untied_compliance(reduced),
        nullity=reduced.K.nrows() - reduced.K.rank(),
        free=reduced.K.nrows() - held.rank(),
        pivots=pivots,
        reduced=reduced,
    )


def _untied_compliance(reduced: Reduced) -> fmpq_mat | None:
    if not reduced.A.nrows() or reduced.K.rank() < reduced.K.nrows():
        return None
    return reduced.E * reduced.K.solve(reduced.E.transpose())


def _lemke(reduced: Reduced, max_pivots: int) -> tuple[fmpq_mat, fmpq_mat, int]:
    """w = p + M z >= 0, z >= 0, w'z = 0 with a = a+ - a-; M is positive semidefinite, so a ray proves infeasibility."""
    m, r = reduced.W.nrows(), reduced.G.ncols()
    G, GT, none = reduced.G, reduced.G.transpose(), zeros(r, 2 * r)
    M = stack(beside(reduced.W, -1 * G, G), beside(GT, none), beside(-1 * GT, none))
    p = stack(reduced.q, -1 * reduced.drive, reduced.drive)
    z, pivots = lemke(M, p, max_pivots)
    motion = [z[m + i] - z[m + r + i] for i in range(r)]
    return fmpq_mat(m, 1, z[:m]), fmpq_mat(r, 1, motion), pivots


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
