"""What `impact` refuses, warns of, and how it fails: with words, and with the history so far."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.analysis.motion.mass_matrix import critical_step, slowest_frequency
from tests.analysis.motions import LENGTH, WAVE, rod_at_wall, rod_matrices, thrown_rod

BALL: dict[str, Any] = dict(
    problem=cq.ContactProblem(stiffness=[[0.0]], load=[0.0], normal=[[1.0]], gap=[1.0], contact_names=["wall"]),
    mass=[2.0],
    displacement=[0.0],
    velocity=[4.0],
    duration=1.0,
    time_step=0.1,
)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(problem=3), "impact: problem: expected a ContactProblem, got 3"),
        (dict(mass=[1.0, 2.0]), r"mass: expected a matrix \(1, 1\) or its diagonal \(1,\), got shape \(2,\)"),
        (dict(mass="heavy"), "mass: expected real numbers, got str"),
        (dict(mass=[-1.0]), "mass: expected no negative diagonal, got -1 at unknown 0"),
        (dict(mass=[np.nan]), "mass: expected finite numbers"),
        (dict(mass=[0.0]), "without any inertia or stiffness"),
        (dict(mass=[0.0], scheme="paoli-schatzman"), "paoli-schatzman needs mass at every unknown; unknown 0 has none"),
        (dict(displacement=[1.5]), "displacement: wall overlaps by 0.5 at the start"),
        (dict(displacement=[0.0, 1.0]), r"displacement: expected shape \(1,\), got \(2,\)"),
        (dict(velocity=[np.inf]), "velocity"),
        (dict(duration=0.0), "duration: expected a positive number, got 0.0"),
        (dict(time_step=-1), "time_step: expected a positive number, got -1"),
        (dict(time_step=1e-200), "time_step: expected a step whose square is a number, got 1e-200"),
        (dict(scheme="magic"), "scheme: expected one of moreau-jean, .*, got 'magic'"),
        (dict(theta=0.3), "theta: expected a number from 0.5 to 1, got 0.3"),
        (dict(restitution=1.2), "restitution: expected a number from 0 to 1, got 1.2"),
        (
            dict(restitution=0.5, scheme="newmark"),
            "restitution: the scheme 'newmark' has none, only moreau-jean, paoli",
        ),
        (dict(penalty=1e3), "penalty: the scheme 'moreau-jean' has none, only penalty"),
        (
            dict(damping=[[1.0]]),
            "impact: unknown argument 'damping'; beside options of 'active-set' it takes ",
        ),
        (dict(time_step=2.0, duration=1.5), "time_step: expected one no longer than the duration, 1.5, got 2"),
        (dict(scheme="penalty"), "penalty: the scheme 'penalty' has no default stiffness"),
        (dict(scheme="penalty", penalty=-1.0), "penalty: expected a positive number, got -1.0"),
        (dict(duration=1e300, time_step=1e-100), "duration: 1e\\+300 takes more steps of 1e-100 than can be counted"),
        (dict(start_time="noon"), "start_time: expected a number, got 'noon'"),
        (dict(start_time=np.nan), "start_time: expected a finite number, got nan"),
        (dict(theta=np.array([0.5, 0.6])), "theta: expected a number, got ndarray of shape"),
        (dict(restituion=0.5, duration=0.1), "unknown argument 'restituion' .do you mean 'restitution'"),
        (dict(tolerance=-1.0, duration=0.1), "tolerance: expected a positive number, got -1"),
        (dict(load=3.0), "load: expected a function, got 3.0"),
        (dict(load=lambda t: [0.0, t]), r"load at time 0: expected shape \(1,\), got \(2,\)"),
        (dict(scheme="modified-mass"), "their mass cannot be moved to others of the same body; take .*'moreau-jean'"),
    ],
)
def test_bad_arguments_get_one_clear_line(change: dict[str, Any], message: str) -> None:
    with pytest.raises(cq.InvalidProblem, match=message) as refused:
        cq.impact(**(BALL | change))
    assert "\n" not in str(refused.value)


def test_methods_that_are_approximate_and_friction_with_springs_are_unsupported() -> None:
    with pytest.raises(cq.Unsupported, match="penalty: approximate by design"):
        cq.impact(**BALL, method="penalty")
    rough = cq.ContactProblem([[1.0, 0], [0, 1.0]], [0, 0], [[1.0, 0]], [1.0], [[0, 1.0]], friction=0.3)
    with pytest.raises(cq.Unsupported, match="penalty: it takes no contacts with friction"):
        cq.impact(rough, [1.0, 1.0], [0, 0], [0, 0], 1.0, 0.1, "penalty", penalty=1.0)
    tied = cq.ContactProblem([[1.0, 0], [0, 1.0]], [0, 0], [[1.0, 0]], [1.0], tie=[[0, 1.0]])
    with pytest.raises(cq.Unsupported, match="modified-mass-central: ties"):
        cq.impact(tied, [0.0, 1.0], [0, 0], [0, 0], 1.0, 0.1, "modified-mass-central")


def test_asymmetric_and_incomplete_masses_are_refused() -> None:
    pair = cq.ContactProblem(1e4 * np.eye(2), [0, 0], [[1.0, 0]], [1.0])
    for mass, message in (
        ([[1.0, 0.5], [0.0, 1.0]], "symmetric"),
        ([[1.0, 0.5], [0.5, 0.0]], "not positive semidefinite"),
        ([[1.0, 1.5], [1.5, 1.0]], "expected a positive semidefinite matrix, got an indefinite one"),
    ):
        with pytest.raises(cq.InvalidProblem, match=message):
            cq.impact(pair, mass, [0, 0], [0, 0], 1.0, 0.1)


def test_a_mass_may_be_very_small() -> None:
    """Its product with another underflows; it is a mass all the same."""
    specks = cq.ContactProblem(np.zeros((2, 2)), [1e-200, 0], [[1.0, 0]], [1.0])
    history = cq.impact(specks, np.diag([1e-200, 1e-200]), [0, 0], [0, 0], 1.0, 0.1)
    assert history.velocities[-1, 0] == pytest.approx(1.0)


def test_dependent_ties_are_refused() -> None:
    tied = cq.ContactProblem(np.eye(2), [0, 0], [[1.0, 0]], [1.0], tie=[[0, 1.0], [0, 2.0]])
    with pytest.raises(cq.InvalidProblem, match="tie: expected independent rows"):
        cq.impact(tied, [1.0, 1.0], [0, 0], [0, 0], 1.0, 0.1)


@pytest.mark.parametrize("scheme", ["paoli-schatzman", "modified-mass-central", "penalty"])
def test_explicit_steps_beyond_their_limit_are_refused_with_both_numbers(scheme: str) -> None:
    knobs = {"penalty": 1.0} if scheme == "penalty" else {}
    with pytest.raises(cq.InvalidProblem, match=rf"{scheme} is stable up to 0\.00\d+ .*, got 0\.00[34]"):
        thrown_rod(scheme, courant=1.05 if scheme != "modified-mass-central" else 1.2, **knobs)


@pytest.mark.parametrize("elements", [50, 400])
def test_the_critical_step_of_a_rod_is_a_wave_through_an_element(elements: int) -> None:
    K, M = rod_matrices(elements)
    assert critical_step(M, K) == pytest.approx(LENGTH / elements / WAVE, rel=1e-6)
    assert critical_step(M, 0 * K) == np.inf


@pytest.mark.slow
def test_a_step_that_is_too_long_for_a_contact_is_named_with_both_times() -> None:
    """The course chapter's rod: 0.2 m of steel at 0.5 m/s, steps of 0.01 s where contact lasts 7.7e-5 s."""
    length, modulus, density, area, n = 0.2, 2.1e11, 7850.0, np.pi * 0.008**2, 100
    h, middle = length / n, np.r_[1.0, 2 * np.ones(n - 1), 1.0]
    K = sp.csc_matrix(sp.diags([middle, -np.ones(n), -np.ones(n)], [0, 1, -1]) * modulus * area / h)
    M = sp.diags(middle / 2 * density * area * h)
    rows = sp.csr_matrix(([1.0], ([0], [n])), shape=(1, n + 1))
    problem = cq.ContactProblem(K, np.zeros(n + 1), rows, [0.05])
    still, velocity = np.zeros(n + 1), np.full(n + 1, 0.5)
    for scheme in ("moreau-jean", "newmark", "backward-euler", "deuflhard-krause-ertel", "modified-mass"):
        with pytest.warns(cq.TimeStepWarning, match=r"time step 0\.01 is too long .* lasts about 7\.7e-05") as caught:
            history = cq.impact(problem, M, still, velocity, 0.15, 0.01, scheme)
        assert _of_steps(history) == [str(caught[0].message)]
    # Resolved: no warning, which the test settings would make an error.
    near = problem.replace(gap=[5e-4])
    resolved = cq.impact(near, M, still, velocity, 0.0012, 1e-6)
    assert _of_steps(resolved) == []
    assert [event.kind for event in resolved.events][:1] == ["closed"]


