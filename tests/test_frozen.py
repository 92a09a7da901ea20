"""Problems and answers cannot be changed, travel between processes, and depend on no setting of NumPy's."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
import threading
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp import errors
from tests.examples import truss


def arrays_of(thing: Any, seen: set[int] | None = None) -> list[np.ndarray]:
    """Every array in a problem or an answer, wherever it lies."""
    seen = set() if seen is None else seen
    if id(thing) in seen:
        return []
    seen.add(id(thing))
    if isinstance(thing, np.ndarray):
        return [thing]
    if sp.issparse(thing):
        return [thing.data, thing.indices, thing.indptr]
    if isinstance(thing, tuple):
        return [array for part in thing for array in arrays_of(part, seen)]
    if is_dataclass(thing):
        names = [each.name for each in fields(thing) if each.name != "_shared"]
        return [array for name in names for array in arrays_of(getattr(thing, name), seen)]
    return []


def copies(thing: Any) -> list[Any]:
    return [copy.copy(thing), copy.deepcopy(thing), *(pickle.loads(pickle.dumps(thing, p)) for p in (2, 5))]


def rough() -> cq.ContactProblem:
    return truss(tangent=[[1.0, 0.0]], friction=0.3)


def local() -> cq.LocalProblem:
    return cq.LocalProblem(delassus=np.eye(3), offset=[-1.0, 0.1, 0.0], friction=0.3, dimension=3)


def refused() -> cq.NotCertified:
    return cq.NotCertified("the certificate refuses the answer", cq.solve(truss()))


THINGS = {
    "problem": rough,
    "sparse problem": lambda: truss().replace(stiffness=sp.csr_matrix(truss().stiffness)),
    "solution": lambda: cq.solve(truss()),
    "polished solution": lambda: cq.solve(truss(), "clarabel"),
    "rough solution": lambda: cq.solve(rough()),
    "certificate": lambda: cq.solve(truss()).certificate,
    "local problem": local,
    "local solution": lambda: cq.solve(local()),
}


@pytest.mark.parametrize("name", THINGS)
def test_no_array_can_be_written_to_and_copies_are_as_frozen(name: str) -> None:
    thing = THINGS[name]()
    whole = arrays_of(thing)
    assert whole
    for other in (
        thing,
        copy.copy(thing),
        copy.deepcopy(thing),
        *(pickle.loads(pickle.dumps(thing, p)) for p in (2, 5)),
    ):
        found = arrays_of(other)
        assert not any(array.flags.writeable for array in found)
        assert all(np.array_equal(a, b) for a, b in zip(found, whole, strict=True))


def test_what_is_computed_from_a_problem_is_frozen_too() -> None:
    problem, solution = rough(), cq.solve(rough())
    for array in (problem.diagonal, problem.load_size, solution.gap, solution.slip):
        assert not array.flags.writeable
    with pytest.raises(ValueError, match="read-only"):
        problem.stiffness_rows.data *= 3


def test_what_the_caller_does_with_his_arrays_later_changes_nothing() -> None:
    K, f = sp.csr_matrix([[2.0, -1.0], [-1.0, 2.0]]), np.array([1.0, 0.0])
    problem = cq.ContactProblem(K, f, [[1.0, 0.0]], [0.1])
    K.data *= 3
    f[:] = 7.0
    assert problem.load.tolist() == [1.0, 0.0]
    assert problem.stiffness.toarray()[0, 0] == 2.0


@pytest.mark.parametrize("key", ["stiffness", "load", "normal", "gap", "friction", "tie_value"])
def test_masked_arrays_are_refused_in_one_line(key: str) -> None:
    data = dict(stiffness=np.eye(2), load=[1.0, 0.0], normal=[[1.0, 0.0]], gap=[0.1], tangent=[[0.0, 1.0]])
    data |= dict(friction=[0.3], tie=[[0.0, 1.0]], tie_value=[0.0])
    data[key] = np.ma.masked_array(np.array(data[key], dtype=float), mask=True)
    with pytest.raises(cq.InvalidProblem, match=f"^{key}: .*masked"):
        cq.ContactProblem(**data)


def test_masked_answers_are_refused_in_one_line() -> None:
    with pytest.raises(cq.InvalidProblem, match=r"displacement: .*masked"):
        cq.certify(truss(), displacement=np.ma.masked_array([0.0, 0.0], mask=[True, False]), normal_force=[1.0])
    with pytest.raises(cq.InvalidProblem, match=r"offset: .*masked"):
        cq.LocalProblem(np.eye(2), np.ma.masked_array([1.0, 0.0], mask=True), 0.3, dimension=2)


@pytest.mark.parametrize("friction", ["0.3", "high", ["0.3"], np.array(["0.3"]), 1j])
def test_a_coefficient_that_is_a_word_is_refused(friction: Any) -> None:
    with pytest.raises(cq.InvalidProblem, match="friction: expected real numbers"):
        truss(tangent=[[1.0, 0.0]], friction=friction)


KINDS = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, cq.ContactQPError)]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_error_travels_with_what_it_carries(kind: type[cq.ContactQPError]) -> None:
    made = refused() if kind is cq.NotCertified else kind("what went wrong")
    if kind is cq.NotConverged:
        made = cq.NotConverged("what went wrong", (1.0, 0.5), cq.solve(truss()))
    for other in copies(made):
        assert type(other) is kind
        assert str(other) == str(made)
        assert other.__dict__.keys() == made.__dict__.keys()
        if getattr(made, "solution", None) is not None:
            assert other.solution.normal_force == made.solution.normal_force


def _refuse(_: int) -> None:
    raise refused()


def test_a_worker_that_refuses_does_not_hang_the_pool() -> None:
    spawning = multiprocessing.get_context("spawn")
    with spawning.Pool(1) as pool, pytest.raises(cq.NotCertified, match="refuses") as caught:
        pool.map_async(_refuse, [0]).get(timeout=60)
    assert caught.value.solution.certificate.passed


def _solve_in_child(problem: cq.ContactProblem, answers: Any) -> None:
    answers.put(cq.solve(problem).normal_force.tolist())


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_fork_while_another_thread_holds_the_lock_does_not_hang() -> None:
    problem = truss()
    held, done = threading.Event(), threading.Event()

    def hold() -> None:
        with problem.lock:
            held.set()
            done.wait()

    thread = threading.Thread(target=hold)
    thread.start()
    held.wait()
    forking = multiprocessing.get_context("fork")
    answers = forking.Queue()
    child = forking.Process(target=_solve_in_child, args=(problem, answers))
    child.start()
    try:
        assert answers.get(timeout=60) == cq.solve(truss()).normal_force.tolist()
    finally:
        done.set()
        thread.join()
        child.kill()
        child.join()


def test_settings_of_floating_point_errors_are_the_callers_and_change_nothing() -> None:
    tiny = truss().replace(load=np.array([6e-300, -1e-299]))
    quiet = cq.solve(tiny)
    with np.errstate(all="raise"):
        before = np.geterr()
        for problem in (tiny, truss(), rough()):
            for method in ("active-set", "clarabel", "lemke"):
                solution = cq.solve(problem, method if not problem.frictional else "active-set")
                assert cq.certify(problem, solution.displacement, solution.normal_force, solution.friction_force).passed
        cq.follow_path(truss(), loads=[1e-300 * truss().load, truss().load], steps=2)
        cq.solve(local())
        assert np.geterr() == before
        assert np.array_equal(cq.solve(tiny).normal_force, quiet.normal_force)
