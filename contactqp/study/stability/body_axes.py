"""Axes of stability on chains of springs and bars: gaps, loads, masses, meshes, supports and stiffness contrast."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from contactqp.model.arrays import Array
from contactqp.model.problem import ContactProblem
from contactqp.study.stability.axis_problem import Axis, AxisProblem, powers_of_two, problem_with_closed

Matrix = Array


def chain(springs: Sequence[float], *, ground: bool = True) -> Matrix:
    """Return the stiffness of springs in a row; the first joins the ground or, without ground, unknowns 0 and 1.

    Sums are those of doubles: exact where the springs have few bits.
    """
    size = len(springs) + (not ground)
    K = np.zeros((size, size))
    for i, k in enumerate(springs):
        ends = (i - 1, i) if ground else (i, i + 1)
        for a in ends:
            if a >= 0:
                K[a, a] += k
        if ends[0] >= 0:
            K[ends[0], ends[1]] -= k
            K[ends[1], ends[0]] -= k
    return K


def blocks(*parts: Matrix) -> Matrix:
    """Return the block-diagonal stiffness of bodies that share no unknown."""
    sizes = [len(part) for part in parts]
    K, start = np.zeros((sum(sizes), sum(sizes))), 0
    for part, size in zip(parts, sizes, strict=True):
        K[start : start + size, start : start + size] = part
        start += size
    return K


def rows(n: int, *entries: dict[int, float]) -> Matrix:
    """Return one row (n,) for each dictionary of unknowns and coefficients."""
    E = np.zeros((len(entries), n))
    for row, places in zip(E, entries, strict=True):
        for j, value in places.items():
            row[j] = value
    return E


# A small gap between bodies that travel far, and a wide one.


def pose_gap_ratio(gap: float) -> AxisProblem:
    """Return two chains of unit springs; their ends travel by 1 + g and by 1 and meet with a force of 1/2.

    u = (1/2, 1 + g, 1, 1/2) gives f = (-g, 1 + g, 0, 0). From g = 2^-53 on 1 + g is not a double, and the problem is
    the one of the rounded load.
    """
    right = chain([1.0, 1.0])[::-1, ::-1]  # held at its far end
    load = [-gap, 1.0 + gap, 0.0, 0.0]
    return problem_with_closed(
        ContactProblem(blocks(chain([1.0, 1.0]), right), load, rows(4, {1: 1.0, 2: -1.0}), [gap]), [0]
    )


GAP_RATIO = Axis(
    name="gap-ratio",
    title="Gap / travel",
    quantity="gap / displacement of the other body [1]",
    values=powers_of_two(-70, -60, -54, -52, -50, -47, -43, -40, -33, -27, -20, -13, -7, -3, 0, 7, 13, 20, 30, 40),
    pose=pose_gap_ratio,
    about="Two bodies that travel by 1: what closes the gap between them is a difference of lengths of size 1.",
)


SPRINGS, GAP = (3.0, 5.0, 7.0), 1.0
FIRST_GAP, FIRST_LOAD = 0.25, 4.0


# A contact that is nearly open, and one that is nearly closed.


def pose_grazing(distance: float) -> AxisProblem:
    """Return a chain whose first node is pressed on a stop; its end reaches for a wall with the load P = P_c (1 + δ).

    Springs 5 and 7 from the first node at 1/4 to the wall at 1: P_c = (3/4) / (1/5 + 1/7) = 35/16. The force at the
    wall is P_c δ for δ > 0, and for δ < 0 the gap is -(3/4) δ, both to the rounding of the load.
    """
    touching = (GAP - FIRST_GAP) * SPRINGS[1] * SPRINGS[2] / (SPRINGS[1] + SPRINGS[2])
    problem = ContactProblem(
        chain(SPRINGS),
        [FIRST_LOAD, 0.0, touching * (1.0 + distance)],
        rows(3, {0: 1.0}, {2: 1.0}),
        [FIRST_GAP, GAP],
    )
    return problem_with_closed(problem, [0, 1] if touching * (1.0 + distance) > touching else [0])


GRAZING = Axis(
    name="grazing",
    title="Grazing distance",
    quantity="load / touching load - 1 [1]",
    values=(
        *(-(2.0**-e) for e in (1, 4, 7, 10, 14, 17, 20, 24, 27, 30, 34, 40, 44, 47, 50)),
        0.0,
        *(2.0**-e for e in (50, 47, 44, 40, 34, 30, 27, 24, 20, 17, 14, 10, 7, 4, 1)),
    ),
    pose=pose_grazing,
    about="One contact is pressed, the other one is open, touches, or is closed with next to no force.",
)


LOAD_RATIO_GAP = 0.25
# Loads that are tiny and huge beside stiffness times gap.

# The loaded chain is two unit springs in series: it travels by twice the load.
TOUCHING = LOAD_RATIO_GAP / 2


def pose_load_ratio(load: float) -> AxisProblem:
    """Return two chains of two unit springs, 1/4 apart, one of them pulled onto the other."""
    right = chain([1.0, 1.0])[::-1, ::-1]
    problem = ContactProblem(
        blocks(chain([1.0, 1.0]), right), [0.0, load, 0.0, 0.0], rows(4, {1: 1.0, 2: -1.0}), [LOAD_RATIO_GAP]
    )
    return problem_with_closed(problem, [0] if load > TOUCHING else [])


LOAD_RATIO = Axis(
    name="load-ratio",
    title="Load / stiffness",
    quantity="load / (spring times unit length) [1]; the gap closes above 1/8",
    values=powers_of_two(-540, -100, -50, -30, -20, -10, -5, -4, 0, 5, 10, 20, 30, 50, 100, 300, 500, 540),
    pose=pose_load_ratio,
    about="The same two bodies under loads from nothing to far beyond what numbers can square.",
)


# A heavy mass on a stack of light ones: the contact problem of a time step of impact.

COUNT = 8


def pose_mass_ratio(ratio: float) -> AxisProblem:
    """Return seven masses of 1 under one of r that fall at 1 onto a floor that sinks at 1/4: M v + E'p = M v_free.

    All fall at 1/4 afterwards, and the impulse between two of them is 3/4 of the mass above.
    """
    mass = np.ones(COUNT)
    mass[-1] = ratio
    joints = [{0: -1.0}, *({i: 1.0, i + 1: -1.0} for i in range(COUNT - 1))]
    gap = np.zeros(COUNT)
    gap[0] = 0.25
    return problem_with_closed(ContactProblem(np.diag(mass), -mass, rows(COUNT, *joints), gap), list(range(COUNT)))


MASS_RATIO = Axis(
    name="mass-ratio",
    title="Mass ratio",
    quantity="heavy mass / light mass [1]",
    values=powers_of_two(-53, -40, -30, -20, -10, -5, 0, 2, 4, 7, 10, 13, 17, 20, 27, 33, 40, 47, 53, 60),
    pose=pose_mass_ratio,
    about=(
        "A step of Moreau's and Jean's scheme for eight bodies that fall on each other is the contact problem "
        "M v + E'p = M v_free, E v <= g: K is the mass matrix, displacements are velocities, forces are impulses."
    ),
)


# A bar whose elements shrink towards the contact.

ELEMENTS = 10


def pose_mesh_grading(grading: float) -> AxisProblem:
    """Return a bar of ten elements, the shortest 1/grading of the longest.

    Its springs go from 1 to grading, each a power of two. It is pulled at its middle and at its end, which meets a
    wall. Neighbouring springs add up to doubles while their ratio is below 2^53.
    """
    exponent = grading.as_integer_ratio()[0].bit_length() - 1
    springs = [2.0 ** round(exponent * i / (ELEMENTS - 1)) for i in range(ELEMENTS)]
    load = [0.0] * ELEMENTS
    load[ELEMENTS // 2], load[-1] = 1.0, 2.0
    return problem_with_closed(ContactProblem(chain(springs), load, rows(ELEMENTS, {ELEMENTS - 1: 1.0}), [0.5]), [0])


MESH_GRADING = Axis(
    name="mesh-grading",
    title="Mesh grading",
    quantity="longest / shortest element [1]",
    values=powers_of_two(0, 3, 7, 10, 13, 17, 20, 27, 33, 40, 47, 53, 60, 80, 100),
    pose=pose_mesh_grading,
    about="A bar whose elements shrink towards the wall that it meets: stiffnesses 1 to the grading in one chain.",
)


# A body on a support that softens until the body floats.


def pose_singular_stiffness(support: float) -> AxisProblem:
    """Return five nodes with unit springs, a ground spring ε and a wall.

    u is of size 1, and the wall carries all but ε of the load. From ε = 2^-53 on, 1 + ε is 1: K is singular, the body
    floats, and the wall holds it.
    """
    problem = ContactProblem(chain([support, 1.0, 1.0, 1.0, 1.0]), [0.0, 0.0, 1.0, 0.0, 2.0], rows(5, {4: 1.0}), [4.0])
    return problem_with_closed(problem, [0])


SINGULAR_STIFFNESS = Axis(
    name="singular-stiffness",
    title="Stiffness nearly singular",
    quantity="support / spring of the body [1]",
    values=powers_of_two(-60, -54, -53, -52, -50, -47, -43, -40, -37, -33, -30, -27, -23, -20, -13, -7, -3, -1),
    pose=pose_singular_stiffness,
    about="A body on a soft support is pressed on a wall; at last rounding loses the support, and the body floats.",
)


# Soft and stiff springs in turn.


def pose_stiffness_contrast(contrast: float) -> AxisProblem:
    """Return springs 1, c, 1, c in a row; stops at the far ends of the stiff ones. Forces stay of size 1 whatever c is.

    What a stiff spring carries is c times a difference of displacements of size 1/c: their rounding shows c times.
    The last value is 2^53 - 1: beyond it 1 + c is not a double, and K with its rounded entries is no longer a
    stiffness.
    """
    return problem_with_closed(
        ContactProblem(
            stiffness=chain([1.0, contrast, 1.0, contrast]),
            load=[0.0, 4.0, 0.0, 8.0],
            normal=rows(4, {1: 1.0}, {3: 1.0}),
            gap=[1.0, 2.0],
        ),
        [0, 1],
    )


STIFFNESS_CONTRAST = Axis(
    name="stiffness-contrast",
    title="Stiffness contrast",
    quantity="stiff spring / soft spring [1]",
    values=(*powers_of_two(0, 3, 7, 10, 13, 17, 20, 23, 27, 30, 33, 37, 40, 43, 47, 50, 52), 2.0**53 - 1),
    pose=pose_stiffness_contrast,
    about="A chain of soft and stiff springs in turn with two stops, up to what one entry of K can hold.",
)
