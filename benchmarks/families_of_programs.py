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
