"""Numbers of another code: read in the order, the signs and the units that are stated, completed, and certified.

    u_j   = given displacement at dof_map[j]
    l_N,i = (+ or -) given normal force at contact_map[i], times pressure_area[i] where it is a pressure
    l_T,i = given friction force at contact_map[i], times pressure_area[i] where it is a traction

The sign of friction is not turned: l_T is what the body does to the obstacle, along its own slip. What was not given
is recovered from the rest (`recovery`), and of the completions the first that passes the certificate is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.certificate import certificate_of
from contactqp.certificate.idle_rows import ActingRows, acting_rows
from contactqp.certificate.number_range import NearOne, near_one
from contactqp.errors import InvalidProblem, shown
from contactqp.linalg.condensation import Condensation
from contactqp.model.arrays import Array, Indices, Vector, all_finite
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import ReadOnly, read_array
from contactqp.model.solution import ANSWER_PARTS, Answer, Certificate
from contactqp.oracle.foreign.recovery import displaced, pressed

COMPRESSION = {"positive": 1.0, "negative": -1.0}
# Names listed in a message before it says how many more there are.
LISTED = 5


@dataclass(frozen=True, eq=False)
class GivenAnswer(ReadOnly):
    """The parts of an answer that were given, in the problem's own order, signs and units; None where one was not."""

    displacement: Vector | None  # (n,)
    normal_force: Vector | None  # (m,)
    friction_force: Array | None  # (m, d-1)
    tie_force: Vector | None  # (k,)
    compression: str = "positive"  # the sign that its normal forces came with
    pressure_area: Vector | None = None  # (m,) what they were multiplied by
    notes: tuple[str, ...] = ()

    def filled(self, problem: ContactProblem) -> Answer:
        """Return the answer with zeros for what was not given."""
        width = () if problem.slip_origin is None else problem.slip_origin.shape
        none = np.zeros(width) if problem.slip_origin is not None else None
        return Answer(
            np.zeros(problem.dimension) if self.displacement is None else self.displacement,
            np.zeros(problem.contacts) if self.normal_force is None else self.normal_force,
            none if self.friction_force is None else self.friction_force,
            np.zeros(problem.ties) if self.tie_force is None else self.tie_force,
        )


def missing_parts(problem: ContactProblem, given: GivenAnswer) -> tuple[str, ...]:
    """Return the parts that the problem has and that were not given."""
    wanted = {
        "displacement": True,
        "normal_force": problem.contacts > 0,
        "friction_force": problem.slip_origin is not None,
        "tie_force": problem.ties > 0,
    }
    return tuple(name for name, has in wanted.items() if has and getattr(given, name) is None)


def read_given(
    problem: ContactProblem,
    displacement: Any,
    normal_force: Any,
    friction_force: Any,
    tie_force: Any,
    compression: str = "positive",
    pressure_area: Any = None,
    dof_map: Any = None,
    contact_map: Any = None,
) -> GivenAnswer:
    """Read what was given, `cq.certify` says how.

    Raises InvalidProblem: neither displacement nor normal force, wrong shapes, areas that are not positive, a map that
    names an unknown or contact twice or not at all, another word for `compression`.

    Parameters
    ----------
    problem : ContactProblem
    displacement, normal_force, friction_force, tie_force
        The parts of the answer as another code gives them, None where it gives none.
    compression : the sign of compression in its normal forces, "positive" or "negative"
    pressure_area : float or (m,) array, optional
        The areas that turn its pressures and tractions into forces [length^2].
    dof_map, contact_map : sequences, optional
        The place of each unknown and contact of the problem in what was given, or its name there.
    """
    if not isinstance(compression, str) or compression not in COMPRESSION:
        raise InvalidProblem(f"compression: expected 'positive' or 'negative', got {shown(compression)}")
    if displacement is None and normal_force is None:
        raise InvalidProblem("certify: expected displacement, normal_force or both, got neither")
    notes: list[str] = []
    n, m, k = problem.dimension, problem.contacts, problem.ties
    places = _places("dof_map", dof_map, n, problem.dof_names, "unknown", problem.dof_name)
    at = _places("contact_map", contact_map, m, problem.contact_names, "contact", problem.contact_name)
    if places is not None and displacement is None:
        raise InvalidProblem("dof_map was given, but no displacement")
    if at is not None and normal_force is None and friction_force is None:
        raise InvalidProblem("contact_map was given, but neither normal_force nor friction_force")
    area = _areas(pressure_area, m, normal_force is not None or friction_force is not None)
    u = None if displacement is None else _picked("displacement", displacement, n, places, notes, dof_map)
    force = None if normal_force is None else _picked("normal_force", normal_force, m, at, notes, contact_map)
    friction = _friction(problem, friction_force, at, contact_map)
    if force is not None:
        force = COMPRESSION[compression] * force + 0.0  # no negative zeros
        force = force if area is None else force * area
    if friction is not None and area is not None:
        friction = friction * area[:, None]
    tie = None
    if tie_force is not None:
        tie = read_array("tie_force", tie_force)
        if tie.shape != (k,):
            raise InvalidProblem(f"tie_force: expected shape ({k},), got {tie.shape}")
    if u is None and friction is None and problem.frictional:
        raise InvalidProblem(
            "friction_force: the problem has friction, and without displacement it cannot be recovered; expected one "
            "force a contact, got None"
        )
    return GivenAnswer(u, force, friction, tie, compression, area, tuple(notes))


