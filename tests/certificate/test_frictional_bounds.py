"""Bounds with friction hold against exact rational equilibria, and claim nothing where several are."""

from __future__ import annotations

from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from benchmarks.friction_bounds import below_the_distance, block, fresh
from benchmarks.friction_bounds import judged as certificate_of_printed
from contactqp.certificate import critical_friction, frictional_bounds
from contactqp.elements.shapes import box, rectangle
from contactqp.linalg.iteration import Systems, systems_of
from tests.examples import truss

Rational = list[Fraction]
# Of candidates: what each of their numbers is off by, relative.
OFF = (0.0, 1e-14, 1e-11, 1e-8, 3e-7)
STICK, SLIP = ("stick", "slip")
DIRECTIONS = ((3, 4, 5), (-3, 4, 5), (5, -12, 13), (-4, -3, 5), (7, 24, 25))


def energy(K: Any, v: Rational) -> float:
    """|v|_K, of whole numbers K."""
    product = [sum((int(k) * x for k, x in zip(row, v, strict=True) if k), Fraction()) for row in K]
    return float(sum((a * b for a, b in zip(product, v, strict=True)), Fraction())) ** 0.5


def off(rng: np.random.Generator, values: Any, part: float) -> Any:
    return values * (1 + part * rng.normal(size=np.shape(values)))


def chain(rng: np.random.Generator, n: int) -> Any:
    """The stiffness of springs between neighbours and some others, which the ground does not hold."""
    pairs = [(i, i + 1) for i in range(n - 1)] + [tuple(rng.choice(n, 2, replace=False)) for _ in range(2)]
    ends = np.zeros((len(pairs), n), dtype=int)
    for row, (i, j) in zip(ends, pairs, strict=True):
        row[i], row[j] = 1, -1
    return ends.T @ (rng.integers(1, 4, len(pairs))[:, None] * ends)


def floating_problem(rng: np.random.Generator) -> cq.ContactProblem:
    """One or two chains that contacts alone hold, at most three contacts."""
    m, sizes = int(rng.integers(1, 4)), rng.integers(2, 4, int(rng.integers(1, 3)))
    K = np.zeros((sum(sizes), sum(sizes)))
    for size, last in zip(sizes, np.cumsum(sizes), strict=True):
        K[last - size : last, last - size : last] = chain(rng, size)
    rows = rng.integers(-2, 3, (2 * m, len(K))).astype(float)
    rows[~rows.any(axis=1), 0] = 1.0
    mu = float(rng.choice([0.25, 0.5, 1.0, 2.0]))
    return cq.ContactProblem(
        K, rng.integers(-9, 10, len(K)), rows[:m], rng.integers(-2, 3, m) / 4, tangent=rows[m:], friction=mu
    )


def plane_problem(rng: np.random.Generator) -> cq.ContactProblem:
    """Whole numbers and quarters, up to four contacts: all equilibria are had as fractions."""
    m = int(rng.integers(1, 4))
    n = 2 * m + int(rng.integers(0, 3))
    shape = rng.integers(-3, 4, (n, n))
    rows = np.zeros((2 * m, n))
    if rng.random() < 0.5:
        rows = rng.integers(-2, 3, (2 * m, n)).astype(float)
    rows[np.arange(2 * m), rng.permutation(n)[: 2 * m]] += 1.0
    return cq.ContactProblem(
        shape @ shape.T + np.diag(rng.integers(1, 4, n)),
        rng.integers(-20, 21, n),
        rows[:m],
        rng.integers(-2, 3, m) / 4,
        tangent=rows[m:],
        friction=float(rng.choice([0.125, 0.25, 0.5, 1.0, 2.0])),
        slip_origin=rng.integers(-2, 3, (m, 1)) / 4,
    )


