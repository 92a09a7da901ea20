"""The certificate: figures, error bounds and the verdict on an answer from any code. It imports no solution method."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from contactqp.certificate import messages
from contactqp.certificate.balance import balance, hides_strain, rounded_outward
from contactqp.certificate.bounds import (
    FRICTION_HAS_NONE,
    Bounds,
    error_bounds,
    error_failures,
    force_bound_fails,
    no_bounds,
)
from contactqp.certificate.coulomb_law import IMPLIED, coulomb_residual, sticks_on_supports
from contactqp.certificate.critical_friction import condensed_to_prove
from contactqp.certificate.energy_bounds import bounds_by_energy, energy_bounds
from contactqp.certificate.figures import kept_residuals, violations
from contactqp.certificate.frictional_bounds import frictional_bounds
from contactqp.certificate.idle_rows import acting_rows, dependent_sparse_ties, dependent_ties, with_forces_without_law
from contactqp.certificate.multigrid_bounds import iterated_bounds
from contactqp.certificate.number_range import ABSURD, near_one
from contactqp.certificate.state_answer import remember_verdict, state_verdict
from contactqp.certificate.state_bodies import StateVerdict
from contactqp.certificate.subset_bounds import believed_candidates, bounds_among, state_among
from contactqp.certificate.uniqueness import Uniqueness, other_forces, uniqueness
from contactqp.errors import InvalidProblem, refuse_other
from contactqp.linalg.condensation import Condensation, condense
from contactqp.linalg.convexity import drives_by_rounding, overlap_by_rounding
from contactqp.linalg.dense import RigidMotions
from contactqp.linalg.extended import Residuals
from contactqp.linalg.influence import plain_residuals
from contactqp.linalg.iteration import Systems, iteration, systems_of
from contactqp.linalg.least_norm import WITHIN_ROUNDING
from contactqp.linalg.measures import own_compliance, ratio
from contactqp.linalg.pardiso import SOLVER_VARIABLE
from contactqp.model.arrays import (
    CERTIFY,
    ROUNDED_UP,
    Indices,
    Mask,
    Vector,
    all_finite,
    in_any_time,
    one_blas_thread,
    own_floating_point,
    stage,
)
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import read_answer, refuse_not_positive
from contactqp.model.solution import FIGURES, GLOBALLY, Answer, Certificate, Violations

# Forces and lengths below this part of tolerance times intrinsic size count as zero, as solvers leave that much of
# exact zeros: 1e-12 by default, and 1e-9 for an answer printed with seven digits and judged at 1e-6.
ROUNDING_OF_ANSWERS = 1e-3
# Where K is singular and the bound on the relative error exceeds this, bounds by the energy are tried as well.
WIDE_BOUND = 1e-6
NO_ROUNDING = 1e-9  # a gap above this part of the largest length cannot be the rounding of other lengths
# Largest figure that `holds` accepts, and the part of the intrinsic size that it counts as zero. Both are tighter than
# those of the certificate, because rounding may add to them.
HOLDS, NOTHING = 1e-10, 1e-13
# Changes of forces below this relative size are not mentioned in notes; a force of so many bounds is proven to press.
WORTH_SAYING, PROVEN_FORCE = 1e-9, 10.0
NONE = np.zeros(0, dtype=int)
NOT_CONDENSED = "friction: the bodies are not condensed onto their contacts"
NOT_COMPARED = "friction: no answer of its own states is near whose forces are unique"
SAYS_LESS = "friction: what could be proven is more than the distance to the answer of its own states"


@own_floating_point
def compute_certificate(
    problem: ContactProblem,
    displacement: ArrayLike,
    normal_force: ArrayLike,
    friction_force: ArrayLike | None = None,
    tie_force: ArrayLike | None = None,
    tolerance: float = 1e-9,
    error_tolerance: float = 1e-6,
    factorization: Condensation | None = None,
    prove_friction: bool = False,
) -> Certificate:
    """Judge an answer from any source; signs are those of the problem and are never guessed.

    With friction, Coulomb's law is checked contact by contact, in the plane and in space: |l_T| <= mu l_N, and
    l_T = mu l_N s/|s| where the contact slips. The answer of another law, such as the associated relaxation, is
    refused. Error bounds exist where the friction coefficients are below a constant of the bodies or of the equilibrium
    nearby (see `frictional_bounds`). The certificate also reports whether other equilibria exist, where this is known.

    Parameters
    ----------
    problem : ContactProblem
    displacement : (n,) array [length]
    normal_force : (m,) array [force], positive in compression
    friction_force : (m, d-1) or flat array [force], needed where the problem has tangential rows and friction
    tie_force : (k,) array [force], needed where the problem has ties
    tolerance : largest figure that passes
    error_tolerance : largest bound on the relative error that passes
    factorization : Condensation, optional, reused; residuals are always computed from the problem itself
    prove_friction : whether error bounds are computed with friction, too; bodies that were not condensed
        are condensed for this, up to the sizes stated in `contactqp.certificate.critical_friction`

    Raises
    ------
    InvalidProblem
        Shapes are wrong, forces are missing, or the stiffness is indefinite. An answer with NaN is refused.
    Unsupported : a body too large to factorise has rigid motions that `near_null_space` does not state

    Examples
    --------
    >>> import contactqp as cq
    >>> wall = cq.ContactProblem(stiffness=[[157500.0]], load=[300.0], normal=[[1.0]], gap=[1e-3])
    >>> cq.certify(wall, displacement=[1e-3], normal_force=[142.5]).passed
    True
    >>> cq.certify(wall, displacement=[1e-3], normal_force=[-142.5]).failures[1]
    'tension: contact 0 is held with a force of -142.5 (0.237 of the forces that meet there, tolerance 1e-09)'
    """
    refuse_not_positive("tolerance", tolerance)
    refuse_not_positive("error_tolerance", error_tolerance)
    if type(problem) is not ContactProblem:
        refuse_other("certify", problem, ContactProblem)
    answer = Answer(**read_answer(problem, displacement, normal_force, friction_force, tie_force))
    return certificate_of(problem, answer, tolerance, error_tolerance, factorization, prove_friction)


def certificate_of(
    problem: ContactProblem,
    answer: Answer,
    tolerance: float = 1e-9,
    error_tolerance: float = 1e-6,
    factorization: Condensation | None = None,
    prove_friction: bool = False,
) -> Certificate:
    """Return the certificate of an answer whose arrays already have the shapes of the problem.

    Parameters
    ----------
    problem : ContactProblem
    answer : displacement, forces of contacts, friction and ties
    tolerance, error_tolerance, factorization, prove_friction
        As in `compute_certificate`.
    """
    if not all_finite(answer):
        failures = list(messages.not_finite_parts(problem, answer))
        return messages.not_finite(problem.frictional, failures, tolerance, error_tolerance)
    with one_blas_thread(problem), stage(CERTIFY), in_any_time():
        problem._refuse_exchanged_arrays()
        if problem.has_idle_rows and (rows := acting_rows(problem)) is not None:
            theirs = rows.answer(answer)
            judged = _judge(rows.problem, theirs, tolerance, error_tolerance, factorization, prove_friction)
            whole: Certificate = rows.certificate(judged, answer)
        else:
            whole = _judge(problem, answer, tolerance, error_tolerance, factorization, prove_friction)
        everywhere = problem.friction is not None and bool((problem.friction > 0).all())
        if problem.has_idle_rows or not (answer.friction_force is None or everywhere):
            whole = with_forces_without_law(problem, answer, whole)
        return whole


@dataclass(frozen=True, eq=False)
class _Measured:
    """All that is measured on an answer, from which `_verdict` writes the certificate."""

    found: Violations  # every figure, entry by entry
    balance: float  # the work of the residual on rigid motions, relative to that of the forces
    law: Vector | None  # (m,) the residual of Coulomb's law at each contact; None without friction
    supported: Indices  # contacts that stick where a support carries their friction
    bounds: Bounds
    driven: tuple[str | None, str | None]  # how loads drive a motion by rounding, with closed and with all contacts
    errors: tuple[str, ...]  # one message for each bound on the whole answer that exceeds its tolerance
    force_bound_fails: bool  # whether the bound on the force of a contact is beyond the tolerance
    grazing: Mask  # (m,) contacts whose gap and force both vanish
    dependent: tuple[tuple[int, Indices], ...]  # ties that depend on others, each with these
    others: Uniqueness  # with friction: whether other equilibria exist
    state: StateVerdict  # the basis of the verdict; with friction: the comparison with the answer of the same states


def _judge(
    problem: ContactProblem,
    answer: Answer,
    tolerance: float,
    error_tolerance: float,
    factorization: Condensation | None,
    prove_friction: bool,
) -> Certificate:
    """Return the certificate of a finite answer, measured in units in which the problem's numbers are near one."""
    near = None if problem._is_near_one else near_one(problem)
    scaled, seen = (problem, answer) if near is None else (near.problem, near.answer(answer))
    with scaled._lock:
        if absurd := tuple(_absurd_parts(seen)):
            failures = [messages.of_absurd_part(problem, name, getattr(answer, name), i) for name, i in absurd]
            return messages.not_finite(problem.frictional, failures, tolerance, error_tolerance, messages.ABSURD_ANSWER)
        measured = _measure(scaled, seen, tolerance, error_tolerance, None if near else factorization, prove_friction)
    if near is not None:
        found = replace(near.violations(measured.found), gap=problem.gap - problem.normal @ answer.displacement)
        measured = replace(measured, found=found, bounds=near.bounds(measured.bounds))
    return _verdict(problem, answer, measured, tolerance, error_tolerance)


