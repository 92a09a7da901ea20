"""Random lattices over a floor and a ball: every answer is held to the conditions of an equilibrium by hand."""

from functools import cache

import numpy as np
import pytest
from scipy.optimize import minimize

import contactqp as cq
from tests.analysis.lattices import lattice


def conditions(body, contact, load, solution):
    """The largest violation: balance over the largest load, overlap, tension, force without contact."""
    u, force = solution.displacement, solution.normal_force
    state = contact.state(u)
    balance = load - body.internal_force(u) - state.normal.T @ force
    return max(
        np.abs(balance).max() / np.abs(load).max(), -state.gap.min(), -force.min(), np.abs(state.gap * force).max()
    )


@cache
def loaded(seed):
    """A lattice, what is in its way, its load, and its path to there."""
    body, contact, load = lattice(seed)
    return body, contact, load, cq.large_deformation(body, [load], contact, steps=5)


@pytest.mark.parametrize("seed", [0, 7, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 4, 24))])
def test_lattices_come_to_rest_on_what_is_in_their_way(seed):
    """7 starts with an overlap; 24 snaps, a long way."""
    body, contact, load, history = loaded(seed)
    last = history[-1]
    assert conditions(body, contact, load, last) < 1e-10
    assert last.normal_force.max() > 1e-3
    assert history.stable[-1]
    assert conditions(body, contact, 1.01 * load, last) > 1e-3, "the answer to another load"


@pytest.mark.parametrize("seed", [0, pytest.param(4, marks=pytest.mark.slow)])
def test_scipys_slsqp_finds_no_lower_energy_nearby(seed):
    body, contact, load, history = loaded(seed)
    last = history[-1]
    random = np.random.default_rng(seed)
    found = minimize(
        lambda u: body.energy(u) - load @ u,
        last.displacement + 1e-3 * random.uniform(-1, 1, len(load)),
        jac=lambda u: body.internal_force(u) - load,
        constraints=dict(
            type="ineq",
            fun=lambda u: contact.state(u).gap,
            jac=lambda u: -contact.state(u).normal.toarray(),
        ),
        method="SLSQP",
        options=dict(ftol=1e-14, maxiter=500),
    )
    np.testing.assert_allclose(found.x, last.displacement, atol=1e-5)
    assert found.fun == pytest.approx(last.energy, rel=1e-9)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (4, 7))])
def test_arc_length_meets_load_control_where_nothing_snaps(seed):
    body, contact, load, by_load = loaded(seed)
    assert not by_load.notes
    path = cq.large_deformation(body, [load], contact, control="arc-length", steps=25)
    assert all(conditions(body, contact, t * load, at) < 1e-10 for t, at in zip(path.times[1:], path[1:], strict=True))
    k = int(np.searchsorted(path.times, 1))
    np.testing.assert_array_equal(path[k].normal_force > 0, by_load[-1].normal_force > 0)
    a, b = path.times[k - 1], path.times[k]
    between = path.displacements[k - 1] + (1 - a) / (b - a) * (path.displacements[k] - path.displacements[k - 1])
    np.testing.assert_allclose(between, by_load[-1].displacement, atol=2e-2 * np.abs(between).max())


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3])
def test_a_snap_under_load_is_a_limit_point_of_the_path(seed):
    body, contact, load, history = loaded(seed)
    note = history.notes[0]
    told = [float(number.strip(":")) for number in note.split("jumps")[0].split() if number[:2] == "0."]
    path = cq.large_deformation(body, [load], contact, control="arc-length", steps=30)
    limit = path.limit_points[0]
    assert (limit.kind, limit.smooth) == ("maximum", True)
    assert limit.load_factor == pytest.approx(told[-1], rel=2e-3)
    assert limit.load_factor <= told[-1]
