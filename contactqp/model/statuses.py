"""The states of contacts: one coding for all that solves, enumerates, follows and proves them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from enum import IntEnum
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray


class ContactState(IntEnum):
    """What a contact does; in the plane it slips with s < 0 (SLIP_BACK) or s > 0 (SLIP_ON).

    The product of a slipping state with mu l_N is the friction force in the plane. CLOSED is a closed contact without
    friction, where sticking and slipping are not told apart.
    """

    SLIP_BACK = -1
    OPEN = 0
    SLIP_ON = 1
    STICK = 2
    CLOSED = 3


OPEN, STICK, CLOSED = ContactState.OPEN, ContactState.STICK, ContactState.CLOSED
SLIP_BACK, SLIP_ON = ContactState.SLIP_BACK, ContactState.SLIP_ON
Status = NDArray[np.int8]


def plane_states(friction: Any) -> tuple[int, ...]:
    """Return the states that a contact in the plane can be in, its coefficient of friction a float or a Fraction.

    Without friction a closed contact neither sticks nor slips: SLIP_ON, whose friction is zero, stands for it.
    """
    return (OPEN, STICK, SLIP_BACK, SLIP_ON) if friction > 0 else (OPEN, SLIP_ON)


def all_combinations(friction: Iterable[Any]) -> Iterator[tuple[int, ...]]:
    """Return every combination of the states of contacts in the plane, of coefficients of floats or Fractions (m,)."""
    return product(*(plane_states(mu) for mu in friction))


def status_names(status: Status) -> NDArray[np.str_]:
    """(m,) of open, stick, slip."""
    return np.select([status == OPEN, status == STICK], ["open", "stick"], "slip").astype("<U8")
