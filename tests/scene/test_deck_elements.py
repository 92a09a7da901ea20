"""The elements of a deck are those of CalculiX, by the stiffness that it stores itself; each is distorted."""

from __future__ import annotations

import itertools
import pathlib

import numpy as np
import pytest
from numpy.typing import NDArray

import contactqp as cq
from contactqp.elements.members import beam_stiffness
from contactqp.elements.reference_elements import REFERENCES, Geometry, Quadrature, Reference, gauss
from contactqp.exchange.calculix_results import read_displacements
from contactqp.exchange.processes import run_calculix as calculix
from contactqp.scene.deck.deck import Deck as ReadDeck
from tests.decks import Deck, needs_calculix, run_calculix, write

Matrix = NDArray[np.float64]
SHAPES = {"3": "tri3", "4": "quad4", "6": "tri6", "8": "quad8", "8R": "quad8"}
SOLIDS = {"C3D4": "tet4", "C3D8": "hex8", "C3D10": "tet10", "C3D20": "hex20", "C3D20R": "hex20"}
KINDS = SOLIDS | {f"{model}{count}": kind for model in ("CPE", "CPS", "CAX") for count, kind in SHAPES.items()}
MODULUS, POISSON, THICKNESS = 210_000.0, 0.3, 0.7
# Half of the wedge of a body of revolution that CalculiX has solids of.
HALF_WEDGE = np.deg2rad(1.0)


def one_element(kind: str, seed: int) -> str:
    """Return a deck of one element; %s is its procedure."""
    nodes = REFERENCES[KINDS[kind]].nodes
    points = nodes + 0.1 * np.random.default_rng(seed).uniform(-1, 1, nodes.shape)
    points[:, 0] += 2.5 if kind.startswith("CAX") else 0.0
    rows = [f"{i + 1}, " + ", ".join(f"{x:.13e}" for x in point) for i, point in enumerate(points)]
    labels = ["1", *(str(i + 1) for i in range(len(points)))]
    lines = [
        ", ".join(labels[:11]) + ("," if len(labels) > 11 else ""),
        *([", ".join(labels[11:])] * (len(labels) > 11)),
    ]
    section = ["*SOLID SECTION, ELSET=E, MATERIAL=M", *([f"{THICKNESS}"] if kind.startswith("CP") else [])]
    material = ["*MATERIAL, NAME=M", "*ELASTIC", f"{MODULUS}, {POISSON}", "*DENSITY", "1."]
    return "\n".join(
        ["*NODE", *rows, f"*ELEMENT, TYPE={kind}, ELSET=E", *lines, *material, *section, "*STEP", "%s", "*END STEP", ""]
    )


def stored(folder: pathlib.Path, text: str) -> tuple[list[str], Matrix]:
    """Return the stiffness that CalculiX stores of a deck, and what its unknowns are called: node.axis."""
    run_calculix(folder, text.replace("%s", "*FREQUENCY, SOLVER=MATRIXSTORAGE"))
    names = (folder / "job.dof").read_text().split()
    entries = np.loadtxt(folder / "job.sti")
    (folder / "job.sti").unlink()
    row, column = (entries[:, at].astype(int) - 1 for at in range(2))
    K = np.zeros((len(names), len(names)))
    K[row, column] = K[column, row] = entries[:, 2]
    return names, K


def onto(K: Matrix, kept: list[int]) -> Matrix:
    """Return K with all unknowns eliminated but these, which no force acts on."""
    others = np.setdiff1d(np.arange(len(K)), kept)
    eliminated = np.linalg.lstsq(K[np.ix_(others, others)], K[np.ix_(others, kept)], rcond=1e-13)[0]
    return np.asarray(K[np.ix_(kept, kept)] - K[np.ix_(kept, others)] @ eliminated)


def by_number(name: str) -> str:
    """Return 17.2 for 17.y."""
    node, _, axis = name.partition(".")
    return f"{node}.{'xyz'.index(axis) + 1}"


def apart(folder: pathlib.Path, text: str) -> float:
    """Return how far the stiffness of a deck is from CalculiX's, of its largest entry, thicknesses eliminated."""
    names, theirs = stored(folder, text)
    read = cq.read_deck(write(folder, text.replace("%s", "*STATIC")))
    deck = ReadDeck(read.model, expanded=True)
    ours = deck.problem().stiffness.toarray()
    moved = [name for name in deck.dof_names if not name.startswith("thickness")]
    theirs = onto(theirs, [names.index(by_number(name)) for name in moved])
    ours = onto(ours, [deck.dof_names.index(name) for name in moved])
    return float(abs(ours - theirs).max() / abs(theirs).max())


