"""Bars at large displacements: exact rationals, gradients and Hessians, rigid motions, and two forms that agree."""

from fractions import Fraction as F

import numpy as np
import pytest

from contactqp.elements.deformable import Deformable
from contactqp.elements.nonlinear_truss import LAWS, VOLUMES, GreenLaw, NonlinearTruss, UpdatedTruss
from contactqp.errors import InvalidProblem
from tests.elements.derivatives import check_derivatives

# The bar from (0, 0) to (1, 0), E A0 = 1, its end moved by (1/5, 1/2): exact values of the energy's derivatives.
TEST_BAR = np.array([0.0, 0.0, 0.2, 0.5])
STRAIN = F(69, 200)
FORCE = [F(-207, 500), F(-69, 400), F(207, 500), F(69, 400)]
BLOCK = [[F(357, 200), F(3, 5)], [F(3, 5), F(119, 200)]]
# What the course chapter prints, with half of d'H: no gradient of any energy, and out of balance about node 1.
PRINTED_FORCE = [F(-759, 2000), F(-69, 800), F(759, 2000), F(69, 800)]


def course_bar():
    return NonlinearTruss([[0, 0], [1, 0]], [[0, 1]], modulus=1.0, area=1.0)


def random_truss(dimension, law="green", seed=0):
    """Six nodes, all joined, of random places, moduli and areas."""
    random = np.random.default_rng(seed)
    bars = np.array([(i, j) for i in range(6) for j in range(i)])
    nodes = random.uniform(-1, 1, (6, dimension))
    return NonlinearTruss(nodes, bars, random.uniform(0.5, 2, len(bars)), random.uniform(0.5, 2, len(bars)), law)


def moved(body, amplitude=0.2, seed=1):
    return amplitude * np.random.default_rng(seed).uniform(-1, 1, body.dimension)


def rotation(dimension, angle):
    turn = np.eye(dimension)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    if dimension == 3:
        tilt = np.array([[1, 0, 0], [0, np.cos(1.1), -np.sin(1.1)], [0, np.sin(1.1), np.cos(1.1)]])
        turn = tilt @ turn @ tilt.T
    return turn


def test_the_bar_of_the_course_has_its_exact_strain_force_and_tangent():
    bar = course_bar()
    np.testing.assert_allclose(bar.strain(TEST_BAR), [float(STRAIN)], rtol=1e-15)
    np.testing.assert_allclose(bar.internal_force(TEST_BAR), np.array(FORCE, dtype=float), rtol=1e-15)
    block = np.array(BLOCK, dtype=float)
    K = np.block([[block, -block], [-block, block]])
    np.testing.assert_allclose(bar.tangent(TEST_BAR).toarray(), K, rtol=1e-15)
    assert bar.energy(TEST_BAR) == pytest.approx(float(STRAIN**2 / 2), rel=1e-15)


def test_the_printed_force_is_out_of_balance_and_ours_is_not():
    x = np.array([[0, 0], [F(6, 5), F(1, 2)]])
    moment = [x[1, 0] * f[3] - x[1, 1] * f[2] for f in (FORCE, PRINTED_FORCE)]
    assert moment == [0, F(-69, 800)]
    assert not np.allclose(course_bar().internal_force(TEST_BAR), np.array(PRINTED_FORCE, dtype=float), rtol=1e-3)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("dimension", [2, 3])
def test_force_and_tangent_are_the_derivatives_of_the_energy(dimension, law):
    truss = random_truss(dimension, law)
    check_derivatives(truss, moved(truss))
    check_derivatives(UpdatedTruss(truss), moved(truss))


