"""Newton's method with contact at large displacements, under load control."""

import pickle
from functools import cache

import numpy as np
import pytest
from scipy.optimize import brentq

import contactqp as cq
from contactqp.analysis.large.deformation import LargeHistory
from contactqp.elements.material import Material
from contactqp.elements.shapes import box
from contactqp.elements.solid import Body
from contactqp.errors import InvalidProblem, NotConverged, Unsupported
from tests.analysis.arches import RISE, arch, arch_limit, arch_load, node_over, orders

FLOOR = cq.Plane([0.0, -0.1], [0.0, 1.0])
DOWN = np.array([0.0, -1.0])
EXACT = ("active-set", "clarabel", "osqp", "lemke", "master-slave", "lagrange-multiplier", "augmented-lagrangian")


@pytest.mark.slow
def test_the_path_before_the_limit_is_the_closed_form():
    history = cq.large_deformation(arch(), [0.28 * DOWN], steps=14)
    w = -history.displacements[:, 1]
    np.testing.assert_allclose(arch_load(w), 0.28 * history.times, atol=1e-14)
    assert np.all(np.diff(w) > 0)
    assert history.stable.all()
    assert history.notes == ()
    assert all(solution.certificate.passed for solution in history)


def test_newtons_method_converges_quadratically():
    history = cq.large_deformation(arch(), [0.28 * DOWN], steps=2)
    assert len(history.iterations) == 3  # the start and two steps
    for iterations in history.iterations[1:]:
        assert len(orders(iterations)) >= 2
        assert orders(iterations)[-1] > 1.8


@pytest.mark.sampled(7)
@pytest.mark.parametrize("method", EXACT)
def test_every_method_takes_the_steps(method):
    """The node is pressed onto a floor at 0.18: u_y = -0.02, and u_x and the force follow from balance."""
    floor, load = cq.Plane([0.0, 0.18], [0.0, 1.0]), np.array([0.05, -0.29])
    history = cq.large_deformation(arch(), [load], node_over(floor), steps=3, method=method)
    last = history[-1]
    assert last.displacement[1] == pytest.approx(-0.02, abs=1e-16)
    out_of_balance = load - arch().internal_force(last.displacement)
    np.testing.assert_allclose(out_of_balance, [0.0, -last.normal_force[0]], atol=1e-14)
    assert last.normal_force[0] == pytest.approx(0.161017132, rel=1e-7)
    assert last.certificate.passed
    assert last.gap[0] == pytest.approx(0, abs=1e-16)


def test_a_method_that_approximates_finds_the_balance_of_its_springs():
    floor = cq.Plane([0.0, 0.18], [0.0, 1.0])
    history = cq.large_deformation(arch(), [[0.05, -0.29]], node_over(floor), steps=3, method="penalty", penalty=1e4)
    last = history[-1]
    assert last.normal_force[0] == pytest.approx(-1e4 * last.gap[0], rel=1e-10)
    np.testing.assert_allclose(
        last.load - arch().internal_force(last.displacement), [0.0, -last.normal_force[0]], atol=1e-13
    )
    assert not last.certificate.passed


@pytest.mark.slow
def test_the_certificate_is_of_the_last_step_and_holds_for_the_solution():
    last = cq.large_deformation(arch(), [DOWN], node_over(FLOOR), steps=4)[-1]
    again = cq.certify(last.problem, last.displacement, last.normal_force)
    assert again.passed
    assert not cq.certify(last.problem, last.displacement, -last.normal_force).passed
    assert not cq.certify(last.problem, last.displacement + np.array([0, 1e-6]), last.normal_force).passed


