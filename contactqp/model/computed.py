"""Cache factorisations and other results that depend on a problem's matrices."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from contactqp.model.arrays import Array, Indices, Mask, Vector


@dataclass(eq=False)
class OfStiffness:
    """Results that depend on the stiffness alone; problems with other contacts and ties share them."""

    diagonal: Vector | None = None
    own_scale: Vector | None = None  # 1/sqrt(K_jj)
    rows: Any = None  # K as a CSR matrix
    sizes: Any = None  # |K|
    bodies: Indices | None = None  # (n,) the connected part of K that each unknown belongs to
    extended: Any = None  # K for products in twice double precision
    elimination_order: Any = None  # linalg.pardiso: order of elimination of the first factorisation
    widest_level: int | None = None  # linalg.iteration: unknowns of a level of the breadth-first search
    factorised: bool = False  # linalg.iteration: whether a caller forces a factorisation
    iterable: bool | None = None  # linalg.iteration: whether a hierarchy represents all rigid motions
    supported: bool | None = None  # linalg.iteration: whether no body floats, by a hierarchy
    of_program: bool = False  # model.quadratic_program: whether it was given as P
    convex: bool | None = None  # linalg.convexity: whether K was found to have no negative curvature
    convex_by_iteration: bool = False  # linalg.convexity: the same by a run of conjugate gradients


@dataclass(eq=False)
class OfAnswer:
    """Results for the last answer, each with the arrays that it was computed from (`certificate.figures`)."""

    residuals: tuple[tuple[Any, ...], Any] | None = None  # in extended precision
    sizes: tuple[tuple[Any, ...], Any] | None = None  # forces and lengths by which residuals are measured
    inner_forces: tuple[Vector, Vector] | None = None  # linalg.measures: u and |K||u|
    polished: tuple[tuple[Any, ...], Any] = (), None  # linalg.refinement: the answer before it was rounded
    refined: tuple[tuple[Any, ...], Any] = (), None  # linalg.friction_states: the answer before it was rounded


@dataclass(eq=False)
class Computed:
    """Results that depend on a stiffness and a set of rows, valid for all loads, gaps and coefficients of friction.

    `ContactProblem.replace` passes them on if stiffness and rows stay the same. Each entry is None until it is
    computed, and is written and read by the module named beside it.
    """

    of_stiffness: OfStiffness = field(default_factory=OfStiffness)
    assembly: Any = None  # elements.structure, analysis.large: bodies and contacts of the problem
    contact_points: Array | None = None  # likewise: (m, d), positions of its contacts
    locks: dict[int, Any] = field(default_factory=dict)  # by process
    idle_rows: tuple[Mask, Mask] | None = None  # contacts and ties with rows of zeros
    acting: Any = None  # certificate.idle_rows: the problem without them
    parallel_rows: Any = None  # solving.presolve
    presolved: Any = None  # solving.presolve: the problem without redundant rows
    near_one: Any = None  # certificate.number_range: K and the rows in other units if needed
    unknown_scale: Vector | None = None  # linalg.condensation, where it is that of a condensed problem
    condensation: Any = None  # linalg.condensation
    rigid_motions: Array | None = None  # linalg.equilibration: (n, r), known before the problem was scaled
    wider_condensation: Any = None  # linalg.condensation: one of more contacts, to be reduced
    dependent_ties: Any = None  # certificate.idle_rows
    constraints_are_many: dict[bool, bool] = field(default_factory=dict)  # linalg.iteration: with friction, without
    sparse_saddle: dict[tuple[bytes, float], Any] = field(default_factory=dict)  # linalg.sparse_saddle: the last one
    last_solution: Any = None  # linalg.interior_point: the last one whose answer was given, in extended precision
    sparse_frictional_rows: Any = None  # linalg.sparse_states: with their coefficients
    equilibrated: Any = None  # linalg.equilibration: the scaled problem and its scaling
    equilibrated_forces: Any = None  # linalg.equilibration: the same with a unit of forces apart from that of lengths
    contact_compliance: Any = None  # linalg.delassus
    extended: Any = None  # linalg.extended: K and the rows for products in twice double precision
    iteration: Any = None  # linalg.iteration
    frictional_iteration: Any = None  # linalg.iteration, with the tangential rows
    frictional_rows: Any = None  # linalg.friction_states: with their coefficients and condensation
    row_sizes: dict[int, Any] = field(default_factory=dict)  # linalg.measures: by the identity of the rows
    contact_entries: dict[int, Any] = field(default_factory=dict)  # certificate.coulomb_law: likewise
    parts: Indices | None = None  # linalg.measures: bodies connected by contacts and ties
    scale_through_rows: Vector | None = None  # linalg.measures
    untouched: Mask | None = None  # linalg.measures
    rounding_of_motions: Any = None  # certificate.figures: |K z| of rigid motions z
    independent_rows: bool | None = None  # certificate.uniqueness
    several_answers: Any = None  # certificate.other_answers: results for the last load, with that load
    critical_friction: Any = None  # certificate.critical_friction
    all_contacts: dict[bool, bool] = field(default_factory=dict)  # linalg.iteration: with friction, without
    subset: Any = None  # certificate.subset_bounds: contacts of a subset, and the problem with these alone
    judged_subset: Any = None  # certificate.subset_bounds: the same for contacts of a certificate
    judged_state: Any = None  # certificate.state_answer: the verdict of the last answer, with that answer
    of_answer: OfAnswer = field(default_factory=OfAnswer)
    linearised: Any = None  # analysis.derivatives: the last answer with derivatives, and its systems
    contact_operator: Any = None  # solving.friction.contact_form
    held_against: Any = None  # oracle.foreign.judging: reference answers of the last problem


@dataclass(eq=False)
class OfLocalMatrices:
    """What has been computed of a local problem's matrices, for all problems that differ in their offsets alone."""

    sizes: Any = None  # certificate.local_certificate: |W|
    critical: Any = None  # certificate.local_certificate: the coefficients beneath which forces are unique
    extended: Any = None  # linalg.delassus: W for products in twice double precision
