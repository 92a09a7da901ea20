"""Problems whose right answers are known before they are: whole numbers, put together backwards, no solver asked.

u, l_N, l_T, nu are chosen; then g = E_N u where a contact presses and more where it is open, slip_origin = E_T u where
it sticks and behind it along l_T where it slips, and f = K u + E_N' l_N + E_T' l_T + A' nu. All of it are integers or
quarters, which doubles hold exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

import contactqp as cq

# Unit directions with whole sides: 3-4-5.
DIRECTIONS = np.array([[3, 4], [-4, 3], [5, 0], [-3, -4]])


@dataclass(frozen=True)
class Exact:
    """A problem, and its answer in doubles that hold it exactly."""

    problem: cq.ContactProblem
    displacement: np.ndarray
    normal_force: np.ndarray
    friction_force: np.ndarray | None
    tie_force: np.ndarray | None


def exact(seed: int) -> Exact:
    """Seed 0 to 9: without friction and ties, with ties, with friction in the plane, in space, and both."""
    random = np.random.default_rng(seed)
    width = (0, 0, 0, 0, 0, 1, 1, 2, 2, 1)[seed]
    ties = (0, 0, 0, 1, 2, 0, 0, 0, 0, 1)[seed]
    m = 2 + seed % 3
    n = m * (1 + width) + ties + 2
    A = random.integers(-2, 3, size=(n, n))
    K = A.T @ A + np.diag(random.integers(1, 5, size=n))
    rows = np.eye(n, dtype=int)  # one unknown a row, and some neighbours: independent
    rows += np.triu(random.integers(0, 2, size=(n, n)), 1)
    E_N, E_T, tie = rows[:m], rows[m : m + m * width], rows[m + m * width : m + m * width + ties]
    u = random.integers(-9, 10, size=n)
    force = np.where(np.arange(m) % 3 == 2, 0, 20 * random.integers(1, 6, size=m))
    gap = E_N @ u + np.where(force > 0, 0, random.integers(1, 5, size=m))
    f = K @ u + E_N.T @ force
    given: dict[str, Any] = dict(stiffness=sp.csr_array(K.astype(float)), normal=E_N, gap=gap)
    rub = nu = None
    if width:
        sliding = (np.arange(m) % 2 == 0) & (force > 0)
        along = DIRECTIONS[random.integers(0, 4, size=m)] if width == 2 else 5 * random.choice([-1, 1], size=(m, 1))
        rub = along * (force // 20)[:, None]  # friction 1/4 of the force where all of it is used: |along| is 5
        rub = np.where(sliding[:, None], rub, rub - rub // 2)
        slip = np.where(sliding[:, None], along * random.integers(1, 4, size=(m, 1)), 0)
        slip = np.where(force[:, None] > 0, slip, random.integers(-3, 4, size=(m, width)))
        f = f + E_T.T @ rub.ravel()
        given |= dict(tangent=E_T, friction=0.25, slip_origin=(E_T @ u).reshape(m, width) - slip)
    if ties:
        nu = random.integers(-9, 10, size=ties)
        f = f + tie.T @ nu
        given |= dict(tie=tie, tie_value=tie @ u)
    names = [f"{k // 3 + 1}.{'xyz'[k % 3]}" for k in range(n)]
    contacts = [f"spot {i}" for i in range(m)]
    problem = cq.ContactProblem(load=f, **given, dof_names=names, contact_names=contacts)
    parts = (None if part is None else part.astype(float) for part in (u, force, rub, nu))
    return Exact(problem, *parts)  # type: ignore[arg-type]
