"""Exact answers of the cases: the published rationals, what the cases themselves claim, and the roots they hold."""

from __future__ import annotations

import pathlib
from fractions import Fraction as F
from typing import Any

import flint
import numpy as np
import pytest

import contactqp as cq
from contactqp.oracle.exact import enclosed_answer, rational_answer
from contactqp.oracle.exact.enclosed_scene import root
from contactqp.scene.answers import Answer, Instant
from contactqp.scene.building import build
from contactqp.scene.claims import Expectation
from contactqp.scene.scene import Scene
from tests.clocks import Clock
from tests.shipped_cases import SCENES

CASES = pathlib.Path(__file__).parents[2] / "cases"
NODES = [name for name, scene in SCENES.items() if not (scene.meshed or scene.large or scene.motion is not None)]
# Irrational geometry with friction on a path.
NOT_COVERED = {"wedge"}
# Its slip_origin is a root rounded to eighteen digits, its claims are of the root.
ROUNDED = {"truss_rough_penalty"}


def exact(name: str) -> cq.ExactSolution:
    return cq.exact(cq.load_scene(CASES / f"{name}.toml"))


# Exact rationals of the course chapter's examples, derived apart from this package: (u, l_N, l_T, nu).
PUBLISHED = {
    "bar_wall": ("1/1000", "285/2", "", ""),  # Example 2.5
    "bar_wall_path": ("1/1000", "285/2", "", ""),
    "master_slave_gap": ("11657/28588 4869/28588 21289/28588 3693/14294", "", "", None),  # equation 2.20
    "truss_floor_printed": ("668831/598030000 -1/1000", "180933933661/5980300000", "", ""),  # Example 2.10
    "two_bars": ("41/31500 19/63000", "95", "", ""),  # Example 2.13
    "two_bars_path": ("41/31500 19/63000", "95", "", ""),
    "truss_rough": (  # Example 2.17
        "533489/639328600 -1/1000",
        "180933933661/6393286000",
        "542801800983/31966430000",
        "",
    ),
    "truss_friction": (  # Example 2.18
        "30058/30933965 -1/1000",
        "180933933661/6186793000",
        "542801800983/61867930000",
        "",
    ),
    "two_masses": (  # Example 2.19, pulled and let go
        "1857/400000 0 1419/200000 0",
        "981/50 981/100",
        "-219/100 -981/400",
        "",
    ),
    "two_masses_penalty": (  # Example 2.19 on springs of 1e4 N/m
        "1599/400000 129/20000",
        "981/50 981/100",
        "-309/200 -981/400",
        "",
    ),
    "string_over_floor": (  # Example 2.22, eight elements
        "-3/32 -1/8 -1/8 -1/8 -1/8 -1/8 -3/32",
        "0 1/8 1/4 1/4 1/4 1/8 0",
        "",
        "",
    ),
}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", PUBLISHED)
def test_the_exact_answer_equals_the_published_rational(name: str) -> None:
    answer, (displacement, push, rub, _) = exact(name), PUBLISHED[name]
    assert answer.rational
    if name == "two_masses_penalty":  # the blocks' own displacements; the rest are sliders behind the springs
        assert {F(x) for x in displacement.split()} <= set(answer.displacement)
    else:
        assert list(answer.displacement) == [F(x) for x in displacement.split()]
    assert list(answer.normal_force) == [F(x) for x in push.split()]
    if rub:
        assert answer.friction_force is not None
        assert list(answer.friction_force.ravel()) == [F(x) for x in rub.split()]


def test_the_energies_of_the_course_chapter() -> None:
    assert exact("bar_wall").energy == F(-177, 800)
    assert exact("truss_floor_printed").energy == F(-1180262533661, 11960600000000)
    assert exact("two_bars").energy == F(-2039, 8400)


