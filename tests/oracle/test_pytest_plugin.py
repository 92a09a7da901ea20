"""The plugin in scratch projects of its own: fixture, mark, messages, and what it costs others."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from contactqp import testing

ROOT = Path(__file__).parents[2]

TESTS = """
    import numpy as np
    import pytest

    def my_code(problem):
        K, E = np.asarray(problem.stiffness), problem.normal.toarray()
        force = np.linalg.solve(E @ np.linalg.solve(K, E.T), E @ np.linalg.solve(K, problem.load) - problem.gap)
        return np.linalg.solve(K, problem.load - E.T @ force), force

    def test_right(contact_oracle):
        known = contact_oracle.problem("truss-over-floor")
        contact_oracle.assert_contact_solution(known, *my_code(known.problem))
        contact_oracle.assert_multipliers(known, my_code(known.problem)[1], rtol=1e-8)
        assert contact_oracle.certify(known, *my_code(known.problem)).passed

    def test_wrong_sign(contact_oracle):
        known = contact_oracle.problem("bar-and-wall")
        displacement, force = my_code(known.problem)
        contact_oracle.assert_contact_solution(known, displacement, -force)
"""


@pytest.fixture
def run(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch):  # type: ignore[no-untyped-def]
    """Runs pytest as a process of its own with our plugin and no other; warnings are errors."""
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))

    def call(source: str, *arguments: str) -> pytest.RunResult:
        pytester.makepyfile(source)
        options = ("-p", "contactqp.oracle.pytest_plugin", "-W", "error", "--strict-markers", *arguments)
        return pytester.runpytest_subprocess(*options)

    return call


def test_a_wrong_sign_fails_with_the_diagnosis_and_nothing_else(run) -> None:  # type: ignore[no-untyped-def]
    result = run(TESTS)
    result.assert_outcomes(passed=1, failed=1)
    output = result.stdout.str()
    errors = [line[1:].strip() for line in output.splitlines() if line.startswith("E ")]
    assert errors[0] == "AssertionError: bar-and-wall: the answer is wrong (rtol 1e-09)"
    assert errors[1] == "all contact forces have the opposite sign: with compression='negative' this answer is right"
    row = next(line for line in errors if line.startswith("wall  "))
    assert "-142.5" in row
    assert " 142.5" in row
    assert any("force [kN]" in line for line in errors)
    # The line of the test is shown, none of ours is.
    assert "contact_oracle.assert_contact_solution(known, displacement, -force)" in output
    assert "assertions.py" not in output
    assert "pytest_plugin.py" not in output


@pytest.mark.slow
def test_the_mark_gives_problems_by_kind_and_by_name(run) -> None:  # type: ignore[no-untyped-def]
    result = run(
        """
        import contactqp as cq
        import pytest

        @pytest.mark.contact_gallery(kind="redundant", count=2)
        def test_kind(contact_problem, contact_oracle):
            solution = cq.solve(contact_problem.problem)
            contact_oracle.assert_multipliers(contact_problem, solution.normal_force)

        @pytest.mark.contact_gallery("wedge", "tied-4")
        @pytest.mark.parametrize("method", ["active-set", "osqp"])
        def test_names(contact_problem, method):
            assert contact_problem.name in ("wedge", "tied-4")

        @pytest.mark.contact_gallery(kind="stiff", difficulty="hard", count=1, seed=5)
        class TestInAClass:
            def test_one(self, contact_problem):
                assert contact_problem.name == "stiff-5"

            def test_without(self):
                pass

        @pytest.mark.contact_gallery(kind="tied", count=0)
        def test_none(contact_problem):
            raise AssertionError
        """,
        "-v",
    )
    result.assert_outcomes(passed=8, skipped=1)
    for name in ("test_kind[redundant-0]", "test_kind[redundant-1]", "test_names[wedge-osqp]", "test_one[stiff-5]"):
        result.stdout.fnmatch_lines([f"*{name.replace('[', '[[]')}*PASSED*"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mark", "words"),
    [
        ('kind="redundnat"', "*kind: expected one of named, well-posed, *got 'redundnat' (did you mean 'redundant'?)*"),
        ('"bar-and-wal"', "*no problem is called 'bar-and-wal'; did you mean 'bar-and-wall'?*"),
        ('kinds="tied"', "*unexpected keyword argument 'kinds'*"),
        ('"wedge", kind="tied"', "*expected names or a kind, got both*"),
    ],
)
def test_a_mark_that_names_nothing_is_refused(run, mark: str, words: str) -> None:  # type: ignore[no-untyped-def]
    result = run(f"""
        import pytest

        @pytest.mark.contact_gallery({mark})
        def test_one(contact_problem):
            pass
        """)
    assert result.ret != 0
    result.stdout.fnmatch_lines([words])
    assert "Traceback" not in result.stdout.str()
    assert "During handling" not in result.stdout.str()


@pytest.mark.slow
def test_a_mark_on_a_test_that_takes_no_problem_is_refused(run) -> None:  # type: ignore[no-untyped-def]
    result = run("""
        import pytest

        @pytest.mark.contact_gallery("wedge")
        def test_one():
            pass
        """)
    assert result.ret != 0
    result.stdout.fnmatch_lines(["*contact_gallery: the test takes no argument 'contact_problem'*"])


@pytest.mark.slow
def test_a_problem_without_a_mark_says_what_is_missing(run) -> None:  # type: ignore[no-untyped-def]
    result = run("def test_one(contact_problem): pass")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines(["*contact_problem: mark the test with @pytest.mark.contact_gallery*"])


@pytest.mark.slow
def test_others_are_neither_slowed_nor_warned(run) -> None:  # type: ignore[no-untyped-def]
    """A run that asks for nothing of ours has imported nothing but the plugin."""
    result = run("""
        import sys

        def test_nothing_is_imported():
            ours = sorted(name for name in sys.modules if name.startswith("contactqp"))
            assert ours == ["contactqp", "contactqp.oracle", "contactqp.oracle.pytest_plugin"]
            assert not {"numpy", "scipy", "click", "cvxpy"} & set(sys.modules)
        """)
    result.assert_outcomes(passed=1)
    run("def test_one(contact_problem): pass", "--markers").stdout.fnmatch_lines(["@pytest.mark.contact_gallery*"])


def test_the_entry_point_names_the_plugin() -> None:
    assert (
        '[project.entry-points.pytest11]\ncontactqp = "contactqp.oracle.pytest_plugin"\n'
        in (ROOT / "pyproject.toml").read_text()
    )


@pytest.mark.slow
def test_the_guide_shows_what_is_printed(run, pytester: pytest.Pytester) -> None:  # type: ignore[no-untyped-def]
    section = (ROOT / "docs" / "guide" / "testing.md").read_text()
    source, shown = (re.findall(rf"```{kind}\n(.*?)```", section, re.DOTALL)[0] for kind in ("python", "text"))
    pytester.makepyfile(
        my_code="""
        import contactqp as cq

        def solve(K, f, E, g):
            found = cq.solve(cq.ContactProblem(stiffness=K, load=f, normal=E, gap=g))
            return found.displacement, found.normal_force
        """
    )
    result = run(source)
    result.assert_outcomes(passed=5, failed=1)
    assert shown in result.stdout.str()
    kinds = tuple(re.findall(r"^\| `([a-z-]+)` \|", section, re.MULTILINE))
    assert kinds == testing.KINDS
    assert f": {len(testing.problems('named'))} from courses" in section
    sizes = [known.problem.contacts for known in testing.problems("large")]
    assert f"{min(sizes)} to {max(sizes)} contacts" in section


@pytest.mark.slow
def test_nothing_but_pip_install_is_needed(tmp_path: Path) -> None:
    """A wheel in a new environment with the core dependencies and pytest alone; the plugin is found by itself."""
    clean = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}

    def call(*command: str | Path, code: int = 0) -> str:
        done = subprocess.run([str(part) for part in command], capture_output=True, text=True, cwd=tmp_path, env=clean)
        assert done.returncode == code, done.stdout + done.stderr
        return done.stdout

    call(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", tmp_path / "wheels", ROOT)
    call(sys.executable, "-m", "venv", tmp_path / "new")
    python = tmp_path / "new" / "bin" / "python"
    (wheel,) = (tmp_path / "wheels").glob("contactqp-*.whl")
    call(python, "-m", "pip", "install", "--quiet", wheel, "pytest")
    installed = call(python, "-m", "pip", "list").lower()
    assert not any(extra in installed for extra in ("flint", "h5py", "matplotlib", "scikit-fem"))
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    lines = [line[4:] for line in TESTS.splitlines()]
    marked = [
        "@pytest.mark.contact_gallery(count=2)",
        "def test_solver(contact_problem, contact_oracle):",
        "    import contactqp as cq",
        "    found = cq.solve(contact_problem.problem)",
        "    contact_oracle.assert_contact_solution(",
        "        contact_problem, found.displacement, found.normal_force, found.friction_force, found.tie_force",
        "    )",
    ]
    (scratch / "test_code.py").write_text("\n".join([*lines, *marked, ""]))
    output = call(python, "-m", "pytest", "-W", "error", "--strict-markers", scratch, code=1)
    assert "1 failed, " in output
    assert "bar-and-wall: the answer is wrong (rtol 1e-09)" in output
    assert "all contact forces have the opposite sign" in output
    assert "warning" not in output
    assert str(tmp_path / "new") in call(python, "-c", "import contactqp; print(contactqp.__file__)")
