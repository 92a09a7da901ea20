"""Problems in units of any size: the same verdict and the same digits as in units in which numbers are near one."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.linalg.existence import Conflict, DrivenMotion

# Two bodies on springs, one contact between them that closes and one to a wall that stays open, one tie.
DATA: dict[str, Any] = dict(
    stiffness=np.array([[4.0, -1.0, 0.0], [-1.0, 5.0, 2.5], [0.0, 2.5, 3.0]]),
    load=np.array([2.0, 1.0, 0.5]),
    normal=np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    gap=np.array([0.1, 5.0]),
    tie=np.array([[0.0, 1.0, -1.0]]),
    tie_value=np.array([0.01]),
)
RUBS: dict[str, Any] = dict(tangent=np.array([[0.0, 1.0, 0.0], [0.0, 1.0, 0.0]]), friction=0.25)
SPACE: dict[str, Any] = dict(
    stiffness=np.diag([3.0, 2.0, 2.0]), load=[-3.0, 2.0, 1.0], normal=[[-1.0, 0.0, 0.0]], gap=[0.0],
    tangent=[[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], friction=0.5,
)  # fmt: skip
SIZES = [(2.0**400, 2.0**-300), (2.0**-330, 2.0**320), (2.0**300, 2.0**300)]


def in_units(data: dict[str, Any], length: float, force: float, row: float = 1.0) -> cq.ContactProblem:
    """The problem with lengths and forces in other units, and rows and gaps times a factor."""
    changed = dict(data)
    changed["stiffness"] = np.asarray(data["stiffness"]) * (force / length)
    changed["load"] = np.asarray(data["load"]) * force
    changed["normal"] = np.asarray(data["normal"]) * row
    changed["gap"] = np.asarray(data["gap"]) * row * length
    if "tie_value" in data:
        changed["tie_value"] = data["tie_value"] * length
    if "tangent" in data:
        changed["tangent"] = np.asarray(data["tangent"]) * row
    return cq.ContactProblem(**changed)


@pytest.mark.sampled(10)
@pytest.mark.parametrize(("length", "force"), SIZES)
@pytest.mark.parametrize("data", [DATA, DATA | RUBS, SPACE], ids=["frictionless", "plane", "space"])
@pytest.mark.parametrize("row", [1.0, 2.0**-200])
def test_units_change_no_digit_and_no_verdict(data: dict[str, Any], length: float, force: float, row: float) -> None:
    near, far = cq.solve(in_units(data, 1.0, 1.0)), cq.solve(in_units(data, length, force, row))
    assert near.normal_force[0] > 0  # the contact closes, or nothing would be shown
    assert far.displacement / length == pytest.approx(near.displacement, rel=1e-14)
    assert far.normal_force / force * row == pytest.approx(near.normal_force, rel=1e-14)
    assert far.tie_force / force == pytest.approx(near.tie_force, rel=1e-14)
    assert list(far.contact_status) == list(near.contact_status)
    assert (far.certificate.passed, far.certificate.proven) == (near.certificate.passed, near.certificate.proven)
    if near.friction_force is not None:
        assert far.friction_force / force * row == pytest.approx(near.friction_force, rel=1e-14)


@pytest.mark.parametrize("power", [-100, 100, 150])
def test_units_of_ten_give_the_same_answer(power: int) -> None:
    near, far = cq.solve(in_units(DATA, 1.0, 1.0)), cq.solve(in_units(DATA, 10.0**power, 10.0 ** (power / 2)))
    assert far.certificate.proven
    assert far.displacement / 10.0**power == pytest.approx(near.displacement, rel=1e-12)


@pytest.mark.parametrize(("length", "force"), SIZES)
def test_bounds_have_the_units_of_the_problem(length: float, force: float) -> None:
    near, far = in_units(DATA, 1.0, 1.0), in_units(DATA, length, force)
    right = cq.solve(near)
    parts = (right.displacement * (1 + 1e-4), right.normal_force * (1 - 1e-4), None, right.tie_force)
    other = (parts[0] * length, parts[1] * force, None, parts[3] * force)
    mine, theirs = cq.certify(near, *parts), cq.certify(far, *other)
    assert theirs.energy_error == pytest.approx(mine.energy_error, rel=1e-9)
    assert theirs.force_bound / force == pytest.approx(mine.force_bound, rel=1e-9)
    assert theirs.violations is not None
    assert mine.violations is not None
    assert theirs.violations.residual / force == pytest.approx(mine.violations.residual, rel=1e-9)
    assert theirs.violations.gap / length == pytest.approx(mine.violations.gap, rel=1e-9)
    assert theirs.violations.lengths / length == pytest.approx(mine.violations.lengths, rel=1e-9)
    assert not theirs.passed


def test_messages_speak_in_the_units_of_the_problem() -> None:
    wall = cq.ContactProblem([[1e200]], [3e200], [[1.0]], [1.0], units={"length": "m", "force": "N"})
    failures = cq.certify(wall, [1.0], [-2e200]).failures
    assert any("-2e+200 N" in failure for failure in failures)


@pytest.mark.sampled(20)
@pytest.mark.parametrize("value", [1e308, -1e305, 1e100, np.nan, np.inf])
@pytest.mark.parametrize("part", ["displacement", "normal_force", "tie_force", "friction_force"])
def test_absurd_answers_are_refused_by_name(part: str, value: float) -> None:
    problem = in_units(DATA | RUBS, 1.0, 1.0)
    right = cq.solve(problem)
    parts = {
        name: np.array(getattr(right, name)) for name in ("displacement", "normal_force", "friction_force", "tie_force")
    }
    parts[part].flat[0] = value
    judged = cq.certify(problem, **parts)
    assert not judged.passed
    assert any(failure.startswith(f"{part}: ") for failure in judged.failures)
    if np.isfinite(value):
        assert any("diverged" in failure for failure in judged.failures)
    assert judged.diagnosis


@pytest.mark.parametrize("size", [1e150, 1e-150])
def test_proofs_of_absence_are_those_of_the_problem(size: float) -> None:
    rows, gap = np.array([[size, 0.0], [-2.0 * size, 0.0]]), np.array([size, -3.0 * size])
    between = cq.ContactProblem(np.diag([1e200, 1.0]), [0.0, 1.0], rows, gap)
    with pytest.raises(cq.NoEquilibrium) as caught:
        cq.solve(between)
    proof = caught.value.proof
    assert isinstance(proof, Conflict)
    assert rows.T @ proof.normal == pytest.approx([0.0, 0.0], abs=1e-12 * size)
    assert np.min(proof.normal) >= 0
    assert -(gap @ proof.normal) == pytest.approx(proof.excess, rel=1e-9)
    assert proof.excess > 0


def test_a_driven_motion_has_the_units_of_the_problem() -> None:
    K = 1e180 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    free = cq.ContactProblem(K, [3e90, 1e90], [[1.0, 0.0]], [np.inf])
    with pytest.raises(cq.NoEquilibrium) as caught:
        cq.solve(free.replace(gap=[np.inf]))
    proof = caught.value.proof
    assert isinstance(proof, DrivenMotion)
    assert proof.motion == pytest.approx([1.0, 1.0])
    assert proof.work == pytest.approx(4e90)


def test_what_doubles_cannot_hold_is_refused_by_name() -> None:
    with pytest.raises(cq.InvalidProblem, match=r"displacement: that of unknown 0 is beyond 1.8e308"):
        cq.solve(cq.ContactProblem([[1e-200]], [1e200], [[-1.0]], [1.0]))
    # The nearer wall is 1e250 away from where anything else moves, and the load drives the mass to it.
    with pytest.raises(cq.InvalidProblem, match=r"gap: contact 0 closes only after 1e\+250"):
        cq.solve(cq.ContactProblem(np.diag([0.0, 1.0]), [1.0, 1.0], [[1.0, 0.0]], [1e250]))
    with pytest.raises(cq.InvalidProblem, match="follow_path: expected stiffnesses"):
        cq.follow_path(cq.ContactProblem([[1e200]], [1e200], [[1.0]], [1.0]), [[1e200]])


def test_tangential_rows_of_another_unit_keep_their_friction() -> None:
    near = cq.ContactProblem(**SPACE)
    far = near.replace(tangent=near.tangent.toarray() * 2.0**-100, friction=0.5 * 2.0**100)
    one, other = cq.solve(near), cq.solve(far)
    assert other.displacement == pytest.approx(one.displacement, rel=1e-12)
    assert other.friction_force * 2.0**-100 == pytest.approx(one.friction_force, rel=1e-12)
    assert cq.critical_friction(far).ratio == pytest.approx(cq.critical_friction(near).ratio)


def test_all_equilibria_are_found_in_any_units() -> None:
    klarbring: dict[str, Any] = dict(
        stiffness=[[5.0, -2.0], [-2.0, 1.0]], normal=[[-1.0, 0.0]], gap=[0.0], tangent=[[0.0, 1.0]], load=[-1.0, 0.65],
        friction=0.8,
    )  # fmt: skip
    far = in_units(klarbring, 2.0**300, 2.0**-200)
    assert [str(one.contact_status[0]) for one in cq.equilibria(far)] == ["open", "stick", "slip"]
    assert cq.critical_friction(far).single == pytest.approx([0.5])


@pytest.mark.parametrize("method", ["penalty", "perturbed-lagrangian"])
def test_contact_stiffnesses_are_those_of_the_problem(method: str) -> None:
    knob = {"penalty": "penalty", "perturbed-lagrangian": "perturbation"}[method]
    length, force, row = 2.0**300, 2.0**-200, 2.0**-100
    near = cq.solve(in_units(DATA, 1.0, 1.0), method, **{knob: 1e3})
    far = cq.solve(in_units(DATA, length, force, row), method, **{knob: 1e3 * force / length / row**2})
    assert far.displacement / length == pytest.approx(near.displacement, rel=1e-12)


def test_a_start_is_one_in_the_units_of_the_problem() -> None:
    far = in_units(DATA, 2.0**300, 2.0**300)
    first = cq.solve(far)
    again = cq.solve(far.replace(load=far.load * 1.01), warm_start=first)
    assert again.certificate.proven
    assert again.work.iterations == 1


def test_unknowns_without_stiffness_are_measured_by_their_own_entries() -> None:
    # The column of the second unknown alone says what its unit is; the squares of its entries are none.
    far = cq.ContactProblem(np.diag([1.0, 0.0]), [1.0, 0.0], [[1.0, 1e-170]], [0.0])
    found = cq.solve(far)
    assert found.normal_force == pytest.approx([0.0], abs=1e-12)
    assert far.normal @ found.displacement <= 1e-12
    assert found.displacement[0] == pytest.approx(1.0)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("force", [[0.0, 0.0, 0.0], [0.0, 1e200, 1.0], [1.0, 1e-160, 1e-300]])
def test_what_is_missing_is_recovered_in_any_units(force: list[float]) -> None:
    far = cq.ContactProblem([[0.0]], [0.0], [[0.0], [1.0], [1e-198]], [0.0, 0.0, 0.0])
    assert cq.certify(far, displacement=[0.0]).passed
    assert cq.certify(far, normal_force=force).passed == (force[1] == 0.0)


@pytest.mark.parametrize("length", [2.0**300, 2.0**-330])
def test_recovered_forces_have_the_units_of_the_problem(length: float) -> None:
    force = 2.0**200
    right = cq.solve(in_units(DATA, 1.0, 1.0))
    judged = cq.certify(in_units(DATA, length, force, 2.0**-100), displacement=right.displacement * length)
    assert judged.passed
    assert judged.answer.normal_force * 2.0**-100 / force == pytest.approx(right.normal_force, rel=1e-9)
    assert judged.answer.tie_force / force == pytest.approx(right.tie_force, rel=1e-9)


# A mass that no spring holds beside a bar, and two unknowns without any stiffness, on a floor with friction.
BESIDE_A_BAR: dict[str, Any] = dict(
    stiffness=np.diag([4.0, 0.0, 0.0]), load=[1.0, 3.0, 0.5], normal=[[0.0, 1.0, 0.0]], gap=[0.25],
    tangent=[[0.0, 0.0, 1.0]], friction=0.5,
)  # fmt: skip
BARE: dict[str, Any] = dict(
    stiffness=np.zeros((2, 2)), load=[3.0, 0.5], normal=[[1.0, 0.0]], gap=[0.25], tangent=[[0.0, 1.0]], friction=0.5
)
BAR = np.array([[1.0, -1.0], [-1.0, 1.0]])
FREE: dict[str, Any] = dict(  # two bars that nothing holds; what moves them least is the same in all units
    stiffness=np.kron(np.diag([2.0, 64.0]), BAR),
    load=[1.0, 0.0, 0.0, 0.0], normal=[[0.0, 1.0, -1.0, 0.0], [0.0, 0.0, 0.0, 1.0]], gap=[0.5, 0.25],
)  # fmt: skip
# Contacts and ties that say the same, so that many forces are right: the same of them are found in all units.
TIED: dict[str, Any] = dict(
    stiffness=np.zeros((3, 3)), load=[0.0, 0.0, -2.5],
    normal=[[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 0.0, -1.0]], gap=[1.0, 0.625, -0.625, -0.625],
    tie=np.array([[-1.0, 2.0, -1.0], [-1.0, 2.0, -1.0]]), tie_value=np.array([-0.25, -0.25]),
)  # fmt: skip
EITHER: dict[str, Any] = dict(
    stiffness=np.zeros((2, 2)), load=[-0.125, -1.375], tie=np.array([[0.5, 1.0]]), tie_value=np.array([-0.1875]),
    normal=[[0.0, 1.0], [1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [-1.0, 0.0]], gap=[0.25, -0.375, 0.25, 0.0, 0.75],
)  # fmt: skip
OPPOSITE: dict[str, Any] = dict(
    stiffness=np.diag([0.0, 0.158203125]), load=[0.375, -3.125],
    normal=[[0.0, 1.0], [1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, -1.0]], gap=[0.0, 0.25, -0.125, 0.0, 0.0],
    tie=np.array([[2.0, -0.5], [-0.5, 2.0]]), tie_value=np.array([-0.25, 0.0625]),
)  # fmt: skip
UNLIKE = [BESIDE_A_BAR, BARE, FREE, TIED, EITHER, OPPOSITE]
NEARER = [(2.0**-332, 2.0**332), (2.0**52, 2.0**-222), (2.0**-86, 2.0**-18), (2.0**-20, 1.0), (1.0, 2.0**-40)]


@pytest.mark.sampled(66)
@pytest.mark.parametrize(("length", "force"), [*SIZES, *NEARER])
@pytest.mark.parametrize("data", UNLIKE, ids=["beside a bar", "bare", "free", "tied", "either", "opposite"])
def test_what_no_stiffness_sees_is_the_same_in_all_units(data: dict[str, Any], length: float, force: float) -> None:
    near, far = cq.solve(in_units(data, 1.0, 1.0)), cq.solve(in_units(data, length, force))
    assert np.any(near.normal_force > 0)
    assert far.displacement / length == pytest.approx(near.displacement, rel=1e-14)
    assert far.normal_force / force == pytest.approx(near.normal_force, rel=1e-14)
    assert list(far.contact_status) == list(near.contact_status)
    assert far.certificate.passed


def test_where_other_answers_are_beyond_doubles_nothing_is_said_of_them() -> None:
    problem = cq.ContactProblem(
        stiffness=[[0.0]], load=[2.5e-200], normal=[[5.3e-170], [-6.3e138]], gap=[1.7e-243, 5.1e65],
        tangent=[[2.7e-170], [6.3e138]], friction=0.5, slip_origin=[[-4.3e111], [-1.5e111]],
    )  # fmt: skip
    judged = cq.certify(problem, displacement=[0.0], normal_force=[0.0, 0.0], friction_force=[[0.0], [0.0]])
    assert not judged.passed


@pytest.mark.parametrize("force", [1.0, 2.0**-5, 2.0**-40, 2.0**60])
def test_the_law_is_measured_alike_in_all_units_where_nothing_meets_along_a_tangent(force: float) -> None:
    """Two masses rest on a floor, and one of them is said to be pulled down: no force acts along the floor."""
    masses = dict(
        stiffness=np.array([[2.0, 0.0, -1.0, 0.0], [0.0] * 4, [-1.0, 0.0, 1.0, 0.0], [0.0] * 4]),
        load=np.array([0.0, -2.0, 0.0, -1.0]),
        normal=np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, -1.0]]),
        gap=np.zeros(2),
        tangent=np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]),
        friction=0.25,
    )
    judged = cq.certify(in_units(masses, 1.0, force), np.zeros(4), np.array([-1.0, 1.0]) * force, np.zeros((2, 1)))
    assert judged.tension == pytest.approx(1 / 3)
    assert judged.natural_map == pytest.approx(1 / 3 / 1.25)


# Problems with unknowns that only rows hold, and units of their contacts and ties in which they had no answer.
HELD_BY_ROWS: dict[str, tuple[dict[str, Any], list[float], list[float]]] = {
    "taken for driven": (
        dict(load=[2.0, 0, 2], normal=[[-2.0, 0, 2], [2, 2, -1]], gap=[0.0, 1],
             tie=[[0.0, 2, 0], [0, 1, 0]], tie_value=[-4.0, -2]), [1e15, 1e-7], [1.0, 1e3]),
    "ties in the unit of none": (
        dict(load=[-1.0, -2], normal=[[0.0, 2], [-1, 0], [0, -2]], gap=[2.0, 0, 3],
             tie=[[-1.0, -2], [2, -2]], tie_value=[-2.0, -2]), [1e4, 1e-10, 1e15], [1.0, 1e-6]),
    "ties in tiny units": (
        dict(load=[2.0, -1, -2], normal=[[0.0, 2, 0], [-2, 0, 0]], gap=[2.0, 1],
             tie=[[-2.0, 1, 1], [2, 1, 1]], tie_value=[-2.0, 2]), [100.0, 1e15], [1e-13, 1e-8]),
    "one contact with friction": (
        dict(load=[-2.0], normal=[[-2.0]], gap=[2.0], tangent=[[-2.0]], friction=0.3), [1e12], []),
    "contacts with friction in space": (
        dict(load=[0.0, 6, 3], normal=[[0.0, 2, 1], [0, 0, 2]], gap=[2.0, 2],
             tangent=[[0.0, 0, 1], [-1, 1, -1], [2, -1, 1], [2, 0, 0]], friction=0.3), [1e-10, 1e4], []),
    "beside an unknown with stiffness": (
        dict(stiffness=np.diag([8.0, 0]), load=[-2.0, -4], normal=[[0.0, -1]], gap=[1.0],
             tangent=[[-2.0, -1], [2, 0]], friction=0.3, tie=[[2.0, -1]], tie_value=[-3.0]), [100.0], [1e-12]),
}  # fmt: skip


@pytest.mark.sampled(12)
@pytest.mark.parametrize("name", HELD_BY_ROWS)
@pytest.mark.parametrize("power", [1, 8])
def test_units_of_contacts_and_ties_hide_no_answer(name: str, power: int) -> None:
    given, contacts, ties = HELD_BY_ROWS[name]
    given = dict(stiffness=np.zeros((len(given["load"]),) * 2)) | given
    expected = cq.solve(cq.ContactProblem(**given))
    r, t = np.array(contacts) ** power, np.array(ties) ** power
    scaled = dict(given, normal=np.array(given["normal"]) * r[:, None], gap=np.array(given["gap"]) * r)
    if "tangent" in given:
        tangent = np.array(given["tangent"])
        scaled["tangent"] = tangent * np.repeat(r, len(tangent) // len(r))[:, None]
    if ties:
        scaled |= dict(tie=np.array(given["tie"]) * t[:, None], tie_value=np.array(given["tie_value"]) * t)
    found = cq.solve(cq.ContactProblem(**scaled))
    assert found.certificate.passed
    assert found.normal_force * r == pytest.approx(expected.normal_force, rel=1e-9, abs=1e-9)
    assert found.displacement == pytest.approx(expected.displacement, rel=1e-9, abs=1e-9)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("unit", [1e-19, 1e-9, 1.0, 1e19])
def test_units_of_rows_hide_no_driven_motion_of_a_program(unit: float) -> None:
    rows = np.array([[0.0, 0, 1, 2, -2, 0, 0], [0, 0, 2, -1, 2, -2, 2], [0, 1, 0, 0, 0, 2, -2]])
    tie = np.array([[0.0, -2, -1, -1, -2, -1, 2], [-1, -2, -2, -2, -2, 0, 1]])
    program = cq.ContactProblem(
        np.zeros((7, 7)), [0.0, 2, 2, 1, -2, -2, -1], rows * [[1.0], [unit], [1.0]], [3.0, unit, 3.0],
        tie=tie * [[1.0], [1 / unit]], tie_value=[-6.0, -8 / unit],
    )  # fmt: skip
    with pytest.raises(cq.NoEquilibrium, match="the load drives a motion that nothing resists"):
        cq.solve(program)


def test_rows_of_several_sizes_hide_no_tension_where_nothing_is_stiff() -> None:
    """A tension of a hundred thousandth of what pushes beside it, with a load of 5e8 on another unknown."""
    problem = cq.ContactProblem(
        np.zeros((3, 3)), [-262144.0, 504.0, -536870912.0],
        [[0, 0, 2.0**-2], [0, -(2.0**-5), 0], [0, 2.0**-13, 0], [0, 0, 2.0**-5], [0, -4.0, 0]],
        [0.0, -(2.0**-21), 2.0**-29, 3 * 2.0**-41, -(2.0**-14)],
        tie=[[16.0, -(2.0**-5), 2.0**15], [-8.0, 0.046875, -(2.0**15)]], tie_value=[2.0**-22, 1.5 * 2.0**-22],
    )  # fmt: skip
    u, ties = [1.5 * 2.0**-25, 2.0**-16, 0.0], [-16384.0, 0.0]
    assert cq.certify(problem, u, [0.0, 256.0, 0.0, 0.0, 0.0], tie_force=ties).passed
    torn = cq.certify(problem, u, [0.0, 256.0 - 2.0**-8 * 4.194304, -4.194304, 0.0, 0.0], tie_force=ties)
    assert not torn.passed
    assert "tension" in torn.failures[0]


@pytest.mark.sampled(5)
@pytest.mark.parametrize("apart", [1e6, 1e12, 1e16, 1e40, 1e100])
def test_unknowns_that_nothing_is_stiff_at_have_units_of_their_own(apart: float) -> None:
    """Two unknowns tied and held by rows alone, in units far apart: lengths of one hide none of the other."""
    units = np.exp2(np.round(np.log2([1 / apart, apart])))
    problem = cq.ContactProblem(
        np.zeros((2, 2)), units * [0.0, 2.0], units * [[-1.0, 2.0], [2.0, -1.0]], [4.0, -2.0],
        tie=units * [[-2.0, 0.0]], tie_value=[4.0],
    )  # fmt: skip
    solution = cq.solve(problem)
    assert solution.displacement * units == pytest.approx([-2.0, 1.0])
    assert solution.normal_force == pytest.approx([1.0, 0.0])
    pushing = [1 + np.sqrt(2.0), 2 * np.sqrt(2.0)], [0.25 + 0.97 * np.sqrt(2.0)]
    tie = (2 * pushing[0][1] - pushing[0][0]) / 2
    assert not cq.certify(problem, np.array([-2.0, -0.5]) / units, pushing[0], None, [tie]).passed


@pytest.mark.sampled(3)
@pytest.mark.parametrize("unit", [2.0**10, 2.0**20, 2.0**36])
def test_an_unknown_without_stiffness_has_no_unit_of_the_stiff_one_beside(unit: float) -> None:
    """The stiff one's own unit is 2^10: measured by that, entries of a row are up to 2^46 times each other."""
    soft = 2.0**-20
    columns = np.array([unit, np.sqrt(soft)])
    problem = cq.ContactProblem(
        np.diag([0.0, soft]), columns * [5.0, -4.0], columns * [[-4, 6], [6, 4], [4, -4], [0, -1], [-4, 6]],
        [-0.625, 0.4375, 0.625, 0.5625, -0.75],
    )  # fmt: skip
    solution = cq.solve(problem)
    truth = [float(force) for force in cq.exact(problem).normal_force]
    assert problem.normal.T @ solution.normal_force == pytest.approx(problem.normal.T @ truth)
    assert solution.certificate.proven


