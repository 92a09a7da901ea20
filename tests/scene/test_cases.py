"""Every shipped case, by the methods it speaks of and by every classical method: what it claims holds."""

from fractions import Fraction as F

import numpy as np
import pytest

import contactqp as cq
from contactqp.scene.explaining import report_methods
from contactqp.scene.judging import Judgement, Trial, judge, judge_all, trials
from contactqp.scene.schema import LoadPath
from tests import shipped_cases

SCENES = {f"{name}.toml": scene for name, scene in shipped_cases.SCENES.items()}
CASES = list(SCENES)
# Without a contact there is nothing to enforce: those cases are judged above.
TOUCHING = [name for name, scene in SCENES.items() if scene.contacts and report_methods(scene) is None]
MOVING = [name for name, scene in SCENES.items() if scene.motion is not None]
LARGE = [name for name, scene in SCENES.items() if scene.large]
OF_NODES = [name for name, scene in SCENES.items() if scene.nodes and name not in (*MOVING, *LARGE)]
MESHED = [name for name, scene in SCENES.items() if scene.meshed and name not in MOVING]
EXACT_METHODS = ("lagrange-multiplier", "master-slave", "augmented-lagrangian", "lemke", "osqp", "clarabel")


def test_every_static_frictionless_example_is_there():
    sources = " ".join(SCENES[name].source for name in CASES)
    for words in (
        "2.1",
        "2.2",
        "2.3",
        "2.4",
        "eqs 2.17-2.20",
        "2.5 to 2.9",
        "2.10 to 2.12",
        "2.13 to 2.16",
        "Problem 2.2",
        "Example 2.22",
    ):
        assert words in sources


def test_every_example_with_friction_is_there():
    sources = " ".join(scene.source for scene in SCENES.values())
    for words in ("Example 2.17", "Table 2.2", "Examples 2.18 and 2.21", "Example 2.19", "Problems 2.3, 2.4 and 2.5"):
        assert words in sources


@pytest.mark.parametrize("name", CASES)
def test_what_a_case_claims_holds(name):
    scene = SCENES[name]
    outcomes = judge_all(scene)
    assert outcomes
    for outcome in outcomes:
        assert isinstance(outcome, Judgement), outcome
        rows = (*outcome.expectations, *outcome.published)
        assert rows
        assert all(row.ok for row in rows), [row for row in rows if not row.ok]


@pytest.mark.sampled(34)
@pytest.mark.parametrize("method", EXACT_METHODS)
@pytest.mark.parametrize("name", TOUCHING)
def test_every_exact_method_gives_the_exact_answer(name, method):
    """To 1e-12 of the exact values, unless the case itself says otherwise."""
    scene = SCENES[name]
    outcomes = judge_all(scene, [method])
    assert outcomes
    for outcome in outcomes:
        assert isinstance(outcome, Judgement), outcome.message
        assert outcome.solution.certificate.passed
        assert outcome.met, [row for row in outcome.expectations if not row.ok]


@pytest.mark.parametrize("name", OF_NODES)
def test_expectations_are_sharp(name):
    """Exact answers are asked for to 1e-12, penalised ones to 1e-10, and zeros to a stated size."""
    scene = SCENES[name]
    assert any(claim.method is None for claim in scene.expect)
    for claim in scene.expect:
        if not any(claim.tolerance.dimension):
            assert float(claim.tolerance.si) <= (1e-12 if claim.method is None else 1e-10)


@pytest.mark.parametrize("name", MESHED)
def test_expectations_of_bodies_say_how_exact_they_are(name):
    """Balance to 1e-8; what the mesh blurs to 5 % and with the word for it, and widths by the size of an element."""
    assert SCENES[name].expect
    for claim in SCENES[name].expect:
        if any(claim.tolerance.dimension):
            assert claim.quantity in ("contact half-width", "stick half-width")
            assert "element" in claim.derivation
        elif claim.quantity != "free motions":
            assert claim.tolerance.si <= F(1, 25)
            blurred = claim.tolerance.si > F(1, 10**8)
            words = ("discretisation", "is at the middle", "pulls down")
            assert not blurred or any(word in claim.derivation for word in words), claim.derivation


