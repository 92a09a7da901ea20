"""What a floor excuses is a millionth of what is planted here: a force, a tension, a penetration and a residual of 1e-6
of the intrinsic size, at every contact of problems whose answers lie beside those floors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

import contactqp as cq
from benchmarks.friction_families import contact_problem
from benchmarks.problem_families import family
from contactqp.certificate.bounds import no_bounds
from contactqp.certificate.messages import of_rounded_stiffness
from contactqp.model.solution import Answer, Solution

KINDS = (
    "bedded",
    "decaying_path",
    "pushed_rigidly",
    "unstrained",
    "interference_removed",
    "stack_free_to_slide",
    "printed_floating",
    "far_gap",
    "scaled_contact",
)
Parts = tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray]


def planted(problem: cq.ContactProblem, found: Solution) -> Iterator[tuple[str, Parts]]:
    """Wrong answers: 1e6 times what counts as nothing there."""
    nothing = found.certificate.violations.nothing
    u, normal, friction, tie = found.displacement, found.normal_force, found.friction_force, found.tie_force
    for i, row in enumerate(problem.normal.toarray()):
        acts = np.flatnonzero(row)
        force = 1e6 * np.min(nothing.force[acts] / abs(row[acts]))
        for sign in (1.0, -1.0):
            changed = normal + sign * force * (np.arange(len(normal)) == i)
            what = "force" if changed[i] >= 0 else "tension"
            yield f"{what} at {problem.contact_name(i)}", (u, changed, friction, tie)
        if normal[i] > 0:
            sunk = u + row * (1e6 * nothing.normal[i] / (row @ row))
            yield f"penetration of {problem.contact_name(i)}", (sunk, normal, friction, tie)
    for j in np.flatnonzero(problem.diagonal > 0)[:: max(1, problem.dimension // 8)]:
        moved = u + (1e6 * nothing.force[j] / problem.diagonal[j]) * (np.arange(len(u)) == j)
        yield f"residual at {problem.dof_name(int(j))}", (moved, normal, friction, tie)


@pytest.mark.sampled(81)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", [*KINDS, *(f"{kind} {d}D" for d in (2, 3) for kind in KINDS)])
def test_a_millionth_of_what_counts_is_refused_beside_every_floor(kind: str, seed: int) -> None:
    problem = contact_problem(kind, seed).problem if " " in kind else family(kind, seed)
    found = cq.solve(problem)
    forgeries = list(planted(problem, found))
    assert len(forgeries) >= 4
    passed = [name for name, parts in forgeries if cq.certify(problem, *parts).passed]
    assert passed == []


@pytest.mark.sampled(3)
@pytest.mark.parametrize("unit", [1.0, 2.0**-30, 2.0**40])
def test_parts_without_stiffness_have_forces_of_their_own(unit: float) -> None:
    """A load of 8e-12 between two stops, beside one of 5e-4 that nothing joins it to: a tension of 1e-6 of the small
    one, which its other stop balances, is no rounding of the large one."""
    small, large = 8e-12 * unit, 5e-4 * unit
    rows = np.array([[0.0, 8192.0], [4.0, 0.0], [-(2.0**-29), 0.0]])
    problem = cq.ContactProblem(np.zeros((2, 2)), [-small, large], rows, [448.0, 2.0**32, -1.25])
    found = cq.solve(problem)
    assert found.normal_force == pytest.approx([large / 8192, 0.0, small * 2.0**29], rel=1e-12)
    for part in (1e-6, 1e-4):
        torn = found.normal_force + part * small * np.array([0.0, -1 / 4, -(2.0**29)])
        assert not cq.certify(problem, found.displacement, torn).passed
    rounded = found.normal_force * (1 + 1e-16 * np.array([1, -1, 1]))
    assert cq.certify(problem, found.displacement, rounded).passed


def cantilever(nodes: np.ndarray) -> cq.ContactProblem:
    """A beam of EI = 1 clamped at nodes[0], its tip loaded by 1 and far from a stop: it moves by L³/3."""
    n = 2 * len(nodes)
    K = np.zeros((n, n))
    for e, h in enumerate(np.diff(nodes)):
        own = slice(2 * e, 2 * e + 4)
        K[own, own] += [
            [12 / h**3, 6 / h**2, -12 / h**3, 6 / h**2],
            [6 / h**2, 4 / h, -6 / h**2, 2 / h],
            [-12 / h**3, -6 / h**2, 12 / h**3, -6 / h**2],
            [6 / h**2, 2 / h, -6 / h**2, 4 / h],
        ]
    tip = np.eye(n - 2)[-2]
    return cq.ContactProblem(K[2:, 2:], tip, [-tip], [100.0])


@pytest.mark.parametrize("last", [1e-3, 1e-4, 5e-5])
def test_a_note_says_how_much_of_the_answer_the_last_digits_of_the_stiffness_decide(last: float) -> None:
    """Assembled in doubles, a short element hides the digits of a long one; bounds are those of the matrix."""
    found = cq.solve(cantilever(np.array([0.0, 1.0, 2.0 - last, 2.0])))
    (note,) = found.certificate.notes
    assert "the last digits of the entries of the stiffness may change the strain energy by" in note
    part = float(note.split(" by ")[1].split(" of ")[0])
    off = abs(found.displacement[-2] - 8 / 3) / (8 / 3)
    assert max(1e-7, 10 * found.certificate.energy_error) < off < part < 1e3 * off


def test_elements_of_like_length_hide_no_digits() -> None:
    found = cq.solve(cantilever(np.linspace(0.0, 2.0, 101)))
    assert found.displacement[-2] == pytest.approx(8 / 3, rel=1e-7)
    assert found.certificate.notes == ()


def test_the_note_on_rounded_entries_has_no_square_of_an_energy_norm_beyond_doubles() -> None:
    """The square of 1e-170 is zero: it was divided by."""
    stiffness = np.array([[1.0, -1.0], [-1.0, 1.0 + 2.0**-40]])
    problem = cq.ContactProblem(stiffness, [0.0, 0.0], np.zeros((0, 2)), [])
    answer = Answer(np.full(2, 1e-164), np.zeros(0), None, np.zeros(0))
    notes = list(of_rounded_stiffness(problem, answer, replace(no_bounds(""), energy_scale=1e-170)))
    assert len(notes) == 1
    assert "0.00089 of itself" in notes[0]
