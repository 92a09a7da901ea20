"""Proofs that a problem has no equilibrium: constraints that conflict, or a rigid motion that the load drives.

A proof is found in floats, checked by exact sums, and rejected if rounding of the data could have caused it. With
friction a contact resists a rigid motion z unless it opens faster than it slips,

    -E_N z >= mu |E_T z|,

since then no force of its cone does negative work along z. In space the cone is replaced by polyhedral ones within it,
which are refined near the slips of a motion that the load drives within a cone around it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import NoEquilibrium
from contactqp.linalg.condensation import Condensation, condense
from contactqp.linalg.convexity import nearly_cancelling
from contactqp.linalg.dense import BALANCED, IDLE, RigidMotions, unknown_scale
from contactqp.linalg.equilibration import equilibrated
from contactqp.linalg.exact_algebra import cancel, cancelling
from contactqp.linalg.extended import SparseRows, extend
from contactqp.linalg.factorization import right_singular
from contactqp.linalg.iteration import contacts_are_many
from contactqp.linalg.least_norm import WITHIN_ROUNDING
from contactqp.linalg.measures import scale_through_rows
from contactqp.linalg.nonnegative import given_rows
from contactqp.model.arrays import Array, Vector
from contactqp.model.coulomb import resisting_rows, sides_from, sides_nearby
from contactqp.model.names import describe_driven, describe_motion, describe_proof, listed
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import ReadOnly

# The feasibility tolerances of linear programs with unknowns and rows of unit size.
LP_OPTIONS = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
# Coordinates and gains above this part of the largest are not artefacts of that tolerance, and the excess after a
# linear program, relative to that before, below which it counts as removed.
DRIVEN, REMAINING = 1e-7, 1e-7
UNDRIVEN = WITHIN_ROUNDING * DRIVEN  # the part of the least load whose work on motions of such entries is rounding
PROGRAMS = 4  # linear programs, each starting from the last, which together reach the rounding of doubles
# Polygons in place of the circle of slips, finer near those that the last allowed; the least part of work that counts.
POLYGONS, HARDLY_DRIVEN = 6, 1e-10
# Constraints with slacks beyond this multiple of the excess are left out of the program.
IDLE_SLACK = 1e7
PROJECTIONS = 2  # of a motion onto the null space of rows; the second removes rounding of the first
# Multipliers or displacements below this part of the largest are left out of a conflict or motion.
NO_PART = 1e-9
SOUGHT = 1e3  # a conflict is claimed for displacements within this multiple of the imposed lengths
# For conflicts of more constraints the weights are not solved for in rational numbers, but rounded from a linear
# program to ratios of integers up to LARGEST_DENOMINATOR.
MOST_EXACT, LARGEST_DENOMINATOR = 60, 10_000
# Loads that are balanced to this part of their size were meant to be, and the message advises how to balance them.
MEANT_TO_BALANCE, BUT_FOR = 1e-4, "the loads along it balance but for"
# A rigid motion recognised in printed digits may contain elastic ones of this multiple of their rounding.
RECOGNISED = 1e3


@dataclass(frozen=True, eq=False)
class Conflict(ReadOnly):
    """Farkas' proof that no displacement has E u <= g, A u = b: weights with E'y + A'n = 0, y >= 0, g'y + b'n < 0."""

    normal: Vector  # (m,) y, the largest weight one
    tie: Vector  # (k,) n
    excess: float  # -(g'y + b'n) [length]
    rounding: float  # its possible rounding by the data [length]
    exact: bool  # whether the weighted rows cancel exactly, else to rounding


@dataclass(frozen=True, eq=False)
class DrivenMotion(ReadOnly):
    """A motion z with K z = 0, E z <= 0 (E_N z <= -mu |E_T z| with friction), A z = 0 and f'z > 0.

    Along it nothing resists the load; without friction the energy is unbounded below.
    """

    motion: Vector  # (n,), the largest entry one
    work: float  # f'z [force]
    rounding: float  # its possible rounding by the data [force]


