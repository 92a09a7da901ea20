"""Answers without geometry are drawn as bars; `draw` takes solutions, histories, scenes and bodies."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq

pytest.importorskip("matplotlib")
UNITS = {"length": "mm", "force": "kN"}


def chain(contacts: int, friction: float | None = None) -> cq.ContactProblem:
    """A chain of springs under a load that goes to and fro, with a wall beside every second unknown."""
    n = 2 * contacts
    stiffness = 100 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    rubs = {} if friction is None else dict(tangent=np.eye(n)[1::2], friction=friction)
    names = [f"foot.{i}" for i in range(contacts)]
    return cq.ContactProblem(
        stiffness, 5 * np.sin(np.arange(n) / 3), np.eye(n)[::2], np.full(contacts, 0.1), contact_names=names,
        units=UNITS, **rubs,
    )  # fmt: skip


def panel(figure, name):
    (found,) = [axes for axes in figure.axes if axes.get_ylabel().startswith(name)]
    return found


def heights(axes):
    return np.array([bar.get_height() for bar in axes.patches])


def test_every_contact_has_a_bar_of_its_force_and_its_gap() -> None:
    solution = cq.solve(chain(6))
    figure = cq.draw(solution, title="a chain")
    assert np.any(solution.normal_force > 0)
    assert np.any(solution.gap > 0)
    np.testing.assert_array_equal(heights(panel(figure, "normal force")), solution.normal_force)
    np.testing.assert_array_equal(heights(panel(figure, "gap")), solution.gap)
    assert [axes.get_ylabel() for axes in figure.axes] == ["normal force [kN]", "gap [mm]"]
    assert [label.get_text() for label in figure.axes[-1].get_xticklabels()] == [f"foot.{i}" for i in range(6)]
    assert figure.get_suptitle() == "a chain\nActive-set: passed, proven"


def test_friction_stands_within_its_bound() -> None:
    solution = cq.solve(chain(6, friction=0.3))
    axes = panel(cq.draw(solution), "friction")
    np.testing.assert_array_equal(heights(axes), solution.friction_force[:, 0])
    upper, lower = (np.asarray(line.get_ydata()) for line in axes.get_lines()[:2])
    np.testing.assert_allclose(upper, 0.3 * solution.normal_force)
    np.testing.assert_allclose(lower, -upper)


def test_a_refused_answer_says_so() -> None:
    with pytest.raises(cq.NotConverged) as stopped:
        cq.solve(chain(6), "osqp", polish=False, max_iter=1)
    assert "REFUSED" in cq.draw(stopped.value.solution).get_suptitle()


def test_of_many_contacts_lines_are_drawn() -> None:
    solution = cq.solve(chain(200))
    (lines,) = panel(cq.draw(solution), "normal force").collections
    np.testing.assert_array_equal([segment[1, 1] for segment in lines.get_segments()], solution.normal_force)


def test_where_all_gaps_close_the_axis_still_has_their_size() -> None:
    wall = cq.ContactProblem(stiffness=[[157500.0]], load=[300.0], normal=[[1.0]], gap=[1e-3])
    low, high = panel(cq.draw(cq.solve(wall)), "gap").get_ylim()
    assert low < 0
    assert 1e-3 < high < 2e-3


def test_a_solution_plots_itself_into_a_file(tmp_path) -> None:
    cq.solve(chain(3)).plot(tmp_path / "chain.png", title="a chain")
    assert (tmp_path / "chain.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.slow
def test_a_history_is_drawn_over_its_load_and_one_of_an_instant_as_its_solution() -> None:
    problem = chain(3)
    path = cq.follow_path(problem, [problem.load], steps=4)
    assert any("force" in axes.get_ylabel() for axes in path.plot().figure.axes)
    assert len(path.plot().axes) > 2
    assert len(cq.run("cases/bar_wall.toml").plot().axes) == 2


def test_a_scene_and_bodies_are_drawn_on_their_geometry() -> None:
    history = cq.run("cases/bar_wall.toml")
    figure = cq.draw(history, scene="cases/bar_wall.toml")
    assert "A bar and a rigid wall" in figure.get_suptitle()
    body = cq.Body(cq.rectangle(1.0, 0.5, (8, 4)), cq.Material(1.0, 0.3), "plane-strain", name="block")
    structure = cq.Structure([body])
    system = structure.assemble([cq.Support("block", "top", 0), cq.Support("block", "top", 1, -0.02)])
    contact = cq.pair(structure.surface("block", "bottom"), cq.Paraboloid([0.5, 0.0], [0.0, 1.0], 5.0))
    solution = cq.solve(system.problem([contact]))
    drawn = cq.draw(solution, system=system, contacts=[contact])
    assert any("displacement" in axes.get_ylabel() for axes in drawn.axes)
    with pytest.raises(cq.InvalidProblem, match="expected a scene or a system, got both"):
        cq.draw(solution, scene="cases/bar_wall.toml", system=system)


def test_what_cannot_be_drawn_is_refused_in_one_line(tmp_path) -> None:
    solution = cq.solve(chain(3))
    with pytest.raises(cq.InvalidProblem, match=r"\.png"):
        solution.plot(tmp_path / "chain.gif")
    with pytest.raises(cq.InvalidProblem, match="draw: expected the scene of this solution, which has 6 unknowns"):
        cq.draw(solution, scene="bar_wall")
    with pytest.raises(cq.InvalidProblem, match="draw: answer: expected a Solution or a History"):
        cq.draw([1.0])


def test_load_cases_are_curves_over_their_numbers(tmp_path) -> None:
    problem, phases = chain(6, friction=0.3), np.linspace(0, 3, 8)
    many = cq.solve_many(problem, loads=[8 * np.sin(np.arange(12) / 3 + x) * np.sin(x) for x in phases])
    figure = many.plot(tmp_path / "cases.png", title="a chain")
    assert (tmp_path / "cases.png").read_bytes().startswith(b"\x89PNG")
    assert figure.get_suptitle() == "a chain\n8 load cases, 8 passed"
    assert [axes.get_ylabel() for axes in figure.axes] == ["gap\n[mm]", "normal force\n[kN]", "friction force\n[kN]"]
    curves = {line.get_gid(): line.get_ydata() for line in panel(figure, "normal force").get_lines()}
    assert len(curves) == 6  # five contacts, and all together
    np.testing.assert_array_equal(curves["sum of all 6"], many.normal_force.sum(axis=1))
    worst = int(np.argmax(many.normal_force.max(axis=0)))
    np.testing.assert_array_equal(curves[f"foot.{worst}"], many.normal_force[:, worst])


def test_a_few_load_cases_are_called_by_their_names() -> None:
    many = cq.solve_many(chain(3), loads=[[1.0, 0.0, 2.0, 0.0, 1.0, 0.0], [0.0, 0.0, 5.0, 0.0, 1.0, 0.0]])
    figure = many.plot(names=["dead weight", "$storm$"])
    figure.canvas.draw()
    assert [label.get_text() for label in figure.axes[-1].get_xticklabels()] == ["dead weight", r"\$storm\$"]
    with pytest.raises(cq.InvalidProblem, match="names: expected"):
        many.plot(names=["dead weight"])


def test_friction_beside_almost_no_normal_force_is_drawn_at_its_own_size() -> None:
    """With friction 1e20 a normal force of 3e-20 holds 3: limits of the axis made of 3e-20 would be one number."""
    jammed = cq.ContactProblem(np.eye(2), [0.0, 3.0], [[1.0, 0.0]], [0.0], [[0.0, 1.0]], friction=1e20)
    many = cq.solve_many(jammed, loads=[[3.4e-20, 3.0]])
    assert many.passed.all()
    low, high = panel(many.plot(), "friction force").get_ylim()
    assert low < many.friction_force[0, 0, 0] < high


def test_load_cases_without_an_answer_are_upright_lines() -> None:
    floating = cq.ContactProblem([[1.0, -1.0], [-1.0, 1.0]], [0.0, 0.0], [[0.0, 1.0]], [0.1])
    figure = cq.draw(cq.solve_many(floating, loads=[[1.0, 0.0], [-1.0, 0.0], [2.0, 0.0]]))
    marks = [line for line in panel(figure, "normal force").get_lines() if line.get_gid() == "failed case"]
    assert [mark.get_xdata()[0] for mark in marks] == [1.0]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["without a certified answer: 1"]
    free = cq.solve_many(floating.replace(normal=np.zeros((0, 2)), gap=[]), loads=[[1.0, -1.0]])
    with pytest.raises(cq.InvalidProblem, match="expected cases with contacts"):
        free.plot()
    with pytest.raises(cq.InvalidProblem, match="many load cases are drawn as curves"):
        cq.draw(cq.solve_many(floating, loads=[[1.0, 0.0]]), scene="bar_wall")
