"""Pictures of load paths and motions: curves, units, and every event at its time, read back from the artists."""

from __future__ import annotations

import importlib.util
import itertools
import re
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.analysis.history import Event
from contactqp.pictures import history_drawing, style
from contactqp.pictures.history_drawing import history_figure
from contactqp.pictures.history_panels import history_fields, load_parts
from tests.analysis.motions import SPEED, rod_at_wall, thrown_rod

pytest.importorskip("matplotlib")
UNITS = {"length": "mm", "force": "N"}


def panel(figure, label):
    """The panel whose axis is called so, units left out."""
    (found,) = [axes for axes in figure.axes if axes.get_ylabel().split("\n")[0] == label]
    return found


def curve(axes, name):
    (line,) = [line for line in axes.get_lines() if line.get_gid() == name]
    return np.array(line.get_data(), dtype=float)


def marked(axes):
    """(kind, time) of every line of an event, by kind and time."""
    return [
        (artist.get_gid().removeprefix("event "), segment[0, 0])
        for artist in axes.collections
        if (artist.get_gid() or "").startswith("event ")
        for segment in artist.get_segments()
    ]


def labels(figure):
    return {text.get_position()[0]: text.get_text() for text in figure.axes[0].texts if text.get_gid() == "event label"}


def check_marks(figure, expected, panels):
    """The events of a picture against what must be there: in all time panels, and nothing else."""
    assert len(figure.axes) >= panels > 0
    for axes in figure.axes[:panels]:
        found = sorted(marked(axes))
        assert [kind for kind, _ in found] == sorted(kind for kind, _ in expected)
        np.testing.assert_allclose([t for _, t in found], [t for _, t in sorted(expected)], rtol=1e-9, atol=1e-12)
        for artist in axes.collections:
            for low, high in (segment[:, 1] for segment in artist.get_segments()):
                assert (low, high) == (0.0, 1.0)


def wall_path(**how):
    wall = cq.ContactProblem([[157500.0]], [0.0], [[1.0]], [1e-3], units=UNITS, contact_names=["tip"], dof_names=["u"])
    return cq.follow_path(wall, [[300.0]], **how)


@pytest.fixture(scope="module")
def jenkins():
    """A slider under 1 N, mu 0.3, behind 2 N/m, beside 1 N/m: its loop is known (Jenkin 1922, Iwan 1966)."""
    problem = cq.ContactProblem(
        stiffness=[[3.0, -2.0, 0.0], [-2.0, 2.0, 0.0], [0.0, 0.0, 0.0]],
        load=np.zeros(3),
        normal=[[0.0, 0.0, -1.0]],
        gap=[0.0],
        tangent=[[0.0, 1.0, 0.0]],
        friction=0.3,
        dof_names=["end", "slider", "down"],
        units={"length": "m", "force": "N"},
    )
    corners = [[force, 0.0, -1.0] for force in (0.0, 0.8, -0.8, 0.8)]
    return cq.follow_path(problem, corners, events="exact")


def test_a_bar_meets_the_wall_where_it_is_marked():
    figure = history_figure(wall_path(events="exact"), title="Bar")
    assert figure.get_suptitle() == "Bar\nLoad path: 3 instants, 1 event"
    assert [axes.get_ylabel() for axes in figure.axes] == [
        "displacement\n[mm]",
        "gap\n[mm]",
        "normal force\n[N]",
        "energy\n[N·mm]",
        "load factor",
    ]
    assert [figure.axes[i].get_xlabel() for i in (3, 4)] == ["load factor", "displacement [mm]"]
    check_marks(figure, [("closed", 0.525)], panels=4)
    ((time, text),) = labels(figure).items()
    assert (time, text) == (pytest.approx(0.525), "closed tip")
    np.testing.assert_allclose(curve(panel(figure, "gap"), "tip"), [[0, 0.525, 1], [1e-3, 0, 0]], atol=1e-15)
    np.testing.assert_allclose(curve(panel(figure, "normal force"), "tip")[1], [0, 0, 142.5], atol=1e-12)
    np.testing.assert_allclose(curve(panel(figure, "load factor"), "u"), [[0, 1e-3, 1e-3], [0, 0.525, 1]], atol=1e-15)
    point = curve(panel(figure, "load factor"), "event closed")
    np.testing.assert_allclose(point, [[1e-3], [0.525]], rtol=1e-12)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["closed (1)"]


