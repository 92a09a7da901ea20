"""The benchmark of omissions on tiny sizes: both ways have one answer, and the table says what it measured."""

import pytest

from benchmarks import omissions
from benchmarks.omissions import IMPORTS, OMISSIONS, Saving


@pytest.mark.slow
@pytest.mark.parametrize("omission", OMISSIONS, ids=lambda omission: omission.name)
def test_both_ways_have_one_answer(omission):
    lean, full = omissions.alternated(omission.ways(200), rounds=1)
    assert lean > 0
    assert full > 0


def test_two_answers_are_noticed():
    one, other = OMISSIONS[0].ways(200)[0], OMISSIONS[0].ways(300)[0]
    with pytest.raises((AssertionError, ValueError)):
        omissions.alternated((one, other), rounds=1)
    with pytest.raises(AssertionError, match="two answers"):
        omissions.alternated((one, lambda: 1.001 * one()), rounds=1)


@pytest.mark.slow
def test_a_mass_matrix_takes_memory_and_is_measured_in_a_process_of_its_own(capsys):
    assert omissions.main(["--only", "mass matrix", "--size", "500", "--rounds", "1"]) == 0
    header, row = capsys.readouterr().out.splitlines()
    assert header.split()[:3] == ["left", "out", "unknowns"]
    assert "the consistent mass matrix, in statics: " in row
    lean, full = (float(number) for number in row.split()[6:8])
    assert 0 < lean < 500
    assert 0 < full < 500


@pytest.mark.slow
def test_what_a_bar_does_not_import_costs_more_with_it():
    name, brought_in, modules = next(row for row in IMPORTS if row[0] == "plotting")
    saving = omissions.of_imports(name, brought_in, omissions.installed(modules), rounds=1)
    assert saving.full_bytes > saving.lean_bytes + 5e6


def test_a_saving_within_the_scatter_of_the_clock_is_none():
    saving = Saving("a", "b", 10, 1.0, 1.04, None, None)
    assert saving.verdict == "no time that can be measured"
    assert Saving("a", "b", 10, 1.0, 3.0, None, None).verdict == "3 times as long with it"
    assert Saving("a", "b", 10, 3.0, 1.0, None, None).verdict == "3 times as fast with it"
    assert omissions.line(saving).endswith("b: no time that can be measured")
