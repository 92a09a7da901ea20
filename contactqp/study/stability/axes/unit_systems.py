"""One beam in units of length and force of practice and beyond."""

from __future__ import annotations

from contactqp.model.problem import ContactProblem
from contactqp.study.stability.axis import Axis
from contactqp.study.stability.posed import Posed, posed_with_closed

# (length, force) of one metre and one newton.
UNITS = {
    "N, m": (1.0, 1.0),
    "N, mm": (1e3, 1.0),
    "N, cm": (1e2, 1.0),
    "kN, m": (1.0, 1e-3),
    "kN, mm": (1e3, 1e-3),
    "MN, m": (1.0, 1e-6),
    "MN, km": (1e-3, 1e-6),
    "GN, Mm": (1e-6, 1e-9),
    "lbf, in": (1 / 0.0254, 1 / 4.4482216152605),
    "kip, ft": (1 / 0.3048, 1 / 4448.2216152605),
    "dyn, cm": (1e2, 1e5),
    "mN, um": (1e6, 1e3),
    "nN, nm": (1e9, 1e9),
    "N, pm": (1e12, 1.0),
    "N, fm": (1e15, 1.0),
    "N, Gm": (1e-9, 1.0),
    "N, light year": (1 / 9.4607304725808e15, 1.0),
}
BENDING = 210e9 * 8.0e-6  # E I of a steel beam [N m^2]
LENGTH = 2.0  # of each of two elements [m]
LOADS = (20e3, 0.0, 10e3, 2e3)  # N, N m
GAPS = (2e-3, 6e-3)  # m


def in_metres() -> tuple[list[list[float]], tuple[float, ...], tuple[float, ...]]:
    """K of deflections and slopes (w1, θ1, w2, θ2) of a clamped beam of two elements, loads and gaps, in N and m."""
    a, b, c = 12 * BENDING / LENGTH**3, 6 * BENDING / LENGTH**2, 2 * BENDING / LENGTH
    K = [[2 * a, 0.0, -a, b], [0.0, 4 * c, -b, c], [-a, -b, a, -b], [b, c, -b, 2 * c]]
    return K, LOADS, GAPS


def pose(index: float) -> Posed:
    """The beam on two stops in the units of this place in the list; slopes keep their numbers."""
    length, force = list(UNITS.values())[int(index)]
    K, f, g = in_metres()
    size = (1.0, length, 1.0, length)  # of a moment beside a force, and of a deflection's inverse beside a slope
    stiffness = [
        [x * (force / length * p * q) for x, q in zip(row, size, strict=True)] for row, p in zip(K, size, strict=True)
    ]
    problem = ContactProblem(
        stiffness,
        [x * (force * p) for x, p in zip(f, size, strict=True)],
        [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
        [x * length for x in g],
    )
    return posed_with_closed(problem, [0, 1])


AXIS = Axis(
    name="unit-systems",
    title="Units",
    quantity="units of force and length",
    values=tuple(float(i) for i in range(len(UNITS))),
    labels=tuple(UNITS),
    pose=pose,
    about=(
        "A clamped steel beam of two elements on two stops. Deflections have a unit and slopes none, so that the "
        "stiffness matrix is the worse conditioned the stranger the unit of length; the answer is the same."
    ),
)
