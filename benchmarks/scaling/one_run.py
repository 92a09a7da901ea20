"""One problem on the ranks that this is started on; the first one writes what was measured.

mpiexec -n 2 python -m benchmarks.scaling.one_run --across 40 --write run.json
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.scaling.case import block
from contactqp.distributed.distributed_bodies import distributed_model
from contactqp.distributed.iteration import DistributedIteration
from contactqp.distributed.preconditioner import chosen_solver
from contactqp.distributed.problem import DistributedProblem, DistributedSolution
from contactqp.distributed.ranks import Ranks, aij_copy, petsc
from contactqp.distributed.solving import ENERGY, iteration_of, solve_distributed

# What PETSc logs of a solution by conjugate gradients; each counts what happens inside of it too.
EVENTS = ("KSPSolve", "MatMult", "PCApply")
COUNTED = ("numMessages", "messageLength", "numReductions", "flops", "count")


class CountingRanks(Ranks):
    """Ranks that count how often they meet."""

    met = 0

    def sum(self, value: Any) -> Any:
        self.met += 1
        return super().sum(value)

    def max(self, value: Any) -> Any:
        self.met += 1
        return super().max(value)

    def any(self, flags: Any) -> bool:
        self.met += 1
        return super().any(flags)

    def dot(self, a: Any, b: Any) -> float:
        self.met += 1
        return super().dot(a, b)

    def gathered(self, values: Any) -> Any:
        self.met += 1
        return super().gathered(values)


def timed(ranks: Ranks, work: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds of the slowest rank from a common start, and what came out."""
    ranks.comm.barrier()
    started = time.perf_counter()
    found = work()
    return float(ranks.max(time.perf_counter() - started)), found


def processor(ranks: Ranks, since: float = 0.0) -> float:
    """Seconds of processors, of all ranks together: other work on the machine changes them little."""
    return float(ranks.sum(time.process_time() - since))


def peak(ranks: Ranks) -> list[float]:
    """The largest memory of each rank so far [MiB]."""
    return [float(value) for value in ranks.comm.allgather(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)]


def linear(problem: DistributedProblem, solver: str) -> dict[str, Any]:
    """K u = f without contact by PETSc's own conjugate gradients and the preconditioner that contact has.

    It ends where the residual in the norm of the preconditioner, the energy of the error, is ENERGY of that of the
    load: what the contact problem is solved to.
    """
    PETSc, ranks = petsc(), problem.ranks
    stiffness = aij_copy(problem.stiffness)
    stiffness.setNearNullSpace(_near_null_space(problem, stiffness))
    ksp = PETSc.KSP().create(stiffness.comm)
    ksp.setOptionsPrefix("linear_")
    ksp.setType("cg")
    ksp.setNormType(PETSc.KSP.NormType.NATURAL)
    ksp.setTolerances(rtol=ENERGY, atol=0.0, max_it=2000)
    ksp.setOperators(stiffness)
    ksp.getPC().setType(solver)
    options = PETSc.Options()
    if solver == "hypre":
        options["linear_pc_hypre_boomeramg_strong_threshold"] = 0.5
    ksp.setFromOptions()
    into, load = stiffness.createVecs()
    load.array[:] = problem.load
    started = time.process_time()
    set_up, _ = timed(ranks, ksp.setUp)
    before = _events()
    seconds, _ = timed(ranks, lambda: ksp.solve(load, into))
    found: dict[str, Any] = {"set_up": set_up, "solve": seconds, "steps": ksp.getIterationNumber()}
    found["processor"] = processor(ranks, started)
    steps = max(1, found["steps"])
    found["per_step"] = {
        name: {
            what: [value / steps for value in ranks.comm.allgather(after[what] - before[name][what])]
            for what in COUNTED
        }
        for name, after in _events().items()
    }
    found["levels"] = _levels(ksp.getPC(), solver)
    ksp.destroy()
    stiffness.destroy()
    return found


def _near_null_space(problem: DistributedProblem, stiffness: Any) -> Any:
    """The rigid motions, made orthonormal."""
    basis: list[Any] = []
    for motion in problem.near_null_space.T:
        v = stiffness.createVecRight()
        v.array[:] = motion
        for known in basis:
            v.axpy(-v.dot(known), known)
        v.normalize()
        basis.append(v)
    return petsc().NullSpace().create(vectors=basis, comm=stiffness.comm)