def numbers(one: Any) -> tuple[Rational, list[Rational]]:
    """Displacement, and (l_N, l_T) contact by contact."""
    pairs = zip(one.normal_force, np.ravel(one.friction_force), strict=True)
    return [Fraction(x) for x in one.displacement], [[Fraction(a), Fraction(b)] for a, b in pairs]


def distances(problem: Any, K: Any, u: Any, force: Any, truth: tuple[Rational, list[Rational]]) -> tuple[float, Any]:
    """|u - u*|_K over |u*|_K, and |l_i - l_i*|."""
    displacement, forces = truth
    size = energy(K, displacement) or 1.0
    apart = energy(K, [Fraction(float(a)) - b for a, b in zip(u, displacement, strict=True)])
    own = [
        float(sum((Fraction(float(a)) - b) ** 2 for a, b in zip(one, right, strict=True))) ** 0.5
        for one, right in zip(force, forces, strict=True)
    ]
    del problem
    return apart / size, np.array(own)


@pytest.mark.parametrize("problems", [8, pytest.param(40, marks=pytest.mark.slow)])
def test_no_bound_is_below_the_distance_to_the_exact_answer_in_the_plane(problems: int) -> None:
    claimed = bounds_hold(plane_problem, np.random.default_rng(20), problems)
    assert min(claimed.values()) >= 3 * problems // 4, claimed


def bounds_hold(made: Any, rng: np.random.Generator, problems: int) -> dict[str, int]:
    """How many candidates have bounds of either scope, each held against all equilibria in rational numbers."""
    claimed = {"global": 0, "local": 0}
    for _ in range(problems):
        problem = made(rng)
        try:
            solution, known = cq.solve(problem), cq.exact_equilibria(problem)
        except (cq.NoEquilibrium, cq.NotConverged, cq.SeveralEquilibria):
            continue
        K = np.asarray(problem.stiffness)
        continuum = any(one.continuum for one in known)
        assert not (continuum and made is plane_problem)
        floats = np.linalg.matrix_rank(K) < len(K)
        norm = K + np.diag(np.diag(K)) if floats else K  # that a radius is stated in
        truths = [numbers(one) for one in known]
        for part in OFF:
            u, normal, friction = (
                off(rng, x, part) for x in (solution.displacement, solution.normal_force, solution.friction_force)
            )
            found = cq.certify(problem, u, normal, friction, tolerance=1e-5, error_tolerance=1e-4)
            if not found.proven:
                continue
            assert found.scope == "local" or (len(truths) == 1 and not continuum)
            if continuum:
                continue
            claimed[found.scope] += 1
            force = np.column_stack([normal, friction])
            apart = [distances(problem, K, u, force, truth) for truth in truths]
            nearest, own = min(apart, key=lambda pair: pair[0])
            assert found.energy_error >= nearest * (1 - 1e-9)
            assert np.all(found.force_bound >= own * (1 - 1e-9))
            if found.scope == "local":
                # The distance to the answer of the combination is all of it, but for what doubles hold.
                held = 1e-14 * max(1.0, *(energy(norm, v) / (energy(K, v) or 1.0) for v, _ in truths))
                assert found.energy_error <= 1.1 * nearest + held
                away = [energy(norm, [Fraction(float(a)) - b for a, b in zip(u, v, strict=True)]) for v, _ in truths]
                assert sum(one < found.radius for one in away) == 1
    return claimed


