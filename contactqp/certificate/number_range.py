"""Change the units of problems whose numbers are far from one, so that they are near one.

With u = l D v, rows E = R E' / D and forces R^-1 l w, the problem K, f, E, g is the problem

    K' = D K D,   f' = D f / l,   E' = R^-1 E D,   g' = R^-1 g / l

with the same answer, and energies l^2 times as large. D gives K' a diagonal near one, R gives rows entries near one,
and l (the square root of an energy) the same to loads, overlaps and ties. All of them are powers of two, so nothing is
rounded, and squares of numbers stay in the range of doubles (1e-308 to 1e308) unless the answer does not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.bounds import Bounds
from contactqp.errors import InvalidProblem, NoEquilibrium, NotCertified
from contactqp.linalg.convexity import in_proportion
from contactqp.linalg.equilibration import ALIKE, balanced_exponents, mostly_bare
from contactqp.linalg.existence import BUT_FOR, Conflict, DrivenMotion
from contactqp.model.arrays import Array, Index, Vector
from contactqp.model.computed import Computed
from contactqp.model.names import describe_proof
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import FARTHEST, are_near_one
from contactqp.model.solution import Answer, FreeMotion, NegligibleSizes, Violations

# Displacements and forces beyond this (1e60), in units in which the problem's numbers are near one, are absurd.
ABSURD = 2.0**200
# Gaps beyond this multiple of the lengths are only reached by absurd answers.
FAR_AWAY = 2.0**300
# Tangential rows smaller or larger than the normal row by more than this have a separate unit.
OWN_UNIT = 60
# The range (1e3) within which largest entries of rows at unknowns without stiffness count as similar, also to those at
# stiff unknowns in their units. In units further apart, forces would be measured by the stiff unknowns only.
ALIKE_UNKNOWNS = 10
# Entries of a row that differ by more than this factor (7e19) are not related by rounding.
NO_ROUNDING = 66
# The least coefficient of friction of such contacts in these units; a smaller one has no effect.
LEAST_FRICTION = 2.0**-900
# The range of binary exponents in which squares, and their products with other sizes, do not overflow.
OF_SQUARES = 500
# Marks a problem in these units.
BROUGHT = "brought"
# The exponent of zero, and a lower bound of all others.
NONE, LEAST = -(10**6), -(10**5)
# The options of methods that are contact stiffnesses, with the rows along which they act.
STIFFNESSES = {"penalty": "contacts", "perturbation": "contacts", "tangential_penalty": "tangents"}


@dataclass(frozen=True, eq=False)
class NearOne:
    """A problem, the same problem in units in which its numbers are near one, and the exponents of these units."""

    whole: ContactProblem
    problem: ContactProblem
    unknowns: Index  # (n,) the exponents of D
    contacts: Index  # (m,) those of R, of the normal rows
    tangents: Index  # (m,) of the tangential rows
    ties: Index  # (k,)
    length: int  # the exponent of l

    def answer(self, answer: Answer) -> Answer:
        """Return an answer of the problem in these units."""
        friction = answer.friction_force
        return Answer(
            displacement=self.displacement(answer.displacement),
            normal_force=np.ldexp(answer.normal_force, self.contacts - self.length),
            friction_force=None if friction is None else np.ldexp(friction, self.tangents[:, None] - self.length),
            tie_force=np.ldexp(answer.tie_force, self.ties - self.length),
        )

    def whole_answer(self, answer: Answer) -> Answer:
        """Return an answer in the units of the problem; raise InvalidProblem if it overflows."""
        changed = dict(
            displacement=np.ldexp(answer.displacement, self.unknowns + self.length),
            normal_force=np.ldexp(answer.normal_force, self.length - self.contacts),
            tie_force=np.ldexp(answer.tie_force, self.length - self.ties),
        )
        for name, values in changed.items():
            if np.any(np.isinf(values) & np.isfinite(getattr(answer, name))):
                called = {"displacement": self.whole.dof_name, "tie_force": self.whole.tie_name}
                at = called.get(name, self.whole.contact_name)(int(np.argmax(np.isinf(values))))
                raise InvalidProblem(f"{name}: that of {at} is beyond 1.8e308; state the problem in other units")
        friction = answer.friction_force
        if friction is not None:
            friction = np.ldexp(friction, self.length - self.tangents[:, None])
        return Answer(**changed, friction_force=friction)

    def start(self, solution: Any) -> Any:
        """Return a starting solution in these units."""
        return replace(solution, problem=self.problem, answer=self.answer(solution.answer))

    def options(self, options: dict[str, Any]) -> dict[str, Any]:
        """Return the options of a method in these units, with contact stiffnesses scaled."""
        rows_of = {name: getattr(self, rows) for name, rows in STIFFNESSES.items() if options.get(name) is not None}
        return options | {name: np.ldexp(np.asarray(options[name], float), 2 * row) for name, row in rows_of.items()}

    def displacement(self, displacement: Vector) -> Vector:
        """Return a displacement of the problem in these units."""
        return np.asarray(np.ldexp(displacement, -self.unknowns - self.length))

    def coefficients(self, coefficients: Vector) -> Vector:
        """Return coefficients of friction in the units of the problem."""
        return np.asarray(np.ldexp(coefficients, self.contacts - self.tangents))

    def motions(self, found: tuple[FreeMotion, ...]) -> tuple[FreeMotion, ...]:
        """Return free motions in the units of the problem, with a largest component of one."""
        return tuple(replace(one, direction=self._largest_one(one.direction)[0]) for one in found)

    def _largest_one(self, motion: Vector) -> tuple[Vector, int]:
        """Return a motion in the problem's units, with largest component one, and the exponent of its unit."""
        exponent = int(np.max(_exponent(motion) + self.unknowns))
        moved = np.ldexp(motion, self.unknowns - exponent)
        return np.asarray(moved / np.max(abs(moved))), exponent

    def refuse_far_gap(self, solution: Any = None) -> None:
        """Raise InvalidProblem if an answer closes (without answer: may close) a gap that overflows here."""
        far = (self.problem.gap >= FAR_AWAY) & (self.problem.gap < np.inf)
        if solution is not None:
            far &= self.problem.normal @ solution.answer.displacement > FAR_AWAY / 2
        if far.any():
            i = int(np.argmax(far))
            raise InvalidProblem(
                f"gap: {self.whole.contact_name(i)} closes only after {self.whole.gap[i]:.3g}, more than 1e90 times "
                "what loads and ties move elsewhere; give infinity if it never closes"
            )

    def answer_of(self, solution: Any) -> Answer:
        """Return the answer in the problem's units; raise InvalidProblem if it or a gap overflows."""
        self.refuse_far_gap(solution)
        return self.whole_answer(solution.answer)

    def refuse_lost(self, found: Any, whole: Any) -> None:
        """Raise NotCertified if a solution passes only in these units, underflowing in the problem's."""
        if whole.certificate.passed or not found.certificate.passed:
            return
        for name in ("displacement", "normal_force", "tie_force"):
            there, here = getattr(found.answer, name), getattr(whole.answer, name)
            if np.any(there != 0) and abs(here).max() < np.finfo(float).tiny:
                told = f"{found.method}: {name}: the largest is below 2.2e-308; state the problem in other units"
                raise NotCertified(told, whole)

    def violations(self, found: Violations) -> Violations:
        """Return the figures, those with units in the units of the problem."""
        force, normal, slip = self.length - self.unknowns, self.length + self.contacts, self.length + self.tangents
        few = found.nothing
        width = len(few.tangent) // len(slip) if len(slip) else 1
        nothing = NegligibleSizes(
            np.ldexp(few.force, force),
            np.ldexp(few.normal, normal),
            np.ldexp(few.tangent, np.repeat(slip, width)),
            np.ldexp(few.tie, self.length + self.ties),
            None if few.contact_force is None else np.ldexp(few.contact_force, force),
        )
        return replace(
            found,
            residual=np.ldexp(found.residual, force),
            lengths=np.ldexp(found.lengths, normal),
            tangential_lengths=np.ldexp(found.tangential_lengths, slip),
            gap=np.ldexp(found.gap, normal),
            turned=np.ldexp(found.turned, self.length - self.tangents) if found.turned.size else found.turned,
            meeting=np.ldexp(found.meeting, force),
            intrinsic_size=float(np.ldexp(found.intrinsic_size, self.length)),
            nothing=nothing,
        )

    def bounds(self, bounds: Bounds) -> Bounds:
        """Return the bounds, those with units in the units of the problem."""
        changed: dict[str, Any] = {}
        for name, scale in (("energy_error", bounds.energy_scale), ("force_error", bounds.force_scale)):
            value = getattr(bounds, name)
            changed[name] = value if value is None or scale > 0 else float(np.ldexp(value, self.length))
        if bounds.force_bound is not None:
            changed["force_bound"] = np.ldexp(bounds.force_bound, self.length - self.contacts)
        if bounds.energy_bounds is not None:
            changed["energy_bounds"] = tuple(float(np.ldexp(value, 2 * self.length)) for value in bounds.energy_bounds)
        if bounds.radius is not None:
            changed["radius"] = float(np.ldexp(bounds.radius, self.length))
        return replace(bounds, solution=None, **changed)

    def no_equilibrium(self, error: NoEquilibrium) -> NoEquilibrium:
        """Return an error raised in these units with its proof and numbers in the units of the problem."""
        proof, text = self._proof(error.proof), str(error)
        figures = "" if proof is None else describe_proof(self.problem, error.proof)
        if error.proof is not None and (proof is None or figures not in text or BUT_FOR in text):
            text += " (figures in this message are in units that bring the numbers of the problem near one)"
        elif proof is not None:
            text = text.replace(figures, describe_proof(self.whole, proof))
        return NoEquilibrium(text, proof)

    def _proof(self, proof: Any) -> Any:
        if isinstance(proof, DrivenMotion):
            motion, unit = self._largest_one(proof.motion)
            factor = float(np.max(abs(np.ldexp(proof.motion, self.unknowns - unit))))
            work, rounding = (float(np.ldexp(x / factor, self.length - unit)) for x in (proof.work, proof.rounding))
            return DrivenMotion(motion, work, rounding)
        if isinstance(proof, Conflict):
            if len(proof.normal) != len(self.contacts):
                return None  # a proof of a relaxation, which has other rows
            exponents = np.concatenate([_exponent(proof.normal) - self.contacts, _exponent(proof.tie) - self.ties])
            unit = int(np.max(exponents))
            normal, tie = np.ldexp(proof.normal, -self.contacts - unit), np.ldexp(proof.tie, -self.ties - unit)
            size = float(max(abs(normal).max(initial=0.0), abs(tie).max(initial=0.0)))
            excess, rounding = (float(np.ldexp(x / size, self.length - unit)) for x in (proof.excess, proof.rounding))
            return Conflict(normal / size, tie / size, excess, rounding, proof.exact)
        return proof


