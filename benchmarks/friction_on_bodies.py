"""Frictional problems on bodies: answers that decay over many orders, and free bodies that only move.

In numbers of order one; `friction_families` gives them other units. The stiffness of the first two is regular and rest
is admissible, so that an equilibrium exists (Andersson and Klarbring 2001, every coefficient of friction); the other
three are made around an answer in so few bits that it is exact.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space
from scipy.sparse.csgraph import connected_components

import contactqp as cq
from benchmarks.bricks import blocks
from benchmarks.families_of_printing import print_and_read
from benchmarks.families_of_stacks import spring_block

Array = NDArray[np.float64]
Generator = np.random.Generator
COEFFICIENTS = (0.125, 0.25, 0.75, 1.0, 1.5)


def _grid(*sides: int) -> Array:
    return np.array(list(product(*map(range, sides))), dtype=float)


def _axes(rng: Generator, nodes: Array, size: int, dimension: int) -> tuple[Array, Array]:
    """Normal rows (m, size) along plus or minus an axis and tangential rows ((d - 1) m, size) along the others."""
    normal, tangent = [], []
    for node in nodes:
        frame = np.eye(dimension)[rng.permutation(dimension)]
        frame[0] *= rng.choice([-1.0, 1.0])
        rows = np.zeros((dimension, size))
        rows[:, dimension * node : dimension * (node + 1)] = frame
        normal.append(rows[:1])
        tangent.append(rows[1:])
    return np.vstack(normal), np.vstack(tangent)


def _bed(rng: Generator, dimension: int, stiffer: float) -> tuple[Array, int]:
    """A column of a lattice whose nodes stand on springs in all directions, and how many nodes it has."""
    nodes = _grid(int(rng.integers(6, 13)) if dimension == 2 else 5, *[2] * (dimension - 1))
    K = spring_block(rng, nodes, 0.25)
    return K + np.diag(stiffer * 10 ** rng.uniform(0, 1, len(K))), len(nodes)


def bedded(rng: Generator, dimension: int) -> cq.ContactProblem:
    """A column in a stiff bed, loaded at one end; rough stops there and where next to nothing arrives."""
    K, count = _bed(rng, dimension, 10 ** rng.uniform(0.5, 3))
    return _loaded_at_one_end(rng, K, count, dimension, 0.3)


def decaying_path(rng: Generator, dimension: int) -> cq.ContactProblem:
    """A step of a struck column, M / dt^2 + K, stops in touch from the start: its load may be as small as any."""
    K, count = _bed(rng, dimension, 1.0)
    K += np.diag(np.full(len(K), 10 ** rng.uniform(0, 2)))
    return _loaded_at_one_end(rng, K, count, dimension, 0.0)


def _loaded_at_one_end(rng: Generator, K: Array, count: int, dimension: int, room: float) -> cq.ContactProblem:
    f = np.zeros(len(K))
    f[: dimension * 2] = rng.normal(size=2 * dimension)
    m, width = int(rng.integers(2, 4)), 2 ** (dimension - 1)
    nodes = np.append(rng.integers(0, width), rng.choice(np.arange(width, count), m - 1, replace=False))
    normal, tangent = _axes(rng, nodes, len(K), dimension)
    free = np.linalg.solve(K, f)
    normal[0] *= np.sign(normal[0] @ free)
    gap = np.abs(normal @ free) * room * rng.integers(0, 2, m)
    if m == 3 and rng.random() < 0.5:
        gap[-1] = 2.0 ** float(rng.integers(-10, 11))
    origin = np.zeros((m, dimension - 1))
    tie = None
    if rng.random() < 0.3:  # two nodes in the middle that move as one
        one, other = dimension * (count // 2), dimension * (count // 2 - 1)
        tie = (np.eye(len(K))[one] - np.eye(len(K))[other])[None]
    return cq.ContactProblem(
        stiffness=K, load=f, normal=normal, gap=gap, tangent=tangent, friction=rng.choice(COEFFICIENTS, m),
        slip_origin=origin, tie=tie,
    )  # fmt: skip


def _around(
    rng: Generator, dimension: int, overlaps: bool, strain: float, at_loads: bool, bits: int = 6
) -> cq.ContactProblem:
    """One or two free blocks that have moved to where they lie, each contact open, sticking or slipping along an axis.

    With `at_loads` every load acts at a contact. With `overlaps` the gaps that close are negative. Springs have so many
    `bits`; with more than a few the answer is exact only where there is no strain.
    """
    d = dimension
    bodies = int(rng.integers(1, 3)) if d == 2 else 1
    grids = [_grid(int(rng.integers(2, 4)) if d == 2 else 2, *[2] * (d - 1)) for _ in range(bodies)]
    K = blocks(*(spring_block(rng, nodes, 2.0 ** float(rng.integers(-1, 3)), bits) for nodes in grids))
    motion = []
    for nodes in grids:
        turn = np.triu(rng.integers(-4, 5, (d, d)), 1) / 8 * float(rng.integers(0, 2))
        motion.append((rng.integers(-16, 17, d) / 16 + nodes @ (turn - turn.T)).ravel())
    rigid, n = np.concatenate(motion), len(K)
    strained = strain * np.round(rng.normal(size=n) * 8) / 8
    u = rigid + strained
    m = int(rng.integers(1, 4 if d == 2 else 6))
    normal, tangent = _axes(rng, rng.choice(n // d, min(m, n // d), replace=False), n, d)
    m = len(normal)
    if overlaps:
        normal *= np.where(normal @ u > 0, -1.0, 1.0)[:, None]
    closed, slips = rng.random(m) < 0.75, rng.random(m) < 0.5
    closed[0] = True
    mu = rng.choice(COEFFICIENTS, m)
    size = strain if strain > 0 else 2.0 ** float(rng.integers(-12, 1))
    pressed = np.where(closed, size * rng.integers(4, 17, m) / 8, 0.0)
    direction = np.eye(d - 1)[rng.integers(0, d - 1, m)] * rng.choice([-1.0, 1.0], m)[:, None]
    rubbed = (mu * pressed * np.where(slips, 1.0, rng.integers(-7, 8, m) / 8))[:, None] * direction
    moved = np.where(slips | ~closed, 0.5, 0.0)[:, None] * direction
    load = K @ strained + normal.T @ pressed + tangent.T @ rubbed.ravel()
    tie, value = None, None
    if rng.random() < 0.3:
        tie = np.eye(n)[[int(rng.integers(0, n))]]
        value = tie @ u
        load = load + (0.0 if at_loads else size * float(rng.integers(-2, 3))) * tie[0]
    return cq.ContactProblem(
        stiffness=K, load=load, normal=normal, gap=normal @ u + np.where(closed, 0.0, 0.375), tangent=tangent,
        friction=mu, slip_origin=(tangent @ u).reshape(m, d - 1) - moved, tie=tie, tie_value=value,
    )  # fmt: skip


def pushed_rigidly(rng: Generator, dimension: int) -> cq.ContactProblem:
    """Free blocks moved onto rough supports under their loads: no strain."""
    return _around(rng, dimension, overlaps=False, strain=0.0, at_loads=True)


def unstrained(rng: Generator, dimension: int) -> cq.ContactProblem:
    """Free blocks brought to rest by a motion whose strain is 1e-9 to 1e-2 of it, or nothing."""
    strain = float(rng.integers(0, 2)) * 2.0 ** float(rng.integers(-30, -6))
    return _around(rng, dimension, overlaps=False, strain=strain, at_loads=False)


def interference_removed(rng: Generator, dimension: int) -> cq.ContactProblem:
    """Free blocks that overlap rough obstacles at the start and are shifted off them."""
    return _around(rng, dimension, overlaps=True, strain=0.0, at_loads=False)


def stack_free_to_slide(rng: Generator, dimension: int) -> cq.ContactProblem:
    """Free blocks on a rough floor and on each other, their stiffnesses up to 1e10 apart: made around an answer."""
    d, count = dimension, int(rng.integers(2, 4)) if dimension == 2 else 2
    nodes = _grid(*[2] * d)
    sizes = 2.0 ** rng.permutation(np.append([0, rng.integers(0, 34)], rng.integers(0, 34, count - 2)))
    K = blocks(*(spring_block(rng, nodes, size) for size in sizes))
    n, each = len(K), d * len(nodes)
    rigid = np.concatenate([np.tile(rng.integers(-16, 17, d) / 16, len(nodes)) for _ in sizes])
    u = rigid + rng.integers(-8, 9, n) / 64 / np.repeat(sizes, each)
    low = np.flatnonzero(nodes[:, -1] == 0)
    normal, tangent = [], []
    for block in range(count):
        node = int(rng.choice(low))
        mine = np.eye(n)[block * each + d * node + np.arange(d)]
        under = np.eye(n)[(block - 1) * each + d * (node + 1) + np.arange(d)] if block else np.zeros((d, n))
        normal.append(under[-1:] - mine[-1:])
        tangent.append(mine[:-1] - under[:-1])
    normal, tangent = np.vstack(normal), np.vstack(tangent)
    slips, mu = rng.random(count) < 0.5, rng.choice(COEFFICIENTS, count)
    pressed = rng.integers(4, 17, count) / 8
    direction = np.eye(d - 1)[rng.integers(0, d - 1, count)] * rng.choice([-1.0, 1.0], count)[:, None]
    rubbed = (mu * pressed * np.where(slips, 1.0, rng.integers(-7, 8, count) / 8))[:, None] * direction
    moved = np.where(slips, 0.5, 0.0)[:, None] * direction
    load = K @ (u - rigid) + normal.T @ pressed + tangent.T @ rubbed.ravel()
    return cq.ContactProblem(
        stiffness=K, load=load, normal=normal, gap=normal @ u, tangent=tangent, friction=mu,
        slip_origin=(tangent @ u).reshape(count, d - 1) - moved,
    )  # fmt: skip


# Of the largest singular value, what a spring block's rigid motions have.
FREE = 1e-9
# Of the largest energy along rigid motions, the negative one from which lost digits are no springs.
DRIVES = 1e-2


def printed_floating(rng: Generator, dimension: int) -> cq.ContactProblem:
    """Free blocks moved onto rough supports under their loads, their stiffness printed with 6 to 12 digits.

    Supports that slip hold no turn: what resists it would be the digits, so that rigid motions are stated. Digits that
    happen to hold a body as soft springs would are drawn again: they state another problem.
    """
    while True:
        posed = _around(rng, dimension, overlaps=False, strain=0.0, at_loads=True, bits=53)
        K = posed.stiffness_rows.toarray()
        printed = print_and_read(K, int(rng.integers(6, 13)))
        motions = null_space(K, rcond=FREE)
        if not _holds_a_body(printed, K != 0, motions):
            return posed.replace(stiffness=printed, near_null_space=motions)


def _holds_a_body(printed: Array, coupled: Array, motions: Array) -> bool:
    """Whether printed digits resist every rigid motion of some body, as springs on it would."""
    count, body = connected_components(coupled)
    for members in (body == one for one in range(count)):
        basis, values, _ = np.linalg.svd(motions[members], full_matrices=False)
        rigid = basis[:, values > FREE]
        energies = np.linalg.eigvalsh(rigid.T @ printed[np.ix_(members, members)] @ rigid)
        if energies[0] > -DRIVES * energies[-1]:
            return True
    return False


MAKERS: dict[str, Callable[[Generator, int], cq.ContactProblem]] = {
    maker.__name__: maker
    for maker in (
        bedded,
        decaying_path,
        pushed_rigidly,
        unstrained,
        interference_removed,
        stack_free_to_slide,
        printed_floating,
    )
}
