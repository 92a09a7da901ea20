"""Signs, areas and orders are arguments and never guessed; what is wrong is said contact by contact and in words."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

import contactqp as cq
from contactqp import testing
from contactqp.oracle.foreign import judging
from tests.examples import block_between, seeded_problem, truss, two_bars
from tests.solving.friction.space import several


@pytest.fixture
def block() -> tuple[cq.ContactProblem, cq.Solution]:
    problem = block_between(5, 3)
    names = [f"node {j // 2}.{'xy'[j % 2]}" for j in range(problem.dimension)]
    problem = problem.replace(dof_names=names, contact_names=list("abcde"), units={"length": "m", "force": "kN"})
    return problem, cq.solve(problem)


def test_the_sign_of_compression_is_an_argument(block: tuple[cq.ContactProblem, cq.Solution]) -> None:
    problem, right = block
    tensile = -right.normal_force
    assert cq.certify(problem, right.displacement, tensile, compression="negative").passed
    refused = cq.certify(problem, right.displacement, tensile)
    assert not refused.passed
    assert [finding.kind for finding in refused.findings if finding.cause] == ["sign"]
    said = "all contact forces have the opposite sign: with compression='negative' this answer is right"
    assert refused.diagnosis == said
    wrongly_told = cq.certify(problem, right.displacement, right.normal_force, compression="negative")
    assert "with compression='positive' this answer is right" in wrongly_told.diagnosis
    with pytest.raises(cq.InvalidProblem, match="compression: expected 'positive' or 'negative', got 'tension'"):
        cq.certify(problem, right.displacement, tensile, compression="tension")


def test_pressures_take_areas(block: tuple[cq.ContactProblem, cq.Solution]) -> None:
    problem, right = block
    area = np.array([0.1, 0.2, 0.2, 0.2, 0.1])
    pressure = right.normal_force / area
    judged = cq.certify(problem, right.displacement, -pressure, compression="negative", pressure_area=area)
    assert judged.passed
    assert judged.answer.normal_force == pytest.approx(right.normal_force, rel=1e-15)
    assert "pressure" in [finding.kind for finding in cq.certify(problem, right.displacement, pressure).findings]
    forces = cq.certify(problem, right.displacement, right.normal_force, pressure_area=area)
    assert "without pressure_area this answer is right" in forces.diagnosis
    with pytest.raises(cq.InvalidProblem, match=r"pressure_area: expected positive finite areas, got 0 at \[1\]"):
        cq.certify(problem, right.displacement, pressure, pressure_area=[1.0, 0.0, 1.0, 1.0, 1.0])
    with pytest.raises(cq.InvalidProblem, match="pressure_area: expected one area a contact"):
        cq.certify(problem, right.displacement, pressure, pressure_area=0.2)
    with pytest.raises(cq.InvalidProblem, match="pressure_area was given, but neither"):
        cq.certify(problem, right.displacement, pressure_area=area)


def test_tractions_take_areas_too() -> None:
    known = several(1)
    problem = known.problem
    area = np.linspace(0.5, 1.0, problem.contacts)
    answer = known.answer()
    answer["normal_force"] = known.normal_force / area
    answer["friction_force"] = known.friction_force / area[:, None]
    assert cq.certify(problem, **answer, pressure_area=area).passed


def test_maps_by_place_and_by_name(block: tuple[cq.ContactProblem, cq.Solution]) -> None:
    problem, right = block
    rng = np.random.default_rng(1)
    dofs, contacts = rng.permutation(problem.dimension), rng.permutation(problem.contacts)
    u, force = right.displacement[dofs], right.normal_force[contacts]
    places = {"dof_map": np.argsort(dofs), "contact_map": np.argsort(contacts)}
    names = {
        "dof_map": [problem.dof_names[j] for j in dofs],
        "contact_map": [problem.contact_names[i] for i in contacts],
    }
    for maps in (places, names):
        judged = cq.certify(problem, u, force, **maps)
        assert judged.passed
        assert np.array_equal(judged.answer.displacement, right.displacement)
    assert not cq.certify(problem, u, force).passed
    longer = cq.certify(problem, np.append(u, 7.0), force, **places)
    assert longer.passed
    assert any("1 of the 31 given values" in note for note in longer.notes)


def test_maps_of_frictional_contacts() -> None:
    known = several(2)
    order = np.random.default_rng(3).permutation(known.problem.contacts)
    answer = known.answer() | {
        "normal_force": known.normal_force[order],
        "friction_force": known.friction_force[order].ravel(),
    }
    assert cq.certify(known.problem, **answer, contact_map=np.argsort(order)).passed
    assert not cq.certify(known.problem, **answer).passed


REFUSED = {
    "twice": ({"dof_map": [0, 0]}, "dof_map: place 0 is given to unknown 0 and unknown 1"),
    "negative": ({"dof_map": [0, -1]}, "dof_map: expected places from 0 on, got -1 for unknown 1"),
    "short": ({"dof_map": [0]}, "dof_map: expected 2 integers"),
    "floats": ({"dof_map": [0.0, 1.0]}, "dof_map: expected 2 integers"),
    "beyond": ({"dof_map": [0, 2]}, "displacement: expected at least 3 values"),
    "no names": ({"dof_map": ["a", "b"]}, "dof_map: names were given, but the problem's unknowns have none"),
    "mixed": ({"dof_map": ["a", 1]}, "dof_map: expected 2 integers"),
    "contact names": ({"contact_map": ["a"]}, "contact_map: names were given, but the problem's contacts have none"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_wrong_maps_are_refused_in_one_line(what: str) -> None:
    maps, message = REFUSED[what]
    with pytest.raises(cq.InvalidProblem, match=message) as refusal:
        cq.certify(two_bars(), [1e-3, 0.0], [95.0], **maps)
    assert "\n" not in str(refusal.value)


def test_wrong_names_are_refused() -> None:
    with pytest.raises(cq.InvalidProblem, match=r"dof_map: expected every unknown of the problem, '1\.z' missing"):
        cq.certify(truss(), [1e-3, 0.0], [95.0], dof_map=["1.x", "1.y"])
    with pytest.raises(cq.InvalidProblem, match=r"dof_map: '1\.x' stands there twice"):
        cq.certify(truss(), [1e-3, 0.0], [95.0], dof_map=["1.x", "1.x"])
    with pytest.raises(cq.InvalidProblem, match="displacement: expected 2 values, one for each name"):
        cq.certify(truss(), [1e-3, 0.0, 0.0], [95.0], dof_map=["1.z", "1.x"])


def test_nothing_given_is_refused() -> None:
    with pytest.raises(cq.InvalidProblem, match="expected displacement, normal_force or both, got neither"):
        cq.certify(truss())
    with pytest.raises(cq.InvalidProblem, match="dof_map was given, but no displacement"):
        cq.certify(truss(), normal_force=[1.0], dof_map=[0, 1])
    with pytest.raises(cq.InvalidProblem, match="certify: expected a ContactProblem, got dict"):
        cq.certify({}, [0.0])


# --- contact by contact -----------------------------------------------------------------------------------------------


def test_wrong_contacts_come_worst_first_with_the_right_values(block: tuple[cq.ContactProblem, cq.Solution]) -> None:
    problem, right = block
    force = right.normal_force.copy()
    pushing = np.flatnonzero(force > 0)
    force[pushing[0]] *= 1.01
    force[pushing[1]] *= -1
    judged = cq.certify(problem, right.displacement, force)
    assert [one.index for one in judged.contacts] == [pushing[1], pushing[0]]
    worst = judged.contacts[0]
    assert worst.name == problem.contact_names[pushing[1]]
    assert worst.right_normal_force == right.normal_force[pushing[1]]
    assert worst.right_gap == pytest.approx(0.0, abs=1e-12)
    assert worst.size >= judged.contacts[1].size
    assert "kN" in judged.table()
    assert len(judged.table().splitlines()) == 3
    assert json.loads(json.dumps(worst.data()))["right_normal_force"] == right.normal_force[pushing[1]]
    assert f"{worst.name} is held in tension ({force[pushing[1]]:.4g} kN)" in judged.diagnosis
    assert f"right would be a force of {worst.right_normal_force:.6g} kN" in judged.diagnosis


def test_a_long_table_is_cut() -> None:
    problem = seeded_problem(0, 30, 25)
    judged = cq.certify(problem, np.zeros(30), np.ones(25))
    assert len(judged.table(limit=4).splitlines()) == 6
    assert judged.table(limit=4).splitlines()[-1].startswith("and ")


@pytest.mark.slow
def test_an_answer_to_a_problem_without_one_has_no_right_values() -> None:
    driven = cq.ContactProblem(stiffness=[[0.0]], load=[-1.0], normal=[[1.0]], gap=[1.0])
    judged = cq.certify(driven, [0.0], [0.0])
    assert judged.right is None
    assert judged.why_not is not None
    assert judged.why_not.startswith("NoEquilibrium")
    assert "no right answer can be set beside it" in judged.diagnosis
    assert judged.contacts == () or judged.contacts[0].right_normal_force is None


@pytest.mark.slow
def test_of_several_equilibria_the_nearest_is_set_beside() -> None:
    """Klarbring's (1990) contact, mu above the critical: open, stick and slip are all right."""
    data = dict(stiffness=[[5.0, -2.0], [-2.0, 1.0]], normal=[[-1.0, 0.0]], gap=[0.0], tangent=[[0.0, 1.0]])
    problem = cq.ContactProblem(**data, load=[-1.0, 0.65], friction=0.8)
    known = cq.equilibria(problem)
    assert len(known) == 3
    for one in known:
        near = np.add(one.displacement, [0.0, 1e-4])
        judged = cq.certify(problem, near, one.normal_force, one.friction_force)
        assert not judged.passed
        assert judged.right is not None
        assert judged.right.displacement == pytest.approx(one.displacement, abs=1e-12)
        assert "other answers exist" in judged.diagnosis


