"""The table of compare(): known answers, every verdict, nothing skipped and nothing aborted."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate.certificate import certificate_of
from contactqp.model.solution import Answer, Candidate
from contactqp.solving import methods as registry
from contactqp.solving.methods.method import Method, Settings
from contactqp.study import rows, truth
from contactqp.study.settings import STIFFENINGS, contact_stiffness
from tests.clocks import Clock
from tests.examples import body_on_spring_in_mid_air, two_bars
from tests.study.csv_rows import from_csv

OURS = ["active-set", "lagrange-multiplier", "augmented-lagrangian", "penalty"]
# Exact answer of the two bars at 300 kN: d1 = 41/31500 m, d2 = 19/63000 m, 95 kN.
EXACT = ([41 / 31500, 19 / 63000], [95.0])

Register = Callable[..., None]


@pytest.fixture
def register(monkeypatch: pytest.MonkeyPatch) -> Register:
    """Adds methods to the registry for one test."""

    def add(name: str, answer: Any, **changes: Any) -> None:
        method = Method(name=name, kind="test", solve=answer, **changes)
        monkeypatch.setitem(registry._REGISTRY, name, method)

    return add


def _believe_everything(monkeypatch: pytest.MonkeyPatch) -> None:
    """A certificate that passes whatever it is shown."""
    honest = certificate_of

    def blind(*args: Any, **options: Any) -> cq.Certificate:
        return dataclasses.replace(honest(*args, **options), passed=True, failures=())

    monkeypatch.setattr("contactqp.solving.runs.certificate_of", blind)


def _half_the_force(_: cq.ContactProblem, __: Settings) -> Candidate:
    return Candidate(Answer(np.array(EXACT[0]), np.array([47.5]), None, np.zeros(0)))


def test_exact_methods_are_right_against_the_exact_answer() -> None:
    table = cq.compare(two_bars(), methods=OURS[:3], reference=EXACT)
    assert [row.method for row in table] == OURS[:3]
    for row in table:
        assert row.verdict == rows.RIGHT
        assert row.error_displacement is not None
        assert row.error_displacement < 1e-14
        assert row.error_displacement_max is not None
        assert row.error_displacement_max < 1e-14
        assert row.error_force is not None
        assert row.error_force < 1e-13
        assert row.seconds is not None
        assert row.seconds > 0
        assert row.error_measure == "relative"


def test_penalty_is_approximate_by_the_known_error() -> None:
    beta = np.array(STIFFENINGS) * contact_stiffness(two_bars())
    table = cq.compare(two_bars(), methods=["penalty"], reference=EXACT)
    assert [row.knob_value for row in table] == pytest.approx(beta, rel=0.05)
    for row in table:
        assert row.knob_value is not None
        # λ = 95 β / (β + 105000), and β times the rounding of the gap
        assert row.error_force == pytest.approx(105000 / (row.knob_value + 105000), rel=1e-3)
        assert row.verdict == (rows.RIGHT if row.certificate_passed else rows.APPROXIMATE)
    assert table.rows[0].verdict == rows.APPROXIMATE


def test_every_method_is_listed_and_a_missing_one_says_how_to_install_it() -> None:
    table = cq.compare(two_bars(), knobs={"penalty": [1e8], "perturbed-lagrangian": [1e8]})
    assert [row.method for row in table] == [method.name for method in cq.methods()]
    for method, row in zip(cq.methods(), table, strict=True):
        if not method.installed:
            assert (row.verdict, row.message) == (rows.MISSING, method.install)
    assert rows.WRONG not in {row.verdict for row in table}


def test_a_missing_backend_is_a_row(register: Register) -> None:
    register("absent", _half_the_force, packages=("no_such_package",), install="pip install absent")
    (row,) = cq.compare(two_bars(), methods=["absent"])
    assert (row.verdict, row.message, row.seconds) == (rows.MISSING, "pip install absent", None)


def test_a_wrong_answer_is_refused(register: Register) -> None:
    register("liar", _half_the_force)
    (row,) = cq.compare(two_bars(), methods=["liar"])
    assert row.verdict == rows.REFUSED
    assert row.error_force == pytest.approx(0.5)
    assert row.claimed is True
    assert row.flag_wrong is True


def test_a_wrong_answer_that_passes_is_reported_as_wrong(register: Register, monkeypatch: pytest.MonkeyPatch) -> None:
    register("liar", _half_the_force)
    _believe_everything(monkeypatch)
    (row,) = cq.compare(two_bars(), methods=["liar"], reference=EXACT)
    assert row.verdict == rows.WRONG


@pytest.mark.parametrize(
    ("error", "verdict"),
    [
        (cq.BackendFailed("broke"), rows.BACKEND_FAILED),
        (cq.NotConverged("gave up"), rows.NOT_CONVERGED),
        (cq.Unsupported("cannot"), rows.UNSUPPORTED),
        (cq.NoEquilibrium("none"), rows.REFUSED),
    ],
)
def test_a_failing_method_does_not_abort_the_table(register: Register, error: cq.ContactQPError, verdict: str) -> None:
    def fail(_: cq.ContactProblem, __: Settings) -> Candidate:
        raise error

    register("failing", fail)
    failed, ours = cq.compare(two_bars(), methods=["failing", "active-set"])
    assert (failed.verdict, failed.message) == (verdict, str(error))
    assert ours.verdict == rows.RIGHT


def test_a_bug_is_no_row(register: Register) -> None:
    def broken(_: cq.ContactProblem, __: Settings) -> Candidate:
        raise ZeroDivisionError

    register("broken", broken)
    with pytest.raises(ZeroDivisionError):
        cq.compare(two_bars(), methods=["broken"])


def test_raw_answers_are_kept_and_backends_judged_by_them() -> None:
    (row,) = cq.compare(two_bars(), methods=["osqp"], knobs={"osqp": [1e-3]}, reference=EXACT)
    assert row.verdict == rows.RIGHT
    assert row.variant == "polished"
    assert row.raw_error_force is not None
    assert row.error_force is not None
    assert row.raw_error_force > 1e-6 > row.error_force
    assert row.claimed is True
    assert row.flag_wrong is False


def test_bodies_held_by_contact_alone() -> None:
    table = cq.compare(body_on_spring_in_mid_air(), methods=["active-set", "projected-gauss-seidel"])
    assert [row.verdict for row in table] == [rows.RIGHT, rows.UNSUPPORTED]


def test_a_zero_truth_leaves_absolute_errors() -> None:
    problem = two_bars(load=100.0)  # they do not touch
    (row,) = cq.compare(problem, methods=["osqp"], knobs={"osqp": [1e-3]})
    assert row.verdict == rows.RIGHT
    assert row.error_force == 0.0
    assert "λ absolute" in row.error_measure


def test_redundant_contacts_are_compared_by_their_resultants() -> None:
    twice = two_bars().replace(normal=[[1.0, -1.0], [2.0, -2.0]], gap=[1e-3, 2e-3])
    known = truth.truth_of(twice)
    assert known is not None
    assert not known.unique_forces
    other = known.errors(np.array(EXACT[0]), np.array([0.0, 47.5]), np.zeros(0))
    assert other.small
    assert "resultants" in other.measure
    assert not known.errors(np.array(EXACT[0]), np.array([95.0, 47.5]), np.zeros(0)).small


@pytest.mark.parametrize("factor", [1.001, -1.0, np.nan])
def test_errors_can_fail(factor: float) -> None:
    known = truth.truth_of(two_bars(), EXACT)
    assert known is not None
    u, force = np.array(EXACT[0]), np.array(EXACT[1])
    assert known.errors(u, force, np.zeros(0)).small
    assert not known.errors(u, factor * force, np.zeros(0)).small
    assert not known.errors(factor * u, force, np.zeros(0)).small


def test_errors_do_not_depend_on_units_or_on_the_scale_of_rows() -> None:
    u, force = 1.01 * np.array(EXACT[0]), 0.99 * np.array(EXACT[1])
    plain = truth.truth_of(two_bars(), EXACT)
    millimetres = cq.ContactProblem(
        stiffness=np.diag([157.5, 315.0]), load=[300.0, 0.0], normal=[[1e4, -1e4]], gap=[1e4]
    )
    scaled = truth.truth_of(millimetres, (1e3 * np.array(EXACT[0]), 1e-4 * np.array(EXACT[1])))
    assert plain is not None
    assert scaled is not None
    one, other = plain.errors(u, force, None), scaled.errors(1e3 * u, 1e-4 * force, None)
    assert (one.displacement, one.displacement_max, one.force) == pytest.approx(
        (other.displacement, other.displacement_max, other.force), rel=1e-9
    )
    assert one.displacement == pytest.approx(0.01)


def test_wrong_arguments_are_refused() -> None:
    with pytest.raises(cq.Unsupported, match="active-set"):
        cq.compare(two_bars(), methods=["active-sett"])
    with pytest.raises(cq.InvalidProblem, match="displacement"):
        cq.compare(two_bars(), reference=([1.0], [95.0]))
    with pytest.raises(cq.InvalidProblem, match="knob"):
        cq.compare(two_bars(), methods=["active-set"], knobs={"active-set": [1.0]})


def test_the_table_is_readable_and_goes_round_through_csv() -> None:
    table = cq.compare(two_bars(), methods=OURS)
    text = str(table)
    assert "active-set" in text
    assert "error in λ" in text
    assert max(map(len, text.splitlines())) <= 80
    assert "errors against: active-set, proven" in text
    assert from_csv(table.to_csv()) == table.rows
    assert [rows.Row(**row) for row in table.to_dicts()] == list(table.rows)
    with pytest.raises(dataclasses.FrozenInstanceError):
        table.rows[0].verdict = rows.RIGHT  # type: ignore[misc]


def test_it_says_first_who_is_fastest_and_who_is_not_right_and_goes_by_their_times() -> None:
    row = rows.Row(method="slow", verdict=rows.RIGHT, seconds=0.2, error_displacement=0.0, error_force=0.0)
    found = [
        row,
        dataclasses.replace(row, method="quick", seconds=1e-3),
        dataclasses.replace(row, method="liar", seconds=1e-4, verdict=rows.WRONG, message="the force is off"),
        dataclasses.replace(row, method="soft", seconds=0.1, verdict=rows.APPROXIMATE, knob="penalty", knob_value=1e4),
        rows.Row(method="absent", verdict=rows.MISSING, message="pip install absent"),
        rows.Row(method="unable", verdict=rows.UNSUPPORTED, message="it takes no friction " * 20),
    ]
    lines = rows.brief_comparison(found, "the truth").splitlines()
    assert lines[0] == "quick: the fastest of 2 right answers, 1 ms; wrong but passed: liar;"
    assert lines[1] == "  unsupported: unable; approximate: soft"
    assert [line.split()[0] for line in lines[3:7]] == ["liar", "quick", "soft", "slow"]
    assert lines[5].split()[:2] == ["soft", "1e+04"]
    assert "  liar: the force is off" in lines
    assert any(line.startswith("  not installed: absent") for line in lines)
    assert max(map(len, lines)) <= 80
    none = rows.brief_comparison(found[2:3], "the truth").splitlines()
    assert none[0] == "no method has a right answer; wrong but passed: liar"


def test_methods_with_options_in_them_are_told_how_options_are_given() -> None:
    for methods in ([("penalty", {"penalty": 1e4})], [{"penalty": 1e4}]):
        with pytest.raises(cq.InvalidProblem, match=r"options are keywords, penalty=1e4, .* knobs=") as told:
            cq.compare(two_bars(), methods)
        assert "\n" not in str(told.value)


def test_options_go_to_the_methods_that_take_them() -> None:
    table = cq.compare(two_bars(), ["active-set", "penalty", "augmented-lagrangian"], penalty=1e6, tolerance=1e-6)
    assert [(row.method, row.knob_value) for row in table] == [
        ("active-set", None),
        ("penalty", 1e6),
        ("augmented-lagrangian", 1e6),
    ]
    assert len(cq.compare(two_bars(), "penalty", penalty=1e6)) == 1
    with pytest.raises(
        cq.InvalidProblem, match=r"none of the methods takes an option 'penalti' .do you mean 'penalty'"
    ):
        cq.compare(two_bars(), ["active-set", "penalty"], penalti=1e6)
    with pytest.raises(cq.InvalidProblem, match="none of the methods takes an option 'penalty'"):
        cq.compare(two_bars(), "active-set", penalty=1e6)
    with pytest.raises(cq.InvalidProblem, match=r"methods: expected names, got .'penalty', {'penalty': 10000.0}."):
        cq.compare(two_bars(), [("penalty", {"penalty": 1e4})])


def test_a_time_limit_is_that_of_all_methods_together(register: Register, clock: Clock) -> None:
    """Each of five methods may have held a limit of its own, and the table taken five times as long."""

    def slowly(_: cq.ContactProblem, __: Settings) -> Candidate:
        clock.passes(60.0)
        return Candidate(Answer(np.array(EXACT[0]), np.array(EXACT[1]), None, np.zeros(0)), "solved", 1)

    for name in "abcde":
        register(name, slowly)
    table = cq.compare(two_bars(), [*"abcde", "active-set"], time_limit=100.0)
    assert [row.method for row in table if row.verdict == rows.RIGHT] == ["a", "b"]
    assert {row.message for row in table[2:]} == {"not tried: the time limit of 100 s was over"}
    assert {row.verdict for row in table[2:]} == {rows.NOT_CONVERGED}
    assert [row.method for row in table[2:]] == ["c", "d", "e", "active-set"]
    with pytest.raises(cq.InvalidProblem, match="time_limit"):
        cq.compare(two_bars(), ["active-set"], time_limit=0)
    assert all(row.verdict == rows.NOT_CONVERGED for row in cq.compare(two_bars(), OURS, time_limit=1e-9))


def test_a_solution_as_reference() -> None:
    reference = cq.solve(two_bars(), "lagrange-multiplier")
    table = cq.compare(two_bars(), methods=["active-set"], reference=reference)
    assert table.truth == "reference by lagrange-multiplier"
    assert table.rows[0].verdict == rows.RIGHT


def test_a_reference_that_the_proven_solution_contradicts_is_said_first() -> None:
    other = cq.solve(two_bars().replace(load=two_bars().load * 0.9))
    table = cq.compare(two_bars(), methods=["active-set"], reference=other)
    assert table.truth == "reference by active-set, which the proven solution contradicts: one of them is wrong"
    assert str(table).startswith("errors against: reference by active-set, which the proven solution contradicts")
    assert str(cq.compare(two_bars(), methods=["active-set"], reference=EXACT)).endswith("errors against: reference")


def test_where_friction_leaves_no_proven_answer_the_table_says_how_to_state_one() -> None:
    rough = two_bars().replace(tangent=[[0.0, 1.0]], friction=0.3)
    assert str(cq.compare(rough, methods=["active-set"])).endswith(
        "errors against: nothing, as no answer is proven to be the only one; reference=\n  states what to compare with"
    )
    assert cq.compare(rough, methods=["osqp"], reference=cq.solve(rough))[0].error_force < 1e-12


@pytest.mark.slow
def test_the_error_in_u_of_a_linear_program_is_that_of_the_largest_unknown() -> None:
    """K vanishes, and with it any energy norm. The exact vertex is (8/5, 6/5); a penalty moves both rows by l / 8."""
    program = cq.ContactProblem.from_qp(
        np.zeros((2, 2)), [-1.0, -1.0], G=[[1.0, 2.0], [3.0, 1.0]], h=[4.0, 6.0], lb=[0.0, 0.0]
    )
    table = cq.compare(program, methods=["penalty"], knobs={"penalty": [8.0]})
    # l = (2/5, 1/5): G x = (4.05, 6.025) at x = (1.6, 1.225), of which 0.025 / 1.6 is 1/64
    assert table[0].error_displacement_max == pytest.approx(1 / 64, rel=1e-9)
    assert str(table).splitlines()[2].split()[:3] == ["penalty", "8", "1.6e-02"]


def test_the_error_in_u_is_that_of_the_largest_unknown_where_the_energy_norm_is_blind_to_it() -> None:
    program = cq.ContactProblem.from_qp(
        np.diag([2.0, 0.0]), [-1.0, -1.0], G=[[1.0, 2.0], [3.0, 1.0]], h=[4.0, 6.0], lb=[0.0, 0.0]
    )
    table = cq.compare(program, methods=["penalty"], knobs={"penalty": [20.0]})
    (row,) = table
    assert row.error_displacement == pytest.approx(0.0, abs=1e-9)
    # x = (1/2 - l / 2, ...): l = (1/2, 0), x = (1/4, 15/8), moved along the second axis by l / 20 / 2 = 1/80
    assert row.error_displacement_max == pytest.approx((1 / 80) / (15 / 8), rel=1e-9)
    assert f"{row.error_displacement_max:.1e}" in str(table)