def _absurd_parts(answer: Answer) -> Iterator[tuple[str, int]]:
    """Yield the arrays of an answer in units near one that have an absurdly large entry, by name, with its index."""
    for name, values in vars(answer).items():
        if values is not None and values.size and not abs(values).max() <= ABSURD:
            yield name, int(np.unravel_index(np.argmax(abs(values)), values.shape)[0])


@dataclass(frozen=True, eq=False)
class _Basis:
    """The residual of an answer, its bounds without friction, and the systems from which they were computed."""

    systems: Systems
    residual: Residuals
    bounds: Bounds
    rigid: RigidMotions
    condensation: Condensation | None = None  # one that retains all contacts
    no_proof: str = NOT_CONDENSED  # with friction: why there is no condensation to prove bounds with
    state: StateVerdict | None = None  # with friction and many contacts: found among those that can close


def _measure(
    problem: ContactProblem,
    answer: Answer,
    tolerance: float,
    error_tolerance: float,
    factorization: Condensation | None,
    prove_friction: bool,
) -> _Measured:
    """Compute figures and bounds of an answer; with friction, compare it with the exact answer of the same states."""
    allowed = (error_tolerance, ROUNDING_OF_ANSWERS * tolerance)
    basis = _basis(problem, answer, factorization, prove_friction, allowed)
    bounds, rigid, condensation = basis.bounds, basis.rigid, basis.condensation
    found = violations(problem, answer, basis.residual, allowed[1], rigid)
    out_of_balance = balance(problem, answer, rigid, found.nothing.force) if rigid.count else 0.0
    if not problem.frictional:
        law, supported, others, state = None, NONE, Uniqueness(), StateVerdict(bounds.basis)
    else:
        judged = _with_friction(problem, answer, found, basis, tolerance, allowed, prove_friction)
        law, supported, others, state, bounds = judged
    dependent = _dependent_ties(problem, condensation, bounds) if problem.ties > 1 else ()
    touching = (answer.normal_force > 0) | (found.gap_measure <= WITHIN_ROUNDING)
    nothing, loose = allowed[1] * found.intrinsic_size, not problem.diagonal.all()
    strained = max(found.intrinsic_size, state.energy)
    hidden = bool(rigid.count) and hides_strain(problem, answer.displacement, rigid, strained, bounds.rounding)
    if off := force_bound_fails(bounds, error_tolerance, 0.0):
        off = force_bound_fails(bounds, error_tolerance, _no_force(problem, error_tolerance, nothing))
    if problem.frictional and (off or any(error_failures(bounds, error_tolerance, nothing))):
        bounds = replace(no_bounds(SAYS_LESS), energy_scale=state.energy)
    return _Measured(
        found=found,
        balance=out_of_balance,
        law=law,
        supported=supported,
        bounds=bounds,
        driven=drives_by_rounding(problem, rigid.motions, touching) if loose and bounds.proven else (None, None),
        errors=(
            *((messages.of_hidden_strain(problem, answer.displacement),) if hidden else ()),
            *error_failures(bounds, error_tolerance, nothing),
            *(messages.energy_failures(bounds, tolerance, nothing * nothing) if bounds.by_energy else ()),
            *(messages.of_missed_ties(problem, answer, dependent, tolerance) if dependent else ()),
        ),
        force_bound_fails=off,
        grazing=grazes(answer, found, own_compliance(problem, problem.normal), bounds, tolerance),
        dependent=dependent,
        others=others,
        state=state,
    )


