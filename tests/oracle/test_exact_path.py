"""Load paths with friction in rational numbers: events, answers and refusals."""

from __future__ import annotations

import pathlib
from dataclasses import replace
from fractions import Fraction as F

import pytest
from flint import fmpq, fmpq_mat

import contactqp as cq
from contactqp.linalg.rational import column, fractions, zeros
from contactqp.oracle.exact.exact_path import LooseRates, follow
from contactqp.oracle.exact.rational_equilibrium import Combination, System, system_of
from contactqp.oracle.exact.rational_problem import RationalAnswer, RationalProblem, of_floats
from tests.shipped_cases import SCENES

CASES = pathlib.Path(__file__).parents[2] / "cases"
PATHS = [
    name
    for name, scene in SCENES.items()
    if scene.path is not None
    and not (scene.meshed or scene.large)
    and any(contact.friction for contact in scene.contacts)
    and name != "wedge"
]


def exact(name: str) -> cq.ExactSolution:
    return cq.exact(cq.load_scene(CASES / f"{name}.toml"))


def slider(friction: float = 0.25) -> RationalProblem:
    """A block on a spring of 2, pressed on a rough floor."""
    return of_floats(
        cq.ContactProblem([[2.0, 0.0], [0.0, 0.0]], [0.0, 0.0], [[0.0, -1.0]], [0.0], [[1.0, 0.0]], friction)
    )


@pytest.mark.sampled(9)
@pytest.mark.parametrize("name", PATHS)
def test_the_exact_path_is_the_path_of_floats(name: str) -> None:
    """Independent of it: other code finds its events and states, in doubles."""
    scene = cq.load_scene(CASES / f"{name}.toml")
    answer, history = cq.exact(scene), cq.run(scene)
    end, doubles = history[-1], answer.doubles
    size = float(max(abs(end.normal_force).max(), 1.0))
    assert doubles.displacement == pytest.approx(end.displacement, abs=1e-12)
    assert doubles.normal_force == pytest.approx(end.normal_force, abs=1e-12 * size)
    assert doubles.friction_force == pytest.approx(end.friction_force, abs=1e-12 * size)
    assert list(answer.contact_status) == list(end.contact_status)
    assert [(e.kind, e.contact) for e in answer.events] == [(e.kind, e.contact) for e in history.events]
    assert [float(e.time) for e in answer.events] == pytest.approx([e.time for e in history.events], abs=1e-11)


def test_event_times_are_the_published_rationals() -> None:
    # The load factor at which the truss touches, by hand: gap over free displacement.
    assert {e.time for e in exact("truss_friction").events} == {F(458394666339, 639328600000)}
    # Example 2.19: thresholds 981/400 and 2943/400 N on the way to 12 N, 1419/200 N on the way back.
    times = [e.time for e in exact("two_masses").events if e.kind == "slip"]
    assert [12 * (t - 1) for t in times[:2]] == [F(981, 400), F(2943, 400)]
    assert 12 * (3 - times[2]) == F(1419, 200)


def test_the_order_of_loads_matters() -> None:
    press, push = exact("order_press_first"), exact("order_push_first")
    assert press.problem.load.tolist() == push.problem.load.tolist()
    assert press.normal_force[0] != push.normal_force[0]


def test_a_slider_that_is_pulled_and_let_go() -> None:
    # Pressed by 1, pulled by 1: slips at 1/4, ends at (1 - 1/4) / 2; let go, the spring pulls with 3/4 > 1/4.
    end = follow(slider(), [column([0.0, -1.0]), column([1.0, -1.0]), column([0.0, -1.0])], ["pad"])
    assert [(event.kind, event.time) for event in end.events] == [
        ("closed", 0),
        ("slip", F(5, 4)),
        ("stick", 2),
        ("slip", F(5, 2)),
    ]
    assert fractions(end.answer.displacement) == [F(1, 8), 0]
    assert fractions(end.answer.friction_force) == [F(-1, 4)]
    assert end.status == ("slip",)


def test_a_path_without_load_stays_at_rest() -> None:
    end = follow(slider(), [zeros(2, 1)], ["pad"])
    assert fractions(end.answer.displacement) == [0, 0]
    assert end.status == ("grazing",)


def test_a_lost_equilibrium_is_told_with_its_time() -> None:
    loose = replace(slider(), K=zeros(2, 2))
    with pytest.raises(cq.NoEquilibrium, match=r"t = 1\.25: no continuation"):
        follow(loose, [column([0.0, -1.0]), column([1.0, -1.0])], ["pad"])


def test_a_loose_body_that_falls_has_not_lost_its_equilibrium() -> None:
    """A block falls at once onto the floor below, where it rests: no equilibrium is denied."""
    block = replace(slider(), K=zeros(2, 2), g=column([0.1]))
    with pytest.raises(cq.Unsupported, match="t = 0: the path jumps where the load moves a body that nothing holds"):
        follow(block, [column([0.0, -1.0])], ["pad"])


