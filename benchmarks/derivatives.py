"""Hold derivatives against exact rational ones, and say what they and many load cases cost.

    python -m benchmarks.derivatives                     # 10 000 derivatives and more, five minutes
    python -m benchmarks.derivatives --problems 8        # twice as many
    python -m benchmarks.derivatives --cost              # what a gradient and a thousand loads cost

Families of `silently_wrong` and, in the plane, of `friction_random`, problems of up to 24 unknowns, contacts and ties,
with lengths and forces in units near 1e-9, 1 and 1e9, powers of two, so that the exact answers are the same. Rates of
displacements, forces and gaps along random directions of load, gaps, tie values, coefficients, slip origins, stiffness
and rows are compared on either side with those in Fractions. Exit code 1 if one is off by more than 1e-9 of its size in
the square root of energy, if a bound is below the error, of a gradient's product with the direction, too, or if a kink
is not seen, or seen where there is none.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np
import scipy.sparse as sp

import contactqp as cq
from benchmarks.friction_families import CONTACT_FAMILIES, contact_problem
from benchmarks.price_of_contact import block, fresh
from benchmarks.problem_families import FAMILIES, family

LARGEST, FAR, SAME = 24, 1e-9, 1e-9
# Powers of two near 1e-9, 1 and 1e9.
UNITS = (2.0**-30, 1.0, 2.0**30)
QUANTITIES = ("displacement", "normal_force", "gap", "reaction", "energy", "tie_force", "friction_force", "slip")
# Parameters along which answers are linear and the energy is quadratic until a contact's state changes; the step of
# quotients, which is rounded with the parameter, and what they may therefore be off by.
LINEAR, STEP, QUOTIENT = ("load", "gap", "tie_value", "slip_origin"), 2.0**-24, 1e-6
LENGTHS = ("displacement", "gap", "slip")
# Parts of an event a unit of step that the rounding of rates makes, beside gaps a thousand times smaller than others.
ROUNDED = 1e-12


@dataclass
class Tally:
    """What the derivatives of one family showed."""

    counts: Counter[str] = field(default_factory=Counter)
    worst: float = 0.0
    wrong: list[str] = field(default_factory=list)


def in_units(problem: cq.ContactProblem, force: float, length: float) -> cq.ContactProblem:
    """The same problem with other numbers: those of lengths times `length`, those of forces times `force`."""
    data: dict[str, Any] = dict(
        stiffness=problem.stiffness * (force / length), load=problem.load * force, normal=problem.normal,
        gap=problem.gap * length,
    )  # fmt: skip
    if problem.ties:
        data.update(tie=problem.tie, tie_value=problem.tie_value * length)
    if problem.tangent is not None and problem.slip_origin is not None:
        origin = problem.slip_origin * length
        data.update(tangent=problem.tangent, friction=problem.friction, slip_origin=origin)
    return cq.ContactProblem(**data)


def directions(rng: np.random.Generator, problem: cq.ContactProblem) -> dict[str, Any]:
    """A direction of each parameter that the problem has, of the size of the parameter."""
    n, m, k = problem.dimension, problem.contacts, problem.ties
    K = sp.coo_array(problem.stiffness)
    turn = sp.csr_array((K.data * rng.integers(-2, 3, K.nnz), (K.row, K.col)), shape=K.shape)
    far = np.max(abs(problem.load), initial=0.0) or 1.0
    wide = np.max(abs(problem.gap), initial=0.0) or 1.0
    found: dict[str, Any] = dict(
        load=rng.integers(-3, 4, n) * far, gap=rng.integers(-3, 4, m) * wide, stiffness=(turn + turn.T) / 2,
        rows=sp.csr_array(problem.normal.multiply(rng.integers(-2, 3, (m, n)))),
    )  # fmt: skip
    if k:
        found["tie_value"] = rng.integers(-3, 4, k) * wide
    if problem.frictional:
        found.update(friction=rng.integers(0, 3, m) / 8, slip_origin=rng.integers(-3, 4, (m, 1)) * wide)
    return found


def sizes(problem: cq.ContactProblem, solution: cq.Solution) -> dict[str, Any]:
    """What takes a unit of each entry of a quantity to the square root of energy; an energy beside the answer's."""
    unit = 1.0 / np.sqrt(np.where(problem.diagonal > 0, problem.diagonal, 1.0))
    normal = np.sqrt(problem.normal.power(2) @ unit**2)
    tangent = np.zeros(0) if problem.tangent is None else np.sqrt(problem.tangent.power(2) @ unit**2)
    tie = np.sqrt(sp.csr_array(problem.tie).power(2) @ unit**2)
    found = dict(displacement=1 / unit, normal_force=normal, gap=1 / np.maximum(normal, 1e-300), reaction=unit,
                 friction_force=tangent, slip=1 / np.maximum(tangent, 1e-300), tie_force=tie)  # fmt: skip
    met = (solution.displacement / unit, solution.normal_force * normal, problem.load * unit)
    return found | dict(energy=1 / max(*(float(np.max(abs(one), initial=0.0)) for one in met), 1e-300))


