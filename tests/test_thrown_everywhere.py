"""Numbers of any size at every public function, method and property: only errors of this package leave, and no warning.

`tests.test_thrown` composes problems of such numbers. Here they stand in the place of the numbers that each call of
`tests.wild_calls` has, which a test there holds against all public names, and solutions of composed problems are asked
for derivatives, gradients and load cases.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import contactqp as cq
from tests import test_thrown, wild_calls
from tests.test_thrown import MANY, Draw, arrays, ask_everything, number
from tests.test_wild_arguments import ASSERTIONS, NAMES

# Options that say how much work there is.
KEPT = ("steps", "divisions", "count", "duration", "time_step", "unknowns", "time_limit", "held", "bars", "facets")


@pytest.fixture(scope="module")
def calls(tmp_path_factory: pytest.TempPathFactory) -> dict[str, wild_calls.Call]:
    return wild_calls.calls(tmp_path_factory.mktemp("numbers"))


def numbers_like(draw: Draw, value: Any) -> Any:
    """Return a value with other numbers in the same places; whole numbers and words stay, they name things."""
    if isinstance(value, bool | int | str | Path) or value is None:
        return value
    if isinstance(value, float):
        return draw(number)
    if isinstance(value, Mapping):
        return {name: numbers_like(draw, one) for name, one in value.items()}
    if isinstance(value, cq.ContactProblem):
        return value.replace(load=arrays(draw, value.dimension), gap=arrays(draw, value.contacts))
    if isinstance(value, list | tuple | np.ndarray | sp.sparray):
        try:
            found = value.toarray() if isinstance(value, sp.sparray) else np.asarray(value)
        except ValueError:
            return value
        return arrays(draw, *found.shape) if found.dtype.kind == "f" else value
    return value


def only_our_errors_leave(call: Callable[[], Any]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", cq.StartWarning)
        warnings.simplefilter("ignore", cq.TimeStepWarning)
        try:
            answer = call()
            if not isinstance(answer, cq.Scene):  # pydantic's own properties warn
                ask_everything(answer)
        except cq.ContactQPError as error:
            ask_everything(getattr(error, "solution", None))


def throw_numbers(draw: Draw, call: wild_calls.Call) -> None:
    changed = {one for one in call.arguments if one not in KEPT and draw(st.booleans())}

    def again() -> Any:
        given = {one: numbers_like(draw, value) if one in changed else value for one, value in call.arguments.items()}
        return call.function(**given)

    try:
        only_our_errors_leave(again)
    except AssertionError:
        if call.function.__module__ != ASSERTIONS:  # what `testing` says of a wrong answer
            raise


@pytest.mark.sampled(32)
@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=5, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_numbers_of_any_size_are_taken_or_refused(
    name: str, calls: dict[str, wild_calls.Call], data: st.DataObject
) -> None:
    throw_numbers(data.draw, calls[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=MANY, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_numbers_of_any_size_are_taken_or_refused_many_times(
    name: str, calls: dict[str, wild_calls.Call], data: st.DataObject
) -> None:
    throw_numbers(data.draw, calls[name])


OF = ("displacement", "normal_force", "friction_force", "tie_force", "gap", "slip", "energy", "reaction")
PARAMETERS = ("load", "gap", "tie_value", "friction", "slip_origin", "stiffness", "rows")


def shaped(draw: Draw, problem: cq.ContactProblem, parameter: str) -> Any:
    """Return a direction of a parameter, of any numbers."""
    n, m = problem.dimension, problem.contacts
    shapes = {"load": (n,), "gap": (m,), "tie_value": (problem.ties,), "friction": (m,), "stiffness": (n, n)}
    if parameter == "slip_origin":
        return arrays(draw, *(problem.slip_origin.shape if problem.slip_origin is not None else (m, 1)))
    found = arrays(draw, *shapes.get(parameter, (m, n)))
    with np.errstate(all="ignore"):
        return found + found.T if parameter == "stiffness" else found


def derived(draw: Draw) -> Callable[[], Any]:
    """A derivative, a matrix of them or a gradient of the solution to a composed problem, or of its exact one."""
    problem, of, parameter = test_thrown.problem(draw), draw(st.sampled_from(OF)), draw(st.sampled_from(PARAMETERS))
    direction, kind = shaped(draw, problem, parameter), draw(st.sampled_from(["derivative", "jacobian", "pullback"]))
    sizes = {"displacement": problem.dimension, "reaction": problem.dimension, "energy": 1, "tie_force": problem.ties}
    weights = arrays(draw, sizes.get(of, problem.contacts))
    exactly = draw(st.integers(0, 4)) == 0

    def ask() -> Any:
        if exactly:
            return cq.exact(problem).derivative(of, with_respect_to=parameter, direction=direction)
        solution = cq.solve(problem)
        if kind == "derivative":
            return solution.derivative(of, with_respect_to=parameter, direction=direction)
        if kind == "jacobian":
            return solution.jacobian(of, with_respect_to=parameter)
        return solution.pullback(of, weights, with_respect_to=parameter)

    return ask


def solved_many(draw: Draw) -> Callable[[], Any]:
    problem, cases = test_thrown.problem(draw), draw(st.integers(0, 3))
    given: dict[str, Any] = {}
    if draw(st.booleans()):
        given["loads"] = arrays(draw, cases, problem.dimension)
    if draw(st.booleans()):
        given["gaps"] = arrays(draw, cases, problem.contacts)
    if draw(st.booleans()):
        given["friction"] = draw(number)

    def ask() -> Any:
        found = cq.solve_many(problem, **given)
        return [*found], found.envelope() if len(found) else None

    return ask


def replaced(draw: Draw) -> Callable[[], Any]:
    problem = test_thrown.problem(draw)
    other = {
        name: value for name, value in test_thrown.problem_arguments(draw).items() if draw(st.booleans())
    }  # of other shapes, too
    return lambda: cq.solve(problem.replace(**other))


def of_a_program(draw: Draw) -> Callable[[], Any]:
    n = draw(st.integers(1, 3))
    P, q, rows = test_thrown.stiffness(draw, n), arrays(draw, n), draw(st.integers(0, 2))
    bounds = {name: arrays(draw, n) for name in ("lb", "ub") if draw(st.booleans())}
    between = {"C": arrays(draw, rows, n), "l": arrays(draw, rows), "u": arrays(draw, rows)}
    G, h, A, b = arrays(draw, rows, n), arrays(draw, rows), arrays(draw, 1, n), arrays(draw, 1)

    def ask() -> Any:
        problem = cq.ContactProblem.from_qp(P, q, G, h, A, b, **bounds, **between)
        return cq.solve(problem), problem.to_qp()

    return ask


def drawn(draw: Draw) -> Callable[[], Any]:
    problem = test_thrown.problem(draw)
    return lambda: cq.draw(cq.solve(problem))


COMPOSED: dict[str, Callable[[Draw], Callable[[], Any]]] = {
    "derivative": derived, "solve_many": solved_many, "replace": replaced, "from_qp": of_a_program, "draw": drawn,
}  # fmt: skip


@pytest.mark.sampled(5)
@pytest.mark.parametrize("name", COMPOSED)
@settings(max_examples=8, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_answers_to_composed_problems_are_asked(name: str, data: st.DataObject) -> None:
    only_our_errors_leave(lambda: COMPOSED[name](data.draw)())


@pytest.mark.slow
@pytest.mark.parametrize("name", COMPOSED)
@settings(max_examples=4 * MANY, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_answers_to_composed_problems_are_asked_many_times(name: str, data: st.DataObject) -> None:
    only_our_errors_leave(lambda: COMPOSED[name](data.draw)())


@pytest.mark.slow
@pytest.mark.parametrize("format_", ["folder", "hdf5"])
def test_problems_of_any_numbers_are_written_and_read_again(tmp_path: Path, format_: str) -> None:
    function = cq.write_fclib if format_ == "hdf5" else cq.write_problem
    if format_ == "hdf5":
        pytest.importorskip("h5py")

    @settings(max_examples=20, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
    @given(data=st.data())
    def written(data: st.DataObject) -> None:
        only_our_errors_leave(lambda: test_thrown.written(data.draw, tmp_path, function)())

    written()
