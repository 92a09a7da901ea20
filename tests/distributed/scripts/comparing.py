"""PETSc's own solvers give the answers of the active set, contacts being bounds or made so."""

import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.distributed.bounded import METHODS, SOLVERS, bound_unknowns
from contactqp.distributed.distributed_bodies import distributed_model
from contactqp.distributed.distributing import distribute
from contactqp.distributed.ranks import Ranks, petsc
from contactqp.distributed.solving import solve_distributed
from contactqp.errors import BackendFailed, NoEquilibrium, NotCertified, Unsupported
from contactqp.scene.building import build

CASES = Path(__file__).parents[3] / "cases"
SAME = 1e-9
ranks = Ranks()


def held(name, lid, axis):
    """A case whose upper side is moved down, so that no rigid motion is left."""
    text = (CASES / f"{name}.toml").read_text()
    text = text.replace(
        "supports = [", f'supports = [{{ name = "lid", on = "{lid}", axis = "{axis}", value = "-50 um" }},'
    )
    file = Path(sys.argv[1]) / f"{name}.toml"
    if ranks.rank == 0:
        file.write_text(text)
    ranks.comm.barrier()
    return distributed_model(cq.load_scene(file), ranks).problem


def close(a, b, what):
    assert np.max(abs(a - b), initial=0.0) <= SAME * np.max(abs(b), initial=0.0), f"{what}: {a} and {b}"


def compared(part, known, method, solver):
    found = solve_distributed(part, method, solver=solver)
    assert found.certificate.passed
    assert found.method == method
    assert found.work.iterations > 0
    for name in ("displacement", "normal_force", "tie_force"):
        close(getattr(found, name), getattr(known, name), f"{method} {solver}: {name}")


def chain(rows, gaps, ties, values):
    """Eight masses on springs between two walls, a load that varies, and rows over them."""
    n = 8
    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    return cq.ContactProblem(
        stiffness=1e4 * K, load=300 * np.cos(np.arange(n)), normal=rows, gap=gaps, tie=ties, tie_value=values
    )


def row(**entries):
    return [float(entries.get(f"u{i}", 0.0)) for i in range(8)]


foot = build(cq.load_scene(CASES / "truss_floor.toml")).problem
# Oblique contacts, one that touches three masses, a slot with two walls, a tie of two; u4 is met by two rows.
several = chain(
    [row(u0=0.6, u1=0.8), row(u2=-1, u3=0.5, u4=0.5), row(u5=0.5), row(u5=-2.0), row(u4=0.3, u6=1)],
    [1e-3, 2e-3, 5e-3, 1e-2, -4e-3],
    [row(u7=1, u1=-1)],
    [1e-3],
)
for problem in (foot, several):
    known = cq.solve(problem)
    assert np.any(known.normal_force > 0)
    part = distribute(problem, ranks)
    for method in METHODS:
        for solver in SOLVERS:
            compared(part, known, method, solver)
assert np.any(known.normal_force == 0)
assert known.tie_force.any()

bounds, u = bound_unknowns(part, "vinewtonrsls"), np.random.default_rng(1).standard_normal(len(part.load))
w = bounds.unknowns(u)
assert ranks.any(w != u)
close(bounds.displacement(w), u, "T w")
from_answer = solve_distributed(part, "vinewtonrsls", warm_start=solve_distributed(part).answer)
close(from_answer.displacement, known.displacement, "from the answer")

on_all = cq.solve(several, engine="petsc", method="VINewtonRSLS")
assert isinstance(on_all, cq.Solution)
close(on_all.normal_force, known.normal_force, "engine petsc")

for part in (held("block_on_paraboloid", "block.top", "z"), held("hertz_line", "cylinder.top", "y")):
    known = solve_distributed(part)
    assert np.any(known.normal_force > 0)
    for method in METHODS:
        compared(part, known, method, "asm")
    compared(part, known, "vinewtonrsls", "mumps")

# What SNES calls zero is an absolute length: in the last problem it is made one that closes contacts that are open.
options = petsc().Options("contactqp_bounds_")
options["snes_vi_zero_tolerance"] = 0.1
with pytest.raises(NotCertified, match="equilibrium"):
    solve_distributed(part, "vinewtonrsls", solver="mumps")
options.delValue("snes_vi_zero_tolerance")

# With a hundredth of the memory that it expects to need MUMPS fails, and the number of its error is passed on.
for method in METHODS:
    name = ("tao_bnk_" if method.startswith("tao") else "") + "mat_mumps_icntl_14"
    options[name] = -99
    with pytest.raises(BackendFailed, match=r"^PETSc's mumps failed: INFOG\(1\) = -9 "):
        solve_distributed(part, method, solver="mumps")
    options.delValue(name)

crossing = distribute(chain([row(u0=1), row(u2=1, u3=1), row(u2=1, u3=-1)], [1e-3] * 3, [], []), ranks)
with pytest.raises(Unsupported, match=r"^vinewtonrsls takes bounds on single unknowns; contact 1 limits several"):
    solve_distributed(crossing, "vinewtonrsls")
narrow = distribute(chain([row(u5=1), row(u5=-1)], [-1e-3, 0.0], [], []), ranks)
with pytest.raises(NoEquilibrium, match="conflict at unknown 5"):
    solve_distributed(narrow, "tao-bntr")
loose = cq.ContactProblem(stiffness=sp.diags([1.0, 0.0]), load=[1.0, 1.0], normal=[[0.0, 1.0]], gap=[1.0])
with pytest.raises(Unsupported, match="a body that only contacts hold"):
    solve_distributed(distribute(loose, ranks), "vinewtonssls")
with pytest.raises(Unsupported, match=r"solver: expected auto, mumps, hypre, asm, got 'gamg'"):
    solve_distributed(narrow, "vinewtonrsls", solver="gamg")
with pytest.raises(Unsupported, match=r"^clarabel: engine 'petsc' has active-set"):
    solve_distributed(narrow, "clarabel")
if ranks.rank == 0:
    print("compared")
