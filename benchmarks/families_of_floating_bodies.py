"""Bodies that float: held by contact, by ties, or by nothing."""

from __future__ import annotations

import numpy as np

from benchmarks.bricks import (
    Array,
    Generator,
    blocks,
    chain,
    few_bits,
    free_response,
    lattice,
    light,
    magnitudes,
    squeeze,
    units,
)
from benchmarks.family_register import member
from contactqp import ContactProblem


def free_stack(rng: Generator, contrast: float) -> tuple[Array, Array, Array, Array]:
    """Free chains in a row before a wall: the load of each body, and so of all behind a contact, is towards the wall.

    Each is squeezed besides, by loads up to 1e6 times those that press the stack together.
    """
    sizes = rng.integers(1, 7, int(rng.integers(1, 5)))
    parts = [chain(magnitudes(rng, 0, contrast, s), False) * magnitudes(rng, 0, contrast / 4) for s in sizes]
    K, lengths = blocks(*parts), sizes + 1
    n = len(K)
    last = np.cumsum(lengths) - 1
    first = last - lengths + 1
    f = few_bits(rng.normal(size=n), 6)
    hardest = rng.uniform(0, 6)
    for a, b in zip(first, last, strict=True):
        f[b] += few_bits(abs(np.sum(f[a : b + 1])) * 2 + 0.5, 6)
        f[a : b + 1] += squeeze(rng, int(b - a + 1), 0, hardest)
    E = units(n, last)
    E[np.arange(len(first) - 1), first[1:]] = -1.0
    return K, f, E, few_bits(rng.uniform(0, 1, len(last)) * 10 ** rng.uniform(-6, 1))


@member(well_posed=True)
def floating_stack(rng: Generator) -> ContactProblem:
    """Bodies held by contact alone, pushed one against the next and against a wall; contrast to 1e9."""
    return ContactProblem(*free_stack(rng, rng.uniform(0, 7)))


@member(well_posed=True)
def floating_between_springs(rng: Generator) -> ContactProblem:
    """A free body between two grounded chains, squeezed, and pressed lightly to one of them."""
    sizes = rng.integers(1, 8, 3)
    left, right = (chain(magnitudes(rng, 0, 9, sizes[i]) * magnitudes(rng, 0, 3), True) for i in (0, 2))
    K = blocks(left, chain(magnitudes(rng, 0, 9, sizes[1]), False), right)
    n, a = len(K), int(sizes[0])
    b = a + int(sizes[1])
    f = few_bits(rng.normal(size=n), 8)
    f[a : b + 1] += squeeze(rng, b - a + 1)
    E = np.zeros((2, n))
    E[0, [a - 1, a]], E[1, [b, n - 1]] = (1, -1), (1, -1)
    return ContactProblem(K, f, E, magnitudes(rng, -6, 1, 2))


@member(well_posed=True)
def floating_undriven(rng: Generator) -> ContactProblem:
    """Free chains, loads in balance (exactly), wide gaps to walls, cracks that close lightly."""
    parts = [chain(magnitudes(rng, 0, 6, int(rng.integers(2, 7))), False) for _ in range(int(rng.integers(1, 4)))]
    K, f = blocks(*parts), []
    for part in parts:
        own = np.round(rng.normal(size=len(part)) * 32) / 32
        own[-1] -= np.sum(own)
        f.append(own)
    ends, load = np.cumsum([len(p) for p in parts]) - 1, np.concatenate(f)
    start = int(ends[0]) + 1 - len(parts[0])
    cracks = units(len(K), [start, start + 1]) - units(len(K), [start + 1, start])
    free = free_response(K[1:, 1:], load[1:])
    approach = cracks @ np.append(0.0, free)
    gap = np.where(approach > 0, light(rng, 2) * approach, 0.0 + abs(approach))
    E = np.vstack([units(len(K), ends), units(len(K), ends, -1.0), cracks])
    return ContactProblem(K, load, E, np.append(magnitudes(rng, -1, 2, 2 * len(ends)), gap))


def block_on_floor(rng: Generator, corner: bool) -> ContactProblem:
    """A free lattice under loads that press it to a floor below all of them, and to a wall beside all of them.

    A rigid motion that the floor allows lifts every point between its outer contacts, so no load gains from it; so does
    the wall. Without the wall there are no sideways loads and the block is free to slide.
    """
    wide, high = int(rng.integers(2, 5)), int(rng.integers(2, 4))
    K = lattice(rng, wide, high, rng.uniform(0, 7))
    f = np.zeros(len(K))
    f[[2 * (x + wide * (high - 1)) + 1 for x in range(wide)]] = -few_bits(rng.uniform(0, 1, wide), 6)
    E = units(len(K), [2 * x + 1 for x in range(wide)], -1.0)
    for y in range(high):  # sideways and opposite at one height: neither force nor moment
        f[[2 * (x + wide * y) for x in range(wide)]] = squeeze(rng, wide, 0, 5)
    if corner:
        f[[2 * (wide - 1 + wide * y) for y in range(high)]] -= few_bits(rng.uniform(0.1, 1, high), 6)
        E = np.vstack([E, units(len(K), [2 * wide * y for y in range(high)], -1.0)])
    gap = few_bits(rng.uniform(0, 1, len(E)) * 10 ** rng.uniform(-9, 0))
    return ContactProblem(K, f, E, gap)


@member(well_posed=True)
def lattice_free_to_slide(rng: Generator) -> ContactProblem:
    """A free lattice pressed on a floor, sideways motion undriven; the loads lie between the outer contacts."""
    return block_on_floor(rng, False)


@member(well_posed=True)
def lattice_in_corner(rng: Generator) -> ContactProblem:
    """A free lattice pressed into a corner of floor and wall; the loads lie between the outer contacts of both."""
    return block_on_floor(rng, True)


@member(well_posed=True)
def lifted_off_spring(rng: Generator) -> ContactProblem:
    """A heavy free body over a stiff spring, small load, wide gap: a small residual, no force, and all is wrong."""
    spring, gap, load = magnitudes(rng, 6, 12), magnitudes(rng, -2, 2), magnitudes(rng, -1, 3)
    body = chain(magnitudes(rng, 0, 6, int(rng.integers(1, 5))) * spring / 64, False)
    K = blocks(np.array([[float(spring)]]), body)
    f = np.zeros(len(K))
    f[-1] = -load
    E = np.zeros((1, len(K)))
    E[0, 0], E[0, 1] = 1.0, -1.0
    return ContactProblem(K, f, E, [float(gap)])
