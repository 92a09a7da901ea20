"""`time_limit` is that of the call: of what comes before a method, of each of its steps, and of what polishes."""

from __future__ import annotations

import functools
import os
import signal
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.certificate import certificate, energy_bounds, state_answer
from contactqp.certificate.state_answer import OUT_OF_TIME
from contactqp.errors import BackendFailed
from contactqp.linalg import condensation, dense, factorization, multigrid, nonnegative, pardiso, refinement, schur
from contactqp.linalg.factorization import factorise
from contactqp.linalg.pardiso import SOLVER_VARIABLE
from contactqp.model import arrays
from contactqp.model.solution import Answer
from contactqp.solving import equilibria, local_solving
from contactqp.solving.friction.alart_curnier import newton
from contactqp.solving.friction.algorithms import ALGORITHMS
from contactqp.solving.friction.force_system import ForceSystem
from contactqp.solving.friction.local_form import Iterate, LocalForm
from tests.blocks_in_space import fresh, on_paraboloid
from tests.clocks import Clock
from tests.solving.friction.problems import rough_truss
from tests.solving.friction.space import block, plane_block

CHAIN = sp.diags([-1.0, 3.0, -1.0], [-1, 0, 1], shape=(2 * dense.BLOCK, 2 * dense.BLOCK), format="csr")
NONE, MANY = np.zeros(0, dtype=np.intp), np.arange(dense.BLOCK + 1)
PROBLEMS = {"frictionless": on_paraboloid((5, 5, 3)), "plane": rough_truss(), "space": block([1.0, 0.0])}


@pytest.mark.parametrize("name", PROBLEMS)
def test_no_time_at_all_says_so_and_what_was_not_begun(name: str) -> None:
    words = "stopped at the time limit of 1e-09 s, before the stiffness was condens.*; no displacement had been"
    with pytest.raises(cq.NotConverged, match=words) as caught:
        cq.solve(fresh(PROBLEMS[name]), time_limit=1e-9)
    assert caught.value.solution is None
    assert str(caught.value).count("no displacement") == 1