def _areas(value: Any, m: int, forces: bool) -> Vector | None:
    if value is None:
        return None
    if not forces:
        raise InvalidProblem("pressure_area was given, but neither normal_force nor friction_force")
    area = read_array("pressure_area", value)
    if area.shape != (m,):
        raise InvalidProblem(f"pressure_area: expected one area a contact, shape ({m},), got {area.shape}")
    if not np.all((area > 0) & np.isfinite(area)):
        i = int(np.argmin(np.where(np.isfinite(area), area, -np.inf)))
        raise InvalidProblem(f"pressure_area: expected positive finite areas, got {area[i]:g} at [{i}]")
    return area


def _places(
    name: str,
    value: Any,
    count: int,
    names: Sequence[str] | None,
    kind: str,
    called: Callable[[int], str],
) -> Indices | None:
    """Return the place (count,) of each unknown or contact of the problem in what was given."""
    if value is None:
        return None
    try:
        if isinstance(value, str) or sp.issparse(value):
            raise TypeError("no list")
        entries = list(islice(value, count + 1))  # some have no end
    except Exception as error:  # noqa: BLE001  whatever an object says of itself
        raise InvalidProblem(f"{name}: expected {count} integers or names, got {shown(value)} ({error})") from None
    if entries and all(isinstance(one, str) for one in entries):
        return _by_name(name, entries, names, kind)
    try:
        places = np.asarray(entries if len(entries) > count else value)
    except ValueError:
        places = np.zeros(0, dtype=object)
    if places.shape != (count,) or not np.issubdtype(places.dtype, np.integer):
        raise InvalidProblem(
            f"{name}: expected {count} integers, the place of each {kind} in the given order, or the given order's "
            f"names, got {places.dtype.name} of shape {places.shape}"
        )
    if count and np.min(places) < 0:
        i = int(np.argmin(places))
        raise InvalidProblem(f"{name}: expected places from 0 on, got {places[i]} for {called(i)}")
    first, times = np.unique(places, return_counts=True)
    if np.any(times > 1):
        twice = int(first[np.argmax(times)])
        both = " and ".join(called(int(i)) for i in np.flatnonzero(places == twice)[:2])
        raise InvalidProblem(f"{name}: place {twice} is given to {both}; expected each of its own")
    return places.astype(np.intp)


def _by_name(name: str, entries: list[str], names: Sequence[str] | None, kind: str) -> Indices:
    if names is None:
        raise InvalidProblem(f"{name}: names were given, but the problem's {kind}s have none; expected integers")
    place = {entry: i for i, entry in enumerate(entries)}
    if len(place) != len(entries):
        twice = next(entry for i, entry in enumerate(entries) if place[entry] != i)
        raise InvalidProblem(f"{name}: {twice!r} stands there twice; expected distinct names")
    missing = [one for one in names if one not in place]
    if missing:
        raise InvalidProblem(f"{name}: expected every {kind} of the problem, {_listed(missing)} missing")
    return np.array([place[one] for one in names], dtype=np.intp)


def _picked(name: str, value: Any, count: int, places: Indices | None, notes: list[str], order: Any) -> Array:
    """Return the entries of a given vector in the problem's order."""
    array = read_array(name, value)
    if places is None:
        if array.shape != (count,):
            raise InvalidProblem(f"{name}: expected shape ({count},), got {array.shape}")
        return array
    _refuse_short(name, array.shape[:1] if array.ndim == 1 else (), places, order)
    if len(array) > count:
        notes.append(f"{name}: {len(array) - count} of the {len(array)} given values are of no place in the problem")
    return array[places]


