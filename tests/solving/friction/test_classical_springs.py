"""Penalty and perturbed Lagrangian with friction, contacts on springs: the course chapter's Table 2.2, Problem 2.3."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

import contactqp as cq
from tests.solving.friction.problems import TOUCH, random_problem, rough_truss

PENALISED = {"penalty": "penalty", "perturbed-lagrangian": "perturbation"}
UP_TO_1E8 = (1e3, 1e4, 1e5, 1e6, 1e7, 1e8)
# The printed stiffness of the truss [kN/m], its load [kN] and gap [m], exactly.
K11, K12, K22 = Fraction(59803), Fraction(68831, 10), Fraction(77443)
LOAD, GAP, MU = (Fraction(60), Fraction(-100)), Fraction(1, 1000), Fraction(3, 10)
FORCE = Fraction(180933933661, 6186793000)  # l_N of Example 2.18


def of_two(a: Fraction, b: Fraction, c: Fraction, d: Fraction, right: tuple[Fraction, Fraction]) -> list[Fraction]:
    """The solution of [[a, b], [c, d]] x = right."""
    det = a * d - b * c
    return [(d * right[0] - b * right[1]) / det, (a * right[1] - c * right[0]) / det]


def stuck_on_springs(beta: Fraction, origin: Fraction) -> list[Fraction]:
    """d1x, d1z, l_N, l_T of (K + beta E_N'E_N + beta E_T'E_T) d = f + beta (E_N' g + E_T' o)."""
    right = (LOAD[0] + beta * origin, LOAD[1] - beta * GAP)
    dx, dz = of_two(K11 + beta, K12, K12, K22 + beta, right)
    return [dx, dz, beta * (-dz - GAP), beta * (dx - origin)]


def slipping_on_springs(beta: Fraction, sense: int) -> list[Fraction]:
    """d1x, d1z, l_N, l_T of (K + beta E_s'E_N) d = f + beta E_s' g, E_s = (s mu, -1)."""
    drag = sense * MU
    right = (LOAD[0] + beta * drag * GAP, LOAD[1] - beta * GAP)
    dx, dz = of_two(K11, K12 - beta * drag, K12, K22 + beta, right)
    return [dx, dz, beta * (-dz - GAP), drag * beta * (-dz - GAP)]


def numbers(solution: cq.Solution) -> list[float]:
    return [*solution.displacement, *solution.normal_force, *solution.friction_force[:, 0]]


# Table 2.2, d1x, d1z [mm], friction and normal force [kN]: the exact values of the printed stiffness with the exact
# slip origin, and the row that the chapter prints (its headings of the two forces interchanged, friction as it acts on
# the node).
TABLE_2_2 = {
    1e3: ((1.15777360315533982, -1.38914972002445750, 0.323321648401555932, 0.389149720024457498),
          ("1.1578", "-1.3891", "-0.32331", "0.38915")),
    1e4: ((1.11177983861249132, -1.34547638812887983, 2.77327883858707430, 3.45476388128879830),
          ("1.1118", "-1.3455", "-2.7732", "3.4547")),
    1e5: ((0.947769100963257654, -1.16388693551642048, 11.3317146209473763, 16.3886935516420477),
          ("0.94777", "-1.1639", "-11.331", "16.389")),
    1e6: ((0.850645413814949565, -1.02636991232745461, 16.1934590611656740, 26.3699123274546118),
          ("0.85065", "-1.0264", "-16.193", "26.37")),
    1e7: ((0.836141819614461555, -1.00280946741733873, 16.8986486067766398, 28.0946741733873368),
          ("0.83615", "-1.0028", "-16.898", "28.095")),
    1e8: ((0.834621676417962387, -1.00028279883670641, 16.9721664178495293, 28.2798836706414221),
          ("0.83463", "-1.0003", "-16.972", "28.28")),
}  # fmt: skip


@pytest.mark.sampled(4)
@pytest.mark.parametrize("beta", TABLE_2_2)
@pytest.mark.parametrize("name", PENALISED)
def test_rough_contact_of_table_2_2(name: str, beta: float) -> None:
    """Example 2.17: contact so rough that it sticks, on springs."""
    known, _ = TABLE_2_2[beta]
    exact = stuck_on_springs(Fraction(beta), Fraction(533489, 639328600))
    np.testing.assert_allclose([float(x) for x in exact], [1e-3 * known[0], 1e-3 * known[1], known[3], known[2]], 1e-15)
    solution = cq.solve(rough_truss(friction=100.0), name, **{PENALISED[name]: beta})
    # The friction is beta times a difference of displacements: their last places are a few 1e-12 of it at 1e8.
    np.testing.assert_allclose(numbers(solution), [float(x) for x in exact], 1e-12)
    assert solution.contact_status.tolist() == ["stick"], "the stretch of a spring is no slip"


@pytest.mark.parametrize("beta", TABLE_2_2)
def test_table_2_2_as_it_is_printed(beta: float) -> None:
    """All 24 numbers, by the stiffness of the geometry that the chapter does not round, bars (3, 3) and (-3, 4) m long,
    and a slip origin of 0.717 times the free displacement."""
    root = 26250 * np.sqrt(2.0)
    K = np.array([[22680 + root, -30240 + root], [-30240 + root, 40320 + root]])
    origin = 0.717 * np.linalg.solve(K, [60.0, -100.0])[0]
    solution = cq.solve(rough_truss(friction=100.0, slip_origin=origin, stiffness=K), "penalty", penalty=beta)
    dx, dz, normal, friction = numbers(solution)
    printed = [f"{value:.5g}" for value in (1e3 * dx, 1e3 * dz, -friction, normal)]
    assert printed == [f"{float(value):.5g}" for value in TABLE_2_2[beta][1]]


def test_last_row_of_table_2_2_is_rounding() -> None:
    """beta = 1e20: multiples of beta times the last places of the two lengths, 2^-63 and 2^-62."""
    solution = cq.solve(rough_truss(friction=100.0), "penalty", penalty=1e20)
    assert solution.normal_force[0] == 1e20 * 2.0**-62
    assert solution.friction_force[0, 0] % (1e20 * 2.0**-63) == 0.0
    assert abs(solution.friction_force[0, 0] - 16.980369749859462) > 5, "no digit of it is right"
    right = cq.solve(rough_truss(friction=100.0), "perturbed-lagrangian", perturbation=1e20)
    np.testing.assert_allclose(numbers(right)[2:], [28.3006162497657699, 16.9803697498594619], 1e-12)


@pytest.mark.sampled(5)
@pytest.mark.parametrize("beta", UP_TO_1E8)
@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("name", PENALISED)
def test_slip_on_springs(name: str, sense: int, beta: float) -> None:
    """Problem 2.3: l_N = l_exact beta / (beta + S_s), S_s = det K / (K11 + s mu K12)."""
    exact = slipping_on_springs(Fraction(beta), sense)
    rigid = LOAD[1] * -K11 + K12 * LOAD[0] - GAP * (K11 * K22 - K12 * K12)
    felt = (K11 * K22 - K12 * K12) / (K11 + sense * MU * K12)
    assert exact[2] == rigid / (K11 + sense * MU * K12) * Fraction(beta) / (Fraction(beta) + felt)
    if sense > 0:
        assert exact[2] == FORCE * Fraction(beta) / (Fraction(beta) + felt)
    origin = TOUCH if sense > 0 else 4e-3
    solution = cq.solve(rough_truss(slip_origin=origin), name, **{PENALISED[name]: beta})
    np.testing.assert_allclose(numbers(solution), [float(x) for x in exact], 1e-11)
    assert solution.contact_status.tolist() == ["slip"]
    assert solution.method == name


def test_perturbed_lagrangian_is_penalty_in_exact_arithmetic() -> None:
    """[[K, E_s'], [E_N, -1/kappa]] after elimination of l_N, in rationals; the printed +1/kappa is another answer."""

    def perturbed(kappa: Fraction, sense: int, sign: int) -> Fraction:
        drag = sense * MU
        # Of the first row, d1x; the others in (d1z, l_N).
        a, right = K22 - K12 * K12 / K11, LOAD[1] - K12 * LOAD[0] / K11
        return of_two(a, -1 - K12 * drag / K11, Fraction(-1), sign / kappa, (right, GAP))[1]

    for kappa in map(Fraction, (1000, 100000, 10**6, 10**20)):
        for sense in (1, -1):
            assert perturbed(kappa, sense, -1) == slipping_on_springs(kappa, sense)[2]
            assert perturbed(kappa, sense, 1) != slipping_on_springs(kappa, sense)[2]


@pytest.mark.sampled(6)
@pytest.mark.parametrize("seed", range(12))
def test_perturbed_lagrangian_is_penalty(seed: int) -> None:
    problem = random_problem(np.random.default_rng(seed))
    answers: list[cq.Solution | None] = []
    for name, option in PENALISED.items():
        try:
            answers.append(cq.solve(problem, name, **{option: 300.0}))
        except cq.NotConverged:
            answers.append(None)
    one, other = answers
    assert (one is None) == (other is None)
    if one and other:
        scale = 1 + np.max(abs(one.displacement)) + np.max(abs(one.normal_force))
        np.testing.assert_allclose(numbers(other), numbers(one), 0, atol=1e-9 * scale)
        assert other.contact_status.tolist() == one.contact_status.tolist()


@pytest.mark.parametrize("beta", [1e4, 1e6, 1e8])
def test_the_certificate_says_how_far_off_springs_are(beta: float) -> None:
    solution = cq.solve(rough_truss(friction=100.0), "penalty", penalty=beta)
    certificate, force = solution.certificate, solution.normal_force[0]
    assert not certificate.passed
    assert any("floor is penetrated by" in failure for failure in certificate.failures)
    depth = force / beta
    np.testing.assert_allclose(certificate.penetration, depth / (2e-3 + depth), 1e-9)
    stretch = solution.friction_force[0, 0] / beta
    np.testing.assert_allclose(certificate.slip_direction, stretch / (solution.displacement[0] + TOUCH), 1e-9)
    assert certificate.equilibrium < 1e-12
