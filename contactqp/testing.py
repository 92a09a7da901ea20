"""For the tests of a contact code: problems with exact answers, and assertions that say what is wrong.

    import pytest
    from contactqp.testing import assert_contact_solution, problems

    @pytest.mark.parametrize("known", problems("redundant", count=5))
    def test_my_code(known):
        displacement, normal_force = my_code(known.problem)
        assert_contact_solution(known, displacement, normal_force, rtol=1e-8)

`problem("truss-over-floor")`, `problem("redundant-17")` give one problem, `problems()` several of every kind, the same
on every machine; each carries its exact answer in doubles and in Fractions (`GalleryProblem`). `check_solver` runs a
solver over them and returns a table. With pytest the fixture `contact_oracle` has all of this.
"""

from __future__ import annotations

from contactqp.oracle.assertions import assert_contact_solution, assert_multipliers
from contactqp.oracle.gallery.gallery import DIFFICULTIES, KINDS, problem, problems
from contactqp.oracle.gallery.problem import ExactAnswer, ExactProblem, GalleryProblem
from contactqp.oracle.solver_check import SolverReport, SolverVerdict, check_solver

__all__ = [
    "DIFFICULTIES",
    "KINDS",
    "ExactAnswer",
    "ExactProblem",
    "GalleryProblem",
    "SolverReport",
    "SolverVerdict",
    "assert_contact_solution",
    "assert_multipliers",
    "check_solver",
    "problem",
    "problems",
]
