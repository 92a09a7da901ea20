"""Answers as functions of JAX and PyTorch, differentiated by what `pullback` says; neither is imported until asked for.

A function takes what is varied by name, in double precision: load (n,), gap (m,), tie_value (k,), friction (m,),
slip_origin (m, d-1), and stiffness, the entries (nnz,) of K on the pattern of `problem.stiffness_rows`. Every call is a
certified solution, and its gradient one system with the same factors. Where an answer has no gradient, at a contact
that grazes, the error says so.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.derivatives import QUANTITIES, VECTORS, pullback
from contactqp.errors import BackendMissing, InvalidProblem
from contactqp.model.arguments import checked
from contactqp.model.arrays import Array, own_floating_point
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution
from contactqp.solving.solve import solve

FRAMEWORKS = ("jax", "torch")
VARIED = (*VECTORS, "stiffness")


@checked
@own_floating_point
def differentiable(problem: ContactProblem, of: str, varied: Sequence[str], framework: str) -> Callable[..., Any]:
    """Return an answer as a function of what is varied, for automatic differentiation.

    Parameters
    ----------
    problem : ContactProblem
        What is not varied is its own.
    of : str
        "displacement", "normal_force", "friction_force", "tie_force", "gap", "slip" or "energy".
    varied : sequence of str
        Names of the arguments, in their order: "load", "gap", "tie_value", "friction", "slip_origin" and "stiffness",
        the entries of K on the pattern of `problem.stiffness_rows`, which are symmetrised.
    framework : str
        "jax": for `jax.grad`, `jax.jacrev`, `jax.vmap` and `jax.jit`; "torch": for tensors.

    Raises
    ------
    BackendMissing
        The framework is not installed.
    InvalidProblem
        A name that is none of these; JAX computes in single precision.

    Examples
    --------
    >>> import jax, contactqp as cq  # doctest: +SKIP
    >>> jax.config.update("jax_enable_x64", True)  # doctest: +SKIP
    >>> bar = cq.ContactProblem([[157500.0]], [300.0], [[1.0]], [1e-3])  # doctest: +SKIP
    >>> force = cq.differentiable(bar, "normal_force", ["gap"], "jax")  # doctest: +SKIP
    >>> jax.jacrev(force)(bar.gap)  # doctest: +SKIP
    Array([[-157500.]], dtype=float64)
    """
    known = tuple(name for name in QUANTITIES if name != "reaction")
    named = [("of", of, known), ("framework", framework, FRAMEWORKS), *(("varied", name, VARIED) for name in varied)]
    for argument, name, names in named:
        if name not in names:
            raise InvalidProblem(f"{argument}: expected one of {', '.join(names)}, got {name!r}")
    if not varied or len(set(varied)) < len(varied):
        raise InvalidProblem(f"varied: expected names, each once, got {', '.join(varied) or 'none'}")
    try:
        module = import_module(framework)
    except ImportError:
        raise BackendMissing(f"differentiable: {framework} is not installed: pip install {framework}") from None
    host = _Host(problem, of, tuple(varied))
    return _jax_function(module, host) if framework == "jax" else _torch_function(module, host)


class _Host:
    """Answers and gradients in NumPy."""

    def __init__(self, problem: ContactProblem, of: str, varied: tuple[str, ...]) -> None:
        self.problem, self.of, self.varied = problem, of, varied
        found = getattr(solve(problem), of)
        self.shape = np.shape(found)

    def solution(self, values: Sequence[Any]) -> Solution:
        """Return the certified answer where these have the varied parameters' places."""
        changes: dict[str, Any] = {}
        for name, value in zip(self.varied, values, strict=True):
            given = np.asarray(value, dtype=float)
            if name == "stiffness":
                rows = self.problem.stiffness_rows
                if given.shape != rows.data.shape:
                    raise InvalidProblem(f"stiffness: expected entries {rows.data.shape}, got {given.shape}")
                K = sp.csr_array((given, rows.indices, rows.indptr), shape=rows.shape)
                given = (K + K.T) / 2
            changes[name] = given
        found: Solution = solve(self.problem.replace(**changes))
        return found

    def value(self, *values: Any) -> Array:
        """Return the quantity, in doubles."""
        return np.array(getattr(self.solution(values), self.of), dtype=float)

    def gradients(self, weights: Any, *values: Any) -> tuple[Array, ...]:
        """Return the gradient of weights . quantity by each argument, in its shape."""
        solution, rows = self.solution(values), self.problem.stiffness_rows
        found = []
        for name, value in zip(self.varied, values, strict=True):
            gradient = pullback(solution, self.of, np.array(weights, dtype=float).reshape(self.shape), name)
            if name == "stiffness":
                places = np.repeat(np.arange(rows.shape[0]), np.diff(rows.indptr)), rows.indices
                gradient = sp.csr_array(gradient)[places]
            found.append(np.array(gradient, dtype=float).reshape(np.shape(value)))
        return tuple(found)


def _jax_function(jax: Any, host: _Host) -> Callable[..., Any]:
    """Return a function with a reverse rule, whose solutions are made outside of JAX, one for each of a batch."""
    if not jax.config.jax_enable_x64:
        raise InvalidProblem(
            'differentiable: JAX computes in single precision; expected jax.config.update("jax_enable_x64", True)'
        )

    def shaped(shape: tuple[int, ...]) -> Any:
        return jax.ShapeDtypeStruct(shape, float)

    def answered(*values: Any) -> Any:
        return jax.pure_callback(host.value, shaped(host.shape), *values, vmap_method="sequential")

    def forward(*values: Any) -> Any:
        return answered(*values), values

    def backward(values: Any, weights: Any) -> Any:
        shapes = tuple(shaped(value.shape) for value in values)
        return jax.pure_callback(host.gradients, shapes, weights, *values, vmap_method="sequential")

    answer: Any = jax.custom_vjp(answered)
    answer.defvjp(forward, backward)
    made: Callable[..., Any] = answer
    return made


def _torch_function(torch: Any, host: _Host) -> Callable[..., Any]:
    """Return a function of tensors in double precision."""

    def forward(context: Any, *values: Any) -> Any:
        context.save_for_backward(*values)
        return torch.from_numpy(host.value(*(value.detach().numpy() for value in values)))

    def backward(context: Any, weights: Any) -> Any:
        values = (value.detach().numpy() for value in context.saved_tensors)
        return tuple(map(torch.from_numpy, host.gradients(weights.detach().numpy(), *values)))

    rules = dict(forward=staticmethod(forward), backward=staticmethod(backward))
    kind: Any = type("ContactAnswer", (torch.autograd.Function,), rules)
    apply: Callable[..., Any] = kind.apply
    return apply
