"""The campaign of random frictional problems: a part of it, and that its own checks can fail."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import contactqp as cq
from benchmarks.friction_families import FAMILIES, Posed, Units, contact_problem, local_problem
from benchmarks.friction_law import broken, broken_locally
from benchmarks.friction_on_bodies import MAKERS
from benchmarks.friction_random import judge, table


@pytest.mark.slow
@pytest.mark.parametrize(("every", "solvable"), [(4, 4), pytest.param(2, 9, marks=pytest.mark.slow)])
def test_nothing_is_wrong_and_the_default_solves_what_has_an_answer(every: int, solvable: int) -> None:
    reports = [judge(family, 0) for family in FAMILIES[::every]]
    assert [line for report in reports for line in report.wrong] == []
    assert sum(report.exists for report in reports) >= solvable
    assert all(report.outcomes["default"] == "solved" for report in reports if report.exists)
    assert any("local problems in space" in line for line in table(reports))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("family", "seed"),
    [
        ("more singular 2D", 4),  # a contact that rigid motions alone move: its compliance is rounding
        ("local unsymmetric 3D", 1),  # Gauss-Seidel stops where the certificate just passes
        ("stack_free_to_slide 2D", 34),  # put to rest, a contact slips by rounding against its own friction
        ("unstrained 2D", 196),  # rounding of a free direction gives contacts no room
        ("printed_floating 2D", 97),  # digits that sum to zero hold a turn by 1e-16 of the stiffness in doubles
    ],
)
def test_what_the_campaign_found(family: str, seed: int) -> None:
    assert judge(family, seed).wrong == []


@pytest.mark.slow
@pytest.mark.parametrize("name", MAKERS)
def test_bodies_that_only_move_or_hardly_move_have_an_equilibrium(name: str) -> None:
    for seed in range(3):
        assert cq.exact_equilibria(contact_problem(f"{name} 2D", seed).plain)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("family", "seed"),
    [
        ("unstrained 3D", 73),  # contacts that move little: no iterate's forces tell which of them stick
        ("unstrained 2D", 165),  # the first answer sticks by a slip of 3e-11, a thirtieth of the strain
        ("unstrained 3D", 144),  # the only contact that sticks has no friction: its correction is all of its force
        ("pushed_rigidly 3D", 37),  # refined along a free motion of 1e9, and put to rest
        ("pushed_rigidly 3D", 138),  # two answers meet in one, where Newton's corrections halve
        ("bedded 3D", 31),  # forces of 1e-8, and one of 1e-14 at its friction bound
        ("interference_removed 3D", 10),
        ("printed_floating 3D", 156),  # a family of near answers along a turn that contacts hold by rounding alone
    ],
)
def test_the_default_finds_an_answer_of_bodies_that_hardly_deform(family: str, seed: int) -> None:
    posed = contact_problem(family, seed)
    found = cq.solve(posed.problem)
    assert found.certificate.passed
    assert broken(posed, found) < 1e-9


def test_the_law_written_out_refuses_what_is_spoiled() -> None:
    posed = contact_problem("made around an answer 2D", 1)
    right = cq.solve(posed.problem)
    assert np.any(right.friction_force != 0)
    assert broken(posed, right) < 1e-12
    assert broken(posed, replace(right, answer=replace(right.answer, friction_force=-right.friction_force))) > 1e-3
    assert broken(posed, replace(right, answer=replace(right.answer, normal_force=1.001 * right.normal_force))) > 1e-5
    assert broken(posed, replace(right, answer=replace(right.answer, displacement=right.displacement + 1e-3))) > 1e-5
    problem, _ = local_problem("local unsymmetric 2D", 1)
    found = cq.solve(problem)
    assert broken_locally(problem, found) < 1e-12
    assert broken_locally(problem, replace(found, force=-found.force)) > 1e-3
    assert broken_locally(problem, replace(found, force=found.force + 1e-3)) > 1e-5


def test_bad_units_change_no_answer() -> None:
    posed = contact_problem("bad units 2D", 2)
    plain = cq.equilibria(posed.plain)
    assert posed.units.length != 1
    found = [one.displacement / posed.units.unknown / posed.units.length for one in cq.equilibria(posed.problem)]
    assert len(found) == len(plain)
    for u, known in zip(found, plain, strict=True):
        np.testing.assert_allclose(u, known.displacement, rtol=1e-12)


def test_at_rest_under_nothing_an_answer_is_held_against_the_gap_that_is_there() -> None:
    problem = cq.ContactProblem(
        np.diag([2.0, 3.0]), [0.0, 0.0], [[1.0, 0.0], [1.0, 0.0]], [0.0, 0.5], tangent=[[0.0, 1.0], [0.0, 1.0]],
        friction=0.5,
    )  # fmt: skip
    posed = Posed(problem, problem, Units(np.ones(2), np.ones(2), 1.0, 1.0), True)
    rest = cq.solve(problem)
    noisy = replace(rest, answer=replace(rest.answer, displacement=np.array([2e-16, 5e-16])))
    assert broken(posed, noisy) < 1e-14  # of nothing at all it would be a large part
    assert broken(posed, replace(rest, answer=replace(rest.answer, displacement=np.array([1e-6, 0.0])))) > 1e-7
    loaded = Posed(problem, problem.replace(load=[1e-15, 0.0]), posed.units, True)
    assert broken(loaded, noisy) > 1e-2
