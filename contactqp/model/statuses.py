"""What a contact with friction in the plane can do, as numbers: its product with mu l_N is the friction of a slip."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# A contact is open, sticks, or slips with s < 0 or s > 0.
OPEN, STICK, SLIP_BACK, SLIP_ON = 0, 2, -1, 1
Status = NDArray[np.int8]


def status_names(status: Status) -> NDArray[np.str_]:
    """(m,) of open, stick, slip."""
    return np.select([status == OPEN, status == STICK], ["open", "stick"], "slip").astype("<U8")
