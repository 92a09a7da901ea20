"""Define answers as data: the `Candidate` of a method, the `Certificate` that judges it, and the `Solution` for
users.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem, counted
from contactqp.model.arrays import Array, Vector, computes
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import ReadOnly, read_only
from contactqp.model.summary import Printed, html_of, place_of, summary_of, verdict_of, wrapped

# The possible bases of a verdict.
BOUNDS, STATE, FIGURES_ALONE = "bounds", "state", "figures"
# The scope of proven bounds: for every answer, or for the only one nearby.
GLOBALLY, LOCALLY = "global", "local"
# What a problem determines: the displacement, or only the energy where K is singular on free unknowns.
BY_DISPLACEMENT, BY_ENERGY = "displacement", "energy"


FIGURES = ("equilibrium", "balance", "penetration", "tension", "complementarity", "cone", "slip_direction", "tie")


@dataclass(frozen=True, eq=False)
class NegligibleSizes(ReadOnly):
    """The forces and lengths below which an answer counts as zero at an unknown or in a row."""

    force: Vector  # (n,) at unknowns [force]
    normal: Vector  # (m,) in the normal rows [length]
    tangent: Vector  # (m (d-1),) in the tangential rows [length]
    tie: Vector  # (k,) in the ties [length]
    contact_force: Vector | None = None  # (n,) of contacts at unknowns, where less than `force` [force]


# The arrays that an answer consists of, in the order in which messages and tables name them.
ANSWER_PARTS = ("displacement", "normal_force", "friction_force", "tie_force")


V = TypeVar("V")  # type of vectors: doubles, extended or rational numbers
F = TypeVar("F")  # type of friction forces, which may have another shape or be None


@dataclass(frozen=True, eq=False)
class AnswerOf(Generic[V, F]):
    """A displacement with its forces in the signs of a `ContactProblem`, in numbers of any kind."""

    displacement: V  # (n,)
    normal_force: V  # (m,)
    friction_force: F  # (m, d-1)
    tie_force: V  # (k,)


@dataclass(frozen=True, eq=False)
class Answer(AnswerOf[Vector, Array | None], ReadOnly):
    """A displacement with its forces in doubles, in the shapes of a problem."""


def _of_answer(name: str, doc: str) -> Any:
    """Return a property that reads an array of the answer as fast as an attribute."""
    return property(attrgetter(f"answer.{name}"), doc=doc)


class HoldsAnswer:
    """A class that holds an `Answer` and has the arrays of it as properties."""

    answer: Answer
    displacement: Vector = _of_answer("displacement", "Displacement (n,) of `answer` [length].")
    normal_force: Vector = _of_answer(
        "normal_force", "Normal forces (m,) of `answer`, positive in compression [force]."
    )
    friction_force: Array | None = _of_answer(
        "friction_force", "Friction (m, d-1) of `answer` [force]; None without it."
    )
    tie_force: Vector = _of_answer("tie_force", "Forces of the ties (k,) of `answer` [force].")


@dataclass(frozen=True, eq=False)
class Violations(ReadOnly):
    """The figures at every unknown, contact and tie, so that messages can name the worst one; none is negative."""

    equilibrium: Vector  # (n,) |residual_j| / F_j (Oettli and Prager 1964)
    residual: Vector  # (n,) f - K u - E_N'l_N - E_T'l_T - A'nu [force]
    penetration: Vector  # (m,) (E_N u - g)+ as a gap
    tension: Vector  # (m,) (-l_N)+ as a force
    complementarity: Vector  # (m,) min(gap, l_N), each in its own measure
    cone: Vector  # (m,) (|l_T| - mu l_N)+ as a force
    slip_direction: Vector  # (m,) min(|s|, |l_T - mu l_N s/|s||), each in its own measure
    tie: Vector  # (k,) |A u - b| / (|A||u| + |b|)
    slip_measure: Vector  # (m,) |s| / |L| of the tangential rows, 0 without friction
    turned: Vector  # (m,) change of the friction force if the displacement is rounded to doubles [force]
    lengths: Vector  # (m,) L of the normal rows [length]
    tangential_lengths: Vector  # (m,) that of the tangential rows
    gap: Vector  # (m,) g - E_N u [length]
    gap_measure: Vector  # (m,) |gap| / L, 0 where the gap is nothing
    force_measure: Vector  # (m,) |l_N| as a force
    meeting: Vector  # (n,) F [force]
    intrinsic_size: float  # S of problem and answer [square root of energy]
    nothing: NegligibleSizes  # forces and lengths that count as zero


@dataclass(frozen=True, eq=False)
class Certificate(ReadOnly, Printed):
    """The verdict on an answer, with its largest dimensionless violations and proven bounds on its errors.

    `passed` is true if every figure is at most `tolerance` and every available bound at most `error_tolerance`
    (`force_bound` relative to the largest contact force). `proven` is true if energy and force error were bounded and
    not only estimated, as for bodies that are too large to factorise.

    With friction, `natural_map` measures Signorini's and Coulomb's law as one equation. It enters the verdict with four
    times the tolerance, which the other figures imply, so that it refuses no answer that they pass.
    `uniqueness` is empty if this is the only answer. It does not enter the verdict, since each of several answers is
    right. "several answers": others exist at this load; "several answers possible": no test excludes them (friction is
    above a critical coefficient, or contacts are too many for more than a sufficient bound); "forces not unique":
    redundant contacts may share the force differently; "not examined": `notes` give the reason. `contraction` is the
    factor by which a step of the Tresca fixed-point iteration multiplies the error of its friction bounds near this
    answer.

    `basis` states what the verdict rests on. "bounds": the bounds on the error, without friction. "state": with
    friction, the solution of the linear system of its own combination of open, stick and slip, from which `distance` is
    measured. "figures": the figures alone; `notes` or `reasons` give the reason.

    `scope` states for which answers `proven` holds. "global": the bounds hold for every equilibrium, so always without
    friction, and with it where it is below a constant of the bodies (`contactqp.certificate.frictional_bounds`).
    "local": of the only equilibrium whose displacement is within `radius` of this one, in the energy norm, or, where
    contacts alone hold a body, in that of v'Kv + sum K_jj v_j^2; others further away are not excluded. Where nothing
    resists a rigid motion it is unique up to that motion, which changes neither strain nor forces; a note states it.
    Either error is infinite where the strain, or the contact forces, of the equilibrium may vanish. With friction
    `force_bound` is that of a contact's whole force, except along tangents whose unknowns are all supported: friction
    along these has no effect, any value within the cone is right, and a note states it where contacts stick.

    Where unknowns have no stiffness, forces on them have no energy, and `force_error` compares Euclidean norms of all
    forces, with rows scaled to entries near one.

    `determined` is "energy" where K is singular on unknowns that constraints leave free, as where a body drifts and in
    a linear program: displacement and forces may then be one of many. Where there are `energy_bounds` the verdict
    requires that they differ by at most `tolerance` times the larger term of the energy; `energy_error` is then
    relative to sqrt(2 |f'u*|) where nothing is strained, |u*|_K being zero. Where closed contacts and ties contradict
    each other by rounding of the data, nothing is `proven`, and `energy_bounds` are those of a problem whose gaps are
    changed by that much, as stated in `reasons`.
    """

    equilibrium: float  # componentwise backward error
    balance: float  # of the forces on every rigid motion of the bodies
    penetration: float
    tension: float
    complementarity: float
    cone: float
    slip_direction: float
    tie: float
    natural_map: (
        float | None
    )  # contact and friction as one equation (`contactqp.certificate.coulomb_law`); None without friction
    energy_error: float | None  # >= |u - u*|_K / |u*|_K, absolute where |u*|_K vanishes
    force_error: float | None  # >= |l - l*|_W / |l*|_W, absolute where l* vanishes
    force_bound: Vector | None  # (m,) >= |l_i - l_i*| [force]
    reasons: tuple[str, ...]  # reasons for bounds that are None
    grazing: tuple[int, ...]  # contacts whose gap and force both vanish
    failures: tuple[str, ...]  # what failed, where, by how much
    notes: tuple[str, ...]
    # With friction, findings against uniqueness; without it displacements and strains are unique, and a note states
    # where forces are not.
    uniqueness: tuple[str, ...]
    # From 1 on the Tresca fixed-point iteration does not converge without damping; None beyond 100 closed contacts.
    contraction: float | None
    tolerance: float
    error_tolerance: float
    passed: bool
    proven: bool
    basis: str  # "bounds", "state" or "figures"
    energy_bounds: tuple[float, float] | None = None  # lower <= J* <= upper [force * length], where they were formed
    determined: str = BY_DISPLACEMENT  # "displacement" or "energy"
    distance: float | None = None  # relative, to the solution for its own states; None unless `basis` is "state"
    scope: str | None = None  # "global", "local" (within `radius`), or None where nothing is proven
    radius: float | None = None  # [square root of energy], of the local statement
    violations: Violations | None = field(
        repr=False, default=None
    )  # contact by contact; None where the answer is not finite

    def __bool__(self) -> bool:
        """Return `passed`, so that ``assert contactqp.certify(...)`` fails where the answer is refused."""
        return self.passed

    def __repr__(self) -> str:
        return f"{type(self).__name__}({verdict_of(self)})"

    def __str__(self) -> str:
        lines = []
        if self.basis == STATE and self.distance is not None:
            same = "with the same contacts open, sticking and slipping"
            lines.append(f"relative distance to the equilibrium {same}: {self.distance:.3g}")
        if self.scope == LOCALLY and self.radius is not None:
            within = f"within {self.radius:.3g} of this answer, in the square root of energy"
            lines.append(f"proven is that it is the only one {within}; others further away are not excluded")
        lines += map(str, self.failures)
        lines += [f"no bound: {reason}" for reason in reasons_together(self.reasons)]
        lines += [f"note: {note}" for note in self.notes]
        if self.passed:
            verdict = "passed, proven" if self.proven else "passed, not proven"
        else:
            verdict = "REFUSED, error bounds proven" if self.proven else "REFUSED, no error bounds"
        return "\n".join([verdict, *wrapped(*lines)])


def reasons_together(reasons: Iterable[str]) -> Iterator[str]:
    """Yield each reason once, after the names of all bounds that it concerns."""
    named: dict[str, list[str]] = {}
    for text in reasons:
        what, _, reason = text.partition(": ")
        named.setdefault(reason, []).append(what)
    for reason, names in named.items():
        yield f"{', '.join(names)}: {reason}"


@dataclass(frozen=True, eq=False)
class LocalCertificate(ReadOnly, Printed):
    """The verdict on forces: the worst violation of any contact, and published errors; `passed` judges the former."""

    natural_map: float  # the residual of the law of contact and friction, each contact scaled to a compliance of one
    siconos_error: float  # `siconos_local_error`, W and q as given; no part of the verdict
    penetration: float  # (-u_N)+ as a velocity
    tension: float  # (-r_N)+ as a force
    complementarity: float  # min(u_N, r_N), each in its own measure
    cone: float  # (|r_T| - mu r_N)+ as a force
    slip_direction: float  # min(|u_T|, |r_T + mu r_N u_T/|u_T||), each in its own measure
    joints: float  # |V'r + R l + s| / (|V|'|r| + |R||l| + |s|)
    failures: tuple[str, ...]
    tolerance: float
    passed: bool
    gap_measure: Vector = field(repr=False)  # (m,) |u_N| as a velocity
    slip_measure: Vector = field(repr=False)  # (m,) |u_T| as a velocity
    force_measure: Vector = field(repr=False)  # (m,) r_N as a force
    _examine: Callable[[], tuple[tuple[str, ...], tuple[str, ...]]] = field(repr=False)  # finds uniqueness and notes
    # Bounds of `certify_local`, no part of the verdict (`contactqp.certificate.frictional_bounds`).
    force_error: float | None = None  # >= |r - r*|_W / |r*|_W, absolute where r* vanishes
    force_bound: Vector | None = None  # (m,) >= |r_i - r_i*| [force]
    scope: str | None = None  # as that of `Certificate`; "local": the only forces within `radius`, in the norm of W
    radius: float | None = None
    reasons: tuple[str, ...] = ()  # why there is no bound

    @cached_property
    def uniqueness(self) -> tuple[str, ...]:
        """Return findings against uniqueness, with friction; they are not part of the verdict and found when read."""
        return self._examined[0]

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """Return the notes, which explain these findings."""
        return self._examined[1]

    @cached_property
    def _examined(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        return self._examine()

    def __getstate__(self) -> dict[str, Any]:
        """Return the data for copies and pickles, with the findings in place of the problem that they are found in."""
        return vars(self) | dict(_examine=partial(tuple, (self.uniqueness, self.notes)))

    @property
    def proven(self) -> bool:
        """Return whether the errors of the forces could be bounded."""
        return self.force_error is not None

    def __bool__(self) -> bool:
        """Return `passed`, so that ``assert contactqp.certify_local(...)`` fails where the forces are refused."""
        return self.passed

    @property
    def basis(self) -> str:
        """Return the basis of the verdict, always "figures"."""
        return "figures"

    def __str__(self) -> str:
        lines = [f"natural map {self.natural_map:.3g}"]
        if self.force_error is not None:
            which = "the only forces" if self.radius is None else f"the only forces within {self.radius:.3g}"
            lines.append(f"proven: at most {self.force_error:.3g} of their size from {which}")
        lines += map(str, self.failures)
        lines += [f"no bound: {text}" for text in self.reasons]
        lines += [f"note: {text}" for text in self.notes]
        return "\n".join(["passed" if self.passed else "REFUSED", *wrapped(*lines)])


@dataclass(frozen=True, eq=False)
class Candidate(HoldsAnswer):
    """The answer of one method to one `ContactProblem`, in that problem's own unknowns, neither polished nor certified.

    Displacements, forces and ties have the problem's units; contact forces are positive in compression.
    """

    answer: Answer  # its friction is None unless the method enforces friction itself
    iterations: int | None = 0  # None if the backend does not report it
    claimed: bool = True  # the method's own flag "solved"
    status: str = ""  # the status text of the backend
    history: tuple[float, ...] = ()  # the method's own measure of progress, one number an iteration
    contact_status: NDArray[np.str_] | None = None  # (m,) of open, stick, slip, where the method enforces friction


@dataclass(frozen=True)
class Work:
    """The work that a solution took."""

    factorisations: int = 0  # of the stiffness
    back_substitutions: int = 0  # right-hand sides solved with them
    iterations: int | None = 0  # of the method, None if it does not report them
    retained: int = 0  # unknowns of the problem passed to the method
    polish_corrections: int = 0  # changes of the method's contact set while polishing
    solver: str = ""  # "dense", "superlu", "pardiso", or "pyamg" where nothing is factorised
    krylov_iterations: int = 0  # of conjugate gradients, the certificate's included
    routes: tuple[str, ...] = ()  # further attempts after a refused first answer, with their results

    def after(self, earlier: Work) -> Work:
        """Return the sum of this work and earlier work."""
        counts = ("factorisations", "back_substitutions", "polish_corrections", "krylov_iterations")
        sums: dict[str, Any] = {name: getattr(self, name) + getattr(earlier, name) for name in counts}
        counted = self.iterations is not None and earlier.iterations is not None
        return replace(self, iterations=(self.iterations or 0) + (earlier.iterations or 0) if counted else None, **sums)


@dataclass(frozen=True, eq=False)
class Raw(ReadOnly, HoldsAnswer):
    """A method's answer before polishing, with a certificate that is computed on first access."""

    problem: ContactProblem = field(repr=False)
    answer: Answer  # without friction forces, as raw answers exist only without friction
    claimed: bool
    status: str
    judge: Callable[..., Certificate] = field(repr=False)  # `contactqp.certificate.certificate.compute_certificate`

    @cached_property
    def certificate(self) -> Certificate:
        """Return the certificate of the unpolished answer."""
        answer = self.answer
        parts = (answer.displacement, answer.normal_force, answer.friction_force, answer.tie_force)
        return self.judge(self.problem, *parts)


@dataclass(frozen=True, eq=False)
class FreeMotion(ReadOnly):
    """A rigid motion that no load drives and no contact or tie resists."""

    direction: Vector  # (n,), largest component 1
    description: str

    def __str__(self) -> str:
        return self.description


@dataclass(frozen=True, eq=False)
class Final:
    """The answer to be certified: a candidate, polished or not, without components along free motions."""

    answer: Answer
    free_motions: tuple[FreeMotion, ...] = ()
    corrections: int = 0  # of the contact set
    polished: bool = False
    contact_status: NDArray[np.str_] | None = None  # of an approximate method; None for the default of the certificate


@computes
@dataclass(frozen=True, eq=False)
class Solution(ReadOnly, HoldsAnswer):
    """Displacement and forces of one ContactProblem, with the certificate that judged them.

    Forces are positive in compression (`normal_force` is l_N of K u + E_N' l_N + E_T' l_T + A' nu = f); gaps are
    positive when open.
    """

    problem: ContactProblem = field(repr=False)
    answer: Answer  # its arrays are also properties of the solution
    contact_status: NDArray[np.str_]  # (m,) of open, closed, grazing, stick, slip
    free_motions: tuple[FreeMotion, ...]
    certificate: Certificate
    method: str
    seconds: float  # to the certified answer
    certify_seconds: float  # of these, for the certificate
    work: Work
    raw: Raw | None = field(default=None, repr=False)  # before polish, where the answer was polished
    history: tuple[float, ...] = field(default=(), repr=False)  # of an iterative method, one number an iteration

    @property
    def gap(self) -> Vector:
        """Return g - E_N u, positive when open [length]."""
        return read_only(np.asarray(self.problem.gap - self.problem.normal @ self.displacement))

    @property
    def slip(self) -> Array | None:
        """Return E_T u - slip_origin, (m, d-1) [length], or None without tangential rows."""
        problem = self.problem
        if problem.tangent is None or problem.slip_origin is None:
            return None
        slipped = (problem.tangent @ self.displacement).reshape(problem.slip_origin.shape)
        return read_only(np.asarray(slipped - problem.slip_origin))

    @property
    def energy(self) -> float:
        """Return the potential energy 1/2 u'Ku - f'u [force * length]."""
        return self.problem.energy(self.displacement)

    def at(self, unknown: str | int) -> float:
        """Return the displacement of an unknown, by its name in `dof_names` or its number [length].

        Raises
        ------
        InvalidProblem
            No unknown is called that; the nearest names are given.
        """
        names = self.problem.dof_names or ()
        if isinstance(unknown, str) and unknown not in names and unknown in (self.problem.contact_names or ()):
            raise InvalidProblem(f"{unknown!r} is a contact: force_at, gap_at, friction_at and status_at take it")
        return float(self.displacement[place_of(unknown, self.problem.dimension, self.problem.dof_name, "unknown")])

    def force_at(self, contact: str | int) -> float:
        """Return the normal force of a contact, by its name in `contact_names` or its number [force].

        `gap_at`, `friction_at` and `status_at` ask in the same way.

        Raises
        ------
        InvalidProblem
            No contact is called that; the nearest names are given.
        """
        return float(self.normal_force[self._contact(contact)])

    def gap_at(self, contact: str | int) -> float:
        """Return the gap of a contact, positive when open [length]; `contact` and errors as in `force_at`."""
        return float(self.gap[self._contact(contact)])

    def friction_at(self, contact: str | int) -> Vector | None:
        """Return the friction force (d-1,) of a contact [force], or None without friction; else as `force_at`."""
        place = self._contact(contact)
        return None if self.friction_force is None else read_only(self.friction_force[place])

    def status_at(self, contact: str | int) -> str:
        """Return open, closed, grazing, stick or slip; `contact` and errors as in `force_at`."""
        return str(self.contact_status[self._contact(contact)])

    def _contact(self, contact: str | int) -> int:
        return place_of(contact, self.problem.contacts, self.problem.contact_name, "contact")

    def summary(self) -> str:
        """Return verdict, contacts and displacements as tables of at most 80 columns; what `print` shows."""
        return summary_of(self)

    def derivative(self, of: str, with_respect_to: str, direction: Any) -> Any:
        """Return the rate of a quantity along a direction: `contactqp.analysis.derivatives.derivative`."""
        return import_module("contactqp.analysis.derivatives").derivative(self, of, with_respect_to, direction)

    def jacobian(self, of: str, with_respect_to: str, return_bound: bool = False) -> Any:
        """Return the derivatives with respect to all entries of a parameter:
        `contactqp.analysis.derivatives.jacobian`.
        """
        return import_module("contactqp.analysis.derivatives").jacobian(self, of, with_respect_to, return_bound)

    def pullback(self, of: str, weights: Any, with_respect_to: str, return_bound: bool = False) -> Any:
        """Return the gradient of weights . quantity with respect to a parameter.

        Parameters
        ----------
        of, weights, with_respect_to, return_bound : as in `contactqp.analysis.derivatives.pullback`
        """
        module = import_module("contactqp.analysis.derivatives")
        return module.pullback(self, of, weights, with_respect_to, return_bound)

    def plot(self, file: str | Path | None = None, **options: Any) -> Any:
        """Draw the answer, into a file if one is given, and return the figure: `contactqp.draw(self, file, ...)`."""
        return import_module("contactqp.study.answer_pictures").draw(self, file, **options)

    def __repr__(self) -> str:
        problem = self.problem
        sizes = f"{counted('unknown', problem.dimension)}, {counted('contact', problem.contacts)}"
        return f"{type(self).__name__}({self.method}, {sizes}, {verdict_of(self.certificate)})"

    def __str__(self) -> str:
        return summary_of(self)

    def _repr_html_(self) -> str:
        return html_of(self)
