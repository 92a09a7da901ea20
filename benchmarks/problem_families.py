"""Seeded families of contact problems that methods get wrong.

`family(name, seed)` gives the same problem every time. Numbers are floats and mean what they say: a floating body's
stiffness is singular exactly, not to rounding, because its springs have so few bits that their sums are exact. That
every problem has (or has not) a solution is by construction; each maker says how.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from bricks import (
    Array,
    Generator,
    beam,
    blocks,
    chain,
    fair_gaps,
    few_bits,
    free_response,
    in_units,
    lattice,
    light,
    magnitudes,
    squeeze,
    units,
    with_rows,
)

from contactqp import ContactProblem


@dataclass(frozen=True)
class Family:
    """One named family; `well_posed`: a unique answer that rounding of the data does not decide."""

    name: str
    make: Callable[[Generator], ContactProblem] = field(repr=False)
    well_posed: bool
    solvable: bool = True

    @property
    def about(self) -> str:
        """The first line of the maker's docstring."""
        return (self.make.__doc__ or "").strip().split("\n")[0]


FAMILIES: dict[str, Family] = {}


def family(name: str, seed: int) -> ContactProblem:
    """The problem of a family with that seed."""
    rng = np.random.default_rng([zlib.crc32(name.encode()), seed])
    return FAMILIES[name].make(rng)


def _in(well_posed: bool, solvable: bool = True) -> Callable[[Callable[[Generator], ContactProblem]], Callable]:
    def register(make: Callable[[Generator], ContactProblem]) -> Callable[[Generator], ContactProblem]:
        name = make.__name__
        FAMILIES[name] = Family(name, make, well_posed, solvable)
        return make

    return register


# ------------------------------------------------------------------------------- stiffness contrast


@_in(well_posed=True)
def chain_walls(rng: Generator) -> ContactProblem:
    """Grounded chain, contrast to 1e12, walls on both sides; gaps are not negative, so rest is feasible."""
    n = int(rng.integers(3, 25))
    K = chain(magnitudes(rng, 0, rng.uniform(0, 12), n), True)
    f = rng.normal(size=n) * 10 ** rng.uniform(-3, 3)
    at = rng.choice(n, min(n, int(rng.integers(1, 12))), replace=False)
    E = units(n, at, rng.choice([-1.0, 1.0], len(at)))
    return ContactProblem(K, f, E, fair_gaps(rng, K, f, E))


@_in(well_posed=True)
def chain_between(rng: Generator) -> ContactProblem:
    """Grounded chains of stiffnesses 1 to 1e12 pushed into each other; gaps are not negative."""
    sizes = rng.integers(2, 9, int(rng.integers(2, 5)))
    parts = [chain(magnitudes(rng, 0, 2, s) * magnitudes(rng, 0, 10), True) for s in sizes]
    K, ends = blocks(*parts), np.cumsum(sizes) - 1
    n = len(K)
    E = units(n, ends[:-1]) - units(n, ends[1:])
    f = rng.normal(size=n) * np.repeat([10 ** rng.uniform(-2, 2) for _ in sizes], sizes)
    return ContactProblem(K, f, E, fair_gaps(rng, K, f, E))


@_in(well_posed=True)
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


@_in(well_posed=True)
def soft_support(rng: Generator) -> ContactProblem:
    """A stiff chain on one soft spring (contrast 1e4 to 1e12): nearly floating; walls on one side, gaps >= 0."""
    n = int(rng.integers(2, 12))
    K = chain(np.append(1.0, magnitudes(rng, 4, 11) * magnitudes(rng, 0, 1, n - 1)), True)
    f = rng.normal(size=n) + 1.0 + squeeze(rng, n)
    at = rng.choice(n, int(rng.integers(1, n + 1)), replace=False)
    E = units(n, at)
    gap = light(rng, len(at)) * np.abs(np.sum(f)) * 10 ** rng.choice([0, rng.uniform(-3, 0.3)])
    return ContactProblem(K, f, E, gap)


