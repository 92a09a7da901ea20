"""The geometry of a scene in floats: the meshes of its bodies and its rigid obstacles.

Meshes come from built-in shapes and files, and their nodes are found by position. Contacts that start deep inside an
obstacle cause a warning.
"""

from __future__ import annotations

from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from contactqp.elements.obstacle import Obstacle, Plane
from contactqp.elements.round_obstacle import Circle, Cylinder, Paraboloid, Sphere
from contactqp.errors import InvalidProblem, StartWarning, warn
from contactqp.model.arrays import EPS
from contactqp.scene.units import number, read_unit, vector

if TYPE_CHECKING:  # meshes are imported where a scene has bodies
    from collections.abc import Mapping, Sequence

    from contactqp.elements.mesh import Mesh
    from contactqp.elements.mesh_files import Lattice
    from contactqp.elements.structure import Part
    from contactqp.model.arrays import Array, Mask
    from contactqp.model.solution import Solution
    from contactqp.scene.schema import Contact, SceneData
    from contactqp.scene.schema_bodies import Body, Membrane, MeshFile, Shape

# The largest distance between a stated point and its node, in diagonals of the node's smallest element; it allows for
# rounded coordinates and excludes the neighbouring nodes.
NEAR_NODE = 0.01


@dataclass(frozen=True, eq=False)
class Nearest:
    """The node of a mesh nearest to a point: its index, its position, and the size of its smallest element [length]."""

    apart: float
    node: int
    at: tuple[float, ...]
    smallest: float


def body_mesh(scene: SceneData, body: Body | Membrane) -> Mesh:
    """Return the mesh of a body in the scene's unit of length.

    Raises InvalidProblem: the file, its mesh or the numbers of the shape are invalid; BackendMissing: the file needs
    meshlane, which is not installed.
    """
    if body.shape is not None:
        return lattice_of_shape(scene, body.shape).mesh()
    if body.mesh is not None:
        return mesh_of_file(scene, body.mesh)
    raise InvalidProblem("expected 'shape' or 'mesh', got neither")


def mesh_of_file(scene: SceneData, source: MeshFile) -> Mesh:
    """Read the mesh of a file, in the scene's unit of length."""
    from contactqp.elements.mesh_files import read_mesh

    folder = Path() if scene.file is None else scene.file.parent
    mesh = read_mesh(folder / source.file, part=source.part, drop_unconnected=source.drop_unconnected)
    scale = float(read_unit(source.unit)[0] / read_unit(scene.units.length)[0])
    return mesh if scale == 1 else mesh.mapped(lambda points: scale * points)


def lattice_of_shape(scene: SceneData, shape: Shape) -> Lattice:
    """Return the lattice from which the mesh of a shape is made, in the scene's unit of length."""
    from contactqp.elements import shapes

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
    """Return the node of a body or membrane at a point, to within NEAR_NODE of the smallest element that has the node.

    Raises
    ------
    InvalidProblem
        No node is that near; the message names the nearest one.
    """
    return near_enough(nearest_to(body, point), what)


def nearest_to(body: Part, point: ArrayLike) -> Nearest:
    """Return the node of a body or membrane nearest to a point, however far."""
    from contactqp.elements.solid import Membrane

    points = body.points if isinstance(body, Membrane) else body.mesh.points
    apart = np.linalg.norm(points - np.asarray(point), axis=1)
    node = int(np.argmin(apart))
    around = [points[block.nodes[(block.nodes == node).any(axis=1)]] for block in body.mesh.blocks]
    smallest = min(float(np.linalg.norm(np.ptp(x, axis=1), axis=1).min()) for x in around if len(x))
    return Nearest(float(apart[node]), node, tuple(points[node].tolist()), smallest)


def near_enough(nearest: Nearest, what: str) -> int:
    """Return the index of the nearest node if it is within the tolerance NEAR_NODE, else raise as `nearest_node`."""
    reach = NEAR_NODE * nearest.smallest
    if nearest.apart > reach:
        at = ", ".join(f"{x:.9g}" for x in nearest.at)
        raise InvalidProblem(
            f"near: expected a node of {what} within {reach:.3g} of the point (1 % of an element), got the "
            f"nearest, node {nearest.node} at ({at}), {nearest.apart:.3g} away"
        )
    return nearest.node


