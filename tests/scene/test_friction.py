"""Friction in scenes: its rows come with it and only with it, and what is asked of them is along the axes."""

import json

import numpy as np
import pytest
from rich.console import Console

import contactqp as cq
from contactqp.scene.building import build
from contactqp.scene.explaining import explain
from contactqp.scene.judging import Failure, Trial, judge, judge_all, trials
from contactqp.scene.printing import judgement_data, print_judgement
from contactqp.scene.scene import Scene

from .test_bodies import BLOCK, PRESSED

FLOOR = {"name": "floor", "point": ["0 m", "0 m"], "normal": [0, 1]}
# Springs of 100 N/m along both axes over a floor; 10 N down and 5 N to the right.
PAD = dict(
    title="a pad",
    axes=["x", "z"],
    nodes=[{"name": "1", "at": ["0 m", "0 m"]}],
    springs=[
        {"name": "a", "nodes": ["1"], "direction": [1, 0], "stiffness": "100 N/m"},
        {"name": "b", "nodes": ["1"], "direction": [0, 1], "stiffness": "100 N/m"},
    ],
    obstacles=[FLOOR],
    contacts=[{"name": "foot", "node": "1", "obstacle": "floor", "friction": 0.3}],
    loads=[{"unknown": "1.x", "value": "5 N"}, {"unknown": "1.z", "value": "-10 N"}],
)


def pad(**contact):
    return Scene(**PAD | {"contacts": [PAD["contacts"][0] | contact]})


def claim(quantity, value, **keys):
    return {"quantity": quantity, "value": value, "derivation": "by hand", "tolerance": 1e-12} | keys


def judged(scene, *expect):
    found = judge(Scene(**scene | {"expect": expect}), Trial()).expectations
    assert len(found) == len(expect) > 0
    return found


def tangential(scene):
    return {block.name: block for block in explain(scene).blocks}["tangential rows E_T, friction"]


def test_no_friction_no_rows():
    for friction in (None, 0, 0.0):
        scene = pad(friction=friction)
        assert scene.problem().tangent is None
        assert not tangential(scene).included
    assert tangential(pad()).reason.startswith("1 contact with friction, one row each")
    body = Scene(**PRESSED | {"contacts": [PRESSED["contacts"][0] | {"friction": 0}]})
    assert body.problem().tangent is None
    assert not tangential(body).included


def test_where_one_contact_has_friction_every_one_has_a_row_and_its_own_coefficient():
    wall = {"name": "wall", "point": ["1 m", "0 m"], "normal": [-1, 0]}
    contacts = [PAD["contacts"][0], {"name": "side", "node": "1", "obstacle": "wall"}]
    scene = Scene(**PAD | {"obstacles": [FLOOR, wall], "contacts": contacts})
    problem = scene.problem()
    assert problem.friction.tolist() == [0.3, 0.0]
    assert problem.tangent.toarray().tolist() == [[1, 0], [0, 1]]
    assert tangential(scene).reason.startswith("1 contact with friction of 2, one row each")


def test_two_nodes_slip_against_each_other():
    scene = Scene(
        title="two nodes", axes=["x", "z"],
        nodes=[{"name": "1", "at": ["0 m", "1 m"]}, {"name": "2", "at": ["0 m", "0 m"]}],
        fixed=["2.z"], springs=[{"name": n, "nodes": [n], "direction": [1, 0], "stiffness": "1 N/m"} for n in "12"],
        contacts=[{"name": "pair", "nodes": ["1", "2"], "friction": 0.5}],
        loads=[{"unknown": "1.x", "value": "1 N"}, {"unknown": "1.z", "value": "-4 N"}],
        expect=[claim("friction force", "0.5 N", at="pair", along="x"), claim("displacement", "0.5 m", at="2.x")],
    )  # fmt: skip
    row = scene.problem().tangent.toarray()[0]
    assert row.tolist() in ([1, 0, -1], [-1, 0, 1])
    assert judge(scene, Trial()).met, "they share the load: the lower is pushed along by what the upper does to it"


