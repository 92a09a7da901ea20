"""Where the steps of a load path with friction jump: no way leads continuously through the step, or several do.

From the state at its start a step is followed again from event to event (`friction_events`). Where that finds no
continuation the step has jumped to an equilibrium beyond; where it finds several, or several equilibria exist at the
end of the step, the step has chosen one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby

from contactqp.analysis.friction_events import ExactPath
from contactqp.certificate.subset_bounds import first_candidates
from contactqp.certificate.uniqueness import SEVERAL
from contactqp.errors import NoEquilibrium, NotConverged, SeveralEquilibria
from contactqp.linalg.condensation import condense
from contactqp.linalg.threads import one_blas_thread
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution
from contactqp.solving.friction.force_system import ForceSystem

SAID_BEFORE = "follow_path: "


def step_notes(problem: ContactProblem, steps: Sequence[Solution], times: Sequence[float]) -> Iterator[str]:
    """One text for every step that jumps or chooses, and one for every run of steps with several equilibria."""
    reason = _not_followed(problem)
    if reason:
        yield f"whether steps jump was not examined: {reason}"
    else:
        with problem.lock, one_blas_thread(problem):
            system = ForceSystem(problem, condense(problem))
            for i in range(len(steps) - 1):
                found = _through(problem, system, steps[i], steps[i + 1], (times[i], times[i + 1]))
                if found:
                    yield f"step to t = {times[i + 1]:.12g}: {found}"
    yield from _several(steps, times)


def _not_followed(problem: ContactProblem) -> str:
    if problem.slip_origin is not None and problem.slip_origin.shape[1] > 1:
        return "two tangential rows a contact"
    return "too many contacts" if first_candidates(problem) is not None else ""


def _through(
    problem: ContactProblem, system: ForceSystem, before: Solution, now: Solution, times: tuple[float, float]
) -> str:
    """What stops the way through one step, or nothing."""
    start, end = times
    path = ExactPath(problem, before, system)
    jump = path.jump_at_start() if start == 0 else ""
    if jump:
        return f"it jumps; {jump}"
    try:
        path.leg(before.problem.load, now.problem.load, start, end - start)
    except NoEquilibrium as error:
        return f"it jumps; {str(error).removeprefix(SAID_BEFORE)}"
    except SeveralEquilibria as error:
        return f"it chooses; {str(error).removeprefix(SAID_BEFORE)}"
    except NotConverged as error:
        return f"whether it jumps was not found out; {str(error).removeprefix(SAID_BEFORE)}"
    return ""


def _several(steps: Sequence[Solution], times: Sequence[float]) -> Iterator[str]:
    """Runs of steps at whose loads the certificate knows of other equilibria."""
    known = [i > 0 and SEVERAL in solution.certificate.uniqueness for i, solution in enumerate(steps)]
    for several, run in groupby(range(len(known)), key=known.__getitem__):
        places = list(run)
        if several:
            first, last = times[places[0]], times[places[-1]]
            when = f"t = {first:.12g}" if first == last else f"t = {first:.12g} to {last:.12g}"
            yield f"{when}: several equilibria exist at this load, and a step takes one of them"
