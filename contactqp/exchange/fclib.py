"""Read and write FCLIB's HDF5 files: problems in local and global form, guesses and solutions stored with them.

    /fclib_local    W, V? R?   spacedim   vectors/{q, mu, s?}      u = W r + q + V l,  V'r + R l + s = 0
    /fclib_global   M, H, G?   spacedim   vectors/{f, w, mu, b?}   M v = H r + f + G l,  u = H'v + w,  G'v + b = 0
    /solution, /guesses/1, /guesses/2, ...   u, r, v? l?

(Acary, Bremond, Huber 2018, and fclib.h.) What is stored under /solution is all zero in many published files.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import BackendMissing, InvalidProblem, Unsupported
from contactqp.exchange.files import (
    Path,
    Storage,
    StoredMatrix,
    check_dimension,
    check_file,
    check_finite,
    check_friction,
    file_size,
    matrix_of,
    naming,
    one_line,
    read_bytes,
    stored_form,
    write_whole,
    wrong,
)
from contactqp.exchange.local_form import body_motion, local_form_of, of_closing_contacts
from contactqp.model.arguments import checked
from contactqp.model.arrays import Array, Index
from contactqp.model.local_problem import GlobalProblem, LocalProblem, LocalSolution
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution

SIGNATURE = b"\x89HDF\r\n\x1a\n"
# Where the signature may stand: a user block of 512 bytes or a power of two times that may come before it.
SIGNATURE_PLACES = (0, 512, 1024, 2048)
# The largest size of an unpacked array: this many times the size of the file, plus a constant.
GROWTH, SMALL = 100, 2**26
EXPECTED = "an FCLIB file (HDF5)"


def is_hdf5(data: bytes) -> bool:
    """Return whether these first bytes of a file are HDF5's."""
    return any(data[place:].startswith(SIGNATURE) for place in SIGNATURE_PLACES)


def h5py_module() -> Any:
    """Import h5py, where a file is first read or written; BackendMissing where it is not installed."""
    try:
        import h5py
    except ImportError as error:
        raise BackendMissing(f"FCLIB's files need h5py ({error}): pip install h5py") from None
    return h5py


@contextmanager
def opened(path: Path) -> Iterator[Hdf5File]:
    """Yield the file, open for reading.

    Raises
    ------
    BackendMissing
        h5py is not installed.
    InvalidProblem
        No such file, or it is not HDF5.
    """
    head = read_bytes(path, EXPECTED, max(SIGNATURE_PLACES) + len(SIGNATURE))
    if not is_hdf5(head):
        raise wrong(path, "content", EXPECTED, "an empty file" if not head else "something else")
    h5py = h5py_module()
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise wrong(path, "content", EXPECTED, f"a damaged one ({one_line(error)})") from None
    with file:
        yield Hdf5File(path, file)


