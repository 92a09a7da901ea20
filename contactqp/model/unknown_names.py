"""What unknowns are called: 12.x here, 12.1 with Abaqus and CalculiX, 12.UX with Ansys, and which of them are the same.

Directions 1, 2, 3 are x, y, z and 4, 5, 6 the rotations about them, as both Abaqus and CalculiX number them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING

import numpy as np

from contactqp.model.arrays import Vector

if TYPE_CHECKING:
    from contactqp.model.problem import ContactProblem

NAMES_IN_A_MESSAGE = 8
# An unknown that moves by this part of the largest takes part in a motion.
TAKES_PART = 1e-9
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
    """Return, for each wanted name, the given names that mean it under another spelling.

    More than one, or one for two wanted names, is ambiguous.

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


def describe_motion(problem: ContactProblem, motion: Vector) -> str:
    """Describe a motion in words: the unknowns that move, and how far relative to the largest."""
    moving = np.flatnonzero(abs(motion) > TAKES_PART * np.max(abs(motion)))
    if problem.dof_names is not None:
        together = _moving_together((problem.dof_names[j] for j in moving.tolist()), motion[moving])
        if together:
            return listed(together)
    # Rounded, so that unknowns that move alike are named in their own order.
    order = moving[np.argsort(-np.round(abs(motion[moving]), 6), kind="stable")]
    named = [f"{problem.dof_name(int(j))} by {motion[j]:+.3g}" for j in order[:NAMES_IN_A_MESSAGE]]
    return listed(named, len(order))


def _moving_together(names: Iterable[str], motion: Vector) -> list[str]:
    """Describe translations of bodies as ``"block along x by +1 (node 0 and 152 more)"``; empty if nodes move apart."""
    first: dict[tuple[str, str], str] = {}
    count: dict[tuple[str, str], int] = {}
    step_of: dict[tuple[str, str], float] = {}
    for name, step in zip(names, np.round(motion, 6).tolist(), strict=True):
        parts = name.rsplit(" ", 3)  # body, node, its number, axis
        if len(parts) != 4 or parts[1] != "node" or not parts[2].isdecimal():
            return []
        key = parts[0], parts[3]
        if step_of.setdefault(key, step) != step:
            return []
        first.setdefault(key, parts[2])
        count[key] = count.get(key, 0) + 1
    more = {key: f" and {nodes - 1} more" if nodes > 1 else "" for key, nodes in count.items()}
    return [f"{key[0]} along {key[1]} by {step_of[key]:+.3g} (node {first[key]}{more[key]})" for key in first]


def listed(names: list[str], count: int | None = None) -> str:
    """Return the first names of a list and the number of those left out, of `count` or of the list."""
    shown = names[:NAMES_IN_A_MESSAGE]
    more = (len(names) if count is None else count) - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more else "")