def _with_friction(
    problem: ContactProblem,
    answer: Answer,
    found: Violations,
    basis: _Basis,
    tolerance: float,
    allowed: tuple[float, float],
    prove: bool,
) -> tuple[Vector | None, Indices, Uniqueness, StateVerdict, Bounds]:
    """Return the fields `law`, `supported`, `others` and `state` of `_Measured`, and the bounds with friction."""
    law = coulomb_residual(problem, answer, found)
    supported = sticks_on_supports(problem, answer)
    others = uniqueness(problem, answer, found, basis.condensation, tolerance)
    state = basis.state
    if state is None:
        condensation = None if basis.systems is Systems.SPARSE else basis.condensation
        state = state_verdict(problem, answer, found, condensation, allowed)
        remember_verdict(problem, answer, allowed, state)
    bounds = basis.bounds
    if prove and basis.condensation is not None and state.compared is not None:
        bounds = frictional_bounds(problem, basis.condensation, answer, state.compared)
    elif prove and basis.state is None:
        bounds = no_bounds(basis.no_proof if basis.condensation is None else NOT_COMPARED)
    return law, supported, others, state, bounds if bounds.proven else replace(bounds, energy_scale=state.energy)


def _no_force(problem: ContactProblem, error_tolerance: float, nothing: float) -> float:
    """Return the size below which a bound on a force counts as nothing; S may be that of a gap crossed rigidly."""
    pushed = 0.0 if problem.frictional else float((problem.own_scale * problem.load_size).max(initial=0.0))
    return min(nothing, error_tolerance * pushed) if pushed > 0 else nothing


