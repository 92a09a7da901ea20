"""Friction in the plane with many contacts: sparse systems beside condensed ones, and wrong answers refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.elements.material import Material
from contactqp.elements.shapes import rectangle
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from contactqp.linalg.iteration import condense_anyway, constraints_are_many
from contactqp.linalg.sparse_states import MOST_CHANGES, ChangedStateSystem, SparseStateSystem, frictional_rows
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK
from contactqp.solving.friction import newton
from contactqp.solving.methods import Settings
from tests.clocks import Clock

pytest.importorskip("pyamg")


def strip(cells: int, friction: float, press: float) -> cq.ContactProblem:
    """A strip of quadrilaterals, its top pressed down onto a parabola beneath."""
    body = Body(rectangle(1.0, 8 / cells, (cells, 8)), Material(1.0, 0.3), "plane-strain", name="strip")
    structure = Structure([body])
    held = [Support("strip", "top", 1, -press), Support("strip", "top", 0, 0.0)]
    parabola = cq.Paraboloid([0.5, 0.0], [0.0, 1.0], 5.0)
    return structure.assemble(held).problem(
        [cq.pair(structure.surface("strip", "bottom"), parabola)], friction=friction
    )


def pushed(seed: int, cells: int = 320) -> cq.ContactProblem:
    """The strip with loads that leave contacts in every state, slip origins, and ties every now and then."""
    rng = np.random.default_rng(seed)
    problem = strip(cells, 0.3, float(10 ** rng.uniform(-3.5, -2)))
    size, m = float(np.max(abs(problem.load))), problem.contacts
    load = problem.load + rng.normal(size=problem.dimension) * size * 10 ** rng.uniform(-3, -1)
    load[::2] += size * 10 ** rng.uniform(-3, -1)
    changed = problem.replace(
        load=load,
        friction=np.where(rng.random(m) < 0.1, 0.0, 10 ** rng.uniform(-1.5, 0, m)),
        slip_origin=rng.normal(size=(m, 1)) * 1e-5,
    )
    if seed % 2:
        rows = sp.csr_matrix((np.ones(4), ([0, 0, 1, 1], [1001, 1201, 2001, 2201])), shape=(2, problem.dimension))
        changed = changed.replace(tie=rows, tie_value=[1e-4, 0.0])
    return changed


def condensed(problem: cq.ContactProblem) -> cq.ContactProblem:
    """The same numbers, condensed however many contacts there are."""
    twin = problem.replace(stiffness=problem.stiffness)
    condense_anyway(twin)
    return twin


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_sparse_systems_find_what_condensed_ones_do(seed: int) -> None:
    problem = pushed(seed)
    assert constraints_are_many(problem)
    sparse, dense = cq.solve(problem), cq.solve(condensed(problem))
    assert sparse.work.retained == problem.dimension
    assert sparse.certificate.passed
    assert sparse.certificate.basis == "state"
    assert {"open", "slip"} <= set(sparse.contact_status)
    largest = float(np.max(dense.normal_force))
    assert sparse.normal_force == pytest.approx(dense.normal_force, abs=1e-12 * largest)
    assert sparse.friction_force == pytest.approx(dense.friction_force, abs=1e-12 * largest)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_combination_near_a_factorised_one_is_solved_by_its_factors(seed: int) -> None:
    problem, rng = pushed(seed), np.random.default_rng(seed)
    rows, m = frictional_rows(problem), problem.contacts
    status = rng.choice([OPEN, STICK, SLIP_ON, SLIP_BACK], m).astype(np.int8)
    status[~rows.slides & (status == STICK)] = SLIP_ON
    factorised = SparseStateSystem(problem, rows, status)
    changed = status.copy()
    chosen = np.flatnonzero(rows.slides)[: MOST_CHANGES // 2 * 8 : 8]
    changed[chosen] = rng.choice([OPEN, STICK, SLIP_ON, SLIP_BACK], len(chosen))
    by_factors = ChangedStateSystem(rows, factorised, changed)
    anew = SparseStateSystem(problem, rows, changed)
    assert by_factors.regular
    assert anew.regular
    right = [rng.normal(size=size) for size in (problem.dimension, m, m, problem.ties)]
    found, expected = (vars(system.correct(*right)) for system in (by_factors, anew))
    assert len(expected) == 4
    for here, there in zip(found.values(), expected.values(), strict=True):
        assert here == pytest.approx(there, abs=1e-11 * float(np.max(abs(there), initial=0.0)))


@pytest.mark.slow
def test_newton_factorises_the_first_combination_and_changes_it() -> None:
    problem = strip(1000, 0.05, 0.05)
    solution = cq.solve(problem)
    assert solution.certificate.passed
    assert solution.work.iterations > 3
    assert solution.work.factorisations == 1


@pytest.mark.slow
def test_a_change_that_leaves_no_inverse_is_factorised_anew() -> None:
    """Two contacts of one node: the second one closes where the first is closed, and is redundant."""
    problem = pushed(0)
    twice = problem.replace(
        normal=sp.vstack([problem.normal, problem.normal[:1]]),
        gap=np.append(problem.gap, problem.gap[0]),
        tangent=sp.vstack([problem.tangent, problem.tangent[:1]]),
        friction=np.append(problem.friction, problem.friction[0]),
        slip_origin=np.vstack([problem.slip_origin, problem.slip_origin[:1]]),
        contact_names=None,
    )
    rows, status = frictional_rows(twice), np.full(twice.contacts, STICK, dtype=np.int8)
    status[-1] = OPEN
    assert rows.system(twice, status).regular
    status = status.copy()
    status[-1] = STICK
    assert not rows.system(twice, status).regular
    assert rows.factorisations == 2


def test_few_contacts_are_condensed_as_ever() -> None:
    assert not constraints_are_many(strip(120, 0.3, 0.002))


@pytest.mark.slow
@pytest.mark.parametrize("part", ["normal_force", "friction_force", "displacement"])
def test_wrong_answers_are_refused_by_the_comparison(part: str) -> None:
    problem = pushed(2)
    solution = cq.solve(problem)
    answer = {
        "displacement": solution.displacement.copy(),
        "normal_force": solution.normal_force.copy(),
        "friction_force": solution.friction_force.copy(),
    }
    assert cq.certify(problem, **answer).passed
    worst = int(np.argmax(abs(answer[part]).ravel()))
    answer[part].reshape(-1)[worst] *= 1 + 1e-4
    refused = cq.certify(problem, **answer)
    assert not refused.passed
    if part != "displacement":
        assert any(text.startswith("state:") for text in refused.failures), refused.failures


@pytest.mark.slow
def test_an_equilibrium_with_another_law_of_friction_is_refused() -> None:
    """Forces of twice the coefficient balance the bodies: the figures see the cone, and the comparison the distance."""
    problem = pushed(4)
    rough = cq.solve(problem.replace(friction=2 * problem.friction))
    judged = cq.certify(problem, rough.displacement, rough.normal_force, rough.friction_force)
    assert not judged.passed
    assert judged.equilibrium <= 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("cells", [160, 320])
def test_a_start_is_the_combination_of_the_load_before(cells: int) -> None:
    problem = pushed(2, cells)
    first = cq.solve(problem)
    again = cq.solve(problem.replace(load=problem.load * (1 + 1e-6)), warm_start=first)
    assert again.certificate.passed
    assert again.work.iterations <= 2


@pytest.mark.slow
def test_where_newton_gives_up_the_problem_is_condensed(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = cq.solve(pushed(0))
    monkeypatch.setattr(newton, "MAX_SPARSE_STEPS", 1)
    found = cq.solve(pushed(0))
    assert found.work.retained < found.problem.dimension == expected.work.retained
    largest = float(np.max(expected.normal_force))
    assert found.normal_force == pytest.approx(expected.normal_force, abs=1e-12 * largest)


@pytest.mark.parametrize("friction", [0.3, 0.8])
def test_many_contacts_take_newtons_method_from_the_answer_without_friction(
    friction: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A long strip laid onto a parabola, 320 contacts: one Tresca problem takes as long as all else together."""
    body = cq.Body(cq.rectangle(10.0, 0.08, (320, 4)), cq.Material(1.0, 0.3), "plane-strain", name="strip")
    structure = cq.Structure([body])
    system = structure.assemble([cq.Support("strip", "left", axis) for axis in (0, 1)])
    valley = cq.pair(structure.surface("strip", "bottom"), cq.Paraboloid([5.0, -1e-3], [0.0, 1.0], 50.0))
    problem, top = system.problem(valley, friction=friction), np.zeros(body.size)
    points = body.mesh.points
    top[2 * np.flatnonzero(points[:, 1] == points[:, 1].max()) + 1] = -1e-7
    problem = problem.replace(load=top[system.free])
    reference = cq.solve(problem, algorithm="tresca")
    monkeypatch.setattr("contactqp.solving.friction.tresca.solve_convex", None)
    found = cq.solve(problem.replace(stiffness=problem.stiffness), condense=True)
    assert found.certificate.passed
    assert found.method == "newton"
    assert list(found.contact_status) == list(reference.contact_status)
    largest = reference.normal_force.max()
    np.testing.assert_allclose(found.normal_force, reference.normal_force, rtol=0, atol=1e-14 * largest)
    np.testing.assert_allclose(found.friction_force, reference.friction_force, rtol=0, atol=1e-14 * largest)


