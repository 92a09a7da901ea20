"""What a contact with friction in the plane can do, as numbers: its product with mu l_N is the friction of a slip."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

# A contact is open, sticks, or slips with s < 0 or s > 0.
OPEN, STICK, SLIP_BACK, SLIP_ON = 0, 2, -1, 1
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
