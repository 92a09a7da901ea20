"""Which way a large body is solved: what is asked for decides, and whether factors fit into memory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp import errors
from contactqp.errors import free_memory
from contactqp.linalg import delassus, iteration, multigrid, pardiso, runtime, sparse_saddle
from contactqp.solving.friction import local_form
from tests.blocks_in_space import fresh, on_paraboloid, on_sphere
from tests.solving.friction.space import block

needs_pyamg = pytest.mark.skipif(not multigrid.available(), reason="needs pyamg")
needs_pardiso = pytest.mark.skipif(not pardiso.available(), reason="needs pypardiso")
# Methods that are shown the condensed problem, and what they have to be told.
ON_FACTORS: dict[str, dict[str, Any]] = {
    "clarabel": {},
    "osqp": {},
    "lagrange-multiplier": {},
    "penalty": {"penalty": 1e4},
    "active-set": {"condense": True},
}


@pytest.fixture
def small_is_large(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bodies from a hundred unknowns on are iterated on."""
    monkeypatch.delenv(pardiso.SOLVER_VARIABLE, raising=False)
    monkeypatch.setattr(iteration, "MOST_OPERATIONS", 1e4)
    monkeypatch.setattr(iteration, "COUPLED", 0)


def rubbing() -> cq.ContactProblem:
    problem = on_paraboloid((6, 6, 4))
    along = sp.csr_matrix(
        ([1.0] * 2 * problem.contacts, (np.arange(2 * problem.contacts), _tangents(problem))),
        shape=(2 * problem.contacts, problem.dimension),
    )
    return cq.ContactProblem(problem.stiffness, problem.load, problem.normal, problem.gap, tangent=along, friction=0.3)


def _tangents(problem: cq.ContactProblem) -> np.ndarray:
    """The unknowns along the plane beside the vertical one of every contact."""
    vertical = problem.normal.indices
    return np.column_stack([vertical - 2, vertical - 1]).ravel()


@pytest.mark.slow
@needs_pyamg
@pytest.mark.usefixtures("small_is_large")
@pytest.mark.parametrize("method", ON_FACTORS)
def test_a_method_that_needs_factors_has_them_at_any_size(method: str) -> None:
    problem = fresh(on_sphere())
    reference = cq.solve(fresh(problem))
    assert reference.work.solver == "pyamg"
    solution = cq.solve(problem, method, **ON_FACTORS[method])
    assert solution.work.solver in ("pardiso", "superlu")
    exact = method != "penalty"
    assert solution.certificate.passed == exact
    off = np.max(abs(solution.normal_force - reference.normal_force)) / np.max(reference.normal_force)
    assert off < (1e-6 if exact else 0.5)
    if exact:  # whoever asks next uses the factors
        assert cq.solve(problem).certificate.proven


@needs_pyamg
@pytest.mark.usefixtures("small_is_large")
def test_friction_is_factorised_at_any_size() -> None:
    problem = rubbing()
    assert iteration.iterated(problem.replace(friction=0.0))
    solution = cq.solve(problem)
    assert solution.certificate.passed
    assert solution.certificate.basis == "state"
    assert "slip" in solution.contact_status or "stick" in solution.contact_status


@pytest.mark.slow
@needs_pardiso
def test_factors_that_do_not_fit_are_not_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = fresh(on_paraboloid((14, 14, 8)))
    assert problem.dimension > 2000
    monkeypatch.setattr(pardiso, "free_memory", lambda: 2**20)
    with pytest.raises(
        cq.Unsupported, match=r"the factors of \d+ unknowns need about .* GiB, 0.0 GiB are free: .*mesh"
    ):
        cq.solve(problem)
    monkeypatch.undo()
    assert cq.solve(problem).certificate.proven


