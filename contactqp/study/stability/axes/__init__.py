"""The axes: one file an idea."""

from __future__ import annotations

from contactqp.errors import InvalidProblem
from contactqp.study.stability.axes import (
    contact_count,
    friction,
    gap_ratio,
    grazing,
    incline,
    load_ratio,
    mass_ratio,
    mesh_grading,
    penalty_stiffness,
    redundancy,
    singular_stiffness,
    stiffness_contrast,
    unit_systems,
)
from contactqp.study.stability.axis import Axis

AXES: tuple[Axis, ...] = (
    penalty_stiffness.AXIS,
    stiffness_contrast.AXIS,
    singular_stiffness.AXIS,
    mesh_grading.AXIS,
    gap_ratio.AXIS,
    load_ratio.AXIS,
    grazing.AXIS,
    redundancy.AXIS,
    friction.AXIS,
    incline.AXIS,
    mass_ratio.AXIS,
    unit_systems.AXIS,
    contact_count.CONTACTS,
    contact_count.CLOSED_CONTACTS,
)


def find_axis(name: str) -> Axis:
    """The axis of that name.

    Raises
    ------
    InvalidProblem
        There is none; the names are given.
    """
    for axis in AXES:
        if axis.name == name:
            return axis
    raise InvalidProblem(f"stability: no axis is called {name!r}; expected {', '.join(axis.name for axis in AXES)}")
