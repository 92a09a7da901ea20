"""Rigorous enclosures of every displacement and force of a problem whose data are not small.

Refinement leaves an approximation with residuals r1 = f - K u - B'y and r2 = c - B u on the contacts that push and the
ties (B, c), known without rounding. The errors e_u, e_y solve the same linear system, in scaled unknowns

    (K + B'B) e_u + B'e_y = r1 + B'r2 =: r,    B e_u = r2,

so that with a <= lambda_min(K + B'B), |K + B'B| <= h, s <= lambda_min(BB') and |B|^2 <= t

    |e_y| <= h/s (sqrt(t) |r| / a + |r2|),    |e_u| <= (|r| + sqrt(t) |e_y|) / a.

All four are crude, and proven by one factorisation in floats (`contactqp.oracle.exact.definite`): r is as small as
refinement makes it. The contact set is right where every force of it and every gap outside of it is strictly positive.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import NotCertified
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution
from contactqp.oracle.exact.definite import EPS, SAFE, largest_row_sum, least_eigenvalue
from contactqp.oracle.exact.exact_solution import Floats
from contactqp.oracle.exact.fixed_point import Fixed
from contactqp.oracle.exact.refinement import Refined


@dataclass(frozen=True, eq=False)
class Bounds:
    """Of the scaled system of a contact set: a, h, s and t of the module, all proven."""

    scale: Floats  # (n,) of the unknowns
    length: Floats  # (k + c,) of the ties' and contacts' rows
    a: float
    h: float
    s: float
    t: float


@dataclass(frozen=True, eq=False)
class Enclosure:
    """Radii around the approximation of a `Refined`; its contact set is proven."""

    refined: Refined
    displacement: Floats  # (n,)
    normal_force: Floats  # (m,)
    tie_force: Floats  # (k,)
    gap: Floats  # (m,)
    definite: bool  # the stiffness is positive definite within the ties: the only equilibrium, and the minimum


def regular(problem: ContactProblem, closed: Any, solution: Solution) -> Bounds:
    """The proof that the system of closed contacts (c,) has one solution, and by how much.

    Raises
    ------
    NotCertified
        It was not found.
    """
    K, scale = _scaled(problem)
    B, length = _rows(sp.vstack([problem.tie, problem.normal[closed]]), scale)
    held, pushed = sp.csc_matrix(B.T @ B), sp.csc_matrix(B @ B.T)
    h, t = largest_row_sum(K) + largest_row_sum(abs(B).T @ abs(B)), largest_row_sum(abs(B) @ abs(B).T)
    a = least_eigenvalue(K + held, _terms(B) * EPS * h)
    s = least_eigenvalue(pushed, _terms(B) * EPS * t)
    if a is None or s is None:
        what = "the stiffness, with the contacts that push," if a is None else "the rows of the contacts that push"
        why = "is not proven to be positive definite" if a is None else "are not proven to be independent"
        raise NotCertified(f"exact: {what} {why}: forces or motions may not be unique", solution)
    return Bounds(scale, length, a, h, s, t)


def is_convex(problem: ContactProblem) -> bool:
    """Whether the stiffness is proven to be positive definite on the motions that the ties leave."""
    K, scale = _scaled(problem)
    B, _ = _rows(sp.csr_matrix(problem.tie), scale)
    h = largest_row_sum(K) + largest_row_sum(abs(B).T @ abs(B))
    return least_eigenvalue(sp.csc_matrix(K + B.T @ B), _terms(B) * EPS * h) is not None


def enclose(refined: Refined) -> Enclosure:
    """Radii of all components.

    Raises
    ------
    NotCertified
        The system is not proven to be regular (redundant contacts, floating bodies that nothing holds, floats too
        ill-conditioned), or a force or a gap is not proven to be positive (a contact that just touches).
    """
    problem, closed = refined.problem, refined.closed
    bounds = regular(problem, closed, refined.first)
    scale, length, a, h, s, t = bounds.scale, bounds.length, bounds.a, bounds.h, bounds.s, bounds.t
    r1 = _norm(refined.imbalance, scale)
    ties, contacts = length[: problem.ties], length[problem.ties :]
    r2 = float(np.hypot(_norm(refined.tie_error, ties), _norm(refined.gap[closed], contacts)))
    r = (r1 + np.sqrt(t) * r2) * SAFE
    forces = h / s * (np.sqrt(t) * r / a + r2) * SAFE
    motion = (r + np.sqrt(t) * forces) / a * SAFE
    push, gap = np.zeros(problem.contacts), np.zeros(problem.contacts)
    push[closed] = contacts * forces * SAFE
    largest = _largest(problem.normal, scale)
    reach = largest * np.sqrt(_squares(problem.normal, scale, largest))
    gap[:] = reach * motion * SAFE
    gap[closed] = 0.0
    _refuse_undecided(refined, push, gap)
    return Enclosure(refined, scale * motion * SAFE, push, ties * forces * SAFE, gap, is_convex(problem))


def _scaled(problem: ContactProblem) -> tuple[Any, Floats]:
    """D K D with about ones on the diagonal, and the diagonal of D (n,)."""
    scale = _power_of_two(problem.diagonal)
    D = sp.diags(scale)
    return sp.csc_matrix(D @ sp.csc_matrix(problem.stiffness) @ D), scale


def _rows(rows: Any, scale: Floats) -> tuple[Any, Floats]:
    """Rows times D, made about one long, and what by."""
    rows = sp.csr_matrix(rows)
    largest = _largest(rows, scale)
    length = _power_of_two(_squares(rows, scale, largest)) / largest
    return sp.csr_matrix(sp.diags(length) @ rows @ sp.diags(scale)), length


def _largest(rows: Any, scale: Floats) -> Floats:
    """About the largest entry of each row times D, a power of two: squares of what is left are within doubles."""
    entries = sp.csr_matrix(abs(sp.csr_matrix(rows)) @ sp.diags(scale))
    most = entries.max(axis=1).toarray().ravel() if entries.shape[0] and entries.shape[1] else np.ones(rows.shape[0])
    return np.asarray(np.exp2(np.round(np.log2(np.where(most > 0, most, 1.0)))))


def _squares(rows: Any, scale: Floats, largest: Floats) -> Floats:
    """Sums of squares of the rows of diag(largest)^-1 E D."""
    entries = sp.diags(1 / largest) @ sp.csr_matrix(rows) @ sp.diags(scale)
    return np.asarray(entries.multiply(entries).sum(axis=1)).ravel()


def _terms(B: Any) -> float:
    """Terms of the sums that make B'B and BB', and some for forming them."""
    down, across = np.diff(sp.csc_matrix(B).indptr), np.diff(B.indptr)
    return float(np.max(across, initial=0)) + float(np.max(down, initial=0)) + 4


def _power_of_two(squares: Any) -> Floats:
    """1 / sqrt of positive numbers to a power of two, which scales without rounding."""
    squares = np.asarray(squares, dtype=float)
    return np.exp2(-np.round(np.log2(np.where(squares > 0, squares, 1.0)) / 2))


def _norm(values: Fixed, scale: Floats) -> float:
    """An upper bound of |diag(scale) x|."""
    largest = values.exponent
    magnified = values.floats_at(-largest) * scale
    # What has underflown is beneath the term added.
    return float((np.linalg.norm(magnified) + 1e-280 * len(scale)) * SAFE * 2.0 ** max(largest, -900))


def _refuse_undecided(refined: Refined, push: Floats, gap: Floats) -> None:
    problem = refined.problem
    forces, gaps = refined.normal_force.floats(), refined.gap.floats()
    closed = np.zeros(problem.contacts, dtype=bool)
    closed[refined.closed] = True
    weak = np.flatnonzero(np.where(closed, forces <= 2 * push, gaps <= 2 * gap))
    if weak.size:
        named = ", ".join(problem.contact_name(int(i)) for i in weak[:8])
        more = f" and {weak.size - 8} more" if weak.size > 8 else ""
        raise NotCertified(
            f"exact: neither the gap nor the force of {named}{more} is proven to be positive: what just touches is "
            "decided in rational numbers only, for smaller problems",
            refined.first,
        )