def space_problem(
    rng: np.random.Generator, floating: bool = False
) -> tuple[cq.ContactProblem, Any, tuple[Rational, list[Rational]]]:
    """A problem in space that is made around its answer, whose slips and forces have rational lengths."""
    m, d = int(rng.integers(1, 5)), 3
    n = d * m + int(rng.integers(0, 4))
    shape = rng.integers(-2, 3, (n, n))
    K = chain(rng, n) if floating else shape @ shape.T + np.diag(rng.integers(1, 12, n))
    rows = np.zeros((d * m, n), dtype=int)
    rows[np.arange(d * m), rng.permutation(n)[: d * m]] = rng.choice([-1, 1], d * m)
    normal, tangent = rows[:m], rows[m:]
    u = [Fraction(int(x), 4) for x in rng.integers(-12, 13, n)]
    moved = [sum((int(a) * x for a, x in zip(row, u, strict=True)), Fraction()) for row in rows]
    mu, gap, origin, forces = Fraction(1, int(rng.choice([1, 4]))), moved[:m], [], []
    for i in range(m):
        at, (a, b, c) = moved[m + 2 * i : m + 2 * i + 2], DIRECTIONS[rng.integers(len(DIRECTIONS))]
        along = [Fraction(a, c), Fraction(b, c)]
        state, push = rng.choice(["open", STICK, SLIP]), Fraction(int(rng.integers(1, 40)), 2)
        part = Fraction(int(rng.integers(0, 8)), 8) if state == STICK else Fraction(1)
        slip = Fraction(int(rng.integers(1, 9)), 2) if state == SLIP else Fraction()
        forces.append([Fraction()] * 3 if state == "open" else [push, *(part * mu * push * x for x in along)])
        gap[i] += Fraction(1, 4) if state == "open" else 0
        origin.append([x - slip * y for x, y in zip(at, along, strict=True)])
    flat = [one[0] for one in forces] + [x for one in forces for x in one[1:]]
    load = [
        sum((int(k) * x for k, x in zip(K[j], u, strict=True)), Fraction())
        + sum((int(e) * x for e, x in zip(rows[:, j], flat, strict=True)), Fraction())
        for j in range(n)
    ]
    problem = cq.ContactProblem(
        K, [float(x) for x in load], normal, [float(x) for x in gap], tangent=tangent, friction=float(mu),
        slip_origin=[[float(x) for x in one] for one in origin],
    )  # fmt: skip
    return problem, K, (u, forces)


@pytest.mark.parametrize(
    ("floating", "problems", "least"),
    [
        (True, 8, 1),
        pytest.param(False, 16, 1, marks=pytest.mark.slow),
        pytest.param(False, 40, 12, marks=pytest.mark.slow),
        pytest.param(True, 60, 12, marks=pytest.mark.slow),
    ],
)
def test_no_bound_is_below_the_distance_to_the_answer_in_space(floating: bool, problems: int, least: int) -> None:
    """The problem's numbers are rounded, which moves its answer by some 1e-15."""
    rng, proven = np.random.default_rng(21), {"global": 0, "local": 0}
    for _ in range(problems):
        problem, K, truth = space_problem(rng, floating)
        plain = np.array([float(x) for x in truth[0]]), np.array([[float(x) for x in one] for one in truth[1]])
        for part in (1e-11, 1e-8, 3e-7):
            u, force = (off(rng, x, part) for x in plain)
            found = cq.certify(problem, u, force[:, 0], force[:, 1:], tolerance=1e-5, error_tolerance=1e-4)
            assert found.passed or floating  # where nothing holds a body its answer is one of many
            if not found.proven:
                continue
            proven[found.scope] += 1
            apart, own = distances(problem, K, u, force, truth)
            assert found.energy_error >= apart * (1 - 1e-3)
            assert np.all(found.force_bound >= own * (1 - 1e-3))
            assert found.energy_error <= 1.01 * apart + 1e-14
            assert found.scope == "global" or apart * energy(K, truth[0]) < found.radius
    assert min(proven["local"], proven["global"] or least * floating) >= least, proven


