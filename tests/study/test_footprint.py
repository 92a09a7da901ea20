"""A footprint says what one case takes, whatever becomes of the process that measures it."""

import json
import pickle
import sys
import tomllib
from pathlib import Path

import pytest

from contactqp.model.arrays import BUILD, CERTIFY, CONDENSE, METHOD, POLISH, READ, STEPS, timed
from contactqp.scene.building import build
from contactqp.scene.scene import load_scene, run_model
from contactqp.study.footprint import IMPORT, OPTIONAL, Footprint, measure
from contactqp.study.footprint_child import ImportMeter, contact_count, main
from tests.examples import PUSHED_OFF

ROOT = Path(__file__).parents[2]
CASES = ROOT / "cases"


@pytest.fixture(scope="module")
def wall() -> Footprint:
    return measure(CASES / "bar_wall.toml")


@pytest.mark.slow
def test_stages_sum_to_the_total(wall):
    assert [stage.name for stage in wall.stages] == [IMPORT, READ, BUILD, CONDENSE, METHOD, POLISH, CERTIFY]
    assert sum(stage.seconds for stage in wall.stages) == pytest.approx(wall.seconds, rel=0.05)
    assert all(stage.seconds > 0 for stage in wall.stages)


@pytest.mark.slow
def test_a_bar_needs_no_factorisation_and_nothing_optional(wall):
    assert (wall.failure, wall.certified, wall.instants) == (None, True, 1)
    assert (wall.factorisations, wall.back_substitutions) == (0, 0)  # its one unknown is the contact's
    assert (wall.contacts.looked_at, wall.contacts.kept, wall.contacts.dropped) == (1, 1, 0)
    assert {"numpy", "scipy", "pydantic"} <= set(wall.modules.packages)
    assert "contactqp" not in wall.modules.packages
    assert "json" not in wall.modules.packages
    named = {name for _, group in OPTIONAL for name in group}
    assert set(wall.modules.left_out) | set(wall.modules.missing) == named - set(wall.modules.packages)
    in_vain = {
        "pint",
        "dask",
        "skfem",
        "matplotlib",
        "osqp",
        "clarabel",
        "cvxpy",
        "flint",
        "plotly",
        "distributed",
        "rich",
    }
    assert not in_vain & set(wall.modules.packages)


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory by parts is read from /proc")
def test_memory_has_a_share_of_the_interpreter_and_of_modules(wall):
    memory = wall.memory
    assert min(memory.interpreter, memory.modules) > 4e6
    assert memory.peak < 500e6
    assert memory.interpreter + memory.modules < 1.1 * memory.peak


def test_it_is_plain_data(wall):
    assert Footprint.from_data(json.loads(json.dumps(wall.data()))) == wall
    assert pickle.loads(pickle.dumps(wall)) == wall
    nothing = Footprint("a.toml", "active-set", failure="died")
    assert Footprint.from_data(nothing.data()) == nothing


@pytest.mark.slow
def test_work_of_a_path_is_that_of_all_steps():
    path = measure(CASES / "von_mises_arc.toml")
    assert path.certified
    assert path.instants == 25
    assert path.factorisations >= 24  # a tangent a step
    assert STEPS in [stage.name for stage in path.stages]


@pytest.mark.slow
def test_a_case_without_an_answer_is_said_in_one_line(tmp_path):
    file = tmp_path / "loose.toml"
    file.write_text(PUSHED_OFF)
    found = measure(file)
    assert "\n" not in found.failure
    assert not found.certified
    assert found.contacts.looked_at == 1
    assert READ in [stage.name for stage in found.stages]


def test_a_process_that_takes_too_long_or_dies_is_said_in_one_line(monkeypatch):
    late = measure(CASES / "bar_wall.toml", time_limit=0.01)
    assert late.failure == "stopped in a step that had not ended when the time limit of 0.01 s was over"
    monkeypatch.setattr("contactqp.study.footprint.CHILD", "tests.study.dying")
    monkeypatch.setattr(sys, "path", [str(ROOT), *sys.path])
    assert measure("kill").failure == "the process was killed, mostly for want of memory (SIGKILL)"
    assert measure("raise").failure == "the process ended early: ValueError: no such luck"
    assert measure("say").failure == "the process that measured said nothing that can be read"
    monkeypatch.setattr(sys, "executable", "/no/such/python")
    assert measure("say").failure == "no process could be started: No such file or directory"


def test_a_solve_that_takes_too_long_says_where_it_stopped(capsys):
    """`contactqp explain` waited for ever for a path whose steps had no answer."""
    main(str(CASES / "truss_friction.toml"), "active-set", "1e-9")
    late = Footprint.from_data(json.loads(capsys.readouterr().out))
    assert late.failure.startswith("stopped at the time limit of 1e-09 s, before the stiffness was condensed")
    assert late.contacts.kept == 1
    assert READ in [stage.name for stage in late.stages]


def test_imports_have_a_stage_of_their_own():
    sys.modules.pop("this_is_not_there", None)
    with timed() as clock, ImportMeter(clock).watching():
        import json  # noqa: F401  is there already

        with pytest.raises(ImportError):
            import this_is_not_there  # noqa: F401
    assert clock.seconds[IMPORT] > 0
    assert __import__.__name__ == "__import__"


def test_what_is_optional_in_the_extras_is_known_here():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    modules = {"scikit-fem": "skfem", "python-flint": "flint"}
    named = {name for _, group in OPTIONAL for name in group}
    for extra in ("solids", "backends", "exchange", "exact", "fast"):
        names = [line.partition(">")[0] for line in extras[extra]]
        assert {modules.get(name, name) for name in names} <= named


@pytest.mark.slow
def test_contacts_that_are_dropped_are_counted_and_checked(monkeypatch):
    monkeypatch.setattr("contactqp.linalg.iteration.MANY", 40)  # contact unknowns; 3000 otherwise
    monkeypatch.setattr("contactqp.certificate.subset_bounds.FIRST", 20)
    model = build(load_scene(CASES / "hertz_line.toml"))
    history = run_model(model, "active-set")
    count = contact_count(model, history)
    solution = history[-1]
    assert count.looked_at == len(solution.gap) == 81
    assert 0 < count.dropped < 81 - int((solution.normal_force > 0).sum())
    assert count.kept == 81 - count.dropped
    assert solution.certificate.passed
    assert 0 < count.least_dropped_gap <= solution.gap.max()
    assert solution.normal_force[solution.gap >= count.least_dropped_gap].max() == 0.0
