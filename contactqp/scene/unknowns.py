"""The unknowns of a scene: their names, which of them are fixed, and where they stand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from contactqp.scene.schema import SceneData

ROTATION = "theta"


@dataclass(frozen=True)
class Unknowns:
    """Every unknown of every node, ``node.axis`` and ``node.theta``, node by node."""

    names: tuple[str, ...]
    fixed: frozenset[str]

    @property
    def free(self) -> tuple[str, ...]:
        return tuple(name for name in self.names if name not in self.fixed)

    @property
    def place(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.names)}


def is_rotation(unknown: str) -> bool:
    return unknown.endswith("." + ROTATION)


def of_node(scene: SceneData, node: str) -> tuple[str, ...]:
    """The displacements of a node, one for each axis."""
    return tuple(f"{node}.{axis}" for axis in scene.axes)


def of_scene(scene: SceneData) -> Unknowns:
    """Displacements of all nodes, and a rotation where a beam ends."""
    turning = {node for beam in scene.beams for node in beam.nodes}
    by_node = {
        node: of_node(scene, node) + ((f"{node}.{ROTATION}",) if node in turning else ()) for node in scene.every_node
    }
    fixed = {unknown for entry in scene.fixed for unknown in by_node.get(entry, (entry,))}
    return Unknowns(tuple(name for names in by_node.values() for name in names), frozenset(fixed))
