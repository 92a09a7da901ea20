"""Coulomb friction in space, two tangential rows a contact: closed forms, and problems made around their answers."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate.coulomb_law import natural_map
from tests.solving.friction.problems import Known, known_answer
from tests.solving.friction.space import WAYS, block, direction, several

ANGLES = (0.0, 0.3, np.pi / 2, 2.0, -2.5)


def solved(problem: cq.ContactProblem, way: str) -> cq.Solution:
    method, options = WAYS[way]
    return cq.solve(problem, method, **options)


def off(solution: cq.Solution, known: Known) -> float:
    """The largest difference from what is known, relative to the largest of each."""
    pairs = (
        (solution.displacement, known.displacement),
        (solution.normal_force, known.normal_force),
        (solution.friction_force, known.friction_force),
    )
    return max(float(np.max(abs(a - b)) / np.max(abs(b))) for a, b in pairs)


@pytest.mark.sampled(60)
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("angle", ANGLES)
def test_a_block_sticks_below_its_bound_and_slides_along_the_push_beyond(way: str, angle: float) -> None:
    """mu N = 3, springs of 2: pushed by 2.97 it has not moved, pushed by 3.03 it has by 0.03 / 2, along the push."""
    t = direction(angle)
    stuck, slid = solved(block(2.97 * t), way), solved(block(3.03 * t), way)
    np.testing.assert_allclose(stuck.displacement, 0.0, atol=1e-15)
    np.testing.assert_allclose(stuck.friction_force[0], 2.97 * t, atol=1e-14)
    assert stuck.contact_status.tolist() == ["stick"]
    np.testing.assert_allclose(slid.displacement[:2], 0.015 * t, atol=1e-15)
    np.testing.assert_allclose(slid.friction_force[0], 3.0 * t, atol=1e-14)
    np.testing.assert_allclose(slid.normal_force, 10.0, rtol=1e-15)
    assert slid.contact_status.tolist() == ["slip"]
    assert stuck.certificate.passed
    assert slid.certificate.passed


@pytest.mark.slow
@pytest.mark.parametrize("way", WAYS)
def test_on_unequal_springs_it_does_not_slide_along_the_push(way: str) -> None:
    """K_T = [[5, 1], [1, 2]]: pushed by K_T s + mu N s/|s| it slides by s, whatever the push's own direction."""
    K = np.array([[5.0, 1.0], [1.0, 2.0]])
    for angle in ANGLES:
        s = 0.7 * direction(angle)
        push = K @ s + 3.0 * direction(angle)
        solution = solved(block(push, tangential=K), way)
        np.testing.assert_allclose(solution.displacement[:2], s, rtol=1e-12, atol=1e-14)
        along = push / np.linalg.norm(push)
        assert abs(along[0] * s[1] - along[1] * s[0]) > 1e-3


def test_what_is_off_by_a_little_is_refused() -> None:
    """Friction turned by 1e-6, a bound exceeded by 1e-7, friction along the slip's other way, a stuck block moved."""
    t = direction(0.3)
    problem, slid = block(4.0 * t), np.append(0.5 * t, 0.0)
    right = dict(displacement=slid, normal_force=[10.0])
    assert cq.certify(problem, friction_force=[3.0 * t], **right).passed
    turned = cq.certify(problem, friction_force=[3.0 * direction(0.3 + 1e-6)], **right)
    assert turned.slip_direction > 1e-8
    beyond = cq.certify(problem, friction_force=[3.0000003 * t], **right)
    assert beyond.cone > 1e-9
    for wrong in (turned, beyond, cq.certify(problem, friction_force=[-3.0 * t], **right)):
        assert not wrong.passed
    moved = cq.certify(block(2.0 * t), np.append(1e-6 * t, 0.0), [10.0], [2.0 * t - 2e-6 * t])
    assert moved.slip_direction > 1e-8
    assert not moved.passed


def test_a_polygon_in_place_of_the_cone_is_refused() -> None:
    """Pushed at 22.5 degrees, an inscribed square gives mu N / sqrt(2) / cos 22.5 deg, 23 % less, another way."""
    t = direction(np.pi / 8)
    problem = block(4.0 * t)
    corner = np.array([3.0, 0.0])
    flat = (4.0 * t - corner) / 2.0
    assert not cq.certify(problem, [*flat, 0.0], [10.0], [corner]).passed


