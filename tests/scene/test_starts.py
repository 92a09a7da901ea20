"""Contacts that start deep inside of what they touch, or are turned the wrong way, are told of; right ones are not."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.cli import main
from contactqp.elements.shapes import disc
from contactqp.elements.surface import Surface
from tests.shipped_cases import SCENES

LIES_DEEPER, SAME_WAY, DRAGGED = "the rest of its body lies deeper still", "face the same way", "will be dragged out"


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
        (1.7, -1, DRAGGED),
        (2.001, 1, LIES_DEEPER),
        (5.0, 1, LIES_DEEPER),
        (-0.1, 1, ""),  # a wall behind the bar, which its tip is far from
    ],
)
def test_a_node_and_a_wall(wall: float, normal: int, doubt: str) -> None:
    found = doubts_of(bar(wall, normal).problem)
    assert len(found) == bool(doubt)
    assert all(doubt in text and text.startswith("contacts[0] ('tip'): it starts ") for text in found)


@pytest.mark.parametrize(("direction", "doubt"), [((1.0,), ""), ((-1.0,), "dragged back")])
def test_two_nodes(direction: tuple[float], doubt: str) -> None:
    scene = cq.Scene(
        title="two", axes=["x"],
        nodes=[{"name": n, "at": [f"{x} m"]} for n, x in (("a", 0), ("b", 1), ("c", 1.5), ("d", 3))],
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


@pytest.mark.parametrize(
    ("height", "normal", "side", "doubt"),
    [
        (0.0, 1, "bottom", ""),
        (-0.01, 1, "bottom", ""),
        (0.01, 1, "bottom", ""),  # pressed in by a hundredth
        (0.5, 1, "bottom", DRAGGED),
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
        (cq.Plane(point=[0.0, -0.6], normal=[0.0, 1.0]), DRAGGED),
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


def test_of_bare_points_nothing_is_known_that_could_be_doubted() -> None:
    assert doubts_of(lambda: cq.pair([[0.0, -5.0]], cq.Plane(point=[0.0, 0.0], normal=[0.0, 1.0]))) == []


@pytest.mark.sampled(5)
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


@pytest.mark.parametrize("command", [["run"], ["explain", "--no-solve"]])
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
    assert said.startswith(f"contactqp: {reversed_wall}: contacts[0] ('tip'): it starts 0.001 inside 'wall'")
    assert len(said.splitlines()) == 1
    with pytest.raises(SystemExit) as end:
        main([*command, "--strict", str(REVERSED)])
    assert end.value.code == 0
    assert capfd.readouterr().err == ""


def test_a_strict_refusal_is_json_where_that_is_asked_for(
    reversed_wall: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["run", "--strict", "--json", str(reversed_wall)])
    assert json.loads(capfd.readouterr().out)["code"] == "start"
