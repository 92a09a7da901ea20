"""Every installed backend of qpsolvers: signs of its duals, tolerances that arrive, failures in our own words."""

from __future__ import annotations

import importlib.util
import subprocess
import sys

import numpy as np
import pytest
import qpsolvers
import scipy.sparse as sp

from contactqp.errors import BackendFailed, Unsupported
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Candidate
from contactqp.solving.methods.backends import BACKENDS, METHODS, Backend, backend_options, solve_quadratic_program
from contactqp.solving.methods.method import Method, Settings
from tests.solving.methods.static_examples import EXAMPLES, FREE, TWO_BARS, Example, require_answer, require_near

INSTALLED = tuple(method for method in METHODS if method.installed)
BACKEND = {backend.name: backend for backend in BACKENDS}
INFEASIBLE = ContactProblem(stiffness=np.eye(2), load=[2.0, -1.0], normal=[[1.0, 0], [-1.0, 0]], gap=[0.5, -0.6])
# In the examples' own numbers (stiffness 1e5, lengths 1e-3), before polish; `solve` hands over nondimensional problems.
RAW = 1e-5

every_backend = pytest.mark.parametrize("method", INSTALLED, ids=lambda method: method.name)


def example(name: str) -> Example:
    return next(example for example in EXAMPLES if example.name == name)


def test_the_usual_backends_are_here() -> None:
    assert {"osqp", "clarabel"} <= {method.name for method in INSTALLED}
    for name, package in (("piqp", "piqp"), ("daqp", "daqp"), ("highs", "highspy"), ("scs", "scs")):
        if importlib.util.find_spec(package):
            assert name in {method.name for method in INSTALLED}


def test_every_row_of_the_table_is_a_method_with_a_command_that_installs_it() -> None:
    assert len(METHODS) == len(BACKENDS) == len({backend.name for backend in BACKENDS})
    for method in METHODS:
        assert method.install.startswith("pip install"), method.name
        assert method.scale, method.name
        assert method.polish, method.name


@pytest.mark.sampled(3)
@every_backend
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.name)
@pytest.mark.parametrize("form", [np.asarray, sp.csc_array], ids=["dense", "sparse"])
def test_signs_and_values(method: Method, example: Example, form: object) -> None:
    if example.name == "floating" and not method.semidefinite:
        pytest.skip("refuses a singular stiffness, and says so in the registry")
    candidate = method.solve(example.problem.replace(stiffness=form(example.problem.stiffness)), Settings())
    assert candidate.claimed, candidate.status
    require_answer(example, candidate, RAW)


@every_backend
def test_two_bars_to_the_tolerance_that_was_asked_for(method: Method) -> None:
    # Nondimensional, as `solve` hands it over: forces in 157.5 kN, lengths in mm.
    unit = TWO_BARS.replace(stiffness=np.diag([1.0, 2.0]), load=[300 / 157.5, 0.0], gap=[1.0])
    candidate = method.solve(unit, Settings(tolerance=1e-9))
    assert 157.5 * candidate.normal_force[0] == pytest.approx(95.0, rel=1e-6)


@every_backend
def test_stiffness_in_columns_is_not_overwritten(method: Method) -> None:
    tied = example("tied and touching")
    columns = np.asfortranarray(tied.problem.stiffness)
    require_answer(tied, method.solve(tied.problem.replace(stiffness=columns), Settings()), RAW)
    assert np.array_equal(columns, np.eye(2))


@every_backend
def test_infeasible_is_not_claimed(method: Method) -> None:
    try:
        candidate = method.solve(INFEASIBLE, Settings())
    except BackendFailed as failed:
        text = str(failed)
        assert text.startswith(f"{method.name}: ")
        assert text.endswith(("nothing was returned", "finite numbers, got [nan nan]"))
        return
    assert not candidate.claimed
    assert candidate.status.startswith(method.name)


@every_backend
def test_a_backend_prints_nothing(method: Method, capfd: pytest.CaptureFixture[str]) -> None:
    method.solve(TWO_BARS, Settings())
    captured = capfd.readouterr()
    assert (captured.out, captured.err) == ("", "")


@pytest.mark.slow
@pytest.mark.parametrize("method", ["highs", "cvxpy"])
def test_the_first_use_of_highs_prints_nothing(method: str) -> None:
    """HiGHS greets once a process, and does not ask whether it may."""
    pytest.importorskip("highspy")
    solver = ", solver='HIGHS'" if method == "cvxpy" else ""
    program = "import contactqp as cq; p = cq.ContactProblem([[2.0]], [3.0], [[1.0]], [1.0]); "
    program += f"assert cq.solve(p, {method!r}{solver}).normal_force[0] > 0.9"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")


