"""Local problems by every algorithm, against solutions that were made first or are known in closed form."""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import contactqp as cq
from contactqp.certificate.local_certificate import MeasuredForces
from contactqp.linalg.measures import lengths
from tests.solving.friction.problems import walls_that_conflict

ALGORITHMS = ("newton", "nsgs", "ppa", "admm", "combinations", "aclm", "tresca")
# Order (N, T), Klarbring's (1990) contact.
KLARBRING = [[1.0, 2.0], [2.0, 5.0]]


def made(
    seed: int, contacts: int = 5, dimension: int = 3, friction: float = 0.3, rank: int | None = None, skew: float = 0.0
) -> tuple[cq.LocalProblem, NDArray[np.float64], NDArray[np.float64]]:
    """A problem with the forces and velocities it was made from: a third each open, sticking, sliding."""
    random = np.random.default_rng(seed)
    size = contacts * dimension
    root = random.normal(size=(size, rank or size))
    W = root @ root.T / size + (0.0 if rank else 1.0) * np.eye(size)
    wrong = random.normal(size=W.shape)
    W = W + skew * (wrong - wrong.T)
    mu = friction * random.uniform(0.5, 1.0, contacts)
    r, u = np.zeros((contacts, dimension)), np.zeros((contacts, dimension))
    for i in range(contacts):
        direction = random.normal(size=dimension - 1)
        direction /= np.linalg.norm(direction)
        if i % 3 == 0:
            u[i, 0], u[i, 1:] = random.uniform(0.2, 1.0), direction
        else:
            r[i, 0] = random.uniform(0.5, 2.0)
            share = 1.0 if i % 3 == 1 else random.uniform(0.0, 0.9)
            r[i, 1:] = -share * mu[i] * r[i, 0] * direction
            u[i, 1:] = random.uniform(0.2, 1.0) * direction * (i % 3 == 1)
    q = u.ravel() - W @ r.ravel()
    return cq.LocalProblem(delassus=W, offset=q, friction=mu, dimension=dimension), r, u


def method_of(algorithm: str) -> str:
    return "clarabel" if algorithm in ("aclm", "tresca") else "active-set"


@pytest.mark.sampled(11)
@pytest.mark.parametrize("algorithm", [None, *ALGORITHMS])
@pytest.mark.parametrize("dimension", [2, 3])
def test_the_forces_that_a_problem_was_made_from(algorithm: str | None, dimension: int) -> None:
    for seed in range(6):
        problem, r, u = made(seed, dimension=dimension)
        method = "active-set" if algorithm is None else method_of(algorithm)
        solution = cq.solve(problem, method=method, algorithm=algorithm)
        assert np.allclose(solution.force, r, atol=1e-9)
        assert np.allclose(solution.velocity, u, atol=1e-9)
        assert list(solution.contact_status) == (["open", "slip", "stick"] * 2)[:5]
        assert solution.certificate.passed
        assert solution.certificate.natural_map <= 1e-9


@pytest.mark.sampled(5)
@pytest.mark.parametrize("algorithm", [name for name in ALGORITHMS if name not in ("newton", "combinations")])
def test_without_newtons_finish_an_algorithm_gets_there_itself(algorithm: str) -> None:
    # An interior point knows forces to the square root of its gap.
    tolerance = 1e-5 if algorithm in ("aclm", "tresca") else 1e-8
    for seed in range(3):
        problem, r, _ = made(seed)
        found = cq.solve(problem, method=method_of(algorithm), algorithm=algorithm, polish=False, tolerance=tolerance)
        assert np.allclose(found.force, r, atol=20 * tolerance)
        assert found.iterations > 1


@pytest.mark.parametrize("seed", range(4))
def test_redundant_contacts_have_one_velocity(seed: int) -> None:
    """The forces are one choice among many; normal velocities and the law are not."""
    problem, _, u = made(seed, contacts=6, rank=9)
    solution = cq.solve(problem)
    assert solution.certificate.passed
    assert np.allclose(solution.velocity, u, atol=1e-7) or solution.certificate.natural_map <= 1e-9