@pytest.mark.sampled(12)
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("ties", [0, 1])
def test_open_sticking_and_sliding_at_once(way: str, ties: int) -> None:
    for seed in range(4):
        known = several(seed, ties=ties)
        solution = solved(known.problem, way)
        assert off(solution, known) < 1e-9
        assert solution.contact_status.tolist() == ["open", "slip", "stick"] * 2
        assert solution.certificate.passed


def test_the_measure_of_the_tests_sees_what_is_wrong() -> None:
    one, other = several(0), several(1)
    assert off(cq.solve(one.problem), other) > 0.1


def _turned(problem: cq.ContactProblem, angles: np.ndarray, factors: np.ndarray) -> cq.ContactProblem:
    """Contact i's tangents turned by an angle, all its rows times a factor."""
    assert problem.tangent is not None
    assert problem.slip_origin is not None
    R = np.array([[[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]] for a in angles]) * factors[:, None, None]
    T = problem.tangent.toarray().reshape(problem.contacts, 2, -1)
    return problem.replace(
        normal=problem.normal.toarray() * factors[:, None],
        gap=problem.gap * factors,
        tangent=np.einsum("iab,ibn->ian", R, T).reshape(2 * problem.contacts, -1),
        slip_origin=np.einsum("iab,ib->ia", R, problem.slip_origin),
    )


@pytest.mark.parametrize("seed", range(3))
def test_frames_and_scales_of_contacts_mean_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    known = several(seed, ties=1)
    angles, factors = rng.uniform(-np.pi, np.pi, 6), 10.0 ** rng.uniform(-5, 5, 6)
    solution = cq.solve(_turned(known.problem, angles, factors))
    np.testing.assert_allclose(solution.displacement, known.displacement, atol=1e-12)
    np.testing.assert_allclose(solution.normal_force * factors, known.normal_force, atol=1e-12)
    c, s = np.cos(angles), np.sin(angles)
    x, y = known.friction_force.T
    there = np.column_stack([c * x + s * y, c * y - s * x])
    np.testing.assert_allclose(solution.friction_force * factors[:, None], there, atol=1e-12)


@pytest.mark.sampled(10)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("way", ["by itself", "nsgs", "admm", "aclm, clarabel", "tresca, clarabel"])
def test_scales_of_unknowns_mean_nothing(seed: int, way: str) -> None:
    known = several(seed)
    scale = 10.0 ** np.random.default_rng(seed).uniform(-5, 5, known.problem.dimension)
    K, N, T = (getattr(known.problem, name) for name in ("stiffness", "normal", "tangent"))
    problem = known.problem.replace(
        stiffness=K * np.outer(scale, scale),
        load=known.problem.load * scale,
        normal=N.toarray() * scale,
        tangent=T.toarray() * scale,
    )
    solution = solved(problem, way)
    np.testing.assert_allclose(solution.displacement * scale, known.displacement, atol=1e-9)
    np.testing.assert_allclose(solution.friction_force, known.friction_force, atol=1e-9)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("length", [1e-6, 1e3])
@pytest.mark.parametrize("force", [1e-9, 1e9])
def test_units_mean_nothing(length: float, force: float) -> None:
    known = several(2, ties=1)
    one = known.problem
    problem = one.replace(
        stiffness=one.stiffness * force / length,
        load=one.load * force,
        gap=one.gap * length,
        slip_origin=one.slip_origin * length,
        tie_value=one.tie_value * length,
    )
    solution = cq.solve(problem)
    np.testing.assert_allclose(solution.displacement / length, known.displacement, atol=1e-12)
    np.testing.assert_allclose(solution.friction_force / force, known.friction_force, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3, 4))])
