"""Paths through limit points: von Mises' truss by arc length and by displacement, with and without obstacles.

Random lattices over a floor and a ball are checked by the conditions of an equilibrium, written out here.
"""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from scipy.optimize import minimize

import contactqp as cq
from contactqp.errors import InvalidProblem, NotConverged, Unsupported
from tests.analysis.arches import RISE, arch, arch_limit, arch_load, node_over, orders
from tests.analysis.lattices import lattice

DOWN = [[0.0, -1.0]]
BY_ARC = dict(control="arc-length", steps=40, arc_length=0.02)
BY_NODE = dict(control="displacement", controlled=1, target=-0.5, steps=25)


@pytest.mark.slow
@pytest.mark.parametrize("how", [BY_NODE, BY_ARC], ids=["displacement", "arc length"])
def test_von_mises_truss_follows_its_closed_form_through_both_limits(how):
    history = cq.large_deformation(arch(), DOWN, **how)
    w = -history.displacements[:, 1]
    assert w[-1] > 2.3 * RISE
    np.testing.assert_allclose(history.times, arch_load(w), rtol=0, atol=1e-10 * arch_limit()[0])
    limit, place = arch_limit()
    first, second = history.limit_points
    assert (first.kind, second.kind) == ("maximum", "minimum")
    assert first.load_factor == pytest.approx(limit, rel=1e-10)
    assert -first.displacement[1] == pytest.approx(place, rel=1e-10)
    assert second.load_factor == pytest.approx(-limit, rel=1e-10)
    assert -second.displacement[1] == pytest.approx(2 * RISE - place, rel=1e-10)
    size = 100 * RISE**3 / (1 + RISE**2) ** 1.5
    assert abs(first.load_factor / size - 16 / 27) > 0.2, "the limit of the force that the course chapter prints"
    assert first.smooth
    assert w[first.after] < place < w[first.after + 1]
    between = (w > place) & (w < 2 * RISE - place)
    np.testing.assert_array_equal(history.stable, ~between)
    assert all(solution.certificate.passed for solution in history)
    assert history.notes == ()


@pytest.mark.slow
def test_the_path_converges_quadratically():
    history = cq.large_deformation(arch(), DOWN, **(BY_ARC | dict(arc_length=0.1, steps=6)))
    found = [orders(iterations)[-1] for iterations in history.iterations if len(orders(iterations))]
    assert len(found) >= 3  # other steps are too short to tell
    assert min(found) > 1.8


def test_load_displacement_and_arc_length_meet():
    by_load = cq.large_deformation(arch(), [[0.0, -0.28]], steps=4)
    by_node = cq.large_deformation(
        arch(), DOWN, control="displacement", controlled=1, target=by_load[-1].displacement[1], steps=3
    )
    assert by_node.times[-1] == pytest.approx(0.28, rel=1e-12)
    np.testing.assert_allclose(by_node[-1].displacement, by_load[-1].displacement, atol=1e-14)