@pytest.mark.slow
def test_snap_through_onto_a_floor_is_told_with_its_load():
    limit, w = arch_limit()
    leapt = cq.large_deformation(arch(), [5 * DOWN], steps=1)
    assert leapt[-1].displacement[1] < -0.5
    assert not any(iteration.shift for iteration in leapt.iterations[1])  # no iterate saw the crest
    assert leapt.notes[0].startswith("snap-through at load factor 0.05806")
    history = cq.large_deformation(arch(), [DOWN], node_over(FLOOR), steps=10)
    (note,), (snap,) = history.notes, history.snaps
    assert snap.low < snap.high == pytest.approx(limit, rel=1e-6)
    assert (snap.unknown, snap.after) == (1, pytest.approx(-0.3))
    assert note.startswith("snap-through at load factor 0.290327")
    assert limit == pytest.approx(0.290327, abs=1e-6)
    assert [(event.kind, event.time) for event in history.events] == [("closed", pytest.approx(0.3))]
    np.testing.assert_allclose(history.displacements[3:, 1], -0.3, atol=1e-15)
    # On the floor the arch pulls its node up: the floor carries less than the load, and the rest is in the bars.
    np.testing.assert_allclose(history.normal_forces[3:, 0], history.times[3:] - arch_load(0.3), atol=1e-13)
    assert history[2].displacement[1] > -w
    assert any(iteration.shift > 0 for iteration in history.iterations[3])


def test_a_steep_path_is_no_snap():
    """A rise so small that the stiffness at rest is next to nothing, drawn upwards: it stiffens."""
    assert cq.large_deformation(arch(rise=0.01), [[0.0, 5.0]], steps=3).notes == ()


@pytest.mark.slow
def test_without_an_obstacle_the_arch_hangs_below_its_supports():
    history = cq.large_deformation(arch(), [0.5 * DOWN], steps=5)
    w = -history[-1].displacement[1]
    assert w > 2 * RISE
    assert arch_load(w) == pytest.approx(0.5, rel=1e-12)
    assert "snap-through" in history.notes[0]


def test_convex_methods_refuse_indefinite_tangents():
    with pytest.raises(
        Unsupported, match=r"at load factor \S+: clarabel: the tangent is indefinite .* expected method='active-set'"
    ):
        cq.large_deformation(arch(), [0.5 * DOWN], steps=5, method="clarabel")


@pytest.mark.slow
def test_an_unstable_equilibrium_is_told():
    """A straight column of two bars between lateral springs; load control along the axis of symmetry
    finds the straight column, which no longer is a minimum."""
    nodes = [[0, 0], [0, 1], [0, 2], [1, 1], [-1, 1]]
    column = cq.NonlinearTruss(nodes, [[0, 1], [1, 2], [1, 3], [1, 4]], [1000.0, 1000.0, 0.5, 0.5], 1.0)
    body = cq.Supported(column, held=[0, 1, 4, 6, 7, 8, 9])  # the top moves along the column only
    history = cq.large_deformation(body, [[0.0, 0.0, -0.8]], steps=2)
    # Two bars of length 1 under P push the middle sideways with 2 P u, the springs pull it back with u: P = 1/2.
    assert history.stable.tolist() == [True, True, False]
    np.testing.assert_allclose(history[-1].displacement[0], 0, atol=1e-15)
    assert "from load factor 1 the equilibrium is unstable: 1 motion(s)" in history.notes[0]
    for factor, stands in ((0.99, True), (1.01, False)):
        assert cq.large_deformation(body, [[0.0, 0.0, -0.5 * factor]], steps=1)[-1].stable == stands


@pytest.mark.slow
def test_a_round_obstacle_turns_its_normal_and_convergence_stays_quadratic():
    ball = cq.Circle([0.3, -0.9], 1.0)
    load = np.array([30.0, -10.0])
    history = cq.large_deformation(arch(0.5), [load], node_over(ball, 0.5), steps=2)
    last = history[-1]
    x = np.array([0.0, 0.5]) + last.displacement
    n = (x - [0.3, -0.9]) / np.linalg.norm(x - [0.3, -0.9])
    assert np.linalg.norm(x - [0.3, -0.9]) == pytest.approx(1, abs=1e-15)
    balance = load - arch(0.5).internal_force(last.displacement) + last.normal_force[0] * n
    np.testing.assert_allclose(balance, 0, atol=1e-12)
    assert orders(history.iterations[-1])[-1] > 1.8


