"""The worst combination of resultants, where the linear program that finds it is hard on its solver."""

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate import balance
from contactqp.certificate.balance import _worst_direction

# Of a lattice in corners that is free to slide: forces along two motions, next to none along the third.
BASIS = np.array(
    [
        [float.fromhex(x) for x in row.split()]
        for row in (
            "-0x1.4fd67fbe5e19fp-7 -0x1.6a002a00132acp-1 -0x1.34fa76e404082p-17",
            "-0x1.689572d4b6d9cp-18 0x1.39f5047f72ee9p-16 -0x1.f12b25f8ed541p-2",
            "-0x1.4fd67fbe5e0e0p-7 -0x1.6a002a00132b4p-1 -0x1.34fa3f8a931e0p-17",
            "0x1.7dcb6a564000cp-20 -0x1.4c6cd722e006fp-18 -0x1.0734f5de27aa9p-1",
            "-0x1.6a002a0224e67p-1 0x1.4fd67f68c9a39p-7 0x1.7656b341104a6p-19",
            "-0x1.68957282852acp-18 0x1.39f50437e7de8p-16 -0x1.f12b2587d27ddp-2",
            "-0x1.6a002a0224e67p-1 0x1.4fd67f68c9a39p-7 0x1.7656b341104a6p-19",
            "0x1.7dcb6a2f6c745p-20 -0x1.4c6cd70111c00p-18 -0x1.0734f5c36366dp-1",
        )
    ]
)
WEIGHT = np.array(
    [float.fromhex(x) for x in ["-0x1.bc48ae2634680p-18", "0x1.832e1b866d887p-16", "-0x1.0000000000000p+0"]]
)


def test_a_program_that_its_solver_gives_up_is_solved_more_roughly():
    """HiGHS has no answer within 1e-10; the certificate must not end in an ArithmeticError."""
    direction = _worst_direction(BASIS, WEIGHT)
    assert np.sum(abs(BASIS @ direction)) == pytest.approx(1.0, abs=1e-6)
    best = WEIGHT @ direction
    assert best == pytest.approx(0.50020404, rel=1e-6)
    random = np.random.default_rng(0).normal(size=(3, 20000))
    random = random / np.sum(abs(BASIS @ random), axis=0)
    assert np.max(WEIGHT @ random) <= best * (1 + 1e-6)


def test_unknowns_without_outer_forces_are_no_part_of_the_program(monkeypatch: pytest.MonkeyPatch) -> None:
    """The program had two rows of zeros for each of them, most unknowns of a body, and took a third of a step."""
    random = np.random.default_rng(1)
    motions, size = random.normal(size=(40, 3)), np.where(np.arange(40) < 9, 1.0, 0.0)
    work, posed = np.array([3.0, 1.0, 2.0]), []

    def worst_direction(basis: np.ndarray, weight: np.ndarray) -> np.ndarray:
        posed.append(len(basis))
        return _worst_direction(basis, weight)

    monkeypatch.setattr(balance, "_worst_direction", worst_direction)
    found = balance._worst_resultant(motions, work, np.zeros(3), size, 0.0)
    assert posed == [9]
    a = random.normal(size=(3, 20000))
    sampled = np.max(abs(work @ a) / (size @ abs(motions @ a)))
    assert sampled <= found * (1 + 1e-6) <= 1.2 * sampled


