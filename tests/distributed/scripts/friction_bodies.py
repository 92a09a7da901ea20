"""Elastic bodies that rub, each with what its contacts are known to do."""

from __future__ import annotations

import numpy as np

import contactqp as cq
from contactqp.elements.material import Material
from contactqp.elements.shapes import box, rectangle
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support


def pushed_in_plane(mu: float, cells: tuple[int, int] = (24, 12)) -> cq.ContactProblem:
    """A block whose top is moved down and sideways on a plane: it sticks in the middle and slides at an edge."""
    body = Body(rectangle(2.0, 1.0, cells), Material(1.0, 0.3), "plane-strain", name="block")
    structure = Structure([body])
    held = [Support("block", "top", 0, 0.004), Support("block", "top", 1, -0.02)]
    floor = cq.Plane([0.0, 0.0], [0.0, 1.0])
    paired = cq.pair(structure.surface("block", "bottom"), floor)
    return structure.assemble(held).problem([paired], friction=mu)


def pushed_in_space(mu: float, cells: tuple[int, int, int] = (8, 7, 5)) -> cq.ContactProblem:
    """The same in space, pushed along no axis: directions of slip fan out."""
    body = Body(box((1.0, 1.0, 0.6), cells, "hex8"), Material(1.0, 0.3), "3d", name="block")
    structure = Structure([body])
    held = [Support("block", "top", axis, (0.004, 0.002, -0.02)[axis]) for axis in range(3)]
    floor = cq.Plane([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    paired = cq.pair(structure.surface("block", "bottom"), floor)
    return structure.assemble(held).problem([paired], friction=mu)


def on_incline(mu: float, cells: tuple[int, int] = (12, 8), slope: float = 0.2) -> cq.ContactProblem:
    """A block that nothing but friction holds; its weight has the slope's part along the floor."""
    body = Body(rectangle(1.5, 1.0, cells), Material(1.0, 0.3), "plane-strain", name="block")
    structure = Structure([body])
    paired = cq.pair(structure.surface("block", "bottom"), cq.Plane([0.0, 0.0], [0.0, 1.0]))
    problem = structure.assemble([]).problem([paired], friction=mu)
    share = np.tile([slope, -1.0], problem.dimension // 2) * 0.02 / problem.dimension
    return problem.replace(load=share)


def two_blocks(mu: float) -> cq.ContactProblem:
    """Two held blocks with meshes that do not match, pressed and pushed onto each other: rows of many unknowns."""
    one = Body(rectangle(1.0, 0.5, (9, 5), corner=(0.0, -0.5)), Material(1.0, 0.3), "plane-strain", name="lower")
    two = Body(rectangle(1.0, 0.5, (7, 4)), Material(3.0, 0.2), "plane-strain", name="upper")
    structure = Structure([one, two])
    held = [Support("lower", "bottom", axis) for axis in range(2)]
    held += [Support("upper", "top", axis, (0.006, -0.02)[axis]) for axis in range(2)]
    surfaces = (structure.surface("upper", "bottom"), structure.surface("lower", "top"))
    paired = cq.pair_node_to_segment(*surfaces, dimension=structure.size)
    return structure.assemble(held).problem([paired], friction=mu)


BODIES = {
    "pushed in the plane": pushed_in_plane,
    "pushed in space": pushed_in_space,
    "on an incline": on_incline,
    "two blocks": two_blocks,
}
