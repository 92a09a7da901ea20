"""`explain` is read off the scene: what is in it is included, what is not is left out, with the reason."""

from pathlib import Path

import contactqp as cq
from contactqp.scene.explaining import explain

CASES = Path(__file__).parents[2] / "cases"


def blocks(case):
    return {block.name: block for block in explain(cq.load_scene(CASES / case)).blocks}


def test_the_wall_needs_almost_nothing():
    found = blocks("bar_wall.toml")
    assert {name for name, block in found.items() if block.included} == {
        "axial bars", "supports", "contact rows E_N u <= g", "exact rational numbers"
    }  # fmt: skip
    assert found["tangential rows E_T, friction"].reason == "no contact has friction"
    assert found["tie rows A u = b"].reason == "no ties"
    assert found["mass matrix"].reason.startswith("statics")
    assert found["Newton loop"].reason.startswith("linear")


def test_the_reasons_follow_the_scene():
    column = blocks("tie_column_solid.toml")
    assert column["tie rows A u = b"].reason == "4 ties"
    assert column["rotations"].included
    assert not column["contact rows E_N u <= g"].included
    assert blocks("bar_wall_path.toml")["load path"].reason.startswith("loads grow from nothing, 6 steps")
    assert blocks("truss_floor.toml")["exact rational numbers"].reason == "a length or a normal is irrational"


def test_constraints_are_written_out():
    assert explain(cq.load_scene(CASES / "two_bars.toml")).contacts == ("tips: u(1.x) - u(2.x) <= 0.001 m",)
    assert explain(cq.load_scene(CASES / "tie_beam_section.toml")).ties == (
        "top: u(A.x) - u(B.x) + 0.1 u(B.theta) = 0",
        "bottom: -u(B.x) - 0.1 u(B.theta) + u(C.x) = 0",
    )
