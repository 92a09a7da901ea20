"""Problems with known exact answers, used by many tests. Numbers are those of the course chapter's examples."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

import contactqp as cq

# Example 2.10 with the printed stiffness: d1x, l_N from the exact rationals.
TRUSS_FORCE = float(Fraction(180933933661, 5980300000))
TRUSS_DISPLACEMENT = (float(Fraction(668831, 598030000)), -1e-3)
# Compliance seen by its contact: S = K22 - K12^2/K11.
TRUSS_CONTACT_STIFFNESS = float(Fraction(458394666339, 5980300))

# A case file whose load drives its node away from the wall: no equilibrium.
PUSHED_OFF = """\
title = "pushed off"
axes = ["x"]
nodes = [{ name = "1", at = ["0 m"] }]
obstacles = [{ name = "wall", point = ["1 m"], normal = [-1] }]
contacts = [{ name = "tip", node = "1", obstacle = "wall" }]
loads = [{ unknown = "1.x", value = "-1 N" }]
"""


def truss(**changes: object) -> cq.ContactProblem:
    """Example 2.10, printed stiffness: a two-bar truss over a floor 1 mm below its node (kN, m)."""
    data: dict[str, object] = dict(
        stiffness=np.array([[59803.0, 6883.1], [6883.1, 77443.0]]),
        load=[60.0, -100.0],
        normal=[[0.0, -1.0]],
        gap=[1e-3],
        dof_names=["1.x", "1.z"],
        contact_names=["floor"],
        units={"length": "m", "force": "kN"},
    )
    return cq.ContactProblem(**(data | changes))


def two_bars(load: float = 300.0) -> cq.ContactProblem:
    """Example 2.13: two bars, 1 mm apart; l = 95 kN at 300 kN."""
    return cq.ContactProblem(
        stiffness=np.diag([157500.0, 315000.0]), load=[load, 0.0], normal=[[1.0, -1.0]], gap=[1e-3]
    )


def body_on_spring_in_mid_air() -> cq.ContactProblem:
    """Two masses on a spring of 1e11 N/m, loaded by 10 N, 1 m from the wall: only the wall can hold them."""
    return cq.ContactProblem(
        stiffness=1e11 * np.array([[1.0, -1.0], [-1.0, 1.0]]), load=[0.0, 10.0], normal=[[1.0, 0.0]], gap=[1.0]
    )


def cantilever(
    elements: int = 400, length: float = 1.0, bending: float = 1.0, pressure: float = 1.0
) -> cq.ContactProblem:
    """A clamped Euler-Bernoulli beam under uniform load on a stop at its tip, unknowns (w, theta) a node.

    The stop's force is R = 3EI/L^3 (q L^4/(8EI) - g), exact for this element with consistent loads.
    """
    h = length / elements
    local = bending / h**3 * np.array(
        [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h],
         [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h * h, -6 * h, 4 * h * h]]
    )  # fmt: skip
    force = pressure * h / 2 * np.array([1.0, h / 6, 1.0, -h / 6])
    n = 2 * (elements + 1)
    K, f = np.zeros((n, n)), np.zeros(n)
    for e in range(elements):
        at = slice(2 * e, 2 * e + 4)
        K[at, at] += local
        f[at] += force
    E = np.zeros((1, n))
    E[0, n - 2] = 1.0
    gap = 0.5 * pressure * length**4 / (8 * bending)
    return cq.ContactProblem(stiffness=K[2:, 2:], load=f[2:], normal=E[:, 2:], gap=[gap])


CANTILEVER_FORCE = 3.0 * (1 / 8 - 1 / 16)


def block_between(columns: int = 4, rows: int = 3, contrast: float = 1.0, seed: int = 0) -> cq.ContactProblem:
    """A floating 2D spring lattice pressed onto a floor that its lowest nodes touch or nearly touch."""
    random = np.random.default_rng(seed)
    nodes = np.array([(i, j) for j in range(rows) for i in range(columns)], dtype=float)
    n = 2 * len(nodes)
    K = np.zeros((n, n))
    for a in range(len(nodes)):
        for b in range(a):
            d = nodes[a] - nodes[b]
            if np.dot(d, d) < 2.5:
                k = contrast ** random.uniform(-0.5, 0.5)
                t = np.concatenate([d, -d]) / np.linalg.norm(d)
                at = [2 * a, 2 * a + 1, 2 * b, 2 * b + 1]
                K[np.ix_(at, at)] += k * np.outer(t, t)
    f = np.zeros(n)
    f[1::2] = -random.uniform(0.5, 1.5, len(nodes))
    E = np.zeros((columns, n))
    E[np.arange(columns), 2 * np.arange(columns) + 1] = -1.0
    return cq.ContactProblem(stiffness=K, load=f, normal=E, gap=random.uniform(0, 1e-2, columns))


def seeded_problem(seed: int, n: int = 8, m: int = 5, rigid: int = 0) -> cq.ContactProblem:
    """Random positive (semi)definite stiffness; with `rigid` > 0 contacts hold the motions that the load drives."""
    random = np.random.default_rng(seed)
    B = random.standard_normal((n, n - rigid))
    K: NDArray[np.float64] = B @ B.T
    E = random.standard_normal((m, n))
    force = random.uniform(0.5, 2.0, m)
    displacement = random.standard_normal(n)
    closed = random.random(m) < 0.6
    closed[: rigid + 1] = True
    gap = E @ displacement + np.where(closed, 0.0, random.uniform(0.1, 1.0, m))
    load = K @ displacement + E.T @ np.where(closed, force, 0.0)
    return cq.ContactProblem(stiffness=K, load=load, normal=E, gap=gap)
