"""Problems by a grammar: bodies, what holds them, what touches, what repeats and grazes, which law, which units.

A sentence is drawn word by word; every problem has the words that it was made of. Stiffnesses are in few bits, so that
sums of them are exact: what floats does so exactly, and an answer that a problem is made around is its exact answer.
Units are powers of two: nothing is rounded, and what holds of the plain problem holds of the one in units.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import connected_components

import contactqp as cq
from benchmarks.bricks import Array, Generator, blocks, chain, few_bits, lattice, magnitudes, springs, units
from benchmarks.friction_families import COEFFICIENTS, Posed, Units

WORDS = ("bodies", "held", "contacts", "law", "load", "repeats", "ties", "size")


@dataclass(frozen=True)
class Sentence:
    """A problem with the words that it was made of."""

    words: tuple[str, ...]
    posed: Posed


@dataclass
class Draft:
    """What a problem is made of, until it is one."""

    rng: Generator
    K: Array
    normal: Array
    tangent: Array | None = None  # contact-major
    width: int = 0  # tangential rows a contact
    tie: Array | None = None
    load: Array | None = None
    gap: Array | None = None
    origin: Array | None = None
    tie_value: Array | None = None
    friction: Array | None = None


# ------------------------------------------------------------------------------- what bodies there are


def _chain(rng: Generator) -> Array:
    return chain(magnitudes(rng, 0, float(rng.choice([1, 4, 8])), int(rng.integers(1, 5))), False)


def _lattice(rng: Generator) -> Array:
    return lattice(rng, 2, 2, float(rng.choice([0, 3, 6])))


def _network(rng: Generator) -> Array:
    n = int(rng.integers(2, 6))
    pairs = [(i, j) for i in range(n) for j in range(i)]
    return springs(n, [(i, j, float(magnitudes(rng, -1, 3))) for i, j in pairs if rng.random() < 0.7 or j == i - 1])


def _full(rng: Generator) -> Array:
    n = int(rng.integers(1, 6))
    shape = rng.integers(-3, 4, size=(n, n + 1)).astype(float)
    return np.asarray(shape @ shape.T)


def _masses(rng: Generator) -> Array:
    return np.diag(magnitudes(rng, -3, 3, int(rng.integers(1, 4))))


def _bare(rng: Generator) -> Array:
    return np.zeros((1, 1)) if rng.random() < 0.5 else _chain(rng)


def _loose(rng: Generator) -> Array:
    """Unknowns that no stiffness sees, neither their own nor one another's."""
    return np.zeros((n := int(rng.integers(1, 4)), n))


def _bed(rng: Generator) -> Array:
    """A chain in a stiff bed: what acts at one end decays along it."""
    K = chain(magnitudes(rng, 0, 0.5, int(rng.integers(5, 11))), False)
    return K + np.diag(np.full(len(K), float(magnitudes(rng, 0, 4))))


BODIES: dict[str, Callable[[Generator], Array]] = {
    "chain": _chain, "lattice": _lattice, "network": _network, "full": _full, "masses": _masses, "bare": _bare,
    "loose": _loose, "bed": _bed,
}  # fmt: skip
HELD = ("ground", "ground", "ground", "one spring", "ties", "contact")
CONTACTS = ("nodes", "nodes", "between", "skew", "opposite")
REPEATS = ("", "", "", "contact", "multiple", "tie", "nearly", "zero row", "infinite gap")
LOADS = ("everywhere", "everywhere", "one", "tiny", "huge", "none")
# Problems without friction that have tangents all the same, as those of a body do.
SLIPPERY = 0.1
SIZES = ("one", "one", "one", "rows", "unknowns", "energy", "all", "extreme", "extreme rows")


def draw(rng: Generator, law: str) -> Sentence:
    """A sentence of one law: "frictionless", "plane" or "space"."""
    names = [str(rng.choice(list(BODIES))) for _ in range(int(rng.choice([1, 1, 2])))]
    return _sentence(rng, law, names, str(rng.choice(HELD)))


def floating(rng: Generator) -> Sentence:
    """A lattice without friction that contacts alone hold: where it may move, units decide what its least motion is."""
    return _sentence(rng, "frictionless", ["lattice"], "contact")


def _sentence(rng: Generator, law: str, names: list[str], held: str) -> Sentence:
    K = blocks(*(BODIES[name](rng) for name in names))
    if law != "frictionless":
        K = _wide_enough(rng, K, 2 if law == "plane" else 3)
    draft = Draft(rng, _hold(rng, K, held), np.zeros((0, len(K))))
    touching = str(rng.choice(CONTACTS))
    _touch(draft, touching, law)
    if held == "ties" or rng.random() < 0.25:
        _tie(draft)
    repeats = str(rng.choice(REPEATS))
    # Rows that are nearer, and more so on bodies that contacts alone hold, are open: benchmarks/README.md.
    _repeat(draft, repeats, 16 if held == "contact" else 20)
    around = held in ("contact", "ties") or rng.random() < 0.5
    loading = "around an answer" if around else str(rng.choice(LOADS))
    (_around_an_answer if around else _load)(draft, loading)
    if repeats == "infinite gap" and draft.gap is not None and len(draft.gap) and not around:
        draft.gap[-1] = np.inf
    plain = _problem(draft)
    size = str(rng.choice(SIZES))
    chosen = _units(rng, size, plain)
    return Sentence((*names, held, touching, law, loading, repeats, size), in_units(plain, chosen, around))


