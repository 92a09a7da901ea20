"""Judge an answer of another code to a case, to matrices or to a file of frictional contact: `contactqp check`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from contactqp.certificate.local_certificate import certify_local, contact_figures
from contactqp.errors import ContactQPError, InvalidProblem, Unsupported, counts
from contactqp.exchange.answer_files import read_answer, read_candidate_forces
from contactqp.exchange.answer_reader import AnswerFile, names_of
from contactqp.exchange.fclib import StoredAnswer
from contactqp.exchange.files import Ledger, naming, wrong
from contactqp.exchange.local_form import SingularMatrix, local_form_of
from contactqp.exchange.problem_files import is_of_matrices, is_problem_file, read_problem_with_ledger
from contactqp.linalg.delassus import velocity_of
from contactqp.model.arrays import Array, own_floating_point
from contactqp.model.local_problem import LocalProblem, LocalSolution
from contactqp.model.names import read_units
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import LOCALLY, LocalCertificate, reasons_together
from contactqp.model.summary import finite
from contactqp.oracle.diagnosis.orders import mistake_in_local_forces
from contactqp.oracle.judged_answer import JudgedAnswer, certify
from contactqp.scene.building import build
from contactqp.scene.scene import load_scene
from contactqp.scene.tables import fits, print_wrapped
from contactqp.solving.solve import solve
from contactqp.study.friction_files import MOST_CONTACTS, called, figures, vector_text
from contactqp.study.verdict import CheckOptions, Order, Verdict, as_options, read_areas, read_order


@dataclass(frozen=True, eq=False)
class AnswerVerdict(Verdict):
    """The verdict on an answer to a problem with displacements."""

    problem: ContactProblem
    certificate: JudgedAnswer


def check_case(problem_file: str, candidate_file: str, options: CheckOptions) -> AnswerVerdict:
    """Judge an answer against a case file.

    Raises SceneError, InvalidProblem: one of the files is invalid; Unsupported: the case is a motion, a load path with
    friction or a large deformation, whose right answer depends on the history.
    """
    scene = load_scene(problem_file)
    problem = build(scene).problem
    if scene.motion is not None:
        raise Unsupported(f"{problem_file}: check: a motion has no answer of its own at its end")
    if scene.large:
        raise Unsupported(f"{problem_file}: check: a large deformation has no problem of its own at its end")
    if scene.path is not None and problem.frictional:
        raise Unsupported(f"{problem_file}: check: a load path with friction has no answer of its own at its end")
    ledger = Ledger(problem_file)
    sizes = counts(unknown=problem.dimension, contact=problem.contacts, tie=problem.ties)
    ledger.read.append(f"case file: {sizes}")
    return check_problem(problem, ledger, candidate_file, options)


def check_problem(problem: ContactProblem, ledger: Ledger, candidate_file: str, options: CheckOptions) -> AnswerVerdict:
    """Judge an answer against a problem.

    Raises InvalidProblem: the candidate, the areas or the maps are invalid; BackendMissing: the candidate's reader is
    not installed.

    Parameters
    ----------
    problem : ContactProblem
    ledger : what was read from the problem's file, which the verdict lists
    candidate_file : the file of the answer
    options : tolerances, sign of compression, areas and maps
    """
    dofs = read_order(options.dof_map, names_of(problem, "displacement"))
    contacts = read_order(options.contact_map, names_of(problem, "normal_force"))
    found = read_answer(candidate_file, _renamed(problem, dofs, contacts))
    given: dict[str, Any] = dict(found.parts)
    given |= {"dof_map": _map(dofs, found, "displacement"), "contact_map": _map(contacts, found, "normal_force")}
    if options.pressure_areas is not None:
        given["pressure_area"] = read_areas(options.pressure_areas, names_of(problem, "normal_force"), found.ledger)
        found.ledger.converted.append("pressures: multiplied by the areas of the contacts")
    _take_pressure(candidate_file, given, options)
    given |= {"tolerance": options.tolerance, "error_tolerance": options.error_tolerance}
    if options.compression == "negative" and "normal_force" not in given:
        raise wrong(candidate_file, "normal_force", "the forces whose sign --compression tells", "none")
    if options.compression == "negative" and "normal_force" in given:
        found.ledger.converted.append("normal forces: turned round, compression is negative in the file")
    with naming(candidate_file):
        certificate = certify(problem, **given, compression=options.compression)
    wrong_answer = not certificate.passed
    return AnswerVerdict(
        problem_file=ledger.source,
        candidate_file=candidate_file,
        problem=problem,
        certificate=certificate,
        worst=certificate.contacts,
        right=certificate.right if wrong_answer else None,
        why_not=certificate.why_not if wrong_answer else None,
        ledgers=(ledger, found.ledger),
    )


def _renamed(problem: ContactProblem, dofs: Order | None, contacts: Order | None) -> ContactProblem:
    """Return the problem under the names that the candidate uses."""
    changes = {}
    for key, order in (("dof_names", dofs), ("contact_names", contacts)):
        if order is not None and order.renamed is not None:
            if len(set(order.renamed)) != len(order.renamed):
                raise wrong(order.file, "candidate", "every name once", "one of them twice")
            changes[key] = order.renamed
    return problem.replace(**changes) if changes else problem


def _map(order: Order | None, found: AnswerFile, part: str) -> Sequence[int] | Sequence[str] | None:
    """Return the map for values given in order; those given by name have their names from a table."""
    if order is None:
        return None
    named = part in found.named or (part == "normal_force" and "normal_pressure" in found.named)
    if named and order.names is not None:
        raise wrong(order.file, "content", "a table problem,candidate, as the candidate has names", "an order")
    if named:  # values given by name are already in the problem's order
        return order.places if order.renamed is None else None
    if order.renamed is not None and order.places is None:
        raise wrong(order.file, "candidate", "places counted from 0, as the candidate has no names", "names")
    return order.places or order.names


def _take_pressure(file: str, given: dict[str, Any], options: CheckOptions) -> None:
    """Replace a pressure by the force, its product with the area."""
    if "normal_pressure" not in given:
        return
    if "normal_force" in given:
        raise wrong(file, "normal_pressure", "either forces or pressures", "both")
    if options.pressure_areas is None:
        raise wrong(file, "normal_pressure", "--pressure-areas, which make it a force", "none")
    given["normal_force"] = given.pop("normal_pressure")


# A stored velocity that differs more from W r + q, relatively, does not belong to the forces.
OTHER_VELOCITY = 1e-6


@dataclass(frozen=True, eq=False)
class WorstContact:
    """One contact whose forces break the contact law."""

    name: str
    index: int
    figure: str  # the figure with the largest violation
    size: float  # the value of that figure
    force: Array  # (d,) as given
    velocity: Array  # (d,) W r + q of all the given forces
    right_force: Array | None  # (d,) of our solution
    right_velocity: Array | None

    def data(self) -> dict[str, Any]:
        """Return the findings as plain data for JSON."""
        return {
            "contact": self.name,
            "figure": self.figure,
            "size": finite(self.size),
            "force": finite(self.force),
            "velocity": finite(self.velocity),
            "right_force": finite(self.right_force),
            "right_velocity": finite(self.right_velocity),
        }


@dataclass(frozen=True, eq=False)
class ForcesVerdict(Verdict):
    """The verdict on forces for a problem of a file."""

    problem: LocalProblem
    certificate: LocalCertificate
    worst: tuple[WorstContact, ...]  # all beyond the tolerance, worst first


def check_forces(problem_file: str, candidate_file: str, options: CheckOptions) -> ForcesVerdict:
    """Judge a file of forces against a file's problem, by the contact law and W as given.

    Raises InvalidProblem, Unsupported, BackendMissing: one of the files is invalid; M is singular, so that forces alone
    do not determine the motion; or there is a map, which does not apply to forces contact by contact.
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
        notes=(*_causes(problem, given, right, certificate), *_notes(problem, given)),
    )