@pytest.mark.sampled(3)
@pytest.mark.parametrize("decades", [6, 0, 3])
def test_redundant_rows_on_unknowns_in_units_apart(decades: int) -> None:
    """Where the closed rows and a tie leave forces undetermined K, which sees one unknown, measures them."""
    columns = np.exp2(np.round(np.log2(10) * decades * np.array([1, -1, 0, 1])))
    problem = cq.ContactProblem(
        np.diag([0.0, 0.0, 2.0, 0.0]), columns * [3.0, 2.0, 2.0, 0.0],
        columns * [[0, 2, 2, -2], [2, 0, -2, 0], [0, 2, 2, 1], [2, -1, 1, 1], [1, -1, 1, 1]],
        [-4.0, 3.0, -2.0, 3.0, 2.0],
        tie=[columns * [1, 2, 2, 1]], tie_value=[-3.0],
    )  # fmt: skip
    assert cq.solve(problem).certificate.proven


@pytest.mark.slow
def test_rows_and_unknowns_in_units_of_both_that_hide_each_other() -> None:
    """Every unknown has an entry of one half, yet what meets in the rows is 1e-25: open contacts do not push there."""
    e = 2.0**-82
    problem = cq.ContactProblem(
        np.zeros((2, 2)), [0.0, 0.5], [[-e, 0.5], [4 * e, -0.5]], [e, -e], tie=[[-0.5, 0.0]], tie_value=[0.25]
    )
    assert cq.solve(problem).normal_force == pytest.approx([1.0, 0.0])
    forces = [1 + 2 * np.sqrt(2.0), 2 * np.sqrt(2.0)]
    tie = 2 * (4 * e * forces[1] - e * forces[0])
    judged = cq.certify(problem, [-0.5, -e / 2], forces, None, [tie])
    assert not judged.passed
    assert any("complementarity" in text for text in judged.failures)