def refuse_driven_motion(problem: ContactProblem, rigid: RigidMotions) -> None:
    """Raise NoEquilibrium if a rigid motion z gains energy from the load (f'z > 0) and no contact or tie resists it.

    Conflicting constraints are reported first, as holding the motion would not help there.
    """
    if (found := driven_motion(problem, rigid)) is None:
        return
    refuse_sparse_conflict(problem)
    advice, size = "", float(problem.load_size @ abs(found.motion))
    if found.work <= MEANT_TO_BALANCE * size and not problem.frictional:
        advice = (
            f"; {BUT_FOR} {found.work:.3g} ({found.work / size:.2g} of their size): if they "
            "were meant to balance, project them, load - Z (Z'Z)^-1 Z' load with the rigid motions Z in columns"
        )
    else:
        lower = ", lower the load to what friction holds" if problem.frictional else ""
        advice = f"; hold it by a support, a tie or a contact{lower}, or check the sign of the load"
    held = "no contact, friction or tie holds back" if problem.frictional else "no contact or tie holds back"
    lifted = " (what slides by s counts as lifted by mu s)" if problem.frictional else ""
    if problem.near_null_space is None and (SparseRows(problem.stiffness_rows) @ extend(found.motion)).double().any():
        held += ", nor the stiffness by more than the rounding of its entries"
    text = f"the load drives a rigid motion that {held}: {describe_driven(problem, found.motion)}{lifted}{advice}"
    raise NoEquilibrium(text, found)


def doubtful_drive(problem: ContactProblem) -> str:
    """Return a text on a driven motion whose load may be a rounding error such as F sin(pi), else an empty one."""
    found = None if contacts_are_many(problem) else driven_motion(problem, condense(problem).rigid, doubtful=True)
    why = "; a load on a motion that nothing holds back is so small that it may be rounding of other loads"
    cure = "state it as zero, or hold the motion"
    return "" if found is None else f"{why}: {describe_motion(problem, found.motion)}; {cure}"


def driven_motion(problem: ContactProblem, rigid: RigidMotions, doubtful: bool = False) -> DrivenMotion | None:
    """Return a rigid motion that the load drives and no row resists, proven or `doubtful`.

    max f'Z a  over  E Z a <= 0, A Z a = 0, |a| <= 1 is positive exactly when the energy is unbounded below on the
    constraints' recession cone (Frank and Wolfe 1956). With friction E are the `resisting_rows`.
    """
    if not rigid.motions.shape[1] or not np.any(problem.load):
        return None
    Z = rigid.motions / np.max(abs(rigid.motions), axis=0)
    drive = problem.load @ Z
    if np.all(abs(drive) <= max(BALANCED, _uncertainty(problem, rigid)) * (problem.load_size @ abs(Z))):
        return None
    unit, across = partial(_unit, Z=Z, still=_still(Z, _positive_scale(problem))), problem.tangent
    in_space = problem.frictional and across is not None and across.shape[0] > problem.contacts
    slips = (lambda along: np.asarray(across @ (Z @ along)).reshape(-1, 2)) if in_space else None
    coordinates, resisting = driven_in_cones(drive, partial(resisting_rows, problem), unit, unit(problem.tie), slips)
    if coordinates is None:
        return None
    for stated in _stated_ahead(problem):  # a translation is clearer than the steepest motion
        simple = _proven_drive(problem, rigid, resisting, stated)
        if simple is not None and (doubtful or simple.work > simple.rounding):
            return simple
    motion = Z @ coordinates
    found = _proven_drive(problem, rigid, resisting, motion / np.max(abs(motion)))
    return found if found is not None and (doubtful or found.work > found.rounding) else None


