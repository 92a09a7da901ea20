"""Where a call is, said while it lasts."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from contactqp.cli import main, output
from contactqp.cli.solving import whereabouts
from contactqp.linalg import multigrid
from contactqp.linalg.pardiso import SOLVER_VARIABLE
from contactqp.model import arrays
from contactqp.scene.shipped import case_path
from tests.blocks_in_space import fresh, on_paraboloid


def test_the_stages_of_a_solve_are_told_in_their_order() -> None:
    told: list[str] = []
    solution = cq.solve(fresh(on_paraboloid((4, 4, 3))), progress=told.append)
    assert solution.certificate.passed
    stages = [one for one in told if one in arrays.STAGES]
    assert stages[0] == arrays.METHOD
    assert [one for one in stages if one != arrays.METHOD] == [arrays.CONDENSE, arrays.POLISH, arrays.CERTIFY]
    before = len(told)
    cq.solve(fresh(on_paraboloid((4, 4, 3))))
    assert len(told) == before, "nobody asked"


def test_friction_says_which_step_it_is_at() -> None:
    block = cq.ContactProblem(np.eye(2), [0.1, -1.0], [[0.0, -1.0]], [0.0], tangent=[[1.0, 0.0]], friction=0.5)
    told: list[str] = []
    cq.solve(block, algorithm="tresca", progress=told.append)
    assert "friction bounds, step 1" in told
    told.clear()
    cq.solve(block, algorithm="nsgs", progress=told.append)
    assert any(one.startswith("nsgs, step 1: the law is violated by") for one in told)


@pytest.mark.skipif(not multigrid.available(), reason="needs pyamg")
def test_an_iteration_says_what_is_closed_and_sticks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SOLVER_VARIABLE, "pyamg")
    told: list[str] = []
    solution = cq.solve(fresh(on_paraboloid((6, 6, 4), friction=0.3)), progress=told.append)
    closed, stick = np.sum(solution.normal_force > 0), np.sum(solution.contact_status == "stick")
    last = [one for one in told if one.startswith("combination")][-1]
    assert last.endswith(f"{closed} closed, {stick} of them stick")
    assert any(one.startswith("contact set 1: ") for one in told)


def test_what_progress_raises_ends_the_call() -> None:
    class Enough(Exception):
        pass

    def stop(where: str) -> None:
        if where == arrays.CONDENSE:
            raise Enough

    problem = fresh(on_paraboloid((4, 4, 3)))
    with pytest.raises(Enough):
        cq.solve(problem, progress=stop)
    assert cq.solve(problem).certificate.passed  # and leaves nothing behind


def test_what_is_no_function_is_refused() -> None:
    with pytest.raises(cq.InvalidProblem, match="progress: expected a function of one text, got str"):
        cq.solve(on_paraboloid((3, 3, 2)), progress="yes")  # type: ignore[arg-type]


def test_a_terminal_shows_where_a_long_command_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(output.sys.stderr, "isatty", lambda: True, raising=False)
    with whereabouts() as show:
        assert show is not None
        show("condense")
    assert capsys.readouterr().err == "", "it was done at once"
    monkeypatch.setattr(output, "LONG", 0.0)
    with whereabouts() as show:
        assert show is not None
        show("condense")
        show("method")  # too soon to be read
    assert capsys.readouterr().err == "\r\x1b[K0 s: condense\r\x1b[K"


def test_a_command_that_writes_to_a_file_shows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(output, "LONG", 0.0)
    with whereabouts() as show:
        assert show is None


def test_an_enclosed_answer_says_where_it_is() -> None:
    """Refinement and the proof take longer than the solution that they start from."""
    told: list[str] = []
    with arrays.telling(told.append):
        cq.exact(cq.ContactProblem([[1575.0]], [300.0], [[1.0]], [0.125]), enclose=True)
    assert "refine the answer, round 1" in told
    assert told[-1] == "prove the contact set"


def test_oracle_shows_on_a_terminal_where_it_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(output.sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(output, "LONG", 0.0)
    with pytest.raises(SystemExit) as ended:
        main(["oracle", str(case_path("bar_wall"))])
    assert not ended.value.code
    assert capsys.readouterr().err.startswith("\r\x1b[K0 s: ")