def test_in_space_a_contact_has_two_orthonormal_rows():
    scene = Scene(
        title="in space", axes=["x", "y", "z"], nodes=[{"name": "1", "at": ["0 m", "0 m", "0 m"]}],
        springs=[{"name": a, "nodes": ["1"], "direction": d, "stiffness": "1 N/m"} for a, d in zip(
            "xyz", np.eye(3, dtype=int).tolist(), strict=True)],
        obstacles=[{"name": "slope", "point": ["0 m"] * 3, "normal": [2, 3, 6]}],
        contacts=[{"name": "foot", "node": "1", "obstacle": "slope", "friction": 0.3}],
    )  # fmt: skip
    problem = scene.problem()
    tangent = problem.tangent.toarray()
    np.testing.assert_allclose(tangent @ tangent.T, np.eye(2), atol=1e-15)
    np.testing.assert_allclose(tangent @ [2 / 7, 3 / 7, 6 / 7], 0, atol=1e-15)
    assert tangential(scene).reason.startswith("1 contact with friction, two rows each")
    # The components along the axes do not depend on which two tangents were chosen.
    vector = build(scene).along_axes((tangent @ [1.0, 2.0, 3.0])[np.newaxis])[0]
    np.testing.assert_allclose(vector, np.array([1, 2, 3]) - 26 / 49 * np.array([2, 3, 6]), atol=1e-14)


def test_what_friction_does_is_told_along_the_axes_and_can_be_wrong():
    right = [
        claim("friction force", "3 N", at="foot", along="x"),
        claim("friction force", "0 N", at="foot", along="z", tolerance="1e-12 N"),
        claim("slip", "20 mm", at="foot", along="x"),
        claim("status", "slip", at="foot"),
        claim("spring force", "2 N", at="a"),
    ]
    assert all(row.ok for row in judged(PAD, *right))
    wrong = [claim("friction force", "-3 N", at="foot", along="x"), claim("slip", "-20 mm", at="foot", along="x")]
    assert not any(row.ok for row in judged(PAD, *wrong))


def test_a_fixed_unknown_feels_friction():
    held = PAD | {"fixed": ["2.x"], "nodes": [*PAD["nodes"], {"name": "2", "at": ["0 m", "-1 m"]}], "obstacles": []}
    held["contacts"] = [{"name": "foot", "nodes": ["1", "2"], "friction": 0.3}]
    held["springs"] = [*PAD["springs"], {"name": "c", "nodes": ["2"], "direction": [0, 1], "stiffness": "100 N/m"}]
    held["nodes"] = [{"name": "1", "at": ["0 m", "0 m"]}, {"name": "2", "at": ["0 m", "-1 um"]}]
    judgement = judge(Scene(**held, expect=[claim("reaction", "1 N", at="2.x")]), Trial())
    force = judgement.solution.normal_force[0]
    assert judgement.expectations[0].got == pytest.approx(-0.3 * force, rel=1e-12), "the support holds 2 back"


def test_slip_starts_at_its_origin():
    """5 N against a spring from 0 and friction: with the origin where the spring alone holds it, nothing is left."""
    solution = cq.run(pad(slip_origin=["50 mm", "7 mm"]))[-1]
    assert solution.problem.slip_origin.tolist() == [[0.05]]
    assert solution.contact_status.tolist() == ["stick"]
    assert solution.friction_force[0, 0] == pytest.approx(0, abs=1e-14)


SHEARED = PRESSED | {
    "contacts": [PRESSED["contacts"][0] | {"friction": 0.3}],
    "supports": [],
    "tractions": [{"name": "shear", "side": "block.top", "value": ["10 MPa", "0 MPa"]}],
}


def test_a_side_on_an_obstacle():
    """In balance: the floor takes what acts on the top; its couple tips the pressure and no more."""
    rows = judged(
        SHEARED,
        claim("friction resultant", "200 N", at="foot", along="x", tolerance=1e-9),
        claim("friction resultant", "0 N", at="foot", along="y", tolerance="1e-6 N"),
        claim("contact force", "2000 N", at="foot", tolerance=1e-9),
        claim("friction resultant", "-200 N", at="foot", along="x", tolerance=1e-9),
    )
    assert [row.ok for row in rows] == [True, True, True, False], rows
    model = build(Scene(**SHEARED))
    assert model.problem.tangent.shape == (model.problem.contacts, model.problem.dimension)
    assert {b.name: b for b in explain(model.scene).blocks}["tangential rows E_T, friction"].included


