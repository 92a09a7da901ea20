"""Pictures of bars and beams: the members, obstacles and labels that were drawn."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from contactqp.elements.members import beam_displacements
from contactqp.errors import InvalidProblem, Unsupported
from contactqp.pictures.frame_drawing import structure_figure
from contactqp.pictures.style import check_picture, save
from contactqp.study.answer_pictures import fields_of
from tests.shipped_cases import SCENES

pytest.importorskip("matplotlib")


def fields(case):
    scene = case if isinstance(case, cq.Scene) else SCENES[case]
    return fields_of(scene, cq.run(scene)[-1])


def lines(figure, gid):
    return [
        np.array(line.get_data_3d() if hasattr(line, "get_data_3d") else line.get_data()).T
        for line in figure.axes[0].get_lines()
        if line.get_gid() == gid
    ]


# Seconds to solve; there are others of their kinds.
LONG = ("cattaneo_mindlin_sphere", "cable_on_floor", "truss_dragged", "von_mises_snaps")


def _slow_if_long(name):
    return pytest.param(name, marks=pytest.mark.slow) if name in LONG else name


def test_the_fields_of_the_truss_on_the_floor():
    found = fields("truss_floor")
    assert found.axes == ("x", "z")
    assert found.nodes == ("1", "right", "left")
    np.testing.assert_allclose(found.position, [[0, 0], [3, 3], [-3, 4]])
    np.testing.assert_allclose(found.displacement[0], [59 * np.sqrt(2) / 274204 + 55807 / 68551000, -1e-3], rtol=1e-12)
    np.testing.assert_array_equal(found.displacement[1:], 0)
    assert found.held.tolist() == [[False, False], [True, True], [True, True]]
    assert [(member.kind, member.nodes) for member in found.members] == [("bar", (0, 1)), ("bar", (0, 2))]
    (contact,) = found.contacts
    assert contact.push.tolist() == [[0.0, 1.0]]
    assert contact.force == pytest.approx(64855 / 1399 - 15930 * np.sqrt(2) / 1399)
    assert (contact.initial_gap, contact.status) == (1e-3, "closed")
    assert abs(contact.gap) < 1e-15


def test_two_bodies_push_each_other_apart():
    (contact,) = fields("two_bars").contacts
    assert contact.push.tolist() == [[-1.0], [1.0]]
    assert contact.force == pytest.approx(95.0)


def test_the_picture_of_the_truss():
    figure = structure_figure(fields("truss_floor"), scale=100.0, title="Truss")
    assert figure.get_suptitle() == "Truss\nDisplacements magnified 100 times"
    (bars,), (undeformed,) = lines(figure, "bar"), lines(figure, "undeformed")
    foot = 100 * np.array([59 * np.sqrt(2) / 274204 + 55807 / 68551000, -1e-3])
    np.testing.assert_allclose(bars, [foot, [3, 3], [np.nan] * 2, foot, [-3, 4], [np.nan] * 2])
    np.testing.assert_allclose(undeformed[[0, 1, 4]], [[0, 0], [3, 3], [-3, 4]])
    (floor,) = lines(figure, "obstacle")
    np.testing.assert_allclose(floor[:, 1], foot[1])  # the closed contact lies on it
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "foot: closed, force 30.25 kN, gap 0 m" in labels
    assert "contact force, longest arrow 30.25 kN" in labels
    (arrow,) = [c for c in figure.axes[0].collections if c.get_gid() == "contact forces"]
    assert (arrow.U[0], arrow.V[0]) == (0.0, pytest.approx(0.14 * 6))
    assert (figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()) == ("x [m]", "z [m]")


def test_friction_is_an_arrow_on_the_scale_of_the_contact_force():
    figure = structure_figure(fields("truss_friction"), scale=100.0)
    drawn = {c.get_gid(): c for c in figure.axes[0].collections}
    push, rub = drawn["contact forces"], drawn["friction"]
    assert push.V[0] > 0
    assert (rub.U[0] / push.V[0], rub.V[0]) == (pytest.approx(-0.3), 0.0)  # against the slip to the right
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "friction, on the same scale, at most 8.774 kN" in labels


def test_the_load_of_the_truss_is_an_arrow_that_ends_at_its_foot():
    figure = structure_figure(fields("truss_floor"), scale=100.0)
    (arrow,) = [c for c in figure.axes[0].collections if c.get_gid() == "loads"]
    foot = 100 * np.array([59 * np.sqrt(2) / 274204 + 55807 / 68551000, -1e-3])
    np.testing.assert_allclose(arrow.get_offsets()[0] + [arrow.U[0], arrow.V[0]], foot)
    np.testing.assert_allclose([arrow.U[0], arrow.V[0]], 0.14 * 6 * np.array([0.6, -1.0]))  # 60 kN and -100 kN
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "load, in all 60 and -100 kN along x and z, longest arrow 116.6 kN" in labels


def of_loads(figure):
    """Return the entries of loads in the legends of a figure."""
    return [text.get_text() for legend in figure.legends for text in legend.get_texts() if "load" in text.get_text()]


@pytest.mark.parametrize(
    ("case", "said"),
    [("cantilever_stop", "0 and -20 kN along x and y"), ("string_over_floor", "0 and -2 N along x and z")],
)
def test_the_resultant_of_loads_has_the_part_that_supports_take_at_once(case, said):
    figure = structure_figure(fields(case))  # 10 kN/m on 2 m, half of it at the root; 1 N/m on 2 m, held at both ends
    assert [label.partition(", longest")[0] for label in of_loads(figure)] == [f"load, in all {said}"]


def test_the_resultant_of_a_part_of_the_load_has_that_part_at_supports_too():
    scene = SCENES["cantilever_stop"]
    problem = scene.problem()
    half = structure_figure(fields_of(scene, cq.solve(problem.replace(load=problem.load / 2))))
    assert of_loads(half)[0].startswith("load, in all 0 and -10 kN along x and y")
    other = structure_figure(fields_of(scene, cq.solve(problem.replace(load=[1.0, -1.0, 0.0]))))
    assert of_loads(other)[0].startswith("load, in all 1 and -1 kN along x and y")  # no part of the scene's load
    assert not of_loads(structure_figure(fields_of(scene, cq.solve(problem.replace(load=np.zeros(3))))))


@pytest.mark.parametrize(("axis", "across"), [("x", 1), ("z", 0)])
def test_a_bar_along_z_stands_upright(axis, across):
    scene = cq.Scene(
        title="bar", axes=[axis], nodes=[{"name": "a", "at": ["0 m"]}, {"name": "b", "at": ["2 m"]}],
        bars=[{"name": "bar", "nodes": ["a", "b"], "area": "1 m^2", "modulus": "8 Pa"}], fixed=["a"],
        obstacles=[{"name": "wall", "point": ["2.1 m"], "normal": [-1]}],
        contacts=[{"name": "tip", "node": "b", "obstacle": "wall"}], loads=[{"unknown": f"b.{axis}", "value": "1 N"}],
    )  # fmt: skip
    figure = structure_figure(fields_of(scene, cq.run(scene)[-1]))
    axes = figure.axes[0]
    (bar,), (wall,) = lines(figure, "bar"), lines(figure, "obstacle")
    assert abs(np.ptp(bar[:2, 1 - across])) == pytest.approx(2.1)
    assert np.ptp(bar[:2, across]) == 0
    assert np.ptp(wall[:, across]) > 0  # it lies across the bar,
    assert np.ptp(wall[:, 1 - across]) == 0
    assert wall[0, 1 - across] == pytest.approx(2.1)  # where that ends
    assert [axes.xaxis.get_visible(), axes.yaxis.get_visible()] == ([False, True] if axis == "z" else [True, False])
    assert (axes.get_ylabel() if axis == "z" else axes.get_xlabel()) == f"{axis} [m]"


def test_a_beam_is_drawn_as_its_cubic():
    """A cantilever under a force at its tip: v(s) = v(1) s^2 (3 - s) / 2, exact at every point."""
    scene = cq.Scene(
        title="cantilever", axes=["x", "y"],
        nodes=[{"name": "a", "at": ["0 m", "0 m"]}, {"name": "b", "at": ["0 m", "2 m"]}],
        beams=[{"name": "beam", "nodes": ["a", "b"], "area": "1 m^2", "inertia": "1 m^4", "modulus": "8 Pa"}],
        fixed=["a", "a.theta"], loads=[{"unknown": "b.x", "value": "0.3 N"}],
    )  # fmt: skip
    (bar,) = fields(scene).members
    s = bar.path[:, 1] / 2
    tip = 0.3 * 2**3 / (3 * 8)
    np.testing.assert_allclose(bar.displacement[:, 0], tip * s**2 * (3 - s) / 2, atol=1e-15)
    np.testing.assert_allclose(bar.displacement[:, 1], 0, atol=1e-15)
    wrong = beam_displacements([0.0, 0.0], [0.0, 2.0], np.array([0, 0, 0, tip, 0, 0.0]), s)
    assert np.abs(wrong[:, 0] - bar.displacement[:, 0]).max() > 0.1 * tip


@pytest.mark.slow
@pytest.mark.parametrize("case", [_slow_if_long(name) for name, scene in SCENES.items() if scene.bodies])
def test_every_case_of_bodies_has_fields_to_draw(case):
    scene = SCENES[case]
    if scene.path is not None:  # what there is to draw of its first corner there is of the others
        scene = scene.model_copy(update={"path": scene.path.model_copy(update={"corners": scene.path.corners[:1]})})
    solution = cq.run(scene)[-1]
    found = fields_of(scene, solution)
    assert [body.body.name for body in found.bodies] == [body.name for body in scene.bodies]
    assert [pairing.name for pairing in found.pairings] == [contact.name for contact in scene.contacts]
    total = sum(np.nansum(pairing.force) for pairing in found.pairings)
    assert total == pytest.approx(solution.normal_force.sum(), rel=1e-12)


def test_a_membrane_is_refused_by_name():
    scene = next(scene for scene in SCENES.values() if scene.membranes)
    with pytest.raises(Unsupported, match="a membrane has no stresses"):
        fields_of(scene, cq.run(scene)[-1])


@pytest.mark.sampled(68)
@pytest.mark.parametrize("case", [_slow_if_long(name) for name, scene in SCENES.items() if not scene.meshed])
def test_every_case_of_bars_has_a_picture_whose_labels_stand_free(case):
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    found = fields(case)
    figure = structure_figure(found)
    canvas = FigureCanvasAgg(figure)
    figure.draw_without_rendering()
    canvas.draw()
    renderer = canvas.get_renderer()
    legend = figure.legends[0].get_window_extent(renderer)
    shown = figure.axes[0].yaxis if found.upright else figure.axes[0].xaxis
    assert shown.label.get_window_extent(renderer).y0 > legend.y1
    assert figure.axes[0].get_lines()
    for line in figure.axes[0].get_lines():
        x = np.asarray(line.get_xdata(), dtype=float)
        low, high = figure.axes[0].get_xlim()
        assert np.nanmin(x) >= low
        assert np.nanmax(x) <= high


def tripod(gap="1 mm"):
    return cq.Scene(
        title="tripod", axes=["x", "y", "z"],
        nodes=[{"name": n, "at": [f"{x} m" for x in at]}
               for n, at in {"foot": (0, 0, 0), "a": (3, 0, 4), "b": (-2, 3, 4), "c": (-2, -3, 4)}.items()],
        bars=[{"name": n, "nodes": ["foot", n], "area": "15 cm^2", "modulus": "210 GPa"} for n in "abc"],
        fixed=["a", "b", "c"], obstacles=[{"name": "floor", "point": ["0 m", "0 m", f"-{gap}"], "normal": [0, 0, 1]}],
        contacts=[{"name": "foot", "node": "foot", "obstacle": "floor"}],
        loads=[{"unknown": "foot.z", "value": "-500 kN"}],
    )  # fmt: skip


def test_three_dimensions():
    figure = structure_figure(fields(tripod()), scale=100.0)
    (bars,) = lines(figure, "bar")
    np.testing.assert_allclose(bars[0, 2], -0.1)
    assert len(lines(figure, "obstacle")) == 2  # a cross
    assert figure.axes[0].get_zlabel() == "z [m]"


@pytest.mark.slow
def test_names_of_nodes_in_space_stand_in_front_of_obstacles_and_arrows():
    axes = structure_figure(fields("block_on_incline_sideways")).axes[0]
    axes.figure.canvas.draw()  # which sorts what is in space by its depth
    (name,) = (text for text in axes.texts if text.get_text().strip() == "block")
    assert name.get_zorder() > max(artist.get_zorder() for artist in (*axes.lines, *axes.collections))
    assert name.get_path_effects()


def test_an_obstacle_far_away_is_left_to_the_legend():
    figure = structure_figure(fields(tripod("3 m")), scale=100.0)
    assert lines(figure, "obstacle") == []
    bars = np.array([[3, 0, 4], [-2, 3, 4], [-2, -3, 4]], dtype=float)
    lengths = np.linalg.norm(bars, axis=1)
    K = sum(15e-4 * 210e9 / L**3 * np.outer(d, d) for d, L in zip(bars, lengths, strict=True))
    gap = 3 + np.linalg.solve(K, [0, 0, -500e3])[2]
    assert f"foot: open, force 0 N, gap {gap:.3f} m" in [text.get_text() for text in figure.legends[0].get_texts()]


@pytest.mark.slow
def test_the_file_is_written(tmp_path):
    save(structure_figure(fields("bar_wall")), check_picture(tmp_path / "case.pdf"))
    assert (tmp_path / "case.pdf").read_bytes().startswith(b"%PDF")


def test_what_cannot_be_drawn_is_refused(tmp_path):
    with pytest.raises(InvalidProblem, match=r"a.gif: expected a file name that ends in .png or .pdf or .svg"):
        check_picture(tmp_path / "a.gif")
    with pytest.raises(InvalidProblem, match="scale: expected a positive number, got -1"):
        structure_figure(fields("bar_wall"), scale=-1.0)
