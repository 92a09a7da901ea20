"""Types of arrays, by what they hold; shapes stand beside each field and in each docstring."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Vector = NDArray[np.float64]  # one number an unknown, contact, tie
Index = NDArray[np.int64]
Indices = NDArray[np.intp]  # as NumPy's own functions return them
Mask = NDArray[np.bool_]
