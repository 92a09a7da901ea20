"""What a case claims is held against the answer, and every kind of claim can fail."""

from pathlib import Path

import pytest

import contactqp as cq
from contactqp.scene.claims import QUANTITIES
from contactqp.scene.judging import Trial, judge, trials
from contactqp.scene.scene import Scene

from .test_building import WALL

CASES = Path(__file__).parents[2] / "cases"


def judged(*expect, published=(), trial=None, **changes):
    return judge(Scene(**WALL | changes, expect=expect, published=published), trial or Trial())


def expectation(quantity, value, **more):
    return {"quantity": quantity, "value": value, "derivation": "by hand"} | more


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        (expectation("displacement", "1 mm", at="1.x"), "1.000000001 mm"),
        (expectation("normal force", "285/2 kN", at="tip"), "-285/2 kN"),
        (expectation("gap", "0 m", at="tip", tolerance="1e-15 m"), "1e-14 m"),
        (expectation("status", "closed", at="tip"), "open"),
        (expectation("energy", "-177/800 kN*m"), "177/800 kN*m"),
        (expectation("reaction", "-315/2 kN", at="support.x"), "-142.5 kN"),
        (expectation("bar force", "157.5 kN", at="bar"), "-157.5 kN"),
        (expectation("stiffness", "157500 kN/m", at="1.x", along="1.x"), "157501 kN/m"),
        (expectation("displacement", "1/3150 m", at="1.x", load_factor="1/6"), "1 mm"),
        (expectation("tie rank", "0", tolerance="0.1"), "1"),
    ],
)
def test_an_expectation_is_met_or_not(right, wrong):
    met, not_met = judged(right, right | {"value": wrong}).expectations
    assert met.ok, met
    assert not not_met.ok, not_met


BY_LOADS = {"with_respect_to": "load factor"}
BY_GAP = {"with_respect_to": "gap", "of": "tip"}


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        (expectation("normal force", "-157500 kN/m", at="tip", **BY_GAP), "-157499.999 kN/m"),
        (expectation("normal force", "-157500 N/mm", at="tip", **BY_GAP), "157500 N/mm"),
        (expectation("displacement", "1", at="1.x", **BY_GAP), "0.999"),
        (expectation("energy", "-142.5 kN", **BY_GAP), "142.5 kN"),
        (expectation("normal force", "300 kN", at="tip", **BY_LOADS), "142.5 kN"),
        (expectation("total normal force", "1", with_respect_to="load", of="1.x"), "0.5"),
        (expectation("gap", "-1/525 m", at="tip", load_factor="1/6", **BY_LOADS), "1/525 m"),
        (expectation("next event load factor", "21/40", load_factor="1/6"), "1"),
    ],
)
def test_a_derivative_is_met_or_not(right, wrong):
    met, not_met = judged(right, right | {"value": wrong}).expectations
    assert met.ok, met
    assert not not_met.ok, not_met


def test_derivatives_that_a_scene_does_not_have():
    force = expectation("normal force", "1 kN/m", at="tip", **BY_GAP)
    for changes, message in (
        ({"value": "1 kN"}, r'expected a force per length such as "1 kN/m"'),
        ({"of": None}, "expects 'of' naming the contact"),
        ({"of": "top"}, r"expect\[0\].of: "),
        ({"with_respect_to": None}, "'of' expects 'with_respect_to'"),
        ({"with_respect_to": "friction", "value": "1 kN"}, "expected a contact with friction"),
        ({"with_respect_to": "mass"}, "with_respect_to"),
        ({"quantity": "bar force", "at": "bar"}, "expects no 'with_respect_to'; derivatives have"),
        ({"method": "penalty", "penalty": "1e8 kN/m"}, "expects no 'method'"),
    ):
        stated = {key: value for key, value in (force | changes).items() if value is not None}
        with pytest.raises(cq.SceneError, match=message):
            judged(stated)
    corners = {"path": {"corners": [{"push": 1}], "steps": 2}, "loads": [WALL["loads"][0] | {"name": "push"}]}
    with pytest.raises(cq.SceneError, match="expected no load factor, since the load path has corners"):
        judged(expectation("normal force", "1 kN", at="tip", **BY_LOADS), **corners)
    touching = expectation("normal force", "0 kN", at="tip", tolerance="1e-9 kN", load_factor="525/1024", **BY_LOADS)
    with pytest.raises(
        cq.SceneError, match="expected a derivative, and there is none: the two sides differ: tip grazes"
    ):
        judged(touching, obstacles=[WALL["obstacles"][0] | {"point": ["(2 + 1/1024) m"]}])  # g = 525/1024 P / K


