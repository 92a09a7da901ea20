"""Load paths: steps, exact events, energies.

A load path of 100 steps on one body makes one factorisation, counted where the factors are made.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse.linalg as spla

import contactqp as cq
from benchmarks.load_path import price
from benchmarks.price_of_contact import block, fresh
from contactqp.linalg import pardiso
from contactqp.linalg.condensation import condense
from tests.examples import block_between, seeded_problem, truss, two_bars


def test_the_contact_load_is_found_exactly() -> None:
    history = cq.follow_path(two_bars(0.0), loads=[[300.0, 0.0], [0.0, 0.0]], events="exact")
    assert [(event.kind, event.contact) for event in history.events] == [("closed", 0), ("opened", 0)]
    assert [event.time for event in history.events] == pytest.approx([157.5 / 300, 2 - 157.5 / 300], rel=1e-14)
    assert list(history.times) == pytest.approx([0.0, 0.525, 1.0, 1.475, 2.0])
    proportional = cq.follow_path(truss(), loads=[[60.0, -100.0]], events="exact")
    assert proportional.events[0].time == pytest.approx(458394666339 / 639328600000, rel=1e-13)
    assert proportional.events[0].name == "floor"


def test_steps_hit_every_corner_and_share_one_factorisation() -> None:
    history = cq.follow_path(two_bars(), loads=[[300.0, 0.0], [150.0, 0.0]], steps=4)
    assert len(history) == 9
    assert history.normal_forces[4] == pytest.approx([95.0])
    assert history.times[4] == 1.0
    assert sum(solution.work.factorisations for solution in history) == 0  # diag(K): nothing lies inside
    assert history.displacements.shape == (9, 2)
    assert history.friction_forces is None
    beam = cq.follow_path(truss(), loads=[[60.0, -100.0]], steps=10)
    assert sum(solution.work.factorisations for solution in beam) == 1


def test_work_is_elastic_energy_where_events_are_exact() -> None:
    history = cq.follow_path(two_bars(), loads=[[300.0, 0.0]], events="exact")
    assert history.energies[-1].work == pytest.approx(history.energies[-1].elastic, rel=1e-12)
    assert history.energies[-1].total == pytest.approx(history[-1].energy + 300.0 * history[-1].displacement[0])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3, 4))])
def test_exact_events_agree_with_many_steps(seed: int) -> None:
    problem = seeded_problem(seed, n=7, m=6)
    problem = problem.replace(gap=np.maximum(abs(problem.gap), 0.05))
    corners = [problem.load, -problem.load, 0 * problem.load]
    exact = cq.follow_path(problem, corners, events="exact")
    steps = cq.follow_path(problem, corners, steps=50)
    assert len(exact.events) == len(steps.events) > 0
    by_time = {(event.kind, event.contact): event.time for event in exact.events}
    for event in steps.events:
        assert 0 <= event.time - by_time[event.kind, event.contact] < 1 / 50 + 1e-12 or any(
            0 <= event.time - other.time < 1 / 50 + 1e-12
            for other in exact.events
            if (other.kind, other.contact) == (event.kind, event.contact)
        )


def test_contacts_that_close_together() -> None:
    """Two equal bars reach two equal walls at one load."""
    problem = cq.ContactProblem(stiffness=np.eye(2), load=[0.0, 0.0], normal=np.eye(2), gap=[0.5, 0.5])
    history = cq.follow_path(problem, [[1.0, 1.0]], events="exact")
    assert [(event.contact, event.time) for event in history.events] == [(0, 0.5), (1, 0.5)]


def test_redundant_contacts_close_without_end() -> None:
    problem = cq.ContactProblem(stiffness=[[1.0]], load=[0.0], normal=[[1.0], [1.0]], gap=[0.5, 0.5])
    history = cq.follow_path(problem, [[1.0]], events="exact")
    assert {event.time for event in history.events} == {0.5}
    assert history[-1].normal_force.sum() == pytest.approx(0.5)


def test_what_cannot_be_followed_is_refused() -> None:
    with pytest.raises(cq.Unsupported, match="approximate"):
        cq.follow_path(truss(), [[60.0, -100.0]], events="exact", method="penalty", penalty=1e6)
    with pytest.raises(cq.InvalidProblem, match="steps"):
        cq.follow_path(truss(), [[60.0, -100.0]], steps=0)
    with pytest.raises(cq.InvalidProblem, match="events"):
        cq.follow_path(truss(), [[60.0, -100.0]], events="some")
    with pytest.raises(cq.InvalidProblem, match="loads"):
        cq.follow_path(truss(), [])
    loose = cq.ContactProblem(stiffness=[[0.0]], load=[0.0], normal=[[1.0]], gap=[1.0])
    with pytest.raises(cq.Unsupported, match="jumps"):
        cq.follow_path(loose, [[1.0]], events="exact")


def resting_beam(load: list[float]) -> cq.ContactProblem:
    """A free beam, EI = 1, on three supports at 0, 1 and 2; loads at 1/2 and 3/2 [downwards]."""
    K, s = np.zeros((10, 10)), 0.5
    rows = [[12, 6 * s, -12, 6 * s], [6 * s, 4 * s * s, -6 * s, 2 * s * s]]
    rows += [[-12, -6 * s, 12, -6 * s], [6 * s, 2 * s * s, -6 * s, 4 * s * s]]
    for i in range(4):
        K[2 * i : 2 * i + 4, 2 * i : 2 * i + 4] += np.array(rows) / s**3
    supports, forces = np.zeros((3, 10)), np.zeros(10)
    supports[[0, 1, 2], [0, 4, 8]] = -1.0
    forces[[2, 6]] = [-part for part in load]
    return cq.ContactProblem(K, forces, supports, np.zeros(3))


def test_a_free_body_at_rest_is_held_by_what_it_rests_on() -> None:
    """Exact events: a load in one span lifts the beam off the third support, two equal ones press 5/16, 22/16, 5/16."""
    one, two = resting_beam([1.0, 0.0]), resting_beam([1.0, 1.0])
    history = cq.follow_path(two, loads=[one.load, two.load, one.load], events="exact")
    assert all(solution.certificate.passed for solution in history)
    at = {time: force for time, force in zip(history.times, history.normal_forces, strict=True)}
    assert at[1.0] == pytest.approx([0.5, 0.5, 0.0], rel=1e-12)
    assert at[2.0] == pytest.approx([5 / 16, 22 / 16, 5 / 16], rel=1e-12)
    # If it could pull, the third support would have -3/32 of the first load and 13/32 of the second.
    third = [(event.kind, event.time) for event in history.events if event.contact == 2]
    assert third == [("closed", pytest.approx(1 + 3 / 13, rel=1e-12)), ("opened", pytest.approx(3 - 3 / 13, rel=1e-12))]
    pressed = cq.ContactProblem(np.zeros((2, 2)), [-1.0, 0.1], [[-1.0, 1.0], [-1.0, -1.0]], [0.0, 0.0])
    rigid = cq.follow_path(pressed, loads=[[-1.0, 0.1]], events="exact")
    assert rigid[-1].normal_force == pytest.approx([0.55, 0.45], rel=1e-14)
    legs = [[-1.0, -y, x] for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    table = cq.ContactProblem(np.zeros((3, 3)), np.zeros(3), legs, np.zeros(4))
    stood = cq.follow_path(table, loads=[[-100.0, 0.0, 0.0]], events="exact")
    assert stood[-1].normal_force.sum() == pytest.approx(100.0)
    with pytest.raises(cq.Unsupported, match="moves a body that nothing holds"):  # it tips
        cq.follow_path(pressed, loads=[[-1.0, 0.1], [-1.0, 1.1]], events="exact")


def test_a_loose_body_is_followed_in_steps() -> None:
    history = cq.follow_path(block_between(seed=1), [block_between(seed=1).load], steps=5)
    assert np.all(np.diff(history.normal_forces.sum(axis=1)) > 0)


STEPS = 100


@pytest.fixture(params=["superlu", "pardiso"])
def made(request, monkeypatch):
    """The sizes of the sparse matrices that were factorised, in order."""
    sizes = []
    monkeypatch.setenv(pardiso.SOLVER_VARIABLE, request.param)
    if request.param == "pardiso":
        pytest.importorskip("pypardiso")
        factorise = pardiso.Pardiso.__init__

        def counted(self, matrix, retained):
            sizes.append(matrix.shape[0] - len(retained))
            factorise(self, matrix, retained)

        monkeypatch.setattr(pardiso.Pardiso, "__init__", counted)
    else:
        splu = spla.splu

        def counted_splu(matrix, **options):
            sizes.append(matrix.shape[0])
            return splu(matrix, **options)

        monkeypatch.setattr(spla, "splu", counted_splu)
    return sizes


@pytest.mark.slow
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_path_of_100_steps_makes_one_factorisation(dimension, made):
    problem = block(500, dimension)
    history = cq.follow_path(problem, [problem.load], steps=STEPS)
    assert len(history) == STEPS + 1
    assert len(made) == 1
    assert [solution.work.factorisations for solution in history] == [1] + STEPS * [0]
    assert all(solution.certificate.passed and solution.certificate.proven for solution in history)
    closed = (history.normal_forces > 0).sum(axis=1)
    assert closed[0] < closed[STEPS // 2] < closed[-1], "the contact grows along the path"
    alone = cq.solve(fresh(problem)).normal_force
    np.testing.assert_allclose(history[-1].normal_force, alone, rtol=0, atol=1e-12 * alone.max())


@pytest.mark.sampled(2)
def test_steps_on_fresh_problems_are_seen_to_factorise_each_time(made):
    problem = block(500, 2)
    for fraction in (0.2, 0.4, 0.6):
        cq.solve(fresh(problem).replace(load=fraction * problem.load))
    assert len(made) == 3


def test_only_what_is_looked_at_is_expanded():
    """Two corners are reduced; the start is solved, and one step among a hundred polished and certified."""
    problem = block(500, 2)
    history = cq.follow_path(problem, [problem.load], steps=STEPS)
    spent = condense(problem).back_substitutions
    looked = history[STEPS // 2]
    assert looked.certificate.proven
    after = condense(problem).back_substitutions
    assert spent < STEPS // 2
    assert 0 < after - spent <= 6
    assert history[STEPS // 2] is looked
    assert condense(problem).back_substitutions == after


@pytest.mark.slow
def test_the_benchmark_judges_the_further_step():
    found = price(block(500, 2), steps=3, rounds=1)
    assert found.factorisations == 1
    assert replace(found, first=1.0, step=0.049).met
    assert not replace(found, first=1.0, step=0.051).met


def test_a_history_says_where_what_solutions_have_is() -> None:
    history = cq.follow_path(truss(), loads=[[60.0, -100.0]], steps=2)
    for name in ("at", "displacement", "certificate"):
        with pytest.raises(AttributeError, match=rf"history\[-1\]\.{name} is that of the last"):
            getattr(history, name)
    assert not hasattr(history, "nonsense")


@pytest.mark.parametrize(("length", "force"), [(1.0, 1.0), (2.0**20, 2.0**-20), (1e3, 1e-3)])
def test_a_small_gap_beside_a_large_force_closes_at_its_time_in_any_units(length: float, force: float) -> None:
    """Two springs of 1e9 N/m: one is pressed with 1e6 N, the other closes 5e-8 m, halfway to a load of 100 N."""
    stiffness = 1e9 * force / length * np.eye(2)
    springs = cq.ContactProblem(stiffness, np.zeros(2), np.eye(2), length * np.array([0.0, 5e-8]))
    events = cq.follow_path(springs, [force * np.array([1e6, 100.0])], events="exact").events
    assert [(event.kind, event.contact) for event in events] == [("closed", 0), ("closed", 1)]
    assert [event.time for event in events] == pytest.approx([0.0, 0.5], rel=1e-12)


@pytest.mark.slow
def test_a_load_that_tips_a_body_is_told_with_its_time() -> None:
    """A seesaw with its load beyond one support: the other lifts off at 10/11 of the second leg, in the last step."""
    seesaw = cq.ContactProblem(np.zeros((2, 2)), [-1.0, 0.0], [[-1.0, 1.0], [-1.0, -1.0]], [0.0, 0.0])
    with pytest.raises(cq.NoEquilibrium, match=r"^follow_path: at t = 2: the load drives") as ended:
        cq.follow_path(seesaw, loads=[[-1.0, 0.0], [-1.0, 1.1]], steps=10)
    assert ended.value.history.times[-1] == pytest.approx(1.9)
    assert ended.value.history.normal_forces[-1] == pytest.approx([0.995, 0.005])


def _beam_on_three_stops(stiffness: float) -> cq.ContactProblem:
    """A rigid beam over stops at -1, 0 and 1, and rows on the sum of two of them: four contacts on two unknowns."""
    rows = [[-1.0, 1.0], [-1.0, 0.0], [-1.0, -1.0], [-2.0, -1.0]]
    return cq.ContactProblem(stiffness * np.eye(2), np.zeros(2), rows, np.zeros(4))


def test_exact_events_of_redundant_contacts_on_an_elastic_body_follow_its_displacements() -> None:
    """A beam that is pressed down rests on all four, and lifts off one end where the moment is the force: M = F = 1."""
    beam = _beam_on_three_stops(2.0)
    history = cq.follow_path(beam, [[-1.0, 0.0], [-1.0, 3.0]], events="exact")
    stepped = cq.follow_path(beam, [[-1.0, 0.0], [-1.0, 3.0]], steps=30)
    for instant, time in zip(stepped, stepped.times, strict=True):
        between = [np.interp(time, history.times, column) for column in history.displacements.T]
        assert instant.displacement == pytest.approx(between, abs=1e-12)
    assert any(time == pytest.approx(4 / 3, rel=1e-12) for time in history.times)


def test_exact_events_of_a_rigid_body_whose_contacts_share_forces_are_refused_or_right() -> None:
    from tests.solving.test_masonry_arch import arch

    sprung = arch(0.3)
    sprung = sprung.replace(stiffness=np.eye(sprung.dimension))
    leaning = np.array(sprung.load)
    leaning[12] += 0.5
    loads = [sprung.load, leaning]
    history = cq.follow_path(sprung, loads, events="exact")
    stepped = cq.follow_path(sprung, loads, steps=4)
    for instant, time in zip(stepped, stepped.times, strict=True):
        between = [np.interp(time, history.times, column) for column in history.displacements.T]
        assert instant.displacement == pytest.approx(between, abs=1e-10)
    assert abs(history.displacements[-1]).max() > 1e-3
    with pytest.raises(cq.Unsupported, match="contacts share forces"):
        cq.follow_path(arch(0.3), [arch(0.3).load], events="exact")