class Hdf5File:
    """Groups and datasets by their full names."""

    def __init__(self, path: Path, file: Any) -> None:
        self.path = path
        self._file = file

    def has(self, name: str) -> bool:
        try:
            return name in self._file
        except (OSError, RuntimeError, ValueError, KeyError) as error:
            raise wrong(self.path, name, "a group", f"damaged data ({one_line(error)})") from None

    def top(self) -> list[str]:
        try:
            return sorted(str(name) for name in self._file)
        except (OSError, RuntimeError, ValueError, KeyError) as error:
            raise wrong(self.path, "content", "groups", f"damaged data ({one_line(error)})") from None

    def integer(self, name: str) -> int:
        values = self.integers(name)
        if len(values) != 1:
            raise wrong(self.path, name, "one integer", f"{len(values)}")
        return int(values[0])

    def integers(self, name: str) -> Index:
        values = self._values(name)
        if values.dtype.kind not in "iu" or values.ndim > 1:
            raise wrong(self.path, name, "a list of integers", f"{values.dtype} of shape {values.shape}")
        return values.reshape(-1).astype(np.int64)

    def numbers(self, name: str) -> Array:
        """Return a list of numbers of any length, finite or not."""
        values = self._values(name)
        if values.dtype.kind not in "fiu" or values.ndim > 1:
            raise wrong(self.path, name, "a list of numbers", f"{values.dtype} of shape {values.shape}")
        return values.reshape(-1).astype(float)

    def vector(self, name: str, size: int, why: str, *, finite: bool = True) -> Array:
        """Return numbers of a dataset.

        Parameters
        ----------
        name : str
        size, why : int, str, how many are expected and where in the file that number comes from
        finite : bool, whether inf and NaN are refused
        """
        values = self.numbers(name)
        if len(values) != size:
            raise wrong(self.path, name, f"{size} numbers ({why})", len(values))
        if finite:
            check_finite(self.path, name, values)
        return values

    def shape(self, name: str) -> tuple[int, int]:
        """Return the shape (m, n) that a matrix states."""
        return self.integer(f"{name}/m"), self.integer(f"{name}/n")

    def matrix(self, name: str, shape: tuple[int, int], why: str) -> Any:
        """Return a matrix of this shape in CSR form; `why` says where the shape comes from."""
        if self.shape(name) != shape:
            raise wrong(self.path, f"{name}/m, {name}/n", f"{shape} ({why})", self.shape(name))
        stored = StoredMatrix(
            nzmax=self.integer(f"{name}/nzmax"),
            m=shape[0],
            n=shape[1],
            nz=self.integer(f"{name}/nz"),
            p=self.integers(f"{name}/p"),
            i=self.integers(f"{name}/i"),
            x=self.numbers(f"{name}/x"),
        )
        return matrix_of(stored, self.path, name)

    def _check_growth(self, name: str, dataset: Any) -> None:
        """Refuse a dataset that would unpack to far more than its file holds, packed or without stored chunks."""
        most = SMALL + GROWTH * file_size(self.path, EXPECTED)
        stated = int(dataset.dtype.itemsize) * math.prod(int(size) for size in dataset.shape)
        if stated > most:
            raise wrong(self.path, name, f"at most {most >> 20} MiB", f"{stated / 2**20:.0f} MiB")

    def _values(self, name: str) -> NDArray[Any]:
        if not self.has(name):
            raise wrong(self.path, name, "this dataset", "none of that name")
        try:
            dataset = self._file[name]
            if not hasattr(dataset, "shape"):
                raise wrong(self.path, name, "a dataset", "a group")
            self._check_growth(name, dataset)
            return np.asarray(dataset[()])
        except InvalidProblem:
            raise
        except (OSError, RuntimeError, KeyError, TypeError, ValueError, MemoryError) as error:
            raise wrong(self.path, name, "numbers", f"damaged data ({one_line(error)})") from None


LOCAL, GLOBAL = "fclib_local", "fclib_global"
ROLLING, ROLLING_LOCAL = "fclib_global_rolling", "fclib_local_rolling"


@dataclass(frozen=True, eq=False)
class StoredAnswer:
    """Forces and velocities as a file states them; `contactqp.certify_local` says whether they are right."""

    force: Array  # (m, d) r, on the body, in the order (N, T1, T2)
    joint_force: Array | None = None  # (p,) l
    velocity: Array | None = None  # (m, d) u
    motion: Array | None = None  # (n,) v, in the global form

    @property
    def finite(self) -> bool:
        """Return whether every force is a number."""
        joint = self.joint_force
        return bool(np.all(np.isfinite(self.force)) and (joint is None or np.all(np.isfinite(joint))))


@checked
def read_fclib(path: Path, *, as_stored: bool = False) -> ContactProblem | LocalProblem | GlobalProblem:
    """Return the problem in an FCLIB file.

    Parameters
    ----------
    path : path
    as_stored : bool
        Return the global form of the file unchanged, as a GlobalProblem.

    Returns
    -------
    LocalProblem
        For a local file; and for a global one whose M is less symmetric than a ContactProblem accepts (1e-6), with W =
        H'M^-1 H of the unsymmetric M; `asymmetry` measures that of W.
    ContactProblem
        For any other global file: stiffness M, load f, normal -H_N', gap w_N, tangent H_T', slip_origin -w_T, tie G',
        tie_value -b.

    Raises
    ------
    InvalidProblem
        The file is missing, no HDF5 or no FCLIB, or a dataset is missing, too short, out of range or not finite.
    Unsupported
        Contacts resist rolling.
    BackendMissing
        h5py is not installed.
    """
    with opened(path) as file:
        stored = _read_local(file) if _form(file) == LOCAL else _read_global(file)
    return stored if as_stored else solvable(stored, path)