class Flattened(cq.ObstacleContact):
    """An obstacle that does not say how it curves."""

    def curvature(self, *_):
        return None


@pytest.mark.slow
def test_without_its_curvature_convergence_is_linear_and_the_answer_the_same():
    ball, load = cq.Circle([0.3, -0.4], 0.5), [[30.0, -30.0]]
    known = cq.large_deformation(arch(0.5), load, cq.ObstacleContact([[0.0, 0.5]], ball), steps=1)
    unknown = cq.large_deformation(arch(0.5), load, Flattened([[0.0, 0.5]], ball), steps=1)
    np.testing.assert_allclose(unknown[-1].displacement, known[-1].displacement, atol=1e-11)
    np.testing.assert_allclose(orders(unknown.iterations[-1])[-5:], 1, atol=0.1)
    assert orders(known.iterations[-1])[-1] > 1.7


@pytest.mark.parametrize("curved", [True, False])
def test_a_node_on_top_of_a_ball_needs_its_indefinite_tangent(curved):
    """A soft spring holds a node that a load presses onto a ball: K + curvature is indefinite across the ball, and the
    node has energy along it. Pressed too hard it slips off."""
    post = cq.NonlinearTruss([[-1, 1], [0, 1], [1, 1], [0, 2]], [[0, 1], [1, 2], [1, 3]], 1.0, 1.0)
    body = cq.Supported(post, held=[0, 1, 4, 5, 6, 7])
    geometry = cq.ObstacleContact([[0.0, 1.0]], cq.Circle([0.0, 0.0], 1.0))
    load = [[0.0, -1.5 if curved else -2.5]]
    history = cq.large_deformation(body, load, geometry, steps=3)
    if curved:
        np.testing.assert_allclose(history[-1].displacement, 0, atol=1e-15)
        np.testing.assert_allclose(history[-1].normal_force, [1.5])
        assert history.stable.all()
    else:  # 2 E A / L = 2 is less than 2.5 / R: the top is no minimum
        assert not history.stable[-1]
        assert "unstable" in history.notes[0]
        assert not history.snaps
        assert len(history.notes) == 1


@pytest.mark.slow
def test_energies_balance_where_the_steps_are_small():
    ball = cq.Circle([0.3, -0.6], 1.0)
    fine = cq.large_deformation(arch(0.5), [[3.0, -10.0]], node_over(ball, 0.5), steps=100)
    last = fine.energies[-1]
    assert last.elastic == pytest.approx(arch(0.5).energy(fine[-1].displacement), rel=1e-14)
    assert fine[-1].normal_force[0] > 1
    assert last.work == pytest.approx(last.elastic, rel=1e-3)
    assert last.dissipated == 0
    assert fine[-1].energy == pytest.approx(last.elastic - fine[-1].load @ fine[-1].displacement)


@pytest.mark.slow
def test_ties_move_the_body_and_work_on_it():
    """The node is drawn down through the flat state by a tie: the tie's force is P(w) all the way, unstable or not."""
    history = cq.large_deformation(arch(), [[0, 0]], tie=[[0.0, 1.0]], tie_values=[[-0.5]], steps=50)
    w = -history.displacements[:, 1]
    np.testing.assert_allclose(w, np.linspace(0, 0.5, 51), atol=1e-15)
    np.testing.assert_allclose([solution.tie_force[0] for solution in history], arch_load(w), atol=1e-13)
    assert history.stable.all()
    assert all(solution.certificate.passed for solution in history)
    assert history.energies[-1].work == pytest.approx(history.energies[-1].elastic, rel=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["clarabel", "lemke"])
def test_stiffness_along_a_tie_makes_the_step_convex_for_every_method(method):
    """The tangent is indefinite along the tie alone, whose displacement is given: the same problem, now convex."""
    ways = dict(tie=[[0.0, 1.0]], tie_values=[[-0.3]], steps=5)
    history = cq.large_deformation(arch(), [[0, 0]], method=method, **ways)
    w = -history.displacements[:, 1]
    np.testing.assert_allclose([solution.tie_force[0] for solution in history], arch_load(w), atol=1e-12)
    assert arch().tangent(history[3].displacement).toarray()[1, 1] < 0


