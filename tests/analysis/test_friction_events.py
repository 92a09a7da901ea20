"""Load paths with Coulomb friction, every event found exactly."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.analysis import friction_events
from contactqp.certificate.uniqueness import FORCES
from tests.analysis.friction_paths import ORDERS, WEIGHTS, pulled, rolling_block, truss_from_rest
from tests.solving.friction.problems import TOUCH, one_contact, two_masses

CLOSING = 458394666339 / 639328600000
KLARBRING = [[1.0, 2.0], [2.0, 5.0]]  # compliance (n, t): above mu = 1/2 rates may have none or several answers


def events(history: cq.History) -> list[tuple[str, int]]:
    return [(event.kind, event.contact) for event in history.events]


def balance(history: cq.History) -> float:
    """Work that is neither stored nor dissipated, relative to the work done."""
    first, last = history.energies[0], history.energies[-1]
    missing = last.work - (last.elastic - first.elastic) - last.dissipated
    return abs(missing) / max(abs(one.work) for one in history.energies)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("steps", [None, 1, 2, 7, 40])
def test_example_2_18_closes_and_slips_at_once(steps: int | None) -> None:
    history = cq.follow_path(truss_from_rest(0.3), [[60.0, -100.0]], events="exact", steps=steps)
    assert events(history) == [("closed", 0), ("slip", 0)]
    assert [event.time for event in history.events] == pytest.approx([CLOSING] * 2, rel=1e-14)
    np.testing.assert_allclose(history[-1].displacement[0], 30058 / 30933965, rtol=1e-12)
    np.testing.assert_allclose(history[-1].normal_force[0], 180933933661 / 6186793000, rtol=1e-12)
    assert all(solution.certificate.passed for solution in history)
    assert len(history) == 2 + (steps or 1)
    assert balance(history) < 1e-14


def test_example_2_17_sticks_where_it_touched() -> None:
    history = cq.follow_path(truss_from_rest(0.8), [[60.0, -100.0]], events="exact")
    assert events(history) == [("closed", 0)]
    np.testing.assert_allclose(history[-1].displacement[0], TOUCH, rtol=1e-15)
    assert history.energies[-1].dissipated == 0.0


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", ORDERS)
def test_the_order_of_loads_decides_the_state(name: str) -> None:
    loads, moved, force, ratio = ORDERS[name]
    history = cq.follow_path(truss_from_rest(0.3), loads, events="exact")
    np.testing.assert_allclose(history[-1].displacement[0], moved, rtol=1e-13)
    np.testing.assert_allclose(history[-1].normal_force[0], force, rtol=1e-13)
    np.testing.assert_allclose(history[-1].friction_force[0, 0], ratio * force, rtol=1e-12, atol=1e-12)
    assert balance(history) < 1e-13


@pytest.mark.slow
def test_example_2_19_loaded_and_unloaded() -> None:
    """mu m2 g = 2.4525 N and mu (m1 + m2) g = 7.3575 N of 12 N; pushed back the second mass slides at 7.095 N."""
    history = cq.follow_path(two_masses(0.0), [WEIGHTS, pulled(12.0), WEIGHTS], events="exact")
    assert events(history) == [
        ("closed", 0),
        ("closed", 1),
        ("slip", 1),
        ("slip", 0),
        ("stick", 0),
        ("stick", 1),
        ("slip", 1),
    ]
    # Mass 2 slides back at 12 - 2 x 2.4525 N.
    wanted = [0.0, 0.0, 1 + 2.4525 / 12, 1 + 7.3575 / 12, 2.0, 2.0, 2 + 4.905 / 12]
    np.testing.assert_allclose([event.time for event in history.events], wanted, rtol=1e-14)
    np.testing.assert_allclose(history[-1].displacement, [4.6425e-3, 7.095e-3, 0, 0], rtol=1e-13, atol=1e-16)
    energies = history.energies[-1]
    np.testing.assert_allclose(
        [energies.work, energies.dissipated, energies.elastic], [0.08875670625, 0.074972925, 0.01378378125], rtol=1e-13
    )


def test_a_snap_is_told_at_its_load() -> None:
    """K_tt + mu K_nt < 0 at mu = 0.8: pressed by 1 and pulled by 0.8 the contact can neither stick nor slide on."""
    pressed_and_pulled = [[-1.0, 0.0], [-1.0, 2.0]]
    stable = cq.follow_path(one_contact(KLARBRING, [0.0, 0.0], 0.4), pressed_and_pulled, events="exact")
    assert events(stable) == [("closed", 0), ("slip", 0), ("opened", 0)]
    np.testing.assert_allclose([event.time for event in stable.events], [0.0, 1.2, 1.25], rtol=1e-14, atol=1e-15)
    with pytest.raises(cq.NoEquilibrium, match=r"t = 1\.4: no continuation.*contact 0"):
        cq.follow_path(one_contact(KLARBRING, [0.0, 0.0], 0.8), pressed_and_pulled, events="exact")


@pytest.mark.parametrize(("more", "error"), [(1e-7, cq.NoEquilibrium), (1e-9, cq.NotConverged), (-1e-9, None)])
def test_what_rounding_may_have_lost_is_not_denied(more: float, error: type[Exception] | None) -> None:
    """Along its cone by so much more than friction holds, where sliding on is no way out."""
    problem = one_contact(KLARBRING, [0.0, 0.0], 0.8)
    pulled_along = [[-1.0, 0.0], [-1.0, 0.8], [-2.0, 1.6 + more]]
    if error is None:
        assert cq.follow_path(problem, pulled_along, events="exact")[-1].contact_status.tolist() == ["stick"]
        return
    with pytest.raises(error, match="t = 2: no continuation"):
        cq.follow_path(problem, pulled_along, events="exact")


def test_several_continuations_are_told_at_their_load() -> None:
    """At the edge of the cone, unloaded, with K_tt + mu K_nt < 0: it may stick or slip on; from rest three ways."""
    problem = one_contact(KLARBRING, [0.0, 0.0], 0.8)
    with pytest.raises(cq.SeveralEquilibria, match=r"t = 2: .*contact 0 stick; contact 0 slip on"):
        cq.follow_path(problem, [[-1.0, 0.0], [-1.0, 0.8], [-1.0, 0.0]], events="exact")
    with pytest.raises(cq.SeveralEquilibria, match=r"t = 0: .*open; .*stick; .*slip on"):
        cq.follow_path(problem, [[-1.0, 0.65]], events="exact")
    back = cq.follow_path(
        one_contact(KLARBRING, [0.0, 0.0], 0.4), [[-1.0, 0.0], [-1.0, 0.4], [-1.0, 0.0]], events="exact"
    )
    assert events(back) == [("closed", 0)]


def test_at_the_critical_friction_there_is_a_continuum_or_nothing() -> None:
    problem = one_contact(KLARBRING, [0.0, 0.0], 0.5)
    with pytest.raises(cq.SeveralEquilibria, match="t = 0"):
        cq.follow_path(problem, [[-1.0, 0.5]], events="exact")
    with pytest.raises(cq.NoEquilibrium, match="t = 2"):
        cq.follow_path(problem, [[-1.0, 0.0], [-1.0, 0.5], [-1.0, 0.6]], events="exact")


def cradle(friction: float = 0.3) -> cq.ContactProblem:
    """A rigid body (x, z, angle) on a spring of 50 to its foot, which stands on the floor; its sides are 0.1 above it.

    Until a side comes down nothing resists its rotation.
    """
    stiffness = np.zeros((4, 4))
    stiffness[np.ix_([1, 3], [1, 3])] = [[50.0, -50.0], [-50.0, 50.0]]
    return cq.ContactProblem(
        stiffness=stiffness,
        load=np.zeros(4),
        normal=[[0.0, 0.0, 0.0, -1.0], [0.0, -1.0, 2.0, 0.0], [0.0, -1.0, -2.0, 0.0]],
        gap=[0.0, 0.1, 0.1],
        tangent=[[1.0, 0.0, 0.0, 0.0]] * 3,
        friction=friction,
        contact_names=["foot", "left", "right"],
    )


@pytest.mark.slow
def test_a_rotation_that_nothing_resists_and_no_load_drives_is_no_other_continuation() -> None:
    """Pressed by 20, both sides come down at 50 x 0.1 = 5 and carry 15; turned by 2 x 15 = 30 of 36 it lifts a side."""
    pressed, turned = np.array([0.0, -20.0, 0.0, 0.0]), np.array([0.0, -20.0, 36.0, 0.0])
    history = cq.follow_path(cradle(), [pressed, turned], events="exact")
    assert [(event.kind, event.name) for event in history.events] == [
        ("closed", "foot"),
        ("closed", "left"),
        ("closed", "right"),
        ("opened", "right"),
    ]
    np.testing.assert_allclose(history[-1].normal_force, [2.0, 18.0, 0.0], rtol=1e-13)
    np.testing.assert_allclose([event.time for event in history.events], [0.0, 0.25, 0.25, 1 + 30 / 36], atol=1e-14)
    assert [len(solution.free_motions) for solution in history][1:] == [1, 0, 0, 0]
    assert all(solution.certificate.passed for solution in history)
    assert balance(history) < 1e-14
    with pytest.raises(cq.Unsupported, match=r"the load moves a body that nothing holds.*\(at t = 0\)"):
        cq.follow_path(cradle(), [turned], events="exact")


def test_no_continuation_is_listed_twice() -> None:
    """At the critical friction and the edge of the cone it sticks, or slips at any rate."""
    loads = [[-1.0, 0.0], [-1.0, 0.5], [-2.0, 1.0]]
    with pytest.raises(cq.SeveralEquilibria, match=r"\(contact 0 stick; contact 0 slip on at any rate\)"):
        cq.follow_path(one_contact(KLARBRING, [0.0, 0.0], 0.5), loads, events="exact")


def test_contacts_that_change_together() -> None:
    """Two equal sliders, not coupled: both close, slip, stick and slip back at once."""
    one = one_contact([[1.0, 0.2], [0.2, 1.0]], [0.0, 0.0], 0.3)
    both = cq.ContactProblem(
        stiffness=np.kron(np.eye(2), one.stiffness),
        load=np.zeros(4),
        normal=np.kron(np.eye(2), one.normal.toarray()),
        gap=[0.1, 0.1],
        tangent=np.kron(np.eye(2), one.tangent.toarray()),
        friction=0.3,
    )
    loads = [np.tile(load, 2) for load in ([-1.0, 0.0], [-1.0, 1.0], [-1.0, -1.0])]
    history = cq.follow_path(both, loads, events="exact")
    kinds = [kind for kind, _ in events(history)]
    assert kinds[::2] == kinds[1::2] == ["closed", "slip", "stick", "slip"]
    times = [event.time for event in history.events]
    np.testing.assert_allclose(times[::2], times[1::2], rtol=1e-13)
    assert balance(history) < 1e-13


def test_many_masses_that_float_come_to_rest_on_the_floor_at_once() -> None:
    """Masses that only springs of the x axis hold, pressed by 1 to 9 and pulled each by 2: mu = 1/4 holds the last two.

    At rest all are open, and the load drives every one of them; 4^9 choices are too many to try.
    """
    m = 9
    weight, spring = np.arange(1.0, m + 1), np.linspace(1.0, 2.0, m)
    rows = np.eye(2 * m)
    masses = cq.ContactProblem(
        stiffness=np.diag(np.column_stack([spring, np.zeros(m)]).ravel()), load=np.zeros(2 * m), normal=-rows[1::2],
        gap=np.zeros(m), tangent=rows[::2], friction=0.25,
    )  # fmt: skip
    pressed = np.column_stack([np.zeros(m), -weight]).ravel()
    pulled_aside = np.column_stack([np.full(m, 2.0), -weight]).ravel()
    last = cq.follow_path(masses, [pressed, pulled_aside], events="exact")[-1]
    np.testing.assert_allclose(last.normal_force, weight, rtol=1e-14)
    held = np.minimum(weight / 4, 2.0)
    np.testing.assert_allclose(last.friction_force[:, 0], held, rtol=1e-14)
    np.testing.assert_allclose(last.displacement[::2], (2.0 - held) / spring, rtol=1e-13, atol=1e-15)
    assert last.certificate.passed


def test_of_masses_on_each_other_those_that_float_come_to_rest_and_those_on_springs_lift_off() -> None:
    """Even masses touch the floor, odd ones the mass before them; 1 and 3 are lifted, on springs of 2 along z."""
    m, load = 7, np.array([-1.0, 2.0, -1.0, 1.0, -1.0, -1.5, -2.0])
    upright = np.array([2.0, 2.0, 0.0, 2.0, 0.0, 0.0, 0.0])
    normal, tangent = -np.eye(2 * m)[1::2], np.eye(2 * m)[::2]
    for odd in range(1, m, 2):
        normal[odd, 2 * odd - 1], tangent[odd, 2 * odd - 2] = 1.0, -1.0
    masses = cq.ContactProblem(
        stiffness=np.diag(np.column_stack([np.ones(m), upright]).ravel()), load=np.zeros(2 * m), normal=normal,
        gap=np.zeros(m), tangent=tangent, friction=0.5,
    )  # fmt: skip
    last = cq.follow_path(masses, [np.column_stack([np.zeros(m), load]).ravel()], events="exact")[-1]
    np.testing.assert_allclose(last.normal_force, [1.0, 0.0, 1.0, 0.0, 2.5, 1.5, 2.0], rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(last.displacement[1::2], [0.0, 1.0, 0.0, 0.5, 0.0, 0.0, 0.0], rtol=1e-14, atol=1e-15)
    assert last.certificate.passed


@pytest.mark.slow
def test_redundant_contacts_and_contacts_without_friction() -> None:
    twice = truss_from_rest(0.3).replace(load=[0.0, 0.0])
    twice = cq.ContactProblem(
        stiffness=twice.stiffness,
        load=twice.load,
        normal=[[0.0, -1.0]] * 2,
        gap=[1e-3] * 2,
        tangent=[[1.0, 0.0]] * 2,
        friction=0.3,
    )
    history = cq.follow_path(twice, [[60.0, -100.0]], events="exact")
    np.testing.assert_allclose(history[-1].displacement[0], 30058 / 30933965, rtol=1e-12)
    np.testing.assert_allclose(history[-1].normal_force.sum(), 180933933661 / 6186793000, rtol=1e-12)
    half = cq.follow_path(two_masses(0.0).replace(friction=[0.25, 0.0]), [WEIGHTS, pulled(12.0)], events="exact")
    assert events(half) == [("closed", 0), ("closed", 1), ("slip", 0)]
    assert half.events[-1].time == pytest.approx(1 + 4.905 / 12, rel=1e-14)


def random_body(seed: int) -> tuple[cq.ContactProblem, list[np.ndarray]]:
    """One to four coupled contacts, some with gaps, mu below what their coupling makes critical; a closed cycle."""
    rng = np.random.default_rng(seed)
    m = int(rng.integers(1, 5))
    n = 2 * m + 2
    shape = 0.3 * rng.normal(size=(n, n))
    problem = cq.ContactProblem(
        stiffness=shape @ shape.T + np.diag(rng.uniform(1, 3, n)),
        load=np.zeros(n),
        normal=-np.eye(2 * m, n)[::2],
        gap=rng.uniform(0, 0.3, m) * (rng.random(m) < 0.7),
        tangent=np.eye(2 * m, n)[1::2],
        friction=rng.uniform(0.05, 0.6, m),
    )
    corners = [1.5 * rng.normal(size=n) for _ in range(3)]
    return problem, [*corners, corners[0], np.zeros(n)]


@pytest.mark.sampled(12)
@pytest.mark.parametrize("seed", range(12))
def test_cycles_of_random_bodies_balance_their_energy(seed: int) -> None:
    problem, loads = random_body(seed)
    history = cq.follow_path(problem, loads, events="exact")
    dissipated = np.array([one.dissipated for one in history.energies])
    assert np.all(np.diff(dissipated) >= 0)
    assert balance(history) < 1e-12
    assert all(solution.certificate.passed for solution in history)
    assert history.energies[-1].work > -1e-12 * max(one.work for one in history.energies)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 6))])
def test_many_steps_come_to_the_same(seed: int) -> None:
    problem, loads = random_body(seed)
    exact = cq.follow_path(problem, loads, events="exact")
    at_corner = {time: solution for time, solution in zip(exact.times.tolist(), exact, strict=True)}
    errors = []
    for count in (25, 400):
        steps = cq.follow_path(problem, loads, steps=count)
        off = [steps[count * leg].displacement - at_corner[float(leg)].displacement for leg in range(1, len(loads) + 1)]
        errors.append(np.max(np.abs(off)) / np.max(np.abs(exact.displacements)))
    assert errors[1] < 5e-3
    assert errors[1] < 0.3 * errors[0] + 1e-12


@pytest.mark.slow
def test_steps_leave_work_unexplained_where_exact_events_do_not() -> None:
    """The balance is a check that can fail: five steps a leg miss the kinks."""
    problem, loads = random_body(1)
    assert balance(cq.follow_path(problem, loads, steps=5)) > 1e-3
    assert balance(cq.follow_path(problem, loads, events="exact")) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.4, pytest.param(0.05, marks=pytest.mark.slow)])
def test_a_block_pressed_and_pushed(friction: float) -> None:
    problem, loads = rolling_block(friction)
    exact = cq.follow_path(problem, [*loads, loads[0]], events="exact")
    assert balance(exact) < 1e-11
    assert {event.kind for event in exact.events} >= {"closed", "slip", "stick"}
    steps = cq.follow_path(problem, [*loads, loads[0]], steps=200)
    size = np.max(abs(exact[-1].displacement))
    np.testing.assert_allclose(steps[-1].displacement, exact[-1].displacement, atol=2e-3 * size)
    first = {}
    for event in exact.events:
        first.setdefault((event.kind, event.contact), event.time)
    closings = [event for event in steps.events if event.kind == "closed" and event.time < 1]
    assert closings
    for event in closings:
        assert -0.01 < event.time - first[event.kind, event.contact] < 0.01


@pytest.mark.slow
def test_the_quick_search_and_all_combinations_choose_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, loads = rolling_block(0.2, (8, 3))
    monkeypatch.setattr(friction_events, "ALL_TRIED", 4096)
    every = cq.follow_path(problem, loads, events="exact")
    monkeypatch.setattr(friction_events, "ALL_TRIED", 0)
    quick = cq.follow_path(problem, loads, events="exact")
    assert events(every) == events(quick)
    np.testing.assert_allclose(quick[-1].displacement, every[-1].displacement, rtol=1e-9, atol=1e-15)
    monkeypatch.setattr(friction_events, "QUICK_STEPS", 0)
    monkeypatch.setattr(friction_events, "MOST_TRIED", 0)
    with pytest.raises(cq.NotConverged, match="undecided"):
        cq.follow_path(problem, loads, events="exact")


@pytest.mark.slow
def test_forces_that_are_not_unique_go_on_from_where_they_are() -> None:
    """Two unknowns held by a tie, a floor and friction: what carries what is open, and follows the load steadily."""
    problem = cq.ContactProblem(
        stiffness=[[2.0, 0.3], [0.3, 1.5]],
        load=[0.0, 0.0],
        normal=[[0.0, -1.0]],
        gap=[0.1],
        tangent=[[1.0, 0.0]],
        friction=0.7,
        tie=[[1.0, 0.4]],
    )
    history = cq.follow_path(problem, [[0.3, -1.0], [-0.2, -0.6], [0.4, 0.5]], events="exact")
    assert all(solution.certificate.passed for solution in history)
    assert history.events[0].kind == "closed"
    assert balance(history) < 1e-13


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [range(1), pytest.param(range(4), marks=pytest.mark.slow)], ids=["one", "four"])
@pytest.mark.parametrize("options", [{"steps": 9}, {"events": "exact"}])
def test_units_and_the_scale_of_rows_change_nothing(options: dict[str, object], seeds: range) -> None:
    """u = d v unknown by unknown, forces times F, lengths times L, the rows of contact i times r_i."""
    rng = np.random.default_rng(3)
    for seed in seeds:
        problem, loads = random_body(seed)
        length, force = 10.0 ** rng.uniform(-6, 6), 10.0 ** rng.uniform(-9, 9)
        d, r = 10.0 ** rng.uniform(-3, 3, problem.dimension), 10.0 ** rng.uniform(-3, 3, problem.contacts)
        other = cq.ContactProblem(
            stiffness=problem.stiffness * np.outer(d, d) * force / length,
            load=problem.load,
            normal=problem.normal.toarray() * d * r[:, None],
            gap=problem.gap * length * r,
            tangent=problem.tangent.toarray() * d * r[:, None],
            friction=problem.friction,
        )
        one = cq.follow_path(problem, loads, **options)
        scaled = cq.follow_path(other, [load * d * force for load in loads], **options)
        assert one.events
        assert events(scaled) == events(one)
        np.testing.assert_allclose([e.time for e in scaled.events], [e.time for e in one.events], rtol=1e-10)
        size = np.max(abs(one.displacements))
        np.testing.assert_allclose(scaled.displacements * d / length, one.displacements, atol=1e-9 * size)
        dissipated = one.energies[-1].dissipated
        np.testing.assert_allclose(scaled.energies[-1].dissipated, dissipated * force * length, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("push", [0.1, 0.0])
def test_a_loose_body_that_the_load_sets_going_jumps_as_it_does_without_friction(push: float) -> None:
    """A block 0.1 above the floor falls at once: steps find it there, and no choice at a contact is to blame."""
    block = cq.ContactProblem(np.zeros((2, 2)), [0.0, 0.0], [[0.0, -1.0]], [0.1], [[1.0, 0.0]], friction=0.3)
    with pytest.raises(cq.Unsupported, match="the load moves a body that nothing holds; give steps instead"):
        cq.follow_path(block, [[push, -1.0]], events="exact")
    assert cq.follow_path(block, [[push, -1.0]], steps=2)[-1].gap == pytest.approx([0.0], abs=1e-15)
    with pytest.raises(cq.NoEquilibrium, match=r"^follow_path: at t = 1: the load drives .* unknown 1 by \+1") as ended:
        cq.follow_path(block, [[push, 1.0]], events="exact")
    assert ended.value.proof is not None


def node_on_a_guide(friction: float) -> cq.ContactProblem:
    """A node above a floor on a guide of 45 degrees, u_x + u_z = 0: where it is closed it does not move."""
    return cq.ContactProblem(
        stiffness=2 * np.eye(2), load=[0.0, 0.0], normal=[[0.0, -1.0]], gap=[0.0], tangent=[[1.0, 0.0]],
        friction=friction, tie=[[1.0, 1.0]], tie_value=[0.0],
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.5, 0.9, 0.999999])
@pytest.mark.parametrize("options", [{"events": "exact"}, {"steps": 60}, {"steps": 7}])
def test_a_node_that_comes_back_to_its_wedge_sticks_in_it(options: dict[str, Any], friction: float) -> None:
    """N + T = 3 with |T| <= mu N: the slip origin is rounding, so that the sign of the slip is, too."""
    history = cq.follow_path(node_on_a_guide(friction), [[1.0, -3.0], [-1.0, 1.0], [2.0, -1.0]], **options)
    last = history[-1]
    assert FORCES in last.certificate.uniqueness
    assert last.contact_status == ["stick"]
    assert not cq.certify(last.problem, last).proven
    assert last.normal_force + last.friction_force[:, 0] == pytest.approx([3.0], rel=1e-9)
    assert abs(last.friction_force[0, 0]) <= friction * last.normal_force[0] * (1 + 1e-9)


@pytest.mark.sampled(6)
@pytest.mark.parametrize("friction", [0.3, 0.5, 0.9])
@pytest.mark.parametrize("options", [{"events": "exact"}, {"steps": 7}])
def test_a_ball_comes_back_to_its_groove(options: dict[str, Any], friction: float) -> None:
    c = 0.5**0.5
    problem = cq.ContactProblem(
        stiffness=[[2.0, 0.3], [0.3, 2.0]], load=[0.0, 0.0], normal=[[-c, -c], [c, -c]], gap=[0.0, 0.0],
        tangent=[[c, -c], [c, c]], friction=friction,
    )  # fmt: skip
    last = cq.follow_path(problem, [[0.3, -10.0], [0.2, 10.0], [0.1, -10.0]], **options)[-1]
    assert last.certificate.passed
    assert list(last.contact_status) == ["stick", "stick"]
    assert FORCES in last.certificate.uniqueness
    np.testing.assert_allclose(last.displacement, 0.0, atol=1e-15)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("loads", "opened"), [([[3.0, -1.0], [-3.0, 3.0]], 1.4), ([[0.0, -2.0], [-3.0, 1.0]], 4 / 3)])
def test_a_wedged_node_is_lifted_off_at_the_load_that_pulls_it(loads: list[list[float]], opened: float) -> None:
    """With mu = 1 the floor and the guide may wedge each other with any force, which holds the node against nothing."""
    history = cq.follow_path(node_on_a_guide(1.0), loads, events="exact")
    assert [event.time for event in history.events if event.kind == "opened"] == [pytest.approx(opened)]
    assert all(solution.certificate.passed for solution in history)
    pull = (loads[-1][0] - loads[-1][1]) / 4
    np.testing.assert_allclose(history[-1].displacement, [pull, -pull], rtol=1e-12)
    assert history[-1].contact_status == ["open"]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("options", [{"events": "exact"}, {"steps": 7}])
def test_no_rounded_slip_origin_denies_an_equilibrium(options: dict[str, Any]) -> None:
    """With mu = 1 a slip origin of +1e-17 has no equilibrium in rational numbers, and one of -1e-17 has."""
    last = cq.follow_path(node_on_a_guide(1.0), [[1.0, -3.0], [-1.0, 1.0], [2.0, -1.0]], **options)[-1]
    assert last.certificate.passed
    assert FORCES in last.certificate.uniqueness
    assert last.normal_force + last.friction_force[:, 0] == pytest.approx([3.0])
