"""What the parts of a scene start a motion with, unknown by unknown."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import TYPE_CHECKING

from contactqp.scene.unknowns import of_node

if TYPE_CHECKING:
    from contactqp.scene.schema import SceneData
    from contactqp.scene.schema_motion import StartDisplacement, StartVelocity


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
