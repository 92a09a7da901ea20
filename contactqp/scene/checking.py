"""Check that the parts of a scene fit each other: names exist, lengths are not zero, loads act on free unknowns.

Meshes are not read before the scene is built.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator
from typing import TYPE_CHECKING

from contactqp.errors import SceneError
from contactqp.scene.blocks import BLOCKS
from contactqp.scene.blocks.element import ROTATION, refuse_zero_direction, refuse_zero_length
from contactqp.scene.checking_analyses import claims_fit, control_fits, motion_fits, path_fits
from contactqp.scene.fields import no_such, refuse_unknown
from contactqp.scene.schema import Unknowns, is_rotation, unknowns_of
from contactqp.scene.units import KINDS, Dimension

if TYPE_CHECKING:
    from contactqp.scene.schema import SceneData, Tie

# The lists of the file whose entries have names, beside the blocks of elements.
_LISTS = ("ties", "obstacles", "contacts", "bodies", "membranes", "supports")
_VECTORS = {
    "obstacles": ("point", "normal", "centre", "apex", "axis"),
    "contacts": ("direction", "slip_origin"),
    "supports": ("near",),
    "point_loads": ("near", "force"),
    "line_loads": ("value",),
    "tractions": ("value",),
}


def check(scene: SceneData) -> None:
    """Raise SceneError at the first part that does not fit the others."""
    _names_are_distinct(scene)
    _dimensions_fit(scene)
    _obstacles_have_directions(scene)
    path_fits(scene)
    large_fits(scene)
    if scene.meshed:
        check_bodies(scene)
        motion_fits(scene, Unknowns((), frozenset()))
        claims_fit(scene, Unknowns((), frozenset()))
        return
    _no_bodies(scene)
    _nodes_exist(scene)
    _elements_fit(scene)
    unknowns = unknowns_of(scene)
    parts = (
        _fixed_exist, _matrices_fit, _ties_fit, _contacts_fit, _loads_fit, _nothing_hangs, control_fits, motion_fits,
        claims_fit,
    )  # fmt: skip
    for part in parts:
        part(scene, unknowns)


def _names_are_distinct(scene: SceneData) -> None:
    for key in ("nodes", *BLOCKS, *_LISTS):
        seen: dict[str, int] = {}
        for i, item in enumerate(getattr(scene, key)):
            if item.name in seen:
                raise SceneError(
                    f"{key}[{i}].name: expected distinct names, got {item.name!r} as in {key}[{seen[item.name]}]"
                )
            seen[item.name] = i


def _dimensions_fit(scene: SceneData) -> None:
    d = len(scene.axes)
    for where, element in scene.elements:
        element.check_axes(scene, where)
    for key, vector in _vectors(scene):
        if len(vector) != d:
            raise SceneError(
                f"{key}: expected {d} components, one for each of the axes {list(scene.axes)}, got {len(vector)}"
            )


def _vectors(scene: SceneData) -> Iterator[tuple[str, tuple[object, ...]]]:
    yield from ((f"nodes[{i}].at ({node.name!r})", node.at) for i, node in enumerate(scene.nodes))
    element_vectors = {key: kind.vectors for key, kind in BLOCKS.items()}
    for key, names in {**element_vectors, **_VECTORS}.items():
        for i, item in enumerate(getattr(scene, key)):
            for name in names:
                if (vector := getattr(item, name)) is not None:
                    yield f"{key}[{i}].{name} ({item.name!r})", vector
    if scene.gravity is not None:
        yield "gravity", scene.gravity


def _no_bodies(scene: SceneData) -> None:
    """Refuse keys that need bodies in a scene without bodies, and an empty scene."""
    for key in ("supports", "tractions", "pressures", "point_loads"):
        if getattr(scene, key):
            held = (
                '; fixed = ["C.y"] holds the node C along y, and a tie of one term moves it'
                if key == "supports"
                else ""
            )
            raise SceneError(f"{key}: expected none in a scene without bodies{held}")
    if not scene.nodes:
        raise SceneError("nodes: expected 'nodes', 'bodies' or 'membranes', got none")
    for i, obstacle in enumerate(scene.obstacles):
        if obstacle.kind != "plane" and not scene.large:
            raise SceneError(
                f"obstacles[{i}].kind ({obstacle.name!r}): expected a plane for nodes, got {obstacle.kind!r}: round "
                "obstacles take deformation = 'large', at small displacements their tangent plane does"
            )
    for i, contact in enumerate(scene.contacts):
        if not contact.touched:
            raise SceneError(f"contacts[{i}] ({contact.name!r}): expected 'node' or 'nodes' in a scene without bodies")


def _nodes_exist(scene: SceneData) -> None:
    stated = {node.name: node.at for node in scene.nodes}
    for where, element in scene.elements:
        element.check_nodes(stated, where)
    every = scene.every_node
    for where, element in scene.elements:
        for key, name in element.named_nodes():
            _node_exists(f"{where}.{key} ({element.name!r})", name, stated, every)
    for i, contact in enumerate(scene.contacts):
        for j, name in enumerate(contact.touched):
            key = "node" if contact.node else f"nodes[{j}]"
            _node_exists(f"contacts[{i}].{key} ({contact.name!r})", name, stated, every)


def _node_exists(key: str, name: str, stated: Iterable[str], every: Container[str]) -> None:
    if name not in every:
        raise SceneError(f"{key}: {no_such(name, stated, 'node')}")


def _elements_fit(scene: SceneData) -> None:
    for where, element in scene.elements:
        element.check(scene, where)
    for i, contact in enumerate(scene.contacts):
        refuse_zero_direction(contact.direction, f"contacts[{i}].direction ({contact.name!r})")
        if contact.direction is None and contact.nodes:
            refuse_zero_length(scene, contact.nodes, f"contacts[{i}].nodes ({contact.name!r})")


def _obstacles_have_directions(scene: SceneData) -> None:
    for i, obstacle in enumerate(scene.obstacles):
        for key in ("normal", "axis"):
            vector = getattr(obstacle, key)
            refuse_zero_direction(vector, f"obstacles[{i}].{key} ({obstacle.name!r})")


def _known_unknown(key: str, name: str, scene: SceneData, unknowns: Unknowns) -> None:
    if name in unknowns.names:
        return
    node, _, axis = name.rpartition(".")
    if axis == ROTATION and node in scene.every_node:
        raise SceneError(f"{key}: node {node!r} has no rotation, since no beam ends there")
    raise SceneError(f"{key}: {no_such(name, unknowns.names, 'unknown')}")


def _fixed_exist(scene: SceneData, unknowns: Unknowns) -> None:
    nodes = scene.every_node
    seen: set[str] = set()
    for i, name in enumerate(scene.fixed):
        if name in seen:
            raise SceneError(f"fixed[{i}]: expected distinct names, got {name!r} twice")
        seen.add(name)
        if name not in nodes:
            _known_unknown(f"fixed[{i}]", name, scene, unknowns)
    if not unknowns.free:
        raise SceneError("fixed: expected at least one free unknown, got every one fixed")


def _matrices_fit(scene: SceneData, unknowns: Unknowns) -> None:
    for i, matrix in enumerate(scene.matrices):
        for j, name in enumerate(matrix.unknowns):
            key = f"matrices[{i}].unknowns[{j}] ({matrix.name!r})"
            _known_unknown(key, name, scene, unknowns)
            if is_rotation(name):
                raise SceneError(f"{key}: expected displacements, got the rotation {name!r}")
        _distinct(f"matrices[{i}].unknowns ({matrix.name!r})", matrix.unknowns)


def _distinct(key: str, names: Iterable[str]) -> None:
    names = list(names)
    for name in names:
        if names.count(name) > 1:
            raise SceneError(f"{key}: expected distinct unknowns, got {name!r} twice")


def _ties_fit(scene: SceneData, unknowns: Unknowns) -> None:
    for i, tie in enumerate(scene.ties):
        where = f"ties[{i}]"
        for j, term in enumerate(tie.terms):
            _known_unknown(f"{where}.terms[{j}].unknown ({tie.name!r})", term.unknown, scene, unknowns)
            if term.factor.si == 0:
                raise SceneError(
                    f"{where}.terms[{j}].factor ({tie.name!r}): expected a factor that is not zero, got {term.factor}"
                )
        _distinct(f"{where}.terms ({tie.name!r})", [term.unknown for term in tie.terms])
        if unknowns.fixed.issuperset(term.unknown for term in tie.terms):
            raise SceneError(f"{where} ({tie.name!r}): expected a free unknown, got fixed ones only")
        _tie_dimensions(where, tie)


def _tie_dimensions(where: str, tie: Tie) -> None:
    """Check the factors: in a row of lengths numbers for displacements and lengths for rotations, else numbers."""
    number, length = KINDS["number"].dimension, KINDS["length"].dimension
    angular = all(is_rotation(term.unknown) for term in tie.terms) and tie.value.dimension == number
    for j, term in enumerate(tie.terms):
        expected: Dimension = length if is_rotation(term.unknown) and not angular else number
        if term.factor.dimension != expected:
            kind = "a length (its lever)" if expected == length else "a number without a unit"
            raise SceneError(
                f"{where}.terms[{j}].factor ({tie.name!r}): expected {kind} for {term.unknown!r}, got {term.factor}"
            )
    if not angular and tie.value.dimension != length:
        raise SceneError(f'{where}.value ({tie.name!r}): expected a length such as "0 m", got {tie.value}')


def _contacts_fit(scene: SceneData, unknowns: Unknowns) -> None:
    names = [obstacle.name for obstacle in scene.obstacles]
    for i, contact in enumerate(scene.contacts):
        if contact.obstacle is not None:
            refuse_unknown(f"contacts[{i}].obstacle ({contact.name!r})", contact.obstacle, names, "obstacle")
        touched = {name for node in contact.touched for name in scene.displacements(node)}
        if unknowns.fixed.issuperset(touched):
            raise SceneError(f"contacts[{i}] ({contact.name!r}): expected a node that can move, got fixed ones only")
        if contact.friction and len(scene.axes) == 1:
            raise SceneError(
                f"contacts[{i}].friction ({contact.name!r}): expected a scene of two axes or three, got one"
            )


def _loads_fit(scene: SceneData, unknowns: Unknowns) -> None:
    for i, load in enumerate(scene.loads):
        key = f"loads[{i}].unknown"
        _known_unknown(key, load.unknown, scene, unknowns)
        if load.unknown in unknowns.fixed:
            raise SceneError(f"{key}: expected a free unknown, got {load.unknown!r}, which is fixed")
        kind = KINDS["moment" if is_rotation(load.unknown) else "force"]
        if load.value.dimension != kind.dimension:
            raise SceneError(
                f'loads[{i}].value: expected {kind.article} such as "{kind.example}" on {load.unknown!r}, '
                f"got {load.value}"
            )
    for i, line_load in enumerate(scene.line_loads):
        for key, loaded in (("string", scene.strings), ("beam", scene.beams)):
            if (named := getattr(line_load, key)) is not None:
                refuse_unknown(f"line_loads[{i}].{key} ({line_load.name!r})", named, [one.name for one in loaded], key)
    for name in {load.name for load in scene.loads}:
        _distinct(f"loads ({name!r})" if name else "loads", [x.unknown for x in scene.loads if x.name == name])
    weighs = scene.gravity is not None and any(list(element.weights(scene)) for _, element in scene.elements)
    if scene.path is not None and not (scene.loads or scene.line_loads or weighs):
        raise SceneError("path: expected loads that grow along it, got none")


def _nothing_hangs(scene: SceneData, unknowns: Unknowns) -> None:
    """Refuse a free node without element, contact or tie, which must be a mistake."""
    attached = {name for _, element in scene.elements for name in element.chain}
    attached |= {name for contact in scene.contacts for name in contact.touched}
    attached |= {term.unknown.rpartition(".")[0] for tie in scene.ties for term in tie.terms}
    for i, node in enumerate(scene.nodes):
        if node.name not in attached and not unknowns.fixed.issuperset(scene.displacements(node.name)):
            raise SceneError(
                f"nodes[{i}] ({node.name!r}): expected an element, tie or contact at this free node, got none"
            )


def large_fits(scene: SceneData) -> None:
    """Raise SceneError at the first part that does not fit large deformations, or that only they have."""
    if not scene.large:
        _no_large_keys(scene)
        return
    small_only = [key for key, kind in BLOCKS.items() if not kind.large]
    for key in ("bodies", "membranes", *small_only, "ties"):
        if getattr(scene, key):
            raise SceneError(f"{key}: expected none with deformation = 'large', which is offered of bars")
    if scene.motion is not None:
        raise SceneError("motion: expected none with deformation = 'large', which is of statics")
    if scene.path is None:
        raise SceneError("path: expected with deformation = 'large', the path on which the loads grow, and missing")
    if len(scene.axes) == 1:
        raise SceneError("axes: expected two or three with deformation = 'large', got one")
    if not scene.bars:
        raise SceneError("bars: expected with deformation = 'large', got none")
    if scene.path.events is not None:
        raise SceneError(
            f"path.events: expected none with deformation = 'large', where nothing is linear between events, got "
            f"{scene.path.events!r}"
        )
    _obstacles_are_surfaces(scene)


def _no_large_keys(scene: SceneData) -> None:
    for i, bar in enumerate(scene.bars):
        if bar.law is not None:
            raise SceneError(f"bars[{i}].law ({bar.name!r}): expected with deformation = 'large' only, got {bar.law!r}")
    if scene.path is not None and scene.path.control is not None:
        raise SceneError(f"path.control: expected with deformation = 'large' only, got {scene.path.control!r}")


def _obstacles_are_surfaces(scene: SceneData) -> None:
    obstacles_exist_in(scene)
    for i, obstacle in enumerate(scene.obstacles):
        if obstacle.kind == "paraboloid" and obstacle.measure != "normal":
            raise SceneError(
                f"obstacles[{i}].measure ({obstacle.name!r}): expected 'normal' with deformation = 'large': a gap "
                "along the axis has no normal that follows large displacements"
            )
    for i, contact in enumerate(scene.contacts):
        if contact.node is None:
            raise SceneError(
                f"contacts[{i}] ({contact.name!r}): expected 'node' and 'obstacle' with deformation = 'large'"
            )


# Keys that only scenes of nodes have, and their replacements in scenes of bodies.
_OF_NODES = {
    "ties": "ties between bodies are not offered yet",
    "fixed": "'supports' hold bodies",
    "line_loads": "they act on strings and beams",
    "loads": "'tractions', 'pressures' and 'point_loads' act on bodies",
}
# The dimensions that an obstacle exists in.
_DIMENSIONS = {"plane": (2, 3), "circle": (2,), "sphere": (3,), "cylinder": (3,), "paraboloid": (2, 3)}


def check_bodies(scene: SceneData) -> None:
    """Raise SceneError at the first part that does not fit the others."""
    beside = {key: kind.beside_bodies for key, kind in BLOCKS.items()}
    for key, instead in {"nodes": "", **beside, **_OF_NODES}.items():
        if getattr(scene, key):
            instead = instead or f"bodies and {key} in one scene are not offered yet"
            raise SceneError(f"{key}: expected none in a scene of bodies: {instead}")
    if scene.axes not in (("x", "y"), ("x", "y", "z")):
        raise SceneError(f"axes: expected ['x', 'y'] or ['x', 'y', 'z'] in a scene of bodies, got {list(scene.axes)}")
    if scene.membranes:
        _membranes_fit(scene)
    _models_fit(scene)
    _bodies_exist(scene)
    _obstacles_exist(scene)
    for i, support in enumerate(scene.supports):
        refuse_unknown(f"supports[{i}].axis ({support.name!r})", support.axis, scene.axes, "axis")
        if scene.path is not None and support.value is not None and support.value.si:
            raise SceneError(
                f"supports[{i}].value ({support.name!r}): expected 0 with a load path, which makes loads grow and "
                f"prescribed displacements not, got {support.value}"
            )
    loaded = scene.tractions or scene.pressures or scene.point_loads or scene.gravity
    if scene.path is not None and not loaded:
        raise SceneError("path: expected loads that grow along it, got none")


def _membranes_fit(scene: SceneData) -> None:
    """Refuse membranes outside of the plane z = 0 of a scene in space, and beside bodies."""
    if scene.bodies:
        raise SceneError("membranes: expected none beside bodies, which are not offered together")
    if len(scene.axes) != 3:
        raise SceneError(
            f"axes: expected ['x', 'y', 'z'] with membranes, which deflect along z, got {list(scene.axes)}"
        )
    for i, membrane in enumerate(scene.membranes):
        if membrane.shape is not None and membrane.shape.dimension != 2:
            raise SceneError(
                f"membranes[{i}].shape ({membrane.name!r}): expected a plane shape, got {membrane.shape.kind!r}"
            )
    for i, support in enumerate(scene.supports):
        if support.axis != "z":
            raise SceneError(
                f"supports[{i}].axis ({support.name!r}): expected 'z' for a membrane, got {support.axis!r}"
            )
    if scene.gravity is not None:
        raise SceneError("gravity: expected none, membranes have no mass")


def _models_fit(scene: SceneData) -> None:
    round_ones = [body.model == "axisymmetric" for body in scene.bodies]
    for i, body in enumerate(scene.bodies):
        where = f"bodies[{i}].model ({body.name!r})"
        if (body.model == "3d") != (len(scene.axes) == 3):
            raise SceneError(f"{where}: expected a model for the axes {list(scene.axes)}, got {body.model!r}")
        if round_ones[i] != round_ones[0]:
            raise SceneError(f"{where}: expected axisymmetric bodies only, or none, got {body.model!r}")
        if scene.gravity is not None and body.density is None:
            raise SceneError(f"bodies[{i}].density ({body.name!r}): expected, since there is gravity, and missing")


def _places(scene: SceneData) -> Iterator[tuple[str, str]]:
    """Yield every key that names an elastic body, and the body."""
    for key, name in (("point_loads", "on"), ("tractions", "side"), ("pressures", "side")):
        for i, item in enumerate(getattr(scene, key)):
            yield f"{key}[{i}].{name} ({item.name!r})", item.body
    for i, contact in enumerate(scene.contacts):
        for j, side in enumerate(contact.touching_sides):
            key = f"contacts[{i}].sides[{j}]" if contact.sides else f"contacts[{i}].side"
            yield f"{key} ({contact.name!r})", side.partition(".")[0]


def _bodies_exist(scene: SceneData) -> None:
    names = [body.name for body in scene.bodies]
    for key, name in _places(scene):
        refuse_unknown(key, name, names, "body")
    meshed = [body.name for body in scene.meshed]
    for i, support in enumerate(scene.supports):
        refuse_unknown(f"supports[{i}].on ({support.name!r})", support.body, meshed, "body")
    for i, contact in enumerate(scene.contacts):
        if contact.membrane is not None:
            membranes = [membrane.name for membrane in scene.membranes]
            refuse_unknown(f"contacts[{i}].membrane ({contact.name!r})", contact.membrane, membranes, "membrane")


def obstacles_exist_in(scene: SceneData) -> None:
    """Refuse obstacles that do not exist in the dimension of the scene."""
    d = len(scene.axes)
    for i, obstacle in enumerate(scene.obstacles):
        if d not in _DIMENSIONS[obstacle.kind]:
            raise SceneError(
                f"obstacles[{i}].kind ({obstacle.name!r}): a {obstacle.kind} does not exist in {d} dimensions"
            )


def _obstacles_exist(scene: SceneData) -> None:
    names = [obstacle.name for obstacle in scene.obstacles]
    obstacles_exist_in(scene)
    for i, contact in enumerate(scene.contacts):
        where = f"contacts[{i}]"
        if contact.touched:
            raise SceneError(f"{where} ({contact.name!r}): expected 'side' or 'sides' in a scene of bodies")
        if contact.obstacle is not None:
            refuse_unknown(f"{where}.obstacle ({contact.name!r})", contact.obstacle, names, "obstacle")
        if contact.sides is not None:
            _pairs_fit(scene, f"{where}.sides ({contact.name!r})", contact.sides, contact.pairing)


def _pairs_fit(scene: SceneData, where: str, sides: tuple[str, ...], pairing: str | None) -> None:
    first, second = (scene.body(side.partition(".")[0]) for side in sides)
    thicknesses = [None if body.thickness is None else body.thickness.si for body in (first, second)]
    if thicknesses[0] != thicknesses[1]:
        raise SceneError(f"{where}: expected bodies of one thickness, got {first.thickness} and {second.thickness}")
    if first.model == "axisymmetric" and pairing == "mortar":
        raise SceneError(f"{where}: expected the pairing 'node-to-segment' between axisymmetric bodies, got 'mortar'")