def test_path_quantities():
    path = {"events": "exact"}
    rows = judged(
        expectation("closing load factor", "21/40", at="tip"),
        expectation("closing load", "157.5 kN", at="tip", along="1.x"),
        expectation("closing load", "157 kN", at="tip", along="1.x"),
        path=path,
    ).expectations
    assert [row.ok for row in rows] == [True, True, False]
    late = WALL["obstacles"][0] | {"point": ["3 m"]}
    with pytest.raises(cq.SceneError, match="expected contact 'tip' to close"):
        judged(expectation("closing load factor", "21/40", at="tip"), path=path, obstacles=[late])


@pytest.mark.parametrize(
    ("printed", "verdict", "holds"),
    [
        ("142.5 kN", "right", True),
        ("1.425e2 kN", "right", True),
        ("143 kN", "right", True),  # half a unit of its last digit
        ("142.4 kN", "right", False),
        ("142.4 kN", "wrong", True),
        ("142.5 kN", "wrong", False),
        ("-142.5 kN", "right", False),
    ],
)
def test_a_printed_number_is_right_to_its_last_digit(printed, verdict, holds):
    one = dict(quantity="normal force", at="tip", printed=printed, verdict=verdict, where="p. 1", why="by hand")
    (row,) = judged(published=[one]).published
    assert row.ok is holds


def test_a_matrix_that_is_off_by_one_entry_is_not_met():
    scene = cq.load_scene(CASES / "tie_symmetry.toml")
    (matrix,) = (claim for claim in scene.expect if claim.quantity == "tie matrix")
    data = {"quantity": "tie matrix", "unknowns": matrix.unknowns, "derivation": "flipped"}
    rows = [list(row) for row in matrix.rows]
    rows[2][3] = "1"
    changed = scene.model_copy(update={"expect": (type(matrix)(**data, rows=rows),)})
    assert not judge(changed, Trial()).expectations[0].ok
    fewer = scene.model_copy(update={"expect": (type(matrix)(**data, rows=rows[:2]),)})
    assert not judge(fewer, Trial()).met
    for nothing in ([], [[], []]):
        with pytest.raises(ValueError, match="at least 1 item"):
            type(matrix)(**data, rows=nothing)


def test_a_claim_about_a_method_is_for_that_method_and_knob_only():
    scene = cq.load_scene(CASES / "bar_wall.toml")
    soft = [trial for trial in trials(scene, "penalty") if str(trial.knobs["penalty"]) == "1e5 kN/m"]
    rows = judge(scene, soft[0]).expectations
    assert {row.quantity for row in rows} == {"displacement 1.x", "normal force tip"}
    assert all(row.ok for row in rows)
    exact = judge(scene, Trial("lagrange-multiplier")).expectations
    assert "energy" in {row.quantity for row in exact}
    assert not any(row.expected == rows[0].expected for row in exact)


def test_the_knobs_of_a_case_are_tried():
    scene = cq.load_scene(CASES / "bar_wall.toml")
    assert str(trials(scene)[0]) == "active-set"
    assert {trial.method for trial in trials(scene)} == {
        "active-set", "penalty", "perturbed-lagrangian", "augmented-lagrangian"
    }  # fmt: skip
    assert len(trials(scene, "penalty")) == 5
    assert [study.knob[0] for study in scene.study] == ["penalty", "perturbation", "penalty"]


def test_every_quantity_has_a_meaning_and_a_reader():
    from contactqp.scene.answers import READERS
    from contactqp.scene.blocks import element_quantities
    from contactqp.scene.body_answers import _READERS

    for of, readers in (("nodes", READERS | element_quantities()), ("bodies", _READERS)):
        assert set(readers) == {name for name, measure in QUANTITIES.items() if measure.of in (of, "both")}
    assert all(measure.meaning for measure in QUANTITIES.values())


def test_spring_forces_pull_or_push():
    rows = judged(
        expectation("spring force", "-0.1 kN", at="s", tolerance=1e-9),
        expectation("spring force", "0.1 kN", at="g", tolerance=1e-9),
        springs=[
            {"name": "g", "nodes": ["1"], "stiffness": "100 kN/m"},
            {"name": "s", "nodes": ["1", "post"], "stiffness": "100 kN/m"},
        ],
        nodes=[*WALL["nodes"], {"name": "post", "at": ["3 m"]}],
        fixed=["support", "post"],
    ).expectations
    assert [row.ok for row in rows] == [True, True], rows
