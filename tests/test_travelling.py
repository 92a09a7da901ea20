"""Errors travel between processes with the answers that they carry."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
import threading
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp import errors
from tests.examples import truss


def copies(thing: Any) -> list[Any]:
    return [copy.copy(thing), copy.deepcopy(thing), *(pickle.loads(pickle.dumps(thing, p)) for p in (2, 5))]


def rough() -> cq.ContactProblem:
    return truss(tangent=[[1.0, 0.0]], friction=0.3)


def local() -> cq.LocalProblem:
    return cq.LocalProblem(delassus=np.eye(3), offset=[-1.0, 0.1, 0.0], friction=0.3, dimension=3)


def refused() -> cq.NotCertified:
    return cq.NotCertified("the certificate refuses the answer", cq.solve(truss()))


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
