"""FCLIB's HDF5 files, written as fclib.h lays them out: 32-bit integers, doubles, strings that end with a zero byte."""

from __future__ import annotations

from pathlib import Path as FilePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem
from contactqp.exchange.fclib import GLOBAL, LOCAL
from contactqp.exchange.hdf5_file import h5py_module
from contactqp.exchange.local_form import body_motion
from contactqp.exchange.matrix_storage import Storage, StoredMatrix, stored_form
from contactqp.exchange.refusal import Path
from contactqp.exchange.whole_file import check_file, write_whole
from contactqp.model.global_problem import GlobalProblem
from contactqp.model.local_problem import LocalProblem, LocalSolution
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution

SUFFIXES = (".hdf5", ".h5")
# As published files have it.
USUAL_STORAGE: dict[str, Storage] = {LOCAL: "csr", GLOBAL: "triplet"}


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
    path : path that ends in .hdf5 or .h5
        A file that is there is replaced.
    problem : LocalProblem, GlobalProblem or ContactProblem
        A ContactProblem is written in global form: M = K, H = (-E_N', E_T'), w = (g, -slip_origin), G = A', b = -b.
        `read_fclib` gives all of them back bit for bit; names and units have no place in the file.
    solution : LocalSolution or Solution, optional
        Written under /solution: u, r, and l of joints; in global form v, and nu = -l of ties.
    storage : "csc", "csr" or "triplet", optional
        Of all matrices; by default rows in local form and triplets in global form, as published files have it.

    Raises
    ------
    InvalidProblem
        Another suffix, no such folder, a solution of another problem, a ContactProblem without tangential rows.
    BackendMissing
        h5py is not installed.
    """
    file = check_file(FilePath(path), SUFFIXES)
    form = LOCAL if isinstance(problem, LocalProblem) else GLOBAL
    bodies = GlobalProblem.of(problem) if isinstance(problem, ContactProblem) else problem
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


def _local_data(problem: LocalProblem) -> tuple[dict[str, NDArray[np.float64]], dict[str, Any]]:
    vectors = {"q": problem.offset, "mu": problem.friction}
    matrices = {"W": problem.delassus}
    if problem.joints:
        vectors["s"] = problem.bilateral_offset
        matrices |= {"V": problem.bilateral, "R": problem.bilateral_delassus}
    return vectors, matrices


def _global_data(problem: GlobalProblem) -> tuple[dict[str, NDArray[np.float64]], dict[str, Any]]:
    vectors = {"f": problem.load, "w": problem.offset, "mu": problem.friction}
    matrices = {"M": problem.matrix, "H": problem.directions}
    if len(problem.joint_offset):
        vectors["b"] = problem.joint_offset
        matrices["G"] = problem.joints
    return vectors, matrices


def _answer_data(
    problem: LocalProblem | GlobalProblem, solution: LocalSolution | Solution
) -> dict[str, NDArray[np.float64]]:
    """v, u, r, l as FCLIB names them, of a solution that belongs to this problem."""
    if isinstance(solution, LocalSolution):
        r, u, joint, v = solution.force, solution.velocity, solution.joint_force, None
    elif isinstance(problem, LocalProblem) or solution.slip is None:
        raise InvalidProblem("solution: expected one of this problem, got one of another kind")
    else:
        # Without a coefficient of friction nothing rubs, and there is no friction force at all.
        rubs = solution.friction_force if solution.friction_force is not None else np.zeros_like(solution.slip)
        r = np.column_stack([solution.normal_force, -rubs])
        u = np.column_stack([solution.gap, solution.slip])
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


def _put_vectors(group: Any, vectors: dict[str, NDArray[np.float64]]) -> None:
    for name, values in vectors.items():
        group.create_dataset(name, data=np.asarray(values, dtype=np.float64))


def _put_integer(group: Any, name: str, value: int) -> None:
    group.create_dataset(name, data=np.array([value], dtype=np.int32))


def _put_text(h5py: Any, group: Any, name: str, text: str) -> None:
    """A string of fixed length that ends with a zero byte, as H5LTmake_dataset_string writes it."""
    data = text.encode() + b"\0"
    kind = h5py.h5t.C_S1.copy()
    kind.set_size(len(data))
    if not text.isascii():
        kind.set_cset(h5py.h5t.CSET_UTF8)
    made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    made.set_obj_track_times(False)
    dataset = h5py.h5d.create(group.id, name.encode(), kind, h5py.h5s.create(h5py.h5s.SCALAR), dcpl=made)
    dataset.write(h5py.h5s.ALL, h5py.h5s.ALL, np.array(data, dtype=f"S{len(data)}"), mtype=kind)