def obstacle(scene: SceneData, name: str) -> Obstacle:
    """Return the rigid obstacle of that name."""
    item = scene.obstacle(name)
    where = {key: vector(scene.system, getattr(item, key) or ()) for key in ("point", "centre", "apex")}
    normal, axis = (np.array([float(x) for x in vector or ()]) for vector in (item.normal, item.axis))
    radius = 0.0 if item.radius is None else number(scene.system, item.radius)
    inside = bool(item.inside)
    if item.kind == "plane":
        return Plane(where["point"], normal)
    if item.kind == "circle":
        return Circle(where["centre"], radius, inside)
    if item.kind == "sphere":
        return Sphere(where["centre"], radius, inside)
    if item.kind == "cylinder":
        return Cylinder(where["point"], axis, radius, inside)
    return Paraboloid(where["apex"], axis, radius, inside, item.measure or "axis")


def height_of(item: Obstacle, name: str, points: Array) -> Array:
    """Return the z of the obstacle's upper surface over (p, 2) points, -inf where there is none [length].

    Raises
    ------
    InvalidProblem
        The obstacle is not the region below a surface z(x, y), but another kind, a hole, or turned to another side.
    """
    if isinstance(item, Plane) and float(item.outward()[2]) > 0:
        n = np.asarray(item.outward(), dtype=float)
        return np.asarray(item.point[2] - (points - np.asarray(item.point[:2])) @ n[:2] / n[2])
    if isinstance(item, Sphere) and not item.inside:
        below = item.radius**2 - _squares(points, item.centre)
        return np.where(below >= 0, item.centre[2] + np.sqrt(np.maximum(below, 0)), -np.inf)
    if isinstance(item, Paraboloid) and not item.inside and not np.any(item.axis[:2]) and item.axis[2] > 0:
        return np.asarray(item.apex[2] - _squares(points, item.apex) / (2 * item.radius))
    raise InvalidProblem(
        "expected an obstacle below the membrane (a plane whose normal points up, a sphere, or a paraboloid with the "
        f"axis +z, none of them a hole), got {name!r}"
    )


def _squares(points: Array, centre: Any) -> Array:
    """Return r^2 of the points from the vertical through the centre."""
    squares: Array = ((points - np.asarray(centre, dtype=float)[:2]) ** 2).sum(axis=1)
    return squares


# Depths count as equal if they differ by less than this part of the larger one.
SAME_DEPTH = 1e-6
# Gaps up to this part of the largest coordinate may be rounding of a few products of coordinates with a normal.
GAP_ROUNDING = 16 * EPS


def warn_of_start(scene: SceneData, place: int, doubt: str) -> None:
    """Warn about one of the scene's contacts if `doubt` is not empty."""
    if doubt:
        file = f"{scene.file}: " if scene.file else ""
        name = scene.contacts[place].name
        warn(f"{file}contacts[{place}] ({name!r}): {doubt}", StartWarning)


def warn_of_nodes(scene: SceneData, gaps: Array) -> None:
    """Warn of contacts of nodes, whose initial gaps are these [length]."""
    for place, doubt in _doubts_of_nodes(scene, gaps).items():
        warn_of_start(scene, place, doubt)


def _beyond_rounding(scene: SceneData, gaps: Array) -> Array:
    """Return initial gaps, zero where the rounding of coordinates and of the normal may have made them [length]."""
    lengths = [float(x) for node in scene.every_node for x in scene.point(node)]
    for item in scene.obstacles:
        stated = [*(item.point or ()), *(item.centre or ()), *(item.apex or ())]
        lengths += vector(scene.system, stated if item.radius is None else [*stated, item.radius])
    size = max((abs(x) for x in lengths), default=0.0)
    return np.where(abs(gaps) <= GAP_ROUNDING * size, 0.0, gaps)


def _doubts_of_nodes(scene: SceneData, gaps: Array) -> dict[int, str]:
    """Return the doubts about contacts of nodes, by the index of the contact."""
    gaps = _beyond_rounding(scene, gaps)
    if not len(gaps) or np.min(gaps) > 0:
        return {}
    from contactqp.elements.pairing import CURE, doubt_of_depth

    points = {node: np.array(scene.point(node), dtype=float) for node in scene.every_node}
    size = float(np.ptp(np.array(list(points.values())), axis=0).max())
    beside = _neighbours(scene)
    doubts = {}
    for place in np.flatnonzero(gaps <= 0).tolist():
        contact, depth = scene.contacts[place], -float(gaps[place])
        if contact.obstacle is None:
            doubt = doubt_of_depth(depth, size, "the other node", scene.units.length)
        elif _deeper(scene, contact, depth, points, beside) and not _wound(scene, contact, points, beside):
            where = f"{depth:.6g} {scene.units.length} inside" if depth else "on the surface of"
            deeper = "lies deeper still" if depth else "lies inside"
            what = f"{contact.obstacle!r}, and all that it is joined to {deeper}"
            doubt = f"it starts {where} {what}: {CURE}; turn it round?"
        else:
            doubt = doubt_of_depth(depth, size, repr(contact.obstacle), scene.units.length)
        if doubt:
            doubts[place] = doubt
    return doubts


