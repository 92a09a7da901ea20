"""Redundant and grazing contacts, gaps and loads of every size."""

from __future__ import annotations

import numpy as np

from benchmarks.bricks import (
    Array,
    Generator,
    blocks,
    chain,
    fair_gaps,
    few_bits,
    free_response,
    light,
    magnitudes,
    units,
    with_rows,
)
from benchmarks.families_of_floating_bodies import free_stack
from benchmarks.families_of_stiffness import chain_walls
from benchmarks.family_register import member
from contactqp import ContactProblem


@member(well_posed=True)
def duplicated_rows(rng: Generator) -> ContactProblem:
    """Chains with contacts stated twice or three times, some rescaled by powers of two: forces are not unique."""
    base = chain_walls(rng)
    rows, gaps = base.normal.toarray(), np.asarray(base.gap)
    again = rng.integers(0, len(rows), int(rng.integers(1, len(rows) + 3)))
    factor = 2.0 ** rng.integers(-13, 14, len(again)) * rng.integers(0, 2, len(again))
    factor = np.where(factor > 0, factor, 1.0)
    return with_rows(base, rows[again] * factor[:, None], gaps[again] * factor)


@member(well_posed=True)
def summed_rows(rng: Generator) -> ContactProblem:
    """A free stack whose further contacts are sums of its own (gaps too, exactly): dependent where all are closed."""
    K, f, E, g = free_stack(rng, rng.uniform(0, 4))
    count = int(rng.integers(1, 4))
    weights = rng.integers(0, 3, (count, len(E))).astype(float)
    weights[:, -1] += 1
    g = np.round(g * 2**20) / 2**20
    return ContactProblem(K, f, np.vstack([E, weights @ E]), np.append(g, weights @ g))


@member(well_posed=True)
def more_contacts_than_unknowns(rng: Generator) -> ContactProblem:
    """Two to five unknowns in a polytope of 6 to 15 random walls around rest."""
    n, m = int(rng.integers(2, 6)), int(rng.integers(6, 16))
    K = chain(magnitudes(rng, 0, rng.uniform(0, 10), n), True)
    E = rng.normal(size=(m, n))
    f = rng.normal(size=n) * np.sqrt(np.diag(K))
    return ContactProblem(K, f, E, fair_gaps(rng, K, f, E))


@member(well_posed=False)
def nearly_redundant(rng: Generator) -> ContactProblem:
    """Pairs of contacts whose rows differ by an angle of 1e-2 to 1e-12; gaps are not negative."""
    base = more_contacts_than_unknowns(rng)
    rows, gaps = base.normal.toarray(), np.asarray(base.gap)
    chosen = rng.choice(len(rows), 3, replace=False)
    angle = 10.0 ** rng.uniform(-12, -2, (3, 1))
    near = rows[chosen] + angle * rng.normal(size=(3, rows.shape[1]))
    return with_rows(base, near, gaps[chosen] * (1 + angle[:, 0] * rng.normal(size=3) * rng.integers(0, 2, 3)))


def _manufactured(rng: Generator, contrast: float) -> tuple[Array, Array, Array, Array, int]:
    """A chain with a chosen solution u, l in few bits: f = K u + E'l and E u are exact. The last two contacts idle."""
    n = int(rng.integers(4, 14))
    K = chain(magnitudes(rng, 0, contrast, n), True)
    u = np.round(rng.normal(size=n) * 64) / 64
    at = rng.choice(n, int(rng.integers(3, min(n, 8) + 1)), replace=False)
    E = units(n, at, rng.choice([-1.0, 1.0], len(at)))
    force = few_bits(rng.uniform(0.1, 1, len(at)) * np.max(K.diagonal()[at]), 6)
    force[-2:] = 0.0
    return K, K @ u + E.T @ force, E, E @ u, len(at)


@member(well_posed=True)
def exactly_grazing(rng: Generator) -> ContactProblem:
    """A manufactured solution: all contacts closed, two of them without force, exactly."""
    K, f, E, g, _ = _manufactured(rng, rng.uniform(0, 8))
    return ContactProblem(K, f, E, g)


@member(well_posed=False)
def nearly_grazing(rng: Generator) -> ContactProblem:
    """The same with the gaps of the two idle contacts off by 0, 1e-15 to 1e-6 of their size, either way."""
    K, f, E, g, m = _manufactured(rng, rng.uniform(0, 8))
    delta = rng.choice([0.0, *(s * 10.0**-e for e in range(6, 16) for s in (-1, 1))], 2)
    g[m - 2 :] *= 1 + delta
    return ContactProblem(K, f, E, g)


@member(well_posed=False)
def single_grazing(rng: Generator) -> ContactProblem:
    """A single contact whose gap is the free displacement to 1e-6 to 1e-15; gaps are not negative."""
    n = int(rng.integers(3, 10))
    K = chain(magnitudes(rng, 0, rng.uniform(0, 10), n), True)
    f = rng.normal(size=n)
    j = int(rng.integers(0, n))
    reach = free_response(K, f)[j]
    gap = abs(reach) * (1 + rng.choice([-1, 1]) * 10 ** rng.uniform(-15, -6))
    return ContactProblem(K, f, units(n, [j], np.sign(reach) or 1.0), [gap])


@member(well_posed=True)
def any_gap(rng: Generator) -> ContactProblem:
    """Chains with gaps from 1e-12 to 1e3, closed, or overlapping; one wall an unknown, so they never conflict."""
    n = int(rng.integers(3, 16))
    K = chain(magnitudes(rng, 0, rng.uniform(0, 8), n), True)
    at = rng.choice(n, min(n, int(rng.integers(2, 9))), replace=False)
    E = units(n, at, rng.choice([-1.0, 1.0], len(at)))
    f = rng.normal(size=n)
    if rng.random() < 0.5:
        gap = magnitudes(rng, -12, 3, len(at)) * rng.choice([-1.0, 0.0, 1.0, 1.0], len(at))
        return ContactProblem(K, f * 10 ** rng.uniform(-6, 6), E, gap)
    size = 10 ** rng.uniform(-12, 3) / np.max(abs(E @ free_response(K, f)))
    return ContactProblem(K, f * size, E, fair_gaps(rng, K, f * size, E))


@member(well_posed=True)
def tiny_load_wide_gap(rng: Generator) -> ContactProblem:
    """Free bodies pushed over gaps whose stiffness times gap is 1e3 to 1e12 of the load; loads are towards the wall."""
    K, f, E, g = free_stack(rng, rng.uniform(0, 3))
    return ContactProblem(K * float(magnitudes(rng, 3, 6)), f, E, (g + 2.0**-6) * float(magnitudes(rng, 0, 3)))


@member(well_posed=True)
def overlap(rng: Generator) -> ContactProblem:
    """Press fits: grounded chains that overlap by 1e-12 to 1e3, without load or pulled until they nearly part."""
    sizes = rng.integers(2, 7, 2)
    K = blocks(*(chain(magnitudes(rng, 0, 9, s) * magnitudes(rng, 0, 3), True) for s in sizes))
    n = len(K)
    E = np.zeros((1, n))
    E[0, [sizes[0] - 1, n - 1]] = 1.0, 1.0
    f, gap = rng.normal(size=n), -magnitudes(rng, -12, 3, 1)
    pull = float(gap[0] / (E @ free_response(K, f))[0])
    return ContactProblem(K, f * pull * rng.choice([0.0, float(light(rng))]), E, gap)