@pytest.mark.slow
def test_slips_that_may_turn_each_other_are_proven_nearby(monkeypatch: pytest.MonkeyPatch) -> None:
    """By Newton and Kantorovich: of all slips here, also of those whose constant of monotonicity is not below one."""
    known, seen = frictional_bounds.slips_nearby, []

    def never_monotone(*given: Any) -> Any:
        seen.append(known(*given))
        return frictional_bounds.replace(seen[-1], kappa=np.inf) if seen[-1].slides.any() else seen[-1]

    monkeypatch.setattr(frictional_bounds, "slips_nearby", never_monotone)
    monkeypatch.setattr(frictional_bounds, "critical", lambda *_: SimpleNamespace(kappa=np.inf, unique=False))
    for floating in (False, True):
        test_no_bound_is_below_the_distance_to_the_answer_in_space(floating, 30, 0)
    assert sum(one.slides.any() for one in seen) >= 80
    assert any(one.kappa >= 1 for one in seen)


def law(y: Any, A: Any, B: Any, P: Any, mu: Any, N: Any, s: Any) -> Any:
    """Return y + sum B_i' mu (N + P_i y) t_i, t_i the direction of s_i + A_i y: Coulomb's law but for a constant."""
    slip = s + A @ y
    return y + np.einsum("iwp,iw->p", B, (mu * (N + P @ y) / np.linalg.norm(slip, axis=1))[:, None] * slip)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("skew", [False, True])
def test_a_ball_of_slips_has_one_answer_at_most(skew: bool) -> None:
    """Newton's map contracts between any two points of the ball, and not in one sixteen times as large."""
    rng, beyond, found = np.random.default_rng(3), 0, 0
    for _ in range(40):
        q = int(rng.integers(1, 4))
        shape = rng.standard_normal((2 * q, 2 * q))
        A = np.linalg.cholesky(shape @ shape.T + 0.1 * np.eye(2 * q)).reshape(q, 2, 2 * q)
        turn = np.triu(rng.standard_normal((2 * q, 2 * q)), 1)
        B, A = A, A @ (np.eye(2 * q) + skew * (turn - turn.T))
        P, mu, N = rng.standard_normal((q, 2 * q)), rng.uniform(0.1, 1.5, q), rng.uniform(0.5, 2.0, q)
        s = rng.standard_normal((q, 2)) * 10 ** rng.uniform(-2, 1)

        slips = critical_friction.SlipsNearby(np.ones(q, dtype=bool), mu, A, B, P, np.inf)
        ball = slips.settled(N, s, 0.0, np.inf)
        if ball is None:  # nearly singular
            continue
        found += 1
        assert ball.radius > 1e-6 * np.min(np.linalg.norm(s, axis=1))
        steps = 1e-4 * ball.radius * np.eye(2 * q)
        data = A, B, P, mu, N, s
        J = np.column_stack([(law(step, *data) - law(-step, *data)) / (2e-4 * ball.radius) for step in steps])
        assert ball.inverse == pytest.approx(np.linalg.norm(np.linalg.inv(J), 2), rel=1e-3)  # of central differences
        assert ball.slack >= 0.5
        for far in (1.0, 16.0):
            for _ in range(20):
                y, z = (x / np.linalg.norm(x) * far * ball.radius for x in rng.standard_normal((2, 2 * q)))
                kept = np.linalg.norm(y - z - np.linalg.solve(J, law(y, *data) - law(z, *data)))
                assert far > 1 or kept <= 0.501 * np.linalg.norm(y - z)
                beyond += far > 1 and kept > 0.501 * np.linalg.norm(y - z)
    assert beyond > 20
    assert found > 25


def test_a_bound_that_were_too_small_would_be_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frictional_bounds, "_distance", lambda *_: 0.0)
    original = frictional_bounds._bounds

    def smaller(*arguments: Any) -> Any:
        found = original(*arguments)
        return frictional_bounds.replace(found, energy_error=0.9 * found.energy_error)

    monkeypatch.setattr(frictional_bounds, "_bounds", smaller)
    with pytest.raises(AssertionError):
        test_no_bound_is_below_the_distance_to_the_exact_answer_in_the_plane(8)


KLARBRING = dict(
    stiffness=[[5.0, -2.0], [-2.0, 1.0]], load=[-1.0, 0.65], normal=[[-1.0, 0.0]], gap=[0.0], tangent=[[0.0, 1.0]]
)


