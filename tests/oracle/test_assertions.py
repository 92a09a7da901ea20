"""The assertions pass right answers, whatever their signs and orders, and fail on wrong ones at the stated limit."""

from __future__ import annotations

import re
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate import state_answer
from contactqp.oracle.assertions import assert_contact_solution, assert_multipliers
from contactqp.oracle.gallery.gallery import problem, problems
from contactqp.oracle.gallery.problem import GalleryProblem, stated

EVERY = problems()
SLIDING = [known for known in EVERY if "slip" in known.exact.contact_status]


def parts(known: GalleryProblem) -> dict[str, Any]:
    return dict(
        displacement=known.displacement,
        normal_force=known.normal_force,
        friction_force=known.friction_force,
        tie_force=known.tie_force,
    )


@pytest.mark.sampled(16)
@pytest.mark.parametrize("known", EVERY)
def test_exact_answers_pass(known: GalleryProblem) -> None:
    given = parts(known)
    assert_contact_solution(known, **given)
    assert_contact_solution(known.problem, **given)
    forces = {name: value for name, value in given.items() if name != "displacement"}
    assert_multipliers(known, **forces)
    negative = forces | {"normal_force": -known.normal_force}
    assert_multipliers(known, **negative, compression="negative")


@pytest.mark.sampled(10)
@pytest.mark.parametrize("known", [known for known in EVERY if not known.problem.frictional])
def test_exact_forces_pass_beside_a_solution(known: GalleryProblem) -> None:
    assert_multipliers(known.problem, known.normal_force, tie_force=known.tie_force)


@pytest.mark.sampled(40)
@pytest.mark.parametrize("known", [known for known in EVERY if any(known.exact.normal_force)])
def test_the_opposite_sign_fails(known: GalleryProblem) -> None:
    # Where other answers are not excluded, another one may be meant.
    several = cq.certify(known.problem, **parts(known)).uniqueness
    words = "all contact forces have the opposite sign"
    words = f"{known.name}: .*\n{f'({words}|.* held in tension)' if several else words}"
    with pytest.raises(AssertionError, match=words):
        assert_contact_solution(known, **parts(known) | {"normal_force": -known.normal_force})
    with pytest.raises(AssertionError, match=words):
        assert_multipliers(known, -known.normal_force, known.friction_force, known.tie_force)


@pytest.mark.sampled(8)
@pytest.mark.parametrize("known", SLIDING)
def test_friction_along_the_slip_fails(known: GalleryProblem) -> None:
    given = parts(known) | {"friction_force": -np.asarray(known.friction_force)}
    with pytest.raises(AssertionError, match="friction"):
        assert_contact_solution(known, **given)
    with pytest.raises(AssertionError):
        assert_multipliers(known, known.normal_force, given["friction_force"])


@pytest.mark.sampled(26)
@pytest.mark.parametrize("known", EVERY)
def test_a_moved_displacement_fails(known: GalleryProblem) -> None:
    given = parts(known)
    size = max(float(np.max(abs(known.displacement))), float(np.max(abs(known.problem.gap), initial=0)), 1.0)
    given["displacement"] = known.displacement + size * np.cos(np.arange(known.problem.dimension))
    with pytest.raises(AssertionError, match=re.escape(known.name)):
        assert_contact_solution(known, **given)


@pytest.mark.parametrize("part", ["displacement", "normal_force", "friction_force", "tie_force"])
def test_what_is_not_finite_fails(part: str) -> None:
    name = {"friction_force": "pad-slides", "tie_force": "master-and-slave"}.get(part, "bar-and-wall")
    given = parts(problem(name))
    given[part] = np.full_like(given[part], np.nan)
    with pytest.raises(AssertionError):
        assert_contact_solution(problem(name), **given)
    if part != "displacement":
        del given["displacement"]
        with pytest.raises(AssertionError):
            assert_multipliers(problem(name), **given)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("rtol", [1e-9, 1e-6, 1e-3])