def _events() -> dict[str, dict[str, float]]:
    return {name: dict(petsc().Log.Event(name).getPerfInfo()) for name in EVENTS}


def _levels(pc: Any, solver: str) -> list[dict[str, float]]:
    """Unknowns and nonzeros of each level of GAMG's, the coarsest first."""
    if solver != "gamg":
        return []
    found = []
    for level in range(pc.getMGLevels()):
        A = pc.getMGSmoother(level).getOperators()[0]
        info = A.getInfo(info=A.InfoType.GLOBAL_SUM)
        found.append({"unknowns": A.getSize()[0], "nonzeros": info["nz_used"]})
    return found


def without_contact(problem: DistributedProblem, iteration: DistributedIteration) -> int:
    """Steps of conjugate gradients for K u = f with the multigrid that contact has, to the error that `linear` has."""
    run = iteration.run_without_rows(problem.load.copy())
    enough = ENERGY**2 * run.square()
    while run.square() > enough and run.step():
        pass
    return run.steps


def contact(problem: DistributedProblem, solver: str) -> tuple[dict[str, Any], DistributedSolution]:
    """The contact problem from the first preconditioner to the certificate."""
    problem.computed.clear()
    ranks: Any = problem.ranks
    started = time.process_time()
    set_up, iteration = timed(ranks, lambda: iteration_of(problem, chosen_solver(solver, problem.dimension)))
    before = time.process_time()
    same, same_steps = timed(ranks, lambda: without_contact(problem, iteration))
    started += time.process_time() - before
    met = ranks.met
    seconds, solution = timed(ranks, lambda: solve_distributed(problem, solver=solver))
    worked = processor(ranks, started)
    steps = solution.work.krylov_iterations
    found = {
        "set_up": set_up,
        "active_set": seconds - solution.certify_seconds,
        "certificate": solution.certify_seconds,
        "processor": worked,
        "steps": steps,
        "same_multigrid": {"solve": same, "steps": same_steps},
        "sets": solution.work.iterations,
        "meetings_per_step": (ranks.met - met) / max(1, steps),
        "passed": solution.certificate.passed,
        "proven": solution.certificate.proven,
        "closed": int(ranks.sum(int(np.sum(solution.answer.normal_force > 0)))),
    }
    return found, solution


def measure(across: int, solver: str, repeats: int, answer: Path | None) -> dict[str, Any]:
    """All figures of one problem."""
    petsc().Log.begin()
    ranks = CountingRanks()
    empty = peak(ranks)
    seconds, problem = timed(ranks, lambda: distributed_model(block(across), ranks).problem)
    found: dict[str, Any] = {
        "ranks": ranks.size,
        "across": across,
        "solver": solver,
        "unknowns": problem.dimension,
        "unknowns_here": ranks.comm.allgather(len(problem.load)),
        "contacts": int(ranks.sum(problem.contacts)),
        "nonzeros": problem.stiffness.getInfo(info=problem.stiffness.InfoType.GLOBAL_SUM)["nz_used"],
        "build": seconds,
        "empty_peak": empty,
        "build_peak": peak(ranks),
        "contact": [],
        "linear": [],
    }
    for _ in range(repeats):
        figures, solution = contact(problem, solver)
        if "contact_peak" not in found:
            found["contact_peak"] = peak(ranks)
        if answer is not None:
            whole = {"displacement": solution.displacement, "normal_force": solution.normal_force}
            if ranks.rank == 0:
                np.savez(answer, **whole)
            answer = None
        del solution
        problem.computed.clear()
        found["contact"].append(figures)
        found["linear"].append(linear(problem, solver))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--across", type=int, required=True, help="cells along an edge")
    parser.add_argument("--solver", default="gamg", choices=("gamg", "hypre"))
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--write", type=Path, required=True, metavar="JSON")
    parser.add_argument("--answer", type=Path, metavar="NPZ")
    chosen = parser.parse_args()
    found = measure(chosen.across, chosen.solver, chosen.repeats, chosen.answer)
    if Ranks().rank == 0:
        chosen.write.write_text(json.dumps(found))


if __name__ == "__main__":
    main()
