"""The meshes of a scene's bodies in floats, from built-in shapes and files, and their nodes by their places."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from contactqp.elements import shapes
from contactqp.elements.lattice import Lattice
from contactqp.elements.membrane import Membrane as MembranePart
from contactqp.elements.mesh import Mesh
from contactqp.elements.mesh_files import read_mesh
from contactqp.elements.structure import Part
from contactqp.errors import InvalidProblem
from contactqp.scene.units import number, read_unit, vector

if TYPE_CHECKING:
    from contactqp.scene.schema import SceneData
    from contactqp.scene.schema_bodies import Body, Membrane, MeshFile, Shape

# How far a point may be from the node that it stands for, in diagonals of the node's smallest element: coordinates in
# a case file are rounded, and a node of a mesh is no neighbour's.
NEAR = 0.01


@dataclass(frozen=True, eq=False)
class Nearest:
    """The node of a mesh nearest to a point: its number, where it is, and the smallest element that has it [length]."""

    apart: float
    node: int
    at: tuple[float, ...]
    smallest: float


def body_mesh(scene: SceneData, body: Body | Membrane) -> Mesh:
    """Return the mesh of a body in the scene's unit of length.

    Raises
    ------
    InvalidProblem
        The file or its mesh is no good, or the shape's numbers are none.
    BackendMissing
        A file that needs meshlane, which is not installed.
    """
    if body.shape is not None:
        return lattice_of_shape(scene, body.shape).mesh()
    if body.mesh is not None:
        return mesh_of_file(scene, body.mesh)
    raise InvalidProblem("expected 'shape' or 'mesh', got neither")


def mesh_of_file(scene: SceneData, source: MeshFile) -> Mesh:
    """Read the mesh of a file, in the scene's unit of length."""
    folder = Path() if scene.file is None else scene.file.parent
    mesh = read_mesh(folder / source.file, part=source.part, drop_unconnected=source.drop_unconnected)
    scale = float(read_unit(source.unit)[0] / read_unit(scene.units.length)[0])
    return mesh if scale == 1 else mesh.mapped(lambda points: scale * points)


def lattice_of_shape(scene: SceneData, shape: Shape) -> Lattice:
    """Return the mesh of a shape before it is made, in the scene's unit of length."""
    options: dict[str, Any] = {} if shape.grading is None else {"grading": float(shape.grading)}
    for key, name in (("corner", "corner"), ("centre", "center")):
        if getattr(shape, key) is not None:
            options[name] = vector(scene.system, getattr(shape, key))
    options |= {name: getattr(shape, name) for name in ("towards", "part") if getattr(shape, name) is not None}
    divisions: Any = shape.divisions
    size: Any = None if shape.size is None else vector(scene.system, shape.size)
    radius = 0.0 if shape.radius is None else number(scene.system, shape.radius)
    if shape.kind == "rectangle":
        return shapes.rectangle.lattice(size[0], size[1], divisions, shape.element, **options)
    if shape.kind == "box":
        options |= {} if shape.crown is None else {"crown": number(scene.system, shape.crown)}
        return shapes.box.lattice(size, divisions, shape.element, **options)
    if shape.kind == "cylinder":
        height = 0.0 if shape.height is None else number(scene.system, shape.height)
        return shapes.cylinder.lattice(radius, height, divisions, shape.element, **options)
    if shape.kind == "ball":
        return shapes.ball.lattice(radius, divisions, shape.element, **options)
    discs = {"disc": shapes.disc, "half-disc": shapes.half_disc, "quarter-disc": shapes.quarter_disc}
    return discs[shape.kind].lattice(radius, divisions, shape.element, **options)


def nearest_node(body: Part, point: ArrayLike, what: str) -> int:
    """Return the node of a body or membrane at a point, to within NEAR of the smallest element that has the node.

    Raises
    ------
    InvalidProblem
        There is none so near: a neighbour would be held, loaded or asked instead. The nearest is named.
    """
    return near_enough(nearest_to(body, point), what)


def nearest_to(body: Part, point: ArrayLike) -> Nearest:
    """Return the node of a body or membrane nearest to a point, however far."""
    points = body.points if isinstance(body, MembranePart) else body.mesh.points
    apart = np.linalg.norm(points - np.asarray(point), axis=1)
    node = int(np.argmin(apart))
    around = [points[block.nodes[(block.nodes == node).any(axis=1)]] for block in body.mesh.blocks]
    smallest = min(float(np.linalg.norm(np.ptp(x, axis=1), axis=1).min()) for x in around if len(x))
    return Nearest(float(apart[node]), node, tuple(points[node].tolist()), smallest)


def near_enough(nearest: Nearest, what: str) -> int:
    """Return the nearest node's number if it is within NEAR of its smallest element, as `nearest_node` does."""
    reach = NEAR * nearest.smallest
    if nearest.apart > reach:
        at = ", ".join(f"{x:.9g}" for x in nearest.at)
        raise InvalidProblem(
            f"near: expected a node of {what} within {reach:.3g} of the point (1 % of an element), got the "
            f"nearest, node {nearest.node} at ({at}), {nearest.apart:.3g} away"
        )
    return nearest.node