def test_rtol_of_the_displacement_on_both_sides_of_the_limit(rtol: float) -> None:
    """The bar stands 1 mm from where it was: off by d it violates d / 2 and is wrong by d."""
    bar = problem("bar-and-wall")
    assert_contact_solution(bar, [1 + 0.9 * rtol], [142.5], rtol=rtol)
    with pytest.raises(AssertionError):
        assert_contact_solution(bar, [1 + 1.1 * rtol], [142.5], rtol=rtol)
    assert_contact_solution(bar.problem, [1 + 0.9 * rtol], [142.5], rtol=rtol)
    with pytest.raises(AssertionError):
        assert_contact_solution(bar.problem, [1 + 1.1 * rtol], [142.5], rtol=rtol)


@pytest.mark.slow
@pytest.mark.parametrize("rtol", [1e-9, 1e-6, 1e-3])
def test_rtol_of_the_forces_on_both_sides_of_the_limit(rtol: float) -> None:
    bar = problem("bar-and-wall")
    for sign in (-1, 1):
        inside, outside = ([142.5 * (1 + sign * factor * rtol)] for factor in (0.9, 1.1))
        assert_multipliers(bar, inside, rtol=rtol)
        assert_contact_solution(bar, [1.0], inside, rtol=rtol)
        with pytest.raises(AssertionError, match=r"142\.5"):
            assert_multipliers(bar, outside, rtol=rtol)
        with pytest.raises(AssertionError):
            assert_contact_solution(bar, [1.0], outside, rtol=rtol)


def test_rtol_is_the_tolerance_of_the_figures() -> None:
    """The truss sinks into the floor by d: the figure is d / 2, of the 1 mm that it moved and the gap of 1 mm."""
    truss = problem("truss-over-floor")
    sunk = truss.displacement + np.array([0, -1e-5])
    found = cq.certify(truss.problem, sunk, truss.normal_force)
    assert found.penetration == pytest.approx(5e-6, rel=1e-4)
    worst = max(found.penetration, found.equilibrium, found.energy_error or 0, found.force_error or 0, 1e-5)
    assert_contact_solution(truss, sunk, truss.normal_force, rtol=1.1 * worst)
    with pytest.raises(AssertionError, match=r"floor +gap"):
        assert_contact_solution(truss.problem, sunk, truss.normal_force, rtol=0.9 * found.penetration)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("rtol", [1e-9, 1e-4])
def test_rtol_of_forces_is_relative_to_the_largest_and_blind_to_the_scale_of_rows(rtol: float) -> None:
    known = problem("falling-dominoes")
    force = known.normal_force
    assert_multipliers(known, force + np.array([0, 0, 0.9 * rtol * 7]), rtol=rtol)
    with pytest.raises(AssertionError, match="contact 2"):
        assert_multipliers(known, force + np.array([0, 0, 1.1 * rtol * 7]), rtol=rtol)
    scale = np.array([1.0, 1.0, 8.0])
    scaled = known.problem.replace(normal=scale[:, None] * known.problem.normal, gap=scale * known.problem.gap)
    assert_multipliers(scaled, force / scale + [0, 0, 0.9 * rtol * 7 / 8], rtol=rtol)
    with pytest.raises(AssertionError, match="contact 2"):
        assert_multipliers(scaled, force / scale + [0, 0, 1.1 * rtol * 7 / 8], rtol=rtol)


@pytest.mark.slow
def test_forces_that_are_not_unique_are_held_against_what_they_do_together() -> None:
    stops = problem("redundant-stops")
    for right in ([5, 5], [10, 0], [2.5, 7.5]):
        assert_multipliers(stops, right)
        assert_multipliers(stops.problem, right)
        assert_contact_solution(stops, [1], right)
    for wrong, word in (([11, -1], "tension"), ([6, 5], "resultant"), ([5, 4.9999], "resultant")):
        with pytest.raises(AssertionError, match=word):
            assert_multipliers(stops, wrong)
        with pytest.raises(AssertionError, match=word):
            assert_multipliers(stops.problem, wrong)
    assert_multipliers(stops, [5, 5 + 0.9e-4 * 10], rtol=1e-4)
    with pytest.raises(AssertionError, match="resultant"):
        assert_multipliers(stops, [5, 5 + 1.1e-4 * 10], rtol=1e-4)


