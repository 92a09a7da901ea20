"""A diagnosis compares ratios: values whose squares are no doubles have the same causes as others."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.oracle.diagnosis import evidence
from contactqp.oracle.diagnosis.scales import _proportion
from contactqp.oracle.foreign.judging import certify_given
from contactqp.solving.friction.contact_form import ContactForm

K = np.array([[4.0, -1.0, 0.0], [-1.0, 3.0, -1.0], [0.0, -1.0, 2.0]])
CAUSES: dict[str, tuple[float, float]] = {
    "sign": (1.0, -1.0),
    "unit": (1.0, 1000.0),
    "unit of lengths": (1000.0, 1.0),
    "half": (1.0, 0.5),
    "everything": (2.0, 2.0),
    "nothing": (1.0, 0.0),
}


def scaled(length: float, force: float) -> cq.ContactProblem:
    """Three springs on two stops, in other units."""
    rows = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return cq.ContactProblem(K * (force / length), np.array([3.0, 1.0, 2.0]) * force, rows, np.full(2, 0.1) * length)


def findings(length: float, force: float, factors: tuple[float, float]) -> list[str]:
    problem = scaled(length, force)
    right = cq.solve(problem)
    judged = cq.certify(problem, factors[0] * right.displacement, factors[1] * right.normal_force)
    assert not judged.passed
    return [finding.kind for finding in judged.findings]


@pytest.mark.sampled(20)
@pytest.mark.parametrize("cause", CAUSES)
@pytest.mark.parametrize("powers", [(0, 560), (0, -560), (300, 300), (-300, 300), (-300, -300)])
def test_a_cause_is_named_in_any_units(cause: str, powers: tuple[int, int]) -> None:
    """Powers of two: not a digit of the problem changes."""
    length, force = (2.0**power for power in powers)
    expected = findings(1.0, 1.0, CAUSES[cause])
    assert expected
    assert findings(length, force, CAUSES[cause]) == expected


@pytest.mark.sampled(13)
@pytest.mark.parametrize("friction", [False, True])
@pytest.mark.parametrize("factors", [(1e300, -1.0), (1.0, 1e300), (1.7e308, 1.7e308), (5e-324, 1.0), (-1.0, 1.7e308)])
@pytest.mark.parametrize(("length", "force"), [(1.0, 1.0), (1e-8, 1e150), (1e-160, 1e-8), (1e120, 1e-120)])
def test_no_size_of_an_answer_ends_in_somebody_elses_error(
    length: float, force: float, factors: tuple[float, float], friction: bool
) -> None:
    rough: dict[str, Any] = dict(tangent=[[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], friction=0.3) if friction else {}
    problem = scaled(length, force)
    if friction:
        problem = cq.ContactProblem(problem.stiffness, problem.load, [[1.0, 0, 0], [0, 1.0, 0]], problem.gap, **rough)
    with np.errstate(over="ignore"):
        u = np.clip(np.array([0.1, 0.2, 0.1]) * length * factors[0], -1.7e308, 1.7e308)
        push = np.clip(np.array([2.0, 1.0]) * force * factors[1], -1.7e308, 1.7e308)
    judged = cq.certify(problem, u, push, 0.1 * push if friction else None)
    assert not judged.passed
    assert judged.diagnosis
    assert judged.table()


@pytest.mark.sampled(7)
@pytest.mark.parametrize("factors", [(1e300, -1.0), (1e300, 1.0), (-1e200, 1e100), (1e-300, 1e150), (1.0, 1e157)])
@pytest.mark.parametrize(("length", "force"), [(1.0, 1.0), (1e-8, 1e150), (1e-160, 1e-8), (1e-100, 1e100)])
def test_a_right_answer_times_any_number_is_explained(
    length: float, force: float, factors: tuple[float, float]
) -> None:
    """The factor was infinite where only its square is no double, and its power of ten no number."""
    problem = scaled(length, force)
    right = cq.solve(problem)
    judged = cq.certify(problem, factors[0] * right.displacement, factors[1] * right.normal_force)
    assert not judged.passed
    assert judged.findings
    assert judged.diagnosis


def test_what_is_proportional_is_told_from_what_is_not() -> None:
    one, other = np.array([1.0, -2.0, 3.0]), np.array([1.0, -2.0, 3.1])
    for size in (1e-300, 1.0, 1e300):
        factor = _proportion(1e3 * size * one, size * one)
        assert factor == pytest.approx(1e3, rel=1e-12)
        assert _proportion(size * other, size * one) is None
        assert _proportion(0 * one, size * one) == 0.0
        assert _proportion(size * one, 0 * one) == 1.0
    assert _proportion(1e300 * one, 1e-300 * one) is None  # that factor is no double
    assert _proportion(np.array([1.0, 0.0]), np.array([0.0, 1.0])) is None


@pytest.mark.slow
def test_certificates_of_a_diagnosis_are_counted_where_no_right_answer_is_known(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each may look for bounds in vain, for a tenth of a second even of a few unknowns."""
    asked: list[object] = []

    def counted(*given: object) -> object:
        asked.append(given)
        return certify_given(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(evidence, "certify_given", counted)
    judged = cq.certify(cq.ContactProblem([[0.0]], [-1.0], [[1.0]], [0.0]), [0.0], [5.0])
    assert judged.right is None
    hurried = judged.findings_within(1.0)
    assert len(asked) == 1
    assert any("not examined after 1 operations" in one.text and "signs and units" in one.text for one in hurried)
    judged.findings_within(1e9)
    assert len(asked) >= 6


@pytest.mark.sampled(8)
@pytest.mark.parametrize("power", [-250, -170, 170, 250])
@pytest.mark.parametrize("candidate", [(1.01, 0.99), (0.9, 1.1)])
def test_penetrations_and_forces_whose_ratio_is_beyond_doubles_are_told_all_the_same(
    power: int, candidate: tuple[float, float]
) -> None:
    """Two walls in units of their own: a penalty of 99, and contacts that push across their gaps."""
    unit, (u, force) = 10.0**power, candidate
    problem = cq.ContactProblem(np.eye(2), [2.0, 2.0], unit * np.eye(2), [unit, unit])
    judged = cq.certify(problem, [u, u], [force / unit, force / unit])
    assert not judged.passed
    assert judged.findings
    assert judged.diagnosis


@pytest.mark.slow
def test_free_motions_beside_rows_whose_sizes_leave_the_range_of_doubles(capfd: pytest.CaptureFixture[str]) -> None:
    problem = cq.ContactProblem(
        [[0, 0, 0, 0, 0], [0, 0, 0, 0, 0], [0, 0, 0, 0, 0], [0, 0, 0, 14, -14], [0, 0, 0, -14, 14]],
        [0.0, -1.0, -0.6875, -22.5, 23.1875],
        [[-1e229, 0, 1e229, 0, 0], [0, 4e-264, -4e-264, 0, 0], [0, 0, -1e-141, 0, 1e-141]],
        [7e228, 2e-264, 5e-142], tie=[[0.0, 1.0, 0.0, 0.0, 0.0]], tie_value=[0.0],
    )  # fmt: skip
    right = cq.solve(problem)
    assert right.free_motions
    judged = cq.certify(problem, 1.1 * right.displacement, right.normal_force, None, right.tie_force)
    assert not judged.passed
    assert judged.findings
    assert capfd.readouterr().out == ""


@pytest.mark.slow
def test_questions_with_friction_that_have_no_answer_try_few_combinations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two rough pairs between which a soft chain hangs: other gaps have no equilibrium, which took seconds to find."""
    soft, softer, link = 2.2595258997171186e-12, 1.2789769243681803e-11, 0.01330566406250
    K = np.zeros((7, 7))
    K[:2, :2] = [[soft, -soft], [-soft, 8.6544105215580203e-12]]
    K[1, 2] = K[2, 1] = -softer
    K[2:5, 2:5] = [
        [2.6354070401662932e-11, -link, 0.0],
        [-link, 4.79199232e9, -9.126805504e9],
        [0, -9.126805504e9, 1.8253611008e10],
    ]
    normal, tangent = np.zeros((4, 7)), np.zeros((4, 7))
    normal[0, [2, 4]], normal[1, [4, 6]], normal[2, [3, 4]], normal[3, [4, 6]] = (
        [-2.0**-12, 2.0**23], [-128.0, 512.0], [-(2.0**14), 2.0**15], [-(2.0**17), 2.0**19],
    )  # fmt: skip
    tangent[[0, 1, 2, 3], [5, 3, 5, 3]] = -8.0, 64.0, -(2.0**-5), 2.0**16
    load = [
        -3.7265625,
        -24.3984375,
        57.31450712680817,
        4.197994962560000e11,
        -8.761733222400000e11,
        0.205078125,
        172032.0,
    ]
    gap = [-7.38197504e08, 2048.0, 524288.0, 2097152.0]
    friction, origin = [5.0, 0.25, 5.0, 0.25], [[268435456.0], [4096.0], [0.0], [0.0]]
    problem = cq.ContactProblem(K, load, normal, gap, tangent=tangent, friction=friction, slip_origin=origin)
    tried = 0
    answer_in = ContactForm.answer_in

    def counted(*arguments: Any) -> Any:
        nonlocal tried
        tried += 1
        return answer_in(*arguments)

    monkeypatch.setattr(ContactForm, "answer_in", counted)
    u = [
        -3.2900668703882734e12,
        -1.6407994287242734e12,
        1.3786235411898633e12,
        0.24645222512457429,
        -47.876774193548385,
    ]
    u += [-33554432.0, -7.9691935483870964]
    forces = [6.5254718271334795e-03, 336.0, 0.0, 0.0], [[-2.5634765625e-02], [-84.84], [0.0], [0.0]]
    certificate = cq.certify(problem, u, *forces)
    assert not certificate.passed
    assert isinstance(certificate.findings, tuple)
    assert 0 < tried <= 4 * 50  # it was 1024
