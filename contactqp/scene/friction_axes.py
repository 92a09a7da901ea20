"""Friction forces along the axes of a scene."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contactqp.analysis.large.deformation import LargeSolution
from contactqp.elements.obstacle import tangent_frames
from contactqp.model.solution import Solution
from contactqp.scene.building import NodeModel
from contactqp.scene.obstacles import obstacle


def friction_along_axes(model: NodeModel, solution: Solution) -> NDArray[np.float64]:
    """lambda_T of each contact along the axes, (m, d), with tangents that at large deformations are those of now."""
    force = solution.friction_force
    if not isinstance(solution, LargeSolution) or force is None or solution.position is None:
        return model.along_axes(force)
    vectors = np.zeros(solution.position.shape)
    for i, contact in enumerate(model.scene.contacts):
        normals = obstacle(model.scene, str(contact.obstacle)).normals(solution.position[i : i + 1])
        vectors[i] = force[i] @ tangent_frames(np.asarray(normals, dtype=float))[0]
    return vectors
