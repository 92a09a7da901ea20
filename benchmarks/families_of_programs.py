"""Quadratic and linear programs as such: many constraints, few of which matter, and energies that see few unknowns."""

from __future__ import annotations

import numpy as np

from benchmarks.bricks import Generator
from benchmarks.family_register import member
from contactqp import ContactProblem


def eighths(rng: Generator, *shape: int, most: int = 16) -> np.ndarray:
    """Multiples of 1/8, so that sums and products of a few stay exact."""
    return rng.integers(-most, most + 1, shape) / 8.0


@member(well_posed=True)
def redundant_polytopes(rng: Generator) -> ContactProblem:
    """The nearest point of a polytope to one outside, half of whose rows repeat others, scaled, or follow from them."""
    n = int(rng.integers(2, 7))
    rows = np.vstack([eighths(rng, 3 * n, n), np.eye(n), -np.eye(n)])
    rows = rows[np.any(rows, axis=1)]
    gap = np.sum(abs(rows), axis=1) * (1 + rng.integers(0, 5, len(rows)) / 8)
    pairs = rng.integers(0, len(rows), (len(rows), 2))
    sums = rows[pairs[:, 0]] + rows[pairs[:, 1]]
    slack = rng.choice([0.0, 0.25], len(rows))
    scale = 2.0 ** rng.integers(-3, 4, len(rows))
    E = np.vstack([rows, sums, scale[:, None] * rows])
    g = np.concatenate([gap, gap[pairs[:, 0]] + gap[pairs[:, 1]] + slack, scale * gap])
    kept = np.any(E, axis=1)
    return ContactProblem(np.eye(n), 8.0 * eighths(rng, n), E[kept], g[kept])


@member(well_posed=True)
def bounds_everywhere(rng: Generator) -> ContactProblem:
    """A string between two obstacles that may touch every node of it, pulled both ways."""
    n = int(rng.integers(8, 40))
    K = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    upper, lower = rng.integers(1, 9, n) / 64.0, rng.integers(1, 9, n) / 64.0
    return ContactProblem(K, eighths(rng, n) / 16, np.vstack([np.eye(n), -np.eye(n)]), np.concatenate([upper, lower]))


@member(well_posed=True)
def banded_inequalities(rng: Generator) -> ContactProblem:
    """The convex sequence nearest to a noisy one, every second difference a row, as LISWET of Maros and Meszaros."""
    n = int(rng.integers(6, 30))
    E = -np.diff(np.eye(n), 2, axis=0)
    t = np.linspace(-1, 1, n)
    return ContactProblem(np.eye(n), np.round(512 * t * t) / 512 + eighths(rng, n) / 16, E, np.zeros(n - 2))


@member(well_posed=True)
def optimal_control(rng: Generator) -> ContactProblem:
    """States and bounded controls in time, ties between them the law of motion, as DTOC and CONT of the collections."""
    steps, states = int(rng.integers(3, 9)), int(rng.integers(1, 4))
    A, B = np.eye(states) + eighths(rng, states, states, most=4), eighths(rng, states, 1) + 1.0
    n = steps * (states + 1)  # x_1, ..., x_T and the controls before them
    move = np.kron(np.eye(steps), np.eye(states)) - np.kron(np.eye(steps, k=-1), A)
    tie = np.hstack([move, -np.kron(np.eye(steps), B)])
    value = np.concatenate([A @ (4.0 * eighths(rng, states)), np.zeros((steps - 1) * states)])
    K = np.diag(np.concatenate([rng.integers(1, 9, steps * states) / 4.0, rng.integers(1, 5, steps) / 16.0]))
    control = np.eye(n)[steps * states :]
    most = rng.integers(1, 9, steps) / 8.0
    rows, gap = np.vstack([control, -control]), np.concatenate([most, most])
    return ContactProblem(K, np.zeros(n), rows, gap, tie=tie, tie_value=value)


@member(well_posed=False)
def linear_programs(rng: Generator) -> ContactProblem:
    """The cheapest way to carry goods from sources to sinks: K = 0, integers, vertices where many rows meet."""
    sources, sinks = int(rng.integers(2, 5)), int(rng.integers(2, 6))
    rows = np.vstack([np.kron(np.eye(sources), np.ones(sinks)), np.kron(np.ones(sources), np.eye(sinks))])
    carried = rng.integers(0, 5, sources * sinks).astype(float)
    size = sources * sinks
    cost = rng.integers(1, 20, size).astype(float)
    return ContactProblem(
        np.zeros((size, size)), -cost, -np.eye(size), np.zeros(size), tie=rows, tie_value=rows @ carried
    )


@member(well_posed=False)
def staged_programs(rng: Generator) -> ContactProblem:
    """Goods carried through stages for costs of which some are 1e-9 of the others and a few quadratic: degenerate."""
    stages, width = int(rng.integers(3, 5)), int(rng.integers(2, 4))
    size = stages * width * width
    cost = rng.integers(0, 5, size).astype(float)
    cost[rng.random(size) < 0.15] = 1e-9 * rng.integers(1, 5)
    out, into = np.kron(np.eye(width), np.ones(width)), np.kron(np.ones(width), np.eye(width))
    nothing = np.zeros((width, size))
    rows = np.vstack([np.kron(np.eye(stages), out), nothing]) - np.vstack([nothing, np.kron(np.eye(stages), into)])
    balance = np.concatenate([np.ones(width), np.zeros((stages - 1) * width), -np.ones(width)])
    stated = len(rows) - int(rng.integers(0, 2))  # the last row follows from the others
    energy = np.zeros(size)
    energy[rng.choice(size, int(rng.integers(0, 5)), replace=False)] = float(rng.choice([1.0, 2.0, 10.0]))
    unit = 2.0 ** rng.integers(-10, 11)  # of force
    return ContactProblem(
        unit * np.diag(energy),
        -unit * cost,
        -np.eye(size),
        np.zeros(size),
        tie=rows[:stated],
        tie_value=balance[:stated],
    )


