"""`exact`: the equilibrium in rational numbers, or enclosed, and proven.

Where an enclosure cannot decide, rational numbers are guessed from an approximation, and proven.
"""

from __future__ import annotations

import importlib
import time
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from contactqp.errors import InvalidProblem, NoEquilibrium, NotCertified, NotConverged, Unsupported
from contactqp.exchange.problem_files import read_problem
from contactqp.model.arguments import checked
from contactqp.model.arrays import own_floating_point
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution
from contactqp.oracle.exact.exact_solution import ExactSolution
from contactqp.scene.scene import STANDARD_INPUT, Scene, load_scene
from contactqp.scene.shipped import case_path

if TYPE_CHECKING:
    from contactqp.oracle.exact.rational_answer import Asked
    from contactqp.scene.building import NodeModel
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from contactqp.oracle.exact.enclosed_answer import FLOATS_THAT_FLOAT, LOCAL, MINIMUM, is_convex, regular
from contactqp.oracle.exact.exact_solution import Fractions
from contactqp.oracle.exact.rational_answer import PROVEN, Asked, symmetrised
from contactqp.oracle.exact.refinement import Fixed, FixedMatrix, Integers, Refined, fixed, refine

# Digits of the approximation, and what of them is taken to be right.
DIGITS, RIGHT = 80, 72
# Rational numbers guessed from an approximation far beyond doubles, and proven in integers.
#
# Numbers with small denominators are the only ones of their kind near enough to be told by continued fractions; a
# common denominator of what came before makes the next ones smaller. How they were found proves nothing and need not:
# every statement of the problem is checked in integers, without any rounding. The last step of exact linear and
# quadratic programming: Gleixner, Steffy and Wolter (2016), INFORMS Journal on Computing 28, 449.

# Two numbers of this denominator are further apart than the digits that are taken to be right.
LARGEST_DENOMINATOR = 2**110


@dataclass(frozen=True, eq=False)
class Column:
    """The numbers `integers` / `denominator`."""

    integers: Integers
    denominator: int

    def times(self, rows: Any, less: Any) -> Column:
        """rows x - less, both of them floats."""
        product = FixedMatrix(sp.csr_matrix(rows)) @ Fixed(self.integers, 0)
        found = product - _times(fixed(less), self.denominator)
        return Column(found.integers << max(-found.bits, 0), self.denominator << max(found.bits, 0))

    def fractions(self) -> Fractions:
        array = np.empty(len(self.integers), dtype=object)
        array[:] = [Fraction(x, self.denominator) for x in self.integers.tolist()]
        return array


@dataclass(frozen=True, eq=False)
class Reconstructed:
    """An answer that is proven, with the signs of `contactqp.Solution`."""

    displacement: Column  # (n,)
    normal_force: Column  # (m,)
    tie_force: Column  # (k,)


def reconstruct(refined: Refined) -> Reconstructed | None:
    """Return the exact answer near an approximation, proven; None where no small numbers are one."""
    u = guessed(refined.displacement)
    push, tie = guessed(refined.normal_force), guessed(refined.tie_force)
    if u is None or push is None or tie is None:
        return None
    answer = Reconstructed(u, push, tie)
    return answer if solves(refined.problem, answer) else None


def guessed(values: Fixed) -> Column | None:
    """Return numbers of one small denominator, the nearest that are near enough; None where there are none.

    >>> third = Fixed(np.array([2**400 // 3, 5 * 2**399], dtype=object), 400)
    >>> [str(x) for x in guessed(third).fractions()]
    ['1/3', '5/2']
    """
    exact = values.fractions().tolist()
    off = Fraction(max((abs(x) for x in exact), default=Fraction(0))) / 10**RIGHT
    common = 1
    for x in exact:
        near = simplest(x * common - off * common, x * common + off * common)
        common *= near.denominator
        if common > LARGEST_DENOMINATOR:
            return None
    integers = np.empty(len(exact), dtype=object)
    integers[:] = [round(x * common) for x in exact]
    return Column(integers, common)


def simplest(low: Fraction, high: Fraction) -> Fraction:
    """Return the fraction of least denominator in [low, high], by continued fractions.

    >>> simplest(Fraction(3141, 1000), Fraction(3142, 1000)), simplest(Fraction(-1, 3), Fraction(1, 9))
    (Fraction(245, 78), Fraction(0, 1))
    """
    if low <= 0 <= high:
        return Fraction(0)
    if high < 0:
        return -simplest(-high, -low)
    terms = []
    while True:
        whole = math.ceil(low)
        if whole <= high:
            terms.append(whole)
            break
        whole -= 1
        terms.append(whole)
        low, high = 1 / (high - whole), 1 / (low - whole)
    found = Fraction(terms.pop())
    while terms:
        found = terms.pop() + 1 / found
    return found


