"""FCLIB's HDF5 files, read: problems in local and global form, guesses and solutions stored with them.

    /fclib_local    W, V? R?   spacedim   vectors/{q, mu, s?}      u = W r + q + V l,  V'r + R l + s = 0
    /fclib_global   M, H, G?   spacedim   vectors/{f, w, mu, b?}   M v = H r + f + G l,  u = H'v + w,  G'v + b = 0
    /solution, /guesses/1, /guesses/2, ...   u, r, v? l?

(Acary, Bremond, Huber 2018, and fclib.h.) What is stored under /solution is all zero in many published files.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import Unsupported
from contactqp.exchange.hdf5_file import Hdf5File, opened
from contactqp.exchange.local_form import local_form_of
from contactqp.exchange.refusal import Path, check_dimension, check_friction, naming, wrong
from contactqp.model.global_problem import GlobalProblem
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem

LOCAL, GLOBAL, ROLLING = "fclib_local", "fclib_global", "fclib_global_rolling"
ROLLING_LOCAL = "fclib_local_rolling"


@dataclass(frozen=True, eq=False)
class StoredAnswer:
    """Forces and velocities as a file holds them. Nobody vouches for them: judge them by `contactqp.certify_local`."""

    force: NDArray[np.float64]  # (m, d) r, on the body, in the order (N, T1, T2)
    joint_force: NDArray[np.float64] | None = None  # (p,) l
    velocity: NDArray[np.float64] | None = None  # (m, d) u
    motion: NDArray[np.float64] | None = None  # (n,) v, in the global form

    @property
    def finite(self) -> bool:
        """Whether every force is a number."""
        joint = self.joint_force
        return bool(np.all(np.isfinite(self.force)) and (joint is None or np.all(np.isfinite(joint))))


def read_fclib(path: Path, *, as_stored: bool = False) -> ContactProblem | LocalProblem | GlobalProblem:
    """The problem in an FCLIB file.

    Parameters
    ----------
    path : path
    as_stored : bool
        Leave the global form as the file says it: a GlobalProblem.

    Returns
    -------
    LocalProblem
        Of a local file; and of a global one whose M is less symmetric than a ContactProblem forgives (1e-6), through
        W = H'M^-1 H of M as it is: its `asymmetry` says how unsymmetric W became.
    ContactProblem
        Of any other global file: stiffness M, load f, normal -H_N', gap w_N, tangent H_T', slip_origin -w_T, tie G',
        tie_value -b.

    Raises
    ------
    InvalidProblem
        No such file, no HDF5, no FCLIB, a dataset that is missing, too short, out of range or not finite.
    Unsupported
        Contacts that resist rolling.
    BackendMissing
        h5py is not installed.
    """
    with opened(path) as file:
        stored = _read_local(file) if _form(file) == LOCAL else _read_global(file)
    return stored if as_stored else solvable(stored, path)


def solvable(stored: LocalProblem | GlobalProblem, path: Path) -> ContactProblem | LocalProblem:
    """What a file says as a problem that `contactqp.solve` takes."""
    if isinstance(stored, LocalProblem):
        return stored
    with naming(path):
        return stored.contact_problem() if stored.symmetric else local_form_of(stored)


def read_fclib_guesses(path: Path) -> tuple[StoredAnswer, ...]:
    """The guesses stored with a problem, () where there are none; some are close to a solution, some are zero.

    Raises as `read_fclib`.
    """
    with opened(path) as file:
        if not file.has("guesses"):
            return ()
        number = file.integer("guesses/number_of_guesses")
        if number < 0:
            raise wrong(path, "guesses/number_of_guesses", "a number", number)
        return tuple(_answer(file, f"guesses/{k}") for k in range(1, number + 1))


def read_fclib_solution(path: Path) -> StoredAnswer:
    """What is stored under /solution. It is somebody's claim, and all zero in many published files.

    Raises as `read_fclib`, also where there is none.
    """
    with opened(path) as file:
        if not file.has("solution"):
            raise wrong(path, "solution", "a stored solution", "none")
        return _answer(file, "solution")


def _form(file: Hdf5File) -> str:
    found = [name for name in (LOCAL, GLOBAL, ROLLING, ROLLING_LOCAL) if file.has(name)]
    if not found:
        raise wrong(file.path, "content", f"/{LOCAL} or /{GLOBAL}", f"{file.top()}")
    if len(found) > 1:
        raise wrong(file.path, "content", "one problem", f"{found}")
    if found[0] in (ROLLING, ROLLING_LOCAL):
        raise Unsupported(f"{file.path}: /{found[0]}: contacts that resist rolling are not supported, only sliding")
    return found[0]


def _dimension(file: Hdf5File, form: str) -> int:
    return check_dimension(file.path, f"{form}/spacedim", file.integer(f"{form}/spacedim"))


def _friction(file: Hdf5File, form: str) -> NDArray[np.float64]:
    place = f"{form}/vectors/mu"
    friction = file.numbers(place)
    friction = file.vector(place, len(friction), "")
    check_friction(file.path, place, friction)
    return friction


def _read_local(file: Hdf5File) -> LocalProblem:
    d, mu = _dimension(file, LOCAL), _friction(file, LOCAL)
    size = d * len(mu)
    why = f"{d} for each of the {len(mu)} contacts of mu"
    q = file.vector(f"{LOCAL}/vectors/q", size, why)
    joints: dict[str, Any] = {}
    if file.has(f"{LOCAL}/V") or file.has(f"{LOCAL}/R"):
        p = file.shape(f"{LOCAL}/R")[0]
        joints = dict(
            bilateral=file.matrix(f"{LOCAL}/V", (size, p), f"{why}, by the {p} joints of R"),
            bilateral_delassus=file.matrix(f"{LOCAL}/R", (p, p), "square"),
            bilateral_offset=file.vector(f"{LOCAL}/vectors/s", p, f"the {p} joints of R"),
        )
    W = file.matrix(f"{LOCAL}/W", (size, size), why)
    with naming(file.path):
        return LocalProblem(delassus=W, offset=q, friction=mu, dimension=d, **joints)


def _read_global(file: Hdf5File) -> GlobalProblem:
    d, mu = _dimension(file, GLOBAL), _friction(file, GLOBAL)
    f = file.numbers(f"{GLOBAL}/vectors/f")
    n, size = len(f), d * len(mu)
    unknowns, contacts = f"the {n} unknowns of f", f"{d} for each of the {len(mu)} contacts of mu"
    f = file.vector(f"{GLOBAL}/vectors/f", n, "")
    w = file.vector(f"{GLOBAL}/vectors/w", size, contacts)
    joints: dict[str, Any] = {}
    if file.has(f"{GLOBAL}/G"):
        p = file.shape(f"{GLOBAL}/G")[1]
        joints = dict(
            joints=file.matrix(f"{GLOBAL}/G", (n, max(p, 0)), unknowns),
            joint_offset=file.vector(f"{GLOBAL}/vectors/b", p, f"the {p} joints of G"),
        )
    H = file.matrix(f"{GLOBAL}/H", (n, size), f"{unknowns}; {contacts}")
    M = file.matrix(f"{GLOBAL}/M", (n, n), unknowns)
    with naming(file.path):
        return GlobalProblem(matrix=M, directions=H, load=f, offset=w, friction=mu, dimension=d, **joints)


def read_solution_for(path: Path, contacts: int, dimension: int) -> StoredAnswer:
    """What is stored under /solution, of a problem of this size that stands elsewhere."""
    with opened(path) as file:
        if not file.has("solution"):
            raise wrong(path, "solution", "a stored solution", "none")
        return _sized_answer(file, "solution", contacts, dimension)


def _answer(file: Hdf5File, group: str) -> StoredAnswer:
    form = _form(file)
    return _sized_answer(file, group, len(_friction(file, form)), _dimension(file, form))


def _sized_answer(file: Hdf5File, group: str, m: int, d: int) -> StoredAnswer:
    why = f"{d} for each of {m} contacts"
    r = file.vector(f"{group}/r", d * m, why, finite=False).reshape(m, d)
    u, v, joint = None, None, None
    if file.has(f"{group}/u"):
        u = file.vector(f"{group}/u", d * m, why, finite=False).reshape(m, d)
    if file.has(f"{group}/v"):
        v = file.numbers(f"{group}/v")
    if file.has(f"{group}/l"):
        joint = file.numbers(f"{group}/l")
    return StoredAnswer(force=r, joint_force=joint, velocity=u, motion=v)