# ------------------------------------------------------------------------------------------- bodies


@_in(well_posed=True)
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


@_in(well_posed=True)
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


@_in(well_posed=True)
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


# ------------------------------------------------------------------------------------ floating bodies


def _stack(rng: Generator, contrast: float) -> tuple[Array, Array, Array, Array]:
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


@_in(well_posed=True)
def floating_stack(rng: Generator) -> ContactProblem:
    """Bodies held by contact alone, pushed one against the next and against a wall; contrast to 1e9."""
    return ContactProblem(*_stack(rng, rng.uniform(0, 7)))


@_in(well_posed=True)
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


@_in(well_posed=True)
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


def _block_on_floor(rng: Generator, corner: bool) -> ContactProblem:
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


@_in(well_posed=True)
def lattice_free_to_slide(rng: Generator) -> ContactProblem:
    """A free lattice pressed on a floor, sideways motion undriven; the loads lie between the outer contacts."""
    return _block_on_floor(rng, False)


@_in(well_posed=True)
def lattice_in_corner(rng: Generator) -> ContactProblem:
    """A free lattice pressed into a corner of floor and wall; the loads lie between the outer contacts of both."""
    return _block_on_floor(rng, True)


@_in(well_posed=True)
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


# ----------------------------------------------------------------------------------- redundant contacts


@_in(well_posed=True)
def duplicated_rows(rng: Generator) -> ContactProblem:
    """Chains with contacts stated twice or three times, some rescaled by powers of two: forces are not unique."""
    base = chain_walls(rng)
    rows, gaps = base.normal.toarray(), np.asarray(base.gap)
    again = rng.integers(0, len(rows), int(rng.integers(1, len(rows) + 3)))
    factor = 2.0 ** rng.integers(-13, 14, len(again)) * rng.integers(0, 2, len(again))
    factor = np.where(factor > 0, factor, 1.0)
    return with_rows(base, rows[again] * factor[:, None], gaps[again] * factor)


@_in(well_posed=True)
def summed_rows(rng: Generator) -> ContactProblem:
    """A free stack whose further contacts are sums of its own (gaps too, exactly): dependent where all are closed."""
    K, f, E, g = _stack(rng, rng.uniform(0, 4))
    count = int(rng.integers(1, 4))
    weights = rng.integers(0, 3, (count, len(E))).astype(float)
    weights[:, -1] += 1
    g = np.round(g * 2**20) / 2**20
    return ContactProblem(K, f, np.vstack([E, weights @ E]), np.append(g, weights @ g))


@_in(well_posed=True)
def more_contacts_than_unknowns(rng: Generator) -> ContactProblem:
    """Two to five unknowns in a polytope of 6 to 15 random walls around rest."""
    n, m = int(rng.integers(2, 6)), int(rng.integers(6, 16))
    K = chain(magnitudes(rng, 0, rng.uniform(0, 10), n), True)
    E = rng.normal(size=(m, n))
    f = rng.normal(size=n) * np.sqrt(np.diag(K))
    return ContactProblem(K, f, E, fair_gaps(rng, K, f, E))


@_in(well_posed=False)
def nearly_redundant(rng: Generator) -> ContactProblem:
    """Pairs of contacts whose rows differ by an angle of 1e-2 to 1e-12; gaps are not negative."""
    base = more_contacts_than_unknowns(rng)
    rows, gaps = base.normal.toarray(), np.asarray(base.gap)
    chosen = rng.choice(len(rows), 3, replace=False)
    angle = 10.0 ** rng.uniform(-12, -2, (3, 1))
    near = rows[chosen] + angle * rng.normal(size=(3, rows.shape[1]))
    return with_rows(base, near, gaps[chosen] * (1 + angle[:, 0] * rng.normal(size=3) * rng.integers(0, 2, 3)))


# ------------------------------------------------------------------------------------------- grazing


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


