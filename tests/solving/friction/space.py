"""Frictional problems in space with answers in closed form, or made around them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import contactqp as cq
from contactqp.elements.loads import Traction
from contactqp.elements.material import Material
from contactqp.elements.shapes import box, rectangle
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from tests.solving.friction.problems import Known, made_around

# Every way to ask for an answer in space: method, its options.
WAYS: dict[str, tuple[str, dict[str, Any]]] = {
    "by itself": ("active-set", {}),
    "newton": ("active-set", {"algorithm": "newton"}),
    "nsgs": ("active-set", {"algorithm": "nsgs"}),
    "admm": ("active-set", {"algorithm": "admm"}),
    "aclm, clarabel": ("clarabel", {"algorithm": "aclm"}),
    "aclm, scs": ("scs", {"algorithm": "aclm"}),
    "aclm, cvxpy": ("cvxpy", {"algorithm": "aclm"}),
    "aclm, active set, 8 sides": ("active-set", {"algorithm": "aclm", "facets": 8}),
    "tresca, clarabel": ("clarabel", {"algorithm": "tresca"}),
    "tresca, active set, 32 sides": ("active-set", {"algorithm": "tresca", "facets": 32}),
    "tresca, circumscribed": ("clarabel", {"algorithm": "tresca", "facets": 12, "polygon": "circumscribed"}),
}


def direction(angle: float) -> np.ndarray:
    return np.array([np.cos(angle), np.sin(angle)])


def block(
    push: ArrayLike, pressed: float = 10.0, friction: float = 0.3, tangential: ArrayLike = 2.0, **changes: Any
) -> cq.ContactProblem:
    """One block on a plane: unknowns x, y along it and z off it; springs along it, a number or (2, 2); mu N = 3."""
    stiffness = np.zeros((3, 3))
    stiffness[:2, :2] = np.asarray(tangential) * np.eye(2) if np.ndim(tangential) == 0 else tangential
    data: dict[str, Any] = dict(
        stiffness=stiffness,
        load=[*np.asarray(push, dtype=float), -pressed],
        normal=[[0.0, 0.0, -1.0]],
        gap=[0.0],
        tangent=np.eye(2, 3),
        friction=friction,
    )
    return cq.ContactProblem(**(data | changes))


def several(seed: int, contacts: int = 6, ties: int = 0, softness: float = 0.2) -> Known:
    """Blocks in a row, each state in turn open, sticking, sliding, anisotropic, coupled, around a known answer.

    mu W_NT is small beside W_NN: the answer is the only one.
    """
    rng = np.random.default_rng(seed)
    n = 3 * contacts
    mixed = rng.normal(size=(n, n))
    K = np.eye(n) + softness * mixed @ mixed.T / n
    K += np.diag(rng.uniform(0.0, 2.0, n))
    rows = np.eye(n)
    normal, tangent = -rows[::3], np.delete(rows, np.arange(0, n, 3), axis=0)
    mu = rng.uniform(0.1, 0.5, contacts)
    u, pressed, rubbed, slip = rng.normal(size=n), np.zeros(contacts), np.zeros((contacts, 2)), np.zeros((contacts, 2))
    gap = normal @ u
    for i in range(contacts):
        way = direction(rng.uniform(0, 2 * np.pi))
        if i % 3 == 0:
            gap[i] += rng.uniform(0.3, 1.0)
            slip[i] = way
        else:
            pressed[i] = rng.uniform(0.5, 2.0)
            rubbed[i] = mu[i] * pressed[i] * (1.0 if i % 3 == 1 else rng.uniform(0.0, 0.9)) * way
            slip[i] = rng.uniform(0.1, 1.0) * way * (i % 3 == 1)
    tie, nu = rng.normal(size=(ties, n)), rng.normal(size=ties)
    return made_around((u, pressed, rubbed, nu), slip, K, (normal, tangent, tie), gap, mu)


def elastic_block(
    cells: tuple[int, int, int] = (8, 8, 4),
    friction: float = 0.3,
    push: tuple[float, float] = (0.004, 0.002),
    poisson: float = 0.3,
    plane_strain: bool = False,
    shear: tuple[float, float] = (0.0, 0.0),
) -> cq.ContactProblem:
    """A block 1 x 1 x 1/2, E = 1, its top pressed down by 0.02 and moved sideways; its flanks sheared by tractions."""
    body = Body(box((1.0, 1.0, 0.5), cells, "hex8"), Material(modulus=1.0, poisson=poisson), "3d", name="b")
    structure = Structure([body])
    held = [Support("b", "top", 0, push[0]), Support("b", "top", 1, push[1]), Support("b", "top", 2, -0.02)]
    if plane_strain:
        held += [Support("b", side, 1, 0.0) for side in ("front", "back")]
    sides = [Traction("b", "right", [0.0, 0.0, shear[0]]), Traction("b", "left", [0.0, 0.0, -shear[0]])]
    sides += [Traction("b", "back", [0.0, 0.0, shear[1]]), Traction("b", "front", [0.0, 0.0, -shear[1]])]
    system = structure.assemble(held, sides if any(shear) else [])
    floor = cq.pair(structure.surface("b", "bottom"), cq.Plane([0.0, 0.0, 0.0], [0.0, 0.0, 1.0]))
    return system.problem([floor], friction=friction)


def plane_block(cells: tuple[int, int], friction: float, push: float, poisson: float = 0.3) -> cq.ContactProblem:
    """The section of `elastic_block` in plane strain."""
    body = Body(rectangle(1.0, 0.5, cells, "quad4"), Material(modulus=1.0, poisson=poisson), "plane-strain", name="b")
    structure = Structure([body])
    system = structure.assemble([Support("b", "top", 0, push), Support("b", "top", 1, -0.02)])
    floor = cq.pair(structure.surface("b", "bottom"), cq.Plane([0.0, 0.0], [0.0, 1.0]))
    return system.problem([floor], friction=friction)
