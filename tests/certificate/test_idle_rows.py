"""Contacts that never close and rows of zeros constrain nothing, whoever solves, and a force on them is refused."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

import contactqp as cq

K = 157500.0 * np.eye(2)
LOAD = np.array([300.0, 200.0])
NORMAL = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 0.0]]
GAP = [0.0, 1e-3, np.inf, 5e-4]
TIES = dict(tie=[[0.0, 0.0], [0.0, 1.0]], tie_value=[0.0, 1e-3])
PROBLEM = cq.ContactProblem(K, LOAD, NORMAL, GAP, **TIES)
EXACT = [method.name for method in cq.methods() if method.installed and method.exact]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", EXACT)
def test_every_method_leaves_them_out(method: str) -> None:
    solution = cq.solve(PROBLEM, method)
    assert solution.certificate.passed
    assert solution.normal_force == pytest.approx([0.0, 0.0, 0.0, 300 - 157500 * 5e-4])
    assert solution.tie_force == pytest.approx([0.0, 200 - 157.5])
    assert solution.contact_status.tolist() == ["open", "open", "open", "closed"]
    assert solution.gap.tolist()[2] == np.inf
    assert solution.certificate.force_bound.shape == (4,)


def test_the_answer_is_that_without_them() -> None:
    few = cq.ContactProblem(K, LOAD, [NORMAL[1], NORMAL[3]], [GAP[1], GAP[3]], tie=[TIES["tie"][1]], tie_value=[1e-3])
    solution, alone = cq.solve(PROBLEM), cq.solve(few)
    assert solution.displacement.tolist() == alone.displacement.tolist()
    assert solution.certificate.proven
    assert solution.certificate.energy_error == pytest.approx(alone.certificate.energy_error, rel=1e-3)


def test_nothing_but_idle_rows_is_a_linear_system() -> None:
    solution = cq.solve(cq.ContactProblem(K, LOAD, [[0.0, 0.0], [1.0, 0.0]], [np.inf, np.inf]))
    assert solution.displacement == pytest.approx(LOAD / 157500.0, rel=1e-15)


@pytest.mark.parametrize(("contact", "words"), [(0, "contact 0 constrains"), (2, "contact 2 constrains")])
@pytest.mark.parametrize("force", [1e-3, -1e-3])
def test_a_force_on_them_is_refused(contact: int, words: str, force: float) -> None:
    solution = cq.solve(PROBLEM)
    forged = solution.normal_force.copy()
    forged[contact] = force
    certificate = cq.certify(PROBLEM, solution.displacement, forged, tie_force=solution.tie_force)
    assert not certificate.passed
    assert any(words in failure for failure in certificate.failures)


def test_a_force_on_a_tie_of_zeros_is_refused() -> None:
    solution = cq.solve(PROBLEM)
    certificate = cq.certify(PROBLEM, solution.displacement, solution.normal_force, tie_force=[1.0, 42.5])
    assert any("tie 0" in failure for failure in certificate.failures)


@pytest.mark.parametrize(
    ("change", "words"),
    [(dict(gap=[-1e-300, 1.0, np.inf, 1.0]), "contact 0"), (dict(tie_value=[1e-9, 1e-3]), "tie 0")],
)
def test_a_row_of_zeros_that_is_not_met_proves_that_there_is_none(change: dict, words: str) -> None:
    problem = PROBLEM.replace(**change)
    for method in ("active-set", "lemke", "clarabel"):
        with pytest.raises(cq.NoEquilibrium, match=words) as caught:
            cq.solve(problem, method)
    proof = caught.value.proof
    sides = [*zip(proof.normal, problem.gap, strict=True), *zip(proof.tie, problem.tie_value, strict=True)]
    assert sum(Fraction(float(y)) * Fraction(float(g)) for y, g in sides if y) < 0
    answer = cq.solve(PROBLEM)
    assert not cq.certify(problem, answer.displacement, answer.normal_force, tie_force=answer.tie_force).passed


@pytest.mark.sampled(4)
@pytest.mark.parametrize("algorithm", [None, "tresca", "newton", "nsgs", "enumeration", "aclm"])
def test_with_friction_they_neither_push_nor_rub(algorithm: str | None) -> None:
    rubbing = dict(tangent=[[0.0, 1.0], [0.0, 1.0], [1.0, 0.0]], friction=0.3)
    problem = cq.ContactProblem(K, LOAD, NORMAL[:3], GAP[:3], **rubbing)
    solution = cq.solve(problem, algorithm=algorithm)
    assert solution.certificate.passed
    assert solution.normal_force == pytest.approx([0.0, 142.5, 0.0])
    assert solution.friction_force.ravel() == pytest.approx([0.0, 42.75, 0.0])
    forged = solution.friction_force.copy()
    forged[2] = 1e-3
    assert not cq.certify(problem, solution.displacement, solution.normal_force, forged).passed
    assert [one.normal_force.shape for one in cq.equilibria(problem)] == [(3,)]


def test_a_tie_keeps_its_number_in_messages() -> None:
    problem = cq.ContactProblem(
        K, LOAD, [[1.0, 0.0]], [1.0], tie=[[0.0, 0.0], [1.0, 0.0], [1.0, 0.0]], tie_value=[0.0, 0.0, 1.0]
    )
    with pytest.raises(cq.NoEquilibrium, match="tie 1, tie 2"):
        cq.solve(problem)


def test_a_solution_with_them_is_a_place_to_start_from() -> None:
    first = cq.solve(PROBLEM)
    again = cq.solve(PROBLEM.replace(load=LOAD * 1.01), warm_start=first)
    assert again.certificate.passed


@pytest.mark.parametrize("enclose", [None, True, False])
def test_rational_numbers_leave_out_what_never_closes(enclose: bool | None) -> None:
    """The exact answer has the shape of the problem, an infinite gap where it has one, and no force there."""
    problem = PROBLEM.with_contacts([1, 2, 3]).with_ties([1]) if enclose else PROBLEM
    never, solution = problem.gap == np.inf, cq.solve(problem)
    answer = cq.exact(problem, enclose=enclose)
    assert answer.problem is problem
    assert answer.rational is (not enclose)
    assert [str(answer.gap[i]) for i in np.flatnonzero(never)] == ["inf"]
    assert answer.doubles.gap == pytest.approx(solution.gap, abs=1e-15)
    assert answer.doubles.normal_force == pytest.approx(solution.normal_force, abs=1e-15)
    assert answer.doubles.displacement == pytest.approx(solution.displacement, abs=1e-15)
    assert tuple(np.array(answer.contact_status)[never]) == ("open",)
    assert all(not entry for entry in answer.normal_force[never])


def test_equilibria_in_rational_numbers_leave_out_what_never_closes() -> None:
    """A pad of 10 on a spring of one slides by two; seven contacts beside it never close, and count for nothing."""
    rows, along = np.zeros((8, 2)), np.zeros((8, 2))
    rows[:, 1], along[:, 0] = -1.0, 1.0
    gap = np.array([np.inf] * 3 + [0.0] + [np.inf] * 4)
    pad = cq.ContactProblem([[1.0, 0], [0, 0]], [5.0, -10], rows, gap, tangent=along, friction=0.25)
    [state] = cq.exact_equilibria(pad)
    assert state.displacement.tolist() == [Fraction(5, 2), 0]
    assert state.normal_force.tolist() == [0, 0, 0, 10, 0, 0, 0, 0]
    assert state.friction_force[:, 0].tolist() == [0, 0, 0, Fraction(5, 2), 0, 0, 0, 0]
    assert state.contact_status == ("open",) * 3 + ("slip",) + ("open",) * 4
    assert state.gap.tolist() == [np.inf] * 3 + [0] + [np.inf] * 4
    assert state.slip[:, 0].tolist() == [Fraction(5, 2)] * 8
    assert cq.exact(pad).normal_force.tolist() == state.normal_force.tolist()


@pytest.mark.parametrize("friction", [False, True])
@pytest.mark.parametrize("enclose", [None, True])
def test_rows_of_zeros_that_touch_have_no_force_in_rational_numbers(friction: bool, enclose: bool | None) -> None:
    """A contact without a normal that touches presses on nothing, and so its friction holds nothing."""
    sliding = dict(tangent=[[0.0], [-1.0], [1.0]], friction=[0.0, 0.5, 0.5], slip_origin=[-0.5, 0.0, 0.5])
    zeros = cq.ContactProblem(
        [[4.0]], [-10.0], [[0.0], [-1.0], [0.0]], [1.0, 2.0, 0.0], **(sliding if friction else {})
    )
    pressed = Fraction(4, 3) if friction else Fraction(2)
    answer = cq.exact(zeros, enclose=None if friction else enclose)
    assert answer.doubles.normal_force == pytest.approx([0.0, float(pressed), 0.0])
    assert answer.normal_force[[0, 2]].tolist() == [0, 0]
    assert answer.unique_forces
    assert answer.contact_status == ("open", "slip" if friction else "closed", "open")
    assert answer.contact_status == tuple(cq.solve(zeros).contact_status)
    assert answer.gap[2] == 0
    if friction:
        [state] = cq.exact_equilibria(zeros)
        assert state.normal_force.tolist() == [0, pressed, 0]
        assert state.contact_status == answer.contact_status
    with pytest.raises(cq.NoEquilibrium):
        cq.exact(zeros.replace(gap=[1.0, 2.0, -1.0]))


def test_the_margin_and_the_local_form_leave_out_what_never_closes() -> None:
    rows = dict(normal=[[-1.0, 0.0], [1.0, 0.0]], gap=[0.5, np.inf], tangent=[[0.0, 1.0]] * 2, friction=0.3)
    both = cq.ContactProblem(stiffness=[[2.0, 0.0], [0.0, 4.0]], load=[-3.0, 1.0], **rows)
    one = both.with_contacts([0])
    local = cq.local_form_of(both)
    assert local.offset.tolist() == cq.local_form_of(one).offset.tolist()
    assert local.contact_names == ("contact 0",)
    assert cq.existence_margin(both) == cq.existence_margin(one)
    assert cq.existence_margin(both.with_contacts([1])) == 1.0


def test_what_has_no_number_for_infinity_says_so() -> None:
    with pytest.raises(cq.Unsupported, match="contact 2 never closes"):
        cq.exact(PROBLEM).derivative("gap", "load", PROBLEM.load)
    with pytest.raises(cq.InvalidProblem, match="gap"):
        PROBLEM.replace(gap=[0.0, -np.inf, 1.0, 1.0])


@pytest.mark.parametrize("width", [1, 2])
def test_where_every_contact_is_idle_friction_has_nothing_to_act_on(width: int) -> None:
    rows, nothing = np.zeros((2, 3)), np.zeros((2 * width, 3))
    problem = cq.ContactProblem(np.eye(3), [1.0, 0.0, 2.0], rows, [0.0, 1.0], tangent=nothing, friction=0.3)
    solution = cq.solve(problem)
    assert solution.certificate.passed
    assert solution.displacement.tolist() == [1.0, 0.0, 2.0]
    assert not np.any(solution.friction_force)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("tangent", [[[0.0, 1.0], [0.0, 0.0]], [[0.0, 0.6], [0.0, 0.8]]], ids=["zero", "parallel"])
def test_friction_along_what_no_unknown_feels_counts_in_the_cone(tangent: list[list[float]]) -> None:
    """In space a node that is held in one tangential direction, along an axis or between the two that are stated."""
    problem = cq.ContactProblem(np.diag([10.0, 10.0]), [5.0, 1.0], [[1.0, 0.0]], [0.0], tangent=tangent, friction=[0.3])
    solution = cq.solve(problem)
    along = np.array(tangent)[:, 1]
    across = np.array([-along[1], along[0]])
    assert solution.friction_force[0] @ along == pytest.approx(1.0, abs=1e-12)
    for unfelt, passes in ((1.1, True), (1.2, False), (100.0, False), (1e6, False)):  # 1.118 is left by 0.3 * 5 and 1
        judged = cq.certify(problem, [0.0, 0.0], [5.0], [along + unfelt * across])
        assert judged.passed is passes, (unfelt, judged)
    beyond = cq.certify(problem, [0.0, 0.0], [5.0], [along + 100.0 * across])
    assert beyond.cone > 1.0  # though the excess along what is felt is half of the load there
