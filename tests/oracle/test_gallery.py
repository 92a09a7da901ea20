"""The gallery: its answers satisfy every condition exactly, its problems never change, and solvers find the answers."""

from __future__ import annotations

import dataclasses
import hashlib
import subprocess
import sys
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.linalg.exact_algebra import rank
from contactqp.oracle.gallery.gallery import DIFFICULTIES, KINDS, NAMED, RANDOM, problem, problems
from contactqp.oracle.gallery.problem import GalleryProblem, rows_of
from tests.oracle.exact_conditions import broken_conditions, doubles, is_semidefinite

EVERY = problems("named") + [known for kind in RANDOM for known in problems(kind, count=6)]


@pytest.mark.sampled(9)
@pytest.mark.parametrize("known", EVERY)
def test_the_answer_satisfies_every_condition_exactly(known: GalleryProblem) -> None:
    assert broken_conditions(known.data, known.exact) == []
    assert is_semidefinite(known.data.stiffness)


@pytest.mark.sampled(8)
@pytest.mark.parametrize("kind", RANDOM)
def test_the_conditions_hold_whatever_the_seed(kind: str) -> None:
    count = 3 if kind == "large" else 30
    broken = {
        known.name: broken_conditions(known.data, known.exact) for known in problems(kind, count=count, seed=1000)
    }
    assert {name: names for name, names in broken.items() if names} == {}


@pytest.mark.sampled(9)
@pytest.mark.parametrize("known", EVERY)
def test_the_data_are_doubles_or_what_rounding_them_changes_is_said(known: GalleryProblem) -> None:
    assert known.data.rounded() == (() if known.rounding == 0 else ("friction",))
    assert known.rounding < Fraction(1, 2**53)
    if known.kind != "named":
        assert doubles(known.exact.displacement + known.exact.normal_force + known.exact.tie_force + known.exact.gap)
        assert doubles(x for row in known.exact.friction_force for x in row)


@pytest.mark.sampled(26)
@pytest.mark.parametrize("known", EVERY)
def test_the_certificate_passes_the_answer_and_the_solver_finds_it(known: GalleryProblem) -> None:
    problem, right = known.problem, (known.displacement, known.normal_force, known.friction_force, known.tie_force)
    assert cq.certify(problem, *right).passed
    solution = cq.solve(problem)
    if known.unique_displacement:
        np.testing.assert_allclose(solution.displacement, right[0], rtol=0, atol=1e-9 * _largest(right[0], problem.gap))
    if known.unique_forces:
        size = _largest(right[1], problem.load)
        np.testing.assert_allclose(solution.normal_force, right[1], rtol=0, atol=1e-9 * size)
        np.testing.assert_allclose(solution.tie_force, right[3], rtol=0, atol=1e-9 * size)
    elif not problem.frictional:
        pushed = known.problem.normal.T @ right[1] + known.problem.tie.T @ right[3]
        found = known.problem.normal.T @ solution.normal_force + known.problem.tie.T @ solution.tie_force
        np.testing.assert_allclose(found, pushed, rtol=0, atol=1e-9 * _largest(pushed))


@pytest.mark.sampled(5)
@pytest.mark.parametrize("known", EVERY)
def test_a_changed_answer_breaks_a_condition(known: GalleryProblem) -> None:
    answer = known.exact
    moved = (answer.displacement[0] + Fraction(1, 10**9), *answer.displacement[1:])
    broken = broken_conditions(known.data, dataclasses.replace(answer, displacement=moved))
    assert broken or not known.unique_displacement
    if any(answer.normal_force):
        i = max(range(len(answer.normal_force)), key=lambda i: answer.normal_force[i])
        force = list(answer.normal_force)
        force[i] = -force[i]
        assert {"equilibrium", "tension"} <= set(
            broken_conditions(known.data, dataclasses.replace(answer, normal_force=tuple(force)))
        )


@pytest.mark.sampled(2)
@pytest.mark.parametrize("known", problems("frictional", count=9))
def test_friction_along_the_slip_breaks_a_condition(known: GalleryProblem) -> None:
    answer = known.exact
    turned = tuple(tuple(-x for x in row) for row in answer.friction_force)
    broken = broken_conditions(known.data, dataclasses.replace(answer, friction_force=turned))
    assert "equilibrium" in broken
    assert ("slip direction" in broken) == ("slip" in answer.contact_status)


