"""Stating a gallery problem of few unknowns as dense rows of integers, fractions and strings."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

from contactqp.oracle.gallery.algebra import Given, Numbers, numbers, rows_of
from contactqp.oracle.gallery.problem import Contents, ExactAnswer, ExactProblem, exact_answer
from contactqp.oracle.gallery.uniqueness import only_displacement, only_forces

Dense = Sequence[Sequence[Given]]


def stated(
    *,
    stiffness: Dense,
    load: Sequence[Given],
    normal: Dense = (),
    gap: Sequence[Given] = (),
    displacement: Sequence[Given],
    normal_force: Sequence[Given] = (),
    tangent: Dense = (),
    friction: Given = 0,
    friction_force: Dense = (),
    tie: Dense = (),
    tie_value: Sequence[Given] | None = None,
    tie_force: Sequence[Given] = (),
    description: str,
    source: str,
    formula: str,
    units: tuple[str, str] = ("", ""),
    unknowns: Sequence[str] | None = None,
    contacts: Sequence[str] | None = None,
    one_displacement: bool | None = None,
    one_forces: bool | None = None,
    rounding: Fraction = Fraction(0),
) -> Contents:
    """A problem and its answer; `units` are those of length and force, one coefficient of friction holds for all.

    `one_displacement` and `one_forces` are said where a proof is known that `gallery_uniqueness` does not find.
    """
    rough = bool(tangent)
    data = ExactProblem(
        stiffness=rows_of(stiffness),
        load=numbers(load),
        normal=rows_of(normal),
        gap=numbers(gap),
        tangent=rows_of(tangent),
        friction=(Fraction(friction),) * len(normal) if rough else (),
        slip_origin=(Fraction(0),) * len(tangent),
        tie=rows_of(tie),
        tie_value=numbers([0] * len(tie) if tie_value is None else tie_value),
    )
    rubbing: list[Numbers] = [numbers(row) for row in friction_force]
    answer = exact_answer(data, numbers(displacement), numbers(normal_force), rubbing, numbers(tie_force))
    names: dict[str, Any] = dict(
        units=dict(zip(("length", "force"), units, strict=True)),
        dof_names=None if unknowns is None else tuple(unknowns),
        contact_names=None if contacts is None else tuple(contacts),
    )
    return with_uniqueness(data, answer, description, source, formula, names, one_displacement, one_forces, rounding)


def with_uniqueness(
    data: ExactProblem,
    answer: ExactAnswer,
    description: str,
    source: str,
    formula: str,
    names: dict[str, Any],
    one_displacement: bool | None = None,
    one_forces: bool | None = None,
    rounding: Fraction = Fraction(0),
) -> Contents:
    """Contents, with what exact ranks prove of the uniqueness of the answer where nothing else is known."""
    displacement = only_displacement(data, answer) if one_displacement is None else one_displacement
    forces = only_forces(data, answer, displacement) if one_forces is None else one_forces
    return Contents(data, answer, description, source, formula, displacement, forces, rounding, names)
