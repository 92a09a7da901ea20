"""Read and look up the names of unknowns, contacts, ties and units, and describe motions with them.

An unknown is called 12.x here, 12.1 in Abaqus and CalculiX, 12.UX in Ansys; these spellings are recognised.

Directions 1, 2, 3 are x, y, z and 4, 5, 6 the rotations about them, as both Abaqus and CalculiX number them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import InvalidProblem, shown
from contactqp.model.arrays import EPS, Array, Indices, Vector
from contactqp.model.problem_data import is_whole

NAMES_IN_A_MESSAGE = 8
# An unknown belongs to a motion if it moves by at least this part of the largest.
TAKES_PART = 1e-9
# Entries below this part of the largest of their rows may be the rounding of zero.
FAINT = 8 * EPS
# A translation of unit length is among motions if its distance from their span is below this.
WITHIN_SPAN = 1e-9
AXES = ("x", "y", "z", "rotx", "roty", "rotz")
SPELLINGS = {
    **{axis: axis for axis in AXES},
    **{str(k): axis for k, axis in enumerate(AXES, 1)},
    **{f"{before}{axis}": axis for before in ("u", "u_", "d", "disp_", "displacement_") for axis in AXES[:3]},
    **{f"{before}{k}": axis for before in ("u", "d") for k, axis in enumerate(AXES[:3], 1)},
    **{f"{before}{axis[-1]}": axis for before in ("r", "ur") for axis in AXES[3:]},
    **{f"ur{k}": axis for k, axis in enumerate(AXES[3:], 1)},
    "theta": "rotz",  # of plane beams
}


def axis_called(name: str) -> str | None:
    """Return one of `AXES` by any of its names, such as x, 1, ux, U1, d1, rotz or UR3; None for other names."""
    return SPELLINGS.get(name.strip().lower())


def plain_name(name: str) -> str | None:
    """Return node.axis with the axis as in `AXES`; None where a name does not end in a direction."""
    node, _, axis = name.rpartition(".")
    known = axis_called(axis)
    return f"{node}.{known}" if node and known is not None else None


def other_spellings(wanted: Iterable[str], given: Collection[str], among: Iterable[str]) -> dict[str, list[str]]:
    """Return, for each wanted name, the given names that are other spellings of it.

    Several for one wanted name, or one for several, are ambiguous.

    Parameters
    ----------
    wanted : iterable of str, names that were not found as they stand
    given : collection of str, all names that were given
    among : iterable of str, all names that there are; a given name that is one of them means that one and no other
    """
    exact = set(among)
    by_meaning: dict[str, list[str]] = {}
    for name in given:
        meaning = plain_name(name)
        if meaning is not None and name not in exact:
            by_meaning.setdefault(meaning, []).append(name)
    return {name: found for name in wanted if (found := by_meaning.get(plain_name(name) or "", []))}


def describe_motion(problem: Any, motion: Vector) -> str:
    """Describe a motion (n,) of a problem in words: the unknowns that move, and how far relative to the largest."""
    moving = np.flatnonzero(abs(motion) > TAKES_PART * np.max(abs(motion)))
    if problem.dof_names is not None:
        bodies = _moving_bodies(problem.dof_names, moving, motion)
        if bodies:
            return listed(bodies)
    # Rounded, so that unknowns with equal motions are named in their own order.
    order = moving[np.argsort(-np.round(abs(motion[moving]), 6), kind="stable")]
    named = [f"{problem.dof_name(int(j))} by {motion[j]:+.3g}" for j in order[:NAMES_IN_A_MESSAGE]]
    return listed(named, len(order))


def describe_overload(problem: Any, motion: Vector, pull: float, friction: float) -> str:
    """Say that a load pulls along a motion with more than friction carries; empty where it does not.

    Parameters
    ----------
    problem : has names and units
    motion : (n,) array
    pull, friction : the work of the load on the motion, and the largest of friction at given normal forces
    """
    if not pull > friction:
        return ""
    size, unit = float(np.max(abs(motion))), f" {problem.units.force}" if problem.units.force else ""
    return (
        f"; along {describe_motion(problem, motion / size)} the load pulls with {pull / size:.4g}{unit} and friction "
        f"carries {friction / size:.4g}{unit}, by mu l_N of this step; there may be no equilibrium: lower the load, "
        "press the contacts more, or hold the motion"
    )


def describe_driven(problem: Any, motion: Vector) -> str:
    """Describe a motion that nothing resists, and what may be wrong with the rows at its unknowns."""
    return f"{describe_motion(problem, motion)}{describe_faint(problem, np.flatnonzero(motion))}"


def describe_faint(problem: Any, unknowns: Indices) -> str:
    """Say in brackets which of the unknowns only rows resist, by entries that may be the rounding of zero; else "".

    The normal force of a round body has such a lever about the middle. It is not rounding if the unknown has a unit
    that makes its entries that small, so that it counts as it is stated.
    """
    loose = unknowns[problem.diagonal[unknowns] == 0]
    across = [] if problem.tangent is None else [problem.tangent]
    rows = abs(sp.csr_array(sp.vstack([problem.normal, problem.tie, *across])))
    if not loose.size or not rows.nnz:
        return ""
    largest = rows.max(axis=1).toarray().ravel()
    rows.data /= np.repeat(largest, np.diff(rows.indptr))
    part = rows.max(axis=0).toarray().ravel()[loose]
    faint = loose[(part > 0) & (part <= FAINT)]
    if not faint.size:
        return ""
    named = listed([problem.dof_name(int(j)) for j in faint[:NAMES_IN_A_MESSAGE]], len(faint))
    return f" (at {named} all rows have less than {FAINT:.0e} of their largest entry: state 0 where that is rounding)"


def describe_proof(problem: Any, proof: Any) -> str:
    """Describe a proof that there is no equilibrium, by its motion or its weighted overlap."""
    if hasattr(proof, "motion"):
        return describe_driven(problem, proof.motion)
    unit = f" {problem.units.length}" if problem.units.length else ""
    return f"they overlap by {proof.excess:.3g}{unit}, rounding {proof.rounding:.1g}"


def along_axes(problem: Any, motions: Array) -> Array:
    """Return motions (n, q) with the same span: translations of bodies along axes as far as it has them, then others.

    Translations are of one body, or of all together that do not move alone; the others are orthogonal to all of them.
    Unknowns without the names of bodies, axes and nodes leave the motions as they are.

    Parameters
    ----------
    problem : ContactProblem
    motions : (n, q) array, of independent columns
    """
    groups = {} if problem.dof_names is None or motions.shape[1] < 2 else _bodies_and_axes(problem.dof_names)
    basis, translations = np.linalg.qr(motions)[0], list[Vector]()
    alone: set[tuple[str, str]] = set()
    together = [[key for key in groups if key[1] == axis] for axis in AXES[:3]]
    for keys in (*([key] for key in groups if key[1] in AXES[:3]), *together):
        unit = np.zeros(len(basis))
        for key in keys:
            if key not in alone:
                unit[groups[key]] = 1.0
        unit /= np.linalg.norm(unit) or 1.0
        if unit.any() and np.linalg.norm(basis @ (basis.T @ unit) - unit) <= WITHIN_SPAN:
            translations.append(unit)
            alone.update(keys)
    if not translations:
        return motions
    moved = np.column_stack(translations)
    others = np.linalg.qr(basis.T @ moved, mode="complete")[0][:, len(translations) :]
    return np.hstack([moved, basis @ others])


def _bodies_and_axes(names: Sequence[str]) -> dict[tuple[str, str], Indices]:
    """Return the unknowns of each body and axis from names such as ``"block node 7 x"``; none if any is other."""
    groups: dict[tuple[str, str], list[int]] = {}
    for j, name in enumerate(names):
        parts = _of_node(name)
        if parts is None:
            return {}
        groups.setdefault((parts[0], parts[2]), []).append(j)
    return {key: np.array(unknowns) for key, unknowns in groups.items()}


def _of_node(name: str) -> tuple[str, str, str] | None:
    """Return body, number of the node and axis of an unknown of a mesh, such as ``"block node 7 x"``."""
    parts = name.rsplit(" ", 3)
    if len(parts) != 4 or parts[1] != "node" or not parts[2].isdecimal():
        return None
    return parts[0], parts[2], parts[3]


def _moving_bodies(names: Sequence[str], moving: Indices, motion: Vector) -> list[str]:
    """Describe the bodies that move as ``"block along x by +1 (node 0 and 152 more)"``, where nodes move apart as
    ``"block turning about node 7 (node 0 y by +1 and 305 more)"``; empty unless all names are those of nodes of bodies.

    Parameters
    ----------
    names : the names of all unknowns
    moving : the unknowns that move
    motion : (n,) array
    """
    steps: dict[str, dict[str, list[tuple[float, str]]]] = {}
    for j in moving.tolist():
        parts = _of_node(names[j])
        if parts is None:
            return []
        steps.setdefault(parts[0], {}).setdefault(parts[2], []).append((round(float(motion[j]), 6), parts[1]))
    found = []
    for body, axes in steps.items():
        if any(len({step for step, _ in of_axis}) > 1 for of_axis in axes.values()):
            found.append(_turning(body, axes, names))
            continue
        for axis, of_axis in axes.items():
            step, first = of_axis[0]
            found.append(f"{body} along {axis} by {step:+.3g} (node {first}{_and_more(len(of_axis) - 1)})")
    return found


def _turning(body: str, axes: Mapping[str, list[tuple[float, str]]], names: Sequence[str]) -> str:
    """Describe a body whose nodes move apart, by a node that stays where it is, if any, and what moves most."""
    every = (parts for parts in map(_of_node, names) if parts is not None and parts[0] == body)
    turned = {node for of_axis in axes.values() for _, node in of_axis}
    still = next((f" about node {node}" for _, node, _ in every if node not in turned), "")
    step, node, axis = max(
        ((step, node, axis) for axis, of_axis in axes.items() for step, node in of_axis), key=lambda one: abs(one[0])
    )
    return f"{body} turning{still} (node {node} {axis} by {step:+.3g}{_and_more(sum(map(len, axes.values())) - 1)})"


def _and_more(count: int) -> str:
    return f" and {count} more" if count else ""


def listed(names: list[str], count: int | None = None) -> str:
    """Return the first names of a list and the number of those left out, of `count` or of the list."""
    shown = names[:NAMES_IN_A_MESSAGE]
    more = (len(names) if count is None else count) - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more else "")


def read_names(name: str, value: Sequence[str] | None, size: int) -> tuple[str, ...] | None:
    if value is None:
        return None
    try:
        if isinstance(value, (str, bytes)) or sp.issparse(value):
            raise TypeError("no names")
        names = tuple(str(v) for v in islice(value, size + 1))  # infinite iterables
        "".join(names).encode()
    except Exception as error:  # noqa: BLE001  whatever an object says of itself
        raise InvalidProblem(f"{name}: expected {size} names, got {shown(value)} ({error})") from None
    if len(names) != size:
        raise InvalidProblem(f"{name}: expected {size} names, got {len(names) if len(names) < size else 'more'}")
    if len(set(names)) != size:
        twice = next(v for v in names if names.count(v) > 1)
        raise InvalidProblem(f"{name}: expected distinct names, got {shown(twice)} more than once")
    return names


def name_of(kind: str, number: int, count: int, names: Sequence[str] | None) -> str:
    """Return the name of a contact, an unknown or a tie, or its kind and its number where there are no names.

    Raises InvalidProblem: the number is not between 0 and `count` - 1.

    Parameters
    ----------
    kind : "contact", "unknown" or "tie"
    number, count, names : int, counted from 0, how many there are, and their names, if they have any
    """
    if not (is_whole(number) and 0 <= number < count):
        raise InvalidProblem(f"{kind}: expected a number from 0 to {count - 1}, got {shown(number)}")
    return names[number] if names else f"{kind} {number}"


@dataclass(frozen=True)
class Units:
    """Names of the units that the numbers of a problem are in; they label messages and tables and convert nothing."""

    length: str = ""
    force: str = ""

    def __post_init__(self) -> None:
        for what, name in vars(self).items():
            if not isinstance(name, str):
                raise InvalidProblem(f"units: expected the name of a unit of {what}, got {shown(name)}")


NO_UNITS = Units()
# Names that are units of one quantity only, and names that are units of neither.
LENGTHS = ("m", "mm", "cm", "dm", "km", "um", "nm", "in", "inch", "ft", "yd")
NEITHER = ("g", "kg", "s", "min", "h", "rad", "deg", "Pa", "kPa", "MPa", "GPa", "psi", "bar", "J")
FORCES = ("N", "mN", "kN", "MN", "GN", "daN", "dyn", "kgf", "lbf", "kip", "kips")


def read_units(value: Units | Mapping[str, str] | None) -> Units:
    """Return the units in a mapping with the keys ``length`` and ``force``, no units for None."""
    if value is None or isinstance(value, Units):
        return value or NO_UNITS
    if not isinstance(value, Mapping) or sp.issparse(value) or (value and set(value) != {"length", "force"}):
        example = '{"length": "mm", "force": "N"}'
        raise InvalidProblem(
            f"units: expected the keys 'length' and 'force', both of them, as in {example}, got {shown(value)}"
        )
    for what, others in (("length", FORCES), ("force", LENGTHS)) if value else ():
        if not isinstance(value[what], str) or value[what] in (*others, *NEITHER):
            raise InvalidProblem(f"units: expected a {what}, got {shown(value[what])}")
    return Units(**value)
