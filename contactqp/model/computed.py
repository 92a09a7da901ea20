"""What has been computed of a problem's matrices, kept with them for all that asks again."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from contactqp.model.arrays import Array, Indices, Mask, Vector


@dataclass(eq=False)
class OfStiffness:
    """What has been computed of a stiffness alone; problems with other contacts and ties share it."""

    diagonal: Vector | None = None
    own_scale: Vector | None = None  # 1/sqrt(K_jj)
    rows: Any = None  # K as a CSR matrix
    sizes: Any = None  # |K|
    bodies: Indices | None = None  # (n,) the connected part of K that each unknown belongs to
    extended: Any = None  # K for products in twice double precision
    elimination_order: Any = None  # linalg.pardiso: that of the unknowns, found with the first sparse factorisation
    widest_level: int | None = None  # linalg.iteration: unknowns of a level of the breadth-first search
    factorised: bool = False  # linalg.iteration: whether it is factorised however large it is, as somebody wishes
    iterable: bool | None = None  # linalg.iteration: whether a hierarchy knows all motions of bodies that float
    supported: bool | None = None  # linalg.iteration: no body floats, as far as a hierarchy can tell
    convex: bool | None = None  # linalg.convexity: whether K was found to have no negative curvature
    convex_by_iteration: bool = False  # linalg.convexity: whether a run of conjugate gradients met none


@dataclass(eq=False)
class OfAnswer:
    """What has been computed of the last answer, each with the arrays that it was made of (`certificate.figures`)."""

    residuals: tuple[tuple[Any, ...], Any] | None = None  # in extended precision
    sizes: tuple[tuple[Any, ...], Any] | None = None  # forces and lengths by which residuals are measured


@dataclass(eq=False)
class Computed:
    """What has been computed of a stiffness and a set of rows, for every load, gap and friction that follow.

    `ContactProblem.replace` hands it on as long as stiffness and rows stay. Entries are None until they are asked for;
    each is made and read by one module, the one named beside it.
    """

    of_stiffness: OfStiffness = field(default_factory=OfStiffness)
    assembly: Any = None  # elements.structure, analysis.large: bodies and contacts that the problem was made of
    contact_points: Array | None = None  # likewise: (m, d), where the contacts of that problem are
    locks: dict[int, Any] = field(default_factory=dict)  # by process
    idle_rows: tuple[Mask, Mask] | None = None  # contacts and ties with rows of zeros
    acting: Any = None  # certificate.idle_rows: the problem without them
    parallel_rows: Any = None  # solving.presolve
    presolved: Any = None  # solving.presolve: the problem without rows that it can do without
    near_one: Any = None  # certificate.number_range: whether K and the rows are, and else these in other units
    unknown_scale: Vector | None = None  # linalg.condensation, where it is that of a condensed problem
    condensation: Any = None  # linalg.condensation
    wider_condensation: Any = None  # linalg.condensation: that of more contacts, from which to go on
    dependent_ties: Any = None  # certificate.idle_rows
    constraints_are_many: dict[bool, bool] = field(default_factory=dict)  # linalg.iteration: with friction, without
    sparse_saddle: dict[tuple[bytes, float], Any] = field(default_factory=dict)  # linalg.sparse_saddle: the last one
    last_solution: Any = None  # linalg.interior_point: the last one whose answer was given, in extended precision
    sparse_frictional_rows: Any = None  # linalg.sparse_states: with the coefficients that they are for
    equilibrated: Any = None  # linalg.equilibration: the problem in units of its own, and the way there
    equilibrated_forces: Any = None  # linalg.equilibration: the same with a unit of forces apart from that of lengths
    contact_compliance: Any = None  # linalg.delassus
    extended: Any = None  # linalg.extended: K and the rows for products in twice double precision
    iteration: Any = None  # linalg.iteration
    frictional_iteration: Any = None  # linalg.iteration, with the tangential rows
    frictional_rows: Any = None  # linalg.friction_states: with the coefficients and the condensation that they are of
    row_sizes: dict[int, Any] = field(default_factory=dict)  # linalg.measures: by the identity of the rows
    contact_entries: dict[int, Any] = field(default_factory=dict)  # certificate.coulomb_law: likewise
    parts: Indices | None = None  # linalg.measures: bodies connected by contacts and ties
    scale_through_rows: Vector | None = None  # linalg.measures
    untouched: Mask | None = None  # linalg.measures
    rounding_of_motions: Any = None  # certificate.figures: |K z| of rigid motions z
    independent_rows: bool | None = None  # certificate.uniqueness
    several_answers: Any = None  # certificate.other_answers: what was found of the last load, with what it was of
    critical_friction: Any = None  # certificate.critical_friction
    all_contacts: dict[bool, bool] = field(default_factory=dict)  # linalg.iteration: with friction, without
    subset: Any = None  # certificate.subset_bounds: contacts that are solved for, and the problem with these alone
    judged_subset: Any = None  # certificate.subset_bounds: the same of contacts that a certificate alone asks for
    judged_state: Any = None  # certificate.state_answer: the verdict of the last answer, with what it was of
    of_answer: OfAnswer = field(default_factory=OfAnswer)
    linearised: Any = None  # analysis.derivatives: the last answer whose derivatives were asked for, and its systems
    contact_operator: Any = None  # solving.friction.contact_form
    held_against: Any = None  # oracle.foreign.judging: right answers that answers to the last problem are held against
