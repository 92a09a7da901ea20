"""The table of the axes of stability."""

from __future__ import annotations

from contactqp.errors import InvalidProblem
from contactqp.study.stability.body_axes import (
    GAP_RATIO,
    GRAZING,
    LOAD_RATIO,
    MASS_RATIO,
    MESH_GRADING,
    SINGULAR_STIFFNESS,
    STIFFNESS_CONTRAST,
)
from contactqp.study.stability.posed import Axis
from contactqp.study.stability.problem_axes import (
    CLOSED_CONTACTS,
    CONTACTS,
    FRICTION,
    INCLINE,
    PENALTY_STIFFNESS,
    REDUNDANCY,
    UNIT_SYSTEMS,
)

AXES: tuple[Axis, ...] = (
    PENALTY_STIFFNESS,
    STIFFNESS_CONTRAST,
    SINGULAR_STIFFNESS,
    MESH_GRADING,
    GAP_RATIO,
    LOAD_RATIO,
    GRAZING,
    REDUNDANCY,
    FRICTION,
    INCLINE,
    MASS_RATIO,
    UNIT_SYSTEMS,
    CONTACTS,
    CLOSED_CONTACTS,
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