@pytest.mark.parametrize("name", ["osqp", "scs", "clarabel", "piqp"])
def test_stopped_early_is_not_claimed(name: str) -> None:
    pytest.importorskip(BACKEND[name].package)
    candidate = solve_quadratic_program(BACKEND[name], TWO_BARS, Settings(tolerance=1e-12, max_iter=1))
    assert not candidate.claimed
    assert candidate.status.startswith(f"{name}: ")


def test_proxqp_does_not_stop_at_a_point_that_is_not_complementary() -> None:
    pytest.importorskip("proxsuite")
    unit = ContactProblem(sp.diags([1.5, 3.15]).tocsc(), [3.0, 0.0], [[1.0, -1.0]], [1.0])
    candidate = solve_quadratic_program(BACKEND["proxqp"], unit, Settings())
    assert candidate.normal_force[0] == pytest.approx(63 / 62, rel=1e-7)
    # This is what the table's settings are for: without them the sparse backend stops 5e-5 short, as solved.
    problem = qpsolvers.Problem(unit.stiffness.copy(), -unit.load, sp.csc_matrix(unit.normal), unit.gap.copy())
    short = qpsolvers.solve_problem(problem, solver="proxqp", eps_abs=1e-9, eps_rel=0.0)
    assert short.found
    assert abs(short.z[0] - 63 / 62) > 1e-6


def settings_of(name: str) -> set[str]:
    """Every setting the backend knows. qpsolvers passes unknown ones of these backends by without a word."""
    if name == "piqp":
        return set(dir(pytest.importorskip("piqp").DenseSolver().settings))
    if name == "qpalm":
        return set(dir(pytest.importorskip("qpalm").Settings()))
    if name == "highs":
        return set(dir(pytest.importorskip("highspy").Highs().getOptions()))
    return set(dir(pytest.importorskip("clarabel").DefaultSettings()))


@pytest.mark.parametrize("name", ["piqp", "qpalm", "highs", "clarabel"])
def test_every_keyword_of_the_table_exists(name: str) -> None:
    backend = BACKEND[name]
    known = settings_of(name)
    assert set(backend_options(backend, Settings(max_iter=7))) <= known
    assert backend.time_limit is None or backend.time_limit in known
    assert "no_such_setting" not in known


def test_tolerance_is_not_tighter_than_the_backend_accepts() -> None:
    options = backend_options(BACKEND["highs"], Settings(tolerance=1e-14))
    assert options["primal_feasibility_tolerance"] == 1e-10
    assert backend_options(BACKEND["osqp"], Settings(tolerance=1e-14))["eps_abs"] == 1e-14


@pytest.mark.parametrize("backend", BACKENDS, ids=lambda backend: backend.name)
def test_a_time_limit_is_passed_on_or_refused(backend: Backend) -> None:
    if backend.time_limit is None:
        with pytest.raises(Unsupported, match="no time limit"):
            backend_options(backend, Settings(time_limit=1.0))
    else:
        assert backend_options(backend, Settings(time_limit=1.0))[backend.time_limit] == 1.0


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", ["osqp", "clarabel", "highs", "scs", "qpalm"])
def test_a_time_limit_is_kept(name: str) -> None:
    pytest.importorskip(BACKEND[name].package)
    random = np.random.default_rng(0)
    factor = random.standard_normal((300, 300))
    problem = ContactProblem(
        factor @ factor.T / 300 + 1e-4 * np.eye(300),
        random.standard_normal(300),
        random.standard_normal((150, 300)),
        random.uniform(0, 0.1, 150),
    )
    try:
        candidate = solve_quadratic_program(BACKEND[name], problem, Settings(time_limit=1e-6))
    except BackendFailed:
        return
    assert not candidate.claimed, candidate.status


def test_highs_ends_by_itself_and_says_by_which_limit() -> None:
    """Where springs lie twelve decades apart its active set came back to the same sets for ever."""
    pytest.importorskip("highspy")
    options = backend_options(BACKEND["highs"], Settings())
    assert options["qp_iteration_limit"] <= 100_000
    assert backend_options(BACKEND["highs"], Settings(max_iter=7))["qp_iteration_limit"] == 7
    chain = 2.0 * np.eye(40) - np.eye(40, k=1) - np.eye(40, k=-1)
    pulled = ContactProblem(chain, np.ones(40), np.eye(40), np.linspace(0.0, 1.0, 40))
    few = solve_quadratic_program(BACKEND["highs"], pulled, Settings(max_iter=1))
    assert not few.claimed
    assert "not solved within 1 iterations: max_iter allows more" in few.status
    assert solve_quadratic_program(BACKEND["highs"], pulled, Settings()).claimed