@pytest.mark.slow
def test_the_default_arc_length_comes_to_the_load_where_nothing_softens():
    history = cq.large_deformation(arch(), [[0.0, 1e-6]], control="arc-length", steps=10)
    np.testing.assert_allclose(history.times, np.linspace(0, 1, 11), rtol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("height", [0.05, -0.05])
def test_snapping_onto_a_floor_turns_the_load_at_a_corner(height):
    """On its falling branch the node meets the floor: the load falls no more, and the floor carries what rises."""
    floor = node_over(cq.Plane([0.0, height], [0.0, 1.0]))
    history = cq.large_deformation(arch(), DOWN, floor, control="arc-length", steps=40, arc_length=0.03)
    w = RISE - height
    smooth, corner = history.limit_points
    assert (corner.kind, corner.smooth) == ("minimum", False)
    assert corner.load_factor == pytest.approx(arch_load(w), rel=1e-12)
    assert smooth.load_factor == pytest.approx(arch_limit()[0], rel=1e-12)
    ((kind, time),) = [(event.kind, event.time) for event in history.events]
    assert (kind, time) == ("closed", corner.load_factor)
    resting = history.normal_forces[:, 0] > 0
    assert resting[-1]
    np.testing.assert_allclose(history.normal_forces[resting, 0], history.times[resting] - arch_load(w), atol=1e-13)
    np.testing.assert_allclose(history.displacements[resting, 1], -w, atol=1e-15)
    assert np.all(np.diff(history.times[resting]) > 0)
    assert history.stable[resting].all()
    assert history.notes == ()


@pytest.mark.slow
def test_drawn_back_up_the_contact_opens():
    """A node that rests on a ceiling is drawn off it by a load that falls from there."""
    ceiling = node_over(cq.Plane([0.0, RISE + 0.05], [0.0, -1.0]))
    pressed = cq.large_deformation(arch(), [[0.0, 3.0]], ceiling, steps=3)[-1]
    assert pressed.normal_force[0] == pytest.approx(3.0 + arch_load(-0.05), rel=1e-12)
    back = dataclasses.replace(pressed, load_rate=-1.0)
    history = cq.large_deformation(
        arch(), [[0.0, 3.0]], ceiling, control="arc-length", steps=12, arc_length=0.05, start=back
    )
    ((kind, time),) = [(event.kind, event.time) for event in history.events]
    assert kind == "opened"
    assert time == pytest.approx(-arch_load(-0.05) / 3.0, rel=1e-12)
    w = -history.displacements[-1, 1]
    assert history.times[-1] * 3.0 == pytest.approx(-arch_load(w), rel=1e-10)


@pytest.mark.slow
def test_a_floor_in_the_way_ends_displacement_control_with_the_history_so_far():
    floor = node_over(cq.Plane([0.0, 0.05], [0.0, 1.0]))
    with pytest.raises(NotConverged, match="unknown 1 can go no further") as failure:
        cq.large_deformation(arch(), DOWN, floor, **BY_NODE)
    so_far = failure.value.history
    assert so_far[-1].displacement[1] == pytest.approx(-0.15, abs=1e-14)
    assert so_far.times[-1] == pytest.approx(arch_load(0.15), rel=1e-12)


@pytest.mark.slow
def test_a_round_obstacle_is_followed_past_its_side():
    """The node slides along a ball as the load rises: unstable on its top, bent aside."""
    ball = cq.Circle([0.02, -0.9], 1.0)
    history = cq.large_deformation(
        arch(), [[0.02, -1.0]], node_over(ball), control="arc-length", steps=20, arc_length=0.03
    )
    last = history[-1]
    x = np.array([0.0, RISE]) + last.displacement
    n = (x - [0.02, -0.9]) / np.linalg.norm(x - [0.02, -0.9])
    assert np.linalg.norm(x - [0.02, -0.9]) == pytest.approx(1, abs=1e-14)
    balance = last.load - arch().internal_force(last.displacement) + last.normal_force[0] * n
    np.testing.assert_allclose(balance, 0, atol=1e-12)
    assert [event.kind for event in history.events] == ["closed"]


@pytest.mark.slow
def test_bifurcations_on_the_way_are_told():
    """A steep arch sways before it snaps: K_xx vanishes at w = h - sqrt(L0^2 - 2 - 1)."""
    rise = 2.0
    history = cq.large_deformation(arch(rise), DOWN, control="arc-length", steps=40, arc_length=0.15)
    w = rise - np.sqrt(rise**2 + 1 - 3)
    load = arch_load(w, rise)
    first, second = history.notes
    a, b = (float(number) for number in first.split("factors ")[1].split(" other")[0].split(" and "))
    assert a < load < b
    assert "branch off" in second
    assert -history.displacements[:, 1].min() > 2 * rise
    np.testing.assert_allclose(history.times, arch_load(-history.displacements[:, 1], rise), atol=1e-11)


@pytest.mark.slow
def test_a_path_that_turns_sharply_goes_on_and_not_back():
    """Of a flat arch whose load counts for much in the length of an arc the limit is a needle in (u, t)."""
    steep = dict(control="arc-length", steps=30, arc_length=0.3)
    start = cq.large_deformation(arch(), DOWN, steps=1, start=None, control="arc-length", arc_length=1e-3)[0]
    start = dataclasses.replace(start, load_scale=3.0)
    history = cq.large_deformation(arch(), DOWN, start=start, **steep)
    w = -history.displacements[:, 1]
    assert np.all(np.diff(w) > 0)
    assert [limit.kind for limit in history.limit_points] == ["maximum", "minimum"]
    assert history.limit_points[0].load_factor == pytest.approx(arch_limit()[0], rel=1e-10)


@pytest.mark.slow
def test_arcs_in_space_with_many_bars():
    """A shallow dome of eight bars under its apex: eight halves of von Mises' truss."""
    angle = np.arange(8) * np.pi / 4
    nodes = np.vstack([np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1), [[0, 0, RISE]]])
    dome = cq.NonlinearTruss(nodes, [[i, 8] for i in range(8)], 25.0, 1.0)
    body = cq.Supported(dome, held=list(range(24)))
    history = cq.large_deformation(body, [[0, 0, -1.0]], control="arc-length", steps=30, arc_length=0.02)
    np.testing.assert_allclose(history.times, arch_load(-history.displacements[:, 2]), atol=1e-12)
    assert history.limit_points[0].load_factor == pytest.approx(arch_limit()[0], rel=1e-10)