@pytest.mark.slow
def test_every_kind_is_what_its_name_says() -> None:
    every = problems(count=9)
    assert {known.kind for known in every} >= {"degenerate", "redundant", "floating", "tied", "stiff", "large"}
    for known in every:
        answer, data = known.exact, known.data
        if known.kind == "degenerate":
            assert "grazing" in answer.contact_status
            assert known.unique_forces
        elif known.kind == "redundant":
            closed = [row for row, gap in zip(data.normal, answer.gap, strict=True) if gap == 0]
            assert rank(tuple(closed)) < len(closed)
            assert known.unique_displacement
            assert not known.unique_forces
        elif known.kind == "floating":
            assert rank(data.stiffness) == data.unknowns - 6
            assert known.unique_displacement
        elif known.kind == "tied":
            assert data.tie
            assert any(answer.tie_force)
        elif known.kind == "stiff":
            diagonal = [row[i] for i, row in enumerate(data.stiffness)]
            assert known.difficulty == "easy" or max(diagonal) > 2**30
        elif known.kind == "large":
            assert data.contacts >= 144
        if known.kind not in ("named", "redundant"):
            assert known.unique_displacement
            assert known.unique_forces


def test_the_check_of_definiteness_can_fail() -> None:
    assert is_semidefinite(rows_of([[1, 2, 0], [2, 4, 0], [0, 0, 3]]))
    assert not is_semidefinite(rows_of([[1, 2], [2, 3]]))
    assert not is_semidefinite(rows_of([[0, 1], [1, 4]]))
    assert not is_semidefinite(rows_of([[2, 3], [1, 2]]))


def test_some_problem_has_more_closed_rows_than_unknowns() -> None:
    more = [known for known in problems("redundant", "easy", count=3) if known.exact.gap.count(0) > known.data.unknowns]
    assert more


@pytest.mark.slow
def test_frictional_problems_come_in_the_plane_and_in_space_and_in_every_state() -> None:
    found = problems("frictional", count=12)
    assert {known.data.directions for known in found} == {1, 2}
    assert {state for known in found for state in known.exact.contact_status} == {"stick", "slip", "open"}
    for known in found:
        assert not cq.certify(known.problem, known.displacement, known.normal_force, known.friction_force).uniqueness


def test_what_is_not_unique_is_not_called_so() -> None:
    assert not problem("klarbring-sticks").unique_displacement
    assert problem("klarbring-below-critical").unique_forces
    assert not problem("redundant-stops").unique_forces
    assert not problem("floating-disc").unique_displacement
    assert problem("floating-disc").unique_forces
    sticks, slides, opens = (problem(f"klarbring-{state}") for state in ("sticks", "slides", "opens"))
    assert sticks.data == slides.data == opens.data
    assert len({known.exact.contact_status for known in (sticks, slides, opens)}) == 3


def test_forces_that_only_signs_make_unique_are_found_to_be() -> None:
    """Two opposite stops of one slide, both touching: no compression of both adds nothing... but one alone does."""
    from contactqp.oracle.gallery.problem import ExactProblem, exact_answer, only_forces

    def answered(normal: list[list[int]]) -> bool:
        n = len(normal[0])
        stiffness = rows_of([[int(i == j) for j in range(n)] for i in range(n)])
        zero = (Fraction(0),)
        data = ExactProblem(stiffness, zero * n, rows_of(normal), zero * len(normal))
        return only_forces(data, exact_answer(data, zero * n, zero * len(normal)), True)

    assert answered([[1], [2]])  # grazing, parallel: any force would push
    assert not answered([[1], [-1]])  # grazing, opposite: equal forces cancel


def test_named_answers_are_those_of_their_sources() -> None:
    force = {name: problem(name).exact.normal_force for name in NAMED}
    assert force["bar-and-wall"] == (Fraction("142.5"),)
    assert force["two-bars"] == (95,)
    assert force["truss-over-floor"] == (Fraction(180933933661, 5980300000) * 10**6,)
    assert force["truss-on-rough-floor"] == (Fraction(180933933661, 6186793000) * 10**6,)
    assert problem("truss-on-rough-floor").exact.displacement[0] == Fraction(30058, 30933965) * 1000
    assert problem("two-masses-on-rough-floor").exact.displacement[:2] == (Fraction("4.6425"), Fraction("14.19"))
    assert problem("master-and-slave").exact.displacement[0] == Fraction(11657, 28588)
    assert len(force) == len(problems("named"))
    assert all(known.source and known.formula and known.description for known in problems("named"))


