"""Settings of methods that a study tries: each method with values of its knob, condensed or on all unknowns."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from contactqp.errors import InvalidProblem, shown
from contactqp.linalg.condensation import condense
from contactqp.linalg.iteration import contacts_are_many, iterated
from contactqp.model.arrays import Indices
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import read_array
from contactqp.solving.methods import Method, find, methods
from contactqp.solving.methods.method import ACTIVE_SET

# Multiples of the contact stiffness: penalty and perturbation below it do not resist contact, and far above it they
# lose a digit of the gap to rounding for each digit of accuracy.
STIFFENINGS = (1e1, 1e2, 1e3, 1e4, 1e5, 1e6)
# Knobs that are stiffnesses.
STIFFNESSES = ("penalty", "perturbation")
TOLERANCES = (1e-3, 1e-6, 1e-9, 1e-12)
# The tolerance that `solve` asks for by default.
DEFAULT_TOLERANCE = 1e-9
UZAWA_ITERATIONS = (1, 2, 4, 8, 16)
# Tolerances of raw answers in a brief report; and unknowns beyond which it tries final answers alone, and every second
# stiffness.
BRIEF_TOLERANCES, BRIEF_LADDERS = (1e-3, 1e-6, 1e-9), 20_000
# Unknowns of problems on all of which a brief report tries final answers too: what condensation saves is told by them.
BRIEF_WHOLE = range(500, 2_000)
# What is tried on all unknowns where the contact unknowns alone would do: every setting, where condensation takes away
# so many unknowns of at most so many; beyond, the default of methods that keep matrices sparse, up to so many unknowns.
WORTH_A_LADDER, WHOLE_LADDER, WHOLE_DEFAULT = 10, 1_000, 10_000


@dataclass(frozen=True)
class Setting:
    """One method with one value of its knob."""

    method: Method
    variant: str = ""  # "raw", "polished", "uzawa"
    knob: str = ""
    value: float | None = None  # None: the method's own default
    options: Mapping[str, Any] = field(default_factory=dict)  # keyword arguments of solve

    @property
    def whole(self) -> bool:
        """Return whether the method is to work on all unknowns, without condensation."""
        return self.options.get("condense") is False

    @property
    def tolerance(self) -> float:
        """Return the relative tolerance that is asked of the method."""
        return float(self.options.get("tolerance", DEFAULT_TOLERANCE))

    @property
    def stands_for_exactness(self) -> bool:
        """Return whether the answer must be exact to the last digits, whatever the knob."""
        return self.method.exact and (self.variant == "polished" or (self.variant == "" and self.value is None))


def contact_stiffness(problem: ContactProblem) -> float:
    """Return the largest 1 / Σ_j (E_ij² / K_jj) over the contacts [force / length].

    An upper estimate of the stiffness that a contact feels, (E K⁻¹ Eᵀ)⁻¹, which also exists for bodies that float. An
    unknown without stiffness of its own counts with the largest stiffness of the problem; without contacts, that is
    the answer, and 1 if nothing has any stiffness.
    """
    diagonal = problem.diagonal
    stiffest = float(diagonal.max()) or 1.0
    compliance = problem.normal.power(2) @ (1.0 / np.where(diagonal > 0, diagonal, stiffest))
    return float(np.max(1.0 / compliance)) if problem.contacts else stiffest


def chosen_methods(names: str | Sequence[str] | None) -> tuple[Method, ...]:
    """Return the methods of these names, all by default, installed or not.

    Raises Unsupported: there is no method of that name; the nearest names are given.
    """
    names = [names] if isinstance(names, str) else names
    by_name = {method.name: method for method in methods()}
    return tuple(by_name.values()) if names is None else tuple(by_name.get(name) or find(name) for name in names)


def single_settings(
    problem: ContactProblem, method: Method, values: Sequence[float] | None = None
) -> Iterator[Setting]:
    """Yield the method as `solve` runs it, over the values of its knob if it has no default or if values are given."""
    if not method.installed:
        yield Setting(method)
    elif values is not None:
        yield from ladder(method, method.knob or "", values)
    elif method.required:
        yield from ladder(method, method.required[0], stiffness_ladder(problem))
    elif method.knob == "tolerance":
        yield from ladder(method, "tolerance", [DEFAULT_TOLERANCE])
    else:
        yield Setting(method, knob=method.knob or "")


def all_settings(
    problem: ContactProblem,
    method: Method,
    tolerances: Sequence[float] = TOLERANCES,
    stated: Sequence[tuple[str, str, Sequence[float]]] = (),
) -> Iterator[Setting]:
    """Yield every variant of a method over the values of its knob.

    Parameters
    ----------
    problem : the problem whose contact stiffness scales penalties and perturbations
    method : the method; one that is not installed yields a single setting
    tolerances : sequence of float, values for the methods whose knob is the tolerance; each is run raw and polished
    stated : sequence of (variant, knob, values)
        Values that the case states for this method; they take the place of the default ones.
    """
    if not method.installed:
        yield Setting(method)
        return
    for variant, knob, values in stated:
        yield from ladder(method, knob, values, variant)
    if method.required:
        yield from () if stated else ladder(method, method.required[0], stiffness_ladder(problem))
        return
    if method.knob == "tolerance":
        own = [values for _, knob, values in stated if knob == "tolerance"]
        yield from () if own else ladder(method, "tolerance", tolerances, "polished")
        yield from ladder(method, "tolerance", own[0] if own else tolerances, "raw")
        return
    yield Setting(method, knob=method.knob or "")
    if method.polish and method.kind != ACTIVE_SET:
        yield Setting(method, "raw", options={"polish": False})
    if "update" in method.options:
        yield from ladder(method, "iterations", UZAWA_ITERATIONS, "uzawa")


def brief_settings(problem: ContactProblem, method: Method) -> Iterator[Setting]:
    """Yield the settings of a brief report: raw answers over the knob, final ones at the default tolerance alone.

    Polished answers are exact at any tolerance; the stiffnesses of penalty methods are swept as in a full report. Of
    large problems final answers alone are tried, and three stiffnesses.
    """
    large = problem.dimension > BRIEF_LADDERS
    stiffnesses = stiffness_ladder(problem)[1::2]
    final = []
    for setting in all_settings(problem, method, BRIEF_TOLERANCES):
        if setting.knob == "tolerance" and setting.variant == "polished" and setting.value != DEFAULT_TOLERANCE:
            continue
        if large and (setting.variant in ("raw", "uzawa") or (method.required and setting.value not in stiffnesses)):
            continue
        yield setting
        if setting.variant in ("", "polished") and not method.required:
            final.append(setting)
    if problem.dimension in BRIEF_WHOLE:
        yield from on_all_unknowns(problem, final)


def ladder(method: Method, knob: str, values: Sequence[float], variant: str = "") -> Iterator[Setting]:
    """Yield one setting for each value of a knob.

    Parameters
    ----------
    method : the method that is set
    knob : "tolerance", "penalty", "perturbation" or "iterations"
    values : sequence of float, values of the knob, in the order of the settings
    variant : "raw", "polished" or "uzawa"; by default "polished" where the method polishes its answer
    """
    variant = variant or ("polished" if method.polish else "")
    for given in values:
        value = read_array(knob, given)
        if value.size != 1:
            raise InvalidProblem(f"{knob}: expected a number, got {shown(given)}")
        option = {"max_iter": int(value.item())} if knob == "iterations" else {knob: value.item()}
        yield Setting(method, variant, knob, value.item(), option | _OF_VARIANTS.get(variant, {}))


_OF_VARIANTS: Mapping[str, dict[str, Any]] = {"raw": {"polish": False}, "uzawa": {"update": "uzawa"}}


def on_all_unknowns(problem: ContactProblem, settings: Iterable[Setting]) -> Iterator[Setting]:
    """Yield the settings that are tried on the whole problem too, with ``condense=False``.

    All of them are where condensation eliminates ten unknowns or more of at most 1000. Where it eliminates fewer both
    problems are much the same, and each method's default, or 1e-9, is enough. Beyond 1000 unknowns a dense solver takes
    minutes: up to 10 000 the default of methods that keep matrices sparse is tried. Where nothing is condensed no
    setting is.
    """
    n = problem.dimension
    ladder_pays = n <= WHOLE_LADDER and n - len(_touched(problem)) >= WORTH_A_LADDER
    for setting in settings:
        usual = setting.value in (None, DEFAULT_TOLERANCE) and (n <= WHOLE_LADDER or setting.method.sparse)
        if (ladder_pays or (usual and n <= WHOLE_DEFAULT)) and condensable(problem, setting.method):
            yield replace(setting, options={**setting.options, "condense": False})


def note_on_all_unknowns(problem: ContactProblem, methods: Iterable[Method]) -> str:
    """Return in words which settings `on_all_unknowns` does not try on a problem; empty where it tries all."""
    n, inside = problem.dimension, problem.dimension - len(_touched(problem))
    if not any(condensable(problem, method) for method in methods):
        return ""
    if n > WHOLE_DEFAULT:
        return f"{n} unknowns: no method is tried on all of them, only on those of contact"
    if n > WHOLE_LADDER:
        return f"{n} unknowns: on all of them only methods that keep matrices sparse are tried, at their default"
    if inside >= WORTH_A_LADDER:
        return ""
    return f"condensation takes away {inside} of {n} unknowns: on all of them methods are tried at their default only"


def condensable(problem: ContactProblem, method: Method) -> bool:
    """Return whether the option `condense` of solve makes a difference to an installed method.

    It makes none to the active set, whose every step is one on the contact unknowns, and none with friction.
    """
    bare = not problem.contacts and not problem.ties
    if not method.installed or method.kind == ACTIVE_SET or bare or problem.frictional or iterated(problem):
        return False
    if len(_touched(problem)) < problem.dimension or contacts_are_many(problem):
        return True
    return condense(problem).rigid.count > 0


def _touched(problem: ContactProblem) -> Indices:
    """Return the unknowns that contacts and ties touch."""
    return np.union1d(problem.normal.indices, problem.tie.indices)


def stiffness_ladder(problem: ContactProblem) -> tuple[float, ...]:
    """Return `STIFFENINGS` times the contact stiffness, rounded to two digits [force / length]."""
    stiffness = contact_stiffness(problem)
    return tuple(float(f"{factor * stiffness:.1e}") for factor in STIFFENINGS)
