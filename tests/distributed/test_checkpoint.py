"""Steps of a load path are kept, and a run that was ended goes on from them, on any number of ranks."""

from __future__ import annotations

import json
import shutil
import signal

import numpy as np
import pytest

import contactqp as cq
from tests.distributed.cases import STEPS, path_case
from tests.distributed.conftest import SCRIPTS

SCRIPT = "path_in_steps.py"


def serial(case):
    history = cq.run(cq.load_scene(case))
    return history.displacements, [[event.kind, event.name, event.time] for event in history.events]


def same(found: dict, case) -> bool:
    displacements, events = serial(case)
    assert np.abs(displacements).max() > 0
    assert len(events) == 2  # the bodies meet, and the second one meets the wall
    close = np.abs(np.array(found["displacements"]) - displacements).max() <= 1e-9 * np.abs(displacements).max()
    return bool(close) and found["events"] == events


@pytest.mark.parametrize(
    ("other", "third"), [(1, None), *(pytest.param(*counts, marks=pytest.mark.slow) for counts in ((1, 2), (3, 1)))]
)
def test_a_killed_run_goes_on_from_its_last_step_on_another_number_of_ranks(
    on_ranks, python_on_ranks, tmp_path, other, third
):
    case, folder = path_case(tmp_path), tmp_path / "steps"
    killed = python_on_ranks(2, SCRIPTS / SCRIPT, case, folder, 4)
    assert killed.code == 128 + signal.SIGKILL
    assert "rank 1" in killed.err
    assert killed.out == ""
    assert sorted(file.name for file in folder.glob("step-*.json")) == [f"step-{i:06d}.json" for i in range(4)]
    found = json.loads(on_ranks(SCRIPT, other, case, folder))
    assert found["solved"] == STEPS + 1 - 4
    assert same(found, case)
    if third is not None:
        again = json.loads(on_ranks(SCRIPT, third, case, folder))
        assert again["solved"] == 0
        assert same(again, case)


@pytest.mark.slow
def test_a_step_that_not_all_ranks_have_written_is_solved_again(on_ranks, kept):
    case, folder = kept
    (folder / "step-000006.json").unlink()  # the run ended before this was written
    (folder / "step-000006" / "0-of-1.npz").write_bytes(b"half a fi")
    found = json.loads(on_ranks(SCRIPT, 1, case, folder))
    assert found["solved"] == 1
    assert same(found, case)


@pytest.fixture(scope="module")
def shelf(tmp_path_factory):
    """Where the one run is that the tests below take copies of."""
    return tmp_path_factory.mktemp("kept")


@pytest.fixture
def kept(on_ranks, shelf, tmp_path):
    """A case and the folder of all its steps."""
    if not any(shelf.iterdir()):
        on_ranks(SCRIPT, 1, path_case(shelf), shelf / "steps")
    shutil.copytree(shelf, tmp_path, dirs_exist_ok=True)
    return path_case(tmp_path), tmp_path / "steps"


def run(case, folder) -> list[object]:
    return ["run", case, "--engine", "petsc", "--checkpoint", folder]


@pytest.mark.slow
def test_what_is_no_folder_of_this_case_is_refused_in_one_line(commands, kept, tmp_path):
    case, folder = kept
    shutil.copytree(folder, half := tmp_path / "half")
    (half / "step-000002" / "0-of-1.npz").write_bytes(b"half a fi")
    shutil.copytree(folder, less := tmp_path / "less")
    (less / "step-000002" / "0-of-1.npz").unlink()
    (other := tmp_path / "other").mkdir()
    (mine := tmp_path / "mine").mkdir()
    (mine / "thesis.tex").touch()
    asked = {
        (case, half): "0-of-1.npz: expected a file of a step",
        (case, less): "0-of-1.npz: No such file",
        (path_case(other, load="2001 kN"), folder): "steps of another case",
        (case, mine): "expected the steps of a run, or an empty folder",
    }
    found = commands(*(run(*each) for each in asked))
    for (code, out, err), said in zip(found, asked.values(), strict=True):
        assert (code, out) == (2, "")
        (line,) = err.strip().splitlines()
        assert said in line


@pytest.mark.slow
def test_words_of_a_case_may_change_between_its_runs(commands, kept):
    case, folder = kept
    case.write_text(case.read_text().replace("Two bars in a row", "Bars, and a wall"))
    ((code, out, err),) = commands(run(case, folder))
    assert code == 0, err
    assert "Bars, and a wall" in out
