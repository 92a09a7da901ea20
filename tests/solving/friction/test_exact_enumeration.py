"""Enumeration in rational numbers: printed rationals, closed forms, and floating point on the same problems."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from scipy.linalg import block_diag

import contactqp as cq
from contactqp.linalg.exact_algebra import Polyhedron, solutions
from contactqp.solving.methods.penalty import with_contact_springs
from tests.solving.friction.problems import pad, random_problem, rough_truss

KLARBRING = dict(stiffness=[[5.0, -2.0], [-2.0, 1.0]], normal=[[-1.0, 0.0]], gap=[0.0], tangent=[[0.0, 1.0]])


def test_the_rationals_of_the_rough_truss() -> None:
    """Example 2.18 from its printed decimals: d1x = 30058/30933965 m, l_N = 180933933661/6186793000 kN."""
    [state] = cq.exact_equilibria(
        rough_truss(),
        stiffness=[["59803", "6883.1"], ["6883.1", "77443"]],
        gap=["1/1000"],
        friction="3/10",
        slip_origin=["533489/639328600"],
    )
    assert state.displacement.tolist() == [Fraction(30058, 30933965), Fraction(-1, 1000)]
    assert state.normal_force.tolist() == [Fraction(180933933661, 6186793000)]
    assert state.friction_force[0, 0] == Fraction(3, 10) * state.normal_force[0]
    assert state.contact_status == ("slip",)
    assert not state.continuum
    assert state.unique_forces
    # Floats as they stand are another problem, a rounding away.
    [floats] = cq.exact_equilibria(rough_truss())
    assert floats.displacement[0] != state.displacement[0]
    assert float(floats.displacement[0]) == pytest.approx(30058 / 30933965, rel=1e-14)


def test_one_contact_has_three_states_a_continuum_or_none() -> None:
    """Klarbring (1990), mu_c = 1/2: forces (l_N, l_T) of open, stick and slip worked out by hand."""
    three = cq.exact_equilibria(cq.ContactProblem(**KLARBRING, load=[-1.0, 0.65], friction=0.8), load=[-1, "0.65"])
    assert [one.contact_status[0] for one in three] == ["open", "stick", "slip"]
    assert [one.normal_force[0] for one in three][:2] == [0, 1]
    exact = cq.exact_equilibria(
        cq.ContactProblem(**KLARBRING, load=[-1.0, 0.65], friction=0.8), load=[-1, "0.65"], friction="0.8"
    )
    assert [(one.normal_force[0], one.friction_force[0, 0]) for one in exact] == [
        (0, 0),
        (1, Fraction(13, 20)),
        (Fraction(1, 2), Fraction(2, 5)),
    ]
    family = cq.exact_equilibria(cq.ContactProblem(**KLARBRING, load=[-1.0, 0.5], friction=0.5))
    assert [one.continuum for one in family] == [True]
    assert cq.exact_equilibria(pad(3636.0)) == ()


def test_forces_of_redundant_contacts_and_motions_that_nothing_resists() -> None:
    """A contact that is there twice; a block that hangs between walls under any pressure; a plate that is free."""
    twice = rough_truss(
        normal=[[0.0, -1.0]] * 2, gap=[1e-3] * 2, tangent=[[1.0, 0.0]] * 2, slip_origin=[0.0] * 2, contact_names=None
    )
    [once], [shared] = cq.exact_equilibria(rough_truss(slip_origin=0.0)), cq.exact_equilibria(twice)
    assert once.unique_forces
    assert not shared.unique_forces
    assert not shared.continuum
    assert shared.displacement.tolist() == once.displacement.tolist()
    assert sum(shared.normal_force) == once.normal_force[0]
    walls = cq.ContactProblem(
        stiffness=np.zeros((2, 2)), load=[0.0, -1.0], normal=[[1.0, 0.0], [-1.0, 0.0]], gap=[0.0, 0.0],
        tangent=[[0.0, 1.0]] * 2, friction=0.5,
    )  # fmt: skip
    hanging = cq.exact_equilibria(walls)
    assert hanging
    assert all(block.continuum for block in hanging), "pressed just so that it slides, it hangs anywhere"
    for block in hanging:
        assert sum(block.friction_force.ravel()) == -1
        assert all(abs(t) <= n / 2 for t, n in zip(block.friction_force[:, 0], block.normal_force, strict=True))
    free = cq.ContactProblem(
        stiffness=np.zeros((3, 3)), load=[1.0, -10.0, 0.0], normal=[[0.0, -1.0, 0.0]], gap=[0.0], tangent=np.eye(1, 3),
        friction=0.5,
    )  # fmt: skip
    [rests] = cq.exact_equilibria(free)
    assert rests.displacement.tolist() == [0, 0, 0]
    assert not rests.continuum


def _rational_problem(rng: np.random.Generator) -> cq.ContactProblem:
    """Small integers throughout: singular stiffness, redundant contacts, ties and grazing contacts are exactly so."""
    m = int(rng.integers(1, 4))
    n = 2 * m + int(rng.integers(0, 2))
    shape = rng.integers(-2, 3, size=(n, n if rng.random() < 0.6 else n - 1))
    stiffness = shape @ shape.T + (rng.random() < 0.3) * np.eye(n)
    normal, tangent = -np.eye(2 * m, n)[::2], np.eye(2 * m, n)[1::2]
    if rng.random() < 0.5:
        normal, tangent = rng.integers(-2, 3, size=(2, m, n))
        normal[:, 0] += 3 * (np.max(abs(normal), axis=1) == 0)
    if m > 1 and rng.random() < 0.3:  # a contact that is there twice
        normal[1], tangent[1] = normal[0], tangent[0]
    k = int(rng.random() < 0.3)
    return cq.ContactProblem(
        stiffness=stiffness,
        load=rng.integers(-4, 5, size=n),
        normal=normal,
        gap=rng.integers(-1, 2, size=m),
        tangent=tangent,
        friction=rng.choice([0.0, 0.25, 0.5, 1.0, 2.0, 5.0], size=m) + (np.arange(m) == 0) / 8,
        slip_origin=rng.integers(-1, 2, size=m),
        tie=rng.integers(1, 3, size=(k, n)) if k else None,
        tie_value=rng.integers(-1, 2, size=k) if k else None,
    )


@pytest.mark.parametrize(("count", "each"), [(6, 0), pytest.param(150, 5, marks=pytest.mark.slow)])
def test_floating_point_finds_what_rational_numbers_find(count: int, each: int) -> None:
    """Every displacement, to the last digits; of a continuum at least one member."""
    rng = np.random.default_rng(18)
    counts = {"none": 0, "one": 0, "several": 0, "continuum": 0}
    for _ in range(count):
        problem = _rational_problem(rng)
        exact, found = cq.exact_equilibria(problem), cq.equilibria(problem)
        if any(one.continuum for one in exact):
            counts["continuum"] += 1
            assert found
            continue
        counts[("none", "one", "several")[min(len(exact), 2)]] += 1
        assert len(found) == len(exact), problem
        for one in exact:
            u = one.displacement.astype(float)
            size = np.max(abs(u), initial=1e-30)
            near = min(found, key=lambda s: np.max(abs(s.displacement - u)))
            assert np.max(abs(near.displacement - u)) <= 1e-13 * size
            if one.unique_forces:
                force = one.normal_force.astype(float)
                np.testing.assert_allclose(near.normal_force, force, rtol=1e-12, atol=1e-12 * np.max(force))
            assert cq.certify(
                problem, u, one.normal_force.astype(float), one.friction_force.astype(float),
                one.tie_force.astype(float) if problem.ties else None,
            ).passed  # fmt: skip
    assert min(counts.values()) >= each, counts


def test_a_soft_body_beside_stiff_ones_is_not_missed() -> None:
    """A slip system whose smallest singular value is 5e-12 of the largest is regular: compliances differ by 1e3."""
    rng = np.random.default_rng(2)
    for _ in range(23):
        problem = random_problem(rng)
        beta, beta_T = 10 ** rng.uniform(0, 3, (2, problem.contacts))
    springs = with_contact_springs(problem, beta, beta_T)
    [state] = cq.equilibria(springs)
    same = cq.solve(springs, algorithm="tresca")
    assert state.contact_status.tolist() == same.contact_status.tolist() == ["open", "open", "slip"]
    np.testing.assert_allclose(state.displacement, same.displacement, rtol=1e-12)


def test_what_is_no_exact_value_of_the_problem() -> None:
    problem = rough_truss()
    with pytest.raises(cq.InvalidProblem, match=r"friction: expected what rounds to the problem's 0\.3, got 2/5"):
        cq.exact_equilibria(problem, friction="2/5")
    with pytest.raises(cq.InvalidProblem, match=r"gap: expected rational numbers, got 'x'"):
        cq.exact_equilibria(problem, gap=["x"])
    with pytest.raises(cq.InvalidProblem, match="stiffness: expected 4 exact values, got 1"):
        cq.exact_equilibria(problem, stiffness=[1])
    with pytest.raises(cq.InvalidProblem, match="got 'mass'"):
        cq.exact_equilibria(problem, mass=1)
    with pytest.raises(cq.InvalidProblem, match="exactly symmetric"):
        cq.exact_equilibria(problem, stiffness=[["59803", "6883.1"], ["6883.10000000001", "77443"]])
    with pytest.raises(cq.InvalidProblem, match="with friction"):
        cq.exact_equilibria(rough_truss(friction=0.0))
    space = cq.ContactProblem(np.eye(3), np.ones(3), -np.eye(1, 3), [0.0], tangent=np.eye(3)[1:], friction=0.3)
    with pytest.raises(cq.Unsupported, match="two tangential"):
        cq.exact_equilibria(space)
    seven = cq.ContactProblem(
        np.eye(14), np.zeros(14), -np.eye(7, 14), np.ones(7), tangent=np.eye(14)[7:], friction=1.0
    )
    with pytest.raises(cq.Unsupported, match=r"7 contacts; at most 6 .*; contactqp\.equilibria lists"):
        cq.exact_equilibria(seven)


@pytest.mark.slow
def test_polyhedra_against_linear_programs_in_floating_point() -> None:
    from scipy.optimize import linprog

    rng = np.random.default_rng(3)
    counts = {"empty": 0, "bounded": 0, "unbounded": 0}
    for _ in range(150):
        size, rooms = int(rng.integers(1, 4)), int(rng.integers(1, 8))
        slope, room = rng.integers(-3, 4, size=(rooms, size)), rng.integers(-3, 6, size=rooms)
        polyhedron = Polyhedron(
            [Fraction(int(x)) for x in room], [[Fraction(int(x)) for x in row] for row in slope], size
        )
        wanted = rng.integers(-2, 3, size=size)
        known = linprog(-wanted, A_ub=-slope, b_ub=room, bounds=(None, None), method="highs")
        assert polyhedron.empty == (linprog(0 * wanted, A_ub=-slope, b_ub=room, bounds=(None, None)).status == 2)
        if polyhedron.empty:
            counts["empty"] += 1
            continue
        _, high = polyhedron.range([Fraction(int(x)) for x in wanted])
        assert (high is None) == (known.status != 0)
        counts["unbounded" if high is None else "bounded"] += 1
        at = polyhedron.point() if high is None else high
        assert all(
            sum(a * x for a, x in zip(row.tolist(), at, strict=True)) >= -b
            for row, b in zip(slope, room.tolist(), strict=True)
        )
        if high is not None:
            assert float(sum(int(a) * x for a, x in zip(wanted, high, strict=True))) == pytest.approx(
                -known.fun, abs=1e-9
            )
    assert min(counts.values()) >= 10, counts


def test_systems_that_contradict_or_leave_free() -> None:
    one, two = Fraction(1), Fraction(2)
    assert solutions([[one, one, one], [two, two, one]], 2) is None
    found = solutions([[one, two, one]], 2)
    assert found is not None
    assert found.point == [1, 0]
    assert found.free == [[-2, 1]]


@pytest.mark.slow
@pytest.mark.parametrize("first", [True, False])
def test_bodies_without_an_equilibrium_have_none_beside_others(first: bool) -> None:
    """What four contacts cannot hold is not held either where a body that stands apart has a fifth one."""
    none: dict[str, Any] = {
        "stiffness": np.array([[2.25, -2.25, 0.0], [-2.25, 2.25, 0.0], [0.0, 0.0, 0.0]]),
        "load": np.array([-2.0, -4.0, 2.0]),
        "normal": np.array([[-2.0, 1.0, 2.0], [1.0, -1.0, 0.0], [2.0, -1.0, 0.0], [2.0, -2.0, 2.0]]),
        "gap": np.array([-0.5, 0.75, 1.5, -0.25]),
        "tangent": np.array([[1.0, 0.0, 1.0], [0.0, -1.0, 1.0], [2.0, 1.0, 1.0], [1.0, 2.0, 0.0]]),
        "friction": np.array([1.0, 0.5, 1.0, 1.0]),
    }
    slider: dict[str, Any] = {
        "stiffness": np.eye(2),
        "load": np.array([1.0, -3.0]),
        "normal": np.array([[0.0, -1.0]]),
        "gap": np.array([1.0]),
        "tangent": np.array([[1.0, 0.0]]),
        "friction": np.array([0.25]),
    }
    parts = (none, slider) if first else (slider, none)
    matrices = {name: block_diag(*(part[name] for part in parts)) for name in ("stiffness", "normal", "tangent")}
    vectors = {name: np.concatenate([part[name] for part in parts]) for name in ("load", "gap", "friction")}
    alone = "contact 0.*contact 3 alone" if first else "contact 1.*contact 4 alone"
    with pytest.raises(cq.NoEquilibrium, match=f"proven in rational numbers, of the bodies at {alone}"):
        cq.solve(cq.ContactProblem(**matrices, **vectors))
