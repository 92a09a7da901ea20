"""Load paths with corners: what loads are multiplied by along them, the times that answers stand at, and refusals."""

from fractions import Fraction as F

import numpy as np
import pytest

import contactqp as cq
from contactqp.scene.building import build
from contactqp.scene.explaining import explain
from contactqp.scene.fields import no_such
from contactqp.scene.judging import Trial, judge
from contactqp.scene.scene import Scene
from contactqp.scene.schema import factors_at

from .test_bodies import PRESSED

# A stone of 1 kg that hangs on springs of 100 N/m a centimetre over a floor.
STONE = dict(
    title="a stone",
    axes=["x", "z"],
    gravity=["0 m/s^2", "-10 m/s^2"],
    nodes=[{"name": "1", "at": ["0 m", "0 m"]}],
    springs=[
        {"name": "a", "nodes": ["1"], "direction": [1, 0], "stiffness": "100 N/m"},
        {"name": "b", "nodes": ["1"], "direction": [0, 1], "stiffness": "100 N/m"},
    ],
    masses=[{"name": "stone", "node": "1", "mass": "1 kg"}],
    obstacles=[{"name": "floor", "point": ["0 m", "-1 cm"], "normal": [0, 1]}],
    contacts=[{"name": "foot", "node": "1", "obstacle": "floor"}],
    loads=[
        {"name": "push", "unknown": "1.x", "value": "4 N"},
        {"name": "lift", "unknown": "1.x", "value": "1 N"},
        {"name": "lift", "unknown": "1.z", "value": "20 N"},
    ],
    path={"steps": 4, "corners": [{"gravity": 1}, {"gravity": 1, "push": "1/2"}, {"gravity": 1, "push": 1, "lift": 1}]},
)


def claim(quantity, value, **keys):
    return {"quantity": quantity, "value": value, "derivation": "by hand", "tolerance": 1e-12} | keys


def changed(**changes):
    return Scene(**STONE | changes)


def test_factors_are_linear_between_corners_and_zero_where_they_are_not_named():
    scene = changed()
    for time, expected in (
        (F(0), (0, 0, 0)),
        (F(1, 2), (F(1, 2), 0, 0)),
        (F(1), (1, 0, 0)),
        (F(3, 2), (1, F(1, 4), 0)),
        (F(9, 4), (1, F(5, 8), F(1, 4))),
        (F(3), (1, 1, 1)),
    ):
        factors = factors_at(scene, time)
        assert tuple(factors.of(name) for name in ("gravity", "push", "lift")) == expected
    assert build(scene).exact_load_at(F(9, 4)) == {"1.x": F(5, 2) + F(1, 4), "1.z": -10 + F(20, 4)}
    assert build(scene).exact.load == {"1.x": 5, "1.z": 10}, "the problem's own load is the one at the end"


def test_the_path_goes_from_corner_to_corner():
    history = cq.run(changed())
    assert history.times.tolist() == [i / 4 for i in range(13)]
    np.testing.assert_allclose(history.displacements[4], [0, -0.01], atol=1e-15)
    np.testing.assert_allclose(history.displacements[-1], [0.05, 0.1], rtol=1e-14)
    assert history.normal_forces[4, 0] == pytest.approx(9)


@pytest.mark.slow
def test_answers_at_a_time():
    right = [
        claim("normal force", "9 N", at="foot", time=1),
        claim("spring force", "-2 N", at="a", time=2),
        claim("status", "open", at="foot"),
        claim("displacement", "3.5/100 m", at="1.x", time=2.5),
        claim("normal force", "4 N", at="foot", time="9/4"),
        claim("displacement", "0.032 m", at="1.x", time=2.4),  # no step: without friction it is solved for
        claim("displacement", "0 m", at="1.x", time=0, tolerance="1e-15 m"),
        claim("elastic energy", "1/200 J", time=1),
    ]
    right[1]["value"] = "2 N"
    for wanted in right:
        (row,) = judge(changed(expect=[wanted]), Trial()).expectations
        assert row.ok, row
    wrong = [claim("normal force", "9 N", at="foot", time=2.25), claim("elastic energy", "1/100 J", time=1)]
    assert not any(row.ok for row in judge(changed(expect=wrong), Trial()).expectations)
    assert str(changed(expect=right).expect[4]) == "normal force foot at time 9/4"


def test_events_of_a_path_with_corners():
    path = STONE["path"] | {"events": "exact"}
    expect = [
        claim("event time", "1/10", at="foot", event="closed"),
        claim("event load", "-1 N", at="foot", along="1.z", event="closed"),
        claim("event time", "2 + 9/20", at="foot", event="opened"),
        claim("events", "2", at="foot"),
    ]
    found = judge(changed(path=path, expect=expect), Trial()).expectations
    assert len(found) == len(expect)
    assert all(row.ok for row in found)
    again = claim("event time", "1", at="foot", event="closed", occurrence=2)
    with pytest.raises(
        cq.SceneError, match=r"to close 2 times on the load path; its events: closed at 0.1, opened at 2.45"
    ):
        judge(changed(path=path, expect=[again]), Trial())


