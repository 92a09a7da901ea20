"""Bounds with friction where rounding is large beside them: soft bodies, sliding ones, forces that nearly vanish."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

import contactqp as cq

# Slips (a, b, c) of length c.
DIRECTIONS = ((3, 4, 5), (-4, 3, 5), (5, -12, 13), (-8, -15, 17))
WIDE = dict(tolerance=0.9, error_tolerance=1e3)


def sliding_node(
    K: np.ndarray, load: np.ndarray, mu: float, gap: float, direction: int
) -> tuple[cq.ContactProblem, list[Fraction]]:
    """A node that is pressed to a wall and slides, with its exact second displacement and normal force."""
    problem = cq.ContactProblem(K, load, [[1.0, 0.0]], [gap], tangent=[[0.0, 1.0]], friction=mu)
    (a, b), (_, c) = [[Fraction(float(x)) for x in row] for row in K]
    f, h, g, drag = Fraction(float(load[0])), Fraction(float(load[1])), Fraction(gap), direction * Fraction(mu)
    across = (h - b * g - drag * (f - a * g)) / (c - drag * b)  # b g + c x + drag (f - a g - b x) = h
    return problem, [across, f - a * g - b * across]


@pytest.mark.sampled(10)
@pytest.mark.parametrize("soft", [1.0, 2.0**-20, 2.0**-30])
@pytest.mark.parametrize("off", [0.0, 1e-15, 1e-12])
def test_no_bound_is_below_the_distance_by_what_doubles_round(soft: float, off: float) -> None:
    rng, proven = np.random.default_rng(5), 0
    for _ in range(15):
        angle = rng.uniform(0.3, 1.2)
        one, other = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        K = np.outer(one, one) + soft * np.outer(other, other)
        K[1, 0] = K[0, 1]
        mu, gap = float(rng.choice([0.125, 0.3, 3.0])), rng.normal()
        for direction in (1, -1):
            load = K @ [gap, direction * rng.uniform(0.5, 2.0)] + np.array([1.0, direction * mu]) * rng.uniform(1, 4)
            problem, (across, push) = sliding_node(K, load, mu, gap, direction)
            drag = direction * Fraction(mu) * push
            u, forces = np.array([gap, float(across)]), np.array([float(push), float(drag)]) * (1 + off * rng.normal())
            u[1] *= 1 + off * rng.normal()
            judged = cq.certify(problem, u, forces[:1], forces[1:], **WIDE)
            proven += judged.proven
            if not judged.proven:
                continue
            (a, b), (_, c) = [[Fraction(float(x)) for x in row] for row in K]
            v = Fraction(u[1]) - across
            assert judged.energy_error is not None
            assert judged.force_error is not None
            # In rational numbers, squared: the roots are not.
            strain = a * Fraction(gap) ** 2 + 2 * b * Fraction(gap) * across + c * across**2
            assert Fraction(judged.energy_error) ** 2 * strain >= c * v * v

            def squared(x: Fraction, y: Fraction, a: Fraction = a, b: Fraction = b, c: Fraction = c) -> Fraction:
                return (c * x * x - 2 * b * x * y + a * y * y) / (a * c - b * b)

            apart = squared(Fraction(forces[0]) - push, Fraction(forces[1]) - drag)
            assert Fraction(judged.force_error) ** 2 * squared(push, drag) >= apart
    assert proven >= 20


def soft_pair(rng: np.random.Generator, soft: float) -> tuple[np.ndarray, Fraction]:
    """Two nodes joined by springs, both on a soft bed, and W_NN / W_NT of a contact that presses both, exactly."""
    stiff = np.array([[1.3, 0.4], [0.4, 0.9]]) * rng.uniform(0.7, 1.4, (2, 2))
    bed = soft * np.array([[1.1, 0.35], [0.35, 1.7]]) * rng.uniform(0.7, 1.4, (2, 2))
    stiff[1, 0], bed[1, 0] = stiff[0, 1], bed[0, 1]
    own, beside = stiff + bed, bed - stiff
    # On both nodes alike own + beside resists, in rational numbers; its inverse is that of the contact's rows.
    across, between = (Fraction(own[1, i]) + Fraction(beside[1, i]) for i in (1, 0))
    return np.block([[own, beside], [beside, own]]), across / abs(between)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("soft", [2.0**-10, 2.0**-30, 2.0**-36])
def test_rounding_of_a_soft_body_hides_no_friction_above_the_critical(soft: float) -> None:
    rng, undecided = np.random.default_rng(3), 0
    rows = np.array([[1.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 1.0]])
    for _ in range(20):
        K, limit = soft_pair(rng, soft)
        for part, several in ((1 + 1e-9 / soft**0.5, True), (1 + 1e-13, True), (0.99, False)):
            mu = float(limit * Fraction(part))
            problem = cq.ContactProblem(K, np.ones(4), rows[:1], [0.0], tangent=rows[1:], friction=mu)
            found = cq.critical_friction(problem)
            assert not (several and found.unique)
            undecided += not several and not found.unique
    assert not undecided


def free_pair(push: float, drag: float) -> cq.ContactProblem:
    """Two nodes joined by springs, held by nothing but a rough floor below the first; loads act on the second."""
    joined = np.kron(np.array([[1.0, -1.0], [-1.0, 1.0]]), np.eye(2))
    load = np.array([0.0, 0.0, drag, -push])
    return cq.ContactProblem(joined, load, [[0.0, -1.0, 0.0, 0.0]], [0.0], tangent=[[1.0, 0.0, 0.0, 0.0]], friction=0.5)


@pytest.mark.parametrize("excess", [0.0, 1e-13])
def test_bodies_that_slide_at_their_friction_are_not_claimed_to_be_alone(excess: float) -> None:
    # Without excess any slip is one of equilibrium, with it none is.
    problem = free_pair(1.0, 0.5 * (1 + excess))
    judged = cq.certify(problem, [1.0, 0.0, 1.5, -1.0], [1.0], [0.5])
    assert judged.scope is None
    assert any("rounding decides whether friction balances it" in reason for reason in judged.reasons)
    assert cq.certify(free_pair(1.0, 0.25), [0.0, 0.0, 0.25, -1.0], [1.0], [0.25]).proven


def test_a_body_that_floats_freely_is_alone_but_for_its_motion() -> None:
    pulled = free_pair(0.0, 0.0).replace(load=[-1.0, -2.0, 1.0, 2.0], gap=[4.0])
    judged = cq.certify(pulled, [-0.5, -1.0, 0.5, 1.0], [0.0], [0.0])
    assert judged.scope == "local"
    assert any("rigid motions that nothing resists" in note for note in judged.notes)
    held = cq.certify(free_pair(1.0, 0.25), [0.0, 0.0, 0.25, -1.0], [1.0], [0.25])
    assert not any("rigid motions that nothing resists" in note for note in held.notes)


def test_forces_that_may_vanish_have_no_relative_error() -> None:
    gap = 1.0 - 2.0**-27
    problem = cq.ContactProblem(np.eye(2), [1.0, 1.0], [[1.0, 0.0]], [gap], tangent=[[0.0, 1.0]], friction=0.3)
    exact = [1.0 - gap]  # an answer that has none is as far from it as all of it
    judged = cq.certify(problem, [1.0 - 2.0**-26, 1.0], [0.0], [0.0], **WIDE)
    assert judged.force_error is None or judged.force_error >= 1.0
    right = cq.certify(problem, [gap, 1.0 - 0.3 * exact[0]], exact, [0.3 * exact[0]])
    assert right.scope == "global"
    assert right.force_error is not None
    assert right.force_error < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("spread", [1, pytest.param(40, marks=pytest.mark.slow)])
def test_slip_directions_in_space_are_doubles_and_bounds_allow_for_it(spread: int) -> None:
    """Two nodes that slip along (3, 4) / 5 and the like, as whole numbers say; slips are rounded in each digit."""
    rng, scopes = np.random.default_rng(3), set()
    for _ in range(12 * spread):
        springs = rng.integers(-3, 4, (8, 6))
        K = springs.T @ springs + np.diag(rng.integers(1, 4, 6))
        u, size = rng.integers(-9, 10, 6), rng.integers(1, 6, 2)
        slip = size[:, None] * [DIRECTIONS[i][:2] for i in rng.integers(0, len(DIRECTIONS), 2)]
        length = np.rint(np.linalg.norm(slip, axis=1)).astype(int)
        push = length * rng.integers(1, 20, 2)
        rub = push[:, None] * slip // length[:, None]
        mu = float(rng.choice([1.0, 3.0]))
        rows, along = np.eye(6)[[0, 3]], np.eye(6)[[1, 2, 4, 5]]
        forces = (int(mu) * rub).ravel()
        load = K @ u + rows.T @ push + along.T @ forces
        problem = cq.ContactProblem(
            K, load, rows, rows @ u, tangent=along, friction=mu, slip_origin=along @ u - slip.ravel()
        )
        for part in (1e-16, 1e-13):
            moved, pushed, rubbed = (x * (1 + part * rng.normal(size=x.shape)) for x in (u, push, forces))
            judged = cq.certify(problem, moved, pushed, rubbed)
            if judged.proven and judged.energy_error is not None:
                scopes.add(judged.scope)
                v = [Fraction(a) - int(b) for a, b in zip(moved, u, strict=True)]
                energy = sum(int(k) * a * b for row, a in zip(K, v, strict=True) for k, b in zip(row, v, strict=True))
                assert Fraction(judged.energy_error) ** 2 * int(u @ K @ u) >= energy
    assert scopes == ({"global", "local"} if spread > 1 else {"local"})


def test_open_contacts_of_an_unsymmetric_local_problem_may_close_in_others_nearby() -> None:
    # Open, it slips at r = (1, -2) as well, |r|^2 = 1 - 2 + 4, and sticks at (4, -5).
    problem = cq.LocalProblem(delassus=[[1.0, 1.0], [0.0, 1.0]], offset=[1.0, 5.0], friction=2.0, dimension=2)
    judged = [cq.certify_local(problem, force) for force in ([0.0, 0.0], [1.0, -2.0], [4.0, -5.0])]
    assert [one.scope for one in judged] == ["local"] * 3
    assert all(one.radius is not None and 0.1 < one.radius < 3.0**0.5 for one in judged)


def sticking_force(W: np.ndarray, offset: np.ndarray) -> list[Fraction]:
    (a, b), (_, c) = [[Fraction(x) for x in row] for row in W.tolist()]
    p, s = (Fraction(x) for x in offset.tolist())
    return [(b * s - c * p) / (a * c - b * b), (b * p - a * s) / (a * c - b * b)]


@pytest.mark.slow
def test_friction_within_rounding_of_its_bound_may_be_beyond_it() -> None:
    rng, proven = np.random.default_rng(4), 0
    for _ in range(60):
        W = np.array([[2.0, 1.0], [1.0, 3.0]]) * rng.integers(1, 9)
        offset = np.array([-1.0, 0.0]) - rng.uniform(0.0, 0.2, 2)
        push, rub = sticking_force(W, offset)
        mu = float(abs(rub) / push)
        problem = cq.LocalProblem(delassus=W, offset=offset, friction=mu, dimension=2)
        drag = Fraction(mu) * (1 if rub > 0 else -1)
        if abs(rub) > Fraction(mu) * push:  # it slips by next to nothing, u_N = 0
            push = -Fraction(offset[0]) / (Fraction(W[0, 0]) + Fraction(W[0, 1]) * drag)
            rub = drag * push
        for force in ([float(push), float(rub)], [float(push), mu * float(push) * (1 if rub > 0 else -1)]):
            judged = cq.certify_local(problem, force)
            if judged.force_error is None:
                continue
            proven += 1
            (a, b), (_, c) = W.astype(int).tolist()
            x, y = Fraction(force[0]) - push, Fraction(force[1]) - rub
            size = a * push**2 + 2 * b * push * rub + c * rub**2
            assert Fraction(judged.force_error) ** 2 * size >= a * x * x + 2 * b * x * y + c * y * y
    assert proven > 50


def block_on_feet(pushed: float, feet: tuple[float, ...] = (-1.0, 1.0)) -> cq.ContactProblem:
    """A rigid block (x, y, turn) on a bed, pressed onto feet and pushed sideways; their tangential rows are one."""
    normal = np.array([[0.0, -1.0, -x] for x in feet])
    tangent = np.tile([[1.0, 0.0, 0.0]], (len(feet), 1))
    return cq.ContactProblem(
        np.diag([1.0, 2.0, 3.0]), [pushed, -8.0, 1.0], normal, np.zeros(len(feet)), tangent=tangent, friction=0.25
    )


def test_a_rigid_block_that_slides_on_two_feet_is_proven() -> None:
    # 4.5 + 3.5 press and rub with 2: x = 5 - 2.
    problem = block_on_feet(5.0)
    exact = cq.certify(problem, [3.0, 0.0, 0.0], [4.5, 3.5], [1.125, 0.875])
    assert (exact.passed, exact.scope) == (True, "local")
    assert exact.radius is not None
    assert exact.force_bound is not None
    assert 0.5 < exact.radius < 3.5
    assert np.all(exact.force_bound < 1e-14)
    off = cq.certify(problem, [3.0, 0.0, 0.0], [4.5 + 2.0**-27, 3.5 - 2.0**-27], [1.125, 0.875])
    assert off.force_bound is not None
    assert np.all(off.force_bound >= 2.0**-27)
    # Sticking, they share friction in many ways.
    assert cq.certify(block_on_feet(1.0), [0.0, 0.0, 0.0], [4.5, 3.5], [0.4, 0.6]).scope is None
    assert cq.certify(block_on_feet(5.0, (-1.0, 0.0, 1.0)), [3.0, 0.0, 0.0], [4, 1, 3], [1.0, 0.25, 0.75]).scope is None