def near_one(problem: ContactProblem) -> NearOne | None:
    """Return the problem in units in which its numbers are near one, None if they already are.

    Raises InvalidProblem: a coefficient of friction overflows in these units.
    """
    computed = problem._computed
    if computed.near_one is None:
        computed.near_one = (_matrices_are_near_one(problem), None)
    near, twin = computed.near_one
    if twin == BROUGHT or (near and _vectors_are_near_one(problem) and _units_are_own(problem)):
        return None
    if twin is None:
        twin = _rescaled(problem, _uniform_units(problem) or _row_units(problem))
        computed.near_one = (near, twin)
    return _under_load(problem, *twin)


def refuse_far_from_one(who: str, problem: ContactProblem, farthest: int = FARTHEST) -> None:
    """Raise InvalidProblem if the problem's numbers are so far from one that results would overflow."""
    near = _matrices_are_near_one(problem, farthest) and _vectors_are_near_one(problem, farthest)
    if near_one(problem) is not None and not near:
        raise InvalidProblem(
            f"{who}: expected stiffnesses, rows, loads and lengths whose sizes are from {2.0**-farthest:.0e} to "
            f"{2.0**farthest:.0e}, got others; state the problem in other units"
        )


def _exponent(values: Any) -> Index:
    """Return the binary exponent of each number, for zero one far below that of any double."""
    values = np.asarray(values, dtype=float)
    return np.where(values == 0, NONE, np.frexp(values)[1]).astype(np.int64)


