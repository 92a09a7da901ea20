"""Provide the pytest plugin with the fixture `contact_oracle` and the mark `contact_gallery`.

It is loaded in every run of pytest if contactqp is installed, and therefore imports nothing until a test uses it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from contactqp.oracle.foreign.crosscheck_verdict import CrossCheck
    from contactqp.oracle.gallery.problem import GalleryProblem
    from contactqp.oracle.judged_answer import JudgedAnswer
    from contactqp.oracle.solver_check import SolverReport

MARK = (
    "contact_gallery(*names, kind=None, difficulty=None, count=None, seed=0): run the test for problems of contactqp's "
    "gallery, each given as `contact_problem`: those of the names, or of a kind (see contactqp.testing.problems)."
)
ARGUMENT = "contact_problem"


class ContactOracle:
    """The functions of `contactqp.testing`, and `certify`, for tests with the fixture `contact_oracle`."""

    def problem(self, name: str) -> GalleryProblem:
        """Return the problem of the gallery with this name."""
        from contactqp.oracle.gallery.gallery import problem

        return problem(name)

    def problems(
        self, kind: str | None = None, difficulty: str | None = None, count: int | None = None, seed: int = 0
    ) -> list[GalleryProblem]:
        """Return problems of the gallery, as `contactqp.testing.problems` does.

        Parameters
        ----------
        kind, difficulty, count, seed
            As there.
        """
        from contactqp.oracle.gallery.gallery import problems

        return problems(kind, difficulty, count, seed)

    def certify(self, problem: Any, *answer: Any, **options: Any) -> JudgedAnswer:
        """Certify an answer as `contactqp.certify`, also for a problem of the gallery."""
        from contactqp.oracle.judged_answer import certify

        return certify(getattr(problem, "problem", problem), *answer, **options)

    def crosscheck(self, path: Any, results: Any = None, **options: Any) -> CrossCheck:
        """Judge the contact of a CalculiX deck as `contactqp.crosscheck`; `assert` fails if it is wrong."""
        from contactqp.oracle.foreign.crosscheck import crosscheck

        return crosscheck(path, results, **options)

    def assert_contact_solution(self, problem: Any, *answer: Any, **options: Any) -> None:
        """Assert that an answer is right: `contactqp.testing.assert_contact_solution`."""
        __tracebackhide__ = True
        from contactqp.oracle.assertions import assert_contact_solution

        assert_contact_solution(problem, *answer, **options)

    def assert_multipliers(self, problem: Any, *forces: Any, **options: Any) -> None:
        """Assert that contact forces are right: `contactqp.testing.assert_multipliers`."""
        __tracebackhide__ = True
        from contactqp.oracle.assertions import assert_multipliers

        assert_multipliers(problem, *forces, **options)

    def check_solver(
        self, solver: Callable[[Any], Any], problems: Iterable[GalleryProblem] | None = None, **options: Any
    ) -> SolverReport:
        """Run a solver over the gallery: `contactqp.testing.check_solver`."""
        from contactqp.oracle.solver_check import check_solver

        return check_solver(solver, problems, **options)


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", MARK)


@pytest.fixture(scope="session")
def contact_oracle() -> ContactOracle:
    """Provide problems with exact answers, and assertions that explain wrong answers: see contactqp.testing."""
    return ContactOracle()


@pytest.fixture
def contact_problem() -> None:
    """Provide a problem of contactqp's gallery with its exact answer, chosen by @pytest.mark.contact_gallery."""
    pytest.fail(
        f"{ARGUMENT}: mark the test with @pytest.mark.contact_gallery, which chooses the problems", pytrace=False
    )


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    mark = metafunc.definition.get_closest_marker("contact_gallery")
    if mark is None:
        return
    where = f"{metafunc.definition.nodeid}: contact_gallery: "
    if ARGUMENT not in metafunc.fixturenames:
        # In a marked class some tests may not use the fixture.
        if mark in getattr(metafunc.function, "pytestmark", []):
            pytest.fail(f"{where}the test takes no argument {ARGUMENT!r}", pytrace=False)
        return
    chosen: list[GalleryProblem] = []
    fault: Exception | None = None
    try:
        chosen = _chosen(*mark.args, **mark.kwargs)
    except (TypeError, ValueError) as error:
        fault = error
    if fault is not None:  # outside of the handler, so that pytest shows no chain of exceptions
        pytest.fail(f"{where}{fault}", pytrace=False)
    metafunc.parametrize(ARGUMENT, chosen, ids=[exact.name for exact in chosen])


def _chosen(
    *names: str, kind: str | None = None, difficulty: str | None = None, count: int | None = None, seed: int = 0
) -> list[GalleryProblem]:
    from contactqp.oracle.gallery.gallery import chosen_problems

    return chosen_problems(names, kind, difficulty, count, seed)
