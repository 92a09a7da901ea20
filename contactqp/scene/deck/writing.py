"""Write a scene of elastic bodies as a deck that CalculiX runs, so that a case can be put to another code."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path as FilePath

import numpy as np

from contactqp.elements.abaqus import HEX_FACES
from contactqp.elements.reference_elements import Reference
from contactqp.elements.solid import Body
from contactqp.errors import InvalidProblem, Unsupported
from contactqp.exchange.files import Path, write_whole
from contactqp.model.arguments import checked
from contactqp.scene.body_model import BodyModel, body_model, sides_of
from contactqp.scene.scene import Scene

# Prefixes of the element types, by the model of the body.
_PREFIX = {"3d": "C3D", "plane-strain": "CPE", "plane-stress": "CPS", "axisymmetric": "CAX"}
# A sign, 13 digits and an exponent of four are 20 characters, which is what CalculiX reads of a number.
DIGITS = 12
# The springs behind contact yield this part of what a layer of the slave as thick as its facets yields: on stiffer ones
# between faces CalculiX 2.20 ends with some of them in tension.
YIELDING_NODES, YIELDING_FACES = 1e-4, 1e-2
WORDS_A_LINE = 12


@checked
def write_deck(scene: Scene, folder: Path) -> str:
    """Write a scene of elastic bodies as a deck of CalculiX, and return the path of the file.

    Loads are written as nodal forces, supports with what they prescribe, contact of two sides as *CONTACT PAIR of
    nodes, on springs that yield a ten-thousandth of what the elements beside them do, or of faces for a mortar, on
    springs that yield a hundredth: CalculiX does not come to an end on stiffer ones.

    Raises Unsupported: a scene of nodes and bars, membranes, obstacles, elements that CalculiX has not, a motion or a
    load path; InvalidProblem: the folder cannot be made or written to.

    Parameters
    ----------
    scene : Scene
    folder : path
        It is made where it is not there; the file is called as the case file, with the suffix .inp.
    """
    told = f"{scene.file or 'scene'}: export"
    if not scene.bodies or scene.membranes or any(contact.obstacle is not None for contact in scene.contacts):
        raise Unsupported(f"{told}: a deck has elastic bodies and contacts of two of their sides, no obstacles")
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
            raise Unsupported(f"export: {body.name} is no elastic body")
        elements[body.name] = count
        yield from _body(number, body, _first_node(model, body.name), count)
        count += body.mesh.elements
    for number, contact in enumerate(scene.contacts):
        yield from _contact(
            model, number, sides_of(contact), str(contact.pairing), float(contact.friction or 0), elements
        )
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


def _contact(
    model: BodyModel,
    number: int,
    ends: list[tuple[str, str]],
    pairing: str,
    friction: float,
    elements: dict[str, int],
) -> Iterator[str]:
    """Yield the surfaces and the pair of one entry of the scene's contacts."""
    names = [f"SLAVE{number + 1}", f"MASTER{number + 1}"]
    for name, (body, side) in zip(names, ends, strict=True):
        mesh = model.structure.solid(body).mesh
        pairs = mesh.sides.get(side)
        if pairs is None:
            raise Unsupported(f"export: {body}.{side}: a set of nodes; expected a side of faces")
        first = np.cumsum([0, *(len(block) for block in mesh.blocks)])
        yield f"*SURFACE, NAME={name}"
        for element, facet in pairs.tolist():
            kind = mesh.blocks[int(np.searchsorted(first, element, side="right")) - 1].kind
            face = HEX_FACES.index(facet) if kind.corners == 8 else facet
            yield f"{elements[body] + element + 1}, S{face + 1}"
    slave = model.structure.solid(ends[0][0])
    modulus = min(model.structure.solid(body).material.modulus for body, _ in ends)
    size = float(np.ptp(slave.mesh.points, axis=0).max()) / max(len(slave.mesh.points), 2) ** (1 / slave.dimension)
    nodes = pairing != "mortar"
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
