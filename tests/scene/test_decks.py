"""A deck is the contact problem that it states: elements as CalculiX has them, loads, equations, ties and contact."""

from __future__ import annotations

import pathlib
import re
import time

import numpy as np
import pytest

import contactqp as cq
from contactqp.exchange.calculix_results import read_displacements
from contactqp.exchange.problem_files import read_problem_with_ledger
from contactqp.exchange.processes import run_calculix as calculix
from tests.decks import STACK, Deck, needs_calculix, write


def solved(folder: pathlib.Path, text: str, enforcement: str = "exact") -> cq.Solution:
    return cq.solve(cq.read_deck(write(folder, text)).problem(enforcement))


def test_two_cubes_touch_with_the_force_of_two_bars(tmp_path: pathlib.Path) -> None:
    solution = solved(tmp_path, STACK)  # 0.02 less the gap 0.01 over two bars of E A / L = 1000
    assert solution.certificate.passed
    assert np.allclose(solution.normal_force, 5.0 / 4, rtol=1e-12)
    assert solution.at("5.z") == pytest.approx(-0.005)


def test_the_penalty_that_the_deck_states_is_one_more_spring(tmp_path: pathlib.Path) -> None:
    solution = solved(tmp_path, STACK, "penalty")
    assert solution.certificate.passed
    assert solution.normal_force.sum() == pytest.approx(0.01 / (2 / 1000 + 1 / 1e4), rel=1e-12)
    hard = STACK.replace("PRESSURE-OVERCLOSURE=LINEAR\n1e4", "PRESSURE-OVERCLOSURE=HARD")
    assert solved(tmp_path, hard, "penalty").normal_force.sum() == pytest.approx(0.01 / (2 / 1000 + 1 / 5e4), rel=1e-12)


def test_a_mortar_of_the_same_faces_gives_the_same(tmp_path: pathlib.Path) -> None:
    problem = cq.read_deck(write(tmp_path, STACK)).problem(discretisation="mortar")
    assert np.allclose(cq.solve(problem).normal_force, 5.0 / 4, rtol=1e-12)


def test_names_are_those_of_the_deck(tmp_path: pathlib.Path) -> None:
    deck = cq.read_deck(write(tmp_path, STACK))
    assert deck.dof_names == tuple(f"{node}.z" for node in (5, 6, 7, 8, 11, 12, 13, 14))
    assert deck.problem().contact_names == tuple(f"node {node}" for node in (11, 12, 13, 14))
    labels, moved = deck.displacements(cq.solve(deck.problem()).displacement)
    assert moved[labels.tolist().index(15)].tolist() == [0.0, 0.0, -0.02]


def test_a_deck_is_read_like_any_problem(tmp_path: pathlib.Path) -> None:
    problem, ledger = read_problem_with_ledger(write(tmp_path, STACK))
    assert problem.contacts == 4
    assert ledger.read[0] == "16 nodes, 2 C3D8"


def test_clearance_takes_the_place_of_distances(tmp_path: pathlib.Path) -> None:
    text = STACK.replace("*BOUNDARY\nBOTTOM", "*CLEARANCE, MASTER=BELOW, SLAVE=ABOVE, VALUE=-0.01\n*BOUNDARY\nBOTTOM")
    assert solved(tmp_path, text).normal_force.sum() == pytest.approx(15.0)


def test_adjust_moves_slave_nodes_onto_the_master(tmp_path: pathlib.Path) -> None:
    text = STACK.replace("TYPE=NODE TO SURFACE", "TYPE=NODE TO SURFACE, ADJUST=0.02")
    deck = cq.read_deck(write(tmp_path, text))
    force = cq.solve(deck.problem()).normal_force.sum()
    assert force == pytest.approx(0.02 / (1 / 1000 + 1.01 / 1000))  # the upper cube is 1.01 high now
    assert any("4 slave nodes moved, by 0.01 at most" in line for line in deck.ledger.converted)


def test_a_list_of_nodes_is_the_surface_of_its_faces(tmp_path: pathlib.Path) -> None:
    text = STACK.replace("*SURFACE, NAME=ABOVE\n2, S1", "*SURFACE, NAME=ABOVE, TYPE=NODE\n11\n12\n13\n14")
    assert solved(tmp_path, text).normal_force.sum() == pytest.approx(5.0)
    with pytest.raises(cq.InvalidProblem, match=r"\*SURFACE ABOVE: node 11 has no face"):
        solved(tmp_path, text.replace("11\n12\n13\n14", "11\n12\n13"))


def test_a_tie_joins_what_it_is_near_to(tmp_path: pathlib.Path) -> None:
    pair = re.search(r"\*CONTACT PAIR.*\n.*\n", STACK)
    assert pair is not None
    text = STACK.replace(pair[0], "*TIE, NAME=T, POSITION TOLERANCE=0.02, ADJUST=NO\nABOVE, BELOW\n")
    solution = solved(tmp_path, text)
    assert abs(solution.tie_force.sum()) == pytest.approx(0.02 / (2 / 1000))
    far = cq.read_deck(write(tmp_path, text.replace("TOLERANCE=0.02", "TOLERANCE=0.001")))
    assert far.problem().ties == 0