def solves(problem: ContactProblem, answer: Reconstructed) -> bool:
    """Equilibrium, ties, gaps, forces and complementarity of a frictionless problem of floats, in integers."""
    u, push, tie = answer.displacement, answer.normal_force, answer.tie_force
    K = FixedMatrix(sp.csr_matrix(problem.stiffness))
    Et, At = (FixedMatrix(sp.csr_matrix(sp.csr_matrix(x).T)) for x in (problem.normal, problem.tie))
    # All three denominators are multiplied out.
    left = [_times(fixed(problem.load), u.denominator * push.denominator * tie.denominator)]
    left += [_times(K @ Fixed(u.integers, 0), -push.denominator * tie.denominator)]
    left += [_times(Et @ Fixed(push.integers, 0), -u.denominator * tie.denominator)]
    left += [_times(At @ Fixed(tie.integers, 0), -u.denominator * push.denominator)]
    overlap, tied = u.times(problem.normal, problem.gap), u.times(problem.tie, problem.tie_value)
    return (
        not any(_sum(left).integers)
        and not any(tied.integers)
        and all(x <= 0 for x in overlap.integers)
        and all(x >= 0 for x in push.integers)
        and not any(x and y for x, y in zip(overlap.integers, push.integers, strict=True))
    )


def _times(values: Fixed, factor: int) -> Fixed:
    return Fixed(values.integers * factor, values.bits)


def _sum(parts: Iterable[Fixed]) -> Fixed:
    total, *others = parts
    for part in others:
        total = total + part
    return total


ONLY = "the rows of all contacts without gap are independent: these are the only forces that hold this displacement"


def prove_by_reconstruction(asked: Asked, first: Solution) -> ExactSolution | None:
    """Rational numbers with small denominators, proven; None where there are none, or others beside them."""
    problem = asked.problem
    try:
        found = reconstruct(refine(problem, asked.method, DIGITS, first=first, **asked.options))
        if found is None:
            return None
        gap = -found.displacement.times(problem.normal, problem.gap).fractions()
        regular(problem, np.flatnonzero(gap == 0), first)
        convex = is_convex(problem)
        if not convex:
            regular(problem, np.flatnonzero(found.normal_force.fractions() > 0), first)
    except (NotCertified, NotConverged):
        return None
    return _answer(asked, found, gap, convex)


def _answer(asked: Asked, found: Reconstructed, gap: Fractions, convex: bool) -> ExactSolution:
    problem = asked.problem
    u, push = found.displacement.fractions(), found.normal_force.fractions()
    ranges = np.empty((problem.contacts, 2), dtype=object)
    ranges[:, 0], ranges[:, 1] = push, push
    none, slip = None, None
    if problem.tangent is not None and problem.slip_origin is not None:
        shape = problem.slip_origin.shape
        slip = found.displacement.times(problem.tangent, problem.slip_origin).fractions().reshape(shape)
        none = np.full(shape, Fraction(0), dtype=object)
    load = fixed(problem.load).fractions()
    # u'(K u - f) - f'u
    twice = found.displacement.times(problem.stiffness, problem.load).fractions() - load
    return ExactSolution(
        problem=problem,
        displacement=u,
        normal_force=push,
        friction_force=none,
        tie_force=found.tie_force.fractions(),
        gap=gap,
        slip=slip,
        contact_status=tuple(_status(x, force) for x, force in zip(gap, push, strict=True)),
        rational=True,
        radius=None,
        unique_forces=True,
        force_range=ranges,
        free_motions=(),
        energy=sum((x * y for x, y in zip(u, twice, strict=True)), Fraction(0)) / 2,
        equilibria=None,
        uniqueness=(),
        events=(),
        data=asked.source,
        way="iterative refinement, and the fractions nearest to it",
        proof=(*PROVEN, ONLY, MINIMUM if convex else LOCAL),
        notes=symmetrised(problem) + (() if convex else (FLOATS_THAT_FLOAT,)),
        method=asked.method,
        seconds=time.perf_counter() - asked.started,
    )


def _status(gap: Fraction, force: Fraction) -> str:
    return "closed" if force else "open" if gap else "grazing"


# What an exact answer is asked of on the command line: a case file, or a problem of another code.


