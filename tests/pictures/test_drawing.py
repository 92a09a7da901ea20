"""Pictures of elastic bodies: what was drawn, read back from the artists and not from pixels."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import contactqp as cq
from contactqp.elements.reference_elements import REFERENCES, Block
from contactqp.elements.structure import Support
from contactqp.errors import BackendMissing, InvalidProblem
from contactqp.pictures.contact_fields import contact_fields
from contactqp.pictures.drawing import contact_zone, figure, segments, triangles
from contactqp.pictures.space_drawing import facets, fans, sharp_edges, surface
from contactqp.pictures.style import (
    MARKERS,
    arrows_to_draw,
    check_picture,
    edge_points,
    edges,
    magnification,
    outline_points,
    pieces,
    sample,
    save,
)
from tests.elements.bodies import PLANE, SOLID, distorted
from tests.pictures.examples import MODULUS, PRESSURE, block, cube, solved, stack, unloaded, with_friction

pytest.importorskip("matplotlib")


def area(points: np.ndarray, corners: np.ndarray) -> float:
    a, b, c = (points[corners[:, i]] for i in range(3))
    return float(0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum())


@pytest.mark.parametrize("kind", PLANE)
def test_the_small_triangles_fill_the_elements(kind):
    """On straight edges exactly; curved ones to the error of six chords, 1/36 of what the chord leaves out."""
    mesh = distorted(kind)
    total = 0.0
    for block_ in mesh.blocks:
        parts = pieces(block_.kind, 6)
        x = sample(block_, mesh.points, parts.points)
        total += sum(area(element, parts.triangles) for element in x)
    quadratic = len(REFERENCES[kind].nodes) > REFERENCES[kind].corners
    assert np.isclose(total, mesh.volume(), rtol=2e-4 if quadratic else 1e-12)


@pytest.mark.parametrize("kind", PLANE)
def test_every_edge_is_there_once(kind):
    mesh = distorted(kind)
    found = sum(len(b) for b in edges(mesh))
    corners = len({int(n) for b in mesh.blocks for n in b.nodes[:, : b.kind.corners].ravel()})
    assert corners - found + mesh.elements == 1  # Euler


@pytest.mark.parametrize("scale", [1.0, 7.0])
@pytest.mark.parametrize("kind", ["quad4", "tri6"])
def test_positions_and_values_are_those_of_the_fields(kind, scale):
    fields = block(kind).fields
    strain = PRESSURE / MODULUS
    drawn = triangles(fields, scale)
    undeformed = drawn.points / (1 + scale * strain * np.array([0.25, -1.0]))
    assert np.isclose(area(undeformed, drawn.triangles), 2.0, rtol=1e-12)
    exact = np.hypot(*(strain * np.array([0.25, -1.0]) * undeformed).T)
    np.testing.assert_allclose(drawn.values, exact, atol=1e-14)


@pytest.mark.slow
def test_friction_tilts_the_arrows_and_not_the_pressure():
    found = block()
    solution = with_friction(found.solution, 0.5 * found.solution.normal_force[:, None])
    result = figure(contact_fields(found.system, found.pairings, solution), scale=10.0)
    drawn = {artist.get_gid(): artist for artist in result.axes[0].collections}
    arrows, plain = drawn["pressure arrows"], drawn["pressure"].get_paths()
    np.testing.assert_allclose(arrows.V, 0.14 * 2, rtol=1e-9)
    np.testing.assert_allclose(arrows.U, -0.5 * arrows.V, rtol=1e-9)
    assert plain
    assert all(np.ptp(path.vertices[[0, 3, 4], 0]) <= 1e-12 for path in plain)  # the side from the surface is upright
    labels = [text.get_text() for text in result.legends[0].get_texts()]
    assert "contact pressure, at most 3 N/mm², friction tilts arrows" in labels


def test_the_map_of_a_pairing_in_space_has_arrows_of_friction():
    found = cube("hex8")
    friction = found.solution.normal_force[:, None] * [0.3, -0.4]
    fields = contact_fields(found.system, found.pairings, with_friction(found.solution, friction))
    (arrows,) = [c for axes in figure(fields).axes for c in axes.collections if c.get_gid() == "friction"]
    along = fields.pairings[0].friction[:, :2] / np.linalg.norm(fields.pairings[0].friction, axis=1, keepdims=True)
    np.testing.assert_allclose(np.stack([arrows.U, arrows.V], axis=1) / np.hypot(arrows.U, arrows.V)[:, None], along)


@pytest.mark.slow
def test_the_legend_of_a_flat_map_covers_neither_the_name_of_its_axis_nor_the_scale_of_colours():
    body = cq.Body(cq.box((40.0, 20.0, 10.0), (4, 2, 1)), cq.Material(modulus=1.0, poisson=0.3), "3d", name="block")
    structure = cq.Structure([body])
    held = [cq.Support("block", "top", axis, value) for axis, value in zip("xyz", (0.01, 0.0, -0.01), strict=True)]
    floor = cq.pair(structure.surface("block", "bottom"), cq.Plane([0.0, 0.0, 0.0], [0.0, 0.0, 1.0]))
    drawn = cq.draw(cq.solve(structure.assemble(held).problem([floor], friction=0.3)))
    for _ in range(2):  # the first layout does not have the ticks yet
        drawn.draw_without_rendering()
    with_legends = [axes for axes in drawn.axes if axes.get_legend() is not None]
    (shown,) = (axes for axes in with_legends if "friction, at most" in str(axes.get_legend().texts))
    legend = shown.get_legend().get_window_extent()
    assert not legend.overlaps(shown.xaxis.label.get_window_extent())
    scales = [axes for axes in drawn.axes if axes.get_ylabel().startswith("contact pressure")]
    assert scales
    assert not any(legend.overlaps(axes.get_window_extent()) for axes in scales)


def test_bodies_that_overlapped_and_press_are_drawn_without_a_gap_between_them():
    """An interference of 1 % of the size, pushed apart: magnified as it would be without, it were a gap."""
    moved, size = np.array([[0.0, 0.01]]), 1.0
    assert magnification(None, size, moved, np.array([1.0]), np.array([1.0])) > 2.0
    scale = magnification(None, size, moved, np.array([-0.01]), np.array([0.0]))
    assert abs(-0.01 + scale * 0.01) <= 0.002 * size


def test_the_picture_of_two_bodies():
    fields = stack().fields
    result = figure(fields, scale=10.0, title="Two blocks")
    axes, bar = result.axes
    assert result.get_suptitle() == "Two blocks\nDisplacements magnified 10 times"
    assert bar.get_ylabel() == "displacement, magnitude [mm]"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [mm]", "y [mm]")
    assert axes.get_aspect() == 1
    drawn = {artist.get_gid(): artist for artist in axes.collections}
    undeformed = [artist for artist in axes.collections if artist.get_gid() == "undeformed"]
    outline = np.concatenate([np.concatenate(artist.get_segments()) for artist in undeformed])
    np.testing.assert_allclose([outline.min(axis=0), outline.max(axis=0)], [[0, 0], [2, 2]])
    points = np.concatenate([p.position + 10 * p.displacement for p in fields.pairings])
    np.testing.assert_allclose(drawn["closed"].get_offsets(), points)
    arrows = drawn["pressure arrows"]
    np.testing.assert_allclose(np.hypot(arrows.U, arrows.V), 0.14 * 2, rtol=1e-9)
    assert (arrows.V > 0).all()
    heads = arrows.get_offsets() + np.stack([arrows.U, arrows.V], axis=1)
    np.testing.assert_allclose(heads, points[-len(heads) :], atol=1e-12)
    labels = [text.get_text() for text in result.legends[0].get_texts()]
    assert labels == [
        "undeformed",
        "rigid obstacle",
        "contact pressure, at most 3 N/mm²",
        "load, in all 0 and -6 N along x and y, longest arrow 2 N",
        "closed (9)",
    ]
    loads = drawn["loads"]
    ends = loads.get_offsets() + np.stack([loads.U, loads.V], axis=1)
    upper = fields.bodies[1]
    on_top = upper.points[:, 1] == 2.0
    np.testing.assert_allclose(np.sort(ends, axis=0), np.sort((upper.points + 10 * upper.displacement)[on_top], axis=0))
    np.testing.assert_allclose(loads.V / loads.V.min(), [0.5, 1.0, 1.0, 0.5])  # of three elements, and at most 0.14 * 2
    assert loads.V.min() == pytest.approx(-0.14 * 2)
    obstacle = np.concatenate(drawn["obstacle"].get_segments())
    assert np.abs(obstacle[:, 1]).max() == 0
    assert (obstacle[:, 0].min(), obstacle[:, 0].max()) == (0, 2)


def test_an_obstacle_is_drawn_where_it_is():
    structure = block().system.structure
    system = structure.assemble([Support("block", "top", 0), Support("block", "top", 1, -0.1)])
    floor = cq.Plane(point=[0.0, -0.5], normal=[0.0, 1.0])
    found = solved(system, cq.pair(structure.surface("block", "bottom"), floor, dimension=structure.size))
    axes = figure(found.fields, scale=3.0).axes[0]
    (drawn,) = [artist for artist in axes.collections if artist.get_gid() == "obstacle"]
    np.testing.assert_allclose(np.concatenate(drawn.get_segments())[:, 1], -0.5)
    assert axes.get_ylim()[0] < -0.5
    assert not [artist for artist in axes.collections if artist.get_gid() == "pressure arrows"]


def test_nothing_is_clipped():
    axes = figure(stack().fields, scale=10.0).axes[0]
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    drawn = {artist.get_gid(): artist.get_paths() for artist in axes.collections}
    assert drawn["deformed"]
    assert drawn["pressure"]
    for x in (path.vertices for path in (*drawn["deformed"], *drawn["pressure"])):
        assert left < x[:, 0].min()
        assert x[:, 0].max() < right
        assert low < x[:, 1].min()
        assert x[:, 1].max() < high


def test_the_title_says_the_chosen_magnification():
    result = figure(block().fields)
    # The largest displacement is that of the upper corner, 0.015 * sqrt(1 + 0.5^2): less than 2 % of 2 mm.
    assert result.get_suptitle() == "Displacements magnified 5 times"
    assert figure(block().fields, scale=1.0).get_suptitle() == "Displacements true to scale"


@pytest.mark.parametrize(
    ("size", "moved", "initial_gap", "gap", "expected"),
    [
        (1.0, 1e-3, 0.0, 0.0, 50.0),
        (1e6, 1e3, 0.0, 0.0, 50.0),  # in other units
        (1.0, 0.3, 0.0, 0.0, 1.0),  # large enough
        (1.0, 0.0, 0.0, 0.0, 1.0),
        (1.0, 1e-3, 1e-3, 0.0, 2.0),  # overlap of at most (2 - 1) * 1e-3 < 0.002
        (1.0, 1e-3, 1e-3, 2e-3, 50.0),  # opens
    ],
)
def test_the_magnification_is_visible_and_bounded(size, moved, initial_gap, gap, expected):
    u = np.array([[0.0, -moved]])
    assert magnification(None, size, u, np.array([initial_gap]), np.array([gap])) == expected


@pytest.mark.parametrize("scale", [0.0, -1.0, np.nan, np.inf])
def test_a_scale_that_is_none_is_refused(scale):
    with pytest.raises(InvalidProblem, match="scale: expected a positive number"):
        figure(block().fields, scale=scale)


def test_neighbouring_contacts_follow_the_boundary():
    for kind, count in (("quad4", 4), ("quad8", 8)):
        fields = block(kind).fields
        (pairing,) = fields.pairings
        ends = pairing.position[segments(fields, pairing)]
        assert len(ends) == count
        np.testing.assert_allclose(np.abs(np.diff(ends[:, :, 0], axis=1)), 2.0 / count)


def test_a_small_contact_zone_gets_its_own_window():
    fields = block().fields
    assert contact_zone(fields, 1.0, 2.0) is None
    window = contact_zone(fields, 0.0, 20.0)
    np.testing.assert_allclose(window, [[-2, -3], [4, 3]])


@pytest.mark.parametrize("kind", SOLID)
def test_the_surface_of_a_cube(kind):
    fields = unloaded(kind)
    polygons, values = surface(fields, 1.0)
    strain = PRESSURE / MODULUS
    undeformed = np.concatenate([p.mean(axis=1) for p in surface(fields, 0.0)[0]])
    moved = np.linalg.norm(undeformed * [0.25 * strain, 0.25 * strain, -strain], axis=1)
    np.testing.assert_allclose(np.concatenate(values), moved, rtol=1e-9)
    high = np.concatenate([p.reshape(-1, 3) for p in polygons]).max(axis=0)
    np.testing.assert_allclose(high, [2 + 0.5 * strain, 1 + 0.25 * strain, 1 - strain], rtol=1e-12)
    (body,) = fields.bodies
    lines = [sharp_edges(b, body.points) for b in body.body.mesh.facets_of(body.body.mesh.boundary)]
    assert np.isclose(np.linalg.norm(np.diff(np.concatenate(lines), axis=1), axis=2).sum(), 4 * (2 + 1 + 1))


@pytest.mark.sampled(5)
@pytest.mark.parametrize("kind", ["hex8", "tet4", "hex20", "tet10", "hex27"])
def test_the_map_covers_the_contact_surface(kind):
    fields = cube(kind).fields
    (pairing,) = fields.pairings
    at = pairing.position[:, :2]
    places, values, corners = fans(at, np.ones(len(at)), facets(fields, pairing))
    a, b, c = (places[corners[:, i]] for i in range(3))
    twice = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert np.isclose(np.abs(twice).sum() / 2, 2.0)
    np.testing.assert_allclose(values, 1.0)


def write(fields, file):
    path = check_picture(file)
    save(figure(fields), path)


@pytest.mark.slow
def test_the_picture_of_a_cube(tmp_path):
    fields = cube().fields
    result = figure(fields, scale=2.0)
    labels = {label for axes in result.get_axes() for label in (axes.get_xlabel(), axes.get_ylabel())}
    assert {"x [mm]", "y [mm]", "contact pressure [N/mm²]", "displacement, magnitude [mm]"} <= labels
    (panel,) = [axes for axes in result.get_axes() if axes.get_title()]
    assert panel.get_title() == "contact: at most 3 N/mm²"
    write(fields, tmp_path / "cube.png")
    assert (tmp_path / "cube.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("suffix", "start"), [(".png", b"\x89PNG"), (".pdf", b"%PDF"), (".svg", b"<?xml")])
def test_files_are_written_whole(tmp_path, suffix, start):
    file = tmp_path / f"block{suffix}"
    write(block().fields, str(file))
    assert file.read_bytes().startswith(start)
    assert list(tmp_path.iterdir()) == [file]


def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    file = tmp_path / "block.png"
    file.write_bytes(b"old")

    def full(_, name, **__):
        Path(name).write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", full)
    with pytest.raises(InvalidProblem, match=r"block.png: cannot be written \(No space left on device\)"):
        write(block().fields, file)
    assert file.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [file]


def test_files_that_cannot_be_are_refused(tmp_path):
    fields = block().fields
    with pytest.raises(InvalidProblem, match=r"a.jpg: expected a file name that ends in .png or .pdf or .svg"):
        write(fields, tmp_path / "a.jpg")
    with pytest.raises(InvalidProblem, match="there is no folder"):
        write(fields, tmp_path / "none" / "a.png")
    (tmp_path / "b.png").mkdir()
    with pytest.raises(InvalidProblem, match="expected a file, this is a folder"):
        write(fields, tmp_path / "b.png")


def test_a_missing_matplotlib_is_named_with_its_remedy(tmp_path, monkeypatch):
    real = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *a: None if name == "matplotlib" else real(name, *a))
    with pytest.raises(BackendMissing, match=r"drawing a.png needs matplotlib: pip install matplotlib"):
        write(block().fields, tmp_path / "a.png")


def test_many_arrows_are_thinned_out_but_for_the_largest():
    x = np.linspace(0, 1, 1001)[:, np.newaxis] * [0.1, 1.0]
    value = np.where(np.arange(1001) < 900, 1.0, 0.0)
    value[7], value[8] = 2.0, np.nan
    drawn = arrows_to_draw(x[::-1], value[::-1], 60)
    assert 55 <= len(drawn) <= 61
    assert 1000 - 7 in drawn
    assert (value[::-1][drawn] > 0).all()
    assert arrows_to_draw(x[:50], value[:50], 60).tolist() == [i for i in range(50) if i != 8]
    assert len(arrows_to_draw(x, np.zeros(1001), 60)) == 0


def test_every_status_has_its_own_marker():
    assert len(set(MARKERS.values())) == len(MARKERS)
    assert {"open", "closed", "grazing", "stick", "slip", "held"} == set(MARKERS)


@pytest.mark.parametrize("kind", ["tri3", "quad4", "tri6", "quad8", "quad9"])
def test_outlines_go_once_around(kind):
    reference = REFERENCES[kind]
    x = outline_points(reference)
    nodes = {tuple(p) for p in np.round(x, 12).tolist()}
    on_edge = reference.nodes[[sorted({n for f in reference.facets for n in f})][0]]
    assert all(tuple(p) in nodes for p in np.round(on_edge, 12).tolist())


def test_a_line_of_three_nodes_is_drawn_as_the_parabola():
    curve = Block(REFERENCES["line3"], np.array([[0, 1, 2]]))
    (x,) = sample(curve, np.array([[-1.0, 1.0], [1.0, 1.0], [0.0, 0.0]]), edge_points(curve))
    np.testing.assert_allclose(x[:, 1], x[:, 0] ** 2, atol=1e-15)
    assert len(x) == 7
