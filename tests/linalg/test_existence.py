"""Absence is proven: a claim that nothing is an equilibrium carries what shows it, and that is true in exact sums."""

from __future__ import annotations

import math
import pickle
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.linalg import existence
from contactqp.linalg.existence import Conflict, DrivenMotion
from contactqp.model.solution import Answer
from contactqp.solving.sparse_run import refuse_ray

METHODS = ("active-set", "lemke", "daqp", "clarabel", "lagrange-multiplier")
BAR = 157500.0 * np.array([[1.0, -1.0], [-1.0, 1.0]])


def assert_conflict(problem: cq.ContactProblem, proof: Conflict) -> None:
    """E'y + A'n = 0, to rounding where it is said to be only that, and g'y + b'n < 0, all of it in rational numbers."""
    rows = [*problem.normal.toarray(), *problem.tie.toarray()]
    weights = [Fraction(float(x)) for x in (*proof.normal, *proof.tie)]
    limit = [Fraction(float(x)) for x in (*problem.gap, *problem.tie_value)]
    assert np.all(proof.normal >= 0)
    assert sum(w * g for w, g in zip(weights, limit, strict=True)) < 0
    for j in range(problem.dimension):
        terms = [w * Fraction(float(row[j])) for w, row in zip(weights, rows, strict=True)]
        assert abs(sum(terms)) <= Fraction(1, 2**48) * sum(abs(x) for x in terms)


@pytest.mark.sampled(15)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("part", [1e-6, 1e-9, 1e-12])
def test_gaps_that_conflict_by_little_are_a_conflict(method: str, part: float) -> None:
    problem = cq.ContactProblem(np.eye(2) * 1e5, [300.0, 0.0], [[1.0, 0.0], [-1.0, 0.0]], [1.0, -1.0 - part])
    with pytest.raises(cq.NoEquilibrium, match="contact 0, contact 1") as caught:
        cq.solve(problem, method)
    assert caught.value.proof.exact
    assert_conflict(problem, caught.value.proof)
    assert caught.value.proof.excess == pytest.approx(part, rel=1e-3)


@pytest.mark.sampled(15)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("part", [1e-6, 1e-9, 1e-12])
def test_ties_that_conflict_by_little_are_a_conflict(method: str, part: float) -> None:
    ties = dict(tie=[[1.0, 0.0], [2.0, 0.0]], tie_value=[1e-3, 2e-3 * (1 + part)])
    problem = cq.ContactProblem(np.eye(2) * 1e5, [300.0, 0.0], [[0.0, 1.0]], [1.0], **ties)
    with pytest.raises(cq.NoEquilibrium, match="tie 0, tie 1") as caught:
        cq.solve(problem, method)
    assert_conflict(problem, caught.value.proof)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", METHODS)
def test_ties_that_differ_by_rounding_are_no_conflict(method: str) -> None:
    ties = dict(tie=[[1.0, 0.0], [1.0, 0.0]], tie_value=[0.3, 0.1 + 0.2])
    problem = cq.ContactProblem(np.eye(2) * 1e5, [300.0, 100.0], [[0.0, 1.0]], [1e-4], **ties)
    solution = cq.solve(problem, method)
    assert solution.certificate.passed
    assert solution.displacement == pytest.approx([0.3, 1e-4], rel=1e-12)


