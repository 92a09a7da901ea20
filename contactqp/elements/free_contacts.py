"""Contacts of bodies some of whose unknowns are prescribed: rows of the free unknowns, and what is left of the gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.elements.pairing import Pairing
from contactqp.elements.reading import real_array
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Index, Vector


@dataclass(frozen=True, eq=False)
class FreeContacts:
    """The contacts that a free unknown moves, m of them, over the f free unknowns.

    Attributes
    ----------
    kept : (m,) array of int
        Their places among the rows of all pairings.
    normal : (m, f) sparse array
    gap : (m,) array
        gap - E_N u_prescribed [length].
    names : list of str
    tangent : ((d-1) m, f) sparse array, optional
    friction : (m,) array, optional
    slip_origin : ((d-1) m,) array, optional
        -E_T u_prescribed [length].
    """

    kept: Index
    normal: Any
    gap: Vector
    names: list[str]
    tangent: Any = None
    friction: Vector | None = None
    slip_origin: Vector | None = None


def free_contacts(
    pairings: Sequence[Pairing],
    prescribed: Vector,
    *,
    friction: ArrayLike | None = None,
    names: Sequence[str] | None = None,
) -> FreeContacts:
    """Contacts between supported nodes, which no free unknown moves, are left out.

    Parameters
    ----------
    pairings : sequence of Pairing
        Rows over all n unknowns.
    prescribed : (n,) array
        Displacements of the supports [length], NaN at free unknowns.
    friction, names
        As `System.problem` takes them.

    Raises
    ------
    InvalidProblem
        Rows of another length than u; supported nodes that are pressed into an obstacle.
    """
    free = np.flatnonzero(np.isnan(prescribed))
    given = np.where(np.isnan(prescribed), 0.0, prescribed)
    normal = stacked([pairing.normal for pairing in pairings], len(given))
    gap = np.concatenate([np.zeros(0), *[np.asarray(pairing.gap, dtype=float) for pairing in pairings]])
    gap = gap - normal @ given
    kept = kept_contacts(normal, prescribed)
    held = np.setdiff1d(np.arange(len(gap)), kept)
    called = [f"contact {i}" for i in range(len(gap))] if names is None else names
    if len(called) != len(gap):
        raise InvalidProblem(f"names: expected one for each of {len(gap)} rows, got {len(called)}")
    if held.size and gap[held].min() < 0:
        i = held[np.argmin(gap[held])]
        raise InvalidProblem(
            f"{called[i]}: its nodes are supported and overlap by {-gap[i]:.6g}; nothing can part them"
        )
    tangential: dict[str, Any] = {}
    if friction is not None:
        tangent = stacked([pairing.tangent for pairing in pairings], len(given))
        per_contact = tangent.shape[0] // max(len(gap), 1)
        rows = (kept[:, None] * per_contact + np.arange(per_contact)).ravel()
        tangential = {
            "tangent": tangent[rows][:, free],
            "friction": np.broadcast_to(real_array("friction", friction), gap.shape)[kept],
            "slip_origin": -(tangent @ given)[rows],
        }
    return FreeContacts(kept, sp.csr_array(normal[kept][:, free]), gap[kept], [called[i] for i in kept], **tangential)


def kept_contacts(normal: Any, prescribed: Vector) -> Index:
    """The rows of E_N that depend on a free unknown."""
    return np.flatnonzero(abs(sp.csr_array(normal)) @ np.isnan(prescribed).astype(float) > 0)


def stacked(rows: Sequence[Any], n: int) -> Any:
    """The rows of all pairings, one under the other.

    Raises
    ------
    InvalidProblem
        Rows over another number of unknowns than n.
    """
    for i, matrix in enumerate(rows):
        if matrix.shape[1] != n:
            raise InvalidProblem(f"pairing {i}: expected rows over all {n} unknowns, got {matrix.shape[1]}")
    return sp.csr_array(sp.vstack([sp.csr_array((0, n)), *rows], format="csr"))
