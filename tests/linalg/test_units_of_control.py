"""Programs of control and smoothing are solved in all units of their unknowns and rows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.linalg.equilibration import _units_of_bodies


def double_integrator(steps: int) -> dict[str, Any]:
    """Return a body that is brought to rest at zero from 3, with bounded force and speed; in each step force, place,
    speed, of which the speed costs nothing.
    """
    A, B, start = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.005], [0.1]]), np.array([3.0, 0.0])
    eye, back = sp.eye_array(steps), sp.eye_array(steps, k=-1)
    moves = sp.kron(eye, np.hstack([-B, np.eye(2)])) + sp.kron(back, np.hstack([np.zeros((2, 1)), -A]))
    value = np.concatenate([A @ start, np.zeros(2 * steps - 2)])
    limit = np.tile([1.0, 5.0, 0.5], steps)
    P = sp.diags_array(np.tile([0.01, 1.0, 0.0], steps))
    return dict(P=P, q=np.zeros(3 * steps), A=sp.csr_array(moves), b=value, lb=-limit, ub=limit)


@pytest.mark.parametrize("unit", [1e-7, 1e7])
@pytest.mark.parametrize("steps", [20, 50])
def test_control_in_other_units_is_proven_and_has_the_same_energy(steps: int, unit: float) -> None:
    """Ties were met to 5e-9, and the answer refused, with unknowns in 1e7 of these units, and rows in their own."""
    given = double_integrator(steps)
    of_rows = 10.0 ** np.random.default_rng(5).uniform(-5, 5, len(given["b"]))
    changed = dict(
        P=given["P"] * unit**2, q=given["q"], A=sp.diags_array(of_rows) @ given["A"] * unit, b=of_rows * given["b"],
        lb=given["lb"] / unit, ub=given["ub"] / unit,
    )  # fmt: skip
    plain, solution = (cq.solve(cq.ContactProblem.from_qp(**one)) for one in (given, changed))
    assert plain.certificate.proven
    assert solution.certificate.proven
    assert solution.energy == pytest.approx(plain.energy, rel=1e-12)
    assert solution.displacement * unit == pytest.approx(plain.displacement, rel=1e-7, abs=1e-9)


def test_a_chain_on_springs_over_many_decades_keeps_its_own_units() -> None:
    """At a unit diagonal of K its rows would have entries of 1e-6 beside one, and rounding of these would conflict."""
    rng = np.random.default_rng([17, 12])
    springs, rows = np.exp2(rng.integers(-43, 1, 614).astype(float)), 598
    E = sp.diags_array([np.ones(rows), -2.0 * np.ones(rows)], offsets=[0, 1], shape=(rows, 614)).tocsr()
    u, force = rng.integers(-4, 5, 614).astype(float), np.ldexp(rng.integers(1, 9, rows), rng.integers(-43, 1, rows))
    problem = cq.ContactProblem(sp.diags_array(springs).tocsr(), springs * u + E.T @ force, E, E @ u)
    given, factors = abs(sp.csr_matrix(problem.normal)), _units_of_bodies(problem)
    entries = (sp.diags_array(factors[1]) @ given @ sp.diags_array(factors[0])).tocsr()
    assert np.min(entries.data) == pytest.approx(0.5)
    assert cq.certify(problem, u, force).proven
