"""Whether a small local problem in the plane has an answer at all, in rational numbers: nothing is rounded."""

from __future__ import annotations

import itertools
from fractions import Fraction
from typing import Any

import numpy as np

from contactqp.model.local_problem import LocalProblem
from contactqp.model.statuses import OPEN, SLIP_BACK, SLIP_ON, STICK
from contactqp.solving.friction.exact_algebra import ONE, ZERO, Region, Row, solutions


def has_local_equilibrium(problem: LocalProblem) -> bool:
    """Whether some forces (r, l) satisfy V'r + R l + s = 0 and, with u = W r + V l + q, Coulomb's law at every contact.

    Every combination of open, stick and slip either way is a linear system and a list of signs, decided exactly; the
    problem is in the plane, and there are 4^m of them.
    """
    m, p = problem.contacts, problem.joints
    W, V, R = (_fractions(matrix) for matrix in (problem.delassus, problem.bilateral, problem.bilateral_delassus))
    q, s = _row(problem.offset), _row(problem.bilateral_offset)
    mu = _row(problem.friction)
    joints = [[*(V[i][j] for i in range(2 * m)), *R[j], s[j]] for j in range(p)]
    velocity = [[*W[i], *V[i], q[i]] for i in range(2 * m)]  # forms in (r, l), their constant last
    force = [[ONE if j == i else ZERO for j in range(2 * m + p + 1)] for i in range(2 * m)]
    for states in itertools.product((OPEN, STICK, SLIP_BACK, SLIP_ON), repeat=m):
        zero, signs = list(joints), list[Row]()
        for i, state in enumerate(states):
            push, rub, opens, slips = force[2 * i], force[2 * i + 1], velocity[2 * i], velocity[2 * i + 1]
            if state == OPEN:
                zero += [push, rub]
                signs.append(opens)
                continue
            zero += [opens, slips if state == STICK else _sum(rub, push, state * mu[i])]
            signs.append(push)
            signs += [_sum([-x for x in rub], push, mu[i]), _sum(rub, push, mu[i])] if state == STICK else []
            signs += [] if state == STICK else [[state * x for x in slips]]
        found = solutions([[*row[:-1], -row[-1]] for row in zero], 2 * m + p)
        if found is None:
            continue
        images = [(value + sign[-1], slope) for sign in signs for value, slope in [found.image(sign[:-1])]]
        if not Region(images, len(found.free)).empty:
            return True
    return False


def _sum(one: Row, other: Row, factor: Fraction) -> Row:
    return [x + factor * y for x, y in zip(one, other, strict=True)]


def _fractions(matrix: Any) -> list[Row]:
    dense = matrix.toarray() if hasattr(matrix, "toarray") else np.asarray(matrix)
    return [_row(row) for row in dense]


def _row(values: Any) -> Row:
    return [Fraction(float(x)) for x in np.asarray(values).ravel()]
