"""The error of a finite-element field in the H1 seminorm, and the order at which errors fall."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.mesh import Mesh
from contactqp.elements.reference_elements import at_rule

Vector = NDArray[np.float64]


def h1_error(mesh: Mesh, values: Vector, gradient: Callable[[Vector], Vector]) -> float:
    """sqrt(integral of |grad v_h - grad v|^2 / integral of |grad v|^2) [-].

    Parameters
    ----------
    values : (N, c) array
        v_h at the nodes.
    gradient : callable
        (p, d) points to dv_c/dx_a, (p, c, d).
    """
    missed = whole = 0.0
    for block in mesh.blocks:
        geometry = at_rule(block, mesh.points, block.kind.fine_rule)
        found = np.einsum("eqnd,enc->eqcd", geometry.gradient, values[block.nodes])
        exact = gradient(geometry.positions.reshape(-1, mesh.dimension)).reshape(found.shape)
        weights = geometry.determinant * block.kind.fine_rule.weights
        missed += float((weights * ((found - exact) ** 2).sum(axis=(2, 3))).sum())
        whole += float((weights * (exact**2).sum(axis=(2, 3))).sum())
    return float(np.sqrt(missed / whole))


def order(sizes: Sequence[float], errors: Sequence[float]) -> float:
    """The slope of log(error) over log(element size), fitted to all meshes."""
    return float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])
