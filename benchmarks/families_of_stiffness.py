"""Stiffness contrast and slender bodies."""

from __future__ import annotations

import numpy as np

from benchmarks.bricks import Generator, beam, blocks, chain, fair_gaps, lattice, light, magnitudes, squeeze, units
from benchmarks.family_register import member
from contactqp import ContactProblem


@member(well_posed=True)
def chain_walls(rng: Generator) -> ContactProblem:
    """Grounded chain, contrast to 1e12, walls on both sides; gaps are not negative, so rest is feasible."""
    n = int(rng.integers(3, 25))
    K = chain(magnitudes(rng, 0, rng.uniform(0, 12), n), True)
    f = rng.normal(size=n) * 10 ** rng.uniform(-3, 3)
    at = rng.choice(n, min(n, int(rng.integers(1, 12))), replace=False)
    E = units(n, at, rng.choice([-1.0, 1.0], len(at)))
    return ContactProblem(K, f, E, fair_gaps(rng, K, f, E))


@member(well_posed=True)
def chain_between(rng: Generator) -> ContactProblem:
    """Grounded chains of stiffnesses 1 to 1e12 pushed into each other; gaps are not negative."""
    sizes = rng.integers(2, 9, int(rng.integers(2, 5)))
    parts = [chain(magnitudes(rng, 0, 2, s) * magnitudes(rng, 0, 10), True) for s in sizes]
    K, ends = blocks(*parts), np.cumsum(sizes) - 1
    n = len(K)
    E = units(n, ends[:-1]) - units(n, ends[1:])
    f = rng.normal(size=n) * np.repeat([10 ** rng.uniform(-2, 2) for _ in sizes], sizes)
    return ContactProblem(K, f, E, fair_gaps(rng, K, f, E))


@member(well_posed=True)
def random_truss(rng: Generator) -> ContactProblem:
    """Bars in random directions between random unknowns, contrast to 1e10; gaps are not negative."""
    n, bars = int(rng.integers(4, 20)), int(rng.integers(20, 45))
    B = rng.normal(size=(bars, n)) * (rng.random((bars, n)) < 4 / n)
    k = 10 ** rng.uniform(0, rng.uniform(0, 10), bars)
    K = B.T * k @ B
    K = (K + K.T) / 2 + np.diag(10 ** rng.uniform(0, 2, n))
    f = rng.normal(size=n) * np.sqrt(np.diag(K))
    E = rng.normal(size=(int(rng.integers(2, 12)), n)) * (rng.random((1, n)) < 0.5)
    E[:, 0] += 1
    return ContactProblem(K, f, E, fair_gaps(rng, K, f, E))


@member(well_posed=True)
def soft_support(rng: Generator) -> ContactProblem:
    """A stiff chain on one soft spring (contrast 1e4 to 1e12): nearly floating; walls on one side, gaps >= 0."""
    n = int(rng.integers(2, 12))
    K = chain(np.append(1.0, magnitudes(rng, 4, 11) * magnitudes(rng, 0, 1, n - 1)), True)
    f = rng.normal(size=n) + 1.0 + squeeze(rng, n)
    at = rng.choice(n, int(rng.integers(1, n + 1)), replace=False)
    E = units(n, at)
    gap = light(rng, len(at)) * np.abs(np.sum(f)) * 10 ** rng.choice([0, rng.uniform(-3, 0.3)])
    return ContactProblem(K, f, E, gap)


@member(well_posed=True)
def beam_stops(rng: Generator) -> ContactProblem:
    """A cantilever of 5 to 40 elements on several stops above and below; gaps are not negative."""
    elements = int(rng.integers(5, 41))
    K = beam(elements, 10 ** rng.uniform(-1, 2), 10 ** rng.uniform(0, 6))[2:, 2:]
    n = len(K)
    f = np.zeros(n)
    f[::2] = rng.normal(size=elements) + rng.choice([-1, 1])
    nodes = rng.choice(elements, min(elements, int(rng.integers(1, 8))), replace=False)
    E = units(n, 2 * nodes, rng.choice([-1.0, 1.0], len(nodes)))
    return ContactProblem(K, f, E, fair_gaps(rng, K, f, E))


@member(well_posed=True)
def beam_supports_as_rows(rng: Generator) -> ContactProblem:
    """A beam whose two supports are ties, stops between; rest is feasible, and the supports hold it."""
    elements = int(rng.integers(5, 21))
    K = beam(elements, 10 ** rng.uniform(-1, 1), 10 ** rng.uniform(0, 6))
    n = len(K)
    f = np.zeros(n)
    f[::2] = rng.normal(size=elements + 1) + rng.choice([-1, 1])
    A = units(n, [0, n - 2])
    held = K[np.ix_(inner := np.setdiff1d(np.arange(n), [0, n - 2]), inner)]
    nodes = 2 * rng.choice(np.arange(1, elements), min(elements - 1, int(rng.integers(1, 6))), replace=False)
    E = units(n, nodes, rng.choice([-1.0, 1.0], len(nodes)))
    return ContactProblem(K, f, E, fair_gaps(rng, held, f[inner], E[:, inner], 7), tie=A)


@member(well_posed=True)
def lattice_on_floor(rng: Generator) -> ContactProblem:
    """A plane spring lattice held at its left side over a floor, contrast to 1e8; gaps are not negative."""
    wide, high = int(rng.integers(3, 6)), int(rng.integers(2, 4))
    K = lattice(rng, wide, high, rng.uniform(0, 8))
    keep = np.array([j for j in range(len(K)) if (j // 2) % wide != 0])
    f = rng.normal(size=len(keep))
    floor = [int(np.flatnonzero(keep == 2 * x + 1)[0]) for x in range(1, wide)]
    top = [int(np.flatnonzero(keep == 2 * (x + wide * (high - 1)) + 1)[0]) for x in range(1, wide)]
    f[top] -= 3
    K = K[np.ix_(keep, keep)]
    E = units(len(keep), floor, -1.0)
    return ContactProblem(K, f, E, fair_gaps(rng, K, f, E))