def read_case(path: str) -> Any:
    """Return a Scene of a TOML file or standard input; whatever `contactqp.read_problem` reads of anything else."""
    is_case = path == STANDARD_INPUT or case_path(path).suffix.lower() == ".toml"
    return load_scene(path) if is_case else read_problem(path)


def tie_names(case: Any, ties: int) -> tuple[str, ...]:
    """Return the names of the ties of a scene or a problem, or their numbers."""
    named = tuple(str(tie.name) for tie in case.ties) if isinstance(case, Scene) else getattr(case, "tie_names", None)
    return named if named and len(named) == ties else tuple(f"tie {i}" for i in range(ties))


FLOATS = "the problem's floats as they stand"
CASE = "the case's own numbers"
BODY = "the floats of the assembled bodies as they stand"
# Unknowns, contacts and ties whose rational numbers take a second, and some ten seconds.
RATIONAL, RATIONAL_AT_LAST, RATIONAL_WITH_FRICTION = 300, 700, 500
# Whatever is asked for: matrices of rational numbers are dense.
MOST_OF_A_CASE = 1500


@checked
@own_floating_point
def exact(problem: Any, method: str = "active-set", *, enclose: bool | None = None, **options: Any) -> ExactSolution:
    """Return the exact answer to a contact problem.

    A floating-point method proposes which contacts are closed (and which of them stick and slip); the linear system of
    that proposal is solved in rational numbers, and every statement of the problem is checked in them, with no
    tolerance. What does not hold corrects the proposal; at last Lemke's method in rational numbers finds the answer or
    proves that there is none.

    Larger problems, and scenes whose lengths are irrational, are enclosed: every number is an interval mid +- radius
    that is proven to hold the exact one (`contactqp.oracle.exact.enclosed_answer`,
    `contactqp.oracle.exact.enclosed_scene`). Bodies that float freely are then held where floats rest them; a note says
    where, and what the holding carries.

    Parameters
    ----------
    problem : ContactProblem or Scene
        A problem's floats are taken as they stand, the stiffness as it was symmetrised. The numbers of a scene of nodes
        are read exactly: 1 mm is 1/1000 m, and 0.1 is 1/10. A scene's answer is the one under its full load; with
        friction and a load path, the one at the end of the path. Of a scene with elastic bodies the floats of the
        assembled problem are taken as they stand.
    method : str
        A name of `contactqp.methods()`: what proposes.
    enclose : bool, optional
        Of a problem's floats, whether to enclose or to compute in rational numbers; by default rational numbers up to
        300 unknowns and contacts. What just touches an enclosure cannot decide: then fractions of small denominators
        are looked for and proven (`contactqp.oracle.exact.exact`), at last in rational numbers up to
        700.
    **options
        Of `contactqp.solve`.

    Raises
    ------
    NoEquilibrium
        Proven: the constraints conflict, or the load drives a motion that nothing holds.
    SeveralEquilibria
        On a load path with friction, several ways to go on.
    NotCertified, NotConverged
        Nothing could be proven.
    Unsupported
        Motions and large deformations, friction on paths of bodies or with irrational numbers, irrational slip
        directions; a stiffness that rounding has made indefinite, or that was printed and is singular to rounding only.
    BackendMissing
        python-flint is not installed.

    Examples
    --------
    A bar of 1575 kN/m, pulled with 300 kN towards a wall 1/8 m away.

    >>> import contactqp as cq
    >>> bar = cq.ContactProblem(stiffness=[[1575.0]], load=[300.0], normal=[[1.0]], gap=[0.125])
    >>> answer = cq.exact(bar)
    >>> answer.normal_force[0], answer.doubles.normal_force[0].item(), answer.unique_forces
    (Fraction(825, 8), 103.125, True)

    Two stops at one place: the least of the forces that hold, and how far each can range.

    >>> stops = cq.ContactProblem(stiffness=[[2.0]], load=[3.0], normal=[[1.0], [1.0]], gap=[0.5, 0.5])
    >>> answer = cq.exact(stops)
    >>> [str(force) for force in answer.normal_force], [str(end) for end in answer.force_range[0]]
    (['1', '1'], ['0', '2'])
    """
    started = time.perf_counter()
    importlib.import_module("contactqp.linalg.rational")  # which says so where python-flint is missing
    if isinstance(problem, ContactProblem):
        if problem.rigid_change > 0:
            raise Unsupported(
                "exact: the stiffness was printed, and its rigid motions cost no energy to rounding only, which "
                "rational numbers take for springs; state it in numbers that are exact, or as a scene"
            )
        return _of_floats(_asked(problem, FLOATS, method, options, started), enclose)
    if isinstance(problem, LocalProblem):
        raise Unsupported("exact: a local problem of velocities and forces; give the problem with its stiffness")
    from contactqp.scene.scene import Scene

    if not isinstance(problem, Scene):
        raise InvalidProblem(f"exact: expected a ContactProblem or a Scene, got {type(problem).__name__}")
    return _of_scene(problem, method, enclose, options, started)


