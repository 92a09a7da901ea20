"""Write a scene of elastic bodies as a CalculiX deck, so that another code can solve the case.

A rigid plane becomes a plate of one element with all nodes fixed.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path as FilePath

import numpy as np

from contactqp.elements.abaqus import HEX_FACES
from contactqp.elements.obstacle import Plane
from contactqp.elements.reference_elements import Reference
from contactqp.elements.solid import Body
from contactqp.errors import InvalidProblem, Unsupported
from contactqp.exchange.files import Path, write_whole
from contactqp.model.arguments import checked
from contactqp.model.arrays import Vector
from contactqp.scene.body_model import BodyModel, body_model, sides_of
from contactqp.scene.geometry import obstacle
from contactqp.scene.scene import Scene

# Prefixes of the element types, by the model of the body.
_PREFIX = {"3d": "C3D", "plane-strain": "CPE", "plane-stress": "CPS", "axisymmetric": "CAX"}
# A sign, 13 digits and an exponent of four are 20 characters, which is what CalculiX reads of a number.
DIGITS = 12
# The compliance of the contact springs relative to that of a layer of the slave as thick as its facets. With stiffer
# springs between faces CalculiX 2.20 ends with some in tension.
YIELDING_NODES, YIELDING_FACES = 1e-4, 1e-2
# The plate that replaces a plane extends beyond the body by this part of the body's size.
WIDER = 0.5
WORDS_A_LINE = 12


@checked
def write_deck(scene: Scene, folder: Path) -> str:
    """Write a scene of elastic bodies as a deck of CalculiX, and return the path of the file.

    Loads are written as nodal forces, supports with their prescribed values, and contact of two sides as *CONTACT PAIR:
    node to surface, or surface to surface for a mortar. The springs have 1e-4, or 1e-2 for surfaces, of the compliance
    of the adjacent elements; CalculiX does not converge with stiffer ones.

    Raises Unsupported: nodes and bars, membranes, round obstacles, elements that CalculiX lacks, a motion, a load path
    or ties; InvalidProblem: the folder cannot be created or written to.

    Parameters
    ----------
    scene : Scene
    folder : path
        It is made where it is not there; the file is called as the case file, with the suffix .inp.
    """
    told = f"{scene.file or 'scene'}: export"
    if not scene.bodies or scene.membranes:
        raise Unsupported(f"{told}: a deck has elastic bodies, no membranes, bars, masses or matrices")
    for contact in scene.contacts:
        if contact.obstacle is not None and not isinstance(obstacle(scene, contact.obstacle), Plane):
            raise Unsupported(f"{told}: {contact.name}: a deck has planes as obstacles, {contact.obstacle!r} is none")
    if scene.motion is not None or scene.path is not None or scene.large:
        raise Unsupported(f"{told}: a deck has one static step of small displacements")
    target = FilePath(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidProblem(f"{folder}: cannot be made ({error.strerror or error})") from None
    file = target / f"{FilePath(scene.file).stem if scene.file else 'scene'}.inp"
    text = "\n".join([*_lines(scene, body_model(scene)), ""])

    def write(beside: FilePath) -> None:
        beside.write_text(text, encoding="ascii")

    write_whole(file, write)
    return str(file)


def _lines(scene: Scene, model: BodyModel) -> Iterator[str]:
    yield "*HEADING"
    yield "".join(letter for letter in scene.title if letter.isascii() and letter.isprintable()) or "a scene"
    elements: dict[str, int] = {}
    count = 0
    for number, body in enumerate(model.structure.bodies):
        if not isinstance(body, Body):
            raise Unsupported(f"export: {body.name} is not an elastic body")
        elements[body.name] = count
        yield from _body(number, body, _first_node(model, body.name), count)
        count += body.mesh.elements
    node = model.structure.size // len(model.structure.bodies[0].axes)
    # CalculiX allows one type of contact pair in a deck.
    nodes = all(contact.obstacle is not None or contact.pairing != "mortar" for contact in scene.contacts)
    for number, contact in enumerate(scene.contacts):
        sides = [_side(model, *end, elements) for end in sides_of(contact)]
        slave = model.structure.solid(sides_of(contact)[0][0])
        plane = None if contact.obstacle is None else obstacle(scene, contact.obstacle)
        if isinstance(plane, Plane):
            plate = _Plate(slave, np.asarray(plane.outward(), dtype=float), np.asarray(plane.point, dtype=float))
            yield from plate.lines(f"PLATE{number + 1}", node, count)
            sides.append([(count + 1, plate.face)])
            node, count = node + len(plate.points), count + 1
        materials = [model.structure.solid(body).material.modulus for body, _ in sides_of(contact)]
        yield from _contact(slave, number, sides, min(materials), float(contact.friction or 0), nodes=nodes)
    yield from _supports_and_loads(model)


def _first_node(model: BodyModel, body: str) -> int:
    """Return the label before that of the first node of a body."""
    return model.structure.first(body) // len(model.structure.bodies[0].axes)


def _body(number: int, body: Body, node: int, element: int) -> Iterator[str]:
    name = f"BODY{number + 1}"
    yield f"*NODE, NSET={name}"
    for i, point in enumerate(body.mesh.points):
        yield ", ".join([str(node + i + 1), *map(_number, point)])
    for block in body.mesh.blocks:
        yield f"*ELEMENT, TYPE={_type(body, block.kind)}, ELSET={name}"
        for nodes in block.nodes.tolist():
            element += 1
            words = [str(element), *(str(node + i + 1) for i in nodes)]
            rows = [", ".join(words[at : at + WORDS_A_LINE]) for at in range(0, len(words), WORDS_A_LINE)]
            yield from ",\n".join(rows).split("\n")
    yield from (f"*MATERIAL, NAME={name}", "*ELASTIC", f"{_number(body.material.modulus)}, {body.material.poisson!r}")
    if body.material.density:
        yield from ("*DENSITY", _number(body.material.density))
    yield f"*SOLID SECTION, ELSET={name}, MATERIAL={name}"
    if body.model in ("plane-strain", "plane-stress"):
        yield _number(body.thickness)


def _type(body: Body, kind: Reference) -> str:
    nodes = len(kind.nodes)
    if nodes not in ((4, 8, 10, 20) if body.dimension == 3 else (3, 4, 6, 8)):
        raise Unsupported(f"export: {body.name}: CalculiX has no elements {kind.name}")
    return f"{_PREFIX[body.model]}{nodes}"


# A face of an element: the element's label and the number of the face from 1.
_Face = tuple[int, int]


def _side(model: BodyModel, body: str, side: str, elements: dict[str, int]) -> list[_Face]:
    """Return the faces of a side of a body."""
    mesh = model.structure.solid(body).mesh
    pairs = mesh.sides.get(side)
    if pairs is None:
        raise Unsupported(f"export: {body}.{side}: a set of nodes; expected a side of faces")
    first, found = np.cumsum([0, *(len(block) for block in mesh.blocks)]), []
    for element, facet in pairs.tolist():
        kind = mesh.blocks[int(np.searchsorted(first, element, side="right")) - 1].kind
        face = HEX_FACES.index(facet) if kind.corners == 8 else facet
        found.append((elements[body] + element + 1, face + 1))
    return found


class _Plate:
    """One element with a face in a plane, wide enough for a body beside it, and below the plane.

    Parameters
    ----------
    body : Body
    normal, point : (d,) arrays, out of the plane, and a point in it [length]
    """

    def __init__(self, body: Body, normal: Vector, point: Vector) -> None:
        self.body, d = body, body.dimension
        x = body.mesh.points
        along = np.linalg.svd(normal[None])[2][1:]  # unit vectors along the plane
        if d == 3 and np.linalg.det(np.vstack([along, normal])) < 0:
            along = along[::-1]
        if d == 2 and along[0] @ [normal[1], -normal[0]] < 0:
            along = -along
        at = (x - point) @ along.T
        low, high = at.min(axis=0), at.max(axis=0)
        size = float(np.ptp(x, axis=0).max())
        low, high = low - WIDER * size, high + WIDER * size
        if body.model == "axisymmetric" and abs(normal[0]) > 0:
            raise Unsupported(f"export: {body.name}: a plane beside a body of revolution, which is a cone in a deck")
        corners = np.array([[low[0]], [high[0]]]) if d == 2 else np.array(
            [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]]
        )  # fmt: skip
        top = point + corners @ along
        if body.model == "axisymmetric":
            top[:, 0] = np.maximum(top[:, 0], 0.0)
        below = top - size * normal
        # Counter-clockwise in the plane; in space first the lower face, then the one in the plane.
        self.points = np.concatenate([below, top[::-1]] if d == 2 else [below, top])
        self.face = 3 if d == 2 else 2

    def lines(self, name: str, node: int, element: int) -> Iterator[str]:
        """Yield the lines of nodes, element and supports; labels continue from `node` and `element`."""
        body, count = self.body, len(self.points)
        yield f"*NODE, NSET={name}"
        for i, point in enumerate(self.points):
            yield ", ".join([str(node + i + 1), *map(_number, point)])
        yield f"*ELEMENT, TYPE={_PREFIX[body.model]}{count}, ELSET={name}"
        yield ", ".join([str(element + 1), *(str(node + i + 1) for i in range(count))])
        yield from (f"*MATERIAL, NAME={name}", "*ELASTIC", f"{_number(body.material.modulus)}, 0.")
        yield f"*SOLID SECTION, ELSET={name}, MATERIAL={name}"
        if body.model in ("plane-strain", "plane-stress"):
            yield _number(body.thickness)
        yield from ("*BOUNDARY", f"{name}, 1, {body.dimension}")


def _contact(
    slave: Body, number: int, sides: list[list[_Face]], modulus: float, friction: float, *, nodes: bool
) -> Iterator[str]:
    """Yield the surfaces and the pair of one entry of the scene's contacts, of nodes or of faces."""
    names = [f"SLAVE{number + 1}", f"MASTER{number + 1}"]
    for name, faces in zip(names, sides, strict=True):
        yield f"*SURFACE, NAME={name}"
        yield from (f"{element}, S{face}" for element, face in faces)
    size = float(np.ptp(slave.mesh.points, axis=0).max()) / max(len(slave.mesh.points), 2) ** (1 / slave.dimension)
    stiffness = modulus / ((YIELDING_NODES if nodes else YIELDING_FACES) * size)
    yield f"*SURFACE INTERACTION, NAME=CONTACT{number + 1}"
    yield "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR"
    yield f"{_number(stiffness)}, {_number(1e-12 * modulus)}" if nodes else _number(stiffness)
    if friction:
        yield from ("*FRICTION", f"{_number(friction)}, {_number(stiffness / 10)}")
    kind_of_pair = "NODE TO SURFACE" if nodes else "SURFACE TO SURFACE"
    yield f"*CONTACT PAIR, INTERACTION=CONTACT{number + 1}, TYPE={kind_of_pair}"
    yield ", ".join(names)


