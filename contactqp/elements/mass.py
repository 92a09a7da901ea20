"""Mass matrices: consistent, the integral of rho N_i N_j, and lumped, a diagonal of the same masses."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.elements.assembly import assemble, pattern
from contactqp.elements.exact import Number, Numbers, square_root, squared_length
from contactqp.elements.geometry import Block
from contactqp.elements.solid import Body
from contactqp.errors import InvalidProblem


def bar_mass(density: Number, area: Number, start: Any, end: Any, lumped: bool = False) -> Numbers:
    """M = (rho A L / 6) [[2 I, I], [I, 2 I]], lumped (rho A L / 2) [[I, 0], [0, I]].

    Parameters
    ----------
    density, area : Fraction or float
        rho [force time^2 / length^4], A [length^2].
    start, end : (dimension,) arrays
        The two nodes [length].
    lumped : bool

    Returns
    -------
    (2 dimension, 2 dimension) array [force time^2 / length] on (u_start, u_end): a bar has inertia along and across
    itself. Exact where all data are and L is rational.

    >>> bar_mass(6.0, 1.0, [0.0], [2.0]).tolist()
    [[4.0, 2.0], [2.0, 4.0]]
    """
    d = np.asarray(end) - np.asarray(start)
    part = density * area * square_root(squared_length(d)) / 6
    weights = np.array([[3, 0], [0, 3]] if lumped else [[2, 1], [1, 2]])
    M: Numbers = part * np.kron(weights, np.eye(len(d), dtype=int))
    return M


def solid_mass(body: Body, lumped: bool = False) -> Any:
    """M of an elastic body: (N d, N d) CSC, symmetric positive definite [force time^2 / length].

    Consistent, M_ij = integral of rho N_i N_j, with the body's thickness, or of the full circle. Lumped, the diagonal
    of each element's consistent matrix, scaled to the element's mass: positive for every kind of element, where sums of
    rows are not (Hinton, Rock and Zienkiewicz 1976). Of linear triangles, tetrahedra and rectangles both are the same.

    Raises
    ------
    InvalidProblem
        The material has no density.
    """
    if not body.material.density > 0:
        raise InvalidProblem(f"{body.name}: a mass needs a density > 0, {body.material.name} has none")
    nodes = len(body.mesh.points)
    blocks = [_element_masses(body, block) for block in body.mesh.blocks]
    if lumped:
        total = np.zeros(nodes)
        for block, masses in zip(body.mesh.blocks, blocks, strict=True):
            share = np.einsum("eii->ei", masses)
            share = share * (masses.sum(axis=(1, 2)) / share.sum(axis=1))[:, None]
            total += np.bincount(block.nodes.ravel(), weights=share.ravel(), minlength=nodes)
        scalar = sp.diags(total)
    else:
        where = pattern([block.nodes for block in body.mesh.blocks], nodes)
        scalar = assemble(where, np.concatenate([masses.ravel() for masses in blocks])[np.newaxis, np.newaxis])
    return sp.csc_array(sp.kron(scalar, sp.identity(body.dimension)))


def _element_masses(body: Body, block: Block) -> NDArray[np.float64]:
    """The integrals of rho N_i N_j over each element, (E, n, n), symmetric to the last digit."""
    geometry, weights = body.integration(block, block.kind.fine_rule)
    weighted = weights[:, :, None] * (body.material.density * geometry.shape)
    masses = np.matmul(np.swapaxes(weighted, 1, 2), geometry.shape)
    return np.asarray((masses + np.swapaxes(masses, 1, 2)) / 2)