@pytest.mark.parametrize("algorithm", ["newton", "nsgs", "admm", None])
def test_an_unsymmetric_operator_is_taken_as_it_is(algorithm: str | None) -> None:
    problem, r, _ = made(3, skew=0.02)
    assert problem.asymmetry > 1e-3
    assert np.allclose(cq.solve(problem, algorithm=algorithm).force, r, atol=1e-9)


def test_a_minimisation_sees_the_symmetric_part_and_newton_mends_it() -> None:
    problem, r, _ = made(3, skew=0.02)
    assert np.allclose(cq.solve(problem, method="clarabel", algorithm="aclm").force, r, atol=1e-9)
    with pytest.raises(cq.NotCertified) as refused:
        cq.solve(problem, method="clarabel", algorithm="aclm", polish=False)
    assert "symmetric part" in str(refused.value)
    solution = refused.value.solution
    assert isinstance(solution, cq.LocalSolution)
    assert 1e-4 < solution.certificate.natural_map < 1e-1


@pytest.mark.parametrize("algorithm", [None, *ALGORITHMS])
def test_where_tresca_cycles_undamped(algorithm: str | None) -> None:
    """Klarbring's contact, mu = 0.8 above the critical 0.5, one answer: sliding back with r_N = 35/13."""
    problem = cq.LocalProblem(delassus=KLARBRING, offset=[-7.0, -17.0], friction=0.8, dimension=2)
    method = "active-set" if algorithm is None else method_of(algorithm)
    solution = cq.solve(problem, method=method, algorithm=algorithm)
    assert np.allclose(solution.force, [[35 / 13, 28 / 13]], rtol=1e-9)
    assert np.allclose(solution.velocity, [[0.0, -11 / 13]], atol=1e-9)


@pytest.mark.sampled(7)
@pytest.mark.parametrize("algorithm", [None, *ALGORITHMS])
def test_a_ball_on_a_plane_slides_along_its_velocity(algorithm: str | None) -> None:
    """W = 1: r_N = 1, r_T = -mu q_T/|q_T|, whatever the direction; within the cone it sticks, r = -q."""
    method = "active-set" if algorithm is None else method_of(algorithm)
    for angle in (0.0, 0.4, 2.0, -2.7):
        q = np.array([-1.0, 2 * np.cos(angle), 2 * np.sin(angle)])
        one = cq.LocalProblem(delassus=np.eye(3), offset=q, friction=0.5, dimension=3)
        sliding = cq.solve(one, method=method, algorithm=algorithm)
        assert np.allclose(sliding.force, [[1.0, -0.5 * np.cos(angle), -0.5 * np.sin(angle)]], atol=1e-9)
        stuck = cq.LocalProblem(delassus=np.eye(3), offset=q, friction=2.1, dimension=3)
        assert np.allclose(cq.solve(stuck, method=method, algorithm=algorithm).force, [-q], atol=1e-9)


@pytest.mark.parametrize(
    ("friction", "offset", "force"),
    [(1.0, (-0.01, -1.0), (0.025, 0.025)), (1.5, (-0.01, -1.0), (0.3085, 0.403))],
)
def test_painleves_rod(friction: float, offset: tuple[float, float], force: tuple[float, float]) -> None:
    """A rod sliding at tan(theta) = 2, m = l = 1: it slides on, or sticks without a collision (Genot, Brogliato 1999).

    Slip: r_N = 0.01 / (1.6 - 1.2 mu); stick: r = -W^-1 q.
    """
    W = np.array([[1.6, -1.2], [-1.2, 3.4]])
    solution = cq.solve(cq.LocalProblem(delassus=W, offset=offset, friction=friction, dimension=2))
    assert np.allclose(solution.force, [force], atol=5e-5)
    exact = -np.linalg.solve(W, offset) if friction > 1 else np.array([0.025, 0.025])
    assert np.allclose(solution.force, [exact], rtol=1e-9)


