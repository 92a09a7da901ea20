"""Axes of stability on other problems: contact count, friction, incline, penalty, redundancy and units."""

from __future__ import annotations

from fractions import Fraction
from functools import partial

import numpy as np
import scipy.sparse as sp

from contactqp.model.problem import ContactProblem
from contactqp.study.stability.axis_problem import (
    Axis,
    AxisProblem,
    ExactAnswer,
    SweptTruth,
    powers_of_two,
    problem_with_answers,
    problem_with_closed,
)

# Five nodes over a floor in 1: two of them lie on it. Few bits, so that K u and K u + E'λ are exact in doubles.
PRESSED, FORCE = (-0.5, -1.0, -1.0, -0.75, -0.5), (0.0, 3.0, 2.0, 0.0, 0.0)
LOOSE = (-0.25, -0.5, -0.25, 0.0, 0.25)
BLOCK = len(PRESSED)
FLOOR, FAR = 1.0, 64.0
# Blocks that are pressed where not all are.
FEW = 2
COUNTS = (1.0, 10.0, 100.0, 1_000.0, 10_000.0, 100_000.0)
# With more contacts than this the rows of the closed ones are not kept as a dense matrix.
EXAMINED = 100


def pose_contact_count(count: float, *, pressed: int | None) -> AxisProblem:
    """Return strings of five nodes beside each other over a floor, on which `pressed` of them, or all, lie.

    One contact is a single node. λ* and u* are chosen, and f = K u* + E'λ* has few bits.
    """
    m = int(count)
    if m == 1:
        return _constructed(sp.csr_array([[2.0]]), np.array([-1.0]), np.array([3.0]), np.array([FLOOR]))
    strings = m // BLOCK
    lying = strings if pressed is None else min(pressed, strings)
    one = sp.diags([-np.ones(BLOCK - 1), 2 * np.ones(BLOCK), -np.ones(BLOCK - 1)], [-1, 0, 1])
    u = np.concatenate([np.tile(PRESSED, lying), np.tile(LOOSE, strings - lying)])
    force = np.concatenate([np.tile(FORCE, lying), np.zeros(BLOCK * (strings - lying))])
    gap = np.repeat([FLOOR, FAR], [BLOCK * lying, BLOCK * (strings - lying)])
    return _constructed(sp.csr_array(sp.kron(sp.identity(strings), one)), u, force, gap)


def _constructed(K: sp.csr_array, u: np.ndarray, force: np.ndarray, gap: np.ndarray) -> AxisProblem:
    E = -sp.identity(len(u), format="csr")
    problem = ContactProblem(K if len(u) > BLOCK else K.toarray(), K @ u + E.T @ force, E, gap)
    closed = np.flatnonzero(force)
    source = "constructed of numbers of few bits: f = K u* + E'λ* is exact"
    truth = SweptTruth(u, force, np.zeros(0), source, supported=True, problem=problem)
    rows = E[closed].toarray() if len(u) <= EXAMINED else None
    return AxisProblem(problem, truth, (), tuple(int(i) for i in closed), rows, rows)


CONTACTS = Axis(
    name="contacts",
    title="Number of contacts, few of them closed",
    quantity="contacts [1]",
    values=COUNTS,
    pose=partial(pose_contact_count, pressed=FEW),
    about="Strings over a floor, of which two lie on it and all others hang far above it.",
)

CLOSED_CONTACTS = Axis(
    name="closed-contacts",
    title="Number of contacts, two of five closed",
    quantity="contacts [1]",
    values=COUNTS,
    pose=partial(pose_contact_count, pressed=None),
    about="Strings that all lie on the floor: two of five contacts are closed.",
)


# Coulomb's coefficient up to and past the critical one: one answer, then three.

CRITICAL = Fraction(1, 2)  # K11 / |K12|