def _matrices_are_near_one(problem: ContactProblem, farthest: int = FARTHEST) -> bool:
    matrices = _matrices(problem)
    sizes = [problem.diagonal, *(_largest(matrix) for matrix in matrices if matrix.nnz)]
    sizes += [] if problem.diagonal.all() else [_largest_without_stiffness(problem, matrices)]
    return all(are_near_one(one, farthest) for one in sizes)


def _largest_without_stiffness(problem: ContactProblem, matrices: list[Any]) -> Vector:
    """Return the largest entry of the rows at each unknown without stiffness (n,), zero at the others."""
    largest = np.zeros(problem.dimension)
    if problem.diagonal.all():
        return largest
    for matrix in matrices:
        np.maximum.at(largest, matrix.indices, abs(matrix.data))
    return np.where(problem.diagonal > 0, 0.0, largest)


def _matrices(problem: ContactProblem) -> list[Any]:
    return [problem.normal, problem.tie, *([] if problem.tangent is None else [problem.tangent])]


def _vectors_are_near_one(problem: ContactProblem, farthest: int = FARTHEST) -> bool:
    """Return whether the largest of load, gaps, ties and slip origins are in range and not all below it."""
    parts = [problem.load, problem.gap[np.isfinite(problem.gap)], problem.tie_value]
    if problem.slip_origin is not None:
        parts.append(problem.slip_origin)
    largest = max(float(abs(part).max(initial=0.0)) for part in parts)
    return are_near_one(np.array([largest]), farthest)


