"""Load paths with Coulomb friction in steps: history, anchors, events, dissipation.

Steps that jump across a snap, or take one of several continuations, are noted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.analysis import friction_events, friction_path
from contactqp.linalg.condensation import condense
from contactqp.model.coulomb import OPEN
from contactqp.solving.friction.force_system import ForceSystem
from tests.analysis.friction_paths import ORDERS, WEIGHTS, jenkins, pulled, rolling_block, truss_from_rest
from tests.analysis.test_friction_events import KLARBRING, random_body
from tests.solving.friction.problems import TOUCH, one_contact, random_problem, rough_truss, two_masses

CLOSING = 458394666339 / 639328600000
COUNTS = (1, 2, 7, 40)


@pytest.mark.sampled(5)
@pytest.mark.parametrize("steps", COUNTS)
@pytest.mark.parametrize("options", [{}, {"algorithm": "tresca"}, {"algorithm": "newton"}, {"method": "clarabel"}])
def test_example_2_18_by_every_step_count(steps: int, options: dict[str, str]) -> None:
    history = cq.follow_path(truss_from_rest(0.3), [[60.0, -100.0]], steps=steps, **options)
    assert len(history) == steps + 1
    np.testing.assert_allclose(history[-1].displacement[0], 30058 / 30933965, rtol=1e-12)
    np.testing.assert_allclose(history[-1].normal_force[0], 180933933661 / 6186793000, rtol=1e-12)
    np.testing.assert_allclose(history[-1].friction_force[0, 0], 0.3 * 180933933661 / 6186793000, rtol=1e-12)
    shown = next(time for time in history.times if time > CLOSING)
    assert [(event.kind, event.time, event.name) for event in history.events] == [
        ("closed", shown, "floor"),
        ("slip", shown, "floor"),
    ]


@pytest.mark.sampled(8)
@pytest.mark.parametrize("steps", COUNTS)
@pytest.mark.parametrize("options", [{}, {"algorithm": "tresca"}])
def test_example_2_17_sticks_where_it_touched(steps: int, options: dict[str, str]) -> None:
    """Anchored at the end of the step it would stand at 0.74779 mm after one step, 0.81467 mm after ten."""
    history = cq.follow_path(truss_from_rest(0.8), [[60.0, -100.0]], steps=steps, **options)
    np.testing.assert_allclose(history[-1].displacement[0], TOUCH, rtol=1e-14)
    np.testing.assert_allclose(history[-1].normal_force[0], 180933933661 / 6393286000, rtol=1e-12)
    assert history[-1].contact_status.tolist() == ["stick"]
    assert [event.kind for event in history.events] == ["closed"]


def test_a_wrong_anchor_is_refused() -> None:
    right = cq.follow_path(truss_from_rest(0.8), [[60.0, -100.0]], steps=1)[-1]
    without_event = cq.solve(rough_truss(0.8, 0.0))
    assert abs(without_event.displacement[0] - TOUCH) > 8e-5
    forces = (right.displacement, right.normal_force, right.friction_force)
    assert cq.certify(right.problem, *forces).passed
    moved = right.problem.replace(slip_origin=without_event.displacement[:1])
    assert not cq.certify(moved, *forces).passed


@pytest.mark.parametrize("name", ORDERS)
def test_the_order_of_loads_decides_the_state(name: str) -> None:
    loads, moved, force, ratio = ORDERS[name]
    history = cq.follow_path(truss_from_rest(0.3), loads, steps=7)
    np.testing.assert_allclose(history[-1].displacement[0], moved, rtol=1e-12)
    np.testing.assert_allclose(history[-1].normal_force[0], force, rtol=1e-12)
    np.testing.assert_allclose(history[-1].friction_force[0, 0], ratio * force, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_example_2_19_loaded_and_unloaded_in_steps() -> None:
    corners = [WEIGHTS, pulled(12.0), WEIGHTS]
    history = cq.follow_path(two_masses(0.0), corners, steps=16)
    np.testing.assert_allclose(history[-1].displacement, [4.6425e-3, 7.095e-3, 0, 0], rtol=1e-13, atol=1e-16)
    np.testing.assert_allclose(history[-1].friction_force[:, 0], [-2.19, -2.4525], rtol=1e-12)
    np.testing.assert_allclose(history.energies[-1].dissipated, 0.074972925, rtol=1e-12)
    np.testing.assert_allclose(history.energies[-1].elastic, 0.01378378125, rtol=1e-12)
    slips = [(event.contact, event.time) for event in history.events if event.kind == "slip"]
    assert slips == [(1, 1 + 4 / 16), (0, 1 + 10 / 16), (1, 2 + 7 / 16)]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("steps", COUNTS)
def test_normal_first_or_tangential_first(steps: int) -> None:
    """K = [[2, -1/2], [-1/2, 2]] in (n, t): pressed first it sticks at 0, pushed first where it comes down, at 1/8."""
    problem = cq.ContactProblem(
        stiffness=[[2.0, -0.5], [-0.5, 2.0]],
        load=[0.0, 0.0],
        normal=[[-1.0, 0.0]],
        gap=[0.0],
        tangent=[[0.0, 1.0]],
        friction=0.3,
    )
    for loads in ([[-1.0, 0.25]], [[-1.0, 0.0], [-1.0, 0.25]]):
        stuck = cq.follow_path(problem, loads, steps=steps)[-1]
        np.testing.assert_allclose(stuck.displacement, 0.0, atol=1e-15)
        np.testing.assert_allclose([stuck.normal_force[0], stuck.friction_force[0, 0]], [1.0, 0.25], rtol=1e-12)
    other = cq.follow_path(problem, [[0.0, 0.25], [-1.0, 0.25]], steps=steps)[-1]
    np.testing.assert_allclose(other.displacement, [0.0, 0.125], atol=1e-15)
    np.testing.assert_allclose([other.normal_force[0], other.friction_force[0, 0]], [0.9375, 0.0], atol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("events", ["exact", None])
def test_energy_of_a_jenkins_loop(events: str | None) -> None:
    """k = 2, mu N = 0.3, amplitude 0.5: a loop costs 4 mu N (D - mu N / k) = 0.42."""
    problem, loads = jenkins(stiffness=2.0, friction=0.3, amplitude=0.5, loops=2)
    history = cq.follow_path(problem, loads, steps=10 if events is None else None, events=events)
    at = {time: energies for time, energies in zip(history.times.tolist(), history.energies, strict=True)}
    for start, end in ((2.0, 4.0), (4.0, 6.0)):
        np.testing.assert_allclose(at[end].dissipated - at[start].dissipated, 0.42, rtol=1e-12)
        np.testing.assert_allclose(at[end].elastic, at[start].elastic, rtol=1e-12)
        if events:
            np.testing.assert_allclose(at[end].work - at[start].work, 0.42, rtol=1e-12)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("options", [{"steps": 3}, {"steps": 50}, {"events": "exact"}, {"steps": 3, "method": "osqp"}])
def test_a_contact_that_closes_again_elsewhere(options: dict[str, object]) -> None:
    """It sticks where it came down; lifted, its anchor is gone; then it comes down and sticks somewhere else."""
    K11, K12, K22 = Fraction(59803), Fraction(68831, 10), Fraction(77443)
    gap = Fraction(1, 1000)
    # On the way from (60, 0) to (20, -100) the node touches where u_z = -gap: f = (60 - 40 t, -100 t).
    touch = Fraction(60 * K12 - K11 * K22 * gap + K12**2 * gap) / (40 * K12 - 100 * K11)
    again = (60 - 40 * touch + K12 * gap) / K11
    loads = [[60.0, -100.0], [60.0, 0.0], [20.0, -100.0]]
    history = cq.follow_path(truss_from_rest(5.0), loads, **options)
    down, up, down_again = (next(s for s, t in zip(history, history.times, strict=True) if t == c) for c in (1, 2, 3))
    np.testing.assert_allclose(down.displacement[0], TOUCH, rtol=1e-13)
    assert up.contact_status.tolist() == ["open"]
    np.testing.assert_allclose(down_again.displacement[0], float(again), rtol=1e-12)
    assert down_again.contact_status.tolist() == ["stick"]
    kinds = [event.kind for event in history.events]
    assert [kind for kind in kinds if kind != "slip"] == ["closed", "opened", "closed"]


def test_contacts_closed_at_the_start_are_anchored_where_the_caller_says() -> None:
    """Two masses whose springs hold nothing back at d = (0, 0), anchored 1 mm further on: friction pulls them there."""
    history = cq.follow_path(two_masses(0.0, (1e-3, 1e-3)), [WEIGHTS], steps=1)
    np.testing.assert_allclose(history[-1].problem.slip_origin[:, 0], 1e-3)
    np.testing.assert_allclose(history[-1].displacement[:2], 1e-3, rtol=1e-12)
    with pytest.raises(cq.Unsupported, match="jump"):
        cq.follow_path(two_masses(0.0, (1e-3, 1e-3)), [WEIGHTS], events="exact")


@pytest.mark.slow
def test_what_falls_freely_is_anchored_where_the_step_began() -> None:
    above = two_masses(0.0).replace(gap=[1e-3, 2e-3])
    history = cq.follow_path(above, [WEIGHTS, pulled(12.0), WEIGHTS], steps=4)
    np.testing.assert_allclose(history[-1].displacement, [4.6425e-3, 7.095e-3, -1e-3, -2e-3], rtol=1e-12)
    with pytest.raises(cq.Unsupported, match=r"the load moves a body that nothing holds.*\(at t = 0\)"):
        cq.follow_path(above, [WEIGHTS], events="exact")


@pytest.mark.slow
def test_steps_wait_until_they_are_looked_at_and_share_one_factorisation() -> None:
    problem, loads = rolling_block(0.3)
    history = cq.follow_path(problem, loads, steps=5)
    assert not any(isinstance(step, cq.Solution) for step in history._solutions._steps)
    assert history[3].certificate.passed
    assert sum(isinstance(step, cq.Solution) for step in history._solutions._steps) == 1
    assert sum(solution.work.factorisations for solution in history) == 1
    assert all(solution.method == "newton" for solution in history)


@pytest.mark.slow
def test_a_body_by_newton_and_by_tresca() -> None:
    """The quick way on the contact unknowns and `solve` step by step are the same path."""
    problem, loads = rolling_block(0.3)
    quick = cq.follow_path(problem, loads, steps=4)
    slow = cq.follow_path(problem, loads, steps=4, algorithm="tresca")
    scale = np.max(abs(quick.displacements))
    np.testing.assert_allclose(quick.displacements, slow.displacements, atol=1e-10 * scale)
    assert quick.events == slow.events
    assert {event.kind for event in quick.events} >= {"closed", "slip"}


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.05, 0.2, 0.4])
def test_friction_takes_energy_and_a_closed_cycle_gives_none(friction: float) -> None:
    problem, loads = rolling_block(friction)
    press, push = loads
    cycle = [press, push, press, 2 * press - push, press]
    energies = cq.follow_path(problem, cycle, steps=12).energies
    dissipated = np.array([one.dissipated for one in energies])
    assert np.all(np.diff(dissipated) >= 0)
    assert dissipated[-1] > 0
    # Between the first and the last visit to `press`.
    first, last = energies[12], energies[-1]
    given = last.work - first.work - (last.elastic - first.elastic)
    assert given > 0


@pytest.mark.slow
@pytest.mark.parametrize("steps", [1, 3, 8])
def test_where_all_contacts_stick_steps_are_exact(steps: int) -> None:
    """mu = 100: nothing slips, each of many contacts sticks where it closed, and no step count moves them."""
    problem, loads = rolling_block(100.0)
    exact = cq.follow_path(problem, loads, events="exact")[-1]
    history = cq.follow_path(problem, loads, steps=steps)
    assert np.count_nonzero(history[-1].normal_force) > 8
    size = np.max(abs(exact.displacement))
    np.testing.assert_allclose(history[-1].displacement, exact.displacement, atol=1e-12 * size)
    force = np.max(exact.normal_force)
    np.testing.assert_allclose(history[-1].friction_force, exact.friction_force, atol=1e-10 * force)


def test_no_equilibrium_is_told_at_its_load() -> None:
    """The second pad has nothing but friction: 0.25 x 9.81 N = 2.4525 N; in ten steps of 1 N, at the third."""
    loose = two_masses(0.0).replace(stiffness=np.zeros((4, 4)))
    with pytest.raises(cq.NoEquilibrium, match=r"t = 1\.3"):
        cq.follow_path(loose, [WEIGHTS, pulled(10.0)], steps=10)
    with pytest.raises(cq.NoEquilibrium, match=r"t = 1\.24525: .*contact 1"):
        cq.follow_path(loose, [WEIGHTS, pulled(10.0)], events="exact")


def test_what_a_path_with_friction_cannot_do_is_refused() -> None:
    with pytest.raises(cq.Unsupported, match="no method is called 'NAME'"):
        cq.follow_path(truss_from_rest(0.3), [[60.0, -100.0]], method="NAME")
    with pytest.raises(cq.Unsupported, match=r"singular stiffness|semidefinite|exact convex method"):
        cq.follow_path(truss_from_rest(0.3), [[60.0, -100.0]], method="projected-gauss-seidel")
    with pytest.raises(cq.InvalidProblem, match="warm_start"):
        cq.follow_path(truss_from_rest(0.3), [[60.0, -100.0]], warm_start=cq.solve(rough_truss()))
    with pytest.raises(cq.InvalidProblem, match="penalty"):
        cq.follow_path(truss_from_rest(0.3), [[60.0, -100.0]], penalty=1e6)
    with pytest.raises(cq.InvalidProblem, match="bisection"):
        cq.follow_path(truss_from_rest(0.3), [[60.0, -100.0]], algorithm="bisection")
    with pytest.raises(cq.InvalidProblem, match="tolerance"):
        cq.follow_path(truss_from_rest(0.3), [[60.0, -100.0]], tolerance=-1.0)
    space = cq.ContactProblem(np.eye(3), np.zeros(3), -np.eye(1, 3), [0.0], tangent=np.eye(3)[1:], friction=0.3)
    with pytest.raises(cq.Unsupported, match="two tangential rows"):
        cq.follow_path(space, [[-1.0, 0.0, 0.0]], events="exact")


@pytest.mark.slow
def test_slips_go_on_from_refined_positions() -> None:
    """A body that forces from everywhere hold where its load would carry it a thousand times as far: digits cancel."""
    random = np.random.default_rng(2)
    problem = random_problem(random)
    corners = [random.normal(size=problem.dimension) * np.max(abs(problem.load)) for _ in range(3)]
    history = cq.follow_path(problem, [*corners, corners[0]], steps=1)
    slipping = 0
    for before, solution in pairwise(history):
        position = problem.tangent @ before.displacement
        assert solution.problem.slip_origin.ravel() == pytest.approx(position, rel=1e-14, abs=1e-14)
        slipping += int(np.sum(abs(solution.slip) > 1e-4))
    assert slipping > 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("steps", "bodies", "seed"),
    [(1, 4, 2), (3, 4, 2), *(pytest.param(steps, 12, 5, marks=pytest.mark.slow) for steps in (1, 3, 10))],
)
def test_no_step_and_no_cycle_of_steps_creates_energy(steps: int, bodies: int, seed: int) -> None:
    """However coarse: what the loads do is at least what is stored and dissipated, and in a cycle not negative."""
    random, cycles = np.random.default_rng(seed), 0
    for _ in range(bodies):
        problem = random_problem(random)
        corners = [random.normal(size=problem.dimension) * np.max(abs(problem.load)) for _ in range(3)]
        try:
            history = cq.follow_path(problem, [*corners, corners[0]], steps=steps)
            energies = history.energies[steps:]  # from the first corner on, and back to it
        except cq.ContactQPError:
            continue
        cycles += 1
        size = max(one.elastic for one in energies)
        given = np.diff([one.work for one in energies])
        kept = np.diff([one.elastic + one.dissipated for one in energies])
        assert np.all(given >= kept - 1e-9 * size)
        assert energies[-1].work - energies[0].work >= energies[-1].elastic - energies[0].elastic - 1e-9 * size
    assert cycles >= 2 / 3 * bodies


# K_tt + mu K_nt < 0 above mu = 1/2: pressed by 1 and pulled by mu at t = 1 + mu / 2 it can neither stick nor slide on.
PRESSED_AND_PULLED = [[-1.0, 0.0], [-1.0, 2.0]]


def jumps(history: cq.History) -> list[str]:
    return [note for note in history.notes if "jumps" in note]


@pytest.mark.sampled(6)
@pytest.mark.parametrize(("steps", "shown"), [(1, "2"), (4, "1.5"), (5, "1.6"), (10, "1.5"), (50, "1.42")])
@pytest.mark.parametrize(("friction", "lost"), [(0.8, "1.4"), (0.7, "1.35")])
def test_a_step_across_a_snap(friction: float, lost: str, steps: int, shown: str) -> None:
    history = cq.follow_path(one_contact(KLARBRING, [0.0, 0.0], friction), PRESSED_AND_PULLED, steps=steps)
    found = jumps(history)
    assert len(found) == 1
    assert f"at t = {lost}: no continuation" in found[0]
    assert "contact 0" in found[0]
    when = float(found[0].split("step to t = ")[1].split(":")[0])
    assert when - 1 / steps - 1e-12 <= float(lost) < when + 1e-12
    if friction == 0.8:
        assert found[0].startswith(f"step to t = {shown}: ")
    # What carried a force sticking lets go at once.
    assert history[-1].contact_status.tolist() == ["open"]


@pytest.mark.sampled(3)
@pytest.mark.parametrize("steps", [1, 4, 10])
def test_no_step_jumps_below_the_critical_friction(steps: int) -> None:
    assert cq.follow_path(one_contact(KLARBRING, [0.0, 0.0], 0.4), PRESSED_AND_PULLED, steps=steps).notes == ()


@pytest.mark.sampled(3)
@pytest.mark.parametrize("options", [{}, {"algorithm": "tresca"}, {"method": "lagrange-multiplier"}])
def test_whatever_takes_the_steps(options: dict[str, Any]) -> None:
    history = cq.follow_path(one_contact(KLARBRING, [0.0, 0.0], 0.8), PRESSED_AND_PULLED, steps=4, **options)
    assert [note.split(":")[0] for note in jumps(history)] == ["step to t = 1.5"]


@pytest.mark.slow
def test_on_contact_springs_the_snap_is_that_of_the_bodies_on_them() -> None:
    problem = one_contact(KLARBRING, [0.0, 0.0], 0.8)
    stiff = cq.follow_path(problem, PRESSED_AND_PULLED, steps=4, method="penalty", penalty=1e6)
    assert len(jumps(stiff)) == 1
    assert "no continuation" in jumps(stiff)[0]
    # Springs as soft as these let it slide on: 1 / beta on the diagonal of W raises mu_c to (1 + 1) / 2.
    soft = cq.follow_path(problem, PRESSED_AND_PULLED, steps=4, method="penalty", penalty=1.0)
    assert jumps(soft) == []


def test_a_step_that_chooses() -> None:
    problem = one_contact(KLARBRING, [0.0, 0.0], 0.8)
    unloaded = cq.follow_path(problem, [[-1.0, 0.0], [-1.0, 0.8], [-1.0, 0.0]], steps=4)
    chooses, several = unloaded.notes
    assert chooses.startswith("step to t = 2.25: it chooses; at t = 2: several continuations")
    assert several.startswith("t = 1.75 to 2.25: several equilibria")
    from_rest = cq.follow_path(problem, [[-1.0, 0.65]], steps=1)
    assert from_rest.notes[0].startswith("step to t = 1: it chooses; at t = 0: several")
    assert from_rest.notes[1].startswith("t = 1: several equilibria")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("steps", "seeds"), [(2, 1), *(pytest.param(steps, 3, marks=pytest.mark.slow) for steps in (1, 5))]
)
def test_paths_without_snaps_have_no_notes(steps: int, seeds: int) -> None:
    for seed in range(seeds):
        problem, loads = random_body(seed)
        assert cq.follow_path(problem, loads, steps=steps).notes == ()
    problem, loads = rolling_block(0.3, (8, 3))
    assert cq.follow_path(problem, [*loads, loads[0]], steps=steps).notes == ()
    assert cq.follow_path(two_masses(0.0), [WEIGHTS, pulled(12.0), WEIGHTS], steps=steps).notes == ()
    assert cq.follow_path(two_masses(0.0), [WEIGHTS, pulled(12.0)], events="exact").notes == ()
    assert cq.follow_path(truss_from_rest(0.3).replace(friction=0.0), [[60.0, -100.0]], steps=steps).notes == ()


@pytest.mark.slow
def test_what_falls_and_what_is_anchored_elsewhere_jumps() -> None:
    above = two_masses(0.0).replace(gap=[1e-3, 2e-3])
    (falls,) = cq.follow_path(above, [WEIGHTS], steps=4).notes
    assert falls == "step to t = 0.25: it jumps; the load moves a body that nothing holds"
    (drawn,) = cq.follow_path(two_masses(0.0, (1e-3, 1e-3)), [WEIGHTS], steps=2).notes
    assert drawn.endswith("contact 0 is closed at the start, at E_T u = 0, and slip_origin anchors it at 0.001")


@pytest.mark.parametrize("friction", [0.4, 0.8])
def test_notes_stop_after_their_operations_and_say_so(friction: float, monkeypatch: pytest.MonkeyPatch) -> None:
    history = cq.follow_path(one_contact(KLARBRING, [0.0, 0.0], friction), PRESSED_AND_PULLED, steps=4)
    monkeypatch.setattr(friction_path, "BUDGET", 1.0)
    monkeypatch.setattr(friction_path, "_operations_of_an_event", lambda *_: (1e3, 1.0))
    assert [note for note in history.notes if "several" not in note] == [
        "whether steps after t = 0.25 jump was not examined after 9 operations: events='exact' follows them"
    ]


@pytest.mark.slow
@pytest.mark.parametrize(("seeds", "steps"), [([3], 1), (range(20), 3)])
def test_a_path_in_doubles_has_the_events_and_forces_of_the_exact_one(seeds: Sequence[int], steps: int) -> None:
    for seed in seeds:
        problem, loads = random_body(seed)
        history = cq.follow_path(problem, loads, steps=steps)
        system, compared = ForceSystem(problem, condense(problem)), 0
        for i, (before, now) in enumerate(pairwise(history)):
            part = (history.times[i], history.times[i + 1])
            exact, nothing = friction_path._through(problem, system, before, now, part, refined=True)
            quick, stopped = friction_path._through(problem, system, before, now, part, refined=False)
            if stopped:  # forces that are shared in many ways are followed to the last digits
                assert "not determined" in stopped
                continue
            assert nothing == ""
            assert [one.end for one in quick.segments] == pytest.approx([one.end for one in exact.segments], abs=1e-9)
            assert [one.status.tolist() for one in quick.segments] == [one.status.tolist() for one in exact.segments]
            for values in ("normal_force", "friction_force"):
                size = abs(exact.answer.normal_force).max()
                assert getattr(quick.answer, values) == pytest.approx(getattr(exact.answer, values), abs=1e-9 * size)
            assert quick.keeps_signs()
            pulled = np.where(quick.status == OPEN, 0.0, -1e-6 * size)
            quick.answer = replace(quick.answer, normal_force=pulled)
            assert not quick.keeps_signs() or not pulled.any()
            compared += 1
        assert compared >= steps


@pytest.mark.slow
def test_what_is_not_examined_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    space = cq.ContactProblem(np.eye(3), np.zeros(3), -np.eye(1, 3), [0.0], tangent=np.eye(3)[1:], friction=0.3)
    (note,) = cq.follow_path(space, [[-1.0, 0.0, 0.1]], steps=2).notes
    assert note == "whether steps jump was not examined: two tangential rows a contact"
    problem, loads = rolling_block(0.2, (8, 3))
    history = cq.follow_path(problem, loads, steps=2)
    monkeypatch.setattr(friction_events, "ALL_TRIED", 0)
    monkeypatch.setattr(friction_events, "QUICK_STEPS", 0)
    monkeypatch.setattr(friction_events, "MOST_TRIED", 0)
    assert "step to t = 0.5: whether it jumps was not found out; at t = 0" in history.notes[0]
    monkeypatch.setattr(friction_path, "contacts_are_many", lambda _: True)
    (note,) = cq.follow_path(problem, loads, steps=2).notes
    assert note.endswith("too many contacts")


@pytest.mark.parametrize("size", [1e-4, 1e-10, 1e-14])
def test_a_path_that_begins_small_is_not_measured_by_a_far_seat(size: float) -> None:
    """A tower on springs, its upper half on stiff ones, 1 mm over rough seats and touching rough ones above: what a far
    gap calls rounding is all that the contacts above feel of a small load."""
    height = 16
    points = np.array([(i, j) for j in range(height) for i in (0, 1)], float)
    n, K = 2 * len(points), np.diag(np.where(np.repeat(points_above(points, height / 2), 2), 3e6, 1e3))
    for a in range(len(points)):
        for b in range(a):
            apart = points[a] - points[b]
            if np.hypot(*apart) < 1.5:
                row = np.zeros(n)
                row[2 * a : 2 * a + 2] = apart / np.hypot(*apart)
                row[2 * b : 2 * b + 2] = -row[2 * a : 2 * a + 2]
                K += 1e6 * np.outer(row, row)
    nodes = [0, 1, 2 * height - 2, 2 * height - 1]
    normal, tangent, load = np.zeros((4, n)), np.zeros((4, n)), np.zeros(n)
    normal[[0, 1], [1, 3]], normal[[2, 3], [2 * k + 1 for k in nodes[2:]]] = -1.0, 1.0
    tangent[range(4), [2 * k for k in nodes]] = 1.0
    load[:2] = 2e3, -1e4
    problem = cq.ContactProblem(K, load, normal, [1e-3, 1e-3, 0, 0], tangent=tangent, friction=0.3)
    last = cq.follow_path(problem, [size * load], steps=3)[-1]
    alone = cq.solve(problem.replace(load=size * load))
    assert last.certificate.passed
    assert list(last.contact_status) == list(alone.contact_status)
    assert last.displacement == pytest.approx(alone.displacement, rel=1e-9, abs=1e-12 * np.max(abs(alone.displacement)))


def points_above(points: np.ndarray, height: float) -> np.ndarray:
    return points[:, 1] >= height


def block_pushed_until_it_slides() -> tuple[cq.ContactProblem, list[Any]]:
    """A free block, 5000 N on a floor with mu = 0.3, and loads that push it by 0, 0.75 and 0.9 of 2000 N."""
    mesh, material = cq.rectangle(100.0, 50.0, (20, 10), "quad4"), cq.Material(modulus=210000.0, poisson=0.3)
    structure = cq.Structure([cq.Body(mesh, material, "plane-strain", name="block")])
    floor = cq.pair(structure.surface("block", "bottom"), cq.Plane([0.0, 0.0], [0.0, 1.0]))

    def loaded(load: cq.Traction) -> cq.ContactProblem:
        return structure.assemble([], [load]).problem([floor], friction=0.3)

    problem = loaded(cq.Traction("block", "top", [0.0, -50.0]))
    push = loaded(cq.Traction("block", "left", [40.0, 0.0])).load
    return problem, [problem.load + part * push for part in (0.0, 0.75, 0.9)]


@pytest.mark.slow
@pytest.mark.parametrize("options", [{"steps": 4}, {"events": "exact"}])
def test_beyond_the_sliding_limit_there_is_no_path_and_what_was_is_kept(options: dict[str, Any]) -> None:
    """mu N = 1500 N are reached at the end of the second leg, with too many contacts to try all their combinations."""
    problem, loads = block_pushed_until_it_slides()
    with pytest.raises(cq.NoEquilibrium, match=r"block along x by \+1") as ended:
        cq.follow_path(problem, loads, **options)
    assert ended.value.proof is not None
    history = ended.value.history
    assert isinstance(history, cq.History)
    assert history.times[-1] == 2
    assert history.friction_forces[-1].sum() == pytest.approx(1500.0, rel=1e-9)
    assert all(solution.certificate.passed for solution in history)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", ["active-set", "penalty"])
def test_a_path_without_friction_keeps_what_was_before_it_ended(method: str) -> None:
    """A block that springs hold along x alone is pressed down, and then pulled up."""
    problem = cq.ContactProblem([[1.0, 0.0], [0.0, 0.0]], [0.0, 0.0], [[0.0, -1.0]], [0.0])
    knob = {"penalty": 1e4} if method == "penalty" else {}
    with pytest.raises(cq.NoEquilibrium) as ended:
        cq.follow_path(problem, [[1.0, -1.0], [1.0, 1.0]], steps=2, method=method, **knob)
    assert ended.value.history.times.tolist()[:3] == [0.0, 0.5, 1.0]
    assert ended.value.history.normal_forces[2] == pytest.approx([1.0])
