"""Frictional contact in the local form of FCLIB, in which velocities and forces of the contacts are the only unknowns.

    u = W r + q + V l,    V'r + R l + s = 0        the bodies, eliminated
    r_N >= 0,  u_N >= 0,  r_N u_N = 0              Signorini
    |r_T| <= mu r_N,  r_T = -mu r_N u_T/|u_T| where u_T does not vanish        Coulomb

The order in a contact is (N, T) or (N, T1, T2), and r is the force on the body: r_N = l_N, r_T = -l_T, u_N = g - E_N u,
u_T = E_T u - slip_origin in the signs of `contactqp.model.problem` (Acary, Bremond, Huber 2018).

Frictional contact in the global form of FCLIB: bodies, contacts and joints.

    M v = H r + f + G l,    u = H'v + w,    G'v + b = 0

with the law of Signorini and Coulomb between u and r, (N, T) or (N, T1, T2) contact by contact, r the force on the
bodies. M may be a stiffness and v a displacement, or M a mass (with what the time step adds) and v a velocity.
In the signs of `contactqp.model.problem`: E_N = -H_N', g = w_N, E_T = H_T', slip_origin = -w_T, A = G', b -> -b;
l_N = r_N, l_T = -r_T, nu = -l.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from contactqp.errors import InvalidProblem, counted, counts, shown
from contactqp.model.arguments import checked
from contactqp.model.arrays import Array, Vector, computes, own_floating_point, refuses_misfits
from contactqp.model.computed import OfLocalMatrices
from contactqp.model.names import name_of, read_names
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import (
    SYMMETRY_TOLERANCE,
    Matrix,
    ReadOnly,
    eigenvalues_exceed,
    eigenvalues_of,
    is_number,
    read_array,
    read_coefficient,
    read_matrix,
    read_only,
    read_vector,
)
from contactqp.model.solution import LocalCertificate
from contactqp.model.summary import Printed, local_summary

# A semidefinite operator may have negative eigenvalues of this part of the largest, by rounding and print precision.
INDEFINITE = 1e-5
# Up to this size definiteness is checked on input, by eigenvalues.
DEFINITENESS_CHECK_SIZE = 300
# The largest scale of a contact without compliance.
LARGEST_SCALE = 1e150

# Scales that depend on the matrices alone if every contact has a compliance.
OF_MATRICES = ("contact_scale", "scaled_delassus", "scaled_asymmetry", "joint_scale", "own_compliances", "_of_matrices")


@computes
@dataclass(frozen=True, init=False, eq=False, repr=False)
class LocalProblem(ReadOnly):
    """One frictional contact problem in local form.

    Parameters
    ----------
    delassus : (d m, d m) array or sparse matrix
        W = H'M^-1 H, positive semidefinite; contact by contact, N before T. It is used as given, symmetric or not:
        `asymmetry` is max |W - W'| / max |W|, `scaled_asymmetry` the same with every contact's rows scaled to a
        compliance of one.
    offset : (d m,) or (m, d) array
        q, the velocities (or gaps and slips) without contact forces.
    friction : float or (m,) array
        Coulomb's coefficient, not negative.
    dimension : 2 or 3
        d, of the space.
    bilateral : (d m, p) array or sparse matrix, optional
        V, the influence of p joints.
    bilateral_delassus : (p, p) array or sparse matrix, optional
        R, of the joints on each other; zero by default (then V'r = -s is a condition on the forces).
    bilateral_offset : (p,) array, optional
        s; zero by default.
    contact_names : sequence of distinct strings, optional

    Raises
    ------
    InvalidProblem
        Wrong shapes, values that are not finite, a negative coefficient, an indefinite W.

    Examples
    --------
    >>> problem = LocalProblem(delassus=[[1.0, 2.0], [2.0, 5.0]], offset=[-7.0, -17.0], friction=0.8, dimension=2)
    >>> problem.contacts, problem.asymmetry
    (1, 0.0)
    """

    delassus: Matrix
    offset: Vector
    friction: Vector
    dimension: int
    bilateral: Matrix
    bilateral_delassus: Matrix
    bilateral_offset: Vector
    contact_names: tuple[str, ...] | None
    asymmetry: float

    @refuses_misfits
    @own_floating_point
    def __init__(
        self,
        delassus: Any,
        offset: ArrayLike,
        friction: ArrayLike,
        dimension: int,
        bilateral: Any = None,
        bilateral_delassus: Any = None,
        bilateral_offset: ArrayLike | None = None,
        contact_names: Sequence[str] | None = None,
    ) -> None:
        if not is_number(dimension) or dimension not in (2, 3):
            raise InvalidProblem(f"dimension: expected 2 or 3, got {shown(dimension)}")
        dimension = int(dimension)
        W = read_matrix("delassus", delassus)
        size = W.shape[0]
        if W.shape != (size, size) or size % dimension:
            raise InvalidProblem(
                f"delassus: expected a square matrix of {dimension} rows a contact, got shape {W.shape}"
            )
        m = size // dimension
        V = read_matrix("bilateral", np.zeros((size, 0)) if bilateral is None else bilateral)
        if V.shape[0] != size:
            raise InvalidProblem(f"bilateral: expected {size} rows, one for each of delassus, got shape {V.shape}")
        joints = V.shape[1]
        given = bilateral_delassus is not None or bilateral_offset is not None
        if bilateral is None and given:
            raise InvalidProblem("bilateral_delassus or bilateral_offset was given without bilateral")
        R = read_matrix(
            "bilateral_delassus", np.zeros((joints, joints)) if bilateral_delassus is None else bilateral_delassus
        )
        if R.shape != (joints, joints):
            raise InvalidProblem(f"bilateral_delassus: expected shape ({joints}, {joints}), got {R.shape}")
        names = read_names("contact_names", contact_names, m)
        q = read_array("offset", offset)
        values = dict(
            delassus=W,
            offset=read_vector("offset", q.ravel() if q.shape == (m, dimension) else q, size),
            friction=read_coefficient(friction, m),
            dimension=dimension,
            bilateral=V,
            bilateral_delassus=R,
            bilateral_offset=read_vector(
                "bilateral_offset", np.zeros(joints) if bilateral_offset is None else bilateral_offset, joints
            ),
            contact_names=names,
            asymmetry=_asymmetry(W),
        )
        vars(self).update({name: read_only(value) for name, value in values.items()})
        self._refuse_indefinite()

    def with_offsets(self, offset: Vector, bilateral_offset: Vector) -> LocalProblem:
        """Return the problem with other offsets (d m,), (p,); its matrices are not checked again."""
        twin = object.__new__(LocalProblem)
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        values["offset"] = read_only(read_vector("offset", offset, len(self.offset)))
        values["bilateral_offset"] = read_only(read_vector("bilateral_offset", bilateral_offset, self.joints))
        vars(twin).update(values)
        if self._own_compliance.all():  # no scale depends on offsets
            vars(twin).update({name: getattr(self, name) for name in OF_MATRICES})
        return twin

    def _refuse_indefinite(self) -> None:
        W, diagonal = self.delassus, self.delassus.diagonal()
        largest = np.max(abs(W.data), initial=0.0)
        own = np.repeat(self.contact_scale, self.dimension)
        worst = float(np.min(diagonal * own**2, initial=0.0))
        if 0 < W.shape[0] <= DEFINITENESS_CHECK_SIZE and largest > 0:
            root = np.where(diagonal > 0, 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), own)
            scaled = root[:, None] * W.toarray() * root
            symmetric, finite = (scaled + scaled.T) / 2, bool(np.isfinite(scaled).all())
            if finite and eigenvalues_exceed(-INDEFINITE, symmetric):
                return
            worst = float(eigenvalues_of(symmetric)[0]) if finite else -np.inf
        if worst < -INDEFINITE:
            raise InvalidProblem(
                f"delassus: expected positive semidefinite, got an indefinite matrix (eigenvalue {worst:.3g}, "
                "largest diagonal entry 1 after scaling)"
            )

    @cached_property
    def contacts(self) -> int:
        """Return the number of contacts m."""
        return len(self.friction)

    @cached_property
    def joints(self) -> int:
        """Return the number of joints p."""
        return len(self.bilateral_offset)

    @cached_property
    def _of_matrices(self) -> OfLocalMatrices:
        return OfLocalMatrices()

    @cached_property
    def own_compliances(self) -> Array:
        """Return the largest |entry| of each contact's own block of W, along the normal and the tangents (2, m)."""
        W, d, largest = self.delassus, self.dimension, np.zeros((2, self.contacts))
        tangents = product(range(1, d), repeat=2)
        for row, column in ((0, 0), *tangents):
            of_kind = largest[min(row, 1)]
            np.maximum(of_kind, abs(W.diagonal(column - row)[min(row, column) :: d]), out=of_kind)
        return read_only(largest)

    @property
    def _own_compliance(self) -> Vector:
        """The mean diagonal entry of each contact's own block (m,)."""
        return np.asarray(self.delassus.diagonal().reshape(self.contacts, self.dimension).mean(axis=1))

    @cached_property
    def contact_scale(self) -> Vector:
        """Return the factors s_i of the contacts' rows (m,) that give every contact's own block a mean diagonal of one.

        s_i u_i and r_i / s_i are roots of energies. A contact without a compliance of its own is given a row of V, or
        else an offset, as large as the other contacts have.
        """
        size = self._own_compliance
        known = size > 0
        scale = 1.0 / np.sqrt(np.where(known, size, 1.0))
        rows = abs(self.bilateral).max(axis=1).toarray().ravel() if self.joints else np.zeros(len(self.offset))
        for entries in (rows, abs(self.offset)):
            size = np.max(entries.reshape(self.contacts, self.dimension), axis=1, initial=0.0)
            felt = size > 0
            typical = float(np.median((scale * size)[known & felt])) if np.any(known & felt) else 1.0
            with np.errstate(over="ignore"):
                own = np.minimum(typical / np.where(felt, size, 1.0), LARGEST_SCALE)
            scale = np.where(felt & ~known, own, scale)
            known = known | felt
        return read_only(np.asarray(scale))

    @cached_property
    def scaled_delassus(self) -> Any:
        """Return the CSR matrix s_i W_ij s_j (d m, d m), s being the `contact_scale`."""
        scale, W = np.repeat(self.contact_scale, self.dimension), self.delassus
        row = np.repeat(np.arange(W.shape[0]), np.diff(W.indptr))
        data = (scale[row] * W.data) * scale[W.indices]
        return read_only(sp.csr_array((data, W.indices, W.indptr), shape=W.shape))

    @cached_property
    def scaled_asymmetry(self) -> float:
        """Return the `asymmetry` of `scaled_delassus`, which is independent of the scaling of contacts."""
        return _asymmetry(self.scaled_delassus)

    @cached_property
    def joint_scale(self) -> Vector:
        """Return the factors (p,) that give the columns of V, scaled by `contact_scale`, unit length."""
        scaled = self.bilateral.toarray() * np.repeat(self.contact_scale, self.dimension)[:, None]
        size = np.linalg.norm(scaled, axis=0)
        return read_only(np.asarray(1.0 / np.where(size > 0, size, 1.0)))

    @cached_property
    def drive(self) -> float:
        """Return the root mean square of scaled offsets of contacts that overlap without forces, or of loads of joints.

        It is the larger of the two, and zero where zero forces are the answer. Distant contacts do not enter.
        """
        overlaps = self._scaled_offset[self._scaled_offset[:, 0] < 0]
        return max(_mean_size(overlaps), _mean_size(self.bilateral_offset * self.joint_scale))

    @cached_property
    def typical_velocity(self) -> float:
        """Return the size that velocities are measured by: the `drive`, else the least scaled offset, else 1."""
        sizes = np.max(abs(self._scaled_offset), axis=1, initial=0.0)
        waiting = sizes[sizes > 0]
        return self.drive or (float(np.min(waiting)) if len(waiting) else 1.0)

    @property
    def _scaled_offset(self) -> Array:
        return self.contact_scale[:, None] * self.offset.reshape(self.contacts, self.dimension)

    def contact_name(self, i: int) -> str:
        """Return the name of contact i, or "contact i" without names."""
        return name_of("contact", i, self.contacts, self.contact_names)

    def __repr__(self) -> str:
        joints = f", {self.joints} joints" if self.joints else ""
        return f"LocalProblem({counted('contact', self.contacts)} in {self.dimension}D{joints})"


def _mean_size(parts: Array) -> float:
    """Return the root mean square of sizes whose squares may exceed doubles."""
    size = float(np.max(abs(parts), initial=0.0))
    return size * float(np.sqrt(np.mean((parts / size) ** 2))) if size > 0 else 0.0


def _asymmetry(W: Any) -> float:
    largest = np.max(abs(W.data), initial=0.0)
    if W.shape[0] <= DEFINITENESS_CHECK_SIZE and largest > 0:
        dense = W.toarray()
        return float(np.max(abs(dense - dense.T)) / largest)
    return float(np.max(abs(sp.csr_array(W - W.T)).data, initial=0.0) / largest) if largest > 0 else 0.0


@dataclass(frozen=True, eq=False)
class LocalSolution(ReadOnly, Printed):
    """Forces and velocities of one LocalProblem, with the certificate that judged them."""

    problem: LocalProblem = field(repr=False)
    force: Array  # (m, d) r, on the body, in the order (N, T1, T2)
    velocity: Array  # (m, d) u = W r + q + V l
    joint_force: Vector  # (p,) l
    contact_status: NDArray[np.str_]  # (m,) of open, grazing, stick, slip, and closed without friction
    certificate: LocalCertificate
    method: str  # the algorithm, and the convex method where it has one
    seconds: float
    iterations: int
    history: tuple[float, ...] = field(default=(), repr=False)  # the algorithm's own measure of progress

    def summary(self) -> str:
        """Return verdict, forces and velocities as a table of at most 80 columns; what `print` shows."""
        return local_summary(self)

    def __repr__(self) -> str:
        verdict = "passed" if self.certificate.passed else "REFUSED"
        return f"LocalSolution({self.method}, {counted('contact', len(self.force))}, {verdict})"

    def __str__(self) -> str:
        return local_summary(self)


def local_status(problem: LocalProblem, certificate: LocalCertificate) -> NDArray[np.str_]:
    """Return the statuses (m,) by the measures of the certificate; "grazing" has neither normal velocity nor force."""
    push, tolerance = certificate.force_measure, certificate.tolerance
    sliding = np.where(certificate.slip_measure > tolerance, "slip", "stick")
    closed = np.where(problem.friction > 0, sliding, "closed")
    apart = np.where(certificate.gap_measure > tolerance, "open", "grazing")
    return np.where(push > tolerance, closed, apart).astype("<U8")


@dataclass(frozen=True, init=False, eq=False, repr=False)
class GlobalProblem(ReadOnly):
    """A problem in FCLIB's global form as stated in its file, not symmetrised.

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
            asymmetry=_stiffness_asymmetry(M),
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
        """Return whether M is symmetric within the tolerance of a ContactProblem."""
        return self.asymmetry <= SYMMETRY_TOLERANCE

    @property
    def contacts(self) -> int:
        """Return the number of contacts m."""
        return len(self.friction)

    def __repr__(self) -> str:
        joints = f", {len(self.joint_offset)} joints" if len(self.joint_offset) else ""
        return (
            f"GlobalProblem({counts(unknown=self.matrix.shape[0], contact=self.contacts)} in {self.dimension}D{joints})"
        )


def _stiffness_asymmetry(M: Any) -> float:
    difference = abs(M - M.T).tocoo()
    difference.eliminate_zeros()
    diagonal = abs(M.diagonal())
    pair = np.sqrt(diagonal[difference.row]) * np.sqrt(diagonal[difference.col])
    with np.errstate(over="ignore"):  # beside diagonals of 5e-324
        relative = np.divide(difference.data, pair, out=np.full(len(pair), np.inf), where=pair > 0)
    return float(np.max(relative, initial=0.0))