@pytest.mark.parametrize("name", PROBLEMS)
def test_what_comes_before_the_method_counts(name: str, clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    """Condensing takes longer than the call may: the method never begins."""
    problem, made = fresh(PROBLEMS[name]), condensation.Condensation.__init__

    def slowly(self: Any, *arguments: Any) -> None:
        made(self, *arguments)
        clock.passes(300.0)

    monkeypatch.setattr(condensation.Condensation, "__init__", slowly)
    began = time.process_time()
    with pytest.raises(cq.NotConverged, match=r"time limit of 200"):
        cq.solve(problem, time_limit=200.0)
    assert time.process_time() - began < 1.5


@pytest.mark.sampled(3)
@pytest.mark.parametrize("unit", [1.0, 2.0**-100])
@pytest.mark.parametrize("name", PROBLEMS)
def test_what_was_found_is_certified_however_long_that_takes(
    name: str, unit: float, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The time is up when certificates begin, those in units near one and in the problem's own alike."""
    problem = PROBLEMS[name]
    if unit != 1.0:
        problem = problem.replace(stiffness=problem.stiffness * unit, load=problem.load * unit)
    cq.solve(problem)
    judged = certificate._judge

    def late(*arguments: Any) -> cq.Certificate:
        clock.passes(300.0)
        return judged(*arguments)

    monkeypatch.setattr(certificate, "_judge", late)
    assert cq.solve(problem, time_limit=200.0).certificate.passed


def test_an_earlier_end_stays_within_a_later_one() -> None:
    with arrays.within_time(1e-9), arrays.within_time(60.0), pytest.raises(cq.NotConverged, match="of 1e-09 s"):
        arrays.refuse_late("more")
    with arrays.within_time(1e-9), arrays.in_any_time():
        arrays.refuse_late("more")
    arrays.refuse_late("more")
    assert arrays.seconds_left() is None


def test_a_call_within_another_does_not_say_that_there_is_no_answer() -> None:
    """A path has the steps before, a comparison other methods, a proof the answer in floats."""
    problem = fresh(PROBLEMS["plane"])
    with arrays.within_time(1e-9), pytest.raises(cq.NotConverged, match="time limit") as caught:
        cq.solve(problem, time_limit=60.0)
    assert arrays.NO_ANSWER not in str(caught.value)


NOTHING_BEGUN = {
    "factorised": (lambda: pardiso.Pardiso(CHAIN, NONE), "the stiffness was factorised"),
    "eliminated": (lambda: schur.TrailingBlock(CHAIN, np.array([0])), "the stiffness was factorised"),
    "substituted": (
        lambda: dense.BackSubstitution(CHAIN, np.arange(dense.BLOCK + 1), factorise),
        "the stiffness was condensed",
    ),
    "floating": (
        lambda: factorization._SoftPart(np.arange(8), np.eye(8)),
        "the rigid motions of the stiffness were found",
    ),
    "coarsened": (lambda: multigrid.Hierarchy(CHAIN), "the hierarchy of the stiffness was built"),
}


@pytest.mark.parametrize("what", NOTHING_BEGUN)
def test_no_phase_of_a_factorisation_or_a_hierarchy_begins_late(what: str) -> None:
    make, message = NOTHING_BEGUN[what]
    if (what == "factorised" and not pardiso.available()) or (what == "coarsened" and not multigrid.available()):
        pytest.skip("needs pypardiso or pyamg")
    make()
    with arrays.within_time(1e-9), pytest.raises(cq.NotConverged, match=f"before {message}"):
        make()


def late_at(words: str, clock: Clock, seconds: float) -> Callable[[str], None]:
    """Return what is told of progress and lets this time pass when a stage of these words begins."""

    def told(where: str) -> None:
        if where.startswith(words):
            clock.passes(seconds)

    return told


@pytest.mark.slow
def test_an_answer_of_a_backend_that_was_not_settled_in_time_is_returned_with_its_error(clock: Clock) -> None:
    problem = fresh(on_paraboloid((5, 5, 3)))
    truth = cq.solve(problem, condense=False)
    settle = late_at("sparse systems settle", clock, 1000.0)
    with pytest.raises(cq.NotConverged, match="before another set of closed contacts was solved for") as caught:
        cq.solve(fresh(problem), condense=False, time_limit=1000.0, progress=settle)
    found = caught.value.solution
    error = found.displacement - truth.displacement
    energy = float(np.sqrt(error @ (problem.stiffness @ error)))
    strained = float(np.sqrt(truth.displacement @ (problem.stiffness @ truth.displacement)))
    assert found.certificate.energy_error is not None
    assert 0 < energy / strained <= (1 + 1e-6) * found.certificate.energy_error < 1e-2


def test_bounds_of_an_unfinished_answer_take_as_long_again_at_most(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    settled, problem = energy_bounds.solved_from, fresh(on_paraboloid((3, 3, 2)))
    answer = Answer(np.zeros(problem.dimension), np.zeros(problem.contacts), None, np.zeros(0))

    def slowly(*arguments: Any, **options: Any) -> Any:
        clock.passes(100.0)
        return settled(*arguments, **options)

    with arrays.within_time(60.0), arrays.unfinished(), arrays.in_any_time():
        assert energy_bounds.energy_bounds(problem, answer).energy_error is not None
    monkeypatch.setattr(energy_bounds, "solved_from", slowly)
    with arrays.within_time(50.0), arrays.unfinished(), arrays.in_any_time():
        bounds = energy_bounds.energy_bounds(fresh(problem), answer)
    assert bounds.energy_error is None
    assert energy_bounds.OUT_OF_TIME in str(bounds.reasons)


@pytest.fixture
def slow_systems(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each system of closed contacts that is refined takes a hundred seconds."""
    solved = refinement.answer_on

    def slowly(*arguments: Any, **options: Any) -> Any:
        clock.passes(100.0)
        return solved(*arguments, **options)

    monkeypatch.setattr(refinement, "answer_on", slowly)


@pytest.mark.usefixtures("slow_systems")
@pytest.mark.parametrize(("seconds", "had"), [(10000.0, True), (50.0, False)])
def test_bounds_by_condensed_systems_of_an_unfinished_answer_do_so_too(seconds: float, had: bool) -> None:
    """Dense problems of 1500 contacts were judged for 14 s after a limit of one."""
    problem = fresh(on_paraboloid((3, 3, 2)))
    answer = Answer(np.zeros(problem.dimension), np.zeros(problem.contacts), None, np.zeros(0))
    with arrays.within_time(seconds), arrays.unfinished(), arrays.in_any_time():
        found = certificate.certificate_of(problem, answer)
    assert (found.energy_error is not None) == had
    assert had == (energy_bounds.OUT_OF_TIME not in str(found.reasons))


@pytest.mark.usefixtures("slow_systems")
def test_no_set_of_closed_contacts_is_corrected_late() -> None:
    """What the method had is returned as it came."""
    K = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(20, 20), format="csr")
    string = cq.ContactProblem(K, np.full(20, -0.5), -sp.identity(20, format="csr"), np.ones(20))
    solve = functools.partial(cq.solve, string, "projected-gauss-seidel", max_iter=1)
    assert solve(time_limit=1e6).work.polish_corrections > 0
    with pytest.raises(cq.NotConverged, match="of 50 s, before a set of closed contacts was corrected") as caught:
        solve(time_limit=50.0)
    assert not caught.value.solution.certificate.passed


def test_a_backend_without_a_time_limit_is_asked_all_the_same() -> None:
    """PIQP has none; where it finds the closed contacts of bounds alone its answer was lost with one."""
    told: list[str] = []
    K = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(40, 40), format="csr")
    membrane = cq.ContactProblem(K, -np.ones(40), -sp.identity(40, format="csr"), np.full(40, 3.0))
    solution = cq.solve(membrane, condense=False, time_limit=60.0, progress=told.append)
    finders = [one for one in told if one.endswith("finds the closed contacts")]
    assert solution.certificate.proven
    assert finders == ["piqp finds the closed contacts"]


@pytest.mark.slow
@pytest.mark.skipif(not multigrid.available(), reason="needs pyamg")
def test_friction_that_is_cut_short_is_not_compared_with_its_states(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The answer so far comes at once; it does not pass whatever its figures are."""
    monkeypatch.setenv(SOLVER_VARIABLE, "pyamg")
    problem = fresh(on_paraboloid((6, 6, 4), friction=0.3))
    assert cq.solve(problem).certificate.passed
    with pytest.raises(cq.NotConverged, match="time limit") as caught:
        cq.solve(fresh(problem), time_limit=1000.0, progress=late_at("combination 2", clock, 1000.0))
    found = caught.value.solution
    assert found.normal_force.max() > 0
    assert not found.certificate.passed
    assert any(OUT_OF_TIME in failure for failure in found.certificate.failures)


CUT_SHORT = [
    ("plane", "ppa", "active-set", 2),
    ("plane", "aclm", "osqp", 2),
    ("plane", "tresca", "active-set", 1),
    ("space", "nsgs", "active-set", 2),
    ("space", "ppa", "active-set", 2),
    ("space", "aclm", "osqp", 2),
    ("space", "tresca", "osqp", 2),
]


@pytest.mark.parametrize(("name", "algorithm", "method", "last"), CUT_SHORT)
def test_friction_on_condensed_contacts_has_its_answer_so_far(
    name: str, algorithm: str, method: str, last: int, clock: Clock
) -> None:
    """It is that of the last step, with what is known of its error, and never passes for an answer."""
    problem = rough_truss() if name == "plane" else on_paraboloid((5, 5, 3), friction=0.2, pushed=0.004)
    truth, steps = cq.solve(problem), list[str]()

    def told(where: str) -> None:
        if " step " in where:
            steps.append(where)
            clock.passes(300.0 if len(steps) == last else 0.0)

    with pytest.raises(cq.NotConverged, match="stopped at the time limit of 200 s") as caught:
        cq.solve(fresh(problem), method, algorithm=algorithm, time_limit=200.0, progress=told)
    found = caught.value.solution
    error = found.displacement - truth.displacement
    assert 0 < np.linalg.norm(error) < 0.5 * np.linalg.norm(truth.displacement)
    assert found.normal_force.max() > 0
    assert not found.certificate.passed
    assert len(steps) == last


def test_an_unfinished_answer_is_compared_with_its_states_for_as_long_again(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ten combinations of 90 300 unknowns took 3 s after a limit of 0.9 s."""
    problem, refined = plane_block((12, 6), 0.3, 0.001), state_answer.CondensedBodies.refined
    answer = Answer(
        np.zeros(problem.dimension), np.zeros(problem.contacts), np.zeros((problem.contacts, 1)), np.zeros(problem.ties)
    )

    def slowly(*arguments: Any) -> Any:
        clock.passes(100.0)
        return refined(*arguments)

    monkeypatch.setattr(state_answer.CondensedBodies, "refined", slowly)
    for seconds, late in ((1e6, False), (150.0, True)):
        with arrays.within_time(seconds), arrays.unfinished(), arrays.in_any_time():
            found = certificate.certificate_of(fresh(problem), answer)
        assert not found.passed
        assert any(OUT_OF_TIME in failure for failure in found.failures) == late


@pytest.mark.parametrize("unit", [1.0, 2.0**40])
def test_friction_by_newton_has_the_answer_of_its_last_combination(
    unit: float, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was lost, and no word said that the time was up."""
    problem = plane_block((12, 6), 0.3, 0.001)
    problem = problem.replace(stiffness=problem.stiffness * unit, load=problem.load * unit)
    truth, solved = cq.solve(problem, algorithm="newton"), ForceSystem.solve
    assert truth.work.iterations > 1

    def slowly(*arguments: Any) -> Any:
        clock.passes(300.0)
        return solved(*arguments)

    monkeypatch.setattr(ForceSystem, "solve", slowly)
    with pytest.raises(cq.NotConverged, match="newton: stopped at the time limit of 200 s") as caught:
        cq.solve(fresh(problem), algorithm="newton", time_limit=200.0)
    found = caught.value.solution
    assert found.normal_force.max() > 0
    assert not found.certificate.passed
    error = np.linalg.norm(found.displacement - truth.displacement)
    assert 0 < error < np.linalg.norm(truth.displacement)


def spheres(contacts: int = 40) -> cq.LocalProblem:
    """Contacts in space that an ill-conditioned Delassus operator couples: Newton's method takes some ten steps."""
    random = np.random.default_rng(3)
    H = random.standard_normal((3 * contacts, 2 * contacts))
    return cq.LocalProblem(delassus=H @ H.T, offset=random.standard_normal(3 * contacts), friction=0.5, dimension=3)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("algorithm", [None, *ALGORITHMS])
def test_a_local_problem_out_of_time_says_so_and_has_its_best_answer_judged(algorithm: str | None) -> None:
    problem = spheres()
    with pytest.raises(cq.NotConverged, match="stopped at the time limit of 1e-09 s") as caught:
        cq.solve(problem, time_limit=1e-9, algorithm=algorithm)
    found = caught.value.solution
    assert not found.certificate.passed
    assert found.certificate.natural_map > 1e-6


def in_the_plane() -> cq.LocalProblem:
    """Seven contacts, of which enumeration tries 4^7 combinations of open, stick and slip either way."""
    H = np.random.default_rng(3).standard_normal((14, 14))
    return cq.LocalProblem(delassus=H @ H.T, offset=-np.ones(14), friction=0.1, dimension=2)


def test_combinations_are_enumerated_in_time(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    """Time is up after the first answer, and that one is in the error."""
    words = "time limit of 200 s, before every combination of open, stick and slip was tried"
    problem, judged = in_the_plane(), local_solving._Judge.solution
    whole = cq.solve(problem, algorithm="enumeration", time_limit=200.0)

    def slowly(*arguments: Any) -> cq.LocalSolution:
        clock.passes(300.0)
        return judged(*arguments)

    monkeypatch.setattr(local_solving._Judge, "solution", slowly)
    with pytest.raises(cq.NotConverged, match=words) as caught:
        cq.solve(problem, algorithm="enumeration", time_limit=200.0)
    assert caught.value.solution.force == pytest.approx(whole.force, rel=1e-9)
    with pytest.raises(cq.NotConverged, match="stopped at the time limit") as caught:
        cq.solve(problem, algorithm="enumeration", time_limit=1e-9)
    assert caught.value.solution is None


@pytest.mark.parametrize("algorithm", ["tresca", "aclm"])
def test_a_convex_step_on_polygons_is_condensed_in_time(algorithm: str, clock: Clock, monkeypatch: Any) -> None:
    """The Delassus operator has forty motions without energy, and the time is up while these are found."""
    images = factorization.SparseRows.__matmul__

    def slowly(*arguments: Any) -> Any:
        clock.passes(100.0)
        return images(*arguments)

    monkeypatch.setattr(factorization.SparseRows, "__matmul__", slowly)
    began = clock()
    with pytest.raises(cq.NotConverged, match="stopped at the time limit of 1000 s") as caught:
        cq.solve(spheres(), algorithm=algorithm, time_limit=1000.0)
    assert caught.value.solution is not None
    assert clock() - began < 2000.0


def test_newton_in_no_time_returns_where_it_starts() -> None:
    form = LocalForm(spheres())
    start = Iterate.nothing(form)
    assert newton(form, start).error < start.error
    with arrays.within_time(1e-9):
        assert newton(form, start).error == start.error


def test_contacts_that_close_one_by_one_do_so_in_time() -> None:
    W, h, none = np.eye(60), np.ones(60), np.zeros(60, dtype=bool)
    assert nonnegative.dual_active_set(W, h, none, 0 * h, 100)[2]
    with arrays.within_time(1e-9), pytest.raises(cq.NotConverged, match="before contacts open and close one by one"):
        nonnegative.dual_active_set(W, h, none, 0 * h, 100)


def test_a_backend_without_a_time_limit_says_so_before_anything_is_factorised() -> None:
    pytest.importorskip("piqp")
    said: list[str] = []
    with pytest.raises(cq.Unsupported, match="piqp: this backend has no time limit: leave time_limit out"):
        cq.solve(fresh(PROBLEMS["frictionless"]), "piqp", time_limit=60.0, progress=said.append)
    assert not said


@pytest.fixture
def while_factorising(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[], None]], list[int]]:
    """Do something as PARDISO begins to factorise, and list what its factorisations end with."""
    if not pardiso.available():
        pytest.skip("needs pypardiso")
    monkeypatch.setattr(pardiso, "LONG", 0)
    call, ended = pardiso._Analysis.call, []

    def doing(what: Callable[[], None]) -> list[int]:
        def watched(self: Any, phase: int, *rest: Any) -> None:
            if phase == pardiso.FACTORISE:
                what()
            try:
                call(self, phase, *rest)
            except BackendFailed as error:
                ended.append(int(str(error).split()[2]))
                raise

        monkeypatch.setattr(pardiso._Analysis, "call", watched)
        return ended

    return doing


BY_ITS_PROGRESS = -13  # PARDISO's error where its progress function has ended it


def test_a_long_factorisation_ends_when_the_time_is_up(clock: Clock, while_factorising: Any) -> None:
    ended = while_factorising(lambda: clock.passes(1e6))
    words = "before the factors of the stiffness were complete"
    with arrays.within_time(1e5), pytest.raises(cq.NotConverged, match=words):
        pardiso.Pardiso(CHAIN, NONE)
    assert ended == [BY_ITS_PROGRESS]
    while_factorising(lambda: None)
    assert pardiso.Pardiso(CHAIN, NONE).solve_all(CHAIN @ np.ones(CHAIN.shape[0])) == pytest.approx(1.0)


def test_ctrl_c_ends_a_long_factorisation(while_factorising: Any) -> None:
    ended = while_factorising(lambda: os.kill(os.getpid(), signal.SIGINT))
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            pardiso.Pardiso(CHAIN, NONE)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert ended == [BY_ITS_PROGRESS]


def test_a_time_limit_is_that_of_both_laws_together(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    solved = equilibria.solve

    def slowly(*arguments: Any, **options: Any) -> cq.Solution:
        found = solved(*arguments, **options)
        clock.passes(300.0)
        return found

    monkeypatch.setattr(equilibria, "solve", slowly)
    assert cq.associated_difference(rough_truss(), time_limit=1000.0).coulomb.certificate.passed
    with pytest.raises(cq.NotConverged, match="stopped at the time limit of 200 s"):
        cq.associated_difference(fresh(rough_truss()), time_limit=200.0)
