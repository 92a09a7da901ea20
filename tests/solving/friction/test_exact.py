"""Coulomb friction against exact numbers: the course chapter's examples with the true law, inclines, elastic blocks."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from contactqp.elements.loads import Traction
from contactqp.elements.material import Material
from contactqp.elements.shapes import rectangle
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from tests.examples import truss
from tests.solving.friction.problems import TOUCH, pad, rough_truss, two_masses

CONVEX = [m for m in cq.methods() if m.installed and m.friction == "convex steps"]

# (mu, slip origin [m], d1x [m], l_N, l_T [kN], status), exact rationals of the printed stiffness rounded to doubles.
STATES = {
    "2.18: slips from the touch point": (0.3, TOUCH, 30058 / 30933965, 180933933661 / 6186793000, 0.3, "slip"),
    "2.18 in one step from zero": (0.3, 0.0, 30058 / 30933965, 180933933661 / 6186793000, 0.3, "slip"),
    "pulled, then pressed": (
        0.3,
        668831 / 598030000,
        668831 / 598030000,
        30.2549928366469910,
        0.0,
        "stick",
    ),
    "slides back": (0.3, 2e-3, 28327 / 22206950, 13917994897 / 444139000, -0.3, "slip"),
    "2.17: stuck at the touch point": (0.8, TOUCH, TOUCH, 180933933661 / 6393286000, 0.6, "stick"),
    "mu = 0.8 in one step from zero": (0.8, 0.0, 0.000747785773213934639, None, 0.8, "slip"),
}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("algorithm", [None, "tresca", "enumeration"])
@pytest.mark.parametrize("name", STATES)
def test_truss_on_a_rough_floor(name: str, algorithm: str | None) -> None:
    friction, origin, moved, force, ratio, status = STATES[name]
    solution = cq.solve(rough_truss(friction, origin), algorithm=algorithm)
    np.testing.assert_allclose(solution.displacement, [moved, -1e-3], rtol=1e-15)
    if force is not None:
        np.testing.assert_allclose(solution.normal_force, force, rtol=1e-14)
    size = solution.normal_force[0]
    np.testing.assert_allclose(solution.friction_force[0, 0], ratio * size, rtol=1e-13, atol=1e-12 * size)
    assert solution.contact_status.tolist() == [status]
    assert solution.certificate.passed
    assert not solution.certificate.proven, "`solve` looks for no bound with friction"
    judged = cq.certify(
        solution.problem, solution.displacement, solution.normal_force, solution.friction_force, solution.tie_force
    )
    assert (judged.proven, judged.scope) == (True, "global")


@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", CONVEX, ids=lambda m: m.name)
def test_every_exact_method_solves_the_convex_steps(method) -> None:
    assert method.exact
    assert method.semidefinite
    solution = cq.solve(rough_truss(), method.name, algorithm="tresca")
    np.testing.assert_allclose(solution.displacement[0], 30058 / 30933965, rtol=1e-15)
    assert solution.method == f"Tresca fixed-point iteration, each step by {method.name}"


def test_the_chapters_own_answer_is_refused() -> None:
    """Example 2.18 as printed: friction pushes along the slip, and 31.337 kN."""
    found = cq.solve(rough_truss())
    printed = cq.certify(rough_truss(), [0.0012755916503617, -1e-3], [31.3370248886], [-9.4011074666])
    assert found.certificate.passed
    assert printed.slip_direction > 1e-2
    assert not printed.passed


# (pull [N], slip origin [m], d1, d2 [m], friction on 1 and 2 [N], status): Example 2.19, true Coulomb.
FAR = (4.6425e-3, 1.419e-2)
PULLS = {
    "below 2.4525 N both stick": (2.4, (0, 0), (0.0, 0.0), (0.0, 2.4), "stick stick"),
    "above it the second slides": (2.5, (0, 0), (0.0, 0.0475e-3), (0.0475, 2.4525), "stick slip"),
    "below 7.3575 N the first still sticks": (7.35, (0, 0), (0.0, 4.8975e-3), (4.8975, 2.4525), "stick slip"),
    "12 N: both slide": (12.0, (0, 0), FAR, (4.905, 2.4525), "slip slip"),
    "unloaded to 7.1 N: stuck": (7.1, FAR, FAR, (4.905, -2.4475), "stick stick"),
    "unloaded to 0: the second slides back": (0.0, FAR, (4.6425e-3, 7.095e-3), (-2.19, -2.4525), "stick slip"),
}


@pytest.mark.sampled(9)
@pytest.mark.parametrize("algorithm", ["tresca", "enumeration"])
@pytest.mark.parametrize("name", PULLS)
def test_two_masses_on_a_rough_floor(name: str, algorithm: str) -> None:
    """Nothing but the floor holds the masses' heights: the stiffness is singular."""
    pull, origin, moved, friction, status = PULLS[name]
    solution = cq.solve(two_masses(pull, origin), algorithm=algorithm)
    np.testing.assert_allclose(solution.displacement, [*moved, 0.0, 0.0], rtol=1e-13, atol=1e-17)
    np.testing.assert_allclose(solution.normal_force, [19.62, 9.81], rtol=1e-14)
    np.testing.assert_allclose(solution.friction_force[:, 0], friction, rtol=1e-12, atol=1e-13)
    assert " ".join(solution.contact_status) == status