WEIGHT, BLOCKS = 2.0**-20, 52


def column(blocks: int, push: float) -> tuple[cq.ContactProblem, list[int]]:
    """Blocks on each other, of 7 and 5 cells in turn, all nodes loaded, the lowest held; contacts of each joint."""
    material = Material(1.0, 0.3)
    shapes = [
        rectangle(1.0, 0.3, (7 - 2 * (i % 2), 2)).mapped(lambda x, i=i: np.add(x, [0.0, 0.3 * i]))
        for i in range(blocks)
    ]
    bodies = [Body(shape, material, "plane-strain", name=f"{i}") for i, shape in enumerate(shapes)]
    structure = Structure(bodies)
    joints = [(structure.surface(f"{i}", "top"), structure.surface(f"{i + 1}", "bottom")) for i in range(blocks - 1)]
    pairs = [cq.pair_mortar(*joint) for joint in joints]
    assembled = structure.assemble([Support("0", "bottom", axis) for axis in range(2)])
    load = np.concatenate([np.tile([push, -WEIGHT], len(body.mesh.points)) for body in bodies])
    return assembled.problem(pairs, friction=0.3).replace(load=load[assembled.free]), [p.normal.shape[0] for p in pairs]


@pytest.mark.slow
def test_floating_blocks_carry_what_lies_on_them() -> None:
    """The resultants of each joint are the loads above it; dense systems took twelve times as long."""
    push = WEIGHT / 4096
    problem, counts = column(BLOCKS, push)
    assert constraints_are_many(problem)
    solution = cq.solve(problem)
    assert (solution.work.retained, solution.certificate.basis) == (problem.dimension, "state")
    assert solution.certificate.passed
    above = np.cumsum([3 * (8 - 2 * (i % 2)) for i in range(BLOCKS)][:0:-1])[::-1]
    starts = np.cumsum([0, *counts[:-1]])
    assert np.add.reduceat(solution.normal_force, starts) == pytest.approx(WEIGHT * above, rel=1e-12)
    assert np.add.reduceat(solution.friction_force[:, 0], starts) == pytest.approx(push * above, rel=1e-11)
    largest = solution.normal_force.copy()
    largest[np.argmax(largest)] *= 1 + 1e-5
    forged = cq.certify(problem, solution.displacement, largest, solution.friction_force)
    assert not forged.passed


