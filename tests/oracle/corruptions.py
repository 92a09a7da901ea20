"""A corpus of wrong answers: kinds of mistakes, each made on ten generated problems whose right answer is known.

`corpus(kind)` gives ten (problem, given) pairs; a kind that does not change an answer beyond rounding skips to the next
problem. `named` is the finding that names the cause, None where a mistake leaves no trace that a diagnosis may name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice

import numpy as np
import scipy.sparse as sp

import contactqp as cq
from contactqp.model.problem import ContactProblem
from tests.oracle.right_answers import Base, Given, frictional, frictionless, redundant

PROBLEMS = 10
# A mistake that changes every value by less than this part of the largest is none; rounding changes less than others.
CHANGES, ROUNDS = 1e-5, 1e-9


@dataclass(frozen=True)
class Kind:
    """One kind of mistake."""

    name: str
    make: Callable[[Base, np.random.Generator], Given | None]
    named: str | None
    on: Callable[[], tuple[Base, ...]] = frictionless


KINDS: dict[str, Kind] = {}


def mistake(named: str | None, on: Callable[[], tuple[Base, ...]] = frictionless) -> Callable[[Callable], Callable]:
    def register(make: Callable[[Base, np.random.Generator], Given | None]) -> Callable:
        name = make.__name__
        KINDS[name] = Kind(name, make, named, on)
        return make

    return register


def corpus(kind: Kind, count: int = PROBLEMS) -> Iterator[tuple[Base, Given]]:
    """The first `count` problems whose answer the mistake changes, with the changed answers."""
    return islice(_changed(kind), count)


def _changed(kind: Kind) -> Iterator[tuple[Base, Given]]:
    for i, base in enumerate(kind.on()):
        with suppress(cq.NoEquilibrium, cq.NotConverged, cq.NotCertified, cq.InvalidProblem):
            given = kind.make(base, np.random.default_rng([i, len(kind.name)]))
            if given is not None and _differs(base, given, ROUNDS if kind.named in ROUNDED else CHANGES):
                yield base, given


ROUNDED = ("single-precision", "printed-digits")


def _differs(base: Base, given: Given, changes: float) -> bool:
    forces = max(float(np.max(abs(right), initial=0.0)) for part, right in base.right.items() if "force" in part)
    for part, mine in given.items():
        right = base.right[part]
        size = np.max(abs(right), initial=0.0) if part == "displacement" else forces
        if not np.max(abs(mine - right), initial=0.0) <= changes * size:
            return True
    return False


def _pushing(base: Base) -> np.ndarray:
    force = base["normal_force"]
    return np.flatnonzero(force > 1e-3 * np.max(force, initial=0.0))


def _other(problem: ContactProblem, base: Base) -> Given | None:
    """The answer to another problem with as many contacts and ties."""
    found = cq.solve(problem)
    if not np.any(found.displacement):  # that is another mistake: nothing was computed
        return None
    return {part: getattr(found, part) for part in base.right}


# ------------------------------------------------------------------------------ signs, units, factors, digits


@mistake("sign")
def forces_of_the_other_sign(base, _rng):
    return base.right | {"normal_force": -base["normal_force"]}


@mistake("unit")
def displacements_in_millimetres(base, _rng):
    return base.right | {"displacement": 1e3 * base["displacement"]}


@mistake("unit")
def displacements_alone_in_inches(base, _rng):
    return {"displacement": base["displacement"] / 0.0254}


@mistake("unit")
def forces_in_kilonewtons(base, _rng):
    return {part: 1e-3 * values if "force" in part else values for part, values in base.right.items()}


@mistake("unit")
def forces_in_kilogram_force(base, _rng):
    return base.right | {"normal_force": base["normal_force"] / 9.80665}


@mistake("half")
def forces_of_a_half_model(base, _rng):
    return base.right | {"normal_force": 0.5 * base["normal_force"]}


@mistake("zero")
def forces_left_at_zero(base, _rng):
    return base.right | {"normal_force": 0.0 * base["normal_force"]}


@mistake("single-precision")
def rounded_to_single_precision(base, _rng):
    return {part: values.astype(np.float32).astype(float) for part, values in base.right.items()}


@mistake("printed-digits")
def printed_with_six_digits(base, _rng):
    return {part: np.array([float(f"{x:.5e}") for x in values]) for part, values in base.right.items()}


@mistake("inexact")
def stopped_early(base, rng):
    return {part: values * (1 + 1e-5 * rng.normal(size=values.shape)) for part, values in base.right.items()}


@mistake("not-finite")
def not_a_number(base, _rng):
    spoiled = base["displacement"].copy()
    spoiled[len(spoiled) // 2] = np.nan
    return base.right | {"displacement": spoiled}


@mistake("one-value")
def one_force_mistyped(base, _rng):
    pushing = _pushing(base)
    if len(base["displacement"]) + len(base["normal_force"]) < 6 or not pushing.size:
        return None
    force = base["normal_force"].copy()
    force[pushing[0]] *= 1.37
    return base.right | {"normal_force": force}


# ------------------------------------------------------------------------------ orders


@mistake("permuted")
def contacts_in_reverse_order(base, _rng):
    pushing = base["normal_force"][_pushing(base)]
    if len(np.unique(np.round(pushing, 9))) < 2:
        return None
    return base.right | {"normal_force": base["normal_force"][::-1].copy()}


@mistake("permuted-unknowns")
def unknowns_direction_by_direction(base, _rng):
    u = base["displacement"]
    return base.right | {"displacement": u.reshape(-1, 2).T.ravel()} if len(u) % 2 == 0 and len(u) > 2 else None


@mistake("permuted-unknowns")
def components_swapped(base, _rng):
    u = base["displacement"]
    return base.right | {"displacement": u.reshape(-1, 2)[:, ::-1].ravel()} if len(u) % 2 == 0 else None


@mistake("tangent-order", on=frictional)
def tangents_swapped(base, _rng):
    friction = base["friction_force"]
    return base.right | {"friction_force": friction[:, ::-1].copy()} if friction.shape[1] == 2 else None


# ------------------------------------------------------------------------------ other data


@mistake("gap-ignored")
def gaps_ignored(base, _rng):
    return _other(base.problem.replace(gap=0 * base.problem.gap), base) if np.any(base.problem.gap) else None


@mistake("gap-sign")
def gaps_of_the_other_sign(base, _rng):
    return _other(base.problem.replace(gap=-base.problem.gap), base) if np.any(base.problem.gap) else None


@mistake("load")
def load_of_the_other_sign(base, _rng):
    return _other(base.problem.replace(load=-base.problem.load), base)


@mistake("load")
def load_counted_twice(base, _rng):
    return _other(base.problem.replace(load=2 * base.problem.load), base)


@mistake("load-missing")
def load_of_one_unknown_missing(base, _rng):
    load = base.problem.load.copy()
    if np.count_nonzero(load) < 2:
        return None
    load[np.argmax(abs(load))] = 0.0
    return _other(base.problem.replace(load=load), base)


@mistake("stiffness")
def another_modulus(base, _rng):
    return _other(base.problem.replace(stiffness=base.problem.stiffness * 1.21), base)


@mistake("regularised")
def stiffness_regularised(base, _rng):
    K = sp.csr_matrix(base.problem.stiffness)
    return _other(base.problem.replace(stiffness=K + 1e-4 * np.max(K.diagonal()) * sp.identity(K.shape[0])), base)


@mistake("ties-ignored")
def ties_ignored(base, _rng):
    problem = base.problem
    if not problem.ties:
        return None
    found = cq.solve(problem.replace(tie=None, tie_value=None))
    return {
        "displacement": found.displacement,
        "normal_force": found.normal_force,
        "tie_force": np.zeros(problem.ties),
    }


@mistake("tie-sign")
def tie_forces_of_the_other_sign(base, _rng):
    return base.right | {"tie_force": -base["tie_force"]} if base.problem.ties else None


# ------------------------------------------------------------------------------ other contact


@mistake("free")
def no_contact_at_all(base, _rng):
    problem = base.problem
    found = cq.solve(problem.with_contacts(np.zeros(0, dtype=int)))
    if not np.any(found.displacement):
        return None
    parts = {"displacement": found.displacement, "normal_force": np.zeros(problem.contacts)}
    return parts | ({"tie_force": found.tie_force} if problem.ties else {})


@mistake("contact-missed")
def one_contact_missed(base, _rng):
    pushing = _pushing(base)
    if len(pushing) < 2:
        return None
    kept = np.setdiff1d(np.arange(base.problem.contacts), pushing[-1:])
    found = cq.solve(base.problem.with_contacts(kept))
    if (
        not np.any(found.normal_force)
        or (base.problem.gap - base.problem.normal @ found.displacement)[pushing[-1]] >= 0
    ):
        return None
    force = np.zeros(base.problem.contacts)
    force[kept] = found.normal_force
    return base.right | {part: getattr(found, part) for part in base.right} | {"normal_force": force}


@mistake("bilateral")
def contacts_glued(base, _rng):
    problem = base.problem
    rows = sp.vstack([sp.csr_matrix(problem.normal), sp.csr_matrix(problem.tie)])
    values = np.concatenate([problem.gap, problem.tie_value])
    glued = problem.with_contacts(np.zeros(0, dtype=int)).replace(tie=rows, tie_value=values)
    found = cq.solve(glued)
    if np.linalg.matrix_rank(rows.toarray()) < rows.shape[0]:
        return None
    m = problem.contacts
    parts = {"displacement": found.displacement, "normal_force": found.tie_force[:m], "tie_force": found.tie_force[m:]}
    return {part: parts[part] for part in base.right}


def _stiff(base: Base) -> float:
    return 1e3 * float(np.max(abs(base.problem.stiffness.diagonal())))


def _sprung(base: Base, found: cq.Solution) -> bool:
    """Whether springs push at the right contacts, more than one, and the method itself made no gross rounding."""
    same = np.array_equal(found.normal_force > 0, base["normal_force"] > 0)
    return bool(same and len(_pushing(base)) > 1 and found.certificate.equilibrium < 1e-7)


@mistake("penalty")
def penalty_springs(base, _rng):
    found = cq.solve(base.problem, "penalty", penalty=_stiff(base))
    return {part: getattr(found, part) for part in base.right} if _sprung(base, found) else None


@mistake("penalty")
def penalty_displacements_alone(base, _rng):
    found = cq.solve(base.problem, "penalty", penalty=_stiff(base))
    return {"displacement": found.displacement} if _sprung(base, found) else None


@mistake("pressure")
def pressures_for_forces(base, _rng):
    pushing = _pushing(base)
    if len(pushing) < 4:
        return None
    area = np.full(base.problem.contacts, 0.05)
    area[[pushing[0], pushing[-1]]] = 0.025
    return base.right | {"normal_force": base["normal_force"] / area}


@mistake("distribution")
def forces_lumped_at_a_neighbour(base, _rng):
    pushing = _pushing(base)
    if len(pushing) < 2:
        return None
    force = base["normal_force"].copy()
    force[pushing[0]] += 0.3 * force[pushing[1]]
    force[pushing[1]] *= 0.7
    return base.right | {"normal_force": force}


@mistake("duplicate-row")
def one_row_twice(base, _rng):
    pushing = _pushing(base)
    if len(pushing) < 3:
        return None
    force = base["normal_force"].copy()
    force[pushing[1]] *= 0.5
    return base.right | {"normal_force": force}


@mistake(None)
def one_contact_opened_that_pushes(base, _rng):
    """Its force is set to zero, all else kept."""
    pushing = _pushing(base)
    if not pushing.size:
        return None
    force = base["normal_force"].copy()
    force[pushing[-1]] = 0.0
    return base.right | {"normal_force": force}


@mistake(None)
def random_noise(base, rng):
    return {part: values * (1 + 0.1 * rng.normal(size=values.shape)) for part, values in base.right.items()}


# ------------------------------------------------------------------------------ other friction


@mistake("friction-sign", on=frictional)
def friction_of_the_other_sign(base, _rng):
    return base.right | {"friction_force": -base["friction_force"]}


@mistake("friction-ignored", on=frictional)
def friction_ignored(base, _rng):
    return _other(base.problem.replace(friction=0 * base.problem.friction), base)


def _slides(problem: ContactProblem, given: Given | None) -> bool:
    if given is None:
        return False
    slip = (problem.tangent @ given["displacement"]).reshape(problem.slip_origin.shape) - problem.slip_origin
    return bool(np.any((np.linalg.norm(slip, axis=1) > 1e-6) & (given["normal_force"] > 1e-6) & (problem.friction > 0)))


@mistake("friction-coefficient", on=frictional)
def another_coefficient(base, _rng):
    found = _other(base.problem.replace(friction=0.8 * base.problem.friction), base)
    return found if _slides(base.problem, found) else None


@mistake("associated", on=frictional)
def associated_cone(base, _rng):
    found = cq.solve(base.problem, algorithm="associated")
    given = {part: getattr(found, part) for part in base.right}
    return given if _slides(base.problem, given) else None


@mistake("stuck", on=frictional)
def nothing_slips(base, _rng):
    found = _other(base.problem.replace(friction=np.where(base.problem.friction > 0, 50.0, 0.0)), base)
    if found is None or _slides(base.problem, found):
        return None
    size = np.linalg.norm(found["friction_force"], axis=1)
    return found if np.any(size > 1.001 * base.problem.friction * found["normal_force"]) else None


@mistake("slip-origin", on=frictional)
def slip_origin_ignored(base, _rng):
    return _other(base.problem.replace(slip_origin=0 * base.problem.slip_origin), base)


@mistake("sign", on=frictional)
def normal_forces_of_the_other_sign_with_friction(base, _rng):
    return base.right | {"normal_force": -base["normal_force"]}


@mistake("one-value", on=frictional)
def one_friction_force_mistyped(base, _rng):
    friction = base["friction_force"].copy()
    friction[np.unravel_index(np.argmax(abs(friction)), friction.shape)] *= 1.5
    return base.right | {"friction_force": friction}


# ------------------------------------------------------------------------------ contacts that stand twice


@mistake("duplicate-row", on=redundant)
def force_counted_at_each_of_two_rows(base, _rng):
    force = base["normal_force"].copy()
    rows = base.problem.normal.toarray()
    pair = np.flatnonzero(np.all(rows == rows[-1], axis=1))
    force[pair] = np.sum(force[pair])
    return base.right | {"normal_force": force}


@mistake("sign", on=redundant)
def shared_forces_of_the_other_sign(base, _rng):
    return base.right | {"normal_force": -base["normal_force"]}


@mistake("unit", on=redundant)
def shared_forces_in_another_unit(base, _rng):
    return base.right | {"normal_force": 1e3 * base["normal_force"]}


@mistake("unit", on=redundant)
def displacements_of_shared_forces_in_millimetres(base, _rng):
    return {"displacement": 1e3 * base["displacement"]}


@mistake("gap-ignored", on=redundant)
def gaps_ignored_where_forces_are_shared(base, _rng):
    return _other(base.problem.replace(gap=0 * base.problem.gap), base)
