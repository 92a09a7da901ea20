"""The page on scaling has the measured figures, and the model's answers to them."""

from __future__ import annotations

import copy
import json
from dataclasses import replace

import pytest

from benchmarks.scaling.__main__ import KEPT, PAGE, filled
from benchmarks.scaling.model import INDEX, Node, forecast, measured
from benchmarks.scaling.tables import tables

FOUND = json.loads(KEPT.read_text())


def test_the_tables_of_the_page_are_those_of_the_figures():
    page = PAGE.read_text()
    assert filled(page, FOUND) == page
    assert len(tables(FOUND)) > 2
    for name in tables(FOUND):
        assert f"<!-- {name} -->" in page, "every table has a place"


def test_other_figures_are_seen():
    changed = copy.deepcopy(FOUND)
    changed["strong"][0]["linear"][0]["per_step"]["KSPSolve"]["flops"][0] *= 2
    assert filled(PAGE.read_text(), changed) != PAGE.read_text()


def test_answers_on_any_number_of_ranks_are_the_same():
    assert len(FOUND["differences"]) > 2
    for difference in FOUND["differences"]:
        assert difference["displacement"] <= 1e-9
        assert difference["normal_force"] <= 1e-9


def test_a_step_is_the_sum_that_the_page_says():
    of, node = measured(FOUND), Node()
    found = forecast(10**8, 100, of, node)
    N, per_core = 10**8 / 6400, 200e9 / 64
    alone = 6 * of.flops * N / per_core
    sent = 26 * (of.messages * 2e-6 + of.surface * N ** (2 / 3) / (12.5e9 / 64))
    met = 2 * of.meetings * 2e-6 * 12.643856189774724  # log2 6400
    assert found.step == pytest.approx(alone + sent + met)
    assert found.communication == pytest.approx(sent + met)


def test_what_breaks_is_named():
    of = measured(FOUND)
    assert "memory" in forecast(10**9, 1, of).breaks
    assert not forecast(10**7, 10, of, Node(latency=0.0, network=1e30)).breaks
    assert "32-bit indices (unknowns)" in forecast(INDEX + 1, 1000, of).breaks
    assert "a mesh file, read by rank 0" in forecast(10**9, 1000, of, Node(memory=50e9)).breaks
    assert (
        "32-bit indices (nonzeros of a rank)" in forecast(10**9, 1, replace(of, nonzeros=250.0), Node(cores=1)).breaks
    )