def pose_friction(ratio: float) -> AxisProblem:
    """Return Klarbring's node, K = [[1, -2], [-2, 5]], on a rough floor, with μ = ratio / 2, push P = (μ + 1/2) / 2.

    Sliding, u_x = (P - μ) / (1 - 2 μ) = 1/4 and λ_N = 1/2 whatever μ is. Beyond the critical 1/2 the node may also
    stick (λ_N = 1, λ_T = P < μ) or be lifted (u_z = 2 P - 1 > 0) under the same load.
    """
    friction = Fraction(ratio) / 2
    push = (friction + CRITICAL) / 2
    problem = ContactProblem(
        stiffness=[[1.0, -2.0], [-2.0, 5.0]],
        load=[float(push), -1.0],
        normal=[[0.0, -1.0]],
        gap=[0.0],
        tangent=[[1.0, 0.0]],
        friction=float(friction),
    )
    slides = ExactAnswer((Fraction(1, 4), Fraction(0)), (Fraction(1, 2),), (friction / 2,))
    sticks = ExactAnswer((Fraction(0), Fraction(0)), (Fraction(1),), (push,))
    lifted = ExactAnswer((5 * push - 2, 2 * push - 1), (Fraction(0),), (Fraction(0),))
    answers = [slides, sticks, lifted] if friction > CRITICAL else [slides]
    return problem_with_answers(problem, answers, np.array([[0.0, -1.0]]), np.array([[float(friction), -1.0]]))


FRICTION = Axis(
    name="friction",
    title="Friction past the critical coefficient",
    quantity="μ / critical μ [1]",
    values=(
        *(2.0**-10, 0.25, 0.5, 0.75),
        *(1.0 - 2.0**-e for e in (5, 10, 20, 30, 40, 50)),
        *(1.0 + 2.0**-e for e in (50, 40, 30, 20, 10, 5)),
        *(1.25, 1.5, 2.0, 4.0, 16.0, 2.0**10, 2.0**20),
    ),
    pose=pose_friction,
    about=(
        "One node (Klarbring 1990) slides; above the critical coefficient the same load has three equilibria, each of "
        "which is right."
    ),
)


# A block that nothing but friction holds on an incline: below tan α there is no equilibrium.

SLOPE = Fraction(3, 4)  # tan α
NORMAL, TANGENT = [[3.0, -4.0]], [[4.0, 3.0]]  # along (-3, 4) / 5 and along the plane, five times as long


def pose_incline(ratio: float) -> AxisProblem:
    """Return a rigid block of weight 25 without any spring on an incline of slope 3/4, μ = ratio × 3/4.

    It is held by λ_N = 4 and λ_T = -3 (forces of rows of length 5: 20 and 15 N) wherever μ >= 3/4.
    """
    friction = Fraction(ratio) * SLOPE
    problem = ContactProblem(np.zeros((2, 2)), [0.0, -25.0], NORMAL, [0.0], tangent=TANGENT, friction=float(friction))
    held = ExactAnswer((Fraction(0), Fraction(0)), (Fraction(4),), (Fraction(-3),))
    rows = np.array([*NORMAL, *TANGENT])
    return problem_with_answers(problem, [held] if friction >= SLOPE else [], rows, rows)


INCLINE = Axis(
    name="incline",
    title="Friction that must hold a body",
    quantity="μ / slope [1]",
    values=(
        *(2.0**-10, 0.5, 0.75),
        *(1.0 - 2.0**-e for e in (5, 10, 20, 30, 40, 50)),
        *(1.0, *(1.0 + 2.0**-e for e in (50, 40, 30, 20, 10, 5))),
        *(1.25, 2.0, 16.0, 2.0**10, 2.0**20),
    ),
    pose=pose_incline,
    about="A block without springs on an incline: below its slope no equilibrium exists, and to say so is right.",
)


# Penalty β, perturbation κ and the augmented Lagrangian's β on the two-bar truss of the course chapter.

STIFFNESS = ((59803.0, 6883.1), (6883.1, 77443.0))  # kN/m, as printed
LOAD = (60.0, -100.0)  # kN
GAP = 1e-3  # m
# Between 1e9 and 1e16, where the error turns, every half decade.
VALUES = tuple(sorted([10.0**k for k in range(25)] + [float(f"1e{k}") * 3.0 for k in range(9, 16)]))


