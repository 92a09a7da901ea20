"""What CalculiX prints at nodes: displacements, forces, contact pressures, at one time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

DISPLACEMENT, FORCE, CONTACT = "displacement", "force", "contact"


@dataclass(frozen=True, eq=False)
class NodalField:
    """One field at one time; `kind` is one of the above, or CalculiX's own name of it."""

    kind: str
    components: tuple[str, ...]  # CalculiX's own names: D1, D2, D3; COPEN, ..., CPRESS, ...
    time: float
    nodes: NDArray[np.int64]  # (N,) as printed
    values: NDArray[np.float64]  # (N, c)

    def component(self, name: str) -> NDArray[np.float64] | None:
        """(N,) one component, None where the field has no such one."""
        return self.values[:, self.components.index(name)] if name in self.components else None
