"""The fields of a solution of bars, springs, beams, strings and matrices: displacements of nodes, forces and gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactqp.model.arrays import Array
from contactqp.model.problem import Units


@dataclass(frozen=True, eq=False)
class Member:
    """One element as a line of k points.

    Attributes
    ----------
    kind : str
        "bar", "spring", "beam", "string", "matrix", or what another kind of elements is called.
    nodes : tuple of int
        Those it connects, as places in FrameFields.nodes; a single one is connected to the ground.
    path, displacement : (k, d) arrays
        Points along the element and what they move by [length].
    """

    kind: str
    nodes: tuple[int, ...]
    path: Array
    displacement: Array


@dataclass(frozen=True, eq=False)
class FrameContact:
    """A node and an obstacle, or two nodes.

    Attributes
    ----------
    name : str
    nodes : tuple of int
        One against an obstacle, or two.
    push : (1 or 2, d) array
        Where a unit of force pushes each of the nodes, -E_N [-].
    force : float
        lambda_N, positive in compression [force].
    gap, initial_gap : float
        Under the load and before it, positive when open [length].
    status : str
        "open", "closed", "grazing", "stick" or "slip".
    """

    name: str
    nodes: tuple[int, ...]
    push: Array
    force: float
    gap: float
    initial_gap: float
    status: str


@dataclass(frozen=True, eq=False)
class FrameFields:
    """All nodes, members and contacts of one solution; N nodes in d dimensions, d = 1, 2 or 3.

    Attributes
    ----------
    axes : tuple of str
        Which of x, y, z the d components are.
    nodes : tuple of str
        Names.
    position, displacement : (N, d) arrays [length]
    held : (N, d) array of bool
        Displacements that a support holds.
    members, contacts, units
    """

    axes: tuple[str, ...]
    nodes: tuple[str, ...]
    position: Array
    displacement: Array
    held: NDArray[np.bool_]
    members: tuple[Member, ...]
    contacts: tuple[FrameContact, ...]
    units: Units
