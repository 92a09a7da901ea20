"""Compute the proven equilibrium in rational numbers or intervals (`exact`)."""

from __future__ import annotations

import importlib
import time
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import InvalidProblem, NoEquilibrium, NotCertified, NotConverged, Unsupported
from contactqp.exchange.problem_files import read_problem
from contactqp.model.arguments import checked
from contactqp.model.arrays import own_floating_point, time_is_up
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution
from contactqp.oracle.exact.exact_solution import ExactSolution
from contactqp.scene.scene import STANDARD_INPUT, Scene, load_scene
from contactqp.scene.shipped import case_path
from contactqp.solving.methods import within_time_of

if TYPE_CHECKING:
    from contactqp.oracle.exact.rational_answer import Asked
    from contactqp.scene.building import NodeModel


# Inputs of the command line: a case file, or a problem of another code.


def read_case(path: str) -> Any:
    """Return the Scene of a TOML file or standard input, else the problem read by `contactqp.read_problem`."""
    is_case = path == STANDARD_INPUT or case_path(path).suffix.lower() == ".toml"
    return load_scene(path) if is_case else read_problem(path)


def tie_names(case: Any, ties: int) -> tuple[str, ...]:
    """Return the names of the ties of a scene or a problem, or their numbers."""
    named = tuple(str(tie.name) for tie in case.ties) if isinstance(case, Scene) else getattr(case, "tie_names", None)
    return named if named and len(named) == ties else tuple(f"tie {i}" for i in range(ties))


FLOATS = "the problem's floats as they stand"
CASE = "the case's own numbers"
BODY = "the floats of the assembled bodies as they stand"
# Numbers of unknowns, contacts and ties that take about one second, and some ten seconds, in rational numbers.
RATIONAL, RATIONAL_AT_LAST, RATIONAL_WITH_FRICTION = 300, 700, 500
# The upper limit in any case, as matrices of rational numbers are dense.
MOST_OF_A_CASE = 1500


