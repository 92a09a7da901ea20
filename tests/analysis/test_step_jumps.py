"""Steps that jump across a snap, or take one of several continuations, are told."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.analysis import friction_events, friction_path
from tests.analysis.friction_paths import WEIGHTS, pulled, rolling_block, truss_from_rest
from tests.analysis.test_friction_events import KLARBRING, random_body
from tests.solving.friction.problems import one_contact, two_masses

# K_tt + mu K_nt < 0 above mu = 1/2: pressed by 1 and pulled by mu at t = 1 + mu / 2 it can neither stick nor slide on.
PRESSED_AND_PULLED = [[-1.0, 0.0], [-1.0, 2.0]]


def jumps(history: cq.History) -> list[str]:
    return [note for note in history.notes if "jumps" in note]


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("steps", "shown"), [(1, "2"), (4, "1.5"), (5, "1.6"), (10, "1.5"), (50, "1.42")])
@pytest.mark.parametrize(("friction", "lost"), [(0.8, "1.4"), (0.7, "1.35")])
def test_a_step_across_a_snap(friction: float, lost: str, steps: int, shown: str) -> None:
    history = cq.follow_path(one_contact(KLARBRING, [0.0, 0.0], friction), PRESSED_AND_PULLED, steps=steps)
    found = jumps(history)
    assert len(found) == 1
    assert f"at t = {lost}: no continuation" in found[0]
    assert "contact 0" in found[0]
    when = float(found[0].split("step to t = ")[1].split(":")[0])
    assert when - 1 / steps - 1e-12 <= float(lost) < when + 1e-12
    if friction == 0.8:
        assert found[0].startswith(f"step to t = {shown}: ")
    # What carried a force sticking lets go at once.
    assert history[-1].contact_status.tolist() == ["open"]


@pytest.mark.parametrize("steps", [1, 4, 10])
def test_no_step_jumps_below_the_critical_friction(steps: int) -> None:
    assert cq.follow_path(one_contact(KLARBRING, [0.0, 0.0], 0.4), PRESSED_AND_PULLED, steps=steps).notes == ()


@pytest.mark.parametrize("options", [{}, {"algorithm": "tresca"}, {"method": "lagrange-multiplier"}])
def test_whatever_takes_the_steps(options: dict[str, Any]) -> None:
    history = cq.follow_path(one_contact(KLARBRING, [0.0, 0.0], 0.8), PRESSED_AND_PULLED, steps=4, **options)
    assert [note.split(":")[0] for note in jumps(history)] == ["step to t = 1.5"]


def test_on_contact_springs_the_snap_is_that_of_the_bodies_on_them() -> None:
    problem = one_contact(KLARBRING, [0.0, 0.0], 0.8)
    stiff = cq.follow_path(problem, PRESSED_AND_PULLED, steps=4, method="penalty", penalty=1e6)
    assert len(jumps(stiff)) == 1
    assert "no continuation" in jumps(stiff)[0]
    # Springs as soft as these let it slide on: 1 / beta on the diagonal of W raises mu_c to (1 + 1) / 2.
    soft = cq.follow_path(problem, PRESSED_AND_PULLED, steps=4, method="penalty", penalty=1.0)
    assert jumps(soft) == []


def test_a_step_that_chooses() -> None:
    problem = one_contact(KLARBRING, [0.0, 0.0], 0.8)
    unloaded = cq.follow_path(problem, [[-1.0, 0.0], [-1.0, 0.8], [-1.0, 0.0]], steps=4)
    chooses, several = unloaded.notes
    assert chooses.startswith("step to t = 2.25: it chooses; at t = 2: several continuations")
    assert several.startswith("t = 1.75 to 2.25: several equilibria")
    from_rest = cq.follow_path(problem, [[-1.0, 0.65]], steps=1)
    assert from_rest.notes[0].startswith("step to t = 1: it chooses; at t = 0: several")
    assert from_rest.notes[1].startswith("t = 1: several equilibria")


@pytest.mark.parametrize(
    ("steps", "seeds"), [(2, 1), *(pytest.param(steps, 3, marks=pytest.mark.slow) for steps in (1, 5))]
)
def test_paths_without_snaps_have_no_notes(steps: int, seeds: int) -> None:
    for seed in range(seeds):
        problem, loads = random_body(seed)
        assert cq.follow_path(problem, loads, steps=steps).notes == ()
    problem, loads = rolling_block(0.3, (8, 3))
    assert cq.follow_path(problem, [*loads, loads[0]], steps=steps).notes == ()
    assert cq.follow_path(two_masses(0.0), [WEIGHTS, pulled(12.0), WEIGHTS], steps=steps).notes == ()
    assert cq.follow_path(two_masses(0.0), [WEIGHTS, pulled(12.0)], events="exact").notes == ()
    assert cq.follow_path(truss_from_rest(0.3).replace(friction=0.0), [[60.0, -100.0]], steps=steps).notes == ()


def test_what_falls_and_what_is_anchored_elsewhere_jumps() -> None:
    above = two_masses(0.0).replace(gap=[1e-3, 2e-3])
    (falls,) = cq.follow_path(above, [WEIGHTS], steps=4).notes
    assert falls.startswith("step to t = 0.25: it jumps; at t = 0: no continuation")
    (drawn,) = cq.follow_path(two_masses(0.0, (1e-3, 1e-3)), [WEIGHTS], steps=2).notes
    assert drawn.endswith("contact 0 is closed at the start, at E_T u = 0, and slip_origin anchors it at 0.001")


def test_what_is_not_examined_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    space = cq.ContactProblem(np.eye(3), np.zeros(3), -np.eye(1, 3), [0.0], tangent=np.eye(3)[1:], friction=0.3)
    (note,) = cq.follow_path(space, [[-1.0, 0.0, 0.1]], steps=2).notes
    assert note == "whether steps jump was not examined: two tangential rows a contact"
    problem, loads = rolling_block(0.2, (8, 3))
    history = cq.follow_path(problem, loads, steps=2)
    monkeypatch.setattr(friction_events, "ALL_TRIED", 0)
    monkeypatch.setattr(friction_events, "QUICK_STEPS", 0)
    monkeypatch.setattr(friction_events, "MOST_TRIED", 0)
    assert "step to t = 0.5: whether it jumps was not found out; at t = 0" in history.notes[0]
    monkeypatch.setattr(friction_path, "first_candidates", lambda problem: problem)
    (note,) = cq.follow_path(problem, loads, steps=2).notes
    assert note.endswith("too many contacts")
