"""What the quantities of a scene of nodes, bars and springs are read off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from contactqp.model.solution import Solution
from contactqp.scene.building import ExactProblem, NodeModel
from contactqp.scene.instant import Instant
from contactqp.scene.schema import SceneData
from contactqp.scene.unknowns import of_node


@dataclass(frozen=True, eq=False)
class Answer:
    """A scene's solution at one instant, and its load path if it has one."""

    model: NodeModel
    solution: Solution
    instant: Instant

    @property
    def scene(self) -> SceneData:
        return self.model.scene

    @property
    def exact(self) -> ExactProblem:
        return self.model.exact

    def displacement(self, unknown: str) -> float:
        """Of any unknown, fixed ones included."""
        if unknown in self.exact.unknowns.fixed:
            return 0.0
        return float(self.solution.displacement[self.exact.unknowns.free.index(unknown)])

    def of_node(self, node: str) -> np.ndarray[Any, Any]:
        return np.array([self.displacement(name) for name in of_node(self.scene, node)])
