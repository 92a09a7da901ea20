"""What a step with friction takes over from the one before: the local form of its contacts and systems of states."""

from dataclasses import replace

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate.certificate import certificate_of
from contactqp.elements.material import Material
from contactqp.elements.shapes import box
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from contactqp.linalg import friction_states
from contactqp.linalg.condensation import condense
from contactqp.linalg.delassus import condensed_frictional_rows
from contactqp.model.local_problem import LocalProblem
from contactqp.solving.friction import alart_curnier, contact_form
from contactqp.solving.friction.local_form import LocalForm


@pytest.fixture
def block():
    """A block in space on a plane with friction, pressed and pulled sideways."""
    structure = Structure([Body(box((1.0, 1.0, 1.0), (2, 2, 2)), Material(1.0, 0.3), "3d", name="block")])
    held = [Support("block", "top", axis, (0.01, 0.0, -0.02)[axis]) for axis in range(3)]
    pairs = cq.pair(structure.surface("block", "bottom"), cq.Plane([0.0, 0.0, -0.005], [0.0, 0.0, 1.0]))
    return structure.assemble(held).problem([pairs], friction=0.3)


@pytest.mark.slow
def test_a_path_whose_contacts_keep_their_states_factorises_once_a_direction_of_slip(block, monkeypatch):
    """Solve and certificate share a system, and steps in which all stick share one."""
    made = []
    factorise = friction_states.StateSystem._factorise
    monkeypatch.setattr(
        friction_states.StateSystem, "_factorise", lambda self, *given: made.append(self) or factorise(self, *given)
    )
    sticking = block.replace(friction=5.0)
    history = cq.follow_path(sticking, [block.load], steps=12)
    closed = {tuple(solution.contact_status) for solution in history}
    assert all(solution.certificate.passed for solution in history)
    assert len(made) <= 2 * len(closed)


@pytest.mark.slow
def test_steps_that_go_on_as_before_start_from_where_the_last_two_lead(block, monkeypatch):
    """Forces of contacts that keep their states grow with the load: continued, they are the answer but for rounding."""
    starts = []
    newton = alart_curnier.newton
    monkeypatch.setattr(
        "contactqp.solving.friction.algorithms.newton",
        lambda form, start, *given: starts.append(start.error) or newton(form, start, *given),
    )
    history = cq.follow_path(block, [block.load], steps=20)
    assert np.array_equal(history[-1].contact_status, history[-4].contact_status)
    assert max(starts[-6:]) <= 1e-12  # two calls a step


def test_another_coefficient_has_rows_of_its_own(block):
    condensation = condense(block)
    rows = condensed_frictional_rows(block, condensation)
    same = condensed_frictional_rows(block.replace(slip_origin=block.slip_origin), condensation)
    other = condensed_frictional_rows(block.replace(friction=0.1), condensation)
    assert same is rows
    assert np.allclose(other.coefficient, rows.coefficient / 3)
    fewer, more = cq.solve(block.replace(friction=0.1)), cq.solve(block)
    assert abs(fewer.friction_force).sum() < abs(more.friction_force).sum()


def test_residuals_of_the_start_lead_to_the_same_answer(block, monkeypatch):
    """Beyond the sizes of one array the certificate's refinement starts from the residuals that are known."""
    found = cq.solve(block)
    monkeypatch.setattr("contactqp.linalg.extended.ONE_ARRAY", 0)
    again = cq.solve(block.replace(stiffness=block.stiffness.copy()))
    assert again.certificate.passed
    assert again.certificate.distance <= 1e-15
    assert np.allclose(again.normal_force, found.normal_force, rtol=1e-14, atol=0)
    assert np.allclose(again.friction_force, found.friction_force, rtol=1e-13, atol=1e-18)


def test_a_local_problem_with_other_offsets_is_that_problem():
    W = np.diag([1.0, 4.0, 2.0, 9.0]) + 0.1
    first = LocalProblem(W, [-1.0, 0.5, 2.0, 0.0], 0.3, 2)
    offset = np.array([3.0, -1.0, -2.0, 1.0])
    twin, anew = first.with_offsets(offset, np.zeros(0)), LocalProblem(W, offset, 0.3, 2)
    for name in ("offset", "contact_scale", "typical_velocity", "drive"):
        assert np.array_equal(getattr(twin, name), getattr(anew, name))
    assert np.array_equal(twin.scaled_delassus.toarray(), anew.scaled_delassus.toarray())
    assert not twin.offset.flags.writeable
    with pytest.raises(cq.InvalidProblem, match="offset"):
        first.with_offsets(offset * np.nan, np.zeros(0))


def test_scales_of_contacts_without_a_compliance_follow_their_offsets():
    first = LocalProblem(np.diag([1.0, 1.0, 0.0, 0.0]), [-1.0, 0.0, 1.0, 0.0], 0.3, 2)
    assert first.contact_scale[1] == 1.0
    assert first.with_offsets(np.array([-1.0, 0.0, 4.0, 0.0]), np.zeros(0)).contact_scale[1] == 0.25


def test_an_answer_right_to_doubles_is_refined_once_by_its_certificate(block, monkeypatch):
    """What a correction changes beneath the rounding of slip directions a second one does not make smaller."""
    corrections, correct = [], friction_states.StateSystem.correct
    monkeypatch.setattr(
        friction_states.StateSystem, "correct", lambda self, *given: corrections.append(self) or correct(self, *given)
    )
    found = cq.solve(block.replace(friction=0.1))
    assert "slip" in found.contact_status
    corrections.clear()
    again = cq.certify(
        found.problem,
        displacement=found.displacement,
        normal_force=found.normal_force,
        friction_force=found.friction_force,
    )
    assert again.passed
    assert again.distance <= 1e-15
    assert len(corrections) == 1


def test_the_certificate_of_a_solve_takes_the_answer_before_it_was_rounded(block, monkeypatch):
    """Method and certificate refine one combination once; of other data, or of copies, the answer is refined anew."""
    refined, refine = [], friction_states.refined_by
    monkeypatch.setattr(
        friction_states, "refined_by", lambda *given, **more: refined.append(1) or refine(*given, **more)
    )
    found = cq.solve(block.replace(friction=0.1))
    assert found.certificate.passed
    assert len(refined) == 1
    # The same arrays beside a coefficient of which they are no answer.
    other = certificate_of(found.problem.replace(friction=0.05), found.answer)
    assert len(refined) > 1
    assert not other.passed
    assert other.distance > 1e-3
    anew = certificate_of(found.problem, replace(found.answer, normal_force=found.normal_force.copy()))
    assert anew.distance == pytest.approx(found.certificate.distance, rel=1e-6, abs=1e-18)


def test_the_local_form_of_a_step_is_made_once(block, monkeypatch):
    """Held bodies have no joints whose load forces would balance, and one scale of forces."""
    forms = []
    monkeypatch.setattr(contact_form, "LocalForm", lambda *given: forms.append(LocalForm(*given)) or forms[-1])
    assert cq.solve(block).certificate.passed
    assert len(forms) == 1