@_in(well_posed=True)
def exactly_grazing(rng: Generator) -> ContactProblem:
    """A manufactured solution: all contacts closed, two of them without force, exactly."""
    K, f, E, g, _ = _manufactured(rng, rng.uniform(0, 8))
    return ContactProblem(K, f, E, g)


@_in(well_posed=False)
def nearly_grazing(rng: Generator) -> ContactProblem:
    """The same with the gaps of the two idle contacts off by 0, 1e-15 to 1e-6 of their size, either way."""
    K, f, E, g, m = _manufactured(rng, rng.uniform(0, 8))
    delta = rng.choice([0.0, *(s * 10.0**-e for e in range(6, 16) for s in (-1, 1))], 2)
    g[m - 2 :] *= 1 + delta
    return ContactProblem(K, f, E, g)


@_in(well_posed=False)
def single_grazing(rng: Generator) -> ContactProblem:
    """A single contact whose gap is the free displacement to 1e-6 to 1e-15; gaps are not negative."""
    n = int(rng.integers(3, 10))
    K = chain(magnitudes(rng, 0, rng.uniform(0, 10), n), True)
    f = rng.normal(size=n)
    j = int(rng.integers(0, n))
    reach = free_response(K, f)[j]
    gap = abs(reach) * (1 + rng.choice([-1, 1]) * 10 ** rng.uniform(-15, -6))
    return ContactProblem(K, f, units(n, [j], np.sign(reach) or 1.0), [gap])


# --------------------------------------------------------------------------------------- gaps and loads


@_in(well_posed=True)
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


@_in(well_posed=True)
def tiny_load_wide_gap(rng: Generator) -> ContactProblem:
    """Free bodies pushed over gaps whose stiffness times gap is 1e3 to 1e12 of the load; loads are towards the wall."""
    K, f, E, g = _stack(rng, rng.uniform(0, 3))
    return ContactProblem(K * float(magnitudes(rng, 3, 6)), f, E, (g + 2.0**-6) * float(magnitudes(rng, 0, 3)))


@_in(well_posed=True)
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


# ------------------------------------------------------------------------------------------------ units

# (length, force) of one metre and one newton in the unit systems of practice.
UNIT_SYSTEMS = {
    "m, N": (1.0, 1.0),
    "mm, N": (1e3, 1.0),
    "mm, kN": (1e3, 1e-3),
    "m, kN": (1.0, 1e-3),
    "um, MN": (1e6, 1e-6),
}


@_in(well_posed=True)
def unit_systems(rng: Generator) -> ContactProblem:
    """Bars of 1e5 to 1e10 N/m, loads of 0.1 to 100 kN, gaps a part of the approach, in five unit systems."""
    n = int(rng.integers(3, 20))
    K = chain(10 ** rng.uniform(5, 10, n), True)
    f = rng.normal(size=n) * 10 ** rng.uniform(2, 5)
    at = rng.choice(n, min(n, int(rng.integers(1, 9))), replace=False)
    E = units(n, at, rng.choice([-1.0, 1.0], len(at)))
    return in_units(ContactProblem(K, f, E, fair_gaps(rng, K, f, E)), *UNIT_SYSTEMS[rng.choice(list(UNIT_SYSTEMS))])


@_in(well_posed=True)
def floating_unit_systems(rng: Generator) -> ContactProblem:
    """Free stacks in units that differ by powers of two near 1e3 and 1e6, so that they stay free exactly."""
    length, force = 2.0 ** rng.choice([0, 10, 20, -10]), 2.0 ** rng.choice([0, -10, -20, 10])
    return in_units(ContactProblem(*_stack(rng, rng.uniform(0, 6))), length, force)