def test_the_check_of_derivatives_fails_on_half_of_the_quadratic_term():
    class Printed(NonlinearTruss):
        def internal_force(self, displacement):
            half = np.asarray(displacement) / 2
            return (self.summed(self.area * self.stress(displacement) / self.length * self._bars_now(half))).ravel()

    bar = Printed([[0, 0], [1, 0]], [[0, 1]], modulus=1.0, area=1.0)
    np.testing.assert_allclose(bar.internal_force(TEST_BAR), np.array(PRINTED_FORCE, dtype=float), rtol=1e-15)
    with pytest.raises(AssertionError):
        check_derivatives(bar, TEST_BAR)
    with pytest.raises(AssertionError, match="shows nothing"):
        check_derivatives(course_bar(), np.zeros(4))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("volume", VOLUMES)
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("dimension", [2, 3])
def test_total_and_updated_lagrangian_agree(dimension, law, volume):
    truss = random_truss(dimension, law, seed=3)
    updated = UpdatedTruss(truss, volume)
    u = moved(truss, 0.5, seed=4)
    force, K = truss.internal_force(u), truss.tangent(u).toarray()
    np.testing.assert_allclose(updated.internal_force(u), force, rtol=0, atol=1e-13 * np.abs(force).max())
    np.testing.assert_allclose(updated.tangent(u).toarray(), K, rtol=0, atol=1e-13 * np.abs(K).max())
    assert updated.energy(u) == pytest.approx(truss.energy(u), rel=1e-13)
    np.testing.assert_allclose(updated.area(u) * updated.cauchy_stress(u), truss.axial_force(u), rtol=1e-12)


def test_the_cauchy_stress_is_the_pushed_forward_modulus_times_almansis_strain():
    truss = random_truss(2)
    u = moved(truss)
    for volume in VOLUMES:
        updated = UpdatedTruss(truss, volume)
        L, area = updated.length(u), updated.area(u)
        E = np.asarray(truss.modulus) * np.asarray(truss.area) / area * (L / truss.length) ** 3
        np.testing.assert_allclose(updated.current_modulus(u), E, rtol=1e-12)
        np.testing.assert_allclose(updated.cauchy_stress(u), E * updated.almansi_strain(u), rtol=1e-11)
    assert np.ptp(updated.cauchy_stress(u) / UpdatedTruss(truss).cauchy_stress(u)) > 0.1  # the volume laws differ


@pytest.mark.sampled(7)
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("angle", [0.3, np.pi / 2, 2.0, np.pi, 5.0])
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_rigid_rotation_costs_nothing(dimension, angle, law):
    truss = random_truss(dimension, law)
    X = truss.nodes
    u = (X @ rotation(dimension, angle).T - X + np.arange(dimension)).ravel()
    eps = np.finfo(float).eps
    stiff = float(np.sum(truss.modulus * truss.area * truss.length))
    for body in (truss, UpdatedTruss(truss)):
        assert 0 <= body.energy(u) <= (64 * eps) ** 2 * stiff
        assert np.abs(body.internal_force(u)).max() <= 64 * eps * stiff / truss.length.min()
    assert truss.energy(moved(truss)) > 1e-3


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("dimension", [2, 3])
def test_forces_and_tangents_turn_with_the_body(dimension, law):
    """Frame indifference: f(Q x) = Q f(x), K(Q x) = Q K(x) Q'."""
    truss = random_truss(dimension, law)
    u, Q = moved(truss), rotation(dimension, 2.5)
    turned = (truss.positions(u) @ Q.T - truss.nodes).ravel()
    turn = np.kron(np.eye(len(truss.nodes)), Q)
    assert truss.energy(turned) == pytest.approx(truss.energy(u), rel=1e-13)
    np.testing.assert_allclose(truss.internal_force(turned), turn @ truss.internal_force(u), atol=1e-13)
    np.testing.assert_allclose(truss.tangent(turned).toarray(), turn @ truss.tangent(u) @ turn.T, atol=1e-12)


@pytest.mark.parametrize("law", LAWS)
def test_forces_balance(law):
    truss = random_truss(2, law)
    u = moved(truss, 0.5)
    f, x = truss.internal_force(u).reshape(-1, 2), truss.positions(u)
    assert np.abs(f.sum(axis=0)).max() <= 1e-13 * np.abs(f).max()
    assert abs(np.sum(x[:, 0] * f[:, 1] - x[:, 1] * f[:, 0])) <= 1e-13 * np.abs(f).max()