def test_the_slowest_vibration_of_a_held_rod_is_found() -> None:
    K, M = rod_matrices(100)
    step = 3.0 * LENGTH / WAVE
    inertia = 4 / step**2

    def respond(y: np.ndarray) -> np.ndarray:
        held = np.zeros(101)
        held[1:] = sp.linalg.spsolve(sp.csc_matrix(inertia * M + K)[1:, 1:], y[1:])
        return held

    omega, shape = slowest_frequency(respond, M, inertia, np.ones(101))
    assert omega is not None
    assert shape is not None
    assert np.pi / omega == pytest.approx(2 * LENGTH / WAVE, rel=1e-3)
    quarter = np.sin(np.linspace(0, np.pi / 2, 101))
    assert shape / shape[-1] == pytest.approx(quarter, abs=1e-3)
    # One that is slow enough is found in fewer steps, in one from its shape.
    asked = 0

    def counted(y: np.ndarray) -> np.ndarray:
        nonlocal asked
        asked += 1
        return respond(y)

    fast, _ = slowest_frequency(counted, M, inertia, np.ones(101), 2 * omega)
    assert fast is not None
    assert omega * (1 - 1e-9) <= fast <= 2 * omega
    assert asked <= 4
    asked = 0
    again, _ = slowest_frequency(counted, M, inertia, np.zeros(101), 2 * omega, known=shape)
    assert again == pytest.approx(omega, rel=1e-3)
    assert asked == 1
    # None is as slow as that: the whole search.
    least, _ = slowest_frequency(counted, M, inertia, np.ones(101), 0.5 * omega, known=shape)
    assert least == pytest.approx(omega, rel=1e-9)
    rigid = slowest_frequency(lambda y: y / inertia / M.diagonal(), M, inertia, np.ones(101), omega)
    assert rigid == (None, None)


