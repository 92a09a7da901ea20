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
    "model.engines",
    "model.floating_point",
    "exchange.whole_file",
    "linalg.stages",
    "linalg.forking",
    "model.printed_stiffness",
    "model.problem_data",
    "model.verdicts",
    "model.problem",
    "model.statuses",
    "model.solution",
    "linalg.blas_threads",
    "linalg.extended",
    "model.local_problem",
    "linalg.extended_rows",
    "model.coulomb_cone",
    "certificate.published_errors",
    "linalg.factorization",
    "linalg.pardiso",
    "linalg.trailing_block",
    "linalg.elimination",
    "linalg.coarsest_level",
    "linalg.multigrid",
    "linalg.v_cycle",
    "linalg.held_rows",
    "linalg.conjugate_gradients",
    "linalg.contact_iteration",
    "linalg.condensation",
    "linalg.delassus",
    "linalg.nonnegative",
    "linalg.range_space",
    "linalg.saddle",
    "linalg.row_sizes",
    "linalg.intrinsic_size",
    "linalg.measures",
    "certificate.figures",
    "certificate.balance",
    "linalg.frictional_rows",
    "linalg.friction_states",
    "linalg.iteration",
    "certificate.coulomb_residual",
    "linalg.contact_compliance",
    "certificate.critical_coefficients",
    "certificate.answer_count",
    "certificate.uniqueness",
    "certificate.local_uniqueness",
    "certificate.local_certificate",
    "model.local_solution",
    "linalg.polishing",
    "certificate.energy_norm",
    "linalg.least_distance",
    "certificate.admissible_pair",
    "certificate.multigrid_bounds",
    "certificate.bounds",
    "certificate.candidates",
    "certificate.failures",
    "certificate.state_answer",
    "linalg.existence",
    "certificate.idle_rows",
    "certificate.certificate",
    "solving.widening",
    "linalg.scaling",
    "solving.methods",
    "solving.solving_arguments",
    "solving.methods.inexact_active_set",
    "solving.friction.aitken",
    "distributed",
    "solving.friction",
    "solving.local_solving",
    "solving.solvability",
    "solving.metering",
    "solving.condensed_attempt",
    "solving.whole_attempt",
    "solving.associated_attempt",
    "solving.friction_attempt",
    "solving.enforced_attempt",
    "solving.iterated_attempt",
    "solving.solve",
    "solving.multiplicity",
    "solving.relaxation",
    "elements.energies",
    "elements distributed.pieces",
    "analysis distributed.scenes.friction_on_ranks",
    "pictures scene.in_text",
    "scene distributed.scenes.distributed_bodies distributed.scenes.pieces distributed.scenes.running_on_ranks distributed.scenes.solutions_in_pieces",  # noqa: E501
    "exchange model.global_problem",
    "oracle",
    "study",
    "testing",
    "cli",
)


def _layer(module: str) -> int | None:
    """The place in LAYERS of the longest path there that the module begins with; a line may hold several."""
    place = {name: layer for layer, line in enumerate(LAYERS) for name in line.split()}
    parts = module.split(".")
    heads = (".".join(parts[:end]) for end in range(len(parts), 0, -1))
    return next((place[head] for head in heads if head in place), None)


def _imports(path: pathlib.Path) -> set[str]:
    """Modules of the package that a file imports on import: function bodies and TYPE_CHECKING are left out."""
    found: set[str] = set()
    tree = ast.parse(path.read_text())
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("contactqp"):
            found.update(f"{node.module}.{alias.name}".partition(".")[2] for alias in node.names)
    return found


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_point_one_way(path: pathlib.Path) -> None:
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    imported = _imports(path)
    if parts[0] in ("__init__", "__main__") or not imported:
        return
    mine = _layer(".".join(parts))
    assert mine is not None, f"{path.name} is in no layer: put it in one"
    above = {name for name in imported if (layer := _layer(name)) is not None and layer > mine}
    assert not above, f"{'/'.join(parts)} imports {above} from above it"


def test_the_certificate_imports_no_method() -> None:
    code = (
        "import sys, contactqp.certificate.certificate; print([m for m in sys.modules if "
        "m.startswith('contactqp.solving.methods')])"
    )
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


def test_public_names_are_all_there_and_methods_is_a_function() -> None:
    code = (
        "import contactqp as cq, contactqp.solving.methods, types; "
        "print(len(cq.methods()) > 5, type(cq.methods) is types.FunctionType, "
        "all(getattr(cq, name) is not None for name in cq.__all__))"
    )
    assert _run(code) == "True True True"


def _run(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()
