"""A frictionless contact problem in rational numbers as a linear complementarity problem, and Lemke's answer to it.

With Z a basis of the motions that neither K nor A resists,

    [ K  A'  Z ] [ u0   -R ]   [ f   E' ]
    [ A  0   0 ] [ .     . ] = [ b   0  ]        u = u0 - R l + Z a,    Z'(f - E'l) = 0,    W = E R,
    [ Z' 0   0 ] [ .     . ]   [ 0   0  ]        gap = g - E u = q + W l - G a,    q = g - E u0,  G = E Z,

a linear complementarity problem with free variables a. Lemke's method decides it, and proves by its ray that there is
no solution.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from flint import fmpq, fmpq_mat

from contactqp.oracle.exact.exact_problem import RationalProblem
from contactqp.oracle.exact.lemke import lemke
from contactqp.oracle.exact.rational import (
    NoSolution,
    beside,
    independent_rows,
    null_space,
    solve_any,
    stack,
    take,
    take_columns,
    zeros,
)


@dataclass(frozen=True, eq=False)
class Reduced:
    """The problem in its contact forces l and motions a (see the module)."""

    data: RationalProblem  # with ties that are independent
    Z: fmpq_mat
    u0: fmpq_mat
    R: fmpq_mat
    W: fmpq_mat
    q: fmpq_mat
    G: fmpq_mat
    drive: fmpq_mat  # Z'f

    def displaced(self, force: fmpq_mat, motion: fmpq_mat) -> fmpq_mat:
        """u = u0 - R l + Z a."""
        return self.u0 - self.R * force + self.Z * motion

    def on_set(self, closed: Iterable[int], softness: Iterable[fmpq] = ()) -> tuple[fmpq_mat, fmpq_mat] | None:
        """Forces and motions with the contacts of the set closed and the others without force.

        With a softness (length / force) for each contact of the set they are springs instead: the penalty answer.
        """
        closed = tuple(closed)
        count, r = len(closed), self.G.ncols()
        W = take_columns(take(self.W, closed), closed)
        for i, soft in enumerate(softness):
            W[i, i] += soft
        G, q = take(self.G, closed), take(self.q, closed)
        system = stack(beside(W, -1 * G), beside(G.transpose(), zeros(r, r)))
        solved = solve_any(system, stack(-1 * q, self.drive))
        if solved is None:
            return None
        values = solved[0].entries()
        force = zeros(self.W.nrows(), 1)
        for i, value in zip(closed, values[:count], strict=True):
            force[i, 0] = value
        return force, fmpq_mat(r, 1, values[count:])

    def lemke(self, max_pivots: int) -> tuple[fmpq_mat, fmpq_mat, int]:
        """Forces, motions and the number of pivots; a = a+ - a-, and a ray proves that there is no solution."""
        m, r = self.W.nrows(), self.G.ncols()
        G, GT, none = self.G, self.G.transpose(), zeros(r, 2 * r)
        M = stack(beside(self.W, -1 * G, G), beside(GT, none), beside(-1 * GT, none))
        z, pivots = lemke(M, stack(self.q, -1 * self.drive, self.drive), max_pivots)
        motion = [z[m + i] - z[m + r + i] for i in range(r)]
        return fmpq_mat(m, 1, z[:m]), fmpq_mat(r, 1, motion), pivots

    def holds(self, force: fmpq_mat, motion: fmpq_mat) -> bool:
        """The proof: the problem as it was stated, in rational arithmetic."""
        data, u = self.data, self.displaced(force, motion)
        gap, pushes = data.gap(u).entries(), force.entries()
        if any(lam < 0 for lam in pushes) or any(w < 0 for w in gap):
            return False
        if any(lam != 0 and w != 0 for lam, w in zip(pushes, gap, strict=True)):
            return False
        missing = data.f - data.K * u - data.E.transpose() * force
        return data.A * u == data.b and solve_any(data.A.transpose(), missing) is not None


def reduce_problem(data: RationalProblem) -> Reduced:
    """Raises NoSolution where the ties contradict each other."""
    kept = _independent_ties(data)
    data = RationalProblem(
        data.K, data.f, data.E, data.g, take(data.A, kept), take(data.b, kept), data.T, data.friction, data.slip_origin
    )
    n, k, m = data.unknowns, data.ties, data.contacts
    Z = null_space(stack(data.K, data.A))
    r = Z.ncols()
    top = beside(data.K, data.A.transpose(), Z)
    system = stack(top, beside(data.A, zeros(k, k + r)), beside(Z.transpose(), zeros(r, k + r)))
    right = stack(beside(data.f, data.E.transpose()), beside(data.b, zeros(k, m)), zeros(r, 1 + m))
    solved = take(system.solve(right), range(n)).transpose()
    u0, R = take(solved, [0]).transpose(), take(solved, range(1, 1 + m)).transpose()
    return Reduced(data, Z, u0, R, data.E * R, data.gap(u0), data.E * Z, Z.transpose() * data.f)


def _independent_ties(data: RationalProblem) -> list[int]:
    kept = independent_rows(data.A)
    if len(kept) < data.ties and solve_any(data.A, data.b) is None:
        raise NoSolution("the ties contradict each other")
    return kept