def _same_reach(found: tuple[float, float], true: tuple[Any, Any]) -> bool:
    """Whether the steps to the next event are those of the exact answer, as parts of an event a unit of step."""
    parts = [[float(1 / step) if step else np.inf for step in pair] for pair in (found, true)]
    return bool(np.allclose(*parts, rtol=SAME, atol=ROUNDED))


def floats(values: Any) -> np.ndarray:
    return np.array([float(x) for x in np.ravel(values)])


def compare(tally: Tally, where: str, problem: cq.ContactProblem, rng: np.random.Generator) -> None:
    """Compare all derivatives of one problem with the exact ones."""
    try:
        solution, answer = cq.solve(problem), cq.exact(problem, enclose=False)
    except (cq.ContactQPError, ValueError) as error:
        tally.counts[f"no answer: {type(error).__name__}"] += 1
        return
    if solution.certificate.uniqueness:
        tally.counts["several answers"] += 1
        return
    unit = sizes(problem, solution)
    there = dict(friction_force=problem.frictional, slip=problem.frictional, tie_force=problem.ties > 0)
    of = [name for name in QUANTITIES if there.get(name, True)]
    for parameter, direction in directions(rng, problem).items():
        try:
            exact = {name: answer.derivative(name, parameter, direction) for name in of}
        except cq.Unsupported:
            tally.counts["no exact ones"] += 1
            continue
        whole = max((float(np.max(abs(floats(one.right)) * unit[name], initial=0.0)) for name, one in exact.items()
                     if one.right is not None), default=0.0)  # fmt: skip
        for name, true in exact.items():
            found = solution.derivative(name, parameter, direction)
            if found.reach is not None and true.reach is not None and not _same_reach(found.reach, true.reach):
                tally.wrong.append(f"{where}: {name} by {parameter} reaches {found.reach}, exactly {true.reach}")
            if found.right is not None and true.right is None:
                place, asked = f"{where}: {name} by {parameter}", (parameter, direction, name)
                by_quotients(tally, place, answer, solution, asked, found)
            if found.right is None or true.right is None:
                tally.counts["none: " + ("both" if found.right is None and true.right is None else
                             "doubles alone" if found.right is None else "exact alone")] += 1  # fmt: skip
                continue
            sides = ((found.left, true.left), (found.right, true.right))
            errors = [abs(np.ravel(one) - floats(other)) for one, other in sides]
            largest = max(float(np.max(error * unit[name], initial=0.0)) for error in errors)
            relative = largest / whole if whole > 0 else largest
            tally.counts["compared"] += 1
            tally.counts["kinks"] += not true.exists
            tally.worst = max(tally.worst, relative)
            if relative > FAR:
                tally.wrong.append(f"{where}: {name} by {parameter} off by {relative:.2g}")
            differs = float(np.max(abs(floats(true.left) - floats(true.right)) * unit[name], initial=0.0))
            if found.exists != true.exists and not 0 < differs <= 2 * SAME * whole:
                tally.wrong.append(f"{where}: {name} by {parameter}: exists {found.exists}, exactly {true.exists}")
            tally.counts["reaches"] += found.reach is not None and true.reach is not None
            if true.exists and found.exists:
                by_gradient(tally, f"{where}: {name} by {parameter}", solution, (name, parameter, direction), true)
            if found.bound is not None:
                tally.counts["bounds"] += 1
                exact_errors = [
                    abs(Fraction(float(x)) - Fraction(y)) > Fraction(float(bound))
                    for one, other in sides
                    for x, y, bound in zip(np.ravel(one), np.ravel(other), np.ravel(found.bound), strict=True)
                ]
                if any(exact_errors):
                    tally.wrong.append(f"{where}: {name} by {parameter}: a bound is below the error")


