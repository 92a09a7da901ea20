"""The unknowns of a scene and its exact numbers: names, positions, load factors at a time, starts of a motion."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from contactqp.elements.exact import Numbers
from contactqp.scene.units import Quantity

if TYPE_CHECKING:
    from contactqp.scene.schema import SceneData, StartDisplacement, StartVelocity

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


# Numbers of a scene of nodes, exactly, in its own units.


def value(scene: SceneData, quantity: Quantity) -> Fraction:
    return scene.system.value(quantity)


def point(scene: SceneData, node: str) -> Numbers:
    """Return the position of a node, exactly, in the scene's unit of length."""
    return np.array([value(scene, x) for x in scene.node(node).at])


def displacements(scene: SceneData, nodes: Iterable[str]) -> tuple[str, ...]:
    return tuple(name for node in nodes for name in of_node(scene, node))


def ends(scene: SceneData, nodes: Iterable[str]) -> Iterator[Numbers]:
    return (point(scene, node) for node in nodes)


# The load path of a scene: what each of its loads is multiplied by at every pseudo-time.

# What masses and bodies weigh goes by this name.
GRAVITY = "gravity"


@dataclass(frozen=True)
class Factors:
    """What the loads are multiplied by: those that are named here, and all others."""

    others: Fraction = Fraction(0)
    named: Mapping[str, Fraction] = field(default_factory=dict)

    def of(self, name: str | None) -> Fraction:
        """Return the factor of the loads of that name; None is a load without one."""
        return self.others if name is None else self.named.get(name, self.others)


def has_corners(scene: SceneData) -> bool:
    """Whether loads come one by one and not all together."""
    return scene.path is not None and scene.path.corners is not None


def end_time(scene: SceneData) -> Fraction:
    """Return the pseudo-time at which the path ends: 1 for each leg."""
    return Fraction(len(scene.path.corners) if scene.path and scene.path.corners else 1)


def factors_at(scene: SceneData, time: Fraction) -> Factors:
    """At a pseudo-time of the path; without corners, all loads times `time`."""
    if scene.path is None or scene.path.corners is None:
        return Factors(others=time)
    corners: list[Mapping[str, Fraction]] = [{}, *scene.path.corners]
    leg = max(ceil(time), 1)
    before, after, way = corners[leg - 1], corners[leg], time - (leg - 1)
    zero = Fraction(0)
    return Factors(
        named={
            name: before.get(name, zero) + way * (after.get(name, zero) - before.get(name, zero))
            for name in {**before, **after}
        }
    )


def load_names(scene: SceneData) -> Iterator[tuple[str, str | None]]:
    """The key of every load, and what corners call it."""
    for key in ("loads", "line_loads", "tractions", "pressures", "point_loads"):
        yield from ((f"{key}[{i}]", load.name) for i, load in enumerate(getattr(scene, key)))
    if scene.gravity is not None:
        yield "gravity", GRAVITY


# What the parts of a scene start a motion with, unknown by unknown.


def started(scene: SceneData, item: StartVelocity | StartDisplacement) -> Iterator[tuple[str, Fraction]]:
    """Every unknown that the entry speaks of, with its number in the scene's units; of a body ``body.axis``."""
    value = [scene.system.value(component) for component in item.value]
    bar = next((bar for bar in scene.bars if bar.name == item.of), None)
    if bar is not None:
        end = value if item.to is None else [scene.system.value(component) for component in item.to]
        for i, node in enumerate(bar.chain):
            part = Fraction(i, bar.divisions)
            between = [a + part * (b - a) for a, b in zip(value, end, strict=True)]
            yield from zip(of_node(scene, node), between, strict=True)
    elif scene.meshed or item.of in scene.every_node:
        yield from zip(of_node(scene, item.of), value, strict=True)
    else:
        yield item.of, value[0]