def warn_of_unpushed(scene: SceneData, gaps: Array, history: Sequence[Solution]) -> None:
    """Warn of contacts of nodes that start inside an obstacle, never have a force and end outside, and of a rope on the
    planes of a polygon none of which ever pushes it.

    Such an obstacle is turned the wrong way, which the initial positions do not show for a beam along it, nor for a
    rope, which may lie on a post as well as in a trough. Motions are not checked.
    """
    if scene.motion is not None or scene.bodies or scene.membranes or not np.min(gaps, initial=1.0) <= 0:
        return
    from contactqp.elements.pairing import CURE

    told, gaps = _doubts_of_nodes(scene, gaps), _beyond_rounding(scene, gaps)
    pushed = np.any([solution.normal_force > 0 for solution in history], axis=0)
    wound = _on_polygons(scene, gaps)
    leaves = (history[-1].contact_status == "open") & ~pushed & ((gaps < 0) | (wound & ~pushed[wound].any()))
    for place in np.flatnonzero(leaves).tolist():
        contact, depth = scene.contacts[place], -float(gaps[place])
        if place not in told and contact.obstacle is not None:
            where = f"{depth:.6g} {scene.units.length} inside" if depth else "on the surface of"
            doubt = f"it starts {where} {contact.obstacle!r} and ends outside, and nothing has pushed it"
            warn_of_start(scene, place, f"{doubt}: {CURE}; turn it round?")


def _on_polygons(scene: SceneData, gaps: Array) -> Mask:
    """Return which contacts are those of a rope that lies on planes round a convex body, by their initial gaps."""
    points = {node: np.array(scene.point(node), dtype=float) for node in scene.every_node}
    found, beside = np.zeros(len(gaps), dtype=bool), _neighbours(scene)
    for place in np.flatnonzero(gaps <= 0).tolist():
        contact = scene.contacts[place]
        found[place] = (
            contact.obstacle is not None
            and _deeper(scene, contact, -float(gaps[place]), points, beside)
            and _wound(scene, contact, points, beside)
        )
    return found


def _neighbours(scene: SceneData) -> Mapping[str, set[str]]:
    """Return the nodes that elements join to each node."""
    found: defaultdict[str, set[str]] = defaultdict(set)
    for _, element in scene.elements:
        nodes = {name.rpartition(".")[0] for names, _ in element.stiffnesses(scene) for name in names}
        for node in nodes:
            found[node] |= nodes - {node}
    return found


def _deeper(
    scene: SceneData, contact: Contact, depth: float, points: Mapping[str, Array], beside: Mapping[str, set[str]]
) -> bool:
    """Return whether all nodes that the contact's node is joined to lie deeper inside of its obstacle."""
    others = [points[node] for node in sorted(beside[contact.touched[0]]) if node in points]
    if not others:
        return False
    try:
        distances = obstacle(scene, str(contact.obstacle)).distance(np.array(others))
    except InvalidProblem:  # the obstacle has no distance there
        return False
    return bool(np.all(-np.asarray(distances, dtype=float) > depth * (1 + SAME_DEPTH)))


def _wound(scene: SceneData, contact: Contact, points: Mapping[str, Array], beside: Mapping[str, set[str]]) -> bool:
    """Return whether the contact's node lies inside another obstacle that a node joined to it touches, as that of a
    rope does which lies on planes round a convex body.
    """
    node = contact.touched[0]
    touched = {c.obstacle for c in scene.contacts if c.obstacle is not None and c.node in beside[node]}
    for name in sorted(touched - {contact.obstacle}):
        with suppress(InvalidProblem):  # the obstacle has no distance there
            if obstacle(scene, name).distance(points[node][None, :])[0] < 0:
                return True
    return False