@pytest.mark.slow
def test_small_programs_without_stiffness_are_solved_where_loads_are_far_from_lengths() -> None:
    """Loads of 1e17 beside gaps of 1e-10, unknowns in units of their own: lengths were lost beside loads."""
    contacts = np.array([[-3.0, -1, -3, -1, 2], [1, 0, 1, 0, 0], [0, -1, 0, -1, 2], [-4, -2, -4, -2, 4]])
    ties = np.array([[-2.0, 0, -2, 0, 0], [3, 2, 3, 2, -4], [3, 2, 3, 2, -4]])
    u, force = np.array([-0.875, 0.0, 0.25, 1.0, 0.625]), np.array([0.25, 0.8125, 1.0, 0.0])
    load = contacts.T @ force + ties.T @ [0.3125, 0.0, -0.5625]
    unit, length, pull = 2.0 ** np.array([-20, -22, -14, 4, 14]), 2.0**-26, 2.0**34
    row, tied = 2.0 ** np.array([-10, -4, -6, 12]), 2.0 ** np.array([-6, -12, -2])
    problem = cq.ContactProblem(
        np.zeros((5, 5)),
        load * pull / unit,
        contacts / unit * row[:, None],
        contacts @ u * row * length,
        tie=ties / unit * tied[:, None],
        tie_value=ties @ u * tied * length,
    )
    solution = cq.solve(problem)
    plain = cq.solve(cq.ContactProblem(np.zeros((5, 5)), load, contacts, contacts @ u, tie=ties, tie_value=ties @ u))
    energy = -float(load @ u)
    assert plain.certificate.passed
    assert solution.certificate.passed
    assert plain.energy == pytest.approx(energy, rel=1e-9)
    assert solution.energy == pytest.approx(energy * pull * length, rel=1e-9)