@pytest.mark.slow
def test_a_path_is_resumed_where_it_broke_off():
    whole = cq.large_deformation(arch(), DOWN, **BY_ARC)
    half = cq.large_deformation(arch(), DOWN, **(BY_ARC | dict(steps=10)))
    assert half[-1].load_rate < 0
    rest = cq.large_deformation(arch(), DOWN, **(BY_ARC | dict(steps=30, start=half[-1])))
    np.testing.assert_allclose(rest.displacements, whole.displacements[10:], atol=1e-12)
    assert [limit.kind for limit in rest.limit_points] == ["minimum"]


@pytest.mark.slow
def test_work_and_energy_agree_along_a_path_without_jumps():
    history = cq.large_deformation(arch(), DOWN, **(BY_NODE | dict(steps=200)))
    for energies in history.energies[::50]:
        assert energies.work == pytest.approx(energies.elastic, abs=1e-5)
    assert history.energies[-1].elastic > 1e-2


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (dict(method="clarabel"), Unsupported, "unstable equilibria"),
        (dict(friction=0.3), Unsupported, "with friction"),
        (dict(loads=[[0, 1.0], [0, 2.0]]), InvalidProblem, "takes one load, got 2"),
        (dict(controlled=2), InvalidProblem, "controlled: expected a place from 0 to 1"),
        (dict(target=None), InvalidProblem, "target"),
        (dict(arc_length=0.1), InvalidProblem, "arc_length: 'displacement' control has none"),
        (dict(control="load"), InvalidProblem, "controlled: 'load' control has none"),
        (dict(control="arc-length", controlled=None, target=None, arc_length=-1.0), InvalidProblem, "positive length"),
    ],
)
def test_bad_arguments_are_refused(change, error, message):
    floor = node_over(cq.Plane([0.0, -9.0], [0.0, 1.0]))
    with pytest.raises(error, match=message):
        cq.large_deformation(arch(), **(dict(loads=DOWN, contact=floor) | BY_NODE | change))


@pytest.mark.parametrize("how", [BY_NODE, BY_ARC], ids=["displacement", "arc length"])
def test_coefficients_of_zero_are_no_friction_on_a_path_through_limits(how):
    floor = node_over(cq.Plane([0.0, -0.1], [0.0, 1.0]))
    how = how | (dict(target=-0.3, steps=10) if how is BY_NODE else {})
    smooth, zero = (cq.large_deformation(arch(), DOWN, floor, friction=mu, **how) for mu in (None, 0.0))
    np.testing.assert_array_equal(zero.displacements, smooth.displacements)
    assert zero.limit_points[0].load_factor == smooth.limit_points[0].load_factor
    assert zero[-1].friction_force.tolist() == zero[-1].slip.tolist() == [[0.0]]
    np.testing.assert_array_equal(zero.normal_forces, smooth.normal_forces)
    assert zero[-1].certificate.passed


def conditions(body, contact, load, solution):
    """The largest violation: balance over the largest load, overlap, tension, force without contact."""
    u, force = solution.displacement, solution.normal_force
    state = contact.state(u)
    balance = load - body.internal_force(u) - state.normal.T @ force
    return max(
        np.abs(balance).max() / np.abs(load).max(), -state.gap.min(), -force.min(), np.abs(state.gap * force).max()
    )


@cache
def loaded(seed):
    """A lattice, what is in its way, its load, and its path to there."""
    body, contact, load = lattice(seed)
    return body, contact, load, cq.large_deformation(body, [load], contact, steps=5)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 4, 7, 24])
