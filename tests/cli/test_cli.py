"""The command line: methods and options, exit codes, one line for an error, nothing imported in vain."""

import json
import subprocess
import sys
import threading
from dataclasses import replace

import numpy as np
import pytest
import scipy

import contactqp.cli
from contactqp.solving.methods.method import Method
from contactqp.study.footprint import Footprint
from tests.cli.commands import CASES, WALL, run
from tests.examples import PUSHED_OFF


def test_a_method_is_run_with_the_knobs_of_the_case(capsys):
    _, out, _ = run(capsys, "run", WALL, "--method", "penalty", "--json")
    assert [one["knobs"]["penalty"] for one in json.loads(out)] == [f"1e{i} kN/m" for i in (4, 5, 6, 7, 8)]


def test_knobs_have_units(capsys):
    code, out, _ = run(capsys, "run", WALL, "--method", "penalty", "--penalty", "1e8 N/mm", "--json")
    (one,) = json.loads(out)
    assert code == 0
    assert one["normal_force"]["tip"] == pytest.approx(5700000 / 40063, rel=1e-12)
    assert len(one["expectations"]) == 2
    for value, words in (("1e8", "without a unit"), ("1e8 kN", "which is a force")):
        code, _, err = run(capsys, "run", WALL, "--method", "penalty", "--penalty", value)
        assert code == 2
        assert words in err


def test_a_knob_that_nobody_states_is_exit_2_and_named_as_on_the_command_line(capsys):
    code, _, err = run(capsys, "run", CASES / "tie_symmetry.toml", "--method", "penalty")
    assert code == 2
    assert 'penalty: the case states no penalty: state one with its unit, such as --penalty "1e8 kN/m"' in err


def test_options_reach_the_method(capsys):
    code, _, _ = run(capsys, "run", WALL, "--method", "augmented-lagrangian", "--option", "update=uzawa")
    assert code == 0
    code, _, err = run(capsys, "run", WALL, "--method", "active-set", "--option", "colour=red")
    assert code == 2
    assert "colour" in err
    assert run(capsys, "run", WALL, "--option", "colour")[0] == 2


def test_several_methods(capsys):
    code, out, _ = run(capsys, "run", WALL, "--method", "active-set", "--method", "lemke", "--json")
    assert code == 0
    assert [one["method"] for one in json.loads(out)] == ["active-set", "lemke"]


def test_an_unknown_method_is_exit_2_with_the_nearest_name(capsys):
    for written, meant in (
        ("activ-set", "active-set"),
        ("OSQPP", "osqp"),
        ("Augmented_Lagrange", "augmented-lagrangian"),
    ):
        code, _, err = run(capsys, "run", WALL, "--method", written)
        assert code == 2
        assert f"nearest: {meant}" in err
        assert err.count("\n") == 1
    assert "the methods: active-set, " in run(capsys, "run", WALL, "--method", "xyz")[2]


def test_a_method_that_is_not_installed_is_exit_3(capsys, monkeypatch):
    monkeypatch.setattr(Method, "installed", property(lambda self: self.name != "clarabel"))
    code, _, err = run(capsys, "run", WALL, "--method", "clarabel")
    assert code == 3
    assert "pip install" in err


def test_no_equilibrium_is_exit_1_in_one_line(capsys, tmp_path):
    file = tmp_path / "loose.toml"
    file.write_text(PUSHED_OFF)
    code, _, err = run(capsys, "run", file)
    assert code == 1
    assert err.count("\n") == 1
    assert str(file) in err
    (data,) = json.loads(run(capsys, "run", file, "--json")[1])
    assert data["failure"]


@pytest.mark.sampled(40)
@pytest.mark.parametrize("case", sorted(CASES.glob("*.toml")), ids=lambda case: case.stem)
def test_explain_says_what_is_in_a_case(case, capsys):
    code, out, _ = run(capsys, "explain", "--no-solve", case)
    assert code == 0
    assert "left out" in out
    data = json.loads(run(capsys, "explain", "--no-solve", case, "--json")[1])
    assert data["unknowns"]
    assert data["footprint"] is None


@pytest.mark.slow
def test_explain_says_what_the_answer_takes(capsys):
    code, out, err = run(capsys, "explain", WALL)
    assert (code, err) == (0, "")
    for words in ("certificate passed", "import modules", "certify", "0 factorisations", "1 looked at, 1 kept", "MiB"):
        assert words in out
    (left_out,) = (line for line in out.splitlines() if line.startswith("not imported:"))
    assert "osqp" in left_out


def test_explain_explains_what_has_no_answer(capsys, monkeypatch):
    footprint = Footprint(WALL, "active-set", failure="the process died of SIGSEGV")
    monkeypatch.setattr("contactqp.study.footprint.measure", lambda case, **_: replace(footprint, case=case))
    code, out, _ = run(capsys, "explain", WALL)
    assert code == 0
    assert "left out" in out
    assert " ".join(out.split()).endswith("no answer: the process died of SIGSEGV")
    code, out, _ = run(capsys, "explain", WALL, "--json")
    assert json.loads(out)["footprint"] == json.loads(json.dumps(footprint.data()))
    assert json.loads(out)["unknowns"] == ["1.x"]


