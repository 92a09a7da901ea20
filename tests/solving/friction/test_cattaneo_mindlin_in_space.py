"""Cattaneo's and Mindlin's partial slip of a sphere: an elastic block on a rigid paraboloid, pressed and then pushed.

Half of the block by its plane of symmetry. It is pressed without friction, and slips count from where that leaves it:
pressing makes no shear. By the sphere's formulas (Johnson 1985, section 7.2), with a and p0 of Hertz,

    c / a = (1 - Q / (mu P))^(1/3),    q = mu p0 (sqrt(1 - r^2/a^2) - c/a sqrt(1 - r^2/c^2)),

the last term inside of c only. Q and P are those of the answer itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

import contactqp as cq
from contactqp.elements.material import Material
from contactqp.elements.shapes import box
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from contactqp.linalg import multigrid
from contactqp.linalg.pardiso import SOLVER_VARIABLE

FRICTION, RADIUS, MODULUS, POISSON = 0.4, 10.0, 21000.0, 0.3
# Half of the largest size of an element within the contact [mm].
ELEMENT = 0.1


def pushed(sideways: float, cells: tuple[int, int, int] = (8, 20, 7)) -> tuple[cq.ContactProblem, np.ndarray]:
    """The block, its top pressed down and moved along y, and the places of its contacts."""
    shape = box(
        (4.0, 8.0, 4.0), cells, "hex8", grading=14.0, towards=("left", "middle", "bottom"), corner=(0.0, -4.0, 0.0)
    )
    structure = Structure([Body(shape, Material(MODULUS, POISSON), "3d", name="b")])
    held = [Support("b", "left", 0), Support("b", "top", 1, sideways), Support("b", "top", 2, -0.035)]
    surface = structure.surface("b", "bottom")
    pairing = cq.pair(surface, cq.Paraboloid([0.0, 0.0, 0.0], [0.0, 0.0, 1.0], RADIUS))
    foot = surface.points[np.unique(surface.facets)]
    near = np.flatnonzero(np.hypot(foot[:, 0], foot[:, 1]) < 1.0)
    problem = structure.assemble(held).problem([pairing], friction=FRICTION)
    return problem.with_contacts(near), foot[near]


@dataclass(frozen=True)
class Partly:
    """The answer in partial slip, and what the sphere's formulas make of its P and Q."""

    solution: cq.Solution
    radius: np.ndarray  # (m,) of the contacts' places
    load: float  # P on the whole block
    driven: float  # Q / (mu P)

    @property
    def a(self) -> float:
        return float((3 * self.load * RADIUS / (4 * MODULUS / (1 - POISSON**2))) ** (1 / 3))

    @property
    def c(self) -> float:
        return float(self.a * (1 - self.driven) ** (1 / 3))

    def ratio(self, radius: np.ndarray) -> np.ndarray:
        """q / p at radii below a."""
        inner = np.sqrt(np.maximum(0.0, 1 - radius**2 / self.c**2))
        return FRICTION * (1 - self.c / self.a * inner / np.sqrt(1 - radius**2 / self.a**2))


@pytest.fixture(scope="module", params=[0.006, 0.010, 0.012])
def partly(request: pytest.FixtureRequest) -> Partly:
    return partial_slip(request.param)


def partial_slip(sideways: float, cells: tuple[int, int, int] = (8, 20, 7)) -> Partly:
    problem, places = pushed(0.0, cells)
    pressed = cq.solve(problem.replace(friction=np.zeros(problem.contacts)))
    assert problem.tangent is not None
    origin = (problem.tangent @ pressed.displacement).reshape(-1, 2)
    solution = cq.solve(problem.replace(load=pushed(sideways, cells)[0].load, slip_origin=origin))
    assert solution.friction_force is not None
    P, Q = 2 * solution.normal_force.sum(), 2 * solution.friction_force[:, 1].sum()
    return Partly(solution, np.hypot(places[:, 0], places[:, 1]), float(P), float(Q / (FRICTION * P)))


