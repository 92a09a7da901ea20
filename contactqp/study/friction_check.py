"""Somebody else's forces for a file's problem, judged: what is wrong, at which contacts, and what is right there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.certificate.local_certificate import certify_local, contact_figures
from contactqp.errors import ContactQPError, InvalidProblem
from contactqp.exchange.candidate_forces import read_candidate_forces
from contactqp.exchange.fclib import StoredAnswer
from contactqp.exchange.ledger import Ledger
from contactqp.exchange.local_form import SingularMatrix, local_form_of
from contactqp.exchange.problem_files import read_problem_with_ledger
from contactqp.exchange.refusal import naming, wrong
from contactqp.linalg.extended import velocity_of
from contactqp.model.local_problem import LocalProblem, LocalSolution
from contactqp.model.solution import LocalCertificate
from contactqp.solving.solve import solve
from contactqp.study.check_options import CheckOptions, read_areas
from contactqp.study.friction_files import finite
from contactqp.study.verdict import Verdict, finite_list

# A stored velocity that differs from W r + q by more than this part of it belongs to other forces.
OTHER_VELOCITY = 1e-6


@dataclass(frozen=True, eq=False)
class WorstContact:
    """One contact whose forces break the law."""

    name: str
    index: int
    figure: str  # the figure that is broken most
    size: float  # as the certificate measures it
    force: NDArray[np.float64]  # (d,) as given
    velocity: NDArray[np.float64]  # (d,) W r + q of all the given forces
    right_force: NDArray[np.float64] | None  # (d,) of our solution
    right_velocity: NDArray[np.float64] | None

    def data(self) -> dict[str, Any]:
        return {
            "contact": self.name,
            "figure": self.figure,
            "size": finite(self.size),
            "force": finite_list(self.force),
            "velocity": finite_list(self.velocity),
            "right_force": finite_list(self.right_force),
            "right_velocity": finite_list(self.right_velocity),
        }


@dataclass(frozen=True, eq=False)
class ForcesVerdict(Verdict):
    """What is said of forces for a file."""

    problem: LocalProblem
    certificate: LocalCertificate
    worst: tuple[WorstContact, ...]  # worst first; all that are beyond the tolerance


def check_forces(problem_file: str, candidate_file: str, options: CheckOptions) -> ForcesVerdict:
    """Judge a file of forces against a file's problem, by the law and W as given and nothing else.

    Raises
    ------
    InvalidProblem, Unsupported, BackendMissing
        Of either file; M is singular, so that forces alone do not say how the bodies move; a map, which forces contact
        by contact have no use for.
    """
    for name, file in (("--dof-map", options.dof_map), ("--contact-map", options.contact_map)):
        if file is not None:
            raise InvalidProblem(
                f"{problem_file}: {name}: expected a problem with displacements; forces for this one come in the order "
                "of its contacts, or as CSV whose first column names them"
            )
    with naming(problem_file):
        try:
            stored, ledger = read_problem_with_ledger(problem_file)
            problem = local_form_of(stored)
        except SingularMatrix as error:
            raise InvalidProblem(f"{error}, and forces alone cannot be judged") from None
    given, candidate = read_candidate_forces(candidate_file, problem)
    force = given.force.copy()
    if options.compression == "negative":
        force[:, 0] *= -1
        candidate.converted.append("normal forces: turned round, compression is negative in the file")
    if options.pressure_areas is not None:
        names = [problem.contact_name(i) for i in range(problem.contacts)]
        force *= _areas(options.pressure_areas, names, candidate)[:, None]
        candidate.converted.append("pressures: multiplied by the areas of the contacts")
    given = replace(given, force=force)
    with naming(candidate_file):
        certificate = certify_local(problem, given.force, given.joint_force, tolerance=options.tolerance)
    right, why_not = (None, None) if certificate.passed else _right(problem, options.tolerance)
    return ForcesVerdict(
        problem_file=problem_file,
        candidate_file=candidate_file,
        problem=problem,
        certificate=certificate,
        worst=_worst(problem, given, certificate, right),
        right=right,
        why_not=why_not,
        ledgers=(ledger, candidate),
        notes=_notes(problem, given),
    )


def _areas(file: str, names: list[str], ledger: Ledger) -> NDArray[np.float64]:
    areas = read_areas(file, names, ledger)
    if areas.shape != (len(names),) or not np.all((areas > 0) & np.isfinite(areas)):
        raise wrong(file, "content", f"{len(names)} positive areas", f"{areas.size} numbers")
    return areas


def _right(problem: LocalProblem, tolerance: float) -> tuple[LocalSolution | None, str | None]:
    try:
        return solve(problem, tolerance=min(tolerance, 1e-9)), None
    except ContactQPError as error:
        return None, str(error)


def _worst(
    problem: LocalProblem, given: StoredAnswer, certificate: LocalCertificate, right: LocalSolution | None
) -> tuple[WorstContact, ...]:
    if not given.finite:
        bad = np.flatnonzero(~np.all(np.isfinite(given.force), axis=1))
        velocity = np.full_like(given.force, np.nan)
        return tuple(_contact(problem, int(i), "not finite", np.inf, given.force, velocity, right) for i in bad)
    measures = contact_figures(problem, given.force, given.joint_force)
    names, table = list(measures), np.array(list(measures.values()))
    largest = np.max(table, axis=0, initial=0.0)
    beyond = np.flatnonzero(largest > certificate.tolerance)
    order = beyond[np.argsort(-largest[beyond], kind="stable")]
    velocity = velocity_of(problem, given.force, given.joint_force)
    return tuple(
        _contact(problem, int(i), names[int(np.argmax(table[:, i]))], largest[i], given.force, velocity, right)
        for i in order
    )


def _contact(
    problem: LocalProblem,
    i: int,
    figure: str,
    size: float,
    force: NDArray[np.float64],
    velocity: NDArray[np.float64],
    right: LocalSolution | None,
) -> WorstContact:
    return WorstContact(
        name=problem.contact_name(i),
        index=i,
        figure=figure.replace("_", " "),
        size=float(size),
        force=force[i],
        velocity=velocity[i],
        right_force=None if right is None else right.force[i],
        right_velocity=None if right is None else right.velocity[i],
    )


def _notes(problem: LocalProblem, given: StoredAnswer) -> tuple[str, ...]:
    notes = []
    if not np.any(given.force) and problem.contacts:
        notes.append("all forces in the file are zero")
    if given.velocity is not None and given.finite:
        velocity = velocity_of(problem, given.force, given.joint_force)
        size = max(float(np.linalg.norm(velocity)), float(np.linalg.norm(problem.offset)))
        apart = float(np.linalg.norm(velocity - given.velocity))
        if not apart <= OTHER_VELOCITY * size:
            notes.append(f"the velocities in the file are not those of its forces: |u - (W r + q)| = {apart:.3g}")
    return tuple(notes)