@pytest.mark.sampled(2)
@pytest.mark.parametrize("pairing", ["mortar", "node-to-segment"])
def test_a_side_on_a_side(pairing):
    shape = {key: value for key, value in BLOCK["shape"].items() if key != "grading"}
    lower = BLOCK | {"name": "lower", "shape": shape | {"corner": ["0 mm", "-1 mm"]}}
    scene = SHEARED | {
        "bodies": [BLOCK, lower],
        "obstacles": [],
        "contacts": [{"name": "foot", "sides": ["block.bottom", "lower.top"], "pairing": pairing, "friction": 0.3}],
        "supports": [{"name": a, "on": "lower.bottom", "axis": a} for a in "xy"],
    }
    rows = judged(
        scene,
        claim("friction resultant", "200 N", at="foot", along="x", tolerance=1e-8),
        claim("support force", "-200 N", at="x", tolerance=1e-8),
        claim("contact force", "2000 N", at="foot", tolerance=1e-8),
    )
    assert all(row.ok for row in rows), rows


def test_sticking_slipping_and_tractions_of_a_side():
    """Held by its flank, every node of a block that is pressed slips: the traction is mu times the pressure."""
    smooth = PRESSED | {"contacts": [PRESSED["contacts"][0] | {"friction": 0.3}]}
    smooth["supports"] = [{"name": "flank", "on": "block.left", "axis": "x", "value": "1 um"}]
    near = {"at": "foot", "near": ["2 mm", "0 mm"]}
    rows = judged(
        smooth,
        claim("sticking contacts", "0", at="foot", tolerance=0.5),
        claim("friction traction", "1 MPa", along="x", **near),
        claim("contact pressure", "1 MPa", **near),
        claim("stick half-width", "1 mm", **near),
        claim("friction resultant", "1 N", at="foot", along="x"),
        claim("support force", "1 N", at="flank"),
    )
    got = [row.got for row in rows]
    assert got[0] == 0
    assert got[1] == pytest.approx(0.3 * got[2], rel=1e-9)
    assert np.isnan(got[3])
    assert got[4] == pytest.approx(got[5], rel=1e-9)


# Pressed by 10 N, pushed with 5 N and let go: it slides from 3 N on, 20 mm far, and stays there.
PUSHED = PAD | {
    "loads": [
        {"name": "weight", "unknown": "1.z", "value": "-10 N"},
        {"name": "push", "unknown": "1.x", "value": "5 N"},
    ],
    "path": {"events": "exact", "corners": [{"weight": 1}, {"weight": 1, "push": 1}, {"weight": 1}]},
}


def test_along_a_path_with_friction():
    right = [
        claim("event load", "3 N", at="foot", along="1.x", event="slip"),
        claim("event time", "2", at="foot", event="stick"),
        claim("events", "3", at="foot"),
        claim("friction force", "3 N", at="foot", along="x", time=2),
        claim("displacement", "20 mm", at="1.x"),
        claim("friction force", "-2 N", at="foot", along="x"),
        claim("status", "stick", at="foot"),
        claim("dissipated energy", "3*0.02 J"),
        claim("dissipated energy", "0 J", time=1, tolerance="1e-15 J"),
        claim("work of the loads", "0.08 J"),
        claim("elastic energy", "0.02 J"),
        claim("displacement", "0 mm", at="1.x", time=1.6, tolerance="1e-15 m"),
    ]
    rows = judged(PUSHED, *right)
    assert all(row.ok for row in rows), [row for row in rows if not row.ok]
    wrong = [
        claim("event load", "5 N", at="foot", along="1.x", event="slip"),
        claim("friction force", "2 N", at="foot", along="x"),
        claim("dissipated energy", "0.02 J"),
        claim("displacement", "0 mm", at="1.x", tolerance="1e-15 m"),
    ]
    assert not any(row.ok for row in judged(PUSHED, *wrong))


@pytest.mark.slow
def test_with_friction_nothing_off_the_path_is_solved_for():
    """At time 2.2 the push is 4 N again. A solve from rest would give the 10 mm of the way out; it stands at 20 mm."""
    for path in (PUSHED["path"], {"steps": 4, "corners": PUSHED["path"]["corners"]}):
        with pytest.raises(
            cq.SceneError, match=r"displacement 1.x at time 11/5: expected a step of the load path, nearest"
        ):
            judged(PUSHED | {"path": path}, claim("displacement", "20 mm", at="1.x", time="2.2"))
    at_steps = PUSHED | {"path": {"steps": 10, "corners": PUSHED["path"]["corners"]}}
    (row,) = judged(at_steps, claim("displacement", "20 mm", at="1.x", time="2.2"))
    assert row.ok
    loads = [{"unknown": "1.x", "value": "1 N"}, {"unknown": "1.z", "value": "-10 N"}]
    together = PAD | {"path": {"events": "exact", "steps": 1}, "loads": loads}
    with pytest.raises(cq.SceneError, match="at load factor 1/3: expected a step of the load path, nearest: 0, 1"):
        judged(together, claim("normal force", "1 N", at="foot", load_factor="1/3"))