def test_a_motion_that_leaves_all_numbers_fails_with_its_history() -> None:
    with pytest.raises(cq.NotConverged, match="newmark: the motion has left all numbers at time") as failed:
        thrown_rod("newmark", duration=2.0, method="active-set", load=lambda t: np.full(101, 1e306 * t))
    history = failed.value.history
    assert isinstance(history, cq.MotionHistory)
    assert 1 <= len(history) < 601
    assert np.all(np.isfinite(history.displacements))


@pytest.mark.slow
def test_a_method_that_gives_up_fails_with_the_history_until_then(monkeypatch: pytest.MonkeyPatch) -> None:
    from contactqp.analysis.motion import step_contact

    def gives_up(*_: object) -> None:
        raise cq.NotConverged("lemke: no")

    monkeypatch.setattr(step_contact, "normal_forces", gives_up)
    with pytest.raises(cq.NotConverged, match="moreau-jean: step 151: lemke: no") as failed:
        thrown_rod("moreau-jean")
    history = failed.value.history
    assert len(history) == 151
    assert history.times[-1] == pytest.approx(0.5)
    monkeypatch.undo()
    assert np.array_equal(history.resume(1.5).displacements, thrown_rod("moreau-jean")[0].displacements)


def test_steps_before_a_failure_are_certified_too(monkeypatch: pytest.MonkeyPatch) -> None:
    from contactqp.analysis.motion import step_contact

    right, calls = step_contact.normal_forces, []

    def spoils_then_gives_up(*arguments: Any) -> Any:
        calls.append(1)
        if len(calls) == 5:
            raise cq.NotConverged("lemke: no")
        return right(*arguments) * (1.001 if len(calls) == 3 else 1.0)

    monkeypatch.setattr(step_contact, "normal_forces", spoils_then_gives_up)
    with pytest.raises(cq.NotConverged, match=r"refuses the step that ends at time 0\.51: complementarity") as failed:
        thrown_rod("moreau-jean")
    assert len(failed.value.history) == 153


