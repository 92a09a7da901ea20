"""The rigid obstacles of a scene in floats, and warnings of contacts that start deep inside of what they touch."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.obstacle import Obstacle, Plane
from contactqp.elements.round_obstacle import Circle, Cylinder, Paraboloid, Sphere
from contactqp.errors import InvalidProblem, StartWarning, warn
from contactqp.scene.units import number, vector

if TYPE_CHECKING:
    from collections.abc import Mapping

    from contactqp.model.arrays import Array
    from contactqp.scene.schema import Contact, SceneData


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


def height_of(item: Obstacle, name: str, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the z of the obstacle's upper surface over (p, 2) points, -inf where there is none [length].

    Raises
    ------
    InvalidProblem
        An obstacle that does not lie below a surface z(x, y): of another kind, a hole, or turned to another side.
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


def _squares(points: NDArray[np.float64], centre: Any) -> NDArray[np.float64]:
    """Return r^2 of the points from the vertical through the centre."""
    squares: NDArray[np.float64] = ((points - np.asarray(centre, dtype=float)[:2]) ** 2).sum(axis=1)
    return squares


# Depths that differ by less than this part of the larger one are the same.
SAME = 1e-6


def warn_of_start(scene: SceneData, place: int, doubt: str) -> None:
    """Warn of a doubt about one of the scene's contacts, if there is one."""
    if doubt:
        file = f"{scene.file}: " if scene.file else ""
        name = scene.contacts[place].name
        warn(f"{file}contacts[{place}] ({name!r}): {doubt}", StartWarning)


def warn_of_nodes(scene: SceneData, gaps: Array) -> None:
    """Warn of contacts of nodes, whose initial gaps are these [length]."""
    if not len(gaps) or np.min(gaps) > 0:
        return
    from contactqp.elements.pairing import CURE, doubt_of_depth

    points = {node: np.array(scene.point(node), dtype=float) for node in scene.every_node}
    size = float(np.ptp(np.array(list(points.values())), axis=0).max())
    beside = _neighbours(scene)
    for place in np.flatnonzero(gaps <= 0).tolist():
        contact, depth = scene.contacts[place], -float(gaps[place])
        if contact.obstacle is None:
            doubt = doubt_of_depth(depth, size, "the other node", scene.units.length)
        elif _deeper(scene, contact, depth, points, beside):
            where = f"{depth:.6g} {scene.units.length} inside" if depth else "on the surface of"
            deeper = "lies deeper still" if depth else "lies inside"
            what = f"{contact.obstacle!r}, and all that it is joined to {deeper}"
            doubt = f"it starts {where} {what}: {CURE}; turn it round?"
        else:
            doubt = doubt_of_depth(depth, size, repr(contact.obstacle), scene.units.length)
        warn_of_start(scene, place, doubt)


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
    except InvalidProblem:  # it has no distance there
        return False
    return bool(np.all(-np.asarray(distances, dtype=float) > depth * (1 + SAME)))
