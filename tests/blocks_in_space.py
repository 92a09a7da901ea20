"""Small blocks of hexahedra and tetrahedra for the tests of what is solved without a factorisation."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

import contactqp as cq
from contactqp.elements.material import Material
from contactqp.elements.shapes import box
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support


def on_paraboloid(
    cells=(10, 10, 7), size=(1.0, 1.0, 0.7), poisson=0.3, kind="hex8", press=0.02, sides=True, friction=None, pushed=0.0
):
    """A block whose top is moved down onto a paraboloid; `sides` holds the top sideways too, or pushes it along x."""
    body = Body(box(size, cells, kind), Material(1.0, poisson), "3d", name="block")
    structure = Structure([body])
    held = [Support("block", "top", axis, pushed * (axis == 0)) for axis in range(2) if sides]
    held += [Support("block", "top", 2, -press)]
    obstacle = cq.Paraboloid([size[0] / 2, size[1] / 2, 0.0], [0.0, 0.0, 1.0], 5.0)
    pair = cq.pair(structure.surface("block", "bottom"), obstacle)
    return structure.assemble(held).problem([pair], friction=friction)


def on_sphere(cells=(9, 9, 6), friction=None):
    """A block on a sphere: every contact row touches the three unknowns of its node."""
    body = Body(box((1.0, 1.0, 0.7), cells, "hex8"), Material(1.0, 0.3), "3d", name="block")
    structure = Structure([body])
    held = [Support("block", "top", axis, -0.03 * (axis == 2)) for axis in range(3)]
    sphere = cq.Sphere([0.5, 0.5, -1.5], 1.5)
    return structure.assemble(held).problem([cq.pair(structure.surface("block", "bottom"), sphere)], friction=friction)


def stacked(upper=(7, 7, 5), lower=(6, 6, 5), friction=None):
    """Two held blocks with meshes that do not match, one pressed on the other: mortar rows share many unknowns."""
    one = Body(box((1.0, 1.0, 0.5), lower, "hex8", corner=(0.0, 0.0, -0.5)), Material(1.0, 0.3), "3d", name="lower")
    two = Body(box((1.0, 1.0, 0.5), upper, "hex8"), Material(3.0, 0.2), "3d", name="upper")
    structure = Structure([one, two])
    held = [Support("lower", "bottom", axis) for axis in range(3)]
    held += [Support("upper", "top", axis, -0.02 * (axis == 2)) for axis in range(3)]
    surfaces = (structure.surface("upper", "bottom"), structure.surface("lower", "top"))
    pair = cq.pair_mortar(*surfaces, dimension=structure.size)
    return structure.assemble(held).problem([pair], friction=friction)


def layered(contrast, cells=(12, 12, 24)):
    """A lattice of unit springs with one soft layer; the nodes on top reach a wall at 0.9 of the way they would go."""
    across, deep, high = cells
    index = np.arange(across * deep * high).reshape(high, deep, across)
    layer = index // (across * deep)
    ends = [(index[:-1], index[1:]), (index[:, :-1], index[:, 1:]), (index[..., :-1], index[..., 1:])]
    a, b = (np.concatenate([pair[k].ravel() for pair in ends]) for k in range(2))
    spring = np.ones(len(a))
    spring[: index[:-1].size][layer[:-1].ravel() == high // 2 - 1] = contrast
    entries = (np.r_[spring, spring, -spring, -spring], (np.r_[a, b, a, b], np.r_[a, b, b, a]))
    ground = sp.diags((layer == 0).ravel().astype(float))
    K = sp.csc_matrix(sp.coo_matrix(entries, shape=(index.size, index.size)) + ground)
    load = np.where(layer.ravel() < high // 2, 0.1, contrast / 10)
    top = index[-1].ravel()
    normal = sp.csr_matrix((np.ones(len(top)), (np.arange(len(top)), top)), shape=(len(top), index.size))
    return cq.ContactProblem(stiffness=K, load=load, normal=normal, gap=0.9 * spsolve(K, load)[top])


def with_ties(problem, count=4):
    """The same body with some pairs of unknowns tied to move alike: rows of two unknowns."""
    untouched = np.setdiff1d(np.arange(problem.dimension), problem.normal.indices)
    chosen = untouched[:: len(untouched) // (2 * count)][: 2 * count].reshape(count, 2)
    ones = np.tile([1.0, -1.0], count)
    rows = sp.csr_array((ones, (np.repeat(np.arange(count), 2), chosen.ravel())), shape=(count, problem.dimension))
    return problem.replace(tie=rows, tie_value=np.linspace(-1e-3, 1e-3, count))


def fresh(problem):
    """The same numbers with nothing computed from them."""
    return problem.replace(stiffness=problem.stiffness)