def test_laws_of_a_stretched_bar_by_hand():
    """A bar of length 1 and E A0 = 2, drawn to 3/2."""
    u = np.array([0, 0, 0.5, 0])
    forces = {"green": 2 * 0.625 * 1.5, "engineering": 1.0, "logarithmic": 2 * np.log(1.5) / 1.5}
    energies = {"green": 0.625**2, "engineering": 0.25, "logarithmic": np.log(1.5) ** 2}
    for law in LAWS:
        truss = NonlinearTruss([[0, 0], [1, 0]], [[0, 1]], modulus=4.0, area=0.5, law=law)
        np.testing.assert_allclose(truss.axial_force(u), [forces[law]], rtol=1e-15)
        assert truss.energy(u) == pytest.approx(energies[law], rel=1e-15)


def test_at_rest_the_tangent_is_the_linear_truss():
    from contactqp.elements.members import truss_stiffness

    start, end = np.array([0.2, -0.1]), np.array([1.0, 0.7])
    K = NonlinearTruss([start, end], [[0, 1]], 3.0, 2.0).tangent(np.zeros(4)).toarray()
    np.testing.assert_allclose(K, truss_stiffness(3.0, 2.0, start, end), rtol=1e-14)


def test_a_bar_that_shrinks_to_a_point_is_refused_where_its_law_cannot_bear_it():
    gone = np.array([0.0, 0.0, -1.0, 0.0])
    assert course_bar().energy(gone) == 0.125
    for law in ("engineering", "logarithmic"):
        bar = NonlinearTruss([[0, 0], [1, 0]], [[0, 1]], 1.0, 1.0, law)
        assert bar.energy(gone) == np.inf
        with pytest.raises(InvalidProblem, match="bar 0 has shrunk to a point"):
            bar.internal_force(gone)
    assert UpdatedTruss(course_bar()).energy(gone) == np.inf
    with pytest.raises(InvalidProblem, match="no direction"):
        UpdatedTruss(course_bar()).tangent(gone)


def test_small_displacements_keep_their_digits():
    """A bar drawn by 1e-12 of its length: the strain is not the difference of two squares of lengths."""
    assert course_bar().strain([0, 0, 1e-12, 0])[0] == pytest.approx(1e-12, rel=1e-11)


def test_a_truss_is_deformable_and_takes_laws_of_ones_own():
    own = NonlinearTruss([[0, 0], [1, 0]], [[0, 1]], 1.0, 1.0, GreenLaw())
    assert isinstance(own, Deformable)
    assert isinstance(UpdatedTruss(own), Deformable)
    np.testing.assert_array_equal(own.internal_force(TEST_BAR), course_bar().internal_force(TEST_BAR))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(nodes=[[0.0], [1.0]]), r"shape \(N, 2\)"),
        (dict(bars=[[0, 2]]), "nodes from 0 to 1"),
        (dict(bars=[[0.0, 1.0]]), "whole numbers"),
        (dict(nodes=[[1.0, 0.0], [1.0, 0.0]]), "at one place"),
        (dict(modulus=-1.0), "positive"),
        (dict(area=[1.0, 2.0]), r"shape \(1,\)"),
        (dict(law="grean"), "green, engineering"),
    ],
)
def test_bad_trusses_are_refused(change, message):
    data = dict(nodes=[[0.0, 0.0], [1.0, 0.0]], bars=[[0, 1]], modulus=1.0, area=1.0)
    with pytest.raises(InvalidProblem, match=message):
        NonlinearTruss(**(data | change))


@pytest.mark.slow
def test_many_bars_are_one_sparse_matrix():
    """A chain of 1e5 bars: (2 + 1) pairs a node, in a second."""
    n = 100_001
    nodes = np.stack([np.arange(n), np.zeros(n)], axis=1)
    bars = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
    chain = NonlinearTruss(nodes, bars, 1.0, 1.0)
    K = chain.tangent(np.zeros(2 * n))
    assert K.nnz <= 4 * (3 * n - 2)
    with pytest.raises(InvalidProblem, match="displacement: expected shape"):
        chain.tangent(np.zeros(3))
    with pytest.raises(InvalidProblem, match="volume: expected one of"):
        UpdatedTruss(chain, "isotropic")
