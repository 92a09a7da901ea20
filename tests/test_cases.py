"""Every shipped case, by the methods it speaks of and by every classical method: what it claims holds."""

from pathlib import Path

import pytest

import contactqp as cq
from contactqp.scene.judging import Judgement, judge_all

FOLDER = Path(__file__).parents[1] / "cases"
CASES = sorted(file.name for file in FOLDER.glob("*.toml"))
# Without a contact there is nothing to enforce: those cases are judged above.
TOUCHING = [name for name in CASES if cq.load_scene(FOLDER / name).contacts]
EXACT_METHODS = ("lagrange-multiplier", "master-slave", "augmented-lagrangian", "lemke", "osqp", "clarabel")


def test_every_static_frictionless_example_is_there():
    sources = " ".join(cq.load_scene(FOLDER / name).source for name in CASES)
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
    ):
        assert words in sources


@pytest.mark.parametrize("name", CASES)
def test_what_a_case_claims_holds(name):
    scene = cq.load_scene(FOLDER / name)
    outcomes = judge_all(scene)
    assert outcomes
    for outcome in outcomes:
        assert isinstance(outcome, Judgement), outcome
        rows = (*outcome.expectations, *outcome.published)
        assert rows
        assert all(row.ok for row in rows), [row for row in rows if not row.ok]


@pytest.mark.parametrize("method", EXACT_METHODS)
@pytest.mark.parametrize("name", TOUCHING)
def test_every_exact_method_gives_the_exact_answer(name, method):
    """To 1e-12 of the exact values, unless the case itself says otherwise."""
    scene = cq.load_scene(FOLDER / name)
    for outcome in judge_all(scene, [method]):
        assert isinstance(outcome, Judgement), outcome.message
        assert outcome.solution.certificate.passed
        assert outcome.met, [row for row in outcome.expectations if not row.ok]


@pytest.mark.parametrize("name", CASES)
def test_expectations_are_sharp(name):
    """Exact answers are asked for to 1e-12, penalised ones to 1e-10, and zeros to a stated size."""
    scene = cq.load_scene(FOLDER / name)
    assert any(claim.method is None for claim in scene.expect)
    for claim in scene.expect:
        if not any(claim.tolerance.dimension):
            assert float(claim.tolerance.si) <= (1e-12 if claim.method is None else 1e-10)


def test_the_contact_load_is_found_exactly():
    history = cq.run(cq.load_scene(FOLDER / "bar_wall_path.toml"))
    (event,) = history.events
    assert (event.kind, event.contact, event.time) == ("closed", 0, 0.525)
    assert history[-1].normal_force[0] == pytest.approx(142.5, rel=1e-14)
    assert len(cq.run(cq.load_scene(FOLDER / "bar_wall.toml"))) == 1


def test_the_last_row_of_table_2_1_is_one_place_of_the_gap_times_the_penalty():
    scene = cq.load_scene(FOLDER / "truss_floor_printed.toml")
    textbook = cq.solve(scene.problem(), method="penalty", penalty=1e20)
    assert textbook.normal_force[0] == 1e20 * 2.0**-62
    assert f"{textbook.normal_force[0]:.5g}" == "21.684"
    assert not textbook.certificate.passed
    perturbed = cq.solve(scene.problem(), method="perturbed-lagrangian", perturbation=1e20)
    assert f"{perturbed.normal_force[0]:.6g}" == "30.255"


@pytest.mark.parametrize("name", ["bar_wall.toml", "truss_floor_printed.toml", "two_bars.toml"])
def test_the_perturbed_lagrangian_is_the_penalty_method(name):
    problem = cq.load_scene(FOLDER / name).problem()
    for knob in (1e3, 1e4, 1e5, 1e6, 1e7, 1e8):
        penalty = cq.solve(problem, method="penalty", penalty=knob)
        perturbed = cq.solve(problem, method="perturbed-lagrangian", perturbation=knob)
        assert perturbed.normal_force == pytest.approx(penalty.normal_force, rel=1e-11)
