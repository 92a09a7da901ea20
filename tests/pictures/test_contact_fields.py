"""Fields against uniform states that are known exactly; a force is no pressure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.elements.structure import Structure, Support
from contactqp.errors import InvalidProblem
from contactqp.pictures.contact_fields import contact_fields, fields_of_deck
from contactqp.pictures.drawing import figure
from tests.decks import STACK, lame_force, press_fit, two_blocks, write
from tests.pictures.examples import FLOOR, POISSON, PRESSURE, block, cube, solved, stack, uniaxial, with_friction


@pytest.mark.sampled(6)
@pytest.mark.parametrize("kind", ["tri3", "quad4", "tri6", "quad8"])
@pytest.mark.parametrize("thickness", [1.0, 0.5])
def test_a_block_under_pressure(kind, thickness):
    fields = block(kind, thickness=thickness).fields
    (body,), (pairing,) = fields.bodies, fields.pairings
    np.testing.assert_allclose(body.displacement, uniaxial(body.points), atol=1e-13)
    np.testing.assert_allclose(body.stress, np.tile([0, -PRESSURE, 0, 0, 0, 0], (len(body.points), 1)), atol=1e-10)
    np.testing.assert_allclose(body.von_mises, PRESSURE, rtol=1e-11)
    np.testing.assert_allclose(pairing.pressure, PRESSURE, rtol=1e-10)
    assert np.isclose(pairing.force.sum(), PRESSURE * 2.0 * thickness, rtol=1e-12)
    np.testing.assert_allclose(body.contact_force.sum(axis=0), [0, PRESSURE * 2.0 * thickness], atol=1e-12)
    np.testing.assert_allclose(pairing.position, body.points[pairing.node])
    np.testing.assert_allclose(pairing.displacement, body.displacement[pairing.node])
    np.testing.assert_allclose(pairing.gap, 0, atol=1e-14)
    assert set(pairing.status) == {"closed"}
    assert pairing.on_obstacle
    assert (fields.units.length, fields.units.force) == ("mm", "N")


@pytest.mark.sampled(4)
@pytest.mark.parametrize("kind", ["quad4", "tri3", "quad8", "tri6"])
def test_the_pressure_of_a_cylinder_is_that_of_the_full_circle(kind):
    """Its force is 2 pi r p da, so force over the area of the meridian is none."""
    found = block(kind, "axisymmetric")
    (pairing,) = found.fields.pairings
    assert np.isclose(pairing.force.sum(), PRESSURE * np.pi * 2.0**2, rtol=1e-12)
    np.testing.assert_allclose(pairing.pressure, PRESSURE, rtol=1e-9)
    np.testing.assert_allclose(found.pairings[0].pressure(found.solution.normal_force), pairing.pressure, rtol=1e-14)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("kind", ["hex8", "tet4", "hex27", "tet10"])
def test_a_cube_under_pressure(kind):
    fields = cube(kind).fields
    (body,), (pairing,) = fields.bodies, fields.pairings
    np.testing.assert_allclose(body.displacement, uniaxial(body.points), atol=1e-13)
    np.testing.assert_allclose(pairing.pressure, PRESSURE, rtol=1e-10)
    np.testing.assert_allclose(body.von_mises, PRESSURE, rtol=1e-10)
    assert np.isclose(pairing.force.sum(), PRESSURE * 2.0, rtol=1e-12)


@pytest.mark.parametrize("cells", [(3, 2), (4, 2)])
def test_two_bodies_and_two_pairings(cells):
    """With (4, 2) every slave node stands on a master node: the contact belongs to the slave, the upper body."""
    fields = stack(cells).fields
    lower, upper = fields.bodies
    floor, between = fields.pairings
    assert set(floor.body) == {0}
    assert set(between.body) == {1}
    assert (floor.on_obstacle, between.on_obstacle) == (True, False)
    for pairing in fields.pairings:
        np.testing.assert_allclose(pairing.pressure, PRESSURE, rtol=1e-9)
        assert np.isclose(pairing.force.sum(), 2 * PRESSURE, rtol=1e-12)
    np.testing.assert_allclose(between.position, upper.points[between.node])
    np.testing.assert_allclose(lower.contact_force.sum(axis=0), 0, atol=1e-11)
    np.testing.assert_allclose(upper.contact_force.sum(axis=0), [0, 2 * PRESSURE], atol=1e-11)
    whole = uniaxial(np.concatenate([lower.points, upper.points]))
    np.testing.assert_allclose(np.concatenate([lower.displacement, upper.displacement]), whole, atol=1e-13)
    assert [pairing.name for pairing in fields.pairings] == ["contact 1", "contact 2"]


def test_the_contact_belongs_to_the_slave_also_where_its_body_comes_first():
    found = stack((4, 2))
    structure = found.system.structure
    surfaces = structure.surface("lower", "top"), structure.surface("upper", "bottom")
    between = cq.pair_mortar(*surfaces, dimension=structure.size)
    fields = solved(found.system, found.pairings[0], between).fields
    assert set(fields.pairings[1].body) == {0}
    np.testing.assert_allclose(fields.pairings[1].pressure, PRESSURE, rtol=1e-9)


def test_points_without_area_have_a_force_and_no_pressure():
    found = block()
    surface = found.system.structure.surface("block", "bottom")
    nodes = surface.nodes
    pairing = cq.pair(
        surface.points[nodes], FLOOR, unknowns=surface.unknowns[nodes], dimension=found.system.structure.size
    )
    (bare,), (whole,) = solved(found.system, pairing).fields.pairings, found.fields.pairings
    assert bare.pressure is None
    np.testing.assert_allclose(bare.force, whole.force, rtol=1e-10)
    assert bare.node.tolist() == nodes.tolist()


def test_a_held_contact_has_no_known_force_and_says_so():
    structure = Structure([block().system.structure.bodies[0]])
    corner = structure.body("block").mesh.nearest((0.0, 0.0))
    supports = [Support("block", corner, 0), Support("block", corner, 1), Support("block", "top", 1, -0.01)]
    pairing = cq.pair(structure.surface("block", "bottom"), FLOOR, dimension=structure.size)
    found = solved(structure.assemble(supports), pairing)
    (fields,) = found.fields.pairings
    held = fields.status == "held"
    assert fields.node[held].tolist() == [corner]
    assert np.isnan(fields.force[held]).all()
    assert np.isnan(fields.pressure[held]).all()
    assert np.isfinite(fields.force[~held]).all()
    assert fields.gap[held] == 0
    rubbing = with_friction(found.solution, 0.5 * found.solution.normal_force[:, None])
    (rubbed,) = contact_fields(found.system, found.pairings, rubbing).pairings
    assert np.isnan(rubbed.friction[held]).all()
    np.testing.assert_allclose(rubbed.friction[~held], np.outer(fields.force[~held], [-0.5, 0.0]), atol=1e-12)


def test_open_contacts_keep_their_gap():
    found = block()
    structure = found.system.structure
    low = cq.Plane(point=[0.0, -0.5], normal=[0.0, 2.0])
    system = structure.assemble([Support("block", "top", 0), Support("block", "top", 1, -0.1)])
    (fields,) = solved(
        system, cq.pair(structure.surface("block", "bottom"), low, dimension=structure.size)
    ).fields.pairings
    np.testing.assert_allclose(fields.gap, 0.4, rtol=1e-12)
    np.testing.assert_allclose(fields.initial_gap, 0.5)
    assert set(fields.status) == {"open"}
    assert np.abs(fields.force).max() == np.abs(fields.pressure).max() == 0


def test_friction_pushes_against_the_slip_on_the_body():
    found = block()
    solution = with_friction(found.solution, 0.5 * found.solution.normal_force[:, None])
    fields = contact_fields(found.system, found.pairings, solution)
    np.testing.assert_allclose(fields.bodies[0].contact_force.sum(axis=0), [-PRESSURE, 2 * PRESSURE], rtol=1e-11)
    (pairing,) = fields.pairings
    np.testing.assert_allclose(pairing.friction, np.outer(pairing.force, [-0.5, 0.0]), atol=1e-12)
    np.testing.assert_allclose(pairing.shear, np.tile([-0.5 * PRESSURE, 0.0], (len(pairing.force), 1)), atol=1e-10)
    assert found.fields.pairings[0].friction is None


def test_friction_of_a_mortar_is_that_of_the_nodes_that_it_belongs_to():
    found = stack()
    forces = found.solution.normal_force
    fields = contact_fields(found.system, found.pairings, with_friction(found.solution, 0.25 * forces[:, None]))
    for pairing in fields.pairings:
        np.testing.assert_allclose(np.linalg.norm(pairing.friction, axis=1), 0.25 * pairing.force, rtol=1e-10)
        np.testing.assert_allclose(np.sum(pairing.friction * pairing.direction, axis=1), 0.0, atol=1e-12)


def test_friction_in_space_lies_in_the_plane_of_contact():
    found = cube("hex8")
    friction = found.solution.normal_force[:, None] * [0.3, -0.4]
    fields = contact_fields(found.system, found.pairings, with_friction(found.solution, friction))
    (pairing,) = fields.pairings
    np.testing.assert_allclose(np.linalg.norm(pairing.friction, axis=1), 0.5 * pairing.force, rtol=1e-10)
    np.testing.assert_allclose(pairing.friction[:, 2], 0.0, atol=1e-12)
    np.testing.assert_allclose(fields.bodies[0].contact_force.sum(axis=0)[:2], pairing.friction.sum(axis=0)[:2])


def test_what_does_not_belong_together_is_refused():
    found = block()
    with pytest.raises(InvalidProblem, match=r"solution: expected 39 unknowns and 10 contacts.*, got 39 and 5"):
        contact_fields(found.system, found.pairings * 2, found.solution)
    with pytest.raises(InvalidProblem, match="names: expected one for each of 1 pairings, got 2"):
        contact_fields(found.system, found.pairings, found.solution, names=["a", "b"])
    moved = replace(found.pairings[0], points=found.pairings[0].points + np.array([0.0, 0.1]))
    with pytest.raises(InvalidProblem, match=r"contact: contact 0 at \[.*0.1\]: expected a node of the structure"):
        contact_fields(found.system, [moved], found.solution)


def test_plane_strain_has_the_stress_across_the_plane():
    (body,) = block(model="plane-strain").fields.bodies
    np.testing.assert_allclose(body.stress[:, 2], -POISSON * PRESSURE, rtol=1e-10)
    shape = np.sqrt(1 - POISSON + POISSON**2)  # of (0, -p, -nu p)
    np.testing.assert_allclose(body.von_mises, PRESSURE * shape, rtol=1e-10)


@pytest.mark.slow
def test_a_deck_has_the_fields_of_its_bodies(tmp_path):
    steel = "*SOLID SECTION, ELSET=SOLID, MATERIAL=STEEL\n"
    two = STACK.replace(steel, "*ELSET, ELSET=A\n1\n*ELSET, ELSET=B\n2\n" + steel.replace("SOLID,", "A,")
                        + steel.replace("SOLID,", "B,"))  # fmt: skip
    for text, bodies in ((STACK, 1), (two, 2)):
        deck = cq.read_deck(write(tmp_path, text))
        fields = fields_of_deck(deck, cq.solve(deck.problem()))
        (pairing,) = fields.pairings
        assert len(fields.bodies) == bodies
        assert (pairing.name, set(pairing.body)) == ("ABOVE on BELOW", {bodies - 1})
        np.testing.assert_allclose(pairing.pressure, 5.0, rtol=1e-10)  # 0.01 over two bars of modulus 1000
        np.testing.assert_allclose(pairing.displacement, np.tile([0, 0, -0.015], (4, 1)), atol=1e-12)
        np.testing.assert_allclose(pairing.gap, 0.0, atol=1e-12)
        for body in fields.bodies:
            np.testing.assert_allclose(body.von_mises, 5.0, rtol=1e-9)
        pushed = sum(body.contact_force[:, 2].clip(min=0).sum() for body in fields.bodies)
        assert pushed == pytest.approx(5.0)


def test_nodes_of_several_parts_of_a_deck_bear_their_load_once(tmp_path):
    text = STACK.replace("2, 11, 12, 13, 14, 15, 16, 17, 18\n", "2, 11, 12, 13, 14, 15, 16, 17, 18\n"
                         "*NODE, NSET=ALL\n21, 0., 0., 3.\n22, 1., 0., 3.\n23, 1., 1., 3.\n24, 0., 1., 3.\n"
                         "*ELEMENT, TYPE=C3D8, ELSET=SOFT\n3, 15, 16, 17, 18, 21, 22, 23, 24\n")  # fmt: skip
    text = text.replace("*SURFACE, NAME=BELOW", "*MATERIAL, NAME=RUBBER\n*ELASTIC\n1., 0.\n"
                        "*SOLID SECTION, ELSET=SOFT, MATERIAL=RUBBER\n*SURFACE, NAME=BELOW", 1)  # fmt: skip
    text = text.replace("*BOUNDARY\nTOP, 3, 3, -0.02\n", "*CLOAD\nTOP, 3, -2.\n")
    deck = cq.read_deck(write(tmp_path, text))
    fields = fields_of_deck(deck, cq.solve(deck.problem()))
    assert [len(body.points) for body in fields.bodies] == [16, 8]
    assert sum(body.load[:, 2].sum() for body in fields.bodies) == -8.0


@pytest.mark.slow
def test_friction_of_a_deck_acts_on_its_slave_nodes(tmp_path):
    text = two_blocks("hex8", "NODE TO SURFACE", "LINEAR\n1e8, 1e-6", push=5e-4, friction="0.3, 1e7")
    deck = cq.read_deck(write(tmp_path, text))
    solution = cq.solve(deck.problem())
    (pairing,) = fields_of_deck(deck, solution).pairings
    full = deck.contacts("node-to-segment").tangent
    expected = -(full.T @ solution.friction_force.ravel())  # on all nodes, those of the master included
    slave = pairing.friction.sum(axis=0)
    assert sp.issparse(full)
    assert abs(expected.reshape(-1, 3).sum(axis=0)).max() < 1e-9 * abs(slave).max()
    nodes = deck.contacts("node-to-segment").pairs[0].pairing.nodes
    np.testing.assert_allclose(pairing.friction, expected.reshape(-1, 3)[nodes], atol=1e-12 * abs(slave).max())


@pytest.mark.slow
def test_a_curved_pair_of_a_deck_is_mapped_with_its_pressures(tmp_path):
    deck = cq.read_deck(write(tmp_path, press_fit("SURFACE TO SURFACE", "LINEAR\n1e8")))
    (pairing,) = fields_of_deck(deck, cq.solve(deck.problem())).pairings
    np.testing.assert_allclose(pairing.pressure, lame_force() / (np.pi / 2 * 20.0 * 4.0), rtol=0.03)


def test_the_fields_of_a_deck_are_those_of_its_own_solution(tmp_path):
    deck = cq.read_deck(write(tmp_path, STACK))
    other = cq.read_deck(write(tmp_path, STACK.replace("ALL, 1, 2", "ALL, 1"), "other.inp"))
    for problem in (other.problem(), deck.problem(discretisation="points")):
        with pytest.raises(InvalidProblem, match="a solution of its 8 unknowns by nodes or as a mortar, got one of "):
            fields_of_deck(deck, cq.solve(problem))


@pytest.mark.slow
def test_a_deck_is_drawn_on_its_springs_and_as_a_mortar(tmp_path):
    deck = cq.read_deck(write(tmp_path, two_blocks("hex8", "SURFACE TO SURFACE", "LINEAR\n1e7")))
    for options in (dict(enforcement="penalty"), dict(discretisation="mortar")):
        solution = cq.solve(deck.problem(**options))
        (pairing,) = fields_of_deck(deck, solution).pairings
        np.testing.assert_array_equal(pairing.force, solution.normal_force)
        assert np.nanmin(pairing.gap) == pytest.approx(-np.max(solution.displacement[len(deck.free) :], initial=0.0))


@pytest.mark.slow
def test_a_deck_without_contact_has_bodies_all_the_same(tmp_path):
    text = STACK[: STACK.index("*SURFACE INTERACTION")] + "*BOUNDARY\n" + STACK.partition("*BOUNDARY\n")[2]
    deck = cq.read_deck(write(tmp_path, text))
    fields = fields_of_deck(deck, cq.solve(deck.problem()))
    assert (len(fields.bodies), fields.pairings) == (1, ())
    assert figure(fields).axes