def test_nothing_is_solved_before_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    import contactqp.oracle.judged_answer as module

    def refuse(*_: object) -> None:
        raise AssertionError("solved")

    problem = truss()
    right = cq.solve(problem)
    monkeypatch.setattr(module, "right_answer", refuse)
    judged = cq.certify(problem, right.displacement, -right.normal_force)
    assert "REFUSED" in str(judged)
    assert cq.certify(problem, right.displacement, right.normal_force).diagnosis == "nothing is wrong with this answer"
    with pytest.raises(AssertionError, match="solved"):
        _ = judged.contacts


def test_the_tolerance_that_would_pass_is_named_and_does() -> None:
    problem = seeded_problem(1, 12, 6)
    right = cq.solve(problem)
    rounded = {
        "displacement": right.displacement.astype(np.float32),
        "normal_force": right.normal_force.astype(np.float32),
    }
    judged = cq.certify(problem, **rounded)
    assert "every number is one of single precision; tolerance=1e-07 passes it" in judged.diagnosis
    assert cq.certify(problem, **rounded, tolerance=1e-7).passed
    assert not cq.certify(problem, **rounded, tolerance=1e-8).passed


@pytest.mark.slow
def test_the_tolerance_is_named_where_forces_are_recovered_by_it() -> None:
    """Rows touch, or do not, by the tolerance, and at 1e-9 the recovered forces are far off."""
    rows = np.array([[-0.5, 0.2, -1.0, -0.2], [-1.0, 0, 0, 0], [1.0, 0, 0, 0], [0, 0, 0, -1.0], [0.9, 0.1, -0.7, -0.9]])
    problem = cq.ContactProblem(
        stiffness=np.array(
            [[0.6, 0.8, -0.3, -1.1], [0.8, 3.1, -0.9, -1.2], [-0.3, -0.9, 2.6, 2.7], [-1.1, -1.2, 2.7, 7.6]]
        ),
        load=[1.6, 0.9, -1.2, -3.1],
        normal=rows,
        gap=[-0.1, 0.25, 0.2, 0.25, 0.5],
    )
    right = cq.solve(problem)
    assert np.sum(right.normal_force > 0) >= 2
    off = right.displacement + 1e-7 * np.array([0.8, -0.3, 0.5, -0.1])
    judged = cq.certify(problem, displacement=off)
    named = re.search(r"tolerance=(1e-\d+) passes it", judged.diagnosis)
    assert named is not None, judged.diagnosis
    assert not judged.passed
    assert cq.certify(problem, displacement=off, tolerance=float(named[1])).passed


