"""The answer of a scene of bodies in a few lines: its unknowns and contacts are too many to list."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from contactqp.analysis.motion.history import is_moving
from contactqp.scene.units import KINDS

if TYPE_CHECKING:
    from contactqp.scene.bodies import BodyModel

# Directions of motions have 1 as their largest component and are known to rounding.
SMALL = 1e-6
Table = tuple[list[str], list[list[str | float]]]


def summaries(model: BodyModel, solution: Any) -> Iterator[Table]:
    """For each body how far it moves and how fast, for each contact of the scene its force, peak pressure and gap."""
    system = model.scene.system
    length, force = system.length, system.force
    pressure = system.label(KINDS["pressure"].dimension)
    fields = [model.displacement(solution)]
    header = ["body", "along", f"lowest displacement [{length}]", f"highest [{length}]"]
    if is_moving(solution):
        fields.append(model.velocity(solution.velocity))
        header += [f"lowest velocity [{length}/s]", f"highest [{length}/s]"]
    rows: list[list[str | float]] = []
    for body in model.structure.bodies:
        ranges = [model.ranges(body.name, field) for field in fields]
        for i, axis in enumerate(body.axes):
            rows.append([body.name, axis, *(float(x) for r in ranges for x in r[i])])
    yield header, rows
    header = ["contact", "nodes", "pressing", f"normal force [{force}]", f"peak pressure [{pressure}]"]
    header.append(f"smallest gap [{length}]")
    if model.problem.frictional:
        header += ["sticking", *(f"friction {axis} [{force}]" for axis in model.scene.axes)]
    yield header, [list(row.values()) for row in _contacts(model, solution)]


def motions_in_words(model: BodyModel, solution: Any) -> list[str]:
    """Each free motion body by body: ``block along x``, or ``disc turning`` where its nodes move differently.

    The motions of a solution are any basis; here each is told with a body that the others leave where it is.
    """
    if not solution.free_motions:
        return []
    return [_motion_in_words(model, motion) for motion in _reduced(model, model.free_motions(solution))]


def _reduced(model: BodyModel, rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """The reduced echelon form: each row has a 1 where all others have 0, ordered by these places."""
    rows = rows.copy()
    places = []
    for i in range(len(rows)):
        column, at = model.largest(rows, i)
        rows[i] /= column[i]
        others = np.arange(len(rows)) != i
        rows[others] -= np.outer(column[others], rows[i])
        places.append(at)
    reduced: NDArray[np.float64] = rows[np.argsort(places)]
    return reduced


def _motion_in_words(model: BodyModel, motion: NDArray[np.float64]) -> str:
    said = []
    for body in model.structure.bodies:
        low, high = model.ranges(body.name, motion).T
        moving = np.flatnonzero(np.maximum(-low, high) > SMALL)
        if moving.size:
            same = bool(np.all((high - low)[moving] <= SMALL))
            along = " and ".join(body.axes[i] for i in moving)
            said.append(f"{body.name} along {along}" if same else f"{body.name} turning")
    return ", ".join(said)


def summary_data(model: BodyModel, solution: Any) -> dict[str, Any]:
    """The contacts of the scene and its free motions for JSON; forces and pressures in the scene's units."""
    return {
        "contacts": _contacts(model, solution),
        "contact_notes": model.notes,
        "free_motions": motions_in_words(model, solution),
    }


def _contacts(model: BodyModel, solution: Any) -> list[dict[str, str | float]]:
    rows: list[dict[str, str | float]] = []
    for contact in model.contacts:
        gaps = model.gaps(contact.name, solution)
        known = gaps[np.isfinite(gaps)]
        rows.append(
            {
                "contact": contact.name,
                "nodes": len(contact.pairing.gap),
                "pressing": int(model.closed(contact.name, solution).sum()),
                "normal_force": float(model.normal_forces(contact.name, solution).sum()),
                "peak_pressure": float(np.nan_to_num(model.pressures(contact.name, solution)).max()),
                "smallest_gap": float(known.min()) if known.size else 0.0,
            }
        )
        if model.problem.frictional:
            total = model.friction_vectors(contact.name, solution).sum(axis=0)
            rows[-1]["sticking"] = int(model.stuck(contact.name, solution).sum())
            rows[-1] |= {f"friction_{axis}": float(f) for axis, f in zip(model.scene.axes, total, strict=True)}
    return rows
