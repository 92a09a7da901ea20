"""One condensed problem of an elastic body by every installed method: one answer, or a certificate that says it is not.

A block pressed on a paraboloid, plane and solid, some contacts closed and some open; and the same resting on contact
alone. The reference is the active set's answer, whose certificate proves its distance from the truth.
"""

import numpy as np
import pytest

import contactqp as cq
from contactqp.elements.loads import Traction
from contactqp.elements.material import Material
from contactqp.elements.shapes import box, rectangle
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support

METHODS = [method for method in cq.methods() if method.installed]
EXACT = [method.name for method in METHODS if method.exact]
APPROXIMATE = [method for method in METHODS if not method.exact]
RAW = [method.name for method in METHODS if method.exact and method.polish and method.kind != "active set"]


def pressed(dimension, floating=False):
    """A block with its top moved down by 0.02, or under a traction and held sideways only."""
    steel = Material(1.0, 0.3)
    if dimension == 2:
        body = Body(rectangle(1.0, 0.5, (12, 4)), steel, "plane-strain", name="block")
        paraboloid = cq.Paraboloid([0.5, 0.0], [0.0, 1.0], 2.0)
    else:
        body = Body(box((1.0, 1.0, 0.5), (5, 5, 2)), steel, "3d", name="block")
        paraboloid = cq.Paraboloid([0.5, 0.5, 0.0], [0.0, 0.0, 1.0], 2.0)
    structure, up = Structure([body]), dimension - 1
    if floating:
        held = [Support("block", side, axis) for axis, side in enumerate(("left", "front")[:up])]
        load = [Traction("block", "top", [0.0] * up + [-0.03])]
    else:
        held = [Support("block", "top", axis, -0.02 if axis == up else 0.0) for axis in range(dimension)]
        load = []
    return structure.assemble(held, load).problem([cq.pair(structure.surface("block", "bottom"), paraboloid)])


PROBLEMS = {d: pressed(d) for d in (2, 3)}
REFERENCES = {d: cq.solve(problem) for d, problem in PROBLEMS.items()}


def error(found, reference):
    """Of the forces, relative to the largest."""
    return np.abs(found - reference.normal_force).max() / reference.normal_force.max()


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_reference_is_proven_and_not_trivial(dimension):
    problem, reference = PROBLEMS[dimension], REFERENCES[dimension]
    closed = reference.normal_force > 0
    assert 3 <= closed.sum() <= problem.contacts - 3
    assert reference.certificate.passed
    assert reference.certificate.proven
    assert reference.certificate.force_bound.max() < 1e-12 * reference.normal_force.max()
    assert reference.work.retained < problem.dimension, "the methods see the condensed problem"


@pytest.mark.sampled(9)
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("method", EXACT)
def test_every_exact_method_gives_the_one_answer(method, dimension):
    solution = cq.solve(PROBLEMS[dimension], method=method)
    assert solution.certificate.passed
    assert error(solution.normal_force, REFERENCES[dimension]) < 1e-9
    scale = np.abs(REFERENCES[dimension].displacement).max()
    assert np.abs(solution.displacement - REFERENCES[dimension].displacement).max() < 1e-9 * scale


@pytest.mark.sampled(9)
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("method", RAW)
def test_a_raw_answer_is_near_or_its_certificate_says_that_it_is_not(method, dimension):
    """Before polish backends stop at their tolerance; whatever passes is near, and whatever is far does not pass."""
    solution = cq.solve(PROBLEMS[dimension], method=method, tolerance=1e-4)
    raw = solution.raw
    assert raw is not None
    off = error(raw.normal_force, REFERENCES[dimension])
    assert off < 1e-5 or not raw.certificate.passed
    if raw.certificate.force_bound is not None:
        missed = np.abs(raw.normal_force - REFERENCES[dimension].normal_force)
        assert np.all(missed <= raw.certificate.force_bound + 1e-12 * REFERENCES[dimension].normal_force.max())


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("method", APPROXIMATE, ids=lambda method: method.name)
def test_an_approximate_method_is_off_and_its_certificate_says_by_how_much(method, dimension):
    (knob,) = method.required
    reference = REFERENCES[dimension]
    solution = cq.solve(PROBLEMS[dimension], method=method.name, **{knob: 100.0})
    assert error(solution.normal_force, reference) > 1e-4
    assert not solution.certificate.passed
    assert any("penetration" in failure for failure in solution.certificate.failures)
    missed = np.abs(solution.normal_force - reference.normal_force)
    assert np.all(missed <= solution.certificate.force_bound * (1 + 1e-9))


def test_a_coarse_raw_answer_is_refused():
    raw = cq.solve(PROBLEMS[2], method="osqp", tolerance=1e-4).raw
    assert error(raw.normal_force, REFERENCES[2]) > 1e-6
    assert raw.claimed
    assert not raw.certificate.passed


@pytest.mark.sampled(15)
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("method", EXACT)
def test_a_body_that_contact_alone_holds_up(method, dimension):
    """The one answer, or the method says that it does not take a singular stiffness."""
    problem = pressed(dimension, floating=True)
    if not next(entry for entry in METHODS if entry.name == method).semidefinite:
        with pytest.raises(cq.Unsupported, match="singular"):
            cq.solve(problem, method=method)
        return
    reference = cq.solve(problem)
    assert np.isclose(reference.normal_force.sum(), 0.03, rtol=1e-12), "the traction on a top of area 1"
    assert error(cq.solve(problem, method=method).normal_force, reference) < 1e-9
