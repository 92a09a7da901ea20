"""Coulomb's law for a contact problem by an algorithm of the local form, its combination refined on the problem."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from contactqp.certificate.figures import holds
from contactqp.errors import NotConverged
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.existence import refuse_conflict
from contactqp.linalg.friction_states import condensed_frictional_rows
from contactqp.model.arrays import Array
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer
from contactqp.solving.friction.algorithms import ALGORITHMS, ATTEMPTS, LONG_ATTEMPTS, run_algorithm, run_any
from contactqp.solving.friction.conic import balancing_forces
from contactqp.solving.friction.contact_form import ContactForm
from contactqp.solving.friction.enumeration import MOST_CONTACTS
from contactqp.solving.friction.local_form import NEARER, Deadline, Iterate, LocalForm
from contactqp.solving.methods import Method, Settings

# Iterates whose natural map is off by less than this part of the forces may have the right combination.
WORTH_REFINING = 1e-5
# Forces that balance the load with less than this part of what would deform the bodies by the typical gap are small:
# the bodies move as if they were rigid.
SMALL_FORCES = 0.1
# Contacts of which all combinations of states take less than the long attempts of algorithms: 3^5 in space.
MOST_TRIED = 5
# Of few contacts, so many combinations near that of the best iterate are tried: about a second, the same anywhere.
MOST_NEARBY = 300


@dataclass(frozen=True, eq=False)
class LocalAnswer:
    """Coulomb's answer, and which algorithm of the local form found it."""

    answer: Answer
    name: str
    iterations: int
    history: tuple[float, ...]


def solve_on_contacts(
    problem: ContactProblem, condensation: Condensation, method: Method, settings: Settings, algorithm: str | None
) -> LocalAnswer:
    """Find Coulomb's answer by `algorithm`, a name of `algorithms.ALGORITHMS`; None tries one after another.

    Raises
    ------
    NoEquilibrium
        The constraints conflict, which is asked where an answer does not come at once.
    NotConverged
        No iterate's combination of open, stick and slip is an equilibrium.
    BackendFailed, BackendMissing, Unsupported, InvalidProblem
        Of the convex method.
    """
    contacts = ContactForm(problem, condensation, condensed_frictional_rows(problem, condensation))
    balanced = balancing_forces(LocalForm(contacts.local))
    deadline = Deadline(settings.time_limit)
    failed: NotConverged | None = None
    for size in _force_sizes(balanced):
        form = LocalForm(contacts.local, size)
        start = None if balanced is None else balanced / size
        left = replace(settings, time_limit=deadline.left)
        try:
            return _on_form(problem, condensation, contacts, form, start, method, left, algorithm)
        except NotConverged as error:
            failed = failed or error
    assert failed is not None
    raise failed


def _force_sizes(balanced: Array | None) -> tuple[float, ...]:
    """Sizes to give to forces of the local form: their own first, where bodies move as if they were rigid."""
    size = 0.0 if balanced is None else float(np.max(abs(balanced), initial=0.0))
    return (size, 1.0) if 0 < size < SMALL_FORCES else (1.0,)


def _on_form(
    problem: ContactProblem,
    condensation: Condensation,
    contacts: ContactForm,
    form: LocalForm,
    balanced: Array | None,
    method: Method,
    settings: Settings,
    algorithm: str | None,
) -> LocalAnswer:
    found: list[Answer] = []
    tried: dict[bytes, float] = {}  # combinations, and the error of the iterate that each was last refined from

    def accepted(iterate: Iterate) -> bool:
        if not iterate.error <= WORTH_REFINING * max(1.0, float(np.max(abs(iterate.force), initial=0.0))):
            return False
        status = contacts.status(form, iterate)
        if iterate.error >= NEARER * tried.get(status.tobytes(), np.inf):
            return False
        tried[status.tobytes()] = iterate.error
        answer = contacts.answer_in(status, contacts.plain(form, iterate))
        if holds(problem, answer):
            found.append(answer)
        return bool(found)

    start, deadline = _start(form, contacts, settings, balanced), Deadline(settings.time_limit)
    if algorithm is None:
        attempts = len(ATTEMPTS) - (LONG_ATTEMPTS if form.m <= MOST_TRIED else 0)
        outcome = run_any(form, settings, start, accepted, lambda: refuse_conflict(problem, condensation), attempts)
    else:
        outcome = run_algorithm(form, ALGORITHMS[algorithm], method, settings, start, accepted)
    iterate, name, nearby = outcome.iterate, outcome.name, ""
    if not found and algorithm is None and form.m <= MOST_CONTACTS:
        found, nearby = _near(problem, contacts, form, iterate, deadline)
        name = f"combinations near {name}"
    if not found:
        raise NotConverged(
            f"{outcome.name}: the law is still violated by {iterate.error:.2g} of the typical gap or slip after "
            f"{iterate.iterations} iterations{nearby}",
            iterate.history,
        )
    return LocalAnswer(found[-1], name, iterate.iterations, iterate.history)


def _near(
    problem: ContactProblem, contacts: ContactForm, form: LocalForm, iterate: Iterate, deadline: Deadline
) -> tuple[list[Answer], str]:
    """The answer of the combination that holds and differs from an iterate's in the fewest contacts, if one is found,
    and how many were tried: `MOST_NEARBY`, or as many as a limit of time allows.

    Each is refined from the iterate, whose displacement gives the first directions of slip. Bodies that move far under
    forces that hardly deform them need this: no force of an iterate tells which of the contacts that move little stick.
    """
    plain, status = contacts.plain(form, iterate), contacts.status(form, iterate)
    sliding = (SLIP_ON,) if form.d == 3 else (SLIP_ON, SLIP_BACK)
    every = np.array(list(itertools.product((OPEN, STICK, *sliding), repeat=form.m)), dtype=np.int8)
    nearest = np.argsort(np.count_nonzero(every != status, axis=1), kind="stable")
    for tried, combination in enumerate(every[nearest]):
        if deadline.passed or (deadline.left is None and tried == MOST_NEARBY):
            some = f"the {tried} nearest of {len(every)} combinations"
            return [], f"; {some} fail as well; a longer time_limit tries more"
        answer = contacts.answer_in(combination, plain)
        if holds(problem, answer):
            return [answer], ""
    return [], f"; all {len(every)} combinations, refined from there, fail as well"


def _start(form: LocalForm, contacts: ContactForm, settings: Settings, balanced: Array | None) -> Iterate:
    """The forces of a warm start, or those that hold the bodies, or none."""
    warm = settings.warm_start
    if warm is not None and warm.finite:
        balanced = form.scaled(contacts.scaled_force(warm.normal_force, warm.friction_force))
    if balanced is None:
        return Iterate.nothing(form)
    return Iterate.at(form, balanced, form.joint_force(balanced))
