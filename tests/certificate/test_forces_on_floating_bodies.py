"""Forces and answers of bodies that float: each is judged beside what acts there, in any units and however far away."""

from fractions import Fraction

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate.figures import force_norm
from contactqp.linalg.condensation import condense
from contactqp.linalg.extended import extend
from tests.certificate.test_floating_bounds import braced_square


@pytest.mark.parametrize(
    ("unknown", "row"),
    [((1.0, 1.0, 1.0), 1.0), ((2.0**9, 2.0**-13, 2.0**-20), 2.0**-24), ((2.0**-20, 2.0**15, 2.0**9), 2.0**19)],
)
def test_a_force_on_a_floating_body_is_judged_beside_the_largest_in_any_units(unknown, row: float) -> None:
    """A bar under 1e5 at both ends leans on a stop with 1.125: off by 1e-5 it passed where unknowns had other units.

    The energy norm of forces on what floats has the rigid response in it, which depends on the units of unknowns.
    """
    d = np.asarray(unknown)
    K = 1e6 * np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    problem = cq.ContactProblem(
        stiffness=K / np.outer(d, d), load=np.array([1e5 + 1.125, 0.0, -1e5]) / d,
        normal=np.array([[1.0, 0.0, 0.0]]) / d * row, gap=[0.0],
    )  # fmt: skip
    right = cq.solve(problem)
    assert right.normal_force * row == pytest.approx([1.125], rel=1e-10)
    forged = cq.certify(problem, right.displacement, right.normal_force * (1 + 1.1e-5))
    assert not forged.passed
    assert any("the force of contact 0" in failure and "1.1e-05" in failure for failure in forged.failures)


# A lattice of eight unknowns that one spring holds: it turns and slides freely.
LATTICE = np.array(
    [
        [819600, 400, -819200, 0, 0, 0, -400, -400],
        [400, 6416, 0, 0, 0, -6016, -400, -400],
        [-819200, 0, 819205.75, -5.75, -5.75, 5.75, 0, 0],
        [0, 0, -5.75, 92165.75, 5.75, -5.75, 0, -92160],
        [0, 0, -5.75, 5.75, 7557.9208984375, -5.75, -7552, 0],
        [0, -6016, 5.75, -5.75, -5.75, 6021.75, 0, 0],
        [-400, -400, 0, 0, -7552, 0, 7952, 400],
        [-400, -400, 0, -92160, 0, 0, 400, 92560],
    ]
)


def test_no_rigid_motion_that_leaves_a_gap_penetrated_bounds_forces_of_the_wrong_sign():
    """A rigid motion meets either contact alone, and both strain it: what is not met counts, pushing or not."""
    normal = np.zeros((2, 8))
    normal[0, [1, 2]], normal[1, [2, 5]] = (-1, 1), (-1, 1)
    problem = cq.ContactProblem(LATTICE, np.zeros(8), normal, [0.1484375, -0.3896484375])
    right = cq.solve(problem)
    assert np.all(right.normal_force > 1000)
    certificate = cq.certify(problem, right.displacement, -right.normal_force)
    assert not certificate.passed
    assert np.all(certificate.force_bound >= 2 * right.normal_force * (1 - 1e-9))


def test_forces_on_what_floats_are_measured_where_units_differ_by_1e8():
    """One of two free motions has 1e-8 of its size at an unknown whose unit makes it matter as much."""
    K = np.array([[12 * 2.0**30, -96.0, -(3 * 2.0**18)], [-96.0, 2.0**-20, 2.0**-8], [-(3 * 2.0**18), 2.0**-8, 64.0]])
    K = K[np.ix_([0, 1, 2, 0], [0, 1, 2, 0])]
    problem = cq.ContactProblem(K, np.zeros(4), [[2.0**16, 0.0, 0.0, 0.0]], [1.0])
    assert condense(problem).rigid.count == 2
    norm, uncertain = force_norm(problem, condense(problem), extend(np.ones(1)))
    # What no motion takes of the force is C y, C being columns of K that span the others.
    C = [[Fraction(entry) for entry in K[:, place]] for place in (0, 2)]
    gram = [[sum(a * b for a, b in zip(one, other, strict=True)) for other in C] for one in C]
    work = [column[0] * 2**16 for column in C]
    determinant = gram[0][0] * gram[1][1] - gram[0][1] ** 2
    y = [
        (gram[1][1] * work[0] - gram[0][1] * work[1]) / determinant,
        (gram[0][0] * work[1] - gram[0][1] * work[0]) / determinant,
    ]
    resisted = [y[0] * C[0][i] + y[1] * C[1][i] for i in (0, 2)]
    exact = float(y[0] * resisted[0] + y[1] * resisted[1]) ** 0.5
    assert abs(norm - exact) <= uncertain + 1e-15 * exact
    assert uncertain < 1e-9 * exact


