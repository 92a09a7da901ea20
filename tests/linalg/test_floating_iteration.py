"""Bodies that contacts alone hold, solved without a factorisation: the answers of the factorising way, and refusals."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.elements.material import Material
from contactqp.elements.shapes import box
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from contactqp.linalg import multigrid
from contactqp.linalg.iteration import iterated
from contactqp.linalg.pardiso import SOLVER_VARIABLE
from tests.blocks_in_space import fresh

pytestmark = pytest.mark.skipif(not multigrid.available(), reason="needs pyamg")


def _block(name, cells, size, low=0.0, modulus=1.0):
    return Body(box(size, cells, "hex8", corner=(0.0, 0.0, low)), Material(modulus, 0.3), "3d", name=name)


def _pressed(body, weight, tilt):
    """Forces on the top of a body, `tilt` of which grow along x."""
    points, force = body.mesh.points, np.zeros(body.size)
    top = np.flatnonzero(points[:, 2] >= np.max(points[:, 2]) - 1e-9 * np.ptp(points[:, 2]))
    share = 1 + tilt * (2 * points[top, 0] / np.ptp(points[:, 0]) - 1)
    force[3 * top + 2] = -weight * share / np.sum(share)
    return force


def free_block(cells=(11, 11, 6), size=(1.0, 1.0, 0.5), modulus=1.0, weight=0.02, tilt=0.3, below=0.0, held=()):
    """A block pressed on a paraboloid, with nothing else that holds it, or two planes of symmetry."""
    body = _block("block", cells, size, modulus=modulus)
    structure = Structure([body])
    assembled = structure.assemble([Support("block", side, axis) for axis, side in enumerate(held)])
    centre = (0.0 if held else size[0] / 2, 0.0 if held else size[1] / 2, -below)
    pair = cq.pair(structure.surface("block", "bottom"), cq.Paraboloid(centre, [0.0, 0.0, 1.0], 5.0 * size[0]))
    problem = assembled.problem([pair], friction=0.0)
    return problem.replace(load=_pressed(body, weight, tilt)[assembled.free])


def stack(supported, friction=0.0):
    """Blocks with flat faces and other meshes, one on the other; the lowest is supported or lies on a flat obstacle."""
    bodies = [_block(f"b{i}", (9 - i, 8 - i, 4), (1.0, 1.0, 0.4), low=0.4 * i, modulus=1.0 + i) for i in range(3)]
    structure = Structure(bodies)
    assembled = structure.assemble([Support("b0", "bottom", axis) for axis in range(3)] if supported else [])
    pairs = [
        cq.pair_mortar(
            structure.surface(f"b{i + 1}", "bottom"), structure.surface(f"b{i}", "top"), dimension=structure.size
        )
        for i in range(2)
    ]
    if not supported:
        ground = cq.Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
        pairs.append(cq.pair(structure.surface("b0", "bottom"), ground, dimension=structure.size))
    force = np.concatenate([np.zeros(bodies[0].size + bodies[1].size), _pressed(bodies[2], 0.02, 0.2)])
    return assembled.problem(pairs, friction=friction).replace(load=force[assembled.free])


PROBLEMS = {
    "free": free_block,
    "free along z": lambda: free_block(held=("left", "front"), tilt=0.0),
    "steel in mm and N": lambda: free_block(size=(100.0, 100.0, 50.0), modulus=210e3, weight=1e5),
    "micrometres and uN": lambda: free_block(size=(50.0, 50.0, 25.0), modulus=70e3, weight=1e6),
    "tall and slender": lambda: free_block((5, 5, 60), (1.0, 1.0, 12.0), weight=0.005, tilt=0.05),
    "far above the obstacle": lambda: free_block(below=100.0),
    "a stack": lambda: stack(supported=False),
    "a stack on a supported body": lambda: stack(supported=True),
}


def _by(solver, problem, monkeypatch):
    monkeypatch.setenv(SOLVER_VARIABLE, solver)
    return cq.solve(fresh(problem))


@pytest.mark.sampled(8)
@pytest.mark.parametrize("name", PROBLEMS)
def test_the_answer_is_that_of_the_factorising_way(name, monkeypatch):
    problem = PROBLEMS[name]()
    reference, found = (_by(solver, problem, monkeypatch) for solver in ("superlu", "pyamg"))
    certificate = found.certificate
    assert certificate.passed
    assert not certificate.proven, "an estimate is no proof"
    assert certificate.balance <= 1e-13
    assert found.work.solver == "pyamg"
    assert found.work.factorisations == 0
    push = np.max(reference.normal_force)
    assert np.max(abs(found.normal_force - reference.normal_force)) <= 1e-8 * push
    assert np.max(abs(found.displacement - reference.displacement)) <= 1e-7 * np.max(abs(reference.displacement))
    assert found.contact_status.tolist() == reference.contact_status.tolist()
    assert len(found.free_motions) == len(reference.free_motions)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["free", "free along z", "a stack"])
def test_a_force_a_hundredth_off_is_refused(name, monkeypatch):
    problem = PROBLEMS[name]()
    found = _by("pyamg", problem, monkeypatch)
    largest = int(np.argmax(found.normal_force))
    forged = found.normal_force.copy()
    forged[largest] *= 1.01
    assert not cq.certify(problem, found.displacement, forged).passed
    shared = forged.copy()  # its resultant taken from the others
    shared[forged > 0] *= np.sum(found.normal_force) / np.sum(forged)
    assert not cq.certify(problem, found.displacement, shared).passed
    other = cq.solve(problem.replace(load=1.01 * problem.load))
    assert not cq.certify(problem, other.displacement, other.normal_force).passed


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_load_that_nothing_holds_is_refused_in_the_same_words(friction, monkeypatch):
    lifted = free_block((8, 8, 4))
    problem = lifted.replace(load=-lifted.load, friction=friction)
    messages = []
    for solver in ("superlu", "pyamg"):
        with pytest.raises(cq.NoEquilibrium) as caught:
            _by(solver, problem, monkeypatch)
        messages.append(str(caught.value))
    assert messages[0] == messages[1]


@pytest.mark.slow
@pytest.mark.parametrize("problem", [free_block((10, 10, 5)), stack(supported=False)], ids=["free", "a stack"])
def test_with_friction_too(problem, monkeypatch):
    rubbing = problem.replace(friction=0.3)
    reference, found = (_by(solver, rubbing, monkeypatch) for solver in ("superlu", "pyamg"))
    assert found.certificate.passed
    assert found.certificate.basis == "state"
    push = np.max(reference.normal_force)
    assert np.max(abs(found.normal_force - reference.normal_force)) <= 1e-8 * push
    assert np.max(abs(found.friction_force - reference.friction_force)) <= 1e-8 * push
    assert len(found.free_motions) == len(reference.free_motions)
    forged = found.friction_force.copy()
    forged[int(np.argmax(np.linalg.norm(forged, axis=1)))] *= 0.99
    assert not cq.certify(rubbing, found.displacement, found.normal_force, forged).passed


@pytest.fixture
def large(monkeypatch):
    monkeypatch.delenv(SOLVER_VARIABLE, raising=False)
    monkeypatch.setattr("contactqp.linalg.iteration.MOST_OPERATIONS", 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("by", ["pardiso", "superlu"])
@pytest.mark.usefixtures("large")
def test_a_large_body_is_iterated_on_where_its_motions_are_stated(monkeypatch, by):
    monkeypatch.setattr("contactqp.linalg.pardiso.available", lambda: by == "pardiso")
    free = free_block((8, 8, 4))
    assert iterated(free)
    assert cq.solve(free).work.solver == "pyamg"
    unstated = fresh(free).replace(near_null_space=None)
    assert not iterated(unstated)
    found = cq.solve(unstated)
    assert found.certificate.proven
    assert found.work.factorisations > 0
    if by == "superlu":  # which does not tell beforehand what memory it takes
        monkeypatch.setattr("contactqp.linalg.iteration.LARGEST_BY_SUPERLU", 1)
        with pytest.raises(cq.Unsupported, match="floats"):
            cq.solve(fresh(unstated))


def test_a_body_whose_motions_nobody_states_is_refused_in_words(monkeypatch):
    monkeypatch.setenv(SOLVER_VARIABLE, "pyamg")
    problem = fresh(free_block((6, 6, 4))).replace(near_null_space=None)
    words = r"block node 0 x floats.*near_null_space states 0 of 3 as rigid.*CONTACTQP_SPARSE_SOLVER=pardiso"
    with pytest.raises(cq.Unsupported, match=words):
        cq.solve(problem)
    with pytest.raises(cq.Unsupported, match="floats"):
        cq.certify(problem, np.zeros(problem.dimension), np.zeros(problem.contacts))


@pytest.mark.usefixtures("large")
def test_a_soft_spring_is_no_rigid_motion():
    free = free_block((8, 8, 4))
    spring = sp.csr_array(([1e-11], ([2], [2])), shape=free.stiffness.shape)
    held = free.replace(stiffness=free.stiffness + spring)
    assert not iterated(held)


@pytest.mark.slow
@pytest.mark.usefixtures("large")
def test_where_stated_motions_are_not_all_the_body_is_factorised_after_all():
    free = free_block((8, 8, 4))
    some = fresh(free).replace(near_null_space=free.near_null_space[:, :3])
    found = cq.solve(some)
    assert found.certificate.passed
    reference = cq.solve(free)
    assert found.normal_force == pytest.approx(reference.normal_force, abs=1e-8 * np.max(reference.normal_force))


@pytest.mark.slow
@pytest.mark.usefixtures("large")
def test_derivatives_of_an_answer_by_iteration_factorise_the_body(monkeypatch):
    monkeypatch.setattr("contactqp.linalg.pardiso.available", lambda: True)
    free = free_block((8, 8, 4), held=("left", "front"), tilt=0.0)
    found = cq.solve(free)
    assert found.work.solver == "pyamg"
    rate = found.derivative("normal_force", with_respect_to="load", direction=free.load).value
    heavier = cq.solve(fresh(free.replace(load=1.001 * free.load)))
    change = (heavier.normal_force - found.normal_force) / 0.001
    assert rate == pytest.approx(change, rel=0.05, abs=0.01 * np.max(abs(rate)))