def _units_are_own(problem: ContactProblem) -> bool:
    """Return whether all unknowns have stiffness, or forces and lengths are similar and rows near one.

    Stiffness relates forces to lengths and scales each unknown. Without it the choice among several right answers would
    depend on units, and unknowns are scaled by rows. Programs, whose K is zero at most unknowns, are equilibrated when
    they are solved, with separate units of force and length.
    """
    if problem.diagonal.all() or mostly_bare(problem):
        return True
    return _rows_are_alike(problem) and _columns_are_alike(problem) and _uniform_unit(problem) == 0


def _rows_are_alike(problem: ContactProblem) -> bool:
    """Return whether the largest entries of all rows of contacts and ties are similar and near one."""
    sizes = np.concatenate([_row_exponents(problem.normal), _row_exponents(problem.tie)])
    sizes = np.append(sizes[sizes > LEAST], 0)
    return int(np.ptp(sizes)) <= ALIKE


def _columns_are_alike(problem: ContactProblem) -> bool:
    """Return whether the largest entries at unknowns without stiffness are near one, and rows have none far smaller."""
    matrices = _matrices(problem)
    sizes = _exponent(_largest_without_stiffness(problem, matrices))
    sizes = np.append(sizes[sizes > LEAST], 0)
    entries = _entries(matrices)
    bare = problem.diagonal[entries.col] == 0
    exponent, row, count = _exponent(entries.data), entries.row, entries.shape[0]
    largest, least = _largest_at(count, row[bare], exponent[bare]), -_largest_at(count, row[bare], -exponent[bare])
    of_stiff = exponent[~bare] - _exponent(problem.diagonal[entries.col[~bare]]) // 2
    beside = _largest_at(count, row[~bare], of_stiff)
    mixed = (largest > LEAST) & (beside > LEAST)
    apart = largest[mixed] + _uniform_unit(problem) - beside[mixed]
    alike = max(int(np.ptp(sizes)), int(np.max(abs(apart), initial=0))) <= ALIKE_UNKNOWNS
    return alike and bool(np.all(largest - least <= NO_ROUNDING))


def _largest_at(count: int, at: Index, values: Index) -> Index:
    """Return the largest value at each of `count` indices, NONE where there is none."""
    found = np.full(count, NONE)
    np.maximum.at(found, at, values)
    return found


def _row_exponents(rows: Any) -> Index:
    """Return the exponent of the largest entry of each row."""
    return _exponent(_largest(rows))


def _largest(rows: Any) -> Vector:
    """Return the largest entry of each row of a CSR matrix."""
    largest = np.zeros(rows.shape[0])
    filled = (rows.indptr[1:] > rows.indptr[:-1]).nonzero()[0]
    if filled.size:
        largest[filled] = np.maximum.reduceat(abs(rows.data), rows.indptr[filled])
    return largest


def _uniform_units(problem: ContactProblem) -> tuple[Index, Index] | None:
    """Return exponents of D and of all rows if one unit of length and one of force bring the matrices near one.

    Results that depend on relative sizes of unknowns, such as minimum-norm motions of floating bodies, are then the
    same in all units of length and force. Rows are unchanged, or scaled to similar sizes if they determine the scale of
    unknowns. None if separate units of unknowns are needed.
    """
    diagonal, rows, unit = problem.diagonal[problem.diagonal > 0], _matrices(problem), _uniform_unit(problem)
    exponents = _exponent(diagonal) + 2 * unit
    near = bool(np.all(abs(exponents) <= FARTHEST)) and all(are_near_one(_largest(matrix)) for matrix in rows)
    if not (near and are_near_one(_largest_without_stiffness(problem, rows))) or not _columns_are_alike(problem):
        return None
    sizes = np.concatenate([_row_exponents(matrix) for matrix in rows])
    alike = bool(problem.diagonal.all()) or _rows_are_alike(problem)
    return np.full(problem.dimension, unit), unit + np.where((sizes > LEAST) & (not alike), sizes, 0)