def _areas(file: str, names: list[str], ledger: Ledger) -> Array:
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
    force: Array,
    velocity: Array,
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


def _causes(
    problem: LocalProblem, given: StoredAnswer, right: LocalSolution | None, certificate: LocalCertificate
) -> Iterator[str]:
    """Return the mistake that explains wrong forces, in words; nothing where none does."""
    if certificate.passed or not given.finite or not np.any(given.force):
        return iter(())
    return mistake_in_local_forces(problem, given.force, given.joint_force, right, certificate.tolerance)


@own_floating_point
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


def check_answer(problem: str, candidate: str, options: CheckOptions) -> ForcesVerdict | AnswerVerdict:
    """Judge an answer to a case file or to matrices, or forces for a file of FCLIB or Siconos.

    Raises SceneError, InvalidProblem, Unsupported, BackendMissing: the files or the options are invalid.
    """
    if Path(problem).is_dir() and not is_problem_file(problem):
        names = ", ".join(sorted(file.name for file in Path(problem).iterdir())[:5]) or "nothing"
        raise wrong(problem, "folder", "problem.json, or a file called stiffness or K", f"{names:.100}")
    if options.units is not None and not (is_problem_file(problem) and is_of_matrices(problem)):
        raise InvalidProblem(f"--units: {problem}: expected a deck or matrices without units")
    if not is_problem_file(problem):
        return check_case(problem, candidate, options)
    if not is_of_matrices(problem):
        return check_forces(problem, candidate, options)
    stored, ledger = read_problem_with_ledger(problem)
    assert isinstance(stored, ContactProblem)
    named = called(problem, stored, read_units(options.units))
    assert isinstance(named, ContactProblem)
    return check_problem(named, ledger, candidate, options)


