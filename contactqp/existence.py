"""Why a problem has no equilibrium, in words: conflicting constraints, or a rigid motion that the load drives."""

from __future__ import annotations

from typing import Any

import numpy as np

from contactqp.condensation import Condensation, unknown_scale
from contactqp.errors import NoEquilibrium
from contactqp.factorization import Array
from contactqp.problem import ContactProblem, Vector
from contactqp.saddle import BALANCED

LP_TOLERANCE = 1e-10
# Coordinates and gains of this part of the largest are no artefact of that tolerance.
DRIVEN = 1e-7
# Constraints that can be met to this part of their own lengths are not called conflicting.
COMPATIBLE = 1e-9
# A multiplier or a displacement of this part of the largest takes no part in a conflict or a motion.
NO_PART = 1e-9
NAMES_IN_A_MESSAGE = 8


def refuse_driven_motion(problem: ContactProblem, condensation: Condensation) -> None:
    """Raise if some rigid motion z gains energy from the load (f'z > 0) and no contact or tie resists it.

    max f'Z a  over  E Z a <= 0, A Z a = 0, |a| <= 1 is positive exactly when the energy is unbounded below on the
    constraints' recession cone (Frank and Wolfe 1956).
    """
    Z = condensation.rigid.motions
    if not Z.shape[1] or not np.any(problem.load):
        return
    Z = Z / np.max(abs(Z), axis=0)
    balanced = max(BALANCED, condensation.rigid.uncertainty)
    drive = problem.load @ Z
    if np.all(abs(drive) <= balanced * (problem.load_size @ abs(Z))):
        return
    normal, tie = _unit(problem.normal, Z), _unit(problem.tie, Z)
    coordinates = _without_artefacts(_steepest(drive, normal, tie), normal, tie)
    motion = Z @ coordinates
    scale = unknown_scale(problem)
    rounding = max(
        balanced * (problem.load_size @ abs(motion)),
        condensation.rigid.uncertainty * np.linalg.norm(scale * problem.load_size) * np.linalg.norm(motion / scale),
    )
    if problem.load @ motion > rounding and drive @ coordinates > DRIVEN * np.max(abs(drive)):
        raise NoEquilibrium(
            "the load drives a rigid motion that no contact or tie holds back: "
            f"{describe_motion(problem, motion / np.max(abs(motion)))}"
        )


def _unit(rows: Any, Z: Array) -> Array:
    """Rows on rigid motions, of unit size where they are not rounding."""
    values = rows @ Z
    if not len(values):
        return np.zeros((0, Z.shape[1]))
    size = np.max(abs(values), axis=1, keepdims=True)
    rounding = BALANCED * np.max(abs(rows) @ abs(Z), axis=1, keepdims=True)
    return np.where(size > rounding, values / np.where(size > 0, size, 1.0), 0.0)


def _steepest(drive: Array, normal: Array, tie: Array) -> Array:
    """The coordinates, at most one each, that gain most energy and that no row resists."""
    from scipy.optimize import linprog

    answer = linprog(
        -drive / np.max(abs(drive)),
        A_ub=normal if len(normal) else None,
        b_ub=np.zeros(len(normal)) if len(normal) else None,
        A_eq=tie if len(tie) else None,
        b_eq=np.zeros(len(tie)) if len(tie) else None,
        bounds=(-1, 1),
        method="highs",
        options={"primal_feasibility_tolerance": LP_TOLERANCE, "dual_feasibility_tolerance": LP_TOLERANCE},
    )
    if answer.x is None:
        raise NoEquilibrium(f"whether the load drives a rigid motion could not be decided: {answer.message}")
    return np.asarray(answer.x)


def _without_artefacts(coordinates: Array, normal: Array, tie: Array) -> Array:
    """The linear program meets its rows to a tolerance: make those it meets exact, and what it then leaves is real."""
    met = np.vstack([normal[abs(normal @ coordinates) <= DRIVEN], tie])
    if len(met):
        _, values, rotation = np.linalg.svd(met)
        free = rotation[int(np.sum(values > DRIVEN)) :]
        coordinates = free.T @ (free @ coordinates)
    return np.where(abs(coordinates) > DRIVEN, coordinates, 0.0)


def refuse_conflict(problem: ContactProblem, condensation: Condensation) -> None:
    """Raise if no displacement satisfies E u <= g, A u = b; the message names rows that conflict.

    The least t with E_i u - t <= g_i and |A u - b| <= t (rows of unit length) is positive exactly when they conflict,
    and its multipliers are Farkas' proof: a combination of the named rows that reads 0 <= -t.
    """
    from scipy.optimize import linprog

    rows = np.vstack([condensation.normal, condensation.tie, -condensation.tie]) * condensation.scale
    right = np.concatenate([problem.gap, problem.tie_value, -problem.tie_value])
    if not len(rows):
        return
    length = np.linalg.norm(rows, axis=1)
    rows, right = rows / length[:, None], right / length
    size = np.max(abs(right), initial=0.0)
    if size == 0:
        return
    count = rows.shape[1]
    answer = linprog(
        np.append(np.zeros(count), 1.0),
        A_ub=np.column_stack([rows, -np.ones(len(rows))]),
        b_ub=right / size,
        bounds=[(None, None)] * count + [(0, None)],
        method="highs",
        options={"primal_feasibility_tolerance": LP_TOLERANCE, "dual_feasibility_tolerance": LP_TOLERANCE},
    )
    if answer.x is None or answer.x[-1] <= COMPATIBLE:
        return
    m, k = problem.contacts, problem.ties
    taking_part = np.flatnonzero(abs(answer.ineqlin.marginals) > NO_PART)
    names = [problem.contact_name(i) if i < m else f"tie {(i - m) % k}" for i in taking_part.tolist()]
    raise NoEquilibrium(f"no displacement satisfies these constraints together: {_listed(names)}")


def describe_motion(problem: ContactProblem, motion: Vector) -> str:
    """A motion in words: the unknowns that move, and how far relative to the largest."""
    moving = np.flatnonzero(abs(motion) > NO_PART * np.max(abs(motion)))
    # Rounded, so that unknowns that move alike are named in their own order.
    order = moving[np.argsort(-np.round(abs(motion[moving]), 6), kind="stable")]
    named = [f"{problem.dof_name(int(j))} by {motion[j]:+.3g}" for j in order[:NAMES_IN_A_MESSAGE]]
    return _listed(named, len(order))


def _listed(names: list[str], count: int | None = None) -> str:
    """The first names of a list, and how many more there are of `count`, or of the list."""
    shown = names[:NAMES_IN_A_MESSAGE]
    more = (len(names) if count is None else count) - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more else "")