@pytest.mark.sampled(28)
@needs_calculix
@pytest.mark.parametrize("kind", [kind for kind in KINDS if not kind.startswith("CAX")])
def test_elements_are_those_of_calculix(tmp_path: pathlib.Path, kind: str) -> None:
    for seed in range(3):
        assert apart(tmp_path, one_element(kind, seed)) <= 1e-10


@needs_calculix
def test_springs_are_those_of_calculix(tmp_path: pathlib.Path) -> None:
    text = one_element("C3D4", 0).replace("*MATERIAL", "*ELEMENT, TYPE=SPRINGA, ELSET=S\n9, 2, 3\n*MATERIAL", 1)
    assert apart(tmp_path, text.replace("*STEP", "*SPRING, ELSET=S\n\n55555.\n*STEP")) <= 1e-10


def two_thicknesses(second: float) -> str:
    """Return a deck of two elements of plane stress, the second one of another material and thickness."""
    text = one_element("CPS4", 0).replace("*ELEMENT", "11, 2.9, -1.1\n12, 3.2, 0.8\n*ELEMENT", 1)
    text = text.replace("*MATERIAL", "*ELEMENT, TYPE=CPS4, ELSET=F\n2, 2, 11, 12, 3\n*MATERIAL", 1)
    other = f"*MATERIAL, NAME=N\n*ELASTIC\n70000., 0.2\n*DENSITY\n1.\n*SOLID SECTION, ELSET=F, MATERIAL=N\n{second}\n"
    return text.replace("*STEP", f"{other}*STEP")


@needs_calculix
def test_sections_of_two_thicknesses_have_unknown_thicknesses_of_their_own(tmp_path: pathlib.Path) -> None:
    assert apart(tmp_path, two_thicknesses(THICKNESS)) <= 1e-10
    assert apart(tmp_path, two_thicknesses(0.9)) <= 1e-10
    file = write(tmp_path, two_thicknesses(0.9).replace("%s", "*STATIC"))
    names = ReadDeck(cq.read_deck(file).model, expanded=True).dof_names
    assert len(names) == 12 + 8
    assert "thickness of node 2 where it is 0.9" in names
    assert "thickness of node 1" in names


def test_the_thickness_of_a_bar_in_tension_is_that_of_poisson(tmp_path: pathlib.Path) -> None:
    nodes = "*NODE\n1, 0., 0.\n2, 2., 0.\n3, 2., 1.\n4, 0., 1.\n"
    text = nodes + one_element("CPS4", 0).partition("*ELEMENT")[1] + one_element("CPS4", 0).partition("*ELEMENT")[2]
    pulled = "*STATIC\n*BOUNDARY\n1, 1, 2\n4, 1\n*CLOAD\n2, 1, 3500.\n3, 1, 3500."
    deck = cq.read_deck(write(tmp_path, text.replace("%s", pulled)))
    strain = 7000 / (THICKNESS * MODULUS)
    for solution in (cq.solve(deck.problem()), cq.solve(ReadDeck(deck.model, expanded=True).problem())):
        assert solution.at("2.x") == pytest.approx(2 * strain, rel=1e-12)
    assert solution.at("thickness of node 3") == pytest.approx(-POISSON * strain * THICKNESS, rel=1e-12)


def contact_in_plane_stress(element: str, thickness: float) -> str:
    """Return the deck of a square that is pressed by 0.001 onto a wider one."""
    deck = Deck("CPS")
    for name, size, divisions, corner in (
        ("UP", (1.0, 1.0), (6, 3), np.array([0.3, 1.0])), ("LOW", (1.6, 1.0), (5, 2), np.zeros(2))
    ):  # fmt: skip
        mesh = cq.rectangle(*size, divisions, element)
        deck.body(name, mesh.mapped(lambda x, corner=corner: x + corner), section=f"{thickness}")
    deck.surface("SLAVE", "UP", "bottom")
    deck.surface("MASTER", "LOW", "top")
    deck.nset("TOP", "UP", "top")
    deck.nset("BOTTOM", "LOW", "bottom")
    deck.pair("NODE TO SURFACE", "LINEAR\n1e9, 1e-6")
    deck.lines += ["*BOUNDARY", "BOTTOM, 1, 2"]
    deck.step += ["*BOUNDARY", "TOP, 1, 1", "TOP, 2, 2, -0.001"]
    return deck.text()


@pytest.mark.sampled(4)
@needs_calculix
@pytest.mark.parametrize("element", ["quad4", "tri3", "quad8", "tri6"])
def test_contact_in_plane_stress_is_judged_on_the_elements_of_calculix(tmp_path: pathlib.Path, element: str) -> None:
    file = write(tmp_path, contact_in_plane_stress(element, 5.0))
    found = cq.crosscheck(file, error_tolerance=1e-3)
    assert found.passed, found.summary()
    plain = cq.solve(cq.read_deck(file).problem()).normal_force.sum()
    assert f"CalculiX's elements have stress across the plane; without it the exact resultant is {plain:.6g}" in (
        found.summary()
    )
    assert found.pairs[0].resultant / plain - 1 > 4e-3  # as thick as five of the squares: no small difference


