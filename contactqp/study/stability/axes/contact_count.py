"""The number of contacts: few of many that close, and half of them."""

from __future__ import annotations

from functools import partial

import numpy as np
import scipy.sparse as sp

from contactqp.model.problem import ContactProblem
from contactqp.study.stability.axis import Axis
from contactqp.study.stability.posed import Posed, SweptTruth

# Five nodes over a floor in 1: two of them lie on it. Few bits, so that K u and K u + E'λ are exact in doubles.
PRESSED, FORCE = (-0.5, -1.0, -1.0, -0.75, -0.5), (0.0, 3.0, 2.0, 0.0, 0.0)
LOOSE = (-0.25, -0.5, -0.25, 0.0, 0.25)
BLOCK = len(PRESSED)
FLOOR, FAR = 1.0, 64.0
# Blocks that are pressed where not all are.
FEW = 2
COUNTS = (1.0, 10.0, 100.0, 1_000.0, 10_000.0, 100_000.0)
# With more contacts than this the rows of the closed ones are not kept as a dense matrix.
EXAMINED = 100


def pose(count: float, *, pressed: int | None) -> Posed:
    """Strings of five nodes beside each other, each node over the floor; `pressed` of the strings, or all, lie on it.

    One contact is a single node. λ* and u* are chosen, and f = K u* + E'λ* has few bits.
    """
    m = int(count)
    if m == 1:
        return _posed(sp.csr_array([[2.0]]), np.array([-1.0]), np.array([3.0]), np.array([FLOOR]))
    strings = m // BLOCK
    lying = strings if pressed is None else min(pressed, strings)
    one = sp.diags([-np.ones(BLOCK - 1), 2 * np.ones(BLOCK), -np.ones(BLOCK - 1)], [-1, 0, 1])
    u = np.concatenate([np.tile(PRESSED, lying), np.tile(LOOSE, strings - lying)])
    force = np.concatenate([np.tile(FORCE, lying), np.zeros(BLOCK * (strings - lying))])
    gap = np.repeat([FLOOR, FAR], [BLOCK * lying, BLOCK * (strings - lying)])
    return _posed(sp.csr_array(sp.kron(sp.identity(strings), one)), u, force, gap)


def _posed(K: sp.csr_array, u: np.ndarray, force: np.ndarray, gap: np.ndarray) -> Posed:
    E = -sp.identity(len(u), format="csr")
    problem = ContactProblem(K if len(u) > BLOCK else K.toarray(), K @ u + E.T @ force, E, gap)
    closed = np.flatnonzero(force)
    source = "constructed of numbers of few bits: f = K u* + E'λ* is exact"
    truth = SweptTruth(problem, u, force, np.zeros(0), source, held=True)
    rows = E[closed].toarray() if len(u) <= EXAMINED else None
    return Posed(problem, truth, (), tuple(int(i) for i in closed), rows, rows)


CONTACTS = Axis(
    name="contacts",
    title="Number of contacts, few of them closed",
    quantity="contacts [1]",
    values=COUNTS,
    pose=partial(pose, pressed=FEW),
    about="Strings over a floor, of which two lie on it and all others hang far above it.",
)

CLOSED_CONTACTS = Axis(
    name="closed-contacts",
    title="Number of contacts, two of five closed",
    quantity="contacts [1]",
    values=COUNTS,
    pose=partial(pose, pressed=None),
    about="Strings that all lie on the floor: two of five contacts are closed.",
    largest=1_000.0,
    why_largest="contacts that may close are condensed onto as dense matrices, and 10 000 of them take minutes",
)
