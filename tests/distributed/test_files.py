"""Files of matrices on several ranks: the first one reads and deals out, and the answer is that of one process."""

from __future__ import annotations

import json

import numpy as np
import pytest

import contactqp as cq
from contactqp.oracle.gallery.gallery import problems
from tests.distributed.cases import RANKS

# Ties, bodies that float, redundant contacts, friction in the plane and in space, more ranks than unknowns.
NAMES = ("bar-and-wall", "merged-chain", "floating-2", "redundant-1", "tied-1", "frictional-1", "large-1")


def write_gallery(folder):
    for known in problems():
        if known.name in NAMES:
            tied = tuple(f"joint {k}" for k in range(known.problem.ties))
            cq.write_problem(folder / known.name, known.problem.replace(tie_names=tied) if tied else known.problem)
    return folder


@pytest.fixture(scope="module")
def gallery(tmp_path_factory):
    return write_gallery(tmp_path_factory.mktemp("gallery"))


def run(python_on_ranks, count, *arguments):
    return python_on_ranks(count, "-m", "contactqp", "run", *arguments, "--engine", "petsc")


def are_the_same(said: str, ranks: int, names: tuple[str, ...]) -> None:
    assert said.splitlines() == [f"{name}: the same on {ranks}" for name in names]


@pytest.mark.slow
@pytest.mark.parametrize("ranks", RANKS)
def test_a_problem_of_the_first_rank_is_dealt_out(on_ranks, gallery, ranks):
    are_the_same(on_ranks("problems_of_first_rank.py", ranks, *(gallery / name for name in NAMES)), ranks, NAMES)


@pytest.mark.slow
def test_a_part_that_is_wrong_is_seen(on_ranks, gallery):
    # Two ranks write at once, so that of a line no more than this is sure to hold together.
    with pytest.raises(pytest.fail.Exception, match="load: off"):
        on_ranks("problems_of_first_rank.py", 2, "--spoil", gallery / "tied-1")


@pytest.mark.slow
def test_the_command_prints_the_answer_once(python_on_ranks, gallery, tmp_path):
    problem = cq.read_problem(gallery / "tied-1")
    arrays = {"K": problem.stiffness.toarray(), "f": problem.load, "E_N": problem.normal.toarray(), "g": problem.gap}
    np.savez(tmp_path / "tied.npz", **arrays, A=problem.tie.toarray(), b=problem.tie_value)
    done = run(python_on_ranks, 3, gallery / "tied-1", tmp_path / "tied.npz", "--json")
    assert done.code == 0, done.err
    wanted = cq.solve(problem)
    outcomes = json.loads(done.out)
    assert len(outcomes) == 2
    for found in outcomes:
        assert found["met"]
        for part in ("displacement", "normal_force", "tie_force"):
            values, others = np.array(found[part]), getattr(wanted, part)
            assert np.abs(values - others).max() <= 1e-9 * np.abs(others).max()


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [2, 1, 3])
def test_a_broken_file_is_refused_in_one_line(python_on_ranks, gallery, tmp_path, ranks):
    cq.write_problem(tmp_path / "broken", cq.read_problem(gallery / "tied-1"))
    file = tmp_path / "broken" / "stiffness.mtx"
    file.write_text(file.read_text().rstrip().rpartition("\n")[0])
    done = run(python_on_ranks, ranks, tmp_path / "broken")
    assert done.code == 2
    assert done.out == ""
    (line,) = done.said
    assert line.startswith(f"contactqp: {file}: entries: expected")
