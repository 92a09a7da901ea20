"""The smallest problem that still shows a finding."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

import contactqp as cq
from benchmarks.adversary.grammar import in_units
from benchmarks.friction_families import Posed, Units

# Problems that are tried; each is judged as the first was.
TRIES = 80


def shrunk(posed: Posed, still: Callable[[Posed], bool]) -> Posed:
    """Take away units, contacts, ties and unknowns while `still` says that the finding is there."""
    left = TRIES
    smaller = True
    while smaller and left > 0:
        smaller = False
        for tried in _smaller(posed):
            left -= 1
            if left < 0:
                break
            if still(tried):
                posed, smaller = tried, True
                break
    return posed


def _smaller(posed: Posed) -> Iterator[Posed]:
    plain, units = posed.plain, posed.units
    n, m, k = plain.dimension, plain.contacts, plain.ties
    ones = Units(np.ones(n), np.ones(m), 1.0, 1.0)
    if not all(
        np.array_equal(getattr(units, name), getattr(ones, name)) for name in ("unknown", "row", "length", "force")
    ):
        yield in_units(plain, ones, posed.solvable)
        yield in_units(plain, replace(units, unknown=ones.unknown, row=ones.row), posed.solvable)
    for i in range(m):
        kept = np.delete(np.arange(m), i)
        yield _posed(plain.with_contacts(kept), replace(units, row=units.row[kept]), posed)
    for i in range(k):
        yield _posed(plain.with_ties(np.delete(np.arange(k), i)), units, posed)
    for j in range(n if n > 1 else 0):
        kept = np.delete(np.arange(n), j)
        yield _posed(_without_unknown(plain, kept), replace(units, unknown=units.unknown[kept]), posed)
    if np.any(plain.load):
        for j in np.flatnonzero(plain.load):
            yield _posed(plain.replace(load=np.where(np.arange(n) == j, 0.0, plain.load)), units, posed)


def _posed(plain: cq.ContactProblem, units: Units, before: Posed) -> Posed:
    return in_units(plain, units, False) if not before.solvable else in_units(plain, units, before.solvable)


def _without_unknown(plain: cq.ContactProblem, kept: np.ndarray) -> cq.ContactProblem:
    K = np.asarray(plain.stiffness)
    return cq.ContactProblem(
        stiffness=K[np.ix_(kept, kept)], load=plain.load[kept], normal=plain.normal.toarray()[:, kept], gap=plain.gap,
        tangent=None if plain.tangent is None else plain.tangent.toarray()[:, kept], friction=plain.friction,
        slip_origin=plain.slip_origin, tie=plain.tie.toarray()[:, kept] if plain.ties else None,
        tie_value=plain.tie_value if plain.ties else None,
    )  # fmt: skip