@member(well_posed=False)
def paired_inequalities(rng: Generator) -> ContactProblem:
    """Equations written as two inequalities each, some of which follow from others; K sees half of the unknowns."""
    n, m = int(rng.integers(4, 12)), int(rng.integers(1, 4))
    rows = np.vstack([eighths(rng, m, n), np.eye(1, n) + np.eye(1, n, 1)])
    rows = np.vstack([rows, rows[0] + rows[-1]])
    value = rows @ rng.integers(-3, 4, n)
    seen = rng.integers(0, 2, n).astype(float)
    load = np.where(seen > 0, 4.0 * eighths(rng, n), 0.0)
    box = np.full(2 * n, 10.0)
    return ContactProblem(
        np.diag(seen),
        load,
        np.vstack([rows, -rows, np.eye(n), -np.eye(n)]),
        np.concatenate([value, -value, box]),
    )


@member(well_posed=False)
def sums_of_sizes(rng: Generator) -> ContactProblem:
    """A fit whose coefficients cost by their sizes, as the lasso: x = p - q, residuals are unknowns of their own."""
    n, fitted = int(rng.integers(2, 6)), int(rng.integers(3, 9))
    A = eighths(rng, fitted, n)
    rows = np.hstack([A, -A, -np.eye(fitted)])
    K = np.diag(np.repeat([0.0, 1.0], [2 * n, fitted]))
    price = np.repeat([-rng.integers(1, 9) / 4.0, 0.0], [2 * n, fitted])
    bounded = np.eye(2 * n, 2 * n + fitted)
    return ContactProblem(K, price, -bounded, np.zeros(2 * n), tie=rows, tie_value=4.0 * eighths(rng, fitted))


@member(well_posed=False)
def chains_without_energy(rng: Generator) -> ContactProblem:
    """Bare unknowns between bounds, each a multiple of the next, and stiff ones for the rest, as in GOULDQP2: zero."""
    n = int(rng.integers(3, 12))
    ratio = rng.integers(80, 97, n) / 8.0
    chain = np.diag(ratio)[:-1] - np.diag(ratio[1:], 1)[:-1]
    stiff = 2.0 * np.eye(n - 1) - np.eye(n - 1, k=1) - np.eye(n - 1, k=-1)
    K = np.zeros((2 * n - 1, 2 * n - 1))
    K[n:, n:] = stiff
    lower, upper = np.repeat([1.0, 0.0], [n, n - 1]), np.repeat([2.0, 1.5], [n, n - 1])
    rows = np.vstack([np.eye(2 * n - 1), -np.eye(2 * n - 1)])
    tie = np.hstack([chain, np.eye(n - 1)])
    gap = np.concatenate([upper, -lower])
    return ContactProblem(K, np.zeros(2 * n - 1), rows, gap, tie=tie, tie_value=np.zeros(n - 1))


@member(well_posed=False)
def pyramids_of_feet(rng: Generator) -> ContactProblem:
    """Forces of feet in pyramids of friction that balance a weight, some feet in the air; K sees their sum."""
    feet = int(rng.integers(2, 5))
    total = np.kron(np.ones((1, feet)), np.eye(3))
    arms = np.kron(rng.integers(-4, 5, (1, feet)) / 4.0, np.array([[0.0, 0.0, 1.0]]))
    wrench = np.vstack([total, arms])
    side = np.array([[1.0, 0.0, -0.5], [-1.0, 0.0, -0.5], [0.0, 1.0, -0.5], [0.0, -1.0, -0.5]])
    press = np.array([[0.0, 0.0, 1.0]])
    stands = rng.integers(0, 4, feet) > 0
    rows = np.vstack([np.kron(np.eye(feet), side), np.kron(np.eye(feet), press), -np.kron(np.eye(feet), press)])
    gap = np.concatenate([np.zeros(4 * feet), 16.0 * stands, np.zeros(feet)])
    wanted = np.concatenate([eighths(rng, 2), [16.0], eighths(rng, 1)])
    return ContactProblem(wrench.T @ wrench, wrench.T @ wanted, rows, gap)


@member(well_posed=False)
def separating_planes(rng: Generator) -> ContactProblem:
    """The plane between two sets of points with a price for those on the wrong side: the offset and these are bare."""
    points, n = int(rng.integers(4, 12)), int(rng.integers(2, 4))
    place = eighths(rng, points, n)
    side = np.where(np.arange(points) % 2 == 0, 1.0, -1.0)
    rows = np.hstack([side[:, None] * (place + 0.5 * side[:, None]), side[:, None], np.eye(points)])
    size = n + 1 + points
    K = np.diag(np.repeat([1.0, 0.0], [n, size - n]))
    load = np.repeat([0.0, -2.0], [n + 1, points])
    positive = np.eye(size)[n + 1 :]
    gap = np.concatenate([-np.ones(points), np.zeros(points)])
    return ContactProblem(K, load, np.vstack([-rows, -positive]), gap)