def jammed(normal: float, tangential: float = 0.0, friction: float = 0.5) -> cq.LocalProblem:
    """A block between two walls that move towards each other by `normal`, and slides along both by `tangential`."""
    W = np.zeros((4, 4))
    W[::2, ::2], W[1::2, 1::2] = [[1.0, -1.0], [-1.0, 1.0]], [[1.0, 1.0], [1.0, 1.0]]
    return cq.LocalProblem(delassus=W, offset=[normal, tangential, normal, tangential], friction=friction, dimension=2)


@pytest.mark.slow
def test_a_jammed_block_has_no_answer_and_the_existence_test_says_so() -> None:
    assert cq.existence_margin(jammed(-0.1)) < 0
    assert cq.existence_margin(jammed(0.1)) > 0
    for algorithm in (None, "enumeration"):
        with pytest.raises(cq.NoEquilibrium, match=r"no combination|proven in rational numbers"):
            cq.solve(jammed(-0.1), algorithm=algorithm)
    assert cq.equilibria(jammed(-0.1)) == ()
    pressed = np.array([[1e16, 0.0], [1e16, 0.0]])  # beside which the approach of 0.1 is rounding
    assert cq.certify_local(jammed(-0.1), pressed).natural_map > 0.1


def test_the_existence_test_takes_contact_problems_too() -> None:
    """Rows of full rank on held bodies: a solution for any coefficient; between closing walls: none."""
    problem, _, _ = made(0, contacts=2)
    W = problem.delassus.toarray()
    K = np.linalg.inv(W)
    rows = np.eye(6)
    held = cq.ContactProblem(
        K, K @ problem.offset, -rows[[0, 3]], [0.0, 0.0], tangent=rows[[1, 2, 4, 5]], friction=problem.friction
    )
    assert cq.existence_margin(held) > 0
    walls = walls_that_conflict()
    assert cq.existence_margin(walls) < 0
    with pytest.raises(cq.Unsupported, match="float"):
        cq.existence_margin(walls.replace(stiffness=np.zeros((2, 2))))
    with pytest.raises(cq.InvalidProblem, match="with friction"):
        cq.existence_margin(walls.replace(friction=0.0))


def test_a_hanging_block_has_any_wall_force_and_no_velocity() -> None:
    """Weight -1 between touching walls: any normal force N with 2 mu N >= 1 would hold it."""
    solution = cq.solve(jammed(0.0, -1.0))
    assert np.allclose(solution.velocity[:, 0], 0.0, atol=1e-12)
    assert solution.certificate.passed


def test_joints_are_the_same_as_what_they_leave_of_the_contacts() -> None:
    """V'r + R l + s = 0 eliminated: W - V R^-1 V', q - V R^-1 s."""
    random = np.random.default_rng(5)
    root = random.normal(size=(11, 11))
    whole = root @ root.T / 11 + np.eye(11)
    W, V, R = whole[:9, :9], whole[:9, 9:], whole[9:, 9:]
    q, s = random.normal(size=9) - [1.0, 0, 0] * 3, random.normal(size=2)
    joined = cq.LocalProblem(
        delassus=W, offset=q, friction=0.4, dimension=3, bilateral=V, bilateral_delassus=R, bilateral_offset=s
    )
    left = cq.LocalProblem(
        delassus=W - V @ np.linalg.solve(R, V.T), offset=q - V @ np.linalg.solve(R, s), friction=0.4, dimension=3
    )
    expected = cq.solve(left)
    for algorithm in (None, *ALGORITHMS):
        method = "active-set" if algorithm is None else method_of(algorithm)
        found = cq.solve(joined, method=method, algorithm=algorithm)
        assert np.allclose(found.force, expected.force, atol=1e-9)
        assert np.allclose(V.T @ found.force.ravel() + R @ found.joint_force + s, 0.0, atol=1e-9)
    wrong = cq.certify_local(joined, expected.force, joint_force=found.joint_force + 1e-3)
    assert not wrong.passed
    assert any("joints" in failure for failure in wrong.failures)


QUADRATIC = [m.name for m in cq.methods() if m.kind == "quadratic program" and m.installed and m.semidefinite]