@pytest.mark.sampled(9)
@pytest.mark.parametrize("turned", [0.0, 0.1, 0.2, 0.7])
@pytest.mark.parametrize("short", [1e-2, 3e-3, 1e-4, 1e-5])
def test_a_block_in_space_slides_in_all_frames(turned: float, short: float) -> None:
    """The slope is 1/2, mu = (1 - short) / 2; with more it rests. Along the proof no force of the cone works."""
    along, normal = np.array([2.0, 0.0, -1.0]) / math.sqrt(5), np.array([1.0, 0.0, 2.0]) / math.sqrt(5)
    c, s = math.cos(turned), math.sin(turned)
    tangent = np.array([[c, s], [-s, c]]) @ [along, [0.0, 1.0, 0.0]]
    block = cq.ContactProblem(np.zeros((3, 3)), [0, 0, -1.0], [-normal], [0.0], tangent, friction=(1 - short) / 2)
    with pytest.raises(cq.NoEquilibrium, match="the load drives a rigid motion") as caught:
        cq.solve(block)
    z = caught.value.proof.motion
    assert normal @ z >= (1 - 1e-12) * block.friction[0] * np.linalg.norm(tangent @ z)
    assert block.load @ z > 0
    assert cq.solve(block.replace(friction=(1 + short) / 2)).certificate.passed
    # The same as joints of a problem in local form.
    local = dict(bilateral=np.vstack([normal, tangent]), bilateral_offset=[0.0, 0.0, -1.0], dimension=3)
    with pytest.raises(cq.NoEquilibrium, match="the load drives a rigid motion"):
        cq.solve(cq.LocalProblem(np.zeros((3, 3)), np.zeros(3), (1 - short) / 2, **local))
    assert cq.solve(cq.LocalProblem(np.zeros((3, 3)), np.zeros(3), (1 + short) / 2, **local)).certificate.passed


@pytest.mark.sampled(8)
@pytest.mark.parametrize("seed", range(12))
def test_a_hidden_conflict_is_proven_and_its_absence_is_not_claimed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    E = rng.integers(-4, 5, (6, 4)).astype(float)
    u, weight = rng.integers(-3, 4, 4).astype(float), rng.integers(1, 4, 6).astype(float)
    E = np.vstack([E, -(weight @ E)])  # weight'E + last = 0
    met = E @ u
    apart = met + np.append(np.zeros(6), -(10.0 ** -rng.integers(3, 9)))
    K = np.eye(4) * 1e4
    assert cq.solve(cq.ContactProblem(K, np.ones(4), E, met)).certificate.passed
    with pytest.raises(cq.NoEquilibrium) as caught:
        cq.solve(cq.ContactProblem(K, np.ones(4), E, apart))
    assert_conflict(cq.ContactProblem(K, np.ones(4), E, apart), caught.value.proof)


def test_a_proof_travels_with_its_exception() -> None:
    problem = cq.ContactProblem(np.eye(1), [0.0], [[1.0], [-1.0]], [1.0, -2.0])
    with pytest.raises(cq.NoEquilibrium) as caught:
        cq.solve(problem)
    copy = pickle.loads(pickle.dumps(caught.value))
    assert str(copy) == str(caught.value)
    assert copy.proof.normal.tolist() == [1.0, 1.0]


@pytest.mark.sampled(8)
@pytest.mark.parametrize("method", METHODS)
def test_rounding_of_a_load_drives_nothing(method: str) -> None:
    """F sin(pi) = 4e-14 beside F on an unknown that nothing holds is no load, and off a stop it is no absence."""
    load = 300 * np.array([math.cos(math.pi), math.sin(math.pi)])
    bar = cq.ContactProblem(np.diag([157500.0, 0.0]), load, [[-1.0, 0.0]], [1e-3])
    solution = cq.solve(bar, method)
    assert solution.certificate.passed
    assert solution.normal_force == pytest.approx([300 - 157.5])
    assert solution.displacement[1] == 0
    with pytest.raises(cq.NoEquilibrium, match="unknown 1"):
        cq.solve(bar.replace(load=[load[0], 3e-10]), method)
    stopped = cq.ContactProblem(bar.stiffness, load, [[-1.0, 0.0], [0.0, -1.0]], [1e-3, 1.0])
    try:
        cq.solve(stopped, method)
    except cq.NoEquilibrium:
        pytest.fail("4e-14 beside 300 was taken for a load that drives a motion")
    except cq.ContactQPError:
        pass


@pytest.mark.slow
def test_a_load_that_may_be_rounding_is_told_where_nothing_is_found() -> None:
    load = 300 * np.array([math.cos(math.pi), math.sin(math.pi)])
    stopped = cq.ContactProblem(np.diag([157500.0, 0.0]), load, [[-1.0, 0.0], [0.0, -1.0]], [1e-3, 1.0])
    said = "so small that it may be rounding of other loads: unknown 1 by \\+1; state it as zero, or hold the motion"
    with pytest.raises((cq.NotConverged, cq.NotCertified), match=said):
        cq.solve(stopped)
    assert cq.solve(stopped.replace(load=[load[0], 0.0])).certificate.proven