def by_gradient(tally: Tally, where: str, solution: cq.Solution, asked: tuple[str, str, Any], true: Any) -> None:
    """Hold the product of a gradient with the direction, and its bound, against the exact rate of a weighted sum."""
    name, parameter, direction = asked
    rate = np.asarray(true.value)
    weights = np.resize(np.arange(-2, 6) / 3, rate.shape)
    try:
        found, bound = solution.pullback(name, weights, parameter, return_bound=True)
    except cq.InvalidProblem:  # not unique in other directions, or a contact grazes that this one leaves
        tally.counts["gradients: none"] += 1
        return
    if bound is None:
        tally.counts["gradients without a bound"] += 1
        return
    entries = [one.toarray() if sp.issparse(one) else np.asarray(one) for one in (found, bound, direction)]
    gradient, apart, along = ([Fraction(float(x)) for x in np.broadcast_to(one, entries[0].shape).ravel()]
                              for one in entries)  # fmt: skip
    exact = sum(
        (Fraction(float(w)) * Fraction(x) for w, x in zip(weights.ravel(), rate.ravel(), strict=True)), Fraction()
    )
    product = sum((x * d for x, d in zip(gradient, along, strict=True)), Fraction())
    allowed = sum((x * abs(d) for x, d in zip(apart, along, strict=True)), Fraction())
    tally.counts["gradients with a bound"] += 1
    if abs(product - exact) > allowed:
        tally.wrong.append(f"{where}: the gradient is off by more than its bound")


def by_quotients(tally: Tally, where: str, answer: Any, solution: cq.Solution, asked: Any, found: Any) -> None:
    """Hold sides of which rational rates are not unique, or of redundant contacts, against exact answers nearby.

    Sides along which the state of a contact changes within the step have no quotients.
    """
    parameter, direction, name = asked
    if parameter not in LINEAR or name == "reaction" or getattr(answer, name) is None:
        return
    problem = solution.problem
    here, given = fractions(answer, name), np.asarray(getattr(problem, parameter))
    change = np.asarray(direction).reshape(given.shape)
    of_all = sizes(problem, solution)
    moved = solution.derivative("displacement", parameter, direction)
    unit, least = of_all[name], ROUNDED * _size_of_lengths(solution, moved, of_all) if name in LENGTHS else 0.0
    pushed = solution.derivative("normal_force", parameter, direction)
    reach = np.min([one.reach or (np.inf, np.inf) for one in (moved, pushed)], axis=0)
    for side, sign, event in ((found.left, -1, reach[0]), (found.right, 1, reach[1])):
        if event < STEP:
            tally.counts["none: exact alone, an event within the step"] += 1
            continue
        steps = [sign * STEP, sign * STEP / 2]
        try:
            others = [cq.exact(problem.replace(**{parameter: given + h * change}), enclose=False) for h in steps]
        except (cq.ContactQPError, ValueError):
            tally.counts["none: exact alone, no answer on a side"] += 1
            continue
        far, near = ([(y - x) / Fraction(h) for x, y in zip(here, fractions(other, name), strict=True)]
                     for other, h in zip(others, steps, strict=True))  # fmt: skip
        true = np.array([float(2 * b - a) for a, b in zip(far, near, strict=True)])
        whole = float(np.max(abs(true) * unit, initial=0.0))
        tally.counts["none: exact alone, held against quotients"] += 1
        if not np.all(abs(np.ravel(side) - true) * unit <= max(QUOTIENT * whole, least)):
            tally.wrong.append(f"{where}: {side} on a side where exact answers change by {true}")