def test_loads_add_up_and_the_weight_is_that_of_the_density(tmp_path: pathlib.Path) -> None:
    free = STACK.replace("*BOUNDARY\nTOP, 3, 3, -0.02\n", "*DLOAD\n2, P2, 30.\n*CLOAD\nTOP, 3, -1.\nTOP, 3, -1.\n")
    assert solved(tmp_path, free).normal_force.sum() == pytest.approx(38.0)
    heavy = free.replace("*CLOAD", "SOLID, GRAV, 10., 0., 0., -1.\n*CLOAD")
    assert solved(tmp_path, heavy).normal_force.sum() == pytest.approx(58.0)


def test_equations_bind_nodes(tmp_path: pathlib.Path) -> None:
    text = STACK.replace("TOP, 3, 3, -0.02", "15, 3, 3, -0.02").replace(
        "*STEP", "*EQUATION\n" + "".join(f"2\n{node}, 3, 1., 15, 3, -1.\n" for node in (16, 17, 18)) + "*STEP"
    )
    assert solved(tmp_path, text).normal_force.sum() == pytest.approx(5.0)


WRONG = {
    "a hexahedron that is collapsed": (
        "15, 16, 17, 18\n*NSET",
        "15, 16, 17, 17\n*NSET",
        "model.inp: element 2 (C3D8): a node stands in it twice",
    ),
    "an element inside out": (
        "1, 1, 2, 3, 4, 5, 6, 7, 8",
        "1, 5, 6, 7, 8, 1, 2, 3, 4",
        "element 1 (C3D8): its Jacobian",
    ),
    "a node that is not there": ("15, 16, 17, 18\n*NSET", "15, 16, 17, 19\n*NSET", "element 2: there is no node 19"),
    "an element without a section": ("ELSET=SOLID, MATERIAL", "ELSET=SOME, MATERIAL", "got 'SOME'; it has SOLID"),
    "a face that is none": ("2, S1\n", "3, S1\n", "*SURFACE ABOVE: there is no element 3"),
    "a material that is not there": (
        "MATERIAL=STEEL\n*SURF",
        "MATERIAL=IRON\n*SURF",
        "there is no material IRON; it has STEEL",
    ),
    "surfaces that look away": ("2, S1\n", "2, S2\n", "do not face each other"),
    "a surface against itself": ("ABOVE, BELOW", "ABOVE, ABOVE", "*CONTACT PAIR: "),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_makes_no_bodies_is_refused_by_name(tmp_path: pathlib.Path, name: str) -> None:
    old, new, said = WRONG[name]
    assert old in STACK
    with pytest.raises(cq.InvalidProblem, match=re.escape(said)):
        solved(tmp_path, STACK.replace(old, new, 1))


STACK_OF_ONE = """\
*NODE
1, 5., 0.
2, 6., 0.
3, 6.1, 1.
4, 5., 1.
*ELEMENT, TYPE=CPE4, ELSET=E
1, 1, 2, 3, 4
*MATERIAL, NAME=M
*ELASTIC
1000., 0.3
*SOLID SECTION, ELSET=E, MATERIAL=M
*STEP
*STATIC
*END STEP
"""


@pytest.mark.parametrize("kind", ["CPS4", "CAX4"])
def test_plane_stress_and_axial_symmetry_tell_where_calculix_differs(tmp_path: pathlib.Path, kind: str) -> None:
    text = STACK_OF_ONE.replace("CPE4", kind)
    deck = cq.read_deck(write(tmp_path, text))
    assert deck.problem().dimension == 8
    assert any(line.startswith(f"{kind}: ") for line in deck.ledger.assumed)


@pytest.mark.slow
def test_many_lines_of_loads_are_read_in_little_time(tmp_path: pathlib.Path) -> None:
    free = STACK.replace("*BOUNDARY\nTOP, 3, 3, -0.02\n", "*DLOAD\n" + "2, P2, 0.01\n" * 3000)
    began = time.process_time()
    deck = cq.read_deck(write(tmp_path, free))
    assert deck.problem().load.sum() == pytest.approx(-30.0)
    assert time.process_time() - began < 5


LOADS = {
    "forces": ["*CLOAD", "TOP, 1, 3.", "TOP, 2, -1."],
    "pressure": ["*DSLOAD", "SIDE, P, 2."],
    "weight": ["*DLOAD", "BODY, GRAV, 9810., 0., -1., 0."],
}
# The largest difference of a displacement, of the largest one: printed digits, or a wedge in the place of a circle.
DIFFERENCES = {"C3D": 1e-6, "CPE": 1e-6, "CAX": 5e-4}


@pytest.mark.sampled(30)
@needs_calculix
@pytest.mark.parametrize("load", LOADS)
@pytest.mark.parametrize(("model", "kind"), [
    *(("C3D", kind) for kind in ("hex8", "hex20", "tet4")), *(("CPE", kind) for kind in ("quad4", "quad8", "tri3")),
    *(("CAX", kind) for kind in ("quad4", "quad8", "tri3", "tri6")),
])  # fmt: skip
def test_loads_move_distorted_bodies_as_in_calculix(tmp_path: pathlib.Path, model: str, kind: str, load: str) -> None:
    if (model, kind, load) == ("CAX", "tri3", "pressure"):
        pytest.skip("CalculiX halves the pressure on an edge, whatever the radii of its ends, which the ledger tells")
    deck = Deck(model)
    if model == "C3D":
        mesh = cq.box((1.0, 1.0, 1.0), (3, 3, 3), kind).mapped(lambda x: x + 0.05 * np.sin(3 * x[:, [1, 2, 0]]))
    else:
        square = cq.rectangle(1.0, 1.0, (3, 3), kind)
        mesh = square.mapped(lambda x: x + 0.05 * np.sin(3 * x[:, [1, 0]]) + np.array([2.0, 0.0]))
    deck.body("BODY", mesh, section="0.3" if model == "CPE" else "")
    deck.lines.insert(len(deck.lines) - (2 if model == "CPE" else 1), "*DENSITY\n7.8e-9")
    deck.nset("BOTTOM", "BODY", "bottom")
    deck.nset("TOP", "BODY", "top")
    deck.surface("SIDE", "BODY", "top")
    deck.lines += ["*BOUNDARY", "BOTTOM, 1, 3"]
    deck.step += LOADS[load]
    file = write(tmp_path, deck.text())
    read = cq.read_deck(file)
    labels, ours = read.displacements(cq.solve(read.problem()).displacement)
    theirs, _ = read_displacements(calculix(file, labels, tmp_path / "run", 60.0).results)
    assert theirs.nodes.tolist() == labels.tolist()
    assert abs(theirs.values[:, : ours.shape[1]] - ours).max() <= DIFFERENCES[model] * abs(ours).max()


def test_a_flat_master_of_a_tie_is_refused_by_its_element(tmp_path: pathlib.Path) -> None:
    text = STACK.replace("*CONTACT PAIR, INTERACTION=TOUCH, TYPE=NODE TO SURFACE", "*TIE, NAME=T")
    flat = text.replace(" 6, 1., 0., 1.", " 6, 0., 0., 1.").replace(" 7, 1., 1., 1.", " 7, 0., 0., 1.")
    with pytest.raises(cq.InvalidProblem, match=r"line \d+: \*SURFACE: surface BELOW: facet 0"):
        solved(tmp_path, flat)


def test_what_has_no_place_in_the_problem_is_told(tmp_path: pathlib.Path) -> None:
    text = STACK.replace("18, 0., 1., 2.01\n", "18, 0., 1., 2.01\n99, 5., 5., 5.\n").replace(
        "MATERIAL=STEEL\n*SUR", "MATERIAL=STEEL\n2.\n*SUR"
    )
    text = text.replace("\n1e4\n", "\n1e4, 3., 0.1\n").replace("*BOUNDARY\nBOTTOM", "*BOUNDARY\n99, 1, 3\nBOTTOM")
    deck = cq.read_deck(write(tmp_path, text))
    deck.problem()
    told = " ".join(deck.ledger.ignored)
    for words in ("1 node in no element and no equation", "a thickness, which solids have not", "a tension of 3",
                  "a clearance of 0.1", "*BOUNDARY: 1 node in no element, such as 99"):  # fmt: skip
        assert words in told
    plane = STACK_OF_ONE.replace("*STEP", "*BOUNDARY\n1, 1, 3\n*STEP")
    deck = cq.read_deck(write(tmp_path, plane))
    deck.problem()
    assert any("direction 3, which plane elements have not" in line for line in deck.ledger.ignored)
    bare = cq.read_deck(write(tmp_path, STACK.replace("*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR\n1e4\n", "")))
    assert any("no *SURFACE BEHAVIOR: HARD" in line for line in bare.ledger.assumed)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("enforcement", ["exact", "penalty"])
def test_rounding_of_prescribed_displacements_drives_nothing(tmp_path: pathlib.Path, enforcement: str) -> None:
    free_to_slide = STACK.replace("ALL, 1, 2\n", "ALL, 1\n")  # the upper cube along y, which nothing resists
    solution = solved(tmp_path, free_to_slide, enforcement)
    assert solution.certificate.passed
    assert solution.normal_force.sum() == pytest.approx(5.0 if enforcement == "exact" else 0.01 / 0.0021)