@pytest.mark.parametrize("load", [1e-6, 1.0])
def test_a_load_that_drives_a_motion_is_named_with_the_motion(load: float) -> None:
    problem = cq.ContactProblem(np.diag([157500.0, 0.0]), [300.0, load], [[1.0, 0.0]], [1e-3])
    with pytest.raises(cq.NoEquilibrium, match=r"unknown 1 by \+1") as caught:
        cq.solve(problem)
    proof = caught.value.proof
    assert isinstance(proof, DrivenMotion)
    z = [Fraction(float(x)) for x in proof.motion]
    assert all(sum(Fraction(float(k)) * x for k, x in zip(row, z, strict=True)) == 0 for row in problem.stiffness)
    assert all(
        sum(Fraction(float(e)) * x for e, x in zip(row, z, strict=True)) <= 0 for row in problem.normal.toarray()
    )
    assert sum(Fraction(float(f)) * x for f, x in zip(problem.load, z, strict=True)) > 0


def test_loads_that_balance_to_seven_digits_name_motion_and_imbalance_and_the_way_out() -> None:
    load = np.array([100.0, -100.00001])
    problem = cq.ContactProblem(BAR, load, [[1.0, -1.0]], [1e-3])
    with pytest.raises(cq.NoEquilibrium, match=r"balance but for 1e-05 .*project them") as caught:
        cq.solve(problem)
    assert caught.value.proof.work == pytest.approx(1e-5, rel=1e-6)
    Z = np.ones((2, 1))
    balanced = load - Z @ np.linalg.solve(Z.T @ Z, Z.T @ load)
    assert cq.solve(problem.replace(load=balanced)).certificate.passed


# A frame of four nodes that floats; node 3 is held across by a stiff spring, so that it turns about that node alone.
FRAME = np.array(
    [
        [2, 1, -1, 0, 0, 0, -1, -1],
        [1, 2, 0, 0, 0, -1, -1, -1],
        [-1, 0, 2, -1, -1, 1, 0, 0],
        [0, 0, -1, 3442, 1, -1, 0, -1],
        [0, 0, -1, 1, 2, -1, -1, 0],
        [0, -1, 1, -1, -1, 2, 0, 0],
        [-1, -1, 0, 0, -1, 0, 2, 1],
        [-1, -1, 0, -1, 0, 0, 1, 2],
    ],
    dtype=float,
)
PUSHED = np.array([6.25, -5.73, -1.06, 0.4, 4.15, 12.3, -18.7, -10.1])


@pytest.mark.sampled(3)
@pytest.mark.parametrize("size", [1.0, 1e8, 2.0**40])
def test_contacts_where_a_motion_stands_still_do_not_resist_it(size: float) -> None:
    """The entry of a rigid motion at a node that it does not move is rounding, and a row there feels none of it."""
    rows = np.eye(8)[[3, 1, 3, 7, 4]]
    rows[3] = -rows[3]
    problem = cq.ContactProblem(FRAME, size * PUSHED, rows, np.zeros(5))
    with pytest.raises(cq.NoEquilibrium, match="drives a rigid motion") as caught:
        cq.solve(problem)
    assert np.all(problem.normal @ caught.value.proof.motion <= 1e-15)
    assert cq.solve(problem.replace(normal=np.vstack([rows, -np.eye(8)[[1, 4]]]), gap=np.zeros(7))).certificate.passed


def _pad(pull: float, count: int = 1) -> cq.ContactProblem:
    """Pads of 10 N each, all on springs of their own, all but the first of them at rest."""
    unit = np.eye(2 * count)
    load = np.zeros(2 * count)
    load[0], load[1::2] = pull, -10.0
    spring = np.diag(np.tile([1.0, 0.0], count))
    return cq.ContactProblem(spring, load, -unit[1::2], np.zeros(count), tangent=unit[::2], friction=0.3)