@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", ["active-set", "cvxpy", *QUADRATIC])
@pytest.mark.parametrize("algorithm", ["aclm", "tresca"])
def test_in_the_plane_every_quadratic_programming_method_takes_the_steps(method: str, algorithm: str) -> None:
    problem, r, _ = made(1, contacts=4, dimension=2)
    solution = cq.solve(problem, method=method, algorithm=algorithm)
    assert np.allclose(solution.force, r, atol=1e-9)
    called = {"tresca": "Tresca fixed-point iteration"}.get(algorithm, algorithm)
    assert solution.method == f"{called}, each step by {method}"


@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", ["clarabel", "scs", "cvxpy"])
def test_in_space_cones_are_cones(method: str) -> None:
    if not next(m for m in cq.methods() if m.name == method).installed:
        pytest.skip(f"{method} is not installed")
    problem, r, _ = made(2, contacts=3)
    assert np.allclose(cq.solve(problem, method=method, algorithm="aclm").force, r, atol=1e-9)
    assert np.allclose(cq.solve(problem, method=method, algorithm="tresca").force, r, atol=1e-9)


def test_polygons_say_how_far_they_are_off() -> None:
    """Sliding across a side of an inscribed square: friction is cos 45 degrees of the bound."""
    q = np.array([-1.0, 2.0, 0.0])
    problem = cq.LocalProblem(delassus=np.eye(3), offset=q, friction=0.5, dimension=3)
    with pytest.raises(cq.NotCertified) as refused:
        cq.solve(problem, algorithm="tresca", facets=4, polish=False)
    assert "polygons (4 sides, inscribed, friction bound up to 0.29 off)" in str(refused.value)
    solution = refused.value.solution
    assert isinstance(solution, cq.LocalSolution)
    size = lengths(solution.force[:, 1:])[0]
    assert np.isclose(size, 0.5 * np.cos(np.pi / 4), atol=1e-9)
    exact = cq.solve(problem, algorithm="tresca", facets=4)  # Newton's method ends on the cone
    sides = "4 sides, inscribed, friction bound up to 0.29 off"
    assert exact.method == f"Tresca fixed-point iteration, each step by active-set on polygons ({sides})"
    assert np.allclose(exact.force, [[1.0, -0.5, 0.0]], atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    "sides", [(4, 16), pytest.param((8, 32), marks=pytest.mark.slow)], ids=["four and sixteen", "eight and more"]
)
def test_more_sides_are_nearer_and_both_polygons_enclose_the_cone(sides: tuple[int, ...]) -> None:
    """One pad dragged across a side: an inscribed side loses friction, a circumscribed one is the disc there."""
    for facets in sides:
        across, corner = np.array([-1.0, 2.0, 0.0]), 2.0 * np.pi / (2 * facets)
        askew = np.array([-1.0, 2 * np.cos(corner), 2 * np.sin(corner)])
        for polygon, q, expected in (
            ("inscribed", across, 0.5 * np.cos(np.pi / facets)),
            ("circumscribed", askew, 0.5 / np.cos(np.pi / facets)),
        ):
            problem = cq.LocalProblem(delassus=np.eye(3), offset=q, friction=0.5, dimension=3)
            with pytest.raises(cq.NotCertified) as refused:
                cq.solve(problem, algorithm="aclm", facets=facets, polygon=polygon, polish=False)
            found: Any = refused.value.solution
            assert np.isclose(lengths(found.force[:, 1:])[0] / found.force[0, 0], expected, rtol=1e-6)


def test_forces_that_were_accepted_are_certified_as_they_were_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    # Measured again for the certificate they took a third longer to find.
    problem, right, _ = made(3)
    measured: list[object] = []
    original = MeasuredForces.__init__

    def counted(self: MeasuredForces, *given: Any, **named: Any) -> None:
        measured.append(self)
        original(self, *given, **named)

    monkeypatch.setattr(MeasuredForces, "__init__", counted)
    solution = cq.solve(problem)
    assert len(measured) == 1
    np.testing.assert_allclose(solution.force, right, atol=1e-12)
    assert solution.certificate.passed