@pytest.mark.sampled(2)
@pytest.mark.parametrize("turned", [1.0, -1.0])
def test_forces_where_no_motion_moves_do_no_work(turned: float) -> None:
    """A frame on springs that leave it one motion, which does not move the unknown that is loaded and stopped.

    What it moves there is rounding, and so is all the work of the forces, which was measured against rounding.
    """
    frame = np.array(
        [
            [147.345703125, 55, -92, 0, 0, 0, -55, -55],
            [55, 86, 0, 0, 0, -31, -55, -55],
            [-92, 0, 334, -49, -49, 49, 0, 0],
            [0, 0, -49, 56.53125, 49, -49, 0, -1.125],
            [0, 0, -49, 49, 561, -49, -512, 0],
            [0, -31, 49, -49, -49, 80, 0, 0],
            [-55, -55, 0, 0, -512, 0, 567, 55],
            [-55, -55, 0, -1.125, 0, 0, 55, 265.125],
        ]
    )
    row = np.eye(8)[3:4] * turned
    problem = cq.ContactProblem(frame, [0, 0, 0, 1.490234375 * turned, 0, 0, 0, 0], row, [0.0026512146])
    right = cq.solve(problem)
    resisted = np.linalg.lstsq(frame, np.eye(8)[3], rcond=None)[0][3]
    assert right.normal_force == pytest.approx([1.490234375 - 0.0026512146 / resisted], rel=1e-9)
    shaken = right.displacement + 1e-17 * np.arange(8)
    certificate = cq.certify(problem, shaken, right.normal_force)
    assert certificate.passed
    assert certificate.balance == 0.0
    # Where motions do move, forces that do not balance are seen as ever.
    pushed = problem.replace(load=problem.load + 1e-6 * np.eye(8)[4])
    assert not cq.certify(pushed, shaken, right.normal_force).passed


def squeezed(net: float) -> cq.ContactProblem:
    """A chain of springs that loads of 2.3e13 pull apart and a net load presses on a stop."""
    chain = np.array([[376.0, -376, 0, 0], [-376, 15352, -14976, 0], [0, -14976, 43648, -28672], [0, 0, -28672, 28672]])
    load = [-1.0093173145300e11, 1.00931731456e11, 2.3089744183298e13, -2.3089744183301e13 + net]
    return cq.ContactProblem(chain, load, [[1.0, 0, 0, 0]], [0.0])


@pytest.mark.slow
def test_no_bound_is_claimed_of_contact_forces_that_count_as_nothing_beside_what_squeezes() -> None:
    # 8 of 4.6e13 is 2e-13: the load counts as balanced, and a force of -8 or 0 passes every figure.
    right = cq.solve(squeezed(8.0))
    assert right.certificate.proven
    assert right.normal_force[0] == pytest.approx(8.0, rel=1e-9)
    assert not cq.certify(squeezed(8.0), right.displacement, [4.0]).passed
    for wrong in (-8.0, 0.0):
        found = cq.certify(squeezed(8.0), right.displacement, [wrong])
        if found.passed:
            assert not found.proven
            assert "counts as nothing" in found.reasons[0]
        else:
            assert found.force_error > 0.5
    # What is more is seen, and refused.
    more = cq.solve(squeezed(8e3))
    for wrong in (-8e3, 0.0):
        assert not cq.certify(squeezed(8e3), more.displacement, [wrong]).passed


@pytest.mark.slow
def test_a_load_that_balances_but_for_its_rounding_is_proven() -> None:
    chain = squeezed(0.0)
    rng = np.random.default_rng(3)
    for _ in range(20):
        pulled = rng.normal(size=4)
        pulled -= np.mean(pulled)
        found = cq.solve(chain.replace(load=pulled, gap=[1e9])).certificate
        assert found.passed
        assert found.proven


@pytest.mark.parametrize("load", [1.0, 0.3, -1e6])
def test_a_massless_node_that_a_tie_holds_without_a_force_leaves_the_bounds(load: float) -> None:
    """What extended precision rounds of the load is all of the forces at the massless node; it drives nothing."""
    problem = cq.ContactProblem(
        np.diag([1e3, 0.0]), [load, 0.0], [[0.0, 1.0]], [1e4], tie=[[-1.0, 1.0]], tie_value=[0.0]
    )
    solution = cq.solve(problem)
    assert solution.certificate.proven
    assert solution.certificate.energy_error <= 1e-12


