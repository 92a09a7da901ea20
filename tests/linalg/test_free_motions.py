"""Motions that neither stiffness nor closed contacts resist move bodies rigidly, to the last digits."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.linalg import floating
from contactqp.linalg.condensation import condense
from contactqp.linalg.dense import saddle_point


@pytest.mark.slow
def test_free_motions_move_a_stiff_body_rigidly_though_it_hardly_moves() -> None:
    """Springs do no work: their nodes move alike, in every free motion of four chains on two walls."""
    K, bodies, moving = np.zeros((9, 9)), (slice(0, 3), slice(3, 5), slice(5, 7), slice(7, 9)), 0
    for first, spring in ((0, 2.0**25), (1, 1368.0), (3, 1.0), (5, 1.0), (7, 1.0)):
        K[first : first + 2, first : first + 2] += spring * np.array([[1, -1], [-1, 1]])
    for seed in range(40):
        rng = np.random.default_rng(seed)
        walls = rng.integers(1, 9, (2, 9)) * rng.choice([-1, 1], (2, 9)) / 4
        condensation = condense(cq.ContactProblem(K, np.zeros(9), walls, [0.0, 0.0]))
        scaled = saddle_point(condensation, np.array([0, 1])).free
        motions = scaled * condensation.scale[:, None]
        for body in bodies:
            for q in np.flatnonzero(np.max(abs(scaled[body]), axis=0) > 1e-6):
                moving += 1
                assert np.ptp(motions[body, q]) <= 1e-14 * np.max(abs(motions[body, q]))
    assert moving > 200


def test_large_loads_that_balance_on_a_stiff_body_drive_no_free_motion() -> None:
    """A chain of 2e7 and 1368 beside a lattice: loads of 3.5e7 and contact forces of one, which are 15/8 and 9/8."""
    strain = np.array([
        [1, 1, 0, 0, 0, 0, -1, -1], [1, 0, -1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, -1, 0, 0],
        [0, 0, 1, -1, -1, 1, 0, 0], [0, 0, 0, 1, 0, 0, 0, -1], [0, 0, 0, 0, 1, 0, -1, 0],
    ])  # fmt: skip
    K = np.zeros((11, 11))
    K[:2, :2] = 19922944.0 * np.array([[1, -1], [-1, 1]])
    K[1:3, 1:3] += 1368.0 * np.array([[1, -1], [-1, 1]])
    K[3:, 3:] = strain.T @ strain
    E = [
        [-1, -1, 0.25, 0.25, 0, 1.75, -0.25, 0.75, 1, 0, 0.5],
        [1, 0.5, 0.5, 0.25, -0.5, 1, 0.5, 1, -1, -0.75, 0.5],
        [1, 0.75, 0, 0.25, -0.25, 0.5, 0.5, -1, 1.5, 0.25, -0.5],
        [1, 0.5, 0.5, 0.25, -0.5, 1, 0.5, 1, -1, -0.75, 0.5],
    ]
    load = [34865155.0, -34867031.21875, 1881.9375, -1.375, -3.59375, 3.4375, -0.25, -1.625, 1.0625, 2.375, 3.25]
    problem = cq.ContactProblem(K, load, E, [-1.03125, -0.09375, 0.15625, 0.03125])
    moved = np.array([14861, -20195, 7349, -5176, -18053, -2672, -5947, -24794, -10541, 5254, 11581]) / 20032
    assert cq.certify(problem, moved, [0.0, 1.875, 1.125, 0.0]).proven
    assert cq.solve(problem).normal_force == pytest.approx([0.0, 1.875, 1.125, 0.0], abs=1e-12)


def chain(n: int) -> sp.csr_matrix:
    """Return the stiffness of n nodes joined by springs of one, free to slide."""
    diagonal = np.full(n, 2.0)
    diagonal[[0, -1]] = 1.0
    return sp.diags([np.full(n - 1, -1.0), diagonal, np.full(n - 1, -1.0)], [-1, 0, 1], format="csr")


def sliding_chains(chains: int, n: int, contacts: int, load: float) -> tuple[cq.ContactProblem, np.ndarray, np.ndarray]:
    """Return chains whose neighbours may meet, and their displacement of least norm and forces in closed form.

    A spring that carries N shortens by N or as far as its contact admits, which carries the rest.
    """
    rng, first = np.random.default_rng(0), np.arange(contacts)
    f = load * rng.integers(-4, 5, (chains, n)).astype(float)
    f[:, 0] -= f.sum(axis=1)
    columns = np.stack([first, first + 1], axis=1).ravel()
    meets = sp.csr_matrix((np.tile([1.0, -1.0], contacts), (np.repeat(first, 2), columns)), shape=(contacts, n))
    gap, carried = rng.integers(1, 9, (chains, contacts)) / 8, np.cumsum(f, axis=1)[:, :-1]
    shortened = carried.copy()
    shortened[:, :contacts] = np.minimum(carried[:, :contacts], gap)
    u = np.hstack([np.zeros((chains, 1)), -np.cumsum(shortened, axis=1)])
    K, E = (sp.block_diag([part] * chains, format="csr") for part in (chain(n), meets))
    problem = cq.ContactProblem(K, f.ravel(), E, gap.ravel())
    return problem, (u - u.mean(axis=1)[:, None]).ravel(), (carried - shortened)[:, :contacts].ravel()


@pytest.mark.sampled(3)
@pytest.mark.parametrize("load", [1.0, 0.0])
@pytest.mark.parametrize(
    ("chains", "n", "contacts"), [(1, 2, 1), (1, 20, 10), (3, 10, 8), (1, 1000, 600), (5, 400, 300)]
)
def test_sparse_systems_list_free_motions_and_return_the_least_norm(
    chains: int, n: int, contacts: int, load: float
) -> None:
    """No contact across the chains resists their sliding, also where many are closed."""
    problem, moved, pushed = sliding_chains(chains, n, contacts, load)
    solution, size = cq.solve(problem, condense=False), abs(moved).max() or 1.0
    assert solution.certificate.proven
    assert solution.work.retained == problem.dimension
    assert len(solution.free_motions) == chains
    assert solution.displacement == pytest.approx(moved, abs=1e-13 * size * bool(load), rel=0)
    assert solution.normal_force == pytest.approx(pushed, abs=1e-12 * size * bool(load), rel=0)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("problem", "moved", "free"),
    [
        (cq.ContactProblem([[0.0, 0], [0, 0]], [1.0, 0], [[1.0, 0], [0, 1], [0, -1]], [1.0, 5, -3]), [1, 3], 1),
        (cq.ContactProblem(np.zeros((2, 2)), [1.0, 1], [[1.0, 1], [-1, 0], [0, -1]], [1.0, 0, 0]), [0.5, 0.5], 1),
        (cq.ContactProblem(np.diag([1.0, 0]), [1.0, 0], [[0.0, -1]], [2.0]), [1, 0], 1),
        (cq.ContactProblem([[1.0, -1], [-1, 1]], [1.0, -1], [[1.0, -1]], [0.5]), [0.25, -0.25], 1),
        (cq.ContactProblem([[1.0, -1], [-1, 1]], [0.0, 0], [[1.0, 0], [0, -1]], [-1.0, 1]), [-1, -1], 0),
        (cq.ContactProblem([[1.0, -1], [-1, 1]], [0.0, 0], [[1.0, 0], [0, -1]], [-1.0, 2]), [-1, -1], 1),
    ],
)
def test_programs_of_sparse_systems_rest_at_the_least_norm(problem: cq.ContactProblem, moved: list, free: int) -> None:
    """What neither load nor rows determine is nearest to zero, at the gaps where these leave zero out."""
    solution = cq.solve(problem, condense=False)
    assert solution.displacement == pytest.approx(moved, abs=1e-14)
    assert len(solution.free_motions) == free
    assert solution.certificate.proven


@pytest.mark.slow
@pytest.mark.parametrize(("unknowns", "free"), [(100, 99), (700, 0)])
def test_hundreds_of_unknowns_without_stiffness_are_searched_for_free_motions_and_no_more(
    unknowns: int, free: int
) -> None:
    """A cost drives one unknown against its bound and determines no other; a search takes the cube of their number."""
    cost, both = np.zeros(unknowns), sp.vstack([sp.identity(unknowns), -sp.identity(unknowns)], format="csr")
    cost[0] = 1.0
    problem = cq.ContactProblem(sp.csr_array((unknowns, unknowns)), cost, both, np.ones(2 * unknowns))
    solution = cq.solve(problem, condense=False)
    assert solution.certificate.proven
    assert solution.displacement[0] == 1.0
    assert len(solution.free_motions) == free


@pytest.mark.sampled(2)
@pytest.mark.parametrize("decimal", [1e-6, 2.0**-20])
def test_a_chain_over_many_bounds_rests_on_the_first_that_it_meets(decimal: float) -> None:
    """The load balances, to rounding only in decimals, and the least norm presses nothing."""
    n = 3000
    load = np.random.default_rng(0).integers(-3, 3, n).astype(float)
    load[0] -= load.sum()
    problem = cq.ContactProblem(chain(n), load * decimal, -sp.identity(n, format="csr"), np.full(n, -1.0))
    solution = cq.solve(problem)
    moved = -np.concatenate([[0.0], np.cumsum(np.cumsum(load)[:-1])]) * decimal
    assert solution.displacement == pytest.approx(moved - moved.min() + 1, rel=1e-12)
    assert len(solution.free_motions) == 1
    assert not solution.normal_force.any()


def test_free_motions_of_many_bodies_are_listed() -> None:
    """Eighty blocks on each other, each free to slide: none was listed, and the answer lay anywhere along them."""
    count = 80
    shapes = [cq.rectangle(1.0, 0.25, ((7, 5)[i % 2], 2), corner=(0.0, 0.25 * i)) for i in range(count)]
    blocks = [cq.Body(shape, cq.Material(1.0, 0.3), "plane-strain", name=f"b{i}") for i, shape in enumerate(shapes)]
    structure = cq.Structure(blocks)
    held = structure.assemble([cq.Support("b0", "bottom", axis) for axis in range(2)])
    faces = [(structure.surface(f"b{i}", "top"), structure.surface(f"b{i + 1}", "bottom")) for i in range(count - 1)]
    load = np.zeros(structure.size)
    load[1::2] = -1e-5
    problem = held.problem([cq.pair_mortar(*both) for both in faces]).replace(load=load[held.free])
    solution = cq.solve(problem)
    assert solution.certificate.passed
    motions = np.column_stack([motion.direction for motion in solution.free_motions])
    slid = np.zeros((structure.size, count - 1))
    for i in range(count - 1):
        slid[
            structure.first(f"b{i + 1}") : structure.first(f"b{i + 1}") + 2 * len(blocks[i + 1].mesh.points) : 2, i
        ] = 1
    slid = slid[held.free] / np.linalg.norm(slid, axis=0)
    assert motions.shape[1] == count - 1
    assert np.linalg.norm(motions - slid @ (slid.T @ motions)) < 1e-12
    assert abs(slid.T @ solution.displacement).max() < 1e-13 * np.linalg.norm(solution.displacement)


TEXTBOOK = {
    "master-slave": {}, "lagrange-multiplier": {}, "penalty": {"penalty": 2.0**40},
    "perturbed-lagrangian": {"perturbation": 2.0**40}, "augmented-lagrangian": {},
}  # fmt: skip


@pytest.mark.sampled(3)
@pytest.mark.parametrize("load", [1.0, 0.0])
@pytest.mark.parametrize(("method", "options"), TEXTBOOK.items())
def test_textbook_systems_of_all_unknowns_are_regular_where_chains_slide(
    method: str, options: dict, load: float
) -> None:
    """Springs without force hold what nothing drives, and the answer is that of the least norm."""
    problem, moved, pushed = sliding_chains(2, 9, 5, load)
    solution = cq.solve(problem, method=method, condense=False, **options)
    assert solution.work.retained == problem.dimension
    assert len(solution.free_motions) == 2
    assert solution.displacement == pytest.approx(moved, abs=1e-9)
    assert solution.normal_force == pytest.approx(pushed, abs=1e-3)  # rounding of penalties of 1e12


@pytest.mark.parametrize("bodies", [1, 2])
def test_free_motions_of_blocks_are_translations_along_axes_and_turns(bodies: int) -> None:
    """Blocks of two by two elements pressed on a floor: each may slide along x and y, and turn about z."""
    names = [f"b{i}" for i in range(bodies)]
    cube = cq.box((1.0, 1.0, 1.0), (2, 2, 2))
    structure = cq.Structure([cq.Body(cube, cq.Material(1e6, 0.3), "3d", name=b) for b in names])
    floor = [cq.pair(structure.surface(b, "bottom"), cq.Plane([0, 0, 0], [0, 0, 1.0])) for b in names]
    problem = structure.assemble([], [cq.Pressure(b, "top", 1.0) for b in names]).problem(floor)
    motions = cq.solve(problem).free_motions
    slides = [f"{b} along {axis} by +1 (node 0 and 26 more)" for b in names for axis in "xy"]
    assert [str(motion) for motion in motions[: 2 * bodies]] == slides
    assert len(motions) == 3 * bodies
    directions = np.array([motion.direction for motion in motions])
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    assert unit @ unit.T == pytest.approx(np.eye(3 * bodies), abs=1e-12)
    assert abs(directions[:, 2::3]).max() < 1e-12  # nothing leaves the floor
    assert abs(problem.stiffness_rows @ directions.T).max() < 1e-6 * problem.diagonal.max()


def test_what_rows_feel_of_many_bodies_is_found_in_one_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of four hundred bodies each had been cut out of the rows. The largest entries of a row on each of them count."""
    rng = np.random.default_rng(5)
    rows, bodies = sp.random(7, 12, 0.4, random_state=rng, format="csr"), rng.integers(0, 5, 12)
    of_motion = np.array([3, 0, 3, 4])
    found = floating._largest_entries(rows, bodies, of_motion)
    for i, row in enumerate(abs(rows.toarray())):
        assert found[i].tolist() == [max(row[bodies == body], default=0.0) for body in of_motion]
    monkeypatch.setattr(sp.csr_matrix, "__getitem__", None)  # no body is cut out
    motions, K = np.eye(4), sp.csr_matrix([[1.0, 0, 0, 0], [0, 2.0, -1.0, 0]])
    left = floating.unresisted(motions, np.arange(4), K)
    assert abs(K @ left).max() <= 1e-14
    assert left.shape == (4, 2)
