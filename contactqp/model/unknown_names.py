"""What unknowns are called: 12.x here, 12.1 with Abaqus and CalculiX, 12.UX with Ansys, and which of them are the same.

Directions 1, 2, 3 are x, y, z and 4, 5, 6 the rotations about them, as both Abaqus and CalculiX number them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

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
    """One of `AXES` by any of its names: x, 1, ux, U1, d1, rotz, UR3, ..."""
    return SPELLINGS.get(name.strip().lower())


def plain_name(name: str) -> str | None:
    """node.axis with the axis as in `AXES`; None where a name does not end in a direction."""
    node, _, axis = name.rpartition(".")
    known = axis_called(axis)
    return f"{node}.{known}" if node and known is not None else None


def other_spellings(wanted: Iterable[str], given: Collection[str], among: Iterable[str]) -> dict[str, list[str]]:
    """Which of the given names mean a wanted one under another spelling; more than one, or one for two, is ambiguous.

    Parameters
    ----------
    wanted : iterable of str
        Names that were not found as they stand.
    given : collection of str
        All names that were given.
    among : iterable of str
        All names that there are; a given name that is one of them means that one and no other.
    """
    exact = set(among)
    by_meaning: dict[str, list[str]] = {}
    for name in given:
        meaning = plain_name(name)
        if meaning is not None and name not in exact:
            by_meaning.setdefault(meaning, []).append(name)
    return {name: found for name in wanted if (found := by_meaning.get(plain_name(name) or "", []))}