def _values(scene: Scene, answer: cq.ExactSolution, claim: Expectation) -> tuple[F, float] | None:
    """What an answer says of a claim, and its radius; None of what it says nothing about."""
    problem = answer.problem
    if claim.quantity == "displacement":
        place = [problem.dof_name(j) for j in range(problem.dimension)]
        if claim.at not in place:
            return None
        at = place.index(str(claim.at))
        return answer.displacement[at], 0.0 if answer.radius is None else answer.radius.displacement[at]
    if claim.quantity in ("normal force", "gap"):
        name = claim.quantity.replace(" ", "_")
        at = [problem.contact_name(i) for i in range(problem.contacts)].index(str(claim.at))
        return getattr(answer, name)[at], 0.0 if answer.radius is None else getattr(answer.radius, name)[at]
    if claim.quantity == "tie force":
        at = [tie.name for tie in scene.ties].index(str(claim.at))
        return answer.tie_force[at], 0.0
    return None


@pytest.mark.sampled(14)
@pytest.mark.parametrize("name", [name for name in NODES if name not in NOT_COVERED])
def test_what_a_case_claims_is_exactly_so(name: str) -> None:
    scene = cq.load_scene(CASES / f"{name}.toml")
    answer, checked = cq.exact(scene), 0
    for claim in scene.expect:
        if claim.method is not None or claim.time is not None or claim.reached is not None:
            continue
        if claim.load_factor != 1 or claim.with_respect_to is not None:
            continue
        if claim.quantity == "status":
            at = [c.name for c in scene.contacts].index(str(claim.at))
            assert answer.contact_status[at] == claim.value
            checked += 1
        elif (found := _values(scene, answer, claim)) is not None:
            value = scene.system.value(claim.targets[0])
            # Roots in a claim are read to some ninety digits.
            digits = 17 if name in ROUNDED else 80
            assert abs(found[0] - value) <= F(found[1]) + (0 if answer.rational else abs(value) / 10**digits), claim
            checked += 1
    assert checked or name == "truss_free"


@pytest.mark.parametrize("name", ["bar_touch_down", "bar_gap_design", "truss_friction"])
def test_derivatives_that_a_case_claims_are_those_of_its_numbers_in_fractions(name: str) -> None:
    scene = cq.load_scene(CASES / f"{name}.toml")
    model, checked = build(scene), 0
    for claim in scene.expect:
        if claim.with_respect_to is None:
            continue
        problem = model.problem.replace(load=model.load_at(claim.load_factor))
        answer = Answer(model, cq.exact(problem), Instant(claim.load_factor))
        value = scene.system.value(claim.targets[0])
        assert abs(F(answer.value_of(claim)) - value) <= F(1, 10**14) * abs(value), claim  # data rounded to doubles
        checked += 1
    assert checked >= 3


def test_irrational_lengths_are_enclosed_and_hold_the_root_of_two() -> None:
    answer = exact("truss_floor")
    assert not answer.rational
    assert answer.radius is not None
    with flint.ctx.workprec(2000):
        root = flint.arb(2).sqrt()
        for mid, radius, value in (
            (answer.displacement[0], answer.radius.displacement[0], 59 * root / 274204 + flint.arb(55807) / 68551000),
            (answer.displacement[1], answer.radius.displacement[1], flint.arb(-1) / 1000),
            (answer.normal_force[0], answer.radius.normal_force[0], (64855 - 15930 * root) / 1399),
        ):
            middle = flint.arb(flint.fmpq(mid.numerator, mid.denominator))
            assert abs(middle - value) <= flint.arb(flint.fmpq(*radius.as_integer_ratio()))
            assert 0 < radius <= 1e-60 * abs(mid)
    assert answer.doubles.normal_force[0] == 30.2548805942791965


def test_a_case_is_read_exactly_and_a_problem_as_it_stands() -> None:
    scene = cq.load_scene(CASES / "truss_floor_printed.toml")
    problem = cq.ContactProblem([[59803.0, 6883.1], [6883.1, 77443.0]], [60.0, -100.0], [[0.0, -1.0]], [1e-3])
    of_case, of_floats = cq.exact(scene), cq.exact(problem)
    assert of_case.displacement[1] == F(-1, 1000)
    assert of_floats.displacement[1] == -F(1e-3) != F(-1, 1000)
    # 6883.1 and 1e-3 are no doubles: the answers differ beyond the last digits of doubles, and only there.
    assert of_floats.normal_force[0] != of_case.normal_force[0]
    assert of_floats.doubles.normal_force[0] == pytest.approx(of_case.doubles.normal_force[0], rel=1e-15)