def test_a_pendulum_without_stiffness_falls_to_where_it_hangs():
    """A bar on a hinge, loaded across its axis: a mechanism until it has turned into the load."""
    bar = cq.Supported(cq.NonlinearTruss([[0, 0], [1, 0]], [[0, 1]], 100.0, 1.0), held=[0, 1])
    history = cq.large_deformation(bar, [[0.0, -10.0]], steps=1, max_iter=200)
    stretch = brentq(lambda x: 100 * (x * x - 1) / 2 * x - 10, 1, 1.2, xtol=1e-15)
    np.testing.assert_allclose(history[-1].displacement, [-1, -stretch], atol=1e-9)


@cache
def dragged(friction=0.5, steps=20, method="active-set"):
    """A soft bar from a foot on the floor to a hand that is led to the right and back over the foot.

    Returns the history, the truss, and the lead a of the hand at which the foot slides, from balance by hand:
    with the bar's force q per length of it, q a = mu (N - q H).
    """
    height, modulus, weight = 0.9, 5.0, 1.0
    truss = cq.NonlinearTruss([[0, 0], [0.2, height]], [[0, 1]], modulus, 1.0)
    foot = cq.ObstacleContact([[0.0, 0.0]], cq.Plane([0, 0], [0, 1]), unknowns=[[0, 1]], dimension=4)
    load, A = [0, -weight, 0, 0], [[0, 0, 1, 0], [0, 0, 0, 1]]
    values = [[0.0, 0.0], [3.0, 0.0], [-1.0, 0.0]]
    history = cq.large_deformation(
        truss, [load] * 3, foot, steps=steps, tie=A, tie_values=values, friction=friction, method=method
    )
    L0 = truss.length[0]

    def force(a):
        return modulus * (a * a + height**2 - L0**2) / (2 * L0**3)

    lead = brentq(lambda a: force(a) * a - friction * (weight - force(a) * height), 0.2, 3, xtol=1e-15)
    return history, truss, lead, weight - force(lead) * height


@pytest.mark.slow
def test_a_truss_that_turns_far_is_dragged_along_a_plane_with_friction():
    history, truss, lead, pressed = dragged()
    forward, back = history[40], history[60]
    assert forward.displacement[0] == pytest.approx(0.2 + 3 - lead, abs=1e-10)
    assert back.displacement[0] == pytest.approx(0.2 - 1 + lead, abs=1e-10)
    for solution, sign in ((forward, 1), (back, -1)):
        assert solution.normal_force[0] == pytest.approx(pressed, rel=1e-10)
        assert solution.friction_force[0, 0] == pytest.approx(sign * 0.5 * pressed, rel=1e-10)
        assert solution.contact_status.tolist() == ["slip"]
        x = truss.positions(solution.displacement)
        assert np.sign(x[1, 0] - x[0, 0]) == sign  # the bar leans the other way: it has turned through the vertical
    assert [event.kind for event in history.events] == ["closed", "slip", "stick", "slip"]
    slid = (0.2 + 3 - lead) + (0.2 + 3 - lead - (0.2 - 1 + lead))
    assert history.energies[-1].dissipated == pytest.approx(0.5 * pressed * slid, rel=1e-10)
    assert history.energies[-1].work == pytest.approx(history.energies[-1].total + 0.5 * pressed * slid, rel=1e-2)
    assert all(solution.certificate.passed for solution in history)
    assert max(solution.negative for solution in history) == 0


@pytest.mark.slow
def test_the_bar_is_compressed_on_the_way_and_its_tangent_indefinite():
    history, truss, _, _ = dragged()
    forces = [truss.axial_force(solution.displacement)[0] for solution in history]
    assert min(forces) < -0.1
    assert any("indefinite" in note for solution in history for note in solution.certificate.notes)


