"""The solution that answers are compared with, and the errors of an answer relative to it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from contactqp.errors import ContactQPError, InvalidProblem
from contactqp.linalg.condensation import condense
from contactqp.linalg.dense import saddle_point
from contactqp.model.arrays import EPS, Vector, in_any_time
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import read_array
from contactqp.model.solution import GLOBALLY, Solution
from contactqp.oracle.assertions import largest_of, weights
from contactqp.solving.solve import solve

# The rounding error of a few dozen additions, relative to the size of the terms.
SUMS_ROUND = 64 * EPS
# Answers with a larger true error are wrong; it is the certificate's error tolerance.
ERROR_TOLERANCE = 1e-6
# Values of `Errors.measure` where errors are not relative.
ABSOLUTE_ENERGY = "u absolute in the energy norm (the true energy vanishes)"
ABSOLUTE_FORCE = "λ absolute (the truth is zero)"
# What the source of a truth says if the proven solution differs from it.
CONTRADICTED = "which the proven solution contradicts: one of them is wrong"


@dataclass(frozen=True)
class Errors:
    """True errors of one answer; None where they are not finite or cannot be measured."""

    displacement: float | None  # ‖u − u*‖_K / ‖u*‖_K
    displacement_max: float | None  # max |u − u*| / max |u*|
    force: float | None  # max |λ_i − λ_i*| e_i / max |λ_i*| e_i with e_i = max_j |E_ij|
    measure: str  # "relative", or which errors are measured otherwise
    judged: float  # the largest of the deciding errors, relative to sizes that do not vanish
    allowance: float  # the part of `judged` that rounding the answer to doubles may cause

    @property
    def allowed(self) -> float:
        """Return the largest value of `judged` of an answer that is right."""
        return ERROR_TOLERANCE + self.allowance

    @property
    def small(self) -> bool:
        """Return whether the answer is right."""
        return self.judged <= self.allowed


@dataclass(frozen=True, eq=False)
class TrueAnswer:
    """The displacement and the forces that are right, without the problem that they solve."""

    displacement: Vector  # (n,)
    normal_force: Vector  # (m,)
    tie_force: Vector | None  # (k,)
    source: str
    unique_forces: bool = True
    free: bool = False  # whether there are free motions
    contradicted: bool = False  # a proven solution differs, so one of the two is wrong


@dataclass(frozen=True, eq=False)
class Truth(TrueAnswer):
    """The solution of a problem: stated exactly, given by a user, or proven.

    Contact forces are not unique where contacts are redundant; their resultants at the unknowns are, and are compared
    instead. Displacements are unique up to motions that nothing constrains.
    """

    problem: ContactProblem = field(kw_only=True)

    def errors(self, displacement: Vector, normal_force: Vector, tie_force: Vector | None) -> Errors:
        """Return the errors of an answer: displacement (n,), normal_force (m,), tie_force (k,) or None.

        The energy norm decides about u, and where the stiffness is singular, the largest unknown too. Where the truth
        is zero, errors are absolute and are judged relative to the lengths and forces that meet in the problem.
        """
        if not (np.all(np.isfinite(displacement)) and np.all(np.isfinite(normal_force))):
            return Errors(None, None, None, "the answer is not finite", float("inf"), 0.0)
        energy = self._energy(displacement - self.displacement)
        largest = _Measured.of(
            largest_of(displacement - self.displacement), largest_of(self.displacement), self._length()
        )
        force = self._force(normal_force, tie_force)
        decisive = [energy.judged] if energy.relative else []
        decisive += [largest.judged] if not self.free and (self._singular or not energy.relative) else []
        return Errors(
            energy.value,
            largest.value,
            force.value if force else None,
            self._measure(energy, largest, force),
            max([*decisive, force.judged if force else 0.0], default=0.0),
            self._allowance(),
        )

    def compared_with(self, proven: Solution) -> Truth:
        """Return this truth; its source says so if a proven solution contradicts it beyond the error tolerance."""
        if self.errors(proven.displacement, proven.normal_force, proven.tie_force).small:
            return self
        return replace(self, source=f"{self.source}, {CONTRADICTED}", contradicted=True)

    @property
    def _singular(self) -> bool:
        return condense(self.problem).rigid.count > 0

    def _energy(self, difference: Vector) -> _Measured:
        return _Measured.of(self._norm(difference), self._norm(self.displacement), self._norm_of_sizes())

    def _norm(self, displacement: Vector) -> float:
        return float(np.sqrt(max(displacement @ (self.problem.stiffness @ displacement), 0.0)))

    def _norm_of_sizes(self) -> float:
        """Return √(|u|ᵀ|K||u|), the size of the terms that cancel in ‖u‖_K."""
        size = abs(self.displacement)
        return float(np.sqrt(size @ (abs(self.problem.stiffness) @ size)))

    def _allowance(self) -> float:
        norm = self._norm(self.displacement)
        return SUMS_ROUND * self._norm_of_sizes() / norm if norm > SUMS_ROUND * self._norm_of_sizes() else 0.0

    def _length(self) -> float:
        """Return the largest length that meets at a contact or tie."""
        problem, size = self.problem, abs(self.displacement)
        at_contacts = (abs(problem.normal) @ size + abs(problem.gap)) / weights(problem.normal)
        at_ties = (abs(problem.tie) @ size + abs(problem.tie_value)) / weights(problem.tie)
        return max(largest_of(at_contacts), largest_of(at_ties))

    def _force(self, normal_force: Vector, tie_force: Vector | None) -> _Measured | None:
        if self.unique_forces:
            weight = weights(self.problem.normal)
            change, truth = (normal_force - self.normal_force) * weight, self.normal_force * weight
        elif tie_force is None or self.tie_force is None:
            return None
        else:
            truth = self._resultant(self.normal_force, self.tie_force)
            change = self._resultant(normal_force - self.normal_force, tie_force - self.tie_force)
        meeting = abs(self.problem.stiffness) @ abs(self.displacement) + abs(self.problem.load)  # at each unknown
        return _Measured.of(largest_of(change), largest_of(truth), largest_of(meeting))

    def _resultant(self, normal_force: Vector, tie_force: Vector) -> Vector:
        return np.asarray(self.problem.normal.T @ normal_force + self.problem.tie.T @ tie_force)

    def _measure(self, energy: _Measured, largest: _Measured, force: _Measured | None) -> str:
        notes = []
        if not energy.relative:
            notes.append(ABSOLUTE_ENERGY)
        if not largest.relative:
            notes.append("max-norm of u absolute (the truth is zero)")
        if not self.unique_forces:
            notes.append(f"redundant contacts: λ {'as resultants on the unknowns' if force else 'not unique'}")
        if force and not force.relative:
            notes.append(ABSOLUTE_FORCE)
        return "; ".join(notes) or "relative"


@dataclass(frozen=True)
class _Measured:
    """An error: relative to the truth, or absolute where the truth is zero to rounding."""

    value: float
    relative: bool
    judged: float

    @classmethod
    def of(cls, change: float, truth: float, scale: float) -> _Measured:
        """Measure a change; `scale` is the size of the terms that cancel in the truth, used where it is zero."""
        if truth > SUMS_ROUND * scale:
            return cls(change / truth, True, change / truth)
        if scale > 0:
            return cls(change, False, change / scale)
        return cls(change, False, 0.0 if change == 0 else float("inf"))


Reference = Solution | tuple[ArrayLike, ...]


def truth_of(problem: ContactProblem, reference: Reference | None = None) -> Truth | None:
    """Return the reference as a truth, or the proven active-set solution, or None where nothing is proven.

    If the proven solution contradicts the reference beyond the error tolerance, the text on the source states it.

    Raises InvalidProblem: the reference has wrong shapes, or values that are not finite.
    """
    own = proven_solution(problem)
    if reference is None:
        return None if own is None else truth_of_solution(own)
    truth = truth_of_reference(problem, reference)
    if own is None:
        return truth
    return replace(truth, unique_forces=_unique(own), free=bool(own.free_motions)).compared_with(own)


def proven_solution(problem: ContactProblem) -> Solution | None:
    """Return the active-set solution if its certificate passes with both bounds proven of every answer, else None."""
    try:
        solution = solve(problem)
    except ContactQPError:  # the row of the method has the reason
        return None
    return solution if solution.certificate.passed and solution.certificate.scope == GLOBALLY else None


def truth_of_solution(solution: Solution) -> Truth:
    """Return a solution whose errors are proven small as the truth."""
    bound = solution.certificate.energy_error, solution.certificate.force_error
    return Truth(
        problem=solution.problem,
        displacement=solution.displacement,
        normal_force=solution.normal_force,
        tie_force=solution.tie_force,
        source=f"{solution.method}, proven to {bound[0]:.1e} in u and {bound[1]:.1e} in λ (energy norm)",
        unique_forces=_unique(solution),
        free=bool(solution.free_motions),
    )


def _unique(solution: Solution) -> bool:
    closed = np.flatnonzero(solution.contact_status != "open")
    with in_any_time():
        return not saddle_point(condense(solution.problem), closed).redundant


def truth_of_reference(problem: ContactProblem, reference: Reference) -> Truth:
    """Return a reference as the truth.

    Raises InvalidProblem: it has wrong shapes, or values that are not finite.
    """
    if isinstance(reference, Solution):
        values: tuple[ArrayLike, ...] = (reference.displacement, reference.normal_force, reference.tie_force)
        source = f"reference by {reference.method}"
    else:
        values, source = tuple(reference), "reference"
    if len(values) not in (2, 3):
        raise InvalidProblem(f"reference: expected (displacement, normal_force[, tie_force]), got {len(values)} values")
    sizes = (problem.dimension, problem.contacts, problem.ties)
    names = ("displacement", "normal_force", "tie_force")
    vectors = [_vector(name, value, size) for name, value, size in zip(names, values, sizes, strict=False)]
    tie_force = vectors[2] if len(vectors) == 3 else None
    return Truth(vectors[0], vectors[1], tie_force, source, problem=problem)


def _vector(name: str, value: ArrayLike, size: int) -> Vector:
    vector = read_array(f"reference: {name}", value).ravel()
    if vector.shape != (size,) or not np.all(np.isfinite(vector)):
        raise InvalidProblem(f"reference: {name}: expected {size} finite numbers, got {vector}")
    return vector
