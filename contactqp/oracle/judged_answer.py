"""Read and judge an answer of another code: the certificate, the right values, and the causes of errors.

Numbers are read in the order, the signs and the units that are stated:

    u_j   = given displacement at dof_map[j]
    l_N,i = (+ or -) given normal force at contact_map[i], times pressure_area[i] where it is a pressure
    l_T,i = given friction force at contact_map[i], times pressure_area[i] where it is a traction

The sign of friction is unchanged: l_T is the force of the body on the obstacle, along its slip.

The certificate is computed from the problem and the answer, and nothing else changes its verdict. Wrong contacts with
their right values, and causes, need a solution, which is computed at the first use.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.certificate.certificate import certificate_of
from contactqp.errors import ContactQPError, InvalidProblem, refuse_other, shown
from contactqp.linalg.condensation import Condensation
from contactqp.model.arguments import checked
from contactqp.model.arrays import Array, Indices, Vector, own_floating_point
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import read_array, refuse_not_positive
from contactqp.model.quadratic_program import in_own_words
from contactqp.model.solution import Answer, Certificate, Solution
from contactqp.oracle.diagnosis.diagnosis import diagnose, paragraph
from contactqp.oracle.diagnosis.evidence import Finding
from contactqp.oracle.foreign.judging import (
    GivenAnswer,
    JudgedContact,
    Recovery,
    certify_given,
    contacts_table,
    judged_contacts,
    right_answer,
)

COMPRESSION = {"positive": 1.0, "negative": -1.0}
# The most names listed in a message, before the number of others.
LISTED = 5


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class JudgedAnswer(Certificate):
    """The certificate of a given answer, and the causes of its errors in words.

    `right`, `contacts`, `findings` and `diagnosis` are computed at their first use, which may solve the problem.
    Printing does not solve it, and lists violations only.
    """

    problem: ContactProblem = field(repr=False)
    given: GivenAnswer = field(repr=False)  # the given parts in the problem's order, signs and units
    answer: Answer = field(repr=False)  # the judged answer: given and recovered parts
    recovered: tuple[str, ...] = ()

    @cached_property
    @own_floating_point
    def _found(self) -> tuple[Solution | None, str | None]:
        try:
            return right_answer(self.problem, self.answer), None
        except ContactQPError as error:
            return None, f"{type(error).__name__}: {error}"

    @property
    def right(self) -> Solution | None:
        """Return the right solution, None if none exists or none was found (see `why_not`)."""
        return self._found[0]

    @property
    def why_not(self) -> str | None:
        """Return the reason why there is no right solution for comparison, None if there is one."""
        return self._found[1]

    @cached_property
    @own_floating_point
    def contacts(self) -> tuple[JudgedContact, ...]:
        """Return the wrong contacts with their right values, worst first; empty if the answer passed."""
        if self.passed:
            return ()
        return judged_contacts(self.problem, self.answer, self, self.right)

    @cached_property
    @own_floating_point
    def findings(self) -> tuple[Finding, ...]:
        """Return the findings on the answer, causes first; empty if it passed.

        Solving other questions may take 1e9 operations, about a second, or as many as the right answer; a finding names
        those not examined.
        """
        return () if self.passed else diagnose(self.problem, self.given, self.answer, self, self.right)

    @own_floating_point
    def findings_within(self, operations: float) -> tuple[Finding, ...]:
        """Return the `findings` of a search that may take this many floating-point operations; 1e9 take about a second.

        Operations are predicted, not timed, so that the findings do not depend on the machine.

        Raises
        ------
        InvalidProblem
            The operations are not a positive number.
        """
        refuse_not_positive("operations", operations)
        return () if self.passed else diagnose(self.problem, self.given, self.answer, self, self.right, operations)

    @property
    def diagnosis(self) -> str:
        """Return the findings on the answer as one paragraph."""
        return paragraph(self, self.problem, self.findings, self.contacts, None if self.passed else self.why_not)

    @checked
    @own_floating_point
    def table(self, limit: int = 20) -> str:
        """Return the wrong contacts as text."""
        return contacts_table(self.problem, self.contacts, limit)

    def __str__(self) -> str:
        text = super().__str__()
        return text if self.passed else f"{text}\n  what went wrong, in words: .diagnosis; contact by contact: .table()"


@own_floating_point
def certify(
    problem: ContactProblem,
    displacement: ArrayLike | Solution | None = None,
    normal_force: ArrayLike | None = None,
    friction_force: ArrayLike | None = None,
    tie_force: ArrayLike | None = None,
    tolerance: float = 1e-9,
    error_tolerance: float = 1e-6,
    factorization: Condensation | None = None,
    *,
    compression: str = "positive",
    pressure_area: ArrayLike | None = None,
    dof_map: Any = None,
    contact_map: Any = None,
) -> JudgedAnswer:
    """Judge an answer of any origin, with a stated order and sign of compression.

    Displacements, forces or both are given; missing parts are recovered from the others and named in `recovered` and in
    the notes. Friction may be missing only if displacements are given.

    With friction the law itself is judged, in the plane and in space: |l_T| <= mu l_N, l_T = mu l_N s/|s| where it
    slips. The answer of another law, such as that of the associated relaxation, is refused. Errors are bounded if
    friction is small enough for a unique answer, or relative to the equilibrium nearby (`scope`); the certificate also
    states, as far as possible, whether other answers exist.

    Parameters
    ----------
    problem : ContactProblem
    displacement : (n,) array [length] or Solution, optional
        The displacements; with `dof_map`, which says where each unknown stands, the array may be longer. A solution
        brings its own forces.
    normal_force : (m,) array [force], optional
        The normal forces, in the sign that `compression` states.
    friction_force : (m, d-1) or flat array [force], optional
        l_T, what the body does to the obstacle, along its own slip, whatever `compression` says.
    tie_force : (k,) array [force], optional
    tolerance : float
        The largest relative residual that passes.
    error_tolerance : float
        Largest bound on the relative error that passes.
    factorization : Condensation, optional
        A factorisation of this stiffness to be reused; the residuals that decide are formed from the problem all the
        same.
    compression : "positive" or "negative"
        The sign of the given normal forces that means compression.
    pressure_area : (m,) array [length^2, or length], optional
        The area of each contact of the problem: the given contact forces are pressures and tractions.
    dof_map, contact_map : (n,), (m,) integers or sequence of names, optional
        The place of each unknown or contact of the problem in the given order; or the names in the given order, which
        are looked up in the problem's `dof_names`, `contact_names`.

    Raises
    ------
    InvalidProblem
        Neither displacement nor normal force is given, shapes or maps are wrong, or the stiffness is indefinite. An
        answer with NaN raises nothing; it does not pass.
    Unsupported
        A body too large to factorise floats along motions that are not stated, or only forces are given for such a
        body.

    Examples
    --------
    >>> import contactqp as cq
    >>> wall = cq.ContactProblem(stiffness=[[157500.0]], load=[300.0], normal=[[1.0]], gap=[1e-3])
    >>> cq.certify(wall, displacement=[1e-3], normal_force=[142.5]).passed
    True
    >>> cq.certify(wall, normal_force=[-142.5], compression="negative").answer.displacement
    array([0.001])
    >>> wrong = cq.certify(wall, displacement=[1e-3], normal_force=[-142.5])
    >>> wrong.failures[1]
    'tension: contact 0 is held with a force of -142.5 (0.237 of the forces that meet there, tolerance 1e-09)'
    >>> wrong.right.normal_force, wrong.contacts[0].figure
    (array([142.5]), 'force')
    """
    if isinstance(problem, LocalProblem):
        raise InvalidProblem(
            "certify: expected a ContactProblem, got LocalProblem, which has no displacements; cq.certify_local judges "
            "forces of one"
        )
    if type(problem) is not ContactProblem:
        refuse_other("certify", problem, ContactProblem)
    parts = (displacement, normal_force, friction_force, tie_force)
    if isinstance(displacement, Solution):
        if any(part is not None for part in parts[1:]):
            raise InvalidProblem("certify: a Solution brings its own forces; expected it alone, or arrays")
        own = displacement
        parts = (own.displacement, own.normal_force, own.friction_force, own.tie_force)
    given = read_given(problem, *parts, compression, pressure_area, dof_map, contact_map)
    refuse_not_positive("tolerance", tolerance)
    refuse_not_positive("error_tolerance", error_tolerance)
    tolerances = tolerance, error_tolerance
    with in_own_words() if problem._computed.of_stiffness.of_program else nullcontext():
        if (answer := _complete(problem, given)) is None:
            found, completed = certify_given(problem, given, *tolerances, factorization)
        else:
            found = certificate_of(problem, answer, *tolerances, factorization, prove_friction=True)
            completed = Recovery(answer, ())
    judged = vars(found) | dict(notes=(*found.notes, *given.notes, *completed.notes))
    return JudgedAnswer(**judged, problem=problem, given=given, answer=completed.answer, recovered=completed.recovered)


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
    """Read the given parts; parameters are those of `cq.certify`.

    Raises InvalidProblem: neither displacement nor normal force, wrong shapes, areas that are not positive, a map that
    names an unknown or contact twice or not at all, an unknown word for `compression`.

    Parameters
    ----------
    problem : ContactProblem
    displacement, normal_force, friction_force, tie_force
        The parts of the answer as another code gives them, None where it gives none.
    compression : the sign of compression in its normal forces, "positive" or "negative"
    pressure_area : (m,) array, optional
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
    if force is None and not m:
        force = np.zeros(0)
    tie = np.zeros(0) if tie_force is None and not k else None
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


def _complete(problem: ContactProblem, given: GivenAnswer) -> Answer | None:
    """Return the answer if all parts were given, None if one has to be recovered."""
    u, force, friction, tie = given.displacement, given.normal_force, given.friction_force, given.tie_force
    if u is None or force is None or tie is None or (friction is None and problem.slip_origin is not None):
        return None
    return Answer(u, force, friction, tie)


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
    """Return the index (count,) of each unknown or contact of the problem in the given arrays."""
    if value is None:
        return None
    try:
        if isinstance(value, str) or sp.issparse(value):
            raise TypeError("no list")
        entries = list(islice(value, count + 1))  # iterators may be infinite
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
    """Raise InvalidProblem unless the given array is as long as its map requires."""
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
