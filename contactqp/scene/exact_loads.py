"""The loads of a scene of nodes at their full values, and their sum at a point of the load path, in exact numbers."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from contactqp.elements import point_mass, string
from contactqp.elements.scalars import Number, square_root, squared_length
from contactqp.scene.corners import GRAVITY, Factors
from contactqp.scene.exact_numbers import displacements, ends, value
from contactqp.scene.unknowns import of_node

if TYPE_CHECKING:
    from contactqp.scene.schema import SceneData

# A linear form of the unknowns by their names; what is zero is left out.
Row = Mapping[str, Number]


def exact_loads(scene: SceneData) -> Mapping[str | None, Row]:
    """The loads at their full values by their names; what has mass weighs by the name of gravity."""
    total: defaultdict[str | None, defaultdict[str, Number]] = defaultdict(lambda: defaultdict(Fraction))
    for load in scene.loads:
        total[load.name][load.unknown] += value(scene, load.value)
    for line_load in scene.line_loads:
        per_length = np.array([value(scene, b) for b in line_load.value])
        for segment in scene.string(line_load.string).segments:
            forces = string.uniform_load(per_length, *ends(scene, segment))
            for name, force in zip(displacements(scene, segment), forces, strict=True):
                total[line_load.name][name] += force
    for name, force in _weights(scene):
        total[GRAVITY][name] += force
    return {name: dict(row) for name, row in total.items()}


def _weights(scene: SceneData) -> Iterator[tuple[str, Number]]:
    """What weighs at each unknown; half of a bar at each end, which is M g of either mass matrix."""
    if scene.gravity is None:
        return
    gravity = np.array([value(scene, g) for g in scene.gravity])
    at_nodes: list[tuple[str, Number]] = [(mass.node, value(scene, mass.mass)) for mass in scene.masses]
    for bar in scene.bars:
        if bar.density is not None:
            per_length = value(scene, bar.density) * value(scene, bar.area)
            for segment in bar.segments:
                start, end = ends(scene, segment)
                half = per_length * square_root(squared_length(end - start)) / 2
                at_nodes += [(node, half) for node in segment]
    for node, mass in at_nodes:
        yield from zip(of_node(scene, node), point_mass.weight(mass, gravity), strict=True)


def sum_of(loads: Mapping[str | None, Row], factors: Factors) -> Row:
    total: defaultdict[str, Number] = defaultdict(Fraction)
    for name, row in loads.items():
        for unknown, force in row.items():
            total[unknown] += factors.of(name) * force
    return dict(total)