@pytest.mark.parametrize(
    ("stiffness", "load", "row"), [(4.0, 5e-324, []), (1e300, 1e-30, [1.0]), (2.0**1000, 2.0**-90, [1.0])]
)
def test_an_answer_below_all_doubles_is_refused_and_is_known_in_rational_numbers(
    stiffness: float, load: float, row: list[float]
) -> None:
    """The displacement was rounded to zero, and returned with a certificate that refuses it."""
    problem = cq.ContactProblem([[stiffness]], [load], np.reshape(row, (-1, 1)), row)
    with pytest.raises(
        cq.NotCertified, match=r"displacement: the largest is below 2.2e-308; state the problem in"
    ) as no:
        cq.solve(problem)
    assert no.value.solution.displacement.tolist() == [0.0]
    assert cq.exact(problem).displacement[0] == Fraction(load) / Fraction(stiffness)


@pytest.mark.parametrize("where", [0.0, 1.0])
def test_small_numbers_beside_others_are_no_reason_to_refuse(where: float) -> None:
    """A wall of stiffness takes all of a force of 5e-324, or another unknown moves by one."""
    beside = cq.ContactProblem(np.diag([4.0, 1.0]), [5e-324, where], [[1.0, 0.0]], [0.0])
    solution = cq.solve(beside)
    assert solution.certificate.passed
    assert solution.displacement.tolist() == [0.0, where]


