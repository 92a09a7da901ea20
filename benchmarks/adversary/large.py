"""Bodies of hundreds of unknowns around an answer: whole numbers in few bits, so that it is exact without being solved.

The answer is chosen first: displacements, contact forces where contacts are closed, forces of ties. Loads and gaps
follow from it, and all sums of them are exact in doubles. Nothing of this package takes part in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

import contactqp as cq
from benchmarks.adversary.judging import Judge
from benchmarks.bricks import Array, Generator
from contactqp.model.arrays import EPS

# Methods beside the default one, and the systems that they are solved on.
METHODS = ("active-set", "active-set", "clarabel", "lagrange-multiplier", "piqp", "lemke")
# Errors, of the largest displacement and of the largest force, that an answer that passes may have.
WRONG = 1e-6
FORGED = 1e-3
# Part of a bound that the rounding of what it is held against may take.
ROUNDING = 1e-6
# Seconds that the larger ones take by the slower methods.
PATIENCE = 20.0


@dataclass(frozen=True)
class Known:
    """A problem whose answer is exact, with its strain energy."""

    problem: cq.ContactProblem
    displacement: Array
    force: Array
    tie_force: Array

    def errors(self, u: Array, force: Array) -> tuple[float, float]:
        """Return the error of displacements in the energy norm, of theirs, and of forces of the largest."""
        K, apart = self.problem.stiffness, u - self.displacement
        size = np.sqrt(self.displacement @ (K @ self.displacement))
        largest = float(abs(self.force).max(initial=0.0))
        off = float(abs(force - self.force).max(initial=0.0))
        return float(np.sqrt(max(apart @ (K @ apart), 0.0)) / size) if size > 0 else 0.0, off / (largest or 1.0)


def draw(rng: Generator) -> Known:
    """A sheet of springs, each node with one unknown: on the ground, on a bed, or held by contacts alone."""
    rows, columns = int(rng.integers(1, 25)), int(rng.integers(4, 30))
    number = np.arange(rows * columns).reshape(rows, columns)
    pairs = np.vstack([np.stack([number[1:], number[:-1]], -1).reshape(-1, 2),
                       np.stack([number[:, 1:], number[:, :-1]], -1).reshape(-1, 2)])  # fmt: skip
    n, spread = number.size, int(rng.choice([0, 4, 10]))

    def stiffnesses(count: int) -> Array:
        return np.asarray(rng.integers(1, 8, count) * 2.0 ** rng.integers(0, spread + 1, count))

    difference = _rows(pairs, n)
    K = difference.T @ sp.diags_array(stiffnesses(len(pairs))) @ difference
    held = str(rng.choice(["ground", "bed", "contacts"]))
    if held != "contacts":
        where = number[:, 0] if held == "ground" else np.arange(n)
        K = K + sp.csr_array((stiffnesses(len(where)), (where, where)), shape=(n, n))
    places = rng.permutation(n)
    m, k = int(rng.integers(1, max(n // 2, 2))), int(rng.integers(0, 4))
    touching, tied = places[:m], places[m : m + 2 * k].reshape(-1, 2) if m + 2 * k <= n else places[:0].reshape(0, 2)
    normal = sp.csr_array((rng.choice([-1.0, 1.0], m), (np.arange(m), touching)), shape=(m, n))
    tie, u = _rows(tied, n), np.asarray(rng.integers(-64, 65, n) / 2.0 ** int(rng.integers(0, 7)))
    closed = rng.random(m) < rng.choice([0.1, 0.5, 0.9])
    closed[0] = True
    force = np.where(closed, rng.integers(1, 4096, m) * 2.0 ** int(rng.integers(0, 10)), 0.0)
    force[1:][rng.random(m - 1) < 0.05] = 0.0  # closed ones of these graze
    pull = rng.integers(-512, 513, len(tied)).astype(float)
    load = K @ u + normal.T @ force + tie.T @ pull
    gap = normal @ u + np.where(closed, 0.0, rng.integers(1, 64, m))
    length, unit = (2.0 ** float(rng.choice([0, 0, -40, 60, -300, 280])) for _ in range(2))
    row = 2.0 ** (rng.integers(-20, 21, m) if rng.random() < 0.3 else np.zeros(m))
    problem = cq.ContactProblem(
        sp.csr_array(K) * unit / length, load * unit, sp.diags_array(row) @ normal, gap * length * row,
        tie=tie, tie_value=tie @ u * length,
    )  # fmt: skip
    return Known(problem, u * length, force * unit / row, pull * unit)


def _rows(pairs: Array, n: int) -> Any:
    """The difference of two unknowns in each row."""
    count = len(pairs)
    columns, values = np.ravel(pairs), np.tile([1.0, -1.0], count)
    return sp.csr_array((values, (np.repeat(np.arange(count), 2), columns)), shape=(count, n))


def judge_large(judge: Judge, rng: Generator) -> None:
    """Solve one by several methods, and judge the exact answer and forged ones.

    The default method has to have an answer; others may stop without one.
    """
    known = draw(rng)
    other: dict[str, Any] = {"method": str(rng.choice(METHODS)), "condense": bool(rng.random() < 0.5)}
    for options in ({}, other):
        fresh = known.problem.replace(stiffness=known.problem.stiffness)
        name = " ".join(map(str, ["solve", *options.values()]))
        found, error = judge.ask(name, lambda fresh=fresh, options=options: cq.solve(fresh, **options), PATIENCE)
        if found is None:
            if not options:
                judge.found("refused", name, str(error)[:300])
            continue
        off = known.errors(found.displacement, found.normal_force)
        if max(off) > WRONG:
            judge.found("wrong", name, f"passed, and off by {max(off):.2g}")
        _judge_bounds(judge, name, known, found.certificate, found.displacement, found.normal_force)
    for answer, u, force, tie in _answers(known, rng):
        name = f"certify {answer}"
        certificate = judge.ask(name, lambda u=u, f=force, t=tie: cq.certify(known.problem, u, f, None, t))[0]
        if certificate is None:
            continue
        if certificate.passed is not (answer == "truth"):
            kind = "forgery" if certificate.passed else "refused"
            judge.found(kind, name, str(certificate.failures)[:300])
        _judge_bounds(judge, name, known, certificate, u, force)


def _judge_bounds(judge: Judge, name: str, known: Known, certificate: Any, u: Array, force: Array) -> None:
    """No proven bound is below the error of what it bounds."""
    strain, _ = known.errors(u, force)
    bound, of_forces = certificate.energy_error, certificate.force_bound
    if bound is not None and strain > bound * (1 + ROUNDING) + EPS:
        judge.found("bound", name, f"energy_error {bound:.3g}, and it is {strain:.3g}")
    if of_forces is not None:
        beyond = float(np.max(abs(force - known.force) - np.asarray(of_forces) * (1 + ROUNDING), initial=0.0))
        if beyond > EPS * abs(known.force).max():
            judge.found("bound", name, f"force_bound is exceeded by {beyond:.3g}, largest {max(known.force):.3g}")


def _answers(known: Known, rng: Generator) -> list[tuple[str, Array, Array, Array]]:
    """The exact answer, and answers that differ from it by a thousandth of the largest displacement or force."""
    u, force, tie = known.displacement, known.force, known.tie_force
    pushing = np.flatnonzero(force > 0)
    one = int(rng.choice(pushing))
    more, turned, moved = force.copy(), force.copy(), u.copy()
    of_row = abs(known.problem.normal).max(axis=1).toarray().ravel()
    more[one] += FORGED * np.max(force * of_row) / of_row[one]
    turned[one] *= -1
    moved[int(rng.integers(0, len(u)))] += FORGED * (np.max(abs(u)) or 1.0)
    found = [("truth", u, force, tie), ("a force off by 0.001", u, more, tie), ("a tension", u, turned, tie),
             ("no forces", u, 0 * force, tie), ("a node off by 0.001", moved, force, tie)]  # fmt: skip
    if len(tie) and np.any(tie):
        pulled = tie.copy()
        pulled[0] += FORGED * max(np.max(abs(tie)), np.max(force * of_row))
        found.append(("a tie force off by 0.001", u, force, pulled))
    return found