def test_the_certificate_refuses_forces_that_are_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    from contactqp.analysis.motion import step_contact

    right, alone = step_contact.normal_forces, step_contact.StepContact.alone
    monkeypatch.setattr(step_contact, "normal_forces", lambda *a: 1.001 * right(*a))
    assert thrown_rod("moreau-jean")[0][-1].certificate.passed  # what is refused is solved again, by itself

    def spoilt(self: Any, posed: Any) -> Any:
        found = alone(self, posed)
        return replace(found, normal=1.001 * found.normal)

    monkeypatch.setattr(step_contact.StepContact, "alone", spoilt)
    with pytest.raises(cq.NotConverged, match=r"refuses the step that ends at time 0\.503333: equilibrium is"):
        thrown_rod("moreau-jean")


def test_a_start_inside_a_wall_is_not_rounding() -> None:
    problem, mass = rod_at_wall(10, gap=0.0)
    with pytest.raises(cq.InvalidProblem, match="contact 0 overlaps by 1e-06"):
        cq.impact(problem, mass, np.full(11, -1e-6), np.zeros(11), 1.0, 0.01)


@pytest.mark.parametrize("spring", [0.0, 1.0])
def test_a_late_impact_beside_a_body_that_rests_or_swings_is_minded(spring: float) -> None:
    """Two masses on a stiff spring fall on the ground: the held one's half period is pi sqrt(m / k)."""
    K = np.zeros((3, 3))
    K[0, 0], K[1:, 1:] = spring, [[1e8, -1e8], [-1e8, 1e8]]
    problem = cq.ContactProblem(K, [-10.0, 0, 0], [[-1.0, 0, 0], [0, -1.0, 0]], [0.0 if not spring else 50.0, 0.1])
    arguments: Any = (np.ones(3), np.zeros(3), [0, -1.0, -1.0])
    with pytest.warns(cq.TimeStepWarning, match=r"\(contact 1\): it lasts about 0\.00031"):
        history = cq.impact(problem, *arguments, 0.2, 0.01)
    assert len(_of_steps(history)) == 1
    first = cq.impact(problem, *arguments, 0.05, 0.01)
    assert first.notes == ()
    with pytest.warns(cq.TimeStepWarning, match=r"closes at time 0\.1"):
        assert len(_of_steps(first.resume(0.15))) == 1
    assert first.notes == ()


def _of_steps(history: cq.MotionHistory) -> list[str]:
    """The notes but for those on overlap and energy, which have tests of their own."""
    return [note for note in history.notes if "penetrates" not in note and not note.startswith("the energy grows")]


