"""The certificate of an answer that no rank has whole: `contactqp.certify` by reductions."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from contactqp.certificate.bounds import FRICTION_HAS_NONE, Bounds, no_bounds
from contactqp.certificate.certificate import ROUNDING_OF_ANSWERS, grazes, not_finite, status_words
from contactqp.certificate.failures import (
    MOST_NAMED,
    PARTS,
    failed_errors,
    fails_force_bound,
    said_of_balance,
    said_of_estimates,
    said_of_figure,
    said_of_force_bound,
    said_of_grazing,
    said_of_law,
    said_of_part,
)
from contactqp.certificate.figures import IMPLIED
from contactqp.certificate.uniqueness import UNKNOWN
from contactqp.distributed.answer import DistributedAnswer
from contactqp.distributed.balance import balance
from contactqp.distributed.bodies import Bodies
from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.violations import coulomb_residual, row_sizes, violations
from contactqp.distributed.worst import said_of_first, said_of_worst, worst
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Vector
from contactqp.model.problem_data import refuse_not_positive
from contactqp.model.solution import FIGURES, Certificate, Violations

NOT_ASKED = "no solver was given that could bound it"
NOT_COMPARED = "the verdict rests on the figures alone: bodies that are dealt out to ranks have no system of one state"
NOT_FACTORISED = "uniqueness was not examined: bodies that are dealt out to ranks are not condensed onto their contacts"


def certify_distributed(
    problem: DistributedProblem,
    answer: DistributedAnswer,
    tolerance: float = 1e-9,
    error_tolerance: float = 1e-6,
    bounds: Callable[[], Bounds] | None = None,
) -> Certificate:
    """Judge anyone's answer, of which each rank has its part, as `contactqp.certify` judges it. Collective.

    The certificate is the same on all ranks, but for `violations` and `force_bound`, which are those of the rank's own
    unknowns, contacts and ties; `grazing` are numbers of contacts as one process would have them.

    Parameters
    ----------
    problem : DistributedProblem
    answer : DistributedAnswer
    tolerance : float
        Largest figure that passes.
    error_tolerance : float
        Largest bound on the relative error that passes.
    bounds : function, optional
        Called by all ranks where the answer is finite and nothing rubs: how far the answer is from the truth.

    Raises
    ------
    InvalidProblem
        Wrong shapes on any rank, or no positive tolerance. NaN is no error here: it fails.
    """
    refuse_not_positive("tolerance", tolerance)
    refuse_not_positive("error_tolerance", error_tolerance)
    ranks = problem.ranks
    with ranks.together():
        _refuse_shapes(problem, answer)
    frictional = problem.frictional
    if failures := _not_finite(problem, answer):
        return not_finite(frictional, failures, tolerance, error_tolerance)
    known = _known(frictional, bounds)
    bodies = Bodies(ranks, problem.body)
    found = violations(problem, answer, bodies, ROUNDING_OF_ANSWERS * tolerance)
    named = [name for name in FIGURES if name != "balance"]
    figures = dict(zip(named, worst(ranks, *(getattr(found, name) for name in named)), strict=True))
    figures["balance"] = balance(problem, answer, bodies)
    law = coulomb_residual(problem, answer, found)
    natural_map = None if law is None else worst(ranks, law)[0]
    failures = [
        *_failed_figures(problem, answer, found, figures, tolerance),
        *_failed_law(problem, law, natural_map, IMPLIED * tolerance),
        *failed_errors(known, error_tolerance, ROUNDING_OF_ANSWERS * tolerance * found.intrinsic_size),
        *_failed_force_bound(problem, answer, known, error_tolerance),
    ]
    grazing, names = _grazing(problem, answer, found, known, tolerance)
    examined = ((UNKNOWN,), (NOT_FACTORISED, NOT_COMPARED)) if frictional else ((), ())
    return Certificate(
        **figures,
        natural_map=natural_map,
        energy_error=known.energy_error,
        force_error=known.force_error,
        force_bound=known.force_bound,
        reasons=known.reasons,
        grazing=grazing,
        failures=tuple(failures),
        notes=(*said_of_grazing(names), *said_of_estimates(known), *examined[1]),
        uniqueness=examined[0],
        contraction=None,
        tolerance=tolerance,
        error_tolerance=error_tolerance,
        passed=not failures,
        proven=known.proven,
        basis=known.basis,
        violations=found,
    )


def contact_status(problem: DistributedProblem, certificate: Certificate) -> Any:
    """(m_here,) of open, closed, grazing and, with friction, stick, slip, as `contactqp.certificate.certificate`
    measures them.
    """
    return status_words(certificate, problem.friction, np.isin(problem.contact_number, certificate.grazing))


def _known(frictional: bool, bounds: Callable[[], Bounds] | None) -> Bounds:
    if frictional:
        return no_bounds(FRICTION_HAS_NONE)
    return no_bounds(NOT_ASKED) if bounds is None else bounds()


def _refuse_shapes(problem: DistributedProblem, answer: DistributedAnswer) -> None:
    rubbed = None if problem.slip_origin is None else problem.slip_origin.shape
    expected = dict(zip(PARTS, (problem.load.shape, problem.gap.shape, rubbed, problem.tie_value.shape), strict=True))
    for name, shape in expected.items():
        values = getattr(answer, name)
        if values is None and name == "friction_force":
            if problem.friction is not None and np.any(problem.friction > 0):
                raise InvalidProblem("friction_force: the problem has friction; expected one force a contact, got None")
        elif np.shape(values) != shape:
            raise InvalidProblem(f"{name}: expected shape {shape} on this rank, got {np.shape(values)}")


def _not_finite(problem: DistributedProblem, answer: DistributedAnswer) -> list[str]:
    """What is not finite, in words, the first unknown, contact or tie of each part of the answer."""
    numbers = problem.dof_number, problem.contact_number, problem.contact_number, problem.tie_number
    said = []
    for name, number in zip(PARTS, numbers, strict=True):
        values = getattr(answer, name)
        values = np.zeros(len(number)) if values is None else values
        flags = ~np.all(np.isfinite(values), axis=tuple(range(1, values.ndim)))
        say = partial(said_of_part, problem, name, values)
        said.append(said_of_first(problem.ranks, flags, number, say))
    return [text for text in said if text is not None]


def _failed_figures(
    problem: DistributedProblem,
    answer: DistributedAnswer,
    found: Violations,
    figures: dict[str, float],
    tolerance: float,
) -> list[str]:
    numbers = {"equilibrium": problem.dof_number, "tie": problem.tie_number}
    said = []
    for name in FIGURES:
        if figures[name] <= tolerance:
            continue
        if name == "balance":
            said.append(said_of_balance(figures[name], tolerance))
            continue
        number = numbers.get(name, problem.contact_number)
        say = partial(said_of_figure, problem, answer, found, name, tolerance=tolerance)
        said.append(said_of_worst(problem.ranks, getattr(found, name), number, say))
    return said


def _failed_law(problem: DistributedProblem, law: Vector | None, largest: float | None, limit: float) -> list[str]:
    if law is None or largest is None or largest <= limit:
        return []
    say = partial(said_of_law, problem, law, limit=limit)
    return [said_of_worst(problem.ranks, law, problem.contact_number, say)]


def _failed_force_bound(
    problem: DistributedProblem, answer: DistributedAnswer, known: Bounds, tolerance: float
) -> list[str]:
    relative = known.relative_force_bound
    if not problem.ranks.any(fails_force_bound(known, tolerance)) or relative is None:
        return []
    say = partial(said_of_force_bound, problem, answer, known, tolerance=tolerance)
    return [said_of_worst(problem.ranks, relative, problem.contact_number, say)]


def _grazing(
    problem: DistributedProblem, answer: DistributedAnswer, found: Violations, known: Bounds, tolerance: float
) -> tuple[tuple[int, ...], list[str]]:
    """The numbers of the contacts of all ranks that graze, and the names of the first of them."""
    compliance = row_sizes(problem, problem.normal).compliance
    here = np.flatnonzero(grazes(answer, found, compliance, known, tolerance))
    here = here[np.argsort(problem.contact_number[here])]
    numbers = np.sort(problem.ranks.gathered(problem.contact_number[here]))
    names = [(int(problem.contact_number[i]), problem.contact_name(int(i))) for i in here[:MOST_NAMED]]
    every = sorted(name for part in problem.ranks.comm.allgather(names) for name in part)
    return tuple(int(number) for number in numbers), [name for _, name in every[:MOST_NAMED]]