def truss() -> ContactProblem:
    """Return two bars over a smooth floor (Example 2.10), in kN and m."""
    return ContactProblem(
        stiffness=STIFFNESS, load=LOAD, normal=[[0.0, -1.0]], gap=[GAP], units={"length": "m", "force": "kN"}
    )


def closed_form() -> ExactAnswer:
    """Return u_x = (f_x + K12 g) / K11, u_z = -g, λ = K12 u_x - K22 g - f_z from the doubles of the data, exactly."""
    (k11, k12), (_, k22) = ((Fraction(x) for x in row) for row in STIFFNESS)
    g, (fx, fz) = Fraction(GAP), (Fraction(x) for x in LOAD)
    ux = (fx + k12 * g) / k11
    return ExactAnswer((ux, -g), (k12 * ux - k22 * g - fz,))


def pose_penalty_stiffness(_: float) -> AxisProblem:
    """Return the truss, which is the same problem for every β."""
    return problem_with_closed(truss(), [0])


PENALTY_STIFFNESS = Axis(
    name="penalty",
    title="Penalty β and perturbation κ",
    quantity="β, κ [kN/m]",
    values=VALUES,
    pose=pose_penalty_stiffness,
    about=(
        "The two-bar truss of Example 2.10 of the course chapter, whose Table 2.1 ends with 21.684 kN at β = 1e20. "
        "Only methods that have such a knob are swept."
    ),
    knobs={"penalty": "penalty", "perturbed-lagrangian": "perturbation", "augmented-lagrangian": "penalty"},
)


# Two contacts whose normals differ by a small angle.


def pose_redundancy(angle: float) -> AxisProblem:
    """Return a node on springs that is pressed into the corner of the normals (0, -1) and (θ, -1).

    u = (0, -1) and λ = (3, 5) while θ > 2^-50. Only the angle distinguishes the two forces: f = K u + E'λ = (1 + 5 θ,
    -13), 5 θ beside 1. From θ = 2^-51 on 1 + 5 θ is not a double, and the problem is that of the rounded load.
    """
    problem = ContactProblem(
        [[4.0, -1.0], [-1.0, 5.0]], [1.0 + 5.0 * angle, -13.0], [[0.0, -1.0], [angle, -1.0]], [1.0, 1.0]
    )
    return problem_with_closed(problem, [0, 1])


REDUNDANCY = Axis(
    name="redundancy",
    title="Nearly redundant contacts",
    quantity="angle between the normals of two contacts [rad]",
    values=powers_of_two(-50, -47, -43, -40, -37, -33, -30, -27, -23, -20, -17, -13, -10, -7, -3, 0),
    pose=pose_redundancy,
    about="A node in a corner that is nearly flat: both contacts carry force, and only the angle tells them apart.",
)


# One beam in units of length and force of practice and beyond.

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
    """Return K of deflections and slopes (w1, θ1, w2, θ2) of a clamped beam, loads and gaps, in N and m."""
    a, b, c = 12 * BENDING / LENGTH**3, 6 * BENDING / LENGTH**2, 2 * BENDING / LENGTH
    K = [[2 * a, 0.0, -a, b], [0.0, 4 * c, -b, c], [-a, -b, a, -b], [b, c, -b, 2 * c]]
    return K, LOADS, GAPS


def pose_unit_systems(index: float) -> AxisProblem:
    """Return the beam on two stops in the units at this place of `UNITS`; slopes keep their numbers."""
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
    return problem_with_closed(problem, [0, 1])


UNIT_SYSTEMS = Axis(
    name="unit-systems",
    title="Units",
    quantity="units of force and length",
    values=tuple(float(i) for i in range(len(UNITS))),
    labels=tuple(UNITS),
    pose=pose_unit_systems,
    about=(
        "A clamped steel beam of two elements on two stops. Deflections have a unit and slopes none, so that the "
        "stiffness matrix is the worse conditioned the stranger the unit of length; the answer is the same."
    ),
)