def test_a_path_by_the_penalty_method():
    """Springs of 100 N/m and 50 N/m: l_N = 10/3 N; the slider slides from 3 N on, 20 mm far under mu l_N = 1 N."""
    soft = {"method": "penalty", "penalty": "50 N/m"}
    right = [
        claim("normal force", "10/3 N", at="foot", **soft),
        claim("event load", "3 N", at="foot", along="1.x", event="slip", **soft),
        claim("displacement", "40 mm", at="1.x", time=2, **soft),
        claim("friction force", "1 N", at="foot", along="x", time=2, **soft),
        claim("displacement", "20/3 mm", at="1.x", **soft),
        claim("dissipated energy", "0.02 J", **soft),
    ]
    scene = Scene(**PUSHED | {"expect": right})
    (trial,) = trials(scene, "penalty")
    judgement = judge(scene, trial)
    assert judgement.met, [row for row in judgement.expectations if not row.ok]
    assert len(judgement.expectations) == len(right)
    assert not judgement.solution.certificate.passed
    ends = judgement.history.energies[-1]
    assert ends.work == pytest.approx(ends.elastic + ends.dissipated, rel=1e-13)


@pytest.mark.slow
def test_what_is_printed_of_steps_that_jump(capsys):
    """Klarbring's node with mu = 0.8 is pressed by 1 N and pushed: at 0.8 N it can neither stick nor slide on."""
    matrix = {"name": "K", "unknowns": ["1.x", "1.z"], "unit": "N/m", "rows": [[1, -2], [-2, 5]]}
    node = {name: value for name, value in PUSHED.items() if name != "springs"} | {
        "matrices": [matrix],
        "contacts": [PAD["contacts"][0] | {"friction": 0.8}],
        "loads": [
            {"name": "press", "unknown": "1.z", "value": "-1 N"},
            {"name": "push", "unknown": "1.x", "value": "2 N"},
        ],
        "path": {"steps": 4, "corners": [{"press": 1}, {"press": 1, "push": 1}]},
    }
    judgement = judge(Scene(**node), Trial())
    (note,) = [note for note in judgement_data(judgement)["notes"] if "jumps" in note]
    assert note.startswith("step to t = 1.5: it jumps; at t = 1.4: no continuation")
    print_judgement(Console(width=250), judgement)
    assert note in capsys.readouterr().out
    assert judgement_data(judge(Scene(**PUSHED), Trial()))["notes"] == []


def test_what_is_printed_of_a_path_with_friction(capsys):
    judgement = judge(Scene(**PUSHED), Trial())
    data = judgement_data(judgement)
    assert data["friction_force"]["foot"] == pytest.approx({"x": -2.0, "z": 0.0})
    assert data["energies"] == pytest.approx({"work": 0.08, "elastic": 0.02, "dissipated": 0.06})
    assert [event["kind"] for event in data["events"]] == ["closed", "slip", "stick"]
    json.dumps(data)
    print_judgement(Console(width=150), judgement)
    out = capsys.readouterr().out
    assert "friction x [N]" in out
    assert "dissipated 0.06 N*m" in out
    assert "time" in out
    smooth = judge(Scene(**PAD | {"contacts": [{"name": "foot", "node": "1", "obstacle": "floor"}]}), Trial())
    assert not {"friction_force", "energies"} & set(judgement_data(smooth))
    print_judgement(Console(width=150), smooth)
    assert "friction" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"contacts": [PAD["contacts"][0] | {"friction": -1}]}, r"contacts\[0\].friction \('foot'\): .*not negative"),
        (
            {"contacts": [{"name": "foot", "node": "1", "obstacle": "floor", "slip_origin": ["0 m", "0 m"]}]},
            "slip_origin: expected with friction between nodes",
        ),
        (
            {"contacts": [PAD["contacts"][0] | {"slip_origin": ["0 m"]}]},
            r"slip_origin \('foot'\): expected 2 components",
        ),
        (
            {"contacts": [PAD["contacts"][0] | {"slip_origin": ["0 m", "0 m"]}], "path": {"steps": 1}},
            r"contacts\[0\].slip_origin \('foot'\): expected none with a load path",
        ),
        ({"expect": [claim("friction force", "1 N", at="foot")]}, "expects 'along' naming the axis"),
        ({"expect": [claim("friction force", "1 N", at="foot", along="y")]}, "there is no axis 'y'"),
        (
            {
                "contacts": [{"name": "foot", "node": "1", "obstacle": "floor"}],
                "expect": [claim("friction force", "1 N", at="foot", along="x")],
            },
            "expects a contact with friction, 'foot' has none",
        ),
        (
            {"expect": [claim("slip", "1 m", at="foot", along="x")], "path": {"steps": 1}},
            r"'slip' expects no \[path\]",
        ),
        (
            {"expect": [claim("normal force", "1 N", at="foot", load_factor=0.5)]},
            r"expect\[0\].load_factor: expected none with friction and no load path: the answer depends on the way",
        ),
        ({"expect": [claim("dissipated energy", "1 J")]}, r"'dissipated energy' expects \[path\]"),
    ],
)
def test_friction_that_makes_no_sense_is_refused(changes, words):
    with pytest.raises(cq.SceneError, match=words):
        Scene(**PAD | changes)