@pytest.mark.sampled(3)
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("algorithm", [None, "tresca", "enumeration"])
def test_pad_on_an_incline(sign: float, algorithm: str | None) -> None:
    """N = 12000, mu = 0.3: held by friction alone up to 3600."""
    solution = cq.solve(pad(sign * 3564.0), algorithm=algorithm)
    np.testing.assert_allclose(solution.displacement, 0.0, atol=1e-15)
    np.testing.assert_allclose(solution.friction_force, [[sign * 3564.0]], rtol=1e-15)
    assert solution.contact_status.tolist() == ["stick"]
    held = cq.solve(pad(sign * 3636.0, spring=1000.0), algorithm=algorithm)
    np.testing.assert_allclose(held.displacement[0], sign * 0.036, rtol=1e-12)
    np.testing.assert_allclose(held.friction_force, [[sign * 3600.0]], rtol=1e-15)
    assert held.contact_status.tolist() == ["slip"]


def test_a_motion_that_nothing_holds_is_listed_and_at_rest() -> None:
    """Two pads, the second on ice: no load drives it along the incline, nothing resists it."""
    one = pad(3564.0)
    both = cq.ContactProblem(
        stiffness=np.zeros((4, 4)),
        load=[*one.load, 0.0, -5.0],
        normal=[[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, -1.0]],
        gap=[0.0, 0.0],
        tangent=[[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
        friction=[0.3, 0.0],
        dof_names=["x1", "y1", "x2", "y2"],
    )
    for algorithm in ("tresca", "enumeration"):
        solution = cq.solve(both, algorithm=algorithm)
        assert [str(motion) for motion in solution.free_motions] == ["x2 by +1"]
        np.testing.assert_allclose(solution.displacement, 0.0, atol=1e-15)
        np.testing.assert_allclose(solution.normal_force, [12000.0, 5.0], rtol=1e-15)
    assert cq.solve(one).free_motions == ()


def test_a_pad_that_slides_away_has_no_equilibrium() -> None:
    for algorithm in (None, "enumeration"):
        with pytest.raises(cq.NoEquilibrium, match="drives a rigid motion that no contact, friction or tie holds back"):
            cq.solve(pad(3636.0), algorithm=algorithm)
    assert cq.equilibria(pad(3636.0)) == ()


def test_mirrored_tangents_mirror_the_friction() -> None:
    one = cq.solve(rough_truss())
    other = cq.solve(rough_truss(slip_origin=-TOUCH, tangent=[[-1.0, 0.0]]))
    np.testing.assert_allclose(other.displacement, one.displacement, rtol=1e-15)
    np.testing.assert_allclose(other.friction_force, -one.friction_force, rtol=1e-15)
    np.testing.assert_allclose(other.slip, -one.slip, rtol=1e-12)


def _block(pull: float, side: float, friction: float | None, height: float = 0.5) -> cq.ContactProblem:
    """A block of E = 1, nu = 0 pressed by 0.01 of its height and pulled sideways at its top; shear on its flanks."""
    body = Body(rectangle(1.0, height, (6, 3), "quad4"), Material(modulus=1.0, poisson=0.0), "plane-stress", name="b")
    structure = Structure([body])
    system = structure.assemble(
        [Support("b", "top", 0, pull), Support("b", "top", 1, -0.01 * height)],
        [Traction("b", "right", [0.0, side]), Traction("b", "left", [0.0, -side])],
    )
    floor = cq.pair(structure.surface("b", "bottom"), cq.Plane([0.0, 0.0], [0.0, 1.0]))
    return system.problem([floor], friction=friction)


TRIBUTARY = np.array([0.5, 1, 1, 1, 1, 1, 0.5]) / 6


@pytest.mark.parametrize("shear", [0.0019, 0.004])
def test_block_pressed_and_sheared(shear: float) -> None:
    """Uniform stress: pressure p = 0.01, shear t <= mu p = 0.002. G = 1/2: the top leads by h t/G, the rest is slip."""
    pull, held = 0.5 * shear / 0.5, min(shear, 0.002)
    solution = cq.solve(_block(pull, held, friction=0.2), algorithm="tresca")
    np.testing.assert_allclose(np.sort(solution.normal_force), np.sort(0.01 * TRIBUTARY), rtol=1e-12)
    np.testing.assert_allclose(np.sort(abs(solution.friction_force[:, 0])), np.sort(held * TRIBUTARY), rtol=1e-11)
    np.testing.assert_allclose(abs(solution.slip[:, 0]), (shear - held) * 0.5 / 0.5, rtol=1e-11, atol=1e-15)
    assert set(solution.contact_status) == {"stick" if shear < 0.002 else "slip"}
    assert np.all(solution.friction_force[:, 0] * solution.slip[:, 0] >= 0), "friction never does work on the body"


def test_without_friction_where_it_closes_and_with_so_much_that_nothing_slides() -> None:
    """mu = 0 at all contacts that close is the frictionless answer; mu = 1e6 is that with tangential ties."""
    smooth, rough = _block(0.004, 0.0, friction=None), _block(0.004, 0.0, friction=1e6)
    far = smooth.contacts - 1
    lifted = rough.replace(gap=np.where(np.arange(rough.contacts) == far, 1.0, rough.gap))
    some = lifted.replace(friction=np.where(np.arange(rough.contacts) == far, 0.5, 0.0))
    plain = smooth.replace(gap=lifted.gap)
    np.testing.assert_allclose(cq.solve(some).displacement, cq.solve(plain).displacement, rtol=1e-12, atol=1e-17)
    stuck = cq.solve(rough)
    assert set(stuck.contact_status) == {"stick"}
    tied = cq.solve(cq.ContactProblem(smooth.stiffness, smooth.load, smooth.normal, smooth.gap, tie=rough.tangent))
    np.testing.assert_allclose(stuck.displacement, tied.displacement, rtol=1e-11, atol=1e-15)
    np.testing.assert_allclose(stuck.normal_force, tied.normal_force, rtol=1e-11)
    np.testing.assert_allclose(stuck.friction_force[:, 0], tied.tie_force, rtol=1e-9, atol=1e-13)


@pytest.mark.slow
def test_a_displacement_so_far_out_that_rounding_hides_the_forces_does_not_pass() -> None:
    """Two blocks on an incline, pulled harder than friction holds: there is no equilibrium, however far they slide."""
    along, across = np.array([np.cos(0.3), np.sin(0.3)]), np.array([-np.sin(0.3), np.cos(0.3)])
    spring = 10.0 * np.outer(along, along) + 3.3 * np.outer(across, across)
    K = np.block([[spring, -spring], [-spring, spring]])
    zero = np.zeros(2)
    problem = cq.ContactProblem(
        stiffness=(K + K.T) / 2,
        load=np.r_[-across, along - across],
        normal=[np.r_[-across, zero], np.r_[zero, -across]],
        gap=[0.0, 0.0],
        tangent=[np.r_[along, zero], np.r_[zero, along]],
        friction=0.3,
    )
    for slip in np.logspace(0, 18, 37):
        u = np.r_[slip * along, (slip + 0.07) * along]
        assert not cq.certify(problem, u, [1.0, 1.0], [0.3, 0.3]).passed


@pytest.mark.parametrize("algorithm", ["tresca", "enumeration"])
def test_a_contact_that_cannot_slide_has_no_friction(algorithm: str) -> None:
    """Its tangential unknown is supported: the support takes the load, and what friction would take is nobody's."""
    solution = cq.solve(rough_truss(0.3, 0.0, tangent=[[0.0, 0.0]]), algorithm=algorithm)
    assert solution.certificate.passed
    assert solution.friction_force[0, 0] == 0.0
    np.testing.assert_allclose(solution.normal_force, cq.solve(truss()).normal_force, rtol=1e-15)


@pytest.mark.parametrize("factor", [2.0**-600, 2.0**600])
def test_forces_whose_squares_are_no_doubles(factor: float) -> None:
    problem = rough_truss()
    scaled = problem.replace(stiffness=problem.stiffness * factor, load=problem.load * factor)
    one, other = cq.solve(problem), cq.solve(scaled)
    assert other.certificate.passed
    np.testing.assert_allclose(other.friction_force, one.friction_force * factor, rtol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.3, 5.0])
@pytest.mark.parametrize("pull", [0.0, 0.5, 0.99])
def test_what_does_not_move_at_all_on_an_oblique_plane(pull: float, friction: float) -> None:
    """The plane's normal (-3, 4) / 5 is no axis: what refinement leaves of a zero displacement is no violation."""
    n, t = np.array([-0.6, 0.8]), np.array([0.8, 0.6])
    problem = cq.ContactProblem(
        stiffness=1000.0 * np.outer(t, t),
        load=-12000.0 * n + pull * 3600.0 * t,
        normal=[-n],
        gap=[0.0],
        tangent=[t],
        friction=friction,
    )
    for load in (problem.load, 0.0 * problem.load):
        history = cq.follow_path(problem, loads=[problem.load, load], steps=2)
        assert np.all(history.displacements == 0.0)
        assert history[-1].certificate.passed
    solution = cq.solve(problem)
    assert np.all(solution.displacement == 0.0)
    assert solution.contact_status.tolist() == ["stick"]
    np.testing.assert_allclose(solution.friction_force[0, 0], pull * 3600.0, rtol=1e-14, atol=1e-9)