def test_friction_above_a_critical_one_goes_on_in_several_ways() -> None:
    # Load (5/2, -1) on a node that touches: it sticks (5/2 < 3), or lifts off by K^-1 f = (3/2, 1/2), or slips by 1/2.
    coupled = of_floats(
        cq.ContactProblem([[2.0, -1.0], [-1.0, 1.0]], [0.0, 0.0], [[0.0, -1.0]], [0.0], [[1.0, 0.0]], 3.0)
    )
    with pytest.raises(cq.SeveralEquilibria, match=r"at t = 0: several continuations.*open; stick; slip on"):
        follow(coupled, [column([2.5, -1.0])], ["node"])


def test_paths_that_do_not_start_at_rest_are_refused() -> None:
    overlap = replace(slider(), g=column([-1.0]))
    away = replace(slider(), slip_origin=column([1.0]))
    for data, why in ((overlap, "does not start"), (away, "away from its slip_origin")):
        with pytest.raises(cq.Unsupported, match=why):
            follow(data, [column([0.0, -1.0])], ["pad"])


def test_a_piece_that_breaks_the_law_would_be_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the next event skipped, the cone is left: the proof at the end of the piece refuses it."""
    monkeypatch.setattr("contactqp.oracle.exact.exact_path._Walk._ahead", lambda *_: fmpq(1))
    with pytest.raises(ArithmeticError, match="cone"):
        follow(slider(), [column([0.0, -1.0]), column([1.0, -1.0])], ["pad"])


def two_stops(friction: tuple[float, float]) -> RationalProblem:
    """A node on springs that two stops of one place hold: who of them carries what is open."""
    return of_floats(
        cq.ContactProblem(
            [[2.0, 0.0], [0.0, 3.0]],
            [0.0, 0.0],
            [[0.0, -1.0], [0.0, -1.0]],
            [0.0, 0.0],
            [[1.0, 0.0], [1.0, 0.0]],
            list(friction),
        )
    )


@pytest.mark.sampled(3)
@pytest.mark.parametrize("friction", [(1.0, 1.0), (1.0, 0.25), (0.25, 1.0)])
@pytest.mark.parametrize("push", [0.0, 0.125, 0.5, 2.0])
def test_forces_that_are_open_in_rates_are_said_to_be(friction: tuple[float, float], push: float) -> None:
    """One motion, several forces: no case of several equilibria."""
    with pytest.raises(cq.Unsupported, match="contact forces are not unique in rates"):
        follow(two_stops(friction), [column([push, -1.0])], ["one", "other"])


def jammed() -> RationalProblem:
    """A node between two walls that touch it, which only their friction can hold."""
    return of_floats(
        cq.ContactProblem(
            [[1.0, 0.0], [0.0, 0.0]], [0.0, 1.0], [[1.0, 0.0], [-1.0, 0.0]], [0.0, 0.0], [[0.0, 1.0], [0.0, 1.0]], 0.5
        )
    )


def test_a_solution_that_breaks_the_law_does_not_speak_for_the_others() -> None:
    """Of a singular system one solution is computed, without any jamming: the law refuses it, and others hold."""
    data = jammed()
    system = system_of(data, Combination((0, 1), (0, 1)))
    solved = system.solve()
    assert solved is not None
    motion, forces, only = solved
    assert not only

    def rooms(rate: RationalAnswer) -> list[fmpq]:
        push, rub = rate.normal_force.entries(), rate.friction_force.entries()
        return [x for N, T in zip(push, rub, strict=True) for x in (N, N / 2 - T, N / 2 + T)]

    assert any(x < 0 for x in rooms(system.answer(motion, forces)))
    loose = LooseRates(system, motion, forces, rooms)
    assert not loose.empty
    assert not loose.forces_known
    # With forces below 3/4 nothing holds: 2 * 3/8 < 1.
    bounded = LooseRates(system, motion, forces, lambda rate: [*rooms(rate), *_below(rate, system, motion, forces)])
    assert bounded.empty
    with pytest.raises(cq.Unsupported, match="contact forces are not unique"):
        follow(data, [column([0.0, 1.0])], ["left", "right"])


def _below(rate: RationalAnswer, system: System, motion: fmpq_mat, forces: fmpq_mat) -> list[fmpq]:
    """3/4 - N, of which directions have -N only."""
    start = system.answer(motion, forces)
    constant = fmpq(3, 4) if rate.displacement == start.displacement and _same_load(rate, start) else fmpq(0)
    return [constant - x for x in rate.normal_force.entries()]


def _same_load(rate: RationalAnswer, start: RationalAnswer) -> bool:
    return bool(sum(rate.friction_force.entries(), fmpq(0)) == sum(start.friction_force.entries(), fmpq(0)) != 0)