@pytest.mark.slow
def test_with_large_sliding_steps_change_nothing():
    coarse, fine = dragged(steps=5)[0], dragged(steps=10)[0]
    np.testing.assert_allclose(coarse[-1].displacement, fine[-1].displacement, atol=1e-10)


@pytest.mark.slow
def test_a_foot_that_lands_while_it_moves_slides_from_where_it_lands():
    """A node on soft springs, drawn sideways and down; it lands on the way and friction counts from there."""
    springs = cq.NonlinearTruss([[0, 1], [0, 101], [100, 1]], [[0, 1], [0, 2]], 100.0, 1.0)
    body = cq.Supported(springs, held=[2, 3, 4, 5])
    foot = cq.ObstacleContact([[0.0, 1.0]], cq.Plane([0, 0], [0, 1]))

    def end(steps):
        return cq.large_deformation(body, [[2.0, -2.0]], foot, steps=steps, friction=10.0)[-1].displacement[0]

    def height(load):
        return 1 + cq.large_deformation(body, [[load, -load]], steps=1)[-1].displacement[1]

    lands = brentq(height, 0.9, 1.1, xtol=1e-14)
    where = cq.large_deformation(body, [[lands, -lands]], steps=1)[-1].displacement[0]
    assert end(1) == pytest.approx(where, rel=1e-9)  # of 2, where it would go without friction
    assert end(20) == pytest.approx(where, rel=1e-9)


@pytest.mark.slow
def test_a_block_in_space_is_dragged_with_friction_that_opposes_its_slip():
    """A soft cube is pressed on a floor by its top and dragged askew until all of it slides: |l_T| = mu l_N."""
    part = Body(box((1.0, 1.0, 1.0), (2, 2, 2)), Material(1.0, 0.3), "3d", name="cube")
    solid, X = cq.NonlinearSolid(part), part.mesh.points
    top = np.flatnonzero(X[:, 2] == 1)
    A = np.eye(part.size)[(3 * top[:, None] + np.arange(3)).ravel()]
    floor = cq.ObstacleContact(part.surface("bottom"), cq.Plane([0, 0, 0], [0, 0, 1]), dimension=part.size)
    moves = [np.tile(move, len(top)) for move in ([0, 0, -0.1], [1.0, 0.5, -0.1], [1.0, 0.5, -0.1])]
    history = cq.large_deformation(
        solid, [np.zeros(part.size)] * 3, floor, steps=2, friction=0.3, tie=A, tie_values=moves
    )
    dragged = history[4]
    assert set(dragged.contact_status) == {"slip"}
    np.testing.assert_allclose(np.linalg.norm(dragged.friction_force, axis=1), 0.3 * dragged.normal_force, rtol=1e-9)
    total = dragged.friction_force.sum(axis=0)
    np.testing.assert_allclose(total / np.linalg.norm(total), np.array([2, 1]) / np.sqrt(5), atol=1e-2)
    # The step that moves nothing changes nothing: all stick where they slid to.
    np.testing.assert_array_equal(history[5].displacement, dragged.displacement)
    assert set(history[5].contact_status) == {"stick"}
    assert all(solution.certificate.passed for solution in history)


@pytest.mark.slow
def test_failures_carry_the_history_and_resume():
    floor = cq.Plane([0.0, 0.18], [0.0, 1.0])
    whole = cq.large_deformation(arch(), [[0.05, -0.28]], node_over(floor), steps=8)

    class Breaks:
        """An arch that cannot be computed below u_y = -0.015."""

        dimension = 2

        def energy(self, u):
            return arch().energy(u) if u[1] > -0.015 else np.inf

        def internal_force(self, u):
            if u[1] <= -0.015:
                raise InvalidProblem("element 7 is turned inside out")
            return arch().internal_force(u)

        def tangent(self, u):
            return arch().tangent(u)

    with pytest.raises(NotConverged, match=r"load factor 0.375.*element 7 is turned inside out") as failure:
        cq.large_deformation(Breaks(), [[0.05, -0.28]], node_over(floor), steps=8)
    so_far = failure.value.history
    assert isinstance(so_far, LargeHistory)
    assert len(so_far) >= 3
    assert failure.value.solution is so_far[-1]
    resumed = cq.large_deformation(arch(), [[0.05, -0.28]], node_over(floor), steps=8, start=so_far[-1])
    np.testing.assert_allclose(resumed.times, whole.times[len(so_far) - 1 :])
    np.testing.assert_allclose(resumed[-1].displacement, whole[-1].displacement, atol=1e-14)