def _dependent_ties(
    problem: ContactProblem, condensation: Condensation | None, bounds: Bounds
) -> tuple[tuple[int, Indices], ...]:
    """Return the dependent ties, each with those it depends on; without a condensation only if rows are redundant."""
    if condensation is not None:
        return dependent_ties(problem, condensation)
    return dependent_sparse_ties(problem) if bounds.redundant else ()


def _verdict(
    problem: ContactProblem, answer: Answer, measured: _Measured, tolerance: float, error_tolerance: float
) -> Certificate:
    """Return the certificate; the answer passes if no figure, law, bound or comparison of states yields a failure."""
    found, bounds, law = measured.found, measured.bounds, measured.law
    figures = {name: float(getattr(found, name).max(initial=0.0)) for name in FIGURES if name != "balance"}
    figures["balance"] = measured.balance
    failures: list[str] = []
    if not all(figure <= tolerance for figure in figures.values()):
        failures += messages.failed_figures(problem, answer, found, figures, tolerance)
    if law is not None and not np.all(law <= IMPLIED * tolerance):
        failures.append(messages.of_law(problem, law, int(np.argmax(law)), IMPLIED * tolerance))
    failures += measured.errors
    if measured.force_bound_fails and bounds.relative_force_bound is not None:
        worst = int(np.argmax(bounds.relative_force_bound))
        failures.append(messages.of_force_bound(problem, answer, bounds, worst, error_tolerance))
    failures += measured.state.failures
    pressing = (found.force_measure > tolerance) & ~measured.grazing
    notes = (*_hidden_gaps(problem, answer, found), *_notes(problem, pressing, measured.grazing, bounds))
    notes += () if problem.diagonal.all() else messages.of_faint_levers(problem, answer)
    if abs(answer.displacement) @ found.meeting > messages.MUCH_MOVED * bounds.energy_scale**2:
        notes += tuple(messages.of_rounded_stiffness(problem, answer, bounds))
    if measured.supported.size or measured.dependent:
        notes += messages.of_friction_on_supports(problem, measured.supported)
        notes += messages.of_dependent_ties(problem, measured.dependent)
    claimed = bounds if failures else bounds.claimed(error_tolerance)
    if claimed.proven and (measured.driven[bool(failures)] or (not failures and problem.contacts + problem.ties > 1)):
        doubt = measured.driven[bool(failures)] or overlap_by_rounding(problem, found.gap_measure <= tolerance)
        claimed = claimed if doubt is None else no_bounds(doubt)
    return Certificate(
        **figures,
        natural_map=None if law is None else float(law.max(initial=0.0)),
        energy_error=claimed.energy_error,
        force_error=claimed.force_error,
        force_bound=None if (bound := claimed.force_bound) is None or np.isnan(bound).any() else ROUNDED_UP * bound,
        reasons=claimed.reasons,
        grazing=tuple(measured.grazing.nonzero()[0].tolist()),
        failures=tuple(failures),
        notes=(*notes, *measured.others.notes, *measured.state.notes),
        uniqueness=measured.others.findings,
        contraction=measured.others.contraction,
        tolerance=tolerance,
        error_tolerance=error_tolerance,
        passed=not failures,
        proven=claimed.proven,
        basis=measured.state.basis if claimed is bounds else claimed.basis,
        energy_bounds=bounds.energy_bounds and rounded_outward(problem, answer, bounds.energy_bounds),
        determined=bounds.determined,
        distance=measured.state.distance,
        scope=(bounds.scope or GLOBALLY) if claimed.proven else None,
        radius=bounds.radius if claimed.proven else None,
        violations=found,
    )