@pytest.mark.sampled(4)
@pytest.mark.parametrize("scheme", ["backward-euler", "moreau-jean", "newmark", "deuflhard-krause-ertel"])
def test_long_steps_of_a_free_body_between_walls(scheme: str) -> None:
    """A free chain of springs between two walls, in steps of 100 vibrations: K + M/h^2 hardly feels the mass."""
    K = np.array([[3.0, -3.0, 0.0], [-3.0, 4.0, -1.0], [0.0, -1.0, 1.0]])
    walls = dict(normal=[[1.0, 0.0, 0.0], [0.0, 0.0, -1.0]], gap=[0.1273, 0.153])
    chain = cq.ContactProblem(K, [0.3009, 0.8637, -0.1586], **walls)
    with pytest.warns(cq.TimeStepWarning, match="too long"):
        history = cq.impact(chain, [1.6, 1.1, 0.5], np.zeros(3), [0.39, -0.34, 0.73], 8000.0, 400.0, scheme=scheme)
    assert all(instant.certificate.passed for instant in history)
    assert np.max(history.normal_forces) > 0.1
    if scheme == "backward-euler":  # which comes to rest at once, on the wall that the loads push it to
        assert history[-1].displacement == pytest.approx(cq.solve(chain).displacement, abs=1e-6)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::contactqp.TimeStepWarning")
@pytest.mark.parametrize("held", ["tie", "contact"])
def test_what_comes_to_rest_under_a_load_that_ties_or_contacts_carry_is_right(held: str) -> None:
    """Implicit steps damp the motion until its velocities are no more than the rounding of the forces at rest."""
    K = [[9e4, -2e4, 1e4], [-2e4, 5e4, 3e3], [1e4, 3e3, 7e4]]
    rows: Any = dict(normal=[[1.0, -0.3, -0.2]], gap=[0.0])
    if held == "tie":
        rows = dict(normal=[[1.0, 0.0, 0.0]], gap=[1.0], tie=[[1.0, -2.0, 0.7]], tie_value=[0.0])
    body, nothing = cq.ContactProblem(K, [30.0, -50.0, 20.0], **rows), np.zeros(3)
    history = cq.impact(body, [1.0, 2.0, 0.5], nothing, nothing, 4.0, 0.1, theta=1.0)
    assert all(instant.certificate.passed for instant in history)
    at_rest = cq.solve(body)
    assert history[-1].displacement == pytest.approx(at_rest.displacement, rel=1e-12)
    assert np.max(abs(history.velocities[10])) < 1e-12  # of a motion that begins with 0.006
    for name, size in (("velocity", 1e-12), ("displacement", 1e-12), ("normal_force", 1e-6), ("tie_force", 1e-6)):
        states, values = list(history.motion.states), np.array(getattr(history.motion.states[10], name))
        if len(values):
            values[-1] += size
            states[10] = replace(states[10], **{name: values})
            forged = cq.MotionHistory(replace(history.motion, states=states), tuple, history.resume)
            assert not forged[10].certificate.passed, name


def test_a_massless_contact_out_of_balance_at_the_start_is_refused_where_it_would_ring() -> None:
    """A mass on a spring whose foot has a load, and a floor 0.15 beneath that the foot must not pass.

    From balance, the foot 0.1 beneath the mass, it falls on the floor and stands there, 10 and the spring's 5 to 15 N
    above it. Without balance the foot's velocity would change its sign in every step, and the floor was passed by 1.3.
    """
    K, units = [[100.0, -100], [-100, 100.0]], {"length": "m", "force": "N"}
    foot = cq.ContactProblem(K, [-10.0, 0], [[-1.0, 0]], [0.15], units=units)
    given: dict[str, Any] = dict(mass=[0.0, 1.0], velocity=[0.0, 0.0], duration=0.5, time_step=0.01)
    with pytest.raises(cq.InvalidProblem, match=r"unknown 0 has no mass and a contact, and -10 N are out of balance"):
        cq.impact(foot, displacement=[0.0, 0.0], **given)
    fallen = cq.impact(foot, displacement=[-0.1, 0.0], **given)
    by_newmark = cq.impact(foot, displacement=[0.0, 0.0], scheme="newmark", **given)
    for history in (fallen, by_newmark):
        assert -0.155 - 1e-9 < history.displacements[:, 0].min() <= -0.15 + 1e-9
        assert history.normal_forces.max() > 10
    # A contact that is closed, or a tie, holds what is left.
    on_floor = foot.replace(gap=[0.0])
    assert cq.impact(on_floor, displacement=[0.0, 0.0], **given).normal_forces[1:, 0] == pytest.approx(10.0)