def test_energy_is_asked_at_a_step():
    with pytest.raises(cq.SceneError, match="elastic energy at time 12/5: expected a step of the load path"):
        judge(changed(expect=[claim("elastic energy", "1 J", time=2.4)]), Trial())


def test_bodies_have_named_loads_too():
    corners = [{"press": 1}, {"press": "1/2", "gravity": 1}]
    data = PRESSED | {"gravity": ["0 m/s^2", "-9.81 m/s^2"], "path": {"steps": 1, "corners": corners}}
    weight = F(7850) * F(981, 100) * F(2, 10**6) / 100  # 2 mm^2 times 10 mm
    expect = [
        claim("contact force", "2000 N", at="foot", tolerance=1e-10, time=1),
        claim("contact force", f"1000 + {weight} N", at="foot", tolerance=1e-10),
    ]
    judgement = judge(Scene(**data, expect=expect), Trial())
    assert judgement.met, judgement.expectations


def test_explain_names_the_loads():
    (block,) = (block for block in explain(changed()).blocks if block.name == "load path")
    assert block.reason.startswith("from nothing to 3 corners of the loads push, lift, gravity, each leg with 4 steps")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"path": {"corners": []}}, "path.corners: expected at least 1, got 0"),
        (
            {"path": {"corners": [{"gravity": 1, "push": 1}, {"gravity": 1, "lfit": 1}]}},
            r"path.corners\[1\]: there is no load 'lfit'; nearest: 'lift'",
        ),
        ({"path": {"corners": [{"gravity": 1, "push": 1}]}}, r"'lift' \(loads\[1\]\) is in none"),
        (
            {"path": {"corners": [{"gravity": 1, "push": "1 N", "lift": 1}]}},
            r"path.corners\[0\].push: expected a number",
        ),
        ({"path": {"corners": 3}}, "path.corners: expected a list, got"),
        ({"path": {"corners": [3]}}, r"path.corners\[0\]: expected a table, got"),
        (
            {"loads": [{"unknown": "1.x", "value": "4 N"}]},
            r"loads\[0\].name: expected, since the load path has corners, and missing",
        ),
        (
            {"loads": [*STONE["loads"], {"name": "push", "unknown": "1.x", "value": "1 N"}]},
            r"loads \('push'\): expected distinct unknowns, got '1.x' twice",
        ),
        (
            {"expect": [claim("gap", "1 m", at="foot", load_factor=0.5)]},
            "load_factor: expected 'time', since the load path",
        ),
        (
            {"expect": [claim("gap", "1 m", at="foot", time=4)]},
            "time: expected one from 0 to 3, the end of the path, got 4",
        ),
        ({"expect": [claim("gap", "1 m", at="foot", time=-1)]}, "time: expected one from 0 to 3"),
        ({"expect": [claim("stiffness", "1 N/m", at="1.x", along="1.x", time=1)]}, "'stiffness' depends on no time"),
        ({"expect": [claim("events", "1", at="foot", time=1)]}, "'events' depends on no time"),
        (
            {"expect": [claim("closing load factor", "1", at="foot")]},
            "expected 'event time' with event = 'closed', since the load path has corners",
        ),
        ({"expect": [claim("event time", "1", at="foot")]}, "'event time' expects 'event' of the contact"),
        ({"expect": [claim("event time", "1", at="foot", event="slide")]}, "event: expected 'closed'"),
        ({"expect": [claim("gap", "1 m", at="foot", occurrence=2)]}, "'gap' expects no 'occurrence'"),
        (
            {"expect": [claim("gap", "1 m", at="foot", time=1, load_factor=0.5)]},
            "expected 'time' or 'load_factor', got both",
        ),
        ({"expect": [claim("gap", "1 m", at="foot", time=1)], "path": None}, r"time: expected \[path\]"),
    ],
)
def test_corners_that_make_no_sense_are_refused(changes, words):
    with pytest.raises(cq.SceneError, match=words):
        Scene(**STONE | changes)


def test_of_many_names_a_message_lists_as_many_as_a_line_holds() -> None:
    few = no_such("q", ["tip", "foot"], "node")
    assert few == "there is no node 'q'; known: 'foot', 'tip'"
    many = no_such("q", [f"node number {i}" for i in range(500)], "node")
    assert len(many) < 600
    assert many.endswith("more")
    assert int(many.split(" and ")[1].split()[0]) == 500 - many.count("'node number")
    assert len(no_such("q", ["x" * 5000], "node")) < 200
    assert no_such("q", [], "node") == "there is no node 'q'; known: none"
