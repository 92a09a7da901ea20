"""Bodies that several tests share."""

from __future__ import annotations

import numpy as np

from contactqp.elements.material import Material
from contactqp.elements.mesh import Mesh
from contactqp.elements.reference_elements import KINDS, REFERENCES
from contactqp.elements.shapes import box, rectangle
from contactqp.elements.solid import Body

STEEL = Material(modulus=210.0, poisson=0.3, density=7.85, name="steel")
PLANE = [kind for kind in KINDS if REFERENCES[kind].dimension == 2]
SOLID = [kind for kind in KINDS if REFERENCES[kind].dimension == 3]
MODELS = [(kind, model) for kind in PLANE for model in ("plane-strain", "plane-stress", "axisymmetric")]
MODELS += [(kind, "3d") for kind in SOLID]


def distorted(kind: str, cells: int = 2, amount: float = 0.05) -> Mesh:
    """A block away from the origin whose nodes, all of them, are pushed about: edges of quadratic kinds are curved."""
    random = np.random.default_rng(7)
    if REFERENCES[kind].dimension == 2:
        mesh = rectangle(2.0, 1.5, (cells + 1, cells), kind, corner=(1.0, -0.5))
    else:
        mesh = box((1.0, 1.2, 0.9), (cells, cells, cells), kind, corner=(1.0, -0.5, 0.3))
    return mesh.mapped(lambda x: x + amount / cells * random.uniform(-1, 1, x.shape) + 0.05 * np.sin(2 * x[:, ::-1]))


def body(kind: str, model: str, **options: float) -> Body:
    return Body(distorted(kind), STEEL, model, **options)