def test_a_wrong_answer_fails_and_says_where() -> None:
    problem, r, _ = made(0)
    assert cq.certify_local(problem, r).passed
    for row, change, figure in [(0, -0.1, "tension"), (1, -0.2, "penetration"), (0, 0.1, "complementarity")]:
        wrong = r.copy()
        wrong[row, 0] += change
        certificate = cq.certify_local(problem, wrong)
        assert not certificate.passed
        assert getattr(certificate, figure) > 1e-3
        assert any(figure.split("_")[0] in text for text in certificate.failures)
    flipped = r.copy()
    flipped[1, 1:] *= -1
    assert cq.certify_local(problem, flipped).slip_direction > 1e-3
    beyond = r.copy()
    beyond[2, 1:] = 2.0
    assert cq.certify_local(problem, beyond).cone > 1e-3
    assert not cq.certify_local(problem, np.full_like(r, np.nan)).passed


def test_figures_do_not_depend_on_units_or_on_a_contacts_own_scale() -> None:
    problem, r, _ = made(4)
    wrong = r + 1e-3
    figures = cq.certify_local(problem, wrong)
    factor = np.repeat([1e3, 1.0, 1e-4, 7.0, 1.0], 3)
    W = problem.delassus.toarray() * np.outer(factor, factor)
    scaled = cq.LocalProblem(
        delassus=W * 50.0, offset=problem.offset * factor * 3.0, friction=problem.friction, dimension=3
    )
    found = cq.certify_local(scaled, wrong.ravel() / factor * 3.0 / 50.0)
    for name in ("penetration", "tension", "complementarity", "cone", "slip_direction"):
        assert np.isclose(getattr(found, name), getattr(figures, name), rtol=1e-9)
    assert np.allclose(cq.solve(scaled).force.ravel(), r.ravel() / factor * 3.0 / 50.0, rtol=1e-8)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(dimension=4), "dimension: expected 2 or 3, got 4"),
        (dict(offset=[1.0]), r"offset: expected shape \(2,\), got \(1,\)"),
        (dict(friction=-0.1), "friction: expected a coefficient >= 0"),
        (dict(delassus=[[1.0, 2.0], [2.0, 1.0]]), "delassus: expected positive semidefinite"),
        (dict(delassus=np.eye(3)), "delassus: expected a square matrix of 2 rows a contact"),
        (dict(delassus=[[np.nan, 0.0], [0.0, 1.0]]), "delassus: expected finite numbers"),
        (dict(bilateral_offset=[1.0]), "without bilateral"),
    ],
)
def test_what_is_no_problem_is_refused(changes: dict[str, Any], message: str) -> None:
    data: dict[str, Any] = dict(delassus=KLARBRING, offset=[-7.0, -17.0], friction=0.8, dimension=2)
    with pytest.raises(cq.InvalidProblem, match=message):
        cq.LocalProblem(**(data | changes))


def test_arguments_are_refused_by_name() -> None:
    problem, _, _ = made(0)
    with pytest.raises(cq.InvalidProblem, match="algorithm: expected one of"):
        cq.solve(problem, algorithm="lemke")
    with pytest.raises(cq.InvalidProblem, match="facets: expected a whole number from 3 to 10000, got 2"):
        cq.solve(problem, algorithm="tresca", facets=2)
    with pytest.raises(cq.InvalidProblem, match="polygon: expected one of"):
        cq.solve(problem, algorithm="tresca", polygon="round")
    with pytest.raises(cq.InvalidProblem, match="unknown option 'penalty'"):
        cq.solve(problem, penalty=3.0)
    with pytest.raises(cq.Unsupported, match="penalty"):
        cq.solve(problem, method="penalty", algorithm="aclm")
    with pytest.raises(cq.InvalidProblem, match="warm_start"):
        cq.solve(problem, warm_start=3)


