"""Every answer of a small local problem in the plane: all combinations of open, stick, slip either way.

With r_N = l_N, r_T = -l_T, u_N = g - N x and u_T = T x - o, the local form u = W r + q + V l is the base and slope of
`contactqp.solving.friction.enumeration`, and V'r + R l + s = 0 is what always holds. W need not be symmetric.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from contactqp.errors import Unsupported
from contactqp.model.arrays import Vector
from contactqp.solving.friction.alart_curnier import newton
from contactqp.solving.friction.enumeration import Combinations, refuse_many
from contactqp.solving.friction.iterate import Iterate
from contactqp.solving.friction.local_form import LocalForm

# Of the typical velocity, what rounding may leave of another.
NOTHING = 1e-12
# Answers whose forces move every contact alike, to this part of what the forces make of it, are one.
SAME = 1e-8


def enumerated(form: LocalForm) -> Iterator[Iterate]:
    """Forces of combinations whose signs may hold, finished by Newton's method; velocities come but once.

    Raises
    ------
    Unsupported
        The problem is in space, or has more than eight contacts.
    """
    if (reason := not_enumerated(form)) is not None:
        raise Unsupported(reason)
    seen: list[tuple[Vector, Vector]] = []  # W r + V l, and the sizes that its entries are made of
    for count, y in enumerate(y for _, y in _combinations(form).plausible()):
        force = np.stack([y[: form.m], -y[form.m : 2 * form.m]], axis=1)
        found = newton(form, Iterate.at(form, force, y[2 * form.m :]))
        answers = form.velocity(found.force, found.joint_force).ravel() - form.q
        sizes = abs(form.W) @ abs(found.force).ravel() + abs(form.V) @ abs(found.joint_force)
        # Where the law is missed by more than velocities differ, a better one may follow.
        if found.error <= SAME * max(1.0, float(np.max(sizes, initial=0.0))):
            if any(np.all(abs(answers - u) <= SAME * np.maximum(sizes, size)) for u, size in seen):
                continue
            seen.append((answers, sizes))
        yield Iterate(found.force, found.joint_force, found.error, count + 1)


def not_enumerated(form: LocalForm) -> str | None:
    """Why the combinations of a problem are not listed, or None."""
    if form.d > 2:
        return "enumeration: the problem is in space; slip directions in space cannot be listed"
    return refuse_many(form.m)


def _combinations(form: LocalForm) -> Combinations:
    W = form.W.toarray() if form.sparse else form.W
    signs = np.r_[np.ones(form.m), -np.ones(form.m)]
    order = np.r_[2 * np.arange(form.m), 2 * np.arange(form.m) + 1]  # all normals, then all tangents
    V = form.V[order]
    # u in the order and the signs of r = (l_N, -l_T); then N x - g = -u_N, T x - o = u_T.
    compliance = np.hstack([W[np.ix_(order, order)] * signs, V])
    return Combinations(
        coefficient=form.mu,
        base=-signs * form.q[order],
        slope=-signs[:, None] * compliance,
        target=np.zeros(2 * form.m),
        fixed=np.hstack([V.T * signs, form.R]),
        fixed_right=-form.s,
        nothing=NOTHING,
    )
