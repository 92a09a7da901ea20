"""Warnings of contacts of a scene that start deep inside of what they may touch, or are turned the wrong way."""

from __future__ import annotations

import warnings
from collections import defaultdict
from typing import TYPE_CHECKING

import numpy as np

from contactqp.errors import InvalidProblem, StartWarning

if TYPE_CHECKING:
    from collections.abc import Mapping

    from contactqp.model.arrays import Array
    from contactqp.scene.schema import Contact, SceneData

# Depths that differ by less than this part of the larger one are the same.
SAME = 1e-6


def warn_of_start(scene: SceneData, place: int, doubt: str) -> None:
    """Warn of a doubt about one of the scene's contacts, if there is one."""
    if doubt:
        file = f"{scene.file}: " if scene.file else ""
        name = scene.contacts[place].name
        warnings.warn(f"{file}contacts[{place}] ({name!r}): {doubt}", StartWarning, stacklevel=2)


def warn_of_nodes(scene: SceneData, gaps: Array) -> None:
    """Warn of contacts of nodes, whose initial gaps are these [length]."""
    if not len(gaps) or np.min(gaps) > 0:
        return
    from contactqp.elements.pairing import CURE, doubt_of_depth

    points = {node: np.array(scene.point(node), dtype=float) for node in scene.every_node}
    size = float(np.ptp(np.array(list(points.values())), axis=0).max())
    beside = _neighbours(scene)
    for place in np.flatnonzero(gaps <= 0).tolist():
        contact, depth = scene.contacts[place], -float(gaps[place])
        if contact.obstacle is None:
            doubt = doubt_of_depth(depth, size, "the other node", scene.units.length)
        elif _deeper(scene, contact, depth, points, beside):
            where = f"{depth:.6g} {scene.units.length} inside" if depth else "on the surface of"
            deeper = "lies deeper still" if depth else "lies inside"
            what = f"{contact.obstacle!r}, and all that it is joined to {deeper}"
            doubt = f"it starts {where} {what}: {CURE}; turn it round?"
        else:
            doubt = doubt_of_depth(depth, size, repr(contact.obstacle), scene.units.length)
        warn_of_start(scene, place, doubt)


def _neighbours(scene: SceneData) -> Mapping[str, set[str]]:
    """Return the nodes that elements join to each node."""
    found: defaultdict[str, set[str]] = defaultdict(set)
    for _, element in scene.elements:
        nodes = {name.rpartition(".")[0] for names, _ in element.stiffnesses(scene) for name in names}
        for node in nodes:
            found[node] |= nodes - {node}
    return found


def _deeper(
    scene: SceneData, contact: Contact, depth: float, points: Mapping[str, Array], beside: Mapping[str, set[str]]
) -> bool:
    """Return whether all nodes that the contact's node is joined to lie deeper inside of its obstacle."""
    from contactqp.scene.obstacles import obstacle

    others = [points[node] for node in sorted(beside[contact.touched[0]]) if node in points]
    if not others:
        return False
    try:
        distances = obstacle(scene, str(contact.obstacle)).distance(np.array(others))
    except InvalidProblem:  # it has no distance there
        return False
    return bool(np.all(-np.asarray(distances, dtype=float) > depth * (1 + SAME)))
