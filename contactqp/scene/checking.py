"""What a scene's parts must have in common: names that exist, lengths that are not zero, loads on free unknowns."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction
from typing import TYPE_CHECKING

from contactqp.errors import SceneError
from contactqp.scene.checking_bodies import (
    check_bodies,
    check_no_bodies,
    control_fits,
    large_fits,
    motion_fits,
    path_fits,
)
from contactqp.scene.checking_claims import claims_fit
from contactqp.scene.fields import unknown
from contactqp.scene.units import KINDS, Dimension
from contactqp.scene.unknowns import ROTATION, Unknowns, is_rotation, of_node, of_scene

if TYPE_CHECKING:
    from contactqp.scene.schema import SceneData, Tie

_LISTS = (
    "nodes", "bars", "springs", "beams", "strings", "masses", "matrices", "ties", "obstacles", "contacts", "bodies",
    "membranes", "supports", "line_loads", "tractions", "pressures", "point_loads",
)  # fmt: skip


_VECTORS = {
    "obstacles": ("point", "normal", "centre", "apex", "axis"),
    "springs": ("direction",),
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
    check_no_bodies(scene)
    _nodes_exist(scene)
    _lengths_are_positive(scene)
    _strings_are_straight(scene)
    unknowns = of_scene(scene)
    parts = (
        _fixed_exist, _matrices_fit, _ties_fit, _contacts_fit, _loads_fit, _nothing_hangs, control_fits, motion_fits,
        claims_fit,
    )  # fmt: skip
    for part in parts:
        part(scene, unknowns)


def _names_are_distinct(scene: SceneData) -> None:
    for key in _LISTS:
        seen: dict[str, int] = {}
        for i, item in enumerate(getattr(scene, key)):
            if item.name in seen:
                raise SceneError(
                    f"{key}[{i}].name: expected distinct names, got {item.name!r} as in {key}[{seen[item.name]}]"
                )
            seen[item.name] = i


def _dimensions_fit(scene: SceneData) -> None:
    d = len(scene.axes)
    for i, bar in enumerate(scene.bars):
        if bar.divisions > 1 and d > 1 and not scene.large:
            raise SceneError(
                f"bars[{i}].divisions ({bar.name!r}): expected 1 in a scene with {d} axes, where nothing holds the "
                f"nodes inside of a bar across it, got {bar.divisions}"
            )
    if scene.beams and d != 2:
        raise SceneError(f"beams: expected a scene with two axes, got {d}")
    if scene.strings and d == 1:
        raise SceneError(
            "strings: expected a scene with two axes or three, since they deflect across themselves, got 1"
        )
    for key, vector in _vectors(scene):
        if len(vector) != d:
            raise SceneError(
                f"{key}: expected {d} components, one for each of the axes {list(scene.axes)}, got {len(vector)}"
            )


def _vectors(scene: SceneData) -> Iterator[tuple[str, tuple[object, ...]]]:
    yield from ((f"nodes[{i}].at ({node.name!r})", node.at) for i, node in enumerate(scene.nodes))
    for key, names in _VECTORS.items():
        for i, item in enumerate(getattr(scene, key)):
            for name in names:
                if (vector := getattr(item, name)) is not None:
                    yield f"{key}[{i}].{name} ({item.name!r})", vector
    if scene.gravity is not None:
        yield "gravity", scene.gravity


def _node_uses(scene: SceneData) -> Iterator[tuple[str, str]]:
    """Every place that names a node, and the name."""
    for key in ("bars", "springs", "beams", "strings", "contacts"):
        for i, item in enumerate(getattr(scene, key)):
            for j, name in enumerate(item.nodes or ()):
                yield f"{key}[{i}].nodes[{j}] ({item.name!r})", name
    for key in ("masses", "contacts"):
        for i, item in enumerate(getattr(scene, key)):
            if item.node is not None:
                yield f"{key}[{i}].node ({item.name!r})", item.node


def _nodes_exist(scene: SceneData) -> None:
    stated = [node.name for node in scene.nodes]
    for i, bar in enumerate(scene.bars):
        for j, name in enumerate(bar.nodes):
            if name not in stated:
                raise SceneError(f"bars[{i}].nodes[{j}] ({bar.name!r}): {unknown(name, stated, 'node')}")
        for name in bar.chain[1:-1]:
            if name in stated:
                raise SceneError(
                    f"bars[{i}].divisions ({bar.name!r}): expected no node {name!r}, which stands inside of the bar"
                )
    for key, name in _node_uses(scene):
        if name not in scene.every_node:
            raise SceneError(f"{key}: {unknown(name, stated, 'node')}")


def _lengths_are_positive(scene: SceneData) -> None:
    for key in ("bars", "beams", "springs", "contacts"):
        for i, item in enumerate(getattr(scene, key)):
            where = f"{key}[{i}]"
            direction = getattr(item, "direction", None)
            if direction is not None and not any(direction):
                raise SceneError(f"{where}.direction ({item.name!r}): expected a direction, got the zero vector")
            if direction is None and len(item.nodes or ()) == 2:
                _apart(scene, f"{where}.nodes ({item.name!r})", item.nodes)
            if key == "springs" and direction is None and len(item.nodes) == 1 and len(scene.axes) > 1:
                raise SceneError(f"{where}.direction ({item.name!r}): expected for a spring to the ground, and missing")
    for i, mass in enumerate(scene.masses):
        if scene.gravity is None and scene.motion is None:
            raise SceneError(f"gravity: expected, since masses[{i}] ({mass.name!r}) weighs, and missing")


def _strings_are_straight(scene: SceneData) -> None:
    """A tension that turns at a node would push it aside with no load at all."""
    for i, string in enumerate(scene.strings):
        where = f"strings[{i}].nodes ({string.name!r})"
        for segment in string.segments:
            _apart(scene, where, segment)
        ways = [_way(scene, segment) for segment in string.segments]
        for node, before, after in zip(string.nodes[1:], ways, ways[1:], strict=False):
            along = sum(a * b for a, b in zip(before, after, strict=True))
            squares = sum(a * a for a in before) * sum(b * b for b in after)
            if along <= 0 or along**2 != squares:
                raise SceneError(
                    f"{where}: expected nodes one after another on a straight line, got a turn at {node!r}"
                )


def _way(scene: SceneData, nodes: tuple[str, ...]) -> list[Fraction]:
    start, end = (scene.node(name).at for name in nodes)
    return [b.si - a.si for a, b in zip(start, end, strict=True)]


def _obstacles_have_directions(scene: SceneData) -> None:
    for i, obstacle in enumerate(scene.obstacles):
        for key in ("normal", "axis"):
            vector = getattr(obstacle, key)
            if vector is not None and not any(vector):
                raise SceneError(f"obstacles[{i}].{key} ({obstacle.name!r}): expected a direction, got the zero vector")


def _apart(scene: SceneData, where: str, nodes: tuple[str, ...]) -> None:
    first, second = (scene.node(name) for name in nodes)
    if first.name == second.name:
        raise SceneError(f"{where}: expected two different nodes, got {first.name!r} twice")
    if [x.si for x in first.at] == [x.si for x in second.at]:
        raise SceneError(
            f"{where}: expected nodes apart from each other, got zero length between {nodes[0]!r} and {nodes[1]!r}"
        )


def _known_unknown(key: str, name: str, scene: SceneData, unknowns: Unknowns) -> None:
    if name in unknowns.names:
        return
    node, _, axis = name.rpartition(".")
    if axis == ROTATION and node in scene.every_node:
        raise SceneError(f"{key}: node {node!r} has no rotation, since no beam ends there")
    raise SceneError(f"{key}: {unknown(name, unknowns.names, 'unknown')}")


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
    """In a row of lengths, displacements have numbers as factors and rotations lengths; a row of rotations, numbers."""
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
        if contact.obstacle is not None and contact.obstacle not in known:
            raise SceneError(
                f"contacts[{i}].obstacle ({contact.name!r}): {unknown(contact.obstacle, known, 'obstacle')}"
            )
        touched = {name for node in contact.touched for name in of_node(scene, node)}
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
        if line_load.string not in strings:
            raise SceneError(
                f"line_loads[{i}].string ({line_load.name!r}): {unknown(line_load.string, strings, 'string')}"
            )
    for name in {load.name for load in scene.loads}:
        _distinct(f"loads ({name!r})" if name else "loads", [x.unknown for x in scene.loads if x.name == name])
    weighs = scene.gravity is not None and any(bar.density is not None for bar in scene.bars)
    if scene.path is not None and not (scene.loads or scene.line_loads or scene.masses or weighs):
        raise SceneError("path: expected loads that grow along it, got none")


def _nothing_hangs(scene: SceneData, unknowns: Unknowns) -> None:
    """A free node that nothing holds or touches is a slip of the pen."""
    attached = {name for _, name in _node_uses(scene)}
    attached |= {name.rpartition(".")[0] for matrix in scene.matrices for name in matrix.unknowns}
    attached |= {term.unknown.rpartition(".")[0] for tie in scene.ties for term in tie.terms}
    for i, node in enumerate(scene.nodes):
        if node.name not in attached and not unknowns.fixed.issuperset(of_node(scene, node.name)):
            raise SceneError(
                f"nodes[{i}] ({node.name!r}): expected an element, tie or contact at this free node, got none"
            )
