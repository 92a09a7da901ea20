"""The benchmark of published friction problems, on problems made here: its score, its profiles, what it reports."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import contactqp as cq
from benchmarks import friction_runs, published_friction, siconos_peer
from benchmarks.friction_runs import Published, Run
from benchmarks.friction_score import Arrays, projection, score
from benchmarks.performance_profiles import draw
from benchmarks.siconos_process import block_text
from contactqp.certificate.local_certificate import certify_local
from contactqp.exchange.siconos import read_siconos
from tests.solving.friction.test_local import made

needs_siconos = pytest.mark.skipif(
    not siconos_peer.available(), reason=f"Siconos is not installed for {siconos_peer.PYTHON}"
)
SOLVED = Run("default", "newton", 1e-12, 1e-12, 0.1, claimed=True)


def one_contact(scale: float = 1.0) -> Published:
    """W = I, q = scale (-3, 4), mu = 1/2: it slides with r = scale (3, -3/2)."""
    return Published("one", cq.LocalProblem(np.eye(2), [-3.0 * scale, 4.0 * scale], 0.5, 2))


@pytest.mark.parametrize("scale", [1.0, 1e-9, 1e9])
def test_the_score_of_a_closed_form_is_zero_and_does_not_know_units(scale):
    problem = one_contact(scale)
    assert problem.score(scale * np.array([[3.0, -1.5]])) < 1e-15
    # r = 0: u = q, the map is (3 - 2, -4), outside the cone and its polar; its projection is (12, -6)/5 (1 - 2 = -1).
    moved = np.array([[3.0 - 0.5 * 4.0, -4.0]])
    expected = np.linalg.norm([12.0 / 5, -6.0 / 5]) / 5.0
    assert np.allclose(projection(moved, np.array([0.5])), [[12.0 / 5, -6.0 / 5]])
    assert problem.score(np.zeros((1, 2))) == pytest.approx(expected, rel=1e-14)


def published(local, force):
    """The error of Acary, Bremond and Huber (2018) with W scaled to max |W| = 1 and q to |q| = sqrt(d m)."""
    largest, size = np.max(abs(local.delassus.data)), np.linalg.norm(local.offset) / np.sqrt(len(local.offset))
    scaled = cq.LocalProblem(local.delassus / largest, local.offset / size, local.friction, local.dimension)
    return cq.acary_bremond_huber_error(scaled, force * (largest / size))


@pytest.mark.sampled(4)
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("skew", [0.0, 0.05])
def test_the_score_is_the_published_error_and_sees_what_is_wrong(dimension, skew):
    for seed in range(5):
        local, force, _ = made(seed, dimension=dimension, skew=skew)
        problem = Published("made", local)
        assert problem.score(force) < 1e-14
        flipped = force * np.array([1.0, *[-1.0] * (dimension - 1)])
        noisy = force + 1e-6 * np.random.default_rng(seed).normal(size=force.shape)
        for wrong, at_least in ((flipped, 1e-2), (-force, 1e-2), (1.001 * force, 1e-5), (noisy, 1e-8)):
            assert problem.score(wrong) > at_least
            assert problem.score(wrong) == pytest.approx(published(local, wrong), rel=1e-9)
            assert not certify_local(local, wrong).passed
        assert problem.score(np.full_like(force, np.nan)) == np.inf


def test_an_unsymmetric_operator_is_scored_as_given():
    local, force, _ = made(1, skew=0.05)
    problem = Published("made", local)
    assert problem.unsymmetric
    floor = friction_runs.symmetric_floor(problem, 10.0)
    assert problem.score(force) < 1e-14 < 1e-3 < floor < 1.0
    minimised = friction_runs.run_ours(problem, "aclm", 10.0, polish=False)
    assert 1e-3 < minimised.error <= 1.01 * floor
    assert not minimised.solved
    assert friction_runs.run_ours(problem, "default", 10.0).solved


def test_the_rank_is_that_of_what_made_the_operator():
    assert Published("made", made(2, contacts=6, rank=9)[0]).rank == 9


def test_siconos_reads_the_problem_that_was_written(tmp_path):
    local, _, _ = made(3, contacts=4, skew=0.02)
    scaled = Published("made", local).scaled
    scaled.save(tmp_path / "problem.npz")
    loaded = Arrays.load(tmp_path / "problem.npz")
    file = tmp_path / "problem.dat"
    file.write_text(block_text(loaded), encoding="ascii")
    again = read_siconos(file)
    largest = np.max(abs(local.delassus.data))
    assert np.array_equal(again.delassus.toarray(), local.delassus.toarray() / largest)
    assert np.array_equal(again.offset, scaled.offset)
    assert np.array_equal(again.friction, local.friction)


@pytest.mark.slow
def test_profiles_are_drawn_also_where_nothing_is_solved(tmp_path):
    pytest.importorskip("matplotlib")
    draw({"a": [1.0, np.inf], "b": [2.0, 0.5]}, tmp_path / "some.png", "two")
    draw({"a": [np.inf], "b": [np.inf]}, tmp_path / "none.png", "none")
    assert all((tmp_path / name).stat().st_size > 1000 for name in ("some.png", "none.png"))


def test_what_is_certified_and_wrong_is_told():
    wrong = replace(SOLVED, error=1e-7)
    refused = replace(wrong, claimed=False, remark="NotConverged")
    theirs = replace(wrong, algorithm="Siconos NSGS", ours=False, remark="not solved, though it says so")
    assert [run.verdict for run in (SOLVED, wrong, refused)] == ["solved", "WRONGLY CALLED SOLVED", "NotConverged"]
    assert not replace(SOLVED, claimed=False).solved  # right by luck is not solved
    assert theirs.verdict == "not solved, though it says so"
    names = [f"problem {number}" for number in range(30)]
    runs = [{"default": SOLVED} for _ in names]
    assert published_friction.failures(names, runs, 60.0) == []
    runs[:2] = [{"default": refused}] * 2
    assert published_friction.failures(names, runs, 60.0) == []
    runs[2] = {"default": refused, "Siconos NSGS": theirs}
    assert published_friction.failures(names, runs, 60.0) == ["the default solves 27 of 30, fewer than 28 of 30"]
    runs[2] = {"default": replace(SOLVED, elapsed=61.0), "admm": replace(wrong, algorithm="admm")}
    assert published_friction.failures(names, runs, 60.0) == [
        "problem 2: admm is certified and off by 1e-07",
        "problem 2: the default takes 61.0 s, more than 60 s",
    ]
    assert published_friction.failures(names[:1], [{"default": refused}], 60.0) == [
        "the default solves 0 of 1, fewer than 28 of 30"
    ]


def test_the_best_is_the_fastest_right_one():
    slow, fast = replace(SOLVED, seconds=2.0), replace(SOLVED, seconds=1.0)
    wrong = replace(SOLVED, seconds=0.1, error=1e-3, claimed=False)
    worse = replace(wrong, error=1e-2)
    assert friction_runs.best([slow, wrong, fast]) is fast
    assert friction_runs.best([worse, wrong]) is wrong


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    pytest.importorskip("h5py")
    for number, (dimension, skew) in enumerate([(2, 0.0), (3, 0.0), (3, 0.02)]):
        cq.write_fclib(tmp_path / f"made{number}.hdf5", made(number, dimension=dimension, skew=skew)[0])
    (tmp_path / "README.md").write_text("no problem\n", encoding="utf-8")
    return tmp_path


@pytest.mark.slow
def test_a_bound_that_is_less_than_the_planted_error_is_found(folder, monkeypatch):
    certify_local = cq.certify_local

    def smaller(*arguments, **options):
        found = certify_local(*arguments, **options)
        return replace(found, force_bound=0.9 * found.force_bound)

    problems = list(friction_runs.published_problems(folder))
    assert published_friction.proven(problems, 10.0) == []
    monkeypatch.setattr(published_friction.cq, "certify_local", smaller)
    found = published_friction.proven(problems, 10.0)
    assert found
    assert "hdf5: a planted error of" in found[0]


@pytest.mark.slow
def test_the_table_of_a_folder(folder, capsys, monkeypatch):
    monkeypatch.setattr(siconos_peer, "available", lambda: False)
    assert (
        published_friction.main([str(folder), "--algorithms", "newton", "aclm", "--plot", str(folder / "p.png")]) == 0
    )
    printed = capsys.readouterr().out
    assert "Siconos is not installed" in printed
    assert printed.count("default: newton") == 3
    # Twice the default, two algorithms, those that minimise without polish, and what is proven.
    assert printed.count("made2.hdf5") == 6
    assert "\nglobal 3, local 0, none 0\n" in printed
    assert "not symmetric" in printed
    assert "all targets met" in printed
    assert (folder / "p.png").stat().st_size > 1000


def test_a_folder_is_needed(monkeypatch, tmp_path, capsys):
    monkeypatch.delenv(published_friction.VARIABLE, raising=False)
    with pytest.raises(SystemExit):
        published_friction.main([])
    assert published_friction.VARIABLE in capsys.readouterr().err
    with pytest.raises(SystemExit):
        published_friction.main([str(tmp_path)])
    assert "no problems" in capsys.readouterr().err


@needs_siconos
@pytest.mark.parametrize("dimension", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_siconos_solves_what_was_made(dimension):
    local, _, _ = made(4, dimension=dimension)
    runs = friction_runs.run_siconos(Published("made", local), 10.0)
    assert [run.algorithm for run in runs] == [f"Siconos {name}" for name in siconos_peer.SOLVERS[dimension]]
    assert runs[0].solved
    assert sum(run.solved for run in runs) >= 2
    answer = siconos_peer.solve(Published("made", local).scaled, "NSGS", 10.0)
    assert score(Published("made", local).scaled, answer.force) <= friction_runs.SOLVED
    assert 0 < answer.seconds < 10


@needs_siconos
def test_a_process_that_fails_is_no_answer():
    answer = siconos_peer.solve(one_contact().scaled, "NO_SUCH_SOLVER", 10.0)
    assert answer.force is None
    assert "NO_SUCH_SOLVER" in answer.ended


def test_without_siconos_there_is_none(monkeypatch):
    monkeypatch.setattr(siconos_peer, "PYTHON", "/no/such/python")
    siconos_peer.available.cache_clear()
    assert not siconos_peer.available()
    siconos_peer.available.cache_clear()
