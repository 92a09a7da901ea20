"""The associated relaxation: right as what it is, refused as Coulomb's answer wherever something slides."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

import contactqp as cq
from contactqp.solving.friction.associated import projection_slope
from tests.solving.friction.problems import TOUCH, Known, known_answer, pad, random_problem, rough_truss

# Example 2.18 relaxed: (E_N + mu E_T) u = g + mu o with the printed K, worked out in rationals.
FORCE = Fraction(1446341175004419733, 45330143107078000)
DISPLACEMENT = (Fraction(108134611337, 113325357767695), Fraction(-43701737704129, 45330143107078000))


def test_example_2_18_in_rationals() -> None:
    a, b, c, mu, origin = 59803, Fraction(68831, 10), 77443, Fraction(3, 10), Fraction(533489, 639328600)
    u = DISPLACEMENT
    assert a * u[0] + b * u[1] + FORCE * mu == 60
    assert b * u[0] + c * u[1] - FORCE == -100
    slip = u[0] - origin
    assert slip > 0
    assert Fraction(1, 1000) + u[1] == mu * slip, "it opens by mu |s|"


@pytest.mark.parametrize(
    "method", [m for m in cq.methods() if m.installed and m.friction == "convex steps"], ids=lambda m: m.name
)
def test_example_2_18(method: cq.methods) -> None:
    solution = cq.solve(rough_truss(), method.name, algorithm="associated")
    np.testing.assert_allclose(solution.displacement, [float(x) for x in DISPLACEMENT], rtol=1e-13)
    np.testing.assert_allclose(solution.normal_force, float(FORCE), rtol=1e-13)
    np.testing.assert_allclose(solution.friction_force[0], 0.3 * float(FORCE), rtol=1e-13)
    assert solution.method == f"associated friction law by {method.name} (not Coulomb)"
    certificate = solution.certificate
    assert not certificate.passed
    assert certificate.complementarity > 1e-3
    assert certificate.natural_map > 1e-3
    assert certificate.equilibrium < 1e-14
    assert certificate.cone < 1e-14


def test_the_difference_is_reported() -> None:
    found = cq.associated_difference(rough_truss())
    force = 180933933661 / 6186793000
    assert found.coulomb.certificate.passed
    assert not found.associated.certificate.passed
    np.testing.assert_allclose(found.normal_force, float(FORCE) - force, rtol=1e-11)
    np.testing.assert_allclose(found.friction_force[0], 0.3 * (float(FORCE) - force), rtol=1e-11)
    np.testing.assert_allclose(
        found.displacement, [float(DISPLACEMENT[0]) - 30058 / 30933965, 3.59232354e-5], rtol=1e-7
    )
    np.testing.assert_allclose(found.opening, 0.3 * (float(DISPLACEMENT[0]) - TOUCH), rtol=1e-10)
    assert found.force_part == pytest.approx(float(FORCE) / force - 1, rel=1e-10)
    assert "opens contacts that slide by up to 3.59e-05" in str(found)


@pytest.mark.slow
def test_they_agree_where_nothing_slides() -> None:
    for problem in (rough_truss(0.8), pad(3564.0)):
        found = cq.associated_difference(problem)
        assert found.associated.certificate.passed
        assert found.force_part < 1e-12
        assert np.max(found.opening) < 1e-15
    sliding = cq.associated_difference(pad(3636.0, spring=1000.0), method="active-set")
    assert not sliding.associated.certificate.passed


@pytest.mark.slow
def test_random_problems_of_the_plane() -> None:
    """Passed exactly where nothing slides under load; else refused, whatever enumeration finds."""
    rng = np.random.default_rng(9)
    counts = {True: 0, False: 0}
    for _ in range(60):
        problem = random_problem(rng)
        try:
            solution = cq.solve(problem, algorithm="associated")
        except cq.NoEquilibrium:
            continue
        loaded = (solution.normal_force > 1e-9) & (problem.friction > 0)
        slides = bool(np.any(loaded & (abs(solution.slip[:, 0]) > 1e-9)))
        assert solution.certificate.passed is not slides, solution.certificate
        counts[slides] += 1
        if not slides:
            known = cq.equilibria(problem)
            assert min(np.max(abs(solution.displacement - s.displacement)) for s in known) < 1e-9
    assert counts[True] > 10, counts
    assert counts[False] > 10, counts


def _relaxed(known: Known) -> Known:
    """The same forces and displacement as the relaxation's answer: gaps open by mu |s| where contacts slide."""
    p = known.problem
    slip = (p.tangent @ known.displacement).reshape(known.friction_force.shape) - p.slip_origin
    opening = np.where(known.normal_force > 0, p.friction * np.linalg.norm(slip, axis=1), 0.0)
    # What touches without pressing and slides must be as far off.
    room = np.where(known.normal_force > 0, 0.0, p.friction * np.linalg.norm(slip, axis=1))
    problem = p.replace(gap=p.gap + opening + room)
    return Known(problem, known.displacement, known.normal_force, known.friction_force, known.tie_force)