# Klarbring's node between mu_c = 1/2 and mu: open, stuck or sliding.
THREE = dict(
    title="three answers",
    axes=["x", "z"],
    nodes=[{"name": "1", "at": ["0 m", "0 m"]}],
    matrices=[{"name": "K", "unknowns": ["1.x", "1.z"], "unit": "N/m", "rows": [[1, -2], [-2, 5]]}],
    obstacles=[FLOOR],
    contacts=[{"name": "foot", "node": "1", "obstacle": "floor", "friction": 0.8}],
    loads=[{"unknown": "1.x", "value": "0.65 N"}, {"unknown": "1.z", "value": "-1 N"}],
)


@pytest.mark.slow
def test_a_case_says_whether_there_are_other_answers():
    words = [{"quantity": "uniqueness", "value": word, "derivation": "by hand"} for word in
             ("one answer", "several answers", "forces not unique; several answers")]  # fmt: skip
    assert [row.ok for row in judged(THREE, *words)] == [False, True, False]
    assert [row.ok for row in judged(PAD, *words)] == [True, False, False]
    assert [row.ok for row in judged(SHEARED, *words)] == [True, False, False], "bodies too"
    frame = {"name": "frame", "at": ["0 m", "0 m"]}
    hung = THREE | {
        "nodes": [*THREE["nodes"], frame], "fixed": ["frame"], "matrices": [], "obstacles": [],
        "loads": [THREE["loads"][1]], "contacts": [
            {"name": str(side), "nodes": ["1", "frame"], "direction": [side, 0], "friction": 0.5} for side in (1, -1)
        ],
    }  # fmt: skip
    assert [row.ok for row in judged(hung, *words)] == [False, True, True], "each word must be said, not all that are"
    with pytest.raises(cq.SceneError, match=r"value: there is no uniqueness 'two answers'; nearest: 'one answer'"):
        judged(PAD, words[0] | {"value": "one answer; two answers"})
    smooth = PAD | {"contacts": [PAD["contacts"][0] | {"friction": 0}]}
    with pytest.raises(cq.SceneError, match=r"expect\[0\].quantity: 'uniqueness' expects a contact with friction"):
        judged(smooth, words[0])


@pytest.mark.sampled(3)
@pytest.mark.parametrize("method", ["active-set", "osqp", "lagrange-multiplier"])
def test_a_block_wedged_between_walls_too_close_for_it_is_refused(method):
    """Each wall is 0.1 m into it: friction or not, no displacement satisfies both."""
    walls = [{"name": n, "point": [f"{-0.1 * s} m", "0 m"], "normal": [-s, 0]} for n, s in (("left", -1), ("right", 1))]
    wedged = Scene(**PAD | {
        "obstacles": walls, "springs": [],
        "contacts": [{"name": w["name"], "node": "1", "obstacle": w["name"], "friction": 0.5} for w in walls],
        "expect": [claim("displacement", "1 m", at="1.x")],
    })  # fmt: skip
    assert wedged.problem().gap.tolist() == [-0.1, -0.1]
    (failure,) = judge_all(wedged, [method])
    assert isinstance(failure, Failure)
    assert not failure.met
    assert "left, right" in failure.message
    with pytest.raises(cq.NoEquilibrium, match="no displacement satisfies these constraints together: left, right"):
        cq.run(wedged, method)
