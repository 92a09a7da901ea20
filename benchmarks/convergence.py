"""Orders of convergence of contact solutions against closed forms, and whether they are what theory promises.

    python -m benchmarks.convergence                # about a minute
    python -m benchmarks.convergence --finest 32

Hertz's line contact and the flat punch on a piece of the half-plane, and the membrane over a ball, on meshes halved
again and again; orders are fitted to all of them. Exit code 1 if one misses its target:

    Hertz       displacement in H1 at least 0.9 with linear elements (their order is 1; quadratic ones are reported:
                3/2, since the pressure is a root at the edge of contact), force at a given approach and peak pressure
                at least 0.9 and the latter off by at most 1 % at last, the edge of contact never off by an element
    punch       force 0.9, pressure in L1 0.4: its 1/sqrt at the corners is matched to order 1/2 by no better
    membrane    deflection in H1 0.9, its free boundary's radius 0.9, and never off by two elements
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from benchmarks.contact_of_half_planes import hertz_level, punch_level
from benchmarks.h1_error import order
from benchmarks.membrane_over_ball import membrane_level, on_disc, on_square

COARSEST = 8
QUADRATIC = ("tri6", "quad8")
LINEAR = ("tri3", "quad4")


def orders(levels: Sequence[Any], names: Sequence[str]) -> dict[str, float]:
    """The fitted order of each of these errors."""
    return {name: order([found.size for found in levels], [getattr(found, name) for found in levels]) for name in names}


def study(
    title: str, level: Callable[[int], Any], finest: int, targets: dict[str, float], most: dict[str, float]
) -> bool:
    """Print levels and orders; whether the orders reach `targets` and the finest errors stay below `most`."""
    levels = [level(COARSEST * 2**i) for i in range(int(np.log2(finest / COARSEST)) + 1)]
    names = [name for name in vars(levels[0]) if name not in ("size", "unknowns")]
    print(f"{title}\n{'unknowns':>12s}{'size':>9s}" + "".join(f"{name:>13s}" for name in names))
    for found in levels:
        errors = "".join(f"{getattr(found, name):>13.2e}" for name in names)
        print(f"{found.unknowns:>12d}{found.size:>9.4f}{errors}")
    reached = orders(levels, list(targets))
    print(
        "    order of " + ", ".join(f"{name} {value:.2f} (at least {targets[name]})" for name, value in reached.items())
    )
    met = all(value >= targets[name] for name, value in reached.items())
    met &= all(getattr(levels[-1], name) <= limit for name, limit in most.items())
    print("    met" if met else f"    MISSED; at last at most {most}", flush=True)
    return met


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--finest", type=int, default=64, help="cells of the finest mesh, 8 times a power of 2")
    finest = parser.parse_args(arguments).finest
    good = {"force": 0.9, "peak": 0.9}
    met = []
    for kind in LINEAR + QUADRATIC:
        last, h1 = (finest, 0.9) if kind in LINEAR else (finest // 2, 1.4)
        title = f"Hertz's line contact, {kind} (half-width in elements)"
        met.append(
            study(
                title,
                lambda n, kind=kind: hertz_level(kind, n),
                last,
                {"h1": h1, **good},
                {"peak": 0.01, "half_width": 1.0},
            )
        )
    for kind in LINEAR:
        targets = {"force": 0.9, "l1": 0.4}
        met.append(study(f"Flat punch, {kind}", lambda n, kind=kind: punch_level(kind, n), finest, targets, {}))
    for name, mesh in (("square", on_square), ("disc", on_disc)):
        for kind in LINEAR:
            title = f"Membrane over a ball on the {name}, {kind} (boundary in elements)"
            targets = {"h1": 0.9, "radius": 0.9}
            met.append(
                study(
                    title,
                    lambda n, kind=kind, mesh=mesh: membrane_level(mesh(kind, n)),
                    finest,
                    targets,
                    {"boundary": 2.0},
                )
            )
    print(f"{met.count(False)} of {len(met)} miss their target")
    return int(not all(met))


if __name__ == "__main__":
    raise SystemExit(main())