def prism(kind: str) -> Reference:
    """Return the solid that CalculiX makes of a plane element: its nodes on two or three layers."""
    plane = REFERENCES[SHAPES[kind]]
    quadratic, simplex = len(plane.nodes) > plane.corners, plane.corners == 3
    layers = [*itertools.product((-1, 1), plane.nodes.tolist())]
    layers += [(0, node) for node in plane.nodes[: plane.corners].tolist()] if quadratic else []
    if quadratic and not simplex:
        powers = [p for p in itertools.product(range(3), repeat=3) if sum(one == 2 for one in p) <= 1]
    else:
        powers = [(*p, k) for p in plane.exponents.tolist() for k in (0, 1)]
        powers += [(*p, 2) for p in plane.exponents.tolist() if quadratic and sum(p) <= 1]
    across = gauss(3 if quadratic and not kind.endswith("R") else 2, 1)
    inside = gauss(2, 2) if kind.endswith("R") else plane.rule
    points = [[*p, z] for p in inside.points.tolist() for z in across.points.ravel().tolist()]
    rule = Quadrature(np.array(points), np.outer(inside.weights, across.weights).ravel())
    nodes = np.array([[*node, float(z)] for z, node in layers])
    return Reference("prism", nodes, np.array(powers), 2 * plane.corners, (), "", "", rule, rule)


def stiffness_in_space(kind: Reference, corners: Matrix) -> Matrix:
    """Return the stiffness of one solid: lambda div(v) div(u) + 2 mu e(v):e(u), integrated."""
    geometry = Geometry(kind, corners[None], kind.rule.points)
    volume, G = geometry.determinant[0] * kind.rule.weights, geometry.gradient[0]
    products = np.einsum("q,qia,qjb->iajb", volume, G, G)
    lame_lambda, lame_mu = MODULUS * POISSON / (1 + POISSON) / (1 - 2 * POISSON), MODULUS / 2 / (1 + POISSON)
    K = lame_lambda * products + lame_mu * np.swapaxes(products, 1, 3)
    K += lame_mu * np.einsum("icjc,ab->iajb", products, np.eye(3))
    return K.reshape(corners.size, corners.size)


@pytest.mark.sampled(3)
@needs_calculix
@pytest.mark.parametrize("count", SHAPES)
def test_axisymmetric_elements_are_a_wedge_in_calculix(tmp_path: pathlib.Path, count: str) -> None:
    text = one_element(f"CAX{count}", 1)
    names, theirs = stored(tmp_path, text)
    deck = cq.read_deck(write(tmp_path, text.replace("%s", "*STATIC")))
    at = [names.index(by_number(name)) for name in deck.dof_names]
    theirs = theirs[np.ix_(at, at)]
    points, kind = deck.model.points[:, :2], prism(count)
    plane = len(points)
    place = [*range(plane), *range(plane), *range(len(kind.nodes) - 2 * plane)]
    angle = HALF_WEDGE * kind.nodes[:, 2]
    corners = np.stack([points[place, 0] * np.cos(angle), points[place, 1], -points[place, 0] * np.sin(angle)], axis=1)
    turned = np.zeros((len(place), 3, plane, 2))  # displacements of its nodes from those of the plane
    for node, (there, phi) in enumerate(zip(place, angle.tolist(), strict=True)):
        turned[node, :, there] = [[np.cos(phi), 0.0], [0.0, 1.0], [-np.sin(phi), 0.0]]
    R = turned.reshape(3 * len(place), 2 * plane)
    wedge = -R.T @ stiffness_in_space(kind, corners) @ R  # turned inside out: z points to the left
    assert abs(wedge - theirs).max() <= 1e-10 * abs(theirs).max()
    circle = deck.problem().stiffness.toarray()
    assert abs(circle * HALF_WEDGE / np.pi - theirs).max() <= 3e-4 * abs(theirs).max()