@checked
@own_floating_point
def exact(problem: Any, method: str = "active-set", *, enclose: bool | None = None, **options: Any) -> ExactSolution:
    """Return the exact answer to a contact problem.

    A floating-point method proposes the closed contacts (and which of them stick and slip). The linear system of that
    proposal is solved in rational numbers, and all conditions are checked without tolerance. Violated conditions
    correct the proposal; if this fails, Lemke's method in rational numbers finds the answer or proves that there is
    none.

    Larger problems, and scenes whose lengths are irrational, are enclosed: every number is an interval mid +- radius
    proven to contain the exact one (`contactqp.oracle.exact.enclosed_answer`, `contactqp.oracle.exact.enclosed_scene`).
    Floating bodies are then held at their floating-point position; a note has the held unknowns and their forces.

    Parameters
    ----------
    problem : ContactProblem or Scene
        A problem's floats are taken as they stand, the stiffness as it was symmetrised. The numbers of a scene of nodes
        are read exactly: 1 mm is 1/1000 m, and 0.1 is 1/10. The answer to a scene is the one under its full load or,
        with friction and a load path, the one at the end of the path. For a scene with elastic bodies the floats of the
        assembled problem are taken as they stand.
    method : str
        A name of `contactqp.methods()`, which proposes the contact states.
    enclose : bool, optional
        Whether the answer to a problem is enclosed instead of computed in rational numbers; by default problems of up
        to 300 unknowns and contacts are computed in rational numbers. An enclosure cannot decide about contacts that
        just touch: fractions with small denominators are then looked for and proven
        (`contactqp.oracle.exact.reconstructed_answer`), and the last resort are rational numbers, up to 700 unknowns
        and contacts.
    **options
        Options of `contactqp.solve`. `time_limit` [s] is that of the whole call, proof included. One linear system in
        rational numbers is not interrupted, nor is one factorisation of an enclosure: some ten seconds with 700
        unknowns and contacts, or 100 000 unknowns.

    Raises
    ------
    NoEquilibrium
        The constraints provably conflict, or the load drives a motion that nothing resists.
    SeveralEquilibria
        A load path with friction has several continuations.
    NotCertified, NotConverged
        No proof was found, or not within the time limit; `solution` of the error is the answer in floating point, if
        there is one.
    Unsupported
        The scene is a motion or a large deformation; there is friction on a load path of bodies, with irrational
        numbers, or with irrational slip directions; or the stiffness is indefinite by rounding, or was printed and is
        singular only up to rounding.
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
    importlib.import_module("contactqp.linalg.rational")  # raises BackendMissing without python-flint
    if isinstance(problem, ContactProblem):
        if problem.rigid_change > 0:
            raise Unsupported(
                "exact: the stiffness was printed, and its rigid motions cost no energy to rounding only, which "
                "rational numbers take for springs; state it in numbers that are exact, or as a scene"
            )
        with within_time_of(options):
            return _of_any_gaps(problem, FLOATS, method, enclose, options, started)
    if isinstance(problem, LocalProblem):
        raise Unsupported("exact: a local problem of velocities and forces; give the problem with its stiffness")
    from contactqp.scene.scene import Scene

    if not isinstance(problem, Scene):
        raise InvalidProblem(f"exact: expected a ContactProblem or a Scene, got {type(problem).__name__}")
    with within_time_of(options):
        return _of_scene(problem, method, enclose, options, started)


def _asked(problem: ContactProblem, source: str, method: str, options: dict[str, Any], started: float) -> Asked:
    from contactqp.oracle.exact.rational_answer import Asked

    return Asked(problem, source, method, options, started)


def _of_any_gaps(
    problem: ContactProblem, source: str, method: str, enclose: bool | None, options: dict[str, Any], started: float
) -> ExactSolution:
    """Return the answer of a problem's floats; contacts that never press are open rows of zeros in rational numbers.

    They have an infinite gap, or a row of zeros with a gap of 0.
    """
    zero = (abs(problem.normal).sum(axis=1) == 0) & (problem.gap == 0)
    never = np.flatnonzero((problem.gap == np.inf) | zero)
    if not never.size:
        return _of_floats(_asked(problem, source, method, options, started), enclose)
    acts, gap = np.ones(problem.contacts), problem.gap.copy()
    acts[never], gap[never] = 0.0, 1.0
    finite = problem.replace(normal=sp.diags_array(acts) @ problem.normal, gap=gap)
    answer = _of_floats(_asked(finite, source, method, options, started), enclose)
    stated = answer.gap.copy()
    stated[never] = [Fraction(0) if zero[i] else np.inf for i in never]
    return replace(answer, problem=problem, gap=stated)


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
            if enclose or size > RATIONAL_AT_LAST or time_is_up():
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
        try:  # proven as a strict local minimum
            return prove_by_enclosure(asked)
        except (NoEquilibrium, NotCertified, NotConverged):
            raise indefinite from None


def _reconstructed(asked: Asked, error: NotCertified | NotConverged) -> ExactSolution | None:
    from contactqp.oracle.exact.reconstructed_answer import prove_by_reconstruction

    first = error.solution
    if not isinstance(error, NotCertified) or not isinstance(first, Solution) or first.free_motions:
        return None
    return prove_by_reconstruction(asked, first)


def _of_scene(
    scene: Scene, method: str, enclose: bool | None, options: dict[str, Any], started: float
) -> ExactSolution:
    for there, what in ((scene.large, "large deformations"), (scene.motion is not None, "a motion")):
        if there:
            raise Unsupported(f"exact: {what}: the answer is not the solution of one linear system")
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
        return _of_any_gaps(at_end, BODY, method, enclose, options, started)
    from contactqp.oracle.exact.rational_answer import prove, prove_path
    from contactqp.oracle.exact.rational_problem import of_scene
    from contactqp.scene.building import NodeModel as Nodes

    assert isinstance(model, Nodes)  # scenes without meshes consist of nodes
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
    """Return the exact loads (n, 1) on the free unknowns at the corners of the path."""
    from contactqp.linalg.rational import column
    from contactqp.scene.schema import end_time

    free = model.exact.unknowns.free
    loads = [model.exact_load_at(Fraction(i + 1)) for i in range(int(end_time(model.scene)))]
    return [column([load.get(name, Fraction(0)) for name in free]) for load in loads]
