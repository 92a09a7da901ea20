"""Coulomb's law for a contact problem by an algorithm of the local form, its combination refined on the problem."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from contactqp.condensation import Condensation
from contactqp.errors import NotConverged
from contactqp.factorization import Array
from contactqp.friction.contact_form import ContactForm
from contactqp.friction.existence_test import refuse_unbalanced
from contactqp.friction.iterate import Iterate
from contactqp.friction.local_algorithms import ALGORITHMS, run_algorithm, run_any
from contactqp.friction.local_form import LocalForm
from contactqp.friction_states import holds
from contactqp.frictional_rows import FrictionalRows
from contactqp.methods import Method, Settings
from contactqp.problem import ContactProblem
from contactqp.violations import Answer

# Iterates whose natural map is off by less than this part of the forces may have the right combination.
WORTH_REFINING = 1e-5


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
    """Coulomb's answer by `algorithm`, a name of `local_algorithms.ALGORITHMS`; None tries one after another.

    Raises
    ------
    NoEquilibrium
        No forces in their cones balance the load.
    NotConverged
        No iterate's combination of open, stick and slip is an equilibrium.
    BackendFailed, BackendMissing, Unsupported, InvalidProblem
        Of the convex method.
    """
    contacts = ContactForm(problem, condensation, FrictionalRows(problem, condensation))
    form = LocalForm(contacts.local)
    found: list[Answer] = []

    def accepted(iterate: Iterate) -> bool:
        if not iterate.error <= WORTH_REFINING * max(1.0, float(np.max(abs(iterate.force), initial=0.0))):
            return False
        answer = contacts.answer(form, iterate)
        if holds(problem, answer):
            found.append(answer)
        return bool(found)

    start = _start(form, contacts, settings, refuse_unbalanced(form))
    if algorithm is None:
        outcome = run_any(form, settings, start, accepted)
    else:
        outcome = run_algorithm(form, ALGORITHMS[algorithm], method, settings, start, accepted)
    iterate = outcome.iterate
    if not found:
        raise NotConverged(
            f"{outcome.name}: the law is still violated by {iterate.error:.2g} of the typical gap or slip after "
            f"{iterate.iterations} iterations",
            iterate.history,
        )
    return LocalAnswer(found[-1], outcome.name, iterate.iterations, iterate.history)


def _start(form: LocalForm, contacts: ContactForm, settings: Settings, balanced: Array | None) -> Iterate:
    """The forces of a warm start, or those that hold the bodies, or none."""
    warm = settings.warm_start
    if warm is not None and warm.finite:
        balanced = form.scaled(contacts.scaled_force(warm.normal_force, warm.friction_force))
    if balanced is None:
        return Iterate.nothing(form)
    return Iterate.at(form, balanced, form.joint_force(balanced))