@pytest.mark.slow
@pytest.mark.parametrize("dimension", [2, 3])
def test_answers_that_problems_were_made_around(dimension: int) -> None:
    rng = np.random.default_rng(20 + dimension)
    refused = passed = 0
    for _ in range(40):
        known = _relaxed(known_answer(rng, dimension))
        p = known.problem
        if not p.frictional or np.linalg.matrix_rank(p.stiffness) < p.dimension:
            continue
        solution = cq.solve(p, algorithm="associated")
        size = np.max(abs(known.displacement))
        np.testing.assert_allclose(solution.displacement, known.displacement, rtol=0, atol=1e-8 * size)
        slip = np.linalg.norm(solution.slip, axis=1)
        slides = np.any((known.normal_force > 0) & (p.friction > 0) & (slip > 1e-6))
        assert solution.certificate.passed is not bool(slides), solution.certificate
        refused, passed = refused + bool(slides), passed + (not slides)
    assert refused > 8
    assert passed > 3


def test_space_and_plane_agree() -> None:
    """A tangent more, along which nothing pulls, changes nothing."""
    flat = cq.ContactProblem(
        stiffness=[[2.0, 0.5], [0.5, 3.0]],
        load=[-2.0, 3.0],
        normal=[[-1.0, 0.0]],
        gap=[0.1],
        tangent=[[0.0, 1.0]],
        friction=0.4,
    )
    K = np.zeros((3, 3))
    K[:2, :2], K[2, 2] = flat.stiffness, 1.0
    solid = cq.ContactProblem(K, [-2.0, 3.0, 0.0], [[-1.0, 0.0, 0.0]], [0.1], tangent=np.eye(3)[1:], friction=0.4)
    one, other = (cq.solve(p, algorithm="associated") for p in (flat, solid))
    assert other.method == "associated friction law by clarabel (not Coulomb)"
    np.testing.assert_allclose(other.displacement, [*one.displacement, 0.0], atol=1e-13)
    np.testing.assert_allclose(other.normal_force, one.normal_force, rtol=1e-12)
    np.testing.assert_allclose(other.friction_force[0], [one.friction_force[0, 0], 0.0], atol=1e-12)
    assert not other.certificate.passed
    with pytest.raises(cq.InvalidProblem, match="this very problem"):
        cq.associated_difference(solid, coulomb=one)


def test_a_start_is_no_hindrance() -> None:
    start = cq.solve(rough_truss())
    warm = cq.solve(rough_truss(), algorithm="associated", warm_start=start)
    np.testing.assert_allclose(warm.normal_force, float(FORCE), rtol=1e-13)


def test_the_slope_of_the_projection() -> None:
    from contactqp.certificate.coulomb_law import onto_cone

    rng = np.random.default_rng(0)
    kinds = set()
    for _ in range(50):
        x, mu, step = rng.normal(size=3), float(rng.uniform(0.1, 2.0)), 1e-6
        slope = projection_slope(x, mu)
        by_differences = [
            (onto_cone((x + step * e)[None], np.array([mu]))[0] - onto_cone((x - step * e)[None], np.array([mu]))[0])
            / (2 * step)
            for e in np.eye(3)
        ]
        np.testing.assert_allclose(slope, np.array(by_differences).T, atol=1e-8)
        kinds.add(int(np.linalg.matrix_rank(slope)))
    assert kinds == {0, 2, 3}


def test_what_has_no_relaxation_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(cq.Unsupported, match="systems of stick and slip of its own"):
        cq.solve(rough_truss(), "penalty", penalty=1e8, algorithm="associated")
    with pytest.raises(cq.InvalidProblem, match="with friction"):
        cq.associated_difference(rough_truss(0.0))
    space = dict(normal=[[-1.0, 0.0, 0.0]], gap=[0.0], tangent=np.eye(3)[1:], friction=0.3)
    driven = cq.ContactProblem(np.zeros((3, 3)), [-1.0, 0.5, 0.0], **space)
    with pytest.raises(cq.NoEquilibrium):
        cq.solve(driven, algorithm="associated")
    monkeypatch.setitem(__import__("sys").modules, "clarabel", None)
    with pytest.raises(cq.BackendMissing, match="pip install clarabel"):
        cq.solve(cq.ContactProblem(np.eye(3), [-1.0, 0.5, 0.0], **space), algorithm="associated")
