"""Stiff and degenerate elastic bodies of about 8000 unknowns: the error of every method's contact forces.

    python -m benchmarks.hard_bodies
    python -m benchmarks.hard_bodies --methods active-set osqp --unknowns 2000

A block on an obstacle: with a stiffness contrast of 1e8; in SI units, E = 2.1e11 Pa, pressed by 1e-6 m; floating, under
a traction; with every contact row twice; on a flat floor that it grazes exactly, alone and beside contacts that push.
The error is that of |l - l*|_W / |l*|_W against the answer refined in extended precision, absolute where no contact
pushes. A method is right (at most 1e-10) or refuses; exit code 1 if one is neither.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator

import numpy as np
import scipy.sparse as sp

import contactqp as cq
from contactqp.elements.loads import Traction
from contactqp.elements.material import Material
from contactqp.elements.shapes import rectangle
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from contactqp.solving.methods import find
from contactqp.solving.methods.method import COMPLEMENTARITY

LARGEST_ERROR = 1e-10


def _block(unknowns: int, modulus: float, low: float = 0.0, name: str = "block") -> Body:
    cells = round(np.sqrt(unknowns / 4))
    mesh = rectangle(1.0, 0.5, (2 * cells, cells), corner=(0.0, low))
    return Body(mesh, Material(modulus, 0.3), "plane-strain", name=name)


def _pressed(body: Body, press: float, obstacle: object) -> cq.ContactProblem:
    structure = Structure([body])
    held = [Support("block", "top", 0), Support("block", "top", 1, -press)]
    return structure.assemble(held).problem([cq.pair(structure.surface("block", "bottom"), obstacle)])


def _paraboloid(sagitta: float) -> cq.Paraboloid:
    """Its edge lies `sagitta` beneath its apex, half a block away."""
    return cq.Paraboloid([0.5, 0.0], [0.0, 1.0], 0.125 / sagitta)


def contrast(unknowns: int) -> cq.ContactProblem:
    """A soft block pressed by one 1e8 times as stiff, which rests on a paraboloid."""
    soft, stiff = _block(unknowns // 2, 1.0, 0.5, "soft"), _block(unknowns // 2, 1e8, 0.0, "stiff")
    structure = Structure([soft, stiff])
    held = [Support("soft", "top", 0), Support("soft", "top", 1, -0.1), Support("stiff", "left", 0)]
    between = cq.pair_node_to_segment(structure.surface("soft", "bottom"), structure.surface("stiff", "top"))
    under = cq.pair(structure.surface("stiff", "bottom"), _paraboloid(1e-10))
    return structure.assemble(held).problem([between, under])


def si_units(unknowns: int) -> cq.ContactProblem:
    """Steel, metres and newtons, pressed by a micrometre."""
    return _pressed(_block(unknowns, 2.1e11), 1e-6, _paraboloid(2e-6))


def floating(unknowns: int) -> cq.ContactProblem:
    """Held sideways at its left, pressed down by a traction: contact alone holds it up."""
    structure = Structure([_block(unknowns, 1.0)])
    system = structure.assemble([Support("block", "left", 0)], [Traction("block", "top", [0.0, -0.01])])
    return system.problem([cq.pair(structure.surface("block", "bottom"), _paraboloid(0.05))])


def every_row_twice(unknowns: int) -> cq.ContactProblem:
    """Each contact stated twice: forces are not unique, their resultants are."""
    once = _pressed(_block(unknowns, 1.0), 0.02, _paraboloid(0.025))
    twice = sp.vstack([once.normal, once.normal])
    return cq.ContactProblem(once.stiffness, once.load, twice, np.concatenate([once.gap, once.gap]))


def grazed(unknowns: int) -> cq.ContactProblem:
    """A flat floor that the unloaded block touches along its whole face and nothing presses it on."""
    return _pressed(_block(unknowns, 1.0), 0.0, cq.Plane([0.0, 0.0], [0.0, 1.0]))


def grazed_beside_pushing(unknowns: int) -> cq.ContactProblem:
    """Two blocks, one pressed on a paraboloid, one that grazes its floor."""
    pressed, still = _block(unknowns // 2, 1.0, 0.0, "pressed"), _block(unknowns // 2, 1.0, 0.0, "still")
    structure = Structure([pressed, still])
    held = [Support("pressed", "top", 0), Support("pressed", "top", 1, -0.02)]
    held += [Support("still", "top", 0), Support("still", "top", 1)]
    floor = cq.Plane([0.0, 0.0], [0.0, 1.0])
    under = [cq.pair(structure.surface("pressed", "bottom"), _paraboloid(0.025), dimension=structure.size)]
    under += [cq.pair(structure.surface("still", "bottom"), floor, dimension=structure.size)]
    return structure.assemble(held).problem(under)


VARIANTS: dict[str, Callable[[int], cq.ContactProblem]] = {
    "contrast 1e8": contrast,
    "SI units": si_units,
    "floating": floating,
    "every row twice": every_row_twice,
    "grazed": grazed,
    "grazed beside pushing": grazed_beside_pushing,
}


def outcomes(problem: cq.ContactProblem, methods: list[str]) -> Iterator[tuple[str, float, float | None, str]]:
    """Method, seconds, force error (None if refused), what was said."""
    for method in methods:
        twin = problem.replace(stiffness=problem.stiffness)
        limit = {} if "no time limit" in find(method).note or method == "active-set" else {"time_limit": 60.0}
        started = time.perf_counter()
        try:
            solution = cq.solve(twin, method=method, **limit)
        except cq.ContactQPError as refusal:
            yield method, time.perf_counter() - started, None, str(refusal).splitlines()[0][:90]
            continue
        certificate = solution.certificate
        error = np.inf if certificate.force_error is None else certificate.force_error
        said = "passed" if certificate.passed else certificate.failures[0][:90]
        yield method, solution.seconds, error, said


def main(arguments: list[str] | None = None) -> int:
    polished = [m.name for m in cq.methods() if m.installed and m.polish and m.kind != COMPLEMENTARITY]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--unknowns", type=int, default=8000)
    parser.add_argument("--methods", nargs="+", default=polished, choices=polished, metavar="METHOD")
    chosen = parser.parse_args(arguments)
    wrong = 0
    for name, make in VARIANTS.items():
        problem = make(chosen.unknowns)
        print(f"{name}: {problem.dimension} unknowns, {problem.contacts} contacts")
        for method, seconds, error, said in outcomes(problem, chosen.methods):
            right = error is not None and error <= LARGEST_ERROR
            wrong += error is not None and not right
            verdict = "refused" if error is None else f"{error:.1e}"
            print(f"    {method:20s}{seconds:>8.2f} s  {verdict:>9s}  {said}", flush=True)
    print(f"{wrong} answers neither right nor refused")
    return int(wrong > 0)


if __name__ == "__main__":
    raise SystemExit(main())