def print_check(console: Console, verdict: ForcesVerdict | AnswerVerdict) -> None:
    """Print the verdict and its reasons, the worst contacts with right values beside them, and what was read."""
    word = "[green]right[/green]" if verdict.passed else "[red]WRONG[/red]"
    tolerance = f"(tolerance {verdict.certificate.tolerance:g})"
    console.print(f"{escape(verdict.candidate_file)}: {word} {tolerance}", soft_wrap=True)
    print_wrapped(console, [f"  ignored: {line}" for line in verdict.ledgers[-1].ignored])
    if isinstance(verdict, AnswerVerdict) and not verdict.passed:
        # On one line, so that its options can be copied.
        console.print(escape(f"  {as_options(verdict.certificate.diagnosis)}"), soft_wrap=True)
    for name, value in figures(verdict.certificate).items():
        console.print(f"  {name.replace('_', ' ')}: {value:.3g}")
    print_wrapped(console, [f"  {line}" for line in _bounds(verdict)])
    print_wrapped(console, [f"  wrong: {failure}" for failure in verdict.certificate.failures])
    print_wrapped(console, [f"  note: {note}" for note in (*verdict.notes, *verdict.certificate.notes)])
    if isinstance(verdict, ForcesVerdict):
        _print_forces(console, verdict)
    elif not verdict.passed:
        console.print(escape(verdict.certificate.table(MOST_CONTACTS)), soft_wrap=True)
    if verdict.why_not is not None:
        print_wrapped(console, [f"no right values to set beside: {verdict.why_not}"])
    for ledger in verdict.ledgers:
        last = ledger is verdict.ledgers[-1]  # the notes on what was read are above those on what was ignored
        lines = [f"  {kind}: {line}" for kind, line in ledger if not (last and kind == "ignored")]
        print_wrapped(console, [ledger.source, *lines])


def _bounds(verdict: Verdict) -> Iterator[str]:
    """Yield how far the candidate is from a right answer at most, and why a bound is missing."""
    certificate = verdict.certificate
    errors = {"displacement": getattr(certificate, "energy_error", None), "contact forces": certificate.force_error}
    stated = [f"{what} {error:.2g}" for what, error in errors.items() if error is not None]
    if stated:
        word = "proven" if certificate.proven else "estimated"
        yield f"error bounds, {word}: {', '.join(stated)}, relative in the energy norm"
    largest = np.inf if certificate.force_bound is None else np.max(certificate.force_bound, initial=0.0)
    if 0 < largest < np.inf:
        unit = verdict.problem.units.force if isinstance(verdict.problem, ContactProblem) else ""
        yield f"no contact force is further off than {largest:.2g} {unit}".rstrip()
    if certificate.scope == LOCALLY and certificate.radius is not None:
        yield f"that is from the only answer within {certificate.radius:.3g}, in the square root of energy"
    yield from (f"no bound: {reason}" for reason in reasons_together(certificate.reasons))


def _print_forces(console: Console, verdict: ForcesVerdict) -> None:
    header = ["contact", "wrong", "size", "force", "velocity"]
    header += ["right force", "right velocity"] if verdict.right is not None else []
    _print_table(console, header, [_forces_row(one) for one in verdict.worst])
    if verdict.right is not None:
        told = f"right values: one solution, by {verdict.right.method}; there are others where contacts are redundant"
        print_wrapped(console, [f"{told} or friction is large"])


def _forces_row(one: WorstContact) -> list[str]:
    shown = [one.force, one.velocity]
    shown += [part for part in (one.right_force, one.right_velocity) if part is not None]
    return [escape(one.name), one.figure, f"{one.size:.3g}", *map(vector_text, shown)]


def _print_table(console: Console, header: list[str], rows: list[list[str]]) -> None:
    """Print a row for each contact, or, where that is too wide, each of its vectors in a line."""
    if not rows:
        return
    table = Table(*header, box=box.SIMPLE, pad_edge=False)
    for row in rows[:MOST_CONTACTS]:
        table.add_row(*row)
    if fits(console, table):
        console.print(table)
    else:
        for name, wrong, size, *vectors in rows[:MOST_CONTACTS]:
            console.print(f"{name}: {wrong} {size}")
            for what, vector in zip(header[3:], vectors, strict=True):
                console.print(f"    {what:16}{vector}")
    if len(rows) > MOST_CONTACTS:
        console.print(f"... and {len(rows) - MOST_CONTACTS} more contacts (--json has all)")
