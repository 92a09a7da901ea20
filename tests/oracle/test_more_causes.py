"""Two mistakes at once, offsets, units of gaps, mixed-up components, and what is said of numbers without bounds."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import contactqp as cq
from contactqp.oracle.diagnosis import diagnosis
from contactqp.testing import assert_multipliers, problem
from tests.examples import seeded_problem
from tests.oracle.test_causes import causes
from tests.solving.friction.problems import known_answer
from tests.solving.friction.space import several

UNITS = {"length": "mm", "force": "N"}


@pytest.fixture
def right() -> cq.Solution:
    return cq.solve(seeded_problem(3, 12, 8).replace(units=UNITS))


def test_two_causes_that_both_hold_are_not_offered_as_two_choices(right: cq.Solution) -> None:
    judged = cq.certify(right.problem, 1e3 * right.displacement, -right.normal_force)
    assert judged.diagnosis == (
        "all contact forces have the opposite sign, and displacements are 1000 times the right values (micrometres "
        "instead of millimetres?): with both undone this answer is right"
    )
    contact, unknown = np.arange(8)[::-1], np.arange(12).reshape(-1, 2)[:, ::-1].ravel()
    both = cq.certify(right.problem, right.displacement[unknown], right.normal_force[contact])
    assert causes(both) == {"permuted", "permuted-unknowns"}
    assert "the same numbers" not in both.diagnosis


def test_one_explanation_of_a_kind() -> None:
    """Twice the load is found by the residual, by the factor and by solving again; it is said once."""
    problem = seeded_problem(3, 12, 8).replace(gap=np.zeros(8))
    other = cq.solve(problem.replace(load=2 * problem.load))
    said = cq.certify(problem, other.displacement, other.normal_force).diagnosis
    assert said.count("the load") == 1, said


def test_what_a_flipped_sign_hides_is_named_too(right: cq.Solution) -> None:
    soft = cq.solve(right.problem, "penalty", penalty=1e3)
    judged = cq.certify(right.problem, soft.displacement, -soft.normal_force)
    assert causes(judged) == {"sign", "penalty"}
    assert judged.diagnosis.startswith("all contact forces have the opposite sign (compression='negative'), and with ")
    assert "looks like a penalty of about 1e+03 N/mm" in judged.diagnosis
    reverse = cq.certify(right.problem, right.displacement, -right.normal_force[::-1])
    assert causes(reverse) == {"sign", "permuted"}


def test_what_a_unit_hides_is_named_too(right: cq.Solution) -> None:
    soft = cq.solve(right.problem, "penalty", penalty=1e3)
    forces = cq.certify(right.problem, soft.displacement, 1e-3 * soft.normal_force)
    assert causes(forces) == {"unit", "penalty"}
    assert "about 0.001 times the right ones (kN instead of N?)" in forces.diagnosis
    lengths = cq.certify(right.problem, 1e-3 * soft.displacement, -soft.normal_force)
    assert causes(lengths) == {"unit", "penalty"}
    assert "metres instead of millimetres?) and all contact forces have the opposite sign" in lengths.diagnosis


def test_a_sign_is_told_of_forces_that_are_right_to_a_digit(right: cq.Solution) -> None:
    rng = np.random.default_rng(0)
    noise = 1 + 0.03 * rng.normal(size=8)
    judged = cq.certify(right.problem, right.displacement, -right.normal_force * noise)
    assert causes(judged) == {"sign"}
    assert "with that undone it agrees with the right answer to 1 digit only" in judged.diagnosis
    noise = abs(1 + 1.0 * rng.normal(size=8))
    assert causes(cq.certify(right.problem, right.displacement, -right.normal_force * noise)) == set()


def test_gaps_in_another_unit(right: cq.Solution) -> None:
    given = right.problem
    other = cq.solve(given.replace(gap=1e-3 * given.gap))
    judged = cq.certify(given, other.displacement, other.normal_force)
    assert causes(judged) == {"gap-unit"}
    assert "the initial gaps 0.001 times as large" in judged.diagnosis


@pytest.mark.sampled(2)
@pytest.mark.parametrize("offset", [0.25, -0.25])
def test_an_offset_of_all_gaps_is_no_penalty(right: cq.Solution, offset: float) -> None:
    problem = right.problem
    other = cq.solve(problem.replace(gap=problem.gap + offset))
    judged = cq.certify(problem, other.displacement, other.normal_force)
    assert causes(judged) == {"gap-offset"}
    word = "larger" if offset > 0 else "smaller"
    assert f"every gap {word} by 0.25 mm" in judged.diagnosis
    shape = problem.gap + offset * np.linspace(0.5, 1.5, 8)
    other = cq.solve(problem.replace(gap=shape))
    assert "gap-offset" not in causes(cq.certify(problem, other.displacement, other.normal_force))


def test_one_penetrated_contact_may_have_another_gap() -> None:
    wall = cq.ContactProblem(stiffness=[[4.0]], load=[10.0], normal=[[1.0]], gap=[1.0])
    said = cq.certify(wall, [1.25], [5.0]).diagnosis
    assert "near 0.25: looks like a penalty of about 20, or like a gap that is larger by as much" in said
    assert causes(cq.certify(wall, [1.0 + 1e-8 / 3], [6.0 - 4e-8 / 3])) == {"inexact"}


def test_displacements_that_are_all_off_by_the_same(right: cq.Solution) -> None:
    moved = right.displacement.reshape(-1, 2) + np.array([3.0, -7.0])
    judged = cq.certify(right.problem, moved.ravel(), right.normal_force)
    assert causes(judged) == {"shifted"}
    assert "off by the same (3, -7) mm" in judged.diagnosis
    moved[0, 0] += 1
    assert "shifted" not in causes(cq.certify(right.problem, moved.ravel(), right.normal_force))


def test_normal_and_tangential_forces_that_are_swapped() -> None:
    known = known_answer(np.random.default_rng(0), 2, m=3)
    right = known.answer()
    normal, rubbing = right["normal_force"], right["friction_force"]
    swapped = right | {"normal_force": rubbing[:, 0], "friction_force": normal[:, None]}
    assert causes(cq.certify(known.problem, **swapped)) == {"components"}
    space = several(2)
    right = space.answer()
    table = np.column_stack([right["normal_force"], right["friction_force"]])
    last = right | {"normal_force": -table[:, 2], "friction_force": table[:, :2]}
    turned = right | {"normal_force": table[:, 1], "friction_force": table[:, [2, 0]]}
    assert "components" not in causes(cq.certify(space.problem, **last))
    assert causes(cq.certify(space.problem, **turned)) == {"components"}


def test_tangents_turned_by_an_angle() -> None:
    known = several(2)
    c, s = np.cos(np.radians(30)), np.sin(np.radians(30))
    right = known.answer()
    judged = cq.certify(known.problem, **right | {"friction_force": right["friction_force"] @ [[c, s], [-s, c]]})
    assert causes(judged) == {"tangent-turned"}
    assert "turned by 30 degrees" in judged.diagnosis
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, 6, size=len(right["friction_force"]))
    x, y = right["friction_force"].T
    each = np.column_stack([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y])
    assert causes(cq.certify(known.problem, **right | {"friction_force": each})) == set()


def test_no_question_is_solved_for_an_answer_that_balances_nothing(
    right: cq.Solution, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    solve = diagnosis.solve
    monkeypatch.setattr(
        diagnosis, "solve", lambda *given, **options: (asked.append("solved"), solve(*given, **options))[1]
    )
    noise = 1 + 0.1 * np.random.default_rng(0).normal(size=12)
    assert causes(cq.certify(right.problem, right.displacement * noise, right.normal_force)) == set()
    assert asked == []
    free = cq.solve(right.problem.with_contacts(np.zeros(0, dtype=int)))
    assert causes(cq.certify(right.problem, free.displacement, np.zeros(8))) == {"free"}
    assert asked


def test_numbers_whose_squares_are_no_doubles_are_refused_without_a_warning(right: cq.Solution) -> None:
    for factor in (1e200, 1e-200, 1e300):
        judged = cq.certify(right.problem, factor * right.displacement, factor * right.normal_force)
        assert not judged.passed
        assert judged.diagnosis
        assert judged.table()


def test_a_part_that_is_right_is_not_said_to_be_off(right: cq.Solution) -> None:
    force = right.normal_force * np.linspace(0.5, 1.5, 8)
    said = cq.certify(right.problem, right.displacement, force).diagnosis
    assert "the contact forces are off by up to" in said
    assert "displacement is off" not in said


def test_friction_of_the_right_size_along_another_direction_is_said_with_its_angle() -> None:
    known = several(2)
    right = known.answer()
    sliding = int(np.flatnonzero(cq.solve(known.problem).contact_status == "slip")[0])
    friction = right["friction_force"].copy()
    friction[sliding] = friction[sliding] @ [[0.0, 1.0], [-1.0, 0.0]]
    said = " ".join(one.text for one in cq.certify(known.problem, **right | {"friction_force": friction}).findings)
    assert "90 degrees off" in said
    assert "without friction of mu l_N against the slip" in said


def test_printing_says_where_the_words_are_and_solves_nothing(right: cq.Solution) -> None:
    judged = cq.certify(right.problem, right.displacement, -right.normal_force)
    assert str(judged).endswith("what went wrong, in words: .diagnosis; contact by contact: .table()")
    assert "diagnosis" not in str(cq.certify(right.problem, right.displacement, right.normal_force))
    assert pickle.loads(pickle.dumps(judged)).diagnosis == judged.diagnosis


def test_a_problem_without_displacements_is_sent_to_its_own_judge() -> None:
    local = cq.LocalProblem(delassus=np.eye(2), offset=[-1.0, 0.0], friction=[0.3], dimension=2)
    with pytest.raises(cq.InvalidProblem, match=r"LocalProblem.*cq\.certify_local"):
        cq.certify(local, [0.0], [1.0])  # type: ignore[arg-type]


@pytest.mark.parametrize("order", [3, "ab"])
def test_maps_that_are_no_sequences(right: cq.Solution, order: object) -> None:
    with pytest.raises(cq.InvalidProblem, match=r"dof_map: expected 12 integers or names, got"):
        cq.certify(right.problem, right.displacement, dof_map=order)


def test_one_wrong_force_of_few_is_no_pressure() -> None:
    blocks = problem("stacked-blocks").problem
    assert causes(cq.certify(blocks, normal_force=[56.0, 48.0, 30.0])) == set()


def test_rows_that_say_the_same_tell_no_offset_of_gaps() -> None:
    """They have one gap whatever their forces are."""
    stops = problem("redundant-stops").problem
    assert causes(cq.certify(stops, normal_force=[5.0, 6.0])) == set()


def test_forces_alone_are_not_explained_by_displacements_that_nobody_gave() -> None:
    with pytest.raises(AssertionError) as caught:
        assert_multipliers(problem("bar-and-wall"), [142.0])
    assert "load" not in str(caught.value)
    assert "stiff" not in str(caught.value)


def _printed(values: list[float], count: int) -> list[float]:
    return [float(f"{value:.{count - 1}e}") for value in values]


@pytest.mark.slow
def test_of_several_answers_a_printed_one_is_near_its_own() -> None:
    """Three contacts of a node share its friction: the shares of another equilibrium are no right ones to these."""
    load, push = 1.2345678, [2.4691356, 4.9382712, 2.4691356]
    problem = cq.ContactProblem(
        stiffness=[[8.0, 0.0], [0.0, 8.0]],
        load=[-5 * load, -8 * load],
        normal=[[0.0, -1.0], [0.0, -1.0], [0.0, -1.0]],
        gap=[0.0, 0.0, 0.0],
        tangent=[[1.0, 0.0], [1.0, 0.0], [1.0, 0.0]],
        friction=[0.5, 0.25, 0.125],
        slip_origin=[0.01, 0.01, 0.01],
    )
    drag = [-0.5 * push[0], -0.25 * push[1], -0.125 * push[2]]
    along = (-5 * load - sum(drag)) / 8
    assert cq.certify(problem, [along, 0.0], push, drag).passed
    judged = cq.certify(problem, _printed([along, 0.0], 6), _printed(push, 6), _printed(drag, 6))
    assert judged.findings[0].kind == "inexact"
    assert "same contacts open, sticking and slipping to about 6 digits" in judged.diagnosis
    wrong = cq.certify(problem, [along, 0.0], push, [drag[0], -drag[1], drag[2]])
    assert "digits" not in wrong.diagnosis


@pytest.mark.slow
def test_seven_digits_are_no_other_load() -> None:
    """A bar that nothing touches is stretched by its load alone: what rounds this is not another load."""
    load = 1.2345678
    problem = cq.ContactProblem(
        stiffness=[[8.0, -8.0, 0.0], [-8.0, 8.0, 0.0], [0.0, 0.0, 8.0]],
        load=[-load, load, 0.0],
        normal=[[1.0, 0.0, 0.0]],
        gap=[load],
        tangent=[[0.0, 0.0, 1.0]],
        friction=0.5,
    )
    left = -3.3333333
    judged = cq.certify(problem, _printed([left, left + load / 8, 0.0], 7), [0.0], [0.0])
    assert "7 digits" in judged.diagnosis or "6 digits" in judged.diagnosis
    assert "1 times" not in judged.diagnosis
    assert cq.certify(problem, [left, left + 1.001 * load / 8, 0.0], [0.0], [0.0]).findings[0].kind == "load"


def test_digits_are_no_cause_where_every_digit_is_right() -> None:
    """A contact that constrains nothing has a force: no displacement and no other force is wrong in any digit."""
    problem = cq.ContactProblem(
        stiffness=[[8.0, 0.0], [0.0, 8.0]],
        load=[2.0, -8.0],
        normal=[[0.0, -1.0], [0.0, 0.0]],
        gap=[0.0, 0.0],
        tangent=[[1.0, 0.0], [0.0, 1.0]],
        friction=0.5,
    )
    judged = cq.certify(problem, [0.0, 0.0], [8.0, 0.875], [2.0, 0.0])
    assert not judged.passed
    assert "digits" not in judged.diagnosis
    assert "constrains nothing" in judged.diagnosis or "0.875" in judged.diagnosis


@pytest.mark.sampled(2)
@pytest.mark.parametrize("digits", [12, 13])
def test_what_is_left_of_many_digits_is_no_offset_and_no_glue(digits: int) -> None:
    """A Winkler beam printed with more digits than are usual, at a tolerance beneath them: it has no other fault.

    The mean of the last digits, 1e-14 of the displacements, is no place from where these are counted.
    """
    bending = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4.0]])
    stiffness = np.zeros((9, 9))
    stiffness[:4, :4] += 100.0 * bending
    stiffness[2:6, 2:6] += 100.0 * bending
    stiffness[6:, 6:] = 10.0 * np.eye(3)
    rows = np.zeros((3, 9))
    rows[range(3), [0, 2, 4]], rows[range(3), [6, 7, 8]] = -1.0, 1.0
    beam = cq.ContactProblem(stiffness, [-7.0, 1.0, -3.0, 0.0, -5.0, -1.0, 0.0, 0.0, 0.0], rows, np.zeros(3))
    right = cq.solve(beam)
    u, force = _printed(right.displacement, digits), _printed(right.normal_force, digits)
    judged = cq.certify(beam, u, force, tolerance=10.0**-digits)
    assert not judged.passed
    assert f"about {digits} digits" in judged.diagnosis or f"about {digits - 1} digits" in judged.diagnosis
    assert not causes(judged) & {"shifted", "bilateral"}


def test_a_force_of_zero_is_no_printed_digit_of_one() -> None:
    """Beside a force of 1e6 one of 1 is six digits down, and an answer without it is not right to six digits."""
    springs = cq.ContactProblem(np.diag([1e6, 1.0]), [2e6, 2.0], np.eye(2), [1.0, 1.0])
    judged = cq.certify(springs, [1.0, 1.0], [1e6, 0.0])
    assert judged.diagnosis == "all values are right but one: the normal force of contact 1 is 0 instead of 1"
    three = cq.ContactProblem(np.diag([1e9, 1.0, 1.0]), [2e9, 2.0, 3.0], np.eye(3), [1.0, 1.0, 1.0])
    judged = cq.certify(three.replace(units=UNITS), [1.0, 1.0, 1.0], [1e9, 0.0, 0.0])
    assert "4 digits of the largest values, but contact 2 has 0 and should have 2 N: " in judged.diagnosis
    rounded = cq.certify(springs, [1.0, 1.0], [1e6 * (1 + 1e-5), 1.0])
    assert "should have" not in rounded.diagnosis


def sliding_row(twice: bool = False) -> tuple[cq.ContactProblem, dict[str, np.ndarray]]:
    """Ten weights of 10, 11, ..., 19 in a row, joined by springs of 2; the first is pulled by 4 and slides by 1/2.

    Nothing but the floor holds them, so that no bound covers their friction, 3 and 1 at the first two; with `twice` two
    contacts at each share the force, 0.3 and 0.7 of it.
    """
    n = 10
    stiffness, load = np.zeros((2 * n, 2 * n)), np.zeros(2 * n)
    spring = np.array([[2.0, -2.0], [-2.0, 2.0]])
    for i in range(n - 1):
        stiffness[2 * i : 2 * i + 3 : 2, 2 * i : 2 * i + 3 : 2] += spring
    load[1::2], load[0] = -10.0 - np.arange(n), 4.0
    displacement, friction = np.zeros(2 * n), np.zeros(n)
    displacement[0], friction[:2] = 0.5, (3.0, 1.0)
    copies, share = (2, np.tile([0.3, 0.7], n)) if twice else (1, np.ones(n))
    normal, tangent = (np.repeat(np.eye(2 * n)[k::2], copies, axis=0) for k in (1, 0))
    problem = cq.ContactProblem(stiffness, load, -normal, np.zeros(copies * n), tangent, friction=0.3)
    forces = {
        "normal_force": share * np.repeat(-load[1::2], copies),
        "friction_force": share * np.repeat(friction, copies),
    }
    return problem, {"displacement": displacement, **forces}


def test_causes_are_found_on_bodies_that_contacts_alone_hold_with_friction() -> None:
    problem, right = sliding_row()
    normal, friction = right["normal_force"], right["friction_force"]
    assert cq.certify(problem, **right).passed
    for changes, words in (
        ({"friction_force": -friction}, "all friction forces have the opposite sign: turned, this answer is right"),
        ({"friction_force": friction / 1e3}, "friction forces are 0.001 times the right values"),
        ({"normal_force": -normal}, "with compression='negative' this answer is right"),
        ({"normal_force": normal[::-1], "friction_force": friction[::-1]}, "the contacts stand in reverse order"),
    ):
        assert words in cq.certify(problem, **(right | changes)).diagnosis


def test_a_sign_is_found_where_contacts_share_their_forces_otherwise_than_the_right_answer() -> None:
    problem, right = sliding_row(twice=True)
    assert cq.certify(problem, **right).passed
    for part, words in (
        ("normal_force", "all contact forces have the opposite sign (compression='negative')"),
        ("friction_force", "all friction forces have the opposite sign"),
    ):
        judged = cq.certify(problem, **(right | {part: -right[part]}))
        assert judged.diagnosis.startswith(f"{words}: with that undone this answer is right")
