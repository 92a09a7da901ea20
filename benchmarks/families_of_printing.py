"""Floating bodies whose stiffness was printed with six to twelve digits and read again.

Every body sits in a corner: contacts that push hold each of its motions, so that the problem has an answer whatever the
digits do. Rigid motions are stated, in any order and sign of the unknowns, or are to be recognised.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.linalg import block_diag

from benchmarks.bricks import Array, Generator, beam, blocks, chain, units
from benchmarks.family_register import member
from contactqp import ContactProblem


def print_and_read(K: Array, digits: int) -> Array:
    """Every entry rounded to so many decimal digits."""
    return np.array([[float(f"{entry:.{digits - 1}e}") for entry in row] for row in K])


def _bar(rng: Generator) -> tuple[Array, Array, Array]:
    """K, rigid motions and seats of a bar, or of a beam (deflections and slopes)."""
    nodes = int(rng.integers(3, 10))
    if rng.random() < 0.5:
        return chain(rng.uniform(1, 10, nodes - 1), False), np.ones((nodes, 1)), units(nodes, [nodes - 1])
    n, places = 2 * nodes, np.arange(nodes, dtype=float)
    motions = np.zeros((n, 2))
    motions[::2, 0], motions[::2, 1], motions[1::2, 1] = 1.0, places, 1.0
    return beam(nodes - 1, nodes - 1.0, float(rng.uniform(1, 10))), motions, -units(n, [0, n - 2])


def _block(rng: Generator) -> tuple[Array, Array, Array]:
    """The same of a block of springs between nodes that lie irregularly, plane or in space."""
    d = 2 if rng.random() < 0.6 else 3
    grid = np.array(list(product(range(int(rng.integers(2, 4))), *[range(2)] * (d - 1))), dtype=float)
    places = grid + rng.uniform(-0.2, 0.2, grid.shape)
    p = len(places)
    K, motions = np.zeros((d * p, d * p)), np.tile(np.eye(d), (p, 1))
    for i, j in zip(*np.triu_indices(p, 1), strict=True):
        if np.max(abs(grid[i] - grid[j])) <= 1:
            along = (places[i] - places[j]) / np.linalg.norm(places[i] - places[j])
            row = np.zeros(d * p)
            row[d * i : d * i + d], row[d * j : d * j + d] = along, -along
            K += rng.uniform(1, 3) * np.outer(row, row)
    for a, b in zip(*np.triu_indices(d, 1), strict=True):
        turn = np.zeros((p, d))
        turn[:, a], turn[:, b] = -places[:, b], places[:, a]
        motions = np.column_stack([motions, turn.ravel()])
    return K, motions, np.vstack([_seats(places, axis, d) for axis in range(d)])


def _seats(places: Array, axis: int, d: int) -> Array:
    """Rows of d - axis nodes far apart on the low side of an axis: 3, 2 and 1 of them in space hold a body."""
    low = np.flatnonzero(places[:, axis] < 0.5)
    others = np.delete(places[low], axis, axis=1)
    chosen = [int(np.argmin(others @ np.ones(d - 1)))]
    while len(chosen) < d - axis:
        spread = [_spread(others[[*chosen, k]]) if k not in chosen else -1.0 for k in range(len(low))]
        chosen.append(int(np.argmax(spread)))
    return -units(d * len(places), d * low[chosen] + axis)


def _spread(points: Array) -> float:
    """The length or area that points span."""
    values = np.linalg.svd(points[1:] - points[0], compute_uv=False)
    return float(np.prod(values))


@member(well_posed=True)
def printed_floating(rng: Generator) -> ContactProblem:
    """Bars, beams and blocks in corners, K printed with 6 to 12 digits; motions stated or recognised, some tied."""
    bodies = [(_bar if rng.random() < 0.5 else _block)(rng) for _ in range(int(rng.integers(1, 3)))]
    length, force = 10.0 ** rng.integers(-3, 4), 10.0 ** rng.integers(-3, 10)
    stiff = blocks(*(K for K, _, _ in bodies)) * 10 ** rng.uniform(0, 1) * force / length
    E = block_diag(*(rows for *_, rows in bodies))
    motions = block_diag(*(Z for _, Z, _ in bodies))
    K = print_and_read(stiff, int(rng.integers(6, 13)))
    n = len(K)
    forces = np.max(K) * length * 10 ** rng.uniform(-6, -2) * rng.uniform(0.2, 1, len(E))
    size = length * 10 ** rng.uniform(-6, -3)
    strained = size * rng.normal(size=n)
    far = units(n, rng.permutation(n)[: int(rng.integers(0, 3))], float(rng.choice([-1.0, 1.0])))
    moved = motions @ (size * 10 ** rng.uniform(-1, 2) * rng.normal(size=motions.shape[1]))
    E, forces = np.vstack([E, far]), np.append(forces, np.zeros(len(far)))
    u = moved + strained
    gap = E @ u + np.where(forces > 0, 0.0, length * rng.uniform(0.01, 1, len(E)))
    tie, value = np.zeros((0, n)), np.zeros(0)
    if len(bodies) > 1 and rng.random() < 0.5:
        tie = units(n, [0]) - units(n, [len(bodies[0][0])])
        value = tie @ u
    load = stiff @ strained + E.T @ forces + tie.T @ (forces[:1] * rng.uniform(-0.1, 0.1, len(tie)))
    if rng.random() < 0.5:
        return ContactProblem(K, load, E, gap, tie=tie, tie_value=value)
    order, sign = rng.permutation(n), rng.choice([-1.0, 1.0], n)
    return ContactProblem(
        (K * np.outer(sign, sign))[np.ix_(order, order)],
        (load * sign)[order],
        (E * sign)[:, order],
        gap,
        tie=(tie * sign)[:, order],
        tie_value=value,
        near_null_space=(motions * sign[:, None])[order],
    )