def test_offsets_may_be_as_small_as_doubles_go() -> None:
    """A third of the contacts hears of nothing but numbers whose reciprocals are no doubles."""
    problem = cq.LocalProblem(
        delassus=np.eye(6), offset=[-1e-18, 2e-18, 0.0, -1e-310, 3e-310, 0.0], friction=0.3, dimension=3
    )
    for algorithm in (None, "admm", "nsgs"):
        found = cq.solve(problem, algorithm=algorithm)
        assert np.allclose(found.force[0], [1e-18, -3e-19, 0.0], rtol=1e-9, atol=0.0)


def test_nothing_pushes_nothing() -> None:
    problem = cq.LocalProblem(delassus=np.eye(3), offset=np.zeros(3), friction=0.3, dimension=3)
    assert np.allclose(cq.solve(problem).force, 0.0)
    none = cq.LocalProblem(delassus=np.zeros((0, 0)), offset=[], friction=[], dimension=3)
    assert cq.solve(none).force.shape == (0, 3)


def test_all_answers_of_klarbrings_contact() -> None:
    """mu = 0.8 above the critical 0.5: open, stick and slip; enumeration alone does not choose."""
    problem = cq.LocalProblem(delassus=KLARBRING, offset=[0.3, 1.25], friction=0.8, dimension=2)
    found = cq.equilibria(problem)
    assert [str(one.contact_status[0]) for one in found] == ["open", "stick", "slip"]
    np.testing.assert_allclose([one.force[0] for one in found], [[0, 0], [1, -0.65], [0.5, -0.4]], atol=1e-12)
    with pytest.raises(cq.SeveralEquilibria, match=r"3 equilibria.*r_N = 0\.5"):
        cq.solve(problem, algorithm="enumeration")
    assert any(np.allclose(cq.solve(problem).force, one.force, atol=1e-12) for one in found)


@pytest.mark.slow
def test_enumeration_takes_unsymmetric_operators_and_joints() -> None:
    for seed in range(4):
        problem, r, u = made(seed, contacts=4, dimension=2, skew=0.05)
        found = cq.solve(problem, algorithm="enumeration")
        np.testing.assert_allclose(found.force, r, atol=1e-12)
        np.testing.assert_allclose(found.velocity, u, atol=1e-12)
        rng = np.random.default_rng(seed)
        V, joint = rng.normal(size=(8, 2)), rng.normal(size=2)
        for R in (np.zeros((2, 2)), np.eye(2)):
            jointed = cq.LocalProblem(
                delassus=problem.delassus,
                offset=problem.offset - V @ joint,
                friction=problem.friction,
                dimension=2,
                bilateral=V,
                bilateral_delassus=-R,
                bilateral_offset=R @ joint - V.T @ r.ravel(),
            )
            assert any(np.allclose(one.velocity, u, atol=1e-9) for one in cq.equilibria(jointed))


def test_what_rounding_may_hide_is_not_denied() -> None:
    """A tolerance that doubles cannot meet is no proof that there is no answer."""
    problem, *_ = made(1, contacts=3, dimension=2)
    with pytest.raises(cq.NotConverged) as refused:
        cq.solve(problem, algorithm="enumeration", tolerance=1e-300)
    assert refused.value.solution.certificate.natural_map < 1e-13


def test_what_enumeration_of_a_local_problem_refuses() -> None:
    space, _, _ = made(0, contacts=2)
    many, _, _ = made(0, contacts=9, dimension=2)
    with pytest.raises(cq.Unsupported, match="in space"):
        cq.solve(space, algorithm="enumeration")
    with pytest.raises(cq.Unsupported, match="9 contacts"):
        cq.equilibria(many)
    with pytest.raises(cq.InvalidProblem, match="enumeration or None, got 'lemke'"):
        cq.solve(many, algorithm="lemke")
    with pytest.raises(cq.InvalidProblem, match="enumeration: unknown option 'facets'"):
        cq.solve(many, algorithm="enumeration", facets=8)


