"""What the families are built of: chains, beams, lattices, loads and gaps, in numbers whose sums are exact."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contactqp import ContactProblem

Array = NDArray[np.float64]
Generator = np.random.Generator


def few_bits(values: Array | float, bits: int = 8) -> Array:
    """Rounded to a few significant bits: sums and small integer multiples of such numbers are exact."""
    mantissa, exponent = np.frexp(values)
    return np.asarray(np.ldexp(np.round(mantissa * 2**bits), exponent - bits))


def magnitudes(rng: Generator, low: float, high: float, size: int | None = None) -> Array:
    """10 to a power that is uniform in [low, high], in few bits."""
    return few_bits(10.0 ** rng.uniform(low, high, size))


def springs(size: int, members: list[tuple[int, int, float]]) -> Array:
    """K of unknowns joined by springs (i, j, k); j = -1 is the ground."""
    K = np.zeros((size, size))
    for i, j, k in members:
        K[i, i] += k
        if j >= 0:
            K[j, j] += k
            K[i, j] -= k
            K[j, i] -= k
    return K


def chain(stiffness: Array, grounded: bool) -> Array:
    """K of a chain; the first spring goes to the ground if it is grounded."""
    if grounded:
        return springs(len(stiffness), [(i, i - 1, k) for i, k in enumerate(stiffness)])
    return springs(len(stiffness) + 1, [(i + 1, i, k) for i, k in enumerate(stiffness)])


def blocks(*parts: Array) -> Array:
    """Block diagonal."""
    size = sum(len(p) for p in parts)
    K, start = np.zeros((size, size)), 0
    for part in parts:
        K[start : start + len(part), start : start + len(part)] = part
        start += len(part)
    return K


def units(size: int, at: Array | list[int], signs: Array | list[float] | float = 1.0) -> Array:
    """Rows that pick single unknowns."""
    rows = np.zeros((len(at), size))
    rows[np.arange(len(at)), at] = signs
    return rows


def free_response(K: Array, f: Array) -> Array:
    """K^-1 f by refined elimination; a size to choose gaps by, no truth."""
    D = 1 / np.sqrt(np.diag(K))
    return D * np.linalg.lstsq(K * np.outer(D, D), D * f, rcond=1e-15)[0]


def light(rng: Generator, size: int | None = None, lightest: float = 5.0) -> Array:
    """1 - 10^-p, p from 0.2 to `lightest`: the part of an approach that a gap lets pass before it closes.

    Lightly pressed contacts are where methods that look at the whole energy stop too early.
    """
    return np.asarray(1 - 10.0 ** rng.uniform(-lightest, -0.2, size))


def fair_gaps(rng: Generator, K: Array, f: Array, E: Array, lightest: float = 5.0) -> Array:
    """Not negative (rest is feasible), and such that some contacts close, many of them lightly."""
    approach = E @ free_response(K, f)
    typical = np.max(abs(approach), initial=0.0) or 1.0
    part = np.where(rng.random(len(E)) < 0.25, rng.uniform(0.5, 2.0, len(E)), light(rng, len(E), lightest))
    if rng.random() < 0.5:  # one contact alone, lightly pressed; the others are far
        part = np.where(np.arange(len(E)) == np.argmax(approach), part, 2 * part + 1)
    return np.where(approach > 0, part * approach, 0.1 * part * typical)


def squeeze(rng: Generator, size: int, low: float = 0, high: float = 6) -> Array:
    """Two opposite loads in few bits on two of `size` unknowns: large, and without resultant exactly."""
    f = np.zeros(size)
    if size > 1:
        at = rng.choice(size, 2, replace=False)
        f[at] = np.array([1.0, -1.0]) * float(few_bits(10.0 ** rng.uniform(low, high), 6))
    return f


def beam(elements: int, length: float, bending: float) -> Array:
    """K of a chain of Euler-Bernoulli elements, unknowns (w, theta) a node, nothing held; exactly singular."""
    L = float(few_bits(length / elements, 5))
    forces, moments = [12, 6 * L, -12, 6 * L], [6 * L, 4 * L**2, -6 * L, 2 * L**2]
    opposite = [6 * L, 2 * L**2, -6 * L, 4 * L**2]
    element = few_bits(bending / L**3) * np.array([forces, moments, [-x for x in forces], opposite])
    K = np.zeros((2 * elements + 2, 2 * elements + 2))
    for e in range(elements):
        K[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += element
    return K


def lattice(rng: Generator, wide: int, high: int, contrast: float) -> Array:
    """K of a plane spring lattice on a unit grid with both diagonals.

    Node (x, y) has the unknowns 2(x + wide y) and the next.
    A spring of stiffness 2k along (1, 1)/sqrt(2) has the entries k: exact in few bits.
    """
    K = np.zeros((2 * wide * high, 2 * wide * high))
    for x in range(wide):
        for y in range(high):
            for dx, dy in ((1, 0), (0, 1), (1, 1), (-1, 1)):
                if 0 <= x + dx < wide and y + dy < high:
                    d = np.array([dx, dy, -dx, -dy], dtype=float)
                    one, other = 2 * (x + wide * y), 2 * (x + dx + wide * (y + dy))
                    at = [one, one + 1, other, other + 1]
                    K[np.ix_(at, at)] += few_bits(10.0 ** rng.uniform(0, contrast), 6) * np.outer(d, d)
    return K


def in_units(problem: ContactProblem, length: float, force: float) -> ContactProblem:
    """The same problem with its lengths and forces in other units."""
    K = np.asarray(problem.stiffness.toarray() if hasattr(problem.stiffness, "toarray") else problem.stiffness)
    return ContactProblem(
        stiffness=K * (force / length),
        load=problem.load * force,
        normal=problem.normal,
        gap=problem.gap * length,
        tie=problem.tie,
        tie_value=problem.tie_value * length,
    )


def in_other_words(rng: Generator, problem: ContactProblem, ten: bool) -> ContactProblem:
    """The same problem with its unknowns in another order, with other signs and, in part, in other units.

    Powers of ten round the data and so pose another problem, for stiffnesses that are regular; powers of two do not.
    """
    n, m = problem.dimension, problem.contacts
    base, decade = (10.0, 1.0) if ten else (2.0, np.log2(10))

    def powers(largest: int, size: int) -> Array:
        chosen = base ** np.round(decade * rng.integers(-largest, largest + 1, size))
        return np.where(rng.random() < 0.3, chosen, 1.0)

    order, D, r = rng.permutation(n), powers(4, n) * rng.choice([-1.0, 1.0], n), powers(4, m)
    length, force = (
        base ** np.round(decade * rng.choice([0, 0, 3, -3])),
        base ** np.round(decade * rng.choice([0, 3, -3])),
    )
    K = np.asarray(problem.stiffness.toarray() if hasattr(problem.stiffness, "toarray") else problem.stiffness)
    other = ContactProblem(
        stiffness=(K * np.outer(D, D))[np.ix_(order, order)],
        load=(problem.load * D)[order],
        normal=(problem.normal.toarray() * np.outer(r, D))[:, order],
        gap=problem.gap * r,
        tie=(problem.tie.toarray() * D)[:, order],
        tie_value=problem.tie_value,
    )
    return in_units(other, length, force)


def with_rows(problem: ContactProblem, rows: Array, gaps: Array) -> ContactProblem:
    """The problem with further contacts."""
    normal = np.vstack([problem.normal.toarray(), rows])
    return problem.replace(normal=normal, gap=np.append(problem.gap, gaps))