@pytest.mark.sampled(5)
@pytest.mark.parametrize(
    "arguments",
    [["methods"], ["gallery", "--list"], ["explain", WALL], ["cases", "bar"], ["run", CASES / "truss_floor.toml"]],
)
def test_what_goes_into_a_pipe_is_80_columns_wide_unless_columns_says_otherwise(capsys, monkeypatch, arguments):
    monkeypatch.delenv("COLUMNS", raising=False)
    widths = [max(map(len, run(capsys, *arguments)[1].splitlines()))]
    monkeypatch.setenv("COLUMNS", "150")
    widths.append(max(map(len, run(capsys, *arguments)[1].splitlines())))
    assert widths[0] <= 80
    assert 80 < widths[1] <= 150 or arguments[0] == "cases"


def test_methods_are_listed(capsys):
    code, out, _ = run(capsys, "methods")
    assert code == 0
    assert "active-set" in out
    data = {one["name"]: one for one in json.loads(run(capsys, "methods", "--json")[1])}
    assert data["penalty"]["knob"] == "penalty"
    assert data["active-set"]["installed"] is True


def test_wrong_usage_is_exit_2(capsys):
    assert run(capsys, "run")[0] == 2
    assert run(capsys, "walk")[0] == 2
    assert run(capsys, "--help")[0] == 0


def test_interruption_is_quiet(capsys, monkeypatch):
    def interrupt(_):
        raise KeyboardInterrupt

    monkeypatch.setattr("contactqp.scene.scene.load_scene", interrupt)
    code, _, err = run(capsys, "run", WALL)
    assert code == 130
    assert err.strip() == "contactqp: interrupted"


def test_python_m_is_the_command_line_and_imports_nothing_in_vain():
    script = (
        "import sys\nfrom contactqp.cli import main\ntry:\n    main(['run', sys.argv[1]])\nexcept SystemExit as e:\n"
        "    print(e.code, *sorted(sys.modules), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", script, WALL], capture_output=True, text=True, check=True)
    code, *modules = done.stderr.split()
    assert code == "0"
    heavy = {
        "cvxpy",
        "matplotlib",
        "skfem",
        "qpsolvers",
        "osqp",
        "clarabel",
        "piqp",
        "highspy",
        "scs",
        "daqp",
        "sympy",
        "pandas",
        "h5py",
        "dask",
    }
    assert not heavy & {name.partition(".")[0] for name in modules}
    assert "scipy.spatial" not in modules
    left_by_numpy = {f"numpy.{name}" for name in ("f2py", "testing", "polynomial", "char", "ctypeslib")}
    assert not left_by_numpy & set(modules) or np.lib.NumpyVersion(np.__version__) < "2.0.0"
    assert "scipy.sparse.linalg" not in modules or scipy.__version__ < "1.15"  # which brings it with scipy.sparse
    ours = {name for name in modules if name.startswith("contactqp.")}
    not_needed = (
        "exchange",
        "friction",
        "analysis.motion",
        "analysis.load_path",
        "analysis.large_deformation",
        "elements.mesh",
        "elements.reference_elements",
        "elements.shapes",
        "elements.solid",
        "elements.surface",
        "study",
    )
    assert not [name for name in ours if name.removeprefix("contactqp.").startswith(not_needed)]
    listed = subprocess.run([sys.executable, "-m", "contactqp", "methods"], capture_output=True, text=True, check=True)
    assert "active-set" in listed.stdout


@pytest.mark.parametrize(
    ("arguments", "code", "ending"),
    [
        (("run", "nowhere.toml"), "invalid-scene", 2),
        (("run", WALL, "--method", "penalty", "--option", "bet=1"), "invalid-problem", 2),
        (("run", WALL, "--method"), "usage", 2),
        (("oracle", "nowhere.toml"), "invalid-scene", 2),
        (("explain", "nowhere.toml"), "invalid-scene", 2),
        (("check", WALL, "nowhere.json"), "invalid-problem", 2),
        (("gallery",), "invalid-problem", 2),
        (("methods", "--jsn"), "usage", 2),
    ],
)
def test_with_json_errors_are_json_as_well(capsys, arguments, code, ending):
    exit_code, out, err = run(capsys, *arguments[:1], "--json", *arguments[1:])
    data = json.loads(out)
    assert (data["code"], data["exit"], exit_code) == (code, ending, ending)
    assert data["error"] in " ".join(err.split())
    assert run(capsys, *arguments)[1] == ""