def test_a_candidate_far_away_does_not_make_the_truth_small() -> None:
    """A candidate that has moved by 1e6 rounds away the strain of the truth; the truth's own is known all the same."""
    problem = cq.ContactProblem(braced_square(1e2), np.tile([0.0, -1e-9], 4), np.eye(8)[[1, 3]] * -1.0, [1e-5, 1e-5])
    truth = cq.solve(problem)
    far = truth.displacement + 5e6 * np.tile([0.3, 1.0], 4)
    far[4] += 1e-6
    apart = far - truth.displacement
    strain = np.sqrt(apart @ problem.stiffness @ apart)
    size = np.sqrt(truth.displacement @ problem.stiffness @ truth.displacement)
    found = cq.certify(problem, far, truth.normal_force)
    assert size > 0
    assert found.energy_error >= 0.5 * strain / size > 1e3
    assert not found.passed


@pytest.mark.sampled(3)
@pytest.mark.parametrize("far", [1e16, 1e22, 1e24, 1e34, 1e60])
@pytest.mark.parametrize("frictional", [False, True])
def test_no_motion_is_so_large_that_it_hides_what_is_wrong(far: float, frictional: bool) -> None:
    """Two masses on a spring are wedged apart by two: moved as far as that, both alike, they are penetrated by two."""
    K = np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    law = dict(tangent=[[0.0, 0.0, 1.0]], friction=0.25) if frictional else {}
    wedge = cq.ContactProblem(K, [0.0, 0.0, 1.0], [[1.0, -1.0, 0.0]], [-2.0], **law)
    friction = [[0.5]] if frictional else None
    beside = 0.5 if frictional else 1.0
    for force in (2.0, 2.02, 0.0):
        assert not cq.certify(wedge, [far, far, beside], [force], friction).passed
    assert cq.certify(wedge, [2.0**40, 2.0**40 + 2.0, beside], [2.0], friction).passed


@pytest.mark.slow
def test_a_motion_that_a_tie_asks_for_without_forces_is_right() -> None:
    """A mechanism between two contacts that touch, moved by a tie alone: all forces are zero, exactly.

    What refinement left of its strain, 1e-25, was held against a tolerance of zero.
    """
    side, turned = np.array([-3.0, 1.0, 0.0, 0.0, 3.0, -1.0, 0.0, 0.0]), np.zeros(8)
    turned[[1, 3]] = 4.0, -4.0
    problem = cq.ContactProblem(
        stiffness=np.outer(side, side) + np.outer(turned, turned),
        load=np.zeros(8),
        normal=[[-2.0, 0, 0, 0, 2.0, 0, 0, 0], [-3.0, 1.0, 0, 0, 0, 0, 0, 0]],
        gap=[0.0, 0.0],
        tie=[[0, 1.0, 0, 0, 0, 0, -2.0, 0], [0, 0, 2.0, 2.0, 0, 0, 0, 0]],
        tie_value=[-1.0, 0.0],
    )
    u = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0])
    assert cq.certify(problem, u).passed
    assert cq.certify(problem, u, [0.0, 0.0], None, [0.0, 0.0]).passed
    for pushed, held in (([1e-9, 0.0], [0.0, 0.0]), ([0.0, 1e-15], [0.0, 0.0]), ([0.0, 0.0], [1e-12, 0.0])):
        assert not cq.certify(problem, u, pushed, None, held).passed
    assert not cq.certify(problem, u + 1e-6 * np.eye(8)[1]).passed