def _hidden_gaps(problem: ContactProblem, answer: Answer, found: Violations) -> Iterator[str]:
    """Yield a note where a gap counts as zero although it is too large to be rounding, as beside very soft springs."""
    size = abs(problem.gap)
    hidden = (size > 0) & (size <= found.nothing.normal)
    if hidden.any():
        met = np.concatenate([size[np.isfinite(size)], abs(problem.normal @ answer.displacement)])
        hidden &= size > NO_ROUNDING * met.max()
    if hidden.any():
        i = int(np.argmax(np.where(hidden, size, 0.0)))
        yield messages.of_hidden_gap(problem, i, float(found.nothing.normal[i]))


def _notes(problem: ContactProblem, pressing: Mask, grazing: Mask, bounds: Bounds) -> tuple[str, ...]:
    """Return the notes of a certificate: they explain and do not change the verdict."""
    graze = grazing.nonzero()[0][: messages.MOST_NAMED].tolist()
    notes = list(messages.of_grazing([*map(problem.contact_name, graze)])) if graze else []
    if bounds.redundant and not problem.frictional:
        notes += messages.of_shared_forces(*other_forces(problem, pressing, grazing))
    if problem.asymmetry > 0:
        notes.append(f"the stiffness was asymmetric by {problem.asymmetry:.2g} of its diagonal and was symmetrised")
    if bounds.cleared > WORTH_SAYING:
        notes.append(messages.of_rigid_motions(bounds))
    if bounds.free_distance > WORTH_SAYING * bounds.energy_scale > 0:
        notes.append(
            f"{bounds.free_distance / bounds.energy_scale:.2g} of energy_error is what the rounding of the stiffness "
            "makes of motions that nothing resists: the answer lies elsewhere along them, which is as right"
        )
    if problem.rigid_change > 0:
        notes.append(messages.of_printing(problem))
    return (*notes, *messages.of_estimates(bounds)) if bounds.estimated or bounds.free else tuple(notes)