def test_no_test_can_change_a_problem_for_another() -> None:
    known = problem("pad-slides")
    assert problem("pad-slides") is known
    for values in (known.displacement, known.normal_force, known.friction_force, known.gap, known.problem.load):
        assert values is not None
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 7


def test_names_kinds_and_difficulties() -> None:
    assert str(problem("redundant-17")) == "redundant-17"
    assert (problem("redundant-17").kind, problem("redundant-17").difficulty) == ("redundant", "hard")
    assert [known.name for known in problems("tied", "moderate", count=2, seed=5)] == ["tied-7", "tied-10"]
    assert {known.kind for known in problems()} == set(KINDS)
    assert {known.difficulty for known in problems("large")} == set(DIFFICULTIES)
    assert problems("named", "hard") == []
    assert len({known.name for known in problems(count=50)}) == 50 * len(RANDOM) + len(NAMED)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("redundnat-3", "did you mean 'redundant-0'"),
        ("truss-over-flor", "did you mean 'truss-over-floor'"),
        ("redundant", "with a seed"),
        ("redundant--1", "redundant--1"),
        ("redundant-01", "redundant-01"),
    ],
)
def test_an_unknown_name_is_refused_with_the_nearest(name: str, words: str) -> None:
    with pytest.raises(cq.InvalidProblem, match="gallery: no problem is called") as refused:
        problem(name)
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (dict(kind="redundnat"), "did you mean 'redundant'"),
        (dict(kind="x"), "expected one of named, well-posed"),
        (dict(difficulty="har"), "did you mean 'hard'"),
        (dict(count=-1), "count: expected an integer >= 0, got -1"),
        (dict(seed=1.5), "seed: expected a whole number, got 1.5"),
        (dict(count=10**9), "at most 100000"),
    ],
)
def test_unknown_kinds_and_counts_are_refused(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(cq.InvalidProblem, match=r"gallery: |problems: ") as refused:
        problems(**arguments)
    assert words in str(refused.value)


# The data of the first problems of each kind, once and for all: tests that name a problem must keep what they test.
FINGERPRINTS = {
    "well-posed": "79f642243338a436",
    "degenerate": "b5e926cc848d4e93",
    "redundant": "d070f4cf8df2bbe2",
    "floating": "7ed5b40ba865fc44",
    "frictional": "d4f5b131e72c3010",
    "stiff": "25bd51674b0baeba",
    "tied": "c96ef412b39aaadd",
    "large": "b03e53f422b8f4d5",
}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("kind", RANDOM)
def test_random_problems_never_change(kind: str) -> None:
    assert _fingerprint(kind) == FINGERPRINTS[kind]


@pytest.mark.slow
def test_problems_do_not_depend_on_the_process() -> None:
    code = (
        "from contactqp.oracle.gallery.gallery import problem; import numpy.random, random; random.seed(1); "
        "print(problem('frictional-1').exact.displacement == problem('frictional-1').exact.displacement, "
        "hash(problem('frictional-1').exact.displacement))"
    )
    printed = [
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
        for _ in range(2)
    ]
    assert printed[0] == printed[1] == f"True {hash(problem('frictional-1').exact.displacement)}\n"


def _fingerprint(kind: str) -> str:
    text = "".join(
        f"{known.name}: {[_plain(value) for value in dataclasses.astuple(known.data)]} {known.exact.displacement} "
        f"{known.exact.normal_force} {known.exact.friction_force} {known.exact.tie_force}\n"
        for known in problems(kind, count=3)
    )
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _plain(value: Any) -> Any:
    return [sorted(row.items()) if isinstance(row, dict) else row for row in value]


def _largest(*vectors: np.ndarray[Any, Any]) -> float:
    return max(float(np.max(abs(vector), initial=0.0)) for vector in vectors)
