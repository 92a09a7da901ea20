"""What a scene's parts must have in common: names that exist, lengths that are not zero, loads on free unknowns."""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator
from typing import TYPE_CHECKING

from contactqp.errors import SceneError
from contactqp.scene.blocks import BLOCKS
from contactqp.scene.blocks.element import ROTATION, refuse_zero_direction, refuse_zero_length
from contactqp.scene.checking_bodies import check_bodies, obstacles_exist_in
from contactqp.scene.checking_claims import claims_fit
from contactqp.scene.fields import no_such, refuse_unknown
from contactqp.scene.units import KINDS, Dimension
from contactqp.scene.unknowns import Unknowns, is_rotation, load_names, start_values, unknowns_of

if TYPE_CHECKING:
    from contactqp.scene.schema import SceneData, Tie

# The lists of the file whose entries have names, beside the blocks of elements.
_LISTS = (
    "ties", "obstacles", "contacts", "bodies", "membranes", "supports", "line_loads", "tractions", "pressures",
    "point_loads",
)  # fmt: skip
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
    """Refuse what only bodies can have in a scene without them, and a scene of nothing."""
    for key in ("supports", "tractions", "pressures", "point_loads"):
        if getattr(scene, key):
            raise SceneError(f"{key}: expected none in a scene without bodies")
    if not scene.nodes:
        raise SceneError("nodes: expected 'nodes', 'bodies' or 'membranes', got none")
    for i, obstacle in enumerate(scene.obstacles):
        if obstacle.kind != "plane" and not scene.large:
            raise SceneError(
                f"obstacles[{i}].kind ({obstacle.name!r}): expected a plane for nodes, got {obstacle.kind!r}"
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
    known = [obstacle.name for obstacle in scene.obstacles]
    for i, contact in enumerate(scene.contacts):
        if contact.obstacle is not None:
            refuse_unknown(f"contacts[{i}].obstacle ({contact.name!r})", contact.obstacle, known, "obstacle")
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
    strings = [string.name for string in scene.strings]
    for i, line_load in enumerate(scene.line_loads):
        refuse_unknown(f"line_loads[{i}].string ({line_load.name!r})", line_load.string, strings, "string")
    for name in {load.name for load in scene.loads}:
        _distinct(f"loads ({name!r})" if name else "loads", [x.unknown for x in scene.loads if x.name == name])
    weighs = scene.gravity is not None and any(list(element.weights(scene)) for _, element in scene.elements)
    if scene.path is not None and not (scene.loads or scene.line_loads or weighs):
        raise SceneError("path: expected loads that grow along it, got none")


def _nothing_hangs(scene: SceneData, unknowns: Unknowns) -> None:
    """Refuse a free node that nothing holds or touches, which is a slip of the pen."""
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


def control_fits(scene: SceneData, unknowns: Unknowns) -> None:
    """Raise SceneError if the path's control does not fit the scene."""
    path = scene.path
    if path is None or path.control in (None, "load"):
        return
    if path.corners is not None:
        raise SceneError(f"path.corners: expected none with control = {path.control!r}, whose load factor follows")
    for i, contact in enumerate(scene.contacts):
        if contact.friction:
            raise SceneError(
                f"contacts[{i}].friction ({contact.name!r}): expected none with control = {path.control!r}: friction "
                "needs control = 'load'"
            )
    if path.controlled is not None and path.controlled not in unknowns.free:
        fixed = " among those that are free" if path.controlled in unknowns.fixed else ""
        raise SceneError(f"path.controlled: {no_such(path.controlled, unknowns.free, 'unknown')}{fixed}")


def motion_fits(scene: SceneData, unknowns: Unknowns) -> None:
    """Raise SceneError at the first part that does not fit the motion."""
    if scene.motion is None:
        return
    if scene.path is not None:
        raise SceneError("motion: expected [motion] or [path], got both")
    if scene.study:
        raise SceneError("study: expected none in a motion, whose steps have no knob to sweep")
    for i, contact in enumerate(scene.contacts):
        if contact.slip_origin is not None:
            raise SceneError(
                f"contacts[{i}].slip_origin ({contact.name!r}): expected none in a motion, which finds it itself"
            )
    for i, support in enumerate(scene.supports):
        if support.value is not None and support.value.si:
            raise SceneError(
                f"supports[{i}].value ({support.name!r}): expected 0 in a motion, which holds supports still, got "
                f"{support.value}"
            )
    _has_mass(scene)
    _starts_fit(scene, unknowns)


def _has_mass(scene: SceneData) -> None:
    if scene.membranes:
        raise SceneError("membranes: expected none in a motion, they have no mass")
    for where, element in scene.elements:
        element.check_motion(where)
    for i, body in enumerate(scene.bodies):
        where = f"bodies[{i}].density ({body.name!r})"
        if body.density is None:
            raise SceneError(f'{where}: expected in a motion, as in "7850 kg/m^3", and missing')
        if not body.density.si:
            raise SceneError(f"{where}: expected a positive number in a motion, got {body.density}")
    if not scene.bodies and not any(element.has_mass for _, element in scene.elements):
        raise SceneError("motion: expected a bar, body or point mass that has mass, got none")


def _starts_fit(scene: SceneData, unknowns: Unknowns) -> None:
    assert scene.motion is not None
    for key in ("displacements", "velocities"):
        seen: dict[str, str] = {}
        for i, item in enumerate(getattr(scene.motion, key)):
            where = f"motion.{key}[{i}]"
            _one_thing(scene, f"{where}.of", item.of, unknowns)
            expected = 1 if item.of in unknowns.names else len(scene.axes)
            for name in ("value", "to"):
                vector = getattr(item, name)
                if vector is not None and len(vector) != expected:
                    raise SceneError(f"{where}.{name} ({item.of!r}): expected {expected} components, got {len(vector)}")
            if item.to is not None and item.of not in {bar.name for bar in scene.bars}:
                raise SceneError(f"{where}.to ({item.of!r}): expected of a bar only, along which it is linear")
            for name, value in start_values(scene, item):
                if name in seen:
                    raise SceneError(f"{where} ({item.of!r}): expected {name!r} once, got it in {seen[name]} too")
                seen[name] = where
                if name in unknowns.fixed and value:
                    raise SceneError(f"{where} ({item.of!r}): expected 0 for {name!r}, which is fixed")


def _one_thing(scene: SceneData, where: str, name: str, unknowns: Unknowns) -> None:
    if scene.meshed:
        known = {"body": [body.name for body in scene.bodies]}
    else:
        known = {"bar": [bar.name for bar in scene.bars], "node": [*scene.every_node], "unknown": [*unknowns.names]}
    kinds = [kind for kind, names in known.items() if name in names]
    if not kinds:
        raise SceneError(
            f"{where}: {no_such(name, [n for names in known.values() for n in names], ' or '.join(known))}"
        )
    if len(kinds) > 1:
        raise SceneError(f"{where}: expected a name of one thing, got {name!r}, a {' and a '.join(kinds)}")


def path_fits(scene: SceneData) -> None:
    """Raise SceneError at the first corner that does not fit the loads, or load that no corner names."""
    if scene.path is None:
        return
    for i, contact in enumerate(scene.contacts):
        if contact.slip_origin is not None:
            raise SceneError(
                f"contacts[{i}].slip_origin ({contact.name!r}): expected none with a load path, which finds it itself"
            )
    if scene.path.corners is None:
        return
    loads = list(load_names(scene))
    for key, name in loads:
        if name is None:
            raise SceneError(f"{key}.name: expected, since the load path has corners, and missing")
    known = {str(name): None for _, name in loads}
    for i, corner in enumerate(scene.path.corners):
        for name in corner:
            refuse_unknown(f"path.corners[{i}]", name, known, "load")
    for key, name in loads:
        if not any(name in corner for corner in scene.path.corners):
            raise SceneError(
                f"path.corners: expected every load in one corner or more, and {name!r} ({key}) is in none"
            )
