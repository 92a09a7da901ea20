"""A study sent to a Dask cluster that is there already."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from contactqp.errors import InvalidProblem
from contactqp.study.running.journal import Cell, Crash
from contactqp.study.running.runner import Running, run_cells
from contactqp.study.running.workers import Cluster, cluster
from tests.study.running import cell_functions as do
from tests.study.running.cell_functions import Number

pytest.importorskip("distributed")
ROOT = Path(__file__).parents[3]
# One process that is scheduler and two workers with a thread each; it says its address.
CLUSTER = """
import sys
from distributed import LocalCluster
with LocalCluster(n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None, host="127.0.0.1",
                  protocol="tcp") as cluster:
    print(cluster.scheduler_address, flush=True)
    sys.stdin.read()
"""


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """Of a scheduler in another process; it ends with its stdin."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", CLUSTER], stdin=pipe, stdout=pipe, text=True, env=environment) as run:
        assert run.stdout is not None
        yield run.stdout.readline().strip()
        run.terminate()


@pytest.fixture
def workers(address: str) -> Iterator[Cluster]:
    with cluster(address) as found:
        yield found


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of distributed itself
def test_cells_run_there_and_a_crash_costs_its_own(workers: Cluster) -> None:
    halves = [Cell(str(i), do.half, (i,), Number) for i in range(6)]
    bad = [Cell("segfault", do.segfault, (), Number), Cell("hangs", do.hangs, (), Number)]
    with workers.side_by_side() as pool:
        assert pool.size == 2
        found = run_cells([*halves[:3], *bad, *halves[3:]], pool, time_limit=3.0)
    assert found.pop("segfault") == Crash("the process died of a segmentation fault (SIGSEGV)")
    assert found.pop("hangs") == Crash("stopped after 3 s without an answer")
    assert list(found.values()) == [Number(i / 2) for i in range(6)]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_what_is_timed_runs_alone_in_one_process_of_a_worker(workers: Cluster, tmp_path: Path) -> None:
    with workers.alone() as pool:
        found = run_cells([Cell(str(i), do.overlap, (tmp_path,), Number) for i in range(4)], pool)
        places = run_cells([Cell(str(i), do.where, (), Number) for i in range(3)], pool)
    assert {result.value for result in found.values()} == {1}
    assert len({result.value for result in places.values()}) == 1
    assert workers.ask(os.getpid) != os.getpid()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_report_from_there_is_the_same_table(address: str, tmp_path: Path) -> None:
    from dataclasses import replace

    from contactqp.study.reporting import write_report

    tables = []
    for i, running in enumerate((Running(jobs=1), Running(dask=address))):
        result = write_report(
            [ROOT / "cases" / "two_bars.toml"], tmp_path / str(i), methods=["active-set", "daqp"], running=running
        )
        untimed = dict(seconds=None, seconds_spread=None, repeats=0, linear_solve_seconds=None)
        tables.append([replace(row, **untimed) for row in result.rows])
    assert tables[0] == tables[1]
    assert "run by 2 workers of Dask with 2 threads" in result.notes


@pytest.mark.parametrize(
    "address", ["", "nowhere", "no/address", "http://[::", "ftp://somewhere:1", "tcp://127.0.0.1:{closed}"]
)
def test_a_bad_address_is_one_line(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("contactqp.study.running.workers.PATIENCE", 0.5)
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        address = address.format(closed=unused.getsockname()[1])
        with pytest.raises(InvalidProblem, match="expected the address of a Dask scheduler") as told, cluster(address):
            pass
    assert address in str(told.value)
    assert "\n" not in str(told.value)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_workers_with_another_contactqp_are_refused(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("contactqp.study.running.workers.source_digest", _of_another_time)
    with pytest.raises(InvalidProblem, match="expected this contactqp on every worker"), cluster(address):
        pass


def _of_another_time() -> str:
    return f"another {os.getpid()}"


@pytest.mark.slow
def test_processes_here_and_a_cluster_exclude_each_other() -> None:
    with pytest.raises(InvalidProblem, match="got both: 2 and tcp://there:8786"):
        Running(jobs=2, dask="tcp://there:8786")