RIGHT = Event("closed", 0, 0.525, "tip")
WRONG = {
    "late": [Event("closed", 0, 0.53, "tip")],
    "another kind": [Event("opened", 0, 0.525, "tip")],
    "none": [],
    "one too many": [RIGHT, Event("slip", 0, 1.0, "tip")],
}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("events", WRONG.values(), ids=WRONG)
def test_the_check_of_marks_refuses_wrong_ones(events):
    path = wall_path(events="exact")
    check_marks(history_figure(cq.History(list(path), path.times, lambda: [RIGHT])), [("closed", 0.525)], panels=4)
    with pytest.raises(AssertionError):
        check_marks(history_figure(cq.History(list(path), path.times, lambda: events)), [("closed", 0.525)], panels=4)


@pytest.mark.slow
def test_the_loop_of_jenkins(jenkins):
    figure = history_figure(jenkins)
    ends = [1.5625, 2.5625, 3.5625]  # slip at 0.45 N, -0.1 N and 0.1 N on ways of 0.8 N and 1.6 N
    check_marks(figure, [("closed", 0.0), *(("slip", t) for t in ends), ("stick", 2.0), ("stick", 3.0)], panels=5)
    loop = panel(figure, "load")
    assert loop.get_ylabel() == "load\n[N]"
    u = [0.0, 0.0, 0.15, 0.5, 0.2, -0.5, -0.2, 0.5]
    force = [0.0, 0.0, 0.45, 0.8, -0.1, -0.8, 0.1, 0.8]
    np.testing.assert_allclose(curve(loop, "end"), [u, force], atol=1e-12)
    np.testing.assert_allclose(curve(loop, "event slip"), [[0.15, 0.2, -0.2], [0.45, -0.1, 0.1]], atol=1e-12)
    np.testing.assert_allclose(
        curve(panel(figure, "friction force"), "contact 0")[1][2:], np.array([1, 1, -1, -1, 1, 1]) * 0.3
    )
    assert curve(panel(figure, "energy"), "dissipated")[1][-1] == pytest.approx(0.525)
    assert figure.axes[4].get_xlabel() == "pseudo-time [legs]"
    # What does not vary but by rounding is no mountain range.
    low, high = panel(figure, "gap").get_ylim()
    assert high - low > 1e-3


@pytest.fixture(scope="module")
def rod():
    return thrown_rod("moreau-jean")


@pytest.mark.slow
def test_a_thrown_rod(rod):
    history, step = rod
    figure = history_figure(history, time_unit="s")
    assert [axes.get_ylabel().replace("\n", " ") for axes in figure.axes] == [
        "displacement [length]",
        "velocity [length/s]",
        "gap [length]",
        "normal force [force]",
        "energy [force·length]",
    ]
    assert figure.axes[-1].get_xlabel() == "time [s]"
    np.testing.assert_array_equal(curve(panel(figure, "velocity"), "unknown 0")[1], history.velocities[:, 0])
    np.testing.assert_allclose(curve(panel(figure, "gap"), "contact 0")[1], 5.0 + history.displacements[:, 0])
    np.testing.assert_array_equal(curve(panel(figure, "normal force"), "contact 0")[1], history.normal_forces[:, 0])
    for name in ("kinetic", "elastic", "total", "impact"):
        drawn = curve(panel(figure, "energy"), name)
        np.testing.assert_array_equal(drawn, [history.times, [getattr(e, name) for e in history.energies]])
    check_marks(figure, [(event.kind, event.time) for event in history.events], panels=5)
    assert min(labels(figure)) == pytest.approx(0.5, abs=1.001 * step)


@pytest.mark.slow
def test_ten_thousand_steps_are_drawn_without_a_look_at_one(monkeypatch, rod):
    def refuse(*_):
        raise AssertionError("an instant was certified to be drawn")

    monkeypatch.setattr("contactqp.analysis.motion.motion_history._solution_at", refuse)
    problem, mass = rod_at_wall(4)
    history = cq.impact(problem, mass, np.zeros(5), np.full(5, -SPEED), 10.0, 1e-3)
    figure = history_figure(history)
    assert len(curve(panel(figure, "gap"), "contact 0")[0]) == 10_001
    history_figure(rod[0])


