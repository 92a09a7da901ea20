"""Bodies that floats leave free to slide: their forces are enclosed, and what holds them carries rounding only."""

from __future__ import annotations

import pathlib
import re
from dataclasses import replace
from fractions import Fraction as F

import numpy as np
import pytest

import contactqp as cq
from contactqp.cli import main
from contactqp.oracle.exact.enclosed_answer import carried, enclose, hold
from contactqp.oracle.exact.refinement import fixed, refine
from contactqp.scene.building import build

CASES = pathlib.Path(__file__).parents[2] / "cases"


@pytest.mark.slow
def test_bodies_whose_floats_are_indefinite_are_enclosed_as_local_minima() -> None:
    """Blocks patched together: 50 unknowns, small enough for rationals, but rounding has made K indefinite."""
    scene = cq.load_scene(CASES / "patch_two_blocks.toml")
    answer = cq.exact(scene)
    assert not answer.rational
    assert any("strict local minimum" in line for line in answer.proof)
    shares = [F(1, 10), F(1, 5), F(1, 5), F(1, 5), F(1, 5), F(1, 10)]  # kN: a uniform pressure
    assert all(abs(x - y) < F(1, 10**14) for x, y in zip(answer.normal_force, shares, strict=True))
    with pytest.raises(cq.Unsupported, match="rounding has made it indefinite"):
        cq.exact(build(scene).problem, enclose=False)


@pytest.fixture(scope="module")
def stack() -> cq.ExactSolution:
    return cq.exact(cq.load_scene(CASES / "stacked_blocks.toml"))


@pytest.mark.slow
def test_a_stack_that_may_slide_has_its_forces_to_many_digits(stack: cq.ExactSolution) -> None:
    assert not stack.rational
    assert len(stack.free_motions) == 3
    assert any(note.startswith("free motions are held at lower node") for note in stack.notes)
    assert any("strict local minimum" in line for line in stack.proof)  # not the only one: it may slide
    assert stack.radius is not None
    assert np.all(stack.radius.normal_force < 1e-30)
    floats = cq.solve(stack.problem)
    assert stack.doubles.normal_force == pytest.approx(floats.normal_force, rel=1e-9)


@pytest.mark.slow
def test_its_joints_carry_all_vertical_load(stack: cq.ExactSolution) -> None:
    """With E u = 1 for the body's motion: what pushes on it from below less what pushes from above is its load."""
    problem = stack.problem
    for body in ("lower", "middle", "upper"):
        up = np.array([dof.startswith(body) and dof.endswith("y") for dof in map(problem.dof_name, range(374))])
        push = problem.normal[:, np.flatnonzero(up)].sum(axis=1)
        pushed = sum((F(float(x)) * y for x, y in zip(np.ravel(push), stack.normal_force, strict=True)), F(0))
        load = sum((F(float(x)) for x in problem.load[up]), F(0))
        held = problem.stiffness.toarray()[:, up].sum()  # the floor, where it is no contact
        assert held == pytest.approx(0.0, abs=1e-6)
        assert float(pushed - load) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
def test_the_command_prints_a_body_that_may_slide(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(["oracle", str(CASES / "floating_disc.toml")])
    assert left.value.code == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "free motions are held at disc node" in shown
    assert "rest 665" in shown


@pytest.mark.slow
def test_holding_that_carries_more_than_rounding_is_refused() -> None:
    problem = build(cq.load_scene(CASES / "stacked_blocks.toml")).problem
    held = hold(problem, cq.solve(problem))
    assert len(held.unknowns) == 3
    refined = refine(held.problem)
    radius = enclose(refined).tie_force
    assert "at most" in carried(held, refined, radius)
    pushed = fixed(np.array([0.0, 1e-3, 0.0]))
    with pytest.raises(cq.NotCertified, match=r"motions that floats call free take 0\.001"):
        carried(held, replace(refined, tie_force=pushed), radius)
    with pytest.raises(cq.NotCertified, match="take"):
        carried(held, refined, np.full(3, np.nan))


@pytest.mark.sampled(2)
@pytest.mark.parametrize("stiffness", [[[1.0, -1.0], [-1.0, 1.0]], [[0.0, 0.0], [0.0, 0.0]]])
def test_a_motion_that_two_contacts_without_force_block_is_not_free(stiffness: list[list[float]]) -> None:
    """Both move by (1, 1) only, contact 1 forbids it to the left and contact 2 to the right: u = (0.5, -1.5)."""
    load = [-2.0, 2.0] if stiffness[0][0] else [-4.0, 4.0]
    problem = cq.ContactProblem(stiffness, load, [[-2.0, 2.0], [-2.0, -2.0], [0.0, 2.0]], [-4.0, 2.0, -3.0])
    solution, exact = cq.solve(problem), cq.exact(problem)
    assert solution.displacement == pytest.approx([0.5, -1.5], rel=1e-14)
    assert not solution.free_motions
    assert not exact.free_motions
    roomy = problem.replace(gap=[-4.0, 2.5, -3.0])
    assert len(cq.solve(roomy).free_motions) == len(cq.exact(roomy).free_motions) == 1


def test_rows_that_oppose_each_other_along_free_motions_alone_block_them_too() -> None:
    """No forces of contacts 0 and 2 balance each other, for the spring between the unknowns feels them."""
    problem = cq.ContactProblem(
        [[2.0, -2.0], [-2.0, 2.0]], [0.0, 0.0], [[0.0, -2.0], [-1.0, -1.0], [2.0, -1.0]], [2.0, 2.0, -1.0]
    )
    assert cq.solve(problem).displacement == pytest.approx([-1.0, -1.0], rel=1e-14)
    assert not cq.solve(problem).free_motions
    assert not cq.exact(problem).free_motions


@pytest.mark.slow
def test_what_is_refused_of_a_held_stack_comes_with_the_answer_of_the_free_one(tmp_path: pathlib.Path) -> None:
    """A block a hundred million times as stiff as the others: no enclosure, and three ties less than the held stack."""
    text = (CASES / "stacked_blocks.toml").read_text()
    head, upper = text.rsplit("[[bodies]]", 1)
    upper = re.sub(r'modulus = "[^"]*"', 'modulus = "2147483647 GPa"', upper, count=1)
    file = tmp_path / "stack.toml"
    file.write_text(f"{head}[[bodies]]{upper}")
    scene = cq.load_scene(file)
    with pytest.raises((cq.NotCertified, cq.NotConverged)) as refused:
        cq.exact(scene, enclose=True)
    assert refused.value.solution.tie_force.shape == (0,)
    with pytest.raises(cq.ContactQPError):
        cq.exact(scene)