def test_random_problems_satisfy_the_law_or_are_refused(seed: int) -> None:
    """mu from 0 to 5, coupled strongly, floating, tied; each was made around an answer, so there is one to find."""
    rng = np.random.default_rng(seed)
    same = 0
    for _ in range(60):
        known = known_answer(rng, 3, stiff=2.0)
        solution = cq.solve(known.problem)
        certificate = solution.certificate
        assert certificate.passed
        figures = ("equilibrium", "penetration", "tension", "complementarity", "cone", "slip_direction", "tie")
        assert max(getattr(certificate, name) for name in figures) <= 1e-9
        assert certificate.natural_map is None or certificate.natural_map <= 1e-9
        close = np.allclose(solution.displacement, known.displacement, atol=1e-9 * np.max(abs(known.displacement)))
        same += close
        if not close:
            # Then both are answers.
            assert cq.certify(known.problem, **known.answer()).passed
    assert same > 40


def _in_space(problem: cq.ContactProblem, angles: np.ndarray) -> cq.ContactProblem:
    """A problem in the plane whose contacts may also move out of it, against springs; tangents turned."""
    m, n = problem.contacts, problem.dimension
    K = np.zeros((n + m, n + m))
    K[:n, :n] = problem.stiffness
    K[n:, n:] = np.diag(np.linspace(1.0, 3.0, m))
    c, s = np.cos(angles), np.sin(angles)
    out = np.hstack([np.zeros((m, n)), np.eye(m)])
    T = np.hstack([problem.tangent.toarray(), np.zeros((m, m))])
    tangent = np.stack([c[:, None] * T + s[:, None] * out, c[:, None] * out - s[:, None] * T], axis=1)
    origin = problem.slip_origin[:, 0]
    return problem.replace(
        stiffness=K,
        load=np.append(problem.load, np.zeros(m)),
        normal=np.hstack([problem.normal.toarray(), np.zeros((m, m))]),
        tangent=tangent.reshape(2 * m, -1),
        slip_origin=np.column_stack([c * origin, -s * origin]),
        tie=np.hstack([problem.tie.toarray(), np.zeros((problem.ties, m))]) if problem.ties else None,
        tie_value=problem.tie_value if problem.ties else None,
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_what_stays_in_a_plane_is_the_plane_s_answer(seed: int) -> None:
    rng, compared = np.random.default_rng(seed), 0
    for _ in range(12):
        known = known_answer(rng, 2)
        problem = known.problem.replace(friction=0.2 * (known.problem.friction > 0))
        if not problem.frictional:
            continue
        answers = cq.equilibria(problem)
        if len(answers) != 1 or answers[0].certificate.uniqueness:
            continue  # others may be right, or the same forces shared differently
        compared += 1
        angles = rng.uniform(-np.pi, np.pi, problem.contacts)
        solution = cq.solve(_in_space(problem, angles))
        flat, n = answers[0], problem.dimension
        scale = np.max(abs(flat.displacement))
        np.testing.assert_allclose(solution.displacement[:n], flat.displacement, atol=1e-9 * scale)
        np.testing.assert_allclose(solution.displacement[n:], 0.0, atol=1e-9 * scale)
        np.testing.assert_allclose(solution.normal_force, flat.normal_force, atol=1e-9)
        x = flat.friction_force[:, 0]
        there = np.column_stack([np.cos(angles) * x, -np.sin(angles) * x])
        np.testing.assert_allclose(solution.friction_force, there, atol=1e-9)
    assert compared > 3


def test_slips_count_from_their_origin() -> None:
    """Moved to (1, 1) by hand, then let go: pulled back by 2 sqrt(2) < 3 it stays, by 4.2 it comes back."""

    def let_go(origin: np.ndarray) -> cq.Solution:
        return cq.solve(block([0.0, 0.0], slip_origin=[origin]))

    stays = let_go(np.array([1.0, 1.0]))
    np.testing.assert_allclose(stays.displacement, [1.0, 1.0, 0.0], rtol=1e-15)
    np.testing.assert_allclose(stays.friction_force, [[-2.0, -2.0]], rtol=1e-15)
    back = let_go(np.array([1.5, 1.5]))
    t = direction(np.pi / 4)
    np.testing.assert_allclose(back.displacement[:2], 1.5 * t, rtol=1e-14)
    np.testing.assert_allclose(back.friction_force[0], -3.0 * t, rtol=1e-14)


def test_an_open_contact_without_friction_and_slip_satisfies_the_law() -> None:
    """Its cone is a ray; r = 0, u = (1, 0, 0). And a tension of 1 violates it by 1."""
    none, open_ = np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]])
    for friction in (0.0, 0.3):
        assert np.all(natural_map(none, open_, np.array([friction])) == 0.0)
        assert np.max(abs(natural_map(-open_, none, np.array([friction])))) == 1.0


