"""Ranks are there, what fails is seen, what hangs ends, and arrays go from rank to rank as they are."""

from __future__ import annotations

import pytest

from tests.distributed.conftest import finished


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2, 3])
def test_all_ranks_are_there(on_ranks, monkeypatch, count):
    monkeypatch.setenv("PETSC_OPTIONS", "-greeting hello")
    assert on_ranks("greeting.py", count, count, "-not_for_petsc").split() == [str(count), "ranks"]


@pytest.mark.slow
def test_a_script_that_fails_fails_the_test_with_what_all_ranks_said(on_ranks, monkeypatch):
    monkeypatch.setenv("PETSC_OPTIONS", "-greeting nothing")
    with pytest.raises(pytest.fail.Exception, match=r"(?s)exit code 1.*AssertionError"):
        on_ranks("greeting.py", 2, 2)


@pytest.mark.slow
def test_a_run_that_hangs_fails_the_test(start_ranks):
    # Rank 1 waits for a message that nobody sends.
    hangs = "from mpi4py import MPI; c = MPI.COMM_WORLD; c.rank and c.recv(); c.barrier()"
    with pytest.raises(pytest.fail.Exception, match="no end after 3 s"):
        finished(start_ranks(2, "-c", hangs), limit=3)


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [1, 2, 3, 4])
def test_rows_come_where_they_are_sent(on_ranks, ranks):
    assert on_ranks("exchanged.py", ranks) == f"the same on {ranks}\n"