def test_where_several_answers_exist_each_is_proven_nearby_alone() -> None:
    problem = cq.ContactProblem(**KLARBRING, friction=0.8)
    answers = cq.equilibria(problem)
    assert len(answers) == 3
    for one in answers:
        found = cq.certify(problem, one.displacement, one.normal_force, one.friction_force)
        assert (found.passed, found.scope) == (True, "local")
        apart = [one.displacement - other.displacement for other in answers if other is not one]
        assert min(np.sqrt(v @ np.array(KLARBRING["stiffness"]) @ v) for v in apart) >= found.radius > 0
        assert "others further away are not excluded" in str(found)
    assert judged(cq.ContactProblem(**KLARBRING, friction=0.2)).scope == "global"


def test_a_slip_in_space_stops_at_its_length() -> None:
    """Two contacts side by side; the one that slips is at rest after |s|, however the tangents are laid."""
    slides, sticks = [2.0, 0.3, 0.3], [10.0, 1.0, 0.0]
    unit = np.eye(6)
    problem = cq.ContactProblem(
        unit, [*slides, *sticks], unit[[0, 3]], [0.0, 0.0], tangent=unit[[1, 2, 4, 5]], friction=[0.1, 3.0]
    )
    found, slip = judged(problem), np.hypot(0.3, 0.3) - 0.1 * 2.0
    assert found.scope == "local"
    assert found.radius == pytest.approx(slip, rel=1e-6)
    assert found.radius <= slip


def test_a_slip_that_supports_prevent_stands_in_no_ones_way() -> None:
    """Nodes in a plane of symmetry: their second tangent touches nothing that moves, and its row of W is zero."""
    unit = np.eye(4)
    tangent = np.array([unit[1], np.zeros(4), unit[3], np.zeros(4)])
    data = dict(stiffness=np.eye(4) + 0.1, load=[2.0, 1.5, 3.0, 0.1], normal=unit[[0, 2]], gap=[0.0, 0.0])
    problem = cq.ContactProblem(**data, tangent=tangent, friction=[0.3, 0.3])
    flat = cq.ContactProblem(**data, tangent=unit[[1, 3]], friction=[0.3, 0.3])
    assert cq.critical_friction(problem).kappa == pytest.approx(cq.critical_friction(flat).kappa, rel=1e-12)
    found, plane = judged(problem), judged(flat)
    assert found.scope == plane.scope == "global"
    assert np.all(found.force_bound < 1e-12)


def test_what_cannot_close_together_does_not_stand_in_the_way() -> None:
    """Two walls face each other, and their rows depend: only one of them is met, and the other is far away."""
    walls = dict(stiffness=[[2.0, -1.0], [-1.0, 2.0]], load=[3.0, 1.0], normal=[[1.0, 0.0], [-1.0, 0.0]])
    problem = cq.ContactProblem(**walls, gap=[0.25, 1.0], tangent=[[0.0, 1.0], [0.0, 1.0]], friction=0.25)
    found = judged(problem)
    assert found.scope == "local"
    (only,) = cq.exact_equilibria(problem)
    assert [float(x) for x in only.normal_force] == pytest.approx([25 / 9, 0.0])
    # Nearer than the other wall: its gap of 1.25 costs an energy of 1.25^2 / W, W = 2/3.
    assert 0 < found.radius < 1.25 / np.sqrt(2 / 3)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e6])
def test_radius_and_bounds_have_the_units_of_the_problem(unit: float) -> None:
    data = {name: np.asarray(value) for name, value in KLARBRING.items()}
    scaled = cq.ContactProblem(
        **(data | dict(stiffness=data["stiffness"] * unit, load=data["load"] * unit)), friction=0.8
    )
    plain = cq.certify(cq.ContactProblem(**KLARBRING, friction=0.8), *known_answer(1.0))
    found = cq.certify(scaled, *known_answer(unit))
    assert found.scope == plain.scope == "local"
    assert found.radius == pytest.approx(plain.radius * np.sqrt(unit), rel=1e-9)