@_in(well_posed=True)
def badly_scaled(rng: Generator) -> ContactProblem:
    """Single unknowns scaled by 1e-6 to 1e6 and rows by 1e-4 to 1e4: chains, beams, lattices, free stacks."""
    makers = (chain_walls, beam_stops, lattice_on_floor, floating_stack, chain_between)
    base = makers[int(rng.integers(0, len(makers)))](rng)
    D = 2.0 ** rng.integers(-20, 21, base.dimension)
    r = 2.0 ** rng.integers(-13, 14, base.contacts)
    K = np.asarray(base.stiffness) * np.outer(D, D)
    return ContactProblem(K, base.load * D, base.normal.toarray() * np.outer(r, D), base.gap * r)


# ------------------------------------------------------------------------------------------------- ties


@_in(well_posed=True)
def tied_chains(rng: Generator) -> ContactProblem:
    """Grounded chains with multi-point constraints, contrast to 1e9; ties and gaps hold at a chosen displacement."""
    n = int(rng.integers(6, 20))
    K = chain(magnitudes(rng, 0, rng.uniform(0, 9), n), True)
    k = int(rng.integers(1, 4))
    A = np.round(rng.normal(size=(k, n)) * 8) / 8 * (rng.random((k, n)) < 4 / n)
    A[np.arange(k), np.arange(k)] = 1.0
    start = np.round(rng.normal(size=n) * 16) / 16
    at = rng.choice(n, int(rng.integers(1, 7)), replace=False)
    E = units(n, at, rng.choice([-1.0, 1.0], len(at)))
    load = rng.normal(size=n) * 10 ** rng.uniform(0, 4)
    # The response of the tied bodies: from the chosen displacement along motions that the ties leave free.
    free = np.linalg.svd(A)[2][k:].T
    u = start + free @ free_response(free.T @ K @ free, free.T @ (load - K @ start))
    room = E @ (u - start)
    gap = E @ start + np.where(room > 0, light(rng, len(at)) * room, rng.uniform(0, 1, len(at)) * abs(room))
    return ContactProblem(K, load, E, gap, tie=A, tie_value=A @ start)


@_in(well_posed=True)
def held_by_ties(rng: Generator) -> ContactProblem:
    """Free chains whose only supports are tie rows at one end (some stated twice); walls before the other ends."""
    sizes = rng.integers(2, 8, int(rng.integers(1, 4)))
    K = blocks(*(chain(magnitudes(rng, 0, 8, s), False) for s in sizes))
    n, last = len(K), np.cumsum(sizes + 1) - 1
    A = units(n, last - sizes)
    if rng.random() < 0.4:
        A = np.vstack([A, 2.0 * A[:1]])
    f = few_bits(rng.normal(size=n), 8)
    E = units(n, last)
    held = np.setdiff1d(np.arange(n), last - sizes)
    gap = fair_gaps(rng, K[np.ix_(held, held)], f[held], E[:, held])
    return ContactProblem(K, f, E, gap, tie=A)


# ------------------------------------------------------------------------------------------ no solution


@_in(well_posed=False, solvable=False)
def conflicting_walls(rng: Generator) -> ContactProblem:
    """Two walls that leave an unknown no room, by 1e-7 to 1 of their distance to rest."""
    base = chain_walls(rng)
    j, at = int(rng.integers(0, base.dimension)), float(rng.normal())
    overlap_ = abs(at) * 10 ** rng.uniform(-7, 0)
    return with_rows(base, units(base.dimension, [j, j], [1.0, -1.0]), np.array([at, -at - overlap_]))


@_in(well_posed=False, solvable=False)
def driven_away(rng: Generator) -> ContactProblem:
    """A free stack whose last body is pulled off all the others: the load drives a motion that no contact resists."""
    K, f, E, g = _stack(rng, rng.uniform(0, 5))
    return ContactProblem(K, -f, E, g)


@_in(well_posed=False, solvable=False)
def weakly_driven_away(rng: Generator) -> ContactProblem:
    """A free lattice on a floor with a sideways load of 1e-6 to 1 of the others: nothing holds it back."""
    base = _block_on_floor(rng, False)
    f = np.array(base.load)
    f[0] = np.max(abs(f)) * 2.0 ** -int(rng.integers(0, 20))
    return base.replace(load=f)