def test_too_few_iterations_say_what_is_left():
    words = r"at load factor 0.5: Newton's method: 2 iterations leave [^;]*; nor do parts [^;]*$"
    with pytest.raises(NotConverged, match=words):
        cq.large_deformation(arch(), [0.28 * DOWN], steps=2, max_iter=2)


def test_a_mechanism_says_what_makes_it_stiff():
    """A bar held at one end and pushed across itself; in balance it hangs along the load, N / E A longer."""
    bar, held, across = cq.NonlinearTruss([[0, 0], [1, 0]], [[0, 1]], 1e10, 1e-4), np.eye(4)[:2], [0, 0, 0, 100.0]
    with pytest.raises(NotConverged, match=r"the load drives a mechanism, .*: stretch it first, .* \(start=\)"):
        cq.large_deformation(bar, [across], tie=held, steps=1, max_iter=4)
    hanging = cq.large_deformation(bar, [across], tie=held, steps=1, start=[0, 0, -1.0, 1.0])[-1]
    np.testing.assert_allclose(hanging.displacement, [0, 0, -1.0, 1.0 + 1e-4], atol=2e-8)


@pytest.mark.slow
def test_a_mechanism_that_is_stretched_first_is_stiff():
    bar, held = cq.NonlinearTruss([[0, 0], [1, 0]], [[0, 1]], 1e10, 1e-4), np.eye(4)[:2]
    stretched = cq.large_deformation(bar, [[0, 0, 100.0, 0], [0, 0, 100.0, 100.0]], tie=held, steps=2)[-1]
    end = np.array([1.0, 0.0]) + stretched.displacement[2:]
    np.testing.assert_allclose(np.hypot(*end), 1.0 + 2**0.5 * 1e-4, atol=4e-8)


@pytest.mark.slow
def test_a_lost_pair_is_told():
    """A node that is drawn to the centre of a hole, where every direction is as near."""
    hole = cq.Circle([0.0, 0.1], 1.0, inside=True)
    with pytest.raises(NotConverged, match="lies at the centre"):
        cq.large_deformation(
            arch(), [[0, 0]], node_over(hole), tie=[[0, 1.0]], tie_values=[[-0.1]], steps=1, friction=0.1
        )


@pytest.mark.slow
def test_what_falls_without_end_does_not_converge():
    free = cq.NonlinearTruss([[0, 0], [1, 0], [0, 1]], [[0, 1], [1, 2], [2, 0]], 1.0, 1.0)
    with pytest.raises(NotConverged) as failure:
        cq.large_deformation(free, [[0.0, -1.0] * 3], steps=1, max_iter=30)
    assert len(failure.value.history) == 1


@pytest.mark.slow
def test_histories_are_pickled():
    history = cq.large_deformation(arch(), [DOWN], node_over(FLOOR), steps=4)
    again = pickle.loads(pickle.dumps(history))
    assert again.notes == history.notes
    np.testing.assert_array_equal(again.displacements, history.displacements)
    assert again.iterations == history.iterations


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(body=object()), "body: expected"),
        (dict(loads=[]), "at least one load"),
        (dict(loads=[[1.0]]), r"loads\[0\]: expected shape \(2,\)"),
        (dict(contact=object()), "contact: expected an object with contacts, "),
        (dict(contact=cq.ObstacleContact([[0, 0, 0]], cq.Sphere([0, 0, 9], 1.0))), "2 unknowns of the body, got 3"),
        (dict(steps=0), "steps: expected a positive integer"),
        (dict(control="force"), "control: expected one of"),
        (dict(tolerance=0), "tolerance: expected"),
        (dict(friction=0.3), "friction: expected contacts"),
        (dict(tie=[[0, 1.0]], tie_values=[[0.0], [1.0]]), "one for each of 1 loads, got 2"),
        (dict(start=[0.0]), "start: expected shape"),
    ],
)
def test_bad_arguments_are_refused(change, message):
    with pytest.raises(InvalidProblem, match=message):
        cq.large_deformation(**(dict(body=arch(), loads=[DOWN]) | change))


