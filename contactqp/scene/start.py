"""Warnings of contacts of a scene that start deep inside of what they may touch, or are turned the wrong way."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from contactqp.errors import StartWarning
from contactqp.scene.obstacles import obstacle

if TYPE_CHECKING:
    from contactqp.model.arrays import Array
    from contactqp.scene.schema import Contact, SceneData


def warn_of_start(scene: SceneData, contact: Contact, doubt: str) -> None:
    """Warn of a doubt about one of the scene's contacts, if there is one."""
    if doubt:
        file = f"{scene.file}: " if scene.file else ""
        place = f"contacts[{scene.contacts.index(contact)}] ({contact.name!r})"
        warnings.warn(f"{file}{place}: {doubt}", StartWarning, stacklevel=2)


def warn_of_nodes(scene: SceneData, gaps: Array) -> None:
    """Warn of contacts of nodes, whose initial gaps are these [length]."""
    if not len(gaps) or np.min(gaps) >= 0:
        return
    from contactqp.elements.start import DEEP, doubt_of_points

    points = {node: np.array(scene.point(node), dtype=float) for node in scene.every_node}
    size = float(np.ptp(np.array(list(points.values())), axis=0).max())
    for contact, gap in zip(scene.contacts, gaps.tolist(), strict=True):
        mine = np.array([points[node] for node in contact.touched])
        if contact.obstacle is not None:
            others = np.array([point for node, point in points.items() if node not in contact.touched])
            body = others.reshape(-1, mine.shape[1])
            touched = obstacle(scene, contact.obstacle)
            warn_of_start(scene, contact, doubt_of_points(mine, np.array([gap]), touched, repr(contact.obstacle), body))
        elif -gap > DEEP * size > 0:
            part = f"{100 * -gap / size:.2g} % of the size of the structure"
            cure = "a direction points from the first node to the second"
            doubt = f"its nodes start {-gap:.6g} past each other, {part}, and will be dragged back: {cure}"
            warn_of_start(scene, contact, doubt)
