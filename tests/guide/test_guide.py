"""What the pages of docs/guide claim beside what they print, which tests/docs holds."""

from __future__ import annotations

import pathlib
import re

import numpy as np
import pytest

import contactqp as cq

GUIDE = pathlib.Path(__file__).parents[2] / "docs" / "guide"


def text_of(page: str) -> str:
    return (GUIDE / f"{page}.md").read_text(encoding="utf-8")


def block(page: str, language: str, place: int = 0) -> str:
    found = re.findall(rf"```{language}\n(.*?)```", text_of(page), re.DOTALL)
    return str(found[place])


@pytest.mark.slow
def test_the_body_example_presses_a_block_on_a_paraboloid() -> None:
    scope: dict[str, object] = {}
    exec(compile(block("bodies", "python"), "bodies.md", "exec"), scope)
    solution, contact = scope["solution"], scope["contact"]
    assert isinstance(solution, cq.Solution)
    assert solution.certificate.passed
    assert solution.work.factorisations == 1
    pressure = scope["pressure"]
    assert isinstance(pressure, np.ndarray)
    assert pressure @ contact.area == pytest.approx(solution.normal_force.sum())  # type: ignore[attr-defined]
    assert 0.2 < np.mean(solution.normal_force > 0) < 0.9


@pytest.mark.slow
def test_the_example_with_friction_slips_and_dissipates() -> None:
    scope: dict[str, object] = {}
    exec(compile(block("friction", "python"), "friction.md", "exec"), scope)
    slipping, path = scope["slipping"], scope["path"]
    assert isinstance(slipping, cq.Solution)
    assert isinstance(path, cq.History)
    assert np.allclose(slipping.friction_force, [[0.18, 0.24]], rtol=1e-12)
    assert np.allclose(slipping.slip, [[0.06, 0.08]], rtol=1e-12)
    assert path.energies[-1].dissipated == pytest.approx(0.3 * 5 * 0.5, rel=1e-9)


@pytest.mark.slow
def test_the_rod_of_the_example_bounces_and_every_scheme_leaves_the_energy_of_the_table() -> None:
    scope: dict[str, object] = {}
    exec(compile(block("impact", "python"), "impact.md", "exec"), scope)
    history = scope["history"]
    assert isinstance(history, cq.MotionHistory)
    assert [(event.kind, round(event.time, 2)) for event in history.events] == [("closed", 0.5), ("opened", 1.17)]
    assert history.normal_forces[300, 0] == pytest.approx(300, rel=1e-3)
    assert history.energies[0].total == pytest.approx(500)
    table = re.findall(r"^\| `([a-z-]+)` \| .* \| ([\d .]+) \|$", text_of("impact"), re.MULTILINE)
    assert len(table) == 6
    table.append(("newmark", "11 400"))  # what blows up is not known to more digits
    n = 100
    for scheme, energy in table:
        step = 0.1 / 30 / (2 if scheme == "modified-mass-central" else 1)
        moved = cq.impact(
            scope["rod"],  # type: ignore[arg-type]
            scope["middle"] / 2 * 0.1,  # type: ignore[operator]
            np.zeros(n + 1),
            np.full(n + 1, -10.0),
            2.0,
            step,
            scheme,
        )
        assert moved.energies[-1].total == pytest.approx(
            float(energy.replace(" ", "")), rel=0.01 if scheme == "newmark" else 1e-4
        ), scheme


@pytest.mark.slow
def test_the_arch_of_the_example_snaps_onto_its_floor() -> None:
    scope: dict[str, object] = {}
    exec(compile(block("large_deformation", "python"), "large_deformation.md", "exec"), scope)
    last = scope["snapped"][-1]  # type: ignore[index]
    np.testing.assert_allclose(last.displacement, [0, -0.3], atol=1e-15)
    assert last.normal_force[0] == pytest.approx(1 + 100 / 1.04**1.5 * 0.003, rel=1e-12)