@pytest.mark.parametrize("friction", [None, 0.3])
def test_a_certificate_is_true_where_it_passed_and_false_where_it_refuses(friction: float | None) -> None:
    """So that ``assert cq.certify(...)`` in somebody's tests fails for a wrong answer."""
    tangent = {} if friction is None else {"tangent": [[1.0, 0.0]], "friction": friction}
    problem = cq.ContactProblem([[4.0, -1.0], [-1.0, 3.0]], [1.0, -2.0], [[0.0, -1.0]], [0.0], **tangent)
    solution = cq.solve(problem)
    assert solution.certificate
    judged = cq.certify(problem, solution)
    assert judged
    assert judged.passed
    np.testing.assert_array_equal(judged.answer.normal_force, solution.normal_force)
    wrong = cq.certify(problem, solution.displacement, 1.01 * solution.normal_force, solution.friction_force)
    assert not wrong
    assert not wrong.passed


def test_a_local_certificate_is_false_where_it_refuses() -> None:
    problem = cq.LocalProblem(delassus=np.eye(2), offset=[-1.0, 0.0], friction=0.3, dimension=2)
    assert cq.certify_local(problem, [1.0, 0.0])
    assert not cq.certify_local(problem, [1.1, 0.0])


def test_a_solution_with_other_forces_beside_it_is_refused() -> None:
    problem = cq.ContactProblem([[2.0]], [3.0], [[1.0]], [1.0])
    solution = cq.solve(problem)
    with pytest.raises(cq.InvalidProblem, match="a Solution brings its own forces"):
        cq.certify(problem, solution, normal_force=[1.0])


