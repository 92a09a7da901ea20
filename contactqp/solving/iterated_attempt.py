"""The active set by conjugate gradients on the whole problem, where a body is too large to factorise."""

from __future__ import annotations

from contextlib import nullcontext

from contactqp.errors import Unsupported
from contactqp.linalg.iteration import Iteration, iteration
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Final, Work
from contactqp.solving.methods import Method, Settings
from contactqp.solving.methods.inexact_active_set import solve_by_iteration
from contactqp.solving.whole_attempt import WholeAttempt

_ELSE = "to factorise it all the same: CONTACTQP_SPARSE_SOLVER=pardiso or superlu"


class IteratedAttempt(WholeAttempt):
    """The answer, its last system solved to the accuracy that the certificate asks for.

    Raises
    ------
    Unsupported
        Another method than the active set, or a wish to condense.
    NotConverged
        As `solve_by_iteration`.
    """

    def __init__(self, problem: ContactProblem, method: Method, settings: Settings, condense: bool | str) -> None:
        if method.kind != "active set":
            raise Unsupported(
                f"{method.name}: a body this large is not factorised, only iterated on, by active-set; {_ELSE}"
            )
        if condense is True:
            raise Unsupported(f"{method.name}: condensing a body this large means factorising it; {_ELSE}")
        known: Iteration | None = problem._shared.get("iteration")
        self._before = known.krylov_iterations if known else 0
        self._way = iteration(problem)
        self._size = problem.dimension
        self.candidate = solve_by_iteration(problem, self._way, settings)

    def final(self, polished: bool) -> Final:
        """The answer that is to be certified: the candidate."""
        del polished
        return Final(self.candidate.displacement, self.candidate.normal_force, self.candidate.tie_force)

    def counting(self) -> object:
        """A context whose work counts as this attempt's."""
        return nullcontext()

    def work(self, corrections: int) -> Work:
        """What it has cost so far."""
        return Work(
            iterations=self.candidate.iterations,
            retained=self._size,
            polish_corrections=corrections,
            solver=self._way.solver,
            krylov_iterations=self._way.krylov_iterations - self._before,
        )

    def refuse_conflict(self) -> None:
        """Does nothing: constraints that conflict are not told from others without a factorisation."""