def bricks(courses: int, columns: int) -> cq.ContactProblem:
    """Bricks laid half over each other, of different stiffness, pushed along: some contacts slip, others open."""
    rng, bodies, joints = np.random.default_rng(3), [], []
    places = [(row, k + row % 2 / 2) for row in range(courses) for k in range(columns - row % 2)]
    for row, left in places:
        shape = rectangle(0.98, 0.5, (4, 2)).mapped(lambda x, row=row, left=left: np.add(x, [left, 0.5 * row]))
        bodies.append(Body(shape, Material(10 ** rng.uniform(-1, 1), 0.3), "plane-strain", name=f"{row} {left}"))
    structure = Structure(bodies)
    held = [Support(f"0 {float(k)}", "bottom", axis) for k in range(columns) for axis in range(2)]
    for row, left in places[columns:]:
        below = [f"{row - 1} {left + half}" for half in (-0.5, 0.5) if (row - 1, left + half) in places]
        upper = structure.surface(f"{row} {left}", "bottom")
        joints += [cq.pair_mortar(upper, structure.surface(name, "top")) for name in below]
    assembled = structure.assemble(held)
    load = np.concatenate([np.tile([0.1e-5, -1e-5], len(body.mesh.points)) for body in bodies])
    return assembled.problem(joints, friction=0.5).replace(
        load=(load * rng.uniform(0.5, 1.5, len(load)))[assembled.free]
    )