def test_with_friction_absence_is_proven_in_rational_numbers() -> None:
    """The spring across keeps the pad's normal force at 10 N: no motion alone proves that 5 N along it are too much."""
    sliding = _pad(5.0).replace(stiffness=np.diag([0.0, 1.0]))
    for algorithm in (None, "enumeration"):
        with pytest.raises(cq.NoEquilibrium, match="proven in rational numbers"):
            cq.solve(sliding, algorithm=algorithm)
    assert cq.exact_equilibria(sliding) == ()


def test_with_friction_a_driven_motion_proves_absence() -> None:
    sliding = _pad(5.0).replace(stiffness=np.zeros((2, 2)))
    with pytest.raises(cq.NoEquilibrium, match="no contact, friction or tie holds back") as found:
        cq.solve(sliding)
    motion = found.value.proof.motion
    assert sliding.load @ motion > 0
    assert motion[1] >= 0.3 * abs(motion[0])
    assert cq.exact_equilibria(sliding) == ()


def test_what_floats_did_not_find_is_not_denied(monkeypatch: pytest.MonkeyPatch) -> None:
    """Floats overlook the equilibrium: rationals find it, and where they cannot look nothing is denied."""
    monkeypatch.setattr("contactqp.solving.friction_runs.all_equilibria", lambda *_: ())
    assert cq.solve(_pad(5.0), algorithm="enumeration").certificate.passed
    monkeypatch.setattr("contactqp.solving.friction_runs.holds", lambda *_: False)
    with pytest.raises(cq.NotConverged, match="in rational numbers there is one"):
        cq.solve(_pad(5.0), algorithm="enumeration")
    with pytest.raises(cq.NotConverged, match="up to 4 contacts"):
        cq.solve(_pad(5.0, count=6), algorithm="enumeration")