@pytest.mark.slow
def test_what_a_motion_was_until_it_failed_is_drawn(tmp_path, monkeypatch):
    from contactqp.analysis.motion import step_contact

    def gives_up(*_):
        raise cq.NotConverged("lemke: no")

    monkeypatch.setattr(step_contact, "normal_forces", gives_up)
    with pytest.raises(cq.NotConverged) as failed:
        thrown_rod("moreau-jean")
    figure = history_figure(failed.value.history)
    assert "Motion: 151 instants, no event" in figure.get_suptitle()
    assert curve(panel(figure, "displacement"), "unknown 0")[0][-1] == pytest.approx(0.5)
    cq.draw_history(failed.value.history, tmp_path / "failed.png")
    assert (tmp_path / "failed.png").exists()


@pytest.mark.slow
def test_a_motion_that_left_all_numbers_is_drawn_as_far_as_there_is_room(tmp_path):
    with pytest.raises(cq.NotConverged, match="left all numbers") as failed:
        thrown_rod("newmark", duration=2.0, load=lambda t: np.full(101, 1e306 * t))
    history = failed.value.history
    figure = history_figure(history)
    (remark,) = [text.get_text() for text in figure.axes[-1].texts if text.get_gid() == "remarks"]
    assert re.search(r"[1-9]\d* instants with values beyond 1e\+?300 are left out", remark)
    lines = [line for axes in figure.axes for line in axes.get_lines()]
    assert len(lines) > 2
    for line in lines:
        assert np.nanmax(abs(line.get_ydata())) <= 1e300
    cq.draw_history(history, tmp_path / "left.svg")
    assert (tmp_path / "left.svg").exists()


@pytest.mark.slow
def test_the_start_alone_is_a_point(rod):
    history, _ = rod
    first = cq.MotionHistory(replace(history.motion, states=history.motion.states[:1]), tuple, history._resume)
    figure = history_figure(first)
    (line,) = panel(figure, "gap").get_lines()
    assert line.get_marker() == "."
    assert "1 instant, no event" in figure.get_suptitle()


def test_a_path_that_failed_at_its_start_is_drawn_too():
    spring = cq.ContactProblem([[2.0]], [0.0], np.zeros((0, 1)), [])
    rest = cq.History([cq.solve(spring)], [0.0])
    figure = history_figure(rest)
    assert [axes.get_ylabel().split("\n")[0] for axes in figure.axes] == ["displacement"]
    np.testing.assert_array_equal(curve(figure.axes[0], "unknown 0"), [[0.0], [0.0]])


@pytest.mark.slow
def test_numbers_that_are_none_are_left_out(tmp_path, rod):
    history, _ = rod
    states = list(history.motion.states)
    states[-1] = replace(states[-1], displacement=np.full(101, np.inf), velocity=np.full(101, -1e305))
    cq.draw_history(
        cq.MotionHistory(replace(history.motion, states=states), tuple, history._resume), tmp_path / "blown.png"
    )
    assert (tmp_path / "blown.png").exists()


def row_of_stops(count, steps=40):
    """Nodes on springs of 1 that meet stops one after the other, at loads 1/count, 2/count, ..."""
    gap = (np.arange(count) + 1.0) / count
    problem = cq.ContactProblem(sp.eye(count), np.zeros(count), sp.eye(count), gap, units=UNITS)
    return cq.follow_path(problem, [np.ones(count)], steps=steps)


@pytest.mark.slow
def test_of_many_contacts_those_that_push_hardest_and_the_sum():
    history = row_of_stops(8)
    figure = history_figure(history)
    forces = panel(figure, "normal force")
    names = [line.get_gid() for line in forces.get_lines()]
    assert names == [*(f"contact {i}" for i in range(5)), "sum of all 8"]
    np.testing.assert_allclose(curve(forces, "sum of all 8")[1], history.normal_forces.sum(axis=1))
    gaps = np.array([solution.gap for solution in history])
    np.testing.assert_allclose(curve(panel(figure, "gap"), "smallest of all 8")[1], gaps.min(axis=1))
    # All unknowns under one load: over their mean displacement, whose product with the load is work.
    np.testing.assert_allclose(
        curve(panel(figure, "load factor"), "all loaded"), [history.displacements.mean(axis=1), history.times]
    )
    for axes in figure.axes:
        curves = [line for line in axes.get_lines() if not line.get_gid().startswith("event")]
        assert len({line.get_color() for line in curves}) == len(curves)


