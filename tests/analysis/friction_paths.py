"""Load paths with friction whose answers are known."""

from __future__ import annotations

import numpy as np

import contactqp as cq
from contactqp.elements.material import Material
from contactqp.elements.shapes import rectangle
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from tests.solving.friction.problems import rough_truss

WEIGHTS = np.array([0.0, 0.0, -2 * 9.81, -9.81])  # of `two_masses`

# Example 2.18 (kN, m), mu = 0.3, one load by four ways: (corners, d1x, l_N, l_T / l_N).
SLIPS_ON = (30058 / 30933965, 180933933661 / 6186793000, 0.3)
ORDERS = {
    "proportional": ([[60.0, -100.0]], *SLIPS_ON),
    "vertical, then horizontal": ([[0.0, -100.0], [60.0, -100.0]], *SLIPS_ON),
    "horizontal, then vertical": ([[60.0, 0.0], [60.0, -100.0]], 668831 / 598030000, 30.254992836646991, 0.0),
    "pulled to 80 kN and back": (
        [[0.0, -100.0], [80.0, -100.0], [60.0, -100.0]],
        28327 / 22206950,
        13917994897 / 444139000,
        -0.3,
    ),
}


def pulled(force: float) -> np.ndarray:
    """The weights, and a force on the second mass."""
    return np.array([0.0, force, -2 * 9.81, -9.81])


def truss_from_rest(friction: float) -> cq.ContactProblem:
    """Examples 2.17 and 2.18 before any load."""
    return rough_truss(friction, 0.0, load=[0.0, 0.0])


def jenkins(
    stiffness: float, friction: float, amplitude: float, loops: int
) -> tuple[cq.ContactProblem, list[np.ndarray]]:
    """A slider pressed by 1, pulled through a spring whose end moves to and fro: the problem, and its loads."""
    problem = cq.ContactProblem(
        stiffness=[[stiffness, 0.0], [0.0, 0.0]],
        load=[0.0, 0.0],
        normal=[[0.0, -1.0]],
        gap=[0.0],
        tangent=[[1.0, 0.0]],
        friction=friction,
    )
    ends = [0.0, amplitude, *([-amplitude, amplitude] * loops)]
    return problem, [np.array([stiffness * end, -1.0]) for end in ends]


def rolling_block(friction: float, cells: tuple[int, int] = (16, 4)) -> tuple[cq.ContactProblem, list[np.ndarray]]:
    """A block pressed on a paraboloid, and then pushed sideways: contacts close one by one and slip from the rim."""
    body = Body(rectangle(1.0, 0.5, cells), Material(1.0, 0.3), "plane-strain", name="block")
    structure = Structure([body])
    surface = cq.pair(structure.surface("block", "bottom"), cq.Paraboloid([0.47, 0.0], [0.0, 1.0], 5.0))
    loads = []
    for sideways in (0.0, 0.02):
        held = [Support("block", "top", 0, sideways), Support("block", "top", 1, -0.02)]
        problem = structure.assemble(held).problem([surface], friction=friction)
        loads.append(np.array(problem.load))
    return problem.replace(load=np.zeros(problem.dimension)), loads
