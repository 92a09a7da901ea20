"""A process that is forked while another thread computes does not wait for that thread, which it does not have."""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import cached_property
from typing import Any

import pytest

import contactqp as cq
from contactqp.analysis.history import History
from contactqp.model import arrays
from contactqp.study.running import workers
from tests.public_objects import bars, rubbing

pytestmark = [
    pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="nothing forks here"),
    pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning"),
]


@contextmanager
def held_elsewhere(*locks: AbstractContextManager[Any]) -> Iterator[None]:
    """While another thread holds the locks."""
    taken, leave = threading.Event(), threading.Event()

    def hold() -> None:
        for lock in locks:
            lock.__enter__()
        taken.set()
        leave.wait(60)
        for lock in locks:
            lock.__exit__(None, None, None)

    thread = threading.Thread(target=hold)
    thread.start()
    assert taken.wait(10)
    try:
        yield
    finally:
        leave.set()
        thread.join()


def in_forked_child(work: Callable[[], Any]) -> Any:
    context = multiprocessing.get_context("fork")
    receive, send = context.Pipe(duplex=False)
    child = context.Process(target=lambda: send.send(work()), daemon=True)
    child.start()
    try:
        assert receive.poll(30), "the child waits for a thread of its parent"
        return receive.recv()
    finally:
        child.kill()
        child.join()


@pytest.mark.slow
@pytest.mark.parametrize("make", [bars, rubbing])
def test_a_problem_is_solved_in_a_child_while_a_thread_of_the_parent_works_on_it(make) -> None:
    problem = make()
    expected = cq.solve(problem).normal_force.tolist()
    with held_elsewhere(problem._lock):
        assert in_forked_child(lambda: cq.solve(problem).normal_force.tolist()) == expected
        changed = problem.replace(load=2 * problem.load)
        found = in_forked_child(lambda: cq.solve(changed))
    assert found.certificate.passed
    assert cq.solve(changed).normal_force.tolist() == pytest.approx(found.normal_force.tolist(), rel=1e-12)


def test_the_lock_of_a_child_is_a_lock() -> None:
    """Threads of the child still wait for each other, and problems that share a stiffness share it."""
    problem = bars()

    def one_lock() -> bool:
        return problem._lock is problem.replace(load=[0.0, 0.0])._lock and problem._lock.acquire(blocking=False)

    with held_elsewhere(problem._lock):
        assert in_forked_child(one_lock)
        assert not problem._lock.acquire(blocking=False)


def test_a_solve_may_fork_inside_of_itself() -> None:
    problem = bars()
    with problem._lock:
        assert in_forked_child(lambda: cq.solve(problem).certificate.passed)


def test_the_limit_of_threads_of_blas(monkeypatch) -> None:
    monkeypatch.setattr(arrays, "WORTHWHILE", 1)
    problem = bars()
    with held_elsewhere(arrays._LIMIT._lock):
        assert in_forked_child(lambda: cq.solve(problem).certificate.passed)


def test_what_a_worker_of_a_cluster_asks_its_processes() -> None:
    """The child has processes of its own: those of its parent answer the parent."""
    theirs = workers._CHILDREN[-1]

    def own() -> bool:
        with workers._LOCK:
            return workers._CHILDREN[-1] is not theirs

    with held_elsewhere(workers._LOCK, theirs._lock):
        assert in_forked_child(own)
        assert in_forked_child(lambda: workers.stop_children() is None)
    assert workers._CHILDREN[-1] is theirs


def test_what_is_computed_when_looked_at() -> None:
    """Up to Python 3.11 a cached property has one lock for all instances of its class."""
    history = cq.follow_path(bars(), loads=[[10.0, 1.0]], steps=2)
    events = [vars(History)["events"], vars(History)["energies"], vars(cq.LocalProblem)["contact_scale"]]
    assert all(isinstance(one, cached_property) for one in events)
    locks = [one.lock for one in events if hasattr(one, "lock")]
    with held_elsewhere(*locks):
        assert len(in_forked_child(lambda: history.events)) == 2
        assert len(in_forked_child(lambda: history.energies)) == 3