@pytest.mark.parametrize("name", ["hanging_block", "corner_triangle"])
def test_what_is_not_the_only_answer_says_so(name: str) -> None:
    scene = cq.load_scene(CASES / f"{name}.toml").model_copy(update={"path": None})
    answer = cq.exact(scene)
    assert "several answers" in answer.uniqueness
    assert answer.equilibria is None or answer.equilibria > 1


def test_a_slip_direction_in_space_that_is_rational() -> None:
    answer = exact("block_on_incline_sideways")
    assert answer.rational
    assert answer.friction_force is not None
    assert list(answer.friction_force[0]) == [F(3600, 13), F(1500, 13)]  # mu N = 300 along (12, 5) / 13
    assert answer.contact_status == ("slip",)
    assert answer.slip is not None
    assert answer.slip[0, 0] / answer.slip[0, 1] == F(12, 5)


@pytest.mark.sampled(6)
@pytest.mark.parametrize("name", ["truss_floor_printed", "two_bars", "string_over_floor_fine", "cantilever_stop"])
@pytest.mark.parametrize("method", ["clarabel", "osqp", "lemke"])
def test_any_method_may_propose(name: str, method: str) -> None:
    scene = cq.load_scene(CASES / f"{name}.toml")
    other = cq.exact(scene, method)
    assert other.method == method
    assert list(other.normal_force) == list(cq.exact(scene).normal_force)


def test_doubles_are_the_nearest() -> None:
    answer = exact("string_over_floor_fine")
    assert any(answer.normal_force)
    for x, double in zip(answer.normal_force, answer.doubles.normal_force, strict=True):
        near = [np.nextafter(double, -np.inf), double, np.nextafter(double, np.inf)]
        assert min(near, key=lambda y: abs(F(float(y)) - x)) == double


TILTED = """
title = "A tilted frame"
units = { length = "m", force = "kN" }
axes = ["x", "z"]
gravity = ["0 m/s^2", "-9.81 m/s^2"]
nodes = [
    { name = "a", at = ["0 m", "0 m"] },
    { name = "b", at = ["1 m", "2 m"] },
    { name = "c", at = ["3 m", "2.5 m"] },
    { name = "d", at = ["4 m", "0 m"] },
    { name = "e", at = ["3.001 m", "2.4 m"] },
    { name = "f", at = ["3 m", "1 m"] },
]
bars = [
    { name = "cd", nodes = ["c", "d"], area = "15 cm^2", modulus = "2.1e8 kN/m^2", density = "7850 kg/m^3" },
    { name = "ed", nodes = ["e", "d"], area = "15 cm^2", modulus = "2.1e8 kN/m^2" },
    { name = "ef", nodes = ["e", "f"], area = "15 cm^2", modulus = "2.1e8 kN/m^2" },
]
beams = [
    { name = "ab", nodes = ["a", "b"], area = "15 cm^2", inertia = "300 cm^4", modulus = "2.1e8 kN/m^2" },
    { name = "bc", nodes = ["b", "c"], area = "15 cm^2", inertia = "300 cm^4", modulus = "2.1e8 kN/m^2" },
]
springs = [{ name = "bd", nodes = ["b", "d"], stiffness = "100 kN/m" }]
fixed = ["a", "d", "f"]
obstacles = [{ name = "wall", point = ["1.001 m", "2 m"], normal = [-1, -1] }]
contacts = [{ name = "tip", node = "b", obstacle = "wall" }, { name = "pair", nodes = ["c", "e"] }]
loads = [{ unknown = "b.x", value = "300 kN" }, { unknown = "c.z", value = "-300 kN" }]
"""


