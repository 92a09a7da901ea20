"""Free bodies whose answer is a rigid motion, without strain or with one that is tiny beside the motion.

Springs, motions, forces and rows have so few bits that K u, E u and E'l are exact. The load is f = K u + E'l + A'nu of
a chosen u and l >= 0 with g = E u where l > 0 and g >= E u elsewhere, so u is an answer and no load drives a motion.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from benchmarks.bricks import Array, Generator, beam, blocks, chain, in_other_words, magnitudes, units
from benchmarks.families_of_stacks import spring_block
from benchmarks.family_register import member
from contactqp import ContactProblem

BITS = 5


def _dyadic(rng: Generator, size: int | None = None) -> Array:
    """Numbers in (0, 1] of five binary places."""
    return np.asarray(rng.integers(1, 2**BITS + 1, size) / 2.0**BITS)


def _power(rng: Generator, low: float, high: float) -> float:
    """A power of two near 10 to a power in [low, high]."""
    return float(2.0 ** np.round(np.log2(10) * rng.uniform(low, high)))


def _answered(
    rng: Generator,
    K: Array,
    rigid: Array,
    E: Array,
    closed: Array,
    tie: Array | None,
    force: float,
    room: float,
    strained: Array | float = 0.0,
) -> ContactProblem:
    """The problem that `rigid` + `strained` answers, with forces of the size `force` and gaps up to `room`.

    One closed contact in six only grazes, as long as another one pushes.
    """
    u = rigid + strained
    pushes = closed & (rng.random(len(closed)) < 5 / 6)
    pushes = pushes if np.any(pushes) else closed
    forces = np.where(pushes, force * _dyadic(rng, len(E)), 0.0)
    gap = E @ u + np.where(closed, 0.0, room * _dyadic(rng, len(E)))
    load = K @ (u - rigid) + E.T @ forces
    if tie is None:
        return ContactProblem(K, load, E, gap)
    load += tie.T @ (force * _dyadic(rng, len(tie)) * rng.choice([-1.0, 0.0, 1.0], len(tie)))
    return ContactProblem(K, load, E, gap, tie=tie, tie_value=tie @ u)


def _bars(rng: Generator) -> tuple[list[Array], list[Array]]:
    """Stiffness and motion of one to three free bars or beams of two to six nodes each, sizes up to 1e4 apart."""
    parts, motions = [], []
    for _ in range(int(rng.integers(1, 4))):
        nodes, moved = int(rng.integers(2, 7)), _power(rng, -4, 1) * float(_dyadic(rng)) * float(rng.choice([-1, 1]))
        if rng.random() < 0.6:
            parts.append(chain(magnitudes(rng, 0, 2, nodes - 1) * _power(rng, 0, 4), False))
            motions.append(np.full(nodes, moved))
        else:
            parts.append(beam(nodes - 1, nodes - 1.0, _power(rng, 0, 6)))
            turn = float(rng.choice([0.0, 1.0])) * moved * float(rng.integers(-8, 9)) / 8
            motions.append(np.column_stack([moved + turn * np.arange(nodes), np.full(nodes, turn)]).ravel())
    return parts, motions


@member(well_posed=True)
def pushed_rigidly(rng: Generator) -> ContactProblem:
    """Free bars and beams that fall onto supports under their loads, or are pushed onto a stop at the loaded node."""
    parts, motions = _bars(rng)
    K, u = blocks(*parts), np.concatenate(motions)
    n, rows, closed, start = len(K), [], [], 0
    for part, motion in zip(parts, motions, strict=True):
        nodes = np.arange(0, len(part), 1 if part[0, 0] == -part[0, 1] else 2)
        falls = rng.random() < 0.5
        stops = rng.permutation(nodes)[: int(rng.integers(2, len(nodes) + 1)) if falls else 1]
        others = np.setdiff1d(nodes, stops)[: int(rng.integers(0, 3))]
        sign = 1.0 if motion[0] > 0 else -1.0
        rows += [units(n, start + stops, sign), units(n, start + others, rng.choice([-1.0, 1.0], len(others)))]
        closed += [True] * len(stops) + [False] * len(others)
        start += len(part)
    tie = None
    if len(parts) > 1 and rng.random() < 0.4:
        tie = units(n, [0]) - units(n, [len(parts[0])])
    stiff = float(np.max(K)) * float(np.max(abs(u)))
    room = float(np.max(abs(u))) * _power(rng, -3, 2)
    force = stiff * _power(rng, -7, 2)
    return in_other_words(rng, _answered(rng, K, u, np.vstack(rows), np.array(closed), tie, force, room), ten=False)


def _floating_blocks(rng: Generator) -> tuple[Array, Array, Array, Array, int]:
    """K, a rigid motion, places (n / d, d) and body of every node, and d, of one to three free blocks."""
    d = 2 if rng.random() < 0.6 else 3
    parts, motions, places, body = [], [], [], []
    moved = _power(rng, -5, 1)
    for b in range(int(rng.integers(1, 4 if d == 2 else 3))):
        sides = [int(rng.integers(2, 5 if d == 2 and axis == 0 else 3)) for axis in range(d)]
        nodes = np.array(list(product(*map(range, sides))), dtype=float)
        parts.append(spring_block(rng, nodes, _power(rng, 0, 5)))
        turn = moved * np.triu(rng.integers(-4, 5, (d, d)), 1) / 8 * float(rng.choice([0.0, 1.0]))
        shift = moved * rng.integers(-16, 17, d) / 16
        motions.append((shift + nodes @ (turn - turn.T)).ravel())
        places.append(nodes)
        body += [b] * len(nodes)
    return blocks(*parts), np.concatenate(motions), np.vstack(places), np.array(body), d


def _rows_of_blocks(rng: Generator, n: int, body: Array, d: int) -> Array:
    """Contacts along axes or oblique, of nodes with stops or with nodes of another block."""
    rows = np.zeros((int(rng.integers(2, 9)), n))
    for row in rows:
        normal = np.eye(d)[rng.integers(d)] if rng.random() < 0.6 else rng.integers(-2, 3, d) / 2
        normal = normal if np.any(normal) else np.ones(d)
        normal = normal * float(rng.choice([-1.0, 1.0]))
        one, other = rng.integers(0, len(body), 2)
        row[d * one : d * one + d] += normal
        if body[one] != body[other]:
            row[d * other : d * other + d] -= normal
    return rows


@member(well_posed=True)
def unstrained(rng: Generator) -> ContactProblem:
    """Floating blocks, plane or in space, that a motion brings to rest, unstrained or strained by 1e-10 to 1e-3."""
    K, u, _, body, d = _floating_blocks(rng)
    n, size = len(K), float(np.max(abs(u))) or 1.0
    strain = size * _power(rng, -10, -3) if rng.random() < 0.5 else 0.0
    strained = strain * np.round(rng.normal(size=n) * 8) / 8
    E = _rows_of_blocks(rng, n, body, d)
    closed = rng.random(len(E)) < 0.7
    closed[0] = True
    tie = _rows_of_blocks(rng, n, body, d)[: int(rng.integers(1, 3))] if rng.random() < 0.35 else None
    force = float(np.max(K)) * (strain or size * _power(rng, -8, 0)) * _power(rng, -1, 1)
    return in_other_words(rng, _answered(rng, K, u, E, closed, tie, force, size, strained), ten=False)


@member(well_posed=True)
def interference_removed(rng: Generator) -> ContactProblem:
    """Blocks and bars that overlap at the start (negative gaps) and part by a rigid shift; some are pressed besides."""
    if rng.random() < 0.5:
        parts, motions = _bars(rng)
        K, u = blocks(*parts), np.concatenate(motions)
        E = units(len(K), np.sort(rng.permutation(len(K))[: int(rng.integers(1, len(K) + 1))][:8]))
    else:
        K, u, _, body, d = _floating_blocks(rng)
        E = _rows_of_blocks(rng, len(K), body, d)
    if rng.random() < 0.4:  # a grounded neighbour that stays as it is
        other = chain(magnitudes(rng, 0, 3, int(rng.integers(1, 6))) * _power(rng, 0, 4), True)
        K, u = blocks(K, other), np.append(u, np.zeros(len(other)))
        E = np.hstack([E, np.zeros((len(E), len(other)))])
        E[0, -1] -= 1.0
    approach = E @ u
    E = np.where(approach[:, None] > 0, -E, E)  # every gap that closes is negative or zero
    closed = rng.random(len(E)) < 0.8
    closed[np.argmax(abs(approach))] = True
    tie = None
    if rng.random() < 0.3:
        tie = units(len(K), rng.choice(len(K), 1))
    size = float(np.max(abs(u))) or 1.0
    force = 0.0 if rng.random() < 0.4 else float(np.max(K)) * size * _power(rng, -7, 0)
    return in_other_words(rng, _answered(rng, K, u, E, closed, tie, force, size), ten=False)


@member(well_posed=True)
def held_by_weak_springs(rng: Generator) -> ContactProblem:
    """Rigid machines on three to six feet with shims, in the plane and in space, kept from floating by weak springs.

    The load is up to 1e15 times what would strain the springs by a shim: which feet stand is decided by the shims.
    """
    space, feet = bool(rng.random() < 0.5), int(rng.integers(3, 7))
    reach, spring, weight = _power(rng, -1, 3), _power(rng, -7, 2), _power(rng, -2, 5)
    place = np.round(rng.uniform(-1, 1, (feet, 2 if space else 1)), 3) * reach
    rows = np.column_stack([-np.ones(feet), place])
    gap = np.where(rng.random(feet) < 0.5, 0.0, _power(rng, -3, 1) * np.round(rng.uniform(0, 1, feet), 2))
    at = np.round(rng.dirichlet(np.ones(feet)) @ place / reach, 3) * reach
    K = spring * np.diag([1.0, *np.full(place.shape[1], reach**2)])
    return ContactProblem(K, weight * np.array([-1.0, *at]), rows, gap)