def _uniform_unit(problem: ContactProblem) -> int:
    """Return the exponent of D that brings the largest stiffness near one, or without stiffness, loads near lengths."""
    stiffest = problem.diagonal.max(initial=0.0)
    if stiffest > 0:
        return -(int(_exponent(stiffest)) // 2)
    sizes = np.concatenate([_row_exponents(problem.normal), _row_exponents(problem.tie)])
    return _unit_of_loads(problem, np.zeros(problem.dimension, dtype=int), np.where(sizes > LEAST, sizes, 0))


def _unit_of_loads(problem: ContactProblem, unknowns: Index, rows: Index) -> int:
    """Return the exponent of D, in addition to those of unknowns (n,) and rows, that makes loads and lengths similar.

    The largest finite gaps, ties and slip origins are the lengths.
    """
    m = problem.contacts
    normal, tie = rows[:m], rows[m : m + problem.ties]
    lengths = [(_exponent(problem.gap) - normal)[np.isfinite(problem.gap)], _exponent(problem.tie_value) - tie]
    if problem.slip_origin is not None:
        lengths.append((_exponent(problem.slip_origin) - normal[:, None]).ravel())
    force = int(np.max(_exponent(problem.load) + unknowns, initial=NONE))
    length = int(np.max(np.concatenate(lengths), initial=NONE))
    return (length - force) // 2 if min(force, length) > LEAST else 0


def _rescaled(
    problem: ContactProblem, units: tuple[Index, Index]
) -> tuple[ContactProblem, tuple[Index, Index, Index, Index]]:
    """Return the matrices in units, with the exponents of D and of normal, tangential and tie rows."""
    m, k = problem.contacts, problem.ties
    unknowns, sizes = units
    normal, tie = sizes[:m], sizes[m : m + k]
    width = (len(sizes) - m - k) // m if m else 0
    across = sizes[m + k :].reshape(m, width).max(axis=1) if width else normal
    felt = np.diff(problem.tangent.indptr).reshape(m, width).any(axis=1) if problem.tangent is not None else False
    across = np.where(felt & (abs(across - normal) > OWN_UNIT), across, normal)  # a row of zeros has no unit
    K = sp.coo_array(problem.stiffness_rows)
    stiffness = sp.csc_array((np.ldexp(K.data, unknowns[K.row] + unknowns[K.col]), (K.row, K.col)), shape=K.shape)
    values = problem._values() | dict(
        stiffness=stiffness if sp.issparse(problem.stiffness) else stiffness.toarray(),
        normal=_times(problem.normal, -normal, unknowns),
        tie=_times(problem.tie, -tie, unknowns),
        near_null_space=None if problem.near_null_space is None else _motions(problem.near_null_space, unknowns),
    )
    if problem.tangent is not None:
        values["tangent"] = _times(problem.tangent, -np.repeat(across, width), unknowns)
    computed = Computed(near_one=(True, BROUGHT))
    return ContactProblem._of_checked(values, computed), (unknowns, normal, across, tie)


def _entries(matrices: list[Any]) -> Any:
    """Return the entries of rows that are not zero."""
    entries = sp.coo_array(sp.vstack(matrices))
    entries.eliminate_zeros()
    return entries


def _of_constraints(problem: ContactProblem, entries: Any) -> Any:
    """Return entries of the rows of normals, ties and tangents, with those of a contact combined in one row."""
    others = problem.contacts + problem.ties
    width = max((entries.shape[0] - others) // max(problem.contacts, 1), 1)
    row = np.where(entries.row < others, entries.row, (entries.row - others) // width)
    return sp.coo_array((entries.data, (row, entries.col)), shape=entries.shape)


def _row_units(problem: ContactProblem) -> tuple[Index, Index]:
    """Return the exponents of D (n,), and of the rows of normals, ties and tangents.

    Unknowns with stiffness have a unit diagonal; others have similar entries of rows, or a largest one like its row's.
    """
    entries = _entries(_matrices(problem))
    count, exponent, stiff = entries.shape[0], _exponent(entries.data), problem.diagonal > 0
    unknowns = np.where(stiff, -(_exponent(problem.diagonal) // 2), 0)
    balanced = balanced_exponents(_of_constraints(problem, entries), exponent, unknowns, ~stiff)
    if balanced is not None:
        return _with_loads_near_lengths(problem, entries, balanced)
    use = stiff[entries.col]
    sizes = _largest_at(count, entries.row[use], (exponent + unknowns[entries.col])[use])
    sizes = np.where(sizes > LEAST, sizes, _largest_at(count, entries.row, exponent + unknowns[entries.col]))
    of_columns = _largest_at(problem.dimension, entries.col, exponent - sizes[entries.row])
    return _with_loads_near_lengths(problem, entries, np.where(~stiff & (of_columns > LEAST), -of_columns, unknowns))


def _with_loads_near_lengths(problem: ContactProblem, entries: Any, unknowns: Index) -> tuple[Index, Index]:
    """Return exponents of D and of all rows; without stiffness, a further unit brings loads near lengths."""
    sizes = _largest_at(entries.shape[0], entries.row, _exponent(entries.data) + unknowns[entries.col])
    sizes = np.where(sizes > LEAST, sizes, 0)
    unit = 0 if problem.diagonal.any() else _unit_of_loads(problem, unknowns, sizes)
    return unknowns + unit, sizes + unit


def _times(rows: Any, of_rows: Index, of_unknowns: Index) -> Any:
    entries = sp.coo_array(rows)
    data = np.ldexp(entries.data, of_rows[entries.row] + of_unknowns[entries.col])
    return sp.csr_array((data, (entries.row, entries.col)), shape=rows.shape)


def _motions(motions: Array, unknowns: Index) -> Array:
    """Return motions in these units, each with a largest component near one."""
    largest = np.max(_exponent(motions) - unknowns[:, None], axis=0)
    return np.asarray(np.ldexp(motions, -unknowns[:, None] - largest))


def _under_load(problem: ContactProblem, twin: ContactProblem, units: tuple[Index, Index, Index, Index]) -> NearOne:
    """Return the problem with its own load, gaps, ties and friction in units near one."""
    unknowns, normal, across, tie = units = (in_proportion(problem, units[0]), *units[1:])
    length = _length(problem, units)
    gap = np.minimum(np.ldexp(problem.gap, -normal - length), FAR_AWAY)
    values = twin._values() | dict(
        load=np.ldexp(problem.load, unknowns - length),
        load_sum=None if problem.load_sum is None else np.ldexp(problem.load_sum, unknowns - length),
        gap=np.where(problem.gap == np.inf, np.inf, gap),
        tie_value=np.ldexp(problem.tie_value, -tie - length),
        dof_names=problem.dof_names,
        contact_names=problem.contact_names,
        units=problem.units,
    )
    if problem.slip_origin is not None and problem.friction is not None:
        values["slip_origin"] = np.ldexp(problem.slip_origin, -across[:, None] - length)
        values["friction"] = _coefficients(problem, problem.friction, across - normal)
    return NearOne(problem, ContactProblem._of_checked(values, twin._computed), *units, length)


def _length(problem: ContactProblem, units: tuple[Index, Index, Index, Index]) -> int:
    """Return the exponent of l, by the largest load, overlap, tie or slip origin, else by the least gap."""
    unknowns, normal, across, tie = units
    sizes = [
        _exponent(problem.load) + unknowns,
        _exponent(np.minimum(problem.gap, 0.0)) - normal,
        _exponent(problem.tie_value) - tie,
    ]
    if problem.slip_origin is not None:
        sizes.append((_exponent(problem.slip_origin) - across[:, None]).ravel())
    largest = int(np.max(np.concatenate(sizes), initial=NONE))
    if largest > LEAST:
        return largest
    gaps = (_exponent(problem.gap) - normal)[np.isfinite(problem.gap) & (problem.gap > 0)]
    return int(np.min(gaps)) if gaps.size else 0


def _coefficients(problem: ContactProblem, given: Vector, exponents: Index) -> Vector:
    """Return Coulomb's coefficients for normal and tangential rows in separate units."""
    found = np.asarray(np.ldexp(given, exponents))
    lost = (found > ABSURD) & (given <= ABSURD)
    if lost.any():
        i = int(np.argmax(lost))
        raise InvalidProblem(
            f"tangent: the rows of {problem.contact_name(i)} are less than 1e-60 of its normal row, measured by the "
            "stiffness of their unknowns; expected rows of one unit of length"
        )
    return np.where((given > 0) & (found < LEAST_FRICTION), LEAST_FRICTION, found)
