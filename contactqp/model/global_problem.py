"""Frictional contact in the global form of FCLIB: bodies, contacts and joints.

    M v = H r + f + G l,    u = H'v + w,    G'v + b = 0

with the law of Signorini and Coulomb between u and r, (N, T) or (N, T1, T2) contact by contact, r the force on the
bodies. M may be a stiffness and v a displacement, or M a mass (with what the time step adds) and v a velocity.
In the signs of `contactqp.model.problem`: E_N = -H_N', g = w_N, E_T = H_T', slip_origin = -w_T, A = G', b -> -b;
l_N = r_N, l_T = -r_T, nu = -l.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.errors import InvalidProblem, counts, shown
from contactqp.model.arguments import checked
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import (
    SYMMETRY_TOLERANCE,
    Matrix,
    ReadOnly,
    is_number,
    read_array,
    read_coefficient,
    read_matrix,
    read_only,
    read_vector,
)


@dataclass(frozen=True, init=False, eq=False, repr=False)
class GlobalProblem(ReadOnly):
    """A problem in FCLIB's global form as its file states it; nothing is symmetrised.

    Parameters
    ----------
    matrix : (n, n) array or sparse matrix
        M, symmetric or not: `asymmetry` is max |M_ij - M_ji| / sqrt(M_ii M_jj).
    directions : (n, d m) array or sparse matrix
        H, one column for each component of each contact, N before T.
    load : (n,) array
        f.
    offset : (d m,) or (m, d) array
        w.
    friction : float or (m,) array
        Coulomb's coefficient, not negative.
    dimension : 2 or 3
        d.
    joints : (n, p) array or sparse matrix, optional
        G.
    joint_offset : (p,) array, optional
        b; zero by default.

    Raises
    ------
    InvalidProblem
        Wrong shapes, values that are not finite, a negative coefficient.
    """

    matrix: Matrix
    directions: Matrix
    load: Vector
    offset: Vector
    friction: Vector
    dimension: int
    joints: Matrix
    joint_offset: Vector
    asymmetry: float

    def __init__(
        self,
        matrix: Any,
        directions: Any,
        load: ArrayLike,
        offset: ArrayLike,
        friction: ArrayLike,
        dimension: int,
        joints: Any = None,
        joint_offset: ArrayLike | None = None,
    ) -> None:
        if not is_number(dimension) or dimension not in (2, 3):
            raise InvalidProblem(f"dimension: expected 2 or 3, got {shown(dimension)}")
        M = read_matrix("matrix", matrix)
        n = M.shape[0]
        if M.shape != (n, n):
            raise InvalidProblem(f"matrix: expected a square matrix, got shape {M.shape}")
        H = read_matrix("directions", directions)
        if H.shape[0] != n or H.shape[1] % dimension:
            raise InvalidProblem(
                f"directions: expected {n} rows and {dimension} columns a contact, got shape {H.shape}"
            )
        m = H.shape[1] // dimension
        G = read_matrix("joints", np.zeros((n, 0)) if joints is None else joints)
        if G.shape[0] != n:
            raise InvalidProblem(f"joints: expected {n} rows, got shape {G.shape}")
        if joints is None and joint_offset is not None and read_array("joint_offset", joint_offset).size:
            raise InvalidProblem("joint_offset was given without joints")
        b = np.zeros(G.shape[1]) if joint_offset is None else joint_offset
        values = dict(
            matrix=M,
            directions=H,
            load=read_vector("load", load, n),
            offset=read_vector("offset", read_array("offset", offset).reshape(-1), H.shape[1]),
            friction=read_coefficient(friction, m),
            dimension=int(dimension),
            joints=G,
            joint_offset=read_vector("joint_offset", b, G.shape[1]),
            asymmetry=_asymmetry(M),
        )
        for name, value in values.items():
            object.__setattr__(self, name, read_only(value))

    @classmethod
    @checked
    def of(cls, problem: ContactProblem) -> GlobalProblem:
        """Return a ContactProblem in global form, bit for bit.

        Raises
        ------
        InvalidProblem
            It has no tangential rows: a contact has two or three components in FCLIB.
        """
        if problem.tangent is None or problem.slip_origin is None or problem.friction is None:
            raise InvalidProblem("tangent: expected tangential rows (with friction=0 if there is none), got none")
        m, d = problem.contacts, 1 + problem.slip_origin.shape[1]
        rows = sp.vstack([-problem.normal, problem.tangent], format="csr")
        normal_first = np.column_stack([np.arange(m), m + np.arange((d - 1) * m).reshape(m, d - 1)]).astype(int)
        return cls(
            matrix=problem.stiffness,
            directions=rows[normal_first.ravel()].T,
            load=problem.load,
            offset=np.column_stack([problem.gap, -problem.slip_origin]),
            friction=problem.friction,
            dimension=d,
            joints=problem.tie.T,
            joint_offset=-problem.tie_value,
        )

    def contact_problem(self) -> ContactProblem:
        """Return the problem as a ContactProblem.

        Raises
        ------
        InvalidProblem
            M is not symmetric, or is indefinite; a contact or a joint that moves nothing.
        """
        m, d = self.contacts, self.dimension
        rows = sp.csr_array(self.directions.T)
        is_normal = np.arange(d * m) % d == 0
        w = self.offset.reshape(m, d)
        return ContactProblem(
            stiffness=self.matrix,
            load=self.load,
            normal=-rows[is_normal],
            gap=w[:, 0],
            tangent=rows[~is_normal],
            friction=self.friction,
            slip_origin=-w[:, 1:],
            tie=sp.csr_array(self.joints.T),
            tie_value=-self.joint_offset,
        )

    @property
    def symmetric(self) -> bool:
        """Whether M is symmetric within the tolerance of a ContactProblem."""
        return self.asymmetry <= SYMMETRY_TOLERANCE

    @property
    def contacts(self) -> int:
        """Number of contacts m."""
        return len(self.friction)

    def __repr__(self) -> str:
        joints = f", {len(self.joint_offset)} joints" if len(self.joint_offset) else ""
        return (
            f"GlobalProblem({counts(unknown=self.matrix.shape[0], contact=self.contacts)} in {self.dimension}D{joints})"
        )


def _asymmetry(M: Any) -> float:
    difference = abs(M - M.T).tocoo()
    difference.eliminate_zeros()
    diagonal = abs(M.diagonal())
    pair = np.sqrt(diagonal[difference.row]) * np.sqrt(diagonal[difference.col])
    relative = np.divide(difference.data, pair, out=np.full(len(pair), np.inf), where=pair > 0)
    return float(np.max(relative, initial=0.0))