def test_one_wrong_force_among_a_few_right_values_is_named_with_its_right_value() -> None:
    problem = cq.ContactProblem(
        [[100.0, -20.0, 0.0], [-20.0, 80.0, -10.0], [0.0, -10.0, 60.0]],
        [10.0, 5.0, 8.0],
        [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        [0.02, 0.05],
    )
    solution = cq.solve(problem)
    judged = cq.certify(problem, solution.displacement, solution.normal_force * [1.01, 1.0])
    assert judged.diagnosis == (
        "all values are right but one: the normal force of contact 0 is 9.56975 instead of 9.475"
    )
    both = cq.certify(problem, solution.displacement, solution.normal_force * [1.01, 0.98])
    assert both.diagnosis.endswith("at contact 1, and 1 other contact is wrong too")


def test_gaps_that_are_rounding_stand_as_zero_beside_wrong_ones() -> None:
    rng = np.random.default_rng(3)
    shape = rng.standard_normal((12, 12))
    problem = cq.ContactProblem(shape @ shape.T + np.eye(12), 5 * rng.standard_normal(12), rng.standard_normal((6, 12)),
                                np.full(6, 0.01))  # fmt: skip
    right = cq.solve(problem)
    judged = cq.certify(problem, 1.001 * right.displacement, right.normal_force)
    closed = [one for one in judged.contacts if right.contact_status[one.index] == "closed"]
    assert any(right.gap[one.index] != 0 for one in closed)
    assert [one.right_gap for one in closed] == [0.0] * len(closed)


@pytest.mark.slow
@pytest.mark.parametrize("energies", [np.zeros((3, 3)), np.diag([0.0, 0.0, 2.0])])
def test_contacts_of_another_best_vertex_are_not_called_wrong(energies: np.ndarray) -> None:
    # x_0 + x_1 <= 1 closes: all answers between its two ends have the same energy. x_2 rests at 1.
    program = cq.ContactProblem.from_qp(energies, [-1.0, -1.0, 1.0], G=[[1.0, 1.0, 0.0]], h=[1.0], lb=[0.0, 0.0, 1.0])
    forces = cq.solve(program).normal_force
    for end in ([1.0, 0.0], [0.0, 1.0], [0.25, 0.75]):
        assert cq.certify(program, [*end, 1.0], forces).passed
        judged = cq.certify(program, [*end, 1.01], forces)
        assert [one.name for one in judged.contacts] == ["lower 2"]
        assert judged.contacts[0].right_gap == pytest.approx(0.0, abs=1e-15)
        assert judged.diagnosis.endswith("the right answer is not the only one: other displacements have the same "
                                         "energy, and other gaps")  # fmt: skip
        testing.assert_contact_solution(program, displacement=[*end, 1.0], normal_force=forces)
        with pytest.raises(AssertionError):
            testing.assert_contact_solution(program, displacement=[*end, 1.01], normal_force=forces)


def test_contacts_of_a_unique_answer_are_called_wrong_by_their_gap() -> None:
    program = cq.ContactProblem.from_qp(np.eye(2), [-1.0, -1.0], lb=[0.0, 1.5])
    judged = cq.certify(program, [2.0, 1.5], [0.0, 0.5])
    assert [(one.name, one.figure) for one in judged.contacts] == [("lower 0", "gap")]
    assert "not the only one" not in judged.diagnosis


@pytest.mark.parametrize("in_time", [True, False])
def test_a_right_answer_that_is_not_found_is_sought_once(in_time: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """What ended because the time was up is sought again."""
    sought: list[cq.ContactProblem] = []

    def gives_up(problem: cq.ContactProblem) -> cq.Solution:
        sought.append(problem)
        raise cq.NotConverged(f"gave up {len(sought)}")

    monkeypatch.setattr(judging, "solve", gives_up)
    monkeypatch.setattr(judging, "time_is_up", lambda: not in_time)
    problem = two_bars()
    reasons = [cq.certify(problem, [0.0, 0.0], [force]).why_not for force in (1.0, 2.0, 3.0)]
    times = range(1, 4) if not in_time else (1, 1, 1)
    assert reasons == [f"NotConverged: gave up {time}" for time in times]
    assert len(sought) == times[-1]
    assert sought[0] is problem
