"""Contact forces of many load cases by influence functions: a product with the loads and a small system for each.

Let B = [E; A] be the rows of contacts and ties and Y = K^-1 B' their influence functions, the displacements under unit
forces along them. With W = B Y the forces l of a load f within the limits c = (g, b) are, on closed contacts and ties
C,

    W_CC l_C = (Y'f - c)_C,    and the gaps of the other contacts    (c - Y'f + W l)_i,

in which no unknown but those of contacts appears. Rows are scaled so that W_ii = 1, and lengths and forces with them.

Every answer is proven. The forces computed for C solve a system whose right-hand side is off by their residual r and
by e, the error of Y'f, of W and of the products with them. With V = W_CC^-1 the forces l* of the answer on C satisfy

    |l - l*| <= |V| (|r| + e),    |gap_i - gap_i*| <= e_i + |W_iC| |V| (|r| + e),

and where forces are positive and gaps open by more than these bounds, l* meets the conditions of Karush, Kuhn and
Tucker: K being positive definite, it is the solution. A case that is nearer to another set, or less accurate than an
answer has to be, is left to `solve`.

Where the least eigenvalue w of W for all contacts and ties tells enough, |V| x is not formed: the eigenvalues of W_CC
are not less, so that no entry of V x exceeds |x|/w.

The influence functions are corrected once, by residuals with digits beyond double precision (`linalg.sliced`). The size
q of the correction, relative to the functions, tells that of what is left, q^2, and ALLOWANCE times as much is counted,
as it is in certificates. A product of vectors, added up in parts of p numbers and these in groups of p, is off by at
most (2 p + number of groups) eps/2 of the sum of its terms' sizes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.linalg.condensation import Condensation
from contactqp.linalg.dense import lower_factor
from contactqp.linalg.runtime import lapack
from contactqp.linalg.sliced import LEFT_OUT, SlicedStiffness
from contactqp.model.arrays import Array, Mask, Vector
from contactqp.model.problem import ContactProblem

EPS = float(np.finfo(float).eps)
# What corrections of influence functions tell of their errors is counted so many times; corrections larger than a part
# of the functions tell nothing.
ALLOWANCE, LARGEST_CORRECTION = 1e4, 1e-6
# Influence functions at once: factors are read once for all of them, and some fifteen arrays of their size are there
# for a while, which should not take more than all functions at the loaded unknowns, unless that is next to nothing.
FEWEST, MOST, ARRAYS = 6, 32, 15
# Terms of a product that are added up by themselves.
PART = 64
# Corrections of the set of closed contacts for one load, at most, and sets whose systems are kept.
MOST_SETS, KEPT = 50, 16
# Forces are proven to this part of the largest, gaps to this part of the largest length, or left to `solve`; so is what
# is nearer than `GRAZING` of these to another set of closed contacts.
PROVEN, GRAZING = 1e-7, 1e-8
# Lengths, scaled, whose products neither underflow nor overflow.
SMALLEST, LARGEST = 1e-100, 1e100
# An inverse is known to be near where what is missing of it is less than this.
NEAR = 0.1


@dataclass(frozen=True, eq=False)
class ProvenForces:
    """The answer of one load case on its contacts and, behind these, its ties."""

    force: Vector  # (m + k,)
    bound: Vector  # (m + k,) of the error of each force
    gap: Vector  # (m,)
    closed: Mask  # (m,)


class Influence:
    """The influence functions of the contacts and ties of a problem that does not float, at the loaded unknowns."""

    def __init__(self, problem: ContactProblem, condensation: Condensation, loaded: NDArray[np.intp]) -> None:
        operator = condensation.delassus
        stiffness = SlicedStiffness(problem.stiffness_rows, condensation.unknown_scale)
        self._scale, self._contacts = operator.row_scale, problem.contacts
        rows = sp.csr_array(sp.diags(self._scale) @ sp.vstack([problem.normal, problem.tie]))
        unit, count = condensation.unknown_scale, len(self._scale)
        self._functions, W, largest = np.empty((len(loaded), count)), np.empty((count, count)), np.empty(count)
        correction = 0.0
        at_once = min(MOST, max(FEWEST, count * len(loaded) // (ARRAYS * len(unit))))
        for start in range(0, count, at_once):
            of = slice(start, start + at_once)
            Y = condensation.responses(condensation.scale[:, None] * operator.response[:, of])
            change = condensation.free_displacements(stiffness.residual(rows[of].T.toarray(), Y))
            Y += change
            self._functions[:, of], W[:, of] = Y[loaded], rows @ Y
            largest[of] = np.max(abs(Y) / unit[:, None], axis=0)
            correction = max(correction, float(np.max(abs(change) / (unit[:, None] * largest[of]))))
        self.accurate = bool(correction <= LARGEST_CORRECTION and np.all(np.isfinite(largest)))
        self._W = (W + W.T) / 2
        # Errors of Y'f are this times D'|f|; those of W_ij the product of row i's and column j's.
        refined = EPS + ALLOWANCE * correction**2 + stiffness.longest * LEFT_OUT / EPS * correction
        terms, longest = 2 * PART + len(loaded) // PART**2 + 2, int(np.max(np.diff(rows.indptr), initial=0))
        self._unit, self._of_load = unit[loaded], (refined + EPS / 2 * terms) * largest
        self._of_column, self._of_row = (refined + EPS * longest) * largest, abs(rows) @ unit
        self._least_eigenvalue = self._bounded_eigenvalue()
        self._systems: dict[bytes, _System | None] = {}

    def free(self, loads: Any) -> tuple[Array, Vector]:
        """Return Y'f, scaled (q, m + k), of loads at the loaded unknowns (q, loaded), and the size D'|f| of each."""
        found = np.zeros((loads.shape[0], len(self._scale)))
        for first in range(0, len(self._unit), PART**2):
            group = np.zeros_like(found)
            for start in range(first, min(first + PART**2, len(self._unit)), PART):
                group += loads[:, start : start + PART] @ self._functions[start : start + PART]
            found += group
        return found, np.asarray(abs(loads) @ self._unit)

    def forces(self, free: Vector, size: float, limit: Vector, closed: Mask) -> ProvenForces | None:
        """Return the proven forces of a load, or None where it is left to `solve`.

        Parameters
        ----------
        free, size : (m + k,) array and float
            What `free` returns of the load.
        limit : (m + k,) array
            Gaps and tie values.
        closed : (m,) array
            The contacts to begin with.
        """
        m, length = self._contacts, self._scale * limit
        found = self._on_own_set(free - length, closed)
        if found is None:
            return None
        system, force, slack = found
        members, pushing, terms = system.members, abs(force), abs(free) + abs(length)
        error = self._of_load * size + EPS * (len(members) + 4) * (terms + pushing.sum())
        error += self._of_row * (self._of_column[members] @ pushing)
        error += self._of_column * (self._of_row[members] @ pushing)
        off = abs(slack[members]) + error[members]
        on = np.zeros(m, dtype=bool)
        on[members[members < m]] = True
        largest = max(float(terms.max(initial=0.0)), float(pushing.max(initial=0.0)))
        if not SMALLEST < largest < LARGEST:
            return None
        bound = np.full(len(members), np.linalg.norm(off) / self._least_eigenvalue)
        if bound.max(initial=0.0) > PROVEN * pushing.max(initial=0.0):
            bound = system.bounded(off)
        of_gap = error + abs(self._W[:, members]) @ bound
        pushes = force[: on.sum()] > np.maximum(bound[: on.sum()], GRAZING * largest)
        opens = slack[:m][~on] > np.maximum(of_gap[:m], GRAZING * largest)[~on]
        accurate = bound.max(initial=0.0) <= PROVEN * pushing.max(initial=0.0) and of_gap.max() <= PROVEN * largest
        if not (pushes.all() and opens.all() and accurate):
            return None
        forces, bounds = np.zeros(len(free)), np.zeros(len(free))
        forces[members], bounds[members] = force, bound
        gap = np.where(on, 0.0, slack[:m] / self._scale[:m])
        return ProvenForces(forces * self._scale, bounds * self._scale, gap, on)

    def _bounded_eigenvalue(self) -> float:
        """Return a number that no eigenvalue of the true W is less than, next to nothing where none is known."""
        from scipy.linalg import eigvalsh

        values = eigvalsh(self._W, check_finite=False) if self.accurate else np.zeros(1)
        rounding = 8 * len(self._W) * EPS * values[-1]  # of LAPACK's eigenvalues, and of W's two halves
        missing = 2 * np.linalg.norm(self._of_row) * np.linalg.norm(self._of_column)
        return max(float(values[0] - rounding - missing), float(np.finfo(float).tiny))

    def _on_own_set(self, excess: Vector, closed: Mask) -> tuple[_System, Vector, Vector] | None:
        """Return the system of the contacts that a load closes, their forces and all gaps, scaled."""
        m = self._contacts
        for _ in range(MOST_SETS):
            system = self._system(closed)
            if system is None:
                return None
            force = system.solve(excess[system.members])
            slack = self._W[:, system.members] @ force - excess
            signs = slack[:m] < 0
            signs[closed] = force[: np.count_nonzero(closed)] > 0
            if np.array_equal(signs, closed):
                return system, force, slack
            closed = signs
        return None

    def _system(self, closed: Mask) -> _System | None:
        """Return the system of a set of closed contacts and the ties; None where their rows are dependent."""
        key = closed.tobytes()
        if key not in self._systems:
            if len(self._systems) >= KEPT:
                self._systems.pop(next(iter(self._systems)))
            ties = np.arange(self._contacts, len(self._scale))
            members = np.concatenate([np.flatnonzero(closed), ties])
            W = self._W[np.ix_(members, members)]
            factor = lower_factor(W)
            of_entries = self._of_row[members], self._of_column[members]
            self._systems[key] = None if factor is None else _System(members, W, factor, *of_entries)
        return self._systems[key]


class _System:
    """W_CC of a set of closed contacts and ties, factorised."""

    def __init__(self, members: NDArray[np.intp], W: Array, factor: Array, of_row: Vector, of_column: Vector) -> None:
        self.members, self._W, self._factor = members, W, factor
        self._of_row, self._of_column = of_row, of_column

    def solve(self, right: Vector) -> Vector:
        return np.asarray(lapack().dpotrs(self._factor, right, lower=True)[0]) if len(right) else right

    def bounded(self, size: Vector) -> Vector:
        """Return bounds of W_CC^-1 x for all |x| <= size, infinite where the inverse is not known."""
        sizes, missing = self._inverse
        if not missing < NEAR:
            return np.full(len(size), np.inf)
        found = sizes @ size
        return np.asarray(found + missing / (1 - missing) * found.max(initial=0.0))

    @cached_property
    def _inverse(self) -> tuple[Any, float]:
        """|V| of the inverse in doubles and q >= |I - V W|, the errors of W included."""
        count = len(self.members)
        if not count:
            return np.zeros((0, 0)), 0.0
        V = np.asarray(lapack().dpotrs(self._factor, np.eye(count), lower=True)[0])
        sizes = abs(V)
        missing = abs(np.eye(count) - V @ self._W).sum(axis=1) + EPS * count * (sizes @ abs(self._W)).sum(axis=1)
        missing += (sizes @ self._of_row) * self._of_column.sum() + (sizes @ self._of_column) * self._of_row.sum()
        return sizes, float(missing.max())
