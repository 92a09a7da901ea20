"""Newton's method on the combination of states: found among all equilibria, or not at all."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate.local_certificate import siconos_local_error
from contactqp.linalg.condensation import condense
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK
from contactqp.solving.friction import alart_curnier
from contactqp.solving.friction.alart_curnier import drawn_combinations
from contactqp.solving.friction.force_system import ForceSystem
from contactqp.solving.friction.local_form import BlockSystem, Iterate, LocalForm
from tests.solving.friction.problems import one_contact, pad, random_problem, rough_truss, two_masses


def test_the_truss_is_solved_to_the_last_digits() -> None:
    solution = cq.solve(rough_truss(), algorithm="newton")
    assert solution.method == "newton"
    np.testing.assert_allclose(solution.displacement, [30058 / 30933965, -1e-3], rtol=1e-15)
    np.testing.assert_allclose(solution.normal_force, 180933933661 / 6186793000, rtol=1e-14)
    assert solution.work.iterations <= 3


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3))])
def test_what_it_finds_is_among_all_equilibria(seed: int) -> None:
    rng = np.random.default_rng(seed)
    found = unique = 0
    for _ in range(60):
        problem = random_problem(rng)
        if not problem.frictional:
            continue
        every = cq.equilibria(problem)
        unique += len(every) == 1
        try:
            solution = cq.solve(problem, algorithm="newton")
        except cq.NotConverged:
            continue
        except cq.NoEquilibrium:
            assert not every
            continue
        scale = np.max(abs(solution.displacement))
        distances = [np.max(abs(solution.displacement - other.displacement)) for other in every]
        assert min(distances) <= 1e-7 * scale
        found += len(every) == 1
    assert found >= 0.8 * unique, "strongly coupled, mu up to 5: nearly all of them"


def test_a_warm_start_is_newtons_and_what_newton_cannot_is_tresca_s() -> None:
    first = cq.solve(two_masses(12.0))
    again = cq.solve(two_masses(11.9, (4.6425e-3, 1.419e-2)), warm_start=first)
    assert first.method.startswith("Tresca")
    assert again.method == "newton"
    assert again.contact_status.tolist() == ["stick", "stick"]
    with pytest.raises(cq.NotConverged, match="newton"):
        cq.solve(two_masses(12.0), algorithm="newton", max_iter=1)
    assert cq.solve(two_masses(12.0), warm_start=first, max_iter=3).certificate.passed


def test_no_equilibrium_is_none_of_its_answers() -> None:
    with pytest.raises(cq.NoEquilibrium, match="friction or tie holds back"):
        cq.solve(pad(3636.0), algorithm="newton")
    with pytest.raises(cq.NotConverged, match="time limit"):
        cq.solve(rough_truss(), algorithm="newton", time_limit=1e-9)


def test_above_the_critical_friction_it_finds_one_of_three() -> None:
    problem = one_contact([[1, 2], [2, 5]], [0.3, 1.25], 0.8)
    states = {str(solution.contact_status[0]) for solution in cq.equilibria(problem)}
    assert states == {"open", "stick", "slip"}
    assert str(cq.solve(problem, algorithm="newton").contact_status[0]) in states


@pytest.fixture
def system_of_nine() -> tuple[ForceSystem, cq.ContactProblem]:
    rng = np.random.default_rng(5)
    m, n = 9, 20
    shape = rng.normal(size=(n, n))
    problem = cq.ContactProblem(
        stiffness=shape @ shape.T + np.eye(n),
        load=rng.normal(size=n),
        normal=rng.normal(size=(m, n)),
        gap=rng.normal(size=m),
        tangent=rng.normal(size=(m, n)),
        friction=0.4,
    )
    return ForceSystem(problem, condense(problem)), problem


def test_factors_that_are_updated_give_what_new_ones_give(
    system_of_nine: tuple[ForceSystem, cq.ContactProblem],
) -> None:
    system, problem = system_of_nine
    lengths = system.lengths(problem, condense(problem).reduce_load(problem.load)[0])
    rng = np.random.default_rng(6)
    status = np.full(9, STICK, dtype=np.int8)
    for _ in range(40):
        status = status.copy()
        status[rng.integers(9)] = rng.choice([OPEN, STICK, SLIP_BACK, SLIP_ON])
        fresh = ForceSystem(problem, condense(problem)).solve(status, lengths)
        updated = system.solve(status, lengths)
        np.testing.assert_allclose(updated.normal, fresh.normal, rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(updated.slip, fresh.slip, rtol=1e-9, atol=1e-10)
    assert system.factorisations < 40


def test_a_spoiled_update_is_seen_and_factorised_anew(system_of_nine: tuple[ForceSystem, cq.ContactProblem]) -> None:
    system, problem = system_of_nine
    lengths = system.lengths(problem, condense(problem).reduce_load(problem.load)[0])
    status = np.full(9, STICK, dtype=np.int8)
    system.solve(status, lengths)
    status[0] = SLIP_ON
    right = system.solve(status, lengths)
    assert system.factorisations == 1
    system._factor._columns = {i: 1.001 * column for i, column in system._factor._columns.items()}
    again = system.solve(status, lengths)
    assert system.factorisations == 2
    np.testing.assert_allclose(again.normal, right.normal, rtol=1e-10)


@pytest.mark.slow
def test_drawn_combinations_pass_over_bodies_that_have_gone_far_away() -> None:
    """A motion that contacts hardly resist takes a body thousands of lengths away, where no digit of a gap is left."""
    rng = np.random.default_rng(2)
    motions = rng.normal(size=(9, 2))
    motions[:, 1] = motions[:, 0] + 1e-6 * rng.normal(size=9)
    force = np.abs(rng.normal(size=(3, 3))) * [1.0, 0.5, 0.5]
    form = LocalForm(
        cq.LocalProblem(
            delassus=np.eye(9),
            offset=-force.ravel(),
            friction=3.0,
            dimension=3,
            bilateral=motions,
            bilateral_offset=-motions.T @ force.ravel(),
        )
    )
    found = list(drawn_combinations(form, Iterate.nothing(form)))
    assert len(found) > 10
    assert max(np.max(abs(one.joint_force)) for one in found) <= 1e3


def _chain(m: int, d: int, joints: int, coupled: int) -> LocalForm:
    """Return contacts that feel others up to twice `coupled` away; one of them has no compliance of its own."""
    rng = np.random.default_rng(10 * m + d)
    rows = np.kron(np.eye(m), np.eye(d)) + 0.2 * rng.normal(size=(m * d, m * d))
    apart = abs(np.subtract.outer(np.arange(m), np.arange(m))) <= coupled
    rows *= np.kron(apart, np.ones((d, d)))
    rows[5 * d : 6 * d] = 0.0
    V = rng.normal(size=(m * d, joints))
    return LocalForm(
        cq.LocalProblem(
            delassus=rows @ rows.T,
            offset=rng.normal(size=m * d),
            friction=np.where(np.arange(m) % 7, 0.3, 0.0),
            dimension=d,
            bilateral=V,
            bilateral_delassus=np.eye(joints),
            bilateral_offset=rng.normal(size=joints),
        )
    )


@pytest.mark.sampled(4)
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(("m", "joints", "coupled"), [(20, 2, 19), (120, 0, 1), (160, 0, 1), (160, 3, 1)])
def test_newtons_step_is_that_of_the_whole_law(m: int, joints: int, coupled: int, d: int) -> None:
    """The equations of closed contacts, dense or by blocks, give the step that those of all contacts give."""
    form, rng = _chain(m, d, joints, coupled), np.random.default_rng(m)
    assert form.sparse == (m > 20)
    here = Iterate.at(form, rng.normal(size=(m, d)), rng.normal(size=joints))
    r, u = here.force, form.velocity(here.force, here.joint_force)
    closed, stuck = _law(r, u, form.mu)
    assert 0 < stuck.sum() < closed.sum() < m
    step = alart_curnier._direction(form, here, 1e-3)
    assert step is not None
    change, joint_change = step
    W = (form.W.toarray() if form.sparse else form.W) + 1e-3 * np.eye(m * d)
    du = (W @ change.ravel() + form.V @ joint_change).reshape(m, d)
    t = 1e-7
    ahead = _map(r + t * change, u + t * du, form.mu)
    np.testing.assert_allclose((ahead - _map(r, u, form.mu)) / t, -_map(r, u, form.mu), rtol=1e-4, atol=1e-4)
    missed = form.joint_residual(r + change, here.joint_force + joint_change)
    np.testing.assert_allclose(missed, 0.0, atol=1e-9)


def _law(r: np.ndarray, u: np.ndarray, mu: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which contacts are closed and which of them stick (m,)."""
    trial = r - u
    closed = trial[:, 0] > 0
    return closed, closed & (mu > 0) & (np.linalg.norm(trial[:, 1:], axis=1) <= mu * trial[:, 0])


