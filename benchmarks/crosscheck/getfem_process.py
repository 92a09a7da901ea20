"""GetFEM on the block, under the system's Python.

    /usr/bin/python3 -m benchmarks.crosscheck.getfem_process problem.npz answer.json basic 1
    /usr/bin/python3 -m benchmarks.crosscheck.getfem_process problem.npz answer.json nodal 1

basic: `add_basic_contact_brick` on the matrices that are given; projected: the same, min(multiplier, 0). The other ways
have GetFEM's own trilinear elements. nodal: `add_nodal_contact_with_rigid_obstacle_brick`; integral and penalised:
`add_integral_contact_with_rigid_obstacle_brick`, `add_penalized_contact_with_rigid_obstacle_brick`. The number is the
augmentation (the brick's option), or the penalty [N/mm^3]. Multipliers are written as GetFEM has them, negative in
compression.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from benchmarks.crosscheck.child import Given, debian_version, write_answer

YOUNG, POISSON = 210_000.0, 0.3
# The contact bricks' augmentation parameter; the manual advises a value near Young's modulus.
AUGMENTATION = YOUNG
RESIDUAL, MOST = 1e-9, 100
# GetFEM numbers the corners of a cell with x running fastest.
CORNERS = [0, 1, 3, 2, 4, 5, 7, 6]
BOTTOM = 1


def main(problem: str, answer: str, way: str, number: str) -> None:
    import getfem as gf

    given = Given.load_file(Path(problem))
    ways: dict[str, Callable[..., tuple[Any, dict[str, np.ndarray]]]] = {"basic": _basic, "projected": _basic}
    solve = ways.get(way, _own)
    done, parts = solve(gf, given, way, float(number))
    said = f"{'converged' if done[1] else 'not converged'}, {done[0]} steps"
    write_answer(Path(answer), said, f"GetFEM {debian_version('python3-getfem')}", **parts)


def _basic(gf: Any, given: Given, way: str, number: float) -> tuple[Any, dict[str, np.ndarray]]:
    n, m = len(given.load), len(given.gap)
    model = gf.Model("real")
    model.add_variable("u", n)
    model.add_variable("lambda_n", m)
    model.add_explicit_matrix("u", "u", _matrix(gf, given.stiffness), 1, 0)
    model.add_explicit_rhs("u", given.load)
    model.add_initialized_data("r", [AUGMENTATION])
    model.add_initialized_data("gap", given.gap)
    model.add_initialized_data("alpha", np.ones(m))
    normal = _matrix(gf, sp.csr_matrix(given.normal))
    model.add_basic_contact_brick("u", "lambda_n", "r", normal, "gap", "alpha", int(number))
    done = model.solve("max_res", RESIDUAL, "max_iter", MOST)
    multiplier = model.variable("lambda_n")
    force = np.minimum(multiplier, 0.0) if way == "projected" else multiplier
    return done, {"displacement": model.variable("u"), "normal_force": force}


def _own(gf: Any, given: Given, way: str, number: float) -> tuple[Any, dict[str, np.ndarray]]:
    mesh = gf.Mesh("empty", 3)
    for cell in given.cells:
        mesh.add_convex(gf.GeoTrans("GT_QK(3,1)"), given.points[cell[CORNERS]].T)
    below = [face for face in mesh.outer_faces().T if mesh.normal_of_face(*map(int, face))[1] < -0.5]
    mesh.set_region(BOTTOM, np.array(below).T)
    field, height = gf.MeshFem(mesh, 3), gf.MeshFem(mesh, 1)
    for one in (field, height):
        one.set_fem(gf.Fem("FEM_QK(3,1)"))
    integration = gf.MeshIm(mesh, gf.Integ("IM_GAUSS_PARALLELEPIPED(3,3)"))  # two points a direction
    place = _places(field, given.points)
    free = np.array([place[node, axis] for node, axis in given.free])
    held = np.setdiff1d(np.arange(field.nbdof()), free)
    load = np.zeros(field.nbdof())
    load[free] = given.load

    model = gf.Model("real")
    model.add_fem_variable("u", field)
    lame = {"first": YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON)), "shear": YOUNG / (2 * (1 + POISSON))}
    for name, value in lame.items():
        model.add_initialized_data(name, [value])
    model.add_isotropic_linearized_elasticity_brick(integration, "u", *lame)
    model.add_explicit_rhs("u", load)
    model.add_variable("hold", len(held))
    rows = sp.csr_matrix((np.ones(len(held)), (np.arange(len(held)), held)), shape=(len(held), field.nbdof()))
    model.add_constraint_with_multipliers("u", "hold", _matrix(gf, rows), np.zeros(len(held)))
    parts: dict[str, np.ndarray] = {}
    order = _contact(model, field, height, integration, way, number)
    done = model.solve("max_res", RESIDUAL, "max_iter", MOST)
    parts["displacement"] = model.variable("u")[free]
    if order is not None:
        nodes = [_nearest(given.points, point) for point in order]
        at = [nodes.index(int(node)) for node in given.bottom]
        parts["normal_force"] = model.variable("lambda_n")[at]
    return done, parts


def _contact(model: Any, field: Any, height: Any, integration: Any, way: str, number: float) -> np.ndarray | None:
    """Add the brick; where the multipliers are forces at nodes, the points (m, 3) of these."""
    if way == "nodal":
        points = field.basic_dof_nodes()[:, field.basic_dof_on_region(BOTTOM)[::3]].T
        model.add_variable("lambda_n", len(points))
        model.add_initialized_data("r", [AUGMENTATION])
        model.add_nodal_contact_with_rigid_obstacle_brick(integration, "u", "lambda_n", "r", BOTTOM, "y", int(number))
        return np.asarray(points)
    model.add_initialized_fem_data("distance", height, height.basic_dof_nodes()[1])
    if way == "integral":
        model.add_filtered_fem_variable("lambda_n", height, BOTTOM)
        model.add_initialized_data("r", [AUGMENTATION / 10])  # of a stress and a length: Young's modulus by 10 mm
        model.add_integral_contact_with_rigid_obstacle_brick(
            integration, "u", "lambda_n", "distance", "r", BOTTOM, int(number)
        )
    else:
        model.add_initialized_data("r", [number])
        model.add_penalized_contact_with_rigid_obstacle_brick(integration, "u", "distance", "r", BOTTOM)
    return None


def _places(field: Any, points: np.ndarray) -> dict[tuple[int, int], int]:
    """GetFEM's number of every unknown by node and axis."""
    at = [_nearest(points, point) for point in field.basic_dof_nodes().T]
    return {(node, number % 3): number for number, node in enumerate(at)}


def _nearest(points: np.ndarray, point: np.ndarray) -> int:
    distances = np.max(abs(points - point), axis=1)
    if np.min(distances) > 1e-9:
        raise ValueError(f"no node at {point}")
    return int(np.argmin(distances))


def _matrix(gf: Any, matrix: sp.csr_matrix) -> Any:
    entries = matrix.tocoo()
    theirs = gf.Spmat("empty", *matrix.shape)
    for i, j, value in zip(entries.row, entries.col, entries.data):  # noqa: B905 (all are as long)
        theirs.add(int(i), int(j), np.array([[value]]))
    return theirs


if __name__ == "__main__":
    main(*sys.argv[1:])
