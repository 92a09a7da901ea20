"""Answers with slips in space and their rates in sixty decimal digits, by Newton's method on the equations themselves.

Roots make them no rational numbers. The states are given; nothing of the package is used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal, localcontext
from typing import Any

import numpy as np

import contactqp as cq

DIGITS = 60


def decimals(values: Any) -> np.ndarray:
    """Return doubles as the decimal numbers that they are."""
    given = values.toarray() if hasattr(values, "toarray") else np.asarray(values, dtype=float)
    return np.array([Decimal(float(x)) for x in given.ravel()], dtype=object).reshape(given.shape)


def solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the solution of a linear system in decimals, rows exchanged for the largest pivot of a scaled column."""
    a = np.column_stack([matrix, right])
    n = len(a)
    for row in a:
        row /= max(abs(x) for x in row[:n])
    for k in range(n):
        place = k + max(range(n - k), key=lambda i: abs(a[k + i, k]))
        a[[k, place]] = a[[place, k]]
        for i in range(n):
            if i != k and a[i, k] != 0:
                a[i, k:] -= a[i, k] / a[k, k] * a[k, k:]
    return a[:, n] / np.array([a[k, k] for k in range(n)], dtype=object)


@dataclass
class Data:
    """The data of a problem, or a direction of them, in decimals."""

    stiffness: np.ndarray
    load: np.ndarray
    normal: np.ndarray
    gap: np.ndarray
    tangent: np.ndarray
    friction: np.ndarray
    slip_origin: np.ndarray
    tie: np.ndarray
    tie_value: np.ndarray

    @classmethod
    def of(cls, problem: cq.ContactProblem) -> Data:
        return cls(**{name: decimals(getattr(problem, name)) for name in cls.__dataclass_fields__})

    def along(self, parameter: str, direction: Any) -> Data:
        """Return a direction of one of them."""
        name = "normal" if parameter == "rows" else parameter
        none = {key: 0 * value for key, value in vars(self).items()}
        return Data(**(none | {name: decimals(direction).reshape(none[name].shape)}))


class Reference:
    """An answer in given states, "open", "stick" or "slip", and its rates."""

    def __init__(self, problem: cq.ContactProblem, solution: cq.Solution) -> None:
        self.data, self.status = Data.of(problem), list(solution.contact_status)
        self.n, self.m, self.k = problem.dimension, problem.contacts, problem.ties
        parts = solution.displacement, solution.normal_force, solution.friction_force, solution.tie_force
        start = np.concatenate([decimals(part).ravel() for part in parts])
        self._in_digits(lambda: self._find(start))
        # What sticks in doubles and takes more friction than its bound slips by less than their rounding.
        _, push, drag, _ = self._parts(self.x)
        bound = self.data.friction * push
        beyond = [word == "stick" and d @ d > b * b for word, d, b in zip(self.status, drag, bound, strict=True)]
        if any(beyond):
            self.status = ["slip" if more else word for word, more in zip(self.status, beyond, strict=True)]
            self._in_digits(lambda: self._find(start))

    def _in_digits(self, what: Callable[[], Any]) -> Any:
        with localcontext() as context:
            context.prec = DIGITS
            return what()

    def _find(self, x: np.ndarray) -> None:
        for _ in range(9):
            step = solved(self._jacobian(x), -self._missed(x))
            x = x + step
        assert max(abs(s) for s in step) <= Decimal(10) ** -45 * max(abs(y) for y in x)
        self.x = x

    def _parts(self, x: np.ndarray) -> list[np.ndarray]:
        n, m = self.n, self.m
        u, push, drag, tie = np.split(x, [n, n + m, n + 3 * m])
        return [u, push, drag.reshape(m, 2), tie]

    def _slip(self, x: np.ndarray, i: int) -> tuple[np.ndarray, Any]:
        slip = self.data.tangent[2 * i : 2 * i + 2] @ self._parts(x)[0] - self.data.slip_origin[i]
        return slip, (slip @ slip).sqrt()

    def _missed(self, x: np.ndarray) -> np.ndarray:
        d, (u, push, drag, tie) = self.data, self._parts(x)
        force = d.stiffness @ u + d.normal.T @ push + d.tangent.T @ drag.ravel() + d.tie.T @ tie - d.load
        contact, friction = push.copy(), drag.copy()
        for i, state in enumerate(self.status):
            if state == "open":
                continue
            contact[i] = d.normal[i] @ u - d.gap[i]
            slip, size = self._slip(x, i)
            friction[i] = slip if state == "stick" else drag[i] - d.friction[i] * push[i] * slip / size
        return np.concatenate([force, contact, friction.ravel(), d.tie @ u - d.tie_value])

    def _jacobian(self, x: np.ndarray) -> np.ndarray:
        d, n, m, (_, push, _, _) = self.data, self.n, self.m, self._parts(x)
        J = decimals(np.eye(len(x)))
        J[:n, :n], J[:n, n : n + m], J[:n, n + m : n + 3 * m] = d.stiffness, d.normal.T, d.tangent.T
        J[:n, n + 3 * m :], J[n + 3 * m :, :n], J[n + 3 * m :, n + 3 * m :] = d.tie.T, d.tie, decimals(0.0)
        for i, state in enumerate(self.status):
            rows, at = d.tangent[2 * i : 2 * i + 2], slice(n + m + 2 * i, n + m + 2 * i + 2)
            if state == "open":
                continue
            J[n + i, n + i], J[n + i, :n] = Decimal(0), d.normal[i]
            if state == "stick":
                J[at, at], J[at, :n] = decimals(np.zeros((2, 2))), rows
                continue
            slip, size = self._slip(x, i)
            t = slip / size
            J[at, n + i] = -d.friction[i] * t
            J[at, :n] = -d.friction[i] * push[i] / size * ((decimals(np.eye(2)) - np.outer(t, t)) @ rows)
        return J

    def rates(self, parameter: str, direction: Any) -> dict[str, Any]:
        """Return the rates of all quantities along a direction."""
        return self._in_digits(lambda: self._rates(self.data.along(parameter, direction)))

    def _rates(self, e: Data) -> dict[str, Any]:
        d, x = self.data, self.x
        u, push, _, _ = self._parts(x)
        force = e.load - e.stiffness @ u - e.normal.T @ push
        contact, friction = 0 * push, 0 * self._parts(x)[2]
        for i, state in enumerate(self.status):
            if state == "open":
                continue
            contact[i] = e.gap[i] - e.normal[i] @ u
            if state == "stick":
                friction[i] = e.slip_origin[i]
                continue
            slip, size = self._slip(x, i)
            t = slip / size
            back = e.slip_origin[i] - t * (t @ e.slip_origin[i])
            friction[i] = e.friction[i] * push[i] * t - d.friction[i] * push[i] / size * back
        dx = solved(self._jacobian(x), np.concatenate([force, contact, friction.ravel(), e.tie_value]))
        du, dpush, ddrag, dtie = self._parts(dx)
        reaction = d.normal.T @ dpush + e.normal.T @ push + d.tangent.T @ ddrag.ravel() + d.tie.T @ dtie
        energy = (d.stiffness @ u - d.load) @ du - e.load @ u + u @ (e.stiffness @ u) / 2
        slip = (d.tangent @ du).reshape(-1, 2) - e.slip_origin
        gap = e.gap - e.normal @ u - d.normal @ du
        return dict(
            displacement=du, normal_force=dpush, friction_force=ddrag, tie_force=dtie, gap=gap, slip=slip,
            reaction=reaction, energy=energy,
        )  # fmt: skip