def test_every_root_of_a_frame_is_carried_as_a_ball(tmp_path: pathlib.Path) -> None:
    """Beams, bars, springs, weights, an oblique wall and an oblique pair: nothing is a float on the way."""
    case = tmp_path / "tilted.toml"
    case.write_text(TILTED)
    scene = cq.load_scene(case)
    answer, floats = cq.exact(scene), cq.run(scene)[-1]
    assert answer.radius is not None
    assert answer.contact_status == ("closed", "open")
    assert answer.doubles.displacement == pytest.approx(floats.displacement, rel=1e-10)
    assert answer.doubles.normal_force == pytest.approx(floats.normal_force, rel=1e-12)
    seen = answer.doubles.displacement != 0
    assert np.max(answer.radius.displacement[seen] / abs(answer.doubles.displacement[seen])) < 1e-60


def test_a_ball_does_not_compute_with_what_may_be_rounded() -> None:
    ball = root(F(2))
    for other in (0.5, np.float64(0.5)):
        with pytest.raises(TypeError):
            ball * other
        with pytest.raises(TypeError):
            other - ball
    assert not ball - ball > 0
    assert not ball - ball < 0
    with pytest.raises(TypeError):
        float(ball)  # type: ignore[arg-type]


def test_a_printed_matrix_that_is_not_symmetric_is_symmetrised_and_said_to_be(tmp_path: pathlib.Path) -> None:
    """An exact answer to another matrix than floats solve would agree with nothing, and is no minimum of an energy."""
    case = """
        title = "printed"
        units = { length = "m", force = "N" }
        axes = ["x", "z"]
        nodes = [{ name = "A", at = ["0 m", "%s"] }]
        matrices = [{ name = "K", unknowns = ["A.x", "A.z"], unit = "N/m", rows = [[6, 5], [5.000001, 6]] }]
        obstacles = [{ name = "floor", point = ["0 m", "0 m"], normal = [0, 1] }]
        contacts = [{ name = "corner", node = "A", obstacle = "floor" }]
        loads = [{ name = "press", unknown = "A.z", value = "-1 N" }]
    """
    file = tmp_path / "printed.toml"
    file.write_text(case % "1 m")
    answer = cq.exact(cq.load_scene(file))
    mean = F(50000005, 10**7)
    determinant = 36 - mean**2
    assert answer.displacement.tolist() == [mean / determinant, -6 / determinant]
    assert any("asymmetric as given, by 1.67e-07" in note for note in answer.notes)
    file.write_text((case % "1 m").replace("5.000001", "5"))
    assert cq.exact(cq.load_scene(file)).notes == ()


SPRINGS = cq.ContactProblem(np.diag([2.0, 4.0]), [3.0, 1.0], np.eye(2), [0.5, 1.0])
PAD = cq.ContactProblem([[1.0, 0.0], [0.0, 2.0]], [5.0, -10.0], [[0.0, -1.0]], [0.5], [[1.0, 0.0]], 0.25)
LATE = {
    "rational": (lambda **limit: cq.exact(SPRINGS, **limit), "the stiffness was proven to be positive semidefinite"),
    "enclosed": (lambda **limit: cq.exact(SPRINGS, enclose=True, **limit), "round 1 of the refinement"),
    "friction": (lambda **limit: cq.exact(PAD, **limit), "a linear system was solved in rational numbers"),
    "roots": (lambda **limit: cq.exact(cq.load_scene(CASES / "truss_floor.toml"), **limit), "the answer was enclosed"),
}


@pytest.mark.parametrize("name", LATE)
def test_the_proof_ends_with_the_time_limit_of_the_call(
    name: str, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The answer in floats takes all the time, and is what the error has."""
    run, what = LATE[name]
    run(time_limit=100.0)

    def slowly(*arguments: Any, **options: Any) -> cq.Solution:
        found = cq.solve(*arguments, **options)
        clock.passes(300.0)
        return found

    for module in (enclosed_answer, rational_answer):
        monkeypatch.setattr(module, "solve", slowly)
    with pytest.raises(cq.NotConverged, match=f"stopped at the time limit of 100 s, before {what}") as caught:
        run(time_limit=100.0)
    assert caught.value.solution.certificate.passed
    with pytest.raises(cq.InvalidProblem, match="time_limit"):
        run(time_limit=-1.0)
