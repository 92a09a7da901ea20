"""The one problem of contactqp, with its signs.

    minimise    1/2 u'K u - f'u
    subject to  E_N u <= g        m unilateral contacts; the gap g - E_N u is positive when open
                A u = b           k ties

Its solution satisfies K u + E_N' l_N + E_T' l_T + A' nu = f with l_N >= 0, l_N (g - E_N u) = 0: the multiplier l_N is a
FORCE, positive in compression. With friction, |l_T| <= mu l_N, and l_T = mu l_N s/|s| where s = E_T u - slip_origin is
not 0: l_T is what the body does to the obstacle, along its slip, and the friction on the body is -E_T' l_T.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.errors import InvalidProblem, Unsupported, counts
from contactqp.model.arguments import read_places
from contactqp.model.arrays import WORTHWHILE, Array, Indices, Mask, inverse_root, own_floating_point, refuses_misfits
from contactqp.model.arrays import Vector as Vector
from contactqp.model.computed import Computed
from contactqp.model.coulomb import without_rounded_levers
from contactqp.model.names import NO_UNITS, name_of, read_names, read_units
from contactqp.model.names import Units as Units
from contactqp.model.problem_data import (
    PLAIN,
    are_near_one,
    csr_rows,
    no_rows,
    read_array,
    read_friction,
    read_gap,
    read_motions,
    read_only,
    read_rows,
    read_stiffness,
    read_vector,
    rows_of_dense,
)
from contactqp.model.problem_data import Matrix as Matrix
from contactqp.model.quadratic_program import QuadraticProgram, given_program, of_program, quadratic_program

MEASURED = ("asymmetry", "rigid_change")  # found while a stiffness was read
CARRIED = ("load_sum", "_computed")  # arguments of derived problems beside their data


@dataclass(frozen=True, init=False, eq=False, repr=False)
class ContactProblem:
    """One contact problem: min 1/2 u'Ku - f'u subject to E_N u <= g and A u = b, with Coulomb data for friction.

    Parameters
    ----------
    stiffness : (n, n) array or sparse matrix
        K, symmetric positive semidefinite [force / length]. Symmetrised when its asymmetry
        max |K_ij - K_ji| / sqrt(K_ii K_jj) is at most 1e-6 (`asymmetry` keeps the value), refused beyond it. Where its
        digits were lost in print and bodies float, K is changed by no more than these digits, so that rigid motions
        (those of `near_null_space`, or recognised) cost no energy: `rigid_change` is max |dK_ij| / sqrt(K_ii K_jj).
    load : (n,) array
        f [force].
    normal : (m, n) array or sparse matrix
        E_N; row i maps displacements to the approach of contact i [-]. A row of zeros, of a node that is fixed,
        constrains nothing where g_i >= 0 and proves that there is no equilibrium where g_i < 0; likewise a tie.
    gap : (m,) array
        g, the initial gaps [length]; negative means that the contact starts in overlap, infinity that it never closes.
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
    dof_names, contact_names, tie_names : sequences of distinct strings, optional
        Used in every message and table.
    units : Units or mapping with the keys ``length`` and ``force``, optional
    near_null_space : (n, q) array, optional
        Motions that cost little energy, one a column: the rigid-body motions of elastic bodies. Those that K resists
        by nothing but the rounding of its entries, be they doubles or printed digits, are taken as rigid; the others
        are a hint for multigrid on large problems. With q = 0 no body floats, and K is not changed.

    Raises
    ------
    InvalidProblem
        On wrong shapes, values that are not finite, an asymmetric or indefinite K, negative friction.

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
    slip_origin: Array | None
    tie: Matrix
    tie_value: Vector
    dof_names: tuple[str, ...] | None
    contact_names: tuple[str, ...] | None
    tie_names: tuple[str, ...] | None
    units: Units
    near_null_space: Array | None
    asymmetry: float
    rigid_change: float
    load_sum: Vector | None  # (n,) sizes of the forces that add up to `load`, where these are not |load|
    _computed: Computed

    @refuses_misfits
    @own_floating_point
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
        near_null_space: ArrayLike | None = None,
        tie_names: Sequence[str] | None = None,
    ) -> None:
        K, asymmetry, rigid_change = read_stiffness(stiffness, near_null_space)
        m = (E_N := read_rows("normal", normal, n := K.shape[0])).shape[0]
        A = no_rows(n) if tie is None else read_rows("tie", tie, n)
        if tie is None and tie_value is not None and read_array("tie_value", tie_value).size:
            raise InvalidProblem("tie_value was given without tie")
        E_T, friction_, origin = read_friction(tangent, friction, slip_origin, m, n)
        loose = E_T is not None and not K.diagonal().all()
        E_N, E_T = without_rounded_levers(K, E_N, E_T) if loose else (E_N, E_T)
        values = dict(
            stiffness=K,
            asymmetry=asymmetry,
            rigid_change=rigid_change,
            load=read_vector("load", load, n),
            normal=E_N,
            gap=read_gap(gap, m),
            tangent=E_T,
            friction=friction_,
            slip_origin=origin,
            tie=A,
            tie_value=read_vector("tie_value", np.zeros(A.shape[0]) if tie_value is None else tie_value, A.shape[0]),
            dof_names=None if dof_names is None else read_names("dof_names", dof_names, n),
            contact_names=None if contact_names is None else read_names("contact_names", contact_names, m),
            tie_names=None if tie_names is None else read_names("tie_names", tie_names, A.shape[0]),
            near_null_space=read_motions(near_null_space, n),
            units=NO_UNITS if units is None else read_units(units),
        )
        self._keep(values, Computed())

    @classmethod
    def from_qp(
        cls,
        P: Any,
        q: ArrayLike | None = None,
        G: Any = None,
        h: ArrayLike | None = None,
        A: Any = None,
        b: ArrayLike | None = None,
        lb: ArrayLike | None = None,
        ub: ArrayLike | None = None,
        **ranges: Any,
    ) -> ContactProblem:
        """Return the contact problem of a quadratic program in the form and signs of qpsolvers.

        Minimise 1/2 x'P x + q'x subject to G x <= h, A x = b, lb <= x <= ub and, by the keywords C, l, u, to
        l <= C x <= u. Contacts are in the order G, ranges, lower bounds, upper bounds and are called "row 3",
        "range 4 upper", "lower 7"; infinite sides have none. Ranges and bounds whose sides are equal are ties after A,
        "tie 2", "range 4", "fixed 7". With names of unknowns and ranges these stand for the numbers: "range r4 upper",
        "lower x7". z, y and z_box of qpsolvers are the forces of rows, of ties, of upper less those of lower bounds.

        Parameters
        ----------
        P : (n, n) array or sparse matrix
            Symmetric positive semidefinite; or a `qpsolvers.Problem`, which has all of these.
        q : (n,) array
        G, h : (m, n) array or sparse matrix and (m,) array, optional
        A, b : (k, n) array or sparse matrix and (k,) array, optional
        lb, ub : (n,) arrays, optional
            Infinite where there is no bound.
        **ranges
            C (p, n), l (p,), u (p,); dof_names of the n unknowns and range_names of the p rows of C.

        Raises
        ------
        InvalidProblem
            As `ContactProblem`; a matrix without its limits; a lower side above its upper one.

        Examples
        --------
        >>> problem = ContactProblem.from_qp(P=[[2.0, 0.0], [0.0, 2.0]], q=[-2.0, -6.0], ub=[4.0, 1.0])
        >>> problem.contact_names
        ('upper 0', 'upper 1')
        """
        return of_program(cls, given_program(P, q, G, h, A, b, lb, ub), **ranges)

    def to_qp(self) -> QuadraticProgram:
        """Return this frictionless problem with the arguments of `qpsolvers.Problem`.

        Contacts that `from_qp` has made of bounds go back into lb and ub; all others, ranges included, are rows of G.

        Raises
        ------
        Unsupported
            Coulomb's friction is not a quadratic program.

        Examples
        --------
        >>> problem = ContactProblem.from_qp(P=[[2.0, 0.0], [0.0, 2.0]], q=[-2.0, -6.0], ub=[4.0, 1.0])
        >>> problem.to_qp().ub
        array([4., 1.])
        """
        if self.frictional:
            raise Unsupported("to_qp: Coulomb's friction is not a quadratic program; give friction=0 to leave it out")
        return quadratic_program(self)

    def _keep(self, values: Mapping[str, Any], computed: Computed) -> None:
        """Set the fields of the problem, arrays read-only; `load_sum` is None where not given."""
        vars(self).update(dict(load_sum=None) | dict(values), _computed=computed)
        # Frequently used values are plain attributes.
        sizes = dict(dimension=self.stiffness.shape[0], contacts=self.normal.shape[0], ties=self.tie.shape[0])
        vars(self).update(sizes, frictional=self.friction is not None and bool((self.friction > 0).any()))
        given: tuple[Any, ...] = (self.stiffness, self.normal, self.tangent, self.tie)
        vars(self)["_arrays"] = [(one, one.data, one.indices, one.indptr) for one in given if hasattr(one, "indptr")]
        vars(self).update({name: read_only(value) for name, value in values.items() if type(value) not in PLAIN})
        self.load_size, self.own_scale  # noqa: B018  which everything asks for too

    def _refuse_exchanged_arrays(self) -> None:
        """Raise InvalidProblem where a sparse matrix was given other arrays: read-only ones can still be exchanged."""
        for matrix, data, indices, indptr in vars(self)["_arrays"]:
            if not (matrix.data is data and matrix.indices is indices and matrix.indptr is indptr):
                raise InvalidProblem(
                    "stiffness, normal, tangent or tie holds other arrays than the problem was made with: a problem "
                    "does not change; make another one, or use problem.replace(stiffness=...)"
                )

    @classmethod
    def _of_checked(cls, values: Mapping[str, Any], computed: Computed) -> ContactProblem:
        """Return a problem of checked values, with the results computed for it."""
        problem = object.__new__(cls)
        problem._keep(values, computed)
        return problem

    def _values(self) -> dict[str, Any]:
        """Return all data of the problem by the names of the fields, without computed results."""
        self._refuse_exchanged_arrays()
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name != "_computed"}

    def _transformed(
        self,
        stiffness: Matrix,
        load: Vector,
        load_size: Vector,
        normal: Any,
        gap: Vector,
        tie: Any,
        tie_value: Vector,
        named: bool = True,
    ) -> ContactProblem:
        """Return this frictionless problem in other unknowns; rounding may make its stiffness indefinite, unchecked.

        `load_size` (n,) has the sizes behind each entry of the load; `named` rows are the contacts, with their names.
        """
        names, ties = (self.contact_names, self.tie_names) if named else (None, None)
        kept = dict(contact_names=names, tie_names=ties, units=self.units, asymmetry=0.0, rigid_change=0.0)
        frictionless = dict(tangent=None, friction=None, slip_origin=None, dof_names=None, near_null_space=None)
        rows = dict(stiffness=stiffness, normal=csr_rows(normal), tie=csr_rows(tie))
        data = dict(load=load, load_sum=load_size, gap=gap, tie_value=tie_value)
        return ContactProblem._of_checked(kept | frictionless | data | rows, Computed())

    @cached_property
    def dimension(self) -> int:
        """Return the number of unknowns n."""
        return int(self.stiffness.shape[0])

    @cached_property
    def diagonal(self) -> Vector:
        """Return the diagonal entries K_jj (n,), computed once for a stiffness."""
        of_stiffness = self._computed.of_stiffness
        if of_stiffness.diagonal is None:
            of_stiffness.diagonal = np.array(self.stiffness.diagonal(), dtype=float)
            of_stiffness.diagonal.setflags(write=False)
        return of_stiffness.diagonal

    @cached_property
    def own_scale(self) -> Vector:
        """Return the scale D (n,) of the unknowns, 1/sqrt(K_jj) [length / sqrt(energy)], and 1 where K_jj is zero."""
        of_stiffness = self._computed.of_stiffness
        if of_stiffness.own_scale is None:
            of_stiffness.own_scale = inverse_root(self.diagonal)
            of_stiffness.own_scale.setflags(write=False)
        return of_stiffness.own_scale

    @cached_property
    def stiffness_rows(self) -> Any:
        """Return K as a CSR matrix; a symmetric one has the same arrays by rows as by columns."""
        of_stiffness = self._computed.of_stiffness
        if of_stiffness.rows is None:
            K = self.stiffness
            if sp.issparse(K):
                by_rows = K if K.format == "csc" else csr_rows(K)
                rows = sp.csr_matrix((by_rows.data, by_rows.indices, by_rows.indptr), shape=K.shape)
            else:
                rows = rows_of_dense(K, sp.csr_matrix)
            of_stiffness.rows = read_only(rows)
        return of_stiffness.rows

    @cached_property
    def stiffness_sizes(self) -> Any:
        """Return |K| as a CSR matrix."""
        of_stiffness = self._computed.of_stiffness
        if of_stiffness.sizes is None:
            rows = self.stiffness_rows
            sizes = copy(rows) if rows.has_canonical_format else read_only(abs(rows))
            sizes.data = abs(sizes.data)
            sizes.data.setflags(write=False)
            of_stiffness.sizes = sizes
        return of_stiffness.sizes

    @cached_property
    def contacts(self) -> int:
        """Return the number of contacts m."""
        return int(self.normal.shape[0])

    @cached_property
    def ties(self) -> int:
        """Return the number of ties k."""
        return int(self.tie.shape[0])

    @cached_property
    def load_size(self) -> Vector:
        """Return the sizes of the forces that add up to `load` (n,), which exceed |load| where forces cancel."""
        size = abs(self.load) if self.load_sum is None else self.load_sum
        size.setflags(write=False)
        return size

    @cached_property
    def frictional(self) -> bool:
        """Return whether any contact has a positive coefficient of friction."""
        return self.friction is not None and bool(np.any(self.friction > 0))

    def replace(self, **changes: Any) -> ContactProblem:
        """Return the problem with other data, by the names of its arguments; unchanged K and rows keep their factors.

        New ties have the names given with them, or none. InvalidProblem is raised as by `ContactProblem`.

        >>> problem = ContactProblem(stiffness=[[2.0]], load=[1.0], normal=[[1.0]], gap=[0.0])
        >>> float(problem.replace(load=[3.0]).load[0])
        3.0
        """
        names = {f.name for f in fields(self)} - {*MEASURED, *CARRIED}
        if unknown := set(changes) - names:
            raise InvalidProblem(f"replace: unknown {sorted(unknown)}; known are {sorted(names)}")
        if set(changes) & {"stiffness", "normal", "tangent", "tie", "near_null_space"}:
            unset = {"tie_names": None} if "tie" in changes else {}
            unset |= {} if np.any(self.slip_origin) else {"slip_origin": None}
            made = ContactProblem(**{name: getattr(self, name) for name in names} | unset | changes)
            for name in MEASURED if "stiffness" not in changes else ():
                object.__setattr__(made, name, max(getattr(self, name), getattr(made, name)))
            return made
        n, m, k, checked = self.dimension, self.contacts, self.ties, self._values()
        for name, size in (("load", n), ("tie_value", k)):
            if name in changes:
                checked[name] = read_vector(name, changes[name], size)
        if "gap" in changes:
            checked["gap"] = read_gap(changes["gap"], m)
        if set(changes) & {"friction", "slip_origin"}:
            friction, origin = (changes.get(name, getattr(self, name)) for name in ("friction", "slip_origin"))
            _, checked["friction"], checked["slip_origin"] = read_friction(self.tangent, friction, origin, m, n, True)
        for name, size in (("dof_names", n), ("contact_names", m), ("tie_names", k)):
            if name in changes:
                checked[name] = read_names(name, changes[name], size)
        if "units" in changes:
            checked["units"] = read_units(changes["units"])
        return ContactProblem._of_checked(checked, self._computed)

    def _without_results(self) -> ContactProblem:
        """Return a copy of the problem without computed results."""
        return ContactProblem._of_checked(self._values(), Computed())

    def _with_load_sum(self, load: Vector, size: Vector) -> ContactProblem:
        """Return the problem under a load (n,) that is a sum of forces whose sizes add up to `size` (n,)."""
        return ContactProblem._of_checked(self.replace(load=load)._values() | dict(load_sum=size), self._computed)

    def with_contacts(self, contacts: Indices) -> ContactProblem:
        """Return the problem with these contacts alone, in this order and with their names; K keeps its factors.

        `contacts` (c,) has their numbers from 0, or (m,) truth values; InvalidProblem is raised for any other.

        >>> two = ContactProblem(stiffness=[[2.0]], load=[3.0], normal=[[1.0], [1.0]], gap=[0.5, 1.0])
        >>> two.with_contacts([1]).gap, two.with_contacts([1]).contact_name(0)
        (array([1.]), 'contact 1')
        """
        kept, contacts = self._values(), read_places("contacts", contacts, self.contacts)
        kept.update(normal=self.normal[contacts], gap=self.gap[contacts])
        if self.tangent is not None and self.friction is not None and self.slip_origin is not None:
            rows = np.arange(self.tangent.shape[0]).reshape(self.slip_origin.shape)[contacts].ravel()
            of_kept = dict(friction=self.friction[contacts], slip_origin=self.slip_origin[contacts])
            kept.update(tangent=self.tangent[rows], **of_kept)
        kept["contact_names"] = tuple(self.contact_name(int(i)) for i in contacts)
        return ContactProblem._of_checked(kept, Computed(self._computed.of_stiffness))

    @cached_property
    def _is_near_one(self) -> bool:
        """Return whether all unknowns have stiffness and no number is far from one; else `number_range` rescales."""
        rows = [one.data for one in (self.normal, self.tie, self.tangent) if one is not None]
        lengths = [self.gap, self.tie_value, *([] if self.slip_origin is None else [self.slip_origin.ravel()])]
        largest = abs(np.concatenate([self.load, *lengths])).max(keepdims=True)
        return bool(self.diagonal.all()) and are_near_one(np.concatenate([self.diagonal, *rows, largest]))

    @cached_property
    def _is_small(self) -> bool:
        """Return whether all unknowns have stiffness and are few, as are the rows, so that condensing is cheap."""
        rows = self.contacts + self.ties + (0 if self.tangent is None else self.tangent.shape[0])
        return max(self.dimension, rows) < WORTHWHILE and bool(self.diagonal.all())

    @cached_property
    def has_idle_rows(self) -> bool:
        """Return whether a contact or a tie constrains nothing: its row is zero, or its gap infinite."""
        return any(bool(which.any()) for which in self.idle_rows())

    def idle_rows(self) -> tuple[Mask, Mask]:
        """Return which contacts (m,) and ties (k,) constrain nothing: their rows are zero, or their gaps infinite."""
        if self._computed.idle_rows is None:
            zero = [one.indptr[1:] == one.indptr[:-1] for one in (self.normal, self.tie)]
            zero[0].flags.writeable = zero[1].flags.writeable = False
            self._computed.idle_rows = zero[0], zero[1]
        contacts, ties = self._computed.idle_rows
        return contacts | (self.gap == np.inf), ties

    def with_ties(self, ties: Indices) -> ContactProblem:
        """Return the problem with these ties alone, as `with_contacts` does with contacts."""
        ties = read_places("ties", ties, self.ties)
        names = tuple(map(self.tie_name, ties.tolist()))
        kept = self._values() | dict(tie_names=names, tie=self.tie[ties], tie_value=self.tie_value[ties])
        return ContactProblem._of_checked(kept, Computed(self._computed.of_stiffness))

    @property
    def _lock(self) -> Any:
        """Return the lock for computations that problems with the same stiffness and rows share.

        Every process has its own, since a process forked while another thread holds the lock would wait for ever.
        """
        return self._computed.locks.setdefault(os.getpid(), threading.RLock())

    def __getstate__(self) -> dict[str, Any]:
        """Return the data for copies and pickles, without computed results."""
        return self._values()

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._keep(state, Computed())

    @own_floating_point
    def energy(self, displacement: ArrayLike) -> float:
        """Return 1/2 u'Ku - f'u [force * length].

        Raises
        ------
        InvalidProblem
            `displacement` is not an array of n real numbers.
        """
        if (u := read_array("displacement", displacement)).shape != (self.dimension,):
            raise InvalidProblem(f"displacement: expected shape ({self.dimension},), got {u.shape}")
        return float(0.5 * u @ (self.stiffness @ u) - self.load @ u)

    def contact_name(self, i: int) -> str:
        """Return the name of contact i, or "contact i" without names."""
        return name_of("contact", i, self.contacts, self.contact_names)

    def dof_name(self, j: int) -> str:
        """Return the name of unknown j, or "unknown j" without names."""
        return name_of("unknown", j, self.dimension, self.dof_names)

    def tie_name(self, i: int) -> str:
        """Return the name of tie i, or "tie i" without names."""
        return name_of("tie", i, self.ties, self.tie_names)

    def __repr__(self) -> str:
        friction = ", with friction" if self.frictional else ""
        sizes = counts(unknown=self.dimension, contact=self.contacts, tie=self.ties)
        return f"ContactProblem({sizes}{friction})"