@every_backend
def test_a_warm_start_is_a_hint(method: Method) -> None:
    start = Candidate(Answer(np.array([1e-3, 2e-4]), np.array([90.0]), None, np.zeros(0)))
    candidate = method.solve(TWO_BARS, Settings(warm_start=start))
    require_answer(example("2.13"), candidate, RAW)


class Panic(BaseException):
    """What a Rust library raises through its Python binding."""


@pytest.mark.parametrize("error", [ValueError("bad"), RuntimeError("bad"), Panic("bad"), qpsolvers.SolverError("bad")])
def test_whatever_a_backend_raises_is_backend_failed(error: BaseException, monkeypatch: pytest.MonkeyPatch) -> None:
    def raising(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(qpsolvers, "solve_problem", raising)
    with pytest.raises(BackendFailed, match=f"osqp: {type(error).__name__}: bad") as caught:
        solve_quadratic_program(BACKEND["osqp"], TWO_BARS, Settings())
    assert caught.value.__cause__ is error


@pytest.mark.parametrize("hidden", [False, True])
def test_an_interrupt_is_no_failure_of_the_backend(hidden: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """qpsolvers raises an error of its own where Ctrl-C is pressed while Clarabel is set up."""

    def interrupted(*_: object, **__: object) -> None:
        pressed = KeyboardInterrupt()
        if hidden:
            raise qpsolvers.ProblemError("Solver failed to build problem") from pressed
        raise pressed

    monkeypatch.setattr(qpsolvers, "solve_problem", interrupted)
    with pytest.raises(KeyboardInterrupt):
        solve_quadratic_program(BACKEND["osqp"], TWO_BARS, Settings())


@pytest.mark.parametrize(
    "wrong",
    [{"x": None}, {"x": np.array([np.nan, 0.0])}, {"x": np.zeros(3)}, {"z": None}, {"z": np.array([np.inf])}],
    ids=["no x", "nan", "shape", "no dual", "infinite dual"],
)
def test_what_is_no_answer_is_backend_failed(wrong: dict[str, object], monkeypatch: pytest.MonkeyPatch) -> None:
    def answering(problem: qpsolvers.Problem, **_: object) -> qpsolvers.Solution:
        solution = qpsolvers.Solution(problem)
        solution.found, solution.x, solution.z, solution.y = True, np.zeros(2), np.zeros(1), np.zeros(0)
        for name, value in wrong.items():
            setattr(solution, name, value)
        return solution

    monkeypatch.setattr(qpsolvers, "solve_problem", answering)
    with pytest.raises(BackendFailed, match="osqp"):
        solve_quadratic_program(BACKEND["osqp"], TWO_BARS, Settings())


def test_warnings_of_a_backend_are_in_its_status() -> None:
    candidate = solve_quadratic_program(BACKEND["osqp"], TWO_BARS, Settings(max_iter=1))
    assert "OSQP exited with status" in candidate.status


def test_unconstrained_problems_stay_with_the_backend() -> None:
    # qpsolvers would hand them to LSQR with its tolerance of 1e-6.
    soft = FREE.replace(stiffness=np.diag([1.0, 1e-4]), load=[1.0, 1e-4])
    candidate = solve_quadratic_program(BACKEND["clarabel"], soft, Settings())
    assert "LSQR" not in candidate.status
    assert candidate.displacement == pytest.approx([1.0, 1.0], rel=1e-6)


@every_backend
def test_iterations_are_counted_or_said_to_be_unknown(method: Method) -> None:
    count = method.solve(TWO_BARS, Settings()).iterations
    assert (count is None) == (not BACKEND[method.name].iterations)
    assert count is None or count > 0


@every_backend
@pytest.mark.parametrize("ties", [1, 2])
def test_ties_without_any_contact(method: Method, ties: int) -> None:
    problem = ContactProblem(
        np.diag([1.0, 2.0, 4.0]),
        [1.0, -1.0, 2.0],
        np.zeros((0, 3)),
        [],
        tie=np.eye(3)[:ties],
        tie_value=[0.5, 0.25][:ties],
    )
    candidate = method.solve(problem, Settings())
    middle = -0.5 if ties == 1 else 0.25
    require_near("displacement", candidate.displacement, [0.5, middle, 0.5], 1e-6)
    require_near("tie force", candidate.tie_force, [0.5, -1.5][:ties], 1e-6)
    assert candidate.normal_force.shape == (0,)
