"""A scheme of one's own is one class and one line: `impact` and case files find it, and its steps are certified."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import contactqp as cq
from contactqp.analysis.motion.schemes import SCHEMES, register
from contactqp.analysis.motion.schemes.scheme import Scheme, SchemeData, SchemeEntry, State
from contactqp.analysis.motion.step_contact import StepProblem, StepResult
from contactqp.model.arrays import Vector
from tests.analysis.motions import GAP, SPEED, rod_at_wall, thrown_rod

CASE = Path(__file__).parent.parent.parent / "cases" / "rod_at_wall.toml"


class StewartTrinkle(Scheme):
    """(M + h^2 K) v+ + E'P = M v + h (f+ - K u),  E_N v+ <= (g - E_N u) / h,  P_N >= 0,  u+ = u + h v+."""

    name = "stewart-trinkle"
    keeps_energy = False

    def __init__(self, body: SchemeData) -> None:
        self.body = body
        self.inertia = 1 / body.step**2
        self.templates = (body.template(body.mass + body.step**2 * body.stiffness),)

    def pose(self, state: State, load: Vector, next_load: Vector, answers: tuple[StepResult, ...]) -> StepProblem:
        del load, answers
        problem, h, u = self.body.problem, self.body.step, state.displacement
        impulse = self.body.mass @ state.velocity + h * (next_load - self.body.stiffness @ u)
        return StepProblem(impulse, (problem.gap - problem.normal @ u) / h, tie_value=problem.tie_value)

    def accept(self, state: State, answers: tuple[StepResult, ...]) -> State:
        found, h, u = answers[-1], self.body.step, state.displacement
        return State(u + h * found.unknown, found.normal / h, found.friction / h, found.tie / h, found.unknown, u)

    def answered(self, before: State, after: State) -> tuple[StepResult, ...]:
        del before
        v, h = after.velocity, self.body.step
        return (StepResult(v, h * after.normal_force, h * after.friction_force, h * after.tie_force, v),)


class Pulling(StewartTrinkle):
    """The same with the forces of the wrong sign in what it says it was answered."""

    def accept(self, state: State, answers: tuple[StepResult, ...]) -> State:
        ended = super().accept(state, answers)
        return State(ended.displacement, -ended.normal_force, *(np.zeros(0),) * 2, ended.velocity, ended.before)


@pytest.fixture
def registered() -> Iterator[SchemeEntry]:
    entry = SchemeEntry("stewart-trinkle", lambda body, _: StewartTrinkle(body))
    register(entry)
    yield entry
    del SCHEMES[entry.name]


def test_a_registered_scheme_moves_a_rod_that_stays_outside_of_the_wall(registered: SchemeEntry) -> None:
    problem, _ = rod_at_wall(100)
    history, _ = thrown_rod(registered.name)
    touching = history.normal_forces[:, 0] > 0
    assert touching.any()
    assert np.all(history.displacements @ problem.normal.toarray().T <= GAP * (1 + 1e-12))
    assert history.times[np.argmax(touching)] == pytest.approx(GAP / SPEED, abs=0.02)
    assert history[int(np.argmax(touching))].certificate.passed
    # The scheme damps the waves, so that the rod leaves the wall more slowly than it came.
    assert 0 < history.velocities[-1].mean() < SPEED


def test_a_case_file_finds_a_registered_scheme(registered: SchemeEntry, tmp_path: Path) -> None:
    text = CASE.read_text(encoding="utf-8").split("[[expect")[0]
    stated = [line for line in text.splitlines() if line.startswith("scheme")]
    assert stated
    case = tmp_path / "rod.toml"
    case.write_text(text.replace(stated[0], f'scheme = "{registered.name}"'), encoding="utf-8")
    assert cq.run(cq.load_scene(case)).normal_forces.max() > 0


def test_a_name_is_taken_once(registered: SchemeEntry) -> None:
    with pytest.raises(cq.InvalidProblem, match="scheme: expected a name of its own, got 'stewart-trinkle'"):
        register(registered)
    with pytest.raises(
        cq.InvalidProblem, match=r"scheme: expected one of moreau-jean, .*, stewart-trinkle, got 'magic'"
    ):
        thrown_rod("magic")


def test_forces_of_the_wrong_sign_are_not_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SCHEMES, "pulling", SchemeEntry("pulling", lambda body, _: Pulling(body)))
    history, _ = thrown_rod("pulling")
    pulls = int(np.argmin(history.normal_forces[:, 0]))
    assert history.normal_forces[pulls, 0] < 0
    assert not history[pulls].certificate.passed


@pytest.mark.sampled(4)
@pytest.mark.parametrize("scheme", ["newmark", "moreau-jean", "modified-mass", "modified-mass-central"])
def test_energy_that_a_scheme_makes_is_noted_with_the_schemes_that_make_none(scheme: str) -> None:
    """The rod's 500 J became thousands by the trapezoidal rule, and the history had no note."""
    history, _ = thrown_rod(scheme, elements=20, courant=0.5)
    notes = [note for note in history.notes if note.startswith("the energy grows")]
    assert bool(notes) == (scheme == "newmark")
    for note in notes:
        assert note.endswith("the scheme 'newmark' makes it: take 'modified-mass' or 'moreau-jean'")
        assert f"it reaches {max(energy.total for energy in history.energies):.6g}" in note


def test_energy_that_a_load_puts_in_is_not_noted() -> None:
    """A ball that is pushed against a wall gains all its energy from the load."""
    ball = cq.ContactProblem(stiffness=[[0.0]], load=[3.0], normal=[[1.0]], gap=[1.0])
    history = cq.impact(ball, [2.0], [0.0], [0.0], duration=1.1, time_step=0.01, restitution=1.0)
    assert history.energies[-1].total > 2.0
    assert not any(note.startswith("the energy") for note in history.notes)


