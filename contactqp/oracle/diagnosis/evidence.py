"""Collect the evidence of a diagnosis: the given and the right answer, their distance, and the violations.

Distances are largest differences relative to the largest value, with unknowns scaled by energy, sqrt(K_jj) u_j, and
forces by their rows, |E_i D| l_i, D = 1/sqrt(K_jj). Only given parts are compared. If forces are not unique because
rows are dependent, the nodal forces E_N'l_N + E_T'l_T + A'nu are compared instead.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from contactqp.certificate.messages import unit_of
from contactqp.certificate.uniqueness import POSSIBLE, SEVERAL
from contactqp.errors import ContactQPError, InvalidProblem
from contactqp.linalg.dense import unknown_scale
from contactqp.model.arrays import TINY, Array, Vector
from contactqp.model.coulomb import slips
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import ANSWER_PARTS, Answer, Certificate, Solution, Violations
from contactqp.oracle.foreign.judging import GivenAnswer, certify_given

# The kinds of findings: causes, which explain a whole answer.
CAUSES = {
    "sign": "forces of the opposite sign",
    "displacement-sign": "displacements of the opposite sign",
    "friction-sign": "friction forces of the opposite sign",
    "tie-sign": "tie forces of the opposite sign",
    "unit": "another unit of length or force",
    "half": "a factor of two",
    "radian": "forces of the full circle instead of those of one radian, or the other way round",
    "scaled": "a factor without a name",
    "zero": "a part was left at zero",
    "permuted": "contacts in another order",
    "permuted-unknowns": "unknowns in another order",
    "tangent-order": "tangential directions in another order",
    "tangent-sign": "one tangential direction of the opposite sign",
    "tangent-turned": "tangential directions turned by an angle",
    "components": "normal and tangential forces in another order",
    "single-precision": "numbers of single precision",
    "printed-digits": "numbers as printed",
    "inexact": "right to a few digits",
    "one-value": "one value is wrong and all others are right",
    "pressure": "pressures instead of forces, or forces taken for pressures",
    "duplicate-row": "a contact row that stands twice",
    "distribution": "the right total, at the wrong contacts",
    "penalty": "contact by springs",
    "bilateral-springs": "contact by springs that also pull",
    "barrier": "an interior point far from the boundary",
    "load": "another factor of the load",
    "load-missing": "the load of some unknowns is missing",
    "stiffness": "another modulus",
    "regularised": "something was added to the diagonal of the stiffness",
    "gap-ignored": "no initial gaps",
    "gap-sign": "initial gaps of the opposite sign",
    "gap-unit": "initial gaps in another unit",
    "gap-offset": "every gap is off by the same",
    "shifted": "every displacement is off by the same",
    "overlap-ignored": "initial overlaps taken as closed gaps",
    "ties-ignored": "no ties",
    "tie-value-ignored": "tie values of zero",
    "free": "no contact at all",
    "contact-missed": "contact was missed somewhere",
    "bilateral": "contacts held both ways",
    "friction-ignored": "no friction",
    "friction-coefficient": "another coefficient of friction",
    "friction-reversed": "friction that pushes along",
    "slip-origin": "slip counted from zero",
    "stuck": "no slip was allowed",
    "associated": "the associated relaxation, in which sliding dilates",
    "pyramid": "friction bounded direction by direction",
}
# Kinds of findings that are not causes: violations and notes.
SYMPTOMS = {
    "not-finite": "NaN or infinity",
    "tension": "a contact pulls",
    "penetration": "a contact is penetrated",
    "complementarity": "a contact pushes without touching",
    "cone": "friction beyond its bound",
    "slip": "slip without full friction against it",
    "tie": "a tie is missed",
    "equilibrium": "an unknown is out of balance",
    "balance": "the forces on a body do not balance",
    "inaccurate": "a bound on the error is too large",
    "several": "other answers exist, or may",
    "not-examined": "hypotheses that were left out because the problem is large, or too many",
}


@dataclass(frozen=True)
class Finding:
    """A finding with its kind (a key of `CAUSES` or `SYMPTOMS`) and a sentence.

    A cause explains the whole answer: with it undone the answer is right, or more accurate by at least two digits. Any
    other finding states a violation, without a guess.
    """

    kind: str
    text: str
    cause: bool = False
    together: bool = False  # in addition to the cause before it, not as an alternative

    def __str__(self) -> str:
        return self.text


# The most contacts named one by one.
NAMED = 3


def symptoms(problem: ContactProblem, answer: Answer, certificate: Certificate) -> Iterator[Finding]:
    """Yield a finding for each figure and bound that fails."""
    found = certificate.violations
    if found is None:
        for failure in certificate.failures:
            yield Finding("not-finite", f"the answer is not finite: {failure}")
        return
    limit = certificate.tolerance
    force, length = unit_of(problem.units.force), unit_of(problem.units.length)
    yield from _of_contacts(problem, answer, found, limit)
    if certificate.tie > limit:
        worst = int(np.argmax(found.tie))
        missed = abs(problem.tie[[worst]] @ answer.displacement - problem.tie_value[worst])[0]
        yield Finding("tie", f"{problem.tie_name(worst)} is missed by {missed:.3g}{length}")
    if certificate.equilibrium > limit:
        worst = int(np.argmax(found.equilibrium))
        count = int(np.sum(found.equilibrium > limit))
        text = f"{problem.dof_name(worst)} is out of balance by {found.residual[worst]:.4g}{force}"
        others = {1: "", 2: ", and another one is too"}.get(count, f", and {count - 1} other unknowns are too")
        yield Finding("equilibrium", text + others)
    if certificate.balance > limit:
        part = f"{certificate.balance:.2g} of the forces that act on it"
        yield Finding("balance", f"the forces on a body do not balance as a whole (by {part})")
    bounds = (certificate.energy_error or 0.0, certificate.force_error or 0.0)
    if max(bounds) > certificate.error_tolerance and certificate.failures:
        named = zip(("the displacement is", "the contact forces are"), bounds, strict=True)
        off = [f"{what} off by up to {_part(bound)}" for what, bound in named if bound > certificate.error_tolerance]
        yield Finding("inaccurate", f"{' and '.join(off)}, in the energy norm")


def _of_contacts(problem: ContactProblem, answer: Answer, found: Violations, limit: float) -> Iterator[Finding]:
    force, length = unit_of(problem.units.force), unit_of(problem.units.length)
    sizes: tuple[tuple[str, Vector, Callable[[int], str], str], ...] = (
        ("tension", found.tension, lambda i: f"{answer.normal_force[i]:.4g}{force}", "held in tension"),
        ("penetration", found.penetration, lambda i: f"{-found.gap[i]:.3g}{length}", "penetrated"),
        (
            "complementarity",
            found.complementarity,
            lambda i: f"{answer.normal_force[i]:.4g}{force} across a gap of {found.gap[i]:.3g}{length}",
            "pushing without touching",
        ),
        ("cone", found.cone, lambda i: _friction_of(problem, answer, i), "exceeding the friction bound mu l_N"),
        (
            "slip",
            found.slip_direction,
            lambda i: _friction_along(problem, answer, i),
            "slipping without friction of mu l_N against the slip",
        ),
    )
    for kind, measure, worded, what in sizes:
        beyond = np.flatnonzero(measure > limit)
        if not beyond.size:
            continue
        worst = beyond[np.argsort(-measure[beyond], kind="stable")]
        if len(worst) == 1:
            i = int(worst[0])
            yield Finding(kind, f"{problem.contact_name(i)} is {what} ({worded(i)})")
            continue
        named = ", ".join(f"{problem.contact_name(int(i))} ({worded(int(i))})" for i in worst[:NAMED])
        more = f" and {len(worst) - NAMED} more contacts" if len(worst) > NAMED else ""
        yield Finding(kind, f"{named}{more} are {what}")


def _friction_of(problem: ContactProblem, answer: Answer, i: int) -> str:
    if answer.friction_force is None or problem.friction is None:
        return ""
    bound = problem.friction[i] * max(answer.normal_force[i], 0.0)
    size = float(np.linalg.norm(answer.friction_force[i]))
    return f"{size:.4g} against {bound:.4g}{unit_of(problem.units.force)}"


def _friction_along(problem: ContactProblem, answer: Answer, i: int) -> str:
    """Return in words the friction force compared to mu l_N, and its angle to the slip."""
    slip = slips(problem, answer.displacement)
    if slip is None or answer.friction_force is None:
        return ""
    force, moved = answer.friction_force[i], slip[i]
    size = float(np.linalg.norm(force) * np.linalg.norm(moved))
    text = _friction_of(problem, answer, i)
    if not 0 < size < np.inf:
        return text
    angle = float(np.degrees(np.arccos(np.clip(force @ moved / size, -1, 1))))
    return f"{text}, {angle:.3g} degrees off" if angle >= 0.5 else text


def _part(bound: float) -> str:
    """Return a fraction of the right size in words."""
    if 1e-3 <= bound < 1:
        return f"{100 * bound:.2g} %"
    return f"{bound:.2g} {'of' if bound < 1 else 'times'} the right size"


# A hypothesis explains an answer if undoing it reduces the error by the first factor, and at most to the second.
GONE, LEFT = 1e-2, 1e-3
# Smaller differences count as no error.
NO_ERROR = 1e-9
# Undoing a mistake must reduce the error by this factor even if the rest is below NO_ERROR.
LEAST_REDUCTION = 0.1


@dataclass(frozen=True, eq=False)
class Explanation:
    """A cause, and the error of the answer with it undone."""

    finding: Finding
    error: float  # the remaining error
    beside: tuple[Finding, ...] = ()  # further causes that are needed


# Operations (a tenth of a second) of a certificate without known right answer, whose bounds fail.
PER_CERTIFICATE = 1e8


@dataclass(eq=False)
class Effort:
    """The operations available for other questions, those used, and the kinds of questions not examined."""

    allowed: float
    spent: float = 0.0
    unasked: list[str] = field(default_factory=list)

    @property
    def exhausted(self) -> bool:
        return self.spent >= self.allowed


@dataclass(frozen=True, eq=False)
class Evidence:
    """One refused answer."""

    problem: ContactProblem
    given: GivenAnswer
    answer: Answer  # complete
    certificate: Certificate
    right: Solution | None
    recovered: bool = False  # whether a part of the answer was computed from the others
    effort: Effort = field(default_factory=lambda: Effort(np.inf))  # shared by all evidence of a diagnosis

    @cached_property
    def before(self) -> float:
        """Return the relative error of the given parts, infinity if no right answer is known.

        With several answers, the right answer found may be far although an equilibrium with this answer's states is
        near.
        """
        return min(np.inf if self.right is None else self.apart(self.given, self.right), self.own_states)

    @cached_property
    def own_states(self) -> float:
        """Return the relative distance from an equilibrium with the answer's own open, sticking and slipping contacts.

        It is infinite if there is only one equilibrium, the right answer, or nothing to compare with.
        """
        found = self.certificate
        several = SEVERAL in found.uniqueness or POSSIBLE in found.uniqueness
        return found.distance if several and found.distance is not None else np.inf

    @cached_property
    def weights(self) -> dict[str, Any]:
        """Return weights that make entries of each part comparable in energy, relative to the largest of displacements
        or forces.

        Only ratios are compared, and weights of at most one avoid overflow.
        """
        D = unknown_scale(self.problem)
        problem = self.problem

        def of(rows: Any) -> Vector:
            return np.asarray(np.sqrt(np.asarray(rows.multiply(rows) @ D**2).ravel()))

        friction = None
        if problem.tangent is not None and problem.slip_origin is not None:
            friction = of(problem.tangent).reshape(problem.slip_origin.shape)
        normal, tie = of(problem.normal), of(problem.tie)
        largest = max(_largest(part) for part in (normal, friction, tie) if part is not None)
        return {
            "displacement": np.min(D) / D,
            "normal_force": normal / largest,
            "friction_force": None if friction is None else friction / largest,
            "tie_force": tie / largest,
        }

    @cached_property
    def shared(self) -> bool:
        """Return whether forces are not unique because of dependent rows, by the certificates."""
        words = [*self.certificate.reasons, *self.certificate.notes, *self.certificate.uniqueness]
        if self.right is not None:
            certificate = self.right.certificate
            words += [*certificate.reasons, *certificate.notes, *certificate.uniqueness]
        return any("redundant" in word or "forces not unique" in word for word in words)

    @cached_property
    def given_parts(self) -> tuple[str, ...]:
        """Return the names of the parts of the answer that were given and have entries."""
        return tuple(name for name in ANSWER_PARTS if getattr(self.given, name) is not None and self.size_of(name))

    def size_of(self, name: str) -> int:
        return int(np.size(getattr(self.given, name)))

    def apart(self, one: GivenAnswer, other: Solution | Answer) -> float:
        """Return the distance of the given parts of two answers."""
        worst = 0.0
        names = list(self.given_parts)
        if self.shared and "normal_force" in names:
            worst = self._of_resultants(one, other)
            names = [name for name in names if name == "displacement"]
        for name in names:
            worst = max(worst, self.part_apart(name, getattr(one, name), getattr(other, name)))
        return worst

    def part_apart(self, name: str, mine: Array, right: Array) -> float:
        """Return max |w (x - x*)| / max |w x*|; a negligible right part of forces is compared to the size of all
        forces.
        """
        weight = self.weights[name]
        difference = weight * (mine - right)
        if name == "displacement":
            difference = self._without_free_motions(difference)
        return _relative(difference, weight * right, weight * mine, self._floor(name))

    def _floor(self, name: str) -> float:
        """Return the size below which a part of the forces is compared to all forces."""
        if self.right is None or name == "displacement":
            return 0.0
        sizes = [
            float(np.max(abs(self.weights[other] * getattr(self.right, other)), initial=0.0))
            for other in ("normal_force", "friction_force", "tie_force")
            if getattr(self.right, other) is not None and self.weights[other] is not None
        ]
        return 1e-3 * max(sizes, default=0.0)

    def _without_free_motions(self, difference: Vector) -> Vector:
        if self.right is None or not self.right.free_motions or not np.isfinite(difference).all():
            return difference
        motions = np.column_stack([motion.direction for motion in self.right.free_motions])
        motions = motions * self.weights["displacement"][:, None]
        along, *_ = np.linalg.lstsq(motions, difference, rcond=None)
        return np.asarray(difference - motions @ along)

    def _of_resultants(self, one: GivenAnswer, other: Solution | Answer) -> float:
        D = unknown_scale(self.problem)
        D = D / np.max(D)
        mine, right = (D * self.resultant(answer) for answer in (one.filled(self.problem), other))
        return _relative(mine - right, right, mine, 0.0)

    def resultant(self, answer: Solution | Answer) -> Vector:
        """Return E_N'l_N + E_T'l_T + A'nu (n,) of the given parts of an answer [force]."""
        total = self.problem.normal.T @ answer.normal_force
        if "friction_force" in self.given_parts and self.problem.tangent is not None:
            total = total + self.problem.tangent.T @ np.ravel(np.asarray(answer.friction_force))
        if "tie_force" in self.given_parts:
            total = total + self.problem.tie.T @ answer.tie_force
        return np.asarray(total)

    def explains(self, left: float) -> bool:
        """Return whether a hypothesis that leaves this error explains the answer."""
        return left <= min(LEFT, GONE * self.before) or left <= NO_ERROR < LEAST_REDUCTION * self.before

    def passes(self, changed: GivenAnswer, problem: ContactProblem | None = None) -> bool:
        """Return whether the certificate passes a changed answer, or the same answer to another problem.

        Without a known right answer certificates are expensive, and count as other questions.
        """
        if self.right is None:
            if self.effort.exhausted:
                self.effort.unasked.append("signs and units")
                return False
            self.effort.spent += PER_CERTIFICATE
        try:
            found, _ = certify_given(
                problem or self.problem, changed, self.certificate.tolerance, self.certificate.error_tolerance
            )
        except ContactQPError:
            return False
        return found.passed

    def passes_with(self, **changes: Any) -> bool:
        """Return whether the given answer is right for the problem with other data.

        Invalid data explain nothing, such as infinite ones due to large factors.
        """
        try:
            changed = self.problem.replace(**changes)
        except InvalidProblem:
            return False
        return self.passes(self.given, changed)

    def with_parts(self, **changes: Any) -> GivenAnswer:
        """Return the given answer with some parts changed."""
        return replace(self.given, **changes)

    def then(self, undone: GivenAnswer, left: float) -> str:
        """Return in words how right the answer is with its mistake undone."""
        return "this answer is right" if self.passes(undone) else f"it agrees with the right one to {digits(left)}"


def _largest(values: Any) -> float:
    """Return the largest size, at least the smallest normal number, for division."""
    return max(float(np.max(abs(np.asarray(values)), initial=0.0)), TINY)


def _relative(difference: Any, right: Any, mine: Any, floor: float) -> float:
    scale = max(float(np.max(abs(right), initial=0.0)), floor)
    scale = scale or float(np.max(abs(mine), initial=0.0))
    worst = float(np.max(abs(difference), initial=0.0))
    return worst / scale if scale > 0 else worst


def digits(part: float) -> str:
    """Return in words how many digits agree for this relative difference."""
    count = 16 if part <= 0 else max(0, min(16, int(np.floor(-np.log10(part)))))
    return f"{count} digit{'' if count == 1 else 's'}"