def test_lattices_come_to_rest_on_what_is_in_their_way(seed):
    """7 starts with an overlap; 24 snaps, a long way."""
    body, contact, load, history = loaded(seed)
    last = history[-1]
    assert conditions(body, contact, load, last) < 1e-10
    assert last.normal_force.max() > 1e-3
    assert history.stable[-1]
    assert conditions(body, contact, 1.01 * load, last) > 1e-3, "the answer to another load"


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 4])
def test_scipys_slsqp_finds_no_lower_energy_nearby(seed):
    body, contact, load, history = loaded(seed)
    last = history[-1]
    random = np.random.default_rng(seed)
    found = minimize(
        lambda u: body.energy(u) - load @ u,
        last.displacement + 1e-3 * random.uniform(-1, 1, len(load)),
        jac=lambda u: body.internal_force(u) - load,
        constraints=dict(
            type="ineq",
            fun=lambda u: contact.state(u).gap,
            jac=lambda u: -contact.state(u).normal.toarray(),
        ),
        method="SLSQP",
        options=dict(ftol=1e-14, maxiter=500),
    )
    np.testing.assert_allclose(found.x, last.displacement, atol=1e-5)
    assert found.fun == pytest.approx(last.energy, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 4, 7])
def test_arc_length_meets_load_control_where_nothing_snaps(seed):
    body, contact, load, by_load = loaded(seed)
    assert not by_load.notes
    path = cq.large_deformation(body, [load], contact, control="arc-length", steps=25)
    assert len(path) > 1
    assert all(conditions(body, contact, t * load, at) < 1e-10 for t, at in zip(path.times[1:], path[1:], strict=True))
    k = int(np.searchsorted(path.times, 1))
    np.testing.assert_array_equal(path[k].normal_force > 0, by_load[-1].normal_force > 0)
    a, b = path.times[k - 1], path.times[k]
    between = path.displacements[k - 1] + (1 - a) / (b - a) * (path.displacements[k] - path.displacements[k - 1])
    np.testing.assert_allclose(between, by_load[-1].displacement, atol=2e-2 * np.abs(between).max())


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3])
def test_a_snap_under_load_is_a_limit_point_of_the_path(seed):
    body, contact, load, history = loaded(seed)
    note = history.notes[0]
    told = [float(number.strip(":")) for number in note.split("jumps")[0].split() if number[:2] == "0."]
    path = cq.large_deformation(body, [load], contact, control="arc-length", steps=30)
    limit = path.limit_points[0]
    assert (limit.kind, limit.smooth) == ("maximum", True)
    assert limit.load_factor == pytest.approx(told[-1], rel=2e-3)
    assert limit.load_factor <= told[-1]


@pytest.mark.slow
@pytest.mark.parametrize(("length", "force"), [(2.0**300, 2.0**-400), (2.0**-300, 2.0**300)])
@pytest.mark.parametrize("control", ["arc-length", "load"])
def test_units_of_any_size_change_no_digit_of_a_path(length, force, control):
    """Displacements beyond 1e50 were those of a torn bar, and entries of 1e-200 beside rows of 1 an OverflowError."""

    def path(length, force):
        points = np.array([[-1, 0], [0, 0.25], [1, 0]]) * length
        truss = cq.NonlinearTruss(points, [[0, 1], [1, 2]], modulus=100.0 * force, area=1.0)
        floor = cq.ObstacleContact([[0.0, 0.25 * length]], cq.Plane([0.0, -0.125 * length], [0.0, 1.0]))
        by = dict(steps=6, arc_length=0.125 * length) if control == "arc-length" else dict(steps=2)
        body = cq.Supported(truss, held=[0, 1, 4, 5])
        return cq.large_deformation(body, [[0.0, -force]], floor, control=control, **by)

    near_one, far = path(1.0, 1.0), path(length, force)
    assert [event.kind for event in near_one.events] == ["closed"]
    np.testing.assert_allclose(far.displacements / length, near_one.displacements, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(far.normal_forces / force, near_one.normal_forces, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose([e.time for e in far.events], [e.time for e in near_one.events], rtol=1e-12)
    factors = [[limit.load_factor for limit in history.limit_points] for history in (far, near_one)]
    np.testing.assert_allclose(*factors, rtol=1e-11)
