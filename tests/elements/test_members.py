"""Bars, trusses, springs, beams and strings: exact numbers stay exact, forces balance, rigid motions cost nothing.

A beam is compared with the textbook's cantilevers in every direction, a string with a wire over a floor. A wire of
length L under the tension T and a load b per length hangs at a height d over a floor. It touches from
x_1 = sqrt(2 T d / b) on. On elements of length h it touches from the node X on, X (X - h) <= x_1^2 <= X (X + h): the
node before does not penetrate, and X is not pulled. Up to X the nodes lie on w = b x^2 / (2 T) - R x / T with the end
reaction R = T d / X + b X / 2 = b x_1 + b (X - x_1)^2 / (2 X).
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction as F
from typing import NamedTuple

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st

import contactqp as cq
from contactqp.elements.members import (
    beam_stiffness,
    spring_force,
    spring_stiffness,
    spring_to_ground,
    string_load,
    string_stiffness,
    truss_axial_force,
    truss_stiffness,
)
from contactqp.elements.scalars import square_root, unit_vector
from contactqp.errors import InvalidProblem

EA = (F(210_000_000), F(15, 10_000))  # kN/m^2, m^2
ORIGIN = np.array([F(0), F(0)])
COORDINATE = st.fractions(min_value=-10, max_value=10, max_denominator=100)


def test_the_bar_of_example_2_5_is_exact():
    ends = np.array([F(0)]), np.array([F(2)])
    K = truss_stiffness(*EA, *ends)
    assert K.tolist() == [[157500, -157500], [-157500, 157500]]
    assert isinstance(K[0, 0], F)
    assert truss_axial_force(*EA, *ends, np.array([F(0), F(1, 1000)])) == F(315, 2)


def test_a_truss_on_one_axis_is_the_bar():
    K = truss_stiffness(*EA, np.array([F(1)]), np.array([F(3)]))
    assert K.tolist() == [[157500, -157500], [-157500, 157500]]  # E A / L of the bar, wherever it lies


def test_the_truss_of_example_2_10():
    left = truss_stiffness(*EA, ORIGIN, np.array([F(-3), F(4)]))[:2, :2]
    assert left.tolist() == [[22680, -30240], [-30240, 40320]]  # a 3-4-5 triangle is rational
    right = truss_stiffness(*EA, ORIGIN, np.array([F(3), F(3)]))[:2, :2]
    assert all(isinstance(k, float) for k in right.ravel())
    K = (left + right).astype(float)
    exact = np.array([[22680 + 26250 * np.sqrt(2), 26250 * np.sqrt(2) - 30240], [0, 40320 + 26250 * np.sqrt(2)]])
    np.testing.assert_allclose(np.triu(K), exact, rtol=4e-16)


def test_a_truss_in_space_is_exact_where_its_length_is():
    K = truss_stiffness(F(27), F(1), np.array([F(0)] * 3), np.array([F(1), F(2), F(2)]))
    assert K[0, 0] == 1
    assert K[1, 5] == -4
    u = np.array([0, 0, 0, 1, 0, 0])
    assert truss_axial_force(F(27), F(1), np.array([F(0)] * 3), np.array([F(1), F(2), F(2)]), u) == F(3)


@pytest.mark.slow
@given(st.lists(COORDINATE, min_size=2, max_size=2), st.lists(COORDINATE, min_size=2, max_size=2))
def test_a_truss_resists_no_rigid_motion_and_balances(start, end):
    a, b = np.array(start, dtype=float), np.array(end, dtype=float)
    if np.linalg.norm(b - a) < 0.01:
        return
    K = truss_stiffness(2.0, 3.0, a, b)
    turn = np.array([-a[1], a[0], -b[1], b[0]])
    for motion in ([1, 0, 1, 0], [0, 1, 0, 1], turn):
        assert np.abs(K @ np.asarray(motion, dtype=float)).max() <= 1e-13 * np.abs(K).max() * np.abs(motion).max()
    assert np.abs(K - K.T).max() == 0


def test_the_axial_force_is_the_stiffness_times_the_displacement():
    a, b, u = np.array([0.0, 0.0]), np.array([2.0, 1.0]), np.array([0.1, -0.2, 0.3, 0.4])
    force = truss_stiffness(5.0, 2.0, a, b) @ u
    n = (b - a) / np.linalg.norm(b - a)
    assert np.isclose(force[2:] @ n, truss_axial_force(5.0, 2.0, a, b, u))
    assert truss_axial_force(5.0, 2.0, a, b, np.array([0.0, 0.0, *n])) > 0  # pulled apart: tension


def test_springs_are_exact_along_any_rational_direction():
    K = spring_to_ground(F(10), [F(1), F(1)])
    assert K.tolist() == [[5, 5], [5, 5]]
    assert spring_stiffness(F(10), [F(2)]).tolist() == [[10, -10], [-10, 10]]
    assert spring_force(F(10), [F(3), F(4)], [F(1), F(0)]) == 6


def test_no_direction_is_refused():
    with pytest.raises(InvalidProblem, match="spring direction: expected a vector of positive length"):
        spring_to_ground(1.0, [0.0, 0.0])
    with pytest.raises(InvalidProblem):
        unit_vector([float("nan"), 1.0], "direction")


def test_roots_of_squares_are_exact():
    assert square_root(F(49, 36)) == F(7, 6)
    assert isinstance(square_root(F(2)), float)
    assert isinstance(square_root(4.0), float)


@pytest.mark.parametrize("angle", [0.0, 0.3, np.pi / 2, 2.5, -1.0])
def test_a_cantilever_bends_by_the_textbook(angle):
    """Tip load: w = F L^3 / (3 E I), theta = F L^2 / (2 E I); axial: F L / (E A)."""
    E, A, inertia, L, force = 7.0, 2.0, 0.3, 1.7, 0.9
    along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    K = beam_stiffness(E, A, inertia, np.zeros(2), L * along)[3:, 3:]
    bent = np.linalg.solve(K, [*(force * across), 0.0])
    np.testing.assert_allclose(bent[:2], force * L**3 / (3 * E * inertia) * across, atol=1e-14)
    assert np.isclose(bent[2], force * L**2 / (2 * E * inertia))
    stretched = np.linalg.solve(K, [*(force * along), 0.0])
    np.testing.assert_allclose(stretched, [*(force * L / (E * A) * along), 0.0], atol=1e-14)


def test_a_positive_rotation_turns_the_first_axis_towards_the_second():
    K = beam_stiffness(1.0, 1.0, 1.0, np.zeros(2), np.array([1.0, 0.0]))[3:, 3:]
    assert np.linalg.solve(K, [0.0, 1.0, 0.0])[2] > 0


def test_rigid_motions_cost_nothing():
    a, b = np.array([0.5, -0.2]), np.array([1.3, 0.9])
    K = beam_stiffness(3.0, 2.0, 0.1, a, b)
    turn = np.array([-a[1], a[0], 1, -b[1], b[0], 1])
    for motion in ([1, 0, 0, 1, 0, 0], [0, 1, 0, 0, 1, 0], turn):
        assert np.abs(K @ np.asarray(motion, dtype=float)).max() < 1e-13 * np.abs(K).max()


def test_a_beam_of_rational_length_is_exact():
    K = beam_stiffness(F(5), F(1), F(1), np.array([F(0), F(0)]), np.array([F(3), F(4)]))
    assert all(isinstance(entry, F | int) for entry in K.ravel())
    assert K[2, 2] == 4  # 4 E I / L
    assert (K == K.T).all()


EXACT = [method.name for method in cq.methods() if method.exact and method.installed]


class Answer(NamedTuple):
    """The first node in touch X, the end reaction R, deflections and forces of the inner nodes, and the energy."""

    first: F
    reaction: F
    deflection: np.ndarray
    force: np.ndarray
    energy: F


@dataclass(frozen=True)
class Wire:
    """L, T, b and d, all rational."""

    length: F
    tension: F
    load: F
    depth: F

    @property
    def free_boundary(self):
        return np.sqrt(float(2 * self.tension * self.depth / self.load))

    @property
    def energy(self):
        """Pi = -b d L + 4/3 b d x_1 of the wire itself."""
        b, d = float(self.load), float(self.depth)
        return -b * d * float(self.length) + 4 / 3 * b * d * self.free_boundary

    def problem(self, elements):
        """Deflections of the inner nodes, each of which may touch."""
        h = self.length / elements
        ends = np.array([F(0), F(0)]), np.array([h, F(0)])
        K_e = string_stiffness(self.tension, *ends)[1::2, 1::2].astype(float)
        f_e = string_load([F(0), -self.load], *ends)[1::2].astype(float)
        K, f = np.zeros((elements + 1, elements + 1)), np.zeros(elements + 1)
        for e in range(elements):
            K[e : e + 2, e : e + 2] += K_e
            f[e : e + 2] += f_e
        inner = slice(1, -1)
        down = sp.csc_array(-np.eye(elements - 1))
        gap = np.full(elements - 1, float(self.depth))
        return cq.ContactProblem(sp.csc_array(K[inner, inner]), f[inner], down, gap)

    def answer(self, elements):
        """By hand in rational numbers."""
        L, T, b, d = self.length, self.tension, self.load, self.depth
        h, square = L / elements, 2 * T * d / b
        X = next(k * h for k in range(1, elements // 2 + 1) if k * (k + 1) * h * h >= square)
        R = T * d / X + b * X / 2
        w, force = [], []
        for i in range(1, elements):
            x = min(i * h, L - i * h)
            w.append(b * x * x / (2 * T) - R * x / T if x < X else -d)
            force.append(F(0) if x < X else b * h if x > X else b * X + b * h / 2 - R)
        # A straight line and a bubble on either side, which do no work on each other, and what elements miss.
        side = T * d * d / (2 * X) - b * d * X / 2 - b * b * X * (X * X - h * h) / (24 * T)
        return Answer(X, R, np.array(w, dtype=float), np.array(force, dtype=float), 2 * side - b * d * (L - 2 * X))


DIGEST = Wire(F(2), F(1), F(1), F(1, 8))  # x_1 = 1/2
THIRD = Wire(F(2), F(3), F(2), F(1, 27))  # x_1 = 1/3: a third of an element away from the nearest of 2^k nodes
MESHES = [2**k for k in range(4, 10)]  # h = 1/8 ... 1/256


def first_contact(wire, solution):
    """X: the first node that presses."""
    h = float(wire.length) / (len(solution.normal_force) + 1)
    return (np.flatnonzero(solution.normal_force > 0)[0] + 1) * h


def test_across_itself_the_string_is_a_spring_of_t_over_h():
    K = string_stiffness(F(3), [F(0), F(0)], [F(1, 4), F(0)])
    assert K[1::2, 1::2].tolist() == [[12, -12], [-12, 12]]
    assert not K[0::2].any()
    assert isinstance(K[1, 1], F)
    assert string_load([F(0), F(-3)], [F(0), F(0)], [F(1, 4), F(0)]).tolist() == [0, F(-3, 8), 0, F(-3, 8)]


def test_in_space_it_stays_exact_where_its_length_is_rational():
    start, end = np.array([F(1), F(0), F(0)]), np.array([F(2), F(2), F(2)])
    K = string_stiffness(F(27), start, end)
    assert all(isinstance(k, F) for k in K.ravel())
    along = np.tile(end - start, 2) * np.repeat([0, 1], 3)
    across = np.array([0, 0, 0, F(2), F(-1), F(0)])
    assert not (K @ along).any()
    assert (K @ across).tolist() == [-18, 9, 0, 18, -9, 0]
    assert (K == K.T).all()
    K = string_stiffness(F(1), [F(0), F(0)], [F(1), F(1)])
    np.testing.assert_allclose(K[:2, :2].astype(float), np.array([[1, -1], [-1, 1]]) / np.sqrt(8), rtol=1e-15)


def test_it_is_what_the_tension_adds_to_a_bar():
    """The energy T (l - h - d.u/h): the change of length beyond the linear one, by differences of second order."""
    start, end, T, step = np.array([0.1, -0.2, 0.3]), np.array([1.0, 0.7, -0.4]), 2.0, 1e-4
    length = lambda u: np.linalg.norm(end + u[3:] - start - u[:3])  # noqa: E731
    unit = np.eye(6) * step
    second = [
        [length(p + q) - length(p - q) - length(q - p) + length(-p - q) for p in unit] for q in unit
    ]  # fmt: skip
    found = T * np.array(second) / (4 * step**2)
    assert np.abs(found).max() > 0.5
    np.testing.assert_allclose(string_stiffness(T, start, end), found, atol=1e-6)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("method", EXACT)
def test_the_wire_whose_free_boundary_is_a_node_is_exact_by_every_method(method):
    solution = cq.solve(DIGEST.problem(8), method=method)
    w = np.array([-3 / 32, *[-1 / 8] * 5, -3 / 32])
    force = np.array([0, 1 / 8, 1 / 4, 1 / 4, 1 / 4, 1 / 8, 0])
    assert solution.certificate.passed
    np.testing.assert_allclose(solution.displacement, w, rtol=1e-12)
    np.testing.assert_allclose(solution.normal_force, force, rtol=1e-12, atol=1e-14)
    assert solution.normal_force.sum() == pytest.approx(1.0, rel=1e-12)
    # -1/6 of the wire itself, and b^2 h^2 / (24 T) per length off the floor, since elements are straight.
    assert solution.energy == pytest.approx(-1 / 6 + 1 / 384, rel=1e-12)
    np.testing.assert_allclose(solution.normal_force[2:-2] / 0.25, 1.0, rtol=1e-12)  # the pressure is b


@pytest.mark.sampled(11)
@pytest.mark.parametrize("wire", [DIGEST, THIRD], ids=["1/2", "1/3"])
@pytest.mark.parametrize("method", EXACT)
def test_wherever_the_free_boundary_is_every_method_gives_the_answer_by_hand(method, wire):
    for elements in (5, 6, 14):
        hand, node_load = wire.answer(elements), float(wire.load * wire.length / elements)
        solution = cq.solve(wire.problem(elements), method=method)
        assert solution.certificate.passed
        np.testing.assert_allclose(solution.displacement, hand.deflection, rtol=1e-12)
        np.testing.assert_allclose(solution.normal_force, hand.force, rtol=0, atol=1e-12 * node_load)
        assert solution.energy == pytest.approx(float(hand.energy), rel=1e-12)
        assert solution.normal_force.sum() + float(2 * hand.reaction) == pytest.approx(elements * node_load, rel=1e-12)
        assert hand.force.max() <= node_load, "no point reaction at the free boundary"


@pytest.mark.slow
def test_the_free_boundary_converges_with_the_first_order_as_a_node_and_the_second_from_the_forces():
    x_1, h, node, balance, energy = THIRD.free_boundary, [], [], [], []
    for elements in MESHES:
        solution = cq.solve(THIRD.problem(elements))
        hand = THIRD.answer(elements)
        assert solution.certificate.proven
        np.testing.assert_allclose(
            solution.normal_force, hand.force, rtol=0, atol=1e-13 * float(THIRD.load) * 2 / elements
        )
        assert solution.energy == pytest.approx(float(hand.energy), rel=1e-12)
        h.append(2 / elements)
        node.append(abs(first_contact(THIRD, solution) - x_1))
        # What the floor does not carry the ends do, b x_1 each: x_1 = (L - sum lambda / b) / 2.
        balance.append((2 - solution.normal_force.sum() / 2) / 2 - x_1)
        energy.append(solution.energy - THIRD.energy)
        assert first_contact(THIRD, solution) == pytest.approx(float(hand.first), rel=1e-14)
        assert balance[-1] == pytest.approx(float((hand.first - F(1, 3)) ** 2 / (2 * hand.first)), rel=1e-7)
    order = lambda errors: np.polyfit(np.log(h), np.log(errors), 1)[0]  # noqa: E731
    np.testing.assert_allclose(node, np.array(h) / 3, rtol=1e-10)
    assert order(node) == pytest.approx(1.0, abs=1e-9)
    assert order(balance) == pytest.approx(2.0, abs=0.05)
    assert order(energy) == pytest.approx(2.0, abs=0.05)
    assert min(energy) > 0, "straight elements on a flat floor are admissible: their energy is above the minimum"


@pytest.mark.sampled(3)
@pytest.mark.parametrize("depth", [F(1, 10), F(1, 7), F(3, 31)])
def test_the_first_node_in_touch_is_never_further_off_than_its_bound(depth):
    """|X - x_1| <= h X / (X + x_1), about half an element."""
    wire = Wire(F(2), F(1), F(1), depth)
    for elements in MESHES:
        X = first_contact(wire, cq.solve(wire.problem(elements)))
        assert abs(X - wire.free_boundary) <= 2 / elements * X / (X + wire.free_boundary) * (1 + 1e-9)


def test_a_free_boundary_at_any_other_node_pulls_or_penetrates():
    problem, right = DIGEST.problem(8), 2
    for first in range(1, 5):
        touching = np.arange(first - 1, 8 - first)
        K, f = problem.stiffness.toarray(), problem.load
        w = np.full(7, -1 / 8)
        free = np.setdiff1d(np.arange(7), touching)
        w[free] = np.linalg.solve(K[np.ix_(free, free)], f[free] - K[np.ix_(free, touching)] @ w[touching])
        force = np.where(np.isin(np.arange(7), touching), K @ w - f, 0.0)
        certificate = cq.certify(problem, displacement=w, normal_force=force)
        assert certificate.passed == (first == right)
        words = " ".join(certificate.failures)
        assert ("tension" in words) == (first < right)
        assert ("penetration" in words) == (first > right)


def test_a_wire_that_just_touches_grazes():
    """b_c = 8 T d / L^2: the middle is at the floor and presses nothing."""
    for elements in (8, 10):
        solution = cq.solve(Wire(F(2), F(1), F(1, 4), F(1, 8)).problem(elements))
        assert solution.contact_status[elements // 2 - 1] == "grazing"
        np.testing.assert_allclose(solution.normal_force, 0, atol=1e-15)
        assert set(np.delete(solution.contact_status, elements // 2 - 1)) == {"open"}