def test_a_contact_that_no_rigid_motion_moves_carries_nothing_of_what_rounding_leaves() -> None:
    """A lattice of springs with two rigid motions, neither of which moves unknown 1, where a contact grazes."""
    K = np.zeros((7, 7))
    springs = {(0, 4): -68, (0, 5): -6, (0, 6): -6, (1, 2): -28, (1, 3): -28, (1, 4): 28, (2, 3): 28, (2, 4): -28}
    for (i, j), k in (springs | {(2, 6): -224, (3, 4): -28, (3, 5): -528, (5, 6): 6}).items():
        K[i, j] = K[j, i] = k
    K += np.diag([74, 46, 252, 556, 96, 534, 230])
    load = [-32.5, 0.75, -234.5, 451.5, 45.25, -463.5, 222.5]
    rows = np.zeros((3, 7))
    rows[[0, 0, 1, 2, 2], [1, 4, 1, 1, 4]] = -1, 1, 1, -0.5, 0.5
    solution = cq.solve(cq.ContactProblem(K, load, rows, [-0.375, -0.5, 0.1875]))
    assert solution.normal_force == pytest.approx([0.75, 0.0, 0.0], abs=1e-14)
    assert solution.certificate.proven
    assert np.max(solution.certificate.force_bound) < 1e-12


def _grazing(push: float) -> cq.ContactProblem:
    """A stiffness of rank one under 5242880 at contact 0 and `push` at contact 1; gaps 0, 0, 8.5e-8, 0."""
    stretch = np.array([1.0, 1.0, 2.0, -2.0])
    return cq.ContactProblem(
        stiffness=np.outer(stretch, stretch),
        load=[15728638.012695312, -1.98730468750 + 2 * push, 10485756.025390625, 3.974609375 - push],
        normal=[[3.0, 0.0, 2.0, 0.0], [0.0, 2.0, 0.0, -1.0], [-3.0, 0.0, 0.0, 0.0], [3.0, -1.0, 1.0, 0.0]],
        gap=[6.01171875, -1.998046875, -5.999999915249646, 6.0048828125],
    )


@pytest.mark.sampled(3)
@pytest.mark.parametrize("power", [-40, -37, -34, -31, -29])
def test_bounds_of_forces_contain_what_a_load_leaves_out_of_balance(power: int) -> None:
    """A force of 2^-29 beside one of 5e6 is within rounding of a balance without it, which does not make it zero."""
    push = 2.0**power
    u = [2.0, 2.0**-10, 0.005859375, 2.0]
    problem = _grazing(push)
    without = cq.certify(problem, u, [5242880.0, 0.0, 0.0, 0.0])
    assert without.force_bound is None or without.force_bound[1] >= push
    exact = cq.certify(problem, u, [5242880.0, push, 0.0, 0.0])
    assert exact.passed
    assert exact.force_bound is not None
    assert exact.force_bound.max() < 1e-3 * push


def test_noise_of_a_displacement_drives_nothing_where_nothing_loads_the_body() -> None:
    """A lattice that floats but for ties, without a load: what another code left of zero is refined to zero."""
    K = np.zeros((8, 8))
    springs = {
        (0, 1): -126,
        (0, 2): 368,
        (0, 6): 126,
        (0, 7): 126,
        (1, 5): 31.5,
        (1, 6): 126,
        (1, 7): 126,
        (3, 7): 4.25,
    }
    for (i, j), k in (springs | {(2, 3): 3.125, (2, 4): 3.125, (2, 5): -3.125, (3, 4): -3.125, (3, 5): 3.125}).items():
        K[i, j] = K[j, i] = -k
    K[4, 5] = K[5, 4] = -3.125
    K[3, 7] = K[7, 3] = -4.25
    K[4, 6] = K[6, 4] = -1.0
    K[6, 7] = K[7, 6] = 126.0
    K += np.diag([494, 157.5, 371.125, 7.375, 57.375, 34.625, 127, 130.25])
    rows = np.zeros((5, 8))
    rows[[0, 1, 2, 3, 4], [3, 5, 2, 0, 5]] = 1, 1, -1, -1, 4
    tie = [[2, 1, 1, 1, 0, 1, 1, 0], [0.5, -0.5, 1, -0.5, 0.5, 1, 0.5, 0.5]]
    problem = cq.ContactProblem(
        K, np.zeros(8), rows, [0.6220703125, 1.353515625, 0.30517578125, 0.0, 1.501953125], tie=tie, tie_value=[0, 0]
    )
    noise = np.array([0.0, 1.06e-16, -1.73e-17, -2.45e-15, 4.54e-16, -1.28e-15, 3.63e-15, -3.42e-15])
    others = np.random.default_rng(3).normal(size=(4, 8)) * 3e-15  # half of them met a force of 1e-171
    for zero in (noise, *others):
        assert cq.certify(problem, zero, np.zeros(5), tie_force=np.zeros(2)).proven
    assert not cq.certify(problem, noise, [0.0, 0.0, 0.0, 1e-3, 0.0], tie_force=np.zeros(2)).passed