@pytest.mark.parametrize("name", MOVING)
def test_expectations_of_motions_say_how_exact_they_are(name):
    """What steps and elements blur to 2 % and with the word for it, times by steps; all else to 1e-6."""
    assert SCENES[name].expect
    for claim in SCENES[name].expect:
        if claim.quantity == "event time":
            steps = claim.tolerance.si / SCENES[name].motion.time_step.si
            assert steps <= 5
            assert "step" in claim.derivation
        elif not any(claim.tolerance.dimension):
            assert claim.tolerance.si <= F(1, 50)
            assert claim.tolerance.si <= F(1, 10**6) or "discretisation" in claim.derivation, claim.derivation


def test_every_example_of_impact_is_there():
    sources = " ".join(SCENES[name].source for name in MOVING)
    for words in ("Example 2.23", "first benchmark", "second benchmark", "Dabaghi"):
        assert words in sources
    claimed = {claim.quantity for name in MOVING for claim in SCENES[name].expect}
    assert {"total momentum", "momentum", "contact impulse", "total energy", "impact energy", "velocity"} <= claimed


@pytest.mark.parametrize("name", LARGE)
def test_expectations_of_large_deformations_say_how_exact_they_are(name):
    """Limit points and balance to 1e-10, jumps as far as they are halved down, and a chain to the word for it."""
    assert SCENES[name].expect
    for claim in SCENES[name].expect:
        if any(claim.tolerance.dimension):
            assert claim.targets[0].si == 0 or "second order" in claim.derivation
        elif claim.tolerance.si > F(1, 10**10):
            assert claim.tolerance.si <= F(1, 200)
            assert "second order" in claim.derivation or "millionth" in claim.derivation, claim.derivation


@pytest.mark.slow
def test_the_motions_of_what_is_free_are_named():
    from contactqp.scene.body_answers import motions_in_words

    for name, expected in (
        ("floating_disc.toml", ["disc along x"]),
        ("stacked_blocks.toml", ["lower along x", "middle along x", "upper along x"]),
    ):
        (judgement,) = judge_all(SCENES[name])
        assert motions_in_words(judgement.model, judgement.solution) == expected


def test_the_contact_load_is_found_exactly():
    history = cq.run(SCENES["bar_wall_path.toml"])
    (event,) = history.events
    assert (event.kind, event.contact, event.time) == ("closed", 0, 0.525)
    assert history[-1].normal_force[0] == pytest.approx(142.5, rel=1e-14)
    assert len(cq.run(SCENES["bar_wall.toml"])) == 1


def test_the_wire_meets_the_floor_node_after_node():
    """At b = 2 T d / (x (x + h)), the middle at 8 T d / L^2, each on both sides at once; what it carries is exact."""
    history = cq.run(SCENES["string_over_floor.toml"])
    closed = {event.contact: event.time for event in history.events}
    assert {event.kind for event in history.events} == {"closed"}
    assert closed == pytest.approx({3: 1 / 4, 2: 1 / 3, 4: 1 / 3, 1: 2 / 3, 5: 2 / 3}, rel=1e-14)
    assert history[-1].normal_force.sum() == pytest.approx(1.0, rel=1e-14)


def test_the_last_row_of_table_2_1_is_one_place_of_the_gap_times_the_penalty():
    scene = SCENES["truss_floor_printed.toml"]
    textbook = cq.solve(scene.problem(), method="penalty", penalty=1e20)
    assert textbook.normal_force[0] == 1e20 * 2.0**-62
    assert f"{textbook.normal_force[0]:.5g}" == "21.684"
    assert not textbook.certificate.passed
    perturbed = cq.solve(scene.problem(), method="perturbed-lagrangian", perturbation=1e20)
    assert f"{perturbed.normal_force[0]:.6g}" == "30.255"


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", ["bar_wall.toml", "truss_floor_printed.toml", "two_bars.toml"])
def test_the_perturbed_lagrangian_is_the_penalty_method(name):
    problem = SCENES[name].problem()
    for knob in (1e3, 1e4, 1e5, 1e6, 1e7, 1e8):
        penalty = cq.solve(problem, method="penalty", penalty=knob)
        perturbed = cq.solve(problem, method="perturbed-lagrangian", perturbation=knob)
        assert perturbed.normal_force == pytest.approx(penalty.normal_force, rel=1e-11)