@pytest.mark.slow
def test_a_force_at_an_open_contact_fails_where_forces_are_not_unique() -> None:
    K = np.diag([2.0, 1.0])
    three = cq.ContactProblem(stiffness=K, load=[12, 0], normal=[[1, 0], [1, 0], [1, 0]], gap=[1, 1, 2])
    assert_multipliers(three, [4, 6, 0])
    with pytest.raises(AssertionError, match="force at an open contact"):
        assert_multipliers(three, [4, 5, 1])


@pytest.mark.slow
def test_redundant_friction_is_judged_by_cone_direction_and_resultant() -> None:
    """Two feet of one pad share its weight of 50 and its friction of 25 as they like."""
    pad = problem("pad-slides-in-space")
    E_N, E_T = pad.problem.normal.toarray(), pad.problem.tangent.toarray()  # type: ignore[union-attr]
    feet = cq.ContactProblem(
        stiffness=pad.problem.stiffness,
        load=pad.problem.load,
        normal=np.vstack([E_N, E_N]),
        gap=[0, 0],
        tangent=np.vstack([E_T, E_T]),
        friction=0.5,
    )
    assert_contact_solution(feet, [3, 4, 0], [20, 30], [[6, 8], [9, 12]])
    assert_multipliers(feet, [20, 30], [[6, 8], [9, 12]])
    for friction in ([[9, 12], [6, 8]], [[6, 8], [-9, -12]], [[6, 8], [8, 12]]):
        with pytest.raises(AssertionError):
            assert_multipliers(feet, [20, 30], friction)


def test_ties_that_are_not_given_may_be_any() -> None:
    known = problem("tied-1")
    assert_multipliers(known, known.normal_force)
    with pytest.raises(AssertionError, match="tie 0"):
        assert_multipliers(known, known.normal_force, tie_force=known.tie_force + 1)


def test_redundant_contacts_beside_ties() -> None:
    tied = cq.ContactProblem(
        stiffness=np.eye(2), load=[12, 3], normal=[[1, 0], [1, 0]], gap=[1, 1], tie=[[1, -1]], tie_value=[0]
    )
    right = cq.solve(tied)
    total = right.normal_force.sum()
    assert_multipliers(tied, [total, 0])
    assert_multipliers(tied, [0, total], tie_force=right.tie_force)
    with pytest.raises(AssertionError, match="resultant"):
        assert_multipliers(tied, [total + 1, 0])
    with pytest.raises(AssertionError, match="resultant"):
        assert_multipliers(tied, [total, 0], tie_force=right.tie_force + 1)


def test_several_answers_are_all_right() -> None:
    for state in ("sticks", "slides", "opens"):
        known = problem(f"klarbring-{state}")
        for other in ("sticks", "slides", "opens"):
            assert_contact_solution(problem(f"klarbring-{other}"), **parts(known))
        assert_multipliers(problem("klarbring-sticks"), known.normal_force, known.friction_force)
    with pytest.raises(AssertionError):
        assert_multipliers(problem("klarbring-sticks"), [1.0], [[0.5]])
    with pytest.raises(cq.Unsupported, match="several answers"):
        assert_multipliers(problem("klarbring-sticks"), [1.0])