def _refuse_short(name: str, shape: tuple[int, ...], places: Indices, order: Any) -> None:
    """Raise unless what was given is as long as its map says."""
    by_name = len(places) > 0 and isinstance(next(iter(order)), str)
    least = len(list(order)) if by_name else int(np.max(places, initial=-1)) + 1
    if not shape or (shape[0] != least if by_name else shape[0] < least):
        expected = f"{least} values, one for each name of its map" if by_name else f"at least {least} values"
        raise InvalidProblem(f"{name}: expected {expected}, got {shape[0] if shape else 'another shape'}")


def _friction(problem: ContactProblem, value: Any, places: Indices | None, order: Any) -> Array | None:
    if problem.slip_origin is None:
        if value is not None and read_array("friction_force", value).size:
            raise InvalidProblem("friction_force was given, but the problem has no tangential rows")
        return None
    if value is None:
        return None if problem.frictional else np.zeros(problem.slip_origin.shape)
    shape = problem.slip_origin.shape
    array = read_array("friction_force", value)
    if places is None:
        if array.shape not in (shape, (int(np.prod(shape)),)):
            raise InvalidProblem(f"friction_force: expected shape {shape}, got {array.shape}")
        return array.reshape(shape)
    if array.ndim == 1 and array.size % shape[1] == 0:
        array = array.reshape(-1, shape[1])
    if array.ndim != 2 or array.shape[1] != shape[1]:
        raise InvalidProblem(f"friction_force: expected {shape[1]} components a contact, got shape {array.shape}")
    _refuse_short("friction_force", array.shape[:1], places, order)
    return array[places]


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return ", ".join(repr(name) for name in names[:LISTED]) + more


@dataclass(frozen=True, eq=False)
class Recovery:
    """A complete answer, and what of it was recovered."""

    answer: Answer
    recovered: tuple[str, ...]
    notes: tuple[str, ...] = ()


def recoveries(problem: ContactProblem, given: GivenAnswer) -> Iterator[Recovery]:
    """Complete answers, the plain way first.

    Raises InvalidProblem: what is recovered is beyond doubles; Unsupported: forces alone were given and the body is too
    large to factorise.
    """
    missing = missing_parts(problem, given)
    if not missing:
        yield Recovery(given.filled(problem), ())
    elif (twin := acting_rows(problem) or near_one(problem)) is not None:
        yield from _recovered_there(twin, problem, given)
    elif not all_finite(given):
        yield Recovery(
            given.filled(problem), (), ("nothing was recovered: the given values are not finite, or absurdly large",)
        )
    elif "displacement" in missing:
        for answer, how in displaced(problem, given.filled(problem), missing):
            yield Recovery(answer, missing, (f"recovered from the forces: {_words(missing)} ({how})",))
    else:
        for answer, how in pressed(problem, given.filled(problem), missing):
            yield Recovery(answer, missing, (f"recovered from the displacement: {_words(missing)} ({how})",))


def _recovered_there(twin: ActingRows | NearOne, problem: ContactProblem, given: GivenAnswer) -> Iterator[Recovery]:
    """Complete answers of the rows that act, or in units in which numbers are near one, as those of the problem.

    What was given stays as it was.
    """
    names = [name for name in ANSWER_PARTS if getattr(given, name) is not None]
    there = twin.answer(given.filled(problem))
    for found in recoveries(twin.problem, replace(given, **{name: getattr(there, name) for name in names})):
        whole = twin.whole_answer(found.answer)
        yield replace(found, answer=replace(whole, **{name: getattr(given, name) for name in names}))


def _words(names: tuple[str, ...]) -> str:
    return ", ".join(names)


def certify_given(
    problem: ContactProblem,
    given: GivenAnswer,
    tolerance: float = 1e-9,
    error_tolerance: float = 1e-6,
    factorization: Condensation | None = None,
) -> tuple[Certificate, Recovery]:
    """Return the certificate of the first completion that passes, or else of the first one, and the completion.

    Raises InvalidProblem, Unsupported as `contactqp.certify` and `recoveries`.

    Parameters
    ----------
    problem : ContactProblem
    given : the parts that came, in the problem's order, signs and units
    tolerance, error_tolerance : the largest figure and the largest relative error bound that pass
    factorization : reused instead of factorising again
    """
    first: tuple[Certificate, Recovery] | None = None
    for tried in recoveries(problem, given):
        found = certificate_of(problem, tried.answer, tolerance, error_tolerance, factorization, prove_friction=True)
        if found.passed:
            return found, tried
        first = first or (found, tried)
    assert first is not None  # there is always a plain way
    return first