@pytest.mark.sampled(2)
@pytest.mark.parametrize("load", [1.0, 1e6])
def test_a_rounding_of_forces_elsewhere_at_a_massless_node_needs_no_balance(load: float) -> None:
    """A tie force of 1e-13 of the load was all of the forces at the massless node, and out of balance."""
    problem = cq.ContactProblem(
        np.diag([1e3, 0.0]), [load, 0.0], [[0.0, 1.0]], [1e4], tie=[[-1.0, 1.0]], tie_value=[0.0]
    )
    u = [load / 1e3] * 2
    assert cq.certify(problem, u, [0.0], None, [1e-13 * load]).passed
    assert not cq.certify(problem, u, [0.0], None, [1e-6 * load]).passed
    for force in (1e-6, -1e-6):
        assert not cq.certify(problem, u, [force * load], None, [0.0]).passed
    assert cq.certify(problem, normal_force=[0.0]).passed


@pytest.mark.sampled(3)
@pytest.mark.parametrize("noise", [8.4e-40, 0.0, -1e-33])
def test_a_tie_force_of_rounding_needs_no_balance_where_nothing_is_stiff(noise: float) -> None:
    """Two walls press on a node from both sides, by 13 and 11.75; a tie holds another node, with next to no force."""
    rows = dict(normal=[[0, 1, -1], [-1, 0, 1], [1, 0, -1], [4, 0, -4]], gap=[-0.5, 0, 0, 0.375])
    ties = dict(tie=[[0, 1, 0], [0, 0, 1]], tie_value=[-0.875, 0])
    problem = cq.ContactProblem(np.zeros((3, 3)), [-1.25, 0, 2.125], **rows, **ties)
    judged = cq.certify(problem, [0, -0.875, 0], [0, 13, 11.75, 0], None, [noise, 0.875])
    assert judged.proven
    assert not cq.certify(problem, [0, -0.875, 0], [0, 13, 11.75, 0], None, [1e-3, 0.875]).passed


def hinged_beam(turned: float) -> cq.ContactProblem:
    """A clamped beam, EI = EA = 1, of length 1; a hinge; two elements of 1/2 under a force -2 between; a roller."""

    def element(length: float) -> np.ndarray:
        bent, ends = np.array([[12, 6], [6, 4]]) / [[length**3, length**2], [length**2, length]], np.zeros((6, 6))
        ends[np.ix_([1, 2], [1, 2])], ends[np.ix_([4, 5], [4, 5])] = bent, bent * [[1, -1], [-1, 1]]
        ends[np.ix_([1, 2], [4, 5])] = [[-bent[0, 0], bent[0, 1]], [-bent[0, 1], bent[1, 1] / 2]]
        ends[np.ix_([4, 5], [1, 2])] = ends[np.ix_([1, 2], [4, 5])].T
        ends[np.ix_([0, 3], [0, 3])] = [[1 / length, -1 / length], [-1 / length, 1 / length]]
        c, s = np.cos(turned), np.sin(turned)
        across = np.kron(np.eye(2), [[c, s, 0], [-s, c, 0], [0, 0, 1]])
        return np.asarray(across.T @ ends @ across)

    stiffness = np.zeros((12, 12))
    stiffness[:3, :3] = element(1.0)[3:, 3:]
    for first in (3, 6):
        stiffness[first : first + 6, first : first + 6] += element(0.5)
    down = np.array([np.sin(turned), -np.cos(turned)])
    load, roller = np.zeros(12), np.zeros((1, 12))
    load[6:8], roller[0, 9:11] = 2 * down, down
    hinge = np.eye(2, 12) - np.eye(2, 12, 3)
    return cq.ContactProblem(stiffness, load, roller, [0.25], tie=hinge, tie_value=[0.0, 0.0])


@pytest.mark.parametrize("turned", [0.0, 0.5, np.pi / 2])
def test_a_bent_beam_with_a_hinge_is_proven_also_where_nothing_acts_along_it(turned: float) -> None:
    """The axial force of the hinge is rounding of the bending ones, and no force that a rigid motion leaves."""
    for units in (1.0, 1e3):
        beam = hinged_beam(turned)
        lengths = np.where(np.arange(12) % 3 == 2, units, 1.0)
        beam = beam.replace(stiffness=beam.stiffness * np.outer(lengths, lengths))
        found = cq.solve(beam)
        assert found.normal_force == pytest.approx([1.0], rel=1e-12)
        assert found.certificate.proven, found.certificate
        assert found.certificate.force_bound <= 1e-12
