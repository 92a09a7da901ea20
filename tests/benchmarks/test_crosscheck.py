"""Other codes on one block: what docs/crosscheck.md says of them, repeated wherever they are installed."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("skfem")

import contactqp as cq
from benchmarks.crosscheck import calculix
from benchmarks.crosscheck.__main__ import PAGE, as_expected, available
from benchmarks.crosscheck.attempts import ATTEMPTS, CALCULIX, WRONG, Attempt
from benchmarks.crosscheck.block import YOUNG, block, block_in_metres
from benchmarks.crosscheck.judging import Judged, judge, own_stiffness, prepare
from contactqp.errors import Unsupported
from contactqp.exchange.answer_files import read_answer

EVERY = [one for asked in ATTEMPTS.values() for one in asked]
ROW = re.compile(
    r"^\| (?P<name>[^|]+) \| .* \| \*\*(?P<verdict>right|wrong)\*\* \| (?P<off>\S+) \| (?P<overlap>\S+) \|$", re.M
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("crosscheck")
    prepare(place)
    if calculix.available():
        own_stiffness(place)
    return place


def solved(name: str, folder: Path) -> Judged:
    attempt = next(one for one in EVERY if one.name == name)
    if not available(attempt.code):
        pytest.skip(f"{attempt.code} is not installed (benchmarks/crosscheck/README.md)")
    return judge(attempt, folder)


def rows() -> dict[str, re.Match[str]]:
    return {found["name"]: found for found in ROW.finditer(PAGE.read_text(encoding="utf-8"))}


def test_the_page_has_every_attempt_with_its_verdict() -> None:
    assert {name: found["verdict"] for name, found in rows().items()} == {one.name: one.verdict for one in EVERY}
    text = PAGE.read_text(encoding="utf-8")
    assert all(one.because in text for one in EVERY)


@pytest.mark.sampled(12)
@pytest.mark.parametrize("attempt", EVERY, ids=lambda one: f"{one.code}: {one.name}")
def test_what_the_page_says(attempt: Attempt, folder: Path) -> None:
    found = solved(attempt.name, folder)
    assert as_expected(found), found.verdict.certificate.diagnosis
    printed = float(rows()[attempt.name]["off"])
    if attempt.verdict == WRONG:
        assert 0.5 * printed <= found.force_error <= 2 * printed
        assert found.verdict.certificate.diagnosis
    else:
        assert found.force_error <= 10 * attempt.limits[1]


def test_calculix_stores_the_stiffness_that_is_ours(tmp_path: Path) -> None:
    if not calculix.available():
        pytest.skip("CalculiX is not installed (benchmarks/crosscheck/README.md)")
    (tmp_path / "calculix").mkdir()
    assert own_stiffness(tmp_path) <= 1e-12


@pytest.mark.slow
def test_both_files_of_results_are_one_answer(tmp_path: Path) -> None:
    """Seven digits in .dat, six in .frd; binary fields are refused."""
    if not calculix.available():
        pytest.skip("CalculiX is not installed (benchmarks/crosscheck/README.md)")
    deck = calculix.contact_deck(block(), calculix.Contact("NODE TO SURFACE", printed=True, fields=True))
    assert calculix.run(tmp_path, "job", deck)[0] == 0
    tables, fields = (read_answer(tmp_path / f"job{suffix}", block().problem).parts for suffix in (".dat", ".frd"))
    for part in ("displacement", "normal_pressure"):
        assert np.allclose(fields[part], tables[part], rtol=6e-6, atol=0)
    calculix.run(
        tmp_path, "binary", deck.replace("*NODE FILE", "*NODE OUTPUT").replace("*CONTACT FILE", "*CONTACT OUTPUT")
    )
    with pytest.raises(Unsupported, match="a binary block"):
        read_answer(tmp_path / "binary.frd", block().problem)


def test_hard_contact_is_a_penalty_of_fifty_times_young(folder: Path) -> None:
    least, most = solved("node to face, springs", folder).spring
    assert least == pytest.approx(1.0, rel=2e-3)
    assert most == pytest.approx(1.0, rel=2e-3)


@pytest.mark.slow
def test_hard_contact_pulls_at_open_nodes_with_e_by_70000(folder: Path) -> None:
    found = solved("node to face, HARD", folder)
    assert np.sum(found.pulls) == 3
    assert np.allclose(found.pressure[found.pulls], -YOUNG / 70_000, rtol=1e-3)
    assert np.all(found.gap[found.pulls] > 4e-3)  # a thousand times the overlaps
    assert "held in tension" in found.verdict.certificate.diagnosis


def test_a_list_of_slave_nodes_doubles_the_edges(folder: Path) -> None:
    found = solved("node to face, slave nodes", folder)
    residual = found.verdict.certificate.violations.residual  # type: ignore[union-attr]
    names = found.block.problem.dof_names
    at_edge = found.pressure[1] * found.block.area[1]
    assert found.block.area[1] == 50.0
    assert abs(residual[names.index("3.2")]) == pytest.approx(at_edge, rel=1e-3)


@pytest.mark.slow
def test_mortar_hard_is_the_same_penalty(folder: Path) -> None:
    solved("mortar, HARD", folder)
    springs = replace(
        next(one for one in CALCULIX if one.name == "mortar, HARD"),
        name="mortar, springs",
        contact=calculix.Contact("MORTAR", calculix.linear(50 * YOUNG, 1e-6)),
    )
    hard, spring = solved("mortar, HARD", folder), judge(springs, folder)
    assert np.array_equal(hard.verdict.certificate.answer.displacement, spring.verdict.certificate.answer.displacement)


def test_mortar_loses_the_edge_over_the_edge(folder: Path) -> None:
    """The nodes 74 to 76 touch, and stay open where the floor ends below them."""
    found = solved("mortar, floor as large as the block", folder)
    right = cq.solve(block().problem)
    edge = [
        i for i in range(right.gap.size) if found.block.problem.contact_name(i) in ("node 74", "node 75", "node 76")
    ]
    assert np.all(right.normal_force[edge] > 80)
    assert np.all(found.gap[edge] > 2e-4)


def test_getfem_multipliers_of_open_contacts_are_r_times_the_gap(folder: Path) -> None:
    found = solved("basic brick, augmented multipliers", folder)
    right = cq.solve(block().problem)
    pulling = found.pulls
    assert np.array_equal(pulling, right.gap > 1e-4)
    force = found.verdict.certificate.answer.normal_force
    assert np.allclose(force[pulling], -YOUNG * right.gap[pulling], rtol=1e-9)


@pytest.mark.slow
def test_petsc_presses_across_gaps_below_its_zero_tolerance(folder: Path) -> None:
    found = solved("vinewtonrsls in metres", folder)
    assert found.said.startswith("converged")
    pressed = found.verdict.certificate.answer.normal_force > 1.0
    across = found.gap[pressed & (found.gap > 0)]
    assert across.size
    assert np.max(across) <= 1e-8
    assert found.force_error > 0.1


def test_the_block_in_metres_is_the_same_block() -> None:
    one, other = cq.solve(block().problem), cq.solve(block_in_metres().problem)
    assert np.allclose(other.normal_force, one.normal_force / 100, rtol=1e-10)
    assert np.allclose(other.gap, 1e-5 * one.gap, rtol=1e-10, atol=1e-20)