@pytest.mark.sampled(20)
@pytest.mark.parametrize("seed", range(40))
def test_rigid_bodies_that_overlap_are_moved_apart(seed: int) -> None:
    """K = 0: the energy sees nothing; what is feasible by construction is found, with forces that balance the load."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 5)), int(rng.integers(1, 7))
    E = np.zeros((m, n))
    for row in E:
        touched = rng.choice(n, min(n, int(rng.integers(1, 3))), replace=False)
        row[touched] = rng.choice([-1.0, 1.0, 0.5, 2.0], len(touched))
    gap = E @ rng.normal(size=n) + rng.uniform(0, 1, m) * (rng.random(m) < 0.7)
    load = E.T @ (rng.uniform(0, 1, m) * (rng.random(m) < 0.5)) if rng.random() < 0.6 else np.zeros(n)
    solution = cq.solve(cq.ContactProblem(np.zeros((n, n)), load, E, gap))
    assert solution.certificate.passed
    assert np.all(solution.gap >= -1e-12)
    assert E.T @ solution.normal_force == pytest.approx(load, abs=1e-12)


@pytest.mark.parametrize("condense", ["auto", False])
def test_constraints_that_conflict_are_told_before_a_motion_that_the_load_drives(condense: Any) -> None:
    """A support along the driven motion, which was advised, would not move the two walls apart."""
    problem = cq.ContactProblem(np.zeros((2, 2)), [0.0, 1.0], [[1.0, 0.0], [-1.0, 0.0]], [-1.0, -1.0])
    with pytest.raises(cq.NoEquilibrium, match="contact 0, contact 1") as caught:
        cq.solve(problem, condense=condense)
    assert_conflict(problem, caught.value.proof)
    # The sparse way found first that the energy falls for ever, where a row contradicts a tie.
    rows = [[1, -1, 0, 0], [1, -1, -1, 0], [0, -1, 1, 1], [0, -1, 0, 1], [0, 0, 0, -1]]
    ties = [[0, -1, 1, 1], [1, 0, 1, 1]]
    falling = cq.ContactProblem(
        np.zeros((4, 4)), [0.0, 1.0, 1.0, 0.0], rows, [0, 0, 1, 0, 0], tie=ties, tie_value=[2, 2]
    )
    with pytest.raises(cq.NoEquilibrium, match="contact 2, tie 0"):
        cq.solve(falling, condense=condense)


def test_a_stated_translation_is_named_before_what_gains_most() -> None:
    """A free block that its load lifts off and would turn besides: up, which is simplest, is what is said."""
    structure = cq.Structure(
        [cq.Body(cq.rectangle(2.0, 1.0, (2, 1)), cq.Material(1.0, 0.3), "plane-strain", name="block")]
    )
    floor = cq.pair(structure.surface("block", "bottom"), cq.Plane([0.0, 0.0], [0.0, 1.0]))
    load = [cq.Traction("block", "left", [0.0, 3.0])]
    with pytest.raises(
        cq.NoEquilibrium, match=r"holds back: block along y by \+1 .*; hold it by a support, a tie or a contact"
    ):
        cq.solve(structure.assemble([], load).problem([floor]))


def test_an_overlap_is_said_as_a_length() -> None:
    walls = cq.ContactProblem([[2.0]], [0.0], [[1.0], [-1.0]], [0.5, -0.55], units={"length": "mm", "force": "N"})
    with pytest.raises(cq.NoEquilibrium, match=r"contact 0, contact 1 \(weighted, they overlap by 0.05 mm, rounding"):
        cq.solve(walls)


def held_grid(side: int, flux: float) -> cq.ContactProblem:
    """A grid whose values lie between 0 and 10, all their second differences zero, with this slope at the border."""
    chain = sp.diags([1.0, -2.0, 1.0], [-1, 0, 1], shape=(side, side)).tolil()
    chain[0, 0] = chain[-1, -1] = -1.0
    one, size = sp.identity(side), side * side
    ends = np.zeros(side)
    ends[0] = ends[-1] = 1.0
    value = flux * (np.kron(ends, np.ones(side)) + np.kron(np.ones(side), ends))
    both = sp.vstack([sp.identity(size), -sp.identity(size)], format="csr")
    gap = np.concatenate([np.full(size, 10.0), np.zeros(size)])
    tie = sp.csr_matrix(sp.kron(one, chain) + sp.kron(chain, one))
    return cq.ContactProblem(sp.identity(size, format="csr"), np.ones(size), both, gap, tie=tie, tie_value=value)


@pytest.mark.slow
def test_forces_that_diverge_prove_a_conflict_without_a_linear_program(monkeypatch: pytest.MonkeyPatch) -> None:
    """A linear program took a minute of these constraints, of which an interior point's forces are the proof."""
    monkeypatch.setattr(existence, "_least_excess", None)
    problem = held_grid(12, 1.0)
    with pytest.raises(cq.NoEquilibrium, match="no displacement satisfies") as error:
        cq.solve(problem, condense=False)
    proof = error.value.proof
    assert isinstance(proof, Conflict)
    assert_conflict(problem, proof)
    assert cq.solve(held_grid(12, 0.0), condense=False).certificate.proven


