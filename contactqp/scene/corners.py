"""The load path of a scene: what each of its loads is multiplied by at every pseudo-time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from math import ceil
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from contactqp.scene.schema import SceneData

# What masses and bodies weigh goes by this name.
GRAVITY = "gravity"


@dataclass(frozen=True)
class Factors:
    """What the loads are multiplied by: those that are named here, and all others."""

    others: Fraction = Fraction(0)
    named: Mapping[str, Fraction] = field(default_factory=dict)

    def of(self, name: str | None) -> Fraction:
        """Of the loads of that name; None is a load without one."""
        return self.others if name is None else self.named.get(name, self.others)


def has_corners(scene: SceneData) -> bool:
    """Whether loads come one by one and not all together."""
    return scene.path is not None and scene.path.corners is not None


def end_time(scene: SceneData) -> Fraction:
    """Where the path ends: 1 for each way from corner to corner."""
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
