"""Proximal points of Coulomb's law, each by semismooth Newton (Acary, Bremond and Huber 2018, section on PPA).

    r <- the forces of (W + a I) r + (q - a r_old)

A step is a regular problem however singular W is; its fixed points are the answers of W. The weight a falls while
Newton's method finds proximal points quickly, and grows where it does not.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator

import numpy as np
import scipy.sparse as sp

from contactqp.solving.friction.alart_curnier import newton
from contactqp.solving.friction.iterate import Iterate
from contactqp.solving.friction.local_form import LocalForm

# The weight, contacts having a compliance of one: at first, at least, and at most before it is given up.
FIRST, LEAST, MOST = 1e-2, 1e-9, 1e3
# Newton's steps for one proximal point, and those after which the weight halves; the weight grows by this factor.
STEPS, FEW, GROWTH = 25, 6, 4.0
# A proximal point is found where its own residual has fallen to this part.
FOUND = 1e-2
ROUNDING = 1e-14


def proximal_points(form: LocalForm, start: Iterate) -> Iterator[Iterate]:
    """Iterates, one a proximal point, until Newton's method finds none at any weight."""
    here, weight, count = start, FIRST, 0
    while weight <= MOST:
        nearby = _regular(form, here, weight)
        owed = Iterate.at(nearby, here.force, here.joint_force)
        found = newton(nearby, owed, STEPS, target=max(1e-3 * owed.error, ROUNDING))
        if found.error <= max(FOUND * owed.error, 10 * ROUNDING):
            weight = max(weight / 2, LEAST) if found.iterations <= FEW else weight
            count += 1
            here = Iterate.at(form, found.force, found.joint_force, count)
            yield here
        else:
            weight *= GROWTH


def _regular(form: LocalForm, centre: Iterate, weight: float) -> LocalForm:
    """The problem of the proximal point of `centre`."""
    size = form.m * form.d
    nearby = copy.copy(form)
    nearby.W = form.W + weight * (sp.identity(size, format="csr") if form.sparse else np.eye(size))
    nearby.q = form.q - weight * centre.force.ravel()
    return nearby