def test_each_colour_of_a_curve_has_dashes_of_its_own():
    assert len(set(style.LINE_COLOURS)) == len(style.LINE_COLOURS) == len(style.DASHES)
    assert len(set(style.DASHES)) == len(style.DASHES)
    looks = [history_drawing.KINDS[kind]["linestyle"] for kind in ("closed", "opened", "slip", "stick")]
    assert len(set(looks)) == 4


@pytest.mark.slow
def test_labels_of_many_events_stand_free_and_count_all():
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    history = row_of_stops(100, steps=60)
    figure = history_figure(history)
    figure.draw_without_rendering()
    renderer = FigureCanvasAgg(figure).get_renderer()
    texts = [text for text in figure.axes[0].texts if text.get_gid() == "event label"]
    boxes = sorted((text.get_window_extent(renderer) for text in texts), key=lambda box: box.x0)
    assert len(boxes) > 20
    assert all(left.x1 <= right.x0 for left, right in itertools.pairwise(boxes))
    assert len(history.events) == 99
    assert sum(label.events for label in history_drawing.labels(history.events, 1.0)) == 99
    (remark,) = [text.get_text() for text in figure.axes[-1].texts if text.get_gid() == "remarks"]
    hidden = sum(int(text.get_text().split("+ ")[1]) for text in texts)
    assert remark == f"{99 - hidden} of 99 events are named; + n: n more at that place"
    assert len(marked(figure.axes[0])) == len(np.unique([event.time for event in history.events]))


def test_loads_that_come_one_by_one():
    press, push = np.array([0.0, 2.0, 2.0]), np.array([1.0, 0.0, 0.5])
    amounts = np.array([[0, 0], [0.5, 0], [1, 0], [1, 1], [1, -1], [1, 0.25]])
    parts = load_parts(amounts @ [press, push])
    assert len(parts) == 2
    np.testing.assert_allclose(
        [part.amount[:, None] * part.pattern for part in parts],
        [np.outer(a, p) for a, p in zip(amounts.T, [press, push], strict=True)],
        atol=1e-14,
    )
    assert load_parts(np.random.default_rng(0).normal(size=(9, 5))) == ()


def test_loads_on_many_unknowns_are_drawn_with_their_work():
    """Springs of 1 and 2 under two loads on six unknowns: force over mean displacement, the area is the work."""
    stiffness = np.r_[1.0, 1, 1, 2, 2, 2]
    problem = cq.ContactProblem(np.diag(stiffness), np.zeros(6), np.zeros((0, 6)), np.zeros(0), units=UNITS)
    first, second = np.r_[1.0, 1, 1, 0, 0, 0], np.r_[0, 0, 0, 2.0, 2, 2]
    history = cq.follow_path(problem, [first, first + second], steps=4)
    axes = panel(history_figure(history), "load")
    one, two = curve(axes, "load 1, from 0 on"), curve(axes, "load 2, from 1 on")
    np.testing.assert_allclose(one[:, -1], [1.0, 3.0])
    np.testing.assert_allclose(two[:, -1], [1.0, 6.0])
    np.testing.assert_allclose(two[:, :5], 0.0, atol=1e-14)
    work = sum(float(np.sum((y[1:] + y[:-1]) * np.diff(x)) / 2) for x, y in (one, two))
    assert work == pytest.approx(history.energies[-1].work)