def test_a_problem_without_an_answer_has_the_code_of_its_error(capsys, tmp_path):
    contactqp.write_problem(tmp_path / "pulled", contactqp.ContactProblem([[0.0]], [-1.0], [[1.0]], [0.0]))
    (data,) = json.loads(run(capsys, "run", tmp_path / "pulled", "--json")[1])
    assert data["code"] == "no-equilibrium"
    assert "drives" in data["failure"]


def test_an_energy_beyond_all_doubles_is_null_in_json(capsys, tmp_path):
    contactqp.write_problem(tmp_path / "far", contactqp.ContactProblem([[1.0]], [1e200], [[1.0]], [1e300]))
    exit_code, out, _ = run(capsys, "run", tmp_path / "far", "--json")
    (data,) = json.loads(out)
    assert exit_code == 0
    assert data["energy"] is None
    assert "1e+200" in out


def test_a_case_without_an_answer_has_the_code_of_its_error(capsys):
    stopped = ("--method", "osqp", "--option", "max_iter=1", "--option", "polish=false")
    (data,) = json.loads(run(capsys, "run", WALL, *stopped, "--json")[1])
    assert data["code"] == "not-converged"
    assert "maximum iterations reached" in data["failure"]


@pytest.mark.slow
def test_a_process_of_the_commands_own_does_not_look_for_garbage_at_its_end(monkeypatch, capsys):
    """Of 0.73 s of processor time 0.14 s went into that. Processes that call `main` themselves go on as they were."""
    calls: list[int] = []
    monkeypatch.setattr("gc.freeze", lambda: calls.append(1))
    monkeypatch.setattr("sys.argv", ["contactqp", "run", WALL])
    for arguments, count in ((["run", WALL], 0), (None, 2)):
        with pytest.raises(SystemExit):
            contactqp.cli.main(arguments)
        assert len(calls) == count
    capsys.readouterr()


def test_cases_side_by_side_print_what_they_print_one_by_one(capsys, tmp_path):
    """Also warnings of where a contact starts, and what is not met."""
    text = (CASES / "bar_wall.toml").read_text(encoding="utf-8")
    turned = tmp_path / "turned.toml"
    turned.write_text(text.replace("normal = [-1]", "normal = [1]"), encoding="utf-8")
    files = [turned, CASES / "two_bars.toml"]
    one_by_one, together = (run(capsys, "run", *files, "--jobs", jobs) for jobs in ("1", "2"))
    assert one_by_one == together
    assert not [thread.name for thread in threading.enumerate() if "Executor" in type(thread).__name__]
    code, out, err = together
    assert code == 1
    assert err.count("contactqp: warning: ") == 1
    assert out.splitlines()[-1].startswith("1 of 2 met")


@pytest.mark.slow
def test_certificates_of_cases_side_by_side_are_those_of_one_by_one(capsys):
    files = [CASES / f"{name}.toml" for name in ("truss_floor", "bar_wall", "two_bars")]
    both = [json.loads(run(capsys, "run", *files, "--jobs", jobs, "--json")[1]) for jobs in ("1", "3")]
    assert [one["certificate"] for one in both[0]] == [one["certificate"] for one in both[1]]


@pytest.mark.slow
def test_an_error_of_a_case_side_by_side_is_one_line(capsys):
    code, out, err = run(capsys, "run", *[CASES / f"{name}.toml" for name in ("bar_wall", "two_bars")], "--jobs", "2",
                         "--method", "nonesuch")  # fmt: skip
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert "no method is called 'nonesuch'" in err


def test_a_time_limit_is_that_of_a_case(capsys):
    code, _, err = run(capsys, "run", WALL, "--time-limit", "1e-9")
    assert code == 1
    assert "active-set: stopped at the time limit of 1e-09 s, before the stiffness was condensed" in err
    assert run(capsys, "run", WALL, "--time-limit", "600", "--quiet")[0] == 0
    for wrong in ("0", "-1", "nan"):
        code, _, err = run(capsys, "run", WALL, "--time-limit", wrong)
        assert code == 2
        assert "--time-limit: expected a positive number of seconds" in err


def test_options_of_no_method_are_not_dropped(capsys):
    for option in (("--option", "facets=8"), ("--penalty", "1 kN/m")):
        code, _, err = run(capsys, "run", WALL, *option)
        assert code == 2
        assert "belongs to a method; state it by --method" in err


def test_an_option_goes_to_the_methods_that_take_it(capsys):
    code, out, err = run(
        capsys, "run", WALL, "--method", "penalty", "--penalty", "1e8 kN/m", "--method", "osqp", "--json"
    )
    assert err == ""
    assert [(one["method"], sorted(one["knobs"])) for one in json.loads(out)] == [
        ("penalty", ["penalty"]),
        ("osqp", []),
    ]
    code, _, err = run(capsys, "run", WALL, "--method", "osqp", "--method", "lemke", "--penalty", "1e8 kN/m")
    assert code == 2
    assert "osqp: unknown option 'penalty'; options of its own: none; of every method: tolerance, " in err