@pytest.mark.slow
def test_the_circle_that_sticks(partly: Partly) -> None:
    """To half of an element: all inside of c sticks, nothing does that is nearer to the rim."""
    assert 0.4 < partly.driven < 0.9
    sticks, slips = (partly.radius[partly.solution.contact_status == state] for state in ("stick", "slip"))
    assert np.min(slips) > partly.c - ELEMENT
    assert np.max(sticks) < partly.c + ELEMENT
    assert np.max(partly.radius[partly.solution.normal_force > 0]) < partly.a + ELEMENT


@pytest.mark.slow
@pytest.mark.sampled(3)
def test_the_traction_along_the_push(partly: Partly) -> None:
    """q / p at the nodes, to 4 % of mu in the middle, where no element straddles a rim.

    The formula has all tractions parallel. Slip is not quite, by a part that grows with nu (Johnson 1985, section 7.2):
    at the rim some 13 % of mu act across the push, in the middle under 2 %.
    """
    force, pressed = partly.solution.friction_force, partly.solution.normal_force
    along, across = (force[pressed > 0, k] / pressed[pressed > 0] for k in (1, 0))
    radius = partly.radius[pressed > 0]
    middle = radius < 0.55 * partly.c
    assert np.count_nonzero(middle) > 2
    np.testing.assert_allclose(along[middle], partly.ratio(radius[middle]), atol=0.04 * FRICTION)
    slides = (radius > partly.c + ELEMENT) & (radius < partly.a)
    np.testing.assert_allclose(along[slides], FRICTION, rtol=0.01)
    assert np.max(abs(across[middle])) < 0.02 * FRICTION
    assert 0.05 * FRICTION < np.max(abs(across)) < 0.15 * FRICTION
    assert partly.solution.certificate.passed


@pytest.mark.sampled(3)
def test_the_formula_tells_partial_slip_from_sticking(partly: Partly) -> None:
    """Without the inner term, or with that of a cylinder (a square root), the middle would be off by far more."""
    right = partly.ratio(np.zeros(1))[0]
    cylinder = FRICTION * (1 - np.sqrt(1 - partly.driven))
    assert abs(right - FRICTION) > 0.2 * FRICTION
    assert abs(right - cylinder) > 0.05 * FRICTION


@pytest.mark.slow
@pytest.mark.parametrize("by", ["factors", "iteration"])
@pytest.mark.parametrize(
    ("cells", "element", "most"), [((8, 20, 7), 0.095, 0.04), ((12, 30, 10), 0.065, 0.02), ((16, 40, 14), 0.05, 0.02)]
)
def test_partial_slip_comes_to_the_formula_as_elements_become_smaller(
    monkeypatch: pytest.MonkeyPatch, cells: tuple[int, int, int], element: float, most: float, by: str
) -> None:
    """3990, 12 152 and 29 356 unknowns: both circles to an element, and what is left of mu in the middle."""
    if by == "iteration":
        if not multigrid.available():
            pytest.skip("needs pyamg")
        monkeypatch.setenv(SOLVER_VARIABLE, "pyamg")
    found = partial_slip(0.010, cells)
    solution, radius = found.solution, found.radius
    assert (solution.work.solver == "pyamg") == (by == "iteration")
    assert solution.certificate.passed
    sticks, slips = (radius[solution.contact_status == state] for state in ("stick", "slip"))
    assert found.c - element < np.min(slips)
    assert np.max(sticks) < found.c + element
    pressed = solution.normal_force > 0
    assert found.a - element < np.max(radius[pressed]) < found.a + element
    middle = pressed & (radius < 0.55 * found.c)
    assert solution.friction_force is not None
    along = solution.friction_force[middle, 1] / solution.normal_force[middle]
    assert np.max(abs(along - found.ratio(radius[middle]))) < most * FRICTION
