"""Random frictional problems, seeded: numbers of order one, singular, redundant, and the same in bad units.

Bad units are powers of two, so that nothing is rounded: what holds for one problem holds for the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import contactqp as cq
from benchmarks.friction_on_bodies import MAKERS

COEFFICIENTS = (0.0, 0.125, 0.25, 0.75, 1.0, 1.5, 3.0, 5.0)


@dataclass(frozen=True)
class Units:
    """u = unknown * length * v, forces times `force`, the rows of contact i times `row`."""

    unknown: NDArray[np.float64]  # (n,)
    row: NDArray[np.float64]  # (m,)
    length: float
    force: float


@dataclass(frozen=True)
class Posed:
    """A problem, the same in the numbers it was made in, and whether it was made around an answer."""

    problem: cq.ContactProblem
    plain: cq.ContactProblem
    units: Units
    solvable: bool


def _size(rng: np.random.Generator, dimension: int) -> tuple[int, int]:
    m = int(rng.integers(1, 4 if dimension == 2 else 6))
    return m, dimension * m + int(rng.integers(0, 4))


def _stiffness(rng: np.random.Generator, n: int, coupling: float, missing: int) -> NDArray[np.float64]:
    """Diagonal to full; singular by integers, exactly."""
    if missing:
        shape = rng.integers(-3, 4, size=(n, max(n - missing, 1))).astype(float)
        return shape @ shape.T
    shape = rng.normal(size=(n, n))
    full = coupling * shape @ shape.T
    K = full + np.diag(rng.uniform(0.2, 2.0, n)) * (1.0 if coupling < 1 else 0.05)
    return np.asarray((K + K.T) / 2)


def _contact(
    rng: np.random.Generator, dimension: int, missing: int, redundant: bool, around: bool
) -> cq.ContactProblem:
    m, n = _size(rng, dimension)
    t = dimension - 1
    K = _stiffness(rng, n, float(rng.choice([0.0, 0.1, 1.0, 3.0])), missing)
    rows = np.eye(dimension * m, n)
    normal, tangent = -rows[::dimension], rows[np.arange(dimension * m) % dimension > 0]
    if rng.random() < 0.5:
        normal = rng.integers(-4, 5, size=(m, n)) / 4 + normal
        tangent = rng.integers(-4, 5, size=(t * m, n)) / 4 + tangent
    if redundant:
        twin = int(rng.integers(0, m))
        normal, tangent = np.vstack([normal, normal[twin]]), np.vstack([tangent, tangent[t * twin : t * (twin + 1)]])
        m += 1
    k = int(rng.random() < 0.3)
    tie = rng.integers(-4, 5, size=(k, n)) / 4 + np.eye(k, n)[:, ::-1]
    mu = rng.choice(COEFFICIENTS, size=m)
    mu[0] = mu[0] or 0.5
    load, gap, origin, value = (
        rng.normal(size=n), 0.3 * rng.normal(size=m), 0.2 * rng.normal(size=(m, t)) * rng.integers(0, 2), np.zeros(k),
    )  # fmt: skip
    if redundant:
        gap[-1], origin[-1], mu[-1] = gap[twin], origin[twin], mu[twin]
    if around:
        # Eighths and slips along an axis: with a stiffness of integers the load is exact, and so is the answer.
        u, nu, pressed = rng.integers(-8, 9, n) / 8, rng.integers(-8, 9, k) / 8, rng.integers(4, 17, m) / 8
        slips, part, closed = rng.random(m) < 0.5, rng.integers(-7, 8, m) / 8, rng.random(m) < 0.7
        direction = np.eye(t)[rng.integers(0, t, m)] * rng.choice([-1.0, 1.0], size=m)[:, None]
        if redundant:
            slips[-1], closed[-1], direction[-1] = slips[twin], closed[twin], direction[twin]
        pressed = np.where(closed, pressed, 0.0)
        rubbed = (mu * pressed * np.where(slips, 1.0, part))[:, None] * direction
        moved = np.where(slips | ~closed, 0.5, 0.0)[:, None] * direction
        gap, origin = normal @ u + np.where(closed, 0.0, 0.375), (tangent @ u).reshape(m, t) - moved
        load = K @ u + normal.T @ pressed + tangent.T @ rubbed.ravel() + tie.T @ nu
        value = tie @ u
    return cq.ContactProblem(
        stiffness=K, load=load, normal=normal, gap=gap, tangent=tangent, friction=mu, slip_origin=origin,
        tie=tie if k else None, tie_value=value if k else None,
    )  # fmt: skip


def _dense(problem: cq.ContactProblem) -> NDArray[np.float64]:
    return np.asarray(problem.stiffness.toarray() if hasattr(problem.stiffness, "toarray") else problem.stiffness)


def _in_units(plain: cq.ContactProblem, units: Units) -> cq.ContactProblem:
    assert plain.tangent is not None
    assert plain.slip_origin is not None
    d, width = units.unknown, plain.slip_origin.shape[1]
    row, rows = units.row, np.repeat(units.row, width)
    return cq.ContactProblem(
        stiffness=_dense(plain) / np.outer(d, d) * units.force / units.length,
        load=plain.load / d * units.force,
        normal=plain.normal.toarray() / d * row[:, None],
        gap=plain.gap * row * units.length,
        tangent=plain.tangent.toarray() / d * rows[:, None],
        friction=plain.friction,
        slip_origin=plain.slip_origin * row[:, None] * units.length,
        tie=plain.tie.toarray() / d if plain.ties else None,
        tie_value=plain.tie_value * units.length if plain.ties else None,
    )


CONTACT_FAMILIES = {
    f"{name} {dimension}D": (dimension, missing, redundant, around, bad)
    for dimension in (2, 3)
    for name, missing, redundant, around, bad in (
        ("any", 0, False, False, False),
        ("made around an answer", 0, False, True, False),
        ("singular", 1, False, True, False),
        ("more singular", 2, False, False, False),
        ("redundant", 0, True, True, False),
        ("bad units", 0, False, False, True),
        ("singular, redundant, bad units", 1, True, True, True),
    )
}
LOCAL_FAMILIES = {
    f"local {name} {dimension}D": (dimension, deficient, skew, around)
    for dimension in (2, 3)
    for name, deficient, skew, around in (
        ("any", False, 0.0, False),
        ("unsymmetric", False, 0.3, True),
        ("rank-deficient", True, 0.0, True),
        ("rank-deficient, unsymmetric", True, 0.05, True),
    )
}
FAMILIES = (*CONTACT_FAMILIES, *LOCAL_FAMILIES)
# One contact far beyond all others, or every contact in a unit of its own.
FAR, SCALED, PRINTED = "far_gap", "scaled_contact", "printed_floating"
for _dimension in (2, 3):
    for _kind in (FAR, SCALED):
        CONTACT_FAMILIES[f"{_kind} {_dimension}D"] = (_dimension, 0, False, False, False)
        LOCAL_FAMILIES[f"local {_kind} {_dimension}D"] = (_dimension, False, 0.0, True)
        FAMILIES += (f"{_kind} {_dimension}D", f"local {_kind} {_dimension}D")
    for _kind in MAKERS:
        CONTACT_FAMILIES[f"{_kind} {_dimension}D"] = (_dimension, 0, False, True, True)
# In the order in which they came, since a family's place is a part of its seeds.
for _later in (tuple(MAKERS)[:5], tuple(MAKERS)[5:6], tuple(MAKERS)[6:]):
    FAMILIES += tuple(name for name in CONTACT_FAMILIES if name.split()[0] in _later)


def contact_problem(name: str, seed: int) -> Posed:
    dimension, missing, redundant, around, bad = CONTACT_FAMILIES[name]
    rng = np.random.default_rng([seed, FAMILIES.index(name)])
    made = MAKERS.get(name.split()[0])
    plain = made(rng, dimension) if made else _contact(rng, dimension, missing, redundant, around)
    n, m = plain.dimension, plain.contacts
    units = Units(np.ones(n), np.ones(m), 1.0, 1.0)
    if bad:
        units = Units(
            2.0 ** rng.integers(-12, 13, n), 2.0 ** rng.integers(-12, 13, m), 2.0 ** float(rng.integers(-20, 21)),
            2.0 ** float(rng.integers(-30, 31)),
        )  # fmt: skip
    if name.startswith(SCALED):
        units = Units(np.ones(n), own_units(rng, m), 1.0, 1.0)
    if name.startswith(PRINTED):  # as it was printed, in its own units
        return Posed(plain, plain, Units(np.ones(n), np.ones(m), 1.0, 1.0), around)
    if name.startswith(FAR):
        plain = with_far_contact(rng, plain)
        units = Units(np.ones(plain.dimension), np.ones(m + 1), 1.0, 1.0)
    return Posed(_in_units(plain, units), plain, units, around)


def own_units(rng: np.random.Generator, contacts: int) -> NDArray[np.float64]:
    """(m,) powers of two from 1e-8 to 1e8, of rows, gap and slip origin of every contact."""
    return np.asarray(2.0 ** rng.integers(-26, 27, contacts))


def with_far_contact(rng: np.random.Generator, near: cq.ContactProblem) -> cq.ContactProblem:
    """The problem with a contact that stays open, a million to a billion away, and a far slip origin: answers stay.

    It belongs to a body of its own, or, every other time, to the first unknowns of the others, beyond a stop that no
    answer reaches.
    """
    assert near.tangent is not None
    assert near.slip_origin is not None
    assert near.friction is not None
    width, n = near.slip_origin.shape[1], near.dimension
    alone = width + 1 if rng.random() < 0.5 else 0
    own = np.eye(n + alone)[n:] if alone else np.eye(n)[: width + 1]
    K = np.zeros((n + alone, n + alone))
    K[:n, :n], K[n:, n:] = _dense(near), np.eye(alone)

    def wider(rows: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.hstack([rows, np.zeros((len(rows), alone))])

    far = 2.0 ** float(rng.integers(20, 31))
    return cq.ContactProblem(
        stiffness=K,
        load=np.append(near.load, rng.normal(size=alone)),
        normal=np.vstack([wider(near.normal.toarray()), own[0]]),
        gap=np.append(near.gap, far),
        tangent=np.vstack([wider(near.tangent.toarray()), own[1 : width + 1]]),
        friction=np.append(near.friction, 0.5),
        slip_origin=np.vstack([near.slip_origin, np.full((1, width), -far)]),
        tie=wider(near.tie.toarray()) if near.ties else None,
        tie_value=near.tie_value if near.ties else None,
    )


def local_problem(name: str, seed: int) -> tuple[cq.LocalProblem, bool]:
    """A problem, and whether it was made around an answer."""
    dimension, deficient, skew, around = LOCAL_FAMILIES[name]
    rng = np.random.default_rng([seed, FAMILIES.index(name)])
    m = int(rng.integers(1, 5 if dimension == 2 else 8))
    size = m * dimension
    rank = max(1, size - int(rng.integers(1, max(2, size // 2)))) if deficient else size
    root = rng.integers(-3, 4, size=(size, rank)) / 3.0
    wrong = rng.normal(size=(size, size))
    W = root @ root.T + (0.0 if deficient else 0.2) * np.eye(size) + skew * (wrong - wrong.T)
    mu = rng.choice(COEFFICIENTS, size=m)
    q = rng.normal(size=size)
    if around:
        direction = rng.normal(size=(m, dimension - 1))
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        closed, slips = rng.random(m) < 0.7, rng.random(m) < 0.5
        pressed = np.where(closed, rng.uniform(0.5, 2.0, m), 0.0)
        rubbed = -(mu * pressed * np.where(slips, 1.0, rng.uniform(0.0, 0.9, m)))[:, None] * direction
        u = np.column_stack([np.where(closed, 0.0, 0.4), np.where(slips | ~closed, 0.5, 0.0)[:, None] * direction])
        q = u.ravel() - W @ np.column_stack([pressed, rubbed]).ravel()
    if SCALED in name:
        c = np.repeat(own_units(rng, m), dimension)
        W, q = W * np.outer(c, c), q * c
    if FAR in name:  # coupled to the first contact, and far beyond what it can be moved
        moves = np.hstack([rng.integers(-2, 3, (dimension, dimension)) / 2, np.zeros((dimension, size - dimension))])
        W = np.block([[W, W @ moves.T], [moves @ W, moves @ W @ moves.T + np.eye(dimension)]])
        mu, q = np.append(mu, 0.5), np.concatenate([q, 2.0 ** float(rng.integers(20, 31)) * np.ones(dimension)])
    return cq.LocalProblem(delassus=W, offset=q, friction=mu, dimension=dimension), around