def _size_of_lengths(solution: cq.Solution, moved: Any, unit: dict[str, Any]) -> float:
    """The largest displacement, rate of one, and gap, in the square root of energy, of which rounding is a part."""
    gap = np.where(np.isfinite(solution.problem.gap), abs(solution.problem.gap), 0.0)
    lengths = solution.displacement, *(one for one in (moved.left, moved.right) if one is not None)
    met = *(abs(one) * unit["displacement"] for one in lengths), gap * unit["gap"]
    return max(float(np.max(one, initial=0.0)) for one in met)


def fractions(answer: Any, name: str) -> list[Fraction]:
    return [Fraction(x) for x in ([answer.energy] if name == "energy" else np.ravel(getattr(answer, name)))]


def survey(problems: int) -> int:
    """Print a line for each family; return how many derivatives were wrong."""
    makers = {name: lambda seed, name=name: family(name, seed) for name in FAMILIES}
    makers |= {f"friction: {name}": lambda seed, name=name: contact_problem(name, seed).problem
               for name, kind in CONTACT_FAMILIES.items() if kind[0] == 2}  # fmt: skip
    whole, wrong, started = Counter[str](), 0, time.perf_counter()
    print(
        f"{'family':40s}{'compared':>9s}{'kinks':>7s}{'bounds':>8s}{'none':>6s}{'worst':>9s}{'wrong':>7s}{'so far':>9s}"
    )
    try:
        for name, make in makers.items():
            tally = _of_family(name, make, problems)
            whole += tally.counts
            wrong += len(tally.wrong)
            if tally.counts["compared"]:
                none = sum(count for what, count in tally.counts.items() if what.startswith("none"))
                compared, kinks, bounds = (tally.counts[what] for what in ("compared", "kinks", "bounds"))
                print(f"{name:40s}{compared:9d}{kinks:7d}{bounds:8d}{none:6d}{tally.worst:9.1e}{len(tally.wrong):7d}"
                      f"{whole['compared']:9d}", flush=True)  # fmt: skip
            for message in tally.wrong[:3]:
                print(f"    {message}")
    finally:  # of those so far, where it is interrupted
        print(", ".join(f"{what} {count}" for what, count in sorted(whole.items())), f"wrong {wrong}", sep=", ")
        print(f"{time.perf_counter() - started:.0f} s, {time.process_time():.0f} s of the processor")
    return wrong


def _of_family(name: str, make: Any, problems: int) -> Tally:
    """Compare the derivatives of some problems of a family, each in three units."""
    tally = Tally()
    for seed in range(problems):
        try:
            problem = make(seed)
        except cq.ContactQPError:
            continue
        if problem.dimension + problem.contacts + problem.ties > LARGEST or problem.rigid_change > 0:
            continue
        for force in UNITS:
            changed = in_units(problem, force, UNITS[(UNITS.index(force) + seed) % 3])
            compare(tally, f"{name} {seed} {force:.0e}", changed, np.random.default_rng(seed))
    return tally


