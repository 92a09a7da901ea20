"""Derivatives by other packages beside ours, on two problems whose exact ones are rational.

    pip install jax qpax cvxpylayers
    python -m benchmarks.derivative_peers

Bar and wall: d lambda / d gap of 1/2 k u^2 - P u over u <= g, lambda = P - k u, in kN and m and in N and mm; exactly
-k. Blocks between walls (Boyd and Vandenberghe 2004, section 5.5.4; an example of cvxpylayers' notebooks): d x / d k of
1/2 k1 x1^2 + 1/2 k2 (x2 - x1)^2 + 1/2 k3 (l - x2)^2 over w/2 <= x1, w + x1 <= x2, x2 <= l - w/2, at stiffnesses times
1, 1e3 and 1e5. Every package at its own settings; errors are the largest entry's, relative to the largest of the exact
ones. A package that is not installed is left out by name.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import contactqp as cq

Array = np.ndarray[Any, Any]
BAR = {"kN, m": (157_500.0, 300.0, 1e-3), "N, mm": (157_500.0, 300_000.0, 1.0)}
FACTORS = (1.0, 1e3, 1e5)
SPRINGS, WIDE, FAR = np.array([1.0, 2.0, 1.5]), 0.5, 2.0
# The elongation of spring i is ENDS[i] x - REST[i].
ENDS, REST = np.array([[1.0, 0.0], [-1.0, 1.0], [0.0, 1.0]]), np.array([0.0, 0.0, FAR])
ROWS, GAP = np.array([[-1.0, 0.0], [1.0, -1.0], [0.0, 1.0]]), np.array([-WIDE / 2, -WIDE, FAR - WIDE / 2])


@dataclass(frozen=True)
class Peer:
    """One package: d lambda / d gap of the bar, and d x / d k (2, 3) of the blocks."""

    module: str
    bar: Callable[[float, float, float], float]
    blocks: Callable[[Array], Array]


def _bar(k: float, load: float, gap: float) -> cq.ContactProblem:
    return cq.ContactProblem([[k]], [load], [[1.0]], [gap])


def _blocks(k: Array) -> cq.ContactProblem:
    return cq.ContactProblem(ENDS.T @ np.diag(k) @ ENDS, ENDS.T @ (k * REST), ROWS, GAP)


def _changes() -> list[tuple[Array, Array]]:
    """Return d K and d f of each spring."""
    return [(np.outer(end, end), end * rest) for end, rest in zip(ENDS, REST, strict=True)]


def _own_bar(k: float, load: float, gap: float) -> float:
    return float(cq.solve(_bar(k, load, gap)).derivative("normal_force", "gap", [1.0]).value[0])


def _own_blocks(k: Array) -> Array:
    solution = cq.solve(_blocks(k))
    rates = [
        solution.derivative("displacement", "stiffness", stiff).value
        + solution.derivative("displacement", "load", load).value
        for stiff, load in _changes()
    ]
    return np.column_stack(rates)


def exact_blocks(k: Array) -> Array:
    """Return d x / d k of the rational answer."""
    answer = cq.exact(_blocks(k))
    rates = [
        answer.derivative("displacement", "stiffness", stiff).value
        + answer.derivative("displacement", "load", load).value
        for stiff, load in _changes()
    ]
    return np.column_stack([np.array(rate, dtype=float) for rate in rates])


def _doubles() -> Any:
    import jax

    jax.config.update("jax_enable_x64", True)
    return jax


def _qpax_bar(k: float, load: float, gap: float) -> float:
    jax = _doubles()
    import jax.numpy as jnp
    import qpax

    def force(g: Any) -> Any:
        none = jnp.zeros((0, 1)), jnp.zeros(0)
        u = qpax.solve_qp_primal(jnp.array([[k]]), jnp.array([-load]), *none, jnp.ones((1, 1)), g)
        return (load - k * u)[0]

    return float(jax.grad(force)(jnp.array([gap]))[0])


def _qpax_blocks(k: Array) -> Array:
    jax = _doubles()
    import jax.numpy as jnp
    import qpax

    def place(stiffness: Any) -> Any:
        Q, q = ENDS.T @ jnp.diag(stiffness) @ ENDS, -ENDS.T @ (stiffness * REST)
        return qpax.solve_qp_primal(Q, q, jnp.zeros((0, 2)), jnp.zeros(0), jnp.array(ROWS), jnp.array(GAP))

    return np.asarray(jax.jacrev(place)(jnp.array(k)))


def _layer_bar(k: float, load: float, gap: float) -> float:
    jax = _doubles()
    import cvxpy as cp
    import jax.numpy as jnp
    from cvxpylayers.jax import CvxpyLayer

    u, g = cp.Variable(1), cp.Parameter(1)
    energy = k / 2 * cp.sum_squares(u) - load * cp.sum(u)
    layer = CvxpyLayer(cp.Problem(cp.Minimize(energy), [u <= g]), parameters=[g], variables=[u])
    return float(jax.grad(lambda gap: (load - k * layer(gap)[0])[0])(jnp.array([gap]))[0])


def _layer_blocks(k: Array) -> Array:
    jax = _doubles()
    import cvxpy as cp
    import jax.numpy as jnp
    from cvxpylayers.jax import CvxpyLayer

    x, root = cp.Variable(2), cp.Parameter(3, nonneg=True)
    energy = cp.sum_squares(cp.multiply(root, ENDS @ x - REST)) / 2
    layer = CvxpyLayer(cp.Problem(cp.Minimize(energy), [ROWS @ x <= GAP]), parameters=[root], variables=[x])
    rows = [jax.grad(lambda stiffness, i=i: layer(jnp.sqrt(stiffness))[0][i])(jnp.array(k)) for i in range(2)]
    return np.stack([np.asarray(row) for row in rows])


PEERS = {
    "contactqp": Peer("contactqp", _own_bar, _own_blocks),
    "cvxpylayers": Peer("cvxpylayers", _layer_bar, _layer_blocks),
    "qpax": Peer("qpax", _qpax_bar, _qpax_blocks),
}


def main() -> int:
    names = [name for name, peer in PEERS.items() if importlib.util.find_spec(peer.module) is not None]
    for name in PEERS.keys() - names:
        print(f"{name} is not installed: pip install jax qpax cvxpylayers")
    print(f"{'':34s}" + "".join(f"{name:>20s}" for name in names))
    for units, data in BAR.items():
        values = "".join(f"{PEERS[name].bar(*data):20.6f}" for name in names)
        print(f"{f'bar, d lambda / d gap in {units}':34s}{values}")
    for factor in FACTORS:
        k = factor * SPRINGS
        exact = exact_blocks(k)
        errors = [abs(PEERS[name].blocks(k) - exact).max() / abs(exact).max() for name in names]
        print(f"{f'blocks, stiffness times {factor:g}':34s}" + "".join(f"{error:20.1e}" for error in errors))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