@pytest.mark.slow
def test_four_orders_of_the_same_loads_end_in_three_states():
    names = ("", "_vertical_first", "_horizontal_first", "_overload")
    ends = [cq.run(SCENES[f"truss_friction{name}.toml"])[-1] for name in names]
    for end in ends:
        np.testing.assert_allclose(end.problem.load, [60.0, -100.0], rtol=1e-15)
        assert end.certificate.passed
    moved = [end.displacement[0] for end in ends]
    assert moved[0] == pytest.approx(moved[1], rel=1e-15)
    exact = [30058 / 30933965, 668831 / 598030000, 28327 / 22206950]
    np.testing.assert_allclose([moved[0], moved[2], moved[3]], exact, rtol=1e-14)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("steps", [1, 2, 7, 50])
def test_the_truss_slips_to_the_same_place_in_any_number_of_steps(steps):
    """Where the way is known to a step only: friction 0.3 is below the 3/5 from which on it would stick somewhere."""
    scene = SCENES["truss_friction.toml"].model_copy(update={"path": LoadPath(steps=steps)})
    end = judge(scene.model_copy(update={"expect": scene.expect[1:]}), Trial())
    assert end.met, [row for row in end.expectations if not row.ok]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["two_masses.toml", "two_masses_penalty.toml"])
@pytest.mark.parametrize("steps", [1, 7, pytest.param(99, marks=pytest.mark.slow)])
def test_the_events_of_two_masses_do_not_depend_on_the_steps(name, steps):
    """2.4525 N and 7.3575 N, by penalty springs 2.6773125 N and 7.848 N; 99 steps are those of the chapter."""
    path = LoadPath(steps=steps, events="exact", corners=SCENES[name].path.corners)
    judgement = judge(SCENES[name].model_copy(update={"path": path}), Trial())
    assert len(judgement.history) >= 3 * steps + 1
    assert judgement.met, [row for row in judgement.expectations if not row.ok]


def test_two_masses_in_steps_end_where_exact_events_lead():
    """Each step is exact for it: the normal forces are known, and the loads only grow or only fall within a leg."""
    scene = SCENES["two_masses.toml"]
    states = [claim for claim in scene.expect if claim.event is None and "energy" not in claim.quantity]
    states = [claim for claim in states if claim.quantity != "work of the loads"]
    path = LoadPath(steps=4, corners=scene.path.corners)
    scene = scene.model_copy(update={"path": path, "expect": tuple(states)})
    found = {trial.method: judge(scene, trial) for trial in trials(scene)}
    for method, judgement in found.items():
        stated = [claim for claim in states if (claim.method or "active-set") == method]
        assert len(judgement.expectations) == len(stated) >= 3
        assert judgement.met, [row for row in judgement.expectations if not row.ok]
    assert set(found) == {"active-set", "penalty"}


@pytest.mark.slow
def test_the_wrong_numbers_of_the_chapter_are_not_ours():
    """Example 2.18 prints 0.8357 mm and 31.337 kN, 2.19 prints 2.787 N and 7.878 N."""
    rows = [
        row
        for name in ("truss_friction.toml", "two_masses_penalty.toml")
        for row in judge(SCENES[name], Trial()).published
    ]
    wrong = {row.expected for row in rows if row.verdict == "wrong"}
    assert {0.8357e-3, 0.0013, 31.337, 2.787, 7.878} <= wrong
    assert all(row.ok for row in rows)


def test_the_spheres_case_tells_a_sphere_from_a_cylinder():
    """c/a = (1 - x)^(1/3), not its square root, which the claims of stick and traction leave out by far."""
    claims = {}
    for claim in SCENES["cattaneo_mindlin_sphere.toml"].expect:
        claims.setdefault(claim.quantity, claim)
    a, driven, peak = 1.0, 0.9, 3 * 140 / (2 * np.pi)
    for power, held in ((1 / 3, True), (1 / 2, False)):
        c = a * (1 - driven) ** power
        for quantity, value in (("stick half-width", c), ("friction traction", 0.4 * peak * (1 - c / a))):
            claim = claims[quantity]
            stated, size = float(claim.targets[0].si), 1e-3 if quantity.startswith("stick") else 1e6
            tolerance = float(claim.tolerance.si) * (1.0 if any(claim.tolerance.dimension) else stated)
            assert (abs(value * size - stated) < 1e-9 * stated) is held
            assert held or abs(value * size - stated) > 2 * tolerance
