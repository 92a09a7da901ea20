"""Contacts that start deep inside of what they touch, or are turned the wrong way, are told of; right ones are not."""

from __future__ import annotations

import json
import warnings
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.cli import main
from contactqp.elements.shapes import disc, rectangle
from contactqp.elements.surface import Surface
from contactqp.scene.judging import judge_all
from tests.shipped_cases import SCENES

LIES_DEEPER, SAME_WAY, DRAGGED = (
    "and all that it is joined to lies deeper still",
    "face the same way",
    "will be dragged out",
)


def doubts_of(make: Any) -> list[str]:
    """What `make` warns of."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        make()
    return [str(one.message) for one in caught if issubclass(one.category, cq.StartWarning)]


def bar(wall: float, normal: int) -> cq.Scene:
    return cq.Scene(
        title="bar", axes=["x"], nodes=[{"name": "a", "at": ["0 m"]}, {"name": "b", "at": ["2 m"]}],
        bars=[{"name": "bar", "nodes": ["a", "b"], "area": "1 m^2", "modulus": "8 Pa"}], fixed=["a"],
        obstacles=[{"name": "wall", "point": [f"{wall} m"], "normal": [normal]}],
        contacts=[{"name": "tip", "node": "b", "obstacle": "wall"}], loads=[{"unknown": "b.x", "value": "1 N"}],
    )  # fmt: skip


@pytest.mark.parametrize(
    ("wall", "normal", "doubt"),
    [
        (2.001, -1, ""),  # a gap
        (2.0, -1, ""),
        (1.999, -1, ""),  # an interference fit
        (1.7, -1, ""),
        (1.4, -1, DRAGGED),
        (2.001, 1, LIES_DEEPER),
        (5.0, 1, LIES_DEEPER),
        (2.0, 1, "on the surface of 'wall', and all that it is joined to lies inside"),
        (-0.1, 1, ""),  # a wall behind the bar, which its tip is far from
    ],
)
def test_a_node_and_a_wall(wall: float, normal: int, doubt: str) -> None:
    found = doubts_of(bar(wall, normal).problem)
    assert len(found) == bool(doubt)
    assert all(doubt in text and text.startswith("contacts[0] ('tip'): it starts ") for text in found)


def test_a_rope_round_a_post_lies_inside_of_its_tangent_planes_which_is_right() -> None:
    places = [(-4, -12), (-5, 0), (-3, 4), (3, 4), (5, 0), (4, -12)]
    normals = [(-1, 0), (-3, 5), (3, 5), (1, 0)]
    names = [f"{i}" for i in range(6)]
    scene = cq.Scene(
        title="rope", axes=["x", "y"],
        nodes=[{"name": n, "at": [f"{x} m", f"{y} m"]} for n, (x, y) in zip(names, places, strict=True)],
        bars=[{"name": a + b, "nodes": [a, b], "area": "1 m^2", "modulus": "8 Pa"}
              for a, b in pairwise(names)],
        fixed=["0", "5"],
        obstacles=[{"name": f"post {n}", "point": [f"{x} m", f"{y} m"], "normal": [a, b]}
                   for n, (x, y), (a, b) in zip(names[1:5], places[1:5], normals, strict=True)],
        contacts=[{"name": n, "node": n, "obstacle": f"post {n}"} for n in names[1:5]],
        loads=[{"unknown": "1.y", "value": "-1 N"}],
    )  # fmt: skip
    assert doubts_of(scene.problem) == []


@pytest.mark.parametrize("more", [{}, {"deformation": "large", "path": {"steps": 2}}])
@pytest.mark.parametrize(("normal", "load", "doubted"), [(1, -3, False), (1, 3, True), (-1, 3, False), (-1, -3, False)])
def test_planes_under_a_rope_are_doubted_where_none_of_them_ever_pushes(
    normal: int, load: int, doubted: bool, more: dict[str, Any]
) -> None:
    """A rope on the two flanks of a roof that is pulled off both: in a trough it would press onto them. Planes that it
    does not lie inside of, as of a ceiling, it may leave.
    """
    places = [(-2, -2), (-1, 0), (1, 0), (2, -2)]
    scene = cq.Scene(
        title="rope", axes=["x", "y"],
        nodes=[{"name": f"{i}", "at": [f"{x} m", f"{y} m"]} for i, (x, y) in enumerate(places)],
        bars=[{"name": f"b{i}", "nodes": [f"{i}", f"{i + 1}"], "area": "1 cm^2", "modulus": "1 GPa"} for i in range(3)],
        fixed=["0", "3"],
        obstacles=[{"name": "left", "point": ["-1 m", "0 m"], "normal": [-normal, 2 * normal]},
                   {"name": "right", "point": ["1 m", "0 m"], "normal": [normal, 2 * normal]}],
        contacts=[{"name": "1", "node": "1", "obstacle": "left"}, {"name": "2", "node": "2", "obstacle": "right"}],
        loads=[{"unknown": f"{i}.y", "value": f"{load} N"} for i in (1, 2)], **more,
    )  # fmt: skip
    assert doubts_of(scene.problem) == []
    found = doubts_of(lambda: cq.run(scene))
    assert [text.split(":")[0] for text in found] == [f"contacts[{i}] ('{i + 1}')" for i in range(2) if doubted]
    assert all("on the surface of" in text and "ends outside, and nothing has pushed it" in text for text in found)


@pytest.mark.parametrize(
    ("direction", "doubt"), [((1.0,), ""), ((-1.0,), "inside the other node, 33 % of the size of its body")]
)
def test_two_nodes(direction: tuple[float], doubt: str) -> None:
    scene = cq.Scene(
        title="two", axes=["x"],
        nodes=[{"name": n, "at": [f"{x} m"]} for n, x in (("a", 0), ("b", 1), ("c", 2), ("d", 3))],
        springs=[{"name": "l", "nodes": ["a", "b"], "stiffness": "1 N/m"},
                 {"name": "r", "nodes": ["c", "d"], "stiffness": "1 N/m"}],
        fixed=["a", "d"], contacts=[{"name": "tip", "nodes": ["b", "c"], "direction": list(direction)}],
    )  # fmt: skip
    found = doubts_of(scene.problem)
    assert len(found) == bool(doubt)
    assert all(doubt in text for text in found)


def block(height: float, normal: int, side: str = "bottom") -> cq.Scene:
    return cq.Scene(
        title="block", units={"length": "mm", "force": "N"}, axes=["x", "y"],
        obstacles=[{"name": "plane", "point": ["0 mm", f"{height} mm"], "normal": [0, normal]}],
        contacts=[{"name": "rest", "side": f"block.{side}", "obstacle": "plane", "overlap": "1 mm"}],
        supports=[{"name": "l", "on": "block.left", "axis": "x"}],
        tractions=[{"name": "press", "side": "block.top", "value": ["0 MPa", "-5 MPa"]}],
        bodies=[{"name": "block", "model": "plane-stress", "thickness": "1 mm", "modulus": "200 MPa", "poisson": 0.3,
                 "shape": {"kind": "rectangle", "element": "quad4", "size": ["2 mm", "1 mm"], "divisions": [4, 2]}}],
    )  # fmt: skip


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    ("height", "normal", "side", "doubt"),
    [
        (0.0, 1, "bottom", ""),
        (-0.01, 1, "bottom", ""),
        (0.01, 1, "bottom", ""),  # pressed in by a hundredth
        (0.6, 1, "bottom", DRAGGED),
        (0.0, -1, "bottom", SAME_WAY),
        (-0.01, -1, "bottom", SAME_WAY),
        (1.0, -1, "top", ""),  # a ceiling
        (1.0, 1, "top", SAME_WAY),
    ],
)
def test_a_side_and_a_plane(height: float, normal: int, side: str, doubt: str) -> None:
    found = doubts_of(block(height, normal, side).problem)
    assert len(found) == bool(doubt)
    assert all(doubt in text and "'plane'" in text for text in found)


@pytest.mark.parametrize(
    ("obstacle", "doubt"),
    [
        (cq.Plane(point=[0.0, -1.0], normal=[0.0, 1.0]), ""),
        (cq.Plane(point=[0.0, -1.0], normal=[0.0, -1.0]), DRAGGED),  # all of it is inside, the top most of all
        (cq.Plane(point=[0.0, -0.4], normal=[0.0, 1.0]), DRAGGED),
        (cq.Circle(centre=[0.0, 0.0], radius=1.001, inside=True), ""),
        (cq.Circle(centre=[0.0, -3.0], radius=2.0), ""),
    ],
)
def test_the_whole_boundary_of_a_disc_in_python(obstacle: Any, doubt: str) -> None:
    """Most of the boundary faces along the normal of a plane, far from it; what decides is where it touches."""
    mesh = disc(1.0, (4, 4))
    facets = mesh.facets_of(mesh.boundary)[0].nodes
    surface = Surface(mesh.points, facets, np.arange(mesh.points.size).reshape(-1, 2), name="disc.arc")
    found = doubts_of(lambda: cq.pair(surface, obstacle))
    assert len(found) == bool(doubt)
    assert all(text.startswith("disc.arc: ") and doubt in text for text in found)


def ring(inner: float, outer: float, parts: int = 48) -> Surface:
    """The hole of a ring about the origin, whose facets have the ring on their left."""
    angle = 2 * np.pi * np.arange(parts) / parts
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    points = np.concatenate([inner * circle, outer * circle])
    facets = np.array([((i + 1) % parts, i) for i in range(parts)])
    return Surface(points, facets, np.arange(points.size).reshape(-1, 2), name="ring.hole")


def bottom_of(width: float, height: float, corner: tuple[float, float], revolved: bool = False) -> Surface:
    mesh = rectangle(width, height, (4, 40), corner=corner)
    (side,) = mesh.facets_of(mesh.sides["bottom"])
    unknowns = np.arange(mesh.points.size).reshape(-1, 2)
    return Surface(mesh.points, side.nodes, unknowns, name="block.bottom", revolved=revolved)


def known_near_its_surface(points: np.ndarray) -> np.ndarray:
    """A floor whose distance is told up to 0.1 alone."""
    height = np.asarray(points)[:, 1] + 0.001
    return np.where(abs(height) < 0.1, height, np.nan)


@pytest.mark.parametrize(
    ("surface", "obstacle"),
    [
        (ring(1.0, 1.3), cq.Circle(centre=[0.0, 0.0], radius=1.001)),  # shrunk on a shaft
        (ring(1.0, 1.01), cq.Circle(centre=[0.0, 0.0], radius=1.0 + 1e-6)),
        (bottom_of(1.0, 20.0, (-0.5, 0.0)),
         cq.Paraboloid(apex=[0.0, 0.0], axis=[0.0, 1.0], radius=5.0, inside=True, measure="normal")),
        (bottom_of(1.0, 10.0, (0.0, -0.001)), cq.SignedDistance(known_near_its_surface, 2)),
    ],
)  # fmt: skip
def test_bodies_around_and_far_beyond_their_obstacle_are_not_doubted(surface: Surface, obstacle: Any) -> None:
    """What is doubted is told at the contacts: the middle of a ring is inside of its shaft."""
    assert doubts_of(lambda: cq.pair(surface, obstacle)) == []


def joined(nodes: dict[str, float], bars: list[tuple[str, str]], wall: float, normal: int) -> cq.Scene:
    return cq.Scene(
        title="bars", axes=["x"], nodes=[{"name": name, "at": [f"{x} m"]} for name, x in nodes.items()],
        bars=[{"name": f"{a}{b}", "nodes": [a, b], "area": "1 m^2", "modulus": "8 Pa"} for a, b in bars],
        fixed=["a"], obstacles=[{"name": "wall", "point": [f"{wall} m"], "normal": [normal]}],
        contacts=[{"name": "stop", "node": "b", "obstacle": "wall"}],
    )  # fmt: skip


@pytest.mark.parametrize(
    ("nodes", "bars", "wall", "normal", "doubt"),
    [
        (dict(a=0, b=1, c=10), [("a", "b"), ("b", "c")], 0.999, -1, ""),  # a collar in the middle of a bar
        (dict(a=0, b=1, c=1.1, d=9), [("a", "b"), ("c", "d")], 0.999, -1, ""),  # another bar behind the wall
        (dict(a=0, b=1, c=1.1, d=9), [("a", "b"), ("c", "d")], 1.001, 1, LIES_DEEPER),
    ],
)
def test_what_a_node_is_joined_to_decides(
    nodes: dict[str, float], bars: list[tuple[str, str]], wall: float, normal: int, doubt: str
) -> None:
    found = doubts_of(joined(nodes, bars, wall, normal).problem)
    assert len(found) == bool(doubt)
    assert all(doubt in text for text in found)


MATERIAL = cq.Material(modulus=1.0, poisson=0.3)


def two_blocks(overlap: float) -> cq.Structure:
    """An upper block whose bottom lies so deep inside of a wider one."""
    upper = rectangle(1.0, 0.5, (15, 8), corner=(0.0, -overlap))
    ground = rectangle(2.0, 0.5, (20, 5), corner=(-0.5, -0.5))
    meshes = {"upper": upper, "ground": ground}
    return cq.Structure([cq.Body(mesh, MATERIAL, "plane-strain", name=name) for name, mesh in meshes.items()])


@pytest.mark.sampled(3)
@pytest.mark.parametrize("pair", [cq.pair_mortar, cq.pair_node_to_segment])
@pytest.mark.parametrize("slave", ["bottom", "top"])
def test_two_bodies_deep_inside_of_each_other_or_face_to_back_are_refused(pair: Any, slave: str) -> None:
    """Half of the upper block is inside of the ground, or its top is paired with the top of the ground."""
    apart, inside = two_blocks(0.0), two_blocks(0.25)
    assert doubts_of(lambda: pair(apart.surface("upper", "bottom"), apart.surface("ground", "top"))) == []
    deep = r"0\.25 inside ground\.top .* at most 0\.00\d+, which 'overlap' can change"
    structure, words = (inside, deep) if slave == "bottom" else (apart, "face each other")
    with pytest.raises(cq.InvalidProblem, match=words):
        pair(structure.surface("upper", slave), structure.surface("ground", "top"))
    assert len(pair(inside.surface("upper", "bottom"), inside.surface("ground", "top"), overlap=0.3).gap)


@pytest.mark.parametrize("revolved", [True, False])
def test_the_size_of_a_rim_is_its_diameter(revolved: bool) -> None:
    """A section of 1 mm at a radius of 100 mm that overlaps by 0.5 mm: half of the section, 0.25 % of the diameter."""
    surface = bottom_of(1.0, 1.0, (100.0, 0.0), revolved)
    assert bool(doubts_of(lambda: cq.pair(surface, cq.Plane(point=[0.0, 0.5], normal=[0.0, 1.0])))) is not revolved


def test_of_bare_points_nothing_is_known_that_could_be_doubted() -> None:
    assert doubts_of(lambda: cq.pair([[0.0, -5.0]], cq.Plane(point=[0.0, 0.0], normal=[0.0, 1.0]))) == []


@pytest.mark.sampled(30)
@pytest.mark.parametrize("case", sorted(SCENES))
def test_no_case_that_comes_with_the_package_is_doubted(case: str) -> None:
    assert doubts_of(SCENES[case].problem) == []


REVERSED = Path(__file__).parents[2] / "cases" / "bar_wall.toml"


@pytest.fixture
def reversed_wall(tmp_path: Path) -> Path:
    text = REVERSED.read_text(encoding="utf-8")
    assert "normal = [-1]" in text
    file = tmp_path / "reversed.toml"
    file.write_text(text.replace("normal = [-1]", "normal = [1]"), encoding="utf-8")
    return file


@pytest.mark.sampled(2)
@pytest.mark.parametrize("command", [["explain", "--no-solve"], ["run"]])
def test_the_command_line_warns_once_and_refuses_with_strict(
    reversed_wall: Path, capfd: pytest.CaptureFixture[str], command: list[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main([*command, str(reversed_wall)])
    assert end.value.code == (1 if command == ["run"] else 0)  # what the case expects is not met
    said = capfd.readouterr().err
    assert said.count("contactqp: warning: ") == 1
    assert LIES_DEEPER in said
    with pytest.raises(SystemExit) as end:
        main([*command, "--strict", str(reversed_wall)])
    assert end.value.code == 2
    said = capfd.readouterr().err
    assert said.startswith(f"contactqp: {reversed_wall}: contacts[0] ('tip'): it starts 0.001 m inside 'wall'")
    assert len(said.splitlines()) == 1
    with pytest.raises(SystemExit) as end:
        main([*command, "--strict", str(REVERSED)])
    assert end.value.code == 0
    assert capfd.readouterr().err == ""


def beam_along_a_stop(height: float, normal: int, load: float = -20.0, **more: Any) -> cq.Scene:
    """A cantilever over or under a stop, which all of its nodes are as far from."""
    return cq.Scene(
        title="beam", axes=["x", "y"], units={"length": "m", "force": "kN"},
        nodes=[{"name": "root", "at": ["0 m", "0 m"]}, {"name": "end", "at": ["2 m", "0 m"]}],
        beams=[{"name": "b", "nodes": ["root", "end"],
                "area": "3e-3 m^2", "inertia": "2e-5 m^4", "modulus": "2e8 kPa"}],
        fixed=["root"], obstacles=[{"name": "stop", "point": ["2 m", f"{height} mm"], "normal": [0, normal]}],
        contacts=[{"name": "end on stop", "node": "end", "obstacle": "stop"}],
        loads=[{"unknown": "end.y", "value": f"{load} kN"}], **more,
    )  # fmt: skip


UNPUSHED = "it starts 0.003 m inside 'stop' and ends outside, and nothing has pushed it"
BY_STEPS = dict(path={"steps": 2})


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("height", "normal", "load", "more", "doubt"),
    [
        (-3.0, 1, -20.0, {}, ""),
        (-3.0, -1, -20.0, {}, UNPUSHED),
        (-3.0, -1, -20.0, BY_STEPS, ""),  # unloaded it is pushed off, which the events tell
        (3.0, 1, -20.0, {}, ""),  # a stop that bends it up before it is loaded
        (3.0, 1, 20.0, BY_STEPS, ""),  # it pushes at first, and the load lifts the end off
        (3.0, -1, 20.0, {}, ""),  # a ceiling
    ],
)
def test_a_beam_along_a_stop_is_doubted_where_nothing_has_pushed_it(
    height: float, normal: int, load: float, more: dict[str, Any], doubt: str
) -> None:
    scene = beam_along_a_stop(height, normal, load, **more)
    assert doubts_of(scene.problem) == []  # before it is solved nothing tells
    for run in (lambda: cq.run(scene), lambda: judge_all(scene)):
        found = doubts_of(run)
        assert len(found) == bool(doubt)
        assert all(text.startswith("contacts[0] ('end on stop'): ") and doubt in text for text in found)


def node_on_a_ramp(at: tuple[str, str]) -> cq.Scene:
    """A node on two springs, at the ramp -x + 3 z = 0 or near it, which a load pulls off."""
    springs = [
        {"name": name, "nodes": ["a"], "direction": along, "stiffness": "1 kN/m"}
        for name, along in (("across", [1, 0]), ("up", [0, 1]))
    ]
    return cq.Scene(
        title="ramp", axes=["x", "z"], nodes=[{"name": "a", "at": list(at)}], springs=springs,
        obstacles=[{"name": "ramp", "point": ["0 m", "0 m"], "normal": [-1, 3]}],
        contacts=[{"name": "c", "node": "a", "obstacle": "ramp"}], loads=[{"unknown": "a.z", "value": "100 N"}],
    )  # fmt: skip


def test_a_start_within_the_rounding_of_coordinates_is_not_inside() -> None:
    """A node on a ramp, 1.4e-17 m inside by the rounding of its coordinates, was said to start inside of it."""
    on_it = node_on_a_ramp(("0.30000000000000004 m", "0.1 m"))
    assert -1e-16 < on_it.problem().gap[0] < 0
    assert not doubts_of(lambda: cq.run(on_it))
    (doubt,) = doubts_of(lambda: cq.run(node_on_a_ramp(("0.300001 m", "0.1 m"))))
    assert "inside 'ramp' and ends outside" in doubt


def test_strict_refuses_a_stop_that_never_pushes(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    text = (REVERSED.parent / "cantilever_stop.toml").read_text(encoding="utf-8")
    assert "normal = [0, 1]" in text
    file = tmp_path / "beam.toml"
    file.write_text(text.replace("normal = [0, 1]", "normal = [0, -1]"), encoding="utf-8")
    for options, words in (([], "contactqp: warning: "), (["--strict"], "contactqp: ")):
        with pytest.raises(SystemExit) as end:
            main(["run", *options, str(file)])
        assert end.value.code == (2 if options else 1)
        said = capfd.readouterr().err
        assert said.startswith(f"{words}{file}: contacts[0] ('end on stop'): it starts 0.001 m inside 'stop'")
        assert len(said.splitlines()) == 1


def test_a_strict_refusal_is_json_where_that_is_asked_for(
    reversed_wall: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["run", "--strict", "--json", str(reversed_wall)])
    assert json.loads(capfd.readouterr().out)["code"] == "start"
