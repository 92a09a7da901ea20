"""Published problems of frictional contact: every algorithm of ours, and Siconos's beside them.

    python -m benchmarks.published_friction FOLDER
    python -m benchmarks.published_friction FOLDER --algorithms newton admm --plot profiles.png
    python -m benchmarks.published_friction FOLDER --algorithms            # the default only

FOLDER holds files of FCLIB (HDF5) or Siconos (text); without it the environment variable CONTACTQP_FRICTION_DATA names
it. All are scored by the natural-map error after normalisation, W as given (`friction_score.py`), at 1e-8, and Siconos
gets every problem normalised. Where W is not symmetric, the algorithms that minimise run once more without the polish
by Newton's method: what they reach is what the symmetric part of W allows.

Seconds are those of the processor, Siconos's in its driver, so that other work on the machine counts little; time
limits are by the clock. A last table says what `cq.certify_local` proves of the default's forces, held against all
equilibria ("global") or against the only one within a radius ("local"), or why it proves nothing. Then the largest
force is made a thousandth larger: a bound on its error must be no less.

Exit code 1 where the default solves less than 28 of 30, where it takes longer than the time limit, where anything
of ours is certified and its score is missed, or where a bound is less than the error that was planted.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from typing import Any

import numpy as np

import contactqp as cq
from benchmarks import siconos_peer
from benchmarks.friction_runs import (
    ALGORITHMS,
    CONVEX,
    DEFAULT,
    Published,
    Run,
    best,
    published_problems,
    run_ours,
    run_siconos,
    symmetric_floor,
    warm_up,
)
from benchmarks.performance_profiles import draw

VARIABLE = "CONTACTQP_FRICTION_DATA"
# The part of the largest force that is added to one contact, and the verdict that it may pass.
PLANTED, LOOSE = 1e-3, 0.1
# The part of the problems that the default must solve.
NEEDED, OF = 28, 30
# Problems of at most so many contacts are apart: Python's calls alone cost more than Siconos takes.
FEW = 20
NSGS, BEST = "Siconos NSGS", "Siconos, the best of each problem"
HEADER = (
    f"{'problem':<44}{'contacts':>9}{'dim':>4}{'rank':>10}{'asymmetry':>10}  {'algorithm':<28}{'error':>8}"
    f"{'siconos':>9}{'seconds':>10}  verdict"
)


def line(problem: Published, run: Run) -> str:
    """A row of the table."""
    local = problem.local
    by = run.by if run.by.startswith(run.algorithm) else f"{run.algorithm}: {run.by or 'no answer'}"
    return (
        f"{problem.name:<44}{local.contacts:>9}{local.dimension:>4}{f'{problem.rank}/{len(local.offset)}':>10}"
        f"{local.asymmetry:>10.0e}  {by:<28}{run.error:>8.0e}{run.siconos_error:>9.0e}{run.seconds:>10.4f}  "
        f"{run.verdict}"
    )


def one_problem(problem: Published, algorithms: list[str], time_limit: float) -> dict[str, Run]:
    """All runs on a problem, printed as they come."""
    runs: dict[str, Run] = {}
    for name in (DEFAULT, *algorithms):
        runs[name] = run_ours(problem, name, time_limit)
        print(line(problem, runs[name]), flush=True)
    if siconos_peer.available():
        theirs = run_siconos(problem, time_limit)
        for run in theirs:
            print(line(problem, run), flush=True)
        runs |= {NSGS: theirs[0], BEST: best(theirs)}
    return runs


def without_polish(problems: list[Published], time_limit: float) -> None:
    """What minimisations reach where W is not symmetric."""
    print(
        "\nW not symmetric, errors with W as given: floor, of an exact solution with W symmetrised, which\n"
        "minimisations tend to; and the least of each of them on its way, without polish"
    )
    print(f"{'problem':<44}{'asymmetry':>10}{'floor':>8}" + "".join(f"{name:>8}{'seconds':>9}" for name in CONVEX))
    for problem in problems:
        runs = [run_ours(problem, name, time_limit, polish=False) for name in CONVEX]
        print(
            f"{problem.name:<44}{problem.local.asymmetry:>10.0e}{symmetric_floor(problem, time_limit):>8.0e}"
            + "".join(f"{run.error:>8.0e}{run.seconds:>9.2f}" for run in runs),
            flush=True,
        )


def beside(problems: list[Published], runs: list[dict[str, Run]]) -> None:
    """The default and Siconos, a line a problem."""
    others = [name for name in (NSGS, BEST) if name in runs[0]]
    titles = [
        f"{name:<16}{'error':>7}{'seconds':>9}" for name in ("default", "Siconos", "Siconos's best")[: 1 + len(others)]
    ]
    print(f"\n{'problem':<44}{'contacts':>9}{'rank':>10}{'asymmetry':>10}  " + "  ".join(titles))
    for problem, of_one in zip(problems, runs, strict=True):
        local = problem.local
        rank = f"{problem.rank}/{len(local.offset)}"
        cells = [_cell(of_one[name]) for name in (DEFAULT, *others)]
        print(f"{problem.name:<44}{local.contacts:>9}{rank:>10}{local.asymmetry:>10.0e}  " + "  ".join(cells))


def _cell(run: Run) -> str:
    by = (run.by or run.algorithm).removeprefix("Siconos ")
    return f"{by if run.solved else f'({by})':<16}{run.error:>7.0e}{run.seconds:>9.4f}"


def ratios(problems: list[Published], runs: list[dict[str, Run]]) -> None:
    """The default's seconds in units of those of Siconos's best, where both solve, apart by size."""
    solved = [
        (problem.local.contacts > FEW, of_one[DEFAULT].seconds / of_one[BEST].seconds)
        for problem, of_one in zip(problems, runs, strict=True)
        if BEST in of_one and of_one[DEFAULT].solved and of_one[BEST].solved
    ]
    for many, size in ((True, f"more than {FEW}"), (False, f"at most {FEW}")):
        found = sorted(ratio for is_many, ratio in solved if is_many == many)
        if found:
            listed = ", ".join(f"{ratio:.2g}" for ratio in found)
            print(f"seconds over Siconos's best, {size} contacts: median {np.median(found):.2g} of {listed}")


def summary(runs: list[dict[str, Run]]) -> None:
    """One line an algorithm."""
    print(f"\n{'algorithm':<36}{'solved':>12}{'wrong':>7}{'median s':>10}{'longest s':>11}{'largest error solved':>22}")
    for name in runs[0]:
        column = [of_one[name] for of_one in runs]
        solved = [run for run in column if run.solved]
        times = [run.seconds for run in solved] or [np.nan]
        print(
            f"{name:<36}{f'{len(solved)} of {len(column)}':>12}{sum(run.wrong for run in column):>7}"
            f"{np.median(times):>10.3f}{max(times):>11.2f}{max((run.error for run in solved), default=np.nan):>22.0e}"
        )


def proven(problems: list[Published], time_limit: float) -> list[str]:
    """What is proven of the default's forces, a line a problem; returned is what was too small."""
    print(f"\n{'problem':<44}{'contacts':>9}{'scope':>8}{'bound':>9}{'solve s':>9}{'bound s':>9}  why there is none")
    found, counts = [], dict.fromkeys(("global", "local", "none"), 0)
    for problem in problems:
        began = time.perf_counter()
        try:
            solution = cq.solve(problem.local, time_limit=time_limit)
        except cq.ContactQPError:
            continue
        solved = time.perf_counter()
        judged = cq.certify_local(problem.local, solution.force)
        spent = time.perf_counter() - solved
        counts[judged.scope or "none"] += 1
        bound = "" if judged.force_error is None else f"{judged.force_error:.0e}"
        why = "".join(judged.reasons).removeprefix("force_error, force_bound: ")
        print(
            f"{problem.name:<44}{problem.local.contacts:>9}{judged.scope or '':>8}{bound:>9}{solved - began:>9.4f}"
            f"{spent:>9.4f}  {why}",
            flush=True,
        )
        found += _hidden(problem, solution.force)
    print(", ".join(f"{scope} {count}" for scope, count in counts.items()))
    return found