@needs_calculix
@pytest.mark.parametrize("kind", ["T3D2", "T2D2"])
def test_trusses_are_bars_in_calculix_too(tmp_path: pathlib.Path, kind: str) -> None:
    nodes = "*NODE\n1, 0.1, 0.2\n2, 1.2, -0.4" + ("" if kind == "T2D2" else ", 1.7")
    rest = one_element("C3D4", 0).partition("*MATERIAL")[2].replace("=M\n*STEP", "=M\n0.04\n*STEP")
    text = f"{nodes}\n*ELEMENT, TYPE={kind}, ELSET=E\n1, 1, 2\n*MATERIAL{rest}"
    names, theirs = stored(tmp_path, text)
    deck = cq.read_deck(write(tmp_path, text.replace("%s", "*STATIC")))
    ends = onto(theirs, [names.index(f"{node}.{axis}") for node in (1, 2) for axis in (1, 2, 3)])
    at = [(int(name[0]) - 1) * 3 + "xyz".index(name[2]) for name in deck.dof_names]
    bar = deck.problem().stiffness.toarray()
    assert np.linalg.matrix_rank(bar, tol=1e-9 * bar.max()) == 1
    assert abs(bar - ends[np.ix_(at, at)]).max() <= 1e-10 * abs(bar).max()


@pytest.mark.parametrize("dimension", [2, 3])
@needs_calculix
def test_bars_meet_in_hinges_in_calculix_too(tmp_path: pathlib.Path, dimension: int) -> None:
    points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.2], [0.0, 1.0, -0.1], [0.3, 0.4, 1.1], [1.3, 1.4, 1.1]]
    bars = [(1, 4), (2, 4), (3, 4), (4, 5), (2, 5), (3, 5)]
    nodes = [f"{i + 1}, " + ", ".join(f"{x}" for x in point[:dimension]) for i, point in enumerate(points)]
    elements = [f"{i + 1}, {a}, {b}" for i, (a, b) in enumerate(bars)]
    held = [f"{node}, 1, {dimension}" for node in (1, 2, 3)]
    cards = [f"*ELEMENT, TYPE=T{dimension}D2, ELSET=E", *elements, "*MATERIAL, NAME=M", "*ELASTIC", "210000., 0.3"]
    cards += ["*SOLID SECTION, ELSET=E, MATERIAL=M", "4e-4", "*BOUNDARY", *held]
    cards += ["*STEP", "*STATIC", "*CLOAD", "5, 1, 1.", "5, 2, 2.", "*END STEP", ""]
    text = "\n".join(["*NODE, NSET=ALL", *nodes, *cards])
    file = write(tmp_path, text)
    deck = cq.read_deck(file)
    labels, ours = deck.displacements(cq.solve(deck.problem()).displacement)
    theirs, _ = read_displacements(calculix(file, labels, tmp_path / "run", 60.0).results)
    assert abs(theirs.values[:, :dimension] - ours).max() <= 1e-6 * abs(ours).max()


def cantilever(elements: int) -> str:
    """Return a deck of beams, 10 long and 0.2 thick, held at one end, with a force of 1 across the other."""
    nodes = [f"{i + 1}, {10 * i / elements}, 0., 0." for i in range(elements + 1)]
    beams = [f"{i + 1}, {i + 1}, {i + 2}" for i in range(elements)]
    cards = ["*ELEMENT, TYPE=B31, ELSET=E", *beams, "*MATERIAL, NAME=M", "*ELASTIC", f"{MODULUS}, {POISSON}"]
    cards += ["*BEAM SECTION, ELSET=E, MATERIAL=M, SECTION=RECT", "0.2, 0.2", "0., 1., 0.", "*BOUNDARY", "1, 1, 6"]
    cards += ["*STEP", "*STATIC", "*CLOAD", f"{elements + 1}, 3, 1.", "*NODE PRINT, NSET=ALL", "U", "*END STEP", ""]
    return "\n".join(["*NODE, NSET=ALL", *nodes, *cards])


def test_beams_are_refused_as_they_are_solids_in_calculix(tmp_path: pathlib.Path) -> None:
    with pytest.raises(cq.InvalidProblem, match=r"line 9: \*BEAM SECTION: CalculiX makes solids of beams, "):
        cq.read_deck(write(tmp_path, cantilever(1)))
    with pytest.raises(cq.InvalidProblem, match=r"line 4: \*ELEMENT: elements B31: CalculiX makes solids of beams, "):
        cq.read_deck(write(tmp_path, cantilever(1).replace("*BEAM SECTION", "*HEADING")))


@needs_calculix
def test_beams_of_calculix_bend_less_than_beams_do(tmp_path: pathlib.Path) -> None:
    beam = beam_stiffness(MODULUS, 0.2**2, 0.2**4 / 12, np.zeros(2), np.array([10.0, 0.0]))[3:, 3:]
    deflection = np.linalg.solve(np.asarray(beam, dtype=float), [0.0, 1.0, 0.0])[1]
    for elements, part in ((1, 0.75), (4, 0.983)):
        run_calculix(tmp_path, cantilever(elements))
        theirs, _ = read_displacements(tmp_path / "job.dat")
        assert theirs.values[theirs.nodes.tolist().index(elements + 1), 2] == pytest.approx(part * deflection, rel=1e-3)