@pytest.mark.slow
@needs_pyamg
@needs_pardiso
@pytest.mark.usefixtures("small_is_large")
def test_a_body_whose_factors_do_not_fit_is_iterated_on_as_before(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = fresh(on_paraboloid((14, 14, 8)))
    with monkeypatch.context() as patch:
        patch.setattr(pardiso, "free_memory", lambda: 2**20)
        with pytest.raises(cq.Unsupported, match="need about"):
            cq.solve(problem, "clarabel")
    assert cq.solve(problem).work.solver == "pyamg"


@pytest.mark.slow
@needs_pardiso
def test_the_prediction_of_memory_grows_with_the_factors() -> None:
    nothing = np.zeros(0, dtype=np.intp)
    sizes = [pardiso.Pardiso(fresh(on_paraboloid(cells)).stiffness, nothing) for cells in ((8, 8, 8), (16, 16, 16))]
    small, large = (one.predicted_memory for one in sizes)
    assert large > 16 * small / 2  # n^(4/3) is a factor of 16 from 8 to 16 cells along an edge
    assert large > 12 * sp.csr_matrix(on_paraboloid((16, 16, 16)).stiffness).nnz / 2


@needs_pardiso
def test_where_factors_are_a_help_alone_none_are_had_for_want_of_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sparse saddle points catch what a solver has no memory for, and go on without."""
    monkeypatch.setattr(pardiso, "free_memory", lambda: 2**20)
    chain, one = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(150, 150)), sp.identity(150)
    wide = sp.csc_matrix(sp.kron(one, chain) + sp.kron(chain, one))  # a narrow band takes no such solver
    order = pardiso.EliminationOrder(wide.shape[0])
    with pytest.raises(cq.BackendFailed, match="need about"):
        sparse_saddle.factorised(wide, pardiso.INDEFINITE, order, np.arange(wide.shape[0]))


@pytest.mark.parametrize(("limit", "free"), [("max", None), (str(2**34), 2**34 - 2**33 + 2**32)])
def test_files_that_a_group_caches_are_free_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str, free: int | None
) -> None:
    written = {"memory.max": limit, "memory.current": str(2**33), "memory.stat": f"anon 5\ninactive_file {2**32}\n"}
    for name, text in written.items():
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(errors, "_GROUPS", ((str(tmp_path), "memory.max", "memory.current", "inactive_file"),))
    monkeypatch.setattr(errors, "_available", lambda: None)
    monkeypatch.setattr(errors, "_left_of_address_space", lambda: None)
    assert free_memory() == free


def test_free_memory_is_that_of_the_machine_or_less() -> None:
    free = free_memory()
    assert free is None or 0 < free < 2**50


def test_what_memory_does_not_hold_is_refused_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """NumPy's MemoryError, wherever it comes from in a call, is one of this package that says what is free."""

    def full(*_: object, **__: object) -> None:
        raise MemoryError("Unable to allocate 244. MiB for an array with shape (4000, 8000)\nand more")

    monkeypatch.setattr(delassus, "unit_rows", full)
    monkeypatch.setattr(errors, "free_memory", lambda: 2**30)
    words = (
        r"memory is full: Unable to allocate 244. MiB .*8000\), 1.0 GiB are free: free memory, or take fewer contacts"
    )
    rough = block([1.0, 0.0])
    for call in (lambda: cq.solve(fresh(rough)), lambda: cq.follow_path(fresh(rough), [rough.load], steps=2)):
        with pytest.raises(cq.Unsupported, match=words) as caught:
            call()
        assert "\n" not in str(caught.value)


def test_dense_operators_of_contacts_with_friction_are_refused_before_they_fill_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(runtime, "free_memory", lambda: 2**8)
    monkeypatch.setattr(runtime, "LITTLE_MEMORY", 0)
    monkeypatch.setattr(delassus, "LITTLE", 0)
    monkeypatch.setattr(local_form, "DENSE_SIZE", 0)
    with pytest.raises(
        cq.Unsupported, match=r"contacts with friction and .* need about .* GiB, .* are free: free memory"
    ):
        cq.solve(fresh(block([1.0, 0.0])))
    coupled = cq.LocalProblem(delassus=np.eye(30) + 0.1, offset=-np.ones(30), friction=0.3, dimension=3)
    with pytest.raises(cq.Unsupported, match=r"operators of 10 contacts need about .* GiB, .* are free: free memory"):
        cq.solve(coupled)
