"""One problem by every method: what came out, held against the exact solution, and the certificates of it all."""

from __future__ import annotations

import time
import traceback
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

import contactqp as cq
from benchmarks.exact_truth import Truth, find_truth
from benchmarks.problem_families import FAMILIES, family
from contactqp.linalg.equilibration import nondimensional
from contactqp.linalg.rational import NoSolution, Undecided, floats, rational
from contactqp.solving.methods import Settings, find
from contactqp.solving.methods.method import ACTIVE_SET, QUADRATIC_PROGRAM

EPS = float(np.finfo(float).eps)
WRONG, PER_CONDITION = 1e-6, 100 * EPS
# What rounding to floats may take from a bound: relative to the bound itself, and to the size of the truth.
SLACK = 16 * EPS
# Where the truth is that of a stiffness which was made singular exactly: so many roundings of it, times kappa.
BLUR = 1e3
# An exact answer that floats cannot hold to this is no well-posed problem for a method that returns floats.
REPRESENTABLE = 1e-7
VERDICTS = ("right", "refused", "wrong", "denied", "crashed", "unsupported")
# Seconds for a method that can stop; all of these problems take it milliseconds.
PATIENCE = 5.0
NOISE = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12)


@dataclass(frozen=True)
class Outcome:
    """What one method made of one problem."""

    method: str
    verdict: str  # one of VERDICTS; "denied": NoEquilibrium of a problem that has one
    error: float | None  # of what was returned or refused
    raw_wrong: bool  # the method's own flag said solved, and its raw answer is wrong
    needlessly: bool  # refused an answer that is right
    seconds: float
    said: str = ""


@dataclass(frozen=True)
class Bounded:
    """One bound of one certificate against the true error."""

    figure: str  # energy_error, force_error, force_bound
    source: str  # method, raw method, or the way the truth was spoiled
    bound: float
    error: float  # what it must exceed
    largest: float  # the largest error that it may mean, where the truth is next to nothing
    slack: float = SLACK  # what rounding may take from it
    rounding: float = EPS  # what one rounding of the candidate makes of the error

    @property
    def kind(self) -> str:
        """ "returned", "raw" or "spoiled"."""
        if self.source.startswith("raw "):
            return "raw"
        return "returned" if self.source in available() else "spoiled"

    @property
    def below(self) -> bool:
        return self.bound < self.error * (1 - self.slack) - self.slack


@dataclass(frozen=True)
class Report:
    """Everything about one problem."""

    family: str
    seed: int
    truth: str  # "exact", "none" (proven), or why it is not known
    pivots: int = 0
    kappa: float = 1.0
    representable: float = 0.0
    outcomes: tuple[Outcome, ...] = ()
    bounds: tuple[Bounded, ...] = ()
    spoiled_passed: tuple[tuple[str, float], ...] = ()
    truth_refused: str = ""  # what the certificate has against the truth rounded to floats
    warned: tuple[str, ...] = ()  # warnings that escaped

    @property
    def well_posed(self) -> bool:
        return FAMILIES[self.family].well_posed and self.truth == "exact" and self.representable <= REPRESENTABLE


@cache
def available() -> tuple[str, ...]:
    """Every installed method, and the second way of the augmented Lagrangian."""
    return (*(method.name for method in cq.methods() if method.installed), "augmented-lagrangian uzawa")