@pytest.mark.slow
def test_combinations_of_convex_problems_lead_to_what_dense_systems_find() -> None:
    """Friction alone holds the bricks: from contacts that all stick Newton's method meets a brick that is free."""
    problem = bricks(6, 5)
    dense = cq.solve(problem)
    assert {"open", "slip", "stick"} <= set(dense.contact_status)
    sparse = newton.solve_sparse_newton(problem, Settings(1e-9)).answer
    largest = float(np.max(dense.normal_force))
    assert sparse.normal_force == pytest.approx(dense.normal_force, abs=1e-12 * largest)
    assert sparse.friction_force == pytest.approx(dense.friction_force, abs=1e-12 * largest)


@pytest.mark.slow
def test_sparse_systems_return_the_answer_of_the_last_combination_when_the_time_is_up(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, refined = pushed(0), newton.refined_sparse
    truth = cq.solve(problem)

    def slowly(*arguments: Any) -> Any:
        found = refined(*arguments)
        clock.passes(300.0)
        return found

    monkeypatch.setattr(newton, "refined_sparse", slowly)
    words = "newton: stopped at the time limit of 500 s, before combination 3 of open, stick and slip was solved for"
    with pytest.raises(cq.NotConverged, match=words) as caught:
        cq.solve(problem._without_results(), time_limit=500.0)
    found = caught.value.solution
    assert not found.certificate.passed
    error = np.linalg.norm(found.displacement - truth.displacement)
    assert 0 < error < 0.5 * np.linalg.norm(truth.displacement)


@pytest.mark.slow
def test_a_body_that_contacts_hide_is_refused_for_its_negative_stiffness() -> None:
    problem, _ = column(BLOCKS, 0.0)
    unknowns = 30 + np.arange(36)  # the second block
    block = problem.stiffness[unknowns][:, unknowns].toarray()
    values, modes = np.linalg.eigh(block)
    changed = block - 1.001 * values[3] * np.outer(modes[:, 3], modes[:, 3])
    K = problem.stiffness.tolil()
    K[np.ix_(unknowns, unknowns)] = (changed + changed.T) / 2
    with pytest.raises(cq.InvalidProblem, match="positive semidefinite"):
        cq.solve(problem.replace(stiffness=K.tocsr()))


@pytest.mark.slow
def test_floating_blocks_are_solved_by_the_factors_of_another_combination() -> None:
    problem, _ = column(12, 0.0)
    rows, m = frictional_rows(problem), problem.contacts
    assert rows.floats
    status = np.full(m, STICK, dtype=np.int8)
    status[::9] = SLIP_ON
    changed = status.copy()
    changed[[0, 9, 13, 20]] = STICK, OPEN, OPEN, SLIP_BACK
    by_factors = ChangedStateSystem(rows, SparseStateSystem(problem, rows, status), changed)
    anew, rng = SparseStateSystem(problem, rows, changed), np.random.default_rng(0)
    assert by_factors.regular
    right = [rng.normal(size=size) for size in (problem.dimension, m, m, 0)]
    for here, there in zip(*(vars(system.correct(*right)).values() for system in (by_factors, anew)), strict=True):
        assert here == pytest.approx(there, abs=1e-11 * float(np.max(abs(there), initial=0.0)))


def test_the_convex_problems_that_combinations_come_from_hold_ties() -> None:
    """Two blocks that a tie joins move together in the problem with springs and in Tresca's."""
    problem = cq.ContactProblem(
        np.diag([4.0, 4.0, 1.0, 1.0]), [1.0, -2.0, 0.0, 0.0], [[0.0, -1.0, 0.0, 0.0]], [0.0],
        tangent=[[1.0, 0.0, 0.0, 0.0]], friction=0.3, tie=[[1.0, 0.0, -1.0, 0.0]], tie_value=[0.5],
    )  # fmt: skip
    for _, posed in (newton._with_springs(problem), newton._with_bounds(problem, np.array([0.6]))):
        u = cq.solve(posed).displacement
        assert u[0] - u[2] == pytest.approx(0.5)
