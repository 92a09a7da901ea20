"""Functions of JAX and PyTorch have the derivatives of answers; without these, one line says what to install."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.analysis.many_loads import _Host

HAS_JAX, HAS_TORCH = (importlib.util.find_spec(name) is not None for name in ("jax", "torch"))


def problems() -> list[tuple[cq.ContactProblem, str, list[str]]]:
    rng = np.random.default_rng(4)
    shape, rows = rng.standard_normal((5, 5)), rng.standard_normal((4, 5))
    K = shape @ shape.T + 2 * np.eye(5)
    plain = cq.ContactProblem(K, 4 * rng.standard_normal(5), rows[:2], [0.1, 0.2])
    return [
        (cq.ContactProblem([[157500.0]], [300.0], [[1.0]], [1e-3]), "normal_force", ["gap", "load"]),
        (plain, "displacement", ["load", "gap", "stiffness"]),
        (plain.replace(tie=rows[2:3], tie_value=[0.1]), "tie_force", ["tie_value", "load"]),
        (plain.replace(tangent=rows[2:], friction=0.2), "friction_force", ["load", "friction"]),
        (cq.ContactProblem(sp.csr_array(K), plain.load, rows[:2], [0.1, 0.2]), "energy", ["stiffness", "load"]),
    ]


def arguments(problem: cq.ContactProblem, varied: list[str]) -> list[np.ndarray]:
    return [np.array(problem.stiffness_rows.data if name == "stiffness" else getattr(problem, name)) for name in varied]


@pytest.mark.skipif(not HAS_JAX, reason="jax is not installed")
@pytest.mark.parametrize("which", range(5))
def test_jax_has_the_derivatives_of_answers(which: int) -> None:
    import jax

    jax.config.update("jax_enable_x64", True)
    problem, of, varied = problems()[which]
    function, values = cq.differentiable(problem, of, varied, "jax"), arguments(problem, varied)
    solution, rng = cq.solve(problem), np.random.default_rng(0)
    assert np.asarray(function(*values)) == pytest.approx(np.asarray(getattr(solution, of)))
    jacobians = jax.jacrev(function, argnums=tuple(range(len(values))))(*values)
    for value, name, jacobian in zip(values, varied, jacobians, strict=True):
        direction = rng.standard_normal(value.shape)
        change: object = direction
        if name == "stiffness":
            rows = problem.stiffness_rows
            matrix = sp.csr_array((direction, rows.indices, rows.indptr), shape=rows.shape)
            change = (matrix + matrix.T) / 2
        rate = np.ravel(solution.derivative(of, name, change).value)
        found = np.asarray(jacobian).reshape(rate.size, -1) @ direction.ravel()
        assert found == pytest.approx(rate, rel=1e-9, abs=1e-12)
    batch = [np.stack([value, 1.01 * value]) for value in values]
    assert np.asarray(jax.vmap(function)(*batch))[0] == pytest.approx(np.asarray(getattr(solution, of)))
    each = jax.vmap(jax.jacrev(function), in_axes=(0,) + (None,) * (len(values) - 1))(batch[0], *values[1:])
    for place, value in enumerate(batch[0]):
        assert each[place] == pytest.approx(np.asarray(jax.jacrev(function)(value, *values[1:])), rel=1e-12, abs=1e-12)
    total = jax.jit(jax.grad(lambda *given: (function(*given) ** 2).sum()))(*values)
    assert total.shape == values[0].shape


@pytest.mark.skipif(not HAS_TORCH, reason="torch is not installed")
@pytest.mark.parametrize("which", range(5))
def test_torch_checks_the_gradients(which: int) -> None:
    import torch

    problem, of, varied = problems()[which]
    function = cq.differentiable(problem, of, varied, "torch")
    values = [torch.tensor(value, requires_grad=True) for value in arguments(problem, varied)]
    step = 1e-9 if which == 0 else 1e-6
    assert torch.autograd.gradcheck(function, values, eps=step, atol=1e-4, rtol=1e-4)
    first, *others = (value.detach() for value in values)
    batch = torch.stack([first, 1.01 * first])
    expected = torch.stack([function(one, *others) for one in batch])
    assert torch.allclose(torch.func.vmap(function, (0,) + (None,) * len(others))(batch, *others), expected)
    rate = torch.func.grad(lambda one: function(one, *others).sum())
    assert torch.allclose(torch.func.vmap(rate)(batch), torch.stack([rate(one) for one in batch]))


def test_batches_are_solved_as_many_load_cases_and_a_gradient_needs_no_second_solution() -> None:
    problem = problems()[1][0]
    host = _Host(problem, "normal_force", ("load", "gap"))
    loads = np.linspace(0.5, 1.5, 7)[:, None] * problem.load
    found = host.value(loads, problem.gap[None])
    assert found == pytest.approx(cq.solve_many(problem, loads=loads).normal_force)
    assert host._last is None
    weights = np.ones(problem.contacts)
    host.value(loads[0], problem.gap)
    kept = host._last
    assert kept is not None
    by_load, by_gap = host.gradients(np.stack([weights, 2 * weights]), loads[:1], problem.gap[None])
    assert host._last is kept
    assert by_load[1] == pytest.approx(kept[1].pullback("normal_force", 2 * weights, "load"))
    assert by_gap.shape == (2, problem.contacts)
    # A body that nothing but a wall holds, which one of the loads drives away: the error is that of `solve`.
    free = cq.ContactProblem([[1.0, -1.0], [-1.0, 1.0]], [1.0, 1.0], [[1.0, 0.0]], [0.5])
    with pytest.raises(cq.NoEquilibrium):
        _Host(free, "normal_force", ("load",)).value([[1.0, 1.0], [-1.0, -1.0]])


def test_gradients_of_a_batch_are_those_of_each_case_however_it_is_nested() -> None:
    """As `vmap` of `jacrev` asks for them: several weights, the last dimension, for each of several cases."""
    problem = problems()[1][0]
    host, weights = _Host(problem, "normal_force", ("load", "gap")), np.eye(problem.contacts)
    loads = np.array([1.0, -1.0])[:, None] * problem.load
    cases = [[cq.solve(problem.replace(load=load, gap=k * problem.gap)) for load in loads] for k in (1.0, 2.0, 0.5)]
    one, two = [solution.jacobian("normal_force", "load") for solution in cases[0]]
    assert not np.allclose(one, two)
    gaps = np.array([1.0, 2.0, 0.5])[:, None, None, None] * problem.gap
    for given, shape in ((loads[:, None], (1, *loads.shape)), (loads[:1, None], (1, 1, loads.shape[1]))):
        by_load, by_gap = host.gradients(weights[None, None], given[None], gaps)
        assert by_load.shape[:3] == (3, shape[1], problem.contacts)
        for k, row in enumerate(cases):
            for place, solution in enumerate(row[: shape[1]]):
                assert by_load[k, place] == pytest.approx(solution.jacobian("normal_force", "load"), abs=1e-12)
                assert by_gap[k, place] == pytest.approx(solution.jacobian("normal_force", "gap"), abs=1e-12)


def test_what_is_not_installed_or_no_argument_is_one_line() -> None:
    problem = problems()[0][0]
    for framework, there in (("jax", HAS_JAX), ("torch", HAS_TORCH)):
        if not there:
            with pytest.raises(cq.BackendMissing, match=f"{framework} is not installed: pip install {framework}"):
                cq.differentiable(problem, "gap", ["load"], framework)
    for call, message in (
        (("mass", ["load"], "jax"), "of: expected one of"),
        (("gap", ["rows"], "jax"), "varied: expected one of load"),
        (("gap", [], "jax"), "varied: expected names"),
        (("gap", ["load"], "mxnet"), "framework: expected one of jax, torch"),
    ):
        with pytest.raises(cq.InvalidProblem, match=message):
            cq.differentiable(problem, *call)
