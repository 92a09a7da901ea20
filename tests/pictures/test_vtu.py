"""VTU files read back by meshlane: every field, exactly."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

import contactqp as cq
from contactqp.elements.mesh_files import read_mesh
from contactqp.errors import BackendMissing, InvalidProblem
from contactqp.pictures.contact_fields import ContactFields
from contactqp.pictures.vtu import STATUS, STATUS_FIELD, write_vtu
from tests.elements.bodies import PLANE, SOLID
from tests.pictures.examples import FLOOR, PRESSURE, block, solved, stack, unloaded
from tests.pictures.test_frames import fields as frame

meshlane = pytest.importorskip("meshlane")


def written(fields, folder):
    write_vtu(fields, folder / "fields.vtu")
    assert [file.name for file in folder.iterdir()] == ["fields.vtu"]
    return meshlane.read(folder / "fields.vtu")


def test_two_bodies(tmp_path):
    fields = stack().fields
    read = written(fields, tmp_path)
    lower, upper = fields.bodies
    np.testing.assert_array_equal(read.points[:, :2], np.concatenate([lower.points, upper.points]))
    np.testing.assert_array_equal(read.points[:, 2], 0)
    displacement = read.point_data["displacement"]
    assert displacement.shape == (len(read.points), 3)
    np.testing.assert_array_equal(displacement[:, :2], np.concatenate([lower.displacement, upper.displacement]))
    np.testing.assert_array_equal(read.point_data["stress"], np.concatenate([lower.stress, upper.stress]))
    np.testing.assert_allclose(read.point_data["von_mises"], PRESSURE, rtol=1e-9)
    (cells,) = read.cells
    assert cells.type == "quad"
    first = len(lower.points)
    expected = np.concatenate([lower.body.mesh.blocks[0].nodes, upper.body.mesh.blocks[0].nodes + first])
    np.testing.assert_array_equal(cells.data, expected)
    assert read.cell_data["body"][0].tolist() == [0] * 8 + [1] * 6
    floor, between = fields.pairings
    contacts = np.concatenate([floor.node, between.node + first])
    away = np.setdiff1d(np.arange(len(read.points)), contacts)
    for name in ("pressure", "normal_force", "gap"):
        assert np.isnan(read.point_data[f"contact_{name}"][away]).all()
    np.testing.assert_array_equal(read.point_data["contact_pressure"][floor.node], floor.pressure)
    np.testing.assert_array_equal(read.point_data["contact_normal_force"][between.node + first], between.force)
    np.testing.assert_array_equal(read.point_data["contact_gap"][between.node + first], between.gap)
    status = read.point_data[STATUS_FIELD]
    assert np.issubdtype(status.dtype, np.integer)
    assert set(status[away]) == {-1}
    assert set(status[contacts]) == {STATUS["closed"]}
    np.testing.assert_array_equal(
        read.point_data["contact_force"][:, :2], np.concatenate([lower.contact_force, upper.contact_force])
    )


def test_the_name_of_the_status_is_its_legend():
    assert STATUS_FIELD == "contact_status (-1 none, 0 open, 1 grazing, 2 closed, 3 stick, 4 slip, 5 held)"


@pytest.mark.sampled(8)
@pytest.mark.parametrize("kind", [*PLANE, *SOLID])
def test_every_kind_of_element_comes_back(kind, tmp_path):
    fields = unloaded(kind) if kind in SOLID else block(kind).fields
    write_vtu(fields, tmp_path / "a.vtu")
    mesh, read = fields.bodies[0].body.mesh, read_mesh(tmp_path / "a.vtu")
    np.testing.assert_array_equal(read.points, mesh.points)
    assert [b.kind.name for b in read.blocks] == [kind]
    np.testing.assert_array_equal(read.blocks[0].nodes, mesh.blocks[0].nodes)
    assert np.isclose(read.volume(), 2.0)


def test_a_node_with_two_contacts_shows_the_one_that_is_closed(tmp_path):
    found = block()
    surface, size = found.system.structure.surface("block", "bottom"), found.system.structure.size
    lower = cq.Plane(point=[0.0, -0.1], normal=[0.0, 1.0])
    pairings = [cq.pair(surface, plane, dimension=size) for plane in (FLOOR, lower)]
    for both in (pairings, pairings[::-1]):
        read = written(solved(found.system, *both).fields, tmp_path)
        nodes = surface.nodes
        np.testing.assert_allclose(read.point_data["contact_gap"][nodes], 0, atol=1e-14)
        np.testing.assert_allclose(read.point_data["contact_pressure"][nodes], PRESSURE, rtol=1e-9)
        assert set(read.point_data[STATUS_FIELD][nodes]) == {STATUS["closed"]}


def test_no_contact_at_all(tmp_path):
    fields = block().fields
    read = written(ContactFields(fields.bodies, (), fields.units), tmp_path)
    assert np.isnan(read.point_data["contact_gap"]).all()
    assert set(read.point_data[STATUS_FIELD]) == {-1}


def test_a_truss_stands_in_the_plane_of_its_axes(tmp_path):
    found = frame("truss_floor")
    read = written(found, tmp_path)
    np.testing.assert_array_equal(read.points, [[0, 0, 0], [3, 0, 3], [-3, 0, 4]])
    np.testing.assert_array_equal(read.point_data["displacement"][:, [0, 2]], found.displacement)
    assert read.cells_dict["line"].tolist() == [[0, 1], [0, 2]]
    (contact,) = found.contacts
    np.testing.assert_array_equal(read.point_data["contact_force"], [[0, 0, contact.force], [0] * 3, [0] * 3])
    assert read.point_data["contact_gap"][0] == contact.gap
    assert np.isnan(read.point_data["contact_gap"][1:]).all()
    assert read.point_data[STATUS_FIELD].tolist() == [STATUS["closed"], -1, -1]
    assert "contact_pressure" not in read.point_data


def test_both_nodes_of_a_pair_carry_the_contact(tmp_path):
    read = written(frame("two_bars"), tmp_path)
    np.testing.assert_allclose(read.point_data["contact_force"][:, 0], [0, -95, 95, 0], rtol=1e-12)
    assert read.point_data[STATUS_FIELD].tolist() == [-1, 2, 2, -1]


def test_what_cannot_be_written_is_refused(tmp_path, monkeypatch):
    with pytest.raises(InvalidProblem, match=r"a.vtk: expected a file name that ends in .vtu"):
        write_vtu(frame("two_bars"), tmp_path / "a.vtk")
    real = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *a: None if name == "meshlane" else real(name, *a))
    with pytest.raises(BackendMissing, match=r"writing a.vtu needs meshlane: pip install meshlane"):
        write_vtu(frame("two_bars"), tmp_path / "a.vtu")
    assert not list(tmp_path.iterdir())