def _asked(problem: ContactProblem, source: str, method: str, options: dict[str, Any], started: float) -> Asked:
    from contactqp.oracle.exact.rational_answer import Asked

    return Asked(problem, source, method, options, started)


def _of_floats(asked: Asked, enclose: bool | None) -> ExactSolution:
    from contactqp.oracle.exact.enclosed_answer import prove_by_enclosure
    from contactqp.oracle.exact.rational_answer import Indefinite, prove
    from contactqp.oracle.exact.rational_problem import of_floats

    size = asked.problem.dimension + asked.problem.contacts + asked.problem.ties
    small = size <= (RATIONAL_WITH_FRICTION if asked.problem.frictional else RATIONAL)
    enclosed_first = enclose or (enclose is None and not small)
    if enclosed_first:
        try:
            return prove_by_enclosure(asked)
        except (NotCertified, NotConverged) as error:
            if not enclose and (found := _reconstructed(asked, error)) is not None:
                return found
            if enclose or size > RATIONAL_AT_LAST:
                raise
    if size > MOST_OF_A_CASE:
        raise Unsupported(
            f"exact: {size} unknowns, contacts and ties, too many for rational numbers (at most {MOST_OF_A_CASE}); "
            "enclose=True encloses them"
        )
    try:
        return prove(of_floats(asked.problem), asked)
    except Indefinite as indefinite:
        if enclosed_first or enclose is not None:
            raise
        try:  # as a strict local minimum
            return prove_by_enclosure(asked)
        except (NoEquilibrium, NotCertified, NotConverged):
            raise indefinite from None


def _reconstructed(asked: Asked, error: NotCertified | NotConverged) -> ExactSolution | None:
    first = error.solution
    if not isinstance(error, NotCertified) or not isinstance(first, Solution) or first.free_motions:
        return None
    return prove_by_reconstruction(asked, first)


def _of_scene(
    scene: Scene, method: str, enclose: bool | None, options: dict[str, Any], started: float
) -> ExactSolution:
    for there, what in ((scene.large, "large deformations"), (scene.motion is not None, "a motion")):
        if there:
            raise Unsupported(f"exact: {what}: the answer is no solution of one linear system")
    from contactqp.scene.building import build
    from contactqp.scene.schema import end_time

    model = build(scene)
    walked = scene.path is not None and model.problem.frictional
    if scene.meshed:
        if walked:
            raise Unsupported("exact: friction on a load path of bodies, whose answer depends on the way")
        at_end = model.problem
        if scene.path is not None:
            at_end = at_end.replace(load=model.load_at(end_time(scene)))
        return _of_floats(_asked(at_end, BODY, method, options, started), enclose)
    from contactqp.oracle.exact.rational_answer import prove, prove_path
    from contactqp.oracle.exact.rational_problem import of_scene
    from contactqp.scene.building import NodeModel as Nodes

    assert isinstance(model, Nodes)  # a scene without meshes is one of nodes
    if model.problem.dimension > MOST_OF_A_CASE:
        raise Unsupported(
            f"exact: a case of {model.problem.dimension} unknowns, too many for rational numbers (at most "
            f"{MOST_OF_A_CASE}); its problem of floats can be enclosed"
        )
    asked = _asked(model.problem, CASE, method, options, started)
    if not model.exact.rational:
        if walked:
            raise Unsupported("exact: friction on a load path with irrational numbers, whose answer depends on the way")
        from contactqp.oracle.exact.enclosed_scene import enclose_scene

        return enclose_scene(scene, asked)
    data = of_scene(model.exact)
    if walked:
        return prove_path(data, _corners(model), asked)
    return prove(data, asked)


def _corners(model: NodeModel) -> list[Any]:
    """Return the exact loads (n, 1) of the path's corners on the free unknowns."""
    from contactqp.linalg.rational import column
    from contactqp.scene.schema import end_time

    free = model.exact.unknowns.free
    loads = [model.exact_load_at(Fraction(i + 1)) for i in range(int(end_time(model.scene)))]
    return [column([load.get(name, Fraction(0)) for name in free]) for load in loads]