def _basis(
    problem: ContactProblem,
    answer: Answer,
    factorization: Condensation | None,
    prove_friction: bool,
    allowed: tuple[float, float],
) -> _Basis:
    """Choose the systems by which an answer is judged, and compute its residual and its bounds without friction."""
    at_once = factorization is not None or (problem._is_small and not os.environ.get(SOLVER_VARIABLE))
    systems = Systems.CONDENSED if at_once else systems_of(problem)
    proves = prove_friction and problem.frictional
    if systems is Systems.ITERATED:
        residual, by_products = plain_residuals(problem, answer), not problem.frictional
        bounds = iterated_bounds(problem, answer, iteration(problem)) if by_products else no_bounds(FRICTION_HAS_NONE)
        return _Basis(systems, residual, bounds, iteration(problem).rigid)
    no_proof = FRICTION_HAS_NONE
    if proves and systems in (Systems.SUBSET, Systems.SPARSE):
        factorization, no_proof = condensed_to_prove(problem)
    residual = kept_residuals(problem, answer)
    if systems is Systems.SPARSE:
        bounds = no_bounds(FRICTION_HAS_NONE) if problem.frictional else energy_bounds(problem, answer)
        rigid = RigidMotions(np.zeros((problem.dimension, 0)))
        return _Basis(systems, residual, bounds, rigid, factorization, no_proof)
    candidates = believed_candidates(problem, answer) if systems is Systems.SUBSET and factorization is None else None
    if candidates is not None and problem.frictional:
        state, rigid = state_among(problem, answer, candidates, allowed)
        return _Basis(systems, residual, no_bounds(no_proof), rigid, state=state)
    if candidates is not None:
        return _Basis(systems, residual, *bounds_among(problem, answer, residual, candidates))
    known = problem._computed.condensation if factorization is None else _matching(problem, factorization)
    condensation = known or condense(problem)
    bounds = error_bounds(problem, answer, residual, condensation, bounds_by_energy)
    far = WIDE_BOUND if condensation.rigid.count else np.finfo(float).max
    if bounds.suspicious is not None or (bounds.energy_error is not None and bounds.energy_error > far):
        bounds = bounds_by_energy(problem, answer, bounds, condensation.rigid)
    return _Basis(systems, residual, bounds, condensation.rigid, condensation)


def grazes(answer: Any, found: Violations, compliance: Vector, bounds: Bounds, tolerance: float) -> Mask:
    """Return a mask (m,) of the contacts whose gap and force both vanish.

    A contact force may be tiny beside huge forces that cancel inside a stiff body at the same unknowns. Where the
    energy of the answer is known, the force must vanish beside that as well, and a force that is more than rounding of
    the others and than `PROVEN_FORCE` times its proven error does not vanish.

    Parameters
    ----------
    answer, found : Answer, and its Violations: gaps and forces relative to the lengths and forces that meet there
    compliance : (m,) array [length / force], `own_compliance` of each contact
    bounds : its Bounds, whose `energy_scale` is 0 where the energy is not known
    tolerance : the relative size up to which a gap or a force counts as zero
    """
    vanish = found.force_measure <= tolerance
    if not vanish.any():
        return vanish
    vanish &= ratio(abs(found.gap), found.lengths) <= tolerance
    if bounds.energy_scale > 0:
        vanish &= abs(answer.normal_force) * np.sqrt(compliance) <= tolerance * bounds.energy_scale
    if bounds.force_bound is not None:
        presses = answer.normal_force > PROVEN_FORCE * bounds.force_bound
        vanish &= ~(presses & (found.force_measure > ROUNDING_OF_ANSWERS * tolerance))
    return np.asarray(vanish)


def _matching(problem: ContactProblem, factorization: Condensation) -> Condensation:
    if not isinstance(factorization, Condensation):
        raise InvalidProblem(f"factorization: expected a Condensation, got {type(factorization).__name__}")
    if not factorization.fits(problem):
        raise InvalidProblem("factorization: it was made for another stiffness or other rows than this problem's")
    return factorization


def holds(problem: ContactProblem, answer: Answer, largest: float = HOLDS) -> bool:
    """Return whether an answer satisfies equilibrium, contact and Coulomb's law by figures up to `largest`.

    Rigid motion in the displacement is ignored, and violations below `NOTHING` times the intrinsic size are accepted.
    """
    if not all_finite(answer):
        return False
    rigid = (problem._computed.condensation or condense(problem)).rigid
    found = violations(problem, answer, kept_residuals(problem, answer), NOTHING, rigid)
    if any(float(getattr(found, name).max(initial=0.0)) > largest for name in FIGURES if name != "balance"):
        return False
    return not rigid.count or balance(problem, answer, rigid, found.nothing.force) <= largest


def holds_by_products(problem: ContactProblem, rigid: RigidMotions, answer: Answer, tolerance: float) -> bool:
    """Return `holds` for a body too large to factorise, by products in doubles and without the balance of motions.

    Parameters
    ----------
    problem, answer : ContactProblem, Answer
    rigid : the null space of K
    tolerance : largest figure that passes
    """
    found = violations(problem, answer, plain_residuals(problem, answer), NOTHING, rigid)
    return all(float(getattr(found, name).max(initial=0.0)) <= tolerance for name in FIGURES if name != "balance")