def _map(r: np.ndarray, u: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """Return Alart's and Curnier's residual (m, d)."""
    push = np.maximum(r[:, 0] - u[:, 0], 0.0)
    y = r[:, 1:] - u[:, 1:]
    size = np.linalg.norm(y, axis=1)
    part = np.minimum(1.0, mu * push / size)
    return np.column_stack([r[:, 0] - push, r[:, 1:] - part[:, None] * y])


def test_open_contacts_take_no_part_in_newtons_equations(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes, form = [], _chain(160, 3, 0, 1)
    solve = BlockSystem.solve
    monkeypatch.setattr(BlockSystem, "solve", lambda self, *right: sizes.append(len(right[0])) or solve(self, *right))
    force = np.zeros((160, 3))
    force[:40, 0] = 1e3
    here = Iterate.at(form, force, np.zeros(0))
    closed = force[:, 0] > form.velocity(force, np.zeros(0))[:, 0]
    alart_curnier._direction(form, here, 1e-3)
    assert sizes == [3 * closed.sum()]
    assert closed.sum() < 160


def test_where_newton_ends_at_rounding_it_does_not_start_again(monkeypatch: pytest.MonkeyPatch) -> None:
    calls, newton = [], alart_curnier.newton
    monkeypatch.setattr(
        "contactqp.solving.friction.algorithms.newton", lambda *given: calls.append(given) or newton(*given)
    )
    problem = cq.LocalProblem(delassus=np.diag([3.0, 7.0, 11.0]), offset=[-0.1, 0.7, 0.3], friction=0.3, dimension=3)
    assert cq.solve(problem).certificate.natural_map <= 1e-15
    assert len(calls) == 1


def _pile(seed: int, d: int, bodies: int = 6, contacts: int = 18) -> cq.LocalProblem:
    """Return rigid bodies with more contacts than motions, loaded by the forces of a known answer."""
    rng = np.random.default_rng(seed)
    motions = 3 * d - 3
    G = np.zeros((contacts * d, (bodies + 1) * motions))
    for i in range(contacts):
        frame = np.linalg.qr(rng.normal(size=(d, d)))[0]
        for body, sign in zip(rng.choice(bodies + 1, 2, replace=False), (1.0, -1.0), strict=True):
            arm = rng.normal(size=d) / 2
            turned = np.array([[-arm[1]], [arm[0]]]) if d == 2 else np.cross(np.eye(3), arm).T
            own = slice(motions * body, motions * (body + 1))
            G[d * i : d * (i + 1), own] = sign * frame.T @ np.hstack([np.eye(d), turned])
    G = G[:, motions:]  # the first body is the ground
    states = rng.choice(3, contacts, p=(0.4, 0.35, 0.25))
    way = rng.normal(size=(contacts, d - 1))
    way /= np.linalg.norm(way, axis=1)[:, None]
    push = np.where(states > 0, 10.0 ** rng.uniform(-2, 0.5, contacts), 0.0)
    part = np.where(states == 1, rng.uniform(size=contacts), 1.0)
    r = np.column_stack([push, 0.3 * (part * push)[:, None] * way])
    gap = np.where(states == 0, rng.uniform(size=contacts), 0.0)
    u = np.column_stack([gap, -np.where(states == 1, 0.0, rng.uniform(size=contacts))[:, None] * way])
    W = G @ G.T
    return cq.LocalProblem(delassus=W, offset=u.ravel() - W @ r.ravel(), friction=0.3, dimension=d)


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("seed", "d"), [(0, 2), (15, 2), (29, 2), (89, 2), (95, 2), (95, 3), (122, 3), (139, 3)])
def test_newton_passes_over_points_from_which_no_step_lowers_the_residual(seed: int, d: int) -> None:
    """It used to end there, on contacts that depend on one another, and other algorithms had to begin anew."""
    problem = _pile(seed, d)
    found = cq.solve(problem, algorithm="newton")
    assert siconos_local_error(problem, found.force) <= 1e-12