@pytest.mark.slow
def test_motions_that_no_contact_resists_are_no_joints_of_the_local_form() -> None:
    """Two points and a bar; one contact holds one of them, and its forces follow from balance: (20; 20, 0).

    In the local form the motions of the other point, a rounding in the contact's rows, were scaled to one.
    """
    d = np.array([1.0, -1.0, 0.0])
    problem = cq.ContactProblem(
        stiffness=258.5 * np.outer(np.append(d, -d), np.append(d, -d)),
        load=[222.1484375, -222.1484375, 0.0, -212.1484375, 212.1484375, -40.0],
        normal=[[0.0, 0.0, 0.0, -0.5, -1.0, -1.0]],
        gap=[0.5],
        tangent=[[0.0, 0.0, 0.0, 1.0, 0.5, -1.0], [0.0, 0.0, 0.0, 1.0, -1.0, 0.5]],
        friction=2.0,
        slip_origin=[[-4.0, -2.5]],
    )
    solution = cq.solve(problem)
    assert solution.certificate.passed
    np.testing.assert_allclose(solution.normal_force, [20.0], rtol=1e-12)
    np.testing.assert_allclose(solution.friction_force.ravel(), [20.0, 0.0], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(solution.displacement[3:], [-3.0, 0.0, 1.0], rtol=1e-12, atol=1e-12)
    assert not cq.certify(problem, solution.displacement, [20.0], [20.0, 1e-6]).passed


@pytest.mark.slow
def test_combinations_are_refined_from_rest_too() -> None:
    """Two contacts stick and one slides by 1/8 along (3, 4)/5; forces and displacements are dyadic, made by hand.

    From the directions of slip of the last iterate the combination of the answer leads to another slip.
    """
    a, b = np.array([-0.59375, -1.1875]), np.array([-1.1875, -2.375])
    K = np.zeros((6, 6))
    for i, sign in ((0, -1.0), (3, 1.0)):
        K[i, [0, 1]], K[i, [3, 4]] = sign * a, -sign * a
        K[i + 1, [0, 1]], K[i + 1, [3, 4]] = sign * b, -sign * b
    K[5, 5] = 0.5
    problem = cq.ContactProblem(
        stiffness=K,
        load=[-2.40234375, 7.4453125, -3.0, 341.40234375, 105.3046875, 1.5],
        normal=[[0, 0, 0, 3, 4, 0], [-1, 0, 0, 1, 0, 0], [0, 0, 0, 0.5, 0.75, 1.5]],
        gap=[-4.375, -5.125, 8.25],
        tangent=[[0, 0, 0, -4, 3, 0], [0, 0, 0, 0, 0, 5], [0, -1, 0, 0, 1, 0], [0, 0, -1, 0, 0, 1],
                 [0, 0, 0, 0.75, -1.5, 0.5], [0, 0, 0, 1.5, 0.5, -0.75]],
        friction=[0.5, 1.0, 2.0],
        slip_origin=[[3.75, 30.0], [0.375, 6.25], [2.4375, -6.4375]],
    )  # fmt: skip
    u = np.array([4.0, -0.625, -0.25, -1.125, -0.25, 6.0])
    assert cq.certify(problem, u, [40.0, 5.0, 45.0], [-12.0, -9.0, -2.25, 3.0, 54.0, 72.0]).passed
    assert cq.solve(problem).certificate.passed


@pytest.mark.sampled(4)
@pytest.mark.parametrize("algorithm", [None, "newton", "nsgs", "ppa", "admm", "tresca"])
def test_a_node_on_an_edge_is_held_at_its_bound(algorithm: str | None) -> None:
    """Along the edge of two walls the load is all that both can hold, 0.25 (3 + 3): no slip tells the direction."""
    walls, tangents = [[0, 1, 0], [0, 0, -1]], [[1, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0]]
    node = cq.ContactProblem(np.diag([4.0, 3.0, 5.0]), [1.5, 3.0, -3.0], walls, [0.0, 0.0], tangents, 0.25)
    solution = cq.solve(node, algorithm=algorithm)
    assert abs(solution.displacement).max() <= 1e-15
    assert solution.normal_force == pytest.approx([3.0, 3.0], abs=1e-12)
    assert solution.friction_force == pytest.approx(np.array([[0.75, 0.0], [0.75, 0.0]]), abs=1e-12)


@pytest.mark.slow
def test_what_refinement_leaves_of_a_force_is_no_imbalance_of_a_motion() -> None:
    """One force acts on the first unknown, and it is zero: of it 1e-30 was left, an imbalance of all that acts there.

    K was then cleared of a rounding along rigid motions that it has not, which left 1e-18.
    """
    K = np.zeros((9, 9))
    K[np.ix_([1, 2, 7, 8], [1, 2, 7, 8])] = 0.125 * np.outer([1, 1, -1, -1], [1, 1, -1, -1])
    K[np.ix_([6, 8], [6, 8])] += [[32.0, 16.0], [16.0, 8.0]]
    problem = cq.ContactProblem(
        stiffness=K,
        load=[0.0, 15.203125, 23.640625, 37.03125, 16.875, 72.1875, -42.53125, -32.078125, -98.578125],
        normal=[[0, 0, 0, 2, 3, 6, -2, -3, -6], [0, 0, 0.5, 0, 0, -0.5, 0, 0, 0]],
        gap=[-16.75, 4.125],
        tangent=[[0, 0, 0, 3, -6, 2, -3, 6, -2], [0, 0, 0, 6, 2, -3, -6, -2, 3],
                 [0.5, 0, 0, -0.5, 0, 0, 0, 0, 0], [0, 0.5, 0, 0, -0.5, 0, 0, 0, 0]],
        friction=[0.25, 1.0],
        slip_origin=[[34.375, -12.625], [-4.4453125, 3.25]],
    )  # fmt: skip
    solution = cq.solve(problem)
    assert solution.certificate.passed
    np.testing.assert_allclose(solution.normal_force, [15.0, 45.0], rtol=1e-14)
    np.testing.assert_allclose(solution.friction_force.ravel(), [2.34375, 0.0, 0.0, 28.125], rtol=1e-14)


@pytest.mark.sampled(6)
@pytest.mark.parametrize("algorithm", [None, "nsgs"])
@pytest.mark.parametrize(("push", "gap"), [((3.1, 0.0), 0.0), ((2.2, 2.2), 0.0), ((2.0, 0.0), 1.9)])
def test_a_block_on_a_spring_that_friction_cannot_hold_has_no_equilibrium(
    push: tuple[float, float], gap: float, algorithm: str | None
) -> None:
    """A spring of 5 bears 5 gap of the weight of 10, and the floor the rest: friction holds 0.3 (10 - 5 gap)."""
    pulled = block(push, tangential=0.0).replace(gap=[gap])
    on_spring = cq.ContactProblem(
        np.diag([0.0, 0.0, 5.0]), pulled.load, pulled.normal, pulled.gap, pulled.tangent, friction=0.3
    )
    with pytest.raises(cq.NoEquilibrium, match="proven in rational numbers; lower the load to what friction holds"):
        cq.solve(on_spring, algorithm=algorithm)
    held = 0.299 * (10.0 - 5.0 * gap) / float(np.hypot(*push))
    assert cq.solve(on_spring.replace(load=[held * push[0], held * push[1], -10.0])).contact_status == ("stick",)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("seed", [5, 3, 28])
def test_what_rounding_leaves_of_gaps_that_ties_determine_is_no_proof(seed: int) -> None:
    """Ties hold all unknowns that a contact feels: its gap is zero but for the rounding of their rows."""
    rng = np.random.default_rng(seed)
    axes, tie = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.integers(-3, 4, size=(3, 3)).astype(float)
    u = rng.integers(-5, 6, 3) / 10
    normal, tangent = axes[:1], axes[1:]
    tied = cq.ContactProblem(
        np.diag([1.0, 0.0, 0.0]),
        [0.3, 0.1, 0.0],
        normal,
        normal @ u,
        tangent,
        friction=0.4,
        tie=tie,
        tie_value=tie @ u,
        slip_origin=(tangent @ u)[None],
    )
    assert cq.solve(tied).displacement == pytest.approx(u, abs=1e-14)