def test_friction_with_an_approximate_method_is_refused():
    with pytest.raises(Unsupported, match="approximate"):
        cq.large_deformation(arch(), [DOWN], node_over(FLOOR), friction=0.3, method="penalty", penalty=1e4)


@pytest.mark.slow
def test_a_slack_chain_takes_its_shape_without_a_snap():
    """At no load a chain has motions without stiffness; how far it falls then is no jump off a stable equilibrium."""
    nodes = [[0.0, 0.0], [0.6, -0.8], [1.4, -0.8], [2.0, 0.0]]
    chain = cq.Supported(cq.NonlinearTruss(nodes, [[0, 1], [1, 2], [2, 3]], 1e4, 1.0), held=[0, 1, 6, 7])
    history = cq.large_deformation(chain, [[0.0, -1.0, 0.0, -3.0]], steps=2)
    assert np.max(abs(history.displacements[1])) > 0.05
    assert any(iteration.shift for iteration in history.iterations[1])
    assert (history.notes, history.snaps) == ((), ())


def test_a_load_beyond_all_numbers_is_refused_without_a_warning():
    with pytest.raises(NotConverged, match="no part of the step can be taken: the energy is not a number"):
        cq.large_deformation(arch(), [[0.0, -1e200]], steps=1)


@pytest.mark.slow
def test_a_body_that_nothing_holds_is_told_so():
    loose = cq.NonlinearTruss([[-1, 0], [0, 0.2], [1, 0]], [[0, 1], [1, 2]], modulus=100.0, area=1.0)
    with pytest.raises(NotConverged, match="its load may drive a motion that nothing holds"):
        cq.large_deformation(loose, [[0, -1.0, 0, 0, 0, 0]], max_iter=12)


def test_unknowns_of_a_solid_have_the_names_of_its_nodes() -> None:
    mesh = cq.rectangle(2.0, 1.0, (2, 1))
    block = cq.Body(mesh, cq.Material(1.0, 0.3), "plane-strain", name="block")
    held = [*range(4), 4, 5]
    solid = cq.Supported(cq.NonlinearSolid(block, "neo-hookean"), held=held)
    load = np.zeros(solid.dimension)
    load[-1] = -0.01
    bent = cq.large_deformation(solid, [load], steps=1)[-1]
    assert bent.problem.dof_names is not None
    assert bent.problem.dof_names[0] == "block node 3 x"
    assert bent.at("block node 5 y") == bent.displacement[-1]


@pytest.mark.slow
@pytest.mark.parametrize(("law", "rise"), [("green", 0.2), ("green", 0.4), ("engineering", 0.6), ("logarithmic", 0.4)])
def test_an_arch_pressed_onto_a_floor_comes_back_to_rest(law: str, rise: float) -> None:
    """Without load the forces left of each iteration are the largest there are, down to 1e-183, and no step ends it."""
    floor = cq.ObstacleContact([[0.0, rise]], cq.Plane([0.0, 0.5 * rise], [0.0, 1.0]))
    press = [0.0, -3 * arch_limit(rise)[0]]
    history = cq.large_deformation(arch(rise=rise, law=law), [press, [0.0, 0.0], press], floor, steps=1)
    assert [solution.normal_force[0] > 0 for solution in history] == [False, True, False, True]
    assert not history[2].displacement.any()
    assert history[2].certificate.passed
    assert history[2].stable
