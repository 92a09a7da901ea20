"""How long the stiffness of a block of hexahedra takes, against the number of elements.

`python -m benchmarks.stiffness_assembly`; where scikit-fem is installed also its generic form, up to 16^3 elements.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable

from contactqp.elements.material import Material
from contactqp.elements.shapes import box
from contactqp.elements.solid import Body

SIZES = (8, 16, 32, 48)
GENERIC_UP_TO = 16


def seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def ours(n: int) -> tuple[float, float, int]:
    """Seconds for the checked mesh and for the stiffness, and the number of unknowns."""
    start = time.perf_counter()
    mesh = box((1.0, 1.0, 1.0), (n, n, n))
    meshed = time.perf_counter() - start
    body = Body(mesh, Material(modulus=1.0, poisson=0.3), "3d")
    return meshed, seconds(lambda: body.stiffness), body.size


def generic(n: int) -> float:
    """Seconds of scikit-fem's linear elasticity on as many hexahedra."""
    import skfem
    from skfem.models.elasticity import linear_elasticity

    line = [i / n for i in range(n + 1)]
    basis = skfem.Basis(skfem.MeshHex.init_tensor(line, line, line), skfem.ElementVector(skfem.ElementHex1()))
    return seconds(lambda: linear_elasticity(1.0, 1.0).assemble(basis))


if __name__ == "__main__":
    theirs = importlib.util.find_spec("skfem") is not None
    print("hexahedra  unknowns   mesh [s]  stiffness [s]  per element [us]  scikit-fem [s]")
    for n in SIZES:
        meshed, assembled, unknowns = ours(n)
        other = f"{generic(n):.2f}" if theirs and n <= GENERIC_UP_TO else "-"
        print(f"{n:>6}^3 {unknowns:>11} {meshed:>10.2f} {assembled:>14.2f} {1e6 * assembled / n**3:>17.1f} {other:>15}")