def judged(problem: cq.ContactProblem) -> Any:
    """The certificate of the solution, bounds included."""
    found = cq.solve(problem)
    return cq.certify(problem, found.displacement, found.normal_force, found.friction_force)


def known_answer(unit: float) -> tuple[Any, Any, Any]:
    solution = cq.solve(cq.ContactProblem(**KLARBRING, friction=0.8))
    return solution.displacement, solution.normal_force * unit, solution.friction_force * unit


def test_a_contact_at_the_border_of_two_states_is_proven_globally_or_not_at_all() -> None:
    rough = truss().replace(tangent=[[1.0, 0.0]], friction=0.3)
    assert judged(rough).scope == "global"
    border = cq.ContactProblem(  # kappa is above 1, and the contact sticks with all of its friction
        stiffness=[[1.0, 0.0], [0.0, 1.0]],
        load=[1.0, 3.0],
        normal=[[1.0, 0.0]],
        gap=[0.0],
        tangent=[[0.0, 1.0]],
        friction=3.0,
    )
    found = judged(border)
    assert (found.passed, found.scope) == (True, None)
    assert "a contact is within rounding of another state" in found.reasons[0]


def test_wrong_answers_are_proven_by_nothing() -> None:
    rough = truss().replace(tangent=[[1.0, 0.0]], friction=0.3)
    right = cq.solve(rough)
    for part in (1e-3, 1e-5):
        found = cq.certify(rough, right.displacement, right.normal_force * (1 + part), right.friction_force)
        assert (found.passed, found.proven, found.scope) == (False, False, None)
        assert found.reasons[0] == "energy_error: friction: no answer of its own states is near whose forces are unique"


def test_friction_along_a_supported_tangent_is_judged_by_its_figures_alone() -> None:
    held = cq.ContactProblem(
        stiffness=[[8.0]], load=[4.0], normal=[[1.0]], gap=[0.25], tangent=[[0.0]], friction=0.5, slip_origin=[0.0]
    )
    for friction in (-0.9, 0.0, 0.9):
        found = cq.certify(held, [0.25], [2.0], [friction])
        assert (found.passed, found.uniqueness, found.force_bound[0]) == (True, (), 0.0)
    assert cq.certify(held, [0.25], [2.0], [1.00001]).failures[0].startswith("cone")
    assert not cq.certify(held.replace(slip_origin=[-0.5]), [0.25], [2.0], [0.9]).passed


def test_the_constant_of_the_theorem_is_kappa_and_not_the_ratio_of_the_coefficients() -> None:
    """Of Example 2.18, whose answer is the only one to every load."""
    found = cq.critical_friction(cq.run(cq.load_scene("truss_friction"))[-1].problem)
    assert (found.kappa, found.contraction) == (pytest.approx(0.171575, rel=1e-5), pytest.approx(0.0345289, rel=1e-5))
    assert found.unique


def by_sparse_systems(problem: cq.ContactProblem) -> cq.ContactProblem:
    """The problem with a new stiffness, as if its contacts were so many that sparse systems cost less."""
    again = fresh(problem)
    again._computed.constraints_are_many[True] = True
    assert systems_of(again) is Systems.SPARSE
    return again


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("model", "tied"), [("plane-strain", False), ("plane-strain", True), ("3d", False), ("3d", True)]
)
def test_rough_contacts_are_proven_whatever_systems_solve_them(model: str, tied: bool) -> None:
    """A block that supports or ties hold: where sparse systems solve it, its bounds condense it."""
    mesh = rectangle(2.0, 0.5, (23, 4)) if model == "plane-strain" else box((1.0, 1.0, 0.3), (4, 4, 2))
    problem = block(mesh, model, 0.2, tied)
    again = by_sparse_systems if model == "plane-strain" and not tied else fresh
    solution = cq.solve(again(problem))
    found = certificate_of_printed(again(problem), solution)
    assert (found.passed, found.proven, found.scope, found.reasons) == (True, True, "global", ())
    printed = certificate_of_printed(again(problem), solution, 9)
    assert (printed.passed, printed.proven, below_the_distance(solution, printed)) == (True, True, 0)
    assert found.force_error < 1e-12 < 1e-10 < printed.force_error < 1e-7
    forged = solution.normal_force.copy()
    forged[np.argmax(forged)] *= 1.001
    parts = solution.displacement, forged, solution.friction_force, solution.tie_force
    wrong = cq.certify(again(problem), *parts)
    assert not wrong.passed
    assert not wrong.proven or max(wrong.force_bound) >= 1e-3 * max(solution.normal_force)


