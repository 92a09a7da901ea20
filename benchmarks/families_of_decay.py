"""Answers that decay over many orders: bodies on stiff beds, first steps of paths and of waves.

Far from the load a displacement is 1e-20 of the largest one, with contacts there as well as near. Every stiffness is
regular and rest is admissible, so that each problem has one answer.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from benchmarks.bricks import Array, Generator, beam, blocks, chain, few_bits, in_other_words, lattice, light, units
from benchmarks.family_register import member
from contactqp import ContactProblem
from contactqp.linalg.rational import column, floats, matrix


def _rail(rng: Generator) -> tuple[Array, Array, Array]:
    """A beam of 8 to 30 elements on springs of 4 to 400 times its own: K, its deflections, the bed of all unknowns."""
    elements = int(rng.integers(8, 31))
    K = beam(elements, elements * 10 ** rng.uniform(-1, 0.5), 10 ** rng.uniform(3, 7))
    bed = np.zeros(len(K))
    bed[::2] = K[2, 2] / 24 * 10 ** rng.uniform(0.6, 2.6)
    return K, np.arange(0, len(K), 2), bed


def _pile(rng: Generator) -> tuple[Array, Array, Array]:
    """A bar of 20 to 60 elements in soil of 0.5 to 20 times its stiffness, uneven by up to a half."""
    n = int(rng.integers(20, 61))
    k = 10 ** rng.uniform(5, 10)
    K = chain(k * rng.uniform(0.5, 1.5, n - 1), False)
    return K, np.arange(n), k * 10 ** rng.uniform(-0.3, 1.3) * rng.uniform(0.5, 1.5, n)


def _block(rng: Generator) -> tuple[Array, Array, Array]:
    """A lattice of two or three nodes by up to 12 whose upper half stands on springs of 10 to 1e5 times its own."""
    wide, high = int(rng.integers(2, 4)), int(rng.integers(6, 13))
    K = lattice(rng, wide, high, rng.uniform(0, 1)) * 10 ** rng.uniform(0, 6)
    upper = np.arange(len(K)) >= 2 * wide * (high // 2)
    return K, np.arange(1, len(K), 2), np.where(upper, np.max(K) * 10 ** rng.uniform(1, 5), 0.0)


def _decaying_gaps(rng: Generator, K: Array, f: Array, E: Array) -> Array:
    """Not negative; a part of what each contact approaches without contact, wide, or none at all."""
    approach = E @ floats(matrix(K).solve(column(f)))
    kind = rng.choice(4, len(E), p=[0.5, 0.2, 0.15, 0.15])
    largest = np.max(abs(approach), initial=0.0) or 1.0
    share = np.where(approach > 0, light(rng, len(E)) * approach, 0.1 * abs(approach))
    wide = largest * 10 ** rng.uniform(-1, 2, len(E))
    return np.select([kind == 0, kind == 1, kind == 2], [share, wide, 1.5 * abs(approach)], 0.0)


def _contacts(rng: Generator, K: Array, f: Array, at: Array) -> tuple[Array, Array]:
    """Two to seven stops at these unknowns, near the largest load and anywhere; rows and gaps."""
    near = at[np.argsort(abs(at - int(np.argmax(abs(f)))))[:3]]
    chosen = np.unique(np.append(rng.choice(near, 1), rng.choice(at, min(len(at), int(rng.integers(2, 7))), False)))
    E = units(len(K), chosen, rng.choice([-1.0, 1.0], len(chosen)))
    return E, _decaying_gaps(rng, K, f, E)


def _tied(rng: Generator, problem: ContactProblem, at: Array) -> ContactProblem:
    """The problem with one or two ties: neighbours that move as one, a support, or a settlement instead of the load."""
    touched = np.unique(problem.normal.indices)
    idle = np.setdiff1d(at, touched)
    pairs = [(a, b) for a, b in pairwise(at) if a not in touched or b not in touched]
    rows, values, load = [], [], problem.load
    if pairs:
        a, b = pairs[int(rng.integers(len(pairs)))]
        rows, values = [units(problem.dimension, [a]) - units(problem.dimension, [b])], [0.0]
    if len(idle) and rng.random() < 0.5:
        settles = rng.random() < 0.5
        one = int(idle[np.argmin(abs(idle - int(np.argmax(abs(load)))))]) if settles else int(rng.choice(idle))
        rows.append(units(problem.dimension, [one]))
        values.append(10 ** rng.uniform(-6, -1) if settles else 0.0)
        load = np.zeros_like(load) if settles else load
    if not rows or (len(rows) == 2 and rows[0][0, one] and values[1] and set(np.flatnonzero(rows[0])) & set(touched)):
        return problem  # a settlement would be handed on to an unknown with a stop
    return ContactProblem(
        problem.stiffness, load, problem.normal, problem.gap, tie=np.vstack(rows), tie_value=np.array(values)
    )


def _local_load(rng: Generator, size: int, at: Array) -> Array:
    """Loads on one to three neighbouring unknowns at an end, or anywhere."""
    f, start = np.zeros(size), 0 if rng.random() < 0.6 else int(rng.integers(0, len(at)))
    loaded = at[start : start + int(rng.integers(1, 4))]
    f[loaded] = rng.normal(size=len(loaded)) * 10 ** rng.uniform(-3, 5)
    return f


@member(well_posed=True)
def bedded(rng: Generator) -> ContactProblem:
    """Rails and piles on stiff beds, blocks half in springs: displacements decay to 1e-20, stops are near and far."""
    K, at, bed = (_rail, _pile, _block)[int(rng.integers(0, 3))](rng)
    K = K + np.diag(bed)
    f = _local_load(rng, len(K), at)
    problem = ContactProblem(K, f, *_contacts(rng, K, f, at))
    if rng.random() < 0.35:
        problem = _tied(rng, problem, at)
    return in_other_words(rng, problem, ten=True)


def _struck(rng: Generator) -> tuple[Array, Array, Array]:
    """A resting rod, beam or block and a mass that hits its end: M / dt^2 + K, its load in one of the first steps, at.

    Steps of 0.1 to 1.2 of what a wave takes through an element carry it over many orders. The striker is the last
    unknown and touches the first; a step of the implicit Euler method starts from the u and v of the last one.
    """
    kind = int(rng.integers(0, 3))
    if kind == 0:
        K = chain(np.full(int(rng.integers(20, 50)), 10 ** rng.uniform(4, 9)), False)
        at = np.arange(len(K))
    elif kind == 1:
        K = beam(int(rng.integers(8, 25)), 20.0, 10 ** rng.uniform(3, 7))
        at = np.arange(0, len(K), 2)
    else:
        K = lattice(rng, 2, int(rng.integers(6, 14)), 0.3) * 10 ** rng.uniform(0, 6)
        at = np.arange(1, len(K), 2)
    inertia = np.append(np.diag(K) * 10 ** rng.uniform(-0.2, 2.0), 0.0)
    inertia[-1] = inertia[0] * 10 ** rng.uniform(-1, 2)
    K = blocks(K, np.zeros((1, 1))) + np.diag(inertia)
    u, moved = np.zeros(len(K)), np.zeros(len(K))
    moved[-1] = 10 ** rng.uniform(-6, -2)  # v dt
    touch = units(len(K), [len(K) - 1]) - units(len(K), [int(at[0])])
    compliance = np.linalg.solve(K, touch[0])
    for _ in range(int(rng.integers(0, 6))):
        free = np.linalg.solve(K, inertia * (u + moved))
        after = free - compliance * max(0.0, float(touch[0] @ free) / float(touch[0] @ compliance))
        u, moved = after, after - u
    return K, inertia * (u + moved), at


@member(well_posed=True)
def decaying_path(rng: Generator) -> ContactProblem:
    """Steps of paths that begin at 1e-12 of their load, and first steps of struck rods: the body is M / dt^2 + K."""
    if rng.random() < 0.5:
        K, f, at = _struck(rng)
        E, gap = _contacts(rng, K, f, at)
        E = np.vstack([E, units(len(K), [len(K) - 1]) - units(len(K), [int(at[0])])])
        problem = ContactProblem(K, f, E, np.append(gap, 0.0))
    else:
        K, at, bed = (_rail, _pile, _block)[int(rng.integers(0, 3))](rng)
        K = K + np.diag(bed * rng.choice([0.05, 1.0]) + np.where(bed > 0, 0.0, few_bits(np.max(bed) * 1e-6)))
        f = _local_load(rng, len(K), at)
        E, gap = _contacts(rng, K, f, at)
        problem = ContactProblem(K, f * 10 ** rng.uniform(-12, 0), E, gap)
    if rng.random() < 0.3:
        problem = _tied(rng, problem, at)
    return in_other_words(rng, problem, ten=True)
