"""A history as a table: what each contact does at each instant, as rows and as a file."""

from __future__ import annotations

import copy
import csv
from pathlib import Path

import numpy as np
import pytest

import contactqp as cq
from tests.model.test_summary import sled


def test_every_contact_has_a_row_at_every_instant() -> None:
    history = sled(3)
    table = history.table()
    assert len(table) == 9 * 3
    for row in table:
        solution, i = history[row.instant], int(row.contact.removeprefix("contact "))
        assert row.time == history.times[row.instant]
        assert row.status == solution.contact_status[i]
        assert row.normal_force == pytest.approx(solution.normal_force[i])
        assert row.friction_force == pytest.approx(solution.friction_force[i])
        assert row.gap == pytest.approx(solution.gap[i])
    assert {row.status for row in table} >= {"open", "stick", "slip"}


def test_it_is_written_with_units_and_all_digits(tmp_path: Path) -> None:
    history = sled(3)
    history.write_csv(tmp_path / "path.csv")
    with (tmp_path / "path.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [
        "instant", "time [legs]", "contact", "status", "normal_force [N]", "friction_force [N]", "gap [mm]"
    ]  # fmt: skip
    assert [float(row["normal_force [N]"]) for row in rows] == [row.normal_force for row in history.table()]
    assert rows[-1]["status"] == history[-1].contact_status[-1]


def test_a_folder_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(cq.InvalidProblem, match="expected a file that can be written, got: No such file"):
        sled(1).write_csv(tmp_path / "none" / "path.csv")


def test_it_prints_the_first_rows_within_80_columns() -> None:
    lines = str(sled().table()).splitlines()
    assert lines[0] == "189 rows, the first 40 shown; to_csv() has all"
    assert len(lines) == 42
    assert lines[1].split()[:2] == ["#", "time"]
    assert max(map(len, lines)) <= 80


def test_friction_in_space_has_two_columns() -> None:
    block = cq.ContactProblem(
        stiffness=np.eye(3), load=np.zeros(3), normal=[[0.0, 0.0, -1.0]], gap=[0.0],
        tangent=[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], friction=0.3,
    )  # fmt: skip
    table = cq.follow_path(block, [[0.1, 0.2, -1.0]], steps=2).table()
    assert table.columns[4:] == ("normal_force", "friction_force_1", "friction_force_2", "gap")
    np.testing.assert_allclose(table[-1].friction_force, [0.1, 0.2])
    assert table.to_dicts()[-1]["friction_force_2"] == pytest.approx(0.2)


@pytest.mark.slow
def test_motions_and_large_deformations_say_what_their_times_are() -> None:
    ball = cq.ContactProblem(stiffness=[[0.0]], load=[0.0], normal=[[1.0]], gap=[1.0])
    fall = cq.impact(ball, [1.0], [0.0], [1.0], duration=0.3, time_step=0.1)
    assert fall.table().columns[1] == "time [as time_step]"
    assert fall.table("time [ms]").columns[1] == "time [ms]"
    case = cq.run("bar_impact")
    assert case.time_label == copy.copy(case).time_label == "time [s]"
    assert cq.run("von_mises_truss").table().columns[1] == "load factor"


def test_without_contacts_it_is_empty() -> None:
    bare = cq.ContactProblem(stiffness=[[1.0]], load=[0.0], normal=np.zeros((0, 1)), gap=[])
    assert len(cq.follow_path(bare, [[1.0]], steps=2).table()) == 0