@pytest.mark.slow
def test_what_rounding_strains_along_a_motion_that_a_tie_asks_for_is_no_error() -> None:
    """Nothing is strained; the answer differs from the middle of all by a motion that the tie holds."""
    problem = cq.ContactProblem(
        stiffness=[[4608.0, -3072.0, 0, 0], [-3072.0, 2048.0, 0, 0], [0.0] * 4, [0.0] * 4],
        load=np.zeros(4),
        normal=[[2.0, -1.0, -3.0, 2.0], [-2.0, 2.0, 3.0, -1.0]],
        gap=[9.0, -7.0],
        tie=[[0.0, 0.0, 0.0, 2.0]],
        tie_value=[2.0],
    )
    u = np.array([0.0, 0.0, -2.0, 1.0])
    assert cq.certify(problem, u).passed
    for strained in (1e-6, 1e-11):
        assert not cq.certify(problem, u + np.array([strained, 0.0, 0.0, 0.0])).passed


@pytest.mark.slow
def test_forces_of_ties_are_held_against_a_contact_at_unknowns_without_stiffness() -> None:
    """The contact carries the load, and the tie nothing: a rounding of its force was compared with itself."""
    K = np.zeros((5, 5))
    K[np.ix_([0, 2], [0, 2])] = [[4.0, -8.0], [-8.0, 16.0]]
    problem = cq.ContactProblem(
        K, [0, 0, 0, 4.0, 4.0], [[0, 0, 0, 2.0, 2.0]], [-2.0], tie=[[-1.0, 2.0, -1.0, 1.0, 2.0]], tie_value=[-0.75]
    )
    u = [2.0, 1.625, 1.0, -1.0, 0.0]
    for tie_force in (0.0, -2.8e-16, None):
        assert cq.certify(problem, u, [2.0], tie_force=None if tie_force is None else [tie_force]).passed
    assert not cq.certify(problem, u, [2.0], tie_force=[1e-8]).passed
    assert not cq.certify(problem, u, [2.0 + 1e-8], tie_force=[0.0]).passed


FREE: dict[str, tuple[dict[str, object], str]] = {
    "a spring that floats": (dict(stiffness=[[1, -1], [-1, 1]], load=[1, -1], normal=[[1, 0]], gap=[5]), "energy"),
    "a spring that a force holds": (
        dict(stiffness=[[1, -1], [-1, 1]], load=[1, 1], normal=[[1, 0]], gap=[5]),
        "displacement",
    ),
    "a spring that touches": (dict(stiffness=[[1, -1], [-1, 1]], load=[1, -1], normal=[[1, 0]], gap=[0.5]), "energy"),
    "a spring between walls that touch": (
        dict(stiffness=[[1, -1], [-1, 1]], load=[1, -1], normal=[[1, 0], [-1, 0]], gap=[0.5, -0.5]),
        "displacement",
    ),
    "an unknown without stiffness": (dict(stiffness=[[1, 0], [0, 0]], load=[1, 0], normal=[[1, 0]], gap=[5]), "energy"),
}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("condense", [True, False])
@pytest.mark.parametrize("what", FREE)
def test_a_displacement_is_determined_where_no_motion_is_free(what: str, condense: bool) -> None:
    data, determined = FREE[what]
    problem = cq.ContactProblem(**{name: np.array(part, dtype=float) for name, part in data.items()})
    assert bool(cq.exact(problem).free_motions) == (determined == "energy")
    certificate = cq.solve(problem, condense=condense).certificate
    assert certificate.proven
    assert certificate.determined == determined
