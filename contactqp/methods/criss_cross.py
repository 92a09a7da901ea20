"""One contact at a time, by least index: the criss-cross method, for sets on which the textbook's loop goes in circles.

Of the contacts whose sign is wrong, the one of least index changes sides. Where its row follows from those of closed contacts, the
closed contact of least index that stands in its way opens for it; where opening it would let a body go, the open contact of least index
that the body would run into closes instead. No set comes twice in exact arithmetic (Klafszky and Terlaky 1992; den
Hertog, Roos and Terlaky 1993), redundant contacts and floating bodies included; without exchanges it is Murty's method (1974).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.errors import NotConverged
from contactqp.factorization import null_space
from contactqp.methods.textbook_algebra import Indices, Mask, SingularSystem
from contactqp.problem import ContactProblem, Vector

# Parts of a dependent row, and approaches of a unit motion, below this are rounding.
NEGLIGIBLE = 1e-10


@dataclass(frozen=True, eq=False)
class Step:
    """The equality problem's answer for one set of closed contacts."""

    displacement: Vector  # (n,)
    normal_force: Vector  # (m,), zero on the open contacts
    tie_force: Vector  # (k,)
    bound: Mask  # (m,) the closed contacts that took part; dependent rows may leave some out


# A mask of the closed contacts, and an order of preference among them should their rows be dependent.
Enforcement = Callable[[Mask, Indices], Step]


def change_one(name: str, problem: ContactProblem, enforce: Enforcement, closed: Mask, wrong: Mask) -> Step:
    """The step on the next set: the `wrong` contact of least index changes sides, with an exchange where it must.

    Parameters
    ----------
    closed : (m,) mask
        A set with independent rows that holds the bodies.

    Raises
    ------
    NotConverged
        No contact can be exchanged: the constraints conflict, or nothing stops a body that the load drives.
    """
    changing = int(np.flatnonzero(wrong)[0])
    order = np.argsort(np.arange(len(closed)) == changing, kind="stable")  # in doubt, it is the one left out
    flipped = closed ^ wrong & (np.arange(len(closed)) == changing)
    if closed[changing]:
        try:
            return enforce(flipped, order)
        except SingularSystem:
            other = _next_stop(name, problem, closed, changing)
    else:
        step = enforce(flipped, order)
        if step.bound[changing]:
            return step
        other = _in_the_way(name, problem, closed, changing)
    flipped[other] = not flipped[other]
    return enforce(flipped, order)


def _in_the_way(name: str, problem: ContactProblem, closed: Mask, entering: int) -> int:
    """With E_i = c'[E_B; A], the least k in B with c_k > 0: without giving way there, E_i u cannot decrease."""
    B = np.flatnonzero(closed)
    rows = _unit(sp.vstack([problem.normal[B], problem.tie]))
    row = _unit(problem.normal[[entering]])[0]
    weights = np.linalg.lstsq(rows.T, row, rcond=None)[0][: B.size]
    positive = B[weights > NEGLIGIBLE]
    if positive.size == 0:
        raise NotConverged(f"{name}: {problem.contact_name(entering)} penetrates and no closed contact can give way")
    return int(positive[0])


def _next_stop(name: str, problem: ContactProblem, closed: Mask, leaving: int) -> int:
    """The open contact of least index that approaches in the rigid motion by which a body leaves contact i."""
    Z = np.linalg.qr(null_space(problem.stiffness))[0]
    held = closed.copy()
    held[leaving] = False
    rows = (
        np.vstack(
            [_unit(sp.vstack([problem.tie, problem.normal[np.flatnonzero(held)]])), _unit(problem.normal[[leaving]])]
        )
        @ Z
    )
    opens = np.append(np.zeros(len(rows) - 1), -1.0)
    coordinates = np.linalg.lstsq(rows, opens, rcond=NEGLIGIBLE)[0]
    if np.linalg.norm(rows @ coordinates - opens) > np.sqrt(NEGLIGIBLE):
        raise NotConverged(f"{name}: the system of equations is singular without {problem.contact_name(leaving)}")
    motion = Z @ (coordinates / np.linalg.norm(coordinates))
    approach = _unit(problem.normal) @ motion
    ahead = np.flatnonzero(~closed & (approach > NEGLIGIBLE))
    if ahead.size == 0:
        raise NotConverged(
            f"{name}: nothing stops the body that the load drives away from {problem.contact_name(leaving)}"
        )
    return int(ahead[0])


def _unit(rows: sp.spmatrix) -> NDArray[np.float64]:
    dense = np.asarray(rows.toarray())
    return dense / np.linalg.norm(dense, axis=1, keepdims=True)