def solvable(stored: LocalProblem | GlobalProblem, path: Path) -> ContactProblem | LocalProblem:
    """Return the stored problem in the form that `contactqp.solve` takes."""
    if isinstance(stored, LocalProblem):
        return stored
    with naming(path):
        return stored.contact_problem() if stored.symmetric else local_form_of(stored)


@checked
def read_fclib_guesses(path: Path) -> tuple[StoredAnswer, ...]:
    """Return the guesses stored with a problem, () where there are none; some are close to a solution, some are zero.

    Raises as `read_fclib`.
    """
    with opened(path) as file:
        if not file.has("guesses"):
            return ()
        number = file.integer("guesses/number_of_guesses")
        if number < 0:
            raise wrong(path, "guesses/number_of_guesses", "a number", number)
        return tuple(_answer(file, f"guesses/{k}") for k in range(1, number + 1))


@checked
def read_fclib_solution(path: Path) -> StoredAnswer:
    """Return the answer stored under /solution, which need not be right and is all zero in many published files.

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


def _friction(file: Hdf5File, form: str) -> Array:
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
    """Return the answer stored under /solution for a problem of this size that another file holds."""
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


# FCLIB's HDF5 files, written as fclib.h lays them out: 32-bit integers, doubles, strings that end with a zero byte.

SUFFIXES = (".hdf5", ".h5")
# As published files have it.
USUAL_STORAGE: dict[str, Storage] = {LOCAL: "csr", GLOBAL: "triplet"}


@checked
def write_fclib(
    path: Path,
    problem: LocalProblem | GlobalProblem | ContactProblem,
    solution: LocalSolution | Solution | None = None,
    *,
    title: str = "",
    description: str = "",
    math_info: str = "",
    storage: Storage | None = None,
) -> None:
    """Write a problem, and its solution if there is one, to an FCLIB file; the whole file or nothing.

    Parameters
    ----------
    title, description, math_info : str, written under info
    path : path that ends in .hdf5 or .h5
        A file that is there is replaced.
    problem : LocalProblem, GlobalProblem or ContactProblem
        A ContactProblem is written in global form: M = K, H = (-E_N', E_T'), w = (g, -slip_origin), G = A', b = -b.
        `read_fclib` gives them back bit for bit. Names, units and contacts of infinite gaps have no place in the file.
    solution : LocalSolution or Solution, optional
        Written under /solution: u, r, and l of joints; in global form v, and nu = -l of ties.
    storage : "csc", "csr" or "triplet", optional
        The storage of all matrices; by default rows in local form and triplets in global form, as in published files.

    Raises
    ------
    InvalidProblem
        Another suffix, no such folder, a solution of another problem, a ContactProblem without tangential rows.
    BackendMissing
        h5py is not installed.
    """
    file = check_file(FilePath(path), SUFFIXES)
    form = LOCAL if isinstance(problem, LocalProblem) else GLOBAL
    bodies = GlobalProblem.of(of_closing_contacts(problem)) if isinstance(problem, ContactProblem) else problem
    vectors, matrices = _local_data(bodies) if isinstance(bodies, LocalProblem) else _global_data(bodies)
    stored = {name: stored_form(matrix, storage or USUAL_STORAGE[form], name) for name, matrix in matrices.items()}
    answer = _answer_data(bodies, solution) if solution is not None else {}
    texts = {"title": title, "description": description, "math_info": math_info}
    h5py = h5py_module()

    def write(beside: FilePath) -> None:
        with h5py.File(beside, "w") as target:
            top = target.create_group(form)
            _put_integer(top, "spacedim", bodies.dimension)
            for name, matrix in stored.items():
                _put_matrix(top.create_group(name), matrix)
            _put_vectors(top.create_group("vectors"), vectors)
            info = top.create_group("info")
            for name, text in texts.items():
                _put_text(h5py, info, name, text)
            if answer:
                _put_vectors(target.create_group("solution"), answer)

    write_whole(file, write)


def _local_data(problem: LocalProblem) -> tuple[dict[str, Array], dict[str, Any]]:
    vectors = {"q": problem.offset, "mu": problem.friction}
    matrices = {"W": problem.delassus}
    if problem.joints:
        vectors["s"] = problem.bilateral_offset
        matrices |= {"V": problem.bilateral, "R": problem.bilateral_delassus}
    return vectors, matrices


def _global_data(problem: GlobalProblem) -> tuple[dict[str, Array], dict[str, Any]]:
    vectors = {"f": problem.load, "w": problem.offset, "mu": problem.friction}
    matrices = {"M": problem.matrix, "H": problem.directions}
    if len(problem.joint_offset):
        vectors["b"] = problem.joint_offset
        matrices["G"] = problem.joints
    return vectors, matrices


def _answer_data(problem: LocalProblem | GlobalProblem, solution: LocalSolution | Solution) -> dict[str, Array]:
    """Return v, u, r and l, as FCLIB names them, of a solution that belongs to this problem."""
    if isinstance(solution, LocalSolution):
        r, u, joint, v = solution.force, solution.velocity, solution.joint_force, None
    elif isinstance(problem, LocalProblem) or solution.slip is None:
        raise InvalidProblem("solution: expected one of this problem, got one of another kind")
    else:
        # Without a coefficient of friction there is no friction force at all.
        given = np.zeros_like(solution.slip) if solution.friction_force is None else solution.friction_force
        written = solution.gap < np.inf
        r = np.column_stack([solution.normal_force, -given])[written]
        u = np.column_stack([solution.gap, solution.slip])[written]
        joint, v = -solution.tie_force, solution.displacement
    joints = problem.joints if isinstance(problem, LocalProblem) else len(problem.joint_offset)
    shape = (problem.contacts, problem.dimension)
    if r.shape != shape or joint.shape != (joints,):
        raise InvalidProblem(
            f"solution: expected one of this problem, with forces of shape {shape} and {joints} joints, "
            f"got forces of shape {r.shape} and {len(joint)} joints"
        )
    answer = {"u": u.ravel(), "r": r.ravel()}
    if isinstance(problem, GlobalProblem):
        answer["v"] = body_motion(problem, r, joint) if v is None else v
    if joints:
        answer["l"] = joint
    return answer


def _put_matrix(group: Any, matrix: StoredMatrix) -> None:
    for name in ("nzmax", "m", "n", "nz"):
        _put_integer(group, name, getattr(matrix, name))
    for name, values in (("p", matrix.p), ("i", matrix.i)):
        group.create_dataset(name, data=np.asarray(values, dtype=np.int32))
    group.create_dataset("x", data=np.asarray(matrix.x, dtype=np.float64))


def _put_vectors(group: Any, vectors: dict[str, Array]) -> None:
    for name, values in vectors.items():
        group.create_dataset(name, data=np.asarray(values, dtype=np.float64))


def _put_integer(group: Any, name: str, value: int) -> None:
    group.create_dataset(name, data=np.array([value], dtype=np.int32))


def _put_text(h5py: Any, group: Any, name: str, text: str) -> None:
    """Write a string of fixed length that ends with a zero byte, as H5LTmake_dataset_string writes it."""
    data = text.encode() + b"\0"
    kind = h5py.h5t.C_S1.copy()
    kind.set_size(len(data))
    if not text.isascii():
        kind.set_cset(h5py.h5t.CSET_UTF8)
    made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    made.set_obj_track_times(False)
    dataset = h5py.h5d.create(group.id, name.encode(), kind, h5py.h5s.create(h5py.h5s.SCALAR), dcpl=made)
    dataset.write(h5py.h5s.ALL, h5py.h5s.ALL, np.array(data, dtype=f"S{len(data)}"), mtype=kind)
