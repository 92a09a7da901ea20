"""Blocks that lie on each other and are free to slide: their stiffnesses lie up to ten decades apart."""

from __future__ import annotations

from itertools import product

import numpy as np

from benchmarks.bricks import Array, Generator, blocks, few_bits, squeeze, units
from benchmarks.family_register import member
from contactqp import ContactProblem


def spring_block(rng: Generator, nodes: Array, size: float, bits: int = 6) -> Array:
    """K of nodes on a unit grid (p, d), joined by springs of so many bits along edges and diagonals of faces."""
    count, d = nodes.shape
    K = np.zeros((count * d, count * d))
    for i in range(count):
        for j in range(i + 1, count):
            along = nodes[j] - nodes[i]
            if np.max(abs(along)) == 1 and np.count_nonzero(along) <= 2:
                at = np.append(d * i + np.arange(d), d * j + np.arange(d))
                both = np.append(along, -along)
                K[np.ix_(at, at)] += few_bits(size * 10 ** rng.uniform(0, 1), bits) * np.outer(both, both)
    return K


@member(well_posed=True)
def stack_free_to_slide(rng: Generator) -> ContactProblem:
    """Two to four free blocks on a floor and on each other, plane or in space, stiffnesses to 1e10 apart, some tied.

    Loads press nodes down that stand in columns, so that every column can carry its own; sideways loads are opposite
    along one line of a grid. A tie joins the sideways motion of two blocks, or holds that of the lowest.
    """
    d = 2 if rng.random() < 0.7 else 3
    wide = int(rng.integers(2, 5)) if d == 2 else 2
    base = list(product(*[range(wide if axis == 0 else 2) for axis in range(d - 1)]))
    nodes = np.array([(*place, height) for height in (0, 1) for place in base], dtype=float)
    count, contrast = int(rng.integers(2, 5)), rng.uniform(0, 10)
    sizes = 10 ** rng.permutation(np.append([0.0, contrast], rng.uniform(0, contrast, count - 2)))
    K = blocks(*(spring_block(rng, nodes, size) for size in sizes))
    p, columns = d * len(nodes), len(base)
    f = np.zeros(len(K))
    for b in range(count):
        top = b * p + d * (columns + np.arange(columns))
        if b == count - 1 or rng.random() < 0.3:
            f[top + d - 1] = -few_bits(rng.uniform(0.1, 1, columns), 6)
        line = np.flatnonzero(np.all(nodes[:, 1:] == nodes[rng.integers(len(nodes)), 1:], axis=1))
        f[b * p + d * line] += squeeze(rng, len(line), -1, 2)
    low = d * np.arange(columns) + d - 1
    floor = units(len(K), low, -1.0)
    between = [units(len(K), (b - 1) * p + d * columns + low) - units(len(K), b * p + low) for b in range(1, count)]
    E = np.vstack([floor, *between])
    gap = few_bits(rng.uniform(0, 1, len(E)) * 10 ** rng.uniform(-9, 0))
    if rng.random() < 0.5:
        return ContactProblem(K, f, E, gap)
    b = int(rng.integers(0, count))
    A = units(len(K), [b * p]) - (units(len(K), [(b - 1) * p + d * columns]) if b else 0.0)
    return ContactProblem(K, f, E, gap, tie=A)
