"""The certificate of frictional answers: the law as one equation, in the plane and in space."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate.coulomb_law import IMPLIED
from tests.examples import truss
from tests.solving.friction.problems import Known, known_answer, random_problem, rough_truss, two_masses

LAW = ("penetration", "tension", "complementarity", "cone", "slip_direction")


def _block(**changes: object) -> cq.ContactProblem:
    """One contact in space that presses with 2 and is pulled along its first tangent by 3; mu = 1/2, K = 2."""
    data: dict[str, object] = dict(
        stiffness=2.0 * np.eye(3),
        load=[-2.0, 3.0, 0.0],
        normal=[[-1.0, 0.0, 0.0]],
        gap=[0.0],
        tangent=[[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        friction=0.5,
    )
    return cq.ContactProblem(**(data | changes))


def test_friction_along_the_slip_is_refused_where_the_other_tangent_is_at_rest() -> None:
    right = cq.certify(_block(), [0.0, 1.0, 0.0], [2.0], [1.0, 0.0])
    assert right.passed, right
    assert right.natural_map is not None
    assert right.natural_map < 1e-15
    pushes = cq.certify(_block(), [0.0, 2.0, 0.0], [2.0], [-1.0, 0.0])
    assert pushes.equilibrium == 0.0
    assert pushes.slip_direction > 0.1
    assert pushes.natural_map > 0.1
    assert any(failure.startswith("natural_map: contact 0") for failure in pushes.failures)


def test_natural_map_by_hand() -> None:
    """v = (0, 3/2, 0), l_N = 2, l_T = 0: phi = F_T = |K v| + |f| = 6, L = 3/2, mu = 1/2.

    r/phi = (1/3, 0), u/L = (0, 1): r - u - e_N/2 = (-1/6, -1), whose projection is (4/15, -2/15): n = (1, 2)/15, over
    1 + mu. In space two unknowns feel the tangents: phi is sqrt(2) F_T.
    """
    flat = cq.certify(_block(tangent=[[0.0, 1.0, 0.0]]), [0.0, 1.5, 0.0], [2.0], [0.0])
    assert flat.natural_map == pytest.approx(np.sqrt(5) / 15 / 1.5, rel=1e-14)
    # r/phi = (1/sqrt(18), 0): projected x = (1/sqrt(18) - 1/2, -1) has r_N = (1/2 + x_N)/(5/4), r_T = r_N/2.
    r_N = 0.8 / np.sqrt(18)
    solid = cq.certify(_block(), [0.0, 1.5, 0.0], [2.0], [0.0, 0.0])
    assert solid.natural_map == pytest.approx(np.hypot(1 / np.sqrt(18) - r_N, r_N / 2) / 1.5, rel=1e-14)


def test_natural_map_is_none_without_friction_and_infinite_without_numbers() -> None:
    assert cq.solve(truss()).certificate.natural_map is None
    assert cq.solve(rough_truss(friction=0.0)).certificate.natural_map is None
    nan = cq.certify(rough_truss(), [np.nan, 0.0], [1.0], [0.0])
    assert nan.natural_map == np.inf
    assert not nan.passed


def test_a_contact_that_cannot_slide_is_measured_along_its_normal() -> None:
    solution = cq.solve(rough_truss(0.3, 0.0, tangent=[[0.0, 0.0]]))
    assert solution.certificate.natural_map == pytest.approx(0.0, abs=1e-15)
    through = cq.certify(solution.problem, 1.001 * solution.displacement, solution.normal_force, [0.0])
    assert through.natural_map > 1e-5


WRONG = {
    "opposite friction": lambda u, n, t: (u, n, -t),
    "no friction": lambda u, n, t: (u, n, 0 * t),
    "beyond the cone": lambda u, n, t: (u, n, 1.1 * t),
    "turned": lambda u, n, t: (u, n, t[:, ::-1] * [1.0, -1.0]),
    "tension": lambda u, n, t: (u, -n, t),
    "penetration": lambda u, n, t: (u - [0.1, 0.0, 0.0], n, t),
    "open and pressed": lambda u, n, t: (u - [-0.1, 0.0, 0.0], n, t),
}


@pytest.mark.parametrize("kind", WRONG)
def test_the_natural_map_sees_wrong_answers_in_space(kind: str) -> None:
    problem = _block(load=[-2.0, 3.0, 1.0])
    along = np.array([3.0, 1.0]) / np.sqrt(10)
    u, pressed, rubbed = np.append(0.0, (np.array([3.0, 1.0]) - along) / 2), np.array([2.0]), along[None]
    right = cq.certify(problem, u, pressed, rubbed)
    assert right.passed
    assert right.natural_map < 1e-15
    wrong = cq.certify(problem, *WRONG[kind](u, pressed, rubbed))
    assert wrong.natural_map > 1e-3
    assert not wrong.passed


@pytest.mark.slow
@pytest.mark.parametrize("count", [40, pytest.param(150, marks=pytest.mark.slow)])
@pytest.mark.parametrize("dimension", [2, 3])
def test_right_answers_pass_and_the_other_figures_imply_the_natural_map(dimension: int, count: int) -> None:
    """Contacts of all states, unknowns of scales apart by up to 1e10, then everything off by up to its size."""
    rng = np.random.default_rng(dimension)
    largest = 0.0
    for _ in range(count):
        known = known_answer(rng, dimension, stiff=float(rng.choice([0, 2, 5])))
        right = cq.certify(known.problem, **known.answer())
        assert right.passed, right
        noise = 10.0 ** rng.uniform(-8, 0)
        off = {name: v * (1 + noise * rng.normal(size=v.shape)) for name, v in known.answer().items()}
        off["friction_force"] = off["friction_force"] + noise * rng.normal(size=off["friction_force"].shape)
        wrong = cq.certify(known.problem, **off)
        if wrong.natural_map is not None:
            worst = max(getattr(wrong, name) for name in LAW)
            assert wrong.natural_map <= IMPLIED * worst
            largest = max(largest, wrong.natural_map / worst)
    assert largest > 0.5, "it is no smaller a thing than the others"


def _transformed(known: Known, length: float, force: float, d: np.ndarray, r: np.ndarray) -> Known:
    """u = length d v, forces times `force`, rows of contact i times r_i."""
    p, t = known.problem, known.friction_force.shape[1]
    rows = np.repeat(r, t)
    problem = cq.ContactProblem(
        stiffness=p.stiffness * np.outer(d, d) * force / length,
        load=p.load * d * force,
        normal=p.normal.toarray() * d * r[:, None],
        gap=p.gap * length * r,
        tangent=p.tangent.toarray() * d * rows[:, None],
        friction=p.friction,
        slip_origin=p.slip_origin * length * r[:, None],
        tie=p.tie.toarray() * d if p.ties else None,
        tie_value=p.tie_value * length if p.ties else None,
    )
    forces = (known.normal_force * force / r, known.friction_force * force / r[:, None], known.tie_force * force)
    return Known(problem, known.displacement * length / d, *forces)


@pytest.mark.slow
@pytest.mark.parametrize("count", [8, pytest.param(25, marks=pytest.mark.slow)])
@pytest.mark.parametrize("what", ["units", "unknowns", "rows"])
@pytest.mark.parametrize("dimension", [2, 3])
def test_the_natural_map_is_invariant(what: str, dimension: int, count: int) -> None:
    rng, compared = np.random.default_rng(5), 0
    for _ in range(count):
        known = known_answer(rng, dimension)
        if not known.problem.frictional:
            continue
        compared += 1
        moved = dataclasses.replace(
            known,
            displacement=known.displacement * (1 + 0.1 * rng.normal(size=known.displacement.shape)),
            friction_force=known.friction_force + 0.1 * rng.normal(size=known.friction_force.shape),
        )
        length, force = 10.0 ** rng.uniform(-6, 6), 10.0 ** rng.uniform(-9, 9)
        d, r = 10.0 ** rng.uniform(-4, 4, known.problem.dimension), 10.0 ** rng.uniform(-4, 4, known.problem.contacts)
        ones = (1.0, 1.0, np.ones_like(d), np.ones_like(r))
        change = {"units": (length, force, *ones[2:]), "unknowns": (*ones[:2], d, ones[3]), "rows": (*ones[:3], r)}
        one, other = moved, _transformed(moved, *change[what])
        here = cq.certify(one.problem, **one.answer()).natural_map
        there = cq.certify(other.problem, **other.answer()).natural_map
        assert here > 1e-4
        assert there == pytest.approx(here, rel=1e-9)
    assert compared >= count / 2


@pytest.mark.slow
def test_exact_answers_of_stiff_and_floating_problems_pass() -> None:
    rng = np.random.default_rng(8)
    states = [state for _ in range(15) for state in cq.equilibria(random_problem(rng))]
    assert len(states) >= 10
    for state in states:
        assert state.certificate.natural_map < 1e-10
    for pull in (2.4, 2.5, 7.35, 12.0):
        assert cq.solve(two_masses(pull)).certificate.natural_map < 1e-14
    for factor in (1e-12, 1e12):
        p = rough_truss()
        stiff = cq.solve(p.replace(stiffness=p.stiffness * factor, load=p.load * factor))
        assert stiff.certificate.natural_map < 1e-14


def test_an_open_contact_without_friction_obeys_the_law_whether_it_slips_or_not() -> None:
    """r = 0, u_N > 0: at rest sideways too, where 0 <= mu (r_N - u_N) = -0 says nothing of the cone, a half line."""
    from contactqp.certificate.coulomb_law import natural_map

    for slip in (0.0, 1.0):
        assert not np.any(natural_map(np.zeros((1, 2)), np.array([[0.7, slip]]), np.zeros(1)))
    assert natural_map(np.zeros((1, 2)), np.array([[-0.7, 0.0]]), np.zeros(1))[0, 0] == -0.7
