"""Remove idle rows, contacts with infinite gaps and rows of zeros, before solving and certifying, and restore them.

A row of zeros states 0 <= g or 0 = b, as for a fixed node: it is satisfied, and its force is 0, or there is no
equilibrium.

Ties that depend on others are found at the end of this file.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.bounds import NEXT_TO_NOTHING
from contactqp.certificate.coulomb_law import contact_entries, vector_measure
from contactqp.certificate.figures import energy_norm, response
from contactqp.certificate.number_range import ABSURD, near_one
from contactqp.errors import NoEquilibrium
from contactqp.linalg.condensation import Condensation, condense
from contactqp.linalg.existence import Conflict
from contactqp.linalg.extended import extend, two_product
from contactqp.linalg.floating import independent_rows
from contactqp.linalg.iteration import Systems, systems_of
from contactqp.linalg.krylov import IndependentRows
from contactqp.linalg.measures import NOTHING_BY_DEFAULT, forces_that_meet, row_sizes
from contactqp.model.arrays import Indices, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Certificate, NegligibleSizes, Violations

# The arrays of `Violations` with an entry for every contact.
_OF_CONTACTS = (
    "penetration",
    "tension",
    "complementarity",
    "cone",
    "slip_direction",
    "slip_measure",
    "lengths",
    "tangential_lengths",
    "gap",
    "gap_measure",
    "force_measure",
)


# Quantities and parameters with entries for each contact.
_BY_CONTACT = ("normal_force", "friction_force", "gap", "slip", "friction", "slip_origin", "rows")


@dataclass(frozen=True, eq=False)
class ActingRows:
    """The contacts and ties whose rows are not zero, and the problem with these alone.

    `repeats` has a tie that repeats another one, and that other one, in pairs; derivatives leave the first out.
    """

    whole: ContactProblem
    contacts: Indices
    ties: Indices
    problem: ContactProblem
    repeats: tuple[tuple[int, int], ...] = ()

    @property
    def met(self) -> bool:
        """Return whether every row of zeros is satisfied."""
        contacts, ties = _others(self.whole.contacts, self.contacts), _others(self.whole.ties, self.ties)
        return not (np.any(self.whole.gap[contacts] < 0) or np.any(self.whole.tie_value[ties] != 0))

    def refuse_conflict(self) -> None:
        """Raise NoEquilibrium if a row of zeros is not satisfied: 0 <= g < 0, or 0 = b with b not zero."""
        whole = self.whole
        for name, called, limit, idle in (
            ("normal", whole.contact_name, whole.gap, _others(whole.contacts, self.contacts)),
            ("tie", whole.tie_name, whole.tie_value, _others(whole.ties, self.ties)),
        ):
            missed = idle[limit[idle] < 0] if name == "normal" else idle[limit[idle] != 0]
            if missed.size:
                i = int(missed[0])
                normal, tie = np.zeros(whole.contacts), np.zeros(whole.ties)
                (normal if name == "normal" else tie)[i] = 1.0 if name == "normal" else -np.sign(limit[i])
                what = "overlap" if name == "normal" else "value"
                raise NoEquilibrium(
                    f"{called(i)} acts on nothing that moves, and no displacement removes its {what} of "
                    f"{abs(limit[i]):.6g}",
                    Conflict(normal, tie, abs(float(limit[i])), 0.0, True),
                )

    def answer(self, answer: Answer) -> Answer:
        """Return the part of an answer that belongs to the acting rows."""
        friction, tie = (
            None if answer.friction_force is None else answer.friction_force[self.contacts],
            answer.tie_force,
        )
        for other, kept in self.repeats:
            one, place = _data_of_tie(self.whole, kept)
            tie = tie.copy()
            tie[kept] += tie[other] * _data_of_tie(self.whole, other)[0][place] / one[place]
        return Answer(answer.displacement, answer.normal_force[self.contacts], friction, tie[self.ties])

    def whole_answer(self, answer: Answer) -> Answer:
        """Return an answer on the acting rows as one of the whole problem, without force on the other rows."""
        friction = None if answer.friction_force is None else self.friction(answer.friction_force)
        return Answer(answer.displacement, self.normal(answer.normal_force), friction, self.tie(answer.tie_force))

    def start(self, solution: Any) -> Any:
        """Return the part of a starting solution that belongs to the acting rows."""
        return replace(solution, problem=self.problem, answer=self.answer(solution.answer))

    def at(self, step: ContactProblem) -> ActingRows:
        """Return the acting rows of a step: a problem with the same rows, another load and slip origin."""
        changes: dict[str, Any] = dict(load=step.load)
        if self.whole.slip_origin is not None and step.slip_origin is not None:
            changes["slip_origin"] = np.array(self.whole.slip_origin)
            changes["slip_origin"][self.contacts] = step.slip_origin
        return replace(self, whole=self.whole.replace(**changes), problem=step)

    def acting(self, solution: Any) -> Any:
        """Return a solution of the whole problem as one on the acting rows, with its verdict."""
        violations = solution.certificate.violations
        if violations is not None:
            names = ("slip_measure", "gap_measure", "force_measure")
            violations = replace(violations, **{name: getattr(violations, name)[self.contacts] for name in names})
        certificate = replace(solution.certificate, violations=violations)
        status = solution.contact_status[self.contacts]
        return replace(self.start(solution), contact_status=status, certificate=certificate)

    def part(self, name: str, values: Any) -> Any:
        """Return the part of a quantity or parameter for the acting rows, or all of it if it has no part for each
        row.
        """
        if name in ("tie_force", "tie_value"):
            return values[self.ties]
        return values[self.contacts] if name in _BY_CONTACT else values

    def spread(self, name: str, values: Any) -> Any:
        """Return a quantity or a parameter of the acting rows as one of all rows, zero on the others."""
        if name in ("tie_force", "tie_value"):
            return self.tie(values)
        if name in ("friction_force", "slip", "slip_origin"):
            return self.friction(values)
        if name == "rows":
            whole = self.whole.normal
            entries = np.zeros(whole.nnz)
            entries[np.isin(np.repeat(np.arange(self.whole.contacts), np.diff(whole.indptr)), self.contacts)] = (
                values.data
            )
            return sp.csr_array((entries, whole.indices, whole.indptr), shape=whole.shape)
        return self.normal(values) if name in _BY_CONTACT else values

    @property
    def idle_contacts(self) -> Indices:
        """Return the contacts that constrain nothing."""
        return _others(self.whole.contacts, self.contacts)

    def without_answer(self, name: str, values: Any = None) -> str:
        """Return why there is no answer in a direction, in which a row of zeros is violated, else an empty string.

        Parameters
        ----------
        name, values : a parameter, and a direction of it, all of its entries where that is None
        """
        for other, kept in self.repeats if name == "tie_value" else ():
            changes = np.array([1.0, 0.0]) if values is None else values[[other, kept]]
            (one, place), row = _data_of_tie(self.whole, kept), _data_of_tie(self.whole, other)[0]
            if not all(
                map(np.array_equal, two_product(changes[:1], one[[place]]), two_product(changes[1:], row[[place]]))
            ):
                both = f"{self.whole.tie_name(other)} repeats {self.whole.tie_name(kept)}"
                return f"{both}, and no displacement has the values of both if one changes without the other"
        idle, called = self.idle_contacts, self.whole.contact_name
        idle = idle[self.whole.gap[idle] <= 0]
        text = "has no gap: towards a side there is no answer near this one"
        if name == "tie_value":
            left_out = [other for other, _ in self.repeats]
            idle, called = np.setdiff1d(_others(self.whole.ties, self.ties), left_out), self.whole.tie_name
            text = "no displacement has its value: towards a side there is no answer"
        elif name not in ("gap", "rows") or (name == "rows" and values is None):
            return ""
        touched = [i for i in idle.tolist() if values is None or abs(values[[i]]).sum() > 0]
        if name == "gap" and values is not None and (np.all(values[idle] >= 0) or np.all(values[idle] <= 0)):
            return ""  # towards one side there is an answer
        return f"{called(touched[0])} acts on nothing that moves and {text}" if touched else ""

    def solution(self, found: Any) -> Any:
        """Return a solution on the acting rows as one of the whole problem."""
        changed = self.forces(found) | dict(certificate=self._judged(found))
        if found.raw is not None:
            changed["raw"] = replace(found.raw, problem=self.whole, answer=self.whole_answer(found.raw.answer))
        return replace(found, **changed)

    def forces(self, found: Any) -> dict[str, Any]:
        """Return problem, answer and contact states of a solution on the acting rows, extended to the whole problem."""
        whole = self.whole
        status = np.full(whole.contacts, "open", dtype=found.contact_status.dtype)
        status[self.contacts] = found.contact_status
        return dict(problem=whole, contact_status=status, answer=self.whole_answer(found.answer))

    def friction(self, force: Any) -> Any:
        """Return the friction forces of all contacts (..., m, d-1) from those of the acting ones."""
        origin = self.whole.slip_origin
        if origin is None:
            return None
        every = np.zeros((*force.shape[:-2], *origin.shape))
        every[..., self.contacts, :] = force
        return every

    def normal(self, force: Any) -> Any:
        """Return the normal forces of all contacts (..., m) from those of the acting ones."""
        return _spread(self.whole.contacts, self.contacts, force)

    def tie(self, force: Any) -> Any:
        """Return the forces of all ties (..., k) from those of the acting ones."""
        return _spread(self.whole.ties, self.ties, force)

    def _judged(self, found: Any) -> Any:
        nothing = Answer(found.answer.displacement, np.zeros(self.whole.contacts), None, np.zeros(self.whole.ties))
        return self.certificate(found.certificate, nothing)

    def certificate(self, certificate: Any, answer: Answer) -> Any:
        """Return the certificate of the whole problem's answer from that of the acting rows.

        A force on an idle row is refused, as is a row of zeros that is not satisfied.
        """
        if certificate.violations is None:
            return certificate
        found = self._violations(certificate.violations, answer)
        figures = {name: float(np.max(getattr(found, name), initial=0.0)) for name in ("penetration", "tension")}
        figures |= {
            name: float(np.max(getattr(found, name), initial=0.0)) for name in ("complementarity", "cone", "tie")
        }
        failures = (*certificate.failures, *self._failures(found, answer, certificate.tolerance))
        bound = None
        if certificate.force_bound is not None:
            bound = self._contacts(certificate.force_bound, abs(answer.normal_force))
        return replace(
            certificate,
            **figures,
            force_bound=bound,
            grazing=tuple(int(self.contacts[i]) for i in certificate.grazing),
            failures=failures,
            passed=not failures,
            violations=found,
        )

    def _contacts(self, values: Vector, others: Vector | None = None) -> Vector:
        return np.asarray(_spread(self.whole.contacts, self.contacts, values, others))

    def _violations(self, found: Violations, answer: Answer) -> Violations:
        """Return the figures of all rows; rows of zeros are measured by the forces on them."""
        whole = self.whole
        push, drag = _pushes(whole, answer)
        free = np.where(np.isinf(whole.gap) | (whole.gap >= 0), 0.0, 1.0)
        others: dict[str, Vector] = {name: np.zeros(whole.contacts) for name in _OF_CONTACTS}
        others |= dict(lengths=np.full(whole.contacts, np.inf), tangential_lengths=np.full(whole.contacts, np.inf))
        others |= dict(gap=whole.gap, force_measure=push, cone=drag, penetration=free)
        others |= dict(gap_measure=np.where(whole.gap == 0, 0.0, 1.0))
        others["tension"] = np.where(answer.normal_force < 0, push, 0.0)
        others["complementarity"] = np.where(answer.normal_force > 0, push, 0.0)
        spread: dict[str, Any] = {n: self._contacts(getattr(found, n), others[n]) for n in _OF_CONTACTS}
        unmet = np.where((whole.tie_value != 0) | (answer.tie_force != 0), 1.0, 0.0)
        tie = _spread(whole.ties, self.ties, found.tie, unmet)
        return replace(replace(found, tie=tie, nothing=self._nothing(found.nothing)), **spread)

    def _nothing(self, nothing: NegligibleSizes) -> NegligibleSizes:
        """Return the negligible sizes of all rows; on rows of zeros only zero is negligible."""
        whole = self.whole
        tangent = nothing.tangent
        if whole.slip_origin is not None:
            shape = whole.slip_origin.shape
            across = np.zeros(shape)
            if tangent.size:
                across[self.contacts] = tangent.reshape(len(self.contacts), shape[1])
            tangent = across.ravel()
        tie = _spread(whole.ties, self.ties, nothing.tie)
        return NegligibleSizes(nothing.force, self._contacts(nothing.normal), tangent, tie, nothing.contact_force)

    def _failures(self, found: Violations, answer: Answer, tolerance: float) -> Iterator[str]:
        whole, idle = self.whole, _others(self.whole.contacts, self.contacts)
        for i in idle.tolist():
            name, force = whole.contact_name(i), answer.normal_force[i]
            if found.penetration[i] > tolerance:
                yield f"penetration: {name} acts on nothing that moves, and its gap is {whole.gap[i]:.6g}"
            if max(found.tension[i], found.complementarity[i]) > tolerance:
                kind = "tension" if force < 0 else "complementarity"
                yield f"{kind}: {name} constrains nothing and has a force of {force:.6g}"
            if found.cone[i] > tolerance:
                yield f"cone: {name} constrains nothing and has friction"
        for i in _others(whole.ties, self.ties).tolist():
            if found.tie[i] > tolerance:
                value, force = whole.tie_value[i], answer.tie_force[i]
                what = f"its value is {value:.6g}, its force {force:.6g}"
                yield f"tie: {whole.tie_name(i)} acts on nothing that moves; {what}"


def forces_without_law(problem: ContactProblem, answer: Answer) -> tuple[Vector, Vector, Vector]:
    """Return E'l (n,) of forces that the law requires to be zero, and their normal and tangential sizes (m,).

    These are forces of contacts that never close, and friction with a coefficient of zero.
    """
    never = np.isinf(problem.gap)
    push, friction = np.where(never, answer.normal_force, 0.0), np.zeros(problem.contacts)
    load = problem.normal.T @ push
    if answer.friction_force is not None and problem.tangent is not None:
        smooth = never | (True if problem.friction is None else problem.friction <= 0)
        stray = np.where(smooth[:, None], answer.friction_force, 0.0)
        load, friction = load + problem.tangent.T @ stray.ravel(), np.linalg.norm(stray, axis=1)
    return np.asarray(load), abs(push), np.asarray(friction)


def with_forces_without_law(problem: ContactProblem, answer: Answer, certificate: Certificate) -> Certificate:
    """Return a certificate whose force errors include forces that the law requires to be zero.

    Other bounds compare with an answer without them and do not include them. They are measured by the energy of the
    bodies' response, beside that of the contact forces and the strain, in units in which the problem's numbers are near
    one; where the bodies are not condensed by |D E'l| with D = 1/sqrt(K_jj).
    """
    load, push, friction = forces_without_law(problem, answer)
    if certificate.violations is None or not (load.any() or friction.any()):
        return certificate
    near = near_one(problem)
    seen, theirs, unit = (problem, answer, 0) if near is None else (near.problem, near.answer(answer), near.length)
    size, pushed, strain = _energies(seen, theirs)
    nothing = size <= NOTHING_BY_DEFAULT * np.ldexp(certificate.violations.intrinsic_size, -unit)
    pressed = pushed > NEXT_TO_NOTHING * max(strain, size)  # else errors of forces are absolute
    scale, failures = pushed if pressed else strain, certificate.failures
    part = size / scale if scale > 0 else np.inf
    if not (nothing or part <= certificate.error_tolerance):
        worst = int(np.argmax(np.maximum(push, friction)))
        why = "its gap is infinite" if np.isinf(problem.gap[worst]) else "its coefficient of friction is zero"
        where = f"{problem.contact_name(worst)} has a force that the law makes zero, as {why}"
        failures = (*failures, f"force_error: {part:.2g} of the contact forces; {where}")
    error, bound = certificate.force_error, certificate.force_bound
    return replace(
        certificate,
        force_error=None if error is None else error + (part if pressed else float(np.ldexp(size, unit))),
        force_bound=None if bound is None else bound + friction,
        distance=None if certificate.distance is None else certificate.distance + part,
        failures=failures,
        passed=not failures,
    )


def _energies(problem: ContactProblem, answer: Answer) -> tuple[float, float, float]:
    """Return the energy norms of the response to forces that should be zero, to all others, and of the displacement."""
    load = forces_without_law(problem, answer)[0]
    if not (np.isfinite(load).all() and abs(load).max() <= ABSURD):
        return np.inf, 0.0, 0.0
    rows = acting_rows(problem)
    problem, answer = (problem, answer) if rows is None else (rows.problem, rows.answer(answer))
    push = problem.normal.T @ answer.normal_force - load
    if answer.friction_force is not None and problem.tangent is not None:
        push = push + problem.tangent.T @ answer.friction_force.ravel()
    strain, _ = energy_norm(problem, extend(answer.displacement))
    if systems_of(problem) is not Systems.CONDENSED:
        return float(np.linalg.norm(problem.own_scale * load)), float(np.linalg.norm(problem.own_scale * push)), strain
    condensation = condense(problem)
    found = []
    for one in (load, push):
        u, left = response(problem, condensation, extend(one), tied=True)
        found.append(energy_norm(problem, u)[0] + left)
    return found[0], found[1], strain


def acting_rows(problem: ContactProblem) -> ActingRows | None:
    """Return the acting rows of a problem, None if all of them act."""
    idle_contacts, idle_ties = problem.idle_rows()
    if not (idle_contacts.any() or idle_ties.any()):
        return None
    contacts, ties = np.flatnonzero(~idle_contacts), np.flatnonzero(~idle_ties)
    cached = problem._computed.acting
    if cached is None or not np.array_equal(cached[0], contacts):
        cached = problem._computed.acting = (contacts, problem.with_contacts(contacts).with_ties(ties))
    changes: dict[str, Any] = dict(load=problem.load, gap=problem.gap[contacts], tie_value=problem.tie_value[ties])
    changes |= dict(dof_names=problem.dof_names, units=problem.units)
    changes |= dict(contact_names=[problem.contact_name(int(i)) for i in contacts])
    if problem.friction is not None and problem.slip_origin is not None:
        changes |= dict(friction=problem.friction[contacts], slip_origin=problem.slip_origin[contacts])
    acting = cached[1].replace(**changes)
    if problem.load_sum is not None:
        acting = acting._with_load_sum(problem.load, problem.load_size)
    return ActingRows(problem, contacts, ties, acting)


def acting_once(problem: ContactProblem) -> ActingRows | None:
    """Return the acting rows of a certified problem without exactly repeated ties, None if all act."""
    rows = acting_rows(problem) if problem.has_idle_rows else None
    inner = problem if rows is None else rows.problem
    found = [
        (i, int(on[0]))
        for i, on in inner._computed.dependent_ties or ()
        if len(on) == 1 and _repeats(inner, i, int(on[0]))
    ]
    if not found:
        return rows
    kept = _others(inner.ties, np.array([i for i, _ in found], dtype=np.intp))
    reduced = inner.with_ties(kept)
    reduced._computed.wider_condensation = inner._computed.condensation
    whole = np.arange(problem.ties) if rows is None else rows.ties
    contacts = np.arange(problem.contacts) if rows is None else rows.contacts
    pairs = tuple((int(whole[i]), int(whole[j])) for i, j in found)
    return ActingRows(problem, contacts, whole[kept], reduced, pairs)


def _data_of_tie(problem: ContactProblem, tie: int) -> tuple[Vector, int]:
    """Return the row of a tie with its value (n + 1,), and the index of the largest entry of the row."""
    row = problem.tie[[tie]].toarray().ravel()
    return np.append(row, problem.tie_value[tie]), int(np.argmax(abs(row)))


def _repeats(problem: ContactProblem, tie: int, kept: int) -> bool:
    """Return whether a tie is exactly a multiple of another one, by exact products of doubles."""
    (one, _), (other, place) = _data_of_tie(problem, tie), _data_of_tie(problem, kept)
    return all(map(np.array_equal, two_product(one, other[place]), two_product(other, one[place])))


def _others(count: int, members: Indices) -> Indices:
    return np.setdiff1d(np.arange(count), members)


def _spread(count: int, members: Indices, values: Any, others: Vector | None = None) -> Any:
    everywhere = np.zeros((*np.shape(values)[:-1], count)) if others is None else np.array(others, dtype=float)
    everywhere[..., members] = values
    return everywhere


def _pushes(problem: ContactProblem, answer: Answer) -> tuple[Vector, Vector]:
    """Return the measures of normal and friction forces, (m,) each; a force on a row of zeros measures one."""
    F, m = forces_that_meet(problem, answer), problem.contacts
    zero = np.diff(problem.normal.indptr) == 0
    push = np.where(zero, answer.normal_force != 0, row_sizes(problem, problem.normal).measure(answer.normal_force, F))
    if answer.friction_force is None or problem.tangent is None:
        return push, np.zeros(m)
    drag = vector_measure(contact_entries(problem, "tangent"), answer.friction_force, F, np.zeros_like(F))
    held = np.diff(problem.tangent.indptr).reshape(answer.friction_force.shape) == 0
    return push, np.where(np.any(held & (answer.friction_force != 0), axis=1), 1.0, drag)


# Weights below this do not count in a dependence of unit rows.
NO_PART = 1e-9
# The residual of a dependent unit row, by rounding of sparse factors.
VERIFIED, MOST_VERIFIED = 1e-10, 100


def dependent_ties(problem: ContactProblem, condensation: Condensation) -> tuple[tuple[int, Indices], ...]:
    """Return the ties that depend on others, with these, found once for the rows of a problem.

    They are those without force if all ties act; contradicting values are refused in `existence`.
    """
    if problem._computed.dependent_ties is None:
        rows = condensation.tie * condensation.scale
        rows = rows / np.linalg.norm(rows, axis=1, keepdims=True)
        kept = independent_rows(rows)
        others = np.setdiff1d(np.arange(len(rows)), kept)
        shares, *_ = np.linalg.lstsq(rows[kept].T, rows[others].T, rcond=None)
        taking_part = [kept[abs(share) > NO_PART] for share in shares.T]
        problem._computed.dependent_ties = tuple(zip(others.tolist(), taking_part, strict=True))
    found: tuple[tuple[int, Indices], ...] = problem._computed.dependent_ties
    return found


def sharing_unknowns(rows: Any) -> Indices:
    """Return the rows of a CSR matrix that may be dependent, as they share each of their unknowns with others.

    A row with an unshared unknown is independent and is left out, and then so are rows with which it was the only one
    to share an unknown.
    """
    left = np.arange(rows.shape[0])
    while left.size:
        some = rows[left]
        once = np.bincount(some.indices, some.data != 0, minlength=rows.shape[1]) == 1
        alone = np.zeros(len(left), dtype=bool)
        alone[np.repeat(np.arange(len(left)), np.diff(some.indptr))[once[some.indices] & (some.data != 0)]] = True
        if not alone.any():
            break
        left = left[~alone]
    return left


def dependent_sparse_ties(problem: ContactProblem) -> tuple[tuple[int, Indices], ...]:
    """Return `dependent_ties` of many ties, by sparse factors of their Gram matrix, at most MOST_VERIFIED."""
    if problem._computed.dependent_ties is None:
        ties = sharing_unknowns(problem.tie)
        length = np.sqrt(np.asarray(problem.tie.multiply(problem.tie).sum(axis=1)).ravel()[ties])
        rows = sp.csr_matrix(sp.diags(1.0 / length) @ problem.tie[ties])
        gram = IndependentRows(rows, np.ones(problem.dimension))
        found = []
        for i in np.setdiff1d(np.arange(len(ties)), gram.kept)[:MOST_VERIFIED].tolist():
            row = rows[[i]].toarray().ravel()
            share = gram.solve(rows @ row)
            if np.linalg.norm(row - rows.T @ share) <= VERIFIED:
                found.append((int(ties[i]), ties[abs(share) > NO_PART]))
        problem._computed.dependent_ties = tuple(found)
    cached: tuple[tuple[int, Indices], ...] = problem._computed.dependent_ties
    return cached