def driven_in_cones(
    drive: Vector,
    rows_at: Callable[[Array | None, bool], Any],
    unit: Callable[[Any], Array],
    tie: Array,
    slips: Callable[[Vector], Array] | None,
) -> tuple[Array | None, Any]:
    """Return coordinates (r,) of a driven motion, None if none was found, and the rows that do not resist it.

    Parameters
    ----------
    drive, tie : as `driven_coordinates` takes them
    rows_at : gives the rows with polygons of these sides (m, k) within or around the cones, as `resisting_rows`
    unit : gives unit rows of coordinates
    slips : those (m, 2) along coordinates; None in the plane and without friction, where polygons are exact
    """

    def steepest(sides: Array | None, within: bool, least: float) -> tuple[Array | None, Any]:
        return driven_coordinates(drive, unit(rows := rows_at(sides, within)), tie, least), rows

    if slips is None:
        return steepest(None, True, DRIVEN)
    outer = steepest(None, False, HARDLY_DRIVEN)[0]  # in most problems there is none
    found = (None, None) if outer is None else steepest(None, True, DRIVEN)
    for polygon in range(POLYGONS):
        if found[0] is not None or outer is None:
            break
        found = steepest(sides_from(slips(outer)), True, HARDLY_DRIVEN)
        outer = steepest(sides_nearby(slips(outer), 2 * polygon // POLYGONS), False, HARDLY_DRIVEN)[0]
    return found


def _stated_ahead(problem: ContactProblem) -> Iterator[Vector]:
    """Yield the stated rigid motions, each in the direction in which the load does work, the largest work first."""
    if problem.near_null_space is None:
        return
    Z = problem.near_null_space / np.max(abs(problem.near_null_space), axis=0)
    work = problem.load @ Z
    for k in np.argsort(-abs(work)).tolist():
        if work[k] != 0:
            yield np.sign(work[k]) * Z[:, k]


def driven_coordinates(drive: Vector, normal: Array, tie: Array, least: float = DRIVEN) -> Array | None:
    """Return coordinates a (r,) with normal a <= 0, tie a = 0 and drive'a > 0, for unit rows in floats, else None.

    Parameters
    ----------
    drive, normal, tie : (r,), (m, r) and (k, r) arrays, the work of the load on each motion, and unit rows
    least : the part of |drive|'|a| that drive'a must exceed
    """
    if (coordinates := _steepest(drive, normal, tie)) is None:
        return None
    coordinates = _without_artefacts(coordinates, normal, tie)
    return coordinates if drive @ coordinates > least * (abs(drive) @ abs(coordinates)) else None


def _uncertainty(problem: ContactProblem, rigid: RigidMotions) -> float:
    """Return the relative size of elastic motions that a rigid one may contain, larger for printed stiffnesses."""
    recognised = RECOGNISED * problem.rigid_change if problem.near_null_space is None else 0.0
    return max(rigid.uncertainty, recognised)


def _proven_drive(problem: ContactProblem, rigid: RigidMotions, resisting: Any, z: Vector) -> DrivenMotion | None:
    """Return the motion z if K z, (E z)+ and A z are rounding errors and the load does work on it, else None."""
    uncertainty, scale = _uncertainty(problem, rigid), _positive_scale(problem)
    still = _still(z, scale)
    for rows, signed in ((problem.stiffness_rows, False), (resisting, True), (problem.tie, False)):
        felt = (SparseRows(rows) @ extend(z)).double()
        rounding = max(BALANCED, uncertainty) * (abs(rows) @ abs(z)) + IDLE * (abs(rows) @ still)
        if np.any((felt if signed else abs(felt)) > rounding):
            return None
    size = problem.load_size
    work = extend(problem.load).dot(extend(z))
    rounding = max(
        max(BALANCED, uncertainty) * float(size @ abs(z)),
        # The least load beside much larger ones, so that F sin(pi) does not count.
        max(IDLE, uncertainty) * float(np.linalg.norm(scale * size) * np.linalg.norm(z / scale)),
    )
    return DrivenMotion(z, work, rounding) if work > 0 else None


def _positive_scale(problem: ContactProblem) -> Vector:
    """Return D (n,), the scale through rows, or where these reach nothing stiff the scale of systems."""
    joined = scale_through_rows(problem)
    return np.where(joined > 0, joined, unknown_scale(problem))


def _still(motions: Array, scale: Vector) -> Array:
    """Return the size at each unknown to which the rounding of motions (n,) or (n, r) is relative."""
    return np.asarray((scale * np.max(abs(motions.T) / scale, axis=-1, keepdims=True)).T)


def _unit(rows: Any, Z: Array, still: Array) -> Array:
    """Return the displacements of unit rows by rigid motions, zero where they are rounding errors."""
    values = rows @ Z
    if not len(values):
        return np.zeros((0, Z.shape[1]))
    size, of_rows = abs(values).max(axis=1, keepdims=True), abs(rows)
    rounding = BALANCED * (of_rows @ abs(Z)) + IDLE * (of_rows @ still)
    rounding = rounding.max(axis=1, keepdims=True)
    return np.where(size > rounding, values / np.where(size > 0, size, 1.0), 0.0)


def _program(cost: Vector, **constraints: Any) -> Any:
    """Solve a linear program in the form of `linprog` to its tightest tolerances."""
    from scipy.optimize import linprog

    return linprog(cost, method="highs", options=LP_OPTIONS, **constraints)


def _steepest(drive: Array, normal: Array, tie: Array) -> Array | None:
    """Return the coordinates, each at most one, of the steepest unresisted motion, None if there is none.

    If every row resists a single coordinate, each is treated separately, else a linear program is solved.
    """
    if touch_one_each(normal) and touch_one_each(tie):
        ahead = np.sign(drive)
        return np.where(np.any(normal * ahead > 0, axis=0) | np.any(tie != 0, axis=0), 0.0, ahead)
    apart, still = given_rows("ub", normal, np.zeros(len(normal))), given_rows("eq", tie, np.zeros(len(tie)))
    answer = _program(-drive / np.max(abs(drive)), **apart, **still, bounds=(-1, 1))
    return None if answer.x is None else np.asarray(answer.x)


def touch_one_each(rows: Array) -> bool:
    """Return whether every row of (r, q) has at most one entry."""
    return bool(np.all(np.count_nonzero(rows, axis=1) <= 1))


def _without_artefacts(coordinates: Array, normal: Array, tie: Array) -> Array:
    """Return coordinates that satisfy exactly the rows that a linear program satisfied to its tolerance."""
    met = np.vstack([normal[abs(normal @ coordinates) <= DRIVEN], tie])
    if len(met):
        values, rotation = right_singular(met)
        free = rotation[int(np.sum(values > DRIVEN)) :]
        coordinates = free.T @ (free @ coordinates)
    return np.where(abs(coordinates) > DRIVEN, coordinates, 0.0)


def refuse_conflict(problem: ContactProblem, condensation: Condensation) -> None:
    """Raise NoEquilibrium if no displacement satisfies E u <= g, A u = b; the message names rows that conflict."""
    refuse_proven(problem, conflict(problem, condensation))


def refuse_sparse_conflict(problem: ContactProblem) -> None:
    """Raise NoEquilibrium as `refuse_conflict` does, with sparse rows and without condensing."""
    rows = sp.csr_matrix(sp.vstack([problem.normal, problem.tie]))
    twin, scaling = equilibrated(problem)
    lengths = float(np.max(abs(np.concatenate([np.minimum(twin.gap, 0.0), twin.tie_value])), initial=0.0))
    least = lengths * scaling.length * np.concatenate([scaling.contacts, scaling.ties])
    refuse_proven(problem, _conflict(problem, rows, scaling.unknowns, least))


def refuse_proven(problem: ContactProblem, found: Conflict | None) -> None:
    """Raise NoEquilibrium with a conflict, unless it is None; the message names its rows."""
    if found is None:
        return
    names = [problem.contact_name(int(i)) for i in np.flatnonzero(found.normal)]
    names += [problem.tie_name(int(i)) for i in np.flatnonzero(found.tie)]
    together = f"{listed(names)} (weighted, {describe_proof(problem, found)})"
    raise NoEquilibrium(f"no displacement satisfies these constraints together: {together}", found)


def conflict(problem: ContactProblem, condensation: Condensation) -> Conflict | None:
    """Return the proven weights of constraints that conflict beyond rounding of the data, else None."""
    rows = sp.csr_matrix(np.vstack([condensation.normal, condensation.tie]))
    return _conflict(problem, rows, condensation.scale)


def _conflict(problem: ContactProblem, rows: Any, scale: Vector, least: Vector | None = None) -> Conflict | None:
    """Return the weights of conflicting rows (m + k, q), over unknowns of scales (q,), else None.

    Where K gives rows no scale, their rounding is measured by the lengths `least` (m + k,). The least t with E_i u - t
    <= g_i and |A u - b| <= t (rows of unit length) is positive exactly when they conflict, and its multipliers are
    Farkas' proof. If a linear program removes the excess up to its tolerance, another one starts from there with the
    remaining excess scaled to one (Gleixner, Steffy and Wolter 2016).
    """
    limit, m = np.concatenate([problem.gap, problem.tie_value]), problem.contacts
    scaled = sp.csr_matrix(rows @ sp.diags(scale))
    length = np.sqrt(np.asarray(scaled.multiply(scaled).sum(axis=1)).ravel())
    u, extended, sizes = np.zeros(rows.shape[1]), SparseRows(rows), abs(rows)
    for _ in range(PROGRAMS):
        left = (extend(limit) - extended @ extend(u)).double()
        missing = np.where(np.arange(len(limit)) < m, np.maximum(-left, 0.0), abs(left))
        if np.all(missing <= WITHIN_ROUNDING * (sizes @ abs(u) + abs(limit))):
            return None
        if (size := float(np.max(missing / length))) == 0:  # below rounding of rows of this length
            return None
        step, remaining, weight = _least_excess(sp.diags(1.0 / length) @ scaled, left / length / size, m)
        if step is None:
            return None
        u = u + size * scale * step
        if remaining > REMAINING:
            sizes_of_rows = sizes @ abs(u) + abs(limit) + (0.0 if least is None else least)
            return _proven_conflict(rows, limit, m, weight / length, sizes_of_rows, scale)
    return None


def _least_excess(unit: Any, left: Vector, m: int) -> tuple[Vector | None, float, Vector]:
    """Return the step of least excess of unit rows, the excess, and its multipliers (m + k,)."""
    q, count = unit.shape
    rows = sp.csr_matrix(sp.vstack([unit, -unit[m:]]))
    answer = _program(
        np.append(np.zeros(count), 1.0),
        A_ub=sp.hstack([rows, -np.ones((rows.shape[0], 1))], format="csr"),
        b_ub=np.minimum(np.concatenate([left, -left[m:]]), IDLE_SLACK),
        bounds=[(None, None)] * count + [(0, None)],
    )
    if answer.x is None:
        return None, 0.0, np.zeros(q)
    weight = -np.asarray(answer.ineqlin.marginals)
    return np.asarray(answer.x[:-1]), float(answer.x[-1]), np.concatenate([weight[:m], weight[m:q] - weight[q:]])


def refuse_sparse_drive(problem: ContactProblem, unbalanced: Vector | None = None) -> None:
    """Raise NoEquilibrium if a load drives a motion that neither K nor a row resists, without condensing.

    The motion z with K z = 0, E z <= 0, A z = 0 along which the load does most work, its entries at most one in scaled
    unknowns, comes from a linear program; its residuals are then formed in extended precision. There is none where
    admissible forces leave less of the scaled loads `unbalanced` (n,) than rounding of the least: f'z <= |r|'|z|.
    """
    twin, _ = equilibrated(problem)
    if np.all(np.diff(twin.stiffness_rows.indptr)):
        return  # no unknown lacks stiffness, and a linear program in the whole K may take too long
    if unbalanced is not None and np.sum(abs(unbalanced)) <= UNDRIVEN * np.min(
        abs(twin.load[twin.load != 0]), initial=np.inf
    ):
        return
    held = sp.csr_matrix(sp.vstack([twin.stiffness_rows, twin.tie]))
    held = held[np.flatnonzero(np.diff(held.indptr))]
    still, apart = (given_rows(*rows, np.zeros(rows[1].shape[0])) for rows in (("eq", held), ("ub", twin.normal)))
    answer = _program(-twin.load, **still, **apart, bounds=(-1.0, 1.0))
    if answer.x is not None:
        refuse_drive_along(problem, np.asarray(answer.x, dtype=float))


def refuse_drive_along(problem: ContactProblem, motion: Vector, strictly: bool = False) -> None:
    """Raise NoEquilibrium if a motion near this one (n,), in scaled unknowns, is driven and unresisted.

    Conflicting constraints are reported first. With `strictly` K z must be exactly zero, as a regular K resists smooth
    motions of long chains by no more than rounding of its entries.
    """
    twin, scaling = equilibrated(problem)
    held = sp.csr_matrix(sp.vstack([twin.stiffness_rows, twin.tie]))
    held = held[np.flatnonzero(np.diff(held.indptr))]
    z: Vector = np.where(abs(motion) > DRIVEN * np.max(abs(motion), initial=0.0), motion, 0.0)
    z = _projected(twin, held, z)
    stiff = np.diff(twin.stiffness_rows.indptr) > 0
    # Loads may be balanced up to their digits only, while the costs of a linear program are taken as exact.
    least = DRIVEN * float(np.max(abs(twin.load))) if np.any(z[stiff]) else 0.0
    for motion in (np.round(z), z):  # exact with integers, where they suffice
        work = float(extend(twin.load).dot(extend(motion)))
        rounding = WITHIN_ROUNDING * float(abs(twin.load) @ abs(motion))
        if not (work > max(rounding, least) and _is_unresisted(twin, held, motion)):
            continue
        if not (strictly and np.any((SparseRows(twin.stiffness_rows) @ extend(motion)).double())):
            refuse_sparse_conflict(problem)
            moved = scaling.unknowns * motion
            largest = float(np.max(abs(moved)))
            found = DrivenMotion(moved / largest, work * scaling.force / largest, rounding * scaling.force / largest)
            text = "the load drives a motion that nothing resists, and the energy falls for ever"
            raise NoEquilibrium(f"{text}: {describe_driven(problem, found.motion)}", found)


def _projected(problem: ContactProblem, held: Any, motion: Vector) -> Vector:
    """Return a motion corrected to satisfy exactly the rows that a linear program satisfied to its tolerance."""
    from scipy.sparse.linalg import lsqr

    moved = problem.normal @ motion
    resting = problem.normal[np.flatnonzero(abs(moved) <= DRIVEN * (abs(problem.normal) @ abs(motion)))]
    rows = sp.csr_matrix(sp.vstack([held, resting]))
    still = motion == 0
    rows = rows @ sp.diags((~still).astype(float))
    for _ in range(PROJECTIONS):
        motion = np.where(still, 0.0, motion - lsqr(rows, rows @ motion, atol=1e-16, btol=1e-16)[0])
    return motion


def _is_unresisted(problem: ContactProblem, held: Any, motion: Vector) -> bool:
    """Return whether no row resists a motion beyond the rounding of its sums."""
    for rows, signed in ((held, False), (problem.normal, True)):
        moved = (SparseRows(rows) @ extend(motion)).double()
        if np.any((moved if signed else abs(moved)) > WITHIN_ROUNDING * (abs(rows) @ abs(motion))):
            return False
    return True


def _proven_conflict(rows: Any, limit: Vector, m: int, weight: Vector, sizes: Vector, scale: Vector) -> Conflict | None:
    """Return Farkas' proof on the rows with weights, or None.

    Weights are rational, or floats with exact sums if rows cancel to rounding; `sizes` (m + k,) are their lengths.
    """
    scaled = sp.csr_matrix(rows @ sp.diags(scale))
    own = abs(weight) * np.sqrt(np.asarray(scaled.multiply(scaled).sum(axis=1)).ravel())
    members = np.flatnonzero(own > NO_PART * np.max(own))
    touched = np.unique(rows[members].indices)
    part, scale = sp.csc_matrix(rows[members][:, touched]), scale[touched]
    few = len(members) <= MOST_EXACT
    found = cancelling(part.toarray().tolist()) if few else _cancelling_simply(part, weight[members])
    exact = found is not None
    if found is None:
        found = [Fraction(float(x)) for x in nearly_cancelling(part, scale, weight[members])]
    if sum(x * Fraction(float(w)) for x, w in zip(found, weight[members], strict=True)) < 0:
        found = [-x for x in found]
    largest = max(map(abs, found), default=Fraction(0))
    if not largest or any(x < 0 for x, i in zip(found, members.tolist(), strict=True) if i < m):
        return None
    found = [x / largest for x in found]
    y = np.array([float(x) for x in found])
    if not exact and not cancel(part, found, part.shape[0] * Fraction(WITHIN_ROUNDING)):
        return None
    excess = float(-sum(x * Fraction(float(limit[i])) for x, i in zip(found, members.tolist(), strict=True)))
    sizes, own = sizes[members], limit[members]
    if not exact:  # rows that cancel to rounding admit displacements far away
        sizes = np.maximum(sizes, abs(own) + abs(part) @ _farthest(own, abs(part), scale))
    rounding = WITHIN_ROUNDING * float(abs(y) @ sizes)
    if not excess > rounding:
        return None
    every = np.zeros(rows.shape[0])
    every[members] = y
    return Conflict(every[:m], every[m:], excess, rounding, exact)


def _cancelling_simply(rows: Any, weight: Vector) -> list[Fraction] | None:
    """Return the weights rounded to ratios of small integers if the rows of a CSC matrix then cancel exactly."""
    largest = float(np.max(abs(weight)))
    found = [Fraction(float(w) / largest).limit_denominator(LARGEST_DENOMINATOR) for w in weight]
    return found if cancel(rows, found) else None


def _farthest(limit: Vector, sizes: Any, scale: Vector) -> Vector:
    """Return displacements (q,) of SOUGHT times the largest length that rows of these entries impose in the scale."""
    imposed = np.divide(abs(limit), sizes @ scale, out=np.zeros(len(limit)), where=limit != 0)
    return np.asarray(SOUGHT * scale * float(np.max(imposed, initial=0.0)))


def conflict_of(problem: ContactProblem, scale: Vector, weights: Vector) -> Conflict | None:
    """Return weights (m + k,) as a conflict if rows cancel to rounding and overlap by more than that.

    Displacements within SOUGHT times the largest imposed length are excluded; scale (n,) is that of unknowns.
    """
    rows = sp.csr_matrix(sp.vstack([problem.normal, problem.tie]))
    limit, weights = np.concatenate([problem.gap, problem.tie_value]), weights / np.max(abs(weights))
    limit = np.where(weights != 0, limit, 0.0)
    across, size = rows.T.tocsr(), abs(rows).T @ abs(weights)
    left = abs((SparseRows(across) @ extend(weights)).double())
    if np.any(left > WITHIN_ROUNDING * size):
        return None
    farthest = _farthest(limit, abs(rows), scale)
    excess = -float(extend(limit).dot(extend(weights)))
    rounding = WITHIN_ROUNDING * float(abs(weights) @ abs(limit) + size @ farthest)
    push, held = np.split(weights, [problem.contacts])
    return Conflict(push, held, excess, rounding, exact=False) if excess > rounding else None