def test_a_small_residual_is_not_the_exact_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two nodes on soft springs, joined by a stiff one, off by 1e-4 together: 5e-14 of the forces that meet there.

    A pad with friction beside them is why no bound can be had; the combination of its states is taken for too large, so
    that the certificate has its figures alone.
    """
    k = 2**30
    known = GalleryProblem(
        "soft-beside-a-pad",
        "named",
        "easy",
        lambda: stated(
            stiffness=[[k + 1, -k, 0, 0], [-k, k + 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
            load=[1, 1, -4, Fraction(5, 4)],
            normal=[[0, 0, -1, 0]],
            gap=[0],
            tangent=[[0, 0, 0, 1]],
            friction=Fraction(1, 16),
            displacement=[1, 1, 0, 1],
            normal_force=[4],
            friction_force=[[Fraction(1, 4)]],
            description="",
            source="",
            formula="",
            one_displacement=True,
        ),
    )
    given = parts(known)
    assert_contact_solution(known, **given)
    given["displacement"] = known.displacement + np.array([1e-4, 1e-4, 0, 0])
    assert cq.certify(known.problem, **given).equilibrium < 1e-12
    with pytest.raises(AssertionError, match=r"the displacement is .* away from the answer of its\s+own combination"):
        assert cq.certify(known.problem, **given).passed, str(cq.certify(known.problem, **given))
    monkeypatch.setattr(state_answer, "MOST_OPERATIONS", 0.0)
    with pytest.raises(AssertionError, match="what it violates is small, but this is not the exact answer") as failed:
        assert_contact_solution(known, **given)
    assert "unknown 0" in str(failed.value)


def test_orders_and_pressures_are_taken_as_by_certify() -> None:
    bars = problem("two-bars")
    u, force = bars.displacement, bars.normal_force
    assert_contact_solution(bars, u[::-1], force, dof_map=["2.x", "1.x"])
    assert_contact_solution(bars, u, force / 4, pressure_area=[4.0])
    assert_multipliers(bars, force / 4, pressure_area=[4.0])
    dominoes = problem("falling-dominoes")
    assert_multipliers(dominoes, dominoes.normal_force[::-1], contact_map=[2, 1, 0])
    with pytest.raises(AssertionError):
        assert_multipliers(dominoes, dominoes.normal_force[::-1])


def test_missing_parts_are_recovered() -> None:
    truss = problem("truss-over-floor")
    assert_contact_solution(truss, truss.displacement)
    assert_contact_solution(truss, normal_force=truss.normal_force)
    with pytest.raises(AssertionError):
        assert_contact_solution(truss, normal_force=1.01 * truss.normal_force)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda bar: assert_contact_solution(bar), "expected displacement, normal_force or both"),
        (lambda bar: assert_contact_solution(bar, [1.0], [142.5, 0.0]), r"normal_force: expected shape \(1,\)"),
        (lambda bar: assert_contact_solution(bar, [1.0], [142.5], rtol=0), "rtol: expected a positive number"),
        (lambda bar: assert_multipliers(bar, [142.5], rtol=-1.0), "rtol: expected a positive number"),
        (lambda bar: assert_multipliers(bar, None), "expected normal_force"),
        (lambda bar: assert_multipliers(bar, [142.5], compression="pos"), "expected 'positive' or 'negative'"),
        (lambda bar: assert_multipliers(bar, [142.5], [[0.0]]), "no tangential rows"),
        (lambda _: assert_multipliers([[1.0]], [142.5]), "expected a ContactProblem or a GalleryProblem"),  # type: ignore[arg-type]
    ],
)
def test_what_is_no_answer_is_refused(call: Any, words: str) -> None:
    with pytest.raises(cq.InvalidProblem, match=words):
        call(problem("bar-and-wall"))


def test_the_message_has_the_place_the_wrong_and_the_right_values_and_their_units() -> None:
    with pytest.raises(AssertionError) as failed:
        assert_contact_solution(problem("bar-and-wall"), [1.0], [-142.5])
    message = str(failed.value)
    for words in ("bar-and-wall: the answer is wrong", "wall", "-142.5", "142.5", "[kN]", "opposite sign"):
        assert words in message
    with pytest.raises(AssertionError) as failed:
        assert_multipliers(problem("bar-and-wall"), [-142.5])
    lines = str(failed.value).splitlines()
    assert lines[0] == "bar-and-wall: the forces are not the exact ones (rtol 1e-09)"
    assert lines[-1].split() == ["wall", "normal", "force", "-142.5", "kN", "142.5", "kN", "2"]