def judge(family_name: str, seed: int, methods: tuple[str, ...]) -> Report:
    """Solve one problem by every method and hold all that comes out against the exact solution."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        problem = family(family_name, seed)
        first, error = attempt(problem, "active-set")
        truth, known = exact_truth(problem, first or getattr(error, "solution", None))
        if truth is None:
            outcomes = tuple(_without_truth(problem, method, known) for method in methods)
            return Report(family_name, seed, known, outcomes=outcomes)
        threshold = WRONG + PER_CONDITION * (kappa := truth.condition)
        bounds: list[Bounded] = []
        outcomes = tuple(_outcome(problem, method, truth, threshold, bounds) for method in methods)
        passed, refused = _spoil(problem, truth, threshold, seed, bounds)
    said = tuple(sorted({f"{w.category.__name__}: {w.message}"[:120] for w in caught}))
    values = (truth.pivots, kappa, truth.representable, outcomes, tuple(bounds), passed, refused, said)
    return Report(family_name, seed, known, *values)


def exact_truth(problem: cq.ContactProblem, solution: Any) -> tuple[Truth | None, str]:
    guesses = [] if solution is None else [np.flatnonzero(solution.normal_force > 0)]
    try:
        return find_truth(problem, guesses), "exact"
    except NoSolution:
        return None, "none"
    except Undecided as reason:
        return None, f"undecided: {reason}"


def attempt(problem: cq.ContactProblem, method: str) -> tuple[Any, BaseException | None]:
    """The solution, or None and what was raised."""
    name, _, way = method.partition(" ")
    options: dict[str, Any] = {"update": way, "max_iter": 100} if way else {}  # 100 show whether it converges
    if find(name).kind == QUADRATIC_PROGRAM and "no time limit" not in find(name).note:
        options["time_limit"] = PATIENCE  # HiGHS cycles for ever on some of these
    for knob in find(name).required:
        options[knob] = 1e4 * _contact_stiffness(problem)
    try:
        # A fresh problem: no method inherits what another has computed.
        return cq.solve(problem.replace(stiffness=problem.stiffness), method=name, **options), None
    except Exception as error:  # noqa: BLE001  a crash is a result here, counted and reported
        return None, error


def _contact_stiffness(problem: cq.ContactProblem) -> np.ndarray:
    """1 / sum_j (E_ij^2 / K_jj)."""
    diagonal = problem.stiffness.diagonal()
    stiff = np.where(diagonal > 0, diagonal, np.max(diagonal))
    return np.asarray(1.0 / (problem.normal.power(2) @ (1.0 / stiff)))


def _outcome(problem: cq.ContactProblem, method: str, truth: Truth, threshold: float, bounds: list[Bounded]) -> Outcome:
    started = time.perf_counter()
    returned, error = attempt(problem, method)
    seconds = time.perf_counter() - started
    solution = returned if returned is not None else getattr(error, "solution", None)
    true = None
    if solution is not None:
        errors = truth.errors(solution.displacement, solution.normal_force, solution.tie_force)
        true = errors.worst
        bounds += bounded(method, truth, solution.certificate, errors)
    raw_wrong = _raw_is_wrong(method, solution, error, truth, threshold, bounds)
    verdict = _verdict(returned, error, true, threshold)
    needlessly = verdict == "refused" and true is not None and true <= WRONG
    return Outcome(method, verdict, true, raw_wrong, needlessly, seconds, _said(error, solution))


def _verdict(returned: Any, error: BaseException | None, true: float | None, threshold: float) -> str:
    if isinstance(error, cq.NoEquilibrium):
        return "denied"
    if isinstance(error, cq.Unsupported):
        return "unsupported"
    if error is not None:
        return "refused" if isinstance(error, cq.ContactQPError) else "crashed"
    if not returned.certificate.passed:
        return "refused"
    return "right" if true is not None and true <= threshold else "wrong"


def _said(error: BaseException | None, solution: Any) -> str:
    if error is None:
        return "" if solution.certificate.passed else "; ".join(solution.certificate.failures)[:300]
    last = "" if isinstance(error, cq.ContactQPError) else traceback.format_tb(error.__traceback__)[-1].strip()
    return f"{type(error).__name__}: {error} {last}"[:300]


def _raw_is_wrong(
    method: str, solution: Any, error: BaseException | None, truth: Truth, threshold: float, bounds: list[Bounded]
) -> bool:
    """Whether the method's own flag said solved of a raw answer that is wrong; also judges the raw answer's bounds."""
    if solution is None or not find(method.split()[0]).exact:
        return False
    if solution.raw is not None:
        errors = truth.errors(solution.raw.displacement, solution.raw.normal_force, solution.raw.tie_force)
        bounds += bounded(f"raw {method}", truth, solution.raw.certificate, errors)
        return bool(solution.raw.claimed and errors.worst > threshold)
    if find(method.split()[0]).kind == ACTIVE_SET or isinstance(error, cq.NotConverged):
        return False
    return truth.errors(solution.displacement, solution.normal_force).worst > threshold


def bounded(source: str, truth: Truth, certificate: Any, errors: Any) -> Iterator[Bounded]:
    """The certificate's bounds with the true errors they are to exceed; a tiny truth may be meant absolutely.

    Where only the energy is determined, or of a program, and nothing is strained, `energy_error` is relative to the
    work of the load.
    """
    slack = SLACK + BLUR * truth.condition * errors.blurred
    for figure, readings in errors.readings.items():
        by_energy = certificate.determined == "energy" or truth.program is not None
        if figure == "energy_error" and by_energy and truth.tiny[0]:
            readings = (*readings, readings[-1] / truth.work) if truth.work > 0 else ()
        if readings and (bound := getattr(certificate, figure)) is not None:
            rounding = errors.rounding if figure == "energy_error" else EPS
            yield Bounded(figure, source, float(bound), min(readings), max(readings), slack, rounding)
    if certificate.force_bound is not None and errors.contact is not None and len(errors.contact):
        own = np.maximum(abs(truth.rounded()[1]), errors.contact)  # a small force counts as well
        own[own == 0] = 1.0
        some = np.where(errors.contact > 0, np.inf, 0.0)  # above a bound of zero
        given = certificate.force_bound > 0
        worst = int(np.argmax(np.divide(errors.contact, certificate.force_bound, out=some, where=given)))
        bound, error = float(certificate.force_bound[worst] / own[worst]), float(errors.contact[worst] / own[worst])
        yield Bounded("force_bound", source, bound, error, error, slack)


def _without_truth(problem: cq.ContactProblem, method: str, known: str) -> Outcome:
    """A problem without solution (only NoEquilibrium is right), or whose solution is not known (nothing is judged)."""
    started = time.perf_counter()
    returned, error = attempt(problem, method)
    seconds = time.perf_counter() - started
    if known != "none":
        return Outcome(method, "unsupported", None, False, False, seconds, known)
    verdict = _verdict(returned, error, None, 0.0)
    verdict = "right" if verdict == "denied" else verdict
    return Outcome(method, verdict, None, _claims_an_answer(problem, method), False, seconds, _said(error, returned))


def _claims_an_answer(problem: cq.ContactProblem, name: str) -> bool:
    """Whether the method alone, asked about a problem without solution, says that it solved it."""
    method = find(name.split()[0])
    if not method.exact or method.kind == ACTIVE_SET:
        return False
    try:
        patient = Settings(time_limit=PATIENCE if "no time limit" not in method.note else None)
        return method.solve(nondimensional(problem)[0] if method.scale else problem, patient).claimed
    except Exception:  # noqa: BLE001  anything but an answer is a refusal here
        return False


# ------------------------------------------------------------------------------- spoiled answers


def _spoil(
    problem: cq.ContactProblem, truth: Truth, threshold: float, seed: int, bounds: list[Bounded]
) -> tuple[tuple[tuple[str, float], ...], str]:
    """Certificates of answers that are wrong on purpose: those that passed, and the objection to the truth."""
    passed: list[tuple[str, float]] = []
    objection = ""
    for name, u, force in spoiled(truth, np.random.default_rng(seed)):
        try:
            certificate = cq.certify(problem, u, force, tie_force=truth.tie_force)
        except cq.InvalidProblem as error:  # the problem is refused, whatever the answer
            return (), str(error)
        errors = truth.errors(u, force, truth.tie_force)
        bounds += bounded(name, truth, certificate, errors)
        if certificate.passed and errors.worst > threshold:
            passed.append((name, errors.worst))
        if name == "truth" and not certificate.passed:
            objection = "; ".join(certificate.failures)[:300]
    return tuple(passed), objection


def spoiled(truth: Truth, rng: np.random.Generator) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """The truth, and answers that are off by a known act: name, displacement, forces."""
    u, force = truth.rounded()
    yield "truth", u, force
    yield "forces x 1.001", u, 1.001 * force
    yield "forces x 1.1", u, 1.1 * force
    for size in NOISE:
        yield f"noise {size:.0e} on u", u * (1 + size * rng.normal(size=len(u))), force
        yield f"noise {size:.0e} on l", u, force * (1 + size * rng.normal(size=len(force)))
    if np.any(force > 0):
        flipped = force.copy()
        flipped[np.argmax(force)] *= -1
        yield "flipped sign", u, flipped
    yield from _other_sets(truth, rng)


def _other_sets(truth: Truth, rng: np.random.Generator) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Exact answers to other questions: a contact ignored, one closed too many, penalty springs."""
    closed = [i for i, x in enumerate(truth.force.entries()) if x > 0]
    opened = [i for i in range(truth.force.nrows()) if i not in closed]
    sets: list[tuple[str, list[int], list[Any]]] = []
    if closed:
        sets.append(("ignored contact", [i for i in closed if i != int(rng.choice(closed))], []))
        for stiffer in (1e2, 1e6, 1e10):
            soft = [truth.compliance[i, i] / rational(stiffer) for i in closed]
            sets.append((f"penalty {stiffer:.0e}", closed, soft))
    if opened:
        sets.append(("one too many", [*closed, int(rng.choice(opened))], []))
    for name, members, softness in sets:
        found = truth.reduced.on_set(members, softness)
        if found is not None:
            yield name, floats(truth.reduced.displaced(*found)), floats(found[0])