@pytest.mark.sampled(3)
@pytest.mark.parametrize("size", [1e-145, 1e10, 1e145])
def test_derivatives_have_their_digits_or_are_refused(size: float) -> None:
    """An unknown without stiffness in a tie of 1e155: its motion is as long, its square infinite, its rate was zero."""

    def rates(size: float) -> np.ndarray:
        stiffness = [[0.0, 0.0], [0.0, 2.0]]
        problem = cq.ContactProblem(stiffness, [2.0, 3.0], np.zeros((0, 2)), [], tie=[[size, 1.0]], tie_value=[2.0])
        return cq.solve(problem).jacobian("displacement", with_respect_to="tie_value")

    assert rates(size) == pytest.approx(np.array([[1 / size], [0.0]]), rel=1e-9, abs=1e-9 / size)
    with pytest.raises(cq.InvalidProblem, match=r"derivatives: expected stiffnesses, .* from 3e-151 to 3e\+150"):
        rates(1e155)


@pytest.mark.parametrize("friction", [None, 0.5])
@pytest.mark.parametrize("soft", [-100, -60, 0, 60])
@pytest.mark.parametrize(("part", "balances"), [(1e-3, False), (1e-8, False), (1e-12, False), (1e-15, True)])
def test_a_load_that_nothing_resists_is_measured_beside_the_loads_as_they_are_stated(
    soft: int, part: float, balances: bool, friction: float | None
) -> None:
    """A soft spring in units near one has a large load, beside which any other load would be rounding."""
    tangent = None if friction is None else [[0.0, 1.0, 0.0]]
    problem = cq.ContactProblem(
        np.diag([2.0**soft, 1.0, 0.0]), [2.0, 1.0, part], [[1.0, 0.0, 0.0]], [5.0 * 2.0**-soft], tangent,
        friction=friction,
    )  # fmt: skip
    answer = [2.0 * 2.0**-soft, 1.0, 0.0]
    assert cq.certify(problem, answer, [0.0], None if friction is None else [0.0]).passed == balances
    if balances:
        assert cq.solve(problem).certificate.passed
    else:
        with pytest.raises((cq.NoEquilibrium, cq.NotCertified)):
            cq.solve(problem)
