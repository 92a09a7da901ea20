"""The mass of a scene: exact for nodes, by quadrature for bodies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.elements import point_mass
from contactqp.elements.exact import Number, Numbers
from contactqp.elements.loads import bar_mass, solid_mass
from contactqp.scene.building import NodeModel, assembled
from contactqp.scene.exact_numbers import displacements, ends, value
from contactqp.scene.unknowns import of_node

if TYPE_CHECKING:
    from contactqp.scene.models import Model
    from contactqp.scene.schema import SceneData


def exact_mass(scene: SceneData) -> Mapping[tuple[str, str], Number]:
    """M on all unknowns by their names, in the scene's units; what is zero is left out."""
    return assembled(_element_masses(scene))


def _element_masses(scene: SceneData) -> Iterator[tuple[tuple[str, ...], Numbers]]:
    lumped = scene.motion is not None and scene.motion.mass == "lumped"
    for bar in scene.bars:
        if bar.density is not None:
            for segment in bar.segments:
                start, end = ends(scene, segment)
                density, area = value(scene, bar.density), value(scene, bar.area)
                yield displacements(scene, segment), bar_mass(density, area, start, end, lumped)
    for mass in scene.masses:
        yield of_node(scene, mass.node), point_mass.inertia(value(scene, mass.mass), len(scene.axes))


def mass_on_all(model: Model) -> Any:
    """M on all unknowns, free or not, CSR."""
    if not isinstance(model, NodeModel):
        motion = model.scene.motion
        lumped = motion is not None and motion.mass == "lumped"
        parts = [solid_mass(model.structure.solid(body.name), lumped) for body in model.structure.bodies]
        return sp.csr_array(sp.block_diag(parts, format="csr"))
    place = model.exact.unknowns.place
    matrix = sp.lil_array((len(place), len(place)))
    for (i, j), entry in exact_mass(model.scene).items():
        matrix[place[i], place[j]] = float(entry)
    return matrix.tocsr()


def free_places(model: Model) -> NDArray[np.int64]:
    """Where the free unknowns stand among all."""
    if not isinstance(model, NodeModel):
        return model.system.free
    unknowns = model.exact.unknowns
    return np.array([unknowns.place[name] for name in unknowns.free], dtype=np.int64)
