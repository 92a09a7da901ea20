"""Solve a problem in rational numbers from the contact states found in floating point, with a proof."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from flint import fmpq_mat

from contactqp.certificate.uniqueness import SEVERAL
from contactqp.errors import (
    BackendFailed,
    ContactQPError,
    NoEquilibrium,
    NotCertified,
    NotConverged,
    SeveralEquilibria,
    Unsupported,
)
from contactqp.linalg.rational import NoSolution, Undecided, dot, fraction, fractions_of, is_semidefinite, number, zeros
from contactqp.model.names import describe_motion
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import FreeMotion, Solution
from contactqp.oracle.exact.exact_path import follow
from contactqp.oracle.exact.exact_solution import ExactEvent, ExactSolution
from contactqp.oracle.exact.rational_equilibrium import Proposal, Settled, settle, settle_with_friction
from contactqp.oracle.exact.rational_problem import RationalProblem, status
from contactqp.solving.solve import solve

# The most pivots of Lemke's method, used if no proposed set is right; some hundred take seconds.
MOST_PIVOTS = 400
# The relative agreement of the floating-point and exact answer of well-posed data.
AGREE = 1e-6
# The largest relative asymmetry due to assembly.
ASSEMBLY_ASYMMETRY = 1e-14
PROVEN = (
    "equilibrium at every unknown",
    "every tie",
    "every gap >= 0 and every normal force >= 0, one of them 0 at each contact",
)
PROVEN_FRICTION = "Coulomb's law at every contact"
PROVEN_PATH = "all of these at both ends of every piece of the load path, and that each event has one continuation"
PROVEN_MINIMUM = "the stiffness is positive semidefinite: the equilibrium is the minimum"


class Indefinite(Unsupported):
    """Rounding has made the stiffness indefinite."""


@dataclass(frozen=True, eq=False)
class Asked:
    """A problem in floats, and the method that proposes its contact set."""

    problem: ContactProblem
    source: str
    method: str
    options: dict[str, Any]
    started: float


def proposal(asked: Asked) -> tuple[Solution | None, ContactQPError | None]:
    """Return the floating-point answer, or the last candidate with the reason of failure."""
    try:
        return solve(asked.problem, asked.method, **asked.options), None
    except (NotCertified, NotConverged) as error:
        found = error.solution
        return (found if isinstance(found, Solution) else None), error
    except (NoEquilibrium, SeveralEquilibria, BackendFailed) as error:
        return None, error


@contextmanager
def proof_of(solution: Solution | None) -> Iterator[None]:
    """Add the answer in floats to the error of a proof that did not end."""
    try:
        yield
    except NotConverged as error:
        if error.solution is None:
            error.solution = solution
        raise


def prove(data: RationalProblem, asked: Asked) -> ExactSolution:
    """Return the exact answer.

    Raises NoEquilibrium: proven in rational arithmetic; NotConverged: no proposed set is right, and Lemke's method did
    not end; Unsupported: the stiffness in its exact numbers is indefinite, or friction that is not covered.
    """
    solution, error = proposal(asked)
    with proof_of(solution):
        return _proven(data, asked, solution, error)


def _proven(
    data: RationalProblem, asked: Asked, solution: Solution | None, error: ContactQPError | None
) -> ExactSolution:
    if data.frictional:
        found = settle_with_friction(data, Proposal(asked.problem, solution))
        if found is None:
            raise NoEquilibrium("no combination of open, stick and slip is an equilibrium, proven in rational numbers")
        findings = () if solution is None else solution.certificate.uniqueness
        if found.equilibria is not None:
            findings = tuple(word for word in findings if "several" not in word)
            findings += (SEVERAL,) if found.equilibria > 1 or found.continuum else ()
        several = None if found.continuum else found.equilibria
        return solution_of(data, found.settled, asked, solution, several, findings)
    if not is_semidefinite(data.K):
        raise Indefinite(
            f"exact: the stiffness is not positive semidefinite as it stands ({asked.source}): rounding has made it "
            "indefinite, as it does with bodies that float; give rational numbers"
        )
    try:
        settled = settle(data, _guesses(solution), MOST_PIVOTS)
    except NoSolution:
        reason = str(error) if isinstance(error, NoEquilibrium) else "the constraints and the load conflict"
        raise NoEquilibrium(f"{reason} (proven in rational numbers)") from None
    except Undecided as why:
        raise NotConverged(f"exact: no proposed set of closed contacts holds, and Lemke's method: {why}") from error
    return solution_of(data, settled, asked, solution)


def prove_path(data: RationalProblem, corners: Sequence[fmpq_mat], asked: Asked) -> ExactSolution:
    """Return the exact answer at the end of a load path with friction.

    Raises NoEquilibrium, SeveralEquilibria, NotConverged, Unsupported as `exact_path.follow` does.
    """
    names = [asked.problem.contact_name(i) for i in range(data.contacts)]
    end = follow(data, corners, names)
    ranges = tuple((fraction(x), fraction(x)) for x in end.answer.normal_force.entries())
    way = f"the load path, event by event in rational numbers, in {end.pieces} pieces"
    settled = Settled(end.answer, True, ranges, zeros(data.unknowns, 0), way)
    answer = solution_of(data, settled, asked, None, events=end.events)
    return replace(answer, contact_status=end.status, proof=(*answer.proof, PROVEN_PATH))


def _guesses(solution: Solution | None) -> Iterator[tuple[int, ...]]:
    if solution is not None:
        yield tuple(np.flatnonzero(solution.normal_force > 0).tolist())
        yield tuple(i for i, word in enumerate(solution.contact_status) if word != "open")
    else:
        yield ()


def solution_of(
    data: RationalProblem,
    settled: Settled,
    asked: Asked,
    solution: Solution | None,
    equilibria: int | None = None,
    findings: tuple[str, ...] = (),
    events: tuple[ExactEvent, ...] = (),
) -> ExactSolution:
    """Return the proven equilibrium as an ExactSolution.

    Parameters
    ----------
    data : the problem in rational numbers
    settled : the proven answer
    asked : the problem, the method, and the starting time
    solution : Solution or None, the floating-point answer
    equilibria : the number of equilibria, if counted
    findings : tuple of str, findings on other equilibria
    events : tuple of ExactEvent, those of a load path
    """
    problem, answer = asked.problem, settled.answer
    u, shape = answer.displacement, None if problem.slip_origin is None else problem.slip_origin.shape
    minimum = () if data.frictional else (PROVEN_MINIMUM,)
    ranges = np.empty((data.contacts, 2), dtype=object)
    ranges[:] = [list(pair) for pair in settled.ranges] if data.contacts else ranges
    return ExactSolution(
        problem=problem,
        displacement=fractions_of(u),
        normal_force=fractions_of(answer.normal_force),
        friction_force=None if shape is None else fractions_of(answer.friction_force).reshape(shape),
        tie_force=fractions_of(answer.tie_force),
        gap=fractions_of(data.gap(u)),
        slip=None if shape is None else fractions_of(data.slip(u)).reshape(shape),
        contact_status=status(data, answer),
        rational=True,
        radius=None,
        unique_forces=settled.unique_forces,
        force_range=ranges,
        free_motions=_motions(problem, settled.motions),
        energy=fraction(dot(u, data.K * u) / 2 - dot(u, data.f)),
        equilibria=equilibria,
        uniqueness=findings,
        events=events,
        data=asked.source,
        way=settled.way,
        proof=PROVEN + ((PROVEN_FRICTION,) if data.frictional else minimum),
        notes=symmetrised(problem) + _notes(answer.displacement, solution),
        method=asked.method,
        seconds=time.perf_counter() - asked.started,
    )


def symmetrised(problem: ContactProblem) -> tuple[str, ...]:
    """Return a note if the given stiffness has an asymmetry beyond rounding."""
    if problem.asymmetry <= ASSEMBLY_ASYMMETRY:
        return ()
    return (f"the stiffness is asymmetric as given, by {problem.asymmetry:.3g}: (K + K')/2 is taken",)


def _notes(u: fmpq_mat, solution: Solution | None) -> tuple[str, ...]:
    if solution is None:
        return ()
    try:
        exact = np.array([number(x) for x in u.entries()])
    except OverflowError:
        return ("the exact displacement is beyond all doubles",)
    apart = float(np.max(abs(exact - solution.displacement), initial=0.0))
    if apart <= AGREE * float(np.max(abs(exact), initial=0.0)):
        return ()
    return (
        f"the numbers as they stand have another answer than floats find, which take them to be rounded: displacements "
        f"differ by up to {apart:.3g}",
    )


def _motions(problem: ContactProblem, motions: fmpq_mat) -> tuple[FreeMotion, ...]:
    directions = []
    for column in motions.transpose().tolist():
        largest = max(column, key=abs)
        directions.append(np.array([number(x / largest) for x in column]))
    return tuple(FreeMotion(direction, describe_motion(problem, direction)) for direction in directions)
