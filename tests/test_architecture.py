"""Imports point one way, and a scene brings in only what it needs."""

from __future__ import annotations

import ast
import pathlib
import subprocess
import sys

import pytest

PACKAGE = pathlib.Path(__file__).parent.parent / "contactqp"

# From the bottom to the top: a module imports from its own layer or from layers before it.
LAYERS = (
    "errors",
    "engines",
    "floating_point",
    "whole_file",
    "stages",
    "forking",
    "printed_stiffness",
    "problem_data",
    "problem",
    "statuses",
    "solution",
    "blas_threads",
    "extended",
    "local_problem",
    "coulomb_cone",
    "published_errors",
    "factorization",
    "pardiso",
    "trailing_block",
    "elimination",
    "coarsest_level",
    "multigrid",
    "v_cycle",
    "held_rows",
    "conjugate_gradients",
    "contact_iteration",
    "condensation",
    "delassus",
    "nonnegative",
    "range_space",
    "saddle",
    "row_sizes",
    "intrinsic_size",
    "violations",
    "balance",
    "frictional_rows",
    "friction_states",
    "iteration",
    "coulomb_residual",
    "contact_compliance",
    "critical_coefficients",
    "answer_count",
    "uniqueness",
    "local_uniqueness",
    "local_certificate",
    "local_solution",
    "polishing",
    "energy_norm",
    "least_distance",
    "admissible_pair",
    "multigrid_bounds",
    "bounds",
    "candidates",
    "failures",
    "state_answer",
    "existence",
    "idle_rows",
    "certificate",
    "widening",
    "scaling",
    "methods",
    "solving_arguments",
    "inexact_active_set",
    "aitken",
    "distributed",
    "friction",
    "local_solving",
    "solvability",
    "metering",
    "condensed_attempt",
    "whole_attempt",
    "associated_attempt",
    "friction_attempt",
    "enforced_attempt",
    "iterated_attempt",
    "solving",
    "multiplicity",
    "relaxation",
    "energies",
    "elements",
    "analysis",
    "pictures",
    "scene",
    "exchange",
    "oracle",
    "study",
    "testing",
    "cli",
)


def _imports(path: pathlib.Path) -> set[str]:
    """Modules of the package that a file imports on import: function bodies and TYPE_CHECKING are left out."""
    found: set[str] = set()
    tree = ast.parse(path.read_text())
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("contactqp"):
            found.update([node.module.split(".")[1]] if "." in node.module else [alias.name for alias in node.names])
    return found


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_point_one_way(path: pathlib.Path) -> None:
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    if parts[0] in ("__init__", "__main__"):
        return
    assert parts[0] in LAYERS, f"{path.name} is in no layer: put it in one"
    mine = LAYERS.index(parts[0])
    above = {name for name in _imports(path) if name in LAYERS and LAYERS.index(name) > mine}
    assert not above, f"{'/'.join(parts)} imports {above} from above it"


def test_the_certificate_imports_no_method() -> None:
    code = "import sys, contactqp.certificate; print([m for m in sys.modules if m.startswith('contactqp.methods')])"
    assert _run(code) == "[]"


OPTIONAL = (
    "cvxpy",
    "osqp",
    "clarabel",
    "qpsolvers",
    "matplotlib",
    "skfem",
    "piqp",
    "daqp",
    "highspy",
    "scs",
    "pyamg",
    "h5py",
)


def test_importing_the_package_imports_nothing_optional() -> None:
    modules = f"[m for m in {(*OPTIONAL, 'scipy.linalg', 'pint', 'pydantic', 'click', 'rich')} if m in sys.modules]"
    assert _run(f"import sys, contactqp; print({modules})") == "[]"


def test_solving_by_our_own_method_imports_no_backend() -> None:
    modules = f"[m for m in {OPTIONAL} if m in sys.modules]"
    code = (
        "import sys, contactqp as cq; "
        "cq.solve(cq.ContactProblem(stiffness=[[2.0]], load=[1.0], normal=[[1.0]], gap=[0.1])); "
        f"print({modules})"
    )
    assert _run(code) == "[]"


def test_public_names_are_all_there_and_methods_stays_callable() -> None:
    code = (
        "import contactqp as cq, contactqp.methods; "
        "print(len(cq.methods()) > 5, callable(cq.methods), all(getattr(cq, name) is not None for name in cq.__all__))"
    )
    assert _run(code) == "True True True"


def _run(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()