@pytest.mark.slow
def test_times_of_a_motion_have_their_unit_or_say_what_they_are_stated_in():
    drop = cq.ContactProblem(stiffness=[[0.0]], load=[-9.81], normal=[[-1.0]], gap=[1.0])
    fall = cq.impact(drop, mass=[1.0], displacement=[0.0], velocity=[0.0], duration=0.1, time_step=1e-2)
    labels = {axes.get_xlabel() for axes in history_figure(fall).axes}
    assert "time [as time_step]" in labels
    assert "time [s]" in {axes.get_xlabel() for axes in history_figure(fall, time_unit="s").axes}
    assert "time [as time_step]" in str(fall)
    assert "time [as time_step]" in fall.table().columns


def test_loads_that_go_back_keep_their_events_in_order():
    """An event at a load that is passed twice belongs to the pass that comes after the event before."""
    once = wall_path(steps=4)
    solutions, times = [once[i] for i in (0, 1, 2, 3, 2, 1, 2, 3, 4)], [0, 0.25, 0.5, 0.75, 0.5, 0.25, 0.5, 0.75, 1]
    events = (Event("closed", 0, 0.75), Event("opened", 0, 0.5), Event("closed", 0, 0.75))
    fields = history_fields(cq.History(solutions, times, lambda: events))
    assert fields.instants(events).tolist() == [3, 4, 7]


def test_notes_are_told():
    path = wall_path(steps=2)
    notes = ["it jumps at time 0.5 by $1", "second", "third", "fourth"]
    told = cq.History(list(path), path.times, notes=lambda: notes)
    (remark,) = [text.get_text() for text in history_figure(told).axes[-1].texts if text.get_gid() == "remarks"]
    assert remark.splitlines() == [
        r"note: it jumps at time 0.5 by \$1",
        "note: second",
        "note: third",
        "and 1 more in history.notes",
    ]


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".png", ".pdf", ".svg"])
def test_names_are_shown_as_they_are(tmp_path, suffix):
    names = dict(dof_names=["_u$a$"], contact_names=["$\\frac{$_tip"])
    problem = cq.ContactProblem([[1.0]], [0.0], [[1.0]], [0.5], **names)
    history = cq.follow_path(problem, [[1.0]], events="exact")
    figure = history_figure(history, title="10 $ a day, 20 $ a night")
    assert figure.get_suptitle().startswith("10 \\$ a day, 20 \\$ a night\n")
    assert labels(figure) == {0.5: "closed \\$\\frac{\\$_tip"}
    assert [text.get_text() for text in figure.axes[0].get_legend().get_texts()] == [" _u\\$a\\$"]
    file = tmp_path / f"names{suffix}"
    cq.draw_history(history, file, title="10 $ a day, 20 $ a night")
    assert list(tmp_path.iterdir()) == [file]


def test_what_cannot_be_drawn_is_refused(tmp_path, monkeypatch):
    path = wall_path(steps=2)
    with pytest.raises(cq.InvalidProblem, match=r"a.jpg: expected a file name that ends in .png or .pdf or .svg"):
        cq.draw_history(path, tmp_path / "a.jpg")
    with pytest.raises(cq.InvalidProblem, match="draw_history: history: expected a History"):
        cq.draw_history((1.0, 0.5), tmp_path / "a.png")  # the history of a method, not of a path
    with pytest.raises(cq.InvalidProblem, match="expected a history of one instant or more, got none"):
        cq.draw_history(cq.History([], []), tmp_path / "a.png")
    real = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *a: None if name == "matplotlib" else real(name, *a))
    with pytest.raises(cq.BackendMissing, match=r"drawing a.png needs matplotlib: pip install matplotlib"):
        cq.draw_history(path, tmp_path / "a.png")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_friction_in_space_is_drawn_by_its_size():
    pad = cq.ContactProblem(
        stiffness=np.diag([2.0, 2.0, 0.0]),
        load=np.zeros(3),
        normal=[[0.0, 0.0, -1.0]],
        gap=[0.0],
        tangent=[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        friction=0.3,
    )
    history = cq.follow_path(pad, [[0.0, 0.0, -1.0], [0.6, 0.8, -1.0]], steps=4)
    figure = history_figure(history)
    drawn = curve(panel(figure, "friction force, size"), "contact 0")[1]
    # Sticks up to 0.3 N, the load is 0.25, 0.5, 0.75, 1 N.
    np.testing.assert_allclose(drawn[4:], [0.0, 0.25, 0.3, 0.3, 0.3], atol=1e-9)