def _wide_enough(rng: Generator, K: Array, dimension: int) -> Array:
    while len(K) < dimension:
        K = blocks(K, _full(rng))
    return K


def _hold(rng: Generator, K: Array, held: str) -> Array:
    if held == "ground":
        return K + np.diag(magnitudes(rng, -1, 3, len(K)) * (rng.random(len(K)) < 0.7))
    if held == "one spring":
        at = int(rng.integers(0, len(K)))
        K = K.copy()
        K[at, at] += float(magnitudes(rng, -2, 4))
    return K


def _touch(draft: Draft, touching: str, law: str) -> None:
    """Normal rows, and tangential ones in frames of orthogonal unit vectors."""
    rng, n = draft.rng, len(draft.K)
    m = int(rng.integers(1, 4 if law != "frictionless" else 6))
    if touching == "nodes":
        normal = units(n, rng.integers(0, n, m), rng.choice([-1.0, 1.0], m))
    elif touching == "between" and n > 1:
        pairs = np.array([rng.choice(n, 2, replace=False) for _ in range(m)])
        normal = units(n, pairs[:, 0]) - units(n, pairs[:, 1])
    elif touching == "opposite":
        normal = units(n, rng.integers(0, n, m))
        normal = np.vstack([normal, -normal[:1]])
    else:
        normal = rng.integers(-4, 5, (m, n)) / 4 + units(n, rng.integers(0, n, m))
    draft.normal = normal
    slippery = law == "frictionless" and rng.random() < SLIPPERY
    if law == "frictionless" and not slippery:
        return
    draft.width = 2 if law == "space" else 1
    rows = [_across(rng, row, draft.width) for row in normal]
    draft.tangent = np.vstack(rows)
    draft.friction = np.zeros(len(normal))
    if not slippery:
        draft.friction = rng.choice(COEFFICIENTS, len(normal))
        draft.friction[0] = draft.friction[0] or 0.5


def _across(rng: Generator, normal: Array, width: int) -> Array:
    """Rows of other unknowns, or of integers."""
    n = len(normal)
    others = np.flatnonzero(normal == 0)
    if len(others) >= width and rng.random() < 0.8:
        return units(n, rng.choice(others, width, replace=False), rng.choice([-1.0, 1.0], width))
    return np.asarray(rng.integers(-4, 5, (width, n)) / 4 + units(n, rng.permutation(n)[:width]))


def _tie(draft: Draft) -> None:
    rng, n = draft.rng, len(draft.K)
    k = int(rng.integers(1, 3))
    rows = units(n, rng.choice(n, k, replace=n < k))
    if rng.random() < 0.5:
        rows = rows + rng.integers(-2, 3, (k, n)) / 2
    draft.tie = rows


def _repeat(draft: Draft, repeats: str, nearest: int) -> None:
    """Append a row like another one; nearly parallel ones are apart by 2^-8 to 2^-nearest."""
    rng, m = draft.rng, len(draft.normal)
    twin = int(rng.integers(0, m))
    if repeats in ("contact", "multiple"):
        factor = 1.0 if repeats == "contact" else float(rng.choice([0.5, 2.0, 4.0]))
        _append(draft, factor * draft.normal[twin], twin, factor)
    elif repeats == "tie" and draft.tie is not None:
        draft.tie = np.vstack([draft.tie, float(rng.choice([1.0, -1.0, 2.0])) * draft.tie[0]])
    elif repeats == "nearly":
        row = draft.normal[twin].copy()
        row[int(rng.integers(0, len(row)))] += 2.0 ** -int(rng.integers(8, nearest + 1))
        _append(draft, row, twin, 1.0)
    elif repeats in ("zero row", "infinite gap"):
        factor = 0.0 if repeats == "zero row" else 1.0
        _append(draft, factor * draft.normal[twin], twin, factor)


def _append(draft: Draft, row: Array, twin: int, factor: float) -> None:
    draft.normal = np.vstack([draft.normal, row])
    if draft.tangent is not None and draft.friction is not None:
        rows = draft.tangent[draft.width * twin : draft.width * (twin + 1)]
        draft.tangent = np.vstack([draft.tangent, factor * rows])
        draft.friction = np.append(draft.friction, draft.friction[twin])


# ------------------------------------------------------------------------------- loads, gaps, answers


