"""Enclose every displacement and force of a problem of floats in proven intervals."""

from __future__ import annotations

import time
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from contactqp.errors import NoEquilibrium, NotCertified, NotConverged, Unsupported
from contactqp.linalg.iteration import factors_are_dear, factors_take
from contactqp.model.arrays import EPS, Indices, tell
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import AnswerOf, FreeMotion, Solution
from contactqp.oracle.exact.exact_solution import ExactSolution, Floats, Fractions, Parts
from contactqp.oracle.exact.rational_answer import Asked, proof_of, symmetrised
from contactqp.oracle.exact.refinement import (
    MOST_WORK,
    SAFE,
    Fixed,
    FixedMatrix,
    Refined,
    fixed,
    is_dense,
    largest_row_sum,
    least_eigenvalue,
    refine,
)
from contactqp.solving.solve import solve

# Rigorous enclosures of every displacement and force of a problem whose data are not small.
#
# Refinement leaves an approximation with residuals r1 = f - K u - B'y and r2 = c - B u on the contacts that push and
# the ties (B, c), known without rounding. The errors e_u, e_y solve the same linear system, in scaled unknowns
#
#     (K + B'B) e_u + B'e_y = r1 + B'r2 =: r,    B e_u = r2,
#
# so that with a <= lambda_min(K + B'B), |K + B'B| <= h, s <= lambda_min(BB') and |B|^2 <= t
#
#     |e_y| <= h/s (sqrt(t) |r| / a + |r2|),    |e_u| <= (|r| + sqrt(t) |e_y|) / a.
#
# All four are crude, and proven by one factorisation in floats (`contactqp.oracle.exact.refinement`): r is as small as
# refinement makes it. The contact set is right if all its forces and all gaps of other contacts are strictly
# positive.


@dataclass(frozen=True, eq=False)
class Bounds:
    """The proven bounds a, h, s and t of the scaled system of a contact set."""

    scale: Floats  # (n,) scales of the unknowns
    length: Floats  # (k + c,) scales of the rows of ties and contacts
    a: float
    h: float
    s: float
    t: float


@dataclass(frozen=True, eq=False)
class Enclosure(AnswerOf[Floats, None]):
    """Radii around the approximation of a `Refined`; its contact set is proven."""

    refined: Refined
    gap: Floats  # (m,)
    definite: bool  # the stiffness is positive definite within the ties, so that the equilibrium is the unique minimum


