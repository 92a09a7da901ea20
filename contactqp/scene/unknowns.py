"""The unknowns of a scene, which of them are fixed, the factors of loads on its path, and the starts of its motion."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from math import ceil
from typing import TYPE_CHECKING

from contactqp.scene.blocks.element import ROTATION

if TYPE_CHECKING:
    from contactqp.scene.schema import SceneData, StartDisplacement, StartVelocity


@dataclass(frozen=True)
class Unknowns:
    """Every unknown of every node, ``node.axis`` and ``node.theta``, node by node."""

    names: tuple[str, ...]
    fixed: frozenset[str]

    @cached_property
    def free(self) -> tuple[str, ...]:
        """Return those that are not fixed."""
        return tuple(name for name in self.names if name not in self.fixed)

    @cached_property
    def place(self) -> dict[str, int]:
        """Return the place of each of them among all."""
        return {name: i for i, name in enumerate(self.names)}


def is_rotation(unknown: str) -> bool:
    """Return whether an unknown is a rotation."""
    return unknown.endswith("." + ROTATION)


def unknowns_of(scene: SceneData) -> Unknowns:
    """Return the displacements of all nodes, and a rotation where an element turns them."""
    turning = {node for _, element in scene.elements for node in element.turning}
    by_node = {
        node: scene.displacements(node) + ((f"{node}.{ROTATION}",) if node in turning else ())
        for node in scene.every_node
    }
    fixed = {unknown for entry in scene.fixed for unknown in by_node.get(entry, (entry,))}
    return Unknowns(tuple(name for names in by_node.values() for name in names), frozenset(fixed))


# What masses and bodies weigh goes by this name.
GRAVITY = "gravity"


@dataclass(frozen=True)
class Factors:
    """The factors of the loads: those of loads that are named here, and that of all others."""

    others: Fraction = Fraction(0)
    named: Mapping[str, Fraction] = field(default_factory=dict)

    def of(self, name: str | None) -> Fraction:
        """Return the factor of the loads of that name; None is a load without one."""
        return self.others if name is None else self.named.get(name, self.others)


def has_corners(scene: SceneData) -> bool:
    """Return whether loads come one by one and not all together."""
    return scene.path is not None and scene.path.corners is not None


def end_time(scene: SceneData) -> Fraction:
    """Return the pseudo-time at which the path ends: 1 for each leg from corner to corner."""
    return Fraction(len(scene.path.corners) if scene.path and scene.path.corners else 1)


def factors_at(scene: SceneData, time: Fraction) -> Factors:
    """Return the factors at a pseudo-time of the path; without corners, all loads times `time`."""
    if scene.path is None or scene.path.corners is None:
        return Factors(others=time)
    corners: list[Mapping[str, Fraction]] = [{}, *scene.path.corners]
    leg = max(ceil(time), 1)
    before, after, part = corners[leg - 1], corners[leg], time - (leg - 1)
    zero = Fraction(0)
    return Factors(
        named={
            name: before.get(name, zero) + part * (after.get(name, zero) - before.get(name, zero))
            for name in {**before, **after}
        }
    )


def load_names(scene: SceneData) -> Iterator[tuple[str, str | None]]:
    """Yield the key of every load, and the name that corners have for it."""
    for key in ("loads", "line_loads", "tractions", "pressures", "point_loads"):
        yield from ((f"{key}[{i}]", load.name) for i, load in enumerate(getattr(scene, key)))
    if scene.gravity is not None:
        yield "gravity", GRAVITY


def start_values(scene: SceneData, item: StartVelocity | StartDisplacement) -> Iterator[tuple[str, Fraction]]:
    """Yield every unknown that the entry of a motion starts, with its number in the scene's units; of a body
    ``body.axis``.
    """
    value = [scene.value(component) for component in item.value]
    bar = next((bar for bar in scene.bars if bar.name == item.of), None)
    if bar is not None:
        end = value if item.to is None else [scene.value(component) for component in item.to]
        for i, node in enumerate(bar.chain):
            part = Fraction(i, bar.divisions)
            between = [a + part * (b - a) for a, b in zip(value, end, strict=True)]
            yield from zip(scene.displacements(node), between, strict=True)
    elif scene.meshed or item.of in scene.every_node:
        yield from zip(scene.displacements(item.of), value, strict=True)
    else:
        yield item.of, value[0]