def _around_an_answer(draft: Draft, _: str) -> None:
    """Load, gaps and values that a chosen answer belongs to, exactly; contacts closed, open, grazing, at any force."""
    rng, (n, m) = draft.rng, (len(draft.K), len(draft.normal))
    body = connected_components(draft.K != 0, directed=False)[1]
    at_rest = rng.random(n)[body] < 0.2  # some bodies, without load but for that of their contacts
    u = np.where(at_rest, 0.0, rng.integers(-8, 9, n) / 8)
    closed, grazes = rng.random(m) < 0.6, rng.random(m) < 0.2
    lightest = float(rng.choice([0, 3, 10]))
    pressed = np.where(closed & ~grazes, rng.integers(4, 17, m) / 8 * 2.0 ** -rng.integers(0, lightest + 1, m), 0.0)
    room = np.where(closed | grazes, 0.0, rng.integers(1, 9, m) / 8)
    zero = ~np.any(draft.normal, axis=1)
    room, pressed = np.where(zero, np.abs(room), room), np.where(zero, 0.0, pressed)
    load = draft.K @ u + draft.normal.T @ pressed
    draft.gap = draft.normal @ u + room
    if draft.tangent is not None and draft.friction is not None:
        slips = (rng.random(m) < 0.5) & ~zero
        part = rng.integers(-7, 8, m) / 8
        direction = np.eye(draft.width)[rng.integers(0, draft.width, m)] * rng.choice([-1.0, 1.0], m)[:, None]
        rubbed = (draft.friction * pressed * np.where(slips, 1.0, part))[:, None] * direction
        moved = np.where(slips | (room > 0), 0.5, 0.0)[:, None] * direction
        draft.origin = (draft.tangent @ u).reshape(m, draft.width) - moved
        load = load + draft.tangent.T @ rubbed.ravel()
    if draft.tie is not None:
        load = load + draft.tie.T @ (rng.integers(-8, 9, len(draft.tie)) / 8)
        draft.tie_value = draft.tie @ u
    draft.load = load


def _load(draft: Draft, loading: str) -> None:
    rng, (n, m) = draft.rng, (len(draft.K), len(draft.normal))
    f = few_bits(rng.normal(size=n), 10)
    if loading == "one":
        f = f * (np.arange(n) == rng.integers(0, n))
    f = f * {"tiny": 2.0**-40, "huge": 2.0**30, "none": 0.0}.get(loading, 1.0)
    draft.load = f
    typical = float(np.max(abs(f))) / max(float(np.max(np.diag(draft.K))), 1.0) or 1.0
    draft.gap = few_bits(rng.normal(size=m) + 0.5, 10) * float(few_bits(typical, 1)) * (rng.random(m) < 0.7)
    draft.gap = np.where(np.any(draft.normal, axis=1), draft.gap, abs(draft.gap))
    if draft.tangent is not None:
        draft.origin = np.zeros((m, draft.width))
    if draft.tie is not None:
        draft.tie_value = np.zeros(len(draft.tie))


def _problem(draft: Draft) -> cq.ContactProblem:
    return cq.ContactProblem(
        stiffness=draft.K, load=draft.load, normal=draft.normal, gap=draft.gap, tangent=draft.tangent,
        friction=draft.friction, slip_origin=draft.origin, tie=draft.tie, tie_value=draft.tie_value,
    )  # fmt: skip


# ------------------------------------------------------------------------------- units


def _units(rng: Generator, size: str, plain: cq.ContactProblem) -> Units:
    n, m = plain.dimension, plain.contacts
    unknown, row, length, force = np.ones(n), np.ones(m), 1.0, 1.0
    if size in ("unknowns", "all"):
        unknown = 2.0 ** rng.integers(-20, 21, n)
    if size in ("rows", "all"):
        row = 2.0 ** rng.integers(-26, 27, m)
    if size in ("energy", "all"):
        length, force = 2.0 ** float(rng.integers(-30, 31)), 2.0 ** float(rng.integers(-30, 31))
    if size == "extreme":
        length, force = 2.0 ** float(rng.integers(-330, 331)), 2.0 ** float(rng.integers(-330, 331))
    if size == "extreme rows":
        row = 2.0 ** rng.integers(-900, 901, m)
    return Units(unknown, row, length, force)


def in_units(plain: cq.ContactProblem, chosen: Units, solvable: bool) -> Posed:
    """The problem in units: u = unknown length v, forces times `force`, rows times `row`."""
    d, row = chosen.unknown, chosen.row
    changed = dict(
        stiffness=np.asarray(plain.stiffness) / np.outer(d, d) * chosen.force / chosen.length,
        load=plain.load / d * chosen.force,
        normal=plain.normal.toarray() / d * row[:, None],
        gap=plain.gap * chosen.length * row,
        tie=plain.tie.toarray() / d if plain.ties else None,
        tie_value=plain.tie_value * chosen.length if plain.ties else None,
    )
    if plain.tangent is not None and plain.slip_origin is not None:
        rows = np.repeat(row, plain.slip_origin.shape[1])
        changed |= dict(
            tangent=plain.tangent.toarray() / d * rows[:, None],
            friction=plain.friction,
            slip_origin=plain.slip_origin * chosen.length * row[:, None],
        )
    return Posed(cq.ContactProblem(**changed), plain, chosen, solvable)