@pytest.mark.slow
def test_two_hundred_contacts_are_proven_and_condensed_where_that_is_asked_for() -> None:
    problem = block(rectangle(2.0, 0.5, (199, 8)), "plane-strain", 0.2, tied=False)
    assert systems_of(problem) is Systems.SPARSE
    sparse, condensed = cq.solve(problem), cq.solve(fresh(problem), condense=True)
    assert (sparse.work.retained, condensed.work.retained) == (3200, 400)
    assert np.allclose(sparse.normal_force, condensed.normal_force, rtol=1e-12, atol=1e-15)
    found = certificate_of_printed(problem, sparse)
    assert (found.proven, found.scope) == (True, "local")


@pytest.mark.slow
def test_beyond_the_size_of_a_global_statement_there_is_a_local_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(critical_friction, "MOST_CONTACTS", 23)
    monkeypatch.setattr("contactqp.linalg.iteration.MANY_WITH_FRICTION", 23)
    plane = by_sparse_systems(block(rectangle(2.0, 0.5, (23, 4)), "plane-strain", 0.2, tied=False))
    space = block(box((1.0, 1.0, 0.3), (5, 3, 2)), "3d", 0.2, tied=False)
    assert (systems_of(plane), systems_of(space)) == (Systems.SPARSE, Systems.SUBSET)
    for problem in (plane, space):
        solution = cq.solve(problem)
        found = certificate_of_printed(problem, solution)
        assert (found.proven, found.scope, found.reasons) == (True, "local", ())
        printed = certificate_of_printed(problem, solution, 9)
        assert (printed.proven, printed.scope, below_the_distance(solution, printed)) == (True, "local", 0)


@pytest.mark.slow
def test_beyond_the_stated_size_the_reason_is_the_size(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(critical_friction, "MOST_CONTACTS", 23)
    monkeypatch.setattr(critical_friction, "MOST_NEARBY", 23)
    monkeypatch.setattr("contactqp.linalg.iteration.MANY_WITH_FRICTION", 23)
    plane = by_sparse_systems(block(rectangle(2.0, 0.5, (23, 4)), "plane-strain", 0.2, tied=False))
    space = block(box((1.0, 1.0, 0.3), (5, 3, 2)), "3d", 0.2, tied=False)
    assert systems_of(space) is Systems.SUBSET
    for problem in (plane, space):
        found = certificate_of_printed(problem, cq.solve(problem))
        assert (found.passed, found.proven) == (True, False)
        assert found.reasons[0] == "energy_error: friction: 24 contacts, at most 23 are examined"
        assert "uniqueness was not examined: 24 contacts, at most 23 are examined" in found.notes
    monkeypatch.setattr(critical_friction, "MOST_CONTACTS", 24)
    monkeypatch.setattr(critical_friction, "MOST_NEARBY", 24)
    monkeypatch.setattr(critical_friction, "MOST_UNKNOWNS", 47)
    found = certificate_of_printed(plane, cq.solve(plane))
    assert found.reasons[0] == "energy_error: friction: 48 contact unknowns, at most 47 are examined"
