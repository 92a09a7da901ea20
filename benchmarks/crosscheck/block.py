"""The block: 80 x 30 x 20 mm of steel, 8 x 3 x 2 trilinear hexahedra, held at x = 0, over a rigid floor at y = 0.

The bottom is curved, its nodes stand 2e-3 + 8e-3 (x/80)^2 + 2e-3 (z/20)^2 mm above the floor, so that the floor's
normal is exactly y and the gaps are exactly the nodes' heights. A pressure of 100 (1 - 1.4 x/80) N/mm^2 on the top
presses near the wall and pulls at the other end: some nodes close, the far edge lifts off. Trilinear elements with
2 x 2 x 2 Gauss points are the same in CalculiX (C3D8), GetFEM and scikit-fem: the stiffness that CalculiX stores equals
ours to 1e-12, so that only contact is judged.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import scipy.sparse as sp

import contactqp as cq

YOUNG, POISSON = 210_000.0, 0.3  # N/mm^2
LENGTH, HEIGHT, DEPTH = 80.0, 30.0, 20.0  # mm
CELLS = (8, 3, 2)
PRESSURE, PULL = 100.0, 1.4
FRICTION = 0.2
SMALL = 100.0
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])


@dataclass(frozen=True, eq=False)
class Block:
    """Mesh and contact problem; nodes are numbered from 1, unknowns are called node.axis, contacts by their node."""

    points: np.ndarray  # (N, 3) [mm]
    cells: np.ndarray  # (C, 8) nodes from 0, in the order of CORNERS
    free: np.ndarray  # (n, 2) node from 0 and axis of every unknown
    bottom: np.ndarray  # (m,) nodes from 0 that may touch
    area: np.ndarray  # (m,) [mm^2] of the bottom around each of them
    problem: cq.ContactProblem


@cache
def block() -> Block:
    """The block without friction."""
    nx, ny, nz = CELLS
    grid = np.array([(i, j, k) for k in range(nz + 1) for j in range(ny + 1) for i in range(nx + 1)])
    number = {tuple(place): at for at, place in enumerate(grid)}
    points = _points(grid)
    corners = [(i, j, k) for k in range(nz) for j in range(ny) for i in range(nx)]
    cells = np.array([[number[tuple(np.add(corner, c))] for c in CORNERS] for corner in corners])
    free = np.argwhere(np.repeat(grid[:, :1] > 0, 3, axis=1))
    bottom = np.flatnonzero((grid[:, 1] == 0) & (grid[:, 0] > 0))
    area = _areas(grid)
    load = np.zeros((len(grid), 3))
    top = grid[:, 1] == ny
    load[top, 1] = -PRESSURE * (1 - PULL * points[top, 0] / LENGTH) * area[top]
    place = {(node, axis): j for j, (node, axis) in enumerate(map(tuple, free))}
    normal = sp.lil_matrix((len(bottom), len(free)))
    for i, node in enumerate(bottom):
        normal[i, place[node, 1]] = -1.0  # downwards is towards the floor
    problem = cq.ContactProblem(
        stiffness=_stiffness(points, cells, free),
        load=load[free[:, 0], free[:, 1]],
        normal=normal.tocsr(),
        gap=points[bottom, 1],
        dof_names=[f"{node + 1}.{axis + 1}" for node, axis in free],
        contact_names=[f"node {node + 1}" for node in bottom],
        units={"length": "mm", "force": "N"},
    )
    return Block(points, cells, free, bottom, area[bottom], problem)


@cache
def block_with_friction() -> Block:
    """The same with Coulomb friction on the floor: slips along x and z."""
    plain = block()
    place = {(node, axis): j for j, (node, axis) in enumerate(map(tuple, plain.free))}
    tangent = sp.lil_matrix((2 * len(plain.bottom), len(plain.free)))
    for i, node in enumerate(plain.bottom):
        for row, axis in enumerate((0, 2)):
            tangent[2 * i + row, place[node, axis]] = 1.0
    return replace(plain, problem=plain.problem.replace(tangent=tangent.tocsr(), friction=FRICTION))


@cache
def block_in_metres() -> Block:
    """The same in metres and newtons, gaps and loads a hundredth: displacements a hundredth, forces a hundredth."""
    plain = block()
    problem = plain.problem.replace(
        stiffness=1e3 * plain.problem.stiffness,
        load=plain.problem.load / SMALL,
        gap=1e-3 * plain.problem.gap / SMALL,
        units={"length": "m", "force": "N"},
    )
    return replace(plain, points=1e-3 * plain.points, area=1e-6 * plain.area, problem=problem)


def _points(grid: np.ndarray) -> np.ndarray:
    nx, ny, nz = CELLS
    x, z = LENGTH * grid[:, 0] / nx, DEPTH * grid[:, 2] / nz
    gap = 2e-3 + 8e-3 * (x / LENGTH) ** 2 + 2e-3 * (z / DEPTH) ** 2
    return np.stack([x, gap + (HEIGHT - gap) * grid[:, 1] / ny, z], axis=1)


def _areas(grid: np.ndarray) -> np.ndarray:
    """(N,) what of the face that a node lies in belongs to it: half a cell at edges, a quarter at corners."""
    nx, _, nz = CELLS
    shares = np.where(np.isin(grid[:, 0], (0, nx)), 0.5, 1.0) * np.where(np.isin(grid[:, 2], (0, nz)), 0.5, 1.0)
    return shares * (LENGTH / nx) * (DEPTH / nz)


def _stiffness(points: np.ndarray, cells: np.ndarray, free: np.ndarray) -> Any:
    import skfem
    from skfem.models.elasticity import lame_parameters, linear_elasticity

    reference = np.asarray(skfem.MeshHex.init_refdom().p.T)
    order = [int(np.flatnonzero((corner == CORNERS).all(axis=1))[0]) for corner in reference]
    mesh = skfem.MeshHex(points.T, cells.T[order])
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementHex1()), intorder=3)  # two Gauss points a direction
    K = linear_elasticity(*lame_parameters(YOUNG, POISSON)).assemble(basis)
    unknowns = basis.nodal_dofs[free[:, 1], free[:, 0]]
    return sp.csr_matrix(K)[unknowns][:, unknowns]