def _supports_and_loads(model: BodyModel) -> Iterator[str]:
    d = len(model.structure.bodies[0].axes)
    prescribed = model.system.prescribed.reshape(-1, d)
    held = np.argwhere(~np.isnan(prescribed)).tolist()
    at_rest = [(node, axis) for node, axis in held if prescribed[node, axis] == 0]
    moved = [(node, axis) for node, axis in held if prescribed[node, axis] != 0]
    if at_rest:
        yield "*BOUNDARY"
        yield from (f"{node + 1}, {axis + 1}, {axis + 1}" for node, axis in at_rest)
    yield from ("*STEP, INC=1000", "*STATIC", "1., 1., 1e-5, 1.")
    if moved:
        yield "*BOUNDARY"
        for node, axis in moved:
            yield f"{node + 1}, {axis + 1}, {axis + 1}, {_number(prescribed[node, axis])}"
    load = model.system.load.reshape(-1, d)
    forces = np.argwhere(load != 0).tolist()
    if forces:
        yield "*CLOAD"
        yield from (f"{node + 1}, {axis + 1}, {_number(load[node, axis])}" for node, axis in forces)
    yield from ("*NODE FILE", "U", "*CONTACT FILE", "CDIS, CSTR", "*END STEP")


def _number(value: float) -> str:
    return f"{float(value):.{DIGITS}e}"
