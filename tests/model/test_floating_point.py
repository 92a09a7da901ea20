"""What NumPy does on overflow and underflow is the caller's to say, and changes nothing here."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp

import contactqp as cq
from contactqp.linalg.delassus import velocity_of
from contactqp.model.arrays import own_floating_point
from tests.blocks_in_space import on_paraboloid
from tests.examples import truss
from tests.public_objects import solid

# Functions that read, write, and draw.
NOT_COMPUTING = {
    "box",
    "draw",
    "draw_history",
    "load_scene",
    "methods",
    "read_fclib",
    "read_fclib_guesses",
    "read_fclib_solution",
    "read_mesh",
    "read_problem",
    "read_siconos",
    "rectangle",
    "write_fclib",
    "write_problem",
}


def rubbing() -> cq.ContactProblem:
    return cq.ContactProblem(
        sp.csr_array([[2.0, -1.0], [-1.0, 2.0]]), [1.0, 3.0], [[0.0, 1.0]], [0.1], [[1.0, 0.0]], friction=0.3
    )


def bedded() -> cq.ContactProblem:
    """Displacements decay by 300 at every unknown, from the first on past the smallest double."""
    K = sp.diags([np.full(400, 3.0), np.full(399, -1e-2), np.full(399, -1e-2)], [0, 1, -1]).tocsc()
    return cq.ContactProblem(K, np.r_[1.0, np.zeros(399)], sp.csr_array(np.eye(400)), np.full(400, 0.1))


def scaled(problem: cq.ContactProblem, factor: float) -> cq.ContactProblem:
    return problem.replace(load=factor * problem.load, gap=factor * problem.gap)


FAMILY: dict[str, Callable[[], cq.ContactProblem]] = {
    "truss": truss,
    "rubbing": rubbing,
    "tiny": lambda: scaled(truss(), 1e-305),
    "huge": lambda: scaled(truss(), 1e200),
    "rubbing, tiny": lambda: scaled(rubbing(), 1e-305),
    "nothing": lambda: scaled(truss(), 0.0),
    "far": lambda: truss(gap=[1e300]),
    "never": lambda: truss(gap=[np.inf]),
    "floating": lambda: cq.ContactProblem([[1.0, -1.0], [-1.0, 1.0]], [1.0, 0.0], [[0.0, 1.0]], [0.5]),
    "rigid": lambda: cq.ContactProblem([[0.0]], [1.0], [[1.0]], [0.5]),
    "contrast": lambda: cq.ContactProblem(np.diag([1e-100, 1e100]), [1e-100, 1e50], np.eye(2), [1e-3, 1e-60]),
    "tied": lambda: cq.ContactProblem(np.diag([2.0, 3.0]), [1.0, 4.0], [[1.0, 0.0]], [0.1], tie=[[1.0, -1.0]]),
    "bedded": bedded,
    "in space": lambda: on_paraboloid((4, 4, 3)),
}


@contextmanager
def strict() -> Iterator[None]:
    with np.errstate(all="raise"), warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def looked_at(thing: Any, depth: int = 2) -> None:
    """Ask for all that an answer of the package has to say."""
    str(thing)
    for name in [name for name in dir(thing) if not name.startswith("_")]:
        value = getattr(thing, name)
        if depth and type(value).__module__.startswith("contactqp") and not callable(value):
            looked_at(value, depth - 1)


def outcome(function: Callable[[], Any]) -> Any:
    try:
        return function()
    except cq.ContactQPError as error:
        return error


@pytest.mark.sampled(14)
@pytest.mark.parametrize("name", FAMILY)
def test_no_method_and_no_certificate_lets_an_error_of_floating_point_out(name: str) -> None:
    problem, compared = FAMILY[name](), list[str]()
    values = {"penalty": dict(penalty=1e6), "perturbed-lagrangian": dict(perturbation=1e-6)}
    for method in cq.methods():
        if not method.installed or (problem.dimension > 10 and method.name not in ("active-set", "clarabel")):
            continue

        def solved(method: Any = method) -> Any:
            return cq.solve(problem, method.name, **values.get(method.name, {}))

        expected = outcome(solved)
        with strict():
            found = outcome(solved)
            compared.append(method.name)
            assert type(found) is type(expected)
            if not isinstance(found, cq.Solution):
                continue
            looked_at(found)
            forces = (found.normal_force, found.friction_force, found.tie_force)
            cq.certify(problem, found.displacement, *forces)
        if method.name == "active-set":
            assert np.array_equal(found.normal_force, expected.normal_force)
    assert "active-set" in compared


@pytest.mark.sampled(28)
@pytest.mark.parametrize("size", [1e-300, 1.0, 1e250])
@pytest.mark.parametrize("name", FAMILY)
def test_wrong_answers_are_explained_as_usual(name: str, size: float) -> None:
    problem = FAMILY[name]()
    friction = None if problem.slip_origin is None else np.full(problem.slip_origin.shape, size)
    parts = (np.full(problem.dimension, size), np.full(problem.contacts, -size), friction, np.full(problem.ties, size))
    with strict():
        judged = cq.certify(problem, *parts)
        looked_at(judged)
        judged.table()
    assert judged.failures == cq.certify(problem, *parts).failures


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::contactqp.errors.TimeStepWarning")
@pytest.mark.parametrize("name", [name for name in FAMILY if name not in ("bedded", "in space")])
def test_paths_motions_and_what_is_known_of_a_problem(name: str) -> None:
    problem = FAMILY[name]()
    n, load = problem.dimension, problem.load
    work: list[Callable[[], Any]] = [
        lambda: cq.follow_path(problem, [load, 0 * load], steps=3),
        lambda: cq.follow_path(problem, [load, 0 * load], events="exact"),
        lambda: cq.exact(problem),
        lambda: cq.exact_equilibria(problem),
        lambda: cq.equilibria(problem),
        lambda: cq.critical_friction(problem),
        lambda: cq.existence_margin(problem),
        lambda: cq.associated_difference(problem),
        lambda: cq.local_form_of(problem),
        lambda: cq.compare(problem, methods=["active-set", "clarabel"]),
        *(
            lambda scheme=scheme: cq.impact(problem, np.ones(n), np.zeros(n), np.zeros(n), 0.02, 0.005, scheme)
            for scheme in ("moreau-jean", "newmark", "modified-mass-central", "deuflhard-krause-ertel")
        ),
    ]
    with strict():
        warnings.simplefilter("ignore", cq.TimeStepWarning)
        for each in work:
            found = outcome(each)
            outcome(lambda found=found: looked_at(found))
            if isinstance(found, cq.History):
                outcome(lambda found=found: [looked_at(one) for one in found])


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("compliance", "size"), [(1.0, 1.0), (1e-150, 1.0), (1e150, 1e100), (1.0, 1e-300)])
def test_local_problems(compliance: float, size: float) -> None:
    W, q = np.diag([2.0, 1.0, 1.0, 3.0, 1.0, 1.0]) * compliance, np.array([-3.0, 0.5, 0.1, -1.0, 0.0, 0.0]) * size
    with strict():
        problem = cq.LocalProblem(W, q, 0.4, 3)
        looked_at(problem)
        for algorithm in (None, "newton", "nsgs", "ppa", "admm", "tresca", "aclm"):
            looked_at(outcome(lambda algorithm=algorithm: cq.solve(problem, algorithm=algorithm)))
        for force in (np.full(6, 1e-200), np.full(6, 1e200)):
            looked_at(cq.certify_local(problem, force))
            for error in (cq.acary_bremond_huber_error, cq.fclib_merit_1, cq.siconos_local_error):
                outcome(lambda error=error, force=force: error(problem, force))


def shapes(size: float) -> dict[str, Callable[[], Any]]:
    """What bodies, obstacles and pairings compute at coordinates of a size, call by call."""
    points, edge, u = np.full((1, 2), size), np.array([[0.0, 0.0], [size, 0.0]]), size * np.linspace(-1.0, 1.0, 8)
    nodes, bars = np.array([[-size, 0.0], [0.0, size / 5], [size, 0.0]]), [[0, 1], [1, 2]]
    round_ones: tuple[Any, ...] = (cq.Circle([0.0, 0.0], 1.0), cq.Paraboloid([0.0, 0.0], [0.0, 1.0], 1.0))

    def truss() -> cq.NonlinearTruss:
        return cq.NonlinearTruss(nodes, bars, modulus=100.0, area=1.0)

    def pressed() -> Any:
        surface = cq.Surface(edge, np.array([[0, 1]]), np.arange(4).reshape(2, 2))
        return cq.pair(surface, cq.Plane([0.0, -1.0], [0.0, 1.0])).pressure([1e-300, 1e300])

    def least() -> Any:
        cable = cq.Cable("cable", {"w": 1.0}, 8.0, slack=0.1 * size)
        return looked_at(cq.ConstrainedEnergy(["w"], [[2.0]], [3.0 * size], parts=[cable]).solve())

    return {
        "truss": lambda: truss().tangent(u[:6]),
        "updated truss": lambda: cq.UpdatedTruss(truss()).internal_force(u[:6]),
        "supported": lambda: cq.Supported(truss(), held=[0, 1, 4, 5]).support_forces(u[:2]),
        "solid": lambda: solid().internal_force(u),
        "pressure": pressed,
        "energy": least,
        "contact": lambda: cq.ObstacleContact([[0.0, 2.0]], round_ones[0]).state(u[:2]),
        **{f"gap of {type(one).__name__}": lambda one=one: one.distance(points) for one in round_ones},
        **{f"normal of {type(one).__name__}": lambda one=one: one.normals(points) for one in round_ones},
        "velocity": lambda: velocity_of(cq.LocalProblem(np.eye(2), [0.0, 0.0], 0.3, 2), np.full((1, 2), size)),
    }


@pytest.mark.sampled(4)
@pytest.mark.parametrize("size", [1e-320, 1e-160, 1.0, 1e160, 1e300])
@pytest.mark.parametrize("name", shapes(1.0))
def test_what_bodies_and_obstacles_compute_too(name: str, size: float) -> None:
    work = shapes(size)[name]
    with strict():
        outcome(work)


def test_the_callers_settings_stay_as_they_are() -> None:
    with np.errstate(all="raise"):
        before = np.geterr()
        cq.solve(scaled(truss(), 1e-2))
        assert np.geterr() == before
        with pytest.raises(FloatingPointError):
            np.float64(1e-300) * np.float64(1e-300)


def test_without_settings_of_its_own_a_solve_would_end_in_somebody_elses_error() -> None:
    """What the other tests find nothing of is there."""
    problem = scaled(truss(), 1e-305)
    with strict(), pytest.raises(FloatingPointError):
        inspect.unwrap(type(problem).energy)(problem, [1e-200, 1e-200])


def test_every_public_function_that_computes_has_settings_of_its_own() -> None:
    functions = {name: one for name in cq.__all__ if inspect.isfunction(one := getattr(cq, name))}
    bare = {name for name, function in functions.items() if not has_settings(function)}
    assert bare == NOT_COMPUTING


def has_settings(function: Any) -> bool:
    """Whether `own_floating_point` is among what wraps a function."""
    wrapper = own_floating_point(function).__code__
    while hasattr(function, "__wrapped__") and function.__code__ is not wrapper:
        function = function.__wrapped__
    return function.__code__ is wrapper


@pytest.mark.parametrize("factorise", [np.linalg.svd, scipy.linalg.eigvalsh, np.linalg.eigvals])
def test_matrices_beyond_the_floats_are_numbers_too_far_apart(factorise: Callable[[Any], Any]) -> None:
    matrix = np.array([[np.nan, 0.0], [0.0, 1.0]])
    with pytest.raises(cq.InvalidProblem, match=r"numbers too far apart: .* which other units may bring"):
        own_floating_point(factorise)(matrix)


def test_other_errors_of_linear_algebra_are_not_reworded() -> None:
    with pytest.raises(np.linalg.LinAlgError, match="Singular matrix"):
        own_floating_point(np.linalg.inv)(np.zeros((2, 2)))
