"""What exact answers cost: the cases in rational numbers, and bodies with more and more contacts enclosed.

    python -m benchmarks.exact_answers

prints, case by case, the milliseconds of `cq.exact` (the second call: imports and first factorisations are not its
work) and, for blocks pressed onto a paraboloid and for condensed (dense) problems, seconds and the widest relative
radius of what is not zero.
"""

from __future__ import annotations

import time
import warnings
from pathlib import Path

import numpy as np

import contactqp as cq
from contactqp.elements.material import Material
from contactqp.elements.shapes import rectangle
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support

CASES = Path(__file__).parents[1] / "cases"
BLOCKS = ((40, 20), (99, 50), (199, 50), (199, 100))
# Displacements below this part of the largest are rounding of zeros (symmetry).
NOTHING = 1e-25


def block(divisions: tuple[int, int]) -> cq.ContactProblem:
    """A block pressed onto a paraboloid."""
    body = Body(rectangle(1.0, 0.5, divisions, "quad4"), Material(modulus=1.0, poisson=0.3), "plane-strain", name="b")
    structure = Structure([body])
    system = structure.assemble([Support("b", "top", 0), Support("b", "top", 1, -0.02)])
    contact = cq.pair(structure.surface("b", "bottom"), cq.Paraboloid([0.5, 0.0], [0.0, 1.0], 5.0))
    return system.problem([contact])


def condensed(contacts: int) -> cq.ContactProblem:
    """A dense stiffness with a contact at every unknown."""
    rng = np.random.default_rng(contacts)
    basis = rng.standard_normal((contacts, contacts))
    stiffness = basis @ basis.T / contacts + np.eye(contacts)
    return cq.ContactProblem(stiffness, rng.standard_normal(contacts), np.eye(contacts), 0.1 * rng.random(contacts))


def widest(answer: cq.ExactSolution) -> float:
    """The largest relative radius of what is not zero; 0 where exact."""
    if answer.radius is None:
        return 0.0
    doubles, radius = answer.doubles, answer.radius
    pairs = [(doubles.normal_force, radius.normal_force), (doubles.displacement, radius.displacement)]
    seen = [(abs(x), r, abs(x) > NOTHING * np.max(abs(x), initial=0.0)) for x, r in pairs]
    return max(float(np.max(r[kept] / x[kept], initial=0.0)) for x, r, kept in seen)


def _timed(asked: object, **options: object) -> tuple[cq.ExactSolution, float]:
    started = time.perf_counter()
    answer = cq.exact(asked, **options)
    return answer, time.perf_counter() - started


def main() -> None:
    """Print both tables."""
    warnings.simplefilter("ignore", cq.TimeStepWarning)
    print(f"{'case':32} {'':9} {'ms':>8}")
    for file in sorted(CASES.glob("*.toml")):
        scene = cq.load_scene(file)
        if scene.meshed or scene.large or scene.motion is not None:
            continue
        try:
            cq.exact(scene)
        except cq.Unsupported as error:
            print(f"{file.stem:32} unsupported: {error}")
            continue
        answer, seconds = _timed(scene)
        print(f"{file.stem:32} {'rational' if answer.rational else 'enclosed':9} {1e3 * seconds:8.1f}")
    print(f"\n{'problem':32} {'unknowns':>9} {'contacts':>9} {'closed':>7} {'s':>8} {'radius':>8}")
    problems = [("block", block(divisions)) for divisions in BLOCKS]
    problems += [("condensed", condensed(m)) for m in (50, 100, 200, 400)]
    rows = [(name, problem, None) for name, problem in problems]
    rows += [("condensed, in rational numbers", condensed(m), False) for m in (50, 100, 200)]
    for name, problem, enclose in rows:
        answer, seconds = _timed(problem, enclose=enclose)
        closed = answer.contact_status.count("closed")
        sizes = f"{problem.dimension:9} {problem.contacts:9} {closed:7}"
        print(f"{name:32} {sizes} {seconds:8.2f} {'exact' if answer.rational else f'{widest(answer):.0e}':>8}")


if __name__ == "__main__":
    main()
