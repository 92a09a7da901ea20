"""The one problem of contactqp, with its signs.

    minimise    1/2 u'K u - f'u
    subject to  E_N u <= g        m unilateral contacts; the gap g - E_N u is positive when open
                A u = b           k ties

Its solution satisfies K u + E_N' l_N + E_T' l_T + A' nu = f with l_N >= 0, l_N (g - E_N u) = 0: the multiplier l_N is a
FORCE, positive in compression. With friction, |l_T| <= mu l_N and l_T points along the slip s = E_T u - slip_origin.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from contactqp.errors import InvalidProblem

Vector = NDArray[np.float64]
Matrix = Any  # scipy.sparse matrix or dense (n, n) array: SciPy's sparse types carry no useful annotations

# Programs print stiffness matrices with six or more digits; what is further from symmetric is another matrix.
SYMMETRY_TOLERANCE = 1e-6
# Rows are squared on the way.
LARGEST_ENTRY = 1e150
# Up to this size definiteness is decided at the door, by eigenvalues (a few milliseconds); above, by the factorisation.
DEFINITENESS_CHECK_SIZE = 200


@dataclass(frozen=True)
class Units:
    """Names of the units that the numbers of a problem are in; they label messages and tables and convert nothing."""

    length: str = ""
    force: str = ""


@dataclass(frozen=True, init=False, eq=False, repr=False)
class ContactProblem:
    """One contact problem: min 1/2 u'Ku - f'u subject to E_N u <= g and A u = b, with Coulomb data for friction.

    Parameters
    ----------
    stiffness : (n, n) array or sparse matrix
        K, symmetric positive semidefinite [force / length]. Symmetrised when its asymmetry
        max |K_ij - K_ji| / sqrt(K_ii K_jj) is at most 1e-6 (`asymmetry` keeps the value), refused beyond it.
    load : (n,) array
        f [force].
    normal : (m, n) array or sparse matrix
        E_N; row i maps displacements to the approach of contact i [-].
    gap : (m,) array
        g, the initial gaps [length]; negative means that the contact starts in overlap.
    tangent : ((d-1) m, n) array or sparse matrix, optional
        E_T, contact-major: in 3D the rows 2i and 2i+1 belong to contact i.
    friction : float or (m,) array, optional
        Coulomb's coefficient, not negative.
    slip_origin : (m, d-1) or flat array, optional
        E_T u where the step starts [length]; zero by default.
    tie : (k, n) array or sparse matrix, optional
        A, rows of multi-point constraints and of supports kept as rows.
    tie_value : (k,) array, optional
        b [length]; zero by default.
    dof_names, contact_names : sequences of distinct strings, optional
        Used in every message and table.
    units : Units or mapping with the keys ``length`` and ``force``, optional

    Raises
    ------
    InvalidProblem
        On wrong shapes, values that are not finite, an asymmetric or indefinite K, a zero row, negative friction.

    Examples
    --------
    >>> problem = ContactProblem(stiffness=[[157500.0]], load=[300.0], normal=[[1.0]], gap=[1e-3])
    >>> problem.dimension, problem.contacts, problem.ties
    (1, 1, 0)
    """

    stiffness: Matrix
    load: Vector
    normal: Matrix
    gap: Vector
    tangent: Matrix | None
    friction: Vector | None
    slip_origin: NDArray[np.float64] | None
    tie: Matrix
    tie_value: Vector
    dof_names: tuple[str, ...] | None
    contact_names: tuple[str, ...] | None
    units: Units
    asymmetry: float
    _shared: dict[str, Any]

    def __init__(
        self,
        stiffness: Any,
        load: ArrayLike,
        normal: Any,
        gap: ArrayLike,
        tangent: Any = None,
        friction: ArrayLike | None = None,
        slip_origin: ArrayLike | None = None,
        tie: Any = None,
        tie_value: ArrayLike | None = None,
        dof_names: Sequence[str] | None = None,
        contact_names: Sequence[str] | None = None,
        units: Units | Mapping[str, str] | None = None,
    ) -> None:
        K, asymmetry = _stiffness(stiffness)
        n = K.shape[0]
        E_N = _rows("normal", normal, n)
        m = E_N.shape[0]
        A = _rows("tie", np.zeros((0, n)) if tie is None else tie, n)
        if tie is None and tie_value is not None and np.size(tie_value):
            raise InvalidProblem("tie_value was given without tie")
        E_T, friction_, origin = _friction(tangent, friction, slip_origin, m, n)
        values = dict(
            stiffness=K,
            asymmetry=asymmetry,
            load=_vector("load", load, n),
            normal=E_N,
            gap=_vector("gap", gap, m),
            tangent=E_T,
            friction=friction_,
            slip_origin=origin,
            tie=A,
            tie_value=_vector("tie_value", np.zeros(A.shape[0]) if tie_value is None else tie_value, A.shape[0]),
            dof_names=_names("dof_names", dof_names, n),
            contact_names=_names("contact_names", contact_names, m),
            units=_units(units),
        )
        for name, value in values.items():
            object.__setattr__(self, name, value)
        _refuse_zero_rows("normal", E_N, self.contact_name)
        _refuse_zero_rows("tie", A, lambda i: f"tie {i}")
        # What is computed from stiffness and rows alone, kept for every problem that `replace` derives from this one.
        object.__setattr__(self, "_shared", {})

    @classmethod
    def _of_checked(cls, values: Mapping[str, Any], shared: dict[str, Any]) -> ContactProblem:
        """A problem of values that need no further check, with what it shares with the problem they come from."""
        problem = object.__new__(cls)
        for name, value in values.items():
            object.__setattr__(problem, name, value)
        object.__setattr__(problem, "_shared", shared)
        return problem

    def transformed(
        self,
        stiffness: Matrix,
        load: Vector,
        load_size: Vector,
        normal: Any,
        gap: Vector,
        tie: Any,
        tie_value: Vector,
    ) -> ContactProblem:
        """This frictionless problem in other unknowns (condensed, scaled): same contacts and ties, not checked again.

        `load_size` is the sum of sizes behind each entry of the load. Rounding may leave a transformed stiffness
        indefinite by a few digits of what it was before; it still is this problem.
        """
        kept = dict(contact_names=self.contact_names, units=self.units, asymmetry=0.0)
        frictionless = dict(tangent=None, friction=None, slip_origin=None, dof_names=None)
        data = dict(load=load, gap=gap, tie_value=tie_value, stiffness=stiffness)
        rows = dict(normal=sp.csr_array(normal), tie=sp.csr_array(tie))
        return ContactProblem._of_checked(kept | frictionless | data | rows, {"load_size": load_size})

    @property
    def dimension(self) -> int:
        """Number of unknowns n."""
        return int(self.stiffness.shape[0])

    @property
    def contacts(self) -> int:
        """Number of contacts m."""
        return int(self.normal.shape[0])

    @property
    def ties(self) -> int:
        """Number of ties k."""
        return int(self.tie.shape[0])

    @property
    def load_size(self) -> Vector:
        """(n,) sizes of the loads that add up to `load`: in a condensed problem more than |load|, where they cancel."""
        return np.asarray(self._shared.get("load_size", abs(self.load)))

    @property
    def frictional(self) -> bool:
        """Whether any contact has a positive coefficient of friction."""
        return self.friction is not None and bool(np.any(self.friction > 0))

    def replace(self, **changes: Any) -> ContactProblem:
        """The same problem with other data; K and the rows are kept, and with them their factorisation.

        >>> problem = ContactProblem(stiffness=[[2.0]], load=[1.0], normal=[[1.0]], gap=[0.0])
        >>> float(problem.replace(load=[3.0]).load[0])
        3.0
        """
        known = {f.name for f in fields(self)} - {"asymmetry", "_shared"}
        unknown = set(changes) - known
        if unknown:
            raise InvalidProblem(f"replace: unknown {sorted(unknown)}; known are {sorted(known)}")
        if set(changes) & {"stiffness", "normal", "tangent", "tie"}:
            return ContactProblem(**{name: getattr(self, name) for name in known} | changes)
        n, m, k = self.dimension, self.contacts, self.ties
        checked: dict[str, Any] = {name: getattr(self, name) for name in known} | {"asymmetry": self.asymmetry}
        for name, size in (("load", n), ("gap", m), ("tie_value", k)):
            if name in changes:
                checked[name] = _vector(name, changes[name], size)
        if set(changes) & {"friction", "slip_origin"}:
            origin = changes.get("slip_origin", self.slip_origin)
            friction = changes.get("friction", self.friction)
            _, checked["friction"], checked["slip_origin"] = _friction(self.tangent, friction, origin, m, n)
        for name, size in (("dof_names", n), ("contact_names", m)):
            if name in changes:
                checked[name] = _names(name, changes[name], size)
        if "units" in changes:
            checked["units"] = _units(changes["units"])
        return ContactProblem._of_checked(checked, self._shared)

    def energy(self, displacement: ArrayLike) -> float:
        """1/2 u'Ku - f'u."""
        u = np.asarray(displacement, dtype=float)
        return float(0.5 * u @ (self.stiffness @ u) - self.load @ u)

    def contact_name(self, i: int) -> str:
        return self.contact_names[i] if self.contact_names else f"contact {i}"

    def dof_name(self, j: int) -> str:
        return self.dof_names[j] if self.dof_names else f"unknown {j}"

    def __repr__(self) -> str:
        friction = ", with friction" if self.frictional else ""
        return f"ContactProblem({self.dimension} unknowns, {self.contacts} contacts, {self.ties} ties{friction})"


def _array(name: str, value: Any) -> NDArray[np.float64]:
    try:
        raw = np.asarray(value)
        if np.iscomplexobj(raw):
            raise TypeError("complex numbers")
        return np.array(raw, dtype=float)
    except (TypeError, ValueError) as error:
        raise InvalidProblem(f"{name}: expected real numbers, got {type(value).__name__} ({error})") from None


def _finite(name: str, values: NDArray[np.float64]) -> None:
    if not np.all(np.isfinite(values)):
        where = np.argwhere(~np.isfinite(values))[0]
        at = ", ".join(str(int(i)) for i in where)
        raise InvalidProblem(f"{name}: expected finite numbers, got {values[tuple(where)]} at [{at}]")


def _frozen(values: NDArray[np.float64]) -> NDArray[np.float64]:
    values.setflags(write=False)
    return values


def _vector(name: str, value: ArrayLike, size: int) -> Vector:
    vector = _array(name, value)
    if vector.shape != (size,):
        raise InvalidProblem(f"{name}: expected shape ({size},), got {vector.shape}")
    _finite(name, vector)
    return _frozen(vector)


def _sparse(name: str, value: Any) -> Any:
    """A canonical float64 CSR copy: duplicates summed, indices sorted, explicit zeros dropped."""
    if sp.issparse(value):
        if np.issubdtype(value.dtype, np.complexfloating):
            raise InvalidProblem(f"{name}: expected real numbers, got complex numbers")
        rows = sp.csr_array(value, dtype=float, copy=True)
    else:
        dense = _array(name, value)
        if dense.ndim != 2:
            raise InvalidProblem(f"{name}: expected a matrix, got {dense.ndim} dimension(s) of shape {dense.shape}")
        rows = sp.csr_array(dense)
    rows.sum_duplicates()
    _finite(name, rows.data)
    rows.eliminate_zeros()
    return rows


def _rows(name: str, value: Any, n: int) -> Any:
    if not sp.issparse(value) and np.size(value) == 0:
        value = np.zeros((0, n))
    rows = _sparse(name, value)
    if rows.shape[1] != n:
        raise InvalidProblem(f"{name}: expected {n} columns, one for each unknown, got shape {rows.shape}")
    return rows


def _refuse_zero_rows(name: str, rows: Any, called: Any) -> None:
    empty = np.flatnonzero(np.diff(rows.indptr) == 0)
    if empty.size:
        raise InvalidProblem(f"{name}: the row of {called(int(empty[0]))} is zero; it constrains nothing")
    largest = abs(rows).max(axis=1).toarray().ravel() if rows.shape[0] else np.ones(1)
    extreme = np.flatnonzero((largest < 1 / LARGEST_ENTRY) | (largest > LARGEST_ENTRY))
    if extreme.size:
        i = int(extreme[0])
        raise InvalidProblem(f"{name}: the row of {called(i)} has the size {largest[i]:.3g}; its square is no double")


def _stiffness(value: Any) -> tuple[Matrix, float]:
    dense = not sp.issparse(value)
    K = _sparse("stiffness", value)
    n = K.shape[0]
    if K.shape != (n, n) or n == 0:
        raise InvalidProblem(f"stiffness: expected a square matrix, got shape {K.shape}")
    diagonal = K.diagonal()
    if np.any(diagonal < 0):
        j = int(np.argmin(diagonal))
        raise InvalidProblem(f"stiffness: expected positive semidefinite, got K[{j}, {j}] = {diagonal[j]:.6g}")
    coo = K.tocoo()
    root = np.sqrt(diagonal)
    pair = root[coo.row] * root[coo.col]
    outside = np.abs(coo.data) > (1 + SYMMETRY_TOLERANCE) * pair
    if np.any(outside):
        at = int(np.flatnonzero(outside)[0])
        i, j = int(coo.row[at]), int(coo.col[at])
        raise InvalidProblem(
            f"stiffness: indefinite, |K[{i}, {j}]| = {abs(coo.data[at]):.6g} "
            f"exceeds sqrt(K[{i}, {i}] K[{j}, {j}]) = {pair[at]:.6g}"
        )
    difference = abs(K - K.T).tocoo()
    asymmetry = 0.0
    if difference.nnz:
        relative = difference.data / (root[difference.row] * root[difference.col])
        worst = int(np.argmax(relative))
        asymmetry = float(relative[worst])
        if asymmetry > SYMMETRY_TOLERANCE:
            i, j = int(difference.row[worst]), int(difference.col[worst])
            raise InvalidProblem(
                f"stiffness: expected symmetric, got K[{i}, {j}] and K[{j}, {i}] that differ by {asymmetry:.3g} "
                f"of sqrt(K[{i}, {i}] K[{j}, {j}]) (at most {SYMMETRY_TOLERANCE:g} is symmetrised)"
            )
        K = sp.csr_array((K + K.T) / 2)
    if n <= DEFINITENESS_CHECK_SIZE:
        _refuse_indefinite(K.toarray())
    if dense:
        return _frozen(K.toarray()), asymmetry
    return sp.csc_array(K), asymmetry


def _refuse_indefinite(K: NDArray[np.float64]) -> None:
    scale = np.sqrt(np.where(np.diag(K) > 0, np.diag(K), 1.0))
    eigenvalues = np.linalg.eigvalsh(K / np.outer(scale, scale))
    # Rounding of an exactly semidefinite matrix moves its eigenvalues by a few n eps; printed digits by
    # SYMMETRY_TOLERANCE.
    if eigenvalues[0] < -64 * len(K) * np.finfo(float).eps * max(eigenvalues[-1], 1.0):
        raise InvalidProblem(
            f"stiffness: expected positive semidefinite, got an indefinite matrix (eigenvalue {eigenvalues[0]:.3g} "
            "after scaling its diagonal to one)"
        )


def _friction(
    tangent: Any, friction: ArrayLike | None, slip_origin: ArrayLike | None, m: int, n: int
) -> tuple[Matrix | None, Vector | None, NDArray[np.float64] | None]:
    if tangent is None:
        if friction is not None and np.any(np.asarray(friction) != 0):
            raise InvalidProblem("friction: a coefficient was given without tangent, the directions of slip")
        if slip_origin is not None:
            raise InvalidProblem("slip_origin was given without tangent, the directions of slip")
        return None, None, None
    E_T = _rows("tangent", tangent, n)
    if E_T.shape[0] not in (m, 2 * m):
        raise InvalidProblem(f"tangent: expected {m} rows (2D) or {2 * m} rows (3D), got {E_T.shape[0]}")
    per_contact = E_T.shape[0] // m if m else 1
    coefficient = _array("friction", 0.0 if friction is None else friction)
    if coefficient.ndim == 0:
        coefficient = np.full(m, float(coefficient))
    coefficient = _vector("friction", coefficient, m)
    if np.any(coefficient < 0):
        i = int(np.argmin(coefficient))
        raise InvalidProblem(f"friction: expected a coefficient >= 0, got {coefficient[i]:.6g} at contact {i}")
    origin = np.zeros((m, per_contact)) if slip_origin is None else _array("slip_origin", slip_origin)
    if (
        origin.size != m * per_contact
        or origin.ndim not in (1, 2)
        or (origin.ndim == 2 and origin.shape != (m, per_contact))
    ):
        raise InvalidProblem(
            f"slip_origin: expected shape ({m}, {per_contact}) or ({m * per_contact},), got {origin.shape}"
        )
    _finite("slip_origin", origin)
    return E_T, coefficient, _frozen(origin.reshape(m, per_contact))


def _names(name: str, value: Sequence[str] | None, size: int) -> tuple[str, ...] | None:
    if value is None:
        return None
    names = tuple(str(v) for v in value)
    if len(names) != size:
        raise InvalidProblem(f"{name}: expected {size} names, got {len(names)}")
    if len(set(names)) != size:
        twice = next(v for v in names if names.count(v) > 1)
        raise InvalidProblem(f"{name}: expected distinct names, got {twice!r} more than once")
    return names


def _units(value: Units | Mapping[str, str] | None) -> Units:
    if value is None:
        return Units()
    if isinstance(value, Units):
        return value
    try:
        return Units(**value)
    except TypeError:
        raise InvalidProblem(f"units: expected the keys 'length' and 'force', got {value!r}") from None
