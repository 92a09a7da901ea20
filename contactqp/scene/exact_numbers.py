"""Numbers of a scene of nodes, exactly, in its own units."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from contactqp.elements.scalars import Numbers
from contactqp.scene.units import Quantity
from contactqp.scene.unknowns import of_node

if TYPE_CHECKING:
    from contactqp.scene.schema import SceneData


def value(scene: SceneData, quantity: Quantity) -> Fraction:
    return scene.system.value(quantity)


def point(scene: SceneData, node: str) -> Numbers:
    """Where a node stands, exactly, in the scene's unit of length."""
    return np.array([value(scene, x) for x in scene.node(node).at])


def displacements(scene: SceneData, nodes: Iterable[str]) -> tuple[str, ...]:
    return tuple(name for node in nodes for name in of_node(scene, node))


def ends(scene: SceneData, nodes: Iterable[str]) -> Iterator[Numbers]:
    return (point(scene, node) for node in nodes)