def test_a_contact_without_compliance_beside_numbers_of_any_size_has_its_answer():
    """The second contact has no compliance and a speed of 1e-247; the scales of both are doubles all the same."""
    W = np.zeros((4, 4))
    W[:2, :2] = [[24.0, -6.0], [-6.0, 3.0]]
    problem = cq.LocalProblem(delassus=W, offset=[-3.5e56, 7e-76, 8e-168, 1e-247], friction=0.3, dimension=2)
    assert np.all(np.isfinite(problem.contact_scale))
    force = cq.solve(problem).force
    assert force[0, 0] == pytest.approx(3.5e56 / (24 - 6 * 0.3), rel=1e-9)  # slides against the bound 0.3 N
    assert np.all(force[1] == 0)


def test_local_numbers_that_no_common_size_brings_within_doubles_are_refused_by_name():
    problem = cq.LocalProblem(delassus=np.eye(4), offset=[-1e-160, 0.0, 1e200, 0.0], friction=0.3, dimension=2)
    with pytest.raises(cq.InvalidProblem, match="offset: an entry is not a double"):
        cq.solve(problem)


def test_where_clarabel_is_missing_the_others_are_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    """One attempt of seven takes convex steps; the default asked for its backend before the first of them."""
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *a: None if name == "clarabel" else find(name, *a))
    slides = cq.LocalProblem(delassus=np.diag([2.0, 1.0, 1.0]), offset=[-2.0, 5.0, 0.0], friction=0.5, dimension=3)
    np.testing.assert_allclose(cq.solve(slides).force, [[1.0, -0.5, 0.0]], rtol=1e-14)


@pytest.mark.parametrize("huge", [1e290, 1e300, 1e306, 1.7e308])
def test_forces_whose_figures_leave_the_doubles_are_refused(huge: float) -> None:
    """The natural map is not a number there; that is no figure that passes."""
    W = np.diag([2.0, 1.0, 2.0, 1.0])
    W[0, 1] = W[1, 0] = 0.3
    problem = cq.LocalProblem(delassus=W, offset=[-1.0, 0.2, -1.0, 0.1], friction=[0.3, 0.3], dimension=2)
    force = cq.solve(problem).force.copy()
    assert cq.certify_local(problem, force).passed
    force[0] = [huge, 0.0]
    judged = cq.certify_local(problem, force)
    assert not judged.passed
    assert judged.failures


def _wedged(offset: float) -> cq.LocalProblem:
    """Two contacts face to face on one rigid rod in space: what opens the one closes the other."""
    push = np.array([1.0, 0.0, 0.0, -1.0, 0.0, 0.0])
    return cq.LocalProblem(
        delassus=np.outer(push, push), offset=[-1.0, 0.0, 0.0, offset, 0.0, 0.0], friction=0.3, dimension=3
    )


@pytest.mark.sampled(4)
@pytest.mark.parametrize("unit", [1.0, 2.0**20, 1e-3])
def test_that_no_forces_open_all_contacts_is_proven_in_space(unit: float) -> None:
    """Weights of normal velocities that no force changes are positive, where offsets make their sum negative."""
    nothing = cq.LocalProblem(delassus=np.zeros((3, 3)), offset=[-unit, 0.0, 0.0], friction=0.5, dimension=3)
    with pytest.raises(cq.NoEquilibrium, match="no contact forces keep contact 0 from being penetrated, proven"):
        cq.solve(nothing)
    with pytest.raises(cq.NoEquilibrium, match="contact 0, contact 1"):
        cq.solve(_wedged(0.5))
    with pytest.raises(cq.NoEquilibrium):
        cq.solve(_wedged(1.0 - 1e-6))
    for offset in (1.0, 1.0 + 1e-6, 2.0):  # they touch, or one is open
        solution = cq.solve(_wedged(offset))
        assert solution.certificate.passed
        assert solution.force[0, 0] - solution.force[1, 0] == pytest.approx(1.0, abs=1e-5)


def test_joints_that_open_contacts_are_no_proof_of_absence() -> None:
    jointed = cq.LocalProblem(
        delassus=np.zeros((3, 3)), offset=[-1.0, 0.0, 0.0], friction=0.5, dimension=3,
        bilateral=[[1.0], [0.0], [0.0]], bilateral_delassus=[[0.0]], bilateral_offset=[0.0],
    )  # fmt: skip
    assert cq.solve(jointed).certificate.passed
