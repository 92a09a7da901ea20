"""An answer of another code, judged: the certificate, and beside it what the certificate alone cannot say.

The certificate is computed from the problem and the answer; nothing here changes its verdict. What is wrong at which
contact, what is right there and why it may have gone wrong takes a solution, which is computed when first asked for.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from numpy.typing import ArrayLike

from contactqp.errors import ContactQPError, InvalidProblem, refuse_other
from contactqp.linalg.condensation import Condensation
from contactqp.model.arguments import checked
from contactqp.model.arrays import own_floating_point
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import refuse_not_positive
from contactqp.model.solution import Answer, Certificate, Solution
from contactqp.oracle.diagnosis.diagnosis import diagnose, paragraph
from contactqp.oracle.diagnosis.evidence import Finding
from contactqp.oracle.foreign.foreign_answer import GivenAnswer, certify_given, read_given
from contactqp.oracle.foreign.judging import JudgedContact, contacts_table, judged_contacts, right_answer


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class JudgedAnswer(Certificate):
    """The certificate of a given answer, and what went wrong with it in words.

    `right`, `contacts`, `findings` and `diagnosis` are computed when first looked at; they may solve the problem.
    Printing does not: it says what is violated, and where the rest is.
    """

    problem: ContactProblem = field(repr=False)
    given: GivenAnswer = field(repr=False)  # what came, in the problem's order, signs and units
    answer: Answer = field(repr=False)  # what was judged: what came and what was recovered from it
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
        """Return the right solution; None where there is none or none was found, and `why_not` says why."""
        return self._found[0]

    @property
    def why_not(self) -> str | None:
        """Return why there is no right solution to set beside the answer; None where there is one."""
        return self._found[1]

    @cached_property
    @own_floating_point
    def contacts(self) -> tuple[JudgedContact, ...]:
        """Return the wrong contacts, worst first, beside the right values; empty where the answer passed."""
        if self.passed:
            return ()
        return judged_contacts(self.problem, self.answer, self, self.right)

    @cached_property
    @own_floating_point
    def findings(self) -> tuple[Finding, ...]:
        """Return what is wrong with the answer, causes first; empty where it passed.

        Other questions that it may be the right answer to may take 1e9 operations, about a second, or as many as the
        right answer; a finding says which were left unasked.
        """
        return () if self.passed else diagnose(self.problem, self.given, self.answer, self, self.right)

    @own_floating_point
    def findings_within(self, operations: float) -> tuple[Finding, ...]:
        """Return what `findings` are with so many operations for other questions, 1e9 of them about a second.

        Operations are predicted, not timed: the findings do not depend on the machine.

        Raises
        ------
        InvalidProblem
            The operations are no positive number.
        """
        refuse_not_positive("operations", operations)
        return () if self.passed else diagnose(self.problem, self.given, self.answer, self, self.right, operations)

    @property
    def diagnosis(self) -> str:
        """Return in one paragraph what is wrong with the answer."""
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
    """Judge anyone's answer to a problem, in any order and with any sign of compression, which are stated.

    Displacements alone, forces alone or both: what is missing is recovered from the rest and named in `recovered` and
    in the notes. Friction alone may be missing only where displacements are given.

    With friction the law itself is judged, in the plane and in space: |l_T| <= mu l_N, l_T = mu l_N s/|s| where it
    slips. Another law's answer, such as that of the associated relaxation, is refused. Errors are bounded where
    friction is small enough for one answer, or of the equilibrium nearby (`scope`); the certificate also says whether
    other answers exist, as far as that can be told.

    Parameters
    ----------
    problem : ContactProblem
    displacement : (n,) array [length] or Solution, optional
        Longer, if `dof_map` says where each unknown stands. A solution brings its own forces.
    normal_force : (m,) array [force], optional
        With the sign that `compression` says.
    friction_force : (m, d-1) or flat array [force], optional
        l_T, what the body does to the obstacle, along its own slip, whatever `compression` says.
    tie_force : (k,) array [force], optional
    tolerance : float
        Largest figure that passes.
    error_tolerance : float
        Largest bound on the relative error that passes.
    factorization : Condensation, optional
        Reused instead of factorising again; the residuals that decide are formed from the problem all the same.
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
        Neither displacement nor normal force, wrong shapes or maps, or an indefinite stiffness. NaN is no error here:
        it fails.
    Unsupported
        A body that is too large to factorise floats along motions that nobody has stated, or forces alone are given and
        it is.

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
    found, completed = certify_given(problem, given, tolerance, error_tolerance, factorization)
    judged = vars(found) | dict(notes=(*found.notes, *given.notes, *completed.notes))
    return JudgedAnswer(**judged, problem=problem, given=given, answer=completed.answer, recovered=completed.recovered)