def _cost_with_friction(unknowns: int, cases: int, floats: bool) -> None:
    """Print what load cases of a block on a rough floor cost, pressed and dragged along by forces at its contacts.

    Its top is held, or the floor alone holds it.
    """
    cells = round(np.sqrt(unknowns / 4))
    block = cq.Body(cq.rectangle(2.0, 1.0, (2 * cells, cells)), cq.Material(1.0, 0.3), "plane-strain", name="block")
    structure = cq.Structure([block])
    floor = cq.pair(structure.surface("block", "bottom"), cq.Plane([0.0, -1e-3], [0.0, 1.0]))
    held = structure.assemble([] if floats else [cq.Support("block", "top", axis) for axis in range(2)])
    problem, rng = held.problem([floor], friction=0.3), np.random.default_rng(0)
    press, drag = (np.asarray(rows.sum(axis=0)).ravel() for rows in (problem.normal, problem.tangent))
    turn, m = np.linspace(0.0, 3.0, cases), problem.contacts
    dragged = 3e-4 if floats else 2e-3  # friction of 0.3 of what presses least holds it
    loads = np.outer(4e-3 * (0.8 + 0.5 * np.sin(2 * turn)), press) + np.outer(dragged * np.cos(turn), drag)
    loads += 1e-5 * rng.standard_normal((cases, m)) @ problem.normal
    started = time.process_time()
    cq.solve(problem.replace(load=loads[0]))
    first = time.process_time() - started
    started = time.process_time()
    many = cq.solve_many(fresh(problem), loads=loads)
    taken = time.process_time() - started
    how = "on the floor alone" if floats else "with friction"
    print(f"    {how}, {problem.dimension} unknowns, {m} contacts: first solution {first:.3f} s, {cases} cases "
          f"{taken:.2f} s, {taken / first:.1f} of the first, {int(many.passed.sum())} passed, "
          f"{int(many.proven.sum())} proven")  # fmt: skip


def cost(unknowns: int, cases: int) -> None:
    """Print what a gradient and many load cases cost beside the first solution, in seconds of the processor."""
    problem = fresh(block(unknowns, 2))
    rng = np.random.default_rng(0)
    size = 1e-3 * np.max(abs(problem.load))
    at = rng.choice(problem.dimension, 300, replace=False)
    rows = []
    for _ in range(cases):
        places = (np.zeros(len(at), dtype=int), at)
        noise = sp.csr_array((size * rng.standard_normal(len(at)), places), shape=(1, problem.dimension))
        rows.append(sp.csr_array(problem.load[None] * (0.5 + rng.random())) + noise)
    loads = sp.csr_array(sp.vstack(rows))
    started = time.process_time()
    cq.solve(problem)
    first = time.process_time() - started
    print(f"{problem.dimension} unknowns, {problem.contacts} contacts: first solution {first:.3f} s")
    one = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # with all loads in memory, as later
    started = time.process_time()
    many = cq.solve_many(problem, loads=loads)
    taken_by_all = time.process_time() - started
    now = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(f"    {cases} load cases: {taken_by_all:.2f} s, {taken_by_all / first:.1f} of the first, "
          f"{int(many.passed.sum())} passed, {int(many.proven.sum())} proven, peak {now / one:.2f} of that of one"
          )  # fmt: skip
    for floats in (False, True):
        _cost_with_friction(unknowns, max(1, cases // 5), floats)
    pairs = ("normal_force", "load"), ("displacement", "load"), ("normal_force", "stiffness")
    solves: list[float] = []
    taken: dict[tuple[str, str], list[float]] = {pair: [] for pair in pairs}
    for _ in range(7):  # in turns, as the machine may be busy; what the first solution imported is there
        changed = fresh(problem)
        started = time.process_time()
        solved = cq.solve(changed)
        solves.append(time.process_time() - started)
        for of, parameter in pairs:
            weights, started = np.ones_like(getattr(solved, of)), time.process_time()
            solved.pullback(of, weights, parameter)
            taken[of, parameter].append(time.process_time() - started)
    print(f"    further solutions {np.median(solves):.3f} s")
    for (of, parameter), seconds in taken.items():
        parts = np.median(np.divide(seconds, solves))
        print(f"    gradient of {of} by {parameter}: {np.median(seconds):.4f} s, {parts:.3f} of a further solution")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=4, help="of each family, each in three units")
    parser.add_argument("--cost", action="store_true", help="what gradients and load cases cost, and nothing else")
    parser.add_argument("--unknowns", type=int, default=30_000)
    parser.add_argument("--cases", type=int, default=1000)
    chosen = parser.parse_args()
    if chosen.cost:
        cost(chosen.unknowns, chosen.cases)
        return 0
    return int(survey(chosen.problems) > 0)


if __name__ == "__main__":
    sys.exit(main())
