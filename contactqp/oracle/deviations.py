"""How far somebody's numbers are from the right ones: component by component, or by what the forces do together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.model.arrays import Vector
from contactqp.model.coulomb_cone import directions, lengths
from contactqp.oracle.reference import Reference, weights


@dataclass(frozen=True)
class Deviation:
    """One number that is wrong; `size` is relative to the largest right one of its kind."""

    what: str
    where: str
    value: float
    right: float
    size: float


def displacement_deviations(reference: Reference, displacement: Vector, rtol: float) -> list[Deviation]:
    """Unknowns further than rtol times the largest displacement from the right ones; none where those have no size."""
    if not reference.one_displacement or not reference.length > 0:
        return []
    problem = reference.problem
    return _beyond("displacement", problem.dof_name, displacement, reference.displacement, 1 / reference.length, rtol)


def force_deviations(
    reference: Reference,
    normal_force: Vector,
    friction_force: NDArray[np.float64] | None,
    tie_force: Vector | None,
    rtol: float,
) -> list[Deviation]:
    """Forces further than rtol times the largest one from the right ones.

    A multiplier is measured by the largest force that it puts on an unknown, max_j |E_ij| |l_i|: scaling a row changes
    nothing. Where forces are not unique, what they do together is compared instead: `resultant_deviations`.
    """
    if not reference.one_force:
        return resultant_deviations(reference, normal_force, friction_force, tie_force, rtol)
    problem, scale = reference.problem, reference.force
    name = problem.contact_name
    rows = [("normal force", name, normal_force, reference.normal_force, problem.normal)]
    if friction_force is not None and reference.friction_force is not None:
        width = friction_force.shape[1]
        given, right = friction_force.ravel(), reference.friction_force.ravel()
        rows.append(("friction force", lambda i: name(i // width), given, right, problem.tangent))
    if tie_force is not None:
        rows.append(("tie force", lambda i: f"tie {i}", tie_force, reference.tie_force, problem.tie))
    return [
        one
        for what, called, given, right, matrix in rows
        for one in _beyond(what, called, given, right, _relative(weights(matrix), scale), rtol)
    ]


def resultant_deviations(
    reference: Reference,
    normal_force: Vector,
    friction_force: NDArray[np.float64] | None,
    tie_force: Vector | None,
    rtol: float,
) -> list[Deviation]:
    """What is wrong with forces that are one answer among others.

    Right are all that do the same together, E_N'l_N + E_T'l_T + A'nu, that pull nowhere and push at no open contact,
    and that obey Coulomb's law. Tie forces that were not given may be any.
    """
    problem = reference.problem
    right = reference.resultant
    scale = float(np.max(abs(right), initial=0.0)) or reference.force
    name, size = problem.contact_name, _relative(weights(problem.normal), scale)
    nothing = np.zeros(problem.contacts)
    found = _beyond("tension", name, np.minimum(normal_force, 0), nothing, size, rtol)
    found += _beyond("force at an open contact", name, np.where(reference.open, normal_force, 0), nothing, size, rtol)
    change = problem.normal.T @ (normal_force - reference.normal_force)
    if friction_force is not None and problem.tangent is not None and problem.friction is not None:
        change = change + problem.tangent.T @ (friction_force - np.asarray(reference.friction_force)).ravel()
        bound = problem.friction * np.maximum(normal_force, 0)
        found += _beyond("friction force", name, np.maximum(lengths(friction_force), bound), bound, size, rtol)
        slides = np.any(reference.slip != 0, axis=1)
        along = np.sum(friction_force * directions(reference.slip), axis=1)
        found += _beyond("friction along the slip", name, np.where(slides, along, bound), bound, size, rtol)
    if tie_force is not None:
        change = change + problem.tie.T @ (tie_force - reference.tie_force)
    elif problem.ties:
        A = problem.tie.toarray()
        change = change - A.T @ np.linalg.lstsq(A.T, change, rcond=None)[0]
    together = _relative(np.ones(problem.dimension), scale)
    return found + _beyond("resultant", problem.dof_name, right + change, right, together, rtol)


def deviations_table(found: list[Deviation], force: str = "", length: str = "", limit: int = 10) -> str:
    """The deviations as text, the largest first."""
    units = {"displacement": length}
    lines = [["where", "what", "given", "right", "relative"]]
    for one in sorted(found, key=lambda one: -one.size if one.size == one.size else -np.inf)[:limit]:
        unit = units.get(one.what, force)
        numbers = [f"{value:.12g}{' ' + unit if unit else ''}" for value in (one.value, one.right)]
        lines.append([one.where, one.what, *numbers, f"{one.size:.2g}"])
    widths = [max(len(line[j]) for line in lines) for j in range(5)]
    text = ["  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines]
    return "\n".join(text + ([f"and {len(found) - limit} more"] if len(found) > limit else []))


def _relative(size: Vector, scale: float) -> Vector:
    return size / scale if scale > 0 else np.where(size > 0, np.inf, 0.0)


def _beyond(what: str, called: Callable[[int], str], given: Any, right: Any, size: Any, rtol: float) -> list[Deviation]:
    """The entries whose difference times `size` is larger than rtol, or no number."""
    given, right = np.asarray(given, dtype=float), np.asarray(right, dtype=float)
    apart = abs(given - right)
    relative = np.where(apart > 0, apart, 0.0) * np.broadcast_to(size, apart.shape) if apart.size else apart
    relative = np.where(np.isfinite(given), np.where(apart == 0, 0.0, relative), np.inf)
    return [
        Deviation(what, called(int(i)), float(given[i]), float(right[i]), float(relative[i]))
        for i in np.flatnonzero(relative > rtol)
    ]
