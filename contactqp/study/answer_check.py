"""Somebody else's answer to a problem of energy and contacts, judged: from a case file, or from matrices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from contactqp.errors import Unsupported
from contactqp.exchange.answer_files import read_answer
from contactqp.exchange.answer_reader import AnswerFile, names_of
from contactqp.exchange.ledger import Ledger
from contactqp.exchange.refusal import naming, wrong
from contactqp.model.problem import ContactProblem
from contactqp.oracle.judged_answer import JudgedAnswer, certify
from contactqp.scene.building import build
from contactqp.scene.scene import load_scene
from contactqp.study.check_options import CheckOptions, Order, read_areas, read_order
from contactqp.study.verdict import Verdict


@dataclass(frozen=True, eq=False)
class AnswerVerdict(Verdict):
    """What is said of an answer."""

    problem: ContactProblem
    certificate: JudgedAnswer


def check_case(problem_file: str, candidate_file: str, options: CheckOptions) -> AnswerVerdict:
    """Judge an answer against a case file.

    Raises
    ------
    SceneError, InvalidProblem
        Of either file.
    Unsupported
        A motion, a load path with friction, a large deformation: what is right at its end depends on the way there.
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
    ledger.read.append(f"case file: {problem.dimension} unknowns, {problem.contacts} contacts, {problem.ties} ties")
    return check_problem(problem, ledger, candidate_file, options, [tie.name for tie in scene.ties])


def check_problem(
    problem: ContactProblem,
    ledger: Ledger,
    candidate_file: str,
    options: CheckOptions,
    tie_names: Sequence[str] | None = None,
) -> AnswerVerdict:
    """Judge an answer against a problem.

    Raises
    ------
    InvalidProblem
        Of the candidate, the areas or the maps.
    BackendMissing
        The candidate's reader is not installed.
    """
    dofs = read_order(options.dof_map, names_of(problem, "displacement"))
    contacts = read_order(options.contact_map, names_of(problem, "normal_force"))
    found = read_answer(candidate_file, _renamed(problem, dofs, contacts), tie_names)
    given: dict[str, Any] = dict(found.parts)
    given |= {"dof_map": _map(dofs, found, "displacement"), "contact_map": _map(contacts, found, "normal_force")}
    if options.pressure_areas is not None:
        given["pressure_area"] = read_areas(options.pressure_areas, names_of(problem, "normal_force"), found.ledger)
        found.ledger.converted.append("pressures: multiplied by the areas of the contacts")
    _take_pressure(candidate_file, given, options)
    given |= {"tolerance": options.tolerance, "error_tolerance": options.error_tolerance}
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
    """The problem under the names that the candidate uses."""
    changes = {}
    for key, order in (("dof_names", dofs), ("contact_names", contacts)):
        if order is not None and order.renamed is not None:
            if len(set(order.renamed)) != len(order.renamed):
                raise wrong(order.file, "candidate", "every name once", "one of them twice")
            changes[key] = order.renamed
    return problem.replace(**changes) if changes else problem


def _map(order: Order | None, found: AnswerFile, part: str) -> Sequence[int] | Sequence[str] | None:
    """The map for values that came in order; values that came by name are in the problem's order already."""
    if order is None:
        return None
    named = part in found.named or (part == "normal_force" and "normal_pressure" in found.named)
    if named and order.renamed is None:
        raise wrong(order.file, "content", "a table problem,candidate, as the candidate has names", "an order")
    if not named and order.renamed is not None:
        raise wrong(order.file, "candidate", "places counted from 0, as the candidate has no names", "names")
    return order.places or order.names


def _take_pressure(file: str, given: dict[str, Any], options: CheckOptions) -> None:
    """A pressure becomes a force by its area, and by nothing else."""
    if "normal_pressure" not in given:
        return
    if "normal_force" in given:
        raise wrong(file, "normal_pressure", "either forces or pressures", "both")
    if options.pressure_areas is None:
        raise wrong(file, "normal_pressure", "--pressure-areas, which make it a force", "none")
    given["normal_force"] = given.pop("normal_pressure")