def regular(problem: ContactProblem, closed: Any, solution: Solution) -> Bounds:
    """Return proven bounds by which the system of closed contacts (c,) has a unique solution.

    Raises NotCertified: no proof was found.
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
    """Return whether the stiffness is proven to be positive definite on the motions allowed by the ties."""
    K, scale = _scaled(problem)
    B, _ = _rows(sp.csr_matrix(problem.tie), scale)
    h = largest_row_sum(K) + largest_row_sum(abs(B).T @ abs(B))
    return least_eigenvalue(sp.csc_matrix(K + B.T @ B), _terms(B) * EPS * h) is not None


def enclose(refined: Refined) -> Enclosure:
    """Return proven radii around all components of a refined answer.

    Raises NotCertified: the system is not proven to be regular (redundant contacts, floating bodies, ill-conditioned
    data), or a force or a gap is not proven to be positive (a contact that just touches).
    """
    problem, closed = refined.problem, refined.closed
    tell("prove the contact set")
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
    return Enclosure(scale * motion * SAFE, push, None, ties * forces * SAFE, refined, gap, is_convex(problem))


def _scaled(problem: ContactProblem) -> tuple[Any, Floats]:
    """Return D K D, with a diagonal of about one, and the diagonal (n,) of D, of powers of two."""
    scale = _power_of_two(problem.diagonal)
    D = sp.diags(scale)
    return sp.csc_matrix(D @ sp.csc_matrix(problem.stiffness) @ D), scale


def _rows(rows: Any, scale: Floats) -> tuple[Any, Floats]:
    """Return rows times D, scaled to lengths of about one, and their scales."""
    rows = sp.csr_matrix(rows)
    largest = _largest(rows, scale)
    length = _power_of_two(_squares(rows, scale, largest)) / largest
    return sp.csr_matrix(sp.diags(length) @ rows @ sp.diags(scale)), length


def _largest(rows: Any, scale: Floats) -> Floats:
    """Return a power of two near the largest entry of each row times D, so that squares do not overflow."""
    entries = sp.csr_matrix(abs(sp.csr_matrix(rows)) @ sp.diags(scale))
    most = entries.max(axis=1).toarray().ravel() if entries.shape[0] and entries.shape[1] else np.ones(rows.shape[0])
    return np.asarray(np.exp2(np.round(np.log2(np.where(most > 0, most, 1.0)))))


def _squares(rows: Any, scale: Floats, largest: Floats) -> Floats:
    """Return the sums of squares of the rows of diag(largest)^-1 E D."""
    entries = sp.diags(1 / largest) @ sp.csr_matrix(rows) @ sp.diags(scale)
    return np.asarray(entries.multiply(entries).sum(axis=1)).ravel()


def _terms(B: Any) -> float:
    """Return the number of terms of an entry of B'B and BB', with some more for forming these."""
    down, across = np.diff(sp.csc_matrix(B).indptr), np.diff(B.indptr)
    return float(np.max(across, initial=0)) + float(np.max(down, initial=0)) + 4


def _power_of_two(squares: Any) -> Floats:
    """Return the powers of two nearest to 1/sqrt of positive numbers, for scaling without rounding."""
    squares = np.asarray(squares, dtype=float)
    return np.exp2(-np.round(np.log2(np.where(squares > 0, squares, 1.0)) / 2))


def _norm(values: Fixed, scale: Floats) -> float:
    """Return an upper bound of |diag(scale) x|."""
    largest = values.exponent
    magnified = values.floats_at(-largest) * scale
    # Underflow is covered by the added term.
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


# Floating bodies are held at some unknowns, so that everything else can be enclosed.
#
# For motions z of assembled bodies K z = 0 holds only up to rounding, and nothing balances the rounding of the load
# along z. Therefore one unknown per motion is held at its computed value, without strain or load; the forces of these
# constraints are enclosed with the rest, and must be of rounding size.

# The largest force of holding constraints, relative to all forces.
PART_THAT_MAY_BE_HELD = 1e-9


@dataclass(frozen=True, eq=False)
class Held:
    """A problem with additional ties that hold its free motions."""

    problem: ContactProblem
    unknowns: Indices  # (r,) held unknowns, one per motion
    free: Solution  # of the original problem


def hold(problem: ContactProblem, solution: Solution) -> Held:
    """Return the problem with one unknown per free motion tied to its value in the solution."""
    motions = np.array([motion.direction for motion in solution.free_motions])
    # Column pivots are unknowns with well-conditioned independent rows of the motions.
    order = scipy.linalg.qr(motions, mode="r", pivoting=True)[1]
    unknowns = np.sort(order[: len(motions)])
    rows = sp.identity(problem.dimension, format="csr")[unknowns]
    ties = sp.vstack([sp.csr_matrix(problem.tie), rows]).tocsr()
    values = np.concatenate([problem.tie_value, solution.displacement[unknowns]])
    held = problem.replace(tie=ties, tie_value=values)
    return Held(held, unknowns, solution)


def carried(held: Held, refined: Refined, radius: Floats) -> str:
    """Return a note on the held unknowns, with a bound of the holding forces.

    Raises NotCertified: the forces exceed rounding, so that the motions are not free.
    """
    problem = held.problem
    first = problem.ties - len(held.unknowns)
    most = float(np.max(abs(refined.tie_force.floats()[first:]) + radius[first:]))
    u, push = abs(refined.displacement.floats()), refined.normal_force.floats()
    there = abs(problem.stiffness) @ u + abs(problem.load) + abs(problem.normal).T @ push
    if not most <= PART_THAT_MAY_BE_HELD * float(np.max(there)):
        raise NotCertified(
            f"exact: motions that floats call free take {most:.3g} {problem.units.force}".rstrip() + " to hold",
            held.free,
        )
    named = ", ".join(problem.dof_name(int(j)) for j in held.unknowns)
    return (
        f"free motions are held at {named}, where floats leave them; what rounding has left to hold is at most "
        f"{most:.2g} {problem.units.force}".rstrip()
    )


REGULAR = "the system of this contact set is regular: these are its only displacements and forces"
STRICT = "every normal force of the set and every gap outside of it is strictly positive"
MINIMUM = "the stiffness is positive definite within the ties: the equilibrium is the only one, and the minimum"
BUT_FOR_MOTIONS = "the stiffness is positive definite once free motions are held: no other equilibrium but for these"
LOCAL = (
    "the stiffness is positive definite against ties and contacts that push: the equilibrium is a strict local minimum"
)
FLOATS_THAT_FLOAT = (
    "the floats of the stiffness are not proven to be positive definite, as a body that floats on its contacts has "
    "them: that no other equilibrium lies far away is not proven"
)


# Factorisations of bodies in space are predicted to take up to so many times what they take.
OVERESTIMATED = 8.0


def prove_by_enclosure(asked: Asked) -> ExactSolution:
    """Return intervals that contain all displacements and forces of the equilibrium, proven.

    Raises NotCertified: the contact set is not proven: contacts that just touch, redundant ones, floating bodies;
    NotConverged: refinement ends too early; NoEquilibrium: proven in floats; Unsupported: friction, or a stiffness too
    large to be factorised.
    """
    problem = asked.problem
    if problem.frictional:
        raise Unsupported(f"exact: friction with {problem.dimension} unknowns, too many for rational numbers")
    large = f"exact: {problem.dimension} unknowns: an enclosure needs factors of the stiffness, which are predicted to"
    cure = "`contactqp run` and `check` bound the error of its floats, and a coarser mesh can be enclosed"
    if factors_are_dear(problem):
        raise Unsupported(f"{large} take too long or not to fit into the free memory; {cure}")
    try:
        first = solve(problem, asked.method, **asked.options)
    except NoEquilibrium as error:
        raise NoEquilibrium(f"{error} (checked in sums of floats in extended precision)", error.proof) from None
    with proof_of(first):
        return _enclosed(asked, first, large, cure)


def _enclosed(asked: Asked, first: Solution, large: str, cure: str) -> ExactSolution:
    problem = asked.problem
    if not is_dense(problem.stiffness_rows) and factors_take(problem, OVERESTIMATED * MOST_WORK):
        text = f"{large} take more than the {MOST_WORK:.0e} multiplications whose rounding is bounded; {cure}"
        raise NotCertified(text, first)
    held = hold(problem, first) if first.free_motions else None
    if held is not None:
        refined, found = _held_enclosure(held, asked)
    else:
        refined = refine(problem, asked.method, first=first, **asked.options)
        found = enclose(refined)
    notes = symmetrised(problem)
    notes += () if held is None else (carried(held, refined, found.tie_force),)
    return _answer(asked, found, first.free_motions, notes)


def _held_enclosure(held: Held, asked: Asked) -> tuple[Refined, Enclosure]:
    """Return the answer of a problem whose free motions are held, refined and enclosed.

    Raises NotCertified, NotConverged: as `prove_by_enclosure`, with the answer of the free problem.
    """
    try:
        refined = refine(held.problem, asked.method, **asked.options)
        return refined, enclose(refined)
    except NoEquilibrium as error:  # the free problem has an answer, though the held one has not
        text = f"exact: free motions that are held where floats leave them miss contacts that just touch: {error}"
        raise NotCertified(text, held.free) from None
    except NotCertified as error:
        raise NotCertified(str(error), held.free) from error
    except NotConverged as error:
        raise NotConverged(str(error), solution=held.free) from error


def _answer(asked: Asked, found: Enclosure, motions: tuple[FreeMotion, ...], notes: tuple[str, ...]) -> ExactSolution:
    problem, refined = asked.problem, found.refined
    push, ranges = refined.normal_force.fractions(), np.empty((problem.contacts, 2), dtype=object)
    ranges[:, 0], ranges[:, 1] = push, push
    gap = refined.gap.fractions()
    gap[refined.closed] = Fraction(0)
    closed = np.zeros(problem.contacts, dtype=bool)
    closed[refined.closed] = True
    slip, slip_radius = _slip(found)
    slip_shape = None if slip is None else slip.shape
    none = np.zeros(0) if slip_shape is None else np.zeros(slip_shape)
    return ExactSolution(
        problem=problem,
        displacement=refined.displacement.fractions(),
        normal_force=push,
        friction_force=None if slip_shape is None else fixed(none).fractions().reshape(slip_shape),
        tie_force=refined.tie_force.fractions()[: problem.ties],
        gap=gap,
        slip=slip,
        contact_status=tuple("closed" if yes else "open" for yes in closed),
        rational=False,
        radius=Parts(
            found.displacement,
            found.normal_force,
            None if slip_shape is None else none,
            found.tie_force[: problem.ties],
            found.gap,
            slip_radius,
        ),
        unique_forces=True,
        force_range=ranges,
        free_motions=motions,
        energy=None,
        equilibria=None,
        uniqueness=(),
        events=(),
        data=asked.source,
        way=f"iterative refinement in {refined.rounds} rounds, and bounds of what is left",
        proof=(REGULAR, STRICT, LOCAL if not found.definite else BUT_FOR_MOTIONS if motions else MINIMUM),
        notes=notes if found.definite else (*notes, FLOATS_THAT_FLOAT),
        method=asked.method,
        seconds=time.perf_counter() - asked.started,
    )


def _slip(found: Enclosure) -> tuple[Fractions | None, Floats | None]:
    problem = found.refined.problem
    if problem.tangent is None or problem.slip_origin is None:
        return None, None
    shape = problem.slip_origin.shape
    moved: Fixed = FixedMatrix(sp.csr_matrix(problem.tangent)) @ found.refined.displacement - fixed(problem.slip_origin)
    radius = abs(problem.tangent) @ found.displacement * SAFE
    return moved.fractions().reshape(shape), np.asarray(radius).reshape(shape)
