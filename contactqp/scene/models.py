"""From a scene to what it is computed with."""

from __future__ import annotations

from typing import TYPE_CHECKING

from contactqp.linalg.stages import BUILD, stage
from contactqp.scene.building import NodeModel, exact_problem

if TYPE_CHECKING:
    from contactqp.scene.bodies import BodyModel
    from contactqp.scene.schema import SceneData

    Model = NodeModel | BodyModel


def build(scene: SceneData) -> Model:
    """Nodes with bars and springs in exact numbers, or elastic bodies and membranes in floats.

    Raises
    ------
    SceneError
        Of bodies: a mesh, a set, a load or a pair of sides that is no good; the message starts with its key.
    BackendMissing
        A mesh file that needs meshlane, which is not installed.
    """
    with stage(BUILD):
        if scene.meshed:
            from contactqp.scene.bodies import body_model

            return body_model(scene)
        return NodeModel(scene, exact_problem(scene))