def test_a_displacement_that_diverges_proves_a_drive_without_a_linear_program(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scipy.optimize.linprog", None)
    size = 60
    K = sp.diags([1.0] * size + [0.0] * size, format="csr")
    tie = sp.csr_matrix(np.hstack([np.zeros((size - 1, size)), np.diff(np.eye(size), axis=0)]))
    load = np.concatenate([np.ones(size), np.full(size, 0.25)])
    below = sp.hstack([sp.csr_matrix((size, size)), -sp.identity(size)], format="csr")
    with pytest.raises(cq.NoEquilibrium, match="energy falls for ever") as error:
        cq.solve(cq.ContactProblem(K, load, below, np.zeros(size), tie=tie), condense=False)
    proof = error.value.proof
    assert isinstance(proof, DrivenMotion)
    assert np.all(tie @ proof.motion == 0)
    assert np.all(below @ proof.motion <= 0)
    assert np.all(K @ proof.motion == 0)
    assert load @ proof.motion > 0


@pytest.mark.slow
@pytest.mark.parametrize("size", [3_000, pytest.param(10_000, marks=pytest.mark.slow)])
def test_a_smooth_motion_of_a_long_chain_is_no_proof(size: int) -> None:
    """A beam of ten thousand differences resists it by less than rounding of its entries, and holds all the same."""
    second = sp.diags([1.0, -2.0, 1.0], [-1, 0, 1], shape=(size, size))
    K = sp.csr_matrix(second.T @ second)
    smooth = np.sin(np.pi * (np.arange(size) + 1) / (size + 1))
    assert np.max(abs(K @ smooth)) < 2e-14 * (10_000 / size) ** 4
    problem = cq.ContactProblem(K, np.ones(size), -sp.identity(size, format="csr"), np.ones(size))
    diverged = Answer(1e20 * smooth, np.zeros(size), None, np.zeros(0))
    refuse_ray(problem, diverged)


@pytest.mark.parametrize("force", [1.0, 1e30])
def test_figures_of_a_proof_are_in_the_units_of_the_problem(force: float) -> None:
    """Walls 2 mm into each other, and a load on what nothing holds, whatever the size of forces."""
    spring = cq.ContactProblem([[force]], [force], [[1.0], [-1.0]], [-1.0, -1.0], units={"length": "mm", "force": "N"})
    with pytest.raises(cq.NoEquilibrium) as refused:
        cq.solve(spring)
    assert "(weighted, they overlap by 2 mm, rounding 4e-15)" in str(refused.value)
    assert "figures" not in str(refused.value)
    with pytest.raises(cq.NoEquilibrium, match=r"holds back: unknown 0 by \+1; hold it by[^(]*$"):
        cq.solve(cq.ContactProblem([[0.0]], [force], [[-1.0]], [0.0]))


def test_figures_that_are_not_of_the_proof_have_their_units_named() -> None:
    """Loads that balance but for a part of 1e-6: what is left of them is told in the units of the solution."""
    rod = cq.ContactProblem(
        1e30 * np.array([[1.0, -1.0], [-1.0, 1.0]]), [1e30, -1e30 * (1 - 1e-6)], [[-1.0, 0.0]], [0.0]
    )
    with pytest.raises(cq.NoEquilibrium, match=r"balance but for .*\(figures in this message are in units that"):
        cq.solve(rod)


@pytest.mark.slow
@pytest.mark.parametrize("condense", [True, False])
def test_rows_that_cancel_to_rounding_only_leave_room_far_away(condense: bool) -> None:
    """No row of the three is a sum of the others exactly: E'l = f has one solution, and E u = g is where it acts."""
    problem = cq.ContactProblem(
        np.zeros((3, 3)),
        [2.0, 2.8, 6.3],
        [[1.0, 0.7, 2.0], [-1.0, 0.7, 0.3], [1.0, -2.0999999999999996, -2.6]],
        [1.9, -0.27, -1.3600000000000567],
    )
    exact = cq.exact(problem, enclose=False)
    assert list(exact.gap) == [0, 0, 0]
    assert max(abs(exact.doubles.displacement)) < 200
    assert cq.solve(problem, condense=condense).certificate.passed


def test_a_turn_of_a_block_is_named_by_the_block_and_the_node_that_stays() -> None:
    """A block on a hinge at node 0, by ties, and by supports, whose unknowns are none of the problem."""
    structure = cq.Structure(
        [cq.Body(cq.rectangle(2.0, 1.0, (2, 1)), cq.Material(1.0, 0.3), "plane-strain", name="block")]
    )
    lifted = [cq.Traction("block", "right", [0.0, 3.0])]
    free = structure.assemble([], lifted).problem([])
    hinged = free.replace(tie=np.eye(12)[:2], tie_value=np.zeros(2))
    words = r"holds back: block turning about node 0 \(node 4 y by \+1 and 6 more\);"
    with pytest.raises(cq.NoEquilibrium, match=words):
        cq.solve(hinged)
    (motion,) = cq.solve(hinged.replace(load=np.zeros(12))).free_motions
    assert str(motion).startswith("block turning about node 0 (node 4 y by ")
    held = [cq.Support("block", 0, "x"), cq.Support("block", 0, "y")]
    with pytest.raises(cq.NoEquilibrium, match=r"holds back: block turning \(node 4 y by \+1 and 6 more\);"):
        cq.solve(structure.assemble(held, lifted).problem([]))