def test_a_single_mass_that_its_scheme_leaves_at_the_stop_is_told() -> None:
    """The contact-stabilised scheme takes momentum by the body behind the contact: here there is none."""
    spring = cq.ContactProblem([[1.0]], [0.0], [[1.0]], [0.0])
    history = cq.impact(spring, [1.0], [-1.0], [0.0], 3.0, 1e-2, "deuflhard-krause-ertel")
    assert history.displacements[-1, 0] == 0.0
    assert history.velocities[-1, 0] == pytest.approx(1.0, abs=1e-4)
    (note,) = history.notes
    assert "contact 0 rests at its obstacle in step 160 and keeps a velocity of 1 towards it" in note
    assert "100% of the energy" in note
    bouncing = cq.impact(spring, [1.0], [-1.0], [0.0], 3.0, 1e-2, "moreau-jean", restitution=1.0)
    assert not [note for note in bouncing.notes if "keeps a velocity" in note]


def test_a_mesh_behind_the_contact_takes_its_momentum() -> None:
    history, _ = thrown_rod("deuflhard-krause-ertel", courant=1.0)
    assert not [note for note in history.notes if "keeps a velocity" in note]


@pytest.mark.parametrize("scheme", ["deuflhard-krause-ertel", "modified-mass"])
def test_a_tip_without_mass_on_a_spring_pushes_as_the_closed_form_says(scheme: str) -> None:
    """A mass of 1 behind a spring of 100 meets a wall with 1: the force is 10 sin 10 t for pi/10, then it flies back.

    A spring of 50 holds the tip along the wall against a load of 3; friction of 0.3 takes its part of that.
    """
    K = np.array([[100.0, -100.0, 0.0], [-100.0, 100.0, 0.0], [0.0, 0.0, 50.0]])
    tip = cq.ContactProblem(K, [0.0, 0.0, 3.0], [[0.0, 1.0, 0.0]], [0.1], tangent=[[0.0, 0.0, 1.0]], friction=0.3)
    history = cq.impact(tip, [1.0, 0.0, 0.0], [0, 0, 0.06], [1.0, 1.0, 0.0], 0.6, 1e-3, scheme)
    since = history.times - 0.1
    force = np.where((since > 0) & (since < np.pi / 10), 10 * np.sin(10 * since), 0.0)
    np.testing.assert_allclose(history.normal_forces[:, 0], force, atol=0.02)
    np.testing.assert_allclose(history.displacements[:, 2] * 50 + history.friction_forces[:, 0, 0], 3.0, rtol=1e-9)
    assert np.all(abs(history.friction_forces[:, 0, 0]) <= 0.3 * history.normal_forces[:, 0] * (1 + 1e-12))
    assert history.velocities[-1, 0] == pytest.approx(-1.0, abs=1e-3)
    assert history.energies[-1].total == pytest.approx(history.energies[0].total, rel=1e-4)
    assert all(instant.certificate.passed for instant in history[90:450:40])


def test_beams_between_point_masses_move_with_the_contact_stabilised_scheme() -> None:
    """Their rotations have no mass, and keep the motion that rotations condensed out of the stiffness have."""
    K = np.array([[24.0, 0.0, -12.0, 6.0], [0.0, 8.0, -6.0, 2.0], [-12.0, -6.0, 12.0, -6.0], [6.0, 2.0, -6.0, 4.0]])
    turns, moves = [1, 3], [0, 2]
    inner = np.linalg.solve(K[np.ix_(turns, turns)], K[np.ix_(turns, moves)])
    condensed = K[np.ix_(moves, moves)] - K[np.ix_(moves, turns)] @ inner
    stop, scheme = {"normal": [[0.0, 0.0, -1.0, 0.0]], "gap": [0.2]}, "deuflhard-krause-ertel"
    beam = cq.impact(
        cq.ContactProblem(K, np.zeros(4), **stop), [1, 0, 1, 0], np.zeros(4), [0, 0, -1, 0], 3, 0.01, scheme
    )
    stop["normal"] = [[0.0, -1.0]]
    small = cq.impact(cq.ContactProblem(condensed, [0, 0], **stop), [1, 1], np.zeros(2), [0, -1], 3, 0.01, scheme)
    assert small.normal_forces.any()
    np.testing.assert_allclose(beam.displacements[:, moves], small.displacements, atol=1e-12)
    np.testing.assert_allclose(beam.normal_forces, small.normal_forces, atol=1e-9)


def test_a_start_whose_energy_moves_off_the_contacts_is_told() -> None:
    """Of two masses the one at the wall has all of the motion: without its mass nothing moves."""
    problem = cq.ContactProblem(stiffness=[[2.0, -1.0], [-1.0, 1.0]], load=[0.0, 0.0], normal=[[0.0, 1.0]], gap=[9.0])
    given = dict(displacement=[0.0, 0.0], duration=1.0, time_step=0.1, scheme="modified-mass")
    lost = cq.impact(problem, [1.0, 2.0], velocity=[0.0, 3.0], **given)
    assert lost.energies[0].kinetic == 0
    assert any("start is 0, with the stated mass 9" in note for note in lost.notes), lost.notes
    kept = cq.impact(problem, [1.0, 2.0], velocity=[1.0, 2.0], **given | {"scheme": "moreau-jean"})
    assert not any("kinetic energy" in note for note in kept.notes)