def _hidden(problem: Published, force: Any) -> list[str]:
    """Whether a bound on forces with an error that was planted is less than that."""
    planted, worst = force.copy(), int(np.argmax(abs(force[:, 0])))
    planted[worst, 0] *= 1 + PLANTED
    judged = cq.certify_local(problem.local, planted, tolerance=LOOSE)
    apart = abs(planted - force)[worst, 0]
    if judged.force_bound is None or judged.force_bound[worst] >= apart * (1 - 1e-6):
        return []
    return [f"{problem.name}: a planted error of {apart:.3g} is bounded by {judged.force_bound[worst]:.3g}"]


def failures(names: list[str], runs: list[dict[str, Run]], time_limit: float) -> list[str]:
    """What was promised and not kept."""
    found = []
    solved = sum(of_one[DEFAULT].solved for of_one in runs)
    if OF * solved < NEEDED * len(runs):
        found.append(f"the default solves {solved} of {len(runs)}, fewer than {NEEDED} of {OF}")
    for name, of_one in zip(names, runs, strict=True):
        found += [
            f"{name}: {run.algorithm} is certified and off by {run.error:.1g}"
            for run in of_one.values()
            if run.ours and run.wrong
        ]
        if of_one[DEFAULT].elapsed > time_limit:
            found.append(f"{name}: the default takes {of_one[DEFAULT].elapsed:.1f} s, more than {time_limit:g} s")
    return found


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", default=os.environ.get(VARIABLE), help=f"by default that of {VARIABLE}")
    parser.add_argument("--algorithms", nargs="*", choices=ALGORITHMS, default=list(ALGORITHMS))
    parser.add_argument("--plot", type=Path, help="draw performance profiles to this file")
    parser.add_argument("--time-limit", type=float, default=60.0, help="seconds for each problem and algorithm")
    chosen = parser.parse_args(arguments)
    if chosen.folder is None:
        parser.error(f"no folder of problems was given, and {VARIABLE} is not set")
    problems = list(published_problems(Path(chosen.folder)))
    if not problems:
        parser.error(f"{chosen.folder}: no problems of FCLIB or Siconos in this folder")
    if not siconos_peer.available():
        print(f"Siconos is not installed for {siconos_peer.PYTHON}: ours alone (see benchmarks/siconos_peer.py)")
    warm_up(chosen.algorithms)
    print(HEADER)
    runs = [one_problem(problem, chosen.algorithms, chosen.time_limit) for problem in problems]
    beside(problems, runs)
    ratios(problems, runs)
    summary(runs)
    unsymmetric = [problem for problem in problems if problem.unsymmetric]
    if unsymmetric and set(CONVEX) & set(chosen.algorithms):
        without_polish(unsymmetric, chosen.time_limit)
    if chosen.plot is not None:
        seconds = {
            name: [of_one[name].seconds if of_one[name].solved else np.inf for of_one in runs] for name in runs[0]
        }
        draw(seconds, chosen.plot, f"{len(problems)} published problems, error at most 1e-8")
    missed = failures([problem.name for problem in problems], runs, chosen.time_limit)
    missed += proven(problems, chosen.time_limit)
    print("\n" + ("\n".join(missed) if missed else "all targets met"))
    return int(bool(missed))


if __name__ == "__main__":
    raise SystemExit(main())
