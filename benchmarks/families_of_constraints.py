"""Units, ties, and problems without solution."""

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
    in_units,
    light,
    magnitudes,
    units,
    with_rows,
)
from benchmarks.families_of_floating_bodies import block_on_floor, floating_stack, free_stack
from benchmarks.families_of_stiffness import beam_stops, chain_between, chain_walls, lattice_on_floor
from benchmarks.family_register import member
from contactqp import ContactProblem

# (length, force) of one metre and one newton in the unit systems of practice.
UNIT_SYSTEMS = {
    "m, N": (1.0, 1.0),
    "mm, N": (1e3, 1.0),
    "mm, kN": (1e3, 1e-3),
    "m, kN": (1.0, 1e-3),
    "um, MN": (1e6, 1e-6),
}


@member(well_posed=True)
def unit_systems(rng: Generator) -> ContactProblem:
    """Bars of 1e5 to 1e10 N/m, loads of 0.1 to 100 kN, gaps a part of the approach, in five unit systems."""
    n = int(rng.integers(3, 20))
    K = chain(10 ** rng.uniform(5, 10, n), True)
    f = rng.normal(size=n) * 10 ** rng.uniform(2, 5)
    at = rng.choice(n, min(n, int(rng.integers(1, 9))), replace=False)
    E = units(n, at, rng.choice([-1.0, 1.0], len(at)))
    return in_units(ContactProblem(K, f, E, fair_gaps(rng, K, f, E)), *UNIT_SYSTEMS[rng.choice(list(UNIT_SYSTEMS))])


@member(well_posed=True)
def floating_unit_systems(rng: Generator) -> ContactProblem:
    """Free stacks in units that differ by powers of two near 1e3 and 1e6, so that they stay free exactly."""
    length, force = 2.0 ** rng.choice([0, 10, 20, -10]), 2.0 ** rng.choice([0, -10, -20, 10])
    return in_units(ContactProblem(*free_stack(rng, rng.uniform(0, 6))), length, force)


@member(well_posed=True)
def badly_scaled(rng: Generator) -> ContactProblem:
    """Single unknowns scaled by 1e-6 to 1e6 and rows by 1e-4 to 1e4: chains, beams, lattices, free stacks."""
    makers = (chain_walls, beam_stops, lattice_on_floor, floating_stack, chain_between)
    base = makers[int(rng.integers(0, len(makers)))](rng)
    D = 2.0 ** rng.integers(-20, 21, base.dimension)
    r = 2.0 ** rng.integers(-13, 14, base.contacts)
    K = np.asarray(base.stiffness) * np.outer(D, D)
    return ContactProblem(K, base.load * D, base.normal.toarray() * np.outer(r, D), base.gap * r)


@member(well_posed=True)
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


@member(well_posed=True)
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


def answer_shared_with_ties(rng: Generator) -> tuple[Array, ...]:
    """K, rows of contacts and ties that depend on each other, u, forces of contacts and ties: an answer of few bits."""
    n = int(rng.integers(2, 9))
    factor = rng.integers(-3, 4, (n + 2, n)).astype(float)
    K = np.diag(2.0 ** rng.integers(-6, 7, n)) if rng.random() < 0.5 else factor.T @ factor + np.eye(n)
    base = rng.integers(-2, 3, (int(rng.integers(1, min(n, 4) + 1)), n)).astype(float)
    E, A = (rng.integers(-2, 3, (int(rng.integers(1, 6)), len(base))) @ base for _ in range(2))
    E, A = E[np.any(E, axis=1)], A[np.any(A, axis=1)]
    force = np.where(rng.random(len(E)) < 0.7, rng.integers(0, 17, len(E)) / 16.0, 0.0)
    if not (np.any(force) and len(A)):
        return answer_shared_with_ties(rng)
    return K, E, A, rng.integers(-8, 9, n) / 8.0, force, rng.integers(-16, 17, len(A)) / 16.0


@member(well_posed=True)
def shared_with_ties(rng: Generator) -> ContactProblem:
    """Contacts and ties whose rows depend on each other, around an answer, in units of 1e-7 to 1e7 of each unknown."""
    K, E, A, u, force, tie_force = answer_shared_with_ties(rng)
    gap = E @ u + (force == 0) * rng.integers(0, 9, len(E)) / 8.0
    load = K @ u + E.T @ force + A.T @ tie_force
    unit, row, tied = (4.0 ** rng.integers(-12, 13, len(each)) for each in (u, force, tie_force))
    E, A, value = E / unit * row[:, None], A / unit * tied[:, None], A @ u * tied
    return ContactProblem(K / np.outer(unit, unit), load / unit, E, gap * row, tie=A, tie_value=value)


@member(well_posed=False, solvable=False)
def conflicting_walls(rng: Generator) -> ContactProblem:
    """Two walls that leave an unknown no room, by 1e-7 to 1 of their distance to rest."""
    base = chain_walls(rng)
    j, at = int(rng.integers(0, base.dimension)), float(rng.normal())
    overlap_ = abs(at) * 10 ** rng.uniform(-7, 0)
    return with_rows(base, units(base.dimension, [j, j], [1.0, -1.0]), np.array([at, -at - overlap_]))


@member(well_posed=False, solvable=False)
def driven_away(rng: Generator) -> ContactProblem:
    """A free stack whose last body is pulled off all the others: the load drives a motion that no contact resists."""
    K, f, E, g = free_stack(rng, rng.uniform(0, 5))
    return ContactProblem(K, -f, E, g)


@member(well_posed=False, solvable=False)
def weakly_driven_away(rng: Generator) -> ContactProblem:
    """A free lattice on a floor with a sideways load of 1e-6 to 1 of the others: nothing holds it back."""
    base = block_on_floor(rng, False)
    f = np.array(base.load)
    f[0] = np.max(abs(f)) * 2.0 ** -int(rng.integers(0, 20))
    return base.replace(load=f)
